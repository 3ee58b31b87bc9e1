"""The parts of the hardened search: its swarm, where further maxima may be, and the climbs."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from blender_lidar.optimise import hardened as basins
from blender_lidar.optimise.adaptive_swarm import AdaptiveSwarm, reflected
from blender_lidar.optimise.cma_es import CovarianceAdaptation
from blender_lidar.optimise.hardened import Basins
from blender_lidar.optimise.search import distinct_donors, generator


@given(st.lists(st.floats(-50.0, 50.0), min_size=1, max_size=5))
def test_the_bounds_reflect(targets):
    found = reflected(np.array(targets))
    for target, share in zip(targets, found.tolist(), strict=True):
        while not 0.0 <= target <= 1.0:  # one wall after the other
            target = -target if target < 0.0 else 2.0 - target
        assert share == pytest.approx(target, abs=1e-9)
        assert 0.0 <= share <= 1.0


@given(st.integers(4, 30), st.integers(0, 30), st.integers(0, 2**32))
def test_the_donors_of_a_jump_are_distinct_and_not_the_particle(particles, archived, seed):
    rng, i = generator(seed), np.arange(particles)
    pool = particles + archived
    j, k = distinct_donors(i, rng.integers(particles - 1, size=particles), rng.integers(pool - 2, size=particles))
    assert not ((i == j) | (i == k) | (j == k)).any()
    assert 0 <= j.min() <= j.max() < particles
    assert 0 <= k.min() <= k.max() < particles + archived


def test_personal_bests_never_get_worse_and_what_a_jump_learns_stays_in_range():
    swarm = AdaptiveSwarm(generator(3), 10, 2, np.zeros(2, dtype=bool))
    for _ in range(60):
        before = swarm.value.copy()
        values = -np.abs(swarm.candidates - 0.3).sum(axis=1)
        swarm.tell(values)
        assert (swarm.value >= before).all()
        assert np.array_equal(swarm.value, np.maximum(before, values))
        swarm.move()
        assert (swarm._scales >= 0.05).all()
        assert (np.concatenate([swarm._scales, swarm._crossovers]) <= 1.0).all()
        assert len(swarm._replaced) <= 10


def test_a_swarm_drifts_over_a_plateau_instead_of_freezing():
    """x = best = guide and no velocity is where particle swarms stay for ever on a quantised objective."""
    swarm = AdaptiveSwarm(generator(0), 10, 2, np.zeros(2, dtype=bool))
    for _ in range(100):
        swarm.tell(np.zeros(10))
        swarm.move()
    seen = [swarm.best.copy()]
    for _ in range(10):
        swarm.tell(np.zeros(10))
        swarm.move()
        seen.append(swarm.best.copy())
    assert all((a != b).any(axis=1).all() for a, b in pairwise(seen))


def test_the_first_points_of_a_swarm_are_evaluated_before_it_moves():
    """A swarm that replaced another moved before its first points had values, and learnt from nothing."""
    swarm = AdaptiveSwarm(generator(0), 10, 2, np.zeros(2, dtype=bool))
    first = swarm.candidates.copy()
    swarm.move()
    assert np.array_equal(swarm.candidates, first)
    swarm.tell(np.arange(10.0))
    swarm.move()
    assert not (swarm.candidates == first).all(axis=1).any()


def test_a_collapsed_swarm_says_so():
    swarm = AdaptiveSwarm(generator(0), 10, 3, np.zeros(3, dtype=bool))
    generations = 0
    while not swarm.exhausted:
        swarm.tell(-np.square(swarm.candidates - 0.6).sum(axis=1))
        swarm.move()
        generations += 1
    assert 20 < generations < 400
    np.testing.assert_allclose(swarm.best[swarm.order[0]], 0.6, atol=5e-3)


# --- basins: beside the definition worked out point by point ----------------------------------------------------------


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


# --- climbs: CMA-ES beside the cmaes package, on a plateau, and to walls and corners ----------------------------------


def test_a_climb_is_cma_es_as_the_cmaes_package_has_it():
    """Mean, step size and covariance after each of 25 generations fed with the same samples."""
    cmaes = pytest.importorskip("cmaes")
    mean = np.array([0.4, 0.6, 0.55])
    ours = CovarianceAdaptation(generator(0), mean, 0.1, 8)
    theirs = cmaes.CMA(mean=mean, sigma=0.1, population_size=8, seed=0)
    slope = np.array([1.0, 30.0, 900.0])
    for _ in range(25):
        ours.move()
        values = -(slope * np.square(ours.candidates - [0.5, 0.52, 0.5])).sum(axis=1)
        theirs.tell([(x, -value) for x, value in zip(ours.candidates, values, strict=True)])
        ours.tell(values)
        np.testing.assert_allclose(ours._mean, theirs._mean, rtol=1e-6)
        assert ours._step == pytest.approx(theirs._sigma, rel=1e-5)
        np.testing.assert_allclose(ours._covariance, theirs._C, rtol=1e-4, atol=1e-7)


def test_a_climb_on_a_plateau_widens_and_then_gives_up():
    climb = CovarianceAdaptation(generator(0), np.array([0.5, 0.5]), 0.001, 6)
    for _ in range(10):
        climb.move()
        climb.tell(np.zeros(6))
    assert climb._step > 0.003
    for _ in range(20):
        climb.move()
        climb.tell(np.zeros(6))
    assert climb.exhausted


@pytest.mark.parametrize("best", [[1.0, 0.4, 0.6], [1.0, 0.0, 0.6], [1.0, 0.0, 1.0], [1.0, 0.0, 1.0, 0.4, 0.6]])
def test_a_climb_to_a_wall_along_an_edge_or_into_a_corner_arrives(best):
    """Samples drawn again while outside the box stayed off the wall; put on it, climbs along it ended early."""
    best, slope = np.array(best), np.array([1.0, 3.0, 10.0, 3.0, 1.0])[: len(best)]
    walls, missed = np.isin(best, [0.0, 1.0]), []
    for seed in range(8):
        climb, tried = CovarianceAdaptation(generator(seed), np.full(best.size, 0.5), 0.1, 8), []
        while not climb.exhausted:
            climb.move()
            tried.append(climb.candidates)
            climb.tell(-np.abs(climb.candidates - best) @ slope)
            beyond = np.abs(climb._mean - 0.5) - 0.5
            assert (beyond <= 4.0 * climb._step * np.sqrt(np.diag(climb._covariance))).all()
        tried = np.concatenate(tried)
        assert ((tried >= 0.0) & (tried <= 1.0)).all()
        assert (tried[:, walls] == best[walls]).all(axis=1).any()
        missed.append((np.abs(tried - best) @ slope).min())
    assert np.median(missed) < 1e-4


def test_a_climb_on_a_circle_goes_through_the_wall_and_the_other_variables_stop_there():
    climb = CovarianceAdaptation(generator(0), np.array([0.99, 0.99]), 0.05, 40, periodic=np.array([True, False]))
    climb.move()
    around, stopped = climb.candidates.T
    assert (around < 0.2).any()
    assert (around > 0.8).any()
    assert not np.isin(around, (0.0, 1.0)).any()
    assert stopped.min() > 0.5
    assert (stopped == 1.0).any()
