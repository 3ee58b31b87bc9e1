"""blender-lidar dataset: labelled point clouds of a scene from random mountings, in the layouts of detectors."""

from __future__ import annotations

import argparse
from contextlib import ExitStack, closing
from dataclasses import asdict, replace
from pathlib import Path

from ..detection.dataset import TRAIN, VAL, DatasetPlan, plan_dataset
from ..detection.dataset_files import DatasetFolder
from ..detection.judge import watched
from ..document import as_sentence
from ..errors import InputError
from ..names import DATASET_LAYOUTS
from ..run.words import warnings_text
from ..scene.site import Site, prepare
from ..scoring.evaluation import workplace_of
from .options import default_folder, scenario_from
from .parsers import options_of
from .progress import Progress
from .report import say_result
from .verbs import DatasetOptions


def run(args: argparse.Namespace) -> int:
    """Make a data set, or go on with it; returns the exit code."""
    asked = options_of(args, DatasetOptions)
    layouts = _layouts(asked)
    scenario = scenario_from(args)
    whole = DatasetFolder(args.out if args.out is not None else default_folder(scenario, "dataset"))
    folders = [DatasetFolder(whole.path / name) if name else whole for name in scenario.names]
    for folder in folders:
        folder.check()
    texts, results, site = [], {}, prepare(scenario)
    for number, (name, folder) in enumerate(zip(scenario.names, folders, strict=True)):
        results[name] = result = _write(asked, layouts, site.with_lidar(number), folder, name)
        texts.append(_summary(result, folder.path))
    return say_result(args, "\n\n".join(texts), results.get("", results))


def _write(asked: DatasetOptions, layouts: tuple[str, ...], site: Site, folder: DatasetFolder, name: str) -> dict:
    """The data set of one LiDAR; `name` tells it from others, whose scans of a number show the same traffic."""
    scenario, joined = site.scenario, bool(name)
    as_recorded = asked.as_recorded or joined
    plan = plan_dataset(site, asked.mountings, asked.scans, scenario.search.seed, as_recorded=as_recorded)
    if joined and not asked.as_recorded:
        plan = replace(plan, notes=(*plan.notes, "as with --as-recorded, so that the scans of all LiDARs go together"))
    identity = {
        **site.identity,
        "--mountings": len(plan.mounts),
        "--scans": len(plan),
        "--as-recorded": as_recorded,
        "--layout": list(layouts),
    }
    if joined:
        identity["[[lidar]]"] = name
    with ExitStack() as stack:

        def progress(total: int, done: int):
            return stack.enter_context(closing(Progress(total, f"scans {name}".rstrip(), done))).advance

        workers = workplace_of(scenario.model).processes
        return folder.write(plan, layouts, identity, _about(site, plan, layouts), workers, progress)


def _layouts(asked: DatasetOptions) -> tuple[str, ...]:
    """The layouts that are asked for, in the order of their list."""
    given = asked.layouts or DATASET_LAYOUTS[:1]
    if len(set(given)) < len(given):
        raise InputError("--layout: names a layout twice")
    return tuple(layout for layout in DATASET_LAYOUTS if layout in given)


def _about(site: Site, plan: DatasetPlan, layouts: tuple[str, ...]) -> dict[str, object]:
    """What dataset.json says of a plan."""
    scenario = site.scenario
    error = scenario.model.pose_error
    return {
        "scene": Path(scenario.source).name,
        "sensor": site.model.name,
        "region": asdict(scenario.region),
        "road": scenario.road.as_table(),
        "outlines_m": _outlines(site),
        "range_gate_m": site.observation.lidar.max_range_m,
        "watched_m": [corner.tolist() for corner in watched(site)],
        "caster": site.observation.caster,
        "layouts": list(layouts),
        "seed": plan.seed,
        "pose_error": error and asdict(error),
        "mountings": [mount.as_table() for mount in plan.mounts],
        "warnings": site.recording.report.warnings_as_dicts(),
        "notes": [*site.plan.notes, *plan.notes],
        "versions": plan.versions,
    }


def _outlines(site: Site) -> list[list[list[float]]] | None:
    """The region on a level map as polygons, by which detectors are judged without the map; None for any other road."""
    scenario = site.scenario
    if scenario.road_map.endless or not scenario.road_map.surface.is_flat:
        return None
    return [outline.tolist() for outline in site.region.outlines]


def _summary(result: dict, folder: Path) -> str:
    lines = [*warnings_text(result)]
    for split, purpose in ((TRAIN, "for training"), (VAL, "for validation")):
        one = result[split]
        lines.append(
            f"{one['scans']:,} scans of {one['frames']:,} frames {purpose}: {one['labelled']:,} labelled boxes of "
            f"{one['different_vehicles']:,} vehicles, {one['with_return']:,} with a return"
        )
    mountings = len(result["mountings"])
    where = f"Data set in {folder}: {mountings} mounting{'s' * (mountings != 1)} of the {result['sensor']} "
    where += f"({result['caster']}), {', '.join(result['layouts'])}"
    return "\n".join([*lines, "", where, *(f"\n{as_sentence(note)}" for note in result["notes"])])
