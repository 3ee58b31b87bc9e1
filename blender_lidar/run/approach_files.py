"""The detectable share of each approach and movement as CSV, and with the approaches' outlines as GeoJSON."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from functools import partial

import numpy as np

from ..files import to_csv, write_text
from ..road.settings import RoadSettings
from ..scene.site import Site
from .folder import RunFolder
from .vehicle_table import APPROACH, MOVEMENT

TABLE, OUTLINES = "approaches.csv", "approaches.geojson"
_COLUMNS = ("by", "name", "boxes", "distinct_vehicles", "before", "before_low_90", "before_high_90")
_COLUMNS += ("after", "after_low_90", "after_high_90", "gain", "gain_low_90", "gain_high_90")


def write_approaches(folder: RunFolder, site: Site, result: Mapping) -> None:
    """Write both into a run's folder, the outlines where a map has them; nothing where no approach is known."""
    rows = [_row(group) for group in result["groups"] if group["by"] in (APPROACH, MOVEMENT)]
    if not rows:
        return
    write_text(folder.file(TABLE), to_csv(_COLUMNS, ([row[key] for key in _COLUMNS] for row in rows)))
    outlines = _outlines(site, result, {row["name"]: row for row in rows if row["by"] == APPROACH})
    if outlines is not None:
        write_text(folder.file(OUTLINES), json.dumps(outlines, indent=1) + "\n")


def _row(group: Mapping) -> dict[str, object]:
    row = {key: group.get(key) for key in _COLUMNS if key in group}
    for key in ("before", "after", "gain"):
        row[f"{key}_low_90"], row[f"{key}_high_90"] = group[f"{key}_interval_90"] or (None, None)
    return row


def _outlines(site: Site, result: Mapping, rows: Mapping[str, Mapping]) -> dict[str, object] | None:
    """GeoJSON: the counted part of each approach with its shares, and the masts; None where no map has approaches.

    Coordinates are the map's own metres. Of a SUMO net in UTM they are UTM's, without the net's offset, and ``crs``,
    of the older GeoJSON of 2008 that GIS programs read, names the zone; else the program must be told.
    """
    road, region = site.scenario.road_map, site.region
    if not region.spans:
        return None
    offset, zone = _projected(site.scenario.road)
    placed = partial(_placed, offset=np.add(site.scenario.road.origin_m, offset))
    features = []
    for name, row in rows.items():
        lanes = [lane for lane in region.spans if road.lanes[lane].road == name]
        polygons = [[placed(outline)] for lane in lanes for outline in road.area([lane], region.spans[lane])]
        features.append(_feature("MultiPolygon", polygons, row))
    for lidar in result["lidars"]:
        mount = lidar["deployment"]
        (foot,) = placed([(mount["x_m"], mount["y_m"])])[:1]
        features.append(_feature("Point", foot, {"name": lidar["name"], **mount}))
    named = {"crs": {"type": "name", "properties": {"name": f"urn:ogc:def:crs:EPSG::{zone}"}}} if zone else {}
    return {"type": "FeatureCollection", **named, "features": features}


def _feature(kind: str, coordinates: object, properties: Mapping[str, object]) -> dict[str, object]:
    return {
        "type": "Feature",
        "geometry": {"type": kind, "coordinates": coordinates},
        "properties": dict(properties),
    }


def _placed(outline: Sequence[Sequence[float]], offset: np.ndarray) -> list[list[float]]:
    """Corners (k, 2) in the map's own frame [m], to the millimetre, the first once more at the end."""
    corners = np.add(outline, offset).round(3).tolist()
    return [*corners, corners[0]]


def _projected(road: RoadSettings) -> tuple[np.ndarray, int | None]:
    """What makes projected coordinates of a net's [m], and EPSG's number of its UTM zone; zeros and None otherwise."""
    if not road.net:
        return np.zeros(2), None
    from ..road.sumo_net import net_location

    offset, projection = net_location(road.net)
    zone = re.search(r"\+proj=utm .*?\+zone=(\d+)", projection)
    if zone is None:
        return np.zeros(2), None
    return -offset, (32700 if "+south" in projection else 32600) + int(zone[1])
