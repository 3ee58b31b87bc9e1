"""Places for poles about a junction: off the lanes, nearest to its middle on each corner, island and median."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from .approaches import point_of_compass
from .road_map import RoadMap

_CELL_M = 0.5
_CLEAR_M = 1.5  # from a pole to where vehicles drive
_FARTHEST_M = 25.0  # beyond the radius about the middle
_APART_M = 6.0  # between two poles: slivers of one island count once
_WIDE_M = 4.0  # from the middle of a median to its edges, at most
_MOST_POLES = 12
_ROUND_DIGITS = 1


class PolePlace(NamedTuple):
    """A place where a pole may stand: a name such as ``corner_north_east``, and its foot in the site frame [m]."""

    name: str
    x_m: float
    y_m: float


def propose_poles(road: RoadMap, middle_xy: tuple[float, float], radius_m: float) -> list[PolePlace]:
    """One pole on each piece of ground between the roads, where it comes nearest to a place.

    Parameters
    ----------
    road : RoadMap
        Footways are ground; junctions are not.
    middle_xy : (float, float)
        What the poles look at [m, site frame].
    radius_m : float
        Of what they look at about it [m]; poles stand at most 25 m beyond.

    Returns
    -------
    list of PolePlace
        The nearest first, at most 12, 1.5 m or more off where vehicles drive and 6 m apart; empty where there is
        no such ground.
    """
    reach = radius_m + _FARTHEST_M
    steps = np.arange(-math.ceil(reach / _CELL_M), math.ceil(reach / _CELL_M) + 1) * _CELL_M
    x, y = np.meshgrid(middle_xy[0] + steps, middle_xy[1] + steps)
    xy = np.stack([x.ravel(), y.ravel()], axis=1)
    open_ground = ~road.driven.on(xy).reshape(x.shape)
    off_m = _distance_to(~open_ground)
    stands = off_m >= _CLEAR_M
    away = np.hypot(x - middle_xy[0], y - middle_xy[1])
    piece = _connected(stands)
    found = []
    for number in range(1, int(piece.max()) + 1):
        of_piece = piece == number
        at = np.flatnonzero(of_piece.ravel())[away[of_piece].argmin()]
        if away.ravel()[at] <= reach:
            found.append((float(away.ravel()[at]), xy[at], float(off_m[of_piece].max()) <= _WIDE_M))
    kept = []
    for one in sorted(found, key=lambda one: one[0]):
        if all(math.dist(one[1], other[1]) >= _APART_M for other in kept):
            kept.append(one)
    return _named(kept[:_MOST_POLES], middle_xy)


def _named(found: list[tuple[float, np.ndarray, bool]], middle_xy: tuple[float, float]) -> list[PolePlace]:
    """Places with names of their own: what each stands on, where from the middle, and a number from the second on."""
    poles, taken = [], {}
    for _, (x, y), narrow in found:
        where = point_of_compass(math.atan2(y - middle_xy[1], x - middle_xy[0])).replace("-", "_")
        name = f"{'median' if narrow else 'corner'}_{where}"
        taken[name] = taken.get(name, 0) + 1
        name = name if taken[name] == 1 else f"{name}_{taken[name]}"
        poles.append(PolePlace(name, round(float(x), _ROUND_DIGITS), round(float(y), _ROUND_DIGITS)))
    return poles


def _distance_to(marked: np.ndarray) -> np.ndarray:
    """Distance transform: of each cell (ny, nx) from the nearest marked one [m], as far as `_WIDE_M` and a cell."""
    most = math.ceil(_WIDE_M / _CELL_M) + 1
    rows, columns = marked.shape
    padded = np.pad(marked, most)
    distance = np.full(marked.shape, np.inf)
    for up in range(-most, most + 1):
        for right in range(-most, most + 1):
            seen = padded[most + up : most + up + rows, most + right : most + right + columns]
            distance[seen] = np.minimum(distance[seen], _CELL_M * math.hypot(up, right))
    return distance


def _connected(marked: np.ndarray) -> np.ndarray:
    """Connected components of marked cells (ny, nx), by edges: numbers from 1; 0 where nothing is marked."""
    label = np.where(marked, np.arange(1, marked.size + 1).reshape(marked.shape), 0)
    while True:
        before = label.copy()
        for axis in (0, 1):
            for flip in (False, True):
                turned = np.moveaxis(label, axis, 0)
                turned = turned[::-1] if flip else turned
                for row in range(1, len(turned)):  # the larger number runs along the rows
                    one = turned[row]
                    np.maximum(one, turned[row - 1], out=one, where=one > 0)
        if (label == before).all():
            return (
                np.unique(label, return_inverse=True)[1].reshape(label.shape) if (label == 0).any() else label * 0 + 1
            )
