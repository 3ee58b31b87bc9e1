"""What is made of what mountings see: each vehicle's value by the chosen metric, and what it adds to the objective."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ..errors import InputError
from ..metrics.catalogue import metric_named
from ..metrics.context import Field, FrameBoxes, Mountings, SceneContext, View
from ..metrics.metric import POINTS, VIEW, VehicleReturns
from ..metrics.views import PE_VGOP
from ..optimise.objective import detectable, vehicle_score
from ..sensors.pose import Pose
from ..traffic import RoadFrame
from ..traffic.vehicles import Vehicles
from .frame_scorer import FrameScorer, Observation, Seen


@dataclass(frozen=True, slots=True)
class CountedFrame:
    """A frame, and which of its vehicles count; the others hide and are not scored."""

    vehicles: Vehicles
    counted: np.ndarray

    @property
    def boxes(self) -> FrameBoxes:
        """The frame as metrics know it."""
        vehicles = self.vehicles
        return FrameBoxes(vehicles.frame, vehicles.centre_m, vehicles.size_m, vehicles.heading_rad, self.counted)


@dataclass(frozen=True, slots=True)
class Scoring:
    """What is made of what a mounting sees: the metric, and the settings of Eqs. 10 and 11.

    `loss` is None where a vehicle below the threshold adds what the metric gives it, as others do. `field` is where
    metrics of a whole scene look; None serves all others.
    """

    threshold: float
    view: str
    loss: float | None
    reading: str
    metric: str = PE_VGOP.name
    field: Field | None = None


class Scored(NamedTuple):
    """What s mountings make of the n counted vehicles of one frame.

    Attributes
    ----------
    seen : Seen
        Returns and occupancies.
    values : ndarray, (s, n)
        The metric, in its own unit.
    detectable : ndarray of bool, (s, n)
        Eq. 11.
    objective : ndarray, (s, n)
        What each vehicle adds to the objective (Eq. 10).
    """

    seen: Seen
    values: np.ndarray
    detectable: np.ndarray
    objective: np.ndarray


class VehicleScores:
    """Scores frames under mountings by one metric.

    Parameters
    ----------
    scoring : Scoring
        The metric and the settings of Eqs. 10 and 11.
    observation : Observation
        How vehicles are seen.
    frames : sequence of CountedFrame
        All that will be scored: a metric with a memory learns from them, once.
    """

    def __init__(self, scoring: Scoring, observation: Observation, frames: Sequence[CountedFrame]) -> None:
        context = None if scoring.field is None else _context(scoring.field, observation, frames)
        self._scoring, self._metric = scoring, metric_named(scoring.metric).learnt(context)

    def of(self, frame: CountedFrame, scorer: FrameScorer, poses: Sequence[Pose], mountings: Mountings) -> Scored:
        """Score s mountings, given as poses and as what `mountings_of` makes of them, on the frame of a scorer."""
        scoring, metric = self._scoring, self._metric
        seen = scorer.see(poses, keep_returns=POINTS in metric.needs)
        noticed = detectable(seen.occupancy, scoring.threshold, scoring.view)
        values = metric.values(_rows(metric, frame, scorer, seen, mountings)).reshape(noticed.shape)
        objective = vehicle_score(metric.merit(values), noticed, scoring.loss, scoring.reading)
        return Scored(seen, values, noticed, objective)


def mountings_of(poses: Sequence[Pose]) -> Mountings:
    """Mountings as metrics know them."""
    return Mountings(
        np.array([pose.position for pose in poses]).reshape(-1, 3),
        np.array([pose.rotation for pose in poses]).reshape(-1, 3, 3),
    )


def scene_field(
    metric: str, road: RoadFrame, centre_xy_m: tuple[float, float], radius_m: float, searched: Sequence[CountedFrame]
) -> Field | None:
    """Where a metric with a memory looks, the carriageway within a region; None for any other metric.

    Raises
    ------
    InputError
        When no counted vehicle of the searched frames is there.
    """
    if metric_named(metric).learn is None:
        return None
    low, high = road.carriageway_y
    y = np.concatenate([frame.vehicles.centre_m[frame.counted, 1] for frame in searched])
    if not ((y >= low) & (y <= high)).any():
        raise InputError(
            f"metric {metric!r} looks at the carriageway of [road], y {low:g} to {high:g} m, where no vehicle of the "
            "searched frames is; check [road] and [traffic]"
        )
    return Field(centre_xy_m, radius_m, (low, high))


def _context(field, observation, frames) -> SceneContext:
    """What a metric with a memory learns from."""
    return SceneContext(
        tuple(frame.boxes for frame in frames),
        observation.lattice.directions,
        observation.min_range_m,
        observation.max_range_m,
        field,
    )


def _rows(metric, frame, scorer, seen: Seen, mountings) -> VehicleReturns:
    """What a metric is given: one row for each mounting and vehicle, mounting after mounting."""
    vehicles = scorer.vehicles
    away = vehicles.centre_m[:, :2] - mountings.origin_m[:, None, :2]
    points, owner = (None, None) if seen.returns is None else seen.returns
    return VehicleReturns(
        size_m=np.tile(vehicles.size_m, (len(mountings), 1)),
        count=seen.points.reshape(-1),
        occupancy=seen.occupancy.reshape(-1, 3),
        distance_m=np.hypot(away[..., 0], away[..., 1]).reshape(-1),
        points=points,
        vehicle=owner,
        view=View(mountings, frame.boxes) if VIEW in metric.needs else None,
    )
