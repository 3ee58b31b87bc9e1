"""Detections as files: CSV of our own and KITTI's label text, of any detector, by frame."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from ..clouds.files import levelled
from ..csv_header import laid_out
from ..csv_tables import Column, read_whole
from ..errors import InputError, MissingFileError, printable, unknown_name
from ..files import make_folder, read_text, reading, write_columns, write_text
from ..road.road_map import wrap_angle
from ..sensors.pose import Pose
from ..traffic.boxes import KINDS, Boxes, boxes_of_rows, detected_boxes, join_boxes

_CAR, _LARGE, _SMALL = range(len(KINDS))
_KINDS_OF_NAMES = {
    **dict.fromkeys(("car", "van"), _CAR),
    **dict.fromkeys(("truck or bus", "truck", "bus", "trailer", "construction_vehicle", "tram"), _LARGE),
    **dict.fromkeys(("motorcycle", "cyclist", "bicycle"), _SMALL),
}
"""What detectors and labels call vehicles, in small letters."""
NO_VEHICLES = ("pedestrian", "person_sitting", "traffic_cone", "barrier", "misc", "dontcare", "roadworker", "child")
NO_VEHICLES += ("animal", "trashcan", "roadbarrel", "unknown", "unknown1", "unknown2", "cart", "cone", "trafficcone")
_PLACE, _SIZE = Column("a number of metres, -1e9 to 1e9", -1e9, 1e9), Column("more than 0, up to 1000", 1e-3, 1e3)
_COLUMNS = {
    "frame": Column("a whole number", whole=True),
    **dict.fromkeys(("x_m", "y_m", "z_m"), _PLACE),
    **dict.fromkeys(("length_m", "width_m", "height_m"), _SIZE),
    "heading_deg": Column("a number of degrees", -1e6, 1e6),
    "confidence": Column("0 to 1", 0.0, 1.0),
}
_KITTI_NAMES = ("Car", "Truck", "Cyclist")  # by kind
_OF_KITTI = ("height_m", "width_m", "length_m", "x_m", "y_m", "z_m", "heading_deg", "confidence")  # in KITTI's order
Poses = Pose | Sequence[Pose]
"""The LiDAR's pose in all frames, or one for each number from 0 on."""


def read_detected(path: str | Path, poses: Poses) -> dict[int, Boxes]:
    """The detections of frames in the road frame, by the number of their frame.

    What is no vehicle is left out: pedestrians, cones.

    Parameters
    ----------
    path : path
        A CSV file as `write_detected` writes it; or a folder of KITTI's label texts with scores, named by their frames,
        in the camera frame that `kitti_camera` describes.
    poses : Pose, or sequence of Pose
        What KITTI's boxes are seen from; or one for each number from 0 on, and then there may be no other number.

    Raises
    ------
    MissingFileError, InputError
        Naming the file, the line or the entry, and what is allowed.
    """
    path = Path(path)
    if path.is_dir():
        return _read_kitti(path, poses)
    found = _read_csv(path)
    if not found:
        raise InputError(f"{path}: has no detection of a vehicle")
    for number in found:
        _pose(poses, number, path)
    return found


def _pose(poses: Poses, number: int, where: str | Path) -> Pose:
    if isinstance(poses, Pose):
        return poses
    if not 0 <= number < len(poses):
        raise InputError(f"{where}: has detections of number {number}; allowed: scans 0 to {len(poses) - 1}")
    return poses[number]


def _kind(name: str, where: str) -> int | None:
    """The kind that a name says; None for what is no vehicle."""
    name = name.strip().lower()
    if name in NO_VEHICLES:
        return None
    if name not in _KINDS_OF_NAMES:
        raise unknown_name(name, (*_KINDS_OF_NAMES, *NO_VEHICLES), "class", where)
    return _KINDS_OF_NAMES[name]


# --- CSV --------------------------------------------------------------------------------------------------------------


def write_detected(path: str | Path, of_frame: Mapping[int, Boxes]) -> None:
    """Write detections as CSV: ``frame, class, x_m ... heading_deg, confidence``, by box centres in the road frame."""
    boxes = join_boxes(list(of_frame.values()))
    columns = boxes.table() | {"class": np.array(KINDS)[boxes.kind], "confidence": boxes.confidence}
    columns["frame"] = np.repeat(np.array([*of_frame], dtype=np.int64), [len(one) for one in of_frame.values()])
    del columns["vehicle_id"]
    digits = {name: 3 for name in columns if name.endswith("_m")}
    write_columns(path, columns, {**digits, "heading_deg": 2, "confidence": 6})


def _read_csv(path: Path) -> dict[int, Boxes]:
    rows = read_whole(path, laid_out(path, ("class", *_COLUMNS)), _COLUMNS, ["class"])
    value = rows.columns
    kind = [_kind(name, rows.where(row)) for row, name in enumerate(value["class"].tolist())]
    kind = np.array([-1 if one is None else one for one in kind], dtype=np.int8)
    boxes = detected_boxes(
        np.column_stack([value[name] for name in ("x_m", "y_m", "z_m")]),
        np.column_stack([value[name] for name in ("length_m", "width_m", "height_m")]),
        np.radians(value["heading_deg"]),
        kind,
        value["confidence"],
    )
    return _by_frame(value["frame"].astype(np.int64)[kind >= 0], boxes.select(kind >= 0))


def _by_frame(frame: np.ndarray, boxes: Boxes) -> dict[int, Boxes]:
    return {int(number): boxes.select(frame == number) for number in np.unique(frame)}


# --- KITTI's label text -----------------------------------------------------------------------------------------------


def kitti_camera(boxes: Boxes, pose: Pose) -> tuple[np.ndarray, np.ndarray]:
    """Boxes as KITTI's labels have them: bottom centres (n, 3) [m] and rotation_y (n,) [rad].

    The LiDAR frame is that of the ``.bin`` files of `clouds.files`: levelled, x along the LiDAR's +y, y along its -x, z
    up. The camera stands where the LiDAR does and looks along its x: x right, y down, z ahead.
    """
    ahead, left, up = levelled(boxes.centre_m, pose).T
    bottom = np.column_stack([-left, 0.5 * boxes.size_m[:, 2] - up, ahead])
    return bottom, wrap_angle(pose.yaw - boxes.heading_rad)


def from_kitti_camera(bottom: np.ndarray, height: np.ndarray, rotation_y: np.ndarray, pose: Pose):
    """The inverse of `kitti_camera`: box centres [m] and headings [rad] in the road frame."""
    cos, sin = math.cos(pose.yaw), math.sin(pose.yaw)
    right, down, ahead = bottom.T
    centre = np.column_stack([cos * right - sin * ahead, sin * right + cos * ahead, 0.5 * height - down])
    return pose.position + centre, wrap_angle(pose.yaw - rotation_y)


def write_kitti_labels(folder: str | Path, of_frame: Mapping[int, Boxes], poses: Poses) -> None:
    """Write detections as KITTI's label texts with scores, ``NNNNNN.txt`` by frame, in the frame of `kitti_camera`.

    There is no image: its box is -1, truncation, occlusion and alpha are not known.
    """
    make_folder(Path(folder), "--out")
    for number, boxes in of_frame.items():
        heads = [f"{_KITTI_NAMES[kind]} -1 -1 -10" for kind in boxes.kind]
        scores = [f" {confidence:.6f}" for confidence in boxes.confidence]
        text = kitti_labels(heads, boxes, _pose(poses, number, folder), scores)
        write_text(Path(folder) / f"{number:06d}.txt", text)


def kitti_labels(heads: Sequence[str], boxes: Boxes, pose: Pose, scores: Sequence[str] = ()) -> str:
    """Lines of KITTI's label text: type, truncation, occlusion and alpha, no box in an image, the box, a score."""
    bottom, rotation_y = kitti_camera(boxes, pose)
    return "".join(
        f"{head} -1 -1 -1 -1 {height:.3f} {width:.3f} {length:.3f} {x:.3f} {y:.3f} {z:.3f} {turn:.4f}{score}\n"
        for head, (length, width, height), (x, y, z), turn, score in zip(
            heads, boxes.size_m, bottom, rotation_y, scores or [""] * len(heads), strict=True
        )
    )


def _read_kitti(folder: Path, poses: Poses) -> dict[int, Boxes]:
    paths = sorted(path for path in folder.glob("*.txt") if re.fullmatch("-?[0-9]+", path.stem))
    if not paths:
        raise MissingFileError(f"{folder}: has no KITTI label texts, named like 000100.txt")
    return {int(path.stem): _kitti_boxes(path, _pose(poses, int(path.stem), folder)) for path in paths}


def _kitti_boxes(path: Path, pose: Pose) -> Boxes:
    rows = [
        (x, y, z, length, width, height, turn, kind, score)
        for where, name, (height, width, length, x, y, z, turn, score) in kitti_lines(path, (16,))
        if (kind := _kind(name, where)) is not None
    ]
    boxes = boxes_of_rows(rows)
    centre, heading = from_kitti_camera(boxes.centre_m, boxes.size_m[:, 2], boxes.heading_rad, pose)
    return detected_boxes(centre, boxes.size_m, heading, boxes.kind, boxes.confidence)


def kitti_lines(path: Path, fields: Sequence[int]) -> Iterator[tuple[str, str, list[float]]]:
    """Of each line of a label text where it is, the type, and the numbers of the box, checked; a score where there is.

    `fields` are how many words a line may have.
    """
    for line, text in enumerate(text_of(path).splitlines(), start=1):
        words, where = text.split(), f"{path}:{line}"
        if words and len(words) not in fields:
            last = ", the last is the score" if 16 in fields else ""
            raise InputError(f"{where}: {len(words)} fields; allowed: {' or '.join(map(str, fields))}{last}")
        if words and words[0].lower() not in NO_VEHICLES:
            numbers = [_number(word, where) for word in words[8:]]
            for name, value in zip(_OF_KITTI, numbers, strict=False):
                if not _COLUMNS[name].accepts(np.array([value]))[0]:
                    what, allowed = name.partition("_")[0], _COLUMNS[name].allowed
                    raise InputError(f"{where}: {what} is {value:g}; allowed: {allowed}")
            yield where, words[0], numbers


def text_of(path: Path) -> str:
    with reading(path, "a text file"):
        try:
            return read_text(path)
        except UnicodeDecodeError as error:
            raise InputError(f"{path}: is no text in UTF-8") from error


def _number(word: str, where: str) -> float:
    try:
        return float(word)
    except ValueError:
        raise InputError(f"{where}: {printable(word)!r} is no number") from None
