"""Masts, mountings, poses and search spaces; and sites: which vehicles judge a mounting."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from blender_lidar.errors import InputError
from blender_lidar.road.settings import RoadSettings, map_of
from blender_lidar.scene import site as site_module
from blender_lidar.scene.deployment import Pole, SearchSpace
from blender_lidar.scene.mounting import Mast, Mounting, hung_at, mast_at, mounting_from
from blender_lidar.scene.scenario import load_scenario
from blender_lidar.scene.site import prepare, read_recordings
from blender_lidar.scene.sugar import on_pole
from blender_lidar.sensors.beams import beam_directions, beam_lattice
from blender_lidar.sensors.model import load_model
from blender_lidar.sensors.pose import Pose, lean_matrix, rotation_matrix
from tests.small_scene import FRAME_STEP_S, mounting, place_of, traffic_rows, write_scene, write_table

pytestmark = pytest.mark.versions

LEVEL = RoadSettings()
SLOPING = RoadSettings(grade_percent=6.0, cross_fall_percent=-2.5, crown_percent=3.0)
ANGLE = st.floats(-1.4, 1.4)
PLACE = st.floats(-30.0, 30.0)
mountings = st.builds(
    lambda road, x, y, facing, height, tilt_x, tilt_y, yaw: (
        map_of(road),
        Mounting(mast_at(map_of(road), x, y, facing), height, tilt_x, tilt_y, yaw),
    ),
    st.sampled_from([LEVEL, SLOPING]),
    PLACE,
    PLACE,
    st.floats(0.0, 6.2),
    st.floats(1.0, 9.0),
    ANGLE,
    ANGLE,
    st.floats(-3.0, 3.0),
)


@settings(max_examples=80, deadline=None)
@given(mountings)
def test_a_mounting_comes_back_from_its_pose_and_from_its_table(made):
    road, mounting = made
    pose = mounting.pose
    for again in (
        hung_at(pose, road, mounting.mast.facing_rad),
        mounting_from(mounting.as_table(), road, Mounting(Mast(facing_rad=mounting.mast.facing_rad))),
    ):
        np.testing.assert_allclose(again.pose.position, pose.position, atol=1e-9)
        np.testing.assert_allclose(again.pose.rotation, pose.rotation, atol=1e-9)


@settings(max_examples=60, deadline=None)
@given(mountings)
def test_the_sensor_looks_along_the_mast_frame_turned_by_its_tilts(made):
    _, mounting = made
    axes = mounting.mast.T_site_mast.rotation
    np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-12)
    level = Mounting(Mast(), 0.0, mounting.tilt_x, mounting.tilt_y, mounting.yaw)
    np.testing.assert_allclose(mounting.pose.rotation, level.pose.rotation @ axes, atol=1e-9)
    up = np.array(mounting.mast.up)
    np.testing.assert_allclose(mounting.pose.position, mounting.mast.foot_m + mounting.height_m * up, atol=1e-12)


def test_a_mast_that_faces_along_x_looks_down_there():
    tilted = Mounting(Mast((0.0, 0.0, 0.0), facing_rad=0.0), 4.0, tilt_x=math.radians(20.0))
    ahead = tilted.pose.to_world(np.array([[0.0, 1.0, 0.0]]))[0]
    np.testing.assert_allclose(ahead, [math.cos(math.radians(20.0)), 0.0, -math.sin(math.radians(20.0))], atol=1e-12)


def test_a_lean_and_its_tilts_are_one_mounting_and_two_that_differ_are_refused():
    road = map_of(LEVEL)
    lean = mounting_from({"height_m": 4.0, "lean_deg": 20.0, "lean_direction_deg": 30.0, "spin_deg": 5.0}, road)
    np.testing.assert_allclose(lean.pose.rotation, lean_matrix(*np.radians([20.0, 30.0, 5.0])), atol=1e-12)
    table = lean.as_table()
    assert table["lean_deg"] == pytest.approx(20.0, abs=1e-9)
    np.testing.assert_allclose(mounting_from(table, road).pose.rotation, lean.pose.rotation, atol=1e-9)
    with pytest.raises(InputError, match="its lean is not that of its tilts"):
        mounting_from({**table, "tilt_x_deg": 3.0}, road)
    with pytest.raises(InputError, match="has lean_deg and tilt_x_deg"):
        mounting_from({"lean_deg": 3.0, "tilt_x_deg": 3.0}, road)
    upright = mounting_from({"yaw_deg": 12.0}, road).as_table()
    assert (upright["lean_deg"], upright["lean_direction_deg"], upright["spin_deg"]) == (0.0, None, 12.0)


def test_what_a_table_leaves_out_is_that_of_the_other_mounting():
    road = map_of(SLOPING)
    base = Mounting(mast_at(road, 3.0, -1.0), 2.5, 0.1, 0.2, 0.3)
    found = mounting_from({"height_m": 4.0, "tilt_y_deg": 0.0}, road, base)
    assert found == replace(base, height_m=4.0, tilt_y=0.0)
    moved = mounting_from({"x_m": 9.0}, road, base)
    assert moved.xy == (9.0, -1.0)


def test_a_search_space_gives_the_layout_of_all_its_lidars():
    upright = {"tilt_y_deg": 0.0, "yaw_deg": 0.0}
    one = place_of({"x_m": 0.0, "y_m": 0.0, **upright}, {"height_m": (2.0, 4.0), "tilt_x_deg": (0.0, 25.0)})
    two = place_of(
        {"y_m": -1.0, "height_m": 5.0, "tilt_x_deg": 0.0, "tilt_y_deg": 0.0},
        {"x_m": (-9.0, 9.0), "yaw_deg": (0.0, 360.0)},
    )
    space = SearchSpace((one, two))
    assert space.lower == (2.0, 0.0, -9.0, 0.0)
    assert space.periodic == (False, False, False, True)
    first, second = space.layout([3.0, 10.0, 7.0, 90.0])
    assert first == Mounting(Mast(), 3.0, tilt_x=math.radians(10.0))
    assert second == Mounting(Mast((7.0, -1.0, 0.0)), 5.0, yaw=math.radians(90.0))


@pytest.mark.parametrize("foot_z_m", [-1.0, 0.0, 3.0])
@pytest.mark.parametrize("own", [(None, None), (3.0, 8.0), (None, 6.0)])
def test_no_pole_is_searched_below_its_foot(foot_z_m, own):
    fixed = {"x_m": 0.0, "y_m": 0.0, "tilt_y_deg": 0.0, "yaw_deg": 0.0}
    anywhere = place_of(fixed, {"height_m": (2.0, 4.5), "tilt_x_deg": (0.0, 25.0)})
    low, high = on_pole(anywhere, Pole("a", 1.0, -2.0, foot_z_m, *own)).span("height_m")
    expected = [usual if end is None else end for usual, end in zip((2.0, 4.5), own, strict=True)]
    assert (low - foot_z_m, high - foot_z_m) == pytest.approx(tuple(expected))
    assert low > foot_z_m


# --- sites ------------------------------------------------------------------------------------------------------------


STANDING = 999


def test_a_vehicle_that_was_counted_in_the_search_never_judges_but_still_hides_others(tmp_path):
    """One that breaks down beside the lanes is seen in searched and held-out frames alike."""
    rows = traffic_rows()
    broken_down = [[n, STANDING, "car", 8.0, 10.5, 4.4, 1.8, 1.5, 0.0, FRAME_STEP_S * n] for n in range(60)]
    write_table(tmp_path / "traffic.csv", sorted(rows + broken_down, key=lambda row: row[0]))
    site = prepare(load_scenario(write_scene(tmp_path, {"traffic": {"block_s": 10.0}})))
    assert len(site.holdout) > 2
    for frame in site.search:
        assert frame.counted[frame.vehicle_id == STANDING].tolist() == [True]
    for frame in site.holdout:
        assert frame.counted[frame.vehicle_id == STANDING].tolist() == [False]
    searched, judging = (
        np.unique(np.concatenate([frame.vehicle_id[frame.counted] for frame in frames]))
        for frames in (site.search, site.holdout)
    )
    assert len(judging) > 3
    assert not np.isin(judging, searched).any()


def test_all_three_angles_of_a_mounting_are_degrees():
    angles = {"tilt_x_deg": 15.0, "tilt_y_deg": -30.0, "yaw_deg": 90.0}
    pose = mounting({"x_m": 1.0, "y_m": -2.0, "height_m": 4.0, **angles}).pose
    assert (pose.tilt_x, pose.tilt_y, pose.yaw) == tuple(map(math.radians, angles.values()))
    assert pose.position.tolist() == [1.0, -2.0, 4.0]


def test_a_site_of_traffic_that_was_read_already_is_the_same_and_reads_none(tmp_path, monkeypatch):
    scenario = load_scenario(write_scene(tmp_path))
    site, recordings = prepare(scenario), read_recordings(scenario)
    monkeypatch.setattr(site_module, "read_settings", None)
    again = prepare(scenario, recordings=recordings)
    assert again.identity == site.identity
    for one, other in zip((*site.search, *site.holdout), (*again.search, *again.holdout), strict=True):
        np.testing.assert_array_equal(one.centre_m, other.centre_m)
        np.testing.assert_array_equal(one.counted, other.counted)


# --- poses: which way each angle turns the sensor, and where its beams then meet the road -----------------------------


TURN = st.floats(-math.pi, math.pi)
LENGTH = st.floats(-100.0, 100.0)
PLUS_X, PLUS_Y = np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0])


def elevation(direction: np.ndarray) -> float:
    return math.asin(direction[2])


def test_a_level_sensor_looks_where_its_own_axes_point():
    np.testing.assert_array_equal(rotation_matrix(0.0, 0.0, 0.0), np.eye(3))


@pytest.mark.parametrize("tilt_deg", [-20.0, 1.0, 19.0, 45.0])
def test_positive_tilt_x_lowers_the_horizon_beam_towards_plus_y_by_that_angle(tilt_deg):
    tilt = math.radians(tilt_deg)
    turned = PLUS_Y @ rotation_matrix(tilt, 0.0, 0.0)
    np.testing.assert_allclose(turned, [0.0, math.cos(tilt), -math.sin(tilt)], atol=1e-15)
    assert elevation(-PLUS_Y @ rotation_matrix(tilt, 0.0, 0.0)) == pytest.approx(tilt)
    np.testing.assert_allclose(PLUS_X @ rotation_matrix(tilt, 0.0, 0.0), PLUS_X)


@pytest.mark.parametrize("tilt_deg", [-20.0, 1.0, 19.0, 45.0])
def test_positive_tilt_y_raises_the_horizon_beam_towards_plus_x_by_that_angle(tilt_deg):
    tilt = math.radians(tilt_deg)
    turned = PLUS_X @ rotation_matrix(0.0, tilt, 0.0)
    np.testing.assert_allclose(turned, [math.cos(tilt), 0.0, math.sin(tilt)], atol=1e-15)
    np.testing.assert_allclose(PLUS_Y @ rotation_matrix(0.0, tilt, 0.0), PLUS_Y)


def test_yaw_turns_counter_clockwise_seen_from_above():
    np.testing.assert_allclose(PLUS_X @ rotation_matrix(0.0, 0.0, math.pi / 2), PLUS_Y, atol=1e-15)
    np.testing.assert_allclose(PLUS_Y @ rotation_matrix(0.0, 0.0, math.pi / 2), -PLUS_X, atol=1e-15)


def test_yaw_turns_a_tilted_sensor_about_the_vertical():
    tilted = PLUS_Y @ rotation_matrix(0.3, 0.0, 0.0)
    turned = PLUS_Y @ rotation_matrix(0.3, 0.0, 1.1)
    assert turned[2] == pytest.approx(tilted[2])
    assert math.atan2(turned[1], turned[0]) == pytest.approx(math.pi / 2 + 1.1)


def test_clockwise_azimuth_undoes_counter_clockwise_yaw():
    turned = beam_directions(0.7, 0.1) @ rotation_matrix(0.0, 0.0, 0.7)
    np.testing.assert_allclose(turned, beam_directions(0.0, 0.1), atol=1e-15)


def test_tilt_x_comes_before_tilt_y_before_yaw():
    whole = rotation_matrix(0.2, 0.3, 0.4)
    parts = rotation_matrix(0.2, 0.0, 0.0) @ rotation_matrix(0.0, 0.3, 0.0) @ rotation_matrix(0.0, 0.0, 0.4)
    np.testing.assert_allclose(whole, parts)


@given(TURN, TURN, TURN)
def test_every_rotation_keeps_lengths_and_handedness(tilt_x, tilt_y, yaw):
    rotation = rotation_matrix(tilt_x, tilt_y, yaw)
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-14)
    assert np.linalg.det(rotation) == pytest.approx(1.0)


@given(LENGTH, LENGTH, LENGTH, TURN, TURN, TURN)
def test_directions_in_the_road_frame_are_rows_times_the_rotation_wherever_the_sensor_hangs(
    x, y, height, tilt_x, tilt_y, yaw
):
    pose = Pose(x, y, height, tilt_x, tilt_y, yaw)
    np.testing.assert_array_equal(pose.position, [x, y, height])
    directions = beam_directions(np.linspace(0.0, 6.0, 7), np.linspace(-1.0, 1.0, 7))
    expected = directions @ rotation_matrix(tilt_x, tilt_y, yaw)
    np.testing.assert_allclose(pose.to_world(directions), expected, atol=1e-14)


def nearest_ground_m(name: str, pose: Pose, side: float) -> float:
    """Distance at which the beams first meet the road straight towards +y (side 1) or -y (side -1); inf if never."""
    directions = pose.to_world(beam_lattice(load_model(name)).directions.reshape(-1, 3))
    ahead = (np.abs(directions[:, 0]) < 0.01) & (side * directions[:, 1] > 0.0) & (directions[:, 2] < 0.0)
    reach = pose.height_m * np.hypot(directions[ahead, 0], directions[ahead, 1]) / -directions[ahead, 2]
    return float(reach.min(initial=math.inf))


@pytest.mark.parametrize(
    ("name", "height_m", "tilt_deg", "towards", "away"),
    [
        ("RS-16", 2.0, 0.0, 7.5, 7.5),
        ("RS-16", 4.1, 19.0, 6.1, math.inf),
        ("RS-32", 2.0, 0.0, 7.0, 7.0),
        ("RS-32", 4.2, 13.0, 7.6, 80.0),
        ("RS-80", 2.0, 0.0, 4.3, 4.3),
        ("RS-80", 4.4, 9.0, 6.5, 15.3),
    ],
)
def test_tilting_towards_the_road_blinds_the_other_side(name, height_m, tilt_deg, towards, away):
    pose = Pose(height_m=height_m, tilt_x=math.radians(tilt_deg))
    assert nearest_ground_m(name, pose, 1.0) == pytest.approx(towards, abs=0.06)
    assert nearest_ground_m(name, pose, -1.0) == pytest.approx(away, abs=0.2)


@given(st.lists(st.integers(-36000, 36000), min_size=3, max_size=3))
def test_a_table_gives_the_angles_back_as_they_were_typed(hundredths):
    typed = {key: n / 100.0 for key, n in zip(("tilt_x_deg", "tilt_y_deg", "yaw_deg"), hundredths, strict=True)}
    assert Pose.from_table(typed).as_table() == {"x_m": 0.0, "y_m": 0.0, "height_m": 2.0, **typed}


@given(TURN)
def test_what_a_table_keeps_of_an_angle_is_off_by_its_last_digits_at_most(angle):
    assert Pose.from_table(Pose(yaw=angle).as_table()).yaw == pytest.approx(angle, rel=0.0, abs=1e-14)
