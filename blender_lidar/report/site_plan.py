"""The site plan of a proposed scene: trajectories from above, with lanes, region and pole, to be checked by eye."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from ..names import SIDES
from ..road.straight import StraightRoad, road_map
from ..traffic.layout import HALF_STRETCH_M, RoadLayout
from ..traffic.vehicles import Recording
from .figure import ALONG_LABEL, INK, TRAVEL_LABEL, mark_sensor, sheet

_MOST_POINTS = 60_000
_ROUND_M = 20.0  # shown around the region
_EDGE_LOOK = {"color": INK, "linewidth": 1.2}
_LANE_LOOK = {"color": "#173f70", "linewidth": 0.8, "linestyle": (0, (6, 4))}
_REGION_LOOK = {"facecolor": "#cf7f1b", "alpha": 0.22, "edgecolor": "none", "zorder": 0.5}
_ALONG, _OTHER = "#4b86c2", "#a35c00"  # driven along the carriageway, or any other way
_LONGEST_NAME = 28
_WITHIN_RAD = math.radians(30.0)


def plot_site_plan(recording: Recording, layout: RoadLayout, path: str | Path, axis_names: tuple[str, str]) -> None:
    """Draw all trajectories from above, the proposed road about its pole, and where across it vehicles drive.

    Parameters
    ----------
    recording : Recording
        In the file's own plane [m].
    layout : RoadLayout
        What is proposed.
    path : path
        The PNG to write; an existing file is replaced.
    axis_names : (str, str)
        What the file calls the axes of its plane.

    Errors as `figure.sheet`.
    """
    xy = recording.centre_m[:, :2]
    turned = recording.heading_rad - math.radians(layout.placing.heading_deg)
    both_ways = layout.road.carriageways == 2
    along = np.abs(np.sin(turned)) <= math.sin(_WITHIN_RAD)
    along &= both_ways | (np.cos(turned) > 0.0)
    name = Path(recording.source).name
    name = name if len(name) <= _LONGEST_NAME else f"{name[: _LONGEST_NAME - 1]}\N{HORIZONTAL ELLIPSIS}"
    subtitle = (
        f"{name}: {layout.vehicles + layout.oncoming:,} vehicles on {road_text(layout.road)}; pole "
        f"{layout.road.setback_m:g} m to the {layout.road.drives_on} of it"
    )
    with sheet(path, 190.0, "Proposed site", subtitle) as figure:
        how = {"height_ratios": (1.0, 1.0), "width_ratios": (5.0, 1.0)}
        axes = figure.subplot_mosaic([["all", "all"], ["near", "across"]], **how)
        _draw_all(axes["all"], xy, along, layout, axis_names)
        road = layout.placing.points(xy)
        _draw_near(axes["near"], road, along, layout)
        _draw_across(axes["across"], road, along, layout)
        axes["across"].set_ylim(axes["near"].get_ylim())
        figure.legend(handles=_handles(), loc="outside lower center", ncols=3, handlelength=2.4)


def road_text(road: StraightRoad) -> str:
    """Carriageways, lanes and median of a road, in words."""
    lanes = "1 lane" if road.lanes == 1 else f"{road.lanes} lanes"
    if road.carriageways == 1:
        return f"{lanes} of {road.lane_width_m:g} m"
    return f"2 x {lanes} of {road.lane_width_m:g} m with a median of {road.median_m:g} m"


def _draw_points(axes, xy, along, size):
    thin = slice(None, None, max(1, -(-len(xy) // _MOST_POINTS)))
    xy, along = xy[thin], along[thin]
    for which, colour in ((~along, _OTHER), (along, _ALONG)):
        axes.plot(*xy[which].T, ".", color=colour, markersize=size, markeredgewidth=0.0, alpha=0.6, zorder=1.0)


def _draw_all(axes, xy, along, layout, names):
    """The whole recording in the file's plane, and where the road frame lies in it."""
    _draw_points(axes, xy, along, 1.0)
    turn = math.radians(layout.placing.heading_deg)
    axes_of_road = np.array([[math.cos(turn), math.sin(turn)], [-math.sin(turn), math.cos(turn)]])  # rows: x and y
    first, last = layout.stretch_m
    for right, left in layout.road.carriageways_y:
        outline = np.array([[first, right], [last, right], [last, left], [first, left], [first, right]])
        outline = layout.placing.origin_m + outline @ axes_of_road
        axes.fill(*outline.T, **_REGION_LOOK)
        axes.plot(*outline.T, **_EDGE_LOOK)
    mark_sensor(axes, layout.pole_m)
    size = 0.03 * float(np.ptp(xy, axis=0).max())
    y = layout.pole_y + (size if layout.pole_y else -size)
    _arrow(axes, *(layout.placing.origin_m + np.array([[0.0, y], [4.0 * size, y]]) @ axes_of_road))
    axes.set_aspect("equal", adjustable="datalim")
    axes.set(title="All trajectories, in the file's own frame", xlabel=f"{names[0]} [m]", ylabel=f"{names[1]} [m]")
    axes.grid()


def _arrow(axes, start, end):
    look = {"arrowstyle": "-|>", "color": INK, "linewidth": 1.4, "mutation_scale": 12.0}
    axes.annotate("", end, start, arrowprops=look, zorder=4)


def _draw_near(axes, road, along, layout):
    """The road frame about the pole."""
    low, high = layout.stretch_m[0] - _ROUND_M, layout.stretch_m[1] + _ROUND_M
    bottom, top = _across_m(layout)
    shown = (road[:, 0] > low) & (road[:, 0] < high)
    _draw_points(axes, road[shown], along[shown], 2.2)
    for edges in layout.road.carriageways_y:
        axes.fill_between(layout.stretch_m, *edges, **_REGION_LOOK)
        for y in edges:
            axes.plot((low, high), (y, y), **_EDGE_LOOK)
    for y in road_map(layout.road).offset_m:
        axes.plot((low, high), (y, y), **_LANE_LOOK)
    at = bottom + 4.0, top - 4.0  # beside the carriageway that drives along +x, and the other one
    with_x, against = at if layout.road.drives_on == SIDES[0] else at[::-1]
    reach = 0.3 * HALF_STRETCH_M
    _arrow(axes, (-reach, with_x), (reach, with_x))
    if layout.road.carriageways == 2:
        _arrow(axes, (reach, against), (-reach, against))
    mark_sensor(axes, (0.0, layout.pole_y))
    axes.set(
        xlim=(low, high),
        ylim=(bottom, top),
        xlabel=ALONG_LABEL if layout.road.carriageways > 1 else TRAVEL_LABEL,
        ylabel="Across, y [m], to the left",
    )
    axes.set_title("The proposed road frame (y stretched)")
    axes.grid()


def _across_m(layout):
    """From where to where across the road is shown."""
    return -8.0, layout.road.place(SIDES[1])[0] + 8.0


def _draw_across(axes, road, along, layout):
    """How often vehicles drive where across the road, beside the proposed lanes."""
    bottom, top = _across_m(layout)
    near = along & (road[:, 0] >= layout.stretch_m[0]) & (road[:, 0] <= layout.stretch_m[1])
    counts, edges = np.histogram(road[near, 1], np.arange(bottom, top + 0.25, 0.25))
    axes.barh(edges[:-1], counts, height=0.25, align="edge", color=_ALONG)
    for y in np.ravel(layout.road.carriageways_y):
        axes.axhline(y, **_EDGE_LOOK)
    for y in road_map(layout.road).offset_m:
        axes.axhline(y, **_LANE_LOOK)
    axes.set(xlabel="Boxes", title="Driven where", yticklabels=[])


def _handles():
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    dots = {"linestyle": "none", "marker": "o", "markersize": 3.0}
    return [
        Line2D([], [], color=_ALONG, label="driven along the road", **dots),
        Line2D([], [], color=_OTHER, label="driven any other way", **dots),
        Line2D([], [], label="edges of the road", **_EDGE_LOOK),
        Line2D([], [], label="lane centres", **_LANE_LOOK),
        Patch(label="region; an arrow is a direction of travel", **_REGION_LOOK),
        Line2D([], [], linestyle="none", marker="^", markerfacecolor="white", markeredgecolor="black", label="LiDAR"),
    ]
