"""The report as text: a section for each thing that was varied, a line for each finding."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence

from ..metrics.catalogue import metric_named
from .findings import RULE, UNDECIDED, VERDICTS, worst
from .variations import CASTERS, METRIC, MOUNTING, SEARCH, SECTIONS, SENSOR, TRAFFIC

HEADINGS = {
    TRAFFIC: "Traffic",
    MOUNTING: "Mounting tolerance",
    METRIC: "Metric",
    SENSOR: "Sensor",
    SEARCH: "Search",
    CASTERS: "Casters, against the float64 oracle",
}
_WIDTH = 120


def report_text(result: Mapping) -> str:
    """What `study_stability` came to, for a terminal."""
    parts = [line for text in _head(result) for line in textwrap.wrap(text, _WIDTH, subsequent_indent="  ")] + [""]
    for section in SECTIONS:
        findings = _of(result, section)
        if findings:
            parts += [HEADINGS[section], *_lines(findings), ""]
    return "\n".join([*parts, *_verdicts(result)])


def report_markdown(result: Mapping, pictures: Sequence[str]) -> str:
    """The same as a page of Markdown, with the pictures."""
    parts = ["# How stable is this answer?", "", *(f"- {line}" for line in _head(result)), ""]
    parts += [f"![{name.removesuffix('.png').replace('_', ' ')}]({name})" for name in pictures]
    for section in SECTIONS:
        findings = _of(result, section)
        if findings:
            parts += ["", f"## {HEADINGS[section]}", "", "| what | to what | verdict | found |", "|---|---|---|---|"]
            parts += [f"| {one['what']} | {one['value']} | {one['verdict']} | {one['text']} |" for one in findings]
    return "\n".join([*parts, "", *(f"- {line}" for line in _verdicts(result)), ""])


def table_rows(result: Mapping) -> list[dict[str, object]]:
    """One row for each finding, for CSV."""
    keys = ("section", "what", "value", "verdict", "text")
    return [{key: one[key] for key in keys} | {"loss": one["numbers"].get("loss", "")} for one in result["findings"]]


def _of(result: Mapping, section: str) -> list[Mapping]:
    return [finding for finding in result["findings"] if finding["section"] == section]


def _head(result: Mapping) -> list[str]:
    metric, mount = metric_named(result["metric"]), result["mounting"]
    search = f"found by {result['search']}, seed {result['seed']}, to hang as planned"
    origin = "as given" if result["mounting_given"] else search
    if not result["mounting_given"] and result["answered_frames"] < result["frames"]:
        origin += f", on {result['answered_frames']} of them"
    best, base = metric.number(result["objective_per_vehicle"]), metric.number(result["baseline_per_vehicle"])
    return [
        f"{result['sensor']}, {result['frames']} frames, {result['vehicles']:,} vehicle observations, "
        f"{result['caster']}, detail {result['detail']}",
        f"Mounting in question, {origin}: {mount['height_m']:.2f} m, {mount['tilt_x_deg']:.1f} deg across the road"
        f"{_others(mount, result['baseline'])}; "
        f"{metric.in_unit('objective')} per vehicle {best}, baseline {base}",
        f"Each change has its own best height and tilt, the other coordinates staying, on {result['varied_frames']} of "
        f"the searched frames; losses to it are on the {result['judged_frames']} {_JUDGED[result['judged_on']]}, and "
        "are to be read against the line 'as the scene has it'; inside or outside: of where other traffic of this kind "
        "puts the optimum of the scene as it is",
        f"Verdicts - {RULE}",
    ]


def _others(mount: Mapping, baseline: Mapping) -> str:
    """The other coordinates, where they are not the baseline's; candidates share them with the mounting."""
    names = {"x_m": "x {:.2f} m", "y_m": "y {:.2f} m", "tilt_y_deg": "{:.1f} deg along it", "yaw_deg": "yaw {:.1f} deg"}
    return "".join(f", {text.format(mount[key])}" for key, text in names.items() if mount[key] != baseline[key])


_JUDGED = {
    "held out": "held-out frames, with 90 % intervals",
    "searched": "same frames, as nothing is held out, and so without intervals",
}


def _lines(findings: Sequence[Mapping]) -> list[str]:
    width = max(len(_name(one)) for one in findings) + 2
    lines = []
    for one in findings:
        start = f"  {one['verdict']:<10}{_name(one):<{width}}"
        wrapped = textwrap.wrap(one["text"], _WIDTH - 12 - width) or [""]
        lines += [start + wrapped[0], *(" " * (12 + width) + more for more in wrapped[1:])]
    return lines


def _name(finding: Mapping) -> str:
    return f"{finding['what']}, {finding['value']}" if finding["value"] else finding["what"]


def _verdicts(result: Mapping) -> list[str]:
    lines = []
    for section in SECTIONS:
        verdicts = [one["verdict"] for one in _of(result, section)]
        if verdicts:
            counts = ", ".join(f"{verdicts.count(verdict)} {verdict}" for verdict in VERDICTS if verdict in verdicts)
            gravest = worst(verdicts)
            overall = gravest if gravest == UNDECIDED else f"at worst {gravest}"
            lines.append(f"{HEADINGS[section]}: {overall} ({counts})")
    return lines
