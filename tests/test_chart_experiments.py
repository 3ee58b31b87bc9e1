"""What the chart switches on and off: motion during a turn, and every ablation of a scene."""

from __future__ import annotations

import pickle
from dataclasses import replace

import numpy as np
import pytest

from blender_lidar.casting.protocol import Revolution
from blender_lidar.scene.mounting import Mast, Mounting
from blender_lidar.scene.observation import CountedFrame
from blender_lidar.scene.scenario import load_scenario
from blender_lidar.scene.site import prepare
from blender_lidar.scoring.frame_scorer import FrameScorer, singles
from blender_lidar.sensors.model import load_model
from blender_lidar.studies.driver import Job, landscapes
from blender_lidar.studies.motion import (
    SECTORS,
    MovingScorer,
    moved,
    recorded_velocity,
    sector_times,
    sectors,
    velocity_at,
)
from blender_lidar.studies.variations import ablations, without_offsets
from tests.sample_traffic import dense_traffic
from tests.small_scene import MAPPED, traffic_rows, write_scene, write_table

LAYOUTS = ((Mounting(height_m=3.0, tilt_x=0.25),), (Mounting(Mast((1.0, -0.5, 0.0)), 4.4, 0.1, 0.05, 0.2),))
POSES = [mounting.pose for (mounting,) in LAYOUTS]


@pytest.fixture(scope="module")
def frame():
    """Lorries hide cars; every third vehicle does not count."""
    vehicles = dense_traffic(seed=3, vehicles=8, length_m=30.0)
    return CountedFrame(vehicles, np.arange(len(vehicles)) % 3 > 0)


def assert_same(one, other):
    np.testing.assert_array_equal(one.points, other.points)
    np.testing.assert_allclose(one.occupancy, other.occupancy, rtol=1e-12)


# --- motion -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("boxes_move", [True, False])
@pytest.mark.parametrize("also", ["", "a barrier", "noise and drop-out"])
def test_vehicles_that_stand_are_seen_as_in_an_instant(site, frame, boxes_move, also):
    if also == "a barrier":
        ((_, there),) = next(one for one in ablations(site, 1) if one.what == "median barrier").pairs
        site = there.changed(site)
    imperfections = replace(site.observation.lidar.imperfections, dropout=0.1, range_noise_m=0.02)
    changes = {"imperfections": imperfections} if "noise" in also else {}
    observation = site.observation.with_lidar(max_range_m=50.0, **changes)
    standing = MovingScorer(frame, observation, np.zeros((len(frame.vehicles), 2)), boxes_move=boxes_move)
    expected = FrameScorer(frame.vehicles, frame.counted, observation).see(singles(POSES))
    assert expected.points.sum() > 100
    assert_same(standing.see(singles(POSES)), expected)


def test_a_sector_sees_vehicles_where_they_are_at_its_time(site, frame):
    """Of a frame in which everything moves, a sector's returns are those of a frame that stands where all then are."""
    observation = site.observation.with_lidar(max_range_m=50.0)
    velocity = velocity_at(frame.vehicles, 25.0)
    late_s, sector = sector_times(observation.lattice), sectors(observation.lattice)
    expected = []
    for number in range(SECTORS):
        there = moved(frame.vehicles, velocity, late_s[number])
        standing = FrameScorer(there, frame.counted, observation)
        ((met,),) = standing._revolutions(singles(POSES[:1]))
        ours = sector[met.beam] == number
        met = Revolution(*(column[..., ours] for column in met))
        expected.append(standing.returns_of(POSES[0], met)[0])
    found = MovingScorer(frame, observation, velocity).see(singles(POSES[:1]), keep_returns=True).returns[0]
    expected = np.concatenate(expected)
    assert len(found) > 200
    by_place = [points[np.lexsort(points.round(6).T)] for points in (found, expected)]
    np.testing.assert_allclose(*by_place, atol=1e-9)


def test_sectors_follow_the_columns_time_and_lie_about_the_middle_of_the_turn(site):
    lattice = site.observation.lattice
    ring, slot = np.divmod(np.arange(lattice.rings * lattice.columns), lattice.columns)
    column_s = lattice.column(ring, slot) / (lattice.columns * lattice.rotation_hz)
    middle = sector_times(lattice)[sectors(lattice)] + 0.5 / lattice.rotation_hz
    assert np.abs(middle - column_s).max() <= 0.5 / SECTORS / lattice.rotation_hz + 1e-4
    assert sector_times(lattice).sum() == pytest.approx(0.0)


def test_boxes_left_at_mid_turn_hold_the_same_returns_elsewhere(site, frame):
    observation = site.observation.with_lidar(max_range_m=50.0)
    velocity = velocity_at(frame.vehicles, 25.0)
    with_boxes, without = (
        MovingScorer(frame, observation, velocity, boxes_move=boxes).see(singles(POSES[:1]), keep_returns=True)
        for boxes in (True, False)
    )
    np.testing.assert_array_equal(with_boxes.points, without.points)
    away = np.abs(with_boxes.returns[0] - without.returns[0])
    assert 0.1 < away.max() <= 25.0 * 0.5 / observation.lattice.rotation_hz + 1e-9


def test_velocities_are_those_that_the_recording_was_made_with(tmp_path):
    """Vehicles at 10 m/s; read from frames 0.5 s apart, and nothing is known from frames 2 s apart."""
    rows = [
        [frame, number, "car", 10.0 * time_s - 4.0, y, 4.4, 1.8, 1.5, 0.0, time_s]
        for frame, time_s in enumerate((0.0, 0.5, 1.0, 3.0))
        for number, y in ((1, 3.7), (2, 7.2))
    ]
    write_table(tmp_path / "traffic.csv", rows)
    recording = prepare(load_scenario(write_scene(tmp_path, {"traffic": {"frames": 1, "holdout": 0.0}}))).recording
    for frame in (0, 1, 2):
        velocity = recorded_velocity(recording, recording.vehicles(frame))
        np.testing.assert_allclose(velocity, [[10.0, 0.0]] * 2, atol=1e-9)
    assert not recorded_velocity(recording, recording.vehicles(3)).any()


# --- ablations --------------------------------------------------------------------------------------------------------


def test_every_ablation_can_be_sent_to_a_worker_and_has_a_name_of_its_own(site):
    changes = ablations(site, 3)
    sides = {one.stage: one for change in changes for pair in change.pairs for one in pair}
    assert len({(change.what, change.value) for change in changes}) == len(changes)
    assert [one.stage for one in pickle.loads(pickle.dumps(list(sides.values())))] == list(sides)
    wanted = "median barrier, body shape, finer shape, glass drop-out, azimuth offsets, range noise, drop-out"
    wanted += ", weak returns, unit spread, motion in a turn"
    assert {change.what for change in changes} >= set(wanted.split(", "))


def test_ablations_change_scores(site):
    """At 20 m from two lanes weak returns need not matter, and frames here are too far apart to tell a speed."""
    for change in ablations(site, 1):
        if change.pairs and change.what != "weak returns" and not change.value.startswith("recorded"):
            both = [next(landscapes(site, [Job(one, LAYOUTS)])).objective for one in change.pairs[0]]
            assert not np.allclose(*both, rtol=1e-9), change


def test_offsets_left_out_are_all_0_and_the_other_rings_keep_their_beams(tmp_path):
    settings = {**MAPPED, "sensor": {"name": "RS-80", "rotation_hz": 10.0}}
    site = prepare(load_scenario(write_scene(tmp_path, settings)))
    assert load_model("RS-80").azimuth_offset_rad.any()
    level = without_offsets(site).observation.lattice
    assert not level.slot_azimuth0_rad.any()
    assert not level.shift.any()
    np.testing.assert_array_equal(level.elevation_rad, site.observation.lattice.elevation_rad)
    assert level.columns == site.observation.lattice.columns
    assert all(one.pairs for one in ablations(site, 1))


def test_a_sensor_without_offsets_says_so(site):
    (change,) = (one for one in ablations(site, 2) if one.what == "azimuth offsets")
    assert (change.pairs, change.note) == ((), "the beam table of the RS-16 has none")


def test_a_sensor_that_is_imperfect_at_random_is_drawn_several_times_and_no_other_is(site):
    changes = {one.what: one for one in ablations(site, 3)}
    drawn = {what for what, change in changes.items() if len(change.pairs) == 3}
    assert drawn == {"glass drop-out", "range noise", "drop-out", "unit spread"}
    assert all(len(change.pairs) == 1 for what, change in changes.items() if what not in {*drawn, "azimuth offsets"})
    for what in drawn:
        perfect, imperfect = zip(*changes[what].pairs, strict=True)
        assert len({one.stage for one in perfect}) == 1
        scores = [next(landscapes(site, [Job(one, LAYOUTS)])).objective for one in imperfect]
        assert not np.allclose(scores[0], scores[1])


@pytest.mark.parametrize("key", ["glass_dropout", "dropout"])
def test_what_the_scene_has_is_left_out_once_and_both_sides_draw_the_same(key, tmp_path):
    write_table(tmp_path / "traffic.csv", traffic_rows())
    noisy = prepare(load_scenario(write_scene(tmp_path, {**MAPPED, "sensor": {key: 0.2, "unit_spread_deg": 0.1}})))
    changes = ablations(noisy, 2)
    assert len({(one.what, one.value) for one in changes}) == len(changes)
    ours = [one for one in changes if one.value == "0.2, as the scene has it"]
    assert len(ours) == 1
    for draw, (without, having) in enumerate(ours[0].pairs, start=1):
        left_out, there = (one.changed(noisy) for one in (without, having))
        assert (left_out.scenario.sensor.unit_spread_deg, left_out.observation.lidar.imperfections.seed) == (0.1, draw)
        assert getattr(left_out.observation.lidar.imperfections, key) == 0.0
        assert getattr(there.observation.lidar.imperfections, key) == 0.2
        assert there.observation.lidar.imperfections.seed == draw
    spread = next(one for one in changes if one.what == "unit spread")
    assert [one.stage for _, one in spread.pairs] == [one.stage for _, one in ours[0].pairs]
