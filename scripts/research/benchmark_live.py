"""Time live updates in two commits of this repository side by side: NumPy alone, caster bvh.

An update is all that happens after a LiDAR has moved: Blender evaluates, the add-on takes note, and `live.update()`
casts, scores and colours; redraws are left out. Each case runs in processes of its own, with either commit in turn.

    python scripts/research/benchmark_live.py --only trees --against HEAD~1
    blender --background --factory-startup --python scripts/research/benchmark_live.py -- --only example
"""

import argparse
import json
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
_RESULT, _TODAY = "benchmark_live: ", "today alone: "
_MOUNTINGS = {"RS-16": (4.1, 19.0), "RS-80": (4.4, 9.0)}  # the paper's Table II: height [m] and tilt [deg]
_DRAG_M, _STEPS = 30.0, 61


def main() -> None:
    """Carry it out."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--against", default="030385c", help="the other commit")
    parser.add_argument("--only", default="", help="cases with this in their names")
    parser.add_argument("--rounds", type=int, default=2, help="processes for each case and commit")
    parser.add_argument("--seconds", type=float, default=3.0, help="how long each of them times, at least two updates")
    for name in ("case", "tree", "site"):  # of a process of its own
        parser.add_argument(f"--{name}", help=argparse.SUPPRESS)
    args = parser.parse_args(sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else None)
    if args.case:
        return timed(args)
    with tempfile.TemporaryDirectory() as folder:
        then = Path(folder, "then")
        subprocess.run(["git", "archive", "-o", f"{then}.tar", args.against], cwd=HERE, check=True)
        shutil.unpack_archive(f"{then}.tar", then)
        site = then / "scenes" / "i80.toml"  # the same for both, with one range gate, which the older one keeps
        site.write_text(site.read_text().replace("150.0", "50.0"))
        print(f"| ms: median (p95) | {args.against} | now | ratio |\n|---|---|---|---|")
        for name in [name for name in CASES if args.only in name]:
            found = {tree: [] for tree in ((HERE,) if name.startswith(_TODAY) else (then, HERE))}
            for tree in args.rounds * list(found):
                found[tree] += in_a_process(args, name, tree, site)
            told = {tree: 1e3 * np.quantile(seconds, (0.5, 0.95)) for tree, seconds in found.items()}
            shown = " | ".join("{:.3g} ({:.3g})".format(*told[tree]) if tree in told else "" for tree in (then, HERE))
            ratio = f"{told[HERE][0] / told[then][0]:.3f}" if then in told else ""
            print(f"| {name} | {shown} | {ratio} |", flush=True)


def in_a_process(args, name, tree, site):
    """What one process measures."""
    blender = [bpy.app.binary_path, "--background", "--factory-startup", "--python", __file__, "--"]
    command = blender if bpy.app.binary_path else [sys.executable, __file__]
    command += ["--case", name, "--tree", str(tree), "--site", str(site), "--seconds", str(args.seconds)]
    done = subprocess.run(command, cwd=tree, capture_output=True, text=True, check=False)
    if _RESULT not in done.stdout:
        raise SystemExit(f"{name}, {tree}:\n{done.stdout[-2000:]}\n{done.stderr[-4000:]}")
    return json.loads(done.stdout.split(_RESULT)[1].splitlines()[0])


# --- In a process of its own: the tree that is measured comes first in the path ---------------------------------------


def timed(args):
    """Measure one case, and print its seconds."""
    sys.modules["numba"] = None  # as if it were not installed
    sys.path.insert(0, args.tree)

    import blender_lidar

    bpy.ops.wm.read_homefile(use_empty=True)
    blender_lidar.register()
    next(steps := CASES[args.case](Path(args.site)))  # made ready
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
    lidar.location.z, lidar.rotation_euler.x = _MOUNTINGS[sensor][0], -np.radians(_MOUNTINGS[sensor][1])
    group.live = True

    def move(x):
        lidar.location.x = x
        bpy.context.view_layer.update()
        module.update()

    move(0.0)
    assert group.points > 0, bpy.context.scene.blender_lidar.problem
    return move


def dragged(sensor, furnish=lambda: None, *, other=False):
    """A case: the example's LiDAR is dragged along the road, or stays while an `other` object, the user's, moves."""

    def steps(site):
        lidar, item = load(site), placed("Other", grid("Other", 1.0, 8)) if other else None
        furnish()
        move = live(lidar, sensor)
        move(-0.5 * _DRAG_M)
        yield
        for step in range(10_000):
            x = _DRAG_M * (step % _STEPS / (_STEPS - 1) - 0.5)
            if other:
                item.location.x, x = x, 0.0
            yield clocked(lambda x=x: move(x))

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


def ground():
    """Rough ground of 200,000 triangles about the road, a little below it."""
    placed("Ground", grid("Ground", 60.0, 317))


def forest(count):
    """Instances of a tree of 332 faces along both sides of the road, always as densely."""
    import bmesh  # which there is once bpy is

    shape, mesh, points = bmesh.new(), bpy.data.meshes.new("Tree"), bpy.data.meshes.new("Places")
    bmesh.ops.create_icosphere(shape, subdivisions=3, radius=1.3, matrix=Matrix.Translation((0.0, 0.0, 3.2)))
    trunk = Matrix.Translation((0.0, 0.0, 1.0))
    bmesh.ops.create_cone(shape, cap_ends=True, segments=10, radius1=0.2, radius2=0.15, depth=2.0, matrix=trunk)
    shape.to_mesh(mesh)
    half = 100.0 * np.sqrt(count / 5_000)
    x, y = np.random.default_rng(1).uniform(-half, half, (2, count))
    y += 1_000.0 + np.where(y > 0.0, 28.0, -2.0)  # none on the road
    points.vertices.add(count)
    points.vertices.foreach_set("co", np.stack([x, y, 0.0 * x], axis=1).astype(np.float32).ravel())
    scatter = placed("Forest", points)
    scatter.location.y = -1_000.0  # where the tree itself stands
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
        from blender_lidar.addon import scenarios

        scene, layer, paid = bpy.context.scene, bpy.context.view_layer, []
        for number in range(20_000):
            scene.collection.objects.link(bpy.data.objects.new(f"Straw {number}", None))
        layer.update()
        of_updates = bpy.app.handlers.depsgraph_update_post
        ours = [call for call in of_updates if call.__module__.startswith("blender_lidar")]
        of_updates.clear()
        of_updates.append(lambda *event: paid.append(clocked(lambda: [call(*event) for call in ours])))
        yield
        for step in range(10_000):
            if asked:
                yield clocked(lambda: scenarios.active_lidar(scene))
            else:
                scene.objects[0].location.x = step + 1.0
                layer.update()
                yield paid[-1]

    return steps


def played(_):
    """A case: today's example is played with a live RS-16."""
    from blender_lidar.addon import live as module
    from blender_lidar.world.blender.objects import lidars

    scene = bpy.context.scene
    bpy.ops.blender_lidar.load_example()
    scene.blender_lidar.model.caster = "bvh"
    live(lidars(scene)[0])
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
    main()
