"""Cells of occupancy grids marked by points, compiled: the kernel behind `ViewGrids` and the compiled frame scorer."""

from __future__ import annotations

from ..compiled import compiled, inlined


@compiled
def mark_points(points, vehicle, half_m, cell_m, cells, start, marks, mark, hit):
    """Count in `hit` (n, 3) the cells that points are the first to mark (Eq. 6), as `ViewGrids` does it in NumPy.

    Points (k, 3) in the frames of their vehicles (k,) [m]; those more than a cell beyond their box are dropped.
    `half_m`, `cells` and `start` are those of `ViewGrids`, `marks` a byte for each cell, `mark` this cloud's number.
    """
    for k in range(len(vehicle)):
        row = vehicle[k]
        length, width, height = cells[0, row], cells[1, row], cells[2, row]
        x, y = (points[k, 0] + half_m[0, row]) / cell_m, (points[k, 1] + half_m[1, row]) / cell_m
        z = (points[k, 2] + half_m[2, row]) / cell_m
        if not (-1.0 <= x < length + 1.0 and -1.0 <= y < width + 1.0 and -1.0 <= z < height + 1.0):
            continue
        along, across, up = _whole(x, length), _whole(y, width), _whole(z, height)
        views = (0, along * width + across), (1, along * height + up), (2, across * height + up)
        for view, cell in views:
            at = start[view, row] + cell
            hit[row, view] += marks[at] != mark  # without a branch, which nobody could predict
            marks[at] = mark


@inlined
def _whole(place, count):
    """The cell that a place belongs to; beyond the rim the rim's."""
    return int(max(min(place, count - 1.0), 0.0))
