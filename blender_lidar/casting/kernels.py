"""Compiled kernels of casting: rays and planes, culling, and a tree of boxes that rays go through, all in float64."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ..compiled import compiled, inlined
from .exact import ExactSearch
from .protocol import MISS, PlaneHits, Returns, TrianglePlanes

# --- Rays and triangles' planes: the arithmetic that rasterising, the tree and measuring share ------------------------
# A triangle is a row of `TrianglePlanes.as_rows`: three linear functions of a place, of its plane and of two corners'
# weights, four numbers each, and how far rounding moves its edges.

ROUNDING = 128.0 * float(np.finfo(float).eps)
EDGE = 1e-11  # barycentric: so near an edge rounding decides, or how a caster takes it
NEARER = 1e-6  # relative: how much nearer than it seems a thing may be that rounding decides
TOUCH = 1e-12  # relative: what starts so near a plane may be on either side of it
_BESIDE = 1e-3  # barycentric: of a triangle that is touched


@inlined
def signed_distance(planes, t, function, place):
    """What a place signed_distance to the zero of one of a triangle's three functions."""
    k = 4 * function
    return planes[t, k + 3] - (planes[t, k] * place[0] + planes[t, k + 1] * place[1] + planes[t, k + 2] * place[2])


@inlined
def is_within(planes, t, place):
    """Whether a place on a triangle's plane lies within the triangle, or hardly beside it."""
    b, c = -signed_distance(planes, t, 1, place), -signed_distance(planes, t, 2, place)
    return min(1.0 - b - c, b, c) >= -_BESIDE


@inlined
def size_of(planes, t, function, place):
    """Sum of the sizes of what `signed_distance` adds up, of which rounding takes its share."""
    k = 4 * function
    size = abs(planes[t, k] * place[0]) + abs(planes[t, k + 1] * place[1]) + abs(planes[t, k + 2] * place[2])
    return abs(planes[t, k + 3]) + size


@inlined
def measured(planes, t, origin, x, y, z):
    """Distance along a ray to a triangle's plane, as `TrianglePlanes.meet` has it."""
    return signed_distance(planes, t, 0, origin) / (planes[t, 0] * x + planes[t, 1] * y + planes[t, 2] * z)


@inlined
def is_inside(planes, t, origin, x, y, z, distance):
    """Whether a ray meets a triangle itself, at a distance from the origin, as `TrianglePlanes.meet` has it."""
    second = (planes[t, 4] * x + planes[t, 5] * y + planes[t, 6] * z) * distance - signed_distance(planes, t, 1, origin)
    third = (planes[t, 8] * x + planes[t, 9] * y + planes[t, 10] * z) * distance - signed_distance(planes, t, 2, origin)
    return distance >= 0.0 and second >= 0.0 and third >= 0.0 and second + third <= 1.0


@inlined
def to_world(x, y, z, rotation):
    """A direction from the sensor frame in the frame of the triangles, as `Pose.to_world` adds it up."""
    return (
        rotation[0, 0] * x + rotation[1, 0] * y + rotation[2, 0] * z,
        rotation[0, 1] * x + rotation[1, 1] * y + rotation[2, 1] * z,
        rotation[0, 2] * x + rotation[1, 2] * y + rotation[2, 2] * z,
    )


@inlined
def is_behind(planes, t, other, origin, x, y, z):
    """Whether a triangle is met after another, or with it and has the higher row."""
    distance, its = measured(planes, t, origin, x, y, z), measured(planes, other, origin, x, y, z)
    return distance > its or (distance == its and t > other)


class CompiledPlanes(TrianglePlanes):
    """The planes of triangles."""

    def __init__(self, corners: np.ndarray, normal: np.ndarray) -> None:
        super().__init__(corners, normal)
        self._rows = super().as_rows()

    def as_rows(self) -> np.ndarray:
        return self._rows

    def meet(self, origins: np.ndarray, directions: np.ndarray, triangle: np.ndarray) -> PlaneHits:
        shared = origins.ndim == 1
        starts = origins[:, None] if shared else origins
        return PlaneHits(*_meet(self._rows, starts, shared, directions, triangle))


@compiled
def _meet(planes, origins, shared, directions, triangle):
    rays = len(triangle)
    distance, facing, inside = np.empty(rays), np.empty(rays), np.empty(rays, dtype=np.bool_)
    for k in range(rays):
        t, start = triangle[k], 0 if shared else k
        origin = origins[0, start], origins[1, start], origins[2, start]
        x, y, z = directions[0, k], directions[1, k], directions[2, k]
        facing[k] = planes[t, 0] * x + planes[t, 1] * y + planes[t, 2] * z
        distance[k] = measured(planes, t, origin, x, y, z)
        inside[k] = is_inside(planes, t, origin, x, y, z, distance[k])
    return distance, facing, inside


# --- The same as `culling.reachable_beams`: piece by piece, without arrays in between ---------------------------------

_TURN = 2.0 * math.pi


@compiled
def beams_within(
    corners, middle, radius, origin, rotation, max_range, sine, azimuth0, step, columns, margin, least_cosine
):
    """Flat indices of the beams that may meet a piece, rising; a row of the mask for each ring.

    `corners` (3, 8, p), `middle` (3, p) and `radius` (p,) are those of `Pieces`, `sine` (rings,) is the elevations'.
    """
    mask = np.zeros((len(sine), columns), dtype=np.bool_)
    first_azimuth, last_azimuth = azimuth0.min(), azimuth0.max()
    for piece in range(len(radius)):
        x, y, z = middle[0, piece] - origin[0], middle[1, piece] - origin[1], middle[2, piece] - origin[2]
        if not math.sqrt(x * x + y * y + z * z) - radius[piece] <= max_range:
            continue
        low, high, first, last = _bounds(corners, piece, origin, rotation, least_cosine)
        ring_from, ring_to = np.searchsorted(sine, low - margin), np.searchsorted(sine, high + margin, side="right")
        slot_from = math.ceil((first - margin - last_azimuth) / step)
        slot_to = math.floor((last + margin - first_azimuth) / step) + 1
        if slot_to - slot_from >= columns:
            slot_from, slot_to = 0, columns
        turns = slot_from // columns * columns
        slot_from, slot_to = slot_from - turns, slot_to - turns
        for ring in range(ring_from, ring_to):
            mask[ring, slot_from : min(slot_to, columns)] = True
            if slot_to > columns:  # across azimuth zero
                mask[ring, : slot_to - columns] = True
    return np.flatnonzero(mask)


@inlined
def _bounds(corners, piece, origin, rotation, least_cosine):
    """As `culling._angular_bounds`, for one piece."""
    place = np.empty((8, 3))
    across = ahead = above = 0.0
    for k in range(8):
        x, y, z = corners[0, k, piece] - origin[0], corners[1, k, piece] - origin[1], corners[2, k, piece] - origin[2]
        for axis in range(3):
            place[k, axis] = rotation[axis, 0] * x + rotation[axis, 1] * y + rotation[axis, 2] * z
        across, ahead, above = across + place[k, 0], ahead + place[k, 1], above + place[k, 2]
    length = math.sqrt(across * across + ahead * ahead + above * above)
    low, high, cosine, first, last = np.inf, -np.inf, np.inf, np.inf, -np.inf
    for k in range(8):
        x, y, z = place[k, 0], place[k, 1], place[k, 2]
        distance = math.sqrt(x * x + y * y + z * z)
        if distance == 0.0 or length == 0.0:  # at a corner, or in the very middle
            return -1.0, 1.0, 0.0, _TURN
        low, high = min(low, z / distance), max(high, z / distance)
        cosine = min(cosine, (x * across + y * ahead + z * above) / distance / length)
        off_centre = math.atan2(x * ahead - y * across, x * across + y * ahead)
        first, last = min(first, off_centre), max(last, off_centre)
    if not cosine > least_cosine:  # about the sensor
        return -1.0, 1.0, 0.0, _TURN
    low, high = low / cosine if low < 0.0 else low, high / cosine if high > 0.0 else high
    if not last - first < math.pi or (across == 0.0 and ahead == 0.0):  # about its axis
        return low, high, 0.0, _TURN
    centre = math.atan2(across, ahead)
    return low, high, first + centre, last + centre


@compiled
def directions_of(components, beams, rotation, into):
    """Directions (k, 3) of beams in the road frame, added up as `Pose.to_world` does, in float64 or float32."""
    for k in range(len(beams)):
        x, y, z = components[0, beams[k]], components[1, beams[k]], components[2, beams[k]]
        into[k, 0], into[k, 1], into[k, 2] = to_world(x, y, z, rotation)


# --- Any rays against many triangles: a tree of boxes in float64 ------------------------------------------------------
# Triangles are sorted along a curve that fills space (Morton 1966) and halved again and again, so that the tree needs
# no links: the two halves of box i are the boxes 2 i and 2 i + 1.

_LEAF = 4  # triangles
_BITS = 10  # of the curve, along each axis
_SLACK = 1e-12  # relative: boxes are larger by that
_LOOSE = 1e-9  # relative: and are entered so much sooner and left so much later, even where they are flat


class BoxTree(NamedTuple):
    """The tree as compiled code takes it; without any triangle `order` is empty."""

    low: np.ndarray
    high: np.ndarray
    order: np.ndarray
    planes: np.ndarray


NO_BOXES = BoxTree(np.empty((0, 3)), np.empty((0, 3)), np.empty(0, dtype=np.int64), np.empty((0, 13)))


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

    @property
    def boxes(self) -> BoxTree:
        """The tree for `hidden`."""
        return BoxTree(self._low, self._high, self._order, self._planes)

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


@compiled
def hidden(origin, directions, distance, tree):
    """Occlusion test (any hit): whether something lies nearer than a distance along rays, (n,) int8; 2 is undecided.

    Rays start at `origin` (3,) [m]; `directions` (n, 3) are of unit length, and `distance` is (n,) [m].
    """
    found = np.zeros(len(distance), dtype=np.int8)
    low, high, order, planes = tree.low, tree.high, tree.order, tree.planes
    leaves, stack = len(low) // 2, np.empty(64, dtype=np.int64)
    ox, oy, oz = origin[0], origin[1], origin[2]
    for ray in range(len(distance)):
        dx, dy, dz, reach = directions[ray, 0], directions[ray, 1], directions[ray, 2], distance[ray]
        per_x, per_y, per_z = _reciprocal(dx), _reciprocal(dy), _reciprocal(dz)
        stack[0], height = 1, 1
        while height:
            height -= 1
            node = stack[height]
            if not _entry(low[node], high[node], ox, oy, oz, per_x, per_y, per_z) <= reach:
                continue
            if node < leaves:
                stack[height], stack[height + 1] = 2 * node, 2 * node + 1
                height += 2
                continue
            for place in range((node - leaves) * _LEAF, min((node - leaves + 1) * _LEAF, len(order))):
                away, certain = _meeting(planes, order[place], origin, dx, dy, dz)
                if certain and away < reach * (1.0 - NEARER):
                    found[ray], height = 1, 0
                    break
                if away * (1.0 - NEARER) <= reach:
                    found[ray] = 2
    return found


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
    missing = signed_distance(planes, t, 0, origin)
    sign, away = (1.0 if missing > 0.0 else -1.0), abs(missing)
    facing = sign * (planes[t, 0] * x + planes[t, 1] * y + planes[t, 2] * z)
    b = away * (planes[t, 4] * x + planes[t, 5] * y + planes[t, 6] * z) - signed_distance(planes, t, 1, origin) * facing
    c = (
        away * (planes[t, 8] * x + planes[t, 9] * y + planes[t, 10] * z)
        - signed_distance(planes, t, 2, origin) * facing
    )
    a = facing - b - c
    far = size_of(planes, t, 0, origin)
    if away <= TOUCH * far and is_within(planes, t, origin):
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
