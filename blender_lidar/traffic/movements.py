"""Approach, exit and movement of each vehicle at junctions, from the map or, without one, from its own track."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..road.approaches import approaches_to, comes_from, ends_of, exits_of, movement
from ..road.road_map import RoadMap, wrap_angle
from .boxes import WAY_COLUMNS, Boxes
from .vehicles import Recording

_STEP_S = 0.5  # between the places by which a vehicle's way is known
_BEYOND_M = 15.0  # past the nearest place to the middle: it has crossed
_UNKNOWN = ""


Ways = dict[int, tuple[str, str, str]]
"""Of vehicles the road that each comes from and the one that it leaves by, and straight, left, right or u-turn; nothing
where it is not known."""


def with_ways(boxes: Boxes, ways: Ways, road: RoadMap) -> Boxes:
    """The boxes with approach, exit and movement of their vehicles, and the map's name of the lane that each is in."""
    columns = np.array([ways.get(number, (_UNKNOWN,) * 3) for number in boxes.vehicle_id.tolist()], dtype=str)
    names = np.array([*(lane.name for lane in road.lanes), _UNKNOWN])
    lane = names[road.locate(boxes.centre_m, boxes.heading_rad).lane]
    return replace(boxes, **dict(zip(WAY_COLUMNS, (*columns.reshape(-1, 3).T, lane), strict=True)))


def ways_by_map(recording: Recording, road: RoadMap, junctions: Sequence[str]) -> Ways:
    """The ways of a recording's vehicles across some junctions of a map, of each the first; none of pedestrians.

    A vehicle that is not seen to leave has the exit of its lane, where that leads to one alone.
    """
    inner, approaches = set(junctions), approaches_to(road, junctions)
    part = _each_half_second(recording.vehicles_alone)
    lane = road.locate(part.centre_m, part.heading_rad).lane
    found = {}
    for vehicle, rows in _tracks(part):
        lanes = [one for one in lane[rows].tolist() if one >= 0]
        at = next((at for at, one in enumerate(lanes) if road.lanes[one].road in approaches), None)
        inside = next((at for at, one in enumerate(lanes) if road.lanes[one].junction in inner), None)
        if at is None and inside is None:
            continue
        came = _UNKNOWN if at is None else road.lanes[lanes[at]].road
        later = lanes[inside if at is None else at :]
        left = next((road.lanes[one].road for one in later if _leaves(road, one, came, inner)), None)
        if left is None:
            ahead = [exits_of(road, one) for one in later]
            left = next((min(roads) for roads in reversed(ahead) if len(roads) == 1), _UNKNOWN)
        turn = _UNKNOWN
        if came and left:
            turn = movement(ends_of(road, left)[0] - ends_of(road, came)[1])
        found[vehicle] = came, left, turn
    return found


def _leaves(road: RoadMap, row: int, came: str, inner: set[str]) -> bool:
    """Whether a lane belongs to a road beyond the junction."""
    lane = road.lanes[row]
    leads_on = all(road.lanes[one].junction not in inner for one in lane.leads_to)
    return not lane.junction and lane.road != came and leads_on


def ways_by_track(recording: Recording, middle_xy: tuple[float, float]) -> Ways:
    """The ways of vehicles without a map: where each comes from, by the compass, and how far it turns.

    One that is not seen to pass the middle of the site has no movement.
    """
    part, found = _each_half_second(recording.vehicles_alone), {}
    away = np.hypot(*(part.centre_m[:, :2] - middle_xy).T)
    for vehicle, rows in _tracks(part):
        heading, nearest = part.heading_rad[rows], int(away[rows].argmin())
        turned = float(wrap_angle(np.diff(heading)).sum())
        crossed = away[rows][-1] - away[rows][nearest] >= _BEYOND_M and nearest > 0
        came, left = comes_from(heading[0]), comes_from(heading[-1] + math.pi)
        found[vehicle] = (came, left, movement(turned)) if crossed else (came, _UNKNOWN, _UNKNOWN)
    return found


def _each_half_second(recording: Recording) -> Recording:
    """Frames that are half a second apart."""
    kept, last = np.zeros(len(recording.frames), dtype=bool), -math.inf
    for at, time_s in enumerate(recording.frame_time_s.tolist()):
        if time_s >= last + _STEP_S - 1e-6 or time_s < last:  # a later recording begins again
            kept[at], last = True, time_s
    return recording.select(kept[np.searchsorted(recording.frames, recording.frame)])


def _tracks(recording: Recording):
    """Of each vehicle its number and its rows, in order of time."""
    order = np.lexsort((recording.frame, recording.vehicle_id))
    vehicle, first = np.unique(recording.vehicle_id[order], return_index=True)
    yield from zip(vehicle.tolist(), np.split(order, first[1:]), strict=True)
