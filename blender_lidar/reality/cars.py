"""Every labelled car of a folder of sweeps with the points in its box, and every metric of it."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from ..errors import InputError
from ..metrics.assignment import NO_BOX, points_in_boxes
from ..metrics.context import FrameBoxes, Mountings, View
from ..metrics.metric import Metric, VehicleReturns, vehicle_returns
from ..metrics.vgop import to_vehicle_frame
from .labelled import LabelledBoxes, LabelledClouds, LabelledSweep

BEARINGS = {"end-on": (0.0, 20.0), "oblique": (20.0, 70.0), "side-on": (70.0, 90.0)}
"""Between the line of sight and the car's axis [deg]; the upper end belongs to the next but for the last."""
_AT_THE_ORIGIN = Mountings(np.zeros((1, 3)), np.eye(3)[None])


class TrainingCars(NamedTuple):
    """Labelled cars that metrics learn from.

    Attributes
    ----------
    returns : VehicleReturns
        Of all of them.
    frames : tuple of FrameBoxes
        Their boxes sweep by sweep, in the sensor's frame.
    """

    returns: VehicleReturns
    frames: tuple[FrameBoxes, ...]


@dataclass(frozen=True, slots=True, eq=False)
class ScoredCars:
    """n labelled cars, in the order of sweeps and labels.

    Attributes
    ----------
    frame : ndarray of str, (n,)
    boxes : LabelledBoxes
        Of all frames.
    bearing_deg : ndarray, (n,)
        Angle between the line of sight and the car's axis, 0 (end-on) to 90 (side-on).
    count : ndarray of int64, (n,)
        Points in the box.
    occupancy : ndarray, (n, 3)
        P of the top, side and front view.
    scores : mapping of str to ndarray, (n,)
        By the metric's name, in its own unit.
    seconds : mapping of str to float
        Processor time of the stages over all sweeps, which other programs do not lengthen: ``read``, ``assign``,
        ``pe_vgop``, and ``all_metrics``, which holds what metrics share but not reading and assigning.
    """

    frame: np.ndarray
    boxes: LabelledBoxes
    bearing_deg: np.ndarray
    count: np.ndarray
    occupancy: np.ndarray
    scores: Mapping[str, np.ndarray]
    seconds: Mapping[str, float]

    def __len__(self) -> int:
        return len(self.frame)

    def select(self, which: np.ndarray) -> ScoredCars:
        """The cars that `which`, a (n,) mask or an index array, picks; the seconds stay those of all."""
        return ScoredCars(
            frame=self.frame[which],
            boxes=self.boxes.select(which),
            bearing_deg=self.bearing_deg[which],
            count=self.count[which],
            occupancy=self.occupancy[which],
            scores={name: values[which] for name, values in self.scores.items()},
            seconds=self.seconds,
        )


def score_cars(
    clouds: LabelledClouds,
    frames: Sequence[str],
    classes: Sequence[str],
    metrics: Sequence[Metric],
    ground_clearance_m: float = 0.0,
) -> ScoredCars:
    """Read, assign and score, one sweep after the other.

    Parameters
    ----------
    clouds : LabelledClouds
    frames : sequence of str
        Which sweeps.
    classes : sequence of str
        What counts as a car, in the data set's words; capitals do not matter.
    metrics : sequence of Metric
        The first is timed by itself.
    ground_clearance_m : float
        Points less than this above a box's floor are left out [m].

    Raises
    ------
    InputError, MissingFileError
        Of files that cannot be used, or where no sweep has such a label.
    """
    wanted = {name.lower() for name in classes}
    seconds = dict.fromkeys(("read", "assign", "pe_vgop", "all_metrics"), 0.0)
    parts: list[tuple[str, LabelledBoxes, VehicleReturns, dict[str, np.ndarray]]] = []
    met: set[str] = set()
    for frame in frames:
        watch = _Watch(seconds)
        sweep = clouds.read(frame)
        watch.stop("read")
        met.update(sweep.boxes.label.tolist())
        boxes, row = _assigned(sweep, _labelled(sweep, wanted), ground_clearance_m)
        watch.stop("assign")
        returns = _returns(sweep.points, boxes, row)
        scores = {metrics[0].name: metrics[0].values(returns)}
        watch.stop("pe_vgop", "all_metrics")
        scores |= {metric.name: metric.values(returns) for metric in metrics[1:]}
        watch.stop("all_metrics")
        parts.append((frame, boxes, returns, scores))
    if not sum(len(boxes) for _, boxes, _, _ in parts):
        raise InputError(
            f"--class: {', '.join(classes)}: {clouds.folder} labels none in {len(frames)} sweeps; it labels "
            f"{', '.join(sorted(met)) or 'nothing'}"
        )
    boxes = LabelledBoxes.joined([boxes for _, boxes, _, _ in parts])
    return ScoredCars(
        frame=np.repeat([frame for frame, _, _, _ in parts], [len(boxes) for _, boxes, _, _ in parts]),
        boxes=boxes,
        bearing_deg=bearing_deg(boxes),
        count=np.concatenate([returns.count for _, _, returns, _ in parts]),
        occupancy=np.concatenate([returns.occupancy for _, _, returns, _ in parts]),
        scores={metric.name: np.concatenate([scores[metric.name] for *_, scores in parts]) for metric in metrics},
        seconds=seconds,
    )


def training_cars(
    clouds: LabelledClouds, frames: Sequence[str], classes: Sequence[str], ground_clearance_m: float = 0.0
) -> TrainingCars | None:
    """The labelled cars of some sweeps, for metrics to learn from; None without such a car.

    Parameters as in `score_cars`.
    """
    wanted = {name.lower() for name in classes}
    points, vehicle, parts = [], [], []
    cars = 0
    for frame in frames:
        sweep = clouds.read(frame)
        boxes, row = _assigned(sweep, _labelled(sweep, wanted), ground_clearance_m)
        inside = np.flatnonzero(row != NO_BOX)
        points.append(to_vehicle_frame(sweep.points[inside], boxes.centre_m, boxes.heading_rad, row[inside]))
        vehicle.append(row[inside] + cars)
        parts.append(boxes)
        cars += len(boxes)
    if not cars:
        return None
    boxes = LabelledBoxes.joined(parts)
    returns = vehicle_returns(np.concatenate(points), np.concatenate(vehicle), boxes.size_m, boxes.distance_m)
    return TrainingCars(returns, tuple(_seen_from_the_sensor(one).boxes for one in parts))


def bearing_deg(boxes: LabelledBoxes) -> np.ndarray:
    """Angle between the line of sight to each box's centre and its axis, (n,): 0 (end-on) to 90 (side-on)."""
    sight = np.arctan2(boxes.centre_m[:, 1], boxes.centre_m[:, 0])
    return np.degrees(np.arccos(np.clip(np.abs(np.cos(boxes.heading_rad - sight)), 0.0, 1.0)))


def of_bearing(bearing_deg: np.ndarray) -> dict[str, np.ndarray]:
    """Which cars, (n,) bool, are seen end-on, obliquely and from the side."""
    last = list(BEARINGS)[-1]
    return {
        name: (bearing_deg >= low) & ((bearing_deg < high) | (name == last)) for name, (low, high) in BEARINGS.items()
    }


def _labelled(sweep: LabelledSweep, wanted: set[str]) -> np.ndarray:
    """Which boxes bear one of the labels, in small letters, that are wanted, (n,) bool."""
    return np.array([label.lower() in wanted for label in sweep.boxes.label.tolist()], dtype=bool)


def _assigned(sweep: LabelledSweep, mine: np.ndarray, ground_clearance_m: float) -> tuple[LabelledBoxes, np.ndarray]:
    """The boxes that count, and the row among them of each point.

    Boxes of other classes take part, so that a point of a van that a car's box overlaps goes to the nearer one.
    """
    boxes = sweep.boxes
    row = points_in_boxes(sweep.points, boxes.centre_m, boxes.size_m, boxes.heading_rad, ground_clearance_m)
    number = np.full(len(boxes) + 1, NO_BOX, dtype=np.int64)  # the last is for points in no box
    number[:-1][mine] = np.arange(np.count_nonzero(mine))
    return boxes.select(mine), number[row]


def _returns(points: np.ndarray, boxes: LabelledBoxes, row: np.ndarray) -> VehicleReturns:
    inside = np.flatnonzero(row != NO_BOX)
    local = to_vehicle_frame(points[inside], boxes.centre_m, boxes.heading_rad, row[inside])
    returns = vehicle_returns(local, row[inside], boxes.size_m, boxes.distance_m)
    return replace(returns, view=_seen_from_the_sensor(boxes))


def _seen_from_the_sensor(boxes: LabelledBoxes) -> View:
    """A frame's cars and the sensor, which is the origin of their frame."""
    placed = FrameBoxes(0, boxes.centre_m, boxes.size_m, boxes.heading_rad, np.ones(len(boxes), dtype=bool))
    return View(_AT_THE_ORIGIN, placed)


class _Watch:
    """Adds the processor time since it was last stopped to the stages named."""

    def __init__(self, seconds: dict[str, float]) -> None:
        self._seconds, self._since = seconds, time.process_time()

    def stop(self, *stages: str) -> None:
        now = time.process_time()
        for stage in stages:
            self._seconds[stage] += now - self._since
        self._since = now
