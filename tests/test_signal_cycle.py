"""The cycle of a signal is found where queues keep its time, and nowhere else; blocks are then not shorter than it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from blender_lidar.scene.region import region_of
from blender_lidar.scene.scenario import load_scenario
from blender_lidar.scene.site import read_recordings
from blender_lidar.traffic import RepairReport, plan_frames
from blender_lidar.traffic.cycle import signal_cycle_s
from blender_lidar.traffic.vehicles import Recording

SPEED_M_S, GAP_M, HEADWAY_S = 12.0, 7.0, 2.0


def everywhere(vehicles):
    return np.abs(vehicles.centre_m[:, :2]).max(axis=1) <= 60.0


def queue(rng, length_s, is_green, per_s, heading_rad, first_id):
    """Rows (time, id, x, y, heading) of one lane, each second: a point queue before a stop line 5 m before the origin.

    Vehicles arrive at random, stand one behind the other, and leave two seconds apart while `is_green`.
    """
    arrival = np.cumsum(rng.exponential(1.0 / per_s, int(2 * per_s * length_s)))
    leaves, free_s = [], 0.0
    for time_s in arrival:
        free_s = max(free_s + HEADWAY_S, time_s)
        while not is_green(free_s):
            free_s += 0.5
        leaves.append(free_s)
    rows, leaves = [], np.array(leaves)
    for number, (came, left) in enumerate(zip(arrival, leaves, strict=True)):
        for time_s in np.arange(np.ceil(came - 5.0), min(left + 5.0, length_s)):
            ahead = int((leaves[:number] > max(time_s, came)).sum())
            along = -5.0 - GAP_M * ahead if came <= time_s < left else -5.0 + SPEED_M_S * (time_s - came)
            along = -5.0 + SPEED_M_S * (time_s - left) if time_s >= left else along
            place = along * np.array([np.cos(heading_rad), np.sin(heading_rad)])
            rows.append((time_s, first_id + number, *place, heading_rad))
    return [row for row in rows if row[0] >= 0.0]


def recording_of(rows, step_s=1.0):
    time_s, number, x, y, heading = np.array([row for row in rows if row[0] % step_s == 0.0]).T
    n = len(time_s)
    return Recording.from_rows(
        frame=time_s.astype(int),
        time_s=time_s,
        vehicle_id=number,
        class_index=np.zeros(n),
        centre_m=np.column_stack([x, y, np.full(n, 0.75)]),
        size_m=np.tile([4.5, 1.9, 1.5], (n, 1)),
        heading_rad=heading,
        lane=np.ones(n),
        time_step_s=1.0,
        source="queue",
        report=RepairReport(),
    )


def crossing(cycle_s, length_s=600, seed=1):
    """Two roads that are green in turn, as long each."""
    rng, rows = np.random.default_rng(seed), []
    for arm, heading in enumerate((0.0, 0.5 * np.pi)):

        def is_green(time_s, arm=arm):
            return (time_s + 0.5 * arm * cycle_s) % cycle_s < 0.45 * cycle_s

        rows += queue(rng, length_s, is_green, 0.15, heading, 10_000 * arm)
    return rows


@pytest.mark.parametrize("cycle_s", [60, 90, 120])
@pytest.mark.parametrize("step_s", [1.0, 5.0])
def test_a_signals_cycle_is_found_within_5_percent(cycle_s, step_s):
    recording = recording_of(crossing(cycle_s), step_s)
    found, queues = signal_cycle_s(recording, recording.frames, everywhere)
    assert found == pytest.approx(cycle_s, rel=0.05)
    assert queues


def test_arms_that_are_green_in_turn_are_not_taken_for_half_a_cycle():
    recording = recording_of(crossing(100))
    assert signal_cycle_s(recording, recording.frames, everywhere)[0] == pytest.approx(100, rel=0.05)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_queues_that_keep_no_time_have_no_cycle(seed):
    rng = np.random.default_rng(seed)
    ends = np.cumsum(rng.uniform(20.0, 100.0, 60))
    rows = queue(rng, 900, lambda time_s: np.searchsorted(ends, time_s) % 2 == 0, 0.15, 0.0, 0)
    recording = recording_of(rows)
    assert signal_cycle_s(recording, recording.frames, everywhere) == (None, True)


def test_traffic_that_never_stands_has_no_cycle():
    rows = queue(np.random.default_rng(1), 600, lambda time_s: True, 0.15, 0.0, 0)
    recording = recording_of(rows)
    assert signal_cycle_s(recording, recording.frames, everywhere) == (None, False)


def test_the_shipped_motorway_has_no_cycle():
    scenario = load_scenario(Path(__file__).parents[1] / "scenes" / "i80.toml")
    (recording,), region = read_recordings(scenario), region_of(scenario.region, scenario.road_map)
    assert signal_cycle_s(recording, recording.frames, region.holds)[0] is None


def test_blocks_are_not_shorter_than_the_cycle_and_a_note_says_so():
    plan = plan_frames(recording_of(crossing(90, length_s=1800)), everywhere)
    assert 90 <= plan.block_s <= 95
    (note,) = (note for note in plan.notes if note.startswith("blocks of"))
    assert note.startswith(
        f"blocks of {plan.block_s:.0f} s: at least a signal's cycle (90 s, found in the traffic) and "
    )


def test_frames_meet_all_of_a_cycle():
    """Thirty of 1,800 s are 60 s apart, half a cycle, which alone would meet two moments of it."""
    recording = recording_of(crossing(120, length_s=1800))
    plan = plan_frames(recording, everywhere, holdout=0.0)
    assert len(plan.search) == 30
    assert np.unique(plan.search % 120 // 15).size == 8


def test_no_frame_is_drawn_twice_where_nearly_all_are_drawn():
    plan = plan_frames(recording_of(crossing(60, length_s=400), step_s=10.0), everywhere, count=30, holdout=0.0)
    assert np.unique(plan.search).size == len(plan.search) == 30


def test_blocks_that_are_given_too_short_for_a_signal_are_told():
    plan = plan_frames(recording_of(crossing(90)), everywhere, block_s=30.0)
    assert any(note.startswith("blocks of 30 s may make intervals too narrow") for note in plan.notes)


def test_a_recording_too_short_to_know_a_cycle_says_so():
    notes = plan_frames(recording_of(crossing(90, length_s=300)), everywhere).notes
    assert any(note.startswith("queues come and go, and 2") for note in notes)
