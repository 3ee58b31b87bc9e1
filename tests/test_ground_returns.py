"""Density and evenness of ground returns against plain loops, and what the published numbers reward."""

from __future__ import annotations

import math

import numpy as np
import pytest

from blender_lidar.errors import InputError
from blender_lidar.metrics import scene_metrics as ground_returns
from blender_lidar.metrics.metric import Field, SceneContext
from blender_lidar.metrics.scene_metrics import (
    DISC_RADIUS_M,
    density_on_ground,
    field_area,
    nuc,
    nuc_on_ground,
)

AREA_M2 = 20.0 * 30.0


def slow_nuc(points, area, radius, discs, seed):
    """Every disc against every point."""
    share = math.pi * radius**2 / area
    picked = [points[int(u * len(points))] for u in np.random.default_rng(seed).random(discs)]
    ratio = [sum(math.dist(point, centre) <= radius for point in points) / (len(points) * share) for centre in picked]
    mean = sum(ratio) / discs
    return math.sqrt(sum((x - mean) ** 2 for x in ratio) / discs)


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("pairs", [1, 40, 1 << 20])
def test_non_uniformity_equals_the_slow_loop_however_many_pairs_are_looked_at_together(seed, pairs, monkeypatch):
    monkeypatch.setattr(ground_returns, "_PAIRS_AT_A_TIME", pairs)
    rng = np.random.default_rng(seed)
    radius = float(rng.uniform(0.3, 6.0))
    points = np.concatenate([rng.uniform([-10, 2], [10, 32], (200, 2)), rng.normal([3.0, 8.0], 0.4, (100, 2))])
    expected = slow_nuc(points, AREA_M2, radius, 80, seed)
    assert nuc(points, AREA_M2, radius, 80, seed) == pytest.approx(expected, rel=1e-12)
    assert expected > 0.1


@pytest.mark.parametrize("width", [0.0, 0.3, 1.4])
def test_returns_of_a_single_ring_that_lie_in_a_line_are_counted_once(width):
    points = np.random.default_rng(8).uniform([-10.0, 5.0], [10.0, 5.0 + width], (150, 2))
    for turned in (points, points[:, ::-1]):
        assert nuc(turned, AREA_M2, 0.7, 60, 4) == pytest.approx(slow_nuc(turned, AREA_M2, 0.7, 60, 4), rel=1e-12)


def test_points_on_the_rim_of_a_disc_count_and_whole_radii_apart_are_found():
    """Points on a lattice of the radius: each has itself and, but for the border, four neighbours on the rim."""
    step = np.arange(7) * 0.5
    points = np.stack(np.meshgrid(step, step), axis=-1).reshape(-1, 2)
    found = ground_returns._neighbours(points, points, 0.5)
    border = np.isin(points, (0.0, 3.0)).sum(axis=1)
    np.testing.assert_array_equal(found, 5 - border)


def test_even_returns_are_more_uniform_than_clustered_ones_and_random_ones_in_between():
    rng = np.random.default_rng(2)
    step = np.stack(np.meshgrid(np.arange(0.1, 20, 0.2), np.arange(0.1, 30, 0.2)), axis=-1).reshape(-1, 2)
    random = rng.uniform([0, 0], [20, 30], step.shape)
    clustered = np.abs(rng.normal(0.0, 4.0, step.shape))
    even, chance, crowd = (nuc(points, AREA_M2) for points in (step, random, clustered))
    assert even < chance < crowd
    assert even < 0.15


def test_non_uniformity_does_not_move_with_the_frame_or_turn_with_it():
    rng = np.random.default_rng(3)
    points = rng.uniform([0, 0], [20, 30], (3000, 2))
    turned = points @ np.array([[0.6, 0.8], [-0.8, 0.6]]) + [100.0, -40.0]
    assert nuc(turned, AREA_M2) == pytest.approx(nuc(points, AREA_M2), rel=1e-9)


def test_a_single_return_is_perfectly_uniform_and_none_is_worst():
    """Why NUC alone places no sensor."""
    assert nuc(np.array([[1.0, 2.0]]), AREA_M2) == 0.0
    assert nuc(np.full((500, 2), 3.0), AREA_M2) == 0.0
    worst = nuc(np.zeros((0, 2)), AREA_M2)
    assert worst == pytest.approx(0.5 * AREA_M2 / (math.pi * DISC_RADIUS_M**2))
    two = np.concatenate([np.zeros((50, 2)), np.array([[10.0, 10.0]] * 50), np.array([[20.0, 0.0]])])
    assert 0.0 < nuc(two, AREA_M2) < worst


def test_the_area_of_a_field_equals_that_of_many_thin_strips():
    for radius, low, high in ((50.0, 2.0, 23.96), (20.0, 2.0, 30.0), (20.0, -8.0, 9.0)):
        y = np.linspace(low, high, 400_001)
        thin = np.sqrt(np.maximum(radius**2 - y**2, 0.0))
        strips = 2.0 * float(np.sum(0.5 * (thin[1:] + thin[:-1]) * np.diff(y)))
        assert field_area(radius, (low, high)) == pytest.approx(strips, rel=1e-6)
    assert field_area(20.0, (-30.0, 30.0)) == pytest.approx(math.pi * 400.0)
    assert field_area(20.0, (25.0, 30.0)) == 0.0


def test_a_region_that_holds_no_carriageway_is_refused():
    down = np.array([[[0.0, 0.6, -0.8]]])
    context = SceneContext((), down, 0.4, 50.0, Field((0.0, 0.0), 20.0, (25.0, 30.0)))
    for value in (density_on_ground, nuc_on_ground):
        with pytest.raises(InputError, match=r"a region of 20 m about \(0\.0, 0\.0\) holds none of the carriageway"):
            value(context, np.array([0.0, 0.0, 4.0]), np.eye(3))
