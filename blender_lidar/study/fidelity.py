"""How much of the model mountings are scored with: detail, share of the beams, number of frames, and how it is cast."""

from __future__ import annotations

from dataclasses import dataclass, replace

from ..casting.standing import StandingScenery
from ..sensors.beams import beam_lattice
from .frame_scorer import Observation


@dataclass(frozen=True, slots=True)
class Fidelity:
    """What an evaluation may be made cheaper by, or dearer.

    Attributes
    ----------
    detail : str
        Level of detail of the vehicles, of `world.shapes.DETAILS`.
    stride : int
        Every so many-th firing column is cast.
    phase : int
        Which of them: 0 to `stride` - 1 columns are passed over first.
    caster : str or None
        A name of `casting.CASTERS`; None keeps the scene's.
    frames : int or None
        How many of the searched frames are looked at, spread evenly; None takes them all.
    culled : bool
        Whether beams that can reach no vehicle are left out.
    ground : bool
        Whether the road is cast against too, as two large triangles.
    """

    detail: str
    stride: int = 1
    phase: int = 0
    caster: str | None = None
    frames: int | None = None
    culled: bool = True
    ground: bool = False

    @property
    def name(self) -> str:
        """A short name, for tables and pictures; phases share it."""
        parts = [
            self.detail,
            "" if self.stride == 1 else f"1/{self.stride}",
            "" if self.frames is None else f"{self.frames}f",
            self.caster or "",
            "" if self.culled else "every beam",
            "ground" if self.ground else "",
        ]
        return " ".join(part for part in parts if part)

    @property
    def text(self) -> str:
        """The same in words."""
        columns = {1: "all beams", 2: "every 2nd column", 3: "every 3rd column"}
        parts = [
            self.detail,
            columns.get(self.stride, f"every {self.stride}th column"),
            "all frames" if self.frames is None else f"{self.frames} frame{'s' * (self.frames != 1)}",
            self.caster or "",
            "" if self.culled else "nothing culled",
            "the ground cast too" if self.ground else "",
        ]
        return ", ".join(part for part in parts if part)

    def observed(self, observation: Observation) -> Observation:
        """The same sensor, seen through this fidelity but for frames and ground; `observation` has every beam.

        Raises
        ------
        InputError
            For a stride beyond the columns of a turn.
        """
        lattice = observation.lattice
        if self.stride != 1 or self.phase:
            lattice = beam_lattice(
                lattice.model, lattice.rotation_hz, phase_rad=self.phase * lattice.step_rad, stride=self.stride
            )
        caster, scenery = self.caster or observation.caster, observation.scenery
        if scenery is not None and caster != observation.caster:
            scenery = StandingScenery(scenery.scenery, caster)
        return replace(
            observation, lattice=lattice, detail=self.detail, caster=caster, scenery=scenery, culled=self.culled
        )
