"""blender-lidar compare: our scans and scores beside real, labelled sweeps.

``--paired``: the rays of real sweeps, cast against our shapes in the labelled boxes. ``--detections``: does a metric
follow what real detectors do?
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path

from ..casting import resolve
from ..errors import InputError, MissingExtraError, unknown_name
from ..files import check_folder, check_unused, make_folder, to_csv, write_columns, write_text
from ..report.compare_figures import draw_detections, draw_paired
from ..report.compare_text import findings_text, paired_text
from ..scene.provenance import file_digest, versions
from ..sensors.imperfections import Imperfections
from ..studies.compare.cars import chosen_metrics
from ..studies.compare.detections import FRAMES_FILE, SETS_RULE, read_detections, read_frames, tuned_frames
from ..studies.compare.detectors import Settings, car_columns, compare, correlation_table, plain
from ..studies.compare.labelled import open_labelled
from ..studies.compare.paired import CLEARANCE_M, GROWN_M, MEASURED, SHORT_M, pair_cars, variants
from ..studies.compare.paired_findings import RESULT, TABLE, aggregate, cheapest_within_noise, judging, paired_table
from ..toml_table import Setting, checked
from ..world.shapes import DETAILS
from .options import check_scipy, label_classes, new_folder
from .progress import Progress

COMPARE_SCHEMA = 1
_ASKED = {
    "ground_clearance": Setting(low=0.0),
    "block_frames": Setting(kind=int, low=1, high=100_000),
    "seed": Setting(kind=int, low=0),
}
_MARGIN = Setting(kind=tuple[float, float, float], low=0.0, high=1.0)
_LOSSES = ("range_noise_m", "dropout", "glass_dropout", "range_at_10_percent_m")
_RESULT, _CARS, _CORRELATION = "compare.json", "cars.csv", "correlation.csv"
Made = tuple[dict, dict[str, Callable[[Path], None]], Callable[[Path], list[str]], str]
"""Of a comparison: its result, what writes its tables by the names of their files, what draws it, and its text."""


def run(args: argparse.Namespace) -> int:
    """Carry it out; returns the exit code."""
    if args.paired == (args.detections is not None):
        raise InputError("compare: give either --paired or --detections CARS.csv")
    folder = Path(args.out or new_folder("paired" if args.paired else f"compare_{Path(args.kitti).resolve().name}"))
    check_folder(folder, "--out")
    name, *others = (RESULT, TABLE) if args.paired else (_RESULT, _CARS, _CORRELATION)
    for file in (name, *others):  # nothing is mixed with what another comparison left
        if (folder / file).exists():
            raise InputError(f"--out: {folder}: holds {file} already; give another folder")
    check_unused(folder, "--out", "comparison")
    result, tables, draw, text = _paired(args) if args.paired else _beside_detectors(args)
    make_folder(folder, "--out")
    for file, write in tables.items():
        write(folder / file)
    try:
        pictures = draw(folder)
    except MissingExtraError as error:
        pictures = []
        print(f"blender-lidar: note: no pictures: {error}", file=sys.stderr)
    written = json.dumps(result, indent=2, allow_nan=False)
    write_text(folder / name, written + "\n")
    out = sys.stderr if args.json else sys.stdout
    print(f"{text}\n\nResults in {folder}: {', '.join([name, *tables, *pictures])}", file=out, flush=True)
    if args.json:
        print(written)
    return 0


def _beside_detectors(args: argparse.Namespace) -> Made:
    """Metrics beside detectors."""
    asked = [checked(getattr(args, key), limits, f"--{key.replace('_', '-')}") for key, limits in _ASKED.items()]
    settings = Settings(label_classes(args), *asked)
    metrics = chosen_metrics(args.metrics)
    check_scipy("compare --detections")
    clouds = open_labelled(args.kitti)
    findings = compare(clouds, read_detections(args.detections, args.frames_table), metrics, settings)
    about = {
        "schema": COMPARE_SCHEMA,
        "kitti": args.kitti,
        "detections": args.detections,
        "detections_sha256": file_digest(args.detections),
        **asdict(settings),
        "versions": versions(""),
    }
    tables = {
        _CARS: partial(write_columns, columns=car_columns(findings.judged)),
        _CORRELATION: partial(write_text, text=to_csv(*correlation_table(findings))),
    }
    return about | plain(findings.result), tables, partial(draw_detections, findings), findings_text(findings)


def _paired(args: argparse.Namespace) -> Made:
    """Rays of real sweeps cast against our shapes."""
    chosen = [name.strip() for name in args.details.split(",")]
    for name in chosen:
        if name not in DETAILS:
            raise unknown_name(name, DETAILS, "level of detail", "--details")
    details = [name for name in DETAILS if name in chosen]  # from the cheapest on
    margin_m = checked(args.label_margin, _MARGIN, "--label-margin")
    lossy, classes, caster = _losses(args.losses), label_classes(args), resolve(args.caster, "--caster")
    clouds = open_labelled(args.kitti)
    listed = clouds.folder / FRAMES_FILE
    told = read_frames(listed) if listed.is_file() else {}
    progress = Progress(len(clouds), "sweeps")
    try:
        ways = variants(details, lossy)
        paired = pair_cars(clouds, ways, caster, margin_m, classes, lambda: progress.advance(1))
    finally:
        progress.close()
    sets = aggregate(paired, told)
    result = {
        "folder": str(args.kitti),
        "layout": clouds.layout,
        "sweeps": len(clouds),
        "unpaired_files": clouds.unpaired,
        "classes": list(classes),
        "caster": caster,
        "details": details,
        "losses": {name: getattr(lossy, name) for name in _LOSSES},
        "label_margin_m": list(margin_m),
        "clearance_m": CLEARANCE_M,
        "hidden_if_nearer_than_box_by_m": GROWN_M + SHORT_M,
        "tuning": None if tuned_frames(told) is None else SETS_RULE,
        "sensor": paired.sensor,
        "left_out": paired.left_out,
        "sets": sets,
        "cheapest_within_noise": cheapest_within_noise(sets[judging(sets)], details),
        "versions": versions(caster),
    }
    columns, decimals = paired_table(paired, told)
    tables = {TABLE: partial(write_columns, columns=columns, decimals=decimals)}
    return result, tables, partial(draw_paired, paired, result), paired_text(result)


def _losses(text: str) -> Imperfections:
    """The measured losses with those replaced that `text` names."""
    given = {}
    for part in text.split(","):
        name, _, number = part.partition("=")
        if name.strip() not in _LOSSES:
            raise unknown_name(name.strip(), _LOSSES, "loss", "--losses")
        try:
            given[name.strip()] = float(number)
        except ValueError:
            raise InputError(f"--losses: {part!r}; allowed: NAME=VALUE, such as glass_dropout=0.5") from None
    try:
        return replace(MEASURED, **given)
    except InputError as error:
        raise InputError(f"--losses: {error}") from error
