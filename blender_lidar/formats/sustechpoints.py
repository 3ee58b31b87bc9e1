"""Folders of SUSTechPOINTS, the annotation tool of the paper: https://github.com/naurril/SUSTechPOINTS."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np

from ..scan import PointCloud
from ..traffic.vehicles import Vehicles
from .atomic import make_folder, write_text
from .kitti import levelled
from .pcd import write_pcd

# Names of the tool's own object types, in the order of `traffic.vehicles.CLASSES`.
OBJECT_TYPES = ("Car", "Van", "Truck", "Bus", "Motorcycle")


def write_sustechpoints(folder: str | Path, cloud: PointCloud, vehicles: Vehicles, header: dict) -> None:
    """Write one frame into a scene folder: ``lidar/NNNNNN.pcd`` and ``label/NNNNNN.json``.

    Both are in the levelled sensor's frame: x where the LiDAR's +y looks, y to its left, z up. A label is the list of
    the boxes that return at least one point, with centre, size along, across and up, and Euler angles [rad].

    Raises
    ------
    OutputError
        If a file cannot be written.
    """
    folder = Path(folder)
    for part in ("lidar", "label"):
        make_folder(folder / part, "--out")
    pose = header["pose"]
    seen = np.flatnonzero(np.isin(vehicles.vehicle_id, cloud.vehicle_id))
    centre = levelled(vehicles.centre_m[seen], pose)
    turn = math.radians(pose["yaw_deg"]) + 0.5 * math.pi  # from the road's x axis to that of the levelled frame
    boxes = [
        {
            "obj_id": str(vehicles.vehicle_id[row]),
            "obj_type": OBJECT_TYPES[vehicles.class_index[row]],
            "psr": {
                "position": _axes(place),
                "rotation": _axes([0.0, 0.0, math.remainder(vehicles.heading_rad[row] - turn, 2.0 * math.pi)]),
                "scale": _axes(vehicles.size_m[row]),
            },
        }
        for row, place in zip(seen.tolist(), centre, strict=True)
    ]
    name = f"{vehicles.frame:06d}"
    write_text(folder / "label" / f"{name}.json", json.dumps(boxes, indent=1) + "\n")
    write_pcd(folder / "lidar" / f"{name}.pcd", replace(cloud, xyz=levelled(cloud.xyz, pose)), header)


def _axes(values):
    return {axis: round(float(value), 6) for axis, value in zip("xyz", values, strict=True)}
