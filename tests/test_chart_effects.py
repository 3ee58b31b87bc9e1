"""Ablations: what each changes, and what leaving a thing out of the model costs."""

from __future__ import annotations

import pickle
from dataclasses import replace

import numpy as np
import pytest

from blender_lidar.report.chart import ablation_cells
from blender_lidar.scene.scenario import load_scenario
from blender_lidar.scene.site import prepare
from blender_lidar.sensors.model import load_model
from blender_lidar.studies.candidates import Candidates
from blender_lidar.studies.chart import ablation_row
from blender_lidar.studies.driver import Job, Landscape, landscapes
from blender_lidar.studies.effects import NEEDED, NOT_NEEDED, UNDECIDED, Reference, compared, regret, verdict
from blender_lidar.studies.variations import Ablation, ablations, without_offsets
from tests.small_scene import MAPPED, mounting, traffic_rows, write_scene, write_table

BLOCKS, MOUNTINGS = 12, 16
LAYOUTS = tuple((mounting({"height_m": height, "tilt_x_deg": tilt}),) for height, tilt in ((3.0, 14.0), (4.4, 6.0)))
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


def effects(draws: list[Draw], reference: Reference) -> dict:
    found = compared(draws, reference)
    lost = found["lost"]
    return found | {"regret": lost and lost.share, "regret_interval_90": lost and lost.interval_90}


def found_in(*draws: Draw) -> dict:
    return effects(draws, reference_of(draws[0]))


# --- effects ----------------------------------------------------------------------------------------------------------


def test_a_shift_of_all_scores_is_a_bias_alone_and_no_shift_is_none():
    for shift in (0.0, 0.25):
        found = found_in(draw(1, shift=shift))
        assert (found["bias"], found["tau"]) == (pytest.approx(-shift), pytest.approx(1.0))
        assert (found["regret"], found["regret_interval_90"]) == (0.0, (0.0, 0.0))


def test_a_choice_that_is_worth_half_of_the_gain_costs_half():
    """Without the thing the order is turned round: the last is chosen, worth as much as the baseline and half of 2."""
    worth = np.linspace(0.0, 1.0, MOUNTINGS)[:, None] * np.ones((1, BLOCKS))
    found = found_in((landscape(worth[::-1]), landscape(worth), landscape(worth)))
    assert (found["regret"], found["regret_interval_90"]) == (pytest.approx(0.5), pytest.approx((0.5, 0.5)))
    assert found["tau"] == pytest.approx(-1.0)
    np.testing.assert_array_equal(found["chosen"], np.eye(MOUNTINGS)[[0, -1]])


def test_what_several_draws_change_is_the_mean_and_what_they_lose_is_judged_together():
    draws = [draw(seed, noise=0.5, shift=shift) for seed, shift in ((1, 0.1), (2, 0.3))]
    together = effects(draws, reference_of(draws[0]))
    apart = [effects([one], reference_of(draws[0])) for one in draws]
    for key in ("bias", "tau", "regret"):
        assert together[key] == pytest.approx(np.mean([one[key] for one in apart]))
    low, high = together["regret_interval_90"]
    assert low < together["regret"] < high


def test_what_is_judged_in_two_blocks_has_no_interval_and_what_gains_nothing_no_loss():
    assert found_in(draw(1, noise=0.5, judges=2))["regret_interval_90"] is None
    one = draw(1, noise=0.5)
    worse = replace(one[2], objective=np.concatenate([np.full((1, 8), 20.0), one[2].objective[1:]]))
    assert found_in((*one[:2], worse))["regret"] is None  # where the baseline is better than all


def test_the_interval_of_a_loss_covers_the_truth_about_as_often_as_it_says():
    """A choice that is worth 0.2 less, of a gain of 2, in every third of judging blocks that differ."""
    held, best, other = 0, np.eye(MOUNTINGS)[15], np.eye(MOUNTINGS)[12]
    for seed in range(200):
        luck = 0.2 * np.random.default_rng(seed).normal(size=(MOUNTINGS, 12))
        judged = landscape(np.linspace(0.0, 1.0, MOUNTINGS)[:, None] + luck)
        low, high = regret([other], [best], [judged], np.arange(12)).interval_90
        held += low <= 0.1 <= high
    assert 0.84 <= held / 200 <= 0.96


# --- verdicts and rows ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("interval", "expected"),
    [
        ((0.011, 0.2), NEEDED),
        ((-0.3, 0.01), NOT_NEEDED),
        ((0.0, 0.011), UNDECIDED),
        ((-0.5, 0.5), UNDECIDED),
        (None, UNDECIDED),
    ],
)
def test_a_thing_is_needed_or_not_by_the_whole_interval_of_what_is_lost(interval, expected):
    assert verdict(interval, 0.01) == expected


def row_of(noise: float, shift: float = 0.0, blocks: int = BLOCKS, refused: str | None = None) -> dict:
    one = draw(1, noise, shift, blocks)
    every = Candidates(("height_m",), np.linspace(2.0, 5.0, MOUNTINGS)[:, None], (None,) * (1 + MOUNTINGS))
    change = Ablation("thing", "big", ((None, None),))
    return ablation_row(change, refused, [] if refused else [one], every, reference_of(one), 0.01)


def test_a_great_shift_is_beyond_the_noise_in_the_score_and_needs_nothing_else():
    row = row_of(0.0, shift=0.5)
    assert row["beyond_noise"] == {"score": True, "ranking": False}
    assert (row["shift"], row["verdict"]) == ({"height_m": 0.0}, NOT_NEEDED)
    assert ablation_cells(row)[-2:] == ("score", NOT_NEEDED)
    assert ablation_cells(row_of(0.0))[-2:] == ("nothing", NOT_NEEDED)


def test_noise_that_turns_the_order_round_is_beyond_in_the_ranking_and_moves_the_choice():
    row = row_of(3.0)
    assert row["beyond_noise"]["ranking"]
    assert row["regret"] > 0.01
    assert row["shift"]["height_m"] > 0.0  # with the thing the highest is chosen


def test_with_too_few_blocks_for_a_floor_numbers_are_given_and_none_is_beyond():
    row = row_of(0.0, shift=0.5, blocks=3)
    assert (row["bias"], row["beyond_noise"]) == (pytest.approx(0.5), None)
    assert ablation_cells(row)[-2] == "not known"


def test_a_side_that_cannot_be_had_is_told_of_in_its_words():
    row = row_of(0.0, refused="the sensor is imperfect")
    assert (row["note"], row["bias"], row["verdict"]) == ("the sensor is imperfect", None, None)


# --- the ablations of a scene -----------------------------------------------------------------------------------------


def test_every_ablation_can_be_sent_to_a_worker_and_has_a_name_of_its_own(site):
    changes = ablations(site, 3)
    sides = {one.stage: one for change in changes for pair in change.pairs for one in pair}
    assert len({(change.what, change.value) for change in changes}) == len(changes)
    assert [one.stage for one in pickle.loads(pickle.dumps(list(sides.values())))] == list(sides)
    wanted = "median barrier, body shape, finer shape, glass drop-out, azimuth offsets, range noise, drop-out"
    wanted += ", weak returns, unit spread"
    assert {change.what for change in changes} >= set(wanted.split(", "))


def test_ablations_change_scores(site):
    """At 20 m from two lanes weak returns need not matter."""
    for change in ablations(site, 1):
        if change.pairs and change.what != "weak returns":
            both = [next(landscapes(site, [Job(one, LAYOUTS)])).objective for one in change.pairs[0]]
            assert not np.allclose(*both, rtol=1e-9), change


def test_offsets_left_out_are_all_0_and_the_other_rings_keep_their_beams(tmp_path):
    settings = {**MAPPED, "sensor": {"name": "RS-80", "rotation_hz": 10.0}}
    site = prepare(load_scenario(write_scene(tmp_path, settings)))
    assert load_model("RS-80").azimuth_offset_rad.any()
    level = without_offsets(site).observation.lattice
    assert not level.slot_azimuth0_rad.any()
    assert not level.shift.any()
    np.testing.assert_array_equal(level.elevation_rad, site.observation.lattice.elevation_rad)
    assert level.columns == site.observation.lattice.columns
    assert all(one.pairs for one in ablations(site, 1))


def test_a_sensor_without_offsets_says_so(site):
    (change,) = (one for one in ablations(site, 2) if one.what == "azimuth offsets")
    assert (change.pairs, change.note) == ((), "the beam table of the RS-16 has none")


def test_a_sensor_that_is_imperfect_at_random_is_drawn_several_times_and_no_other_is(site):
    changes = {one.what: one for one in ablations(site, 3)}
    drawn = {what for what, change in changes.items() if len(change.pairs) == 3}
    assert drawn == {"glass drop-out", "range noise", "drop-out", "unit spread"}
    assert all(len(change.pairs) == 1 for what, change in changes.items() if what not in {*drawn, "azimuth offsets"})
    for what in drawn:
        perfect, imperfect = zip(*changes[what].pairs, strict=True)
        assert len({one.stage for one in perfect}) == 1
        scores = [next(landscapes(site, [Job(one, LAYOUTS)])).objective for one in imperfect]
        assert not np.allclose(scores[0], scores[1])


@pytest.mark.parametrize("key", ["glass_dropout", "dropout"])
def test_what_the_scene_has_is_left_out_once_and_both_sides_draw_the_same(key, tmp_path):
    write_table(tmp_path / "traffic.csv", traffic_rows())
    noisy = prepare(load_scenario(write_scene(tmp_path, {**MAPPED, "sensor": {key: 0.2, "unit_spread_deg": 0.1}})))
    changes = ablations(noisy, 2)
    assert len({(one.what, one.value) for one in changes}) == len(changes)
    ours = [one for one in changes if one.value == "0.2, as the scene has it"]
    assert len(ours) == 1
    for draw, (without, having) in enumerate(ours[0].pairs, start=1):
        left_out, there = (one.changed(noisy) for one in (without, having))
        assert (left_out.scenario.lidar.sensor.unit_spread_deg, left_out.observation.lidar.imperfections.seed) == (
            0.1,
            draw,
        )
        assert getattr(left_out.observation.lidar.imperfections, key) == 0.0
        assert getattr(there.observation.lidar.imperfections, key) == 0.2
        assert there.observation.lidar.imperfections.seed == draw
    spread = next(one for one in changes if one.what == "unit spread")
    assert [one.stage for _, one in spread.pairs] == [one.stage for _, one in ours[0].pairs]
