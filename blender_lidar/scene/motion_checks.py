"""Checks of motion: wrong time steps and headings, told by the ways that vehicles go."""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import cached_property

import numpy as np

from ..traffic import format_of
from ..traffic.ngsim import FOOT_M
from ..traffic.tracks import central_velocity, held_heading
from ..traffic.vehicles import Placing, Recording
from .settings import Scenario

ROWS = 20_000  # of a sample
FEWEST = 20  # boxes, or ways of vehicles, that tell anything
UNITS = {"feet": FOOT_M, "centimetres": 0.01, "millimetres": 0.001, "inches": 0.0254, "decimetres": 0.1}
FITTING = 0.8  # share that a guess must set right

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
        self._recording = recording
        frames, apart = len(recording.frames), 1
        found = self._between(recording, apart)
        while apart < min(_MOST_APART, 0.5 * frames) and (
            len(found[0]) < FEWEST or (np.hypot(*found[0].T) >= _FAR_ENOUGH_M).sum() < _MOVED_SHARE * len(found[0])
        ):
            apart *= 2
            later = self._between(recording, apart)
            found = max(found, later, key=lambda ways: len(ways[0])) if len(found[0]) < FEWEST else later
        far = np.hypot(*found[0].T) >= _FAR_ENOUGH_M
        self.moved_m, self.seconds, self.heading_rad = (one[far] for one in found)

    @staticmethod
    def _between(recording: Recording, apart: int) -> tuple[np.ndarray, ...]:
        frames = recording.frames
        pairs = int(np.clip(ROWS / max(np.median(recording.counts), 1), 4, _PAIRS))
        last = len(frames) - 1 - apart
        parts = [(np.zeros((0, 2)), np.zeros(0), np.zeros(0))]
        for at in np.unique(np.linspace(0, last, min(pairs, last + 1)).astype(int)) if last >= 0 else ():
            before, after = recording.vehicles(frames[at]), recording.vehicles(frames[at + apart])
            _, one, other = np.intersect1d(before.vehicle_id, after.vehicle_id, return_indices=True)
            moved = after.centre_m[other, :2] - before.centre_m[one, :2]
            turn = within_half_a_turn(after.heading_rad[other] - before.heading_rad[one])
            seconds = np.full(len(one), after.time_s - before.time_s)
            parts.append((moved, seconds, before.heading_rad[one] + 0.5 * turn))
        return tuple(np.concatenate(column) for column in zip(*parts, strict=True))

    @cached_property
    def tracks(self) -> Tracks:
        """Whole tracks, of a share of the vehicles where there are many."""
        return Tracks(self._recording)

    @cached_property
    def steps(self) -> _Steps:
        """Their steps from row to row."""
        return _Steps(self.tracks)

    @property
    def speed_m_s(self) -> np.ndarray:
        """Their speeds, (w,) [m/s]."""
        return np.hypot(*self.moved_m.T) / self.seconds

    def astray(self, heading_rad: np.ndarray) -> np.ndarray:
        """How far headings are off the directions of motion, counter-clockwise, (w,) [rad]."""
        return within_half_a_turn(np.arctan2(self.moved_m[:, 1], self.moved_m[:, 0]) - heading_rad)

    def share_astray(self, heading_rad: np.ndarray) -> float:
        """The share of headings that are more than 30 degrees off."""
        return float((np.abs(self.astray(heading_rad)) > ASTRAY_RAD).mean())

    def mean_astray(self, heading_rad: np.ndarray) -> float:
        """The circular mean of how far they are off [rad]: noise of positions leaves it where it is."""
        return float(np.angle(np.exp(1j * self.astray(heading_rad)).mean()))

    def is_astray(self, heading_rad: np.ndarray) -> bool:
        """Whether that mean is more than 3 degrees and three of its standard errors."""
        error = np.std(self.astray(heading_rad)) / math.sqrt(len(self.seconds))
        return abs(self.mean_astray(heading_rad)) > _MEAN_ASTRAY_RAD + 3.0 * float(error)


_TRACK_ROWS = 100_000


class Tracks:
    """Tracks of whole vehicles, row by row in order of time.

    Attributes
    ----------
    vehicle : ndarray, (n,) int
    xy : ndarray, (n, 2)
        Places [m].
    velocity : ndarray, (n, 2)
        By central differences over about two seconds [m/s]; NaN for vehicles in one frame only.
    heading_rad : ndarray, (n,)
        As the recording has it [rad].
    time_s, frame : ndarray, (n,)
        Since the recording's beginning [s], and the frame's number.
    length_m : ndarray, (n,)
        Of the boxes [m].
    """

    def __init__(self, recording: Recording) -> None:
        of_row = np.unique(recording.vehicle_id, return_inverse=True)[1].reshape(-1)
        kept = np.flatnonzero(of_row % -(-len(of_row) // _TRACK_ROWS) == 0)
        kept = kept[np.lexsort((recording.frame[kept], of_row[kept]))]
        time_s = recording.frame_time_s[np.searchsorted(recording.frames, recording.frame[kept])]
        self.vehicle, self.xy = of_row[kept], recording.centre_m[kept, :2]
        self.heading_rad, self.length_m = recording.heading_rad[kept], recording.size_m[kept, 0]
        self.time_s, self.frame = time_s - recording.frame_time_s[0], recording.frame[kept]
        self.velocity = central_velocity(self.vehicle, self.time_s, self.xy)
        self.speed_m_s = np.hypot(*self.velocity.T)


def within_half_a_turn(angle):
    return np.arctan2(np.sin(angle), np.cos(angle))


# --- The checks: what each has seen, and what is probably meant; nothing where all may be true --------------------

_SPEEDS_M_S = (1.5, 70.0)  # nine of ten that move at all are slower than the one, or one of ten faster than the other
_USUAL_M_S = (2.0, 40.0)
_FASTEST_MEDIAN_M_S = 44.0  # 160 km/h
_LONGEST_CRAWL_S = 60.0
ASTRAY_RAD = math.radians(30.0)
_MOST_ASTRAY = 0.25  # share of ways
_MEAN_ASTRAY_RAD = math.radians(3.0)  # real and generated recordings: at most 0.3 degrees


def time_step(recording: Recording, sample: Recording, ways: Ways, scenario: Scenario) -> str | None:
    """Speeds that no traffic has: a wrong time step, or vehicles that are numbered anew in each frame."""
    if len(ways.seconds) < FEWEST:
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
        cause = "milliseconds for seconds" if usual < 0.1 else "frame numbers for seconds, or a jam that crawls"
        return f"{seen}; probably {cause}: check time_s and [traffic] time_step_s"
    if ways.share_astray(ways.heading_rad) > _MOST_ASTRAY:
        return (
            f"{seen}, in no direction; probably vehicles are numbered anew in each frame, or places have another unit "
            "and axis than headings: check vehicle_id, x_m and y_m"
        )
    apart = "probably frames are further apart (check time_s and [traffic] time_step_s)"
    units = [unit for unit, factor in UNITS.items() if _USUAL_M_S[0] <= usual * factor <= _USUAL_M_S[1]]
    of_table = bool(units) and format_of(recording.source) == "table"
    return f"{seen}; {apart}" + (f", or x_m and y_m are in {' or '.join(units)}" if of_table else "")


_MOST_REPEATED = 0.05  # share of rows
_JUMP_M, _MOST_JUMPING = 20.0, 0.05  # between two rows of a vehicle, with a speed that none has; share of vehicles
_FEWEST_TOGETHER = 5  # vehicles
_MOST_OF_FRAMES = 0.05  # in more it is no event
_ASIDE_M, _AHEAD_M = 1.5, 5.0  # that all have jumped together, in steps of at most 2 s and 1 s


def tracks(recording: Recording, sample: Recording, ways: Ways, scenario: Scenario) -> str | None:
    """Vehicles that are in two places at once or jump, each by itself or all together."""
    report = recording.report
    if report.repeated > max(_MOST_REPEATED * report.rows_read, FEWEST):
        return (
            f"{report.repeated:,} of {report.rows_read:,} rows are of a vehicle that is elsewhere in the same frame "
            "(usual: none); probably several vehicles have one vehicle_id"
        )
    steps = ways.steps
    if together := _together(steps):
        return together
    far = steps.distance_m > _JUMP_M
    jumps = far & (steps.distance_m > _SPEEDS_M_S[1] * steps.seconds)
    back = far[1:] & far[:-1] & ((steps.moved_m[1:] * steps.moved_m[:-1]).sum(axis=1) < 0.0)
    jumps[1:] |= back & (np.diff(steps.vehicle) == 0) & (np.maximum(steps.seconds[1:], steps.seconds[:-1]) <= 3.0)
    jumping, vehicles = np.unique(steps.vehicle[jumps]), len(np.unique(ways.tracks.vehicle))
    if len(jumping) > max(_MOST_JUMPING * vehicles, _FEWEST_TOGETHER):
        return (
            f"{len(jumping):,} of {vehicles:,} vehicles jump, by {_JUMP_M:g} m and more and faster than any drives, or "
            "there and back (usual: none); probably several vehicles have one vehicle_id, or frames are out of order"
        )
    return None


class _Steps:
    """From one row of a vehicle to its next: distances, seconds, and how far ahead and aside of its heading [m]."""

    def __init__(self, tracks: Tracks) -> None:
        first = np.flatnonzero(np.diff(tracks.vehicle) == 0)
        moved = tracks.xy[first + 1] - tracks.xy[first]
        turn = within_half_a_turn(tracks.heading_rad[first + 1] - tracks.heading_rad[first])
        heading, self.turn_rad = tracks.heading_rad[first] + 0.5 * turn, turn
        self.vehicle, self.seconds = tracks.vehicle[first], tracks.time_s[first + 1] - tracks.time_s[first]
        self.frame, self.next_frame = tracks.frame[first], tracks.frame[first + 1]
        self.moved_m, self.distance_m = moved, np.hypot(*moved.T)
        self.ahead_m = moved[:, 0] * np.cos(heading) + moved[:, 1] * np.sin(heading)
        self.aside_m = moved[:, 1] * np.cos(heading) - moved[:, 0] * np.sin(heading)


def _together(steps: _Steps) -> str | None:
    """A step in which all vehicles jump alike, as where a camera or an origin has moved."""
    before = np.flatnonzero((np.diff(steps.vehicle) == 0) & (np.maximum(steps.seconds[1:], steps.seconds[:-1]) <= 2.0))
    now = before + 1
    if not len(now):
        return None
    expected = steps.ahead_m[before] / steps.seconds[before] * steps.seconds[now]
    faster = np.where(steps.seconds[now] <= 1.0, steps.ahead_m[now] - expected, 0.0)
    usual = []
    for values in (steps.aside_m[now], faster):
        order = np.lexsort((values, steps.frame[now]))
        frames, start, count = np.unique(steps.frame[now][order], return_index=True, return_counts=True)
        usual.append(values[order][start + count // 2])  # the median of each frame
    aside, ahead = usual
    told = count >= _FEWEST_TOGETHER
    far = np.flatnonzero(told & ((np.abs(aside) > _ASIDE_M) | (np.abs(ahead) > _AHEAD_M)))
    if not len(far) or len(far) > max(_MOST_OF_FRAMES * told.sum(), 2):
        return None
    at = int(far[0])
    next_frame = steps.next_frame[now][steps.frame[now] == frames[at]].min()
    return (
        f"all vehicles jump together by {math.hypot(aside[at], ahead[at]):.1f} m from frame {frames[at]} to "
        f"{next_frame}; probably the camera or the file's origin has moved (make two recordings, each with its "
        "origin_m), or places are rounded coarsely"
    )


_CENTIMETRES = 100
_MOST_AGAIN_LATER = 0.2  # share of places; of real and generated recordings at most a hundredth
_HASHED = np.array([2_654_435_761, 40_503])


def _there_again(recording: Recording) -> str | None:
    """Places to the centimetre that others take again after one and the same time: copies of the same minutes.

    Vehicles that follow each other at even distances take each other's places too, but the leader is still there then.
    A simulation that draws nothing may repeat itself as well.
    """
    place = (np.rint(_CENTIMETRES * recording.centre_m[:, :2]).astype(np.int64) * _HASHED).sum(axis=1)
    kept = np.flatnonzero(place % -(-len(place) // _TRACK_ROWS) == 0)  # of one place all or none
    kept = kept[np.lexsort((recording.frame[kept], place[kept]))]
    place, vehicle = place[kept], recording.vehicle_id[kept]
    arrives = np.append(True, (np.diff(place) != 0) | (np.diff(vehicle) != 0))  # rows of one that stands are one
    kept, place, vehicle = kept[arrives], place[arrives], vehicle[arrives]
    time_s = recording.frame_time_s[np.searchsorted(recording.frames, recording.frame[kept])]
    again = np.flatnonzero(np.diff(place) == 0)
    if len(again) < FEWEST:
        return None
    later = np.rint(_CENTIMETRES * (time_s[again + 1] - time_s[again])).astype(np.int64)
    lags, counts = np.unique(later, return_counts=True)
    lag = lags[counts.argmax()]
    share = counts.max() / len(place)
    alike = again[later == lag]
    if share <= _MOST_AGAIN_LATER or len(np.unique(vehicle[alike])) < _FEWEST_TOGETHER:
        return None
    alike = alike[np.linspace(0, len(alike) - 1, min(len(alike), _PAIRS)).astype(int)]
    frames = recording.frame[kept[alike + 1]].tolist()
    still = [one in recording.vehicles(frame).vehicle_id for one, frame in zip(vehicle[alike], frames, strict=True)]
    if np.mean(still) > _FEW_STILL:
        return None
    return (
        f"{100 * share:.0f} % of the places are taken again to the centimetre {lag / _CENTIMETRES:g} s later, by other "
        "vehicles: if the same minutes are there more than once, what is held out is what was searched"
    )


_FEW_STILL = 0.1  # share
_MOST_TURNING_DEG, _MANY_LOST = 3.0, 0.2
_FEW_MOVE, _FEW_SHARED = 0.05, 0.05  # shares of vehicles
_COME_AGAIN_M, _MOST_AGAIN = -20.0, 0.05  # ahead; share of vehicles


def track_notes(recording: Recording, ways: Ways) -> Iterator[str]:
    """What is suspicious of tracks and may be right, as sentences."""
    steps, vehicles = ways.steps, len(np.unique(ways.tracks.vehicle))
    if len(recording.frames) < 2 or vehicles < 2:
        return
    seen_again = len(np.unique(steps.vehicle))
    if seen_again <= _FEW_SHARED * vehicles:
        yield (
            "next to no vehicle is in more than one frame: frames that are unrelated, or vehicles numbered anew in "
            "each, which then judge what they have chosen"
        )
        return
    if repeats := _there_again(recording):
        yield repeats
    lowest, highest = (_by_vehicle(ways.tracks, how) for how in (np.minimum, np.maximum))
    moved = np.hypot(*(highest - lowest).T) >= _FAR_ENOUGH_M
    if moved.mean() <= _FEW_MOVE:
        yield f"next to no vehicle moves in {np.ptp(recording.frame_time_s):.0f} s: a jam, or a car park?"
    turning = math.degrees(float(np.median(np.abs(steps.turn_rad))))
    if turning > _MOST_TURNING_DEG:
        yield f"headings change by {turning:.0f} degrees from row to row (usual: under 1): are they noise?"
    lost = _lost(ways.tracks, recording.frames)
    if lost > _MANY_LOST:
        yield (
            f"vehicles are missing in {100 * lost:.0f} % of the frames between their first and their last, and hide "
            "nothing there"
        )
    again = len(np.unique(steps.vehicle[steps.ahead_m < _COME_AGAIN_M]))
    if again > max(_MOST_AGAIN * vehicles, 1):
        yield (
            f"{100 * again / vehicles:.0f} % of the vehicles come again from behind: if a vehicle_id is used again for "
            "others, these are missing among those that judge"
        )


def _lost(tracks: Tracks, frames: np.ndarray) -> float:
    """Share of the frames between vehicles' first and last ones in which they are not there."""
    gaps = np.diff(np.searchsorted(frames, tracks.frame))[np.diff(tracks.vehicle) == 0] - 1
    return float(gaps.sum() / (gaps.sum() + len(tracks.frame)))


def _by_vehicle(tracks: Tracks, how: np.ufunc) -> np.ndarray:
    first = np.flatnonzero(np.diff(tracks.vehicle, prepend=-1))
    return how.reduceat(tracks.xy, first, axis=0)


def headings(recording: Recording, sample: Recording, ways: Ways, scenario: Scenario) -> str | None:
    """Headings off the motion: radians, a compass's bearings, mirrored, reversed, or of another axis."""

    def fits(heading: np.ndarray) -> bool:
        return ways.share_astray(heading) < 1 - FITTING and not ways.is_astray(heading)

    if len(ways.seconds) < FEWEST:
        return None
    share, mean = ways.share_astray(ways.heading_rad), abs(ways.mean_astray(ways.heading_rad))
    if share <= _MOST_ASTRAY and not ways.is_astray(ways.heading_rad):
        return _standing_astray(ways.tracks) or _bends_not_followed(ways.tracks)
    settings = scenario.traffic
    placing = Placing(settings.origin_m or (0.0, 0.0), settings.heading_deg or 0.0)
    in_file = within_half_a_turn(ways.heading_rad + math.radians(placing.heading_deg))
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


_STANDS_M_S = 0.5
_FEW = 0.02  # share of the boxes


def _standing_astray(tracks: Tracks) -> str | None:
    """Headings of vehicles that stand, off those with which they came or leave: made of noise, or of nothing."""
    known, _ = held_heading(tracks.vehicle, tracks.velocity, np.nan)
    stands = (tracks.speed_m_s < _STANDS_M_S) & ~np.isnan(known)
    astray = np.abs(within_half_a_turn(tracks.heading_rad - known)[stands]) > ASTRAY_RAD
    if stands.sum() < FEWEST or astray.mean() <= _MOST_ASTRAY or astray.sum() <= _FEW * len(stands):
        return None
    return (
        f"{100 * astray.mean():.0f} % of the boxes that stand point more than 30 degrees off the way they came or go "
        "(usual: none), as no vehicle turns on the spot; probably headings are made from the motion, and are noise or "
        "0 where there is none: keep the last one"
    )


_CELL_M = 20.0
_FAST_M_S = 5.0  # against the noise of positions
_BENDS_ASTRAY_RAD = math.radians(4.0)  # real and generated recordings: at most 1.5 degrees


def _bends_not_followed(tracks: Tracks) -> str | None:
    """Headings that are right in the mean and off the motion place by place, as of one number on a bend."""
    fast = np.flatnonzero(tracks.speed_m_s > _FAST_M_S)
    fast = fast[:: -(-len(fast) // ROWS) or 1]
    velocity, heading = tracks.velocity[fast], tracks.heading_rad[fast]
    astray = np.exp(1j * (np.arctan2(velocity[:, 1], velocity[:, 0]) - heading))
    cell = np.floor(tracks.xy[fast] / _CELL_M)
    eighth = np.rint(heading / (0.25 * math.pi)) % 8
    place = np.unique(np.column_stack([cell, eighth]), axis=0, return_inverse=True)[1].reshape(-1)
    boxes = np.bincount(place)
    mean = np.angle(np.bincount(place, astray.real) + 1j * np.bincount(place, astray.imag))
    told = boxes >= FEWEST
    if not told.any():
        return None
    off = math.sqrt(np.average(np.square(mean[told]), weights=boxes[told]))
    if off <= _BENDS_ASTRAY_RAD:
        return None
    meant = "headings do not follow the road's bends: one direction for all, or that of a chord"
    if (np.abs(np.angle(astray)) > ASTRAY_RAD).mean() > _FEW:
        meant = "headings of some vehicles, such as those of a class, are of another axis"
    return (
        f"place by place vehicles head {math.degrees(off):.0f} degrees off their motion (usual: under 2), though not "
        f"in the mean; probably {meant}"
    )
