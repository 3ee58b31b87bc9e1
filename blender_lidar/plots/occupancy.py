"""Chart: one vehicle's three occupancy grids before and after (the paper's Fig. 4)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..errors import InputError
from ..metrics.vgop import VIEWS, entropy
from .canvas import FAINT, OPTIMISED, SMALL_PT, WIDTH_MM, header_mm, panel_title, place, sheet

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_LONGEST_MM = 79.0  # room for a vehicle's length on half a sheet
_LARGEST_SCALE = 20.0  # millimetres on paper for a metre: 1 to 50
_TITLE_MM = 10.0  # above a mounting's drawing
_PAD_MM = 3.0
_GAP_MM = 7.0  # above each view, for its caption
_LEAST_OUTLINED_MM = 0.5  # smaller cells would drown in their outlines
_SIDES_OF_VIEW = {"top": (0, 1), "side": (0, 2), "front": (1, 2)}  # of the box, to the right and upwards


@dataclass(frozen=True, slots=True)
class OccupancyViews:
    """One vehicle under one mounting.

    Attributes
    ----------
    grids : mapping of str to ndarray of bool
        ``top`` (length cells, width cells), ``side`` (length, height) and ``front`` (width, height): True where a
        point fell. Cell (0, 0) lies at the box's rear, right, bottom end of the two axes.
    size_m : tuple of float
        Length, width and height of the box [m].
    cell_m : float
        Side of a cell [m].

    Raises
    ------
    InputError
        If a view is missing, empty or not a grid, or a length is not positive.
    """

    grids: Mapping[str, np.ndarray]
    size_m: tuple[float, float, float]
    cell_m: float = 0.05

    def __post_init__(self) -> None:
        if np.shape(self.size_m) != (3,) or not np.min(self.size_m) > 0.0:
            raise InputError(f"occupancy chart: size_m must be three positive lengths, got {self.size_m}")
        for view in VIEWS:
            if view not in self.grids:
                raise InputError(f"occupancy chart: no view {view!r}; needed: {', '.join(VIEWS)}")
            if np.ndim(self.grids[view]) != 2 or not np.size(self.grids[view]):
                raise InputError(
                    f"occupancy chart: view {view!r} has shape {np.shape(self.grids[view])}; needed: (r, c)"
                )

    def occupancy(self, view: str) -> float:
        """Share of the view's cells that hold a point: P of Eq. 7."""
        return float(np.mean(self.grids[view]))


def plot_occupancy(
    path: str | Path,
    before: OccupancyViews,
    after: OccupancyViews,
    *,
    names: tuple[str, str] = ("Baseline", "Optimised"),
    mountings: tuple[str, str] = ("", ""),
    title: str = "",
    subtitle: str = "",
) -> None:
    """Draw the top, side and front grid of one vehicle under both mountings, all at one scale.

    Parameters
    ----------
    path : str or Path
        The PNG to write.
    before, after : OccupancyViews
        The vehicle under the baseline and under the optimised mounting.
    names, mountings : tuple of str
        What to call the two mountings, and what to write behind it, as "height 2.0 m, tilt 0°".
    title, subtitle : str
        Headings.
    """
    length, width, height = np.maximum(before.size_m, after.size_m)
    scale = min(_LONGEST_MM / length, _LARGEST_SCALE)
    drawing_mm = scale * (width + 2.0 * height) + 4.0 * _GAP_MM
    header = header_mm(title, subtitle) + _TITLE_MM
    with sheet(path, header + drawing_mm + _PAD_MM, title, subtitle, to_scale=True) as figure:
        for left_mm, vehicle, name, mounting in zip(
            (_PAD_MM, 0.5 * WIDTH_MM + _PAD_MM), (before, after), names, mountings, strict=True
        ):
            axes = place(figure, left_mm, header, _LONGEST_MM, drawing_mm)
            axes.set_axis_off()
            axes.set_xlim(0.0, _LONGEST_MM / scale)
            axes.set_ylim(-drawing_mm / scale, 0.0)
            floor = 0.0
            for view in VIEWS:
                floor = _draw_view(axes, vehicle, view, floor, scale)
            _draw_scale_bar(axes, floor - _GAP_MM / scale, vehicle.cell_m, scale)
            total = sum(float(entropy(vehicle.occupancy(view))) for view in VIEWS)
            panel_title(axes, name, mounting, f"PE-VGOP {total:z.3f} bits")


def _draw_view(axes: Axes, vehicle: OccupancyViews, view: str, ceiling: float, scale: float) -> float:
    """One grid with its caption, below `ceiling` [m on the drawing]; returns where it ends."""
    from matplotlib.colors import ListedColormap
    from matplotlib.patches import Rectangle

    grid = np.asarray(vehicle.grids[view], dtype=float)
    across, up = (vehicle.size_m[side] for side in _SIDES_OF_VIEW[view])
    floor = ceiling - _GAP_MM / scale - up
    lines = {"edgecolors": FAINT, "linewidth": 0.25} if scale * vehicle.cell_m >= _LEAST_OUTLINED_MM else {}
    edges = [vehicle.cell_m * np.arange(cells + 1) for cells in grid.shape]
    colours = ListedColormap(["white", OPTIMISED["color"]])
    axes.pcolormesh(edges[0], floor + edges[1], grid.T, cmap=colours, vmin=0.0, vmax=1.0, clip_on=False, **lines)
    axes.add_patch(Rectangle((0.0, floor), across, up, fill=False, edgecolor="black", linewidth=1.0, clip_on=False))
    p = vehicle.occupancy(view)
    caption = f"{view} view, {across:.2f} m by {up:.2f} m: P = {p:.4f}, adds {entropy(p):z.3f} bits"
    axes.text(0.0, floor + up + 1.0 / scale, caption, va="bottom", fontsize=SMALL_PT)
    return floor


def _draw_scale_bar(axes: Axes, height: float, cell_m: float, scale: float) -> None:
    """One metre, and what a cell measures."""
    axes.plot([0.0, 1.0], [height, height], "|-", color="black", linewidth=1.0, markersize=6.0, clip_on=False)
    text = f"1 m; a cell is {cell_m:g} m by {cell_m:g} m"
    axes.text(1.0 + 2.0 / scale, height, text, va="center", fontsize=SMALL_PT)
