"""Which way vehicles point, from where they have been: NGSIM records no heading.

Local straight-line fits over a moving window, as a Savitzky-Golay filter of 3.1 s; a speed gate below which a heading
is held; a limit against the tracker's lateral wander.
"""

from __future__ import annotations

import numpy as np

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
        Unbroken stretch of track that each row belongs to, ascending; nothing is fitted across two.
    time_s : ndarray, (n,)
        Ascending within a segment [s]; spacing may vary.
    position_m : ndarray, (n, 2)

    Returns
    -------
    ndarray, (n, 2)
        [m/s]; NaN where the window holds fewer than two times.
    """
    # Sums over windows are differences of running sums; counting from each segment's start keeps them exact.
    start = np.searchsorted(segment, segment)
    t = time_s - time_s[start]
    p = position_m - position_m[start]
    half = WINDOW_S / 2 + 1e-6
    key = segment * (t.max() + 4 * half) + t
    low = np.searchsorted(key, key - half, side="left")
    high = np.searchsorted(key, key + half, side="right")

    def window_sum(values: np.ndarray) -> np.ndarray:
        running = np.concatenate([[0.0], np.cumsum(values)])
        return running[high] - running[low]

    n = high - low
    sum_t = window_sum(t)
    spread = window_sum(t * t) - sum_t**2 / n
    spread[(n < 2) | (spread < 1e-6)] = np.nan
    slopes = [(window_sum(t * axis) - sum_t * window_sum(axis) / n) / spread for axis in p.T]
    return np.stack(slopes, axis=1)


def held_heading(
    vehicle_id: np.ndarray, velocity: np.ndarray, at_rest_rad: np.ndarray | float = 0.0
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

    Returns
    -------
    heading_rad : ndarray, (n,)
    held : ndarray, (n,) bool
        Where it is not the heading of the row's own motion.
    """
    n = len(vehicle_id)
    rows = np.arange(n)
    moving = np.hypot(velocity[:, 0], velocity[:, 1]) >= SLOWEST_M_S
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
    if not len(changed):
        return np.zeros(len(lane), dtype=bool)
    # Both rows of a change count, as it lies somewhere between them.
    events = np.zeros(len(lane))
    events[changed] = events[changed + 1] = 1
    start = np.searchsorted(vehicle_id, vehicle_id)
    t = time_s - time_s[start]
    key = (np.concatenate([[0], np.cumsum(~same)])) * (t.max() + 4 * LANE_CHANGE_S) + t
    running = np.concatenate([[0.0], np.cumsum(events)])
    low = np.searchsorted(key, key - LANE_CHANGE_S - 1e-6, side="left")
    high = np.searchsorted(key, key + LANE_CHANGE_S + 1e-6, side="right")
    return running[high] > running[low]


def limited(heading_rad: np.ndarray, changing: np.ndarray) -> np.ndarray:
    """Headings kept within 6 degrees of the road, 15 where a lane change explains more, (n,) [rad].

    For roads whose x axis follows the direction of travel; a vehicle that moves backwards is taken for a
    tracker's error and limited too.
    """
    limit = np.where(changing, LANE_CHANGE_LIMIT_RAD, LIMIT_RAD)
    return np.clip(heading_rad, -limit, limit)
