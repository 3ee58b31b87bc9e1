"""Every metric by name: what `[objective] metric` and `--metric` may say."""

from __future__ import annotations

from functools import partial

from ..errors import unknown_name
from . import scene_metrics as scene
from . import vehicle_metrics as vehicle
from .metric import NEEDS_DISTANCE, NEEDS_POINTS, NEEDS_VIEW, Metric, SceneContext

_HIT = "of its top, side and front the beams hit"
_IN_VOXELS = f"what share of the voxels of {vehicle.OCCUPANCY_VOXEL_M} m in its box hold a return"
_BEAMS = "how many beams return from it"


def _of_vehicle(name, label, unit, score, tells, decimals=3, *, needs=(), higher_is_better=True) -> Metric:
    return Metric(name, label, unit, higher_is_better, score, frozenset(needs), tells=tells, decimals=decimals)


_of_points = partial(_of_vehicle, needs=[NEEDS_POINTS])


def _voxel_entropy(voxel_m: float) -> Metric:
    score = partial(vehicle.voxel_entropy, voxel_m=voxel_m)
    tells = f"how evenly its returns spread over voxels of {voxel_m} m"
    return _of_points(f"voxel-entropy-{voxel_m}", f"voxel entropy ({voxel_m} m)", "bits", score, tells)


def _of_scene(name, label, unit, values, tells, decimals, *, prepare=scene.Road, higher_is_better=True) -> Metric:
    learn = partial(scene.SceneScore, prepare=prepare, values=values)
    needs = frozenset({NEEDS_VIEW})
    return Metric(name, label, unit, higher_is_better, None, needs, learn, tells, decimals, of_scene=True)


def _itself(context: SceneContext) -> SceneContext:
    return context


_of_ground = partial(_of_scene, prepare=_itself)

PE_VGOP = _of_vehicle("pe-vgop", "PE-VGOP", "bits", vehicle.view_entropy, f"how much {_HIT}")
VIEW_COVERAGE = _of_points("view-coverage", "view coverage", "", vehicle.view_coverage, f"how much {_HIT}, from 0 to 1")
_VIEWS = "sum of the views' occupancies"
_SURE, _UNSURE = "how certain the voxels of the road are", "how uncertain the voxels of the road are"
_ALL = (
    PE_VGOP,
    VIEW_COVERAGE,
    _of_vehicle("sum-of-views", _VIEWS, "", vehicle.sum_of_views, f"what shares {_HIT}", 4),
    _of_vehicle("points", "number of returns", "points", vehicle.points, _BEAMS, 1),
    _of_vehicle("log-points", "ln(1 + returns)", "", vehicle.log_points, f"{_BEAMS}, on a logarithmic scale"),
    _of_vehicle(
        *("areal-density", "areal density", "points/m²", vehicle.areal_density),
        f"{_BEAMS} for each square metre of its footprint",
    ),
    _of_vehicle(
        *("volumetric-density", "volumetric density", "points/m³", vehicle.volumetric_density),
        f"{_BEAMS} for each cubic metre of its box",
    ),
    _voxel_entropy(0.1),
    _voxel_entropy(0.2),
    _of_points("voxel-occupancy", "share of occupied voxels", "", vehicle.voxel_occupancy, _IN_VOXELS, 5),
    _of_points(
        *("voxel-occupancy-entropy", "voxel occupancy entropy", "bits", vehicle.voxel_occupancy_entropy),
        f"{_IN_VOXELS}, turned into an entropy",
        4,
    ),
    _of_vehicle(
        *("ap-entropy", "entropy of the position", "nats", vehicle.ap_entropy),
        "how uncertain a detector is expected to leave its position",
        higher_is_better=False,
    ),
    _of_vehicle(
        *("distance", "distance", "m", vehicle.distance, "how far from the LiDAR it is, horizontally", 2),
        needs=[NEEDS_DISTANCE],
        higher_is_better=False,
    ),
    _of_scene("s-mig", "S-MIG", "nats", scene.s_mig, f"{_SURE}, together, that beams cross", 1),
    _of_scene(
        *("covered-entropy", "entropy of covered voxels", "nats", scene.covered_entropy),
        f"{_UNSURE}, together, that beams cross",
        1,
    ),
    _of_scene("m-sog", "M-SOG", "nats", scene.m_sog, f"{_SURE}, in the mean, that beams cross", 4),
    _of_scene(
        *("expected-visibility", "expected visibility", "voxels", scene.visible_voxels),
        "how many occupied voxels beams can be expected to meet",
        1,
    ),
    _of_ground(
        *("ground-density", "density of ground returns", "points/m²", scene.density_on_ground),
        "how densely beams sample the empty road",
        3,
    ),
    _of_ground(
        *("ground-nuc", "non-uniformity of ground returns (NUC)", "", scene.nuc_on_ground),
        "how unevenly beams sample the empty road",
        3,
        higher_is_better=False,
    ),
)
METRICS: dict[str, Metric] = {metric.name: metric for metric in _ALL}


def metric_named(name: str, where: str = "") -> Metric:
    """The metric of that name.

    Raises
    ------
    InputError
        When there is none, with the nearest name; `where` says where the name came from.
    """
    if name not in METRICS:
        raise unknown_name(name, METRICS, "metric", where)
    return METRICS[name]
