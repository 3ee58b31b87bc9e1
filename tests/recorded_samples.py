"""Clouds of our own sensor, written as recordings are: the comparison with reality is tried on what is known."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from blender_lidar.casting import is_available
from blender_lidar.sensors.beams import beam_lattice
from blender_lidar.sensors.imperfections import PERFECT
from blender_lidar.sensors.model import load_model
from blender_lidar.sensors.pose import Pose
from blender_lidar.traffic.boxes import Boxes
from blender_lidar.traffic.vehicles import CLASSES
from tests.sample_traffic import scan

KITTI = Path(__file__).parents[1].parent / "shared" / "data" / "kitti"
needs_kitti = pytest.mark.skipif(not KITTI.is_dir(), reason=f"no KITTI excerpt at {KITTI}")
CASTER = "embree" if is_available("embree") else "exact"
HEIGHT_M = 1.73
SENSOR = "HDL-64E-S3"
CALIBRATION = "R0_rect: 1 0 0 0 1 0 0 0 1\nTr_velo_to_cam: 0 -1 0 0 0 0 -1 0 1 0 0 0\n"


def street(seed: int = 1, cars: int = 7) -> Boxes:
    """Cars about a LiDAR at the origin, 12 to 45 m ahead of it (+y) at all bearings, none hidden by another."""
    rng = np.random.default_rng(seed)
    azimuth = np.linspace(-0.9, 0.9, cars)
    distance = rng.uniform(12.0, 45.0, cars)
    size = rng.uniform([3.6, 1.6, 1.4], [4.6, 1.9, 1.6], (cars, 3))
    centre = np.column_stack([distance * np.sin(azimuth), distance * np.cos(azimuth), 0.5 * size[:, 2]])
    return Boxes(
        frame=seed,
        time_s=0.0,
        vehicle_id=np.arange(cars),
        class_index=np.full(cars, CLASSES.index("car"), dtype=np.int8),
        centre_m=centre,
        size_m=size,
        heading_rad=rng.uniform(-np.pi, np.pi, cars),
        lane=np.ones(cars, dtype=np.int16),
    )


def scanned(vehicles: Boxes, pose: Pose | None = None, sensor=SENSOR, detail: str = "body", imperfections=PERFECT):
    """The cloud of one turn over vehicles, in the road frame."""
    return scan(
        vehicles,
        beam_lattice(load_model(sensor)),
        Pose(height_m=HEIGHT_M) if pose is None else pose,
        caster=CASTER,
        detail=detail,
        max_range_m=60.0,
        imperfections=imperfections,
    )


def in_kitti_frame(xyz: np.ndarray) -> np.ndarray:
    """Points (n, 3) of the road frame in the sensor's, x ahead."""
    return xyz[:, [1, 0, 2]] * [1.0, -1.0, 1.0] - [0.0, 0.0, HEIGHT_M]
