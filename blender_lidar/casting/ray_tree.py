"""Any rays against many triangles, compiled: a tree of boxes in float64.

Triangles are sorted along a curve that fills space (Morton 1966) and halved again and again, so that the tree needs no
links: the two halves of box i are the boxes 2 i and 2 i + 1.
"""

from __future__ import annotations

import numpy as np

from ..compiled import compiled, inlined
from .compiled_rays import EDGE, NEARER, ROUNDING, TOUCH, lacks, measured, size_of, touches
from .exact import ExactSearch
from .protocol import MISS, Returns

_LEAF = 4  # triangles
_BITS = 10  # of the curve, along each axis
_SLACK = 1e-12  # relative: boxes are larger by that
_LOOSE = 1e-9  # relative: and are entered so much sooner and left so much later, even where they are flat


class RayTree:
    """A fixed set of triangles.

    Parameters
    ----------
    corners : ndarray, (m, 3, 3)
        Corners of each triangle [m]; at least one.
    planes : ndarray, (m, 13)
        As `TrianglePlanes.as_rows` gives them.
    exact : ExactSearch
        Of the same triangles: it decides where rounding would.
    """

    def __init__(self, corners: np.ndarray, planes: np.ndarray, exact: ExactSearch) -> None:
        self._planes, self._exact = planes, exact
        low, high = corners.min(axis=1), corners.max(axis=1)
        self._order = np.argsort(_along_curve(low + high), kind="stable")
        slack = _SLACK * np.abs(corners).max()
        leaves = 1 << max(int(np.ceil(np.log2(len(corners) / _LEAF))), 0)
        self._low, self._high = np.full((2 * leaves, 3), np.inf), np.full((2 * leaves, 3), -np.inf)
        starts = np.arange(0, len(corners), _LEAF)
        used = slice(leaves, leaves + len(starts))
        self._low[used] = np.minimum.reduceat(low[self._order], starts) - slack
        self._high[used] = np.maximum.reduceat(high[self._order], starts) + slack
        while leaves > 1:
            halves = slice(leaves, 2 * leaves)
            leaves //= 2
            self._low[leaves : 2 * leaves] = self._low[halves].reshape(-1, 2, 3).min(axis=1)
            self._high[leaves : 2 * leaves] = self._high[halves].reshape(-1, 2, 3).max(axis=1)

    def meet(self, origins: np.ndarray, directions: np.ndarray, max_range: float) -> Returns:
        """What rays meet first, up to `max_range` [m]; `origins` (3,) or (n, 3) [m], unit `directions` (n, 3)."""
        origins = np.ascontiguousarray(np.broadcast_to(origins, directions.shape))
        directions = np.ascontiguousarray(directions)
        triangle, distance, open_ = _first_hits(
            origins, directions, float(max_range), self._low, self._high, self._order, self._planes
        )
        if len(open_):
            triangle[open_] = MISS
            found = self._exact.meet(origins[open_], directions[open_], max_range)
            triangle[open_[found.ray]], distance[open_[found.ray]] = found.triangle, found.distance
        ray = np.flatnonzero(triangle != MISS)
        return Returns(ray, triangle[ray], distance[ray])


def _along_curve(places: np.ndarray) -> np.ndarray:
    """Where places (n, 3) come along the curve, (n,)."""
    low, span = places.min(axis=0), np.ptp(places, axis=0)
    cell = ((places - low) / np.where(span > 0.0, span, 1.0) * ((1 << _BITS) - 1)).astype(np.int64)
    code = np.zeros(len(places), dtype=np.int64)
    for bit in range(_BITS):
        for axis in range(3):
            code |= (cell[:, axis] >> bit & 1) << (3 * bit + axis)
    return code


@compiled
def _first_hits(origins, directions, reach, low, high, order, planes):
    """Triangle (n,) or `MISS` and distance (n,) of each ray's first hit, and the rays that rounding decides."""
    rays, leaves = len(directions), len(low) // 2
    triangle, distance = np.full(rays, MISS), np.full(rays, np.inf)
    undecided, left = np.empty(rays, dtype=np.int64), 0
    stack, entered = np.empty(64, dtype=np.int64), np.empty(64)
    for ray in range(rays):
        origin, direction = origins[ray], directions[ray]
        ox, oy, oz, dx, dy, dz = origin[0], origin[1], origin[2], direction[0], direction[1], direction[2]
        per_x, per_y, per_z = _reciprocal(dx), _reciprocal(dy), _reciprocal(dz)
        nearest, doubted, first, height = np.inf, np.inf, MISS, 0
        if _entry(low[1], high[1], ox, oy, oz, per_x, per_y, per_z) <= reach:
            stack[0], entered[0], height = 1, 0.0, 1
        while height:
            height -= 1
            node = stack[height]
            if entered[height] > nearest:
                continue
            if node < leaves:
                one, other = 2 * node, 2 * node + 1
                at_one = _entry(low[one], high[one], ox, oy, oz, per_x, per_y, per_z)
                at_other = _entry(low[other], high[other], ox, oy, oz, per_x, per_y, per_z)
                if at_one < at_other:
                    one, other, at_one, at_other = other, one, at_other, at_one
                limit = min(nearest, reach)
                if at_one <= limit:
                    stack[height], entered[height] = one, at_one
                    height += 1
                if at_other <= limit:
                    stack[height], entered[height] = other, at_other
                    height += 1
                continue
            for place in range((node - leaves) * _LEAF, min((node - leaves + 1) * _LEAF, len(order))):
                t = order[place]
                away, certain = _meeting(planes, t, origin, dx, dy, dz)
                if away == np.inf:
                    continue
                if not certain:
                    doubted = min(doubted, away * (1.0 - NEARER))
                elif away < nearest or (away == nearest and t < first):
                    nearest, first = away, t
        if doubted <= min(nearest, reach):
            undecided[left] = ray
            left += 1
        elif nearest <= reach:
            triangle[ray] = first
            distance[ray] = measured(planes, first, origin, dx, dy, dz)
            if distance[ray] > reach:
                triangle[ray] = MISS
    return triangle, distance, undecided[:left]


@inlined
def _reciprocal(number):
    return 1.0 / number if abs(number) > 1e-300 else 1e300


@inlined
def _entry(low, high, x, y, z, per_x, per_y, per_z):
    """Where a ray enters a box, inf where it misses it."""
    if low[0] > high[0]:  # an empty one
        return np.inf
    a, b = (low[0] - x) * per_x, (high[0] - x) * per_x
    c, d = (low[1] - y) * per_y, (high[1] - y) * per_y
    e, f = (low[2] - z) * per_z, (high[2] - z) * per_z
    enters, leaves = max(min(a, b), min(c, d), min(e, f), 0.0), min(max(a, b), max(c, d), max(e, f))
    enters *= 1.0 - _LOOSE
    return enters if enters <= leaves * (1.0 + _LOOSE) else np.inf


@inlined
def _meeting(planes, t, origin, x, y, z):
    """Distance at which a ray meets a triangle, inf where it does not, and whether that is certain.

    The weights of the corners where it meets the plane, times the cosine `facing`, are all above 0 within.
    """
    missing = lacks(planes, t, 0, origin)
    sign, away = (1.0 if missing > 0.0 else -1.0), abs(missing)
    facing = sign * (planes[t, 0] * x + planes[t, 1] * y + planes[t, 2] * z)
    b = away * (planes[t, 4] * x + planes[t, 5] * y + planes[t, 6] * z) - lacks(planes, t, 1, origin) * facing
    c = away * (planes[t, 8] * x + planes[t, 9] * y + planes[t, 10] * z) - lacks(planes, t, 2, origin) * facing
    a = facing - b - c
    far = size_of(planes, t, 0, origin)
    if away <= TOUCH * far and touches(planes, t, origin):
        return 0.0, False
    slope_b = abs(planes[t, 4]) + abs(planes[t, 5]) + abs(planes[t, 6])
    slope_c = abs(planes[t, 8]) + abs(planes[t, 9]) + abs(planes[t, 10])
    rounding = max(far * slope_b + size_of(planes, t, 1, origin), far * slope_c + size_of(planes, t, 2, origin))
    doubt = ROUNDING * rounding + (EDGE + planes[t, 12]) * max(facing, 0.0)
    if a < -doubt or b < -doubt or c < -doubt:
        return np.inf, True
    if a < doubt or b < doubt or c < doubt:
        return away / facing if facing > 4.0 * doubt else 0.0, False
    return away / facing, True
