"""Road map: where the lanes of a site are, which way they drive, and how high the surface lies."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import NamedTuple, Protocol

import numpy as np

from ..names import SIDES

_ON_EDGE_M = 1e-9  # what lies this near to an edge lies on it
_ON_SIDE_M = 1e-5  # what lies this near to an edge of a carriageway stands beside it
_LARGEST_M = 1e9  # beyond all distances
_MOST_PAIRS = 400_000  # of places and segments that are looked at together
_CELL_M = 16.0  # side of the square cells in which more places are looked at together
_BESIDE_M = 0.01  # far enough from an edge to lie on one side of it, across the gaps between the lanes of a bend


def wrap_angle(angle):
    """The same angle within half a turn of 0 [rad]."""
    return np.arctan2(np.sin(angle), np.cos(angle))


class Located(NamedTuple):
    """Where n places lie on a road.

    Attributes
    ----------
    lane : ndarray of int, (n,)
        Row of the lane that holds the place; -1 off the lanes.
    s_m : ndarray, (n,)
        Station along the reference line of that lane, or of the nearest one [m].
    t_m : ndarray, (n,)
        Offset from that reference line, to the left [m].
    heading_rad : ndarray, (n,)
        Direction in which that lane drives, counter-clockwise from +x of the site frame.
    """

    lane: np.ndarray
    s_m: np.ndarray
    t_m: np.ndarray
    heading_rad: np.ndarray


class Lane(NamedTuple):
    """What a map says of a lane besides where it lies.

    Attributes
    ----------
    name : str
        As its source calls it.
    road : str
        The road in one direction of travel that it belongs to: SUMO's edge.
    junction : str
        The junction that it crosses; nothing where it belongs to a road between junctions.
    leads_to : tuple of int
        Rows of the lanes into which it leads.
    use : str
        Who travels on it: vehicles, bicycles or pedestrians.
    """

    name: str
    road: str
    junction: str = ""
    leads_to: tuple[int, ...] = ()
    use: str = "vehicles"


class Junction(NamedTuple):
    """Where roads meet.

    Attributes
    ----------
    name : str
        As its source calls it.
    outline_m : ndarray, (k, 2)
        Corners of its area [m].
    signalised : bool or None
        Whether signals rule it; None where the map does not say it.
    """

    name: str
    outline_m: np.ndarray
    signalised: bool | None = None


def polygon_holds(polygon: Sequence[Sequence[float]], xy: np.ndarray) -> np.ndarray:
    """Point in polygon by the even-odd rule, its edge included: which of the points `xy` (n, 2) lie inside, (n,) bool.

    `polygon` are its corners (m, 2) in the order of its outline, in the unit of the points.
    """
    start, xy = np.asarray(polygon, dtype=float), np.asarray(xy)
    found = ((xy >= start.min(axis=0) - _ON_EDGE_M) & (xy <= start.max(axis=0) + _ON_EDGE_M)).all(axis=1)
    if not found.any():
        return found
    edge = np.roll(start, -1, axis=0) - start
    x, y = (xy[found][:, None, axis] - start[:, axis] for axis in (0, 1))  # (n, m), of each from each corner
    crossed = (y < 0.0) != (y < edge[:, 1])  # edges that the level of the point meets; the lower end belongs to one
    with np.errstate(divide="ignore", invalid="ignore"):
        inside = (crossed & (x < edge[:, 0] * (y / edge[:, 1]))).sum(axis=1) % 2 == 1
        along = np.clip((x * edge[:, 0] + y * edge[:, 1]) / np.square(edge).sum(axis=1), 0.0, 1.0)
    off = np.hypot(x - along * edge[:, 0], y - along * edge[:, 1])
    found[found] = inside | (off <= _ON_EDGE_M).any(axis=1)
    return found


class _Segments(NamedTuple):
    """Segments of centre lines, (m,) each."""

    start: np.ndarray  # (m, 2) [m]
    along: np.ndarray  # (m, 2), unit vectors
    length: np.ndarray
    low: np.ndarray  # from where to where they go along themselves [m]
    high: np.ndarray
    half: np.ndarray  # (m, 2), half the width at both ends [m]
    station: np.ndarray
    direction: np.ndarray  # in which the lane drives [rad]
    row: np.ndarray  # of its lane
    opens: np.ndarray  # whether it is the first of its lane, and the last
    closes: np.ndarray


class _Near(NamedTuple):
    """Of n places and l lanes the nearest segment, and how a place lies on it, (n, l) each."""

    segment: np.ndarray
    s: np.ndarray  # from the segment's start, within its ends [m]
    t: np.ndarray  # to its left [m]
    away: np.ndarray  # from it [m]
    half: np.ndarray  # half its width there [m]
    outside: np.ndarray  # whether the lane does not hold the place


class Surface(Protocol):
    """How high the road lies over each place of the site frame's plane."""

    @property
    def is_flat(self) -> bool:
        """Whether it is the plane z = 0."""

    @property
    def is_ground(self) -> bool:
        """Whether it lies everywhere in place of the plane z = 0, and not on it."""

    def height(self, xy: np.ndarray) -> np.ndarray:
        """Height above z = 0 at places (n, 2) [m], (n,)."""

    def triangles(self, centre_m: Sequence[float], reach_m: float) -> np.ndarray:
        """What of it is not the plane z = 0 within reach of a place x, y [m], as triangles (m, 3, 3) that face up."""


@dataclass(frozen=True, slots=True)
class Flat:
    """The plane z = 0."""

    @property
    def is_flat(self) -> bool:
        """That it is."""
        return True

    @property
    def is_ground(self) -> bool:
        """That it is the plane itself."""
        return False

    def height(self, xy: np.ndarray) -> np.ndarray:
        """Height above z = 0 at places (..., 2) [m], (...,)."""
        return np.zeros(np.shape(xy)[:-1])

    def triangles(self, centre_m: Sequence[float], reach_m: float) -> np.ndarray:
        """None, (0, 3, 3)."""
        return np.zeros((0, 3, 3))


@dataclass(frozen=True, slots=True, eq=False)
class RoadMap:
    """Lanes as centre lines with widths, in the site frame; the same for a straight road and for a net.

    A road may have no lanes: stations are then x, offsets y of the site frame, and what asks for lanes gets none.

    Attributes
    ----------
    points_m : tuple of ndarray, (k, 2) each
        Centre line of each lane [m], in the direction of its stations.
    station_m : ndarray, (l,)
        Station of each centre line's first point [m].
    offset_m : ndarray, (l,)
        Offset of each centre line from the reference line of its road, to the left [m]; 0 where it is its own.
    width_m : ndarray, (l,)
        Width of each lane [m].
    against : ndarray of bool, (l,)
        Lanes that drive against their stations.
    surface : Surface
        How high the road lies.
    up : (float, float, float)
        The vertical: masts are plumb where the site frame follows a slope.
    endless : bool
        Whether each lane goes on beyond both ends of its centre line.
    widths_m : tuple of ndarray, (k,) each
        Width of each lane at the points of its centre line, where these differ [m]; `width_m` is then the largest.
    lanes : tuple of Lane, (l,)
        What a map says of each lane; nothing of a straight road.
    junctions : tuple of Junction
        Where roads meet; their areas are road too.
    drives_on : str
        The side of the road on which vehicles drive.
    carriageways_t : tuple of (float, float)
        Right and left edge of each carriageway of a road without ends, as offsets, from the right [m]; else none.
    facing_of : mapping of str to float
        Which way masts face that stand on a side of such a road, square to it [rad]; none where a road has no sides.
    """

    points_m: tuple[np.ndarray, ...]
    station_m: np.ndarray
    offset_m: np.ndarray
    width_m: np.ndarray
    against: np.ndarray
    surface: Surface
    up: tuple[float, float, float] = (0.0, 0.0, 1.0)
    endless: bool = False
    widths_m: tuple[np.ndarray, ...] = ()
    lanes: tuple[Lane, ...] = ()
    junctions: tuple[Junction, ...] = ()
    drives_on: str = SIDES[0]
    carriageways_t: tuple[tuple[float, float], ...] = ()
    facing_of: Mapping[str, float] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.points_m)

    @property
    def edges_t(self) -> tuple[float, float]:
        """Offsets of the outermost edges from the reference line, to the right and to the left [m]."""
        if not len(self):
            return 0.0, 0.0
        half = 0.5 * self.width_m
        return float((self.offset_m - half).min()), float((self.offset_m + half).max())

    def side_of(self, xy: Sequence[float]) -> str:
        """The side of a road without ends on which a place [m] lies, a gantry's over a carriageway; else nothing."""
        if not self.carriageways_t:
            return ""
        edges, t = self.carriageways_t, float(self.locate(np.array([xy], dtype=float)).t_m[0])
        if t <= edges[0][0] + _ON_SIDE_M or t >= edges[-1][1] - _ON_SIDE_M:
            return "right" if t <= edges[0][0] + _ON_SIDE_M else "left"
        over = any(right + _ON_SIDE_M < t < left - _ON_SIDE_M for right, left in edges)
        parted = any(before[1] < after[0] for before, after in itertools.pairwise(edges))
        return "gantry" if over or not parted else "median"

    @property
    def axis(self) -> np.ndarray | None:
        """Unit vector (2,) along which all lanes go on without ends; None where the road bends or ends."""
        if not self.endless:
            return None
        along = _segments(self).along
        return along[0] if np.allclose(along, along[0]) else None

    def locate(self, xy: np.ndarray, heading_rad: np.ndarray | None = None) -> Located:
        """Lane, station, offset and direction of travel at places (n, 2) [m].

        Where lanes cross, as in a junction, the lane whose direction is nearest to `heading_rad` (n,) holds the place,
        and without one the lane whose middle is nearest.
        """
        xy = np.asarray(xy, dtype=float)[:, :2]
        if not len(self):
            return Located(np.full(len(xy), -1), *xy.T, np.zeros(len(xy)))
        found = [np.zeros(len(xy), dtype=kind) for kind in (int, float, float, float)]
        for rows, pieces in _together(_segments(self), xy):
            near = self._near(pieces, xy[rows])
            held = near.outside.copy()
            turn = np.zeros_like(near.away)
            if heading_rad is not None:
                difference = wrap_angle(np.asarray(heading_rad)[rows, None] - pieces.direction[near.segment])
                turn = np.where(held, 0.0, np.abs(difference))
            chosen = np.lexsort((near.away, turn, held), axis=1)[:, 0]
            at = np.arange(len(chosen)), chosen
            best = near.segment[at]
            lane = np.where(held[at], -1, pieces.row[best])
            station, offset = pieces.station[best], self.offset_m[pieces.row[best]]
            values = lane, near.s[at] + station, near.t[at] + offset, pieces.direction[best]
            for column, some in zip(found, values, strict=True):
                column[rows] = some
        return Located(*found)

    def on(self, xy: np.ndarray) -> np.ndarray:
        """Which places (n, 2) [m] lie on a lane or in a junction, edges included, (n,) bool."""
        on = self.locate(xy).lane >= 0
        for junction in self.junctions:
            on |= polygon_holds(junction.outline_m, np.asarray(xy, dtype=float)[:, :2])
        return on

    def at(self, s_m: np.ndarray, t_m: np.ndarray, lane: int = 0) -> np.ndarray:
        """Places at stations and offsets from the reference line of a lane, (..., 2) [m, site frame]."""
        if not len(self):
            return np.stack(np.broadcast_arrays(np.asarray(s_m, dtype=float), t_m), axis=-1)
        line, s_m, station = self.points_m[lane], np.asarray(s_m, dtype=float), self.stations(lane=lane)
        segment = np.clip(np.searchsorted(station, s_m, side="right") - 1, 0, len(station) - 2)
        step = np.diff(line, axis=0)
        along = step / np.hypot(*step.T)[:, None]
        left = np.stack([-along[:, 1], along[:, 0]], axis=1)
        reference = line[:-1] - self.offset_m[lane] * left
        ahead = (s_m - station[segment])[..., None] * along[segment]
        return reference[segment] + ahead + np.asarray(t_m)[..., None] * left[segment]

    def stations(self, s_m: tuple[float, float] | None = None, lane: int = 0) -> np.ndarray:
        """Stations of a lane's corners, (k,) [m]; of those between two others, and these, nothing where it is not."""
        if not len(self):
            return np.array([] if s_m is None or s_m[1] <= s_m[0] else s_m, dtype=float)
        station = np.cumsum(np.hypot(*np.diff(self.points_m[lane], axis=0).T))
        station = self.station_m[lane] + np.concatenate([[0.0], station])
        if s_m is None:
            return station
        low, high = s_m
        if not self.endless:
            low, high = max(low, station[0]), min(high, station[-1])
        if high <= low:
            return station[:0]
        corners = station[1:-1]  # without ends the lane goes straight on there
        return np.concatenate([[low], corners[(corners > low) & (corners < high)], [high]])

    def stretch(self, xy: Sequence[float], reach_m: float) -> tuple[float, float]:
        """Stations between which the road lies within reach of a place [m]."""
        s = float(self.locate(np.array([xy], dtype=float)).s_m[0])
        return s - reach_m, s + reach_m

    def within(self, xy: np.ndarray) -> np.ndarray:
        """Which places (n, 2) [m] lie where vehicles drive, and not on the outer edge of it, (n,) bool."""
        driven = self.driven
        around = np.array([(1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0)]) * _BESIDE_M
        places = (np.asarray(xy, dtype=float)[:, None, :2] + around).reshape(-1, 2)
        inside = driven.locate(places).lane >= 0
        crossed = {lane.junction for lane in self.lanes}
        for junction in self.junctions:
            if junction.name not in crossed:  # a map without lanes inside junctions
                inside |= polygon_holds(junction.outline_m, places)
        return inside.reshape(-1, 4).all(axis=1)

    @property
    def driven(self) -> RoadMap:
        """The same with the lanes of vehicles and bicycles alone: masts may stand on footways."""
        if all(lane.use != "pedestrians" for lane in self.lanes):
            return self
        return self._with(np.flatnonzero([lane.use != "pedestrians" for lane in self.lanes]))

    def nearest(self, xy: Sequence[float]) -> np.ndarray:
        """The nearest place on the middle of each lane, (l, 2) [m]."""
        if not len(self):
            return np.zeros((0, 2))
        pieces = _segments(self)
        near = self._near(pieces, np.array([xy], dtype=float))
        best = near.segment[0]
        return pieces.start[best] + near.s[0][:, None] * pieces.along[best]

    def clearance(self, xy: Sequence[float]) -> tuple[float, str]:
        """How far a place lies from the nearest edge of a lane that is driven on [m], below 0 on it, and on which side
        of its traffic; infinitely far, on no side, where there is none.
        """
        road = self.driven
        if not len(road):
            return math.inf, ""
        lane, near = road._nearest_lane(xy)
        left = (near.t[0, lane] > 0.0) != bool(road.against[lane])
        return float(near.away[0, lane] - near.half[0, lane]), "left" if left else "right"

    def direction(self, xy: Sequence[float]) -> float:
        """Which way the stations of the nearest lane rise at a place, counter-clockwise from +x [rad]."""
        if not len(self):
            return 0.0
        lane, near = self._nearest_lane(xy)
        return float(_segments(self).direction[near.segment[0, lane]] + math.pi * self.against[lane])

    def edges_across(self, xy: Sequence[float]) -> tuple[np.ndarray, np.ndarray]:
        """The edges of the road across from a place on a lane, to the right and to the left of it, (2,) each [m]."""
        found = []
        for side in (-1.0, 1.0):
            place, lane = np.array(xy, dtype=float), self.locate(np.array([xy])).lane[0]
            edge = place
            crossed = set()  # around a bend the way across may come back
            while lane >= 0 and lane not in crossed:
                crossed.add(lane)
                s, t, heading = self.along(lane, place)
                turn = heading + math.pi * self.against[lane]
                left = np.array([-math.sin(turn), math.cos(turn)])
                edge = place + (self.offset_m[lane] + side * self._half(lane, s) - t) * left
                place = edge + side * _BESIDE_M * left
                lane = self.locate(place[None]).lane[0]
            found.append(edge)
        return found[0], found[1]

    def area(self, lanes: Sequence[int] | None = None, s_m: tuple[float, float] | None = None) -> list[np.ndarray]:
        """Outline of each lane as a polygon, (k, 2) each [m]; of all `lanes` unless said, between two stations.

        A lane without ends needs the stations.
        """
        polygons = []
        for lane in range(len(self)) if lanes is None else lanes:
            line, half = self._between(lane, s_m)
            if len(line):
                polygons.append(np.concatenate([_offset_curve(line, -half), _offset_curve(line, half)[::-1]]))
        return polygons

    def lines(self, s_m: tuple[float, float]) -> tuple[list[np.ndarray], list[np.ndarray]]:
        """Edges of carriageways and lines between their lanes, as lines (k, 2) between two stations [m]."""
        edges, dashes = [], []
        for lane in range(len(self)):
            line, half = self._between(lane, s_m)
            if not len(line):
                continue
            for side in (-half, half):
                beside = _offset_curve(line, side)
                others = self._with(np.delete(np.arange(len(self)), lane))
                if not len(others) or (others.locate(_offset_curve(line, 1.001 * side)).lane < 0).all():
                    edges.append(beside)
                elif side[0] > 0.0:  # one of both lanes draws it
                    dashes.append(beside)
        return edges, dashes

    def _nearest_lane(self, xy: Sequence[float]) -> tuple[int, _Near]:
        """The lane that holds a place, or else has the nearest edge."""
        near = self._near(_segments(self), np.array([xy], dtype=float))
        away = np.where(near.outside, near.away - near.half, near.away - _LARGEST_M)[0]
        return int(np.argmin(away)), near

    def along(self, lane: int, xy: Sequence[float]) -> tuple[float, float, float]:
        """Station and offset of a place along one lane [m], on it or not, and which way the lane drives there [rad]."""
        _, *found = self._with(np.array([lane])).locate(np.array([xy]))
        return tuple(float(one[0]) for one in found)

    def _with(self, lanes: np.ndarray) -> RoadMap:
        """The same road with some of its lanes alone, without what they lead to."""
        kept = {
            key: tuple(getattr(self, key)[lane] for lane in lanes) if getattr(self, key) else ()
            for key in ("points_m", "widths_m", "lanes")
        }
        return replace(
            self,
            **kept,
            station_m=self.station_m[lanes],
            offset_m=self.offset_m[lanes],
            width_m=self.width_m[lanes],
            against=self.against[lanes],
        )

    def _near(self, pieces: _Segments, xy: np.ndarray) -> _Near:
        """Of each lane the segment that is nearest to each place (n, 2): one that holds it before the others."""
        held, t, beyond = _offsets(pieces, xy)
        away = np.hypot(t, beyond)
        share = (held / pieces.length).clip(0.0, 1.0)
        half = pieces.half[:, 0] + share * (pieces.half[:, 1] - pieces.half[:, 0])
        outside = away > half + _ON_EDGE_M
        outside |= (pieces.opens & (beyond < -_ON_EDGE_M)) | (pieces.closes & (beyond > _ON_EDGE_M))
        rank = np.where(outside, away + _LARGEST_M, away)
        first = np.flatnonzero(np.diff(pieces.row, prepend=-1))  # the first segment of each lane
        least = np.repeat(np.minimum.reduceat(rank, first, axis=1), np.diff(first, append=len(pieces.row)), axis=1)
        at_least = np.where(rank == least, np.arange(len(pieces.row)), len(pieces.row))
        segment = np.minimum.reduceat(at_least, first, axis=1)  # (n, l)
        picked = (np.take_along_axis(each, segment, axis=1) for each in (held, t, away, half, outside))
        return _Near(segment, *picked)

    def _between(self, lane: int, s_m: tuple[float, float] | None) -> tuple[np.ndarray, np.ndarray]:
        """The centre line of a lane between two stations, (k, 2), and half its width there, (k,) [m]; nothing where it
        has no part there.
        """
        stations = self.stations(s_m, lane)
        return self.at(stations, self.offset_m[lane], lane), self._half(lane, stations)

    def _half(self, lane: int, s_m: np.ndarray) -> np.ndarray:
        """Half the width of a lane at stations (...), (...) [m]."""
        if not self.widths_m:
            return np.full(np.shape(s_m), 0.5 * self.width_m[lane])
        return 0.5 * np.interp(s_m, self.stations(lane=lane), self.widths_m[lane])


@lru_cache(maxsize=32)
def _segments(road: RoadMap) -> _Segments:
    """All m segments of a road's centre lines, lane by lane; made once."""
    start = np.concatenate([line[:-1] for line in road.points_m])
    step = np.concatenate([np.diff(line, axis=0) for line in road.points_m])
    length = np.hypot(*step.T)
    counts = np.array([len(line) - 1 for line in road.points_m])
    row, last = np.repeat(np.arange(len(road)), counts), np.cumsum(counts)
    low, high = np.zeros(len(length)), length.copy()
    if road.endless:
        low[last - counts], high[last - 1] = -np.inf, np.inf
    before = np.cumsum(length) - length
    station = before - before[last - counts][row] + road.station_m[row]
    half = 0.5 * np.stack([road.width_m[row]] * 2, axis=1)
    if road.widths_m:
        ends = [np.stack([width[:-1], width[1:]], axis=1) for width in road.widths_m]
        half = 0.5 * np.concatenate(ends)
    along = step / length[:, None]
    direction = wrap_angle(np.arctan2(along[:, 1], along[:, 0]) + math.pi * road.against[row])
    opens, closes = np.diff(row, prepend=-1) > 0, np.diff(row, append=len(road)) > 0
    return _Segments(start, along, length, low, high, half, station, direction, row, opens, closes)


def _offsets(pieces: _Segments, xy: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """How places (n, 2) lie on each segment: how far along it, to its left, and beyond its ends, (n, m) each [m]."""
    off = xy[:, None] - pieces.start  # (n, m, 2)
    s = (off * pieces.along).sum(axis=-1)
    held = s.clip(pieces.low, pieces.high)
    return held, pieces.along[:, 0] * off[..., 1] - pieces.along[:, 1] * off[..., 0], s - held


def _together(pieces: _Segments, xy: np.ndarray) -> Iterator[tuple[np.ndarray | slice, _Segments]]:
    """Rows of places (n, 2) that are looked at together, with the segments that may hold them or be the nearest."""
    if len(xy) * len(pieces.row) <= _MOST_PAIRS:
        yield slice(None), pieces
        return
    cells, of = np.unique(np.floor(xy / _CELL_M), axis=0, return_inverse=True)
    order, reach = np.argsort(of.reshape(-1), kind="stable"), math.sqrt(0.5) * _CELL_M + _ON_EDGE_M
    for cell, rows in zip(cells, np.split(order, np.cumsum(np.bincount(of.reshape(-1)))[:-1]), strict=True):
        _, t, beyond = _offsets(pieces, (cell[None] + 0.5) * _CELL_M)
        away = np.hypot(t, beyond)[0]
        near = away <= np.maximum(away.min() + 2.0 * reach, pieces.half.max(axis=1) + reach)
        some = _Segments(*(column[near] for column in pieces))
        for part in np.array_split(rows, math.ceil(len(rows) * len(some.row) / _MOST_PAIRS)):
            yield part, some


def _offset_curve(line: np.ndarray, offset_m: np.ndarray) -> np.ndarray:
    """Offset curve: a line (k, 2) moved to its left by so much, (k,) [m], mitred at its corners."""
    along = np.diff(line, axis=0)
    along /= np.hypot(*along.T)[:, None]
    left = np.stack([-along[:, 1], along[:, 0]], axis=1)
    before, after = np.concatenate([left[:1], left]), np.concatenate([left, left[-1:]])
    middle = before + after
    return line + middle * (offset_m / (0.5 * np.square(middle).sum(axis=1)))[:, None]
