"""The case study's tables, as columns for CSV."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from .sensitivity import COLUMNS

NOTHING = ""  # what a CSV holds where there is no value


def table2_rows(result: Mapping) -> list[dict]:
    """Our Table II beside the paper's, with the paper's Table III beside the metric's detectable share."""
    return [_table2_row(sensor, of) for sensor, of in result["sensors"].items()]


def fig9_rows(result: Mapping) -> list[dict]:
    """Fig. 9 by sensor, band and measure, then what height, tilt and spacing make of RS-80's change."""
    return [
        {
            **{key: row[key] for key in ("sensor", "band", "measure", "vehicles", "blocks", "baseline", "optimised")},
            **_interval("change", row["change"]),
        }
        for row in result["fig9"]
    ]


def spacing_rows(result: Mapping) -> list[dict]:
    """The decomposition, one row for each band, measure and effect."""
    return [
        {
            "band": row["band"],
            "measure": row["measure"],
            "vehicles": row["vehicles"],
            "effect": effect,
            **_interval("mean", found),
        }
        for row in result["spacing"]
        for effect, found in row.items()
        if isinstance(found, Mapping)
    ]


def sensitivity_rows(result: Mapping) -> list[dict]:
    """Each setting that the paper leaves unstated, varied alone."""
    return [{key: _cell(row[key]) for key in COLUMNS} for row in result["sensitivity"]]


def as_table(rows: Sequence[Mapping]) -> tuple[list[str], list[list]]:
    """Header and rows for `formats.tables.to_csv`; floats so that reading gives them back."""
    header = list(rows[0])
    return header, [[repr(row[key]) if isinstance(row[key], float) else row[key] for key in header] for row in rows]


def _table2_row(sensor: str, of: Mapping) -> dict:
    published, search = of["published"], of["de_pso"]
    near = of["near_best"][0]
    row = {
        "sensor": sensor,
        "paper_height_m": published["height_m"],
        "paper_tilt_deg": published["tilt_deg"],
        "height_m": of["height_m"],
        "height_low_m": _end(of["height_interval_90"], 0),
        "height_high_m": _end(of["height_interval_90"], 1),
        "tilt_deg": of["tilt_deg"],
        "tilt_low_deg": _end(of["tilt_interval_90"], 0),
        "tilt_high_deg": _end(of["tilt_interval_90"], 1),
        "de_pso_height_m": search["height_m"],
        "de_pso_tilt_deg": search["tilt_x_deg"],
        "de_pso_evaluations": search["evaluations"],
        "searched_baseline_bits": of["baseline_per_vehicle"],
        "searched_optimised_bits": of["objective_per_vehicle"],
        "searched_de_pso_bits": search["per_vehicle"],
        "near_best_points": near["points"],
        "near_best_share_of_grid": near["share_of_grid"],
        "near_best_height_low_m": near["height_m"][0],
        "near_best_height_high_m": near["height_m"][1],
        "near_best_tilt_low_deg": near["tilt_deg"][0],
        "near_best_tilt_high_deg": near["tilt_deg"][1],
        "wide_height_m": of["wide"]["height_m"],
        "wide_tilt_deg": of["wide"]["tilt_deg"],
    }
    names = {"baseline": "baseline", "grid": "optimised", "de_pso": "de_pso", "paper": "paper_mounting"}
    for name, ours in names.items():
        held = of["judged"][name]["holdout"] or {}
        row[f"heldout_{ours}_bits"] = held.get("objective_per_vehicle", NOTHING)
        row[f"heldout_{ours}_detectable"] = held.get("detectable_share", NOTHING)
        if name != "baseline":
            row[f"heldout_{ours}_gain_bits"] = held.get("gain_over_baseline", NOTHING)
            row[f"heldout_{ours}_gain_low_bits"] = _end(held.get("interval_90"), 0)
            row[f"heldout_{ours}_gain_high_bits"] = _end(held.get("interval_90"), 1)
    for confidence in ("01", "03"):
        before, after = published[f"recall_{confidence}"]
        row |= {f"paper_recall_{confidence}_baseline": before, f"paper_recall_{confidence}_optimised": after}
    return row


def _interval(name: str, found: Mapping) -> dict:
    return {name: found["mean"], "low": _end(found["interval_90"], 0), "high": _end(found["interval_90"], 1)}


def _end(interval: Sequence[float] | None, which: int) -> float | str:
    return NOTHING if interval is None else interval[which]


def _cell(value: object) -> object:
    return NOTHING if value is None else value
