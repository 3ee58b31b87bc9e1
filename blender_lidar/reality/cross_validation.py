"""How well a curve fitted to some frames foretells others."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

FOLDS = 10

Foretell = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""Fits to the observations of a mask, (n,), and foretells those of another."""


def folds_of(cluster: np.ndarray, rng: np.random.Generator, folds: int = FOLDS) -> np.ndarray:
    """A fold for each observation, (n,), from 0 on: whole clusters, dealt out at random in even numbers.

    There are as many folds as clusters where these are fewer.
    """
    clusters = int(cluster.max()) + 1
    dealt = np.empty(clusters, dtype=np.int64)
    dealt[rng.permutation(clusters)] = np.arange(clusters) % folds
    return dealt[cluster]


def share_foretold(values: np.ndarray, fold: np.ndarray, foretell: Foretell, weights: np.ndarray) -> np.ndarray:
    """Share of the variance that is foretold, each fold from the others, in each resample, (r,).

    1 less the squared errors over those of the others' mean; below 0 where that mean foretells better. Curves are
    fitted once, to the observations themselves: resamples, `weights` (r, n), draw from their errors.
    """
    error, of_mean = np.zeros((2, len(values)))
    for number in range(int(fold.max()) + 1):
        told = fold == number
        error[told] = values[told] - foretell(~told, told)
        of_mean[told] = values[told] - values[~told].mean()
    worst = weights @ of_mean**2
    return 1.0 - np.divide(weights @ error**2, worst, out=np.full(len(weights), np.nan), where=worst > 0.0)
