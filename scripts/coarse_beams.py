"""How few of the beams still rank mountings, on occupancy cells as they are and on larger ones, and which shapes do.

    python scripts/coarse_beams.py [SCENE.toml] [--sensor RS-16] [--frames 60] [--mountings 150]

What `study.rungs.coarse_observation` rests on. First mountings of Sobol's sequence over [deployment] are scored with
every 4th and every 8th column of beams on few of the searched frames, and ranked against all beams on all of them:
Kendall's tau, weighted towards the best. Then, of as many mountings about the best of these (0.15 m, 5 degrees to
either side) on all frames, how well fewer beams and other shapes correlate with the scene's own detail.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

from blender_lidar.errors import BlenderLidarError
from blender_lidar.optimise.sampling import generator, sobol
from blender_lidar.scenario import load_scenario
from blender_lidar.speed_accuracy.candidates import FIRST, candidates
from blender_lidar.speed_accuracy.ranking import weighted_tau
from blender_lidar.study.fidelity import Fidelity
from blender_lidar.study.rungs import spread_order
from blender_lidar.study.site import Site, prepare
from blender_lidar.world.shapes import DETAILS

STRIDES, FRAMES = (4, 8), (8, 30)
NEAR = {"_m": 0.15, "_deg": 5.0}  # to either side of the best


def main(argv: list[str] | None = None) -> int:
    args = _arguments(argv)
    given = {("sensor", "name"): (args.sensor, "--sensor"), ("traffic", "frames"): (args.frames, "--frames")}
    try:
        scenario = load_scenario(args.scene, {key: value for key, value in given.items() if value[0] is not None})
        print_study(prepare(scenario), args.mountings)
    except BlenderLidarError as error:
        print(f"coarse_beams: {' '.join(str(error).split())}", file=sys.stderr)
        return error.exit_code
    return 0


def print_study(site: Site, mountings: int) -> None:
    """Print both tables, a row as soon as it is known."""
    every, detail = candidates(site.scenario, mountings), site.scenario.model.detail
    order = spread_order(site.plan.search_block, [int(frame.counted.sum()) for frame in site.search])
    with site.evaluator(site.search) as evaluator:

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
    with seen.evaluator(seen.search) as evaluator:
        return evaluator.totals(poses, frames).objective.sum(axis=1)


def _about(site: Site, best: np.ndarray, count: int):
    """Mountings within `NEAR` of the best and the bounds."""
    deployment = site.scenario.deployment
    reach = np.array([next(by for ending, by in NEAR.items() if key.endswith(ending)) for key in deployment.variables])
    lower, upper = np.maximum(best - reach, deployment.lower), np.minimum(best + reach, deployment.upper)
    points = sobol(generator(site.scenario.search.seed), count, lower, upper)
    return tuple(deployment.pose(point) for point in points)


def _arguments(argv):
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0], allow_abbrev=False)
    parser.add_argument("scene", nargs="?", default=str(Path(__file__).parents[1] / "scenes" / "i80.toml"))
    parser.add_argument("--sensor")
    parser.add_argument("--frames", type=_positive, default=60)
    parser.add_argument("--mountings", type=_positive, default=150)
    return parser.parse_args(argv)


def _positive(text):
    if not text.isdecimal() or int(text) < 4:
        raise argparse.ArgumentTypeError(f"is {text!r}; allowed: a whole number from 4")
    return int(text)


if __name__ == "__main__":
    sys.exit(main())
