"""Choosing the frames that a mounting is searched on and the later ones that judge it, of one recording or several."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, fields
from itertools import accumulate

import numpy as np

from ..errors import InputError
from ..statistics import FEWEST_BLOCKS
from .boxes import Boxes
from .cycle import FEWEST_CYCLES, LONG_S, signal_cycle_s
from .vehicles import DIMENSIONS, Recording, RepairReport, counted, unknown_frame

# --- Which frames of a recording are fit to be analysed ---------------------------------------------------

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


# --- The choice of frames ---------------------------------------------------------------------------------------------

Holds = Callable[[Boxes | Recording], np.ndarray]
"""Marks the boxes that score, (n,) bool: those inside the region."""

NOTHING_HELD_OUT = "nothing is held out"  # how a note begins that says why
DEFAULT_COUNT = 30
_SHORTEST_BLOCK_S = 5.0
_TRANSIT_PERCENTILE = 95
_FEWEST_HOLDOUT_BLOCKS = 2
_SHORTEST_S = 1e-3
_FEW_VEHICLES = 10  # different ones
_GOLDEN = (5.0**0.5 - 1.0) / 2.0


@dataclass(frozen=True, slots=True, eq=False)
class FramePlan:
    """Frames to search on and frames to judge by, in blocks longer than a transit of the site and a signal's cycle.

    Attributes
    ----------
    search, holdout : ndarray, (k,) and (m,) int64
        Frame numbers, ascending; `holdout` may be empty.
    search_block, holdout_block : ndarray, (k,) and (m,) int64
        Block of each frame, from 0 without gaps; each half counts its own.
    search_recording, holdout_recording : ndarray, (k,) and (m,) int64
        Recording of each frame, counted from 0.
    block_s : float
        Length of a block [s], of several recordings the longest; the last one of each half may be longer.
    searched_ids : ndarray, (j,) int64
        Vehicles that count in any search frame, ascending. What chose a mounting never judges it: leave them out when
        held-out frames are scored.
    notes : tuple of str
        What could not be had, as sentences.
    """

    search: np.ndarray
    holdout: np.ndarray
    search_block: np.ndarray
    holdout_block: np.ndarray
    search_recording: np.ndarray
    holdout_recording: np.ndarray
    block_s: float
    searched_ids: np.ndarray
    notes: tuple[str, ...]


def plan_frames(
    recording: Recording,
    holds: Holds,
    *,
    count: int | None = None,
    ids: Iterable[int] | None = None,
    spacing_s: float | None = None,
    holdout: float = 0.4,
    block_s: float | None = None,
) -> FramePlan:
    """Divide a recording: its first part is searched, a gap of one block is left, the rest is held out.

    Parameters
    ----------
    recording : Recording
    holds : callable
        Marks the vehicles of a frame that score.
    count : int, optional
        Number of search frames, spread evenly; `DEFAULT_COUNT` if nothing else is asked for.
    ids : iterable of int, optional
        The search frames themselves, instead of `count` and `spacing_s`. What is held out then lies after the last of
        them or, if that is too short, before the first.
    spacing_s : float, optional
        Time between search frames [s]; with `count`, that many from the start.
    holdout : float
        Share of the recording's time that is held out, from 0 to 0.9.
    block_s : float, optional
        Length of a block [s]; by default, in whole seconds and at least 5, the 95th percentile of the time that
        vehicles count (of whole stays, or of all that begin or end in the recording, whichever is longer), or the cycle
        of a signal that the traffic shows, if that is longer.

    Raises
    ------
    InputError
        For a frame that the recording does not have, or a spacing or block that is too short.
    """
    ids = None if ids is None else _known_frames(recording, ids)
    for name, value in (("the spacing of frames", spacing_s), ("the length of a block", block_s)):
        if value is not None and not value >= _SHORTEST_S:
            raise InputError(f"{name} is {value} s; at least {_SHORTEST_S:g} is needed")
    whole = instants(recording)
    candidates = _Frames.of(recording, well_populated_frames(recording, whole))
    notes: list[str] = [] if ids is not None else _skipped(recording, whole, candidates)
    cycle_s, queues = signal_cycle_s(recording, candidates.frames, holds)
    if block_s is None:
        block_s, note = _default_block_s(_transit_block_s(recording, candidates, holds), cycle_s)
        notes += note
        if cycle_s is None and queues and candidates.length_s < FEWEST_CYCLES * LONG_S:
            notes.append(
                f"queues come and go, and {candidates.length_s:.0f} s are too short to tell the cycle of a signal: if "
                "there is one, [traffic] block_s should be at least as long, or intervals may be too narrow"
            )
    elif cycle_s is not None and block_s < 0.95 * cycle_s:
        notes.append(f"blocks of {block_s:g} s may make intervals too narrow: the signal's cycle is {cycle_s:.0f} s")
    listed = None if ids is None else _Frames.of(recording, ids, candidates.spacing_s)

    if listed is None:
        searched, rest = _divided(candidates, holdout, block_s)
        search = _spread(searched, count, spacing_s, cycle_s, notes)
    else:
        searched = search = listed
        rest = _beside(searched, candidates, block_s) if holdout else None
    judged = None if rest is None else _judging(rest, search, searched, holdout, block_s, cycle_s)
    pause = _pause(candidates)
    if judged is None and holdout:
        notes.append(f"{NOTHING_HELD_OUT}: {pause or _too_short(candidates, holdout, block_s, listed is not None)}")
    elif pause:
        notes.append(pause)
    none = np.zeros(0, dtype=np.int64)
    return FramePlan(
        search=search.frames,
        holdout=judged.frames if judged else none,
        search_block=_blocks(search, searched, block_s),
        holdout_block=_blocks(judged, rest, block_s) if judged else none,
        search_recording=np.zeros(len(search.frames), dtype=np.int64),
        holdout_recording=np.zeros(len(judged.frames), dtype=np.int64) if judged else none,
        block_s=float(block_s),
        searched_ids=np.unique(_counted_rows(recording, search.frames, holds).vehicle_id),
        notes=tuple(notes),
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Frames:
    """Some frames, their times, and the time from one to the next."""

    frames: np.ndarray
    time_s: np.ndarray
    spacing_s: float

    @classmethod
    def of(cls, recording: Recording, frames: np.ndarray, spacing_s: float | None = None) -> _Frames:
        time_s = recording.frame_time_s[np.searchsorted(recording.frames, frames)]
        if spacing_s is None:
            spacing_s = float(np.median(np.diff(time_s))) if len(frames) > 1 else recording.time_step_s
        return cls(frames, time_s, spacing_s)

    @property
    def length_s(self) -> float:
        """From the first instant to the end of the last, which stands for the time up to the next."""
        return float(self.time_s[-1] - self.time_s[0]) + self.spacing_s if len(self.frames) else 0.0

    def where(self, which: np.ndarray) -> _Frames:
        return _Frames(self.frames[which], self.time_s[which], self.spacing_s)


def _known_frames(recording: Recording, ids: Iterable[int]) -> np.ndarray:
    frames = np.unique(np.array(list(ids), dtype=np.int64))
    for frame in frames[~np.isin(frames, recording.frames)]:
        raise unknown_frame(frame, recording)
    return frames


def _counted_rows(recording: Recording, frames: np.ndarray, holds: Holds) -> Recording:
    """The boxes that count in some frames, frame by frame."""
    part = recording.select(np.isin(recording.frame, frames))
    return part.select(holds(part))


def _transit_block_s(recording: Recording, candidates: _Frames, holds: Holds) -> float:
    """A block longer than most transits: from a vehicle's first counted instant to the end of its last [s]."""
    part = _counted_rows(recording, candidates.frames, holds)
    if not len(part):
        return _SHORTEST_BLOCK_S
    seen, time_s = part.vehicle_id, candidates.time_s[np.searchsorted(candidates.frames, part.frame)]
    entered = time_s[np.unique(seen, return_index=True)[1]]
    left = time_s[::-1][np.unique(seen[::-1], return_index=True)[1]]
    stay_s = left - entered + candidates.spacing_s
    whole = (entered > candidates.time_s[0]) & (left < candidates.time_s[-1])
    parked = (entered == candidates.time_s[0]) & (left == candidates.time_s[-1])  # searched, and so never judging
    kinds = [stays for stays in (stay_s[whole], stay_s[~parked]) if len(stays)] or [stay_s]
    typical = max(np.percentile(stays, _TRANSIT_PERCENTILE) for stays in kinds)
    return max(_SHORTEST_BLOCK_S, float(math.ceil(typical - 1e-6)))


def _default_block_s(transit_s: float, cycle_s: float | None) -> tuple[float, list[str]]:
    """A block longer than a transit and than the cycle of a signal, if there is one, and a note that tells of it."""
    if cycle_s is None:
        return transit_s, []
    block_s = max(transit_s, float(math.ceil(cycle_s)))
    least = f"at least a signal's cycle ({cycle_s:.0f} s, found in the traffic) and a transit ({transit_s:.0f} s)"
    return block_s, [f"blocks of {block_s:.0f} s: {least}"]


def _divided(candidates: _Frames, holdout: float, block_s: float) -> tuple[_Frames, _Frames | None]:
    """The part to search and, unless it would be too short, the part to hold out, one block later."""
    since = candidates.time_s - candidates.time_s[0]
    end = (1 - holdout) * candidates.length_s
    rest = candidates.where(since >= end + block_s - 1e-9)
    if not holdout or not _is_enough(rest, block_s):
        return candidates, None
    return candidates.where(since < end), rest


def _beside(searched: _Frames, candidates: _Frames, block_s: float) -> _Frames | None:
    """What lies at least a block after the given frames, or else before them, if it is long enough."""
    later = candidates.where(candidates.time_s >= searched.time_s[-1] + searched.spacing_s + block_s - 1e-9)
    earlier = candidates.where(candidates.time_s <= searched.time_s[0] - searched.spacing_s - block_s + 1e-9)
    return next((part for part in (later, earlier) if _is_enough(part, block_s)), None)


def _is_enough(part: _Frames, block_s: float) -> bool:
    """Whether some frames are worth holding out: two blocks long, with frames in two."""
    if part.length_s < _FEWEST_HOLDOUT_BLOCKS * block_s:
        return False
    return len(np.unique(_blocks(part, part, block_s))) >= _FEWEST_HOLDOUT_BLOCKS


def _spread(
    part: _Frames, count: int | None, spacing_s: float | None, cycle_s: float | None, notes: list[str]
) -> _Frames:
    """The search frames: evenly by number, or nearest to the multiples of a spacing."""
    if spacing_s is None:
        chosen = _evenly(part, min(count or DEFAULT_COUNT, len(part.frames)), cycle_s)
    else:
        chosen = part.where(_nearest_to_multiples(part.time_s, spacing_s, count))
    if count is not None and len(chosen.frames) < count:
        has = counted(len(chosen.frames), "frame")
        notes.append(f"{has} instead of {count}: the searched part of the recording has no more")
    return chosen


def _nearest_to_multiples(time_s: np.ndarray, spacing_s: float, count: int | None) -> np.ndarray:
    """Places of the times (n,), ascending, that are nearest to one of the first `count` multiples from the first on."""
    if len(time_s) == 1:
        return np.zeros(1, dtype=np.int64)
    target = np.arange(time_s[0], time_s[-1] + 1e-9, spacing_s)[:count]
    after = np.clip(np.searchsorted(time_s, target), 1, len(time_s) - 1)
    is_before = np.abs(time_s[after - 1] - target) <= np.abs(time_s[after] - target)
    return np.unique(np.where(is_before, after - 1, after))


def _evenly(part: _Frames, count: int, cycle_s: float | None) -> _Frames:
    """One frame of each of so many equal parts: its middle one, or with a cycle one that is off it by golden ratios.

    Frames every 30 s would meet a signal of 90 s in three moments of its cycle alone.
    """
    place = np.arange(count) * _GOLDEN % 1.0 if cycle_s and 2 * count <= len(part.frames) else 0.5
    return part.where(((np.arange(count) + place) * len(part.frames) / count).astype(int))


def _judging(
    rest: _Frames, search: _Frames, searched: _Frames, holdout: float, block_s: float, cycle_s: float | None
) -> _Frames | None:
    """Held-out frames as far apart as the search frames, at least one a block; none if they fill a single block."""
    spacing_s = searched.length_s / len(search.frames)
    share = math.ceil(len(search.frames) * holdout / (1 - holdout))
    count = max(int(rest.length_s // block_s), min(round(rest.length_s / spacing_s), share))
    judged = _evenly(rest, min(count, len(rest.frames)), cycle_s)
    return judged if len(np.unique(_blocks(judged, rest, block_s))) >= _FEWEST_HOLDOUT_BLOCKS else None


def _blocks(chosen: _Frames, part: _Frames, block_s: float) -> np.ndarray:
    """Block of each chosen frame within its part, from 0 without gaps; what is left over joins the last one."""
    last = max(int((part.length_s + 1e-9) // block_s) - 1, 0)
    number = np.minimum((chosen.time_s - part.time_s[0] + 1e-9) // block_s, last)
    return np.unique(number, return_inverse=True)[1].reshape(-1).astype(np.int64)


def _skipped(recording: Recording, whole: np.ndarray, candidates: _Frames) -> list[str]:
    time_s = _Frames.of(recording, whole).time_s
    ends = {"first": candidates.time_s[0] - time_s[0], "last": time_s[-1] - candidates.time_s[-1]}
    lines = [f"the {end} {seconds:{'.0f' if seconds >= 1.0 else '.3g'}} s" for end, seconds in ends.items() if seconds]
    if not lines:
        return []
    return [f"{' and '.join(lines)} are skipped: less than half the median traffic"]


_LONG_PAUSE = 0.5  # share of a recording
_PAUSE_OVER_MEDIAN = 10.0


def _pause(candidates: _Frames) -> str | None:
    """A note of one pause that is most of a recording, as of a wrong date; it is divided by time."""
    since = np.diff(candidates.time_s)
    if len(since) < 2 or since.max() <= max(_LONG_PAUSE * candidates.length_s, _PAUSE_OVER_MEDIAN * np.median(since)):
        return None
    at = int(since.argmax())
    before, after = candidates.frames[at : at + 2]
    first = f"{counted(at + 1, 'frame')} (frame {before})"
    return (
        f"{since[at]:.0f} of the recording's {candidates.length_s:.0f} s are one pause, after {first} and before "
        f"{len(since) - at} ({after}), and it is divided by time: put wrong times right, leave one side out, or make "
        "two recordings, [[traffic]]"
    )


def few_vehicles(searched: int, judging: int | None) -> str | None:
    """A note where an answer may be chance, as so few different vehicles are searched, or judge; else None.

    `judging` is None where nothing is held out.
    """
    if min(searched, searched if judging is None else judging) >= _FEW_VEHICLES:
        return None
    held = "" if judging is None else f" and {judging} in the held-out ones"
    few = f"with fewer than {_FEW_VEHICLES} an answer may be chance"
    return f"few different vehicles: {searched} in the searched frames{held}; {few}"


def _too_short(candidates: _Frames, holdout: float, block_s: float, listed: bool) -> str:
    """Why nothing is held out, and which settings to change."""
    needed_s = (1 + FEWEST_BLOCKS) * block_s / (1.0 if listed else holdout)
    change = "list fewer frames" if listed else "raise [traffic] holdout"
    return (
        f"the recording has {candidates.length_s:.0f} s, {needed_s:.0f} s"
        f"{' after or before the given frames' if listed else ''} are needed for an interval (blocks of {block_s:.0f} "
        f"s, longer than a transit); {change}, or lower block_s, with intervals that may be too narrow"
    )


# --- Several recordings as one: such as a morning and an evening --------------------------------------------------


def joined_recordings(recordings: Sequence[Recording], names: Sequence[str]) -> Recording:
    """Several recordings as one.

    Frames and vehicles of the second are counted on from a power of ten that no number reaches, of the third from
    twice that: with 10000, frame 12345 is frame 2345 of the second. Each keeps its own time. Negative frame numbers
    are counted on as well: with 100, frame 95 is frame -5 of the second.

    Parameters
    ----------
    recordings : sequence of Recording, r
    names : sequence of str, r
        What notes and warnings call them.

    Raises
    ------
    InputError
        Where the numbers of vehicles are too large to be counted on.
    """
    if len(recordings) == 1:
        return recordings[0]
    step = _steps(recordings)
    if len(recordings) * step["vehicle_id"] > _LARGEST_NUMBER:
        largest = max(int(one.vehicle_id.max()) for one in recordings)
        raise InputError(f"{' and '.join(names)}: a vehicle is called {largest}; allowed in several: up to 14 digits")

    def column(name: str) -> np.ndarray:
        return np.concatenate([getattr(one, name) + at * step.get(name, 0) for at, one in enumerate(recordings)])

    return Recording.from_rows(
        **{name: column(name) for name in recordings[0].columns()},
        time_step_s=recordings[0].time_step_s,
        source=" and ".join(one.source for one in recordings),
        report=_joined_reports([one.report for one in recordings], names),
    )


def joined_plans(plans: Sequence[FramePlan], recordings: Sequence[Recording], names: Sequence[str]) -> FramePlan:
    """The plans of several recordings as that of `joined_recordings`; `names` are those of the recordings."""
    if len(plans) == 1:
        return plans[0]
    step = _steps(recordings)

    def counted_on(name: str, by: Iterable[int]) -> np.ndarray:
        return np.concatenate([getattr(plan, name) + number for plan, number in zip(plans, by, strict=True)])

    arrays = {"searched_ids": counted_on("searched_ids", (at * step["vehicle_id"] for at in range(len(plans))))}
    for half in ("search", "holdout"):
        blocks = [len(np.unique(getattr(plan, f"{half}_block"))) for plan in plans]
        arrays[half] = counted_on(half, (at * step["frame"] for at in range(len(plans))))
        arrays[f"{half}_block"] = counted_on(f"{half}_block", accumulate(blocks[:-1], initial=0))
        arrays[f"{half}_recording"] = counted_on(f"{half}_recording", range(len(plans)))
    notes = tuple(f"{name}: {note}" for name, plan in zip(names, plans, strict=True) for note in plan.notes)
    return FramePlan(**arrays, block_s=max(plan.block_s for plan in plans), notes=notes)


_LARGEST_NUMBER = 2**53  # what a float still holds exactly


def _steps(recordings: Sequence[Recording]) -> dict[str, int]:
    """Powers of ten above all numbers of frames and of vehicles, and above their whole range where some are below 0."""
    ends = {name: np.concatenate([getattr(one, name) for one in recordings]) for name in _COUNTED_ON}
    return {name: 10 ** len(str(int(found.max()) - min(int(found.min()), 0))) for name, found in ends.items()}


_COUNTED_ON = ("frame", "vehicle_id")


def _joined_reports(reports: Sequence[RepairReport], names: Sequence[str]) -> RepairReport:
    """What reading several recordings repaired: counts added up, sentences with the name of theirs."""
    named = list(zip(names, reports, strict=True))
    counts = [one.name for one in fields(RepairReport) if isinstance(one.default, int)]
    return RepairReport(
        format=reports[0].format,
        **{count: sum(getattr(report, count) for report in reports) for count in counts},
        notes=tuple(f"{name}: {note}" for name, report in named for note in report.notes),
        assumed=tuple(f"{name}: {text}" for name, report in named for text in report.assumed),
        assumed_sizes=tuple(side for side in DIMENSIONS if any(side in one.assumed_sizes for one in reports)),
        warnings=tuple((what, f"{name}: {text}") for name, report in named for what, text in report.warnings),
    )
