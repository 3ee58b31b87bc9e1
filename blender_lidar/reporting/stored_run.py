"""A run that has ended, read from its folder and checked, so that what is told of it needs nothing else."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np

from ..errors import InputError, MissingFileError
from ..input_file import read_text
from ..metrics.catalogue import METRICS
from ..optimise import READINGS
from ..results import INSTALLATION, RESULT, SCENE, SCHEMA, VEHICLES, VEHICLES_BASELINE, RunFolder
from ..settings import COORDINATES
from ..study.vehicle_table import columns_for
from ..tolerance_table import AIMS
from ..toml_table import read_toml
from ..traffic.report import RepairReport
from .shapes import (
    COUNT,
    NUMBER,
    NUMBER_OR_PAIR,
    PAIR,
    PAIR_TABLE,
    RUNGS,
    TEXT,
    TEXT_TABLE,
    TEXTS,
    MayLack,
    Nullable,
    check_shape,
    one_of,
    or_null,
)

_MOUNT = dict.fromkeys(COORDINATES, NUMBER)
_SCORES = {"objective_per_vehicle": NUMBER, "detectable_share": NUMBER}
_HELD_OUT = _SCORES | {
    "gain_over_baseline": NUMBER,
    "interval_90": or_null(PAIR),
    **dict.fromkeys(("vehicles", "frames", "blocks"), COUNT),
}
_JUDGED = _SCORES | {"deployment": _MOUNT, "objective": NUMBER, "holdout": Nullable(_HELD_OUT)}
_MAP = {
    "points": PAIR,
    "best": dict.fromkeys(("height_m", "tilt_x_deg", "objective_per_vehicle"), NUMBER),
    "search_shortfall": or_null(NUMBER),
    "holdout_regret": MayLack(or_null(NUMBER)),
    "optimum_interval_90": Nullable(dict.fromkeys(("height_m", "tilt_x_deg"), PAIR)),
    "share_within_1_percent": or_null(NUMBER),
}
_IDENTITY = {
    "[traffic] path": TEXT,
    "[objective] loss": or_null(NUMBER),
    "[objective] threshold": NUMBER,
    "[objective] view": TEXT,
    **{f"[deployment] {key}": NUMBER_OR_PAIR for key in COORDINATES},
}
_IMPERFECTIONS = {
    **dict.fromkeys(("range_noise_m", "dropout", "unit_spread_deg"), NUMBER),
    "glass_dropout": MayLack(NUMBER),
    "range_at_10_percent_m": MayLack(or_null(NUMBER)),
    **dict.fromkeys(("unit", "noise_seed"), COUNT),
}
_OVER_SHARP = {"objective_per_vehicle": NUMBER, "interval_90": or_null(PAIR)}
_OVER = _SCORES | {"gain_kept": or_null(NUMBER), "loss_at_limits": PAIR_TABLE}
_OVER_HELD_OUT = _OVER | {
    "gain_over_baseline": NUMBER,
    "interval_90": or_null(PAIR),
    "over_sharp": MayLack(dict.fromkeys(("as_planned", "over_tolerance"), _OVER_SHARP)),
}
_OVER_TOLERANCE = _OVER | {"objective": NUMBER, "holdout": Nullable(_OVER_HELD_OUT)}
_TOLERANCE = {
    "settings": {**dict.fromkeys(("height_m", "tilt_deg", "yaw_deg"), NUMBER), "aim": one_of(AIMS)},
    "searched_errors": or_null(COUNT),
    "judged_errors": COUNT,
    "evaluations": Nullable(dict.fromkeys(("sharp", "robust"), COUNT)),
    "robust": {**dict.fromkeys(("optimised", "baseline"), _OVER_TOLERANCE), "sharp": MayLack(_OVER_TOLERANCE)},
    "sharp": Nullable(_JUDGED),
}
_KINDS = {int: COUNT, float: NUMBER, str: TEXT, tuple: TEXTS}
_RESULT = _JUDGED | {
    "scene": MayLack(TEXT),
    "imperfections": MayLack(_IMPERFECTIONS),
    "scenery": MayLack(Nullable(dict.fromkeys(("objects", "triangles"), COUNT))),
    **dict.fromkeys(("sensor", "caster", "detail"), TEXT),
    "metric": one_of(METRICS),
    **dict.fromkeys(("evaluations", "seed", "frames", "vehicles"), COUNT),
    **dict.fromkeys(("range_gate_m", "block_s", "seconds"), NUMBER),
    "reading": one_of(READINGS),
    "search": or_null(TEXT),
    "fidelity": MayLack(TEXT),
    "rungs": MayLack(or_null(RUNGS)),
    "map": Nullable(_MAP),
    "baseline": _JUDGED,
    "tolerance": MayLack(Nullable(_TOLERANCE)),
    "notes": TEXTS,
    "traffic_report": {field.name: MayLack(_KINDS[type(field.default)]) for field in fields(RepairReport)},
    "identity": _IDENTITY,
    "versions": TEXT_TABLE,
}


@dataclass(frozen=True, slots=True, eq=False)
class StoredRun:
    """What a run has left.

    Attributes
    ----------
    folder : RunFolder
        Where it is.
    name : str
        Of the scene.
    result : dict
        The content of result.json, checked.
    optimised, baseline : dict of str to ndarray
        Vehicle tables of both mountings: the same vehicles in the same order.
    traffic_file : str
        Name of the trajectory file.
    repairs : RepairReport
        What reading it found and repaired.
    scene, installation : str
        The content of scene.toml and installation.txt.
    """

    folder: RunFolder
    name: str
    result: dict
    optimised: dict[str, np.ndarray]
    baseline: dict[str, np.ndarray]
    traffic_file: str
    repairs: RepairReport
    scene: str
    installation: str


def read_run(folder: RunFolder) -> StoredRun:
    """Read a run that has ended.

    Raises
    ------
    MissingFileError, InputError
        When the folder holds no run that has ended, or one of its files is missing or damaged; the text names it.
    """
    result = folder.ended_result()
    where = str(folder.file(RESULT))
    if result.get("schema") != SCHEMA:
        raise InputError(f"{where}: schema is not {SCHEMA}, the one that this version writes")
    check_shape(result, _RESULT, where)
    if (result["holdout"] is None) != (result["baseline"]["holdout"] is None):
        raise InputError(f"{where}: only one of holdout and baseline.holdout is null")
    _check_tolerance(result, where)
    scene = read_toml(folder.file(SCENE))
    check_shape(scene, {"traffic": {"path": TEXT}}, str(folder.file(SCENE)))
    optimised, baseline = folder.read_vehicles(VEHICLES), folder.read_vehicles(VEHICLES_BASELINE)
    for name, table in ((VEHICLES, optimised), (VEHICLES_BASELINE, baseline)):
        if missing := set(columns_for(result["metric"])) - set(table):
            raise InputError(f"{folder.file(name)}: is damaged: has no column {missing.pop()!r}")
    if any(not np.array_equal(optimised[key], baseline[key]) for key in ("frame", "vehicle_id", "split")):
        raise InputError(f"{folder.file(VEHICLES_BASELINE)}: lists other vehicles than {VEHICLES}")
    return StoredRun(
        folder=folder,
        name=_scene_name(result, folder),
        result=result,
        optimised=optimised,
        baseline=baseline,
        traffic_file=Path(scene["traffic"]["path"]).name,
        repairs=_repairs(result["traffic_report"]),
        scene=_text(folder.file(SCENE)),
        installation=_text(folder.file(INSTALLATION)),
    )


def _check_tolerance(result: Mapping, where: str) -> None:
    """Refuse a block of which one half tells of a search or of held-out frames, and the other does not."""
    if result.get("tolerance") is None:
        return
    block = result["tolerance"]
    parts = (block["sharp"], block["robust"].get("sharp"), block["evaluations"], result["search"])
    if len({part is None for part in parts}) > 1:
        raise InputError(f"{where}: tolerance: only a part of it tells of a search")
    judged = [scores["holdout"] for scores in (*block["robust"].values(), *parts[:1]) if scores is not None]
    if {held is None for held in judged} != {result["holdout"] is None}:
        raise InputError(f"{where}: tolerance: only a part of it tells of held-out frames")


def _scene_name(result: Mapping, folder: RunFolder) -> str:
    """The scene file's name without its ending; the folder's in the results of earlier versions."""
    return Path(result.get("scene", "")).stem or folder.path.resolve().name


def _repairs(counts: Mapping) -> RepairReport:
    """The report as it was; what an earlier version did not count yet is nought."""
    values = ((field.name, counts[field.name]) for field in fields(RepairReport) if field.name in counts)
    return RepairReport(**{name: tuple(value) if isinstance(value, list) else value for name, value in values})


def _text(path: Path) -> str:
    try:
        return read_text(path)
    except FileNotFoundError as error:
        raise MissingFileError(f"{path}: there is no such file") from error
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: cannot be read: {error}") from error
