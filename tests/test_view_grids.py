"""Occupancy grids: cells counted by words in NumPy and as they are marked in compiled code."""

from __future__ import annotations

import numpy as np
import pytest

from blender_lidar.metrics import view_grids
from blender_lidar.metrics.view_grids import ViewGrids


def cloud(rng, vehicles=9, points=6000, spread=0.5):
    """Boxes, and points on and about them, each in the frame of its own box."""
    size = rng.uniform([3.5, 1.6, 1.3], [14.0, 2.6, 3.9], (vehicles, 3))
    vehicle = rng.integers(0, vehicles, points)
    return size, vehicle, rng.uniform(-spread, spread, (points, 3)) * size[vehicle]


@pytest.fixture
def _numpy_alone(monkeypatch):
    monkeypatch.setattr(view_grids, "numba_works", lambda: False)


def test_grids_forget_one_cloud_before_the_next():
    rng = np.random.default_rng(2)
    size, vehicle, local = cloud(rng)
    grids = ViewGrids(size)
    first = grids.occupancy(local, vehicle)
    grids.occupancy(local[:10], vehicle[:10])
    np.testing.assert_array_equal(grids.occupancy(local, vehicle), first)
    assert (grids.occupancy(local[:0], vehicle[:0]) == 0.0).all()


@pytest.mark.parametrize("cells", [(1, 1, 1), (7, 1, 1), (8, 1, 1), (9, 8, 1), (255, 8, 8), (256, 8, 8), (400, 60, 80)])
def test_every_cell_is_counted_once_however_many_words_a_grid_takes(cells):
    """A byte that overflowed, or a word that belonged to two grids, would show as a share other than 1."""
    size = np.array([cells, (90, 36, 30), cells]) * 0.05
    grid = np.stack(np.meshgrid(*(np.arange(n) + 0.5 for n in cells), indexing="ij"), axis=-1).reshape(-1, 3)
    shell = grid[((grid < 1) | (grid > np.array(cells) - 1)).any(axis=1)] * 0.05 - 0.5 * size[0]
    rows = np.concatenate([np.zeros(len(shell), dtype=np.int64), np.full(len(shell), 2)])
    p = ViewGrids(size).occupancy(np.tile(shell, (2, 1)), rows)
    assert p.tolist() == [[1.0] * 3, [0.0] * 3, [1.0] * 3]


def test_a_point_beside_its_vehicle_marks_no_other_vehicles_grids_and_its_own_up_to_a_cell_beyond():
    size = np.array([[4.5, 1.8, 1.5]] * 3)
    for beyond, marks in ((0.049, True), (0.051, False), (9.0, False)):
        for signs in ([-1, 0, -1], [1, 1, 1], [-1, -1, -1]):
            point = np.sign(signs) * (0.5 * size[1] + beyond)
            p = ViewGrids(size).occupancy(point[None], np.array([1]))
            assert (p[[0, 2]] == 0.0).all()
            assert (p[1] > 0.0).all() == marks


@pytest.mark.usefixtures("_numpy_alone")
def test_every_cell_is_counted_once_by_numpy_too():
    test_every_cell_is_counted_once_however_many_words_a_grid_takes((256, 8, 8))
    test_grids_forget_one_cloud_before_the_next()


@pytest.mark.skipif(not view_grids.numba_works(), reason="Numba is not installed")
def test_compiled_marks_count_what_numpys_count(monkeypatch):
    """Many clouds in a row: marks of one must not be taken for those of the next, nor after they were emptied."""
    rng = np.random.default_rng(4)
    size = rng.uniform(0.4, 5.0, (6, 3))
    grids, clouds = ViewGrids(size), []
    for _ in range(300):
        vehicle = rng.integers(0, 6, 200)
        clouds.append((rng.uniform(-0.6, 0.6, (200, 3)) * size[vehicle], vehicle))
    found = [grids.occupancy(*each) for each in clouds]
    monkeypatch.setattr(view_grids, "numba_works", lambda: False)
    np.testing.assert_array_equal(found, [grids.occupancy(*each) for each in clouds])
