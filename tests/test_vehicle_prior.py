"""S-MIG and M-SOG of single vehicles, and the prior of a vehicle's voxels, against loops over points."""

from __future__ import annotations

import math
from collections import Counter

import numpy as np
import pytest

import tests.research  # noqa: F401
from blender_lidar.errors import InputError
from blender_lidar.metrics.metric import vehicle_returns
from occupancy_prior import VehiclePrior


def sample(seed, vehicles=30, points=60):
    """Vehicles of all sizes, seen from the left; the last returns nothing."""
    rng = np.random.default_rng(seed)
    size = rng.uniform([3.5, 1.5, 1.3], [6.0, 2.2, 2.4], (vehicles, 3))
    size[0] = 1.2, 0.5, 1.2
    vehicle = rng.integers(0, vehicles - 1, vehicles * points)
    local = rng.uniform(-0.5, 0.5, (len(vehicle), 3)) * size[vehicle]
    local[:, 1] = 0.5 * size[vehicle, 1] - np.abs(rng.normal(0.0, 0.1, len(vehicle)))
    local += rng.normal(0.0, 0.1, local.shape)  # some within reach of a face, some beyond
    return vehicle_returns(local, vehicle, size)


def slow_voxels(returns, voxel):
    """The voxels of each vehicle that hold a return, and all that its box has, as sets of indices from the centre."""
    for number, size in enumerate(returns.size_m):
        n = [max(1, math.ceil(side / 2 / voxel - 1e-9)) for side in size]
        filled = set()
        for point in returns.points[returns.vehicle == number]:
            if all(abs(x) <= side / 2 + voxel for x, side in zip(point, size, strict=True)):
                index = (math.floor(x / voxel) for x in point)
                filled.add(tuple(min(max(i, -count), count - 1) for i, count in zip(index, n, strict=True)))
        has = {(i, j, k) for i in range(-n[0], n[0]) for j in range(-n[1], n[1]) for k in range(-n[2], n[2])}
        yield filled, has


def slow_prior(returns, voxel):
    filled, boxes = Counter(), Counter()
    for holds, has in slow_voxels(returns, voxel):
        filled.update(holds)
        boxes.update(has)
    return {index: filled[index] / count for index, count in boxes.items()}


def slow_entropy(p):
    return -sum(q * math.log(q) for q in (p, 1.0 - p) if 0.0 < q < 1.0)


@pytest.mark.parametrize("voxel", [0.2, 0.35])
def test_the_prior_is_the_share_of_boxes_with_the_voxel_that_return_from_it(voxel):
    returns = sample(1)
    prior, expected = VehiclePrior.learn(returns, voxel), slow_prior(returns, voxel)
    middle = np.array(prior.p.shape) // 2
    for index, share in expected.items():
        assert prior.p[tuple(middle + index)] == pytest.approx(share, abs=1e-15)
    known = np.zeros(prior.p.shape, dtype=bool)
    known[tuple((middle + list(expected)).T)] = True
    assert (prior.p[~known] == 0.0).all()
    assert (prior.vehicles > 0).tolist() == known.tolist()
    assert prior.vehicles.max() == 30
    assert 0.2 < prior.p.max() <= 1.0


def test_scores_of_other_vehicles_are_sums_over_the_voxels_they_return_from():
    prior, expected = VehiclePrior.learn(sample(1)), slow_prior(sample(1), 0.2)
    others = sample(2, vehicles=12)
    entropy, published, mean = prior.covered_entropy(others), prior.s_mig(others), prior.m_sog(others)
    for number, (filled, _) in enumerate(slow_voxels(others, 0.2)):
        terms = [slow_entropy(expected.get(index, 0.0)) for index in filled]
        assert entropy[number] == pytest.approx(sum(terms), abs=1e-12)
        assert published[number] == pytest.approx(-sum(terms), abs=1e-12)
        assert mean[number] == pytest.approx(-sum(terms) / max(len(terms), 1), abs=1e-12)
    assert entropy[:-1].min() > 0.0


def test_a_vehicle_without_returns_gets_the_best_published_score():
    prior, others = VehiclePrior.learn(sample(1)), sample(2, vehicles=12)
    assert (others.count[-1], prior.covered_entropy(others)[-1]) == (0, 0.0)
    for published in (prior.s_mig(others), prior.m_sog(others)):
        assert published[-1] == 0.0 > published[:-1].max()
        assert not np.signbit(published[-1])


def test_a_prior_without_vehicles_points_or_bounds_is_refused():
    returns = sample(1)
    with pytest.raises(InputError, match="no vehicle to learn from"):
        VehiclePrior.learn(vehicle_returns(np.zeros((0, 3)), np.zeros(0, dtype=int), np.zeros((0, 3))))
    with pytest.raises(InputError, match="134,217,728 at most"):
        VehiclePrior.learn(returns, 1e-3)
    with pytest.raises(InputError, match="cell_m is 0"):
        VehiclePrior.learn(returns, 0.0)
