"""Where a landscape may have further maxima, beside the definition worked out point by point."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from blender_lidar.optimise import hardened as basins
from blender_lidar.optimise.hardened import Basins

NOWHERE = np.array([[-9.0, -9.0]])


def message(points, values, sizes):
    found, first = Basins(np.zeros(points.shape[1], dtype=bool)), 0
    for size in sizes:
        found.add(points[first : first + size], values[first : first + size])
        first += size
    found.add(points[first:], values[first:])
    return found


def unclimbed_by_definition(points, values, climbed):
    """All points against all, one at a time, in the order they were evaluated."""
    feasible = [i for i in range(len(points)) if values[i] > -math.inf]
    nearest = {}
    for i in feasible:
        better = [j for j in feasible if values[j] > values[i] or (values[j] == values[i] and j < i)]
        nearest[i] = min((math.dist(points[i], points[j]) for j in better), default=math.inf)
    finite = [distance for distance in nearest.values() if distance < math.inf]
    if not finite:
        return None
    near = sum(finite) / len(finite)
    starts = [i for i in feasible if nearest[i] > near and min(math.dist(points[i], c) for c in climbed) > near]
    return min(starts, key=lambda i: (-values[i], i), default=None)


@settings(max_examples=100)
@given(st.integers(0, 10**6), st.integers(1, 40), st.integers(1, 4), st.lists(st.integers(1, 9), max_size=5))
def test_the_start_is_that_of_the_definition_however_the_points_come(seed, count, variables, sizes):
    rng = np.random.default_rng(seed)
    points = rng.random((count, variables))
    values = rng.integers(-3, 4, count).astype(float)  # with ties
    values[values == -3.0] = -math.inf
    climbed = points[rng.random(count) < 0.2] if rng.random() < 0.5 else np.full((1, variables), -9.0)
    if not len(climbed):
        climbed = points[:1]
    found = message(points, values, sizes).unclimbed(climbed)
    expected = unclimbed_by_definition(points, values, climbed)
    assert (found is None) == (expected is None)
    if expected is not None:
        assert np.array_equal(found[0], points[expected])


def test_every_peak_is_named_once_the_best_first():
    """Three cones of other heights on a mesh of points: their tops, and then nothing."""
    tops, heights = np.array([[0.2, 0.2], [0.8, 0.3], [0.4, 0.9]]), np.array([1.0, 0.9, 0.8])
    mesh = np.linspace(0.0, 1.0, 21)
    points = np.stack(np.meshgrid(mesh, mesh), axis=-1).reshape(-1, 2)
    values = (heights - 2.0 * np.linalg.norm(points[:, None] - tops, axis=2)).max(axis=1)
    found, climbed = message(points, values, [50, 100]), NOWHERE
    for top in tops:
        start, distance = found.unclimbed(climbed)
        np.testing.assert_allclose(start, top)
        assert distance > 0.1
        climbed = np.vstack([climbed, start])
    assert found.unclimbed(climbed) is None


def test_the_better_points_do_not_notice_that_worse_ones_are_forgotten(monkeypatch):
    rng = np.random.default_rng(1)
    points, values = rng.random((200, 3)), rng.random(200)
    monkeypatch.setattr(basins, "WATCHED", 40)
    some = message(points, values, [7] * 20)
    best = np.argsort(-values)[:40]
    alone = message(points[best], values[best], [])
    assert np.array_equal(some._points, alone._points)
    np.testing.assert_allclose(some._nearest, alone._nearest)


@pytest.mark.parametrize("values", [[-math.inf, -math.inf], [-math.inf, 1.0]])
def test_without_two_feasible_points_there_is_nowhere_to_go(values):
    assert message(np.array([[0.1, 0.1], [0.9, 0.9]]), np.array(values), []).unclimbed(NOWHERE) is None
