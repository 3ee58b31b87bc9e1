"""The road frame beside a carriageway, and [road], the settings that place it."""

from __future__ import annotations

from dataclasses import dataclass

from .toml_table import setting

_LARGEST_M = 1e6  # sums and squares stay finite


@dataclass(frozen=True, slots=True)
class RoadFrame:
    """[road], the road frame beside a carriageway: x in the direction of travel, y to the left, the LiDAR at y <= 0.

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
    """

    station_m: float = setting(250.0, low=-_LARGEST_M, high=_LARGEST_M)
    right_edge_m: float = setting(21.9456, low=-_LARGEST_M, high=_LARGEST_M)
    setback_m: float = setting(2.0, low=0.0, high=_LARGEST_M)
    lanes: int = setting(6, low=1, high=50)
    lane_width_m: float = setting(3.66, above=0.0, high=10.0)

    @property
    def carriageway_y(self) -> tuple[float, float]:
        """The y [m] of the carriageway's right and left edge."""
        return self.setback_m, self.setback_m + self.lanes * self.lane_width_m
