"""What it changes to leave out the returns just above the floor of a box, which are the ground's."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ..metrics.metric import Metric
from .agreement import followed_by_name, resampling_of
from .car_sets import CarSet
from .cars import ScoredCars
from .matching import JudgedCars
from .resampled_cars import Draws
from .significance import Difference, Estimate, of_correlation, of_difference


class WithoutGround(NamedTuple):
    """One metric and one detector on the cars of one set, with the other ground clearance.

    Attributes
    ----------
    detector, of_set, metric : str
    spearman, pearson : Estimate
        With the other clearance.
    change : Difference
        Of Spearman's correlation, from the clearance of the results to the other.
    """

    detector: str
    of_set: str
    metric: str
    spearman: Estimate
    pearson: Estimate
    change: Difference


def without_ground(
    judged: JudgedCars, other: ScoredCars, one: CarSet, metrics: Sequence[Metric], draws: Draws
) -> list[WithoutGround]:
    """Of every detector and metric; `other` holds the same cars scored with the other clearance."""
    found = []
    for detector in judged.detectors:
        mine = one.member & detector.in_range
        resampling = resampling_of(judged, mine, draws)
        if resampling is None:
            continue
        number = resampling.clusters.number
        ours, theirs = (
            followed_by_name(judged, detector, mine, resampling, _merits(cars, metrics))
            for cars in (judged.cars, other)
        )
        found += [
            WithoutGround(
                detector.name,
                one.name,
                name,
                of_correlation(theirs[name].spearman, number),
                of_correlation(theirs[name].pearson, number),
                of_difference(theirs[name].spearman, ours[name].spearman, number),
            )
            for name in ours
        ]
    return found


def _merits(cars: ScoredCars, metrics: Sequence[Metric]) -> dict[str, np.ndarray]:
    return {metric.name: metric.merit(cars.scores[metric.name]) for metric in metrics}
