"""What a run found as tables of texts: mountings, poles and recordings side by side, and groups of vehicles.

The terminal and the page print the same tables. `result` is everywhere the content of result.json.
"""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import zip_longest

from ..metrics.catalogue import DETECTABLE, metric_named
from ..scene.mounting import ANGLES, COORDINATE_NAMES, LEANS
from ..traffic.vehicles import counted
from .summary import (
    each_lidar,
    errors_text,
    frames_word,
    judged,
    judged_hung,
    layout_frames,
    leans,
    measured,
    mounting_name,
    percent,
    share_texts,
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
    """Candidate poles, the mountings side by side, what LiDARs add, and recordings alone, as far as a run has them."""
    tables = (poles_table(result), comparison_table(result), *layout_tables(result), recordings_table(result))
    return [table for table in tables if table is not None]


def comparison_table(result: Mapping) -> TextTable:
    """The mountings of a run side by side: the baseline and the run's own."""
    compared = {"baseline": result["baseline"], mounting_name(result): result}
    sections = [(name, _mounting_rows(one)) for name, one in each_lidar(result).items()]
    sections += _score_sections(result, list(compared.values()))
    *others, last = compared
    head = [("Mounting", 1), *((name, 1) for name in compared)]
    return TextTable(f"{', '.join(others).capitalize()} and {last} mounting", [head], sections)


def _mounting_rows(result):
    """Where a LiDAR hangs in each of the mountings that are compared."""
    mounts = [one["deployment"] for one in (result["baseline"], result)]
    shown = COORDINATE_NAMES.keys() - (ANGLES if leans(result) else LEANS)
    always = ("height_m", "lean_deg" if leans(result) else "tilt_x_deg")
    return [
        (f"{name} [{unit}]", *("-" if mount[key] is None else f"{mount[key]:.2f}" for mount in mounts))
        for key, (name, unit) in COORDINATE_NAMES.items()
        if key in shown and (key in always or any(mount[key] for mount in mounts))
    ]


def layout_tables(result: Mapping) -> list[TextTable]:
    """What each of several LiDARs adds, and what each number of them comes to; none of a single LiDAR."""
    if not (layout := result.get("layout")):
        return []
    metric, on = metric_named(result["metric"]), f"on {layout_frames(result)} frames"
    unit = "objective %" if metric.of_share else metric.unit or "objective"
    columns = _head("", "price", "detectable [%]", "90 %", "points", "90 %", unit, "90 %", "shown")

    def row(what: str, price: float | None, scores: Mapping, gain: Mapping | None) -> tuple[str, ...]:
        cells = [what, "" if price is None else f"{price:g}", *share_texts(scores)]
        if gain is None:
            return (*cells, *[""] * 5)
        cells += measured(DETECTABLE, gain["share_gain"], gain["share_gain_interval_90"], "+")
        cells += measured(metric, gain["objective_gain"], ends := gain["interval_90"], "+")
        return (*cells, _YES[ends[0] > 0.0] if ends else "")

    lidars = zip(result["lidars"], layout["parts"], strict=True)
    parts = [row(f"{of['name']}, {of['sensor']}", of["price"], one["alone"], one["without"]) for of, one in lidars]
    steps = [
        row(f"{one['lidars']}: {'+ ' * bool(one['gain'])}{', '.join(one['added'])}", one["price"], one, one["gain"])
        for one in layout["steps"]
    ]
    by = [
        (f"{one['lidars']} or more", "", *measured(DETECTABLE, one["share"], one["interval_90"]), *[""] * 5)
        for one in layout["covered_by"]
    ]
    adds = [("LiDAR", 2), ("alone", 2), ("the layout gains by it", 5)]
    goes = [("LiDARs, and which is added", 2), ("of the boxes", 2), ("gain of the step", 5)]
    return [
        TextTable(f"What each LiDAR adds, {on}", [adds, columns], [("", parts)]),
        TextTable(f"From one LiDAR to all, {on}", [goes, columns], [("", steps), ("By so many LiDARs themselves", by)]),
    ]


def _score_sections(result, compared):
    """Scores on the searched frames and on the held-out ones, and as hung on those that judge."""
    sections = [(f"{frames_word(result).capitalize()} frames", _score_rows(result, compared))]
    if result["holdout"]:
        held = [scores["holdout"] for scores in compared]
        blocks = f", {counted(held[-1]['blocks'], 'block')} of time"
        sections.append((f"Held-out frames{blocks}", _score_rows(result, held)))
    if result.get("cross_fitted"):
        crossed = [result["cross_fitted"][name] for name in ("baseline", "optimised")]
        blocks = counted(crossed[0]["blocks"], "block")
        sections.append((f"Each block of time judged without it, {blocks}", _score_rows(result, crossed)))
    if not errors_text(result):
        return sections
    sections = [(f"{heading}, exactly as planned", rows) for heading, rows in sections]
    after, before, on = judged_hung(result)
    return [*sections, (f"As hung, on {on}", _hung_rows(result, before, after))]


def _hung_rows(result, before, after):
    """Scores of both mountings as hung, under the same errors."""
    metric, hung = metric_named(result["metric"]), [before["as_hung"], after["as_hung"]]
    rows = _with_interval("detectable share [%]", map(share_texts, (before, after)))
    low = ["" if one["nine_of_ten"] is None else DETECTABLE.number(one["nine_of_ten"], -1) for one in hung]
    rows += [("nine of ten installations reach [%]", *low)] * any(low)
    keys = "detectable_share_gain", "detectable_share_gain_interval_90"
    rows += _with_interval("gain [percentage points]", [("", ""), measured(DETECTABLE, *(after[k] for k in keys), "+")])
    for what, key in (
        ("a degree off in one tilt, at worst [%]", "worst_degree"),
        ("10 cm off, at worst [%]", "worst_10_cm"),
    ):
        rows.append((what, "", DETECTABLE.number(after[key], -1)))
    values = (metric.number(one["objective_per_vehicle"], -1) for one in hung)
    rows.append((metric.in_unit("objective per vehicle"), *values))
    return rows + _gain_rows(metric, [after])


def _gain_rows(metric, others):
    """Gains in the objective per vehicle over the baseline, and their intervals."""
    gain = f"gain{metric.per_vehicle}"
    gain = f"{gain} [percentage points of the objective]" if metric.of_share else metric.in_unit(gain)
    gains = (measured(metric, each["gain_over_baseline"], each["interval_90"], "+") for each in others)
    return _with_interval(gain, [("", ""), *gains])


def _score_rows(result, compared):
    """Scores of each mounting, as far as there are any; the first is the baseline, which gains nothing over itself."""
    metric, others = metric_named(result["metric"]), compared[1:]
    rows = [(what, *(f"{each[key]:,}" for each in compared)) for what, key in _COUNTS.items()]
    rows += _with_interval("detectable share [%]", map(share_texts, compared))
    keys = "detectable_share_gain", "detectable_share_gain_interval_90"
    gains = (measured(DETECTABLE, *(each[key] for key in keys), "+") for each in others)
    rows += _with_interval("gain [percentage points]", [("", ""), *gains])
    if "objective" in compared[0] and not metric.of_share:
        rows.append((metric.in_unit("objective"), *(metric.number(each["objective"], -2) for each in compared)))
    values = (metric.number(each["objective_per_vehicle"], -1) for each in compared)
    rows.append((metric.in_unit("objective per vehicle"), *values))
    return rows + (_gain_rows(metric, others) if "gain_over_baseline" in compared[0] else [])


_COUNTS = {"boxes (a vehicle in a frame)": "boxes", "different vehicles": "distinct_vehicles"}


def _with_interval(what, measured_texts):
    """A row of numbers, and one of their intervals where there are any."""
    numbers, within = zip(*measured_texts, strict=True)
    return [(what, *numbers)] + [(f"90 % interval, {what.split(' [')[0]}", *within)] * any(within)


def group_tables(result: Mapping) -> list[TextTable]:
    """Detectable share and objective per vehicle by distance, lane, class and zone: `groups` of result.json as tables.

    Before is the baseline, after the run's mounting, on the frames that judge it; "-" stands for a group that does not
    count in the objective.
    """
    metric, on = metric_named(result["metric"]), judged(result)[2]
    unit = "objective %" if metric.of_share else metric.unit or "objective"
    measures = [("", 3), ("detectable [%]", 6), (unit, 2)]
    columns = ["boxes", "vehicles", "before", "90 %", "after", "90 %", "points", "90 %", "before", "after"]
    tables = []
    for by in dict.fromkeys(group["by"] for group in result["groups"]):
        rows = []
        for group in result["groups"]:
            if group["by"] != by:
                continue
            cells = [f"{group[key]:,}" for key in _COUNTS.values()]
            for key, sign in (("before", "-"), ("after", "-"), ("gain", "+")):
                cells += measured(DETECTABLE, group[key], group[f"{key}_interval_90"], sign)
            means = group["objective_before"], group["objective_after"]
            cells += ["-" if mean is None else metric.number(mean, -1) for mean in means]
            rows.append((group["name"], *cells))
        head = [measures, [(f"by {by}", 1), *((text, 1) for text in columns)]]
        tables.append(TextTable(f"By {by}, on {on}", head, [("", rows)]))
    return tables


def poles_table(result: Mapping) -> TextTable | None:
    """Candidate poles side by side, the best first; None where the scene has none."""
    poles = result.get("poles")
    if not poles:
        return None
    metric, held = metric_named(result["metric"]), poles[0]["holdout"] is not None
    rows = []
    for pole in poles:
        scores = pole["holdout"] or pole
        cells = [f"{pole['height_on_pole_m']:.2f}", metric.number(pole["objective_per_vehicle_as_hung"], -1)]
        cells.append(_hung_percent(scores["as_hung"]) if held else percent(scores))
        if held:
            ends, apart = scores["interval_90"], scores["differs"]
            difference, within = measured(metric, scores["difference_to_best"], ends, "+")
            cells += [difference if pole["rank"] > 1 else "", within, _YES[apart]]
        cells += ["" if pole["cost"] is None else f"{pole['cost']:g}", _YES[pole["existing"]]]
        rows.append((pole["name"], *cells))
    judged_on, hung = (
        "held-out frames" if held else f"{frames_word(result)} frames",
        ", as hung" * bool(errors_text(result)),
    )
    head = ["pole, best first", "height on it [m]", metric.in_unit(f"objective{hung}, searched frames")]
    head.append(f"detectable{hung * held}")
    head += ["difference", "90 %, all together", "differs"] * held + ["cost", "existing"]
    return TextTable(f"Candidate poles, on {judged_on}", [_head(*head)], [("", rows)])


def _hung_percent(hung):
    """The detectable share as hung in per cent, with its interval where it has one."""
    return percent({**hung, "detectable_share_interval_90": hung["interval_90"]})


def _head(*texts):
    return [(text, 1) for text in texts]


_YES = {None: "", True: "yes", False: "no"}


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
            rows.append((one["name"], f"{one['weight']:g}", "nothing held out", *[""] * (9 if held else 3)))
            continue
        shares = [share_texts(side) for side in (before, scores)]
        if held:
            gain = measured(DETECTABLE, *(scores[f"detectable_share_gain{end}"] for end in ("", "_interval_90")), "+")
            shares.append(gain)
        cells = [text for pair in shares for text in (pair if held else pair[:1])]
        cells += [metric.number(side["objective_per_vehicle"], -1) for side in (before, scores)]
        if held:
            cells += measured(metric, scores["gain_over_baseline"], scores["interval_90"], "+")
        rows.append((one["name"], f"{one['weight']:g}", *cells))
    measures = [("detectable [%]", 6 if held else 2), (metric.in_unit("objective per vehicle"), 4 if held else 2)]
    sides = ["before", "90 %", "after", "90 %", "points", "90 %", "before", "after", "gain", "90 %"]
    sides = sides if held else ["before", "after"] * 2
    head = [[("", 1), ("", 1), *measures], [(text, 1) for text in ("recording", "weight", *sides)]]
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
