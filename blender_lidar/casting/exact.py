"""The oracle: every ray against every triangle in float64, Moeller and Trumbore's test, and never a miss too many.

The signed volumes that the test compares with 0 are known to within a rounding error that is bounded here, and they
count as 0 up to that bound. So a ray that meets a triangle in exact arithmetic meets it here too: at vertices, edges
and tips, at grazing incidence, and far from the origin. What is met in excess lies within that rounding of the ray.
"""

from __future__ import annotations

import numpy as np

from .protocol import Caster, Returns, TrianglePlanes, cross, dot, origins_of

_EDGE_TOLERANCE = 1e-12  # barycentric: a ray at an edge belongs to both neighbours, so that it slips through neither
# Each signed volume is made of a dozen rounded operations on coordinates that are themselves rounded.
_ROUNDING = 32.0 * np.finfo(float).eps
_GROUP = 4  # triangles that are passed over together; neighbours in the list tend to be neighbours in space
_BATCH = 1 << 20  # pairs of a ray and a group tested at a time
_SLACK = 1e-9  # relative, of squared distances: what rounding may hide when pairs are passed over


class ExactCaster(Caster):
    """Casts in float64 without any tree: slow, and right. The judge of the others."""

    name = "exact"

    def _meet(self, origins, directions, max_range):
        return self._exact.meet(origins, directions, max_range)


class ExactSearch:
    """Which of a fixed set of triangles a ray meets first, and where, in float64.

    Parameters
    ----------
    corners : ndarray, (m, 3, 3)
        Corners of each triangle [m]; all have area, and there is at least one.
    planes : TrianglePlanes
        Of the same triangles: all casters measure with them, and so alike.
    """

    def __init__(self, corners: np.ndarray, planes: TrianglePlanes) -> None:
        self._corners, self._planes = corners, planes
        self._edges = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
        sides = *self._edges, self._edges[1] - self._edges[0]
        side_1, side_2, side_3 = (np.linalg.norm(side, axis=1) for side in sides)
        self._size = np.maximum(np.maximum(side_1, side_2), side_3)
        self._least_volume = _ROUNDING * side_1 * side_2
        self._farthest = np.linalg.norm(corners, axis=2).max(axis=1)  # corner, from where coordinates are counted
        self._middle = corners.mean(axis=1)
        self._radius = np.linalg.norm(corners - self._middle[:, None], axis=2).max(axis=1) + _ROUNDING * self._farthest
        starts = np.arange(0, len(corners), _GROUP)
        size = np.diff(starts, append=len(corners))
        self._group_middle = np.add.reduceat(self._middle, starts) / size[:, None]
        to_middle = np.linalg.norm(self._middle - np.repeat(self._group_middle, size, axis=0), axis=1)
        self._group_radius = np.maximum.reduceat(to_middle + self._radius, starts)

    def meet(self, origins: np.ndarray, directions: np.ndarray, max_range: float) -> Returns:
        """What rays meet first, up to `max_range` [m]; `origins` (3,) or (n, 3) [m], unit `directions` (n, 3)."""
        step, parts = max(_BATCH // len(self._group_middle), 1), []
        for start in range(0, len(directions), step):
            some = np.arange(start, min(start + step, len(directions)))
            part = self._meet_some(origins_of(origins, some), directions[some], max_range)
            parts.append(part._replace(ray=part.ray + start))
        return Returns(*map(np.concatenate, zip(*parts, strict=True)))

    def _meet_some(self, origins, directions, max_range):
        ray, triangle = self._near_pairs(origins, directions)
        distance = self._distance(origins_of(origins, ray), directions[ray], triangle)
        met = distance <= max_range
        ray, triangle, distance = ray[met], triangle[met], distance[met]
        order = np.lexsort((triangle, distance))  # nearest first; of equals the lowest triangle
        ray, at = np.unique(ray[order], return_index=True)
        return Returns(ray, triangle[order][at], distance[order][at])

    def _near_pairs(self, origins, directions):
        """Pairs (ray, triangle) whose ray pierces the triangle's bounding sphere: the others cannot meet."""
        towards = self._group_middle - origins[..., None, :]  # (groups, 3) or (rays, groups, 3)
        along = directions @ towards.T if origins.ndim == 1 else np.einsum("rgi,ri->rg", towards, directions)
        ray, group = np.nonzero(_pierced(along, towards, self._group_radius))
        ray, triangle = np.repeat(ray, _GROUP), np.add.outer(_GROUP * group, np.arange(_GROUP)).ravel()
        there = triangle < len(self._middle)  # the last group may be smaller
        ray, triangle = ray[there], triangle[there]
        towards = self._middle[triangle] - origins_of(origins, ray)
        pierced = _pierced(dot(towards.T, directions[ray].T), towards, self._radius[triangle])
        return ray[pierced], triangle[pierced]

    def _distance(self, origins, directions, triangle):
        """Distance of each pair, inf where they do not meet (Moeller and Trumbore 1997, two-sided)."""
        rays, size = directions.T, self._size[triangle]
        edge_1, edge_2 = self._edges[0][triangle].T, self._edges[1][triangle].T
        p, s = cross(rays, edge_2), (origins - self._corners[triangle, 0]).T
        q, whole = cross(s, edge_1), dot(edge_1, p)
        facing = np.sign(whole)
        whole, second, third, ahead = np.abs(whole), facing * dot(s, p), facing * dot(rays, q), dot(edge_2, q)
        rounding = _ROUNDING * size * (self._farthest[triangle] + np.linalg.norm(origins, axis=-1))
        low = -_EDGE_TOLERANCE * whole - rounding
        met = (second >= low) & (third >= low) & (second + third <= whole - low) & (facing * ahead >= -rounding * size)
        met = np.flatnonzero(met & (whole > self._least_volume[triangle]))  # a ray along a triangle's plane misses it
        distance = np.full(len(triangle), np.inf)
        distance[met] = self._along(origins_of(origins, met), directions[met], triangle[met])
        return distance

    def _along(self, origins, directions, triangle):
        """Distance along rays to triangles that they meet: to their planes, but within the triangles' extent."""
        there = self._planes.meet(origins.T, directions.T, triangle).distance
        corners = np.einsum("tci,ti->tc", self._corners[triangle] - origins[..., None, :], directions)
        return np.clip(there, np.maximum(corners.min(axis=1), 0.0), np.maximum(corners.max(axis=1), 0.0))


def _pierced(along, towards, radius):
    """Ray-sphere test; the spheres' middles lie at `towards` (..., 3) from the origin and at `along` the ray."""
    square = np.einsum("...i,...i->...", towards, towards)
    least = square * (1.0 - _SLACK) - radius * radius  # of the square of `along`
    return along * np.abs(along) >= np.where(least > 0.0, least, -np.inf)  # from within a sphere any ray
