"""Charts: what a mounting loses as one thing after another changes, off its plan, and by the size of the sample."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..errors import InputError
from .canvas import BASELINE, FAINT, INK, OPTIMISED, SMALL_PT, legend_below, sheet

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# Told apart in grey by lightness, and without any colour by the marker.
VERDICT_LOOKS = {
    "stable": {"color": OPTIMISED["color"], "marker": "o"},
    "fragile": {"color": "#5b8fc7", "marker": "^"},
    "fails": {"color": BASELINE["color"], "marker": "s", "markerfacecolor": "white"},
}
_MOST_PERCENT = 100.0  # a loss beyond is drawn at the rim
_LINEAR_PERCENT = 1.0
_ROW_MM, _HEADING_MM = 3.7, 40.0


@dataclass(frozen=True, slots=True)
class Change:
    """What one change does.

    Attributes
    ----------
    group, name : str
        What it belongs to, and what it is.
    verdict : str
        A key of `VERDICT_LOOKS`.
    loss, interval : float, (float, float) or None
        Share of the gain that is lost, and its 90 % interval.
    optima : sequence of float
        Where the optimum would be, under each draw of the change.
    """

    group: str
    name: str
    verdict: str
    loss: float
    interval: Sequence[float] | None
    optima: Sequence[float]


def plot_changes(
    path: str | Path,
    changes: Sequence[Change],
    *,
    limits: Sequence[float],
    reference: float,
    interval: Sequence[float] | None,
    label: str,
    title: str = "",
    subtitle: str = "",
) -> None:
    """Draw, a row for each change, what is lost and where the optimum would be.

    Parameters
    ----------
    path : str or Path
        The PNG to write.
    changes : sequence of Change
    limits : sequence of float
        Losses at which the verdict changes.
    reference : float
        Where the mounting in question is, on the axis of the optima.
    interval : (float, float) or None
        Where resampled traffic puts the optimum.
    label : str
        What the optima are, with their unit.
    title, subtitle : str
        Headings.

    Raises
    ------
    InputError
        If there is no change.
    """
    if not changes:
        raise InputError("changes: none given; at least one is needed")
    with sheet(path, _HEADING_MM + _ROW_MM * len(changes), title, subtitle) as figure:
        from matplotlib.lines import Line2D

        lost, moved = figure.subplots(1, 2, sharey=True, width_ratios=(1.25, 1.0))
        for row, one in enumerate(changes):
            look = {"linestyle": "none", "markersize": 4.0, "clip_on": False, "zorder": 3, **VERDICT_LOOKS[one.verdict]}
            low, high = 100.0 * np.array(one.interval or (one.loss, one.loss))
            drawn = (
                (lost, 100.0 * one.loss, low, high),
                (moved, float(np.mean(one.optima)), min(one.optima), max(one.optima)),
            )
            for axes, middle, first, last in drawn:
                axes.plot([first, last], [row, row], color=look["color"], linewidth=1.2, zorder=2)
                rim = np.clip(middle, -_MOST_PERCENT, _MOST_PERCENT) if axes is lost else middle
                axes.plot(rim, row, **look)
        for limit in limits:
            lost.axvline(100.0 * limit, color=INK, linewidth=0.8, linestyle="--")
        lost.set_xscale("symlog", linthresh=_LINEAR_PERCENT)
        lost.set_xlim(-0.3 * _MOST_PERCENT, _MOST_PERCENT)
        lost.axvline(0.0, color=INK, linewidth=0.8)
        ticks = [-10.0, -1.0, 0.0, 1.0, *(100.0 * limit for limit in limits), _MOST_PERCENT]
        lost.set_xticks(ticks, [f"{tick:g}" if tick < _MOST_PERCENT else f"{tick:g}+" for tick in ticks])
        lost.minorticks_off()
        lost.set_xlabel("Loss of the mounting [% of the gain]")
        if interval is not None:
            moved.axvspan(*interval, color=FAINT, alpha=0.45, linewidth=0.0)
        moved.axvline(reference, color=INK, linewidth=0.8, linestyle="--")
        moved.set_xlabel(label)
        _name_rows(lost, changes)
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


def _name_rows(axes: Axes, changes: Sequence[Change]) -> None:
    axes.set_yticks(range(len(changes)), [one.name for one in changes], fontsize=SMALL_PT)
    axes.tick_params(axis="y", length=0.0)
    axes.set_ylim(len(changes) - 0.4, -0.6)
    for row in range(1, len(changes)):
        if changes[row].group != changes[row - 1].group:
            axes.axhline(row - 0.5, color=INK, linewidth=0.6, xmin=-0.7, clip_on=False)


def plot_sample_size(
    path: str | Path,
    vehicles: Sequence[float],
    reach: Sequence[float],
    *,
    power: float,
    needed: float,
    asked: float,
    title: str = "",
    subtitle: str = "",
) -> None:
    """Draw half of the optimum's 90 % interval over the number of vehicle observations.

    Parameters
    ----------
    path : str or Path
        The PNG to write.
    vehicles, reach : sequence of float, (k,)
        Vehicle observations, and half of the interval of the best tilt [deg].
    power : float
        The interval falls with this power of the observations, from the last of them on.
    needed, asked : float
        Observations that would make the tilt as certain as `asked` [deg].
    title, subtitle : str
        Headings.
    """
    with sheet(path, 78.0, title, subtitle) as figure:
        axes = figure.subplots()
        handles = axes.plot(vehicles, reach, markersize=4.0, label="samples of the traffic at hand", **_LINE)
        ahead = np.geomspace(vehicles[-1], max(needed, vehicles[-1]) * 1.5, 50)
        look = {"color": OPTIMISED["color"], "linestyle": ":", "label": f"as its power {-power:.2f} from there on"}
        handles += axes.plot(ahead, reach[-1] * (ahead / vehicles[-1]) ** -power, **look)
        handles.append(axes.axhline(asked, color=INK, linestyle="--", linewidth=0.8, label=f"{asked:g} deg"))
        if needed > vehicles[-1]:
            (mark,) = axes.plot(needed, asked, clip_on=False, **{**BASELINE, "linestyle": "none", "label": "asked for"})
            handles.append(mark)
        axes.set_xscale("log")
        axes.xaxis.set_major_formatter(lambda count, _: f"{count:,.0f}")
        axes.minorticks_off()
        axes.set_ylim(bottom=0.0)
        axes.set_xlabel("Vehicle observations")
        axes.set_ylabel("Uncertainty of the best tilt [deg]")
        axes.grid(visible=True)
        legend_below(figure, handles, columns=len(handles))


_LINE = {"color": OPTIMISED["color"], "marker": "o"}


def plot_profiles(
    path: str | Path,
    profiles: Mapping[str, tuple[Sequence[float], Sequence[float]]],
    tolerances: Mapping[str, float],
    *,
    title: str = "",
    subtitle: str = "",
) -> None:
    """Draw the share of the gain that is kept with one coordinate at a time off its plan.

    Parameters
    ----------
    path : str or Path
        The PNG to write.
    profiles : mapping of str to (offsets, shares)
        By name with unit, up to four.
    tolerances : mapping of str to float
        Half-widths that an installer keeps, by the same names; shaded.
    title, subtitle : str
        Headings.
    """
    with sheet(path, 66.0, title, subtitle) as figure:
        for axes, (name, (offsets, shares)) in zip(
            np.atleast_1d(figure.subplots(1, len(profiles), sharey=True)), profiles.items(), strict=True
        ):
            width = tolerances.get(name, 0.0)
            if width:
                axes.axvspan(-width, width, color=FAINT, alpha=0.45, linewidth=0.0)
            axes.plot(offsets, 100.0 * np.array(shares), markersize=3.0, linewidth=1.2, **_LINE)
            axes.axhline(100.0, color=INK, linewidth=0.8, linestyle="--")
            axes.set_xlabel(name)
            axes.grid(visible=True)
        figure.axes[0].set_ylabel("Gain kept [%]")
