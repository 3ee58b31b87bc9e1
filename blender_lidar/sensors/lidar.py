"""A LiDAR without a place: its beams, its range gate, and how imperfect it is."""

from __future__ import annotations

import zlib
from dataclasses import dataclass

from ..names import THE_LIDAR
from .beams import BeamLattice
from .imperfections import PERFECT, Imperfections, MeasurementModel


@dataclass(frozen=True, slots=True)
class Lidar:
    """A LiDAR wherever it hangs: beams, range gate and imperfections.

    Attributes
    ----------
    lattice : BeamLattice
        Its beams.
    max_range_m, min_range_m : float
        The range gate: returns from farther or nearer are lost [m].
    imperfections : Imperfections
        Range noise and lost returns; none unless said.
    name : str
        What tells it from the others of a layout. Its draws depend on it and not on its neighbours.
    """

    lattice: BeamLattice
    max_range_m: float
    min_range_m: float = 0.0
    imperfections: Imperfections = PERFECT
    name: str = THE_LIDAR

    @property
    def key(self) -> tuple[int, ...]:
        """What of the keys of random draws is its own: CRC-32 of its name; nothing where a scene's one has no other."""
        return () if self.name == THE_LIDAR else (zlib.crc32(self.name.encode()),)

    @property
    def reach_m(self) -> float:
        """How far beams are followed [m]: beyond the range gate, as noise carries returns across it."""
        return self.max_range_m + self.imperfections.most_noise_m

    def measurement(self, frame: int) -> MeasurementModel:
        """What the beams of one frame draw, and so measure of what they meet."""
        ends = self.min_range_m, self.max_range_m
        model = self.imperfections.measurement(self.lattice, frame, *ends, self.key)
        return model if (outside := self.lattice.outside) is None else model.without(outside)
