"""Bake: files of frames are what Scan finds there, go on where they were cancelled, and play and render as a cloud."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from blender_lidar.addon import baking, scenarios, session
from blender_lidar.clouds.points import read_points
from blender_lidar.world.blender.objects import hang, lidars, new_mesh, pose_of
from blender_lidar.world.blender.points import cloud_of
from tests.small_scene import traffic_rows, write_scene, write_table
from tests.waiting import WAIT_S

pytestmark = [pytest.mark.usefixtures("registered_addon"), pytest.mark.session, pytest.mark.versions]
WALL = np.array([(x, -6.0, z) for x, z in ((-30.0, 0.0), (30.0, 0.0), (30.0, 1.5), (-30.0, 1.5))])
SCRIPT = Path(__file__).parents[1] / "scripts" / "bake.py"


@pytest.fixture
def scene(tmp_path):
    """A saved scene of two LiDARs, one on a cart that moves, a wall that moves, and four frames to bake."""
    scene = bpy.context.scene
    write_table(
        tmp_path / "traffic.csv", [[*row[:-1], row[-1] / 4.0] for row in traffic_rows()]
    )  # instants 0.5 s apart
    scene.blender_lidar.traffic.path = str(write_scene(tmp_path))
    assert bpy.ops.blender_lidar.load() == {"FINISHED"}
    scene.blender_lidar.model.caster, scene.blender_lidar.starts_s = "exact", -10.1
    assert bpy.ops.blender_lidar.add() == {"FINISHED"}
    cart = bpy.data.objects.new("Cart", None)
    wall = bpy.data.objects.new("Wall", new_mesh("Wall", WALL, np.array([[0, 1, 2, 3]])))
    for item, axis, far in ((cart, 0, 4.0), (wall, 1, 3.0)):
        scene.collection.objects.link(item)
        for frame, place in ((1, 0.0), (5, far)):
            item.location[axis] = place
            item.keyframe_insert("location", frame=frame)
    scene.frame_set(1)
    first, second = lidars(scene)
    second.parent = cart
    hang(second, pose_of(first))
    scene.frame_start, scene.frame_end = 1, 4
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "street.blend"))
    return scene


def bake(scene):
    assert bpy.ops.blender_lidar.bake() == {"FINISHED"}
    return {path: path.stat().st_mtime_ns for one in lidars(scene) for path in baking.files_of(one).values()}


def shown(lidar):
    """Places and attributes of a LiDAR's cloud."""
    mesh = cloud_of(lidar).data
    found = {"co": np.empty(3 * len(mesh.vertices), np.float32)}
    mesh.vertices.foreach_get("co", found["co"])
    for name in ("range", "ring", "intensity", "vehicle", "entropy", "time", "lidar", "label"):
        found[name] = np.empty(len(mesh.vertices))
        mesh.attributes[name].data.foreach_get("value", found[name])
    placed = cloud_of(lidar).evaluated_get(bpy.context.evaluated_depsgraph_get()).matrix_world
    return found | {"matrix": np.array(placed)}


def assert_baked_as_scanned(scene, frame, lidar):
    """The file of a frame and what is shown of it are what Scan finds there, which is returned."""
    scene.frame_set(frame)
    points, vehicle_id = read_points(baking.files_of(lidar)[frame])
    baked = shown(lidar)
    bpy.context.view_layer.objects.active = lidar
    assert bpy.ops.blender_lidar.scan() == {"FINISHED"}
    scanned = shown(lidar)
    np.testing.assert_array_equal(points.astype(np.float32).ravel(), scanned["co"])
    np.testing.assert_array_equal(vehicle_id, scanned["vehicle"])
    for name, values in scanned.items():
        np.testing.assert_allclose(baked[name], values, atol=1e-4, err_msg=name)
    return scanned


@pytest.mark.parametrize("suffix", [".ply", ".pcd"])
def test_files_and_what_is_shown_of_them_are_what_scan_finds_on_each_frame(scene, suffix):
    scene.blender_lidar.bake_format = suffix
    scene.frame_set(3, subframe=0.5)
    bake(scene)
    assert scene.frame_current_final == 3.5
    assert scene.render.use_lock_interface
    sizes = set()
    for frame in (1, 2, 3, 4):
        for lidar in lidars(scene):
            scanned = assert_baked_as_scanned(scene, frame, lidar)
            assert scanned["entropy"].any()
            sizes.add(len(scanned["ring"]))
    assert len(sizes) > 4  # what moves is seen
    scene.frame_set(5)
    assert len(shown(lidars(scene)[0])["ring"]) == 0  # no file, no cloud


def test_without_traffic_own_objects_are_baked_with_their_labels(tmp_path):
    bpy.ops.wm.read_homefile(use_factory_startup=True)
    scene, cube = bpy.context.scene, bpy.data.objects["Cube"]
    for frame, size in ((1, 1.0), (2, 1.5)):
        cube.scale.x = size
        cube.keyframe_insert("scale", frame=frame)
    assert bpy.ops.blender_lidar.add() == {"FINISHED"}
    (lidar,) = lidars(scene)
    scene.frame_end = 2
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "cube.blend"))
    assert len(bake(scene)) == 2
    sizes = []
    for frame in (1, 2):
        scanned = assert_baked_as_scanned(scene, frame, lidar)
        assert (scanned["label"] >= 0).all()
        sizes.append(len(scanned["ring"]))
    assert 0 < sizes[0] < sizes[1]


def test_only_frames_that_are_gone_or_of_other_settings_are_baked_again(scene):
    before = bake(scene)
    assert len(before) == 8
    assert bake(scene) == before
    gone = next(iter(before))
    gone.unlink()
    assert {path for path, when in bake(scene).items() if before[path] != when} == {gone}
    before, (first, second) = bake(scene), lidars(scene)
    first.location.z += 0.5
    after = bake(scene)
    assert {path for path in before if before[path] != after[path]} == set(baking.files_of(first).values())
    bpy.data.objects["Wall"].scale.z = 2.0
    assert not {*after.items()} & {*bake(scene).items()}
    before = bake(scene)
    scene.use_preview_range, scene.frame_preview_start, scene.frame_preview_end = True, 3, 9
    scene.frame_step = 3
    assert set(bake(scene)) - set(before) == {
        baking.files_of(one)[number] for one in (first, second) for number in (6, 9)
    }


def test_a_bake_that_is_cancelled_or_refused_leaves_whole_files_and_the_frame(scene):
    scene.frame_set(2)
    steps = baking.steps(scene)
    assert [next(steps) for _ in range(4)] == ["8 clouds", "frame 1", "frame 1", "frame 2"]
    bpy.data.objects.remove(lidars(scene)[1])
    assert next(steps) == "frame 2 as it was"
    steps.close()
    assert scene.frame_current_final == 2.0
    (lidar,) = lidars(scene)
    assert set(baking.files_of(lidar)) == {1, 2}
    assert sorted(path.name for path in baking.folder_of(lidar).iterdir()) == ["frame_0001.ply", "frame_0002.ply"]
    lidar.location.y = 4.0
    lidar.keyframe_insert("location", frame=3)
    lidar.location.y = 0.0
    lidar.keyframe_insert("location", frame=2)
    with pytest.raises(RuntimeError, match=r"Error: LiDAR, frame 3: .*carriageway"):
        bpy.ops.blender_lidar.bake()
    assert scene.frame_current_final == 2.0
    assert set(baking.files_of(lidar)) == {1, 2}


def test_a_bake_that_undo_has_overtaken_is_cancelled_and_restores_the_frame(scene):
    scene.frame_set(2)
    for message in ("before", "after"):
        bpy.ops.ed.undo_push(message=message)
    steps = baking.steps(scene)
    assert [next(steps) for _ in range(6)][-1] == "frame 3"
    bpy.ops.ed.undo()
    steps.close()
    assert bpy.context.scene.frame_current == 2


def test_whatever_goes_wrong_in_a_window_is_one_line_and_ends_the_timer(scene):
    def failing():
        yield 1 / 0

    told, ended = [], []
    window = SimpleNamespace(
        _steps=failing(), report=lambda kind, text: told.append(text), cancel=lambda _: ended.append(1)
    )
    end = baking.BLENDER_LIDAR_OT_bake.modal(window, bpy.context, SimpleNamespace(type="TIMER"))
    assert (end, told, ended) == ({"FINISHED"}, ["division by zero"], [1])


def test_own_bodies_are_read_once_a_frame(scene, monkeypatch):
    box, mesh = (
        bpy.data.collections.new("Box"),
        new_mesh("Box", np.add(WALL, [[0], [1], [2], [0]]), np.array([[0, 1, 2, 3]])),
    )
    box.objects.link(bpy.data.objects.new("Box", mesh))
    scene.blender_lidar.vehicles.car = box
    read, body_of = [], session.body_of
    monkeypatch.setattr(session, "body_of", lambda *of: read.append(of) or body_of(*of))
    bake(scene)
    assert len(read) == 4  # once a frame for both LiDARs


def test_what_cannot_be_baked_is_one_line(scene):
    lidars(scene)[1].name = "lidar"
    with pytest.raises(RuntimeError, match=r"Error: Bake: LiDARs LiDAR, lidar; allowed"):
        bpy.ops.blender_lidar.bake()
    bpy.ops.wm.read_homefile(use_empty=True)
    assert bpy.ops.blender_lidar.add() == {"FINISHED"}
    with pytest.raises(RuntimeError, match="save it first"):
        bpy.ops.blender_lidar.bake()


def test_a_moved_lidar_or_other_settings_are_told_until_it_is_baked_again(scene):
    lidar = lidars(scene)[0]
    assert not baking.is_changed(lidar)
    bake(scene)
    assert not baking.is_changed(lidar)
    lidar.blender_lidar.height_m += 0.5
    assert baking.is_changed(lidar)
    bake(scene)
    assert not baking.is_changed(lidar)
    lidar.blender_lidar.range_gate_m -= 3.0
    assert baking.is_changed(lidar)
    bake(scene)
    assert not baking.is_changed(lidar)
    scene.blender_lidar.world.detail = "box"
    assert baking.is_changed(lidar)


def test_duplicates_renamed_lidars_and_other_files_have_bakes_of_their_own(scene, tmp_path):
    before, lidar = bake(scene), lidars(scene)[0]
    scenarios.select(bpy.context, lidar)
    assert bpy.ops.object.duplicate() == {"FINISHED"}
    twin = bpy.context.object
    assert not baking.files_of(twin)
    twin.name = "Süd/Mast"
    twin.location.z += 1.0
    after = bake(scene)
    assert len(after) == 12
    assert {path.parent.name for path in after} == {"LiDAR", "LiDAR_001", "S_d_Mast"}
    assert set(before.items()) < set(after.items())
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "other.blend"))
    scene.frame_set(2)
    assert bpy.ops.blender_lidar.free_bake() == {"FINISHED"}
    assert all(path.exists() for path in after)  # the other file's
    assert {path.parents[1].name for path in bake(scene)} == {"other_bake"}
    assert {path: path.stat().st_mtime_ns for path in after} == after
    lidar.name = "s_d_mast"
    with pytest.raises(RuntimeError, match="names that make folders"):
        bpy.ops.blender_lidar.bake()


def test_a_file_that_is_opened_again_shows_its_bake_which_delete_bake_takes_away(scene):
    bake(scene)
    scene.frame_set(2)
    expected = shown(lidars(scene)[0])
    scene.frame_set(9)
    bpy.ops.wm.open_mainfile(filepath=bpy.data.filepath)  # which was saved before, as when a script bakes
    scene = bpy.context.scene
    scene.frame_set(2)
    lidar = lidars(scene)[0]
    np.testing.assert_array_equal(shown(lidar)["co"], expected["co"])
    folder = baking.folder_of(lidar)
    shutil.copy(baking.files_of(lidar)[1], folder / "copy.ply")
    (folder / "frame_0009.ply").write_text("another's")
    baking.files_of(lidar)[3].write_bytes(baking.files_of(lidar)[3].read_bytes()[:-9])
    for frame in (3, 9):
        scene.frame_set(frame)
        assert len(shown(lidar)["ring"]) == 0
    assert bpy.ops.blender_lidar.free_bake() == {"FINISHED"}
    left = sorted(path.name for path in folder.parent.rglob("*.ply"))
    assert left == ["copy.ply", "frame_0003.ply", "frame_0009.ply"]


def test_a_rendered_animation_has_the_cloud_of_each_frame_in_its_place(scene, tmp_path):
    bake(scene)
    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    scene.collection.objects.link(camera)
    scene.camera, scene.world = camera, None
    camera.location = (0.0, 9.0, 9.0)
    shown_one = lidars(scene)[1]
    for item in scene.objects:
        item.hide_render = item != cloud_of(shown_one)
    scene.render.engine, scene.cycles.samples, scene.frame_end = "CYCLES", 1, 3
    scene.cycles.use_denoising = False
    scene.render.resolution_x = scene.render.resolution_y = 48
    scene.render.filepath = str(tmp_path / "film_")
    bpy.ops.render.render(animation=True)
    pictures = []
    for frame in (1, 2, 3):
        scene.frame_set(frame)
        scene.render.filepath = str(tmp_path / f"still_{frame:04d}")
        bpy.ops.render.render(write_still=True)
        for name in ("film", "still"):
            image = bpy.data.images.load(str(tmp_path / f"{name}_{frame:04d}.png"))
            pictures.append(np.array(image.pixels))
        np.testing.assert_array_equal(*pictures[-2:])
        assert pictures[-1].reshape(-1, 4)[:, :3].any()
    assert (pictures[0] != pictures[2]).any()
    assert (pictures[2] != pictures[4]).any()


def run(*words, folder):
    command = [sys.executable, str(SCRIPT), *map(str, words)]
    settings = os.environ | {"PYTHONDONTWRITEBYTECODE": "1"}
    done = subprocess.run(
        command, capture_output=True, text=True, timeout=WAIT_S, check=False, cwd=folder, env=settings
    )
    assert "Traceback" not in done.stdout + done.stderr
    return done.returncode, done.stderr.splitlines()


def test_the_script_bakes_what_the_window_bakes_and_goes_on_from_there(scene, tmp_path):
    bpy.ops.wm.save_mainfile()
    code, said = run("street.blend", "--end", 3, folder=tmp_path)
    assert (code, said[-1]) == (0, "bake: 6 of 6 frame 3")
    before = {path: path.stat().st_mtime_ns for one in lidars(scene) for path in baking.files_of(one).values()}
    assert len(before) == 6
    after = bake(scene)
    assert {path: after[path] for path in before} == before
    assert len(after) == 8
    assert run("street.blend", "--start", 9, folder=tmp_path)[0] == 2
    assert run("none.blend", folder=tmp_path) == (2, ["blender-lidar: none.blend: there is no such file"])


def test_a_lidar_that_renders_hide_is_left_out(scene):
    first, second = lidars(scene)
    second.hide_render = True
    assert {path.parent.name for path in bake(scene)} == {first.name}


def test_headers_say_what_made_a_cloud(scene):
    bake(scene)
    path = baking.files_of(lidars(scene)[0])[2]
    header = json.loads(next(line for line in path.read_bytes().split(b"\n") if b"{" in line).partition(b" ")[2])
    scene.frame_set(2)
    assert header["frame"] == session.vehicles_of(scene).frame
    assert header["sensor"] == "RS-16"
