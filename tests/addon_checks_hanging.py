"""Checks of where a LiDAR hangs: poses, panel and transform, and what it wears."""

from __future__ import annotations

import json
import math

import bpy
import numpy as np

from blender_lidar.addon import operators, properties, scenarios
from blender_lidar.scene.mounting import COORDINATES
from blender_lidar.sensors.pose import Pose
from blender_lidar.world.blender.objects import CLOUD, FAN, PART, hang, lidars, pose_of, role
from blender_lidar.world.blender.points import cloud_of
from tests.addon_sample import (
    FOLDER,
    POSE,
    axes,
    choose,
    coordinates_of,
    evaluated,
    loaded,
    part,
    refused,
    vertices,
)
from tests.small_scene import mounting


def check_fifteen_degrees_of_tilt_show_as_fifteen_and_look_down_across_the_road():
    lidar = loaded()[1]
    hang(lidar, Pose(0.0, 0.0, 4.0))
    lidar.blender_lidar.tilt_x_deg = math.radians(15.0)
    bpy.context.view_layer.update()
    assert coordinates_of(lidar)["tilt_x_deg"] == 15.0
    assert abs(lidar.blender_lidar.tilt_x_deg - math.radians(15.0)) < 1e-6
    assert abs(lidar.blender_lidar.lean_deg - math.radians(15.0)) < 1e-6
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
            setattr(lidar.blender_lidar, key, math.radians(value) if key.endswith("_deg") else value)
        bpy.context.view_layer.update()
        found, expected = pose_of(lidar), mounting(place).pose
        np.testing.assert_allclose(axes(lidar), expected.to_world(np.eye(3)), atol=2e-5, err_msg=str(place))
        np.testing.assert_allclose(found.to_world(np.eye(3)), expected.to_world(np.eye(3)), atol=2e-5)
        np.testing.assert_allclose(found.position, expected.position, atol=1e-4)
        for key, value in place.items():
            shown = getattr(lidar.blender_lidar, key)
            shown = math.degrees(shown) if key.endswith("_deg") else shown
            assert abs(shown - value) < 2e-3, (key, value, shown, place)


def check_a_lean_is_what_poses_call_so():
    lidar = loaded()[1]
    rng = np.random.default_rng(2)
    for _ in range(30):
        lean, direction, spin = (round(value, 2) for value in rng.uniform((1, -170, -170), (80, 170, 170)))
        hang(lidar, Pose(1.0, 2.0, 4.0))
        group = lidar.blender_lidar
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
    lidar.blender_lidar.tilt_x_deg = math.radians(15.0)
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
        lidar.blender_lidar.tilt_x_deg = math.radians(15.0)
        assert coordinates_of(lidar)["tilt_x_deg"] == 15.0, mode
    lidar.constraints.new("COPY_LOCATION").target = target
    bpy.context.view_layer.update()
    np.testing.assert_allclose(pose_of(lidar).position, target.location, atol=1e-4)
    assert bpy.ops.blender_lidar.scan() == {"FINISHED"}
    np.testing.assert_allclose(evaluated(cloud_of(lidar)), vertices(cloud_of(lidar)), atol=1e-4)


def check_what_else_holds_a_pose_is_named_and_nothing_changes():
    scene, lidar = loaded()
    found = {"places": {lidar.name: {"deployment": POSE | {"x_m": 7.0}, "before": POSE}}, "lines": [], "holdout": None}
    lidar.blender_lidar.found = json.dumps(found)
    target = bpy.data.objects.new("Target", None)
    scene.collection.objects.link(target)

    def constrained():
        lidar.constraints.new("TRACK_TO").target = target
        return "Track To", lambda: lidar.constraints.clear()

    def animated():
        lidar.keyframe_insert("location", frame=1)
        return lidar.animation_data.action.name, lidar.animation_data_clear

    def driven():
        lidar.driver_add("rotation_euler", 0)
        return "driver", lidar.animation_data_clear

    for hold in (constrained, animated, driven):
        held, let_go = hold()
        bpy.context.view_layer.update()
        before = np.array(lidar.matrix_world)
        assert held in refused(bpy.ops.blender_lidar.apply)
        assert held in refused(bpy.ops.blender_lidar.revert)
        lidar.blender_lidar.height_m = 9.0
        assert held in scene.blender_lidar.problem, (held, scene.blender_lidar.problem)
        bpy.context.view_layer.update()
        np.testing.assert_array_equal(np.array(lidar.matrix_world), before, err_msg=held)
        let_go()
    assert bpy.ops.blender_lidar.apply() == {"FINISHED"}
    assert coordinates_of(lidar)["x_m"] == 7.0


def check_a_sheared_lidar_is_refused_by_its_name_and_the_parents():
    scene, lidar = loaded()
    stretched = bpy.data.objects.new("Stretched", None)
    scene.collection.objects.link(stretched)
    stretched.scale, lidar.rotation_euler = (0.5, 0.5, 3.0), (0.6, 0.0, 0.0)
    lidar.parent = stretched
    bpy.context.view_layer.update()
    line = refused(bpy.ops.blender_lidar.scan)
    assert f"{lidar.name}: is sheared by its parent Stretched" in line, line
    assert math.isnan(lidar.blender_lidar.tilt_x_deg)
    stretched.scale = (2.0, 2.0, 2.0)
    assert bpy.ops.blender_lidar.scan() == {"FINISHED"}


def check_who_clicks_on_a_part_selects_the_lidar():
    scene, lidar = loaded()
    layer = bpy.context.view_layer
    for piece in [child for child in lidar.children if role(child) in (PART, FAN)]:
        assert not piece.hide_select, piece.name
        choose(piece)
        operators.select_wearer(layer)
        assert layer.objects.active == lidar, piece.name
        assert bpy.context.selected_objects == [lidar], piece.name
    other = bpy.data.objects.new("Other", None)
    scene.collection.objects.link(other)
    choose(other)
    operators.select_wearer(layer)
    assert layer.objects.active == other
    scene.blender_lidar.row = 0
    assert (bpy.context.selected_objects, layer.objects.active) == ([lidar], lidar)


def check_paths_may_be_relative_to_the_file():
    scene, lidar = loaded()
    bpy.ops.wm.save_as_mainfile(filepath=str(FOLDER / "relative.blend"))
    scene.blender_lidar.traffic.path = "//scene/traffic.csv"
    assert bpy.ops.blender_lidar.load() == {"FINISHED"}
    assert bpy.ops.blender_lidar.scan() == {"FINISHED"}
    lidar.blender_lidar.table_path = "//none.toml"
    lidar.blender_lidar.name_ = "own"
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
    assert bpy.ops.blender_lidar.scan() == {"FINISHED"}
    cloud = cloud_of(lidar)
    before, pose = evaluated(cloud), pose_of(lidar)
    lidar.blender_lidar.x_m, lidar.blender_lidar.yaw_deg = 10.0, math.radians(90.0)
    after = pose_of(lidar)
    in_sensor = (before - pose.position) @ pose.to_world(np.eye(3)).T
    np.testing.assert_allclose(evaluated(cloud), after.to_world(in_sensor) + after.position, atol=1e-3)
    for child in lidar.children:
        assert child.parent == lidar
        if child.name.startswith("Head") or role(child) not in (PART, CLOUD):
            np.testing.assert_allclose(
                np.array(child.matrix_world)[:3], np.array(lidar.matrix_world)[:3], atol=1e-5, err_msg=child.name
            )


def check_a_lidar_keeps_its_coordinates_when_the_slope_of_its_road_changes():
    scene, lidar = loaded()
    road = scene.blender_lidar.road
    road.grade_percent, road.cross_fall_percent = 6.0, 2.5
    assert coordinates_of(lidar) == POSE
    scenario = scenarios.scenario_from(scene, lidar)
    assert np.abs(pose_of(lidar).rotation - scenario.lidar.mounting(POSE).pose.rotation).max() < 1e-6
    assert np.abs(pose_of(lidar).rotation - mounting(POSE).pose.rotation).max() > 0.02
    scene.cursor.location = (3.0, -1.0, 4.0)
    assert bpy.ops.blender_lidar.add() == {"FINISHED"}
    added = next(item for item in lidars(scene) if item != lidar)
    upright = dict.fromkeys(POSE, 0.0) | {"x_m": 3.0, "y_m": -1.0, "height_m": 4.0}
    assert coordinates_of(added) == upright
    road.grade_percent, road.cross_fall_percent = 0.0, 0.0
    assert (coordinates_of(lidar), coordinates_of(added)) == (POSE, upright)
    assert np.abs(pose_of(lidar).rotation - mounting(POSE).pose.rotation).max() < 1e-6
    lidar.blender_lidar.y_m, road.crown_percent = 5.0, 4.0  # over the lanes
    assert coordinates_of(lidar) == POSE | {"y_m": 5.0}
    above = properties.road_of(scene).surface.height(np.array([POSE["x_m"], 5.0]))
    assert abs(pose_of(lidar).height_m - POSE["height_m"] - above) < 1e-5
    assert above > 0.05


def check_tilts_and_yaw_are_seen_from_where_the_mast_faces():
    lidar = loaded()[1]
    kept = properties.kept_of(lidar.blender_lidar)
    deployment = kept.tables["deployment"] | {"facing_deg": 180.0}
    properties.keep_tables(lidar.blender_lidar, kept.tables | {"deployment": deployment}, kept.folder, kept.fields)
    lidar.blender_lidar.tilt_y_deg, lidar.blender_lidar.yaw_deg = 0.0, 0.0
    assert coordinates_of(lidar) == POSE | {"tilt_y_deg": 0.0, "yaw_deg": 0.0}
    bpy.context.view_layer.update()
    tilt = math.radians(POSE["tilt_x_deg"])
    np.testing.assert_allclose(axes(lidar)[1], [-math.cos(tilt), 0.0, -math.sin(tilt)], atol=1e-6)
