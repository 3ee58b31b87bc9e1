"""Time updates of the live preview: a LiDAR is dragged 60 m along a dense frame, with NumPy alone; redraws excluded.

An update casts, scores, writes the cloud's mesh with its attributes, and colours points and vehicles. Runs in the bpy
module, and in a real Blender:

blender --background --factory-startup --python-exit-code 1 --python scripts/research/benchmark_live.py -- SCENE.toml
"""

import argparse
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))  # Blender's own Python need not have the package installed
sys.modules["numba"] = None  # as if it were not installed

import bpy
import numpy as np

from blender_lidar.clouds.live import LiveFrame
from blender_lidar.clouds.snapshot import entropy_of_vehicles, vertices_of
from blender_lidar.scene.scenario import load_scenario
from blender_lidar.scene.site import prepare, read_recording
from blender_lidar.world.blender.objects import build_lidar, new_mesh
from blender_lidar.world.blender.points import colours_by, show_cloud, write_cloud
from blender_lidar.world.blender.preview import VisibleObjects
from blender_lidar.world.blender.scene import empty_scene
from blender_lidar.world.blender.traffic import colour_vehicles, show_vehicles

_MOUNTINGS = {"RS-16": (4.1, 19.0), "RS-80": (4.4, 9.0)}  # the paper's Table II: height [m] and tilt [deg]
_DRAG_M, _STEPS = 60.0, 121
_SIDE = 317  # squares along the edge of a ground of 200,000 triangles


def main() -> int:
    """Carry it out; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scene", nargs="?", default="scenes/i80.toml")
    parser.add_argument("--caster", default="bvh")
    args = parser.parse_args(sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else None)
    print(f"Blender {bpy.app.version_string}, NumPy {np.__version__}, {args.caster}: {_STEPS} updates")
    for sensor, (height, tilt) in _MOUNTINGS.items():
        for objects in (False, True):
            seconds, points = drag(args.scene, sensor, args.caster, height, tilt, objects)
            first, (median, high, most) = 1e3 * seconds[0], 1e3 * np.quantile(seconds[1:], (0.5, 0.95, 1.0))
            among = f"{sensor:<6} {'200,000 own triangles' if objects else 'traffic alone':<22} {points:7,} points"
            print(f"{among}  median {median:6.1f}  p95 {high:6.1f}  most {most:6.1f}  the first {first:6.1f} ms")
    return 0


def drag(path, sensor, caster, height, tilt, with_objects):
    """Seconds of each update (n,), and the points of the last."""
    overrides = {("sensor", "name"): (sensor, "here"), ("model", "caster"): (caster, "here")}
    scenario = load_scenario(path, overrides=overrides)
    recording, site = read_recording(scenario), prepare(scenario)
    vehicles = max((recording.vehicles(frame) for frame in recording.frames), key=len)
    scene = empty_scene()
    items = show_vehicles(scene, vehicles)
    lidar = build_lidar(scene, site.observation.lattice, site.scenario.baseline.pose)
    if with_objects:
        scene.collection.objects.link(_ground())
    live, seconds = LiveFrame(site.counted(vehicles), site.observation, site.scoring), []
    objects, cloud = VisibleObjects(), None
    for x in np.linspace(-0.5 * _DRAG_M, 0.5 * _DRAG_M, _STEPS):
        pose = scenario.mounting({"x_m": x, "height_m": height, "tilt_x_deg": tilt}).pose
        scene.view_layers[0].update()
        started = time.perf_counter()
        objects.refresh(scene, scene.view_layers[0].depsgraph)
        look = live.look(pose, [objects])
        bits = entropy_of_vehicles(look.cloud, vehicles, scenario.objective)
        points = vertices_of(look.cloud, vehicles, bits)
        colours_by("range", points)
        if cloud is None:
            cloud = show_cloud(lidar, points)
        else:
            write_cloud(cloud.data, points)
        colour_vehicles(items, bits)
        seconds.append(time.perf_counter() - started)
    return np.array(seconds), len(look.cloud)


def _ground():
    """Rough ground about the road, a little below it."""
    x, y = np.meshgrid(np.linspace(-60.0, 60.0, _SIDE), np.linspace(-60.0, 60.0, _SIDE), indexing="ij")
    corner = np.arange(_SIDE * _SIDE).reshape(_SIDE, _SIDE)
    faces = np.stack([corner[:-1, :-1], corner[1:, :-1], corner[1:, 1:], corner[:-1, 1:]], axis=-1).reshape(-1, 4)
    vertices = np.stack([x, y, 0.1 * np.sin(x + 2.0 * y) - 0.05], axis=-1).reshape(-1, 3)
    return bpy.data.objects.new("Ground", new_mesh("Ground", vertices, faces))


if __name__ == "__main__":
    sys.exit(main())
