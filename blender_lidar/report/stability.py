"""The stability of a scene's answer as pictures, text and files: a section for each thing varied, a line a finding."""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np

from ..metrics.catalogue import metric_named
from ..studies.driver import StudyFolder
from ..studies.findings import ASKED_DEG, MOST_FRAGILE_LOSS, MOST_STABLE_LOSS, RULE, UNDECIDED, VERDICTS, worst
from ..studies.variations import METRIC, MOUNTING, SEARCH, SECTIONS, SENSOR, TRAFFIC
from .figure import BASELINE, FAINT, INK, OPTIMISED, SMALL_PT, legend_below, sheet
from .study_files import WIDTH, markdown_table, wrapped, write_study

CHANGES, OFF_PLAN, SAMPLE_SIZE = "changes.png", "off_plan.png", "sample_size.png"
RESULT, REPORT, TABLE = "stability.json", "report.md", "stability.csv"
FILES = (RESULT, REPORT, TABLE, CHANGES, OFF_PLAN, SAMPLE_SIZE)


def write_results(folder: StudyFolder, result: Mapping) -> list[str]:
    """Write table, pictures, report and result; returns the names of the files."""
    keys = ("section", "what", "value", "verdict", "text")
    rows = [{key: one[key] for key in keys} | {"loss": one["numbers"].get("loss", "")} for one in result["findings"]]

    def draw() -> list[str]:
        return draw_charts(result, folder.file)

    return write_study(folder, result, (REPORT, RESULT), {TABLE: rows}, draw, report_markdown, "no pictures")


def draw_charts(result: Mapping, path: Callable[[str], Path]) -> list[str]:
    """Draw what there is to draw, each into the file that `path` gives for its name; returns the names."""
    mount = result["mounting"]
    about = f"{result['sensor']} at {mount['height_m']:.2f} m, {mount['tilt_x_deg']:.1f} deg; {result['scene']}"
    pictures = {CHANGES: draw_changes, OFF_PLAN: draw_profiles, SAMPLE_SIZE: draw_sample_size}
    return [name for name, draw in pictures.items() if draw(path(name), result, about)]


def _numbers_with(result: Mapping, key: str) -> Mapping:
    """The numbers of the only finding that has this one; none without it."""
    return next((one["numbers"] for one in result["findings"] if key in one["numbers"]), {})


def _name(finding: Mapping, between: str = ", ") -> str:
    return between.join(filter(None, (finding["what"], finding["value"])))


# --- the pictures; each tells whether there is anything to draw -------------------------------------------------------

# Told apart in grey by lightness, and without any colour by the marker.
VERDICT_LOOKS = {
    "stable": {"color": OPTIMISED["color"], "marker": "o"},
    "fragile": {"color": "#5b8fc7", "marker": "^"},
    "fails": {"color": BASELINE["color"], "marker": "s", "markerfacecolor": "white"},
}
_MOST_PERCENT = 100.0  # a loss beyond is drawn at the rim
_LINEAR_PERCENT = 1.0
_ROW_MM, _HEADING_MM = 3.7, 40.0
_LINE = {"color": OPTIMISED["color"], "marker": "o"}
_OFF_PLAN = {  # of a coordinate: its name on an axis, and which tolerance is its own
    "height_m": ("Height [m]", "height_m"),
    "tilt_x_deg": ("Tilt across [deg]", "tilt_deg"),
    "tilt_y_deg": ("Tilt along [deg]", "tilt_deg"),
    "yaw_deg": ("Yaw [deg]", "yaw_deg"),
}


def draw_changes(path: str | Path, result: Mapping, about: str) -> bool:
    """A row for each change: what the mounting loses, and where the optimum would be under each draw of it.

    A loss beyond the rim is drawn on it; shaded is where other traffic puts the optimum of the scene as it is.
    """
    changes = [
        one for one in result["findings"] if one["verdict"] in VERDICT_LOOKS and "best_tilt_deg" in one["numbers"]
    ]
    if not changes:
        return False
    interval = _numbers_with(result, "tilt_interval_90_deg").get("tilt_interval_90_deg")
    limits = [100.0 * MOST_STABLE_LOSS, 100.0 * MOST_FRAGILE_LOSS]
    title = "What the mounting loses when one thing changes"
    with sheet(path, _HEADING_MM + _ROW_MM * len(changes), title, about) as figure:
        from matplotlib.lines import Line2D

        lost, moved = figure.subplots(1, 2, sharey=True, width_ratios=(1.25, 1.0))
        for row, one in enumerate(changes):
            look = VERDICT_LOOKS[one["verdict"]]
            loss, tilts = 100.0 * one["numbers"]["loss"], one["numbers"]["best_tilt_deg"]
            ends = 100.0 * np.array(one["numbers"]["interval_90"] or [one["numbers"]["loss"]] * 2)
            rim = float(np.clip(loss, -_MOST_PERCENT, _MOST_PERCENT))
            for axes, middle, span in ((lost, rim, ends), (moved, float(np.mean(tilts)), (min(tilts), max(tilts)))):
                axes.plot(span, [row, row], color=look["color"], linewidth=1.2, zorder=2)
                axes.plot(middle, row, linestyle="none", markersize=4.0, clip_on=False, zorder=3, **look)
        for limit in limits:
            lost.axvline(limit, color=INK, linewidth=0.8, linestyle="--")
        lost.set_xscale("symlog", linthresh=_LINEAR_PERCENT)
        lost.set_xlim(-0.3 * _MOST_PERCENT, _MOST_PERCENT)
        lost.axvline(0.0, color=INK, linewidth=0.8)
        ticks = [-10.0, -1.0, 0.0, 1.0, *limits, _MOST_PERCENT]
        lost.set_xticks(ticks, [f"{tick:g}" if tick < _MOST_PERCENT else f"{tick:g}+" for tick in ticks])
        lost.minorticks_off()
        lost.set_xlabel("Loss of the mounting [% of the gain]")
        if interval is not None:
            moved.axvspan(*interval, color=FAINT, alpha=0.45, linewidth=0.0)
        moved.axvline(result["mounting"]["tilt_x_deg"], color=INK, linewidth=0.8, linestyle="--")
        moved.set_xlabel("Best tilt under the change [deg]")
        lost.set_yticks(range(len(changes)), [_name(one, ": ") for one in changes], fontsize=SMALL_PT)
        lost.tick_params(axis="y", length=0.0)
        lost.set_ylim(len(changes) - 0.4, -0.6)
        for row in range(1, len(changes)):
            if changes[row]["section"] != changes[row - 1]["section"]:
                lost.axhline(row - 0.5, color=INK, linewidth=0.6, xmin=-0.7, clip_on=False)
        for axes in (lost, moved):
            axes.grid(visible=True, axis="x")
            axes.grid(visible=True, axis="y", linewidth=0.3)
        handles = [
            Line2D([], [], linestyle="none", markersize=4.0, label=name, **look) for name, look in VERDICT_LOOKS.items()
        ]
        handles.append(Line2D([], [], color=INK, linewidth=0.8, linestyle="--", label="limits; the mounting"))
        if interval is not None:
            handles.append(Line2D([], [], color=FAINT, linewidth=6.0, label="90 % of optima on other traffic"))
        legend_below(figure, handles, columns=len(handles))
    return True


def draw_profiles(path: str | Path, result: Mapping, about: str) -> bool:
    """Share of the gain that is kept with one coordinate at a time off its plan; shaded is what an installer keeps."""
    if not result["profiles"]:
        return False
    with sheet(path, 66.0, "The mounting off its plan", about) as figure:
        every = np.atleast_1d(figure.subplots(1, len(result["profiles"]), sharey=True))
        for axes, (key, of) in zip(every, result["profiles"].items(), strict=True):
            name, tolerance = _OFF_PLAN[key]
            width = result["tolerance"][tolerance]
            if width:
                axes.axvspan(-width, width, color=FAINT, alpha=0.45, linewidth=0.0)
            axes.plot(of["offset"], 100.0 * np.array(of["kept"]), markersize=3.0, linewidth=1.2, **_LINE)
            axes.axhline(100.0, color=INK, linewidth=0.8, linestyle="--")
            axes.set_xlabel(name)
            axes.grid(visible=True)
        figure.axes[0].set_ylabel("Gain kept [%]")
    return True


def draw_sample_size(path: str | Path, result: Mapping, about: str) -> bool:
    """Half of the best tilt's 90 % interval over the number of vehicle observations, and how many are needed."""
    found = _numbers_with(result, "reach_deg")
    if not found:
        return False
    vehicles, reach, power, needed = (found[key] for key in ("vehicles", "reach_deg", "power", "needed"))
    with sheet(path, 78.0, "How many vehicles make the best tilt certain", about) as figure:
        axes = figure.subplots()
        handles = axes.plot(vehicles, reach, markersize=4.0, label="samples of the traffic at hand", **_LINE)
        ahead = np.geomspace(vehicles[-1], max(needed, vehicles[-1]) * 1.5, 50)
        look = {"color": OPTIMISED["color"], "linestyle": ":", "label": f"as its power {-power:.2f} from there on"}
        handles += axes.plot(ahead, reach[-1] * (ahead / vehicles[-1]) ** -power, **look)
        asked = {"color": INK, "linestyle": "--", "linewidth": 0.8, "label": f"{ASKED_DEG:g} deg"}
        handles.append(axes.axhline(ASKED_DEG, **asked))
        if needed > vehicles[-1]:
            look = {**BASELINE, "linestyle": "none", "label": "asked for"}
            handles += axes.plot(needed, ASKED_DEG, clip_on=False, **look)
        axes.set_xscale("log")
        axes.xaxis.set_major_formatter(lambda count, _: f"{count:,.0f}")
        axes.minorticks_off()
        axes.set_ylim(bottom=0.0)
        axes.set_xlabel("Vehicle observations")
        axes.set_ylabel("Uncertainty of the best tilt [deg]")
        axes.grid(visible=True)
        legend_below(figure, handles, columns=len(handles))
    return True


# --- the report -------------------------------------------------------------------------------------------------------

HEADINGS = {
    TRAFFIC: "Traffic",
    MOUNTING: "Mounting tolerance",
    METRIC: "Metric",
    SENSOR: "Sensor",
    SEARCH: "Search",
}


_COLUMNS = ("what", "to what", "verdict", "found")


def report_text(result: Mapping) -> str:
    """What `study_stability` came to, for a terminal."""
    parts = [*wrapped(_head(result)), ""]
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
            rows = [[one[key] for key in ("what", "value", "verdict", "text")] for one in findings]
            parts += ["", f"## {HEADINGS[section]}", "", *markdown_table([_COLUMNS, *rows])]
    return "\n".join([*parts, "", *(f"- {line}" for line in _verdicts(result)), ""])


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
        wrapped = textwrap.wrap(one["text"], WIDTH - 12 - width) or [""]
        lines += [start + wrapped[0], *(" " * (12 + width) + more for more in wrapped[1:])]
    return lines


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
