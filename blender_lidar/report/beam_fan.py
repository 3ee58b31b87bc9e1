"""The beam fan of a LiDAR: where its beams meet the road, as text for a terminal and as a chart."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..sensors.model import LidarModel
from .figure import FAINT, INK, sheet

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MOUNT_HEIGHT_M = 4.0
FAN_REACH_M = 100.0
_TOP_M = 6.0  # the picture's upper edge
_BAND_M = 20.0

# Of the text picture: a cell for each 0.5 m of height and 1.25 m of distance, those of the edges halfway beyond them.
_UP_M = np.arange(-0.25, _TOP_M + 0.5, 0.5)
_ALONG_M = np.arange(-0.625, FAN_REACH_M + 1.25, 1.25)
_TICKS = range(0, int(FAN_REACH_M), 10)  # [m], each 8 cells wide
_SHADES = " .:+#"  # by the beams in a cell
_SHADE_FROM = (1, 2, 4, 8)


def ground_distance_m(model: LidarModel, height_m: float = MOUNT_HEIGHT_M) -> np.ndarray:
    """Horizontal distance at which each ring of a level sensor meets the road, (r,) [m].

    It is inf for a ring that never does, or only beyond the sensor's maximum range.
    """
    fall = -np.sin(model.elevation_rad)
    slant = np.divide(height_m, fall, out=np.full(model.rings, np.inf), where=fall > 0.0)
    return np.where(slant <= model.range_max_m, slant, np.inf) * np.cos(model.elevation_rad)


def fan_text(model: LidarModel) -> str:
    """Side view of a level sensor's beams at 4 m, 100 m far, and where they meet the road; within 100 characters.

    The more beams cross a character's cell, the darker it is: ``.`` one, ``:`` from two, ``+`` from four, ``#`` from
    eight.
    """
    way = np.linspace(0.0, 1.0, 4 * len(_ALONG_M))
    beams = ((MOUNT_HEIGHT_M + (up - MOUNT_HEIGHT_M) * way, along * way) for along, up in _ends_m(model))
    crossings = sum((np.histogram2d(*beam, (_UP_M, _ALONG_M))[0] > 0).astype(int) for beam in beams)
    shades = np.array(list(_SHADES))[np.searchsorted(_SHADE_FROM, crossings, side="right")]
    lines = []
    for height, shade in zip(_UP_M[:0:-1] - 0.25, shades[::-1], strict=True):
        label = f"{height:.0f} m" if height == int(height) else ""
        lines.append(f"{label:>6} |{''.join(shade)}".rstrip())
    distance = ground_distance_m(model)
    landings, _ = np.histogram(distance[distance <= FAN_REACH_M], _ALONG_M)
    marks = "".join(" " if count == 0 else str(count) if count < 10 else "*" for count in landings)
    ruler, labels = "+-------" * len(_TICKS), "".join(f"{tick:<8}" for tick in _TICKS)
    lines += [f"{'rings':>6} |{marks}".rstrip(), f"{'':6} +{ruler}+", f"{'':6}  {labels}{FAN_REACH_M:.0f} m", ""]
    return "\n".join([*lines, _bands(distance)])


def plot_beam_fan(model: LidarModel, path: str | Path) -> None:
    """Draw a sensor's beams from the side, and where they meet the road.

    Parameters
    ----------
    model : LidarModel
        The sensor, drawn level at 4 m.
    path : str or Path
        The PNG to write; an existing file is replaced.

    Errors as `figure.sheet`.
    """
    low, high = np.degrees(model.elevation_rad[[0, -1]])
    subtitle = (
        f"{model.rings} rings, {low:+.4g} to {high:+.4g} degrees, {model.columns()} columns a turn at "
        f"{model.default_rotation_hz:g} Hz, {model.range_min_m:g} to {model.range_max_m:g} m"
    )
    with sheet(path, 80.0, f"{model.name}: beam fan", subtitle) as figure:
        _draw_side(figure.add_subplot(), model)


def _ends_m(model: LidarModel) -> np.ndarray:
    """Where each beam leaves the picture or reaches the sensor's range: distance and height, (r, 2) [m]."""
    along, up = np.cos(model.elevation_rad), np.sin(model.elevation_rad)
    room = np.where(up < 0.0, MOUNT_HEIGHT_M, _TOP_M - MOUNT_HEIGHT_M)
    with np.errstate(divide="ignore"):  # a level beam reaches neither edge
        length = np.minimum(model.range_max_m, np.minimum(FAN_REACH_M / along, room / np.abs(up)))
    return np.stack([length * along, MOUNT_HEIGHT_M + length * up], axis=1)


def _bands(distance_m: np.ndarray) -> str:
    """How many rings meet the road in each band of 20 m."""
    edges = np.arange(0.0, FAN_REACH_M + _BAND_M, _BAND_M)
    counts, _ = np.histogram(distance_m[distance_m <= FAN_REACH_M], edges)
    parts = [f"{low:.0f}-{low + _BAND_M:.0f} m {count}" for low, count in zip(edges, counts, strict=False)]
    unseen = int(np.isinf(distance_m).sum())
    parts.append(f"further {len(distance_m) - int(counts.sum()) - unseen}")
    return f"Rings that meet the road: {', '.join(parts)}\nRings that never do, or out of the sensor's range: {unseen}"


def _draw_side(axes: Axes, model: LidarModel) -> None:
    """The beams from the side, those that meet the road dark."""
    distance = ground_distance_m(model)
    lands = distance <= FAN_REACH_M
    for (end_distance, end_height), dark in zip(_ends_m(model), lands, strict=True):
        look = {"color": INK, "linewidth": 0.7} if dark else {"color": FAINT, "linewidth": 0.5}
        axes.plot([0.0, end_distance], [MOUNT_HEIGHT_M, end_height], **look)
    for landing in distance[lands]:
        axes.plot(landing, 0.0, "|", color=INK, markersize=7.0, clip_on=False)
    axes.axhline(0.0, color=INK, linewidth=1.0)
    axes.plot(0.0, MOUNT_HEIGHT_M, "^", color="white", markeredgecolor="black", markersize=8.0, clip_on=False, zorder=5)
    axes.set(
        xlim=(0.0, FAN_REACH_M),
        ylim=(-0.25, _TOP_M),
        xlabel="Distance from the mount [m]",
        ylabel="Height above the road [m]",
        title=f"Level at {MOUNT_HEIGHT_M:g} m, heights stretched: {lands.sum()} of {model.rings} rings (dark) meet the "
        f"road within {FAN_REACH_M:g} m",
    )
