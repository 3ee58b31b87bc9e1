"""Approaches of a junction: the roads that lead to its stop lines, how far they reach back, and movements across it."""

from __future__ import annotations

import heapq
import math
from collections.abc import Iterable
from itertools import chain

import numpy as np

from ..errors import InputError, unknown_name
from .road_map import Junction, RoadMap, polygon_holds, wrap_angle

_STRAIGHT_RAD, _BACK_RAD = math.radians(45.0), math.radians(150.0)  # of turning, up to which and from which on
_AT_END_M = 1.0  # from a lane's end to the junction that it leads into
_POINTS = ("east", "north-east", "north", "north-west", "west", "south-west", "south", "south-east")

Spans = dict[int, tuple[float, float]]
"""Of each lane, by its row, from which station to which [m]."""


def junction_named(road: RoadMap, name: str, where: str) -> Junction:
    """The junction of that name.

    Raises
    ------
    InputError
        Naming the nearest known ones; `where` is what gave it.
    """
    found = {junction.name: junction for junction in road.junctions}
    if name not in found:
        raise unknown_name(name, tuple(found), "junction", where)
    return found[name]


def approaches_to(road: RoadMap, junctions: Iterable[str]) -> list[str]:
    """Roads of vehicles that lead into some junctions, by name, in the order of the map's lanes."""
    inner, found = set(junctions), {}
    outlines = [one.outline_m for one in road.junctions if one.name in inner]
    for number, lane in enumerate(road.lanes):
        if lane.junction or lane.use != "vehicles":
            continue
        into = {road.lanes[row].junction for row in lane.leads_to}
        # Maps without lanes inside junctions: the lane ends at the junction and leads to the ones beyond.
        ends = into == {""} and any(_away_from(outline, road.points_m[number][-1]) <= _AT_END_M for outline in outlines)
        if into & inner or ends:
            found[lane.road] = None
    return list(found)


def _away_from(polygon: np.ndarray, xy: np.ndarray) -> float:
    """Distance of a place from a polygon's outline [m], 0 inside."""
    if polygon_holds(polygon, xy[None])[0]:
        return 0.0
    edge = np.roll(polygon, -1, axis=0) - polygon
    part = (((xy - polygon) * edge).sum(axis=1) / np.square(edge).sum(axis=1)).clip(0.0, 1.0)
    return float(np.hypot(*(polygon + part[:, None] * edge - xy).T).min())


def approach_spans(road: RoadMap, name: str, distance_m: float, where: str) -> Spans:
    """How far an approach reaches back from its stop line along connected lanes: its shortest paths (Dijkstra 1959).

    It goes on along the road before it where that is its only one, across the lanes of the junction between them.

    Raises
    ------
    InputError
        When no road of that name leads into a junction.
    """
    known = approaches_to(road, {junction.name for junction in road.junctions})
    if name not in known:
        raise unknown_name(name, known, "approach", where)
    roads, before = [name], _roads_before(road)
    while len(further := before.get(roads[-1], set())) == 1 and not further & set(roads):
        roads += further
    rows = {row for row, lane in enumerate(road.lanes) if lane.road in roads and lane.use == "vehicles"}
    upstream = [row for row in rows if road.lanes[row].road != name]
    rows |= set(_reached(road, [later for row in upstream for later in road.lanes[row].leads_to])[0])
    length = {row: float(road.stations(lane=row)[-1]) for row in rows}
    spans = {}
    for row, far_m in _to_stop_line(road, name, length).items():
        if far_m < distance_m:
            spans[row] = max(length[row] - (distance_m - far_m), 0.0), length[row]
    return spans


def _to_stop_line(road: RoadMap, name: str, length: dict[int, float]) -> dict[int, float]:
    """How far the ends of lanes lie before the stop line of a road [m], by row; none of those that do not lead there.

    `length` are the lanes that count, by row [m]. One of the road itself that leads nowhere, as where two merge, ends
    beside another one of it.
    """
    own = {row for row in length if road.lanes[row].road == name}
    into: dict[int, list[int]] = {}
    for row in length:
        for later in road.lanes[row].leads_to:
            into.setdefault(later, []).append(row)
    ends = {row for row in own if any(road.lanes[later].road != name for later in road.lanes[row].leads_to)}
    found = _shortest(road, dict.fromkeys(ends or own, 0.0), into, length)
    known = {row: found[row] for row in own & found.keys()}
    return _shortest(road, found | {row: _beside(road, row, known, length) for row in own - found.keys()}, into, length)


def _shortest(
    road: RoadMap, start: dict[int, float], into: dict[int, list[int]], length: dict[int, float]
) -> dict[int, float]:
    """Dijkstra's shortest paths against the traffic, from the ends of lanes that are so far away already [m].

    From a lane to the next it is as far as from the end of the one to the start of the other: across a junction whose
    lanes the map does not have.
    """
    found, queue = {}, [(far, row) for row, far in start.items()]
    heapq.heapify(queue)
    while queue:
        far, row = heapq.heappop(queue)
        if row not in found:
            found[row] = far
            for earlier in into.get(row, ()):
                gap = math.dist(road.points_m[earlier][-1], road.points_m[row][0])
                heapq.heappush(queue, (far + length[row] + gap, earlier))
    return found


def _beside(road: RoadMap, row: int, known: dict[int, float], length: dict[int, float]) -> float:
    """How far a lane's end lies before the stop line, as on the nearest of the lanes of which that is known [m]."""
    end = road.points_m[row][-1]
    away = np.hypot(*(road.nearest(end) - end).T)
    nearest = min(known, key=lambda other: away[other])
    return known[nearest] + max(length[nearest] - road.along(nearest, end)[0], 0.0)


def _roads_before(road: RoadMap) -> dict[str, set[str]]:
    """Of each road between junctions those that lead into it, directly or through a junction."""
    found: dict[str, set[str]] = {}
    for lane in road.lanes:
        if not lane.junction and lane.use == "vehicles":
            for row in _exits(road, lane.leads_to):
                if road.lanes[row].road != lane.road:  # not from piece to piece of one
                    found.setdefault(road.lanes[row].road, set()).add(lane.road)
    return found


def _exits(road: RoadMap, rows: Iterable[int]) -> list[int]:
    """The first lanes beyond a junction that some lanes lead to, by their rows."""
    return _reached(road, rows)[1]


def _reached(road: RoadMap, rows: Iterable[int]) -> tuple[list[int], list[int]]:
    """Lanes of junctions that some lanes are or lead to across these, and the first ones beyond, by their rows."""
    within, beyond, seen, todo = [], [], set(), list(rows)
    while todo:
        row = todo.pop()
        if row in seen:
            continue
        seen.add(row)
        if road.lanes[row].junction:
            within.append(row)
            todo += road.lanes[row].leads_to
        else:
            beyond.append(row)
    return within, beyond


def exits_of(road: RoadMap, row: int) -> set[str]:
    """Roads beyond the junction that a lane, by its row, lies in or leads into."""
    lane = road.lanes[row]
    return {road.lanes[one].road for one in _exits(road, [row] if lane.junction else lane.leads_to)}


def ends_of(road: RoadMap, name: str) -> tuple[float, float]:
    """Direction of travel where a road begins and where it ends, counter-clockwise from +x [rad]."""
    own = [row for row, lane in enumerate(road.lanes) if lane.road == name]
    led_to = {later for row in own for later in road.lanes[row].leads_to}
    first = next((row for row in own if row not in led_to), own[0])
    leaving = (row for row in own if any(road.lanes[later].road != name for later in road.lanes[row].leads_to))
    ending = (row for row in own if not set(road.lanes[row].leads_to) & set(own))
    last = next(chain(leaving, ending), own[-1])
    steps = np.diff(road.points_m[first], axis=0)[0], np.diff(road.points_m[last], axis=0)[-1]
    return tuple(math.atan2(step[1], step[0]) for step in steps)


def movement(turn_rad: float) -> str:
    """What a turn to the left is called [rad]: straight, left, right or u-turn."""
    turn = float(wrap_angle(turn_rad))
    if abs(turn) <= _STRAIGHT_RAD:
        return "straight"
    return "u-turn" if abs(turn) >= _BACK_RAD else "left" if turn > 0.0 else "right"


def comes_from(heading_rad: float) -> str:
    """The point of the compass that one with a heading comes from, where +y is north."""
    return point_of_compass(heading_rad + math.pi)


def point_of_compass(angle_rad: float) -> str:
    """The point of the compass in a direction, counter-clockwise from +x [rad], where +y is north."""
    return _POINTS[round(math.degrees(angle_rad) / 45.0) % 8]


def check_driven(road: RoadMap, junction: Junction, xy: np.ndarray, where: str) -> None:
    """Refuse a junction in which no box centre (n, 2) [m] lies.

    Raises
    ------
    InputError
        Naming how far away vehicles drive.
    """
    middle = 0.5 * (junction.outline_m.min(axis=0) + junction.outline_m.max(axis=0))
    radius = float(np.hypot(*(junction.outline_m - middle).T).max())
    away = np.hypot(*(xy[:, :2] - middle).T)
    if not (away <= radius).any():
        raise InputError(
            f"{where}: nobody drives at junction {junction.name}; the nearest vehicle is {away.min():.0f} m away"
        )
