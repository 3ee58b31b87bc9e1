"""Surfaces that rays start so near to that float32 cannot tell on which side."""

from __future__ import annotations

import numpy as np

_AT_A_TIME = 1 << 20  # pairs of a start and a triangle


class Touching:
    """The triangles that starts of rays in a region may touch.

    Parameters
    ----------
    corners : ndarray, (m, 3, 3)
        Corners of each triangle [m].
    normal : ndarray, (m, 3)
        Unit normals.
    gap : ndarray, (m,)
        How near a start has to be to touch each of them [m].
    low, high : ndarray, (3,)
        Corners of the region [m].
    """

    def __init__(
        self, corners: np.ndarray, normal: np.ndarray, gap: np.ndarray, low: np.ndarray, high: np.ndarray
    ) -> None:
        lower, upper = corners.min(axis=1) - gap[:, None], corners.max(axis=1) + gap[:, None]
        near = np.flatnonzero(((lower <= high) & (upper >= low)).all(axis=1))
        self._lower, self._upper, self._gap = lower[near], upper[near], gap[near]
        self._normal, self._offset = normal[near], np.einsum("ti,ti->t", normal[near], corners[near, 0])

    def any(self, low: np.ndarray, high: np.ndarray) -> bool:
        """Whether starts between two corners (3,) [m] may touch one at all; for a single start rather sure."""
        near = ((self._lower <= high) & (self._upper >= low)).all(axis=1)
        return bool(near.any()) and (low is not high or bool(self._of(low[None])[0]))

    def of(self, origins: np.ndarray) -> np.ndarray:
        """Which starts (n, 3) [m] touch one, (n,) bool."""
        step = max(_AT_A_TIME // max(len(self._gap), 1), 1)
        parts = [self._of(origins[start : start + step]) for start in range(0, len(origins), step)]
        return np.concatenate([np.zeros(0, dtype=bool), *parts])

    def _of(self, origins):
        boxed = ((self._lower <= origins[:, None]) & (self._upper >= origins[:, None])).all(axis=2)
        return (boxed & (np.abs(origins @ self._normal.T - self._offset) <= self._gap)).any(axis=1)
