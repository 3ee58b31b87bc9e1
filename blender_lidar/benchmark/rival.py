"""What others cast rays with: the same beams against the same triangles, and what came of it, to be checked."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from .case import FrameCase
from .timing import Entry

GROUP = "rivals"
RAW, RAW_SURVIVORS = "raw Embree, all beams", "raw Embree, the survivors"
NAIVE, NAIVE_SURVIVORS = "BVHTree.ray_cast, naive loop, all beams", "BVHTree.ray_cast, naive loop, the survivors"
SPARSE = 47  # of what is slow every so many beams are cast: a prime, so that all azimuths have their turn


@dataclass(frozen=True, slots=True, eq=False)
class Rival:
    """Another way to cast a frame's beams.

    Attributes
    ----------
    name : str
        What it is.
    cast : callable
        Casts them once.
    distance : callable
        Distance along each of its rays [m], (k,), inf where it met nothing within the gate, from what `cast` returns.
    beams : ndarray, (k,)
        Flat indices of the beams that it casts.
    scale : float
        How many beams one of them stands for.
    """

    name: str
    cast: Callable[[], object]
    distance: Callable[[object], np.ndarray]
    beams: np.ndarray
    scale: float = 1.0

    @property
    def entry(self) -> Entry:
        """To be timed."""
        note = f"{len(self.beams):,} beams timed, x {self.scale:.1f}" if self.scale != 1.0 else ""
        return Entry(self.name, self.cast, GROUP, self.scale, note)


def all_beams(case: FrameCase) -> np.ndarray:
    """Flat indices of every beam."""
    return np.arange(len(case.directions))


def some_beams(case: FrameCase) -> tuple[np.ndarray, float]:
    """Flat indices of a part of the beams, for what is slow, and how many each stands for."""
    beams = all_beams(case)[::SPARSE]
    return beams, len(case.directions) / len(beams)
