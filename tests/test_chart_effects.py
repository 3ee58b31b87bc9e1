"""What an ablation changes, its interval, and the three verdicts: above the floor, below it, or it cannot be told."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from blender_lidar.report.chart import ablation_cells
from blender_lidar.studies.ablations import (
    ABOVE,
    BELOW,
    UNTOLD,
    Ablation,
    Compared,
    ablation_row,
    beside_floor,
    draw_of,
    with_judges,
)
from blender_lidar.studies.driver import Landscape
from blender_lidar.studies.effects import (
    AblationDraw,
    Candidates,
    Effect,
    Reference,
    choices,
    chosen_by,
    effects,
    halvings,
)

BLOCKS, MOUNTINGS = 12, 16
HALVES = halvings(BLOCKS, 1)


def draw(seed: int, noise: float = 0.0, shift: float = 0.0, blocks: int = BLOCKS) -> AblationDraw:
    """Candidates of rising worth; without the thing each scores `shift` less, and differs by noise in every block."""
    rng = np.random.default_rng(seed)
    vehicles = np.full(blocks, 10.0)
    worth = np.linspace(0.0, 1.0, MOUNTINGS)[:, None] + 0.1 * rng.normal(size=(MOUNTINGS, blocks))
    without = worth - shift + noise * rng.normal(size=worth.shape)
    judged = np.linspace(0.0, 1.0, MOUNTINGS)[:, None] + 0.1 * rng.normal(size=(MOUNTINGS, 8))
    return AblationDraw(10.0 * without, 10.0 * worth, vehicles, 10.0 * np.concatenate([np.full((1, 8), -1.0), judged]))


# --- halves and choices -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("blocks", [4, 9])
def test_halves_share_no_block_and_leave_none_out(blocks):
    halves = halvings(blocks, 3)
    np.testing.assert_array_equal(halves.sum(axis=1), 1)
    assert (halves[:, 0].sum(axis=1) == blocks // 2).all()
    assert len(np.unique(halves[:, 0], axis=0)) > 1


def test_each_half_chooses_what_is_best_on_its_blocks():
    objective = np.random.default_rng(1).normal(size=(5, BLOCKS))
    chosen = chosen_by(HALVES, objective)
    for number in (0, 7, 100):
        for side in (0, 1):
            sums = [row[HALVES[number, side]].sum() for row in objective]
            assert chosen[number, side] == int(np.argmax(sums))


def test_choices_without_a_block_are_those_of_traffic_that_never_had_it():
    one = draw(2, noise=0.5)
    without, having = choices(one, HALVES)
    for block in (0, 5):
        for chosen, objective in ((without, one.without), (having, one.having)):
            changed = objective.copy()
            changed[:, block] = 0.0
            np.testing.assert_array_equal(chosen[1 + block], chosen_by(HALVES, changed))


# --- effects ----------------------------------------------------------------------------------------------------------


def test_what_changes_nothing_has_no_effect_and_no_width():
    found = effects([draw(1)], HALVES)
    for name in ("score", "bias", "apart", "regret"):
        assert found[name] == Effect(0.0, (0.0, 0.0))
    assert found["error"].value == pytest.approx(0.0, abs=1e-12)
    assert found["tau"].value == pytest.approx(1.0)


def test_a_shift_of_all_scores_is_a_bias_alone():
    found = effects([draw(1, shift=0.25)], HALVES)
    assert found["bias"].value == pytest.approx(0.25)
    assert found["score"].interval_90 == pytest.approx((0.25, 0.25))
    assert found["regret"].value == 0.0


def test_the_jackknife_of_a_mean_is_its_standard_error():
    one = draw(1, noise=0.5)
    from_blocks = (one.having - one.without).mean(axis=0) / 10.0
    low, high = effects([one], HALVES)["bias"].interval_90
    t = 1.796  # 11 degrees of freedom, 95 %
    assert (high - low) / 2.0 == pytest.approx(t * from_blocks.std(ddof=1) / np.sqrt(BLOCKS), rel=1e-3)
    assert (low + high) / 2.0 == pytest.approx(from_blocks.mean())


def test_a_choice_that_is_worth_half_of_the_gain_costs_half_and_is_half_apart():
    """Without the thing the order is turned round: the last is chosen, worth as much as the baseline and half of 2."""
    worth = np.linspace(0.0, 1.0, MOUNTINGS)[:, None] * np.ones((1, BLOCKS))
    judged = np.concatenate([-np.ones((1, BLOCKS)), worth])
    found = effects([AblationDraw(worth[::-1], worth, np.ones(BLOCKS), judged)], HALVES)
    assert found["regret"] == Effect(pytest.approx(0.5), pytest.approx((0.5, 0.5)))
    assert found["apart"].value == pytest.approx(0.5)
    assert found["tau"].value == pytest.approx(-1.0)


def test_draws_that_differ_widen_the_interval():
    alike = [draw(1, shift=0.2)] * 4
    apart = [draw(1, shift=shift) for shift in (0.1, 0.15, 0.25, 0.3)]
    one, other = (effects(some, HALVES)["score"] for some in (alike, apart))
    assert one.value == pytest.approx(other.value) == pytest.approx(0.2)
    assert one.interval_90 == pytest.approx((0.2, 0.2))
    t, spread = 2.353, np.std([0.1, 0.15, 0.25, 0.3], ddof=1)  # 3 degrees of freedom
    assert other.interval_90[1] - 0.2 == pytest.approx(t * spread / 2.0, rel=1e-3)


def test_draws_of_either_sign_do_not_cancel_in_the_score():
    both = [draw(1, shift=0.3), draw(1, shift=-0.3)]
    found = effects(both, HALVES)
    assert found["bias"].value == pytest.approx(0.0)
    assert found["score"].value == pytest.approx(0.3)


def test_the_interval_of_the_bias_covers_the_truth_in_nine_of_ten_cases():
    covered = 0
    for seed in range(200):
        low, high = effects([draw(seed, noise=0.5, shift=0.1)], HALVES[:1])["bias"].interval_90
        covered += low <= 0.1 <= high
    assert 0.9 * 200 - 3.0 * np.sqrt(200 * 0.09) <= covered <= 199


def test_intervals_of_what_has_no_sign_do_not_go_below_0():
    found = effects([draw(seed, noise=0.2) for seed in (1, 2)], HALVES)
    assert found["apart"].interval_90[0] >= 0.0
    assert found["score"].interval_90[0] >= 0.0
    assert found["bias"].interval_90[0] < 0.0


def test_what_is_not_judged_has_no_regret_and_few_judges_give_no_interval():
    one = draw(1, noise=0.5)
    found = effects([replace(one, judged=one.judged[:, :0])], HALVES)
    assert (found["apart"], found["regret"]) == (None, None)
    found = effects([replace(one, judged=one.judged[:, :2])], HALVES)
    assert found["regret"].interval_90 is None
    nothing_gained = replace(one, judged=np.concatenate([one.judged[1:].max(axis=0, keepdims=True), one.judged[1:]]))
    assert effects([nothing_gained], HALVES)["regret"] is None


# --- verdicts and rows ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("interval", "expected"),
    [((0.11, 0.2), ABOVE), ((0.0, 0.1), BELOW), ((0.05, 0.2), UNTOLD), ((-0.5, 0.5), UNTOLD), (None, UNTOLD)],
)
def test_an_effect_is_above_or_below_the_floor_by_its_whole_interval(interval, expected):
    assert beside_floor(Effect(0.12, interval), 0.1) == expected


def test_a_tau_is_above_the_floor_where_it_is_surely_less():
    assert beside_floor(Effect(0.7, (0.6, 0.8)), 0.85, less=True) == ABOVE
    assert beside_floor(Effect(0.95, (0.9, 1.0)), 0.85, less=True) == BELOW
    assert beside_floor(Effect(0.85, (0.8, 0.9)), 0.85, less=True) == UNTOLD


def test_nothing_is_told_without_an_effect_or_a_floor():
    assert beside_floor(None, 0.1) == beside_floor(Effect(0.0, (0.0, 0.0)), None) == UNTOLD


def compared_on(noise: float, shift: float = 0.0, blocks: int = BLOCKS) -> tuple[AblationDraw, Compared]:
    """A draw, and what it is compared on, from landscapes with a frame in each block."""
    one = draw(1, noise=noise, shift=shift, blocks=blocks)
    vehicles, below = np.full(blocks, 10), np.full((1, blocks), -10.0)
    having, without = (Landscape(np.concatenate([below, part]), vehicles) for part in (one.having, one.without))
    judged = Landscape(one.judged, np.full(8, 10))
    reference = Reference(having, np.arange(blocks), judged, np.arange(8), 1)
    every = Candidates(("height_m",), np.linspace(2.0, 5.0, MOUNTINGS)[:, None], (None,) * (1 + MOUNTINGS))
    on = Compared(None, every, reference)
    return with_judges(draw_of(without, having, on), judged, slice(None), on), on


def rows(noise: float, shift: float = 0.0, blocks: int = BLOCKS) -> dict:
    one, on = compared_on(noise, shift, blocks)
    return ablation_row(Ablation("thing", "big", ((None, None),)), None, [one], on)


def test_a_great_shift_is_above_the_floor_in_the_score_and_below_in_the_rest():
    row = rows(0.0, shift=0.5)
    assert row["verdicts"] == {"score": ABOVE, "ranking": BELOW, "optimum": BELOW}
    assert row["shift"] == {"height_m": 0.0}
    assert row["floors"]["score"] < row["score_interval_90"][0] <= row["score"] == pytest.approx(0.5)
    assert ablation_cells(row)[-1] == "above: score"


def test_what_changes_nothing_is_below_in_everything():
    row = rows(0.0)
    assert set(row["verdicts"].values()) == {BELOW}
    assert ablation_cells(row)[-1] == BELOW


def test_noise_that_turns_the_order_round_is_above_in_the_ranking():
    assert rows(3.0)["verdicts"]["ranking"] == ABOVE


@pytest.mark.parametrize("blocks", [1, 3])
def test_with_too_few_blocks_for_a_floor_numbers_are_given_and_no_verdicts(blocks):
    row = rows(0.0, shift=0.5, blocks=blocks)
    assert row["bias"] == pytest.approx(0.5)
    assert row["verdicts"] is None
    assert (row["bias_interval_90"] is None) == (blocks == 1)
    assert ablation_cells(row)[-1] == "no floor known"


def test_a_side_that_cannot_be_had_is_told_of_in_its_words():
    _, on = compared_on(0.0)
    row = ablation_row(Ablation("thing", "", ()), "the sensor is imperfect", [], on)
    assert (row["note"], row["bias"], row["verdicts"]) == ("the sensor is imperfect", None, None)


def test_candidates_that_nobody_chooses_are_filled_up_as_unknown():
    one, on = compared_on(0.0)
    judged = with_judges(one, Landscape(np.ones((3, 8)), np.full(8, 4)), [0, 2, 5], on).judged
    assert np.flatnonzero(np.isfinite(judged[:, 0])).tolist() == [0, 2, 5]
