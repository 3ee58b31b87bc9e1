"""S-MIG, M-SOG and expected visibility of real cars, beside what a real detector makes of the same cars."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest

from blender_lidar.metrics.assignment import NO_BOX, points_in_boxes
from blender_lidar.metrics.metric import vehicle_returns
from blender_lidar.metrics.occupancy_prior import OccupiedFrames, VehiclePrior, box_visibility, reach_probability
from blender_lidar.metrics.vgop import to_vehicle_frame
from blender_lidar.metrics.voxel_grid import VoxelGrid
from blender_lidar.sensors.beams import beam_lattice
from blender_lidar.sensors.model import load_model

DATA = Path(__file__).parents[2] / "shared" / "data" / "kitti"
pytestmark = pytest.mark.skipif(not DATA.is_dir(), reason="the KITTI excerpt of ../shared/data is not here")


@pytest.fixture(scope="module")
def cars():
    """Boxes (n,), frames (n,) and the detector's confidence times IoU (n,), NaN out of its range, of all cars."""
    with (DATA / "cars.csv").open(newline="") as stream:
        rows = sorted(csv.DictReader(stream), key=lambda row: row["frame"])
    columns = {
        name: np.array([float(row[name]) for row in rows]) for name in rows[0] if name not in ("split", "label_kind")
    }
    return {
        "frame": columns["frame"],
        "centre": np.column_stack([columns[name] for name in ("x_m", "y_m", "z_m")]),
        "size": np.column_stack([columns[name] for name in ("length_m", "width_m", "height_m")]),
        "heading": columns["yaw_rad"],
        "performance": np.where(
            columns["second_in_range"] > 0, columns["second_confidence"] * columns["second_iou3d"], np.nan
        ),
    }


def returns_of(cars, which):
    """The returns from some of the cars."""
    points, vehicle, rows = [], [], np.flatnonzero(which)
    for frame in np.unique(cars["frame"][rows]):
        mine = rows[cars["frame"][rows] == frame]
        boxes = [cars[name][mine] for name in ("centre", "size", "heading")]
        cloud = np.fromfile(DATA / "velodyne" / f"{int(frame):06d}.bin", np.float32).reshape(-1, 4)[:, :3].astype(float)
        row = points_in_boxes(cloud, *boxes, ground_clearance_m=0.1)
        inside = row != NO_BOX
        points.append(to_vehicle_frame(cloud[inside], boxes[0], boxes[2], row[inside]))
        vehicle.append(np.searchsorted(rows, mine[row[inside]]))
    return vehicle_returns(np.concatenate(points), np.concatenate(vehicle), cars["size"][rows])


def rank_correlation(values, cars, which):
    performance = cars["performance"][which]
    known = np.isfinite(performance)
    ranks = [np.argsort(np.argsort(some[known], kind="stable")) for some in (values, performance)]
    assert known.sum() > 60
    return np.corrcoef(*ranks)[0, 1]


def test_the_published_sign_of_s_mig_ranks_cars_in_the_reverse_of_a_detector(cars):
    """With a prior from one half of the frames and cars from the other."""
    odd = cars["frame"] % 2 == 1
    prior = VehiclePrior.learn(returns_of(cars, ~odd))
    returns = returns_of(cars, odd)
    assert rank_correlation(prior.covered_entropy(returns), cars, odd) > 0.75
    assert rank_correlation(prior.s_mig(returns), cars, odd) < -0.75
    assert abs(rank_correlation(prior.m_sog(returns), cars, odd)) < 0.4


def test_a_car_returns_most_from_its_surface(cars):
    prior = VehiclePrior.learn(returns_of(cars, np.ones(len(cars["frame"]), dtype=bool)))
    middle = np.array(prior.p.shape) // 2
    around = prior.p[middle[0] - 12 : middle[0] + 12, middle[1] - 5 : middle[1] + 5, middle[2] - 4 : middle[2] + 4]
    core = prior.p[middle[0] - 4 : middle[0] + 4, middle[1] - 2 : middle[1] + 2, middle[2] - 2 : middle[2] + 2]
    assert around.max() > 0.3
    assert core.mean() < 0.5 * around.mean()


def test_expected_visibility_of_a_car_knows_something_of_the_detector_but_less_than_its_returns(cars):
    """From a prior of where cars are in the LiDAR's frame, which other frames taught."""
    grid = VoxelGrid.covering((0.0, -40.0, -2.5), (80.0, 40.0, 1.0), 0.4)
    odd, boxes = cars["frame"] % 2 == 1, [cars[name] for name in ("centre", "size", "heading")]
    even = [cars["frame"] == frame for frame in np.unique(cars["frame"][~odd])]
    frames = OccupiedFrames([grid.in_boxes(*(part[which] for part in boxes)) for which in even], len(grid))
    lattice = beam_lattice(load_model("HDL-64E-S2"), stride=3)
    beams = lattice.directions.reshape(-1, 3)
    forward = np.column_stack([beams[:, 1], -beams[:, 0], beams[:, 2]])  # KITTI's x is where zero azimuth looks
    reached = reach_probability(grid, frames.prior, np.zeros(3), forward, 120.0, 0.9)
    visible = box_visibility(grid, reached, *(part[odd] for part in boxes))
    assert visible.min() >= 0.0
    assert visible.max() <= 1.0
    correlation = rank_correlation(visible, cars, odd)
    returns = returns_of(cars, odd)
    assert 0.2 < correlation < rank_correlation(returns.count, cars, odd)
