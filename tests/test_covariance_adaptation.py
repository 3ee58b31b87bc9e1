"""The climbs: CMA-ES beside the cmaes package, on a plateau, and to walls and corners."""

from __future__ import annotations

import numpy as np
import pytest

from blender_lidar.optimise.cma_es import CovarianceAdaptation
from blender_lidar.optimise.search import generator


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
