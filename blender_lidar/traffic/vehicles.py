"""Traffic as oriented bounding boxes in the road frame, by frame; the report of repairs; overlapping boxes."""

from __future__ import annotations

from dataclasses import dataclass, field, fields, replace
from functools import cached_property

import numpy as np

from ..errors import InputError, printable
from ..names import CLASSES
from ..road.road_map import wrap_angle
from .boxes import DTYPES, Boxes

# --- What reading a recording found and repaired ----------------------------------------------------------


@dataclass(frozen=True, slots=True)
class RepairReport:
    """Counts of everything that reading a recording changed.

    Attributes
    ----------
    rows_read : int
        Rows in the file, all locations and periods.
    rows_used : int
        Rows of the file that became boxes.
    location, period : str
        What was read of a file that mixes several; empty where the file names none.
    format : str
        Of the file: ngsim, sumo or table; of several the first's.
    locations, periods : tuple of str
        What the file holds.
    duplicates : int
        Rows dropped because they repeat another in every value that is used.
    repeated : int
        Rows dropped because their vehicle was already there in that frame, elsewhere or with another size.
    off_map : int
        Rows dropped because they lie kilometres from the section, or have no place at all.
    left_out : int
        Rows of what is no vehicle on a road: containers, trains, persons in vehicles, and pedestrians left out.
    types_unknown : int
        Vehicles whose type names no vehicle class, and that were taken for cars.
    sizes_repaired : int
        Vehicles whose size was missing or absurd.
    headings_held, headings_clamped : int
        Boxes whose heading was kept from before, being slow or alone; or limited, being too far off the road's.
    overlaps, overlap_frames : int
        Pairs of overlapping boxes, and the number of frames looked at.
    notes : tuple of str
        Choices made where a setting was missing, as sentences.
    assumed : tuple of str
        What the recording does not say and was assumed, as sentences.
    assumed_sizes : tuple of str
        Which of length, width and height were assumed of some vehicle, as the recording does not have them.
    warnings : tuple of (str, str)
        What cannot be true and was accepted: its name, and what was seen.
    ground : ndarray, (n, 3)
        A sample of places where vehicles stand and how high, as the file has it [m, road frame]; none where it is flat.
    """

    rows_read: int = 0
    rows_used: int = 0
    format: str = ""
    location: str = ""
    period: str = ""
    locations: tuple[str, ...] = ()
    periods: tuple[str, ...] = ()
    duplicates: int = 0
    repeated: int = 0
    off_map: int = 0
    left_out: int = 0
    types_unknown: int = 0
    sizes_repaired: int = 0
    headings_held: int = 0
    headings_clamped: int = 0
    overlaps: int = 0
    overlap_frames: int = 0
    notes: tuple[str, ...] = ()
    assumed: tuple[str, ...] = ()
    assumed_sizes: tuple[str, ...] = ()
    warnings: tuple[tuple[str, str], ...] = ()
    ground: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)), compare=False)

    def lines(self, *, losses: bool = False) -> list[str]:
        """A few lines for a person: only what happened; names from the file are made printable.

        With `losses` they are those of rows that were not used and of sizes that were made up, if there are any.
        """
        happened = [
            (self.duplicates, "duplicate row", "dropped"),
            (self.repeated, "row", "dropped: vehicle already in that frame"),
            (self.off_map, "row", "dropped: off the map"),
            (self.left_out, "row", "left out: no vehicle on a road"),
            (self.types_unknown, "vehicle", "of a type that names no vehicle class taken for cars: give vehicle_types"),
            (self.sizes_repaired, "vehicle", "with a missing or absurd size repaired"),
        ]
        if not losses:
            happened += [
                (self.headings_held, "heading", "held (slower than 2 m/s, or no neighbour in time)"),
                (self.headings_clamped, "heading", "limited"),
            ]
        chosen = [f"location {self.location}"] if len(self.locations) > 1 else []
        chosen += [f"period {self.period}"] if len(self.periods) > 1 else []
        of_what = f" ({', '.join(chosen)})" if chosen else ""
        used = f"{self.rows_used:,} of {counted(self.rows_read, 'row')} used{of_what}"
        lines = [f"{counted(count, noun)} {outcome}" for count, noun, outcome in happened if count]
        if losses:
            return [printable(line) for line in (used, *lines)] if lines or self.rows_used < self.rows_read else []
        if self.overlaps:
            pairs, frames = counted(self.overlaps, "pair"), counted(self.overlap_frames, "frame")
            lines.append(f"{pairs} of overlapping boxes in {frames} looked at")
        return [printable(line) for line in (used, *lines, *self.notes)]

    def as_dict(self) -> dict[str, object]:
        """All counts, for a result file, which holds the warnings by themselves."""
        named = {one.name: getattr(self, one.name) for one in fields(self)}
        elsewhere = ("warnings", "assumed", "assumed_sizes", "ground")
        kept = {name: value for name, value in named.items() if name not in elsewhere}
        return {name: list(value) if isinstance(value, tuple) else value for name, value in kept.items()}

    def warnings_as_dicts(self) -> list[dict[str, str]]:
        """What cannot be true and was accepted, for a result file."""
        return [{"name": name, "text": text} for name, text in self.warnings]


def counted(count: int, noun: str) -> str:
    """A count and its noun: ``"1 frame"``, ``"2 boxes"``."""
    plural = "es" if noun.endswith("x") else "s"
    return f"{count:,} {noun}{plural if count != 1 else ''}"


# --- The traffic as the rest of the package sees it: boxes in the road frame, by frame --------------------

# `class_index` counts into `CLASSES`. A van is any car longer than 4.9 m: van, SUV or pick-up; a bicycle has its rider.
PEDESTRIAN = CLASSES.index("pedestrian")
VAN_LONGER_THAN_M = 4.9
LONG_TRUCK_M = 9.0  # from this length on a truck is an articulated one
DIMENSIONS = ("length", "width", "height")
HEIGHTS_M = {"car": 1.5, "van": 1.9, "truck": 3.0, "long_truck": 3.8, "bus": 3.2, "motorcycle": 1.4}
HEIGHTS_M |= {"bicycle": 1.73, "pedestrian": 1.73}
"""Heights by kind [m], for recordings that have none; the last two are the means of KITTI's labels, by which its
detectors are set up."""
FLEET_KINDS = (*CLASSES, "long_truck")
"""The kinds of vehicles by whose heights and shapes a fleet is made."""


def fleet_kind(class_index: np.ndarray, length_m: np.ndarray) -> np.ndarray:
    """Index into `FLEET_KINDS`, (n,): the class, and for trucks whether they are articulated."""
    is_long = (class_index == CLASSES.index("truck")) & (length_m >= LONG_TRUCK_M)
    return np.where(is_long, len(CLASSES), class_index)


SAME_S = 1e-3
"""A moment this near to an instant of a recording [s] is that instant."""
_LONGEST_S = 1.0  # from one instant to the next, in between which vehicles are taken to move evenly
_PAUSE_S = 5.0  # before a recording that begins earlier than the one before it has ended


@dataclass(frozen=True, eq=False, kw_only=True)
class Recording(Boxes):
    """A whole recording: its boxes sorted by (frame, vehicle_id), with `frame` and `time_s` as columns. All read-only.

    Attributes
    ----------
    time_step_s : float
        Time between consecutive frame numbers [s].
    source : str
        Where it came from, for messages.
    report : RepairReport
        What reading it repaired.
    """

    time_step_s: float
    source: str
    report: RepairReport

    def __post_init__(self) -> None:
        for column in self.columns().values():
            column.flags.writeable = False

    @classmethod
    def from_rows(
        cls, *, frame: np.ndarray, time_s: np.ndarray, time_step_s: float, source: str, report: RepairReport, **columns
    ) -> Recording:
        """Build one from rows in any order; `time_s` is every row's time [s], `columns` are those of `Boxes`."""
        order = np.lexsort((columns["vehicle_id"], frame))
        columns.setdefault("body", np.zeros(len(frame)))
        arrays = {name: np.asarray(columns[name], dtype=kind)[order] for name, kind in DTYPES.items()}
        frame = np.asarray(frame, dtype=np.int64)[order]
        first, row = np.unique(frame, return_index=True, return_inverse=True)[1:]
        arrays |= {"frame": frame, "time_s": np.asarray(time_s, np.float64)[order[first]][row.reshape(-1)]}
        return cls(**arrays, time_step_s=float(time_step_s), source=source, report=report)

    @cached_property
    def vehicles_alone(self) -> Recording:
        """The same recording without pedestrians, who keep to no lane; itself where it has none, or no vehicles."""
        driven = self.class_index != PEDESTRIAN
        if driven.all() or not driven.any():
            return self
        walking, report = len(np.unique(self.vehicle_id[~driven])), self.report
        said = f"Pedestrians: {walking:,} left out; [objective] classes that name pedestrian score them"
        rows = {"rows_used": int(driven.sum()), "left_out": report.left_out + int((~driven).sum())}
        return replace(self.select(driven), report=replace(report, **rows, assumed=(*report.assumed, said)))

    @cached_property
    def _bounds(self) -> np.ndarray:
        """Row at which each frame starts, and the number of rows at the end: (k + 1,) int64."""
        starts = np.diff(self.frame, prepend=self.frame[:1] - 1, append=self.frame[-1:] + 1)
        return np.flatnonzero(starts)

    @cached_property
    def frames(self) -> np.ndarray:
        """The distinct frame numbers, ascending, (k,) int64."""
        return self.frame[self._bounds[:-1]]

    @cached_property
    def frame_time_s(self) -> np.ndarray:
        """Times of `frames`, (k,) [s]."""
        return self.time_s[self._bounds[:-1]]

    @cached_property
    def counts(self) -> np.ndarray:
        """Boxes in each of `frames`, (k,) int64."""
        return np.diff(self._bounds)

    def at(self, frame: int) -> Boxes:
        """The boxes of one frame, as views into the recording.

        Raises
        ------
        InputError
            For a frame that the recording does not have.
        """
        at = int(np.searchsorted(self.frames, frame))
        if at == len(self.frames) or self.frames[at] != frame:
            raise unknown_frame(frame, self)
        return self._of_frame(at, slice(self._bounds[at], self._bounds[at + 1]))

    def _of_frame(self, at: int, rows: slice | np.ndarray) -> Boxes:
        """Some rows as those of one of `frames`."""
        columns = {name: column[rows] for name, column in self.columns().items()}
        return Boxes(**columns | {"frame": int(self.frames[at]), "time_s": float(self.frame_time_s[at])})

    @cached_property
    def since_s(self) -> np.ndarray:
        """Time of each of `frames` since the first, (k,) float64 [s], ascending: the clock by which it is played.

        Of several recordings one that has an earlier time than the one before follows it after a pause of 5 s.
        """
        step = np.diff(self.frame_time_s)
        later = np.cumsum(np.where(step > 0.0, 0.0, _PAUSE_S - step))
        return self.frame_time_s - self.frame_time_s[:1] + np.append(np.zeros(len(self.frames[:1])), later)

    @cached_property
    def next_row(self) -> np.ndarray:
        """Row in which each box's vehicle is in the next of `frames`, (n,) int64; -1: not there, or over 1 s later."""
        order = np.lexsort((self.frame, self.vehicle_id))
        at, found = np.searchsorted(self.frames, self.frame)[order], np.full(len(self), -1)
        goes_on = (np.diff(self.vehicle_id[order]) == 0) & (np.diff(at) == 1)
        goes_on &= np.diff(self.since_s[at]) <= _LONGEST_S + SAME_S
        found[order[:-1][goes_on]] = order[1:][goes_on]
        return found

    def moment(self, since_s: float) -> Boxes:
        """The vehicles at any time on the clock of `since_s`, between two instants by linear interpolation.

        Within `SAME_S` of an instant these are its rows as they were recorded. Between two that are at most 1 s apart
        vehicles that are in both move evenly and turn the shorter way; in a gap there are none.

        Parameters
        ----------
        since_s : float
            Time since the first instant [s].

        Returns
        -------
        Boxes
            `frame` is the number of the nearest instant, `time_s` the moment's own time.
        """
        clock = self.since_s
        at = max(int(np.searchsorted(clock, since_s + SAME_S, side="right")) - 1, 0)
        near = at + int(at + 1 < len(clock) and clock[at + 1] - since_s < since_s - clock[at])
        nearest = self.at(self.frames[near])
        if abs(since_s - clock[near]) <= SAME_S:
            return nearest
        rows = np.arange(self._bounds[at], self._bounds[at + 1])
        rows = rows[(self.next_row[rows] >= 0) & (since_s > clock[at])]
        after, passed = self.next_row[rows], (since_s - clock[at]) / max(np.diff(clock[at : at + 2]).sum(), SAME_S)
        before = self._of_frame(near, rows)
        turn = wrap_angle(self.heading_rad[after] - before.heading_rad)
        return replace(
            before,
            time_s=nearest.time_s + since_s - float(clock[near]),
            since_ms=round(1e3 * (since_s - float(clock[at]))),
            centre_m=before.centre_m + passed * (self.centre_m[after] - before.centre_m),
            heading_rad=wrap_angle(before.heading_rad + passed * turn),
        )


def unknown_frame(frame: int, recording: Recording) -> InputError:
    """The error for a frame number that `recording` does not have."""
    frames = recording.frames
    has = f"the recording has {counted(len(frames), 'frame')} from {frames[0]} to {frames[-1]}"
    nearest = min(frames.tolist(), key=lambda one: abs(one - frame))
    return InputError(f"{recording.source}: no frame {frame}; {has}, {nearest} is the nearest")


_FLAT_WITHIN_M = 0.5  # of height over all places
_SAMPLE = 2000  # places are enough for a slope


def ground_sample(xy_m: np.ndarray, z_m: np.ndarray) -> np.ndarray:
    """A sample of the ground under vehicles, (n, 3) [m]: none where no height is known, or all are alike."""
    known = np.flatnonzero(np.isfinite(z_m))
    if not len(known) or np.ptp(z_m[known]) <= _FLAT_WITHIN_M:
        return np.zeros((0, 3))
    rows = known[:: max(1, len(known) // _SAMPLE)]
    return np.column_stack([xy_m[rows], z_m[rows]])


# --- Vehicles that stand in one another: a defect of recordings that is reported, not repaired ------------

_FRAMES_LOOKED_AT = 60
_TOUCHING_M = 0.02


def overlapping_pairs(vehicles: Boxes) -> np.ndarray:
    """Pairs of vehicles whose oriented boxes overlap, seen from above: sweep and prune, then separating axes.

    Boxes that touch, as those of a tractor and its trailer, do not overlap: 2 cm of overlap are within the digits that
    files are rounded to.

    Parameters
    ----------
    vehicles : Boxes
        One frame.

    Returns
    -------
    ndarray, (p, 2) int64
        Rows of `vehicles`, the smaller first.
    """
    centre, heading, half = vehicles.centre_m[:, :2], vehicles.heading_rad, vehicles.size_m[:, :2] / 2
    half = half - np.minimum(0.5 * _TOUCHING_M, 0.1 * half)
    reach = np.hypot(half[:, 0], half[:, 1])
    along = centre[:, np.abs(centre - centre.mean(axis=0)).sum(axis=0).argmax()] if len(vehicles) else reach
    order = np.argsort(along - reach, kind="stable")
    begin, end = (along - reach)[order], (along + reach)[order]
    near = [np.zeros((2, 0), dtype=np.int64)]
    for later in range(1, len(order)):  # circles that begin before another one ends, the nearest neighbours first
        rows = np.flatnonzero(begin[later:] < end[:-later])
        if not len(rows):
            break
        near.append(np.sort([order[rows], order[rows + later]], axis=0))
    first, second = np.concatenate(near, axis=1)
    together = rectangles_overlap(
        centre[first], half[first], heading[first], centre[second], half[second], heading[second]
    )
    pairs = np.stack([first, second], axis=1)[together]
    return pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))]


def rectangles_overlap(
    centre: np.ndarray,
    half: np.ndarray,
    heading: np.ndarray,
    other_centre: np.ndarray,
    other_half: np.ndarray,
    other_heading: np.ndarray | float,
) -> np.ndarray:
    """Which rectangles overlap another each, row by row, (n,) bool; those that only touch do not.

    By the separating-axis theorem: two rectangles are apart if and only if they are apart along one of their sides.

    Parameters
    ----------
    centre, half : ndarray, (n, 2)
        Centres, and half the length and width [m].
    heading : ndarray, (n,)
        Direction of the length, counter-clockwise from +x [rad].
    other_centre, other_half, other_heading
        The same of the others; also those of one rectangle for all, (2,), (2,) and a number.
    """
    forward, other_forward = _directions(heading), _directions(other_heading)
    left, other_left = (np.stack([-side[..., 1], side[..., 0]], axis=-1) for side in (forward, other_forward))
    offset = other_centre - centre
    together = np.ones(len(centre), dtype=bool)
    for axis in (forward, left, other_forward, other_left):
        extent = half[:, 0] * _along(forward, axis) + half[:, 1] * _along(left, axis)
        extent += other_half[..., 0] * _along(other_forward, axis) + other_half[..., 1] * _along(other_left, axis)
        together &= _along(offset, axis) < extent
    return together


def _directions(heading):
    return np.stack([np.cos(heading), np.sin(heading)], axis=-1)


def _along(vectors, axis):
    return np.abs((vectors * axis).sum(axis=-1))


def frames_looked_at(recording: Recording) -> np.ndarray:
    """Up to 60 frames, (k,) int64, spread evenly over a recording."""
    total = len(recording.frames)
    return recording.frames[np.unique(np.linspace(0, total - 1, min(total, _FRAMES_LOOKED_AT)).astype(int))]


def with_overlaps_reported(recording: Recording) -> Recording:
    """The same recording, its report telling the overlaps of vehicles in up to 60 frames spread evenly over it."""
    vehicles = recording.vehicles_alone
    looked_at = frames_looked_at(vehicles)
    pairs = sum(len(overlapping_pairs(vehicles.at(frame))) for frame in looked_at)
    return replace(recording, report=replace(recording.report, overlaps=pairs, overlap_frames=len(looked_at)))
