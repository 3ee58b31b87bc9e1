"""blender-lidar detect: what a detector finds at a mounting, its recall, precision and AP beside the baseline's."""

from __future__ import annotations

import argparse
import json
import textwrap
from collections.abc import Mapping
from contextlib import closing
from dataclasses import asdict
from pathlib import Path

from ..clouds.files import read_cloud
from ..detection.boxes import DetectedBoxes
from ..detection.classical import ClassicalDetector, dbscan_class
from ..detection.files import read_detected, write_detected, write_kitti
from ..detection.judge import (
    JudgedDetector,
    detection_result,
    hung_off,
    judge_detector,
    judged_from_file,
    judging_frames,
)
from ..detection.scores import CRITERIA
from ..errors import InputError, MissingFileError
from ..files import check_place, check_unused, make_folder, write_text
from ..report.detection import detection_table, detection_text
from ..report.summary import region_text
from ..run.folder import DETECTION
from ..scene.provenance import versions
from ..scene.settings import six_coordinates
from ..scene.site import Site, prepare
from ..sensors.beams import beam_lattice
from ..sensors.model import load_model
from .options import default_folder, mounting_from, scenario_from
from .progress import Progress
from .report import table_text

_OURS = (DETECTION, "detections.csv", "detections_baseline.csv", "label_2", "label_2_baseline")


def run(args: argparse.Namespace) -> int:
    """Detect at a mounting of a scene, or in clouds; returns the exit code."""
    if Path(args.scene).is_dir():
        return _run_clouds(args)
    check_detector(args.detector)
    scenario = scenario_from(args)
    mount = mounting_from(args, scenario)
    folder = Path(args.out if args.out is not None else default_folder(scenario, "detection"))
    check_unused(folder, "--out", "detect", lambda path: path.name in _OURS)
    site = prepare(scenario, mount)
    result = judge_at(site, mount, args.detector, folder)
    if args.json:
        print(json.dumps(result, indent=2))
        return 0
    frames = f"{result['frames']} {'held-out' if result['held_out'] else 'searched'} frames"
    print(f"Detector   {args.detector}; {frames}, vehicles {region_text(asdict(scenario.region))}\n")
    print(f"{told(result)}\n\nResults in {folder}")
    return 0


def check_detector(detector: str) -> None:
    """Refuse early a detector that needs what is not installed, or a file of detections that is not there."""
    if detector == ClassicalDetector.name:
        dbscan_class()
    elif not Path(detector).exists():
        raise MissingFileError(
            f"--detector: {detector}: there is no such file; allowed: {ClassicalDetector.name}, or FILE"
        )


def told(result: Mapping) -> str:
    """What was found, as a sentence and a table."""
    sentence = textwrap.fill(detection_text(result), 120, break_on_hyphens=False)
    return f"{sentence}\n\n{table_text(detection_table(result))}"


def judge_at(site: Site, mount: Mapping[str, float], detector: str, folder: Path) -> dict:
    """Judge a detector at a mounting and at the baseline, and write boxes and scores to a folder; returns the scores.

    Parameters
    ----------
    site : Site
    mount : mapping of str to float
        The six coordinates [m, degrees].
    detector : str
        Its name, or a file of detections at the mounting, which leaves the baseline out.
    folder : Path
    """
    mounts = {"baseline": six_coordinates(dict(site.scenario.baseline)), "given": dict(mount)}
    if mounts["baseline"] == mounts["given"] or detector != ClassicalDetector.name:
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
        "versions": versions(site.observation.caster),
    }
    _write(folder, site, judged, mounts, result)
    return result


def _judged(detector: str, site: Site, mounts: Mapping[str, Mapping[str, float]]) -> dict[str, JudgedDetector]:
    """What the detector makes of each mounting; a file of detections is of the mounting that is given."""
    if detector != ClassicalDetector.name:
        mount = mounts["given"]
        return {"given": judged_from_file(site, mount, read_detected(detector, mount), detector)}
    clouds = len(mounts) * (len(site.search) + len(judging_frames(site)[0]))
    with closing(Progress(clouds, "clouds")) as progress:
        return {
            name: judge_detector(
                site,
                mount,
                ClassicalDetector(site.observation.lattice, (mount["x_m"], mount["y_m"])),
                progress.advance,
            )
            for name, mount in mounts.items()
        }


def _write(folder: Path, site: Site, judged: Mapping[str, JudgedDetector], mounts, result: dict) -> None:
    """The detections of each mounting as CSV and as KITTI's labels, and the scores."""
    make_folder(folder, "--out")
    numbers = [frame.vehicles.frame for frame in judging_frames(site)[0]]
    for name, one in judged.items():
        of_frame = dict(zip(numbers, one.boxes, strict=True))
        ending = "" if name == "given" else f"_{name}"
        write_detected(folder / f"detections{ending}.csv", of_frame)
        write_kitti(folder / f"label_2{ending}", of_frame, mounts[name])
    write_text(folder / DETECTION, json.dumps(result, indent=2) + "\n")


# --- Clouds of a folder -----------------------------------------------------------------------------------------------


def _run_clouds(args: argparse.Namespace) -> int:
    """Detect in the NPZ clouds of a folder, as ``scan --frame-ids`` writes them; the background is learnt from them."""
    if args.detector != ClassicalDetector.name:
        raise InputError(f"--detector: {args.detector}: clouds are looked at by {ClassicalDetector.name}")
    paths = sorted(Path(args.scene).glob("*.npz"))
    if not paths:
        raise InputError(f"{args.scene}: has no .npz clouds, as scan --frame-ids writes them")
    out = Path(args.out if args.out is not None else "detections.csv")
    check_place(out, "--out")
    headers = {path: read_cloud(path)[1] for path in paths}
    first = headers[paths[0]]
    for path, header in headers.items():
        if any(header[key] != first[key] for key in ("sensor", "rotation_hz", "pose")):
            raise InputError(f"{path}: is of another sensor or mounting than {paths[0]}; allowed: one of both")
    pose = first["pose"]
    lattice = beam_lattice(load_model(first["sensor"]), first["rotation_hz"])
    detector = ClassicalDetector(lattice, (pose["x_m"], pose["y_m"]))
    found: dict[int, DetectedBoxes] = {}
    with closing(Progress(2 * len(paths), "clouds")) as progress:

        def clouds():
            for path in paths:
                yield read_cloud(path)[0]
                progress.advance(1)

        detector.learn(clouds())
        for path, cloud in zip(paths, clouds(), strict=True):
            found[int(headers[path]["frame"])] = detector.detect(cloud)
    write_detected(out, found)
    print(f"{out}: {sum(map(len, found.values())):,} boxes in {len(found)} clouds ({detector.name})")
    return 0
