"""Point clouds as files: NPZ, which keeps everything, and the formats of viewers, surveyors and data sets."""

from __future__ import annotations

import io
import json
import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from ..errors import InputError, MissingExtraError, OutputError, one_line
from ..files import make_folder, read_npz, reading, write_bytes, write_text
from ..sensors.pose import Pose
from ..traffic.boxes import Boxes
from ..traffic.vehicles import CLASSES
from ..world.meshes import BUILDING, CYCLIST, PERSON, ROAD, STRUCTURE, SURFACE_CLASS, SURFACES, VEGETATION
from ..world.scenery import NO_LABEL
from .points import SEMANTIC_CLASSES, check_cloud_name, extra_of_formats
from .scan import NO_CLASS, PointCloud, class_names

# --- NPZ, which keeps everything -------------------------------------------------------------------------


def write_npz(path: str | Path, cloud: PointCloud, header: dict, more: Mapping[str, np.ndarray] | None = None) -> None:
    """Write every attribute of a cloud, and `header` as JSON, to an NPZ file; angles become degrees.

    `more` are further arrays, by their names. Only a cloud of several LiDARs has the column `lidar`, and only one of
    objects that are labelled, whose names the header holds, the column `label`.
    """
    more = {name: getattr(cloud, name) for name, _ in _columns_by(header)} | dict(more or {})
    columns = {name: getattr(cloud, name) for name in ("xyz", "range_m", "ring", "time_s", "vehicle_id", "intensity")}
    columns |= {f"{name}_deg": np.degrees(getattr(cloud, f"{name}_rad")) for name in ("azimuth", "incidence")}
    packed = io.BytesIO()  # as a ZipFile on a full disk would complain again when it is collected
    columns |= {"class": class_names(cloud.class_index), "surface": _surface_names(cloud.surface)}
    columns |= {"header": json.dumps(header), **more}
    np.savez_compressed(packed, **columns)
    write_bytes(path, packed.getvalue())


_OWN_MATERIAL = "own"  # of an object of the user's


def _surface_names(surface: np.ndarray) -> np.ndarray:
    """What each point lies on, as text: a name of `SURFACES`, or "own" of a material of the user's."""
    return np.array([*SURFACES, _OWN_MATERIAL])[SURFACE_CLASS[surface]]


def read_cloud(path: str | Path) -> tuple[PointCloud, dict]:
    """A cloud in the road frame and its header from an NPZ file that `write_npz` has written.

    Raises
    ------
    MissingFileError, InputError
        If it is none.
    """
    with reading(path, "an NPZ cloud of scan"):
        try:
            held = read_npz(path)
            columns = {name: held[name] for name in (*_OF_POINTS, *_ANGLES)}
            names, header = held["class"].ravel().tolist(), json.loads(str(held["header"]))
            columns["lidar"] = held.get("lidar", np.zeros(len(names), dtype=np.uint8))
            columns["label"] = held.get("label", np.full(len(names), NO_LABEL, dtype=np.int32))
            surfaces = held.get("surface", np.full(len(names), SURFACES[ROAD])).ravel().tolist()
            number_of = {name: number for number, name in enumerate(SURFACES)}
            columns["surface"] = np.array([number_of.get(name, STRUCTURE) for name in surfaces], np.uint16)
            _check_cloud(columns, names, header)
            if TO_SITE in header:
                matrix = np.array(header[TO_SITE], dtype=float).reshape(4, 4).T
                columns["xyz"] = columns["xyz"] @ matrix[:3, :3] + matrix[3, :3]
        except KeyError as error:
            raise InputError(f"{path}: is not an NPZ cloud of scan: has no {error}") from error
        except ValueError as error:
            raise InputError(f"{path}: is not an NPZ cloud of scan: {one_line(str(error))}") from error
    columns |= {f"{name.removesuffix('_deg')}_rad": np.radians(columns.pop(name)) for name in _ANGLES}
    known = dict(zip([*CLASSES, ""], [*range(len(CLASSES)), NO_CLASS], strict=True))
    return PointCloud(**columns, class_index=np.array([known.get(name, NO_CLASS) for name in names], np.int8)), header


_OF_POINTS = ("xyz", "range_m", "ring", "time_s", "vehicle_id", "intensity")
_ANGLES = ("azimuth_deg", "incidence_deg")
LIDARS, TO_SITE = "lidars", "to_site"  # in headers: those of several LiDARs; the matrix from a sensor's own frame
LABELS = "labels"  # in headers: names of labels, by their numbers
_BY_HEADER = {LIDARS: ("lidar", "u1"), LABELS: ("label", "i4")}  # columns of clouds whose header has a key
_OF_HEADER = {"sensor": str, "frame": int, "rotation_hz": (int, float), "pose": dict}


def _columns_by(header: Mapping) -> list[tuple[str, str]]:
    """The columns, with their kinds, that a cloud has because its header says so."""
    return [column for key, column in _BY_HEADER.items() if key in header]


def _check_cloud(columns: dict[str, np.ndarray], names: list, header: dict) -> None:
    """Refuse, with a `ValueError`, columns that are not those of one cloud, and a header that lacks something."""
    count = len(names)
    for name, values in columns.items():
        if values.shape != ((count, 3) if name == "xyz" else (count,)) or values.dtype.kind not in "fiu":
            raise ValueError(f"{name} has shape {values.shape} of {values.dtype}")
        if not np.isfinite(values).all():
            raise ValueError(f"{name} is not finite")
    several = isinstance(header, dict) and isinstance(header.get(LIDARS), list) and header[LIDARS]
    for one in several or [header]:
        for key, kind in _OF_HEADER.items():
            if not isinstance(one, dict) or not isinstance(one.get(key), kind):
                raise ValueError(f"its header has no {key}")
        if not all(isinstance(one["pose"].get(key), (int, float)) for key in ("x_m", "y_m", "height_m", "yaw_deg")):
            raise ValueError("its header's pose lacks coordinates")


# --- PLY and PCD: records of one layout, little endian, behind a header ----------------------------------

_RECORD = np.dtype(
    [
        *((name, "<f4") for name in ("x", "y", "z", "intensity")),
        *[("ring", "<u2"), ("time", "<f8"), ("vehicle_id", "<i4"), ("class", "<i1"), ("surface", "<u1")],
    ]
)
_PLY_TYPES = {"f4": "float", "u1": "uchar", "u2": "ushort", "f8": "double", "i4": "int", "i1": "char"}


def record_of(header: Mapping) -> np.dtype:
    """What a PLY or PCD file with a header has of each point."""
    return np.dtype(_RECORD.descr + [(name, f"<{kind}") for name, kind in _columns_by(header)])


def _records(path: str | Path, cloud: PointCloud, header: Mapping) -> np.ndarray:
    """The points of a cloud, one after another; of several LiDARs each has its number."""
    _check_ids_fit(path, cloud.vehicle_id, 31, f"32 bits of a {Path(path).suffix.lstrip('.').upper()} file")
    record = np.zeros(len(cloud), dtype=record_of(header))
    record["x"], record["y"], record["z"] = cloud.xyz.T
    record["intensity"], record["ring"], record["time"] = cloud.intensity, cloud.ring, cloud.time_s
    record["vehicle_id"], record["class"] = cloud.vehicle_id, cloud.class_index
    record["surface"] = SURFACE_CLASS[cloud.surface]
    for name, _ in _columns_by(header):
        record[name] = getattr(cloud, name)
    return record


def _check_ids_fit(path: str | Path, vehicle_id: np.ndarray, bits: int, where: str) -> None:
    """Refuse to write ids that a file with so many `bits` for a number, its sign apart, would change."""
    wide = vehicle_id[vehicle_id >= 2**bits]
    if len(wide):
        raise OutputError(f"{path}: vehicle_id {wide[0]} does not fit into the {where}; .npz keeps it")


def write_ply(path: str | Path, cloud: PointCloud, header: dict) -> None:
    """Write a binary PLY file, as mesh and cloud viewers open: http://paulbourke.net/dataformats/ply

    In the road frame; class counts into `traffic.vehicles.CLASSES`, -1 is no vehicle; surface into
    `world.meshes.SURFACES`, one more is a material of the user's.

    Raises
    ------
    OutputError
        If the file cannot be written, or a vehicle's id does not fit into its 32 bits.
    """
    record = _records(path, cloud, header)
    lines = [
        "ply",
        "format binary_little_endian 1.0",
        f"comment {json.dumps(header)}",
        f"element vertex {len(cloud)}",
        *(f"property {_PLY_TYPES[record.dtype[name].str[1:]]} {name}" for name in record.dtype.names),
        "end_header",
    ]
    write_bytes(path, ("\n".join(lines) + "\n").encode("ascii") + record.tobytes())


def write_pcd(path: str | Path, cloud: PointCloud, header: dict) -> None:
    """Write a binary PCD 0.7 file: https://pointclouds.org/documentation/tutorials/pcd_file_format

    In the road frame; class counts into `traffic.vehicles.CLASSES`, -1 is no vehicle; surface into
    `world.meshes.SURFACES`, one more is a material of the user's.

    Raises
    ------
    OutputError
        If the file cannot be written, or a vehicle's id does not fit into its 32 bits.
    """
    record = _records(path, cloud, header)
    kinds = [record.dtype[name] for name in record.dtype.names]
    lines = [
        "# .PCD v0.7 - Point Cloud Data file format",
        f"# {json.dumps(header)}",
        "VERSION 0.7",
        f"FIELDS {' '.join(record.dtype.names).replace('time', 'timestamp')}",
        f"SIZE {' '.join(str(kind.itemsize) for kind in kinds)}",
        f"TYPE {' '.join(kind.kind.upper() for kind in kinds)}",
        f"COUNT {' '.join('1' for _ in kinds)}",
        f"WIDTH {len(cloud)}",
        "HEIGHT 1",
        "VIEWPOINT 0 0 0 1 0 0 0",
        f"POINTS {len(cloud)}",
        "DATA binary",
    ]
    write_bytes(path, ("\n".join(lines) + "\n").encode("utf-8") + record.tobytes())


# --- LAS and LAZ files of surveyors, by laspy -------------------------------------------------------------

_RESOLUTION_M = 0.0001
# ASPRS: unclassified, as what has a label of its own; road surface; the first number that users may define. Vegetation
# is "high" there, as trees are.
_CLASSIFICATION_NONE, _CLASSIFICATION_VEHICLE = 1, 64
_CLASSIFICATIONS = {ROAD: 11, BUILDING: 6, VEGETATION: 5}
_USER_RECORD = 1


def write_las(path: str | Path, cloud: PointCloud, header: dict) -> None:
    """Write LAS 1.4, or LAZ by the suffix, in the road frame; ring, vehicle and class as extra dimensions.

    The GPS time is the time since the start of the revolution [s]; the intensity fills 16 bits.

    Raises
    ------
    MissingExtraError
        If laspy is not installed, or for LAZ its compression is not.
    OutputError
        If the file cannot be written, or a vehicle's id does not fit into its 32 bits.
    """
    with extra_of_formats(path):
        import laspy
    _check_ids_fit(path, cloud.vehicle_id, 31, "32 bits of a LAS file")
    las = laspy.create(point_format=6, file_version="1.4")
    las.header.scales = np.full(3, _RESOLUTION_M)
    las.header.generating_software = "blender_lidar"
    las.vlrs.append(
        laspy.VLR("blender_lidar", _USER_RECORD, "JSON header", record_data=json.dumps(header).encode("utf-8"))
    )
    extra = ("ring", "u2"), ("vehicle_id", "i4"), ("class_index", "i1"), *_columns_by(header)
    for name, kind in extra:
        las.add_extra_dim(laspy.ExtraBytesParams(name, kind))
    las.x, las.y, las.z = cloud.xyz.T
    las.intensity = np.round(cloud.intensity * 65535).astype(np.uint16)
    las.gps_time = cloud.time_s
    las.return_number = las.number_of_returns = np.ones(len(cloud), dtype=np.uint8)
    other = _by_surface(cloud, _CLASSIFICATIONS, _CLASSIFICATION_NONE, _CLASSIFICATION_NONE)
    las.classification = np.where(cloud.vehicle_id >= 0, _CLASSIFICATION_VEHICLE, other).astype(np.uint8)
    for name, _ in extra:
        las[name] = getattr(cloud, name)
    packed = io.BytesIO()
    try:
        las.write(packed, do_compress=Path(path).suffix.lower() == ".laz")
    except laspy.errors.LaspyException as error:
        raise MissingExtraError(f'{path}: {error}: pip install "blender_lidar[formats]"') from None
    write_bytes(path, packed.getvalue())


def _by_surface(cloud: PointCloud, known: Mapping[int, int], unknown: int, labelled: int) -> np.ndarray:
    """The number of a format for what each point lies on, (n,): that of its surface class where the format has one.

    Else it is `labelled` for what has a label of its own, and `unknown` for others.
    """
    numbers, surface = np.full(len(SURFACES) + 1, unknown), SURFACE_CLASS[cloud.surface]
    numbers[list(known)] = list(known.values())
    return np.where((cloud.label >= 0) & ~np.isin(surface, list(known)), labelled, numbers[surface])


# --- KITTI's velodyne files, and SemanticKITTI's labels beside them ---------------------------------------

_OTHER, _STRUCTURE = 99, 52
_SEMANTIC_SURFACES = {ROAD: 40, BUILDING: 50, VEGETATION: 70, PERSON: 30, CYCLIST: 31}


def write_kitti(path: str | Path, cloud: PointCloud, header: dict) -> None:
    """Write ``x, y, z, intensity`` as float32 rows, and a ``.label`` file beside them.

    The frame is the levelled sensor's: origin at its optical centre, x where the LiDAR's +y looks, y to its left, z up.
    A label is uint32: the lower half SemanticKITTI's class, the upper half the vehicle's id.

    Raises
    ------
    OutputError
        If a file cannot be written, or a vehicle's id does not fit into its 16 bits.
    """
    _check_ids_fit(path, cloud.vehicle_id, 16, "16 bits of a .label file")
    path, of_vehicle = Path(path), cloud.vehicle_id >= 0
    rows = np.empty((len(cloud), 4), dtype="<f4")
    rows[:, :3], rows[:, 3] = levelled(cloud.xyz, Pose.from_table(header["pose"])), cloud.intensity
    label = np.where(
        of_vehicle,
        SEMANTIC_CLASSES[cloud.class_index],
        _by_surface(cloud, _SEMANTIC_SURFACES, _STRUCTURE, _OTHER),
    )
    label |= np.where(of_vehicle, cloud.vehicle_id, 0) << 16
    write_bytes(path.with_suffix(".label"), label.astype("<u4").tobytes())
    write_bytes(path, rows.tobytes())


def levelled(xyz: np.ndarray, pose: Pose) -> np.ndarray:
    """Points in the frame of a sensor that hangs where `pose` says, turned by its yaw and not tilted.

    Parameters
    ----------
    xyz : ndarray, (n, 3)
        Points [m, road frame].
    pose : Pose

    Returns
    -------
    ndarray, (n, 3)
        x along the LiDAR's +y, y along its -x, z up [m].
    """
    east, north, up = (xyz - pose.position).T
    cos, sin = np.cos(pose.yaw), np.sin(pose.yaw)
    across, ahead = cos * east + sin * north, cos * north - sin * east  # the LiDAR's x and y
    return np.column_stack([ahead, -across, up])


def in_own_frame(cloud: PointCloud, header: Mapping[str, object], *, level: bool) -> tuple[PointCloud, dict]:
    """A cloud in the frame of the sensor whose pose the header holds, tilted as it hangs, for `write_cloud`.

    The header then has ``to_site`` (4, 4), the matrix that takes the file's points, columns of x, y, z [m] and 1, into
    the road frame. With `level` it is that of `levelled`, and the points are left to the format's own writer.
    """
    pose = Pose.from_table(header["pose"])
    turn = levelled(np.eye(3) + pose.position, pose) if level else pose.rotation.T
    to_site = [[*row, place] for row, place in zip(turn.tolist(), pose.position.tolist(), strict=True)]
    header = {**header, TO_SITE: [*to_site, [0.0, 0.0, 0.0, 1.0]]}
    return (cloud if level else replace(cloud, xyz=pose.to_sensor(cloud.xyz))), header


# --- Folders of SUSTechPOINTS, the annotation tool of the paper: https://github.com/naurril/SUSTechPOINTS -

# Names of the tool's own object types, in the order of `traffic.vehicles.CLASSES`.
SUSTECHPOINTS_PARTS = ("lidar", "label")
OBJECT_TYPES = ("Car", "Van", "Truck", "Bus", "Motorcycle", "BicycleRider", "Pedestrian")


def write_sustechpoints(folder: str | Path, cloud: PointCloud, vehicles: Boxes, header: dict) -> None:
    """Write one frame into a scene folder: ``lidar/NNNNNN.pcd`` and ``label/NNNNNN.json``.

    Both are in the levelled sensor's frame: x where the LiDAR's +y looks, y to its left, z up. A label is the list of
    the boxes that return at least one point, with centre, size along, across and up, and Euler angles [rad].

    Raises
    ------
    OutputError
        If a file cannot be written.
    """
    folder = Path(folder)
    for part in SUSTECHPOINTS_PARTS:
        make_folder(folder / part, "--out")
    pose = Pose.from_table(header["pose"])
    seen = np.flatnonzero(np.isin(vehicles.vehicle_id, cloud.vehicle_id))
    centre = levelled(vehicles.centre_m[seen], pose)
    turn = pose.yaw + 0.5 * math.pi  # from the road's x axis to that of the levelled frame
    boxes = [
        {
            "obj_id": str(vehicles.vehicle_id[row]),
            "obj_type": OBJECT_TYPES[vehicles.class_index[row]],
            "psr": {
                "position": _axes(place),
                "rotation": _axes([0.0, 0.0, math.remainder(vehicles.heading_rad[row] - turn, 2.0 * math.pi)]),
                "scale": _axes(vehicles.size_m[row]),
            },
        }
        for row, place in zip(seen.tolist(), centre, strict=True)
    ]
    name = f"{vehicles.frame:06d}"
    write_text(folder / "label" / f"{name}.json", json.dumps(boxes, indent=1) + "\n")
    write_pcd(folder / "lidar" / f"{name}.pcd", replace(cloud, xyz=levelled(cloud.xyz, pose)), header)


def _axes(values):
    return {axis: round(float(value), 6) for axis, value in zip("xyz", values, strict=True)}


# --- All formats ------------------------------------------------------------------------------------------

WRITERS: dict[str, Callable[[str | Path, PointCloud, dict], None]] = {
    ".npz": write_npz,
    ".pcd": write_pcd,
    ".ply": write_ply,
    ".bin": write_kitti,
    ".las": write_las,
    ".laz": write_las,
}


def write_cloud(path: str | Path, cloud: PointCloud, header: dict) -> None:
    """Write a cloud in the format that the suffix of `path` names."""
    WRITERS[check_cloud_name(path, "cloud").suffix.lower()](path, cloud, header)
