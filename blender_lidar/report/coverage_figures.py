"""Coverage on a plan of the site: where vehicles stay below the threshold, and how far half of them are seen."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ..run.folder import RunFolder
from ..run.words import each_lidar, run_text, sides
from ..scene.settings import ZoneSettings
from .figure import (
    BLIND_COLOURS,
    INK,
    OPTIMISED_LOOK,
    SMALL_PT,
    WIDTH_MM,
    colours,
    legend_below,
    place,
)
from .plan import Stand, background, draw_stands, mm_per_m, north_arrow, north_name, plans, scale_bar, window_of
from .road_plan import ASPHALT_LOOK, SEEN_THROUGH_LOOK, draw_road

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.collections import PolyCollection

    from ..road.road_map import RoadMap

_MARGIN_M = 2.0  # around what is shown
_KEY_MM = 30.0  # below all panels

# --- Blind zones: cells of the site frame and the boxes whose footprints overlap them ---------------------------------

_CELL_M, _FINE_CELL_M, _SMALL_SITE_M = 2.0, 1.0, 60.0
FEW_BOXES = 5  # in a cell, whose share then says little
_SPAN = 5  # cells: side of the square over which the contour's shares are
_AT_ONCE = 2000  # boxes that are laid on the cells together


class Cells(NamedTuple):
    """Square cells of the site frame, and how many boxes overlap each.

    Attributes
    ----------
    corner_m : ndarray, (2,)
        Lower left corner of the first cell [m].
    side_m : float
    boxes, below : ndarray of int, (ny, nx)
        Boxes whose footprints overlap a cell, and those of them below the threshold.
    """

    corner_m: np.ndarray
    side_m: float
    boxes: np.ndarray
    below: np.ndarray


def footprints(table: Mapping[str, np.ndarray]) -> np.ndarray:
    """Corners of the boxes of a vehicle table from above, (n, 4, 2) [m, site frame]."""
    turn = np.exp(1j * np.radians(table["heading_deg"]))[:, None]
    half = 0.5 * np.array([1 + 1j, -1 + 1j, -1 - 1j, 1 - 1j])
    corners = turn * (half.real * table["length_m"][:, None] + 1j * half.imag * table["width_m"][:, None])
    return np.stack([corners.real + table["x_m"][:, None], corners.imag + table["y_m"][:, None]], axis=-1)


def cells_of(table: Mapping[str, np.ndarray], side_m: float) -> Cells:
    """Lay the footprints of a vehicle table on square cells, whose edges are at whole multiples of their side.

    A footprint overlaps a cell where they share an area (separating axis theorem).
    """
    corners = footprints(table)
    low, high = corners.min(axis=1), corners.max(axis=1)
    first = np.floor(low.min(axis=0) / side_m).astype(int)
    columns, rows = np.floor(high.max(axis=0) / side_m).astype(int) - first + 1
    reach = int(np.ceil((high - low).max() / side_m)) + 1
    offset = np.stack(np.meshgrid(np.arange(reach), np.arange(reach)), axis=-1).reshape(-1, 2)
    counts = np.zeros((2, rows * columns), dtype=int)
    missed = ~np.asarray(table["detectable"], dtype=bool)
    size = 0.5 * np.stack([table["length_m"], table["width_m"]], axis=1)
    turn = np.radians(table["heading_deg"])
    for start in range(0, len(corners), _AT_ONCE):
        part = slice(start, start + _AT_ONCE)
        cell = np.floor(low[part] / side_m).astype(int)[:, None] + offset  # (n, k, 2)
        at = side_m * cell
        overlaps = ((at < high[part, None]) & (at + side_m > low[part, None])).all(axis=-1)
        away = at + 0.5 * side_m - 0.5 * (low + high)[part, None]
        for along, half in ((turn[part], size[part, 0]), (turn[part] + 0.5 * math.pi, size[part, 1])):
            axis = np.stack([np.cos(along), np.sin(along)], axis=-1)
            room = half + 0.5 * side_m * np.abs(axis).sum(axis=1)
            overlaps &= np.abs((away * axis[:, None]).sum(axis=-1)) < room[:, None]
        box, which = np.nonzero(overlaps)
        x, y = (cell[box, which] - first).T
        flat = y * columns + x
        counts[0] += np.bincount(flat, minlength=rows * columns)
        counts[1] += np.bincount(flat[missed[part][box]], minlength=rows * columns)
    boxes, below = counts.reshape(2, rows, columns)
    return Cells(first * side_m, side_m, boxes, below)


Image = tuple[str | Path, Sequence[Sequence[float]]]
"""A picture of the site and the points that place it, as `plan.background` takes them."""

_FEW = {"facecolor": "white", "edgecolor": "#a0a0a0", "hatch": "////////", "linewidth": 0.0}
_HALO = {"colors": "white", "linewidths": 3.2}
_HALF = {"colors": OPTIMISED_LOOK["color"], "linewidths": 1.8}


def plot_blind_zones(
    path: str | Path, run: RunFolder, road: RoadMap, zones: Sequence[ZoneSettings] = (), image: Image | None = None
) -> None:
    """Draw the share of boxes below the detectability threshold in cells of 1 or 2 m, before and after, to scale.

    A cell's boxes are those whose footprints overlap it; one of fewer than `FEW_BOXES` is hatched, not shaded. The
    contour is where half of the boxes are detectable (`smoothed`). Circles are distances from each LiDAR; `zones` of
    weights are outlined.
    """
    tables, stands = run.judged, _stands(run)
    window = window_of([footprints(tables[0]), *([one.xy for one in side] for side in stands)], _MARGIN_M)
    side_m = _CELL_M if np.ptp(window, axis=0).max() >= _SMALL_SITE_M else _FINE_CELL_M
    found = [
        f"{100.0 * (~table['detectable'].astype(bool)).mean():.1f} % of {len(table['x_m']):,} boxes below the threshold"
        for table in tables
    ]
    headings = [f"{name}: {text}\n{one}" for (name, text, _), one in zip(sides(run.result), found, strict=True)]
    subtitle = f"{run_text(run.result, held_out=True)}; cells of {side_m:g} m"
    heading = "Where vehicles stay below the threshold", subtitle
    with plans(path, window, headings, _KEY_MM, *heading, road=road) as (figure, panels, end):
        for axes, table, side in zip(panels, tables, stands, strict=True):
            if image is not None:
                background(axes, *image)
            draw_road(axes, road, window, SEEN_THROUGH_LOOK if image else ASPHALT_LOOK, arrows=not road.endless)
            shades = _draw_cells(axes, cells_of(table, side_m))
            marker = draw_stands(axes, side)
            outlines = [_outline_zone(axes, zone) for zone in zones]
            _draw_rings(axes, [stand.xy for stand in side], window)
        _below_plans(panels, run, road)
        bar = place(figure, 0.5 * (WIDTH_MM - 84.0), end + 2.0, 84.0, 2.5)
        figure.colorbar(shades, cax=bar, orientation="horizontal", label="Boxes below the threshold [%]")
        bar.axvline(50.0, color=_HALF["colors"], linewidth=_HALF["linewidths"])
        legend_below(figure, [*_entries(side_m, image is not None), marker, *outlines[:1]], columns=3)


def _stands(run: RunFolder) -> list[list[Stand]]:
    """The LiDARs of each side, with their names where there are several."""
    return [
        [Stand(name, (at["x_m"], at["y_m"]), math.radians(at.get("facing_deg", 90.0))) for name, at in mounts.items()]
        for *_, mounts in sides(run.result)
    ]


def _below_plans(panels: Sequence[Axes], run: RunFolder, road: RoadMap) -> None:
    """North arrow and scale bar below the panels that have a label there."""
    result = next(iter(each_lidar(run.result).values()))
    mount, pointing = result["deployment"], result.get("pointing")
    for axes in panels:
        if axes.get_xlabel():
            scale_bar(axes)
            if pointing:  # bearings fall as angles rise
                bearing = pointing["facing_bearing_deg"] + mount.get("facing_deg", 90.0) - 90.0
                north_arrow(axes, bearing, north_name(road))


def smoothed(counts: np.ndarray) -> np.ndarray:
    """Box filter: the sum of each cell's counts (ny, nx) and those of its neighbours in a square of `_SPAN` cells."""
    padded = np.pad(counts, _SPAN // 2)
    return np.lib.stride_tricks.sliding_window_view(padded, (_SPAN, _SPAN)).sum(axis=(-2, -1))


def _draw_cells(axes: Axes, cells: Cells) -> PolyCollection:
    """Cells shaded by per cent, hatched where there are few boxes; the contour of half of them, where there are not."""
    from matplotlib.collections import PolyCollection

    few, there = cells.boxes < FEW_BOXES, cells.boxes > 0
    axes.add_collection(PolyCollection(_squares(cells, few & there), zorder=1.0, **_FEW), autolim=False)
    look = {"cmap": colours(BLIND_COLOURS), "zorder": 1.0, "linewidth": 0.0, "antialiased": False}
    shades = PolyCollection(_squares(cells, ~few), **look)
    shades.set_array(100.0 * cells.below[~few] / cells.boxes[~few])
    shades.set_clim(0.0, 100.0)
    axes.add_collection(shades, autolim=False)
    share = np.ma.masked_where(few, smoothed(cells.below) / np.maximum(smoothed(cells.boxes), 1))
    if min(share.shape) > 1 and share.min() < 0.5 < share.max():
        middles = [cells.corner_m[k] + cells.side_m * (np.arange(n) + 0.5) for k, n in enumerate(share.shape[::-1])]
        for look in (_HALO, _HALF):
            axes.contour(*middles, share, levels=[0.5], zorder=2.45, **look)
    return shades


def _squares(cells: Cells, chosen: np.ndarray) -> np.ndarray:
    """Corners of the cells that are chosen (ny, nx), (k, 4, 2) [m]."""
    corner = cells.corner_m + cells.side_m * np.argwhere(chosen)[:, ::-1]
    return corner[:, None] + cells.side_m * np.array([(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)])


def _entries(side_m: float, seen_through: bool) -> list[Artist]:
    """The legend of cells, contour and circles."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    across = f"half of the boxes detectable, in squares of {_SPAN * side_m:g} m"
    return [
        Line2D([], [], color=_HALF["colors"], linewidth=_HALF["linewidths"], label=across),
        Patch(label=f"fewer than {FEW_BOXES} boxes: too few to say", **_FEW),
        *[Patch(label="no vehicle was there", **ASPHALT_LOOK)] * (not seen_through),
        Line2D([], [], label="distance from the LiDAR", **_RING),
    ]


def _outline_zone(axes, zone):
    """The outline of a zone with its name and weight in it."""
    x, y = np.array([*zone.polygon_m, zone.polygon_m[0]]).T
    (line,) = axes.plot(x, y, color=INK, linewidth=1.2, linestyle=(0, (4, 2)), label="zone x weight", zorder=3)
    box = {"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 1.0}
    look = {"ha": "center", "va": "center", "fontsize": SMALL_PT, "bbox": box, "clip_on": True}
    axes.text(x[:-1].mean(), y[:-1].mean(), f"{zone.name} x {zone.weight:g}", **look)
    return line


# --- Distances from the LiDARs ----------------------------------------------------------------------------------------

_RING = {"color": "#707070", "linestyle": (0, (1.0, 2.0)), "linewidth": 0.8}
_RINGS = 6  # at most, from a LiDAR to the farthest edge of the plan
_CHARACTER_MM, _BESIDE_MM, _ABOVE_MM = 0.7, 3.5, 3.0  # half of a letter; between middles of texts besides
_INSIDE_MM = (3.5, 1.5)  # of the plan's edges, the middle of a label


def _draw_rings(axes: Axes, places: Sequence[tuple[float, float]], window: np.ndarray) -> None:
    """Circles of round distances about each LiDAR, of several labelled on the side away from the others, if free."""
    size, metre = max(float(np.abs(window - xy).max()) for xy in places), mm_per_m(axes)
    step = next((one for one in (5.0, 10.0, 20.0, 50.0) if size / one <= _RINGS), 100.0)
    turn, ways = np.linspace(0.0, 2.0 * math.pi, 361), np.array([(-1.0, 0.0), (1.0, 0.0), (0.0, 1.0), (0.0, -1.0)])
    box = {"facecolor": "white", "edgecolor": "none", "alpha": 0.85, "pad": 0.6}
    look = {"ha": "center", "va": "center", "fontsize": 6.0, "color": INK, "bbox": box, "zorder": 5.5, "clip_on": True}
    low, high = window + np.outer([1.0, -1.0], _INSIDE_MM) / metre
    taken = [(*xy, _BESIDE_MM + 2.0) for xy in places]
    taken += [(*text.get_position(), _BESIDE_MM + _CHARACTER_MM * len(text.get_text())) for text in axes.texts]
    for radius in np.arange(step, 1.5 * size, step):
        for xy in places:
            axes.plot(*(xy + radius * np.stack([np.cos(turn), np.sin(turn)], axis=1)).T, zorder=2.5, **_RING)
            outwards = np.argsort(-ways @ (xy - np.mean(places, axis=0)), kind="stable")
            free = [
                (x, y)
                for x, y in xy + radius * ways[outwards]
                if (low < (x, y)).all()
                and ((x, y) < high).all()
                and not any(abs(x - u) * metre < w and abs(y - v) * metre < _ABOVE_MM for u, v, w in taken)
            ]
            for x, y in free[: 2 if len(places) == 1 else 1]:
                axes.text(x, y, f"{radius:g} m", **look)
                taken.append((x, y, _BESIDE_MM + 4 * _CHARACTER_MM))
