"""Chart: the score over mounting height and tilt, with the optimum, the baseline and the near-best region."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from ..errors import InputError
from ..metrics.metric import Metric
from ..metrics.views import PE_VGOP
from .binning import near_best_threshold
from .canvas import INK, SCORE_COLOURS, colours, legend_below, sheet

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.lines import Line2D


def plot_score_map(
    path: str | Path,
    height_m: ArrayLike,
    tilt_deg: ArrayLike,
    value: ArrayLike,
    optimum: tuple[float, float],
    baseline: tuple[float, float],
    *,
    baseline_value: float,
    optimum_value: float | None = None,
    robust: tuple[tuple[float, float], float] | None = None,
    region_share: float = 0.01,
    metric: Metric = PE_VGOP,
    title: str = "",
    subtitle: str = "",
) -> None:
    """Draw the objective over a grid of mountings.

    Parameters
    ----------
    path : str or Path
        The PNG to write.
    height_m, tilt_deg : array_like, (h,) and (t,)
        Rising mounting heights [m] and tilts about the road axis [deg], at least two of each.
    value : array_like, (h, t)
        Objective per vehicle; NaN where it was not evaluated.
    optimum, baseline : tuple of float
        Height [m] and tilt [deg] of the two mountings; one outside the grid is marked on the map's edge.
    baseline_value : float
        Objective per vehicle of the baseline.
    optimum_value : float, optional
        That of the optimum; the largest of `value` unless given.
    robust : ((float, float), float), optional
        Height [m] and tilt [deg] of the best mounting over an installer's errors, and its objective per vehicle.
    region_share : float
        The region drawn holds the mountings that lose at most this share of the gain of the best one over the baseline.
    metric : Metric
        What the objective is made of.
    title, subtitle : str
        Headings.

    Raises
    ------
    InputError
        If the shapes disagree, an axis does not rise or no value is finite.
    """
    height_m, tilt_deg, value = (np.asarray(array, dtype=float) for array in (height_m, tilt_deg, value))
    _check_grid(height_m, tilt_deg, value)
    highest = float(np.nanmax(value))
    best = highest if optimum_value is None else optimum_value
    shown = np.ma.masked_invalid(value)
    name = "optimum" if robust is None else "sharp"
    with sheet(path, 115.0, title, subtitle) as figure:
        axes = figure.add_subplot()
        mesh = axes.pcolormesh(tilt_deg, height_m, shown, cmap=colours(SCORE_COLOURS), shading="gouraud")
        figure.colorbar(mesh, ax=axes, label=metric.in_unit("Objective per vehicle"), pad=0.02)
        if shown.min() < shown.max():
            lines = axes.contour(tilt_deg, height_m, shown, levels=8, colors=INK, linewidths=0.4)
            axes.clabel(lines, fontsize=6.5)
        threshold = near_best_threshold(max(best, highest), baseline_value, region_share)
        handles = [
            _mark(axes, optimum, (height_m, tilt_deg), "*", 13.0, name, metric.amount(best)),
            _mark(axes, baseline, (height_m, tilt_deg), "s", 7.0, "baseline", metric.amount(baseline_value)),
            _draw_region(axes, tilt_deg, height_m, shown, threshold, region_share),
        ]
        if robust is not None:
            mounting, its = robust
            handles.insert(1, _mark(axes, mounting, (height_m, tilt_deg), "D", 7.0, "robust", metric.amount(its)))
        axes.set_xlabel("Tilt across the road, positive down towards +y [deg]")
        axes.set_ylabel("Mounting height above the road [m]")
        legend_below(figure, handles, columns=len(handles))


def _check_grid(height_m: np.ndarray, tilt_deg: np.ndarray, value: np.ndarray) -> None:
    for name, axis in (("height_m", height_m), ("tilt_deg", tilt_deg)):
        if axis.ndim != 1 or axis.size < 2 or not (np.diff(axis) > 0).all():
            raise InputError(f"score map: {name} must hold at least two rising values, got {axis.tolist()}")
    if value.shape != (height_m.size, tilt_deg.size):
        raise InputError(
            f"score map: value has shape {value.shape}, height_m and tilt_deg ask for {(height_m.size, tilt_deg.size)}"
        )
    if not np.isfinite(value).any():
        raise InputError("score map: no value is finite")


def _mark(
    axes: Axes,
    mounting: tuple[float, float],
    grid: tuple[np.ndarray, np.ndarray],
    marker: str,
    size: float,
    name: str,
    value: str,
) -> Line2D:
    """A marker at the mounting or, with an arrow leading out of the map, at the edge nearest to it."""
    height, tilt = mounting
    inside = tuple(float(np.clip(at, axis[0], axis[-1])) for at, axis in zip(mounting, grid, strict=True))
    outside = inside != (height, tilt)
    label = f"{name}: {height:.2f} m, {tilt:.1f}°" + (", off the map" if outside else "") + f"\n{value}"
    if outside:
        step = (24.0 * np.sign(tilt - inside[1]), 24.0 * np.sign(height - inside[0]))
        axes.annotate(
            "",
            xy=(inside[1], inside[0]),
            xytext=(-step[0], -step[1]),
            textcoords="offset points",
            arrowprops={"arrowstyle": "->", "color": INK, "linewidth": 1.2, "shrinkB": 6.0},
        )
    (line,) = axes.plot(
        inside[1],
        inside[0],
        marker,
        markersize=size,
        markerfacecolor="white",
        markeredgecolor="black",
        markeredgewidth=1.0,
        clip_on=False,
        zorder=5,
        label=label,
    )
    return line


def _draw_region(
    axes: Axes, tilt_deg: np.ndarray, height_m: np.ndarray, shown: np.ma.MaskedArray, threshold: float, share: float
) -> Line2D:
    """Outline the values from the threshold up; returns what the legend shows for it."""
    from matplotlib.lines import Line2D

    label = f"within {100.0 * share:g} % of the gain"
    if shown.max() < threshold:
        label += "\nsmaller than a cell"
    elif shown.min() < threshold:
        axes.contour(tilt_deg, height_m, shown, levels=[threshold], colors="black", linewidths=2.0)
    else:
        label += "\nthe whole map"
    return Line2D([], [], color="black", linewidth=2.0, label=label)
