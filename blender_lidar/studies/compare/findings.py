"""The findings of a comparison with detectors as tables and as what JSON holds."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from .cars import COLUMNS, KEYS
from .detections import IN_RANGE
from .detectors import COMPARED, GROUPED, PERFORMANCE, Findings
from .labelled import LabelledClouds
from .resampling import Against, Estimate

PAPER = {"frames": 3712, "vehicles": 14357, "seconds": 18.0}
"""Section IV: "using the PE-VGOP to evaluate 3,712 frames of data takes only 18 seconds"."""
_DIGITS = 6


def car_columns(findings: Findings) -> dict[str, np.ndarray]:
    """The table of cars: a row for each."""
    names = [*KEYS, *findings.about, *COLUMNS, *(metric.name for metric in findings.judged.metrics)]
    names += [name + ending for name in findings.judged.detectors for ending in (IN_RANGE, PERFORMANCE)]
    return {name: column.to_numpy() for name, column in findings.judged.table[names].round(_DIGITS).items()}


def correlation_table(findings: Findings) -> tuple[list[str], list[list[object]]]:
    """A header, and a row for each detector, set and metric; what is not known is empty."""
    rows = [_flat(row) for row in findings.agreements]
    header = list(dict.fromkeys(name for row in rows for name in row))
    return header, [[_cell(row.get(name, "")) for name in header] for row in rows]


def _flat(row: Mapping) -> dict[str, object]:
    """A row of `detectors.agreements` as cells."""
    cells = {key: row[key] for key in ("detector", "set", "metric", "cars")}
    cells |= {"resampled": row["resampled"]["unit"], "clusters": row["resampled"]["number"]}
    cells["intervals_too_narrow"] = int(row["resampled"]["intervals_too_narrow"])
    for name in COMPARED:
        cells |= _ends(name, row[name])
    for by in GROUPED:
        cells |= {f"{by}_groups": row[by]["groups"], **_ends(f"{by}_pearson", row[by]["pearson"])}
        cells[f"{by}_spearman"] = row[by]["spearman"]
    for other, held in row["less"].items():
        for name, against in held.items():
            stem = f"{name}_less_{other}"
            cells |= _ends(stem, against.difference)
            cells |= {f"{stem}_p_above": against.p_above, f"{stem}_p_holm": against.p_holm}
    return cells


def _ends(name: str, one: Estimate) -> dict[str, float]:
    return {name: one.value, f"{name}_low": one.low, f"{name}_high": one.high}


def _cell(value: object) -> object:
    if not isinstance(value, float):
        return value
    return round(value, _DIGITS) if math.isfinite(value) else ""


def as_json(findings: Findings, clouds: LabelledClouds, about: Mapping[str, object]) -> dict:
    """Everything but the cars themselves; `about` says with what it was made."""
    judged = findings.judged
    performance = {name: judged[name + PERFORMANCE][judged[name + IN_RANGE]] for name in judged.detectors}
    found = {
        "layout": clouds.layout,
        "frames": findings.frames,
        "cars": len(judged),
        "cars_not_listed": findings.unlisted,
        "main_set": findings.main,
        "sets": {name: int(member.sum()) for name, member in findings.sets.items()},
        "detectors": {
            name: {
                "in_range": len(values),
                "missed": int((values == 0.0).sum()),
                "mean_performance": float(values.mean()) if len(values) else None,
            }
            for name, values in performance.items()
        },
        "metrics": [
            {"name": one.name, "label": one.label, "unit": one.unit, "higher_is_better": one.higher_is_better}
            for one in judged.metrics
        ],
        "correlations": findings.agreements,
        "by_distance": findings.shapes,
        "other_ground_clearance": {
            "ground_clearance_m": findings.other_clearance_m,
            "correlations": findings.without_ground,
        },
        "speed": speed(findings),
    }
    return {**about, **_plain(found)}


def _plain(value: object) -> object:
    """What JSON holds: rounded numbers, None for NaN, and a value with its interval for an estimate."""
    if isinstance(value, Against):
        p_values = {"p_above": _plain(value.p_above), "p_above_holm": _plain(value.p_holm)}
        return {**_plain(value.difference), **p_values}
    if isinstance(value, Estimate):
        interval = [_plain(value.low), _plain(value.high)] if math.isfinite(value.low) else None
        return {"value": _plain(value.value), "interval_90": interval}
    if isinstance(value, dict):
        return {key: _plain(one) for key, one in value.items()}
    if isinstance(value, list):
        return [_plain(one) for one in value]
    if isinstance(value, float):
        return round(value, _DIGITS) + 0.0 if math.isfinite(value) else None
    return value


def speed(findings: Findings) -> dict[str, dict[str, float]]:
    """Milliseconds of processor time a frame and a car of each stage, beside the paper's."""
    frames, cars = findings.frames, len(findings.judged) + findings.unlisted
    read, assign, score, others = findings.seconds.values()
    spent = {
        "read": (read, frames, cars),
        "assign": (assign, frames, cars),
        "pe_vgop": (score, frames, cars),
        "all_metrics": (score + others, frames, cars),
        "file_to_pe_vgop": (read + assign + score, frames, cars),
        "file_to_all_metrics": (read + assign + score + others, frames, cars),
        "paper": (PAPER["seconds"], PAPER["frames"], PAPER["vehicles"]),
    }
    return {
        name: {"ms_per_frame": round(1e3 * seconds / frames, 4), "ms_per_car": round(1e3 * seconds / cars, 4)}
        for name, (seconds, frames, cars) in spent.items()
    }
