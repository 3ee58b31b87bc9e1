"""Metrics that learn where vehicles drive: against slow loops, their identities, and what their signs reward."""

from __future__ import annotations

import math

import numpy as np
import pytest

from blender_lidar.errors import InputError
from blender_lidar.metrics.occupancy_prior import (
    OccupiedFrames,
    bernoulli_entropy,
    box_visibility,
    reach_probability,
)
from blender_lidar.metrics.voxel_grid import VoxelGrid, covered_voxels, traverse

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


def test_a_voxel_that_is_always_occupied_is_certain(occupied):
    always = [np.union1d(frame, [5]) for frame in occupied]
    prior = OccupiedFrames(always, len(GRID), np.arange(1, 13)).prior
    assert prior[5] == 1.0
    assert bernoulli_entropy(prior)[5] == 0.0


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


def test_a_frames_surprisal_is_that_of_the_state_of_every_covered_voxel(occupied):
    frames = OccupiedFrames(occupied, len(GRID))
    covered = covered_voxels(GRID, MOUNT, fan(), 12.0)
    for number, inside in enumerate(occupied):
        state = np.isin(np.arange(len(GRID)), inside)
        terms = [
            -math.log(p if filled else 1.0 - p)
            for p, filled, met in zip(frames.prior.tolist(), state, covered, strict=True)
            if met and 0.0 < p < 1.0
        ]
        assert frames.surprisal(covered)[number] == pytest.approx(sum(terms), rel=1e-12)


def test_a_sensor_that_sees_nothing_gets_the_best_published_score(occupied):
    """S-MIG and M-SOG as printed reward turning away; the positive form does not."""
    frames = OccupiedFrames(occupied, len(GRID))
    road = covered_voxels(GRID, MOUNT, fan(), 12.0)
    sky = covered_voxels(GRID, MOUNT, fan() * [1.0, 1.0, 0.0] + [0.0, 0.0, 2.0], 12.0)
    assert not sky.any()
    for published in (s_mig, m_sog):
        assert published(frames, sky) == 0.0 > published(frames, road)
    assert covered_entropy(frames, sky) == 0.0 < covered_entropy(frames, road)


def test_every_further_beam_lowers_s_mig_and_certain_air_raises_m_sog(occupied):
    frames = OccupiedFrames(occupied, len(GRID))
    few, more = (covered_voxels(GRID, MOUNT, fan()[:count], 12.0) for count in (40, 150))
    assert s_mig(frames, more) < s_mig(frames, few)
    assert covered_entropy(frames, more) > covered_entropy(frames, few)
    with_air = few | (frames.prior == 0.0)
    assert m_sog(frames, with_air) > m_sog(frames, few)
    assert covered_entropy(frames, with_air) == pytest.approx(covered_entropy(frames, few))


def test_a_second_beam_through_the_same_voxels_changes_nothing(occupied):
    frames = OccupiedFrames(occupied, len(GRID))
    once, twice = (covered_voxels(GRID, MOUNT, np.tile(fan(30), (times, 1)), 12.0) for times in (1, 2))
    assert covered_entropy(frames, once) == covered_entropy(frames, twice) > 0.0


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


def test_a_wall_hides_what_lies_behind_it_and_nothing_hides_on_an_empty_road():
    across = VoxelGrid((0.0, 2.0, 0.0), (1, 10, 1), 0.4)
    beam, low = np.array([[0.0, 1.0, 0.0]]), np.array([0.2, 0.0, 0.2])
    assert reach_probability(across, np.zeros(10), low, beam, 9.0).tolist() == [1.0] * 10
    wall = np.eye(10)[4]
    assert reach_probability(across, wall, low, beam, 9.0).tolist() == [1.0] * 5 + [0.0] * 5
    assert expected_visibility(wall, reach_probability(across, wall, low, beam, 9.0)) == 1.0
    half = np.full(10, 0.5)
    np.testing.assert_allclose(reach_probability(across, half, low, beam, 9.0), 0.5 ** np.arange(10))


def test_no_voxel_counts_for_more_than_its_probability_and_more_beams_never_see_less(occupied):
    prior = OccupiedFrames(occupied, len(GRID)).prior
    few, more = (reach_probability(GRID, prior, MOUNT, fan()[:count], 12.0) for count in (50, 150))
    assert (more >= few).all()
    assert more.max() <= 1.0
    assert expected_visibility(prior, few) < expected_visibility(prior, more) < prior.sum()
    np.testing.assert_array_equal(more > 0.0, covered_voxels(GRID, MOUNT, fan(), 12.0))


def test_a_higher_mount_expects_to_see_more_of_dense_traffic():
    lanes = [
        GRID.in_boxes(np.array([[0.0, y, 0.8] for y in (3.5, 7.0)]), np.full((2, 3), [11.0, 2.0, 1.6]), np.zeros(2))
    ]
    prior = 0.5 * OccupiedFrames(lanes, len(GRID)).prior
    low, high = (
        expected_visibility(prior, reach_probability(GRID, prior, np.array([0.0, 0.0, z]), toward_road(z), 30.0))
        for z in (1.0, 4.5)
    )
    assert high > 1.3 * low


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
