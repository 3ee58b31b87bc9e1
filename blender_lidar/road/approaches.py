"""Approaches of a junction: the roads that lead to its stop lines, how far they reach back, and movements across it."""

from __future__ import annotations

import math
from collections.abc import Iterable

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
    """How far an approach reaches back from its stop line, on the roads before it too where these are its only ones.

    Raises
    ------
    InputError
        When no road of that name leads into a junction.
    """
    known = approaches_to(road, {junction.name for junction in road.junctions})
    if name not in known:
        raise unknown_name(name, known, "approach", where)
    before = _roads_before(road)
    spans, roads, left = {}, {name}, {name: distance_m}
    while roads:
        one = roads.pop()
        rows = [row for row, lane in enumerate(road.lanes) if lane.road == one and lane.use == "vehicles"]
        lengths = {row: float(road.stations(lane=row)[-1]) for row in rows}
        spans |= {row: (max(length - left[one], 0.0), length) for row, length in lengths.items()}
        rest, further = left[one] - max(lengths.values()), before.get(one, set())
        if rest > 0.0 and len(further) == 1 and not further & set(left):
            (upstream,) = further
            roads.add(upstream)
            left[upstream] = rest
    return spans


def _roads_before(road: RoadMap) -> dict[str, set[str]]:
    """Of each road between junctions those that lead into it, directly or through a junction."""
    found: dict[str, set[str]] = {}
    for lane in road.lanes:
        if not lane.junction and lane.use == "vehicles":
            for row in _exits(road, lane.leads_to):
                found.setdefault(road.lanes[row].road, set()).add(lane.road)
    return found


def _exits(road: RoadMap, rows: Iterable[int]) -> list[int]:
    """The first lanes beyond a junction that some lanes lead to, by their rows."""
    found, seen, todo = [], set(), list(rows)
    while todo:
        row = todo.pop()
        if row in seen:
            continue
        seen.add(row)
        if road.lanes[row].junction:
            todo += road.lanes[row].leads_to
        else:
            found.append(row)
    return found


def exits_of(road: RoadMap, row: int) -> set[str]:
    """Roads beyond the junction that a lane, by its row, lies in or leads into."""
    lane = road.lanes[row]
    return {road.lanes[one].road for one in _exits(road, [row] if lane.junction else lane.leads_to)}


def ends_of(road: RoadMap, name: str) -> tuple[float, float]:
    """Direction of travel where a road begins and where it ends, counter-clockwise from +x [rad]."""
    row = next(row for row, lane in enumerate(road.lanes) if lane.road == name)
    steps = np.diff(road.points_m[row], axis=0)
    return tuple(math.atan2(step[1], step[0]) for step in (steps[0], steps[-1]))


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
