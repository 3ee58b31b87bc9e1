"""Oriented bounding boxes, one table of all; their overlap from above (bird's-eye-view IoU), suppression and fusion."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from ..names import CLASSES, KINDS

_KINDS_OF = {"van": "car", "truck": KINDS[1], "bus": KINDS[1], "bicycle": "motorcycle"}
_KIND_OF_CLASS = np.array([-1 if c == "pedestrian" else KINDS.index(_KINDS_OF.get(c, c)) for c in CLASSES])
_CLASS_OF_KIND = np.array([CLASSES.index(_class) for _class in ("car", "truck", "motorcycle")], dtype=np.int8)

DTYPES = {
    "vehicle_id": np.int64,
    "class_index": np.int8,
    "centre_m": np.float64,
    "size_m": np.float64,
    "heading_rad": np.float64,
    "lane": np.int16,
    "body": np.int8,
}
"""Of the columns that traffic has."""
WAY_COLUMNS = ("approach", "exit", "movement", "map_lane")
"""Those that a frame has off straight roads: where a vehicle comes from and leaves, how it turns, its lane."""


@dataclass(frozen=True, slots=True, eq=False)
class Boxes:
    """Oriented bounding boxes in the road frame, a row each: vehicles and persons of a frame or more, or detections.

    Columns that are not known, or do not apply, are None. Of a frame that is scored, what does not count only hides.

    Attributes
    ----------
    frame : int, or ndarray, (n,) int64
        Frame number, as the recording counts them: one number where all rows are of one frame.
    time_s : float, or ndarray, (n,)
        Time of the frame [s], from the recording's own zero.
    vehicle_id : ndarray, (n,) int64
        -1 of detections.
    class_index : ndarray, (n,) int8
        Index into `CLASSES`.
    centre_m : ndarray, (n, 3) float64
        Box centres [m].
    size_m : ndarray, (n, 3) float64
        Length, width and height [m].
    heading_rad : ndarray, (n,) float64
        Counter-clockwise from +x [rad].
    lane : ndarray, (n,) int16
        Lane number of the source; 0 where unknown.
    body : ndarray, (n,) int8, or None
        Which of `fleet.BODIES` each has, from 1 on; 0: the usual one of its class and length, None: all have that.
    confidence : ndarray, (n,), or None
        Of detections, 0 to 1.
    counted : ndarray, (n,) bool, or None
        Those that are scored; None where all are.
    weight : ndarray, (n,), or None
        How much each counts in the objective; None where all weigh one.
    approach, exit, movement, map_lane : ndarray, (n,) str, or None
        The road that each comes from and the one that it leaves by, how it turns, and the map's lane; nothing where it
        is not known, None beside a straight road.
    since_ms : int
        Of one frame: whole milliseconds since the instant before; 0 at one.
    """

    frame: int | np.ndarray
    time_s: float | np.ndarray
    vehicle_id: np.ndarray
    class_index: np.ndarray
    centre_m: np.ndarray
    size_m: np.ndarray
    heading_rad: np.ndarray
    lane: np.ndarray
    body: np.ndarray | None = None
    confidence: np.ndarray | None = None
    counted: np.ndarray | None = None
    weight: np.ndarray | None = None
    approach: np.ndarray | None = None
    exit: np.ndarray | None = None
    movement: np.ndarray | None = None
    map_lane: np.ndarray | None = None
    since_ms: int = 0

    def __len__(self) -> int:
        return len(self.vehicle_id)

    @property
    def draw(self) -> int:
        """What imperfections draw by: `frame` at an instant, another number for each moment between two."""
        return self.frame + (self.since_ms << 32)

    @property
    def xy(self) -> np.ndarray:
        """Box centres seen from above, (n, 2) [m]."""
        return self.centre_m[:, :2]

    @property
    def class_name(self) -> np.ndarray:
        """Class names, (n,) str."""
        return np.array(CLASSES)[self.class_index]

    @property
    def kind(self) -> np.ndarray:
        """Index into `KINDS` of what detectors tell apart, (n,) int; -1 for pedestrians."""
        return _KIND_OF_CLASS[self.class_index]

    @property
    def counts(self) -> np.ndarray:
        """Which boxes are scored, (n,) bool: `counted`, or all."""
        return np.ones(len(self), dtype=bool) if self.counted is None else self.counted

    @property
    def counted_weight(self) -> np.ndarray:
        """Weights of the boxes that count: whole numbers where all weigh one."""
        return (np.ones(len(self), dtype=np.int64) if self.weight is None else self.weight)[self.counts]

    def columns(self) -> dict[str, np.ndarray]:
        """What there is of each row, by name."""
        values = ((field.name, getattr(self, field.name)) for field in fields(self))
        return {name: value for name, value in values if isinstance(value, np.ndarray)}

    def rows_of(self, vehicle_id: np.ndarray) -> np.ndarray:
        """Row of each of some vehicles, (k,) int64; -1 of those that are not there."""
        order, found = np.argsort(self.vehicle_id), np.full(len(vehicle_id), -1)
        there = np.isin(vehicle_id, self.vehicle_id)
        found[there] = order[np.searchsorted(self.vehicle_id, vehicle_id[there], sorter=order)]
        return found

    def table(self) -> dict[str, np.ndarray]:
        """The columns of a table of boxes, as `traffic.table` reads them: frame, vehicle_id, class ... heading_deg."""
        return {
            "frame": np.full(len(self), self.frame),
            "vehicle_id": self.vehicle_id,
            "class": self.class_name,
            **dict(zip(("x_m", "y_m", "z_m"), self.centre_m.T, strict=True)),
            **dict(zip(("length_m", "width_m", "height_m"), self.size_m.T, strict=True)),
            "heading_deg": np.degrees(self.heading_rad),
        }

    def select(self, which: np.ndarray | slice) -> Boxes:
        """The same with the rows that `which`, a (n,) mask, an index array or a slice, picks."""
        return replace(self, **{name: column[which] for name, column in self.columns().items()})


def no_boxes(frame: int = 0, time_s: float = 0.0) -> Boxes:
    """A frame without vehicles, or in which nothing was found."""
    return replace(boxes_of_rows([]), frame=frame, time_s=time_s)


def detected_boxes(centre_m, size_m, heading_rad, kind, confidence) -> Boxes:
    """Detections of one frame, by columns of `Boxes`; `kind` is an index into `KINDS`, (n,) int."""
    nobody, lane = np.full(len(kind), -1), np.zeros(len(kind), dtype=np.int16)
    where = centre_m, size_m, heading_rad
    return Boxes(0, 0.0, nobody, _CLASS_OF_KIND[kind], *where, lane, confidence=confidence)


def join_boxes(parts: Sequence[Boxes]) -> Boxes:
    """Detections of several frames or LiDARs as one."""
    none = no_boxes()
    columns = {name: [getattr(part, name) for part in (none, *parts)] for name in none.columns()}
    return replace(none, **{name: np.concatenate(column) for name, column in columns.items()})


def boxes_of_rows(rows: Iterable[Sequence[float]]) -> Boxes:
    """Detections from rows of x, y, z, length, width, height [m], heading [rad], kind and confidence."""
    table = np.array(list(rows), dtype=float).reshape(-1, 9)
    return detected_boxes(table[:, :3], table[:, 3:6], table[:, 6], table[:, 7].astype(np.int8), table[:, 8])


# --- Overlap from above -----------------------------------------------------------------------------------------------


def corners_of(boxes: Boxes) -> np.ndarray:
    """Corners of footprints, (n, 4, 2) [m], counter-clockwise from the front left one."""
    half = 0.5 * boxes.size_m[:, None, :2] * np.array([(1, 1), (-1, 1), (-1, -1), (1, -1)])
    cos, sin = np.cos(boxes.heading_rad)[:, None], np.sin(boxes.heading_rad)[:, None]
    turned = np.stack([cos * half[..., 0] - sin * half[..., 1], sin * half[..., 0] + cos * half[..., 1]], axis=-1)
    return boxes.centre_m[:, None, :2] + turned


def bev_iou(boxes: Boxes, others: Boxes) -> np.ndarray:
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


def suppressed(boxes: Boxes, most_iou: float) -> Boxes:
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


def late_fusion(parts: Sequence[Boxes]) -> Boxes:
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
    boxes = replace(boxes, centre_m=table[:, :3], size_m=table[:, 3:6], heading_rad=table[:, 6])
    return suppressed(boxes.select(kept), _SAME_IOU)
