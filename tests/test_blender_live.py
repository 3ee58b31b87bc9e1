"""A LiDAR that is live: what is drawn of it is what Scan finds, after every change, and nothing stays when it ends."""

from __future__ import annotations

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from blender_lidar import addon
from blender_lidar.addon import live, scenarios, session
from blender_lidar.world.blender.objects import lidars, new_mesh
from blender_lidar.world.blender.points import cloud_of
from tests.blender_session import colours_shown
from tests.small_scene import write_scene

pytestmark = pytest.mark.versions

WALL = np.array([(-30.0, 1.0, 0.0), (30.0, 1.0, 0.0), (30.0, 1.0, 5.0), (-30.0, 1.0, 5.0)])


@pytest.fixture
def lidar(tmp_path):
    """A LiDAR beside the small scene's road, with the add-on; nothing of which may stay registered."""
    handlers = {name: list(getattr(bpy.app.handlers, name)) for name in live.app_handlers}
    bpy.ops.wm.read_homefile(use_empty=True)
    addon.register()
    try:
        scene = bpy.context.scene
        scene.blender_lidar.traffic.path = str(write_scene(tmp_path))
        assert bpy.ops.blender_lidar.load() == {"FINISHED"}
        scene.blender_lidar.model.caster = "exact"
        scene.blender_lidar.frame = 20
        yield lidars(scene)[0]
    finally:
        addon.unregister()
        bpy.ops.wm.read_homefile(use_empty=True)
    assert {name: list(getattr(bpy.app.handlers, name)) for name in live.app_handlers} == handlers
    assert not live._state.shown


def moved(lidar, **place):
    for key, value in place.items():
        setattr(lidar.blender_lidar, key, value)
    bpy.context.view_layer.update()
    live.update()
    return live._state.shown[scenarios.uid_of(lidar)]


def told_of(lidar):
    group = lidar.blender_lidar
    names = ("points", "vehicles", "objective", "detectable_share", "baseline_objective", "baseline_share")
    return [getattr(group, name) for name in names], group.scanned_frame, list(group.scanned_at)


def assert_as_scanned(lidar, shown):
    """What is live is what Scan finds, which writes it into Blender's points."""
    found, xyz = told_of(lidar), shown.look.cloud.xyz.copy()
    assert bpy.ops.blender_lidar.scan() == {"FINISHED"}
    assert found == told_of(lidar)
    stored = np.empty(xyz.size)
    cloud_of(lidar).data.vertices.foreach_get("co", stored)
    np.testing.assert_allclose(stored.reshape(-1, 3), xyz, atol=1e-5)
    return found[0]


def test_a_live_lidar_shows_what_scan_finds_wherever_and_on_whatever_frame_it_is(lidar):
    lidar.blender_lidar.live = True
    seen = [assert_as_scanned(lidar, moved(lidar, height_m=4.0, tilt_x_deg=0.3))]
    seen.append(assert_as_scanned(lidar, moved(lidar, x_m=6.0, tilt_x_deg=0.2)))
    bpy.context.scene.blender_lidar.frame = 23
    seen.append(assert_as_scanned(lidar, moved(lidar)))
    lidar.blender_lidar.range_gate_m = 12.0
    seen.append(assert_as_scanned(lidar, moved(lidar)))
    assert len({tuple(one) for one in seen}) == 4
    assert bpy.context.scene.blender_lidar.problem == ""


def test_what_has_not_changed_is_not_looked_at_again(lidar):
    lidar.blender_lidar.live = True
    before = moved(lidar, height_m=4.0).look
    assert moved(lidar).look is before
    assert moved(lidar, height_m=4.1).look is not before


def test_objects_of_the_users_own_occlude_live_and_exactly(lidar):
    lidar.blender_lidar.live = True
    free = moved(lidar, height_m=4.0, tilt_x_deg=0.3).look.scored.seen.points.sum()
    wall = bpy.data.objects.new("wall", new_mesh("wall", WALL, np.array([[0, 1, 2, 3]])))
    bpy.context.scene.collection.objects.link(wall)
    shown = moved(lidar)
    assert shown.look.scored.seen.points.sum() < 0.5 * free
    objective = lidar.blender_lidar.objective
    assert bpy.ops.blender_lidar.scan() == {"FINISHED"}
    assert lidar.blender_lidar.objective == pytest.approx(objective, rel=1e-3)
    wall.location.y = -20.0
    assert moved(lidar).look.scored.seen.points.sum() == free


def test_points_take_every_colour(lidar):
    lidar.blender_lidar.live = True
    seen = []
    for name in ("range", "ring", "vehicle", "intensity", "entropy"):
        lidar.blender_lidar.colour_by = name
        shown = moved(lidar)
        assert shown.colours.shape == (len(shown.look.cloud), 4)
        assert ((shown.colours >= 0.0) & (shown.colours <= 1.0)).all()
        seen.append(shown.colours.tobytes())
    assert len(set(seen)) == 5


def test_the_cloud_is_hidden_while_live_and_stands_where_it_was_last_seen_afterwards(lidar):
    assert bpy.ops.blender_lidar.scan() == {"FINISHED"}
    lidar.blender_lidar.live = True
    shown = moved(lidar, x_m=5.0)
    assert cloud_of(lidar).hide_get()
    lidar.blender_lidar.live = False
    cloud = cloud_of(lidar)
    assert not cloud.hide_get()
    bpy.context.view_layer.update()
    np.testing.assert_allclose(
        np.array(cloud.matrix_world) @ [*cloud.data.vertices[0].co, 1.0], [*shown.look.cloud.xyz[0], 1.0], atol=1e-4
    )


def test_a_scanned_cloud_takes_another_colour_without_a_scan(lidar):
    assert bpy.ops.blender_lidar.scan() == {"FINISHED"}
    cloud, seen = cloud_of(lidar), set()
    for name in ("range", "ring", "vehicle", "intensity", "entropy"):
        lidar.blender_lidar.colour_by = name
        seen.add(colours_shown(cloud).tobytes())
    assert len(seen) == 5
    lidar.blender_lidar.style = "Rings"
    assert lidar.blender_lidar.colour_by == "ring"
    assert cloud.modifiers[0].node_group.name == "Rings"
    assert colours_shown(cloud).tobytes() in seen
    assert bpy.ops.blender_lidar.scan() == {"FINISHED"}
    assert cloud_of(lidar).modifiers[0].node_group.name == "Rings"


def written(lidar):
    """The cloud's points as they lie in Blender's data."""
    found = np.empty(3 * len(cloud_of(lidar).data.vertices))
    cloud_of(lidar).data.vertices.foreach_get("co", found)
    return found.reshape(-1, 3)


def test_no_cloud_of_before_is_seen_after_a_scan_a_save_a_render_or_the_end_of_the_add_on(lidar, tmp_path):
    lidar.blender_lidar.live = True
    shown = moved(lidar, height_m=4.0)
    assert bpy.ops.blender_lidar.scan() == {"FINISHED"}
    assert cloud_of(lidar).hide_get()
    shown, seen = moved(lidar, x_m=4.0), []
    bpy.app.handlers.save_pre.append(lambda *_: seen.append(cloud_of(lidar).hide_get()))
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "live.blend"), copy=True)
    bpy.app.handlers.save_pre.pop()
    assert seen == [False]
    assert cloud_of(lidar).hide_get()
    np.testing.assert_allclose(written(lidar), shown.look.cloud.xyz, atol=1e-4)
    shown = moved(lidar, x_m=5.0)
    live.on_render(bpy.context.scene)
    np.testing.assert_allclose(written(lidar), shown.look.cloud.xyz, atol=1e-4)
    assert moved(lidar, x_m=5.5).look is shown.look  # nothing is looked at between
    live.on_rendered(bpy.context.scene)
    shown = moved(lidar, x_m=6.0)
    live.unregister()
    assert not cloud_of(lidar).hide_get()
    np.testing.assert_allclose(written(lidar), shown.look.cloud.xyz, atol=1e-4)
    live.register()


def test_pictures_of_an_animation_have_the_cloud_of_their_frame(lidar):
    scene = bpy.context.scene
    lidar.blender_lidar.live = True
    moved(lidar, height_m=4.0)
    live.on_render(scene)
    before = written(lidar)
    scene.frame_set(scene.frame_current + 12)
    after = written(lidar)
    live.on_rendered(scene)
    np.testing.assert_allclose(after, moved(lidar).look.cloud.xyz, atol=1e-4)
    assert before.shape != after.shape or (before != after).any()


def test_a_render_looks_from_where_each_frame_takes_the_lidar(lidar, tmp_path):
    scene, cart = bpy.context.scene, bpy.data.objects.new("Cart", None)
    scene.collection.objects.link(cart)
    lidar.parent = cart
    for frame, x_m in ((1, 0.0), (3, 50.0)):
        cart.location.x = x_m
        cart.keyframe_insert("location", frame=frame)
    scene.frame_set(1)
    lidar.blender_lidar.live, seen = True, []
    before = moved(lidar, height_m=4.0).look.pose

    def note(scene, depsgraph):
        cloud = cloud_of(lidar)
        away = lidar.evaluated_get(depsgraph).matrix_world @ cloud.matrix_parent_inverse  # of the cloud from the road
        shown = live._state.shown[scenarios.uid_of(lidar)]
        assert not shown.problem
        if live._state.rendering:
            seen.append((shown.look.pose.x_m - before.x_m, away.translation.length))

    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    scene.collection.objects.link(camera)
    scene.camera, scene.frame_start, scene.frame_end = camera, 1, 3
    scene.render.engine, scene.cycles.samples, scene.cycles.use_denoising = "CYCLES", 1, False
    scene.render.resolution_x = scene.render.resolution_y = 8
    scene.render.filepath = str(tmp_path / "film_")
    bpy.app.handlers.frame_change_post.append(note)
    try:
        bpy.ops.render.render(animation=True)
    finally:
        bpy.app.handlers.frame_change_post.remove(note)
    assert sorted({round(x_m) for x_m, _ in seen}) == [0, 25, 50]
    assert max(away_m for _, away_m in seen) < 1e-4, seen


def test_live_refuses_in_the_words_of_scan_and_draws_nothing_stale(lidar):
    lidar.blender_lidar.live = True
    moved(lidar, height_m=4.0)
    shown = moved(lidar, y_m=5.0)
    with pytest.raises(RuntimeError) as refusal:
        bpy.ops.blender_lidar.scan()
    assert bpy.context.scene.blender_lidar.problem == str(refusal.value).removeprefix("Error: ").strip()
    assert shown.problem
    assert not moved(lidar, y_m=0.0).problem
    assert bpy.context.scene.blender_lidar.problem == ""


def test_boxes_of_vehicles_hold_them_and_take_the_colours_of_their_entropy(lidar):
    lidar.blender_lidar.live = True
    shown, scene = moved(lidar, height_m=4.0), bpy.context.scene
    boxes, vehicles = live._state.boxes[scenarios.uid_of(scene)], session.vehicles_of(scene)
    np.testing.assert_array_equal(boxes.bits, shown.bits)
    corners = live.box_corners(boxes.vehicles)
    assert corners.shape == (len(vehicles), 8, 3)
    on = shown.look.cloud.vehicle_id == vehicles.vehicle_id[np.argmax(shown.bits)]
    box = corners[np.argmax(shown.bits)]
    assert (shown.look.cloud.xyz[on] > box.min(axis=0)).all()
    assert (shown.look.cloud.xyz[on] < box.max(axis=0)).all()
    edges = box[live._EDGES[:, 0]] - box[live._EDGES[:, 1]]
    sides = np.sort(np.linalg.norm(edges, axis=1)).reshape(3, 4)
    assert np.ptp(sides, axis=1).max() < 1e-9
    areas = np.linalg.norm(np.cross(*(box[live._FACES[:, k]] - box[live._FACES[:, 0]] for k in (1, 2))), axis=1)
    x, y, z = sides[:, 0]
    assert areas.sum() / 2 == pytest.approx(2 * (x * y + y * z + z * x))
    lidar.blender_lidar.live = False
    assert not live._state.boxes


def test_where_undo_has_ended_it_nothing_is_written(lidar):
    assert bpy.ops.blender_lidar.scan() == {"FINISHED"}
    before = len(cloud_of(lidar).data.vertices)
    lidar.blender_lidar.live = True
    moved(lidar, x_m=9.0)
    live.on_history()
    lidar.blender_lidar.live = False
    assert len(cloud_of(lidar).data.vertices) == before
    assert not cloud_of(lidar).hide_get()
    assert not live._state.shown


def test_a_lidar_below_the_ground_says_so_and_goes_on_once_it_is_back(lidar):
    scene = bpy.context.scene
    lidar.blender_lidar.live = True
    moved(lidar, height_m=4.0)
    lidar.location.z = -1.0
    moved(lidar)
    assert "above the ground" in scene.blender_lidar.problem
    lidar.location.z = 3.0
    assert moved(lidar).look is not None
    assert scene.blender_lidar.problem == ""


def test_two_live_lidars_are_looked_at_each_by_itself_and_a_removed_one_is_let_go_of(lidar):
    scene = bpy.context.scene
    scene.cursor.location = (10.0, 0.0, 3.0)
    assert bpy.ops.blender_lidar.add() == {"FINISHED"}
    other = next(item for item in lidars(scene) if item != lidar)
    lidar.blender_lidar.live = other.blender_lidar.live = True
    moved(lidar, height_m=4.0)
    moved(other, height_m=4.5)
    assert len(live._state.shown) == 2
    assert lidar.blender_lidar.points != other.blender_lidar.points
    bpy.data.objects.remove(other)
    live.update()
    assert set(live._state.shown) == {scenarios.uid_of(lidar)}
