"""How far each metric follows what each detector made of the cars, set by set."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from ..metrics.metric import Metric
from ..study.statistics import FEWEST_BLOCKS
from .car_sets import FEWEST_CARS, CarSet, Clusters, clusters
from .chosen_metrics import PAPERS
from .detections import Detector
from .matching import JudgedCars
from .resampled_cars import Draws, Followed, ResampledCars, Resampling, isotonic_r2
from .significance import Difference, Estimate, holm, of_correlation, of_difference, of_resamples

ISOTONIC = "isotonic_r2"
COMPARED = ("spearman", "partial_spearman", "pearson", ISOTONIC)


class Against(NamedTuple):
    """A metric less another in one statistic, in the same resamples.

    Attributes
    ----------
    difference : Difference
        Above 0 where the metric follows the detector more closely.
    p_holm : float
        `p_above` adjusted for the number of metrics that are held against that other one; those that give the same in
        every resample count once.
    """

    difference: Difference
    p_holm: float


class Groups(NamedTuple):
    """Correlations of group means: how many groups, Pearson's, Spearman's."""

    number: int
    pearson: Estimate
    spearman: float


class Agreement(NamedTuple):
    """One metric and one detector on the cars of one set.

    Attributes
    ----------
    detector, of_set, metric : str
    cars : int
        Those in the detector's range.
    clusters : Clusters
        What was resampled.
    statistics : dict of str to Estimate
        Those of `COMPARED`.
    groups : dict of str to Groups
        ``bins_5m``, ``bins_10m``, ``deciles``.
    against : dict of str to dict of str to Against
        By the other metric and the statistic.
    """

    detector: str
    of_set: str
    metric: str
    cars: int
    clusters: Clusters
    statistics: dict[str, Estimate]
    groups: dict[str, Groups]
    against: dict[str, dict[str, Against]]


def agreements(judged: JudgedCars, sets: Sequence[CarSet], metrics: Sequence[Metric], draws: Draws) -> list[Agreement]:
    """Of every detector, set and metric; sets with too few cars or clusters in a detector's range are left out."""
    found: list[Agreement] = []
    for detector in judged.detectors:
        for one in sets:
            resampling = resampling_of(judged, one.member & detector.in_range, draws)
            if resampling is not None:
                found += _of_set(judged, detector, one, resampling, metrics)
    return found


def resampling_of(judged: JudgedCars, mine: np.ndarray, draws: Draws) -> Resampling | None:
    """Resamples of the cars that a mask picks; None with too few cars or clusters for intervals."""
    if np.count_nonzero(mine) < FEWEST_CARS:
        return None
    about = {key: told[mine] for key, told in judged.about.items()}
    drawn = clusters(judged.cars.frame[mine], about, draws.block_frames)
    return Resampling(drawn, draws.seed, draws.resamples) if drawn.number >= FEWEST_BLOCKS else None


def followed_by_name(
    judged: JudgedCars,
    detector: Detector,
    mine: np.ndarray,
    resampling: Resampling,
    merits: Mapping[str, np.ndarray],
) -> dict[str, Followed]:
    """How each metric goes with a detector's performance on the cars that a mask picks; `merits` are of all cars.

    The first of the resamples is those cars themselves.
    """
    boxes = judged.cars.boxes.select(mine)
    about = detector.performance[mine], boxes.distance_m, boxes.occlusion.astype(float)
    parts: dict[str, list[Followed]] = {name: [] for name in merits}
    for weights in resampling.in_parts():
        cars = ResampledCars(*about, weights)
        for name, merit in merits.items():
            parts[name].append(cars.followed_by(merit[mine]))
    return {name: Followed.joined(of) for name, of in parts.items()}


def _of_set(
    judged: JudgedCars, detector: Detector, one: CarSet, resampling: Resampling, metrics: Sequence[Metric]
) -> list[Agreement]:
    mine, drawn = one.member & detector.in_range, resampling.clusters
    merits = {metric.name: metric.merit(judged.cars.scores[metric.name]) for metric in metrics}
    followed = followed_by_name(judged, detector, mine, resampling, merits)
    others = [name for name in dict.fromkeys((metrics[0].name, PAPERS)) if name in followed]
    values = {
        name: {statistic: getattr(found, statistic) for statistic in COMPARED if statistic != ISOTONIC}
        | {ISOTONIC: isotonic_r2(merits[name][mine], detector.performance[mine], resampling)}
        for name, found in followed.items()
    }
    against = {other: against_one(values, other, drawn.number) for other in others}
    return [
        Agreement(
            detector=detector.name,
            of_set=one.name,
            metric=name,
            cars=int(mine.sum()),
            clusters=drawn,
            statistics={key: _estimate(key, of, drawn.number) for key, of in values[name].items()},
            groups={
                by: Groups(means.groups, of_correlation(means.pearson, drawn.number), means.spearman)
                for by, means in found.groups.items()
            },
            against={other: held[name] for other, held in against.items() if name in held},
        )
        for name, found in followed.items()
    ]


def against_one(
    resampled: Mapping[str, Mapping[str, np.ndarray]], other: str, number: int
) -> dict[str, dict[str, Against]]:
    """Every metric held against that other one, by metric and statistic.

    Parameters
    ----------
    resampled : mapping
        By metric and statistic of `COMPARED`: its values, (1 + r,).
    other : str
    number : int
        Clusters that were resampled.
    """
    rivals = [name for name in resampled if name != other]
    held: dict[str, dict[str, Against]] = {name: {} for name in rivals}
    for statistic in COMPARED:
        values = {name: of[statistic] for name, of in resampled.items()}
        apart = {name: of_difference(values[name], values[other], number) for name in rivals}
        # A metric that orders all cars as another does, such as its logarithm, is no further comparison.
        twins = {name: values[name].tobytes() for name in rivals}
        p_values = {twin: apart[name].p_above for name, twin in twins.items()}
        adjusted = dict(zip(p_values, holm(list(p_values.values())), strict=True))
        for name in rivals:
            held[name][statistic] = Against(apart[name], adjusted[twins[name]])
    return held


def _estimate(statistic: str, values: np.ndarray, number: int) -> Estimate:
    return (of_resamples if statistic == ISOTONIC else of_correlation)(values, number)
