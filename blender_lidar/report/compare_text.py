"""A comparison with reality in words: a short table and sentences, for detectors and for paired sweeps."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from ..statistics import FEWEST_BLOCKS
from ..studies.compare.cars import PAPERS
from ..studies.compare.detections import TRAINING
from ..studies.compare.detectors import ANY, COMPARED, PERFORMANCE, Findings
from ..studies.compare.findings import PAPER, speed
from ..studies.compare.labelled import NOT_TOLD
from ..studies.compare.paired import LOSSES
from ..studies.compare.paired_findings import ALL, TUNED, VALIDATION, judging

# --- Metrics beside detectors -----------------------------------------------------------------------------------------

_SIGNIFICANT = 0.05
_NARROW = " that are too narrow (see below)"


def findings_text(findings: Findings) -> str:
    """The whole text."""
    parts = (_head(findings), *(_of_detector(findings, name) for name in findings.judged.detectors))
    parts = (*parts, _by_distance(findings), _ground(findings), _speed(findings), _cautions(findings))
    return "\n\n".join("\n".join(lines) for lines in parts if lines)


def _head(findings: Findings) -> list[str]:
    judged, frames = findings.judged, findings.frames
    sets = ", ".join(f"{name} {int(member.sum())}" for name, member in findings.sets.items())
    lines = [f"{len(judged)} cars in {frames} frame{'s' * (frames != 1)}; sets: {sets}"]
    if findings.unlisted:
        lines.append(f"{findings.unlisted} further labelled cars of these frames are not in the detections: left out")
    return lines


def _of_detector(findings: Findings, detector: str) -> list[str]:
    mine = [row for row in findings.agreements if row["detector"] == detector]
    main = {row["metric"]: row for row in mine if row["set"] == findings.main}
    if not main:
        return [f"{detector}: too few cars or frames of {findings.main} in its range for intervals"]
    first = next(iter(main.values()))
    narrow = _NARROW if first["resampled"]["intervals_too_narrow"] else ""
    width = max(map(len, main))
    head = f"{'':{width}}  {'Spearman':22}  {'given distance, occlusion':25}  {'Pearson':22}  "
    lines = [
        f"{detector}, {findings.main}: {first['cars']} cars, {first['resampled']['number']} resampled {_units(first)}; "
        f"with confidence x IoU, 90 % intervals{narrow}",
        f"{head}{'Pearson, 10 m bins':22}  isotonic R2",
    ]
    for name, row in main.items():
        rank, given, straight, r2 = (row[key].text() for key in COMPARED)
        means = row["bins_10m"]["pearson"].text()
        lines.append(f"{name:{width}}  {rank:22}  {given:25}  {straight:22}  {means:22}  {r2}")
    for name in dict.fromkeys((first["metric"], PAPERS)):
        if name in main:
            lines += [_followed(main[name]), *_rivals(main, name, narrow and f", by intervals{narrow}")]
    return lines + _elsewhere(mine, first["metric"], findings.main)


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
    held = {metric: row["less"][name] for metric, row in main.items() if name in row["less"]}
    ranked = {metric: of["spearman"] for metric, of in held.items() if math.isfinite(of["spearman"].p_above)}
    if not ranked:
        return []
    number = len(set(ranked.values()))  # orders of the cars: twins count once
    many = f"{number} rival{'s' * (number != 1)}"
    by = {metric: f"{metric} by {of.difference.text(3, '+')}" for metric, of in ranked.items()}
    kept = [metric for metric, of in ranked.items() if of.p_holm < _SIGNIFICANT]
    unkept = [metric for metric, of in ranked.items() if of.p_above < _SIGNIFICANT and metric not in kept]
    worse = [metric for metric, of in ranked.items() if of.difference.high < 0.0]
    lines = [f"None of {many} is significantly better in Spearman than {name} after Holm's correction."]
    if kept:
        said = ", ".join(by[metric] for metric in kept)
        lines = [f"Significantly better in Spearman than {name}, with Holm's correction for {many}{narrow}: {said}."]
    if unkept:
        said = ", ".join(f"{by[metric]}, p {ranked[metric].p_above:.3f}" for metric in unkept)
        lines.append(f"Better only without that correction: {said}.")
    if worse:
        rest = [metric for metric in ranked if metric not in {*worse, *kept, *unkept}]
        open_yet = ", ".join(f"{metric} {ranked[metric].difference.text(3, '+')}" for metric in rest)
        beside = f"; cannot be told apart from it: {open_yet}" if rest else ""
        lines.append(f"Below it, by intervals that leave out 0: {len(worse)} of {len(ranked)}{beside}.")
    straighter = [metric for metric, of in held.items() if of["pearson"].p_holm < _SIGNIFICANT]
    if straighter:
        lines.append(f"More linear in the detector (Pearson, after Holm): {', '.join(straighter)}.")
    return lines


def _elsewhere(mine: Sequence[Mapping], name: str, main: str) -> list[str]:
    """What the other sets say of one metric."""
    lines = []
    for row in mine:
        if row["metric"] == name and row["set"] != main:
            learned = ", learned from" if row["set"] == TRAINING else ""
            rivals = [one for one in mine if one["set"] == row["set"] and name in one["less"]]
            better = [one["metric"] for one in rivals if one["less"][name]["spearman"].p_holm < _SIGNIFICANT]
            lines.append(
                f"  {row['set']} ({row['cars']} cars, {row['resampled']['number']} {_units(row)}{learned}): "
                f"{row['spearman'].text()}, given distance and occlusion {row['partial_spearman'].text()}; "
                f"better after Holm: {', '.join(better) or 'none'}"
            )
    return [f"Spearman of {name} on other sets:", *lines] if lines else []


def _by_distance(findings: Findings) -> list[str]:
    mine = [(row, row["linear_less_logarithmic"]) for row in findings.shapes if row["set"] == findings.main]
    lines = [f"With distance ({findings.main}; out-of-fold R2 of a straight line less that of a logarithm):"]
    for text, chosen in (
        ("falls linearly", lambda lead: lead.low > 0.0),
        ("falls logarithmically", lambda lead: lead.high < 0.0),
        ("either fits", lambda lead: lead.low <= 0.0 <= lead.high),
    ):
        said = [f"{_quantity(row)} {lead.text(2, '+')}" for row, lead in mine if row["bearing"] == ANY and chosen(lead)]
        lines += [f"  {text}: {', '.join(said)}"] * bool(said)
    by_bearing = [
        f"{_quantity(row)} {row['bearing']} {lead.text(2, '+')} ({row['cars']} cars)"
        for row, lead in mine
        if row["bearing"] != ANY
        and math.isfinite(lead.value)
        and (row["quantity"] in (findings.judged.metrics[0].name, PAPERS) or row["quantity"].endswith(PERFORMANCE))
    ]
    lines += [f"  by bearing: {', '.join(by_bearing)}"] * bool(by_bearing)
    return lines if mine else []


def _quantity(row: Mapping) -> str:
    return row["quantity"].replace(PERFORMANCE, " performance")


def _ground(findings: Findings) -> list[str]:
    name = findings.judged.metrics[0].name
    ours = [row for row in findings.without_ground if row["metric"] == name]
    said = "; ".join(
        f"{row['detector']} {row['spearman'].text()}, {row['spearman_change'].text(3, '+')}"
        for row in ours
        if math.isfinite(row["spearman_change"].value)
    )
    what = f"Without returns under {findings.other_clearance_m:g} m above floors"
    if findings.other_clearance_m == 0.0:
        what = "With ground returns kept"
    return [f"{what}, {name} has Spearman: {said}."] if said else []


def _speed(findings: Findings) -> list[str]:
    each = speed(findings)
    read, assign, score = (each[stage]["ms_per_frame"] for stage in ("read", "assign", "pe_vgop"))
    ours, every, paper = (
        f"{each[name]['ms_per_frame']:.2f} ms a frame, {each[name]['ms_per_car']:.2f} ms a car"
        for name in ("file_to_pe_vgop", "file_to_all_metrics", "paper")
    )
    return [
        f"PE-VGOP from file to score, processor time: {ours} (reading {read:.2f}, assigning {assign:.2f}, scoring "
        f"{score:.2f} ms a frame); all metrics {every}.",
        f"The paper: {PAPER['seconds']:.0f} s for {PAPER['frames']:,} frames, {paper}; it names no machine.",
    ]


def _cautions(findings: Findings) -> list[str]:
    lines = []
    narrow = dict.fromkeys(row["set"] for row in findings.agreements if row["resampled"]["intervals_too_narrow"])
    if narrow:
        lines.append(
            f"Too narrow: the intervals of {', '.join(narrow)}. Frames of one drive show the same cars again, and no "
            "drives, or fewer than three, are told that could be resampled."
        )
    elif "drive" not in findings.about:
        lines.append("Nothing tells which frames are of one drive; if some are, intervals are too narrow.")
    if TRAINING in findings.sets:
        lines.append(f"Frames of {TRAINING} are those that detectors and priors learned from: no test of them.")
    if (findings.judged["occlusion"] == NOT_TOLD).all():
        lines.append("The labels tell no occlusion: where it is said to be held fixed, distance alone is.")
    if findings.untaught:
        lines.append(f"Left out, as no frame of split {TRAINING} can teach them: {', '.join(findings.untaught)}.")
    return lines


def _units(row: Mapping) -> str:
    unit = row["resampled"]["unit"]
    return {"frame": "frames", "drive": "drives"}.get(unit, f"blocks of {unit}")


# --- Simulated beside real scores -------------------------------------------------------------------------------------

_GROUPS = ("by_distance", "by_bearing")
_HEAD = (
    f"{'detail, losses':<26}  median error  90 % interval     bias  with hidden     both  real only  sim. only  |range|"
)
_LEGEND = (
    "both, real only, sim. only: rays to the cars that return from them in reality, against our shapes, or in both",
    "with hidden: the median error with the rays that something unlabelled stopped before the car",
    "|range|: real less simulated range of the rays that return in both; median of the cars' medians",
)


def paired_text(result: Mapping) -> str:
    """The findings as tables for a terminal, of the set that judges; `result` as `paired.json` has it."""
    sets, sensor, losses = result["sets"], result["sensor"], result["losses"]
    name = judging(sets)
    of = sets[name]
    left_out = ", ".join(f"{count} {reason}" for reason, count in result["left_out"].items())
    lines = [
        f"Sweeps     {result['sweeps']} in {result['folder']}, {result['layout']} layout",
        f"Sensor     {_rings(sensor)}",
        f"Cars       {sets[ALL]['cars']} whole ones at 10 to 50 m; left out: {left_out}",
        f"Casting    {result['caster']}; losses: {100 * losses['glass_dropout']:g} % of the returns from glass, "
        f"{100 * losses['dropout']:g} % of any, noise {losses['range_noise_m']:g} m; weak: 10 % seen to "
        f"{losses['range_at_10_percent_m']:g} m",
    ]
    if name == VALIDATION:
        lines.append(f"Judged on  {of['cars']} cars in {of['frames']} frames that nothing was fitted to")
    elif TUNED in sets:
        lines.append("Judged on  the frames that shapes and losses were fitted to, so that errors are too small")
    lines += ["", "PE-VGOP of each car, simulated less real [bits], and its rays", _HEAD]
    lines += [_row(one) for one in of["variants"]]
    lines += ["", "median error at              10-20 m  20-30 m  30-40 m  40-50 m   end-on  oblique  side-on"]
    for one in of["variants"]:
        medians = [group["absolute_error_bits"] for key in _GROUPS for group in one[key]]
        texts = ["-" if each is None else f"{each['median']:.3f}" for each in medians]
        lines.append(f"{_said(one):<26}" + "".join(f"{text:>9}" for text in texts))
    counts = of["variants"][0]
    lines.append(f"{'cars':<26}" + "".join(f"{group['cars']:>9}" for key in _GROUPS for group in counts[key]))
    return "\n".join([*lines, "", *_LEGEND, "", *_verdict(result["cheapest_within_noise"], sets, of["resampled"])])


def _row(one: Mapping) -> str:
    error, hits, residual = one["absolute_error_bits"], one["hits"], one["residual_abs_median_m"]
    low, high = error["interval_90"] or (math.nan, math.nan)
    return (
        f"{_said(one):<26}  {error['median']:12.3f}  {low:.3f} to {high:.3f}  {one['bias_bits']['median']:+7.3f}"
        f"  {one['absolute_error_hidden_kept_bits']['median']:11.3f}  {hits['both']:>7,}  {hits['real_only']:>9,}"
        f"  {hits['simulated_only']:>9,}  {math.nan if residual is None else residual:5.3f} m"
    )


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
            next(one["absolute_error_bits"]["median"] for one in sets[key]["variants"] if one | best == one)
            for key in (TUNED, VALIDATION)
        )
        lines.append(f"It errs by {fit:.3f} on the frames of the fit and by {other:.3f} on the others.")
    if number >= FEWEST_BLOCKS:
        lines.append(f"Intervals are of {number} resampled {resampled['unit']}{'s' * (number != 1)}.")
        if resampled["too_narrow"]:
            lines.append(
                "They are too narrow: frames of one drive show the same cars again, and a column drive of frames.csv "
                "tells no drives, or fewer than three."
            )
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
