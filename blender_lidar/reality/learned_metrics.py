"""S-MIG, M-SOG and expected visibility of single cars: metrics with a prior of where cars are or return from.

They are published for a region; `metrics.vehicle_prior` and `car_visibility` say in which form they score a car. The
prior is learned from the frames that detectors learned from, and frozen before any other car is scored.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from ..metrics.metric import POINTS, VIEW, Metric
from ..metrics.vehicle_prior import VehiclePrior
from .car_visibility import CarVisibility
from .cars import TrainingCars

_NEEDS = frozenset({POINTS})
COVERED_ENTROPY = Metric(
    "covered-entropy-per-car", "entropy of the voxels hit", "nats", higher_is_better=True, needs=_NEEDS
)
S_MIG = Metric("s-mig-per-car", "S-MIG of a car, as published", "nats", higher_is_better=True, needs=_NEEDS)
M_SOG = Metric("m-sog-per-car", "M-SOG of a car, as published", "nats", higher_is_better=True, needs=_NEEDS)
EXPECTED_VISIBILITY = Metric(
    "expected-visibility-per-car", "expected visibility of a car", "", higher_is_better=True, needs=frozenset({VIEW})
)
LEARNED = {metric.name: metric for metric in (COVERED_ENTROPY, S_MIG, M_SOG, EXPECTED_VISIBILITY)}
"""Without a score until they are `taught`."""


def taught(metrics: Sequence[Metric], training: TrainingCars | None) -> list[Metric]:
    """The metrics, those of `LEARNED` with what the training cars taught them; left out where there is no such car."""
    if training is None:
        return [metric for metric in metrics if metric.name not in LEARNED]
    prior = VehiclePrior.learn(training.returns)
    scores = {
        COVERED_ENTROPY.name: prior.covered_entropy,
        S_MIG.name: prior.s_mig,
        M_SOG.name: prior.m_sog,
        EXPECTED_VISIBILITY.name: CarVisibility(training.frames),
    }
    return [replace(one, score=scores[one.name]) if one.name in LEARNED else one for one in metrics]
