"""The report as text: the sentence, the fidelities, the casters, what was validated, and what the scene needs."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence

from .recommendation import milliseconds

_WIDTH = 120
_LADDER = ("fidelity", "one evaluation", "quartiles", "faster", "bias", "error", "of the gain", "tau", "regret", "")
_ABLATIONS = ("modelled", "", "bias", "error", "tau", "best moves by", "left out it costs", "above the noise in")
_UNITS = {"_m": "m", "_deg": "deg"}


def report_text(result: Mapping) -> str:
    """What `chart_study` came to, for a terminal: of the ladder only what is worth a line there."""
    rows = [row for row in result["rungs"] if _told(row, result)]
    parts = [
        *_wrapped(_head(result)),
        "",
        *_table(_LADDER, [_rung(row, result) for row in rows]),
        f"({len(result['rungs'])} fidelities; all of them are in chart.csv)",
        "",
        *_table(_ABLATIONS, [_ablation(row) for row in result["ablations"]]),
        "",
        *_wrapped([*_hits(result), *_validated(result), *_paired(result), result["sentence"]]),
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
        *_markdown(_ABLATIONS, [_ablation(row) for row in result["ablations"]]),
    ]
    parts += [
        "",
        "## Does it hold",
        "",
        *(f"- {line}" for line in [*_hits(result), *_validated(result), *_paired(result)]),
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
            f"choices apart by {_percent(noise['regret'])} of the gain"
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
        _signed(row["bias"]),
        _number(row["error"]),
        _percent(row["error_share"]),
        _number(row["tau"], 3),
        _interval(row["regret"], row["regret_interval_90"]),
        ", ".join(mark for mark in marks if mark),
    )


def _ablation(row: Mapping) -> tuple[str, ...]:
    if row["bias"] is None:
        return (row["what"], row["value"], row["note"], "", "", "", "", "")
    above = row["above_noise"]
    return (
        row["what"],
        row["value"],
        _signed(row["bias"]),
        _number(row["error"]),
        _number(row["tau"], 3),
        ", ".join(_moved(key, by) for key, by in row["shift"].items()),
        _interval(row["regret"], row["regret_interval_90"]),
        "no floor known" if above is None else ", ".join(above) or "nothing",
    )


def _moved(key: str, by: float) -> str:
    unit = next((unit for ending, unit in _UNITS.items() if key.endswith(ending)), "")
    return f"{round(by, 2) + 0.0:+.2f} {unit}".rstrip()


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
        f"{one['where']}: {one['verdict']}; regret {_interval(one['regret'], one['regret_interval_90'])}, error "
        f"{_percent(one['error_share'])} of the gain"
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


def _number(value: float | None, digits: int = 4) -> str:
    return "" if value is None else f"{value:.{digits}f}"


def _signed(value: float | None) -> str:
    return "" if value is None else f"{round(value, 4) + 0.0:+.4f}"


def _percent(share: float | None) -> str:
    return "" if share is None else f"{round(100.0 * share, 1) + 0.0:.1f} %"


def _interval(share: float | None, interval: Sequence[float] | None) -> str:
    if share is None or interval is None:
        return _percent(share)
    low, high = (f"{round(100.0 * end, 1) + 0.0:.1f}" for end in interval)
    return f"{_percent(share)} ({low} to {high})"
