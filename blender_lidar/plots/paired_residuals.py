"""Chart: where on the car real returns lie before or behind our shapes."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from .canvas import INK, sheet

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.collections import QuadMesh

_EDGES = (np.linspace(-0.5, 0.5, 26), np.linspace(-0.5, 0.5, 17), np.linspace(-0.5, 0.5, 17))  # x, y, z
_FEWEST = 5  # rays in a cell that is drawn
_MOST_M = 0.3  # of the colours


def plot_paired_residuals(
    path: str | Path, residuals: Mapping[str, np.ndarray], *, title: str = "", subtitle: str = ""
) -> None:
    """Draw the median residual over the car, from the side and from an end, a row for each level of detail.

    Parameters
    ----------
    path : str or Path
        The PNG to write.
    residuals : mapping of str to ndarray, (k, 4)
        By level of detail: x, y, z in the unit box, -0.5 to 0.5, and real less simulated range [m].
    """
    with sheet(path, 30.0 + 40.0 * len(residuals), title, subtitle) as figure:
        panels = figure.subplots(len(residuals), 2, squeeze=False, width_ratios=(2.6, 1.2), sharex="col", sharey=True)
        for row, (detail, values) in zip(panels, residuals.items(), strict=True):
            for axes, across in zip(row, (0, 1), strict=True):
                mesh = _draw(axes, values, across)
            off = np.abs(values[:, 3])
            row[0].set_title(f"{detail}: median |residual| {np.median(off) if len(off) else np.nan:.3f} m")
            row[0].set_ylabel("Height in the box [%]")
        panels[-1][0].set_xlabel("Along the box, tail to nose [%]")
        panels[-1][1].set_xlabel("Across the box, right to left [%]")
        label = "Real less simulated range [m]"
        figure.colorbar(mesh, ax=panels.ravel().tolist(), label=label, pad=0.02, extend="both")


def _draw(axes: Axes, values: np.ndarray, across: int) -> QuadMesh:
    edges, heights = _EDGES[across], _EDGES[2]
    column, row = (
        np.clip(np.searchsorted(line, values[:, axis], side="right") - 1, 0, len(line) - 2)
        for line, axis in ((edges, across), (heights, 2))
    )
    cell = row * (len(edges) - 1) + column
    median = np.full((len(heights) - 1) * (len(edges) - 1), np.nan)
    order = np.argsort(cell, kind="stable")
    cells, first = np.unique(cell[order], return_index=True)
    for one, mine in zip(cells, np.split(values[order, 3], first[1:]), strict=True):
        if len(mine) >= _FEWEST:
            median[one] = np.median(mine)
    axes.set_facecolor("#e8e8e8")
    mesh = axes.pcolormesh(
        100.0 * (edges + 0.5),
        100.0 * (heights + 0.5),
        np.ma.masked_invalid(median.reshape(len(heights) - 1, -1)),
        cmap="PuOr",
        vmin=-_MOST_M,
        vmax=_MOST_M,
    )
    for spine in axes.spines.values():
        spine.set_color(INK)
    return mesh
