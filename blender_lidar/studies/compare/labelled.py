"""Labelled point clouds of real LiDARs, in the layouts of KITTI and SUSTechPOINTS: sweeps and their bounding boxes.

KITTI's object benchmark as it is unpacked, ``velodyne/ID.bin``, ``label_2/ID.txt`` and ``calib/ID.txt``: labels are in
the rectified camera's frame (x right, y down, z ahead; the place is the middle of the box's floor) and are turned into
the LiDAR's (x ahead, y left, z up) by the calibration, as the development kit has it: Geiger, Lenz and Urtasun, "Are we
ready for autonomous driving? The KITTI vision benchmark suite", CVPR 2012.

Scenes of SUSTechPOINTS, the annotation tool of the paper (https://github.com/naurril/SUSTechPOINTS),
``lidar/NAME.pcd`` and ``label/NAME.json``: a list of objects, each with ``obj_type`` and ``psr``: place, scale (along,
across, up) and Euler angles of its box in the LiDAR's frame. `scan --format sustechpoints` writes such.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ...clouds.files import read_points
from ...errors import InputError, MissingFileError, printable
from ...traffic.source import open_bytes

NOT_TOLD = -1
_NO_BOX = "DontCare"  # KITTI: a region of the picture, without a place in space
_FIELDS = 15  # of a KITTI label: type, truncation, occlusion, alpha, picture box (4), size (3), place (3), turn
_LARGEST = 1e4  # of any number of a label or a calibration


@dataclass(frozen=True, slots=True, eq=False)
class LabelledBoxes:
    """The bounding boxes of one sweep or of many.

    Attributes
    ----------
    label_line : ndarray of int64, (n,)
        Which entry of the label file each is, counted from 0.
    label : ndarray of str, (n,)
        What each is, in the data set's own words: ``"Car"``, ``"Van"``, ``"Pedestrian"``.
    centre_m, size_m : ndarray, (n, 3)
        Box centres; length, width and height [m, sensor frame].
    heading_rad : ndarray, (n,)
        Counter-clockwise from +x [rad].
    occlusion : ndarray of int8, (n,)
        KITTI's: 0 wholly visible, 1 partly, 2 largely hidden, 3 unknown; `NOT_TOLD` where the layout has none.
    truncation : ndarray, (n,)
        Share that lies outside the camera's picture; NaN where the layout has none.
    """

    label_line: np.ndarray
    label: np.ndarray
    centre_m: np.ndarray
    size_m: np.ndarray
    heading_rad: np.ndarray
    occlusion: np.ndarray
    truncation: np.ndarray

    def __len__(self) -> int:
        return len(self.label)

    @property
    def distance_m(self) -> np.ndarray:
        """Horizontal distance of each box centre from the sensor, (n,) [m]."""
        return np.hypot(self.centre_m[:, 0], self.centre_m[:, 1])

    @property
    def bearing_deg(self) -> np.ndarray:
        """Angle between the line of sight to each box's centre and its axis, (n,): 0 (end-on) to 90 (side-on)."""
        sight = np.arctan2(self.centre_m[:, 1], self.centre_m[:, 0])
        return np.degrees(np.arccos(np.clip(np.abs(np.cos(self.heading_rad - sight)), 0.0, 1.0)))

    def of_class(self, classes: Sequence[str]) -> np.ndarray:
        """Which boxes bear one of the labels, (n,) bool; capitals do not matter."""
        return np.isin(np.char.lower(self.label.astype(str)), [name.lower() for name in classes])

    def select(self, which: np.ndarray) -> LabelledBoxes:
        """The boxes that `which`, a (n,) mask or an index array, picks."""
        return LabelledBoxes(*(getattr(self, field.name)[which] for field in fields(self)))

    def columns(self) -> dict[str, np.ndarray]:
        """What tables of cars tell of each box, by column, (n,) each."""
        return {
            "label_line": self.label_line,
            "distance_m": self.distance_m,
            "bearing_deg": self.bearing_deg,
            **dict(zip(("length_m", "width_m", "height_m"), self.size_m.T, strict=True)),
            "occlusion": self.occlusion,
        }


def joined(tables: Sequence[Mapping[str, np.ndarray]]) -> dict[str, np.ndarray]:
    """Tables of the same columns, such as those of one sweep each, one below the other."""
    return {name: np.concatenate([table[name] for table in tables]) for name in tables[0]}


class LabelledSweep(NamedTuple):
    """One revolution of a real LiDAR.

    Attributes
    ----------
    frame : str
        Its name: that of its files, without a suffix.
    points : ndarray, (n, 3)
        Returns in the sensor's own, levelled frame: origin at its optical centre, z up; in the order of the file [m].
    boxes : LabelledBoxes
        What is in it.
    """

    frame: str
    points: np.ndarray
    boxes: LabelledBoxes


@dataclass(frozen=True, slots=True)
class LabelledClouds:
    """A folder of labelled sweeps, read one at a time.

    Attributes
    ----------
    folder : Path
    layout : str
        A key of `LAYOUTS`.
    frames : tuple of str
        Names of the sweeps that have all their files, sorted.
    unpaired : int
        Files left aside because their partner is missing.
    """

    folder: Path
    layout: str
    frames: tuple[str, ...]
    unpaired: int

    def __len__(self) -> int:
        return len(self.frames)

    def read(self, frame: str) -> LabelledSweep:
        """One sweep.

        Raises
        ------
        InputError, MissingFileError
            Naming the file, and the line where there is one.
        """
        layout = LAYOUTS[self.layout]
        paths = (self.folder / part / f"{frame}{suffix}" for part, suffix in layout.folders.items())
        return LabelledSweep(frame, *layout.read(*paths))


def open_labelled(folder: str | Path) -> LabelledClouds:
    """The labelled sweeps of a folder; nothing is read yet but names.

    Raises
    ------
    MissingFileError, InputError
        If the folder is not there, has neither layout, or no sweep with all its files.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise MissingFileError(f"--kitti: {folder}: there is no such folder")
    wanted = []
    for name, (parts, _) in LAYOUTS.items():
        files = " and ".join(f"{part}/NAME{suffix}" for part, suffix in parts.items())
        if all((folder / part).is_dir() for part in parts):
            stems = [{path.stem for path in (folder / part).glob(f"*{suffix}")} for part, suffix in parts.items()]
            whole = set.intersection(*stems)
            if not whole:
                raise InputError(f"--kitti: {folder}: no sweep with all its files; allowed: {files}")
            return LabelledClouds(folder, name, tuple(sorted(whole)), len(set.union(*stems)) - len(whole))
        wanted.append(f"{name}: {files}")
    raise InputError(f"--kitti: {folder}: has the layout of no known data set; allowed: {'; or '.join(wanted)}")


def _content(path: Path) -> bytes:
    with open_bytes(path, unpack=False) as stream:
        return stream.read()


# --- KITTI ------------------------------------------------------------------------------------------------------------


def _read_kitti(velodyne: Path, label: Path, calibration: Path) -> tuple[np.ndarray, LabelledBoxes]:
    """Points of a sweep that are finite, and its boxes."""
    boxes, content = _kitti_boxes(label, _kitti_calibration(calibration)), _content(velodyne)
    if len(content) % 16:
        raise InputError(f"{velodyne}: {len(content)} bytes; allowed: 16 for each point, four numbers of float32")
    with np.errstate(invalid="ignore"):
        points = np.frombuffer(content, dtype="<f4").reshape(-1, 4)[:, :3].astype(float)
    return points[np.isfinite(points).all(axis=1)], boxes


def _kitti_calibration(path: Path) -> np.ndarray:
    """From the LiDAR's frame into the rectified camera's: rotation and, in the last column, shift [m], (3, 4)."""
    entries = {name.strip(): numbers.split() for name, _, numbers in (line.partition(":") for line in _lines(path))}
    matrices = []
    for name, columns in (("R0_rect", 3), ("Tr_velo_to_cam", 4)):
        words = entries.get(name, [])
        if len(words) != 3 * columns:
            raise InputError(f"{path}: {name} has {len(words)} numbers; allowed: {3 * columns}")
        matrices.append(np.reshape(_numbers(f"{path}: {name}", words), (3, columns)))
    motion = matrices[0] @ matrices[1]
    if np.abs(motion[:, :3] @ motion[:, :3].T - np.eye(3)).max() > 1e-3:
        raise InputError(f"{path}: R0_rect times Tr_velo_to_cam is no rotation")
    return motion


def _kitti_boxes(path: Path, to_camera: np.ndarray) -> LabelledBoxes:
    """The boxes of a ``label_2`` file in the LiDAR's frame; `to_camera` as `_kitti_calibration` gives it."""
    rows, labels, lines = [], [], []
    for number, words in enumerate(map(str.split, _lines(path))):
        if not words or words[0] == _NO_BOX:
            continue
        where = f"{path}:{number + 1}"
        if len(words) not in (_FIELDS, _FIELDS + 1):  # detections carry a score at the end
            raise InputError(f"{where}: {len(words)} fields; allowed: {_FIELDS}, as KITTI's labels have")
        rows.append(_numbers(where, words[1:_FIELDS], sides=slice(7, 10)))
        if rows[-1][1] not in (-1, 0, 1, 2, 3):
            raise InputError(f"{where}: occlusion is {rows[-1][1]:g}; allowed: -1, 0, 1, 2 or 3")
        labels.append(printable(words[0], 40))
        lines.append(number)
    table = np.array(rows, dtype=float).reshape(len(rows), _FIELDS - 1)
    size = table[:, [9, 8, 7]]
    in_camera = table[:, 10:13] - size[:, 2:] * [0.0, 0.5, 0.0]
    turn = table[:, 13]  # about the camera's y axis, which points down; 0 looks along its x axis
    rotation, shift = to_camera[:, :3], to_camera[:, 3]
    ahead = np.column_stack([np.cos(turn), np.zeros_like(turn), -np.sin(turn)]) @ rotation  # the inverse, transposed
    return LabelledBoxes(
        label_line=np.array(lines, dtype=np.int64),
        label=np.array(labels, dtype=str),
        centre_m=(in_camera - shift) @ rotation,
        size_m=size,
        heading_rad=np.arctan2(ahead[:, 1], ahead[:, 0]),
        occlusion=table[:, 1].astype(np.int8),
        truncation=table[:, 0],
    )


def _lines(path: Path) -> list[str]:
    return _content(path).decode("utf-8", errors="replace").splitlines()


# --- SUSTechPOINTS ----------------------------------------------------------------------------------------------------


def _read_sustech(cloud: Path, label: Path) -> tuple[np.ndarray, LabelledBoxes]:
    """Points and boxes of a scene; of a box's angles only the one about the vertical axis is used."""
    points, _ = read_points(cloud)
    try:
        objects = json.loads(_content(label))
    except (ValueError, RecursionError) as error:
        raise InputError(f"{label}: is no JSON file ({error})") from error
    if isinstance(objects, dict):  # later versions of the tool wrap the list
        objects = objects.get("objs")
    if not isinstance(objects, list):
        raise InputError(f"{label}: holds no list of objects")
    labels, rows = [], []
    for number, one in enumerate(objects):
        where = f"{label}: object {number}"
        try:
            psr = one["psr"]
            numbers = [psr[part][axis] for part in ("position", "scale") for axis in "xyz"] + [psr["rotation"]["z"]]
            labels.append(printable(str(one["obj_type"]), 40))
        except (KeyError, TypeError) as error:
            raise InputError(f"{where}: has no obj_type and psr with numbers (position, scale, rotation)") from error
        rows.append(_numbers(where, numbers, sides=slice(3, 6)))
    table = np.array(rows, dtype=float).reshape(len(rows), 7)
    return points, LabelledBoxes(
        label_line=np.arange(len(rows)),
        label=np.array(labels, dtype=str),
        centre_m=table[:, :3],
        size_m=table[:, 3:6],
        heading_rad=table[:, 6],
        occlusion=np.full(len(rows), NOT_TOLD, dtype=np.int8),
        truncation=np.full(len(rows), np.nan),
    )


def _numbers(where: str, given: Iterable, sides: slice = slice(0)) -> list[float]:
    """Finite numbers of bearable size; those in the slice are sides of a box and above 0."""
    try:
        numbers = [float(one) for one in given]
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(f"{where}: {error}") from error
    if not np.abs(numbers).max() <= _LARGEST:  # NaN is not either
        raise InputError(f"{where}: a number is not finite or beyond {_LARGEST:g}")
    if min(numbers[sides], default=1.0) <= 0.0:
        raise InputError(f"{where}: a side of the box is {min(numbers[sides]):g} m; allowed: more than 0")
    return numbers


class SweepLayout(NamedTuple):
    """How a data set is laid out: its folders with the suffix of the files in each, and what reads one sweep's files.

    The reader takes the files' paths in the order of the folders and gives points, (n, 3) [m], and boxes.
    """

    folders: dict[str, str]
    read: Callable[..., tuple[np.ndarray, LabelledBoxes]]


LAYOUTS = {
    "KITTI": SweepLayout({"velodyne": ".bin", "label_2": ".txt", "calib": ".txt"}, _read_kitti),
    "SUSTechPOINTS": SweepLayout({"lidar": ".pcd", "label": ".json"}, _read_sustech),
}
