"""The statistics of studies: ranking, calibration, losses, the noise ceiling, the front, and what is near enough."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from blender_lidar.statistics import student_t
from blender_lidar.studies.candidates import sobol
from blender_lidar.studies.chart import accuracy, mark_within, recommended, sentence
from blender_lidar.studies.driver import Landscape
from blender_lidar.studies.effects import (
    BOUND_LEVEL,
    Noise,
    Reference,
    calibrated_residuals,
    chosen_by,
    chosen_shares,
    compared,
    halvings,
    noise_ceiling,
    pareto_front,
    regret,
    searched_weights,
    share_lost,
    weighted_tau,
)

seeds = st.integers(0, 2**32 - 1)


def scores(seed: int, count: int = 24) -> tuple[np.ndarray, np.ndarray]:
    """A score that follows a reference, and that."""
    rng = np.random.default_rng(seed)
    reference = rng.normal(size=count)
    values = 0.5 * reference + rng.normal(scale=0.4, size=count)
    return values, reference


def traffic(seed: int, blocks: int = 8, mountings: int = 16, noise: float = 0.0) -> tuple[Landscape, np.ndarray]:
    """A landscape with a true worth of each mounting and, in every frame, luck of its own; two frames a block."""
    rng = np.random.default_rng(seed)
    worth = np.concatenate([[-1.0], np.linspace(0.0, 1.0, mountings)])
    vehicles = rng.integers(5, 15, 2 * blocks)
    luck = rng.normal(scale=noise, size=(len(worth), len(vehicles)))
    return Landscape((worth[:, None] + luck) * vehicles, vehicles), np.repeat(np.arange(blocks), 2)


def reference_of(seed: int, noise: float = 0.1) -> Reference:
    searched, block = traffic(seed, noise=noise)
    judged, judged_block = traffic(seed + 1, noise=noise)
    return Reference(searched, block, judged, judged_block, 1)


def accuracy_of(reference: Reference, phases: list[Landscape]) -> dict:
    found = compared([(one, reference.searched, reference.judged) for one in phases], reference)
    return accuracy(found, reference.gain)


# --- ranking ----------------------------------------------------------------------------------------------------------


@given(seed=seeds)
def test_the_weighted_tau_is_1_for_the_same_order_and_minus_1_for_the_reverse(seed):
    _, reference = scores(seed)
    assert weighted_tau(np.exp(reference), reference) == pytest.approx(1.0)
    assert weighted_tau(-reference, reference) == pytest.approx(-1.0)


def test_two_mountings_exchanged_at_the_top_count_more_than_at_the_bottom():
    reference = np.arange(10.0)[::-1]
    top, bottom = reference.copy(), reference.copy()
    top[[0, 1]], bottom[[8, 9]] = reference[[1, 0]], reference[[9, 8]]
    assert weighted_tau(top, reference) < weighted_tau(bottom, reference) < 1.0


# --- calibration ------------------------------------------------------------------------------------------------------


@given(seed=seeds, scale=st.floats(0.01, 100.0), shift=st.floats(-10.0, 10.0))
def test_stretching_and_shifting_a_score_changes_nothing_that_calibration_leaves(seed, scale, shift):
    values, reference = scores(seed)
    expected = calibrated_residuals(values, reference)
    np.testing.assert_allclose(calibrated_residuals(scale * values + shift, reference), expected, atol=1e-8)
    np.testing.assert_allclose(calibrated_residuals(reference * scale + shift, reference), 0.0, atol=1e-8)


def test_each_half_is_judged_by_a_line_that_the_other_half_gave():
    values, reference = scores(3)
    half = len(values) // 2
    slope, intercept = np.polyfit(values[half:], reference[half:], 1)
    expected = reference[:half] - (intercept + slope * values[:half])
    np.testing.assert_allclose(calibrated_residuals(values, reference)[:half], expected)


# --- choices and regret -----------------------------------------------------------------------------------------------


@given(seed=seeds)
def test_orders_that_agree_regret_nothing(seed):
    reference = reference_of(seed)
    searched = reference.searched
    found = accuracy_of(reference, [Landscape(3.0 * searched.objective + 0.2 * searched.vehicles, searched.vehicles)])
    assert (found["regret"], found["regret_interval_90"]) == (0.0, (0.0, 0.0))
    assert found["tau"] == pytest.approx(1.0)
    assert found["error"] == pytest.approx(0.0, abs=1e-9)


def test_regret_is_what_the_choice_loses_of_the_gain():
    """Without luck the best of 16 candidates is worth 1 and the baseline -1: half way back is half of the gain."""
    judged, block = traffic(1)
    best, other = np.eye(16)[15], np.full(16, 0.0)
    other[0] = 1.0
    found = regret([other], [best], [judged], block)
    assert found.share == pytest.approx(0.5)
    assert found.interval_90 == pytest.approx((0.5, 0.5))
    assert regret([other], [best], [Landscape(-judged.objective, judged.vehicles)], block) is None  # nothing is gained
    few, block = traffic(1, blocks=2)
    found = regret([other], [best], [few], block)
    assert (found.interval_90, found.bound(0.95)) == (None, None)


def test_a_share_over_draws_is_their_mean_and_its_interval_covers_the_truth_about_as_often_as_it_says():
    """Three draws of the same 20 blocks lose 0.1, 0.2 and 0.3 of a gain of 1."""
    covered, trials = 0, 300
    for seed in range(trials):
        luck = 0.2 * np.random.default_rng(seed).normal(size=(2, 20))
        lost = np.array([[0.1], [0.2], [0.3]]) + luck[0]
        found = share_lost(lost, np.ones((3, 20)) + luck[1], np.ones(20, dtype=bool))
        assert found.share == pytest.approx(np.mean(lost.sum(axis=1) / (1.0 + luck[1]).sum()))
        covered += found.interval_90[0] <= 0.2 <= found.interval_90[1]
    assert 0.84 <= covered / trials <= 0.96


def test_the_bound_at_95_per_cent_is_the_upper_end_of_the_90_per_cent_interval_and_rises_with_the_level():
    judged, block = traffic(1, noise=0.3)
    found = regret([np.eye(16)[3]], [np.eye(16)[15]], [judged], block)
    assert found.blocks == 8
    assert found.bound(0.95) == pytest.approx(found.interval_90[1], rel=1e-3)
    assert found.bound(0.95) < found.bound(0.98) < found.bound(0.999)
    assert found.bound(0.5) == pytest.approx(found.share)


def test_choices_are_shares_and_those_of_two_blocks_come_from_the_frames_as_they_are():
    searched, block = traffic(4, noise=2.0)
    chosen = chosen_shares(searched, searched_weights(block, 1))
    assert chosen.sum() == pytest.approx(1.0)
    assert (chosen > 0.0).sum() > 1
    few, block = traffic(4, blocks=2, noise=2.0)
    expected = np.eye(16)[np.argmax(few.per_vehicle()[1:])]
    np.testing.assert_array_equal(chosen_shares(few, searched_weights(block, 1)), expected)


def test_frames_that_are_not_looked_at_choose_nothing():
    searched, block = traffic(4, noise=0.5)
    frames = np.array([0, 5, 9])
    alone = Landscape(searched.objective[:, frames], searched.vehicles[frames])
    other = searched.objective.copy()
    other[:, [1, 2]] = 1e6
    changed = Landscape(other, searched.vehicles)
    weights = searched_weights(block, 1)
    np.testing.assert_array_equal(chosen_shares(changed, weights, frames), chosen_shares(searched, weights, frames))
    expected = chosen_shares(searched, np.ones((1, len(block))), frames)
    np.testing.assert_array_equal(chosen_shares(alone, np.ones((1, 3))), expected)


def test_phases_are_averaged():
    reference = reference_of(7, noise=0.3)
    rng = np.random.default_rng(1)
    objective, vehicles = reference.searched.objective, reference.searched.vehicles
    phases = [Landscape(objective + rng.normal(scale=3.0, size=objective.shape), vehicles) for _ in "ab"]
    alone, both = [accuracy_of(reference, [phase]) for phase in phases], accuracy_of(reference, phases)
    for key in ("bias", "tau", "regret"):
        assert both[key] == pytest.approx(np.mean([one[key] for one in alone]))
    assert both["error"] == pytest.approx(np.sqrt(np.mean([one["error"] ** 2 for one in alone])))


# --- halves and the noise ceiling -------------------------------------------------------------------------------------


@pytest.mark.parametrize("blocks", [4, 9])
def test_halves_share_no_block_leave_none_out_and_choose_what_is_best_on_theirs(blocks):
    halves = halvings(blocks, 3)
    np.testing.assert_array_equal(halves.sum(axis=1), 1)
    assert (halves[:, 0].sum(axis=1) == blocks // 2).all()
    assert len(np.unique(halves[:, 0], axis=0)) > 1
    objective = np.random.default_rng(1).normal(size=(5, blocks))
    chosen = chosen_by(halves, objective)
    for number, side in ((0, 0), (7, 1), (100, 0)):
        assert chosen[number, side] == int(np.argmax([row[halves[number, side]].sum() for row in objective]))


def test_the_noise_ceiling_is_twice_the_standard_error_of_the_whole():
    """Each frame's luck has a deviation of 0.5, and 40 blocks hold 80 of them."""
    searched, block = traffic(3, blocks=40, mountings=64, noise=0.5)
    mixed = [0, *(1 + np.random.default_rng(1).permutation(64))]  # as Sobol's points are: halves are alike
    searched = Landscape(searched.objective[mixed] / searched.vehicles * 10, np.full(80, 10))
    noise = noise_ceiling(Reference(searched, block, searched, block, 1))
    assert noise.error == pytest.approx(2.0 * 0.5 / np.sqrt(80.0), rel=0.15)
    assert noise.error_90[0] < noise.error < noise.error_90[1]


def test_three_blocks_have_no_halves_to_compare():
    searched, block = traffic(3, blocks=3)
    assert noise_ceiling(Reference(searched, block, searched, block, 1)) is None


# --- the front and the points of Sobol --------------------------------------------------------------------------------


@given(st.lists(st.tuples(st.integers(0, 6), st.integers(0, 6)), min_size=1, max_size=30))
def test_the_front_is_what_no_other_beats(costs):
    first, second = np.array(costs, dtype=float).T
    beaten = [any(((a <= c and b <= d) and (a < c or b < d)) for a, b in costs) for c, d in costs]
    front = pareto_front(first, second)
    assert sorted(front.tolist()) == np.flatnonzero(~np.array(beaten)).tolist()
    assert (np.diff(first[front]) >= 0.0).all()


@pytest.mark.parametrize("first", [0, 64])
def test_each_half_of_sobols_points_fills_the_box_evenly(first):
    """Of 64 points every eighth of the one side times every eighth of the other holds exactly one."""
    points = sobol(3, 128, np.array([2.0, -10.0]), np.array([4.5, 25.0]))[first : first + 64]
    cell = np.floor((points - [2.0, -10.0]) / [2.5, 35.0] * 8.0).astype(int)
    assert len(np.unique(cell @ [8, 1])) == 64


# --- which fidelities are near enough: asked from many beams to few, so that among many luck passes none --------------

NOISE = Noise(bias=0.1, error=0.05, error_90=(0.04, 0.06), tau=0.9, apart=0.01)  # 5 % of a gain of 1


def row(name: str, median: float, bound: float | None, error: float = 0.001, **changes) -> dict:
    usual = {"detail": "body", "stride": 1}
    timed = {"frames": round(10 * median), "milliseconds": {"median": median}, "speedup": 80.0 / median}
    return {"name": name, "text": name, **usual, **timed, "regret_bound": bound, "error_share": error, **changes}


def reference() -> dict:
    return row("reference", 80.0, 0.0, 0.0, detail="detailed")


def marked(rows: list[dict], key: str, noise: Noise | None = NOISE) -> list[str]:
    mark_within(rows, 0.01, noise, 1.0)
    return [one["name"] for one in rows if one[key]]


def test_the_fastest_of_those_that_are_surely_near_enough_is_recommended():
    rows = [reference(), row("near", 8.0, 0.009, 0.04), row("slower", 10.0, 0.0), row("not sure", 2.0, 0.02)]
    assert marked(rows, "within") == ["reference", "near", "slower"]
    assert sentence(rows[0], recommended(rows), 0.01, 0.3) == (
        "Cheapest within 1 % of the gain: near: 8 ms an evaluation, 10 times faster than the reference (reference)."
    )


def test_what_is_cheaper_than_one_that_fails_is_not_asked_at_its_level_of_detail():
    rows = [
        reference(),
        row("passes", 9.0, 0.009),
        row("fails", 8.0, 0.011),
        row("lucky", 1.0, -0.5),
        row("another level", 2.0, 0.0, detail="box"),
    ]
    assert marked(rows, "asked") == ["reference", "passes", "fails", "another level"]
    assert marked(rows, "within") == ["reference", "passes", "another level"]
    assert recommended(rows)["name"] == "another level"


def test_beams_make_the_order_and_where_they_are_as_many_frames_do_whatever_the_clock_says():
    rows = [
        reference(),
        row("a quarter", 9.0, 0.0, stride=4, frames=30),
        row("half of the frames", 3.0, 0.5, frames=15),
        row("half of the columns", 2.0, 0.0, stride=2, frames=30),
        row("all", 1.0, 0.0, frames=30),
    ]
    assert marked(rows, "asked") == ["reference", "half of the frames", "half of the columns", "all"]
    assert marked(rows, "within") == ["reference", "half of the columns", "all"]


def test_an_error_beyond_tolerance_and_noise_is_not_near_whatever_the_regret():
    rows = [reference(), row("lucky", 8.0, 0.0, 0.2)]
    assert marked(rows, "within") == ["reference"]
    rows = [reference(), row("within the noise", 8.0, 0.0, 0.04)]
    assert marked(rows, "within") == ["reference", "within the noise"]
    assert marked(rows, "within", None) == ["reference"]


def test_where_nothing_cheaper_will_do_the_reference_is_named_and_where_nothing_gains_nothing_is():
    rows = [reference(), row("without blocks", 8.0, None)]
    mark_within(rows, 0.01, None, 0.3)
    assert "only the reference, reference: 80 ms" in sentence(rows[0], recommended(rows), 0.01, 0.3)
    assert sentence(rows[0], rows[0], 0.01, 0.0).startswith("No mounting gains anything over the baseline")


def test_of_forty_eight_that_all_lose_the_tolerance_one_passes_at_most_once_in_twenty_times():
    """Each by itself at 95 % passes a few in every second chart."""
    rng, blocks, passed, alone = np.random.default_rng(1), 10, 0, 0
    single, together = (student_t(level, blocks - 1) for level in (0.95, BOUND_LEVEL))
    trials = 600
    for _ in range(trials):
        lost = rng.normal(0.01, 0.02, (48, blocks))
        middle, error = lost.mean(axis=1), lost.std(axis=1, ddof=1) / np.sqrt(blocks)
        rows = [reference()]
        for number, bound in enumerate((middle + together * error).tolist()):
            rows.append(row(str(number), 50.0 - number, bound, detail=("box", "body", "detailed")[number % 3]))
        passed += len(marked(rows, "within")) > 1
        alone += bool((middle + single * error <= 0.01).any())
    assert passed <= trials * 0.05 + 3.0 * np.sqrt(trials * 0.05 * 0.95)
    assert passed > 0
    assert alone > 0.5 * trials
