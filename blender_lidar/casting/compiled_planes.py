"""The same as `planes`, compiled: one pass over the rays."""

from __future__ import annotations

import numpy as np

from ..compiled import compiled
from .planes import PlaneHits, TrianglePlanes


class CompiledPlanes(TrianglePlanes):
    """The planes of triangles."""

    def __init__(self, corners: np.ndarray, normal: np.ndarray) -> None:
        super().__init__(corners, normal)
        self._rows = super().as_rows()

    def as_rows(self) -> np.ndarray:
        return self._rows

    def meet(self, origins: np.ndarray, directions: np.ndarray, triangle: np.ndarray) -> PlaneHits:
        shared = origins.ndim == 1
        starts = origins[:, None] if shared else origins
        return PlaneHits(*_meet(self._rows, starts, shared, directions, triangle))


@compiled
def _meet(planes, origins, shared, directions, triangle):
    rays = len(triangle)
    distance, facing, inside = np.empty(rays), np.empty(rays), np.empty(rays, dtype=np.bool_)
    for k in range(rays):
        t, start = triangle[k], 0 if shared else k
        ox, oy, oz = origins[0, start], origins[1, start], origins[2, start]
        x, y, z = directions[0, k], directions[1, k], directions[2, k]
        missing = planes[t, 3] - (planes[t, 0] * ox + planes[t, 1] * oy + planes[t, 2] * oz)
        facing[k] = planes[t, 0] * x + planes[t, 1] * y + planes[t, 2] * z
        distance[k] = missing / facing[k]
        missing = planes[t, 7] - (planes[t, 4] * ox + planes[t, 5] * oy + planes[t, 6] * oz)
        second = (planes[t, 4] * x + planes[t, 5] * y + planes[t, 6] * z) * distance[k] - missing
        missing = planes[t, 11] - (planes[t, 8] * ox + planes[t, 9] * oy + planes[t, 10] * oz)
        third = (planes[t, 8] * x + planes[t, 9] * y + planes[t, 10] * z) * distance[k] - missing
        inside[k] = distance[k] >= 0.0 and second >= 0.0 and third >= 0.0 and second + third <= 1.0
    return distance, facing, inside
