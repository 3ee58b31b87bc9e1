"""The charts of a run: convergence, score map, detectable share by distance and approach; plans and clouds apart."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..metrics.catalogue import PE_VGOP, metric_named
from ..run.folder import RunFolder, of_lidar
from ..run.quantities import judged_on
from ..run.vehicle_table import APPROACH, METRIC_VALUE, MOVEMENT, WEIGHT
from ..run.verdict import REGION_SHARE, ScoreMap, near_best_threshold
from ..run.words import (
    each_lidar,
    errors_text,
    gate_text,
    layout_frames,
    mounting_name,
    run_text,
    sides,
    was_searched,
)
from ..scene.site import Site
from ..statistics import FEW_VEHICLES
from ..traffic.vehicles import counted
from .cloud_figures import draw_clouds
from .coverage_figures import plot_blind_zones
from .figure import (
    BASELINE_LOOK,
    FAINT,
    INK,
    OPTIMISED_LOOK,
    SCORE_COLOURS,
    colours,
    legend_below,
    sheet,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.lines import Line2D

FEWEST_VEHICLES = 5  # below this a band's average says little, and is not drawn
BAND_M = 10.0
_SAME_PLACE_M = 0.01


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
        charts["convergence.png"] = partial(plot_convergence, run=run, history=run.read_columns(of_search=True))
        for name in each_lidar(run.result):
            if (found := run.read_score_map(name)) is not None:
                charts[of_lidar("score_map.png", name)] = partial(plot_score_map, run=run, score_map=found, lidar=name)
    if (run.result.get("layout") or {}).get("over_single"):
        charts["layout.png"] = partial(plot_steps, result=run.result)
    road, drawn_on = site.scenario.road_map, site.scenario.drawing
    image = (drawn_on.image, drawn_on.image_points) if drawn_on.image else None
    charts |= {
        "by_distance.png": partial(plot_by_distance, run=run),
        "blind_zones.png": partial(
            plot_blind_zones, run=run, road=road, zones=site.scenario.objective.zones, image=image
        ),
        "other_traffic.png": partial(plot_other_traffic, result=run.result),
        "clouds.png": partial(draw_clouds, site=site, run=run),
    }
    if approach_rows(run.result):
        charts["by_approach.png"] = partial(plot_by_approach, result=run.result)
    for name, draw in charts.items():
        draw(run.file(name))
    return list(charts)


# --- Convergence: how the search's best objective rose with the number of mountings tried -----------------------------


def plot_convergence(path: str | Path, run: RunFolder, history: Mapping[str, np.ndarray]) -> None:
    """Draw the convergence of the search: every candidate's objective per vehicle, and the best so far.

    The `history` is that of the search, its columns by name: with installation errors each frame has its own, and the
    answer, chosen from the best few under further errors, may end lower. A mounting without a finite value is left out.
    """
    result, metric = run.result, metric_named(run.result["metric"])
    over, scored = (" under installation errors", " as searched") if errors_text(result) else ("", "")
    baseline = result["baseline"]["objective_per_vehicle_as_searched"]
    evaluation, vehicles = history["evaluation"], result["vehicles"]
    if WEIGHT in run.baseline:
        vehicles = run.baseline[WEIGHT][run.baseline["split"] == "search"].sum()
    value, best = history["objective"] / vehicles, history["best"] / vehicles
    title = f"Search{over}: {result['search']}, seed {result['seed']}, {result['reading']} reading"
    with sheet(path, 90.0, title, run_text(result)) as figure:
        axes = figure.add_subplot(
            xlabel="Evaluations (mountings tried)",
            ylabel=metric.in_unit("Objective per vehicle"),
            xlim=(0.0, 1.02 * evaluation.max()),
        )
        known = np.isfinite(value)
        look = {"color": FAINT, "markersize": 2.5, "label": "one candidate"}
        dots = axes.plot(evaluation[known], metric.shown(value[known]), ".", **look)
        look, label = _line(OPTIMISED_LOOK), f"best so far{scored} (at the end {metric.amount(best[-1])})"
        line = axes.step(evaluation, metric.shown(best), where="post", label=label, **look)
        label = f"baseline mounting ({metric.amount(baseline)})"
        level = axes.axhline(metric.shown(baseline), label=label, **_line(BASELINE_LOOK))
        for at in _added_at(history) if len(each_lidar(result)) > 1 else ():
            axes.axvline(evaluation[at], color=INK, linewidth=0.8, linestyle=":")
        axes.xaxis.set_major_formatter("{x:,.0f}")
        axes.xaxis.get_major_locator().set_params(integer=True)
        axes.grid(visible=True)
        legend_below(figure, [*line, *dots, level], columns=3)


def _added_at(history: Mapping[str, np.ndarray]) -> np.ndarray:
    """Rows of a history from which on one more LiDAR hangs: its coordinates are NaN before."""
    heights = [np.isfinite(values) for key, values in history.items() if key.endswith(".height_m")]
    return np.flatnonzero(np.diff(np.sum([np.zeros(len(history["best"])), *heights], axis=0)) > 0) + 1


def _line(look: Mapping) -> dict:
    """Colour and dashes of a series, without its markers."""
    return {key: look[key] for key in ("color", "linestyle")}


# --- Score map: the objective over mounting height and tilt, with the near-best region --------------------------------


_TILT_LABELS = {
    "tilt_x_deg": "Tilt, positive down to where the mast faces [deg]",
    "lean_deg": "Lean, in the direction of the optimum [deg]",
}


def plot_score_map(path: str | Path, run: RunFolder, score_map: ScoreMap, lidar: str = "") -> None:
    """Draw the objective over the grid of heights and tilts, the optimum, the baseline and the near-best region.

    It is of one LiDAR, of several the one that is named: the baselines of a layout are no point of its map, nor is one
    on another pole. With installation errors all values are as searched, each frame under its own, though the optimum
    was chosen as hung, under further ones. A mounting outside the grid is marked on its edge.
    """
    result, metric = each_lidar(run.result)[lidar], metric_named(run.result["metric"])
    scored, chosen = (" as searched", " as hung") if errors_text(result) else ("", "")
    marks = [(f"optimum{chosen}", result, "*", 13.0)]
    if not lidar and _on_one_pole(result["deployment"], result["baseline"]["deployment"]):
        marks.append(("baseline", result["baseline"], "s", 7.0))
    grid, values = (score_map.tilt_deg, score_map.height_m), metric.shown(score_map.per_vehicle)
    what = "lean" if score_map.tilt == "lean_deg" else "tilt"
    about = f"{what} of {lidar}, the others held" if lidar else what
    with sheet(path, 115.0, f"Objective{scored} over height and {about}", run_text(run.result)) as figure:
        axes = figure.add_subplot(xlabel=_TILT_LABELS[score_map.tilt], ylabel="Mounting height above the road [m]")
        mesh = axes.pcolormesh(*grid, values, cmap=colours(SCORE_COLOURS), shading="gouraud")
        figure.colorbar(mesh, ax=axes, label=metric.in_unit("Objective per vehicle"), pad=0.02)
        if values.min() < values.max():
            lines = axes.contour(*grid, values, levels=8, colors=INK, linewidths=0.4)
            axes.clabel(lines, fontsize=6.5)
        handles = []
        for name, scores, marker, size in marks:
            look = {"marker": marker, "markersize": size}
            amount = metric.amount(scores["objective_per_vehicle_as_searched"]) + scored
            handles.append(_mark(axes, score_map, scores["deployment"], name, amount, look))
        best = max(result["objective_per_vehicle_as_searched"], score_map.per_vehicle.max())
        least = near_best_threshold(best, result["baseline"]["objective_per_vehicle_as_searched"], REGION_SHARE)
        handles.append(_draw_region(axes, score_map, least))
        legend_below(figure, handles, columns=len(handles))


def _on_one_pole(mount: Mapping, other: Mapping) -> bool:
    """Whether two mountings hang at one place, to the centimetre."""
    return all(abs(mount[key] - other[key]) <= _SAME_PLACE_M for key in ("x_m", "y_m"))


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
    tables = run.judged
    distances = [table["distance_m"] for table in tables]
    edges_m = BAND_M * np.arange(np.concatenate(distances).max(initial=0.0) // BAND_M + 2.0)
    centre_m = edges_m[:-1] + 0.5 * BAND_M
    counts = [np.histogram(distance, edges_m)[0] for distance in distances]
    nearest = "nearest " if len(each_lidar(result)) > 1 else ""
    title, subtitle = "What is seen, by distance", run_text(result, held_out=True)
    unit = ", ".join(filter(None, [metric.unit, "" if metric.higher_is_better else "lower is better"]))
    with sheet(path, 140.0, title, subtitle) as figure:
        share, score, count = figure.subplots(3, 1, sharex=True, height_ratios=(3, 3, 1.4))
        handles = []
        for table, inside, look, (name, *_) in zip(
            tables, counts, (BASELINE_LOOK, OPTIMISED_LOOK), sides(result), strict=True
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
        labels = {"xlabel": f"Horizontal distance from the {nearest}LiDAR [m]", "ylabel": "Boxes\n[number]"}
        count.set(xlim=(0.0, edges_m[-1]), ylim=(0.0, None), **labels)
        count.yaxis.get_major_locator().set_params(integer=True)
        for axes in (share, score, count):
            axes.grid(visible=True)
        figure.align_ylabels()
        legend_below(figure, handles, columns=len(handles))


def plot_steps(path: str | Path, result: Mapping) -> None:
    """Draw the detectable share with its interval, and the price where it is known, against the number of LiDARs."""
    steps = result["layout"]["steps"]
    number, price = ([step[key] for step in steps] for key in ("lidars", "price"))
    rows = 1 if None in price else 2
    about = f"{result['sensor']}, {gate_text(result)}; {layout_frames(result)} frames, 90 % intervals"
    with sheet(path, 45.0 + 35.0 * rows, "From one LiDAR to all", about) as figure:
        share, *more = figure.subplots(rows, 1, sharex=True, squeeze=False)[:, 0]
        share.plot(number, [100.0 * step["detectable_share"] for step in steps], clip_on=False, **OPTIMISED_LOOK)
        for step in steps:
            if ends := step["detectable_share_interval_90"]:
                share.plot([step["lidars"]] * 2, [100.0 * end for end in ends], color=OPTIMISED_LOOK["color"])
        share.set(ylabel="Detectable share [%]", ylim=(0.0, 100.0))
        for axes in more:
            axes.plot(number, price, clip_on=False, **OPTIMISED_LOOK)
            axes.set(ylabel="Price", ylim=(0.0, None))
        added = [f"{step['lidars']}\n{' and '.join(step['added'])}" for step in steps]
        figure.axes[-1].set_xticks(number, added)
        figure.axes[-1].set_xlabel("LiDARs, and which was added")
        for axes in figure.axes:
            axes.grid(visible=True)


def _known_groups(mix: Mapping) -> dict[str, float]:
    """The detectable share of each approach, or else lane, of other traffic that has vehicles enough for one."""
    groups = (mix.get("by_approach") or mix["by_lane"]).items()
    return {name: one["detectable_share"] for name, one in groups if one["distinct_vehicles"] >= FEW_VEHICLES}


def plot_other_traffic(path: str | Path, result: Mapping) -> None:
    """Draw the detectable share under other traffic with its interval, and of each lane or approach."""
    from matplotlib.lines import Line2D

    other = result["other_traffic"]
    rows = [{"what": "as recorded", "value": "", **other["recorded"]}, *other["mixes"]]
    rows = [row for row in rows if row["detectable_share"] is not None]
    about = f"{result['sensor']}, the {mounting_name(result)} mounting, {counted(other['frames'], 'frame')}"
    look = {**OPTIMISED_LOOK, "linestyle": "none"}
    groups_are = "approaches" if other["recorded"].get("by_approach") else "lanes"
    group_look = {"marker": "|", "markersize": 7.0, "linestyle": "none", "color": FAINT}
    with sheet(path, 34.0 + 6.0 * len(rows), "Detectable vehicles under other traffic", about) as figure:
        axes = figure.subplots()
        for at, row in enumerate(rows):
            share, ends = 100.0 * row["detectable_share"], row["interval_90"]
            groups = _known_groups(row)
            shares = [100.0 * one for one in groups.values()]
            axes.plot(shares, [at] * len(shares), zorder=2, **group_look)
            if ends:
                axes.plot([100.0 * end for end in ends], [at, at], color=look["color"])
            axes.plot(share, at, zorder=3, clip_on=False, **look)
            if shares and min(shares) < share:
                lowest = min(groups, key=groups.get)
                axes.annotate(lowest, (min(shares), at), (-3, 0), textcoords="offset points", ha="right", va="center")
        axes.axvline(100.0 * rows[0]["detectable_share"], color=INK, linestyle="--", linewidth=1.0)
        names = [", ".join(filter(None, (row["what"], row["value"]))) for row in rows]
        axes.set(xlabel="Detectable share [%]", xlim=(0.0, 100.0), ylim=(len(rows) - 0.5, -0.5))
        axes.set_yticks(range(len(rows)), names)
        axes.grid(visible=True, axis="x")
        handles = [
            Line2D([], [], **{**look, "linestyle": "-", "label": "all vehicles, 90 % interval"}),
            Line2D([], [], **group_look, label=f"{groups_are} of {FEW_VEHICLES} vehicles or more"),
            Line2D([], [], color=INK, linestyle="--", label="as recorded"),
        ]
        legend_below(figure, handles, columns=3)


def approach_rows(result: Mapping) -> list[Mapping]:
    """Groups of a result by approach, each followed by its movements; none where no vehicle's approach is known.

    A movement's name is its approach's, a comma, and where it leads.
    """
    groups = result.get("groups", ())
    movements = [group for group in groups if group["by"] == MOVEMENT]
    rows = []
    for group in groups:
        if group["by"] == APPROACH:
            rows += [group, *(one for one in movements if one["name"].startswith(f"{group['name']}, "))]
    return rows


def plot_by_approach(path: str | Path, result: Mapping) -> None:
    """Draw the detectable share of each approach and of its movements, before and after, with 90 % intervals."""
    from matplotlib.lines import Line2D

    rows = approach_rows(result)
    looks = {"before": BASELINE_LOOK, "after": OPTIMISED_LOOK}
    names = dict(zip(looks, (name.lower() for name, *_ in sides(result)), strict=True))
    subtitle = f"{result['sensor']}, {gate_text(result)}; {judged_on(result)} frames"
    with sheet(path, 36.0 + 8.0 * len(rows), "Detectable vehicles by approach and movement", subtitle) as figure:
        axes = figure.subplots()
        for at, row in enumerate(rows):
            if at and row["by"] == APPROACH:
                axes.axhline(at - 0.5, color=FAINT, linewidth=0.8)
            for (key, look), shift in zip(looks.items(), (-0.17, 0.17), strict=True):
                if row[f"{key}_interval_90"]:
                    ends = [100.0 * end for end in row[f"{key}_interval_90"]]
                    line = {"color": look["color"], "linestyle": look["linestyle"], "linewidth": 1.4}
                    axes.plot(ends, [at + shift] * 2, clip_on=False, **line)
                axes.plot(100.0 * row[key], at + shift, clip_on=False, zorder=3, **{**look, "linestyle": "none"})
        texts = [row["name"] if row["by"] == APPROACH else row["name"].rpartition(", ")[2] for row in rows]
        boxes = [counted(row["boxes"], "box") for row in rows]
        axes.set(xlabel="Detectable share [%]", xlim=(0.0, 100.0), ylim=(len(rows) - 0.5, -0.5))
        axes.set_yticks(range(len(rows)), [f"{text} ({of})" for text, of in zip(texts, boxes, strict=True)])
        for label, row in zip(axes.get_yticklabels(), rows, strict=True):
            label.set_fontweight("bold" if row["by"] == APPROACH else "normal")
        axes.grid(visible=True, axis="x")
        handles = [Line2D([], [], **{**look, "label": f"{names[key]}, 90 % interval"}) for key, look in looks.items()]
        legend_below(figure, handles, columns=2)


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
        Patch(label="boxes (a vehicle in a frame)" + ("" if alike else " (baseline left)"), **solid),
        Patch(label=f"fewer than {FEWEST_VEHICLES}: not averaged", **hollow),
    ]
