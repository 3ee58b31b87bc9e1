"""Occupancy grids over a vehicle's top, side and front view: the share of cells that hold a point (Eqs. 6 to 8)."""

from __future__ import annotations

from functools import partial

import numpy as np

from ..compiled import numba_works
from ..errors import InputError, unknown_name
from ..names import DEFAULT_CELL_M, READINGS

# --- The two readings of the paper's equations: the corrected one, and the literal one for comparison -----


def check_reading(reading: str) -> None:
    """Raise `InputError` unless `reading` is one of `READINGS`."""
    if reading not in READINGS:
        raise unknown_name(reading, READINGS, "reading")


# --- The grids over a vehicle's top, side and front view ---------------------------------------------------

VIEW_NAMES = ("top", "side", "front")
VIEW_AXES = ((0, 1), (0, 2), (1, 2))  # (row axis, column axis) of top, side, front in the vehicle frame

_MOST_CELLS = 20_000  # along a side: a millimetre of a long truck; a view of more does not fit into memory
_WHOLE_CELL_TOLERANCE = 1e-9  # a box of 4.50 m is 90 cells of 0.05 m, though 4.5 / 0.05 is rounded
_CHUNK_POINTS = 1 << 15  # points whose temporaries stay in cache

_ADD_UP = np.uint64(0x0101010101010101)

_take = partial(np.take, mode="clip")  # rows are in range: without that check twice as fast in NumPy 2


def cell_counts(size: np.ndarray, cell_m: float = DEFAULT_CELL_M) -> np.ndarray:
    """Whole cells along each side of a box: Eq. 8 with `ceil`, so that no occupancy exceeds 1.

    Parameters
    ----------
    size : ndarray, (n, 3)
        Length, width and height of each box [m].
    cell_m : float
        Side of a square cell [m].

    Returns
    -------
    ndarray of int64, (n, 3)
    """
    size = np.asarray(size, dtype=float)
    if size.ndim != 2 or size.shape[1] != 3:
        raise InputError(f"size has shape {size.shape}; allowed: (n, 3)")
    if not (np.isfinite(size).all() and (size > 0).all()):
        raise InputError("size holds a side that is not a positive, finite number of metres")
    if not (np.isfinite(cell_m) and cell_m > 0):
        raise InputError(f"cell_m is {cell_m}; allowed: a positive number of metres")
    return np.maximum(np.ceil(size / cell_m - _WHOLE_CELL_TOLERANCE), 1).astype(np.int64)


class ViewGrids:
    """Occupancy grids of the three views of each of n boxes (Eqs. 6 to 8), made once for any number of clouds.

    Points are not sorted: every point marks its cells in one array, in which each grid begins at a multiple of 64
    cells. In NumPy a cell is a byte; in compiled code, which takes over where Numba is installed, it is a bit.

    Parameters
    ----------
    size : ndarray, (n, 3)
        Length, width and height of each box [m].
    cell_m : float
        Side of a square cell [m].
    reading : {"corrected", "paper"}
        What Eq. 8 divides by: the number of whole cells, or, as printed, the area of the view over that of a cell.

    Attributes
    ----------
    cells : ndarray of int64, (3, n)
        Cells along each side of each box.
    start, words : ndarray of int64, (3, n)
        Cell at which each grid begins in the array of cells, by view and box, and how many words of 64 cells it has.
    half_m : ndarray, (3, n)
        Half of the boxes' sides [m].
    cell_m : float

    Raises
    ------
    InputError
        When a side or the cell is not positive and finite, or the reading is unknown.
    """

    def __init__(self, size: np.ndarray, cell_m: float = DEFAULT_CELL_M, reading: str = "corrected") -> None:
        check_reading(reading)
        cells = cell_counts(size, cell_m)
        size = np.asarray(size, dtype=float)
        if size.size and size.max() > _MOST_CELLS * cell_m:
            most = f"at least {size.max() / _MOST_CELLS:.1g} m, for {_MOST_CELLS:,} cells along the longest side"
            raise InputError(f"cell_m is {cell_m:g}; allowed: {most}")
        self.cell_m, self.half_m = float(cell_m), np.ascontiguousarray(0.5 * size.T)
        self.cells = np.ascontiguousarray(cells.T)
        self._counts = self.cells.astype(float)
        sides = cells if reading == "corrected" else size / cell_m
        self._whole = np.stack([sides[:, row] * sides[:, column] for row, column in VIEW_AXES], axis=1)  # Eq. 8
        grids = np.stack([self.cells[row] * self.cells[column] for row, column in VIEW_AXES])
        self.words = -(-grids // 64)
        self.start = 64 * (np.cumsum(self.words) - self.words.ravel()).reshape(3, -1)

    def __len__(self) -> int:
        return len(self._whole)

    def occupancy(self, points: np.ndarray, vehicle: np.ndarray) -> np.ndarray:
        """P of the top, side and front view of each box (Eqs. 6 to 8), (n, 3).

        Parameters
        ----------
        points : ndarray, (k, 3)
            Points, each in the frame of its own vehicle [m]; finite, which is not checked here. On the rim, or up to
            one cell beyond it, they fall into the rim's cell; further ones are dropped.
        vehicle : ndarray of int64, (k,)
            The box that each point belongs to; in range, which is not checked here either.
        """
        if numba_works():
            from .compiled_marks import count_cells, mark_points

            counts, bits = np.zeros((len(self), 3), dtype=np.int64), self.no_bits(1)[0]
            mark_points(points, vehicle, self.half_m, self.cell_m, self.cells, self.start, bits)
            count_cells(bits, self.start, self.words, counts)
            return self.shares(counts)
        marks = np.zeros(64 * int(self.words.sum()), dtype=np.uint8)
        for first in range(0, len(points), _CHUNK_POINTS):
            chunk = slice(first, first + _CHUNK_POINTS)
            cell, count, kept = self._cells_of(points[chunk], vehicle[chunk])
            start = _take(self.start, kept, axis=1)
            for view, (row, column) in enumerate(VIEW_AXES):
                marks[(cell[row] * count[column] + cell[column]).astype(np.int64) + start[view]] = 1
        eight = (marks.view(np.uint64) * _ADD_UP) >> np.uint64(56)  # marks of eight cells, added up in the top byte
        marked = np.add.reduceat(eight, self.start.ravel() // 8) if len(self) else np.zeros(0)
        return self.shares(marked.reshape(3, -1).T)

    def shares(self, counts: np.ndarray) -> np.ndarray:
        """P of views (Eq. 7) from the marked cells of each box's views, both (..., n, 3)."""
        return counts / self._whole

    def cells_of(self, points: np.ndarray, vehicle: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Cell of each point along each axis, (3, j), and its vehicle, (j,), without the points that are dropped."""
        cell, _, vehicle = self._cells_of(points, vehicle)
        return cell.astype(np.int64), vehicle

    def _cells_of(self, points, vehicle):
        """The same, whole numbers as floats; with the cells along the sides of the boxes, (3, j)."""
        cell = points.T + _take(self.half_m, vehicle, axis=1)
        cell /= self.cell_m  # from the box's rear right lower corner
        count = _take(self._counts, vehicle, axis=1)
        kept = ((cell >= -1.0) & (cell < count + 1.0)).all(axis=0)
        if not kept.all():
            cell, count, vehicle = cell[:, kept], count[:, kept], vehicle[kept]
        np.minimum(cell, count - 1.0, out=cell)  # beyond the rim the rim's
        np.maximum(cell, 0.0, out=cell)
        return np.floor(cell, out=cell), count, vehicle

    def no_bits(self, clouds: int) -> np.ndarray:
        """For compiled code a bit for each cell of each cloud, none of them set: uint64, (clouds, words)."""
        return np.zeros((clouds, int(self.words.sum())), dtype=np.uint64)
