"""Charts: metrics beside what detectors made of the same cars, over distance and against each other."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ..errors import InputError
from .canvas import BASELINE, FAINT, INK, OPTIMISED, SMALL_PT, legend_below, sheet

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_COLUMNS = 4
_ROW_MM, _REST_MM = 40.0, 32.0
_DOTS = {"linestyle": "none", "marker": ".", "markersize": 2.2, "color": FAINT, "zorder": 1}
_METRIC = {"color": OPTIMISED["color"], "linestyle": "-", "marker": "o", "markersize": 3.0}
_DETECTORS = (
    {"color": BASELINE["color"], "linestyle": "--", "marker": "s", "markersize": 3.0, "markerfacecolor": "white"},
    {"color": INK, "linestyle": ":", "marker": "^", "markersize": 3.0, "markerfacecolor": "white"},
)


class Decline(NamedTuple):
    """One quantity over distance, scaled so that its lowest band mean is 0 and its highest 1.

    Attributes
    ----------
    name : str
    distance_m, values : ndarray, (n,)
        Of each car.
    centre_m, mean, low, high : ndarray, (b,)
        Middle of each band, the mean there and the ends of its interval, NaN without one.
    """

    name: str
    distance_m: np.ndarray
    values: np.ndarray
    centre_m: np.ndarray
    mean: np.ndarray
    low: np.ndarray
    high: np.ndarray


class Against(NamedTuple):
    """One metric against a detector's performance.

    Attributes
    ----------
    name, unit : str
    values, performance : ndarray, (n,)
        Of each car.
    curve : tuple of two ndarrays, (k,)
        Metric and performance along the fitted curve.
    note : str
        For the corner.
    """

    name: str
    unit: str
    values: np.ndarray
    performance: np.ndarray
    curve: tuple[np.ndarray, np.ndarray]
    note: str


def plot_declines(
    path: str | Path,
    metrics: Sequence[Decline],
    detectors: Sequence[Decline],
    *,
    title: str = "",
    subtitle: str = "",
) -> None:
    """Draw each metric over distance in a panel of its own, with the performance of up to two detectors.

    Parameters
    ----------
    path : str or Path
        The PNG to write.
    metrics, detectors : sequence of Decline
    title, subtitle : str
        Headings.
    """
    _check(metrics)
    with sheet(path, _height_mm(metrics), title, subtitle) as figure:
        panels = _panels(figure, len(metrics))
        for axes, one in zip(panels, metrics, strict=True):
            dots = axes.plot(one.distance_m, one.values, label="the metric, one car", **_DOTS)
            lines = [
                _with_interval(axes, detector, look) for detector, look in zip(detectors, _DETECTORS, strict=False)
            ]
            lines.append(_with_interval(axes, one, _METRIC, "the panel's metric, mean and 90 % interval"))
            axes.set_title(one.name, fontsize=SMALL_PT)
            axes.set_ylim(-0.35, 1.6)
            axes.set_xlim(left=0.0)
            axes.grid(visible=True)
        for axes in panels[-_COLUMNS:]:  # those with none below
            axes.set_xlabel("Distance [m]")
        figure.supylabel("Scaled: lowest mean of a band 0, highest 1", fontsize=8.0)
        legend_below(figure, [lines[-1], *dots, *lines[:-1]], columns=2)


def plot_against(
    path: str | Path, metrics: Sequence[Against], *, label: str, title: str = "", subtitle: str = ""
) -> None:
    """Draw the performance over each metric, a dot for each car, with the rising curve that fits best.

    Parameters
    ----------
    path : str or Path
        The PNG to write.
    metrics : sequence of Against
        A panel each.
    label : str
        What the performance is.
    title, subtitle : str
        Headings.
    """
    _check(metrics)
    with sheet(path, _height_mm(metrics), title, subtitle) as figure:
        for axes, one in zip(_panels(figure, len(metrics)), metrics, strict=True):
            look = {**_DOTS, "markersize": 3.0, "color": BASELINE["color"], "alpha": 0.55}
            dots = axes.plot(one.values, one.performance, label="one car", **look)
            curve = axes.plot(*one.curve, color=OPTIMISED["color"], label="rising curve that fits best", zorder=3)
            axes.text(0.97, 0.96, one.note, transform=axes.transAxes, ha="right", va="top", fontsize=6.5)
            axes.set_title(one.name, fontsize=SMALL_PT)
            axes.set_xlabel(f"[{one.unit}]" if one.unit else "", fontsize=SMALL_PT, labelpad=1.0)
            axes.set_ylim(-0.03, 1.22)  # room for the note above what performance can be
            axes.grid(visible=True)
            axes.xaxis.get_major_locator().set_params(nbins=4)
        figure.supylabel(label, fontsize=8.0)
        legend_below(figure, [*dots, *curve], columns=2)


def _with_interval(axes: Axes, one: Decline, look: dict, label: str = "") -> object:
    """The means as a line in front of their intervals; returns the legend's entry."""
    axes.fill_between(one.centre_m, one.low, one.high, color=look["color"], alpha=0.18, linewidth=0.0, zorder=2)
    (line,) = axes.plot(one.centre_m, one.mean, label=label or one.name, linewidth=1.2, zorder=3, **look)
    return line


def _check(metrics: Sequence) -> None:
    if not metrics:
        raise InputError("agreement: no metric given; at least one is needed")


def _height_mm(metrics: Sequence) -> float:
    return _REST_MM + _ROW_MM * -(-len(metrics) // _COLUMNS)


def _panels(figure: Figure, number: int) -> list[Axes]:
    """So many axes in rows of four; those left over are taken away."""
    rows = -(-number // _COLUMNS)
    grid = figure.subplots(rows, _COLUMNS, squeeze=False, sharey=True).ravel().tolist()
    for axes in grid[number:]:
        axes.remove()
    return grid[:number]
