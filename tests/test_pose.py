"""The mounting's conventions: which way each angle turns the sensor, and where its beams then meet the road."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from blender_lidar.sensors.beams import beam_directions, beam_lattice
from blender_lidar.sensors.model import load_model
from blender_lidar.sensors.pose import Pose, rotation_matrix

ANGLE = st.floats(-math.pi, math.pi)
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


@given(ANGLE, ANGLE, ANGLE)
def test_every_rotation_keeps_lengths_and_handedness(tilt_x, tilt_y, yaw):
    rotation = rotation_matrix(tilt_x, tilt_y, yaw)
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-14)
    assert np.linalg.det(rotation) == pytest.approx(1.0)


@given(LENGTH, LENGTH, LENGTH, ANGLE, ANGLE, ANGLE)
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


@given(ANGLE)
def test_what_a_table_keeps_of_an_angle_is_off_by_its_last_digits_at_most(angle):
    assert Pose.from_table(Pose(yaw=angle).as_table()).yaw == pytest.approx(angle, rel=0.0, abs=1e-14)
