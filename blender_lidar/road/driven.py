"""Driven area: the road where no map is known, as the footprints of the recorded vehicles on a grid."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .road_map import Flat, RoadMap

_CELL_M = 0.25
_MOST_CELLS = 40_000_000


@dataclass(frozen=True, slots=True, eq=False)
class DrivenArea(RoadMap):
    """A road without lanes: the cells of a grid that lie under a vehicle at some time.

    Attributes
    ----------
    corner_m : (float, float)
        Where the first cell begins [m].
    cells : ndarray of bool, (ny, nx)
        Which cells are driven on; `_CELL_M` wide.
    """

    corner_m: tuple[float, float] = (0.0, 0.0)
    cells: np.ndarray = None

    def on(self, xy: np.ndarray) -> np.ndarray:
        """Which places (n, 2) [m] lie where vehicles drive, (n,) bool."""
        column, row = np.floor((np.asarray(xy, dtype=float)[:, :2] - self.corner_m) / _CELL_M).astype(int).T
        rows, columns = self.cells.shape
        inside = (row >= 0) & (row < rows) & (column >= 0) & (column < columns)
        return inside & self.cells[row.clip(0, rows - 1), column.clip(0, columns - 1)]

    def within(self, xy: np.ndarray) -> np.ndarray:
        """Which places (n, 2) [m] lie where vehicles drive, (n,) bool."""
        return self.on(xy)

    def nearest(self, xy: Sequence[float]) -> np.ndarray:
        """The nearest driven place, (1, 2) [m]."""
        row, column = np.nonzero(self.cells)
        middles = self.corner_m + (np.stack([column, row], axis=1) + 0.5) * _CELL_M
        return middles[[np.hypot(*(middles - xy).T).argmin()]]

    def clearance(self, xy: Sequence[float]) -> tuple[float, str]:
        """How far a place lies from where vehicles drive [m], below 0 on it; no side of traffic is known."""
        away = float(np.hypot(*(self.nearest(xy)[0] - xy))) - 0.5 * _CELL_M
        return (-0.5 * _CELL_M if self.on(np.array([xy]))[0] else max(away, 0.0)), ""

    def edges_across(self, xy: Sequence[float]) -> tuple[np.ndarray, np.ndarray]:
        """The nearest places on both sides, along x, where nobody drives, (2,) each [m]."""
        found = []
        for side in (-1.0, 1.0):
            steps = np.array(xy) + np.arange(1, self.cells.shape[1] + 2)[:, None] * (side * _CELL_M, 0.0)
            found.append(steps[np.argmin(self.on(steps))])
        return found[0], found[1]

    def area(self, lanes: Sequence[int] | None = None, s_m: tuple[float, float] | None = None) -> list[np.ndarray]:
        """Rectangles that cover the area, (4, 2) each [m]: runs of cells along x, joined where rows are alike."""
        edges = np.diff(np.pad(self.cells, ((0, 1), (1, 1))).astype(np.int8), axis=1)
        open_runs, found = {}, []
        for row, marks in enumerate(edges):
            runs = set(zip(np.flatnonzero(marks > 0).tolist(), np.flatnonzero(marks < 0).tolist(), strict=True))
            for run in [one for one in open_runs if one not in runs]:
                (left, right), first = run, open_runs.pop(run)
                corners = np.array([(left, first), (right, first), (right, row), (left, row)])
                found.append(self.corner_m + corners * _CELL_M)
            for run in runs:
                open_runs.setdefault(run, row)
        return found


def driven_area(centre_m: np.ndarray, size_m: np.ndarray, heading_rad: np.ndarray) -> DrivenArea | None:
    """Rasterise footprints on a grid of 0.25 m; None where the grid would be larger than 2.5 square kilometres.

    Parameters
    ----------
    centre_m, size_m : ndarray, (n, 2) or more
        Box centres, and lengths and widths [m].
    heading_rad : ndarray, (n,)
        Counter-clockwise from +x.
    """
    half = 0.5 * np.asarray(size_m)[:, :2]
    reach = float(np.hypot(*half.T).max()) + _CELL_M
    corner = np.floor((centre_m[:, :2].min(axis=0) - reach) / _CELL_M) * _CELL_M
    columns, rows = np.ceil((centre_m[:, :2].max(axis=0) + reach - corner) / _CELL_M).astype(int)
    if rows * columns > _MOST_CELLS:
        return None
    cells = np.zeros((rows, columns), dtype=bool)
    along = np.stack([np.cos(heading_rad), np.sin(heading_rad)], axis=1)
    left = np.stack([-along[:, 1], along[:, 0]], axis=1)
    # Places in each footprint at most two thirds of a cell apart: a cell that a footprint holds whole has one of them.
    steps = [np.linspace(-1.0, 1.0, max(2, int(np.ceil(3.0 * one / _CELL_M)) + 1)) for one in half.max(axis=0)]
    u, v = (grid.ravel() for grid in np.meshgrid(*steps))
    size = max(1, _MOST_CELLS // (20 * len(u)))
    for first in range(0, len(half), size):
        part = slice(first, first + size)
        ahead = (u * half[part, :1])[..., None] * along[part, None]
        aside = (v * half[part, 1:])[..., None] * left[part, None]
        place = centre_m[part, None, :2] + ahead + aside
        column, row = np.floor((place.reshape(-1, 2) - corner) / _CELL_M).astype(int).T
        cells[row, column] = True
    none = np.zeros(0)
    return DrivenArea((), none, none, none, none.astype(bool), Flat(), corner_m=tuple(corner.tolist()), cells=cells)
