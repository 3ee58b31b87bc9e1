"""The ground plane of a point cloud, by trimmed least squares: what heights are counted from, however a LiDAR hangs."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np


class Ground(NamedTuple):
    """A plane: z = `level` + `slope_x` x + `slope_y` y [m], x and y counted from the LiDAR [m], slopes by metre.

    `residual_m` is how far the points within 0.3 m lie off it in the median; NaN where there were too few for a plane,
    which is then z = 0.
    """

    level: float
    slope_x: float
    slope_y: float
    residual_m: float

    def height(self, xy: np.ndarray) -> np.ndarray:
        """Its z at places (n, 2) [m, from the LiDAR], (n,) [m]."""
        return self.level + self.slope_x * xy[:, 0] + self.slope_y * xy[:, 1]

    def above(self, points: np.ndarray) -> np.ndarray:
        """Height above it of points (n, 3), (n,) [m]."""
        return points[:, 2] - self.height(points[:, :2])


_TOLERANCES_M = ((0.3, 0.03), (0.3, 0.015), (0.2, 0.005), (0.12, 0.0), (0.08, 0.0))  # and by metre of range
_FEWEST_GROUND, _ON_GROUND_M = 50, 10.0  # points, and how far they must spread both ways
_NEAR_GROUND_M = 0.3
_MOST_FITTED = 5000  # points, evenly from all beams


def fit_ground(points: np.ndarray) -> Ground:
    """The ground plane of a cloud, by least squares over points that lie ever nearer to the last one.

    Parameters
    ----------
    points : ndarray, (n, 3)
        x and y counted from the LiDAR, z from where the ground is believed to be [m].
    """
    points = points[:: max(1, len(points) // _MOST_FITTED)]
    ground = Ground(0.0, 0.0, 0.0, math.nan)
    reach = np.hypot(points[:, 0], points[:, 1])
    for fixed, by_range in _TOLERANCES_M:
        off = np.abs(ground.above(points))
        near = off < fixed + by_range * reach
        if near.sum() < _FEWEST_GROUND or np.ptp(points[near, :2], axis=0).min() < _ON_GROUND_M:
            return Ground(0.0, 0.0, 0.0, math.nan)
        some = points[near]
        system = np.column_stack([np.ones(len(some)), some[:, :2]])
        level, *slopes = np.linalg.lstsq(system, some[:, 2], rcond=None)[0].tolist()
        ground = Ground(level, *slopes, 0.0)
    off = np.abs(ground.above(points))
    return ground._replace(residual_m=float(np.median(off[off < _NEAR_GROUND_M])))
