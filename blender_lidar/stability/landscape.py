"""What the study of stability asks of the objective of mountings: the one in question, the baseline, candidates."""

from __future__ import annotations

import numpy as np

from ..study.landscape import Landscape
from .mountings import BASELINE, CANDIDATES, REFERENCE


def best_candidate(landscape: Landscape) -> int:
    """Which candidate is the best; the first of equals."""
    return int(np.argmax(landscape.per_vehicle()[CANDIDATES:]))


def chooses(landscape: Landscape) -> bool:
    """Whether it prefers any mounting to another: the distance, for one, does not."""
    values = landscape.per_vehicle()
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
