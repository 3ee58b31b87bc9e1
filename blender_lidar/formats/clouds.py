"""Point clouds as files: NPZ, which keeps everything, and binary PCD, which every viewer opens."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np

from ..errors import InputError, MissingFileError
from ..scan import PointCloud, class_names
from .atomic import whole_file, write_bytes

# Name, PCD type and size in bytes of each field; RoboSense's XYZIRT and what a labelled cloud adds.
_PCD_FIELDS = (
    ("x", "F", 4),
    ("y", "F", 4),
    ("z", "F", 4),
    ("intensity", "F", 4),
    ("ring", "U", 2),
    ("timestamp", "F", 8),
    ("vehicle_id", "I", 4),
    ("class", "I", 1),
)


def write_npz(path: str | Path, cloud: PointCloud, header: dict) -> None:
    """Write every attribute of a cloud, and `header` as JSON, to an NPZ file; angles become degrees."""
    columns = {
        "xyz": cloud.xyz,
        "range_m": cloud.range_m,
        "ring": cloud.ring,
        "azimuth_deg": np.degrees(cloud.azimuth_rad),
        "time_s": cloud.time_s,
        "vehicle_id": cloud.vehicle_id,
        "class": class_names(cloud.class_index),
        "incidence_deg": np.degrees(cloud.incidence_rad),
        "intensity": cloud.intensity,
        "header": np.array(json.dumps(header)),
    }
    with whole_file(path) as temporary:
        np.savez_compressed(temporary, **columns)


def write_pcd(path: str | Path, cloud: PointCloud, header: dict) -> None:
    """Write a binary PCD 0.7 file in the road frame; class counts into `traffic.vehicles.CLASSES`, -1 is no vehicle."""
    record = np.zeros(len(cloud), dtype=[(name, f"<{kind.lower()}{size}") for name, kind, size in _PCD_FIELDS])
    for axis, name in enumerate("xyz"):
        record[name] = cloud.xyz[:, axis]
    record["intensity"], record["ring"], record["timestamp"] = cloud.intensity, cloud.ring, cloud.time_s
    record["vehicle_id"], record["class"] = cloud.vehicle_id, cloud.class_index
    names, kinds, sizes = zip(*_PCD_FIELDS, strict=True)
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


WRITERS: dict[str, Callable[[str | Path, PointCloud, dict], None]] = {".npz": write_npz, ".pcd": write_pcd}


def check_cloud_name(path: str | Path, option: str) -> Path:
    """`path`, if its suffix names a format that clouds are written in."""
    path = Path(path)
    if path.suffix.lower() not in WRITERS:
        raise InputError(f"{option}: {path}: unknown cloud format {path.suffix!r}; allowed: {', '.join(WRITERS)}")
    return path


def write_cloud(path: str | Path, cloud: PointCloud, header: dict) -> None:
    """Write a cloud in the format that the suffix of `path` names."""
    WRITERS[check_cloud_name(path, "cloud").suffix.lower()](path, cloud, header)


def read_points(path: str | Path) -> tuple[np.ndarray, np.ndarray | None]:
    """Points (n, 3) [m] of an NPZ or PCD file, and the vehicle each belongs to (n,), None where the file does not say.

    NPZ files need the array `xyz`; PCD files, binary or ascii, the fields x, y and z. `vehicle_id` is optional in both.
    """
    path = Path(path)
    if not path.exists():
        raise MissingFileError(f"{path}: there is no such file")
    if path.is_dir():
        raise InputError(f"{path}: is a folder; allowed: a point cloud, {' or '.join(WRITERS)}")
    check_cloud_name(path, "cloud")
    points, vehicle = _read_npz(path) if path.suffix.lower() == ".npz" else _read_pcd(path)
    if points.ndim != 2 or points.shape[1] != 3:
        raise InputError(f"{path}: xyz has shape {points.shape}; allowed: (n, 3)")
    if not np.isfinite(points).all():
        raise InputError(f"{path}: point {int(np.flatnonzero(~np.isfinite(points).all(axis=1))[0])} is not finite")
    if vehicle is not None and vehicle.shape != (len(points),):
        raise InputError(f"{path}: vehicle_id has shape {vehicle.shape}; allowed: ({len(points)},)")
    return points, vehicle


def _read_npz(path):
    try:
        with np.load(path, allow_pickle=False) as content:
            if "xyz" not in content:
                raise InputError(f"{path}: has no array 'xyz'; it has {', '.join(content.files) or 'nothing'}")
            points = np.asarray(content["xyz"], dtype=float)
            vehicle = np.asarray(content["vehicle_id"]).astype(np.int64) if "vehicle_id" in content else None
    except InputError:
        raise
    except Exception as error:  # NumPy and zipfile raise many kinds for a damaged file
        raise InputError(
            f"{path}: is not a readable NPZ file ({str(error).splitlines()[0] if str(error) else type(error).__name__})"
        ) from error
    return points, vehicle


def _read_pcd(path):
    with path.open("rb") as stream:
        settings, kind = {}, None
        while kind is None:
            line = stream.readline(65536)
            words = line.decode("ascii", errors="replace").split()
            if not line or (len(settings) == 0 and words and not words[0].startswith("#") and words[0] != "VERSION"):
                raise InputError(f"{path}: is not a PCD file: no header with a DATA line")
            if words and words[0] == "DATA":
                kind = words[1] if len(words) > 1 else ""
            elif words and not words[0].startswith("#"):
                settings[words[0]] = words[1:]
        body = stream.read()
    try:
        points, fields = int(settings["POINTS"][0]), settings["FIELDS"]
        layout = [
            (name, f"<{letter.lower()}{size}", int(count))
            for name, letter, size, count in zip(
                fields, settings["TYPE"], settings["SIZE"], settings.get("COUNT", ["1"] * len(fields)), strict=True
            )
        ]
        dtype = np.dtype([entry[:2] if entry[2] == 1 else entry for entry in layout])
        if kind == "binary":
            record = np.frombuffer(body, dtype=dtype, count=points)
        elif kind == "ascii":
            table = np.loadtxt(body.decode("ascii").splitlines(), ndmin=2) if points else np.empty((0, len(fields)))
            record = {name: table[:, column] for column, name in enumerate(fields)}
        else:
            raise InputError(f"{path}: DATA {kind} cannot be read; allowed: binary or ascii")
        xyz = np.stack([np.asarray(record[axis], dtype=float) for axis in "xyz"], axis=1)
        vehicle = np.asarray(record["vehicle_id"]).astype(np.int64) if "vehicle_id" in fields else None
    except InputError:
        raise
    except (KeyError, ValueError, IndexError, TypeError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: damaged PCD file ({type(error).__name__}: {error})") from error
    return xyz, vehicle
