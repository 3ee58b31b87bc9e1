"""Chart: how far simulated scores are from real ones, by level of detail and by distance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..errors import InputError
from .canvas import INK, legend_below, sheet

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# Told apart in grey by lightness, and without any colour by the marker.
LOOKS = {
    "box": {"color": "#cf7f1b", "marker": "s", "markerfacecolor": "white"},
    "body": {"color": "#5b8fc7", "marker": "^"},
    "detailed": {"color": "#173f70", "marker": "o"},
}
_FEWEST = 5  # cars of a band that is drawn


@dataclass(frozen=True, slots=True)
class Series:
    """One variant of the simulation.

    Attributes
    ----------
    detail, losses : str
        Level of detail, and what is lost, in words.
    median, interval : float, (float, float) or None
        Median absolute error over all cars and its 90 % interval [bits].
    bands : sequence of (float, float)
        Distances [m].
    band_median, band_interval, band_cars : sequence
        The same for each band; None where it is empty.
    by_distance : bool
        Whether it is drawn by distance too.
    """

    detail: str
    losses: str
    median: float
    interval: Sequence[float] | None
    bands: Sequence[tuple[float, float]]
    band_median: Sequence[float | None]
    band_interval: Sequence[Sequence[float] | None]
    band_cars: Sequence[int]
    by_distance: bool


def plot_paired_errors(path: str | Path, series: Sequence[Series], *, title: str = "", subtitle: str = "") -> None:
    """Draw the median absolute error of every variant, and by distance that of one for each level.

    Raises
    ------
    InputError
        If there is no series.
    """
    if not series:
        raise InputError("paired errors: no series given; at least one is needed")
    with sheet(path, 96.0, title, subtitle) as figure:
        whole, bands = figure.subplots(1, 2, width_ratios=(1.15, 1.0))
        _draw_whole(whole, series)
        handles = _draw_bands(bands, [one for one in series if one.by_distance])
        legend_below(figure, handles, columns=len(handles))


def _draw_whole(axes: Axes, series: Sequence[Series]) -> None:
    for row, one in enumerate(series):
        low, high = one.interval or (one.median, one.median)
        look = LOOKS[one.detail]
        axes.plot([low, high], [row, row], color=look["color"], linewidth=1.6)
        axes.plot(one.median, row, linestyle="none", markersize=5.0, **look)
    axes.set_yticks(range(len(series)), [f"{one.detail}, {one.losses}" for one in series])
    axes.set_ylim(len(series) - 0.4, -0.6)
    axes.set_xlim(left=0.0)
    axes.set_xlabel("Median absolute error, 10 to 50 m [bits per car]")
    axes.grid(visible=True, axis="x")


def _draw_bands(axes: Axes, series: Sequence[Series]) -> list:
    handles = []
    for number, one in enumerate(series):
        look = LOOKS[one.detail]
        centre = np.array([0.5 * (low + high) for low, high in one.bands]) + 0.9 * (number - 0.5 * (len(series) - 1))
        drawn = [index for index, cars in enumerate(one.band_cars) if cars >= _FEWEST]
        for index in drawn:
            if one.band_interval[index] is not None:
                axes.plot([centre[index]] * 2, one.band_interval[index], color=look["color"], linewidth=1.6)
        handles += axes.plot(
            centre[drawn], [one.band_median[index] for index in drawn], markersize=5.0, label=one.detail, **look
        )
    bands, cars = series[0].bands, series[0].band_cars
    ticks = [0.5 * (low + high) for low, high in bands]
    texts = [f"{low:.0f}-{high:.0f} m\n{number} cars" for (low, high), number in zip(bands, cars, strict=True)]
    axes.set_xticks(ticks, texts, color=INK)
    axes.set_ylim(bottom=0.0)
    axes.set_ylabel("Median absolute error [bits per car]")
    axes.set_title(f"By distance: {series[0].losses}")
    axes.grid(visible=True, axis="y")
    return handles
