"""L-shape fitting: the rectangle about the points of a vehicle, of which a LiDAR sees one side or two, and its box."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

USUAL_M = {"car": (4.5, 1.8, 1.5), "van": (5.2, 2.0, 2.1), "truck": (9.0, 2.5, 3.2), "motorcycle": (2.1, 0.8, 1.4)}
"""Length, width and height of what is not seen whole [m]."""
LONG_M = 6.5  # longer than any car or van
_SEARCHES_DEG = (np.arange(-45.0, 45.0, 1.0), np.arange(-1.0, 1.05, 0.1))  # the second about the best of the first
_LEAST_EDGE_M = 0.05  # of the closeness criterion: points nearer to an edge count no more
_MOST_FITTED = 300  # points


def l_shape_heading(xy: np.ndarray) -> float:
    """The heading [rad], -46 to 45 degrees, whose rectangle has points (n, 2) [m] near its edges.

    A variant of the closeness criterion of Zhang, Xu, Dong and Dolan, "Efficient L-shape fitting for vehicle detection
    using laser scanners", IV 2017: each point counts by the nearest of all four edges.
    """
    xy, best = xy[:: len(xy) // _MOST_FITTED + 1] - xy.mean(axis=0), 0.0
    for turns in _SEARCHES_DEG:
        heading = np.radians(best + turns)
        cos, sin = np.cos(heading)[:, None], np.sin(heading)[:, None]
        nearest = np.full((len(heading), len(xy)), np.inf)
        for across in (cos * xy[:, 0] + sin * xy[:, 1], cos * xy[:, 1] - sin * xy[:, 0]):
            for edge in (across.min(axis=1, keepdims=True), across.max(axis=1, keepdims=True)):
                nearest = np.minimum(nearest, np.abs(across - edge))
        best += turns[(1.0 / np.maximum(nearest, _LEAST_EDGE_M)).sum(axis=1).argmax()]
    return math.radians(best)


class LShape(NamedTuple):
    """The rectangle about the points of a vehicle, from above.

    `heading` [rad]; `turn` (2, 2) takes rows of places to along and across it; `low` and `high` (2,) are the ends of
    the points in that frame [m].
    """

    heading: float
    turn: np.ndarray
    low: np.ndarray
    high: np.ndarray

    @classmethod
    def about(cls, xy: np.ndarray, heading: float) -> LShape:
        """The rectangle of a heading [rad] about points (n, 2) [m]."""
        cos, sin = math.cos(heading), math.sin(heading)
        turn = np.array([[cos, -sin], [sin, cos]])
        local = xy @ turn
        return cls(heading, turn, local.min(axis=0), local.max(axis=0))

    @property
    def seen(self) -> np.ndarray:
        """How long and wide the points are, (2,) [m]."""
        return self.high - self.low

    def facing(self, lidars: np.ndarray) -> np.ndarray:
        """Which end and which side face LiDARs (m, 2) [m], (2,): 1 the higher, -1 the lower, 0 both or none alone."""
        local = lidars @ self.turn
        return (local > self.high).any(axis=0).astype(int) - (local < self.low).any(axis=0)

    def centre(self, size: np.ndarray, lidars: np.ndarray) -> np.ndarray:
        """Centre (2,) [m] of a box of a length and width `size` (2,): what is not seen lies away from the LiDARs.

        Where they see both sides or neither, it lies to both.
        """
        facing, half = self.facing(lidars), 0.5 * np.asarray(size)
        ends = np.where(facing > 0, self.high - half, self.low + half)
        return self.turn @ np.where(facing == 0, 0.5 * (self.low + self.high), ends)
