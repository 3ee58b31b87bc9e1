"""blender-lidar compare --detections: does a metric follow what real detectors do?"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

from ..errors import InputError
from ..provenance import file_digest, versions
from ..reality.chosen_metrics import OURS, chosen_metrics, comparable
from ..reality.detections import read_detections
from ..reality.detector_study import Settings, compare
from ..reality.findings_output import check_place, write_findings
from ..reality.findings_tables import as_json
from ..reality.findings_text import findings_text
from ..reality.layouts import open_labelled
from ..reality.resampled_cars import Draws
from .options import checked_number, label_classes, new_folder

SCHEMA = 1
_MOST_BLOCK_FRAMES = 100_000


def add_options(parser: argparse.ArgumentParser) -> None:
    """The options of this half of `compare`."""
    group = parser.add_argument_group("beside detectors")
    group.add_argument(
        "--detections",
        metavar="CARS.csv",
        help="what detectors made of each car: frame, label_line, and NAME_confidence and NAME_iou3d for each detector",
    )
    group.add_argument(
        "--frames-table",
        metavar="CSV",
        help="split, label_kind and drive of each frame; by default frames.csv beside CARS.csv, if it is there",
    )
    group.add_argument(
        "--metrics",
        metavar="NAMES",
        help=f"metrics, divided by commas; the others are held against the first (default all, {OURS} first): "
        + ", ".join(comparable()),
    )
    group.add_argument(
        "--ground-clearance",
        type=float,
        default=0.0,
        metavar="M",
        help="leave out points this little above a box's floor (default 0: none, as detectors see them too)",
    )
    group.add_argument(
        "--block-frames",
        type=int,
        default=1,
        metavar="N",
        help="resample N frames as one, in the order of their names (default 1); whole drives where they are told",
    )
    group.add_argument("--seed", type=int, default=1, help="of the resamples and folds (default 1)")


def run(args: argparse.Namespace) -> int:
    """Carry it out; returns the exit code."""
    settings = _settings(args)
    metrics = chosen_metrics(args.metrics)
    folder = Path(args.out) if args.out is not None else new_folder(f"compare_{Path(args.kitti).resolve().name}")
    check_place(folder)
    clouds = open_labelled(args.kitti)
    detections = read_detections(args.detections, args.frames_table)
    findings = compare(clouds, detections, metrics, settings)
    about = {
        "schema": SCHEMA,
        "kitti": args.kitti,
        "detections": args.detections,
        "detections_sha256": file_digest(args.detections),
        "classes": list(settings.classes),
        "ground_clearance_m": settings.ground_clearance_m,
        **settings.draws._asdict(),
        "versions": versions(""),
    }
    result = as_json(findings, clouds, about)
    files, note = write_findings(findings, result, settings.draws, folder)
    if note:
        print(f"blender-lidar: note: {note}", file=sys.stderr)
    out = sys.stderr if args.json else sys.stdout
    print(f"{findings_text(findings)}\n\nResults in {folder}: {', '.join(files)}", file=out, flush=True)
    if args.json:
        print(json.dumps(result, indent=2, allow_nan=False))
    return 0


def _settings(args: argparse.Namespace) -> Settings:
    if not 1 <= args.block_frames <= _MOST_BLOCK_FRAMES:
        raise InputError(f"--block-frames: is {args.block_frames}; allowed: 1 to {_MOST_BLOCK_FRAMES}")
    if args.seed < 0:
        raise InputError(f"--seed: is {args.seed}; allowed: 0 or more")
    clearance = checked_number(args.ground_clearance, "--ground-clearance", low=0.0)
    return Settings(label_classes(args), clearance, Draws(args.block_frames, args.seed))
