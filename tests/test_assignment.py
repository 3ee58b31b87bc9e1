"""Which box a point lies in, against a loop over points and boxes."""

from __future__ import annotations

import math

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from blender_lidar.metrics.assignment import NO_BOX, SLACK_M, points_in_boxes
from tests.sample_traffic import dense_traffic

CAR = (np.array([[0.0, 0.0, 0.75]]), np.array([[4.0, 2.0, 1.5]]), np.array([0.0]))


def by_loop(points, centre, size, heading, clearance=0.0, slack=SLACK_M):
    """The nearest of the boxes that hold a point, one point and one box at a time."""
    rows = []
    for point in points:
        best, nearest = NO_BOX, math.inf
        for box in range(len(centre)):
            away = point - centre[box]
            forward = away[0] * math.cos(heading[box]) + away[1] * math.sin(heading[box])
            left = away[1] * math.cos(heading[box]) - away[0] * math.sin(heading[box])
            inside = all(
                abs(along) <= 0.5 * side + slack
                for along, side in zip((forward, left, away[2]), size[box], strict=True)
            )
            above = clearance == 0.0 or away[2] + 0.5 * size[box][2] >= clearance
            if inside and above and math.hypot(*away) < nearest:
                best, nearest = box, math.hypot(*away)
        rows.append(best)
    return np.array(rows, dtype=np.int64)


@settings(max_examples=60)
@given(
    seed=st.integers(0, 2**32 - 1),
    boxes=st.integers(0, 8),
    points=st.integers(0, 60),
    spread=st.sampled_from([2.0, 8.0, 40.0]),
    clearance=st.sampled_from([0.0, 0.1, 0.7]),
    slack=st.sampled_from([0.0, SLACK_M, 0.5]),
)
def test_boxes_that_overlap_or_not_get_the_points_of_the_loop(seed, boxes, points, spread, clearance, slack):
    rng = np.random.default_rng(seed)
    centre = rng.uniform([-spread, -spread, 0.0], [spread, spread, 2.0], (boxes, 3))
    size, heading = rng.uniform(0.5, 10.0, (boxes, 3)), rng.uniform(-np.pi, np.pi, boxes)
    cloud = rng.uniform([-spread, -spread, -1.0], [spread, spread, 4.0], (points, 3))
    found = points_in_boxes(cloud, centre, size, heading, clearance, slack)
    assert found.dtype == np.int64
    np.testing.assert_array_equal(found, by_loop(cloud, centre, size, heading, clearance, slack))


def test_a_dense_frame_gets_the_points_of_the_loop_in_any_order():
    vehicles = dense_traffic(vehicles=40, length_m=120.0)
    boxes = vehicles.centre_m, vehicles.size_m, vehicles.heading_rad
    rng = np.random.default_rng(1)
    points = rng.uniform([-60, 0, 0], [60, 26, 4], (3000, 3))
    found = points_in_boxes(points, *boxes, 0.1)
    assert len(np.unique(found)) > 30
    np.testing.assert_array_equal(found, by_loop(points, *boxes, 0.1))
    order = rng.permutation(3000)
    np.testing.assert_array_equal(points_in_boxes(points[order], *boxes, 0.1), found[order])


def test_the_rim_of_a_box_belongs_to_it():
    corners = np.array([(x, y, z) for x in (-2.0, 2.0) for y in (-1.0, 1.0) for z in (0.0, 1.5)])
    outward = np.sign(corners - CAR[0])
    assert points_in_boxes(corners, *CAR, slack_m=0.0).tolist() == [0] * 8
    assert points_in_boxes(corners + 1e-9 * outward, *CAR, slack_m=0.0).tolist() == [NO_BOX] * 8
    assert points_in_boxes(corners + 0.99 * SLACK_M * outward, *CAR).tolist() == [0] * 8
    assert points_in_boxes(corners + 1.01 * SLACK_M * outward, *CAR).tolist() == [NO_BOX] * 8


@given(
    heading=st.floats(-math.pi, math.pi),
    size=st.tuples(*[st.floats(0.5, 15.0)] * 3),
    centre=st.tuples(st.floats(-1e3, 1e3), st.floats(-1e3, 1e3), st.floats(0.0, 5.0)),
)
def test_what_lies_on_a_face_is_not_lost_to_rounding(heading, size, centre):
    half = 0.5 * np.array(size)
    local = np.array([side * sign * half for side in np.eye(3) for sign in (-1.0, 1.0)] + [half, -half])
    turn = np.array([[math.cos(heading), math.sin(heading)], [-math.sin(heading), math.cos(heading)]])
    points = np.column_stack([local[:, :2] @ turn, local[:, 2]]) + centre
    box = np.array([centre]), np.array([size]), np.array([heading])
    assert points_in_boxes(points, *box).tolist() == [0] * len(points)
    millimetres = box[0], box[1].round(3), box[2]
    assert points_in_boxes(points, *millimetres).tolist() == [0] * len(points)


def test_without_boxes_or_points_nothing_belongs_to_anything():
    none = np.empty((0, 3))
    assert points_in_boxes(np.zeros((4, 3)), none, none, np.empty(0)).tolist() == [NO_BOX] * 4
    assert points_in_boxes(none, *CAR).shape == (0,)
    assert points_in_boxes(none, none, none, np.empty(0)).shape == (0,)


def test_a_frame_in_map_coordinates_loses_nothing():
    far = np.array([6_042_842.0, 2_133_117.0, 0.0])
    rng = np.random.default_rng(2)
    points = rng.uniform([-3, -2, 0], [3, 2, 2], (500, 3))
    clear = (np.abs(np.abs(points - CAR[0]) - 0.5 * CAR[1] - SLACK_M) > 1e-6).all(axis=1)
    here = points_in_boxes(points, *CAR)
    there = points_in_boxes(points + far, CAR[0] + far, *CAR[1:])
    np.testing.assert_array_equal(there[clear], here[clear])
