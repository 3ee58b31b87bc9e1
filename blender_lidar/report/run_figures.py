"""The charts of a run: convergence, score map, detectable share by distance, blind zones; clouds and cells apart."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..metrics.catalogue import PE_VGOP, metric_named
from ..run.folder import RunFolder
from ..run.vehicle_table import METRIC_VALUE, WEIGHT
from ..run.verdict import REGION_SHARE, ScoreMap, near_best_threshold
from ..scene.settings import ZoneSettings
from ..scene.site import Site
from ..statistics import FEW_VEHICLES
from ..traffic.vehicles import counted
from .cautions import known_lanes
from .cloud_figures import draw_clouds, draw_occupancy
from .figure import (
    ALONG_LABEL,
    BASELINE_LOOK,
    BLIND_COLOURS,
    FAINT,
    INK,
    OPTIMISED_LOOK,
    SCORE_COLOURS,
    TRAVEL_LABEL,
    colours,
    legend_below,
    mark_sensor,
    sheet,
)
from .summary import leans, mounting_name, mounting_text, sharp_of, sides, was_searched

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.collections import QuadMesh
    from matplotlib.lines import Line2D

    from ..road.road_map import RoadMap

FEWEST_VEHICLES = 5  # below this a band's average says little, and is not drawn
BAND_M = 10.0
_CELL_LENGTH_M = 5.0  # of the blind zones, along the road
_MARGIN_M = 1.5  # room for the LiDAR's marker
_PANEL_MM = 128.0  # width of a panel of the blind zones
_MOST_WRITTEN = 36  # cells along the road in which a number can be read


def draw_charts(site: Site, run: RunFolder) -> list[str]:
    """Draw every chart that the run has data for into its folder; returns the names of the files.

    Raises
    ------
    MissingExtraError
        When matplotlib is not installed.
    MissingFileError, InputError
        When a record of the search is missing or damaged.
    OutputError
        When a chart cannot be written.
    """
    charts = {}
    if was_searched(run.result):
        charts["convergence.png"] = partial(plot_convergence, run=run, history=run.read_history())
        if (score_map := run.read_score_map()) is not None:
            charts["score_map.png"] = partial(plot_score_map, run=run, score_map=score_map)
    charts |= {
        "by_distance.png": partial(plot_by_distance, run=run),
        "blind_zones.png": partial(
            plot_blind_zones, run=run, road=site.scenario.road_map, zones=site.scenario.objective.zones
        ),
        "other_traffic.png": partial(plot_other_traffic, result=run.result),
        "clouds.png": partial(draw_clouds, site=site, run=run),
        "occupancy.png": partial(draw_occupancy, site=site, run=run),
    }
    for name, draw in charts.items():
        draw(run.file(name))
    return list(charts)


def _about(result: Mapping, *, judged: bool = False) -> str:
    """The line below a chart's title: sensor, range gate, vehicles, and the metric where it is not the default.

    It is `judged` if the chart shows held-out frames too, where there are any.
    """
    metric = "" if result["metric"] == PE_VGOP.name else f", metric {metric_named(result['metric']).name}"
    return (
        f"{result['sensor']}, range gate {result['range_gate_m']:g} m, "
        f"{counted(result['vehicles'], 'vehicle box')} in {counted(result['frames'], 'frame')}{metric}"
        f"{', and held-out frames' if judged and result['holdout'] else ''}"
    )


# --- Convergence: how the search's best objective rose with the number of mountings tried -----------------------------


def plot_convergence(path: str | Path, run: RunFolder, history: np.ndarray) -> None:
    """Draw the convergence of the search: every candidate's objective per vehicle, and the best so far.

    The `history` is that of the search that found the mounting, (evaluations, columns): over a tolerance its values
    and the baseline's are those over it. A candidate without a finite value is left out.
    """
    result, metric = run.result, metric_named(run.result["metric"])
    over = "" if sharp_of(result) is None else " over the tolerance"
    base = result["tolerance"]["robust"]["baseline"] if over else result["baseline"]
    baseline = base["objective_per_vehicle"]
    evaluation, vehicles = history[:, 0], result["vehicles"]
    if WEIGHT in run.baseline:
        vehicles = run.baseline[WEIGHT][run.baseline["split"] == "search"].sum()
    value, best = history[:, -2:].T / vehicles
    title = f"Search{over}: {result['search']}, seed {result['seed']}, {result['reading']} reading"
    with sheet(path, 90.0, title, _about(result)) as figure:
        axes = figure.add_subplot(
            xlabel="Evaluations (mountings tried)",
            ylabel=metric.in_unit("Objective per vehicle"),
            xlim=(0.0, 1.02 * evaluation.max()),
        )
        known = np.isfinite(value)
        look = {"color": FAINT, "markersize": 2.5, "label": "one candidate"}
        dots = axes.plot(evaluation[known], metric.shown(value[known]), ".", **look)
        look, label = _line(OPTIMISED_LOOK), f"best so far (at the end {metric.amount(best[-1])})"
        line = axes.step(evaluation, metric.shown(best), where="post", label=label, **look)
        label = f"baseline mounting ({metric.amount(baseline)})"
        level = axes.axhline(metric.shown(baseline), label=label, **_line(BASELINE_LOOK))
        axes.xaxis.set_major_formatter("{x:,.0f}")
        axes.xaxis.get_major_locator().set_params(integer=True)
        axes.grid(visible=True)
        legend_below(figure, [*line, *dots, level], columns=3)


def _line(look: Mapping) -> dict:
    """Colour and dashes of a series, without its markers."""
    return {key: look[key] for key in ("color", "linestyle")}


# --- Score map: the objective over mounting height and tilt, with the near-best region --------------------------------


_TILT_LABELS = {
    "tilt_x_deg": "Tilt, positive down to where the mast faces [deg]",
    "lean_deg": "Lean, in the direction of the optimum [deg]",
}


def plot_score_map(path: str | Path, run: RunFolder, score_map: ScoreMap) -> None:
    """Draw the objective over the grid of heights and tilts, the optimum, the baseline and the near-best region.

    The grid is of mountings that hang as planned: where the run's is the best over a tolerance (robust), the optimum
    is the sharp one, and the robust one has a marker of its own. A mounting outside the grid is marked on its edge.
    """
    result, metric = run.result, metric_named(run.result["metric"])
    sharp = sharp_of(result)
    marks = [("optimum", result, "*", 13.0), ("baseline", result["baseline"], "s", 7.0)]
    if sharp is not None:
        marks[:1] = [("sharp", sharp, "*", 13.0), ("robust", result, "D", 7.0)]
    grid, values = (score_map.tilt_deg, score_map.height_m), metric.shown(score_map.per_vehicle)
    what = "lean" if score_map.tilt == "lean_deg" else "tilt"
    with sheet(path, 115.0, f"Objective over height and {what}", _about(result)) as figure:
        axes = figure.add_subplot(xlabel=_TILT_LABELS[score_map.tilt], ylabel="Mounting height above the road [m]")
        mesh = axes.pcolormesh(*grid, values, cmap=colours(SCORE_COLOURS), shading="gouraud")
        figure.colorbar(mesh, ax=axes, label=metric.in_unit("Objective per vehicle"), pad=0.02)
        if values.min() < values.max():
            lines = axes.contour(*grid, values, levels=8, colors=INK, linewidths=0.4)
            axes.clabel(lines, fontsize=6.5)
        handles = []
        for name, scores, marker, size in marks:
            look = {"marker": marker, "markersize": size}
            amount = metric.amount(scores["objective_per_vehicle"])
            handles.append(_mark(axes, score_map, scores["deployment"], name, amount, look))
        best = max(marks[0][1]["objective_per_vehicle"], score_map.per_vehicle.max())
        least = near_best_threshold(best, result["baseline"]["objective_per_vehicle"], REGION_SHARE)
        handles.append(_draw_region(axes, score_map, least))
        legend_below(figure, handles, columns=len(handles))


def _mark(axes: Axes, score_map: ScoreMap, mount: Mapping, name: str, amount: str, look: Mapping) -> Line2D:
    """A marker at a mounting or, with an arrow leading out of the map, at the edge nearest to it."""
    tilt, grid = mount[score_map.tilt], (score_map.tilt_deg, score_map.height_m)
    at = np.array([tilt, mount["height_m"]])
    edge = np.clip(at, [axis[0] for axis in grid], [axis[-1] for axis in grid])
    label = f"{name}: {mount['height_m']:.2f} m, {tilt:.1f}°"
    if (edge != at).any():
        label += ", off the map"
        arrow = {"arrowstyle": "->", "color": INK, "linewidth": 1.2, "shrinkB": 6.0}
        axes.annotate("", xy=edge, xytext=-24.0 * np.sign(at - edge), textcoords="offset points", arrowprops=arrow)
    colour = {"markerfacecolor": "white", "markeredgecolor": "black", "markeredgewidth": 1.0, "linestyle": "none"}
    (line,) = axes.plot(*edge, label=f"{label}\n{amount}", clip_on=False, zorder=5, **colour, **look)
    return line


def _draw_region(axes: Axes, score_map: ScoreMap, threshold: float) -> Line2D:
    """Outline the values from the threshold up; returns what the legend shows for it."""
    from matplotlib.lines import Line2D

    look, values = {"linewidths": 2.0, "colors": "black"}, score_map.per_vehicle
    label = f"within {100.0 * REGION_SHARE:g} % of the gain"
    if values.max() < threshold:
        label += "\nsmaller than a cell"
    elif values.min() < threshold:
        axes.contour(score_map.tilt_deg, score_map.height_m, values, levels=[threshold], **look)
    else:
        label += "\nthe whole map"
    return Line2D([], [], color="black", linewidth=2.0, label=label)


# --- Detectable share and mean score by distance, before and after ----------------------------------------------------


def plot_by_distance(path: str | Path, run: RunFolder) -> None:
    """Draw the detectable share, the mean score and the number of vehicles by distance band, before and after."""
    result, metric = run.result, metric_named(run.result["metric"])
    if metric.of_share:  # which is drawn anyway
        metric = PE_VGOP
    column = "entropy_bits" if metric is PE_VGOP else METRIC_VALUE
    distances = [table["distance_m"] for table in (run.baseline, run.optimised)]
    edges_m = BAND_M * np.arange(np.concatenate(distances).max(initial=0.0) // BAND_M + 2.0)
    centre_m = edges_m[:-1] + 0.5 * BAND_M
    counts = [np.histogram(distance, edges_m)[0] for distance in distances]
    title, about = "What is seen, by distance", _about(result, judged=True)
    unit = ", ".join(filter(None, [metric.unit, "" if metric.higher_is_better else "lower is better"]))
    with sheet(path, 140.0, title, about) as figure:
        share, score, count = figure.subplots(3, 1, sharex=True, height_ratios=(3, 3, 1.4))
        handles = []
        for table, inside, look, (name, _) in zip(
            (run.baseline, run.optimised), counts, (BASELINE_LOOK, OPTIMISED_LOOK), sides(result), strict=True
        ):
            line = {**look, "label": name.lower(), "clip_on": False, "zorder": 3}
            seen, scored = (
                np.where(inside >= FEWEST_VEHICLES, cell_means(table[key], [table["distance_m"]], [edges_m]), np.nan)
                for key in ("detectable", column)
            )
            handles += share.plot(centre_m, 100.0 * seen, **line)
            score.plot(centre_m, scored, **line)
        share.set(ylabel="Detectable share [%]", ylim=(0.0, 100.0))
        score.set_ylabel(f"Mean {metric.label}\n[{unit}]" if unit else f"Mean {metric.label}")
        if not score.dataLim.y0 < 0.0:
            score.set_ylim(bottom=0.0)
        handles += _draw_counts(count, centre_m, counts)
        labels = {"xlabel": "Horizontal distance from the LiDAR [m]", "ylabel": "Vehicles\n[number]"}
        count.set(xlim=(0.0, edges_m[-1]), ylim=(0.0, None), **labels)
        count.yaxis.get_major_locator().set_params(integer=True)
        for axes in (share, score, count):
            axes.grid(visible=True)
        figure.align_ylabels()
        legend_below(figure, handles, columns=len(handles))


def plot_other_traffic(path: str | Path, result: Mapping) -> None:
    """Draw the detectable share under other traffic with its interval, and of each lane, beside the recorded one's."""
    from matplotlib.lines import Line2D

    other = result["other_traffic"]
    rows = [{"what": "as recorded", "value": "", **other["recorded"]}, *other["mixes"]]
    rows = [row for row in rows if row["detectable_share"] is not None]
    about = f"{result['sensor']}, the {mounting_name(result)} mounting, {counted(other['frames'], 'frame')}"
    look = {**OPTIMISED_LOOK, "linestyle": "none"}
    lane_look = {"marker": "|", "markersize": 7.0, "linestyle": "none", "color": FAINT}
    with sheet(path, 34.0 + 6.0 * len(rows), "Detectable vehicles under other traffic", about) as figure:
        axes = figure.subplots()
        for at, row in enumerate(rows):
            share, ends = 100.0 * row["detectable_share"], row["interval_90"]
            by_lane = known_lanes(row)
            lanes = [100.0 * one for one in by_lane.values()]
            axes.plot(lanes, [at] * len(lanes), zorder=2, **lane_look)
            if ends:
                axes.plot([100.0 * end for end in ends], [at, at], color=look["color"])
            axes.plot(share, at, zorder=3, clip_on=False, **look)
            if lanes and min(lanes) < share:
                lane = min(by_lane, key=by_lane.get)
                axes.annotate(lane, (min(lanes), at), (-3, 0), textcoords="offset points", ha="right", va="center")
        axes.axvline(100.0 * rows[0]["detectable_share"], color=INK, linestyle="--", linewidth=1.0)
        names = [", ".join(filter(None, (row["what"], row["value"]))) for row in rows]
        axes.set(xlabel="Detectable share [%]", xlim=(0.0, 100.0), ylim=(len(rows) - 0.5, -0.5))
        axes.set_yticks(range(len(rows)), names)
        axes.grid(visible=True, axis="x")
        handles = [
            Line2D([], [], **{**look, "linestyle": "-", "label": "all vehicles, 90 % interval"}),
            Line2D([], [], **lane_look, label=f"lanes of {FEW_VEHICLES} vehicles or more"),
            Line2D([], [], color=INK, linestyle="--", label="as recorded"),
        ]
        legend_below(figure, handles, columns=3)


def cell_means(values: np.ndarray, places: Sequence[np.ndarray], edges: Sequence[np.ndarray]) -> np.ndarray:
    """Mean of the values in each cell of a grid of one or more dimensions: a ratio of two histograms.

    Parameters
    ----------
    values : ndarray, (n,)
        Those that are not finite count nowhere.
    places : d ndarrays, (n,)
        Coordinates of each value; those beyond the edges count nowhere.
    edges : d ndarrays
        Rising cell edges along each; a cell holds its lower edge, the last one its upper edge too.

    Returns
    -------
    ndarray, d-dimensional
        NaN in a cell without values.
    """
    known = np.isfinite(values)
    sample = np.column_stack(places)[known]
    total, _ = np.histogramdd(sample, bins=edges, weights=values[known])
    number, _ = np.histogramdd(sample, bins=edges)
    return np.divide(total, number, out=np.full(total.shape, np.nan), where=number > 0)


def _draw_counts(axes: Axes, centre_m: np.ndarray, counts: list[np.ndarray]) -> list[object]:
    """A bar per band, or a pair where the tables differ, hollow if it is not averaged; returns the legend's entries."""
    from matplotlib.patches import Patch

    solid = {"facecolor": FAINT, "edgecolor": INK, "linewidth": 0.6}
    hollow = {**solid, "facecolor": "none"}
    alike = np.array_equal(*counts)
    bars = [(counts[0], 0.0, 0.8)] if alike else [(counts[0], -0.2, 0.4), (counts[1], 0.2, 0.4)]
    for count, shift, width in bars:
        for chosen, look in ((count >= FEWEST_VEHICLES, solid), (count < FEWEST_VEHICLES, hollow)):
            axes.bar((centre_m + shift * BAND_M)[chosen], count[chosen], width * BAND_M, **look)
    return [
        Patch(label="vehicles, over all frames" + ("" if alike else " (baseline left)"), **solid),
        Patch(label=f"fewer than {FEWEST_VEHICLES}: not averaged", **hollow),
    ]


# --- Blind zones: where along and across the road vehicles stay below the threshold, before and after -----------------


def plot_blind_zones(path: str | Path, run: RunFolder, road: RoadMap, zones: Sequence[ZoneSettings] = ()) -> None:
    """Draw the share of vehicles below the detectability threshold per cell of the road, before and after.

    Across the road a cell is a lane, the median, or as wide as a lane beside them; `zones` of weights are outlined.
    """
    tables, mountings = (run.baseline, run.optimised), sides(run.result)
    lane_m, half = float(np.median(road.width_m)), 0.5 * road.width_m
    lines = np.unique(np.concatenate([road.offset_m - half, road.offset_m + half]).round(6))
    poles = np.array([[mount["x_m"], mount["y_m"]] for _, mount in mountings])
    x = np.concatenate([*(table["x_m"] for table in tables), poles[:, 0]])
    y = np.concatenate([*(table["y_m"] for table in tables), lines])
    x_edges = covering_edges(x.min(), x.max(), _CELL_LENGTH_M)
    right = np.arange(math.ceil((lines[0] - y.min()) / lane_m), 0, -1)  # lanes beside the road where vehicles drive
    left = np.arange(1, math.ceil((y.max() - lines[-1]) / lane_m) + 1)
    y_edges = np.concatenate([lines[0] - lane_m * right, lines, lines[-1] + lane_m * left])
    title, about = "Where vehicles stay below the threshold", _about(run.result, judged=True)
    across = poles[:, 1]
    xlim = x_edges[0], x_edges[-1]
    ylim = min(y_edges[0], across.min() - _MARGIN_M), max(y_edges[-1], across.max() + _MARGIN_M)
    height_mm = _PANEL_MM * (ylim[1] - ylim[0]) / (xlim[1] - xlim[0])
    with sheet(path, 46.0 + 2.0 * (height_mm + 7.0), title, about) as figure:
        panels = figure.subplots(2, 1, sharex=True, sharey=True)
        for axes, table, (name, mount) in zip(panels, tables, mountings, strict=True):
            below = np.where(table["detectable"], 0.0, 100.0)
            share = cell_means(below, (table["y_m"], table["x_m"]), (y_edges, x_edges))
            mesh, empty = _draw_cells(axes, x_edges, y_edges, share)
            _write_counts(axes, np.histogram2d(table["y_m"], table["x_m"], (y_edges, x_edges))[0], x_edges, y_edges)
            _draw_lanes(axes, road, np.stack(np.meshgrid(x_edges[[0, -1]], y_edges[[0, -1]]), axis=-1).reshape(-1, 2))
            marker = mark_sensor(axes, (mount["x_m"], mount["y_m"]))
            outlines = [_outline_zone(axes, zone) for zone in zones]
            found = f"{below.mean():.1f} % of {below.size:,} boxes below the threshold"
            axes.set(
                title=f"{name}: {mounting_text(mount, leans=leans(run.result))}\n{found}",
                ylabel="Across the road, y [m]",
            )
            axes.set_aspect("equal")
        panels[-1].set(xlim=xlim, ylim=ylim, xlabel=ALONG_LABEL if road.against.any() else TRAVEL_LABEL)
        figure.colorbar(mesh, ax=panels, label="Boxes below the threshold [%]", pad=0.02)
        legend_below(figure, [marker, empty, *outlines[:1]], columns=3)


def _write_counts(axes: Axes, counts: np.ndarray, x_edges: np.ndarray, y_edges: np.ndarray) -> None:
    """The number of boxes in each cell, where cells are wide enough for it."""
    if len(x_edges) > _MOST_WRITTEN:
        return
    for (row, column), count in np.ndenumerate(counts):
        if count:
            place = 0.5 * (x_edges[column] + x_edges[column + 1]), 0.5 * (y_edges[row] + y_edges[row + 1])
            axes.text(*place, f"{count:.0f}", ha="center", va="center", fontsize=4.5, color=INK)


def _outline_zone(axes, zone):
    """The outline of a zone with its name and weight in it."""
    x, y = np.array([*zone.polygon_m, zone.polygon_m[0]]).T
    (line,) = axes.plot(x, y, color=INK, linewidth=1.2, linestyle=(0, (4, 2)), label="zone x weight", zorder=3)
    box = {"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 1.0}
    look = {"ha": "center", "va": "center", "fontsize": 7.0, "bbox": box, "clip_on": True}
    axes.text(x[:-1].mean(), y[:-1].mean(), f"{zone.name} x {zone.weight:g}", **look)
    return line


def covering_edges(low: float, high: float, step: float, anchor: float = 0.0) -> np.ndarray:
    """Edges at ``anchor + k * step`` for whole k, (e,), the shortest run with every value in ``[low, high]`` inside."""
    first = math.floor((low - anchor) / step)
    last = math.floor((high - anchor) / step) + 1
    # The quotient is rounded: an edge may have come out one step on the wrong side of its value.
    first -= anchor + first * step > low
    last += anchor + last * step < high
    return anchor + step * np.arange(first, last + 1)


def _draw_cells(axes: Axes, x_edges: np.ndarray, y_edges: np.ndarray, percent: np.ndarray) -> tuple[QuadMesh, object]:
    """Cells shaded by per cent over a hatched ground that shows where there is none."""
    from matplotlib.patches import Rectangle

    corner, size = (x_edges[0], y_edges[0]), (np.ptp(x_edges), np.ptp(y_edges))
    look = {"facecolor": "white", "edgecolor": FAINT, "hatch": "//////", "linewidth": 0.0}
    axes.add_patch(Rectangle(corner, *size, zorder=0, **look))
    shades = {"cmap": colours(BLIND_COLOURS), "vmin": 0.0, "vmax": 100.0}
    mesh = axes.pcolormesh(x_edges, y_edges, np.ma.masked_invalid(percent), **shades)
    return mesh, Rectangle((0.0, 0.0), 1.0, 1.0, label="no vehicle was there", **look)


def _draw_lanes(axes: Axes, road: RoadMap, corners: np.ndarray) -> None:
    """The edges of carriageways solid, the lines between their lanes dashed, as far as places (4, 2) reach [m]."""
    s = road.locate(corners).s_m
    edges, between = road.lines((s.min(), s.max()))
    for line in between:
        axes.plot(*line.T, color="black", linewidth=0.5, dashes=(6, 4))
    for line in edges:
        axes.plot(*line.T, color="black", linewidth=1.2)
