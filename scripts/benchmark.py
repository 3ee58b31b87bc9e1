"""Time a frame, culled, cast and scored, beside plain casting of the same beams; all in one run, interleaved.

    python scripts/benchmark.py [SCENE.toml] [--sensor RS-80] [--detail body] [--frames 10] [--repeats 7] [--json FILE]

Every entry is timed once for each frame in each round, so that a busy moment of the machine falls on all of them. For
each frame the median over the rounds is taken; printed are the median, the least and the most over the frames, and the
median of the ratios to raw Embree at the same moment.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import sys
import time
from functools import partial
from pathlib import Path

for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[variable] = "1"  # one core

import numpy as np

from blender_lidar.casting import caster_class, is_available
from blender_lidar.casting.culling import reachable_beams
from blender_lidar.errors import BlenderLidarError
from blender_lidar.formats.atomic import write_text
from blender_lidar.metrics.vgop import entropy, pe_vgop
from blender_lidar.scenario import load_scenario, pose_at
from blender_lidar.study.frame_scorer import FrameScorer, Observation
from blender_lidar.study.site import Region, lattice_of, read_recording
from blender_lidar.traffic import plan_frames
from blender_lidar.world.shapes import DETAILS
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
        return error.exit_code
    times = _measure(entries, args.repeats)
    _print(times, about)
    if args.json:
        summary = {
            name: dict(zip(("least", "median", "most"), _summary(values), strict=True))
            for name, values in times.items()
        }
        write_text(args.json, json.dumps({"about": about, "machine": _machine(), "seconds": summary}, indent=2) + "\n")
    return 0


def _arguments(argv):
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scene", nargs="?", default=str(Path(__file__).parents[1] / "scenes" / "i80.toml"))
    parser.add_argument("--sensor", default="RS-80", choices=sorted(MOUNTINGS))
    parser.add_argument("--detail", choices=DETAILS, help="level of detail of the vehicles, in place of the scene's")
    parser.add_argument("--frames", type=_positive, default=10)
    parser.add_argument("--repeats", type=_positive, default=7)
    parser.add_argument("--json", metavar="FILE")
    return parser.parse_args(argv)


def _positive(text):
    if not text.isdecimal() or int(text) == 0:
        raise argparse.ArgumentTypeError(f"is {text!r}; allowed: a whole number from 1")
    return int(text)


def _entries(args):
    """What is timed: a name and a function for each frame; and a text about the frames."""
    overrides = {("sensor", "name"): (args.sensor, "--sensor")}
    if args.detail:
        overrides["world", "detail"] = (args.detail, "--detail")
    scenario = load_scenario(args.scene, overrides)
    recording = read_recording(scenario)
    gate = scenario.sensor.range_gate_m
    region = Region(scenario.deployment.nominal_xy, gate)
    frames = plan_frames(recording, region.holds, count=args.frames).search.tolist()
    height, tilt = MOUNTINGS[args.sensor]
    pose = pose_at({**scenario.baseline, "height_m": height, "tilt_x_deg": tilt})
    lattice = lattice_of(scenario.sensor)
    every_ray = np.ascontiguousarray(pose.to_world(lattice.directions.reshape(-1, 3)))
    entries, rows = {}, []
    for frame in frames:
        vehicles = recording.vehicles(frame)
        counted = region.holds(vehicles)
        found = {}
        scorers = {}
        for name in ("embree", "bvh"):
            if is_available(name):
                seen = Observation(
                    lattice,
                    gate,
                    0.0,
                    name,
                    scenario.model.detail,
                    scenario.objective.cell_m,
                    imperfections=scenario.sensor.imperfections,
                )
                scorers[name] = FrameScorer(vehicles, counted, seen)
                found[f"ours, {name}: cull, cast, score"] = partial(_score, scorers[name], pose)
        scorer = next(iter(scorers.values()))
        beams = next(reachable_beams(lattice, scorer.shapes.pieces, [pose], gate))
        found["  of which: culling"] = partial(_cull, lattice, scorer.shapes.pieces, pose, gate)
        rays = pose.to_world(np.take(lattice.components.reshape(3, -1), beams, axis=1).T)
        triangles = vehicle_triangles(vehicles, scenario.model.detail).corners
        for name in scorers:
            caster = caster_class(name)(triangles, closed=True)
            found[f"  of which: casting the survivors, {name}"] = partial(caster.meet, pose.position, rays, gate)
        points = int(scorer.see([pose]).points.sum())
        if "embree" in scorers:
            found |= _raw_embree(triangles, every_ray, beams, pose, gate)
        if "bvh" in scorers:
            found |= _plain_bvh(triangles, every_ray, beams, pose, gate)
        for name, function in found.items():
            entries.setdefault(name, []).append(function)
        rows.append([len(vehicles), counted.sum(), len(triangles), len(beams), points])
    entries[f"metric alone: {KITTI_CARS} vehicles x {POINTS_EACH} points"] = [_metric()]
    low, middle, high = (np.quantile(rows, q, axis=0, method="nearest") for q in (0.0, 0.5, 1.0))
    spread = [f"{b:,} ({a:,} to {c:,})" for a, b, c in zip(low, middle, high, strict=True)]
    about = (
        f"{args.sensor}, {len(every_ray):,} beams, {len(frames)} frames, detail {scenario.model.detail}; "
        "median (and range) of a frame:\n"
        f"{spread[0]} vehicles, {spread[1]} within {gate:g} m, {spread[2]} triangles,\n"
        f"{spread[3]} beams can reach a vehicle, {spread[4]} return from one"
    )
    return entries, about


def _cull(lattice, pieces, pose, gate):
    return next(reachable_beams(lattice, pieces, [pose], gate))


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
    """Seconds of every entry, a row for each repeat and a column for each frame."""
    times = {name: np.empty((repeats, len(functions))) for name, functions in entries.items()}
    for turn in range(repeats):
        for column in range(max(map(len, entries.values()))):
            for name, functions in entries.items():
                if column < len(functions):
                    functions[column]()  # a search scores one frame for a whole swarm in a row: caches are warm
                    start = time.perf_counter()
                    functions[column]()
                    times[name][turn, column] = time.perf_counter() - start
        print(f"round {turn + 1} of {repeats}", file=sys.stderr, end="\r", flush=True)
    print(file=sys.stderr)
    return times


def _summary(values):
    """Of each frame the median over the repeats; of those the smallest, the median and the largest."""
    each = np.median(values, axis=0)
    return float(each.min()), float(np.median(each)), float(each.max())


def _machine():
    return f"{platform.machine()}, Python {platform.python_version()}, NumPy {np.__version__}, {os.cpu_count()} cores"


def _print(times, about):
    print(f"{about}\n{_machine()}\n")
    rival = times.get("raw Embree, all beams")
    ratios = "" if rival is None else f"{'x raw Embree':>14}"
    print(f"{'milliseconds':<48} {'median':>9} {'least':>9} {'most':>9}{ratios}")
    for name, values in times.items():
        low, middle, high = (1e3 * value for value in _summary(values))
        line = f"{name:<48} {middle:9.2f} {low:9.2f} {high:9.2f}"
        if rival is not None and values.shape == rival.shape:
            line += f"{np.median(values / rival):14.2f}"  # of pairs measured within the same moment
        print(line)


if __name__ == "__main__":
    sys.exit(main())
