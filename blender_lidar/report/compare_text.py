"""A comparison with reality in words: a table and a verdict, for detectors and for paired sweeps.

What a reader decides by; `compare.json` and `paired.json` hold all sets, bands and bearings.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from ..statistics import FEWEST_BLOCKS
from ..studies.compare.cars import PAPERS
from ..studies.compare.detections import TRAINING
from ..studies.compare.detectors import PAPER, Findings
from ..studies.compare.labelled import NOT_TOLD
from ..studies.compare.paired import RETURN_LOSSES
from ..studies.compare.paired_findings import ALL, TUNED, VALIDATION, judging
from ..studies.compare.resampling import Estimate
from .study import text_table

_DRIVES = (
    "Frames of one drive show the same cars again, and no drives, or fewer than three, are told in a column drive of "
    "frames.csv that could be resampled."
)

# --- Metrics beside detectors -----------------------------------------------------------------------------------------

_SIGNIFICANT = 0.05
_TABLE = {
    "Spearman": lambda row: row["spearman"],
    "given distance, occlusion": lambda row: row["partial_spearman"],
    "Pearson": lambda row: row["pearson"],
    "Pearson, 10 m bins": lambda row: row["bins_10m"]["pearson"],
    "isotonic R2": lambda row: row["isotonic_r2"],
}


def findings_text(findings: Findings) -> str:
    """The main set's correlations with each detector, who is better than the first metric, speed and cautions."""
    result = findings.result
    sets = ", ".join(f"{name} {cars}" for name, cars in result["sets"].items())
    parts = [[f"{result['cars']} cars in {result['frames']} frames; sets: {sets}"]]
    if result["cars_not_listed"]:
        parts[0].append(f"{result['cars_not_listed']} further labelled cars of these frames are not in the detections")
    parts += [_of_detector(result, name) for name in result["detectors"]]
    ours, every, paper = (
        f"{result['speed'][name]['ms_per_frame']:.2f} ms a frame, {result['speed'][name]['ms_per_car']:.2f} ms a car"
        for name in ("file_to_pe_vgop", "file_to_all_metrics", "paper")
    )
    timed = f"PE-VGOP from file to score, processor time: {ours}; all metrics: {every}."
    said = f"The paper: {PAPER['seconds']:.0f} s for {PAPER['frames']:,} frames, {paper}; it names no machine."
    return "\n\n".join("\n".join(lines) for lines in (*parts, [timed, said], _cautions(findings)) if lines)


def _of_detector(result: Mapping, detector: str) -> list[str]:
    """The metrics beside a detector among the main set's cars."""
    judging_set = result["main_set"]
    of = {
        row["metric"]: row for row in result["correlations"] if (row["detector"], row["set"]) == (detector, judging_set)
    }
    if not of:
        return [f"{detector}: too few cars or frames of {judging_set} in its range for intervals"]
    first = next(iter(of.values()))
    drawn = first["resampled"]
    narrow = " that are too narrow (see below)" * drawn["intervals_too_narrow"]
    rows = [[name, *(cell(row).text() for cell in _TABLE.values())] for name, row in of.items()]
    lines = [
        f"{detector}, {judging_set}: {first['cars']} cars, {_drawn(drawn)}; with confidence x IoU, 90 % "
        f"intervals{narrow}",
        *text_table([["", *_TABLE], *rows]),
    ]
    for name in dict.fromkeys((first["metric"], PAPERS)):
        lines += _rivals(
            {metric: row["less"][name]["spearman"] for metric, row in of.items() if name in row["less"]}, name
        )
    return lines


def _rivals(apart: Mapping[str, Estimate], name: str) -> list[str]:
    """Which metrics are better in Spearman than one, by how much each exceeds it."""
    known = {metric: one for metric, one in apart.items() if math.isfinite(one.p_above)}
    if not known:
        return []
    number = len(set(known.values()))  # orders of the cars: twins count once
    many = f"{number} rival{'s' * (number != 1)}"
    better = [metric for metric, one in known.items() if one.p_holm < _SIGNIFICANT]
    below = sum(one.high < 0.0 for one in known.values())
    head = f"None of {many} is significantly better in Spearman than {name} after Holm's correction"
    if better:
        told = ", ".join(f"{metric} by {known[metric].text(3, '+')}" for metric in better)
        head = f"Significantly better in Spearman than {name}, with Holm's correction for {many}: {told}"
    return [f"{head}. Below it, by intervals that leave out 0: {below} of {len(known)}."]


def _cautions(findings: Findings) -> list[str]:
    lines, rows, cars = [], findings.result["correlations"], findings.judged.table
    narrow = dict.fromkeys(row["set"] for row in rows if row["resampled"]["intervals_too_narrow"])
    if narrow:
        lines.append(f"Too narrow: the intervals of {', '.join(narrow)}. {_DRIVES}")
    elif "drive" not in cars:
        lines.append("Nothing tells which frames are of one drive; if some are, intervals are too narrow.")
    if TRAINING in findings.sets:
        lines.append(f"Frames of {TRAINING} are those that detectors and priors learned from: no test of them.")
    if (cars["occlusion"] == NOT_TOLD).all():
        lines.append("The labels tell no occlusion: where it is said to be held fixed, distance alone is.")
    if findings.untaught:
        lines.append(f"Left out, as no frame of split {TRAINING} can teach them: {', '.join(findings.untaught)}.")
    return lines


def _drawn(resampled: Mapping) -> str:
    """What was resampled: ``"26 resampled frames"``."""
    unit, number = resampled["unit"], resampled["number"]
    return f"{number} resampled {unit}s" if unit in ("frame", "drive") else f"{number} resampled blocks of {unit}"


# --- Simulated beside real scores -------------------------------------------------------------------------------------


def paired_text(result: Mapping) -> str:
    """The findings as a table for a terminal, of the set that judges; `result` as `paired.json` has it."""
    sets, losses = result["sets"], result["losses"]
    name = judging(sets)
    of = sets[name]
    left_out = ", ".join(f"{count} {reason}" for reason, count in result["left_out"].items())
    rings = " or ".join(map(str, result["sensor"]["rings"]))
    lines = [
        f"Sweeps     {result['sweeps']} in {result['folder']}, {result['layout']} layout, of {rings} rings",
        f"Cars       {sets[ALL]['cars']} whole ones at 10 to 50 m; left out: {left_out}",
        f"Casting    {result['caster']}; losses: {100 * losses['glass_dropout']:g} % of the returns from glass, "
        f"{100 * losses['dropout']:g} % of any, noise {losses['range_noise_m']:g} m; weak: 10 % seen to "
        f"{losses['range_at_10_percent_m']:g} m",
    ]
    if name == VALIDATION:
        lines.append(f"Judged on  {of['cars']} cars in {of['frames']} frames that nothing was fitted to")
    elif TUNED in sets:
        lines.append("Judged on  the frames that shapes and losses were fitted to, so that errors are too small")
    head = ("detail, losses", "median error", "90 % interval", "bias", "both", "real only", "sim. only", "|range|")
    return "\n".join(
        [
            *lines,
            "",
            "PE-VGOP of each car, simulated less real [bits], and its rays: how many return from it really, against",
            "our shapes, or in both, and how far apart the ranges of these are (median of the cars' medians)",
            *text_table([head, *map(_errors, of["variants"])]),
            "",
            *_verdict(result["cheapest_within_noise"], sets, of["resampled"]),
        ]
    )


def _errors(one: Mapping) -> list[str]:
    """The row of a variant."""
    error, residual = one["absolute_error_bits"], one["residual_abs_median_m"]
    interval = " to ".join(f"{end:.3f}" for end in error["interval_90"] or ()) or "-"
    counts = [f"{one['hits'][key]:,}" for key in ("both", "real_only", "simulated_only")]
    off = "-" if residual is None else f"{residual:.3f} m"
    return [_said(one), f"{error['median']:.3f}", interval, f"{one['bias_bits']['median']:+.3f}", *counts, off]


def _verdict(found: Mapping, sets: Mapping, resampled: Mapping) -> list[str]:
    best, cheapest = found["best"], found["cheapest"]
    if resampled["number"] < FEWEST_BLOCKS:
        return [f"Smallest error: {_said(best)}; with fewer than {FEWEST_BLOCKS} frames there are no intervals."]
    lines = [f"Best: {_said(best)}. No cheaper level of detail is within the noise of it."]
    if best != cheapest:
        low, high = found["interval_90"]
        lines = [
            f"Best: {_said(best)}. The cheapest level of detail within its noise: {cheapest['detail']},",
            f"whose median error is {found['difference_bits']:+.3f} bits off it (90 % interval {low:+.3f} to "
            f"{high:+.3f}).",
        ]
    lines.append(f"Intervals are of {_drawn(resampled)}.")
    if resampled["too_narrow"]:
        lines.append(f"They are too narrow. {_DRIVES}")
    if TUNED in sets and VALIDATION in sets:
        fit, other = (
            next(one["absolute_error_bits"]["median"] for one in sets[key]["variants"] if one | best == one)
            for key in (TUNED, VALIDATION)
        )
        lines.append(f"It errs by {fit:.3f} on the frames of the fit and by {other:.3f} on the others.")
    return lines


def _said(one: Mapping) -> str:
    return f"{one['detail']}, {RETURN_LOSSES[one['losses']]}"
