"""What the person on the ladder needs: where the LiDAR goes, which way it leans, and what to check."""

from __future__ import annotations

import math

from ..scenario import pose_at
from .site import Site

_STEPS = (
    ("tilt_x_deg", "down towards the road", "up, away from the road", "across the road: lean the sensor"),
    (
        "tilt_y_deg",
        "up ahead, in the direction of travel",
        "down ahead, in the direction of travel",
        "along the road: point it",
    ),
)


def installation_text(site: Site, result: dict) -> str:
    """Instructions for one mounting, as plain text."""
    mount = result["deployment"]
    right, _ = site.scenario.road.carriageway_y
    pose = pose_at(mount)
    lines = [
        f"Installation of one {result['sensor']} LiDAR",
        "",
        f"Height       {mount['height_m']:.2f} m from the road surface to the optical centre of the sensor",
        f"Position     {_position(mount, right)}",
        *_tilts(mount),
        f"Yaw          {mount['yaw_deg']:.1f} deg counter-clockwise seen from above"
        + ("" if mount["yaw_deg"] else " (the sensor's zero azimuth faces across the road)"),
        "",
        "Directions are those of somebody who stands at the pole and looks across the carriageway; traffic passes from left to "
        "right."
        if mount["y_m"] < right
        else "The pole stands at the left side of the carriageway, beyond the median.",
        "",
        "Check on site",
        f"- A horizontal beam towards the road must point {_down(pose):.1f} deg below the horizon: measure with an inclinometer on "
        "the sensor's base, once across the road and once along it.",
        f"- {_lowest_beam(site, pose)}",
        f"- Set the rotation rate to {site.observation.lattice.rotation_hz:g} Hz.",
        "- Look for poles, signs, trees and barriers between the sensor and the lanes: they are not in the model.",
        "- The scores hold for the traffic that was given; look at the interval of the gain, and at blind_zones.png.",
        *_expected(result),
    ]
    return "\n".join(lines) + "\n"


def _position(mount, right):
    side = (
        f"{right - mount['y_m']:.2f} m to the right of the carriageway's right edge"
        if mount["y_m"] < right
        else (f"{mount['y_m'] - right:.2f} m to the left of the carriageway's right edge")
    )
    return f"x {mount['x_m']:.2f} m along the road, y {mount['y_m']:.2f} m across it ({side})"


def _tilts(mount):
    lines = []
    for key, positive, negative, axis in _STEPS:
        angle = mount[key]
        name = "Tilt" if key == "tilt_x_deg" else "    "
        if abs(angle) < 0.05:
            lines.append(f"{name}         none {axis.split(':')[0]}")
        else:
            lines.append(f"{name}         {abs(angle):.1f} deg {positive if angle > 0 else negative} ({axis})")
    return lines


def _down(pose):
    """How far the level beam that faces across the road points below the horizon [deg]."""
    return -math.degrees(math.asin(pose.to_world([[0.0, 1.0, 0.0]])[0, 2]))


def _lowest_beam(site, pose):
    lowest = float(site.model.elevation_rad[0])
    ray = pose.to_world([[0.0, math.cos(lowest), math.sin(lowest)]])[0]
    if ray[2] >= 0:
        return "No beam that faces across the road meets the ground."
    reach = -pose.height_m * math.hypot(ray[0], ray[1]) / ray[2]
    return f"Across the road the lowest beam meets the ground {reach:.1f} m from the pole; nothing on the ground nearer is seen there."


def _expected(result):
    lines = [
        "",
        "Expected, on the searched traffic",
        f"- vehicles at or above the threshold: {100 * result['detectable_share']:.1f} % "
        f"(baseline {100 * result['baseline']['detectable_share']:.1f} %)",
        f"- objective per vehicle: {result['objective_per_vehicle']:.3f} bits "
        f"(baseline {result['baseline']['objective_per_vehicle']:.3f})",
    ]
    intervals = (result["map"] or {}).get("optimum_interval_90")
    if intervals:
        height, tilt = intervals["height_m"], intervals["tilt_x_deg"]
        lines.append(
            f"- other traffic of this kind would have put the best height between {height[0]:.1f} and {height[1]:.1f} m and the best "
            f"tilt between {tilt[0]:.0f} and {tilt[1]:.0f} deg (90 % of resampled blocks of time)"
        )
    return lines
