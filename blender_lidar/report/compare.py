"""A comparison of recorded clouds with their simulation: a table and a verdict for a terminal, and one picture."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..statistics import FEWEST_BLOCKS
from .figure import FAINT, HEIGHT_COLOURS, INK, colours, sheet
from .text import text_table

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_HEAD = ("", "vehicles", "points", "simulated", "PE-VGOP", "error (90 % interval)", "bias")
_FEWEST = 5  # vehicles of a band that is drawn
_HEIGHT_MM = 95.0
# They differ in lightness where print is grey, and in the marker without any colour.
_LOOKS = {
    "box": {"color": "#cf7f1b", "marker": "s", "markerfacecolor": "white"},
    "body": {"color": "#5b8fc7", "marker": "^"},
    "detailed": {"color": "#173f70", "marker": "o"},
}
_LINES = "-", "--", ":", "-."  # by the losses


def comparison_text(result: Mapping) -> str:
    """The findings for a terminal; `result` as `compare.json` has it."""
    left_out = ", ".join(f"{count} {reason}" for reason, count in result["left_out"].items() if count)
    on_rings, rows = 100.0 * result["beams"]["share_on_rings"], [_HEAD]
    for one in result["variants"]:
        rows.append((_variant(one, result), *_cells(one)))
        rows += [(f"  {_band(band)}", *_cells(band)) for band in one["by_distance"]]
    lines = [
        f"Vehicles   {result['vehicles']} in {result['frames']} of {result['clouds']} clouds"
        + (f"; left out: {left_out}" if left_out else ""),
        f"Beams      {result['sensor']}: {on_rings:.0f} % of the points are on its rings (by chance 50 %)",
        f"Simulated  {result['caster']}; lost: {'; '.join(result['losses'])}",
        "",
        "Points of all vehicles, PE-VGOP of the median vehicle, and by how much the simulated one differs from the",
        "real one: median absolute error with its interval, and median difference [bits]",
        *text_table(rows),
        "",
        _intervals(result),
    ]
    return "\n".join(lines)


def _variant(one: Mapping, result: Mapping) -> str:
    """The name of a level of detail, with its losses where there are several."""
    return one["detail"] if len(result["losses"]) == 1 else f"{one['detail']}, lost: {one['losses']}"


def _cells(one: Mapping) -> tuple[str, ...]:
    error, points = one["absolute_error_bits"], one["points"]
    ends = error["interval_90"]
    return (
        str(one["vehicles"]),
        f"{points['real']:,}",
        f"{points['simulated']:,}",
        f"{one['real_entropy_bits']:.3f}",
        f"{error['median']:.3f}" + (f" ({ends[0]:.3f} to {ends[1]:.3f})" if ends else ""),
        f"{one['bias_bits']['median']:+.3f}",
    )


def _band(band: Mapping) -> str:
    low, high = band["low_m"], band["high_m"]
    return f"beyond {low:.0f} m" if high is None else f"{low:.0f} to {high:.0f} m"


def _intervals(result: Mapping) -> str:
    if result["resampled"] == "frame":
        return (
            f"Intervals resample the {result['frames']} clouds. They are too narrow where several clouds show the same "
            "vehicles."
        )
    if result["vehicles"] < FEWEST_BLOCKS:
        return f"With fewer than {FEWEST_BLOCKS} vehicles there is no interval."
    return "Intervals resample single vehicles: they leave out what all vehicles share, such as weather and mounting."


def draw_comparison(path: Path, table: Mapping[str, np.ndarray], result: Mapping) -> None:
    """Draw the error by distance, and each vehicle's simulated PE-VGOP over its real one.

    Parameters
    ----------
    path : Path
        The PNG to write.
    table : mapping of str to ndarray
        As `studies.compare.CloudComparison` has it.
    result : mapping
        As `compare.json` has it.

    Raises
    ------
    MissingExtraError
        When matplotlib is not installed.
    """
    variants = result["variants"]
    subtitle = f"{result['vehicles']} vehicles in {result['frames']} clouds; lost: {'; '.join(result['losses'])}"
    with sheet(path, _HEIGHT_MM, "Recorded vehicles beside their simulation", subtitle) as figure:
        by_distance, scores = figure.subplots(1, 2)
        _draw_bands(by_distance, result)
        first = next((one for one in variants if one["detail"] == "body"), variants[0])
        shown = np.logical_and(*(table[key] == first[key] for key in ("detail", "losses")))
        mine = {name: column[shown] for name, column in table.items()}
        real, simulated = mine["real_entropy_bits"], mine["simulated_entropy_bits"]
        top = 1.05 * max(real.max(), simulated.max(), 0.1)
        scores.plot([0.0, top], [0.0, top], color=INK, linewidth=0.8)
        look = {"s": 9.0, "linewidths": 0.0, "cmap": colours(HEIGHT_COLOURS)}
        dots = scores.scatter(real, simulated, c=mine["distance_m"], **look)
        scores.set(aspect="equal", xlim=(0.0, top), ylim=(0.0, top))
        scores.set(
            xlabel="Real PE-VGOP [bits]",
            ylabel="Simulated PE-VGOP [bits]",
            title=f"Each vehicle, {_variant(first, result)}",
        )
        scores.grid(visible=True)
        figure.colorbar(dots, ax=scores, label="Distance [m]", shrink=0.8)


def _draw_bands(axes: Axes, result: Mapping) -> None:
    """The median absolute error of each variant by distance, where there are enough vehicles."""
    variants = result["variants"]
    bands = variants[0]["by_distance"]
    drawn = [row for row, band in enumerate(bands) if band["vehicles"] >= _FEWEST]
    for number, one in enumerate(variants):
        look = {**_LOOKS[one["detail"]], "linestyle": _LINES[result["losses"].index(one["losses"]) % len(_LINES)]}
        x = np.array(drawn) + 0.12 * (number - 0.5 * (len(variants) - 1))
        errors = [one["by_distance"][row]["absolute_error_bits"] for row in drawn]
        for at, error in zip(x, errors, strict=True):
            axes.plot([at] * 2, error["interval_90"] or [error["median"]] * 2, color=look["color"], linewidth=1.6)
        axes.plot(x, [error["median"] for error in errors], markersize=5.0, label=_variant(one, result), **look)
    texts = [f"{_band(band).removesuffix(' m')}\n{band['vehicles']}" for band in bands]
    axes.set_xticks(range(len(bands)), texts, color=INK, fontsize=6.5)
    axes.set_ylim(bottom=0.0)
    axes.set(xlabel="Distance [m], and vehicles", ylabel="Median absolute error [bits]", title="PE-VGOP, by distance")
    axes.grid(visible=True, axis="y")
    if drawn:
        axes.legend(fontsize=6.5)
    else:
        axes.text(0.5, 0.5, f"fewer than {_FEWEST} in each band", transform=axes.transAxes, ha="center", color=FAINT)
