"""Straight road: the road map that the numbers of [road] make, its lanes without ends along x."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..names import SIDES
from .road_map import RoadMap
from .settings import RoadSettings


def straight_road(road: RoadSettings) -> RoadMap:
    """The map of a straight road: its lanes from the right to the left, without ends, with x as their station."""
    of_lanes = (np.arange(road.lanes) + 0.5) * road.lane_width_m
    middle = np.concatenate([right + of_lanes for right, _ in road.carriageways_y])
    along_x = road.place("gantry")[0]  # the carriageway that drives along +x is about it
    against = np.abs(middle - along_x) > 0.5 * road.lanes * road.lane_width_m
    return RoadMap(
        points_m=tuple(np.array([[0.0, y], [1.0, y]]) for y in middle),
        station_m=np.zeros(len(middle)),
        offset_m=middle,
        width_m=np.full(len(middle), road.lane_width_m),
        against=against,
        surface=_surface(road),
        up=road.up,
        endless=True,
        drives_on=road.drives_on,
        carriageways_t=road.carriageways_y,
        facing_of={side: road.place(side)[1] for side in SIDES},
    )


def _surface(road: RoadSettings) -> CrownedSurface:
    """The carriageways above the plane z = 0; both directions on one carriageway have one crown."""
    edges = road.carriageways_y if road.median_m else ((road.carriageways_y[0][0], road.carriageways_y[-1][1]),)
    return CrownedSurface(edges, 0.01 * road.crown_percent)


@dataclass(frozen=True, slots=True)
class CrownedSurface:
    """Carriageways along x that fall from their middle lines to both edges, y [m], which lie at z = 0."""

    edges_y: tuple[tuple[float, float], ...]
    fall: float

    @property
    def is_flat(self) -> bool:
        """Whether it is the plane z = 0."""
        return not self.fall

    @property
    def is_ground(self) -> bool:
        """Whether it lies in place of the plane z = 0: no, on it, as the edges and what is beside them lie at 0."""
        return False

    def height(self, xy: np.ndarray) -> np.ndarray:
        """Height above the plane z = 0 at places (n, 2) [m], (n,)."""
        halves = ((right, 0.5 * (left - right)) for right, left in self.edges_y)
        return sum(self.fall * (half - abs(xy[..., 1] - right - half)).clip(0.0) for right, half in halves)

    def triangles(self, centre_m: Sequence[float], reach_m: float) -> np.ndarray:
        """Both planes of each carriageway within reach along x [m], (4 or 8, 3, 3); nothing where it is flat."""
        planes, ends = [np.empty((0, 3, 3))], (centre_m[0] - reach_m, centre_m[0] + reach_m)
        for right, left in self.edges_y if self.fall else ():
            y = np.array([right, 0.5 * (right + left), left])
            rows = np.stack([np.stack([np.full(3, x), y], axis=1) for x in ends])
            rows = np.concatenate([rows, self.height(rows)[..., None]], axis=-1)
            a, b, c, d = rows[0, :-1], rows[1, :-1], rows[1, 1:], rows[0, 1:]
            planes += [np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)]
        return np.concatenate(planes)
