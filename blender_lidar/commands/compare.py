"""blender-lidar compare: a recorded, labelled cloud beside its simulation."""

from __future__ import annotations

import argparse
import json
import math
from dataclasses import asdict
from pathlib import Path

from ..casting import resolve
from ..clouds.commissioned import Hung, read_commission
from ..clouds.fit import accepted, cloud_misfit
from ..clouds.points import check_steps
from ..errors import InputError, MissingExtraError, unknown_name
from ..files import check_folder, check_unused, make_folder, write_columns, write_text
from ..names import DEFAULT_CELL_M
from ..report.compare import comparison_text, draw_comparison
from ..run.words import warnings_text
from ..scene.provenance import versions
from ..sensors.beams import beam_lattice
from ..sensors.imperfections import Imperfections
from ..sensors.model import load_model
from ..sensors.pose import Pose
from ..studies.compare import NO_LOSSES, Setup, aggregate, compare_frames
from ..studies.recorded import labelled_frames
from ..toml_table import settings_of
from ..world.shapes import DETAILS
from .cloud_options import CompareOptions
from .options import new_folder
from .parsers import options_of
from .progress import Progress
from .report import note, say_result

COMPARE_SCHEMA = 4
RESULT, TABLE, PICTURE = "compare.json", "compare.csv", "compare.png"
_PLACED = "sensor", "x_m", "y_m", "height_m", "tilt_x_deg", "tilt_y_deg", "yaw_deg"
_LOSSES = ("range_noise_m", "dropout", "glass_dropout", "range_at_10_percent_m")


def run(args: argparse.Namespace) -> int:
    """Carry it out; returns the exit code."""
    asked = options_of(args, CompareOptions)
    folder = Path(asked.out or new_folder("compare"))
    check_folder(folder, "--out")
    check_unused(folder, "--out", "comparison")
    hung = hung_of(asked)
    setup, sensor = setup_of(asked, hung), asked.sensor if hung is None else hung.sensor
    lattice = beam_lattice(load_model(sensor), asked.rotation_hz)
    warned = []

    def fitting():
        for frame in labelled_frames(asked.points, asked.boxes, asked.frames, hung):
            check_steps(frame.points, DEFAULT_CELL_M, frame.where)
            misfit = cloud_misfit(frame.points, frame.boxes, options=False)
            warned.extend(accepted(misfit, f"{frame.where}, {asked.boxes}", asked.accept))
            yield frame

    progress = Progress(len(asked.points), "clouds")
    try:
        found = compare_frames(fitting(), lattice, setup, lambda: progress.advance(1))
    finally:
        progress.close()
    result = {
        "schema": COMPARE_SCHEMA,
        "source": [list(asked.points), asked.boxes],
        "clouds": len(asked.points),
        "classes": setup.classes and list(setup.classes),
        "sensor": sensor,
        "pose": asdict(setup.pose),
        "beams": found.sensor,
        "caster": setup.caster,
        "losses": list(setup.losses),
        "label_margin_m": list(setup.margin_m),
        "ground_clearance_m": setup.clearance_m,
        "left_out": found.left_out,
        "warnings": warned,
        **aggregate(found.table),
        "versions": versions(setup.caster),
    }
    make_folder(folder, "--out")
    floats = [name for name, column in found.table.items() if column.dtype.kind == "f"]
    write_columns(folder / TABLE, found.table, {name: 3 if name.endswith("_m") else 5 for name in floats})
    written = [RESULT, TABLE]
    try:
        draw_comparison(folder / PICTURE, found.table, result)
        written.append(PICTURE)
    except MissingExtraError as error:
        note(f"no picture: {error}")
    write_text(folder / RESULT, json.dumps(result, indent=2, allow_nan=False) + "\n")
    text = "\n".join(
        [*warnings_text(result), comparison_text(result), "", f"Results in {folder}: {', '.join(written)}"]
    )
    return say_result(args, text, result)


def hung_of(asked: CompareOptions) -> Hung | None:
    """How the sensor hangs as --commission says, with no option beside it that says it too; None without it."""
    if asked.commission is None and asked.sensor is None:
        raise InputError("--sensor: is missing; allowed: a sensor model or beam table, or --commission")
    given = [settings_of(CompareOptions)[key].option for key in _PLACED if getattr(asked, key)]
    return None if asked.commission is None else read_commission(asked.commission, given)


def setup_of(asked: CompareOptions, hung: Hung | None = None) -> Setup:
    """How the clouds are to be simulated."""
    chosen = [name.strip() for name in asked.details.split(",")]
    for name in chosen:
        if name not in DETAILS:
            raise unknown_name(name, DETAILS, "level of detail", "--details")
    near, far = asked.distance_m or (0.0, math.inf)
    if not near < far:
        raise InputError(f"--distance: {near:g} {far:g}; allowed: the nearer one first")
    angles = (math.radians(angle) for angle in (asked.tilt_x_deg, asked.tilt_y_deg, asked.yaw_deg))
    return Setup(
        details=tuple(name for name in DETAILS if name in chosen),  # from the cheapest on
        caster=resolve(asked.caster, "--caster"),
        pose=Pose(asked.x_m, asked.y_m, asked.height_m, *angles) if hung is None else hung.pose,
        blind_deg=() if hung is None else hung.blind_deg,
        losses={text: losses_of(text) for text in asked.losses or (NO_LOSSES,)},
        margin_m=asked.label_margin_m or (0.0, 0.0, 0.0),
        clearance_m=asked.clearance_m,
        classes=asked.classes,
        between_m=(near, far),
    )


def losses_of(text: str) -> Imperfections:
    """The losses that `text` names, such as ``"dropout=0.05,range_at_10_percent_m=50"``, or none."""
    given = {}
    for part in text.split(",") if text != NO_LOSSES else ():
        name, _, number = part.partition("=")
        if name.strip() not in _LOSSES:
            raise unknown_name(name.strip(), _LOSSES, "loss", "--losses")
        try:
            given[name.strip()] = float(number)
        except ValueError:
            raise InputError(f"--losses: {part!r}; allowed: NAME=VALUE, such as glass_dropout=0.5") from None
    try:
        return Imperfections(**given)
    except InputError as error:
        raise InputError(f"--losses: {error}") from error
