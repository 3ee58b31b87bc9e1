"""Do metrics follow what real detectors do? Correlations car by car, shapes over distance and the ground's share.

Every metric is held against every detector's performance in every set of cars. The paper's Fig. 5 (detection
performance and PE-VGOP fall linearly with distance, the other metrics logarithmically) and Fig. 6 are made for our
cars.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ...errors import InputError
from ...metrics.metric import Metric
from ...statistics import FEWEST_BLOCKS, RESAMPLES, interval_90
from .cars import LEARNED, PAPERS, comparable, judged_cars, of_bearing, score_cars, taught, training_cars
from .detections import FRAME_COLUMNS, IN_RANGE, TRAINING, Detections
from .labelled import LabelledClouds
from .resampling import (
    BANDS_M,
    FEWEST_IN_BAND,
    Against,
    Resampling,
    bootstrap_correlations,
    centred_ranks,
    cluster_bootstrap,
    clusters,
    correlation,
    correlation_of_means,
    cross_validated_r2,
    group_means,
    holm,
    isotonic,
    isotonic_fit,
    kinds,
    linear,
    of_correlation,
    of_difference,
    of_resamples,
)

if TYPE_CHECKING:
    import pandas as pd

ALL, ANY = "all", "any"
PERFORMANCE = "_performance"
COMPARED = ("spearman", "partial_spearman", "pearson", "isotonic_r2")
GROUPED = (*BANDS_M, "deciles")
FEWEST_CARS = 10
OTHER_CLEARANCE_M = 0.1  # as `score --assign box` has it
_NEAREST_M = 0.1  # so that a box about the sensor itself has a logarithm


@dataclass(frozen=True, slots=True)
class Settings:
    """What may be asked differently.

    Attributes
    ----------
    classes : tuple of str
        What counts as a car, in the data set's words.
    ground_clearance_m : float
        Points less than this above a box's floor are left out [m].
    block_frames : int
        So many frames are drawn as one, where whole drives are not.
    seed : int
        Of the resamples and folds.
    resamples : int
    """

    classes: tuple[str, ...] = ("Car",)
    ground_clearance_m: float = 0.0
    block_frames: int = 1
    seed: int = 1
    resamples: int = RESAMPLES


@dataclass(frozen=True, slots=True, eq=False)
class JudgedCars:
    """Cars that were scored and that detectors were tried on.

    Attributes
    ----------
    table : DataFrame, (n,)
        The cars that the detections list: see `cars.score_cars` and `Detections`.
    detectors : tuple of str
    metrics : tuple of Metric
        The first is the one that others are held against.
    settings : Settings
    """

    table: pd.DataFrame
    detectors: tuple[str, ...]
    metrics: tuple[Metric, ...]
    settings: Settings

    def __len__(self) -> int:
        return len(self.table)

    def __getitem__(self, name: str) -> np.ndarray:
        """A column, (n,)."""
        return self.table[name].to_numpy()

    def merits(self, mine: np.ndarray) -> dict[str, np.ndarray]:
        """Each metric of the cars that a mask picks, high where it is good."""
        return {metric.name: metric.merit(self[metric.name][mine]) for metric in self.metrics}

    def resampled(
        self, sets: Mapping[str, np.ndarray]
    ) -> Iterator[tuple[str, str, np.ndarray, np.ndarray, Resampling]]:
        """Every detector and set that has enough cars in its range: names, mask, performance and resamples of these."""
        for detector in self.detectors:
            for of_set, member in sets.items():
                mine = member & self[detector + IN_RANGE]
                resampling = resampling_of(self.table[mine], self.settings)
                if resampling is not None:
                    yield detector, of_set, mine, self[detector + PERFORMANCE][mine], resampling


@dataclass(frozen=True, slots=True, eq=False)
class Findings:
    """What came of it; rows hold what `compare.json` has, with an `Estimate` for a value and its interval.

    Attributes
    ----------
    judged : JudgedCars
    about : tuple of str
        As in `Detections`.
    frames : int
        Sweeps that the detections name.
    unlisted : int
        Labelled cars of these sweeps that the detections do not list; they are left out.
    seconds : dict of str to float
        As in `cars.score_cars`.
    untaught : tuple of str
        Metrics that were left out for want of frames to learn from.
    sets : dict of str to ndarray of bool, (n,)
        Which cars are looked at together.
    main : str
        The set that judges.
    agreements : list of dict
        A row for each detector, set and metric.
    shapes : list of dict
        A row for each quantity, set (the main one and all cars) and bearing.
    other_clearance_m : float
        0 where the results leave out ground returns, else `OTHER_CLEARANCE_M`.
    without_ground : list of dict
        A row for each detector and metric: the main set under that other clearance.
    """

    judged: JudgedCars
    about: tuple[str, ...]
    frames: int
    unlisted: int
    seconds: dict[str, float]
    untaught: tuple[str, ...]
    sets: dict[str, np.ndarray]
    main: str
    agreements: list[dict]
    shapes: list[dict]
    other_clearance_m: float
    without_ground: list[dict]


def compare(clouds: LabelledClouds, detections: Detections, metrics: Sequence[Metric], settings: Settings) -> Findings:
    """Score the cars that the detections list, and hold the scores against the detectors.

    Raises
    ------
    InputError, MissingFileError
        Of files that cannot be used or do not belong together.
    """
    for line, frame in zip(*(detections.table[name].tolist() for name in ("line", "frame")), strict=True):
        if frame not in clouds.frames:
            raise InputError(
                f"{detections.path}:{line}: frame {frame!r} is no sweep of {clouds.folder}, which has {len(clouds)}, "
                f"{clouds.frames[0]} to {clouds.frames[-1]}"
            )
    classes, clearance_m, frames = settings.classes, settings.ground_clearance_m, detections.frames()
    training = training_cars(clouds, detections.frames(TRAINING), classes, clearance_m)
    asked, metrics = metrics, tuple(taught(metrics, training))
    if not metrics:
        raise InputError(f"--metrics: {asked[0].name} learns from frames of split {TRAINING}; there are none")
    timed_first = [comparable()[PAPERS], *(one for one in metrics if one.name != PAPERS)]
    other_m = 0.0 if clearance_m > 0.0 else OTHER_CLEARANCE_M
    (cars, seconds), (others, _) = (
        score_cars(clouds, frames, classes, timed_first, least_m) for least_m in (clearance_m, other_m)
    )
    judged, other = (
        JudgedCars(judged_cars(table, detections, classes), detections.detectors, metrics, settings)
        for table in (cars, others)
    )
    sets = car_sets({name: judged[name] for name in detections.about}, len(judged))
    main = main_set(sets)
    return Findings(
        judged=judged,
        about=detections.about,
        frames=len(frames),
        unlisted=len(cars) - len(judged),
        seconds=seconds,
        untaught=tuple(one.name for one in asked if one.name in LEARNED and training is None),
        sets=sets,
        main=main,
        agreements=agreements(judged, sets),
        shapes=shapes(judged, {name: member for name, member in sets.items() if name in (main, ALL)}),
        other_clearance_m=other_m,
        without_ground=without_ground(judged, other, {main: sets[main]}),
    )


def car_sets(about: Mapping[str, np.ndarray], cars: int) -> dict[str, np.ndarray]:
    """Which cars are looked at together, by name: each split, all, each kind of labels, each kind within each split.

    Of sets with the same cars only the first is kept; what a detector has not seen comes first, what it learned from
    last.
    """
    split = about.get("split")
    splits = [] if split is None else sorted(set(split.tolist()))
    sets = [(name, split == name) for name in sorted(splits, key=lambda name: name == TRAINING)]
    sets.append((ALL, np.ones(cars, dtype=bool)))
    if "label_kind" in about:
        kind = kinds(about["label_kind"])
        of_kind = [(name, kind == name) for name in sorted(set(kind.tolist()))]
        sets += of_kind + [(f"{of} {name}", (split == of) & member) for of in splits for name, member in of_kind]
    kept: dict[str, np.ndarray] = {}
    for name, member in sets:
        if member.any() and not any(np.array_equal(member, other) for other in kept.values()):
            kept[name] = member
    return kept


def main_set(sets: Mapping[str, np.ndarray]) -> str:
    """The one that judges: the first that no detector learned from, or all cars where nothing is told."""
    return next((name for name in sets if name != TRAINING), next(iter(sets)))


def resampling_of(cars: pd.DataFrame, settings: Settings) -> Resampling | None:
    """Resamples of some cars; None with too few of them, or too few clusters, for intervals."""
    if len(cars) < FEWEST_CARS:
        return None
    told = {name: cars[name].to_numpy(str) for name in ("frame", *FRAME_COLUMNS) if name in cars}
    drawn = clusters(told["frame"], told, settings.block_frames)
    return cluster_bootstrap(drawn, settings.seed, settings.resamples) if drawn.number >= FEWEST_BLOCKS else None


def _correlations(
    judged: JudgedCars, mine: np.ndarray, performance: np.ndarray, weights: np.ndarray
) -> dict[str, dict[str, np.ndarray]]:
    """Bootstrap correlations of the metrics of the cars that a mask picks with a detector's performance."""
    distance_m, occlusion = judged["distance_m"][mine], judged["occlusion"][mine].astype(float)
    return bootstrap_correlations(judged.merits(mine), performance, (distance_m, occlusion), distance_m, weights)


def agreements(judged: JudgedCars, sets: Mapping[str, np.ndarray]) -> list[dict]:
    """How far metrics follow detectors: a row for each detector, set and metric.

    Sets with too few cars or clusters in a detector's range are left out. A row has ``detector, set, metric, cars,
    resampled``, an `Estimate` for each statistic of `COMPARED`, ``groups, pearson, spearman`` of the group means for
    each of `GROUPED`, and in ``less``, by another metric and the statistic, an `Against`.
    """
    found = []
    for detector, of_set, mine, performance, (drawn, weights, fold) in judged.resampled(sets):
        number = drawn.number
        resampled = {"unit": drawn.unit, "number": number, "intervals_too_narrow": drawn.too_narrow}
        values = _correlations(judged, mine, performance, weights)
        for name, merit in judged.merits(mine).items():
            values[name]["isotonic_r2"] = cross_validated_r2(merit, performance, isotonic, fold, weights)
        others = [name for name in dict.fromkeys((judged.metrics[0].name, PAPERS)) if name in values]
        against = {other: against_one(values, other, number) for other in others}
        for name, of in values.items():
            row = {"detector": detector, "set": of_set, "metric": name, "cars": len(performance)}
            row |= {"resampled": resampled, **{key: of_correlation(of[key], number) for key in COMPARED[:-1]}}
            row |= {"isotonic_r2": of_resamples(of["isotonic_r2"], number)}
            row |= {by: _grouped(of[by], number) for by in GROUPED}
            found.append(row | {"less": {other: held[name] for other, held in against.items() if name in held}})
    return found


def _grouped(means: np.ndarray, number: int) -> dict:
    """Correlation over groups of cars of mean metric and mean performance, (1 + r, 2, g)."""
    there = np.isfinite(means[0, 0])
    groups, spearman = int(there.sum()), math.nan
    if groups >= 3:
        one = np.ones((1, groups))
        spearman = float(correlation(*(centred_ranks(of[there], one) for of in means[0]), one)[0])
    pearson = of_correlation(correlation_of_means(means[:, 0], means[:, 1]), number)
    return {"groups": groups, "pearson": pearson, "spearman": spearman}


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
    held: dict[str, dict[str, Against]] = {name: {} for name in resampled if name != other}
    for statistic in COMPARED:
        apart = {name: of_difference(resampled[name][statistic], resampled[other][statistic], number) for name in held}
        # A metric that orders all cars as another does, such as its logarithm, is no further comparison.
        twins = {name: resampled[name][statistic].tobytes() for name in held}
        p_values = {twin: apart[name].p_above for name, twin in twins.items()}
        adjusted = dict(zip(p_values, holm(list(p_values.values())), strict=True))
        for name, of in held.items():
            of[statistic] = apart[name]._replace(p_holm=adjusted[twins[name]])
    return held


def shapes(judged: JudgedCars, sets: Mapping[str, np.ndarray]) -> list[dict]:
    """Does a quantity fall with distance linearly or logarithmically? Out-of-fold R2 of both regressions.

    A row for every detector's performance (cars in its range) and every metric, among all cars of each set and by
    bearing; those with too few cars or clusters are left out.
    """
    everywhere = np.ones(len(judged), dtype=bool)
    quantities = {name + PERFORMANCE: judged[name + IN_RANGE] for name in judged.detectors}
    quantities |= {one.name: everywhere for one in judged.metrics if one.name != "distance"}
    found = []
    for (of_set, member), (bearing, seen) in product(
        sets.items(), {ANY: everywhere, **of_bearing(judged["bearing_deg"])}.items()
    ):
        drawn: dict[bytes, Resampling | None] = {}  # most quantities are known of the same cars
        for name, known in quantities.items():
            mine = member & seen & known
            if mine.tobytes() not in drawn:
                drawn[mine.tobytes()] = resampling_of(judged.table[mine], judged.settings)
            resampling = drawn[mine.tobytes()]
            if resampling is None:
                continue
            distance_m = judged["distance_m"][mine]
            line, logarithm = (
                cross_validated_r2(x, judged[name][mine], linear, resampling.fold, resampling.weights)
                for x in (distance_m, np.log(np.maximum(distance_m, _NEAREST_M)))
            )
            number = resampling.clusters.number
            row = {"quantity": name, "set": of_set, "bearing": bearing, "cars": len(distance_m), "clusters": number}
            row |= {"linear_r2": float(line[0]), "logarithmic_r2": float(logarithm[0])}
            found.append(row | {"linear_less_logarithmic": of_difference(line, logarithm, number).difference})
    return found


def without_ground(judged: JudgedCars, other: JudgedCars, sets: Mapping[str, np.ndarray]) -> list[dict]:
    """What it changes to leave out the returns just above the floor of a box, which are the ground's.

    A row for every detector, set and metric; `other` holds the same cars scored with the other clearance.
    """
    found = []
    for detector, of_set, mine, performance, (drawn, weights, _) in judged.resampled(sets):
        ours, theirs = (_correlations(cars, mine, performance, weights) for cars in (judged, other))
        for name, of in theirs.items():
            change = of_difference(of["spearman"], ours[name]["spearman"], drawn.number).difference
            row = {"detector": detector, "set": of_set, "metric": name}
            row |= {key: of_correlation(of[key], drawn.number) for key in ("spearman", "pearson")}
            found.append(row | {"spearman_change": change})
    return found


# --- What charts show -------------------------------------------------------------------------------------------------


class Decline(NamedTuple):
    """One quantity over distance, scaled so that its lowest band mean is 0 and its highest 1.

    Attributes
    ----------
    name : str
    distance_m, values : ndarray, (n,)
        Of each car.
    centre_m, mean, low, high : ndarray, (b,)
        Middle of each band, the mean there and the ends of its interval, NaN without one.
    """

    name: str
    distance_m: np.ndarray
    values: np.ndarray
    centre_m: np.ndarray
    mean: np.ndarray
    low: np.ndarray
    high: np.ndarray


def decline(findings: Findings, name: str, values: np.ndarray, mine: np.ndarray, band_m: float) -> Decline | None:
    """One quantity of the cars that a mask picks, (n,) each, by bands of distance; None with less than two bands."""
    distance_m, values = findings.judged["distance_m"][mine], values[mine]
    band = np.floor(distance_m / band_m).astype(np.int64)
    used = np.flatnonzero(np.bincount(band) >= FEWEST_IN_BAND)
    if len(used) < 2:
        return None
    resampling = resampling_of(findings.judged.table[mine], findings.judged.settings)
    weights = np.ones((1, len(values))) if resampling is None else resampling.weights
    means = group_means(values, band, band.max() + 1, weights)[:, used]
    lowest, highest = means[0].min(), means[0].max()
    scale = highest - lowest if highest > lowest else 1.0
    means, values = (means - lowest) / scale, (values - lowest) / scale
    resampled = [column[np.isfinite(column)] for column in means[1:].T]
    low, high = np.array([interval_90(one) if len(one) > 1 else (np.nan, np.nan) for one in resampled]).T
    return Decline(name, distance_m, values, (used + 0.5) * band_m, means[0], low, high)


class Scatter(NamedTuple):
    """One metric against a detector's performance.

    Attributes
    ----------
    name, unit : str
    values, performance : ndarray, (n,)
        Of each car.
    curve : tuple of two ndarrays, (k,)
        Metric and performance along the isotonic regression.
    note : str
        For the corner.
    """

    name: str
    unit: str
    values: np.ndarray
    performance: np.ndarray
    curve: tuple[np.ndarray, np.ndarray]
    note: str


def scatter(findings: Findings, detector: str) -> list[Scatter]:
    """Every metric against a detector among the main set's cars in its range, with Spearman's correlation."""
    mine = findings.sets[findings.main] & findings.judged[detector + IN_RANGE]
    spearman = {
        row["metric"]: row["spearman"]
        for row in findings.agreements
        if (row["detector"], row["set"]) == (detector, findings.main)
    }
    performance = findings.judged[detector + PERFORMANCE][mine]
    found = []
    for metric in findings.judged.metrics:
        if metric.name in spearman:
            values = findings.judged[metric.name][mine]
            knots, fitted = isotonic_fit(metric.merit(values), performance)
            curve = metric.merit(knots), fitted  # turned back
            found.append(Scatter(metric.name, metric.unit, values, performance, curve, spearman[metric.name].text()))
    return found
