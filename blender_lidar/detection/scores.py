"""Recall, precision and average precision (AP) of detected boxes, and their intervals over blocks of time.

A detection is a hit where it meets a vehicle that counts and that no surer one has met. One that meets a vehicle which
does not count, or lies outside the region, is neither a hit nor a false alarm.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from ..scene.observation import CountedFrame
from ..scene.region import Region
from ..statistics import statistic_interval_90
from .boxes import KINDS, DetectedBoxes, bev_iou, kind_of

CONFIDENCES = (0.1, 0.3)  # at which recall and precision are told, as the paper's Table III has them
MISSED = -1.0  # in place of the confidence of a vehicle's detection


class Criterion(NamedTuple):
    """When a detection meets a vehicle: centres at most so far apart [m], or footprints that overlap as much (IoU)."""

    name: str
    most_m: float | None = None
    least_iou: float | None = None

    def merit(self, boxes: DetectedBoxes, vehicles) -> np.ndarray:
        """How well each detection meets each vehicle, (d, v), the higher the better; -inf where it does not."""
        if self.most_m is None:
            iou = bev_iou(boxes, vehicles)
            return np.where(iou >= self.least_iou, iou, -np.inf)
        away = np.linalg.norm(boxes.centre_m[:, None, :2] - vehicles.centre_m[None, :, :2], axis=-1)
        return np.where(away <= self.most_m, -away, -np.inf)


CRITERIA = (
    Criterion("centre_2m", most_m=2.0),  # nuScenes' second threshold
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
    frame, kind : ndarray of int, (d,)
        The frame that it is in, counted from 0, and what it was taken for.
    distance_m : ndarray, (d,)
        Horizontal distance from the LiDAR, of a hit that of its vehicle [m].
    right : ndarray of bool, (d,)
        Whether a hit was taken for what its vehicle is.
    found : ndarray, (v,)
        Confidence of the detection of each vehicle that counts; `MISSED` where there is none.
    found_right : ndarray of bool, (v,)
        Whether that took it for what it is.
    vehicle_frame, vehicle_kind, vehicle_distance_m : ndarray, (v,)
        The same of the vehicles.
    """

    frames: int
    confidence: np.ndarray
    hit: np.ndarray
    frame: np.ndarray
    kind: np.ndarray
    distance_m: np.ndarray
    right: np.ndarray
    found: np.ndarray
    found_right: np.ndarray
    vehicle_frame: np.ndarray
    vehicle_kind: np.ndarray
    vehicle_distance_m: np.ndarray

    def near(self, low_m: float, high_m: float) -> Matches:
        """Those between two distances from the LiDAR, the lower included."""
        return self._of(*((low_m <= d) & (d < high_m) for d in (self.distance_m, self.vehicle_distance_m)))

    def of_kind(self, kind: int) -> Matches:
        """Vehicles of a kind, found where they were taken for it, and detections that were, hits where it is right."""
        found = np.where(self.found_right, self.found, MISSED)
        sorted_out = replace(self, hit=self.hit & self.right, found=found)
        return sorted_out._of(self.kind == kind, self.vehicle_kind == kind)

    def _of(self, detections: np.ndarray, vehicles: np.ndarray) -> Matches:
        names = ("confidence", "hit", "frame", "kind", "distance_m", "right")
        of_vehicles = ("found", "found_right", "vehicle_frame", "vehicle_kind", "vehicle_distance_m")
        changed = {name: getattr(self, name)[detections] for name in names}
        return replace(self, **changed, **{name: getattr(self, name)[vehicles] for name in of_vehicles})


def match(
    detected: Sequence[DetectedBoxes],
    frames: Sequence[CountedFrame],
    region: Region,
    lidar_xy: tuple[float, float],
    criterion: Criterion,
) -> Matches:
    """Match the detections of frames with their vehicles: the surest first, each with the best that is left.

    Parameters
    ----------
    detected : sequence of DetectedBoxes, f
    frames : sequence of CountedFrame, f
    region : Region
        Where a detection that meets nothing is a false alarm; of stretches of lanes all lanes.
    lidar_xy : (float, float)
        What distances are counted from [m].
    criterion : Criterion
    """
    region = replace(region, stretches=[(x, y, None) for x, y, _ in region.stretches])
    parts = [_matched(boxes, frame, region, lidar_xy, criterion) for boxes, frame in zip(detected, frames, strict=True)]
    of_frame = np.arange(len(frames))
    detections, vehicles = (
        np.concatenate([np.zeros((0, width)), *(part[side] for part in parts)]) for side, width in enumerate((5, 4))
    )
    confidence, hit, kind, distance, right = detections.T
    found, found_right, vehicle_kind, vehicle_distance = vehicles.T
    return Matches(
        frames=len(frames),
        confidence=confidence,
        hit=hit > 0.0,
        frame=np.repeat(of_frame, [len(one) for one, _ in parts]),
        kind=kind.astype(int),
        distance_m=distance,
        right=right > 0.0,
        found=found,
        found_right=found_right > 0.0,
        vehicle_frame=np.repeat(of_frame, [len(other) for _, other in parts]),
        vehicle_kind=vehicle_kind.astype(int),
        vehicle_distance_m=vehicle_distance,
    )


def _matched(boxes: DetectedBoxes, frame: CountedFrame, region: Region, lidar_xy, criterion: Criterion):
    """Of one frame: columns of `Matches` of its detections that count, (d, 5), and of its vehicles that do, (v, 4)."""
    vehicles, counted = frame.vehicles, frame.counted
    merit, kind = criterion.merit(boxes, vehicles), kind_of(vehicles.class_index)
    away, distance = (np.hypot(*(one.centre_m[:, :2] - lidar_xy).T) for one in (boxes, vehicles))
    free, met = counted.copy(), np.full(len(boxes), -1)
    ignored = ~region.holds(boxes)
    for row in np.argsort(-boxes.confidence, kind="stable"):
        left = np.where(free, merit[row], -np.inf)
        if left.max(initial=-np.inf) > -np.inf:
            met[row] = left.argmax()
            free[met[row]] = False
        else:
            ignored[row] |= (merit[row][~counted] > -np.inf).any()
    hit = met >= 0
    found, found_right = np.full(len(vehicles), MISSED), np.zeros(len(vehicles), dtype=bool)
    right = np.zeros(len(boxes), dtype=bool)
    right[hit] = boxes.kind[hit] == kind[met[hit]]
    found[met[hit]], found_right[met[hit]], away[hit] = boxes.confidence[hit], right[hit], distance[met[hit]]
    detections = np.column_stack([boxes.confidence, hit, boxes.kind, away, right])[hit | ~ignored]
    return detections, np.column_stack([found, found_right, kind, distance])[counted]


# --- Recall, precision and average precision --------------------------------------------------------------------------


def recall(matches: Matches, confidence: float, weight: np.ndarray | None = None) -> np.ndarray:
    """Share of the vehicles with a detection at least so sure; NaN where there are none.

    `weight` (r, f) says how often each frame counts in each of r resamples; once if left out. Returns (r,).
    """
    return _share(matches.found >= confidence, _of_frames(matches, weight)[:, matches.vehicle_frame])


def precision(matches: Matches, confidence: float, weight: np.ndarray | None = None) -> np.ndarray:
    """Share of the hits among detections at least so sure, (r,); NaN where there are none; `weight` as for `recall`."""
    sure = matches.confidence >= confidence
    return _share(matches.hit[sure], _of_frames(matches, weight)[:, matches.frame[sure]])


def average_precision(matches: Matches, weight: np.ndarray | None = None) -> np.ndarray:
    """AP over all points: the area below precision, made monotone, over recall, (r,); NaN where there are no vehicles.

    Everingham et al. 2010, as PASCAL VOC has it since then. Detections that are equally sure count as one step, so that
    their order does not matter. `weight` as for `recall`.
    """
    weight = _of_frames(matches, weight)
    vehicles = weight[:, matches.vehicle_frame].sum(axis=1)
    order = np.argsort(-matches.confidence, kind="stable")
    ends = np.flatnonzero(np.diff(matches.confidence[order], append=-np.inf))
    of_each = weight[:, matches.frame[order]]
    taken = np.cumsum(of_each, axis=1)[:, ends]
    hits = np.cumsum(of_each * matches.hit[order], axis=1)[:, ends]
    with np.errstate(divide="ignore", invalid="ignore"):
        precise = np.nan_to_num(hits / taken)
        envelope = np.maximum.accumulate(precise[:, ::-1], axis=1)[:, ::-1]
        return (np.diff(hits, axis=1, prepend=0.0) * envelope).sum(axis=1) / np.where(vehicles > 0, vehicles, np.nan)


def _of_frames(matches: Matches, weight: np.ndarray | None) -> np.ndarray:
    return np.ones((1, matches.frames)) if weight is None else weight


def _share(good: np.ndarray, weight: np.ndarray) -> np.ndarray:
    whole = weight.sum(axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(whole > 0, weight @ good / whole, np.nan)


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
_BANDS_M = 10.0


def detection_scores(by: Sequence[Matches]) -> dict[str, object]:
    """All `MEASURES`, over all and by distance and kind, for a result file; None where there is nothing to divide by.

    `by` are the matches by each of `CRITERIA`. By kind a vehicle counts as found where it was taken for its kind.
    """
    farthest = max((one.vehicle_distance_m.max(initial=0.0) for one in by), default=0.0)
    bands = np.arange(0.0, farthest + _BANDS_M, _BANDS_M)
    near = {f"{low:g}-{high:g} m": [one.near(low, high) for one in by] for low, high in pairwise(bands)}
    kinds = {name: [one.of_kind(kind) for one in by] for kind, name in enumerate(KINDS)}
    return {
        **_measured(by),
        "by_distance": {name: _measured(part) for name, part in near.items()},
        "by_kind": {name: _measured(part) for name, part in kinds.items()},
    }


def _measured(by: Sequence[Matches]) -> dict[str, object]:
    values = {name: float(measure(by, None)[0]) for name, measure in MEASURES.items()}
    told = {name: None if np.isnan(value) else value for name, value in values.items()}
    false_alarms = {
        f"false_alarms_{at:g}": int((~by[0].hit & (by[0].confidence >= at)).sum()) / max(by[0].frames, 1)
        for at in CONFIDENCES
    }
    return {"vehicles": len(by[0].found), **told, **false_alarms}


def paired_intervals(
    one: Sequence[Matches], other: Sequence[Matches], block: np.ndarray, seed: int, recording: np.ndarray | None = None
) -> dict[str, dict[str, object]]:
    """How much better `one` is than `other`, for each of `MEASURES`, with the paired 90 % interval over blocks of time.

    Parameters
    ----------
    one, other : sequence of Matches
        Of the same f frames, by each of `CRITERIA`.
    block, recording : ndarray, (f,)
        Block and recording of each frame.
    seed : int
        For the resampling.
    """
    labels, row = np.unique(block, return_inverse=True)
    vehicles = np.bincount(row[one[0].vehicle_frame], minlength=len(labels))
    stratum = None if recording is None else recording[np.unique(block, return_index=True)[1]]
    found = {}
    for name, measure in MEASURES.items():

        def difference(weight: np.ndarray, measure: Measure = measure) -> np.ndarray:
            of_frames = weight[:, row]
            return np.nan_to_num(measure(one, of_frames)) - np.nan_to_num(measure(other, of_frames))

        whole = float(difference(np.ones((1, len(labels))))[0])
        ends = statistic_interval_90(difference, vehicles, seed, stratum)
        found[name] = {"difference": whole, "interval_90": None if ends is None else list(ends)}
    return found
