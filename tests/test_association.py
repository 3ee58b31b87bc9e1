"""Correlations in many resamples at once equal those of the observations written out as often as drawn."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from blender_lidar.reality.association import (
    centred_ranks,
    correlation,
    correlation_of_means,
    group_means,
    orthogonal,
    pearson,
    residual,
)


def mean_ranks(values):
    """Ranks from 1 on by counting, ties at their mean."""
    return np.array(
        [sum(other < one for other in values) + 0.5 * (sum(o == one for o in values) + 1) for one in values]
    )


def plain_r(x, y):
    x, y = np.asarray(x, dtype=float) - np.mean(x), np.asarray(y, dtype=float) - np.mean(y)
    norm = math.sqrt((x @ x) * (y @ y))
    return x @ y / norm if norm > 1e-12 else math.nan


def left_over(y, controls):
    """By NumPy's least squares, with a constant."""
    design = np.column_stack([np.ones(len(y)), *controls])
    return y - design @ np.linalg.lstsq(design, y, rcond=None)[0]


def written_out(values, weights):
    return np.repeat(values, weights.astype(int))


def resampled(seed, columns):
    """Some columns of few values, so that ties abound, and weights with zeros."""
    rng = np.random.default_rng(seed)
    number = rng.integers(3, 13)
    weights = rng.integers(0, 4, (5, number)).astype(float)
    weights[0] = 1.0
    weights[:, 0] += 1.0  # none is empty
    return [rng.integers(0, rng.integers(1, 9), number).astype(float) for _ in range(columns)], weights


SEEDS = given(seed=st.integers(0, 2**32 - 1))


@settings(deadline=None)
@SEEDS
def test_ranks_equal_those_of_the_observations_written_out(seed):
    (values,), weights = resampled(seed, 1)
    ranks = centred_ranks(values, weights)
    for row, drawn in zip(ranks, weights, strict=True):
        expected = mean_ranks(written_out(values, drawn))
        np.testing.assert_allclose(np.repeat(row, drawn.astype(int)), expected - expected.mean(), atol=1e-9)


@settings(deadline=None)
@SEEDS
def test_spearman_and_pearson_equal_those_of_the_observations_written_out(seed):
    (x, y), weights = resampled(seed, 2)
    by_rank = correlation(centred_ranks(x, weights), centred_ranks(y, weights), weights)
    straight = pearson(x, y, weights)
    for number, drawn in enumerate(weights):
        much_x, much_y = written_out(x, drawn), written_out(y, drawn)
        expected = plain_r(mean_ranks(much_x), mean_ranks(much_y))
        np.testing.assert_allclose(by_rank[number], expected, atol=1e-9)
        np.testing.assert_allclose(straight[number], plain_r(much_x, much_y), atol=1e-7)


@settings(max_examples=60, deadline=None)
@SEEDS
def test_partial_spearman_is_that_of_what_least_squares_leave_of_the_ranks(seed):
    (x, y, *controls), weights = resampled(seed, 4)
    held = orthogonal([centred_ranks(values, weights) for values in controls], weights)
    left = [residual(centred_ranks(values, weights), held, weights) for values in (x, y)]
    partial = correlation(*left, weights)
    for number, drawn in enumerate(weights):
        much = [mean_ranks(written_out(values, drawn)) for values in (x, y, *controls)]
        rest = [left_over(values, much[2:]) for values in much[:2]]
        known = all(np.abs(one).max() > 1e-9 for one in rest)
        expected = plain_r(*rest) if known else math.nan
        np.testing.assert_allclose(partial[number], expected, atol=1e-6)


def test_what_a_control_tells_wholly_leaves_nothing_to_correlate():
    rng = np.random.default_rng(2)
    distance, weights = rng.normal(size=20), np.ones((1, 20))
    ranks = centred_ranks(-3.0 * distance, weights)
    left = residual(ranks, orthogonal([centred_ranks(distance, weights)], weights), weights)
    assert (left == 0.0).all()
    assert np.isnan(correlation(left, ranks, weights)).all()


def test_a_constant_control_holds_nothing_fixed():
    """Layouts without occlusion give one value for all."""
    rng = np.random.default_rng(3)
    weights = np.ones((1, 20))
    x = centred_ranks(rng.normal(size=20), weights)
    np.testing.assert_array_equal(
        residual(x, orthogonal([centred_ranks(np.full(20, -1.0), weights)], weights), weights), x
    )


def test_large_numbers_far_from_zero_keep_their_correlation():
    rng = np.random.default_rng(4)
    x, weights = rng.normal(size=50), np.ones((1, 50))
    y = x + rng.normal(size=50)
    np.testing.assert_allclose(pearson(1e6 + x, 1e4 * y, weights), plain_r(x, y), rtol=1e-8)


def test_ranks_and_correlations_agree_with_scipy():
    stats = pytest.importorskip("scipy.stats")
    rng = np.random.default_rng(5)
    x = rng.integers(0, 30, 200).astype(float)
    y = x + rng.integers(0, 40, 200)
    weights = np.ones((1, 200))
    np.testing.assert_allclose(centred_ranks(x, weights)[0], stats.rankdata(x) - 100.5)
    rank = correlation(centred_ranks(x, weights), centred_ranks(y, weights), weights)
    np.testing.assert_allclose(rank, stats.spearmanr(x, y)[0], atol=1e-12)
    np.testing.assert_allclose(pearson(x, y, weights), stats.pearsonr(x, y)[0], atol=1e-12)


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), one_for_all=st.booleans())
def test_group_means_equal_a_loop(seed, one_for_all):
    (values,), weights = resampled(seed, 1)
    rng = np.random.default_rng(seed)
    group = rng.integers(0, 3, len(values) if one_for_all else weights.shape)
    found = group_means(values, group, 4, weights)
    for row, drawn in enumerate(weights):
        of_row = group if one_for_all else group[row]
        for number in range(4):
            mine = (of_row == number) & (drawn > 0)
            expected = np.average(values[mine], weights=drawn[mine]) if mine.any() else math.nan
            np.testing.assert_allclose(found[row, number], expected, atol=1e-12)


def test_correlation_of_means_leaves_out_what_is_missing():
    x = np.array([[1.0, 2.0, 4.0, np.nan], [1.0, np.nan, 3.0, np.nan], [1.0, 1.0, 1.0, 1.0]])
    y = np.array([[2.0, 3.0, 9.0, 1.0], [1.0, 2.0, 3.0, 4.0], [1.0, 2.0, 3.0, 4.0]])
    found = correlation_of_means(x, y)
    np.testing.assert_allclose(found, [plain_r([1, 2, 4], [2, 3, 9]), np.nan, np.nan])
