"""Do metrics follow what real detectors do? Correlations car by car, shapes over distance and the ground's share.

Every metric is held against every detector's performance in every set of cars. The paper's Fig. 5 (detection
performance and PE-VGOP fall linearly with distance, the other metrics logarithmically) and Fig. 6 are made for our
cars.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import NamedTuple

import numpy as np

from ...errors import InputError
from ...metrics.metric import Metric
from ...statistics import FEWEST_BLOCKS, RESAMPLES, interval_90
from .cars import LEARNED, PAPERS, SHARES, comparable, judged_cars, of_bearing, score_cars, taught, training_returns
from .detections import FRAME_COLUMNS, IN_RANGE, PERFORMANCE, TRAINING, Detections
from .labelled import LabelledClouds
from .resampling import (
    BAND_WIDTHS_M,
    FEWEST_IN_BAND,
    Estimate,
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

ALL, ANY = "all", "any"
COMPARED = ("spearman", "partial_spearman", "pearson", "isotonic_r2")
GROUPED = (*BAND_WIDTHS_M, "deciles")
FEWEST_CARS = 10
OTHER_CLEARANCE_M = 0.1  # as `score --assign box` has it
PAPER = {"frames": 3712, "vehicles": 14357, "seconds": 18.0}
"""Section IV: "using the PE-VGOP to evaluate 3,712 frames of data takes only 18 seconds"."""
_NEAREST_M = 0.1  # so that a box about the sensor itself has a logarithm
_DIGITS = 6


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
    table : dict of str to ndarray, (n,)
        Columns of the cars that the detections list: see `cars.score_cars` and `Detections`.
    detectors : tuple of str
    metrics : tuple of Metric
        The first is the one that others are held against.
    settings : Settings
    """

    table: dict[str, np.ndarray]
    detectors: tuple[str, ...]
    metrics: tuple[Metric, ...]
    settings: Settings

    def __len__(self) -> int:
        return len(self.table["frame"])

    def __getitem__(self, name: str) -> np.ndarray:
        """A column, (n,)."""
        return self.table[name]

    def resampling(self, mine: np.ndarray) -> Resampling | None:
        """Resamples of the cars that a mask picks; None with too few of them, or too few clusters, for intervals."""
        return resampling_of({name: column[mine] for name, column in self.table.items()}, self.settings)

    def correlations(
        self, mine: np.ndarray, performance: np.ndarray, weights: np.ndarray
    ) -> dict[str, dict[str, np.ndarray]]:
        """Bootstrap correlations of the metrics of the cars that a mask picks with a detector's performance."""
        merits = {metric.name: metric.merit(self[metric.name][mine]) for metric in self.metrics}
        distance_m, occlusion = (self[name][mine].astype(float) for name in ("distance_m", "occlusion"))
        return bootstrap_correlations(merits, performance, (distance_m, occlusion), distance_m, weights)


@dataclass(frozen=True, slots=True, eq=False)
class Findings:
    """What came of it.

    Attributes
    ----------
    judged : JudgedCars
    sets : dict of str to ndarray of bool, (n,)
        Which cars are looked at together.
    untaught : tuple of str
        Metrics that were left out for want of frames to learn from.
    result : dict
        What `compare.json` holds of it, with an `Estimate` for a value and its interval.
    """

    judged: JudgedCars
    sets: dict[str, np.ndarray]
    untaught: tuple[str, ...]
    result: dict

    @property
    def main(self) -> str:
        """The set that judges."""
        return self.result["main_set"]


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
    training = training_returns(clouds, detections.frames(TRAINING), classes, clearance_m)
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
    sets = car_sets(judged.table)
    main = main_set(sets)
    followed, without_ground = agreements(judged, other, sets, main)
    result = {
        "layout": clouds.layout,
        "frames": len(frames),
        "cars": len(judged),
        "cars_not_listed": len(cars["frame"]) - len(judged),
        "main_set": main,
        "sets": {name: int(member.sum()) for name, member in sets.items()},
        "detectors": {name: _performance(judged, name) for name in judged.detectors},
        "metrics": [
            {key: getattr(one, key) for key in ("name", "label", "unit", "higher_is_better")} for one in metrics
        ],
        "correlations": followed,
        "by_distance": shapes(judged, {name: member for name, member in sets.items() if name in (main, ALL)}),
        "other_ground_clearance": {"ground_clearance_m": other_m, "correlations": without_ground},
        "speed": speed(seconds, len(frames), len(cars["frame"])),
    }
    lacking = {one.name for one in asked} - {one.name for one in metrics}
    return Findings(judged, sets, tuple(name for name in LEARNED if name in lacking), result)


def car_sets(cars: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Which cars are looked at together, by name: each split, all, each kind of labels, each kind within each split.

    Of sets with the same cars only the first is kept; what a detector has not seen comes first, what it learned from
    last. `cars` are columns of the table, perhaps with those of `FRAME_COLUMNS`.
    """
    split = cars.get("split", np.empty(0, dtype=str))
    splits = {name: split == name for name in sorted(set(split.tolist()))}
    sets = sorted(splits.items(), key=lambda one: one[0] == TRAINING)
    sets.append((ALL, np.ones(len(cars["frame"]), dtype=bool)))
    if "label_kind" in cars:
        kind = kinds(cars["label_kind"])
        of_kind = [(name, kind == name) for name in sorted(set(kind.tolist()))]
        within = product(splits.items(), of_kind)
        sets += of_kind + [(f"{of} {name}", part & member) for (of, part), (name, member) in within]
    kept: dict[str, np.ndarray] = {}
    for name, member in sets:
        if member.any() and not any(np.array_equal(member, other) for other in kept.values()):
            kept[name] = member
    return kept


def main_set(sets: Mapping[str, np.ndarray]) -> str:
    """The one that judges: the first that no detector learned from, or all cars where nothing is told."""
    return next((name for name in sets if name != TRAINING), next(iter(sets)))


def resampling_of(cars: Mapping[str, np.ndarray], settings: Settings) -> Resampling | None:
    """Resamples of some cars, (n,) a column; None with too few of them, or too few clusters, for intervals."""
    if len(cars["frame"]) < FEWEST_CARS:
        return None
    drawn = clusters(cars, settings.block_frames)
    return cluster_bootstrap(drawn, settings.seed, settings.resamples) if drawn.number >= FEWEST_BLOCKS else None


def agreements(
    judged: JudgedCars, other: JudgedCars, sets: Mapping[str, np.ndarray], main: str
) -> tuple[list[dict], list[dict]]:
    """How far metrics follow detectors, and what it changes to leave out returns just above the floors of boxes.

    Sets with too few cars or clusters in a detector's range are left out. `other` holds the same cars scored with the
    other ground clearance.

    Returns
    -------
    followed : list of dict
        A row for each detector, set and metric: ``detector, set, metric, cars, resampled``, an `Estimate` for each
        statistic of `COMPARED`, ``groups, pearson, spearman`` of the group means for each of `GROUPED`, and in
        ``less``, by another metric and the statistic, the difference as an `Estimate`.
    without_ground : list of dict
        A row for each detector and metric: the main set under the other clearance.
    """
    followed, without_ground = [], []
    for detector, (of_set, member) in product(judged.detectors, sets.items()):
        mine = member & judged[detector + IN_RANGE]
        performance, resampling = judged[detector + PERFORMANCE][mine], judged.resampling(mine)
        if resampling is None:
            continue
        drawn, weights, fold = resampling
        number = drawn.number
        resampled = {"unit": drawn.unit, "number": number, "intervals_too_narrow": drawn.too_narrow}
        values = judged.correlations(mine, performance, weights)
        for metric in judged.metrics:
            merit = metric.merit(judged[metric.name][mine])
            values[metric.name]["isotonic_r2"] = cross_validated_r2(merit, performance, isotonic, fold, weights)
        rivals = [name for name in dict.fromkeys((judged.metrics[0].name, PAPERS)) if name in values]
        against = {rival: against_one(values, rival, number) for rival in rivals}
        for name, of in values.items():
            row = {"detector": detector, "set": of_set, "metric": name, "cars": len(performance)}
            row |= {"resampled": resampled, **{key: of_correlation(of[key], number) for key in COMPARED[:-1]}}
            row |= {"isotonic_r2": of_resamples(of["isotonic_r2"], number)}
            row |= {by: _grouped(of[by], number) for by in GROUPED}
            followed.append(row | {"less": {rival: held[name] for rival, held in against.items() if name in held}})
        if of_set == main:
            for name, of in other.correlations(mine, performance, weights).items():
                row = {"detector": detector, "set": of_set, "metric": name}
                row |= {key: of_correlation(of[key], number) for key in ("spearman", "pearson")}
                change = of_difference(of["spearman"], values[name]["spearman"], number)
                without_ground.append(row | {"spearman_change": change})
    return followed, without_ground


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
    resampled: Mapping[str, Mapping[str, np.ndarray]], rival: str, number: int
) -> dict[str, dict[str, Estimate]]:
    """Every metric less that rival in the same resamples, by metric and statistic.

    Parameters
    ----------
    resampled : mapping
        By metric and statistic of `COMPARED`: its values, (1 + r,).
    rival : str
    number : int
        Clusters that were resampled.
    """
    held: dict[str, dict[str, Estimate]] = {name: {} for name in resampled if name != rival}
    for statistic in COMPARED:
        apart = {name: of_difference(resampled[name][statistic], resampled[rival][statistic], number) for name in held}
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
    quantities = [((name + PERFORMANCE,), judged[name + IN_RANGE]) for name in judged.detectors]
    quantities.append((tuple(one.name for one in judged.metrics if one.name != "distance"), everywhere))
    bearings = {ANY: everywhere, **of_bearing(judged["bearing_deg"])}
    found = []
    for (of_set, member), (bearing, seen), (names, known) in product(sets.items(), bearings.items(), quantities):
        mine = member & seen & known
        resampling = judged.resampling(mine)
        if resampling is None:
            continue
        (drawn, weights, fold), distance_m = resampling, judged["distance_m"][mine]
        for name in names:
            line, logarithm = (
                cross_validated_r2(x, judged[name][mine], linear, fold, weights)
                for x in (distance_m, np.log(np.maximum(distance_m, _NEAREST_M)))
            )
            row = {"quantity": name, "set": of_set, "bearing": bearing, "cars": len(distance_m)}
            row |= {"clusters": drawn.number, "linear_r2": float(line[0]), "logarithmic_r2": float(logarithm[0])}
            found.append(row | {"linear_less_logarithmic": of_difference(line, logarithm, drawn.number)})
    return found


def _performance(judged: JudgedCars, detector: str) -> dict:
    values = judged[detector + PERFORMANCE][judged[detector + IN_RANGE]]
    mean = float(values.mean()) if len(values) else None
    return {"in_range": len(values), "missed": int((values == 0.0).sum()), "mean_performance": mean}


def speed(seconds: Mapping[str, float], frames: int, cars: int) -> dict[str, dict[str, float]]:
    """Milliseconds of processor time a frame and a car of each stage of `score_cars`, beside the paper's."""
    read, assign, score, others = seconds.values()
    spent = {"read": read, "assign": assign, "pe_vgop": score, "all_metrics": score + others}
    spent |= {"file_to_pe_vgop": read + assign + score, "file_to_all_metrics": read + assign + score + others}
    rows = {stage: (total, frames, cars) for stage, total in spent.items()}
    rows["paper"] = PAPER["seconds"], PAPER["frames"], PAPER["vehicles"]
    return {
        stage: {"ms_per_frame": round(1e3 * total / frames, 4), "ms_per_car": round(1e3 * total / cars, 4)}
        for stage, (total, frames, cars) in rows.items()
    }


# --- Files ------------------------------------------------------------------------------------------------------------


def car_columns(judged: JudgedCars) -> dict[str, np.ndarray]:
    """The table of cars: a row for each."""
    names = ["frame", "label_line", *(name for name in FRAME_COLUMNS if name in judged.table), "class", "distance_m"]
    names += ["occlusion", "truncation", "length_m", "width_m", "height_m", "bearing_deg", "points_in_box", *SHARES]
    names += [metric.name for metric in judged.metrics]
    names += [name + ending for name in judged.detectors for ending in (IN_RANGE, PERFORMANCE)]
    table = {name: judged[name] for name in names}
    return {name: np.round(of, _DIGITS) if of.dtype.kind == "f" else of for name, of in table.items()}


def correlation_table(findings: Findings) -> tuple[list[str], list[list[object]]]:
    """A header, and a row for each detector, set and metric; what is not known is None."""
    rows = []
    for one in findings.result["correlations"]:
        drawn = one["resampled"]
        values = {key: one[key] for key in ("detector", "set", "metric", "cars")}
        values |= {"resampled": drawn["unit"], "clusters": drawn["number"]}
        values |= {"intervals_too_narrow": int(drawn["intervals_too_narrow"])}
        values |= {key: one[key] for key in (*COMPARED, *GROUPED)}
        values |= {f"{key}_less_{rival}": apart for rival, of in one["less"].items() for key, apart in of.items()}
        rows.append({column: cell for name, value in values.items() for column, cell in _cells(name, value)})
    header = list(dict.fromkeys(name for row in rows for name in row))
    return header, [[row.get(name) for name in header] for row in rows]


def _cells(name: str, value: object) -> list[tuple[str, object]]:
    """An entry of a row as columns and cells."""
    if isinstance(value, dict):
        return [cell for key, one in value.items() for cell in _cells(f"{name}_{key}", one)]
    if isinstance(value, Estimate):
        more = [(f"{name}_{key}", plain(one)) for key, one in value._asdict().items() if key != "value"]
        return [(name, plain(value.value)), *(more if value.p_holm is not None else more[:2])]
    return [(name, plain(value))]


def plain(value: object) -> object:
    """What JSON holds: rounded numbers, None for NaN, and a value with its interval for an estimate."""
    if isinstance(value, Estimate):
        interval = [plain(value.low), plain(value.high)] if math.isfinite(value.low) else None
        tested = {} if value.p_holm is None else {"p_above": value.p_above, "p_above_holm": value.p_holm}
        return {"value": plain(value.value), "interval_90": interval, **plain(tested)}
    if isinstance(value, dict):
        return {key: plain(one) for key, one in value.items()}
    if isinstance(value, list):
        return [plain(one) for one in value]
    if isinstance(value, float):
        return round(value, _DIGITS) + 0.0 if math.isfinite(value) else None
    return value


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


def decline(judged: JudgedCars, name: str, values: np.ndarray, mine: np.ndarray, band_m: float) -> Decline | None:
    """One quantity of the cars that a mask picks, (n,) each, by bands of distance; None with less than two bands."""
    distance_m, values = judged["distance_m"][mine], values[mine]
    band = np.floor(distance_m / band_m).astype(np.int64)
    used = np.flatnonzero(np.bincount(band) >= FEWEST_IN_BAND)
    if len(used) < 2:
        return None
    resampling = judged.resampling(mine)
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
    cars = findings.judged
    mine = findings.sets[findings.main] & cars[detector + IN_RANGE]
    performance, metrics = cars[detector + PERFORMANCE][mine], {one.name: one for one in findings.judged.metrics}
    found = []
    for row in findings.result["correlations"]:
        if (row["detector"], row["set"]) == (detector, findings.main):
            metric, values = metrics[row["metric"]], cars[row["metric"]][mine]
            knots, fitted = isotonic_fit(metric.merit(values), performance)
            curve = metric.merit(knots), fitted  # turned back
            found.append(Scatter(metric.name, metric.unit, values, performance, curve, row["spearman"].text()))
    return found
