"""Recorded roadside clouds of an RS-Ruby-Lite-V2R in the median of a motorway, and boxes fitted to their points.

A folder has one revolution, `revolution.npz`, further ones in float16, `frames_float16.npz`, and the boxes,
`vehicles_fitted.csv`, in the frame of the carriageway that each is on: x ahead, y to the left, origin under the sensor.
"""

from __future__ import annotations

import csv
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from blender_lidar.errors import MissingFileError
from blender_lidar.sensors.pose import Pose
from blender_lidar.studies.recorded import LabelledBoxes, RecordedFrame
from blender_lidar.traffic.vehicles import CLASSES, FLEET_KINDS, fleet_kind

# Of the roadside sensor, found from the road: its height above the crown line [m], and of each carriageway the tilts
# that make its plane level and the yaw that makes its lines parallel to x [degrees].
HEIGHT_M, LENS_M = 3.49, 0.03612
CARRIAGEWAYS = {"left": (0.385 - 1.232, -0.075, 0.42), "right": (0.385 + 1.232, -0.075, 0.14)}
SECTOR_RAD = np.radians(125.0)  # beyond it, aft, columns return nothing
FIRST_HALF = ("raw", "348509", "348537", "348555", "348565", "348587")


def roadside_frames(folder: Path) -> Iterator[tuple[RecordedFrame, Pose, np.ndarray]]:
    """Each carriageway of each cloud, the sensor's pose over it, and how sure each box (n,) is, A to D.

    The lens turns at `LENS_M` from the axis, towards the column. Points and boxes are moved back by so much, level and
    towards the axis, so that rays start on it.
    """
    for name in ("vehicles_fitted.csv", "revolution.npz", "frames_float16.npz"):
        if not (folder / name).is_file():
            raise MissingFileError(f"--roadside: {folder / name}: there is no such file")
    with (folder / "vehicles_fitted.csv").open(encoding="utf-8", newline="") as stream:
        rows = list(csv.DictReader(stream))
    halves = np.load(folder / "frames_float16.npz")
    for file in dict.fromkeys(row["file"] for row in rows):
        points = np.load(folder / "revolution.npz")["xyz_m"] if file == "raw" else halves[f"s{file}000"]
        points = points.reshape(-1, 3).astype(float)
        points = _towards_axis(points[np.isfinite(points).all(axis=1)])
        for side, tilts in CARRIAGEWAYS.items():
            pose = Pose(0.0, 0.0, HEIGHT_M, *np.radians(tilts))
            mine = [row for row in rows if (row["file"], row["carriageway"]) == (file, side)]
            of = lambda *keys, mine=mine: np.array([[float(row[key]) for key in keys] for row in mine])  # noqa: E731
            label, size = np.array([row["class"] for row in mine]), of("length_m", "width_m", "height_m")
            classes, lane = np.array([CLASSES.index(name) for name in label]), np.zeros(len(mine), dtype=np.int16)
            centre, heading = _towards_axis(of("x_m", "y_m", "z_m")), np.radians(of("heading_deg")[:, 0])
            columns = of("vehicle_id")[:, 0].astype(int), classes, centre, size, heading, lane
            shape = np.array(FLEET_KINDS)[fleet_kind(classes, size[:, 0])]
            boxes = LabelledBoxes(0, 0.0, *columns, label=label, shape=shape)
            known = np.array([row["confidence"] for row in mine])
            yield RecordedFrame(file, f"{folder}: {file}", pose.position + pose.to_world(points), boxes), pose, known


def _towards_axis(points: np.ndarray) -> np.ndarray:
    rho = np.hypot(points[:, 0], points[:, 1])
    return points * np.column_stack([1.0 - LENS_M / rho, 1.0 - LENS_M / rho, np.ones_like(rho)])
