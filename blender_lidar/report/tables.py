"""What a run found as tables of texts: mountings, poles and recordings side by side, vehicles by distance and lane.

The terminal and the page print the same tables. `result` is everywhere the content of result.json.
"""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import zip_longest

import numpy as np

from ..metrics.catalogue import metric_named
from ..optimise import vehicle_score
from ..run.folder import RunFolder
from ..run.tolerance import tolerance_text
from ..run.vehicle_table import distance_bands, lanes, metric_values, vehicle_weight
from ..scene.mounting import ANGLES, COORDINATE_NAMES, LEANS
from .summary import (
    aim_text,
    frames_word,
    leans,
    mounting_name,
    percent,
    sharp_of,
    span,
)


@dataclass(frozen=True, slots=True)
class TextTable:
    """Numbers as texts, in columns under a head.

    Attributes
    ----------
    title : str
    head : list of lists of (str, int)
        Lines of headings, each with the number of columns that it stands over.
    sections : list of (str, list of tuples of str)
        A heading, "" for none, and rows: what, then a text for each column, "" where it has none.
    """

    title: str
    head: list[list[tuple[str, int]]]
    sections: list[tuple[str, list[tuple[str, ...]]]]


def score_tables(result: Mapping) -> list[TextTable]:
    """Candidate poles, the mountings side by side, and each of several recordings alone, as far as a run has them."""
    tables = (poles_table(result), comparison_table(result), recordings_table(result))
    return [table for table in tables if table is not None]


def comparison_table(result: Mapping) -> TextTable:
    """The mountings of a run side by side: the baseline, the sharp one where there is one, the run's own."""
    compared = {"baseline": result["baseline"], "sharp": sharp_of(result), mounting_name(result): result}
    compared = {name: scores for name, scores in compared.items() if scores is not None}
    mounts = [scores["deployment"] for scores in compared.values()]
    shown = COORDINATE_NAMES.keys() - (ANGLES if leans(result) else LEANS)
    always = ("height_m", "lean_deg" if leans(result) else "tilt_x_deg")
    mounting = [
        (f"{name} [{unit}]", *("-" if mount[key] is None else f"{mount[key]:.2f}" for mount in mounts))
        for key, (name, unit) in COORDINATE_NAMES.items()
        if key in shown and (key in always or any(mount[key] for mount in mounts))
    ]
    sections = [("", mounting), *_score_sections(result, list(compared.values()))]
    if (block := result.get("tolerance")) is not None:
        robust = [block["robust"][name] for name in ("baseline", "sharp", "optimised") if name in block["robust"]]
        over = f", {tolerance_text(block['settings'])}: {aim_text(block['settings'])}"
        sections += _score_sections(result, robust, over)
    *others, last = compared
    head = [("Mounting", 1), *((name, 1) for name in compared)]
    return TextTable(f"{', '.join(others).capitalize()} and {last} mounting", [head], sections)


def _score_sections(result, compared, over=""):
    """Scores on the searched frames and on the held-out ones; `over` names a tolerance that they are over."""
    sections = [(f"{frames_word(result).capitalize()} frames{over}", _score_rows(result, compared, over))]
    if result["holdout"]:
        held = [scores["holdout"] for scores in compared]
        sections.append((f"Held-out frames{over}", _score_rows(result, held, over)))
    return sections


def _score_rows(result, compared, over):
    """Scores of each mounting, as far as there are any; the first is the baseline, which gains nothing over itself."""
    metric, others = metric_named(result["metric"]), compared[1:]
    rows = []
    if "objective" in compared[0] and not over and not metric.of_share:
        rows.append((metric.in_unit("objective"), *(metric.number(each["objective"], -2) for each in compared)))
    values = (metric.number(each["objective_per_vehicle"], 1) for each in compared)
    rows.append((metric.in_unit("objective per vehicle"), *values))
    rows.append(("detectable share [%]", *(f"{100 * each['detectable_share']:.1f}" for each in compared)))
    if "gain_over_baseline" in compared[0]:
        gain = "gain over the baseline as planned" if over else f"gain{metric.per_vehicle}"
        gain = f"{gain} [percentage points]" if metric.of_share else metric.in_unit(gain)
        rows.append((gain, "", *(metric.number(each["gain_over_baseline"], 1, "+") for each in others)))
    if compared[-1].get("interval_90"):
        spans = (span(metric, each["interval_90"], 1, "+") for each in others)
        rows.append((f"90 % interval, {result['holdout']['blocks']} blocks", "", *spans))
    if over:
        kept = (each["gain_kept"] for each in others)
        rows.append(("gain kept [%]", "", *("-" if share is None else f"{100 * share:.1f}" for share in kept)))
    return rows


def group_tables(run: RunFolder) -> list[TextTable]:
    """Objective per vehicle and detectable share by distance and, where lanes are known, by lane: see `group_table`."""
    groups = {"distance": distance_bands} | ({"lane": lanes} if run.baseline["lane"].any() else {})
    return [group_table(name, function, run) for name, function in groups.items()]


def group_table(name: str, groups: Callable[[Mapping], list[tuple[str, np.ndarray]]], run: RunFolder) -> TextTable:
    """Objective per vehicle and detectable share of each group of vehicles, searched and held out, before and after.

    Before is the baseline, after the run's mounting; "-" stands where a group has no vehicle or the objective is the
    whole scene's.

    Parameters
    ----------
    name : str
        What vehicles are grouped by.
    groups : function
        Names groups of the rows of a vehicle table: `run.verdict.distance_bands` or `lanes`.
    """
    result, tables = run.result, (run.baseline, run.optimised)
    metric, loss = metric_named(result["metric"]), result["identity"]["[objective] loss"]
    scores = [
        vehicle_score(metric.merit(metric_values(table)), table["detectable"], loss, result["reading"])
        for table in tables
    ]
    weight, names = vehicle_weight(run.baseline), {"search": frames_word(result), "holdout": "held out"}
    splits = [split for split in names if (run.baseline["split"] == split).any()]
    rows = []
    for group, chosen in groups(run.optimised):
        cells = []
        for split in splits:
            of = chosen & (run.baseline["split"] == split)
            scored = weight[of].any()
            cells += [metric.number(np.average(score[of], weights=weight[of])) if scored else "-" for score in scores]
            cells += [f"{100 * table['detectable'][of].mean():.1f}" if of.any() else "-" for table in tables]
        rows.append((group, *cells, f"{chosen.sum():,}"))
    unit = "objective %" if metric.of_share else metric.unit or "objective"
    measures = [(unit, 2), ("detectable %", 2)]
    head = [
        [("", 1), *((names[split], 4) for split in splits), ("all frames", 1)],
        [("", 1), *measures * len(splits), ("", 1)],
        [(f"by {name}", 1), *[("before", 1), ("after", 1)] * 2 * len(splits), ("vehicles", 1)],
    ]
    return TextTable(f"By {name}", head, [("", rows)])


def poles_table(result: Mapping) -> TextTable | None:
    """Candidate poles side by side, the best first; None where the scene has none."""
    poles = result.get("poles")
    if not poles:
        return None
    metric, held = metric_named(result["metric"]), poles[0]["holdout"] is not None
    rows = []
    for pole in poles:
        scores = pole["holdout"] or pole
        cells = [f"{pole['height_on_pole_m']:.2f}", metric.number(scores["objective_per_vehicle"], 1), percent(scores)]
        if held:
            ends, apart = scores["interval_90"], scores["differs"]
            cells += [metric.number(scores["difference_to_best"], 1, "+") if pole["rank"] > 1 else ""]
            cells += ["" if ends is None else span(metric, ends, 1, "+"), {None: "", True: "yes", False: "no"}[apart]]
        cells += [
            "" if pole["cost"] is None else f"{pole['cost']:g}",
            {None: "", True: "yes", False: "no"}[pole["existing"]],
        ]
        rows.append((pole["name"], *cells))
    judged_on = "held-out frames" if held else f"{frames_word(result)} frames"
    head = ["pole, best first", "height on it [m]", metric.in_unit("objective per vehicle"), "detectable"]
    head += ["difference", "90 %, all together", "differs"] * held + ["cost", "existing"]
    return TextTable(f"Candidate poles, on {judged_on}", [[(text, 1) for text in head]], [("", rows)])


def recordings_table(result: Mapping) -> TextTable | None:
    """What a mounting is worth on each of several recordings; None where there is one."""
    recordings = result.get("recordings")
    if not recordings:
        return None
    metric, held = metric_named(result["metric"]), result["holdout"] is not None
    rows = []
    for one, base in zip(recordings, result["baseline"]["recordings"], strict=True):
        scores, before = (one["holdout"], base["holdout"]) if held else (one, base)
        if scores is None:
            rows.append((one["name"], f"{one['weight']:g}", "nothing held out", *[""] * (5 if held else 3)))
            continue
        cells = [metric.number(side["objective_per_vehicle"], 1) for side in (before, scores)]
        cells += [f"{100 * side['detectable_share']:.1f}" for side in (before, scores)]
        if held:
            cells.append(metric.number(scores["gain_over_baseline"], 1, "+"))
            cells.append("" if scores["interval_90"] is None else span(metric, scores["interval_90"], 1, "+"))
        rows.append((one["name"], f"{one['weight']:g}", *cells))
    measures = [(metric.in_unit("objective per vehicle"), 2), ("detectable [%]", 2)]
    sides = [("before", 1), ("after", 1)] * 2 + [(text, 1) for text in ("gain", "90 %")] * held
    head = [[("", 1), ("", 1), *measures, *[("", 1)] * (2 * held)], [("recording", 1), ("weight", 1), *sides]]
    return TextTable(
        f"Each recording alone, on {'held-out' if held else frames_word(result)} frames", head, [("", rows)]
    )


# --- Tables for a terminal, and for a page of Markdown ----------------------------------------------------------------

WIDTH = 120  # of texts for a terminal
_NARROWEST = 40  # of a table's last column, which is wrapped


def table_text(table: TextTable) -> str:
    """A table in columns: the first flush left, numbers flush right."""
    rows = [[cell for text, columns in line for cell in (text, *[""] * (columns - 1))] for line in table.head]
    for heading, lines in table.sections:
        rows += [[heading]] * bool(heading) + [[f"  {what}", *cells] for what, *cells in lines]
    widths = [max(map(len, column)) for column in zip_longest(*rows, fillvalue="")]
    padded = ([row[0].ljust(widths[0]), *map(str.rjust, row[1:], widths[1:])] for row in rows)
    return "\n".join("  ".join(cells).rstrip() for cells in padded)


def text_table(rows: Sequence[Sequence[str]]) -> list[str]:
    """Rows, the header first, in columns; the last column is wrapped to the width of a terminal."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)][:-1]
    indent = sum(widths) + 2 * len(widths)
    lines = []
    for *cells, last in rows:
        start = "".join(f"{cell:<{width}}  " for cell, width in zip(cells, widths, strict=True))
        found = textwrap.wrap(last, max(WIDTH - indent, _NARROWEST)) or [""]
        lines += [(start + found[0]).rstrip(), *(" " * indent + more for more in found[1:])]
    return lines


def markdown_table(rows: Iterable[Sequence[str]]) -> list[str]:
    """Rows, the header first, as a table of Markdown."""
    header, *rest = rows
    return [f"| {' | '.join(row)} |" for row in (header, ["---"] * len(header), *rest)]
