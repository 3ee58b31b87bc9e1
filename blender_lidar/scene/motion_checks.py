"""Checks of motion: wrong time steps and headings, told by the ways that vehicles go."""

from __future__ import annotations

import math
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
    """

    def __init__(self, recording: Recording) -> None:
        of_row = np.unique(recording.vehicle_id, return_inverse=True)[1].reshape(-1)
        kept = np.flatnonzero(of_row % -(-len(of_row) // _TRACK_ROWS) == 0)
        kept = kept[np.lexsort((recording.frame[kept], of_row[kept]))]
        time_s = recording.frame_time_s[np.searchsorted(recording.frames, recording.frame[kept])]
        self.vehicle, self.xy = of_row[kept], recording.centre_m[kept, :2]
        self.heading_rad = recording.heading_rad[kept]
        self.velocity = central_velocity(self.vehicle, time_s - recording.frame_time_s[0], self.xy)
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
_MEAN_ASTRAY_RAD = math.radians(8.0)  # real and generated recordings: at most 0.2 degrees


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
        return f"{seen}, in no direction; probably vehicles are numbered anew in each frame: check vehicle_id"
    apart = "probably frames are further apart (check time_s and [traffic] time_step_s)"
    units = [unit for unit, factor in UNITS.items() if _USUAL_M_S[0] <= usual * factor <= _USUAL_M_S[1]]
    of_table = bool(units) and format_of(recording.source) == "table"
    return f"{seen}; {apart}" + (f", or x_m and y_m are in {' or '.join(units)}" if of_table else "")


def headings(recording: Recording, sample: Recording, ways: Ways, scenario: Scenario) -> str | None:
    """Headings off the motion: radians, a compass's bearings, mirrored, reversed, or of another axis."""

    def fits(heading: np.ndarray) -> bool:
        return ways.share_astray(heading) < 1 - FITTING and abs(ways.mean_astray(heading)) <= _MEAN_ASTRAY_RAD

    if len(ways.seconds) < FEWEST:
        return None
    share, mean = ways.share_astray(ways.heading_rad), abs(ways.mean_astray(ways.heading_rad))
    if share <= _MOST_ASTRAY and mean <= _MEAN_ASTRAY_RAD:
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
    fast = tracks.speed_m_s > _FAST_M_S
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
    return (
        f"place by place vehicles head {math.degrees(off):.0f} degrees off their motion (usual: under 2), though not "
        "in the mean; probably headings do not follow the road's bends: one direction for all, or that of a chord"
    )
