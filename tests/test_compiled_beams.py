"""Culled beams cast, measured and marked in compiled passes count what the passes through NumPy count."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from blender_lidar.casting import is_available
from blender_lidar.sensors.beams import beam_lattice
from blender_lidar.sensors.model import load_model
from blender_lidar.sensors.pose import Pose
from blender_lidar.study.frame_scorer import FrameScorer, Observation
from blender_lidar.traffic.vehicles import Vehicles
from tests.sample_traffic import dense_traffic, one_vehicle

pytestmark = pytest.mark.skipif(not is_available("raster"), reason="Numba is not installed")

TREES = [
    pytest.param(name, marks=pytest.mark.skipif(not is_available(name), reason=f"{name} is not installed"))
    for name in ("embree", "bvh")
]
TRAFFIC = dense_traffic(seed=6, vehicles=40, length_m=120.0)
ROOF = TRAFFIC.centre_m[3] + [0.0, 0.0, 0.5 * TRAFFIC.size_m[3, 2]]
POSES = [
    Pose(height_m=4.1, tilt_x=0.3),
    Pose(2.0, 30.0, 1.5, -0.4, 0.2, 2.0),
    Pose(*TRAFFIC.centre_m[3].tolist()),  # inside
    Pose(*ROOF.tolist()),  # on the roof
    Pose(x_m=10_000.0),  # from where nothing is in range
]


def observation(caster, sensor="RS-LiDAR-32", gate=60.0, near=0.4, detail="body", **settings):
    return Observation(beam_lattice(load_model(sensor), stride=10), gate, near, caster, detail, 0.05, **settings)


def assert_same(found, expected):
    np.testing.assert_array_equal(found.points, expected.points)
    np.testing.assert_array_equal(found.occupancy, expected.occupancy)


@pytest.mark.parametrize("caster", TREES)
@pytest.mark.parametrize("detail", ["box", "detailed"])
@pytest.mark.parametrize("culled", [True, False])
def test_compiled_passes_count_what_numpys_count_to_the_last_digit(caster, detail, culled):
    counted = np.random.default_rng(1).random(len(TRAFFIC)) < 0.7
    scorer = FrameScorer(TRAFFIC, counted, observation(caster, detail=detail, near=3.0, culled=culled))
    found = scorer.see(POSES)
    assert found.points[:2].sum() > 500
    assert not found.points[-1].any()
    assert_same(found, scorer.see(POSES, keep_returns=True))  # whose returns are wanted goes through NumPy


@pytest.mark.parametrize("caster", TREES)
def test_a_mounting_at_a_surface_is_left_to_the_float64_caster(caster):
    box, seen = one_vehicle("bus", centre=(0.0, 5.0)), observation(caster, detail="box")
    top = Pose(0.0, 5.0, float(box.size_m[0, 2]))
    oracle = FrameScorer(box, np.array([True]), replace(seen, caster="exact"))
    assert_same(FrameScorer(box, np.array([True]), seen).see([top]), oracle.see([top]))


@pytest.mark.parametrize("caster", TREES)
def test_beams_that_meet_but_the_margin_of_a_triangle_are_decided_in_float64(caster):
    """Past a box's upright edge by less than float32 can tell, to either side, in a scene that makes float32 coarse."""
    lattice, decided, beside = beam_lattice(load_model("RS-16")), 0, np.array([1e-9, 1e-8, -1e-9, -1e-8])
    pose, points = Pose(height_m=1.0), []
    for number, slot in enumerate(range(5, 205, 25)):
        azimuth = lattice.slot_azimuth0_rad[0] + slot * lattice.step_rad - beside[number % 4]
        car = one_vehicle("car", centre=(3.0 * math.tan(azimuth) - 2.0, 3.9), size=[4.0, 1.8, 1.5])
        far = one_vehicle("car", centre=(200.0, 200.0))
        names = ("vehicle_id", "class_index", "centre_m", "size_m", "heading_rad", "lane")
        both = Vehicles(0, 0.0, *(np.concatenate([getattr(part, name) for part in (car, far)]) for name in names))
        seen = Observation(lattice, 50.0, 0.0, caster, "box", 0.05)
        scorer, rays = FrameScorer(both, np.ones(2, dtype=bool), seen), []
        decide = scorer._tree.decide
        scorer._tree.decide = lambda *args, decide=decide, rays=rays: (rays.append(len(args[1])), decide(*args))[1]
        found = scorer.see([pose])
        oracle = FrameScorer(both, np.ones(2, dtype=bool), replace(seen, caster="exact"))
        assert_same(found, oracle.see([pose]))
        decided += sum(rays)
        points.append(int(found.points[0, 0]))
    assert decided > 0
    assert min(points) > 0
