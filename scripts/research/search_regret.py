"""How far a search falls short of the exhaustive grid, over several seeds.

    python scripts/research/search_regret.py [SCENE.toml] [--sensor RS-16] [--seeds 11] [--search de-pso]

The exhaustive 26 x 26 grid of heights and tilts is scored once. Regret is the share of the gain over the baseline
that a search leaves to the grid's best point, below 0 where it does better: on the searched frames, and on held-out
frames that are the same for all.
"""

from __future__ import annotations

import sys

import numpy as np

from arguments import SCENES, overrides_of, parser_of, positive, run_script
from blender_lidar.errors import InputError
from blender_lidar.metrics.catalogue import metric_named
from blender_lidar.optimise import READINGS, SEARCHES, run
from blender_lidar.run.optimise import fresh_search
from blender_lidar.run.verdict import map_scores
from blender_lidar.scene.mounting import pose_at
from blender_lidar.scene.scenario import load_scenario
from blender_lidar.scene.site import prepare
from blender_lidar.scoring.evaluation import site_evaluator


def main(argv: list[str] | None = None) -> int:
    return run_script("search_regret", lambda: _study(_arguments(argv)))


def _arguments(argv):
    parser = parser_of(__doc__, SCENES / "i80.toml")
    parser.add_argument("--sensor")
    parser.add_argument("--traffic")
    parser.add_argument("--frames", type=positive)
    parser.add_argument("--seeds", type=positive, default=11)
    parser.add_argument("--search", choices=SEARCHES)
    parser.add_argument("--reading", choices=READINGS)
    return parser.parse_args(argv)


def _study(args):
    overrides, regrets, found_poses = overrides_of(args), [], []
    site = prepare(load_scenario(args.scene, overrides))
    with site_evaluator(site, site.search) as evaluator:
        scenario = site.scenario
        found = map_scores(evaluator, scenario.deployment, scenario.baseline, site.plan.search_block, grid=(26, 26))
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
            found_poses.append(scenario.deployment.pose(result.x))
            pairs = zip(scenario.deployment.variables, result.x, strict=True)
            told = f"{metric.number(result.value, 1)} at {', '.join(f'{key} {value:.2f}' for key, value in pairs)}"
            print(f"seed {seed}: {told}; regret {100 * regrets[-1]:.2f} %", flush=True)
    _print_regrets("searched", regrets)
    if len(site.holdout):
        grid_best = pose_at(found.best_coordinates(scenario.baseline))
        with site_evaluator(site, site.holdout) as evaluator:
            values = evaluator.totals([scenario.baseline_pose, grid_best, *found_poses]).per_vehicle()
        if values[1] > values[0]:
            _print_regrets("held-out", (values[1] - values[2:]) / (values[1] - values[0]))
        else:
            print("regret on held-out frames: none, as the grid's best point gains nothing there")


def _print_regrets(frames, regrets):
    low, middle, high = (100 * value for value in np.quantile(regrets, [0.0, 0.5, 1.0]))
    print(f"regret on {frames} frames, {len(regrets)} seeds: median {middle:.2f} %, from {low:.2f} to {high:.2f} %")


if __name__ == "__main__":
    sys.exit(main())
