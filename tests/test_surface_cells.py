"""Coverage of surfaces: cells of triangles and of returns, against brute force and what is known."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from blender_lidar.errors import InputError
from blender_lidar.metrics.surface_cells import cells_with_points, surface_cells

pytestmark = pytest.mark.versions

QUAD = np.array([[(0.0, 0.0), (1.0, 0.0), (1.0, 1.0)], [(0.0, 0.0), (1.0, 1.0), (0.0, 1.0)]])


def quad(low, size, at=0.05):
    return np.concatenate([low + size * QUAD, np.full((2, 3, 1), at)], axis=-1)


def touched(corners, edge_m, per_edge=40):
    """Cells by brute force: of many random points on each triangle, as triples."""
    rng, found = np.random.default_rng(1), set()
    for triangle in corners:
        longest = np.linalg.norm(triangle - np.roll(triangle, 1, axis=0), axis=1).max()
        weights = rng.dirichlet(np.ones(3), int((per_edge * longest / edge_m) ** 2) + 100)
        found |= set(map(tuple, np.floor(weights @ triangle / edge_m + 0.01).astype(int).tolist()))
    return found


def triples(cells):
    low = 1 << 20
    return {(*((number >> shift & 2 * low - 1) - low for shift in (42, 21, 0)),) for number in cells}


@given(st.integers(0, 10_000))
def test_cells_are_those_that_brute_force_finds(seed):
    rng = np.random.default_rng(seed)
    corners = rng.uniform(-0.6, 0.6, (3, 3, 3))
    found, expected = triples(surface_cells(corners, 0.25).tolist()), touched(corners, 0.25)
    assert len(found ^ expected) <= 0.15 * len(expected) + 2  # cells of which just a corner is cut


def test_a_square_has_a_cell_for_each_of_its_squares_and_a_return_counts_once():
    cells = surface_cells(quad(0.01, 0.98), 0.1)
    assert len(cells) == 100
    assert len(np.unique(surface_cells(np.concatenate([quad(0.01, 0.98)] * 3), 0.1))) == 100
    points = np.array([(0.55, 0.55, 0.05), (0.56, 0.57, 0.05), (0.95, 0.05, 0.05), (3.0, 3.0, 0.05)])
    assert cells_with_points(cells, points, 0.1).sum() == 2
    assert cells_with_points(cells, np.empty((0, 3)), 0.1).sum() == 0


@pytest.mark.parametrize("error", [-1e-6, 0.0, 1e-6])
def test_a_return_that_is_rounded_over_a_round_number_counts_on_the_surface(error):
    flat = quad(0.01, 0.98, at=0.3)
    cells = surface_cells(flat, 0.1)
    assert len(cells) == 100
    x, y = np.meshgrid(np.arange(0.05, 1.0, 0.1), np.arange(0.05, 1.0, 0.1))
    points = np.stack([x.ravel(), y.ravel(), np.full(100, 0.3 + error)], axis=1)
    assert cells_with_points(cells, points, 0.1).all()


def test_the_union_is_at_least_each_and_at_most_their_sum():
    cells, rng = surface_cells(quad(0.0, 2.0), 0.1), np.random.default_rng(3)
    seen = [cells_with_points(cells, np.c_[rng.uniform(0, 2, (50, 2)), np.full(50, 0.05)], 0.1) for _ in range(3)]
    together = np.any(seen, axis=0).sum()
    assert max(map(np.sum, seen)) <= together <= sum(map(np.sum, seen))


def test_large_triangles_take_little_memory_and_have_the_cells_of_many_small_ones():
    tracemalloc.start()
    whole = surface_cells(quad(0.0, 12.0), 0.1)
    assert tracemalloc.get_traced_memory()[1] < 40e6
    tracemalloc.stop()
    parts = [quad((x, y), 1.0) for x in range(12) for y in range(12)]
    assert set(surface_cells(np.concatenate(parts), 0.1)) == set(whole)
    with pytest.raises(InputError, match="too many"):
        surface_cells(quad(0.0, 60.0), 0.1)


def test_edges_that_cannot_be_are_refused():
    with pytest.raises(InputError, match="above 0 m"):
        surface_cells(quad(0.0, 1.0), 0.0)
    with pytest.raises(InputError, match="too many"):
        surface_cells(quad(0.0, 1000.0), 0.001)
    assert len(surface_cells(np.empty((0, 3, 3)), 0.1)) == 0
