"""The road frame: wherever an empty puts the road in the user's world, what is measured beside it stays the same."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from mathutils import Matrix

from blender_lidar import addon
from blender_lidar.addon import handlers, live, optimising, properties, scenarios, session
from blender_lidar.scene.mounting import COORDINATES
from blender_lidar.world.blender.objects import PART, VEHICLE, frame_of, hang, lidars, new_mesh, pose_of, role
from blender_lidar.world.blender.points import cloud_of
from blender_lidar.world.blender.site import read_site
from tests.blender_session import shown_vehicles
from tests.small_scene import REGION, mounting, without_times, write_scene

pytestmark = pytest.mark.versions

PLACE, TURN_RAD = (1000.0, -500.0, 20.0), math.radians(37.0)
THERE = Matrix.Translation(PLACE) @ Matrix.Rotation(TURN_RAD, 4, "Z")
POSE = {"x_m": 0.5, "y_m": -0.25, "height_m": 4.0, "tilt_x_deg": 15.0, "tilt_y_deg": -2.5, "yaw_deg": 7.5}
WALL = np.array([(-30.0, 1.0, 0.0), (-2.0, 1.0, 0.0), (-2.0, 1.0, 3.0), (-30.0, 1.0, 3.0)])


@pytest.fixture
def lidar(tmp_path, quick):
    """A LiDAR beside the small scene's road, with the add-on."""
    bpy.ops.wm.read_homefile(use_empty=True)
    addon.register()
    try:
        scene = bpy.context.scene
        scene.blender_lidar.traffic.path = str(write_scene(tmp_path, REGION | {"model": {"caster": "exact"}}))
        assert bpy.ops.blender_lidar.load() == {"FINISHED"}
        scene.blender_lidar.frame = 20
        found = lidars(scene)[0]
        hang(found, mounting(POSE).pose)
        yield found
    finally:
        addon.unregister()
        bpy.ops.wm.read_homefile(use_empty=True)


def carried_away():
    """Move and turn the road frame."""
    frame = frame_of(bpy.context.scene)
    frame.location, frame.rotation_euler = PLACE, (0.0, 0.0, TURN_RAD)
    bpy.context.view_layer.update()
    return frame


def scored(lidar):
    group = lidar.blender_lidar
    return [group.points, group.vehicles, group.objective, group.detectable_share, group.baseline_objective]


def seen(lidar):
    """What Scan and Live find: scores, and points in the road frame."""
    assert bpy.ops.blender_lidar.scan() == {"FINISHED"}
    found, mesh = scored(lidar), cloud_of(lidar).data
    xyz = np.array([vertex.co for vertex in mesh.vertices])
    lidar.blender_lidar.live = True
    bpy.context.view_layer.update()
    live.update()
    shown = live._state.shown[scenarios.uid_of(lidar)].look.cloud.xyz
    assert scored(lidar) == found
    np.testing.assert_allclose(shown, xyz, atol=1e-5)
    lidar.blender_lidar.live = False
    return found, xyz


def in_world(item, points):
    bpy.context.view_layer.update()
    matrix = np.array(item.evaluated_get(bpy.context.evaluated_depsgraph_get()).matrix_world)
    return points @ matrix[:3, :3].T + matrix[:3, 3]


def moved(points):
    return points @ np.array(THERE)[:3, :3].T + np.array(PLACE)


def wall(parent=None):
    """A wall of the user's own between the LiDAR and half of the road, not beside it wherever that has gone."""
    made = bpy.data.objects.new("wall", new_mesh("wall", WALL, np.array([[0, 1, 2, 3]])))
    bpy.context.scene.collection.objects.link(made)
    made.parent = parent
    return made


def test_scans_scores_and_the_optimum_are_the_same_wherever_the_road_lies(lidar, tmp_path):
    results = []
    for place in range(2):
        if place:
            carried_away()
        results.append(seen(lidar))
        assert bpy.ops.blender_lidar.optimize() == {"FINISHED"}
        folder = Path(optimising.found_of(lidar)["folder"])
        result = without_times(json.loads((folder / "result.json").read_text(encoding="utf-8")))
        results.append(result["deployment"] | {"objective": result["objective"]})
    assert results[0][0] == results[2][0]
    np.testing.assert_array_equal(results[0][1], results[2][1])
    assert results[1] == results[3]
    assert bpy.ops.blender_lidar.apply() == {"FINISHED"}
    assert pose_of(lidar).height_m == pytest.approx(results[1]["height_m"], abs=1e-4)


def test_all_that_is_shown_goes_with_it_and_the_pole_ends_on_the_road(lidar):
    assert bpy.ops.blender_lidar.scan() == {"FINISHED"}
    scene = bpy.context.scene
    ours = [item for item in scene.objects if role(item) not in (None, "beam fan") and item.type == "MESH"]
    before = [(item, np.array([vertex.co for vertex in item.data.vertices])) for item in ours]
    before = [(item, points, in_world(item, points)) for item, points in before]
    carried_away()
    for item, points, there in before:
        np.testing.assert_allclose(in_world(item, points), moved(there), atol=2e-3, err_msg=item.name)
    assert {role(item) for item, *_ in before} == {"road", "marking", VEHICLE, PART, "cloud"}
    scene.blender_lidar.frame = 23
    vehicles = session.vehicles_of(scene)
    shown, *_ = shown_vehicles(scene)
    assert len(shown) == len(vehicles) > 0
    for centre in vehicles.centre_m:
        assert np.abs(shown - moved(centre)).max(axis=1).min() < 1e-3


def test_the_users_own_objects_are_taken_in_the_frame_of_the_road(lidar):
    (free, *_), _ = seen(lidar)
    made = wall()
    behind, points = seen(lidar)
    assert behind != free
    frame = carried_away()
    assert seen(lidar)[0][0] == free  # it stayed where it was
    made.matrix_world = THERE
    bpy.context.view_layer.update()
    for parent in (None, frame):
        if parent is not None:
            made.parent, made.matrix_basis = frame, Matrix()
            bpy.context.view_layer.update()
        found, xyz = seen(lidar)
        np.testing.assert_allclose(found, behind, rtol=2e-3)
        np.testing.assert_allclose(xyz, points, atol=2e-3)


def test_a_lidar_hangs_by_its_coordinates_whatever_it_is_parented_to(lidar):
    scene, frame = bpy.context.scene, carried_away()
    gantry = bpy.data.objects.new("Gantry", None)
    scene.collection.objects.link(gantry)
    gantry.matrix_world = Matrix.Translation((990.0, -490.0, 25.0))
    bpy.context.view_layer.update()
    for parent in (frame, None, gantry):
        lidar.parent = parent
        lidar.blender_lidar.x_m, lidar.blender_lidar.height_m = 3.0, 5.0
        hang(lidar, mounting(POSE).pose)
        bpy.context.view_layer.update()
        table = properties.mounting_of(lidar).as_table()
        np.testing.assert_allclose([table[key] for key in COORDINATES], list(POSE.values()), atol=5e-4)
        np.testing.assert_allclose(
            np.array(lidar.matrix_world.translation), moved(mounting(POSE).pose.position), atol=1e-3
        )
        (pole,) = (item for item in lidar.children if item.name.startswith("Pole"))
        places = in_world(pole, np.array([vertex.co for vertex in pole.data.vertices]))
        assert abs(places[:, 2].min() - PLACE[2]) < 1e-3
        assert abs(places[:, 2].max() - PLACE[2] - POSE["height_m"]) < 1e-3
    scene.cursor.location = moved(np.array([6.0, -1.0, 3.0]))
    assert bpy.ops.blender_lidar.add() == {"FINISHED"}
    added = properties.mounting_of(scenarios.active_lidar(scene)).as_table()
    np.testing.assert_allclose([added[key] for key in COORDINATES], [6.0, -1.0, 3.0, 0.0, 0.0, 0.0], atol=1e-3)


@pytest.mark.parametrize(
    ("key", "value"), [("rotation_euler", (0.1, 0.0, 0.0)), ("scale", (1.0, 1.0, 1.1)), ("scale", (-1.0, 1.0, 1.0))]
)
def test_a_frame_that_is_tilted_scaled_or_mirrored_is_refused_until_it_is_not(lidar, key, value, tmp_path):
    scene, frame = bpy.context.scene, carried_away()
    said = "Road: is tilted, scaled or mirrored; allowed: moved, and turned about z"
    lidar.blender_lidar.live = True
    live.update()
    before = tuple(getattr(frame, key))
    setattr(frame, key, value)
    bpy.context.view_layer.update()
    live.update()
    assert scene.blender_lidar.problem == said
    for operator, given in (
        (bpy.ops.blender_lidar.scan, {}),
        (bpy.ops.blender_lidar.optimize, {}),
        (bpy.ops.blender_lidar.export_cloud, {"filepath": str(tmp_path / "cloud.npz")}),
        (bpy.ops.blender_lidar.add, {}),
    ):
        with pytest.raises(RuntimeError, match=said):
            operator(**given)
    setattr(frame, key, before)
    bpy.context.view_layer.update()
    live.update()
    assert scene.blender_lidar.problem == ""
    assert bpy.ops.blender_lidar.scan() == {"FINISHED"}


def test_a_deleted_or_copied_frame_leaves_one_that_carries_all(lidar):
    scene, frame = bpy.context.scene, carried_away()
    expected = seen(lidar)[0]

    def select():
        for item in bpy.context.view_layer.objects:
            item.select_set(item == frame)
        bpy.context.view_layer.objects.active = frame

    select()
    assert bpy.ops.object.duplicate() == {"FINISHED"}
    bpy.context.object.location.x += 5.0
    assert frame_of(scene) == frame
    assert seen(lidar)[0] == expected
    select()
    assert bpy.ops.object.delete() == {"FINISHED"}
    assert frame_of(scene) is None
    handlers.adopt_all()  # what a timer does in a window
    frame = frame_of(scene)
    assert tuple(frame.location) == (0.0, 0.0, 0.0)
    assert all(item.parent == frame for item in scene.objects if role(item) in ("road", VEHICLE, "lidar"))
    assert seen(lidar)[0] == expected


def test_a_file_of_ours_is_read_in_its_road_frame(lidar, tmp_path):
    wall(carried_away())
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "moved.blend"), copy=True)
    found = read_site(tmp_path / "moved.blend")
    assert found.names == ("wall",)
    np.testing.assert_allclose(found.corners.min(axis=(0, 1)), WALL.min(axis=0), atol=1e-3)
    np.testing.assert_allclose(found.corners.max(axis=(0, 1)), WALL.max(axis=0), atol=1e-3)
