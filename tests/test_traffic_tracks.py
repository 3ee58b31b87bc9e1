"""The arithmetic behind the boxes, on arrays: fits against a slow oracle, repeats, gaps, sizes, overlaps."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from blender_lidar.traffic import Vehicles, overlapping_pairs
from blender_lidar.traffic.tracks import (
    WINDOW_S,
    fitted_velocity,
    held_heading,
    lane_changing,
)


def irregular_tracks(seed, tracks=6):
    """Segments of 1 to 60 rows at uneven times, and wandering positions."""
    rng = np.random.default_rng(seed)
    sizes = rng.integers(1, 60, tracks)
    segment = np.repeat(np.arange(tracks), sizes)
    time_s = np.concatenate([np.sort(rng.choice(3000, size, replace=False)) * 0.1 for size in sizes])
    return segment, time_s, rng.normal(0, 5, (len(segment), 2)).cumsum(axis=0)


# ---- fitted velocity -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(5))
def test_fitted_velocity_agrees_with_polyfit_row_by_row(seed):
    segment, time_s, position = irregular_tracks(seed)
    velocity = fitted_velocity(segment, time_s, position)
    for row in range(len(segment)):
        window = (segment == segment[row]) & (np.abs(time_s - time_s[row]) <= WINDOW_S / 2 + 1e-9)
        if window.sum() < 2:
            assert np.isnan(velocity[row]).all()
            continue
        slope = np.polyfit(time_s[window] - time_s[row], position[window], 1)[0]
        np.testing.assert_allclose(velocity[row], slope, atol=1e-6 * max(1, np.abs(slope).max()))


@pytest.mark.parametrize("offset_s", [0.0, 1e6])
def test_fitted_velocity_does_not_depend_on_when_or_where(offset_s):
    segment, time_s, position = irregular_tracks(9)
    np.testing.assert_allclose(
        fitted_velocity(segment, time_s + offset_s, position + np.array([1e6, -1e5])),
        fitted_velocity(segment, time_s, position),
        atol=1e-3,
    )


# ---- holding and limiting ------------------------------------------------------------------------------------------


@settings(max_examples=60)
@given(st.integers(0, 2**32 - 1))
def test_held_headings_agree_with_a_loop(seed):
    rng = np.random.default_rng(seed)
    vehicle = np.sort(rng.integers(0, 6, 40))
    velocity = rng.normal(0, 2, (40, 2))
    heading, _ = held_heading(vehicle, velocity)
    for row in range(40):
        own = np.flatnonzero((vehicle == vehicle[row]) & (np.hypot(*velocity.T) >= 2))
        before, after = own[own <= row], own[own > row]
        source = before[-1] if len(before) else after[0] if len(after) else None
        assert heading[row] == (0.0 if source is None else np.arctan2(velocity[source, 1], velocity[source, 0]))


def test_lane_changes_last_three_seconds_either_way_and_stay_with_their_vehicle():
    vehicle = np.repeat([1, 2], 100)
    time_s = np.tile(np.arange(100) * 0.1, 2)
    lane = np.where((vehicle == 1) & (time_s >= 5.0), 2, 1)
    changing = lane_changing(vehicle, time_s, lane)
    assert not changing[100:].any()
    np.testing.assert_allclose(time_s[:100][changing[:100]][[0, -1]], [1.9, 8.0])


# ---- rows ----------------------------------------------------------------------------------------------------------


# ---- overlaps ------------------------------------------------------------------------------------------------------


def frame_of(centre, size, heading):
    n = len(centre)
    return Vehicles(
        frame=0,
        time_s=0.0,
        vehicle_id=np.arange(n),
        class_index=np.zeros(n, dtype=np.int8),
        centre_m=np.column_stack([centre, np.ones(n)]),
        size_m=np.column_stack([size, np.full(n, 2.0)]),
        heading_rad=np.asarray(heading, dtype=float),
        lane=np.zeros(n, dtype=np.int16),
    )


def test_boxes_that_only_touch_or_only_cross_by_their_corners_circles_do_not_overlap():
    apart = frame_of([[0, 0], [4.0, 0], [0, 2.5]], [[4, 2], [4, 2], [4, 2]], [0, 0, 0])
    assert len(overlapping_pairs(apart)) == 0
    beside = frame_of([[0, 0], [3.0, 1.8]], [[4, 2], [4, 2]], [0, 0])
    assert overlapping_pairs(beside).tolist() == [[0, 1]]
    turned = frame_of([[0, 0], [2.9, 1.9]], [[4, 2], [1, 1]], [0, np.pi / 4])
    assert len(overlapping_pairs(turned)) == 0
    assert len(overlapping_pairs(frame_of(np.zeros((0, 2)), np.zeros((0, 2)), []))) == 0


@settings(max_examples=60)
@given(st.integers(0, 2**32 - 1))
def test_overlaps_agree_with_points_sampled_in_the_boxes(seed):
    """A point of one box inside the other proves an overlap; pairs that share no point of a fine grid barely touch."""
    rng = np.random.default_rng(seed)
    centre, heading = rng.uniform(-6, 6, (5, 2)), rng.uniform(-np.pi, np.pi, 5)
    size = rng.uniform([3.0, 1.5], [8.0, 2.5], (5, 2))
    found = {tuple(pair) for pair in overlapping_pairs(frame_of(centre, size, heading)).tolist()}
    grid = np.stack(np.meshgrid(np.linspace(-0.5, 0.5, 60), np.linspace(-0.5, 0.5, 60)), axis=-1).reshape(-1, 2)
    shrunk = {tuple(pair) for pair in overlapping_pairs(frame_of(centre, size - 0.5, heading)).tolist()}
    for i in range(5):
        turn = np.array([[np.cos(heading[i]), np.sin(heading[i])], [-np.sin(heading[i]), np.cos(heading[i])]])
        points = centre[i] + (grid * (size[i] - 0.06)) @ turn
        for j in range(5):
            if i == j:
                continue
            offset = points - centre[j]
            along = offset @ [np.cos(heading[j]), np.sin(heading[j])]
            across = offset @ [-np.sin(heading[j]), np.cos(heading[j])]
            half = size[j] / 2 - 0.03  # boxes that overlap by 2 cm touch
            inside = ((np.abs(along) < half[0]) & (np.abs(across) < half[1])).any()
            pair = (min(i, j), max(i, j))
            if inside:
                assert pair in found
            elif pair in shrunk:
                pytest.fail("boxes that overlap by half a metre share a point of the grid")
