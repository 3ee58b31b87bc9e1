"""Rigid transforms: composed, inverted, and exact far from the origin."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from blender_lidar.rigid import Rigid

ANGLES = st.floats(-10.0, 10.0)
PLACES = st.tuples(*3 * [st.floats(-1e3, 1e3)])
RNG = np.random.default_rng(1)


def by_matrix(transform: Rigid, places: np.ndarray) -> np.ndarray:
    """The same by a homogeneous matrix of columns, the textbook's way."""
    matrix = np.eye(4)
    matrix[:3, :3] = transform.rotation.T
    matrix[:3, 3] = transform.to_m - transform.rotation.T @ transform.from_m
    return (np.column_stack([places, np.ones(len(places))]) @ matrix.T)[:, :3]


@given(ANGLES, PLACES, ANGLES, PLACES)
def test_transforms_are_composed_and_inverted_as_matrices_are(turn, origin, other_turn, other_origin):
    one, other = Rigid.about_z(turn, origin), Rigid.about_z(other_turn, other_origin)
    places = RNG.uniform(-50.0, 50.0, (7, 3))
    np.testing.assert_allclose((one @ other).points(places), one.points(other.points(places)), atol=1e-9)
    np.testing.assert_allclose(one.inverse.points(one.points(places)), places, atol=1e-9)
    np.testing.assert_allclose((one @ other.inverse).points(places), by_matrix(one @ other.inverse, places), atol=1e-8)
    heading = RNG.uniform(-3.0, 3.0, 4)
    along = np.stack([np.cos(heading), np.sin(heading)], axis=1)
    turned = one.directions(along)
    np.testing.assert_allclose(np.exp(1j * one.headings(heading)), turned @ [1.0, 1j], atol=1e-12)
    assert math.remainder((one @ other).turn_rad - turn - other_turn, 2.0 * math.pi) == pytest.approx(0.0, abs=1e-9)


def test_places_in_the_plane_are_those_with_height():
    transform = Rigid.about_z(0.4, (10.0, -2.0))
    places = RNG.uniform(-50.0, 50.0, (5, 3))
    np.testing.assert_array_equal(transform.points(places[:, :2]), transform.points(places)[:, :2])
    np.testing.assert_array_equal(transform.directions(places)[:, 2], places[:, 2])


def test_projected_coordinates_keep_their_last_digits():
    origin = (691_607.03125, 5_336_000.0625)
    site_from_map = Rigid.about_z(math.radians(30.0), origin).inverse
    along = site_from_map.points(np.add(origin, [math.cos(math.radians(30.0)), 0.5]))
    np.testing.assert_allclose(along, [1.0, 0.0], atol=1e-9)
    np.testing.assert_array_equal(site_from_map.points(np.array(origin)), [0.0, 0.0])
