"""Recorded, labelled point clouds: a folder in KITTI's layout, or clouds beside a table of bounding boxes.

KITTI's object benchmark as it is unpacked, ``velodyne/ID.bin``, ``label_2/ID.txt`` and ``calib/ID.txt``: labels are in
the rectified camera's frame (x right, y down, z ahead; the place is the middle of the box's floor) and are turned into
the LiDAR's (x ahead, y left, z up) by the calibration, as the development kit has it: Geiger, Lenz and Urtasun, "Are we
ready for autonomous driving? The KITTI vision benchmark suite", CVPR 2012.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np

from ..clouds.files import read_points
from ..errors import InputError, MissingFileError, printable
from ..traffic.fleet import kind_of
from ..traffic.source import open_bytes
from ..traffic.table import read_table
from ..traffic.vehicles import VAN_LONGER_THAN_M
from ..world.triangles import shape_names

KITTI_PARTS = {"velodyne": ".bin", "label_2": ".txt", "calib": ".txt"}
KITTI_MARGIN_M = (0.15, 0.06, 0.01)
"""By how much KITTI's labels are longer, wider and higher than the cars in them [m], fitted to 59 of its cars."""
_NO_BOX = "DontCare"  # a region of the picture, without a place in space
_FIELDS = 15  # of a KITTI label: type, truncation, occlusion, alpha, picture box (4), size (3), place (3), turn
_LARGEST = 1e4  # of any number of a label or a calibration
# KITTI's labels and the class whose shape stands for each. What has no shape of its own only hides others and is a
# plain box; people fill about half of theirs.
_CLASS_OF = {"Car": "car", "Van": "van", "Truck": "truck", "Tram": "bus", "Bus": "bus"}
_CLASS_OF |= {"Cyclist": "motorcycle", "Motorcycle": "motorcycle"}
_PEOPLE = ("Pedestrian", "Person_sitting", "Person")
_SHARE_OF_PEOPLE = np.array([0.6, 0.6, 1.0])


@dataclass(frozen=True, slots=True, eq=False)
class LabelledBoxes:
    """The bounding boxes of one recorded cloud.

    Attributes
    ----------
    number : ndarray of int64, (n,)
        Identifies each in its frame: its vehicle_id in a table, its line in a KITTI label file counted from 0.
    label : ndarray of str, (n,)
        What each is, in the words of the file: ``"Car"``, ``"truck"``.
    shape : ndarray of str, (n,)
        The shape of `world.shapes` that stands for each; empty for what only hides others, a plain box.
    centre_m, size_m : ndarray, (n, 3)
        Box centres; length, width and height [m, frame of the cloud].
    heading_rad : ndarray, (n,)
        Counter-clockwise from +x [rad].
    cut_off : ndarray of bool, (n,)
        Whether the label reaches out of the camera's picture, so that its box is a guess.
    """

    number: np.ndarray
    label: np.ndarray
    shape: np.ndarray
    centre_m: np.ndarray
    size_m: np.ndarray
    heading_rad: np.ndarray
    cut_off: np.ndarray

    def __len__(self) -> int:
        return len(self.label)

    def of_class(self, classes: Sequence[str] | None) -> np.ndarray:
        """Which boxes bear one of the labels, capitals or not, or have a shape where none is given; (n,) bool."""
        if classes is None:
            return self.shape != ""
        return np.isin(np.char.lower(self.label.astype(str)), [name.lower() for name in classes])

    def select(self, which: np.ndarray) -> LabelledBoxes:
        """The boxes that `which`, a (n,) mask or an index array, picks."""
        return LabelledBoxes(*(getattr(self, field.name)[which] for field in fields(self)))


@dataclass(frozen=True, slots=True, eq=False)
class RecordedFrame:
    """One revolution of a real LiDAR and the boxes of what is in it.

    Attributes
    ----------
    name : str
        Of the frame: of its file in KITTI's layout, its number in a table.
    where : str
        For messages: the file or the folder and the name.
    points : ndarray, (n, 3)
        Returns in the frame of the boxes, z up, in the order of the file [m].
    boxes : LabelledBoxes
    """

    name: str
    where: str
    points: np.ndarray
    boxes: LabelledBoxes


# --- Clouds beside a table --------------------------------------------------------------------------------------------


def tabled_frames(clouds: Sequence[str], table: str, frames: Sequence[int] | None) -> Iterator[RecordedFrame]:
    """Clouds, each with the boxes of one frame of a table in the columns of vehicles.csv and the frame of the clouds.

    Parameters
    ----------
    clouds : sequence of path
        As `read_points` takes them.
    table : path
    frames : sequence of int, optional
        For each cloud its frame in the table; not needed for one cloud where the table has one frame.

    Raises
    ------
    InputError, MissingFileError
        Naming the file, and the line where there is one.
    """
    recording = read_table(table)
    known = recording.frames
    if frames is None:
        if len(clouds) > 1 or len(known) > 1:
            raise InputError(
                f"--boxes: {table}: holds {len(known)} frames, {known[0]} to {known[-1]}, for {len(clouds)} "
                "clouds; give --frame with a number for each cloud"
            )
        frames = known[:1]
    if len(frames) != len(clouds):
        raise InputError(f"--frame: {len(frames)} numbers; allowed: one for each of the {len(clouds)} clouds")
    for cloud, frame in zip(clouds, frames, strict=True):
        vehicles = recording.vehicles(int(frame))
        boxes = LabelledBoxes(
            number=vehicles.vehicle_id,
            label=vehicles.class_name,
            shape=shape_names(vehicles),
            centre_m=vehicles.centre_m,
            size_m=vehicles.size_m,
            heading_rad=vehicles.heading_rad,
            cut_off=np.zeros(len(vehicles), dtype=bool),
        )
        yield RecordedFrame(str(int(frame)), str(cloud), read_points(cloud)[0], boxes)


# --- KITTI ------------------------------------------------------------------------------------------------------------


def kitti_names(folder: str | Path) -> list[str]:
    """Names of the frames of a folder in KITTI's layout that have all their files, sorted.

    Raises
    ------
    MissingFileError, InputError
        If the folder is not there, has not that layout, or no frame with all its files.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise MissingFileError(f"--kitti: {folder}: there is no such folder")
    stems = [{path.stem for path in (folder / part).glob(f"*{suffix}")} for part, suffix in KITTI_PARTS.items()]
    whole = sorted(set.intersection(*stems))
    if not whole:
        files = " and ".join(f"{part}/NAME{suffix}" for part, suffix in KITTI_PARTS.items())
        raise InputError(f"--kitti: {folder}: no frame with all its files; allowed: {files}")
    return whole


def kitti_frame(folder: str | Path, name: str) -> RecordedFrame:
    """One frame of a folder in KITTI's layout, in the LiDAR's frame; points that are not finite are left out.

    Raises
    ------
    InputError, MissingFileError
        Naming the file, and the line where there is one.
    """
    velodyne, label, calibration = (Path(folder) / part / f"{name}{suffix}" for part, suffix in KITTI_PARTS.items())
    boxes, content = _kitti_boxes(label, _kitti_calibration(calibration)), _content(velodyne)
    if len(content) % 16:
        raise InputError(f"{velodyne}: {len(content)} bytes; allowed: 16 for each point, four numbers of float32")
    with np.errstate(invalid="ignore"):
        points = np.frombuffer(content, dtype="<f4").reshape(-1, 4)[:, :3].astype(float)
    return RecordedFrame(name, f"{folder}: {name}", points[np.isfinite(points).all(axis=1)], boxes)


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
        rows.append(_numbers(where, words[1:_FIELDS]))
        if min(rows[-1][7:10]) <= 0.0:
            raise InputError(f"{where}: a side of the box is {min(rows[-1][7:10]):g} m; allowed: more than 0")
        labels.append(printable(words[0], 40))
        lines.append(number)
    table = np.array(rows, dtype=float).reshape(len(rows), _FIELDS - 1)
    size = table[:, [9, 8, 7]]
    in_camera = table[:, 10:13] - size[:, 2:] * [0.0, 0.5, 0.0]
    turn = table[:, 13]  # about the camera's y axis, which points down; 0 looks along its x axis
    rotation, shift = to_camera[:, :3], to_camera[:, 3]
    ahead = np.column_stack([np.cos(turn), np.zeros_like(turn), -np.sin(turn)]) @ rotation  # the inverse, transposed
    label = np.array(labels, dtype=str)
    return LabelledBoxes(
        number=np.array(lines, dtype=np.int64),
        label=label,
        shape=np.array(list(map(_shape_of, labels, size[:, 0].tolist())), dtype=str),
        centre_m=(in_camera - shift) @ rotation,
        size_m=np.where(np.isin(label, _PEOPLE)[:, None], size * _SHARE_OF_PEOPLE, size),
        heading_rad=np.arctan2(ahead[:, 1], ahead[:, 0]),
        cut_off=table[:, 0] > 0.0,
    )


def _shape_of(label: str, length_m: float) -> str:
    """The shape for a KITTI label; a car longer than 4.9 m is a van, as in traffic."""
    name = _CLASS_OF.get(label)
    if name == "car" and length_m > VAN_LONGER_THAN_M:
        name = "van"
    return "" if name is None else kind_of(name, length_m)


def _content(path: Path) -> bytes:
    with open_bytes(path, unpack=False) as stream:
        return stream.read()


def _lines(path: Path) -> list[str]:
    return _content(path).decode("utf-8", errors="replace").splitlines()


def _numbers(where: str, words: Sequence[str]) -> list[float]:
    """Finite numbers of bearable size."""
    try:
        numbers = [float(one) for one in words]
    except ValueError as error:
        raise InputError(f"{where}: {error}") from error
    if not np.abs(numbers).max() <= _LARGEST:  # NaN is not either
        raise InputError(f"{where}: a number is not finite or beyond {_LARGEST:g}")
    return numbers
