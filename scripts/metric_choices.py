"""Which height and tilt each metric would choose: the best of a grid over one scene, metric by metric.

    python scripts/metric_choices.py [SCENE.toml] [--sensor RS-16] [--metrics pe-vgop,points]

Every metric scores the same mountings on the same searched frames. Beside the best of them stand the share of vehicles
that is detectable there (Eq. 11, whatever the metric) and Spearman's correlation of the metric's map with PE-VGOP's.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np

from blender_lidar.errors import BlenderLidarError, InputError
from blender_lidar.metrics.catalogue import METRICS, metric_named
from blender_lidar.reality.association import centred_ranks, correlation
from blender_lidar.scenario import load_scenario
from blender_lidar.study.score_map import map_scores
from blender_lidar.study.site import prepare

OURS = "pe-vgop"


def main(argv: list[str] | None = None) -> int:
    args = _arguments(argv)
    try:
        names = [metric_named(name.strip(), "--metrics").name for name in args.metrics.split(",")]
        print_choices(args, names)
    except BlenderLidarError as error:
        print(f"metric_choices: {error}", file=sys.stderr)
        return error.exit_code
    return 0


def print_choices(args, names):
    """Print the table, a row as soon as it is known."""
    ours = map_of(args, OURS)
    print(f"{'maximised':<25}{'height [m]':>12}{'tilt [deg]':>12}{'detectable [%]':>16}{'with PE-VGOP':>14}")
    for name in names:
        scores = ours if name == OURS else map_of(args, name)
        best = np.unravel_index(np.argmax(scores.per_vehicle), scores.per_vehicle.shape)
        share = 100.0 * scores.detectable_share[best]
        alike = together(scores.per_vehicle, ours.per_vehicle)
        chosen = f"{scores.height_m[best[0]]:>12.2f}{scores.tilt_deg[best[1]]:>12.1f}{share:>16.1f}"
        if np.ptp(scores.per_vehicle) <= 1e-12 * np.abs(scores.per_vehicle).max():  # the same wherever it hangs
            chosen = f"{'-':>12}{'-':>12}{'-':>16}"
        print(f"{name:<25}{chosen}{alike:>14.2f}", flush=True)


def map_of(args, name):
    """The scores of all heights and tilts by one metric."""
    given = {("objective", "metric"): (name, "--metrics"), ("sensor", "name"): (args.sensor, "--sensor")}
    scenario = load_scenario(args.scene, {key: value for key, value in given.items() if value[0] is not None})
    site = prepare(scenario)
    with site.evaluator(site.search) as evaluator:
        scores = map_scores(evaluator, scenario.deployment, dict(scenario.baseline), site.plan.search_block)
    if scores is None:
        raise InputError(f"{args.scene}: [deployment] fixes the height or the tilt; allowed: both searched")
    return scores


def together(first, second):
    """Spearman's correlation of two maps; NaN where one of them is flat."""
    once = np.ones((1, first.size))
    return float(correlation(*(centred_ranks(values.ravel(), once) for values in (first, second)), once)[0])


def _arguments(argv):
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scene", nargs="?", default=str(Path(__file__).parents[1] / "scenes" / "i80.toml"))
    parser.add_argument("--sensor")
    parser.add_argument("--metrics", default=",".join(METRICS), help="divided by commas (default all)")
    return parser.parse_args(argv)


if __name__ == "__main__":
    raise SystemExit(main())
