"""The user's own objects in the open scene: Blender's trees at preview quality against exact triangles."""

from __future__ import annotations

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from blender_lidar.casting.protocol import StandingScenery
from blender_lidar.errors import InputError
from blender_lidar.sensors.beams import beam_lattice
from blender_lidar.sensors.model import load_model
from blender_lidar.sensors.pose import Pose
from blender_lidar.world.blender.objects import glass, new_mesh
from blender_lidar.world.blender.preview import VisibleObjects
from blender_lidar.world.blender.scene import empty_scene
from blender_lidar.world.blender.site import open_scenery
from blender_lidar.world.blender.traffic import show_vehicles
from blender_lidar.world.meshes import GLASS, STRUCTURE
from tests.sample_traffic import dense_traffic

BEAMS = beam_lattice(load_model("RS-32"), stride=4).directions.reshape(-1, 3)
POSE = Pose(0.3, -0.2, 4.1, 0.3, 0.02, 0.1)


def add(scene, name, data, place=(0.0, 0.0, 0.0), turn=(0.0, 0.0, 0.0), scale=(1.0, 1.0, 1.0)):
    item = bpy.data.objects.new(name, data)
    item.location, item.rotation_euler, item.scale = place, turn, scale
    scene.collection.objects.link(item)
    return item


def rough(name, side=12, materials=(), slots=None):
    x, y = np.meshgrid(np.linspace(-1.0, 1.0, side), np.linspace(-1.0, 1.0, side), indexing="ij")
    vertices = np.stack([x, y, 0.1 * np.sin(9.0 * x + 5.0 * y)], axis=-1).reshape(-1, 3)
    corner = np.arange(side * side).reshape(side, side)
    a, b, c, d = corner[:-1, :-1], corner[1:, :-1], corner[1:, 1:], corner[:-1, 1:]
    faces = np.concatenate([np.stack(three, axis=-1).reshape(-1, 3) for three in ((a, b, c), (a, c, d))])
    return new_mesh(name, vertices, faces, materials, None if slots is None else np.arange(len(faces)) % slots)


def assert_as_exact(scene, preview):
    """The preview meets what exact triangles are met at, but for a few rays at edges."""
    layer = scene.view_layers[0]
    exact = StandingScenery(open_scenery(scene, layer), "exact")
    preview.refresh(scene, layer.depsgraph)
    directions = POSE.to_world(BEAMS)
    (ray, *expected), (seen, *found) = (each.met(POSE.position, directions, 60.0) for each in (exact, preview))
    assert len(np.setxor1d(ray, seen)) <= 0.005 * len(ray)
    _, mine, other = np.intersect1d(ray, seen, return_indices=True)
    for column, tolerance in zip(zip(expected, found, strict=True), (1e-3, 0.0, 1e-2, 0.0), strict=True):
        same = np.isclose(column[0][mine], column[1][other], rtol=0.0, atol=tolerance)
        assert (~same).sum() <= 0.005 * len(ray)
    return len(ray)


@pytest.fixture
def scene():
    yield empty_scene()
    empty_scene()


def test_moved_turned_mirrored_and_flattened_objects_occlude_as_their_exact_triangles_do(scene):
    mesh = rough("rough", materials=[glass(), None], slots=2)
    add(scene, "plain", mesh, (4.0, 10.0, 2.0), (1.0, 0.3, 0.2), (3.0, 2.0, 1.0))
    add(scene, "mirrored", mesh, (-6.0, 12.0, 1.0), (0.5, 0.0, 2.0), (-2.0, 3.0, 0.5))
    add(scene, "behind", mesh, (0.0, -9.0, 1.0), (1.4, 0.0, 0.0), (9.0, 9.0, 1.0))  # across azimuth pi
    add(scene, "about the sensor", mesh, (0.0, 0.0, 3.0), (0.0, 0.0, 0.0), (0.5, 0.5, 6.0))
    assert assert_as_exact(scene, VisibleObjects()) > 1000
    surface = open_scenery(scene, scene.view_layers[0]).surface
    assert set(surface.tolist()) == {GLASS, STRUCTURE}


def test_modifiers_curves_and_instances_occlude_and_the_hidden_and_our_own_do_not(scene):
    wall = add(scene, "wall", rough("wall"), (5.0, 9.0, 1.5), (1.5, 0.0, 0.0), (4.0, 1.5, 1.0))
    wall.modifiers.new("Array", "ARRAY").count = 2
    curve = bpy.data.curves.new("rail", "CURVE")
    curve.dimensions, curve.bevel_depth = "3D", 0.4
    line = curve.splines.new("POLY")
    line.points.add(1)
    line.points[0].co, line.points[1].co = (-20.0, 6.0, 0.5, 1.0), (20.0, 6.0, 0.5, 1.0)
    add(scene, "rail", curve)
    trees = bpy.data.collections.new("trees")
    trees.objects.link(bpy.data.objects.new("tree", rough("tree")))
    for x in (-8.0, 3.0):
        add(scene, "copse", None, (x, 15.0, 2.0), (1.3, 0.0, x)).instance_type = "COLLECTION"
        scene.collection.objects[-1].instance_collection = trees
    preview = VisibleObjects()
    there = assert_as_exact(scene, preview)
    add(scene, "hidden", rough("hidden"), (0.0, 3.0, 3.0), (1.5, 0.0, 0.0), (9.0, 9.0, 1.0)).hide_viewport = True
    show_vehicles(scene, dense_traffic(vehicles=10, length_m=40.0))
    assert assert_as_exact(scene, preview) == there > 300


def test_a_preview_follows_what_is_moved_and_what_is_reshaped_once_it_is_told(scene):
    item, preview = add(scene, "plain", rough("rough"), (0.0, 10.0, 2.0), (1.5, 0.0, 0.0), (3.0, 2.0, 1.0)), None
    preview = VisibleObjects()
    first = assert_as_exact(scene, preview)
    item.location.y = 6.0
    assert assert_as_exact(scene, preview) > 1.5 * first
    item.data.vertices.foreach_set("co", 2.0 * np.array([vertex.co for vertex in item.data.vertices]).ravel())
    item.data.update()
    preview.forget()
    assert assert_as_exact(scene, preview) > 3.0 * first


def test_a_unit_scale_is_applied_and_an_empty_scene_hides_nothing(scene):
    preview = VisibleObjects()
    assert assert_as_exact(scene, preview) == 0
    scene.unit_settings.scale_length = 0.01
    add(scene, "in centimetres", rough("rough"), (0.0, 800.0, 200.0), (1.5, 0.0, 0.0), (300.0, 200.0, 100.0))
    assert assert_as_exact(scene, preview) > 300


def test_a_vertex_that_is_not_finite_is_told_by_the_name_of_its_object(scene):
    add(scene, "broken", rough("broken")).data.vertices[0].co.x = float("nan")
    with pytest.raises(InputError, match="'broken': has a vertex that is not finite"):
        open_scenery(scene, scene.view_layers[0])
