"""NGSIM's known defects, made on purpose: what is repaired, reported, must be chosen; and the arithmetic behind it."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from blender_lidar.errors import InputError
from blender_lidar.traffic import Boxes, overlapping_pairs, read_traffic
from blender_lidar.traffic.tracks import (
    WINDOW_S,
    fitted_velocity,
    held_heading,
    lane_changing,
)
from tests import traffic_samples as samples

FOOT_M = 0.3048


def read(tmp_path, columns, **settings):
    return read_traffic(samples.write(tmp_path, samples.native(columns)), **settings)


def changed(columns, row, **values):
    """One row again, with other values."""
    again = samples.picked(columns, np.array([row]))
    return again | {name: np.array([value]) for name, value in values.items()}


# ---- periods -------------------------------------------------------------------------------------------------------


@pytest.fixture
def three_periods():
    return samples.joined(
        samples.columns(vehicles=7, seed=1),
        samples.columns(vehicles=8, seed=2, origin_ms=samples.P2_ORIGIN_MS),
        samples.columns(vehicles=9, seed=3, origin_ms=samples.P3_ORIGIN_MS),
    )


def test_periods_are_never_merged_and_the_first_is_used_unless_chosen(tmp_path, three_periods):
    recording = read(tmp_path, three_periods)
    assert recording.report.periods == ("0400-0415", "0500-0515", "0515-0530")
    assert (recording.report.period, len(np.unique(recording.vehicle_id))) == ("0400-0415", 7)
    assert any("3 periods found" in line for line in recording.report.lines())
    assert recording.report.repeated == recording.report.duplicates == 0


@pytest.mark.parametrize("period", [3, "3", "0515-0530", "05:15-05:30"])
def test_a_period_is_chosen_by_number_or_name(tmp_path, three_periods, period):
    recording = read(tmp_path, three_periods, period=period)
    alone = read(tmp_path, samples.columns(vehicles=9, seed=3, origin_ms=samples.P3_ORIGIN_MS))
    np.testing.assert_array_equal(recording.centre_m, alone.centre_m)
    assert recording.report.period == alone.report.period == "0515-0530"
    assert not recording.report.notes


def test_periods_that_overlap_in_time_are_told_apart_by_their_clocks(tmp_path):
    late_in_p2 = samples.columns(vehicles=3, first_frame=9000, origin_ms=samples.P2_ORIGIN_MS)
    early_in_p3 = samples.columns(vehicles=3, first_frame=1020, origin_ms=samples.P3_ORIGIN_MS)
    assert set(late_in_p2["Global_Time"]) & set(early_in_p3["Global_Time"])
    both = samples.joined(early_in_p3, late_in_p2)
    assert read(tmp_path, both).frames[0] == 9000
    assert read(tmp_path, both, period=2).frames[0] == 1020


def test_times_without_a_date_get_numbers_for_names(tmp_path):
    """Peachtree's Global_Time has ten digits."""
    columns = samples.joined(
        samples.columns(origin_ms=1_163_030_300), samples.columns(origin_ms=1_163_030_300 + 11_000_000)
    )
    assert read(tmp_path, columns).report.periods == ("1", "2")


@pytest.mark.parametrize("step_ms", [1e-3, 0.1, 1e5])
def test_a_clock_in_other_units_is_refused(tmp_path, step_ms):
    columns = samples.columns(vehicles=3, frames=4)
    columns["Global_Time"] = step_ms * columns["Frame_ID"]
    with pytest.raises(InputError, match=rf"Global_Time grows by {step_ms:g} ms from one Frame_ID to the next"):
        read(tmp_path, columns)


def test_unknown_period_names_the_known_ones(tmp_path, three_periods):
    with pytest.raises(InputError, match=r"recording.txt: no period 4; .*1 \(0400-0415\), 2 \(0500-0515\), 3"):
        read(tmp_path, three_periods, period=4)
    with pytest.raises(InputError, match=r"no period '0750-0805'"):
        read(tmp_path, three_periods, period="0750-0805")


# ---- locations -----------------------------------------------------------------------------------------------------


@pytest.fixture
def mixed_sites(tmp_path):
    path = tmp_path / "portal.csv"
    body = samples.portal(samples.columns(vehicles=4, seed=5), "us-101", header=False)
    path.write_text(samples.portal(samples.columns(vehicles=3, seed=6), "i-80") + body, encoding="utf-8", newline="")
    return path


def test_of_several_locations_one_must_be_chosen(mixed_sites):
    with pytest.raises(InputError, match=r"portal.csv: holds 2 locations; choose one of: i-80, us-101"):
        read_traffic(mixed_sites)
    recording = read_traffic(mixed_sites, location="US-101")
    assert (len(np.unique(recording.vehicle_id)), recording.report.location) == (4, "us-101")
    assert recording.report.rows_read == 7 * 120
    assert "location us-101" in recording.report.lines()[0]


# ---- rows ----------------------------------------------------------------------------------------------------------


def test_exact_duplicates_and_contradicting_rows_are_dropped_and_counted_apart(tmp_path):
    columns = samples.columns()
    clean = read(tmp_path, columns)
    spoilt = samples.joined(
        columns,
        samples.picked(columns, np.arange(0, 200, 2)),
        changed(columns, 7, Local_X=30.0),
        changed(columns, 8, v_Length=99.0),
    )
    recording = read(tmp_path, spoilt)
    assert (recording.report.duplicates, recording.report.repeated) == (100, 2)
    np.testing.assert_array_equal(recording.centre_m, clean.centre_m)


def test_rows_far_off_the_map_are_dropped_and_counted(tmp_path):
    columns = samples.columns()
    columns["Local_Y"][5] = 1e7
    columns["Local_X"][700] = -1e6
    recording = read(tmp_path, columns)
    assert recording.report.off_map == 2
    columns["Local_Y"][:] = 1e7
    with pytest.raises(InputError, match="no vehicles left"):
        read(tmp_path, columns)


def test_headings_are_held_while_a_vehicle_stands(tmp_path):
    columns = samples.columns(vehicles=2, frames=600)
    t = (columns["Frame_ID"] - 100) * 0.1
    moved = np.minimum(t, 20) + np.maximum(t - 40, 0)  # stands from 20 s to 40 s, then leaves in another direction
    noise = np.random.default_rng(0).normal(0, 0.3, len(t))
    columns["Local_Y"] = 100 + 20 * moved + noise
    columns["Local_X"] = 30 - 1.0 * np.minimum(t, 20) + 1.0 * np.maximum(t - 40, 0) + noise
    recording = read(tmp_path, columns)
    one = recording.vehicle_id == 1
    heading = recording.heading_rad[one]
    before, after = np.arctan2(1, 20), np.arctan2(-1, 20)
    np.testing.assert_allclose(heading[20:180], before, atol=0.02)
    assert len(np.unique(heading[220:380])) == 1, "one heading throughout the stop"
    assert 0.2 * before < heading[300] < np.radians(6) + 1e-9
    np.testing.assert_allclose(heading[-180:-20], after, atol=0.02)
    assert 2 * 160 <= recording.report.headings_held <= 2 * 200


def test_a_vehicle_that_never_moves_points_along_the_road(tmp_path):
    columns = samples.columns(vehicles=6)
    columns["Local_Y"] = 300 + np.random.default_rng(0).normal(0, 0.5, len(columns["Local_Y"]))
    recording = read(tmp_path, columns)
    assert (recording.heading_rad == 0).all()
    assert recording.report.headings_held == len(recording)


def test_headings_are_limited_more_tightly_away_from_lane_changes(tmp_path):
    columns = samples.columns(vehicles=1, frames=300)
    t = (columns["Frame_ID"] - 100) * 0.1
    columns["Local_Y"] = 100 + 20 * t
    columns["Local_X"] = 60 - 20 * np.tan(np.radians(10)) * t
    recording = read(tmp_path, columns)
    np.testing.assert_allclose(recording.heading_rad, np.radians(6))
    assert recording.report.headings_clamped == 300
    columns["Lane_ID"] = np.where(t < 15, 5, 4)
    heading = read(tmp_path, columns).heading_rad
    np.testing.assert_allclose(heading[np.abs(t - 15) < 2.9], np.radians(10), atol=1e-6)
    np.testing.assert_allclose(heading[np.abs(t - 15) > 3.2], np.radians(6))


def test_absurd_sizes_are_brought_into_range_and_missing_ones_get_the_default(tmp_path):
    columns = samples.columns(vehicles=8, frames=2)
    number = columns["Vehicle_ID"] - 1
    columns["v_Class"] = np.array([2, 2, 2, 3, 3, 1, 1, 2])[number]
    columns["v_Length"] = np.array([3.0, 60.0, 0.0, 200.0, 0.0, 5.9, 0.0, 14.5])[number]
    columns["v_Width"] = np.array([6.0, 20.0, 0.0, 8.5, 0.0, 5.1, 2.5, 6.8])[number]
    recording = read(tmp_path, columns)
    length, width = recording.at(100).size_m[:, :2].T
    np.testing.assert_allclose(length, [2.5, 7.0, 4.5, 25.0, 12.7, 5.9 * FOOT_M, 2.1, 14.5 * FOOT_M])
    np.testing.assert_allclose(width, [6 * FOOT_M, 2.6, 2.05, 8.5 * FOOT_M, 2.59, 0.8, 2.5 * FOOT_M, 6.8 * FOOT_M])
    assert recording.report.sizes_repaired == 7, "vehicles, not rows"


def test_overlaps_are_reported_and_left_alone(tmp_path):
    columns = samples.columns(vehicles=12)
    clean = read(tmp_path, columns)
    assert clean.report.overlaps == 0
    columns["Local_X"][columns["Vehicle_ID"] == 2] = 8.0  # two feet beside vehicle 1
    columns["Local_Y"][columns["Vehicle_ID"] == 2] = columns["Local_Y"][columns["Vehicle_ID"] == 1]
    recording = read(tmp_path, columns)
    assert recording.report.overlaps == recording.report.overlap_frames == 60
    assert len(recording) == len(clean)


# --- the arithmetic behind the boxes, on arrays -----------------------------------------------------------------------


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
    return Boxes(
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
