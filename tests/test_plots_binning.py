"""What the charts count, against loops over the vehicles and the cells."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from blender_lidar.errors import InputError
from blender_lidar.plots import binning
from tests.chart_samples import vehicles

table_rows = st.lists(
    st.tuples(
        st.floats(0.0, 200.0),
        st.booleans(),
        st.one_of(st.just(math.nan), st.floats(0.0, 1.6)),
    ),
    max_size=60,
)


@settings(deadline=None)
@given(rows=table_rows, band_m=st.sampled_from([1.7, 5.0, 10.0, 33.3]))
def test_distance_bands_equal_a_loop_over_the_vehicles(rows, band_m):
    distance, detectable, entropy = np.array(rows, dtype=float).reshape(-1, 3).T
    number = binning.band_count(distance, band_m)
    bands = binning.distance_bands(distance, detectable, entropy, band_m, number)
    members: list[list[tuple[float, bool, float]]] = [[] for _ in range(number)]
    for row in rows:
        members[math.floor(row[0] / band_m)].append(row)
    for band, inside in enumerate(members):
        known = [entropy for _, _, entropy in inside if not math.isnan(entropy)]
        assert bands.count[band] == len(inside)
        share = sum(seen for _, seen, _ in inside) / len(inside) if inside else math.nan
        np.testing.assert_array_equal(bands.detectable_share[band], share)
        mean = math.fsum(known) / len(known) if known else math.nan
        np.testing.assert_allclose(bands.score[band], mean, rtol=1e-14)
        assert bands.centre_m[band] == (band + 0.5) * band_m


def test_a_distance_on_the_border_belongs_to_the_farther_band():
    bands = binning.distance_bands(np.array([0.0, 10.0, 19.9]), np.ones(3), np.ones(3), 10.0, 2)
    np.testing.assert_array_equal(bands.count, [1, 2])


@settings(deadline=None)
@given(
    low=st.floats(-1e3, 1e3),
    length=st.floats(0.0, 300.0),
    step=st.floats(0.1, 20.0),
    anchor=st.floats(-30.0, 30.0),
)
def test_covering_edges_hold_the_range_and_no_whole_cell_more(low, length, step, anchor):
    high = low + length
    edges = binning.covering_edges(low, high, step, anchor)
    assert edges[0] <= low
    assert high <= edges[-1]
    tolerance = 1e-9 * (abs(low) + length + abs(anchor) + step)
    assert low - edges[0] <= step + tolerance
    assert edges[-1] - high <= step + tolerance
    np.testing.assert_allclose(np.diff(edges), step, rtol=1e-9, atol=1e-9)


@settings(deadline=None)
@given(seed=st.integers(0, 2**32 - 1), number=st.integers(0, 80))
def test_cell_shares_equal_a_loop_over_the_cells(seed, number):
    rng = np.random.default_rng(seed)
    x, y, counted = rng.uniform(-12.0, 12.0, number), rng.uniform(-2.0, 12.0, number), rng.random(number) < 0.5
    x_edges, y_edges = np.arange(-10.0, 11.0, 5.0), np.arange(0.0, 10.1, 3.0)
    share = binning.cell_shares(x, y, counted, x_edges, y_edges)
    assert share.shape == (len(y_edges) - 1, len(x_edges) - 1)
    for row in range(share.shape[0]):
        for column in range(share.shape[1]):
            inside = [
                bool(counted[i])
                for i in range(number)
                if x_edges[column] <= x[i] < x_edges[column + 1] and y_edges[row] <= y[i] < y_edges[row + 1]
            ]
            np.testing.assert_array_equal(share[row, column], np.mean(inside) if inside else math.nan)


def test_footprints_equal_corners_turned_one_by_one():
    table = vehicles(11, 20)
    names = ("x_m", "y_m", "length_m", "width_m", "heading_deg")
    corners = binning.footprints(*(table[name] for name in names))
    for index in range(20):
        x, y, length, width, heading = (float(table[name][index]) for name in names)
        turn = complex(math.cos(math.radians(heading)), math.sin(math.radians(heading)))
        for corner, (along, left) in enumerate(((1, 1), (-1, 1), (-1, -1), (1, -1))):
            point = complex(x, y) + turn * complex(along * length / 2, left * width / 2)
            np.testing.assert_allclose(corners[index, corner], (point.real, point.imag), atol=1e-12)


@settings(deadline=None)
@given(best=st.floats(-1, 2), baseline=st.floats(-1, 2), share=st.floats(0, 1))
def test_the_near_best_threshold_gives_up_that_share_of_the_gain_and_never_more(best, baseline, share):
    threshold = binning.near_best_threshold(best, baseline, share)
    assert threshold <= best
    if baseline >= best:
        assert threshold == best
    else:
        assert best - threshold == pytest.approx(share * (best - baseline), abs=1e-12)


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ({"a": [1.0]}, "no column 'b'; needed: a, b"),
        ({"a": [1.0], "b": [1.0, 2.0]}, "column 'b' has shape"),
        ({"a": [1.0], "b": ["car"]}, "not numeric"),
        ({"a": [1.0], "b": [math.nan]}, "column 'b' holds a value that is not a finite number"),
        ({"a": 1.0, "b": 2.0}, "column 'a' has shape"),
    ],
)
def test_a_table_that_cannot_be_counted_is_refused_by_column(table, message):
    with pytest.raises(InputError, match=message) as caught:
        binning.columns(table, ("a", "b"), "vehicles")
    assert str(caught.value).startswith("vehicles: ")
    assert "\n" not in str(caught.value)


def test_nan_passes_only_in_the_columns_that_may_hold_it():
    table = {"a": [1.0, 2.0], "b": [math.nan, 1.0]}
    assert math.isnan(binning.columns(table, ("a", "b"), "vehicles", may_be_nan=("b",))["b"][0])
