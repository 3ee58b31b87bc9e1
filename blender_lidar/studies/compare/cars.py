"""Every labelled car of a folder of sweeps: the points in its box, its metrics, and what detectors made of it.

Metrics of single cars are the catalogue's, PE-VGOP's logarithm, and four that learn: S-MIG, M-SOG, the entropy of the
voxels hit and expected visibility. These are published for a region; `metrics.occupancy_prior` says
in which form they score a car. Their prior is learned from the frames that detectors learned from, and frozen before
any other car is scored.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from ...errors import InputError, unknown_name
from ...metrics.assignment import NO_BOX, points_in_boxes
from ...metrics.catalogue import METRICS
from ...metrics.metric import (
    NEEDS_DETECTABLE,
    NEEDS_POINTS,
    NEEDS_VIEW,
    FrameBoxes,
    Metric,
    Mountings,
    VehicleReturns,
    View,
    vehicle_returns,
)
from ...metrics.occupancy_prior import OccupiedFrames, VehiclePrior, box_visibility, reach_probability
from ...metrics.vgop import to_vehicle_frame
from ...metrics.voxel_grid import VoxelGrid
from . import OURS
from .detections import Detections
from .labelled import LabelledBoxes, LabelledClouds, LabelledSweep, joined

BEARINGS = {"end-on": 0.0, "oblique": 20.0, "side-on": 70.0}
"""From which angle on between the line of sight and the car's axis [deg]."""
PAPERS = "pe-vgop"
SHARES = ["p_top", "p_side", "p_front"]
VOXEL_M = 0.4  # of the prior of expected visibility
LOOKED_FOR_WITHIN_M = 80.0  # cars farther away are not looked for
LOWEST_M, HIGHEST_M = -3.2, 2.0  # of its region, above the sensor: a car's LiDAR sits on its roof
_OFFSET_BITS = 0.001  # so that a car without a point has a logarithm
_AT_THE_ORIGIN = Mountings(np.zeros((1, 3)), np.eye(3)[None])

# --- Which metrics ----------------------------------------------------------------------------------------------------


def log_pe_vgop(returns: VehicleReturns) -> np.ndarray:
    """ln(PE-VGOP + 0.001), (n,): the same order as PE-VGOP, in which detectors saturate later."""
    return np.log(METRICS[PAPERS].values(returns) + _OFFSET_BITS)


LOG_PE_VGOP = Metric("log-pe-vgop", "ln(PE-VGOP + 0.001)", "", higher_is_better=True, score=log_pe_vgop)
LEARNED = {
    name: Metric(name, label, unit, higher_is_better=True, needs=frozenset({needs}))
    for name, label, unit, needs in (
        ("covered-entropy-per-car", "entropy of the voxels hit", "nats", NEEDS_POINTS),
        ("s-mig-per-car", "S-MIG of a car, as published", "nats", NEEDS_POINTS),
        ("m-sog-per-car", "M-SOG of a car, as published", "nats", NEEDS_POINTS),
        ("expected-visibility-per-car", "expected visibility of a car", "", NEEDS_VIEW),
    )
}
"""Without a score until they are `taught`."""


def comparable() -> dict[str, Metric]:
    """Metrics of single cars, by name: those that learn from a scene's traffic are left out."""
    others = {NEEDS_VIEW, NEEDS_DETECTABLE}  # neither a moment's traffic nor a threshold is a single car's
    of_cars = {name: one for name, one in METRICS.items() if one.learn is None and not others & one.needs}
    first = {name: of_cars.pop(name) for name in (OURS, PAPERS)}
    return {**first, LOG_PE_VGOP.name: LOG_PE_VGOP, **of_cars, **LEARNED}


def chosen_metrics(names: str | None) -> tuple[Metric, ...]:
    """The metrics that `--metrics` names, divided by commas; all by default.

    Raises
    ------
    InputError
        For one that is not known.
    """
    known = comparable()
    if names is None:
        return tuple(known.values())
    chosen = dict.fromkeys(name.strip() for name in names.split(","))
    for name in chosen:
        if name not in known:
            raise unknown_name(name, known, "metric", "--metrics")
    return tuple(known[name] for name in chosen)


def taught(metrics: Sequence[Metric], training: Sequence[VehicleReturns]) -> list[Metric]:
    """The metrics, those of `LEARNED` with what the cars of training sweeps taught them, or left out without one."""
    if not sum(map(len, training)):
        return [metric for metric in metrics if metric.name not in LEARNED]
    first = np.cumsum([0, *map(len, training[:-1])]).tolist()
    vehicle = np.concatenate([one.vehicle + row for one, row in zip(training, first, strict=True)])
    points, size_m = (np.concatenate([getattr(one, name) for one in training]) for name in ("points", "size_m"))
    prior = VehiclePrior.learn(vehicle_returns(points, vehicle, size_m))
    visibility = expected_visibility([one.view.boxes for one in training])
    scores = (prior.covered_entropy, prior.s_mig, prior.m_sog, visibility)
    learned = {name: replace(LEARNED[name], score=score) for name, score in zip(LEARNED, scores, strict=True)}
    return [learned.get(metric.name, metric) for metric in metrics]


def expected_visibility(frames: Sequence[FrameBoxes]) -> Callable[[VehicleReturns], np.ndarray]:
    """Expected visibility of single cars: mean, over a box's voxels, of the probability that a beam gets there.

    `metrics.occupancy_prior.reach_probability` has the formula. The prior of a voxel, in the sensor's frame, is the
    share of training frames with a labelled car in it. A beam goes through the centre of every voxel of a car: how
    densely a sensor samples does not enter, nor do the car's returns.

    Parameters
    ----------
    frames : sequence of FrameBoxes
        The training frames, in the sensor's frame.

    Returns
    -------
    callable
        Of each car, (n,), 0 to 1; the `view` of the returns is one sensor in the origin of their frame.
    """
    corner = np.array([LOOKED_FOR_WITHIN_M, LOOKED_FOR_WITHIN_M, HIGHEST_M])
    grid = VoxelGrid.covering((-LOOKED_FOR_WITHIN_M, -LOOKED_FOR_WITHIN_M, LOWEST_M), corner, VOXEL_M)

    def inside(boxes: FrameBoxes) -> np.ndarray:
        return grid.in_boxes(boxes.centre_m, boxes.size_m, boxes.heading_rad)

    prior = OccupiedFrames([inside(frame) for frame in frames], len(grid)).prior

    def visibility(returns: VehicleReturns) -> np.ndarray:
        boxes = returns.view.boxes
        (origin,) = returns.view.mountings.origin_m
        way = grid.centres(inside(boxes)) - origin
        beams = way / np.linalg.norm(way, axis=1, keepdims=True)
        reached = reach_probability(grid, prior, origin, beams, 2.0 * LOOKED_FOR_WITHIN_M)
        return box_visibility(grid, reached, boxes.centre_m, boxes.size_m, boxes.heading_rad)

    return visibility


# --- Cars and their scores --------------------------------------------------------------------------------------------


def score_cars(
    clouds: LabelledClouds,
    frames: Sequence[str],
    classes: Sequence[str],
    metrics: Sequence[Metric],
    ground_clearance_m: float = 0.0,
) -> tuple[dict[str, np.ndarray], dict[str, float]]:
    """Read, assign and score every labelled car, one sweep after the other.

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

    Returns
    -------
    cars : dict of str to ndarray, (n,)
        Columns with a row for each car, in the order of sweeps and labels: ``frame, class, truncation``, those of
        `LabelledBoxes.columns`, ``points_in_box``, those of `SHARES`, and each metric's score in its own unit.
    seconds : dict of str to float
        Processor time of the stages over all sweeps, which other programs do not lengthen: ``read``, ``assign``,
        ``pe_vgop``, which holds what metrics share, and ``other_metrics``.

    Raises
    ------
    InputError, MissingFileError
        Of files that cannot be used, or where no sweep has such a label.
    """
    seconds = dict.fromkeys(("read", "assign", "pe_vgop", "other_metrics"), 0.0)
    tables, met = [], set()
    for frame in frames:
        clock = [time.process_time()]
        sweep = clouds.read(frame)
        clock.append(time.process_time())
        boxes, row = _assigned(sweep, classes, ground_clearance_m)
        clock.append(time.process_time())
        returns = _returns(sweep.points, boxes, row)
        scores = {metrics[0].name: metrics[0].values(returns)}
        clock.append(time.process_time())
        scores |= {metric.name: metric.values(returns) for metric in metrics[1:]}
        clock.append(time.process_time())
        for stage, spent in zip(seconds, np.diff(clock).tolist(), strict=True):
            seconds[stage] += spent
        met.update(sweep.boxes.label.tolist())
        told = {"frame": np.full(len(boxes), frame), "class": boxes.label, "truncation": boxes.truncation}
        shares = dict(zip(SHARES, returns.occupancy.T, strict=True))
        tables.append({**told, **boxes.columns(), "points_in_box": returns.count, **shares, **scores})
    cars = joined(tables)
    if not len(cars["frame"]):
        raise InputError(
            f"--class: {', '.join(classes)}: {clouds.folder} labels none in {len(frames)} sweeps; it labels "
            f"{', '.join(sorted(met)) or 'nothing'}"
        )
    return cars, seconds


def training_returns(
    clouds: LabelledClouds, frames: Sequence[str], classes: Sequence[str], ground_clearance_m: float = 0.0
) -> list[VehicleReturns]:
    """Returns of the labelled cars of each of some sweeps, for metrics to learn from; parameters as in `score_cars`."""
    sweeps = map(clouds.read, frames)
    return [_returns(sweep.points, *_assigned(sweep, classes, ground_clearance_m)) for sweep in sweeps]


def of_bearing(bearing_deg: np.ndarray) -> dict[str, np.ndarray]:
    """Which cars, (n,) bool, are seen end-on, obliquely and from the side."""
    kind = np.searchsorted(list(BEARINGS.values()), bearing_deg, side="right") - 1
    return {name: kind == number for number, name in enumerate(BEARINGS)}


def _assigned(
    sweep: LabelledSweep, classes: Sequence[str], ground_clearance_m: float
) -> tuple[LabelledBoxes, np.ndarray]:
    """The boxes that count, and the row among them of each point.

    Boxes of other classes take part, so that a point of a van that a car's box overlaps goes to the nearer one.
    """
    boxes, mine = sweep.boxes, sweep.boxes.of_class(classes)
    row = points_in_boxes(sweep.points, boxes.centre_m, boxes.size_m, boxes.heading_rad, ground_clearance_m)
    number = np.full(len(boxes) + 1, NO_BOX, dtype=np.int64)  # the last is for points in no box
    number[:-1][mine] = np.arange(np.count_nonzero(mine))
    return boxes.select(mine), number[row]


def _returns(points: np.ndarray, boxes: LabelledBoxes, row: np.ndarray) -> VehicleReturns:
    """The returns from a frame's cars, seen by the sensor in the origin of their frame."""
    inside = np.flatnonzero(row != NO_BOX)
    local = to_vehicle_frame(points[inside], boxes.centre_m, boxes.heading_rad, row[inside])
    returns = vehicle_returns(local, row[inside], boxes.size_m, boxes.distance_m)
    placed = FrameBoxes(0, boxes.centre_m, boxes.size_m, boxes.heading_rad, np.ones(len(boxes), dtype=bool))
    return replace(returns, view=View(_AT_THE_ORIGIN, placed))


def judged_cars(
    cars: Mapping[str, np.ndarray], detections: Detections, classes: Sequence[str]
) -> dict[str, np.ndarray]:
    """The cars that the detections list, with what is told of them, by column, in the order of the cars.

    Raises
    ------
    InputError
        For a detection of no such car.
    """
    listed = detections.table
    row_of = {car: row for row, car in enumerate(_keys(cars))}
    there = []
    for line, (frame, label_line) in zip(listed["line"].tolist(), _keys(listed), strict=True):
        if (frame, label_line) not in row_of:
            known = ", ".join(map(str, cars["label_line"][cars["frame"] == frame])) or "none"
            raise InputError(
                f"{detections.path}:{line}: label_line {label_line} of frame {frame} is no {' or '.join(classes)}; "
                f"allowed: {known}"
            )
        there.append(row_of[frame, label_line])
    order = np.argsort(there)
    mine = np.array(there)[order]
    return {name: of[mine] for name, of in cars.items()} | {name: of[order] for name, of in listed.items()}


def _keys(table: Mapping[str, np.ndarray]) -> list[tuple[str, int]]:
    return list(zip(table["frame"].tolist(), table["label_line"].tolist(), strict=True))
