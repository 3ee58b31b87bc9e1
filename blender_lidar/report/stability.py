"""The report of `stability`: a section for each sort of thing that is varied, a line a finding, and a picture."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from ..metrics.catalogue import metric_named
from ..run.words import of_name, place_text
from ..scene.deployment import variable_of
from ..studies.findings import (
    AT_LEAST_FRAGILE,
    AT_MOST_FRAGILE,
    FAILS,
    FRAGILE,
    SHARE_LIMITS,
    STABLE,
    UNDECIDED,
    VERDICT_RULE,
    VERDICTS,
    by_name,
    worst,
)
from ..studies.variations import SECTIONS
from .figure import BASELINE_LOOK, FAINT, INK, OPTIMISED_LOOK, SMALL_PT, legend_below, sheet
from .study import Section, StudyReport


def _numbers_with(result: Mapping, key: str) -> Mapping:
    """The numbers of the only finding that has this one; none without it."""
    return next((one["numbers"] for one in result["findings"] if key in one["numbers"]), {})


def _name(finding: Mapping, between: str = ", ") -> str:
    return between.join(filter(None, (finding["what"], finding["value"])))


def _tilt(result: Mapping) -> str:
    """Key of what a mounting looks down by: its lean where the scene is given by it, else its tilt across the road."""
    return "lean_deg" if result.get("leans") else "tilt_x_deg"


def _mounts(result: Mapping) -> Mapping[str, Mapping]:
    """Where each LiDAR of the layout in question hangs, by its name."""
    return by_name(result["mounting"], result.get("lidars", ()))


def _about(result: Mapping) -> str:
    mounts = (
        f"{name} at {mount['height_m']:.2f} m, {mount[_tilt(result)]:.1f} deg".lstrip()
        for name, mount in _mounts(result).items()
    )
    return f"{result['sensor']}{':' if result.get('lidars') else ''} {', '.join(mounts)}; {result['scene']}"


# --- the picture ------------------------------------------------------------------------------------------------------

# They differ in lightness where print is grey, and in the marker without any colour.
VERDICT_LOOKS = {
    STABLE: {"color": OPTIMISED_LOOK["color"], "marker": "o"},
    AT_MOST_FRAGILE: {"color": OPTIMISED_LOOK["color"], "marker": "o", "markerfacecolor": "white"},
    FRAGILE: {"color": "#5b8fc7", "marker": "^"},
    AT_LEAST_FRAGILE: {"color": BASELINE_LOOK["color"], "marker": "^", "markerfacecolor": "white"},
    FAILS: {"color": BASELINE_LOOK["color"], "marker": "s", "markerfacecolor": "white"},
    UNDECIDED: {"color": "0.55", "marker": "x"},
}
_LEAST_POINTS, _MOST_POINTS = -30.0, 100.0  # a loss beyond is drawn at the rim
_LINEAR_POINTS = 1.0
_ROW_MM, _HEADING_MM = 3.7, 40.0


def draw_changes(path: str | Path, result: Mapping) -> bool:
    """A row for each change: the detectable share that is lost, and where the optimum would be under each draw of it.

    A loss beyond the rim is drawn on it; shaded is where other traffic puts the optimum of the scene as it is. False
    where there is nothing to draw.
    """
    mounts = _mounts(result)
    best_tilts, optima = (
        [variable_of(name, key) for name in mounts] for key in ("best_tilt_deg", "tilt_interval_90_deg")
    )
    changes = [one for one in result["findings"] if best_tilts[0] in one["numbers"]]
    if not changes:
        return False
    intervals = _numbers_with(result, optima[0])
    limits = [100.0 * limit for limit in SHARE_LIMITS]
    title = "What one change costs, and where the best tilt would be"
    with sheet(path, _HEADING_MM + _ROW_MM * len(changes), title, _about(result)) as figure:
        from matplotlib.lines import Line2D

        widths = (1.25, *[1.0 / len(mounts)] * len(mounts))
        lost, *moved = figure.subplots(1, len(widths), sharey=True, width_ratios=widths)
        for row, one in enumerate(changes):
            look, found = VERDICT_LOOKS[one["verdict"]], one["numbers"]
            loss, tilts = found["detectable_share_lost"], [found[key] for key in best_tilts]
            ends = 100.0 * np.array(found["detectable_share_lost_interval_90"] or [loss] * 2)
            rim = float(np.clip(100.0 * loss, _LEAST_POINTS, _MOST_POINTS))
            best = [(float(np.mean(own)), (min(own), max(own))) for own in tilts]
            for axes, (middle, span) in zip((lost, *moved), ((rim, ends), *best), strict=True):
                axes.plot(span, [row, row], color=look["color"], linewidth=1.2, zorder=2)
                axes.plot(middle, row, linestyle="none", markersize=4.0, clip_on=False, zorder=3, **look)
            if row and one["section"] != changes[row - 1]["section"]:
                lost.axhline(row - 0.5, color=INK, linewidth=0.6, xmin=-0.7, clip_on=False)
        limit = {"color": INK, "linewidth": 0.8, "linestyle": "--"}
        for axes, at in zip((lost, *moved), (limits, *([one[_tilt(result)]] for one in mounts.values())), strict=True):
            for x in at:
                axes.axvline(x, **limit)
            axes.grid(visible=True, axis="x")
            axes.grid(visible=True, axis="y", linewidth=0.3)
        lost.set_xscale("symlog", linthresh=_LINEAR_POINTS)
        lost.set(xlim=(_LEAST_POINTS, _MOST_POINTS), xlabel="Loss of detectable share [percentage points]")
        lost.axvline(0.0, color=INK, linewidth=0.8)
        ticks = [-10.0, -1.0, 0.0, *limits, 20.0, _MOST_POINTS]
        lost.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
        lost.minorticks_off()
        best = f"Best {_tilt(result).split('_')[0]} under the change [deg]"
        for name, axes in zip(mounts, moved, strict=True):
            axes.set_xlabel(f"{name}: best [deg]" if name else best)
        lost.set_yticks(range(len(changes)), [_name(one, ": ") for one in changes], fontsize=SMALL_PT)
        lost.tick_params(axis="y", length=0.0)
        lost.set_ylim(len(changes) - 0.4, -0.6)
        mark = {"linestyle": "none", "markersize": 4.0}
        handles = [Line2D([], [], label=name, **mark, **look) for name, look in VERDICT_LOOKS.items()]
        handles.append(Line2D([], [], label="limits; the mounting", **limit))
        if intervals:
            for axes, key in zip(moved, optima, strict=True):
                axes.axvspan(*intervals[key], color=FAINT, alpha=0.45, linewidth=0.0)
            handles.append(Line2D([], [], color=FAINT, linewidth=6.0, label="90 % of optima on other traffic"))
        legend_below(figure, handles, columns=3)
    return True


# --- the report -------------------------------------------------------------------------------------------------------

HEADINGS = dict(zip(SECTIONS, ("Traffic", "Installation errors", "Metric", "Sensor", "Search"), strict=True))
_COLUMNS = ("verdict", "change", "found")
_MOST_NAMED = 4
_JUDGED = {
    "held out": "held-out frames",
    "searched": "same frames, each block of time by mountings that are chosen without it (cross-fitting, as too little "
    "is held out)",
}


def _sections(result: Mapping) -> list[Section]:
    """What `study_stability` came to."""
    sections = [Section("", (), _head(result))]
    for section, findings in _by_section(result).items():
        rows = [(one["verdict"] or "", _name(one), one["text"]) for one in findings]
        sections.append(Section(HEADINGS[section], [_COLUMNS, *rows], ()))
    return sections


def _by_section(result: Mapping) -> dict[str, list[Mapping]]:
    """The findings of each section that has any."""
    of = {section: [one for one in result["findings"] if one["section"] == section] for section in SECTIONS}
    return {section: findings for section, findings in of.items() if findings}


def _head(result: Mapping) -> list[str]:
    metric, mounts = metric_named(result["metric"]), _mounts(result).items()
    leans = bool(result.get("leans"))
    place = "; ".join(of_name(name, place_text(mount, leans=leans)) for name, mount in mounts)
    origin = "as given" if result["mounting_given"] else f"as optimise answers, seed {result['seed']}"
    asked, varied = "Mounting", "the best height and tilt are searched again"
    if result.get("lidars"):
        asked = "Layout"
        varied = "each LiDAR's best height and tilt are searched again while the others are held, and all together,"
    best, base = metric.number(result["objective_per_vehicle"]), metric.number(result["baseline_per_vehicle"])
    return [
        f"{result['sensor']}, {result['frames']} frames, {result['vehicles']:,} vehicle observations, "
        f"{result['caster']}, detail {result['detail']}",
        f"{asked}, {origin}: {place}; {metric.in_unit('objective')} per vehicle {best}, baseline {base}",
        f"Under each change {varied} on {result['varied_frames']} of the searched "
        "frames, with the other coordinates fixed: that is the rival. A loss is its value minus the mounting's, "
        f"on the {result['judged_frames']} {_JUDGED[result['judged_on']]}, with its 90 % interval",
        VERDICT_RULE,
    ]


def _answer(result: Mapping) -> list[str]:
    """The gravest verdict of each section, which lines have it, and how often there is each."""
    lines = []
    for section, findings in _by_section(result).items():
        verdicts = [one["verdict"] for one in findings]
        counts = ", ".join(f"{verdicts.count(verdict)} {verdict}" for verdict in VERDICTS if verdict in verdicts)
        if (gravest := worst(verdicts)) not in (STABLE, AT_MOST_FRAGILE, UNDECIDED):
            named = [_name(one, " ") for one in findings if one["verdict"] == gravest]
            more = "; ..." if len(named) > _MOST_NAMED else ""
            counts = f"at worst {gravest} ({counts}): {'; '.join(named[:_MOST_NAMED])}{more}"
        lines.append(f"{HEADINGS[section]}: {counts}")
    return lines


def _rows(result: Mapping) -> list[dict]:
    """A row a finding: what was found, what the mounting loses, and how sure that is."""
    keys, losses = ("section", "what", "value", "verdict", "text"), ("detectable_share_lost", "objective_lost", "loss")
    return [
        {key: one[key] for key in keys}
        | {key: one["numbers"].get(key) for loss in losses for key in (loss, f"{loss}_interval_90")}
        | {"detectable_share": one["numbers"].get("detectable_share", {})}
        for one in result["findings"]
    ]


STABILITY_REPORT = StudyReport(
    title="How stable is this answer?",
    result="stability.json",
    tables={"stability.csv": _rows},
    pictures={"changes.png": draw_changes},
    sections=_sections,
    answer=_answer,
)
