"""The road frame beside a carriageway, and [road], the settings that place it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from .toml_table import setting

if TYPE_CHECKING:
    import numpy as np

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
    grade_percent : float
        Rise of the road along +x, on 100 m of level way; masts stay plumb.
    cross_fall_percent : float
        Fall of the road towards -y, the side of y = 0, on 100 m of level way; below 0 it falls towards +y.
    crown_percent : float
        Fall of the carriageway from its middle line to both edges, which lie at z = 0.
    """

    station_m: float = setting(250.0, low=-_LARGEST_M, high=_LARGEST_M)
    right_edge_m: float = setting(21.9456, low=-_LARGEST_M, high=_LARGEST_M)
    setback_m: float = setting(2.0, low=0.0, high=_LARGEST_M)
    lanes: int = setting(6, low=1, high=50)
    lane_width_m: float = setting(3.66, above=0.0, high=10.0)
    grade_percent: float = setting(0.0, low=-12.0, high=12.0)
    cross_fall_percent: float = setting(0.0, low=-8.0, high=8.0)
    crown_percent: float = setting(0.0, low=0.0, high=6.0)

    @property
    def carriageway_y(self) -> tuple[float, float]:
        """The y [m] of the carriageway's right and left edge."""
        return self.setback_m, self.setback_m + self.lanes * self.lane_width_m

    @property
    def is_level(self) -> bool:
        """Whether the vertical stands square on the road's plane."""
        return self.grade_percent == self.cross_fall_percent == 0.0

    @property
    def slopes(self) -> dict[str, float]:
        """What of it is not level, by the settings' names."""
        keys = ("grade_percent", "cross_fall_percent", "crown_percent")
        return {key: getattr(self, key) for key in keys if getattr(self, key)}

    def crown_m(self, y: np.ndarray) -> np.ndarray:
        """How high the surface lies above the plane z = 0 at y [m], (n,)."""
        right, left = self.carriageway_y
        half = 0.5 * (left - right)
        return 0.01 * self.crown_percent * (half - abs(y - right - half)).clip(0.0)
