"""Tubes, and what is made of them: closed, outward, and of the volume that geometry says."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from blender_lidar.world.detailed_shapes import Axle, lower_body
from blender_lidar.world.meshes import GLASS, block, both_sides, drum, fitted, joined, limb, loft, tube, volume

BARE = (  # a lower body as plain as a plank: x, bow, floor_z, sill_y, side_y, side_z, belt_y, belt_z, ridge_z
    (0.0, 0.0, 0.2, 0.9, 0.9, 0.8, 0.9, 1.0, 1.0),
    (4.0, 0.0, 0.2, 0.9, 0.9, 0.8, 0.9, 1.0, 1.0),
)


def enclosed(mesh):
    return volume(mesh.vertices[mesh.faces])


def is_closed(mesh):
    edges = Counter((a, b) for face in mesh.faces.tolist() for a, b in zip(face, face[1:] + face[:1], strict=True))
    return set(edges.values()) == {1} and all((b, a) in edges for a, b in edges)


def ring(sides, radius=1.0, x=0.0):
    turn = 2 * np.pi * np.arange(sides) / sides
    return np.column_stack([np.full(sides, x), radius * np.cos(turn), radius * np.sin(turn)])


@settings(max_examples=50)
@given(st.integers(3, 15), st.lists(st.floats(0.1, 3.0), min_size=2, max_size=6), st.booleans(), st.booleans())
def test_a_tube_is_closed_and_points_outwards_whichever_way_its_rings_turn(sides, radii, turned, backwards):
    rings = np.stack([ring(sides, radius, x) for x, radius in enumerate(radii)])
    rings = rings[:, ::-1] if turned else rings
    made = tube(rings[::-1] if backwards else rings)
    assert is_closed(made)
    assert len(made.faces) == 2 * sides * (len(radii) - 1) + 2 * (sides - 2)
    area = 0.5 * sides * np.sin(2 * np.pi / sides)
    a, b = np.array(radii[:-1]), np.array(radii[1:])
    assert enclosed(made) == pytest.approx(area * (a * a + a * b + b * b).sum() / 3)  # of frustums


def test_volumes_of_a_block_and_a_wheel():
    assert enclosed(block((-1, 2, 3), (1, 3, 7))) == pytest.approx(2 * 1 * 4)
    wheel = drum((1.0, 0.5, 0.3), 0.3, 0.2, 10)
    assert is_closed(wheel)
    assert enclosed(wheel) == pytest.approx(10 * 0.3**2 * np.tan(np.pi / 10) * 0.2)
    assert wheel.vertices[:, 2].min() == pytest.approx(0.0)
    np.testing.assert_allclose(np.unique(wheel.vertices[:, 1].round(9)), [0.4, 0.6])


@settings(max_examples=30)
@given(st.tuples(*[st.floats(-1, 1)] * 3), st.floats(0.02, 0.3), st.sampled_from([4, 6, 8]))
def test_a_limb_leads_from_end_to_end_and_mirrors_into_its_twin(way, radius, sides):
    way = np.add(way, (1.5, 0.0, 0.0))  # never along y
    made = limb([(0, 0.5, 0, radius, radius), (*np.add(way, (0.0, 0.5, 0.0)), radius, radius)], sides)
    assert is_closed(made)
    area = 0.5 * sides * np.sin(2 * np.pi / sides) * radius**2
    assert enclosed(made) == pytest.approx(area * np.linalg.norm(way))
    left, right = both_sides(made)
    assert enclosed(right) == pytest.approx(enclosed(left))
    np.testing.assert_array_equal(right.vertices, left.vertices * [1, -1, 1])


def test_glass_of_a_loft_lies_in_the_bands_named_on_both_sides():
    half = np.array([[1, 0], [1, 1], [0.8, 2], [0, 2.2]])
    halves = np.stack([np.column_stack([np.full(4, x), half]) for x in (0.0, 1.0, 2.0)])
    made = loft(halves, [[False, True, False], [False, False, True]])
    assert is_closed(made)
    glass = made.vertices[made.faces[made.surface == GLASS]].mean(axis=1)
    assert len(glass) == 8
    sides, top = glass[glass[:, 0] < 1], glass[glass[:, 0] > 1]
    assert (np.abs(sides[:, 1]) > 0.8).all()
    assert ((sides[:, 2] > 1) & (sides[:, 2] < 2)).all()
    assert (top[:, 2] > 2).all()
    for some in (sides, top):
        assert (some[:, 1] > 0).sum() == (some[:, 1] < 0).sum() == 2


def test_meshes_joined_and_fitted_fill_the_unit_box():
    made = fitted(joined([block((0, -1, 0), (3, 1, 1)), block((2, -0.5, 0.5), (4, 0.5, 3))]))
    assert is_closed(made)
    np.testing.assert_array_equal(made.vertices.min(axis=0), [-0.5] * 3)
    np.testing.assert_array_equal(made.vertices.max(axis=0), [0.5] * 3)
    assert enclosed(made) == pytest.approx((3 * 2 * 1 + 2 * 1 * 2.5) / (4 * 2 * 3))


def test_an_axle_cuts_an_arch_of_its_radius_into_the_sides_and_nothing_else():
    axle = Axle(2.0, 0.3, 0.88, 0.2, gap=0.06)
    bare, cut = lower_body(BARE), lower_body(BARE, [axle])
    assert is_closed(cut)
    edge = cut.vertices[np.isclose(cut.vertices[:, 1], 0.9) & (cut.vertices[:, 2] > 0.25) & (cut.vertices[:, 2] < 0.75)]
    np.testing.assert_allclose(np.hypot(edge[:, 0] - 2.0, edge[:, 2] - 0.3), 0.36)
    assert edge[:, 2].max() == pytest.approx(0.66)
    taken = enclosed(bare) - enclosed(cut)
    assert 0.0 < taken < np.pi * 0.36**2 * 0.3  # less than half a cylinder, 0.3 m deep, on both sides
    for axis in range(3):
        assert np.ptp(cut.vertices[:, axis]) == np.ptp(bare.vertices[:, axis])
