"""KITTI's cars beside our shapes, and metrics beside what real detectors made of these cars.

    python scripts/research/compare_kitti.py shapes --kitti DIR
    python scripts/research/compare_kitti.py detectors --kitti DIR

`shapes` makes the figures of the first half of docs/evidence/reality.md: PE-VGOP of each car, simulated less real, for
every level of detail and every kind of loss. `detectors` makes those of its second half and of
docs/evidence/reproduction.md: how far metrics of single cars follow confidence x IoU of detectors. DIR is in the layout
of KITTI's object benchmark. `frames.csv` in it has ``frame, split, label_kind`` and perhaps ``drive``; `cars.csv` has
``frame, label_line`` and, for every detector, ``NAME_confidence, NAME_iou3d, NAME_in_range``.

Cars of one frame share light, weather and road, and those of a drive are partly the same, so whole drives are resampled
where a column tells them, else frames.
"""

from __future__ import annotations

import csv
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import NamedTuple

import numpy as np

import rival_metrics
from arguments import counting, parser_of, run_script
from blender_lidar.casting import resolve
from blender_lidar.metrics.assignment import NO_BOX, points_in_boxes
from blender_lidar.metrics.catalogue import PE_VGOP, VIEW_COVERAGE
from blender_lidar.metrics.metric import NEEDS_POINTS, Metric, VehicleReturns, vehicle_returns
from blender_lidar.metrics.vgop import to_vehicle_frame
from blender_lidar.names import DETAILS
from blender_lidar.sensors.imperfections import PERFECT, Imperfections
from blender_lidar.statistics import FEWEST_BLOCKS, interval_90
from blender_lidar.studies.compare import PairedFrame, Setup, chosen, median_interval, resampled_medians
from blender_lidar.studies.recorded import LabelledBoxes
from kitti_sweeps import KITTI_MARGIN_M, kitti_frame, kitti_names, recover_rings
from occupancy_prior import OccupiedFrames, VehiclePrior, box_visibility, reach_probability
from resampled_correlations import (
    Clusters,
    centred_ranks,
    cluster_bootstrap,
    correlation,
    correlation_of_means,
    cross_validated_r2,
    group_means,
    of_correlation,
    of_difference,
    orthogonal,
    pearson,
    residual,
)
from search_judgement import holm
from voxel_grid import VoxelGrid

FEWEST_CARS = 10
BAND_M, FEWEST_IN_BAND = 10.0, 5
CLEARANCES_M = (0.0, 0.1)  # the second as `score --assign box` has it
BEARINGS = {"all": (0.0, 90.1), "end-on": (0.0, 20.0), "oblique": (20.0, 70.0), "side-on": (70.0, 90.1)}
TRAINING = "train"
# Shapes and losses were fitted to KITTI's train split and to these seven other frames with object labels. All others
# decided between fits but entered none.
_TUNED_BESIDE = frozenset(("000001", "000006", "000192", "001985", "002613", "004016", "006542"))
_CELLS = 1 << 18  # of resamples by cars that are worked on at a time: their tables stay in the processor's cache


def main(argv: list[str] | None = None) -> int:
    return run_script("compare_kitti", lambda: _study(argv))


def _study(argv):
    parser = parser_of(__doc__)
    parser.add_argument("what", choices=("shapes", "detectors"))
    parser.add_argument("--kitti", required=True, metavar="DIR")
    parser.add_argument("--class", dest="label", default="Car", help="of shapes: what is compared (default Car)")
    parser.add_argument("--glass-dropout", type=float, default=0.3, help="of shapes: share lost (default 0.3)")
    args = parser.parse_args(argv)
    folder = Path(args.kitti)
    about = {row["frame"]: row for row in rows_of(folder / "frames.csv")}
    lines = shapes(folder, about, args.label, args.glass_dropout) if args.what == "shapes" else detectors(folder, about)
    print("\n".join(lines))


def rows_of(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8-sig", newline="") as stream:
        return list(csv.DictReader(stream))


def clusters(frame: np.ndarray, about: Mapping[str, Mapping[str, str]]) -> Clusters:
    """Drives where `frames.csv` tells three or more, else frames within each kind of labels, of cars (n,)."""
    drive = np.array([about[name].get("drive", "") for name in frame.tolist()])
    if len(np.unique(drive)) >= FEWEST_BLOCKS:
        return Clusters("drive", np.unique(drive, return_inverse=True)[1])
    kind = np.array([kind_of_label(about[name]) for name in frame.tolist()])
    number = np.empty(len(frame), dtype=np.int64)
    for name in np.unique(kind):
        number[kind == name] = np.unique(frame[kind == name], return_inverse=True)[1]
    within = np.char.add(np.char.add(kind, " "), number.astype(str))
    return Clusters("frame", np.unique(within, return_inverse=True)[1])


def kind_of_label(row: Mapping[str, str]) -> str:
    """The word that tells kinds of labels apart, the first but KITTI: ``object label_2 (...)`` is ``object``."""
    return next((word for word in row.get("label_kind", "").split() if word != "KITTI"), "")


# --- Cars beside our shapes -------------------------------------------------------------------------------------------


def losses(glass_dropout: float) -> dict[str, Imperfections]:
    """What the simulation loses, by name: an HDL-64E sees 10 % to 50 m; the shares were fitted to the tuned frames."""
    chance, weak = {"range_noise_m": 0.02, "dropout": 0.05}, {"range_at_10_percent_m": 50.0}
    glass = {"glass_dropout": glass_dropout}
    ways = {"none": {}, "glass": glass, "drop-out": chance, "both": chance | glass, "weak": weak}
    return {name: Imperfections(**given) if given else PERFECT for name, given in ways.items()} | {
        "all": Imperfections(**chance, **glass, **weak)
    }


def shapes(folder: Path, about: Mapping, label: str, glass_dropout: float) -> list[str]:
    """Errors of simulated PE-VGOP: of all cars, of those of the fit, and of the others, which validate."""
    ways = losses(glass_dropout)
    variants = [(detail, lost) for detail, lost in product(DETAILS, ways) if detail != "box" or "glass" not in lost]
    variants = [one for one in variants if one != ("box", "both")]
    setup = Setup(DETAILS, resolve("auto", "caster"), margin_m=KITTI_MARGIN_M, classes=(label,), between_m=(10.0, 50.0))
    names, tables = kitti_names(folder), {one: [] for one in variants}
    with counting(len(names), "frames") as advance:
        for number, name in enumerate(names):
            frame, cut_off = kitti_frame(folder, name)
            rows = chosen(frame.boxes, setup, Counter())
            rows = rows[~cut_off[rows]]
            if len(rows):
                paired = PairedFrame(frame, rows, recover_rings(frame.points), setup, number)
                real, seen = paired.real_columns(), {detail: paired.simulate(detail) for detail in DETAILS}
                for detail, lost in variants:
                    found = paired.columns(*paired.returned(seen[detail], ways[lost]))
                    tables[detail, lost].append({**real, **found})
            advance(1)
    cars = {one: joined(parts) for one, parts in tables.items()}
    frame = next(iter(cars.values()))["frame"]
    fitted, lines = tuned(frame, about), []
    for of_set, mine in {"all": np.ones(len(frame), dtype=bool), "tuned": fitted, "validation": ~fitted}.items():
        if mine.any():
            lines += [
                "",
                *_of_set(of_set, {one: {k: v[mine] for k, v in of.items()} for one, of in cars.items()}, about),
            ]
    return lines[1:]


def tuned(frame: np.ndarray, about: Mapping[str, Mapping[str, str]]) -> np.ndarray:
    """Which cars (n,), by their frames, shapes and losses were fitted to."""
    return np.isin(frame, [name for name in about if about[name].get("split") == TRAINING or name in _TUNED_BESIDE])


def _of_set(name, cars, about):
    some = next(iter(cars.values()))
    drawn = clusters(some["frame"], about)
    hidden = (some["hidden_share"] * some["rays"]).sum() / some["rays"].sum()
    number, frames = len(some["frame"]), len(np.unique(some["frame"]))
    lines = [
        f"{name}: {number} cars in {frames} frames, {drawn.number} resampled {drawn.unit}s; real PE-VGOP "
        f"{np.median(some['real_entropy_bits']):.3f} bits; {100 * hidden:.0f} % of the rays are hidden",
        "  detail    lost      median error (90 %)        bias, and from 30 m on  P errs top side front",
    ]
    errors = {one: of["simulated_entropy_bits"] - of["real_entropy_bits"] for one, of in cars.items()}
    for (detail, lost), error in errors.items():
        of, far = cars[detail, lost], some["distance_m"] >= 30.0
        views = [
            np.median(np.abs(of[f"simulated_p_{view}"] - of[f"real_p_{view}"])) for view in ("top", "side", "front")
        ]
        bias = " ".join(f"{np.median(values):+.3f}" if len(values) else "-" for values in (error, error[far]))
        text = _with_ends(median_interval(np.abs(error), drawn.of_car))
        lines.append(f"  {detail:8s}  {lost:8s}  {text:25s}  {bias:22s}  {' '.join(f'{one:.3f}' for one in views)}")
    pairs = [(("body", "none"), ("body", "weak")), *(((one, "weak"), ("body", "weak")) for one in ("box", "detailed"))]
    for first, second in pairs:
        both = np.abs([errors[first], errors[second]])
        resampled = resampled_medians(both, drawn.of_car)
        apart = {"median": np.subtract(*np.median(both, axis=1)), "interval_90": None}
        if resampled is not None:
            apart["interval_90"] = interval_90(resampled[0] - resampled[1])
        lines.append(f"  {', '.join(first)} errs by {_with_ends(apart, '+')} more than {', '.join(second)}")
    return lines


def _with_ends(found, sign=""):
    ends = found["interval_90"]
    return f"{found['median']:{sign}.3f}" + (f" ({ends[0]:{sign}.3f} to {ends[1]:{sign}.3f})" if ends else "")


def joined(tables: Sequence[Mapping[str, np.ndarray]]) -> dict[str, np.ndarray]:
    return {name: np.concatenate([table[name] for table in tables]) for name in tables[0]}


# --- Metrics of single cars -------------------------------------------------------------------------------------------

LOG_PE_VGOP = Metric(
    "log-pe-vgop", "", "", higher_is_better=True, score=lambda returns: np.log(PE_VGOP.values(returns) + 0.001)
)


def of_single_cars() -> list[Metric]:
    """View coverage and PE-VGOP first, then their rivals."""
    return [VIEW_COVERAGE, PE_VGOP, LOG_PE_VGOP, *(getattr(rival_metrics, name) for name in rival_metrics.NAMES)]


def learned(training: Sequence[VehicleReturns]) -> list[Metric]:
    """Metrics that are published for a region, in a form for one car: their prior is of the training frames' cars."""
    first = np.cumsum([0, *map(len, training[:-1])]).tolist()
    vehicle = np.concatenate([one.vehicle + row for one, row in zip(training, first, strict=True)])
    points, size_m = (np.concatenate([getattr(one, name) for one in training]) for name in ("points", "size_m"))
    prior = VehiclePrior.learn(vehicle_returns(points, vehicle, size_m))
    scores = {"covered-entropy-per-car": prior.covered_entropy, "s-mig-per-car": prior.s_mig}
    scores |= {"m-sog-per-car": prior.m_sog}
    made = [Metric(name, "", "", True, score, frozenset({NEEDS_POINTS})) for name, score in scores.items()]
    visible = expected_visibility([one.frame for one in training])
    return [*made, Metric("expected-visibility-per-car", "", "", True, visible)]


def expected_visibility(frames: Sequence[LabelledBoxes]) -> Callable[[VehicleReturns], np.ndarray]:
    """Expected visibility of single cars: mean, over a box's voxels, of the probability that a beam gets there.

    The prior of a voxel of 0.4 m, in the sensor's frame, is the share of training frames with a labelled car in it. A
    beam goes through the centre of every voxel of a car: how densely a sensor samples does not enter, nor do the car's
    returns. Cars beyond 80 m are not looked for.
    """
    grid = VoxelGrid.covering((-80.0, -80.0, -3.2), np.array([80.0, 80.0, 2.0]), 0.4)

    def inside(boxes: LabelledBoxes) -> np.ndarray:
        return grid.in_boxes(boxes.centre_m, boxes.size_m, boxes.heading_rad)

    prior = OccupiedFrames([inside(frame) for frame in frames], len(grid)).prior

    def visibility(returns: VehicleReturns) -> np.ndarray:
        boxes, origin = returns.frame, np.zeros(3)  # where the LiDAR is
        way = grid.centres(inside(boxes))
        beams = way / np.linalg.norm(way, axis=1, keepdims=True)
        reached = reach_probability(grid, prior, origin, beams, 160.0)
        return box_visibility(grid, reached, boxes.centre_m, boxes.size_m, boxes.heading_rad)

    return visibility


def cars_of(folder: Path, name: str, clearance_m: float) -> tuple[VehicleReturns, dict[str, np.ndarray]]:
    """Returns of a frame's cars in the frame of each, and columns of the cars, (n,) each.

    Boxes of other classes take part, so that a point of a van that a car's box overlaps goes to the nearer one.
    """
    frame, _ = kitti_frame(folder, name)
    row = points_in_boxes(frame.points, frame.boxes.centre_m, frame.boxes.size_m, frame.boxes.heading_rad, clearance_m)
    mine = frame.boxes.of_class(("Car",))
    number = np.full(len(mine) + 1, NO_BOX, dtype=np.int64)  # the last is for points in no box
    number[:-1][mine] = np.arange(mine.sum())
    boxes, row = frame.boxes.select(mine), number[row]
    inside = np.flatnonzero(row != NO_BOX)
    local = to_vehicle_frame(frame.points[inside], boxes.centre_m, boxes.heading_rad, row[inside])
    distance_m = np.hypot(boxes.centre_m[:, 0], boxes.centre_m[:, 1])
    returns = replace(vehicle_returns(local, row[inside], boxes.size_m, distance_m), frame=boxes)
    label = (folder / "label_2" / f"{name}.txt").read_text(encoding="utf-8").splitlines()
    sight = np.arctan2(boxes.centre_m[:, 1], boxes.centre_m[:, 0])
    return returns, {
        "frame": np.full(len(boxes), name),
        "label_line": boxes.vehicle_id,
        "distance_m": distance_m,
        "occlusion": np.array([float(label[line].split()[2]) for line in boxes.vehicle_id.tolist()]),
        "bearing_deg": np.degrees(np.arccos(np.clip(np.abs(np.cos(boxes.heading_rad - sight)), 0.0, 1.0))),
    }


# --- Metrics beside detectors -----------------------------------------------------------------------------------------


class JudgedCars(NamedTuple):
    """Cars that were scored and that detectors were tried on: columns (n,), metrics, and what is said of frames."""

    table: dict[str, np.ndarray]
    metrics: list[Metric]
    about: Mapping[str, Mapping[str, str]]

    def resampling(self, mine: np.ndarray) -> tuple[Clusters, np.ndarray, np.ndarray] | None:
        """Clusters, weights (1 + r, n) and folds of the cars that a mask picks; None with too few for intervals."""
        if mine.sum() < FEWEST_CARS:
            return None
        drawn = clusters(self.table["frame"][mine], self.about)
        return cluster_bootstrap(drawn) if drawn.number >= FEWEST_BLOCKS else None


def judge(folder: Path, about: Mapping, clearance_m: float) -> JudgedCars:
    """Score every car of `cars.csv`; a missed car's performance is 0."""
    listed = {(row["frame"], int(row["label_line"])): row for row in rows_of(folder / "cars.csv")}
    names = sorted({frame for frame, _ in listed})
    found = {name: cars_of(folder, name, clearance_m) for name in names}
    training = [found[name][0] for name in names if about[name].get("split") == TRAINING]
    metrics = of_single_cars() + learned(training)
    table = joined(
        [{**columns, **{one.name: one.values(returns) for one in metrics}} for returns, columns in found.values()]
    )
    keys = list(zip(table["frame"].tolist(), table["label_line"].tolist(), strict=True))
    kept = np.array([key in listed for key in keys])
    table = {name: column[kept] for name, column in table.items()}
    rows = [listed[key] for key in keys if key in listed]
    for name in (key.removesuffix("_confidence") for key in rows[0] if key.endswith("_confidence")):
        table[f"{name}_performance"] = np.array(
            [float(row[f"{name}_confidence"]) * float(row[f"{name}_iou3d"]) for row in rows]
        )
        table[f"{name}_in_range"] = np.array([float(row.get(f"{name}_in_range", 1)) > 0 for row in rows])
    return JudgedCars(table, metrics, about)


def car_sets(cars: JudgedCars) -> dict[str, np.ndarray]:
    """The cars of each split, those of the validating split's object labels alone, and all."""
    rows = [cars.about[name] for name in cars.table["frame"].tolist()]
    split = np.array([row["split"] for row in rows])
    of_object = np.array([kind_of_label(row) == "object" for row in rows])
    val = split != TRAINING
    return {"val": val, "val object": val & of_object, TRAINING: ~val, "all": np.ones(len(rows), dtype=bool)}


def detectors(folder: Path, about: Mapping) -> list[str]:
    """All that reproduction.md says of detectors, by detector and set of cars."""
    cars, other = (judge(folder, about, clearance_m) for clearance_m in CLEARANCES_M)
    sets, lines = car_sets(cars), []
    names = [key.removesuffix("_performance") for key in cars.table if key.endswith("_performance")]
    for name, (of_set, member) in product(names, sets.items()):
        mine = member & cars.table[f"{name}_in_range"]
        resampling = cars.resampling(mine)
        if resampling is not None:
            lines += ["", *_agreement(cars, name, of_set, mine, resampling)]
            if of_set == "val":
                lines += [_without_ground(cars, other, name, mine, resampling), _around_a_performance(cars, name, mine)]
    for of_set in ("val", "all"):
        lines += ["", *_by_distance(cars, names, of_set, sets[of_set])]
    return lines[1:]


def _agreement(cars, name, of_set, mine, resampling):
    """Correlations of every metric with a detector, and by how much each exceeds view coverage and PE-VGOP."""
    drawn, weights, _ = resampling
    number = drawn.number
    values = correlations(cars, name, mine, weights)
    lines = [
        f"{name}, {of_set}: {mine.sum()} cars, {number} resampled {drawn.unit}s",
        f"  {'':28s}{'Spearman':23s}{'given distance, occlusion':27s}{'Pearson':23s}10 m bins, Pearson",
    ]
    for metric, of in values.items():
        parts = (of_correlation(of[key], number).text() for key in ("spearman", "partial", "pearson", "bins"))
        one, two, three, four = parts
        lines.append(f"  {metric:28s}{one:23s}{two:27s}{three:23s}{four} ({of['groups']})")
    for rival, statistic in product((VIEW_COVERAGE.name, PE_VGOP.name), ("spearman", "pearson")):
        apart = {
            metric: of_difference(of[statistic], values[rival][statistic], number)
            for metric, of in values.items()
            if metric != rival
        }
        # A metric that orders all cars as another does, such as its logarithm, is no further comparison.
        twins = {metric: values[metric][statistic].tobytes() for metric in apart}
        p_values = {twin: apart[metric].p_above for metric, twin in twins.items()}
        adjusted = dict(zip(p_values, holm(list(p_values.values())), strict=True))
        many = int(np.isfinite(list(p_values.values())).sum())
        lines.append(f"  less {rival}, {statistic}; p, and by Holm's correction for {many}")
        for metric, one in apart.items():
            if one.low > 0.0 or one.value > 0.0:
                lines.append(f"    {metric:26s}{one.text(3, '+'):28s}{one.p_above:.4f} {adjusted[twins[metric]]:.4f}")
    return lines


def _without_ground(cars, other, name, mine, resampling):
    drawn, weights, _ = resampling
    kept, left_out = (correlations(of, name, mine, weights)[PE_VGOP.name]["spearman"] for of in (cars, other))
    change = of_difference(left_out, kept, drawn.number).text(3, "+")
    return (
        f"  without what is less than {CLEARANCES_M[1]} m above a floor, Spearman of {PE_VGOP.name} changes by {change}"
    )


def _around_a_performance(cars, name, mine):
    performance = cars.table[f"{name}_performance"]
    near = mine & (performance >= 0.65) & (performance <= 0.75)
    lines = (
        f"{metric.name} {np.std(of) / abs(np.mean(of)):.1f}"
        for metric in cars.metrics
        for of in [cars.table[metric.name][near]]
        if np.mean(of) != 0.0
    )
    return f"  coefficient of variation of the {near.sum()} cars at 0.65 to 0.75: {', '.join(lines)}"


def _by_distance(cars, names, of_set, member):
    """Out-of-fold R2 of a line over distance less that of a logarithm, by bearing."""
    lines = [f"{of_set}: R2 of a line less that of a logarithm of distance, by bearing: {', '.join(BEARINGS)}"]
    quantities = {f"{name}_performance": cars.table[f"{name}_in_range"] for name in names}
    quantities |= {one.name: np.ones(len(member), dtype=bool) for one in cars.metrics if one.name != "distance"}
    for quantity, known in quantities.items():
        parts = []
        for low, high in BEARINGS.values():
            mine = member & known & (cars.table["bearing_deg"] >= low) & (cars.table["bearing_deg"] < high)
            resampling = cars.resampling(mine)
            if resampling is None:
                parts.append("-")
                continue
            drawn, weights, fold = resampling
            x, y = cars.table["distance_m"][mine], cars.table[quantity][mine]
            line, logarithm = (cross_validated_r2(of, y, fold, weights) for of in (x, np.log(np.maximum(x, 0.1))))
            parts.append(of_difference(line, logarithm, drawn.number).text(2, "+"))
        lines.append(f"  {quantity:28s}" + "".join(f"{one:25s}" for one in parts).rstrip())
    return lines


def correlations(cars: JudgedCars, name: str, mine: np.ndarray, weights: np.ndarray) -> dict[str, dict]:
    """Correlations of metrics with a detector's performance in every resample, by metric.

    ``spearman``, ``pearson`` and ``partial``, (r,), ranks being made in each resample; partial is Pearson's r of the
    residuals of least squares of the ranks on those of distance and occlusion. ``bins``, (r,), is Pearson's r of the
    means of bands of 10 m with enough cars, of which there are ``groups``.
    """
    performance, distance_m, occlusion = (
        cars.table[key][mine] for key in (f"{name}_performance", "distance_m", "occlusion")
    )
    band = np.floor(distance_m / BAND_M).astype(np.int64)
    used = np.flatnonzero(np.bincount(band) >= FEWEST_IN_BAND)
    found: dict[str, dict[str, list]] = {one.name: {} for one in cars.metrics}
    rows = max(_CELLS // weights.shape[1], 1)
    for part in (weights[first : first + rows] for first in range(0, len(weights), rows)):
        target = centred_ranks(performance, part)
        controls = orthogonal([centred_ranks(values, part) for values in (distance_m, occlusion)], part)
        left = residual(target, controls, part)
        for one in cars.metrics:
            merit = one.merit(cars.table[one.name][mine])
            ranks = centred_ranks(merit, part)
            means = [group_means(of, band, band.max() + 1, part)[:, used] for of in (merit, performance)]
            values = {
                "spearman": correlation(ranks, target, part),
                "partial": correlation(residual(ranks, controls, part), left, part),
                "pearson": pearson(merit, performance, part),
                "bins": correlation_of_means(*means),
            }
            for key, value in values.items():
                found[one.name].setdefault(key, []).append(value)
    return {
        metric: {"groups": len(used), **{key: np.concatenate(parts) for key, parts in of.items()}}
        for metric, of in found.items()
    }


if __name__ == "__main__":
    raise SystemExit(main())
