"""PCD 0.7, the files of the Point Cloud Library: https://pointclouds.org/documentation/tutorials/pcd_file_format."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np

from ..errors import InputError
from ..input_file import open_file
from ..scan import PointCloud
from .atomic import write_bytes
from .identifiers import check_ids_fit

# Name, PCD type and size in bytes of each field; RoboSense's XYZIRT and what a labelled cloud adds.
_FIELDS = (
    ("x", "F", 4),
    ("y", "F", 4),
    ("z", "F", 4),
    ("intensity", "F", 4),
    ("ring", "U", 2),
    ("timestamp", "F", 8),
    ("vehicle_id", "I", 4),
    ("class", "I", 1),
)
_NUMPY_KINDS = {"F": "f", "U": "u", "I": "i"}
_PADDING = "_"
_LONGEST_LINE = 2**16
_MOST_HEADER_LINES = 1_000


def write_pcd(path: str | Path, cloud: PointCloud, header: dict) -> None:
    """Write a binary file in the road frame; class counts into `traffic.vehicles.CLASSES`, -1 is no vehicle.

    Raises
    ------
    OutputError
        If the file cannot be written, or a vehicle's id does not fit into its 32 bits.
    """
    check_ids_fit(path, cloud.vehicle_id, 32)
    record = np.zeros(len(cloud), dtype=[(name, f"<{_NUMPY_KINDS[kind]}{size}") for name, kind, size in _FIELDS])
    for axis, name in enumerate("xyz"):
        record[name] = cloud.xyz[:, axis]
    record["intensity"], record["ring"], record["timestamp"] = cloud.intensity, cloud.ring, cloud.time_s
    record["vehicle_id"], record["class"] = cloud.vehicle_id, cloud.class_index
    names, kinds, sizes = zip(*_FIELDS, strict=True)
    lines = [
        "# .PCD v0.7 - Point Cloud Data file format",
        f"# {json.dumps(header)}",
        "VERSION 0.7",
        f"FIELDS {' '.join(names)}",
        f"SIZE {' '.join(map(str, sizes))}",
        f"TYPE {' '.join(kinds)}",
        f"COUNT {' '.join('1' for _ in names)}",
        f"WIDTH {len(cloud)}",
        "HEIGHT 1",
        "VIEWPOINT 0 0 0 1 0 0 0",
        f"POINTS {len(cloud)}",
        "DATA binary",
    ]
    write_bytes(path, ("\n".join(lines) + "\n").encode("utf-8") + record.tobytes())


def read_pcd(path: Path) -> tuple[np.ndarray, np.ndarray | None]:
    """Points (n, 3) and, where there is such a field, `vehicle_id` (n,) as the file has it: binary or ascii.

    Raises
    ------
    InputError
        If the file is damaged, contradicts itself, is compressed or lacks x, y or z.
    OSError
        If it cannot be read.
    """
    with open_file(path) as stream:
        header = _read_header(path, stream)
        body = stream.read()
    try:
        columns = _READERS[header.encoding](header, body)
        with np.errstate(over="ignore", invalid="ignore"):  # such points are left out later
            xyz = np.stack([np.asarray(columns[axis], dtype=float) for axis in "xyz"], axis=1)
    except (ValueError, TypeError, OverflowError) as error:
        raise InputError(f"{path}: damaged PCD file ({error})") from error
    return xyz, columns["vehicle_id"] if "vehicle_id" in header.names else None


@dataclass(frozen=True, slots=True)
class _Header:
    names: list[str]
    formats: list[str]
    counts: list[int]
    points: int
    encoding: str


def _read_header(path: Path, stream: BinaryIO) -> _Header:
    """What the lines up to DATA say; `stream` then stands at the first point."""
    entries: dict[str, list[str]] = {}
    lines = 0
    while "DATA" not in entries:
        line = stream.readline(_LONGEST_LINE) if lines < _MOST_HEADER_LINES else b""
        lines += 1
        words = line.decode("ascii", errors="replace").split()
        if not line or (not entries and words and not words[0].startswith("#") and words[0] != "VERSION"):
            raise InputError(f"{path}: is not a PCD file: no header with a DATA line")
        if words and not words[0].startswith("#"):
            entries[words[0]] = words[1:]
    encoding = " ".join(entries["DATA"])
    if encoding not in _READERS:
        raise InputError(f"{path}: DATA {encoding} cannot be read; allowed: {' or '.join(_READERS)}")
    missing = [key for key in ("FIELDS", "SIZE", "TYPE", "POINTS") if not entries.get(key)]
    if missing:
        raise InputError(f"{path}: damaged PCD file (no {', '.join(missing)} in its header)")
    try:
        return _interpreted(entries, encoding)
    except ValueError as error:
        raise InputError(f"{path}: damaged PCD file ({error})") from error


def _interpreted(entries: dict[str, list[str]], encoding: str) -> _Header:
    fields, kinds, sizes = entries["FIELDS"], entries["TYPE"], entries["SIZE"]
    counts = [int(count) for count in entries.get("COUNT", ["1"] * len(fields))]
    points = int(entries["POINTS"][0])
    if not len(fields) == len(kinds) == len(sizes) == len(counts):
        raise ValueError("FIELDS, SIZE, TYPE and COUNT differ in length")
    if points < 0 or min(counts) < 1:
        raise ValueError("POINTS is less than 0" if points < 0 else "a COUNT is less than 1")
    if not set(kinds) <= set(_NUMPY_KINDS):
        raise ValueError(f"a TYPE is none of {', '.join(_NUMPY_KINDS)}")
    # No field of a file has a space in its name, so padding, of which there may be several, is like no other.
    names = [f"{_PADDING} {at}" if name == _PADDING else name for at, name in enumerate(fields)]
    absent = [axis for axis in "xyz" if axis not in names]
    if absent or len(set(names)) < len(names):
        raise ValueError(f"no field {', '.join(absent)}" if absent else "two fields have the same name")
    formats = [f"<{_NUMPY_KINDS[kind]}{int(size)}" for kind, size in zip(kinds, sizes, strict=True)]
    return _Header(names, formats, counts, points, encoding)


def _read_binary(header: _Header, body: bytes) -> np.ndarray:
    fields = zip(header.names, header.formats, header.counts, strict=True)
    layout = np.dtype([(name, kind) if count == 1 else (name, kind, count) for name, kind, count in fields])
    needed = header.points * layout.itemsize
    if len(body) < needed:
        raise ValueError(f"its points take {needed} bytes, but it has {len(body)}")
    return np.frombuffer(body, dtype=layout, count=header.points)


def _read_ascii(header: _Header, body: bytes) -> dict[str, np.ndarray]:
    rows = [row for row in body.decode("ascii").split("\n") if row.strip()]
    if len(rows) != header.points:
        raise ValueError(f"POINTS is {header.points}, but it has {len(rows)} rows")
    width = sum(header.counts)
    table = np.loadtxt(rows, ndmin=2, comments=None) if rows else np.empty((0, width))
    if table.shape[1] != width:
        raise ValueError(f"its fields take {width} columns, but it has {table.shape[1]}")
    first = np.cumsum([0, *header.counts])
    return {
        name: table[:, start] if count == 1 else table[:, start : start + count]
        for name, start, count in zip(header.names, first, header.counts, strict=False)
    }


_READERS = {"binary": _read_binary, "ascii": _read_ascii}
