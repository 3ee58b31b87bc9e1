"""Points of cloud files in any format: NPZ, PCD, PLY, LAS and LAZ, KITTI's and text, organised ones as grids.

PLY is read by plyfile, LAS and LAZ by laspy. Our own clouds, with all their columns, are for `files`.
"""

from __future__ import annotations

import io
import math
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

import numpy as np

from ..errors import BlenderLidarError, InputError, MissingExtraError
from ..files import number, open_file, read_file, reading
from ..names import CLOUD_SUFFIXES

# --- What formats have in common --------------------------------------------------------------------------


@contextmanager
def extra_of_formats(path: str | Path) -> Iterator[None]:
    """Refuse a file whose library cannot be imported, with the extra that brings it."""
    try:
        yield
    except ImportError as error:
        raise MissingExtraError(f'{path}: needs {error.name}: pip install "blender_lidar[formats]"') from None


def _named(names: Sequence[str], column: Callable[[str], np.ndarray]) -> tuple[np.ndarray, np.ndarray | None]:
    """Points of the columns x, y and z, also in capitals or as ``x_m``, and `vehicle_id` if it is among the names."""
    called = {name.lower().removesuffix("_m"): name for name in reversed(names)}
    if missing := [axis for axis in "xyz" if axis not in called]:
        raise ValueError(f"it has no {missing[0]}, but {', '.join(names)}")
    ids = column(called["vehicle_id"]) if "vehicle_id" in called else None
    return np.stack([np.asarray(column(called[axis]), dtype=float) for axis in "xyz"], axis=1), ids


# --- One reader a format: points, and `vehicle_id` if there is one -------------------------------------------


def _read_npz(path: Path, stream: BinaryIO) -> tuple[np.ndarray, np.ndarray | None]:
    """The array `xyz` or `points`, (n, 3) or organised, its further columns left out, and `vehicle_id` if there is one.

    Others may be damaged.
    """
    with np.lib.npyio.NpzFile(stream) as archive:
        name = next((name for name in ("xyz", "xyz_m", "points") if name in archive.files), None)
        if name is None:
            raise InputError(f"{path}: has no array 'xyz' or 'points'; it has {', '.join(archive.files) or 'nothing'}")
        xyz, ids = archive[name], archive["vehicle_id"] if "vehicle_id" in archive.files else None
    if xyz.ndim == 3 and ids is not None and ids.shape == xyz.shape[:2]:
        ids = ids.ravel()
    return xyz.reshape(-1, xyz.shape[-1])[:, :3] if xyz.ndim in (2, 3) and xyz.shape[-1] >= 3 else xyz, ids


def _read_ply(path: Path, stream: BinaryIO) -> tuple[np.ndarray, np.ndarray | None]:
    """The vertices of a PLY file, ascii or binary."""
    with extra_of_formats(path):
        from plyfile import PlyData
    vertices = PlyData.read(io.BytesIO(stream.read()))["vertex"].data
    return _named(vertices.dtype.names, vertices.__getitem__)


def _read_pcd(path: Path, stream: BinaryIO) -> tuple[np.ndarray, np.ndarray | None]:
    """Points and, where there is such a field, `vehicle_id`; ascii, binary or compressed."""
    header: dict[str, list[str]] = {}
    while "DATA" not in header:
        line = stream.readline()
        words = line.decode("ascii", errors="replace").split()
        if not line or (not header and words and words[0] != "VERSION" and not words[0].startswith("#")):
            raise ValueError("it has no header with a DATA line")
        if words and not words[0].startswith("#"):
            header[words[0]] = words[1:]
    encoding = " ".join(header["DATA"])
    if encoding not in ("binary", "ascii", "binary_compressed"):
        raise InputError(f"{path}: DATA {encoding} cannot be read; allowed: ascii, binary or binary_compressed")
    for key in ("FIELDS", "SIZE", "TYPE", "POINTS"):
        if not header.get(key):
            raise ValueError(f"its header has no {key}")
    if not set(header["TYPE"]) <= set("FUI"):
        raise ValueError("a TYPE is none of F, U, I")
    fields = []
    counts = header.get("COUNT", ["1"] * len(header["FIELDS"]))
    columns = zip(header["FIELDS"], header["TYPE"], header["SIZE"], map(int, counts), strict=True)
    for place, (name, kind, size, count) in enumerate(columns):
        name = f"_ {place}" if name == "_" else name  # padding, of which there may be several
        fields.append((name, f"<{kind.lower()}{int(size)}", () if count == 1 else (count,)))
    points, body = int(header["POINTS"][0]), stream.read()
    if encoding == "ascii":
        fields = [(name, "<f8", shape) for name, _, shape in fields]
        rows = [row for row in body.decode("ascii").split("\n") if row.strip()]
        body = np.loadtxt(rows, ndmin=2, comments=None).astype("<f8").tobytes() if rows else b""
    kind = np.dtype(fields)
    needed = points * kind.itemsize
    if encoding == "binary_compressed":
        with extra_of_formats(path):
            import lzf
        packed, size = np.frombuffer(body, "<u4", 2).tolist()
        body = (lzf.decompress(body[8 : 8 + packed], size) or b"") if size == needed > 0 else b""
    if not 0 <= needed <= len(body) or (encoding == "ascii" and needed < len(body)):
        raise ValueError(f"its POINTS are {points}, but its data hold others")
    if encoding == "binary_compressed":  # field after field
        starts = points * np.cumsum([0, *(kind[name].itemsize for name in kind.names)])
        at = dict(zip(kind.names, starts.tolist(), strict=False))
        return _named(kind.names, lambda name: np.frombuffer(body, kind[name], points, at[name]))
    return _named(kind.names, np.frombuffer(body, kind, points).__getitem__)


def _read_las(path: Path, stream: BinaryIO) -> tuple[np.ndarray, np.ndarray | None]:
    """The points of a LAS or LAZ file in float64, and `vehicle_id` where it is an extra dimension."""
    with extra_of_formats(path):
        import laspy
    las = laspy.read(stream)
    return _named(["x", "y", "z", *las.point_format.extra_dimension_names], lambda name: np.asarray(las[name]))


# SemanticKITTI's numbers of our classes, in the order of `traffic.vehicles.CLASSES`: a van is a car there, and a
# bicycle with its rider a bicyclist.
SEMANTIC_CLASSES = np.array([10, 10, 18, 13, 15, 31, 30])
_MOVING = (252, 253, 254, 255, 256, 257, 258, 259)  # what SemanticKITTI calls road users that move


def _read_kitti(path: Path, stream: BinaryIO) -> tuple[np.ndarray, np.ndarray | None]:
    """Points of a velodyne file, in its own frame, and the vehicles that the ``.label`` file beside it tells apart.

    nuScenes' files, called ``.pcd.bin``, have a fifth column.
    """
    body, width = stream.read(), 5 if path.name.lower().endswith(".pcd.bin") else 4
    if len(body) % (4 * width):
        raise ValueError(f"its {len(body)} bytes are no rows of {width} float32")
    points, beside = np.frombuffer(body, "<f4").reshape(-1, width)[:, :3], path.with_suffix(".label")
    if not beside.is_file():
        return points, None
    label = np.frombuffer(read_file(beside), "<u4").astype(np.int64)
    if len(label) != len(points):
        raise ValueError(f"its {len(points)} points have {len(label)} labels in {beside.name}")
    return points, np.where(np.isin(label & 0xFFFF, [*SEMANTIC_CLASSES, *_MOVING]), label >> 16, -1)


def _read_text(path: Path, stream: BinaryIO) -> tuple[np.ndarray, np.ndarray | None]:
    """Rows of x, y, z in float64, or of the columns that a header names; separated by commas, semicolons or blanks."""
    lines = [line for line in stream.read().decode("utf-8-sig").splitlines() if line.strip()] or [""]
    rows = [line for line in lines if not line.startswith(("#", "//"))] or lines
    sign = next((sign for sign in ";\t," if sign in rows[0]), None)
    above, first = ([word.strip(' "') for word in line.lstrip("#/ ").split(sign)] for line in (lines[0], rows[0]))
    if any(math.isnan(number(word)) and word.lower() != "nan" for word in first[:3]):
        names, rows = first, rows[1:] or [(sign or " ").join(["nan"] * len(first))]
    else:
        names = above if set("xyz") <= {word.lower().removesuffix("_m") for word in above} else ["x", "y", "z"]

    def column(name: str) -> np.ndarray:
        return np.loadtxt(rows, delimiter=sign, usecols=names.index(name), ndmin=1, comments=None)

    return _named(names, column)


# --- All formats ------------------------------------------------------------------------------------------

READERS = {
    ".npz": _read_npz,
    ".pcd": _read_pcd,
    ".ply": _read_ply,
    **dict.fromkeys((".las", ".laz"), _read_las),
    ".bin": _read_kitti,
    **dict.fromkeys((".csv", ".xyz"), _read_text),
}
_FARTHEST_M = 1e9  # farther is no place but a mark of no return, and its square may be none either


def check_cloud_name(path: str | Path, option: str, formats: Iterable[str] = CLOUD_SUFFIXES) -> Path:
    """`path`, if its suffix names one of the formats; by default those that clouds are written in."""
    path = Path(path)
    if path.suffix.lower() not in formats:
        raise InputError(f"{option}: {path}: unknown cloud format {path.suffix!r}; allowed: {', '.join(formats)}")
    return path


def read_points(path: str | Path) -> tuple[np.ndarray, np.ndarray | None]:
    """The finite points of a file of one of `READERS`, and the vehicle that each belongs to.

    NPZ files need the array `xyz` or `points`, others x, y and z; `vehicle_id` is optional, KITTI's in a .label file.

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
    with reading(path, f"a point cloud, {', '.join(READERS)}"):
        if path.is_dir():
            raise IsADirectoryError
        suffix = check_cloud_name(path, "cloud", READERS).suffix.lower()
        try:
            with open_file(path) as stream, np.errstate(over="ignore", invalid="ignore"):  # such points are left out
                points, vehicle_id = READERS[suffix](path, stream)
                if points.dtype.kind not in "iufb":
                    raise InputError(f"{path}: xyz is of type {points.dtype}; allowed: numbers")
                points = points.astype(float)
        except (BlenderLidarError, OSError):
            raise
        except Exception as error:  # NumPy and zipfile raise many kinds for a damaged file
            reason = str(error).partition("\n")[0] or type(error).__name__
            raise InputError(f"{path}: is not a readable {suffix[1:].upper()} file ({reason})") from error
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


def read_grid(path: str | Path) -> np.ndarray | None:
    """An organised cloud as (columns, channels, 3) [m], NaN where nothing returned; None for a file that is not one.

    Columns are what there is more of. Of NPZ files the array has three dimensions, of PCD files HEIGHT is more than 1.
    """
    path, shape = Path(path), None
    with reading(path, "a point cloud"), open_file(path) as stream:
        if path.suffix.lower() == ".npz":
            with np.lib.npyio.NpzFile(stream) as archive:
                name = next((name for name in ("xyz", "xyz_m", "points") if name in archive.files), None)
                shape = archive[name].shape if name else None
        elif path.suffix.lower() == ".pcd":
            lines = (stream.readline().decode("ascii", errors="replace").split() for _ in range(20))
            head = {words[0]: words[1] for words in lines if len(words) == 2}
            shape = (int(head.get("HEIGHT", 1)), int(head.get("WIDTH", 1)), 3)
    if shape is None or len(shape) != 3 or min(shape[:2]) < 2:
        return None
    with open_file(path) as stream:
        points = READERS[path.suffix.lower()](path, stream)[0].astype(float).reshape(*shape[:2], 3)
    points[~(np.abs(points) <= _FARTHEST_M).all(axis=-1)] = np.nan
    return points if shape[0] >= shape[1] else np.swapaxes(points, 0, 1)


def check_steps(points: np.ndarray, cell_m: float, where: str) -> None:
    """Refuse points (n, 3) that float32 has rounded to steps of more than a fifth of a cell [m], as UTM's are."""
    for axis, values in zip("xyz", points.T, strict=True):
        usual = np.float32(np.median(np.abs(values))) if len(values) else np.float32(0.0)
        step = float(np.spacing(usual))
        if step > 0.2 * cell_m and (values == values.astype(np.float32)).all():
            text = f"{axis} is about {usual:.0f} in float32, whose steps there are {step:g}, of cells of {cell_m:g} m"
            advice = "subtract an origin, in float64 and from the boxes too, before it becomes float32"
            raise InputError(f"{where}: {text}; allowed: steps of a fifth of a cell: {advice}, or write float64")


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
