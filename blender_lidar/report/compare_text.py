"""A comparison with reality in words: a short table and sentences, for detectors and for paired sweeps."""

from __future__ import annotations

import math
from collections.abc import Mapping

from ..statistics import FEWEST_BLOCKS
from ..studies.compare.cars import PAPERS
from ..studies.compare.detections import TRAINING
from ..studies.compare.detectors import ANY, PAPER, PERFORMANCE, Findings
from ..studies.compare.labelled import NOT_TOLD
from ..studies.compare.paired import LOSSES
from ..studies.compare.paired_findings import ALL, TUNED, VALIDATION, judging
from .study import text_table

_DRIVES = (
    "Frames of one drive show the same cars again, and no drives, or fewer than three, are told in a column drive of "
    "frames.csv that could be resampled."
)

# --- Metrics beside detectors -----------------------------------------------------------------------------------------

_SIGNIFICANT = 0.05
_NARROW = " that are too narrow (see below)"
_TABLE = {
    "Spearman": lambda row: row["spearman"],
    "given distance, occlusion": lambda row: row["partial_spearman"],
    "Pearson": lambda row: row["pearson"],
    "Pearson, 10 m bins": lambda row: row["bins_10m"]["pearson"],
    "isotonic R2": lambda row: row["isotonic_r2"],
}


def findings_text(findings: Findings) -> str:
    """The whole text."""
    result = findings.result
    parts = (_head(result), *(_of_detector(result, name) for name in result["detectors"]))
    parts = (*parts, _by_distance(result), _ground(result), _speed(result["speed"]), _cautions(findings))
    return "\n\n".join("\n".join(lines) for lines in parts if lines)


def _head(result: Mapping) -> list[str]:
    sets = ", ".join(f"{name} {cars}" for name, cars in result["sets"].items())
    lines = [f"{result['cars']} cars in {_many(result['frames'], 'frame')}; sets: {sets}"]
    if result["cars_not_listed"]:
        lines.append(f"{result['cars_not_listed']} further labelled cars of these frames are not in the detections")
    return lines


def _of_detector(result: Mapping, detector: str) -> list[str]:
    mine = [row for row in result["correlations"] if row["detector"] == detector]
    main = {row["metric"]: row for row in mine if row["set"] == result["main_set"]}
    if not main:
        return [f"{detector}: too few cars or frames of {result['main_set']} in its range for intervals"]
    first = next(iter(main.values()))
    narrow = _NARROW if first["resampled"]["intervals_too_narrow"] else ""
    rows = [[name, *(of(row).text() for of in _TABLE.values())] for name, row in main.items()]
    lines = [
        f"{detector}, {result['main_set']}: {first['cars']} cars, {_drawn(first)}; with confidence x IoU, 90 % "
        f"intervals{narrow}",
        *text_table([["", *_TABLE], *rows]),
    ]
    for name in dict.fromkeys((first["metric"], PAPERS)):
        if name in main:
            lines += [_followed(main[name]), *_rivals(main, name, narrow and f", by intervals{narrow}")]
    others = [row for row in mine if row["metric"] == first["metric"] and row["set"] != result["main_set"]]
    lines += [f"Spearman of {first['metric']} on other sets:"] * bool(others)
    for row in others:
        cars = f"{row['cars']} cars, {_drawn(row)}{', learned from' * (row['set'] == TRAINING)}"
        given = f"given distance and occlusion {row['partial_spearman'].text()}"
        lines.append(f"  {row['set']} ({cars}): {row['spearman'].text()}, {given}")
    return lines


def _followed(row: Mapping) -> str:
    rank, means = row["spearman"], row["bins_10m"]
    if not math.isfinite(rank.low):
        return f"{row['metric']}: Spearman {rank.text()}, no interval."
    follows = "follows" if rank.low > 0.0 else "goes against" if rank.high < 0.0 else "cannot be shown to follow"
    return (
        f"{row['metric']} {follows} {row['detector']} car by car: Spearman {rank.text()}; beyond what distance and "
        f"occlusion tell: {row['partial_spearman'].text()}. Bins of 10 m: Pearson {means['pearson'].text(3)} over "
        f"{means['groups']} means."
    )


def _rivals(main: Mapping[str, Mapping], name: str, narrow: str) -> list[str]:
    """How the others do beside one metric."""
    apart = {metric: row["less"][name]["spearman"] for metric, row in main.items() if name in row["less"]}
    groups: dict[str, list[str]] = {}
    for metric, one in apart.items():
        if math.isfinite(one.p_above):
            better = "better" if one.p_holm < _SIGNIFICANT else "perhaps" if one.p_above < _SIGNIFICANT else ""
            groups.setdefault(better or ("worse" if one.high < 0.0 else "alike"), []).append(metric)
    if not groups:
        return []
    told = [metric for metrics in groups.values() for metric in metrics]
    many = _many(len({apart[metric] for metric in told}), "rival")  # orders of the cars: twins count once
    said = {
        group: ", ".join(f"{metric} by {apart[metric].text(3, '+')}" for metric in metrics)
        for group, metrics in groups.items()
    }
    lines = [f"None of {many} is significantly better in Spearman than {name} after Holm's correction."]
    if "better" in said:
        head = f"Significantly better in Spearman than {name}, with Holm's correction for {many}{narrow}"
        lines = [f"{head}: {said['better']}."]
    if "perhaps" in said:
        lines.append(f"Better only without that correction: {said['perhaps']}.")
    if "worse" in said:
        beside = f"; cannot be told apart from it: {said['alike']}" if "alike" in said else ""
        lines.append(f"Below it, by intervals that leave out 0: {len(groups['worse'])} of {len(told)}{beside}.")
    return lines


def _by_distance(result: Mapping) -> list[str]:
    """Which quantities fall linearly with distance; by bearing `compare.json` has them."""
    said: dict[str, list[str]] = {"falls linearly": [], "falls logarithmically": [], "either fits": []}
    for row in result["by_distance"]:
        lead = row["linear_less_logarithmic"]
        if (row["set"], row["bearing"]) == (result["main_set"], ANY) and math.isfinite(lead.low):
            shape = (
                "falls linearly" if lead.low > 0.0 else "falls logarithmically" if lead.high < 0.0 else "either fits"
            )
            said[shape].append(f"{row['quantity'].replace(PERFORMANCE, ' performance')} {lead.text(2, '+')}")
    lines = [f"  {shape}: {', '.join(quantities)}" for shape, quantities in said.items() if quantities]
    head = f"With distance ({result['main_set']}; out-of-fold R2 of a straight line less that of a logarithm):"
    return [head, *lines] if lines else []


def _ground(result: Mapping) -> list[str]:
    name, other = result["metrics"][0]["name"], result["other_ground_clearance"]
    said = "; ".join(
        f"{row['detector']} {row['spearman'].text()}, {row['spearman_change'].text(3, '+')}"
        for row in other["correlations"]
        if row["metric"] == name and math.isfinite(row["spearman_change"].value)
    )
    least_m = other["ground_clearance_m"]
    what = f"Without returns under {least_m:g} m above floors" if least_m else "With ground returns kept"
    return [f"{what}, {name} has Spearman: {said}."] if said else []


def _speed(spent: Mapping[str, Mapping[str, float]]) -> list[str]:
    ours, every, paper = (
        f"{spent[name]['ms_per_frame']:.2f} ms a frame, {spent[name]['ms_per_car']:.2f} ms a car"
        for name in ("file_to_pe_vgop", "file_to_all_metrics", "paper")
    )
    return [
        f"PE-VGOP from file to score, processor time: {ours}; all metrics: {every}.",
        f"The paper: {PAPER['seconds']:.0f} s for {PAPER['frames']:,} frames, {paper}; it names no machine.",
    ]


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


def _drawn(row: Mapping) -> str:
    """What was resampled: ``"26 resampled frames"``."""
    unit, number = row["resampled"]["unit"], row["resampled"]["number"]
    return f"{number} resampled {unit}s" if unit in ("frame", "drive") else f"{number} resampled blocks of {unit}"


def _many(number: int, what: str) -> str:
    return f"{number} {what}{'s' * (number != 1)}"


# --- Simulated beside real scores -------------------------------------------------------------------------------------

_HEAD = ("detail, losses", "median error", "90 % interval", "bias", "with hidden", "both", "real only", "sim. only")
_LEGEND = (
    "both, real only, sim. only: rays to the cars that return from them in reality, against our shapes, or in both",
    "with hidden: the median error with the rays that something unlabelled stopped before the car",
    "|range|: real less simulated range of the rays that return in both; median of the cars' medians",
)


def paired_text(result: Mapping) -> str:
    """The findings as tables for a terminal, of the set that judges; `result` as `paired.json` has it."""
    sets, losses = result["sets"], result["losses"]
    name = judging(sets)
    of = sets[name]
    left_out = ", ".join(f"{count} {reason}" for reason, count in result["left_out"].items())
    lines = [
        f"Sweeps     {result['sweeps']} in {result['folder']}, {result['layout']} layout",
        f"Sensor     {_rings(result['sensor'])}",
        f"Cars       {sets[ALL]['cars']} whole ones at 10 to 50 m; left out: {left_out}",
        f"Casting    {result['caster']}; losses: {100 * losses['glass_dropout']:g} % of the returns from glass, "
        f"{100 * losses['dropout']:g} % of any, noise {losses['range_noise_m']:g} m; weak: 10 % seen to "
        f"{losses['range_at_10_percent_m']:g} m",
    ]
    if name == VALIDATION:
        lines.append(f"Judged on  {of['cars']} cars in {of['frames']} frames that nothing was fitted to")
    elif TUNED in sets:
        lines.append("Judged on  the frames that shapes and losses were fitted to, so that errors are too small")
    errors = text_table([[*_HEAD, "|range|"], *map(_errors, of["variants"])])
    groups = {_said(one): [*one["by_distance"], *one["by_bearing"]] for one in of["variants"]}
    first = next(iter(groups.values()))
    where = [group.get("bearing") or f"{group['low_m']:.0f}-{group['high_m']:.0f} m" for group in first]
    medians = [[said, *(_median(group["absolute_error_bits"]) for group in of_one)] for said, of_one in groups.items()]
    counts = ["cars", *(str(group["cars"]) for group in first)]
    lines += ["", "PE-VGOP of each car, simulated less real [bits], and its rays", *errors]
    lines += ["", *text_table([["median error at", *where], *medians, counts]), "", *_LEGEND]
    return "\n".join([*lines, "", *_verdict(result["cheapest_within_noise"], sets, of["resampled"])])


def _errors(one: Mapping) -> list[str]:
    """The row of a variant."""
    error, hits, residual = one["absolute_error_bits"], one["hits"], one["residual_abs_median_m"]
    interval = " to ".join(f"{end:.3f}" for end in error["interval_90"] or ()) or "-"
    counts = [f"{hits[key]:,}" for key in ("both", "real_only", "simulated_only")]
    medians = _median(error), interval, f"{one['bias_bits']['median']:+.3f}"
    off = "-" if residual is None else f"{residual:.3f} m"
    return [_said(one), *medians, _median(one["absolute_error_hidden_kept_bits"]), *counts, off]


def _median(one: Mapping | None) -> str:
    return "-" if one is None else f"{one['median']:.3f}"


def _verdict(found: Mapping, sets: Mapping, resampled: Mapping) -> list[str]:
    best, cheapest, number = found["best"], found["cheapest"], resampled["number"]
    if number < FEWEST_BLOCKS:
        lines = [f"Smallest error: {_said(best)}; with fewer than {FEWEST_BLOCKS} frames there are no intervals."]
    elif best == cheapest:
        lines = [f"Best: {_said(best)}. No cheaper level of detail is within the noise of it."]
    else:
        low, high = found["interval_90"]
        lines = [
            f"Best: {_said(best)}. The cheapest level of detail within its noise: {cheapest['detail']},",
            f"whose median error is {found['difference_bits']:+.3f} bits off it (90 % interval {low:+.3f} to "
            f"{high:+.3f}).",
        ]
    if TUNED in sets and VALIDATION in sets:
        fit, other = (
            next(_median(one["absolute_error_bits"]) for one in sets[key]["variants"] if one | best == one)
            for key in (TUNED, VALIDATION)
        )
        lines.append(f"It errs by {fit} on the frames of the fit and by {other} on the others.")
    if number >= FEWEST_BLOCKS:
        lines.append(f"Intervals are of {_many(number, 'resampled ' + resampled['unit'])}.")
        if resampled["too_narrow"]:
            lines.append(f"They are too narrow. {_DRIVES}")
    return lines


def _said(one: Mapping) -> str:
    return f"{one['detail']}, {LOSSES[one['losses']]}"


def _rings(sensor: Mapping) -> str:
    text = f"{' or '.join(map(str, sensor['rings']))} rings, a firing every {sensor['azimuth_step_deg']:.4f} deg"
    if "height_m" in sensor:
        height, elevation = sensor["height_m"], sensor["elevation_deg"]
        text += (
            f", {elevation[0]:.2f} to {elevation[-1]:.2f} deg, lasers {min(height):.3f} to {max(height):.3f} m above "
            f"and up to {max(map(abs, sensor['lateral_m'])):.3f} m beside the axis"
        )
    return text
