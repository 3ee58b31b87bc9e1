"""Recorded clouds beside a table of boxes, and the rays of their sensor, those without a return as well."""

from __future__ import annotations

import math
import re
from functools import cache

import numpy as np
import pytest

from blender_lidar.errors import InputError
from blender_lidar.sensors.beams import beam_lattice
from blender_lidar.sensors.model import load_model
from blender_lidar.sensors.pose import Pose
from blender_lidar.studies.recorded import NO_POINT, Firings, Rays, crossing, table_rings, tabled_frames
from tests.recorded_samples import HEIGHT_M, SENSOR, scanned, street

LATTICE, POSE = beam_lattice(load_model(SENSOR)), Pose(height_m=HEIGHT_M)


@cache
def swept():
    """A turn over a street."""
    return scanned(street())


def firings(xyz):
    return Firings(xyz, table_rings(POSE.to_sensor(xyz), LATTICE)[0], POSE)


def test_rays_run_through_the_points_that_they_returned_as():
    cloud = swept()
    rays, _ = firings(cloud.xyz).towards(np.array([5.0, 20.0, 1.0]), np.array([8.0, 4.0, 3.0]), 0.4)
    returned = rays.point != NO_POINT
    assert 0 < returned.sum() < len(returned)
    at = rays.origin[returned] + rays.range_m[returned, None] * rays.direction[returned]
    np.testing.assert_allclose(at, cloud.xyz[rays.point[returned]], atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(rays.direction, axis=1), 1.0, atol=1e-12)
    assert np.isinf(rays.range_m[~returned]).all()


@pytest.mark.parametrize("centre", [(4.0, 25.0, 0.8), (0.0, 14.0, 0.8), (-18.0, 0.0, 0.8), (0.3, -30.0, 0.8)])
def test_firings_that_did_not_return_are_put_back_where_they_were(centre):
    """A third of the returns are taken away; the rays towards a box are the sensor's own all the same."""
    cloud = swept()
    kept = np.random.default_rng(4).random(len(cloud.xyz)) > 0.3
    size, heading, centre = np.array([4.5, 1.8, 1.6]), 0.7, np.array(centre)
    rays, _ = firings(cloud.xyz[kept]).towards(centre, size, heading)
    beams = LATTICE.directions.reshape(-1, 3)
    count = len(beams)
    every = Rays(np.tile(POSE.position, (count, 1)), beams, np.full(count, NO_POINT), np.full(count, np.inf))
    entry, leave = crossing(every, centre, size, heading)
    true = beams[(leave >= entry) & (leave > 0.0)]
    assert abs(len(rays.point) - len(true)) <= 0.02 * len(true) + 1
    nearest = np.max(true @ rays.direction.T, axis=1)
    assert np.degrees(np.arccos(np.clip(nearest, -1.0, 1.0))).max() < 0.1  # steps are 0.17


# --- Clouds beside a table --------------------------------------------------------------------------------------------


@pytest.fixture
def table(tmp_path):
    """Two frames of one vehicle each, and clouds of one point for both."""
    for name in "ab":
        np.savez(tmp_path / f"{name}.npz", xyz=np.array([[10.0, 2.0, 1.0]]))
    path = tmp_path / "boxes.csv"
    header = "frame,vehicle_id,class,x_m,y_m,length_m,width_m,height_m,heading_deg"
    path.write_text(f"{header}\n1,7,car,10,2,4,2,1.5,90\n2,7,truck,11,2,10,2.5,4,90\n", encoding="utf-8")
    return path


def test_each_cloud_has_the_boxes_of_its_frame(table):
    clouds = [str(table.with_name(f"{name}.npz")) for name in "ab"]
    first, second = tabled_frames(clouds, str(table), (2, 1))
    assert (first.name, first.boxes.shape.tolist(), second.boxes.shape.tolist()) == ("2", ["long_truck"], ["car"])
    assert second.boxes.centre_m.tolist() == [[10.0, 2.0, 0.75]]
    assert second.points.tolist() == [[10.0, 2.0, 1.0]]
    np.testing.assert_allclose(second.boxes.heading_rad, [0.5 * math.pi])


@pytest.mark.parametrize(
    ("clouds", "frames", "message"),
    [
        ("a", None, "holds 2 frames, 1 to 2, for 1 clouds; give --frame with a number for each cloud"),
        ("ab", (1,), "--frame: 1 numbers; allowed: one for each of the 2 clouds"),
        ("a", (3,), "no frame 3; the recording has 2 frames from 1 to 2"),
    ],
)
def test_clouds_that_have_no_frame_are_refused(table, clouds, frames, message):
    paths = [str(table.with_name(f"{name}.npz")) for name in clouds]
    with pytest.raises(InputError, match=re.escape(message)):
        list(tabled_frames(paths, str(table), frames))
