"""Chart: detectable share and mean score by distance, before and after."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from ..metrics.metric import Metric
from ..metrics.views import PE_VGOP
from .binning import Bands, band_count, columns, distance_bands
from .canvas import BASELINE, FAINT, INK, OPTIMISED, legend_below, say_empty, sheet

if TYPE_CHECKING:
    from matplotlib.axes import Axes

FEWEST_VEHICLES = 5  # below this a band's average says little, and is not drawn


def plot_by_distance(
    path: str | Path,
    baseline_table: Mapping[str, ArrayLike],
    optimised_table: Mapping[str, ArrayLike],
    band_m: float = 10.0,
    *,
    metric: Metric = PE_VGOP,
    column: str = "entropy_bits",
    names: tuple[str, str] = ("Baseline", "Optimised"),
    title: str = "",
    subtitle: str = "",
) -> None:
    """Draw the detectable share, the mean score and the number of vehicles by distance band.

    Parameters
    ----------
    path : str or Path
        The PNG to write.
    baseline_table, optimised_table : mapping of str to array_like, (n,)
        Columns ``distance_m``, ``detectable`` and `column` of vehicles.csv under each mounting.
    band_m : float
        Width of a band [m].
    metric : Metric
        What scores the vehicles.
    column : str
        Where its values are.
    names : tuple of str
        What to call the two mountings.
    title, subtitle : str
        Headings.

    Raises
    ------
    InputError
        If a column is missing, not numeric or of another length.
    """
    needed = ("distance_m", "detectable", column)
    tables = [
        columns(table, needed, f"{name} vehicles", may_be_nan=(column,))
        for name, table in (("baseline", baseline_table), ("optimised", optimised_table))
    ]
    number = band_count(np.concatenate([table["distance_m"] for table in tables]), band_m)
    before, after = (distance_bands(*(table[name] for name in needed), band_m, number) for table in tables)
    with sheet(path, 140.0, title, subtitle) as figure:
        share, score, count = figure.subplots(3, 1, sharex=True, height_ratios=(3, 3, 1.4))
        if not (before.count.any() or after.count.any()):
            say_empty(share, "no vehicles")
            say_empty(score, "no vehicles")
        handles = []
        for bands, style, name in zip((before, after), (BASELINE, OPTIMISED), names, strict=True):
            line = {**style, "label": name.lower()}
            drawn = bands.count >= FEWEST_VEHICLES
            handles += share.plot(
                bands.centre_m, np.where(drawn, 100.0 * bands.detectable_share, np.nan), clip_on=False, zorder=3, **line
            )
            score.plot(bands.centre_m, np.where(drawn, bands.score, np.nan), clip_on=False, zorder=3, **line)
        share.set_ylabel("Detectable share [%]")
        share.set_ylim(0.0, 100.0)
        score.set_ylabel(f"Mean {metric.label}\n{_in_brackets(metric)}".rstrip())
        if not any((bands.score < 0.0).any() for bands in (before, after)):
            score.set_ylim(bottom=0.0)
        handles += _draw_counts(count, before, after, band_m)
        count.set_ylabel("Vehicles\n[number]")
        count.set_xlabel("Horizontal distance from the LiDAR [m]")
        count.set_ylim(bottom=0.0)
        count.yaxis.get_major_locator().set_params(integer=True)
        count.set_xlim(0.0, number * band_m)
        for axes in (share, score, count):
            axes.grid(visible=True)
        figure.align_ylabels()
        legend_below(figure, handles, columns=len(handles))


def _in_brackets(metric: Metric) -> str:
    """A metric's unit, and that lower is better where it is."""
    said = [*([metric.unit] if metric.unit else []), *([] if metric.higher_is_better else ["lower is better"])]
    return f"[{', '.join(said)}]" if said else ""


def _draw_counts(axes: Axes, before: Bands, after: Bands, band_m: float) -> list[object]:
    """A bar per band, or a pair where the tables differ, hollow if it is not averaged; returns the legend's entries."""
    from matplotlib.patches import Patch

    solid = {"facecolor": FAINT, "edgecolor": INK, "linewidth": 0.6}
    hollow = {**solid, "facecolor": "none"}
    if np.array_equal(before.count, after.count):
        groups = [(before, 0.0, 0.8)]
    else:
        groups = [(before, -0.2, 0.4), (after, 0.2, 0.4)]
    for bands, shift, width in groups:
        for chosen, look in ((bands.count >= FEWEST_VEHICLES, solid), (bands.count < FEWEST_VEHICLES, hollow)):
            axes.bar((bands.centre_m + shift * band_m)[chosen], bands.count[chosen], width * band_m, **look)
    return [
        Patch(label="vehicles, over all frames" + (" (baseline left)" if len(groups) > 1 else ""), **solid),
        Patch(label=f"fewer than {FEWEST_VEHICLES}: not averaged", **hollow),
    ]
