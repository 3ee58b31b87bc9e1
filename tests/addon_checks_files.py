"""Checks of several LiDARs, scenes and files: duplicated, undone, saved, appended, built."""

from __future__ import annotations

import math
from types import SimpleNamespace

import bpy
import numpy as np

from blender_lidar.addon import handlers, operators, properties, scenarios, session
from blender_lidar.cli import main as command_line
from blender_lidar.scene.scenario import load_scenario
from blender_lidar.world.blender.objects import CLOUD, PART, hang, lidars, role
from blender_lidar.world.blender.points import STYLES, cloud_of, colours_by, set_look, show_cloud
from tests.addon_sample import (
    FOLDER,
    FRAME,
    OPTIONS,
    POSE,
    choose,
    coordinates_of,
    evaluated,
    example,
    fan,
    fields,
    loaded,
    new_file,
    part,
    refused,
    vertices,
)
from tests.blender_session import assert_shows, colours_shown
from tests.small_scene import mounting


def check_a_lidar_duplicated_alone_or_whole_is_another_one():
    for whole, linked in ((False, False), (True, False), (True, True)):
        scene, lidar = loaded()
        assert bpy.ops.blender_lidar.scan() == {"FINISHED"}
        of_first = vertices(cloud_of(lidar)).copy()
        score, points = lidar.blender_lidar.objective, lidar.blender_lidar.points
        choose(lidar, *(lidar.children if whole else ()))
        assert bpy.ops.object.duplicate(linked=linked) == {"FINISHED"}
        handlers.adopt_all()  # what a timer does in a window
        first, second = lidars(scene)
        assert first == lidar
        case = f"whole={whole} linked={linked}"
        assert scenarios.uid_of(first) != scenarios.uid_of(second)
        kinds = sorted(role(child) for child in second.children)
        assert kinds.count(PART) == 2, (case, kinds)
        choose(second)
        assert scenarios.active_lidar(scene) == second
        second.blender_lidar.name_, second.blender_lidar.x_m, second.blender_lidar.height_m = "VLP-16", 5.0, 2.5
        assert first.blender_lidar.name_ == "RS-16"
        assert first.blender_lidar.height_m == 4.0
        assert abs(evaluated(part(second, "Pole"))[:, 2].max() - 2.5) < 1e-4, case
        assert abs(evaluated(part(second, "Pole"))[:, 2].min()) < 1e-4, case
        assert abs(evaluated(part(first, "Pole"))[:, 2].min()) < 1e-4, case
        assert bpy.ops.blender_lidar.scan() == {"FINISHED"}
        np.testing.assert_array_equal(vertices(cloud_of(first)), of_first, err_msg=case)
        assert (first.blender_lidar.objective, first.blender_lidar.points) == (score, points), case
        assert second.blender_lidar.points != points, case
        assert len(vertices(cloud_of(second))) == second.blender_lidar.points, case
        choose(first)
        assert bpy.ops.blender_lidar.scan() == {"FINISHED"}
        np.testing.assert_array_equal(vertices(cloud_of(first)), of_first, err_msg=case)


def check_a_lidar_is_added_before_traffic_is_loaded_and_dressed_as_its_model():
    scene = new_file()
    scene.cursor.location = (3.0, -1.0, 0.0)
    assert bpy.ops.blender_lidar.add(height_m=4.0) == {"FINISHED"}
    (lidar,) = lidars(scene)
    assert scenarios.active_lidar(scene) == lidar
    place = coordinates_of(lidar)
    assert (place["x_m"], place["y_m"]) == (3.0, -1.0)
    assert not any(child.name.startswith("Pole") for child in lidar.children)
    beams = len(fan(lidar).data.splines)
    lidar.blender_lidar.name_ = "RS-80"
    assert len(fan(lidar).data.splines) == 5 * beams
    scene.blender_lidar.traffic.path = str(example())
    assert bpy.ops.blender_lidar.load() == {"FINISHED"}
    assert lidars(scene) == [lidar]
    assert coordinates_of(lidar) == place
    assert abs(evaluated(part(lidar, "Pole"))[:, 2].min()) < 1e-4


def check_a_bake_is_what_scan_finds_on_each_frame_and_shows_again_in_the_file_that_is_opened():
    scene, lidar = loaded()
    for frame, x_m in ((1, 0.0), (3, 4.0)):
        lidar.location.x = x_m
        lidar.keyframe_insert("location", frame=frame)
    scene.frame_start, scene.frame_end = 1, 3
    bpy.ops.wm.save_as_mainfile(filepath=str(FOLDER / "bake.blend"))
    assert bpy.ops.blender_lidar.bake() == {"FINISHED"}
    expected = []
    for frame in (1, 2, 3):
        scene.frame_set(frame)
        baked = evaluated(cloud_of(lidar))
        assert bpy.ops.blender_lidar.scan() == {"FINISHED"}
        np.testing.assert_allclose(vertices(cloud_of(lidar)), baked, atol=1e-4)
        expected.append(baked)
    assert not np.array_equal(expected[0], expected[2])
    bpy.ops.wm.open_mainfile(filepath=str(FOLDER / "bake.blend"))
    scene = bpy.context.scene
    for frame in (3, 2, 1):
        scene.frame_set(frame)
        np.testing.assert_allclose(evaluated(cloud_of(lidars(scene)[0])), expected[frame - 1], atol=1e-5)
    scene.frame_set(4)
    assert len(vertices(cloud_of(lidars(scene)[0]))) == 0


def check_a_renamed_lidar_stays_the_chosen_one():
    scene, first = loaded()
    assert bpy.ops.blender_lidar.add() == {"FINISHED"}
    second = scenarios.active_lidar(scene)
    second.name = "Nord"
    bpy.context.view_layer.objects.active = None
    assert scenarios.active_lidar(scene) == second
    assert scenarios.lidars_of(scene) == [first, second]


def check_a_linked_lidar_is_scanned_and_never_written():
    lidar = loaded()[1]
    assert bpy.ops.blender_lidar.scan() == {"FINISHED"}
    points, path = lidar.blender_lidar.points, str(FOLDER / "library.blend")
    bpy.ops.wm.save_as_mainfile(filepath=path)
    scene = new_file()
    with bpy.data.libraries.load(path, link=True) as (there, here):
        here.collections = [name for name in there.collections if name == "LiDAR"]
        here.scenes = there.scenes
    here.scenes[0].blender_lidar.lidars.clear()
    handlers.on_history()
    handlers.on_update(here.scenes[0])
    assert not len(here.scenes[0].blender_lidar.lidars), "a linked scene is written"
    bpy.data.scenes.remove(here.scenes[0])
    scene.collection.children.link(here.collections[0])
    scene.blender_lidar.traffic.path = str(example())
    assert bpy.ops.blender_lidar.load() == {"FINISHED"}  # which adds one of this file
    linked = next(one for one in lidars(scene) if one.library)
    handlers.adopt_all()
    assert linked in scenarios.lidars_of(scene)
    assert len({row.lidar.name for row in scene.blender_lidar.lidars}) == 1  # of two LiDARs
    for number, row in enumerate(scene.blender_lidar.lidars):
        scene.blender_lidar.row = number
        assert scenarios.active_lidar(scene) == row.lidar
    before, count = (fields(linked.blender_lidar), np.array(linked.matrix_world).tolist()), len(bpy.data.objects)
    choose(linked)
    scene.blender_lidar.frame = FRAME
    assert bpy.ops.blender_lidar.scan() == {"FINISHED"}
    told = []
    operators.BLENDER_LIDAR_OT_scan.execute(SimpleNamespace(report=lambda *said: told.append(said)), bpy.context)
    assert f"{linked.name}: {points:,} points at" in told[0][1]
    cloud = cloud_of(linked)
    assert cloud.library is None
    assert len(vertices(cloud)) == points
    linked.blender_lidar.height_m = 8.0
    assert f"{linked.name}: is linked from" in scene.blender_lidar.problem
    for _ in range(3):  # no handler makes anything of it
        linked.select_set(True)
        bpy.context.view_layer.update()
        handlers.adopt_all()
    assert (fields(linked.blender_lidar), np.array(linked.matrix_world).tolist()) == before
    assert len(bpy.data.objects) == count + 1
    assert cloud.name in scene.objects


def check_a_lidar_that_cannot_be_completed_is_tried_once():
    scene, lidar = loaded()
    lidar.blender_lidar.name_, lidar.blender_lidar.table_path = "own", "//nowhere.toml"
    choose(lidar)
    bpy.ops.object.duplicate()
    bpy.context.view_layer.update()
    handlers.adopt_all()
    assert "nowhere.toml: there is no such file" in scene.blender_lidar.problem
    told = []
    bpy.app.handlers.depsgraph_update_post.append(told.append)
    try:
        for _ in range(3):
            handlers.on_update(scene, bpy.context.evaluated_depsgraph_get())
            handlers.adopt_all()
            bpy.context.view_layer.update()
    finally:
        bpy.app.handlers.depsgraph_update_post.remove(told.append)
    assert not told, "what failed is an update again"
    assert len(lidars(scene)) == 2


def check_what_a_deleted_lidar_wore_goes_with_it():
    scene = loaded()[0]
    assert bpy.ops.blender_lidar.scan() == {"FINISHED"}
    assert bpy.ops.blender_lidar.add() == {"FINISHED"}
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
    assert bpy.ops.blender_lidar.scan() == {"FINISHED"}
    np.testing.assert_allclose(evaluated(cloud_of(lidar)), vertices(cloud_of(lidar)), atol=1e-4)
    assert abs(evaluated(part(lidar, "Pole"))[:, 2].min()) < 1e-4


def any_points(count=500, seed=1):
    rng = np.random.default_rng(seed)
    whole = {"ring": (0, 16), "vehicle": (-9, 2**24), "label": (-3, 9), "lidar": (0, 2)}
    points = {name: rng.integers(*ends, count).clip(-1) for name, ends in whole.items()}
    points |= {name: most * rng.random(count) for name, most in (("range", 90.0), ("intensity", 1.0), ("entropy", 1.2))}
    return points | {"xyz": rng.normal(size=(count, 3)), "time": np.zeros(count)}


def check_nodes_show_the_colors_that_are_drawn_live_and_leave_out_ranges():
    _, lidar = loaded()
    group, points = lidar.blender_lidar, any_points()
    cloud = show_cloud(lidar, points)
    np.testing.assert_allclose(colours_shown(cloud), colours_by("entropy", points), atol=2e-6)
    for name in group.bl_rna.properties["colour_by"].enum_items.keys():  # noqa: SIM118
        group.colour_by = name
        np.testing.assert_allclose(colours_shown(cloud), colours_by(name, points), atol=2e-6, err_msg=name)
    set_look(cloud, {"Range From": 20.0, "Range To": 40.0})
    among = (points["range"] >= 20.0) & (points["range"] <= 40.0)
    np.testing.assert_allclose(colours_shown(cloud), colours_by(group.colour_by, points)[among], atol=2e-6)
    show_cloud(lidar, any_points(count=7, seed=2))
    set_look(cloud, {"Range From": 0.0, "Range To": 1e6})
    assert len(colours_shown(cloud)) == 7


def check_styles_are_assets_with_materials_of_their_own():
    _, lidar = loaded()
    points = any_points()
    cloud, groups, materials = show_cloud(lidar, points), set(), set()
    for style, (colour_by, *_, told) in STYLES.items():
        lidar.blender_lidar.style = style
        assert lidar.blender_lidar.colour_by == colour_by
        np.testing.assert_allclose(colours_shown(cloud), colours_by(colour_by, points), atol=2e-6, err_msg=style)
        shown = cloud.modifiers[0].node_group
        assert shown.asset_data.description == told
        groups.add(shown.name)
        materials |= materials_of(cloud)
        mine = bpy.data.materials.new("mine")
        set_look(cloud, {"Material": mine})
        assert materials_of(cloud) == {mine.name}
    assert len(materials) == len(STYLES)
    assert groups == {"LiDAR Points", "Rings", "Intensity on Black", "By Vehicle"}


def materials_of(cloud):
    bpy.context.view_layer.update()
    for one in bpy.context.evaluated_depsgraph_get().object_instances:
        if one.object.name == cloud.name and "colour" in one.object.data.attributes:
            return {material.name for material in one.object.data.materials if material is not None}
    return set()


def check_a_cloud_without_a_look_is_given_one_and_groups_of_the_users_own_stay():
    _, lidar = loaded()
    cloud = show_cloud(lidar, any_points())
    cloud.modifiers[0].node_group = None
    points = any_points(count=300, seed=2)
    assert show_cloud(lidar, points, "ring") == cloud
    np.testing.assert_allclose(colours_shown(cloud), colours_by("ring", points), atol=2e-6)
    own = cloud.modifiers[0].node_group = bpy.data.node_groups.new("own", "GeometryNodeTree")
    show_cloud(lidar, points, "range")
    assert cloud.modifiers[0].node_group == own
    cloud.modifiers.clear()
    show_cloud(lidar, points, "range")
    assert not cloud.modifiers
    lidar.blender_lidar.style = "Rings"
    assert cloud.modifiers[0].node_group.name == "Rings"


def check_undo_and_redo_take_back_pose_and_cloud_together():
    lidar = loaded()[1]
    assert bpy.ops.blender_lidar.scan() == {"FINISHED"}
    bpy.ops.ed.undo_push(message="first")
    name, first = lidar.name, (vertices(cloud_of(lidar)).copy(), coordinates_of(lidar), fields(lidar.blender_lidar))
    lidar.blender_lidar.x_m, lidar.blender_lidar.tilt_x_deg = 6.0, math.radians(5.0)
    assert bpy.ops.blender_lidar.scan() == {"FINISHED"}
    bpy.ops.ed.undo_push(message="second")
    second = (vertices(cloud_of(lidar)).copy(), coordinates_of(lidar), fields(lidar.blender_lidar))
    assert len(first[0]) != len(second[0])
    for step, expected in ((bpy.ops.ed.undo, first), (bpy.ops.ed.redo, second), (bpy.ops.ed.undo, first)):
        assert step() == {"FINISHED"}
        lidar = bpy.context.scene.objects[name]
        np.testing.assert_array_equal(vertices(cloud_of(lidar)), expected[0])
        assert coordinates_of(lidar) == expected[1]
        assert fields(lidar.blender_lidar) == expected[2]
    assert bpy.ops.blender_lidar.scan() == {"FINISHED"}
    np.testing.assert_array_equal(vertices(cloud_of(bpy.context.scene.objects[name])), first[0])


def check_saving_and_opening_again_keeps_all_and_reads_traffic_by_need():
    scene, lidar = loaded(sensor={"dropout": 0.1, "range_noise_m": 0.02})
    assert bpy.ops.blender_lidar.scan() == {"FINISHED"}
    cloud, kept, all_of = vertices(cloud_of(lidar)).copy(), fields(lidar.blender_lidar), fields(scene.blender_lidar)
    path = FOLDER / "saved.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    new_file()
    bpy.ops.wm.open_mainfile(filepath=str(path))
    scene = bpy.context.scene
    (lidar,) = lidars(scene)
    assert session._RECORDINGS == {}, "traffic is read when it is asked for"
    assert fields(lidar.blender_lidar) == kept
    assert fields(scene.blender_lidar) == all_of
    np.testing.assert_array_equal(vertices(cloud_of(lidar)), cloud)
    assert bpy.ops.blender_lidar.scan() == {"FINISHED"}
    np.testing.assert_array_equal(vertices(cloud_of(lidar)), cloud)
    bpy.ops.wm.open_mainfile(filepath=str(path))
    (FOLDER / "scene" / "traffic.csv").rename(FOLDER / "away.csv")
    try:
        assert "traffic.csv" in refused(bpy.ops.blender_lidar.scan)
    finally:
        (FOLDER / "away.csv").rename(FOLDER / "scene" / "traffic.csv")
    assert bpy.ops.blender_lidar.scan() == {"FINISHED"}


def check_a_lidar_appended_into_another_file_keeps_its_settings():
    scene, lidar = loaded(sensor={"dropout": 0.1})
    lidar.blender_lidar.name_ = "VLP-16"
    kept, place = fields(lidar.blender_lidar), coordinates_of(lidar)
    path = FOLDER / "source.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    scene, own = loaded()
    bpy.ops.wm.append(filepath=f"{path}/Object/{lidar_name(path)}", directory=f"{path}/Object/", filename="LiDAR")
    handlers.adopt_all()
    other = next(item for item in lidars(scene) if item != own)
    bpy.context.view_layer.update()
    assert fields(other.blender_lidar) == kept
    assert coordinates_of(other) == place
    assert own.blender_lidar.name_ == "RS-16"
    choose(other)
    assert bpy.ops.blender_lidar.scan() == {"FINISHED"}
    assert cloud_of(other) is not None
    assert cloud_of(own) is None


def lidar_name(path):
    with bpy.data.libraries.load(str(path)) as (found, _):
        return next(name for name in found.objects if name == "LiDAR")


def check_two_scenes_of_a_file_do_not_mix():
    scene, lidar = loaded()
    assert bpy.ops.blender_lidar.scan() == {"FINISHED"}
    before = (vertices(cloud_of(lidar)).copy(), fields(scene.blender_lidar), len(scene.objects))
    other = bpy.data.scenes.new("Other")
    bpy.context.window.scene = other
    assert not bpy.ops.blender_lidar.scan.poll()
    assert scenarios.active_lidar(other) is None
    other.blender_lidar.traffic.path = str(example())
    assert bpy.ops.blender_lidar.load() == {"FINISHED"}
    (second,) = lidars(other)
    assert second not in lidars(scene)
    assert second != lidar
    second.blender_lidar.x_m, other.blender_lidar.frame = 8.0, FRAME + 5
    choose(second)
    assert bpy.ops.blender_lidar.scan() == {"FINISHED"}
    assert other.blender_lidar.frame == FRAME + 5
    assert (fields(scene.blender_lidar), len(scene.objects)) == before[1:]
    np.testing.assert_array_equal(vertices(cloud_of(lidar)), before[0])
    assert not set(scene.objects) & set(other.objects)
    bpy.context.window.scene = scene
    assert scenarios.active_lidar(scene) == lidar


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
    assert bpy.ops.blender_lidar.load() == {"FINISHED"}
    site = bpy.data.collections.new("Site")
    scene.collection.children.link(site)
    ours = [one for one in scene.collection.children if one != site]
    for one in ours:  # as users tidy up
        scene.collection.children.unlink(one)
        site.children.link(one)
    collections = len(bpy.data.collections)
    scene.blender_lidar.frame = FRAME
    assert bpy.ops.blender_lidar.load() == {"FINISHED"}
    assert bpy.ops.blender_lidar.scan() == {"FINISHED"}
    assert bpy.ops.blender_lidar.add() == {"FINISHED"}
    assert bpy.ops.blender_lidar.scan() == {"FINISHED"}
    assert len(bpy.data.collections) == collections
    assert list(scene.collection.children) == [site]
    assert scene.camera == camera
    assert bpy.context.view_layer.name == "Second"
    assert bpy.data.filepath == str(path)


def check_what_build_writes_is_taken_over():
    path = example(sensor={"dropout": 0.1, "range_noise_m": 0.02}, road={"grade_percent": 4.0})
    out = FOLDER / "built.blend"
    assert command_line(["build", str(path), "--frame", str(FRAME), "--out", str(out), *OPTIONS]) == 0
    bpy.ops.wm.open_mainfile(filepath=str(out))
    scene = bpy.context.scene
    (lidar,) = lidars(scene)
    written = load_scenario(path).as_tables()
    assert lidar.blender_lidar.schema == properties.SCHEMA
    assert scenarios.scenario_from(scene, lidar).as_tables()["sensor"] == written["sensor"]
    assert scenarios.scenario_from(scene, lidar).as_tables()["road"] == written["road"]
    assert scene.blender_lidar.loaded
    assert scene.blender_lidar.frame == FRAME
    found = coordinates_of(lidar)
    assert {key: found[key] for key in POSE} == POSE
    built = evaluated(cloud_of(lidar))
    choose(lidar)
    assert bpy.ops.blender_lidar.scan() == {"FINISHED"}
    np.testing.assert_allclose(evaluated(cloud_of(lidar)), built, atol=2e-5)
    assert len([child for child in lidar.children if role(child) == CLOUD]) == 1
    lidar.blender_lidar.x_m = 6.0
    assert bpy.ops.blender_lidar.scan() == {"FINISHED"}
    assert len(vertices(cloud_of(lidar))) == lidar.blender_lidar.points != len(built)
    assert_shows(scene, session.vehicles_of(scene))
    assert bpy.ops.blender_lidar.step_frame() == {"FINISHED"}
    assert scene.blender_lidar.frame == FRAME + 1
    assert_shows(scene, session.vehicles_of(scene))
    assert len(session.vehicles_of(scene)) > 0
    bpy.ops.wm.save_mainfile()
    bpy.ops.wm.open_mainfile(filepath=str(out))
    (lidar,) = lidars(bpy.context.scene)
    assert lidar.blender_lidar.x_m == 6.0
    assert bpy.context.scene.blender_lidar.frame == FRAME + 1
    scene = new_file()
    scene["blender_lidar_sensor"] = "no JSON"
    handlers.adopt_all()
    assert "is damaged" in scene.blender_lidar.problem
