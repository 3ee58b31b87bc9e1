"""The scans of a data set: what is drawn, moved and mirrored, and what each sample says of its vehicles."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from blender_lidar.detection import dataset
from blender_lidar.detection.dataset import TRAIN, VAL, plan_dataset, sample, samples
from blender_lidar.scene.mounting import COORDINATES
from blender_lidar.scene.scenario import load_scenario
from blender_lidar.scene.site import prepare
from tests.sample_traffic import scan
from tests.small_scene import mounting, traffic_rows, write_scene, write_table

pytestmark = pytest.mark.versions

REGION = {"region": {"centre_m": [0.0, 0.0], "radius_m": 12.0}, "sensor": {"range_gate_m": 15.0}}
SEARCHED = {"deployment": {"height_m": [2.0, 4.5], "tilt_x_deg": [0.0, 25.0], "x_m": [-2.0, 2.0]}}


def site_of(folder, changes=None):
    write_table(folder / "traffic.csv", traffic_rows(vehicles=150))
    return prepare(load_scenario(write_scene(folder, {**REGION, **SEARCHED, **(changes or {})})))


@pytest.fixture(scope="module")
def plan(tmp_path_factory):
    return plan_dataset(site_of(tmp_path_factory.mktemp("site")), mountings=5, seed=3)


def test_mountings_lie_within_the_bounds_and_what_is_fixed_stays(plan):
    heights, tilts, yaws = np.array(
        [[m.as_table()[k] for m in plan.mounts] for k in ("height_m", "tilt_x_deg", "yaw_deg")]
    )
    assert len(set(heights)) == 5
    assert ((heights >= 2.0) & (heights <= 4.5)).all()
    assert ((tilts >= 0.0) & (tilts <= 25.0)).all()
    assert (yaws == 0.0).all()


def test_by_default_each_frame_is_seen_once_from_each_mounting(plan):
    pairs = {(scan.frame, scan.mounting) for scan in plan.scans}
    assert len(pairs) == len(plan) == 5 * len(plan.frames)


def test_stations_and_sites_differ_and_stay_where_there_is_traffic(plan):
    stations = np.array([scan.station_m for scan in plan.scans])
    assert np.ptp(stations) > 20.0
    assert (np.abs(stations) < 40.0 - 15.0 + 0.01).all()
    assert 0.3 < np.mean([scan.mirrored for scan in plan.scans]) < 0.7


def test_a_region_beside_the_lidar_stays_where_there_is_traffic_when_it_is_mirrored(tmp_path):
    region = {"region": {"centre_m": [9.0, 0.0], "radius_m": 12.0}}
    scans = plan_dataset(site_of(tmp_path, region), mountings=5, seed=3).scans
    middles = [(one.mirrored, one.station_m + (-9.0 if one.mirrored else 9.0)) for one in scans]
    for mirrored in (False, True):
        of_recording = np.array([middle for is_so, middle in middles if is_so == mirrored])
        assert np.ptp(of_recording) > 20.0
        assert (np.abs(of_recording) < 40.0 - 15.0 + 0.01).all()


def test_traffic_passes_below_a_gantry(tmp_path):
    gantry = {"side": "gantry", "y_m": 3.75, "height_m": [5.0, 7.0], "tilt_x_deg": 10.0}
    plan = plan_dataset(site_of(tmp_path, {"deployment": gantry}), mountings=5, seed=3)
    assert np.ptp([scan.station_m for scan in plan.scans]) > 20.0


def test_what_a_scan_draws_does_not_depend_on_how_many_there_are(plan, tmp_path):
    few = plan_dataset(site_of(tmp_path), mountings=5, scans=7, seed=3)
    assert few.scans == plan.scans[:7]
    assert {scan.split for scan in few.scans} == {TRAIN, VAL}
    assert plan_dataset(site_of(tmp_path), mountings=5, scans=7, seed=4).scans != few.scans


def test_counted_are_those_in_the_region_about_the_lidar(plan):
    for one in samples(plan, range(6)):
        xy = one.vehicles.centre_m[:, :2]
        inside = np.hypot(*xy.T) <= 12.0
        assert (one.vehicles.counted == (inside & one.labelled)).all()
        assert one.vehicles.counted.any()


@pytest.mark.parametrize("mirrored", [False, True])
def test_moved_traffic_looks_as_it_does_to_a_lidar_that_is_moved_the_other_way(plan, mirrored):
    chosen = next(s for s in plan.scans if s.mirrored == mirrored and abs(s.station_m) > 3.0)
    detail = "box" if mirrored else "body"  # whose quads, not quite flat, are not halved symmetrically
    plan = replace(plan, observation=replace(plan.observation, detail=detail))
    one, sign = sample(plan, chosen.number), -1.0 if mirrored else 1.0
    mount = {key: chosen.mount.as_table()[key] for key in COORDINATES}
    there = {**mount, "x_m": sign * mount["x_m"] + chosen.station_m}
    there |= {key: sign * mount[key] for key in ("tilt_y_deg", "yaw_deg")}
    seen = plan.observation
    recorded = scan(
        plan.frames[chosen.frame],
        seen.lattice,
        mounting(there).pose,
        caster=seen.caster,
        detail=seen.detail,
        min_range_m=seen.lidar.min_range_m,
        max_range_m=seen.lidar.max_range_m,
    )
    expected = recorded.xyz - (chosen.station_m, 0.0, 0.0)
    expected[:, 0] *= sign
    assert len(one.cloud) == len(recorded)
    rows = [np.lexsort(np.round(points.T, 6)) for points in (one.cloud.xyz, expected)]
    np.testing.assert_allclose(one.cloud.xyz[rows[0]], expected[rows[1]], atol=1e-6)
    np.testing.assert_array_equal(one.cloud.vehicle_id[rows[0]], recorded.vehicle_id[rows[1]])


def test_headings_turn_with_the_mirror():
    from blender_lidar.traffic.boxes import Boxes

    n = np.zeros(2)
    vehicles = Boxes(1, 0.0, n.astype(int), n.astype(int), np.array([[5.0, 1, 1], [6, 2, 1]]), np.ones((2, 3)), n, n)
    vehicles = replace(vehicles, heading_rad=np.radians([10.0, -170.0]))
    turned = dataset._moved(vehicles, 2.0, True, np.array([1.0, 0.0]))
    np.testing.assert_allclose(np.degrees(turned.heading_rad), [170.0, -10.0])
    np.testing.assert_allclose(turned.centre_m[:, 0], [-3.0, -4.0])
    cos, sin = np.cos(0.7), np.sin(0.7)  # a road that runs another way

    def other_way(seen):
        centre = seen.centre_m @ np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]])
        return replace(seen, centre_m=centre, heading_rad=seen.heading_rad + 0.7)

    there, expected = dataset._moved(other_way(vehicles), 2.0, True, np.array([cos, sin])), other_way(turned)
    np.testing.assert_allclose(there.centre_m, expected.centre_m)
    np.testing.assert_allclose(np.exp(1j * there.heading_rad), np.exp(1j * expected.heading_rad))


def test_points_are_those_of_the_cloud_and_lie_in_their_boxes(plan):
    one = sample(plan, 4)
    assert one.points.sum() == (one.cloud.vehicle_id >= 0).sum() > 50
    for row, number in enumerate(one.vehicles.vehicle_id):
        away = one.cloud.xyz[one.cloud.vehicle_id == number] - one.vehicles.centre_m[row]
        cos, sin = np.cos(one.vehicles.heading_rad[row]), np.sin(one.vehicles.heading_rad[row])
        local = np.abs(np.stack([cos * away[:, 0] + sin * away[:, 1], cos * away[:, 1] - sin * away[:, 0], away[:, 2]]))
        assert len(away) == one.points[row]
        assert (0.5 * one.vehicles.size_m[row] + 1e-6 >= local.T).all()


def test_a_vehicle_alone_is_wholly_visible_and_one_behind_another_is_not(plan):
    shares = []
    for one in samples(plan, range(8)):
        for row in np.flatnonzero(one.points > 5):
            only = one.vehicles.vehicle_id[row]
            alone = replace(plan, frames=tuple(f.select(f.vehicle_id == only) for f in plan.frames))
            by_itself = sample(alone, one.scan.number)
            assert by_itself.visibility.tolist() == [1.0]
            shares.append((one.points[row] / by_itself.points[0], one.visibility[row]))
        assert ((one.visibility >= 0.0) & (one.visibility <= 1.0)).all()
        assert (one.visibility[one.points > 0] > 0.0).all()
    of_returns, of_beams = np.transpose(shares)
    assert of_beams.min() < 0.9
    np.testing.assert_allclose(of_beams, of_returns, atol=0.2)


def test_noise_and_clutter_are_of_each_scan(tmp_path):
    changes = {"world": {"clutter": 1.0}, "sensor": {"range_gate_m": 15.0, "range_noise_m": 0.02}}
    plan = plan_dataset(site_of(tmp_path, changes), mountings=1, scans=80, as_recorded=True)
    same = [s.number for s in plan.scans if s.frame == plan.scans[0].frame][:2]
    first, second = (sample(plan, number).cloud for number in same)
    assert first.xyz.shape != second.xyz.shape or (first.xyz != second.xyz).any()
    assert not np.isclose(np.sort(first.range_m)[:50], np.sort(second.range_m)[:50], atol=1e-6).all()


def test_a_lidar_hangs_off_its_plan_by_draws_of_each_scan(tmp_path):
    error = {"model": {"pose_error": {"tilt_deg": 2.0, "height_m": 0.1}}}
    plan = plan_dataset(site_of(tmp_path, error), mountings=2, scans=10)
    off = [np.degrees(scan.hangs.tilt_x - scan.mount.tilt_x) for scan in plan.scans]
    assert len(set(off)) == 10
    assert max(map(abs, off)) <= 2.0
    ground = [one.cloud.xyz[one.cloud.vehicle_id < 0, 2] for one in samples(plan, range(3))]
    assert all(0.001 < np.abs(z).max() < 1.5 for z in ground)


def test_as_recorded_neither_moves_nor_mirrors(tmp_path):
    plan = plan_dataset(site_of(tmp_path), mountings=2, as_recorded=True)
    assert {(scan.station_m, scan.mirrored) for scan in plan.scans} == {(0.0, False)}
