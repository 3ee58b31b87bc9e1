"""Time one frame, culled, cast and scored, beside plain casting of the same beams; all in one run, interleaved.

    python scripts/benchmark.py [SCENE.toml] [--sensor RS-80] [--repeats 15] [--json FILE]

Every entry is timed once in each round, so that a busy moment of the machine falls on all of them; medians and
quartiles over the rounds are printed, and the ratio to the first entry. The frame is one with the median number of
vehicles. Shared and noisy machines need an idle moment: the smallest time is printed as well.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import sys
import time
from pathlib import Path

for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[variable] = "1"  # one core

import numpy as np

from blender_lidar.casting import caster_class, is_available
from blender_lidar.casting.culling import reachable_beams
from blender_lidar.errors import BlenderLidarError
from blender_lidar.formats.atomic import write_text
from blender_lidar.metrics.vgop import entropy, occupancy, pe_vgop
from blender_lidar.scenario import load_scenario, pose_at
from blender_lidar.sensors.beams import beam_lattice
from blender_lidar.sensors.model import load_model
from blender_lidar.study.frame_scorer import FrameScorer, Observation
from blender_lidar.study.site import Region, read_recording
from blender_lidar.world.triangles import vehicle_triangles

# The paper's Table II: height [m] and tilt [deg].
MOUNTINGS = {"RS-16": (4.1, 19.0), "RS-32": (4.2, 13.0), "RS-80": (4.4, 9.0)}
KITTI_CARS, POINTS_EACH = 14_357, 400  # the paper's section IV: 18 s for its cars, from file to score


def main(argv: list[str] | None = None) -> int:
    args = _arguments(argv)
    try:
        entries, about = _entries(args)
    except BlenderLidarError as error:
        print(f"benchmark: {error}", file=sys.stderr)
        return 2
    times = _measure(entries, args.repeats)
    _print(times, about)
    if args.json:
        summary = {
            name: dict(zip(("minimum", "q1", "median", "q3"), _summary(values), strict=True))
            for name, values in times.items()
        }
        write_text(args.json, json.dumps({"about": about, "machine": _machine(), "seconds": summary}, indent=2) + "\n")
    return 0


def _arguments(argv):
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scene", nargs="?", default=str(Path(__file__).parents[1] / "scenes" / "i80.toml"))
    parser.add_argument("--sensor", default="RS-80", choices=sorted(MOUNTINGS))
    parser.add_argument("--repeats", type=int, default=15)
    parser.add_argument("--json", metavar="FILE")
    return parser.parse_args(argv)


def _entries(args):
    """What is timed: a name and a function each, and a text about the frame."""
    scenario = load_scenario(args.scene, {("sensor", "name"): (args.sensor, "--sensor")})
    recording = read_recording(scenario)
    typical = np.argmin(np.abs(recording.counts - np.median(recording.counts)))
    vehicles = recording.vehicles(int(recording.frames[typical]))
    gate = scenario.sensor.range_gate_m
    counted = Region(scenario.deployment.nominal_xy, gate).holds(vehicles)
    height, tilt = MOUNTINGS[args.sensor]
    pose = pose_at({**scenario.baseline, "height_m": height, "tilt_x_deg": tilt})
    lattice = beam_lattice(load_model(args.sensor))
    triangles = vehicle_triangles(vehicles, scenario.model.detail).corners
    every_ray = pose.to_world(lattice.directions.reshape(-1, 3))

    entries = {}
    scorers = {}
    for name in ("embree", "bvh"):
        if is_available(name):
            observation = Observation(lattice, gate, 0.0, name, scenario.model.detail, scenario.objective.cell_m)
            scorers[name] = FrameScorer(vehicles, counted, observation)
            entries[f"ours, {name}: cull, cast, score"] = lambda scorer=scorers[name]: _score(scorer, pose)
    scorer = next(iter(scorers.values()))
    beams = next(reachable_beams(lattice, scorer.pieces, [pose], gate))
    entries["  of which: culling"] = lambda: next(reachable_beams(lattice, scorer.pieces, [pose], gate))
    local, row = scorer.vehicle_points(pose)
    entries["  of which: scoring"] = lambda: entropy(occupancy(local, row, scorer.size_m)).sum(axis=1)
    for name in scorers:
        caster = caster_class(name)(triangles, closed=True)
        entries[f"  of which: casting the survivors, {name}"] = lambda caster=caster: caster.cast(
            pose.position, every_ray[beams], gate
        )
    if "embree" in scorers:
        entries |= _raw_embree(triangles, every_ray, beams, pose, gate)
    if "bvh" in scorers:
        entries |= _plain_bvh(triangles, every_ray, beams, pose, gate)
    entries[f"metric alone: {KITTI_CARS} vehicles x {POINTS_EACH} points"] = _metric()
    about = (
        f"{args.sensor}: {len(every_ray):,} beams, {len(beams):,} can reach a vehicle, {len(row):,} return from one; "
        f"{len(vehicles)} vehicles ({len(triangles):,} triangles), {int(counted.sum())} within {gate:g} m"
    )
    return entries, about


def _score(scorer, pose):
    return entropy(scorer.see([pose]).occupancy[0]).sum(axis=1)


def _raw_embree(triangles, every_ray, beams, pose, gate):
    from embreex.mesh_construction import TriangleMesh
    from embreex.rtcore_scene import EmbreeScene

    scene = EmbreeScene(robust=True)
    vertices = triangles.reshape(-1, 3).astype(np.float32)
    mesh = TriangleMesh(scene, vertices, np.arange(len(vertices), dtype=np.int32).reshape(-1, 3))
    rays = every_ray.astype(np.float32)
    starts = np.tile(pose.position.astype(np.float32), (len(rays), 1))
    few_rays, few_starts = rays[beams].copy(), starts[beams].copy()

    def cast(origins, directions):
        return mesh is not None and scene.run(origins, directions, dists=gate)

    return {
        "raw Embree, all beams": lambda: cast(starts, rays),
        "raw Embree, the survivors": lambda: cast(few_starts, few_rays),
    }


def _plain_bvh(triangles, every_ray, beams, pose, gate):
    import bpy  # noqa: F401  (makes mathutils importable)
    from mathutils import Vector
    from mathutils.bvhtree import BVHTree

    vertices = triangles.reshape(-1, 3)
    tree = BVHTree.FromPolygons(vertices.tolist(), np.arange(len(vertices)).reshape(-1, 3).tolist(), all_triangles=True)
    origin = Vector(pose.position.tolist())

    def loop(rays):
        hits = []
        for ray in rays:
            hits.append(tree.ray_cast(origin, Vector(ray), gate))
        return hits

    return {
        "BVHTree.ray_cast, plain loop, all beams": lambda: loop(every_ray),
        "BVHTree.ray_cast, plain loop, the survivors": lambda: loop(every_ray[beams]),
    }


def _metric():
    rng = np.random.default_rng(0)
    size = rng.uniform(0.9, 1.1, (KITTI_CARS, 3)) * [4.5, 1.8, 1.5]
    vehicle = np.repeat(np.arange(KITTI_CARS), POINTS_EACH)
    points = rng.uniform(-0.5, 0.5, (len(vehicle), 3)) * size[vehicle]
    return lambda: pe_vgop(points, vehicle, size)


def _measure(entries, repeats):
    times = {name: [] for name in entries}
    for round_number in range(repeats + 1):
        for name, function in entries.items():
            start = time.perf_counter()
            function()
            if round_number:  # the first round warms up
                times[name].append(time.perf_counter() - start)
        print(f"round {round_number} of {repeats}", file=sys.stderr, end="\r", flush=True)
    print(file=sys.stderr)
    return times


def _summary(values):
    return float(min(values)), *(float(value) for value in np.quantile(values, [0.25, 0.5, 0.75]))


def _machine():
    return f"{platform.machine()}, Python {platform.python_version()}, NumPy {np.__version__}, {os.cpu_count()} cores"


def _print(times, about):
    print(f"{about}\n{_machine()}\n")
    first = np.median(next(iter(times.values())))
    print(f"{'milliseconds':<48} {'minimum':>9} {'quartile':>9} {'median':>9} {'quartile':>9} {'x first':>8}")
    for name, values in times.items():
        low, q1, median, q3 = (1e3 * value for value in _summary(values))
        print(f"{name:<48} {low:9.2f} {q1:9.2f} {median:9.2f} {q3:9.2f} {median / 1e3 / first:8.2f}")


if __name__ == "__main__":
    sys.exit(main())
