"""No beam that meets a vehicle is culled, wherever the sensor hangs and looks; most of the others are."""

from __future__ import annotations

import functools

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from blender_lidar.casting import CASTERS, caster_class, culling, is_available
from blender_lidar.casting.culling import cut_vehicles, ray_directions, reachable_beams, revolutions
from blender_lidar.sensors.beams import beam_lattice
from blender_lidar.sensors.model import load_model
from blender_lidar.sensors.pose import Pose
from blender_lidar.traffic.vehicles import CLASSES
from blender_lidar.world.shapes import DETAILS, SHAPES
from blender_lidar.world.triangles import vehicle_triangles
from tests.sample_traffic import dense_traffic, one_vehicle

pytestmark = pytest.mark.versions

SENSORS = ("RS-16", "RS-LiDAR-32", "RS-BPearl")  # even, with azimuth offsets, looking up to its own axis
PLACES = ("roadside", "above", "beside", "inside", "behind")
ANGLES = st.floats(-np.pi, np.pi)
lattice_of = functools.cache(lambda sensor, stride: beam_lattice(load_model(sensor), stride=stride))


def kept_beams(vehicles, lattice, pose, gate=50.0, detail="body"):
    """Mask over all beams of the lattice: those that are left after culling."""
    kept = np.zeros(lattice.rings * lattice.columns, dtype=bool)
    kept[reachable_beams(lattice, cut_vehicles(vehicles, detail), pose, gate)] = True
    return kept


def meeting_beams(vehicles, lattice, pose, gate=50.0, detail="body", caster="exact"):
    """Mask over all beams: those that meet a vehicle when every beam is cast."""
    rays = pose.to_world(lattice.directions.reshape(-1, 3))
    tree = caster_class(caster)(vehicle_triangles(vehicles, detail).corners)
    return np.isfinite(tree.cast(pose.position, rays, gate).distance)


def mount(place, vehicles, rng):
    """Where the sensor is [m]: at the roadside, or somewhere about the first vehicle."""
    centre, size, heading = vehicles.centre_m[0], vehicles.size_m[0], vehicles.heading_rad[0]
    left = np.array([-np.sin(heading), np.cos(heading)])
    if place == "above":
        return [*centre[:2], size[2] + rng.uniform(0.01, 3.0)]
    if place == "beside":
        return [*(centre[:2] - left * (0.5 * size[1] + rng.uniform(0.01, 0.5))), rng.uniform(0.1, 4.0)]
    if place == "inside":
        return centre + rng.uniform(-0.3, 0.3, 3) * size
    if place == "behind":
        return [centre[0], centre[1] + rng.uniform(3.0, 20.0), rng.uniform(0.5, 4.5)]
    return [rng.uniform(-20, 20), rng.uniform(-6, 0), rng.uniform(0.5, 6.0)]


@settings(max_examples=300)
@given(
    seed=st.integers(0, 2**32 - 1),
    vehicles=st.integers(1, 5),
    place=st.sampled_from(PLACES),
    sensor=st.sampled_from(SENSORS),
    stride=st.sampled_from([17, 25, 40]),
    detail=st.sampled_from(DETAILS),
    gate=st.sampled_from([6.0, 30.0, 150.0]),
    angles=st.tuples(ANGLES, ANGLES, ANGLES),
)
@example(1, 1, "above", "RS-BPearl", 25, "box", 150.0, (0.0, 0.0, 0.0))
@example(59, 3, "above", "RS-LiDAR-32", 17, "box", 6.0, (0.0, 0.0, 0.0))  # a piece's middle on the very axis
@example(2, 1, "inside", "RS-16", 25, "body", 150.0, (0.0, 0.0, 0.0))
@example(3, 5, "behind", "RS-LiDAR-32", 25, "body", 150.0, (0.2, 0.0, 0.0))
@example(4, 5, "roadside", "RS-LiDAR-32", 17, "detailed", 150.0, (0.2, 0.0, 0.0))
def test_no_beam_that_meets_a_vehicle_is_culled(seed, vehicles, place, sensor, stride, detail, gate, angles):
    rng = np.random.default_rng(seed)
    traffic = dense_traffic(seed=seed, vehicles=vehicles, length_m=rng.uniform(8.0, 40.0) * vehicles)
    traffic.heading_rad[:] += rng.choice([0.0, 1.0]) * rng.uniform(-np.pi, np.pi, vehicles)
    pose = Pose(*map(float, mount(place, traffic, rng)), *angles)
    lattice = lattice_of(sensor, stride)
    meets = meeting_beams(traffic, lattice, pose, gate, detail)
    assert not (meets & ~kept_beams(traffic, lattice, pose, gate, detail)).any()


@pytest.mark.parametrize("detail", DETAILS)
@pytest.mark.parametrize("at", [(0.0, 10.0), (0.0, -10.0), (-10.0, 0.0), (0.05, 3.0)])
def test_a_vehicle_ahead_behind_or_across_azimuth_zero_keeps_its_beams_on_both_sides(at, detail):
    vehicle, lattice, pose = one_vehicle("car", centre=at), lattice_of("RS-16", 4), Pose(height_m=2.0)
    meets = meeting_beams(vehicle, lattice, pose, detail=detail)
    kept = kept_beams(vehicle, lattice, pose, detail=detail)
    assert meets.sum() > 30
    assert not (meets & ~kept).any()
    assert kept.mean() < 0.2
    if at[1] > 0:
        for mask in (meets, kept):
            slots = np.flatnonzero(mask.reshape(lattice.rings, -1).any(axis=0))
            assert slots.min() == 0
            assert slots.max() == lattice.columns - 1


@pytest.mark.parametrize("sensor", ["RS-Helios-5515", "RS-BPearl"], ids=["down at a sill", "up at a roof edge"])
def test_the_middle_of_a_near_edge_reaches_farther_than_its_ends(sensor):
    """Seen from nearby a straight edge is a bow, whose beams must not be taken for beams that pass the vehicle by."""
    vehicle, lattice = one_vehicle("bus", centre=(0.0, 3.0)), lattice_of(sensor, 2)
    for height in np.linspace(0.2, 3.0, 15).tolist():
        pose = Pose(height_m=height)
        meets = meeting_beams(vehicle, lattice, pose, detail="box")
        assert not (meets & ~kept_beams(vehicle, lattice, pose, detail="box")).any()


@pytest.mark.parametrize("corner", [(0.5, 0.5), (0.5, 0.0), (0.0, 0.5), (-0.5, -0.5)])
def test_a_sensor_whose_axis_runs_along_a_side_or_an_edge_of_a_box_loses_no_beam(corner):
    vehicle, lattice = one_vehicle("van", centre=(3.0, 4.0)), lattice_of("RS-BPearl", 10)
    over = vehicle.centre_m[0, :2] + np.array(corner) * vehicle.size_m[0, :2]
    for height in (1.95, 4.0):  # just above the roof, and well above
        for tilt in (np.pi, 0.0):  # a hemisphere of beams downwards, and upwards
            pose = Pose(*over.tolist(), height, tilt)
            meets = meeting_beams(vehicle, lattice, pose, detail="box")
            assert not (meets & ~kept_beams(vehicle, lattice, pose, detail="box")).any()


@pytest.mark.parametrize(
    "caster",
    [
        pytest.param(name, marks=pytest.mark.skipif(not is_available(name), reason=f"{name} is not installed"))
        for name in ("embree", "bvh")
    ],
)
@pytest.mark.parametrize("beside_rad", [1e-9, 1e-8, 1e-7, 1e-6])
def test_a_beam_that_only_a_float32_caster_lets_touch_a_silhouette_is_kept(caster, beside_rad):
    """Beams past a box's upright edge by less than float32 can tell: with culling the caster must still be asked."""
    lattice, pose = lattice_of("RS-16", 1), Pose(height_m=1.0)
    for slot in range(5, 200, 25):
        azimuth = lattice.slot_azimuth0_rad[0] + slot * lattice.step_rad - beside_rad
        vehicle = one_vehicle("car", centre=(3.0 * np.tan(azimuth) - 2.0, 3.9), size=[4.0, 1.8, 1.5])
        far = one_vehicle("car", centre=(200.0, 200.0))  # makes the scene large, and float32 coarse
        traffic = type(vehicle)(
            0,
            0.0,
            *(
                np.concatenate([getattr(vehicle, name), getattr(far, name)])
                for name in ("vehicle_id", "class_index", "centre_m", "size_m", "heading_rad", "lane")
            ),
        )
        meets = meeting_beams(traffic, lattice, pose, detail="box", caster=caster)
        assert not (meets & ~kept_beams(traffic, lattice, pose, detail="box")).any()


@pytest.mark.parametrize(("sensor", "gate"), [("RS-16", 50.0), ("RS-32", 80.0), ("RS-80", 150.0)])
def test_on_dense_traffic_most_beams_are_culled(sensor, gate):
    lattice = lattice_of(sensor, 4)
    kept = kept_beams(dense_traffic(), lattice, Pose(height_m=4.1, tilt_x=np.radians(13.0)), gate)
    assert 0.02 < kept.mean() < 0.4


def test_of_the_beams_that_are_left_most_meet_a_vehicle():
    lattice, pose = lattice_of("RS-16", 20), Pose(height_m=4.1, tilt_x=np.radians(19.0))
    traffic = dense_traffic(vehicles=40, length_m=150.0)
    meets, kept = meeting_beams(traffic, lattice, pose), kept_beams(traffic, lattice, pose)
    assert not (meets & ~kept).any()
    assert meets.sum() > 0.5 * kept.sum()


@pytest.mark.parametrize("caster", [name for name in CASTERS if is_available(name)])
def test_mountings_cast_together_and_one_by_one_meet_the_same(caster):
    traffic, lattice = dense_traffic(vehicles=60, length_m=200.0), lattice_of("RS-LiDAR-32", 20)
    rng = np.random.default_rng(0)
    poses = [Pose(*rng.uniform([-5, -3, 1], [5, 0, 5]), *rng.uniform(-0.5, 0.5, 3)) for _ in range(40)]
    poses[7] = Pose(x_m=10_000.0)  # from where nothing is in range
    pieces, tree = cut_vehicles(traffic, "body"), caster_class(caster)(vehicle_triangles(traffic).corners, closed=True)
    together = list(revolutions(tree, lattice, poses, 60.0, pieces))
    assert len(together) == len(poses)
    for found, pose in zip(together, poses, strict=True):
        (alone,) = revolutions(tree, lattice, [pose], 60.0, pieces)
        for column, other in zip(found, alone, strict=True):
            np.testing.assert_array_equal(column, other)
        np.testing.assert_array_equal(found.beam, np.unique(found.beam))
    assert len(together[7].beam) == 0
    assert list(revolutions(tree, lattice, [], 60.0, pieces)) == []


def test_without_vehicles_or_out_of_range_no_beam_is_left():
    lattice = lattice_of("RS-16", 20)
    assert not kept_beams(dense_traffic(vehicles=0), lattice, Pose()).any()
    assert not kept_beams(one_vehicle("bus", centre=(0.0, 60.0)), lattice, Pose(), gate=50.0).any()
    assert kept_beams(one_vehicle("bus", centre=(0.0, 51.0)), lattice, Pose(), gate=50.0).any()


@pytest.mark.parametrize("detail", DETAILS)
@pytest.mark.parametrize("name", SHAPES)
@pytest.mark.parametrize("length", [0.3, 2.1, 4.9, 16.5])
def test_the_pieces_of_a_vehicle_cover_its_surface_and_stay_in_its_box(name, detail, length):
    if name == "long_truck" and length < 9.0:
        pytest.skip("a truck as short as this has the other shape")
    vehicle = one_vehicle(name.removeprefix("long_"), size=[length, 2.0, 1.7])
    pieces = cut_vehicles(vehicle, detail).corners.T
    low, high = pieces.min(axis=1), pieces.max(axis=1)  # heading 0: the pieces lie along the axes
    half = 0.5 * vehicle.size_m[0]
    np.testing.assert_allclose(low.min(axis=0), vehicle.centre_m[0] - half, atol=1e-12)
    np.testing.assert_allclose(high.max(axis=0), vehicle.centre_m[0] + half, atol=1e-12)
    weights = np.random.default_rng(1).dirichlet([0.5, 0.5, 0.5], 40)
    points = np.einsum("wc,tcj->twj", weights, vehicle_triangles(vehicle, detail).corners).reshape(-1, 1, 3)
    inside = ((points >= low - 1e-12) & (points <= high + 1e-12)).all(axis=2)
    assert inside.any(axis=1).all()


def test_every_motor_vehicle_class_is_in_the_property_test():
    """Guards the strategy above: it would be worthless if it drew cars alone."""
    drawn = {int(index) for seed in range(40) for index in dense_traffic(seed=seed, vehicles=5).class_index}
    assert drawn == set(range(CLASSES.index("bicycle")))


@pytest.mark.skipif(not is_available("raster"), reason="Numba is not installed")
@pytest.mark.parametrize("sensor", SENSORS)
@pytest.mark.parametrize("place", PLACES)
def test_compiled_culling_keeps_the_beams_that_numpys_keeps(sensor, place, monkeypatch):
    from blender_lidar.casting.kernels import directions_of

    rng = np.random.default_rng(5)
    traffic, lattice = dense_traffic(seed=3, vehicles=40, length_m=200.0), lattice_of(sensor, 3)
    pieces = cut_vehicles(traffic, "body")
    poses = [Pose(*map(float, mount(place, traffic, rng)), *rng.uniform(-0.6, 0.6, 3)) for _ in range(4)]
    fast = [reachable_beams(lattice, pieces, pose, 60.0) for pose in poses]
    monkeypatch.setattr(culling, "_fastest", lambda: (culling._angular_bounds, culling._beams_inside))
    for ours, pose in zip(fast, poses, strict=True):
        np.testing.assert_array_equal(ours, reachable_beams(lattice, pieces, pose, 60.0))
        rotated = np.empty((len(ours), 3))
        directions_of(lattice.components.reshape(3, -1), ours, pose.rotation, rotated)
        np.testing.assert_array_equal(ray_directions(lattice, ours, pose), rotated.T)
