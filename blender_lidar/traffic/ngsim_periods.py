"""The recording periods of an NGSIM file, each of which numbers vehicles and frames from 1 again.

Two of I-80's three even overlap in time, so that a row belongs to the period whose clock its frame number fits:
``Global_Time - step * Frame_ID`` is constant within one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..errors import InputError
from .tracks import TrackRows

SAME_PERIOD_S = 60.0
STEP_LIMITS_MS = (10.0, 60_000.0)
"""Milliseconds per frame number; the recordings have 100."""
_USUAL_STEP_MS = 100.0
# Nominal starts in Pacific Daylight Time; recording began up to 2 min 15 s earlier.
_PACIFIC_H = -7
_NOMINAL_S = {
    "0400-0415": 16 * 3600,
    "0500-0515": 17 * 3600,
    "0515-0530": 17 * 3600 + 15 * 60,
    "0750-0805": 7 * 3600 + 50 * 60,
    "0805-0820": 8 * 3600 + 5 * 60,
    "0820-0835": 8 * 3600 + 20 * 60,
    "0828-0845": 8 * 3600 + 28 * 60,
    "0845-0900": 8 * 3600 + 45 * 60,
}
_NOMINAL_TOLERANCE_S = 180
_FIRST_REAL_TIME_MS = 1e12  # Peachtree's 10-digit times are no times of day


@dataclass(frozen=True, slots=True, eq=False)
class Periods:
    """The periods of a recording, in order of time.

    Attributes
    ----------
    names : tuple of str
        As the recording calls them (``"0400-0415"``); else their number, from ``"1"``.
    of_row : ndarray, (n,) int64
        Each row's period, from 0.
    """

    names: tuple[str, ...]
    of_row: np.ndarray


def time_step_ms(rows: TrackRows, where: str) -> float:
    """Milliseconds per frame number: the median over neighbouring rows of each vehicle; 100 if none has two.

    Raises
    ------
    InputError
        If it is beyond `STEP_LIMITS_MS`; `where` names the file.
    """
    order = np.lexsort((rows.time_ms, rows.vehicle_id))
    frames = np.diff(rows.frame[order])
    usable = (np.diff(rows.vehicle_id[order]) == 0) & (frames != 0)
    if not usable.any():
        return _USUAL_STEP_MS
    step = float(np.median(np.diff(rows.time_ms[order])[usable] / frames[usable]))
    if step <= 0:
        return _USUAL_STEP_MS
    if not STEP_LIMITS_MS[0] <= step <= STEP_LIMITS_MS[1]:
        raise InputError(
            f"{where}: Global_Time grows by {step:g} ms from one Frame_ID to the next; allowed: {STEP_LIMITS_MS[0]:g} "
            f"to {STEP_LIMITS_MS[1]:g}"
        )
    return step


def find_periods(rows: TrackRows, step_ms: float) -> Periods:
    """Group rows whose clocks agree within `SAME_PERIOD_S`."""
    origin_s = np.rint((rows.time_ms - step_ms * rows.frame) / 1000.0)
    distinct, number = np.unique(origin_s, return_inverse=True)
    period = np.concatenate([[0], np.cumsum(np.diff(distinct) > SAME_PERIOD_S)])
    first = distinct[np.searchsorted(period, np.arange(period[-1] + 1))]
    return Periods(_names(first), period[number.reshape(-1)])


def choose_period(periods: Periods, period: int | str | None, where: str) -> int:
    """The number, from 0, of the period asked for by number (from 1) or name; the first if none is.

    Raises
    ------
    InputError
        If there is no such period.
    """
    if period is None:
        return 0
    asked = str(period).strip().replace(":", "")
    if asked in periods.names:
        return periods.names.index(asked)
    if asked.isdecimal() and 1 <= int(asked) <= len(periods.names):
        return int(asked) - 1
    known = ", ".join(
        f"{number}" if name == str(number) else f"{number} ({name})" for number, name in enumerate(periods.names, 1)
    )
    raise InputError(f"{where}: no period {period!r}; the recording has: {known}")


def _names(origin_s: np.ndarray) -> tuple[str, ...]:
    names = [_nominal(origin) or str(number) for number, origin in enumerate(origin_s, start=1)]
    return tuple(name if names.count(name) == 1 else str(number) for number, name in enumerate(names, start=1))


def _nominal(origin_s: float) -> str | None:
    if origin_s * 1000 < _FIRST_REAL_TIME_MS:
        return None
    of_day = (origin_s + _PACIFIC_H * 3600) % 86400
    name = min(_NOMINAL_S, key=lambda known: abs(_NOMINAL_S[known] - of_day))
    return name if abs(_NOMINAL_S[name] - of_day) <= _NOMINAL_TOLERANCE_S else None
