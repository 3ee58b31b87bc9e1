"""Oriented boxes that a detector found, their overlap from above (bird's-eye-view IoU) and non-maximum suppression."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields

import numpy as np

from ..names import KINDS
from .vehicles import CLASSES, Vehicles

_KINDS_OF = {"van": "car", "truck": KINDS[1], "bus": KINDS[1], "bicycle": "motorcycle"}
_KIND_OF_CLASS = np.array([-1 if c == "pedestrian" else KINDS.index(_KINDS_OF.get(c, c)) for c in CLASSES])


@dataclass(frozen=True, slots=True, eq=False)
class DetectedBoxes:
    """Detections of one frame in the road frame.

    Attributes
    ----------
    centre_m : ndarray, (n, 3)
        Box centres [m].
    size_m : ndarray, (n, 3)
        Length, width, height [m].
    heading_rad : ndarray, (n,)
        Counter-clockwise from +x [rad].
    kind : ndarray of int8, (n,)
        Index into `KINDS`.
    confidence : ndarray, (n,)
        0 to 1.
    """

    centre_m: np.ndarray
    size_m: np.ndarray
    heading_rad: np.ndarray
    kind: np.ndarray
    confidence: np.ndarray

    def __len__(self) -> int:
        return len(self.confidence)

    def select(self, which: np.ndarray) -> DetectedBoxes:
        """Some of them, by a mask or by rows."""
        return DetectedBoxes(*(getattr(self, field.name)[which] for field in fields(self)))


def no_boxes() -> DetectedBoxes:
    """The boxes of a frame in which nothing was found."""
    return DetectedBoxes(np.empty((0, 3)), np.empty((0, 3)), np.empty(0), np.empty(0, np.int8), np.empty(0))


def join_boxes(parts: Sequence[DetectedBoxes]) -> DetectedBoxes:
    """Several as one."""
    columns = ([getattr(part, field.name) for part in (no_boxes(), *parts)] for field in fields(DetectedBoxes))
    return DetectedBoxes(*map(np.concatenate, columns))


def boxes_of_rows(rows: Iterable[Sequence[float]]) -> DetectedBoxes:
    """DetectedBoxes from rows of x, y, z, length, width, height [m], heading [rad], kind and confidence."""
    table = np.array(list(rows), dtype=float).reshape(-1, 9)
    return DetectedBoxes(table[:, :3], table[:, 3:6], table[:, 6], table[:, 7].astype(np.int8), table[:, 8])


def kind_of(class_index: np.ndarray) -> np.ndarray:
    """The kind of vehicles, (n,), by their class."""
    return _KIND_OF_CLASS[class_index]


# --- Overlap from above -----------------------------------------------------------------------------------------------


def corners_of(boxes: DetectedBoxes | Vehicles) -> np.ndarray:
    """Corners of footprints, (n, 4, 2) [m], counter-clockwise from the front left one."""
    half = 0.5 * boxes.size_m[:, None, :2] * np.array([(1, 1), (-1, 1), (-1, -1), (1, -1)])
    cos, sin = np.cos(boxes.heading_rad)[:, None], np.sin(boxes.heading_rad)[:, None]
    turned = np.stack([cos * half[..., 0] - sin * half[..., 1], sin * half[..., 0] + cos * half[..., 1]], axis=-1)
    return boxes.centre_m[:, None, :2] + turned


def bev_iou(boxes: DetectedBoxes | Vehicles, others: DetectedBoxes | Vehicles) -> np.ndarray:
    """Rotated bird's-eye-view IoU: intersection over union of footprints, (n, m), 0 to 1.

    The corners of an intersection of convex polygons are the corners of each that lie in the other, and where their
    sides cross.
    """
    iou = np.zeros((len(boxes.size_m), len(others.size_m)))
    apart = boxes.centre_m[:, None, :2] - others.centre_m[None, :, :2]
    reach = 0.5 * np.hypot(*boxes.size_m[:, :2].T)[:, None] + 0.5 * np.hypot(*others.size_m[:, :2].T)
    row, column = np.nonzero(np.hypot(apart[..., 0], apart[..., 1]) < reach)
    if not len(row):
        return iou
    middle = boxes.centre_m[row, None, :2]  # counted from there, so that places far away keep their digits
    one, other = corners_of(boxes)[row] - middle, corners_of(others)[column] - middle
    crossings, cross = _crossings(one, other)
    points = np.concatenate([one, other, crossings], axis=1)
    real = np.concatenate([_inside(one, other), _inside(other, one), cross], axis=1)
    shared = _hull_area(points, real)
    area = np.prod(boxes.size_m[row, :2], axis=1) + np.prod(others.size_m[column, :2], axis=1)
    iou[row, column] = shared / (area - shared)
    return np.clip(iou, 0.0, 1.0)


_EDGE = 1e-12  # relative to a box's size: a corner on a side lies inside


def _inside(points: np.ndarray, polygon: np.ndarray) -> np.ndarray:
    """Which points (k, p, 2) lie in their convex polygon (k, 4, 2), counter-clockwise, (k, p) bool."""
    side = np.roll(polygon, -1, axis=1) - polygon
    away = points[:, :, None] - polygon[:, None]
    turn = side[:, None, :, 0] * away[..., 1] - side[:, None, :, 1] * away[..., 0]
    return (turn >= -_EDGE * np.square(side).sum(axis=-1)[:, None]).all(axis=-1)


def _crossings(one: np.ndarray, other: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Where each side of one polygon (k, 4, 2) crosses each of another, (k, 16, 2), and whether it does, (k, 16)."""
    start, along = one[:, :, None], (np.roll(one, -1, axis=1) - one)[:, :, None]
    begin, across = other[:, None], (np.roll(other, -1, axis=1) - other)[:, None]
    turn = along[..., 0] * across[..., 1] - along[..., 1] * across[..., 0]
    off = begin - start
    with np.errstate(divide="ignore", invalid="ignore"):
        at = (off[..., 0] * across[..., 1] - off[..., 1] * across[..., 0]) / turn
        beside = (off[..., 0] * along[..., 1] - off[..., 1] * along[..., 0]) / turn
    met = (turn != 0.0) & (at >= 0.0) & (at <= 1.0) & (beside >= 0.0) & (beside <= 1.0)
    points = start + np.where(met, at, 0.0)[..., None] * along
    return points.reshape(len(one), 16, 2), met.reshape(len(one), 16)


def _hull_area(points: np.ndarray, real: np.ndarray) -> np.ndarray:
    """Areas of convex polygons, (k,), by their corners in any order, some of which are not `real`; the shoelace."""
    count = np.maximum(real.sum(axis=1), 1)[:, None]
    middle = np.where(real[..., None], points, 0.0).sum(axis=1) / count
    away = points - middle[:, None]
    angle = np.where(real, np.arctan2(away[..., 1], away[..., 0]), np.inf)
    order = np.argsort(angle, axis=1)
    away = np.take_along_axis(away, order[..., None], axis=1)
    first = away[:, :1]
    away = np.where(np.take_along_axis(real, order, axis=1)[..., None], away, first)  # the rest closes the outline
    following = np.roll(away, -1, axis=1)
    return 0.5 * np.abs((away[..., 0] * following[..., 1] - away[..., 1] * following[..., 0]).sum(axis=1))


def suppressed(boxes: DetectedBoxes, most_iou: float) -> DetectedBoxes:
    """Non-maximum suppression: the surest first, less those that overlap a surer one by more than `most_iou`."""
    boxes = boxes.select(np.argsort(-boxes.confidence, kind="stable"))
    overlap = bev_iou(boxes, boxes) > most_iou
    kept = np.ones(len(boxes), dtype=bool)
    for row in range(len(boxes)):
        if kept[row]:
            kept[row + 1 :] &= ~overlap[row, row + 1 :]
    return boxes.select(kept)


_SAME_IOU = 0.1  # vehicles do not overlap: boxes that do are of one; it is what detectors themselves suppress by
HIT_M = 2.0  # centres at most so far apart are of one vehicle: the third of nuScenes' thresholds


def late_fusion(parts: Sequence[DetectedBoxes]) -> DetectedBoxes:
    """The detections of several LiDARs as one list: weighted boxes fusion, in which boxes of one vehicle are merged.

    The surest box takes of each other LiDAR the one that is left, of any kind, and overlaps it most, by more than 0.1
    (IoU from above), or else lies nearest, centres at most `HIT_M` apart; then the next. Place, size and heading are
    means by confidence (Solovyev et al. 2021, Image and Vision Computing 107) over boxes of its kind within 45 degrees
    of its axis. The confidence is the surest one's: the same vehicle seen twice by one network is no independent
    evidence, which a noisy-OR would assume. Of merged boxes that overlap by more than 0.1 the surest stays.
    """
    boxes, lidar = join_boxes(parts), np.repeat(np.arange(len(parts)), list(map(len, parts)))
    if len(np.unique(lidar)) < 2:
        return boxes
    order = np.lexsort((boxes.heading_rad, *boxes.centre_m.T, -boxes.confidence))  # whatever the LiDARs' order is
    boxes, lidar = boxes.select(order), lidar[order]
    iou, away = bev_iou(boxes, boxes), np.linalg.norm(boxes.centre_m[:, None, :2] - boxes.centre_m[:, :2], axis=-1)
    merit = np.where(iou > _SAME_IOU, iou, np.where(away <= HIT_M, -away, -np.inf))
    merit[lidar[:, None] == lidar] = -np.inf
    table = np.column_stack([boxes.centre_m, boxes.size_m, boxes.heading_rad])
    free, kept = np.ones(len(boxes), dtype=bool), []
    for row in range(len(boxes)):
        if not free[row]:
            continue
        best = np.argsort(-merit[row], kind="stable")
        best = best[free[best] & (merit[row, best] > -np.inf)]
        group = np.append(row, best[np.unique(lidar[best], return_index=True)[1]])  # the first of each LiDAR
        free[group] = False
        kept.append(row)
        off = table[group] - table[row]
        off[:, -1] = np.remainder(off[:, -1] + 0.5 * np.pi, np.pi) - 0.5 * np.pi  # a box turned about is the same
        alike = (boxes.kind[group] == boxes.kind[row]) & (np.abs(off[:, -1]) <= 0.25 * np.pi)
        weight = np.maximum(boxes.confidence[group][alike], 1e-9)
        table[row] += weight @ off[alike] / weight.sum()
    table = table[kept]
    merged = DetectedBoxes(table[:, :3], table[:, 3:6], table[:, 6], boxes.kind[kept], boxes.confidence[kept])
    return suppressed(merged, _SAME_IOU)
