"""The rising curve that fits best, and what it foretells of frames that it has not seen."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from blender_lidar.reality.cross_validation import folds_of, share_foretold
from blender_lidar.reality.isotonic import isotonic_fit, predict


def by_max_of_min(x, y):
    """The classic formula: at each knot the largest, over starts before it, of the least mean up to an end after it."""
    knots = sorted(set(x.tolist()))
    fitted = []
    for knot in knots:
        starts = [
            min(np.mean(y[(x >= start) & (x <= end)]) for end in knots if end >= knot)
            for start in knots
            if start <= knot
        ]
        fitted.append(max(starts))
    return np.array(knots), np.array(fitted)


@settings(deadline=None)
@given(st.lists(st.tuples(st.integers(0, 8), st.integers(-5, 5)), min_size=1, max_size=14))
def test_the_fit_equals_the_max_min_formula(pairs):
    x, y = np.array(pairs, dtype=float).T
    knots, values = isotonic_fit(x, y)
    expected = by_max_of_min(x, y)
    np.testing.assert_array_equal(knots, expected[0])
    np.testing.assert_allclose(values, expected[1], atol=1e-9)
    assert (np.diff(values) >= -1e-12).all()


def test_the_fit_agrees_with_scipy():
    optimize = pytest.importorskip("scipy.optimize")
    if not hasattr(optimize, "isotonic_regression"):
        pytest.skip("SciPy before 1.12 has no isotonic regression")
    rng = np.random.default_rng(1)
    x = np.arange(200.0)
    y = np.log1p(x) + rng.normal(size=200)
    np.testing.assert_allclose(isotonic_fit(x, y)[1], optimize.isotonic_regression(y).x, atol=1e-9)


def test_beyond_the_fitted_the_curve_is_level():
    fit = isotonic_fit(np.array([1.0, 2.0]), np.array([0.2, 0.6]))
    np.testing.assert_allclose(predict(fit, np.array([-9.0, 1.5, 9.0])), [0.2, 0.4, 0.6])


def test_folds_hold_whole_clusters_and_are_even():
    cluster = np.repeat(np.arange(23), 3)
    fold = folds_of(cluster, np.random.default_rng(1))
    assert sorted(set(fold.tolist())) == list(range(10))
    assert all(len(set(fold[cluster == one].tolist())) == 1 for one in range(23))
    assert set(np.bincount(fold).tolist()) == {6, 9}
    few = folds_of(np.array([0, 1, 2, 2]), np.random.default_rng(1))
    assert sorted(set(few.tolist())) == [0, 1, 2]


def test_the_share_foretold_equals_a_loop_over_folds():
    rng = np.random.default_rng(2)
    x, fold = rng.normal(size=40), rng.integers(0, 4, 40)
    y = x + 0.5 * rng.normal(size=40)
    weights = rng.integers(0, 3, (3, 40)).astype(float)
    found = share_foretold(y, fold, lambda fitted, told: predict(isotonic_fit(x[fitted], y[fitted]), x[told]), weights)
    for drawn, share in zip(weights, found, strict=True):
        error = of_mean = 0.0
        for one in range(40):
            rest = fold != fold[one]
            error += drawn[one] * (y[one] - predict(isotonic_fit(x[rest], y[rest]), x[[one]])[0]) ** 2
            of_mean += drawn[one] * (y[one] - y[rest].mean()) ** 2
        assert share == pytest.approx(1.0 - error / of_mean)


def test_noise_is_not_foretold_and_a_rising_curve_is():
    rng = np.random.default_rng(3)
    x, fold, one = rng.uniform(size=400), np.arange(400) % 10, np.ones((1, 400))
    shares = [
        share_foretold(y, fold, lambda fitted, told, y=y: predict(isotonic_fit(x[fitted], y[fitted]), x[told]), one)[0]
        for y in (rng.normal(size=400), np.sqrt(x))
    ]
    assert shares[0] < 0.05
    assert shares[1] > 0.99
