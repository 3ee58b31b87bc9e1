"""What the add-on must do in a Blender: run by a Blender or by its Python, each check in a new file.

    python tests/addon_session.py FOLDER
    blender --background --factory-startup --python tests/addon_session.py -- FOLDER

Prints a line of JSON: by check what went wrong, "" where nothing did.
"""

from __future__ import annotations

import json
import math
import shutil
import sys
import traceback
from dataclasses import replace
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import bpy
import numpy as np

import blender_lidar
from blender_lidar.addon import handlers, live, operators, optimising, properties, session
from blender_lidar.cli import main as command_line
from blender_lidar.scene.deployment import MOUNTING_OR_LEAN
from blender_lidar.scene.mounting import COORDINATES
from blender_lidar.scene.scenario import load_scenario
from blender_lidar.scene.settings import DECLARED
from blender_lidar.scene.site import prepare
from blender_lidar.scoring.evaluation import Evaluator
from blender_lidar.sensors.pose import Pose
from blender_lidar.world.blender.objects import CLOUD, PART, VEHICLE, hang, lidars, pose_of, role
from blender_lidar.world.blender.points import cloud_of
from tests.small_scene import REGION, mounting, without_times, write_scene

FOLDER = Path(sys.argv[sys.argv.index("--") + 1 if "--" in sys.argv else 1])
POSE = {"x_m": 0.5, "y_m": -0.25, "height_m": 4.0, "tilt_x_deg": 15.0, "tilt_y_deg": -2.5, "yaw_deg": 7.5}
OPTIONS = [word for key, value in POSE.items() for word in (f"--{key.rsplit('_', 1)[0].replace('_', '-')}", str(value))]
FRAME = 20


# --- What checks share ------------------------------------------------------------------------------------------------


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
    assert bpy.ops.lidar.load() == {"FINISHED"}
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
        "lidars": [fields(lidar.lidar) for lidar in lidars(scene)],
        "active": bpy.context.view_layer.objects.active and bpy.context.view_layer.objects.active.name,
    }


def fields(group):
    """Values of all properties of a group."""
    found = {}
    for key, kind in group.bl_rna.properties.items():
        if key in ("rna_type", "name"):
            continue
        value = getattr(group, key, None)
        found[key] = fields(value) if kind.type == "POINTER" else str(tuple(value) if kind_is_array(kind) else value)
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


# --- Poses ------------------------------------------------------------------------------------------------------------


def check_fifteen_degrees_of_tilt_show_as_fifteen_and_look_down_across_the_road():
    lidar = loaded()[1]
    hang(lidar, Pose(0.0, 0.0, 4.0))
    lidar.lidar.tilt_x_deg = math.radians(15.0)
    bpy.context.view_layer.update()
    assert coordinates_of(lidar)["tilt_x_deg"] == 15.0
    assert abs(lidar.lidar.tilt_x_deg - math.radians(15.0)) < 1e-6
    assert abs(lidar.lidar.lean_deg - math.radians(15.0)) < 1e-6
    ahead = axes(lidar)[1]
    assert ahead[1] > 0.9, ahead
    assert abs(ahead[2] + math.sin(math.radians(15.0))) < 1e-6, ahead


def check_panel_and_transform_agree_with_poses():
    lidar = loaded()[1]
    rng = np.random.default_rng(1)
    for _ in range(60):
        values = rng.uniform((-50, -50, 0.5, -85, -85, -179), (50, 50, 20, 85, 85, 179)).round(3).tolist()
        place = dict(zip(COORDINATES, values, strict=True))
        hang(lidar, Pose(0.0, 0.0, 4.0))
        for key, value in place.items():
            setattr(lidar.lidar, key, math.radians(value) if key.endswith("_deg") else value)
        bpy.context.view_layer.update()
        found, expected = pose_of(lidar), mounting(place).pose
        np.testing.assert_allclose(axes(lidar), expected.to_world(np.eye(3)), atol=2e-5, err_msg=str(place))
        np.testing.assert_allclose(found.to_world(np.eye(3)), expected.to_world(np.eye(3)), atol=2e-5)
        np.testing.assert_allclose(found.position, expected.position, atol=1e-4)
        for key, value in place.items():
            shown = getattr(lidar.lidar, key)
            shown = math.degrees(shown) if key.endswith("_deg") else shown
            assert abs(shown - value) < 2e-3, (key, value, shown, place)


def check_a_lean_is_what_poses_call_so():
    lidar = loaded()[1]
    rng = np.random.default_rng(2)
    for _ in range(30):
        lean, direction, spin = (round(value, 2) for value in rng.uniform((1, -170, -170), (80, 170, 170)))
        hang(lidar, Pose(1.0, 2.0, 4.0))
        group = lidar.lidar
        group.lean_deg = math.radians(lean)
        group.lean_direction_deg = math.radians(direction)
        group.spin_deg = math.radians(spin)
        bpy.context.view_layer.update()
        upright = axes(lidar)[2]
        assert abs(math.degrees(math.acos(min(upright[2], 1.0))) - lean) < 0.01, (lean, direction, spin)
        toward = math.degrees(math.atan2(upright[1], upright[0])) - 90.0
        assert abs((toward - direction + 180.0) % 360.0 - 180.0) < 0.01, (lean, direction, toward)
        for key, value in (("lean_deg", lean), ("lean_direction_deg", direction), ("spin_deg", spin)):
            off = math.degrees(getattr(group, key)) - value
            assert abs((off + 180.0) % 360.0 - 180.0) < 0.01, (key, lean, direction, spin, off)


def check_a_parented_lidar_hangs_where_its_parent_takes_it():
    scene, lidar = loaded()
    car = bpy.data.objects.new("Gantry", None)
    scene.collection.objects.link(car)
    car.location, car.rotation_euler, car.scale = (3.0, -2.0, 1.0), (0.0, 0.0, math.radians(30.0)), (2.0, 2.0, 2.0)
    bpy.context.view_layer.update()
    lidar.parent = car
    bpy.context.view_layer.update()
    rng = np.random.default_rng(3)
    for _ in range(20):
        angles = np.radians(rng.uniform(-60, 60, 3))
        pose = Pose(*rng.uniform(-10, 10, 2), rng.uniform(1, 9), *angles)
        hang(lidar, pose)
        bpy.context.view_layer.update()
        np.testing.assert_allclose(axes(lidar), pose.to_world(np.eye(3)), atol=1e-4)
        np.testing.assert_allclose(pose_of(lidar).position, pose.position, atol=1e-3)
        np.testing.assert_allclose(pose_of(lidar).to_world(np.eye(3)), pose.to_world(np.eye(3)), atol=1e-4)
    hang(lidar, Pose(0.0, 0.0, 4.0))
    bpy.context.view_layer.update()
    before = coordinates_of(lidar)
    car.location.x += 2.5
    bpy.context.view_layer.update()
    moved = coordinates_of(lidar)
    assert abs(moved["x_m"] - before["x_m"] - 2.5) < 1e-3, (before, moved)
    lidar.lidar.tilt_x_deg = math.radians(15.0)
    bpy.context.view_layer.update()
    assert abs(coordinates_of(lidar)["tilt_x_deg"] - 15.0) < 1e-3
    assert abs(coordinates_of(lidar)["x_m"] - moved["x_m"]) < 1e-3
    assert abs(evaluated(part(lidar, "Pole"))[:, 2].min()) < 1e-3, "the pole of a parented LiDAR ends on the road"


def check_any_way_to_turn_a_lidar_is_read_and_set():
    scene, lidar = loaded()
    target = bpy.data.objects.new("Target", None)
    scene.collection.objects.link(target)
    target.location = (2.0, 0.5, 5.0)
    for mode in ("QUATERNION", "AXIS_ANGLE", "ZYX"):
        lidar.rotation_mode = mode
        if mode == "QUATERNION":
            lidar.rotation_quaternion = (0.9, 0.3, 0.2, 0.1)
        bpy.context.view_layer.update()
        np.testing.assert_allclose(pose_of(lidar).to_world(np.eye(3)), axes(lidar), atol=1e-5, err_msg=mode)
        lidar.lidar.tilt_x_deg = math.radians(15.0)
        assert coordinates_of(lidar)["tilt_x_deg"] == 15.0, mode
    lidar.constraints.new("COPY_LOCATION").target = target
    bpy.context.view_layer.update()
    np.testing.assert_allclose(pose_of(lidar).position, target.location, atol=1e-4)
    assert bpy.ops.lidar.scan() == {"FINISHED"}
    np.testing.assert_allclose(evaluated(cloud_of(lidar)), vertices(cloud_of(lidar)), atol=1e-4)


def check_paths_may_be_relative_to_the_file():
    scene, lidar = loaded()
    bpy.ops.wm.save_as_mainfile(filepath=str(FOLDER / "relative.blend"))
    scene.blender_lidar.traffic.path = "//scene/traffic.csv"
    assert bpy.ops.lidar.load() == {"FINISHED"}
    assert bpy.ops.lidar.scan() == {"FINISHED"}
    lidar.lidar.table_path = "//none.toml"
    lidar.lidar.name_ = "own"
    assert f"{FOLDER / 'none.toml'}: there is no such file" in scene.blender_lidar.problem


def check_the_pole_is_upright_and_ends_on_the_road_at_any_tilt():
    lidar = loaded()[1]
    rng = np.random.default_rng(4)
    for _ in range(20):
        pose = Pose(*rng.uniform(-10, 10, 2), rng.uniform(1, 9), *np.radians(rng.uniform(-89, 89, 3)))
        hang(lidar, pose)
        places = evaluated(part(lidar, "Pole"))
        assert abs(places[:, 2].min()) < 1e-4, (pose, places[:, 2].min())
        assert abs(places[:, 2].max() - pose.height_m) < 1e-4, pose
        off = np.hypot(*(places[:, :2] - pose.position[:2]).T)
        assert off.max() < 0.0701, (pose, off.max())  # upright: no ring of it stands aside
        middle = evaluated(part(lidar, "Head")).mean(axis=0)
        np.testing.assert_allclose(middle, pose.position, atol=1e-4)


def check_head_fan_and_cloud_follow():
    lidar = loaded()[1]
    assert bpy.ops.lidar.scan() == {"FINISHED"}
    cloud = cloud_of(lidar)
    before, pose = evaluated(cloud), pose_of(lidar)
    lidar.lidar.x_m, lidar.lidar.yaw_deg = 10.0, math.radians(90.0)
    after = pose_of(lidar)
    in_sensor = (before - pose.position) @ pose.to_world(np.eye(3)).T
    np.testing.assert_allclose(evaluated(cloud), after.to_world(in_sensor) + after.position, atol=1e-3)
    for child in lidar.children:
        assert child.parent == lidar
        if child.name.startswith("Head") or role(child) not in (PART, CLOUD):
            np.testing.assert_allclose(
                np.array(child.matrix_world)[:3], np.array(lidar.matrix_world)[:3], atol=1e-5, err_msg=child.name
            )


# --- Several LiDARs, scenes and files ---------------------------------------------------------------------------------


def check_a_lidar_duplicated_alone_or_whole_is_another_one():
    for whole, linked in ((False, False), (True, False), (True, True)):
        scene, lidar = loaded()
        assert bpy.ops.lidar.scan() == {"FINISHED"}
        of_first = vertices(cloud_of(lidar)).copy()
        score, points = lidar.lidar.objective, lidar.lidar.points
        choose(lidar, *(lidar.children if whole else ()))
        assert bpy.ops.object.duplicate(linked=linked) == {"FINISHED"}
        handlers.adopt_all()  # what a timer does in a window
        first, second = lidars(scene)
        assert first == lidar
        case = f"whole={whole} linked={linked}"
        assert session.uid_of(first) != session.uid_of(second)
        kinds = sorted(role(child) for child in second.children)
        assert kinds.count(PART) == 2, (case, kinds)
        choose(second)
        assert session.active_lidar(scene) == second
        second.lidar.name_, second.lidar.x_m, second.lidar.height_m = "VLP-16", 5.0, 2.5
        assert first.lidar.name_ == "RS-16"
        assert first.lidar.height_m == 4.0
        assert abs(evaluated(part(second, "Pole"))[:, 2].max() - 2.5) < 1e-4, case
        assert abs(evaluated(part(second, "Pole"))[:, 2].min()) < 1e-4, case
        assert abs(evaluated(part(first, "Pole"))[:, 2].min()) < 1e-4, case
        assert bpy.ops.lidar.scan() == {"FINISHED"}
        np.testing.assert_array_equal(vertices(cloud_of(first)), of_first, err_msg=case)
        assert (first.lidar.objective, first.lidar.points) == (score, points), case
        assert second.lidar.points != points, case
        assert len(vertices(cloud_of(second))) == second.lidar.points, case
        choose(first)
        assert bpy.ops.lidar.scan() == {"FINISHED"}
        np.testing.assert_array_equal(vertices(cloud_of(first)), of_first, err_msg=case)


def check_a_lidar_is_added_before_traffic_is_loaded_and_dressed_as_its_model():
    scene = new_file()
    scene.cursor.location = (3.0, -1.0, 0.0)
    assert bpy.ops.lidar.add() == {"FINISHED"}
    (lidar,) = lidars(scene)
    assert session.active_lidar(scene) == lidar
    place = coordinates_of(lidar)
    assert (place["x_m"], place["y_m"]) == (3.0, -1.0)
    assert abs(evaluated(part(lidar, "Pole"))[:, 2].min()) < 1e-4
    beams = len(fan(lidar).data.splines)
    lidar.lidar.name_ = "RS-80"
    assert len(fan(lidar).data.splines) == 5 * beams
    scene.blender_lidar.traffic.path = str(example())
    assert bpy.ops.lidar.load() == {"FINISHED"}
    assert lidars(scene) == [lidar]
    assert coordinates_of(lidar) == place


def check_what_a_deleted_lidar_wore_goes_with_it():
    scene = loaded()[0]
    assert bpy.ops.lidar.scan() == {"FINISHED"}
    assert bpy.ops.lidar.add() == {"FINISHED"}
    first = lidars(scene)[0]
    choose(first)
    bpy.ops.object.delete()
    handlers.adopt_all()  # what a timer does in a window
    (left,) = lidars(scene)
    assert not [item for item in scene.objects if role(item) in (PART, CLOUD) and item.parent != left]
    assert len(left.children) == 3


def check_a_scaled_lidar_shows_its_cloud_where_it_is_and_its_pole_on_the_road():
    scene, lidar = loaded()
    parent = bpy.data.objects.new("Gantry", None)
    scene.collection.objects.link(parent)
    parent.scale = (3.0, 3.0, 3.0)
    lidar.parent = parent
    bpy.context.view_layer.update()
    hang(lidar, mounting(POSE).pose)
    lidar.scale = (2.0, 2.0, 2.0)
    bpy.context.view_layer.update()
    assert bpy.ops.lidar.scan() == {"FINISHED"}
    np.testing.assert_allclose(evaluated(cloud_of(lidar)), vertices(cloud_of(lidar)), atol=1e-4)
    assert abs(evaluated(part(lidar, "Pole"))[:, 2].min()) < 1e-4


def fan(lidar):
    return next(child for child in lidar.children if child.type == "CURVE")


def check_undo_and_redo_take_back_pose_and_cloud_together():
    lidar = loaded()[1]
    assert bpy.ops.lidar.scan() == {"FINISHED"}
    bpy.ops.ed.undo_push(message="first")
    name, first = lidar.name, (vertices(cloud_of(lidar)).copy(), coordinates_of(lidar), fields(lidar.lidar))
    lidar.lidar.x_m, lidar.lidar.tilt_x_deg = 6.0, math.radians(5.0)
    assert bpy.ops.lidar.scan() == {"FINISHED"}
    bpy.ops.ed.undo_push(message="second")
    second = (vertices(cloud_of(lidar)).copy(), coordinates_of(lidar), fields(lidar.lidar))
    assert len(first[0]) != len(second[0])
    for step, expected in ((bpy.ops.ed.undo, first), (bpy.ops.ed.redo, second), (bpy.ops.ed.undo, first)):
        assert step() == {"FINISHED"}
        lidar = bpy.context.scene.objects[name]
        np.testing.assert_array_equal(vertices(cloud_of(lidar)), expected[0])
        assert coordinates_of(lidar) == expected[1]
        assert fields(lidar.lidar) == expected[2]
    assert bpy.ops.lidar.scan() == {"FINISHED"}
    np.testing.assert_array_equal(vertices(cloud_of(bpy.context.scene.objects[name])), first[0])


def check_saving_and_opening_again_keeps_all_and_reads_traffic_by_need():
    scene, lidar = loaded(sensor={"dropout": 0.1, "range_noise_m": 0.02})
    assert bpy.ops.lidar.scan() == {"FINISHED"}
    cloud, kept, all_of = vertices(cloud_of(lidar)).copy(), fields(lidar.lidar), fields(scene.blender_lidar)
    path = FOLDER / "saved.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    new_file()
    bpy.ops.wm.open_mainfile(filepath=str(path))
    scene = bpy.context.scene
    (lidar,) = lidars(scene)
    assert session._RECORDINGS == {}, "traffic is read when it is asked for"
    assert fields(lidar.lidar) == kept
    assert fields(scene.blender_lidar) == all_of
    np.testing.assert_array_equal(vertices(cloud_of(lidar)), cloud)
    assert bpy.ops.lidar.scan() == {"FINISHED"}
    np.testing.assert_array_equal(vertices(cloud_of(lidar)), cloud)
    bpy.ops.wm.open_mainfile(filepath=str(path))
    (FOLDER / "scene" / "traffic.csv").rename(FOLDER / "away.csv")
    try:
        assert "traffic.csv" in refused(bpy.ops.lidar.scan)
    finally:
        (FOLDER / "away.csv").rename(FOLDER / "scene" / "traffic.csv")
    assert bpy.ops.lidar.scan() == {"FINISHED"}


def check_a_lidar_appended_into_another_file_keeps_its_settings():
    scene, lidar = loaded(sensor={"dropout": 0.1})
    lidar.lidar.name_ = "VLP-16"
    kept, place = fields(lidar.lidar), coordinates_of(lidar)
    path = FOLDER / "source.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    scene, own = loaded()
    bpy.ops.wm.append(filepath=f"{path}/Object/{lidar_name(path)}", directory=f"{path}/Object/", filename="LiDAR")
    handlers.adopt_all()
    other = next(item for item in lidars(scene) if item != own)
    bpy.context.view_layer.update()
    assert fields(other.lidar) == kept
    assert coordinates_of(other) == place
    assert own.lidar.name_ == "RS-16"
    choose(other)
    assert bpy.ops.lidar.scan() == {"FINISHED"}
    assert cloud_of(other) is not None
    assert cloud_of(own) is None


def lidar_name(path):
    with bpy.data.libraries.load(str(path)) as (found, _):
        return next(name for name in found.objects if name == "LiDAR")


def check_two_scenes_of_a_file_do_not_mix():
    scene, lidar = loaded()
    assert bpy.ops.lidar.scan() == {"FINISHED"}
    before = (vertices(cloud_of(lidar)).copy(), fields(scene.blender_lidar), len(scene.objects))
    other = bpy.data.scenes.new("Other")
    bpy.context.window.scene = other
    assert not bpy.ops.lidar.scan.poll()
    assert session.active_lidar(other) is None
    other.blender_lidar.traffic.path = str(example())
    assert bpy.ops.lidar.load() == {"FINISHED"}
    (second,) = lidars(other)
    assert second not in lidars(scene)
    assert second != lidar
    second.lidar.x_m, other.blender_lidar.frame = 8.0, FRAME + 5
    choose(second)
    assert bpy.ops.lidar.scan() == {"FINISHED"}
    assert other.blender_lidar.frame == FRAME + 5
    assert (fields(scene.blender_lidar), len(scene.objects)) == before[1:]
    np.testing.assert_array_equal(vertices(cloud_of(lidar)), before[0])
    assert not set(scene.objects) & set(other.objects)
    bpy.context.window.scene = scene
    assert session.active_lidar(scene) == lidar


def check_the_users_camera_layer_file_and_nesting_stay():
    scene = new_file()
    path = FOLDER / "own.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    camera = bpy.data.objects.new("Mine", bpy.data.cameras.new("Mine"))
    scene.collection.objects.link(camera)
    scene.camera = camera
    layer = scene.view_layers.new("Second")
    bpy.context.window.view_layer = layer
    scene.blender_lidar.traffic.path = str(example())
    assert bpy.ops.lidar.load() == {"FINISHED"}
    site = bpy.data.collections.new("Site")
    scene.collection.children.link(site)
    ours = [one for one in scene.collection.children if one != site]
    for one in ours:  # as users tidy up
        scene.collection.children.unlink(one)
        site.children.link(one)
    collections = len(bpy.data.collections)
    scene.blender_lidar.frame = FRAME
    assert bpy.ops.lidar.load() == {"FINISHED"}
    assert bpy.ops.lidar.scan() == {"FINISHED"}
    assert bpy.ops.lidar.add() == {"FINISHED"}
    assert bpy.ops.lidar.scan() == {"FINISHED"}
    assert len(bpy.data.collections) == collections
    assert list(scene.collection.children) == [site]
    assert scene.camera == camera
    assert bpy.context.view_layer.name == "Second"
    assert bpy.data.filepath == str(path)


# --- The same as the command line -------------------------------------------------------------------------------------


def check_a_scan_and_a_score_are_those_of_the_command_line():
    scene, lidar = loaded(sensor={"range_noise_m": 0.02, "dropout": 0.1, "noise_seed": 3})
    path = FOLDER / "scene" / "scene.toml"
    assert bpy.ops.lidar.export_cloud(filepath=str(FOLDER / "panel.npz")) == {"FINISHED"}
    words = ["scan", str(path), "--frame", str(FRAME), "--out", str(FOLDER / "line.npz"), *OPTIONS]
    assert command_line(words) == 0
    with np.load(FOLDER / "panel.npz") as panel, np.load(FOLDER / "line.npz") as line:
        assert set(panel) == set(line)
        for name in set(line) - {"header"}:
            np.testing.assert_array_equal(panel[name], line[name], err_msg=name)
        one, other = json.loads(str(panel["header"])), json.loads(str(line["header"]))
        assert one.keys() == other.keys()
        points = line["xyz"]
        differ = {key for key in one if one[key] != other[key]}
        assert differ <= {"scene"}, (differ, one, other)
    assert bpy.ops.lidar.scan() == {"FINISHED"}
    np.testing.assert_allclose(evaluated(cloud_of(lidar)), points, atol=2e-5)

    scenario = session.scenario_from(scene, lidar)
    site = prepared(scenario, mounting(POSE))
    assert [frame.vehicles.frame for frame in site.search] == [FRAME]
    with Evaluator(site.search, site.observation, site.scoring) as evaluator:
        totals = evaluator.totals([(mounting(POSE),), (scenario.baseline,)])
    group, vehicles = lidar.lidar, int(totals.vehicles[0])
    assert vehicles > 0
    assert group.vehicles == vehicles
    objectives, shares = totals.objective[:, 0], totals.detectable[:, 0] / vehicles
    for shown, expected in (
        (group.objective, objectives[0]),
        (group.baseline_objective, objectives[1]),
        (group.detectable_share, shares[0]),
        (group.baseline_share, shares[1]),
    ):
        assert abs(shown - expected) <= 1e-6 * abs(expected), (shown, expected)


def check_a_lidar_keeps_its_coordinates_when_the_slope_of_its_road_changes():
    scene, lidar = loaded()
    road = scene.blender_lidar.road
    road.grade_percent, road.cross_fall_percent = 6.0, 2.5
    assert coordinates_of(lidar) == POSE
    scenario = session.scenario_from(scene, lidar)
    assert np.abs(pose_of(lidar).rotation - scenario.mounting(POSE).pose.rotation).max() < 1e-6
    assert np.abs(pose_of(lidar).rotation - mounting(POSE).pose.rotation).max() > 0.02
    scene.cursor.location = (3.0, -1.0, 4.0)
    assert bpy.ops.lidar.add() == {"FINISHED"}
    added = next(item for item in lidars(scene) if item != lidar)
    upright = dict.fromkeys(POSE, 0.0) | {"x_m": 3.0, "y_m": -1.0, "height_m": 4.0}
    assert coordinates_of(added) == upright
    road.grade_percent, road.cross_fall_percent = 0.0, 0.0
    assert (coordinates_of(lidar), coordinates_of(added)) == (POSE, upright)
    assert np.abs(pose_of(lidar).rotation - mounting(POSE).pose.rotation).max() < 1e-6
    lidar.lidar.y_m, road.crown_percent = 5.0, 4.0  # over the lanes
    assert coordinates_of(lidar) == POSE | {"y_m": 5.0}
    above = properties.road_of(scene).surface.height(np.array([POSE["x_m"], 5.0]))
    assert abs(pose_of(lidar).height_m - POSE["height_m"] - above) < 1e-5
    assert above > 0.05


def check_tilts_and_yaw_are_seen_from_where_the_mast_faces():
    lidar = loaded()[1]
    kept = properties.kept_of(lidar.lidar)
    deployment = kept.tables["deployment"] | {"facing_deg": 180.0}
    properties.keep_tables(lidar.lidar, kept.tables | {"deployment": deployment}, kept.folder, kept.fields)
    lidar.lidar.tilt_y_deg, lidar.lidar.yaw_deg = 0.0, 0.0
    assert coordinates_of(lidar) == POSE | {"tilt_y_deg": 0.0, "yaw_deg": 0.0}
    bpy.context.view_layer.update()
    tilt = math.radians(POSE["tilt_x_deg"])
    np.testing.assert_allclose(axes(lidar)[1], [-math.cos(tilt), 0.0, -math.sin(tilt)], atol=1e-6)


def prepared(scenario, hangs):
    """The one frame that the panel shows, as a run has it."""
    traffic = replace(scenario.traffic, frame_ids=(FRAME,), frames=None, holdout=0.0)
    return prepare(replace(scenario, traffic=traffic), [hangs])


def check_an_exported_run_is_that_of_evaluate():
    loaded()
    out, line = FOLDER / "run", FOLDER / "line"
    assert bpy.ops.lidar.export_run(directory=str(out)) == {"FINISHED"}
    words = ["evaluate", str(FOLDER / "scene" / "scene.toml"), "--out", str(line), *OPTIONS]
    assert command_line(words) == 0
    assert {path.name for path in out.iterdir()} <= {path.name for path in line.iterdir()}
    one, other = (without_times(json.loads((folder / "result.json").read_text())) for folder in (out, line))
    assert one.pop("scene") != other.pop("scene")  # what it is called
    for result in (one, other):  # where a scene would search, the panel says where the LiDAR hangs
        result["identity"] = {key: value for key, value in result["identity"].items() if "[deployment]" not in key}
    for key in other:
        assert one[key] == other[key], (key, one[key], other[key])
    assert (out / "vehicles.csv").read_text() == (line / "vehicles.csv").read_text()
    assert "run" in refused(bpy.ops.lidar.export_run, directory=str(out))


def check_an_optimisation_is_that_of_the_command_line():
    scene = new_file()
    scene.blender_lidar.traffic.path = str(example())
    assert bpy.ops.lidar.load() == {"FINISHED"}
    (lidar,) = lidars(scene)
    assert bpy.ops.lidar.optimise() == {"FINISHED"}
    line = FOLDER / "line"
    assert command_line(["optimise", str(FOLDER / "scene" / "scene.toml"), "--out", str(line)]) == 0
    folders = Path(optimising.found_of(lidar)["folder"]), line
    one, other = (without_times(json.loads((folder / "result.json").read_text())) for folder in folders)
    assert one.pop("scene") != other.pop("scene")  # what it is called
    assert_alike(one, other)
    before = coordinates_of(lidar)
    assert bpy.ops.lidar.apply() == {"FINISHED"}
    assert coordinates_of(lidar)["height_m"] == round(other["deployment"]["height_m"], 4)
    assert bpy.ops.lidar.revert() == {"FINISHED"}
    assert coordinates_of(lidar) == before
    shutil.rmtree(folders[0])


# --- Settings ---------------------------------------------------------------------------------------------------------

TYPED = {
    "traffic": {"frames": 7, "holdout": 0.35, "block_s": 12.3, "time_step_s": 0.1, "origin_m": [0.1, -0.7]},
    "road": {"right_edge_m": 1.23, "setback_m": 2.7, "lanes": 3, "lane_width_m": 3.65, "station_m": 12.7},
    "world": {"detail": "box", "ground": False},
    "objective": {"threshold": 0.07, "cell_m": 0.15, "metric": "vgop"},
    "search": {"particles": 5, "iterations": 4, "seed": 11},
    "sensor": {"rotation_hz": 20.0, "range_gate_m": 47.3, "dropout": 0.05, "glass_dropout": 0.3, "unit": 3}
    | {"range_noise_m": 0.023, "range_at_10_percent_m": 81.7, "noise_seed": 9, "unit_spread_deg": 0.07},
    "baseline": {"height_m": 4.1, "tilt_x_deg": 13.7, "x_m": 0.3},
    "region": {"centre_m": [1.1, -2.3], "radius_m": 33.3},
}


def check_every_field_of_the_panel_comes_back_as_it_was_typed():
    scene = new_file()
    known = {
        name: {key: value for key, value in table.items() if key in DECLARED[name]} for name, table in TYPED.items()
    }
    missing = {name: set(TYPED[name]) - set(known[name]) for name in TYPED}
    assert not any(missing.values()), missing
    metric = DECLARED["objective"]["metric"].default
    known["objective"]["metric"] = metric
    known["road"].pop("setback_m")
    path = example(**known)
    first = load_scenario(path)
    tables = first.with_whole_paths()
    session.fill_scene(scene, tables, "", first)
    lidar = operators.add_lidar(scene, mounting(POSE).pose)
    session.fill_lidar(lidar, tables, "", first)
    for group in (scene.blender_lidar, lidar.lidar):  # nothing is kept of the file, so that the fields say all
        assert group.kept
        group.kept = ""
    fields = session.fields_of(scene) | {"sensor": session.sensor_table(lidar)}
    for name, table in known.items():
        for key, value in table.items():
            assert fields[name][key] == value, (name, key, value, fields[name][key])
    scenario = session.scenario_from(scene, lidar).as_tables()
    for name in ("road", "objective", "region", "baseline", "world", "sensor"):
        assert scenario[name] == first.as_tables()[name], name
    assert scenario["deployment"]["height_m"] == (2.0, 4.5)


def check_every_property_is_as_its_setting_is_declared():
    scene, lidar = loaded()
    groups = {name: (getattr(scene.blender_lidar, name), keys) for name, keys in properties.TABLES.items()}
    hung = {key: declared for key, declared in MOUNTING_OR_LEAN.items() if key != "facing_deg"}  # the file's stays
    groups |= {"sensor": (lidar.lidar, properties.SENSOR), "deployment": (lidar.lidar, hung)}
    groups |= {"baseline": (scene.blender_lidar.baseline, properties.SIX)}
    units = {"m": "LENGTH", "deg": "ROTATION", "s": "TIME"}
    for name, (group, keys) in groups.items():
        for key, declared in keys.items():
            found, case = group.bl_rna.properties[key], (name, key)
            assert found.description.lower().startswith(declared.help.lower()), case
            assert found.name, case
            scale = math.radians(1.0) if key.endswith("_deg") else 1.0
            if declared.kind is float:
                assert found.unit == units.get(key.rpartition("_")[2], "NONE"), case
            if declared.kind in (int, float):
                low, high = max(declared.low, declared.above), min(declared.high, declared.below)
                assert not math.isfinite(low) or abs(found.hard_min - scale * low) <= 1e-6 * max(1, abs(low)), case
                assert not math.isfinite(high) or abs(found.hard_max - scale * high) <= 1e-6 * high or high > 2**31, (
                    case
                )
            if declared.default not in (None, ...) and declared.kind in (int, float) and name != "deployment":
                assert abs(found.default - scale * declared.default) < 1e-6 * max(1, abs(declared.default)), case
            if declared.allowed:
                assert [item.identifier for item in found.enum_items] == list(declared.allowed), case


# --- Wrong input ------------------------------------------------------------------------------------------------------


def check_wrong_input_is_one_line_and_changes_nothing():
    scene = new_file()
    scene.blender_lidar.traffic.path = "/nowhere/traffic.csv"
    assert "/nowhere/traffic.csv" in refused(bpy.ops.lidar.load)
    scene.blender_lidar.traffic.path = "/nowhere/scene.toml"
    assert "/nowhere/scene.toml" in refused(bpy.ops.lidar.load)
    scene.blender_lidar.traffic.path = ""
    refused(bpy.ops.lidar.load)
    assert not bpy.ops.lidar.scan.poll()
    scene = new_file()
    scene.unit_settings.scale_length = 0.01
    scene.blender_lidar.traffic.path = str(example())
    assert "unit scale 0.01" in refused(bpy.ops.lidar.load)
    assert "unit scale 0.01" in refused(bpy.ops.lidar.load_example)
    assert "unit scale 0.01" in refused(bpy.ops.lidar.add)
    scene, lidar = loaded()
    choose(lidar)
    (held,) = (one for one in bpy.context.view_layer.layer_collection.children if lidar in list(one.collection.objects))
    held.exclude = True
    assert "excluded" in refused(bpy.ops.lidar.add)
    held.exclude = False
    choose(lidar)
    assert bpy.ops.lidar.scan() == {"FINISHED"}
    operations = {
        bpy.ops.lidar.scan: {},
        bpy.ops.lidar.export_cloud: {"filepath": str(FOLDER / "refused.npz")},
        bpy.ops.lidar.export_labelled: {"directory": str(FOLDER / "refused")},
        bpy.ops.lidar.export_run: {"directory": str(FOLDER / "refused")},
    }
    lidar.lidar.y_m = 5.0  # in a lane
    for operation, given in operations.items():
        assert "LiDAR" in refused(operation, **given)
    lidar.lidar.y_m = 0.0
    lidar.scale.x = -1.0
    bpy.context.view_layer.update()
    for operation, given in operations.items():
        assert "mirrored" in refused(operation, **given)
    lidar.scale.x = 1.0
    bpy.context.view_layer.update()
    table = FOLDER / "beams.toml"
    table.write_text("rings = 3\n", encoding="utf-8")
    lidar.lidar.table_path = str(table)
    lidar.lidar.name_ = "own"
    assert scene.blender_lidar.problem
    assert "\n" not in scene.blender_lidar.problem
    for operation, given in operations.items():
        assert "beams.toml" in refused(operation, **given)
    lidar.lidar.table_path = str(FOLDER / "no_beams.toml")
    for operation, given in operations.items():
        assert "no_beams.toml" in refused(operation, **given)
    lidar.lidar.name_ = "RS-16"
    assert not scene.blender_lidar.problem
    with properties.silently():
        scene.blender_lidar.frame = 99999
    for operation, given in list(operations.items())[:3]:
        assert "99999" in refused(operation, **given)
    scene.blender_lidar.frame = 99999  # typed: the nearest there is
    assert scene.blender_lidar.frame == 59
    assert "Nobody" in refused(bpy.ops.lidar.choose, name="Nobody")
    assert not list(FOLDER.glob("refused*"))
    bpy.data.batch_remove([*lidar.children, lidar])
    assert not bpy.ops.lidar.scan.poll()


# --- What `build` writes ----------------------------------------------------------------------------------------------


def check_what_build_writes_is_taken_over():
    path = example(sensor={"dropout": 0.1, "range_noise_m": 0.02}, road={"grade_percent": 4.0})
    out = FOLDER / "built.blend"
    assert command_line(["build", str(path), "--frame", str(FRAME), "--out", str(out), *OPTIONS]) == 0
    bpy.ops.wm.open_mainfile(filepath=str(out))
    scene = bpy.context.scene
    (lidar,) = lidars(scene)
    written = load_scenario(path).as_tables()
    assert lidar.lidar.schema == properties.SCHEMA
    assert session.scenario_from(scene, lidar).as_tables()["sensor"] == written["sensor"]
    assert session.scenario_from(scene, lidar).as_tables()["road"] == written["road"]
    assert scene.blender_lidar.loaded
    assert scene.blender_lidar.frame == FRAME
    found = coordinates_of(lidar)
    assert {key: found[key] for key in POSE} == POSE
    built = evaluated(cloud_of(lidar))
    choose(lidar)
    assert bpy.ops.lidar.scan() == {"FINISHED"}
    np.testing.assert_allclose(evaluated(cloud_of(lidar)), built, atol=2e-5)
    assert len([child for child in lidar.children if role(child) == CLOUD]) == 1
    lidar.lidar.x_m = 6.0
    assert bpy.ops.lidar.scan() == {"FINISHED"}
    assert len(vertices(cloud_of(lidar))) == lidar.lidar.points != len(built)
    vehicles = [item for item in scene.objects if role(item) == VEHICLE]
    assert bpy.ops.lidar.step_frame() == {"FINISHED"}
    assert scene.blender_lidar.frame == FRAME + 1
    assert abs(len([item for item in scene.objects if role(item) == VEHICLE]) - len(vehicles)) < 10
    bpy.ops.wm.save_mainfile()
    bpy.ops.wm.open_mainfile(filepath=str(out))
    (lidar,) = lidars(bpy.context.scene)
    assert lidar.lidar.x_m == 6.0
    assert bpy.context.scene.blender_lidar.frame == FRAME + 1
    scene = new_file()
    scene["blender_lidar_sensor"] = "no JSON"
    handlers.adopt_all()
    assert "is damaged" in scene.blender_lidar.problem


# --- Registering ------------------------------------------------------------------------------------------------------


def registered():
    """All of Blender's that an add-on may add to."""
    names = {name for name in dir(bpy.types) if "LIDAR" in name.upper()}
    handlers_ = {
        (name, str(call))
        for name in dir(bpy.app.handlers)
        if isinstance(getattr(bpy.app.handlers, name), list)
        for call in getattr(bpy.app.handlers, name)
    }
    on_types = {(kind, name) for kind in ("Scene", "Object") for name in dir(getattr(bpy.types, kind))}
    menus = {str(call) for call in bpy.types.VIEW3D_MT_add._dyn_ui_initialize()}
    timers = {call.__name__ for call in (handlers.adopt_all, live.update) if bpy.app.timers.is_registered(call)}
    return names, handlers_, on_types, menus, timers, list(properties.ON_CHANGE), live._state.drawing


def check_registering_twice_leaves_nothing():
    blender_lidar.unregister()
    before = registered()
    assert not before[0], before[0]
    for _ in range(2):
        blender_lidar.register()
        assert registered() != before
        loaded()
        assert bpy.ops.lidar.scan() == {"FINISHED"}
        blender_lidar.unregister()
        after = registered()
        for one, other in zip(before, after, strict=True):
            assert one == other, one ^ other if isinstance(one, set) else (one, other)
        assert not session._RECORDINGS
        assert not session._FRAMES
    blender_lidar.unregister()  # once more does no harm
    blender_lidar.register()


def main():
    sys.modules["matplotlib"] = None  # charts take longer than all else
    sentence = {}
    blender_lidar.register()
    wanted = sys.argv[-1] if sys.argv[-1].startswith("check_") else "check_"
    for name, check in [(name, check) for name, check in globals().items() if name.startswith(wanted)]:
        shutil.rmtree(FOLDER, ignore_errors=True)
        FOLDER.mkdir(parents=True)
        try:
            check()
            sentence[name.removeprefix("check_")] = ""
        except Exception:
            sentence[name.removeprefix("check_")] = traceback.format_exc()
    new_file()
    blender_lidar.unregister()
    sys.stdout.write(json.dumps({"checks": sentence}) + "\n")


if __name__ == "__main__":
    main()
