"""[road], as a scene says it: the numbers of a straight road, or a map; and the road map that these make."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

from ..errors import InputError
from ..names import SIDES
from ..toml_table import setting

if TYPE_CHECKING:
    from ..rigid import Rigid
    from .road_map import RoadMap

_LARGEST_M = 1e6  # sums and squares stay finite
_LARGEST_ORIGIN_M = 1e9
MAPS = ("net", "opendrive", "driven")
"""Keys that name a map in place of the numbers of a straight road."""
_OF_MAPS = (*MAPS, "origin_m")


@dataclass(frozen=True, slots=True)
class RoadSettings:
    """[road]: a straight road, whose site frame has x in the direction of travel and y to the left; or a map.

    A map's site frame has the map's own axes, less origin_m. The defaults are I-80's: past the on-ramp, whose
    acceleration lane ends at Local_Y 202 m.

    Attributes
    ----------
    drives_on : str
        The side of the road on which vehicles drive.
    carriageways : int
        1, with traffic along +x; or 2 with a median between them: along +x on the side of drives_on, against it on the
        other.
    median_m : float or None
        Width of the median [m]; 0 where both directions share one carriageway.
    station_m : float
        Local_Y of x = 0 [m].
    right_edge_m : float
        Local_X of the carriageway's right edge [m]; 72 ft on I-80.
    setback_m : float
        Distance from the line y = 0 to the right edge of the road [m].
    lanes : int
        Number of lanes of a carriageway.
    lane_width_m : float
        Width of one lane [m].
    grade_percent : float
        Longitudinal slope: rise of the road along +x [m] per 100 m; masts stay plumb.
    cross_fall_percent : float
        Cross-fall: fall of the road towards -y, the side of y = 0 [m] per 100 m; below 0 it falls towards +y.
    crown_percent : float
        Fall of a carriageway from its middle line to both edges [m] per 100 m; the edges lie at z = 0.
    net : str or None
        SUMO net.
    opendrive : str or None
        OpenDRIVE file.
    driven : bool
        Whether the road is where the recorded vehicles drive, as no map of it is known.
    origin_m : (float, float)
        Origin of the site frame in the map's frame [m], or with driven = true in the recording's.
    """

    drives_on: str = setting(SIDES[0], allowed=SIDES[:2])
    carriageways: int = setting(1, low=1, high=2)
    median_m: float | None = setting(None, low=0.0, high=200.0)
    station_m: float = setting(250.0, low=-_LARGEST_M, high=_LARGEST_M)
    right_edge_m: float = setting(21.9456, low=-_LARGEST_M, high=_LARGEST_M)
    setback_m: float = setting(2.0, low=-_LARGEST_M, high=_LARGEST_M)
    lanes: int = setting(6, low=1, high=50)
    lane_width_m: float = setting(3.66, low=1.0, high=10.0)
    grade_percent: float = setting(0.0, low=-12.0, high=12.0)
    cross_fall_percent: float = setting(0.0, low=-8.0, high=8.0)
    crown_percent: float = setting(0.0, low=0.0, high=6.0)
    net: str | None = setting(None, is_path=True)
    opendrive: str | None = setting(None, is_path=True)
    driven: bool = setting(False)
    origin_m: tuple[float, float] = setting((0.0, 0.0), low=-_LARGEST_ORIGIN_M, high=_LARGEST_ORIGIN_M)

    @property
    def path(self) -> str | None:
        """The file of the map, where there is one."""
        return self.net or self.opendrive

    @property
    def is_map(self) -> bool:
        """Whether a map says where the road is, and not its numbers."""
        return self.driven or self.path is not None

    def as_table(self) -> dict[str, object]:
        """The keys of [road] that make this road."""
        return {key: value for key, value in asdict(self).items() if (key in _OF_MAPS) == self.is_map}

    @property
    def carriageways_y(self) -> tuple[tuple[float, float], ...]:
        """The y [m] of the right and the left edge of each carriageway, from the right."""
        width, step = self.lanes * self.lane_width_m, self.median_m or 0.0
        right = (self.setback_m + number * (width + step) for number in range(self.carriageways))
        return tuple((edge, edge + width) for edge in right)

    def place(self, side: str) -> tuple[float, float]:
        """The y [m] of a mast on a side of the road, and which way it faces [rad], both square to the road.

        As far from the left edge as the line y = 0 is from the right one; in the middle of the median, or over the
        middle of the carriageway that drives along +x.
        """
        edges = self.carriageways_y
        right, left = edges[0][0], edges[-1][1]
        if side == "left":
            return left + self.setback_m, 1.5 * math.pi
        if side == "median":
            return 0.5 * (edges[0][1] + edges[-1][0]), 0.5 * math.pi
        if side == "gantry":
            return 0.5 * sum(edges[-1 if self.drives_on == "left" else 0]), 0.5 * math.pi
        return right - self.setback_m, 0.5 * math.pi

    @property
    def faced_from_any_side(self) -> bool:
        """Whether masts face the road from where they stand unless said; else all face +y."""
        return self.drives_on != SIDES[0] or self.carriageways > 1

    @property
    def T_site_ngsim(self) -> Rigid:
        """From NGSIM's plane (Local_X to the right from the left edge, Local_Y along travel) to the site frame."""
        import numpy as np

        from ..rigid import Rigid

        quarter_turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])  # rows: X to -y, Y to x
        right_edge = np.array([self.right_edge_m, self.station_m, 0.0])
        return Rigid(quarter_turn, right_edge, np.array([0.0, self.setback_m, 0.0]))

    @property
    def is_level(self) -> bool:
        """Whether the vertical stands square on the road's plane."""
        return self.grade_percent == self.cross_fall_percent == 0.0

    @property
    def slopes(self) -> dict[str, float]:
        """What of it is not level, by the settings' names."""
        keys = ("grade_percent", "cross_fall_percent", "crown_percent")
        return {key: getattr(self, key) for key in keys if getattr(self, key)}

    @property
    def up(self) -> tuple[float, float, float]:
        """The vertical in the road frame, whose z stands square on the road's plane.

        With u along x and v along y, both level, the plane is ``z = grade u + cross_fall v``, and the road frame's x
        lies in it above u.
        """
        if self.is_level:
            return 0.0, 0.0, 1.0
        grade, fall = 0.01 * self.grade_percent, 0.01 * self.cross_fall_percent
        along, whole = math.hypot(1.0, grade), math.hypot(1.0, grade, fall)
        return grade / along, fall / (along * whole), 1.0 / whole


def map_of(road: RoadSettings) -> RoadMap:
    """Where the lanes and the surface of a road are; a driven area's needs the traffic, see `driven.driven_area`.

    Raises
    ------
    MissingFileError, InputError, MissingExtraError
        When the file of the map cannot be read.
    """
    if road.driven:
        raise InputError("[road] driven: a driven area is made from the traffic; allowed without it: net or opendrive")
    status = Path(road.path).stat() if road.path and Path(road.path).exists() else None
    return _read(road, status and (status.st_size, status.st_mtime_ns))


@lru_cache(maxsize=8)
def _read(road: RoadSettings, stamp: object) -> RoadMap:
    """The map of a road, of a file as it is now, which its `stamp` tells."""
    if road.net:
        from .sumo_net import read_net

        return read_net(road.net, road.origin_m)
    if road.opendrive:
        from .opendrive import read_opendrive

        return read_opendrive(road.opendrive, road.origin_m)
    from .straight import straight_road

    return straight_road(road)
