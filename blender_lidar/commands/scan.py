"""blender-lidar scan: the whole clouds of one frame or of many, ground included."""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..errors import InputError
from ..formats.atomic import check_place, make_folder
from ..formats.clouds import WRITERS, check_cloud_name, write_cloud
from ..formats.sustechpoints import write_sustechpoints
from ..moments import MountedSensor, mounted_sensor
from ..scan import PointCloud
from ..study.keep_clear import check_mount_is_clear
from ..study.site import frame_of, read_recording
from ..traffic.vehicles import Vehicles
from .options import add_moments, mounting_from, parse_frames, scenario_from
from .progress import Progress

_SUSTECHPOINTS = "sustechpoints"
_FORMATS = [*(suffix.removeprefix(".") for suffix in WRITERS), _SUSTECHPOINTS]


def add_parser(subparsers) -> None:
    """Describe the verb to argparse."""
    parser = subparsers.add_parser(
        "scan",
        help="write the point clouds of frames",
        description="Cast one revolution over a frame and write the cloud: .npz with everything, .pcd, .ply, .las, "
        ".laz, or KITTI's .bin with its .label. With --frame-ids a folder of clouds, one for each frame.",
    )
    add_moments(parser, many="many frames")
    parser.add_argument(
        "--out",
        required=True,
        metavar="CLOUD",
        help="the file to write, whose suffix is the format; the folder to write to with --frame-ids",
    )
    parser.add_argument(
        "--format",
        choices=_FORMATS,
        help="format of the files in the folder; npz unless said, sustechpoints adds labels",
    )
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Carry it out; returns the exit code."""
    one = args.sequence is None
    if one and args.format is not None:
        raise InputError("--format: goes with --frame-ids; the suffix of --out says what one cloud is written as")
    numbers, option = ([args.frame], "--frame") if one else (parse_frames(args.sequence, "--frame-ids"), "--frame-ids")
    if one:
        check_place(args.out, "--out")
    paths = [check_cloud_name(args.out, "--out")] if one else _paths(Path(args.out), numbers, args.format or "npz")
    scenario = scenario_from(args)
    mount = mounting_from(args, scenario)
    scanner = _Scanner(mounted_sensor(scenario, mount), args.format == _SUSTECHPOINTS)
    recording = read_recording(scenario)
    frames = [frame_of(recording, number, option) for number in numbers]
    check_mount_is_clear(scenario, frames, {"--x, --y": mount})
    if one:
        cloud = scanner.write(paths[0], frames[0])
        of_vehicle = cloud.vehicle_id[cloud.vehicle_id >= 0]
        print(
            f"{paths[0]}: {len(cloud)} points, {len(of_vehicle)} of them on {len(np.unique(of_vehicle))} of "
            f"{len(frames[0])} vehicles ({scanner.named})"
        )
        return 0
    make_folder(Path(args.out), "--out")
    progress, points = Progress(len(frames), "scan"), 0
    try:
        for path, vehicles in zip(paths, frames, strict=True):
            points += len(scanner.write(path, vehicles))
            progress.advance(1)
    finally:
        progress.close()
    print(f"{args.out}: {len(frames)} clouds with {points} points ({scanner.named})")
    return 0


@dataclass(frozen=True, slots=True)
class _Scanner:
    """Scans frames with a mounted sensor and writes their clouds."""

    sensor: MountedSensor
    labelled_folder: bool

    @property
    def named(self) -> str:
        """The sensor and the caster, for a message."""
        return f"{self.sensor.lattice.model.name}, {self.sensor.caster}"

    def write(self, path: Path, vehicles: Vehicles) -> PointCloud:
        """Scan one frame and write its cloud, which is returned; with `labelled_folder` into SUSTechPOINTS's folder."""
        cloud, header = self.sensor.scan(vehicles), self.sensor.cloud_header(vehicles)
        if self.labelled_folder:
            write_sustechpoints(path, cloud, vehicles, header)
        else:
            write_cloud(path, cloud, header)
        return cloud


def _paths(folder: Path, numbers: list[int], cloud_format: str) -> list[Path]:
    """A file in the folder for each frame, named by its number; the folder itself where a format orders it."""
    if len(set(numbers)) < len(numbers):
        raise InputError("--frame-ids: names a frame twice")
    if folder.exists() and not folder.is_dir():
        raise InputError(f"--out: {folder}: is a file; allowed: a folder for the clouds of --frame-ids")
    if cloud_format == _SUSTECHPOINTS:
        return [folder] * len(numbers)
    return [folder / f"{number:06d}.{cloud_format}" for number in numbers]
