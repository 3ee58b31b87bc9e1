"""Intervals from resampled blocks: the arithmetic, and how often they hold what they should."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from blender_lidar.statistics import (
    FEWEST_BLOCKS,
    block_sums,
    clopper_pearson_90,
    degrees_of_freedom,
    interval_90,
    of_blocks,
    ratio_interval_90,
    resampled_weights,
    share_gain_interval_90,
    share_interval_90,
    statistic_interval_90,
    student_t,
    student_t_95,
)

TRUTH = 1.0


@given(
    block=st.lists(st.integers(-3, 5), min_size=1, max_size=30),
    rows=st.integers(1, 4),
    seed=st.integers(0, 1000),
)
def test_block_sums_equal_a_loop(block, rows, seed):
    values = np.random.default_rng(seed).normal(size=(rows, 2, len(block)))
    expected = np.zeros((rows, 2, len(set(block))))
    for frame, label in enumerate(block):
        expected[..., sorted(set(block)).index(label)] += values[..., frame]
    np.testing.assert_allclose(block_sums(values, np.array(block)), expected, atol=1e-12)
    np.testing.assert_allclose(block_sums(values[0, 0], np.array(block)), expected[0, 0], atol=1e-12)


def test_block_sums_of_whole_numbers_are_exact_and_leave_their_input_alone():
    values = np.array([1, 2, 3, 4])
    assert block_sums(values, np.array([7, 7, 2, 7])).tolist() == [3.0, 7.0]
    assert values.tolist() == [1, 2, 3, 4]


@pytest.mark.parametrize("blocks", [3, 8, 25])
def test_each_resample_draws_one_block_fewer_than_there_are_all_alike(blocks):
    weights = resampled_weights(blocks, np.random.default_rng(0), 4000)
    assert weights.shape == (4000, blocks)
    assert (weights == np.round(weights)).all()
    assert set(weights.sum(axis=1)) == {blocks - 1}
    expected = (blocks - 1) / blocks
    np.testing.assert_allclose(weights.mean(axis=0), expected, atol=4 * np.sqrt(expected / 4000))


def test_resampled_means_spread_as_the_mean_itself_does():
    """Rao and Wu: the variance over resamples is the unbiased estimate s^2 / b, also for few blocks."""
    values = np.array([1.0, 4.0, 2.0, 8.0])
    weights = resampled_weights(4, np.random.default_rng(1), 200_000)
    means = weights @ values / weights.sum(axis=1)
    assert means.mean() == pytest.approx(values.mean(), rel=0.005)
    assert means.var() == pytest.approx(values.var(ddof=1) / 4, rel=0.02)


STRATA = np.array([0, 0, 0, 0, 1, 1, 1])


def test_resampled_means_of_strata_spread_by_what_their_blocks_differ_within_them():
    """The textbook's variance of a stratified total: the sum of n_h^2 s_h^2 / n_h, whatever lies between strata."""
    values = np.array([1.0, 4.0, 2.0, 8.0, 101.0, 103.0, 108.0])
    weights = resampled_weights(len(values), np.random.default_rng(1), 200_000, STRATA)
    totals = [weights[:, label == STRATA].sum(axis=1) for label in (0, 1)]
    assert all(np.allclose(total, count) for total, count in zip(totals, (4, 3), strict=True))
    expected = sum(len(own) * own.var(ddof=1) for own in (values[:4], values[4:]))
    assert (weights @ values).var() == pytest.approx(expected, rel=0.02)
    assert (weights @ values).mean() == pytest.approx(values.sum(), rel=0.002)


def test_one_stratum_resamples_as_none():
    plain, one = (resampled_weights(5, np.random.default_rng(4), 50, label) for label in (None, np.full(5, 3)))
    assert (plain == one).all()


@pytest.mark.parametrize(
    ("stratum", "degrees"),
    [([0, 0], 0), ([0, 0, 0], 2), ([0, 0, 1], 0), ([0, 0, 1, 1], 2), (STRATA, 5), ([], 0)],
)
def test_every_stratum_takes_a_degree_of_freedom_and_needs_two_blocks(stratum, degrees):
    assert degrees_of_freedom(np.array(stratum)) == degrees


def test_what_the_frames_of_a_block_share_is_told_by_block():
    assert of_blocks(np.array([3, 3, 5, 3]), np.array([1, 1, 2, 0])).tolist() == [3, 3, 5]


def test_nine_intervals_in_ten_hold_the_truth_of_two_recordings_that_differ():
    """Blocks of a poor and a good recording: what lies between the two is no uncertainty of their mean."""
    rng, held, width, plain = np.random.default_rng(11), 0, [], []
    for seed in range(300):
        vehicles = rng.integers(80, 140, 7).astype(float)
        objective = vehicles * (np.where(STRATA == 0, 0.0, 5.0) + rng.normal(size=7))
        truth = (vehicles * np.where(STRATA == 0, 0.0, 5.0)).sum() / vehicles.sum()

        def mean(counts, objective=objective, vehicles=vehicles):
            return counts @ objective / (counts @ vehicles)

        low, high = statistic_interval_90(mean, vehicles, seed, STRATA)
        held += low <= truth <= high
        width.append(high - low)
        plain.append(np.diff(statistic_interval_90(mean, vehicles, seed))[0])
    assert 0.84 <= held / 300 <= 0.96
    assert np.mean(width) < 0.6 * np.mean(plain)


def test_the_same_seed_gives_the_same_interval():
    numerator, denominator = np.arange(8.0), np.full(8, 3.0)
    assert ratio_interval_90(numerator, denominator, 5) == ratio_interval_90(numerator, denominator, 5)
    assert ratio_interval_90(numerator, denominator, 5) != ratio_interval_90(numerator, denominator, 6)


def test_an_interval_leaves_five_per_cent_on_either_side():
    low, high = interval_90(np.arange(101.0))
    assert (low, high) == (pytest.approx(5.0), pytest.approx(95.0))


@pytest.mark.parametrize("blocks", range(FEWEST_BLOCKS))
def test_too_few_blocks_give_no_interval(blocks):
    assert ratio_interval_90(np.ones(blocks), np.ones(blocks), 1) is None


def test_blocks_that_are_all_alike_give_an_interval_without_width():
    low, high = ratio_interval_90(np.full(6, 3.0), np.full(6, 2.0), 1)
    assert low == high == pytest.approx(1.5)


def test_the_interval_holds_the_ratio_and_scales_with_it():
    rng = np.random.default_rng(3)
    vehicles = rng.integers(80, 140, 12).astype(float)
    gain = vehicles * rng.normal(1.0, 0.3, 12)
    low, high = ratio_interval_90(gain, vehicles, 1)
    assert low < gain.sum() / vehicles.sum() < high
    np.testing.assert_allclose(ratio_interval_90(10.0 * gain, vehicles, 1), (10.0 * low, 10.0 * high))


def simulated(blocks, frames, within, runs=400):
    """Share of intervals that hold the true gain, and their mean width, for frames of `blocks` blocks of time.

    `within` is the share of the variance that all frames of a block have in common: 1, and more frames of a block
    tell nothing new.
    """
    rng = np.random.default_rng(7)
    block = np.repeat(np.arange(blocks), frames)
    held, width = 0, 0.0
    for run in range(runs):
        vehicles = rng.integers(80, 140, blocks * frames).astype(float)
        common, own = rng.normal(size=blocks)[block], rng.normal(size=blocks * frames)
        gain = vehicles * (TRUTH + np.sqrt(within) * common + np.sqrt(1.0 - within) * own)
        low, high = ratio_interval_90(block_sums(gain, block), block_sums(vehicles, block), seed=run)
        held += low <= TRUTH <= high
        width += (high - low) / runs
    return held / runs, width


@pytest.mark.parametrize(("blocks", "least"), [(8, 0.80), (20, 0.85)])
def test_about_nine_intervals_in_ten_hold_the_truth_though_frames_are_correlated(blocks, least):
    held, _ = simulated(blocks, frames=5, within=0.8)
    assert least <= held <= 0.95


@pytest.mark.parametrize("blocks", [3, 5])
def test_few_blocks_do_not_make_an_interval_that_claims_too_much(blocks):
    held, _ = simulated(blocks, frames=5, within=0.8)
    assert held >= 0.85


def test_more_frames_of_the_same_blocks_do_not_shrink_the_interval():
    few, many = (simulated(8, frames, within=1.0, runs=150)[1] for frames in (1, 20))
    assert many == pytest.approx(few, rel=0.1)
    independent = simulated(8, 20, within=0.0, runs=150)[1]
    assert independent < 0.3 * many


def test_a_block_without_vehicles_does_not_spoil_the_interval():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        low, high = ratio_interval_90(np.array([10.0, 12.0, 0.0, 9.0]), np.array([5.0, 5.0, 0.0, 5.0]), 1)
    assert 1.5 < low <= 31.0 / 15.0 <= high < 2.7


# One-sided points of Student's t from tables in common use (Abramowitz and Stegun 1964, table 26.10).
TABLED = [
    *((0.95, 1, 6.314), (0.95, 2, 2.920), (0.95, 4, 2.132), (0.95, 9, 1.833), (0.95, 30, 1.697), (0.95, 120, 1.658)),
    *((0.90, 1, 3.078), (0.90, 10, 1.372), (0.90, 120, 1.289)),
    *((0.975, 1, 12.706), (0.975, 2, 4.303), (0.975, 9, 2.262), (0.975, 30, 2.042)),
    *((0.99, 3, 4.541), (0.99, 20, 2.528), (0.995, 4, 4.604), (0.995, 60, 2.660), (0.9995, 8, 5.041)),
]


@pytest.mark.parametrize(("probability", "degrees", "point"), TABLED)
def test_students_t_is_that_of_the_tables(probability, degrees, point):
    assert student_t(probability, degrees) == pytest.approx(point, abs=0.0006)
    if probability == 0.95:
        assert student_t_95(degrees) == student_t(0.95, degrees)


def test_no_interval_is_told_without_a_degree_of_freedom():
    with pytest.raises(ValueError, match="allowed"):
        student_t_95(0)


def test_students_t_holds_the_share_of_draws_that_it_should():
    draws = np.random.default_rng(5).standard_t(7, 200_000)
    for probability in (0.6, 0.9, 0.99):
        assert (draws <= student_t(probability, 7)).mean() == pytest.approx(probability, abs=0.005)


def test_students_t_grows_with_the_probability_and_is_nothing_at_a_half():
    points = [student_t(probability, 5) for probability in np.linspace(0.5, 0.9999, 50)]
    assert abs(points[0]) < 1e-9
    assert (np.diff(points) > 0.0).all()


@pytest.mark.parametrize(("probability", "degrees"), [(0.4, 3), (1.0, 3), (0.95, 0), (float("nan"), 3)])
def test_students_t_refuses_what_it_does_not_serve(probability, degrees):
    with pytest.raises(ValueError, match="allowed"):
        student_t(probability, degrees)


# --- shares of boxes --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("hits", "trials"), [(45, 45), (0, 45), (44, 45), (3, 10), (500, 1000), (1999, 2000)])
def test_clopper_and_pearsons_interval_is_that_of_scipys_beta_distribution(hits, trials):
    beta = pytest.importorskip("scipy.stats").beta
    low = beta.ppf(0.05, hits, trials - hits + 1) if hits else 0.0
    high = beta.ppf(0.95, hits + 1, trials - hits) if hits < trials else 1.0
    assert clopper_pearson_90(hits, trials) == pytest.approx((low, high), abs=1e-12)


def boxes(blocks, vehicles_a_block, frames=3):
    """Vehicle and block of each box, where every vehicle is in as many frames of one block."""
    vehicle = np.repeat(np.arange(blocks * vehicles_a_block), frames)
    return vehicle, vehicle // vehicles_a_block


def test_where_every_box_of_45_vehicles_is_seen_the_share_is_at_least_94_percent():
    vehicle, block = boxes(9, 5)
    seen = np.ones(len(vehicle), dtype=bool)
    assert share_interval_90(seen, vehicle, block, 1) == pytest.approx((0.05 ** (1 / 45), 1.0))
    assert share_interval_90(~seen, vehicle, block, 1) == pytest.approx((0.0, 1 - 0.05 ** (1 / 45)))
    gain = share_gain_interval_90(seen, seen, vehicle, block, 1)
    assert gain == pytest.approx((-(1 - 0.05 ** (1 / 45)), 1 - 0.05 ** (1 / 45)))


def test_shares_of_fewer_than_ten_vehicles_or_three_blocks_have_no_interval():
    for blocks, vehicles in ((3, 3), (2, 50)):
        vehicle, block = boxes(blocks, vehicles)
        seen = vehicle % 2 == 0
        assert share_interval_90(seen, vehicle, block, 1) is None
        assert share_gain_interval_90(seen, ~seen, vehicle, block, 1) is None


def test_intervals_of_shares_hold_the_truth_nine_times_in_ten():
    rng, held, gained, runs = np.random.default_rng(5), 0, 0, 400
    for seed in range(runs):
        vehicle, block = boxes(12, 6)
        chance = np.clip(0.8 + 0.12 * rng.standard_normal(12), 0, 1)[block]  # differs from block to block
        easy = rng.random(12 * 6)[vehicle]  # a vehicle that is hard to see is so in all its frames
        before, after = easy < chance - 0.3, easy < chance
        truth, gain = 0.7977, 0.3  # of the clipped normal distribution, by four million draws
        low, high = share_interval_90(after, vehicle, block, seed)
        held += low <= truth <= high
        low, high = share_gain_interval_90(before, after, vehicle, block, seed)
        gained += low <= gain <= high
    assert 0.86 <= held / runs <= 0.96
    assert 0.86 <= gained / runs <= 0.97
