"""Rays and triangles' planes, compiled: the arithmetic that drawing, the tree in float64 and measuring share.

A triangle is a row of `TrianglePlanes.as_rows`: three linear functions of a place, of its plane and of two corners'
weights, four numbers each, and how far rounding moves its edges.
"""

from __future__ import annotations

import numpy as np

from ..compiled import inlined

ROUNDING = 128.0 * float(np.finfo(float).eps)
EDGE = 1e-11  # barycentric: so near an edge rounding decides, or how a caster takes it
NEARER = 1e-6  # relative: how much nearer than it seems a thing may be that rounding decides
TOUCH = 1e-12  # relative: what starts so near a plane may be on either side of it
_BESIDE = 1e-3  # barycentric: of a triangle that is touched


@inlined
def lacks(planes, t, function, place):
    """What a place lacks to the zero of one of a triangle's three functions."""
    k = 4 * function
    return planes[t, k + 3] - (planes[t, k] * place[0] + planes[t, k + 1] * place[1] + planes[t, k + 2] * place[2])


@inlined
def touches(planes, t, place):
    """Whether a place on a triangle's plane lies within the triangle, or hardly beside it."""
    b, c = -lacks(planes, t, 1, place), -lacks(planes, t, 2, place)
    return min(1.0 - b - c, b, c) >= -_BESIDE


@inlined
def size_of(planes, t, function, place):
    """Sum of the sizes of what `lacks` adds up, of which rounding takes its share."""
    k = 4 * function
    size = abs(planes[t, k] * place[0]) + abs(planes[t, k + 1] * place[1]) + abs(planes[t, k + 2] * place[2])
    return abs(planes[t, k + 3]) + size


@inlined
def measured(planes, t, origin, x, y, z):
    """Distance along a ray to a triangle's plane, as `TrianglePlanes.meet` has it."""
    return lacks(planes, t, 0, origin) / (planes[t, 0] * x + planes[t, 1] * y + planes[t, 2] * z)


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
