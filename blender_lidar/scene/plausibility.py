"""Plausibility of a recording: wrong units, columns and places, which would end in a wrong answer, stop a run.

Each check has a name of `names.WARNINGS`; its limits and their reasons stand in `usual`. What `[traffic] accept` or
``--accept`` names does not stop a run, but stands in all of its results. Suspicious things that may be right are notes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cached_property

import numpy as np

from ..errors import InputError
from ..road.road_map import Surface
from ..traffic.vehicles import CLASSES, Recording
from . import usual
from .motion_checks import Tracks, bend, coupled, drift, headings, jumps, time_step, track_notes
from .place_checks import Placed, carriageway, grade, known_grades, overlaps, place_notes
from .scenario import Scenario


class _Seen:
    """The vehicles of a recording in the road frame, and what several checks look at, made once.

    Sizes are looked at of `everyone`, who walks too.
    """

    def __init__(self, recording: Recording, everyone: Recording, scenario: Scenario) -> None:
        self.recording, self.scenario = recording, scenario
        self.warnings: dict[str, str] = {}
        rows = np.unique(np.linspace(0, len(everyone) - 1, min(len(everyone), usual.SAMPLE)).astype(int))
        self.sample = everyone.where(np.bincount(rows, minlength=len(everyone)) > 0)
        self.tracks = Tracks(recording)

    @cached_property
    def placed(self) -> Placed:
        return Placed.of(self.recording, self.scenario)

    @property
    def heading_known(self) -> bool:
        return "headings" not in self.warnings and len(self.tracks.ways.seconds) >= usual.FEWEST

    @property
    def lies_along_x(self) -> bool:
        """Whether lanes should lie along x, and headings say how vehicles drive: on a map they lie as they do."""
        return self.heading_known and self.scenario.straight is not None


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
    vehicles = recording.vehicles_alone
    seen = _Seen(vehicles, recording, scenario)
    for name, check in _CHECKS.items():
        if name in ("tracks", "overlaps") and seen.warnings:
            continue  # they follow from a warning that is there already
        text = check(seen)
        if text and name not in (scenario.traffic.accept or ()):
            raise InputError(
                f"{recording.source}: {text}; if traffic and scene are right as they are, go on with --accept {name}"
            )
        if text:
            seen.warnings[name] = text
    notes = [*recording.report.notes, *_size_notes(seen), *track_notes(vehicles, seen.tracks), *coupled(vehicles)]
    notes += place_notes(vehicles, scenario, seen.placed, "carriageway" in seen.warnings)
    report = replace(recording.report, warnings=tuple(seen.warnings.items()), notes=tuple(notes))
    return replace(recording, report=report)


def _on_plane(recording: Recording, scenario: Scenario) -> Recording:
    """The boxes on the road's plane, where the heights that a table has are those of its grade."""
    known, road = known_grades(recording, scenario), scenario.road
    raised = np.ptp(recording.centre_m[:, 2] - 0.5 * recording.size_m[:, 2]) > 0.0
    if known is None or not raised or grade(known, road.grade_percent):
        return recording
    if road.is_level and max(map(abs, known)) < usual.LEVEL_PERCENT:  # `_sizes` says what such heights may be
        return recording
    centre = recording.centre_m.copy()
    centre[:, 2] = 0.5 * recording.size_m[:, 2]
    return recording.with_columns(centre_m=centre)


# --- Checks of sizes: what each has seen, and what is probably meant; nothing where all may be true ---------------


def _fits(size_m: np.ndarray, class_index: np.ndarray) -> np.ndarray:
    """Whether sizes (n, 3) [m] are possible for their classes, (n,) bool."""
    limits = np.array([usual.SIZES_M[name] for name in CLASSES])[class_index]
    return ((size_m >= limits[..., 0]) & (size_m <= limits[..., 1])).all(axis=1)


def _sizes(seen: _Seen) -> str | None:
    """Sizes that most of a class cannot have: another unit, or columns swapped; heights that are one for all."""
    sample = seen.sample
    for index in np.argsort(-np.bincount(sample.class_index)):
        size, name = sample.size_m[sample.class_index == index], CLASSES[index]
        fitting = _fits(size, index)
        if len(size) < usual.FEWEST or fitting.mean() >= usual.HALF:
            continue
        units = [unit for unit, factor in usual.UNITS.items() if _fits(size * factor, index).mean() > usual.MOST]
        probably = f"{units[0]} for metres" if units else "another unit, swapped columns or another class"
        if seen.recording.report.periods:  # whose sizes have been repaired, to the least where they were metres
            probably = "v_Length and v_Width in metres, where NGSIM's columns are all in feet, or swapped"
        return (
            f"{100 * (1.0 - fitting.mean()):.0f} % of the boxes of class {name} have impossible sizes: a median {name} "
            f"is {_by(np.median(size, axis=0))} m (usual: {_by(usual.SIZES_M[name])} m); probably {probably}"
        )
    return _heights_alike(sample) or _heights_of_middles(sample, seen.scenario.road_map.surface)


def _by(sizes) -> str:
    """A length, width and height in words, or from where to where each goes."""
    return " by ".join(f"{one:.3g}" if np.isscalar(one) else "{:g} to {:g}".format(*one) for one in sizes)


def _heights_alike(sample: Recording) -> str | None:
    """Trucks and buses as large as cars, or long and no higher: one size or height for all, as none was known."""
    large = np.isin(sample.class_index, [CLASSES.index("truck"), CLASSES.index("bus")])
    cars = sample.size_m[sample.class_index == CLASSES.index("car")]
    other = sample.size_m[large]
    if min(len(cars), len(other)) < usual.FEWEST:
        return None
    car, other = np.median(cars, axis=0), np.median(other, axis=0)
    alike = (np.abs(other - car) <= usual.ALIKE_M).all()
    if alike or (other[0] > usual.LONG_M and other[2] <= car[2] + usual.HIGHER_M):
        return (
            f"the median truck or bus, {_by(other)} m, is as high as the median car, {_by(car)} m (usual: 3 to 4 m and "
            "1.5 m); probably all vehicles were given one size or height: give height_m by class"
        )
    return None


def _heights_of_middles(sample: Recording, surface: Surface) -> str | None:
    """Boxes that stand above the road or in it: z_m that is not of their middles, on z = 0 or on a map's heights."""
    z, half = sample.centre_m[:, 2], 0.5 * sample.size_m[:, 2]
    on_surface = z - surface.height(sample.centre_m)
    z = on_surface if np.abs(on_surface - half).mean() < np.abs(z - half).mean() else z
    if len(z) < usual.FEWEST or (np.abs(z - half) <= usual.OFF_MIDDLE_M).mean() >= usual.HALF:
        return None
    return (
        f"the box centres lie {np.median(z):.3g} m above the road (usual: half their heights, "
        f"{np.median(half):.2g} m); probably z_m is the height of floors or tops, or above sea level: leave the column "
        "out, and the boxes stand on the road"
    )


def _size_notes(seen: _Seen) -> Iterator[str]:
    """Sizes that are impossible for some boxes, or were made up in reading for most vehicles."""
    sample, recording = seen.sample, seen.recording
    odd = ~_fits(sample.size_m, sample.class_index)
    if len(sample) >= usual.FEWEST and odd.mean() > usual.SOME and "sizes" not in seen.warnings:
        name = CLASSES[sample.class_index[odd][0]]
        size = _by(sample.size_m[odd][0])
        yield f"{100 * odd.mean():.0f} % of the boxes have impossible sizes for their class, as a {name} of {size} m"
    repaired, vehicles = recording.report.sizes_repaired, len(np.unique(recording.vehicle_id))
    if repaired > max(usual.HALF * vehicles, 1):
        yield (
            f"{repaired:,} of {vehicles:,} vehicles have a size that is missing or absurd for their class, and were "
            "given a usual one; check v_Length and v_Width, in feet, and v_Class (2 cars, 3 trucks)"
        )


_CHECKS: dict[str, Callable[[_Seen], str | None]] = {  # as `names.WARNINGS`: causes before what comes of them
    "grade": lambda seen: grade(known_grades(seen.recording, seen.scenario), seen.scenario.road.grade_percent),
    "sizes": _sizes,
    "time-step": lambda seen: time_step(seen.tracks),
    "tracks": lambda seen: jumps(seen.recording, seen.tracks),
    "headings": lambda seen: headings(seen.tracks, seen.scenario),
    "drift": lambda seen: drift(seen.tracks, seen.placed.region) if seen.lies_along_x else None,
    "bend": lambda seen: bend(seen.tracks, seen.placed.region) if seen.lies_along_x else None,
    "carriageway": lambda seen: carriageway(seen.recording, seen.scenario, seen.placed, seen.heading_known),
    "overlaps": lambda seen: overlaps(seen.recording),
}
