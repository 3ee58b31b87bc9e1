"""Where a mast stands in its recording's own coordinates, and in words which way a sensor points from there.

Words follow from the pose, the road map and the region, never from the sign of an angle.
"""

from __future__ import annotations

import math

import numpy as np

from ..rigid import Rigid
from .mounting import Mounting
from .site import Site

UPRIGHT_DEG = 0.05  # a smaller tilt cannot be set on site
_AT_MIDDLE_DEG = 10.0  # off the middle of the region, and still towards it
_NEAR_M = 5.0  # of the middle of the region: too near to point at it
_ACROSS_DEG = 60.0  # off the way straight to the road, and still towards it
_FRAMES = {
    "ngsim": "Local_X right, Local_Y ahead; feet in the file",
    "sumo": "x and y of the net",
    "table": "x and y of the table",
}


def pointing(site: Site, mounting: Mounting) -> dict[str, object]:
    """Where a mounting hangs and points, for people with the recording's own coordinates, as JSON holds it.

    Returns
    -------
    dict
        ``frame``, ``x_m`` and ``y_m``: the mast's foot in the recording's frame, of several recordings the first's;
        ``facing_bearing_deg``: which way the mast faces, clockwise from that frame's +y (north, where y is north);
        ``lean_deg``, ``lean_bearing_deg`` and ``leans``: how far the sensor leans off the plumb line, the bearing of
        that side, on which the beams look down, and what lies there, in words; the last two None where it is upright.
    """
    axis = mounting.pose.to_world(np.array([[0.0, 0.0, 1.0]]))[0]
    _, facing, upright = mounting.mast.T_site_mast.rotation
    lean = math.degrees(math.acos(np.clip(axis @ upright, -1.0, 1.0)))
    is_upright = lean < UPRIGHT_DEG
    side = (axis - (axis @ upright) * upright)[:2]
    return {
        **_in_recording(site, mounting.xy),
        "facing_bearing_deg": bearing_deg(site, facing[:2]),
        "lean_deg": lean,
        "lean_bearing_deg": None if is_upright else bearing_deg(site, side),
        "leans": None if is_upright else towards(site, mounting.xy, side),
    }


def bearing_deg(site: Site, direction: np.ndarray) -> float:
    """Bearing of a direction of the site frame, (2,): clockwise from +y of the map or the recording, 0 to 360."""
    counter_clockwise = math.atan2(direction[1], direction[0]) + _T_recording_site(site).turn_rad
    return round(90.0 - math.degrees(counter_clockwise), 9) % 360.0


def towards(site: Site, xy: tuple[float, float], direction: np.ndarray) -> str:
    """What a horizontal direction (2,) points at from a place [m, site frame]: the region's middle, or the road."""
    to_middle = np.subtract(site.region.centre_xy, xy)
    if math.hypot(*to_middle) > _NEAR_M and _between_deg(direction, to_middle) <= _AT_MIDDLE_DEG:
        return "towards the middle of the region"
    road = site.scenario.road_map
    lanes = road.nearest(xy)
    lane = int(np.argmin(np.hypot(*(lanes - xy).T)))
    off = _between_deg(direction, lanes[lane] - xy)
    in_between = road.clearance(xy)[0] <= 0.0 or road.side_of(xy) == "median"
    if not in_between and not _ACROSS_DEG < off < 180.0 - _ACROSS_DEG:
        return "towards the road" if off <= _ACROSS_DEG else "away from the road"
    if not len(road):  # a driven area, whose traffic has no direction
        return "over the road" if in_between else "along the edge of the road"
    heading = float(road.locate(lanes[[lane]]).heading_rad[0])
    turn = math.degrees(math.remainder(math.atan2(direction[1], direction[0]) - heading, 2.0 * math.pi))
    ways = {0.0: "along the nearest lane, with its traffic", 180.0: "along the nearest lane, against its traffic"}
    ways |= {90.0: "to the left of the nearest lane's traffic", -90.0: "to the right of the nearest lane's traffic"}
    return ways[min(ways, key=lambda way: abs(math.remainder(turn - way, 360.0)))]


def _in_recording(site: Site, xy: tuple[float, float]) -> dict[str, object]:
    """A place of the site frame in the map's own coordinates, else the first recording's [m], and what these are."""
    format, road = site.recording.report.format, site.scenario.road
    frame = _FRAMES.get(format, "x and y of the recording")
    if road.path:
        frame = "x and y of the net" if road.net else "x and y of the OpenDRIVE map"
    x_m, y_m = _T_recording_site(site).points(xy)
    return {"frame": frame, "x_m": float(x_m), "y_m": float(y_m)}


def _T_recording_site(site: Site) -> Rigid:
    """From the site frame to the map, which has its axes, or without one to the first recording."""
    road, settings = site.scenario.road, site.scenario.recordings[0]
    if road.path:
        return Rigid.about_z(0.0, road.origin_m)
    if site.recording.report.format == "ngsim":
        return road.T_site_ngsim.inverse
    return Rigid.about_z(math.radians(settings.heading_deg or 0.0), settings.origin_m or road.origin_m)


def _between_deg(first: np.ndarray, second: np.ndarray) -> float:
    """Angle between two directions (2,) [degrees]."""
    along, across = first @ second, first[0] * second[1] - first[1] * second[0]
    return abs(math.degrees(math.atan2(across, along)))
