"""Metrics that learn where vehicles drive: against slow loops, their identities, and what their signs reward."""

from __future__ import annotations

import math

import numpy as np
import pytest

import tests.research  # noqa: F401
from blender_lidar.errors import InputError
from occupancy_prior import (
    OccupiedFrames,
    bernoulli_entropy,
    box_visibility,
    reach_probability,
)
from voxel_grid import VoxelGrid, covered_voxels, traverse

GRID = VoxelGrid((-6.0, 2.0, 0.0), (30, 18, 5), 0.4)
MOUNT = np.array([0.0, 0.0, 3.1])


def traffic(rng, frames=12):
    """Boxes of some frames, two of which may overlap: centres, sizes, headings."""
    for _ in range(frames):
        n = int(rng.integers(1, 5))
        size = rng.uniform([3.5, 1.6, 1.3], [5.5, 2.1, 2.2], (n, 3))
        centre = np.column_stack([rng.uniform(-6, 6, n), rng.choice([3.5, 7.0], n), 0.5 * size[:, 2]])
        yield centre, size, rng.normal(0.0, 0.2, n)


def fan(count=150, seed=5):
    """Beams from above the roadside, most of them over the road."""
    directions = np.random.default_rng(seed).normal([0.0, 1.0, -0.3], [1.0, 0.3, 0.3], (count, 3))
    return directions / np.linalg.norm(directions, axis=1, keepdims=True)


@pytest.fixture(scope="module")
def occupied():
    return [GRID.in_boxes(*boxes) for boxes in traffic(np.random.default_rng(1))]


# --- the prior --------------------------------------------------------------------------------------------------------


def test_the_prior_is_the_share_of_frames_in_which_a_voxel_is_in_a_box(occupied):
    prior = OccupiedFrames(occupied, len(GRID)).prior
    for voxel in range(0, len(GRID), 7):
        assert prior[voxel] == pytest.approx(sum(voxel in frame for frame in occupied) / 12, abs=1e-15)
    assert 0.2 < prior.max() < 1.0
    assert (prior == 0.0).any()


def test_a_weight_counts_a_frame_as_often_as_it_says(occupied):
    weights = np.array([2, 0, 1, 3, 0, 1, 0, 0, 0, 5, 0, 0])
    repeated = [frame for frame, times in zip(occupied, weights, strict=True) for _ in range(times)]
    weighted = OccupiedFrames(occupied, len(GRID), weights)
    np.testing.assert_allclose(weighted.prior, OccupiedFrames(repeated, len(GRID)).prior, atol=1e-15)


@pytest.mark.parametrize(
    ("occupied", "weights", "message"),
    [
        ([], None, "of 0 frames none counts"),
        ([np.array([1])], [0.0], "of 1 frames none counts"),
    ],
)
def test_frames_that_teach_nothing_are_refused(occupied, weights, message):
    with pytest.raises(InputError, match=message):
        OccupiedFrames(occupied, 9, weights)


# --- entropies --------------------------------------------------------------------------------------------------------


def slow_entropy(p):
    return -sum(q * math.log(q) for q in (p, 1.0 - p) if 0.0 < q < 1.0)


def covered_entropy(frames, covered):
    """What the frames that taught a prior are surprised by in the mean: H(POG | L)."""
    return np.average(frames.surprisal(covered), weights=frames.weights)


def s_mig(frames, covered):
    return -covered_entropy(frames, covered)


def m_sog(frames, covered):
    return -covered_entropy(frames, covered) / max(covered.sum(), 1)


def expected_visibility(prior, reached):
    """Sum of p_k prod_{j<k} (1 - p_j)."""
    return math.fsum(prior * reached)


@pytest.mark.parametrize("weights", [None, [3, 1, 4, 1, 5, 9, 2, 6, 5, 3, 5, 0]])
def test_the_mean_surprisal_of_the_frames_that_taught_the_prior_is_the_entropy(occupied, weights):
    frames = OccupiedFrames(occupied, len(GRID), weights)
    covered = covered_voxels(GRID, MOUNT, fan(), 12.0)
    terms = [slow_entropy(p) for p, met in zip(frames.prior.tolist(), covered, strict=True) if met]
    assert frames.surprisal(covered).shape == (12,)
    assert np.ptp(frames.surprisal(covered)) > 1.0
    assert covered_entropy(frames, covered) == pytest.approx(sum(terms), rel=1e-12)
    assert sum(terms) > 50.0


def test_the_entropy_of_an_even_chance_is_ln_2_and_of_certainty_0():
    np.testing.assert_allclose(bernoulli_entropy(np.array([0.0, 0.5, 1.0])), [0.0, math.log(2.0), 0.0])
    p = np.linspace(0.0, 1.0, 101)
    np.testing.assert_allclose(bernoulli_entropy(p), bernoulli_entropy(1.0 - p), atol=1e-15)


# --- expected visibility ----------------------------------------------------------------------------------------------


def slow_reach(grid, prior, origin, directions, farthest):
    """The strength of every beam in every voxel on its way, multiplied out by itself; the best one counts."""
    best, number = np.zeros(len(grid)), grid.with_rim(np.arange(1, len(grid) + 1)) - 1
    for direction in directions:
        walked = [int(number[voxel[0]]) for _, voxel in traverse(grid, origin, direction[None], farthest)]
        way = [voxel for voxel in walked if voxel >= 0]
        for place, voxel in enumerate(way):
            best[voxel] = max(best[voxel], math.prod(1.0 - prior[before] for before in way[:place]))
    return best


def test_visibility_equals_the_product_along_every_beam(occupied):
    prior = OccupiedFrames(occupied, len(GRID)).prior
    reached = reach_probability(GRID, prior, MOUNT, fan(), 12.0)
    expected = slow_reach(GRID, prior, MOUNT, fan(), 12.0)
    np.testing.assert_allclose(reached, expected, rtol=1e-12)
    assert ((reached > 0.01) & (reached < 0.9)).sum() > 50
    assert expected_visibility(prior, reached) == pytest.approx(sum(prior * expected), rel=1e-12)


def test_the_mean_number_of_voxels_expected_to_be_seen_is_the_visibility(occupied):
    weights = np.arange(12)
    frames = OccupiedFrames(occupied, len(GRID), weights)
    reached = reach_probability(GRID, frames.prior, MOUNT, fan(), 12.0)
    seen = frames.sums(reached)
    assert seen[3] == pytest.approx(sum(reached[voxel] for voxel in occupied[3]))
    assert np.average(seen, weights=weights) == pytest.approx(expected_visibility(frames.prior, reached), rel=1e-12)


def toward_road(height):
    """Beams from above the roadside to every voxel's centre: of any height as many."""
    directions = GRID.centres(np.arange(len(GRID))) - [0.0, 0.0, height]
    return directions / np.linalg.norm(directions, axis=1, keepdims=True)


def test_a_box_is_as_visible_as_its_voxels_in_the_mean(occupied):
    prior = OccupiedFrames(occupied, len(GRID)).prior
    reached = reach_probability(GRID, prior, MOUNT, toward_road(3.1), 30.0)
    boxes = (
        np.array([[-2.0, 3.5, 0.8], [0.0, 7.0, 0.8], [50.0, 0.0, 0.0]]),
        np.full((3, 3), [4.4, 1.8, 1.5]),
        np.zeros(3),
    )
    near, far, outside = box_visibility(GRID, reached, *boxes)
    assert near == pytest.approx(np.mean([reached[v] for v in GRID.in_boxes(*(part[:1] for part in boxes))]))
    assert 1.0 >= near > far > outside == 0.0
