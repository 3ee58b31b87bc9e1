"""How few of the beams still rank mountings, on occupancy cells as they are and on larger ones, and which shapes do.

    python scripts/research/coarse_beams.py [SCENE.toml] [--sensor RS-16] [--frames 60] [--mountings 150]

What `fidelity.coarse_observation` rests on. First mountings of Sobol's sequence over [deployment] are scored with
every 4th and every 8th column of beams on few of the searched frames, and ranked against all beams on all of them:
Kendall's tau, weighted towards the best. Then, of as many mountings about the best of these (0.15 m, 5 degrees to
either side) on all frames, how well fewer beams and other shapes correlate with the scene's own detail.
"""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np

from arguments import SCENES, overrides_of, parser_of, positive, run_script
from blender_lidar.scene.scenario import load_scenario
from blender_lidar.scene.site import Site, prepare
from blender_lidar.scoring.evaluation import site_evaluator
from blender_lidar.scoring.fidelity import Fidelity, spread_order
from blender_lidar.studies.effects import FIRST, candidates, sobol, weighted_tau
from blender_lidar.world.shapes import DETAILS

STRIDES, FRAMES = (4, 8), (8, 30)
NEAR = {"_m": 0.15, "_deg": 5.0}  # to either side of the best


def main(argv: list[str] | None = None) -> int:
    return run_script("coarse_beams", lambda: print_study(_arguments(argv)))


def print_study(args) -> None:
    """Print both tables, a row as soon as it is known."""
    site, mountings = prepare(load_scenario(args.scene, overrides_of(args))), args.mountings
    every, detail = candidates(site.scenario, mountings), site.scenario.world.detail
    order = spread_order(site.plan.search_block, [int(frame.counted.sum()) for frame in site.search])
    with site_evaluator(site, site.search) as evaluator:

        def scores(poses, fidelity=None, frames=order):
            return evaluator.totals(poses, frames, fidelity).objective.sum(axis=1)

        truth = scores(every.poses[FIRST:])
        print(f"{site.model.name}, {mountings} mountings, beside all beams on {len(order)} frames: weighted tau")
        print(f"{'':<34}{'cells as they are':>20}{'larger cells':>20}", flush=True)
        for stride in STRIDES:
            fidelity = Fidelity(detail, stride)
            for count in FRAMES:
                some = order[:count]
                larger = weighted_tau(scores(every.poses[FIRST:], fidelity, some), truth)
                as_is = weighted_tau(_on_cells_as_they_are(site, every.poses[FIRST:], fidelity, some), truth)
                name = f"{detail}, every {stride}th column, {len(some)} frames"
                print(f"{name:<34}{as_is:>20.2f}{larger:>20.2f}", flush=True)
        near = _about(site, every.points[int(np.argmax(truth))], mountings)
        truth = scores(near)
        print(f"{mountings} mountings about the best, all frames: correlation with {detail}, all beams; larger cells")
        for shape in [name for name in DETAILS if DETAILS.index(name) <= DETAILS.index(detail)]:
            for stride in (1, 2, *STRIDES):
                fidelity = Fidelity(shape, stride)
                if fidelity != Fidelity(detail):
                    print(f"{fidelity.text:<54}{np.corrcoef(scores(near, fidelity), truth)[0, 1]:>20.2f}", flush=True)


def _on_cells_as_they_are(site: Site, poses, fidelity: Fidelity, frames) -> np.ndarray:
    seen = replace(site, observation=fidelity.observed(site.observation))
    with site_evaluator(seen, seen.search) as evaluator:
        return evaluator.totals(poses, frames).objective.sum(axis=1)


def _about(site: Site, best: np.ndarray, count: int):
    """Mountings within `NEAR` of the best and the bounds."""
    deployment = site.scenario.deployment
    reach = np.array([next(by for ending, by in NEAR.items() if key.endswith(ending)) for key in deployment.variables])
    lower, upper = np.maximum(best - reach, deployment.lower), np.minimum(best + reach, deployment.upper)
    points = sobol(site.scenario.search.seed, count, lower, upper)
    return tuple(deployment.pose(point) for point in points)


def _arguments(argv):
    parser = parser_of(__doc__, SCENES / "i80.toml")
    parser.add_argument("--sensor")
    parser.add_argument("--frames", type=positive, default=60)
    parser.add_argument("--mountings", type=positive, default=150)
    return parser.parse_args(argv)


if __name__ == "__main__":
    sys.exit(main())
