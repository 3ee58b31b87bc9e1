"""Where the lanes and the surface of a site are: `road_map.RoadMap`, made by one file for each source."""

from .straight import StraightRoad

__all__ = ["StraightRoad"]
