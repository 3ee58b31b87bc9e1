"""The report as text: the sentence, the fidelities, the casters, what was validated, and what the scene needs."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence

from .ablation_report import HEADER, ablation_cells, floor_line, needs
from .figures import number, percent, signed, with_interval
from .recommendation import milliseconds

_WIDTH = 120
_LADDER = ("fidelity", "one evaluation", "quartiles", "faster", "bias", "error", "of the gain", "tau", "regret", "")


def report_text(result: Mapping) -> str:
    """What `chart_study` came to, for a terminal: of the ladder only what is worth a line there."""
    rows = [row for row in result["rungs"] if _told(row, result)]
    parts = [
        *_wrapped(_head(result)),
        "",
        *_table(_LADDER, [_rung(row, result) for row in rows]),
        f"({len(result['rungs'])} fidelities; all of them are in chart.csv)",
        "",
        *_table(HEADER, [ablation_cells(row) for row in result["ablations"]]),
        "",
        *_wrapped([*floor_line(result), *needs(result)]),
        "",
        *_wrapped([*_hits(result), *_validated(result), *_paired(result), _asked(result), result["sentence"]]),
    ]
    return "\n".join(parts)


def report_markdown(result: Mapping, pictures: Sequence[str]) -> str:
    """The same as a page of Markdown, with every fidelity and the picture."""
    parts = ["# Speed against accuracy", "", f"**{result['sentence']}**", "", *(f"- {line}" for line in _head(result))]
    parts += ["", *(f"![Error over time]({name})" for name in pictures)]
    parts += ["", "## The ladder", "", *_markdown(_LADDER, [_rung(row, result) for row in result["rungs"]])]
    parts += [
        "",
        "## What the scene needs",
        "",
        *_markdown(HEADER, [ablation_cells(row) for row in result["ablations"]]),
        "",
        *(f"- {line}" for line in [*floor_line(result), *needs(result)]),
    ]
    parts += [
        "",
        "## Does it hold",
        "",
        *(f"- {line}" for line in [_asked(result), *_hits(result), *_validated(result), *_paired(result)]),
    ]
    return "\n".join([*parts, ""])


def _told(row: Mapping, result: Mapping) -> bool:
    return row["pareto"] or row["within"] or row["twin"] is not None or row["name"] == result["reference"]


def _head(result: Mapping) -> list[str]:
    unit = result["metric_unit"] or "1"
    judge = "judge" if result["judged_on"] == "held out" else "chose them, as none is held out"
    lines = [
        f"{result['sensor']}, range gate {result['range_gate_m']:g} m, {result['caster']}; {result['frames']} searched "
        f"frames in {result['blocks']} blocks choose, {result['judged_frames']} {result['judged_on']} ones in "
        f"{result['judged_blocks']} blocks judge; {result['mountings']} mountings of Sobol's sequence",
        f"Reference: {result['rungs'][0]['text']}; the best mounting gains {result['gain_per_vehicle']:.4f} {unit} per "
        f"vehicle over the baseline",
        f"Errors and biases are in {unit} per vehicle, errors after one affine calibration fitted on the other half of "
        "the mountings; tau weighs the best mountings most; regret is what choices on resampled traffic lose to the "
        f"reference's on frames that {judge}, as a share of the gain, with its 90 % interval",
    ]
    noise = result["noise"]
    if noise is None:
        lines.append("Noise ceiling: too few blocks for one")
    else:
        lines.append(
            "Noise ceiling, the reference on one half of the blocks against the other: bias "
            f"{noise['bias']:.4f}, error {noise['error']:.4f} "
            f"({noise['error_90'][0]:.4f} to {noise['error_90'][1]:.4f}), tau {noise['tau']:.3f}, "
            f"choices apart by {percent(noise['apart'])} of the gain"
        )
    if result["casters_not_installed"]:
        lines.append(f"Not installed, and left out: {', '.join(result['casters_not_installed'])}")
    return lines


def _rung(row: Mapping, result: Mapping) -> tuple[str, ...]:
    time = row["milliseconds"]
    marks = [
        "reference" if row["name"] == result["reference"] else "",
        "recommended" if row["name"] == result["recommended"] else "within" if row["within"] else "",
        "front" if row["pareto"] else "",
        "" if row["twin"] is None else f"as {row['twin']}" if row["same_as_twin"] else f"NOT as {row['twin']}",
    ]
    return (
        row["name"],
        milliseconds(time["median"]),
        f"{milliseconds(time['first_quartile'])} to {milliseconds(time['third_quartile'])}",
        f"{row['speedup']:.2g} x",
        signed(row["bias"]),
        number(row["error"]),
        percent(row["error_share"]),
        number(row["tau"], 3),
        with_interval(row["regret"], row["regret_interval_90"]),
        ", ".join(mark for mark in marks if mark),
    )


def _asked(result: Mapping) -> str:
    asked = [row for row in result["rungs"] if row["asked"] and row["name"] != result["reference"]]
    return (
        f"Near enough is asked of each level of detail from all beams to the fewest, up to the first fidelity that "
        f"cannot be shown to be: here of {len(asked)} ({', '.join(row['name'] for row in asked)}), by upper bounds of "
        f"regret at {100 * result['bound_level']:.1f} %{_sure(result)}"
    )


def _sure(result: Mapping) -> str:
    if result["judged_on"] != "held out":
        return ", of frames that chose too, so that more may pass than should"
    return (
        f", so that with {100 * result['sure']:g} % none of those that pass loses more than the tolerance, given what "
        "the searched frames choose"
    )


def _hits(result: Mapping) -> list[str]:
    lines = []
    for name in dict.fromkeys(one["caster"] for one in result["hits"]):
        of = [one for one in result["hits"] if one["caster"] == name]
        rays, hits, missed, other = (sum(one[key] for one in of) for key in ("rays", "hits", "hit_or_miss", "vehicle"))
        farthest = max(one["largest_range_m"] for one in of)
        lines.append(
            f"{name} beside the float64 oracle: of {rays:,} rays, {hits:,} of which hit, {missed} hit where the other "
            f"misses, {other} meet another vehicle; ranges differ by {farthest:.2g} m at most"
        )
    return lines


def _validated(result: Mapping) -> list[str]:
    return [
        f"{one['where']}: {one['verdict']}; regret {with_interval(one['regret'], one['regret_interval_90'])}, error "
        f"{percent(one['error_share'])} of the gain"
        for one in result["validated"]
    ]


def _paired(result: Mapping) -> list[str]:
    paired = result["paired"]
    if paired is None:
        return []
    told = [
        f"{one['detail']} ({one['losses']}) {one['error_bits']:.3f}"
        + ("" if one["interval_90"] is None else f" ({one['interval_90'][0]:.3f} to {one['interval_90'][1]:.3f})")
        for one in paired["variants"]
    ]
    return [f"Against {paired['cars']} real cars, median error per car [bits]: {'; '.join(told)}"]


def _wrapped(lines: Sequence[str]) -> list[str]:
    return [part for line in lines for part in textwrap.wrap(line, _WIDTH, subsequent_indent="  ")]


def _table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    every = [tuple(header), *rows]
    widths = [max(len(row[column]) for row in every) for column in range(len(header))]
    return ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in every]


def _markdown(header: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    return [f"| {' | '.join(row)} |" for row in (header, ["---"] * len(header), *rows)]
