"""Recall, precision and average precision (AP) of detected boxes, and their intervals over blocks of time.

A detection is a hit where it meets a vehicle that counts and that no surer one has met. One that meets a vehicle which
does not count, or lies outside the region, is neither a hit nor a false alarm.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from ..scene.region import Region
from ..statistics import of_blocks, statistic_interval_90
from ..traffic.boxes import HIT_M, Boxes, bev_iou

CONFIDENCES = (0.1, 0.3)  # at which recall and precision are given, as the paper's Table III has them
MISSED = -1.0  # in place of the confidence of a vehicle's detection


class Criterion(NamedTuple):
    """When a detection meets a vehicle: centres at most so far apart [m], or footprints that overlap as much (IoU)."""

    name: str
    most_m: float | None = None
    least_iou: float | None = None

    def merit(self, boxes: Boxes, vehicles) -> np.ndarray:
        """How well each detection meets each vehicle, (d, v), the higher the better; -inf where it does not."""
        if self.most_m is None:
            iou = bev_iou(boxes, vehicles)
            return np.where(iou >= self.least_iou, iou, -np.inf)
        away = np.linalg.norm(boxes.centre_m[:, None, :2] - vehicles.centre_m[None, :, :2], axis=-1)
        return np.where(away <= self.most_m, -away, -np.inf)


CRITERIA = (
    Criterion("centre_2m", most_m=HIT_M),
    Criterion("iou_0.5", least_iou=0.5),
    Criterion("iou_0.7", least_iou=0.7),  # KITTI's for cars
)


@dataclass(frozen=True, slots=True, eq=False)
class Matches:
    """Detections and vehicles of f frames, matched by one criterion.

    Attributes
    ----------
    frames : int
        How many there are, f.
    confidence, hit : ndarray, (d,)
        Of each detection that is a hit or a false alarm.
    frame : ndarray of int, (d,)
        The frame that it is in, counted from 0.
    distance_m : ndarray, (d,)
        Horizontal distance from the LiDAR, of a hit that of its vehicle [m].
    found : ndarray, (v,)
        Confidence of the detection of each vehicle that counts; `MISSED` where there is none.
    vehicle_frame, vehicle_distance_m : ndarray, (v,)
        The same of the vehicles.
    """

    frames: int
    confidence: np.ndarray
    hit: np.ndarray
    frame: np.ndarray
    distance_m: np.ndarray
    found: np.ndarray
    vehicle_frame: np.ndarray
    vehicle_distance_m: np.ndarray

    def near(self, low_m: float, high_m: float) -> Matches:
        """Those between two distances from the LiDAR, the lower included."""
        return self.select(*((low_m <= d) & (d < high_m) for d in (self.distance_m, self.vehicle_distance_m)))

    def select(self, detections: np.ndarray, vehicles: np.ndarray) -> Matches:
        """Some of the detections and of the vehicles, by masks or by rows."""
        changed = {name: getattr(self, name)[detections] for name in ("confidence", "hit", "frame", "distance_m")}
        of_vehicles = ("found", "vehicle_frame", "vehicle_distance_m")
        return replace(self, **changed, **{name: getattr(self, name)[vehicles] for name in of_vehicles})


def match(
    detected: Sequence[Boxes],
    frames: Sequence[Boxes],
    region: Region,
    lidar_xy: tuple[float, float] | np.ndarray,
    criterion: Criterion,
    kind: int | None = None,
) -> Matches:
    """Match the detections of frames with their vehicles: the surest first, each with the best that is left.

    Parameters
    ----------
    detected : sequence of Boxes, f
    frames : sequence of Boxes, f
    region : Region
        Where a detection that meets nothing is a false alarm.
    lidar_xy : (float, float), or ndarray, (f, 2) or (1, l, 2)
        What distances are counted from [m], of each frame where they differ; of l LiDARs the nearest.
    criterion : Criterion
    kind : int, optional
        Only boxes and vehicles of this kind, as if there were no others: a box on another kind is a false alarm.
    """
    parts, xy = [], np.asarray(lidar_xy, dtype=float)
    lidars = np.repeat(xy, len(frames), axis=0) if xy.ndim == 3 else np.broadcast_to(xy, (len(frames), 2))[:, None]
    for boxes, frame, lidar in zip(detected, frames, lidars, strict=True):
        if kind is not None:
            boxes = boxes.select(boxes.kind == kind)
            frame = frame.select(~frame.counts | (frame.kind == kind))
        parts.append(_matched(boxes, frame, region, lidar, criterion))
    of_frame = np.arange(len(frames))
    detections, found = (
        np.concatenate([np.zeros((0, width)), *(part[side] for part in parts)]) for side, width in enumerate((3, 2))
    )
    return Matches(
        frames=len(frames),
        confidence=detections[:, 0],
        hit=detections[:, 1] > 0.0,
        frame=np.repeat(of_frame, [len(one) for one, _ in parts]),
        distance_m=detections[:, 2],
        found=found[:, 0],
        vehicle_frame=np.repeat(of_frame, [len(other) for _, other in parts]),
        vehicle_distance_m=found[:, 1],
    )


def _matched(boxes: Boxes, vehicles: Boxes, region: Region, lidar_xy, criterion):
    """Of one frame: columns of `Matches` of its detections that count, (d, 3), and of its vehicles that do, (v, 2)."""
    away, distance = (
        np.hypot(*(one.centre_m[:, :2] - lidar_xy[:, None]).transpose(2, 0, 1)).min(axis=0) for one in (boxes, vehicles)
    )
    met, ignored = meetings(boxes, vehicles, region, criterion)
    hit, found = met >= 0, np.full(len(vehicles), MISSED)
    found[met[hit]], away[hit] = boxes.confidence[hit], distance[met[hit]]
    detections = np.column_stack([boxes.confidence, hit, away])[~ignored]
    return detections, np.column_stack([found, distance])[vehicles.counts]


def meetings(boxes: Boxes, vehicles: Boxes, region: Region, criterion: Criterion) -> tuple[np.ndarray, np.ndarray]:
    """Of a frame's detections the vehicle that each is a hit on, (d,), -1 for none, and which do not count, (d,) bool.

    Those that count and are no hit are false alarms. The arguments are as for `match`.
    """
    merit = criterion.merit(boxes, vehicles)
    free, met = vehicles.counts.copy(), np.full(len(boxes), -1)
    ignored = ~region.holds(boxes)
    for row in np.argsort(-boxes.confidence, kind="stable"):
        left = np.where(free, merit[row], -np.inf)
        if left.max(initial=-np.inf) > -np.inf:
            met[row] = left.argmax()
            free[met[row]] = False
        else:
            ignored[row] |= (merit[row][~vehicles.counts] > -np.inf).any()
    return met, ignored & (met < 0)


# --- Recall, precision and average precision --------------------------------------------------------------------------


def recall(matches: Matches, confidence: float, weight: np.ndarray | None = None) -> np.ndarray:
    """Share of the vehicles with a detection at least so sure; NaN where there are none.

    `weight` (r, f) says how often each frame counts in each of r resamples; once if left out. Returns (r,).
    """
    return _share(matches.vehicle_frame, matches.found >= confidence, _of_frames(matches, weight))


def precision(matches: Matches, confidence: float, weight: np.ndarray | None = None) -> np.ndarray:
    """Share of the hits among detections at least so sure, (r,); NaN where there are none; `weight` as for `recall`."""
    sure = matches.confidence >= confidence
    return _share(matches.frame[sure], matches.hit[sure], _of_frames(matches, weight))


def average_precision(matches: Matches, weight: np.ndarray | None = None) -> np.ndarray:
    """AP over all points: the area below precision, made monotone, over recall, (r,); NaN where there are no vehicles.

    Everingham et al. 2010, as PASCAL VOC has it since then. Detections that are equally sure count as one step, so that
    their order does not matter. `weight` as for `recall`.
    """
    weight = _of_frames(matches, weight)
    vehicles = weight @ np.bincount(matches.vehicle_frame, minlength=matches.frames)
    order = np.argsort(-matches.confidence, kind="stable")
    frame, hit = matches.frame[order], matches.hit[order].astype(float)
    last = np.flatnonzero(np.diff(matches.confidence[order], append=-np.inf))  # of those that are equally sure
    area, at_once = np.zeros(len(weight)), max(1, _MOST_AT_ONCE // max(len(order), 1))
    for first in range(0, len(weight), at_once):
        counts = weight[first : first + at_once, frame]
        taken, hits = np.cumsum(counts, axis=1)[:, last], np.cumsum(counts * hit, axis=1)[:, last]
        precise = np.divide(hits, taken, out=np.zeros_like(hits), where=taken > 0.0)
        envelope = np.maximum.accumulate(precise[:, ::-1], axis=1)[:, ::-1]
        area[first : first + at_once] = (np.diff(hits, axis=1, prepend=0.0) * envelope).sum(axis=1)
    return area / np.where(vehicles > 0, vehicles, np.nan)


_MOST_AT_ONCE = 2_000_000  # detections times resamples: memory grows with the detections alone


def _of_frames(matches: Matches, weight: np.ndarray | None) -> np.ndarray:
    return np.ones((1, matches.frames)) if weight is None else weight


def _share(frame: np.ndarray, good: np.ndarray, weight: np.ndarray) -> np.ndarray:
    whole = weight @ np.bincount(frame, minlength=weight.shape[1])
    part = weight @ np.bincount(frame, good, minlength=weight.shape[1])
    return np.divide(part, whole, out=np.full(len(whole), np.nan), where=whole > 0)


# --- All of it, and how sure it is ------------------------------------------------------------------------------------

Measure = Callable[[Sequence[Matches], np.ndarray | None], np.ndarray]
MEASURES: dict[str, Measure] = {  # of the matches by each of `CRITERIA`
    **{f"recall_{at:g}": lambda by, weight, at=at: recall(by[0], at, weight) for at in CONFIDENCES},
    **{f"precision_{at:g}": lambda by, weight, at=at: precision(by[0], at, weight) for at in CONFIDENCES},
    **{
        f"ap_{criterion.name}": lambda by, weight, row=row: average_precision(by[row], weight)
        for row, criterion in enumerate(CRITERIA)
    },
}
"""Recall and precision are by the first criterion, centres at most 2 m apart."""
_RECALLS = tuple(f"recall_{at:g}" for at in CONFIDENCES)
_BAND_M = 10.0  # of distances
_MOST_UNDEFINED = 0.05  # share of resamples in which nothing is to be divided by: with more there is no interval


def measured(by: Sequence[Matches]) -> dict[str, object]:
    """All `MEASURES` for a result file, of the matches by each of `CRITERIA`; None where one is undefined."""
    values = {name: float(measure(by, None)[0]) for name, measure in MEASURES.items()}
    known = {name: None if np.isnan(value) else value for name, value in values.items()}
    false_alarms = {
        f"false_alarms_{at:g}": int((~by[0].hit & (by[0].confidence >= at)).sum()) / max(by[0].frames, 1)
        for at in CONFIDENCES
    }
    return {"vehicles": len(by[0].found), **known, **false_alarms}


def by_distance(by: Sequence[Matches], farthest_m: float) -> dict[str, dict[str, object]]:
    """`measured` in bands of 10 m up to the one that holds a distance."""
    lows = _BAND_M * np.arange(int(farthest_m // _BAND_M) + 1)
    return {
        f"{low:g}-{low + _BAND_M:g} m": measured([one.near(low, low + _BAND_M) for one in by]) for low in lows.tolist()
    }


def by_approach(
    matches: Matches, approach: np.ndarray, block: np.ndarray, seed: int, recording: np.ndarray | None = None
) -> dict[str, dict[str, object]]:
    """Recall of the vehicles of each approach, (v,) str, with 90 % intervals over blocks of time; none of ""."""
    none, found = np.zeros(len(matches.confidence), dtype=bool), {}
    for name in np.unique(approach[approach != ""]).tolist():
        part = matches.select(none, approach == name)
        found[name] = {"vehicles": len(part.found)}
        for key, (value, ends) in _with_intervals(([part],), block, seed, recording, _RECALLS).items():
            found[name] |= {key: value, f"{key}_interval_90": _within_0_and_1(ends)}
    return found


def paired_intervals(
    one: Sequence[Matches], other: Sequence[Matches], block: np.ndarray, seed: int, recording: np.ndarray | None = None
) -> dict[str, dict[str, object]]:
    """How much better `one` is than `other`, for each of `MEASURES`, with the paired 90 % interval over blocks of time.

    A difference of something undefined is None.

    Parameters
    ----------
    one, other : sequence of Matches
        Of the same f frames, by each of `CRITERIA`.
    block, recording : ndarray, (f,)
        Block and recording of each frame.
    seed : int
        For the resampling.
    """
    found = _with_intervals((one, other), block, seed, recording)
    return {name: {"difference": value, "interval_90": ends} for name, (value, ends) in found.items()}


def intervals(
    by: Sequence[Matches], block: np.ndarray, seed: int, recording: np.ndarray | None = None
) -> dict[str, list[float] | None]:
    """The 90 % interval over blocks of time of each of `MEASURES`, as for `paired_intervals`, within 0 and 1."""
    found = _with_intervals((by,), block, seed, recording)
    return {name: _within_0_and_1(ends) for name, (_, ends) in found.items()}


def _within_0_and_1(ends: Sequence[float] | None) -> list[float] | None:
    return None if ends is None else np.clip(ends, 0.0, 1.0).tolist()


def _with_intervals(
    sides: Sequence[Sequence[Matches]],
    block: np.ndarray,
    seed: int,
    recording: np.ndarray | None,
    names: Iterable[str] | None = None,
) -> dict[str, tuple[float | None, list[float] | None]]:
    """Each of `MEASURES`, or of some, of one side, or its difference between two, and the interval."""
    labels, row = np.unique(block, return_inverse=True)
    row = row.reshape(-1)
    sides = [[_of_blocks(matches, row, len(labels)) for matches in side] for side in sides]
    frames = (at for side in sides for matches in side for at in (matches.vehicle_frame, matches.frame))
    filled = np.bincount(np.concatenate([*frames]), minlength=len(labels))  # a block may have false alarms alone
    stratum = None if recording is None else of_blocks(recording, block)
    found = {}
    for name in MEASURES if names is None else names:
        measure = MEASURES[name]
        whole = float(np.subtract.reduce([measure(side, None)[0] for side in sides]))
        if np.isnan(whole):
            found[name] = None, None
            continue
        undefined: list[float] = []

        def statistic(weight, measure=measure, whole=whole, undefined=undefined) -> np.ndarray:
            values = np.subtract.reduce([measure(side, weight) for side in sides])
            undefined.append(np.isnan(values).mean())
            return np.where(np.isnan(values), whole, values)

        ends = statistic_interval_90(statistic, filled, seed, stratum)
        known = ends is not None and max(undefined) <= _MOST_UNDEFINED
        found[name] = whole, list(ends) if known else None
    return found


def _of_blocks(matches: Matches, row: np.ndarray, blocks: int) -> Matches:
    """The same with blocks of time in place of frames."""
    return replace(matches, frames=blocks, frame=row[matches.frame], vehicle_frame=row[matches.vehicle_frame])
