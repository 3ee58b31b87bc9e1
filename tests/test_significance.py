"""Intervals and p-values from resampled clusters: the arithmetic, and how often they hold what they should."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from blender_lidar.reality.association import centred_ranks, correlation
from blender_lidar.reality.car_sets import Clusters
from blender_lidar.reality.resampled_cars import Resampling
from blender_lidar.reality.significance import (
    holm,
    of_correlation,
    of_difference,
    of_resamples,
    student_t_above,
)
from blender_lidar.study.statistics import student_t_95


@pytest.mark.parametrize("degrees", [1, 2, 3, 4, 5, 10, 11, 25, 30])
def test_student_t_leaves_five_per_cent_above_the_tables_point(degrees):
    assert student_t_above(student_t_95(degrees), degrees) == pytest.approx(0.05, abs=1e-4)
    assert student_t_above(-student_t_95(degrees), degrees) == pytest.approx(0.95, abs=1e-4)
    assert student_t_above(0.0, degrees) == 0.5


def test_student_t_agrees_with_scipy():
    stats = pytest.importorskip("scipy.stats")
    for degrees in range(1, 40):
        for t in (-6.0, -1.3, 0.2, 2.5, 9.0):
            assert student_t_above(t, degrees) == pytest.approx(stats.t.sf(t, degrees), abs=1e-12)


def test_holm_of_a_worked_example():
    """Four p-values: 0.005 x 4, 0.01 x 3, then 0.03 x 2, and no less for what comes after."""
    assert holm([0.01, 0.04, 0.03, 0.005]) == pytest.approx([0.03, 0.06, 0.06, 0.02])
    assert holm([0.6, math.nan, 0.7])[0::2] == pytest.approx([1.0, 1.0])
    assert math.isnan(holm([0.6, math.nan, 0.7])[1])


@settings(deadline=None)
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
    assert of_difference(values, values, 9)[:3] == (0.0, 0.0, 0.0)
    assert math.isnan(of_difference(values, values, 9).p_above)


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
    return Clusters("frame", frame, False), drawn[:, 0], drawn[:, 1], drawn[:, 2]


def spearman_of_normals(r):
    return 6.0 / math.pi * math.asin(r / 2.0)


@pytest.mark.parametrize(("frames", "per_frame"), [(12, 4), (26, 6)])
def test_intervals_hold_the_true_correlation_and_difference_nine_times_in_ten(frames, per_frame):
    """As many frames and cars as the excerpt's parts have; of cars of a frame that resemble each other."""
    rng = np.random.default_rng(8)
    ours, theirs = spearman_of_normals(0.8), spearman_of_normals(0.6)
    held, held_difference, trials = 0, 0, 250
    for seed in range(trials):
        clusters, metric, performance, rival = simulated(rng, frames, per_frame)
        drawn = Resampling(clusters, seed, 300)
        ranks = [centred_ranks(values, drawn.weights) for values in (metric, performance, rival)]
        first, second = (correlation(ranks[at], ranks[1], drawn.weights) for at in (0, 2))
        interval = of_correlation(first, frames)
        held += interval.low <= ours <= interval.high
        apart = of_difference(first, second, frames)
        held_difference += apart.low <= ours - theirs <= apart.high
    # Four standard errors of the share of 250 trials are 0.076.
    assert 0.82 <= held / trials <= 0.98
    assert 0.82 <= held_difference / trials <= 0.98
