"""What recordings lack or say badly: headings (Savitzky-Golay), ids, repeated rows, vehicle sizes and heights."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from ..csv_header import listed
from ..csv_tables import EMPTY, Rows
from ..errors import InputError
from .vehicles import CLASSES, FLEET_KINDS, HEIGHTS_M, VAN_LONGER_THAN_M, fleet_kind

# --- Which way vehicles point, from where they have been: NGSIM records no heading ------------------------
# Local straight-line fits over a moving window, as a Savitzky-Golay filter of 3.1 s; a speed gate below which a
# heading is held; a limit against the tracker's lateral wander.

WINDOW_S = 3.1
SLOWEST_M_S = 2.0
"""Below this speed, steps of the size of the position noise would turn a vehicle anywhere."""
LIMIT_RAD = np.radians(6.0)
LANE_CHANGE_LIMIT_RAD = np.radians(15.0)
LANE_CHANGE_S = 3.0
"""Time before and after the change of lane number during which the wider limit holds."""


def fitted_velocity(segment: np.ndarray, time_s: np.ndarray, position_m: np.ndarray) -> np.ndarray:
    """Velocity by a least-squares straight line through all positions within half a window of each row.

    Over a window that is symmetric about the row, this is also the slope of the quadratic Savitzky-Golay filter; where
    a track begins or ends, the line is the steadier of the two.

    Parameters
    ----------
    segment : ndarray, (n,) int
        Track that each row belongs to, ascending; nothing is fitted across two.
    time_s : ndarray, (n,)
        Ascending within a segment [s]; spacing may vary.
    position_m : ndarray, (n, 2)

    Returns
    -------
    ndarray, (n, 2)
        [m/s]; NaN where the window holds fewer than two times.
    """
    t, window_sum = _windows(segment, time_s, WINDOW_S / 2)
    p = position_m - position_m[np.searchsorted(segment, segment)]
    n, sum_t = window_sum(np.ones(len(t))), window_sum(t)
    spread = window_sum(t * t) - sum_t**2 / n
    spread[(n < 2) | (spread < 1e-6)] = np.nan
    slopes = [(window_sum(t * axis) - sum_t * window_sum(axis) / n) / spread for axis in p.T]
    return np.stack(slopes, axis=1)


def central_velocity(vehicle: np.ndarray, time_s: np.ndarray, position_m: np.ndarray) -> np.ndarray:
    """Velocity by central differences over about two seconds, however far apart frames are.

    Parameters
    ----------
    vehicle : ndarray, (n,) int
        Ascending from 0.
    time_s : ndarray, (n,)
        From 0, ascending for each vehicle [s].
    position_m : ndarray, (n, 2)

    Returns
    -------
    ndarray, (n, 2)
        [m/s]; NaN for a vehicle that is in one frame only.
    """
    steps_s = np.diff(time_s)[np.diff(vehicle) == 0]
    half_s = max(1.0, 1.01 * float(np.median(steps_s))) if len(steps_s) else 1.0
    key = vehicle * (time_s.max() + 4.0 * half_s) + time_s
    first = np.searchsorted(key, key - half_s - 1e-6, side="left")
    last = np.searchsorted(key, key + half_s + 1e-6, side="right") - 1
    with np.errstate(invalid="ignore", divide="ignore"):
        return (position_m[last] - position_m[first]) / (time_s[last] - time_s[first])[:, None]


def _windows(
    group: np.ndarray, time_s: np.ndarray, half_s: float
) -> tuple[np.ndarray, Callable[[np.ndarray], np.ndarray]]:
    """Times from the start of each row's group, ascending, (n,) [s], and a function that sums over moving windows.

    It takes and gives a value a row: the sum over the rows of the same group at most `half_s` before or after. Sums are
    differences of running sums; counting from each group's start keeps them exact.
    """
    half_s += 1e-6
    t = time_s - time_s[np.searchsorted(group, group)]
    key = group * (t.max() + 4 * half_s) + t
    low = np.searchsorted(key, key - half_s, side="left")
    high = np.searchsorted(key, key + half_s, side="right")

    def window_sum(values: np.ndarray) -> np.ndarray:
        running = np.concatenate([[0.0], np.cumsum(values)])
        return running[high] - running[low]

    return t, window_sum


def held_heading(
    vehicle_id: np.ndarray,
    velocity: np.ndarray,
    at_rest_rad: np.ndarray | float = 0.0,
    slowest_m_s: np.ndarray | float = SLOWEST_M_S,
) -> tuple[np.ndarray, np.ndarray]:
    """Heading of motion where it is fast enough; else the vehicle's last one, else its next one, else `at_rest_rad`.

    Parameters
    ----------
    vehicle_id : ndarray, (n,)
        Rows of a vehicle are neighbours, in order of time.
    velocity : ndarray, (n, 2)
        [m/s]; NaN where unknown.
    at_rest_rad : float or ndarray, (n,)
        Headings of vehicles that are never fast enough [rad]; the road's if left out.
    slowest_m_s : float or ndarray, (n,)
        From which speed on motion tells a heading [m/s].

    Returns
    -------
    heading_rad : ndarray, (n,)
    held : ndarray, (n,) bool
        Where it is not the heading of the row's own motion.
    """
    n = len(vehicle_id)
    rows = np.arange(n)
    moving = np.hypot(velocity[:, 0], velocity[:, 1]) >= slowest_m_s
    last = np.maximum.accumulate(np.where(moving, rows, -1))
    following = np.minimum.accumulate(np.where(moving, rows, n)[::-1])[::-1]
    heading = np.array(np.broadcast_to(at_rest_rad, n), dtype=np.float64)
    open_rows = np.ones(n, dtype=bool)
    for source, known in ((last, last >= 0), (following, following < n)):
        at = np.where(known, source, 0)
        take = open_rows & known & (vehicle_id[at] == vehicle_id)
        heading[take] = np.arctan2(velocity[at[take], 1], velocity[at[take], 0])
        open_rows &= ~take
    return heading, ~moving


def lane_changing(vehicle_id: np.ndarray, time_s: np.ndarray, lane: np.ndarray) -> np.ndarray:
    """Rows within `LANE_CHANGE_S` of a change of lane number, (n,) bool; rows as in `held_heading`."""
    same = np.diff(vehicle_id) == 0
    changed = np.flatnonzero(same & (np.diff(lane) != 0))
    # Both rows of a change count, as it lies somewhere between them.
    events = np.zeros(len(lane))
    events[changed] = events[changed + 1] = 1
    number = np.concatenate([[0], np.cumsum(~same)])  # ids may be too large to be multiplied with times
    _, window_sum = _windows(number, time_s, LANE_CHANGE_S)
    return window_sum(events) > 0


def limited(heading_rad: np.ndarray, changing: np.ndarray) -> np.ndarray:
    """Headings kept within 6 degrees of the road, 15 where a lane change explains more, (n,) [rad].

    For roads whose x axis follows the direction of travel; a vehicle that moves backwards is taken for a
    tracker's error and limited too.
    """
    limit = np.where(changing, LANE_CHANGE_LIMIT_RAD, LIMIT_RAD)
    return np.clip(heading_rad, -limit, limit)


# --- Rows of one recording: vehicles by number, in order, without repeats ----------------------------------

NUMBERED = "vehicles are numbered from 0 by first appearance"
_GARBLED = "\ufffd"  # in place of what is not in the encoding of the rest
_WHOLE = re.compile(r"(?:0|[1-9][0-9]{0,14})(?:\.0*)?")  # below 2**53; with a point, as spreadsheets write them


def vehicle_ids(rows: Rows, name: str, index: dict[str, int]) -> np.ndarray:
    """`Rows.codes` of a column of vehicles' ids.

    Raises
    ------
    InputError
        For the first row without one, or where the file's encoding garbles it.
    """
    found = rows.codes(name, index)
    for text in (*EMPTY, *(text for text in index if _GARBLED in text or text.strip().lower() in ("", "nan"))):
        if text in index and (row := np.flatnonzero(found == index[text])).size:
            encoding = "is in another encoding than the file's beginning; save it as UTF-8"
            raise InputError(f"{rows.where(row[0])}: {name} {encoding if _GARBLED in text else 'is missing'}")
    return found


def vehicle_numbers(names: Sequence[str]) -> tuple[np.ndarray, list[str]]:
    """The number of each vehicle, (n,) int64, by what the file calls them: their own where all are whole, from 0 on.

    Else they count from 0 by first appearance, and a note says so.
    """
    if all(_WHOLE.fullmatch(name.strip()) for name in names):
        return np.array([float(name) for name in names]).astype(np.int64), []
    return np.arange(len(names)), [f"{NUMBERED}: {listed(names)}"]


def drop_repeats(vehicle_id: np.ndarray, frame: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, int, int]:
    """The first row of every vehicle and frame.

    Parameters
    ----------
    vehicle_id, frame : ndarray, (n,)
    values : ndarray, (n, c)
        What distinguishes an exact duplicate from a contradicting row.

    Returns
    -------
    rows : ndarray, (m,) int64
        Indices of the rows kept, in order of (vehicle_id, frame).
    duplicates, repeated : int
        Rows dropped with the same values as the one kept, and with others.
    """
    order = np.lexsort((frame, vehicle_id))
    again = np.zeros(len(order), dtype=bool)
    again[1:] = (np.diff(vehicle_id[order]) == 0) & (np.diff(frame[order]) == 0)
    if not again.any():
        return order, 0, 0
    first = np.maximum.accumulate(np.where(again, 0, np.arange(len(order))))
    dropped = np.flatnonzero(again)
    exact = (values[order[dropped]] == values[order[first[dropped]]]).all(axis=1)
    return order[~again], int(exact.sum()), int((~exact).sum())


# --- Classes, sizes and heights of NGSIM vehicles, which are measured from video blobs and have no height -

_CLASS_INDEX = np.array([0, *map(CLASSES.index, ("motorcycle", "car", "truck"))], dtype=np.int8)
"""By v_Class: 1 motorcycle, 2 auto, 3 truck."""
_PLAUSIBLE_M = {
    1: ((1.6, 2.8, 2.1), (0.5, 1.0, 0.8)),
    2: ((2.5, 7.0, 4.5), (1.3, 2.6, 2.05)),
    3: ((5.0, 25.0, 12.7), (1.8, 2.6, 2.59)),
}
"""Least, largest and default length, and the same of width, by v_Class: percentiles of I-80's and US-101's vehicles."""


def repaired_sizes(v_class: np.ndarray, size_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Lengths and widths brought into their class's range; missing ones (0) become its default.

    Parameters
    ----------
    v_class : ndarray, (n,) int
        1 motorcycle, 2 auto, 3 truck.
    size_m : ndarray, (n, 2)
        Length and width [m].

    Returns
    -------
    size_m : ndarray, (n, 2)
    changed : ndarray, (n,) bool
    """
    repaired = size_m.copy()
    for number, limits in _PLAUSIBLE_M.items():
        rows = v_class == number
        for column, (low, high, default) in enumerate(limits):
            given = size_m[rows, column]
            repaired[rows, column] = np.where(given > 0, np.clip(given, low, high), default)
    # Motorcycle blobs are inflated to about 1.55 m: anything wider than a motorcycle becomes the default.
    _, high, default = _PLAUSIBLE_M[1][1]
    repaired[(v_class == 1) & (size_m[:, 1] > high), 1] = default
    return repaired, (repaired != size_m).any(axis=1)


def class_index(v_class: np.ndarray, length_m: np.ndarray) -> np.ndarray:
    """Index into `CLASSES`, (n,) int8, from NGSIM's three classes and the lengths [m]: long autos are vans."""
    index = _CLASS_INDEX[v_class]
    index[(v_class == 2) & (length_m > VAN_LONGER_THAN_M)] = CLASSES.index("van")
    return index


def heights(index: np.ndarray, length_m: np.ndarray, height_m: Mapping[str, float] | None = None) -> np.ndarray:
    """Heights [m], (n,), from indices into `CLASSES` and lengths [m]; `height_m` replaces those of `HEIGHTS_M`."""
    table = {**HEIGHTS_M, **(height_m or {})}
    return np.array([table[kind] for kind in FLEET_KINDS])[fleet_kind(index, length_m)]


def medians_of(values: np.ndarray, of: np.ndarray) -> np.ndarray:
    """Grouped median: that of the values (n,) of each group, numbered from 0 without gaps; the lower of two middles."""
    counts = np.bincount(of)
    return values[np.lexsort((values, of))[np.cumsum(counts) - counts + (counts - 1) // 2]]
