"""Charts of changes with intervals: by distance, taken apart into effects, and under other settings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ..errors import InputError
from .canvas import BASELINE, FAINT, INK, OPTIMISED, legend_below, sheet

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes

_BAND_TICKS = {"rotation": 45, "ha": "right", "rotation_mode": "anchor"}
_DISTANCE = "Horizontal distance from the LiDAR [m]"
_EFFECT_LOOKS = (
    {"color": OPTIMISED["color"]},
    {"color": FAINT},
    {"color": BASELINE["color"], "hatch": "///", "edgecolor": "white"},
    {"color": "white", "edgecolor": INK},
)


class Mean(NamedTuple):
    """A mean and the ends of its interval; NaN ends where there is none."""

    mean: float
    low: float
    high: float


class Bands(NamedTuple):
    """One sensor by distance: names of the bands, shares before and after, and changes."""

    name: str
    bands: Sequence[str]
    before: Sequence[float]
    after: Sequence[float]
    change: Sequence[Mean]


class Point(NamedTuple):
    """One sensor's optimum under one setting; NaN ends where there is no interval."""

    setting: str
    value: float
    low: float
    high: float
    note: str


def plot_before_after(
    path: str | Path,
    sensors: Sequence[Bands],
    other: Bands | None = None,
    *,
    share_label: str,
    change_label: str,
    title: str = "",
    subtitle: str = "",
) -> None:
    """Draw each sensor's shares before and after by distance and, below, the change of another measure.

    Parameters
    ----------
    path : str or Path
        The PNG to write.
    sensors : sequence of Bands
        A column each.
    other : Bands, optional
        Drawn beside the last sensor's changes: the same with other beams.
    share_label, change_label : str
        What the two rows show, with units.
    title, subtitle : str
        Headings.
    """
    if not sensors:
        raise InputError("by distance: no sensor given; at least one is needed")
    widths = [max(len(sensor.bands), 2) for sensor in sensors]
    with sheet(path, 118.0, title, subtitle) as figure:
        grid = figure.subplots(2, len(sensors), sharey="row", sharex="col", width_ratios=widths, squeeze=False)
        for (upper, lower), sensor in zip(grid.T, sensors, strict=True):
            at = np.arange(len(sensor.bands))
            handles = []
            for values, look in ((sensor.before, BASELINE), (sensor.after, OPTIMISED)):
                handles += upper.plot(at, values, clip_on=False, zorder=3, **look)
            upper.set_title(sensor.name)
            lower.axhline(0.0, color=INK, linewidth=0.8)
            shift = 0.12 if other is not None and sensor is sensors[-1] else 0.0
            look = {"color": OPTIMISED["color"], "marker": "o", "label": "change, 90 % interval"}
            handles.append(_errors(lower, at - shift, sensor.change, look))
            if shift:
                look = {"color": BASELINE["color"], "marker": "D", "label": f"change, {other.name}"}
                handles.append(_errors(lower, at + shift, other.change, look))
            lower.set_xticks(at, _in_metres(sensor.bands), **_BAND_TICKS)
            for axes in (upper, lower):
                axes.grid(visible=True, axis="y")
        grid[0, 0].set_ylabel(share_label)
        grid[0, 0].set_ylim(0.0, 100.0)
        grid[1, 0].set_ylabel(change_label)
        grid[1, len(sensors) // 2].set_xlabel(_DISTANCE)
        figure.align_ylabels()
        legend_below(figure, handles, columns=len(handles))


def plot_effects(
    path: str | Path,
    bands: Sequence[str],
    effects: Mapping[str, Sequence[Mean]],
    total: tuple[str, Sequence[Mean]],
    *,
    label: str,
    title: str = "",
    subtitle: str = "",
) -> None:
    """Draw for each distance band a bar for each of up to four effects, and their sum as a point.

    Parameters
    ----------
    path : str or Path
        The PNG to write.
    bands : sequence of str, (b,)
        Their names.
    effects : mapping of str to sequence of Mean, (b,)
        By name; they add up to the total.
    total : (str, sequence of Mean)
        Its name and values.
    label : str
        What is shown, with its unit.
    title, subtitle : str
        Headings.
    """
    at = np.arange(len(bands))
    width = 0.8 / (len(effects) + 1)
    with sheet(path, 84.0, title, subtitle) as figure:
        axes = figure.subplots()
        handles: list[Artist] = []
        for number, (name, means) in enumerate(effects.items()):
            look = _EFFECT_LOOKS[number]
            place = at + (number - 0.5 * len(effects)) * width
            handles.append(axes.bar(place, [mean.mean for mean in means], width, label=name, zorder=2, **look))
            _errors(axes, place, means, {"color": INK, "marker": ""})
        name, means = total
        look = {"color": "black", "marker": "D", "label": name}
        handles.append(_errors(axes, at + 0.5 * len(effects) * width, means, look))
        axes.axhline(0.0, color=INK, linewidth=0.8)
        axes.set_xticks(at, _in_metres(bands))
        axes.set_ylabel(label)
        axes.set_xlabel(_DISTANCE)
        axes.grid(visible=True, axis="y")
        legend_below(figure, handles, columns=len(handles))


def plot_settings(
    path: str | Path,
    sensors: Mapping[str, Sequence[Point]],
    published: Mapping[str, float],
    *,
    label: str,
    title: str = "",
    subtitle: str = "",
) -> None:
    """Draw the optimum under each setting, a panel for each sensor; the first setting's is the line to compare with.

    Parameters
    ----------
    path : str or Path
        The PNG to write.
    sensors : mapping of str to sequence of Point
        By name; a setting that a sensor lacks is left blank.
    published : mapping of str to float
        Each sensor's value in the paper.
    label : str
        What is shown, with its unit.
    title, subtitle : str
        Headings.
    """
    settings = list(dict.fromkeys(point.setting for points in sensors.values() for point in points))
    if not settings:
        raise InputError("settings: none given; at least one is needed")
    from matplotlib.lines import Line2D

    with sheet(path, 36.0 + 4.6 * len(settings), title, subtitle) as figure:
        panels = figure.subplots(1, len(sensors), sharey=True, sharex=True, squeeze=False)[0]
        for axes, (name, points) in zip(panels, sensors.items(), strict=True):
            lines = (
                axes.axvline(points[0].value, color=OPTIMISED["color"], linestyle="--", label="as the scene has it"),
                axes.axvline(published[name], color=BASELINE["color"], linestyle=":", label="the paper's Table II"),
            )
            middle = np.mean([point.value for many in sensors.values() for point in many])
            for point in points:
                row = settings.index(point.setting)
                if np.isfinite([point.low, point.high]).all():
                    axes.plot([point.low, point.high], [row, row], color=FAINT, linewidth=3.5, solid_capstyle="butt")
                axes.plot(point.value, row, "o", color=OPTIMISED["color"], markersize=4.0, clip_on=False, zorder=3)
                if point.note:
                    left = point.value > middle  # of the point, lest the note runs out of the panel
                    axes.annotate(
                        point.note,
                        (point.value, row),
                        (-5 if left else 5, 0),
                        textcoords="offset points",
                        ha="right" if left else "left",
                        va="center",
                        fontsize=6.0,
                        bbox={"facecolor": "white", "edgecolor": "none", "pad": 0.8},
                    )
            axes.set_title(name)
            axes.grid(visible=True, axis="x")
        panels[0].set_yticks(range(len(settings)), settings)
        panels[0].set_ylim(len(settings) - 0.5, -0.5)
        panels[len(panels) // 2].set_xlabel(label)
        optimum = Line2D([], [], color=OPTIMISED["color"], marker="o", markersize=4.0, linestyle="none")
        optimum.set_label("optimum")
        interval = Line2D([], [], color=FAINT, linewidth=3.5, label="90 % of resampled optima")
        legend_below(figure, [optimum, interval, *lines], columns=4)


def _in_metres(bands: Sequence[str]) -> list[str]:
    """The bands without their unit, which stands on the axis."""
    return [band.removesuffix(" m") for band in bands]


def _errors(axes: Axes, at: np.ndarray, means: Sequence[Mean], look: dict) -> Artist:
    middle = np.array([mean.mean for mean in means])
    reach = np.array([[mean.mean - mean.low, mean.high - mean.mean] for mean in means]).reshape(-1, 2).T
    return axes.errorbar(
        at,
        middle,
        np.nan_to_num(reach),
        linestyle="none",
        markersize=4.0,
        capsize=1.8,
        elinewidth=1.0,
        zorder=4,
        **look,
    )
