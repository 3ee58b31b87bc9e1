"""The cycle of a traffic signal, found in the traffic: autocorrelation of the vehicles that stand in a region."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from .boxes import Boxes
from .vehicles import Recording

_STILL_M_S = 1.0
_FINEST_S, _COARSEST_S = 1.0, 10.0  # between two looks; coarser ones take a multiple of a cycle for it
_SHORTEST_S, _LONGEST_S, LONG_S = 30.0, 180.0, 120.0  # cycles of signals; few are longer than the last
FEWEST_CYCLES = 4
_CORRELATION = 0.42  # jams reach 0.41, cycles made by SUMO 0.67: docs/evidence/intervals.md
_OFF = 0.1  # of a lag: how far a peak may lie off
_QUEUE = 3  # vehicles


def signal_cycle_s(
    recording: Recording, frames: np.ndarray, holds: Callable[[Boxes], np.ndarray]
) -> tuple[float | None, bool]:
    """The cycle of the signal that holds up the traffic of a region, and whether queues come and go there at all.

    Whether vehicles stand is looked at for each quarter of the circle that they head to, as the arms of a crossing
    stand in turn. A signal brings queues back after one, two and three cycles, the waves of a jam keep no such time.

    Parameters
    ----------
    recording : Recording
    frames : ndarray, (f,) int64
        Those that are looked at, ascending.
    holds : callable
        Marks the vehicles of a frame that are in the region.

    Returns
    -------
    cycle_s : float or None
        Length of a cycle [s]; None where there is none, or the recording is shorter than four.
    queues : bool
    """
    time_s, standing = _standing(recording, frames, holds)
    low, high = np.quantile(standing, [0.1, 0.9], axis=0)
    queues = bool(((high >= _QUEUE) & (3.0 * low <= high)).any())
    step_s = float(np.median(np.diff(time_s))) if len(time_s) > 1 else np.inf
    if step_s > _COARSEST_S or not standing.any():
        return None, queues
    evenly = np.arange(time_s[0], time_s[-1] + 0.5 * step_s, step_s)
    alike = _autocorrelation(np.stack([np.interp(evenly, time_s, column) for column in (standing.T > 0)]))
    longest_s = min(_LONGEST_S, len(evenly) * step_s / FEWEST_CYCLES)
    found = []
    for lag in range(int(np.ceil(_SHORTEST_S / step_s)), int(longest_s / step_s) + 1):
        second = _peak(alike, 2.0 * lag)
        third = _peak(alike, 1.5 * second)
        if _peak(alike, lag) == lag and alike[[lag, second, third]].min() >= _CORRELATION:
            found.append((alike[lag], step_s * third / 3.0))
    highest = max(found, default=(0.0,))[0]
    return next((cycle_s for height, cycle_s in found if height >= 0.8 * highest), None), queues  # two are as high


def _standing(recording, frames, holds) -> tuple[np.ndarray, np.ndarray]:
    """Times that are a second apart at least (t,) [s], and the vehicles that stand there, by quarter, (t, 4)."""
    time_s = recording.frame_time_s[np.searchsorted(recording.frames, frames)]
    _, first = np.unique((time_s - time_s[0] + 1e-6) // _FINEST_S, return_index=True)
    still, before = np.zeros(len(recording), dtype=bool), None
    for frame in frames[first]:
        now, begins = recording.at(frame), np.searchsorted(recording.frame, frame)
        if before is not None:
            at = before.rows_of(now.vehicle_id)
            moved_m = np.hypot(*(now.centre_m - before.centre_m[at])[:, :2].T)
            stands = (at >= 0) & (moved_m <= _STILL_M_S * (now.time_s - before.time_s))
            still[begins : begins + len(now)] = stands
        before = now
    standing, part = np.zeros((len(first), 4)), recording.select(still) if still.any() else None
    if part is not None:
        part = part.select(holds(part))
        quarter = np.round(part.heading_rad / (0.5 * np.pi)).astype(int) % 4
        np.add.at(standing, (np.searchsorted(frames[first], part.frame), quarter), 1)
    return time_s[first], standing


def _autocorrelation(series: np.ndarray) -> np.ndarray:
    """Autocorrelation of several series (k, n) together, by the fast Fourier transform: for each lag, (n,)."""
    n = series.shape[1]
    power = np.abs(np.fft.rfft(series - series.mean(axis=1, keepdims=True), 2 * n)) ** 2
    covariance = np.fft.irfft(power.sum(axis=0))[:n] / (n - np.arange(n))
    return covariance / covariance[0] if covariance[0] > 0.0 else covariance


def _peak(alike: np.ndarray, near: float) -> int:
    """The lag of the highest correlation within a tenth of a lag."""
    start = max(1, round((1.0 - _OFF) * near))
    return start + int(np.argmax(alike[start : round((1.0 + _OFF) * near) + 1]))
