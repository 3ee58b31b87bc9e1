"""Coverage of surfaces: which cubes of a grid (voxels) that surfaces pass through hold a return."""

from __future__ import annotations

import numpy as np

from ..errors import InputError

_PER_CELL = 8  # samples of a surface along the edge of a cell
_MOST_SAMPLES = 5_000_000
_AT_A_TIME = 1 << 16  # samples
_BITS = 21  # of a cell's number along an axis
_FIRST = 0.01  # of an edge below 0 the grid begins: where round numbers lie rounding may not tell sides of a border


def surface_cells(corners: np.ndarray, edge_m: float) -> np.ndarray:
    """The cells that triangles pass through, but for corners of cells that are cut by less than an eighth of an edge.

    They are of an edge `edge_m` and the triangles (m, 3, 3) [m]; a number for each cell, (k,) int64, rising.

    Raises
    ------
    InputError
        For an edge that is not above 0, or so short that there are too many cells.
    """
    if not edge_m > 0.0:
        raise InputError(f"cells of an edge of {edge_m:g} m; allowed: above 0 m")
    sides = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1, initial=0.0)
    steps = np.maximum(np.ceil(sides * _PER_CELL / edge_m), 1.0)
    if (0.5 * (steps + 1.0) * (steps + 2.0)).sum() > _MOST_SAMPLES:
        raise InputError(f"cells of an edge of {edge_m:g} m are too many for such surfaces; allowed: a longer edge")
    found = [np.empty(0, np.int64)]
    for count in np.unique(steps).astype(int).tolist():
        rows = max(_AT_A_TIME // (count + 1), 1)
        for first in range(0, count + 1, rows):
            i, j = np.mgrid[first : min(first + rows, count + 1), : count + 1 - first].reshape(2, -1)
            weights = np.stack([i, j, count - i - j], axis=1)[i + j <= count] / count
            found += [np.unique(_numbers(weights @ triangle, edge_m)) for triangle in corners[steps == count]]
    return np.unique(np.concatenate(found))


def cells_with_points(cells: np.ndarray, points: np.ndarray, edge_m: float) -> np.ndarray:
    """Which of some cells (k,), as from `surface_cells`, hold a point of `points` (n, 3) [m], (k,) bool."""
    return np.isin(cells, _numbers(points, edge_m))


def _numbers(points, edge_m):
    """Number of the cell of each point."""
    x, y, z = np.moveaxis(np.floor(points / edge_m + _FIRST).astype(np.int64) + (1 << (_BITS - 1)), -1, 0)
    return (x << 2 * _BITS) | (y << _BITS) | z
