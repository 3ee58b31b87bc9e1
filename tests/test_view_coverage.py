"""View coverage and occupancy grids: bounded, monotone, even-handed, and the same in NumPy and compiled."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import tests.research  # noqa: F401
from blender_lidar.casting import caster_class
from blender_lidar.metrics import view_grids
from blender_lidar.metrics.catalogue import PE_VGOP, VIEW_COVERAGE
from blender_lidar.metrics.metric import vehicle_returns
from blender_lidar.metrics.vehicle_metrics import coverage
from blender_lidar.metrics.view_grids import ViewGrids
from blender_lidar.sensors.beams import beam_lattice
from blender_lidar.sensors.model import load_model
from blender_lidar.world.shapes import shape
from rival_metrics import number_of_returns

pytestmark = pytest.mark.versions

CAR = np.array([4.5, 1.8, 1.5])
SHARES = st.tuples(*[st.floats(0.0, 1.0)] * 3)


def scored(points, size=CAR):
    """View coverage of one vehicle."""
    points = np.asarray(points, dtype=float).reshape(-1, 3)
    returns = vehicle_returns(points, np.zeros(len(points), dtype=int), np.asarray(size, dtype=float)[None])
    return float(VIEW_COVERAGE.values(returns)[0])


def test_it_is_zero_without_returns_and_one_with_every_cell_hit():
    assert scored(np.empty((0, 3))) == 0.0
    axes = [np.arange(-0.5 * side + 0.05, 0.5 * side, 0.1) for side in CAR]
    everywhere = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 3)
    assert scored(everywhere) == pytest.approx(1.0)


@given(SHARES, st.integers(0, 2), st.floats(0.0, 1.0))
def test_more_of_any_view_never_lowers_it(shares, view, more):
    shares = np.array(shares)
    grown = shares.copy()
    grown[view] = max(grown[view], more)
    assert coverage(grown) >= coverage(shares) - 1e-15
    assert 0.0 <= coverage(shares) <= 1.0 + 1e-15


def test_it_depends_less_on_bearing_than_pe_vgop_and_the_number_of_returns_do():
    lattice = beam_lattice(load_model("HDL-64E-S2"), 10.0)
    beams = lattice.directions.reshape(-1, 3)
    body = shape("car", "body")
    car = caster_class("exact")((body.vertices * CAR)[body.faces], closed=True)
    spread = {metric.name: [] for metric in (VIEW_COVERAGE, PE_VGOP, number_of_returns)}
    for bearing in np.radians(np.arange(3.0, 180.0, 12.0)):
        lidar = np.array([20 * math.cos(bearing), 20 * math.sin(bearing), 1.73 - 0.75])
        ahead = beams @ (-lidar / np.linalg.norm(lidar)) > math.cos(math.radians(10.0))
        hits = car.cast(lidar, beams[ahead])
        met = hits.triangle >= 0
        points = lidar + beams[ahead][met] * hits.distance[met, None]
        returns = vehicle_returns(points, np.zeros(len(points), dtype=int), CAR[None])
        for metric in (VIEW_COVERAGE, PE_VGOP, number_of_returns):
            spread[metric.name].append(metric.values(returns)[0])
    variation = {name: np.std(series) / np.mean(series) for name, series in spread.items()}
    assert variation["view-coverage"] < variation["pe-vgop"] < variation["number_of_returns"]
    assert variation["view-coverage"] < 0.12


@pytest.mark.parametrize("size", [(8.0, 2.5, 3.0), (5.2, 2.0, 2.0), (12.0, 2.5, 3.2)])
def test_equally_dense_returns_score_alike_on_small_and_on_large_vehicles(size):
    rng = np.random.default_rng(7)
    values, numbers = [], []
    for sides in (CAR, np.array(size)):
        numbers.append(round(30 * sides[0] * sides[2]))  # on the left side, as many for each square metre
        left = rng.uniform(-0.5, 0.5, (numbers[-1], 3)) * sides
        left[:, 1] = 0.5 * sides[1] - 1e-6
        values.append(scored(left, sides))
    assert numbers[1] > 1.5 * numbers[0]
    assert values[1] == pytest.approx(values[0], rel=0.12)


# --- occupancy grids --------------------------------------------------------------------------------------------------


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
