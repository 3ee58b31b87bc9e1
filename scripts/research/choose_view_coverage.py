"""How the form and the constants of view coverage (`metrics/view_coverage.py`) were chosen, to be done again.

    python scripts/research/choose_view_coverage.py --kitti DIR --detections DIR/cars.csv

Cars of the detectors' training split alone are read; no other car has a say. Candidates are three ways to join the top
view with the side and the front view, cells from 0.1 to 0.4 m, and constants h of s(P) = (1 + h) P / (P + h). Each is
held against every detector's performance (confidence x IoU) by the mean of three correlations per car: Spearman's,
Spearman's given distance and occlusion, and Pearson's. So few cars single out no maximum, so that each candidate's mean
is averaged with those of its neighbours in h: the middle of the broadest hill wins, not the highest spike. Resampled
frames tell what that is worth: the forms cannot be told apart. So the root of squares was taken, which is even-handed
between bearings, with the cell and the constant that are best for it.
"""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import replace
from functools import partial

import numpy as np

from arguments import parser_of, run_script
from blender_lidar.errors import InputError
from blender_lidar.metrics.metric import NEEDS_POINTS, Metric
from blender_lidar.metrics.vehicle_metrics import CELL_M, HALF_SHARE, saturated
from blender_lidar.metrics.vgop import occupancy
from blender_lidar.studies.compare.cars import judged_cars, score_cars
from blender_lidar.studies.compare.detections import read_detections
from blender_lidar.studies.compare.detectors import Settings, resampling_of
from blender_lidar.studies.compare.labelled import open_labelled
from blender_lidar.studies.compare.resampling import centred_ranks, correlation, orthogonal, pearson, residual

CELLS_M = (0.1, 0.15, 0.2, 0.25, 0.3, 0.4)
HALF_SHARES = (0.01, 0.02, 0.03, 0.05, 0.07, 0.1, 0.15, 0.2, 0.3, 0.5, 0.7, 1.0)
JOINED = {
    "sum": lambda top, side, front: (top + side + front) / 3.0,
    "better": lambda top, side, front: (top + np.maximum(side, front)) / 2.0,
    "root of squares": lambda top, side, front: (top + np.hypot(side, front)) / (1.0 + math.sqrt(2.0)),
}
SETTINGS = Settings(resamples=500)
CHOSEN = ("root of squares", CELL_M, HALF_SHARE)


def main(argv: list[str] | None = None) -> int:
    return run_script("choose_view_coverage", lambda: _study(argv))


def _study(argv):
    parser = parser_of(__doc__)
    parser.add_argument("--kitti", required=True, metavar="DIR")
    parser.add_argument("--detections", required=True, metavar="CARS.csv", help="with the frames' split beside it")
    args = parser.parse_args(argv)
    show(smoothed(train_criterion(args.kitti, args.detections)))


def train_criterion(kitti, table):
    """The criterion of every candidate on the training split, in every resample: (forms, cells, constants, 1 + r)."""
    clouds, detections = open_labelled(kitti), read_detections(table)
    frames = detections.frames("train")
    if not frames:
        raise InputError(f"{table}: tells no frame of split 'train'; allowed: a column split, here or in frames.csv")
    train = detections.table["split"] == "train"
    mine = replace(detections, table={name: column[train] for name, column in detections.table.items()})
    cars, _ = score_cars(clouds, frames, ["Car"], candidates())
    judged = judged_cars(cars, mine, ["Car"])
    print(f"{len(judged['frame'])} cars in {len(frames)} frames of the training split; no other car was read")
    total = 0.0
    for detector in mine.detectors:
        in_range = judged[f"{detector}_in_range"]
        total = total + of_detector({name: column[in_range] for name, column in judged.items()}, detector)
    return (total / len(mine.detectors)).reshape(len(JOINED), len(CELLS_M), len(HALF_SHARES), -1)


def candidates():
    """A metric for each form, cell and constant."""
    return [
        Metric(
            f"{form} {cell_m} {half}", "", "", True, partial(candidate, form, cell_m, half), frozenset({NEEDS_POINTS})
        )
        for form in JOINED
        for cell_m in CELLS_M
        for half in HALF_SHARES
    ]


def candidate(form, cell_m, half, returns):
    shares = occupancy(returns.points, returns.vehicle, returns.size_m, cell_m)
    return JOINED[form](*saturated(shares, half).T)


def of_detector(cars, detector):
    """Mean of the three correlations of every candidate with one detector, (candidates, 1 + r)."""
    resampling = resampling_of(cars, SETTINGS)
    if resampling is None:
        raise InputError(f"{detector}: too few cars or frames of the training split in its range")
    weights, performance = resampling.weights, cars[f"{detector}_performance"]
    held = orthogonal([centred_ranks(cars[name], weights) for name in ("distance_m", "occlusion")], weights)
    target = centred_ranks(performance, weights)
    left = residual(target, held, weights)
    found = []
    for metric in candidates():
        scores = cars[metric.name]
        ranks = centred_ranks(scores, weights)
        given = correlation(residual(ranks, held, weights), left, weights)
        found.append(correlation(ranks, target, weights) + given + pearson(scores, performance, weights))
    return np.array(found) / 3.0


def smoothed(criterion):
    """Mean over each constant and its neighbours: over two at either end."""
    padded = np.pad(criterion, ((0, 0), (0, 0), (1, 1), (0, 0)), constant_values=np.nan)
    return np.nanmean(np.stack([padded[:, :, :-2], padded[:, :, 1:-1], padded[:, :, 2:]]), axis=0)


def show(criterion):
    names = [(form, cell_m, half) for form in JOINED for cell_m in CELLS_M for half in HALF_SHARES]
    flat = criterion.reshape(len(names), -1)
    print("criterion  form             cell [m]     h")
    for row in np.argsort(-flat[:, 0], kind="stable")[:12]:
        form, cell_m, half = names[row]
        print(f"   {flat[row, 0]:.4f}  {form:15s}  {cell_m:8g}  {half:4g}{'  <- ours' * (names[row] == CHOSEN)}")
    resampled = flat[:, 1:]
    ours = names.index(CHOSEN)
    print("best of each form, less ours, with the middle 90 % of resampled frames")
    for form in JOINED:
        row = max((row for row, name in enumerate(names) if name[0] == form), key=lambda row: flat[row, 0])
        low, high = np.nanquantile(resampled[row] - resampled[ours], [0.05, 0.95])
        apart = flat[row, 0] - flat[ours, 0]
        print(f"   {form:15s}  cell {names[row][1]:g} m, h {names[row][2]:g}: {apart:+.4f} ({low:+.4f} to {high:+.4f})")
    best = Counter(names[row] for row in np.argmax(np.nan_to_num(resampled, nan=-np.inf), axis=0))
    for place, what in enumerate(("form", "cell [m]", "h")):
        share = Counter()
        for name, times in best.items():
            share[name[place]] += times
        told = ", ".join(f"{value} {100 * times / resampled.shape[1]:.0f} %" for value, times in share.most_common())
        print(f"best {what} in {resampled.shape[1]} resamples of frames: {told}")


if __name__ == "__main__":
    raise SystemExit(main())
