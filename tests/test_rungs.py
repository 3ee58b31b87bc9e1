"""The rungs of a search from cheap to dear: which frames they take, how they thin beams, and what goes on."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest

from blender_lidar.optimise.multi_fidelity import (
    ALL,
    BUT_PEAKS,
    NONE,
    clearly_behind,
    climb_starts,
    diverse,
    going_on,
    peaks,
    survivors,
)
from blender_lidar.scene.scenario import load_scenario
from blender_lidar.scene.site import prepare
from blender_lidar.scoring.fidelity import (
    Fidelity,
    coarse_observation,
    far_apart,
    make_rungs,
    spread_order,
)
from tests.small_scene import write_scene


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
