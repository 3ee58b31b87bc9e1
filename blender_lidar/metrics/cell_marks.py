"""How many cells of the views' grids hold a point, for clouds of points that are marked in them (Eq. 6).

Points are not sorted: every point marks its cells in one array of bytes, in which each grid begins at a whole 64-bit
word, and eight cells at a time are then summed as one number.
"""

from __future__ import annotations

from functools import cache, partial

import numpy as np

from ..numba_here import numba_works

_take = partial(np.take, mode="clip")  # rows are in range: without that check twice as fast in NumPy 2

VIEW_AXES = ((0, 1), (0, 2), (1, 2))  # (row axis, column axis) of top, side, front in the vehicle frame
KEPT_WORDS = 1 << 19  # 4 MB: larger arrays are not kept from one cloud to the next
_CHUNK_POINTS = 1 << 15  # points whose temporaries stay in cache
_WORDS_TO_SUM = 255  # of eight bytes, each 0 or 1: the sum of so many overflows no byte


class CellMarks:
    """The cells of the three views of n boxes.

    Parameters
    ----------
    cells : ndarray of int64, (3, n)
        Cells along each side of each box.
    """

    def __init__(self, cells: np.ndarray) -> None:
        self.cells = cells
        words = -(-np.stack([cells[row] * cells[column] for row, column in VIEW_AXES]) // 8).ravel()
        start = np.cumsum(words) - words
        self.start = (8 * start).reshape(3, -1)  # cell at which each grid begins, by view and box
        self.words = int(words.sum())  # that a cloud's cells take
        parts = -(-words // _WORDS_TO_SUM)
        self._first_part = np.cumsum(parts) - parts  # of each grid
        part = np.arange(parts.sum()) - np.repeat(self._first_part, parts)
        self._part_start = np.repeat(start, parts) + _WORDS_TO_SUM * part
        self._words = np.zeros((0, self.words), dtype=np.uint64)  # made for the first cloud

    @property
    def clouds_at_a_time(self) -> int:
        """How many clouds can be marked together within the memory that is kept; 1 at least."""
        return max(KEPT_WORDS // max(self.words, 1), 1)

    def begin(self, clouds: int) -> None:
        """Empty the cells for some clouds."""
        if clouds == len(self._words):
            self._words.fill(0)
        else:
            self._words = np.zeros((clouds, self.words), dtype=np.uint64)

    def mark_points(self, points: np.ndarray, vehicle: np.ndarray, half: np.ndarray, cell_m: float) -> None:
        """Mark the cells of one cloud's points; those farther than one cell from their box are dropped.

        Parameters
        ----------
        points : ndarray, (k, 3)
            Points, each in the frame of its own vehicle [m].
        vehicle : ndarray of int64, (k,)
            Box of each.
        half : ndarray, (3, n)
            Half of the boxes' sides [m].
        cell_m : float
            Side of a cell [m].
        """
        for first in range(0, len(points), _CHUNK_POINTS):
            chunk = slice(first, first + _CHUNK_POINTS)
            self._mark(*places_kept(places_of(points[chunk], vehicle[chunk], half, cell_m), vehicle[chunk], self.cells))

    def mark_returns(
        self,
        directions: np.ndarray,
        distance: np.ndarray,
        vehicle: np.ndarray,
        cloud: np.ndarray | None,
        start: np.ndarray,
        turning: tuple[np.ndarray, np.ndarray, float],
        drops: bool,
    ) -> None:
        """Mark the cells of returns (k,): directions (3, k), distances [m], boxes and clouds, as `_mark` takes these.

        Parameters
        ----------
        start : ndarray, (3, clouds n)
            Origin of each cloud, in cells from each box's rear right lower corner.
        turning : (ndarray, ndarray, float)
            Cosine and sine of the boxes' headings, (n,) each, and the side of a cell [m].
        drops : bool
            Whether what is farther than one cell from its box is dropped; else it falls into the rim's cell.
        """
        for first in range(0, len(vehicle), _CHUNK_POINTS):
            chunk = slice(first, first + _CHUNK_POINTS)
            number = None if cloud is None else cloud[chunk]
            place = _places_of_returns(directions[:, chunk], distance[chunk], vehicle[chunk], number, start, turning)
            if drops:
                self._mark(*places_kept(place, vehicle[chunk], self.cells, number))
            else:
                self._mark(place, vehicle[chunk], number)

    def _mark(self, place: np.ndarray, vehicle: np.ndarray, cloud: np.ndarray | None = None) -> None:
        """Mark the cells that hold a point in all three views, each once however many points it holds.

        Parameters
        ----------
        place : ndarray, (3, k)
            Points, in cells from their box's rear right lower corner; what lies beside the box falls into the rim's
            cell. Written over.
        vehicle : ndarray of int64, (k,)
            Box of each.
        cloud : ndarray of int64, (k,), or None
            Cloud of each, rising; None where there is one.
        """
        cell = whole_cells(place, vehicle, self.cells)
        marks = self._words.view(bool)
        columns = {axis: _take(self.cells[axis], vehicle) for axis in (1, 2)}
        before = None if cloud is None else cloud * marks.shape[1]  # cells of the clouds before
        for view, (row, column) in enumerate(VIEW_AXES):
            flat = cell[row] * columns[column]
            flat += cell[column]
            flat += _take(self.start[view], vehicle)
            if before is not None:
                flat += before
            marks.reshape(-1)[flat] = True

    def counts(self) -> np.ndarray:
        """Marked cells of each box's views, for each cloud, (clouds, n, 3)."""
        if self.cells.shape[1] == 0:
            return np.zeros((len(self._words), 0, 3), dtype=np.int64)
        of_part = np.add.reduceat(self._words, self._part_start, axis=1).view(np.uint8)
        of_part = of_part.reshape(len(self._words), -1, 8).sum(axis=2, dtype=np.int64)
        counts = np.add.reduceat(of_part, self._first_part, axis=1).reshape(len(self._words), 3, -1)
        if self._words.size > KEPT_WORDS:
            self._words = self._words[:0].copy()
        return counts.transpose(0, 2, 1)


def places_of(points: np.ndarray, vehicle: np.ndarray, half: np.ndarray, cell_m: float) -> np.ndarray:
    """Points (k, 3) of boxes (k,) as places (3, k): in cells from the box's rear right lower corner."""
    place = np.empty((3, len(points)))
    for axis, along in enumerate(place):
        np.add(points[:, axis], _take(half[axis], vehicle), out=along)
        along /= cell_m
    return place


def _places_of_returns(directions, distance, vehicle, cloud, start, turning):
    """The same of returns; see `mark_returns`."""
    cosine, sine, cell_m = turning
    (x, y, z), cells_away = directions, distance / cell_m
    cos, sin = _take(cosine, vehicle), _take(sine, vehicle)
    place = np.empty((3, len(vehicle)))
    np.multiply(cos, x, out=place[0])
    np.multiply(cos, y, out=place[1])
    place[0] += np.multiply(sin, y, out=cos)
    place[1] -= np.multiply(sin, x, out=cos)
    place[2] = z
    in_start = vehicle if cloud is None else cloud * len(cosine) + vehicle
    for axis, along in enumerate(place):
        along *= cells_away
        along += _take(start[axis], in_start)
    return place


def places_kept(place: np.ndarray, vehicle: np.ndarray, cells: np.ndarray, cloud: np.ndarray | None = None):
    """Places (3, j), boxes (j,) and clouds (j,) or None of what lies in its box or at most one cell beyond it."""
    kept = np.ones(len(vehicle), dtype=bool)
    for axis, along in enumerate(place):
        kept &= along >= -1.0
        kept &= along < _take(cells[axis] + 1.0, vehicle)
    if kept.all():
        return place, vehicle, cloud
    return place[:, kept], vehicle[kept], None if cloud is None else cloud[kept]


def whole_cells(place: np.ndarray, vehicle: np.ndarray, cells: np.ndarray) -> np.ndarray:
    """Cells (3, k) of places (3, k), which are written over, in boxes (k,) with `cells` (3, n) along their sides."""
    for axis, along in enumerate(place):
        np.minimum(along, _take(cells[axis] - 1.0, vehicle), out=along)
        np.maximum(along, 0.0, out=along)
    return place.astype(np.int64)


@cache
def fastest_marks() -> type[CellMarks]:
    """The compiled twin where Numba is installed."""
    if not numba_works():
        return CellMarks
    from .compiled_marks import CompiledMarks

    return CompiledMarks
