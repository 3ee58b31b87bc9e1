"""Names beside many points, none of them over another or over a point."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from .canvas import INK

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_FONT_PT = 5.6
_GAP_PT = 0.6  # between a point and its name
_RINGS = (_GAP_PT, 4.5, 9.0, 14.0, 20.0, 27.0, 35.0, 45.0, 56.0)
_DIRECTIONS = np.radians(np.arange(0.0, 360.0, 22.5))
_APART_PT = 0.3  # about each name: where it is drawn is rounded
_LINE_PT = 0.4  # half the width of a line


def name_points(
    axes: Axes,
    places: np.ndarray,
    names: Sequence[str],
    weights: Sequence[str],
    sizes_pt: Sequence[float],
    lines: Sequence[tuple[tuple[float, float], tuple[float, float]]] = (),
) -> None:
    """Write each point's name near it; those farther away get a thin line to their point.

    The crowded ones choose first. A name for which nothing is free goes where it covers least.

    Parameters
    ----------
    axes : Axes
        With their final limits and place.
    places : ndarray, (n, 2)
        The points, in data coordinates.
    names, weights : sequence of str, (n,)
        And how bold they are.
    sizes_pt : sequence of float, (n,)
        Half the side of what each marker covers [points].
    lines : sequence of two points
        Level and upright lines that no name should cross.
    """
    figure = axes.figure
    scale = figure.dpi / 72.0
    at = axes.transData.transform(places)
    texts = [
        axes.text(*place, name, fontsize=_FONT_PT, weight=weight, color=INK, ha="center", va="center", zorder=5)
        for place, name, weight in zip(places, names, weights, strict=True)
    ]
    half = np.array([(box.width, box.height) for box in (text.get_window_extent() for text in texts)]) / 2.0
    half += _APART_PT * scale
    inside = axes.get_window_extent()
    near = np.hypot(*(at[:, None] - at[None]).transpose(2, 0, 1))
    crowd = (near < 40.0 * scale).sum(axis=1)
    covered = [(place, np.full(2, size * scale)) for place, size in zip(at, sizes_pt, strict=True)]
    for line in lines:
        ends = axes.transData.transform(line)
        covered.append((ends.mean(axis=0), 0.5 * np.abs(ends[1] - ends[0]) + _LINE_PT * scale))
    for row in np.argsort(-crowd, kind="stable").tolist():
        spot, ring = _free_spot(at[row], half[row], sizes_pt[row] * scale, covered, inside, scale)
        covered.append((spot, half[row]))
        texts[row].set_position(axes.transData.inverted().transform(spot))
        if ring > 0:
            end = np.clip(at[row], spot - half[row], spot + half[row])
            line = axes.transData.inverted().transform([at[row], end])
            axes.plot(*line.T, color=INK, linewidth=0.3, zorder=1.5)


def _free_spot(point, half, size, covered, inside, scale) -> tuple[np.ndarray, int]:
    """Middle of a name's box beside a point, the nearest that is free, and on which ring about the point it lies."""
    middles, sizes = (np.array(column) for column in zip(*covered, strict=True))
    best = None
    for ring, radius in enumerate(_RINGS):
        for direction in _DIRECTIONS:
            way = np.array([np.cos(direction), np.sin(direction)])
            spot = point + way * (half * np.array([abs(way[0]) ** 0.5, abs(way[1]) ** 0.5]) + size + radius * scale)
            overlap = np.clip(half + sizes - np.abs(middles - spot), 0.0, None).prod(axis=1).sum()
            outside = (spot - half < [inside.x0, inside.y0]).any() or (spot + half > [inside.x1, inside.y1]).any()
            cost = overlap + 1e6 * outside
            if best is None or cost < best[0]:
                best = (cost, spot, ring)
            if best[0] == 0.0:
                return best[1], best[2]
    return best[1], best[2]
