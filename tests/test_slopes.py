"""A road that is not level beside a plumb mast: the same as a tilted world about a level one, beam by beam."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from blender_lidar.casting.exact import ExactCaster
from blender_lidar.clouds.files import levelled
from blender_lidar.detection.judge import believed, sensor_at
from blender_lidar.errors import InputError
from blender_lidar.road.settings import RoadSettings, map_of
from blender_lidar.scene.mount_checks import check_mount_is_clear
from blender_lidar.scene.mounting import COORDINATES, Mounting, mast_at, mounting_from
from blender_lidar.scene.scenario import load_scenario
from blender_lidar.scene.site import prepare, read_recording
from blender_lidar.scoring import frame_scorer
from blender_lidar.sensors.pose import Pose, rotation_matrix
from blender_lidar.world.triangles import vehicle_triangles
from tests.small_scene import CASTER

pytestmark = pytest.mark.versions

MOUNT = dict(zip(COORDINATES, (3.0, -1.0, 4.2, 14.0, 5.0, 20.0), strict=True))
SLOPES = {"grade_percent": 6.0, "cross_fall_percent": -2.5}


def scenario(caster=CASTER, **road):
    scene = {("model", "caster"): caster, ("traffic", "frames"): 4, ("world", "variety"): 1.0}
    scene |= {("road", key): value for key, value in road.items()}
    return load_scenario("i80", {key: (value, "x") for key, value in scene.items()})


@pytest.fixture(scope="module")
def site():
    return prepare(scenario("exact", **SLOPES))


@pytest.fixture(scope="module")
def crowned():
    return prepare(scenario(**SLOPES, crown_percent=3.0))


def tilted(points, grade, cross_fall):
    """Points on a road that was level, after its plane was tilted: Gram and Schmidt's axes within it."""
    x, y = np.array([1.0, 0.0, grade]), np.array([0.0, 1.0, cross_fall])
    x /= np.linalg.norm(x)
    y -= (y @ x) * x
    y /= np.linalg.norm(y)
    return points @ np.stack([x, y, np.cross(x, y)])


def rays_of(lattice, mount):
    """Plumb rays of all beams."""
    angles = (math.radians(mount[key]) for key in ("tilt_x_deg", "tilt_y_deg", "yaw_deg"))
    return lattice.directions.reshape(-1, 3) @ rotation_matrix(*angles)


def test_ranges_are_those_of_a_tilted_world_about_a_plumb_lidar(site):
    grade, cross_fall = 0.06, -0.025
    frame, lattice = site.search[0], site.observation.lattice
    cloud = sensor_at(site, site.scenario.lidar.mounting(MOUNT)).scan(frame)
    corners = tilted(vehicle_triangles(frame).corners, grade, cross_fall)
    foot = tilted(np.array([[MOUNT["x_m"], MOUNT["y_m"], 0.0]]), grade, cross_fall)[0]
    assert foot[2] == pytest.approx(grade * foot[0] + cross_fall * foot[1], abs=1e-12)
    head = foot + np.array([0.0, 0.0, MOUNT["height_m"]])
    rays = rays_of(lattice, MOUNT)
    hits = ExactCaster(corners, closed=True).cast(np.tile(head, (len(rays), 1)), rays)
    # The ground: z = grade x + cross_fall y.
    closing = grade * rays[:, 0] + cross_fall * rays[:, 1] - rays[:, 2]
    with np.errstate(divide="ignore"):
        ground = np.where(closing > 0.0, MOUNT["height_m"] / closing, np.inf)
    expected = np.minimum(hits.distance, ground)
    within = (expected >= site.observation.lidar.min_range_m) & (expected <= site.observation.lidar.max_range_m)
    assert (cloud.vehicle_id >= 0).sum() > 500
    np.testing.assert_allclose(cloud.range_m, expected[within], atol=1e-9, rtol=0.0)
    np.testing.assert_array_equal(cloud.vehicle_id >= 0, (hits.distance < ground)[within])
    measured = tilted(cloud.xyz, grade, cross_fall)
    np.testing.assert_allclose(measured, head + expected[within, None] * rays[within], atol=1e-9, rtol=0.0)
    of_ground = cloud.vehicle_id < 0
    np.testing.assert_allclose(cloud.xyz[of_ground, 2], 0.0, atol=1e-9)


def test_a_crown_is_two_planes_on_which_vehicles_stand(crowned):
    road, frame = crowned.scenario.road, crowned.search[0]
    right, half = road.setback_m, 0.5 * road.lanes * road.lane_width_m
    floor = frame.centre_m[:, 2] - 0.5 * frame.size_m[:, 2]
    np.testing.assert_allclose(floor, 0.03 * (half - abs(frame.centre_m[:, 1] - right - half)).clip(0.0), atol=1e-12)

    mounting = crowned.scenario.lidar.mounting(MOUNT)
    cloud, pose = sensor_at(crowned, mounting).scan(frame), mounting.pose
    of_ground = cloud.vehicle_id < 0
    z = crowned.scenario.road_map.surface.height(cloud.xyz)
    np.testing.assert_allclose(cloud.xyz[of_ground, 2], z[of_ground], atol=1e-9)
    assert (z[of_ground] > 0.2).sum() > 100
    # What lies nearer than the surface: two half-spaces meet in the crown, beside it there is the plane z = 0.
    directions = (cloud.xyz - pose.position) / cloud.range_m[:, None]
    reach = pose.height_m / np.where(directions[:, 2] < 0.0, -directions[:, 2], 1e-300)
    enters, leaves = np.zeros(len(cloud)), np.full(len(cloud), np.inf)
    for side in (-1.0, 1.0):
        above = pose.height_m - 0.03 * (half + side * (pose.y_m - right - half))
        change = directions[:, 2] - side * 0.03 * directions[:, 1]
        cross = -above / change
        enters = np.where(change < 0.0, np.maximum(enters, cross), enters if above < 0.0 else np.inf)
        leaves = np.where((change > 0.0) & (above < 0.0), np.minimum(leaves, cross), leaves)
    surface = np.minimum(reach, np.where(enters < leaves, enters, np.inf))
    np.testing.assert_allclose(cloud.range_m[of_ground], surface[of_ground], atol=1e-9, rtol=0.0)
    assert (cloud.range_m[~of_ground] <= surface[~of_ground] + 1e-9).all()


def test_each_carriageway_has_its_crown_and_both_have_one_where_nothing_parts_them():
    two = RoadSettings(carriageways=2, median_m=5.0, lanes=2, lane_width_m=3.5, setback_m=2.0, crown_percent=3.0)
    y = np.array([2.0, 5.5, 9.0, 11.5, 14.0, 17.5, 21.0])  # of edges, crowns and the middle of the median
    height = map_of(two).surface.height(np.stack([0.0 * y, y], axis=1))
    np.testing.assert_allclose(height, 0.03 * 3.5 * np.array([0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0]), atol=1e-12)
    one = map_of(replace(two, median_m=0.0))
    np.testing.assert_allclose(one.surface.height(np.array([[0.0, 9.0], [0.0, 16.0]])), [0.03 * 7.0, 0.0], atol=1e-12)


@pytest.mark.parametrize(("surveyed", "lifted"), [(0.0, True), (0.04, True), (0.3, False)])
def test_boxes_that_do_not_stand_at_z_0_are_not_lifted_to_the_crown(surveyed, lifted, tmp_path):
    table = "frame,vehicle_id,class,x_m,y_m,length_m,width_m,height_m,heading_deg,z_m\n" + "".join(
        f"{frame},{number},car,{20 * number + 2 * frame},{y},4.5,1.8,1.5,0,{0.75 + surveyed * (number + 2) / 6}\n"
        for frame in range(20)
        for number, y in enumerate((4.0, 8.0, 13.0, 16.0, 20.0))
    )
    (tmp_path / "surveyed.csv").write_text(table)
    scene = {("traffic", "path"): str(tmp_path / "surveyed.csv"), ("traffic", "format"): "table"}
    scene |= {("traffic", "time_step_s"): 0.1, ("road", "crown_percent"): 2.0}
    recording = read_recording(load_scenario("i80", {key: (value, "x") for key, value in scene.items()}))
    floor = recording.centre_m[:, 2] - 0.75
    offset = surveyed * (recording.vehicle_id + 2) / 6
    crown = 0.02 * (10.98 - abs(recording.centre_m[:, 1] - 12.98))
    np.testing.assert_allclose(floor, offset + crown if lifted else offset, atol=1e-12)
    assert any("not lifted to the surface" in note for note in recording.report.notes) != lifted


@pytest.mark.parametrize("compiled", [True, False])
def test_scores_see_what_clouds_do(compiled, crowned, monkeypatch):
    if not compiled:
        monkeypatch.setattr(frame_scorer, "numba_works", lambda: False)
    for height in (2.0, 4.2):
        mounting = crowned.scenario.lidar.mounting(MOUNT | {"height_m": height})
        for frame in crowned.search[:2]:
            cloud = sensor_at(crowned, mounting).scan(frame)
            expected = [(cloud.vehicle_id == number).sum() for number in frame.vehicle_id[frame.counted]]
            seen = frame_scorer.FrameScorer(frame, crowned.observation)
            np.testing.assert_array_equal(seen.see([(mounting.pose,)]).points[0], expected)
            assert sum(expected) > 100


def test_who_believes_in_a_level_road_sees_the_ground_off_it(site):
    cloud = sensor_at(site, site.scenario.lidar.mounting(MOUNT)).scan(site.search[0])
    level = mounting_from(MOUNT, map_of(RoadSettings()))
    seen = believed(cloud, site.scenario.lidar.mounting(MOUNT).pose, level.pose)
    ground = cloud.vehicle_id < 0
    far = ground & (cloud.xyz[:, 0] > 20.0)
    np.testing.assert_allclose(seen.xyz[far, 2], 0.06 * seen.xyz[far, 0] - 0.025 * seen.xyz[far, 1] - 0.205, atol=2e-3)
    assert seen.xyz[far, 2].min() > 0.15  # what a detector takes for the ground lies below


def test_signs():
    uphill, to_the_right = (
        Mounting(mast_at(map_of(RoadSettings(**one)), 0.0, 0.0), 4.0).pose
        for one in ({"grade_percent": 5.0}, {"cross_fall_percent": 5.0})
    )
    ahead = uphill.to_world(np.array([[1.0, 0.0, 0.0]]))[0]
    assert ahead[2] == pytest.approx(-0.05 / math.hypot(1, 0.05))  # level, into the hill
    across = to_the_right.to_world(np.array([[0.0, 1.0, 0.0]]))[0]
    assert across[2] == pytest.approx(-0.05 / math.hypot(1, 0.05))  # level, while the road rises to the left
    assert uphill.x_m > 0.19
    assert to_the_right.y_m > 0.19
    assert uphill.height_m == pytest.approx(4.0 / math.hypot(1, 0.05))


def test_headers_have_the_pose_in_the_road_frame_and_the_plumb_mounting(site):
    sensor = sensor_at(site, site.scenario.lidar.mounting(MOUNT))
    header, pose = sensor.cloud_header(site.search[0]), site.scenario.lidar.mounting(MOUNT).pose
    assert {key: header["mounting"][key] for key in COORDINATES} == pytest.approx(MOUNT)
    assert header["road"] == SLOPES
    np.testing.assert_allclose(levelled(pose.position[None], Pose.from_table(header["pose"])), 0.0, atol=1e-12)
    np.testing.assert_allclose(Pose.from_table(header["pose"]).rotation, pose.rotation, atol=1e-12)


def test_the_head_of_a_leaning_mast_keeps_out_of_boxes():
    box = {"centre_m": [1.0, -1.0, 4.0], "size_m": [1.0, 1.0, 1.0]}
    mount = dict.fromkeys(COORDINATES, 0.0) | {"x_m": 0.3, "y_m": -1.0, "height_m": 4.2}
    higher = box | {"centre_m": [1.0, -1.0, 4.68]}  # its floor, at 4.18 m, lies above a head that leans by 12 %
    for grade, item, inside in ((0.0, box, False), (12.0, box, True), (12.0, higher, False)):
        scene = load_scenario("i80", {("world", "boxes"): ([item], "x"), ("road", "grade_percent"): (grade, "x")})
        if inside:
            with pytest.raises(InputError, match="inside 'box 1'"):
                check_mount_is_clear(scene, scene.lidar, [], {"--x": scene.lidar.mounting(mount)})
        else:
            check_mount_is_clear(scene, scene.lidar, [], {"--x": scene.lidar.mounting(mount)})


def test_files_of_scenery_are_refused_beside_a_slope():
    mesh = ("world", "mesh"), ("site.obj", "x")
    assert load_scenario("i80", dict([mesh, (("road", "crown_percent"), (2.0, "x"))])).world.mesh
    with pytest.raises(InputError, match="plumb; allowed: boxes"):
        load_scenario("i80", dict([mesh, (("road", "grade_percent"), (2.0, "x"))]))
