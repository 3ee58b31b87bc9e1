"""Where the lanes and the surface of a site are: `road_map.RoadMap`, made by one file for each source."""

from .mapped import MappedRoad, Road
from .straight import StraightRoad

__all__ = ["MappedRoad", "Road", "StraightRoad"]
