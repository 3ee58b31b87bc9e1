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
        # As Python's numbers, which compare faster than arrays of three.
        self._low = self._lower.min(axis=0, initial=np.inf).tolist()
        self._high = self._upper.max(axis=0, initial=-np.inf).tolist()
        self._normal, self._offset = normal[near], np.einsum("ti,ti->t", normal[near], corners[near, 0])

    def any(self, low: np.ndarray, high: np.ndarray) -> bool:
        """Whether any start between two corners (3,) [m], which may be one and the same array, may touch one."""
        ends = zip(low.tolist(), high.tolist(), self._low, self._high, strict=True)
        if any(b < lower or a > upper for a, b, lower, upper in ends):  # as at most roadsides, and soon told
            return False
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
