"""A dense street, a sensor over it and the clouds that it gives: what tests of lost returns look at."""

from __future__ import annotations

import numpy as np

from blender_lidar.clouds.scan import scan
from blender_lidar.sensors.beams import beam_lattice
from blender_lidar.sensors.imperfections import PERFECT
from blender_lidar.sensors.model import load_model
from blender_lidar.sensors.pose import Pose
from tests.sample_traffic import dense_traffic

LATTICE = beam_lattice(load_model("RS-LiDAR-32"), stride=4)
TRAFFIC = dense_traffic(vehicles=16, length_m=45.0, frame=7)
POSE = Pose(1.0, -0.5, 3.6, 0.3, 0.07, -0.5)


def cloud_of(imperfections=PERFECT, detail="body", vehicles=TRAFFIC, pose=POSE, **changes):
    options = {"caster": "exact", "min_range_m": 0.4, "max_range_m": 60.0} | changes
    return scan(vehicles, LATTICE, pose, detail=detail, imperfections=imperfections, **options)


def beams_of(cloud):
    """Flat index of each point's beam by (ring, slot)."""
    ring = cloud.ring.astype(int)
    slot = np.round((cloud.azimuth_rad - LATTICE.slot_azimuth0_rad[ring]) / LATTICE.step_rad).astype(int)
    return ring * LATTICE.columns + slot
