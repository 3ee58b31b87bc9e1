"""One revolution over one frame, against geometry that can be written down and a scan without short cuts."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from blender_lidar.casting import caster_class
from blender_lidar.clouds.scan import class_names
from blender_lidar.errors import InputError
from blender_lidar.sensors.beams import beam_lattice
from blender_lidar.sensors.model import load_model
from blender_lidar.sensors.pose import Pose
from blender_lidar.world.shapes import DETAILS
from blender_lidar.world.triangles import vehicle_triangles
from tests.sample_traffic import dense_traffic, one_vehicle, scan

pytestmark = pytest.mark.versions

LATTICES = {name: beam_lattice(load_model(name), stride=10) for name in ("RS-16", "RS-LiDAR-32", "RS-BPearl")}
LATTICE = LATTICES["RS-16"]
TRAFFIC = dense_traffic(vehicles=40, length_m=100.0)
LEVEL = Pose(height_m=4.1)
TILTED = Pose(1.0, -0.5, 4.1, math.radians(19.0), math.radians(4.0), math.radians(-30.0))
HANGING = Pose(1.0, -0.5, 4.1, math.radians(170.0), 0.0, math.radians(100.0))
POSES = pytest.mark.parametrize("pose", [LEVEL, TILTED, HANGING], ids=["level", "tilted", "hanging"])


def cloud_of(vehicles=TRAFFIC, lattice=LATTICE, pose=TILTED, **changes):
    options = {"caster": "exact", "detail": "body", "min_range_m": 0.4, "max_range_m": 60.0} | changes
    return scan(vehicles, lattice, pose, **options)


def by_hand(pose, vectors):
    """Vectors from the sensor's frame into the road's: turned about x by -tilt_x, y by -tilt_y, z by yaw."""
    for angle, (a, b) in ((-pose.tilt_x, (1, 2)), (-pose.tilt_y, (2, 0)), (pose.yaw, (0, 1))):
        turned = vectors.copy()
        turned[:, a] = math.cos(angle) * vectors[:, a] - math.sin(angle) * vectors[:, b]
        turned[:, b] = math.sin(angle) * vectors[:, a] + math.cos(angle) * vectors[:, b]
        vectors = turned
    return vectors


def local_points(cloud, vehicles):
    """Points on vehicles in their vehicle's frame, half the size of its box, and the vehicle's row."""
    mine = np.flatnonzero(cloud.vehicle_id >= 0)
    row = np.searchsorted(vehicles.vehicle_id, cloud.vehicle_id[mine])
    away = cloud.xyz[mine] - vehicles.centre_m[row]
    cos, sin = np.cos(vehicles.heading_rad[row]), np.sin(vehicles.heading_rad[row])
    local = np.column_stack([cos * away[:, 0] + sin * away[:, 1], cos * away[:, 1] - sin * away[:, 0], away[:, 2]])
    return mine, local, 0.5 * vehicles.size_m[row], row


@POSES
@pytest.mark.parametrize("sensor", sorted(LATTICES))
def test_points_are_rebuilt_from_ring_azimuth_and_range(sensor, pose):
    lattice = LATTICES[sensor]
    cloud = cloud_of(lattice=lattice, pose=pose)
    a, b = cloud.azimuth_rad, lattice.elevation_rad[cloud.ring]
    beams = np.column_stack([np.sin(a) * np.cos(b), np.cos(a) * np.cos(b), np.sin(b)])
    rebuilt = [pose.x_m, pose.y_m, pose.height_m] + cloud.range_m[:, None] * by_hand(pose, beams)
    assert len(cloud) > (100 if lattice.elevation_rad[0] < 0.0 or pose != LEVEL else -1)  # the RS-BPearl looks up
    np.testing.assert_allclose(cloud.xyz, rebuilt, atol=1e-9)


@POSES
def test_what_is_no_vehicle_is_ground_at_height_over_the_sine(pose):
    cloud = cloud_of(pose=pose)
    ground = cloud.vehicle_id < 0
    assert ground.sum() > 200
    np.testing.assert_allclose(cloud.xyz[ground, 2], 0.0, atol=1e-9)
    down = (pose.height_m - cloud.xyz[ground, 2]) / cloud.range_m[ground]  # sine of the depression
    np.testing.assert_allclose(cloud.range_m[ground], pose.height_m / down, rtol=1e-9)
    np.testing.assert_allclose(np.cos(cloud.incidence_rad[ground]), down, atol=1e-9)
    expected = 0.2 * down * np.minimum(1.0, (10.0 / cloud.range_m[ground]) ** 2)
    np.testing.assert_allclose(cloud.intensity[ground], expected, rtol=1e-9)


def test_a_level_sensor_over_an_empty_road_draws_one_circle_for_each_ring_that_looks_down():
    cloud = cloud_of(dense_traffic(vehicles=0), pose=LEVEL)
    elevation = LATTICE.elevation_rad[cloud.ring]
    np.testing.assert_allclose(cloud.range_m, -4.1 / np.sin(elevation), rtol=1e-12)
    seen = [ring for ring, b in enumerate(LATTICE.elevation_rad) if b < 0 and -4.1 / math.sin(b) <= 60.0]
    assert np.unique(cloud.ring).tolist() == seen
    assert np.bincount(cloud.ring)[seen].tolist() == [LATTICE.columns] * len(seen)
    assert set(cloud.vehicle_id) == {-1}
    assert set(class_names(cloud.class_index)) == {""}


@POSES
@pytest.mark.parametrize("detail", DETAILS)
def test_points_on_vehicles_lie_on_or_in_the_box_of_the_vehicle_they_name(detail, pose):
    cloud = cloud_of(pose=pose, detail=detail)
    mine, local, half, row = local_points(cloud, TRAFFIC)
    assert len(mine) > 200
    assert len(np.unique(row)) > 10
    assert (np.abs(local) <= half + 1e-6).all()
    if detail == "box":
        np.testing.assert_allclose((half - np.abs(local)).min(axis=1), 0.0, atol=1e-6)
    np.testing.assert_array_equal(cloud.class_index[mine], TRAFFIC.class_index[row])
    np.testing.assert_array_equal(class_names(cloud.class_index[mine]), TRAFFIC.class_name[row])
    assert (cloud.class_index[cloud.vehicle_id < 0] == -1).all()


def test_the_angle_of_incidence_on_a_box_is_that_to_its_face():
    cloud = cloud_of(detail="box")
    mine, local, half, row = local_points(cloud, TRAFFIC)
    on_face = half - np.abs(local) < 1e-6
    clear = on_face.sum(axis=1) == 1
    axis = np.argmax(on_face, axis=1)
    beam = (cloud.xyz[mine] - TILTED.position) / cloud.range_m[mine, None]
    cos, sin = np.cos(TRAFFIC.heading_rad[row]), np.sin(TRAFFIC.heading_rad[row])
    along = [cos * beam[:, 0] + sin * beam[:, 1], cos * beam[:, 1] - sin * beam[:, 0], beam[:, 2]]
    expected = np.arccos(np.abs(np.choose(axis, along)))
    assert clear.mean() > 0.9
    np.testing.assert_allclose(cloud.incidence_rad[mine][clear], expected[clear], atol=1e-6)


@settings(max_examples=25)
@given(
    seed=st.integers(0, 2**32 - 1),
    sensor=st.sampled_from(sorted(LATTICES)),
    height=st.floats(0.5, 6.0),
    angles=st.tuples(st.floats(-1.6, 1.6), st.floats(-0.5, 0.5), st.floats(-3.0, 3.0)),
    near=st.sampled_from([0.0, 0.4, 8.0]),
)
def test_every_beam_returns_from_the_first_thing_it_meets(seed, sensor, height, angles, near):
    """Against all beams cast at vehicles and a huge quad in place of the ground."""
    vehicles, lattice = dense_traffic(seed=seed, vehicles=6, length_m=25.0), LATTICES[sensor]
    pose = Pose(0.0, 0.0, height, *angles)
    corner = 1e4 * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    world = vehicle_triangles(vehicles, "body")
    triangles = np.concatenate([world.corners, corner[[[0, 1, 2], [0, 2, 3]]]])
    rays = pose.to_world(lattice.directions.reshape(-1, 3))
    hits = caster_class("exact")(triangles).cast(pose.position, rays, 30.0)
    kept = np.flatnonzero((hits.distance <= 30.0) & (hits.distance >= near))
    cloud = cloud_of(vehicles, lattice, pose, min_range_m=near, max_range_m=30.0)
    ring, slot = np.divmod(kept, lattice.columns)
    np.testing.assert_array_equal(cloud.ring, ring)
    np.testing.assert_array_equal(cloud.azimuth_rad, lattice.azimuth_rad(ring, slot))
    np.testing.assert_allclose(cloud.range_m, hits.distance[kept], rtol=1e-9, atol=1e-9)
    owner = np.append(world.owner, [-1, -1])[hits.triangle[kept]]
    expected = np.where(owner >= 0, vehicles.vehicle_id[owner], -1)
    at_the_sill = np.abs(cloud.xyz[:, 2]) < 1e-9  # where a vehicle stands on the road, either is first
    np.testing.assert_array_equal(cloud.vehicle_id[~at_the_sill], expected[~at_the_sill])


@pytest.mark.parametrize("sensor", ["RS-16", "RS-LiDAR-32", "HDL-64E-S2"])
def test_time_is_that_of_the_firing_column_and_the_ring(sensor):
    lattice = beam_lattice(load_model(sensor), stride=25)
    cloud = cloud_of(lattice=lattice)
    model = lattice.model
    column = (cloud.azimuth_rad - model.azimuth_offset_rad[cloud.ring]) / lattice.step_rad
    np.testing.assert_allclose(column, np.round(column), atol=1e-6)
    turn_s = 1.0 / lattice.rotation_hz
    expected = np.mod(np.round(column), lattice.columns) / lattice.columns * turn_s
    np.testing.assert_allclose(
        cloud.time_s, expected + np.nan_to_num(model.fire_time_s[cloud.ring]), rtol=0.0, atol=1e-12
    )
    assert cloud.time_s.min() >= 0.0
    assert cloud.time_s.max() < 1.01 * turn_s


def test_nothing_is_nearer_than_the_least_or_farther_than_the_greatest_range():
    whole = cloud_of(max_range_m=60.0)
    part = cloud_of(min_range_m=9.0, max_range_m=21.0)
    inside = (whole.range_m >= 9.0) & (whole.range_m <= 21.0)
    assert 0 < len(part) < len(whole)
    np.testing.assert_array_equal(part.range_m, whole.range_m[inside])
    np.testing.assert_array_equal(part.vehicle_id, whole.vehicle_id[inside])


def test_what_is_too_near_returns_nothing_and_hides_all_the_same():
    bus = one_vehicle("bus", centre=(0.0, 3.0), size=[12.0, 2.0, 3.2])
    cloud = cloud_of(bus, pose=Pose(height_m=2.0), min_range_m=5.0, max_range_m=60.0)
    toward = (np.abs(cloud.xyz[:, 0]) < 2.0) & (cloud.xyz[:, 1] > 4.0)
    assert len(cloud) > 100
    assert not toward.any()


def test_without_ground_only_vehicles_return():
    cloud, whole = cloud_of(ground=False), cloud_of()
    assert (cloud.vehicle_id >= 0).all()
    np.testing.assert_array_equal(cloud.xyz, whole.xyz[whole.vehicle_id >= 0])


def test_a_frame_without_anything_in_range_is_an_empty_cloud_with_the_right_columns():
    cloud, filled = cloud_of(dense_traffic(vehicles=0), max_range_m=1.0), cloud_of()
    assert (len(cloud), cloud.xyz.shape) == (0, (0, 3))
    for name in type(cloud).__slots__:
        assert getattr(cloud, name).dtype == getattr(filled, name).dtype, name
        assert len(getattr(filled, name)) == len(filled), name


@pytest.mark.parametrize("height", [0.0, -1.0])
def test_a_sensor_that_is_not_above_the_ground_is_refused(height):
    with pytest.raises(InputError, match=r"m above the ground; allowed: more than 0 m"):
        cloud_of(pose=Pose(height_m=height))
