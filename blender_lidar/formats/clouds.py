"""Point clouds as files: NPZ, which keeps everything, and the formats of viewers, surveyors and data sets."""

from __future__ import annotations

import io
import json
import warnings
from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np

from ..errors import InputError, MissingFileError
from ..scan import PointCloud, class_names
from .atomic import write_bytes
from .kitti import write_kitti
from .las import write_las
from .npz import read_npz
from .pcd import read_pcd, write_pcd
from .ply import write_ply


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
    packed = io.BytesIO()  # as a ZipFile on a full disk would complain again when it is collected
    np.savez_compressed(packed, **columns)
    write_bytes(path, packed.getvalue())


WRITERS: dict[str, Callable[[str | Path, PointCloud, dict], None]] = {
    ".npz": write_npz,
    ".pcd": write_pcd,
    ".ply": write_ply,
    ".bin": write_kitti,
    ".las": write_las,
    ".laz": write_las,
}
READABLE = (".npz", ".pcd")
_FARTHEST_M = 1e9  # farther is no place but a mark of no return, and its square may be none either


def check_cloud_name(path: str | Path, option: str, formats: Iterable[str] = WRITERS) -> Path:
    """`path`, if its suffix names one of the formats; by default those that clouds are written in."""
    path = Path(path)
    if path.suffix.lower() not in formats:
        raise InputError(f"{option}: {path}: unknown cloud format {path.suffix!r}; allowed: {', '.join(formats)}")
    return path


def write_cloud(path: str | Path, cloud: PointCloud, header: dict) -> None:
    """Write a cloud in the format that the suffix of `path` names."""
    WRITERS[check_cloud_name(path, "cloud").suffix.lower()](path, cloud, header)


def read_points(path: str | Path) -> tuple[np.ndarray, np.ndarray | None]:
    """The finite points of an NPZ or PCD file, and the vehicle that each belongs to.

    NPZ files need the array `xyz`; PCD files, binary or ascii, the fields x, y and z. `vehicle_id` is optional in both.

    Returns
    -------
    points : ndarray, (n, 3)
        In the frame of the file [m].
    vehicle_id : ndarray of int64, (n,), or None
        None where the file does not say.

    Warns
    -----
    UserWarning
        If points were left out because they are not finite; organised clouds have such for beams without a return.

    Raises
    ------
    MissingFileError, InputError
        If there is no such file, or it cannot be used.
    """
    path = Path(path)
    try:
        if path.is_dir():
            raise IsADirectoryError
        check_cloud_name(path, "cloud", READABLE)
        points, vehicle_id = read_npz(path) if path.suffix.lower() == ".npz" else read_pcd(path)
    except FileNotFoundError as error:
        raise MissingFileError(f"{path}: there is no such file") from error
    except IsADirectoryError as error:
        raise InputError(f"{path}: is a folder; allowed: a point cloud, {' or '.join(READABLE)}") from error
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error})") from error
    if points.ndim != 2 or points.shape[1] != 3:
        raise InputError(f"{path}: xyz has shape {points.shape}; allowed: (n, 3)")
    if vehicle_id is not None and vehicle_id.shape != (len(points),):
        raise InputError(f"{path}: vehicle_id has shape {vehicle_id.shape}; allowed: ({len(points)},)")
    finite = (np.abs(points) <= _FARTHEST_M).all(axis=1)
    if not finite.all():
        farther = "" if np.isfinite(points).all(axis=1).sum() == finite.sum() else f", or beyond {_FARTHEST_M:g} m"
        text = f"{path}: {np.count_nonzero(~finite)} of {len(points)} points left out: not finite{farther}"
        warnings.warn(text, stacklevel=2)
    return points[finite], None if vehicle_id is None else _whole_ids(path, vehicle_id[finite])


def _whole_ids(path: Path, vehicle_id: np.ndarray) -> np.ndarray:
    """The ids as int64, if that is what they are."""
    if vehicle_id.dtype.kind not in "iuf":
        raise InputError(f"{path}: vehicle_id is of type {vehicle_id.dtype}; allowed: whole numbers")
    with np.errstate(invalid="ignore"):
        whole = vehicle_id.astype(np.int64)
    changed = whole != vehicle_id
    if changed.any():
        raise InputError(f"{path}: vehicle_id is {vehicle_id[changed][0]}; allowed: whole numbers of at most 63 bits")
    return whole
