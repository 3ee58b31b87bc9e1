"""What an ablation changes, its interval, and the three verdicts: above the floor, below it, or it cannot be told."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from blender_lidar.report.chart import ablation_cells
from blender_lidar.studies.candidates import Candidates
from blender_lidar.studies.chart import ablation_row
from blender_lidar.studies.driver import Landscape
from blender_lidar.studies.effects import (
    ABOVE,
    BELOW,
    UNTOLD,
    Effect,
    Reference,
    beside_floor,
    choices,
    chosen_by,
    effects,
)
from blender_lidar.studies.variations import Ablation

BLOCKS, MOUNTINGS = 12, 16
Draw = tuple[Landscape, Landscape, Landscape]


def landscape(worth: np.ndarray) -> Landscape:
    """Candidates of that worth for each of ten vehicles a block, beside a baseline of -1; a frame is a block."""
    whole = np.concatenate([np.full((1, worth.shape[1]), -1.0), worth])
    return Landscape(10.0 * whole, np.full(worth.shape[1], 10))


def draw(seed: int, noise: float = 0.0, shift: float = 0.0, blocks: int = BLOCKS, judges: int = 8) -> Draw:
    """Candidates of rising worth; without the thing each scores `shift` less, and differs by noise in every block."""
    rng = np.random.default_rng(seed)
    worth = np.linspace(0.0, 1.0, MOUNTINGS)[:, None] + 0.1 * rng.normal(size=(MOUNTINGS, blocks))
    without = worth - shift + noise * rng.normal(size=worth.shape)
    judged = np.linspace(0.0, 1.0, MOUNTINGS)[:, None] + 0.1 * rng.normal(size=(MOUNTINGS, 8))
    return landscape(without), landscape(worth), landscape(judged[:, :judges])


def reference_of(one: Draw) -> Reference:
    """The scene with the thing, as it is compared with."""
    _, having, judged = one
    return Reference(having, np.arange(having.objective.shape[1]), judged, np.arange(judged.objective.shape[1]), 1)


def found_in(*draws: Draw) -> dict[str, Effect | None]:
    return effects(draws, reference_of(draws[0]))


# --- effects ----------------------------------------------------------------------------------------------------------


def test_choices_without_a_block_are_those_of_traffic_that_never_had_it():
    one = draw(2, noise=0.5)
    reference = reference_of(one)
    for chosen, of in zip(choices(*one[:2], reference), one[:2], strict=True):
        for block in (0, 5):
            changed = of.objective[1:].copy()
            changed[:, block] = 0.0
            np.testing.assert_array_equal(chosen[1 + block], chosen_by(reference.halves, changed))


def test_what_changes_nothing_has_no_effect_and_no_width():
    found = found_in(draw(1))
    for name in ("bias", "apart", "regret"):
        assert found[name] == Effect(0.0, (0.0, 0.0))
    assert found["tau"].value == pytest.approx(1.0)


def test_a_shift_of_all_scores_is_a_bias_alone():
    found = found_in(draw(1, shift=0.25))
    assert found["bias"] == Effect(pytest.approx(0.25), pytest.approx((0.25, 0.25)))
    assert found["regret"].value == 0.0


def test_the_jackknife_of_a_mean_is_its_standard_error():
    one = draw(1, noise=0.5)
    from_blocks = (one[1].objective - one[0].objective)[1:].mean(axis=0) / 10.0
    low, high = found_in(one)["bias"].interval_90
    t = 1.796  # 11 degrees of freedom, 95 %
    assert (high - low) / 2.0 == pytest.approx(t * from_blocks.std(ddof=1) / np.sqrt(BLOCKS), rel=1e-3)
    assert (low + high) / 2.0 == pytest.approx(from_blocks.mean())


def test_a_choice_that_is_worth_half_of_the_gain_costs_half_and_is_half_apart():
    """Without the thing the order is turned round: the last is chosen, worth as much as the baseline and half of 2."""
    worth = np.linspace(0.0, 1.0, MOUNTINGS)[:, None] * np.ones((1, BLOCKS))
    found = found_in((landscape(worth[::-1]), landscape(worth), landscape(worth)))
    assert found["regret"] == Effect(pytest.approx(0.5), pytest.approx((0.5, 0.5)))
    assert found["apart"].value == pytest.approx(0.5)
    assert found["tau"].value == pytest.approx(-1.0)


def test_draws_that_differ_widen_the_interval():
    alike = [draw(1, shift=0.2)] * 4
    apart = [draw(1, shift=shift) for shift in (0.1, 0.15, 0.25, 0.3)]
    one, other = (found_in(*some)["bias"] for some in (alike, apart))
    assert one.value == pytest.approx(other.value) == pytest.approx(0.2)
    assert one.interval_90 == pytest.approx((0.2, 0.2))
    t, spread = 2.353, np.std([0.1, 0.15, 0.25, 0.3], ddof=1)  # 3 degrees of freedom
    assert other.interval_90[1] - 0.2 == pytest.approx(t * spread / 2.0, rel=1e-3)


def test_the_interval_of_the_bias_covers_the_truth_in_nine_of_ten_cases():
    covered = 0
    for seed in range(60):
        low, high = found_in(draw(seed, noise=0.5, shift=0.1))["bias"].interval_90
        covered += low <= 0.1 <= high
    assert 0.9 * 60 - 3.0 * np.sqrt(60 * 0.09) <= covered


def test_what_has_no_sign_does_not_go_below_0_and_what_is_not_judged_has_no_regret():
    found = found_in(draw(1, noise=0.2), draw(2, noise=0.2))
    assert found["apart"].interval_90[0] >= 0.0 > found["bias"].interval_90[0]
    assert found_in(draw(1, noise=0.5, judges=2))["regret"].interval_90 is None
    one = draw(1, noise=0.5)
    worse = replace(one[2], objective=np.concatenate([np.full((1, 8), 20.0), one[2].objective[1:]]))
    assert found_in((*one[:2], worse))["regret"] is None  # where the baseline is better than all


# --- verdicts and rows ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("interval", "expected"),
    [((0.11, 0.2), ABOVE), ((-0.3, -0.2), ABOVE), ((0.0, 0.1), BELOW), ((0.05, 0.2), UNTOLD), ((-0.5, 0.5), UNTOLD)],
)
def test_an_effect_is_above_or_below_the_floor_by_its_whole_interval(interval, expected):
    assert beside_floor(Effect(0.12, interval), -0.1, 0.1) == expected


def test_nothing_is_told_without_an_effect_an_interval_or_a_floor():
    for effect, high in ((None, 0.1), (Effect(0.0, None), 0.1), (Effect(0.0, (0.0, 0.0)), np.nan)):
        assert beside_floor(effect, high=high) == UNTOLD


def row_of(noise: float, shift: float = 0.0, blocks: int = BLOCKS, refused: str | None = None) -> dict:
    one = draw(1, noise, shift, blocks)
    every = Candidates(("height_m",), np.linspace(2.0, 5.0, MOUNTINGS)[:, None], (None,) * (1 + MOUNTINGS))
    change = Ablation("thing", "big", ((None, None),))
    return ablation_row(change, refused, [] if refused else [one], every, reference_of(one))


def test_a_great_shift_is_above_the_floor_in_the_score_and_below_in_the_rest():
    row = row_of(0.0, shift=0.5)
    assert row["verdicts"] == {"score": ABOVE, "ranking": BELOW, "optimum": BELOW}
    assert row["shift"] == {"height_m": 0.0}
    assert row["floors"]["score"] < row["bias_interval_90"][0] <= row["bias"] == pytest.approx(0.5)
    assert ablation_cells(row)[-1] == "above: score"


def test_what_changes_nothing_is_below_in_everything():
    row = row_of(0.0)
    assert set(row["verdicts"].values()) == {BELOW}
    assert ablation_cells(row)[-1] == BELOW


def test_noise_that_turns_the_order_round_is_above_in_the_ranking():
    assert row_of(3.0)["verdicts"]["ranking"] == ABOVE


@pytest.mark.parametrize("blocks", [1, 3])
def test_with_too_few_blocks_for_a_floor_numbers_are_given_and_no_verdicts(blocks):
    row = row_of(0.0, shift=0.5, blocks=blocks)
    assert row["bias"] == pytest.approx(0.5)
    assert row["verdicts"] is None
    assert (row["bias_interval_90"] is None) == (blocks == 1)
    assert ablation_cells(row)[-1] == "no floor known"


def test_a_side_that_cannot_be_had_is_told_of_in_its_words():
    row = row_of(0.0, refused="the sensor is imperfect")
    assert (row["note"], row["bias"], row["verdicts"]) == ("the sensor is imperfect", None, None)
