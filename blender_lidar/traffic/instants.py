"""Which frames of a recording are fit to be analysed."""

from __future__ import annotations

import numpy as np

from .vehicles import Recording

_POPULATED_SHARE = 0.5
_PAUSE_OVER_SPACING = 3.0


def well_populated_frames(recording: Recording, frames: np.ndarray | None = None) -> np.ndarray:
    """Frame numbers, (m,) int64, without the thin ends; of `frames`, ascending, or else of all.

    A recording that holds complete passages only is thin for the first and last minute or so. Frames are skipped from
    either end until one has at least half the median number of vehicles.
    """
    frames = recording.frames if frames is None else frames
    counts = recording.counts[np.searchsorted(recording.frames, frames)]
    enough = np.flatnonzero(counts >= _POPULATED_SHARE * np.median(counts))
    return frames[enough[0] : enough[-1] + 1]


def instants(recording: Recording) -> np.ndarray:
    """Frame numbers, (m,) int64, without those that are there for their neighbours' headings only.

    Where frames come in clusters of one odd size, each shorter than the pauses between them, those are the middle ones
    (t - 0.5 s, **t**, t + 0.5 s, every 10 s); else all. A pause is more than three times the closest spacing.
    """
    frames, time_s = recording.frames, recording.frame_time_s
    spacing = np.diff(time_s)
    if not len(spacing):
        return frames
    pauses = np.flatnonzero(spacing > _PAUSE_OVER_SPACING * spacing.min())
    first = np.concatenate([[0], pauses + 1])
    last = np.concatenate([pauses, [len(frames) - 1]])
    size = last - first + 1
    clustered = len(pauses) and size[0] > 1 and size[0] % 2 == 1 and (size == size[0]).all()
    if not clustered or (time_s[last] - time_s[first]).max() >= spacing[pauses].min():
        return frames
    return frames[first + size[0] // 2]
