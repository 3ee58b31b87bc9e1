"""Chart: how much of the gain each mounting has, sensor beside sensor, with the optimum, its interval and rivals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from ..errors import InputError
from .canvas import INK, SCORE_COLOURS, colours, legend_below, sheet

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.collections import QuadMesh

_LEVELS = (0.95, 0.99)
_HEIGHT_MM = 92.0
_WIDTHS = (1.0, 2.2)  # of the outlines
Mounting = tuple[float, float]


@dataclass(frozen=True, slots=True)
class GainMap:
    """One sensor's panel.

    Attributes
    ----------
    name : str
        Of the sensor.
    height_m, tilt_deg : array_like, (h,) and (t,)
        Rising heights [m] and tilts [deg] of the grid.
    share : array_like, (h, t)
        Share of the best point's gain over the baseline.
    optimum : (float, float)
        Height [m] and tilt [deg].
    height_interval, tilt_interval : (float, float) or None
        90 % intervals of both.
    rivals : mapping of str to (float, float)
        Other mountings by name, at most three.
    """

    name: str
    height_m: ArrayLike
    tilt_deg: ArrayLike
    share: ArrayLike
    optimum: Mounting
    height_interval: tuple[float, float] | None
    tilt_interval: tuple[float, float] | None
    rivals: dict[str, Mounting]


def plot_gain_maps(path: str | Path, maps: Sequence[GainMap], *, title: str = "", subtitle: str = "") -> None:
    """Draw the maps side by side, mountings within 1 % and 5 % of the gain outlined.

    Raises
    ------
    InputError
        If there is no map, or a share does not fit its axes.
    """
    if not maps:
        raise InputError("gain maps: none given; at least one is needed")
    with sheet(path, _HEIGHT_MM, title, subtitle) as figure:
        panels = figure.subplots(1, len(maps), sharey=True, squeeze=False)[0]
        for axes, one in zip(panels, maps, strict=True):
            mesh = _draw(axes, one)
        panels[0].set_ylabel("Mounting height above the road [m]")
        panels[len(maps) // 2].set_xlabel("Tilt across the road, positive down towards +y [deg]")
        bar = figure.colorbar(mesh, ax=list(panels), label="Share of the best gain [%]", pad=0.02, extend="min")
        bar.ax.axhline(100.0 * _LEVELS[0], color="black", linewidth=_WIDTHS[0])
        legend_below(figure, _legend(maps), columns=4)


def _draw(axes: Axes, one: GainMap) -> QuadMesh:
    height, tilt, share = (np.asarray(array, dtype=float) for array in (one.height_m, one.tilt_deg, one.share))
    if share.shape != (height.size, tilt.size):
        raise InputError(f"{one.name}: share has shape {share.shape}, the axes ask for {(height.size, tilt.size)}")
    mesh = axes.pcolormesh(
        tilt, height, 100.0 * share, cmap=colours(SCORE_COLOURS), vmin=0.0, vmax=100.0, shading="gouraud"
    )
    for level, width in zip(_LEVELS, _WIDTHS, strict=True):
        if share.min() < level <= share.max():
            axes.contour(tilt, height, share, levels=[level], colors="black", linewidths=width)
    for look, mounting in zip(_RIVALS, one.rivals.values(), strict=False):
        axes.plot(mounting[1], mounting[0], **look, **_RIVAL)
    if one.height_interval is not None and one.tilt_interval is not None:
        for ends, at, across in (
            (one.tilt_interval, one.optimum[0], False),
            (one.height_interval, one.optimum[1], True),
        ):
            line = ([at, at], ends) if across else (ends, [at, at])
            axes.plot(*line, color=INK, linewidth=4.0, solid_capstyle="butt", clip_on=False, zorder=4)
    axes.plot(one.optimum[1], one.optimum[0], **_OPTIMUM)
    axes.set_title(one.name)
    return mesh


_RIVALS = ({"marker": "D", "markersize": 5.5}, {"marker": "o", "markersize": 5.5}, {"marker": "s", "markersize": 5.5})
_RIVAL = {
    "linestyle": "none",
    "markerfacecolor": "white",
    "markeredgecolor": "black",
    "markeredgewidth": 1.0,
    "clip_on": False,
    "zorder": 5,
}
_OPTIMUM = {**_RIVAL, "marker": "*", "markersize": 11.0, "zorder": 6}


def _legend(maps: Sequence[GainMap]) -> list:
    from matplotlib.lines import Line2D

    entries = [Line2D([], [], label="optimum of the grid", **_OPTIMUM)]
    entries += [
        Line2D([], [], label=name, **look, **_RIVAL) for look, name in zip(_RIVALS, maps[0].rivals, strict=False)
    ]
    if any(one.tilt_interval is not None for one in maps):
        entries.append(Line2D([], [], color=INK, linewidth=4.0, label="90 % of resampled optima"))
    return entries + [
        Line2D([], [], color="black", linewidth=width, label=f"within {100.0 * (1.0 - level):.0f} % of the gain")
        for level, width in zip(_LEVELS, _WIDTHS, strict=True)
    ]
