"""Checks of scans without traffic: any scene, labels and materials, the ground, LiDARs on what moves, coverage."""

from __future__ import annotations

import json
import math

import bpy
import numpy as np

from blender_lidar.addon import handlers, live, scenarios
from blender_lidar.clouds.files import LABELS, read_cloud
from blender_lidar.world.blender.objects import frame_of, lidars, role
from blender_lidar.world.blender.points import cloud_of
from tests.addon_sample import FOLDER, choose, loaded, refused, vertices


def default_scene():
    """A new file as Blender opens it: a cube, a camera and a light."""
    bpy.ops.wm.read_homefile(use_factory_startup=True)
    return bpy.context.scene


def attribute(cloud, name):
    found = np.empty(len(cloud.data.vertices))
    cloud.data.attributes[name].data.foreach_get("value", found)
    return found


def seen_live(lidar):
    bpy.context.view_layer.update()
    live.update()
    return live._state.shown[scenarios.uid_of(lidar)].look.cloud


def check_add_and_live_show_points_on_the_default_cube():
    scene = default_scene()
    assert bpy.ops.blender_lidar.add() == {"FINISHED"}
    (lidar,) = lidars(scene)
    assert bpy.context.view_layer.objects.active == lidar
    assert frame_of(scene) is None
    lidar.blender_lidar.live = True
    cloud = seen_live(lidar)
    on_cube = np.isclose(np.abs(cloud.xyz).max(axis=1), 1.0, atol=1e-3)
    assert len(cloud) > 100
    assert on_cube.all()
    preview = cloud.xyz
    lidar.blender_lidar.live = False
    live.update()
    assert bpy.ops.blender_lidar.scan() == {"FINISHED"}
    exact = vertices(cloud_of(lidar))
    np.testing.assert_allclose(exact, preview, atol=1e-3)
    number = sorted({item.name for item in scene.objects if role(item) is None}).index("Cube")
    assert set(attribute(cloud_of(lidar), "label").tolist()) == {number}
    assert np.isclose(attribute(cloud_of(lidar), "intensity").max(), 0.8, atol=0.01)
    assert not scene.blender_lidar.problem
    handlers.adopt_all()
    assert frame_of(scene) is None
    assert len(lidar.children) == 3  # head, fan, cloud


def check_a_lidar_without_traffic_hangs_where_the_cursor_is_and_as_its_options_say():
    scene = default_scene()
    scene.cursor.location = (5.0, 2.0, -3.0)
    assert bpy.ops.blender_lidar.add(model="VLP-16", live=True) == {"FINISHED"}
    (lidar,) = lidars(scene)
    assert (lidar.blender_lidar.name_, lidar.blender_lidar.live) == ("VLP-16", True)
    assert tuple(lidar.location) == (5.0, 2.0, -3.0)
    seen_live(lidar)
    assert not scene.blender_lidar.problem
    lidar.blender_lidar.live = False
    live.update()
    assert bpy.ops.blender_lidar.scan() == {"FINISHED"}
    assert bpy.ops.blender_lidar.add(height_m=1.5) == {"FINISHED"}
    assert bpy.context.view_layer.objects.active.location.z == 1.5
    scene.unit_settings.scale_length = 0.01
    assert "unit scale" in refused(bpy.ops.blender_lidar.scan)


def check_clouds_are_exported_without_traffic_with_labels_and_read_again():
    scene = default_scene()
    assert bpy.ops.blender_lidar.add() == {"FINISHED"}
    scene.objects["Cube"].name = "Würfel"
    scene.blender_lidar.label_by = "material"
    for suffix in ("npz", "ply", "pcd", "bin"):
        path = FOLDER / f"cloud.{suffix}"
        assert bpy.ops.blender_lidar.export_cloud(filepath=str(path)) == {"FINISHED"}
        assert path.stat().st_size > 1000
    cloud, header = read_cloud(FOLDER / "cloud.npz")
    assert list(header[LABELS].values()) == ["Material"]
    assert (cloud.label == int(next(iter(header[LABELS])))).all()
    scene.blender_lidar.label_by = "object"
    assert bpy.ops.blender_lidar.export_cloud(filepath=str(FOLDER / "again.npz")) == {"FINISHED"}
    assert list(read_cloud(FOLDER / "again.npz")[1][LABELS].values()) == ["Würfel"]
    assert bpy.ops.blender_lidar.export_labelled(directory=str(FOLDER / "labelled")) == {"FINISHED"}
    assert json.loads(next((FOLDER / "labelled" / "label").iterdir()).read_text()) == []
    for needs in ("export_run", "optimize", "set_baseline"):
        assert not getattr(bpy.ops.blender_lidar, needs).poll(), needs


def check_labels_are_the_same_live_and_exact():
    scene = default_scene()
    assert bpy.ops.blender_lidar.add() == {"FINISHED"}
    (lidar,) = lidars(scene)
    bpy.ops.mesh.primitive_uv_sphere_add(location=(3.0, 0.0, 0.0))
    ball = bpy.context.object
    ball.pass_index = 4
    ball.data.materials.append(bpy.data.materials.new("Blech"))
    choose(lidar)
    for by in ("object", "collection", "pass_index", "material"):
        scene.blender_lidar.label_by = by
        lidar.blender_lidar.live = True
        mine = seen_live(lidar)
        lidar.blender_lidar.live = False
        live.update()
        assert bpy.ops.blender_lidar.scan() == {"FINISHED"}
        exact = attribute(cloud_of(lidar), "label")
        assert len(set(exact.tolist())) == (1 if by == "collection" else 2), by
        assert abs(len(exact) - len(mine)) <= 0.01 * len(exact)
        if len(exact) == len(mine):
            assert (exact == mine.label).mean() > 0.99, by


def check_a_lidar_on_a_parent_that_moves_looks_from_where_it_is():
    scene = default_scene()
    tug = bpy.data.objects.new("Tug", None)
    scene.collection.objects.link(tug)
    tug.keyframe_insert("location", frame=1)
    tug.location.x = 4.0
    tug.keyframe_insert("location", frame=11)
    scene.frame_set(1)
    assert bpy.ops.blender_lidar.add() == {"FINISHED"}
    (lidar,) = lidars(scene)
    lidar.parent = tug
    lidar.blender_lidar.live = True
    first = seen_live(lidar)
    scene.frame_set(11)
    second = seen_live(lidar)
    assert len(second) != len(first)
    assert abs(second.xyz[:, 0] - 4.0).max() > 2.9  # to the cube's left face
    assert np.isclose(np.abs(second.xyz).max(axis=1), 1.0, atol=1e-3).all()
    lidar.blender_lidar.live = False
    live.update()
    assert bpy.ops.blender_lidar.scan() == {"FINISHED"}
    np.testing.assert_allclose(vertices(cloud_of(lidar)), second.xyz, atol=1e-3)


def check_the_ground_returns_where_it_is_shown():
    scene, lidar = loaded()
    parts = {item.data.name.split(".")[0]: item for item in scene.objects if role(item) in ("road", "marking")}

    def scanned():
        bpy.context.view_layer.update()
        assert bpy.ops.blender_lidar.scan() == {"FINISHED"}
        return vertices(cloud_of(lidar))[attribute(cloud_of(lidar), "vehicle") < 0]

    def on_ground(cloud):
        return np.abs(cloud[:, 2]) < 0.03

    whole = scanned()
    scene.blender_lidar.world.ground = False
    assert all(item.hide_viewport and item.hide_render for item in parts.values())
    assert len(scanned()) == 0
    assert on_ground(whole).all()
    scene.blender_lidar.world.ground = True
    assert not any(item.hide_viewport or item.hide_render for item in parts.values())
    np.testing.assert_array_equal(scanned(), whole)
    parts["Verge"].hide_set(True)
    on_road = scanned()
    assert set(map(tuple, on_road.round(2).tolist())) <= set(map(tuple, whole.round(2).tolist()))
    low, high = np.array(parts["Surface"].bound_box)[[0, 6], 1]
    inside = (whole[:, 1] > low) & (whole[:, 1] < high)
    np.testing.assert_allclose(on_road[on_ground(on_road)], whole[on_ground(whole) & inside], atol=1e-4)
    lidar.blender_lidar.live = True
    assert abs((seen_live(lidar).vehicle_id < 0).sum() - len(on_road)) <= 0.01 * len(on_road)
    lidar.blender_lidar.live = False
    live.update()
    bpy.data.objects.remove(parts["Surface"])
    assert not on_ground(scanned()).any()
    assert math.isclose(lidar.blender_lidar.height_m, 4.0)


def check_coverage_is_what_brute_force_finds_of_each_and_of_all_on_a_parent_that_moves():
    scene = default_scene()
    tug, cube = bpy.data.objects.new("Tug", None), scene.objects["Cube"]
    scene.collection.objects.link(tug)
    tug.keyframe_insert("location", frame=1)
    tug.location.x = 100.0
    tug.keyframe_insert("location", frame=11)
    scene.frame_set(1)
    cube.scale = (0.99, 0.99, 0.99)
    for side in (-1.0, 1.0):  # one sees the face at -y, the other that at +y
        scene.cursor.location = (0.0, side * 3.0, 0.0)
        assert bpy.ops.blender_lidar.add() == {"FINISHED"}
        bpy.context.object.parent = tug
    assert "no object with faces is selected" in refused(bpy.ops.blender_lidar.coverage)
    choose(cube)
    assert bpy.ops.blender_lidar.coverage(edge_m=0.25) == {"FINISHED"}
    told = json.loads(scene.blender_lidar.covered)
    (_, points, _, first), (_, _, _, second), (name, both, cells, share) = told["rows"]
    assert (name, both) == ("All", 2 * points)
    assert abs(first - second) < 0.02
    assert math.isclose(share, first + second, abs_tol=0.02)
    assert 0.1 < first < 1 / 6 + 0.02
    lines = bpy.data.texts["LiDAR coverage.csv"].as_string().strip().split("\n")
    assert lines[0] == "lidar,points,cells,share"
    assert lines[-1].split(",")[:3] == ["All", str(both), str(cells)]
    one = lidars(scene)[0]
    collection, before = bpy.data.collections.new("Boxes"), cube.users_collection[0]
    collection.objects.link(cube)
    before.objects.unlink(cube)
    for place in (0.0, 50.0):
        copy = bpy.data.objects.new("Copy", None)
        copy.instance_type, copy.instance_collection, copy.location.z = "COLLECTION", collection, place
        scene.collection.objects.link(copy)
        choose(copy)
        assert bpy.ops.blender_lidar.coverage(edge_m=0.25) == {"FINISHED"}
        again = json.loads(scene.blender_lidar.covered)
        assert again["rows"] == told["rows"] if place == 0.0 else again["rows"][-1][1] == 0
        bpy.data.objects.remove(copy)
    before.objects.link(cube)
    choose(one)
    assert bpy.ops.blender_lidar.scan() == {"FINISHED"}
    hit = {tuple(cell) for cell in np.floor(vertices(cloud_of(one)) / 0.25 + 0.01).astype(int).tolist()}
    assert len(hit) == told["rows"][0][2]
    scene.frame_set(11)
    choose(cube)
    assert bpy.ops.blender_lidar.coverage() == {"FINISHED"}
    assert [row[1] for row in json.loads(scene.blender_lidar.covered)["rows"]] == [0, 0, 0]
