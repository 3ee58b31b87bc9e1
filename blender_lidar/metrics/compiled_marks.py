"""The same as `cell_marks`, compiled: one pass over the points, and a cell counts when it is marked for the first time.

Marks are numbers. Those of a cloud differ from those of the clouds before, so that cells need not be emptied between.
"""

from __future__ import annotations

import numpy as np

from ..compiled import compiled, inlined
from .cell_marks import KEPT_WORDS, CellMarks

_MOST_MARKS = 255  # of a byte; then all cells are emptied


class CompiledMarks(CellMarks):
    """The cells of the three views of n boxes."""

    def __init__(self, cells: np.ndarray) -> None:
        super().__init__(np.ascontiguousarray(cells))
        self._marks = np.zeros(0, dtype=np.uint8)
        self._last_mark, self._hit = 0, np.zeros((0, cells.shape[1], 3), dtype=np.int64)

    @property
    def clouds_at_a_time(self) -> int:
        return _MOST_MARKS

    def begin(self, clouds: int) -> None:
        self.take_marks(clouds)
        self._hit = np.zeros((clouds, self.cells.shape[1], 3), dtype=np.int64)

    def take_marks(self, clouds: int) -> tuple[np.ndarray, int]:
        """The marks of all cells, and the first of so many numbers that none of them has."""
        if len(self._marks) != 8 * self.words or self._last_mark + clouds > _MOST_MARKS:
            kind = np.uint8 if clouds <= _MOST_MARKS else np.uint64
            self._marks, self._last_mark = np.zeros(8 * self.words, dtype=kind), 0
        self._first_mark = self._last_mark + 1
        self._last_mark += clouds
        return self._marks, self._first_mark

    def mark_points(self, points: np.ndarray, vehicle: np.ndarray, half: np.ndarray, cell_m: float) -> None:
        where = self.cells, self.start, self._marks, self._first_mark, self._hit
        _mark_points(points, vehicle, half, float(cell_m), *where)

    def mark_returns(self, directions, distance, vehicle, cloud, start, turning, drops) -> None:
        cloud = np.zeros(len(vehicle), dtype=np.int64) if cloud is None else cloud
        where = self.cells, self.start, self._marks, self._first_mark, self._hit
        _mark_returns(directions, distance, vehicle, cloud, start, *turning, drops, *where)

    def counts(self) -> np.ndarray:
        self.release()
        return self._hit

    def release(self) -> None:
        """Give back the memory of cells that are too many to be kept."""
        if self.words > KEPT_WORDS:
            self._marks = self._marks[:0].copy()


@compiled
def _mark_points(points, vehicle, half, cell_m, cells, start, marks, mark, hit):
    for k in range(len(vehicle)):
        row = vehicle[k]
        x, y = (points[k, 0] + half[0, row]) / cell_m, (points[k, 1] + half[1, row]) / cell_m
        z = (points[k, 2] + half[2, row]) / cell_m
        if not _at_the_box(x, y, z, cells[0, row], cells[1, row], cells[2, row]):
            continue
        for view, cell in _cells(x, y, z, cells[0, row], cells[1, row], cells[2, row]):
            at = start[view, row] + cell
            if marks[at] != mark:
                marks[at] = mark
                hit[0, row, view] += 1


@compiled
def _mark_returns(
    directions, distance, vehicle, cloud, origin, cosine, sine, cell_m, drops, cells, start, marks, first_mark, hit
):
    for k in range(len(vehicle)):
        row, mark = vehicle[k], first_mark + cloud[k]
        at_origin, away = cloud[k] * len(cosine) + row, distance[k] / cell_m
        x = (cosine[row] * directions[0, k] + sine[row] * directions[1, k]) * away + origin[0, at_origin]
        y = (cosine[row] * directions[1, k] - sine[row] * directions[0, k]) * away + origin[1, at_origin]
        z = directions[2, k] * away + origin[2, at_origin]
        if drops and not _at_the_box(x, y, z, cells[0, row], cells[1, row], cells[2, row]):
            continue
        for view, cell in _cells(x, y, z, cells[0, row], cells[1, row], cells[2, row]):
            at = start[view, row] + cell
            if marks[at] != mark:
                marks[at] = mark
                hit[cloud[k], row, view] += 1


@compiled
def mark_places(place, vehicle, cells, start, marks, mark, hit):
    """Count in `hit` (n, 3) the cells that places (3, k) of boxes (k,) are the first to mark."""
    for k in range(len(vehicle)):
        row = vehicle[k]
        x, y, z = place[0, k], place[1, k], place[2, k]
        for view, cell in _cells(x, y, z, cells[0, row], cells[1, row], cells[2, row]):
            at = start[view, row] + cell
            if marks[at] != mark:
                marks[at] = mark
                hit[row, view] += 1


@inlined
def _at_the_box(x, y, z, length, width, height):
    """Whether a place lies in its box, of so many cells, or at most one cell beyond it."""
    return -1.0 <= x < length + 1.0 and -1.0 <= y < width + 1.0 and -1.0 <= z < height + 1.0


@inlined
def _cells(x, y, z, length, width, height):
    """The three views, and the cell of each that a place falls into."""
    along, across, up = _whole(x, length), _whole(y, width), _whole(z, height)
    return (0, along * width + across), (1, along * height + up), (2, across * height + up)


@inlined
def _whole(place, count):
    """The cell that a place belongs to; beyond the rim the rim's."""
    return int(max(min(place, count - 1.0), 0.0))
