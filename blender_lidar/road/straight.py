"""The straight road of [road], as a road map: x in the direction of travel, y to the left."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

from ..names import SIDES
from ..toml_table import setting

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy as np

    from .road_map import RoadMap

_LARGEST_M = 1e6  # sums and squares stay finite
_ON_EDGE_M = 1e-5  # what lies this near to an edge of a carriageway lies beside it


@dataclass(frozen=True, slots=True)
class StraightRoad:
    """[road], the road frame beside a straight road: x in the direction of travel, y to the left.

    The defaults are I-80's: past the on-ramp, whose acceleration lane ends at Local_Y 202 m.

    Attributes
    ----------
    drives_on : str
        The side of the road on which vehicles drive.
    carriageways : int
        1, with traffic along +x; or 2 with a median between them: along +x on the side of drives_on, against it on the
        other.
    median_m : float or None
        Width of the median [m]; 0 where both directions share one carriageway.
    station_m : float
        Local_Y of x = 0 [m].
    right_edge_m : float
        Local_X of the carriageway's right edge [m]; 72 ft on I-80.
    setback_m : float
        Distance from the line y = 0 to the right edge of the road [m].
    lanes : int
        Number of lanes of a carriageway.
    lane_width_m : float
        Width of one lane [m].
    grade_percent : float
        Longitudinal slope: rise of the road along +x [m] per 100 m; masts stay plumb.
    cross_fall_percent : float
        Cross-fall: fall of the road towards -y, the side of y = 0 [m] per 100 m; below 0 it falls towards +y.
    crown_percent : float
        Fall of a carriageway from its middle line to both edges [m] per 100 m; the edges lie at z = 0.
    """

    drives_on: str = setting(SIDES[0], allowed=SIDES[:2])
    carriageways: int = setting(1, low=1, high=2)
    median_m: float | None = setting(None, low=0.0, high=200.0)
    station_m: float = setting(250.0, low=-_LARGEST_M, high=_LARGEST_M)
    right_edge_m: float = setting(21.9456, low=-_LARGEST_M, high=_LARGEST_M)
    setback_m: float = setting(2.0, low=-_LARGEST_M, high=_LARGEST_M)
    lanes: int = setting(6, low=1, high=50)
    lane_width_m: float = setting(3.66, low=1.0, high=10.0)
    grade_percent: float = setting(0.0, low=-12.0, high=12.0)
    cross_fall_percent: float = setting(0.0, low=-8.0, high=8.0)
    crown_percent: float = setting(0.0, low=0.0, high=6.0)

    @property
    def carriageways_y(self) -> tuple[tuple[float, float], ...]:
        """The y [m] of the right and the left edge of each carriageway, from the right."""
        width, step = self.lanes * self.lane_width_m, self.median_m or 0.0
        right = (self.setback_m + number * (width + step) for number in range(self.carriageways))
        return tuple((edge, edge + width) for edge in right)

    def place(self, side: str) -> tuple[float, float]:
        """The y [m] of a mast on a side of the road, and which way it faces [rad], both square to the road.

        As far from the left edge as the line y = 0 is from the right one; in the middle of the median, or over the
        middle of the carriageway that drives along +x.
        """
        edges = self.carriageways_y
        right, left = edges[0][0], edges[-1][1]
        if side == "left":
            return left + self.setback_m, 1.5 * math.pi
        if side == "median":
            return 0.5 * (edges[0][1] + edges[-1][0]), 0.5 * math.pi
        if side == "gantry":
            return 0.5 * sum(edges[-1 if self.drives_on == "left" else 0]), 0.5 * math.pi
        return right - self.setback_m, 0.5 * math.pi

    @property
    def faced_from_any_side(self) -> bool:
        """Whether masts face the road from where they stand unless said; else all face +y."""
        return self.drives_on != SIDES[0] or self.carriageways > 1

    def side_of(self, xy: Sequence[float]) -> str:
        """The side of the road on which a place [m] lies; a gantry's, where it is over a carriageway."""
        edges, y_m = self.carriageways_y, xy[1]
        if y_m <= edges[0][0] + _ON_EDGE_M or y_m >= edges[-1][1] - _ON_EDGE_M:
            return "right" if y_m <= edges[0][0] + _ON_EDGE_M else "left"
        over = any(right + _ON_EDGE_M < y_m < left - _ON_EDGE_M for right, left in edges)
        return "gantry" if over or not self.median_m else "median"

    def of_ngsim(self, along_m: np.ndarray, right_m: np.ndarray) -> np.ndarray:
        """Places of NGSIM, (n, 2) [m, road frame]: Local_Y along travel, and Local_X from the left edge [m], (n,)."""
        import numpy as np

        return np.stack([along_m - self.station_m, self.setback_m + (self.right_edge_m - right_m)], axis=1)

    def in_ngsim(self, s_m: np.ndarray, t_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Local_Y and Local_X [m] of stations and offsets [m]."""
        return s_m + self.station_m, self.setback_m + self.right_edge_m - t_m

    @property
    def is_level(self) -> bool:
        """Whether the vertical stands square on the road's plane."""
        return self.grade_percent == self.cross_fall_percent == 0.0

    @property
    def slopes(self) -> dict[str, float]:
        """What of it is not level, by the settings' names."""
        keys = ("grade_percent", "cross_fall_percent", "crown_percent")
        return {key: getattr(self, key) for key in keys if getattr(self, key)}

    @property
    def up(self) -> tuple[float, float, float]:
        """The vertical in the road frame, whose z stands square on the road's plane.

        With u along x and v along y, both level, the plane is ``z = grade u + cross_fall v``, and the road frame's x
        lies in it above u.
        """
        if self.is_level:
            return 0.0, 0.0, 1.0
        grade, fall = 0.01 * self.grade_percent, 0.01 * self.cross_fall_percent
        along, whole = math.hypot(1.0, grade), math.hypot(1.0, grade, fall)
        return grade / along, fall / (along * whole), 1.0 / whole

    @property
    def surface(self) -> CrownedSurface:
        """The carriageway above the plane z = 0; one of both directions has one crown."""
        edges = self.carriageways_y if self.median_m else ((self.carriageways_y[0][0], self.carriageways_y[-1][1]),)
        return CrownedSurface(edges, 0.01 * self.crown_percent)


@dataclass(frozen=True, slots=True)
class CrownedSurface:
    """Carriageways along x that fall from their middle lines to both edges, y [m], which lie at z = 0."""

    edges_y: tuple[tuple[float, float], ...]
    fall: float

    @property
    def is_flat(self) -> bool:
        """Whether it is the plane z = 0."""
        return not self.fall

    def height(self, xy: np.ndarray) -> np.ndarray:
        """Height above the plane z = 0 at places (n, 2) [m], (n,)."""
        halves = ((right, 0.5 * (left - right)) for right, left in self.edges_y)
        return sum(self.fall * (half - abs(xy[..., 1] - right - half)).clip(0.0) for right, half in halves)

    def triangles(self, centre_m: Sequence[float], reach_m: float) -> np.ndarray:
        """Both planes of each carriageway within reach along x [m], (4 or 8, 3, 3); nothing where it is flat."""
        import numpy as np

        planes, ends = [np.empty((0, 3, 3))], (centre_m[0] - reach_m, centre_m[0] + reach_m)
        for right, left in self.edges_y if self.fall else ():
            y = np.array([right, 0.5 * (right + left), left])
            rows = np.stack([np.stack([np.full(3, x), y], axis=1) for x in ends])
            rows = np.concatenate([rows, self.height(rows)[..., None]], axis=-1)
            a, b, c, d = rows[0, :-1], rows[1, :-1], rows[1, 1:], rows[0, 1:]
            planes += [np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)]
        return np.concatenate(planes)


@lru_cache(maxsize=8)
def road_map(road: StraightRoad) -> RoadMap:
    """The map of a straight road: its lanes from the right to the left, without ends, with x as their station."""
    import numpy as np

    from .road_map import RoadMap

    of_lanes = (np.arange(road.lanes) + 0.5) * road.lane_width_m
    middle = np.concatenate([right + of_lanes for right, _ in road.carriageways_y])
    along_x = road.place("gantry")[0]  # the carriageway that drives along +x is about it
    against = np.abs(middle - along_x) > 0.5 * road.lanes * road.lane_width_m
    lanes = tuple(np.array([[0.0, y], [1.0, y]]) for y in middle)
    zeros, width = np.zeros(len(middle)), np.full(len(middle), road.lane_width_m)
    return RoadMap(lanes, zeros, middle, width, against, road.surface, road.up, endless=True)
