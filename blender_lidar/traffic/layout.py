"""Estimating a road's layout from trajectories: its direction, carriageways, lanes, and a place for a pole at the kerb.

What is proposed is a straight road, the one road without a map of its own; it and its writers know the settings of one.
Where vehicles drive across the road gives its lanes (`lanes`); what lies where nobody drives cannot be seen. Positions
are those of `Recording`, read with no placing of its own: the file's plane. Left-hand traffic is looked at in a mirror,
where it drives on the right: the kerb is to the right throughout, until the result is mirrored back.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from ..errors import InputError
from ..names import SIDES
from ..rigid import Rigid
from ..road import RoadSettings
from ..road.road_map import wrap_angle
from .lanes import FEW, FEWEST_ON_A_ROAD, ONE_CARRIAGEWAY_M, Lanes, lanes_across
from .motion import SAME_WAY_RAD, Samples, busiest_place, directions, near_place, sharpest, turned, unturned
from .vehicles import Recording

HALF_STRETCH_M = 50.0
_CROSSING_RAD = math.radians(30.0)  # off the road, who drives across it
_OTHER_WAY_M = 40.0  # from a carriageway's edge, within which oncoming vehicles are of the same road
_ASSUMED = (
    "nothing shows on which side of the road vehicles drive (nobody comes the other way, no lanes are known to be "
    'numbered from the kerb): right-hand traffic is assumed; for the left, drives_on = "left" in [road] and '
    'side = "left" in [deployment]'
)
_OVER_THE_LINE_M = 1.0  # by which vehicles that come the other way drive on it
SETBACK_M = 2.0
_SETBACKS_M = (SETBACK_M, 3.0, 4.0, 6.0, 8.0, 10.0)
_CLEAR_M = 1.0  # about the pole
_BIN_M = 5.0  # along the road
_CHORD_M = 25.0
_BEND_RAD = math.radians(2.0)
_MANY_VEHICLES = 12  # on each lane
_MANY_THE_SAME = 0.8  # share of the vehicles of two carriageways that are one


@dataclass(frozen=True, slots=True, eq=False)
class RoadLayout:
    """A road as vehicles drive on it, and a place at its kerb for a pole.

    Attributes
    ----------
    origin_m : (float, float)
        The road frame's origin in the file's plane [m].
    heading_deg : float
        Direction of its x axis there, counter-clockwise.
    road : RoadSettings
        In that frame.
    lane_y : ndarray, (k,)
        Measured lane centres, from the right, in the road frame [m]; a lane that nobody uses has none.
    lane_numbers : tuple of int
        The recording's numbers of the lanes that drive along +x; empty where its lanes were not used.
    stretch_m : (float, float)
        The x around the pole that the region may span [m].
    extent_m : (float, float)
        The x between which the recording follows this road [m].
    vehicles : int
        Different ones that drive along +x and come to the pole.
    oncoming : int
        Different ones on the second carriageway.
    shown_by : str
        What shows on which side vehicles drive.
    notes : tuple of str
        What else there is, and what to check, as sentences; another carriageway with its lines of a scene.
    """

    origin_m: tuple[float, float]
    heading_deg: float
    road: RoadSettings
    lane_y: np.ndarray
    lane_numbers: tuple[int, ...]
    stretch_m: tuple[float, float]
    extent_m: tuple[float, float]
    vehicles: int
    oncoming: int
    shown_by: str
    notes: tuple[str, ...]

    @property
    def T_file_site(self) -> Rigid:
        """From the road frame to the file's plane."""
        return Rigid.about_z(math.radians(self.heading_deg), self.origin_m)

    @property
    def pole_y(self) -> float:
        """The y of the pole, which stands at the kerb at x = 0 [m]."""
        return self.road.place(self.road.drives_on)[0]

    @property
    def pole_m(self) -> tuple[float, float]:
        """The pole in the file's plane [m]."""
        return tuple(self.T_file_site.points((0.0, self.pole_y)).tolist())

    def ngsim_road(self) -> RoadSettings:
        """[road] of an NGSIM recording, whose plane is (Local_Y, -Local_X) [m]."""
        x, y = self.origin_m
        return replace(self.road, station_m=round(x, 2), right_edge_m=round(-y - self.road.setback_m, 2))

    def mirrored(self) -> RoadLayout:
        """Right-hand traffic, in the mirror, as the left-hand traffic that it is: the pole stays where it stands."""
        (x, y), right = self.origin_m, self.road
        road = replace(right, drives_on=SIDES[1])
        y_m = right.place(SIDES[1])[0]  # of what lies on y = 0 in the mirror
        heading_deg = -self.heading_deg + 0.0
        kerb = Rigid.about_z(math.radians(heading_deg), (x, -y + 0.0)).points((0.0, -y_m))
        origin = tuple(round(one, 2) + 0.0 for one in kerb.tolist())
        lane_y, numbers = (y_m - self.lane_y)[::-1], self.lane_numbers[::-1]
        return replace(self, origin_m=origin, heading_deg=heading_deg, road=road, lane_y=lane_y, lane_numbers=numbers)


def propose_layout(recording: Recording, *, follows_x: bool = False, kerb_lane: bool = False) -> RoadLayout:
    """Estimate the layout of the busiest road, or of the busiest approach of an intersection.

    Parameters
    ----------
    recording : Recording
        In the file's own plane [m].
    follows_x : bool
        Whether the road can only follow +x, as in NGSIM, whose files know no other direction.
    kerb_lane : bool
        Whether the recording numbers lanes from the kerb, as SUMO does.

    Raises
    ------
    InputError
        If there are too few vehicles that move, none that drive one way, or no place for a pole beside them.
    """
    samples = Samples.of(recording)
    side, shown_by = _traffic_side(samples, follows_x, kerb_lane)
    mirrored = side == SIDES[1]
    samples = samples.mirrored() if mirrored else samples
    found = [_carriageway(samples, direction, follows_x) for direction in directions(samples, follows_x)]
    layouts = _different([one for one in found if one])
    if not layouts:
        way = "along Local_Y" if follows_x else "one way on a stretch that no others cross"
        raise InputError(
            f"{recording.source}: no road can be proposed: fewer than {FEWEST_ON_A_ROAD} vehicles drive {way}, with "
            "room for a pole beside them"
        )
    layout = _with_others([one.mirrored() for one in layouts] if mirrored else layouts)
    note = f"{shown_by} show left-hand traffic; if vehicles drive on the right there, y is mirrored in the file"
    notes = (note,) if mirrored else () if shown_by else (_ASSUMED,)
    return replace(layout, shown_by=shown_by or "assumed", notes=layout.notes + notes)


@dataclass(frozen=True, slots=True, eq=False)
class _Found:
    """A layout, and the rows of `Samples.vehicle_id` that drive along it and come the other way."""

    layout: RoadLayout
    along: np.ndarray
    oncoming: np.ndarray


def _different(found: list[_Found]) -> list[RoadLayout]:
    """Roads, the busiest first, without those that the vehicles of a busier one come to: it bends, turns or returns."""
    kept: list[_Found] = []
    for one in sorted(found, key=lambda one: -one.layout.vehicles):
        others = (np.union1d(other.along, other.oncoming) for other in kept)
        if all(np.isin(one.along, vehicles).mean() <= _MANY_THE_SAME for vehicles in others):
            kept.append(one)
    return [one.layout for one in kept]


def _with_others(found: list[RoadLayout]) -> RoadLayout:
    best, *others = found
    notes = list(best.notes)
    for other in others:
        (x, y), heading = other.origin_m, other.heading_deg
        notes.append(
            f"also {other.vehicles + other.oncoming:,} vehicles on another carriageway; for it put these in their "
            f"tables, and check the region:\n[traffic]\norigin_m = [{x:.2f}, {y:.2f}]\n"
            f"heading_deg = {heading:g}\n[road]\nsetback_m = {other.road.setback_m:g}\nlanes = {other.road.lanes}\n"
            f"lane_width_m = {other.road.lane_width_m:g}\n{_carriageways(other.road)}"
        )
    return replace(best, notes=tuple(notes))


def _carriageways(road: RoadSettings) -> str:
    if road.carriageways == 1:
        return "carriageways = 1  # without median_m"
    return f"carriageways = {road.carriageways}\nmedian_m = {road.median_m:g}"


# --- A carriageway in one direction -----------------------------------------------------------------------


def _carriageway(everything: Samples, direction: float, follows_x: bool) -> _Found | None:
    """The busiest carriageway in about a direction, and who comes to its pole; None where there is no stretch."""
    place, half_m = busiest_place(everything, direction), HALF_STRETCH_M
    for look in range(3):  # the lanes where most drive, those where the pole stands, and again as far as it is straight
        half_m = 2.0 * HALF_STRETCH_M if follows_x else half_m
        direction, lanes = _lanes_near(everything, place, direction, half_m, turns=not follows_x)
        if lanes is None:
            return None
        oncoming = _oncoming(everything, place, direction, lanes, half_m)
        second = _lanes_of(everything, oncoming, place, direction)
        both = lanes.with_second(second) if second else None
        lanes = both or lanes
        found = _station(everything, place, direction, lanes, stays=look > 0)
        if found is None:
            return None
        place = place + unturned(found.station, 0.0, direction)
        half_m = found.half_m
    others = np.unique(everything.vehicle_id[oncoming if both else oncoming[:0]])
    return _Found(_layout(found, lanes, place, direction, len(others)), found.vehicles, others)


def _lanes_near(
    everything: Samples, place: np.ndarray, direction: float, half_m: float, *, turns: bool
) -> tuple[float, Lanes | None]:
    """The direction in which lanes about a place are sharpest, and these lanes, across from the place."""
    near = near_place(everything, place, direction, half_m)
    if len(near) and turns:
        direction = sharpest(near, place, direction)
    v = turned(near.xy - place, direction)[1]
    return direction, lanes_across(v, near.vehicle_id, near.speed, near.lane)


def _lanes_of(everything: Samples, rows: np.ndarray, place: np.ndarray, direction: float) -> Lanes | None:
    near = everything.select(rows).thinned()
    return lanes_across(turned(near.xy - place, direction)[1], near.vehicle_id, near.speed, near.lane)


def _oncoming(
    everything: Samples, place: np.ndarray, direction: float, lanes: Lanes, half_m: float, side: str = SIDES[1]
) -> np.ndarray:
    """Rows of those that come the other way on the nearest carriageway on one side of some lanes, (r,) int."""
    u, v = turned(everything.xy - place, direction)
    beyond = v - lanes.left_m if side == SIDES[1] else lanes.right_m - v
    here = (np.abs(u) <= half_m) & (beyond > -_OVER_THE_LINE_M) & (beyond <= _OTHER_WAY_M)
    rows = np.flatnonzero(here & (everything.off(direction + math.pi) <= SAME_WAY_RAD) & (everything.speed > 0.0))
    rows = rows[np.argsort(beyond[rows], kind="stable")]
    groups = np.split(rows, 1 + np.flatnonzero(np.diff(beyond[rows]) > ONE_CARRIAGEWAY_M))
    many = (group for group in groups if len(np.unique(everything.vehicle_id[group])) >= FEWEST_ON_A_ROAD)
    return next(many, rows[:0])


def _traffic_side(samples: Samples, follows_x: bool, kerb_lane: bool) -> tuple[str, str]:
    """The side of the road on which vehicles drive, and what shows it; the right, and nothing, where nothing does.

    Lane numbers that count from the kerb tell it, else the side on which the nearest oncoming vehicles are, each
    direction of travel by its number of vehicles.
    """
    by_lanes = by_oncoming = 0
    for direction in directions(samples, follows_x):
        place = busiest_place(samples, direction)
        direction, lanes = _lanes_near(samples, place, direction, HALF_STRETCH_M, turns=not follows_x)
        if lanes is None:
            continue
        order = np.sign(np.diff(lanes.numbers))
        if kerb_lane and len(order) and abs(order.sum()) == len(order):
            by_lanes += int(order[0]) * len(order)
        v, nearest = turned(samples.xy - place, direction)[1], {}
        for side in SIDES[:2]:
            rows = _oncoming(samples, place, direction, lanes, HALF_STRETCH_M, side)
            if len(rows):
                edge = lanes.left_m if side == SIDES[1] else lanes.right_m
                nearest[side] = float(np.abs(np.median(v[rows]) - edge)), len(np.unique(samples.vehicle_id[rows]))
        if nearest:
            beside = min(nearest, key=nearest.get)
            by_oncoming += nearest[beside][1] * (1 if beside == SIDES[1] else -1)
    votes = by_lanes or by_oncoming
    shown_by = "the lanes' numbers" if by_lanes else "vehicles that come the other way" if by_oncoming else ""
    return SIDES[0 if votes >= 0 else 1], shown_by or ("as where NGSIM was recorded" if follows_x else "")


# --- Where a pole may stand beside it ---------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class _Station:
    station: float  # along, from the place that was looked about [m]
    setback_m: float
    extent: tuple[float, float]
    stretch: tuple[float, float]
    half_m: float  # for which the road is straight enough
    vehicles: np.ndarray  # who comes to it
    notes: tuple[str, ...]


def _station(everything: Samples, place: np.ndarray, direction: float, lanes: Lanes, stays: bool) -> _Station | None:
    """The densest stretch of a carriageway, away from its ends and from where others cross it; None where none is.

    Where it `stays` it is the nearest place that is free.
    """
    from scipy import ndimage

    u, v = turned(everything.xy - place, direction)
    off = everything.off(direction)
    on_road = (v >= lanes.right_m) & (v <= lanes.left_m)
    along = on_road & (off <= _CROSSING_RAD)
    across = on_road & (off > _CROSSING_RAD) & (everything.speed > 0.0)
    if not along.any():
        return None
    reach = min(2000.0, float(np.abs(u[along]).max()) + _BIN_M)
    edges = np.arange(-reach, reach + _BIN_M, _BIN_M)
    presence = np.histogram(u[along], edges)[0]
    here = int(np.abs(edges + 0.5 * _BIN_M).argmin())
    followed = ndimage.binary_dilation(presence > 0, iterations=3)
    gaps = np.flatnonzero(~followed)
    low, high = gaps[gaps < here].max(initial=-1) + 1, gaps[gaps > here].min(initial=len(presence)) - 1
    used = np.flatnonzero(presence[low : high + 1]) + low
    if not len(used):
        return None
    extent = float(edges[used[0]]), float(edges[used[-1] + 1])
    crossed = np.histogram(u[across], edges)[0] > np.maximum(FEW * presence, 1)
    near_crossing = ndimage.binary_dilation(crossed, iterations=2)
    middles = edges[:-1] + 0.5 * _BIN_M
    inside = (middles > extent[0]) & (middles < extent[1]) & ~near_crossing[: len(middles)]
    crossings = np.flatnonzero(crossed & (middles > extent[0]) & (middles < extent[1]))
    if len(crossings):  # an approach, not a way out
        upstream = inside & (middles < middles[crossings[-1]])
        inside = upstream if upstream.any() else inside
    for setback in _SETBACKS_M:
        free = inside & _clear(everything, u, v, direction, lanes.right_m - setback, edges)
        if free.any():
            break
    else:
        return None
    if stays:
        merit = -np.abs(middles)
    else:
        dense = ndimage.uniform_filter1d(presence, 2 * int(HALF_STRETCH_M / _BIN_M) + 1, output=float, mode="constant")
        free &= dense >= 0.9 * dense[free].max()
        merit = np.minimum(middles - extent[0], extent[1] - middles)
    chosen = float(middles[free][merit[free].argmax()])
    bend = abs(_bend(everything, np.flatnonzero(along & (np.abs(u - chosen) <= 2.0 * _BIN_M))))
    half, notes = HALF_STRETCH_M, []
    if bend > _BEND_RAD:  # as far as the road stays within a metre of its tangent
        half = max(10.0, min(half, math.floor(math.sqrt(2.0 / (bend / 50.0)))))
        notes.append(f"the road bends by {math.degrees(bend):.0f} deg within 50 m, and a scene's is straight")
    stretch = max(extent[0], chosen - half) - chosen, min(extent[1], chosen + half) - chosen
    coming = along & (u >= chosen + stretch[0]) & (u <= chosen + _BIN_M)  # not those that join beyond a crossing
    vehicles = np.unique(everything.vehicle_id[coming])
    if len(vehicles) < FEWEST_ON_A_ROAD:
        return None
    if len(vehicles) < _MANY_VEHICLES * max(lanes.count, 2):
        notes.append(
            f"only {len(vehicles)} vehicles: little to go by, and a lane that none of them used cannot be seen"
        )
    if len(crossings):
        groups = np.split(crossings, 1 + np.flatnonzero(np.diff(crossings) > 2))
        nearest = min(groups, key=lambda group: np.abs(middles[group] - chosen).min())
        first, last = edges[nearest[0]] - chosen, edges[nearest[-1] + 1] - chosen
        notes.append(f"others cross this carriageway between x {first:.0f} and {last:.0f} m: an intersection?")
    return _Station(chosen, setback, (extent[0] - chosen, extent[1] - chosen), stretch, half, vehicles, tuple(notes))


def _bend(everything: Samples, here: np.ndarray) -> float:
    """By how much a road turns to the left within 50 m: the median of those whose rows are `here` at the pole [rad].

    It is the angle between two chords of 25 m along each vehicle's own way, before and after the pole or, where tracks
    end there, as near to it as they go: no bend is too sharp to be seen.
    """
    vehicle = everything.vehicle_id
    here = here[np.unique(vehicle[here], return_index=True)[1]]
    same = np.diff(vehicle) == 0
    way = np.append(0.0, np.cumsum(np.where(same, np.hypot(*np.diff(everything.xy, axis=0).T), 0.0)))
    first, end = (
        np.searchsorted(everything.vehicle_id, everything.vehicle_id[here], side) for side in ("left", "right")
    )
    middle = np.maximum(np.minimum(way[here], way[end - 1] - _CHORD_M), way[first] + _CHORD_M)
    rows = [np.clip(np.searchsorted(way, middle + shift - 0.1), first, end - 1) for shift in (-_CHORD_M, 0.0, _CHORD_M)]
    lengths = np.diff(way[rows], axis=0)
    long = (lengths > 0.5 * _CHORD_M).all(axis=0)
    if not long.any():
        return 0.0
    chords = np.diff(everything.xy[np.array(rows)[:, long]], axis=0)
    turn = np.diff(np.arctan2(chords[..., 1], chords[..., 0]), axis=0)[0]
    return float(np.median(wrap_angle(turn) * 4.0 * _CHORD_M / lengths[:, long].sum(axis=0)))


def _clear(everything: Samples, u, v, direction: float, line: float, edges: np.ndarray) -> np.ndarray:
    """Bins along the road in which no vehicle ever comes near a pole at `line` across it, (b,) bool."""
    off = np.nan_to_num(everything.off(direction), nan=0.5 * np.pi)
    cos, sin = np.abs(np.cos(off)), np.sin(off)
    length, width = 0.5 * everything.size_m[:, :2].T
    near = np.abs(v - line) <= length * sin + width * cos + _CLEAR_M
    reach = (length * cos + width * sin)[near] + _CLEAR_M + 0.5 * _BIN_M  # a pole may stand anywhere in its bin
    blocked = np.zeros(len(edges) + 1)
    for ends, step in ((u[near] - reach, 1.0), (u[near] + reach, -1.0)):
        np.add.at(blocked, np.searchsorted(edges + 0.5 * _BIN_M, ends), step)
    return np.cumsum(blocked)[: len(edges) - 1] == 0


def _layout(found: _Station, lanes: Lanes, place: np.ndarray, direction: float, oncoming: int) -> RoadLayout:
    shift = lanes.right_m - found.setback_m  # across, of the line y = 0
    origin = place + unturned(0.0, shift, direction)
    road = RoadSettings(
        carriageways=1 if lanes.median_m is None else 2,
        median_m=lanes.median_m,
        setback_m=found.setback_m,
        lanes=lanes.count,
        lane_width_m=lanes.width_m,
    )
    return RoadLayout(
        origin_m=tuple(np.round(origin, 2).tolist()),
        heading_deg=round(math.degrees(direction), 2),
        road=road,
        lane_y=lanes.centres - shift,
        lane_numbers=lanes.numbers,
        stretch_m=found.stretch,
        extent_m=found.extent,
        vehicles=len(found.vehicles),
        oncoming=oncoming,
        shown_by="",
        notes=found.notes,
    )
