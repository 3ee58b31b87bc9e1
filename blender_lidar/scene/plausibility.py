"""Plausibility of a recording: wrong units, columns and places, which would end in a wrong answer, stop a run.

`CHECKS` declares what is looked at, the limit with its reason, what is said and what to do. A check with a name of
`names.WARNINGS` stops a run, unless `[traffic] accept` or ``--accept`` names it: then it stands in all results. The
others are notes: suspicious things that may be right. Limits lie beyond what real recordings (NGSIM) and generated
ones (SUMO) have, which the tests read.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from ..errors import InputError
from ..traffic.lanes import LANE_WIDTHS_M
from ..traffic.ngsim import FOOT_M
from ..traffic.vehicles import CLASSES, Recording
from . import motion_checks as motion
from . import place_checks as place
from . import usual
from .scenario import Scenario

Found = Mapping[str, Any] | None
"""What a sentence tells, by the names in its braces; None where all may be true."""


class Check(NamedTuple):
    """One look at a recording.

    Attributes
    ----------
    name : str
        Of `names.WARNINGS`; empty for a note.
    measure : callable
        From what is seen and the limit what the sentences tell.
    limit : number, tuple or mapping
        Beyond which they are said.
    reason : str
        Why there.
    seen, advice : str
        The sentences, with names in braces.
    """

    name: str
    measure: Callable[[LookedAt, Any], Found]
    limit: Any
    reason: str
    seen: str
    advice: str = ""

    def said(self, recording: LookedAt) -> str | None:
        """What is said of a recording."""
        found = self.measure(recording, self.limit)
        parts = [part for part in (self.seen, self.advice) if part]
        return None if found is None else ("; " if self.name else ": ").join(parts).format(**found)


class LookedAt:
    """The vehicles of a recording in the road frame, and what several checks look at, made once.

    Sizes are looked at of `everyone`, who walks too.
    """

    def __init__(self, recording: Recording, everyone: Recording, scenario: Scenario) -> None:
        self.recording, self.scenario, self.report = recording, scenario, recording.report
        self.warnings: dict[str, str] = {}
        rows = np.unique(np.linspace(0, len(everyone) - 1, min(len(everyone), usual.SAMPLE)).astype(int))
        self.sample = everyone.select(np.bincount(rows, minlength=len(everyone)) > 0)
        self.tracks = motion.Tracks(recording)

    @cached_property
    def placed(self) -> place.Placed:
        return place.Placed.of(self.recording, self.scenario)

    @property
    def heading_known(self) -> bool:
        return "headings" not in self.warnings and len(self.tracks.ways.seconds) >= usual.FEWEST

    @property
    def lies_along_x(self) -> bool:
        """Whether lanes should lie along x, and headings say how vehicles drive: on a map they lie as they do."""
        return self.heading_known and self.scenario.road_map.endless


def checked_recording(recording: Recording, scenario: Scenario) -> Recording:
    """The same recording; its report holds what cannot be true and is accepted.

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
    recording = _on_plane(recording, scenario)
    seen, notes = LookedAt(recording.vehicles_alone, recording, scenario), []
    for check in _checks_of(seen):
        if check.name in seen.warnings or (check.name in ("tracks", "overlaps") and seen.warnings):
            continue  # they follow from a warning that is there already
        text = check.said(seen)
        if text and check.name and check.name not in (scenario.recordings[0].accept or ()):
            go_on = f"if traffic and scene are right as they are, go on with --accept {check.name}"
            raise InputError(f"{recording.source}: {text}; {go_on}")
        if text and check.name:
            seen.warnings[check.name] = text
        elif text:
            notes.append(text)
    notes = (*recording.report.notes, *notes)
    return replace(recording, report=replace(recording.report, warnings=tuple(seen.warnings.items()), notes=notes))


def _on_plane(recording: Recording, scenario: Scenario) -> Recording:
    """The boxes on the road's plane, where the heights that a table has are those of its grade."""
    known, road = place.known_grades(recording, scenario), scenario.road
    raised = np.ptp(recording.centre_m[:, 2] - 0.5 * recording.size_m[:, 2]) > 0.0
    if known is None or not raised or place.crest(known) or place.rise(known, road.grade_percent):
        return recording
    if road.is_level and max(map(abs, known)) < _LEVEL_PERCENT:  # `_heights_of_middles` says what they may be
        return recording
    centre = recording.centre_m.copy()
    centre[:, 2] = 0.5 * recording.size_m[:, 2]
    return replace(recording, centre_m=centre)


_LEVEL_PERCENT = 0.2  # less than what a fit to vehicles of other heights gives by itself

# --- Sizes --------------------------------------------------------------------------------------------------------

_SIZES_M = {
    "car": ((2.6, 8.0), (1.1, 2.8), (0.9, 2.8)),
    "van": ((2.5, 20.0), (1.1, 3.0), (1.0, 4.5)),
    "truck": ((3.0, 40.0), (1.3, 3.1), (1.2, 5.0)),
    "bus": ((5.0, 60.0), (1.5, 3.1), (1.8, 5.0)),
    "motorcycle": ((0.8, 4.0), (0.25, 2.0), (0.6, 2.6)),
    "bicycle": ((0.8, 4.0), (0.25, 2.0), (0.6, 2.6)),
    "pedestrian": ((0.1, 2.0), (0.1, 2.0), (0.6, 2.6)),
}  # least and largest length, width and height
_UNITS = {"feet": FOOT_M, "centimetres": 0.01, "millimetres": 0.001}  # what sizes may be in for metres


def _fits(size_m: np.ndarray, class_index: np.ndarray, limits: Mapping) -> np.ndarray:
    """Whether sizes (n, 3) [m] are possible for their classes, (n,) bool."""
    limits = np.array([limits[name] for name in CLASSES])[class_index]
    return ((size_m >= limits[..., 0]) & (size_m <= limits[..., 1])).all(axis=1)


def _impossible_sizes(seen: LookedAt, limits: Mapping) -> Found:
    """Sizes that most of a class cannot have."""
    sample = seen.sample
    for index in np.argsort(-np.bincount(sample.class_index)):
        size, name = sample.size_m[sample.class_index == index], CLASSES[index]
        fitting = _fits(size, index, limits)
        if len(size) < usual.FEWEST or fitting.mean() >= usual.HALF:
            continue
        units = [unit for unit, factor in _UNITS.items() if _fits(size * factor, index, limits).mean() > usual.MOST]
        probably = f"{units[0]} for metres" if units else "another unit, swapped columns or another class"
        if seen.report.periods:  # whose sizes have been repaired, to the least where they were metres
            probably = "v_Length and v_Width in metres, where NGSIM's columns are all in feet, or swapped"
        share, median = 100 * (1.0 - fitting.mean()), _by(np.median(size, axis=0))
        return {"share": share, "name": name, "size": median, "usual": _by(limits[name]), "probably": probably}
    return None


def _by(sizes) -> str:
    """A length, width and height in words, or from where to where each goes."""
    return " by ".join(f"{one:.3g}" if np.isscalar(one) else "{:g} to {:g}".format(*one) for one in sizes)


def _heights_alike(seen: LookedAt, limit: tuple[float, float, float]) -> Found:
    """Trucks and buses as large as cars, or long and no higher: one size or height for all, as none was known."""
    alike_m, long_m, higher_m = limit
    kind, size = seen.sample.class_index, seen.sample.size_m
    cars, other = (
        size[kind == CLASSES.index("car")],
        size[np.isin(kind, [CLASSES.index("truck"), CLASSES.index("bus")])],
    )
    if min(len(cars), len(other)) < usual.FEWEST:
        return None
    car, other = np.median(cars, axis=0), np.median(other, axis=0)
    alike = (np.abs(other - car) <= alike_m).all() or (other[0] > long_m and other[2] <= car[2] + higher_m)
    return {"other": _by(other), "car": _by(car)} if alike else None


def _heights_of_middles(seen: LookedAt, off_m: float) -> Found:
    """Boxes that stand above the road or in it: z_m that is not of their middles, on z = 0 or on a map's heights."""
    sample = seen.sample
    z, half = sample.centre_m[:, 2], 0.5 * sample.size_m[:, 2]
    on_surface = z - seen.scenario.road_map.surface.height(sample.centre_m)
    z = on_surface if np.abs(on_surface - half).mean() < np.abs(z - half).mean() else z
    if len(z) < usual.FEWEST or (np.abs(z - half) <= off_m).mean() >= usual.HALF:
        return None
    return {"z": np.median(z), "half": np.median(half)}


def _odd_sizes(seen: LookedAt, some: float) -> Found:
    """Sizes that are impossible for some boxes."""
    sample = seen.sample
    odd = ~_fits(sample.size_m, sample.class_index, _SIZES_M)
    if len(sample) < usual.FEWEST or odd.mean() <= some or "sizes" in seen.warnings:
        return None
    return {"share": 100 * odd.mean(), "name": CLASSES[sample.class_index[odd][0]], "size": _by(sample.size_m[odd][0])}


def _made_up_sizes(seen: LookedAt, half: float) -> Found:
    """Sizes that were made up in reading for most vehicles."""
    repaired, vehicles = seen.report.sizes_repaired, len(np.unique(seen.recording.vehicle_id))
    return {"repaired": repaired, "vehicles": vehicles} if repaired > max(half * vehicles, 1) else None


def _crest(seen: LookedAt, limit: float) -> Found:
    return place.crest(place.known_grades(seen.recording, seen.scenario), limit)


def _rise(seen: LookedAt, limit: float) -> Found:
    return place.rise(place.known_grades(seen.recording, seen.scenario), seen.scenario.road.grade_percent, limit)


# --- The list: causes before what comes of them, the names as in `names.WARNINGS`; then notes ---------------------

# fmt: off
WARNING_CHECKS = (
    Check("grade", _crest, 2.0 * place.GRADE_PERCENT, "a metre in a hundred from either side",
        "the file's heights make a {what} at the region, from {before:+.1f} to {beyond:+.1f} % along x, and a road "
        "here is one plane",
        "choose another place, or a shorter [region]"),
    Check("grade", _rise, place.GRADE_PERCENT,
        "a metre in a hundred: maps are that good, and it moves a beam's end by a car's height at 150 m",
        "the file's heights rise by {measured:+.1f} % along x, and [road] grade_percent says {said:g}",
        "probably it should be {measured:.1f}"),
    Check("sizes", _impossible_sizes, _SIZES_M, "from children to road trains, with room for measurement",
        "{share:.0f} % of the boxes of class {name} have impossible sizes: a median {name} is {size} m (usual: "
        "{usual} m)",
        "probably {probably}"),
    Check("sizes", _heights_alike, (0.05, 7.0, 0.2),
        "sizes that differ by less than 0.05 m are one number; trucks and buses over 7 m are 0.2 m higher than cars",
        "the median truck or bus, {other} m, is as high as the median car, {car} m (usual: 3 to 4 m and 1.5 m)",
        "probably all vehicles were given one size or height: give height_m by class"),
    Check("sizes", _heights_of_middles, 0.5,
        "metres of a box above its half height: more than kerbs, lorries' axles and survey errors",
        "the box centres lie {z:.3g} m above the road (usual: half their heights, {half:.2g} m)",
        "probably z_m is the height of floors or tops, or above sea level: leave the column out, and the boxes stand "
        "on the road"),
    Check("time-step", motion.speeds, (44.0, 1.5, 60.0),
        "160 km/h for the median; nine of ten that move slower than 1.5 m/s for over a minute are no traffic",
        "moving vehicles drive {median:.3g} m/s (usual: 2 to 40) with frames {step_s:.3g} s apart",
        "probably time_s is not in seconds, [traffic] time_step_s is another, places are not in metres, or {cause}"),
    Check("tracks", motion.in_two_places, usual.SOME, "of the rows",
        "{repeated:,} of {rows_read:,} rows are of a vehicle that is elsewhere in the same frame (usual: none)",
        "probably several vehicles share a vehicle_id"),
    Check("tracks", motion.jump_together, (1.5, 5.0, 2.0),
        "under half a lane aside; 5 m ahead in 1 s, twice what brakes do; rows at most 2 s apart",
        "all vehicles jump together by {metres:.1f} m from frame {first} to {later}",
        "probably the camera or the file's origin has moved (make two recordings, each with its origin_m), or places "
        "are rounded coarsely"),
    Check("tracks", motion.jumps, (70.0, 3.0),
        "250 km/h; who jumps back within 3 s was no vehicle that left and came again",
        "{jumping:,} of {vehicles:,} vehicles jump by {metres:g} m or more, faster than any vehicle drives or there "
        "and back (usual: none)",
        "probably several vehicles share a vehicle_id, or frames are out of order"),
    Check("headings", motion.headings, (usual.MANY, math.radians(3.0)),
        "a fifth over 30 degrees off; 3 degrees place by place: real and generated ones are up to 1.5",
        "headings of moving vehicles are {degrees:.0f} degrees off their motion (usual: under 2), {share:.0f} % of "
        "them more than 30 (usual: none)",
        "probably {probably}"),
    Check("headings", motion.standing_headings, 0.5, "m/s of what stands; no vehicle turns on the spot",
        "{share:.0f} % of the standing boxes point more than 30 degrees off the way they came or go (usual: none; no "
        "vehicle turns on the spot)",
        "probably headings are computed from the motion, and are noise or 0 where there is none: keep the last "
        "heading"),
    Check("drift", motion.drift, (1.0, 4.0),
        "lanes are marked, and places in them vary by less than 1 m together; 4 standard errors: none of 24 "
        "recordings without drift has as many",
        "all lanes move to the {side} of x by {cm_s:.1f} cm/s",
        "a camera that drifts? Take the drift out of x and y"),
    Check("bend", motion.bend, 2.0, "metres of sagitta: more than half a lane, and vehicles are in the lane beside",
        "the road bends by {degrees:.0f} deg within the region, {aside:.1f} m off a straight line, and a scene's "
        "lanes are straight",
        "choose a shorter [region]"),
    Check("carriageway", place.off_map, usual.HALF, "most drive on roads",
        "{share:.0f} % of the boxes lie on the map's roads; the middle of the traffic is {away:.0f} m from that of "
        "the region, by x {x:.0f}, y {y:.0f} m",
        "check [traffic] origin_m and heading_deg, which place the recording, and [road] origin_m, which places the "
        "map (of traffic in UTM and a SUMO net they differ by its netOffset)"),
    Check("carriageway", place.oblique, usual.FEW, "of the boxes along the road: measurement errors",
        "vehicles in the region drive at {at:g} degrees to the road's x axis (usual: along it)",
        "probably [traffic] heading_deg = {meant:g}, the direction of travel in the file"),
    Check("carriageway", place.beside, (usual.FEW, usual.MINORITY),
        "of the boxes on the carriageway: measurement errors; under a half, where all lie on one as wide beside it",
        "{share:.0f} % of the boxes {where} the region lie on {road}, but at {span}",
        "{meant}"),
    Check("overlaps", place.twice, usual.FEW, "of the boxes",
        "{twice:,} of {boxes:,.0f} boxes stand where another one stands",
        "probably vehicles are listed twice"),
    Check("overlaps", place.overlaps, (usual.SOME, place.OVERLAPPING),
        "pairs a box: NGSIM's are under 0.1 %; unrelated labels reach 0.1, a fifth of the vehicles there twice make "
        "0.16",
        "{pairs:,} pairs among {boxes:,.0f} boxes overlap (usual: none, or a few in a hundred)",
        "probably vehicles are listed twice under different ids, sizes are too large (SUMO: give vehicle_types), x "
        "and y are bumpers and not box centres, or they are in feet or in degrees of longitude and latitude and not "
        "in metres"),
)
NOTE_CHECKS = (
    Check("", _odd_sizes, usual.SOME, "of the boxes",
        "{share:.0f} % of the boxes have impossible sizes for their class, as a {name} of {size} m"),
    Check("", _made_up_sizes, usual.HALF, "of the vehicles",
        "{repaired:,} of {vehicles:,} vehicles have a size that is missing or absurd for their class, and were given "
        "a usual one",
        "check v_Length and v_Width, in feet, and v_Class (2 cars, 3 trucks)"),
    Check("", motion.unrelated_frames, usual.SOME, "of the vehicles are in a second frame",
        "almost no vehicle is in more than one frame",
        "the frames are unrelated, or vehicles have new numbers in each frame, and then the check on held-out traffic"
        " is not independent"),
    Check("", motion.coupled, 0.5, "metres off each other end to end as they drive, as no two drivers stay",
        "{pairs} of boxes touch from end to end as they drive",
        "tractors and trailers as two boxes each? They count as two vehicles; give one box to each"),
)
TRACK_NOTES = (
    Check("", motion.copied_minutes, usual.MANY, "of the frames",
        "{share:.0f} % of the frames come again to the centimetre {later_s:g} s later, under other vehicle numbers",
        "if the recording holds the same minutes twice, held-out frames are copies of searched ones"),
    Check("", motion.standing, 1.0 - usual.SOME, "of the vehicles",
        "almost no vehicle moves in {seconds:.0f} s",
        "a jam, or a car park?"),
    Check("", motion.turning, 3.0, "degrees from row to row in the median: real and generated recordings are under 1",
        "headings change by {degrees:.0f} degrees from row to row (usual: under 1)",
        "are they noise?"),
    Check("", motion.varying_lengths, 0.05, "of itself, along one track: trackers that fit a box in each frame",
        "lengths of one vehicle vary by {share:.0f} % (usual: none)",
        "give it one size in all frames, or each its own vehicle_id"),
    Check("", motion.missing_rows, usual.MANY, "of the frames",
        "vehicles are missing in {share:.0f} % of the frames between their first and their last, and hide nothing "
        "there"),
    Check("", motion.again_from_behind, usual.SOME, "of the vehicles",
        "{share:.0f} % of the vehicles jump back and drive past again",
        "if ids are reused, the later vehicles are left out of the check on held-out traffic"),
)
STRAIGHT_ROAD_NOTES = (
    Check("", place.few_on_it, usual.MINORITY, "of the boxes: under a half",
        "{share:.2g} % of the boxes in the region lie on {road}; they drive at {span}",
        "check [traffic] and [road]"),
    Check("", place.lane_width, LANE_WIDTHS_M, "lanes that are built",
        "[road] lane_width_m is {width:g} m (usual: {low:g} to {high:g})"),
    Check("", place.next_to_it, usual.SOME, "of the vehicles",
        "{share:.0f} % of the vehicles drive within one lane beside {road}, and do not count",
        "check [road] setback_m and lanes, and [traffic] origin_m"),
    Check("", place.against, usual.SOME, "of the boxes",
        "{share:.0f} % of the region's boxes on {road}, drive against the direction of their lane, and they count",
        "if they belong to another carriageway, check [road] setback_m and lanes, or give [region] keep_out"),
    Check("", place.slightly_oblique, place.DRIFT_RAD[0], "1.5 degrees cross half a lane in 60 m",
        "vehicles on the carriageway drive at {at:g} degrees to the road's x axis, {across:.1f} m across it in "
        "{length:.0f} m",
        "check [traffic] heading_deg (such as {meant:g}), if the road does not bend there"),
    Check("", place.lane_spacing, place.WIDER,
        "of a lane's width: a map's scale is right to 2 %, feet or a projection are further off",
        "vehicles drive in {lanes} lanes {apart:.2f} m apart, but [road] lane_width_m is {width:g} m",
        "if that is right, check the unit and the scale of the file's x and y"),
    Check("", place.off_lanes, 1.0, "metres from a lane's middle: nobody drives so",
        "vehicles drive {off:.1f} m beside the lane centres of [road], at y {at} m",
        "check [road] setback_m and the place of the file's origin"),
    Check("", place.some_overlap, (usual.SOME, place.OVERLAPPING), "pairs a box; more are a warning",
        "{pairs:.0f} pairs among 100 boxes overlap (usual: none, or a few)"),
    Check("", place.mirrored, usual.MOST, "of the oncoming traffic",
        "oncoming vehicles drive to the {drives_on} of {road}, at {span}",
        'either this is {other}-hand traffic ([road] drives_on = "{other}"), where a pole on the {drives_on} stands '
        "between both directions and not at the roadside, or y is mirrored in the file"),
)
# fmt: on
CHECKS = (*WARNING_CHECKS, *NOTE_CHECKS, *TRACK_NOTES, *STRAIGHT_ROAD_NOTES)


def _checks_of(seen: LookedAt) -> Iterator[Check]:
    """The checks that a recording gives reason for, in order."""
    yield from WARNING_CHECKS
    yield from NOTE_CHECKS
    if motion.has_tracks(seen):
        yield from TRACK_NOTES
    if seen.scenario.road_map.endless:
        yield from STRAIGHT_ROAD_NOTES
