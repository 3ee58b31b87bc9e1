"""What every caster shares: the protocol, float64 ranges, and a second chance for rays that leaked.

A back-end answers one question: which triangle does a ray meet first? It may answer in float32, and it may leak: near
a shared edge both `BVHTree.ray_cast` and Embree now and then report neither neighbour. What is built on the answer is
common to all of them, so that they differ in speed alone:

- the range is computed again in float64, from the plane of the triangle that was met;
- a ray is suspected of a leak if it met nothing, or if the first thing it met was the inside of a closed mesh.
  Suspects are cast again along four directions that surround their own. Only where all four meet an outside does the
  ray count as a hit, so that a ray that passes by a silhouette stays a miss.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import NamedTuple

import numpy as np

from ..errors import InputError

MISS = -1
LEAK_PROBE_RAD = 6e-6  # wider than float32 rounding seen from a few metres, far narrower than any beam spacing
# Added to a direction, the corners of a tetrahedron surround it whatever way it points; turned off the axes, where
# mesh edges tend to lie.
_PROBES = LEAK_PROBE_RAD * (
    np.array([[1.0, 1.0, 1.0], [1.0, -1.0, -1.0], [-1.0, 1.0, -1.0], [-1.0, -1.0, 1.0]])
    / np.sqrt(3.0)
    @ np.array([[0.36, 0.48, -0.8], [-0.8, 0.60, 0.0], [0.48, 0.64, 0.6]])
)
_REACH_SLACK = 1e-5  # relative: back-ends look a little farther than asked and float64 decides at the limit
_UNIT_TOLERANCE = 1e-6


class Hits(NamedTuple):
    """What rays met first.

    Attributes
    ----------
    distance : ndarray, (n,)
        Distance along each ray [m]; inf where it met nothing.
    triangle : ndarray of int64, (n,)
        Row of the triangle that was met; `MISS` (-1) where there is none.
    """

    distance: np.ndarray
    triangle: np.ndarray


class Caster(ABC):
    """Casts rays against a fixed set of triangles.

    Parameters
    ----------
    corners : array, (m, 3, 3)
        Corners of each triangle [m], counter-clockwise seen from outside. Triangles without area are never met.
        Any size and place: the scene is re-centred in float64 before anything becomes float32.
    """

    name: str
    leaks: bool = True  # whether the back-end may miss a triangle at its edges

    def __init__(self, corners: np.ndarray) -> None:
        corners = np.asarray(corners, dtype=float)
        if corners.ndim != 3 or corners.shape[1:] != (3, 3):
            raise InputError(f"triangles have shape {corners.shape}; allowed: (m, 3, 3)")
        if not np.isfinite(corners).all():
            raise InputError("a triangle has a corner that is not finite")
        flat = corners.reshape(-1, 3)
        self._origin = 0.5 * (flat.min(axis=0) + flat.max(axis=0)) if len(flat) else np.zeros(3)
        self._corners = corners - self._origin
        normal = np.cross(self._corners[:, 1] - self._corners[:, 0], self._corners[:, 2] - self._corners[:, 0])
        area = np.linalg.norm(normal, axis=1)
        self._given = len(corners)
        self._solid = np.flatnonzero(area > 0)
        self._corners, normal = self._corners[self._solid], normal[self._solid] / area[self._solid, None]
        self._normal = normal
        self._offset = _dot(normal, self._corners[:, 0])
        if len(self._solid):
            self._build(self._corners)

    @abstractmethod
    def _build(self, corners: np.ndarray) -> None:
        """Prepare for `_first`; `corners` (m, 3, 3) are re-centred and have area."""

    @abstractmethod
    def _first(self, origins: np.ndarray, directions: np.ndarray, reach: float) -> np.ndarray:
        """Row of the triangle that each ray meets first within `reach`, or `MISS`; float64 in, (n,) int64 out."""

    def cast(self, origins: np.ndarray, directions: np.ndarray, max_range: float = np.inf) -> Hits:
        """What each ray meets first, no farther than `max_range`.

        Parameters
        ----------
        origins : ndarray, (3,) or (n, 3)
            Start of all rays, or of each [m].
        directions : ndarray, (n, 3)
            Unit directions.
        max_range : float
            Farthest distance that counts [m], itself included.

        Raises
        ------
        InputError
            For wrong shapes, a direction that is not finite and of unit length, or an origin that is not finite.
        """
        origins, directions = self._checked(origins, directions, max_range)
        if len(self._solid) == 0 or len(directions) == 0:
            return Hits(np.full(len(directions), np.inf), np.full(len(directions), MISS, dtype=np.int64))
        reach = min(max_range * (1.0 + _REACH_SLACK) + _REACH_SLACK, 1e30)
        triangle = self._first(origins, directions, reach)
        distance = np.full(len(triangle), np.inf)
        met = np.flatnonzero(triangle != MISS)
        distance[met], facing = self._range(
            _rows(origins, met), np.take(directions, met, axis=0), np.take(triangle, met)
        )
        if self.leaks:
            outside = np.zeros(len(triangle), dtype=bool)
            outside[met] = facing < 0.0
            self._second_chance(origins, directions, reach, np.flatnonzero(~outside), triangle, distance)
        beyond = ~(distance <= max_range)
        distance[beyond], triangle[beyond] = np.inf, MISS
        if len(self._solid) < self._given:
            triangle[~beyond] = self._solid[triangle[~beyond]]
        return Hits(distance, triangle)

    def normals(self, triangle: np.ndarray) -> np.ndarray:
        """Outward unit normals (n, 3) of triangles that were met, by their row in the constructor's `corners`."""
        return self._normal[np.searchsorted(self._solid, triangle)]

    def _range(self, origins, directions, triangle):
        """Distance to the plane of each ray's triangle, inf if behind, and the cosine between ray and normal."""
        normal = np.take(self._normal, triangle, axis=0)
        facing = _dot(normal, directions)
        height = np.take(self._offset, triangle)
        height -= _dot(normal, origins)
        with np.errstate(divide="ignore", invalid="ignore"):
            distance = height / facing
        return np.where(distance >= 0.0, distance, np.inf), facing  # also no number, for a ray within the plane

    def _second_chance(self, origins, directions, reach, suspect, triangle, distance):
        """Cast suspects again, four times a hair's breadth away; keep the nearest outside where all four meet one."""
        nearest = np.full(len(suspect), np.inf)
        found = np.full(len(suspect), MISS, dtype=np.int64)
        for offset in _PROBES:
            if len(suspect) == 0:
                return
            ray, origin = np.take(directions, suspect, axis=0), _rows(origins, suspect)
            probed = self._first(origin, ray + offset, reach)
            hit = np.flatnonzero(probed != MISS)
            along, facing = self._range(
                _rows(origin, hit), np.take(ray, hit, axis=0), probed[hit]
            )  # along the ray, not the probe
            outside = hit[facing < 0.0]
            suspect, nearest, found = suspect[outside], nearest[outside], found[outside]
            along, probed = along[facing < 0.0], probed[outside]
            nearer = along < nearest
            nearest, found = np.where(nearer, along, nearest), np.where(nearer, probed, found)
        nearer = nearest < distance[suspect]
        distance[suspect[nearer]], triangle[suspect[nearer]] = nearest[nearer], found[nearer]

    def _checked(self, origins, directions, max_range):
        origins, directions = np.asarray(origins, dtype=float), np.asarray(directions, dtype=float)
        if directions.ndim != 2 or directions.shape[1] != 3:
            raise InputError(f"directions have shape {directions.shape}; allowed: (n, 3)")
        if origins.shape not in ((3,), directions.shape):
            raise InputError(f"origins have shape {origins.shape}; allowed: (3,) or {directions.shape}")
        length = _dot(directions, directions)
        if not (np.abs(length - 1.0) <= _UNIT_TOLERANCE).all():  # also catches NaN, which casters would miss silently
            raise InputError("a direction is not finite and of unit length")
        if not np.isfinite(origins).all():
            raise InputError("an origin is not finite")
        if not max_range >= 0.0:
            raise InputError(f"max_range is {max_range}; allowed: a distance of 0 m or more")
        return origins - self._origin, directions


def _rows(origins, rows):
    """The origins of some rays; a shared one stays shared."""
    return origins if origins.ndim == 1 else np.take(origins, rows, axis=0)


def _dot(a, b):
    """Row by row dot products; `b` may be one vector. Faster for three columns than einsum."""
    return a[:, 0] * b[..., 0] + a[:, 1] * b[..., 1] + a[:, 2] * b[..., 2]
