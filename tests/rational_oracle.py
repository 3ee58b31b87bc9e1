"""The oracle's oracle: which triangle a ray meets first and how far away, in whole rational numbers, without rounding.

A float64 is a fraction, so the ray and the triangles are taken as they are given. Slow: tens of microseconds for a ray
and a triangle, after a bounding-sphere test in float64 that leaves far too much rather than a little too few.
"""

from __future__ import annotations

from fractions import Fraction
from functools import cache

import numpy as np


def first_distances(triangles, origins, directions, max_range=np.inf) -> np.ndarray:
    """Distance (n,) to the nearest triangle that a ray meets, its border included; inf where there is none.

    Rays that lie in a triangle's plane meet it nowhere, as with the casters. The distance is in multiples of the
    direction's length, which is 1 but for rounding.
    """
    origins = np.broadcast_to(origins, directions.shape)
    middle = triangles.mean(axis=1)
    radius = np.linalg.norm(triangles - middle[:, None], axis=2).max(axis=1)
    found = np.full(len(directions), np.inf)
    exactly = cache(lambda at: [tuple(map(Fraction, corner)) for corner in triangles[at].tolist()])
    for row, (origin, direction) in enumerate(zip(origins, directions, strict=True)):
        towards = middle - origin
        off = np.linalg.norm(np.cross(towards, direction), axis=1)
        near = np.flatnonzero(off <= radius + 1e-6 * (1.0 + np.abs(towards).max(axis=1)))
        start, way = tuple(map(Fraction, origin.tolist())), tuple(map(Fraction, direction.tolist()))
        distances = [distance for at in near.tolist() if (distance := _distance(exactly(at), start, way)) is not None]
        if distances and min(distances) <= max_range:
            found[row] = float(min(distances))
    return found


def _distance(triangle, start, way):
    """Distance along the ray to a triangle, its border included; None where it misses."""
    a, b, c = ([at - begin for at, begin in zip(corner, start, strict=True)] for corner in triangle)
    # The ray's line passes a side on the left or right by the sign of the volume that it spans with it.
    volumes = [_volume(way, p, q) for p, q in ((b, c), (c, a), (a, b))]
    if min(volumes) < 0 < max(volumes):
        return None
    whole = sum(volumes)
    if whole == 0:
        return None
    distance = _volume(a, b, c) / whole
    return distance if distance >= 0 else None


def _volume(p, q, r):
    return p[0] * (q[1] * r[2] - q[2] * r[1]) - p[1] * (q[0] * r[2] - q[2] * r[0]) + p[2] * (q[0] * r[1] - q[1] * r[0])
