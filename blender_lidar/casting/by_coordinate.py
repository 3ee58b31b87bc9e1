"""Many triangles, coordinate after coordinate in memory: NumPy is slow over axes of three."""

from __future__ import annotations

import numpy as np


def by_coordinate(corners: np.ndarray) -> np.ndarray:
    """Corners (m, 3, 3) as (corner, axis, triangle)."""
    return np.ascontiguousarray(corners.reshape(-1, 9).T).reshape(3, 3, -1)


def cross(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Cross products of vectors (3, m)."""
    x, y, z = first
    u, v, w = second
    return np.stack([y * w - z * v, z * u - x * w, x * v - y * u])


def dot(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Sums of three products along the first axis, always added up in the same order."""
    return first[0] * second[0] + first[1] * second[1] + first[2] * second[2]


def length(vectors: np.ndarray) -> np.ndarray:
    """Lengths of vectors (3, ...)."""
    return np.sqrt(dot(vectors, vectors))
