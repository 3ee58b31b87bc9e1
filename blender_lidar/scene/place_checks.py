"""Checks of places: who drives beside the carriageway, obliquely to it, or in one another."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ..errors import InputError
from ..names import SIDES
from ..road.road_map import wrap_angle
from ..traffic.lanes import FEWEST_ON_A_ROAD, LANE_WIDTHS_M, USUAL_LANE_M, density_peaks
from ..traffic.vehicles import Recording, frames_looked_at, overlapping_pairs
from . import usual
from .region import Region, region_of
from .scenario import Scenario


@dataclass(frozen=True, slots=True, eq=False)
class Placed:
    """Boxes about the region, a sample, as they lie on the road; the one place that knows how a road lies.

    Attributes
    ----------
    t : ndarray, (n,)
        Across the road, to the left [m].
    heading_rad : ndarray, (n,)
        From the direction in which their lane drives [rad].
    vehicle : ndarray, (n,) int
    inside, on_road : ndarray, (n,) bool
        Whether they lie in the region, and on a lane.
    edges : (float, float)
        The t of the road's outermost edges [m].
    region : Region
    """

    t: np.ndarray
    heading_rad: np.ndarray
    vehicle: np.ndarray
    inside: np.ndarray
    on_road: np.ndarray
    edges: tuple[float, float]
    region: Region

    @classmethod
    def of(cls, recording: Recording, scenario: Scenario) -> Placed:
        """Those of a recording in the circle about a scene's region."""
        road = scenario.road_map
        region = region_of(scenario.region, road)
        near = np.flatnonzero(region.distance(recording) <= region.radius_m)
        near = near[np.unique(np.linspace(0, len(near) - 1, min(len(near), usual.SAMPLE)).astype(int))]
        part = recording.where(np.bincount(near, minlength=len(recording)) > 0)
        at = road.locate(part.centre_m, part.heading_rad)
        heading = part.heading_rad - at.heading_rad
        edges = road.edges_t if scenario.straight else (0.0, 0.0)
        return cls(at.t_m, heading, part.vehicle_id, region.holds(part), at.lane >= 0, edges, region)

    @property
    def name(self) -> str:
        return "the carriageway of [road], y {:g} to {:g} m".format(*self.edges)

    def beside(self, which: np.ndarray, least: float) -> bool:
        """Whether less than a share of some lie on the carriageway, and nearly all on one as wide that overlaps it."""
        low, high = self.edges
        t = np.sort(self.t[which])
        held = np.searchsorted(t, t + (high - low), side="right") - np.arange(len(t))
        best = held.argmax()
        few = self.on_road[which].mean() < least
        return bool(few and held[best] > usual.ALL * len(t) and abs(t[best] - low) < high - low)


def carriageway(recording: Recording, scenario: Scenario, placed: Placed, heading_known: bool) -> str | None:
    """Vehicles that drive obliquely to the road, or almost none of the region on its carriageway."""
    if scenario.straight is None:
        return _off_map(recording, scenario, placed.region)
    inside, stretches = placed.inside, scenario.region.stretches
    heading = placed.heading_rad[inside]
    oblique = (np.abs(np.sin(heading)) <= math.sin(usual.ALONG_RAD)).mean() < usual.FEW if heading.size else False
    if oblique and len(heading) >= usual.FEWEST and heading_known and not recording.report.periods:
        axis = 0.5 * float(np.angle(np.exp(2j * heading).mean()))  # of both ways along it
        axis += math.pi if np.cos(heading - axis).sum() < 0.0 else 0.0
        if (np.abs(np.sin(heading - axis)) <= math.sin(usual.ALONG_RAD)).mean() >= usual.MINORITY:
            at, meant = _turn_meant(axis, scenario)
            return (
                f"vehicles in the region drive at {at:g} degrees to the road's x axis (usual: along it); probably "
                f"[traffic] heading_deg = {meant:g}, the direction of travel in the file"
            )
    looked_at = inside | bool(stretches)  # beside a stretch too
    if looked_at.sum() < usual.FEWEST:
        return None
    share = placed.on_road[looked_at].mean()
    nobody = share < usual.FEW and not (inside.sum() >= usual.FEWEST if stretches else _keep_to_it(placed))
    if not nobody and not placed.beside(looked_at, usual.MINORITY):
        return None
    return (
        f"{100 * share:.0f} % of the boxes {'about' if stretches else 'in'} the region lie on {placed.name}, but at "
        f"{_span('y', placed.t[looked_at])}; "
        f"{_place_meant(placed.t[looked_at], recording, scenario)}"
    )


def _off_map(recording: Recording, scenario: Scenario, region: Region) -> str | None:
    """Most vehicles beside the roads of the map: how far apart both are, and what would join them."""
    part = recording.where(np.arange(len(recording)) % max(1, len(recording) // usual.SAMPLE) == 0)
    near = region.distance(part) <= region.radius_m
    looked_at = part.where(near) if near.sum() >= usual.FEWEST else part
    share = scenario.road_map.on(looked_at.centre_m).mean()
    if len(looked_at) < usual.FEWEST or share >= usual.HALF:
        return None
    middle = np.median(part.centre_m[:, :2], axis=0)
    away = float(np.hypot(*(middle - region.centre_xy)))
    return (
        f"{100 * share:.0f} % of the boxes lie on the map's roads; the middle of the traffic is {away:.0f} m from that "
        f"of the region, by x {middle[0] - region.centre_xy[0]:.0f}, y {middle[1] - region.centre_xy[1]:.0f} m; check "
        "[traffic] origin_m and heading_deg, which place the recording, and [road] origin_m, which places the map (of "
        "traffic in UTM and a SUMO net they differ by its netOffset)"
    )


def _keep_to_it(placed: Placed) -> bool:
    """Whether three vehicles keep to the carriageway in the region: then others may be many beside it."""
    along = placed.on_road & (np.cos(placed.heading_rad) > math.cos(usual.ALONG_RAD))
    of_row = np.unique(placed.vehicle[placed.inside], return_inverse=True)[1].reshape(-1)
    keeping = np.bincount(of_row, along[placed.inside]) > usual.MOST * np.bincount(of_row)
    return bool(keeping.sum() >= FEWEST_ON_A_ROAD and along[placed.inside].sum() >= usual.FEWEST)


def _place_meant(t: np.ndarray, recording: Recording, scenario: Scenario) -> str:
    """What would put vehicles at `t` onto the carriageway, in words."""
    if recording.report.periods:
        at = _span("Local_X", scenario.road.in_ngsim(0.0, t)[1])
        return f"check [road] right_edge_m, in metres where NGSIM has feet: vehicles drive at {at}"
    return (
        "check [traffic] origin_m and heading_deg, the unit and the side (y mirrored, or half a turn), and [road] "
        "setback_m, lanes and lane_width_m"
    )


# --- What is suspicious and may be right --------------------------------------------------------------------------


def _turn_meant(axis: float, scenario: Scenario) -> tuple[float, float]:
    """A direction in the road frame [rad] in degrees, and as what `heading_deg` would make it the road's."""
    turns = axis, axis + math.radians(scenario.traffic.heading_deg or 0.0)
    return tuple(round(math.degrees(wrap_angle(angle)), 1) + 0.0 for angle in turns)


def place_notes(recording: Recording, scenario: Scenario, placed: Placed, accepted: bool) -> Iterator[str]:
    """What is suspicious of the places, as sentences; `accepted` is a warning of the carriageway."""
    if scenario.straight is None:
        return
    t, heading, inside, on_road = placed.t, placed.heading_rad, placed.inside, placed.on_road
    (low, high), width = placed.edges, float(np.median(scenario.road_map.width_m))
    ahead = inside & (np.cos(heading) > math.cos(usual.ASTRAY_RAD))
    off = ahead.sum() >= usual.FEWEST and placed.beside(ahead, usual.MOST)
    off |= inside.any() and on_road[inside].mean() < usual.MINORITY
    if off and not accepted and not scenario.region.stretches:
        share = f"{100 * on_road[inside].mean():.2g} % of the boxes in the region"
        yield f"{share} lie on {placed.name}; they drive at {_span('y', t[inside])}: check [traffic] and [road]"
    if not LANE_WIDTHS_M[0] <= width <= LANE_WIDTHS_M[1]:
        yield f"[road] lane_width_m is {width:g} m (usual: {LANE_WIDTHS_M[0]:g} to {LANE_WIDTHS_M[1]:g})"
    lane = max(width, USUAL_LANE_M)
    along = (t > low - lane) & (t < high + lane) & (np.abs(np.sin(heading)) < math.sin(usual.ASTRAY_RAD))
    next_to = (along & ~inside & ~on_road).sum()
    if scenario.region.stretches and inside.any() and next_to > usual.SOME * (inside.sum() + next_to):
        share = f"{100 * next_to / (inside.sum() + next_to):.0f} % of the vehicles"
        yield (
            f"{share} drive within one lane beside {placed.name}, and do not count; check [road] setback_m and lanes, "
            "and [traffic] origin_m"
        )
    against = np.cos(heading) < -math.cos(usual.ASTRAY_RAD)
    there = inside & on_road
    share = against[there].mean() if there.sum() >= usual.FEWEST else 0.0
    if share > usual.SOME:
        yield (
            f"{100 * share:.0f} % of the region's boxes on {placed.name}, drive against the direction of their lane, "
            "and they count; if they belong to another carriageway, check [road] setback_m and lanes, or give [region] "
            "keep_out"
        )
    nearly = np.arctan(np.tan(heading[there & (np.abs(np.sin(heading)) < math.sin(usual.DRIFT_RAD[1]))]))  # both ways
    drift, length = float(np.median(nearly)) if len(nearly) >= usual.FEWEST else 0.0, 2.0 * placed.region.radius_m
    if abs(drift) >= usual.DRIFT_RAD[0]:
        at, meant = _turn_meant(drift, scenario)
        yield (
            f"vehicles on the carriageway drive at {at:g} degrees to the road's x axis, "
            f"{length * abs(math.tan(drift)):.1f} m across it in {length:.0f} m; check [traffic] heading_deg (such as "
            f"{meant:g}), if the road does not bend there"
        )
    yield from _lane_notes(t[inside & along], scenario)
    pairs, boxes = _overlapping(recording)
    if usual.SOME * boxes < pairs <= usual.OVERLAPPING * boxes:
        yield f"{100 * pairs / boxes:.0f} pairs among 100 boxes overlap (usual: none, or a few)"
    drives_on, beside = scenario.road.drives_on, against & ((t < low) | (t > high))
    wrong = beside & (t < low if drives_on == SIDES[0] else t > high)
    travels = there.sum() >= usual.FEWEST and share < usual.HALF
    if travels and wrong.sum() >= usual.FEWEST and wrong.sum() > usual.MOST * beside.sum():
        other = SIDES[1] if drives_on == SIDES[0] else SIDES[0]
        yield (
            f"oncoming vehicles drive to the {drives_on} of {placed.name}, at {_span('y', t[wrong])}: either this is "
            f'{other}-hand traffic ([road] drives_on = "{other}"), where a pole on the {drives_on} stands between both '
            "directions and not at the roadside, or y is mirrored in the file"
        )


def _lane_notes(t: np.ndarray, scenario: Scenario) -> Iterator[str]:
    """Two lanes and more, found by where boxes lie across the road (n,) [m], that are not those of [road]."""
    if len(t) < 5 * usual.FEWEST:
        return
    lanes, width = np.sort(density_peaks(t, np.ones(len(t)))), float(np.median(scenario.road_map.width_m))
    in_lanes = (np.abs(t[:, None] - lanes) <= usual.ABOUT_LANE_M).any(axis=1).mean()
    spacing = np.diff(lanes)
    if len(lanes) < 2 or in_lanes <= usual.MOST or spacing.max() > (1.0 + usual.MANY) * spacing.min():
        return
    apart = float(spacing.mean())
    if abs(apart / width - 1.0) > usual.WIDER:
        yield (
            f"vehicles drive in {len(lanes)} lanes {apart:.2f} m apart, but [road] lane_width_m is {width:g} m; if "
            "that is right, check the unit and the scale of the file's x and y"
        )
        return
    off = np.abs(lanes[:, None] - scenario.road_map.offset_m).min(axis=1) / width
    off = width * np.abs(off - np.rint(off))
    if off.min() > usual.OFF_LANE_M:
        yield (
            f"vehicles drive {off.mean():.1f} m beside the lane centres of [road], at y "
            f"{', '.join(f'{one:.1f}' for one in lanes)} m; check [road] setback_m and the place of the file's origin"
        )


# --- Boxes in one another -----------------------------------------------------------------------------------------


def _overlapping(recording: Recording) -> tuple[int, float]:
    """Pairs of boxes that overlap, and among how many boxes they were looked for."""
    report = recording.report
    return report.overlaps, report.overlap_frames * len(recording) / len(recording.frames)


def overlaps(recording: Recording) -> str | None:
    """Boxes that stand in one another."""
    pairs, boxes = _overlapping(recording)
    most = usual.SOME if recording.report.periods else usual.OVERLAPPING  # NGSIM's are under 0.1 %
    if boxes < usual.FEWEST or not pairs:
        return None
    twice = _in_one_place(recording)
    if usual.FEW * boxes < twice <= most * boxes:
        return f"{twice:,} of {boxes:,.0f} boxes stand where another one stands; probably vehicles are listed twice"
    if pairs <= most * boxes:
        return None
    return (
        f"{pairs:,} pairs among {boxes:,.0f} boxes overlap (usual: none, or a few in a hundred); probably vehicles are "
        "listed twice under different ids, sizes are too large (SUMO: give vehicle_types), x and y are bumpers and not "
        "box centres, or they are in feet or in degrees of longitude and latitude and not in metres"
    )


def _in_one_place(recording: Recording) -> int:
    """Pairs of boxes that overlap about one middle, in the frames in which overlaps were looked for."""
    found = 0
    for frame in frames_looked_at(recording):
        vehicles = recording.vehicles(frame)
        one, other = overlapping_pairs(vehicles).T
        apart = vehicles.centre_m[one, :2] - vehicles.centre_m[other, :2]
        found += int((np.hypot(*apart.T) < usual.SAME_PLACE_M).sum())
    return found


# --- Where vehicles are --------------------------------------------------------------------------------------------


def nobody_there(recording: Recording, region: Region, frames: int, scenario: Scenario) -> InputError:
    """The error for a region where nobody drives: where vehicles are, and the keys that move one to the other."""
    road, (x, y) = scenario.road_map, recording.centre_m[:, :2].T
    at, (first, last) = road.locate(recording.centre_m), road.stretch(region.centre_xy, region.radius_m)
    beside = (at.s_m >= first) & (at.s_m <= last)
    if scenario.straight and beside.any() and (at.lane[beside] >= 0).mean() < usual.FEW:
        meant = _place_meant(at.t_m[beside], recording, scenario)
    elif asked := {lane for one in scenario.region.stretches or () for lane in one.lanes or ()}:
        there = ", ".join(map(str, np.unique(recording.lane[recording.lane != 0]).tolist()))
        meant = f"its lanes are {there}" if there else "it names no lanes"
        meant = f"check [region] stretches: of lanes {', '.join(map(str, sorted(asked)))}, {meant}"
    elif recording.report.periods:
        local_y, _ = scenario.road.in_ngsim(np.median(x), 0.0)
        meant = f"check [road] station_m (such as {local_y:.0f}) and [region]"
    else:
        meant = "check [traffic] origin_m and heading_deg, and [region]"
    return InputError(
        f"{recording.source}: no vehicle in the region, within {region.radius_m:g} m of x {region.centre_xy[0]:g} m, y "
        f"{region.centre_xy[1]:g} m, in the {frames} searched frames; in the road frame vehicles drive at "
        f"{_span('x', x)}, {_span('y', y)}; {meant}"
    )


def _span(name: str, values: np.ndarray) -> str:
    low, high = np.quantile(values, [0.05, 0.95]) + 0.0
    return f"{name} {low:.0f} to {high:.0f} m"


# --- How the ground rises, where the recording says so ----------------------------------------------------------------


def known_grades(recording: Recording, scenario: Scenario) -> tuple[float, float] | None:
    """`grades_percent` of a recording about the region's middle; None on a map, whose heights are its own."""
    if scenario.straight is None:
        return None
    return grades_percent(recording.report.ground, region_of(scenario.region, scenario.road_map).centre_xy[0])


def grades_percent(ground: np.ndarray, middle_m: float) -> tuple[float, float] | None:
    """How the ground (n, 3) rises along x before a place and beyond it [%], by least squares.

    From what lies within `usual.GROUND_M` along the road and `usual.BESIDE_M` beside it; None where that is too little.
    """
    found = []
    for side in (-1.0, 1.0):
        along = side * (ground[:, 0] - middle_m)
        near = ground[(along >= 0.0) & (along <= usual.GROUND_M) & (np.abs(ground[:, 1]) <= usual.BESIDE_M)]
        if len(near) < usual.FEWEST or np.ptp(near[:, 0]) < 0.3 * usual.GROUND_M:
            return None
        found.append(100.0 * float(np.polyfit(near[:, 0], near[:, 2], 1)[0]))
    return found[0], found[1]


def grade(known: tuple[float, float] | None, said: float) -> str | None:
    """A ground that rises otherwise than [road] grade_percent says, or has a crest or a dip; `known_grades` before."""
    if known is None:
        return None
    before, beyond = known
    if abs(beyond - before) > 2.0 * usual.GRADE_PERCENT:
        what = "crest" if beyond < before else "dip"
        return (
            f"the file's heights make a {what} at the region, from {before:+.1f} to {beyond:+.1f} % along x, and a "
            "road here is one plane; choose another place, or a shorter [region]"
        )
    measured = 0.5 * (before + beyond)
    if abs(measured - said) > usual.GRADE_PERCENT:
        return (
            f"the file's heights rise by {measured:+.1f} % along x, and [road] grade_percent says {said:g}; probably "
            f"it should be {measured:.1f}"
        )
    return None
