"""[road], read: a straight road or a map, and where its lanes are."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from ..errors import InputError
from ..road.driven import driven_area
from ..road.road_map import RoadMap
from ..road.settings import MAPS, RoadSettings, map_of
from ..toml_table import TomlTable, settings_of
from ..traffic import Recording, format_of, joined_recordings, read_traffic
from .settings import TrafficSettings

_OF_FORMATS = ("time_step_s", "period", "location", "height_m", "origin_m", "heading_deg", "vehicle_types")
_USUAL_MEDIAN_M = 4.0


def road_from(table: TomlTable) -> RoadSettings:
    """[road]: a straight road, or a map where it names one.

    Raises
    ------
    InputError
        When it is both, or two maps.
    """
    road, maps = table.read_as(RoadSettings), [key for key in MAPS if table.values.get(key)]
    of_other = [key for key in table.values if key in settings_of(RoadSettings) and key not in road.as_table()]
    if road.is_map and (len(maps) > 1 or of_other):
        raise InputError(
            f"{table.name}: has {maps[0]} and {[*maps[1:], *of_other][0]}; allowed: one map, or the keys of a "
            "straight road"
        )
    if not road.is_map and road.origin_m != RoadSettings().origin_m:
        raise InputError(f"{table.where('origin_m')}: is of a map; allowed: with net, opendrive or driven")
    if road.carriageways == 2 and road.median_m is None:
        return replace(road, median_m=_USUAL_MEDIAN_M)
    if road.carriageways == 1 and road.median_m is not None:
        raise InputError(f"{table.where('median_m')}: is given for one carriageway; allowed: with carriageways = 2")
    return road


def road_map_from(table: TomlTable, road: RoadSettings, recordings: Sequence[TrafficSettings]) -> RoadMap:
    """Where the lanes of a road are; a driven area is made from its recordings.

    Raises
    ------
    BlenderLidarError
        When the file of a map or a recording cannot be read.
    """
    if not road.is_map:
        return map_of(road)
    for traffic in recordings:
        if traffic.format == "ngsim" or (traffic.format == "auto" and format_of(traffic.path) == "ngsim"):
            raise InputError(f"{table.name}: is a map, but {traffic.path} is NGSIM's; allowed: a straight road")
    if not road.driven:
        return map_of(road)
    read = joined_recordings([read_settings(one, road) for one in recordings], [one.name or "" for one in recordings])
    read = read.vehicles_alone
    area = driven_area(read.centre_m, read.size_m, read.heading_rad)
    if area is None:
        raise InputError(
            f"{table.where('driven')}: vehicles drive kilometres apart; allowed: recordings of one site, or a map"
        )
    return area


def read_settings(settings: TrafficSettings, road: RoadSettings) -> Recording:
    """The recording that [traffic] names, in a road's site frame; a map's origin is the recording's unless said."""
    given = {key: getattr(settings, key) for key in _OF_FORMATS}
    if road.is_map and given["origin_m"] is None:
        given["origin_m"] = road.origin_m
    return read_traffic(settings.path, format=settings.format, road=road, **given)
