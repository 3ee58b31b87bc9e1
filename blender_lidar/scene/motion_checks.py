"""Checks of motion: wrong time steps, ids and headings, seen from how vehicles move."""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import cached_property
from typing import NamedTuple

import numpy as np

from ..road.road_map import wrap_angle
from ..traffic.tracks import central_velocity, held_heading
from ..traffic.vehicles import Placing, Recording
from . import usual
from .region import Region
from .scenario import Scenario

# --- How vehicles move --------------------------------------------------------------------------------------------


class Moves(NamedTuple):
    """From rows of vehicles to later ones of the same, (m,) each: first row, seconds, metres (m, 2), headings [rad]."""

    row: np.ndarray
    later: np.ndarray
    seconds: np.ndarray
    moved_m: np.ndarray
    heading_rad: np.ndarray  # the middle of both
    turn_rad: np.ndarray

    @property
    def distance_m(self) -> np.ndarray:
        return np.hypot(*self.moved_m.T)

    def astray(self, heading_rad: np.ndarray) -> np.ndarray:
        """How far headings are off the directions of motion, counter-clockwise, (m,) [rad]."""
        return wrap_angle(np.arctan2(self.moved_m[:, 1], self.moved_m[:, 0]) - heading_rad)

    def share_astray(self, heading_rad: np.ndarray) -> float:
        return float((np.abs(self.astray(heading_rad)) > usual.ASTRAY_RAD).mean())


class Tracks:
    """Tracks of vehicles, row by row in order of time; of a share of the vehicles where there are many.

    Attributes
    ----------
    vehicle : ndarray, (n,) int
        From 0, ascending.
    xy : ndarray, (n, 2)
        Places [m].
    heading_rad, time_s, frame, length_m : ndarray, (n,)
        As the recording has them, times since its beginning.
    step_s : float
        Between frames, in the median [s].
    """

    def __init__(self, recording: Recording) -> None:
        of_row = np.unique(recording.vehicle_id, return_inverse=True)[1].reshape(-1)
        kept = np.flatnonzero(of_row % -(-len(of_row) // usual.TRACK_ROWS) == 0)
        kept = kept[np.lexsort((recording.frame[kept], of_row[kept]))]
        time_s = recording.frame_time_s[np.searchsorted(recording.frames, recording.frame[kept])]
        self.vehicle = np.unique(of_row[kept], return_inverse=True)[1].reshape(-1)
        self.xy, self.heading_rad = recording.centre_m[kept, :2], recording.heading_rad[kept]
        self.time_s, self.frame = time_s - recording.frame_time_s[0], recording.frame[kept]
        self.length_m = recording.size_m[kept, 0]
        self.step_s = float(np.median(np.diff(recording.frame_time_s))) if len(recording.frames) > 1 else 0.0

    @property
    def vehicles(self) -> int:
        """How many there are."""
        return int(self.vehicle.max(initial=-1)) + 1

    def moves(self, rows: int) -> Moves:
        """From each row to that so many rows later."""
        first = np.flatnonzero(self.vehicle[rows:] == self.vehicle[:-rows])
        later = first + rows
        turn = wrap_angle(self.heading_rad[later] - self.heading_rad[first])
        seconds, moved = self.time_s[later] - self.time_s[first], self.xy[later] - self.xy[first]
        return Moves(first, later, seconds, moved, self.heading_rad[first] + 0.5 * turn, turn)

    @cached_property
    def steps(self) -> Moves:
        """From each row to the next."""
        return self.moves(1)

    @cached_property
    def ways(self) -> Moves:
        """A sample of moves of 5 m and more, over as many rows as it takes until a fifth of all are."""
        rows, found, far = 1, self.steps, self.steps.distance_m >= usual.MOVED_M
        while rows < usual.MOST_ROWS_APART and far.sum() < max(usual.FEWEST, usual.MANY * len(far)):
            rows *= 2
            over = self.moves(rows)
            if (more := over.distance_m >= usual.MOVED_M).sum() < far.sum():
                break
            found, far = over, more
        kept = np.flatnonzero(far)
        return Moves(*(column[kept[:: -(-len(kept) // usual.SAMPLE) or 1]] for column in found))


# --- The checks: what each has seen, and what is probably meant; nothing where all may be true --------------------


def time_step(tracks: Tracks) -> str | None:
    """Speeds that no traffic has: a wrong time step or unit, or new vehicle numbers in each frame."""
    ways = tracks.ways
    if len(ways.seconds) < usual.FEWEST:
        return None
    median, fast = np.quantile(ways.distance_m / ways.seconds, [0.5, 0.9])
    crawls = fast < usual.CRAWL_M_S and np.ptp(tracks.time_s) > usual.CRAWL_S
    if not crawls and median <= usual.FASTEST_MEDIAN_M_S:
        return None
    return (
        f"moving vehicles drive {median:.3g} m/s (usual: 2 to 40) with frames {tracks.step_s:.3g} s apart; probably "
        "time_s is not in seconds, [traffic] time_step_s is another, places are not in metres, or "
        + ("a jam crawls" if crawls else "vehicles have new numbers in each frame")
    )


def jumps(recording: Recording, tracks: Tracks) -> str | None:
    """Vehicles that are in two places at once or jump, each by itself or all together."""
    report, steps = recording.report, tracks.steps
    if report.repeated > max(usual.SOME * report.rows_read, usual.FEWEST):
        return (
            f"{report.repeated:,} of {report.rows_read:,} rows are of a vehicle that is elsewhere in the same frame "
            "(usual: none); probably several vehicles share a vehicle_id"
        )
    if together := _together(tracks):
        return together
    far = steps.distance_m > usual.JUMP_M
    jump = far & (steps.distance_m > usual.FASTEST_M_S * steps.seconds)
    back = far[1:] & far[:-1] & ((steps.moved_m[1:] * steps.moved_m[:-1]).sum(axis=1) < 0.0)
    jump[1:] |= back & _next(tracks) & (np.maximum(steps.seconds[1:], steps.seconds[:-1]) <= usual.AGAIN_S)
    jumping = len(np.unique(tracks.vehicle[steps.row[jump]]))
    if jumping <= max(usual.SOME * tracks.vehicles, usual.FEWEST_TOGETHER):
        return None
    return (
        f"{jumping:,} of {tracks.vehicles:,} vehicles jump by {usual.JUMP_M:g} m or more, faster than any vehicle "
        "drives or there and back (usual: none); probably several vehicles share a vehicle_id, or frames are out of "
        "order"
    )


def _next(tracks: Tracks) -> np.ndarray:
    """Which steps, except for the first, follow one of the same vehicle."""
    return np.diff(tracks.vehicle[tracks.steps.row]) == 0


def _together(tracks: Tracks) -> str | None:
    """A step in which all vehicles jump alike, as where a camera or an origin has moved."""
    steps = tracks.steps
    now = 1 + np.flatnonzero(_next(tracks) & (np.maximum(steps.seconds[1:], steps.seconds[:-1]) <= usual.TOGETHER_S))
    if not len(now):
        return None
    cos, sin = np.cos(steps.heading_rad), np.sin(steps.heading_rad)
    ahead = steps.moved_m[:, 0] * cos + steps.moved_m[:, 1] * sin
    aside = (steps.moved_m[:, 1] * cos - steps.moved_m[:, 0] * sin)[now]
    faster = ahead[now] - ahead[now - 1] / steps.seconds[now - 1] * steps.seconds[now]
    faster[steps.seconds[now] > 0.5 * usual.TOGETHER_S] = 0.0
    frames, of = np.unique(tracks.frame[steps.row[now]], return_inverse=True)
    middle = [_medians_of(values, of.reshape(-1)) for values in (aside, faster)]
    enough = np.bincount(of.reshape(-1)) >= usual.FEWEST_TOGETHER
    far = np.flatnonzero(enough & ((np.abs(middle[0]) > usual.ASIDE_M) | (np.abs(middle[1]) > usual.AHEAD_M)))
    if not len(far) or len(far) > max(usual.SOME * enough.sum(), 2):
        return None
    at = far[0]
    later = tracks.frame[steps.later[now]][of.reshape(-1) == at].min()
    return (
        f"all vehicles jump together by {math.hypot(middle[0][at], middle[1][at]):.1f} m from frame {frames[at]} to "
        f"{later}; probably the camera or the file's origin has moved (make two recordings, each with its origin_m), "
        "or places are rounded coarsely"
    )


def _medians_of(values: np.ndarray, of: np.ndarray) -> np.ndarray:
    """The median of the values of each group (n,), numbered from 0 without gaps."""
    count = np.bincount(of)
    return values[np.lexsort((values, of))][np.cumsum(count) - count + count // 2]


def headings(tracks: Tracks, scenario: Scenario) -> str | None:
    """Headings off the motion: radians, a compass's bearings, mirrored, reversed, or of another axis."""
    ways = tracks.ways
    if len(ways.seconds) < usual.FEWEST:
        return None
    share, off = ways.share_astray(ways.heading_rad), _off_rad(tracks, ways.heading_rad)
    if share <= usual.MANY and off <= usual.OFF_RAD:
        return _standing_astray(tracks)
    placing = Placing(heading_deg=scenario.traffic.heading_deg or 0.0)
    in_file = wrap_angle(ways.heading_rad + math.radians(placing.heading_deg))
    meant = {
        "reversed, by half a turn": in_file + math.pi,
        "clockwise from north, as a compass has them (counter-clockwise from +x is 90 minus the bearing), or x and y "
        "are swapped": 0.5 * math.pi - in_file,
        "clockwise, or y mirrored": -in_file,
    }
    degrees = np.degrees(in_file)
    if (np.abs(degrees) <= 2 * math.pi + 0.02).all():
        meant = {"radians for degrees": degrees, **meant}  # the number was the angle in radians
    probably = (
        "measured from another axis than x_m, one heading for all although the road bends or has two directions, or "
        "those of other vehicles"
    )
    for name, heading in meant.items():
        right = placing.headings(heading)
        if ways.share_astray(right) < 1.0 - usual.MOST and _off_rad(tracks, right) <= usual.OFF_RAD:
            probably = name
            break
    return (
        f"headings of moving vehicles are {math.degrees(off):.0f} degrees off their motion (usual: under 2), "
        f"{100 * share:.0f} % of them more than 30 (usual: none); probably {probably}"
    )


def _off_rad(tracks: Tracks, heading_rad: np.ndarray) -> float:
    """How far headings of the ways are off the motion: root mean square of the means place by place, less their noise.

    A place is a square of 20 m and an eighth of the directions; with few boxes all are one place.
    """
    ways = tracks.ways
    astray = np.exp(1j * ways.astray(heading_rad))
    cell = np.floor(tracks.xy[ways.row] / usual.PLACE_M)
    eighth = np.rint(heading_rad / (0.25 * math.pi)) % 8
    place = np.unique(np.column_stack([cell, eighth]), axis=0, return_inverse=True)[1].reshape(-1)
    if np.bincount(place).max() < usual.FEWEST:
        place[:] = 0
    boxes = np.bincount(place)
    mean = (np.bincount(place, astray.real) + 1j * np.bincount(place, astray.imag)) / boxes
    noise = 2.0 * (1.0 - np.abs(mean)) / boxes  # the square of a mean's standard error
    enough = boxes >= usual.FEWEST
    square = np.average((np.square(np.angle(mean)) - noise)[enough], weights=boxes[enough])
    return math.sqrt(max(0.0, square))


def _standing_astray(tracks: Tracks) -> str | None:
    """Headings of vehicles that stand, off those with which they came or leave: made of noise, or of nothing."""
    velocity = central_velocity(tracks.vehicle, tracks.time_s, tracks.xy)
    known, _ = held_heading(tracks.vehicle, velocity, np.nan)
    stands = (np.hypot(*velocity.T) < usual.STANDS_M_S) & ~np.isnan(known)
    astray = np.abs(wrap_angle(tracks.heading_rad - known)[stands]) > usual.ASTRAY_RAD
    if stands.sum() < usual.FEWEST or astray.mean() <= usual.MANY or astray.sum() <= usual.FEW * len(stands):
        return None
    return (
        f"{100 * astray.mean():.0f} % of the standing boxes point more than 30 degrees off the way they came or go "
        "(usual: none; no vehicle turns on the spot); probably headings are computed from the motion, and are noise or "
        "0 where there is none: keep the last heading"
    )


# --- What is suspicious and may be right --------------------------------------------------------------------------


def coupled(recording: Recording) -> Iterator[str]:
    """Articulated lorries as two boxes: pairs that touch from end to end as they drive."""
    touching: dict[tuple[int, int], list[tuple[int, np.ndarray]]] = {}
    looked = recording.frames[:: -(-len(recording.frames) // usual.COUPLED_FRAMES)]
    for at, number in enumerate(looked.tolist()):
        vehicles = recording.vehicles(number)
        ahead = vehicles.centre_m[None, :, :2] - vehicles.centre_m[:, None, :2]
        cos, sin = np.cos(vehicles.heading_rad)[:, None], np.sin(vehicles.heading_rad)[:, None]
        along, aside = ahead[..., 0] * cos + ahead[..., 1] * sin, ahead[..., 1] * cos - ahead[..., 0] * sin
        half_m = 0.5 * vehicles.size_m[:, 0]
        gap = along - half_m[:, None] - half_m
        found = (along > 0.0) & (np.abs(gap) <= usual.COUPLED_M) & (np.abs(aside) <= usual.COUPLED_M)
        for one, other in np.argwhere(found).tolist():
            pair = int(vehicles.vehicle_id[one]), int(vehicles.vehicle_id[other])
            touching.setdefault(pair, []).append((at, vehicles.centre_m[one, :2]))
    count = 0
    for seen in touching.values():
        (first, start), (last, end) = seen[0], seen[-1]
        always = len(seen) >= max(usual.FEWEST_TOGETHER, usual.MOST * (last - first + 1))
        count += always and math.dist(start, end) >= usual.JUMP_M
    if count:
        yield (
            f"{count:,} {'pair' if count == 1 else 'pairs'} of boxes touch from end to end as they drive: tractors and "
            "trailers as two boxes each? They count as two vehicles; give one box to each"
        )


def track_notes(recording: Recording, tracks: Tracks) -> Iterator[str]:
    """What is suspicious of tracks, as sentences."""
    steps, vehicles, of_row = tracks.steps, tracks.vehicles, tracks.vehicle
    if len(recording.frames) < 2 or vehicles < 2:
        return
    if len(np.unique(of_row[steps.row])) <= usual.SOME * vehicles:
        yield (
            "almost no vehicle is in more than one frame: the frames are unrelated, or vehicles have new numbers in "
            "each frame, and then the check on held-out traffic is not independent"
        )
        return
    first = np.flatnonzero(np.diff(of_row, prepend=-1))
    extent = np.maximum.reduceat(tracks.xy, first) - np.minimum.reduceat(tracks.xy, first)
    standing = (np.hypot(*extent.T) < usual.MOVED_M).mean()
    turning = math.degrees(float(np.median(np.abs(steps.turn_rad))))
    mean = np.bincount(of_row, tracks.length_m) / np.bincount(of_row)
    varying = np.sqrt(np.bincount(of_row, np.square(tracks.length_m - mean[of_row])) / np.bincount(of_row)) / mean
    varying = np.median(varying)
    at = np.searchsorted(recording.frames, tracks.frame)
    gaps = (at[steps.later] - at[steps.row] - 1).sum()
    missing = gaps / (gaps + len(at))
    ahead = steps.moved_m[:, 0] * np.cos(steps.heading_rad) + steps.moved_m[:, 1] * np.sin(steps.heading_rad)
    again = len(np.unique(of_row[steps.row[ahead < -usual.JUMP_M]])) / vehicles
    copied, later_s = _there_again(recording)
    for measured, limit, sentence in (
        (
            copied,
            usual.MANY,
            f"{100 * copied:.0f} % of the frames come again to the centimetre {later_s:g} s later, under other "
            "vehicle numbers: if the recording holds the same minutes twice, held-out frames are copies of searched "
            "ones",
        ),
        (
            standing,
            1.0 - usual.SOME,
            f"almost no vehicle moves in {np.ptp(recording.frame_time_s):.0f} s: a jam, or a car park?",
        ),
        (
            turning,
            usual.TURN_DEG,
            f"headings change by {turning:.0f} degrees from row to row (usual: under 1): are they noise?",
        ),
        (
            varying,
            usual.LENGTH_VARIES,
            f"lengths of one vehicle vary by {100 * varying:.0f} % (usual: none); give it one size in all frames, or "
            "each its own vehicle_id",
        ),
        (
            missing,
            usual.MANY,
            f"vehicles are missing in {100 * missing:.0f} % of the frames between their first and their last, and hide "
            "nothing there",
        ),
        (
            again,
            usual.SOME,
            f"{100 * again:.0f} % of the vehicles jump back and drive past again: if ids are reused, the later "
            "vehicles are left out of the check on held-out traffic",
        ),
    ):
        if measured > limit:
            yield sentence


_MIXED = np.array([2_654_435_761, 40_503])  # odd factors, to give each place a number of its own


def _there_again(recording: Recording) -> tuple[float, float]:
    """Share of the frames whose boxes stand where an earlier one's stood, to the centimetre, and how much later [s].

    Vehicles that follow each other at even distances do so too, but some of them are in both frames.
    """
    place = (np.rint(100.0 * recording.centre_m[:, :2]).astype(np.int64) * _MIXED).sum(axis=1)
    first = np.append(0, np.cumsum(recording.counts))
    looks = np.add.reduceat(place * place, first[:-1])
    order = np.argsort(looks, kind="stable")
    same = np.flatnonzero((np.diff(looks[order]) == 0) & (recording.counts[order[:-1]] > 1))
    later_s = []
    for one, other in zip(order[same], order[same + 1], strict=True):
        ids = (recording.vehicle_id[first[at] : first[at + 1]] for at in (one, other))
        if not np.intersect1d(*ids).size:
            later_s.append(recording.frame_time_s[other] - recording.frame_time_s[one])
    return len(later_s) / len(looks), float(np.median(later_s)) if later_s else 0.0


_BIN_M, _SMOOTHED_M, _FARTHEST_M = 0.1, 0.3, 1.7  # of densities across the road, and from one to the next


def drift(tracks: Tracks, region: Region) -> str | None:
    """Lanes that move across the road: cross-correlation of where vehicles drive in one window of time and the next.

    A drone's drift of 5 cm/s makes nine lanes of three. A polygon may hold a crossing, and is not looked at.
    """
    inside = np.hypot(*(tracks.xy - region.centre_xy).T) <= region.radius_m
    rows = np.flatnonzero(inside & (np.abs(np.sin(tracks.heading_rad)) <= math.sin(usual.DRIFT_RAD[1])))
    if region.polygon or not len(rows):
        return None
    since, across = tracks.time_s[rows] - tracks.time_s[rows].min(), tracks.xy[rows, 1]
    window_s = float(np.clip(since.max() / usual.DRIFT_WINDOWS, *usual.DRIFT_WINDOW_S))
    places = [(since / window_s).astype(int), np.rint((across - across.min()) / _BIN_M).astype(int)]
    # A vehicle counts once in a window and a bin: one that waits is no lane of its own.
    once = np.unique(np.column_stack([*places, tracks.vehicle[rows]]), axis=0)
    vehicles = np.bincount(np.unique(once[:, [0, 2]], axis=0)[:, 0])
    counts = np.zeros((len(vehicles), places[1].max() + 1))
    np.add.at(counts, tuple(once[:, :2].T), 1.0)
    kernel = np.exp(-0.5 * (np.arange(-12, 13) * _BIN_M / _SMOOTHED_M) ** 2)
    density, moved, most = [np.convolve(one, kernel) for one in counts], [], round(_FARTHEST_M / _BIN_M)
    for number in np.flatnonzero(np.minimum(vehicles[1:], vehicles[:-1]) >= usual.FEWEST_TOGETHER):
        alike = np.correlate(density[number + 1], density[number], "full")
        middle = len(alike) // 2
        moved.append(_BIN_M * (int(np.argmax(alike[middle - most : middle + most + 1])) - most))
    if len(moved) < usual.DRIFT_WINDOWS - 2 or abs(sum(moved)) < usual.DRIFTED_M:
        return None
    mean, error = float(np.mean(moved)), float(np.std(moved, ddof=1)) / math.sqrt(len(moved))
    if abs(mean) < usual.DRIFT_ERRORS * max(error, _BIN_M / len(moved)):
        return None
    return (
        f"all lanes move to the {'left' if mean > 0.0 else 'right'} of x by {100.0 * abs(mean) / window_s:.1f} cm/s: a "
        "camera that drifts? Take the drift out of x and y"
    )


def bend(tracks: Tracks, region: Region) -> str | None:
    """A road that bends within the region: the sagitta of the vehicles' ways, beside a scene's straight lanes.

    A polygon may hold a crossing, where vehicles turn, and is not looked at.
    """
    inside = np.flatnonzero(np.hypot(*(tracks.xy - region.centre_xy).T) <= region.radius_m)
    if region.polygon or not len(inside):
        return None
    first = np.flatnonzero(np.diff(tracks.vehicle[inside], prepend=-1))
    start, end = inside[first], inside[np.append(first[1:], len(inside)) - 1]
    length = np.hypot(*(tracks.xy[end] - tracks.xy[start]).T)
    chord, turn = tracks.xy[end] - tracks.xy[start], wrap_angle(tracks.heading_rad[end] - tracks.heading_rad[start])
    whole = length >= region.radius_m
    if whole.sum() < usual.FEWEST:
        return None
    turn *= np.where(chord @ chord[whole][0] < 0.0, -1.0, 1.0)  # what drives the other way turns the other way
    turn, length = float(np.median(turn[whole])), float(np.median(length[whole]))
    aside = length * abs(turn) / 8.0
    if aside <= usual.SAGITTA_M:
        return None
    return (
        f"the road bends by {abs(math.degrees(turn)):.0f} deg within the region, {aside:.1f} m off a straight line, "
        "and a scene's lanes are straight; choose a shorter [region]"
    )
