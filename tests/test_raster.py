"""The caster that draws whole turns, beside the float64 oracle: bounds, ties, touching, interruptions."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from blender_lidar.casting import caster_class, is_available
from blender_lidar.casting.culling import cut_vehicles, reachable_beams
from blender_lidar.casting.protocol import TrianglePlanes
from blender_lidar.sensors.beams import beam_lattice
from blender_lidar.sensors.model import load_model
from blender_lidar.sensors.pose import Pose
from blender_lidar.world.shapes import DETAILS
from blender_lidar.world.triangles import vehicle_triangles
from tests.sample_traffic import dense_traffic, one_vehicle
from tests.test_casters import unit_rows

pytestmark = [pytest.mark.skipif(not is_available("raster"), reason="Numba is not installed"), pytest.mark.versions]


@pytest.mark.parametrize("shared", [True, False])
def test_compiled_planes_measure_as_numpys_do_to_the_last_digit(shared, monkeypatch):
    rng = np.random.default_rng(2)
    corners = rng.normal(size=(200, 3, 3)) * 5.0
    normal = unit_rows(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]))
    triangle, rays = rng.integers(0, 200, 5000), unit_rows(rng.normal(size=(5000, 3))).T
    origins = np.array([0.3, -2.0, 4.0]) if shared else rng.normal(size=(3, 5000))
    planes = TrianglePlanes(corners, normal)
    ours = planes.meet(origins, rays, triangle)
    monkeypatch.setattr("blender_lidar.casting.protocol.numba_works", lambda: False)
    for column, other in zip(ours, planes.meet(origins, rays, triangle), strict=True):
        np.testing.assert_array_equal(column, other)


@pytest.mark.parametrize(("offset", "scale"), [(0.0, 1.0), (1e6, 1.0), (-3e6, 1e-3), (0.0, 1e5)])
def test_every_corner_lies_within_the_sphere_about_its_run(offset, scale):
    """A sphere that is too small hides triangles without a word."""
    from blender_lidar.casting.raster import RUN, mesh_of

    corners = offset + scale * np.random.default_rng(5).normal(size=(3 * RUN + 1, 3, 3))
    mesh = mesh_of(corners)
    assert len(mesh.radius) == 4
    for run in range(4):
        away = np.linalg.norm(corners[run * RUN : (run + 1) * RUN] - mesh.middle[run], axis=2)
        assert away.max() <= mesh.radius[run]
        assert mesh.radius[run] <= away.max() * (1.0 + 1e-9) + 1e-11 * abs(offset)


TURNED = [Pose(height_m=4.1, tilt_x=0.3), Pose(2.0, 30.0, 1.5, -0.4, 0.2, 2.0), Pose(0.0, 8.0, 12.0, np.pi, 0.1, 0.0)]


@pytest.mark.parametrize("detail", DETAILS)
@pytest.mark.parametrize("sensor", ["RS-16", "RS-BPearl", "RS-LiDAR-32"])
def test_a_turn_that_is_drawn_is_a_turn_that_is_cast(sensor, detail):
    traffic, lattice = dense_traffic(seed=4, vehicles=50), beam_lattice(load_model(sensor), stride=7)
    corners = vehicle_triangles(traffic, detail).corners
    raster, oracle = caster_class("raster")(corners, closed=True), caster_class("exact")(corners)
    inside = Pose(*traffic.centre_m[3].tolist())
    for pose in (*TURNED, inside):
        turn = raster.revolution(lattice, pose, 60.0)
        rays = pose.to_world(lattice.components.reshape(3, -1).T)
        found = oracle.meet(pose.position, rays, 60.0)
        np.testing.assert_array_equal(turn.beam, found.ray)
        np.testing.assert_array_equal(turn.triangle, found.triangle)
        np.testing.assert_allclose(turn.distance, found.distance, rtol=1e-12)
        np.testing.assert_array_equal(turn.directions, rays[found.ray].T)


def test_a_turn_drawn_from_a_surface_on_a_mesh_line_or_far_from_the_origin_is_the_one_that_is_cast():
    """Where rounding decides everything: each beam goes the slow way."""
    lattice = beam_lattice(load_model("RS-16"), stride=60)
    car = one_vehicle("car", centre=(0.0, 6.0))
    for shift in (0.0, 1e5):
        corners = vehicle_triangles(car, "body").corners + np.array([shift, 0.0, 0.0])
        raster, oracle = caster_class("raster")(corners, closed=True), caster_class("exact")(corners)
        on_a_corner, on_a_side = corners[7, 0], corners[5].mean(axis=0)
        above = corners.reshape(-1, 3)[corners.reshape(-1, 3)[:, 2].argmax()] + [0.0, 0.0, 1.0]
        for start in (on_a_corner, on_a_side, above):
            pose = Pose(*start.tolist(), np.pi / 2)
            rays = pose.to_world(lattice.components.reshape(3, -1).T)
            turn, found = raster.revolution(lattice, pose, 40.0), oracle.meet(pose.position, rays, 40.0)
            np.testing.assert_array_equal(turn.beam, found.ray)
            np.testing.assert_allclose(turn.distance, found.distance, atol=1e-9)


def test_a_sensor_in_the_very_middle_of_a_piece_keeps_all_its_beams():
    car, lattice = one_vehicle("car", centre=(0.0, 6.0)), beam_lattice(load_model("RS-16"), stride=60)
    short = replace(car, size_m=np.array([[1.5, 1.5, 1.5]]))
    middle = Pose(*short.centre_m[0].tolist())
    beams = reachable_beams(lattice, cut_vehicles(short, "box"), middle, 50.0)
    assert len(beams) == lattice.rings * lattice.columns


@pytest.mark.parametrize("aside", [0.05, 0.5])
def test_walls_in_one_plane_seen_grazing_are_told_apart_as_the_oracle_does(aside):
    """Drawn distances are a millionth apart there at most, and rounding is more than was thought."""
    along = np.arange(0.0, 100.0, 0.4)
    low = np.stack([np.full(len(along), aside), 2.0 + along, np.full(len(along), 0.99)], axis=1)
    ahead, up = np.array([0.0, 0.5, 0.0]), np.array([0.0, 0.0, 0.02])
    tiles = np.stack([low, low + ahead, low + ahead + up], axis=1)
    corners = np.concatenate([tiles, tiles[:, ::-1] + [0.0, 0.1, 0.0]])
    lattice, pose = beam_lattice(load_model("RS-16")), Pose(height_m=1.0, tilt_x=np.radians(1.0))  # one ring is level
    turn = caster_class("raster")(corners).revolution(lattice, pose, 200.0)
    rays = pose.to_world(lattice.components.reshape(3, -1).T)
    found = caster_class("exact")(corners).meet(pose.position, rays, 200.0)
    assert len(found.ray) >= 6
    np.testing.assert_array_equal(turn.beam, found.ray)
    np.testing.assert_array_equal(turn.triangle, found.triangle)


def test_what_is_interrupted_while_it_draws_spoils_no_later_turn(monkeypatch):
    from blender_lidar.casting import raster

    traffic, pose = dense_traffic(seed=4, vehicles=20), Pose(height_m=4.1, tilt_x=0.3)
    tree = caster_class("raster")(vehicle_triangles(traffic, "body").corners, closed=True)
    fine, coarse = (beam_lattice(load_model("RS-16"), stride=stride) for stride in (5, 60))
    first = tree.revolution(fine, pose, 60.0)
    with monkeypatch.context() as patch:
        patch.setattr(raster, "undecided_beams", lambda *_: (_ for _ in ()).throw(KeyboardInterrupt))
        with pytest.raises(KeyboardInterrupt):
            tree.revolution(fine, Pose(height_m=2.0), 60.0)
    tree.revolution(coarse, pose, 60.0)
    for column, again in zip(first, tree.revolution(fine, pose, 60.0), strict=True):
        np.testing.assert_array_equal(column, again)


def test_a_turn_without_a_limit_returns_nothing_from_infinity_and_triangles_without_area_nothing_at_all():
    car, lattice, pose = one_vehicle("car", centre=(0.0, 6.0)), beam_lattice(load_model("RS-16")), Pose(height_m=2.0)
    corners = vehicle_triangles(car, "body").corners
    turn = caster_class("raster")(corners, closed=True).revolution(lattice, pose, np.inf)
    assert np.isfinite(turn.distance).all()
    assert len(turn.beam) > 100
    assert len(caster_class("raster")(np.ones((5, 3, 3)), closed=True).revolution(lattice, pose, 50.0).beam) == 0


def test_solids_that_lost_a_side_to_rounding_are_drawn_from_both_sides():
    traffic, lattice = dense_traffic(seed=1, vehicles=60), beam_lattice(load_model("RS-16"), stride=8)
    corners = vehicle_triangles(traffic, "body").corners + np.array([1e12, 0.0, 0.0])
    pose = Pose(x_m=1e12, height_m=4.1, tilt_x=0.3)
    raster, oracle = caster_class("raster")(corners, closed=True), caster_class("exact")(corners)
    found = oracle.meet(pose.position, pose.to_world(lattice.components.reshape(3, -1).T), 80.0)
    np.testing.assert_array_equal(raster.revolution(lattice, pose, 80.0).beam, found.ray)


def test_a_regular_grid_shares_its_vertices():
    """Whole numbers have few bits: their hashes must not be the same."""
    from blender_lidar.casting.raster import mesh_of

    lines = np.arange(60.0)
    grid = np.stack([*np.meshgrid(lines, lines, indexing="ij"), np.zeros((60, 60))], axis=-1)
    a, b, c = grid[:-1, :-1], grid[1:, :-1], grid[1:, 1:]
    mesh = mesh_of(np.stack([a, b, c], axis=2).reshape(-1, 3, 3))
    assert len(mesh.vertices) == len(np.unique(np.concatenate([a, b, c]).reshape(-1, 3), axis=0))
    assert len(mesh.low) >= 1
