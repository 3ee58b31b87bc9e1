"""Time live updates in two commits of this repository side by side: NumPy alone, caster bvh.

An update is all that happens after a LiDAR has moved: Blender evaluates, the add-on takes note, and `live.update()`
casts, scores and colours; redraws are left out. Each case runs in processes of its own, with either commit in turn.

    python scripts/research/benchmark_live.py --only trees --against HEAD
    blender --background --factory-startup --python scripts/research/benchmark_live.py -- --only example
"""

import argparse
import json
import math
import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import bpy
import numpy as np
from mathutils import Matrix

HERE = Path(__file__).resolve().parents[2]
_RESULT = "benchmark_live: "
_TODAY = "today alone: "
_MOUNTINGS = {"RS-16": (4.1, 19.0), "RS-80": (4.4, 9.0)}  # the paper's Table II: height [m] and tilt [deg]
_DRAG_M, _STEPS = 30.0, 61
_SIDE = 317  # squares along the edge of a ground of 200,000 triangles
_FOREST_M, _TREES = 200.0, 5_000  # so many trees on a square of this edge
_ROADSIDE_M = -2.0, 28.0  # y that is free of trees
_AWAY_M = 1_000.0  # where the tree itself stands
_HAY = 20_000  # objects of a scene without a LiDAR


def main() -> int:
    """Carry it out; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--against", default="030385c", help="the other commit")
    parser.add_argument("--only", default="", help="cases with this in their names")
    parser.add_argument("--rounds", type=int, default=2, help="processes for each case and commit")
    parser.add_argument("--seconds", type=float, default=5.0, help="how long each of them times, at least two updates")
    for name in ("case", "tree", "site"):  # of a process of its own
        parser.add_argument(f"--{name}", help=argparse.SUPPRESS)
    given = sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else sys.argv[1:]
    args = parser.parse_args(given)
    if args.case:
        return timed(args)
    with tempfile.TemporaryDirectory() as folder:
        then = Path(folder, "then")
        command = ["git", "archive", "-o", f"{then}.tar", args.against]
        subprocess.run(command, cwd=HERE, check=True)
        shutil.unpack_archive(f"{then}.tar", then)
        site = shutil.copytree(then / "scenes", Path(folder, "scenes")) / "i80.toml"  # the same for both
        print(f"| ms: median (p95) | {args.against} | now | ratio |\n|---|---|---|---|")
        for name in [name for name in CASES if args.only in name]:
            found = {tree: [] for tree in ((HERE,) if name.startswith(_TODAY) else (then, HERE))}
            for tree in args.rounds * list(found):
                found[tree] += in_a_process(args, name, tree, site)
            told = {tree: 1e3 * np.quantile(seconds, (0.5, 0.95)) for tree, seconds in found.items()}
            shown = " | ".join("{:.3g} ({:.3g})".format(*told[tree]) if tree in told else "" for tree in (then, HERE))
            ratio = f"{told[HERE][0] / told[then][0]:.3f}" if then in told else ""
            print(f"| {name} | {shown} | {ratio} |", flush=True)
    return 0


def in_a_process(args, name, tree, site):
    """What one process measures."""
    command = [sys.executable, __file__]
    if bpy.app.binary_path:
        command = [bpy.app.binary_path, "--background", "--factory-startup", "--python", __file__, "--"]
    command += ["--case", name, "--tree", str(tree), "--site", str(site), "--seconds", str(args.seconds)]
    done = subprocess.run(command, cwd=tree, capture_output=True, text=True, check=False)
    lines = [line for line in done.stdout.splitlines() if line.startswith(_RESULT)]
    if not lines:
        raise SystemExit(f"{name}, {tree}:\n{done.stdout[-2000:]}\n{done.stderr[-4000:]}")
    return json.loads(lines[-1].removeprefix(_RESULT))


# --- In a process of its own: the tree that is measured comes first in the path ---------------------------------------


def timed(args):
    """Measure one case, and print its seconds."""
    sys.modules["numba"] = None  # as if it were not installed
    sys.path.insert(0, args.tree)

    import blender_lidar

    bpy.ops.wm.read_homefile(use_empty=True)
    blender_lidar.register()
    steps = CASES[args.case](Path(args.site))
    next(steps)  # made ready
    seconds, end = [], time.perf_counter() + args.seconds
    while len(seconds) < _STEPS and (time.perf_counter() < end or len(seconds) < 2):
        seconds.append(next(steps))
    print(_RESULT + json.dumps(seconds), flush=True)
    os._exit(0)  # bpy may hang at its end


def clocked(call):
    """Seconds of a call."""
    started = time.perf_counter()
    call()
    return time.perf_counter() - started


def load(site):
    """Load a scene file; returns its LiDAR."""
    from blender_lidar.world.blender.objects import lidars

    group = bpy.context.scene.blender_lidar
    group.traffic.path = str(site)
    named = "blender_lidar" if hasattr(bpy.types.Object, "blender_lidar") else "lidar"
    assert getattr(bpy.ops, named).load() == {"FINISHED"}
    group.model.caster = "bvh"
    return lidars(bpy.context.scene)[0]


def live(lidar, sensor="RS-16"):
    """Have a LiDAR live, at the paper's mounting; returns what takes it to an x [m] and updates."""
    from blender_lidar.addon import live as module

    group = getattr(lidar, "blender_lidar", None) or lidar.lidar  # as it was called before
    group.name_ = sensor
    height, tilt = _MOUNTINGS[sensor]
    lidar.location, lidar.rotation_euler = (0.0, 0.0, height), (-math.radians(tilt), 0.0, 0.0)
    group.live = True

    def move(x):
        lidar.location.x = x
        bpy.context.view_layer.update()
        module.update()

    move(0.0)
    assert not bpy.context.scene.blender_lidar.problem, bpy.context.scene.blender_lidar.problem
    assert group.points > 0
    return move


def dragged(sensor, furnish=lambda: None, *, other=False):
    """A case: the example's LiDAR is dragged along the road, or stays while an `other` object, the user's, moves."""

    def steps(site):
        lidar, item = load(site), ground(1.0, 8) if other else None
        furnish()
        move = live(lidar, sensor)
        move(-0.5 * _DRAG_M)
        yield
        for step in range(10_000):
            x = _DRAG_M * (step % _STEPS / (_STEPS - 1) - 0.5)
            if other:
                item.location.x = 0.1 * x
            yield clocked(lambda x=x: move(0.0 if other else x))

    return steps


def placed(name, mesh):
    """An object in the scene."""
    made = bpy.data.objects.new(name, mesh)
    bpy.context.scene.collection.objects.link(made)
    return made


def grid(name, half_m, side):
    """A rough square mesh about the origin."""
    from blender_lidar.world.blender.objects import new_mesh

    x, y = np.meshgrid(np.linspace(-half_m, half_m, side), np.linspace(-half_m, half_m, side), indexing="ij")
    corner = np.arange(side * side).reshape(side, side)
    faces = np.stack([corner[:-1, :-1], corner[1:, :-1], corner[1:, 1:], corner[:-1, 1:]], axis=-1).reshape(-1, 4)
    return new_mesh(name, np.stack([x, y, 0.1 * np.sin(x + 2.0 * y) - 0.05], axis=-1).reshape(-1, 3), faces)


def ground(half_m=60.0, side=_SIDE):
    """Rough ground about the road, a little below it."""
    return placed("Ground", grid("Ground", half_m, side))


def forest(count):
    """Instances of a tree of 332 faces along both sides of the road, always as densely."""
    import bmesh  # which there is once bpy is

    shape, mesh, points = bmesh.new(), bpy.data.meshes.new("Tree"), bpy.data.meshes.new("Places")
    bmesh.ops.create_icosphere(shape, subdivisions=3, radius=1.3, matrix=Matrix.Translation((0.0, 0.0, 3.2)))
    trunk = Matrix.Translation((0.0, 0.0, 1.0))
    bmesh.ops.create_cone(shape, cap_ends=True, segments=10, radius1=0.2, radius2=0.15, depth=2.0, matrix=trunk)
    shape.to_mesh(mesh)
    half = 0.5 * _FOREST_M * math.sqrt(count / _TREES)
    places = np.random.default_rng(1).uniform(-half, half, (count, 3))
    places[:, 1] += np.where(places[:, 1] > 0.0, _ROADSIDE_M[1], _ROADSIDE_M[0])
    places[:, 1], places[:, 2] = places[:, 1] + _AWAY_M, 0.0
    points.vertices.add(count)
    points.vertices.foreach_set("co", places.astype(np.float32).ravel())
    scatter = placed("Forest", points)
    scatter.location.y = -_AWAY_M
    scatter.instance_type, placed("Tree", mesh).parent = "VERTS", scatter


def own_cars(site):
    """A case: as the example's, with a car of 20,000 triangles of the user's own."""
    blend, scene = site.with_name("cars.blend"), site.with_name("cars.toml")
    bpy.data.libraries.write(str(blend), {bpy.data.objects.new("Sedan", grid("Sedan", 2.0, 101))})
    scene.write_text(site.read_text() + '\n[world.vehicles]\ncar = "cars.blend/Sedan"\n')
    return dragged("RS-16")(scene)


def taxed(asked):
    """A case: what a large scene without a LiDAR pays, for each update or each redraw."""

    def steps(_):
        from blender_lidar.addon import session

        scene, layer, paid = bpy.context.scene, bpy.context.view_layer, []
        for number in range(_HAY):
            scene.collection.objects.link(bpy.data.objects.new(f"Straw {number}", None))
        layer.update()
        of_updates = bpy.app.handlers.depsgraph_update_post
        ours = [call for call in of_updates if call.__module__.startswith("blender_lidar")]
        of_updates.clear()
        of_updates.append(lambda *event: paid.append(clocked(lambda: [call(*event) for call in ours])))
        yield
        for step in range(10_000):
            if asked:
                yield clocked(lambda: session.active_lidar(scene))
            else:
                scene.objects[0].location.x = step + 1.0
                layer.update()
                yield paid[-1]

    return steps


def played(site):
    """A case: today's example is played with a live RS-16."""
    from blender_lidar.addon import live as module

    scene = bpy.context.scene
    live(load(HERE / "scenes" / site.name))
    yield
    for frame in range(scene.frame_start + 1, scene.frame_end):
        yield clocked(lambda frame=frame: (scene.frame_set(frame), module.update()))


CASES = {
    "example, RS-16": dragged("RS-16"),
    "example, RS-80": dragged("RS-80"),
    "200,000 triangles, RS-16": dragged("RS-16", ground),
    "200,000 triangles, RS-80": dragged("RS-80", ground),
    "5,000 trees, RS-16": dragged("RS-16", lambda: forest(5_000)),
    "100,000 trees, RS-16": dragged("RS-16", lambda: forest(100_000)),
    "5,000 trees, an object moved": dragged("RS-16", lambda: forest(5_000), other=True),
    "100,000 trees, an object moved": dragged("RS-16", lambda: forest(100_000), other=True),
    "20,000 objects: handlers of an update": taxed(asked=False),
    "20,000 objects: active_lidar": taxed(asked=True),
    _TODAY + "example, RS-16, own cars": own_cars,
    _TODAY + "example, RS-16, a frame played": played,
}

if __name__ == "__main__":
    sys.exit(main())
