"""blender-lidar detect: what a detector finds at a mounting, or on a data set: recall, precision and AP."""

from __future__ import annotations

import argparse
import json
import re
import textwrap
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack, closing
from dataclasses import asdict
from pathlib import Path

from ..clouds.commissioned import Hung, read_commission
from ..detection.classical import ClassicalDetector, dbscan_class
from ..detection.files import Poses, write_detected, write_kitti_labels
from ..detection.judge import (
    DETECTORS,
    detector_at,
    hung_off,
    is_ours,
    is_weights,
    judge_detectors,
    judged_from_file,
    site_judge,
    weights_of,
)
from ..detection.labels import labelled_numbers, read_labels
from ..detection.pillars import PillarsDetector, load_weights
from ..detection.stored import (
    check_clouds,
    detect_in_clouds,
    is_dataset,
    judge_in_clouds,
    judge_on_dataset,
    read_dataset,
)
from ..document import as_sentence
from ..errors import InputError, MissingExtraError, MissingFileError
from ..files import check_folder, check_unused, make_folder, write_text
from ..names import VEHICLE_CLASSES
from ..report.cloud_figures import draw_detections
from ..report.detection import detection_table, detection_text
from ..report.text import table_text
from ..run.folder import DETECTION
from ..run.optimise import sensors_text
from ..run.words import region_text, warnings_text
from ..scene.mounting import Layout
from ..scene.provenance import versions
from ..scene.scenario import Scenario, shipped_scenes
from ..scene.settings import ModelSettings
from ..scene.site import Site, prepare
from ..scoring.evaluation import Evaluator, workplace_of
from ..toml_table import settings_of
from ..traffic.boxes import Boxes
from ..traffic.vehicles import counted
from .cloud_options import RecordedOptions
from .options import default_folder, layout_from, new_folder, scenario_from
from .parsers import given_options
from .progress import Progress
from .report import note, say_result

_PICTURE = "detections.png"
_RECORDED = tuple(settings_of(RecordedOptions))
_OURS = re.compile(rf"{DETECTION}|{_PICTURE}|(detections|label_2)(_baseline|_early_fusion|_[\w-]+_alone)?(\.csv)?")


def run(args: argparse.Namespace) -> int:
    """Detect at a mounting of a scene, on a data set or in clouds; returns the exit code."""
    place = Path(args.scene)
    if place.is_dir() and args.scene not in shipped_scenes():
        return (_run_dataset if is_dataset(place) else _run_clouds)(args, place)
    if given := [f"--{key}" for key in given_options(args, _RECORDED)]:
        raise InputError(f"{', '.join(given)}: for folders of recorded clouds, but {args.scene} is a scene")
    check_detector(args.detector)
    scenario = scenario_from(args)
    check_fits_detectors(scenario)
    layout = layout_from(args, scenario)
    folder = _folder(args, lambda: default_folder(scenario, "detection"))
    result = judge_at(prepare(scenario, layout), layout, args.detector, folder)
    frames = f"{result['frames']} {'held-out' if result['held_out'] else 'searched'} frames"
    return _print(args, folder, result, f"{frames}, vehicles {region_text(result['region'])}")


def _folder(args: argparse.Namespace, default: Callable[[], Path]) -> Path:
    """The folder that the results go to, not yet made; a place that cannot be used is refused."""
    folder = default() if args.out is None else Path(args.out)
    check_folder(folder, "--out")
    check_unused(folder, "--out", "detect", lambda path: _OURS.fullmatch(path.name))
    return folder


def _print(args: argparse.Namespace, folder: Path, result: Mapping, judged: str) -> int:
    """Print what was found in what was `judged`; returns the exit code."""
    heading = "\n".join([*warnings_text(result), f"Detector   {args.detector}; {judged}"])
    parts = [heading, detection_summary(result), f"Results in {folder}", *map(as_sentence, result["notes"])]
    return say_result(args, "\n\n".join(parts), result)


def check_detector(detector: str) -> None:
    """Refuse early a detector that needs what is not installed, or a file of detections that is not there."""
    if detector == ClassicalDetector.name:
        dbscan_class()
    elif is_weights(detector) or detector == PillarsDetector.name:
        load_weights(weights_of(detector))
    elif not Path(detector).exists():
        raise MissingFileError(f"--detector: {detector}: there is no such file; allowed: {', '.join(DETECTORS)}, FILE")


def check_fits_detectors(scenario: Scenario) -> None:
    """Refuse what detectors do not find: vehicles off one plane of ground near z = 0, and pedestrians."""
    if "pedestrian" in scenario.objective.scored_classes:
        raise InputError(
            f"{scenario.where('objective', 'classes')}: pedestrian: the detectors find vehicles alone; allowed with a "
            f"detector: {', '.join(VEHICLE_CLASSES)}"
        )
    if scenario.road_map.surface.is_ground:
        raise InputError(f"{scenario.source}: [road] opendrive has heights; a detector needs a level map")


def detection_summary(result: Mapping) -> str:
    """What was found, as a sentence and a table."""
    sentence = textwrap.fill(detection_text(result), 120, break_on_hyphens=False)
    return f"{sentence}\n\n{table_text(detection_table(result))}"


def judge_at(site: Site, layout: Layout, detector: str, folder: Path) -> dict:
    """Judge a detector at a layout and at the baseline, and write boxes, scores and a picture; returns the scores.

    Parameters
    ----------
    site : Site
    layout : Layout
    detector : str
        Its name, or a file of detections at the layout, which leaves the baseline out.
    folder : Path
        Where they go; the picture where matplotlib is installed.
    """
    mounts = {"baseline": site.scenario.baselines, "given": layout}
    if mounts["baseline"] == layout or not is_ours(detector):
        del mounts["baseline"]
    judge, judged, several = site_judge(site), {}, len(layout) > 1
    if is_ours(detector):
        made = {
            name: [detector_at(site.with_lidar(number), one, detector) for number, one in enumerate(mounts[name])]
            for name in mounts
        }
        workers = workplace_of(site.scenario.model).processes
        learnt = sum(len(site.search) for detectors in made.values() for one in detectors if one.learns)
        with closing(Progress(learnt + len(made) * len(judge.frames), "clouds")) as progress:
            for name, detectors in made.items():
                of_all = judge_detectors(site, mounts[name], detectors, workers, progress.advance)
                judged |= of_all if name == "given" else {name: of_all["given"]}
    else:
        judged["given"] = judged_from_file(site, layout, detector)
    poses = {f"{lidar.name} alone": one.pose for lidar, one in zip(site.scenario.lidars, layout, strict=True)}
    poses |= {name: mount[0].pose for name, mount in mounts.items()}
    hung = tuple(hung_off(site.with_lidar(number), one) for number, one in enumerate(layout))
    rows = [
        {"name": lidar.name, "deployment": planned.as_table(), "hangs": hangs.as_table()}
        for lidar, planned, hangs in zip(site.scenario.lidars, layout, hung, strict=True)
    ]
    ceiling = Evaluator(judge.frames, site.observation, site.scoring).totals([hung]) if several else None
    about = {
        "scene": Path(site.scenario.source).name,
        "sensor": sensors_text(site),
        "region": asdict(site.scenario.region),
        "caster": site.observation.caster,
        **({"lidars": rows} if several else {key: rows[0][key] for key in ("deployment", "hangs")}),
        **({"detectable_share": float(ceiling.detectable_share()[0])} if several else {}),
        "warnings": site.recording.report.warnings_as_dicts(),
        "notes": site.plan.notes,
        "versions": versions(site.observation.caster),
    }
    result = judge.result(detector, judged, about)
    found = {
        "" if name == "given" else f"_{name.replace(' ', '_')}": (
            dict(zip(judge.numbers, one.boxes, strict=True)),
            poses.get(name, layout[0].pose),
        )
        for name, one in judged.items()
    }
    _write(folder, found, result)
    try:
        draw_detections(folder / _PICTURE, site, detector, judged, mounts)
    except MissingExtraError as error:
        note(f"no picture: {error}")
    return result


def _write(folder: Path, found: Mapping[str, tuple[Mapping[int, Boxes], Poses]], result: dict) -> None:
    """Detections as CSV and as KITTI's labels, by the ends of their names, and the scores, in place of earlier ones.

    Labels of several LiDARs together are in the frame of the first.
    """
    make_folder(folder, "--out")
    for found_before in filter(lambda path: _OURS.fullmatch(path.name), [*folder.iterdir()]):
        for path in [found_before] if found_before.is_file() else found_before.glob("[0-9]*.txt"):
            path.unlink()
    for ending, (of_frame, pose) in found.items():
        write_detected(folder / f"detections{ending}.csv", of_frame)
        write_kitti_labels(folder / f"label_2{ending}", of_frame, pose)
    write_text(folder / DETECTION, json.dumps(result, indent=2) + "\n")


# --- Folders: a data set, or clouds -----------------------------------------------------------------------------------

_OF_FOLDERS = ("SCENE.toml", "--detector", "--out", "--workers")


def _run_dataset(args: argparse.Namespace, place: Path) -> int:
    """Judge a detector on the scans of a data set that validate; returns the exit code."""
    _refuse_options(args, "a data set", ("--json", "--accept"))
    stored = read_dataset(place)
    check_clouds(stored, args.detector)
    check_detector(args.detector)
    folder = _folder(args, lambda: new_folder(f"{place.resolve().name}_detection"))
    with ExitStack() as stack:
        result, boxes = judge_on_dataset(stored, args.detector, _workers(args), _progress(stack), args.accept)
    _write(folder, {"": (boxes, stored.poses)}, result)
    scans = f"{result['scans']:,} scans{' of split val' * stored.validates} ({result['frames']} frames)"
    return _print(args, folder, result, f"{scans}, labelled vehicles {region_text(result['region'])}")


def _run_clouds(args: argparse.Namespace, place: Path) -> int:
    """Detect in the clouds of a folder: NPZ, as ``scan --frame-ids`` writes them, or a recording's; the exit code."""
    check_detector(args.detector)
    if not is_ours(args.detector):
        text = f"allowed with a folder of clouds: {' or '.join(DETECTORS)}; to judge a file of detections give"
        raise InputError(f"--detector: {args.detector}: {text} detect SCENE or DATASET --detector FILE")
    asked = given_options(args, _RECORDED)
    hung, of_boxes = _hung(args, asked), ("--accept", "--json") if "boxes" in asked else ()
    taken = (*(f"--{key}" for key in _RECORDED), *of_boxes, *(["--sensor"] if hung else []))
    _refuse_options(args, "a folder of clouds", taken)
    labels = read_labels(asked["boxes"], hung).vehicles_alone if "boxes" in asked else None
    folder = _folder(args, lambda: new_folder("detections"))
    with ExitStack() as stack:
        found = detect_in_clouds(place, args.detector, _workers(args), _progress(stack), hung, asked.get("region"))
    if labels is not None:
        where, empty = asked["boxes"], labelled_numbers(asked["boxes"])
        result = {"clouds": place.resolve().name}
        result |= judge_in_clouds(found, args.detector, labels, where, args.accept, empty)
        _write(folder, {"": (found.boxes, found.pose)}, result)
        return _print(args, folder, result, f"{counted(result['frames'], 'frame')}, boxes of {asked['boxes']}")
    make_folder(folder, "--out")
    write_detected(folder / "detections.csv", found.boxes)
    write_kitti_labels(folder / "label_2", found.boxes, found.pose)
    print(f"{folder}: {sum(map(len, found.boxes.values())):,} boxes in {len(found.boxes)} clouds ({args.detector})")
    print("\n".join(map(as_sentence, found.notes)), end="\n" if found.notes else "")
    return 0


def _hung(args: argparse.Namespace, asked: Mapping) -> Hung | None:
    """How the sensor of recorded clouds hangs; None for clouds of scan."""
    given = [f"--{key}" for key in ("axes", "pose", "sensor", "region") if getattr(args, key) is not None]
    if "commission" in asked:
        return read_commission(asked["commission"], [option for option in given if option != "--region"])
    if "pose" in asked:
        return Hung(asked.get("axes", "rfu"), asked["pose"], args.sensor)
    if given:
        raise InputError(f"{given[0]}: is given without --pose; allowed: both, for clouds of a recording")
    return None


def _refuse_options(args: argparse.Namespace, what: str, taken: Sequence[str] = ()) -> None:
    """Refuse options of scenes where a folder is given."""
    for option in args.given:
        if option not in (*_OF_FOLDERS, *taken):
            raise InputError(f"{option}: is an option for scenes, but {args.scene} is {what}")


def _workers(args: argparse.Namespace) -> int:
    """How many processes look at clouds of a folder."""
    return workplace_of(ModelSettings(**given_options(args, ("workers",)))).processes


def _progress(stack: ExitStack) -> Callable[[int], Callable[[int], object]]:
    return lambda total: stack.enter_context(closing(Progress(total, "clouds"))).advance
