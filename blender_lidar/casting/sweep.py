"""One turn of a LiDAR drawn onto its lattice of beams: triangle by triangle, not beam by beam.

Seen from the sensor a triangle covers few rings and few azimuth slots. Only the beams there are tested, in float64, and
each keeps the nearest that it meets: a depth buffer, as in computer graphics, but on a sphere. What rounding could
decide is left open: those beams are named, for a slower caster.
"""

from __future__ import annotations

import numpy as np

from ..compiled import compiled, inlined
from .compiled_rays import EDGE, NEARER, ROUNDING, TOUCH, is_behind, lacks, measured, size_of, to_world, touches
from .covered import azimuths_covered, rings_covered, see_vertex, slots_between
from .shared_vertices import RUN

TIE = 1e-6  # relative, far above rounding: what is so nearly as far away is measured again, as all casters measure


@compiled
def draw(mesh, planes, table, components, origin, rotation, reach, closed, turn, paper):
    """Draw all triangles within reach as a sensor sees them.

    Parameters
    ----------
    mesh : Mesh
    planes : ndarray, (m, 13)
        Of each triangle, as `TrianglePlanes.as_rows` gives them.
    table : Table
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
    turn : int
        Another number for each turn on the same canvas.
    paper : Canvas

    Returns
    -------
    bool
        Whether the sensor touches a triangle; nothing is then certain.
    """
    touching = False
    vertices, faces, middle, radius = mesh.vertices, mesh.faces, mesh.middle, mesh.radius
    sine, cosine, azimuth0 = table.elevation_sine, table.elevation_cosine, table.azimuth0
    sine0, cosine0 = table.azimuth0_sine, table.azimuth0_cosine
    slot_sine, slot_cosine = table.slot_sine, table.slot_cosine
    nearest, triangle, doubted = paper.nearest, paper.triangle, paper.doubted
    touched, doubtful, number, seen, made = paper.touched, paper.doubtful, paper.number, paper.seen, paper.made
    number[0] = number[1] = 0
    backs, columns, step = not closed or _within_any(mesh.low, mesh.high, origin), len(slot_sine), table.step
    for run in range(len(radius)):
        x, y, z = middle[run, 0] - origin[0], middle[run, 1] - origin[1], middle[run, 2] - origin[2]
        if x * x + y * y + z * z > (reach + radius[run]) ** 2:
            continue
        for t in range(run * RUN, min((run + 1) * RUN, len(faces))):
            missing = lacks(planes, t, 0, origin)
            if abs(missing) <= TOUCH * size_of(planes, t, 0, origin):
                touching |= touches(planes, t, origin)
            if missing > 0.0 and not backs:
                continue
            a, b, c = faces[t, 0], faces[t, 1], faces[t, 2]
            for vertex in (a, b, c):
                if made[vertex] != turn:
                    made[vertex] = turn
                    see_vertex(vertices, vertex, origin, rotation, seen)
            first_ring, last_ring = rings_covered(sine, seen, a, b, c)
            if first_ring == last_ring:
                continue
            first, last = azimuths_covered(seen[a, 3], seen[b, 3], seen[c, 3])
            weights, doubt, away = _weights(planes, t, origin, rotation)
            edge = EDGE + planes[t, 12]
            for ring in range(first_ring, last_ring):
                slot, tests = slots_between(first - azimuth0[ring], last - azimuth0[ring], step, columns)
                level, up = cosine[ring], sine[ring]
                in_ring = _in_ring(weights, level * sine0[ring], level * cosine0[ring], up)
                for _ in range(tests):
                    distance, uncertain = _meeting(in_ring, slot_sine[slot], slot_cosine[slot], doubt, edge, away)
                    beam = ring * columns + slot
                    slot = slot + 1 if slot < columns - 1 else 0
                    if distance == np.inf:
                        continue
                    if uncertain:
                        if doubted[beam] == np.inf:
                            doubtful[number[1]] = beam
                            number[1] += 1
                        doubted[beam] = min(doubted[beam], distance * (1.0 - NEARER))
                        continue
                    before = nearest[beam]
                    if before == np.inf:
                        touched[number[0]] = beam
                        number[0] += 1
                    elif abs(distance - before) <= TIE * distance:
                        x, y, z = to_world(components[0, beam], components[1, beam], components[2, beam], rotation)
                        if is_behind(planes, t, triangle[beam], origin, x, y, z):
                            continue
                    elif distance > before:
                        continue
                    nearest[beam], triangle[beam] = distance, t
    return touching


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
def _weights(planes, t, origin, rotation):
    """Three linear functions of a direction in the sensor frame, all above 0 where a ray meets a triangle.

    They are the weights of its corners where the ray meets its plane, times `facing`, the cosine between ray and
    normal, which is their sum. Returned with what rounding may add to them, and the distance from the plane [m].
    """
    missing = lacks(planes, t, 0, origin)
    sign, doubt, far = (1.0 if missing > 0.0 else -1.0), 0.0, size_of(planes, t, 0, origin)
    fx, fy, fz = _turned(planes, t, 0, rotation)
    fx, fy, fz = sign * fx, sign * fy, sign * fz
    bx, by, bz = _turned(planes, t, 1, rotation)
    short, away = lacks(planes, t, 1, origin), abs(missing)
    bx, by, bz = away * bx - short * fx, away * by - short * fy, away * bz - short * fz
    cx, cy, cz = _turned(planes, t, 2, rotation)
    short = lacks(planes, t, 2, origin)
    cx, cy, cz = away * cx - short * fx, away * cy - short * fy, away * cz - short * fz
    for function in (1, 2):
        k = 4 * function
        slope = abs(planes[t, k]) + abs(planes[t, k + 1]) + abs(planes[t, k + 2])
        doubt = max(doubt, ROUNDING * (far * slope + size_of(planes, t, function, origin)))
    return (fx - bx - cx, fy - by - cy, fz - bz - cz, bx, by, bz, cx, cy, cz), doubt, away


@inlined
def _turned(planes, t, function, rotation):
    """Slope of one of a triangle's functions in the sensor frame."""
    x, y, z = planes[t, 4 * function], planes[t, 4 * function + 1], planes[t, 4 * function + 2]
    return (
        rotation[0, 0] * x + rotation[0, 1] * y + rotation[0, 2] * z,
        rotation[1, 0] * x + rotation[1, 1] * y + rotation[1, 2] * z,
        rotation[2, 0] * x + rotation[2, 1] * y + rotation[2, 2] * z,
    )


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
def _meeting(in_ring, sine, cosine, doubt, edge, away):
    """Distance at which a beam meets a triangle, inf where it does not, and whether rounding decides that."""
    a, b, c = in_ring
    beyond = -doubt - 2.0 * edge  # most beams miss, and show it in one of the three: `facing` is a cosine
    a = a[0] * sine + a[1] * cosine + a[2]
    if a < beyond:
        return np.inf, False
    b = b[0] * sine + b[1] * cosine + b[2]
    if b < beyond:
        return np.inf, False
    c = c[0] * sine + c[1] * cosine + c[2]
    if c < beyond:
        return np.inf, False
    facing = a + b + c
    doubt += edge * max(facing, 0.0)
    if (a < -doubt) | (b < -doubt) | (c < -doubt):
        return np.inf, False
    if (a < doubt) | (b < doubt) | (c < doubt):
        return away / facing if facing > 4.0 * doubt else 0.0, True
    return away / facing, False


@compiled
def take_returns(paper, planes, components, origin, rotation, reach):
    """What the beams of a turn that has been drawn met, and an empty canvas.

    Parameters
    ----------
    paper : Canvas
    planes : ndarray, (m, 13)
    components : ndarray, (3, b)
        The lattice's beams.
    origin, rotation : ndarray
        As for `draw`.
    reach : float
        Hits that are farther away are left out [m].

    Returns
    -------
    beam, triangle : ndarray of int64, (k,)
        Rising beams, and the triangle that each met first.
    distance : ndarray, (k,)
        Distance along each [m]; measured as `TrianglePlanes` does.
    directions : ndarray, (3, k)
        Unit vectors in the frame of the triangles.
    undecided : ndarray of int64, (d,)
        Beams of which rounding decides what they meet, if anything.
    """
    most = paper.number[0]
    beams, triangles = np.empty(most, dtype=np.int64), np.empty(most, dtype=np.int64)
    distances, directions, found = np.empty(most), np.empty((3, most)), 0
    undecided, left = np.empty(paper.number[1], dtype=np.int64), 0
    nearest, doubted = paper.nearest, paper.doubted
    for k in range(paper.number[1]):
        beam = paper.doubtful[k]
        if doubted[beam] <= min(nearest[beam], reach):
            undecided[left] = beam
            left += 1
            nearest[beam] = np.inf
        doubted[beam] = np.inf
    for beam in np.sort(paper.touched[:most]):
        if nearest[beam] == np.inf:  # undecided
            continue
        nearest[beam], t = np.inf, paper.triangle[beam]
        x, y, z = to_world(components[0, beam], components[1, beam], components[2, beam], rotation)
        distance = measured(planes, t, origin, x, y, z)
        if distance <= reach:
            beams[found], triangles[found], distances[found] = beam, t, distance
            directions[0, found], directions[1, found], directions[2, found] = x, y, z
            found += 1
    return beams[:found], triangles[:found], distances[:found], directions[:, :found].copy(), np.sort(undecided[:left])
