"""blender-lidar detect: what a detector finds at a mounting, its recall, precision and AP beside the baseline's."""

from __future__ import annotations

import argparse
import json
import sys
import textwrap
from collections.abc import Iterator, Mapping
from contextlib import closing
from dataclasses import asdict
from pathlib import Path

import numpy as np

from ..clouds.files import read_cloud
from ..clouds.scan import PointCloud
from ..detection.classical import ClassicalDetector, dbscan_class
from ..detection.files import write_detected, write_kitti_labels
from ..detection.judge import (
    DETECTORS,
    JudgedDetector,
    detection_result,
    detector_at,
    hung_off,
    judge_detector,
    judged_from_file,
    judging_frames,
)
from ..detection.pillars import SHIPPED, PillarsDetector, load_weights
from ..detection.scores import CRITERIA
from ..errors import InputError, MissingExtraError, MissingFileError
from ..files import check_folder, check_unused, make_folder, write_text
from ..report.cloud_figures import draw_detections
from ..report.detection import detection_table, detection_text
from ..report.summary import as_sentence, region_text, warnings_text
from ..run.folder import DETECTION
from ..scene.provenance import versions
from ..scene.scenario import pose_at, shipped_scenes
from ..scene.settings import six_coordinates
from ..scene.site import Site, prepare
from ..sensors.beams import beam_lattice
from ..sensors.imperfections import Imperfections
from ..sensors.model import load_model, model_names
from .options import default_folder, mounting_from, new_folder, scenario_from
from .progress import Progress
from .report import table_text

_PICTURE = "detections.png"
_OURS = (DETECTION, _PICTURE, "detections.csv", "detections_baseline.csv", "label_2", "label_2_baseline")


def run(args: argparse.Namespace) -> int:
    """Detect at a mounting of a scene, or in clouds; returns the exit code."""
    check_detector(args.detector)
    if Path(args.scene).is_dir() and args.scene not in shipped_scenes():
        return _run_clouds(args)
    scenario = scenario_from(args)
    mount = mounting_from(args, scenario)
    folder = Path(args.out if args.out is not None else default_folder(scenario, "detection"))
    _check_folder(folder)
    site = prepare(scenario, mount)
    result = judge_at(site, mount, args.detector, folder)
    if args.json:
        print(json.dumps(result, indent=2))
        return 0
    frames = f"{result['frames']} {'held-out' if result['held_out'] else 'searched'} frames"
    where = region_text(asdict(scenario.region))
    print("\n".join([*warnings_text(result), f"Detector   {args.detector}; {frames}, vehicles {where}\n"]))
    print("\n\n".join([told(result), f"Results in {folder}", *map(as_sentence, result["notes"])]))
    return 0


def _check_folder(folder: Path) -> None:
    check_folder(folder, "--out")
    check_unused(folder, "--out", "detect", lambda path: path.name in _OURS)


def check_detector(detector: str) -> None:
    """Refuse early a detector that needs what is not installed, or a file of detections that is not there."""
    if detector == ClassicalDetector.name:
        dbscan_class()
    elif _is_weights(detector) or detector == PillarsDetector.name:
        load_weights(SHIPPED if detector == PillarsDetector.name else detector)
    elif not Path(detector).exists():
        raise MissingFileError(f"--detector: {detector}: there is no such file; allowed: {', '.join(DETECTORS)}, FILE")


def _is_ours(detector: str) -> bool:
    return detector in DETECTORS or _is_weights(detector)


def _is_weights(detector: str) -> bool:
    """Whether it is a file of weights, and so a detector of ours."""
    return Path(detector).suffix.lower() == ".npz"


def told(result: Mapping) -> str:
    """What was found, as a sentence and a table."""
    sentence = textwrap.fill(detection_text(result), 120, break_on_hyphens=False)
    return f"{sentence}\n\n{table_text(detection_table(result))}"


def judge_at(site: Site, mount: Mapping[str, float], detector: str, folder: Path) -> dict:
    """Judge a detector at a mounting and at the baseline, and write boxes, scores and a picture; returns the scores.

    Parameters
    ----------
    site : Site
    mount : mapping of str to float
        The six coordinates [m, degrees].
    detector : str
        Its name, or a file of detections at the mounting, which leaves the baseline out.
    folder : Path
        Where they go; the picture where matplotlib is installed.
    """
    mounts = {"baseline": six_coordinates(dict(site.scenario.baseline)), "given": dict(mount)}
    if mounts["baseline"] == mounts["given"] or not _is_ours(detector):
        del mounts["baseline"]
    judged = _judged(detector, site, mounts)
    result = {
        "scene": Path(site.scenario.source).name,
        "sensor": site.model.name,
        "region": asdict(site.scenario.region),
        "caster": site.observation.caster,
        "deployment": mounts["given"],
        "hangs": hung_off(site, mounts["given"]),
        "criteria": [criterion.name for criterion in CRITERIA],
        **detection_result(site, detector, judged),
        "warnings": site.recording.report.warnings_as_dicts(),
        "notes": [*site.plan.notes, *judged["given"].notes],
        "versions": versions(site.observation.caster),
    }
    _write(folder, site, judged, mounts, result)
    try:
        draw_detections(folder / _PICTURE, site, detector, judged, mounts)
    except MissingExtraError as error:
        print(f"blender-lidar: note: no picture: {error}", file=sys.stderr)
    return result


def _judged(detector: str, site: Site, mounts: Mapping[str, Mapping[str, float]]) -> dict[str, JudgedDetector]:
    """What the detector makes of each mounting; a file of detections is of the mounting that is given."""
    if not _is_ours(detector):
        return {"given": judged_from_file(site, mounts["given"], detector)}
    made = {name: detector_at(site, mount, detector) for name, mount in mounts.items()}
    learnt = sum(len(site.search) for one in made.values() if one.learns)
    with closing(Progress(learnt + len(made) * len(judging_frames(site)[0]), "clouds")) as progress:
        return {name: judge_detector(site, mounts[name], one, progress.advance) for name, one in made.items()}


def _write(folder: Path, site: Site, judged: Mapping[str, JudgedDetector], mounts, result: dict) -> None:
    """The detections of each mounting as CSV and as KITTI's labels, and the scores, in place of earlier ones."""
    make_folder(folder, "--out")
    for name in _OURS:
        for path in (folder / name).glob("[0-9]*.txt"):
            path.unlink()
        if (folder / name).is_file():
            (folder / name).unlink()
    numbers = [frame.vehicles.frame for frame in judging_frames(site)[0]]
    for name, one in judged.items():
        of_frame = dict(zip(numbers, one.boxes, strict=True))
        ending = "" if name == "given" else f"_{name}"
        write_detected(folder / f"detections{ending}.csv", of_frame)
        write_kitti_labels(folder / f"label_2{ending}", of_frame, site.scenario.in_road(mounts[name]))
    write_text(folder / DETECTION, json.dumps(result, indent=2) + "\n")


# --- Clouds of a folder -----------------------------------------------------------------------------------------------

_FEWEST_CLOUDS = 5  # from which a background can be learnt
_OF_CLOUDS = ("scene", "detector", "out", "verb", "run", "left_out")


def _run_clouds(args: argparse.Namespace) -> int:
    """Detect in the NPZ clouds of a folder, as ``scan --frame-ids`` writes them; the background is learnt from them."""
    if not _is_ours(args.detector):
        raise InputError(f"--detector: {args.detector}: clouds are looked at by {' or '.join(DETECTORS)}")
    for name, value in vars(args).items():
        if name not in _OF_CLOUDS and value not in (None, False):
            raise InputError(f"--{name.replace('_', '-')}: is of a scene, and {args.scene} is a folder of clouds")
    paths = sorted(Path(args.scene).glob("*.npz"))
    learns = args.detector == ClassicalDetector.name
    if len(paths) < (_FEWEST_CLOUDS if learns else 1):
        few = f"has {len(paths)} .npz clouds, as scan --frame-ids writes them"
        wanted = f"{_FEWEST_CLOUDS} or more, to learn the empty scene from" if learns else "at least one"
        raise InputError(f"{args.scene}: {few}; allowed: {wanted}")
    folder = Path(args.out) if args.out is not None else new_folder("detections")
    _check_folder(folder)
    headers = [read_cloud(path)[1] for path in paths]
    first, frames = headers[0], [header["frame"] for header in headers]
    for path, header in zip(paths, headers, strict=True):
        if any(header[key] != first[key] for key in ("sensor", "rotation_hz", "pose")):
            raise InputError(f"{path}: is of another sensor or mounting than {paths[0]}; allowed: the same")
        if frames.count(header["frame"]) > 1:
            raise InputError(f"{path}: is of frame {header['frame']}, as another cloud is; allowed: one of each")
    if first["sensor"] not in model_names():
        raise InputError(f"{paths[0]}: its sensor {first['sensor']!r} is of a table of its own; detect at its scene")
    lattice = beam_lattice(load_model(first["sensor"]), first["rotation_hz"])
    pose, losses = first["pose"], first.get("imperfections", {})
    at = np.array([pose["x_m"], pose["y_m"]])
    if learns:
        imperfections = Imperfections(losses.get("range_noise_m", 0.0), losses.get("dropout", 0.0))
        detector = ClassicalDetector(lattice, tuple(at), imperfections)
    else:
        weights = SHIPPED if args.detector == PillarsDetector.name else args.detector
        reach = first["range_m"][1]
        detector = PillarsDetector(first["sensor"], pose_at(pose), at - reach, at + reach, weights)
    with closing(Progress((1 + learns) * len(paths), "clouds")) as progress:

        def clouds() -> Iterator[PointCloud]:
            for path in paths:
                cloud = read_cloud(path)[0]
                if cloud.ring.max(initial=0) >= lattice.rings:
                    raise InputError(f"{path}: has ring {cloud.ring.max()}; the {first['sensor']} has {lattice.rings}")
                yield cloud
                progress.advance(1)

        if learns:
            detector.learn(clouds())
        found = dict(zip(frames, map(detector.detect, clouds()), strict=True))
    make_folder(folder, "--out")
    write_detected(folder / "detections.csv", found)
    write_kitti_labels(folder / "label_2", found, pose)
    print(f"{folder}: {sum(map(len, found.values())):,} boxes in {len(found)} clouds ({detector.name})")
    print("\n".join(map(as_sentence, detector.notes())), end="\n" if detector.notes() else "")
    return 0
