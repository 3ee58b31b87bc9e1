"""Scenes of SUSTechPOINTS, the annotation tool of the paper: ``lidar/NAME.pcd`` and ``label/NAME.json``.

https://github.com/naurril/SUSTechPOINTS: a label file is a list of objects, each with ``obj_type`` and ``psr``: place,
scale (along, across, up) and Euler angles of its box in the LiDAR's frame. `scan --format sustechpoints` writes such.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from ..errors import InputError, MissingFileError, printable
from ..formats.clouds import read_points
from ..input_file import read_text
from .labelled import NOT_TOLD, LabelledBoxes, LabelledSweep

FOLDERS = {"lidar": ".pcd", "label": ".json"}
_LARGEST_M = 1e4


def read_sweep(folder: Path, frame: str) -> LabelledSweep:
    """The sweep `frame` of a scene folder.

    Raises
    ------
    InputError, MissingFileError
        Naming the file and the object.
    """
    points, _ = read_points(folder / "lidar" / f"{frame}.pcd")
    return LabelledSweep(frame, points, read_labels(folder / "label" / f"{frame}.json"))


def read_labels(path: Path) -> LabelledBoxes:
    """The boxes of a label file; only their turn about the vertical axis is used."""
    objects = _objects(path)
    boxes = [_box(path, number, one) for number, one in enumerate(objects)]
    table = np.array([numbers for _, numbers in boxes], dtype=float).reshape(len(boxes), 7)
    return LabelledBoxes(
        label_line=np.arange(len(boxes)),
        label=np.array([label for label, _ in boxes], dtype=str),
        centre_m=table[:, :3],
        size_m=table[:, 3:6],
        heading_rad=table[:, 6],
        occlusion=np.full(len(boxes), NOT_TOLD, dtype=np.int8),
        truncation=np.full(len(boxes), np.nan),
    )


def _objects(path: Path) -> list:
    try:
        content = json.loads(read_text(path))
    except FileNotFoundError as error:
        raise MissingFileError(f"{path}: there is no such file") from error
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error})") from error
    except (ValueError, RecursionError) as error:
        reason = "it is nested too deep" if isinstance(error, RecursionError) else error
        raise InputError(f"{path}: is no JSON file ({reason})") from error
    if isinstance(content, dict):  # later versions of the tool wrap the list
        content = content.get("objs")
    if not isinstance(content, list):
        raise InputError(f"{path}: holds no list of objects")
    return content


def _box(path: Path, number: int, one: object) -> tuple[str, list[float]]:
    """Type of an object and its seven numbers: place, size, heading."""
    where = f"{path}: object {number}"
    try:
        label, psr = one["obj_type"], one["psr"]
        numbers = [float(psr[part][axis]) for part in ("position", "scale") for axis in "xyz"]
        numbers.append(float(psr["rotation"]["z"]))
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise InputError(f"{where}: has no obj_type and psr with numbers (position, scale, rotation)") from error
    if not isinstance(label, str):
        raise InputError(f"{where}: obj_type is no text")
    if not np.isfinite(numbers).all() or max(map(abs, numbers)) > _LARGEST_M:
        raise InputError(f"{where}: a number is not finite or beyond {_LARGEST_M:g}")
    if min(numbers[3:6]) <= 0.0:
        raise InputError(f"{where}: a side of the box is {min(numbers[3:6]):g} m; allowed: more than 0")
    return printable(label, 40), numbers
