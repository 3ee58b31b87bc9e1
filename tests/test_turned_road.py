"""A road that runs another way than x: everything but the frame stays the same, as all ask the map of the road."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from blender_lidar.detection.dataset import plan_dataset, sample
from blender_lidar.detection.judge import watched
from blender_lidar.errors import InputError
from blender_lidar.report.installation import _bearing
from blender_lidar.road import straight
from blender_lidar.road.straight import straight_road
from blender_lidar.run.what_if import jammed
from blender_lidar.scene.mount_checks import check_mount_is_clear
from blender_lidar.scene.scenario import load_scenario
from blender_lidar.scene.site import prepare
from blender_lidar.scoring.evaluation import Evaluator
from blender_lidar.studies.variations import _with_barrier
from tests.small_scene import traffic_rows, write_scene, write_table

pytestmark = pytest.mark.versions

QUARTER = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])  # a quarter turn to the left, for rows
BARRIER = {"kind": "guard_rail", "y_m": 1.4, "x_m": [-30.0, -5.0]}
BOX = {"centre_m": [6.0, 1.0, 0.6], "size_m": [1.0, 0.5, 1.2]}
COMMON = {
    "world": {"barriers": [BARRIER], "boxes": [BOX], "clutter": 1.0, "detail": "box"},
    "region": {"stretches": [{"x_m": [-18.0, 15.0]}]},
    "deployment": {"x_m": 3.0, "y_m": 0.0},
    "sensor": {"range_gate_m": 15.0},
    "model": {"caster": "exact"},
}
MARK_M = 90.0  # a station_m, which means nothing to tables: it marks the road that is turned
TURNED = {
    "road": {"station_m": MARK_M},
    "world": {**COMMON["world"], "boxes": [{**BOX, "centre_m": [-1.0, 6.0, 0.6], "heading_deg": 90.0}]},
    "traffic": {"heading_deg": -90.0},
    "deployment": {"x_m": 0.0, "y_m": 3.0, "facing_deg": 180.0},
}


@pytest.fixture(scope="module")
def sites(tmp_path_factory):
    """A site, and the same one on a road along y."""
    folder = tmp_path_factory.mktemp("turned")
    write_table(folder / "traffic.csv", traffic_rows(vehicles=150))
    along_x = prepare(load_scenario(write_scene(folder, COMMON)))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(straight, "straight_road", turned_map)
        yield along_x, prepare(load_scenario(write_scene(folder, {**COMMON, **TURNED})))


def turned_map(road):
    along_x = straight_road(road)
    if road.station_m != MARK_M:
        return along_x
    return replace(along_x, points_m=tuple(line @ QUARTER[:2, :2] for line in along_x.points_m))


def same_vehicles(one, other):
    np.testing.assert_array_equal(other.vehicle_id, one.vehicle_id)
    np.testing.assert_allclose(other.centre_m, one.centre_m @ QUARTER, atol=1e-9)
    np.testing.assert_allclose(np.exp(1j * other.heading_rad), 1j * np.exp(1j * one.heading_rad), atol=1e-9)


def test_the_same_vehicles_count_among_the_same_things_and_get_the_same_points(sites):
    points = []
    for site in sites:
        layout = site.scenario.lidar.deployment.spaces[0].layout([4.0])
        scored = Evaluator(site.search, site.observation, site.scoring).by_vehicle([layout])
        points.append([one.seen.points[0].tolist() for one in scored])
    assert points[0] == points[1]
    assert sum(map(sum, points[0])) > 500
    one, other = sites
    for before, after in zip((*one.search, *one.holdout), (*other.search, *other.holdout), strict=True):
        same_vehicles(before, after)
        np.testing.assert_array_equal(before.counted, after.counted)
    standing = [site.observation.scenery.scenery.corners for site in sites]
    np.testing.assert_allclose(standing[1], standing[0] @ QUARTER, atol=1e-9)
    assert len(one.plan.notes) == len(other.plan.notes)
    assert len(one.recording.report.notes) == len(other.recording.report.notes)


def test_data_sets_are_moved_and_mirrored_along_it(sites):
    one, other = (plan_dataset(site, mountings=2, scans=12, seed=3) for site in sites)
    assert len({scan.station_m for scan in one.scans}) > 1
    assert {scan.mirrored for scan in one.scans} == {False, True}
    for before, after in zip(one.scans, other.scans, strict=True):
        assert (before.station_m, before.mirrored) == pytest.approx((after.station_m, after.mirrored))
    for number in range(4):
        before, after = sample(one, number), sample(other, number)
        same_vehicles(before.vehicles, after.vehicles)
        np.testing.assert_array_equal(before.points, after.points)


def test_detectors_look_at_the_same_places(sites):
    one, other = (np.array(watched(site)) for site in sites)
    corners = one @ QUARTER[:2, :2]
    np.testing.assert_allclose(other, [corners.min(axis=0), corners.max(axis=0)])


def test_queues_close_up_and_a_barrier_stands_along_it(sites):
    one, other = (jammed(site) for site in sites)
    for before, after in zip(one.search, other.search, strict=True):
        same_vehicles(before, after)
    one, other = (_with_barrier(site, 5.5).observation.scenery.scenery.corners for site in sites)
    np.testing.assert_allclose(other, one @ QUARTER, atol=1e-9)


def test_a_lidar_in_a_barrier_is_refused(sites):
    for site, (x_m, y_m) in zip(sites, ((-10.0, 1.4), (-1.4, -10.0)), strict=True):
        inside = site.scenario.lidar.mounting({"x_m": x_m, "y_m": y_m, "height_m": 0.5})
        with pytest.raises(InputError, match="hangs inside 'guard_rail"):
            check_mount_is_clear(site.scenario, site.scenario.lidar, [], {"here": inside})


def test_an_installer_reads_which_way_the_mast_faces_from_the_road(sites):
    said = []
    for site in sites:
        (mounting,) = site.scenario.lidar.deployment.spaces[0].layout([4.0])
        ahead = site.scenario.road_map.direction(mounting.xy)
        said.append([_bearing(site, axis, ahead, "travel") for axis in mounting.mast.T_site_mast.rotation[1::-1]])
    assert said == [
        ["+y, left of travel, bearing 0 deg", "ahead, in travel, bearing 90 deg"],
        ["-x, left of travel, bearing 0 deg", "ahead, in travel, bearing 90 deg"],
    ]
