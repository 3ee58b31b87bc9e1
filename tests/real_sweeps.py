"""Sweeps of our own sensor, written as KITTI has them: the comparison with reality is tried on what is known."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from blender_lidar.casting import is_available
from blender_lidar.clouds.scan import scan
from blender_lidar.sensors.beams import beam_lattice
from blender_lidar.sensors.imperfections import PERFECT
from blender_lidar.sensors.model import load_model
from blender_lidar.sensors.pose import Pose
from blender_lidar.traffic.vehicles import CLASSES, Vehicles
from tests.labelled_samples import write_kitti_sweep

HEIGHT_M = 1.73
SENSOR = "HDL-64E-S3"


def street(seed: int = 1, cars: int = 7) -> Vehicles:
    """Cars about a LiDAR at the origin, 12 to 45 m ahead of it (+y) at all bearings, none hidden by another."""
    rng = np.random.default_rng(seed)
    azimuth = np.linspace(-0.9, 0.9, cars)
    distance = rng.uniform(12.0, 45.0, cars)
    size = rng.uniform([3.6, 1.6, 1.4], [4.6, 1.9, 1.6], (cars, 3))
    centre = np.column_stack([distance * np.sin(azimuth), distance * np.cos(azimuth), 0.5 * size[:, 2]])
    return Vehicles(
        frame=seed,
        time_s=0.0,
        vehicle_id=np.arange(cars),
        class_index=np.full(cars, CLASSES.index("car"), dtype=np.int8),
        centre_m=centre,
        size_m=size,
        heading_rad=rng.uniform(-np.pi, np.pi, cars),
        lane=np.ones(cars, dtype=np.int16),
    )


def cloud_of(vehicles: Vehicles, detail: str = "body", imperfections=PERFECT):
    """The cloud of one turn over vehicles, and its points in KITTI's frame, in the order of rings and azimuths."""
    cloud = scan(
        vehicles,
        beam_lattice(load_model(SENSOR)),
        Pose(height_m=HEIGHT_M),
        caster="embree" if is_available("embree") else "exact",
        detail=detail,
        max_range_m=60.0,
        imperfections=imperfections,
    )
    return cloud, in_kitti_frame(cloud.xyz)


def in_kitti_frame(xyz: np.ndarray) -> np.ndarray:
    """Points (n, 3) of the road frame in the sensor's, x ahead."""
    return xyz[:, [1, 0, 2]] * [1.0, -1.0, 1.0] - [0.0, 0.0, HEIGHT_M]


def write_kitti(folder: Path, name: str, points: np.ndarray, vehicles: Vehicles, labels=None) -> None:
    """One sweep with its labels."""
    lines = []
    for row in range(len(vehicles)):
        x, y, _ = vehicles.centre_m[row].tolist()
        length, width, height = vehicles.size_m[row].tolist()
        turn = -float(vehicles.heading_rad[row])  # about the camera's y axis, from its x axis: the road frame's
        what = "Car" if labels is None else labels[row]
        lines.append(f"{what} 0 0 0 0 0 1 1 {height!r} {width!r} {length!r} {x!r} {HEIGHT_M!r} {y!r} {turn!r}")
    write_kitti_sweep(folder, name, points, lines)
