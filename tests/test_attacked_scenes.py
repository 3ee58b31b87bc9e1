"""Scans, scores and scenery under attack: many mountings at once, within vehicles, far away, and what is not finite."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from blender_lidar.casting import caster_class, is_available
from blender_lidar.casting.standing import StandingScenery
from blender_lidar.errors import InputError
from blender_lidar.scan import scan
from blender_lidar.sensors.beams import beam_lattice
from blender_lidar.sensors.model import load_model
from blender_lidar.sensors.pose import Pose
from blender_lidar.stability.attack_scenes import points_on_edges, unit, vertices_of
from blender_lidar.study.frame_scorer import FrameScorer, Observation
from blender_lidar.world.scenery import box, join
from tests.sample_traffic import dense_traffic, one_vehicle

FAST = [
    pytest.param(
        name, marks=pytest.mark.skipif(not is_available(name), reason=f"the library of {name} is not installed")
    )
    for name in ("raster", "bvh", "embree")
]
EVERY = [*FAST, "exact"]
LATTICE = beam_lattice(load_model("RS-16"), stride=12)
TRAFFIC = dense_traffic(vehicles=25, length_m=60.0)
SCENERY = join([box("wall", (0.0, 1.0, 1.0), (60.0, 0.2, 2.0)), box("gantry", (4.0, 8.0, 5.0), (0.5, 16.0, 0.6), 0.3)])
EVERYONE = np.ones(len(TRAFFIC), dtype=bool)


def seen(caster, **changes):
    return Observation(LATTICE, 60.0, 0.0, caster, "body", 0.05, **changes)


def moved(vehicles, away):
    return dataclasses.replace(vehicles, centre_m=vehicles.centre_m + away)


def awkward_mountings():
    """Within a vehicle, on its roof, above its corner, in the plane of its roof, on the road, and at the roadside."""
    x, y, z = TRAFFIC.centre_m[0].tolist()
    half = 0.5 * TRAFFIC.size_m[0]
    return [
        Pose(x, y, z),
        Pose(x, y, 2.0 * z, 0.2),
        Pose(x + half[0], y + half[1], 5.0, 0.3),
        Pose(x + 40.0, y - 12.0, 2.0 * z),
        Pose(0.0, 0.0, 0.0, -0.1),
        Pose(0.0, 0.0, 4.1, 0.3),
        Pose(-35.0, 0.0, 4.1, 0.0, 0.2),
    ]


@pytest.mark.parametrize("scenery", [None, SCENERY], ids=["open road", "with scenery"])
@pytest.mark.parametrize("caster", FAST)
def test_awkward_mountings_seen_together_see_what_the_oracle_sees(caster, scenery):
    poses = awkward_mountings()
    found, expected = (
        FrameScorer(TRAFFIC, EVERYONE, seen(name, scenery=scenery and StandingScenery(scenery, name))).see(poses)
        for name in (caster, "exact")
    )
    assert (expected.points.sum(axis=1) > 0).sum() >= len(poses) - 1  # the wall hides all from the road
    np.testing.assert_array_equal(found.points, expected.points)
    np.testing.assert_array_equal(found.occupancy, expected.occupancy)


@pytest.mark.parametrize("caster", EVERY)
def test_a_lidar_inside_a_vehicle_sees_that_vehicle_alone(caster):
    inside = awkward_mountings()[0]
    points = FrameScorer(TRAFFIC, EVERYONE, seen(caster)).see([inside]).points[0]
    assert points[0] == LATTICE.rings * LATTICE.columns
    assert points[1:].sum() == 0


@pytest.mark.parametrize("caster", FAST)
def test_scenery_hides_at_its_corners_and_edges_what_the_oracle_says_it_hides(caster):
    rng = np.random.default_rng(3)
    targets = np.concatenate([vertices_of(SCENERY.corners), *(points_on_edges(rng, SCENERY.corners) for _ in range(8))])
    for origin in ([0.0, 0.0, 4.1], [0.0, 0.0, 2.0], [30.0, 0.9, 1.0], [0.0, 1.0, 1.0]):  # the last one within the wall
        rays, distance = unit(targets - origin), np.linalg.norm(targets - origin, axis=1)
        for share in (0.5, 0.999, 1.001, 2.0):
            found, expected = (
                StandingScenery(SCENERY, name).hides(np.array(origin), rays, share * distance)
                for name in (caster, "exact")
            )
            np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize("caster", EVERY)
@pytest.mark.parametrize("shift", [1e3, 1e5, 1e7])
def test_a_road_frame_far_from_its_origin_is_scanned_and_scored_as_one_at_it(caster, shift):
    away = np.array([shift, -0.7 * shift, 0.0])
    pose = Pose(0.3, -0.4, 4.1, 0.3)
    there = Pose(pose.x_m + away[0], pose.y_m + away[1], pose.height_m, pose.tilt_x)
    near, far = (
        scan(vehicles, LATTICE, mount, caster=caster, max_range_m=60.0)
        for vehicles, mount in ((TRAFFIC, pose), (moved(TRAFFIC, away), there))
    )
    assert (near.vehicle_id >= 0).sum() > 100
    np.testing.assert_array_equal(far.vehicle_id, near.vehicle_id)
    np.testing.assert_allclose(far.range_m, near.range_m, atol=1e-6)
    np.testing.assert_allclose(far.xyz - away, near.xyz, atol=1e-6)
    points = [
        FrameScorer(vehicles, EVERYONE, seen(caster)).see([mount]).points
        for vehicles, mount in ((TRAFFIC, pose), (moved(TRAFFIC, away), there))
    ]
    np.testing.assert_array_equal(*points)


@pytest.mark.parametrize("caster", EVERY)
@pytest.mark.parametrize("away", [1e6, 1e12])
def test_one_vehicle_whose_place_is_a_mistake_empties_no_scan(caster, away):
    """With x_m = 1e12 in one row of a table a scan lost two points of three on all other vehicles, without a word."""
    names = ("vehicle_id", "class_index", "centre_m", "size_m", "heading_rad", "lane")
    lost = one_vehicle("car", centre=(away, 8.0))
    both = dataclasses.replace(
        TRAFFIC, **{name: np.concatenate([getattr(TRAFFIC, name), getattr(lost, name)]) for name in names}
    )
    alone, found = (
        scan(vehicles, LATTICE, Pose(height_m=4.1, tilt_x=0.3), caster=caster, max_range_m=60.0)
        for vehicles in (TRAFFIC, both)
    )
    np.testing.assert_array_equal(found.vehicle_id, alone.vehicle_id)
    np.testing.assert_allclose(found.range_m, alone.range_m, atol=1e-9)


@pytest.mark.parametrize("field", ["x_m", "y_m", "height_m", "tilt_x", "tilt_y", "yaw"])
@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_a_mounting_that_is_not_finite_is_refused_before_it_sees_nothing(field, value):
    with pytest.raises(InputError, match=rf"the mounting's {field} is {value}; allowed: a finite number"):
        Pose(**{field: value})


@pytest.mark.parametrize(
    ("column", "value", "says"),
    [
        ("centre_m", math.nan, r"vehicle 102 of frame 0: its centre is \[.*nan.*\] m.*; allowed: finite"),
        ("centre_m", 1e200, r"vehicle 102 of frame 0: its centre is .*less than 1e\+15 m"),
        ("heading_rad", math.inf, "vehicle 102 of frame 0: .*its heading inf rad"),
        ("size_m", 0.0, r"vehicle 102 of frame 0: its size is \[.*0.0.*\] m; allowed: lengths above 0 m"),
        ("size_m", math.nan, "vehicle 102 of frame 0: its size is"),
    ],
)
@pytest.mark.parametrize("caster", EVERY)
def test_a_vehicle_that_no_ray_could_meet_is_named(caster, column, value, says):
    broken = dataclasses.replace(TRAFFIC, **{column: getattr(TRAFFIC, column).copy()})
    getattr(broken, column)[2] = value
    with pytest.raises(InputError, match=says):
        FrameScorer(broken, EVERYONE, seen(caster))
    with pytest.raises(InputError, match=says):
        scan(broken, LATTICE, Pose(height_m=3.0), caster=caster, max_range_m=50.0)


@pytest.mark.parametrize("caster", EVERY)
def test_scenery_that_is_not_finite_or_asked_about_no_distance_is_refused(caster):
    corners = SCENERY.corners.copy()
    corners[4, 0, 0] = np.nan
    rays, distance = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]), np.array([5.0, 5.0])
    with pytest.raises(InputError, match="triangle 4 is not finite"):
        StandingScenery(dataclasses.replace(SCENERY, corners=corners), caster).hides(np.zeros(3), rays, distance)
    distance[1] = np.nan
    with pytest.raises(InputError, match="rays are followed for nan m; allowed: a distance of 0 m or more"):
        StandingScenery(SCENERY, caster).hides(np.zeros(3), rays, distance)


def test_an_open_mesh_and_a_closed_one_of_the_same_triangles_are_met_alike():
    name = next(name for name in ("embree", "bvh", "exact") if is_available(name))
    rays = LATTICE.directions.reshape(-1, 3)
    found = [caster_class(name)(SCENERY.corners, closed).cast(np.array([0, 0, 4.1]), rays) for closed in (True, False)]
    np.testing.assert_array_equal(found[0].triangle, found[1].triangle)
    np.testing.assert_array_equal(found[0].distance, found[1].distance)
