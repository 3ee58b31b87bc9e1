"""The oracle: every ray against every triangle in float64, Moeller and Trumbore's test."""

from __future__ import annotations

import numpy as np

from .protocol import MISS, Caster

_EDGE_TOLERANCE = 1e-12  # barycentric: a ray at an edge belongs to both neighbours, so that it slips through neither
_BATCH = 1 << 20  # ray-triangle pairs tested at a time


class ExactCaster(Caster):
    """Casts in float64 without any tree: slow, and right. The judge of the others."""

    name = "exact"
    leaks = False

    def _build(self, corners):
        self._edges = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
        self._middle = corners.mean(axis=1)
        self._radius = np.linalg.norm(corners - self._middle[:, None], axis=2).max(axis=1)

    def _first(self, origins, directions, reach):
        first = np.full(len(directions), MISS, dtype=np.int64)
        nearest = np.full(len(directions), np.inf)
        same_origin = origins.ndim == 1
        step = max(_BATCH // max(len(directions), 1), 1)
        for start in range(0, len(self._corners), step):
            stop = min(start + step, len(self._corners))
            triangle, ray = self._near_pairs(origins, directions, start, stop)
            distance = self._distance(origins if same_origin else origins[ray], directions[ray], triangle)
            distance[distance > reach] = np.inf
            order = np.lexsort((triangle, distance))  # nearest first; of equals the lowest triangle
            ray, triangle, distance = ray[order], triangle[order], distance[order]
            ray, at = np.unique(ray, return_index=True)
            nearer = distance[at] < nearest[ray]
            nearest[ray[nearer]] = distance[at][nearer]
            first[ray[nearer]] = triangle[at][nearer]
        return first

    def _near_pairs(self, origins, directions, start, stop):
        """Pairs (triangle, ray) whose ray's line passes the triangle's bounding sphere: the others cannot meet."""
        towards = self._middle[start:stop, None, :] - origins
        along = np.einsum("trj,rj->tr", np.broadcast_to(towards, (stop - start, len(directions), 3)), directions)
        square = np.einsum("trj,trj->tr", towards, towards)
        radius = self._radius[start:stop, None] * (1.0 + 1e-9) + 1e-9
        triangle, ray = np.nonzero((square - along * along <= radius * radius + 1e-9 * square) & (along >= -radius))
        return triangle + start, ray

    def _distance(self, origins, directions, triangle):
        """Distance of each pair, inf where they do not meet (Moeller and Trumbore 1997, two-sided)."""
        edge_1, edge_2 = self._edges[0][triangle], self._edges[1][triangle]
        p = np.cross(directions, edge_2)
        determinant = np.einsum("ij,ij->i", edge_1, p)
        s = origins - self._corners[triangle, 0]
        q = np.cross(s, edge_1)
        with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
            u = np.einsum("ij,ij->i", s, p) / determinant
            v = np.einsum("ij,ij->i", directions, q) / determinant
            distance = np.einsum("ij,ij->i", edge_2, q) / determinant
            low = -_EDGE_TOLERANCE
            meets = (u >= low) & (v >= low) & (u + v <= 1.0 - low) & (distance >= 0.0)
        return np.where(meets, distance, np.inf)
