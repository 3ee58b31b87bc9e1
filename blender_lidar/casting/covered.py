"""Which rings and azimuth slots a triangle may cover as a sensor sees it: bounds on the sphere, never too narrow."""

from __future__ import annotations

import math

from ..compiled import inlined

_TURN = 2.0 * math.pi
_MARGIN_RAD = 1e-9  # of bounds, for rounding; far below any beam spacing
_LEAST_COSINE = 1e-3  # between two corners as seen from the sensor: triangles that look wider get all rings


@inlined
def see_vertex(vertices, vertex, origin, rotation, seen):
    x, y, z = vertices[vertex, 0] - origin[0], vertices[vertex, 1] - origin[1], vertices[vertex, 2] - origin[2]
    for axis in range(3):
        seen[vertex, axis] = rotation[axis, 0] * x + rotation[axis, 1] * y + rotation[axis, 2] * z
    seen[vertex, 3] = math.atan2(seen[vertex, 0], seen[vertex, 1])  # clockwise from +y, Eq. 1
    seen[vertex, 5] = 1.0 / math.sqrt(x * x + y * y + z * z)
    seen[vertex, 4] = seen[vertex, 2] * seen[vertex, 5]


@inlined
def rings_covered(sine, seen, a, b, c):
    """First ring that a triangle may cover, and the one after the last.

    A direction to a point of it is a sum of its corners' directions with weights of 0 or more that add up to 1, over
    the length of that sum, which is the square root of the least cosine between two corners at least.
    """
    low, high = min(seen[a, 4], seen[b, 4], seen[c, 4]), max(seen[a, 4], seen[b, 4], seen[c, 4])
    cosine = min(_cosine(seen, a, b), _cosine(seen, b, c), _cosine(seen, c, a))
    if not cosine > _LEAST_COSINE:  # also where a corner is at the very sensor
        return 0, len(sine)
    least = math.sqrt(min(cosine, 1.0))
    if low < 0.0:
        low /= least
    if high > 0.0:
        high /= least
    return _rank(sine, low - _MARGIN_RAD), _rank(sine, high + _MARGIN_RAD)


@inlined
def _cosine(seen, a, b):
    """Of the angle between two vertices."""
    product = seen[a, 0] * seen[b, 0] + seen[a, 1] * seen[b, 1] + seen[a, 2] * seen[b, 2]
    return product * seen[a, 5] * seen[b, 5]


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
def azimuths_covered(a, b, c):
    """Bounds of a triangle's azimuth, from its corners'; along a side it rises or falls throughout.

    About the sensor's axis, where the corners look all ways, it is a whole turn.
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
def slots_between(first, last, step, columns):
    """First slot between two azimuths from slot 0 on, and how many there are."""
    slot = math.ceil(first / step)
    tests = min(math.floor(last / step) - slot + 1, columns)
    return slot % columns, tests
