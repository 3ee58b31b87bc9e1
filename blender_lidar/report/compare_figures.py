"""Pictures of a comparison with reality: metrics beside detectors, and simulated scores beside real ones."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..studies.compare.detections import IN_RANGE, PERFORMANCE
from ..studies.compare.detectors import Decline, Findings, Scatter, decline, scatter
from ..studies.compare.paired import PICTURED, RETURN_LOSSES, PairedCars, PicturedCar
from ..studies.compare.paired_findings import judging
from ..studies.compare.resampling import FEWEST_IN_BAND
from .figure import (
    BASELINE_LOOK,
    FAINT,
    HEIGHT_COLOURS,
    INK,
    OPTIMISED_LOOK,
    SMALL_PT,
    colours,
    legend_below,
    sheet,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# --- Metrics beside detectors -----------------------------------------------------------------------------------------

_BAND_M = 10.0
_COLUMNS = 4
_DOTS = {"linestyle": "none", "marker": ".", "markersize": 2.2, "color": FAINT, "zorder": 1}
_METRIC = {"color": OPTIMISED_LOOK["color"], "linestyle": "-", "marker": "o", "markersize": 3.0}
_DETECTORS = (
    {"color": BASELINE_LOOK["color"], "linestyle": "--", "marker": "s", "markersize": 3.0, "markerfacecolor": "white"},
    {"color": INK, "linestyle": ":", "marker": "^", "markersize": 3.0, "markerfacecolor": "white"},
)


def draw_detections(findings: Findings, folder: Path) -> list[str]:
    """Draw the paper's Figs. 5 and 6 for the cars of the main set; returns the names of the files.

    Raises
    ------
    MissingExtraError
        When matplotlib is not installed.
    """
    mine, cars = findings.sets[findings.main], findings.judged
    about = f"{findings.main}: {int(mine.sum())} cars"
    detectors = [
        decline(cars, f"{name}: confidence x IoU", cars[name + PERFORMANCE], mine & cars[name + IN_RANGE], _BAND_M)
        for name in cars.detectors[:2]
    ]
    metrics = [decline(cars, one.name, one.merit(cars[one.name]), mine, _BAND_M) for one in cars.metrics]
    names = []
    if any(metrics):
        names.append("by_distance.png")
        plot_declines(
            folder / names[0],
            [one for one in metrics if one is not None],
            [one for one in detectors if one is not None],
            title="Fig. 5: metrics and detectors over distance",
            subtitle=f"{about}, means over {_BAND_M:g} m with at least {FEWEST_IN_BAND} cars, 90 % intervals; metrics "
            "that are good when low are turned over",
        )
    for detector in cars.detectors:
        panels = scatter(findings, detector)
        if panels:
            stem = "against_" + re.sub(r"[^A-Za-z0-9._-]+", "_", detector)  # as far as file systems allow
            names.append(f"{stem}.png" if f"{stem}.png" not in names else f"{stem}_{len(names)}.png")
            plot_against(
                folder / names[-1],
                panels,
                title=f"Fig. 6: metrics against {detector}, car by car",
                subtitle=f"{about}, those in its range; missed cars at 0; Spearman's correlation with 90 % interval",
            )
    return names


def plot_declines(
    path: str | Path, metrics: Sequence[Decline], detectors: Sequence[Decline], *, title: str = "", subtitle: str = ""
) -> None:
    """Draw each metric over distance in a panel of its own, with the performance of up to two detectors.

    Parameters
    ----------
    path : str or Path
        The PNG to write.
    metrics, detectors : sequence of Decline
    title, subtitle : str
        Headings.
    """
    with _panels(path, len(metrics), title, subtitle) as (figure, panels):
        for axes, one in zip(panels, metrics, strict=True):
            dots = axes.plot(one.distance_m, one.values, label="the metric, one car", **_DOTS)
            lines = [_with_interval(axes, one, _METRIC, "the panel's metric, mean and 90 % interval")]
            for detector, look in zip(detectors, _DETECTORS, strict=False):
                lines.append(_with_interval(axes, detector, look, detector.name))
            axes.set_title(one.name, fontsize=SMALL_PT)
            axes.set_ylim(-0.35, 1.6)
            axes.set_xlim(left=0.0)
            axes.grid(visible=True)
        for axes in panels[-_COLUMNS:]:  # those with none below
            axes.set_xlabel("Distance [m]")
        figure.supylabel("Scaled: lowest mean of a band 0, highest 1", fontsize=8.0)
        legend_below(figure, [lines[0], *dots, *lines[1:]], columns=2)


def plot_against(path: str | Path, metrics: Sequence[Scatter], *, title: str = "", subtitle: str = "") -> None:
    """Draw the performance over each metric, a dot for each car, with the isotonic regression.

    Parameters
    ----------
    path : str or Path
        The PNG to write.
    metrics : sequence of Scatter
        A panel each.
    title, subtitle : str
        Headings.
    """
    look = {**_DOTS, "markersize": 3.0, "color": BASELINE_LOOK["color"], "alpha": 0.55}
    with _panels(path, len(metrics), title, subtitle) as (figure, panels):
        for axes, one in zip(panels, metrics, strict=True):
            dots = axes.plot(one.values, one.performance, label="one car", **look)
            curve = axes.plot(*one.curve, color=OPTIMISED_LOOK["color"], label="rising curve that fits best", zorder=3)
            axes.text(0.97, 0.96, one.note, transform=axes.transAxes, ha="right", va="top", fontsize=6.5)
            axes.set_title(one.name, fontsize=SMALL_PT)
            axes.set_xlabel(f"[{one.unit}]" if one.unit else "", fontsize=SMALL_PT, labelpad=1.0)
            axes.set_ylim(-0.03, 1.22)  # room for the note above what performance can be
            axes.grid(visible=True)
            axes.xaxis.get_major_locator().set_params(nbins=4)
        figure.supylabel("Confidence x IoU", fontsize=8.0)
        legend_below(figure, [*dots, *curve], columns=2)


@contextmanager
def _panels(path: str | Path, number: int, title: str, subtitle: str) -> Iterator[tuple[Figure, list[Axes]]]:
    """A sheet with so many axes in rows of four."""
    rows = -(-number // _COLUMNS)
    with sheet(path, 32.0 + 40.0 * rows, title, subtitle) as figure:
        grid = figure.subplots(rows, _COLUMNS, squeeze=False, sharey=True).ravel().tolist()
        for axes in grid[number:]:
            axes.remove()
        yield figure, grid[:number]


def _with_interval(axes: Axes, one: Decline, look: dict, label: str) -> object:
    """The means as a line in front of their intervals; returns the legend's entry."""
    axes.fill_between(one.centre_m, one.low, one.high, color=look["color"], alpha=0.18, linewidth=0.0, zorder=2)
    return axes.plot(one.centre_m, one.mean, label=label, linewidth=1.2, zorder=3, **look)[0]


# --- Simulated beside real scores -------------------------------------------------------------------------------------

_CAR_MM = 50.0  # of height for one car from two sides
_EDGE_M = 0.3  # about a car
_FEWEST = 5  # cars of a band, or rays in a cell, that is drawn
_CELLS = (30, 8), (15, 8)  # along or across the box, and upwards
_MEDIANS = {
    "reduce_C_function": np.median,
    "mincnt": _FEWEST,
    "extent": (0.0, 100.0, 0.0, 100.0),
    "cmap": "PuOr",
    "vmin": -0.3,
    "vmax": 0.3,
}
# Told apart in grey by lightness, and without any colour by the marker.
_LOOKS = {
    "box": {"color": "#cf7f1b", "marker": "s", "markerfacecolor": "white"},
    "body": {"color": "#5b8fc7", "marker": "^"},
    "detailed": {"color": "#173f70", "marker": "o"},
}


def draw_paired(paired: PairedCars, result: Mapping, folder: Path) -> list[str]:
    """Draw errors, scores, two cars and residuals; returns the names of the files.

    Parameters
    ----------
    paired : PairedCars
    result : mapping
        What `paired.json` holds.
    folder : Path

    Raises
    ------
    MissingExtraError
        When matplotlib is not installed.
    """
    of = result["sets"][judging(result["sets"])]
    lost = f"{RETURN_LOSSES[PICTURED]} lost"
    title = "Error of simulated PE-VGOP against a real LiDAR's"
    about = f"{of['cars']} cars in {of['frames']} real sweeps, ray by ray; bars: 90 % of resampled "
    with sheet(folder / "error.png", 96.0, title, f"{about}{of['resampled']['unit']}s") as figure:
        whole, bands = figure.subplots(1, 2, width_ratios=(1.15, 1.0))
        _draw_errors(whole, of["variants"])
        handles = _draw_bands(bands, [one for one in of["variants"] if one["losses"] == PICTURED])
        legend_below(figure, handles, columns=len(handles))
    title = "PE-VGOP of each car, simulated against real"
    with sheet(folder / "scores.png", 80.0, title, f"all {len(paired)} cars; {lost}") as figure:
        _draw_scores(figure, paired)
    _plot_cars(folder / "cars.png", paired.pictured, f"{lost}; from the side and from above, with the label's box")
    title, height = "Real less simulated range over the car", 30.0 + 40.0 * len(paired.residuals)
    about = "median of the rays that hit in both, all cars laid over one another; nothing lost"
    with sheet(folder / "residuals.png", height, title, about) as figure:
        _draw_residuals(figure, paired.residuals)
    return ["error.png", "scores.png", "cars.png", "residuals.png"]


def _draw_errors(axes: Axes, variants: Sequence[Mapping]) -> None:
    """The median absolute error of every variant with its interval."""
    for row, one in enumerate(variants):
        error, look = one["absolute_error_bits"], _LOOKS[one["detail"]]
        axes.plot(error["interval_90"] or [error["median"]] * 2, [row, row], color=look["color"], linewidth=1.6)
        axes.plot(error["median"], row, linestyle="none", markersize=5.0, **look)
    axes.set_yticks(range(len(variants)), [f"{one['detail']}, {RETURN_LOSSES[one['losses']]}" for one in variants])
    axes.set_ylim(len(variants) - 0.4, -0.6)
    axes.set_xlim(left=0.0)
    axes.set_xlabel("Median absolute error, 10 to 50 m [bits per car]")
    axes.grid(visible=True, axis="x")


def _draw_bands(axes: Axes, variants: Sequence[Mapping]) -> list:
    """The median absolute error of some variants by distance; returns the legend's entries."""
    handles = []
    bands = variants[0]["by_distance"]
    centre = np.array([0.5 * (band["low_m"] + band["high_m"]) for band in bands])
    drawn = [index for index, band in enumerate(bands) if band["cars"] >= _FEWEST]
    for number, one in enumerate(variants):
        look, x = _LOOKS[one["detail"]], centre[drawn] + 0.9 * (number - 0.5 * (len(variants) - 1))
        errors = [one["by_distance"][index]["absolute_error_bits"] for index in drawn]
        for at, error in zip(x, errors, strict=True):
            axes.plot([at] * 2, error["interval_90"] or [error["median"]] * 2, color=look["color"], linewidth=1.6)
        handles += axes.plot(x, [error["median"] for error in errors], markersize=5.0, label=one["detail"], **look)
    texts = [f"{band['low_m']:.0f}-{band['high_m']:.0f} m\n{band['cars']} cars" for band in bands]
    axes.set_xticks(centre, texts, color=INK)
    axes.set_ylim(bottom=0.0)
    axes.set_ylabel("Median absolute error [bits per car]")
    axes.set_title(f"By distance: {RETURN_LOSSES[variants[0]['losses']]}")
    axes.grid(visible=True, axis="y")
    return handles


def _draw_scores(figure: Figure, paired: PairedCars) -> None:
    """Every car's simulated PE-VGOP over its real one, a panel for each level of detail."""
    real, simulated = paired["real_entropy_bits"][0], paired["simulated_entropy_bits"]
    drawn = [row for row, way in enumerate(paired.variants) if way.losses == PICTURED]
    panels = figure.subplots(1, len(drawn), sharex=True, sharey=True, squeeze=False)[0]
    top = 1.05 * max(real.max(), simulated[drawn].max(), 0.1)
    look = {"s": 9.0, "linewidths": 0.0, "cmap": colours(HEIGHT_COLOURS), "vmin": 10.0, "vmax": 50.0}
    for axes, row in zip(panels, drawn, strict=True):
        axes.plot([0.0, top], [0.0, top], color=INK, linewidth=0.8)
        dots = axes.scatter(real, simulated[row], c=paired["distance_m"][row], **look)
        axes.set(aspect="equal", xlim=(0.0, top), ylim=(0.0, top))
        axes.set_title(f"{paired.variants[row].detail}: median error {np.median(np.abs(simulated[row] - real)):.3f}")
        axes.grid(visible=True)
    panels[len(panels) // 2].set_xlabel("Real PE-VGOP [bits]")
    panels[0].set_ylabel("Simulated PE-VGOP [bits]")
    figure.colorbar(dots, ax=list(panels), label="Distance [m]", pad=0.02)


def _plot_cars(path: Path, cars: Sequence[PicturedCar], subtitle: str) -> None:
    """Draw cars to one scale from the side and from above: what they gave in reality, and what our shapes give."""
    columns = 1 + max(len(one.simulated) for one in cars)
    height = 20.0 + _CAR_MM * len(cars)
    with sheet(path, height, "The same rays in reality and against shapes", subtitle) as figure:
        panels = figure.subplots(2 * len(cars), columns, squeeze=False, sharex=True, sharey="row")
        for one, views in zip(cars, panels.reshape(len(cars), 2, columns), strict=True):
            for column, (kind, points) in enumerate({"real": one.real, **one.simulated}.items()):
                for axes, up in zip(views[:, column], (2, 1), strict=True):
                    _draw_car(axes, points, one.size_m, up)
                views[0, column].set_title(f"{kind}: {len(points):,} points")
            views[0, 0].set_title(f"Frame {one.frame}, label {one.label_line}\nreal: {len(one.real):,} points")
            views[0, 0].set_ylabel("z [m]")
            views[1, 0].set_ylabel("y [m]")
        for axes in panels[-1]:
            axes.set_xlabel("x [m], forward")


def _draw_car(axes: Axes, points: np.ndarray, size_m: np.ndarray, up: int) -> None:
    """Points of a car over x and the axis `up`, with its box."""
    (x, y), (far_x, far_y) = 0.5 * size_m[[0, up]], 0.5 * size_m[[0, up]] + _EDGE_M
    axes.plot([-x, x, x, -x, -x], [-y, -y, y, y, -y], color=INK, linewidth=0.7)
    axes.plot(points[:, 0], points[:, up], ".", color="#173f70", markersize=1.6, markeredgewidth=0.0)
    axes.set(aspect="equal", xlim=(-far_x, far_x), ylim=(-far_y, far_y))


def _draw_residuals(figure: Figure, residuals: Mapping[str, np.ndarray]) -> None:
    """The median residual over the car, from the side and from an end, a row for each level of detail."""
    panels = figure.subplots(len(residuals), 2, squeeze=False, width_ratios=(2.6, 1.2), sharex="col", sharey=True)
    for row, (detail, values) in zip(panels, residuals.items(), strict=True):
        percent = 100.0 * (values[:, :3] + 0.5)  # of the unit box
        for across, axes in enumerate(row):
            cells = axes.hexbin(percent[:, across], percent[:, 2], values[:, 3], gridsize=_CELLS[across], **_MEDIANS)
            axes.set(facecolor="#e8e8e8", xlim=(0.0, 100.0), ylim=(0.0, 100.0))
        off = np.median(np.abs(values[:, 3])) if len(values) else np.nan
        row[0].set_title(f"{detail}: median |residual| {off:.3f} m")
        row[0].set_ylabel("Height in the box [%]")
    panels[-1][0].set_xlabel("Along the box, tail to nose [%]")
    panels[-1][1].set_xlabel("Across the box, right to left [%]")
    label = "Real less simulated range [m]"
    figure.colorbar(cells, ax=panels.ravel().tolist(), label=label, pad=0.02, extend="both")
