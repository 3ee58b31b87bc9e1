"""The case study's results for a person to read."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from .claims import claims
from .distance import effects_shown
from .published import EVEN
from .report_optima import optima_sections
from .report_settings import settings_section
from .verdicts import with_interval

_SOURCE = "He, Cao, Su and Liu, arXiv 2407.17942, section V"


def report_text(result: Mapping, pictures: Sequence[str] = ()) -> str:
    """The whole report, in Markdown."""
    parts = (
        _head(result),
        _claims(result),
        *optima_sections(result),
        _fig9(result),
        _spacing(result),
        settings_section(result),
        _pictures(pictures),
    )
    return "\n".join(line for part in parts for line in (*part, "")).rstrip() + "\n"


def _head(result):
    effort = result["effort"]
    lines = [
        "# The paper's case study, made again",
        "",
        f"{_SOURCE}, against blender_lidar {result['versions']['blender_lidar']}.",
        "",
        f"- Scene `{result['scene']}`, traffic `{result['traffic']}`, {result['reading']} reading, "
        f"{result['caster']}, seed {result['seed']}.",
        f"- {result['frames']} searched frames in {result['blocks']} blocks of {result['block_s']:g} s, the same for "
        f"all sensors; {_judged_on(result)} judge.",
        "- Intervals are 90 %, from resampled blocks of time. Those of the optima hold the middle 90 % of those of "
        "resampled searched blocks, the same resamples for all sensors; probabilities of an order are shares of these. "
        f"Those of gains, by distance and of the spacing are by Student's t over the {result['judged_blocks']} "
        f"{result['judged_on']} blocks. Each varied setting has resamples of its own.",
        f"- Grids: {_by(effort['grid'])} heights and tilts for Table II, {_by(effort['wide_grid'])} beyond its bounds, "
        f"{_by(effort['sensitivity_grid'])} over {effort['sensitivity_frames']} frames for what is varied.",
        "- *Detectable* is a threshold on the metric (mean occupancy 0.005), not a detector's recall.",
    ]
    return lines + [f"- Note: {note}." for note in result["notes"]]


def _claims(result):
    return [
        "## What reproduces",
        "",
        "| the paper | here | verdict |",
        "|---|---|---|",
        *(f"| {claim.text} | {claim.ours} | **{claim.verdict}** |" for claim in claims(result)),
    ]


def _fig9(result):
    lines = [
        "## By distance (Fig. 9)",
        "",
        f"On {_judged_on(result)}; change of the detectable share in points and of the entropy in bits. "
        f"{EVEN} is judged at RS-80's optimum, not at one of its own.",
        "",
        "| sensor | distance | vehicles | detectable | change | entropy | change |",
        "|---|---|---|---|---|---|---|",
    ]
    rows = {(row["sensor"], row["band"], row["measure"]): row for row in result["fig9"]}
    for (sensor, band, measure), share in rows.items():
        if measure == "detectable":
            bits = rows[sensor, band, "entropy_bits"]
            lines.append(
                f"| {sensor} | {band} | {share['vehicles']} "
                f"| {100 * share['baseline']:.0f} → {100 * share['optimised']:.0f} % "
                f"| {with_interval(share['change'], 0, 100.0)} "
                f"| {bits['baseline']:.3f} → {bits['optimised']:.3f} | {with_interval(bits['change'])} |"
            )
    return lines


def _spacing(result):
    parts = effects_shown(result["spacing"])
    columns = {"change": "change", **parts, "spacing_at_baseline": "lead at the baseline"}
    columns["spacing_at_optimum"] = "lead at the optimum"
    lines = [
        "## RS-80: height, tilt or spacing?",
        "",
        "The change from baseline to optimum, in bits of entropy per vehicle, against a table of the same number of "
        f"rings and field of view with even steps, on {_judged_on(result)}. Change = {' + '.join(parts.values())}, all "
        "but the last with even beams. The lead is what the uneven table sees more than the even one under the same "
        "mounting; one that loses its lead need not be worse.",
        "",
        f"| distance | {' | '.join(columns.values())} |",
        "|---|" + "---|" * len(columns),
    ]
    return lines + [
        f"| {row['band']} | " + " | ".join(with_interval(row[effect]) for effect in columns) + " |"
        for row in result["spacing"]
        if row["measure"] == "entropy_bits"
    ]


def _pictures(pictures):
    return [] if not pictures else ["## Pictures", "", *(f"![{name}]({name})" for name in pictures)]


def _judged_on(result):
    return f"{result['judged_frames']} {result['judged_on']} frames in {result['judged_blocks']} blocks of time"


def _by(grid):
    return " x ".join(map(str, grid))
