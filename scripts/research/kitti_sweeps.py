"""KITTI's labelled sweeps: boxes in the LiDAR's frame, and rings recovered from the order of the points.

KITTI's object benchmark as it is unpacked, ``velodyne/ID.bin``, ``label_2/ID.txt`` and ``calib/ID.txt``: labels are in
the rectified camera's frame (x right, y down, z ahead; the place is the middle of the box's floor) and are turned into
the LiDAR's (x ahead, y left, z up) by the calibration, as the development kit has it: Geiger, Lenz and Urtasun, "Are we
ready for autonomous driving? The KITTI vision benchmark suite", CVPR 2012.

Files of rotating LiDARs such as KITTI's keep ring after ring, in each of which the azimuth turns once; a new ring
starts where it wraps. Lasers do not fire from one point: in KITTI's HDL-64E the rays of the upper block cross the axis
0.20 m above the origin of the coordinates, those of the lower one 0.12 m, and where a sweep tells it, in a third of the
rings, they pass it by about 0.02 m to the left or to the right. Seen from the origin a ring's elevation therefore
depends on the range, by a degree between 10 m and far away, which is two to three rings; and azimuths shift by nearly a
step at 10 m. Seen from the laser neither does. So each ring is the cone ``z = height + tan(elevation) * rho``, which
its points miss by 0.3 mm (median over KITTI's sweeps), with the same heights and elevations in all sweeps to 1 mm and
0.001 degrees.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import numpy as np

from blender_lidar.clouds.rings import Rings
from blender_lidar.errors import InputError
from blender_lidar.studies.recorded import LabelledBoxes, RecordedFrame
from blender_lidar.traffic.vehicles import CLASSES, FLEET_KINDS, VAN_LONGER_THAN_M, fleet_kind

KITTI_MARGIN_M = (0.15, 0.06, 0.01)
"""By how much KITTI's labels are longer, wider and higher than the cars in them [m], fitted to 59 of its cars."""
_NO_BOX = "DontCare"  # a region of the picture, without a place in space
# KITTI's labels and the class whose shape stands for each. What has no shape of its own only hides others and is a
# plain box; people fill about half of theirs.
_CLASS_OF = {"Car": "car", "Van": "van", "Truck": "truck", "Tram": "bus", "Bus": "bus"}
_CLASS_OF |= {"Cyclist": "motorcycle", "Motorcycle": "motorcycle"}
_PEOPLE = ("Pedestrian", "Person_sitting", "Person")
_SHARE_OF_PEOPLE = np.array([0.6, 0.6, 1.0])

FEWEST_RINGS, MOST_RINGS = 4, 256
_FEWEST_RETURNS = 8  # of half of the rings; high ones may see next to nothing
_LEAST_ORDERED = 0.9  # share of neighbouring rings of which the one is above the other as all others are
_NEW_RING_RAD = 0.1  # falls the azimuth so far, a ring begins; edges of near things and jitter take it back by less
_BACKWARDS_RAD, _MOST_BACKWARDS = 1e-4, 0.01  # share of steps between neighbours that may go against the turn
_OFF_CONE_M, _MOST_OFF_CONE = 0.05, 0.1  # a return is off its ring's cone from here on; share of them that may be
_MOST_HEIGHT_M = 0.6  # of a laser; a plane, such as the road through parts of two rings, is a cone of greater height
_FITS = 25
_FINE_M = 5e-4  # distances below do not count as less
_HEIGHT_PRIOR_M = 0.2  # a ring that sees one range alone says nothing of its height: it is near 0
_LATERAL_M = np.linspace(-0.06, 0.06, 61)  # candidates
_LEVEL = 0.002  # [1/m]: neighbours whose inverse ranges differ by less have no parallax
_CLEARLY_BETTER = 0.7  # of the misfit of a laser on the axis
_TURN = 2.0 * math.pi


def kitti_names(folder: Path) -> list[str]:
    """Names of the frames that have all their files, sorted."""
    parts = {"velodyne": ".bin", "label_2": ".txt", "calib": ".txt"}
    stems = [{path.stem for path in (folder / part).glob(f"*{suffix}")} for part, suffix in parts.items()]
    return sorted(set.intersection(*stems))


def kitti_frame(folder: Path, name: str) -> tuple[RecordedFrame, np.ndarray]:
    """A frame in the LiDAR's frame, and which of its boxes (n,) the picture cuts off, so that they are guesses.

    `number` of a box is its line in the label file, counted from 0.
    """
    points = np.fromfile(folder / "velodyne" / f"{name}.bin", dtype="<f4").reshape(-1, 4)[:, :3].astype(float)
    calibration = (folder / "calib" / f"{name}.txt").read_text(encoding="utf-8").splitlines()
    entries = dict(line.partition(":")[::2] for line in calibration)
    rectified, to_camera = (np.array(entries[key].split(), dtype=float) for key in ("R0_rect", "Tr_velo_to_cam"))
    to_camera = rectified.reshape(3, 3) @ to_camera.reshape(3, 4)
    lines = (folder / "label_2" / f"{name}.txt").read_text(encoding="utf-8").splitlines()
    rows = [(number, *line.split()) for number, line in enumerate(lines) if line.split() and line.split()[0] != _NO_BOX]
    label = np.array([row[1] for row in rows], dtype=str)
    table = np.array([row[2:16] for row in rows], dtype=float).reshape(len(rows), 14)
    size = table[:, [9, 8, 7]]
    in_camera = table[:, 10:13] - size[:, 2:] * [0.0, 0.5, 0.0]
    turn = table[:, 13]  # about the camera's y axis, which points down; 0 looks along its x axis
    rotation, shift = to_camera[:, :3], to_camera[:, 3]
    ahead = np.column_stack([np.cos(turn), np.zeros_like(turn), -np.sin(turn)]) @ rotation  # the inverse, transposed
    boxes = LabelledBoxes(
        frame=0,
        time_s=0.0,
        vehicle_id=np.array([row[0] for row in rows], dtype=np.int64),
        class_index=np.array([_class_of(name) for name in label.tolist()], dtype=np.int8),
        lane=np.zeros(len(rows), dtype=np.int16),
        label=label,
        shape=np.array(list(map(_shape_of, label.tolist(), size[:, 0].tolist())), dtype=str),
        centre_m=(in_camera - shift) @ rotation,
        size_m=np.where(np.isin(label, _PEOPLE)[:, None], size * _SHARE_OF_PEOPLE, size),
        heading_rad=np.arctan2(ahead[:, 1], ahead[:, 0]),
    )
    finite = np.isfinite(points).all(axis=1)
    return RecordedFrame(name, f"{folder}: {name}", points[finite], boxes), table[:, 0] > 0.0


def _class_of(label: str) -> int:
    """Index into `CLASSES`; -1 for what is no vehicle."""
    name = _CLASS_OF.get(label)
    return -1 if name is None else CLASSES.index(name)


def _shape_of(label: str, length_m: float) -> str:
    """The shape for a KITTI label; a car longer than 4.9 m is a van, as in traffic."""
    name = _CLASS_OF.get(label)
    if name == "car" and length_m > VAN_LONGER_THAN_M:
        name = "van"
    return "" if name is None else FLEET_KINDS[fleet_kind(CLASSES.index(name), length_m)]


# --- Rings from the order of the points -------------------------------------------------------------------------------


def recover_rings(points: np.ndarray) -> Rings:
    """The rings of a sweep whose points are in ring order, of a sensor that need not be known.

    Parameters
    ----------
    points : ndarray, (n, 3)
        Returns in the sensor's levelled frame, in the order of the file [m].

    Raises
    ------
    InputError
        Where the points are not ring after ring, each with the azimuth turning once, from one end of the field of view
        to the other: such as PCD files that were filtered, merged or written column by column.
    """
    points = np.asarray(points, dtype=float)
    rho, z = np.hypot(points[:, 0], points[:, 1]), points[:, 2]
    azimuth = np.arctan2(points[:, 1], points[:, 0])
    for starts in _ring_starts(azimuth):
        ends = np.append(starts, len(points))
        ring = np.repeat(np.arange(len(starts)), np.diff(ends))
        cones = np.array([_cone(rho[a:b], z[a:b]) for a, b in pairwise(ends)])
        off = np.abs(z - cones[ring, 0] - cones[ring, 1] * rho)
        rising = np.diff(cones[:, 1])
        ordered = max((rising > 0).mean(), (rising < 0).mean()) >= _LEAST_ORDERED
        if ordered and (off > _OFF_CONE_M).mean() <= _MOST_OFF_CONE and np.abs(cones[:, 0]).max() <= _MOST_HEIGHT_M:
            break
    else:
        raise InputError(f"{len(points)} points are not in ring order: ring after ring, each one turn")
    level = (np.diff(ring) == 0) & (np.abs(np.diff(1.0 / np.maximum(rho, 1e-9))) < _LEVEL)
    steps = np.abs(_wrapped(np.diff(azimuth)))[level]
    usual = np.median(steps)  # encoders round steps, so that the median alone is off
    step = float(steps[(steps > 0.25 * usual) & (steps < 1.25 * usual)].mean())
    lateral = np.array([_lateral(azimuth[a:b], rho[a:b], step) for a, b in pairwise(ends)])
    if (rising < 0).mean() > 0.5:
        ring, cones, lateral = len(cones) - 1 - ring, cones[::-1], lateral[::-1]
    return Rings(ring, np.arctan(cones[:, 1]), cones[:, 0].copy(), lateral.copy(), step, float(np.median(off)))


def _ring_starts(azimuth: np.ndarray) -> Iterator[np.ndarray]:
    """First points of the rings, for every way and place that turns may start from and that fits."""
    for seam in (0.0, math.pi):  # ahead or behind
        for way in (1.0, -1.0):
            step = np.diff(np.mod(way * (azimuth - seam), _TURN))
            wraps = step < -_NEW_RING_RAD
            backwards = (step < -_BACKWARDS_RAD) & ~wraps
            starts = np.concatenate([[0], np.flatnonzero(wraps) + 1])
            usual = np.median(np.diff(np.append(starts, len(azimuth))))
            ordered = usual >= _FEWEST_RETURNS and backwards.mean() <= _MOST_BACKWARDS
            if ordered and FEWEST_RINGS <= len(starts) <= MOST_RINGS:
                yield starts


def _cone(rho: np.ndarray, z: np.ndarray) -> tuple[float, float]:
    """Height and tangent of the elevation of the cone about the vertical axis that most points lie on."""
    design = np.column_stack([np.ones_like(rho), rho])
    height, slope = 0.0, np.median(z / np.maximum(rho, 1e-9))
    for _ in range(_FITS):  # least absolute distances, by weights
        weight = 1.0 / np.maximum(np.abs(z - height - slope * rho), _FINE_M)
        normal = (weight[:, None] * design).T @ design
        normal[0, 0] += 1.0 / _HEIGHT_PRIOR_M
        height, slope = np.linalg.solve(normal, design.T @ (weight * z))
    return float(height), float(slope)


def _lateral(azimuth: np.ndarray, rho: np.ndarray, step: float) -> float:
    """How far a ring's rays pass the axis by [m]: what puts its returns on one grid of azimuths at any range."""
    between, nearer = np.abs(_wrapped(np.diff(azimuth))), np.diff(1.0 / np.maximum(rho, 1.0))
    way = np.sign(np.median(_wrapped(np.diff(azimuth))))
    telling = (np.abs(nearer) > 0.004) & (between < 10.0 * step)
    if telling.sum() < 12:
        return 0.0
    grid = 0.5 * step  # encoders of half a step are common
    phase = (between[telling] - way * _LATERAL_M[:, None] * nearer[telling]) / grid
    weight = np.minimum(np.abs(nearer[telling]), 0.05)
    misfit = np.abs(phase - np.round(phase)) @ weight / weight.sum()
    best = int(np.argmin(misfit))
    return float(_LATERAL_M[best]) if misfit[best] < _CLEARLY_BETTER * misfit[len(_LATERAL_M) // 2] else 0.0


def _wrapped(angle: np.ndarray) -> np.ndarray:
    return np.mod(angle + math.pi, _TURN) - math.pi
