"""The site plan of a proposed scene: trajectories from above, with lanes, region and poles, to be checked by eye."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ..road.road_map import RoadMap
from ..road.settings import RoadSettings, map_of
from ..traffic.layout import RoadLayout
from ..traffic.vehicles import Recording, counted
from .figure import INK, WIDTH_MM, header_mm, place, sheet
from .plan import (
    ROOM_MM,
    Stand,
    arrow,
    axis_labels,
    background,
    draw_stands,
    fitted_mm,
    north_arrow,
    north_name,
    plans,
    scale_bar,
    show,
    window_of,
)
from .road_plan import EDGE_LOOK, ENTRY_LOOK, LANE_LINE_LOOK, SEEN_THROUGH_LOOK, STOP_LINE_LOOK, draw_road

_MOST_POINTS = 60_000
_ROUND_M = 15.0  # shown around the region
_CENTRE_LOOK = {"color": "#173f70", "linewidth": 0.8, "linestyle": (0, (6, 4)), "zorder": 2.2}
_REGION_LOOK = {"facecolor": "#cf7f1b", "alpha": 0.22, "edgecolor": "none", "zorder": 0.5}
_KEEP_OUT_LOOK = {"facecolor": "none", "edgecolor": INK, "linewidth": 0.8, "hatch": "xxx", "zorder": 0.6}
_ALONG, _OTHER = "#4b86c2", "#a35c00"  # driven along the carriageway, or any other way
_WAYS = ("#173f70", "#4b9ac2", "#a35c00", "#7a7a7a", "#c46aa0", "#5c8a3a", "#c0261c", "#30c0a0")
_LONGEST_NAME = 28
_WITHIN_RAD = math.radians(30.0)


def plot_site_plan(recording: Recording, layout: RoadLayout, path: str | Path, axis_names: tuple[str, str]) -> None:
    """Draw all trajectories from above, the proposed road about its pole, and where across it vehicles drive; to scale.

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
    turned = recording.heading_rad - math.radians(layout.heading_deg)
    both_ways = layout.road.carriageways == 2
    along = np.abs(np.sin(turned)) <= math.sin(_WITHIN_RAD)
    along &= both_ways | (np.cos(turned) > 0.0)
    colours = np.where(along, _ALONG, _OTHER)
    road = layout.T_file_site.inverse.points(xy)
    title = "Proposed site"
    subtitle = (
        f"{_name_of(recording)}: {layout.vehicles + layout.oncoming:,} vehicles on {road_text(layout.road)}; pole "
        f"{layout.road.setback_m:g} m to the {layout.road.drives_on} of it"
    )
    whole, near = _whole_window(xy), _near_window(layout)
    near_mm = fitted_mm(near, ROOM_MM - _ACROSS_MM - _GAP_MM, 90.0)
    whole_mm = fitted_mm(whole, ROOM_MM, _WHOLE_MM)
    top = header_mm(title, subtitle) + _TITLE_MM
    below = top + whole_mm[1] + _LABELS_MM + _TITLE_MM
    left_mm = WIDTH_MM - ROOM_MM - 5.0
    with sheet(path, below + near_mm[1] + _LABELS_MM + _KEY_MM, title, subtitle, to_scale=True) as figure:
        axes = place(figure, left_mm, top, *whole_mm)
        show(axes, whole)
        axes.set(title="All trajectories, in the file's own frame")
        axes.set(xlabel=f"{axis_names[0]} [m]", ylabel=f"{axis_names[1]} [m]")
        _draw_all(axes, xy, colours, layout)
        scale_bar(axes)
        axes = place(figure, left_mm, below, *near_mm)
        show(axes, near)
        _draw_near(axes, road, colours, layout, near)
        scale_bar(axes)
        across = place(figure, left_mm + near_mm[0] + _GAP_MM, below, _ACROSS_MM, near_mm[1])
        _draw_across(across, road[along], layout, axes.get_ylim())
        figure.legend(handles=_handles(), loc="outside lower center", ncols=3, handlelength=2.4)


_WHOLE_MM, _ACROSS_MM, _GAP_MM = 90.0, 24.0, 3.0  # height of the whole plan; width of the panel beside the near one
_TITLE_MM, _LABELS_MM, _KEY_MM = 6.0, 12.0, 13.0
_THINNEST = 0.12  # height over width of the whole plan at least


def road_text(road: RoadSettings) -> str:
    """Carriageways, lanes and median of a road, in words."""
    lanes = "1 lane" if road.lanes == 1 else f"{road.lanes} lanes"
    if road.carriageways == 1:
        return f"{lanes} of {road.lane_width_m:g} m"
    return f"2 x {lanes} of {road.lane_width_m:g} m with a median of {road.median_m:g} m"


def _name_of(recording: Recording) -> str:
    name = Path(recording.source).name
    return name if len(name) <= _LONGEST_NAME else f"{name[: _LONGEST_NAME - 1]}\N{HORIZONTAL ELLIPSIS}"


def _whole_window(xy: np.ndarray) -> np.ndarray:
    """All trajectories with a margin, (2, 2) [m]; a thin site has room for marks beside it."""
    window = window_of([xy], 0.03 * float(np.ptp(xy, axis=0).max()))
    missing = (_THINNEST * np.ptp(window, axis=0)[::-1] - np.ptp(window, axis=0)).clip(0.0)
    return window + np.array([[-0.5], [0.5]]) * missing


def _near_window(layout: RoadLayout) -> np.ndarray:
    """The road frame about the pole, (2, 2) [m]."""
    edges = layout.road.carriageways_y
    low, high = edges[0][0] - 8.0, edges[-1][1] + 8.0
    ends = layout.stretch_m[0] - _ROUND_M, layout.stretch_m[1] + _ROUND_M
    return np.array([[ends[0], min(low, layout.pole_y - 3.0)], [ends[1], max(high, layout.pole_y + 3.0)]])


def _draw_points(axes, xy, colours, size):
    thin = slice(None, None, max(1, -(-len(xy) // _MOST_POINTS)))
    xy, colours = xy[thin], colours[thin]
    for colour in sorted(set(colours.tolist()), reverse=True):
        which = colours == colour
        axes.plot(*xy[which].T, ".", color=colour, markersize=size, markeredgewidth=0.0, alpha=0.6, zorder=1.0)


def _draw_all(axes, xy, colours, layout):
    """The whole recording in the file's plane, and where the road frame lies in it."""
    _draw_points(axes, xy, colours, 1.0)
    turn = math.radians(layout.heading_deg)
    axes_of_road = np.array([[math.cos(turn), math.sin(turn)], [-math.sin(turn), math.cos(turn)]])  # rows: x and y
    first, last = layout.stretch_m
    for right, left in layout.road.carriageways_y:
        outline = np.array([[first, right], [last, right], [last, left], [first, left], [first, right]])
        outline = layout.origin_m + outline @ axes_of_road
        axes.fill(*outline.T, **_REGION_LOOK)
        axes.plot(*outline.T, color=INK, linewidth=1.0)
    draw_stands(axes, [Stand("", layout.pole_m)])
    size = 0.02 * float(np.ptp(axes.get_xlim()))
    y = layout.pole_y + (size if layout.pole_y else -size)
    arrow(axes, *(layout.origin_m + np.array([[0.0, y], [4.0 * size, y]]) @ axes_of_road))
    axes.grid()


def _draw_near(axes, road, colours, layout, window):
    """The road frame about the pole."""
    shown = ((road > window[0]) & (road < window[1])).all(axis=1)
    proposed = map_of(layout.road)
    draw_road(axes, proposed, window)
    _draw_points(axes, road[shown], colours[shown], 1.6)
    for edges in layout.road.carriageways_y:
        axes.fill_between(layout.stretch_m, *edges, **_REGION_LOOK)
    for y in proposed.offset_m:
        axes.plot(window[:, 0], (y, y), **_CENTRE_LOOK)
    side = layout.road.place(layout.road.drives_on)[1]
    draw_stands(axes, [Stand("", (0.0, layout.pole_y), side)])
    along, across = axis_labels(proposed)
    axes.set(xlabel=along, ylabel=across.replace("Across the road", "Across"), title="The proposed road frame")


def _draw_across(axes, road, layout, limits):
    """How often vehicles drive where across the road, beside the proposed lanes."""
    near = road[(road[:, 0] >= layout.stretch_m[0]) & (road[:, 0] <= layout.stretch_m[1]), 1]
    counts, edges = np.histogram(near, np.arange(limits[0], limits[1] + 0.25, 0.25))
    axes.barh(edges[:-1], counts, height=0.25, align="edge", color=_ALONG)
    for y in np.ravel(layout.road.carriageways_y):
        axes.axhline(y, color=INK, linewidth=1.0)
    for y in map_of(layout.road).offset_m:
        axes.axhline(y, **_CENTRE_LOOK)
    axes.xaxis.get_major_locator().set_params(integer=True, nbins=3)
    axes.set(xlabel="Boxes", title="Driven where", yticklabels=[], ylim=limits)


def _handles():
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    dots = {"linestyle": "none", "marker": "o", "markersize": 3.0}
    return [
        Line2D([], [], color=_ALONG, label="driven along the road", **dots),
        Line2D([], [], color=_OTHER, label="driven any other way", **dots),
        Line2D([], [], label="edges of the road", **EDGE_LOOK),
        Line2D([], [], label="lane centres", **_CENTRE_LOOK),
        Patch(label="region; an arrow is a direction of travel", **_REGION_LOOK),
        _lidar("LiDAR"),
    ]


def _lidar(label):
    from matplotlib.lines import Line2D

    return Line2D([], [], linestyle="none", marker="^", markerfacecolor="white", markeredgecolor="black", label=label)


# --- A site with a map ------------------------------------------------------------------------------------------------


def plot_mapped_plan(
    path: str | Path,
    road: RoadMap,
    outlines: Sequence[np.ndarray],
    poles: Sequence[Stand],
    recording: Recording,
    *,
    keep_out: Sequence[Sequence[Sequence[float]]] = (),
    ways: np.ndarray | None = None,
    bearing_deg: float = 0.0,
    image: tuple[str | Path, Sequence[Sequence[float]]] | None = None,
) -> None:
    """Draw the plan of a site with a map to scale: lanes, stop lines, region, poles, and what was driven behind them.

    Parameters
    ----------
    path : path
        The PNG to write; an existing file is replaced.
    road : RoadMap
    outlines, keep_out : sequence of polygons, (k, 2) each
        The region, and what is kept out of it [m].
    poles : sequence of Stand
        Where LiDARs hang or may hang.
    recording : Recording
        In the site frame; n boxes.
    ways : ndarray of str, (n,), optional
        What each box is coloured by, such as its movement; "" for none. Unless given, the direction of travel.
    bearing_deg : float
        Of the site frame's +y, as `plan.north_arrow` takes it.
    image : (path, points), optional
        A picture of the site, as `plan.background` takes it.

    Errors as `figure.sheet` and `plan.background`.
    """
    window = window_of([*outlines, *([stand.xy] for stand in poles)], _ROUND_M)
    width, height = np.ptp(window, axis=0)  # a site that is high shows more beside it
    window += np.array([[-0.5], [0.5]]) * (max(height / _STEEPEST - width, 0.0), 0.0)
    xy = recording.centre_m[:, :2]
    ways = _quarters(recording.heading_rad, north_name(road) == "N") if ways is None else ways
    shown = ((xy > window[0]) & (xy < window[1])).all(axis=1)
    names, boxes = np.unique(ways[shown], return_counts=True)
    names = names[np.argsort(-boxes, kind="stable")]
    known = [name for name in names.tolist() if name][: len(_WAYS)]
    colour_of = dict(zip(known, _WAYS, strict=False))
    colours = np.array([colour_of.get(name, "#b0b0b0") for name in ways[shown].tolist()])
    vehicles = counted(len(np.unique(recording.vehicle_id[shown])), "vehicle")
    subtitle = f"{_name_of(recording)}: {vehicles} in this window, {counted(len(poles), 'pole')}"
    key_mm = 18.0 + 4.0 * math.ceil(len(known) / 3)
    with plans(path, window, [""], key_mm, "The site to scale", subtitle, road=road) as (figure, panels, _):
        from matplotlib.lines import Line2D
        from matplotlib.patches import Patch

        (axes,) = panels
        if image is not None:
            background(axes, *image)
        drawn = draw_road(axes, road, window, **({"fill": SEEN_THROUGH_LOOK} if image is not None else {}))
        for outline in outlines:
            axes.fill(*np.asarray(outline).T, **_REGION_LOOK)
        for outline in keep_out:
            axes.fill(*np.asarray(outline, dtype=float).T, **_KEEP_OUT_LOOK)
        _draw_drives(axes, recording.vehicle_id[shown], xy[shown], colours)
        scale_bar(axes)
        north_arrow(axes, bearing_deg, north_name(road))
        dots = {"linestyle": "none", "marker": "o", "markersize": 3.0}
        handles = [Line2D([], [], color=colour_of[name], label=name, **dots) for name in known]
        handles.append(Patch(label="region", **_REGION_LOOK))
        handles += [Patch(label="kept out", **_KEEP_OUT_LOOK)] * bool(keep_out)
        lines = {"stop line": ("stop line", STOP_LINE_LOOK), "entry": ("entry without signals", ENTRY_LOOK)}
        lines["lane"] = "line between lanes", LANE_LINE_LOOK
        handles += [Line2D([], [], label=label, **look) for kind, (label, look) in lines.items() if kind in drawn]
        if poles:
            draw_stands(axes, poles)
            handles.append(_lidar("pole, and which way it faces"))
        figure.legend(handles=handles, loc="outside lower center", ncols=3, handlelength=2.4)


_STEEPEST = 1.2  # height over width
_LONGEST_STEP_M = 30.0  # between boxes of a vehicle; farther ones are not one drive


def _draw_drives(axes, vehicle_id, xy, colours):
    """A thin line from each box to the next of its vehicle."""
    from matplotlib.collections import LineCollection

    order = np.argsort(vehicle_id, kind="stable")  # recordings are in the order of time
    xy, colours, vehicle = xy[order], colours[order], vehicle_id[order]
    step = (vehicle[1:] == vehicle[:-1]) & (np.hypot(*np.diff(xy, axis=0).T) <= _LONGEST_STEP_M)
    lines = np.stack([xy[:-1], xy[1:]], axis=1)[step]
    look = {"linewidth": 0.4, "alpha": 0.6, "zorder": 1.0}
    axes.add_collection(LineCollection(lines, colors=colours[1:][step], **look), autolim=False)


def _quarters(heading_rad: np.ndarray, named: bool) -> np.ndarray:
    """The quarter of the circle towards which each box heads, (n,)."""
    names = ("east", "north", "west", "south") if named else ("+x", "+y", "-x", "-y")
    return np.array([f"towards {name}" for name in names])[np.round(heading_rad / (0.5 * math.pi)).astype(int) % 4]
