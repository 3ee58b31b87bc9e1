"""The search over several fidelities: what it finds, spends and refuses on made-up objectives; and its rungs."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

import tests.research  # noqa: F401
from blender_lidar.errors import InputError
from blender_lidar.optimise import make_search
from blender_lidar.optimise.multi_fidelity import (
    ALL,
    BUT_PEAKS,
    NONE,
    MultiFidelitySearch,
    Rung,
    clearly_behind,
    climb_starts,
    diverse,
    going_on,
    peaks,
    survivors,
)
from blender_lidar.run.searches import screening
from blender_lidar.scene.scenario import load_scenario
from blender_lidar.scene.site import prepare
from blender_lidar.scoring.evaluation import Evaluator
from blender_lidar.scoring.fidelity import (
    Fidelity,
    coarse_observation,
    far_apart,
    make_rungs,
    spread_order,
)
from rival_metrics import OPTIONS
from tests.small_scene import write_scene

FRAMES = 40
BLOCK = np.arange(FRAMES) // 4


def made_rungs(frames=FRAMES, climb=24, screen_climb=48):
    order = spread_order(BLOCK[:frames], np.ones(frames))
    coarse, finer = Fidelity("body", 8), Fidelity("body", 4)
    return (
        Rung(coarse, order[:8], climb=screen_climb),
        Rung(coarse, order[:16], candidates=24),
        Rung(finer, order[:32], candidates=12),
        Rung(finer, order, candidates=6, climb=climb),
        Rung(Fidelity("body"), order, candidates=8, climb=climb),
    )


def made_search(d=2, seed=1, **given):
    lower, upper = np.full(d, -1.0), np.full(d, 3.0)
    screen = make_search("hardened", lower, upper, seed=seed, evaluations=screening(d))
    return MultiFidelitySearch(screen, made_rungs(**given), BLOCK, seed=seed)


def objective(asked, bias=0.0):
    """A peak at 1 in every variable, frames that are worth more or less, and a ripple that coarse rungs do not see."""
    worth = 1.0 + 0.3 * np.sin(np.array(asked.frames))
    value = -np.square(asked.x - 1.0).sum(axis=1)
    return value[:, None] * worth + bias * np.cos(40.0 * asked.x.sum(axis=1))[:, None] / asked.fidelity.stride


def run(search, bias=0.0):
    while not search.done:
        search.tell(objective(search.ask(), bias))
    return search


@pytest.mark.parametrize("d", [1, 2, 3, 5])
def test_the_peak_is_found_in_any_number_of_variables(d):
    search = run(made_search(d))
    assert np.abs(search.best_x - 1.0).max() < 0.12 * d
    assert search.best_value == pytest.approx(search.history[:, -2].max())


def two_peaks(asked, reference_lead=1.0, cheap_lead=1.0):
    """Two hills 0.6 of the box apart; the reference ranks the one at 2.2 first, all cheaper rungs that at -0.2."""
    worth = 1.0 + 0.3 * np.sin(np.array(asked.frames))
    lead = -cheap_lead if asked.fidelity.stride > 1 else reference_lead
    hills = [10.0 * np.exp(-np.square((asked.x - at) / 0.6).sum(axis=1)) for at in (-0.2, 2.2)]
    return np.maximum(hills[0] * (1.0 - 0.05 * lead), hills[1] * (1.0 + 0.05 * lead))[:, None] * worth


@pytest.mark.parametrize("d", [1, 2])
def test_of_two_peaks_far_apart_that_of_the_reference_is_found_though_cheap_rungs_prefer_the_other(d):
    found = []
    for seed in range(1, 11):
        search = made_search(d, seed=seed)
        while not search.done:
            search.tell(two_peaks(search.ask()))
        found.append(np.abs(search.best_x - 2.2).max() < 0.12 * d)
    assert sum(found) >= 8  # the screen itself may not come near it


def test_where_the_reference_cannot_tell_two_peaks_apart_it_climbs_from_both():
    search, climbed = made_search(), []
    while not search.done:
        asked = search.ask()
        if search.stage.startswith("climb: body,"):
            climbed += asked.x[:, 0].tolist()
        unlike = 3.0 * (-1.0) ** BLOCK[list(asked.frames)]  # blocks disagree about the one peak
        search.tell(two_peaks(asked, 0.0, 0.0) + np.where(asked.x[:, :1] > 1.0, unlike, 0.0))
    assert {x > 1.0 for x in climbed} == {False, True}
    assert sum(row["candidates"] for row in search.spent) == search.evaluations <= search.budget


def test_a_frame_is_never_asked_for_twice_by_the_same_fidelity_and_mounting():
    search, met = made_search(), set()
    while not search.done:
        asked = search.ask()
        for x in asked.x.tolist():
            new = {(asked.fidelity.name, frame, *x) for frame in asked.frames}
            assert not new & met
            met |= new
        search.tell(objective(asked))


def test_what_is_recorded_has_met_every_frame_at_the_reference():
    search = run(made_search(), bias=0.2)
    history, worth = search.history, 1.0 + 0.3 * np.sin(np.arange(FRAMES))
    x = history[:, 3:-2]
    whole = -np.square(x - 1.0).sum(axis=1)[:, None] * worth + 0.2 * np.cos(40.0 * x.sum(axis=1))[:, None]
    np.testing.assert_allclose(history[:, -2], whole.sum(axis=1), rtol=1e-12)
    np.testing.assert_array_equal(history[:, -1], np.maximum.accumulate(history[:, -2]))
    assert history[:, 0].tolist() == list(range(1, len(history) + 1))


def test_it_spends_a_small_share_of_what_a_search_at_the_reference_does():
    search = run(made_search())
    casts = search.spent[-1]["frame_casts"]
    assert casts < 2000 * FRAMES / 30
    assert search.evaluations <= search.budget
    assert sum(row["candidates"] for row in search.spent) == search.evaluations


def test_made_anew_and_told_the_same_it_asks_for_the_same():
    first, again = made_search(), made_search()
    while not first.done:
        asked, other = first.ask(), again.ask()
        assert (asked.fidelity, asked.frames) == (other.fidelity, other.frames)
        assert np.array_equal(asked.x, other.x)
        first.tell(objective(asked, 0.2), 0.5)
        again.tell(objective(asked, 0.2).tolist(), 0.5)
    np.testing.assert_array_equal(first.history, again.history)
    assert first.spent == again.spent
    assert {row["seconds"] > 0.0 for row in first.spent} == {True}


@pytest.mark.parametrize("frames", [1, 2, 9])
def test_few_frames_make_rungs_alike_and_are_searched_all_the_same(frames):
    search = run(made_search(frames=frames))
    assert np.abs(search.best_x - 1.0).max() < 0.3
    assert search.history.shape[0] >= 8


def test_a_flat_objective_ends():
    search = made_search()
    while not search.done:
        asked = search.ask()
        search.tell(np.zeros((len(asked.x), len(asked.frames))))
    assert search.best_value == 0.0


@pytest.mark.parametrize("wrong", [np.zeros(3), np.zeros((2, 8)), np.zeros(())])
def test_what_is_not_one_number_for_each_candidate_and_frame_is_refused(wrong):
    with pytest.raises(InputError, match="objective values: shape"):
        made_search().tell(wrong)


# --- rungs: which frames they take, how they thin beams, and what goes on ---------------------------------------------


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    return prepare(load_scenario(write_scene(tmp_path_factory.mktemp("rungs"))))


@pytest.mark.parametrize("count", [1, 2, 3, 5, 8, 13, 64, 100])
def test_an_order_that_is_far_apart_holds_each_number_once(count):
    assert sorted(far_apart(count)) == list(range(count))


@pytest.mark.parametrize(("frames", "blocks"), [(1, 1), (2, 2), (7, 3), (30, 9), (54, 27), (60, 7)])
def test_every_beginning_of_the_order_is_spread_evenly_over_blocks(frames, blocks):
    block = np.sort(np.arange(frames) % blocks)
    order = spread_order(block, np.ones(frames))
    assert sorted(order) == list(range(frames))
    for length in range(1, frames + 1):
        per_block = np.bincount(block[list(order[:length])], minlength=blocks)
        full = per_block == np.bincount(block, minlength=blocks)
        assert per_block[~full].max(initial=0) <= per_block.min(where=~full, initial=frames) + 1


def test_a_beginning_is_spread_over_time_too():
    order = spread_order(np.arange(64), np.ones(64))
    for length in (2, 4, 8, 16, 32):
        assert np.diff(np.sort(order[:length])).max() <= 64 / length + 1


def test_frames_in_which_nothing_counts_come_last():
    vehicles = [0, 3, 0, 2, 5, 0]
    order = spread_order([0, 0, 1, 1, 2, 2], vehicles)
    assert [vehicles[frame] > 0 for frame in order] == [True] * 3 + [False] * 3


@pytest.mark.parametrize("frames", [1, 2, 9, 33, 60])
def test_rungs_are_nested_and_end_at_the_reference(site, frames):
    rungs = make_rungs(site.observation, np.arange(frames) // 2, np.ones(frames), 2)
    assert rungs[-1].fidelity == Fidelity(site.observation.detail)
    assert sorted(rungs[-1].frames) == list(range(frames))
    for below, rung in pairwise(rungs):
        assert rung.frames[: len(below.frames)] == below.frames
        assert rung.fidelity.stride <= below.fidelity.stride


def test_cells_grow_with_the_stride_and_the_reference_stays_as_it_is(site):
    seen = site.observation
    assert coarse_observation(seen, Fidelity(seen.detail)).cell_m == seen.cell_m
    assert coarse_observation(seen, Fidelity(seen.detail)).lattice is seen.lattice
    coarse = coarse_observation(seen, Fidelity(seen.detail, stride=4))
    assert coarse.cell_m == pytest.approx(2.0 * seen.cell_m)
    assert coarse.lattice.columns == round(seen.lattice.columns / 4)


def test_diverse_candidates_begin_with_the_best_and_keep_apart_while_they_can():
    rng = np.random.default_rng(1)
    x = rng.random((200, 2))
    values = -np.square(x - 0.5).sum(axis=1)
    rows = diverse(x, values, 10, 0.1)
    assert rows[0] == np.argmax(values)
    apart = np.abs(x[rows][:, None] - x[rows]).max(axis=2) + np.eye(10)
    assert apart.min() > 0.1
    assert len(set(diverse(x / 1e6, values, 10, 0.1))) == 10


def test_the_same_mounting_is_not_taken_twice():
    x = np.repeat([[0.2], [0.7]], 3, axis=0)
    assert sorted(diverse(x, np.arange(6.0), 5, 0.1)) == [2, 5]


@pytest.mark.parametrize("d", [1, 2, 4])
def test_a_peak_is_the_best_of_all_within_its_reach(d):
    rng = np.random.default_rng(d)
    x, values = rng.random((120, d)), rng.normal(size=120)
    found = peaks(x, values)
    near = np.abs(x[:, None] - x).max(axis=2) <= 0.15
    assert found.tolist() == sorted(found, key=lambda row: -values[row])
    assert set(found) == {row for row in range(120) if values[row] == values[near[row]].max()}


def two_basins():
    """Thirty candidates about 0.2 that are all better than three about 0.8, on eight blocks that agree."""
    x = np.concatenate([np.linspace(0.15, 0.25, 30), [0.78, 0.8, 0.82]])[:, None]
    value = np.concatenate([10.0 - np.abs(x[:30, 0] - 0.2), [8.0, 8.1, 8.0]])
    return x, value[:, None] + np.random.default_rng(1).normal(0.0, 0.01, (33, 8))


@pytest.mark.parametrize("drops", [NONE, BUT_PEAKS])
def test_a_far_peak_goes_on_with_the_best_though_thirty_others_are_better(drops):
    x, objective = two_basins()
    kept = going_on(x, objective, np.arange(8), 6, distance=0.006, drops=drops)
    assert 31 in kept
    assert (kept >= 30).sum() == 1
    assert len(kept) == 6
    totals = objective[kept].sum(axis=1)
    assert totals.tolist() == sorted(totals, reverse=True)


def test_a_far_peak_that_is_clearly_behind_is_dropped_where_the_rung_is_the_reference():
    x, objective = two_basins()
    assert (going_on(x, objective, np.arange(8), 6, distance=0.006, drops=ALL) < 30).all()


def test_a_climb_starts_from_the_far_peak_too_unless_that_is_clearly_behind():
    x, objective = two_basins()
    assert climb_starts(x, objective, np.arange(8), likely=True).tolist() == [objective.sum(axis=1).argmax()]
    objective[30:] += np.where(np.arange(8) % 2, 4.0, 0.0) - 0.2  # better in half of the blocks
    assert climb_starts(x, objective, np.arange(8), likely=True).tolist()[1:] == [
        objective[30:].sum(axis=1).argmax() + 30
    ]


def test_what_is_clearly_behind_is_dropped_and_what_is_not_stays():
    rng = np.random.default_rng(2)
    shared, block = rng.normal(0.0, 50.0, 24), np.arange(24) // 2  # what all candidates meet alike
    lead = np.array([0.0, 0.1, 5.0])[:, None]
    objective = shared - lead + rng.normal(0.0, 0.5, (3, 24))
    assert set(survivors(objective, block, 3).tolist()) == {0, 1}


@pytest.mark.parametrize("compared", [1, 5, 23])
def test_of_equals_any_is_called_clearly_behind_in_one_case_in_twenty_at_most(compared):
    """One fixed candidate leads them, so that it is not the luckiest: the bound is for that."""
    rng = np.random.default_rng(compared)
    wrong = [clearly_behind(rng.normal(size=(compared + 1, 10)), np.arange(10), compared).any() for _ in range(1000)]
    assert np.mean(wrong) < 0.05 + 3.0 * math.sqrt(0.05 * 0.95 / 1000)


def test_no_more_go_on_than_may_and_the_best_is_always_among_them():
    rng = np.random.default_rng(3)
    x, objective = rng.random((20, 2)), rng.normal(size=(20, 12))
    for block in (np.zeros(12), np.arange(12) // 6, np.arange(12)):
        for kept in (
            survivors(objective, block, 5),
            *(going_on(x, objective, block, 5, distance=0.05, drops=drops) for drops in (ALL, BUT_PEAKS, NONE)),
        ):
            assert len(kept) == len(set(kept.tolist())) <= 5
            assert kept[0] == objective.sum(axis=1).argmax()


def test_on_a_circle_two_candidates_beside_its_seam_are_one_peak():
    x, values = np.array([[0.001], [0.999], [0.5]]), np.array([3.0, 2.9, 1.0])
    assert peaks(x, values).tolist() == [0, 1, 2]
    assert peaks(x, values, np.array([True])).tolist() == [0, 2]
    assert diverse(x, values, 2, 0.1, periodic=np.array([True])) == [0, 2]


@pytest.mark.parametrize("metric", ["view-coverage", OPTIONS["voxel_entropy_10_cm"]])
def test_cells_of_a_metrics_own_grow_with_thinned_beams(metric, tmp_path):
    site = prepare(load_scenario(write_scene(tmp_path), {("objective", "metric"): (metric, "here")}))
    layouts = [
        (site.scenario.mounting({"height_m": h, "tilt_x_deg": t}),) for h in (2.5, 4.4) for t in (2.0, 10.0, 20.0)
    ]
    with Evaluator(site.search, site.observation, site.scoring) as evaluator:
        full = evaluator.totals(layouts).per_vehicle()
        thinned = evaluator.totals(layouts, fidelity=Fidelity("body", 4)).per_vehicle()
        fixed = replace(coarse_observation(site.observation, Fidelity("body", 4)), cell_growth=1.0)
    with Evaluator(site.search, fixed, site.scoring) as evaluator:
        as_they_are = evaluator.totals(layouts).per_vehicle()
    assert np.corrcoef(full, thinned)[0, 1] > np.corrcoef(full, as_they_are)[0, 1]
