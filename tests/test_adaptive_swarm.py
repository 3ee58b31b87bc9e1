"""The swarm of the hardened search: bounds, donors, what it remembers, and when it has nothing left to do."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from blender_lidar.optimise.adaptive_swarm import AdaptiveSwarm, reflected
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
