"""Data sets as files: NPZ, KITTI's layout and nuScenes' tables; written in parallel, resumed.

Each scan has its files, which are whole or not there, that of its boxes last, and a row in the lists and tables that
are written at the end.
"""

from __future__ import annotations

import json
import math
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from ..clouds.files import levelled, write_npz
from ..clouds.snapshot import MountedSensor
from ..csv_header import laid_out
from ..csv_tables import Column, read_whole
from ..errors import InputError
from ..files import (
    check_folder,
    check_unused,
    folder_lock,
    make_folder,
    read_text,
    reading,
    sweep,
    write_bytes,
    write_columns,
    write_text,
)
from ..names import DATASET_LAYOUTS
from ..scene.mounting import MOUNTED
from ..scene.provenance import check_identity
from ..traffic.table import BOX_COLUMNS
from ..traffic.vehicles import CLASSES
from .dataset import TRAIN, VAL, DatasetPlan, Sample, sample
from .files import kitti_camera, kitti_labels
from .judge import of_each

DATASET, UNFINISHED, SCANS, BOXES = "dataset.json", "unfinished.json", "scans.csv", "boxes"
_OURS = (DATASET, UNFINISHED, SCANS, BOXES, *DATASET_LAYOUTS)
_DECIMALS = {
    **dict.fromkeys(("x_m", "y_m", "z_m", "length_m", "width_m", "height_m", "heading_deg"), 6),
    "distance_m": 3,
    "visibility": 4,
}


def file_name(number: int) -> str:
    """What the files of a scan are called, except for their suffix."""
    return f"{number:06d}"


def read_json(path: Path, what: str) -> dict:
    """The content of a JSON file of a data set; refused where it is damaged."""
    with reading(path, what):
        try:
            content = json.loads(read_text(path))
        except (ValueError, RecursionError) as error:
            raise InputError(f"{path}: is damaged; make the data set again, in another folder") from error
    if not isinstance(content, dict):
        raise InputError(f"{path}: is damaged: it holds no table; make the data set again, in another folder")
    return content


WHOLE = Column("a whole number of at least 0", low=0, whole=True)
_FLAG = Column("0 or 1", 0, 1, whole=True)
_OF_BOXES = {
    **{name: column for name, column in BOX_COLUMNS.items() if name not in ("time_s", "lane")},
    **dict.fromkeys(("vehicle_id", "points"), WHOLE),
    **dict.fromkeys(("labelled", "counted"), _FLAG),
    "visibility": Column("a share, 0 to 1", 0.0, 1.0),
}


def read_columns(path: Path, columns: Mapping[str, Column], text: str) -> dict[str, np.ndarray]:
    """Columns of a table of a data set: numbers, and one of texts."""
    rows = read_whole(path, laid_out(path, (*columns, text)), columns, [text])
    return {**rows.columns, text: np.array(rows.columns[text], dtype=str)}


def read_boxes(folder: Path, number: int) -> dict[str, np.ndarray]:
    """The boxes of a scan, its columns (v,): whole numbers and flags as such."""
    table = read_columns(folder / BOXES / f"{file_name(number)}.csv", _OF_BOXES, "class")
    kinds = {"vehicle_id": np.int64, "points": np.int64, "labelled": bool, "counted": bool}
    return table | {name: table[name].astype(kind) for name, kind in kinds.items()}


# --- The folder -------------------------------------------------------------------------------------------------------


class DatasetFolder:
    """The folder of a data set.

    Parameters
    ----------
    path : path
        Where it is, or will be.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)

    def check(self) -> None:
        """Refuse early a place that cannot be a folder, or that holds what no data set has left.

        Raises
        ------
        OutputError, InputError
            Naming the folder, and what is in the way.
        """
        check_folder(self.path, "--out")
        ours = any((self.path / name).is_file() for name in (DATASET, UNFINISHED))
        check_unused(self.path, "--out", "data set", lambda path: ours and path.name in _OURS)

    def write(
        self,
        plan: DatasetPlan,
        layouts: Sequence[str],
        identity: Mapping[str, object],
        about: Mapping[str, object],
        workers: int = 1,
        progress: Callable[[int, int], Callable[[int], object]] = lambda total, done: lambda steps: None,
    ) -> dict[str, object]:
        """Write what is not there yet; returns the content of dataset.json.

        Parameters
        ----------
        plan : DatasetPlan
        layouts : sequence of str
            Of `names.DATASET_LAYOUTS`.
        identity : mapping
            What must be the same for the folder to be gone on with.
        about : mapping
            What dataset.json says besides.
        workers : int
            Processes.
        progress : callable
            Given the number of scans, and of those that were there, what is recorded of each that is written.

        Raises
        ------
        InputError
            If the folder holds a data set of another plan, naming what differs, or a damaged one.
        """
        identity = json.loads(json.dumps(identity))  # as it is read
        with folder_lock(self.path):
            if (finished := self._read(DATASET, identity)) is not None:
                return finished
            self._read(UNFINISHED, identity)  # refuses that of another plan
            for name in (BOXES, *(part for layout in layouts for part in DATASET_WRITERS[layout][0])):
                make_folder(self.path / name, "--out")
                sweep(self.path / name)
            write_text(self.path / UNFINISHED, json.dumps({"identity": identity}))
            done = {int(path.stem) for path in (self.path / BOXES).glob("[0-9]*.csv")}  # each the last of its scan
            left = [number for number in range(len(plan)) if number not in done]
            of_each(_ScanWriter(self.path, plan, tuple(layouts)), left, workers, progress(len(plan), len(done)))
            return self._finish(plan, layouts, {"identity": identity, **about})

    def _finish(self, plan: DatasetPlan, layouts: Sequence[str], about: Mapping[str, object]) -> dict[str, object]:
        """Write lists, tables and, last, dataset.json."""
        tables = [read_boxes(self.path, number) for number in range(len(plan))]
        write_columns(self.path / SCANS, _scan_columns(plan, tables), {"station_m": 6})
        for layout in layouts:
            if layout == "nuscenes":
                _finish_nuscenes(self.path / layout, plan, tables)
            elif layout != "npz":
                make_folder(self.path / layout / "ImageSets", "--out")
                for split in (TRAIN, VAL):
                    # Loaders of KITTI's layout fail at a scan without a label.
                    listed = (scan for scan, boxes in zip(plan.scans, tables, strict=True) if _has_label(boxes))
                    names = "".join(f"{file_name(scan.number)}\n" for scan in listed if scan.split == split)
                    write_text(self.path / layout / "ImageSets" / f"{split}.txt", names)
        splits = {
            split: [one for scan, one in zip(plan.scans, tables, strict=True) if scan.split == split]
            for split in (TRAIN, VAL)
        }
        result = dict(about)
        for split, of_split in splits.items():
            labelled = {
                key: np.concatenate([np.zeros(0), *(one[key][one["labelled"]] for one in of_split)])
                for key in ("points", "counted", "vehicle_id")
            }
            result[split] = {
                "scans": len(of_split),
                "without_labels": sum(not _has_label(one) for one in of_split),
                "frames": len({scan.frame for scan in plan.scans if scan.split == split}),
                "labelled": len(labelled["points"]),
                "with_return": int((labelled["points"] > 0).sum()),
                "counted": int(labelled["counted"].sum()),
                "different_vehicles": len(np.unique(labelled["vehicle_id"])),
            }
        write_text(self.path / DATASET, json.dumps(result, indent=2) + "\n")
        (self.path / UNFINISHED).unlink(missing_ok=True)
        return result

    def _read(self, name: str, identity: Mapping[str, object]) -> dict | None:
        """The content of a file, None where it is not there; that of another plan is refused."""
        path = self.path / name
        if not path.exists():
            return None
        content = read_json(path, "a file of a data set")
        check_identity(content.get("identity"), identity, f"{self.path}: the data set there", "--out")
        return content


def _scan_columns(plan: DatasetPlan, tables: Sequence[Mapping[str, np.ndarray]]) -> dict[str, np.ndarray]:
    """The columns of scans.csv."""
    scans = plan.scans
    columns = {
        "scan": [scan.number for scan in scans],
        "split": [scan.split for scan in scans],
        "frame": [plan.frames[scan.frame].frame for scan in scans],
        "recording": plan.recordings[[scan.frame for scan in scans]],
        "block": plan.blocks[[scan.frame for scan in scans]],
        "mounting": [scan.mounting for scan in scans],
        **{key: [scan.mount.as_table()[key] for scan in scans] for key in MOUNTED},
        **{f"hangs_{key}": [scan.hangs.as_table()[key] for scan in scans] for key in MOUNTED},
        "station_m": [scan.station_m for scan in scans],
        "mirrored": [scan.mirrored for scan in scans],
        **{key: [int(one[key].sum()) for one in tables] for key in ("labelled", "counted")},
        "vehicle_points": [int(one["points"].sum()) for one in tables],
    }
    return {name: np.array(values) for name, values in columns.items()}


# --- The files of one scan --------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class _ScanWriter:
    """Writes the files of scans, by their numbers."""

    folder: Path
    plan: DatasetPlan
    layouts: tuple[str, ...]

    def __call__(self, number: int) -> int:
        made = sample(self.plan, number)
        for layout in self.layouts:
            DATASET_WRITERS[layout][1](self.folder, made, self.plan)
        write_columns(self.folder / BOXES / f"{file_name(number)}.csv", _box_columns(made), _DECIMALS)
        return number


def _has_label(boxes: Mapping[str, np.ndarray]) -> bool:
    """Whether formats that cannot say how many points a box has label any of these vehicles."""
    return bool((boxes["labelled"] & (boxes["points"] > 0)).any())


def _box_columns(made: Sample) -> dict[str, np.ndarray]:
    """All vehicles of a sample, in the columns of vehicles.csv as far as they go."""
    vehicles = made.vehicles
    away = vehicles.centre_m[:, :2] - made.pose.position[:2]
    return {
        **vehicles.table(),
        "distance_m": np.hypot(*away.T),
        "points": made.points,
        "visibility": made.visibility,
        "labelled": made.labelled,
        "counted": vehicles.counted,
    }


def _write_npz(folder: Path, made: Sample, plan: DatasetPlan) -> None:
    """The cloud as `scan` writes it, and arrays of the vehicles, one row each, whose names begin with ``box_``."""
    vehicles, scan, seen = made.vehicles, made.scan, plan.observation
    lidar = plan.scenario.lidar
    drawn = plan.scenario.with_lidars(replace(lidar, sensor=replace(lidar.sensor, noise_seed=scan.seed)))
    sensor = MountedSensor(drawn, scan.mount, seen.lattice, seen.caster, None)
    about = {key: value for key, value in asdict(scan).items() if key not in ("frame", "mount")}
    about["hangs"] = {key: scan.hangs.as_table()[key] for key in MOUNTED}
    boxes = {
        "vehicle_id": vehicles.vehicle_id,
        "class": vehicles.class_name,
        "centre_m": vehicles.centre_m,
        "size_m": vehicles.size_m,
        "heading_deg": np.degrees(vehicles.heading_rad),
        **{name: getattr(made, name) for name in ("points", "visibility", "labelled")},
        "counted": vehicles.counted,
    }
    more = {f"box_{name}": values for name, values in boxes.items()}
    path = folder / "npz" / f"{file_name(scan.number)}.npz"
    write_npz(path, made.cloud, {**sensor.cloud_header(vehicles), "versions": plan.versions, "scan": about}, more)


# By class: KITTI has no bus, and no motorcycle.
_KITTI_TYPES = ("Car", "Van", "Truck", "Truck", "Cyclist", "Cyclist", "Pedestrian")
_OCCLUDED = (0.5, 0.9)  # visibility from which a vehicle is partly occluded, and from which it is fully visible
# The camera of `kitti_camera`: x right, y down, z ahead; without an image its lens is of focal length 1.
_KITTI_CALIBRATION = (
    "".join(f"P{number}: 1 0 0 0 0 1 0 0 0 0 1 0\n" for number in range(4))
    + "R0_rect: 1 0 0 0 1 0 0 0 1\n"
    + "Tr_velo_to_cam: 0 -1 0 0 0 0 -1 0 1 0 0 0\n"
    + "Tr_imu_to_velo: 1 0 0 0 0 1 0 0 0 0 1 0\n"
)


def _seen_rows(made: Sample) -> np.ndarray:
    """Rows of the labelled vehicles with a return, for formats that cannot say how many points a box has."""
    return np.flatnonzero(made.labelled & (made.points > 0))


def _level_points(made: Sample) -> np.ndarray:
    """The cloud as float32 rows of x, y, z in the levelled frame of `clouds.files` [m], and intensity, 0 to 1."""
    return np.column_stack([levelled(made.cloud.xyz, made.pose), made.cloud.intensity]).astype("<f4")


def _write_kitti(folder: Path, made: Sample, plan: DatasetPlan) -> None:
    """KITTI's velodyne, label_2 and calib, as KITTI's development kit describes them; there is no image."""
    training, name = folder / "kitti" / "training", file_name(made.scan.number)
    rows = _seen_rows(made)
    vehicles = made.vehicles.select(rows)
    bottom, rotation_y = kitti_camera(vehicles, made.pose)
    alpha = np.remainder(rotation_y - np.arctan2(bottom[:, 0], bottom[:, 2]) + math.pi, 2.0 * math.pi) - math.pi
    occluded = len(_OCCLUDED) - np.searchsorted(_OCCLUDED, made.visibility[rows], side="right")
    heads = [
        f"{_KITTI_TYPES[kind]} 0.00 {hidden} {angle:.4f}"
        for kind, hidden, angle in zip(vehicles.class_index, occluded, alpha, strict=True)
    ]
    write_bytes(training / "velodyne" / f"{name}.bin", _level_points(made).tobytes())
    write_text(training / "label_2" / f"{name}.txt", kitti_labels(heads, vehicles, made.pose))
    write_text(training / "calib" / f"{name}.txt", _KITTI_CALIBRATION)


# --- nuScenes: https://www.nuscenes.org/nuscenes, docs/schema_nuscenes.md of its devkit ------------------------------

_VERSION, _SWEEPS = "v1.0-trainval", "samples/LIDAR_TOP"
_VEHICLES = ("car", "car", "truck", "bus.rigid", "motorcycle", "bicycle")
_CATEGORIES = dict(zip(CLASSES, [*map("vehicle.{}".format, _VEHICLES), "human.pedestrian.adult"], strict=True))
_VISIBLE = {"1": (0.0, 0.4), "2": (0.4, 0.6), "3": (0.6, 0.8), "4": (0.8, 1.0)}
_MAP = "maps/none.png"


def _write_nuscenes(folder: Path, made: Sample, plan: DatasetPlan) -> None:
    """A sweep, float32 rows of x, y, z [m], intensity, 0 to 255, and ring: x to the right, y ahead, z up, levelled."""
    ahead, left, up = levelled(made.cloud.xyz, made.pose).T
    points = np.column_stack([-left, ahead, up, 255.0 * made.cloud.intensity, made.cloud.ring]).astype("<f4")
    write_bytes(folder / "nuscenes" / _SWEEPS / f"{file_name(made.scan.number)}.pcd.bin", points.tobytes())


def _finish_nuscenes(folder: Path, plan: DatasetPlan, of_scans: Sequence[Mapping[str, np.ndarray]]) -> None:
    """The tables: each scan is a scene with one sample, the ego vehicle the foot of the pole, turned by its yaw.

    The global frame is the road frame of each scan.
    """
    tables = {name: list(records) for name, records in _fixed_tables().items()}
    names = ("calibrated_sensor", "ego_pose", "scene", "sample", "sample_data", "sample_annotation", "instance")
    tables |= {name: [] for name in names}
    for scan, boxes in zip(plan.scans, of_scans, strict=True):
        token, pose = f"scan-{file_name(scan.number)}", scan.mount.pose
        microseconds = round(plan.frames[scan.frame].time_s * 1e6)
        ahead = pose.yaw + 0.5 * math.pi
        annotations = list(_annotations(token, boxes))
        records = {
            "scene": {"name": token, "description": scan.split, "log_token": "log", "nbr_samples": 1}
            | {"first_sample_token": token, "last_sample_token": token},
            "sample": {"timestamp": microseconds, "scene_token": token, "prev": "", "next": ""},
            "ego_pose": {"timestamp": microseconds, "rotation": _about_z(ahead)}
            | {"translation": [pose.x_m, pose.y_m, 0.0]},
            "calibrated_sensor": {"sensor_token": "LIDAR_TOP", "translation": [0.0, 0.0, pose.height_m]}
            | {"rotation": _about_z(-0.5 * math.pi), "camera_intrinsic": []},
            "sample_data": {"sample_token": token, "ego_pose_token": token, "calibrated_sensor_token": token}
            | {"filename": f"{_SWEEPS}/{file_name(scan.number)}.pcd.bin", "fileformat": "pcd", "width": 0, "height": 0}
            | {"timestamp": microseconds, "is_key_frame": True, "prev": "", "next": ""},
        }
        for name, record in records.items():
            tables[name].append({"token": token, **record})
        tables["sample_annotation"] += [annotation for annotation, _ in annotations]
        tables["instance"] += [instance for _, instance in annotations]
    for name, records in tables.items():
        lines = ",\n".join(map(json.dumps, records))
        write_text(folder / _VERSION / f"{name}.json", f"[\n{lines}\n]\n")
    scenes = {
        f"site_{split}": [f"scan-{file_name(scan.number)}" for scan in plan.scans if scan.split == split]
        for split in (TRAIN, VAL)
    }
    write_text(folder / _VERSION / "splits.json", json.dumps(scenes, indent=0) + "\n")
    write_bytes(folder / _MAP, _white_png())


def _annotations(token: str, boxes: Mapping[str, np.ndarray]) -> Iterator[tuple[dict, dict]]:
    """The annotation and the instance of each labelled vehicle of a scan."""
    columns = (values[boxes["labelled"]].tolist() for values in boxes.values())
    for values in zip(*columns, strict=True):
        row = dict(zip(boxes, values, strict=True))
        mine, visible = f"{token}-vehicle-{row['vehicle_id']}", row["visibility"]
        level = max(number for number, (low, _) in _VISIBLE.items() if visible >= low)
        yield (
            {
                "token": mine,
                "sample_token": token,
                "instance_token": mine,
                "visibility_token": level,
                "attribute_tokens": [],
                "translation": [row[key] for key in ("x_m", "y_m", "z_m")],
                "size": [row[key] for key in ("width_m", "length_m", "height_m")],
                "rotation": _about_z(math.radians(row["heading_deg"])),
                "prev": "",
                "next": "",
                "num_lidar_pts": row["points"],
                "num_radar_pts": 0,
            },
            {
                "token": mine,
                "category_token": _CATEGORIES[row["class"]],
                "nbr_annotations": 1,
                "first_annotation_token": mine,
                "last_annotation_token": mine,
            },
        )


def _fixed_tables() -> dict[str, list[dict]]:
    """The tables that are the same for all data sets."""
    names = dict.fromkeys(_CATEGORIES.values())
    sensor = {"token": "LIDAR_TOP", "channel": "LIDAR_TOP", "modality": "lidar"}
    place = {"token": "log", "logfile": "", "vehicle": "roadside", "date_captured": "1970-01-01", "location": "site"}
    shares = {level: f"{100 * low:.0f}-{100 * high:.0f}" for level, (low, high) in _VISIBLE.items()}
    return {
        "category": [{"token": name, "name": name, "description": ""} for name in names],
        "attribute": [],
        "visibility": [
            {"token": level, "level": f"v{share}", "description": f"{share} %"} for level, share in shares.items()
        ],
        "sensor": [sensor],
        "log": [place],
        "map": [{"token": "map", "category": "semantic_prior", "filename": _MAP, "log_tokens": ["log"]}],
    }


def _about_z(angle: float) -> list[float]:
    """The quaternion w, x, y, z of a turn about z [rad]."""
    return [math.cos(0.5 * angle), 0.0, 0.0, math.sin(0.5 * angle)]


def _white_png() -> bytes:
    """A picture of one pixel: nuScenes' devkit wants a map."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        return len(data).to_bytes(4, "big") + kind + data + zlib.crc32(kind + data).to_bytes(4, "big")

    size = (1).to_bytes(4, "big")
    header = chunk(b"IHDR", size + size + bytes([8, 0, 0, 0, 0]))
    return b"\x89PNG\r\n\x1a\n" + header + chunk(b"IDAT", zlib.compress(b"\0\xff", 9)) + chunk(b"IEND", b"")


DATASET_WRITERS: dict[str, tuple[tuple[str, ...], Callable[[Path, Sample, DatasetPlan], None]]] = {
    "npz": (("npz",), _write_npz),
    "kitti": (tuple(f"kitti/training/{part}" for part in ("velodyne", "label_2", "calib")), _write_kitti),
    "nuscenes": ((f"nuscenes/{_SWEEPS}", f"nuscenes/{_VERSION}", "nuscenes/maps"), _write_nuscenes),
}
"""The folders of each layout's files, and what writes those of one scan."""
