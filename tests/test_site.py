"""A site: which vehicles judge a mounting, and what its coordinates mean."""

from __future__ import annotations

import math

import numpy as np

from blender_lidar.scene import site as site_module
from blender_lidar.scene.scenario import load_scenario
from blender_lidar.scene.site import prepare, read_recordings
from tests.small_scene import FRAME_STEP_S, mounting, traffic_rows, write_scene, write_table

STANDING = 999


def test_a_vehicle_that_was_counted_in_the_search_never_judges_but_still_hides_others(tmp_path):
    """One that breaks down beside the lanes is seen in searched and held-out frames alike."""
    rows = traffic_rows()
    broken_down = [[n, STANDING, "car", 8.0, 10.5, 4.4, 1.8, 1.5, 0.0, FRAME_STEP_S * n] for n in range(60)]
    write_table(tmp_path / "traffic.csv", sorted(rows + broken_down, key=lambda row: row[0]))
    site = prepare(load_scenario(write_scene(tmp_path, {"traffic": {"block_s": 10.0}})))
    assert len(site.holdout) > 2
    for frame in site.search:
        assert frame.counted[frame.vehicles.vehicle_id == STANDING].tolist() == [True]
    for frame in site.holdout:
        assert frame.counted[frame.vehicles.vehicle_id == STANDING].tolist() == [False]
    searched, judging = (
        np.unique(np.concatenate([frame.vehicles.vehicle_id[frame.counted] for frame in frames]))
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
    monkeypatch.setattr(site_module, "read_traffic", None)
    again = prepare(scenario, recordings=recordings)
    assert again.identity == site.identity
    for one, other in zip((*site.search, *site.holdout), (*again.search, *again.holdout), strict=True):
        np.testing.assert_array_equal(one.vehicles.centre_m, other.vehicles.centre_m)
        np.testing.assert_array_equal(one.counted, other.counted)
