"""blender-lidar build: a scene with its traffic, LiDAR and point cloud as a .blend file."""

from __future__ import annotations

import argparse
from pathlib import Path

from ..errors import InputError
from ..formats.atomic import check_place
from ..moments import mounted_sensor
from ..study.keep_clear import check_mount_is_clear
from ..study.site import frame_of, read_recording
from ..world.needs_blender import blender_room
from .options import add_moments, mounting_from, parse_frames, scenario_from


def add_parser(subparsers) -> None:
    """Describe the verb to argparse."""
    parser = subparsers.add_parser(
        "build",
        help="write a scene as a .blend file",
        description="Build one frame's road, vehicles, LiDAR and point cloud in Blender and write them as a .blend "
        "file. With --frame-ids the vehicles drive through those frames, as an animation; the cloud is the first's.",
    )
    add_moments(parser, many="an animation")
    parser.add_argument("--no-cloud", action="store_true", help="leave the point cloud out")
    parser.add_argument("--out", required=True, metavar="FILE.blend", help="the file to write")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Carry it out; returns the exit code."""
    if Path(args.out).suffix.lower() != ".blend":
        raise InputError(f"--out: {args.out}: allowed: a file name that ends in .blend")
    check_place(args.out, "--out")
    animated = args.sequence is not None
    numbers = sorted(set(parse_frames(args.sequence, "--frame-ids"))) if animated else [args.frame]
    scenario = scenario_from(args)
    mount = mounting_from(args, scenario)
    scene = blender_room("scene", "build")
    sensor = mounted_sensor(scenario, mount)
    recording = read_recording(scenario)
    frames = [frame_of(recording, number, "--frame-ids" if animated else "--frame") for number in numbers]
    check_mount_is_clear(scenario, frames, {"--x, --y": mount})
    moment = sensor.moment(frames[0], with_cloud=not args.no_cloud)
    scene.save_blend(args.out, moment, frames if animated else (), recording.time_step_s)
    points = "no cloud" if moment.cloud is None else f"{len(moment.cloud)} points"
    moving = f" driving through {len(frames)} frames" if animated else ""
    print(f"{args.out}: {len(frames[0])} vehicles{moving}, {points} ({sensor.lattice.model.name}, {sensor.caster})")
    return 0
