"""[road] with a map: a SUMO net, OpenDRIVE, or where the recorded vehicles drive."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

from ..toml_table import setting
from .straight import StraightRoad, road_map

if TYPE_CHECKING:
    from .road_map import RoadMap

_LARGEST_ORIGIN_M = 1e9


@dataclass(frozen=True, slots=True)
class MappedRoad:
    """[road] with a map, in place of a straight road: its site frame has the map's own axes, less origin_m.

    Attributes
    ----------
    net : str or None
        SUMO net.
    opendrive : str or None
        OpenDRIVE file.
    driven : bool
        Whether the road is where the recorded vehicles drive, as no map of it is known.
    origin_m : (float, float)
        Origin of the site frame in the map's frame [m], or with driven = true in the recording's.
    """

    net: str | None = setting(None, is_path=True)
    opendrive: str | None = setting(None, is_path=True)
    driven: bool = setting(False)
    origin_m: tuple[float, float] = setting((0.0, 0.0), low=-_LARGEST_ORIGIN_M, high=_LARGEST_ORIGIN_M)

    grade_percent = cross_fall_percent = crown_percent = 0.0
    carriageways, median_m, is_level, slopes = 1, None, True, {}

    @property
    def path(self) -> str | None:
        """The file of the map."""
        return self.net or self.opendrive


Road = StraightRoad | MappedRoad


def map_of(road: Road) -> RoadMap:
    """Where the lanes and the surface of a road are; a driven area's needs the traffic, see `driven.driven_area`.

    Raises
    ------
    MissingFileError, InputError, MissingExtraError
        When the file of the map cannot be read.
    """
    if isinstance(road, StraightRoad):
        return road_map(road)
    status = Path(road.path).stat() if Path(road.path).exists() else None
    return _read(road, status and (status.st_size, status.st_mtime_ns))


@lru_cache(maxsize=4)
def _read(road: MappedRoad, stamp: object) -> RoadMap:
    """The map of a file as it is now, which its `stamp` tells."""
    if road.net:
        from .sumo_net import read_net

        return read_net(road.net, road.origin_m)
    from .opendrive import read_opendrive

    return read_opendrive(road.opendrive, road.origin_m)
