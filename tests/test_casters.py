"""One suite for all casters: analytic ranges, agreement with the float64 oracle, leaks, and bad input."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import tests.research  # noqa: F401
from attack_scenes import cuboid
from blender_lidar.casting import CASTERS, caster_class, is_available, resolve
from blender_lidar.casting.protocol import MISS
from blender_lidar.casting.tree import grown
from blender_lidar.errors import InputError, MissingExtraError
from blender_lidar.sensors.beams import beam_lattice
from blender_lidar.sensors.model import load_model
from blender_lidar.sensors.pose import Pose
from blender_lidar.world.triangles import vehicle_triangles
from tests.sample_traffic import dense_traffic, one_vehicle

pytestmark = pytest.mark.versions

MISSING = {name: pytest.mark.skipif(not is_available(name), reason=f"{name} is not installed") for name in CASTERS}
FAST = [pytest.param(name, marks=MISSING[name]) for name in ("raster", "bvh", "embree")]
EVERY = [*FAST, "exact"]
FLOOR = np.array([[[-50, -50, 0], [50, -50, 0], [50, 50, 0]], [[-50, -50, 0], [50, 50, 0], [-50, 50, 0]]], dtype=float)


def unit_rows(vectors):
    return vectors / np.linalg.norm(vectors, axis=1)[:, None]


def slab_distance(origin, directions, low, high):
    """Distance to an axis-parallel box by the slab method: another algorithm than any caster's."""
    with np.errstate(divide="ignore", invalid="ignore"):
        first, last = (low - origin) / directions, (high - origin) / directions
    near, far = np.fmin(first, last).max(axis=1), np.fmax(first, last).min(axis=1)
    return np.where((near <= far) & (near >= 0), near, np.inf)


@pytest.mark.parametrize("name", EVERY)
def test_distance_to_a_floor_is_height_over_the_sine_of_the_angle(name):
    rng = np.random.default_rng(0)
    rays = unit_rows(np.column_stack([rng.normal(size=(500, 2)), -rng.uniform(0.2, 2, 500)]))
    hits = caster_class(name)(FLOOR).cast(np.array([1.0, 2.0, 3.0]), rays)
    np.testing.assert_allclose(hits.distance, 3.0 / -rays[:, 2], rtol=1e-12)
    assert set(hits.triangle.tolist()) <= {0, 1}


@pytest.mark.parametrize("name", EVERY)
def test_distance_to_a_box_equals_the_slab_method(name):
    low, high = np.array([-2.25, 8.0, 0.0]), np.array([2.25, 9.8, 1.5])
    rng = np.random.default_rng(1)
    aim = rng.uniform(low - 1, high + 1, (3000, 3))
    origin = np.array([0.5, -1.0, 4.0])
    rays = unit_rows(aim - origin)
    expected = slab_distance(origin, rays, low, high)
    found = caster_class(name)(cuboid(low, high)).cast(origin, rays).distance
    assert 1000 < np.isfinite(expected).sum() < 2900
    np.testing.assert_array_equal(np.isfinite(found), np.isfinite(expected))
    np.testing.assert_allclose(found[np.isfinite(found)], expected[np.isfinite(expected)], rtol=1e-10)


@pytest.mark.parametrize("name", EVERY)
def test_the_nearest_of_several_boxes_is_met(name):
    boxes = np.concatenate([cuboid([-1, y, 0], [1, y + 1, 2]) for y in (30.0, 10.0, 20.0)])
    hits = caster_class(name)(boxes).cast(np.array([0.0, 0.0, 1.0]), np.array([[0.0, 1.0, 0.0], [0.0, -1.0, 0.0]]))
    assert hits.distance.tolist() == [pytest.approx(10.0), np.inf]
    assert 12 <= hits.triangle[0] < 24
    assert hits.triangle[1] == MISS


@pytest.mark.parametrize("name", EVERY)
def test_a_hit_counts_up_to_the_range_and_no_farther(name):
    caster = caster_class(name)(FLOOR)
    down = np.array([[0.0, 0.0, -1.0]])
    height = np.array([0.3, 0.4, 12.5])
    for max_range, met in ((12.5, True), (12.5 - 1e-9, False), (12.5 + 1e-9, True), (np.inf, True), (0.0, False)):
        assert np.isfinite(caster.cast(height, down, max_range).distance[0]) == met, max_range


@pytest.mark.parametrize("name", EVERY)
def test_one_origin_for_all_rays_and_one_for_each_agree(name):
    triangles = vehicle_triangles(dense_traffic(vehicles=30, length_m=120.0)).corners
    caster = caster_class(name)(triangles)
    rng = np.random.default_rng(2)
    origins = np.repeat(rng.uniform([-5, -1, 2], [5, 0, 5], (4, 3)), 200, axis=0)
    rays = unit_rows(rng.uniform([-30, 3, 0], [30, 25, 2], (800, 3)) - origins)
    together = caster.cast(origins, rays, 60.0)
    for start in range(0, 800, 200):
        alone = caster.cast(origins[start], rays[start : start + 200], 60.0)
        np.testing.assert_allclose(alone.distance, together.distance[start : start + 200], rtol=1e-12)
        np.testing.assert_array_equal(alone.triangle, together.triangle[start : start + 200])


@pytest.mark.parametrize("closed", [False, True])
@pytest.mark.parametrize("name", EVERY)
def test_a_tree_made_ready_for_a_region_meets_the_same_and_is_not_made_again_within_it(name, closed, monkeypatch):
    triangles = vehicle_triangles(dense_traffic(vehicles=30, length_m=120.0)).corners
    caster, built = caster_class(name)(triangles, closed), []
    caster.make_ready(np.array([-60.0, -60.0, -50.0]), np.array([60.0, 60.0, 70.0]))
    if name in ("bvh", "embree"):
        monkeypatch.setattr(caster, "_build", built.append)
    rng = np.random.default_rng(5)
    for origin in (np.array([x, -1.0, 4.0]) for x in (0.0, 25.0, 59.0, -59.0)):
        rays = unit_rows(rng.uniform([-30, 3, 0], [30, 25, 2], (800, 3)) - origin)
        found, expected = caster.cast(origin, rays, 60.0), caster_class("exact")(triangles).cast(origin, rays, 60.0)
        np.testing.assert_allclose(found.distance, expected.distance, rtol=1e-12)
    assert built == []


@pytest.mark.parametrize("name", FAST[1:2])
def test_a_tree_of_many_triangles_is_that_of_few_and_leaves_blenders_data_as_they_were(name, monkeypatch):
    """Many go to Blender by way of a mesh."""
    import bpy

    triangles = vehicle_triangles(dense_traffic(vehicles=30, length_m=120.0)).corners
    origin = np.array([0.0, 0.0, 4.0])
    rays = unit_rows(np.random.default_rng(6).uniform([-30, 3, 0], [30, 25, 2], (2000, 3)) - origin)
    expected = caster_class(name)(triangles).cast(origin, rays, 60.0)
    before = len(bpy.data.meshes), len(bpy.data.objects)
    monkeypatch.setattr("blender_lidar.casting.bvh._MANY", 0)
    found = caster_class(name)(triangles).cast(origin, rays, 60.0)
    np.testing.assert_array_equal(found.triangle, expected.triangle)
    np.testing.assert_array_equal(found.distance, expected.distance)
    assert (len(bpy.data.meshes), len(bpy.data.objects)) == before


@settings(max_examples=25)
@given(st.integers(0, 2**32 - 1), st.sampled_from([name for name in CASTERS if is_available(name)]))
def test_triangle_soup_is_met_where_the_oracle_meets_it(seed, name):
    rng = np.random.default_rng(seed)
    middle = rng.uniform(-20, 20, (60, 1, 3))
    soup = middle + rng.normal(size=(60, 3, 3))
    soup[::10, 2] = soup[::10, 1]  # some without area
    origin = np.array([0.0, 0.0, 30.0])
    rays = unit_rows(middle[:, 0] + rng.normal(scale=0.5, size=(60, 3)) - origin)
    found, expected = (caster_class(which)(soup).cast(origin, rays) for which in (name, "exact"))
    # Soup is open: a back that is met is as good as a front.
    np.testing.assert_array_equal(found.triangle, expected.triangle)
    np.testing.assert_allclose(found.distance, expected.distance, rtol=1e-9)


@pytest.mark.parametrize("name", FAST)
@pytest.mark.parametrize(
    ("sensor", "stride", "height", "tilt", "gate"), [("RS-16", 2, 4.1, 19.0, 50.0), ("RS-80", 10, 4.4, 9.0, 150.0)]
)
def test_on_dense_traffic_at_most_one_ray_in_ten_thousand_differs_from_the_oracle(
    name, sensor, stride, height, tilt, gate
):
    triangles = vehicle_triangles(dense_traffic(vehicles=130)).corners
    pose = Pose(height_m=height, tilt_x=np.radians(tilt))
    rays = pose.to_world(beam_lattice(load_model(sensor), stride=stride).directions.reshape(-1, 3))
    rays = rays[(rays[:, 1] > -0.2) & (rays[:, 2] < 0.05)]  # the others meet nothing
    expected = caster_class("exact")(triangles).cast(pose.position, rays, gate)
    found = caster_class(name)(triangles, closed=True).cast(pose.position, rays, gate)
    both = np.isfinite(found.distance) & np.isfinite(expected.distance)
    neither = np.isinf(found.distance) & np.isinf(expected.distance)
    apart = np.abs(np.where(both, found.distance, 0.0) - np.where(both, expected.distance, 0.0))
    same = neither | (both & (apart <= 1e-4))  # so a neighbour at a shared edge is no error
    assert both.sum() > 1000
    assert (~same).sum() <= len(rays) / 10_000
    assert apart[found.triangle == expected.triangle].max() <= 1e-9


@pytest.mark.parametrize("caster", FAST)
@pytest.mark.parametrize(("detail", "vehicles", "aimed"), [("body", 130, 2000), ("detailed", 30, 1000)])
@pytest.mark.parametrize("origin", [[0.0, 0.0, 4.4], [-120.0, -1.0, 4.5]], ids=["amid", "at the end"])
def test_rays_aimed_at_vertices_and_edges_of_a_whole_frame_meet_what_the_oracle_meets(
    caster, detail, vehicles, aimed, origin
):
    corners = vehicle_triangles(dense_traffic(vehicles=vehicles), detail).corners
    middles = 0.5 * (corners + np.roll(corners, 1, axis=1))
    targets = np.unique(np.concatenate([corners, middles]).reshape(-1, 3).round(12), axis=0)
    targets = np.random.default_rng(0).permutation(targets)[:aimed]
    origin, exact = np.array(origin), caster_class("exact")(corners)
    rays = unit_rows(targets - origin)
    expected = exact.cast(origin, rays).distance
    for closed in (True, False):
        found = caster_class(caster)(corners, closed).cast(origin, rays).distance
        np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-6)


@pytest.mark.parametrize("name", EVERY)
def test_a_sensor_inside_a_closed_mesh_meets_its_inside(name):
    inside, ahead = np.array([0.1, 0.2, 1.0]), np.array([[0.0, 1.0, 0.0]])
    assert caster_class(name)(cuboid([-1, -1, 0], [1, 1, 2])).cast(inside, ahead).distance[0] == pytest.approx(0.8)


@pytest.mark.parametrize("name", EVERY)
def test_no_triangles_no_rays_and_no_area_are_fine(name):
    cast = caster_class(name)
    down = np.array([[0.0, 0.0, -1.0]])
    assert cast(np.empty((0, 3, 3))).cast(np.zeros(3), down).distance.tolist() == [np.inf]
    assert len(cast(FLOOR).cast(np.zeros(3), np.empty((0, 3))).distance) == 0
    needle = np.array([[[0, 0, 0], [1, 0, 0], [2, 0, 0]]], dtype=float)
    assert cast(needle).cast(np.array([0.5, 0, 1.0]), down).triangle.tolist() == [MISS]
    mixed = cast(np.concatenate([needle, FLOOR - [0, 0, 1]])).cast(np.array([0.5, 0.2, 1.0]), down)
    assert mixed.triangle[0] in (1, 2)
    assert mixed.distance[0] == pytest.approx(2.0)


@pytest.mark.parametrize("name", EVERY)
def test_normals_are_those_of_the_triangles_that_were_met(name):
    soup = np.random.default_rng(9).normal(size=(30, 3, 3)) * 5
    soup[4] = 0.0
    caster = caster_class(name)(soup)
    hits = caster.cast(np.array([0, 0, 40.0]), unit_rows(soup.mean(axis=1) - [0, 0, 40.0]))
    met = hits.triangle[hits.triangle != MISS]
    expected = np.cross(soup[met, 1] - soup[met, 0], soup[met, 2] - soup[met, 0])
    np.testing.assert_allclose(caster.normals(met), unit_rows(expected), atol=1e-12)


@pytest.mark.parametrize("name", EVERY)
@pytest.mark.parametrize(
    ("origin", "ray", "says"),
    [
        ([0, 0, 1], [[0, 0, 0]], "unit length"),
        ([0, 0, 1], [[0, 0, -2]], "unit length"),
        ([0, 0], [[0, 0, -1]], "origins have shape"),
        ([0, 0, 1], [0, 0, -1], "directions have shape"),
    ],
)
def test_rays_that_a_tree_would_miss_silently_are_refused(name, origin, ray, says):
    with pytest.raises(InputError, match=says):
        caster_class(name)(FLOOR).cast(np.array(origin, dtype=float), np.array(ray, dtype=float))


@pytest.mark.parametrize("name", EVERY)
def test_triangles_of_another_shape_are_refused(name):
    with pytest.raises(InputError, match="shape"):
        caster_class(name)(FLOOR[:, :2])


@pytest.mark.parametrize("margin", [1e-5, 1e-3])
def test_grown_triangles_lie_in_their_plane_and_each_side_has_moved_out_by_the_margin(margin):
    rng = np.random.default_rng(12)
    corners = rng.normal(size=(200, 3, 3))
    normal = unit_rows(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]))
    larger = grown(corners, normal, margin)
    moved = np.einsum("tki,ti->tk", larger - corners, normal)
    np.testing.assert_allclose(moved, 0.0, atol=1e-12)
    side = np.roll(corners, -1, axis=1) - corners
    outward = np.cross(side / np.linalg.norm(side, axis=2, keepdims=True), normal[:, None])
    for end in (larger, np.roll(larger, -1, axis=1)):
        out = np.einsum("tki,tki->tk", end - corners, outward)
        np.testing.assert_allclose(out, margin, rtol=1e-6)
    assert np.linalg.norm(larger - corners, axis=2).max() <= 450.0 * margin


@pytest.mark.parametrize("name", EVERY)
def test_directions_that_float32_has_rounded_meet_small_and_distant_triangles(name):
    rng = np.random.default_rng(13)
    middle = unit_rows(rng.normal(size=(300, 3))) * rng.uniform(50, 200, (300, 1))
    small = middle[:, None] + rng.normal(scale=0.02, size=(300, 3, 3))
    rays = unit_rows(small.mean(axis=1)).astype(np.float32).astype(float)
    exact = caster_class("exact")(small).cast(np.zeros(3), unit_rows(rays))
    assert (exact.triangle >= 0).sum() > 290
    for stretched in (rays, unit_rows(rays) * (1.0 - 4e-7)):
        found = caster_class(name)(small).cast(np.zeros(3), stretched)
        np.testing.assert_array_equal(found.triangle, exact.triangle)
        np.testing.assert_allclose(found.distance, exact.distance, rtol=1e-6)


@pytest.mark.parametrize("name", FAST)
def test_where_earlier_rays_started_changes_no_hit(name):
    """The tree is made about where rays start; made for a far wider region it would be coarse."""
    corners = vehicle_triangles(dense_traffic(vehicles=40, length_m=150.0)).corners
    rng = np.random.default_rng(16)
    rays = unit_rows(rng.uniform([-60, 4, 0], [60, 25, 3], (800, 3)) - [0, 0, 4.0])
    expected = caster_class("exact")(corners).cast(np.array([0, 0, 4.0]), rays)
    caster = caster_class(name)(corners, closed=True)
    wide = rng.uniform(-1e6, 1e6, (50, 3))
    starts = [np.array([x, 0.0, 4.0]) for x in (60.0, -60.0, 61.0, 0.5)] + [np.array([[500.0, 0, 4.0]]), wide]
    for start in starts:
        caster.cast(start, np.tile([[0.0, 1.0, 0.0]], (len(np.atleast_2d(start)), 1)))
        found = caster.cast(np.array([0, 0, 4.0]), rays)
        assert (found.triangle != expected.triangle).sum() <= 1
        assert (~np.isclose(found.distance, expected.distance, atol=1e-6)).sum() <= 1


@MISSING["embree"]
def test_a_tree_serves_a_mast_that_moves_about_and_is_not_made_at_each_step():
    corners = vehicle_triangles(dense_traffic(vehicles=130)).corners
    caster, made = caster_class("embree")(corners, closed=True), []
    build = caster._build
    caster._build = lambda grown_corners: (made.append(1), build(grown_corners))
    for x in np.random.default_rng(17).uniform(-20, 20, 40):
        caster.cast(np.array([x, 0.0, 4.0]), np.array([[0.0, 1.0, 0.0]]))
    assert 1 <= len(made) <= 4


def test_casters_are_resolved_by_name_and_never_guessed_silently(monkeypatch):
    assert resolve("exact") == "exact"
    with pytest.raises(InputError, match="unknown caster 'embre'; did you mean 'embree'"):
        resolve("embre")
    monkeypatch.setattr("blender_lidar.casting.is_available", lambda name: name == "bvh")
    assert resolve("auto") == "bvh"
    with pytest.raises(MissingExtraError, match=r"blender_lidar\[fast\]"):
        resolve("embree")
    monkeypatch.setattr("blender_lidar.casting.is_available", lambda name: False)
    with pytest.raises(MissingExtraError, match=r"blender_lidar\[fast\].*blender_lidar\[blender\]"):
        resolve("auto")


@pytest.mark.parametrize("name", EVERY)
@pytest.mark.parametrize("detail", ["box", "detailed"])
def test_of_faces_that_coincide_the_same_one_is_met_whatever_casts(name, detail):
    """Two vehicles of one height that overlap have roofs in one plane: each beam there once went the slow way."""
    one, other = one_vehicle("van", centre=(0.0, 6.0)), one_vehicle("van", centre=(1.5, 6.4))
    corners = np.concatenate([vehicle_triangles(each, detail).corners for each in (one, other)])
    lattice, pose = beam_lattice(load_model("RS-16"), stride=10), Pose(height_m=4.5, tilt_x=0.4)
    rays = pose.to_world(lattice.components.reshape(3, -1).T)
    tree, oracle = caster_class(name)(corners, closed=True), caster_class("exact")(corners)
    found, true = tree.cast(pose.position, rays, 40.0), oracle.cast(pose.position, rays, 40.0)
    assert np.isfinite(true.distance).sum() > 40
    np.testing.assert_allclose(found.distance, true.distance, rtol=1e-12)
    if name == "raster":
        turn = tree.revolution(lattice, pose, 40.0)
        np.testing.assert_array_equal(turn.triangle, true.triangle[true.triangle >= 0])
