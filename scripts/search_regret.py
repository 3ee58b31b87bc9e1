"""How far a search falls short of the exhaustive grid, over several seeds.

    python scripts/search_regret.py [SCENE.toml] [--sensor RS-16] [--seeds 11] [--search de-pso]

The exhaustive 26 x 26 grid of heights and tilts is scored once. Regret is the share of the gain over the baseline
that a search leaves to the grid's best point, below 0 where it does better: on the searched frames, and on held-out
frames that are the same for all.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np

from blender_lidar.errors import BlenderLidarError, InputError
from blender_lidar.metrics.catalogue import metric_named
from blender_lidar.optimise import READINGS, SEARCHES, run
from blender_lidar.run import fresh_search
from blender_lidar.scenario import load_scenario, pose_at
from blender_lidar.study.score_map import FINE_POINTS, map_scores
from blender_lidar.study.site import prepare


def main(argv: list[str] | None = None) -> int:
    args = _arguments(argv)
    try:
        return _study(args)
    except BlenderLidarError as error:
        print(f"search_regret: {error}", file=sys.stderr)
        return error.exit_code


def _arguments(argv):
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scene", nargs="?", default=str(Path(__file__).parents[1] / "scenes" / "i80.toml"))
    parser.add_argument("--sensor")
    parser.add_argument("--traffic")
    parser.add_argument("--frames", type=_positive)
    parser.add_argument("--seeds", type=_positive, default=11)
    parser.add_argument("--search", choices=SEARCHES)
    parser.add_argument("--reading", choices=READINGS)
    return parser.parse_args(argv)


def _positive(text):
    if not text.isdecimal() or int(text) == 0:
        raise argparse.ArgumentTypeError(f"is {text!r}; allowed: a whole number from 1")
    return int(text)


def _study(args):
    given = {
        ("sensor", "name"): (args.sensor, "--sensor"),
        ("traffic", "path"): (args.traffic, "--traffic"),
        ("traffic", "frames"): (args.frames, "--frames"),
        ("search", "method"): (args.search, "--search"),
        ("objective", "reading"): (args.reading, "--reading"),
    }
    overrides = {key: value for key, value in given.items() if value[0] is not None}
    regrets, found_poses = [], []
    site = prepare(load_scenario(args.scene, overrides))
    with site.evaluator(site.search) as evaluator:
        scenario = site.scenario
        found = map_scores(evaluator, scenario.deployment, scenario.baseline, site.plan.search_block, grid=FINE_POINTS)
        if found is None:
            raise InputError(f"{args.scene}: [deployment] height_m and tilt_x_deg must both be pairs")
        baseline = evaluator.totals([scenario.baseline_pose]).per_vehicle()[0]
        height, tilt, best = found.best
        if not best > baseline:
            raise InputError(f"{args.scene}: no grid point is better than the baseline, so there is no gain to miss")
        metric = metric_named(scenario.objective.metric)
        at, base = f"{height:.1f} m, {tilt:.0f} deg", metric.number(baseline, 1)
        print(f"grid: {metric.amount(best, 1)} per vehicle at {at}; baseline {base}")

        def objective(candidates):
            return evaluator.totals([scenario.deployment.pose(x) for x in candidates]).per_vehicle()

        for seed in range(1, args.seeds + 1):
            seeded = load_scenario(args.scene, {**overrides, ("search", "seed"): (seed, "--seeds")})
            result = run(fresh_search(seeded), objective)
            regrets.append((best - result.value) / (best - baseline))
            mount = ", ".join(
                f"{key} {value:.2f}" for key, value in zip(scenario.deployment.variables, result.x, strict=True)
            )
            found_poses.append(scenario.deployment.pose(result.x))
            print(
                f"seed {seed}: {metric.number(result.value, 1)} at {mount}; regret {100 * regrets[-1]:.2f} %",
                flush=True,
            )
    _print_regrets("searched", regrets)
    if len(site.holdout):
        grid_best = pose_at(found.best_coordinates(scenario.baseline))
        with site.evaluator(site.holdout) as evaluator:
            values = evaluator.totals([scenario.baseline_pose, grid_best, *found_poses]).per_vehicle()
        if values[1] > values[0]:
            _print_regrets("held-out", (values[1] - values[2:]) / (values[1] - values[0]))
        else:
            print("regret on held-out frames: none, as the grid's best point gains nothing there")
    return 0


def _print_regrets(frames, regrets):
    low, middle, high = (100 * value for value in np.quantile(regrets, [0.0, 0.5, 1.0]))
    print(f"regret on {frames} frames, {len(regrets)} seeds: median {middle:.2f} %, from {low:.2f} to {high:.2f} %")


if __name__ == "__main__":
    sys.exit(main())
