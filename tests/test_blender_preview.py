"""The user's own objects in the open scene: Blender's trees at preview quality against exact triangles."""

from __future__ import annotations

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from blender_lidar.addon.preview import VisibleObjects
from blender_lidar.casting.protocol import StandingScenery
from blender_lidar.errors import InputError
from blender_lidar.sensors.beams import beam_lattice
from blender_lidar.sensors.model import load_model
from blender_lidar.sensors.pose import Pose
from blender_lidar.world.blender.objects import KEY, PART, glass, new_mesh
from blender_lidar.world.blender.scene import empty_scene
from blender_lidar.world.blender.site import open_scenery
from blender_lidar.world.blender.traffic import show_still
from blender_lidar.world.meshes import GLASS, STRUCTURE
from tests.sample_traffic import dense_traffic

pytestmark = pytest.mark.versions

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


def assert_as_exact(scene, preview, caster="exact"):
    """The preview meets what exact triangles are met at, but for a few rays at edges."""
    layer = scene.view_layers[0]
    exact = StandingScenery(open_scenery(scene, layer), caster)
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


@pytest.fixture
def preview():
    """A preview that Blender tells of changes, as it does while a LiDAR is live."""
    preview = VisibleObjects()

    def told(scene, depsgraph):
        preview.note_updates(depsgraph.updates)

    bpy.app.handlers.depsgraph_update_post.append(told)
    bpy.app.handlers.frame_change_post.append(told)
    yield preview
    bpy.app.handlers.depsgraph_update_post.remove(told)
    bpy.app.handlers.frame_change_post.remove(told)


def test_moved_turned_mirrored_and_flattened_objects_occlude_as_their_exact_triangles_do(scene):
    mesh = rough("rough", materials=[glass(), None], slots=2)
    add(scene, "plain", mesh, (4.0, 10.0, 2.0), (1.0, 0.3, 0.2), (3.0, 2.0, 1.0))
    add(scene, "mirrored", mesh, (-6.0, 12.0, 1.0), (0.5, 0.0, 2.0), (-2.0, 3.0, 0.5))
    add(scene, "behind", mesh, (0.0, -9.0, 1.0), (1.4, 0.0, 0.0), (9.0, 9.0, 1.0))  # across azimuth pi
    add(scene, "about the sensor", mesh, (0.0, 0.0, 3.0), (0.0, 0.0, 0.0), (0.5, 0.5, 6.0))
    assert assert_as_exact(scene, VisibleObjects()) > 1000
    surface = open_scenery(scene, scene.view_layers[0]).surface
    assert set(surface.tolist()) == {GLASS, STRUCTURE}


def test_modifiers_curves_and_instances_occlude_and_the_hidden_and_our_own_do_not(scene, preview):
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
    there = assert_as_exact(scene, preview)
    add(scene, "hidden", rough("hidden"), (0.0, 3.0, 3.0), (1.5, 0.0, 0.0), (9.0, 9.0, 1.0)).hide_viewport = True
    show_still(scene, dense_traffic(vehicles=10, length_m=40.0))
    assert assert_as_exact(scene, preview) == there > 300


def test_a_forest_of_instances_occludes_as_its_exact_triangles_do_near_and_far(scene, preview):
    trees, random = bpy.data.collections.new("trees"), np.random.default_rng(1)
    for name in ("low", "high"):
        trees.objects.link(bpy.data.objects.new(name, rough(name, 6, [glass(), None], 2)))
    trees.objects["high"].location.z = 3.0
    for x, y in random.uniform(-40.0, 40.0, (120, 2)):
        turn, scale = random.uniform(-3.0, 3.0, 3), random.uniform(-2.0, 2.0, 3)
        tree = add(scene, "tree", None, (x, y, 1.0), turn, scale)
        tree.instance_type, tree.instance_collection = "COLLECTION", trees
    seen = [assert_as_exact(scene, preview, "bvh")]
    trees.objects["high"].hide_render = True
    seen.append(assert_as_exact(scene, preview, "bvh"))
    assert seen[0] > 1.2 * seen[1] > 1000


def test_a_preview_follows_whatever_blender_tells_of(scene, preview):
    item = add(scene, "plain", rough("rough"), (0.0, 10.0, 2.0), (1.5, 0.0, 0.0), (3.0, 2.0, 1.0))
    other = bpy.data.collections.new("other")
    scene.collection.children.link(other)

    def again(change):
        change()
        return assert_as_exact(scene, preview)

    def reshape():
        item.data.vertices.foreach_set("co", 2.0 * np.array([vertex.co for vertex in item.data.vertices]).ravel())
        item.data.update()

    first = again(lambda: None)
    assert again(lambda: setattr(item.location, "y", 6.0)) > 1.5 * first
    near = again(reshape)
    assert near > 3.0 * first
    second = add(scene, "second", item.data, (0.0, -10.0, 2.0), (1.5, 0.0, 0.0), (3.0, 2.0, 1.0))
    assert again(lambda: None) > near
    for hide in (second.hide_set, lambda on: setattr(second, "hide_render", on)):
        assert again(lambda hide=hide: hide(True)) == near
        assert again(lambda hide=hide: hide(False)) > near
    other.objects.link(second)
    scene.collection.objects.unlink(second)
    shown = scene.view_layers[0].layer_collection.children["other"]
    for of, name in ((shown, "exclude"), (other, "hide_render"), (other, "hide_viewport")):
        assert again(lambda of=of, name=name: setattr(of, name, True)) == near
        assert again(lambda of=of, name=name: setattr(of, name, False)) > near
    assert again(lambda: bpy.data.objects.remove(second)) == near
    item.data.materials.append(None)
    assert again(lambda: item.data.materials.__setitem__(0, glass())) == near
    assert again(lambda: setattr(item, "parent", add(scene, "far", None, (0.0, 500.0, 0.0)))) == 0


def test_only_trees_of_what_has_another_shape_are_made_again_and_our_own_moves_are_no_change(scene, preview):
    still = add(scene, "still", rough("still"), (0.0, 10.0, 2.0), (1.5, 0.0, 0.0))
    bent = add(scene, "bent", rough("bent"), (0.0, -10.0, 2.0), (1.5, 0.0, 0.0)).modifiers.new("Displace", "DISPLACE")
    for frame, strength in ((1, 0.0), (10, 2.0)):
        bent.strength = strength
        bent.keyframe_insert("strength", frame=frame)
    head = add(scene, "head", rough("head"))
    head[KEY] = PART

    def trees():
        assert_as_exact(scene, preview)
        return {mesh.tree for mesh in preview._meshes.values()}, preview.state

    (before, state), _ = trees(), scene.frame_set(5)
    (after, bent_state), _ = trees(), setattr(head.location, "x", 1.0)
    assert (len(before & after), len(after)) == (1, 2)
    assert bent_state > state
    scene.view_layers[0].update()
    assert preview._seen is not None
    assert trees() == (after, bent_state)
    still.location.x = 1.0
    moved, moved_state = trees()
    assert moved == after
    assert moved_state > bent_state


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
