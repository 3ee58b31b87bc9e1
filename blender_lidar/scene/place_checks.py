"""Checks of places: who drives beside the carriageway, obliquely to it, or in one another."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from ..errors import InputError
from ..traffic import format_of
from ..traffic.layout import density_peaks
from ..traffic.ngsim import FOOT_M
from ..traffic.vehicles import Recording, frames_looked_at, overlapping_pairs
from .motion_checks import ASTRAY_RAD, FEWEST, FITTING, ROWS, Ways, headings, within_half_a_turn
from .region import Region, region_of
from .settings import Scenario

_FEWEST_ON_ROAD = 0.02  # share; at an intersection, or with both directions in one recording, many drive elsewhere
_FEW_ON_ROAD = 0.4  # are no cause to stop, but told
_MOST_ON_ROAD = 0.9  # and these where one as wide would hold all
_ALL_ON_ROAD = 0.95  # of a carriageway as wide that lies elsewhere
_ALONG_RAD = math.radians(5.0)
_MANY_ALIKE = 0.4  # share of the boxes that drive in one direction


def _on_road(y: np.ndarray, scenario: Scenario) -> float:
    low, high = scenario.road.carriageway_y
    return float(((y >= low) & (y <= high)).mean())


def _about_region(recording: Recording, scenario: Scenario) -> tuple[Recording, np.ndarray]:
    """The boxes in the circle about the region, a sample, and which of them lie in the region."""
    region = region_of(scenario.region, scenario.road.carriageway_y)
    near = np.flatnonzero(region.distance(recording) <= region.radius_m)
    near = near[np.unique(np.linspace(0, len(near) - 1, min(len(near), ROWS)).astype(int))]
    part = recording.where(np.bincount(near, minlength=len(recording)) > 0)
    return part, region.holds(part)


def carriageway(recording: Recording, sample: Recording, ways: Ways, scenario: Scenario) -> str | None:
    """Vehicles that drive obliquely to the road, or next to none of the region on its carriageway."""
    about, inside = _about_region(recording, scenario)
    known = len(ways.seconds) >= FEWEST and not recording.report.periods
    known = known and headings(recording, sample, ways, scenario) is None
    oblique = _oblique(about.heading_rad[inside]) if known else None
    if oblique is not None:
        turn = within_half_a_turn(oblique + math.radians(scenario.traffic.heading_deg or 0.0))
        at, meant = (round(math.degrees(angle), 1) + 0.0 for angle in (oblique, turn))
        return (
            f"vehicles in the region drive at {at:g} degrees to the road's x axis (usual: along it); probably "
            f"[traffic] heading_deg = {meant:g}, the direction of travel in the file"
        )
    low, high = scenario.road.carriageway_y
    y = about.centre_m[inside | bool(scenario.region.stretches), 1]  # beside a stretch too
    if len(y) < FEWEST:
        return None
    none_there = _on_road(y, scenario) < _FEWEST_ON_ROAD and not _is_driven_on(about, inside, scenario)
    if not (none_there or _lies_beside(y, low, high, _FEW_ON_ROAD)):
        return None
    return (
        f"{100 * _on_road(y, scenario):.0f} % of the boxes {'about' if scenario.region.stretches else 'in'} the region "
        f"lie on the carriageway of [road], y {low:g} to {high:g} m, but at {_span('y', y)}; "
        f"{_place_meant(y, about.heading_rad[inside | bool(scenario.region.stretches)], recording, scenario)}"
    )


_FEWEST_VEHICLES = 3


def _is_driven_on(about: Recording, inside: np.ndarray, scenario: Scenario) -> bool:
    """Whether a few vehicles keep to the carriageway in the region: then others may be many beside it."""
    if scenario.region.stretches:
        return inside.sum() >= FEWEST
    low, high = scenario.road.carriageway_y
    y = about.centre_m[inside, 1]
    on_road = (y >= low) & (y <= high) & (np.cos(about.heading_rad[inside]) > math.cos(_ALONG_RAD))
    of_row = np.unique(about.vehicle_id[inside], return_inverse=True)[1].reshape(-1)
    keeping = np.bincount(of_row, on_road) > FITTING * np.bincount(of_row)
    return bool(keeping.sum() >= _FEWEST_VEHICLES and on_road.sum() >= FEWEST)


def _lies_beside(y: np.ndarray, low: float, high: float, most: float) -> bool:
    """Whether a carriageway holds less than `most` of the boxes while one as wide that overlaps it holds all.

    `y` (n,) is where boxes lie across the road [m], `low` and `high` are the carriageway's edges [m].
    """
    found = np.sort(y)
    held = np.searchsorted(found, found + (high - low), side="right") - np.arange(len(y))
    best = found[held.argmax()]
    few = ((y >= low) & (y <= high)).mean() < most
    return bool(few and held.max() > _ALL_ON_ROAD * len(y) and abs(best - low) < high - low)


def _oblique(heading_rad: np.ndarray) -> float | None:
    """The direction that most headings (n,) share [rad], where next to none of them lie along x; else None."""
    if len(heading_rad) < FEWEST:
        return None

    def alike(axis: float) -> np.ndarray:
        return np.abs(np.sin(heading_rad - axis)) <= math.sin(_ALONG_RAD)  # both directions

    axis = max(np.radians(np.arange(180.0)), key=lambda axis: alike(axis).sum())
    if alike(0.0).mean() >= _FEWEST_ON_ROAD or alike(axis).mean() < _MANY_ALIKE:
        return None
    ahead = alike(axis) & (np.cos(heading_rad - axis) > 0.0)
    most = ahead if 2 * ahead.sum() >= alike(axis).sum() else alike(axis) & ~ahead
    return float(np.angle(np.exp(1j * heading_rad[most]).mean()))


def _place_meant(y: np.ndarray, heading_rad: np.ndarray, recording: Recording, scenario: Scenario) -> str:
    """What would put vehicles at `y` onto the carriageway, in words."""
    road, ngsim = scenario.road, bool(recording.report.periods)
    if ngsim and _on_road(y + (FOOT_M - 1.0) * road.right_edge_m, scenario) > FITTING:
        return f"probably [road] right_edge_m = {road.right_edge_m:g} is in feet: {FOOT_M * road.right_edge_m:.4g} m"
    if ngsim:
        local_x = road.setback_m + road.right_edge_m - y
        return f"check [road] right_edge_m: vehicles drive at {_span('Local_X', local_x)}"
    if _on_road(-y, scenario) > FITTING:
        if (np.cos(heading_rad) < 0.0).mean() > FITTING:
            return "probably the other side: turn [traffic] heading_deg by 180 degrees"
        return "probably the other side: y is mirrored, or [traffic] origin_m lies to the left of the road"
    low, high = road.carriageway_y
    spread = float(np.diff(np.quantile(y, [0.05, 0.95]))[0])
    if _on_road(FOOT_M * y, scenario) > FITTING and spread > high - low:  # else an origin explains it as well
        return "probably feet for metres"
    return "check [traffic] origin_m and heading_deg, and [road] setback_m, lanes and lane_width_m"


_DRIFT_RAD = (math.radians(1.5), math.radians(15.0))  # least that is told, and who still drives along the road
_MOST_TO_THE_RIGHT = 0.8  # share of those who come the other way
_MANY_OVERLAPS = 0.05  # pairs for each box that are told
_FEWEST_TO_END = 100  # boxes, to tell how far traffic is recorded
_LANE_WIDTHS_M, _USUAL_LANE_M = (2.4, 5.2), 3.5
_FEW_BESIDE = 0.05  # share within a lane of the carriageway that is not told
_FEW_AGAINST = 0.05  # share of the boxes on the carriageway that is not told


def place_notes(recording: Recording, scenario: Scenario, accepted: bool) -> Iterator[str]:
    """What is suspicious of the places and may be right, as sentences; `accepted` is a warning of the carriageway."""
    about, inside = _about_region(recording, scenario)
    y, heading = about.centre_m[inside, 1], about.heading_rad[inside]
    low, high = scenario.road.carriageway_y
    road = f"the carriageway of [road], y {low:g} to {high:g} m"
    ahead = y[np.cos(heading) > math.cos(ASTRAY_RAD)]
    told = len(ahead) >= FEWEST and _lies_beside(ahead, low, high, _MOST_ON_ROAD)
    told |= len(y) > 0 and _on_road(y, scenario) < _FEW_ON_ROAD
    if told and not accepted and not scenario.region.stretches:
        share = f"{100 * _on_road(y, scenario):.2g} % of the boxes in the region"
        yield f"{share} lie on {road}; they drive at {_span('y', y)}: check [traffic] and [road]"
    y_about, along = about.centre_m[:, 1], np.abs(np.sin(about.heading_rad)) < math.sin(ASTRAY_RAD)
    lane = max(scenario.road.lane_width_m, _USUAL_LANE_M)
    narrowest, widest = _LANE_WIDTHS_M
    if not narrowest <= scenario.road.lane_width_m <= widest:
        yield f"[road] lane_width_m is {scenario.road.lane_width_m:g} m (usual: {narrowest:g} to {widest:g})"
    next_to = along & ~inside & (y_about > low - lane) & (y_about < high + lane) & ((y_about < low) | (y_about > high))
    beside = next_to.sum() / max(len(y) + next_to.sum(), 1)
    if scenario.region.stretches and len(y) and beside > _FEW_BESIDE:
        share = f"{100 * beside:.0f} % of the boxes on it and within a lane beside it"
        yield f"{share} lie beside {road}, and do not count; check [road] setback_m and lanes, and [traffic] origin_m"
    on_road = heading[(y >= low) & (y <= high)]
    against = np.cos(on_road) < -math.cos(ASTRAY_RAD)
    if len(against) >= FEWEST and against.mean() > _FEW_AGAINST:
        yield (
            f"{100 * against.mean():.0f} % of the region's boxes on {road}, drive against +x and count as the others "
            "do; if they belong to another carriageway, check [road] setback_m and lanes, or give [region] keep_out"
        )
    yield from _drift_notes(on_road, scenario)
    yield from _lane_notes(y[(y >= low - lane) & (y <= high + lane) & along[inside]], scenario)
    yield from _end_notes(recording, scenario)
    many = recording.report.overlaps / max(recording.report.overlap_frames * len(recording) / len(recording.frames), 1)
    if _MANY_OVERLAPS < many <= _MOST_OVERLAPS:
        yield f"{100 * many:.0f} pairs of boxes overlap among 100 (usual: none, or a few)"
    coming = np.cos(about.heading_rad) < -math.cos(ASTRAY_RAD)
    right, left = coming & (y_about < low), coming & (y_about > high)
    travel = len(against) >= FEWEST and against.mean() < 0.5
    if travel and right.sum() >= FEWEST and right.sum() > _MOST_TO_THE_RIGHT * (right | left).sum():
        yield (
            f"those who come the other way drive to the right of {road}, at {_span('y', y_about[right])}: left-hand "
            "traffic, or y is mirrored in the file; a pole on that side stands between both directions, not at the "
            "roadside"
        )


_MOST_OFF_LANE_M, _ABOUT_LANE_M, _MOST_WIDER = 1.0, 0.7, 0.08
_FEWEST_IN_LANES = 100  # boxes


def _lane_notes(y: np.ndarray, scenario: Scenario) -> Iterator[str]:
    """Two lanes and more, told by where boxes lie across the road (n,) [m], that are not those of [road]."""
    if len(y) < _FEWEST_IN_LANES:
        return
    lanes = np.sort(density_peaks(y, np.ones(len(y))))
    in_lanes = (np.abs(y[:, None] - lanes) <= _ABOUT_LANE_M).any(axis=1).mean()
    spacing = np.diff(lanes)
    width = scenario.road.lane_width_m
    if len(lanes) < 2 or in_lanes <= FITTING or spacing.max() > 1.2 * spacing.min():
        return
    apart = float(spacing.mean())
    if abs(apart / width - 1.0) > _MOST_WIDER:
        yield (
            f"vehicles drive in {len(lanes)} lanes {apart:.2f} m apart, but [road] lane_width_m is {width:g} m; if "
            "that is right, check the unit and scale of the places"
        )
        return
    off = (lanes - scenario.road.carriageway_y[0]) / width - 0.5
    off = width * (off - np.rint(off))
    if np.abs(off).min() > _MOST_OFF_LANE_M:
        yield (
            f"vehicles drive {np.abs(off).mean():.1f} m beside the middles of the lanes of [road], at y "
            f"{', '.join(f'{one:.1f}' for one in lanes)} m; check [road] setback_m and where the file's origin is put"
        )


_SHORT_M = 10.0


def _end_notes(recording: Recording, scenario: Scenario) -> Iterator[str]:
    """A region that reaches beyond where anybody is recorded along the road."""
    settings, region = scenario.region, region_of(scenario.region, scenario.road.carriageway_y)
    x, y = recording.centre_m[:, 0], recording.centre_m[:, 1]
    x = x[np.abs(y - region.centre_xy[1]) <= region.radius_m]
    if settings.polygon_m is not None or len(x) < _FEWEST_TO_END:
        return
    spans = [one.x_m for one in settings.stretches or ()]
    spans = spans or [(settings.centre_m[0] - settings.radius_m, settings.centre_m[0] + settings.radius_m)]
    low, high = min(low for low, _ in spans), max(high for _, high in spans)
    is_there = ((x >= low) & (x <= high)).any()
    if is_there and (x.min() - low > _SHORT_M or high - x.max() > _SHORT_M):
        yield (
            f"the region reaches from x {low:g} to {high:g} m, and vehicles are recorded there from {x.min():.0f} to "
            f"{x.max():.0f} m: beyond, the LiDAR is not asked to see anybody"
        )


def _drift_notes(heading_rad: np.ndarray, scenario: Scenario) -> Iterator[str]:
    """Vehicles on the carriageway that drive a little obliquely to it, and so across its lanes."""
    least, most = _DRIFT_RAD
    along = heading_rad[np.abs(np.sin(heading_rad)) < math.sin(most)]
    drift = float(np.median(np.arctan(np.tan(along)))) if len(along) >= FEWEST else 0.0  # both directions
    if abs(drift) >= least:
        radius = region_of(scenario.region, scenario.road.carriageway_y).radius_m
        at = round(math.degrees(drift), 1)
        meant = round((scenario.traffic.heading_deg or 0.0) + at, 1) + 0.0
        across = 2 * radius * abs(math.tan(drift))
        yield (
            f"vehicles on the carriageway drive at {at:g} degrees to the road's x axis, {across:.1f} m across it in "
            f"{2 * radius:.0f} m; check [traffic] heading_deg (such as {meant:g}), if the road does not bend there"
        )


_MOST_OVERLAPS = 0.2  # pairs for each box
_MOST_TWICE, _SAME_PLACE_M = 0.02, 0.5
_LEFT = 0.1  # share of overlaps that are left where a guess is right


def overlaps(recording: Recording, sample: Recording, ways: Ways, scenario: Scenario) -> str | None:
    """Boxes that stand in one another."""
    report = recording.report
    boxes = report.overlap_frames * len(recording) / len(recording.frames)
    if boxes < FEWEST or not report.overlaps:
        return None
    seen = f"{report.overlaps:,} pairs of boxes overlap among {boxes:,.0f}"
    _, twice = _pairs(recording)
    if _MOST_TWICE * boxes < twice <= _MOST_OVERLAPS * boxes:
        return f"{twice:,} of {boxes:,.0f} boxes stand where another one does; probably vehicles are there twice"
    if report.overlaps <= _MOST_OVERLAPS * boxes:
        return _bumpers(recording, seen)
    if any("no vehicle_types" in note for note in report.notes):
        meant = "vehicles are smaller than SUMO's defaults: give their [traffic] vehicle_types"
    elif np.ptp(recording.centre_m[:, :2], axis=0).max() < 1.0:
        meant = "x_m and y_m are degrees of longitude and latitude: give metres"
    elif recording.report.periods:
        meant = "vehicles are there twice under other ids, or Local_X or Local_Y is not in feet"
    else:
        meant = "vehicles are there twice under other ids, or x_m and y_m are not the boxes' centres, or not in metres"
    return f"{seen} (usual: none, or a few in a hundred); probably {meant}"


def _pairs(recording: Recording, ahead: float = 0.0) -> tuple[int, int]:
    """Pairs that overlap, and those in one place, in the frames looked at; boxes moved by so many of their lengths."""
    overlapping = twice = 0
    for frame in frames_looked_at(recording):
        vehicles = recording.vehicles(frame)
        centre = vehicles.centre_m.copy()
        forward = np.stack([np.cos(vehicles.heading_rad), np.sin(vehicles.heading_rad)], axis=1)
        centre[:, :2] += ahead * vehicles.size_m[:, :1] * forward
        pairs = overlapping_pairs(replace(vehicles, centre_m=centre))
        overlapping += len(pairs)
        apart = centre[pairs[:, 0], :2] - centre[pairs[:, 1], :2]
        twice += int((np.hypot(*apart.T) < _SAME_PLACE_M).sum())
    return overlapping, twice


def _bumpers(recording: Recording, seen: str) -> str | None:
    """Places that are the bumpers' in a table: in dense traffic of several lengths boxes overlap; moved ones do not.

    In free flow nothing tells: all lie half a length ahead, which moves an answer along the road alone.
    """
    if recording.report.overlaps < FEWEST or format_of(recording.source) != "table":
        return None
    for bumpers, ahead in (("front", -0.5), ("rear", 0.5)):
        left = _pairs(recording, ahead)[0]
        if left < _LEFT * recording.report.overlaps:
            return (
                f"{seen}, and {left:,} if their places are taken for the middles of {bumpers} bumpers; probably x_m "
                f"and y_m are those: give the boxes' centres, half a length {'behind' if ahead < 0 else 'ahead'}"
            )
    return None


# --- Where vehicles are --------------------------------------------------------------------------------------------


def nobody_there(recording: Recording, region: Region, frames: int, scenario: Scenario) -> InputError:
    """The error for a region where nobody drives: where vehicles are, and the keys that move one to the other."""
    x, y = recording.centre_m[:, 0], recording.centre_m[:, 1]
    beside = np.abs(x - region.centre_xy[0]) <= region.radius_m
    if beside.any() and _on_road(y[beside], scenario) < _FEWEST_ON_ROAD:
        meant = _place_meant(y[beside], recording.heading_rad[beside], recording, scenario)
    elif asked := {lane for one in scenario.region.stretches or () for lane in one.lanes or ()}:
        there = ", ".join(map(str, np.unique(recording.lane[recording.lane != 0]).tolist()))
        meant = f"its lanes are {there}" if there else "it names no lanes"
        meant = f"check [region] stretches: of lanes {', '.join(map(str, sorted(asked)))}, {meant}"
    elif recording.report.periods:
        meant = f"check [road] station_m (such as {scenario.road.station_m + np.median(x):.0f}) and [region]"
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
