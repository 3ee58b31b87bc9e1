"""The beam fan of a LiDAR: its beams from the side, and where they meet the road."""

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


def ground_distance_m(model: LidarModel, height_m: float = MOUNT_HEIGHT_M) -> np.ndarray:
    """Horizontal distance at which each ring of a level sensor meets the road, (r,) [m].

    It is inf for a ring that never does, or only beyond the sensor's maximum range.
    """
    fall = -np.sin(model.elevation_rad)
    slant = np.divide(height_m, fall, out=np.full(model.rings, np.inf), where=fall > 0.0)
    return np.where(slant <= model.range_max_m, slant, np.inf) * np.cos(model.elevation_rad)


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
