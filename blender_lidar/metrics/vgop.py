"""PE-VGOP: perception entropy from a vehicle's grid occupancy (Eqs. 4 to 9 of He, Cao, Su and Liu).

Equations are numbered as in the paper's source: 1 beams, 2 and 2a to 2c pose and tilt, 3 points, 4 and 5 vehicle frame,
6 to 9 the metric, 10 and 11 the objective, 12 to 15 the search.

A vehicle's points are projected onto its top, side and front view; each view is divided into square cells; the share of
cells that hold a point is the occupancy P of that view, and the vehicle scores the sum of -P log2 P over the three.

All functions take every vehicle of a frame (or of many frames) at once, and none sorts the points.
"""

from __future__ import annotations

import numpy as np

from ..errors import InputError
from .readings import check_reading

VIEWS = ("top", "side", "front")
DEFAULT_CELL_M = 0.05

_VIEW_AXES = ((0, 1), (0, 2), (1, 2))  # (row axis, column axis) of top, side, front in the vehicle frame
_MAX_LATTICE_CELLS = 1 << 26  # cells held in memory at a time: 256 MB of int32
_CHUNK_POINTS = 1 << 15  # points whose temporaries stay in cache
_WHOLE_CELL_TOLERANCE = 1e-9  # a box of 4.50 m is 90 cells of 0.05 m, whatever the rounding of 4.5 / 0.05


def to_vehicle_frame(
    points: np.ndarray, centre: np.ndarray, heading: np.ndarray | float, vehicle: np.ndarray | None = None
) -> np.ndarray:
    """Points in the frame of their vehicle: x forward, y left, z up, origin at the box centre (Eqs. 4 and 5).

    Parameters
    ----------
    points : ndarray, (k, 3)
        Points in a levelled frame, e.g. the road frame [m].
    centre : ndarray, (3,), (k, 3) or, with `vehicle`, (n, 3)
        Box centre in the same frame: one for all points, one for each, or one for each vehicle [m].
    heading : float or ndarray, (k,) or, with `vehicle`, (n,)
        Heading, counter-clockwise from +x [rad].
    vehicle : ndarray of int, (k,), optional
        Row of `centre` and `heading` that each point belongs to.

    Returns
    -------
    ndarray, (k, 3)
        Points in the vehicle frame [m].
    """
    points, centre, heading = (
        _triples(points, "points"),
        np.asarray(centre, dtype=float),
        np.asarray(heading, dtype=float),
    )
    if vehicle is not None:
        centre = _triples(centre, "centre")
        if heading.shape != centre.shape[:1]:
            raise InputError(f"heading has shape {heading.shape}; allowed: {centre.shape[:1]}, one for each vehicle")
        vehicle = _rows(vehicle, len(points), len(centre))
    elif centre.shape not in ((3,), points.shape):
        raise InputError(f"centre has shape {centre.shape}; allowed: (3,) or {points.shape}, as many as points")
    elif heading.shape not in ((), points.shape[:1]):
        raise InputError(f"heading has shape {heading.shape}; allowed: a number or {points.shape[:1]}")
    cos, sin = np.cos(heading), np.sin(heading)
    columns = [cos, sin, *np.moveaxis(centre, -1, 0)]
    if vehicle is not None:
        columns = [np.take(column, vehicle) for column in columns]
    cos, sin, cx, cy, cz = columns
    dx, dy = points[:, 0] - cx, points[:, 1] - cy
    local = np.empty_like(points)
    local[:, 0] = cos * dx + sin * dy  # rows times Eq. 5: a turn by -heading
    local[:, 1] = cos * dy - sin * dx
    local[:, 2] = points[:, 2] - cz
    return local


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
    size = _triples(size, "size")
    if not (np.isfinite(size).all() and (size > 0).all()):
        raise InputError("size holds a side that is not a positive, finite number of metres")
    if not (np.isfinite(cell_m) and cell_m > 0):
        raise InputError(f"cell_m is {cell_m}; allowed: a positive number of metres")
    return np.maximum(np.ceil(size / cell_m - _WHOLE_CELL_TOLERANCE), 1).astype(np.int64)


def occupancy(
    points: np.ndarray,
    vehicle: np.ndarray,
    size: np.ndarray,
    cell_m: float = DEFAULT_CELL_M,
    reading: str = "corrected",
) -> np.ndarray:
    """Share of occupied cells of each vehicle's top, side and front view (Eqs. 6 to 8).

    Points on the rim, or up to one cell beyond it, fall into the rim's cell; further ones are dropped.

    Parameters
    ----------
    points : ndarray, (k, 3)
        Points, each in the frame of its own vehicle [m]: see `to_vehicle_frame`.
    vehicle : ndarray of int, (k,)
        Row of `size` that each point belongs to.
    size : ndarray, (n, 3)
        Length, width and height of each vehicle's box [m].
    cell_m : float
        Side of a square cell [m].
    reading : {"corrected", "paper"}
        ``"corrected"`` divides by the number of whole cells; ``"paper"`` by Eq. 8 as printed, the area of the view over
        that of a cell, so that P can exceed 1.

    Returns
    -------
    ndarray, (n, 3)
        P of the top, side and front view, each in [0, 1] as corrected.

    Raises
    ------
    InputError
        When shapes disagree, a row is out of range, a side is not positive or a point is not finite.
    """
    points, size = _triples(points, "points"), _triples(size, "size")
    cells = cell_counts(size, cell_m)
    vehicle = _rows(vehicle, len(points), len(size))
    if not np.isfinite(points).all():
        raise InputError("points holds a coordinate that is not finite")
    check_reading(reading)
    sides = cells if reading == "corrected" else size / cell_m
    return _occupied_cells(points, vehicle, size, cells, cell_m) / (
        sides[:, [0, 0, 1]] * sides[:, [1, 2, 2]]
    )  # Eqs. 7, 8


def entropy(p: np.ndarray) -> np.ndarray:
    """-p log2 p of each occupancy, 0 where p is 0: one summand of Eq. 9 [bits], in the shape of `p`.

    Below 0 for the p above 1 that only the literal reading of Eq. 8 gives.
    """
    p = np.asarray(p, dtype=float)
    if not ((p >= 0) & (p < np.inf)).all():
        raise InputError("an occupancy is negative or not finite; allowed: 0 or more")
    return p * np.log2(1.0 / np.where(p > 0, p, 1.0))  # Eq. 9


def pe_vgop(
    points: np.ndarray,
    vehicle: np.ndarray,
    size: np.ndarray,
    cell_m: float = DEFAULT_CELL_M,
    reading: str = "corrected",
) -> np.ndarray:
    """PE-VGOP of each vehicle (Eq. 9) [bits], (n,); parameters as in `occupancy`."""
    return entropy(occupancy(points, vehicle, size, cell_m, reading)).sum(axis=1)


def occupancy_views(points: np.ndarray, size: np.ndarray, cell_m: float = DEFAULT_CELL_M) -> dict[str, np.ndarray]:
    """The three occupancy grids of one vehicle, to be drawn (the paper's Fig. 4).

    Parameters
    ----------
    points : ndarray, (k, 3)
        The vehicle's points in its own frame [m].
    size : ndarray, (3,)
        Length, width and height of its box [m].

    Returns
    -------
    dict of str to ndarray of bool
        ``top`` (length cells, width cells), ``side`` (length, height) and ``front`` (width, height).
    """
    points, size = _triples(points, "points"), np.asarray(size, dtype=float).reshape(1, 3)
    cells = cell_counts(size, cell_m)
    index, _, kept = _cell_index(points, np.zeros(len(points), dtype=np.int64), size, cells, cell_m)
    index = index[:, kept].astype(np.int64)
    views = {}
    for name, (row, column) in zip(VIEWS, _VIEW_AXES, strict=True):
        views[name] = np.zeros((cells[0, row], cells[0, column]), dtype=bool)
        views[name][index[row], index[column]] = True
    return views


def _cell_index(points, vehicle, size, cells, cell_m):
    """Cell of every point along each axis, (3, k) whole floats, pulled back to the rim, and which are kept, (k,).

    With them the last cell of each point's vehicle along each axis, (3, k) floats too.
    """
    index, last = np.empty((2, 3, len(points)))
    kept = np.ones(len(points), dtype=bool)
    for axis, (cell, end) in enumerate(zip(index, last, strict=True)):
        np.add(points[:, axis], np.take(0.5 * size[:, axis], vehicle), out=cell)
        cell /= cell_m
        np.floor(cell, out=cell)
        np.take(cells[:, axis] - 1.0, vehicle, out=end)
        kept &= cell >= -1.0
        kept &= cell <= end + 1.0
        np.minimum(cell, end, out=cell)
        np.maximum(cell, 0.0, out=cell)
    return index, last, kept


def _occupied_cells(points, vehicle, size, cells, cell_m):
    """How many cells of each vehicle's top, side and front view hold a point, (n, 3).

    Vehicles are taken in groups whose lattices fit the memory that is set aside; there is one group but for huge input.
    """
    ends = np.cumsum(cells[:, 0] * cells[:, 1] + cells[:, 0] * cells[:, 2] + cells[:, 1] * cells[:, 2])
    if len(ends) == 0 or ends[-1] <= _MAX_LATTICE_CELLS:
        return _distinct_cells(points, vehicle, size, cells, cell_m)
    counts = np.zeros((len(ends), 3), dtype=np.int64)
    first = 0
    while first < len(ends):
        before = ends[first - 1] if first else 0
        last = max(int(np.searchsorted(ends, before + _MAX_LATTICE_CELLS, side="right")), first + 1)
        mine = (vehicle >= first) & (vehicle < last)
        group = slice(first, last)
        counts[group] = _distinct_cells(points[mine], vehicle[mine] - first, size[group], cells[group], cell_m)
        first = last
    return counts


def _distinct_cells(points, vehicle, size, cells, cell_m):
    """`_occupied_cells` of one group, without sorting the points or clearing a lattice.

    Every point writes its own number into its cells of an uninitialised lattice; of the points that share a cell, the
    one whose number is read back stands for the cell.
    """
    vehicles = len(size)
    view_cells = np.stack([cells[:, row] * cells[:, column] for row, column in _VIEW_AXES])
    ends = np.cumsum(view_cells.ravel())
    starts = ends.reshape(3, vehicles) - view_cells
    flat = np.empty((3, len(points)), dtype=np.int64)
    kept = np.empty(len(points), dtype=bool)
    for start in range(0, len(points), _CHUNK_POINTS):
        chunk = slice(start, start + _CHUNK_POINTS)
        owner = vehicle[chunk]
        index, last, kept[chunk] = _cell_index(points[chunk], owner, size, cells, cell_m)
        for view, (row, column) in enumerate(_VIEW_AXES):
            cell = index[row] * (last[column] + 1.0)  # floats hold these numbers exactly
            cell += index[column]
            np.add(np.take(starts[view], owner), cell, out=flat[view, chunk], casting="unsafe")
    if not kept.all():
        flat, vehicle = flat[:, kept], vehicle[kept]
    lattice = np.empty(ends[-1] if vehicles else 0, dtype=np.int32)
    number = np.arange(flat.size, dtype=np.int32).reshape(flat.shape)
    lattice[flat] = number
    stands = np.take(lattice, flat) == number  # Eq. 6, each occupied cell once
    return np.stack([np.bincount(vehicle[stands[view]], minlength=vehicles) for view in range(3)], axis=1)


def _triples(values, name):
    values = np.asarray(values, dtype=float)
    if values.ndim != 2 or values.shape[1] != 3:
        raise InputError(f"{name} has shape {values.shape}; allowed: (n, 3)")
    return values


def _rows(vehicle, points, vehicles):
    vehicle = np.asarray(vehicle)
    if vehicle.shape != (points,):
        raise InputError(f"vehicle has shape {vehicle.shape}; allowed: ({points},), one row for each point")
    if len(vehicle) and not np.issubdtype(vehicle.dtype, np.integer):
        raise InputError(f"vehicle holds {vehicle.dtype} values; allowed: whole rows of size")
    if len(vehicle) and (vehicle.min() < 0 or vehicle.max() >= vehicles):
        raise InputError(f"vehicle names rows {vehicle.min()} to {vehicle.max()}; allowed: 0 to {vehicles - 1}")
    return vehicle.astype(np.int64, copy=False)
