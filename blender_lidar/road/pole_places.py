"""Places for poles about a junction: off the lanes, at the noses of corners, islands and medians."""

from __future__ import annotations

import math
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
    from scipy import ndimage

    reach = radius_m + _FARTHEST_M
    clear_m = _CLEAR_M if road.lanes else _CLEAR_OF_TRACKS_M
    steps = np.arange(-math.ceil(reach / _CELL_M), math.ceil(reach / _CELL_M) + 1) * _CELL_M
    x, y = np.meshgrid(middle_xy[0] + steps, middle_xy[1] + steps)
    xy = np.stack([x.ravel(), y.ravel()], axis=1)
    driven = road.driven.on(xy).reshape(x.shape)
    off_m = _CELL_M * ndimage.distance_transform_edt(~driven) if driven.any() else np.full(x.shape, np.inf)
    away = np.hypot(x - middle_xy[0], y - middle_xy[1])
    piece, pieces = ndimage.label((off_m >= clear_m) & (away <= reach))
    found = []
    for number in range(1, pieces + 1):
        of_piece = piece == number
        narrow = float(off_m[of_piece].max()) <= _WIDE_M
        distance = np.where(of_piece, away, np.inf)
        least = ndimage.minimum_filter(distance, 2 * round(_APART_M / _CELL_M) + 1, mode="constant", cval=np.inf)
        for at in np.flatnonzero(of_piece & (distance == least)):
            found.append((float(away.ravel()[at]), xy[at], narrow))
    kept = []
    for one in sorted(found, key=lambda one: one[0]):
        if all(math.dist(one[1], other[1]) >= _APART_M for other in kept):
            kept.append(one)
    return _named(kept[:_MOST_POLES], middle_xy, wide)


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
