"""The clock of a recording: its instants as they were recorded, what lies between two, and nothing in gaps."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from blender_lidar.traffic import Recording, RepairReport, joined_recordings

COLUMNS = ("vehicle_id", "class_index", "centre_m", "size_m", "heading_rad", "lane", "body")


def recording(rows, step_s=0.5, begin_s=100.0):
    """Boxes (frame, vehicle, x, heading in degrees); numbers and sizes say which vehicle one is."""
    frame, vehicle, x, heading = np.array(rows, dtype=float).T
    return Recording.from_rows(
        frame=frame,
        time_s=begin_s + step_s * frame,
        time_step_s=step_s,
        source="made",
        report=RepairReport(),
        vehicle_id=vehicle,
        class_index=vehicle % 4,
        centre_m=np.column_stack([x, vehicle, np.ones(len(x))]),
        size_m=np.column_stack([4.0 + vehicle, np.full(len(x), 2.0), np.full(len(x), 1.5)]),
        heading_rad=np.radians(heading),
        lane=vehicle,
        body=vehicle % 3,
    )


# Vehicle 1 turns across 180 degrees and leaves a gap of two instants, 2 is there once, 3 comes in the second instant.
ROWS = [(0, 1, 0, 170), (0, 2, 5, 0), (1, 1, 4, -170), (1, 3, 9, 0), (2, 1, 6, -160), (2, 3, 8, 10), (5, 1, 20, 0)]
MADE = recording(ROWS)


@given(st.sampled_from([0, 1, 2, 5]), st.floats(-9e-4, 9e-4))
def test_at_an_instant_its_rows_come_back_bit_for_bit(frame, off_s):
    found, there = MADE.moment(0.5 * frame + off_s), MADE.at(frame)
    assert (found.frame, found.time_s) == (frame, there.time_s)
    for name in COLUMNS:
        np.testing.assert_array_equal(getattr(found, name), getattr(there, name))


@given(st.floats(0.01, 0.99))
def test_between_two_instants_vehicles_that_are_in_both_move_evenly_and_turn_the_shorter_way(part):
    found = MADE.moment(0.5 * part)
    assert found.vehicle_id.tolist() == [1]
    assert found.centre_m[0] == pytest.approx([4.0 * part, 1.0, 1.0])
    assert np.cos(found.heading_rad[0] - np.radians(170 + 20 * part)) == pytest.approx(1.0)
    assert abs(found.heading_rad[0]) <= np.pi
    assert (found.size_m[0, 0], found.lane[0], found.body[0], found.class_index[0]) == (5.0, 1, 1, 1)
    assert found.frame == (0 if part <= 0.5 else 1)
    assert found.time_s == pytest.approx(100.0 + 0.5 * part)
    assert MADE.moment(0.5 + 0.5 * part).vehicle_id.tolist() == [1, 3]


@pytest.mark.parametrize("since_s", [-5.0, -0.002, 1.002, 1.8, 2.498, 2.502, 1e6])
def test_in_a_gap_before_the_beginning_and_after_the_end_there_is_nothing(since_s):
    found = MADE.moment(since_s)
    assert len(found) == 0
    assert found.time_s == pytest.approx(100.0 + since_s)
    assert found.frame == MADE.frames[abs(MADE.since_s - since_s).argmin()]


def test_noise_is_an_instants_own_and_another_at_each_moment_between():
    draws = [MADE.moment(since_s).draw for since_s in (-0.3, 0.0, 0.1, 0.2, 0.3, 0.5, 0.6, 0.8, 1.0, 1.7, 2.4)]
    assert len({*draws}) == len(draws)
    assert [draws[row] for row in (1, 5, 8)] == [0, 1, 2]
    assert MADE.moment(0.2).select([]).draw == draws[3]


def test_what_is_moved_is_never_the_recording():
    before = MADE.centre_m.copy(), MADE.heading_rad.copy()
    MADE.moment(0.25).centre_m[:] = 0.0
    np.testing.assert_array_equal(MADE.centre_m, before[0])
    np.testing.assert_array_equal(MADE.heading_rad, before[1])


@pytest.mark.parametrize(("step_s", "joined"), [(0.1, True), (1.0, True), (1.01, False), (2.0, False)])
def test_instants_more_than_a_second_apart_are_not_joined(step_s, joined):
    found = recording(ROWS, step_s).moment(0.4 * step_s)
    assert found.vehicle_id.tolist() == ([1] if joined else [])


def test_of_several_recordings_one_plays_after_the_other_whatever_their_own_times():
    one, other = recording(ROWS), recording(ROWS, begin_s=100.0)
    both = joined_recordings([one, other], ["one", "other"])
    assert (np.diff(both.since_s) > 0.0).all()
    np.testing.assert_allclose(both.since_s, [0.0, 0.5, 1.0, 2.5, 7.5, 8.0, 8.5, 10.0])
    found = both.moment(7.75)
    np.testing.assert_array_equal(found.centre_m, one.moment(0.25).centre_m)
    assert found.time_s == pytest.approx(100.25)
    assert len(both.moment(5.0)) == 0


def test_a_single_instant_and_one_vehicle_are_a_recording_too():
    made = recording(ROWS[:1])
    assert len(made.moment(0.0)) == 1
    assert len(made.moment(0.1)) == len(made.moment(-0.1)) == 0
