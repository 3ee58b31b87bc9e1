"""Rasterising one revolution of a LiDAR into a depth buffer over its lattice of beams, triangle by triangle.

Seen from the sensor a triangle covers few rings and few azimuth slots. Only the beams there are tested, in float64, and
each keeps the nearest that it meets: a depth buffer, as in computer graphics, but on a sphere. What rounding could
decide is left open: those beams are named, for a slower caster.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from ..compiled import compiled, inlined
from ..sensors.beams import BeamLattice
from .kernels import EDGE, NEARER, TOUCH, is_behind, is_within, signed_distance, size_of, to_world, weight_rounding

RUN = 16  # triangles with a sphere about them: neighbours in the list tend to be neighbours in space

# --- Triangles, the lattice's sines and cosines, and the depth buffer -------------------------------------------------
# Types stand beside the kernels that take them: an index of stored code that names a type of a module which imports
# this one cannot be read while this one is imported.


class Mesh(NamedTuple):
    """Mesh of shared vertices, ready to be rasterised.

    Attributes
    ----------
    vertices : ndarray, (v, 3)
        Each place once [m].
    faces : ndarray of int32, (m, 3)
        Rows of the corners of each triangle.
    middle, radius : ndarray, (r, 3) and (r,)
        Sphere about each run of `RUN` triangles [m].
    low, high : ndarray, (s, 3)
        Boxes about runs that share no vertex with each other [m]: a solid lies within one of them.
    """

    vertices: np.ndarray
    faces: np.ndarray
    middle: np.ndarray
    radius: np.ndarray
    low: np.ndarray
    high: np.ndarray


class LatticeTable(NamedTuple):
    """What `rasterise` needs of a lattice: by ring, and by slot the sine and cosine of its azimuth from slot 0.

    Slots go on for another turn, so that those of a triangle follow each other.
    """

    elevation_sine: np.ndarray
    elevation_cosine: np.ndarray
    azimuth0: np.ndarray
    azimuth0_sine: np.ndarray
    azimuth0_cosine: np.ndarray
    slot_sine: np.ndarray
    slot_cosine: np.ndarray
    columns: int
    step: float


class DepthBuffer(NamedTuple):
    """Depth buffer of one revolution; between revolutions `nearest` and `doubted` are inf for every beam.

    Attributes
    ----------
    nearest : ndarray, (b,)
        Distance to the nearest triangle so far [m].
    triangle : ndarray of int32, (b,)
        Its row.
    doubted : ndarray, (b,)
        The least distance of what a beam may or may not meet [m].
    touched, doubtful : ndarray of int32, (b,)
        Beams that met something, and beams of which rounding decides, in the order in which that was found.
    number : ndarray of int64, (3,)
        How many these are, and how many revolutions have been rasterised.
    projected : ndarray, (v, 6)
        Of each vertex in this revolution: x, y and z in the sensor frame [m], azimuth [rad], sine of the elevation and
        one over the distance.
    projected_in : ndarray of int64, (v,)
        The revolution that a row of `projected` was made in.
    """

    nearest: np.ndarray
    triangle: np.ndarray
    doubted: np.ndarray
    touched: np.ndarray
    doubtful: np.ndarray
    number: np.ndarray
    projected: np.ndarray
    projected_in: np.ndarray


@lru_cache(maxsize=8)
def lattice_table(lattice: BeamLattice) -> LatticeTable:
    """What `rasterise` needs of a lattice."""
    azimuth0, columns = np.ascontiguousarray(lattice.slot_azimuth0_rad), lattice.columns
    slots = np.tile(lattice.step_rad * np.arange(columns), 2)
    return LatticeTable(
        np.sin(lattice.elevation_rad),
        np.cos(lattice.elevation_rad),
        azimuth0,
        np.sin(azimuth0),
        np.cos(azimuth0),
        np.sin(slots),
        np.cos(slots),
        columns,
        float(lattice.step_rad),
    )


def depth_buffer(beams: int, vertices: int) -> DepthBuffer:
    """An empty depth buffer."""
    return DepthBuffer(
        np.full(beams, np.inf),
        np.zeros(beams, dtype=np.int32),
        np.full(beams, np.inf),
        np.zeros(beams, dtype=np.int32),
        np.zeros(beams, dtype=np.int32),
        np.zeros(3, dtype=np.int64),
        np.empty((vertices, 6)),
        np.full(vertices, -1, dtype=np.int64),
    )


# --- Which rings and azimuth slots a triangle may cover as a sensor sees it: bounds on the sphere, never too narrow -

_TURN = 2.0 * math.pi
_MARGIN_RAD = 1e-9  # of bounds, for rounding; far below any beam spacing
_LEAST_COSINE = 1e-3  # between two corners as projected from the sensor: triangles that look wider get all rings


@inlined
def project_vertex(vertices, vertex, origin, inverse, projected):
    """Write a vertex's row of `DepthBuffer.projected`."""
    x, y, z = to_world(
        vertices[vertex, 0] - origin[0], vertices[vertex, 1] - origin[1], vertices[vertex, 2] - origin[2], inverse
    )
    projected[vertex, 0], projected[vertex, 1], projected[vertex, 2] = x, y, z
    projected[vertex, 3] = math.atan2(x, y)  # clockwise from +y, Eq. 1
    projected[vertex, 5] = 1.0 / math.sqrt(x * x + y * y + z * z)
    projected[vertex, 4] = z * projected[vertex, 5]


@inlined
def ring_bounds(sine, projected, a, b, c):
    """First ring that a triangle may cover, and the one after the last.

    A direction to a point of it is a sum of its corners' directions with weights of 0 or more that add up to 1, over
    the length of that sum, which is the square root of the least cosine between two corners at least.
    """
    first, second, third = projected[a, 4], projected[b, 4], projected[c, 4]
    low, high = min(first, second, third), max(first, second, third)
    cosine = min(_cosine(projected, a, b), _cosine(projected, b, c), _cosine(projected, c, a))
    if not cosine > _LEAST_COSINE:  # also where a corner is at the very sensor
        return 0, len(sine)
    least = math.sqrt(min(cosine, 1.0))
    if low < 0.0:
        low /= least
    if high > 0.0:
        high /= least
    return _rank(sine, low - _MARGIN_RAD), _rank(sine, high + _MARGIN_RAD)


@inlined
def _cosine(projected, a, b):
    """Of the angle between two vertices."""
    product = projected[a, 0] * projected[b, 0] + projected[a, 1] * projected[b, 1] + projected[a, 2] * projected[b, 2]
    return product * projected[a, 5] * projected[b, 5]


@inlined
def _rank(rising, value):
    """How many of some rising values lie below one."""
    low, high = 0, len(rising)
    while low < high:
        middle = (low + high) >> 1
        if rising[middle] < value:
            low = middle + 1
        else:
            high = middle
    return low


@inlined
def azimuth_bounds(a, b, c):
    """Bounds of a triangle's azimuth, from its corners'; along a side it rises or falls throughout.

    About the sensor's axis, where the corners look all ways, it is a whole revolution.
    """
    b, c = _within_half_a_turn(b - a), _within_half_a_turn(c - a)
    low, high = min(0.0, b, c), max(0.0, b, c)
    if high - low < math.pi - _MARGIN_RAD:
        return a + low - _MARGIN_RAD, a + high + _MARGIN_RAD
    return 0.0, _TURN


@inlined
def _within_half_a_turn(angle):
    """The same angle from -pi to pi."""
    if angle > math.pi:
        return angle - _TURN
    return angle + _TURN if angle < -math.pi else angle


@inlined
def slots_between(first, last, per_step, columns):
    """First slot between two azimuths from slot 0 on, and how many there are.

    Both are as rounding has it: far less than the margin of the bounds.
    """
    slot = math.ceil(first * per_step)
    tests = min(math.floor(last * per_step) - slot + 1, columns)
    while slot < 0:
        slot += columns
    while slot >= columns:
        slot -= columns
    return slot, tests


# --- Rasterising ------------------------------------------------------------------------------------------------------

TIE = 1e-6  # relative, far above rounding: what is so nearly as far away is measured again, as all casters measure


@compiled
def rasterise(mesh, planes, table, components, origin, rotation, reach, closed, revolution, buffer):
    """Rasterise all triangles within reach as a sensor sees them.

    Parameters
    ----------
    mesh : Mesh
    planes : ndarray, (m, 13)
        Of each triangle, as in `TrianglePlanes.rows`.
    table : LatticeTable
    components : ndarray, (3, b)
        The lattice's beams.
    origin : ndarray, (3,)
        The sensor's place [m].
    rotation : ndarray, (3, 3)
        Its orientation: ``world = sensor @ rotation``.
    reach : float
        What lies wholly farther away is left out [m].
    closed : bool
        Whether triangles bound solids: from outside these their backs are not looked at.
    revolution : int
        Another number for each revolution in the same buffer.
    buffer : DepthBuffer

    Returns
    -------
    bool
        Whether the sensor is within a triangle; nothing is then certain.
    """
    near_surface, inverse = False, rotation.T
    vertices, faces, middle, radius = mesh.vertices, mesh.faces, mesh.middle, mesh.radius
    sine, cosine, azimuth0 = table.elevation_sine, table.elevation_cosine, table.azimuth0
    sine0, cosine0 = table.azimuth0_sine, table.azimuth0_cosine
    slot_sine, slot_cosine, columns, per_step = table.slot_sine, table.slot_cosine, table.columns, 1.0 / table.step
    nearest, triangle, doubted = buffer.nearest, buffer.triangle, buffer.doubted
    touched, doubtful = buffer.touched, buffer.doubtful
    projected, projected_in = buffer.projected, buffer.projected_in
    touches, doubts, turn = np.uint64(0), np.uint64(0), np.uint64(columns)  # as signed, they might count from an end
    least, facing = np.empty(columns), np.empty(columns)
    backs = not closed or _within_any(mesh.low, mesh.high, origin)
    for run in range(len(radius)):
        x, y, z = middle[run, 0] - origin[0], middle[run, 1] - origin[1], middle[run, 2] - origin[2]
        if x * x + y * y + z * z > (reach + radius[run]) ** 2:
            continue
        for t in range(np.uint64(run * RUN), np.uint64(min((run + 1) * RUN, len(faces)))):
            missing = signed_distance(planes, t, 0, origin)
            if abs(missing) <= TOUCH * size_of(planes, t, 0, origin):
                near_surface |= is_within(planes, t, origin)
            if missing > 0.0 and not backs:
                continue
            a, b, c = np.uint32(faces[t, 0]), np.uint32(faces[t, 1]), np.uint32(faces[t, 2])
            for vertex in (a, b, c):
                if projected_in[vertex] != revolution:
                    projected_in[vertex] = revolution
                    project_vertex(vertices, vertex, origin, inverse, projected)
            first_ring, last_ring = ring_bounds(sine, projected, a, b, c)
            if first_ring == last_ring:
                continue
            first, last = azimuth_bounds(projected[a, 3], projected[b, 3], projected[c, 3])
            weights, doubt, away = _weights(planes, t, origin, inverse)
            edge = EDGE + planes[t, 12]
            beyond = -doubt - 2.0 * edge  # most beams miss, and show it in one of the three: `facing` is a cosine
            for ring in range(np.uint64(first_ring), np.uint64(last_ring)):
                slot, tests = slots_between(first - azimuth0[ring], last - azimuth0[ring], per_step, columns)
                if tests <= 0:
                    continue
                level, up = cosine[ring], sine[ring]
                in_ring = _in_ring(weights, level * sine0[ring], level * cosine0[ring], up)
                begin = np.uint64(slot)
                for k in range(np.uint64(tests)):  # without a branch: several beams at a time
                    least[k], facing[k] = _least_weight(in_ring, slot_sine[begin + k], slot_cosine[begin + k])
                for k in range(np.uint64(tests)):
                    if least[k] < beyond:
                        continue
                    distance, uncertain = _meeting(least[k], facing[k], doubt, edge, away)
                    if distance == np.inf:
                        continue
                    beam = begin + k
                    beam = ring * turn + (beam if beam < turn else beam - turn)
                    if uncertain:
                        if doubted[beam] == np.inf:
                            doubtful[doubts] = beam
                            doubts += np.uint64(1)
                        doubted[beam] = min(doubted[beam], distance * (1.0 - NEARER))
                        continue
                    before = nearest[beam]
                    if before == np.inf:
                        touched[touches] = beam
                        touches += np.uint64(1)
                    elif abs(distance - before) <= TIE * distance:
                        x, y, z = to_world(components[0, beam], components[1, beam], components[2, beam], rotation)
                        if is_behind(planes, t, np.uint32(triangle[beam]), origin, x, y, z):
                            continue
                    elif distance > before:
                        continue
                    nearest[beam], triangle[beam] = distance, t
    buffer.number[0], buffer.number[1] = touches, doubts
    return near_surface


@inlined
def _within_any(low, high, place):
    for box in range(len(low)):
        if (
            low[box, 0] <= place[0] <= high[box, 0]
            and low[box, 1] <= place[1] <= high[box, 1]
            and low[box, 2] <= place[2] <= high[box, 2]
        ):
            return True
    return False


@inlined
def _weights(planes, t, origin, inverse):
    """Three linear functions of a direction in the sensor frame, all above 0 where a ray meets a triangle.

    They are the weights of its corners where the ray meets its plane, times `facing`, the cosine between ray and
    normal, which is their sum. Returned with what rounding may add to them, and the distance from the plane [m].
    """
    missing = signed_distance(planes, t, 0, origin)
    sign = 1.0 if missing > 0.0 else -1.0
    fx, fy, fz = to_world(sign * planes[t, 0], sign * planes[t, 1], sign * planes[t, 2], inverse)
    bx, by, bz = to_world(planes[t, 4], planes[t, 5], planes[t, 6], inverse)
    short, away = signed_distance(planes, t, 1, origin), abs(missing)
    bx, by, bz = away * bx - short * fx, away * by - short * fy, away * bz - short * fz
    cx, cy, cz = to_world(planes[t, 8], planes[t, 9], planes[t, 10], inverse)
    short = signed_distance(planes, t, 2, origin)
    cx, cy, cz = away * cx - short * fx, away * cy - short * fy, away * cz - short * fz
    doubt = weight_rounding(planes, t, size_of(planes, t, 0, origin), origin)
    return (fx - bx - cx, fy - by - cy, fz - bz - cz, bx, by, bz, cx, cy, cz), doubt, away


@inlined
def _in_ring(weights, sine, cosine, up):
    """Linear functions of a direction as those of the sine and the cosine of a slot's azimuth in one ring."""
    ax, ay, az, bx, by, bz, cx, cy, cz = weights
    return (
        (ax * cosine - ay * sine, ax * sine + ay * cosine, az * up),
        (bx * cosine - by * sine, bx * sine + by * cosine, bz * up),
        (cx * cosine - cy * sine, cx * sine + cy * cosine, cz * up),
    )


@inlined
def _least_weight(in_ring, sine, cosine):
    """The least of a triangle's three functions of a beam, and their sum."""
    a, b, c = in_ring
    a, b, c = (
        a[0] * sine + a[1] * cosine + a[2],
        b[0] * sine + b[1] * cosine + b[2],
        c[0] * sine + c[1] * cosine + c[2],
    )
    return min(min(a, b), c), a + b + c


@inlined
def _meeting(least, facing, doubt, edge, away):
    """Distance at which a beam meets a triangle, inf where it does not, and whether rounding decides that."""
    doubt += edge * max(facing, 0.0)
    if least < -doubt:
        return np.inf, False
    if least < doubt:
        return away / facing if facing > 4.0 * doubt else 0.0, True
    return away / facing, False


@compiled
def undecided_beams(buffer, reach):
    """Beams (d,) of which rounding decides what they meet within reach; no beam is doubted any more."""
    found, left, doubted = np.empty(buffer.number[1], dtype=np.int64), 0, buffer.doubted
    for beam in buffer.doubtful[: buffer.number[1]]:
        if doubted[beam] <= min(buffer.nearest[beam], reach):
            found[left] = beam
            left += 1
        doubted[beam] = np.inf
    return found[:left]
