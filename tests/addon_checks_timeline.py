"""Checks of the timeline: it moves the traffic, and what it shows is what is scanned."""

from __future__ import annotations

import math
import shutil

import bpy
import numpy as np

from blender_lidar.addon import live, panels, scenarios, session
from blender_lidar.scene.scenario import load_scenario
from blender_lidar.scene.site import read_recording
from blender_lidar.world.blender.objects import lidars
from blender_lidar.world.blender.points import cloud_of
from blender_lidar.world.blender.traffic import traffic_object
from tests.addon_sample import FOLDER, FRAME, example, loaded, new_file, refused, vertices
from tests.blender_session import assert_shows


def scanned(lidar):
    """Points, and the numbers of the vehicles that they lie on, -1 for none."""
    assert bpy.ops.blender_lidar.scan() == {"FINISHED"}
    mesh = cloud_of(lidar).data
    number = np.empty(len(mesh.vertices), np.int32)
    mesh.attributes["vehicle"].data.foreach_get("value", number)
    return vertices(cloud_of(lidar)), number


def check_the_example_plays_20_s_from_the_current_frame_and_is_scanned_at_every_time():
    scene = new_file()
    scene.frame_set(11)
    assert bpy.ops.blender_lidar.load_example() == {"FINISHED"}
    (lidar,), group = lidars(scene), scene.blender_lidar
    group.model.caster = "bvh"
    played = session.recording_of(scene)
    assert (scene.frame_current, scene.frame_start, scene.frame_end, scene.render.fps) == (11, 1, 11 + 480, 24)
    assert (group.frame, session.time_text(scene)) == (2500, "At 0.00 s")
    seen = []
    for at, since_s, text in (
        (11, 0.0, ""),
        (17, 0.25, ", between instants"),
        (23, 0.5, ""),
        (12, 1 / 24, ", between instants"),
    ):
        scene.frame_set(at)
        vehicles = session.vehicles_of(scene)
        np.testing.assert_array_equal(vehicles.centre_m, played.moment(session.since_of(scene)).centre_m)
        assert abs(session.since_of(scene) - since_s) < 1e-5
        assert session.time_text(scene) == f"At {since_s:.2f} s{text}"
        assert_shows(scene, vehicles)
        assert panels.is_stale(scene, lidar)
        xyz, number = scanned(lidar)
        assert not panels.is_stale(scene, lidar)
        seen.append(xyz)
        for row, vehicle in enumerate(vehicles.vehicle_id.tolist()):  # its points lie on its box
            off = xyz[number == vehicle] - vehicles.centre_m[row]
            cos, sin = math.cos(vehicles.heading_rad[row]), math.sin(vehicles.heading_rad[row])
            along, across = off[:, 0] * cos + off[:, 1] * sin, off[:, 1] * cos - off[:, 0] * sin
            assert np.all(np.abs(along) < vehicles.size_m[row, 0] / 2 + 1e-3)
            assert np.all(np.abs(across) < vehicles.size_m[row, 1] / 2 + 1e-3)
    assert len({xyz.tobytes() for xyz in seen}) == 4
    np.testing.assert_array_equal(played.at(2505).centre_m, played.moment(0.5).centre_m)
    lidar.blender_lidar.live = True
    for row, at in ((1, 17), (2, 23)):  # Live follows, and finds what Scan has found
        scene.frame_set(at)
        live.update()
        shown = live._state.shown[scenarios.uid_of(lidar)].look.cloud.xyz
        np.testing.assert_allclose(shown, seen[row], atol=1e-5)
    lidar.blender_lidar.live = False
    live.update()
    searched = read_recording(load_scenario("i80"))
    assert len(session.recordings_of(scene)[0]) == len(searched)
    scene.frame_set(11 + 480 + 1)
    assert session.time_text(scene).endswith("no traffic at this time")
    assert len(session.vehicles_of(scene)) == 0
    assert (scanned(lidar)[1] == -1).all()


def check_the_range_of_a_scene_in_use_stays():
    scene = new_file()
    scene.frame_end = 100
    assert bpy.ops.blender_lidar.load_example() == {"FINISHED"}
    assert (scene.frame_start, scene.frame_end, scene.frame_current) == (1, 100, 1)
    assert scene.blender_lidar.clip
    own = shutil.copy(scene.blender_lidar.traffic.path, FOLDER / "own.csv.gz")
    scene.blender_lidar.traffic.path = str(own)
    assert bpy.ops.blender_lidar.load() == {"FINISHED"}
    assert not scene.blender_lidar.clip  # so that the tab names this file


def check_steps_go_from_instant_to_instant_and_starts_at_moves_the_clock():
    scene, _ = loaded()
    group = scene.blender_lidar
    recording, fps = session.recording_of(scene), scene.render.fps
    assert group.frame == FRAME
    scene.frame_set(scene.frame_current + 5)
    assert group.frame == FRAME
    assert session.time_text(scene).endswith("no traffic at this time")
    for back, expected in ((True, FRAME), (True, FRAME - 1), (False, FRAME), (False, FRAME + 1)):
        assert bpy.ops.blender_lidar.step_frame(back=back) == {"FINISHED"}
        assert group.frame == expected
        assert_shows(scene, recording.at(expected))
    at = scene.frame_current
    group.starts_s += 2.0  # an instant later
    assert (scene.frame_current, group.frame) == (at, FRAME)
    assert_shows(scene, recording.at(FRAME))
    scene.render.fps = fps + 1  # whatever the rate, a second is a second
    group.frame = FRAME + 3
    assert_shows(scene, recording.at(FRAME + 3))
    before = session.since_of(scene)
    assert bpy.ops.blender_lidar.load() == {"FINISHED"}
    assert abs(session.since_of(scene) - before) < 1e-5
    assert group.frame == FRAME + 3


def check_what_is_hidden_or_deleted_is_not_scanned_and_not_searched():
    scene, lidar = loaded()
    xyz, number = scanned(lidar)
    assert (number >= 0).any()
    item, layer = traffic_object(scene), bpy.context.view_layer
    assert item.hide_select
    hiding = [
        lambda hidden: setattr(item, "hide_viewport", hidden),
        lambda hidden: setattr(item, "hide_render", hidden),
        lambda hidden: item.hide_set(hidden),
        lambda hidden: setattr(item.users_collection[0], "hide_render", hidden),
        lambda hidden: setattr(layer.layer_collection.children["Vehicles"], "exclude", hidden),
    ]
    for hide in hiding:
        hide(True)
        assert (scanned(lidar)[1] == -1).all()
        assert "hidden; show it" in refused(bpy.ops.blender_lidar.optimize)
        assert "hidden; show it" in refused(bpy.ops.blender_lidar.export_run, directory=str(FOLDER / "run"))
        hide(False)
        np.testing.assert_array_equal(scanned(lidar)[0], xyz)
    bpy.data.objects.remove(item)
    assert (scanned(lidar)[1] == -1).all()
    scene.frame_set(scene.frame_current + 1)
    scene.frame_set(scene.frame_current - 1)
    assert traffic_object(scene) is None
    assert "deleted; Load brings it back" in refused(bpy.ops.blender_lidar.optimize)
    scene.blender_lidar.traffic.path = str(example())
    assert bpy.ops.blender_lidar.load() == {"FINISHED"}
    scene.blender_lidar.frame = FRAME
    np.testing.assert_array_equal(scanned(lidar)[0], xyz)


def check_another_detail_variety_or_choice_of_vehicles_is_shown_at_once_as_it_is_scanned():
    scene, _ = loaded()
    for detail in ("box", "detailed", "body"):
        scene.blender_lidar.world.detail = detail
        bodies = bpy.data.collections["Vehicle bodies"].objects
        assert all(item.name.split(".")[0].endswith(detail) for item in bodies)
        assert_shows(scene, session.vehicles_of(scene))
    scene.blender_lidar.world.variety = 1.0
    vehicles = session.vehicles_of(scene)
    assert len(set(vehicles.body.tolist())) > 2
    assert_shows(scene, vehicles)
    scene.blender_lidar.traffic.leave_out = str(vehicles.vehicle_id[0])
    left = session.vehicles_of(scene)
    assert left.vehicle_id.tolist() == vehicles.vehicle_id[1:].tolist()
    assert_shows(scene, left)
