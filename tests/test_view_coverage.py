"""View coverage: bounded, monotone, and even-handed between bearings and sizes."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from blender_lidar.casting import caster_class
from blender_lidar.metrics.catalogue import METRICS, VIEW_COVERAGE
from blender_lidar.metrics.metric import vehicle_returns
from blender_lidar.metrics.vehicle_metrics import coverage
from blender_lidar.sensors.beams import beam_lattice
from blender_lidar.sensors.model import load_model
from blender_lidar.world.shapes import shape

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
    spread = {name: [] for name in ("view-coverage", "pe-vgop", "points")}
    for bearing in np.radians(np.arange(3.0, 180.0, 12.0)):
        lidar = np.array([20 * math.cos(bearing), 20 * math.sin(bearing), 1.73 - 0.75])
        ahead = beams @ (-lidar / np.linalg.norm(lidar)) > math.cos(math.radians(10.0))
        hits = car.cast(lidar, beams[ahead])
        met = hits.triangle >= 0
        points = lidar + beams[ahead][met] * hits.distance[met, None]
        returns = vehicle_returns(points, np.zeros(len(points), dtype=int), CAR[None])
        for name, series in spread.items():
            series.append(METRICS[name].values(returns)[0])
    variation = {name: np.std(series) / np.mean(series) for name, series in spread.items()}
    assert variation["view-coverage"] < variation["pe-vgop"] < variation["points"]
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
