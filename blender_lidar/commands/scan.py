"""blender-lidar scan, build and render: what a mounting sees of frames, as clouds, as .blend files and as pictures."""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping, Sequence
from contextlib import ExitStack, closing
from dataclasses import replace
from pathlib import Path

import numpy as np

from ..clouds.files import SUSTECHPOINTS_PARTS, TO_SITE, in_own_frame, write_cloud, write_sustechpoints
from ..clouds.points import check_cloud_name
from ..clouds.scan import PointCloud, joined_clouds
from ..clouds.snapshot import MountedSensor, fused_header, fused_moment, mounted_sensors
from ..detection.files import read_detected
from ..errors import InputError
from ..files import check_place, check_unused, make_folder, write_text
from ..names import CLOUD_SUFFIXES
from ..report.page import RENDER_COMPARISON, RENDER_VIEWS, render_file, write_report
from ..run.folder import SCENE, RunFolder
from ..run.words import sides, warnings_text
from ..scene.lidars import LidarSpec
from ..scene.mount_checks import check_mount_is_clear
from ..scene.mounting import Mounting
from ..scene.provenance import check_same_inputs
from ..scene.scenario import Scenario, load_scenario
from ..scene.site import frame_of, read_recording
from ..traffic import Recording
from ..traffic.boxes import Boxes
from ..world.needs_blender import blender_room
from .options import layout_from, scenario_from
from .progress import Progress
from .verbs import SUSTECHPOINTS


def _numbers(args: argparse.Namespace) -> list[int]:
    """The frames that are asked for, by one option of both."""
    if args.frame is None and args.sequence is None:
        raise InputError("--frame: is missing; allowed: --frame K, or --frame-ids IDS")
    if args.frame is not None and args.sequence is not None:
        raise InputError("--frame: is given beside --frame-ids; allowed: one of both")
    return [args.frame] if args.sequence is None else args.sequence


def _asked(
    args: argparse.Namespace, scenario: Scenario, numbers: list[int]
) -> tuple[tuple[MountedSensor, ...], Recording, list[Boxes]]:
    """The sensors as they are asked to hang, the recording, and its frames, in none of which one stands in traffic."""
    sensors, recording = mounted_sensors(scenario, layout_from(args, scenario)), read_recording(scenario)
    option = "--frame" if args.sequence is None else "--frame-ids"
    _say_warnings(recording)
    frames = [frame_of(recording, number, option) for number in numbers]
    for sensor in sensors:
        check_mount_is_clear(scenario, sensor.spec, frames, {"--x, --y": sensor.mounting}, sensor.stands)
    return sensors, recording, frames


def _say_warnings(recording: Recording) -> None:
    """Print what cannot be true of the traffic and was accepted."""
    for text in warnings_text({"warnings": recording.report.warnings_as_dicts()}):
        print(text, flush=True)


# --- Clouds -----------------------------------------------------------------------------------------------


def run_scan(args: argparse.Namespace) -> int:
    """Write clouds: of several LiDARs the fused one, and beside it each one's in its own frame; returns the code."""
    one, numbers = args.sequence is None, _numbers(args)
    out = Path(args.out)
    paths = [_paths(args, numbers, out)]
    scenario = scenario_from(args)
    named = [*filter(None, scenario.names)]
    beside = [out.with_name(f"{out.stem}_{name}{out.suffix}" if one else f"{out.name}_{name}") for name in named]
    paths += [_paths(args, numbers, own) for own in beside]
    sensors, _, frames = _asked(args, scenario, numbers)
    each = zip(scenario.names, sensors, strict=True)
    of_each = [f"{name} {sensor.lattice.model.name}".lstrip() for name, sensor in each]
    text = f"({', '.join([*of_each, sensors[0].caster])})"
    text += f"; of each LiDAR in its own frame: {', '.join(map(str, beside))}" if named else ""
    for folder in [] if one else [out, *beside]:
        make_folder(folder, "--out")
    points = 0
    with ExitStack() as stack:
        advance = (lambda done: None) if one else stack.enter_context(closing(Progress(len(frames), "scan"))).advance
        for vehicles, places in zip(frames, zip(*paths, strict=True), strict=True):
            clouds = [sensor.scan(vehicles) for sensor in sensors]
            cloud, headers = joined_clouds(clouds), [sensor.cloud_header(vehicles) for sensor in sensors]
            made = [(cloud, fused_header(sensors, vehicles)), *zip(clouds, headers, strict=True)]
            for number, (place, part) in enumerate(zip(places, made, strict=False)):
                level = args.format == SUSTECHPOINTS or place.suffix.lower() == ".bin"
                part = in_own_frame(*part, level=level) if named and (level or number) else part
                _write(place, *part, vehicles, args.format)
            points += len(cloud)
            advance(1)
    if one:
        of_vehicle = cloud.vehicle_id[cloud.vehicle_id >= 0]
        print(
            f"{out}: {points} points, {len(of_vehicle)} of them on {len(np.unique(of_vehicle))} of "
            f"{len(frames[0])} vehicles {text}"
        )
        return 0
    print(f"{args.out}: {len(frames)} clouds with {points} points {text}")
    return 0


def _write(path: Path, cloud: PointCloud, header: dict, vehicles: Boxes, form: str | None) -> None:
    """One cloud; where its format has no room for a matrix of a frame, the header goes into a .json beside it."""
    if form == SUSTECHPOINTS:
        write_sustechpoints(path, cloud, vehicles, header)
        return
    write_cloud(path, cloud, header)
    if TO_SITE in header and path.suffix.lower() == ".bin":
        write_text(path.with_suffix(".json"), json.dumps(header) + "\n")


def _paths(args: argparse.Namespace, numbers: list[int], folder: Path) -> list[Path]:
    """Where clouds go: one file, or one in the folder for each frame, or the folder where a format orders it."""
    if args.sequence is None:
        if args.format is not None:
            raise InputError("--format: goes with --frame-ids; the suffix of --out says what one cloud is written as")
        check_place(folder, "--out")
        return [check_cloud_name(folder, "--out")]
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
    suffixes = (*CLOUD_SUFFIXES, ".label", ".json")
    return path.name in SUSTECHPOINTS_PARTS or (path.stem.isdecimal() and path.suffix in suffixes)


# --- A .blend file ----------------------------------------------------------------------------------------


def run_build(args: argparse.Namespace) -> int:
    """Write a scene as a .blend file; returns the exit code."""
    if Path(args.out).suffix.lower() != ".blend":
        raise InputError(f"--out: {args.out}: allowed: a file name that ends in .blend")
    check_place(args.out, "--out")
    animated, numbers = args.sequence is not None, _numbers(args)
    scene = blender_room("scene", "build")
    scenario = scenario_from(args)
    sensors, recording, frames = _asked(args, scenario, sorted(set(numbers)))
    detections = _detections(args.detections, [sensor.mounting for sensor in sensors])
    moment = fused_moment(scenario, sensors, frames[0], with_cloud=not args.no_cloud, detections=detections)
    moment = replace(moment, since_s=float(recording.since_s[recording.frames.searchsorted(frames[0].frame)]))
    scene.save_blend(args.out, moment, recording.select(np.isin(recording.frame, numbers)) if animated else None)
    clouds = [] if args.no_cloud else [len(one.points["xyz"]) for one in (moment, *moment.further)]
    points = f"{sum(clouds)} points" if clouds else "no cloud"
    moving = f" driving through {len(frames)} frames" if animated else ""
    boxes = sum(len(detections.get(vehicles.frame, ())) for vehicles in frames)
    detected = "" if args.detections is None else f", {boxes} detections"
    text = f"{len(frames[0])} vehicles{moving}, {points}{detected}"
    models = " and ".join(dict.fromkeys(sensor.lattice.model.name for sensor in sensors))
    print(f"{args.out}: {text} ({models}, {sensors[0].caster})")
    return 0


def _detections(path: str | Path | None, layout: Sequence[Mounting]) -> dict[int, Boxes]:
    """What a file says was found in a layout, by frame; nothing without a file."""
    if len(layout) > 1 and path is not None and Path(path).is_dir():
        raise InputError(f"--detections: {path}: KITTI's labels are of one LiDAR; allowed: CSV")
    return {} if path is None else read_detected(path, layout[0].pose)


# --- Pictures ---------------------------------------------------------------------------------------------


def run_render(args: argparse.Namespace) -> int:
    """Render a run's mountings; returns the exit code."""
    run = RunFolder(args.folder)
    base, found = run.result["baseline"], [lidar["deployment"] for lidar in run.result["lidars"]]
    base = list(base.get("deployments", {"": base.get("deployment")}).values())
    deployments = {"baseline": base, "optimised": found}
    blender = blender_room("scene", "render")
    samples = args.samples or blender.SAMPLES
    scenario = load_scenario(run.file(SCENE))
    check_same_inputs(scenario, run.result["identity"])
    recording = read_recording(scenario)
    _say_warnings(recording)
    layouts = {name: list(map(LidarSpec.mounting, scenario.lidars, tables)) for name, tables in deployments.items()}
    detections = {name: _detections(path, layouts[name]) for name, path in _detected_files(args.detections).items()}
    number = _fullest_frame(run, args.detections, detections["optimised"]) if args.frame is None else args.frame
    vehicles = frame_of(recording, number, "--frame")
    views = [view for view in RENDER_VIEWS if args.style in ("both", "points" if view == "points" else "day")]
    written = []
    captions = [f"{name}: {text}" for name, text, _ in sides(run.result)]
    with run.locked(), closing(Progress(len(layouts) * len(views), "render")) as progress:
        for (name, layout), caption in zip(layouts.items(), captions, strict=True):
            scene, sensors = blender.empty_scene(), mounted_sensors(scenario, layout)
            moment = fused_moment(scenario, sensors, vehicles, detections=detections[name])
            blender.build_scene(scene, moment)
            for view in views:
                if view == "points":
                    blender.show_points_alone(scene, caption)
                written.append(run.file(render_file(name, view)))
                blender.render_picture(written[-1], scene, blender.CAMERAS[view], size=blender.SIZE, samples=samples)
                progress.advance(1)
        seen = [view for view in ("above", "points") if view in views]
        written.append(run.file(RENDER_COMPARISON))
        blender.join_pictures(written[-1], [[run.file(render_file(name, view)) for name in layouts] for view in seen])
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


def _fullest_frame(run: RunFolder, path: str | None, detections: Mapping[int, Boxes]) -> int:
    """The searched frame with the most counted vehicles, or the fullest of those that a file has detections of."""
    table = run.optimised
    asked = table["split"] == "search" if path is None else np.isin(table["frame"], list(detections))
    frames, counts = np.unique(table["frame"][asked], return_counts=True)
    if len(frames) == 0:
        raise InputError(f"--detections: {path}: has no frame of the run; allowed: any, where --frame says which")
    return int(frames[counts.argmax()])
