"""Chart: the point clouds of the two mountings from above."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from ..errors import InputError
from .binning import columns, footprints
from .canvas import (
    FAINT,
    HEIGHT_COLOURS,
    INK,
    TRAVEL_LABEL,
    WIDTH_MM,
    colours,
    header_mm,
    legend_below,
    mark_sensor,
    panel_title,
    place,
    sheet,
)

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.collections import PathCollection
    from matplotlib.patches import Patch

_BOX_COLUMNS = ("x_m", "y_m", "length_m", "width_m", "heading_deg")
_MARGIN_M = 2.0
_LONGEST_M = 160.0  # a longer piece of road is cut into stretches below one another
_HIGHEST_M = 4.0  # a truck's roof: all panels, and any two charts, share one scale
_LEFT_MM, _PANEL_MM = 13.0, 152.0  # where the panels begin on paper, and their width
_TITLE_MM, _TICKS_MM, _KEY_MM = 9.0, 7.0, 30.0  # above a mounting, below a panel, below all panels
_STEEPEST = 0.45  # a panel's height over its width is at most this


@dataclass(frozen=True, slots=True)
class _Mounting:
    """What is drawn of one mounting."""

    title: tuple[str, str, str]
    sensor_xy: np.ndarray
    xyz: np.ndarray
    on_vehicle: np.ndarray
    detectable: np.ndarray


def plot_clouds(
    path: str | Path,
    clouds: tuple[Mapping[str, ArrayLike], Mapping[str, ArrayLike]],
    boxes: Mapping[str, ArrayLike],
    detectable: tuple[ArrayLike, ArrayLike],
    sensor_xy: ArrayLike,
    *,
    names: tuple[str, str] = ("Baseline", "Optimised"),
    mountings: tuple[str, str] = ("", ""),
    title: str = "",
    subtitle: str = "",
) -> None:
    """Draw one frame's cloud under the baseline and under the optimised mounting, to scale.

    Parameters
    ----------
    path : str or Path
        The PNG to write.
    clouds : two mappings of str to array_like
        ``xyz`` (n, 3) [m, road frame] and ``vehicle_id`` (n,), -1 on the ground and other things.
    boxes : mapping of str to array_like, (v,)
        ``x_m``, ``y_m``, ``length_m``, ``width_m`` [m] and ``heading_deg`` of the frame's vehicles. They and the LiDAR
        set what part of the road is drawn.
    detectable : two array_like, (v,) bool
        Which vehicles reach the threshold under each mounting.
    sensor_xy : array_like, (2,) or (2, 2)
        Where the LiDAR stands [m, road frame]; two rows when the optimised mounting stands elsewhere.
    names, mountings : tuple of str
        What to call the two mountings, and what to write behind it, as "height 2.0 m, tilt 0°".
    title, subtitle : str
        Headings.

    Raises
    ------
    InputError
        If an array is missing or of another shape.
    """
    box = columns(boxes, _BOX_COLUMNS, "boxes")
    corners = footprints(*(box[name] for name in _BOX_COLUMNS))
    sensors = np.broadcast_to(np.asarray(sensor_xy, dtype=float), (2, 2))
    drawn = [
        _mounting(name, *of_one, vehicles=len(corners))
        for name, *of_one in zip(names, mountings, sensors, clouds, detectable, strict=True)
    ]
    x_edges, (low, high) = _stretches(np.concatenate([corners.reshape(-1, 2), sensors]))
    rows = len(x_edges) - 1
    panel_mm = _PANEL_MM * (high - low) / (x_edges[1] - x_edges[0])
    mounting_mm = _TITLE_MM + rows * (panel_mm + _TICKS_MM)
    header = header_mm(title, subtitle)
    with sheet(path, header + 2.0 * mounting_mm + _KEY_MM, title, subtitle, to_scale=True) as figure:
        for index, mounting in enumerate(drawn):
            for row in range(rows):
                top = header + index * mounting_mm + _TITLE_MM + row * (panel_mm + _TICKS_MM)
                axes = place(figure, _LEFT_MM, top, _PANEL_MM, panel_mm)
                dots, entries = _draw_panel(axes, mounting, corners)
                axes.set_xlim(x_edges[row : row + 2])
                axes.set_ylim(low, high)
                if row == 0:
                    panel_title(axes, *mounting.title)
        axes.set_xlabel(TRAVEL_LABEL)
        bar = place(figure, 0.25 * WIDTH_MM, header + 2.0 * mounting_mm + 7.0, 0.5 * WIDTH_MM, 2.5)
        label = "Height above the road of points on vehicles [m]"
        figure.colorbar(dots, cax=bar, orientation="horizontal", label=label)
        legend_below(figure, entries, columns=3)


def _stretches(window: np.ndarray) -> tuple[np.ndarray, tuple[float, float]]:
    """Edges along x of the pieces of road that hold the points (n, 2), and their common range of y [m]."""
    low, high = window.min(axis=0) - _MARGIN_M, window.max(axis=0) + _MARGIN_M
    length, width = high - low
    missing = max(width / _STEEPEST - length, 0.0)
    pieces = math.ceil((length + missing) / _LONGEST_M)
    return np.linspace(low[0] - 0.5 * missing, high[0] + 0.5 * missing, pieces + 1), (low[1], high[1])


def _mounting(
    name: str,
    text: str,
    sensor_xy: np.ndarray,
    cloud: Mapping[str, ArrayLike],
    detectable: ArrayLike,
    vehicles: int,
) -> _Mounting:
    """Check one mounting's arrays and put its results into words."""
    for array in ("xyz", "vehicle_id"):
        if array not in cloud:
            raise InputError(f"{name} cloud: no array {array!r}; needed: xyz, vehicle_id")
    xyz, vehicle, seen = np.asarray(cloud["xyz"], dtype=float), np.asarray(cloud["vehicle_id"]), np.asarray(detectable)
    if xyz.ndim != 2 or xyz.shape[1] != 3 or vehicle.shape != xyz.shape[:1]:
        raise InputError(
            f"{name} cloud: xyz has shape {xyz.shape}, vehicle_id {vehicle.shape}; needed: (n, 3) and (n,)"
        )
    if seen.shape != (vehicles,):
        raise InputError(f"{name} cloud: detectable has shape {seen.shape}; there are {vehicles} boxes")
    on_vehicle, seen = vehicle >= 0, seen.astype(bool)
    result = f"{seen.sum()} of {vehicles} vehicles detectable, {on_vehicle.sum():,} points on vehicles"
    return _Mounting((name, text, result), sensor_xy, xyz, on_vehicle, seen)


def _draw_panel(axes: Axes, mounting: _Mounting, corners: np.ndarray) -> tuple[PathCollection, list[Artist]]:
    """The cloud, the boxes and the LiDAR; returns the graded points and the legend's entries."""
    dots = _draw_points(axes, mounting.xyz, mounting.on_vehicle)
    outlines = _draw_boxes(axes, corners, mounting.detectable)
    marker = mark_sensor(axes, mounting.sensor_xy)
    axes.set_ylabel("y [m]")
    axes.yaxis.get_major_locator().set_params(integer=True)
    return dots, [marker, *outlines]


def _draw_points(axes: Axes, xyz: np.ndarray, on_vehicle: np.ndarray) -> PathCollection:
    """Ground faint, points on vehicles the darker the higher they lie."""
    ground, vehicle = xyz[~on_vehicle], xyz[on_vehicle]
    axes.plot(ground[:, 0], ground[:, 1], ".", color=FAINT, markersize=1.0, markeredgewidth=0.0, zorder=1)
    return axes.scatter(
        vehicle[:, 0],
        vehicle[:, 1],
        c=vehicle[:, 2],
        s=1.5,
        linewidths=0.0,
        cmap=colours(HEIGHT_COLOURS),
        vmin=0.0,
        vmax=_HIGHEST_M,
        zorder=3,
    )


def _draw_boxes(axes: Axes, corners: np.ndarray, detectable: np.ndarray) -> list[Patch]:
    """Outlines from above, solid if detectable, else dashed and grey inside; returns the legend's entries."""
    from matplotlib.collections import PolyCollection
    from matplotlib.patches import Patch

    solid = {"facecolor": "white", "edgecolor": INK, "linewidth": 0.7}
    dashed = {**solid, "facecolor": "#e2e2e2", "linestyle": (0, (2.5, 1.5))}
    for chosen, look in ((detectable, solid), (~detectable, dashed)):
        axes.add_collection(PolyCollection(corners[chosen], zorder=2, **look))
    return [Patch(label="vehicle, detectable", **solid), Patch(label="vehicle, not detectable", **dashed)]
