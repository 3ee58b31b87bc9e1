"""Chart: what fidelities cost and how far they are from the reference, each named, with the Pareto front."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..errors import InputError
from .canvas import BASELINE, FAINT, INK, OPTIMISED, legend_below, sheet
from .labels import name_points

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# By level of detail, told apart in grey by lightness and without colour by the marker.
_LOOKS = {
    "box": {"marker": "s", "color": "#8fb4da"},
    "body": {"marker": "o", "color": "#3d77b8"},
    "detailed": {"marker": "^", "color": OPTIMISED["color"]},
}
_HEIGHT_MM = 175.0
_MARGIN = 0.05  # of the errors' range, above and below it
_MARKER_PT, _RING_PT = 2.6, 6.0  # half the side of what a marker covers


@dataclass(frozen=True, slots=True)
class Mark:
    """One fidelity.

    Attributes
    ----------
    name : str
    milliseconds : (float, float, float)
        First quartile, median and third quartile of one evaluation.
    error : float
        Root mean square after calibration; 0 for what comes to the same as the reference.
    detail : str
        A level of detail.
    twin : bool
        Whether it comes to the same as another one by definition.
    front, recommended : bool
        Whether it is on the Pareto front, and the one to take.
    """

    name: str
    milliseconds: tuple[float, float, float]
    error: float
    detail: str
    twin: bool
    front: bool
    recommended: bool


def plot_speed_accuracy(
    path: str | Path,
    marks: Sequence[Mark],
    *,
    noise: tuple[float, float, float] | None,
    tolerance: float | None,
    unit: str,
    title: str = "",
    subtitle: str = "",
) -> None:
    """Draw error over the logarithm of time.

    Parameters
    ----------
    path : str or Path
        The PNG to write.
    marks : sequence of Mark
    noise : (float, float, float) or None
        Low end, middle and high end of what the reference differs from itself by on other traffic.
    tolerance : float or None
        The error that is allowed.
    unit : str
        Of errors.
    title, subtitle : str
        Headings.

    Raises
    ------
    InputError
        If there is nothing to draw.
    """
    if not marks:
        raise InputError("fidelities: none given; at least one is needed")
    with sheet(path, _HEIGHT_MM, title, subtitle) as figure:
        axes = figure.subplots()
        axes.set_xscale("log")
        places = np.array([(mark.milliseconds[1], mark.error) for mark in marks])
        handles = _lines(axes, noise, tolerance)
        handles += _points(axes, marks, places)
        most = max(places[:, 1].max(), noise[2] if noise else 0.0, tolerance or 0.0) or 1.0
        axes.set_ylim(-_MARGIN * most, (1.0 + _MARGIN) * most)
        axes.set_xlim(places[:, 0].min() / 1.6, places[:, 0].max() * 1.6)
        ticks = _round_numbers(*axes.get_xlim())
        axes.xaxis.set_ticks(ticks, [f"{tick:g}" for tick in ticks])
        axes.xaxis.set_ticks([], minor=True)
        axes.set_xlabel("One evaluation: median of the times [ms]; bars: quartiles")
        axes.set_ylabel(f"Error after calibration [{unit} per vehicle]" if unit else "Error after calibration")
        axes.grid(visible=True)
        figure.canvas.draw()  # places are now known in pixels
        weights = ["bold" if mark.recommended or mark.front else "normal" for mark in marks]
        bars = [
            ((mark.milliseconds[0], y), (mark.milliseconds[2], y)) for mark, (_, y) in zip(marks, places, strict=True)
        ]
        sizes = [_RING_PT if mark.recommended else _MARKER_PT for mark in marks]
        name_points(axes, places, [mark.name for mark in marks], weights, sizes, [*bars, *_steps(marks, places)])
        legend_below(figure, handles, columns=4)


def _lines(axes: Axes, noise, tolerance) -> list:
    handles = []
    if noise is not None:
        low, middle, high = noise
        handles.append(
            axes.axhspan(
                low,
                high,
                color=FAINT,
                alpha=0.4,
                linewidth=0.0,
                label="reference, half of the blocks against the others",
            )
        )
        axes.axhline(middle, color=FAINT, linewidth=1.0)
    if tolerance is not None:
        look = {"color": INK, "linestyle": ":", "linewidth": 0.9}
        handles.append(axes.axhline(tolerance, label="tolerance", **look))
    return handles


def _round_numbers(low: float, high: float) -> list[float]:
    """1, 2 and 5 times powers of ten between two numbers."""
    powers = range(int(np.floor(np.log10(low))), int(np.ceil(np.log10(high))) + 1)
    return [digit * 10.0**power for power in powers for digit in (1.0, 2.0, 5.0) if low <= digit * 10.0**power <= high]


def _front(marks: Sequence[Mark], places: np.ndarray) -> list[tuple[float, float]]:
    return sorted(tuple(place) for mark, place in zip(marks, places, strict=True) if mark.front)


def _steps(marks: Sequence[Mark], places: np.ndarray) -> list[tuple]:
    """The front's line in pieces, from one corner to the next."""
    pieces = []
    for (x, y), (next_x, next_y) in pairwise(_front(marks, places)):
        pieces += [((x, y), (next_x, y)), ((next_x, y), (next_x, next_y))]
    return pieces


def _points(axes: Axes, marks: Sequence[Mark], places: np.ndarray) -> list:
    handles = axes.step(
        *zip(*_front(marks, places), strict=True),
        where="post",
        color=INK,
        linewidth=0.9,
        label="Pareto front",
        zorder=2,
    )
    for detail, look in _LOOKS.items():
        rows = [row for row, mark in enumerate(marks) if mark.detail == detail]
        if not rows:
            continue
        for row in rows:
            first, _, last = marks[row].milliseconds
            axes.plot([first, last], [places[row, 1]] * 2, color=look["color"], linewidth=0.7, zorder=2)
        for twin, face in ((False, look["color"]), (True, "white")):
            some = [row for row in rows if marks[row].twin == twin]
            (drawn,) = axes.plot(
                *places[some].T, linestyle="none", markersize=4.2, markerfacecolor=face, zorder=3, label=detail, **look
            )
            handles += [drawn] if not twin else []
    for mark, place in zip(marks, places, strict=True):
        if mark.recommended:
            ring = {"marker": "o", "markersize": 11.0, "markerfacecolor": "none", "color": BASELINE["color"]}
            handles += axes.plot(*place, linestyle="none", markeredgewidth=1.5, zorder=4, label="recommended", **ring)
    return handles
