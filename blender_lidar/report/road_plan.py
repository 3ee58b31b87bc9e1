"""The road on a plan: areas, edges, lane lines, stop lines and directions, of a straight road and of a map alike."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from ..road.road_map import Lane, RoadMap
from ..scene.region import polygon_holds
from .figure import INK
from .plan import arrow

if TYPE_CHECKING:
    from matplotlib.axes import Axes

ASPHALT_LOOK = {"facecolor": "#ededed", "edgecolor": "#ededed", "linewidth": 0.3}
SEEN_THROUGH_LOOK = {"facecolor": "none", "edgecolor": "none"}
_OTHERS = {
    "bicycles": {"facecolor": "#f8f8f8", "edgecolor": "#c4c4c4", "hatch": "......", "linewidth": 0.0},
    "pedestrians": {"facecolor": "white", "edgecolor": "#c4c4c4", "hatch": "------", "linewidth": 0.0},
}
EDGE_LOOK = {"color": INK, "linewidth": 1.0}
LANE_LINE_LOOK = {"color": INK, "linewidth": 0.5, "linestyle": (0, (6, 4))}
STOP_LINE_LOOK = {"color": INK, "linewidth": 2.0}
ENTRY_LOOK = {"color": INK, "linewidth": 1.2, "linestyle": (0, (1.2, 0.8))}
_LINES = {
    "edge": EDGE_LOOK,
    "centre": {**EDGE_LOOK, "linewidth": 0.7},
    "lane": LANE_LINE_LOOK,
    "stop line": STOP_LINE_LOOK,
    "entry": ENTRY_LOOK,
}
_STEP_M = 1.0  # along an edge, which may be an edge in part
_BESIDE_M = 0.25  # wider than the gaps between the lanes of a map
_ARROW_M, _BEFORE_END_M = 5.0, 9.0


def draw_road(
    axes: Axes, road: RoadMap, window: np.ndarray, fill: dict = ASPHALT_LOOK, *, arrows: bool = True, over: float = 2.4
) -> set[str]:
    """Draw the road within a window: its areas below all else; edges, lane lines, stop lines and directions over cells.

    Parameters
    ----------
    axes : Axes
    road : RoadMap
        Without lanes its area alone is drawn.
    window : ndarray, (2, 2)
        Lower left and upper right corner [m].
    fill : dict
        How areas where vehicles drive look.
    arrows : bool
        Whether arrows show where lanes lead.
    over : float
        The zorder of lines.

    Returns
    -------
    set of str
        The kinds of lines that are there, as in `road_lines`.
    """
    from matplotlib.collections import LineCollection, PolyCollection

    outlines = _outlines(road, window)
    uses = [road.lanes[row].use if road.lanes and row >= 0 else "vehicles" for row, _ in outlines]
    for use, look in {"vehicles": fill, **_OTHERS}.items():
        areas = [outline for (_, outline), of in zip(outlines, uses, strict=True) if of == use]
        if areas:
            axes.add_collection(PolyCollection(areas, zorder=0.3 + 0.01 * (use != "vehicles"), **look), autolim=False)
    if not len(road):
        return set()
    drawn = {kind: lines for kind, lines in road_lines(road, outlines).items() if lines}
    for kind, lines in drawn.items():
        lines = LineCollection(lines, zorder=over, label=kind, **_LINES[kind])
        axes.add_collection(lines, autolim=False)
    if arrows:
        for row, _ in outlines:
            if row >= 0 and (not road.lanes or (not road.lanes[row].junction and road.lanes[row].use != "pedestrians")):
                _direction_arrow(axes, road, row, window)
    return set(drawn)


def _outlines(road: RoadMap, window: np.ndarray) -> list[tuple[int, np.ndarray]]:
    """Areas that meet a window, each with the row of its lane, or -1 for a junction's or a driven area's."""
    if not len(road):
        found = [(-1, outline) for outline in road.area()]
    else:
        corners = np.stack(np.meshgrid(*window.T), axis=-1).reshape(-1, 2)
        s_m = None
        if road.endless:
            s = road.locate(corners).s_m
            s_m = float(s.min()) - 1.0, float(s.max()) + 1.0
        found = [(row, outline) for row in range(len(road)) for outline in road.area([row], s_m)]
        found += [(-1, np.asarray(junction.outline_m)) for junction in road.junctions]
    return [
        (row, one)
        for row, one in found
        if (one.max(axis=0) >= window[0]).all() and (one.min(axis=0) <= window[1]).all()
    ]


def road_lines(road: RoadMap, outlines: Sequence[tuple[int, np.ndarray]]) -> dict[str, list[np.ndarray]]:
    """Lines (k, 2) [m] by kind: edges of the road, lines between directions and between lanes, stop lines, entries.

    A stop line lies across the end of a lane that leads into a junction; of one that is known to have no signals, and
    where roads meet, it is an entry. `outlines` are the areas, each with the row of its lane, -1 for a junction's.
    """
    found = {kind: [] for kind in _LINES}
    for number, (row, outline) in enumerate(outlines):
        middle = len(outline) // 2
        right, left = outline[:middle], outline[middle:][::-1]
        sides = [(right, -1.0), (left, 1.0)] if row >= 0 else [(np.vstack([outline, outline[:1]]), -_turn(outline))]
        for line, side in sides:
            line = _resampled(line)
            step = np.diff(line, axis=0)
            away = side * np.stack([-step[:, 1], step[:, 0]], axis=1) / np.hypot(*step.T)[:, None]
            beside = 0.5 * (line[:-1] + line[1:]) + _BESIDE_M * away
            kind = np.full(len(step), "edge", dtype=object)
            for other, (of, area) in enumerate(outlines):
                if other != number:
                    kind[polygon_holds(area, beside)] = _between(road, row, of, side)
            for name in set(kind.tolist()) & found.keys():
                runs = np.flatnonzero(np.diff(np.concatenate([[False], kind == name, [False]]).astype(int)))
                found[name] += [line[first : last + 1] for first, last in runs.reshape(-1, 2)]
        if row >= 0 and (entry := _entry(road, row)):
            found[entry].append(outline[middle - 1 : middle + 1])
    return found


def _between(road: RoadMap, row: int, other: int, side: float) -> str:
    """The kind of line on a side of a lane beside which another lies, each by its row; "" for none."""
    if row < 0 or other < 0:
        return ""
    if not road.lanes:
        same_way = road.against[row] == road.against[other]
    else:
        one, two = road.lanes[row], road.lanes[other]
        if one.junction or two.junction:
            return ""
        if "pedestrians" in (one.use, two.use):
            return "edge"
        same_way = one.road == two.road
    if not same_way:
        return "centre"
    return "lane" if side > 0.0 else ""  # one of both lanes draws it


def _entry(road: RoadMap, row: int) -> str:
    """What lies across the end of a lane: a stop line, the entry to a junction without signals, or nothing."""
    if not road.lanes or road.lanes[row].junction or road.lanes[row].use == "pedestrians":
        return ""
    into = {road.lanes[to].junction for to in road.lanes[row].leads_to} - {""}
    if not into:
        return ""
    if not into <= {junction.name for junction in road.junctions if junction.signalised is False}:
        return "stop line"
    from_roads = {one.road for one in road.lanes if not one.junction and _leads_into(road, one, into)}
    return "entry" if len(from_roads) > 1 else ""  # else a road only widens or splits there


def _leads_into(road: RoadMap, lane: Lane, junctions: set[str]) -> bool:
    return any(road.lanes[to].junction in junctions for to in lane.leads_to)


def _turn(outline: np.ndarray) -> float:
    """1 for corners that are counter-clockwise, else -1."""
    x, y = outline.T
    return math.copysign(1.0, (x * np.roll(y, -1) - np.roll(x, -1) * y).sum())


def _resampled(line: np.ndarray) -> np.ndarray:
    """The same line (k, 2) with steps of `_STEP_M` at most and none of no length."""
    line = line[np.concatenate([[True], (np.diff(line, axis=0) != 0.0).any(axis=1)])]
    parts = np.ceil(np.hypot(*np.diff(line, axis=0).T) / _STEP_M).astype(int)
    index = np.concatenate([np.arange(parts.sum()), [parts.sum()]])
    at = np.interp(index, np.concatenate([[0], np.cumsum(parts)]), np.arange(len(line)))
    return np.stack([np.interp(at, np.arange(len(line)), axis) for axis in line.T], axis=1)


def _direction_arrow(axes: Axes, road: RoadMap, row: int, window: np.ndarray) -> None:
    """An arrow on a lane, before its end or before where it leaves the window."""
    line = road.points_m[row]
    if road.endless:
        s = road.locate(np.stack(np.meshgrid(*window.T), axis=-1).reshape(-1, 2)).s_m
        line = road.at(np.array([s.min(), s.max()]), road.offset_m[row], row)
    line = _resampled(line[::-1] if road.against[row] else line)
    inside = np.flatnonzero(((line > window[0]) & (line < window[1])).all(axis=1))
    if len(inside) < 2:
        return
    line = line[inside[0] : inside[-1] + 1]
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(line, axis=0).T))])
    if along[-1] < _BEFORE_END_M + _ARROW_M:
        return
    ends = along[-1] - _BEFORE_END_M + np.array([-0.5, 0.5]) * _ARROW_M
    start, end = np.stack([np.interp(ends, along, axis) for axis in line.T], axis=1)
    arrow(axes, start, end, linewidth=0.8, mutation_scale=6.0, color="#606060", zorder=2.3)
