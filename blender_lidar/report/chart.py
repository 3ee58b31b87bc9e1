"""The chart of a scene as picture, text and files: time against accuracy of every fidelity, and what a scene needs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..errors import InputError
from ..studies.ablations import ABOVE, BELOW, JUDGED, UNTOLD
from ..studies.driver import StudyFolder
from ..studies.ladder import milliseconds
from .figure import BASELINE, FAINT, INK, OPTIMISED, legend_below, name_points, sheet
from .study_files import markdown_table, percent, text_table, wrapped, write_study

if TYPE_CHECKING:
    from matplotlib.axes import Axes

RESULT, REPORT, TABLE, ABLATIONS, PICTURE = "chart.json", "report.md", "chart.csv", "ablation.csv", "chart.png"
FILES = (RESULT, REPORT, TABLE, ABLATIONS, PICTURE)


def write_results(folder: StudyFolder, result: Mapping) -> list[str]:
    """Write tables, picture, report and result; returns the names of the files."""

    def draw() -> list[str]:
        draw_chart(folder.file(PICTURE), result)
        return [PICTURE]

    tables = {name: list(map(_flat, result[key])) for name, key in ((TABLE, "rungs"), (ABLATIONS, "ablations"))}
    return write_study(folder, result, (REPORT, RESULT), tables, draw, report_markdown, "no picture")


def _flat(row: Mapping) -> dict[str, object]:
    """One level of keys: those of a mapping and the ends of an interval get columns of their own; None is empty."""
    flat: dict[str, object] = {}
    for key, value in row.items():
        if isinstance(value, Mapping):
            flat |= {f"{key}_{name}": one for name, one in value.items()}
        elif key.endswith("interval_90"):
            flat |= dict(zip((f"{key}_low", f"{key}_high"), value or (None, None), strict=True))
        else:
            flat[key] = value
    return {key: "" if value is None else value for key, value in flat.items()}


# --- the picture: error over time, every fidelity named, with the Pareto front ----------------------------------------

# By level of detail, told apart in grey by lightness and without colour by the marker.
_LOOKS = {
    "box": {"marker": "s", "color": "#8fb4da"},
    "body": {"marker": "o", "color": "#3d77b8"},
    "detailed": {"marker": "^", "color": OPTIMISED["color"]},
}
_HEIGHT_MM = 175.0
_MARGIN = 0.05  # of the errors' range, above and below it
_MARKER_PT, _RING_PT = 2.6, 6.0  # half the side of what a marker covers
_QUARTILES = ("first_quartile", "median", "third_quartile")
_ABBREVIATED = "1/4: every 4th column; 8f: 8 frames; det.: detailed"


def draw_chart(path: str | Path, result: Mapping) -> None:
    """Draw error over the logarithm of time as a PNG.

    Raises
    ------
    InputError
        If there is nothing to draw.
    """
    rows = [row for row in result["rungs"] if row["error"] is not None]
    if not rows:
        raise InputError("fidelities: none given; at least one is needed")
    gain, noise, unit = result["gain_per_vehicle"], result["noise"], result["metric_unit"]
    tolerance = result["tolerance"] * gain if gain > 0.0 else None
    times = np.array([[row["milliseconds"][key] for key in _QUARTILES] for row in rows])
    places = np.column_stack([times[:, 1], [row["error"] for row in rows]])
    best = [row["name"] == result["recommended"] for row in rows]
    title, about = "Speed against accuracy", f"{result['mountings']} mountings, {result['frames']} frames"
    subtitle = f"{result['sensor']}, {result['scene']}: {about}; reference: {result['reference']}. {_ABBREVIATED}"
    with sheet(path, _HEIGHT_MM, title, subtitle) as figure:
        axes = figure.subplots()
        axes.set_xscale("log")
        handles = _lines(axes, noise, tolerance) + _points(axes, rows, times, places, best)
        most = max(places[:, 1].max(), noise["error_90"][1] if noise else 0.0, tolerance or 0.0) or 1.0
        axes.set_ylim(-_MARGIN * most, (1.0 + _MARGIN) * most)
        axes.set_xlim(places[:, 0].min() / 1.6, places[:, 0].max() * 1.6)
        ticks = _round_numbers(*axes.get_xlim())
        axes.xaxis.set_ticks(ticks, [f"{tick:g}" for tick in ticks])
        axes.xaxis.set_ticks([], minor=True)
        axes.set_xlabel("One evaluation: median of the times [ms]; bars: quartiles")
        axes.set_ylabel(f"Error after calibration [{unit} per vehicle]" if unit else "Error after calibration")
        axes.grid(visible=True)
        figure.canvas.draw()  # places are now known in pixels
        weights = ["bold" if chosen or row["pareto"] else "normal" for row, chosen in zip(rows, best, strict=True)]
        bars = [((first, y), (last, y)) for (first, _, last), y in zip(times, places[:, 1], strict=True)]
        sizes = [_RING_PT if chosen else _MARKER_PT for chosen in best]
        names = [row["name"].replace("detailed", "det.") for row in rows]  # short enough to stand beside a point
        name_points(axes, places, names, weights, sizes, [*bars, *_steps(_front(rows, places))])
        legend_below(figure, handles, columns=4)


def _lines(axes: Axes, noise: Mapping | None, tolerance: float | None) -> list:
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


def _round_numbers(low: float, high: float) -> list[float]:
    """1, 2 and 5 times powers of ten between two numbers."""
    powers = range(int(np.floor(np.log10(low))), int(np.ceil(np.log10(high))) + 1)
    return [digit * 10.0**power for power in powers for digit in (1.0, 2.0, 5.0) if low <= digit * 10.0**power <= high]


def _front(rows: Sequence[Mapping], places: np.ndarray) -> list[tuple[float, float]]:
    return sorted(tuple(place) for row, place in zip(rows, places, strict=True) if row["pareto"])


def _steps(front: Sequence[tuple[float, float]]) -> list[tuple]:
    """The front's line in pieces, from one corner to the next."""
    pieces = []
    for (x, y), (next_x, next_y) in pairwise(front):
        pieces += [((x, y), (next_x, y)), ((next_x, y), (next_x, next_y))]
    return pieces


def _points(axes: Axes, rows: Sequence[Mapping], times: np.ndarray, places: np.ndarray, best: Sequence[bool]) -> list:
    line = {"color": INK, "linewidth": 0.9, "label": "Pareto front", "zorder": 2}
    handles = axes.step(*zip(*_front(rows, places), strict=True), where="post", **line)
    for detail, look in _LOOKS.items():
        some = [number for number, row in enumerate(rows) if row["detail"] == detail]
        if not some:
            continue
        for number in some:
            ends = times[number, [0, 2]]
            axes.plot(ends, [places[number, 1]] * 2, color=look["color"], linewidth=0.7, zorder=2)
        for twin, face in ((False, look["color"]), (True, "white")):
            marks = [number for number in some if (rows[number]["twin"] is not None) == twin]
            style = {"linestyle": "none", "markersize": 4.2, "markerfacecolor": face, "zorder": 3, "label": detail}
            (drawn,) = axes.plot(*places[marks].T, **style, **look)
            handles += [drawn] if not twin else []
    ring = {"marker": "o", "markersize": 11.0, "markerfacecolor": "none", "color": BASELINE["color"]}
    for number in np.flatnonzero(best):
        style = {"linestyle": "none", "markeredgewidth": 1.5, "zorder": 4, "label": "recommended"}
        handles += axes.plot(*places[number], **style, **ring)
    return handles


# --- the ablations as text: a row for each, and what the scene needs in a few lines -----------------------------------


def number(value: float | None, digits: int = 4) -> str:
    """So many digits after the point; nothing for None."""
    return "" if value is None else f"{value:.{digits}f}"


def signed(value: float | None) -> str:
    """Four digits and the sign, which 0 has too."""
    return "" if value is None else f"{round(value, 4) + 0.0:+.4f}"


HEADER = (
    "modelled",
    "",
    "bias",
    "error",
    "tau",
    "best moves by",
    "left out it costs",
    "choices apart",
    "beside the noise floor",
)
_UNITS = {"_m": "m", "_deg": "deg"}


def ablation_cells(row: Mapping) -> tuple[str, ...]:
    """A row under `HEADER`."""
    draws = f"; mean of {row['draws']} draws" if row["draws"] > 1 else ""
    what = (row["what"], row["value"] + draws)
    if row["bias"] is None:
        return (*what, row["note"], "", "", "", "", "", "")
    return (
        *what,
        signed(row["bias"]),
        number(row["error"]),
        number(row["tau"], 3),
        ", ".join(_moved(key, by) for key, by in row["shift"].items()),
        percent(row["regret"], row["regret_interval_90"]),
        percent(row["apart"], row["apart_interval_90"]),
        _verdicts(row["verdicts"]),
    )


def floor_line(result: Mapping) -> list[str]:
    """What the ablations are held against."""
    floor, count = result["ablation_floor"], result["ablation_mountings"]
    if floor is None:
        return ["Noise floor of the ablations: too few blocks for one"]
    return [
        f"Ablations, on the {count} best mountings by the reference; their noise floor, half of the blocks against the "
        f"other: bias {floor['bias']:.4f}, tau {floor['tau']:.3f}, choices apart by {percent(floor['apart'])} of the "
        "gain. An effect is above or below the floor when its whole 90 % interval is, each for itself; else it cannot "
        "be told"
    ]


def needs(result: Mapping) -> list[str]:
    """What the scene needs: all things by what can be told of them."""
    told = [row for row in result["ablations"] if row["verdicts"]]
    above = [f"{_name(row)} ({', '.join(_having(row, ABOVE))})" for row in told if _having(row, ABOVE)]
    below = [_name(row) for row in told if len(_having(row, BELOW)) == len(JUDGED)]
    rest = [
        f"{_name(row)} ({', '.join(_having(row, UNTOLD))})"
        for row in told
        if _having(row, UNTOLD) and not _having(row, ABOVE)
    ]
    kinds = (("Above the noise floor", above), ("Below it in everything", below), ("Cannot be told", rest))
    return [f"{kind}: {'; '.join(names)}" for kind, names in kinds if names]


def _having(row: Mapping, verdict: str) -> list[str]:
    return [name for name in JUDGED if row["verdicts"][name] == verdict]


def _verdicts(verdicts: Mapping[str, str] | None) -> str:
    """By verdict, shortest where all are the same."""
    if verdicts is None:
        return "no floor known"
    kinds = {kind: [name for name in JUDGED if verdicts[name] == kind] for kind in (ABOVE, UNTOLD, BELOW)}
    if len(kinds[BELOW]) == len(JUDGED):
        return BELOW
    return "; ".join(f"{kind}: {', '.join(names)}" for kind, names in kinds.items() if names and kind != BELOW)


def _name(row: Mapping) -> str:
    return f"{row['what']}, {row['value']}" if row["value"] else row["what"]


def _moved(key: str, by: float) -> str:
    unit = next((unit for ending, unit in _UNITS.items() if key.endswith(ending)), "")
    return f"{round(by, 2) + 0.0:+.2f} {unit}".rstrip()


# --- the report: the sentence, the fidelities, the casters, what was validated, and what the scene needs --------------

_LADDER = ("fidelity", "one evaluation", "quartiles", "faster", "bias", "error", "of the gain", "tau", "regret", "")


def _ablations(result: Mapping) -> list[tuple[str, ...]]:
    return [HEADER, *map(ablation_cells, result["ablations"])]


def report_text(result: Mapping) -> str:
    """What `chart_study` came to, for a terminal: of the ladder only what is worth a line there."""
    rows = [row for row in result["rungs"] if _told(row, result)]
    parts = [
        *wrapped(_head(result)),
        "",
        *text_table([_LADDER, *(_rung(row, result) for row in rows)]),
        f"({len(result['rungs'])} fidelities; all of them are in chart.csv)",
        "",
        *text_table(_ablations(result)),
        "",
        *wrapped([*floor_line(result), *needs(result)]),
        "",
        *wrapped([*_hits(result), *_validated(result), *_paired(result), _asked(result), result["sentence"]]),
    ]
    return "\n".join(parts)


def report_markdown(result: Mapping, pictures: Sequence[str]) -> str:
    """The same as a page of Markdown, with every fidelity and the picture."""
    parts = ["# Speed against accuracy", "", f"**{result['sentence']}**", "", *(f"- {line}" for line in _head(result))]
    parts += ["", *(f"![Error over time]({name})" for name in pictures)]
    parts += ["", "## The ladder", "", *markdown_table([_LADDER, *(_rung(row, result) for row in result["rungs"])])]
    parts += [
        "",
        "## What the scene needs",
        "",
        *markdown_table(_ablations(result)),
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
        percent(row["regret"], row["regret_interval_90"]),
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
        f"{one['where']}: {one['verdict']}; regret {percent(one['regret'], one['regret_interval_90'])}, error "
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
