"""Instanced casting: vehicles with a mesh of the user's are met as if all their triangles were merged."""

from __future__ import annotations

import pickle
from dataclasses import replace

import numpy as np
import pytest

from blender_lidar.casting import CASTERS, caster_class, is_available
from blender_lidar.casting.culling import cut_vehicles, reachable_beams
from blender_lidar.casting.instances import OwnBodies
from blender_lidar.clouds.scan import scan
from blender_lidar.scene.observation import Observation
from blender_lidar.scoring.frame_scorer import FrameScorer, FrameShapes
from blender_lidar.sensors.beams import beam_lattice
from blender_lidar.sensors.lidar import Lidar
from blender_lidar.sensors.model import load_model
from blender_lidar.sensors.pose import Pose
from blender_lidar.traffic.vehicles import CLASSES
from blender_lidar.world.meshes import GLASS, Shape
from blender_lidar.world.shapes import shape
from blender_lidar.world.triangles import place, vehicle_triangles
from tests.sample_traffic import dense_traffic

pytestmark = pytest.mark.versions

EVERY = [
    pytest.param(name, marks=pytest.mark.skipif(not is_available(name), reason=f"{name} is not installed"))
    for name in CASTERS
]
LATTICE = beam_lattice(load_model("RS-16"), stride=4)
POSE = Pose(0.0, 0.0, 4.5, np.radians(20.0), 0.0, 0.0)


def blob(columns=24, rows=12) -> Shape:
    """A closed mesh without symmetry that fills the unit box, its upper half of glass."""
    around, up = np.meshgrid(np.linspace(0, 2 * np.pi, columns, endpoint=False), np.linspace(0, np.pi, rows))
    swell = 1.0 + 0.2 * np.cos(3 * around + 0.5) * np.sin(up)
    points = np.stack([swell * np.cos(around) * np.sin(up), swell * np.sin(around) * np.sin(up), -np.cos(up)], axis=-1)
    points = points.reshape(-1, 3)
    low, high = points.min(axis=0), points.max(axis=0)
    a = np.add.outer(columns * np.arange(rows - 1), np.arange(columns)).ravel()
    b = np.add.outer(columns * np.arange(rows - 1), np.roll(np.arange(columns), -1)).ravel()
    faces = np.concatenate([np.stack([a, b, b + columns], 1), np.stack([a, b + columns, a + columns], 1)])
    points = (points - low) / (high - low) - 0.5
    return Shape(points, faces, np.where(points[faces].mean(axis=1)[:, 2] > 0.0, GLASS, 0).astype(np.uint8))


BODIES = {"car": blob(), "truck": blob(9, 7)}


def traffic(vehicles=40):
    return dense_traffic(vehicles=vehicles, length_m=120.0)


def merged(vehicles, bodies):
    """The same triangles in the order of an `InstancedTree`: ours, then those of each vehicle with an own mesh."""
    rows = bodies.rows(vehicles)
    parts = [vehicle_triangles(vehicles, "body", rows >= 0).corners]
    for row in np.flatnonzero(rows >= 0):
        shape = list(bodies.shapes.values())[rows[row]]
        at = vehicles.centre_m[[row]], vehicles.size_m[[row]], vehicles.heading_rad[[row]]
        parts.append(place(shape.vertices, *at)[0][shape.faces])
    return np.concatenate(parts)


def random_rays(rng, count=4000):
    origins = np.repeat(rng.uniform([-30, -8, 0.3], [30, 20, 8], (8, 3)), count // 8, axis=0)
    rays = rng.uniform([-60, 0, 0], [60, 25, 3], (count, 3)) - origins
    return origins, rays / np.linalg.norm(rays, axis=1)[:, None]


@pytest.mark.parametrize("caster", EVERY)
def test_every_caster_meets_instances_as_exact_meets_the_merged_triangles(caster):
    vehicles, bodies = traffic(), OwnBodies(BODIES)
    assert {"car", "truck"} <= {CLASSES[index] for index in vehicles.class_index}
    tree = FrameShapes(vehicles, "body", caster, bodies).tree
    corners = merged(vehicles, bodies)
    oracle = caster_class("exact")(corners)
    origins, rays = random_rays(np.random.default_rng(3))
    for start in (origins, origins[0]):
        for reach in (np.inf, 40.0):
            found, expected = tree.meet(start, rays, reach), oracle.meet(start, rays, reach)
            both, here, there = np.intersect1d(found.ray, expected.ray, return_indices=True)
            assert len(found.ray) - len(both) <= 2  # a ray along an outline
            assert len(expected.ray) - len(both) <= 2
            assert len(both) > 300
            np.testing.assert_allclose(found.distance[here], expected.distance[there], rtol=1e-9)
            same = found.triangle[here] == expected.triangle[there]
            assert same.mean() > 0.999  # of a ray along an edge either neighbour
            normal, other = tree.normals(found.triangle[here]), oracle.normals(expected.triangle[there])
            np.testing.assert_allclose(normal[same], other[same], atol=1e-9)


@pytest.mark.parametrize("caster", EVERY)
def test_casters_agree_on_clouds_and_scores_to_the_last_digit(caster):
    vehicles, bodies = traffic(), pickle.loads(pickle.dumps(OwnBodies(BODIES)))
    counted = np.arange(len(vehicles)) % 3 > 0
    found = []
    for name, culled in ((caster, True), ("exact", False)):
        seen = Observation((Lidar(LATTICE, 60.0, 0.4),), name, "body", 0.05, bodies=bodies, culled=culled)
        scorer = FrameScorer(replace(vehicles, counted=counted), seen)
        found.append((scan(vehicles, seen, POSE), scorer.see([[POSE], [POSE]], keep_returns=True)))
    (cloud, scored), (expected, judged) = found
    for column in ("xyz", "vehicle_id", "class_index", "incidence_rad", "intensity"):
        np.testing.assert_array_equal(getattr(cloud, column), getattr(expected, column))
    np.testing.assert_array_equal(scored.occupancy, judged.occupancy)
    np.testing.assert_array_equal(scored.points, judged.points)
    on_cars = np.isin(cloud.vehicle_id, vehicles.vehicle_id[bodies.rows(vehicles) >= 0])
    assert on_cars.sum() > 300
    assert len(np.unique(cloud.intensity[on_cars])) > 100


def test_a_mesh_of_ours_as_own_body_gives_the_points_that_it_gives_merged():
    vehicles = traffic()
    as_own = OwnBodies({"car": shape("car", "detailed")})
    clouds = [
        scan(vehicles, Observation((Lidar(LATTICE, 60.0, 0.4),), "exact", "detailed", 0.05, bodies=bodies), POSE)
        for bodies in (None, as_own)
    ]
    np.testing.assert_array_equal(clouds[0].vehicle_id, clouds[1].vehicle_id)
    np.testing.assert_allclose(clouds[0].xyz, clouds[1].xyz, atol=1e-8)
    np.testing.assert_allclose(clouds[0].intensity, clouds[1].intensity, atol=1e-8)


def test_no_beam_that_meets_an_own_mesh_is_culled():
    vehicles, bodies = traffic(), OwnBodies({"car": BODIES["car"]})
    shapes = FrameShapes(vehicles, "body", "exact", bodies)
    directions = POSE.to_world(LATTICE.components.reshape(3, -1).T)
    met = shapes.tree.meet(POSE.position, directions, 60.0).ray
    kept = reachable_beams(LATTICE, cut_vehicles(vehicles, "body", shapes.own), POSE, 60.0)
    assert len(met) > 100
    assert np.isin(met, kept).all()


def test_long_trucks_have_the_mesh_of_trucks_unless_they_have_their_own():
    vehicles = traffic()
    is_long = (vehicles.class_name == "truck") & (vehicles.size_m[:, 0] >= 9.0)
    assert (OwnBodies({"truck": blob(4, 4)}).rows(vehicles)[is_long] == 0).all()
    both = OwnBodies({"truck": blob(4, 4), "long_truck": blob(5, 5)})
    assert (both.rows(vehicles)[is_long] == 1).all()
    assert (both.rows(vehicles)[vehicles.class_name == "car"] == -1).all()
