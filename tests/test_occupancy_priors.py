"""Metrics that learn where vehicles drive, S-MIG, M-SOG and the voxels that beams cross, against slow loops."""

from __future__ import annotations

import math
from collections import Counter

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import tests.research  # noqa: F401
from blender_lidar.errors import InputError
from blender_lidar.metrics.metric import vehicle_returns
from occupancy_prior import (
    OccupiedFrames,
    VehiclePrior,
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


# --- single vehicles, and the prior of a vehicle's voxels -------------------------------------------------------------


def sample(seed, vehicles=30, points=60):
    """Vehicles of all sizes, seen from the left; the last returns nothing."""
    rng = np.random.default_rng(seed)
    size = rng.uniform([3.5, 1.5, 1.3], [6.0, 2.2, 2.4], (vehicles, 3))
    size[0] = 1.2, 0.5, 1.2
    vehicle = rng.integers(0, vehicles - 1, vehicles * points)
    local = rng.uniform(-0.5, 0.5, (len(vehicle), 3)) * size[vehicle]
    local[:, 1] = 0.5 * size[vehicle, 1] - np.abs(rng.normal(0.0, 0.1, len(vehicle)))
    local += rng.normal(0.0, 0.1, local.shape)  # some within reach of a face, some beyond
    return vehicle_returns(local, vehicle, size)


def slow_voxels(returns, voxel):
    """The voxels of each vehicle that hold a return, and all that its box has, as sets of indices from the centre."""
    for number, size in enumerate(returns.size_m):
        n = [max(1, math.ceil(side / 2 / voxel - 1e-9)) for side in size]
        filled = set()
        for point in returns.points[returns.vehicle == number]:
            if all(abs(x) <= side / 2 + voxel for x, side in zip(point, size, strict=True)):
                index = (math.floor(x / voxel) for x in point)
                filled.add(tuple(min(max(i, -count), count - 1) for i, count in zip(index, n, strict=True)))
        has = {(i, j, k) for i in range(-n[0], n[0]) for j in range(-n[1], n[1]) for k in range(-n[2], n[2])}
        yield filled, has


def slow_prior(returns, voxel):
    filled, boxes = Counter(), Counter()
    for holds, has in slow_voxels(returns, voxel):
        filled.update(holds)
        boxes.update(has)
    return {index: filled[index] / count for index, count in boxes.items()}


@pytest.mark.parametrize("voxel", [0.2, 0.35])
def test_the_prior_is_the_share_of_boxes_with_the_voxel_that_return_from_it(voxel):
    returns = sample(1)
    prior, expected = VehiclePrior.learn(returns, voxel), slow_prior(returns, voxel)
    middle = np.array(prior.p.shape) // 2
    for index, share in expected.items():
        assert prior.p[tuple(middle + index)] == pytest.approx(share, abs=1e-15)
    known = np.zeros(prior.p.shape, dtype=bool)
    known[tuple((middle + list(expected)).T)] = True
    assert (prior.p[~known] == 0.0).all()
    assert (prior.vehicles > 0).tolist() == known.tolist()
    assert prior.vehicles.max() == 30
    assert 0.2 < prior.p.max() <= 1.0


def test_scores_of_other_vehicles_are_sums_over_the_voxels_they_return_from():
    prior, expected = VehiclePrior.learn(sample(1)), slow_prior(sample(1), 0.2)
    others = sample(2, vehicles=12)
    entropy, published, mean = prior.covered_entropy(others), prior.s_mig(others), prior.m_sog(others)
    for number, (filled, _) in enumerate(slow_voxels(others, 0.2)):
        terms = [slow_entropy(expected.get(index, 0.0)) for index in filled]
        assert entropy[number] == pytest.approx(sum(terms), abs=1e-12)
        assert published[number] == pytest.approx(-sum(terms), abs=1e-12)
        assert mean[number] == pytest.approx(-sum(terms) / max(len(terms), 1), abs=1e-12)
    assert entropy[:-1].min() > 0.0


def test_a_vehicle_without_returns_gets_the_best_published_score():
    prior, others = VehiclePrior.learn(sample(1)), sample(2, vehicles=12)
    assert (others.count[-1], prior.covered_entropy(others)[-1]) == (0, 0.0)
    for published in (prior.s_mig(others), prior.m_sog(others)):
        assert published[-1] == 0.0 > published[:-1].max()
        assert not np.signbit(published[-1])


def test_a_prior_without_vehicles_points_or_bounds_is_refused():
    returns = sample(1)
    with pytest.raises(InputError, match="no vehicle to learn from"):
        VehiclePrior.learn(vehicle_returns(np.zeros((0, 3)), np.zeros(0, dtype=int), np.zeros((0, 3))))
    with pytest.raises(InputError, match="134,217,728 at most"):
        VehiclePrior.learn(returns, 1e-3)
    with pytest.raises(InputError, match="cell_m is 0"):
        VehiclePrior.learn(returns, 0.0)


# --- voxels in boxes and voxels crossed by beams, against tests of every voxel by itself ------------------------------


WALKED = VoxelGrid((-4.0, 1.2, 0.0), (20, 15, 6), 0.4)
LATTICE = [np.array(d) - 2 for d in np.ndindex(5, 5, 5) if d != (2, 2, 2)]  # along planes, edges and corners
TOUCH = 1e-9  # [m]: what is crossed by less may count or not


def unit(directions):
    return directions / np.linalg.norm(directions, axis=-1, keepdims=True)


def lengths_inside(grid, origin, direction, nearest, farthest, margin):
    """How far one beam runs within each voxel, grown by a margin, and where it enters it, (voxels,) each."""
    low = np.add(grid.low_m, np.indices(grid.counts).reshape(3, -1).T * grid.voxel_m) - margin
    enter, leave = np.full(len(low), nearest), np.full(len(low), farthest)
    for axis in range(3):
        high = low[:, axis] + grid.voxel_m + 2.0 * margin
        if direction[axis] == 0.0:
            leave[(origin[axis] < low[:, axis]) | (origin[axis] > high)] = -np.inf
            continue
        ends = np.sort((np.stack([low[:, axis], high], 1) - origin[axis]) / direction[axis], axis=1)
        enter, leave = np.maximum(enter, ends[:, 0]), np.minimum(leave, ends[:, 1])
    return leave - enter, enter


def crossed(grid, origin, direction, nearest, farthest):
    """The voxels that one beam crosses surely, and those that it crosses or touches: each tested by itself."""
    surely, _ = lengths_inside(grid, origin, direction, nearest, farthest, -TOUCH)
    perhaps, enter = lengths_inside(grid, origin, direction, nearest, farthest, TOUCH)
    return set(np.flatnonzero(surely > 0.0).tolist()), set(np.flatnonzero(perhaps >= 0.0).tolist()), enter


def paths(grid, origin, directions, nearest, farthest):
    """The voxels of each beam in the order of the walk, by number within the grid."""
    number = grid.with_rim(np.arange(1, len(grid) + 1)) - 1  # -1 in the rim
    found = [[] for _ in directions]
    for beams, voxel in traverse(grid, origin, directions, farthest, nearest):
        for beam, one in zip(beams, number[voxel], strict=True):
            found[beam].append(int(one))
    return found


origins = st.tuples(st.floats(-6.0, 6.0), st.floats(-1.0, 9.0), st.floats(-1.0, 4.0)) | st.sampled_from(
    [(0.0, 0.0, 2.0), (-4.0, 1.2, 0.0), (0.4, 2.0, 0.8), (4.0, 7.2, 2.4)]
)


@settings(max_examples=80)
@given(seed=st.integers(0, 2**32 - 1), origin=origins, nearest=st.sampled_from([0.0, 0.4, 3.0]))
def test_a_walk_crosses_every_voxel_that_a_slab_test_of_each_finds_once_and_in_their_order(seed, origin, nearest):
    rng = np.random.default_rng(seed)
    along = [LATTICE[number] for number in rng.integers(0, len(LATTICE), 6)]
    directions, origin = unit(np.concatenate([rng.normal(size=(4, 3)), along])), np.array(origin)
    for direction, path in zip(directions, paths(WALKED, origin, directions, nearest, 7.0), strict=True):
        surely, perhaps, enter = crossed(WALKED, origin, direction, nearest, 7.0)
        walked = [voxel for voxel in path if voxel >= 0]
        assert len(set(walked)) == len(walked)
        assert surely <= set(walked) <= perhaps
        assert (np.diff(enter[walked]) >= -1e-6).all()


def test_beams_cover_together_what_each_covers_alone():
    rng = np.random.default_rng(3)
    directions, origin = unit(rng.normal(size=(200, 3))), np.array([0.0, 0.0, 3.0])
    alone = [covered_voxels(WALKED, origin, direction[None], 9.0) for direction in directions]
    together = covered_voxels(WALKED, origin, directions, 9.0)
    assert 100 < together.sum() < len(WALKED)
    np.testing.assert_array_equal(together, np.any(alone, axis=0))


def test_beams_that_miss_the_region_or_end_before_it_cover_nothing():
    origin = np.array([0.0, 0.0, 5.0])
    assert not covered_voxels(WALKED, origin, unit(np.array([[0.0, 1.0, 0.0], [0.0, -1.0, -1.0]])), 50.0).any()
    assert not covered_voxels(WALKED, origin, unit(np.array([[0.0, 1.0, -1.0]])), 2.0).any()
    assert not covered_voxels(WALKED, origin, np.zeros((0, 3)), 50.0).any()
    assert covered_voxels(WALKED, origin, unit(np.array([[0.0, 1.0, -1.0]])), 6.0).any()


# --- the grid ---------------------------------------------------------------------------------------------------------


def slow_in_boxes(grid, centre, size, heading):
    found = []
    for number, index in enumerate(np.ndindex(grid.counts)):
        place = [low + (i + 0.5) * grid.voxel_m for low, i in zip(grid.low_m, index, strict=True)]
        for (cx, cy, cz), (length, width, height), turn in zip(centre, size, heading, strict=True):
            x, y, z = place[0] - cx, place[1] - cy, place[2] - cz
            forward = x * math.cos(turn) + y * math.sin(turn)
            left = y * math.cos(turn) - x * math.sin(turn)
            if abs(forward) <= length / 2 and abs(left) <= width / 2 and abs(z) <= height / 2:
                found.append(number)
                break
    return found


@pytest.mark.parametrize("seed", range(4))
def test_voxels_in_boxes_are_those_whose_centre_is(seed):
    rng = np.random.default_rng(seed)
    boxes = int(rng.integers(0, 6))
    size = rng.uniform([0.3, 0.2, 0.3], [5.0, 2.5, 3.5], (boxes, 3))
    centre = np.column_stack([rng.uniform(-6, 6, boxes), rng.uniform(0, 8, boxes), 0.5 * size[:, 2]])
    heading = rng.uniform(-4.0, 4.0, boxes)
    found = WALKED.in_boxes(centre, size, heading)
    assert found.tolist() == slow_in_boxes(WALKED, centre, size, heading)


def test_a_grid_covers_its_region_with_whole_voxels():
    grid = VoxelGrid.covering((-50.0, 2.0, 0.0), (50.0, 23.96, 3.8), 0.4)
    assert (grid.counts, len(grid)) == ((250, 55, 10), 250 * 55 * 10)
    np.testing.assert_allclose(grid.centres(np.array([0, len(grid) - 1])), [[-49.8, 2.2, 0.2], [49.8, 23.8, 3.8]])
    assert VoxelGrid.covering((0.0, 0.0, 0.0), (4.4, 0.1, 0.4), 0.4).counts == (11, 1, 1)
