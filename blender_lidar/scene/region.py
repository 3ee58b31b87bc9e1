"""The region of interest: where vehicles count, the same for every mounting, sensor and search that are compared."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..errors import InputError
from ..road.road_map import RoadMap
from ..traffic.vehicles import Vehicles
from .settings import RegionSettings

_ON_EDGE_M = 1e-9  # a box centre this near to an edge lies on it


@dataclass(frozen=True, slots=True, eq=False)
class Region:
    """Where vehicles count, by their box centres; its edge belongs to it.

    Attributes
    ----------
    centre_xy, radius_m
        The circle, or with another form the circle about all of it [m, site frame].
    polygon : sequence of (x, y)
        Corners of its outline [m]; none for another form.
    stretches : sequence of (s_m, lanes)
        From where to where along the road [m], and the recording's lanes; None for all that the road has.
    keep_out : sequence of polygons
        What lies in one of them does not count.
    road : RoadMap or None
        What the stretches are of.
    """

    centre_xy: tuple[float, float]
    radius_m: float
    polygon: Sequence[Sequence[float]] = ()
    stretches: Sequence[tuple[Sequence[float], Sequence[int] | None]] = ()
    keep_out: Sequence[Sequence[Sequence[float]]] = ()
    road: RoadMap | None = None

    def distance(self, vehicles: Vehicles) -> np.ndarray:
        """Horizontal distance of each box centre from the middle, (n,) [m]."""
        return np.hypot(*(vehicles.centre_m[:, :2] - self.centre_xy).T)

    def holds(self, vehicles: Vehicles) -> np.ndarray:
        """Which box centres lie inside, (n,) bool."""
        xy = vehicles.centre_m[:, :2]
        if self.polygon:
            inside = polygon_holds(self.polygon, xy)
        elif self.stretches:
            inside = self._on_stretches(vehicles)
        else:
            inside = self.distance(vehicles) <= self.radius_m
        for polygon in self.keep_out:
            inside &= ~polygon_holds(polygon, xy)
        return inside

    def _on_stretches(self, vehicles: Vehicles) -> np.ndarray:
        """Which lie on a stretch, (n,) bool; of boxes without lanes, such as detections, on the road's alone."""
        inside, located = np.zeros(len(vehicles), dtype=bool), self.road.locate(vehicles.centre_m)
        for (low, high), lanes in self.stretches:
            along = (located.s_m >= low - _ON_EDGE_M) & (located.s_m <= high + _ON_EDGE_M)
            inside |= along & (located.lane >= 0 if lanes is None else np.isin(vehicles.lane, lanes))
        return inside


def region_of(settings: RegionSettings, road: RoadMap) -> Region:
    """The region that a scene's settings, once resolved, describe.

    A stretch lies between the edges of the carriageway; one of the recording's lanes wherever these are.
    """
    if settings.polygon_m is None and not settings.stretches:
        return Region(settings.centre_m, settings.radius_m, keep_out=settings.keep_out or ())
    stretches = [(one.x_m, one.lanes) for one in settings.stretches]
    outlines = [settings.polygon_m] if settings.polygon_m else [one for s, _ in stretches for one in road.area(s_m=s)]
    corners = np.concatenate([np.asarray(outline, dtype=float) for outline in outlines])
    low, high = corners.min(axis=0), corners.max(axis=0)
    centre = 0.5 * (low + high)
    radius = float(np.hypot(*(corners - centre).T).max())
    return Region(tuple(centre.tolist()), radius, settings.polygon_m or (), stretches, settings.keep_out or (), road)


# --- Polygons -------------------------------------------------------------------------------------------------------


def polygon_holds(polygon: Sequence[Sequence[float]], xy: np.ndarray) -> np.ndarray:
    """Point in polygon by the even-odd rule, its edge included: which of the points `xy` (n, 2) lie inside, (n,) bool.

    `polygon` are its corners (m, 2) in the order of its outline, in the unit of the points.
    """
    start = np.asarray(polygon, dtype=float)
    edge = np.roll(start, -1, axis=0) - start
    x, y = (xy[:, None, axis] - start[:, axis] for axis in (0, 1))  # (n, m), of each point from each corner
    crossed = (y < 0.0) != (y < edge[:, 1])  # edges that the level of the point meets; the lower end belongs to one
    with np.errstate(divide="ignore", invalid="ignore"):
        inside = (crossed & (x < edge[:, 0] * (y / edge[:, 1]))).sum(axis=1) % 2 == 1
    along = np.clip((x * edge[:, 0] + y * edge[:, 1]) / np.square(edge).sum(axis=1), 0.0, 1.0)
    off = np.hypot(x - along * edge[:, 0], y - along * edge[:, 1])
    return inside | (off <= _ON_EDGE_M).any(axis=1)


def check_polygon(polygon: Sequence[Sequence[float]], where: str) -> None:
    """Refuse corners that are no simple polygon: fewer than three, two that are one, or sides that cross.

    Raises
    ------
    InputError
        Naming `where` they came from.
    """
    corners = [tuple(corner) for corner in polygon]
    if len(corners) < 3 or len(set(corners)) < len(corners):
        raise InputError(f"{where}: has {len(set(corners))} different corners of {len(corners)}; allowed: 3 or more")
    sides = list(zip(corners, corners[1:] + corners[:1], strict=True))
    for first in range(len(sides)):
        for second in range(first + 1, len(sides)):
            neighbours = second - first in (1, len(sides) - 1)
            if not neighbours and _cross(*sides[first], *sides[second]):
                raise InputError(f"{where}: sides {first + 1} and {second + 1} cross; allowed: corners in their order")
    if not np.ptp([_turn(corners[0], corners[1], corner) for corner in corners]):
        raise InputError(f"{where}: all its corners lie on one line; allowed: a polygon with an area")


def _turn(a, b, c) -> float:
    """Above 0 where c lies to the left of the way from a to b."""
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


def _cross(a, b, c, d) -> bool:
    return _turn(a, b, c) * _turn(a, b, d) < 0.0 and _turn(c, d, a) * _turn(c, d, b) < 0.0
