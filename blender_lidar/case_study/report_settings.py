"""The report's section on what the paper leaves unstated, one setting at a time."""

from __future__ import annotations

from collections.abc import Mapping

from .published import SENSORS
from .sensitivity import setting_of
from .verdicts import low_to_high


def settings_section(result: Mapping) -> list[str]:
    """The section as lines of Markdown."""
    lines = [
        "## What the paper leaves unstated",
        "",
        "Optimum and gain over the baseline under the same setting, one setting changed at a time.",
        "",
        "| setting | changed to | " + " | ".join(SENSORS) + " |",
        "|---|---|" + "---|" * len(SENSORS),
    ]
    cells: dict[tuple[str, str], dict[str, str]] = {}
    notes = []
    for row in result["sensitivity"]:
        cells.setdefault(setting_of(row), {})[row["sensor"]] = _optimum_cell(row)
        if row["note"]:
            notes.append(f"- {row['what']} {row['value']}, {row['sensor']}: not possible here: {row['note']}")
    lines += [
        f"| {what} | {value} | " + " | ".join(of.get(sensor, "") for sensor in SENSORS) + " |"
        for (what, value), of in cells.items()
    ]
    kept = [order for order in result["sensitivity_orders"] if order["tilts_fall"]]
    of_all = len(result["sensitivity_orders"])
    said = (
        f"Tilts fall strictly with the number of beams under {len(kept)} of the {of_all} settings common to all three."
    )
    return [*lines, "", said, *_holding(result), *([""] if notes else []), *notes]


def _holding(result):
    """Under which settings the interval of a sensor's tilt holds the paper's value."""
    lines = ["", "The paper's tilt lies within the 90 % interval of ours:", ""]
    for sensor, of in result["sensors"].items():
        rows = [row for row in result["sensitivity"] if row["sensor"] == sensor and row["tilt_low_deg"] is not None]
        tilt = of["published"]["tilt_deg"]
        held = [row for row in rows if row["tilt_low_deg"] <= tilt <= row["tilt_high_deg"]]
        named = "; ".join(
            f"{' '.join(setting_of(row)).strip()} ({low_to_high((row['tilt_low_deg'], row['tilt_high_deg']), 0)})"
            for row in held
        )
        lines.append(f"- {sensor}, {tilt:.0f} degrees: {named or 'under none of them'}")
    return lines


def _optimum_cell(row):
    if row["note"]:
        return "—"
    return f"{row['height_m']:.1f} m, {row['tilt_deg']:.0f}°, {row['gain_bits']:+.3f}"
