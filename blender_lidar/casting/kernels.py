"""Compiled kernels of casting: rays and planes, and a tree of boxes that rays go through, all in float64."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..compiled import compiled, inlined
from .exact import ExactSearch
from .protocol import MISS, Returns, decide_doubtful

# --- Rays and triangles' planes: the arithmetic that rasterising, the tree and measuring share ------------------------
# A triangle is a row of `TrianglePlanes.rows`: three linear functions of a place, of its plane and of two corners'
# weights, four numbers each, and how far rounding moves its edges.

ROUNDING = 128.0 * float(np.finfo(float).eps)
EDGE = 1e-11  # barycentric: so near an edge rounding decides, or how a caster takes it
NEARER = 1e-6  # relative: how much nearer than it seems a thing may be that rounding decides
TOUCH = 1e-12  # relative: what starts so near a plane may be on either side of it
_BESIDE = 1e-3  # barycentric: of a triangle that is touched


@inlined
def growth(planes, t, function, x, y, z):
    """How fast one of a triangle's three functions grows along a direction."""
    k = 4 * function
    return planes[t, k] * x + planes[t, k + 1] * y + planes[t, k + 2] * z


@inlined
def signed_distance(planes, t, function, place):
    """How far a place lies from the zero of one of a triangle's three functions."""
    return planes[t, 4 * function + 3] - growth(planes, t, function, place[0], place[1], place[2])


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
def weight_rounding(planes, t, far, origin):
    """What rounding may add to the weights of a triangle's corners; `far` is the `size_of` of its plane."""
    rounding = 0.0
    for function in (1, 2):
        k = 4 * function
        slope = abs(planes[t, k]) + abs(planes[t, k + 1]) + abs(planes[t, k + 2])
        rounding = max(rounding, far * slope + size_of(planes, t, function, origin))
    return ROUNDING * rounding


@inlined
def measured(planes, t, origin, x, y, z):
    """Distance along a ray to a triangle's plane, as `TrianglePlanes.meet` has it."""
    return signed_distance(planes, t, 0, origin) / growth(planes, t, 0, x, y, z)


@inlined
def is_inside(planes, t, origin, x, y, z, distance):
    """Whether a ray meets a triangle itself, at a distance from the origin, as `TrianglePlanes.meet` has it."""
    second = growth(planes, t, 1, x, y, z) * distance - signed_distance(planes, t, 1, origin)
    third = growth(planes, t, 2, x, y, z) * distance - signed_distance(planes, t, 2, origin)
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


@compiled
def meet_planes(planes, origins, shared, directions, triangle):
    """`TrianglePlanes.meet`, compiled: distance, facing and inside, (k,) each."""
    rays = len(triangle)
    distance, facing, inside = np.empty(rays), np.empty(rays), np.empty(rays, dtype=np.bool_)
    for k in range(rays):
        t, start = triangle[k], 0 if shared else k
        origin = origins[0, start], origins[1, start], origins[2, start]
        x, y, z = directions[0, k], directions[1, k], directions[2, k]
        facing[k], distance[k] = growth(planes, t, 0, x, y, z), measured(planes, t, origin, x, y, z)
        inside[k] = is_inside(planes, t, origin, x, y, z, distance[k])
    return distance, facing, inside


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
    """Bounding volume hierarchy as compiled code takes it."""

    low: np.ndarray
    high: np.ndarray
    order: np.ndarray
    planes: np.ndarray


class RayTree:
    """Bounding volume hierarchy in float64 of a fixed set of triangles.

    Parameters
    ----------
    corners : ndarray, (m, 3, 3)
        Corners of each triangle [m]; at least one.
    planes : ndarray, (m, 13)
        `TrianglePlanes.rows` of them.
    exact : ExactSearch
        Of the same triangles: it decides where rounding would.

    Attributes
    ----------
    boxes : BoxTree
        What `hidden` takes.
    """

    def __init__(self, corners: np.ndarray, planes: np.ndarray, exact: ExactSearch) -> None:
        self._exact = exact
        low, high = corners.min(axis=1), corners.max(axis=1)
        order = np.argsort(_along_curve(low + high), kind="stable")
        slack = _SLACK * np.abs(corners).max()
        leaves = 1 << max(int(np.ceil(np.log2(len(corners) / _LEAF))), 0)
        self.boxes = BoxTree(np.full((2 * leaves, 3), np.inf), np.full((2 * leaves, 3), -np.inf), order, planes)
        starts = np.arange(0, len(corners), _LEAF)
        used = slice(leaves, leaves + len(starts))
        self.boxes.low[used] = np.minimum.reduceat(low[order], starts) - slack
        self.boxes.high[used] = np.maximum.reduceat(high[order], starts) + slack
        while leaves > 1:
            halves, whole = slice(leaves, 2 * leaves), slice(leaves // 2, leaves)
            self.boxes.low[whole] = self.boxes.low[halves].reshape(-1, 2, 3).min(axis=1)
            self.boxes.high[whole] = self.boxes.high[halves].reshape(-1, 2, 3).max(axis=1)
            leaves //= 2

    def meet(self, origins: np.ndarray, directions: np.ndarray, max_range: float) -> Returns:
        """What rays meet first, up to `max_range` [m]; `origins` (3,) or (n, 3) [m], unit `directions` (n, 3)."""
        origins = np.ascontiguousarray(np.broadcast_to(origins, directions.shape))
        directions = np.ascontiguousarray(directions)
        triangle, distance, undecided = _first_hits(origins, directions, float(max_range), self.boxes)
        decide_doubtful(self._exact, origins, directions, max_range, undecided, triangle, distance)
        ray = np.flatnonzero(distance < np.inf)
        return Returns(ray, triangle[ray], distance[ray])


def _along_curve(places: np.ndarray) -> np.ndarray:
    """Morton codes: where places (n, 3) come along the curve, (n,)."""
    low, span = places.min(axis=0), np.ptp(places, axis=0)
    cell = ((places - low) / np.where(span > 0.0, span, 1.0) * ((1 << _BITS) - 1)).astype(np.int64)
    code = np.zeros(len(places), dtype=np.int64)
    for bit in range(_BITS):
        for axis in range(3):
            code |= (cell[:, axis] >> bit & 1) << (3 * bit + axis)
    return code


@compiled
def _first_hits(origins, directions, reach, tree):
    """Triangle (n,) or `MISS` and distance (n,) of each ray's first hit, and the rays that rounding decides."""
    rays = len(directions)
    triangle, distance = np.full(rays, MISS), np.full(rays, np.inf)
    undecided, left = np.empty(rays, dtype=np.int64), 0
    stack, entered = np.empty(64, dtype=np.int64), np.empty(64)
    for ray in range(rays):
        origin, direction = origins[ray], directions[ray]
        nearest, doubted, first = _follow(origin, direction, reach, 0.0, tree, stack, entered)
        if doubted <= min(nearest, reach):
            undecided[left] = ray
            left += 1
        elif nearest <= reach:
            away = measured(tree.planes, first, origin, direction[0], direction[1], direction[2])
            if away <= reach:
                triangle[ray], distance[ray] = first, away
    return triangle, distance, undecided[:left]


@compiled
def hidden(origin, x, y, z, distance, tree, found):
    """Occlusion test (any hit): whether something lies nearer than a distance along rays: `found` (n,) int8; 2: unsure.

    Rays start at `origin` (3,) [m]; the coordinates of their directions are of unit length, and `distance` is (n,) [m].
    """
    ox, oy, oz, whole = origin[0], origin[1], origin[2], _box(tree, 1)
    for ray in range(len(distance)):  # most go past the box about all: without a branch, several at a time
        per = _reciprocal(x[ray]), _reciprocal(y[ray]), _reciprocal(z[ray])
        found[ray] = _entry(whole, ox, oy, oz, *per) <= distance[ray]
    stack, entered = np.empty(64, dtype=np.int64), np.empty(64)
    for ray in range(len(distance)):
        if not found[ray]:
            continue
        reach = distance[ray]
        surely = reach * (1.0 - NEARER)
        nearest, doubted, _ = _follow(origin, (x[ray], y[ray], z[ray]), reach, surely, tree, stack, entered)
        found[ray] = 0
        if nearest < surely:
            found[ray] = 1
        elif min(nearest * (1.0 - NEARER), doubted) <= reach:
            found[ray] = 2


@inlined
def _follow(origin, direction, reach, enough, tree, stack, entered):
    """Distance of the nearest triangle that a ray certainly meets, of the nearest it may meet, and row of the former.

    One that is certainly met nearer than `enough` ends it.
    """
    order, planes = tree.order, tree.planes
    ox, oy, oz, dx, dy, dz = origin[0], origin[1], origin[2], direction[0], direction[1], direction[2]
    per_x, per_y, per_z = _reciprocal(dx), _reciprocal(dy), _reciprocal(dz)
    leaves, nearest, doubted, first, height = len(tree.low) // 2, np.inf, np.inf, MISS, 0
    if _entry(_box(tree, 1), ox, oy, oz, per_x, per_y, per_z) <= reach:
        stack[0], entered[0], height = 1, 0.0, 1
    while height:
        height -= 1
        node = stack[height]
        if entered[height] > nearest:
            continue
        if node < leaves:
            one, other = 2 * node, 2 * node + 1
            at_one = _entry(_box(tree, one), ox, oy, oz, per_x, per_y, per_z)
            at_other = _entry(_box(tree, other), ox, oy, oz, per_x, per_y, per_z)
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
        if nearest < enough:
            break
    return nearest, doubted, first


@inlined
def _reciprocal(number):
    return 1.0 / number if abs(number) > 1e-300 else 1e300


@inlined
def _box(tree, node):
    """Least and largest coordinates of a box; of an empty one the least are inf."""
    low, high = tree.low, tree.high
    return low[node, 0], low[node, 1], low[node, 2], high[node, 0], high[node, 1], high[node, 2]


@inlined
def _entry(box, x, y, z, per_x, per_y, per_z):
    """Where a ray enters a box, inf where it misses it."""
    a, b = (box[0] - x) * per_x, (box[3] - x) * per_x
    c, d = (box[1] - y) * per_y, (box[4] - y) * per_y
    e, f = (box[2] - z) * per_z, (box[5] - z) * per_z
    enters = max(max(min(a, b), min(c, d)), max(min(e, f), 0.0)) * (1.0 - _LOOSE)
    leaves = min(min(max(a, b), max(c, d)), max(e, f)) * (1.0 + _LOOSE)
    return enters if (box[0] < np.inf) & (enters <= leaves) else np.inf


@inlined
def _meeting(planes, t, origin, x, y, z):
    """Distance at which a ray meets a triangle, inf where it does not, and whether that is certain.

    The weights of the corners where it meets the plane, times the cosine `facing`, are all above 0 within.
    """
    missing = signed_distance(planes, t, 0, origin)
    sign, away = (1.0 if missing > 0.0 else -1.0), abs(missing)
    facing = sign * growth(planes, t, 0, x, y, z)
    b = away * growth(planes, t, 1, x, y, z) - signed_distance(planes, t, 1, origin) * facing
    c = away * growth(planes, t, 2, x, y, z) - signed_distance(planes, t, 2, origin) * facing
    least, far = min(facing - b - c, b, c), size_of(planes, t, 0, origin)
    if away <= TOUCH * far and is_within(planes, t, origin):
        return 0.0, False
    doubt = weight_rounding(planes, t, far, origin) + (EDGE + planes[t, 12]) * max(facing, 0.0)
    if least < -doubt:
        return np.inf, True
    if least < doubt:
        return away / facing if facing > 4.0 * doubt else 0.0, False
    return away / facing, True
