"""blender-lidar compare: our scans and scores beside real, labelled sweeps.

``--paired``: the rays of real sweeps, cast against our shapes in the labelled boxes. ``--detections``: does a metric
follow what real detectors do?
"""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import asdict, replace
from importlib.util import find_spec
from pathlib import Path

from ..casting import CASTERS, resolve
from ..errors import InputError, MissingExtraError, OutputError, unknown_name
from ..files import check_folder, make_folder, to_csv, write_columns, write_text
from ..report.compare_figures import draw_detections, draw_paired
from ..report.compare_text import findings_text, paired_text
from ..scene.provenance import file_digest, versions
from ..sensors.imperfections import Imperfections
from ..studies.compare.cars import OURS, chosen_metrics, comparable
from ..studies.compare.detections import RULE, read_detections, read_frame_list
from ..studies.compare.detectors import Settings, compare
from ..studies.compare.findings import as_json, car_columns, correlation_table
from ..studies.compare.labelled import open_labelled
from ..studies.compare.paired import CLEARANCE_M, GROWN_M, LABEL_MARGIN_M, MEASURED, SHORT_M, pair_cars, variants
from ..studies.compare.paired_findings import RESULT, TABLE, aggregate, cheapest_within_noise, judging, paired_table
from ..toml_table import Setting, checked
from ..world.shapes import DETAILS
from .options import label_classes, new_folder
from .progress import Progress

SCHEMA = 1
_MOST_BLOCK_FRAMES = 100_000
_MOST_MARGIN_M = 1.0
_LOSSES = ("range_noise_m", "dropout", "glass_dropout", "range_at_10_percent_m")
_RESULT, _CARS, _CORRELATION = "compare.json", "cars.csv", "correlation.csv"


def add_parser(subparsers) -> None:
    """Describe the verb to argparse."""
    parser = subparsers.add_parser(
        "compare",
        help="hold shapes, beams and metrics against reality",
        description="Compare with real, labelled sweeps: the same rays cast against our shapes (--paired), or metrics "
        "beside what real detectors made of each car (--detections).",
    )
    parser.add_argument(
        "--kitti", required=True, metavar="DIR", help="labelled sweeps in the layout of KITTI or SUSTechPOINTS"
    )
    parser.add_argument(
        "--class",
        dest="classes",
        action="append",
        metavar="NAME",
        help="what the labels call a car; may be repeated (default Car, in small or capital letters)",
    )
    parser.add_argument("--out", metavar="DIR", help="folder of the results; by default a new one under runs/")
    parser.add_argument("--json", action="store_true", help="print the results as JSON, and nothing else, on stdout")
    group = parser.add_argument_group("--paired", "the same rays in reality and against our shapes")
    group.add_argument("--paired", action="store_true", help="compare points, occupancies and PE-VGOP ray by ray")
    group.add_argument(
        "--details", default=",".join(DETAILS), metavar="NAMES", help=f"levels of detail (default {','.join(DETAILS)})"
    )
    group.add_argument("--caster", default="auto", choices=("auto", *CASTERS), help="what casts the rays")
    group.add_argument(
        "--losses",
        default=",".join(f"{name}={getattr(MEASURED, name):g}" for name in _LOSSES),
        metavar="NAME=VALUE,...",
        help="what the variants with losses lose, by the keys of a scene's [sensor] (default %(default)s)",
    )
    group.add_argument(
        "--label-margin",
        type=float,
        nargs=3,
        default=LABEL_MARGIN_M,
        metavar=("L", "W", "H"),
        help="by how much labels are longer, wider and higher than the vehicles in them, in metres "
        f"(default {' '.join(format(one, 'g') for one in LABEL_MARGIN_M)})",
    )
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
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Carry it out; returns the exit code."""
    if args.paired == (args.detections is not None):
        raise InputError("compare: give either --paired or --detections CARS.csv")
    text, folder, files, result = _paired(args) if args.paired else _beside_detectors(args)
    out = sys.stderr if args.json else sys.stdout
    print(f"{text}\n\nResults in {folder}: {', '.join(files)}", file=out, flush=True)
    if args.json:
        print(json.dumps(result, indent=2, allow_nan=False))
    return 0


def _beside_detectors(args: argparse.Namespace) -> tuple[str, Path, list[str], dict]:
    """Text, folder, files and result of metrics beside detectors."""
    if not 1 <= args.block_frames <= _MOST_BLOCK_FRAMES:
        raise InputError(f"--block-frames: is {args.block_frames}; allowed: 1 to {_MOST_BLOCK_FRAMES}")
    if args.seed < 0:
        raise InputError(f"--seed: is {args.seed}; allowed: 0 or more")
    clearance_m = checked(args.ground_clearance, Setting(low=0.0), "--ground-clearance")
    settings = Settings(label_classes(args), clearance_m, args.block_frames, args.seed)
    metrics = chosen_metrics(args.metrics)
    for library in ("pandas", "scipy"):
        if find_spec(library) is None:
            raise MissingExtraError(f"compare --detections needs {library} (pip install {library})")
    folder = Path(args.out) if args.out is not None else new_folder(f"compare_{Path(args.kitti).resolve().name}")
    check_folder(folder, "--out")
    for name in (_RESULT, _CARS, _CORRELATION):
        if (folder / name).exists():
            raise InputError(f"--out: {folder}: holds {name} already; give another folder")
    clouds = open_labelled(args.kitti)
    findings = compare(clouds, read_detections(args.detections, args.frames_table), metrics, settings)
    about = {
        "schema": SCHEMA,
        "kitti": args.kitti,
        "detections": args.detections,
        "detections_sha256": file_digest(args.detections),
        **asdict(settings),
        "versions": versions(""),
    }
    result = as_json(findings, clouds, about)
    make_folder(folder, "--out")
    write_columns(folder / _CARS, car_columns(findings))
    write_text(folder / _CORRELATION, to_csv(*correlation_table(findings)))
    try:
        pictures = draw_detections(findings, folder)
    except MissingExtraError as error:
        pictures = []
        print(f"blender-lidar: note: no pictures: {error}", file=sys.stderr)
    write_text(folder / _RESULT, json.dumps(result, indent=2, allow_nan=False) + "\n")
    return findings_text(findings), folder, [_RESULT, _CARS, _CORRELATION, *pictures], result


def _paired(args: argparse.Namespace) -> tuple[str, Path, list[str], dict]:
    """Text, folder, files and result of rays cast against our shapes."""
    chosen = [name.strip() for name in args.details.split(",")]
    for name in chosen:
        if name not in DETAILS:
            raise unknown_name(name, DETAILS, "level of detail", "--details")
    details = [name for name in DETAILS if name in chosen]  # from the cheapest on
    for value in args.label_margin:
        if not 0.0 <= value <= _MOST_MARGIN_M:
            raise InputError(f"--label-margin: is {value}; allowed: 0 to {_MOST_MARGIN_M:g}")
    lossy, classes = _losses(args.losses), label_classes(args)
    caster = resolve(args.caster, "--caster")
    clouds = open_labelled(args.kitti)
    told = read_frame_list(clouds.folder)
    folder = new_folder("paired") if args.out is None else Path(args.out)
    check_folder(folder, "--out")
    if folder.is_dir() and any(folder.iterdir()):  # nothing is mixed with what another comparison left
        raise OutputError(f"--out: {folder}: is not empty; name a new folder")
    progress = Progress(len(clouds), "sweeps")
    try:
        ways = variants(details, lossy)
        paired = pair_cars(clouds, ways, caster, args.label_margin, classes, lambda: progress.advance(1))
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
        "label_margin_m": list(args.label_margin),
        "clearance_m": CLEARANCE_M,
        "hidden_if_nearer_than_box_by_m": GROWN_M + SHORT_M,
        "tuning": None if told.tuned is None else RULE,
        "sensor": paired.sensor,
        "left_out": paired.left_out,
        "sets": sets,
        "cheapest_within_noise": cheapest_within_noise(sets[judging(sets)], details),
        "versions": versions(caster),
    }
    make_folder(folder, "--out")
    write_columns(folder / TABLE, *paired_table(paired, told))
    try:
        pictures = draw_paired(paired, result, folder)
    except MissingExtraError as error:
        pictures = [f"no pictures: {error}"]
    write_text(folder / RESULT, json.dumps(result, indent=2) + "\n")
    return paired_text(result), folder, [TABLE, RESULT, *pictures], result


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
