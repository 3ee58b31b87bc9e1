"""Real recordings are read and make physical sense."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from blender_lidar.road.straight import StraightRoad, road_map
from blender_lidar.traffic import CLASSES, plan_frames, read_traffic

DATA = Path(__file__).parents[2] / "shared" / "data" / "ngsim"
pytestmark = pytest.mark.skipif(not DATA.is_dir(), reason="the NGSIM excerpts of ../shared/data are not here")

SUMO = "SYNTHETIC_sumo_i80_60s_ngsim18.txt.gz"
LANES_1_TO_3 = "i80_0400-0415_lanes1-3_partial_18col.csv.gz"
VEHICLE_3 = "i80_0515-0530_veh3_raw_99rows.txt"
PEACHTREE = "socrata_export_format_sample_peachtree_200rows.csv"
FOOT_M = 0.3048


@pytest.fixture(scope="module")
def recordings():
    read = {}

    def recording(name):
        if name not in read:
            read[name] = read_traffic(DATA / name)
        return read[name]

    return recording


@pytest.mark.parametrize("name", [SUMO, LANES_1_TO_3])
def test_traffic_flows_forward_in_lanes_from_left_to_right_within_the_carriageway(recordings, name):
    recording = recordings(name)
    by_vehicle = np.lexsort((recording.frame, recording.vehicle_id))
    same = np.diff(recording.vehicle_id[by_vehicle]) == 0
    step = np.diff(recording.frame[by_vehicle])
    moved = np.diff(recording.centre_m[by_vehicle], axis=0)[same & (step == 1)] / recording.time_step_s
    # Centres jerk where a held or limited heading jumps; speeds over a tenth of a second are only roughly sane.
    assert 3.0 < np.mean(moved[:, 0]) < 20.0
    assert np.percentile(moved[:, 0], 1) > -0.5
    assert np.percentile(moved[:, 0], 99.9) < 40.0
    assert abs(np.mean(moved[:, 1])) < 0.5
    past_the_ramp = recording.centre_m[:, 0] > 0
    lanes = np.unique(recording.lane[past_the_ramp & (recording.lane <= 6)])
    lateral = [np.median(recording.centre_m[past_the_ramp & (recording.lane == lane), 1]) for lane in lanes]
    assert len(lanes) >= 3
    np.testing.assert_allclose(np.diff(lateral), -3.66, atol=0.7)
    low, high = road_map(StraightRoad()).edges_t
    assert low < min(lateral)
    assert max(lateral) < high


@pytest.mark.parametrize("name", [SUMO, LANES_1_TO_3])
def test_headings_and_sizes_lie_within_their_ranges(recordings, name):
    recording = recordings(name)
    heading = np.degrees(np.abs(recording.heading_rad))
    assert heading.max() <= 15.0 + 1e-9
    assert (heading <= 6.0 + 1e-9).mean() > 0.95
    assert np.median(heading) < 1.5
    length, width, height = recording.size_m.T
    for number, low, high in ((0, 2.5, 4.9), (1, 4.9, 7.0), (2, 5.0, 25.0), (4, 1.6, 2.8)):
        of_class = recording.class_index == number
        assert (length[of_class] >= low).all(), CLASSES[number]
        assert (length[of_class] <= high).all(), CLASSES[number]
    assert width.min() >= 0.5
    assert width.max() <= 2.6
    assert set(np.unique(height)) <= {1.4, 1.5, 1.9, 3.0, 3.8}
    np.testing.assert_allclose(recording.centre_m[:, 2], height / 2)


def test_the_box_ends_at_the_recorded_front(recordings):
    recording = recordings(VEHICLE_3)
    raw = np.loadtxt(DATA / VEHICLE_3)
    assert recording.frame.tolist() == raw[:, 1].astype(int).tolist()
    direction = np.stack([np.cos(recording.heading_rad), np.sin(recording.heading_rad)], axis=1)
    front = recording.centre_m[:, :2] + recording.size_m[:, :1] / 2 * direction
    road = StraightRoad()
    np.testing.assert_allclose(front[:, 0], raw[:, 5] * FOOT_M - road.station_m, atol=1e-9)
    np.testing.assert_allclose(front[:, 1], road.setback_m + road.right_edge_m - raw[:, 4] * FOOT_M, atol=1e-9)
    assert recording.report.period == "0515-0530"


def test_the_dense_scene_has_its_density_and_classes(recordings):
    recording = recordings(SUMO)
    assert 130 < np.median(recording.counts) < 150
    assert {"car", "van", "truck", "motorcycle"} == set(np.array(CLASSES)[np.unique(recording.class_index)])
    assert (recording.time_step_s, len(recording.frames)) == (0.1, 600)


def test_the_sparse_scene_is_whole(recordings):
    recording = recordings(LANES_1_TO_3)
    assert recording.report.rows_read == recording.report.rows_used == 110_905
    assert (len(np.unique(recording.vehicle_id)), recording.report.period) == (222, "0400-0415")


def test_an_export_of_the_portal_is_read_as_it_comes(recordings):
    recording = recordings(PEACHTREE)
    assert recording.report.location == "peachtree"
    assert recording.report.rows_used + recording.report.duplicates + recording.report.repeated == 200
    assert np.isfinite(recording.centre_m).all()


def test_half_of_the_sparse_scene_can_judge_the_other(recordings):
    recording = recordings(LANES_1_TO_3)

    def counted(vehicles):
        return np.hypot(vehicles.centre_m[:, 0], vehicles.centre_m[:, 1]) <= 60.0

    plan = plan_frames(recording, counted, count=40)
    assert len(plan.search) == 40
    assert plan.holdout_block[-1] >= 4
    assert 5.0 <= plan.block_s <= 60.0
    for frame in plan.holdout:
        vehicles = recording.vehicles(frame)
        assert not np.isin(vehicles.vehicle_id[counted(vehicles)], plan.searched_ids).any()
