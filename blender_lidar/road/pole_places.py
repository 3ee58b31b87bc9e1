"""Places for poles about a junction: off the lanes, at the noses of corners, islands and medians."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from .approaches import point_of_compass
from .road_map import RoadMap

_CELL_M = 0.5
_CLEAR_M = 1.5  # from a pole to where vehicles drive
_CLEAR_OF_TRACKS_M = 3.0  # where no map tells how wide the lanes are
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


def propose_poles(
    road: RoadMap, middle_xy: tuple[float, float], radius_m: float, wide: str = "corner"
) -> list[PolePlace]:
    """A pole wherever the ground between the roads comes nearest to a place: local minima of the distance.

    Parameters
    ----------
    road : RoadMap
        Footways are ground; junctions are not.
    middle_xy : (float, float)
        What the poles look at [m, site frame].
    radius_m : float
        Of what they look at about it [m]; poles stand at most 25 m beyond.
    wide : str
        What ground is called that is no island or median.

    Returns
    -------
    list of PolePlace
        The nearest first, at most 12, 6 m apart, 1.5 m or more off the lanes, 3 m off tracks alone; empty where
        there is no such ground.
    """
    reach = radius_m + _FARTHEST_M
    clear_m = _CLEAR_M if road.lanes else _CLEAR_OF_TRACKS_M
    steps = np.arange(-math.ceil(reach / _CELL_M), math.ceil(reach / _CELL_M) + 1) * _CELL_M
    x, y = np.meshgrid(middle_xy[0] + steps, middle_xy[1] + steps)
    xy = np.stack([x.ravel(), y.ravel()], axis=1)
    off_m = _distance_to(road.driven.on(xy).reshape(x.shape))
    away = np.hypot(x - middle_xy[0], y - middle_xy[1])
    piece = _connected((off_m >= clear_m) & (away <= reach))
    found = []
    for number in range(1, int(piece.max()) + 1):
        of_piece = piece == number
        narrow = float(off_m[of_piece].max()) <= _WIDE_M
        for at in np.flatnonzero(_least_about(np.where(of_piece, away, np.inf)) & of_piece):
            found.append((float(away.ravel()[at]), xy[at], narrow))
    kept = []
    for one in sorted(found, key=lambda one: one[0]):
        if all(math.dist(one[1], other[1]) >= _APART_M for other in kept):
            kept.append(one)
    return _named(kept[:_MOST_POLES], middle_xy, wide)


def _least_about(values: np.ndarray) -> np.ndarray:
    """Which cells (ny, nx) hold the least value of those within `_APART_M` along both axes."""
    size, least = round(_APART_M / _CELL_M), values
    for axis in (0, 1):
        padded = np.pad(least, [(size, size) if one == axis else (0, 0) for one in (0, 1)], constant_values=np.inf)
        least = np.lib.stride_tricks.sliding_window_view(padded, 2 * size + 1, axis=axis).min(axis=-1)
    return values == least


def _named(found: list[tuple[float, np.ndarray, bool]], middle_xy: tuple[float, float], wide: str) -> list[PolePlace]:
    """Places with names of their own: what each stands on, where from the middle, and a number from the second on."""
    poles, taken = [], {}
    for _, (x, y), narrow in found:
        where = point_of_compass(math.atan2(y - middle_xy[1], x - middle_xy[0])).replace("-", "_")
        name = f"{'median' if narrow else wide}_{where}"
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
    before = None
    while before is None or (label != before).any():
        before = label.copy()
        for view in (label, label[::-1], label.T, label.T[::-1]):
            for last, row in pairwise(view):  # the larger number runs along the rows
                np.maximum(row, last, out=row, where=row > 0)
    names = np.unique(label[marked])
    return np.where(marked, np.searchsorted(names, label) + 1, 0)
