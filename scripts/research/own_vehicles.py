"""Time and score a dense frame whose cars have an own mesh of some 20,000 triangles, beside our own bodies.

The mesh is our detailed car with each triangle cut into 64, given as a mesh of the user's: what differs from `detailed`
is the time alone.
"""

import argparse
import sys
import time

import numpy as np

from blender_lidar.casting import CASTERS, is_available
from blender_lidar.casting.instances import OwnBodies
from blender_lidar.scene.scenario import load_scenario
from blender_lidar.scene.site import prepare, read_recording
from blender_lidar.scoring.frame_scorer import FrameScorer
from blender_lidar.scoring.scores import VehicleScores
from blender_lidar.world.meshes import Shape
from blender_lidar.world.shapes import shape

_MOUNTINGS = {"RS-16": (4.1, 19.0), "RS-80": (4.4, 9.0)}  # the paper's Table II: height [m] and tilt [deg]
_CUTS, _REPEATS, _PLACES_M = 3, 5, np.linspace(-10.0, 10.0, 5)


def finer(made: Shape) -> Shape:
    """The same surface with each triangle cut into four."""
    a, b, c = np.moveaxis(made.vertices[made.faces], 1, 0)
    ab, bc, ca = 0.5 * (a + b), 0.5 * (b + c), 0.5 * (c + a)
    corners = np.stack([[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]).transpose(2, 0, 1, 3).reshape(-1, 3)
    return Shape(corners, np.arange(len(corners)).reshape(-1, 3), np.repeat(made.surface, 4))


def main() -> int:
    """Carry it out; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scene", nargs="?", default="i80")
    parser.add_argument("--caster", nargs="+", default=[name for name in CASTERS[:3] if is_available(name)])
    args = parser.parse_args()
    mesh = shape("car", "detailed")
    for _ in range(_CUTS):
        mesh = finer(mesh)
    for caster in args.caster:
        for sensor in _MOUNTINGS:
            for name, detail, bodies in (
                ("our bodies", "body", None),
                ("our detailed ones", "detailed", None),
                (f"cars of {len(mesh.faces):,} triangles", "detailed", OwnBodies({"car": mesh})),
            ):
                seconds, bits, first = scored(args.scene, sensor, caster, detail, bodies)
                told = f"{1e3 * seconds:7.1f} ms a frame, the first {first:5.2f} s, PE-VGOP of a vehicle {bits:.4f}"
                print(f"{caster:<7} {sensor:<6} {name:<26} {told}", flush=True)
    return 0


def scored(path, sensor, caster, detail, bodies):
    """Seconds of a scored mounting, its PE-VGOP per vehicle [bits], and seconds until the first."""
    changes = {("sensor", "name"): sensor, ("model", "caster"): caster, ("world", "detail"): detail}
    scenario = load_scenario(path, {place: (value, "here") for place, value in changes.items()})
    recording, site = read_recording(scenario), prepare(scenario, bodies=bodies)
    frame = site.counted(max((recording.at(number) for number in recording.frames), key=len))
    height, tilt = _MOUNTINGS[sensor]
    places = [{"x_m": x, "height_m": height, "tilt_x_deg": tilt} for x in _PLACES_M]
    layouts = [(scenario.lidar.mounting(one).pose,) for one in places]
    started = time.perf_counter()
    scorer, scores = (
        FrameScorer(frame, site.observation),
        VehicleScores(site.scoring, site.observation, [frame]),
    )
    found = scores.of(frame, scorer, layouts)
    times = [started, time.perf_counter()]
    for _ in range(_REPEATS):
        scores.of(frame, scorer, layouts)
        times.append(time.perf_counter())
    first, *further = np.diff(times)
    return min(further) / len(layouts), found.values.mean(), first


if __name__ == "__main__":
    sys.exit(main())
