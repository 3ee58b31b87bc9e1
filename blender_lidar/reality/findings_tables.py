"""The findings of a comparison with detectors as tables and as what JSON holds."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from .agreement import COMPARED, Against, Agreement
from .detections import Detector
from .detector_study import Findings
from .distance_shape import PERFORMANCE, Shape
from .ground_returns import WithoutGround
from .labelled import LabelledClouds
from .significance import Difference, Estimate

_DIGITS = 6
PAPER = {"frames": 3712, "vehicles": 14357, "seconds": 18.0}
"""Section IV: "using the PE-VGOP to evaluate 3,712 frames of data takes only 18 seconds"."""


def car_columns(findings: Findings) -> dict[str, np.ndarray]:
    """A row for each car."""
    judged, cars = findings.judged, findings.judged.cars
    columns = {"frame": cars.frame, "label_line": cars.boxes.label_line, **judged.about}
    columns |= {
        "class": cars.boxes.label,
        "distance_m": cars.boxes.distance_m,
        "occlusion": cars.boxes.occlusion,
        "truncation": cars.boxes.truncation,
        **dict(zip(("length_m", "width_m", "height_m"), cars.boxes.size_m.T, strict=True)),
        "bearing_deg": cars.bearing_deg,
        "points_in_box": cars.count,
        **dict(zip(("p_top", "p_side", "p_front"), cars.occupancy.T, strict=True)),
    }
    columns |= {metric.name: cars.scores[metric.name] for metric in findings.metrics}
    for detector in judged.detectors:
        columns[f"{detector.name}_in_range"] = detector.in_range
        columns[f"{detector.name}_performance"] = detector.performance
    return {
        name: np.round(values, _DIGITS) if np.asarray(values).dtype.kind == "f" else np.asarray(values)
        for name, values in columns.items()
    }


def correlation_table(findings: Findings) -> tuple[list[str], list[list[object]]]:
    """A header, and a row for each detector, set and metric; what is not known is empty."""
    rows = [_flat(one) for one in findings.agreements]
    header = list(dict.fromkeys(name for row in rows for name in row))
    return header, [[_cell(row.get(name)) for name in header] for row in rows]


def as_json(findings: Findings, clouds: LabelledClouds, about: Mapping[str, object]) -> dict:
    """Everything but the cars themselves; `about` says with what it was made."""
    judged = findings.judged
    return {
        **about,
        "layout": clouds.layout,
        "frames": findings.frames,
        "cars": len(judged),
        "cars_not_listed": judged.unlisted,
        "main_set": findings.main.name,
        "sets": {one.name: int(one.member.sum()) for one in findings.sets},
        "detectors": {one.name: _detector(one) for one in judged.detectors},
        "metrics": [
            {"name": one.name, "label": one.label, "unit": one.unit, "higher_is_better": one.higher_is_better}
            for one in findings.metrics
        ],
        "correlations": [_agreement(one) for one in findings.agreements],
        "by_distance": [_shape(one) for one in findings.shapes],
        "other_ground_clearance": {
            "ground_clearance_m": findings.other_clearance_m,
            "correlations": [_without_ground(one) for one in findings.without_ground],
        },
        "speed": speed(findings),
    }


def speed(findings: Findings) -> dict[str, dict[str, float]]:
    """Milliseconds of processor time a frame and a car of each stage, beside the paper's."""
    seconds, cars = findings.judged.cars.seconds, len(findings.judged) + findings.judged.unlisted
    whole = seconds["read"] + seconds["assign"]
    stages = {
        "read": seconds["read"],
        "assign": seconds["assign"],
        "pe_vgop": seconds["pe_vgop"],
        "all_metrics": seconds["all_metrics"],
        "file_to_pe_vgop": whole + seconds["pe_vgop"],
        "file_to_all_metrics": whole + seconds["all_metrics"],
    }
    found = {name: _each(spent, findings.frames, cars) for name, spent in stages.items()}
    return {**found, "paper": _each(PAPER["seconds"], PAPER["frames"], PAPER["vehicles"])}


def _each(seconds: float, frames: int, cars: int) -> dict[str, float]:
    return {"ms_per_frame": round(1e3 * seconds / frames, 4), "ms_per_car": round(1e3 * seconds / cars, 4)}


def _detector(one: Detector) -> dict:
    performance = one.performance[one.in_range]
    return {
        "in_range": len(performance),
        "missed": int((performance == 0.0).sum()),
        "mean_performance": _number(float(performance.mean())) if len(performance) else None,
    }


def _agreement(one: Agreement) -> dict:
    return {
        "detector": one.detector,
        "set": one.of_set,
        "metric": one.metric,
        "cars": one.cars,
        "resampled": {
            "unit": one.clusters.unit,
            "number": one.clusters.number,
            "intervals_too_narrow": one.clusters.too_narrow,
        },
        **{name: _estimate(estimate) for name, estimate in one.statistics.items()},
        **{
            name: {"groups": means.number, "pearson": _estimate(means.pearson), "spearman": _number(means.spearman)}
            for name, means in one.groups.items()
        },
        "less": {
            other: {name: _against(held) for name, held in by_statistic.items()}
            for other, by_statistic in one.against.items()
        },
    }


def _shape(one: Shape) -> dict:
    return {
        "quantity": one.quantity.replace(PERFORMANCE, "_performance"),
        "set": one.of_set,
        "bearing": one.bearing,
        "cars": one.cars,
        "clusters": one.clusters,
        "linear_r2": _number(one.linear),
        "logarithmic_r2": _number(one.logarithmic),
        "linear_less_logarithmic": _difference(one.lead),
    }


def _without_ground(one: WithoutGround) -> dict:
    return {
        "detector": one.detector,
        "set": one.of_set,
        "metric": one.metric,
        "spearman": _estimate(one.spearman),
        "pearson": _estimate(one.pearson),
        "spearman_change": _difference(one.change),
    }


def _estimate(one: Estimate) -> dict:
    return {"value": _number(one.value), "interval_90": _interval(one.low, one.high)}


def _difference(one: Difference) -> dict:
    return {"value": _number(one.value), "interval_90": _interval(one.low, one.high)}


def _against(one: Against) -> dict:
    return {
        **_difference(one.difference),
        "p_above": _number(one.difference.p_above),
        "p_above_holm": _number(one.p_holm),
    }


def _interval(low: float, high: float) -> list[float] | None:
    return [_number(low), _number(high)] if math.isfinite(low) else None


def _flat(one: Agreement) -> dict[str, object]:
    row: dict[str, object] = {"detector": one.detector, "set": one.of_set, "metric": one.metric, "cars": one.cars}
    row |= {"resampled": one.clusters.unit, "clusters": one.clusters.number}
    row["intervals_too_narrow"] = int(one.clusters.too_narrow)
    for name in COMPARED:
        row |= _ends(name, one.statistics[name])
    for by, means in one.groups.items():
        row |= {f"{by}_groups": means.number, **_ends(f"{by}_pearson", means.pearson), f"{by}_spearman": means.spearman}
    for other, by_statistic in one.against.items():
        for name, held in by_statistic.items():
            stem = f"{name}_less_{other}"
            row |= {stem: held.difference.value, f"{stem}_low": held.difference.low}
            row |= {f"{stem}_high": held.difference.high, f"{stem}_p_above": held.difference.p_above}
            row[f"{stem}_p_holm"] = held.p_holm
    return row


def _ends(name: str, one: Estimate) -> dict[str, float]:
    return {name: one.value, f"{name}_low": one.low, f"{name}_high": one.high}


def _cell(value: object) -> object:
    if isinstance(value, float):
        return round(value, _DIGITS) if math.isfinite(value) else ""
    return "" if value is None else value


def _number(value: float) -> float | None:
    return round(value, _DIGITS) + 0.0 if math.isfinite(value) else None
