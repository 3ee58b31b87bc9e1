"""Chart: what a frame takes with us and with others, and how time and memory grow."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from ..errors import InputError
from .canvas import BASELINE, INK, OPTIMISED, SMALL_PT, sheet

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_ROW_MM, _HEAD_MM, _GROWTH_MM = 5.2, 30.0, 52.0
_LEAST_SPAN, _WIDE = 3.0, 100.0  # of the largest number over the smallest
_ACROSS = 2  # growth panels side by side
_LINES = (
    {"color": OPTIMISED["color"], "linestyle": "-", "marker": "o"},
    {"color": BASELINE["color"], "linestyle": "--", "marker": "s"},
    {"color": "#2a8f6f", "linestyle": "-.", "marker": "^"},
    {"color": "#777777", "linestyle": ":", "marker": "D"},
)


class Bar(NamedTuple):
    """One row: what was timed, milliseconds (quartile, median, quartile), whether it is ours."""

    name: str
    low: float
    median: float
    high: float
    ours: bool


class Line(NamedTuple):
    """One line of a panel: whose, numbers along both axes, and its fitted exponent in words."""

    name: str
    x: Sequence[float]
    y: Sequence[float]
    exponent: str


class Panel(NamedTuple):
    """How something grows, with labels of both axes."""

    x_label: str
    y_label: str
    lines: Sequence[Line]


def plot_benchmark(
    path: str | Path, bars: Sequence[Bar], panels: Sequence[Panel], *, title: str = "", subtitle: str = ""
) -> None:
    """Draw rows of times on a logarithmic axis and, below them, panels of growth, both axes logarithmic.

    Raises
    ------
    InputError
        If there is neither, a time is not above 0, or a panel has more lines than can be told apart.
    """
    if not bars and not panels:
        raise InputError("benchmark chart: neither times nor growth; at least one is needed")
    if any(bar.low <= 0.0 for bar in bars):
        raise InputError("benchmark chart: a time is 0; a logarithmic axis needs times above 0")
    if any(len(panel.lines) > len(_LINES) for panel in panels):
        raise InputError(f"benchmark chart: a panel of more than {len(_LINES)} lines cannot be read")
    bars_mm = _HEAD_MM + _ROW_MM * len(bars) if bars else 0.0
    rows = -(-len(panels) // _ACROSS)
    height_mm = bars_mm + _GROWTH_MM * rows + (0.0 if bars else 14.0)
    with sheet(path, height_mm, title, subtitle) as figure:
        heights = [height for height in (bars_mm, _GROWTH_MM * rows) if height]
        parts = figure.subfigures(len(heights), 1, height_ratios=heights, squeeze=False)[:, 0]
        if bars:
            _draw_bars(parts[0].subplots(), bars)
        if panels:
            every = parts[-1].subplots(rows, _ACROSS, squeeze=False).ravel()
            for axes, panel in zip(every, panels, strict=False):
                _draw_panel(axes, panel)
            for axes in every[len(panels) :]:
                axes.set_axis_off()


def _draw_bars(axes: Axes, bars: Sequence[Bar]) -> None:
    """A dot at each median, a line between the quartiles, the number beside it; the first row on top."""
    for row, bar in enumerate(bars):
        look = OPTIMISED if bar.ours else BASELINE
        axes.plot([bar.low, bar.high], [row, row], color=look["color"], linewidth=2.4, solid_capstyle="butt")
        face = look["color"] if bar.ours else "white"
        axes.plot(bar.median, row, look["marker"], color=look["color"], markersize=4.5, markerfacecolor=face)
        axes.annotate(
            f"{bar.median:,.3g}" if bar.median < 1000.0 else f"{bar.median:,.0f}",
            (bar.high, row),
            xytext=(6.0, 0.0),
            textcoords="offset points",
            va="center",
            fontsize=SMALL_PT,
            color=INK,
        )
    axes.set_xscale("log")
    axes.set_xlim(0.6 * min(bar.low for bar in bars), 4.0 * max(bar.high for bar in bars))
    axes.set_yticks(range(len(bars)), [bar.name for bar in bars])
    axes.set_ylim(len(bars) - 0.4, -0.6)
    axes.tick_params(axis="y", length=0.0)
    axes.xaxis.set_major_formatter("{x:g}")
    axes.set_xlabel("Milliseconds: median and quartiles over repeats; filled: ours, open: others")
    axes.grid(visible=True, axis="x")


def _draw_panel(axes: Axes, panel: Panel) -> None:
    """Lines, and in the legend each one's exponent."""
    from matplotlib.ticker import LogLocator, NullFormatter

    ticks = sorted({x for line in panel.lines for x in line.x})
    for look, line in zip(_LINES, panel.lines, strict=False):
        axes.plot(line.x, line.y, markersize=3.0, linewidth=1.2, label=f"{line.name}, exponent {line.exponent}", **look)
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_xticks(ticks, [f"{tick:,g}" for tick in ticks])
    axes.set_xticks([], minor=True)
    low, high = (end(y for line in panel.lines for y in line.y) for end in (min, max))
    span = max(high / low, _LEAST_SPAN)
    axes.set_ylim(low / span**0.1, high * span**0.5)  # room for the legend above the lines
    axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if span < _WIDE else (1.0,)))
    axes.yaxis.set_major_formatter("{x:,g}")
    axes.yaxis.set_minor_formatter(NullFormatter())
    axes.set_xlabel(panel.x_label)
    axes.set_ylabel(panel.y_label)
    axes.grid(visible=True)
    axes.legend(loc="upper left", fontsize=SMALL_PT, handlelength=3.0)
