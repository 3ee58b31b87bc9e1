"""What an objective adds up, in words."""

from __future__ import annotations

from collections.abc import Mapping

from ..metrics.catalogue import metric_named
from ..metrics.views import PE_VGOP


def objective_text(result: Mapping) -> str:
    """What the objective of a run adds up; `result` is the content of result.json."""
    metric, loss = metric_named(result["metric"]), result["identity"]["[objective] loss"]
    if loss is not None and result["reading"] != "corrected":
        instead = "" if metric is PE_VGOP else f", with {_merit(metric)} in place of the entropy"
        return f"Eq. 10 of the paper as printed{instead}"
    if loss is None:
        if metric.of_scene:
            return f"{_merit(metric)}, of the scene of each frame, once for every vehicle in it"
        return f"{_merit(metric)} of every vehicle, detectable or not"
    unit = metric.unit.removesuffix("s") if abs(loss) == 1 else metric.unit
    return f"{_merit(metric)} of every detectable vehicle, less {f'{abs(loss):g} {unit}'.rstrip()} for every other one"


def _merit(metric):
    return f"{'' if metric.higher_is_better else 'minus '}the {metric.label}"
