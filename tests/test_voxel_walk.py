"""Voxels in boxes and voxels crossed by beams, against tests of every voxel by itself."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import tests.research  # noqa: F401
from voxel_grid import VoxelGrid, covered_voxels, traverse

GRID = VoxelGrid((-4.0, 1.2, 0.0), (20, 15, 6), 0.4)
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
    for direction, path in zip(directions, paths(GRID, origin, directions, nearest, 7.0), strict=True):
        surely, perhaps, enter = crossed(GRID, origin, direction, nearest, 7.0)
        walked = [voxel for voxel in path if voxel >= 0]
        assert len(set(walked)) == len(walked)
        assert surely <= set(walked) <= perhaps
        assert (np.diff(enter[walked]) >= -1e-6).all()


def test_beams_cover_together_what_each_covers_alone():
    rng = np.random.default_rng(3)
    directions, origin = unit(rng.normal(size=(200, 3))), np.array([0.0, 0.0, 3.0])
    alone = [covered_voxels(GRID, origin, direction[None], 9.0) for direction in directions]
    together = covered_voxels(GRID, origin, directions, 9.0)
    assert 100 < together.sum() < len(GRID)
    np.testing.assert_array_equal(together, np.any(alone, axis=0))


def test_beams_that_miss_the_region_or_end_before_it_cover_nothing():
    origin = np.array([0.0, 0.0, 5.0])
    assert not covered_voxels(GRID, origin, unit(np.array([[0.0, 1.0, 0.0], [0.0, -1.0, -1.0]])), 50.0).any()
    assert not covered_voxels(GRID, origin, unit(np.array([[0.0, 1.0, -1.0]])), 2.0).any()
    assert not covered_voxels(GRID, origin, np.zeros((0, 3)), 50.0).any()
    assert covered_voxels(GRID, origin, unit(np.array([[0.0, 1.0, -1.0]])), 6.0).any()


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
    found = GRID.in_boxes(centre, size, heading)
    assert found.tolist() == slow_in_boxes(GRID, centre, size, heading)


def test_a_grid_covers_its_region_with_whole_voxels():
    grid = VoxelGrid.covering((-50.0, 2.0, 0.0), (50.0, 23.96, 3.8), 0.4)
    assert (grid.counts, len(grid)) == ((250, 55, 10), 250 * 55 * 10)
    np.testing.assert_allclose(grid.centres(np.array([0, len(grid) - 1])), [[-49.8, 2.2, 0.2], [49.8, 23.8, 3.8]])
    assert VoxelGrid.covering((0.0, 0.0, 0.0), (4.4, 0.1, 0.4), 0.4).counts == (11, 1, 1)
