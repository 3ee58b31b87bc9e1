"""Vehicle shapes and the meshes that they are made of: closed, outward, and exactly as large as their box."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from blender_lidar.casting import caster_class
from blender_lidar.errors import InputError
from blender_lidar.traffic.fleet import FLEET, KIND_OF_BODY
from blender_lidar.traffic.vehicles import CLASSES, FLEET_KINDS, fleet_kind
from blender_lidar.world.detailed_shapes import Axle, lower_body
from blender_lidar.world.meshes import (
    GLASS,
    SURFACES,
    block,
    both_sides,
    drum,
    fitted,
    joined,
    limb,
    loft,
    tube,
    volume,
)
from blender_lidar.world.shapes import DETAILS, SHAPES, shape, wheels
from blender_lidar.world.triangles import STATIC, vehicle_triangles
from tests.sample_traffic import dense_traffic, one_vehicle

pytestmark = pytest.mark.versions

BODIES = [body.name for bodies in FLEET.values() for body in bodies]
ALL = [(name, detail) for name in SHAPES for detail in DETAILS]
ALL += [(name, "body") for name in BODIES if name not in SHAPES]


@pytest.mark.parametrize(("name", "detail"), ALL)
def test_every_edge_joins_exactly_two_faces_that_turn_the_same_way(name, detail):
    faces = shape(name, detail).faces
    edges = Counter((a, b) for face in faces.tolist() for a, b in zip(face, face[1:] + face[:1], strict=True))
    assert set(edges.values()) == {1}
    assert all((b, a) in edges for a, b in edges)


def components(made):
    """Faces of each connected part of a shape."""
    label = np.arange(len(made.vertices))
    while True:
        lowest = label[made.faces].min(axis=1)
        before = label.copy()
        np.minimum.at(label, made.faces.ravel(), np.repeat(lowest, 3))
        if (label == before).all():
            part = label[made.faces[:, 0]]
            return [made.faces[part == one] for one in np.unique(part)]


@pytest.mark.parametrize(("name", "detail"), ALL)
def test_faces_of_every_part_point_outwards_and_have_area(name, detail):
    made = shape(name, detail)
    parts = components(made)
    assert len(parts) == 1 or detail == "detailed"
    for faces in parts:
        corners = made.vertices[faces]
        assert np.einsum("ij,ij->i", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])).sum() / 6 > 1e-5
    corners = made.vertices[made.faces]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2
    assert area.min() > 1e-5


@pytest.mark.parametrize(("name", "detail"), ALL)
def test_a_shape_takes_a_good_part_of_its_box_and_no_more(name, detail):
    """Counted along a grid of upright lines, so that overlapping parts count once."""
    made = shape(name, detail)
    across = (np.arange(40) + 0.5) / 40 - 0.5
    x, y = map(np.ravel, np.meshgrid(across, across))
    caster = caster_class("exact")(made.vertices[made.faces])
    top, bottom = (
        caster.cast(np.column_stack([x, y, np.full_like(x, z)]), np.tile([0.0, 0.0, -z], (len(x), 1))).distance
        for z in (1.0, -1.0)
    )
    filled = np.where(np.isfinite(top), 2.0 - top - bottom, 0.0).mean()
    assert {"motorcycle": 0.1, "bicycle": 0.07, "pedestrian": 0.2}.get(name, 0.4) < filled <= 1.0 + 1e-9


@pytest.mark.parametrize(("name", "detail"), ALL)
def test_a_ray_from_outside_meets_an_outer_side_first(name, detail):
    """What casters are promised by `closed=True`; where parts overlap as well."""
    made = shape(name, detail)
    rng = np.random.default_rng(3)
    origins = rng.normal(size=(2000, 3))
    origins *= 3.0 / np.linalg.norm(origins, axis=1, keepdims=True)
    rays = rng.uniform(-0.55, 0.55, (2000, 3)) - origins
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    caster = caster_class("exact")(made.vertices[made.faces])
    hits = caster.cast(origins, rays)
    met = hits.triangle >= 0
    assert met.sum() > 500
    assert (np.einsum("ij,ij->i", caster.normals(hits.triangle[met]), rays[met]) < 0.0).all()
    if detail == "detailed":  # whose surface, not the vertices alone, is the same on both sides
        mirrored = caster.cast(origins * [1, -1, 1], rays * [1, -1, 1])
        np.testing.assert_allclose(mirrored.distance, hits.distance, rtol=1e-9)


@pytest.mark.parametrize(("name", "detail"), ALL)
def test_a_shape_fills_its_box_exactly(name, detail):
    vertices = shape(name, detail).vertices
    np.testing.assert_array_equal(vertices.min(axis=0), [-0.5] * 3)
    np.testing.assert_array_equal(vertices.max(axis=0), [0.5] * 3)


@pytest.mark.parametrize(("name", "detail"), ALL)
def test_a_shape_is_the_same_on_both_sides(name, detail):
    vertices = {tuple(vertex) for vertex in shape(name, detail).vertices.round(9).tolist()}
    assert {(x, -y, z) for x, y, z in vertices} == vertices


def test_bodies_differ_at_the_level_body_alone():
    assert set(SHAPES) < set(BODIES)
    assert len(BODIES) == len(set(BODIES)) == 19
    assert len({shape(name, "body").vertices.tobytes() for name in BODIES}) == 19
    for detail in ("box", "detailed"):
        assert len({shape(name, detail).vertices.tobytes() for name in BODIES}) == (1 if detail == "box" else 8)


@pytest.mark.parametrize("name", SHAPES)
def test_boxes_are_twelve_triangles_bodies_a_few_dozen_and_detailed_shapes_a_few_hundred(name):
    assert len(shape(name, "box").faces) == 12
    assert all(36 <= len(shape(body.name, "body").faces) <= 108 for body in FLEET[name])
    assert 200 <= len(shape(name, "detailed").faces) <= 600


@pytest.mark.parametrize("detail", ["body", "detailed"])
@pytest.mark.parametrize("name", ["car", "van", "truck", "long_truck", "bus"])
def test_vehicles_have_windows_above_their_belt_line(name, detail):
    made = shape(name, detail)
    glass = made.vertices[made.faces[made.surface == GLASS]]
    assert len(glass) > 0
    assert glass[..., 2].max() > 0.2
    assert glass[..., 2].min() > -0.5
    assert made.surface.max() < len(SURFACES)


@settings(max_examples=50)
@given(
    st.sampled_from(CLASSES),
    st.sampled_from(DETAILS),
    st.tuples(st.floats(1, 25), st.floats(0.5, 3), st.floats(1, 4.5)),
    st.floats(-10, 10),
)
def test_a_placed_vehicle_spans_its_box_and_never_leaves_it(name, detail, size, heading):
    vehicles = one_vehicle(name, (12.0, 34.0), heading, size)
    corners = vehicle_triangles(vehicles, detail).corners.reshape(-1, 3) - vehicles.centre_m[0]
    cos, sin = np.cos(heading), np.sin(heading)
    local = np.column_stack(
        [cos * corners[:, 0] + sin * corners[:, 1], cos * corners[:, 1] - sin * corners[:, 0], corners[:, 2]]
    )
    np.testing.assert_allclose(local.max(axis=0), np.array(size) / 2, atol=1e-12)
    np.testing.assert_allclose(local.min(axis=0), -np.array(size) / 2, atol=1e-12)


def test_triangles_of_a_frame_carry_their_vehicle_and_stand_on_the_ground():
    vehicles = dense_traffic(vehicles=40)
    for detail in DETAILS:
        triangles = vehicle_triangles(vehicles, detail)
        assert set(triangles.owner.tolist()) == set(range(40))
        assert STATIC not in triangles.owner
        for row in range(40):
            mine = triangles.corners[triangles.owner == row].reshape(-1, 3)
            assert mine[:, 2].min() == pytest.approx(0.0, abs=1e-12)
            np.testing.assert_allclose(0.5 * (mine.min(axis=0) + mine.max(axis=0)), vehicles.centre_m[row], atol=0.05)


def test_a_frame_without_vehicles_has_no_triangles():
    vehicles = dense_traffic(vehicles=3)
    assert len(vehicle_triangles(vehicles.select(np.zeros(3, bool)))) == 0


def test_trucks_of_nine_metres_and_more_are_articulated():
    kinds = fleet_kind(
        np.array([CLASSES.index(name) for name in ("truck", "truck", "car")]), np.array([8.99, 9.0, 12.0])
    )
    assert [FLEET_KINDS[kind] for kind in kinds] == ["truck", "long_truck", "car"]


def test_unknown_shapes_and_details_are_refused_by_name():
    with pytest.raises(InputError, match="body"):
        shape("car", "fine")
    with pytest.raises(InputError, match="motorcycle"):
        shape("tram")


# --- meshes -----------------------------------------------------------------------------------------------------------


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


@pytest.mark.parametrize("name", KIND_OF_BODY)
def test_wheels_stand_on_the_road_proud_of_their_body_and_change_nothing_that_is_scanned(name):
    before, made = shape(name, "body").vertices.copy(), wheels(name)
    assert (len(made) == 2) == (KIND_OF_BODY[name] not in ("motorcycle", "bicycle", "pedestrian"))
    for part in made:
        assert np.abs(part.vertices[:, 0]).max() < 0.5
        assert volume(part.vertices[part.faces]) > 0.0
        assert 0.3 < np.abs(part.vertices[:, 1]).max() < 0.51
    for tires in made[:1]:
        assert tires.vertices[:, 2].min() == pytest.approx(-0.5)
    np.testing.assert_array_equal(shape(name, "body").vertices, before)
