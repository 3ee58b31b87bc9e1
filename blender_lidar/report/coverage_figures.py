"""Coverage on a plan of the site: where vehicles stay below the threshold, and how far each mounting reaches."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ..run.folder import RunFolder
from ..run.words import each_lidar, run_text, sides
from ..scene.settings import ZoneSettings
from .figure import (
    BLIND_COLOURS,
    FAINT,
    INK,
    OPTIMISED_LOOK,
    SMALL_PT,
    WIDTH_MM,
    colours,
    legend_below,
    place,
)
from .plan import Stand, background, draw_stands, north_arrow, north_name, plans, scale_bar, window_of
from .road_plan import ASPHALT_LOOK, EMPTY_LOOK, SEEN_THROUGH_LOOK, draw_road

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.collections import PolyCollection

    from ..road.road_map import RoadMap

_MARGIN_M = 2.0  # around what is shown

# --- Blind zones: cells of the site frame and the boxes whose footprints overlap them ---------------------------------

_CELL_M, _FINE_CELL_M, _SMALL_SITE_M = 2.0, 1.0, 60.0
FEW_BOXES = 5  # in a cell, whose share then says little
_SMALL = 0.5  # side of the square that stands for such a cell
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


def plot_blind_zones(
    path: str | Path, run: RunFolder, road: RoadMap, zones: Sequence[ZoneSettings] = (), image: Image | None = None
) -> None:
    """Draw the share of boxes below the detectability threshold in cells of 1 or 2 m, before and after, to scale.

    A cell's boxes are those whose footprints overlap it; `zones` of weights are outlined.
    """
    from matplotlib.lines import Line2D
    from matplotlib.patches import Rectangle

    tables = run.judged
    stands = _stands(run)
    window = window_of([footprints(tables[0]), *([one.xy for one in side] for side in stands)], _MARGIN_M)
    side_m = _CELL_M if np.ptp(window, axis=0).max() >= _SMALL_SITE_M else _FINE_CELL_M
    found = [
        f"{100.0 * (~table['detectable'].astype(bool)).mean():.1f} % of {len(table['x_m']):,} boxes below the threshold"
        for table in tables
    ]
    subtitle = f"{run_text(run.result, held_out=True)}; cells of {side_m:g} m"
    key_mm = 30.0 if zones else 26.0
    heading = "Where vehicles stay below the threshold", subtitle
    with plans(path, window, _headings(run, found), key_mm, *heading, road=road) as (figure, panels, end):
        for axes, table, side in zip(panels, tables, stands, strict=True):
            _draw_ground(axes, road, window, EMPTY_LOOK, image)
            shades = _draw_cells(axes, cells_of(table, side_m))
            marker = draw_stands(axes, side)
            outlines = [_outline_zone(axes, zone) for zone in zones]
        _below_plans(panels, run, road)
        bar = place(figure, 0.5 * (WIDTH_MM - 84.0), end + 2.0, 84.0, 2.5)
        figure.colorbar(shades, cax=bar, orientation="horizontal", label="Boxes below the threshold [%]")
        few = {"marker": "s", "markersize": 3.5, "color": "#cc4c02", "linestyle": "none"}
        few = Line2D([], [], label=f"cell of fewer than {FEW_BOXES} boxes", **few)
        empty = Rectangle((0.0, 0.0), 1.0, 1.0, label="no vehicle was there", **EMPTY_LOOK)
        legend_below(figure, [marker, few, empty, *outlines[:1]], columns=4)


def _draw_ground(axes: Axes, road: RoadMap, window: np.ndarray, fill: dict, image: Image | None) -> None:
    """The road, seen through where there is a picture of the site below it."""
    if image is not None:
        background(axes, *image)
        fill = SEEN_THROUGH_LOOK
    draw_road(axes, road, window, fill, arrows=not road.endless)


def _headings(run: RunFolder, found: Sequence[str]) -> list[str]:
    """Over each panel the mounting and what was found."""
    return [f"{name}: {text}\n{one}" for (name, text, _), one in zip(sides(run.result), found, strict=True)]


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


def _draw_cells(axes: Axes, cells: Cells) -> PolyCollection:
    """Squares shaded by per cent, smaller ones where there are few boxes; none where there is no box."""
    from matplotlib.collections import PolyCollection

    held = cells.boxes > 0
    boxes = cells.boxes[held]
    look = {"cmap": colours(BLIND_COLOURS), "zorder": 1.0, "antialiased": False}
    edges = {"edgecolor": FAINT, "linewidth": np.where(boxes < FEW_BOXES, 0.3, 0.0)}
    shades = PolyCollection(_squares(cells, _SMALL), **look, **edges)
    shades.set_array(100.0 * cells.below[held] / boxes)
    shades.set_clim(0.0, 100.0)
    axes.add_collection(shades, autolim=False)
    return shades


def _squares(cells: Cells, few: float = 1.0) -> np.ndarray:
    """Corners of the cells that hold boxes, (k, 4, 2) [m]; those of few boxes are smaller by a factor."""
    row, column = np.nonzero(cells.boxes)
    middle = cells.corner_m + cells.side_m * (np.stack([column, row], axis=1) + 0.5)
    half = 0.5 * cells.side_m * np.where(cells.boxes[row, column] < FEW_BOXES, few, 1.0)
    square = np.array([(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)])
    return middle[:, None] + half[:, None, None] * square


def _outline_zone(axes, zone):
    """The outline of a zone with its name and weight in it."""
    x, y = np.array([*zone.polygon_m, zone.polygon_m[0]]).T
    (line,) = axes.plot(x, y, color=INK, linewidth=1.2, linestyle=(0, (4, 2)), label="zone x weight", zorder=3)
    box = {"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 1.0}
    look = {"ha": "center", "va": "center", "fontsize": SMALL_PT, "bbox": box, "clip_on": True}
    axes.text(x[:-1].mean(), y[:-1].mean(), f"{zone.name} x {zone.weight:g}", **look)
    return line


# --- Reach: by bearing from the LiDAR, how far most boxes are detectable ----------------------------------------------

SECTORS = 24
LEAST_SHARE = 0.5  # of the boxes at a distance, to be within reach
FEW_IN_SECTOR = 20
_BAND_M = 5.0
_WITHIN = {"facecolor": "#bcd2ea", "edgecolor": OPTIMISED_LOOK["color"], "linewidth": 0.0, "alpha": 0.75}
_UNSEEN = {"facecolor": "white", "edgecolor": "#a35c00", "linewidth": 0.0, "hatch": "xxxx", "alpha": 0.9}
_OUTLINE = {"color": OPTIMISED_LOOK["color"], "linewidth": 1.6, "zorder": 2.6, "solid_capstyle": "butt"}


class Reach(NamedTuple):
    """Between what distances at least half of the boxes of a sector are detectable.

    Attributes
    ----------
    sector : int
        It begins at so many sectors counter-clockwise from +x.
    near_m, far_m : float
        From the LiDAR; both 0 where fewer than half are detectable at every distance.
    beyond : bool
        Whether it goes on where the boxes end, at `far_m`.
    last_m : float
        Distance of the sector's last box.
    """

    sector: int
    near_m: float
    far_m: float
    beyond: bool
    last_m: float


def unimodal(share: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Isotonic regression on both sides of the peak: shares (n,) that rise to the largest one and then fall."""
    peak = int(np.argmax(share))
    return np.concatenate([_rising(share[:peak], weight[:peak]), -_rising(-share[peak:], weight[peak:])])


def _rising(share: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Isotonic regression by pool adjacent violators."""
    pools: list[tuple[float, float, int]] = []  # mean, weight, number
    for mean, of in zip(share.tolist(), weight.tolist(), strict=True):
        number = 1
        while pools and pools[-1][0] >= mean:
            before, heavy, many = pools.pop()
            mean, of, number = (before * heavy + mean * of) / (heavy + of), heavy + of, number + many
        pools.append((mean, of, number))
    return np.repeat([pool[0] for pool in pools], [pool[2] for pool in pools])


def reaches(table: Mapping[str, np.ndarray], xy: tuple[float, float]) -> list[Reach]:
    """Reach from a place by sectors of bearing, of those sectors alone that hold boxes enough.

    The detectable share in bands of 5 m is made to rise to its peak and to fall beyond it (`unimodal`); reach is the
    stretch around the peak where it is `LEAST_SHARE` or more.
    """
    off = np.stack([table["x_m"] - xy[0], table["y_m"] - xy[1]])
    distance, detectable = np.hypot(*off), np.asarray(table["detectable"], dtype=float)
    sector = np.floor(np.arctan2(off[1], off[0]) / (2.0 * math.pi) * SECTORS).astype(int) % SECTORS
    found = []
    for number in np.unique(sector):
        rows = sector == number
        if np.count_nonzero(rows) < FEW_IN_SECTOR:
            continue
        band = (distance[rows] // _BAND_M).astype(int)
        bands, index, boxes = np.unique(band, return_inverse=True, return_counts=True)
        share = unimodal(np.bincount(index, detectable[rows]) / boxes, boxes)
        within, last = np.flatnonzero(share >= LEAST_SHARE), float(distance[rows].max())
        if not len(within):
            found.append(Reach(int(number), 0.0, 0.0, False, last))
            continue
        beyond = bool(within[-1] == len(bands) - 1)
        near = max(float(_BAND_M * bands[within[0]]), float(distance[rows].min()) if within[0] == 0 else 0.0)
        far = last if beyond else float(_BAND_M * (bands[within[-1]] + 1))
        found.append(Reach(int(number), near, far, beyond, last))
    return found


def plot_reach(path: str | Path, run: RunFolder, road: RoadMap, image: Image | None = None) -> None:
    """Draw how far from each mounting, by sectors of bearing, at least half of the boxes are detectable, to scale."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    tables, stands = run.judged, _stands(run)
    window = window_of([footprints(tables[0]), *([one.xy for one in side] for side in stands)], _MARGIN_M)
    found = [
        [(own, xy, reaches(own, xy)) for own, xy in _by_nearest(table, side)]
        for table, side in zip(tables, stands, strict=True)
    ]
    sectors = [[one for *_, reached in parts for one in reached] for parts in found]
    title = "How far each mounting reaches"
    with plans(
        path,
        window,
        _headings(run, [*map(_reach_text, sectors)]),
        15.0,
        title,
        run_text(run.result, held_out=True),
        road=road,
    ) as (figure, panels, _):
        for axes, side, parts in zip(panels, stands, found, strict=True):
            _draw_ground(axes, road, window, ASPHALT_LOOK, image)
            for own, xy, reached in parts:
                driven = cells_of(own, _CELL_M)
                for one in reached:
                    _draw_sector(axes, one, xy, driven)
            if len(side) == 1:
                _draw_rings(axes, side[0].xy, window)
            marker = draw_stands(axes, side)
        _below_plans(panels, run, road)
        entries = [
            Patch(label=f"{100.0 * LEAST_SHARE:g} % of the boxes or more are detectable", **_WITHIN),
            Line2D([], [], label="reach ends", **_OUTLINE),
            Line2D([], [], label="farthest box: reach goes on", **{**_OUTLINE, "linestyle": (0, (1, 1))}),
            *[Patch(label="fewer at every distance", **_UNSEEN)] * (not all(one.far_m for one in chain(*sectors))),
            *[Line2D([], [], color=FAINT, linestyle=":", label="distance from the LiDAR")] * (len(side) == 1),
            marker,
        ]
        legend_below(figure, entries, columns=3)


def _by_nearest(
    table: Mapping[str, np.ndarray], stands: Sequence[Stand]
) -> Iterator[tuple[Mapping[str, np.ndarray], tuple[float, float]]]:
    """The boxes of a vehicle table to which each LiDAR is the nearest, and its place; none without boxes."""
    away = [np.hypot(table["x_m"] - stand.xy[0], table["y_m"] - stand.xy[1]) for stand in stands]
    nearest = np.argmin(away, axis=0)
    for number in np.unique(nearest):
        yield {key: values[nearest == number] for key, values in table.items()}, stands[number].xy


def _reach_text(found: Sequence[Reach]) -> str:
    """What sectors came to, in a line."""
    if not found:
        return f"no sector of {360 // SECTORS}° has {FEW_IN_SECTOR} boxes"
    least, most = min(one.far_m for one in found), max(one.far_m for one in found)
    beyond, text = sum(one.beyond for one in found), f"reach {least:.0f} to {most:.0f} m"
    return f"{text}; in {beyond} of {len(found)} sectors of {360 // SECTORS}° it goes on where the boxes end"


def _draw_sector(axes: Axes, one: Reach, xy: tuple[float, float], driven: Cells) -> None:
    """The part of a sector within reach, and the line where it ends, dashed where only the boxes do.

    It is cut off where no box was.
    """
    from matplotlib.path import Path as Outline

    turn = 2.0 * math.pi / SECTORS * (one.sector + np.linspace(0.0, 1.0, 16))
    arc = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    far, look = (one.far_m, _WITHIN) if one.far_m else (one.last_m, _UNSEEN)
    area = np.concatenate([one.near_m * arc, far * arc[::-1]]) + xy
    artists = axes.fill(*area.T, zorder=1.0, **look)
    if one.far_m:
        line = (one.far_m * arc + xy).T
        artists += axes.plot(*line, **{**_OUTLINE, "linestyle": (0, (1, 1)) if one.beyond else "-"})
    squares = Outline.make_compound_path(
        *(Outline(square, closed=True) for square in np.pad(_squares(driven), ((0, 0), (0, 1), (0, 0))))
    )
    for artist in artists:
        artist.set_clip_path(squares, axes.transData)


def _draw_rings(axes: Axes, xy: tuple[float, float], window: np.ndarray) -> None:
    """Circles of round distances, each with its distance where it has room along x."""
    size = float(np.abs(window - xy).max())
    step = next((one for one in (5.0, 10.0, 20.0, 50.0) if size / one <= 6.0), 100.0)
    turn = np.linspace(0.0, 2.0 * math.pi, 361)
    for radius in np.arange(step, 1.5 * size, step):
        axes.plot(
            xy[0] + radius * np.cos(turn),
            xy[1] + radius * np.sin(turn),
            ":",
            color="#808080",
            linewidth=0.8,
            zorder=2.5,
        )
        box = {"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 0.6}
        for x in (xy[0] - radius, xy[0] + radius):
            if window[0, 0] + 3.0 < x < window[1, 0] - 3.0:
                axes.text(
                    x,
                    xy[1],
                    f"{radius:g} m",
                    ha="center",
                    va="center",
                    fontsize=6.0,
                    bbox=box,
                    zorder=5.5,
                    clip_on=True,
                )
