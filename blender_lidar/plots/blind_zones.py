"""Chart: where along and across the road vehicles stay below the threshold, before and after."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from ..errors import InputError
from .binning import cell_shares, columns, covering_edges
from .canvas import (
    BLIND_COLOURS,
    FAINT,
    TRAVEL_LABEL,
    colours,
    legend_below,
    mark_sensor,
    panel_title,
    say_empty,
    sheet,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.collections import QuadMesh

_COLUMNS = ("x_m", "y_m", "detectable")
_MARGIN_M = 1.5  # room for the LiDAR's marker


def plot_blind_zones(
    path: str | Path,
    baseline_table: Mapping[str, ArrayLike],
    optimised_table: Mapping[str, ArrayLike],
    sensor_xy: ArrayLike,
    carriageway: tuple[float, float],
    cell_m: tuple[float, float] = (5.0, 3.66),
    *,
    names: tuple[str, str] = ("Baseline", "Optimised"),
    mountings: tuple[str, str] = ("", ""),
    title: str = "",
    subtitle: str = "",
) -> None:
    """Draw the share of vehicles below the detectability threshold per cell of the road.

    Parameters
    ----------
    path : str or Path
        The PNG to write.
    baseline_table, optimised_table : mapping of str to array_like, (n,)
        Columns ``x_m``, ``y_m`` [m, road frame] and ``detectable`` of vehicles.csv under each mounting.
    sensor_xy : array_like, (2,) or (2, 2)
        Where the LiDAR stands [m, road frame]; two rows when the optimised mounting stands elsewhere.
    carriageway : tuple of float
        Right and left edge of the carriageway, lower y first [m].
    cell_m : tuple of float
        Length of a cell along the road and width of a lane [m]; the carriageway is divided into whole lanes.
    names, mountings : tuple of str
        What to call the two mountings, and what to write behind it, as "height 2.0 m, tilt 0°".
    title, subtitle : str
        Headings.

    Raises
    ------
    InputError
        If a column is missing, not numeric or of another length, or the carriageway has no width.
    """
    low, high = carriageway
    if not high > low:
        raise InputError(f"blind zones: the carriageway must run from a lower to a higher y, got {low} to {high} m")
    tables = [
        columns(table, _COLUMNS, f"{name} vehicles")
        for name, table in (("baseline", baseline_table), ("optimised", optimised_table))
    ]
    sensors = np.broadcast_to(np.asarray(sensor_xy, dtype=float), (2, 2))
    lane_m = (high - low) / max(round((high - low) / cell_m[1]), 1)
    x = np.concatenate([*(table["x_m"] for table in tables), sensors[:, 0]])
    y = np.concatenate([table["y_m"] for table in tables])
    x_edges = covering_edges(x.min(), x.max(), cell_m[0])
    y_edges = _lane_edges(y, low, high, lane_m)
    with sheet(path, 120.0, title, subtitle) as figure:
        panels = figure.subplots(2, 1, sharex=True, sharey=True)
        for axes, table, sensor, name, mounting in zip(panels, tables, sensors, names, mountings, strict=True):
            below = table["detectable"] == 0
            share = cell_shares(table["x_m"], table["y_m"], below, x_edges, y_edges)
            mesh, empty = _draw_cells(axes, x_edges, y_edges, share)
            _draw_lanes(axes, np.arange(low, high + 0.5 * lane_m, lane_m))
            marker = mark_sensor(axes, sensor)
            panel_title(axes, name, mounting, _summary(below))
            axes.set_ylabel("Across the road, y [m]")
            if not below.size:
                say_empty(axes, "no vehicles")
        panels[-1].set_ylim(
            min(y_edges[0], sensors[:, 1].min() - _MARGIN_M), max(y_edges[-1], sensors[:, 1].max() + _MARGIN_M)
        )
        panels[-1].set_xlim(x_edges[0], x_edges[-1])
        panels[-1].set_xlabel(TRAVEL_LABEL)
        figure.colorbar(mesh, ax=panels, label="Vehicles below the threshold [%]", pad=0.02)
        legend_below(figure, [marker, empty], columns=2)


def _lane_edges(y_m: np.ndarray, low: float, high: float, lane_m: float) -> np.ndarray:
    """Edges of the lanes, with more of the same width where vehicles drive beside the carriageway."""
    middle = (low + 0.5 * lane_m, high - 0.5 * lane_m)
    return covering_edges(
        min(y_m.min(initial=np.inf), middle[0]), max(y_m.max(initial=-np.inf), middle[1]), lane_m, low
    )


def _draw_cells(axes: Axes, x_edges: np.ndarray, y_edges: np.ndarray, share: np.ndarray) -> tuple[QuadMesh, object]:
    """Cells shaded by share in per cent over a hatched ground that shows where there is none."""
    from matplotlib.patches import Rectangle

    corner, size = (x_edges[0], y_edges[0]), (np.ptp(x_edges), np.ptp(y_edges))
    look = {"facecolor": "white", "edgecolor": FAINT, "hatch": "//////", "linewidth": 0.0}
    axes.add_patch(Rectangle(corner, *size, zorder=0, **look))
    mesh = axes.pcolormesh(
        x_edges, y_edges, np.ma.masked_invalid(100.0 * share), cmap=colours(BLIND_COLOURS), vmin=0.0, vmax=100.0
    )
    return mesh, Rectangle((0.0, 0.0), 1.0, 1.0, label="no vehicle was there", **look)


def _draw_lanes(axes: Axes, edges_m: np.ndarray) -> None:
    """The carriageway's two edges solid, the lines between its lanes dashed."""
    for y in edges_m[1:-1]:
        axes.axhline(y, color="black", linewidth=0.5, dashes=(6, 4))
    for y in edges_m[[0, -1]]:
        axes.axhline(y, color="black", linewidth=1.2)


def _summary(below: np.ndarray) -> str:
    """How many vehicles stay below the threshold, in words."""
    if not below.size:
        return "no vehicles"
    return f"{100.0 * below.mean():.1f} % of {below.size:,} vehicles below the threshold"
