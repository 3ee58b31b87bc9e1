"""Fidelity: how much of the model mountings are scored with, and the rungs of a search from cheap to dear.

It is the detail of the vehicles, the share of the beams and the number of frames.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import zip_longest

import numpy as np

from ..metrics.metric import grown
from ..optimise.multi_fidelity import Rung
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


# --- the rungs of a search: which frames, beams and shapes each scores mountings with ---------------------------------
# A rung's frames are the first so many of one fixed order, so that each rung has all frames of the one below and two
# mountings are always compared on the same ones.

FIRST_FRAMES = 8
_CANDIDATES = (16, 8)  # of the second rung and the third
_FINALISTS = 4
_SCREEN_CLIMB, _COARSE_CLIMB, _LAST_CLIMB = 24, 15, 14  # samples for each variable, of two at least
_COARSE_BEAMS = 4000  # in a turn of the first rung: an eighth of an RS-16's, a thirty-second of an RS-80's
_MOST_STRIDE = 32
_FEWEST_COLUMNS = 40  # of a turn, for any stride


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


def make_rungs(
    observation: Observation, block: Sequence[int], vehicles: Sequence[float], variables: int
) -> tuple[Rung, ...]:
    """The rungs from the cheapest to the reference, which is the last: the scene's own detail, beams and frames.

    Frames double and beams come back from rung to rung, while half as many candidates go on.

    Parameters
    ----------
    observation : Observation
        The scene's.
    block : sequence of int, (f,)
        Block of time of each searched frame.
    vehicles : sequence of float, (f,)
        Vehicles that count in each, or their weights.
    variables : int
        Searched coordinates.
    """
    order, stride = spread_order(block, vehicles), coarsest_stride(observation)
    cheap, reference = min(observation.detail, "body", key=DETAILS.index), Fidelity(observation.detail)
    coarse, finer = Fidelity(cheap, stride), Fidelity(cheap, max(1, stride // 2))
    across = max(variables, 2)  # with one too a climb takes some generations
    climb = 0 if finer == reference else _COARSE_CLIMB * across
    return (
        Rung(coarse, order[:FIRST_FRAMES], climb=_SCREEN_CLIMB * across),
        Rung(coarse, order[: 2 * FIRST_FRAMES], candidates=_CANDIDATES[0]),
        Rung(finer, order[: 4 * FIRST_FRAMES], candidates=_CANDIDATES[1], climb=climb),
        Rung(reference, order, candidates=_FINALISTS, climb=_LAST_CLIMB * across),
    )


def spread_order(block: Sequence[int], vehicles: Sequence[float]) -> tuple[int, ...]:
    """Places of frames in an order of which every beginning is spread evenly over the blocks of time.

    Blocks take turns, a frame each, and come in an order in which neighbours in time come far apart; so do the frames
    within a block. Frames in which no vehicle counts come last.
    """
    block, filled = np.asarray(block), np.asarray(vehicles) > 0
    order = []
    for some in (filled, ~filled):
        queues = [np.flatnonzero(some & (block == label)) for label in np.unique(block[some])]
        queues = [queues[turn][far_apart(len(queues[turn]))].tolist() for turn in far_apart(len(queues))]
        order += [frame for turn in zip_longest(*queues) for frame in turn if frame is not None]
    return tuple(order)


def far_apart(count: int) -> list[int]:
    """0 to `count` - 1 in an order of which every beginning is spread out: by van der Corput's sequence."""
    bits = max(count - 1, 1).bit_length()
    reverse = (int(f"{number:0{bits}b}"[::-1], 2) for number in range(2**bits))
    return [number for number in reverse if number < count]
