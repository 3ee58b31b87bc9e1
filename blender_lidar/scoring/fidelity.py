"""Fidelity: how much of the model mountings are scored with, and the coarse one that a search screens with.

It is the detail of the vehicles, the share of the beams and the number of frames.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..metrics.metric import grown
from ..scene.observation import Observation
from ..scene.site import Site
from ..sensors.beams import BeamLattice, beam_lattice
from ..world.shapes import DETAILS


@dataclass(frozen=True, slots=True)
class Fidelity:
    """What an evaluation may be made cheaper by.

    Attributes
    ----------
    detail : str
        Level of detail of the vehicles, of `world.shapes.DETAILS`.
    stride : int
        Every so many-th firing column is cast.
    phase : int
        Which of them: 0 to `stride` - 1 columns are passed over first.
    frames : int or None
        How many of the searched frames are looked at, spread evenly; None takes them all.
    """

    detail: str
    stride: int = 1
    phase: int = 0
    frames: int | None = None

    @property
    def name(self) -> str:
        """A short name, for tables and pictures; phases share it."""
        beams = "" if self.stride == 1 else f"1/{self.stride}"
        frames = "" if self.frames is None else f"{self.frames}f"
        return " ".join(filter(None, (self.detail, beams, frames)))

    @property
    def text(self) -> str:
        """The same in words."""
        columns = {1: "all beams", 2: "every 2nd column", 3: "every 3rd column"}
        beams = columns.get(self.stride, f"every {self.stride}th column")
        frames = "all frames" if self.frames is None else f"{self.frames} frame{'s' * (self.frames != 1)}"
        return ", ".join((self.detail, beams, frames))


# --- frames -----------------------------------------------------------------------------------------------------------


def evenly_spread(of: int, kept: int) -> np.ndarray:
    """Systematic sample: which `kept` of so many rows lie in the middle of equal stretches of them, (kept,) int."""
    return ((np.arange(kept) + 0.5) * of / kept).astype(int)


def with_fewer_frames(site: Site, frames: int | None) -> Site:
    """The site with at most that many of its searched frames, spread evenly; all for None, or where those are empty."""
    if frames is None or frames >= len(site.search):
        return site
    kept = evenly_spread(len(site.search), frames)
    search = tuple(site.search[row] for row in kept)
    if not any(frame.counted_weight.any() for frame in search):
        return site
    names = ("search", "search_block", "search_recording")
    plan = replace(site.plan, **{name: getattr(site.plan, name)[kept] for name in names})
    return replace(site, plan=plan, search=search)


# --- the coarse fidelity of a search ----------------------------------------------------------------------------------

_SCREENED_FRAMES = 24
_COARSE_BEAMS = 4000  # in a turn: an eighth of an RS-16's, a thirty-second of an RS-80's
_MOST_STRIDE = 32
_FEWEST_COLUMNS = 40  # of a turn, for any stride


def screened_with(observation: Observation, vehicles: Sequence[float]) -> tuple[Fidelity, tuple[int, ...]]:
    """The coarse fidelity, and places of the frames that it looks at, spread evenly over those that hold vehicles.

    `vehicles` (f,) is how many count in each frame, or their weights.
    """
    filled = np.flatnonzero(np.asarray(vehicles) > 0)
    filled = filled if len(filled) else np.arange(len(vehicles))
    frames = filled[evenly_spread(len(filled), min(_SCREENED_FRAMES, len(filled)))]
    detail = min(observation.detail, "body", key=DETAILS.index)
    return Fidelity(detail, coarsest_stride(observation)), tuple(frames.tolist())


def coarse_observation(observation: Observation, fidelity: Fidelity) -> Observation:
    """The same sensor through a fidelity, with cells that grow as returns thin out; the reference stays as it is.

    With one column in k, returns are a k-th, and vehicles fall below the threshold that all beams see; on cells of k
    times the area their share of occupied cells stays about the same. `scripts/research/coarse_beams.py` of commit
    030385c (RS-16, scenes/i80.toml) ranks 150 mountings by a quarter of the beams on 30 frames, beside all beams on 54,
    with a weighted tau of 0.85 on cells as they are and of 0.94 on larger ones; on 8 frames of 0.82 and 0.88, and so by
    an eighth of the beams. Where all are good, 150 mountings within 0.15 m and 5 degrees about the best, shapes count:
    a quarter of the beams on all frames correlates by 0.93 with all beams on the vehicles' own bodies, with boxes by
    0.86, and all beams with boxes by 0.91, so boxes are not used.

    Raises
    ------
    InputError
        For a stride beyond the columns of a turn.
    """
    seen = replace(observation, detail=fidelity.detail)
    if fidelity.stride == 1:
        return seen

    def thinned(beams: BeamLattice) -> BeamLattice:
        phase_rad = fidelity.phase * beams.step_rad
        return beam_lattice(beams.model, beams.rotation_hz, phase_rad=phase_rad, stride=fidelity.stride)

    growth = math.sqrt(fidelity.stride)
    return replace(seen.with_lattices(thinned), cell_m=grown(observation.cell_m, growth), cell_growth=growth)


def coarsest_stride(observation: Observation) -> int:
    """Every so many-th column leaves about `_COARSE_BEAMS` beams in a turn: a power of two."""
    lattice = observation.lattice
    thinning = min(lattice.columns * lattice.rings / _COARSE_BEAMS, lattice.columns / _FEWEST_COLUMNS, _MOST_STRIDE)
    return 2 ** round(math.log2(max(thinning, 1.0)))
