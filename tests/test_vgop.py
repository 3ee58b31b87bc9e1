"""PE-VGOP against a slow loop, the properties that the paper's equations promise or break, and Eqs. 10 and 11."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from blender_lidar.errors import InputError
from blender_lidar.metrics import vgop, view_grids
from blender_lidar.optimise import detectable, vehicle_score

pytestmark = pytest.mark.versions

CAR = np.array([[4.5, 1.8, 1.5]])


def slow_occupancy(points, vehicle, size, cell):
    """The rule of DESIGN.md in plain Python: one set of cells per vehicle and view."""
    result = np.zeros((len(size), 3))
    for row, sides in enumerate(size):
        n = [max(1, math.ceil(side / cell - 1e-9)) for side in sides]
        occupied = [set(), set(), set()]
        for point in points[vehicle == row]:
            index = [math.floor((x + side / 2) / cell) for x, side in zip(point, sides, strict=True)]
            if any(i < -1 or i > count for i, count in zip(index, n, strict=True)):
                continue
            i, j, k = (min(max(value, 0), count - 1) for value, count in zip(index, n, strict=True))
            occupied[0].add((i, j))
            occupied[1].add((i, k))
            occupied[2].add((j, k))
        areas = (n[0] * n[1], n[0] * n[2], n[1] * n[2])
        result[row] = [len(cells) / area for cells, area in zip(occupied, areas, strict=True)]
    return result


def cloud(rng, vehicles, points, spread=1.3):
    size = rng.uniform([1.5, 0.5, 1.0], [12.0, 2.6, 4.0], (vehicles, 3))
    vehicle = rng.integers(0, vehicles, points)
    return rng.uniform(-0.5, 0.5, (points, 3)) * size[vehicle] * spread, vehicle, size


@pytest.mark.parametrize("cell", [0.05, 0.07, 3.0])
@pytest.mark.parametrize("spread", [0.9, 1.02, 1.6])
def test_occupancy_equals_the_slow_loop(cell, spread):
    points, vehicle, size = cloud(np.random.default_rng(3), 12, 4000, spread)
    np.testing.assert_allclose(
        vgop.occupancy(points, vehicle, size, cell), slow_occupancy(points, vehicle, size, cell), rtol=1e-12
    )


def test_points_are_scored_the_same_in_chunks_as_at_once(monkeypatch):
    points, vehicle, size = cloud(np.random.default_rng(6), 30, 5000)
    at_once = vgop.occupancy(points, vehicle, size)
    monkeypatch.setattr(view_grids, "_CHUNK_POINTS", 97)
    monkeypatch.setattr(view_grids, "numba_works", lambda: False)
    np.testing.assert_array_equal(vgop.occupancy(points, vehicle, size), at_once)


@settings(max_examples=60)
@given(st.integers(0, 2**32 - 1), st.floats(0.02, 0.5), st.floats(0.5, 2.0))
def test_occupancy_is_a_share_and_ignores_the_order_of_points(seed, cell, spread):
    rng = np.random.default_rng(seed)
    points, vehicle, size = cloud(rng, 4, 300, spread)
    p = vgop.occupancy(points, vehicle, size, cell)
    assert ((p >= 0) & (p <= 1)).all()
    order = rng.permutation(len(points))
    np.testing.assert_array_equal(vgop.occupancy(points[order], vehicle[order], size, cell), p)


def test_a_heading_of_a_quarter_turn_puts_a_point_ahead_of_the_vehicle_on_its_x_axis():
    np.testing.assert_allclose(
        vgop.to_vehicle_frame(np.array([[1.0, 5.0, 0.0]]), np.array([1.0, 2.0, 0.0]), math.pi / 2),
        [[3, 0, 0]],
        atol=1e-12,
    )


def test_the_three_ways_to_give_centres_and_headings_agree():
    rng = np.random.default_rng(1)
    points, vehicle = rng.normal(size=(50, 3)), rng.integers(0, 4, 50)
    centre, heading = rng.normal(size=(4, 3)), rng.normal(size=4)
    by_row = vgop.to_vehicle_frame(points, centre, heading, vehicle)
    np.testing.assert_array_equal(by_row, vgop.to_vehicle_frame(points, centre[vehicle], heading[vehicle]))
    for row in range(4):
        np.testing.assert_array_equal(
            by_row[vehicle == row], vgop.to_vehicle_frame(points[vehicle == row], centre[row], heading[row])
        )


def test_a_vehicle_covered_with_points_has_occupancy_one_and_no_entropy_as_corrected():
    size = np.array([[4.53, 1.77, 1.5]])
    grid = np.stack(
        np.meshgrid(*(np.arange(-side / 2 + 0.01, side / 2, 0.02) for side in size[0]), indexing="ij"), axis=-1
    ).reshape(-1, 3)
    rows = np.zeros(len(grid), dtype=int)
    np.testing.assert_array_equal(vgop.occupancy(grid, rows, size), [[1.0, 1.0, 1.0]])
    assert vgop.pe_vgop(grid, rows, size)[0] == 0.0
    literal = vgop.occupancy(grid, rows, size, reading="paper")
    assert literal[0, 0] == pytest.approx(91 * 36 / (4.53 * 1.77 / 0.0025))  # 1.021: Eq. 8 as printed exceeds 1
    assert literal[0, 0] > 1.0
    assert vgop.pe_vgop(grid, rows, size, reading="paper")[0] < 0.0


def test_points_on_all_faces_stay_inside_the_lattice():
    corners = np.array([(x, y, z) for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)]) * CAR
    p = vgop.occupancy(corners, np.zeros(8, dtype=int), CAR)
    np.testing.assert_allclose(p, [[4 / (90 * 36), 4 / (90 * 30), 4 / (36 * 30)]])


def test_a_point_one_cell_beyond_the_rim_counts_and_one_farther_does_not():
    rows = np.zeros(1, dtype=int)
    assert vgop.occupancy(np.array([[2.25 + 0.04, 0, 0]]), rows, CAR)[0, 0] > 0
    assert vgop.occupancy(np.array([[2.25 + 0.06, 0, 0]]), rows, CAR)[0, 0] == 0
    assert vgop.occupancy(np.array([[-2.25 - 0.04, 0, 0]]), rows, CAR)[0, 0] > 0
    assert vgop.occupancy(np.array([[-2.25 - 0.06, 0, 0]]), rows, CAR)[0, 0] == 0
    assert vgop.occupancy(np.array([[1e300, 0, 0]]), rows, CAR)[0, 0] == 0


def test_entropy_peaks_at_one_over_e_and_vanishes_at_both_ends():
    assert vgop.entropy(np.array([0.0, 1.0])).tolist() == [0.0, 0.0]
    assert not np.signbit(vgop.entropy(np.array([0.0, 1.0]))).any()
    assert vgop.entropy(1 / math.e) == pytest.approx(math.log2(math.e) / math.e)
    p = np.linspace(0.001, 0.999, 999)
    np.testing.assert_allclose(vgop.entropy(p), -p * np.log2(p), rtol=1e-12)
    assert p[np.argmax(vgop.entropy(p))] == pytest.approx(1 / math.e, abs=1e-3)


@pytest.mark.parametrize(("view", "cells"), [("top", 17), ("side", 14), ("front", 6)])
def test_cells_of_a_car_that_one_view_needs_to_reach_the_papers_threshold(view, cells):
    total = {"top": 90 * 36, "side": 90 * 30, "front": 36 * 30}[view]
    assert (cells - 1) / total < 0.005 <= cells / total


def test_no_points_and_no_vehicles_are_fine():
    assert vgop.occupancy(np.empty((0, 3)), np.empty(0, dtype=int), CAR).tolist() == [[0, 0, 0]]
    assert vgop.occupancy(np.empty((0, 3)), np.empty(0, dtype=int), np.empty((0, 3))).shape == (0, 3)
    assert vgop.pe_vgop(np.empty((0, 3)), np.empty(0, dtype=int), CAR).tolist() == [0.0]


@pytest.mark.parametrize(
    ("points", "vehicle", "size", "cell", "says"),
    [
        (np.zeros((2, 2)), np.zeros(2, int), CAR, 0.05, "points has shape"),
        (np.zeros((2, 3)), np.zeros(3, int), CAR, 0.05, "vehicle has shape"),
        (np.zeros((2, 3)), np.array([0, 1]), CAR, 0.05, "rows 0 to 1"),
        (np.zeros((2, 3)), np.array([-1, 0]), CAR, 0.05, "rows -1 to 0"),
        (np.zeros((2, 3)), np.array([0.0, 0.5]), CAR, 0.05, "float64"),
        (np.full((1, 3), np.nan), np.zeros(1, int), CAR, 0.05, "not finite"),
        (np.zeros((1, 3)), np.zeros(1, int), -CAR, 0.05, "positive"),
        (np.zeros((1, 3)), np.zeros(1, int), CAR * np.nan, 0.05, "positive"),
        (np.zeros((1, 3)), np.zeros(1, int), CAR, 0.0, "cell_m"),
        (np.zeros((1, 3)), np.zeros(1, int), CAR, 1e-9, "cell_m is 1e-09; allowed: at least"),
    ],
)
def test_bad_input_is_named(points, vehicle, size, cell, says):
    with pytest.raises(InputError, match=says):
        vgop.occupancy(points, vehicle, size, cell)


def test_an_unknown_reading_and_an_impossible_occupancy_are_refused():
    with pytest.raises(InputError, match="corrected, paper"):
        vgop.occupancy(np.zeros((1, 3)), np.zeros(1, int), CAR, reading="literal")
    for p in (-0.1, np.nan, np.inf):
        with pytest.raises(InputError, match="occupancy"):
            vgop.entropy(p)


# --- the objective's arithmetic, Eqs. 10 and 11 -----------------------------------------------------------------------


OCCUPANCY = np.array(
    [
        [0.000, 0.000, 0.000],
        [0.005, 0.005, 0.005],
        [0.015, 0.000, 0.000],
        [0.014, 0.000, 0.000],
        [0.006, 0.007, 0.004],
    ]
)
SHARES = hnp.arrays(float, st.tuples(st.integers(0, 6), st.just(3)), elements=st.floats(0.0, 1.0))


@pytest.mark.parametrize(
    ("view", "expected"),
    [
        ("mean", [False, True, True, False, True]),
        ("max", [False, True, True, True, True]),
        ("min", [False, True, False, False, False]),
    ],
)
def test_a_vehicle_is_detectable_from_the_threshold_up(view, expected):
    assert detectable(OCCUPANCY, 0.005, view).tolist() == expected


@given(SHARES, st.floats(0.0, 1.0))
def test_min_implies_mean_implies_max(occupancy, threshold):
    by_min, by_mean, by_max = (detectable(occupancy, threshold, view) for view in ("min", "mean", "max"))
    mean_lost_to_rounding = np.isclose(occupancy.mean(axis=-1), threshold)
    assert (by_mean | ~by_min | mean_lost_to_rounding).all()
    assert (by_max | ~by_mean | mean_lost_to_rounding).all()


def test_the_corrected_reading_penalises_a_missed_vehicle_and_the_literal_one_rewards_it():
    entropy, seen = np.array([0.1, 0.1]), np.array([True, False])
    assert vehicle_score(entropy, seen, loss=-1.0).tolist() == [0.1, -1.0]
    assert vehicle_score(entropy, seen, loss=-1.0, reading="paper").tolist() == [0.1, 1.0]


@given(st.floats(-10.0, 10.0))
def test_the_sign_of_the_constant_matters_to_the_literal_reading_alone(loss):
    missed = np.zeros(1, bool)
    assert vehicle_score([0.3], missed, loss).tolist() == [-abs(loss)]
    assert vehicle_score([0.3], missed, loss, "paper").tolist() == [-loss]


@pytest.mark.parametrize(
    ("occupancy", "options", "message"),
    [
        (OCCUPANCY, {"view": "median"}, "unknown view 'median'; .*mean, max, min"),
        (OCCUPANCY, {"threshold": -0.1}, "threshold: -0.1; allowed"),
        (OCCUPANCY, {"threshold": np.nan}, "threshold: nan; allowed"),
        (OCCUPANCY, {"threshold": "low"}, "threshold: 'low'; allowed"),
        ([0.1, 0.2], {}, r"occupancy: shape \(2,\); allowed: \(\.\.\., 3\)"),
        ([0.1, 0.2, np.nan], {}, "occupancy: .*shares of 0 or more"),
    ],
)
def test_unusable_occupancy_is_refused_in_one_line(occupancy, options, message):
    with pytest.raises(InputError, match=message) as caught:
        detectable(occupancy, **options)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("entropy", "seen", "options", "message"),
    [
        ([np.nan], [True], {}, "infinite or NaN"),
        ([0.1], [True], {"loss": np.inf}, "loss: inf"),
        ([0.1], [True], {"reading": "literal"}, "unknown reading 'literal'.*corrected, paper"),
    ],
)
def test_unusable_scores_are_refused(entropy, seen, options, message):
    with pytest.raises(InputError, match=message):
        vehicle_score(entropy, seen, **options)
