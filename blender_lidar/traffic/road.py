"""Where the road frame lies in a recording's own coordinates."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

import numpy as np

from ..errors import InputError


@dataclass(frozen=True, slots=True)
class RoadFrame:
    """The road frame beside a carriageway: x in the direction of travel, y to the left, the LiDAR at y <= 0.

    The defaults are I-80's: past the on-ramp, whose acceleration lane ends at Local_Y 202 m.

    Attributes
    ----------
    station_m : float
        Local_Y of x = 0 [m].
    right_edge_m : float
        Local_X of the carriageway's right edge [m]; 72 ft on I-80.
    setback_m : float
        From the line y = 0 to that edge [m].
    lanes : int
        Lanes of the carriageway.
    lane_width_m : float
        Width of one lane [m].

    Raises
    ------
    InputError
        For a number that is not finite, a width that is not positive, or less than one lane.
    """

    station_m: float = 250.0
    right_edge_m: float = 21.9456
    setback_m: float = 2.0
    lanes: int = 6
    lane_width_m: float = 3.66

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if not math.isfinite(value):
                raise InputError(f"road: {field.name} is {value}; a finite number is needed")
        if self.lanes < 1 or self.lanes != int(self.lanes):
            raise InputError(f"road: lanes is {self.lanes}; a whole number, at least 1, is needed")
        if self.lane_width_m <= 0:
            raise InputError(f"road: lane_width_m is {self.lane_width_m}; more than 0 is needed")

    @property
    def carriageway_y(self) -> tuple[float, float]:
        """The y [m] of the carriageway's right and left edge."""
        return self.setback_m, self.setback_m + self.lanes * self.lane_width_m

    def from_local(self, local_m: np.ndarray) -> np.ndarray:
        """NGSIM's local coordinates to the road frame.

        Parameters
        ----------
        local_m : ndarray, (n, 2)
            Local_X (to the right, from the left edge) and Local_Y (along travel) [m].

        Returns
        -------
        ndarray, (n, 2)
            x and y [m, road frame].
        """
        local_m = np.asarray(local_m, dtype=np.float64)
        return np.stack(
            [local_m[:, 1] - self.station_m, self.setback_m + (self.right_edge_m - local_m[:, 0])],
            axis=1,
        )


@dataclass(frozen=True, slots=True)
class Placing:
    """Where the road frame lies in the plane coordinates of a table or a net.

    Attributes
    ----------
    origin_m : (float, float)
        The road frame's origin [m, the file's frame].
    heading_deg : float
        Direction of the road's x axis in the file's frame [degrees], counter-clockwise.

    Raises
    ------
    InputError
        For a number that is not finite.
    """

    origin_m: tuple[float, float] = (0.0, 0.0)
    heading_deg: float = 0.0

    def __post_init__(self) -> None:
        if len(self.origin_m) != 2 or not all(math.isfinite(value) for value in self.origin_m):
            raise InputError(f"origin_m is {self.origin_m!r}; two finite numbers are needed")
        if not math.isfinite(self.heading_deg):
            raise InputError(f"heading_deg is {self.heading_deg}; a finite number is needed")

    def points(self, xy_m: np.ndarray) -> np.ndarray:
        """Points of the file's frame, (n, 2) [m], in the road frame."""
        turn = math.radians(self.heading_deg)
        x, y = (np.asarray(xy_m, dtype=np.float64) - self.origin_m).T
        along = x * math.cos(turn) + y * math.sin(turn)
        across = y * math.cos(turn) - x * math.sin(turn)
        return np.stack([along, across], axis=1)

    def headings(self, heading_rad: np.ndarray) -> np.ndarray:
        """Headings from the file's +x, (n,) [rad], as headings from the road's, within half a turn."""
        turned = heading_rad - math.radians(self.heading_deg)
        return np.arctan2(np.sin(turned), np.cos(turned))


def within_x(centre_m: np.ndarray, x_range_m: tuple[float, float] | None, source: str) -> np.ndarray:
    """Which of the box centres, (n, 3) [m, road frame], have their x in a range, (n,) bool; all without a range.

    Raises
    ------
    InputError
        If none has; `source` says in which file.
    """
    if x_range_m is None:
        return np.ones(len(centre_m), dtype=bool)
    low, high = x_range_m
    inside = (centre_m[:, 0] >= low) & (centre_m[:, 0] <= high)
    if not inside.any():
        raise InputError(f"{source}: no vehicles between x = {low} m and x = {high} m")
    return inside
