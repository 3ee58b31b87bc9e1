"""The findings of a comparison with detectors for a person to read: a short table, and sentences with numbers."""

from __future__ import annotations

import math
from collections.abc import Sequence

from .agreement import Agreement
from .car_sets import TRAINING
from .chosen_metrics import PAPERS
from .detector_study import Findings
from .distance_shape import ANY, PERFORMANCE
from .findings_tables import PAPER, speed
from .labelled import NOT_TOLD
from .significance import Difference

_SIGNIFICANT = 0.05
_NARROW = " that are too narrow (see below)"
_TABLE = {"Spearman": 22, "given distance, occlusion": 25, "Pearson": 22, "Pearson, 10 m bins": 22, "isotonic R2": 22}
"""Columns and their widths."""


def findings_text(findings: Findings) -> str:
    """The whole text."""
    parts = (_head(findings), *(_of_detector(findings, one.name) for one in findings.judged.detectors))
    parts = (*parts, _by_distance(findings), _ground(findings), _speed(findings), _cautions(findings))
    return "\n\n".join("\n".join(lines) for lines in parts if lines)


def _head(findings: Findings) -> list[str]:
    judged = findings.judged
    sets = ", ".join(f"{one.name} {int(one.member.sum())}" for one in findings.sets)
    lines = [f"{len(judged)} cars in {findings.frames} frame{'s' * (findings.frames != 1)}; sets: {sets}"]
    if judged.unlisted:
        lines.append(f"{judged.unlisted} further labelled cars of these frames are not in the detections: left out")
    return lines


def _of_detector(findings: Findings, detector: str) -> list[str]:
    mine = [one for one in findings.agreements if one.detector == detector]
    main = [one for one in mine if one.of_set == findings.main.name]
    if not main:
        return [f"{detector}: too few cars or frames of {findings.main.name} in its range for intervals"]
    first = main[0]
    width = max(len(one.metric) for one in main)
    lines = [
        f"{detector}, {first.of_set}: {first.cars} cars, {first.clusters.number} resampled {_units(first)}; "
        f"with confidence x IoU, 90 % intervals{_NARROW if first.clusters.too_narrow else ''}",
        f"{'':{width}}  " + "  ".join(f"{name:{wide}}" for name, wide in _TABLE.items()).rstrip(),
    ]
    for one in main:
        statistics = one.statistics
        cells = (
            statistics["spearman"],
            statistics["partial_spearman"],
            statistics["pearson"],
            one.groups["bins_10m"].pearson,
            statistics["isotonic_r2"],
        )
        texts = [f"{cell.text():{wide}}" for cell, wide in zip(cells, _TABLE.values(), strict=True)]
        lines.append(f"{one.metric:{width}}  " + "  ".join(texts).rstrip())
    for name in dict.fromkeys((first.metric, PAPERS)):
        lines += [line for one in main if one.metric == name for line in (_followed(one), *_rivals(main, name))]
    return lines + _elsewhere(mine, first.metric, first.of_set)


def _elsewhere(mine: Sequence[Agreement], name: str, of_main: str) -> list[str]:
    """What the other sets say of one metric."""
    lines = []
    for one in mine:
        if one.metric == name and one.of_set != of_main:
            learned = ", learned from" if one.of_set == TRAINING else ""
            better = [rival.metric for rival in mine if rival.of_set == one.of_set and _better(rival, name)]
            lines.append(
                f"  {one.of_set} ({one.cars} cars, {one.clusters.number} {_units(one)}{learned}): "
                f"{one.statistics['spearman'].text()}, given distance and occlusion "
                f"{one.statistics['partial_spearman'].text()}; better after Holm: {', '.join(better) or 'none'}"
            )
    return [f"Spearman of {name} on other sets:", *lines] if lines else []


def _better(rival: Agreement, name: str) -> bool:
    return name in rival.against and rival.against[name]["spearman"].p_holm < _SIGNIFICANT


def _rivals(main: Sequence[Agreement], name: str) -> list[str]:
    """How the others do beside one metric."""
    held = {one.metric: one.against[name] for one in main if name in one.against}
    told = {metric: of["spearman"] for metric, of in held.items() if math.isfinite(of["spearman"].difference.p_above)}
    if not told:
        return []
    number = len({(of.difference, of.p_holm) for of in told.values()})  # orders of the cars: twins count once
    many = f"{number} rival{'s' * (number != 1)}"
    better = {metric: of for metric, of in told.items() if of.difference.p_above < _SIGNIFICANT}
    kept = {metric: of for metric, of in better.items() if of.p_holm < _SIGNIFICANT}
    lines = [f"None of {many} is significantly better in Spearman than {name} after Holm's correction."]
    if kept:
        said = ", ".join(f"{metric} by {_signed(of.difference)}" for metric, of in kept.items())
        narrow = f", by intervals{_NARROW}" if main[0].clusters.too_narrow else ""
        lines = [f"Significantly better in Spearman than {name}, with Holm's correction for {many}{narrow}: {said}."]
    if len(better) > len(kept):
        said = ", ".join(
            f"{metric} by {_signed(of.difference)}, p {of.difference.p_above:.3f}"
            for metric, of in better.items()
            if metric not in kept
        )
        lines.append(f"Better only without that correction: {said}.")
    worse = {metric for metric, of in told.items() if of.difference.high < 0.0}
    if worse:
        open_yet = [
            f"{metric} {_signed(of.difference)}" for metric, of in told.items() if metric not in {*worse, *better}
        ]
        beside = f"; cannot be told apart from it: {', '.join(open_yet)}" if open_yet else ""
        lines.append(f"Below it, by intervals that leave out 0: {len(worse)} of {len(told)}{beside}.")
    straighter = [metric for metric, of in held.items() if of["pearson"].p_holm < _SIGNIFICANT]
    if straighter:
        lines.append(f"More linear in the detector (Pearson, after Holm): {', '.join(straighter)}.")
    return lines


def _followed(one: Agreement) -> str:
    rank, given = one.statistics["spearman"], one.statistics["partial_spearman"]
    if not math.isfinite(rank.low):
        return f"{one.metric}: Spearman {rank.text()}, no interval."
    follows = "follows" if rank.low > 0.0 else "goes against" if rank.high < 0.0 else "cannot be shown to follow"
    return (
        f"{one.metric} {follows} {one.detector} car by car: Spearman {rank.text()}; beyond what distance and occlusion "
        f"tell: {given.text()}. Bins of 10 m: Pearson {_of_bins(one)}."
    )


def _of_bins(one: Agreement) -> str:
    means = one.groups["bins_10m"]
    return f"{means.pearson.text(3)} over {means.number} means"


def _by_distance(findings: Findings) -> list[str]:
    mine = [one for one in findings.shapes if one.of_set == findings.main.name and one.bearing == ANY]
    if not mine:
        return []
    lines = [f"With distance ({findings.main.name}; out-of-fold R2 of a straight line less that of a logarithm):"]
    for text, chosen in (
        ("falls linearly", [one for one in mine if one.lead.low > 0.0]),
        ("falls logarithmically", [one for one in mine if one.lead.high < 0.0]),
        ("either fits", [one for one in mine if one.lead.low <= 0.0 <= one.lead.high]),
    ):
        if chosen:
            lines.append(f"  {text}: " + ", ".join(f"{one.quantity} {_signed(one.lead, 2)}" for one in chosen))
    by_bearing = [
        one
        for one in findings.shapes
        if one.of_set == findings.main.name
        and one.bearing != ANY
        and math.isfinite(one.lead.value)
        and (one.quantity in (findings.metrics[0].name, PAPERS) or one.quantity.endswith(PERFORMANCE))
    ]
    if by_bearing:
        said = ", ".join(f"{one.quantity} {one.bearing} {_signed(one.lead, 2)} ({one.cars} cars)" for one in by_bearing)
        lines.append(f"  by bearing: {said}")
    return lines


def _ground(findings: Findings) -> list[str]:
    name = findings.metrics[0].name
    ours = [one for one in findings.without_ground if one.metric == name and math.isfinite(one.change.value)]
    if not ours:
        return []
    kept = findings.other_clearance_m == 0.0
    less = f"Without returns under {findings.other_clearance_m:g} m above floors"
    what = "With ground returns kept" if kept else less
    said = "; ".join(f"{one.detector} {one.spearman.text()}, {_signed(one.change)}" for one in ours)
    return [f"{what}, {name} has Spearman: {said}."]


def _speed(findings: Findings) -> list[str]:
    each = speed(findings)
    read, assign, score = (each[stage]["ms_per_frame"] for stage in ("read", "assign", "pe_vgop"))
    ours, every, paper = (_milliseconds(each[name]) for name in ("file_to_pe_vgop", "file_to_all_metrics", "paper"))
    return [
        f"PE-VGOP from file to score, processor time: {ours} (reading {read:.2f}, assigning {assign:.2f}, scoring "
        f"{score:.2f} ms a frame); all metrics {every}.",
        f"The paper: {PAPER['seconds']:.0f} s for {PAPER['frames']:,} frames, {paper}; it names no machine.",
    ]


def _milliseconds(each: dict[str, float]) -> str:
    return f"{each['ms_per_frame']:.2f} ms a frame, {each['ms_per_car']:.2f} ms a car"


def _cautions(findings: Findings) -> list[str]:
    lines = []
    narrow = list(dict.fromkeys(one.of_set for one in findings.agreements if one.clusters.too_narrow))
    if narrow:
        lines.append(
            f"Too narrow: the intervals of {', '.join(narrow)}. Frames of one drive show the same cars again, and no "
            "drives, or fewer than three, are told that could be resampled."
        )
    elif "drive" not in findings.judged.about:
        lines.append("Nothing tells which frames are of one drive; if some are, intervals are too narrow.")
    if any(one.name == TRAINING for one in findings.sets):
        lines.append(f"Frames of {TRAINING} are those that detectors and priors learned from: no test of them.")
    if (findings.judged.cars.boxes.occlusion == NOT_TOLD).all():
        lines.append("The labels tell no occlusion: where it is said to be held fixed, distance alone is.")
    if findings.untaught:
        lines.append(f"Left out, as no frame of split {TRAINING} can teach them: {', '.join(findings.untaught)}.")
    return lines


def _units(one: Agreement) -> str:
    return {"frame": "frames", "drive": "drives"}.get(one.clusters.unit, f"blocks of {one.clusters.unit}")


def _signed(one: Difference, digits: int = 3) -> str:
    if not math.isfinite(one.low):
        return f"{one.value:+.{digits}f}"
    return f"{one.value:+.{digits}f} ({one.low:+.{digits}f} to {one.high:+.{digits}f})"
