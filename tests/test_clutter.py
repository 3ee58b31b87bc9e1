"""Roadside clutter: the same for the same seed, beside the road, porous where it grows, and in the way of detectors."""

from __future__ import annotations

import numpy as np
import pytest

from blender_lidar.casting.exact import ExactCaster
from blender_lidar.detection.judge import sensor_at
from blender_lidar.road.settings import RoadSettings, map_of
from blender_lidar.scene.scenario import load_scenario
from blender_lidar.scene.site import prepare
from blender_lidar.scoring import frame_scorer
from blender_lidar.world.clutter import Walkers, clutter, leaves
from tests.small_scene import CASTER

pytestmark = pytest.mark.versions

ROAD = map_of(RoadSettings())
AT_ZERO = [((0.0, 0.0), (0.0, 0.0))]


def made(strength=1.0, seed=1, centre_x=0.0, reach_m=100.0, keep_clear=AT_ZERO):
    return clutter(ROAD, strength, seed, (centre_x - reach_m, centre_x + reach_m), keep_clear)


def test_the_same_seed_gives_the_same_and_another_one_another():
    assert made().digest == made().digest
    assert made().digest != made(seed=2).digest
    assert len(made(strength=0.0)) == 0


def test_what_stands_in_a_stretch_does_not_depend_on_how_far_one_looks():
    near, far = made(reach_m=49.0), made(centre_x=30.0, reach_m=200.0)
    known = {corners.tobytes() for corners in far.corners}
    assert len(near) > 1000
    assert all(corners.tobytes() in known for corners in near.corners)


def test_there_is_as_much_as_the_strength_says():
    counts = [len(made(strength=strength, reach_m=1000.0).names) for strength in (0.5, 1.0, 2.0)]
    np.testing.assert_allclose(np.array(counts) / counts[1], [0.5, 1.0, 2.0], rtol=0.15)
    assert counts[1] == pytest.approx(2 * 21 * 12.5, rel=0.12)  # both sides, 2.1 km, 12.5 things on 100 m


def test_the_carriageway_and_the_places_of_the_lidar_stay_free():
    right, left = ROAD.edges_t
    scenery = made(
        strength=3.0, reach_m=1000.0, keep_clear=[((-20.0, -1.0), (20.0, 0.0)), ((300.0, 0.0), (300.0, 0.0))]
    )
    y = scenery.corners[..., 1]
    assert ((y <= right) | (y >= left)).all()
    assert scenery.corners[..., 2].min() >= 0.0
    low, high = scenery.corners.min(axis=1), scenery.corners.max(axis=1)
    assert not ((low[:, 0] < 22.5) & (high[:, 0] > -22.5) & (low[:, 1] < 2.5) & (high[:, 1] > -3.5)).any()
    assert not ((abs(low[:, 0] - 300.0) < 2.5) & (low[:, 1] < 2.5) & (high[:, 1] > -2.5)).any()
    assert ((low[:, 0] > 100.0) & (low[:, 0] < 200.0) & (high[:, 1] > -2.5) & (high[:, 1] < 2.0)).any()  # between them


@pytest.mark.parametrize("half", [(1.8, 1.8, 1.5), (1.2, 1.2, 0.3), (1.2, 1.2, 2.25)], ids=["crown", "bush", "tall"])
def test_leaves_let_37_percent_of_level_beams_through_their_middle_pass(half):
    passed = []
    for seed in range(6):
        caster = ExactCaster(leaves((0.0, 0.0, 4.0), half, np.random.default_rng(seed)), closed=False)
        rng = np.random.default_rng(100 + seed)
        y, z = 0.15 * half[1] * rng.uniform(-1, 1, 400), 4.0 + 0.15 * half[2] * rng.uniform(-1, 1, 400)
        hits = caster.cast(np.column_stack([np.full(400, -10.0), y, z]), np.tile([1.0, 0.0, 0.0], (400, 1)))
        passed.append(np.isinf(hits.distance).mean())
    assert np.mean(passed) == pytest.approx(np.exp(-1.0), abs=0.06)


def middles(scenery):
    """The middle of each walker's box, (n, 2)."""
    return np.array(
        [scenery.corners[scenery.owner == row].reshape(-1, 3)[:, :2].mean(axis=0) for row in range(len(scenery.names))]
    )


def test_walkers_move_along_the_roadside_and_keep_their_distance_from_it():
    walkers = Walkers(ROAD, 1.0, 1, AT_ZERO)
    first, later = middles(walkers.at(100.0)), middles(walkers.at(102.0))
    assert len(first) == pytest.approx(2 * 15, abs=12)
    np.testing.assert_allclose(later[:, 1], first[:, 1], atol=1e-9)
    moved = np.abs(later[:, 0] - first[:, 0])
    assert (moved < 12.01).mean() > 0.9  # but for those who come in again at the other end
    assert (moved > 0.5).mean() > 0.5
    right, left = ROAD.edges_t
    for time_s in (0.0, 50.0, 1e4):
        scenery = walkers.at(time_s)
        assert ((scenery.corners[..., 1] < right) | (scenery.corners[..., 1] > left)).all()
        assert np.hypot(*scenery.corners[..., :2].reshape(-1, 2).T).min() > 0.5
        assert scenery.digest == Walkers(ROAD, 1.0, 1, AT_ZERO).at(time_s).digest


@pytest.mark.parametrize("x_m", [-3000.0, 450.0, 2000.0])
def test_walkers_are_as_many_about_any_place_and_move_on_where_two_look(x_m):
    here, there = (middles(Walkers(ROAD, 1.0, 1, [((x, 0.0), (x, 0.0))]).at(60.0)) for x in (x_m, x_m + 300.0))
    assert len(here) == pytest.approx(2 * 15, abs=12)
    assert (np.abs(here[:, 0] - x_m) <= 500.0).all()
    both = [np.round(some[np.abs(some[:, 0] - x_m - 150.0) < 340.0], 6) for some in (here, there)]
    assert sorted(map(tuple, both[0])) == sorted(map(tuple, both[1]))
    assert len(both[0]) > 5


@pytest.fixture(scope="module")
def sites():
    def site(strength):
        scene = {("world", "clutter"): strength, ("model", "caster"): CASTER, ("traffic", "frames"): 3}
        scene |= {
            ("world", "clutter_seed"): 3,
            ("deployment", "y_m"): -4.0,
            ("baseline", "y_m"): -4.0,
        }  # 6 m from the edge: more stands before it
        return prepare(load_scenario("i80", {key: (value, "x") for key, value in scene.items()}))

    return site(0.0), site(4.0)


def test_clutter_takes_returns_from_vehicles_and_gives_none_to_any(sites):
    mount = sites[0].scenario.lidar.baseline
    returns = []
    for site in sites:
        clouds = [sensor_at(site, mount).scan(frame) for frame in site.search]
        returns.append([np.unique(cloud.vehicle_id, return_counts=True) for cloud in clouds])
    clean, cluttered = (sum(count[vehicle >= 0].sum() for vehicle, count in each) for each in returns)
    assert cluttered < 0.97 * clean
    for (vehicle, count), (other, fewer) in zip(*returns, strict=True):
        known = dict(zip(vehicle.tolist(), count.tolist(), strict=True))
        assert all(n <= known[one] for one, n in zip(other.tolist(), fewer.tolist(), strict=True) if one >= 0)


def test_walkers_return_as_no_vehicle_where_they_are_at_the_time_of_the_frame(sites):
    site = sites[1]
    returns = []
    for frame in site.search[:3]:
        cloud = sensor_at(site, site.scenario.lidar.baseline).scan(frame)
        standing = site.observation.scenery.at(frame.time_s).with_walkers
        for row in np.flatnonzero(np.isin(standing.names, ["pedestrian", "cyclist"])):
            corners = standing.corners[standing.owner == row].reshape(-1, 3)
            near = ((cloud.xyz > corners.min(axis=0) - 0.01) & (cloud.xyz < corners.max(axis=0) + 0.01)).all(axis=1)
            assert (cloud.vehicle_id[near] == -1).all()
            returns.append(near.sum())
    assert np.sum(returns) > 20


@pytest.mark.parametrize("compiled", [True, False])
def test_scores_see_vehicles_behind_clutter_and_walkers_as_clouds_do(compiled, sites, monkeypatch):
    if not compiled:
        monkeypatch.setattr(frame_scorer, "numba_works", lambda: False)
    site = sites[1]
    mount = site.scenario.lidar.baseline
    for frame in site.search[:3]:
        cloud = sensor_at(site, mount).scan(frame)
        expected = [(cloud.vehicle_id == number).sum() for number in frame.vehicle_id[frame.counted]]
        seen = frame_scorer.FrameScorer(frame, site.observation).see(frame_scorer.singles([mount.pose]))
        np.testing.assert_array_equal(seen.points[0], expected)


def test_moments_share_what_stands_and_its_tree(sites):
    standing = next(site.observation.scenery for site in sites if site.observation.scenery is not None)
    one, other = standing.at(3.0), standing.at(4.0)
    assert one.parts[0].tree is other.parts[0].tree
    assert np.shares_memory(one.scenery.corners, other.scenery.corners)
    assert one.with_walkers.digest != other.with_walkers.digest
