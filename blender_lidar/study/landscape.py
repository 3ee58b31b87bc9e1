"""The objective of some mountings, frame by frame."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from .statistics import block_sums


@dataclass(frozen=True, slots=True, eq=False)
class Landscape:
    """What mountings come to on some frames.

    Attributes
    ----------
    objective : ndarray, (m, f)
        Sum over the counted vehicles of each frame, in the metric's unit.
    vehicles : ndarray of int64, (f,)
        Vehicles that count.
    """

    objective: np.ndarray
    vehicles: np.ndarray

    @classmethod
    def from_dict(cls, stored: Mapping) -> Landscape:
        """What `as_dict` gave."""
        return cls(np.array(stored["objective"], dtype=float), np.array(stored["vehicles"], dtype=np.int64))

    def as_dict(self) -> dict:
        """As JSON holds it."""
        return {"objective": self.objective.tolist(), "vehicles": self.vehicles.tolist()}

    def per_vehicle(self) -> np.ndarray:
        """Objective per counted vehicle of each mounting, (m,)."""
        return self.objective.sum(axis=1) / self.vehicles.sum()

    def select(self, rows: list[int]) -> Landscape:
        """Some of its mountings."""
        return Landscape(self.objective[rows], self.vehicles)

    def beside(self, other: Landscape) -> Landscape:
        """The same mountings on its own frames and then on another's."""
        return Landscape(
            np.concatenate([self.objective, other.objective], axis=1), np.concatenate([self.vehicles, other.vehicles])
        )

    def blocks(self, block: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Objective (m, b) and vehicles (b,) of each block of time; `block` (f,) labels the frames."""
        return block_sums(self.objective, block), block_sums(self.vehicles, block)
