"""Rings, elevations and firings are found again in sweeps whose beams are known."""

from __future__ import annotations

import math
from functools import cache

import numpy as np
import pytest

from blender_lidar.errors import InputError
from blender_lidar.sensors.beams import beam_lattice
from blender_lidar.sensors.model import load_model
from blender_lidar.sensors.pose import Pose
from blender_lidar.studies.rings import NO_POINT, Firings, Rays, crossing, recover_rings
from tests.recorded_samples import SENSOR, in_kitti_frame, scanned, street

AT_THE_ORIGIN = Pose(height_m=0.0)


@cache
def sweep():
    """A turn over a street: its cloud and its points as KITTI keeps them."""
    cloud = scanned(street())
    return cloud, in_kitti_frame(cloud.xyz)


def wrapped(angle):
    return np.mod(angle + math.pi, 2.0 * math.pi) - math.pi


@pytest.mark.parametrize("top_first", [False, True])
def test_rings_elevations_and_the_azimuth_step_are_those_of_the_sensor(top_first):
    cloud, points = sweep()
    order = np.lexsort((np.arange(len(cloud)), -cloud.ring.astype(int))) if top_first else np.arange(len(cloud))
    rings = recover_rings(points[order])
    ring = cloud.ring[order].astype(int)
    seen = np.unique(ring)  # the top rings look above everything
    np.testing.assert_array_equal(seen[rings.ring], ring)
    model = load_model(SENSOR)
    np.testing.assert_allclose(rings.elevation_rad, model.elevation_rad[seen], atol=1e-6)
    np.testing.assert_allclose(rings.height_m, 0.0, atol=1e-5)
    np.testing.assert_array_equal(rings.lateral_m, 0.0)
    assert rings.step_rad == pytest.approx(beam_lattice(model).step_rad, rel=1e-4)
    assert rings.spread_m < 1e-6


@pytest.mark.parametrize("way", [1.0, -1.0])
@pytest.mark.parametrize("seam", [0.0, math.pi])
def test_a_turn_may_go_either_way_and_start_ahead_or_behind(way, seam):
    cloud, points = sweep()
    azimuth = np.mod(way * (np.arctan2(points[:, 1], points[:, 0]) - seam), 2.0 * math.pi)
    order = np.lexsort((azimuth, cloud.ring))
    rings = recover_rings(points[order])
    np.testing.assert_array_equal(np.unique(cloud.ring)[rings.ring], cloud.ring[order])


def test_rings_are_found_in_a_crop_of_the_sector_ahead():
    cloud, points = sweep()
    ahead = (points[:, 0] > 0.0) & (np.abs(points[:, 1]) < points[:, 0] + 2.0)
    rings = recover_rings(points[ahead])
    np.testing.assert_array_equal(np.unique(cloud.ring[ahead])[rings.ring], cloud.ring[ahead])


def offset_sweep(lateral_m=0.026, height_m=0.2):
    """Rings whose lasers sit above the origin and, in turn, on either side of the axis, and see walls at all ranges."""
    rng = np.random.default_rng(2)
    elevation = np.radians(np.linspace(-12.0, 1.0, 16))
    azimuth = np.radians(np.arange(0.0, 359.9, 0.18))
    parts = []
    for number, tilt in enumerate(elevation):
        rho = np.repeat(rng.uniform(5.0, 50.0, len(azimuth) // 20 + 1), 20)[: len(azimuth)]
        side = lateral_m * (1 if number % 2 else -1)
        cos, sin = np.cos(azimuth), np.sin(azimuth)
        xyz = np.column_stack([rho * cos - side * sin, rho * sin + side * cos, height_m + rho * np.tan(tilt)])
        seen = np.mod(np.arctan2(xyz[:, 1], xyz[:, 0]), 2.0 * math.pi)
        kept = rng.random(len(azimuth)) > 0.1
        parts.append(xyz[kept][np.argsort(seen[kept])])
    return elevation, np.concatenate(parts)


def test_lasers_beside_the_origin_are_found_as_in_the_hdl_64e():
    elevation, points = offset_sweep()
    rings = recover_rings(points)
    np.testing.assert_allclose(rings.elevation_rad, elevation, atol=1e-4)
    np.testing.assert_allclose(rings.height_m, 0.2, atol=1e-3)
    np.testing.assert_allclose(np.abs(rings.lateral_m), 0.026, atol=0.003)
    assert (np.sign(rings.lateral_m) == np.tile([-1, 1], 8)).all()


def test_rays_run_through_the_points_that_they_returned_as():
    _, points = offset_sweep()
    rings = recover_rings(points)
    rays, _ = Firings(points, rings, AT_THE_ORIGIN).towards(np.array([20.0, 5.0, 0.0]), np.array([8.0, 4.0, 3.0]), 0.4)
    returned = rays.point != NO_POINT
    at = rays.origin[returned] + rays.range_m[returned, None] * rays.direction[returned]
    np.testing.assert_allclose(at, points[rays.point[returned]], atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(rays.direction, axis=1), 1.0, atol=1e-12)
    assert np.isinf(rays.range_m[~returned]).all()


@pytest.mark.parametrize("centre", [(25.0, 4.0, -1.0), (14.0, 0.0, -1.0), (0.0, -18.0, -0.9), (-30.0, 0.3, 0.0)])
def test_firings_that_did_not_return_are_put_back_where_they_were(centre):
    """A third of the returns are taken away; the rays towards a box are the sensor's own all the same."""
    cloud, points = sweep()
    kept = np.random.default_rng(4).random(len(points)) > 0.3
    size, heading = np.array([4.5, 1.8, 1.6]), 0.7
    centre = np.array(centre)
    rings = recover_rings(points[kept])
    rays, _ = Firings(points[kept], rings, AT_THE_ORIGIN).towards(centre, size, heading)

    lattice = beam_lattice(load_model(SENSOR))
    beams = lattice.directions.reshape(-1, 3)[:, [1, 0, 2]] * [1.0, -1.0, 1.0]
    beams = beams[np.isin(np.arange(len(beams)) // lattice.columns, np.unique(cloud.ring[kept]))]
    every = from_the_origin(beams)
    entry, leave = crossing(every, centre, size, heading)
    true = beams[(leave >= entry) & (leave > 0.0)]
    assert abs(len(rays.point) - len(true)) <= 0.02 * len(true) + 1
    nearest = np.max(true @ rays.direction.T, axis=1)
    assert np.degrees(np.arccos(np.clip(nearest, -1.0, 1.0))).max() < 0.1  # steps are 0.17


def from_the_origin(directions):
    count = len(directions)
    return Rays(np.zeros((count, 3)), directions, np.full(count, NO_POINT), np.full(count, np.inf))


@pytest.mark.parametrize(
    "change",
    [
        lambda cloud, points: points[np.random.default_rng(1).permutation(len(points))],
        lambda cloud, points: points[np.lexsort((cloud.ring, cloud.azimuth_rad))],  # column by column
        lambda cloud, points: points[:20],
        lambda cloud, points: points[:0],
        lambda cloud, points: points + np.random.default_rng(1).normal(0.0, 0.5, points.shape),
    ],
    ids=["shuffled", "column by column", "twenty points", "no points", "noise"],
)
def test_points_out_of_ring_order_are_refused_in_one_line(change):
    with pytest.raises(InputError, match=r"^here: its \d+ points are not in ring order; allowed: ring after ring") as e:
        recover_rings(change(*sweep()), "here")
    assert "\n" not in str(e.value)


def test_rings_that_saw_next_to_nothing_do_not_spoil_the_others():
    cloud, points = sweep()
    top = np.unique(cloud.ring)[-3:]
    rng = np.random.default_rng(8)
    kept = ~np.isin(cloud.ring, top) | (rng.random(len(points)) < 0.02)
    kept[np.flatnonzero(cloud.ring == top[1])[0]] = True
    rings = recover_rings(points[kept])
    low = cloud.ring[kept] < top[0]
    np.testing.assert_array_equal(rings.ring[low], np.searchsorted(np.unique(cloud.ring), cloud.ring[kept][low]))
