"""Bootstrap correlations, isotonic regression, cross-validation, intervals and p-values, against slow or known ones."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from blender_lidar.studies.compare.resampling import (
    Clusters,
    bootstrap_correlations,
    centred_ranks,
    cluster_bootstrap,
    clusters,
    correlation,
    correlation_of_means,
    cross_validated_r2,
    group_means,
    holm,
    isotonic,
    isotonic_fit,
    kinds,
    of_correlation,
    of_difference,
    of_resamples,
    orthogonal,
    pearson,
    residual,
)

SEEDS = given(seed=st.integers(0, 2**32 - 1))
ONCE = np.ones((1, 20))


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


@SEEDS
def test_correlations_equal_those_of_the_observations_written_out(seed):
    (x, y), weights = resampled(seed, 2)
    ranks = [centred_ranks(values, weights) for values in (x, y)]
    by_rank, straight = correlation(*ranks, weights), pearson(x, y, weights)
    for number, drawn in enumerate(weights):
        much = [written_out(values, drawn) for values in (x, y)]
        expected = [stats.rankdata(values) for values in much]
        for row, known in zip(ranks, expected, strict=True):
            np.testing.assert_allclose(written_out(row[number], drawn), known - known.mean(), atol=1e-9)
        np.testing.assert_allclose(by_rank[number], plain_r(*expected), atol=1e-9)
        np.testing.assert_allclose(straight[number], plain_r(*much), atol=1e-7)


@settings(max_examples=60)
@SEEDS
def test_partial_spearman_is_that_of_the_residuals_of_least_squares_on_ranks(seed):
    (x, y, *controls), weights = resampled(seed, 4)
    held = orthogonal([centred_ranks(values, weights) for values in controls], weights)
    left = [residual(centred_ranks(values, weights), held, weights) for values in (x, y)]
    partial = correlation(*left, weights)
    for number, drawn in enumerate(weights):
        much = [stats.rankdata(written_out(values, drawn)) for values in (x, y, *controls)]
        rest = [left_over(values, much[2:]) for values in much[:2]]
        known = all(np.abs(one).max() > 1e-9 for one in rest)
        expected = plain_r(*rest) if known else math.nan
        np.testing.assert_allclose(partial[number], expected, atol=1e-6)


def test_what_a_control_tells_wholly_leaves_nothing_and_a_constant_one_takes_nothing():
    """Layouts without occlusion give one value for all."""
    distance = np.random.default_rng(2).normal(size=20)
    ranks = centred_ranks(-3.0 * distance, ONCE)
    left = residual(ranks, orthogonal([centred_ranks(distance, ONCE)], ONCE), ONCE)
    assert (left == 0.0).all()
    assert np.isnan(correlation(left, ranks, ONCE)).all()
    constant = orthogonal([centred_ranks(np.full(20, -1.0), ONCE)], ONCE)
    np.testing.assert_array_equal(residual(ranks, constant, ONCE), ranks)


def test_large_numbers_far_from_zero_keep_their_correlation():
    rng = np.random.default_rng(4)
    x, weights = rng.normal(size=50), np.ones((1, 50))
    y = x + rng.normal(size=50)
    np.testing.assert_allclose(pearson(1e6 + x, 1e4 * y, weights), plain_r(x, y), rtol=1e-8)


@settings(max_examples=40)
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


def test_resamples_worked_on_in_parts_give_the_same(monkeypatch):
    rng = np.random.default_rng(3)
    performance, distance_m = rng.uniform(size=40), rng.uniform(5.0, 40.0, 40)
    weights = rng.integers(0, 3, (25, 40)).astype(float)
    merits = {"points": performance + rng.normal(size=40), "distance": -distance_m}

    def found():
        return bootstrap_correlations(merits, performance, [distance_m, np.zeros(40)], distance_m, weights)

    whole = found()
    monkeypatch.setattr("blender_lidar.studies.compare.resampling._CELLS", 3 * 40)  # three resamples at a time
    for name, parts in found().items():
        for key, values in parts.items():
            np.testing.assert_allclose(values, whole[name][key], atol=1e-12)


# --- Regressions ------------------------------------------------------------------------------------------------------


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


@given(st.lists(st.tuples(st.integers(0, 8), st.integers(-5, 5)), min_size=1, max_size=14))
def test_isotonic_regression_equals_the_max_min_formula(pairs):
    x, y = np.array(pairs, dtype=float).T
    knots, values = isotonic_fit(x, y)
    expected = by_max_of_min(x, y)
    np.testing.assert_array_equal(knots, expected[0])
    np.testing.assert_allclose(values, expected[1], atol=1e-9)
    assert (np.diff(values) >= -1e-12).all()


def test_beyond_the_fitted_the_curve_is_level():
    x, y = np.array([1.0, 2.0]), np.array([0.2, 0.6])
    np.testing.assert_allclose(isotonic(x, y, np.array([-9.0, 1.5, 9.0])), [0.2, 0.4, 0.6])


def test_folds_hold_whole_clusters_and_are_even():
    cluster = np.repeat(np.arange(23), 3)
    fold = cluster_bootstrap(Clusters("frame", cluster, False), 1, 2).fold
    assert sorted(set(fold.tolist())) == list(range(10))
    assert all(len(set(fold[cluster == one].tolist())) == 1 for one in range(23))
    assert set(np.bincount(fold).tolist()) == {6, 9}
    few = cluster_bootstrap(Clusters("frame", np.array([0, 1, 2, 2]), False), 1, 2).fold
    assert sorted(set(few.tolist())) == [0, 1, 2]


def test_cross_validated_r2_equals_a_loop_over_cars():
    rng = np.random.default_rng(2)
    x, fold = rng.normal(size=40), rng.integers(0, 4, 40)
    y = x + 0.5 * rng.normal(size=40)
    weights = rng.integers(0, 3, (3, 40)).astype(float)
    for drawn, share in zip(weights, cross_validated_r2(x, y, isotonic, fold, weights), strict=True):
        error = of_mean = 0.0
        for one in range(40):
            rest = fold != fold[one]
            error += drawn[one] * (y[one] - isotonic(x[rest], y[rest], x[[one]])[0]) ** 2
            of_mean += drawn[one] * (y[one] - y[rest].mean()) ** 2
        assert share == pytest.approx(1.0 - error / of_mean)


def test_noise_is_not_predicted_and_a_rising_curve_is():
    rng = np.random.default_rng(3)
    x, fold, one = rng.uniform(size=400), np.arange(400) % 10, np.ones((1, 400))
    assert cross_validated_r2(x, rng.normal(size=400), isotonic, fold, one)[0] < 0.05
    assert cross_validated_r2(x, np.sqrt(x), isotonic, fold, one)[0] > 0.99


# --- Clusters, intervals and p-values ---------------------------------------------------------------------------------


def test_drives_are_resampled_where_there_are_enough_else_frames_or_blocks_of_them():
    frame = np.array([f"{number:02d}" for number in range(12)])
    by_drive = clusters({"frame": frame, "drive": np.repeat(["a", "b", "c"], 4)})
    assert (by_drive.unit, by_drive.number, by_drive.too_narrow) == ("drive", 3, False)
    in_two = {"frame": frame, "drive": np.repeat(["a", "b"], 6)}
    two = clusters(in_two)
    assert (two.unit, two.number, two.too_narrow) == ("frame", 12, True)
    blocks = clusters(in_two, 4)
    assert blocks.unit == "4 frames"
    assert blocks.of_car.tolist() == [0, 0, 0, 0, 1, 1, 2, 2, 2, 2, 3, 3]  # none spans two drives
    kind = np.array(["object label_2 (sha)"] * 6 + ["KITTI tracking label"] * 6)
    assert kinds(kind).tolist() == ["object"] * 6 + ["tracking"] * 6
    assert clusters({"frame": frame, "label_kind": kind}).too_narrow
    assert not clusters({"frame": frame[:6], "label_kind": kind[:6]}).too_narrow
    assert clusters({"frame": frame}).number == clusters({"frame": np.repeat(frame, 2)}).number == 12


def test_holm_of_a_worked_example():
    """Four p-values: 0.005 x 4, 0.01 x 3, then 0.03 x 2, and no less for what comes after."""
    assert holm([0.01, 0.04, 0.03, 0.005]) == pytest.approx([0.03, 0.06, 0.06, 0.02])
    assert holm([0.6, math.nan, 0.7]) == pytest.approx([1.0, math.nan, 1.0], nan_ok=True)


@given(st.lists(st.floats(0.0, 1.0), max_size=8))
def test_holm_never_lowers_a_p_value_and_keeps_their_order(p_values):
    adjusted = holm(p_values)
    assert all(p <= a <= 1.0 for p, a in zip(p_values, adjusted, strict=True))
    order = np.argsort(p_values, kind="stable")
    assert (np.diff(np.array(adjusted)[order]) >= 0.0).all()


def test_too_few_clusters_or_nothing_known_give_no_interval():
    values = np.array([0.5, 0.4, 0.6, 0.5])
    for estimate in (of_correlation, of_resamples):
        assert math.isnan(estimate(values, 2).low)
        assert math.isnan(estimate(np.full(4, np.nan), 9).value)
        assert estimate(values, 9).low < 0.5 < estimate(values, 9).high
    assert math.isnan(of_difference(values, values - 0.1, 2).p_above)


def test_the_same_in_every_resample_is_no_difference_to_test():
    values = np.array([0.5, 0.4, 0.6])
    same = of_difference(values, values, 9)
    assert same[:3] == (0.0, 0.0, 0.0)
    assert math.isnan(same.p_above)


def test_the_ends_of_a_difference_leave_five_per_cent_beyond_them():
    """Student's t: what is shifted by the interval's lower end has a p-value of 0.05."""
    values = np.array([0.3, 0.1, 0.2, 0.5, 0.4])
    for number in (3, 6, 11, 40):
        apart = of_difference(values, np.zeros(5), number)
        assert of_difference(values - apart.low, np.zeros(5), number).p_above == pytest.approx(0.05, abs=1e-4)
        assert of_difference(values - apart.high, np.zeros(5), number).p_above == pytest.approx(0.95, abs=1e-4)


def test_an_interval_of_a_correlation_stays_within_one():
    estimate = of_correlation(np.array([0.99, 1.0, 0.97, 0.9, 0.995]), 5)
    assert -1.0 < estimate.low < 0.99 < estimate.high < 1.0


def simulated(rng, frames, per_frame):
    """Cars in frames that share a part of both quantities; the clusters, and both metrics and the performance.

    Metric and performance are normal with correlation 0.8, the rival's is 0.6; a third of the variance is the frame's.
    """
    frame = np.repeat(np.arange(frames), per_frame)
    mixing = np.linalg.cholesky([[1.0, 0.8, 0.5], [0.8, 1.0, 0.6], [0.5, 0.6, 1.0]])
    shared, own = rng.normal(size=(frames, 3)), rng.normal(size=(len(frame), 3))
    drawn = (math.sqrt(1 / 3) * shared[frame] + math.sqrt(2 / 3) * own) @ mixing.T
    return Clusters("frame", frame, False), drawn.T


def spearman_of_normals(r):
    return 6.0 / math.pi * math.asin(r / 2.0)


@pytest.mark.parametrize(("frames", "per_frame"), [(12, 4), (26, 6)])
def test_intervals_hold_the_true_correlation_and_difference_nine_times_in_ten(frames, per_frame):
    """As many frames and cars as the excerpt's parts have; of cars of a frame that resemble each other."""
    rng = np.random.default_rng(8)
    ours, theirs = spearman_of_normals(0.8), spearman_of_normals(0.6)
    held, held_difference, trials = 0, 0, 250
    for seed in range(trials):
        drawn, columns = simulated(rng, frames, per_frame)
        weights = cluster_bootstrap(drawn, seed, 300).weights
        ranks = [centred_ranks(values, weights) for values in columns]
        first, second = (correlation(ranks[at], ranks[1], weights) for at in (0, 2))
        interval, apart = of_correlation(first, frames), of_difference(first, second, frames)
        held += interval.low <= ours <= interval.high
        held_difference += apart.low <= ours - theirs <= apart.high
    # Four standard errors of the share of 250 trials are 0.076.
    assert 0.82 <= held / trials <= 0.98
    assert 0.82 <= held_difference / trials <= 0.98
