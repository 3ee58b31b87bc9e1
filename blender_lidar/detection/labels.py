"""Labelled boxes of recorded clouds: tables in the columns of vehicles.csv, SUSTechPOINTS' JSON, KITTI's label text."""

from __future__ import annotations

import csv
import json
import math
import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from ..clouds.commissioned import Hung
from ..errors import InputError, MissingFileError, printable
from ..sensors.pose import Pose
from ..traffic.table import read_table
from ..traffic.vehicles import Recording
from .files import NO_VEHICLES, from_kitti_camera, kitti_lines, text_of

_AHEAD = Pose(height_m=0.0, yaw=-0.5 * math.pi)  # a LiDAR that looks along x of its cloud, as KITTI's camera does
_COLUMNS = ("x_m", "y_m", "z_m", "length_m", "width_m", "height_m", "heading_deg")
_WHOLE = re.compile("[0-9]{1,18}")


def read_labels(path: str | Path, hung: Hung | None = None) -> Recording:
    """The labelled boxes of frames.

    Parameters
    ----------
    path : path
        A table as `read_table` takes it; or of the tools a file, or a folder of files whose names end with the numbers
        of their frames: ``.json`` of SUSTechPOINTS, ``.txt`` of KITTI, whose camera stands where the LiDAR does and
        looks along x of the cloud. What is no vehicle, as a cone or DontCare, is left out.
    hung : Hung, optional
        How the sensor hangs. Boxes of the tools, which label the cloud itself, are brought to the road frame with it.

    Raises
    ------
    MissingFileError, InputError
        Naming the file, the line or the entry.
    """
    path = Path(path)
    if not path.is_dir() and path.suffix.lower() not in _READERS:
        return read_table(path)
    files = sorted(one for one in path.iterdir() if one.suffix.lower() in _READERS) if path.is_dir() else [path]
    if not files:
        raise MissingFileError(f"{path}: has no labels, .json of SUSTechPOINTS or .txt of KITTI")
    rows, frames = [], []
    for file in files:
        frame, boxes = frame_of(file), list(_READERS[file.suffix.lower()](file))
        if frame in frames:
            raise InputError(f"{file}: frame {frame} has several files; allowed: one of each frame")
        frames.append(frame)
        named = all(map(_WHOLE.fullmatch, (box[0] for box in boxes))) and len({box[0] for box in boxes}) == len(boxes)
        rows += [(frame, int(own) if named else at, *box) for at, (own, *box) in enumerate(boxes)]
    if not rows:
        raise InputError(f"{path}: has no vehicle")
    table = dict(zip(("frame", "vehicle_id", "class", *_COLUMNS), map(np.array, zip(*rows, strict=True)), strict=True))
    if hung is not None:
        _place(table, hung)
    try:
        return read_table(table, source=str(path))
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def labelled_numbers(path: str | Path) -> list[int]:
    """The frames of label files, those without a vehicle as well; of a table none, as it has no rows of these."""
    path = Path(path)
    files = path.iterdir() if path.is_dir() else [path]
    return [frame_of(one) for one in files if one.suffix.lower() in _READERS]


def places_alone(path: str | Path) -> set[tuple[int, int]]:
    """Frame and vehicle_id of a table's boxes of confidence D: of guessed sizes, as `fit_boxes` has them."""
    if Path(path).suffix.lower() != ".csv":
        return set()
    rows = csv.DictReader(text_of(Path(path)).splitlines())
    return {(int(row["frame"]), int(row["vehicle_id"])) for row in rows if row.get("confidence") == "D"}


def frame_of(path: Path) -> int:
    """The number of the frame at the end of a file's name; refused where there is none."""
    number = re.search("[0-9]{1,18}$", path.name.removesuffix(".gz").rpartition(".")[0])
    if number is None:
        raise InputError(f"{path}: its name does not end with the number of a frame, as in 000100{path.suffix}")
    return int(number[0])


def _place(table: dict[str, np.ndarray], hung: Hung) -> None:
    """Bring boxes from the sensor's frame to the road's; they stay upright."""
    turn, centre = np.radians(table["heading_deg"]), np.column_stack([table[name] for name in _COLUMNS[:3]])
    ahead = centre + np.column_stack([np.cos(turn), np.sin(turn), 0.0 * turn])
    centre, ahead = map(hung.placed, (centre, ahead))
    table |= dict(zip(_COLUMNS, centre.T, strict=False))
    table["heading_deg"] = np.degrees(np.arctan2(*(ahead - centre).T[1::-1]))


def _sustechpoints(path: Path) -> Iterator[tuple[str | float, ...]]:
    """Its own id, class and `_COLUMNS` of the boxes of a label file."""
    try:
        content = json.loads(text_of(path))
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: is not JSON: {printable(str(error))}") from error
    if not isinstance(content, list):
        raise InputError(f"{path}: is no list of boxes, as SUSTechPOINTS' labels are")
    for at, one in enumerate(content, 1):
        try:
            own, name, psr = str(one.get("obj_id", "")), str(one["obj_type"]), one["psr"]
            centre, size = ([float(psr[key][axis]) for axis in "xyz"] for key in ("position", "scale"))
            heading = math.degrees(float(psr["rotation"]["z"]))
            if not all(map(math.isfinite, (*centre, *size, heading))):
                raise ValueError
        except (AttributeError, LookupError, TypeError, ValueError, OverflowError):
            text = "obj_type and psr with position, rotation and scale by x, y and z"
            raise InputError(f"{path}: entry {at} is no box; needed: {text}") from None
        if name.lower() not in NO_VEHICLES:
            yield own, name, *centre, *size, heading


def _kitti(path: Path) -> Iterator[tuple[str | float, ...]]:
    """The same of a label text; with a score or without."""
    for _, name, (height, width, length, x, y, z, turn, *_) in kitti_lines(path, (15, 16)):
        (centre,), heading = from_kitti_camera(np.array([[x, y, z]]), np.array([height]), np.array([turn]), _AHEAD)
        yield "", name, *centre.tolist(), length, width, height, math.degrees(heading[0])


_READERS = {".json": _sustechpoints, ".txt": _kitti}
