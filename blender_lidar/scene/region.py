"""The region of interest: where vehicles count, the same for every mounting, sensor and search that are compared."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np

from ..errors import InputError, unknown_name
from ..road.approaches import Spans, approach_spans, approaches_to, junction_named
from ..road.road_map import RoadMap, polygon_holds
from ..traffic.boxes import Boxes
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
        What the stretches and the lanes are of.
    spans : dict
        Lanes of a map, by their rows, from which station to which [m].
    areas : sequence of polygons
        Areas of junctions, which count besides these lanes.
    """

    centre_xy: tuple[float, float]
    radius_m: float
    polygon: Sequence[Sequence[float]] = ()
    stretches: Sequence[tuple[Sequence[float], Sequence[int] | None]] = ()
    keep_out: Sequence[Sequence[Sequence[float]]] = ()
    road: RoadMap | None = None
    spans: Spans = field(default_factory=dict)
    areas: Sequence[np.ndarray] = ()

    @property
    def outlines(self) -> list[np.ndarray]:
        """Polygons that together are the region, without what is kept out, (k, 2) each [m]; a circle has 64 corners."""
        if self.polygon:
            return [np.asarray(self.polygon, dtype=float)]
        if self.stretches:
            return [outline for s_m, _ in self.stretches for outline in self.road.area(s_m=s_m)]
        if self.spans or self.areas:
            return [
                *self.areas,
                *(outline for row, s_m in self.spans.items() for outline in self.road.area([row], s_m)),
            ]
        turn = np.linspace(0.0, 2.0 * np.pi, 64, endpoint=False)
        return [self.centre_xy + self.radius_m * np.stack([np.cos(turn), np.sin(turn)], axis=1)]

    def distance(self, vehicles: Boxes) -> np.ndarray:
        """Horizontal distance of each box centre from the middle, (n,) [m]."""
        return np.hypot(*(vehicles.centre_m[:, :2] - self.centre_xy).T)

    def holds(self, vehicles: Boxes) -> np.ndarray:
        """Which box centres lie inside, (n,) bool."""
        xy = vehicles.centre_m[:, :2]
        if self.polygon:
            inside = polygon_holds(self.polygon, xy)
        elif self.stretches:
            inside = self._on_stretches(vehicles)
        elif self.spans or self.areas:
            inside = self._on_lanes(vehicles)
        else:
            inside = self.distance(vehicles) <= self.radius_m
        for polygon in self.keep_out:
            inside &= ~polygon_holds(polygon, xy)
        return inside

    def _on_stretches(self, vehicles: Boxes) -> np.ndarray:
        """Which lie on a stretch, (n,) bool; of boxes without lanes, such as detections, on the road's alone."""
        inside, located = np.zeros(len(vehicles), dtype=bool), self.road.locate(vehicles.centre_m)
        for (low, high), lanes in self.stretches:
            along = (located.s_m >= low - _ON_EDGE_M) & (located.s_m <= high + _ON_EDGE_M)
            inside |= along & (located.lane >= 0 if lanes is None else np.isin(vehicles.lane, lanes))
        return inside

    def _on_lanes(self, vehicles: Boxes) -> np.ndarray:
        """Which lie on the map's lanes that count, or in a junction, (n,) bool."""
        xy, inside = vehicles.centre_m[:, :2], np.zeros(len(vehicles), dtype=bool)
        if self.spans:
            located = self.road.locate(vehicles.centre_m, vehicles.heading_rad)
            low, high = np.full((2, len(self.road) + 1), np.nan)  # the last is of places off the lanes
            for row, ends in self.spans.items():
                low[row], high[row] = ends
            lane, s = located.lane, located.s_m
            inside = (s >= low[lane] - _ON_EDGE_M) & (s <= high[lane] + _ON_EDGE_M)
        for area in self.areas:
            inside |= polygon_holds(area, xy)
        return inside


def region_within(areas: Sequence[np.ndarray], keep_out: Sequence[Sequence[Sequence[float]]] = ()) -> Region:
    """The region of some polygons (k, 2) [m], less those that are kept out, of which no road is known."""
    corners = np.concatenate(areas)
    centre = 0.5 * (corners.min(axis=0) + corners.max(axis=0))
    radius = float(np.hypot(*(corners - centre).T).max())
    return Region(tuple(centre.tolist()), radius, keep_out=keep_out, areas=areas)


@lru_cache(maxsize=16)
def region_of(settings: RegionSettings, road: RoadMap) -> Region:
    """The region that a scene's settings, once resolved, describe.

    A stretch lies between the edges of the carriageway; one of the recording's lanes wherever these are.
    """
    if settings.junction or settings.approaches or settings.lanes:
        return _mapped(settings, road)
    if settings.polygon_m is None and not settings.stretches:
        return Region(settings.centre_m, settings.radius_m, keep_out=settings.keep_out or ())
    stretches = [(one.x_m, one.lanes) for one in settings.stretches]
    outlines = [settings.polygon_m] if settings.polygon_m else [one for s, _ in stretches for one in road.area(s_m=s)]
    corners = np.concatenate([np.asarray(outline, dtype=float) for outline in outlines])
    low, high = corners.min(axis=0), corners.max(axis=0)
    centre = 0.5 * (low + high)
    radius = float(np.hypot(*(corners - centre).T).max())
    return Region(tuple(centre.tolist()), radius, settings.polygon_m or (), stretches, settings.keep_out or (), road)


def _mapped(settings: RegionSettings, road: RoadMap, where: Callable[[str], str] = "[region] {}".format) -> Region:
    """That of a junction, its approaches and lanes of a map; its middle is the junction's where there is one."""
    spans, areas, approaches = {}, [], settings.approaches
    if settings.junction is not None:
        areas.append(junction_named(road, settings.junction, where("junction")).outline_m)
        approaches = approaches_to(road, [settings.junction]) if approaches is None else approaches
    for name in approaches or () if settings.approach_m else ():
        for row, (low, high) in approach_spans(road, name, settings.approach_m, where("approaches")).items():
            known = spans.get(row, (low, high))  # by another approach that has the lane before it too
            spans[row] = min(low, known[0]), high
    rows = {lane.name: row for row, lane in enumerate(road.lanes)}
    for name in settings.lanes or ():
        if name not in rows:
            raise unknown_name(name, rows, "lane", where("lanes"))
        spans[rows[name]] = 0.0, float(road.stations(lane=rows[name])[-1])
    corners = np.concatenate([*areas, *(outline for row, s in spans.items() for outline in road.area([row], s))])
    middle = areas[0] if areas else corners
    centre = 0.5 * (middle.min(axis=0) + middle.max(axis=0))
    radius = float(np.hypot(*(corners - centre).T).max())
    keep_out = settings.keep_out or ()
    return Region(tuple(centre.tolist()), radius, (), (), keep_out, road, spans, areas)


def check_mapped(settings: RegionSettings, road: RoadMap, where: Callable[[str], str]) -> None:
    """Refuse names of junctions, approaches and lanes that a map does not have; `where` says what gave a key.

    Raises
    ------
    InputError
        Naming the nearest known ones.
    """
    _mapped(settings, road, where)


# --- Polygons -------------------------------------------------------------------------------------------------------


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
