"""Where the lanes and the surface of a site are: `road_map.RoadMap`, made by one file for each source."""

from .settings import RoadSettings, map_of

__all__ = ["RoadSettings", "map_of"]
