"""PE-VGOP: perception entropy from a vehicle's grid occupancy (Eqs. 4 to 9 of He, Cao, Su and Liu).

Equations are numbered as in the paper's source: 1 beams, 2 and 2a to 2c pose and tilt, 3 points, 4 and 5 vehicle frame,
6 to 9 the metric, 10 and 11 the objective, 12 to 15 the search.

A vehicle's points are projected onto its top, side and front view; each view is divided into square cells; the share of
cells that hold a point is the occupancy P of that view, and the vehicle scores the sum of -P log2 P over the three.

All functions take every vehicle of a frame (or of many frames) at once, and none sorts the points: see `view_grids`.
"""

from __future__ import annotations

import numpy as np

from ..errors import InputError
from ..names import DEFAULT_CELL_M
from .view_grids import ViewGrids


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
    points = _triples(points, "points")
    centre, heading = np.asarray(centre, dtype=float), np.asarray(heading, dtype=float)
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
        columns = [np.take(column, vehicle, mode="clip") for column in columns]  # twice as fast, and in range
    cos, sin, cx, cy, cz = columns
    dx, dy = points[:, 0] - cx, points[:, 1] - cy
    local = np.empty((3, len(points))).T
    local[:, 0] = cos * dx + sin * dy  # rows times Eq. 5: a turn by -heading
    local[:, 1] = cos * dy - sin * dx
    local[:, 2] = points[:, 2] - cz
    return local


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
    vehicle = _rows(vehicle, len(points), len(size))
    if not np.isfinite(points).all():
        raise InputError("points holds a coordinate that is not finite")
    return ViewGrids(size, cell_m, reading).occupancy(points, vehicle)


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
