"""The charts of a run: convergence, score map, detectable share by distance, blind zones; clouds and cells apart."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..metrics.catalogue import PE_VGOP, metric_named
from ..metrics.metric import Metric
from ..run.folder import RunFolder
from ..run.optimise import Outcome
from ..run.verdict import METRIC_VALUE, REGION_SHARE, ScoreMap, near_best_threshold
from ..scene.site import Site
from ..traffic.vehicles import RoadFrame
from .cloud_figures import draw_clouds, draw_occupancy
from .figure import (
    BASELINE,
    BLIND_COLOURS,
    FAINT,
    INK,
    OPTIMISED,
    SCORE_COLOURS,
    TRAVEL_LABEL,
    colours,
    legend_below,
    mark_sensor,
    say_empty,
    sheet,
)
from .summary import mounting_text, sharp_of, sides

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.collections import QuadMesh
    from matplotlib.lines import Line2D

FEWEST_VEHICLES = 5  # below this a band's average says little, and is not drawn
BAND_M = 10.0
_CELL_LENGTH_M = 5.0  # of the blind zones, along the road
_MARGIN_M = 1.5  # room for the LiDAR's marker


def draw_charts(site: Site, outcome: Outcome, folder: RunFolder) -> list[str]:
    """Draw every chart that the run has data for; returns the names of the files.

    Raises
    ------
    MissingExtraError
        When matplotlib is not installed.
    OutputError
        When a chart cannot be written.
    """
    drawn = []

    def file(name: str) -> Path:
        drawn.append(name)
        return folder.file(name)

    if outcome.history is not None:
        plot_convergence(file("convergence.png"), outcome)
    if outcome.score_map is not None:
        plot_score_map(file("score_map.png"), outcome)
    plot_by_distance(file("by_distance.png"), outcome)
    plot_blind_zones(file("blind_zones.png"), outcome, site.scenario.road)
    draw_clouds(file("clouds.png"), site, outcome)
    draw_occupancy(file("occupancy.png"), site, outcome)
    return drawn


def _about(result: Mapping) -> str:
    """The line below a chart's title: sensor, range gate, vehicles, and the metric where it is not the default."""
    metric = "" if result["metric"] == PE_VGOP.name else f", metric {result['metric']}"
    return (
        f"{result['sensor']}, range gate {result['range_gate_m']:g} m, "
        f"{result['vehicles']} vehicles in {result['frames']} frames{metric}"
    )


# --- Convergence: how the search's best objective rose with the number of mountings tried -----------------------------


def plot_convergence(path: str | Path, outcome: Outcome) -> None:
    """Draw the convergence of the search: every candidate's objective per vehicle, and the best so far.

    It is the search that found the mounting: over a tolerance, its values and the baseline's are those over it. A
    candidate without a finite value is left out.
    """
    result, metric = outcome.result, metric_named(outcome.result["metric"])
    over = "" if sharp_of(result) is None else " over the tolerance"
    base = result["tolerance"]["robust"]["baseline"] if over else result["baseline"]
    baseline = base["objective_per_vehicle"]
    evaluation = outcome.history[:, 0]
    value, best = outcome.history[:, -2:].T / result["vehicles"]
    title = f"Search{over}: {result['search']}, seed {result['seed']}, {result['reading']} reading"
    with sheet(path, 90.0, title, _about(result)) as figure:
        axes = figure.add_subplot()
        known = np.isfinite(value)
        dots = axes.plot(evaluation[known], value[known], ".", color=FAINT, markersize=2.5, label="one candidate")
        look, label = _line(OPTIMISED), f"best so far (at the end {metric.amount(best[-1])})"
        line = axes.step(evaluation, best, where="post", label=label, **look)
        level = axes.axhline(baseline, label=f"baseline mounting ({metric.amount(baseline)})", **_line(BASELINE))
        axes.set_xlabel("Evaluations (mountings tried)")
        axes.set_ylabel(metric.in_unit("Objective per vehicle"))
        axes.xaxis.set_major_formatter("{x:,.0f}")
        axes.xaxis.get_major_locator().set_params(integer=True)
        axes.set_xlim(0.0, 1.02 * evaluation.max())
        axes.grid(visible=True)
        legend_below(figure, [*line, *dots, level], columns=3)


def _line(look: Mapping) -> dict:
    """Colour and dashes of a series, without its markers."""
    return {key: look[key] for key in ("color", "linestyle")}


# --- Score map: the objective over mounting height and tilt, with the near-best region --------------------------------


def plot_score_map(path: str | Path, outcome: Outcome) -> None:
    """Draw the objective over the grid of heights and tilts, the optimum, the baseline and the near-best region.

    The grid is of mountings that hang as planned: where the run's is the best over a tolerance (robust), the optimum
    is the sharp one, and the robust one has a marker of its own. A mounting outside the grid is marked on its edge.
    """
    result, score_map, metric = outcome.result, outcome.score_map, metric_named(outcome.result["metric"])
    sharp = sharp_of(result)
    optimum, base = sharp or result, result["baseline"]
    grid, values = (score_map.tilt_deg, score_map.height_m), score_map.per_vehicle
    with sheet(path, 115.0, "Objective over height and tilt", _about(result)) as figure:
        axes = figure.add_subplot()
        mesh = axes.pcolormesh(*grid, values, cmap=colours(SCORE_COLOURS), shading="gouraud")
        figure.colorbar(mesh, ax=axes, label=metric.in_unit("Objective per vehicle"), pad=0.02)
        if values.min() < values.max():
            lines = axes.contour(*grid, values, levels=8, colors=INK, linewidths=0.4)
            axes.clabel(lines, fontsize=6.5)
        best = max(optimum["objective_per_vehicle"], values.max())
        handles = [
            _mark(axes, score_map, optimum, "optimum" if sharp is None else "sharp", metric, "*", 13.0),
            _mark(axes, score_map, base, "baseline", metric, "s", 7.0),
            _draw_region(axes, score_map, near_best_threshold(best, base["objective_per_vehicle"], REGION_SHARE)),
        ]
        if sharp is not None:
            handles.insert(1, _mark(axes, score_map, result, "robust", metric, "D", 7.0))
        axes.set_xlabel("Tilt across the road, positive down towards +y [deg]")
        axes.set_ylabel("Mounting height above the road [m]")
        legend_below(figure, handles, columns=len(handles))


def _mark(
    axes: Axes, score_map: ScoreMap, scores: Mapping, name: str, metric: Metric, marker: str, size: float
) -> Line2D:
    """A marker at a mounting or, with an arrow leading out of the map, at the edge nearest to it."""
    height, tilt = (scores["deployment"][key] for key in ("height_m", "tilt_x_deg"))
    edge = tuple(
        float(np.clip(at, axis[0], axis[-1])) for at, axis in ((tilt, score_map.tilt_deg), (height, score_map.height_m))
    )
    outside = edge != (tilt, height)
    label = f"{name}: {height:.2f} m, {tilt:.1f}°" + (", off the map" if outside else "")
    if outside:
        away = (-24.0 * np.sign(tilt - edge[0]), -24.0 * np.sign(height - edge[1]))
        arrow = {"arrowstyle": "->", "color": INK, "linewidth": 1.2, "shrinkB": 6.0}
        axes.annotate("", xy=edge, xytext=away, textcoords="offset points", arrowprops=arrow)
    (line,) = axes.plot(
        *edge,
        marker,
        markersize=size,
        markerfacecolor="white",
        markeredgecolor="black",
        markeredgewidth=1.0,
        clip_on=False,
        zorder=5,
        label=f"{label}\n{metric.amount(scores['objective_per_vehicle'])}",
    )
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


def plot_by_distance(path: str | Path, outcome: Outcome) -> None:
    """Draw the detectable share, the mean score and the number of vehicles by distance band, before and after."""
    result, metric = outcome.result, metric_named(outcome.result["metric"])
    if metric.of_scene:  # the value of a scene is no vehicle's
        metric = PE_VGOP
    column = "entropy_bits" if metric is PE_VGOP else METRIC_VALUE
    tables = (outcome.baseline, outcome.optimised)
    bands = [np.floor(table["distance_m"] / BAND_M).astype(int) for table in tables]
    number = 1 + int(np.concatenate(bands).max(initial=0))
    centre_m = (np.arange(number) + 0.5) * BAND_M
    counts = [np.bincount(band, minlength=number) for band in bands]
    title, about = "What is seen, by distance", f"{_about(result)}, and held-out frames"
    with sheet(path, 140.0, title, about) as figure:
        share, score, count = figure.subplots(3, 1, sharex=True, height_ratios=(3, 3, 1.4))
        if not any(inside.any() for inside in counts):
            say_empty(share, "no vehicles")
            say_empty(score, "no vehicles")
        handles, lowest = [], 0.0
        for table, band, inside, look, (name, _) in zip(
            tables, bands, counts, (BASELINE, OPTIMISED), sides(result), strict=True
        ):
            drawn = inside >= FEWEST_VEHICLES
            line = {**look, "label": name.lower(), "clip_on": False, "zorder": 3}
            seen, scored = (band_means(band, table[key], number) for key in ("detectable", column))
            handles += share.plot(centre_m, np.where(drawn, 100.0 * seen, np.nan), **line)
            score.plot(centre_m, np.where(drawn, scored, np.nan), **line)
            lowest = min(lowest, np.nanmin(scored, initial=0.0))
        share.set_ylabel("Detectable share [%]")
        share.set_ylim(0.0, 100.0)
        unit = ", ".join(filter(None, [metric.unit, "" if metric.higher_is_better else "lower is better"]))
        score.set_ylabel(f"Mean {metric.label}\n[{unit}]" if unit else f"Mean {metric.label}")
        if lowest == 0.0:
            score.set_ylim(bottom=0.0)
        handles += _draw_counts(count, centre_m, counts)
        count.set_ylabel("Vehicles\n[number]")
        count.set_xlabel("Horizontal distance from the LiDAR [m]")
        count.set_ylim(bottom=0.0)
        count.yaxis.get_major_locator().set_params(integer=True)
        count.set_xlim(0.0, number * BAND_M)
        for axes in (share, score, count):
            axes.grid(visible=True)
        figure.align_ylabels()
        legend_below(figure, handles, columns=len(handles))


def band_means(band: np.ndarray, values: np.ndarray, bands: int) -> np.ndarray:
    """Mean of the finite `values` (n,) in each of the `bands`, (bands,), NaN where none is; `band` (n,) is theirs."""
    known = np.isfinite(values)
    total = np.bincount(band[known], weights=values[known], minlength=bands)
    return _ratio(total, np.bincount(band[known], minlength=bands))


def _ratio(part: np.ndarray, whole: np.ndarray) -> np.ndarray:
    """part / whole, NaN where the whole is zero."""
    return np.divide(part, whole, out=np.full(np.shape(whole), np.nan), where=whole > 0)


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


def plot_blind_zones(path: str | Path, outcome: Outcome, road: RoadFrame) -> None:
    """Draw the share of vehicles below the detectability threshold per cell of the road, before and after.

    The carriageway is divided into whole lanes of about the road's lane width.
    """
    result, tables = outcome.result, (outcome.baseline, outcome.optimised)
    mountings = sides(result)
    low, high = road.carriageway_y
    lane_m = (high - low) / max(round((high - low) / road.lane_width_m), 1)
    sensors = np.array([[mount["x_m"], mount["y_m"]] for _, mount in mountings])
    x = np.concatenate([*(table["x_m"] for table in tables), sensors[:, 0]])
    y = np.concatenate([*(table["y_m"] for table in tables), [low + 0.5 * lane_m, high - 0.5 * lane_m]])
    x_edges = covering_edges(x.min(), x.max(), _CELL_LENGTH_M)
    y_edges = covering_edges(y.min(), y.max(), lane_m, low)  # more lanes where vehicles drive beside the carriageway
    title, about = "Where vehicles stay below the threshold", f"{_about(result)}, and held-out frames"
    with sheet(path, 120.0, title, about) as figure:
        panels = figure.subplots(2, 1, sharex=True, sharey=True)
        for axes, table, sensor, (name, mount) in zip(panels, tables, sensors, mountings, strict=True):
            below = table["detectable"] == 0
            share = cell_shares(table["x_m"], table["y_m"], below, x_edges, y_edges)
            mesh, empty = _draw_cells(axes, x_edges, y_edges, share)
            _draw_lanes(axes, np.arange(low, high + 0.5 * lane_m, lane_m))
            marker = mark_sensor(axes, sensor)
            found = f"{100.0 * below.mean():.1f} % of {below.size:,} vehicles below the threshold" if below.size else ""
            axes.set_title(f"{name}: {mounting_text(mount)}\n{found or 'no vehicles'}")
            axes.set_ylabel("Across the road, y [m]")
            if not found:
                say_empty(axes, "no vehicles")
        across = sensors[:, 1]
        panels[-1].set_ylim(min(y_edges[0], across.min() - _MARGIN_M), max(y_edges[-1], across.max() + _MARGIN_M))
        panels[-1].set_xlim(x_edges[0], x_edges[-1])
        panels[-1].set_xlabel(TRAVEL_LABEL)
        figure.colorbar(mesh, ax=panels, label="Vehicles below the threshold [%]", pad=0.02)
        legend_below(figure, [marker, empty], columns=2)


def covering_edges(low: float, high: float, step: float, anchor: float = 0.0) -> np.ndarray:
    """Edges at ``anchor + k * step`` for whole k, (e,), the shortest run with every value in ``[low, high]`` inside."""
    first = math.floor((low - anchor) / step)
    last = math.floor((high - anchor) / step) + 1
    # The quotient is rounded: an edge may have come out one step on the wrong side of its value.
    first -= anchor + first * step > low
    last += anchor + last * step < high
    return anchor + step * np.arange(first, last + 1)


def cell_shares(
    x_m: np.ndarray, y_m: np.ndarray, counted: np.ndarray, x_edges_m: np.ndarray, y_edges_m: np.ndarray
) -> np.ndarray:
    """Share of the vehicles in each cell of the road for which `counted` is true: a two-dimensional histogram.

    Parameters
    ----------
    x_m, y_m : ndarray, (n,)
        Box centres [m, road frame]; those beyond the edges count nowhere.
    counted : ndarray, (n,) bool
        Which vehicles make up the share.
    x_edges_m, y_edges_m : ndarray, (c + 1,) and (r + 1,)
        Rising cell edges [m]; a cell holds its lower edge, the last one its upper edge too.

    Returns
    -------
    ndarray, (r, c)
        0 to 1, rows along y; NaN in a cell without vehicles.
    """
    edges = (y_edges_m, x_edges_m)
    total, *_ = np.histogram2d(y_m, x_m, bins=edges)
    part, *_ = np.histogram2d(y_m[counted], x_m[counted], bins=edges)
    return _ratio(part, total)


def _draw_cells(axes: Axes, x_edges: np.ndarray, y_edges: np.ndarray, share: np.ndarray) -> tuple[QuadMesh, object]:
    """Cells shaded by share in per cent over a hatched ground that shows where there is none."""
    from matplotlib.patches import Rectangle

    corner, size = (x_edges[0], y_edges[0]), (np.ptp(x_edges), np.ptp(y_edges))
    look = {"facecolor": "white", "edgecolor": FAINT, "hatch": "//////", "linewidth": 0.0}
    axes.add_patch(Rectangle(corner, *size, zorder=0, **look))
    mesh = axes.pcolormesh(
        x_edges, y_edges, np.ma.masked_invalid(100.0 * share), cmap=colours(BLIND_COLOURS), vmin=0.0, vmax=100.0
    )
    return mesh, Rectangle((0.0, 0.0), 1.0, 1.0, label="no vehicle was there", **look)


def _draw_lanes(axes: Axes, edges_m: np.ndarray) -> None:
    """The carriageway's two edges solid, the lines between its lanes dashed."""
    for y in edges_m[1:-1]:
        axes.axhline(y, color="black", linewidth=0.5, dashes=(6, 4))
    for y in edges_m[[0, -1]]:
        axes.axhline(y, color="black", linewidth=1.2)
