"""Names beside many points, none of them over another or over a point."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from .canvas import INK

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_FONT_PT = 5.6
_GAP_PT = 3.2  # between a point and its name
_RINGS = tuple(_GAP_PT * factor for factor in (1.0, 2.2, 3.6, 5.2, 7.0, 9.0, 11.5, 14.5, 18.0))
_DIRECTIONS = np.radians(np.arange(0.0, 360.0, 22.5))
_POINT_PT = 2.6  # half the side of what a marker covers


def name_points(axes: Axes, places: np.ndarray, names: Sequence[str], weights: Sequence[str]) -> None:
    """Write each point's name near it, in data coordinates (n, 2); those farther away get a thin line to their point.

    The crowded ones choose first. Axes must have their final limits and place. A name for which nothing is free goes
    where it covers least.
    """
    figure = axes.figure
    scale = figure.dpi / 72.0
    at = axes.transData.transform(places)
    texts = [
        axes.text(*place, name, fontsize=_FONT_PT, weight=weight, color=INK, ha="center", va="center", zorder=5)
        for place, name, weight in zip(places, names, weights, strict=True)
    ]
    half = np.array([(box.width, box.height) for box in (text.get_window_extent() for text in texts)]) / 2.0
    inside = axes.get_window_extent()
    near = np.hypot(*(at[:, None] - at[None]).transpose(2, 0, 1))
    crowd = (near < 40.0 * scale).sum(axis=1)
    covered = [(place, np.full(2, _POINT_PT * scale)) for place in at]
    for row in np.argsort(-crowd, kind="stable").tolist():
        spot, ring = _free_spot(at[row], half[row], covered, inside, scale)
        covered.append((spot, half[row]))
        texts[row].set_position(axes.transData.inverted().transform(spot))
        if ring > 0:
            end = np.clip(at[row], spot - half[row], spot + half[row])
            line = axes.transData.inverted().transform([at[row], end])
            axes.plot(*line.T, color=INK, linewidth=0.3, zorder=1.5)


def _free_spot(point, half, covered, inside, scale) -> tuple[np.ndarray, int]:
    """Middle of a name's box beside a point, the nearest that is free, and on which ring about the point it lies."""
    middles, sizes = (np.array(column) for column in zip(*covered, strict=True))
    best = None
    for ring, radius in enumerate(_RINGS):
        for direction in _DIRECTIONS:
            way = np.array([np.cos(direction), np.sin(direction)])
            spot = point + way * (half * np.array([abs(way[0]) ** 0.5, abs(way[1]) ** 0.5]) + radius * scale)
            overlap = np.clip(half + sizes - np.abs(middles - spot), 0.0, None).prod(axis=1).sum()
            outside = (spot - half < [inside.x0, inside.y0]).any() or (spot + half > [inside.x1, inside.y1]).any()
            cost = overlap + 1e6 * outside
            if best is None or cost < best[0]:
                best = (cost, spot, ring)
            if best[0] == 0.0:
                return best[1], best[2]
    return best[1], best[2]
