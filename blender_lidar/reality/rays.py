"""The rays that a real sensor shot towards a box: those that returned, and between them those that did not."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from ..metrics.vgop import to_vehicle_frame
from .rings import Rings

NO_POINT = -1
_TURN = 2.0 * math.pi
_CORNERS = np.array([(x, y, z) for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])


@dataclass(frozen=True, slots=True, eq=False)
class Rays:
    """Rays of one sweep.

    Attributes
    ----------
    origin, direction : ndarray, (k, 3)
        Where each starts [m, sensor frame], and its unit vector; through the point where it returned.
    point : ndarray of int64, (k,)
        Row of the sweep's point that it returned as; `NO_POINT` where it did not return.
    range_m : ndarray, (k,)
        How far away that point is along the ray [m]; inf where there is none.
    """

    origin: np.ndarray
    direction: np.ndarray
    point: np.ndarray
    range_m: np.ndarray

    def __len__(self) -> int:
        return len(self.point)


class Firings:
    """What a sensor fired during one sweep, recovered from what returned.

    Parameters
    ----------
    points : ndarray, (n, 3)
        The sweep's returns [m, sensor frame].
    rings : Rings
        Their rings.
    """

    def __init__(self, points: np.ndarray, rings: Rings) -> None:
        self._points, self._rings = points, rings
        azimuth = np.mod(rings.azimuths(points, rings.ring), _TURN)
        order = np.lexsort((azimuth, rings.ring))
        ends = np.searchsorted(rings.ring[order], np.arange(len(rings) + 1))
        self._of_ring = [order[a:b] for a, b in pairwise(ends)]
        # Three turns, so that a window never wraps.
        self._azimuth = [(azimuth[own] + np.array([[-_TURN], [0.0], [_TURN]])).ravel() for own in self._of_ring]

    def towards(self, centre: np.ndarray, size: np.ndarray, heading: float) -> Rays:
        """All rays that meet a box, which must not hold the sensor's axis.

        Parameters
        ----------
        centre, size : ndarray, (3,)
            Box centre; length, width and height [m, sensor frame].
        heading : float
            Counter-clockwise from +x [rad].
        """
        low, high, nearest, farthest = _window(centre, size, heading)
        margin = np.abs(self._rings.lateral_m).max() / nearest + self._rings.step_rad
        low, high = low - margin, high + margin
        slope, height = np.tan(self._rings.elevation_rad), self._rings.height_m
        ends = height + slope * np.array([[nearest], [farthest]])
        bottom, top = centre[2] - 0.5 * size[2], centre[2] + 0.5 * size[2]
        fitting = np.flatnonzero((ends.max(axis=0) >= bottom) & (ends.min(axis=0) <= top))
        found = [self._within(int(ring), low, high) for ring in fitting]
        azimuth = np.concatenate([np.empty(0), *(one[0] for one in found)])
        point = np.concatenate([np.empty(0, dtype=np.int64), *(one[1] for one in found)])
        ring = np.repeat(fitting, [len(one[0]) for one in found])
        rays = self._rays(azimuth, point, ring)
        entry, leave = crossing(rays, centre, size, heading)
        meets = (leave >= entry) & (leave > 0.0)
        return Rays(rays.origin[meets], rays.direction[meets], rays.point[meets], rays.range_m[meets])

    def _within(self, ring: int, low: float, high: float) -> tuple[np.ndarray, np.ndarray]:
        """Azimuths between two angles at which a ring fired, and the points that came of it."""
        azimuth, own, step = self._azimuth[ring], self._of_ring[ring], self._rings.step_rad
        first, last = np.searchsorted(azimuth, [low, high])
        # With a neighbour on either side: three turns hold one.
        nodes = azimuth[first - 1 : last + 1]
        point = own[np.arange(first - 1, first - 1 + len(nodes)) % len(own)]
        gap = np.diff(nodes)
        lacking = np.maximum(np.round(gap / step).astype(int) - 1, 0)  # firings without a return
        count = np.repeat(lacking, lacking)
        number = np.arange(len(count)) - np.repeat(np.cumsum(lacking) - lacking, lacking) + 1
        between = np.repeat(nodes[:-1], lacking) + np.repeat(gap, lacking) * number / (count + 1)
        every = np.concatenate([nodes, between])
        points = np.concatenate([point, np.full(len(between), NO_POINT)])
        inside = (every >= low) & (every <= high)
        return every[inside], points[inside]

    def _rays(self, azimuth: np.ndarray, point: np.ndarray, ring: np.ndarray) -> Rays:
        origin = self._rings.origins(ring, azimuth)
        elevation = self._rings.elevation_rad[ring]
        level = np.cos(elevation)
        direction = np.column_stack([np.cos(azimuth) * level, np.sin(azimuth) * level, np.sin(elevation)])
        returned = point != NO_POINT
        way = self._points[point[returned]] - origin[returned]
        distance = np.full(len(point), np.inf)
        distance[returned] = np.linalg.norm(way, axis=1)
        direction[returned] = way / distance[returned, None]
        return Rays(origin, direction, point, distance)


def crossing(rays: Rays, centre: np.ndarray, size: np.ndarray, heading: float) -> tuple[np.ndarray, np.ndarray]:
    """How far along each ray it enters and leaves a box, (k,) each [m]; it meets the box where it leaves it later."""
    start = to_vehicle_frame(rays.origin, centre, heading)
    way = to_vehicle_frame(rays.direction, np.zeros(3), heading)
    with np.errstate(divide="ignore"):
        inverse = 1.0 / np.where(way == 0.0, 1e-300, way)
    near, far = (-0.5 * size - start) * inverse, (0.5 * size - start) * inverse
    return np.minimum(near, far).max(axis=1), np.maximum(near, far).min(axis=1)


def _window(centre: np.ndarray, size: np.ndarray, heading: float) -> tuple[float, float, float, float]:
    """Lowest and highest azimuth of a box, the lowest within one turn [rad], and its nearest and farthest [m]."""
    cos, sin = math.cos(heading), math.sin(heading)
    corner = _CORNERS * size @ np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]]) + centre
    middle = math.atan2(centre[1], centre[0])
    relative = np.mod(np.arctan2(corner[:, 1], corner[:, 0]) - middle + math.pi, _TURN) - math.pi
    low = math.fmod(middle + float(relative.min()) + 2.0 * _TURN, _TURN)
    rho = np.hypot(corner[:, 0], corner[:, 1])
    own = to_vehicle_frame(np.array([[0.0, 0.0, centre[2]]]), centre, heading)[0, :2]
    away = np.maximum(np.abs(own) - 0.5 * size[:2], 0.0)
    return low, low + float(np.ptp(relative)), max(float(np.hypot(*away)), 0.1), float(rho.max())
