"""Charts: simulated against real scores, car by car; and single cars as the real and the simulated LiDAR saw them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from .canvas import HEIGHT_COLOURS, INK, WIDTH_MM, colours, header_mm, place, sheet

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Car = tuple[str, np.ndarray, np.ndarray, Mapping[str, np.ndarray]]
_LEFT_MM, _GAP_MM, _TITLE_MM, _BELOW_MM = 14.0, 4.0, 10.0, 11.0
_EDGE_M = 0.3  # about a car


def plot_paired_scores(
    path: str | Path,
    real: np.ndarray,
    simulated: Mapping[str, np.ndarray],
    distance_m: np.ndarray,
    *,
    title: str = "",
    subtitle: str = "",
) -> None:
    """Draw every car's simulated score over its real one, a panel for each level of detail.

    Parameters
    ----------
    path : str or Path
        The PNG to write.
    real : ndarray, (c,)
        PE-VGOP of each car [bits].
    simulated : mapping of str to ndarray, (c,)
        The same as simulated, by level of detail.
    distance_m : ndarray, (c,)
        Shown by lightness [m].
    """
    with sheet(path, 80.0, title, subtitle) as figure:
        panels = figure.subplots(1, len(simulated), sharex=True, sharey=True, squeeze=False)[0]
        top = 1.05 * max(float(np.max(values, initial=0.1)) for values in (real, *simulated.values()))
        for axes, (detail, values) in zip(panels, simulated.items(), strict=True):
            axes.plot([0.0, top], [0.0, top], color=INK, linewidth=0.8)
            dots = axes.scatter(
                real, values, c=distance_m, s=9.0, linewidths=0.0, cmap=colours(HEIGHT_COLOURS), vmin=10.0, vmax=50.0
            )
            axes.set_aspect("equal")
            axes.set_xlim(0.0, top)
            axes.set_ylim(0.0, top)
            axes.set_title(f"{detail}: median error {np.median(np.abs(values - real)):.3f}")
            axes.grid(visible=True)
        panels[len(panels) // 2].set_xlabel("Real PE-VGOP [bits]")
        panels[0].set_ylabel("Simulated PE-VGOP [bits]")
        figure.colorbar(dots, ax=list(panels), label="Distance [m]", pad=0.02)


def plot_paired_cars(path: str | Path, cars: Sequence[Car], *, title: str = "", subtitle: str = "") -> None:
    """Draw cars to scale from the side and from above: what they gave in reality, and what our shapes give.

    Parameters
    ----------
    path : str or Path
        The PNG to write.
    cars : sequence of (name, size (3,), real points (n, 3), points (m, 3) by level of detail)
        Points in each car's own frame [m].
    """
    columns = 1 + max((len(simulated) for *_, simulated in cars), default=0)
    width = (WIDTH_MM - _LEFT_MM - _GAP_MM * columns) / columns
    blocks = [_block(size, width) for _, size, _, _ in cars]
    header = header_mm(title, subtitle)
    height = header + sum(_TITLE_MM + side + top + _GAP_MM + _BELOW_MM for side, top in blocks)
    with sheet(path, height, title, subtitle, to_scale=True) as figure:
        at = header
        for (name, size, real, simulated), (side, top) in zip(cars, blocks, strict=True):
            figure.text(0.012, 1.0 - (at + 3.0) / height, name, fontsize=8.5, fontweight="bold")
            at += _TITLE_MM
            for column, (kind, points) in enumerate({"real": real, **simulated}.items()):
                left = _LEFT_MM + column * (width + _GAP_MM)
                panels = place(figure, left, at, width, side), place(figure, left, at + side + _GAP_MM, width, top)
                for axes, view, label in zip(panels, ((0, 2), (0, 1)), ("z [m]", "y [m]"), strict=True):
                    _draw(axes, points, size, view)
                    axes.tick_params(labelleft=column == 0)
                    if column == 0:
                        axes.set_ylabel(label)
                panels[0].set_title(f"{kind}: {len(points):,} points")
                panels[0].tick_params(labelbottom=False)
                panels[1].set_xlabel("x [m], forward")
            at += side + _GAP_MM + top + _BELOW_MM


def _block(size: np.ndarray, width: float) -> tuple[float, float]:
    """Heights of the panels from the side and from above [mm]."""
    scale = width / (size[0] + 2.0 * _EDGE_M)
    return scale * (size[2] + 2.0 * _EDGE_M), scale * (size[1] + 2.0 * _EDGE_M)


def _draw(axes: Axes, points: np.ndarray, size: np.ndarray, view: tuple[int, int]) -> None:
    from matplotlib.patches import Rectangle

    across, up = view
    half = 0.5 * size
    axes.add_patch(
        Rectangle((-half[across], -half[up]), size[across], size[up], facecolor="none", edgecolor=INK, linewidth=0.7)
    )
    axes.plot(points[:, across], points[:, up], ".", color="#173f70", markersize=1.6, markeredgewidth=0.0)
    axes.set_xlim(-half[across] - _EDGE_M, half[across] + _EDGE_M)
    axes.set_ylim(-half[up] - _EDGE_M, half[up] + _EDGE_M)
