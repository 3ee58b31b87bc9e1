"""The rising curve that fits points best."""

from __future__ import annotations

import numpy as np


def isotonic_fit(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Least squares among all curves that never fall: pool adjacent violators (Barlow and others, 1972).

    Parameters
    ----------
    x, y : ndarray, (n,)
        At least one observation; those of one x are averaged first.

    Returns
    -------
    knots, values : ndarray, (k,)
        Rising x, and the values there; between them the curve is straight, beyond them level.
    """
    knots, row = np.unique(x, return_inverse=True)
    weight = np.bincount(row).astype(float)
    mean = np.bincount(row, weights=y) / weight
    blocks: list[list[float]] = []  # mean, weight, number of knots
    for value, count in zip(mean.tolist(), weight.tolist(), strict=True):
        blocks.append([value, count, 1])
        while len(blocks) > 1 and blocks[-2][0] >= blocks[-1][0]:
            last, before = blocks.pop(), blocks.pop()
            total = last[1] + before[1]
            blocks.append([(last[0] * last[1] + before[0] * before[1]) / total, total, last[2] + before[2]])
    values = np.repeat([block[0] for block in blocks], [int(block[2]) for block in blocks])
    return knots, values


def predict(fit: tuple[np.ndarray, np.ndarray], x: np.ndarray) -> np.ndarray:
    """Values of a fitted curve, (n,)."""
    return np.interp(x, *fit)
