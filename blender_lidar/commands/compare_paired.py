"""blender-lidar compare --paired: the rays of real sweeps, cast against our shapes in the labelled boxes."""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import replace
from pathlib import Path

from ..casting import CASTERS, resolve
from ..errors import InputError, OutputError, unknown_name
from ..formats.atomic import check_folder, make_folder
from ..provenance import versions
from ..reality.frame_list import RULE, read_frame_list
from ..reality.labelled_scene import LABEL_MARGIN_M
from ..reality.layouts import open_labelled
from ..reality.paired_cars import pair_cars
from ..reality.paired_output import summary, write_results
from ..reality.paired_statistics import aggregate, cheapest_within_noise, judging
from ..reality.pairing import CLEARANCE_M, GROWN_M, SHORT_M
from ..reality.variants import MEASURED, variants
from ..sensors.imperfections import Imperfections
from ..world.shapes import DETAILS
from .options import label_classes, new_folder
from .progress import Progress

_MOST_MARGIN_M = 1.0
_LOSSES = ("range_noise_m", "dropout", "glass_dropout", "range_at_10_percent_m")


def add_options(parser: argparse.ArgumentParser) -> None:
    """What the paired comparison needs beside the folder."""
    group = parser.add_argument_group("--paired", "the same rays in reality and against our shapes")
    group.add_argument("--paired", action="store_true", help="compare points, occupancies and PE-VGOP ray by ray")
    group.add_argument(
        "--details", default=",".join(DETAILS), metavar="NAMES", help=f"levels of detail (default {','.join(DETAILS)})"
    )
    group.add_argument("--caster", default="auto", choices=("auto", *CASTERS), help="what casts the rays")
    given = ((name, getattr(MEASURED, name)) for name in _LOSSES)
    group.add_argument(
        "--losses",
        default=",".join(f"{name}={value:g}" for name, value in given),
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


def run(args: argparse.Namespace) -> int:
    """Carry it out; returns the exit code."""
    details, margin_m = _details(args.details), _margin(args.label_margin)
    lossy, classes = _losses(args.losses), label_classes(args)
    caster = resolve(args.caster, "--caster")
    clouds = open_labelled(args.kitti)
    told = read_frame_list(clouds.folder)
    folder = _folder(args.out)
    progress = Progress(len(clouds), "sweeps")
    try:
        paired = pair_cars(clouds, variants(details, lossy), caster, margin_m, classes, lambda: progress.advance(1))
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
        "details": list(details),
        "losses": {name: getattr(lossy, name) for name in _LOSSES},
        "label_margin_m": list(margin_m),
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
    written = write_results(folder, paired, result, told)
    text = f"{summary(result)}\n\nResults in {folder}: {', '.join(written)}"
    print(text, file=sys.stderr if args.json else sys.stdout, flush=True)
    if args.json:
        print(json.dumps(result, indent=2))
    return 0


def _details(text: str) -> tuple[str, ...]:
    names = [name.strip() for name in text.split(",")]
    for name in names:
        if name not in DETAILS:
            raise unknown_name(name, DETAILS, "level of detail", "--details")
    return tuple(name for name in DETAILS if name in names)  # from the cheapest on


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


def _margin(given) -> tuple[float, ...]:
    for value in given:
        if not 0.0 <= value <= _MOST_MARGIN_M:
            raise InputError(f"--label-margin: is {value}; allowed: 0 to {_MOST_MARGIN_M:g}")
    return tuple(given)


def _folder(given: str | None) -> Path:
    """Where results go; a new folder, so that nothing is mixed with what another comparison left."""
    if given is not None:
        folder = Path(given)
        check_folder(folder, "--out")
        if folder.is_dir() and any(folder.iterdir()):
            raise OutputError(f"--out: {folder}: is not empty; name a new folder")
        return folder
    return new_folder("paired")
