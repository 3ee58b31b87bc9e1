"""KITTI's object benchmark as it is unpacked: ``velodyne/ID.bin``, ``label_2/ID.txt`` and ``calib/ID.txt``.

Labels are in the rectified camera's frame (x right, y down, z ahead; the place is the middle of the box's floor) and
are turned into the LiDAR's (x ahead, y left, z up) by the calibration, as the development kit has it: Geiger, Lenz and
Urtasun, "Are we ready for autonomous driving? The KITTI vision benchmark suite", CVPR 2012.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..errors import InputError, MissingFileError, printable
from ..input_file import read_file
from .labelled import LabelledBoxes, LabelledSweep

FOLDERS = {"velodyne": ".bin", "label_2": ".txt", "calib": ".txt"}
NO_BOX = "DontCare"  # a region of the picture, without a place in space
_FIELDS = 15  # of a label: type, truncation, occlusion, alpha, picture box (4), size (3), place (3), turn
_RECTIFY, _TO_CAMERA = ("R0_rect", 9), ("Tr_velo_to_cam", 12)
_LARGEST_M = 1e4


def read_sweep(folder: Path, frame: str) -> LabelledSweep:
    """The sweep `frame` of a folder in KITTI's layout.

    Raises
    ------
    InputError, MissingFileError
        Naming the file and the line.
    """
    paths = {part: folder / part / f"{frame}{suffix}" for part, suffix in FOLDERS.items()}
    to_camera = read_calibration(paths["calib"])
    return LabelledSweep(frame, read_velodyne(paths["velodyne"]), read_labels(paths["label_2"], to_camera))


def read_velodyne(path: Path) -> np.ndarray:
    """The points of a ``velodyne`` file, (n, 3) [m], without those that are not finite."""
    content = _bytes_of(path)
    if len(content) % 16:
        raise InputError(f"{path}: {len(content)} bytes; allowed: 16 for each point (x, y, z, reflectance as float32)")
    with np.errstate(invalid="ignore"):
        points = np.frombuffer(content, dtype="<f4").reshape(-1, 4)[:, :3].astype(float)
    finite = np.isfinite(points)
    return points if finite.all() else points[finite.all(axis=1)]


def read_calibration(path: Path) -> np.ndarray:
    """From the LiDAR's frame into the rectified camera's: a rigid motion as a matrix, (4, 4)."""
    entries = {}
    for line in _lines_of(path):
        name, _, numbers = line.partition(":")
        entries[name.strip()] = numbers.split()
    rectify, to_camera = np.eye(4), np.eye(4)
    rectify[:3, :3] = _matrix(path, entries, *_RECTIFY).reshape(3, 3)
    to_camera[:3] = _matrix(path, entries, *_TO_CAMERA).reshape(3, 4)
    motion = rectify @ to_camera
    if not np.abs(motion[:3, :3] @ motion[:3, :3].T - np.eye(3)).max() <= 1e-3:  # NaN is no rotation either
        raise InputError(f"{path}: {_RECTIFY[0]} times {_TO_CAMERA[0]} is no rotation")
    return motion


def read_labels(path: Path, to_camera: np.ndarray) -> LabelledBoxes:
    """The boxes of a ``label_2`` file in the LiDAR's frame; `to_camera` (4, 4) as `read_calibration` gives it."""
    rows, labels, lines = [], [], []
    for number, line in enumerate(_lines_of(path)):
        words = line.split()
        if not words or words[0] == NO_BOX:
            continue
        rows.append(_numbers(path, number + 1, words))
        labels.append(printable(words[0], 40))
        lines.append(number)
    table = np.array(rows, dtype=float).reshape(len(rows), _FIELDS - 1)
    height, width, length = table[:, 7:10].T
    in_camera = table[:, 10:13] - np.column_stack([np.zeros_like(height), 0.5 * height, np.zeros_like(height)])
    turn = table[:, 13]  # about the camera's y axis, which points down; 0 looks along its x axis
    ahead_in_camera = np.column_stack([np.cos(turn), np.zeros_like(turn), -np.sin(turn)])
    rotation, shift = to_camera[:3, :3], to_camera[:3, 3]
    ahead = ahead_in_camera @ rotation  # rows times the transpose of the inverse
    return LabelledBoxes(
        label_line=np.array(lines, dtype=np.int64),
        label=np.array(labels, dtype=str),
        centre_m=(in_camera - shift) @ rotation,
        size_m=np.column_stack([length, width, height]),
        heading_rad=np.arctan2(ahead[:, 1], ahead[:, 0]),
        occlusion=table[:, 1].astype(np.int8),
        truncation=table[:, 0],
    )


def _numbers(path: Path, line: int, words: list[str]) -> list[float]:
    """The numbers of a label's line, behind its type."""
    if len(words) not in (_FIELDS, _FIELDS + 1):  # detections carry a score at the end
        raise InputError(f"{path}:{line}: {len(words)} fields; allowed: {_FIELDS}, as KITTI's labels have")
    try:
        numbers = [float(word) for word in words[1:_FIELDS]]
    except ValueError as error:
        raise InputError(f"{path}:{line}: {error}") from error
    if not np.isfinite(numbers).all() or max(map(abs, numbers[10:13])) > _LARGEST_M:
        raise InputError(f"{path}:{line}: a number is not finite or a place is beyond {_LARGEST_M:g} m")
    if max(map(abs, (*numbers[7:10], numbers[13]))) > _LARGEST_M:
        raise InputError(f"{path}:{line}: a side of the box or its turn is beyond {_LARGEST_M:g}")
    if min(numbers[7:10]) <= 0.0:
        raise InputError(f"{path}:{line}: a side of the box is {min(numbers[7:10]):g} m; allowed: more than 0")
    if numbers[1] not in (-1, 0, 1, 2, 3):
        raise InputError(f"{path}:{line}: occlusion is {numbers[1]:g}; allowed: -1, 0, 1, 2 or 3")
    return numbers


def _matrix(path: Path, entries: dict[str, list[str]], name: str, count: int) -> np.ndarray:
    words = entries.get(name)
    if words is None or len(words) != count:
        raise InputError(f"{path}: {name} has {len(words or [])} numbers; allowed: {count}")
    try:
        numbers = np.array([float(word) for word in words])
    except ValueError as error:
        raise InputError(f"{path}: {name}: {error}") from error
    if not np.isfinite(numbers).all():
        raise InputError(f"{path}: {name} holds a number that is not finite")
    if np.abs(numbers).max() > _LARGEST_M:
        raise InputError(f"{path}: {name} holds a number beyond {_LARGEST_M:g}")
    return numbers


def _lines_of(path: Path) -> list[str]:
    return _bytes_of(path).decode("utf-8", errors="replace").splitlines()


def _bytes_of(path: Path) -> bytes:
    try:
        return read_file(path)
    except FileNotFoundError as error:
        raise MissingFileError(f"{path}: there is no such file") from error
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error})") from error
