"""What noise, lost returns and a barrier cost: time of scoring a swarm, beside that of the perfect sensor.

    python scripts/research/imperfection_cost.py [SCENE.toml] [--caster raster] [--frames 10] [--repeats 9]

Every frame is scored by every kind of sensor in turn, a swarm of 20 mountings at a time, in one process and warm. The
table has the median over the rounds of the time of all frames, and of its ratio to the perfect sensor's in the round.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from functools import partial
from time import process_time

import numpy as np

from arguments import SCENES, parser_of, positive, run_script
from benchmark_stages import MOUNTINGS, SWARM, swarm_about
from blender_lidar.casting.protocol import StandingScenery
from blender_lidar.scene.mounting import pose_at
from blender_lidar.scene.scenario import load_scenario
from blender_lidar.scene.site import Site, prepare
from blender_lidar.scoring.frame_scorer import FrameScorer, singles
from blender_lidar.sensors.imperfections import PERFECT, Imperfections
from blender_lidar.world.scenery import barrier

MOST = 1.3  # times the perfect sensor
KINDS = {
    "perfect": PERFECT,
    "drop-out 0.1": Imperfections(dropout=0.1),
    "range noise 0.02 m": Imperfections(range_noise_m=0.02),
    "glass drop-out 0.5": Imperfections(glass_dropout=0.5),
    "10 % seen to 60 m": Imperfections(range_at_10_percent_m=60.0),
    "concrete barrier": PERFECT,
}


def main(argv: list[str] | None = None) -> int:
    return run_script("imperfection_cost", lambda: _costs(_arguments(argv)))


def _costs(args) -> None:
    for sensor in ("RS-16", "RS-80"):
        given = {("sensor", "name"): (sensor, ""), ("traffic", "frames"): (args.frames, "--frames")}
        site = prepare(load_scenario(args.scene, given | {("model", "caster"): (args.caster, "--caster")}))
        _print(site, sensor, _seconds(site, sensor, args.repeats))


def _seconds(site: Site, sensor: str, repeats: int) -> np.ndarray:
    """Processor time of each round and kind (repeats, kinds) [s]: the sum over the frames."""
    height, tilt = MOUNTINGS[sensor]
    swarm = swarm_about(pose_at({**site.scenario.baseline, "height_m": height, "tilt_x_deg": tilt}))
    gate, seconds = site.observation.max_range_m, np.zeros((repeats + 1, len(KINDS)))
    standing = StandingScenery(barrier("concrete", 13.0, (-gate, gate)), site.observation.caster)
    for frame in site.search:
        acts = []
        for name, imperfections in KINDS.items():
            seen = replace(site.observation, imperfections=imperfections, scenery=None)
            if name == "concrete barrier":
                seen = replace(seen, scenery=standing)
            acts.append(partial(FrameScorer(frame.vehicles, frame.counted, seen).see, singles(swarm)))
        for round_ in range(repeats + 1):  # the first one makes ready
            for kind, act in enumerate(acts):
                start = process_time()
                act()
                seconds[round_, kind] += process_time() - start
    return seconds[1:]


def _print(site: Site, sensor: str, seconds: np.ndarray) -> None:
    print(f"{sensor}, {site.observation.caster}: {len(site.search)} frames x {SWARM} mountings, {len(seconds)} rounds")
    ratios = np.median(seconds / seconds[:, :1], axis=0)
    for name, time, ratio in zip(KINDS, np.median(seconds, axis=0), ratios, strict=True):
        each = 1e3 * time / len(site.search) / SWARM
        print(f"{name:<22}{each:>10.3f} ms{ratio:>8.2f}{'  more than it may' if ratio > MOST else ''}", flush=True)


def _arguments(argv):
    parser = parser_of(__doc__, SCENES / "i80.toml")
    parser.add_argument("--caster", default="raster")
    parser.add_argument("--frames", type=positive, default=10)
    parser.add_argument("--repeats", type=positive, default=9)
    return parser.parse_args(argv)


if __name__ == "__main__":
    sys.exit(main())
