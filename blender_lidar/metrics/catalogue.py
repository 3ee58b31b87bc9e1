"""Every metric by name: what `[objective] metric` and `--metric` may say."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from ..errors import InputError, unknown_name
from ..plugins import IN_A_FILE, call_plugin, faults_in_one_line, is_plugin, load_plugin
from . import vehicle_metrics as vehicle
from .metric import NEEDS_DETECTABLE, NEEDS_DISTANCE, NEEDS_POINTS, Metric, SceneContext, ScoreFunction, VehicleReturns

# --- What each tells of a vehicle, to end a sentence ------------------------------------------------------------------

_HIT = "of its top, side and front the beams hit"
_BEAMS = "how many beams return from it"
_PER_AREA, _PER_VOLUME = f"{_BEAMS} for each square metre of its footprint", f"{_BEAMS} for each cubic metre of its box"
_IN_VOXELS = f"what share of the voxels of {vehicle.OCCUPANCY_VOXEL_M} m in its box hold a return"
_AS_ENTROPY = f"{_IN_VOXELS}, turned into an entropy"
_UNSURE_PLACE = "how uncertain a detector is expected to leave its position"
_AWAY = "how far from the LiDAR it is, horizontally"

# --- The metrics ------------------------------------------------------------------------------------------------------


def _of_vehicle(name, label, unit, score, tells, decimals=3, *, needs=(), lower_is_better=False) -> Metric:
    return Metric(name, label, unit, not lower_is_better, score, frozenset(needs), tells=tells, decimals=decimals)


_of_points = partial(_of_vehicle, needs=[NEEDS_POINTS])


def _voxel_entropy(voxel_m: float) -> Metric:
    score = partial(vehicle.voxel_entropy, voxel_m=voxel_m)
    tells = f"how evenly its returns spread over voxels of {voxel_m} m"
    return _of_points(f"voxel-entropy-{voxel_m}", f"voxel entropy ({voxel_m} m)", "bits", score, tells)


_ENOUGH = f"whether enough {_HIT} to reach the threshold; PE-VGOP breaks ties"
_VIEWS = "sum of the views' occupancies"
PE_VGOP = _of_vehicle("pe-vgop", "PE-VGOP", "bits", vehicle.view_entropy, f"how much {_HIT}")
VIEW_COVERAGE = _of_points("view-coverage", "view coverage", "", vehicle.view_coverage, f"how much {_HIT}, from 0 to 1")
_ENOUGH_SEEN = _of_vehicle(
    "detectable", "detectable share", "", vehicle.detectable_share, _ENOUGH, 1, needs=[NEEDS_DETECTABLE]
)
DETECTABLE = replace(_ENOUGH_SEEN, of_share=True)
_ALL = (
    PE_VGOP,
    DETECTABLE,
    VIEW_COVERAGE,
    _of_vehicle("sum-of-views", _VIEWS, "", vehicle.sum_of_views, f"what shares {_HIT}", 4),
    _of_vehicle("points", "number of returns", "points", vehicle.points, _BEAMS, 1),
    _of_vehicle("log-points", "ln(1 + returns)", "", vehicle.log_points, f"{_BEAMS}, on a logarithmic scale"),
    _of_vehicle("areal-density", "areal density", "points/m²", vehicle.areal_density, _PER_AREA),
    _of_vehicle("volumetric-density", "volumetric density", "points/m³", vehicle.volumetric_density, _PER_VOLUME),
    _voxel_entropy(0.1),
    _voxel_entropy(0.2),
    _of_points("voxel-occupancy", "share of occupied voxels", "", vehicle.voxel_occupancy, _IN_VOXELS, 5),
    _of_points(
        "voxel-occupancy-entropy", "voxel occupancy entropy", "bits", vehicle.voxel_occupancy_entropy, _AS_ENTROPY, 4
    ),
    _of_vehicle(
        "ap-entropy", "entropy of the position", "nats", vehicle.ap_entropy, _UNSURE_PLACE, lower_is_better=True
    ),
    _of_vehicle("distance", "distance", "m", vehicle.distance, _AWAY, 2, needs=[NEEDS_DISTANCE], lower_is_better=True),
)
METRICS: dict[str, Metric] = {metric.name: metric for metric in _ALL}


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


def _learnt(what: str, learn: Callable[[SceneContext], ScoreFunction], context: SceneContext) -> ScoreFunction:
    """The score that a plug-in makes of a scene, its values checked."""
    score = call_plugin(what, learn, context)
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
