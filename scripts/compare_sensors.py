"""Where each sensor wants to hang on the same traffic, and how certain the order of their tilts is.

    python scripts/compare_sensors.py [SCENE.toml] [--sensors RS-16,RS-32,RS-80] [--traffic FILE] [--frames N]

Every sensor is scored on the whole 26 x 26 grid of heights and tilts over the same frames. Blocks of time, longer
than the longest transit among the sensors, are resampled jointly: in each resample all sensors see the same traffic,
and each takes its best grid point.
"""

from __future__ import annotations

import argparse
import itertools
import sys
from pathlib import Path

import numpy as np

from blender_lidar.commands.options import parse_frames
from blender_lidar.errors import BlenderLidarError, InputError
from blender_lidar.scenario import load_scenario
from blender_lidar.study.score_map import FINE_POINTS, map_scores
from blender_lidar.study.site import prepare
from blender_lidar.study.statistics import interval_90

SEED = 1


def main(argv: list[str] | None = None) -> int:
    args = _arguments(argv)
    try:
        maps = _maps(args)
    except BlenderLidarError as error:
        print(f"compare_sensors: {error}", file=sys.stderr)
        return error.exit_code
    _print(maps)
    return 0


def _arguments(argv):
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scene", nargs="?", default=str(Path(__file__).parents[1] / "scenes" / "i80.toml"))
    parser.add_argument("--sensors", default="RS-16,RS-32,RS-80")
    parser.add_argument("--traffic")
    parser.add_argument("--frames", type=int)
    parser.add_argument("--frame-ids")
    parser.add_argument("--caster")
    return parser.parse_args(argv)


def _maps(args):
    """The score map of each sensor, over the same frames and blocks."""
    sensors = args.sensors.split(",")
    block_s = max(prepare(_scenario(args, sensor)).plan.block_s for sensor in sensors)
    maps = {}
    for sensor in sensors:
        site = prepare(_scenario(args, sensor, block_s))
        print(
            f"{sensor}: {len(site.search)} frames in {len(np.unique(site.plan.search_block))} blocks of {block_s:g} s",
            file=sys.stderr,
        )
        with site.evaluator(site.search) as evaluator:
            scenario, block = site.scenario, site.plan.search_block
            found = map_scores(evaluator, scenario.deployment, scenario.baseline, block, grid=FINE_POINTS)
        if found is None:
            raise InputError(f"{args.scene}: [deployment] height_m and tilt_x_deg must both be pairs")
        if found.resampled_best(SEED) is None:
            raise InputError(f"{args.scene}: too few blocks of {block_s:g} s to resample")
        maps[sensor] = found
    return maps


def _scenario(args, sensor, block_s=None):
    given = {
        ("sensor", "name"): (sensor, "--sensors"),
        ("traffic", "holdout"): (0.0, "compare_sensors"),
        ("traffic", "path"): (args.traffic, "--traffic"),
        ("traffic", "frames"): (args.frames, "--frames"),
        ("traffic", "frame_ids"): (args.frame_ids and parse_frames(args.frame_ids, "--frame-ids"), "--frame-ids"),
        ("traffic", "block_s"): (block_s, "compare_sensors"),
        ("model", "caster"): (args.caster, "--caster"),
    }
    return load_scenario(args.scene, {key: value for key, value in given.items() if value[0] is not None})


def _print(maps):
    resampled = {sensor: found.resampled_best(SEED) for sensor, found in maps.items()}
    print(f"{'sensor':<12} {'height m':>9} {'90 %':>13} {'tilt deg':>9} {'90 %':>13} {'bits/vehicle':>13}")
    for sensor, found in maps.items():
        height, tilt, value = found.best
        ranges = [f"{low:.1f} to {high:.1f}" for low, high in map(interval_90, resampled[sensor])]
        print(f"{sensor:<12} {height:9.1f} {ranges[0]:>13} {tilt:9.0f} {ranges[1]:>13} {value:13.4f}")
    print()
    for first, second in itertools.combinations(maps, 2):
        above = resampled[first][1] > resampled[second][1]
        equal = resampled[first][1] == resampled[second][1]
        shares = f"{100 * above.mean():.1f} % of resamples, equal in {100 * equal.mean():.1f} %"
        print(f"tilt of {first} above that of {second}: {shares}")

    for sensor in maps:
        others = [resampled[other][1] for other in maps if other != sensor]
        if others:
            lowest = (resampled[sensor][1] < np.min(others, axis=0)).mean()
            print(f"tilt of {sensor} below those of all others: {100 * lowest:.1f} % of resamples")


if __name__ == "__main__":
    sys.exit(main())
