"""A small folder of labelled sweeps in the layout of KITTI or SUSTechPOINTS, and detections that belong to it."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

from blender_lidar.files import to_csv

KITTI = Path(__file__).parents[1].parent / "shared" / "data" / "kitti"
needs_kitti = pytest.mark.skipif(not KITTI.is_dir(), reason=f"no KITTI excerpt at {KITTI}")
SIZE_M = (4.2, 1.8, 1.5)
CALIBRATION = "R0_rect: 1 0 0 0 1 0 0 0 1\nTr_velo_to_cam: 0 -1 0 0 0 0 -1 0 1 0 0 0\n"
_FRONT_M = 1.7  # height of the sensor above the road


def sample_cars(frames=16, cars=4, seed=1):
    """For each frame its cars: centre, heading and points of each, in the sensor's frame; far cars have few points."""
    rng = np.random.default_rng(seed)
    found = {}
    for frame in range(frames):
        boxes = []
        for number in range(cars):
            x, y = rng.uniform(6.0, 48.0), 6.0 * (number - 1.5) + rng.uniform(-0.5, 0.5)
            heading = rng.uniform(-math.pi, math.pi) if number % 2 else rng.normal(0.0, 0.05)
            number_of_points = rng.poisson(2500.0 / math.hypot(x, y) * rng.uniform(0.2, 1.0))
            local = rng.uniform(-0.5, 0.5, (number_of_points, 3)) * SIZE_M
            face = rng.integers(0, 2, number_of_points)
            local[np.arange(number_of_points), face] = 0.499 * np.array(SIZE_M)[face]  # on two of its sides
            cos, sin = math.cos(heading), math.sin(heading)
            turned = local @ np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]])
            centre = np.array([x, y, -_FRONT_M + 0.5 * SIZE_M[2]])
            boxes.append((centre, heading, turned + centre))
        found[f"{frame:06d}"] = boxes
    return found


def ground(rng):
    """Returns from the road, between the boxes."""
    return np.column_stack([rng.uniform(0, 60, 500), rng.uniform(-15, 15, 500), np.full(500, -_FRONT_M - 0.05)])


def write_kitti_sweep(folder, name, points, labels):
    """One sweep in KITTI's layout: points in the sensor's frame, and the lines of its labels."""
    for part in ("velodyne", "label_2", "calib"):
        (folder / part).mkdir(parents=True, exist_ok=True)
    rows = np.column_stack([points, np.full(len(points), 0.3)]).astype("<f4")
    (folder / "velodyne" / f"{name}.bin").write_bytes(rows.tobytes())
    (folder / "calib" / f"{name}.txt").write_text(CALIBRATION, encoding="utf-8")
    (folder / "label_2" / f"{name}.txt").write_text("\n".join(labels) + "\n", encoding="utf-8")


def write_kitti(folder, found):
    """Write the frames in KITTI's layout; a DontCare stands first, so that cars begin at entry 1."""
    rng = np.random.default_rng(9)
    length, width, height = SIZE_M
    for frame, boxes in found.items():
        lines = ["DontCare -1 -1 -10 0 0 10 10 -1 -1 -1 -1000 -1000 -1000 -10"]
        for number, (centre, heading, _) in enumerate(boxes):
            x, y, z = centre
            place = f"{-y:.9f} {-(z - 0.5 * height):.9f} {x:.9f}"
            turn = -heading - 0.5 * math.pi
            lines.append(f"Car 0 {number % 3} 0 0 0 9 9 {height} {width} {length} {place} {turn:.9f}")
        write_kitti_sweep(folder, frame, np.vstack([ground(rng), *(points for _, _, points in boxes)]), lines)
    return folder


def write_sustech(folder, found, name="car"):
    """Write the frames in SUSTechPOINTS' layout."""
    for part in ("lidar", "label"):
        (folder / part).mkdir(parents=True)
    rng = np.random.default_rng(9)
    for frame, boxes in found.items():
        points = np.vstack([ground(rng), *(points for _, _, points in boxes)])
        header = f"VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH {len(points)}\nHEIGHT 1\n"
        body = points.astype("<f4").tobytes()
        text = f"{header}POINTS {len(points)}\nDATA binary\n".encode()
        (folder / "lidar" / f"{frame}.pcd").write_bytes(text + body)
        objects = [
            {
                "obj_type": name,
                "psr": {
                    "position": dict(zip("xyz", centre.tolist(), strict=True)),
                    "scale": dict(zip("xyz", SIZE_M, strict=True)),
                    "rotation": {"x": 0.0, "y": 0.0, "z": heading},
                },
            }
            for centre, heading, _ in boxes
        ]
        (folder / "label" / f"{frame}.json").write_text(json.dumps(objects), encoding="utf-8")
    return folder


def detection_rows(found, first_entry, noise=0.05):
    """A detector `good` does as well as a car has points, `blind` by chance; the nearest are out of its range."""
    rng = np.random.default_rng(4)
    rows = []
    for frame, boxes in found.items():
        for number, (centre, _, points) in enumerate(boxes):
            share = min(max(0.15 * math.log1p(len(points)) + noise * rng.normal(), 0.0), 1.0)
            good = (round(share, 4), 0.9) if len(points) else (0.0, 0.0)
            in_range = int(math.hypot(*centre[:2]) > 8.0)
            rows.append([frame, number + first_entry, *good, round(rng.uniform(), 4), 0.5, in_range])
    return rows


HEADER = ["frame", "label_line", "good_confidence", "good_iou3d", "blind_confidence", "blind_iou3d", "blind_in_range"]


def write_detections(path, found, first_entry=1, **settings):
    """Write the cars' table and, beside it, one of frames: the first half is val, the second train."""
    path.write_text(to_csv(HEADER, detection_rows(found, first_entry, **settings)), encoding="utf-8")
    half = len(found) // 2
    rows = [[frame, "val" if number < half else "train", "object"] for number, frame in enumerate(found)]
    path.with_name("frames.csv").write_text(to_csv(["frame", "split", "label_kind"], rows), encoding="utf-8")
    return path
