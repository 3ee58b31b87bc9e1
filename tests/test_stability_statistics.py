"""What a mounting loses and how certain an optimum is: against brute force, and on landscapes whose top is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from blender_lidar.metrics.catalogue import PE_VGOP, metric_named
from blender_lidar.scene.deployment import Installer
from blender_lidar.statistics import resampled_weights, statistic_interval_90
from blender_lidar.studies.candidates import BASELINE, FIRST, Candidates
from blender_lidar.studies.driver import HELD_OUT, SEARCHED, Landscape
from blender_lidar.studies.effects import DRAWS, Lost
from blender_lidar.studies.findings import (
    AT_LEAST_FRAGILE,
    AT_MOST_FRAGILE,
    FAILS,
    FRAGILE,
    MOST_RIVALS,
    RIVAL,
    STABLE,
    UNDECIDED,
    VERDICTS,
    ChangeDraw,
    Judges,
    Losses,
    beside,
    by_loss,
    change_finding,
    chooses,
    cross_fitted,
    gain_finding,
    installation_findings,
    likely_rivals,
    losses_of,
    losses_text,
    of_vehicles,
    optimum_finding,
    repair_finding,
    search_finding,
    worst,
)

REFERENCE = {"x_m": 0.0, "y_m": 0.0, "height_m": 4.0, "tilt_x_deg": 10.0, "tilt_y_deg": 0.0, "yaw_deg": 0.0}
CHANGE = ("metric", "what", "value")
INSTALLER = Installer(height_m=0.05, tilt_deg=1.0, yaw_deg=0.0)


def grid(tilts):
    """The mounting in question and a grid of tilts at its height."""
    tilts = np.array([REFERENCE["tilt_x_deg"], *tilts])
    return Candidates(("height_m", "tilt_x_deg"), np.column_stack([np.full(len(tilts), 4.0), tilts]), ())


def landscape(rows, vehicles=None):
    rows = np.atleast_2d(np.asarray(rows, dtype=float))
    return Landscape(rows, np.ones(rows.shape[1], dtype=np.int64) if vehicles is None else np.asarray(vehicles))


def judges(blocks, distinct=1.0):
    """A block for each frame, of vehicles that are all different unless said."""
    return Judges(np.arange(blocks), distinct, PE_VGOP)


# --- verdicts ---------------------------------------------------------------------------------------------------------


def test_without_an_interval_a_loss_is_undecided():
    assert by_loss(None) == UNDECIDED


@pytest.mark.parametrize(
    ("interval", "verdict"),
    [
        ((0.0, 0.01), STABLE),
        ((-0.6, -0.4), STABLE),
        ((-0.03, 0.011), AT_MOST_FRAGILE),
        ((0.01, 0.05), AT_MOST_FRAGILE),
        ((-0.03, 0.051), UNDECIDED),
        ((0.011, 0.05), FRAGILE),
        ((0.011, 0.051), AT_LEAST_FRAGILE),
        ((0.01, 0.15), UNDECIDED),
        ((0.051, 0.15), FAILS),
    ],
)
def test_a_verdict_has_every_class_that_the_interval_of_the_loss_reaches(interval, verdict):
    assert by_loss(interval) == verdict
    assert verdict in VERDICTS


def test_the_worst_verdict_counts_and_what_is_undecided_or_has_none_does_not():
    assert worst([STABLE, UNDECIDED, FRAGILE, None]) == FRAGILE
    assert worst([FAILS, STABLE]) == FAILS
    assert worst([UNDECIDED, None]) == UNDECIDED


# --- losses -----------------------------------------------------------------------------------------------------------


def told(share, objective, of_gain=None, metric=PE_VGOP):
    share, objective = (Lost(one, ends, 9) for one, ends in (share, objective))
    return losses_text(Losses(share, objective, objective, of_gain), metric)


def test_losses_read_as_losses_and_a_loss_below_0_as_none():
    assert told((0.007, (-0.004, 0.018)), (0.012, (-0.0101, 0.0342)), Lost(0.034, (-0.03, 0.09), 9)) == (
        "loses 0.7 percentage points (-0.4 to 1.8), 0.012 bits (-0.010 to 0.034), 3.4 % (-3.0 to 9.0) of the gain"
    )
    assert told((-0.02, (-0.03, -0.01)), (-0.0301, (-0.06, -0.0001)), Lost(-0.101, (-0.17, -0.031), 9)) == (
        "no loss found (-3.0 to -1.0 percentage points, -0.060 to 0.000 bits)"
    )
    assert told((0.02, None), (-0.1, None)) == "loses 2.0 percentage points; no loss found (-0.100 bits)"
    detectable = metric_named("detectable")
    assert told((0.02, None), (0.02, None), metric=detectable) == "loses 2.0 percentage points, 2.0 % of the metric"


def noisy(levels, blocks, seed, noise=0.05, vehicles=10, share=(0.2, 0.6, 0.8)):
    """The baseline, a mounting and its rival, block by block, of so many vehicles each."""
    rng = np.random.default_rng(seed)
    values = vehicles * (np.array(levels)[:, None] + noise * rng.normal(size=(3, blocks)))
    return Landscape(values, np.full(blocks, vehicles), detectable=rng.binomial(vehicles, share, (blocks, 3)).T)


def test_losses_are_paired_and_have_the_intervals_of_resampled_blocks():
    draws = [noisy((0.0, 0.8, 1.0), 15, seed) for seed in (1, 2)]
    found = losses_of(draws, judges(15))

    def mean(of_draw):
        return lambda weights: np.mean([of_draw(weights, one) for one in draws], axis=0)

    def per_vehicle(rows, weights, one):
        return (rows @ weights.T) / (weights @ one.vehicles)

    def lost(weights, one, rows="objective"):
        _, own, rival = per_vehicle(getattr(one, rows), weights, one)
        return rival - own

    def of_gain(weights, one):
        baseline, own, rival = per_vehicle(one.objective, weights, one)
        return (rival - own) / (rival - baseline)

    for one, statistic in ((found.objective, lost), (found.of_gain, of_gain)):
        assert one.share == pytest.approx(mean(statistic)(np.ones((1, 15)))[0])
        np.testing.assert_allclose(one.interval_90, statistic_interval_90(mean(statistic), np.ones(15), 1), atol=0.003)
    low, high = statistic_interval_90(mean(lambda *given: lost(*given, rows="detectable")), np.ones(15), 1)
    middle, reach = 0.5 * (low + high), np.hypot(0.5 * (high - low), 1.761 / 152.0)  # Student's t of 14 degrees
    np.testing.assert_allclose(found.share.interval_90, (middle - reach, middle + reach), atol=0.003)


@pytest.mark.parametrize(("noise", "real"), [(0.05, True), (2.5, False)])
def test_a_gain_within_twice_its_noise_has_no_shares(noise, real):
    found = losses_of([noisy((0.0, 0.8, 1.0), 20, 3, noise)], judges(20))
    low, high = found.gain.interval_90
    assert (found.gain.share >= high - low) == real  # twice a half-width is the whole width
    assert (found.of_gain is not None) == real
    assert (found.numbers["loss"] is None) != real


def test_where_no_vehicle_differs_the_next_one_may_and_ten_are_the_fewest():
    """Agresti and Min (2005): half a vehicle more on either side has the variance 1 / (n + 2) ** 2."""
    none = Lost(0.0, (0.0, 0.0), 1000)
    for distinct in (10, 45, 1000):
        low, high = of_vehicles(none, distinct).interval_90
        assert (-low, high) == pytest.approx(2 * [1.646 / (distinct + 2)], rel=1e-3)
    assert of_vehicles(none, 9.9).interval_90 is None
    verdicts = [by_loss(of_vehicles(none, distinct).interval_90) for distinct in (30, 32, 162, 163)]
    assert verdicts == [UNDECIDED, AT_MOST_FRAGILE, AT_MOST_FRAGILE, STABLE]


def test_a_vehicle_that_is_seen_often_is_one_vehicle():
    often = losses_of([noisy((0.0, 0.8, 1.0), 8, 4, vehicles=5)], judges(8, distinct=0.2))
    once = losses_of([noisy((0.0, 0.8, 1.0), 8, 4, vehicles=5)], judges(8))
    assert once.share.interval_90 is not None
    assert often.share.interval_90 is None  # 8 of them
    assert often.objective == once.objective


# --- rivals -----------------------------------------------------------------------------------------------------------


@settings(max_examples=20)
@given(st.integers(0, 2**32), st.integers(3, 9))
def test_cross_fitting_judges_each_block_by_a_rival_that_was_chosen_without_it_and_its_neighbours(seed, blocks):
    values = np.random.default_rng(seed).normal(size=(6, 2 * blocks))
    block = np.repeat(np.arange(blocks), 2)
    found = cross_fitted(landscape(values), block)
    aside = 1 if blocks >= 6 else 0
    for frame in range(2 * blocks):
        others = [other for other in range(2 * blocks) if abs(block[other] - block[frame]) > aside]
        assert found[frame] == FIRST + np.argmax([values[row, others].sum() for row in range(FIRST, 6)])


def test_the_luck_of_a_rival_that_judges_itself_is_gone():
    """Forty mountings that are all equally good: the best of them on the same blocks is better by luck alone."""
    rng = np.random.default_rng(8)
    lost = {"itself": [], "others": []}
    for _ in range(40):
        found = landscape(np.concatenate([np.zeros((1, 20)), 1.0 + rng.normal(size=(41, 20))]))
        best = FIRST + np.argmax(found.objective[FIRST:].sum(axis=1))
        for name, rival in (("itself", best), ("others", cross_fitted(found, np.arange(20)))):
            lost[name].append(losses_of([beside(found, FIRST, rival)], judges(20)).objective.share)
    assert np.mean(lost["itself"]) > 0.3
    assert abs(np.mean(lost["others"])) < 3.0 * np.std(lost["others"]) / np.sqrt(40) < 0.25


@settings(max_examples=20)
@given(st.integers(0, 2**32))
def test_likely_rivals_are_those_that_resampled_blocks_prefer_the_best_first(seed):
    values = np.random.default_rng(seed).normal(size=(12, 16))
    found, block = landscape(values), np.repeat(np.arange(8), 2)
    rows = likely_rivals(found, block, 3)
    often = {}
    for weights in resampled_weights(8, np.random.default_rng(3), DRAWS):
        by_hand = [sum(row[k] * weights[block[k]] for k in range(16)) for row in values[FIRST:]]
        best = FIRST + int(np.argmax(by_hand))
        often[best] = often.get(best, 0) + 1
    assert len(rows) == MOST_RIVALS
    assert rows[0] == FIRST + np.argmax(values[FIRST:].sum(axis=1))
    assert all(often.get(row, 0) >= 0.05 * DRAWS for row in set(rows[1:]) - {rows[0]})
    likely = sorted((row for row in often if often[row] >= 0.05 * DRAWS), key=lambda row: -often[row])
    if len({*likely, rows[0]}) <= MOST_RIVALS:
        assert set(rows) == {*likely, rows[0]}


def test_an_interval_reaches_up_to_what_is_lost_to_any_likely_rival():
    one = noisy((0.0, 0.9, 1.0), 20, 1, share=(0.2, 0.6, 0.6))
    other = noisy((0.0, 0.9, 1.0), 20, 1, share=(0.2, 0.6, 0.9))
    both = replace(
        one,
        objective=np.concatenate([one.objective, other.objective[[RIVAL]]]),
        detectable=np.concatenate([one.detectable, other.detectable[[RIVAL]]]),
    )
    alone, found = losses_of([one], judges(20)), losses_of([both], judges(20))
    rival = losses_of([both.select([0, 1, 3])], judges(20))
    assert found.share.share == alone.share.share
    assert found.share.interval_90 == (alone.share.interval_90[0], rival.share.interval_90[1])
    assert found.share.interval_90[1] > alone.share.interval_90[1] + 0.1


# --- one change -------------------------------------------------------------------------------------------------------


def drawn(reference, baseline, best, row=2, chooses=True):
    return ChangeDraw(row, chooses, landscape([baseline, reference, best]))


def found(draws):
    frames = next((draw.judged.objective.shape[1] for draw in draws if isinstance(draw, ChangeDraw)), 1)
    return change_finding(CHANGE, draws, grid([5.0, 10.0]), judges(frames))


def test_several_draws_are_judged_by_their_mean():
    draws = [ChangeDraw(row, True, noisy((0.0, 0.9, 1.0), 12, row, 0.01)) for row in (1, 2)]
    finding = found(draws)
    alone = [found([draw]).numbers for draw in draws]
    for name in ("loss", "objective_lost", "detectable_share_lost"):
        assert finding.numbers[name] == pytest.approx(np.mean([one[name] for one in alone]))
    assert finding.text.endswith("rival at 4.00 m, 5 to 10 deg")
    assert finding.verdict == FAILS
    few = ChangeDraw(1, True, noisy((0.0, 0.9, 1.0), 2, 1, 0.01))
    assert (found([few]).verdict, found([few]).numbers["loss_interval_90"]) == (UNDECIDED, None)


def test_beside_a_loss_stand_the_shares_of_the_vehicles_that_are_detectable():
    vehicles, noticed = np.full(4, 5), np.array([[1.0] * 4, [3.0] * 4, [4.0] * 4])
    judged = Landscape(np.array([[0.0] * 4, [4.0] * 4, [5.0] * 4]), vehicles, detectable=noticed)
    finding = found([ChangeDraw(1, True, judged)])
    assert finding.numbers["detectable_share"] == pytest.approx({"baseline": 0.2, "mounting": 0.6, "best": 0.8})
    assert finding.text.startswith("60.0 % detectable, the rival 80.0 %: loses 20.0 percentage points (")


def test_a_mounting_that_sees_all_vehicles_does_not_fail_whatever_share_of_a_small_gain_it_loses():
    every = np.full((3, 12), 20.0)
    judged = Landscape(noisy((0.0, 0.01, 0.05), 12, 5, 0.001).objective, np.full(12, 20), detectable=every)
    finding = found([ChangeDraw(1, True, judged)])
    assert finding.numbers["loss"] > 0.7
    assert finding.verdict == STABLE
    assert finding.text.startswith("100.0 % detectable, the rival 100.0 %: ")


def test_a_metric_that_does_not_choose_and_a_site_that_refuses_are_undecided():
    assert found([drawn([1.0], [1.0], [1.0], chooses=False)]).verdict == UNDECIDED
    finding = found(["no vehicle is left in the region"])
    assert (finding.verdict, finding.text) == (UNDECIDED, "no vehicle is left in the region")


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
    return np.concatenate([np.zeros((FIRST + 1, blocks)), values])


def optimum(objective, mountings):
    blocks = np.arange(objective.shape[1])
    seen = np.broadcast_to(np.linspace(0.0, 1.0, len(objective))[:, None], objective.shape)
    found = Landscape(objective, np.ones(objective.shape[1], dtype=np.int64), detectable=seen)
    return optimum_finding(found, found, mountings, blocks, 1)


def test_the_optimum_of_resampled_blocks_lies_where_the_tops_lie():
    finding = optimum(hills(30, 2), grid(TILTS))
    low, high = finding.numbers["tilt_interval_90_deg"]
    assert low < TOP < high
    assert high - low < 3.0
    assert finding.verdict is None  # a place is no loss
    shares = [100.0 * (2 + np.flatnonzero(end == TILTS)[0]) / (1 + len(TILTS)) for end in (low, high)]
    assert f"from there {shares[0]:.1f} % to {shares[1]:.1f} % are detectable" in finding.text


def test_a_scene_of_leans_is_spoken_of_in_leans():
    tilts = grid(TILTS)
    leans = replace(tilts, variables=("height_m", "lean_deg"))
    texts = [optimum(hills(30, 2), one).text for one in (tilts, leans)]
    assert texts[1] == texts[0].replace("tilt", "lean") != texts[0]
    one = answer(10.0)
    one["mounting"]["lean_deg"] = 12.0
    found = search_finding([one], [noisy((0.0, 1.0, 1.0), 5, 1)], judges(5), leans=True)
    assert (found.text[-13:], found.numbers["lean_deg"]) == ("lean 12.0 deg", [12.0])


def test_two_blocks_are_too_few_for_an_interval_of_the_optimum():
    assert optimum(hills(2, 2), grid(TILTS)).verdict == UNDECIDED


@pytest.mark.parametrize(
    ("middle", "spread", "verdict"),
    [(0.3, 0.1, STABLE), (0.3, 0.28, FRAGILE), (0.3, 0.5, UNDECIDED), (-0.3, 0.5, UNDECIDED), (-0.3, 0.1, FAILS)],
)
def test_a_gain_is_told_where_its_interval_leaves_out_0(middle, spread, verdict):
    """Six blocks of ten vehicles, whose gains are that much less and more than a mean."""
    gains = middle + spread * np.array([-1.0, 1.0, -1.0, 1.0, -1.0, 1.0])
    values = landscape([np.zeros(6), 10.0 * gains], np.full(6, 10))
    seen = replace(values, detectable=np.array([[2.0] * 6, 2.0 + np.sign(gains)]))
    found = gain_finding(beside(seen, BASELINE, FIRST), judges(6))
    assert found.verdict == verdict
    assert (found.numbers["gain_over_baseline"], found.numbers["blocks"]) == (pytest.approx(middle), 6)
    reach = 2.015 * spread / np.sqrt(5.0)  # Student's t of 5 degrees times the standard error
    assert found.numbers["gain_over_baseline_interval_90"] == pytest.approx([middle - reach, middle + reach], abs=1e-3)
    assert found.numbers["detectable_share_gained"] == pytest.approx(0.1 * np.sign(gains).mean())


def test_too_little_traffic_for_an_interval_of_the_gain():
    few = Landscape(np.array([[0.0], [0.3]]), np.ones(1, dtype=int), detectable=np.array([[0.0], [1.0]]))
    found = gain_finding(beside(few, BASELINE, FIRST), judges(1))
    assert found.verdict == UNDECIDED
    assert found.text == "100.0 % detectable, the baseline's 0.0 %: too little traffic for an interval"


# --- what would see as many with lorries ------------------------------------------------------------------------------


@pytest.mark.parametrize("judging", [HELD_OUT, SEARCHED])
def test_a_height_for_lorries_has_an_interval_on_frames_that_did_not_choose_it_alone(judging):
    """Eight blocks of ten vehicles: 5 detectable, 8 from higher up, 9 from the other side."""
    blocks, wiggle = 8, np.array([-1.0, 1.0] * 4)
    detectable = np.array([np.full(blocks, 2.0), np.full(blocks, 5.0), 8.0 + wiggle, np.full(blocks, 9.0)])
    lorries = Landscape(detectable, np.full(blocks, 10), detectable=detectable)
    recorded = Landscape(detectable[:2], np.full(blocks, 10), detectable=detectable[:2] + 3.0)
    change = ("traffic", "higher for lorries in the nearest lane", "100 %")
    found = repair_finding(change, recorded, lorries, judges(blocks), "6.00 m, tilt 28 deg", judging)
    assert found.verdict is None
    assert found.text.startswith("50.0 % detectable, without these lorries 80.0 %; at 6.00 m, tilt 28 deg 80.0 %, 30.0")
    assert "on the other side of the road 90.0 %, 40.0 (" in found.text
    assert found.text.endswith("held-out ones" if judging == HELD_OUT else "without an independent check")
    assert (found.numbers["higher_gain_interval_90"] is not None) == (judging == HELD_OUT)
    assert found.numbers["other_side_gain_interval_90"] is not None
    if judging == HELD_OUT:
        low, high = found.numbers["higher_gain_interval_90"]
        assert low < 0.3 < high


# --- the other sections -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("aim", "together"), [("mean", 0.16875), ("low", 0.3)])
def test_an_installer_is_told_what_each_error_costs(aim, together):
    """Ten installations that lose 0 to a third of a gain of 1: the mean, or the one that one in ten is worse than."""
    levels = [0.0, 1.0, 0.99, 1.0, 0.8, 1.0, 0.9, 0.9, *(1.0 - 0.3 * np.arange(10) / 8)]
    vehicles, noise = 100, np.random.default_rng(0).normal(size=20)
    values = vehicles * (np.array(levels)[:, None] + 0.001 * noise)
    hung = Landscape(values, np.full(20, vehicles), detectable=values)
    lines = installation_findings(hung, [replace(INSTALLER, aim=aim)], judges(20))
    names = [f"{one.what} {one.value}" for one in lines]
    assert names[:3] == ["height 0.05 m less", "height 0.05 m more", "tilt across the road 1 deg less"]
    assert [one.verdict for one in lines[:4]] == [AT_MOST_FRAGILE, STABLE, FAILS, STABLE]  # the first loses 1 point
    assert lines[2].numbers["loss"] == pytest.approx(0.2)
    assert lines[-1].numbers["detectable_share_lost"] == pytest.approx(together)


def answer(tilt):
    return {"seed": 1, "mounting": {**REFERENCE, "tilt_x_deg": tilt}, "evaluations": 12}


def test_a_search_is_judged_by_the_mean_of_its_seeds():
    draws = [noisy((0.0, level, 1.0), 12, 1, 0.0, share=(0.2, 0.7, 0.7)) for level in (1.0, 0.98, 0.7)]
    found = search_finding([answer(tilt) for tilt in (10.0, 11.0, 20.0)], draws, judges(12))
    assert found.numbers["loss"] == pytest.approx(0.32 / 3.0)
    assert found.text.endswith("of the gain; height 4.00 m, tilt 10.0 to 20.0 deg")
