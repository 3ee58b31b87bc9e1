"""How vehicles move: what `plausibility.CHECKS` asks of time steps, ids, headings and tracks."""

from __future__ import annotations

import math
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ..road.road_map import wrap_angle
from ..traffic.tracks import central_velocity, held_heading, medians_of
from ..traffic.vehicles import Recording
from . import usual

if TYPE_CHECKING:
    from .plausibility import Found, LookedAt

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
        time_s = recording.time_s[kept]
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


# --- What each check measures; None where all may be true ---------------------------------------------------------


def speeds(seen: LookedAt, limit: tuple[float, float, float]) -> Found:
    """Speeds that no traffic has: a wrong time step or unit, or new vehicle numbers in each frame."""
    (fastest_median, crawl_m_s, crawl_s), ways = limit, seen.tracks.ways
    if len(ways.seconds) < usual.FEWEST:
        return None
    median, fast = np.quantile(ways.distance_m / ways.seconds, [0.5, 0.9])
    crawls = fast < crawl_m_s and np.ptp(seen.tracks.time_s) > crawl_s
    if not crawls and median <= fastest_median:
        return None
    cause = "a jam crawls" if crawls else "vehicles have new numbers in each frame"
    return {"median": median, "step_s": seen.tracks.step_s, "cause": cause}


def in_two_places(seen: LookedAt, some: float) -> Found:
    """Vehicles that are in two places at once."""
    repeated, rows_read = seen.report.repeated, seen.report.rows_read
    return {"repeated": repeated, "rows_read": rows_read} if repeated > max(some * rows_read, usual.FEWEST) else None


def jumps(seen: LookedAt, limit: tuple[float, float]) -> Found:
    """Vehicles that jump, each by itself."""
    (fastest_m_s, again_s), tracks, steps = limit, seen.tracks, seen.tracks.steps
    far = steps.distance_m > usual.JUMP_M
    jump = far & (steps.distance_m > fastest_m_s * steps.seconds)
    back = far[1:] & far[:-1] & ((steps.moved_m[1:] * steps.moved_m[:-1]).sum(axis=1) < 0.0)
    jump[1:] |= back & _next(tracks) & (np.maximum(steps.seconds[1:], steps.seconds[:-1]) <= again_s)
    jumping = len(np.unique(tracks.vehicle[steps.row[jump]]))
    if jumping <= max(usual.SOME * tracks.vehicles, usual.FEWEST_TOGETHER):
        return None
    return {"jumping": jumping, "vehicles": tracks.vehicles, "metres": usual.JUMP_M}


def _next(tracks: Tracks) -> np.ndarray:
    """Which steps, except for the first, follow one of the same vehicle."""
    return np.diff(tracks.vehicle[tracks.steps.row]) == 0


def jump_together(seen: LookedAt, limit: tuple[float, float, float]) -> Found:
    """A step in which all vehicles jump alike, as where a camera or an origin has moved."""
    (aside_m, ahead_m, together_s), tracks, steps = limit, seen.tracks, seen.tracks.steps
    now = 1 + np.flatnonzero(_next(tracks) & (np.maximum(steps.seconds[1:], steps.seconds[:-1]) <= together_s))
    if not len(now):
        return None
    cos, sin = np.cos(steps.heading_rad), np.sin(steps.heading_rad)
    ahead = steps.moved_m[:, 0] * cos + steps.moved_m[:, 1] * sin
    aside = (steps.moved_m[:, 1] * cos - steps.moved_m[:, 0] * sin)[now]
    faster = ahead[now] - ahead[now - 1] / steps.seconds[now - 1] * steps.seconds[now]
    faster[steps.seconds[now] > 0.5 * together_s] = 0.0
    frames, of = np.unique(tracks.frame[steps.row[now]], return_inverse=True)
    middle = [medians_of(values, of.reshape(-1)) for values in (aside, faster)]
    enough = np.bincount(of.reshape(-1)) >= usual.FEWEST_TOGETHER
    far = np.flatnonzero(enough & ((np.abs(middle[0]) > aside_m) | (np.abs(middle[1]) > ahead_m)))
    if not len(far) or len(far) > max(usual.SOME * enough.sum(), 2):
        return None
    at = far[0]
    later = tracks.frame[steps.later[now]][of.reshape(-1) == at].min()
    return {"metres": math.hypot(middle[0][at], middle[1][at]), "first": frames[at], "later": later}


def headings(seen: LookedAt, limit: tuple[float, float]) -> Found:
    """Headings off the motion: radians, a compass's bearings, mirrored, reversed, or of another axis."""
    (many, off_rad), tracks, ways = limit, seen.tracks, seen.tracks.ways
    if len(ways.seconds) < usual.FEWEST:
        return None
    share, off = ways.share_astray(ways.heading_rad), _off_rad(tracks, ways.heading_rad)
    if share <= many and off <= off_rad:
        return None
    turned_rad = math.radians(seen.scenario.recordings[0].heading_deg or 0.0)
    in_file = wrap_angle(ways.heading_rad + turned_rad)
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
        right = wrap_angle(heading - turned_rad)
        if ways.share_astray(right) < 1.0 - usual.MOST and _off_rad(tracks, right) <= off_rad:
            probably = name
            break
    return {"degrees": math.degrees(off), "share": 100 * share, "probably": probably}


_PLACE_M = 20.0  # within it no street bends by much


def _off_rad(tracks: Tracks, heading_rad: np.ndarray) -> float:
    """How far headings of the ways are off the motion: root mean square of the means place by place, less their noise.

    A place is a square of 20 m and an eighth of the directions; with few boxes all are one place.
    """
    ways = tracks.ways
    astray = np.exp(1j * ways.astray(heading_rad))
    cell = np.floor(tracks.xy[ways.row] / _PLACE_M)
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


def standing_headings(seen: LookedAt, stands_m_s: float) -> Found:
    """Headings of vehicles that stand, off those with which they came or leave: made of noise, or of nothing."""
    tracks = seen.tracks
    velocity = central_velocity(tracks.vehicle, tracks.time_s, tracks.xy)
    known, _ = held_heading(tracks.vehicle, velocity, np.nan)
    stands = (np.hypot(*velocity.T) < stands_m_s) & ~np.isnan(known)
    if len(tracks.ways.seconds) < usual.FEWEST or stands.sum() < usual.FEWEST:
        return None
    astray = np.abs(wrap_angle(tracks.heading_rad - known)[stands]) > usual.ASTRAY_RAD
    if astray.mean() <= usual.MANY or astray.sum() <= usual.FEW * len(stands):
        return None
    return {"share": 100 * astray.mean()}


# --- What is suspicious and may be right --------------------------------------------------------------------------


def _share_followed(tracks: Tracks) -> float:
    """Share of the vehicles that are in a second frame."""
    return len(np.unique(tracks.vehicle[tracks.steps.row])) / max(tracks.vehicles, 1)


def has_tracks(seen: LookedAt) -> bool:
    """Whether there are tracks to look at: two frames, two vehicles, and more of them in a second frame than a few."""
    enough = len(seen.recording.frames) > 1 and seen.tracks.vehicles > 1
    return enough and _share_followed(seen.tracks) > usual.SOME


def unrelated_frames(seen: LookedAt, some: float) -> Found:
    """Frames that have no vehicle in common."""
    enough = len(seen.recording.frames) > 1 and seen.tracks.vehicles > 1
    return {} if enough and _share_followed(seen.tracks) <= some else None


def standing(seen: LookedAt, most: float) -> Found:
    """Vehicles that never move."""
    first = np.flatnonzero(np.diff(seen.tracks.vehicle, prepend=-1))
    extent = np.maximum.reduceat(seen.tracks.xy, first) - np.minimum.reduceat(seen.tracks.xy, first)
    still = (np.hypot(*extent.T) < usual.MOVED_M).mean()
    return {"seconds": np.ptp(seen.recording.frame_time_s)} if still > most else None


def turning(seen: LookedAt, limit_deg: float) -> Found:
    """Headings that change from row to row."""
    degrees = math.degrees(float(np.median(np.abs(seen.tracks.steps.turn_rad))))
    return {"degrees": degrees} if degrees > limit_deg else None


def varying_lengths(seen: LookedAt, limit: float) -> Found:
    """Lengths of one vehicle that vary: their standard deviation beside their mean, in the median."""
    of_row, length = seen.tracks.vehicle, seen.tracks.length_m
    mean = np.bincount(of_row, length) / np.bincount(of_row)
    varying = np.median(np.sqrt(np.bincount(of_row, np.square(length - mean[of_row])) / np.bincount(of_row)) / mean)
    return {"share": 100 * varying} if varying > limit else None


def missing_rows(seen: LookedAt, many: float) -> Found:
    """Frames between a vehicle's first and last that lack it."""
    steps, at = seen.tracks.steps, np.searchsorted(seen.recording.frames, seen.tracks.frame)
    gaps = (at[steps.later] - at[steps.row] - 1).sum()
    missing = gaps / (gaps + len(at))
    return {"share": 100 * missing} if missing > many else None


def again_from_behind(seen: LookedAt, some: float) -> Found:
    """Vehicles that jump back, as where an id is used again."""
    steps = seen.tracks.steps
    ahead = steps.moved_m[:, 0] * np.cos(steps.heading_rad) + steps.moved_m[:, 1] * np.sin(steps.heading_rad)
    again = len(np.unique(seen.tracks.vehicle[steps.row[ahead < -usual.JUMP_M]])) / seen.tracks.vehicles
    return {"share": 100 * again} if again > some else None


def coupled(seen: LookedAt, limit_m: float) -> Found:
    """Articulated lorries as two boxes: pairs that touch from end to end as they drive."""
    recording, touching = seen.recording, {}
    looked = recording.frames[:: -(-len(recording.frames) // _COUPLED_FRAMES)]
    for at, number in enumerate(looked.tolist()):
        vehicles = recording.at(number)
        ahead = vehicles.centre_m[None, :, :2] - vehicles.centre_m[:, None, :2]
        cos, sin = np.cos(vehicles.heading_rad)[:, None], np.sin(vehicles.heading_rad)[:, None]
        along, aside = ahead[..., 0] * cos + ahead[..., 1] * sin, ahead[..., 1] * cos - ahead[..., 0] * sin
        half_m = 0.5 * vehicles.size_m[:, 0]
        gap = along - half_m[:, None] - half_m
        found = (along > 0.0) & (np.abs(gap) <= limit_m) & (np.abs(aside) <= limit_m)
        for one, other in np.argwhere(found).tolist():
            pair = int(vehicles.vehicle_id[one]), int(vehicles.vehicle_id[other])
            touching.setdefault(pair, []).append((at, vehicles.centre_m[one, :2]))
    count = 0
    for places in touching.values():
        (first, start), (last, end) = places[0], places[-1]
        always = len(places) >= max(usual.FEWEST_TOGETHER, usual.MOST * (last - first + 1))
        count += always and math.dist(start, end) >= usual.JUMP_M
    return {"pairs": f"{count:,} {'pair' if count == 1 else 'pairs'}"} if count else None


_COUPLED_FRAMES = 100  # that are looked at
_MIXED = np.array([2_654_435_761, 40_503])  # odd factors, to give each place a number of its own


def copied_minutes(seen: LookedAt, many: float) -> Found:
    """Frames whose boxes stand where an earlier one's stood, to the centimetre, and how much later [s].

    Vehicles that follow each other at even distances do so too, but some of them are in both frames.
    """
    recording = seen.recording
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
    share = len(later_s) / len(looks)
    return {"share": 100 * share, "later_s": float(np.median(later_s))} if share > many else None


_WINDOWS, _WINDOW_S = 8, (7.5, 15.0)  # in a short recording; their lengths, in which 10 cm/s stay in a lane
_CROSSING_RAD = math.radians(15.0)  # off x: lane changes are beyond
_BIN_M, _SMOOTHED_M, _FARTHEST_M = 0.1, 0.3, 1.7  # of densities across the road, and from one to the next


def drift(seen: LookedAt, limit: tuple[float, float]) -> Found:
    """Lanes that move across the road: cross-correlation of where vehicles drive in one window of time and the next.

    A drone's drift of 5 cm/s makes nine lanes of three. A polygon may hold a crossing, and is not looked at.
    """
    if not seen.lies_along_x:
        return None
    (drifted_m, errors), tracks, region = limit, seen.tracks, seen.placed.region
    inside = np.hypot(*(tracks.xy - region.centre_xy).T) <= region.radius_m
    rows = np.flatnonzero(inside & (np.abs(np.sin(tracks.heading_rad)) <= math.sin(_CROSSING_RAD)))
    if region.polygon or not len(rows):
        return None
    since, across = tracks.time_s[rows] - tracks.time_s[rows].min(), tracks.xy[rows, 1]
    window_s = float(np.clip(since.max() / _WINDOWS, *_WINDOW_S))
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
    if len(moved) < _WINDOWS - 2 or abs(sum(moved)) < drifted_m:
        return None
    mean, error = float(np.mean(moved)), float(np.std(moved, ddof=1)) / math.sqrt(len(moved))
    if abs(mean) < errors * max(error, _BIN_M / len(moved)):
        return None
    return {"side": "left" if mean > 0.0 else "right", "cm_s": 100.0 * abs(mean) / window_s}


def bend(seen: LookedAt, sagitta_m: float) -> Found:
    """A road that bends within the region: the sagitta of the vehicles' ways, beside a scene's straight lanes.

    A polygon may hold a crossing, where vehicles turn, and is not looked at.
    """
    if not seen.lies_along_x:
        return None
    tracks, region = seen.tracks, seen.placed.region
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
    return {"degrees": abs(math.degrees(turn)), "aside": aside} if aside > sagitta_m else None
