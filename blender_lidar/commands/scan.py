"""blender-lidar scan, build and render: what a mounting sees of frames, as clouds, as .blend files and as pictures."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from contextlib import closing
from pathlib import Path

import numpy as np

from ..clouds.files import SUSTECHPOINTS_PARTS, check_cloud_name, write_cloud, write_sustechpoints
from ..clouds.snapshot import MountedSensor, mounted_sensor
from ..detection.files import read_detected
from ..errors import InputError
from ..files import check_place, check_unused, make_folder
from ..names import CLOUD_SUFFIXES
from ..report.page import RENDER_VIEWS, render_file, write_report
from ..report.summary import warnings_text
from ..run.folder import SCENE, RunFolder
from ..scene.mount_checks import check_mount_is_clear
from ..scene.mounting import Mounting
from ..scene.provenance import check_same_inputs
from ..scene.scenario import load_scenario
from ..scene.site import frame_of, read_recording
from ..toml_table import Setting, checked
from ..traffic import Recording
from ..traffic.boxes import DetectedBoxes
from ..traffic.vehicles import Vehicles
from ..world.needs_blender import blender_room
from .options import mounting_from, parse_frames, scenario_from
from .parsers import SUSTECHPOINTS
from .progress import Progress

_MOST_SAMPLES = 4096


def _numbers(args: argparse.Namespace) -> list[int]:
    """The frames that are asked for."""
    return [args.frame] if args.sequence is None else parse_frames(args.sequence, "--frame-ids")


def _asked(args: argparse.Namespace, numbers: list[int]) -> tuple[MountedSensor, Recording, list[Vehicles]]:
    """The sensor as it is asked to hang, the recording, and its frames, in none of which it stands in traffic."""
    scenario = scenario_from(args)
    mount = mounting_from(args, scenario)
    sensor, recording = mounted_sensor(scenario, mount), read_recording(scenario)
    option = "--frame" if args.sequence is None else "--frame-ids"
    _say_warnings(recording)
    frames = [frame_of(recording, number, option) for number in numbers]
    check_mount_is_clear(scenario, frames, {"--x, --y": mount})
    return sensor, recording, frames


def _say_warnings(recording: Recording) -> None:
    """Print what cannot be true of the traffic and was accepted."""
    for text in warnings_text({"warnings": recording.report.warnings_as_dicts()}):
        print(text, flush=True)


# --- Clouds -----------------------------------------------------------------------------------------------


def run_scan(args: argparse.Namespace) -> int:
    """Write clouds; returns the exit code."""
    one, numbers = args.sequence is None, _numbers(args)
    paths = _paths(args, numbers)
    sensor, _, frames = _asked(args, numbers)
    text = f"({sensor.lattice.model.name}, {sensor.caster})"
    if one:
        cloud = sensor.scan(frames[0])
        write_cloud(paths[0], cloud, sensor.cloud_header(frames[0]))
        of_vehicle = cloud.vehicle_id[cloud.vehicle_id >= 0]
        print(
            f"{paths[0]}: {len(cloud)} points, {len(of_vehicle)} of them on {len(np.unique(of_vehicle))} of "
            f"{len(frames[0])} vehicles {text}"
        )
        return 0
    make_folder(Path(args.out), "--out")
    points = 0
    with closing(Progress(len(frames), "scan")) as progress:
        for path, vehicles in zip(paths, frames, strict=True):
            cloud, header = sensor.scan(vehicles), sensor.cloud_header(vehicles)
            if args.format == SUSTECHPOINTS:
                write_sustechpoints(path, cloud, vehicles, header)
            else:
                write_cloud(path, cloud, header)
            points += len(cloud)
            progress.advance(1)
    print(f"{args.out}: {len(frames)} clouds with {points} points {text}")
    return 0


def _paths(args: argparse.Namespace, numbers: list[int]) -> list[Path]:
    """Where the clouds go: one file, or one in the folder for each frame, or the folder where a format orders it."""
    folder = Path(args.out)
    if args.sequence is None:
        if args.format is not None:
            raise InputError("--format: goes with --frame-ids; the suffix of --out says what one cloud is written as")
        check_place(args.out, "--out")
        return [check_cloud_name(args.out, "--out")]
    if len(set(numbers)) < len(numbers):
        raise InputError("--frame-ids: names a frame twice")
    if folder.exists() and not folder.is_dir():
        raise InputError(f"--out: {folder}: is a file; allowed: a folder for the clouds of --frame-ids")
    check_unused(folder, "--out", "scan", _is_of_a_scan)
    if args.format == SUSTECHPOINTS:
        return [folder] * len(numbers)
    return [folder / f"{number:06d}.{args.format or 'npz'}" for number in numbers]


def _is_of_a_scan(path: Path) -> bool:
    """Whether an earlier scan of many frames may have written that; KITTI's own sweeps have no labels beside."""
    if path.suffix == ".bin" and not path.with_suffix(".label").exists():
        return False
    suffixes = (*CLOUD_SUFFIXES, ".label")
    return path.name in SUSTECHPOINTS_PARTS or (path.stem.isdecimal() and path.suffix in suffixes)


# --- A .blend file ----------------------------------------------------------------------------------------


def run_build(args: argparse.Namespace) -> int:
    """Write a scene as a .blend file; returns the exit code."""
    if Path(args.out).suffix.lower() != ".blend":
        raise InputError(f"--out: {args.out}: allowed: a file name that ends in .blend")
    check_place(args.out, "--out")
    animated, numbers = args.sequence is not None, _numbers(args)
    scene = blender_room("scene", "build")
    sensor, recording, frames = _asked(args, sorted(set(numbers)))
    detections = _detections(args.detections, sensor.mounting)
    moment = sensor.moment(frames[0], with_cloud=not args.no_cloud, detections=detections)
    scene.save_blend(args.out, moment, frames if animated else (), recording.time_step_s)
    points = "no cloud" if moment.points is None else f"{len(moment.points['xyz'])} points"
    moving = f" driving through {len(frames)} frames" if animated else ""
    boxes = sum(len(detections.get(vehicles.frame, ())) for vehicles in frames)
    detected = "" if args.detections is None else f", {boxes} detections"
    text = f"{len(frames[0])} vehicles{moving}, {points}{detected}"
    print(f"{args.out}: {text} ({sensor.lattice.model.name}, {sensor.caster})")
    return 0


def _detections(path: str | Path | None, mounting: Mounting) -> dict[int, DetectedBoxes]:
    """What a file says was found at a mounting, by frame; nothing without a file."""
    return {} if path is None else read_detected(path, mounting.pose)


# --- Pictures ---------------------------------------------------------------------------------------------


def run_render(args: argparse.Namespace) -> int:
    """Render a run's mountings; returns the exit code."""
    run = RunFolder(args.folder)
    deployments = {"baseline": run.result["baseline"]["deployment"], "optimised": run.result["deployment"]}
    blender = blender_room("scene", "render")
    asked = blender.SAMPLES if args.samples is None else args.samples
    samples = checked(asked, Setting(kind=int, low=1, high=_MOST_SAMPLES), "--samples")
    scenario = load_scenario(run.file(SCENE))
    check_same_inputs(scenario, run.result["identity"])
    recording = read_recording(scenario)
    _say_warnings(recording)
    mounts = {name: scenario.mounting(table) for name, table in deployments.items()}
    detections = {name: _detections(path, mounts[name]) for name, path in _detected_files(args.detections).items()}
    number = _fullest_frame(run, args.detections, detections["optimised"]) if args.frame is None else args.frame
    vehicles = frame_of(recording, number, "--frame")
    written = []
    with run.locked(), closing(Progress(len(mounts) * len(RENDER_VIEWS), "render")) as progress:
        for name, mount in mounts.items():
            scene = blender.empty_scene()
            moment = mounted_sensor(scenario, mount).moment(vehicles, detections=detections[name])
            blender.build_scene(scene, moment)
            for view in RENDER_VIEWS:
                written.append(run.file(render_file(name, view)))
                blender.render_picture(written[-1], scene, blender.CAMERAS[view], size=blender.SIZE, samples=samples)
                progress.advance(1)
        written.append(write_report(run))
    print(f"frame {number}: " + ", ".join(map(str, written)))
    return 0


def _detected_files(path: str | None) -> dict[str, Path | None]:
    """Files of the detections at both mountings: where `detect` judged both, the baseline's lie beside the others."""
    if path is None:
        return {"baseline": None, "optimised": None}
    given = Path(path)
    beside = given.with_name(f"{given.stem}_baseline{given.suffix}")
    return {"baseline": beside if beside.exists() else None, "optimised": given}


def _fullest_frame(run: RunFolder, path: str | None, detections: Mapping[int, DetectedBoxes]) -> int:
    """The searched frame with the most counted vehicles, or the fullest of those that a file has detections of."""
    table = run.optimised
    asked = table["split"] == "search" if path is None else np.isin(table["frame"], list(detections))
    frames, counts = np.unique(table["frame"][asked], return_counts=True)
    if len(frames) == 0:
        raise InputError(f"--detections: {path}: has no frame of the run; allowed: any, where --frame says which")
    return int(frames[counts.argmax()])
