"""Every metric by name: what `[objective] metric` and `--metric` may say."""

from __future__ import annotations

from ..errors import unknown_name
from .ap_entropy import AP_ENTROPY
from .metric import Metric
from .nearness import DISTANCE_METRIC
from .point_counts import AREAL_DENSITY, LOG_POINTS, POINTS, VOLUMETRIC_DENSITY
from .scene_metrics import COVERED_ENTROPY, EXPECTED_VISIBILITY, GROUND_DENSITY, GROUND_NUC, M_SOG, S_MIG
from .view_coverage import VIEW_COVERAGE
from .views import PE_VGOP, SUM_OF_VIEWS
from .voxels import VOXEL_ENTROPY_01, VOXEL_ENTROPY_02, VOXEL_OCCUPANCY, VOXEL_OCCUPANCY_ENTROPY

_ALL = (
    PE_VGOP,
    VIEW_COVERAGE,
    SUM_OF_VIEWS,
    POINTS,
    LOG_POINTS,
    AREAL_DENSITY,
    VOLUMETRIC_DENSITY,
    VOXEL_ENTROPY_01,
    VOXEL_ENTROPY_02,
    VOXEL_OCCUPANCY,
    VOXEL_OCCUPANCY_ENTROPY,
    AP_ENTROPY,
    DISTANCE_METRIC,
    S_MIG,
    COVERED_ENTROPY,
    M_SOG,
    EXPECTED_VISIBILITY,
    GROUND_DENSITY,
    GROUND_NUC,
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
