"""The search over several fidelities, on made-up objectives: what it finds, spends and refuses."""

from __future__ import annotations

import numpy as np
import pytest

from blender_lidar.errors import InputError
from blender_lidar.optimise import make_search
from blender_lidar.optimise.multi_fidelity import MultiFidelitySearch, Rung
from blender_lidar.run.optimise import screening
from blender_lidar.scoring.fidelity import Fidelity, spread_order

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
