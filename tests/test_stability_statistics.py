"""What a mounting loses and how certain an optimum is: against brute force, and on landscapes whose top is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from blender_lidar.metrics.catalogue import PE_VGOP
from blender_lidar.scene.settings import Tolerance
from blender_lidar.statistics import ratio_interval_90, statistic_interval_90
from blender_lidar.studies.candidates import Candidates
from blender_lidar.studies.driver import Landscape
from blender_lidar.studies.findings import (
    FAILS,
    FRAGILE,
    GRID,
    MOST_FRAGILE_LOSS,
    MOST_STABLE_LOSS,
    STABLE,
    UNDECIDED,
    ChangeDraw,
    by_loss,
    change_finding,
    chooses,
    gain_finding,
    installation_findings,
    losses_to_best,
    lost,
    optimum_finding,
    saturation_finding,
    search_finding,
    values_under,
    worst,
)

REFERENCE = {"x_m": 0.0, "y_m": 0.0, "height_m": 4.0, "tilt_x_deg": 10.0, "tilt_y_deg": 0.0, "yaw_deg": 0.0}
CHANGE = ("metric", "what", "value")
TOLERANCE = Tolerance(height_m=0.05, tilt_deg=1.0, yaw_deg=0.0, aim="mean")


def grid(tilts):
    """The mounting in question and a grid of tilts at its height."""
    tilts = np.array([REFERENCE["tilt_x_deg"], *tilts])
    return Candidates(("height_m", "tilt_x_deg"), np.column_stack([np.full(len(tilts), 4.0), tilts]), ())


def landscape(rows, vehicles=None):
    rows = np.atleast_2d(np.asarray(rows, dtype=float))
    return Landscape(rows, np.ones(rows.shape[1], dtype=np.int64) if vehicles is None else np.asarray(vehicles))


# --- losses -----------------------------------------------------------------------------------------------------------


@settings(max_examples=30)
@given(st.integers(0, 2**32), st.integers(1, 6), st.integers(1, 5))
def test_losses_equal_those_by_hand(seed, candidates, columns):
    values = np.random.default_rng(seed).normal(size=(GRID + candidates, columns))
    for column in range(columns):
        baseline, reference, *others = values[:, column]
        best = max([reference, *others])
        expected = (best - reference) / (best - baseline) if best > baseline else np.nan
        np.testing.assert_allclose(losses_to_best(values)[column], expected)


@pytest.mark.parametrize(
    ("loss", "interval", "verdict"),
    [
        *((loss, None, STABLE) for loss in (-0.3, 0.0, MOST_STABLE_LOSS)),
        *((loss, None, FRAGILE) for loss in (MOST_STABLE_LOSS + 1e-9, MOST_FRAGILE_LOSS)),
        *((loss, None, FAILS) for loss in (MOST_FRAGILE_LOSS + 1e-9, 1.5)),
        (None, None, UNDECIDED),
        (0.21, (-0.10, 0.52), UNDECIDED),
        (0.21, (0.06, 0.36), FAILS),
        (0.03, (-0.20, 0.26), UNDECIDED),
        (0.03, (-0.10, 0.16), STABLE),
        (0.10, (-0.30, 0.50), FRAGILE),
    ],
)
def test_a_verdict_follows_from_the_loss_and_one_that_may_be_none_or_large_is_not_told(loss, interval, verdict):
    assert by_loss(loss, interval) == verdict


def test_the_worst_verdict_counts_and_what_is_undecided_does_not():
    assert worst([STABLE, UNDECIDED, FRAGILE]) == FRAGILE
    assert worst([FAILS, STABLE]) == FAILS
    assert worst([UNDECIDED]) == UNDECIDED


@pytest.mark.parametrize(
    ("share", "interval", "text"),
    [
        (0.034, (-0.01, 0.07), "loses 3.4 % (-1.0 to 7.0)"),
        (-0.091, (-0.148, -0.034), "is better by 9.1 % (3.4 to 14.8)"),
        (-0.0001, None, "loses 0.0 %"),
        (0.5, None, "loses 50.0 %"),
    ],
)
def test_losses_read_as_losses_and_their_opposite_as_such(share, interval, text):
    assert lost(share, interval) == text


# --- one change -------------------------------------------------------------------------------------------------------


def drawn(reference, baseline, best, row=2, chooses=True):
    return ChangeDraw(row, chooses, landscape([baseline, reference, best]))


def found(draws):
    frames = next((draw.judged.objective.shape[1] for draw in draws if isinstance(draw, ChangeDraw)), 1)
    return change_finding(CHANGE, draws, grid([5.0, 10.0]), np.arange(frames))


def test_several_draws_are_judged_by_their_mean_with_an_interval_about_it():
    rng = np.random.default_rng(0)
    draws = [drawn(0.9 + 0.01 * rng.normal(size=12), np.zeros(12), 1.0 + 0.01 * rng.normal(size=12)) for _ in range(3)]
    finding = found(draws)
    losses = [1 - draw.judged.objective[1].sum() / draw.judged.objective[2].sum() for draw in draws]
    assert finding.numbers["losses"] == pytest.approx(losses)
    assert finding.numbers["loss"] == pytest.approx(np.mean(losses))
    low, high = finding.numbers["interval_90"]
    assert low < finding.numbers["loss"] < high
    assert finding.verdict == FRAGILE
    same = change_finding(CHANGE, draws, grid([5.0, 10.0]), None)  # judged on what chose
    assert (same.numbers["loss"], same.numbers["interval_90"]) == (finding.numbers["loss"], None)
    assert finding.text.endswith("best at 4.00 m, 10 deg")


def test_beside_a_loss_stand_the_shares_of_the_vehicles_that_are_detectable():
    vehicles, noticed = np.full(4, 5), np.array([[1.0] * 4, [3.0] * 4, [4.0] * 4])
    judged = Landscape(np.array([[0.0] * 4, [4.0] * 4, [5.0] * 4]), vehicles, detectable=noticed)
    numbers = found([ChangeDraw(1, True, judged)]).numbers
    assert numbers["detectable_share"] == pytest.approx({"baseline": 0.2, "mounting": 0.6, "best": 0.8})


def test_the_interval_is_that_of_resampled_blocks_where_there_is_much_to_gain():
    rng = np.random.default_rng(4)
    draws = [drawn(*(level + 0.05 * rng.normal(size=15) for level in (0.8, 0.0, 1.0))) for _ in range(2)]

    def loss(weights):
        every = [values_under(weights, draw.judged.objective, np.ones(15)) for draw in draws]
        return np.mean([(best - mounting) / (best - baseline) for baseline, mounting, best in every], axis=0)

    expected = statistic_interval_90(loss, np.ones(15), 1)
    np.testing.assert_allclose(found(draws).numbers["interval_90"], expected, atol=0.003)


def test_a_metric_that_does_not_choose_and_a_site_that_refuses_are_undecided():
    assert found([drawn([1.0], [1.0], [1.0], chooses=False)]).verdict == UNDECIDED
    finding = found(["no vehicle is left in the region"])
    assert (finding.verdict, finding.text) == (UNDECIDED, "no vehicle is left in the region")
    nothing_gained = found([drawn([0.5] * 4, [1.0] * 4, [0.9] * 4)])
    assert nothing_gained.verdict == UNDECIDED


def test_a_flat_landscape_chooses_nothing():
    assert not chooses(landscape([[1.0, 2.0]] * 4))
    assert chooses(landscape([[1.0, 2.0], [1.0, 2.0], [1.0, 2.1]]))


# --- the sample -------------------------------------------------------------------------------------------------------

TILTS = np.linspace(0.0, 25.0, 101)
TOP, WIDTH, NOISE = 14.0, 8.0, 1.5


def hills(blocks, seed):
    """Blocks of one vehicle each, whose objective is a parabola with a top that strays about `TOP`."""
    tops = TOP + NOISE * np.random.default_rng(seed).normal(size=blocks)
    values = 1.0 - ((TILTS[:, None] - tops) / WIDTH) ** 2
    return np.concatenate([np.zeros((GRID, blocks)), values])


def test_the_optimum_of_resampled_blocks_lies_where_the_tops_lie():
    finding = optimum_finding(landscape(hills(30, 2)), grid(TILTS), np.arange(30), 1)
    low, high = finding.numbers["tilt_interval_90_deg"]
    assert low < TOP < high
    assert high - low < 3.0
    assert finding.verdict == FAILS  # the mounting in question is worth 0 there, as the baseline is


def test_a_scene_of_leans_is_spoken_of_in_leans():
    tilts = grid(TILTS)
    leans = replace(tilts, variables=("height_m", "lean_deg"))
    texts = [optimum_finding(landscape(hills(30, 2)), one, np.arange(30), 1).text for one in (tilts, leans)]
    assert texts[1] == texts[0].replace("tilt", "lean") != texts[0]
    one = answer(1.0, 10.0)
    one["mounting"]["lean_deg"] = 12.0
    found = search_finding([one], 0.9, 0.0, leans=True)
    assert (found.text[-13:], found.numbers["lean_deg"]) == ("lean 12.0 deg", [12.0])


def test_two_blocks_are_too_few_for_an_interval_of_the_optimum():
    assert optimum_finding(landscape(hills(2, 2)), grid(TILTS), np.arange(2), 1).verdict == UNDECIDED


@pytest.mark.parametrize(("spread", "verdict"), [(0.1, STABLE), (0.25, FRAGILE), (0.5, FAILS)])
def test_a_gain_is_as_certain_as_the_lower_end_of_its_interval(spread, verdict):
    """Blocks of one vehicle, whose gains are 0.3 and that much less and more."""
    gains = 0.3 + spread * np.array([-1.0, 1.0, -1.0, 1.0, -1.0, 1.0])
    found = gain_finding(landscape([np.zeros(6), gains, gains]), np.arange(6), 1, PE_VGOP)
    assert found.verdict == verdict
    assert (found.numbers["gain_over_baseline"], found.numbers["blocks"]) == (pytest.approx(0.3), 6)
    assert found.numbers["interval_90"] == list(ratio_interval_90(gains, np.ones(6), 1))


@pytest.mark.parametrize("judged", [None, landscape([[0.0], [0.3], [0.3]])])
def test_too_little_held_out_traffic_for_an_interval_of_the_gain(judged):
    assert gain_finding(judged, np.zeros(1, dtype=int), 1, PE_VGOP).verdict == UNDECIDED


# --- the other sections -----------------------------------------------------------------------------------------------


def test_an_installer_is_told_what_each_error_costs_in_shares_of_the_gain():
    found = {"gain": 0.5, "kept": 0.9, "limits": {"height_m": [0.0, 0.01], "tilt_x_deg": [0.2, -0.05]}}
    height, tilt, together = installation_findings(found, TOLERANCE)
    assert (height.verdict, tilt.verdict, together.verdict) == (STABLE, FAILS, FRAGILE)
    assert tilt.text == "loses 40.0 % where it is less, is better by 10.0 % where it is more"
    (nothing,) = installation_findings({**found, "gain": 0.0}, TOLERANCE)
    assert nothing.verdict == UNDECIDED


def answer(value, tilt):
    return {"seed": 1, "mounting": {**REFERENCE, "tilt_x_deg": tilt}, "per_vehicle": value, "evaluations": 12}


def test_a_search_is_judged_by_the_worst_of_its_seeds():
    regret = search_finding([answer(1.0, 10.0), answer(0.98, 11.0), answer(0.7, 20.0)], 0.9, 0.0)
    assert regret.numbers["regrets"] == pytest.approx([0.0, 0.02, 0.3])
    assert regret.verdict == FAILS
    assert regret.text == "median 2.0 %, worst 30.0 % of the gain; height 4.00 m, tilt 10.0 to 20.0 deg"
    assert search_finding([answer(0.0, 10.0)], 0.0, 0.1).verdict == UNDECIDED


def test_where_nothing_is_seen_no_share_of_it_is_judged():
    found = {"seen": 0, "share": None, "share_within_10_m": None}
    assert saturation_finding(found).verdict == UNDECIDED
    full = {"seen": 10, "share": 0.5, "share_within_10_m": None}
    assert saturation_finding(full).verdict == FAILS
