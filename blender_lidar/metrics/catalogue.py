"""The metrics by name, and those of plug-ins: what `[objective] metric` and `--metric` may say."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from ..errors import InputError, unknown_name
from ..plugins import IN_A_FILE, call_plugin, faults_in_one_line, is_plugin, load_plugin
from . import vehicle_metrics as vehicle
from .metric import NEEDS_DETECTABLE, NEEDS_POINTS, Metric, ScoreFunction, VehicleReturns

# --- The metrics: the paper's, what a planner signs for, and the one that evidence recommends beside it ---------------

_HIT = "of its top, side and front the beams hit"

PE_VGOP = Metric(
    "pe-vgop", "PE-VGOP", "bits", higher_is_better=True, score=vehicle.view_entropy, tells=f"how much {_HIT}"
)
DETECTABLE = Metric(
    "detectable",
    "detectable share",
    "",
    higher_is_better=True,
    score=vehicle.detectable_share,
    needs=frozenset({NEEDS_DETECTABLE}),
    tells=f"whether enough {_HIT} to reach the threshold; PE-VGOP breaks ties",
    decimals=1,
    of_share=True,
)
VIEW_COVERAGE = Metric(
    "view-coverage",
    "view coverage",
    "",
    higher_is_better=True,
    score=vehicle.view_coverage,
    needs=frozenset({NEEDS_POINTS}),
    tells=f"how much {_HIT}, from 0 to 1",
)
METRICS: dict[str, Metric] = {metric.name: metric for metric in (PE_VGOP, DETECTABLE, VIEW_COVERAGE)}


def metric_named(name: str, where: str = "") -> Metric:
    """The metric of that name, or the one in a file, ``FILE.py:NAME``.

    Raises
    ------
    MissingFileError, InputError
        When there is none, with the nearest name, or it cannot be loaded; `where` says where the name came from.
    """
    if name in METRICS:
        return METRICS[name]
    if not is_plugin(name):
        raise unknown_name(name, (*METRICS, IN_A_FILE), "metric", where)
    found = load_plugin(name, where)
    if not isinstance(found, Metric):
        prefix = f"{where}: " if where else ""
        raise InputError(f"{prefix}{name}: is a {type(found).__name__}; allowed: a function with @blender_lidar.metric")
    what = f"metric {name!r}"
    if found.learn is not None:
        return replace(found, learn=partial(_learnt, what, found.learn))
    return replace(found, score=partial(_scored, what, found.score))


def _learnt(what: str, learn: Callable[..., ScoreFunction], frames: Sequence, observation: object) -> ScoreFunction:
    """The score that a plug-in makes of a scene, its values checked."""
    score = call_plugin(what, learn, frames, observation)
    if not callable(score):
        raise InputError(f"{what}: gave a {type(score).__name__}, having learnt; allowed: a function of the returns")
    return partial(_scored, what, score)


def _scored(what: str, score: ScoreFunction, returns: VehicleReturns) -> np.ndarray:
    """The values of a plug-in, checked."""
    values = call_plugin(what, score, returns)
    with faults_in_one_line(what):
        values = np.asarray(values)
    if values.dtype.kind not in "fiub":
        raise InputError(f"{what}: gave {values.dtype} values; allowed: numbers")
    if values.shape != (len(returns),) or not np.isfinite(values).all():
        allowed = f"({len(returns)},), one finite number for each vehicle"
        given = f"shape {values.shape}" if values.shape != (len(returns),) else "what is not finite"
        raise InputError(f"{what}: gave {given}; allowed: {allowed}")
    return values.astype(float)
