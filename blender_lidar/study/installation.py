"""What the person on the ladder needs: where the LiDAR goes, which way it leans, and what to check."""

from __future__ import annotations

import math

import numpy as np

from ..scenario import pose_at
from ..sensors.pose import Pose
from .site import Site

_UPRIGHT_DEG = 0.05  # a smaller tilt cannot be set on site


def installation_text(site: Site, result: dict) -> str:
    """Instructions for one mounting, as plain text; `result` is the content of result.json."""
    mount = result["deployment"]
    pose = pose_at(mount)
    parts = (
        [f"Installation of one {result['sensor']} LiDAR", ""],
        _placement(site, mount),
        ["", "Check on site"],
        _checks(site, pose),
        ["", "Expected, on the searched traffic"],
        _expected(result),
    )
    return "\n".join(line for part in parts for line in part) + "\n"


def _placement(site, mount):
    right, left = site.scenario.road.carriageway_y
    across = _lean(mount["tilt_x_deg"], "down towards +y, across the road", "up towards +y, across the road")
    along = _lean(mount["tilt_y_deg"], "up ahead, in the direction of travel", "down ahead, in the direction of travel")
    yaw = mount["yaw_deg"]
    lines = [
        f"Height       {mount['height_m']:.2f} m from the road surface to the optical centre of the sensor",
        f"Position     x {mount['x_m']:.2f} m along the road, y {mount['y_m']:.2f} m across it",
        f"Tilt         {across}",
        f"             {along}",
        f"Yaw          {yaw:.1f} deg counter-clockwise seen from above" + _zero_azimuth(yaw),
    ]
    if mount["y_m"] < right:
        lines += [
            f"             The pole stands {right - mount['y_m']:.2f} m to the right of the carriageway: who looks",
            "             across it, towards +y, sees the traffic pass from left to right.",
        ]
    else:
        lines += [
            f"             The pole stands {mount['y_m'] - left:.2f} m to the left of the carriageway: +y points away",
            "             from it, and so does a positive tilt.",
        ]
    return lines


def _lean(angle, positive, negative):
    if abs(angle) < _UPRIGHT_DEG:
        return f"0.0 deg {positive.split(', ')[-1]}"
    return f"{abs(angle):.1f} deg {positive if angle > 0 else negative}"


def _zero_azimuth(yaw):
    return "" if yaw else ": the sensor's zero azimuth faces across the road, +y"


def _checks(site: Site, pose: Pose):
    dip_across, dip_along = (_dip_deg(pose, axis) for axis in ([0.0, 1.0, 0.0], [1.0, 0.0, 0.0]))
    return [
        f"- Inclinometer on the sensor's base: a fall of {dip_across:.1f} deg towards zero azimuth and of",
        f"  {dip_along:.1f} deg a quarter turn clockwise from it (a negative fall is a rise).",
        f"- {_lowest_beam(site, pose)}",
        f"- Rotation rate {site.observation.lattice.rotation_hz:g} Hz.",
        "- Poles, signs, trees and barriers between the sensor and the lanes are not in the model: look for them.",
        "- The scores hold for the traffic that was given: see the interval of the gain in result.json, and",
        "  blind_zones.png for where vehicles stay below the threshold.",
    ]


def _dip_deg(pose, sensor_axis):
    """How far an axis of the sensor points below the horizon [deg]."""
    return -math.degrees(math.asin(pose.to_world(np.array([sensor_axis]))[0, 2])) + 0.0


def _lowest_beam(site, pose):
    """Where the lowest ring meets the ground in the direction of zero azimuth."""
    lowest = float(site.model.elevation_rad[0])
    ray = pose.to_world(np.array([[0.0, math.cos(lowest), math.sin(lowest)]]))[0]
    if ray[2] >= 0:
        return "At zero azimuth no beam of the lowest ring meets the ground."
    reach = -pose.height_m * math.hypot(ray[0], ray[1]) / ray[2]
    return f"At zero azimuth the lowest ring meets the ground {reach:.1f} m from the pole: put a target there."


def _expected(result):
    base = result["baseline"]
    lines = [
        f"- vehicles at or above the threshold: {100 * result['detectable_share']:.1f} % "
        f"(baseline {100 * base['detectable_share']:.1f} %)",
        f"- objective per vehicle: {result['objective_per_vehicle']:.3f} bits "
        f"(baseline {base['objective_per_vehicle']:.3f})",
    ]
    intervals = (result["map"] or {}).get("optimum_interval_90")
    if intervals:
        height, tilt = intervals["height_m"], intervals["tilt_x_deg"]
        lines += [
            f"- other traffic of this kind would put the best height between {height[0]:.1f} and {height[1]:.1f} m and",
            f"  the best tilt between {tilt[0]:.0f} and {tilt[1]:.0f} deg (90 % of resampled blocks of time)",
        ]
    return lines
