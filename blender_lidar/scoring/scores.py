"""Scores of what mountings see: each vehicle's value by the chosen metric, and what it adds to the objective."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ..metrics.catalogue import metric_named
from ..metrics.metric import NEEDS_POINTS, VehicleReturns
from ..optimise.objective import detectable, vehicle_score
from ..scene.observation import Observation, Scoring
from ..sensors.pose import Pose
from ..traffic.boxes import Boxes
from .frame_scorer import FrameScorer, Seen


class Scored(NamedTuple):
    """What s layouts make of the n counted vehicles of one frame.

    Attributes
    ----------
    seen : Seen
        Returns and occupancies.
    values : ndarray, (s, n)
        The metric, in its own unit.
    detectable : ndarray of bool, (s, n)
        Eq. 11.
    objective : ndarray, (s, n)
        What each vehicle adds to the objective (Eq. 10), times its weight.
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
    frames : sequence of Boxes
        All that will be scored: a metric with a memory learns from them, once.
    """

    def __init__(self, scoring: Scoring, observation: Observation, frames: Sequence[Boxes]) -> None:
        self._scoring, self._metric = scoring, metric_named(scoring.metric)
        if self._metric.learn is not None:
            self._metric = replace(self._metric, score=self._metric.learn(frames, observation))

    def of(self, frame: Boxes, scorer: FrameScorer, layouts: Sequence[Sequence[Pose]]) -> Scored:
        """Score s layouts, given by the poses of their LiDARs, on the frame of a scorer."""
        return self.of_seen(frame, scorer, scorer.see(layouts, keep_returns=self.needs_returns), layouts)

    @property
    def needs_returns(self) -> bool:
        """Whether the metric asks for the returns themselves."""
        return NEEDS_POINTS in self._metric.needs

    def of_seen(self, frame: Boxes, scorer: FrameScorer, seen: Seen, layouts: Sequence[Sequence[Pose]]) -> Scored:
        """As `of`, given what the layouts saw, with the returns where the metric asks for them."""
        scoring, metric = self._scoring, self._metric
        noticed = detectable(seen.occupancy, scoring.threshold, scoring.view)
        rows = _rows(frame, scorer, seen, layouts, noticed)
        values = metric.values(rows).reshape(noticed.shape)
        objective = vehicle_score(metric.merit(values), noticed, scoring.loss, scoring.reading)
        return Scored(seen, values, noticed, objective * frame.counted_weight)


def _rows(frame, scorer, seen: Seen, layouts, noticed) -> VehicleReturns:
    """What a metric is given: one row for each layout and vehicle, layout after layout."""
    vehicles = scorer.vehicles
    left_out = np.full(3, np.inf)
    origin = [[left_out if pose is None else pose.position for pose in layout] for layout in layouts]
    origin = np.array(origin).reshape(len(layouts), -1, 3)
    away = vehicles.centre_m[:, :2] - origin[:, :, None, :2]
    points, owner = (None, None) if seen.returns is None else seen.returns
    return VehicleReturns(
        size_m=np.tile(vehicles.size_m, (len(layouts), 1)),
        count=seen.points.reshape(-1),
        occupancy=seen.occupancy.reshape(-1, 3),
        distance_m=np.hypot(away[..., 0], away[..., 1]).min(axis=1, initial=np.inf).reshape(-1),
        points=points,
        vehicle=owner,
        frame=frame,
        layouts=layouts,
        detectable=noticed.reshape(-1),
        cell_growth=scorer.cell_growth,
    )
