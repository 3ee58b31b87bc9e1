"""How much of the model mountings are scored with: level of detail, share of the beams, caster."""

from __future__ import annotations

from dataclasses import dataclass, replace

from ..sensors.beams import beam_lattice
from .frame_scorer import Observation


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
    caster : str or None
        A name of `casting.CASTERS`; None keeps the scene's.
    """

    detail: str
    stride: int = 1
    phase: int = 0
    caster: str | None = None

    @property
    def name(self) -> str:
        """A short name, for tables and pictures."""
        beams = "" if self.stride == 1 else f" 1/{self.stride}"
        return f"{self.detail}{beams}{'' if self.caster is None else f' {self.caster}'}"

    def observed(self, observation: Observation) -> Observation:
        """The same sensor, seen through this fidelity; `observation` has every beam.

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
        return replace(observation, lattice=lattice, detail=self.detail, caster=self.caster or observation.caster)
