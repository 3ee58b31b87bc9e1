"""Rows of one recording put in order: repeats dropped, short gaps filled, long ones found."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

LONGEST_FILLED_GAP_S = 0.5
"""Longer gaps are left open: a car may have changed lanes in between."""


@dataclass(frozen=True, slots=True, eq=False)
class TrackRows:
    """NGSIM rows as they are recorded, in metres.

    Attributes
    ----------
    vehicle_id, frame : ndarray, (n,) int64
    time_ms : ndarray, (n,) float64
        Global_Time [ms].
    local_m : ndarray, (n, 2) float64
        Local_X and Local_Y of the front centre [m].
    size_m : ndarray, (n, 2) float64
        Length and width [m]; 0 where missing.
    v_class : ndarray, (n,) int8
        1 motorcycle, 2 auto, 3 truck.
    lane : ndarray, (n,) int16
    direction : ndarray, (n,) int8
        Bound for: 1 east, 2 north, 3 west, 4 south, where Local_Y runs north; 0 where not recorded, as on freeways.
    """

    vehicle_id: np.ndarray
    frame: np.ndarray
    time_ms: np.ndarray
    local_m: np.ndarray
    size_m: np.ndarray
    v_class: np.ndarray
    lane: np.ndarray
    direction: np.ndarray

    def __len__(self) -> int:
        return len(self.vehicle_id)

    def take(self, which: np.ndarray) -> TrackRows:
        """The rows that a mask or an index array picks."""
        return TrackRows(*(getattr(self, field.name)[which] for field in fields(self)))


def drop_repeats(vehicle_id: np.ndarray, frame: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, int, int]:
    """The first row of every vehicle and frame.

    Parameters
    ----------
    vehicle_id, frame : ndarray, (n,)
    values : ndarray, (n, c)
        What tells an exact duplicate from a contradicting row.

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


def usual_step(vehicle_id: np.ndarray, frame: np.ndarray) -> int:
    """The most frequent distance, in frame numbers, between neighbouring rows of a vehicle; 1 if none has two."""
    steps = np.diff(frame)[np.diff(vehicle_id) == 0]
    if not len(steps):
        return 1
    values, counts = np.unique(steps, return_counts=True)
    return int(values[counts.argmax()])


def fill_gaps(rows: TrackRows, time_step_s: float) -> tuple[TrackRows, np.ndarray]:
    """Interpolate gaps of at most `LONGEST_FILLED_GAP_S` linearly; lane, size and class are those before the gap.

    Parameters
    ----------
    rows : TrackRows
        Sorted by (vehicle_id, frame), without repeats.
    time_step_s : float
        Time between consecutive frame numbers [s].

    Returns
    -------
    rows : TrackRows
        With the new rows in their places.
    added : ndarray, (n,) bool
        Which ones are new.
    """
    step = usual_step(rows.vehicle_id, rows.frame)
    jump = np.diff(rows.frame)
    lost_s = (jump - step) * time_step_s
    short = (lost_s > 0) & (lost_s <= LONGEST_FILLED_GAP_S + 1e-9) & (jump % step == 0)
    short &= np.diff(rows.vehicle_id) == 0
    before = np.flatnonzero(short)
    missing = jump[before] // step - 1
    if not len(before):
        return rows, np.zeros(len(rows), dtype=bool)
    source = np.repeat(before, missing)
    nth = np.arange(len(source)) - np.repeat(np.cumsum(missing) - missing, missing) + 1
    weight = nth / np.repeat(missing + 1, missing)
    added = np.insert(np.zeros(len(rows), dtype=bool), source + 1, True)
    filled = rows.take(np.insert(np.arange(len(rows)), source + 1, source))
    filled.frame[added] += nth * step
    filled.time_ms[added] += weight * np.diff(rows.time_ms)[source]
    filled.local_m[added] += weight[:, None] * np.diff(rows.local_m, axis=0)[source]
    return filled, added


def segments(vehicle_id: np.ndarray, frame: np.ndarray, time_step_s: float) -> tuple[np.ndarray, int]:
    """Number the unbroken stretches of the tracks.

    Parameters
    ----------
    vehicle_id, frame : ndarray, (n,)
        Sorted by (vehicle_id, frame).
    time_step_s : float
        Time between consecutive frame numbers [s].

    Returns
    -------
    segment : ndarray, (n,) int64
        From 0, ascending; a new one starts with every vehicle and after every gap of more than
        `LONGEST_FILLED_GAP_S`.
    split : int
        Gaps that the recording itself does not have: other vehicles were seen in the meantime.
    """
    other = np.diff(vehicle_id) != 0
    lost_s = (np.diff(frame) - usual_step(vehicle_id, frame)) * time_step_s
    gap = ~other & (lost_s > LONGEST_FILLED_GAP_S + 1e-9)
    segment = np.concatenate([[0], np.cumsum(other | gap)])
    frames = np.unique(frame)
    skipped = np.diff(np.searchsorted(frames, frame))
    return segment, int((gap & (skipped > 1)).sum())
