"""Plausibility of a recording: wrong units, columns and places, which would end in a wrong answer, stop a run.

Each check has a name of `names.WARNINGS` and looks at a sample. What `[traffic] accept` or ``--accept`` names does not
stop a run, but stands in all that it tells.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from itertools import permutations

import numpy as np

from ..errors import InputError
from ..traffic import format_of
from ..traffic.ngsim import FOOT_M
from ..traffic.vehicles import CLASSES, Placing, Recording
from .region import Region, region_of
from .settings import Scenario

_ROWS = 20_000  # of the sample
_FEWEST = 20  # boxes, or ways of vehicles, that tell anything


def checked_recording(recording: Recording, scenario: Scenario) -> Recording:
    """The same recording; its report tells what cannot be true and is accepted.

    Parameters
    ----------
    recording : Recording
        The traffic of the scene, in the road frame.
    scenario : Scenario
        Whose `[traffic] accept` names the warnings to go on with.

    Raises
    ------
    InputError
        In one line what was seen, what is usual and what is probably meant, for the first that is not accepted.
    """
    rows = np.unique(np.linspace(0, len(recording) - 1, min(len(recording), _ROWS)).astype(int))
    sample = recording.where(np.bincount(rows, minlength=len(recording)) > 0)
    ways = Ways(recording)
    accepted = scenario.traffic.accept or ()
    warnings = []
    for name, check in _CHECKS.items():
        if name == "overlaps" and warnings:
            continue  # they come of what is told already
        text = check(recording, sample, ways, scenario)
        if text and name not in accepted:
            raise InputError(f"{recording.source}: {text}; to go on all the same: --accept {name}")
        if text:
            warnings.append((name, text))
    notes = (*recording.report.notes, *_place_notes(recording, scenario))
    return replace(recording, report=replace(recording.report, warnings=tuple(warnings), notes=notes))


# --- How vehicles have moved --------------------------------------------------------------------------------------

_MOST_APART = 64  # frames
_PAIRS = 40  # of frames
_FAR_ENOUGH_M = 2.0  # against the noise of positions
_MOVED_SHARE = 0.25


class Ways:
    """Where vehicles have gone between pairs of frames, spread over a recording and as far apart as it takes.

    Attributes
    ----------
    moved_m : ndarray, (w, 2)
        From a vehicle's place in one frame to that in the other, where it is at least 2 m [m].
    seconds : ndarray, (w,)
        Between the two [s].
    heading_rad : ndarray, (w,)
        The middle of its headings in both [rad].
    """

    def __init__(self, recording: Recording) -> None:
        frames, apart = len(recording.frames), 1
        found = self._between(recording, apart)
        while (np.hypot(*found[0].T) >= _FAR_ENOUGH_M).sum() < _MOVED_SHARE * len(found[0]) and apart < _MOST_APART:
            apart *= 2
            if apart >= frames:
                break
            found = self._between(recording, apart)
        far = np.hypot(*found[0].T) >= _FAR_ENOUGH_M
        self.moved_m, self.seconds, self.heading_rad = (one[far] for one in found)

    @staticmethod
    def _between(recording: Recording, apart: int) -> tuple[np.ndarray, ...]:
        frames = recording.frames
        pairs = int(np.clip(_ROWS / max(np.median(recording.counts), 1), 4, _PAIRS))
        last = len(frames) - 1 - apart
        parts = [(np.zeros((0, 2)), np.zeros(0), np.zeros(0))]
        for at in np.unique(np.linspace(0, last, min(pairs, last + 1)).astype(int)) if last >= 0 else ():
            before, after = recording.vehicles(frames[at]), recording.vehicles(frames[at + apart])
            _, one, other = np.intersect1d(before.vehicle_id, after.vehicle_id, return_indices=True)
            moved = after.centre_m[other, :2] - before.centre_m[one, :2]
            turn = _within_half_a_turn(after.heading_rad[other] - before.heading_rad[one])
            seconds = np.full(len(one), after.time_s - before.time_s)
            parts.append((moved, seconds, before.heading_rad[one] + 0.5 * turn))
        return tuple(np.concatenate(column) for column in zip(*parts, strict=True))

    @property
    def speed_m_s(self) -> np.ndarray:
        """Their speeds, (w,) [m/s]."""
        return np.hypot(*self.moved_m.T) / self.seconds

    def astray(self, heading_rad: np.ndarray) -> np.ndarray:
        """How far headings are off the directions of motion, counter-clockwise, (w,) [rad]."""
        return _within_half_a_turn(np.arctan2(self.moved_m[:, 1], self.moved_m[:, 0]) - heading_rad)

    def share_astray(self, heading_rad: np.ndarray) -> float:
        """The share of headings that are more than 30 degrees off."""
        return float((np.abs(self.astray(heading_rad)) > _ASTRAY_RAD).mean())

    def mean_astray(self, heading_rad: np.ndarray) -> float:
        """The circular mean of how far they are off [rad]: noise of positions leaves it where it is."""
        return float(np.angle(np.exp(1j * self.astray(heading_rad)).mean()))


def _within_half_a_turn(angle):
    return np.arctan2(np.sin(angle), np.cos(angle))


# --- The checks: what each has seen, and what is probably meant; nothing where all may be true --------------------

_LANE_SPACING_M = (0.7, 1.9)  # of lanes of 2.4 to 5.8 m, once more multiplied by a foot


def _units(recording: Recording, sample: Recording, ways: Ways, scenario: Scenario) -> str | None:
    """NGSIM's feet that are metres: lanes lie a metre apart, and all sizes had to be repaired."""
    report = recording.report
    if not report.periods or len(sample) < _FEWEST:  # which no other format has
        return None
    lanes = np.unique(sample.lane[sample.lane > 0])
    y = {lane: np.median(sample.centre_m[sample.lane == lane, 1]) for lane in lanes}
    spacing = [abs(y[lane + 1] - y[lane]) for lane in lanes if lane + 1 in y]
    low, high = _LANE_SPACING_M
    narrow = bool(spacing) and low <= np.median(spacing) <= high
    if not narrow or report.sizes_repaired < 0.5 * len(np.unique(recording.vehicle_id)):
        return None
    return (
        f"lanes lie {np.median(spacing):.1f} m apart (3 to 4 m is usual) and {report.sizes_repaired:,} vehicles have "
        "absurd sizes: NGSIM's columns are in feet, and these are probably metres; divide them by 0.3048"
    )


_SIZES_M = {  # least and largest length, width and height
    "car": ((2.6, 8.0), (1.1, 2.8), (0.9, 2.8)),
    "van": ((2.5, 20.0), (1.1, 3.0), (1.0, 4.5)),
    "truck": ((3.0, 40.0), (1.3, 3.6), (1.2, 5.0)),
    "bus": ((4.0, 60.0), (1.5, 3.6), (1.8, 5.0)),
    "motorcycle": ((0.8, 4.0), (0.25, 2.0), (0.6, 2.6)),
}
_UNITS = {"feet": FOOT_M, "centimetres": 0.01, "millimetres": 0.001, "inches": 0.0254}
_MOST_ODD = 0.5  # share of boxes: a class that is wrong for some is no wrong unit
_FITTING = 0.8  # share that a guess must set right


def _sizes(recording: Recording, sample: Recording, ways: Ways, scenario: Scenario) -> str | None:
    """Sizes that no vehicle of the class has: another unit, or columns swapped."""
    limits = np.array([_SIZES_M[name] for name in CLASSES])[sample.class_index]

    def odd(size: np.ndarray) -> float:
        return 1.0 - ((size >= limits[..., 0]) & (size <= limits[..., 1])).all(axis=1).mean()

    share = odd(sample.size_m)
    if len(sample) < _FEWEST:
        return None
    if share <= _MOST_ODD:
        return _of_one_class(sample, limits) or _heights_of_middles(sample)
    usual = int(np.bincount(sample.class_index).argmax())
    size = " by ".join(f"{one:.3g}" for one in np.median(sample.size_m[sample.class_index == usual], axis=0))
    names = [
        f"{unit} for metres"
        for unit, factor in {**_UNITS, "half lengths": 2.0}.items()
        if odd(sample.size_m * factor) < 1 - _FITTING
    ]
    columns = ("length_m", "width_m", "height_m")
    for order in permutations(range(3)):
        if odd(sample.size_m[:, order]) < 1 - _FITTING:
            names.append(
                "columns swapped: "
                + ", ".join(
                    f"{columns[one]} holds the {name}"
                    for one, name in zip(order, ("length", "width", "height"), strict=True)
                    if columns[one] != f"{name}_m"
                )
            )
    if recording.report.periods:  # whose sizes have been repaired, to the least where they were metres
        names = ["v_Length and v_Width in metres, where NGSIM has feet"]
    low, high = zip(*_SIZES_M[CLASSES[usual]], strict=True)
    return (
        f"{100 * share:.0f} % of the boxes have impossible sizes for their class: a median {CLASSES[usual]} is {size} "
        f"m (usual: {low[0]:g} to {high[0]:g} by {low[1]:g} to {high[1]:g} by {low[2]:g} to {high[2]:g} m); "
        f"probably {names[0] if names else 'another unit'}"
    )


def _of_one_class(sample: Recording, limits: np.ndarray) -> str | None:
    """A class whose sizes are another unit's, where those of the others are right."""
    for index in np.unique(sample.class_index):
        own = sample.class_index == index
        low, high = limits[own, :, 0], limits[own, :, 1]

        def fitting(factor: float, size: np.ndarray = sample.size_m[own], low=low, high=high) -> float:
            return float(((factor * size >= low) & (factor * size <= high)).all(axis=1).mean())

        unit = next((name for name, factor in _UNITS.items() if fitting(factor) > _FITTING), None)
        if own.sum() >= _FEWEST and unit is not None and fitting(1.0) < 1.0 - _FITTING:
            size = " by ".join(f"{one:.3g}" for one in np.median(sample.size_m[own], axis=0))
            return f"a median {CLASSES[index]} is {size} m, impossible for its class; probably {unit} for metres"
    return None


_MOST_OFF_M = 0.5


def _heights_of_middles(sample: Recording) -> str | None:
    """Boxes that stand above the road or in it: z_m that is not of their middles."""
    z, half = sample.centre_m[:, 2], 0.5 * sample.size_m[:, 2]
    if (np.abs(z - half) <= _MOST_OFF_M).mean() >= 1.0 - _MOST_ODD:
        return None
    meant = "heights above sea, or of another plane than the road"
    for name, would_be in (("the boxes' floors", z + half), ("the boxes' tops", z - half)):
        if (np.abs(would_be - half) <= _MOST_OFF_M).mean() > _FITTING:
            meant = name
    return (
        f"the boxes' middles lie {np.median(z):.3g} m above the road (usual: half their heights, "
        f"{np.median(half):.2g} m); probably z_m is of {meant}: leave the column out, and they stand on the road"
    )


_SPEEDS_M_S = (1.5, 70.0)  # nine of ten that move at all are slower than the one, or one of ten faster than the other
_USUAL_M_S = (2.0, 40.0)
_FASTEST_MEDIAN_M_S = 44.0  # 160 km/h
_LONGEST_CRAWL_S = 60.0
_ASTRAY_RAD = math.radians(30.0)
_MOST_ASTRAY = 0.25  # share of ways
_MEAN_ASTRAY_RAD = math.radians(8.0)  # real and generated recordings: at most 0.2 degrees


def _time_step(recording: Recording, sample: Recording, ways: Ways, scenario: Scenario) -> str | None:
    """Speeds that no traffic has: a wrong time step, or vehicles that are numbered anew in each frame."""
    if len(ways.seconds) < _FEWEST:
        return None
    usual, fast = np.quantile(ways.speed_m_s, [0.5, 0.9])
    low, high = _SPEEDS_M_S
    if (low <= fast <= high and usual <= _FASTEST_MEDIAN_M_S) or (
        fast < low and np.ptp(recording.frame_time_s) <= _LONGEST_CRAWL_S
    ):
        return None
    step = np.median(np.diff(recording.frame_time_s))
    speed = f"{usual:.2g}" if usual < 100.0 else f"{usual:.0f}"
    seen = f"moving vehicles drive {speed} m/s (usual: 2 to 40) with frames {step:.3g} s apart"
    if fast < low:
        cause = "milliseconds" if usual < 0.1 else "frame numbers"
        return f"{seen}; probably {cause} for seconds: check time_s and [traffic] time_step_s"
    if ways.share_astray(ways.heading_rad) > _MOST_ASTRAY:
        return f"{seen}, in no direction; probably vehicles are numbered anew in each frame: check vehicle_id"
    apart = "probably frames are further apart (check time_s and [traffic] time_step_s)"
    units = [unit for unit, factor in _UNITS.items() if _USUAL_M_S[0] <= usual * factor <= _USUAL_M_S[1]]
    of_table = bool(units) and format_of(recording.source) == "table"
    return f"{seen}; {apart}" + (f", or x_m and y_m are in {' or '.join(units)}" if of_table else "")


def _headings(recording: Recording, sample: Recording, ways: Ways, scenario: Scenario) -> str | None:
    """Headings off the motion: radians, a compass's bearings, mirrored, reversed, or of another axis."""

    def fits(heading: np.ndarray) -> bool:
        return ways.share_astray(heading) < 1 - _FITTING and abs(ways.mean_astray(heading)) <= _MEAN_ASTRAY_RAD

    if len(ways.seconds) < _FEWEST:
        return None
    share, mean = ways.share_astray(ways.heading_rad), abs(ways.mean_astray(ways.heading_rad))
    if share <= _MOST_ASTRAY and mean <= _MEAN_ASTRAY_RAD:
        return None
    settings = scenario.traffic
    placing = Placing(settings.origin_m or (0.0, 0.0), settings.heading_deg or 0.0)
    in_file = _within_half_a_turn(ways.heading_rad + math.radians(placing.heading_deg))
    meant = {
        "reversed, by half a turn": in_file + math.pi,
        "clockwise from north, as a compass has them (counter-clockwise from +x is 90 less the bearing), or x and y "
        "are swapped": 0.5 * math.pi - in_file,
        "clockwise, or y mirrored": -in_file,
        "a quarter turn off": in_file + 0.5 * math.pi,
        "a quarter turn off, clockwise": in_file - 0.5 * math.pi,
    }
    degrees = np.degrees(in_file)
    if (np.abs(degrees) <= 2 * math.pi + 0.02).all():
        meant = {"radians for degrees": degrees, **meant}  # the number was the angle in radians
    guess = next((name for name, heading in meant.items() if fits(placing.headings(heading))), None)
    turned = np.where(np.abs(ways.astray(ways.heading_rad)) > 0.5 * math.pi, math.pi, 0.0)
    if guess is None and fits(ways.heading_rad + turned):
        guess = "one direction's headings for the vehicles of both, or several vehicles under one vehicle_id"
    guess = guess or "of another axis than x_m and y_m, or vehicles are numbered anew in each frame"
    return (
        f"moving vehicles head {math.degrees(mean):.0f} degrees off their motion in the mean (usual: under 2), "
        f"{100 * share:.0f} % of them more than 30 (usual: none); probably {guess}"
    )


_FEWEST_ON_ROAD = 0.02  # share; at an intersection, or with both directions in one recording, many drive elsewhere
_FEW_ON_ROAD = 0.4  # are no cause to stop, but told
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
    near = near[np.unique(np.linspace(0, len(near) - 1, min(len(near), _ROWS)).astype(int))]
    part = recording.where(np.bincount(near, minlength=len(recording)) > 0)
    return part, region.holds(part)


def _carriageway(recording: Recording, sample: Recording, ways: Ways, scenario: Scenario) -> str | None:
    """Vehicles that drive obliquely to the road, or next to none of the region on its carriageway."""
    about, inside = _about_region(recording, scenario)
    known = len(ways.seconds) >= _FEWEST and not recording.report.periods
    known = known and _headings(recording, sample, ways, scenario) is None
    oblique = _oblique(about.heading_rad[inside]) if known else None
    if oblique is not None:
        turn = _within_half_a_turn(oblique + math.radians(scenario.traffic.heading_deg or 0.0))
        at, meant = (round(math.degrees(angle), 1) + 0.0 for angle in (oblique, turn))
        return (
            f"vehicles in the region drive at {at:g} degrees to the road's x axis (usual: along it); probably "
            f"[traffic] heading_deg = {meant:g}, the direction of travel in the file"
        )
    low, high = scenario.road.carriageway_y
    y = about.centre_m[inside | bool(scenario.region.stretches), 1]  # beside a stretch too
    if len(y) < _FEWEST:
        return None
    none_there = _on_road(y, scenario) < _FEWEST_ON_ROAD
    none_there &= not scenario.region.stretches or inside.sum() < _FEWEST  # where others may drive beside it
    if not (none_there or _lies_half_beside(y, low, high)):
        return None
    return (
        f"{100 * _on_road(y, scenario):.0f} % of the boxes {'about' if scenario.region.stretches else 'in'} the region "
        f"lie on the carriageway of [road], y {low:g} to {high:g} m, but at {_span('y', y)}; "
        f"{_place_meant(y, recording, scenario)}"
    )


def _lies_half_beside(y: np.ndarray, low: float, high: float) -> bool:
    """Whether a carriageway holds few of the boxes while one as wide that overlaps it holds all: another one does not.

    `y` (n,) is where boxes lie across the road [m], `low` and `high` are the carriageway's edges [m].
    """
    found = np.sort(y)
    held = np.searchsorted(found, found + (high - low), side="right") - np.arange(len(y))
    best = found[held.argmax()]
    few = ((y >= low) & (y <= high)).mean() < _FEW_ON_ROAD
    return bool(few and held.max() > _ALL_ON_ROAD * len(y) and abs(best - low) < high - low)


def _oblique(heading_rad: np.ndarray) -> float | None:
    """The direction that most headings (n,) share [rad], where next to none of them lie along x; else None."""
    if len(heading_rad) < _FEWEST:
        return None

    def alike(axis: float) -> np.ndarray:
        return np.abs(np.sin(heading_rad - axis)) <= math.sin(_ALONG_RAD)  # both directions

    axis = max(np.radians(np.arange(180.0)), key=lambda axis: alike(axis).sum())
    if alike(0.0).mean() >= _FEWEST_ON_ROAD or alike(axis).mean() < _MANY_ALIKE:
        return None
    ahead = alike(axis) & (np.cos(heading_rad - axis) > 0.0)
    most = ahead if 2 * ahead.sum() >= alike(axis).sum() else alike(axis) & ~ahead
    return float(np.angle(np.exp(1j * heading_rad[most]).mean()))


def _place_meant(y: np.ndarray, recording: Recording, scenario: Scenario) -> str:
    """What would put vehicles onto the carriageway, in words."""
    road, ngsim = scenario.road, bool(recording.report.periods)
    if ngsim and _on_road(y + (FOOT_M - 1.0) * road.right_edge_m, scenario) > _FITTING:
        return f"probably [road] right_edge_m = {road.right_edge_m:g} is in feet: {FOOT_M * road.right_edge_m:.4g} m"
    if ngsim:
        local_x = road.setback_m + road.right_edge_m - y
        return f"check [road] right_edge_m: vehicles drive at {_span('Local_X', local_x)}"
    if _on_road(-y, scenario) > _FITTING:
        return "probably the other side: turn [traffic] heading_deg by 180 degrees, or y is mirrored"
    if _on_road(FOOT_M * y, scenario) > _FITTING:
        return "probably feet for metres"
    return "check [traffic] origin_m and heading_deg, and [road] setback_m, lanes and lane_width_m"


_FEW_BESIDE = 0.05  # share within a lane of the carriageway that is not told
_FEW_AGAINST = 0.05  # share of the boxes on the carriageway that is not told


def _place_notes(recording: Recording, scenario: Scenario) -> Iterator[str]:
    about, inside = _about_region(recording, scenario)
    y, heading = about.centre_m[inside, 1], about.heading_rad[inside]
    low, high = scenario.road.carriageway_y
    road = f"the carriageway of [road], y {low:g} to {high:g} m"
    if not scenario.region.stretches and len(y) and _FEWEST_ON_ROAD <= _on_road(y, scenario) < _FEW_ON_ROAD:
        share = f"{100 * _on_road(y, scenario):.0f} % of the boxes in the region"
        yield f"{share} lie on {road}; check [traffic] and [road]"
    y_about, along = about.centre_m[:, 1], np.abs(np.sin(about.heading_rad)) < math.sin(_ASTRAY_RAD)
    lane = scenario.road.lane_width_m
    next_to = along & ~inside & (y_about > low - lane) & (y_about < high + lane) & ((y_about < low) | (y_about > high))
    beside = next_to.sum() / max(len(y) + next_to.sum(), 1)
    if scenario.region.stretches and len(y) and beside > _FEW_BESIDE:
        share = f"{100 * beside:.0f} % of the boxes on it and within a lane beside it"
        yield f"{share} lie beside {road}, and do not count; check [road] setback_m and lanes, and [traffic] origin_m"
    against = np.cos(heading[(y >= low) & (y <= high)]) < -math.cos(_ASTRAY_RAD)
    if len(against) >= _FEWEST and against.mean() > _FEW_AGAINST:
        yield (
            f"{100 * against.mean():.0f} % of the region's boxes on {road}, drive against +x and count as the others "
            "do; if they belong to another carriageway, check [road] setback_m and lanes, or give [region] keep_out"
        )


_MOST_OVERLAPS = 0.2  # pairs for each box


def _overlaps(recording: Recording, sample: Recording, ways: Ways, scenario: Scenario) -> str | None:
    """Boxes that stand in one another."""
    report = recording.report
    boxes = report.overlap_frames * len(recording) / len(recording.frames)
    if boxes < _FEWEST or report.overlaps <= _MOST_OVERLAPS * boxes:
        return None
    if any("no vehicle_types" in note for note in report.notes):
        meant = "vehicles are smaller than SUMO's defaults: give their [traffic] vehicle_types"
    elif np.ptp(recording.centre_m[:, :2], axis=0).max() < 1.0:
        meant = "x_m and y_m are degrees of longitude and latitude: give metres"
    else:
        meant = "vehicles are there twice under other ids, or x_m and y_m are not the boxes' centres"
    seen = f"{report.overlaps:,} pairs of boxes overlap among {boxes:,.0f}"
    return f"{seen} (usual: none, or a few in a hundred); probably {meant}"


_Check = Callable[[Recording, Recording, Ways, Scenario], str | None]
_CHECKS: Mapping[str, _Check] = {  # in the order of `names.WARNINGS`: causes before what comes of them
    "units": _units,
    "sizes": _sizes,
    "time-step": _time_step,
    "headings": _headings,
    "carriageway": _carriageway,
    "overlaps": _overlaps,
}


# --- Where vehicles are --------------------------------------------------------------------------------------------


def nobody_there(recording: Recording, region: Region, frames: int, scenario: Scenario) -> InputError:
    """The error for a region where nobody drives: where vehicles are, and the keys that move one to the other."""
    x, y = recording.centre_m[:, 0], recording.centre_m[:, 1]
    beside = np.abs(x - region.centre_xy[0]) <= region.radius_m
    if beside.any() and _on_road(y[beside], scenario) < _FEWEST_ON_ROAD:
        meant = _place_meant(y[beside], recording, scenario)
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
