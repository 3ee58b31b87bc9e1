"""The rungs of a search from cheap to dear: which frames they take, how they thin beams, and what goes on."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest

from blender_lidar.scenario import load_scenario
from blender_lidar.study.fidelity import Fidelity
from blender_lidar.study.halving import diverse, survivors
from blender_lidar.study.rungs import coarse_observation, coarsest_stride, far_apart, make_rungs, spread_order
from blender_lidar.study.site import prepare
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


def test_the_stride_is_a_power_of_two_that_leaves_about_four_thousand_beams(site):
    stride, lattice = coarsest_stride(site.observation), site.observation.lattice
    assert math.log2(stride).is_integer()
    assert 2800 <= lattice.columns * lattice.rings / stride < 5700


def test_diverse_candidates_begin_with_the_best_and_keep_apart_while_they_can():
    rng = np.random.default_rng(1)
    x = rng.random((200, 2))
    values = -np.square(x - 0.5).sum(axis=1)
    rows = diverse(x, values, 10, 0.1, np.zeros(2), np.ones(2))
    assert rows[0] == np.argmax(values)
    apart = np.abs(x[rows][:, None] - x[rows]).max(axis=2) + np.eye(10)
    assert apart.min() > 0.1
    crowded = diverse(x / 1e6, values, 10, 0.1, np.zeros(2), np.ones(2))
    assert len(set(crowded.tolist())) == 10


def test_the_same_mounting_is_not_taken_twice():
    x = np.repeat([[0.2], [0.7]], 3, axis=0)
    assert sorted(diverse(x, np.arange(6.0), 5, 0.1, np.zeros(1), np.ones(1)).tolist()) == [2, 5]


def test_what_is_clearly_behind_is_dropped_and_what_is_not_stays():
    rng = np.random.default_rng(2)
    shared, block = rng.normal(0.0, 50.0, 24), np.arange(24) // 2  # what all candidates meet alike
    lead = np.array([0.0, 0.1, 5.0])[:, None]
    objective = shared - lead + rng.normal(0.0, 0.5, (3, 24))
    kept = survivors(objective, block, 3, tell_apart=True)
    assert set(kept.tolist()) == {0, 1}
    assert set(survivors(objective, block, 3, tell_apart=False).tolist()) == {0, 1, 2}


def test_no_more_go_on_than_may_and_the_best_is_always_among_them():
    objective = np.random.default_rng(3).normal(size=(20, 12))
    for block in (np.zeros(12), np.arange(12) // 6, np.arange(12)):
        kept = survivors(objective, block, 5, tell_apart=True)
        assert len(kept) <= 5
        assert kept[0] == objective.sum(axis=1).argmax()


def test_candidates_that_are_equal_on_every_frame_all_stay():
    assert len(survivors(np.ones((4, 6)), np.arange(6), 4, tell_apart=True)) == 4
