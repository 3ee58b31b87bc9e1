"""The report of `chart`: time against accuracy of every fidelity, and what of the model a scene needs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..metrics.catalogue import metric_named
from ..scene.mounting import COORDINATE_NAMES
from ..studies.chart import milliseconds
from ..studies.driver import percent
from .figure import BASELINE_LOOK, FAINT, INK, OPTIMISED_LOOK, SMALL_PT, legend_below, sheet
from .study import Section, StudyReport

if TYPE_CHECKING:
    from matplotlib.axes import Axes


# --- the picture: error over time of every fidelity; those on the Pareto front and the recommended one are named ------

# By level of detail, which differ in lightness where print is grey, and in the marker without colour.
_LOOKS = {
    "box": {"marker": "s", "color": "#8fb4da"},
    "body": {"marker": "o", "color": "#3d77b8"},
    "detailed": {"marker": "^", "color": OPTIMISED_LOOK["color"]},
}
_HEIGHT_MM = 175.0
_MARGIN = 0.05  # of the errors' range, above and below it
_MARKER_PT, _RING_PT = 4.0, 7.5  # from the middle of a point to its name
_QUARTILES = ("first_quartile", "median", "third_quartile")
_ABBREVIATED = "1/4: every 4th column; 8f: 8 frames"


def draw_chart(path: str | Path, result: Mapping) -> bool:
    """Draw error over the logarithm of time as a PNG; returns whether there is anything to draw."""
    rows = result["rungs"]
    if not rows:
        return False
    gain, noise, unit = result["gain_per_vehicle"], result["noise"], result["metric_unit"]
    tolerance = result["tolerance"] * gain if gain > 0.0 else None
    times = np.array([[row["milliseconds"][key] for key in _QUARTILES] for row in rows])
    places = np.column_stack([times[:, 1], [row["error"] for row in rows]])
    front = sorted(tuple(place) for row, place in zip(rows, places.tolist(), strict=True) if row["pareto"])
    best = [row["name"] == result["recommended"] for row in rows]
    about = f"{result['mountings']} mountings, {result['frames']} frames; reference: {result['reference']}"
    subtitle = f"{result['sensor']}, {result['scene']}: {about}. {_ABBREVIATED}"
    with sheet(path, _HEIGHT_MM, "Speed against accuracy", subtitle) as figure:
        from matplotlib.ticker import LogLocator

        error = "Error after calibration" + (f" [{unit} per vehicle]" if unit else "")
        axes = figure.add_subplot(
            xscale="log", xlabel="One evaluation: median of the times [ms]; bars: quartiles", ylabel=error
        )
        handles = [*_limits(axes, noise, tolerance), *_points(axes, rows, times, places, front)]
        ring = {"marker": "o", "markersize": 11.0, "markerfacecolor": "none", "markeredgewidth": 1.5, "zorder": 4}
        look = {"color": BASELINE_LOOK["color"], "linestyle": "none", "label": "recommended"}
        handles += axes.plot(*places[best].T, **ring, **look) if any(best) else []
        most = max(places[:, 1].max(), noise["error_90"][1] if noise else 0.0, tolerance or 0.0) or 1.0
        spread = places[:, 0].min() / 2.5, places[:, 0].max() * 1.6
        axes.set(xlim=spread, ylim=(-_MARGIN * most, (1.0 + _MARGIN) * most))
        axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axes.xaxis.set_major_formatter("{x:g}")
        axes.minorticks_off()
        axes.grid(visible=True)
        legend_below(figure, handles, columns=4)
        figure.canvas.draw()  # places are now known in pixels
        _name_points(axes, rows, places, best)
    return True


def _limits(axes: Axes, noise: Mapping | None, tolerance: float | None) -> list:
    """The noise ceiling and the tolerance; returns what stands in the legend."""
    handles = []
    if noise is not None:
        look = {"color": FAINT, "alpha": 0.4, "linewidth": 0.0}
        label = "reference, half of the blocks against the others"
        handles.append(axes.axhspan(*noise["error_90"], label=label, **look))
        axes.axhline(noise["error"], color=FAINT, linewidth=1.0)
    if tolerance is not None:
        look = {"color": INK, "linestyle": ":", "linewidth": 0.9}
        handles.append(axes.axhline(tolerance, label="tolerance", **look))
    return handles


def _points(axes: Axes, rows: Sequence[Mapping], times: np.ndarray, places: np.ndarray, front: Sequence) -> list:
    """The Pareto front, and every fidelity with its quartiles; as `_limits`."""
    handles = axes.step(*zip(*front, strict=True), "-", where="post", color=INK, linewidth=0.9, label="Pareto front")
    style = {"linestyle": "none", "markersize": 4.2, "zorder": 3}
    for detail, look in _LOOKS.items():
        some = [row["detail"] == detail for row in rows]
        if any(some):
            axes.hlines(places[some, 1], times[some, 0], times[some, 2], colors=look["color"], linewidth=0.7, zorder=2)
            handles += axes.plot(*places[some].T, label=detail, **style, **look)
    return handles


def _name_points(axes: Axes, rows: Sequence[Mapping], places: np.ndarray, best: Sequence[bool]) -> None:
    """Name the front's points to their lower left, where no other can be, and the recommended one if not among them."""
    look, before = {"textcoords": "offset points", "fontsize": SMALL_PT, "color": INK}, None
    for row, place, chosen in sorted(zip(rows, places.tolist(), best, strict=True), key=lambda one: one[1]):
        if row["pareto"]:
            left = _RING_PT if chosen else _MARKER_PT
            name = axes.annotate(row["name"], place, (-left, -2.0), ha="right", va="top", **look)
            box = name.get_window_extent()
            if before is not None and box.x0 < before.x1 and box.y1 > before.y0:  # lower, clear of the name before
                name.xyann = -left, -2.0 - (box.y1 - before.y0) * 72.0 / axes.figure.dpi
            before = name.get_window_extent()
        elif chosen:
            axes.annotate(row["name"], place, (_RING_PT, _MARKER_PT), weight="bold", **look)


# --- the report: the fidelities, what the scene needs, and whether the recommendation holds ---------------------------

_LADDER = ("fidelity", "one evaluation", "quartiles", "faster", "bias", "error", "of the gain", "tau", "regret", "")
_ABLATIONS = ("modelled", "", "bias", "tau", "best moves by", "left out it costs", "beyond noise", "verdict")


def _sections(result: Mapping) -> list[Section]:
    """What `chart_study` came to."""
    return [
        Section("", (), _head(result)),
        Section("The ladder", [_LADDER, *(_rung(row, result) for row in result["rungs"])], [_asked(result)]),
        Section("What the scene needs", [_ABLATIONS, *map(ablation_cells, result["ablations"])], [_floor(result)]),
    ]


def _head(result: Mapping) -> list[str]:
    unit = f"{result['metric_unit'] or '1'} per vehicle"
    if metric_named(result["metric"]).of_share:
        unit = "of the vehicles"
    judge = "judge" if result["judged_on"] == "held out" else "chose them, as none is held out"
    return [
        f"{result['sensor']}, range gate {result['range_gate_m']:g} m, {result['caster']}; {result['frames']} searched "
        f"frames in {result['blocks']} blocks choose, {result['judged_frames']} {result['judged_on']} ones in "
        f"{result['judged_blocks']} blocks judge; {result['mountings']} mountings of Sobol's sequence",
        f"Reference: {result['rungs'][0]['text']}; the best mounting gains {result['gain_per_vehicle']:.4f} {unit} "
        "over the baseline",
        f"Errors and biases are in {unit}, errors after one affine calibration fitted on the other half of "
        "the mountings; tau weighs the best mountings most; regret is what choices on resampled traffic lose to the "
        f"reference's on frames that {judge}, as a share of the gain, with its 90 % interval",
        f"Noise ceiling, the reference on one half of the blocks against the other: {_halves(result['noise'])}",
    ]


def _halves(noise: Mapping | None) -> str:
    """What the reference on one half of the blocks is off from itself on the other."""
    if noise is None:
        return "too few blocks for one"
    low, high = noise["error_90"]
    return (
        f"bias {noise['bias']:.4f}, error {noise['error']:.4f} ({low:.4f} to {high:.4f}), tau {noise['tau']:.3f}, "
        f"choices apart by {percent(noise['apart'])} of the gain"
    )


def _rung(row: Mapping, result: Mapping) -> tuple[str, ...]:
    """A row of the table of fidelities."""
    first, median, third = (milliseconds(row["milliseconds"][key]) for key in _QUARTILES)
    marks = [
        "reference" if row["name"] == result["reference"] else "",
        "recommended" if row["name"] == result["recommended"] else "within" if row["within"] else "",
        "front" if row["pareto"] else "",
    ]
    scores = (
        _number(row["bias"], "+.4f"),
        _number(row["error"]),
        percent(row["error_share"]),
        _number(row["tau"], ".3f"),
    )
    lost = percent(row["regret"], row["regret_interval_90"])
    return (
        row["name"],
        median,
        f"{first} to {third}",
        f"{row['speedup']:.2g} x",
        *scores,
        lost,
        ", ".join(filter(None, marks)),
    )


def _number(value: float | None, form: str = ".4f") -> str:
    """A number in that form, no zero below 0; nothing for None."""
    return "" if value is None else f"{round(value, 4) + 0.0:{form}}"


def ablation_cells(row: Mapping) -> tuple[str, ...]:
    """A row of the table of ablations."""
    draws = f"; mean of {row['draws']} draws" if row["draws"] > 1 else ""
    what = (row["what"], row["value"] + draws)
    if row["bias"] is None:
        return (*what, row["note"], *[""] * 5)
    by_key = ((key.rpartition("."), round(by, 2) + 0.0) for key, by in row["shift"].items())
    moved = ", ".join(f"{name} {by:+.2f} {COORDINATE_NAMES[key][1]}".lstrip() for (name, _, key), by in by_key)
    costs, beyond = percent(row["regret"], row["regret_interval_90"]), row["beyond_noise"]
    names = "not known" if beyond is None else ", ".join(name for name, so in beyond.items() if so) or "nothing"
    return (*what, _number(row["bias"], "+.4f"), _number(row["tau"], ".3f"), moved, costs, names, row["verdict"])


def _floor(result: Mapping) -> str:
    """What the ablations are compared with."""
    return (
        f"Ablations, on the {result['ablation_mountings']} best mountings by the reference; their noise, half of the "
        f"blocks against the other: {_halves(result['ablation_floor'])}. A thing is needed where what is lost without "
        f"it is surely more than {100 * result['tolerance']:g} % of the gain, and not needed where it is surely less, "
        "by the 90 % interval"
    )


def _asked(result: Mapping) -> str:
    asked = [row["name"] for row in result["rungs"] if row["asked"] and row["name"] != result["reference"]]
    sure = f": where held-out frames judge, with {100 * result['sure']:g} % none that passes loses more than that"
    return (
        "Near enough is asked of each level of detail from all beams to the fewest, up to the first fidelity that "
        f"cannot be shown to be: here of {len(asked)} ({', '.join(asked)}), by upper bounds of regret at "
        f"{100 * result['bound_level']:.1f} %{sure if result['judged_on'] == 'held out' else ''}"
    )


CHART_REPORT = StudyReport(
    title="Speed against accuracy",
    result="chart.json",
    tables={
        "chart.csv": lambda result: result["rungs"],
        "ablation.csv": lambda result: result["ablations"],
    },
    pictures={"chart.png": draw_chart},
    sections=_sections,
    answer=lambda result: [result["sentence"]],
)
