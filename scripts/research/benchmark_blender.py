"""Time Blender's part: building a frame's vehicles, changing to the next frame, reading a scene back as triangles.

Runs in the bpy module, and in a real Blender:

blender --background --factory-startup --python-exit-code 1 --python scripts/research/benchmark_blender.py -- SCENE.toml
"""

import argparse
import statistics
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))  # Blender's own Python need not have the package installed

import bpy
import numpy as np

from blender_lidar.scene.scenario import load_scenario
from blender_lidar.scene.site import read_recording
from blender_lidar.world.blender.objects import new_mesh
from blender_lidar.world.blender.scene import empty_scene
from blender_lidar.world.blender.site import visible_triangles
from blender_lidar.world.blender.traffic import show_vehicles
from blender_lidar.world.shapes import DETAILS

_SIDE = 317  # squares along the edge of a ground of 200,000 triangles


def main() -> int:
    """Carry it out; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scene", nargs="?", default="scenes/i80.toml")
    parser.add_argument("--repeats", type=int, default=7)
    args = parser.parse_args(sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else None)
    recording = read_recording(load_scenario(args.scene))
    frames = [recording.vehicles(frame) for frame in recording.frames[:: max(1, len(recording.frames) // 12)]]
    print(f"Blender {bpy.app.version_string}; {len(frames[0])} to {max(map(len, frames))} vehicles; medians")
    for detail in DETAILS:
        build, change = times_of_traffic(frames, detail, args.repeats)
        print(f"{detail:<9} built {1e3 * build:6.1f} ms   frame change {1e3 * change:6.1f} ms")
    count, seconds = time_of_reading(args.repeats)
    print(f"{count:,} triangles read back in {1e3 * seconds:.1f} ms")
    return 0


def times_of_traffic(frames, detail, repeats):
    """Medians of building a frame in an empty scene and of changing from one frame to another 10 s later [s]."""
    built, changed = [], []
    for _ in range(repeats):
        scene = empty_scene()
        for row, vehicles in enumerate(frames):
            started = time.perf_counter()
            show_vehicles(scene, vehicles, detail)
            scene.view_layers[0].update()
            (changed if row else built).append(time.perf_counter() - started)
    return statistics.median(built), statistics.median(changed)


def time_of_reading(repeats):
    """Triangles of a rough ground, and the median of reading it back [s]."""
    scene = empty_scene()
    x, y = np.meshgrid(np.arange(_SIDE, dtype=float), np.arange(_SIDE, dtype=float), indexing="ij")
    corner = np.arange(_SIDE * _SIDE).reshape(_SIDE, _SIDE)
    faces = np.stack([corner[:-1, :-1], corner[1:, :-1], corner[1:, 1:], corner[:-1, 1:]], axis=-1).reshape(-1, 4)
    vertices = np.stack([x, y, 0.1 * np.sin(x + 2.0 * y)], axis=-1).reshape(-1, 3)
    scene.collection.objects.link(bpy.data.objects.new("Ground", new_mesh("Ground", vertices, faces)))
    seconds = []
    for _ in range(repeats):
        started = time.perf_counter()
        count = len(visible_triangles(scene))
        seconds.append(time.perf_counter() - started)
    return count, statistics.median(seconds)


if __name__ == "__main__":
    sys.exit(main())
