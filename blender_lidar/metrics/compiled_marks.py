"""The same as `cell_marks`, compiled: one pass over the points, and a cell counts when it is marked for the first time.

Marks are numbers. Those of a cloud differ from those of the clouds before, so that cells need not be emptied between.
"""

from __future__ import annotations

import numpy as np

from ..compiled import compiled
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

    def mark(self, place: np.ndarray, vehicle: np.ndarray, cloud: np.ndarray | None = None) -> None:
        cloud = np.zeros(len(vehicle), dtype=np.int64) if cloud is None else cloud
        mark_clouds(place, vehicle, cloud, self.cells, self.start, self._marks, self._first_mark, self._hit)

    def counts(self) -> np.ndarray:
        if self.words > KEPT_WORDS:
            self._marks = self._marks[:0].copy()
        return self._hit


@compiled
def mark_clouds(place, vehicle, cloud, cells, start, marks, first_mark, hit):
    """Count in `hit` (clouds, n, 3) the cells that places (3, k) of boxes and clouds (k,) are the first to mark."""
    for k in range(len(vehicle)):
        row, mark = vehicle[k], first_mark + cloud[k]
        length, width, height = cells[0, row], cells[1, row], cells[2, row]
        along, across, up = _whole(place[0, k], length), _whole(place[1, k], width), _whole(place[2, k], height)
        for view, cell in ((0, along * width + across), (1, along * height + up), (2, across * height + up)):
            at = start[view, row] + cell
            if marks[at] != mark:
                marks[at] = mark
                hit[cloud[k], row, view] += 1


@compiled
def _whole(place, count):
    """The cell that a place belongs to; beyond the rim the rim's."""
    return int(max(min(place, count - 1.0), 0.0))
