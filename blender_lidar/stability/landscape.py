"""The objective of some mountings, frame by frame, under all the traffic and under resamples of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ..study.statistics import block_sums
from .mountings import BASELINE, CANDIDATES, REFERENCE


@dataclass(frozen=True, slots=True, eq=False)
class Landscape:
    """What mountings come to on some frames: the one in question, the baseline and candidates, in this order.

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

    @property
    def best(self) -> int:
        """Which candidate is the best; the first of equals."""
        return int(np.argmax(self.per_vehicle()[CANDIDATES:]))

    @property
    def chooses(self) -> bool:
        """Whether it prefers any mounting to another: the distance, for one, does not."""
        values = self.per_vehicle()
        return bool(np.ptp(values) > 1e-9 * np.abs(values).max())


def values_under(weights: np.ndarray, objective: np.ndarray, vehicles: np.ndarray) -> np.ndarray:
    """Objective per vehicle, (m, r), with each block of time counted `weights` (r, b) times."""
    return (objective @ weights.T) / (weights @ vehicles)


def losses_to_best(values: np.ndarray) -> np.ndarray:
    """Share of the gain that the mounting in question leaves to the best of all, for each column of `values` (m, r).

    NaN where no mounting is better than the baseline. The mounting may itself be the best: candidates are a grid.
    """
    best = np.maximum(values[CANDIDATES:].max(axis=0), values[REFERENCE])
    return _share(best - values[REFERENCE], best - values[BASELINE])


def losses_to(values: np.ndarray, candidate: int = 0) -> np.ndarray:
    """The same beside one candidate, chosen elsewhere: below 0 where the mounting in question is the better one."""
    rival = values[CANDIDATES + candidate]
    return _share(rival - values[REFERENCE], rival - values[BASELINE])


def _share(lost: np.ndarray, gain: np.ndarray) -> np.ndarray:
    return np.divide(lost, gain, out=np.full(len(gain), np.nan), where=gain > 0.0)
