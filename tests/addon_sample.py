"""What checks of the add-on share: a loaded scene in a new file, and what is looked at in it."""

from __future__ import annotations

import math
import sys
from pathlib import Path

import bpy
import numpy as np

from blender_lidar.addon import properties
from blender_lidar.scene.mounting import COORDINATES
from blender_lidar.world.blender.objects import PART, hang, lidars, role
from tests.small_scene import REGION, mounting, write_scene

FOLDER = Path(sys.argv[sys.argv.index("--") + 1 if "--" in sys.argv else 1])
POSE = {"x_m": 0.5, "y_m": -0.25, "height_m": 4.0, "tilt_x_deg": 15.0, "tilt_y_deg": -2.5, "yaw_deg": 7.5}
OPTIONS = [word for key, value in POSE.items() for word in (f"--{key.rsplit('_', 1)[0].replace('_', '-')}", str(value))]
FRAME = 20


def new_file():
    bpy.ops.wm.read_homefile(use_factory_startup=True, use_empty=True)
    return bpy.context.scene


def example(**changes):
    """A scene file of a few vehicles, and its settings as a scenario."""
    folder = FOLDER / "scene"
    changes = {name: dict(table) for name, table in changes.items()}
    changes["model"] = {"caster": "bvh", "workers": 1}
    return write_scene(folder, REGION | changes)


def loaded(**changes):
    """A new file with that scene loaded, and its LiDAR at `POSE`."""
    scene = new_file()
    scene.blender_lidar.traffic.path = str(example(**changes))
    assert bpy.ops.blender_lidar.load() == {"FINISHED"}
    scene.blender_lidar.frame = FRAME
    (lidar,) = lidars(scene)
    choose(lidar)
    hang(lidar, mounting(POSE).pose)
    bpy.context.view_layer.update()
    return scene, lidar


def coordinates_of(lidar):
    """Coordinates of a LiDAR's mounting, as the panel has them [m, degrees]."""
    table = properties.mounting_of(lidar).as_table()
    return {key: table[key] for key in COORDINATES}


def choose(*items):
    """Select these alone."""
    for item in bpy.context.view_layer.objects:
        item.select_set(False)
    for item in items:
        item.hide_select = False
        item.select_set(True)
    bpy.context.view_layer.objects.active = items[0]


def vertices(item):
    found = np.empty(3 * len(item.data.vertices), np.float32)
    item.data.vertices.foreach_get("co", found)
    return found.reshape(-1, 3)


def evaluated(item):
    """Vertices of an object as Blender shows them, in the road frame."""
    bpy.context.view_layer.update()
    shown = item.evaluated_get(bpy.context.evaluated_depsgraph_get())
    return vertices(item) @ np.array(shown.matrix_world)[:3, :3].T + np.array(shown.matrix_world.translation)


def part(lidar, name):
    return next(child for child in lidar.children if role(child) == PART and child.name.startswith(name))


def axes(lidar):
    """Directions of the sensor frame's axes in the road frame, a row each."""
    turn = np.array(lidar.matrix_world)[:3, :3].T
    return turn / np.linalg.norm(turn, axis=1, keepdims=True)


def of_state():
    """What a refused operator must leave as it was."""
    scene = bpy.context.scene
    bpy.context.view_layer.update()
    return {
        "objects": sorted((item.name, tuple(np.array(item.matrix_basis).ravel())) for item in bpy.data.objects),
        "meshes": sorted((mesh.name, len(mesh.vertices)) for mesh in bpy.data.meshes),
        "collections": sorted(one.name for one in bpy.data.collections),
        "scene": fields(scene.blender_lidar),
        "lidars": [fields(lidar.blender_lidar) for lidar in lidars(scene)],
        "active": bpy.context.view_layer.objects.active and bpy.context.view_layer.objects.active.name,
    }


def fields(group):
    """Values of all properties of a group."""
    found = {}
    for key, kind in group.bl_rna.properties.items():
        if key in ("rna_type", "name"):
            continue
        value = getattr(group, key, None)
        if isinstance(value, bpy.types.PropertyGroup):
            found[key] = fields(value)
        elif kind.type == "COLLECTION":
            found[key] = [fields(one) for one in value]
        else:
            found[key] = str(tuple(value) if kind_is_array(kind) else getattr(value, "name", value))
    return found


def assert_same(found, expected):
    """As they were, or which part is not."""
    for key, value in expected.items():
        assert found[key] == value, (key, value, found[key])


def assert_alike(one, other, key=""):
    """The same but for the last digits of numbers: BLAS of another process may add up in another order."""
    if isinstance(one, float):
        assert math.isclose(one, other, rel_tol=1e-12), (key, one, other)
    elif isinstance(one, (dict, list)):
        keys = one if isinstance(one, dict) else range(len(one))
        assert len(one) == len(other), (key, one, other)
        for name in keys:
            assert_alike(one[name], other[name], name)
    else:
        assert one == other, (key, one, other)


def kind_is_array(kind):
    return getattr(kind, "is_array", False)


def refused(operator, **given):
    """The one line with which an operator refuses, having changed nothing."""
    before = of_state()
    try:
        answer = operator(**given)
    except RuntimeError as error:
        (line,) = str(error).strip().splitlines()
        assert line.startswith("Error: "), line
        assert_same(of_state(), before)
        return line
    raise AssertionError(f"was not refused: {answer}")


def fan(lidar):
    return next(child for child in lidar.children if child.type == "CURVE")
