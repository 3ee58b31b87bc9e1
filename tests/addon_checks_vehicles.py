"""Checks of vehicles' bodies of the user's own: shown, scanned and searched in place of ours."""

from __future__ import annotations

import json
from pathlib import Path

import bpy
import numpy as np

from blender_lidar.addon import live, optimising, scenarios, session
from blender_lidar.cli import main as command_line
from blender_lidar.world.blender.objects import add_object, lidars, new_mesh
from blender_lidar.world.blender.site import visible_triangles
from blender_lidar.world.blender.traffic import traffic_object
from tests.addon_sample import FOLDER, FRAME, OPTIONS, choose, example, loaded, new_file, refused
from tests.small_scene import without_times


def wedge(name="Wedge", height=1.5):
    """An object that faces -y, as high at its back as at its front it is low."""
    corners = np.array([(x, y, z * (height if y > 0 else 0.3)) for x in (-1, 1) for y in (-2.2, 2.2) for z in (0, 1)])
    faces = np.array([(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (1, 5, 7, 3), (0, 2, 6, 4)])
    item = bpy.data.objects.new(name, new_mesh(name, corners, faces))
    bpy.context.scene.collection.objects.link(item)
    return item


def cars_file():
    """A .blend with the collection Car, of the wedge, of which a row of others would be in the way."""
    scene = new_file()
    into = bpy.data.collections.new("Car")
    scene.collection.children.link(into)
    into.objects.link(wedge())
    into.instance_offset = (1.0, 2.0, 3.0)
    bpy.ops.wm.save_as_mainfile(filepath=str(FOLDER / "cars.blend"), copy=True)
    return {"vehicles": {kind: str(FOLDER / "cars.blend/Car") for kind in ("car", "van", "truck")}}


def assert_shown_as_scanned(scene, own):
    """The triangles of vehicles that Blender shows are those that the LiDAR meets."""
    traffic, vehicles = traffic_object(scene), session.vehicles_of(scene)
    found = visible_triangles(scene, lambda item, _: item != traffic and item.original != traffic)
    low, high = found.corners.min(axis=(0, 1)), found.corners.max(axis=(0, 1))
    half = 0.5 * vehicles.size_m
    np.testing.assert_allclose(low, (vehicles.centre_m - half).min(axis=0), atol=1e-3)
    np.testing.assert_allclose(high, (vehicles.centre_m + half).max(axis=0), atol=1e-3)
    triangles = sum(len(own.shapes["car"].faces) for _ in range(len(vehicles)))
    assert len(found) == triangles, (len(found), triangles)


def check_a_scene_files_own_vehicles_are_loaded_shown_and_scanned_as_on_the_command_line():
    world = cars_file()
    scene, _ = loaded(world=world)
    assert scene.blender_lidar.vehicles.car.name == "Car"
    assert scene.blender_lidar.vehicles.bus is None
    assert_shown_as_scanned(scene, session.own_bodies(scene))
    assert bpy.ops.blender_lidar.export_cloud(filepath=str(FOLDER / "panel.npz")) == {"FINISHED"}
    words = ["--frame", str(FRAME), *OPTIONS]
    path = str(FOLDER / "scene" / "scene.toml")
    assert command_line(["scan", path, *words, "--out", str(FOLDER / "line.npz")]) == 0
    with np.load(FOLDER / "panel.npz") as panel, np.load(FOLDER / "line.npz") as line:
        for name in set(line) - {"header"}:
            np.testing.assert_array_equal(panel[name], line[name], err_msg=name)
        assert np.count_nonzero(line["vehicle_id"] >= 0) > 100
    found = [json.loads((FOLDER / name / "result.json").read_text()) for name in runs(path)]
    one, other = map(without_times, found)
    assert one["objective"] == other["objective"]
    assert one["identity"]["[world] vehicles"] == other["identity"]["[world] vehicles"]
    # What is saved holds them, and what build writes as well, without the file that they came from.
    bpy.ops.wm.save_as_mainfile(filepath=str(FOLDER / "saved.blend"))
    assert command_line(["build", path, *words, "--out", str(FOLDER / "built.blend")]) == 0
    (FOLDER / "cars.blend").unlink()
    for file in ("saved", "built"):
        bpy.ops.wm.open_mainfile(filepath=str(FOLDER / f"{file}.blend"))
        scene = bpy.context.scene
        choose(lidars(scene)[0])
        assert scene.blender_lidar.vehicles.car.name == "Car"
        assert_shown_as_scanned(scene, session.own_bodies(scene))
        assert bpy.ops.blender_lidar.export_cloud(filepath=str(FOLDER / f"{file}.npz")) == {"FINISHED"}
        with np.load(FOLDER / f"{file}.npz") as again, np.load(FOLDER / "line.npz") as line:
            np.testing.assert_allclose(again["xyz"], line["xyz"], atol=2e-5)
            np.testing.assert_array_equal(again["vehicle_id"], line["vehicle_id"])


def runs(path):
    """A run folder of the panel, and of the command line."""
    assert bpy.ops.blender_lidar.export_run(directory=str(FOLDER / "run")) == {"FINISHED"}
    assert command_line(["evaluate", path, "--out", str(FOLDER / "evaluated"), *OPTIONS]) == 0
    return "run", "evaluated"


def check_own_vehicles_are_searched_as_on_the_command_line():
    path = example(world=cars_file())
    scene = new_file()
    scene.blender_lidar.traffic.path = str(path)
    assert bpy.ops.blender_lidar.load() == {"FINISHED"}
    assert bpy.ops.blender_lidar.optimize() == {"FINISHED"}
    assert command_line(["optimise", str(path), "--out", str(FOLDER / "line")]) == 0
    folders = Path(optimising.found_of(lidars(scene)[0])["folder"]), FOLDER / "line"
    one, other = (json.loads((folder / "result.json").read_text()) for folder in folders)
    assert one["deployment"] == other["deployment"]
    assert one["objective"] == other["objective"]


def check_an_object_becomes_the_body_of_a_class_and_what_is_changed_of_it_is_seen_by_the_next_scan():
    scene, lidar = loaded()
    before = scanned(lidar)
    item = wedge()
    child = add_object(scene.collection, "Roof", bpy.data.meshes.new("Roof"), of="x", parent=item)
    del child["blender_lidar_role"]
    choose(item)
    assert bpy.ops.blender_lidar.use_as_vehicle(kind="van") == {"FINISHED"}
    assert bpy.ops.blender_lidar.use_as_vehicle(kind="truck", hide=False) == {"FINISHED"}
    assert set(scene.blender_lidar.vehicles.van.objects) == {item, child}
    assert item.hide_get()
    item.hide_set(True)
    choose(lidar)
    with_wedge = scanned(lidar)
    assert with_wedge != before
    item.data.vertices[3].co.z = 0.4
    item.data.update()
    assert scanned(lidar) != with_wedge
    assert scanned(lidar) == scanned(lidar)
    instance = bpy.data.objects.new("Dropped", None)
    scene.collection.objects.link(instance)
    instance.instance_type, instance.instance_collection = "COLLECTION", scene.blender_lidar.vehicles.truck
    choose(instance)
    assert bpy.ops.blender_lidar.use_as_vehicle(kind="car") == {"FINISHED"}
    assert scene.blender_lidar.vehicles.car == scene.blender_lidar.vehicles.truck
    choose(lidar)
    own = scanned(lidar)
    bpy.ops.wm.save_as_mainfile(filepath=str(FOLDER / "own.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(FOLDER / "own.blend"))
    scene, (lidar,) = bpy.context.scene, lidars(bpy.context.scene)
    assert scenarios.uid_of(scene) in session._BODIES, "a render would have to read them"
    assert scanned(lidar) == own
    lidar.blender_lidar.live = True
    bpy.data.objects["Wedge"].data.vertices[3].co.z = 1.2
    bpy.data.objects["Wedge"].data.update()
    bpy.context.view_layer.update()
    live.update()
    edited = told(lidar)
    assert edited != own
    assert not live._state.reshaped
    lidar.blender_lidar.live = False
    assert scanned(lidar) == edited
    for kind in ("car", "van", "truck"):
        setattr(scene.blender_lidar.vehicles, kind, None)
    assert own != scanned(lidar) == before
    scene.blender_lidar.vehicles.car = before = bpy.data.objects["Dropped"].instance_collection
    scene.blender_lidar.traffic.path = str(example())
    assert bpy.ops.blender_lidar.load() == {"FINISHED"}
    assert scene.blender_lidar.vehicles.car == before  # the file names none


def scanned(lidar):
    """What a scan found."""
    assert bpy.ops.blender_lidar.scan() == {"FINISHED"}
    return told(lidar)


def told(lidar):
    """What the tab says of it."""
    group = lidar.blender_lidar
    return group.points, group.objective, group.detectable_share


def check_what_is_no_body_is_refused_in_a_line_and_changes_nothing():
    scene, lidar = loaded()
    empty = bpy.data.objects.new("Empty", None)
    scene.collection.objects.link(empty)
    choose(empty)
    collections = len(bpy.data.collections)
    assert "Empty: nothing with faces is visible in it" in refused(bpy.ops.blender_lidar.use_as_vehicle, kind="car")
    assert scene.blender_lidar.vehicles.car is None
    assert len(bpy.data.collections) == collections
    choose(lidar)
    assert not bpy.ops.blender_lidar.use_as_vehicle.poll()
    scene.blender_lidar.vehicles.car = bpy.data.collections.new("Hollow")
    assert "LiDAR panel: Vehicles, Car: Hollow: nothing" in scene.blender_lidar.problem
    assert "Vehicles, Car: Hollow" in refused(bpy.ops.blender_lidar.scan)
