"""Which height and tilt each metric would choose: the best of a grid over one scene, metric by metric.

    python scripts/research/metric_choices.py [SCENE.toml] [--sensor RS-16] [--metrics pe-vgop,FILE.py:NAME]

Every metric scores the same mountings on the same searched frames. Beside the best of them stand the share of vehicles
that is detectable there (Eq. 11, for every metric) and Spearman's correlation of the metric's map with PE-VGOP's.
"""

from __future__ import annotations

import numpy as np
from scipy.stats import spearmanr

from arguments import SCENES, overrides_of, parser_of, run_script
from blender_lidar.errors import InputError
from blender_lidar.metrics.catalogue import METRICS, metric_named
from blender_lidar.plugins import short_name
from blender_lidar.run.verdict import map_scores
from blender_lidar.scene.scenario import load_scenario
from blender_lidar.scene.site import prepare
from blender_lidar.scoring.evaluation import site_evaluator
from rival_metrics import OPTIONS as OF_VEHICLES
from scene_metrics import OPTIONS as OF_SCENES

OURS = "pe-vgop"


def main(argv: list[str] | None = None) -> int:
    return run_script("metric_choices", lambda: print_choices(_arguments(argv)))


def print_choices(args):
    """Print the table, a row as soon as it is known."""
    names = [name.strip() for name in args.metrics.split(",")]
    for name in names:
        metric_named(name, "--metrics")
    ours = map_of(args, OURS)
    print(f"{'maximised':<43}{'height [m]':>12}{'tilt [deg]':>12}{'detectable [%]':>16}{'with PE-VGOP':>14}")
    for name in names:
        scores = ours if name == OURS else map_of(args, name)
        best = np.unravel_index(np.argmax(scores.per_vehicle), scores.per_vehicle.shape)
        share = 100.0 * scores.detectable_share[best]
        flat = np.ptp(scores.per_vehicle) <= 1e-12 * np.abs(scores.per_vehicle).max()  # the same wherever it hangs
        alike = np.nan if flat else spearmanr(scores.per_vehicle, ours.per_vehicle, axis=None).statistic
        parts = (f"{scores.height_m[best[0]]:.2f}", f"{scores.tilt_deg[best[1]]:.1f}", f"{share:.1f}")
        chosen = "{:>12}{:>12}{:>16}".format(*(("-",) * 3 if flat else parts))
        print(f"{short_name(name):<43}{chosen}{alike:>14.2f}", flush=True)


def map_of(args, name):
    """The scores of all heights and tilts by one metric."""
    scenario = load_scenario(args.scene, {**overrides_of(args), ("objective", "metric"): (name, "--metrics")})
    site = prepare(scenario)
    space, baseline = scenario.lidar.deployment.spaces[0], scenario.lidar.baseline.as_table()
    others = [baseline[key] or 0.0 for key in space.variables]
    with site_evaluator(site, site.search) as evaluator:
        scores = map_scores(evaluator, space, others, site.plan.search_block)
    if scores is None:
        raise InputError(f"{args.scene}: [deployment] fixes the height or the tilt; allowed: both searched")
    return scores


def _arguments(argv):
    parser = parser_of(__doc__, SCENES / "i80.toml")
    parser.add_argument("--sensor")
    names = (*METRICS, *OF_VEHICLES.values(), *OF_SCENES.values())
    parser.add_argument("--metrics", default=",".join(names), help="divided by commas (default all)")
    return parser.parse_args(argv)


if __name__ == "__main__":
    raise SystemExit(main())
