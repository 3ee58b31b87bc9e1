"""What a run prints: what was loaded, and what it came to."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Mapping
from dataclasses import asdict
from itertools import chain
from pathlib import Path

from ..report.text import document_text
from ..run.folder import INSTALLATION, RunFolder, of_lidar
from ..run.optimise import scenery_counts
from ..run.words import each_lidar, imperfections_text, of_name, region_text, scenery_text, warnings_text
from ..scene.mounting import COORDINATE_NAMES
from ..scene.site import Site
from ..scoring.evaluation import workplace_of
from ..traffic.vehicles import counted

# --- Where a verb prints what ------------------------------------------------------------------------------


def say(args: argparse.Namespace, text: str) -> None:
    """Print for people: on stderr where stdout is for JSON."""
    print(text, file=sys.stderr if args.json else sys.stdout, flush=True)


def say_result(args: argparse.Namespace, text: str, result: Mapping) -> int:
    """Print what a verb has come to, for people and as JSON if that is asked for; returns the exit code."""
    say(args, text)
    if args.json:
        print(json.dumps(result, indent=2))
    return 0


def note(text: str) -> None:
    """Print a note on stderr."""
    print(f"blender-lidar: note: {text}", file=sys.stderr)


def say_stopped(folder: Path) -> int:
    """Say how to go on with what Ctrl-C has stopped; returns the exit code."""
    print(f"blender-lidar: stopped; go on with: --out {folder} --resume", file=sys.stderr)
    return 1


# --- What a run works on, and what it came to --------------------------------------------------------------


def describe_site(site: Site, *, searched: bool = True) -> str:
    """What a run will work on, in a few lines; `searched` is False where a mounting is given."""
    scenario, observation, report = site.scenario, site.observation, site.recording.report
    named = zip(scenario.names, scenario.lidars, strict=True)
    boxes = sum(int(frame.counted.sum()) for frame in site.search)
    traffic = f"{counted(len(site.search), 'frame')} with {counted(boxes, 'box')} of "
    traffic += counted(len(site.plan.searched_ids), "vehicle")
    held_out = "no frame is held out"
    if site.holdout:
        held_out = f"{counted(len(site.holdout), 'held-out frame')} for the check"
    lines = [
        *chain(*(_sensor_lines(site, *one) for one in enumerate(scenario.names))),
        ("Scenery", scenery_text(scenery_counts(site))),
        ("Traffic", f"{_traffic_text(site)}: {traffic}; {held_out}"),
        *(("", line) for line in report.lines(losses=True)),
        ("Region", f"vehicles count {region_text(asdict(scenario.region))}"),
        ("Installer", _installers(scenario)),
        *(("Searched", of_name(name, _ranges(one.deployment))) for name, one in named if searched),
        ("Casting", f"{observation.caster}, detail {observation.detail}, {workplace_of(scenario.model)}"),
    ]
    warnings = warnings_text({"warnings": report.warnings_as_dicts()})
    return "\n".join([*warnings, *(f"{name:<10} {text}" for name, text in lines if text)])


def _sensor_lines(site: Site, number: int, name: str) -> list[tuple[str, str]]:
    """The sensor of one LiDAR by its number, after its name where that tells it from others."""
    model, columns = site.models[number], ""
    if model.columns_a_turn:
        columns = f" with {model.columns()} columns a turn"
    sensor = site.scenario.lidars[number].sensor
    text = of_name(name, f"{model.name}{columns}, range gate {sensor.range_gate_m:g} m")
    return [("Sensor", text), ("", imperfections_text(sensor.imperfections_as_table()))]


def _traffic_text(site: Site) -> str:
    """Which recording a run is about, or all of several with their weights."""
    recordings = site.scenario.recordings
    if len(recordings) == 1:
        return recordings[0].path
    return " and ".join(f"{one.name} ({one.path}, weight {one.weight:g})" for one in recordings)


def files(folder: RunFolder) -> list[str]:
    """Where the results are, and how to see the rest."""
    sheets = ", ".join(of_lidar(INSTALLATION, name) for name in each_lidar(folder.result))
    return [
        f"{folder.path}: report.html (tables, charts, meanings), {sheets}, result.json, vehicles.csv",
        f"blender-lidar report {folder.path} --all prints the tables",
    ]


def run_report(args: argparse.Namespace) -> int:
    """Print what a finished run has come to; returns the exit code."""
    folder = RunFolder(args.folder)
    return say_result(args, document_text(folder.document, files(folder), every=args.all), folder.result)


def _installers(scenario):
    """Within what each LiDAR hangs of its plan; empty where all hang already."""
    texts = {lidar.name: lidar.deployment.installer for lidar in scenario.lidars}
    texts = {name: "hangs already" if one.is_exact else one.text for name, one in texts.items()}
    aim = "" if scenario.aim == "mean" else "; aims at the 10 % quantile over these errors"
    if set(texts.values()) == {"hangs already"}:
        return ""
    if len(set(texts.values())) == 1:
        return next(iter(texts.values())) + aim
    return "; ".join(f"{name}: {text}" for name, text in texts.items()) + aim


def _ranges(deployment):
    """The searched coordinates, each with its bounds; over all poles, which may have heights of their own."""
    poles, ranges = len(deployment.poles), []
    for key, (name, unit) in COORDINATE_NAMES.items():
        bounds = {place.bounds[key] for place in deployment.places if key in place.bounds}
        if bounds:
            own = ", as each pole allows" if len(bounds) > 1 else ""
            ranges.append(f"{name} {min(bounds)[0]:g} to {max(high for _, high in bounds):g} {unit}{own}")
    on_each = f"{counted(poles, 'pole')}; on each: " if poles else ""
    return f"{on_each}{', '.join(ranges) or 'nothing'}"
