"""The installation sheet, what the person on the ladder needs: where the LiDAR goes, how it leans, what to check."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Collection, Mapping
from dataclasses import asdict, replace
from functools import partial

import numpy as np

from ..document import ANSWER, DOUBT, Document, document_from
from ..run.words import region_text
from ..scene.directions import UPRIGHT_DEG, bearing_deg, pointing
from ..scene.mounting import Mast
from ..scene.site import Site

_WIDTH = 110


def installation_text(site: Site, result: Mapping, charts: Collection[str] = ()) -> str:
    """Instructions for one mounting, as plain text.

    `result` is as `run.words.each_lidar` gives it for the LiDAR that the site has alone; `charts` lie beside it.
    """
    document = document_from(result["document"])
    mount = result["deployment"]
    mounting = site.scenario.lidar.mounting(mount)
    plumb = replace(mounting, mast=Mast(facing_rad=mounting.mast.facing_rad))
    right, ahead, _ = plumb.pose.to_world(np.eye(3))  # the sensor's axes; at zero azimuth it looks ahead
    falls = [_falls(-math.degrees(math.asin(axis[2]))) for axis in (ahead, right)]
    road, standing = site.scenario.road, site.observation.scenery
    travel = "the direction of travel" + (f" on the {road.drives_on} carriageway" if road.carriageways == 2 else "")
    along, across = (" along the road", " across it") if site.scenario.road_map.endless else ("", " in the site frame")
    travel = travel if site.scenario.road_map.endless else "the nearest lane's direction"
    bearing = partial(_bearing, site, ahead_rad=site.scenario.road_map.direction(mounting.xy), travel=travel)
    at = pointing(site, mounting)
    modelled = standing is not None and len(standing.scenery.beside_road) > 0
    columns = f", {site.model.columns()} columns a turn" if site.model.columns_a_turn else ""
    lines = [
        *_which(result),
        "",
        *(line for one in document.of(DOUBT) for line in _item(one.text)),
        *[""] * bool(document.of(DOUBT)),
        f"Height       {mount['height_m']:.2f} m from the road surface to the optical centre of the sensor;",
        _above_foot(result),
        *_slopes(site),
        f"Position     x {mount['x_m']:.2f} m{along}, y {mount['y_m']:.2f} m{across}:",
        f"             {_beside(site, mounting)}",
        f"On the map   x {at['x_m']:.2f} m, y {at['y_m']:.2f} m in the recording's coordinates ({at['frame']});",
        "             bearings below are clockwise from their +y, which is north where y points north",
        f"Mast         faces {bearing(plumb.mast.T_site_mast.rotation[1])}",
        f"Lean         {_lean(at)}",
        f"             (as tilts, set before the yaw: {mount['tilt_x_deg']:.1f} deg down towards where the mast faces,",
        f"             {mount['tilt_y_deg']:.1f} deg up on the right of that)",
        f"Yaw          {mount['yaw_deg']:.1f} deg counter-clockwise seen from above; at 0 the sensor's zero azimuth",
        "             points where the mast faces",
        f"Cable        zero azimuth faces {bearing(ahead)};",
        "             a cable outlet opposite it, as most spinning sensors have (see the drawing), faces",
        f"             {bearing(-ahead)}",
        f"Planned for  vehicles {region_text(asdict(site.scenario.region))}, in the frame of the position above",
        "",
        "Check on site",
        f"- Inclinometer on the sensor's base: towards zero azimuth it {falls[0]},",
        f"  a quarter turn clockwise from it, seen from above, it {falls[1]}.",
        f"- {_lowest_beam(site, mounting)}",
        f"- Rotation rate {site.observation.lattice.rotation_hz:g} Hz{columns}.",
        "- Look for poles, signs, trees and barriers between the sensor and the lanes that the scene does not have."
        if modelled
        else "- Poles, signs, trees and barriers between the sensor and the lanes are not in the model: look for them.",
        *["- blind_zones.png shows where vehicles stay below the threshold."] * ("blind_zones.png" in charts),
        "",
        *_expected(document),
    ]
    return "\n".join(lines) + "\n"


def _which(result):
    """Which LiDAR it is, and where the others of its layout hang."""
    if not result.get("layout"):
        return [f"Installation of one {result['sensor']} LiDAR: {result['site']}"]
    count, lines = len(result["lidars"]), []
    for one in result["lidars"]:
        at, pole = one["deployment"], f", on pole {one['pole']['name']}" if one["pole"] else ""
        if one["name"] != result["name"]:
            place = f"x {at['x_m']:.2f} m, y {at['y_m']:.2f} m, height {at['height_m']:.2f} m"
            lines.append(f"Beside it    {one['name']} ({one['sensor']}){pole}: {place}")
    return [f"Installation of LiDAR {result['name']} ({result['sensor']}), one of {count}: {result['site']}", *lines]


def _falls(fall_deg: float) -> str:
    """How far a base falls or rises in a direction."""
    if abs(fall_deg) < UPRIGHT_DEG:
        return "is level"
    return f"{'falls' if fall_deg > 0.0 else 'rises'} by {abs(fall_deg):.1f} deg"


def _above_foot(result):
    """How high above the pole's foot, where that is known."""
    if not result.get("pole"):
        return "             from the pole's foot it is more by as much as the foot lies below the road"
    pole, height = result["pole"], result["deployment"]["height_m"]
    return f"             {height - pole['foot_z_m']:.2f} m from the foot of pole {pole['name']}"


def _slopes(site):
    """How the road slopes under a plumb mast, and what the height is measured from."""
    road, lines = site.scenario.road, []
    if not road.is_level:
        grade, fall = road.grade_percent, road.cross_fall_percent
        ahead = f"{'rises' if grade > 0.0 else 'falls'} {abs(grade):g} % ahead" if grade else ""
        aside = f"falls {abs(fall):g} % to the {'right' if fall > 0.0 else 'left'}" if fall else ""
        lines += [
            f"The road {' and '.join(filter(None, (ahead, aside)))}:",
            "the height is plumb, above the plane of the road where that meets the mast,",
            "and lean, yaw and falls are against the vertical, not the road",
        ]
    if site.scenario.road_map.surface.is_ground:
        lines += ["The road has the heights of its map: the height is plumb, above the nearest lane at the mast"]
    if road.crown_percent:
        height = float(site.scenario.road_map.surface.triangles((0.0, 0.0), 1.0)[..., 2].max())
        lines.append(f"The road's surface is that of the carriageway's edges; its middle is {height:.2f} m higher")
    return [f"             {line}" for line in lines]


def _beside(site, mounting):
    """How far beside the lanes the pole stands, and on which side."""
    road = site.scenario.road_map
    away, side = road.clearance(mounting.xy)
    if road.within(np.array([mounting.xy]))[0]:
        return f"over a lane, {abs(away):.2f} m from its {side} edge, seen in its direction of travel"
    where = "in the median, " if road.side_of(mounting.xy) == "median" else ""
    return f"{where}{away:.2f} m from the edge of the nearest lane, to the {side} of its traffic"


def _lean(at):
    """How far and which way the sensor leans off the plumb line: beams on that side look down."""
    if at["leans"] is None:
        return "none: the sensor stands upright"
    bearing = f"bearing {at['lean_bearing_deg']:.0f} deg from the recording's +y"
    return f"{at['lean_deg']:.1f} deg down {at['leans']}, {bearing}"


def _bearing(site, axis, ahead_rad, travel):
    """Where an axis (3,) points, seen from above, for people on a road that goes ahead in the direction of `travel`."""
    if not site.scenario.road_map.endless:
        return f"bearing {bearing_deg(site, axis[:2]):.0f} deg"
    left = ("+y", "-x", "-y", "+x")  # of the site frame, by the quarter turns of the road in it
    quarter = round(ahead_rad / (0.5 * math.pi))
    bearing = math.degrees(math.atan2(axis[1], axis[0]) - ahead_rad)
    names = {0: f"ahead, in {travel}", 90: f"{left[quarter % 4]}, left of {travel}"}
    names |= {180: f"back, against {travel}", -90: f"{left[(quarter + 2) % 4]}, right of {travel}"}
    nearest = min(names, key=lambda name: abs(math.remainder(bearing - name, 360.0)))
    off = math.remainder(bearing - nearest, 360.0)
    turned = "" if abs(off) < 0.5 else f", {abs(off):.0f} deg {'counter-' if off > 0 else ''}clockwise of it"
    return f"{names[nearest]}{turned}, bearing {bearing_deg(site, axis[:2]):.0f} deg"


_CROWN_STEPS = 20  # each comes nearer by the crown's slope over the beam's


def _lowest_beam(site, mounting):
    """Where the lowest ring meets the ground on the side that looks down, at zero azimuth where none does."""
    pose = mounting.pose
    lowest, (right, ahead, _) = float(site.model.elevation_rad[0]), pose.to_world(np.eye(3)) @ mounting.mast.up
    down = math.hypot(right, ahead) > math.sin(math.radians(UPRIGHT_DEG))
    azimuth = math.atan2(-right, -ahead) if down else 0.0  # clockwise from zero azimuth
    beam = [math.cos(lowest) * math.sin(azimuth), math.cos(lowest) * math.cos(azimuth), math.sin(lowest)]
    ray = pose.to_world(np.array([beam]))[0]
    turn = round(math.degrees(azimuth)) + 0
    side = "zero azimuth" if not turn else f"{abs(turn)} deg {'counter-' if turn < 0 else ''}clockwise of zero azimuth"
    side = f"At {side}{', where the sensor leans' if turn else ''}, the lowest ring"
    if ray[2] >= 0:
        return f"{side} does not meet the ground."
    spot = pose.position - pose.height_m / ray[2] * ray
    for _ in range(_CROWN_STEPS):  # on a crown the surface lies higher there, and so the place nearer
        rise = float(site.scenario.road_map.surface.height(spot))
        spot = pose.position - (pose.height_m - rise) / ray[2] * ray
    reach = math.dist(spot[:2], mounting.xy)
    return f"{side} meets the ground {reach:.1f} m from the pole: put a target there."


def _expected(document: Document) -> list[str]:
    """The two numbers to expect: what is detectable, and how sure that is."""
    told = (one for one in document.of(ANSWER, first=True) if one.label in ("Detectable", "How sure"))
    return [
        *textwrap.wrap(f"Expected: {document.title}", _WIDTH, subsequent_indent="  "),
        *(line for one in told for line in _item(f"{one.label}: {one.text}")),
    ]


def _item(text: str) -> list[str]:
    """A text as an item of a list."""
    return textwrap.wrap(f"- {text}", _WIDTH, subsequent_indent="  ")
