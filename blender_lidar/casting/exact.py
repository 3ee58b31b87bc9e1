"""The oracle: every ray against every triangle in float64, Moeller and Trumbore's test."""

from __future__ import annotations

import numpy as np

from .protocol import Caster, Returns, origins_of

_EDGE_TOLERANCE = 1e-12  # barycentric: a ray at an edge belongs to both neighbours, so that it slips through neither
_GROUP = 4  # triangles that are passed over together; neighbours in the list tend to be neighbours in space
_BATCH = 1 << 20  # pairs of a ray and a group tested at a time
_SLACK = 1e-9  # relative, of squared distances: what rounding may hide when pairs are passed over


class ExactCaster(Caster):
    """Casts in float64 without any tree: slow, and right. The judge of the others."""

    name = "exact"

    def _prepare(self):
        corners = self._corners
        self._edges = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
        self._middle = corners.mean(axis=1)
        self._radius = np.linalg.norm(corners - self._middle[:, None], axis=2).max(axis=1)
        starts = np.arange(0, len(corners), _GROUP)
        size = np.diff(starts, append=len(corners))
        self._group_middle = np.add.reduceat(self._middle, starts) / size[:, None]
        to_middle = np.linalg.norm(self._middle - np.repeat(self._group_middle, size, axis=0), axis=1)
        self._group_radius = np.maximum.reduceat(to_middle + self._radius, starts)

    def _meet(self, origins, directions, max_range):
        step = max(_BATCH // len(self._group_middle), 1)
        rays = np.arange(len(directions))
        parts = [
            self._meet_some(
                origins_of(origins, rays[start : start + step]), directions[start : start + step], max_range
            )
            for start in range(0, len(rays), step)
        ]
        ray = [part.ray + start for start, part in zip(range(0, len(rays), step), parts, strict=True)]
        _, triangle, distance = map(np.concatenate, zip(*parts, strict=True))
        return Returns(np.concatenate(ray), triangle, distance)

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
        triangle = np.add.outer(_GROUP * group, np.arange(_GROUP)).ravel()
        ray = np.repeat(ray, _GROUP)
        if len(triangle) and len(self._middle) % _GROUP:
            there = triangle < len(self._middle)
            ray, triangle = ray[there], triangle[there]
        towards = self._middle[triangle] - origins_of(origins, ray)
        pierced = _pierced(_dot(towards, directions[ray]), towards, self._radius[triangle])
        return ray[pierced], triangle[pierced]

    def _distance(self, origins, directions, triangle):
        """Distance of each pair, inf where they do not meet (Moeller and Trumbore 1997, two-sided)."""
        edge_1, edge_2 = self._edges[0][triangle], self._edges[1][triangle]
        p = _cross(directions, edge_2)
        determinant = _dot(edge_1, p)
        s = origins - self._corners[triangle, 0]
        q = _cross(s, edge_1)
        with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
            u, v, distance = _dot(s, p) / determinant, _dot(directions, q) / determinant, _dot(edge_2, q) / determinant
            low = -_EDGE_TOLERANCE
            meets = (u >= low) & (v >= low) & (u + v <= 1.0 - low) & (distance >= 0.0)
        return np.where(meets, distance, np.inf)


def _pierced(along, towards, radius):
    """Whether rays pierce spheres, whose middles lie at `towards` (..., 3) from the origin and at `along` the ray."""
    square = np.einsum("...i,...i->...", towards, towards)
    least = square * (1.0 - _SLACK) - radius * radius  # of the square of `along`
    return along * np.abs(along) >= np.where(least > 0.0, least, -np.inf)  # whatever the ray from within a sphere


def _cross(a, b):
    """Cross products of rows; for few of them faster than `np.cross`."""
    (ax, ay, az), (bx, by, bz) = a.T, b.T
    return np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], axis=1)


def _dot(a, b):
    return np.einsum("ij,ij->i", a, b)
