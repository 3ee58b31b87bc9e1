"""Plausibility of a recording: wrong units, columns and places, which would end in a wrong answer, stop a run.

Each check has a name of `names.WARNINGS` and looks at a sample. What `[traffic] accept` or ``--accept`` names does not
stop a run, but stands in all that it tells. Suspicious places that may be right are notes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from itertools import permutations

import numpy as np

from ..errors import InputError
from ..traffic.ngsim import FOOT_M
from ..traffic.vehicles import CLASSES, Recording
from .motion_checks import FEWEST, FITTING, ROWS, UNITS, Tracks, Ways, headings, time_step, track_notes, tracks
from .place_checks import carriageway, overlaps, place_notes
from .settings import Scenario


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
    rows = np.unique(np.linspace(0, len(recording) - 1, min(len(recording), ROWS)).astype(int))
    sample = recording.where(np.bincount(rows, minlength=len(recording)) > 0)
    ways = Ways(recording)
    accepted = scenario.traffic.accept or ()
    warnings = []
    for name, check in _CHECKS.items():
        if name in ("tracks", "overlaps") and warnings:
            continue  # they come of what is told already
        text = check(recording, sample, ways, scenario)
        if text and name not in accepted:
            raise InputError(f"{recording.source}: {text}; to go on all the same: --accept {name}")
        if text:
            warnings.append((name, text))
    notes = [*recording.report.notes, *_size_notes(recording, sample, ways.tracks), *track_notes(recording, ways)]
    notes += place_notes(recording, scenario, "carriageway" in dict(warnings))
    return replace(recording, report=replace(recording.report, warnings=tuple(warnings), notes=tuple(notes)))


# --- Checks of sizes: what each has seen, and what is probably meant; nothing where all may be true ---------------

_MOST_OVERLAPPING = 3.0  # pairs in the frames looked at for each box of a frame: 0.05 for each box of 60
_LANE_SPACING_M = (0.7, 1.9)  # of lanes of 2.4 to 5.8 m, once more multiplied by a foot


def _units(recording: Recording, sample: Recording, ways: Ways, scenario: Scenario) -> str | None:
    """NGSIM's feet that are metres: lanes lie a metre apart, and boxes overlap or all sizes had to be repaired."""
    report = recording.report
    if not report.periods or len(sample) < FEWEST:  # which no other format has
        return None
    lanes = np.unique(sample.lane[sample.lane > 0])
    y = {lane: np.median(sample.centre_m[sample.lane == lane, 1]) for lane in lanes}
    spacing = [abs(y[lane + 1] - y[lane]) for lane in lanes if lane + 1 in y]
    low, high = _LANE_SPACING_M
    narrow = bool(spacing) and low <= np.median(spacing) <= high
    repaired = report.sizes_repaired >= 0.5 * len(np.unique(recording.vehicle_id))
    if not narrow or not (repaired or report.overlaps > _MOST_OVERLAPPING * len(sample) / len(sample.frames)):
        return None
    seen = f"{report.sizes_repaired:,} vehicles have absurd sizes" if repaired else "boxes overlap"
    return (
        f"lanes lie {np.median(spacing):.1f} m apart (3 to 4 m is usual) and {seen}: NGSIM's columns are in feet, and "
        "these are probably metres; divide them by 0.3048"
    )


_SIZES_M = {  # least and largest length, width and height
    "car": ((2.6, 8.0), (1.1, 2.8), (0.9, 2.8)),
    "van": ((2.5, 20.0), (1.1, 3.0), (1.0, 4.5)),
    "truck": ((3.0, 40.0), (1.3, 3.1), (1.2, 5.0)),
    "bus": ((5.0, 60.0), (1.5, 3.1), (1.8, 5.0)),
    "motorcycle": ((0.8, 4.0), (0.25, 2.0), (0.6, 2.6)),
}
_FACTORS = {
    **{f"{unit} for metres": factor for unit, factor in UNITS.items()},
    "half lengths for metres": 2.0,
    "metres multiplied by 0.3048": 1.0 / FOOT_M,
    "a slipped decimal point, ten times too small": 10.0,
}
_MOST_ODD, _ALL_ODD = 0.5, 0.95  # shares of boxes: a class that is wrong for some is no wrong unit


def _sizes(recording: Recording, sample: Recording, ways: Ways, scenario: Scenario) -> str | None:
    """Sizes that no vehicle of the class has: another unit, or columns swapped."""
    limits = np.array([_SIZES_M[name] for name in CLASSES])[sample.class_index]

    def odd(size: np.ndarray) -> float:
        return 1.0 - ((size >= limits[..., 0]) & (size <= limits[..., 1])).all(axis=1).mean()

    share = odd(sample.size_m)
    if len(sample) < FEWEST:
        return None
    if share <= _MOST_ODD:
        return _heights_alike(sample) or _of_one_class(sample, limits) or _heights_of_middles(sample)
    usual = int(np.bincount(sample.class_index).argmax())
    size = " by ".join(f"{one:.3g}" for one in np.median(sample.size_m[sample.class_index == usual], axis=0))
    names = _sizes_meant(sample.size_m, lambda size: odd(size) < 1 - FITTING)
    if recording.report.periods:  # whose sizes have been repaired, to the least where they were metres
        names = ["v_Length and v_Width in metres, where NGSIM has feet, or swapped"]
    own = sample.class_index == usual
    if not names and share < _ALL_ODD and (told := _of_one_class(sample.where(own), limits[own])):
        return told
    low, high = zip(*_SIZES_M[CLASSES[usual]], strict=True)
    return (
        f"{100 * share:.0f} % of the boxes have impossible sizes for their class: a median {CLASSES[usual]} is {size} "
        f"m (usual: {low[0]:g} to {high[0]:g} by {low[1]:g} to {high[1]:g} by {low[2]:g} to {high[2]:g} m); "
        + (f"probably {' or '.join(names)}" if names else "check units and columns")
    )


def _sizes_meant(size_m: np.ndarray, fits: Callable[[np.ndarray], bool]) -> list[str]:
    """Units with which sizes (n, 3) fit, and the order of columns that swaps fewest, in words."""
    found = [meant for meant, factor in _FACTORS.items() if fits(size_m * factor)]
    names = ("length", "width", "height")
    for order in sorted(permutations(range(3)), key=lambda order: sum(one != at for at, one in enumerate(order))):
        if fits(size_m[:, order]):
            swapped = [
                f"{names[one]}_m holds the {name}" for one, name in zip(order, names, strict=True) if names[one] != name
            ]
            return [*found, f"columns swapped: {', '.join(swapped)}"]
    return found


_SOME_ODD, _MOST_VARYING = 0.05, 0.05  # shares: of boxes, of a vehicle's length


def _size_notes(recording: Recording, sample: Recording, tracks: Tracks) -> Iterator[str]:
    """Sizes that are impossible for some boxes, change on the way, or were made up in reading for most vehicles."""
    limits = np.array([_SIZES_M[name] for name in CLASSES])[sample.class_index]
    odd = ~((sample.size_m >= limits[..., 0]) & (sample.size_m <= limits[..., 1])).all(axis=1)
    if len(sample) >= FEWEST and _SOME_ODD < odd.mean() <= _MOST_ODD:
        size = " by ".join(f"{one:.3g}" for one in sample.size_m[odd][0])
        name = CLASSES[sample.class_index[odd][0]]
        yield f"{100 * odd.mean():.0f} % of the boxes have impossible sizes for their class, as a {name} of {size} m"
    of_row = np.cumsum(np.diff(tracks.vehicle, prepend=tracks.vehicle[:1]) != 0)
    rows = np.bincount(of_row)
    mean = np.bincount(of_row, tracks.length_m) / rows
    varying = np.sqrt(np.bincount(of_row, np.square(tracks.length_m - mean[of_row])) / rows) / mean
    if np.median(varying) > _MOST_VARYING:
        yield (
            f"lengths of one vehicle vary by {100 * np.median(varying):.0f} % (usual: none); give it one size in all "
            "frames, or each its own vehicle_id"
        )
    repaired, vehicles = recording.report.sizes_repaired, len(np.unique(recording.vehicle_id))
    if repaired > max(_MOST_ODD * vehicles, 1):
        yield (
            f"{repaired:,} of {vehicles:,} vehicles have a size that is missing or absurd for their class, and that of "
            "another was taken; check v_Length and v_Width, in feet, and v_Class (2 cars, 3 trucks)"
        )


_FAR_OFF = 1.5  # times beyond what is possible: no odd class, whatever the unit


def _of_one_class(sample: Recording, limits: np.ndarray) -> str | None:
    """A class whose sizes are another unit's or far from possible, where those of the others are right."""
    for index in np.unique(sample.class_index):
        own = sample.class_index == index
        low, high = limits[own, :, 0], limits[own, :, 1]

        def fitting(size: np.ndarray, low=low, high=high) -> float:
            return float(((size >= low) & (size <= high)).all(axis=1).mean())

        median = np.median(sample.size_m[own], axis=0)
        if own.sum() < FEWEST or fitting(sample.size_m[own]) >= 1.0 - FITTING:
            continue
        meant = _sizes_meant(sample.size_m[own], lambda size, fitting=fitting: fitting(size) > FITTING)
        if meant or ((median < low[0] / _FAR_OFF) | (median > high[0] * _FAR_OFF)).any():
            size = " by ".join(f"{one:.3g}" for one in median)
            probably = " or ".join(meant) or "another unit, or another class"
            return f"a median {CLASSES[index]} is {size} m, impossible for its class; probably {probably}"
    return None


_LONG_M = 7.0
_HIGHER_M, _ALIKE_M = 0.2, 0.05


def _heights_alike(sample: Recording) -> str | None:
    """Trucks and buses as large as cars, or long and no higher: one size or height for all, for want of any."""
    car = sample.class_index == CLASSES.index("car")
    large = np.isin(sample.class_index, [CLASSES.index("truck"), CLASSES.index("bus")])
    if min(car.sum(), large.sum()) >= FEWEST:
        usual, other = (np.median(sample.size_m[which], axis=0) for which in (car, large))
        if (np.abs(usual - other) <= _ALIKE_M).all():
            size = " by ".join(f"{one:.3g}" for one in other)
            return f"a median truck or bus is {size} m, as a median car is; probably one size was given for all"
    long = large & (sample.size_m[:, 0] > _LONG_M)
    if min(car.sum(), long.sum()) < FEWEST:
        return None
    usual, high = (np.median(sample.size_m[which, 2]) for which in (car, long))
    if high > usual + _HIGHER_M:
        return None
    return (
        f"median trucks and buses of over {_LONG_M:g} m are {high:.3g} m high and cars {usual:.3g} m (usual: 3 to 4 "
        "and 1.5); probably one height for all: give height_m by class"
    )


_MOST_OFF_M = 0.5


def _heights_of_middles(sample: Recording) -> str | None:
    """Boxes that stand above the road or in it: z_m that is not of their middles."""
    z, half = sample.centre_m[:, 2], 0.5 * sample.size_m[:, 2]
    if (np.abs(z - half) <= _MOST_OFF_M).mean() >= 1.0 - _MOST_ODD:
        return None
    meant = "heights above sea, or of another plane than the road"
    for name, would_be in (("the boxes' floors", z + half), ("the boxes' tops", z - half)):
        if (np.abs(would_be - half) <= _MOST_OFF_M).mean() > FITTING:
            meant = name
    return (
        f"the boxes' middles lie {np.median(z):.3g} m above the road (usual: half their heights, "
        f"{np.median(half):.2g} m); probably z_m is of {meant}: leave the column out, and they stand on the road"
    )


_Check = Callable[[Recording, Recording, Ways, Scenario], str | None]
_CHECKS: Mapping[str, _Check] = {  # in the order of `names.WARNINGS`: causes before what comes of them
    "units": _units,
    "sizes": _sizes,
    "time-step": time_step,
    "tracks": tracks,
    "headings": headings,
    "carriageway": carriageway,
    "overlaps": overlaps,
}
