"""What the person on the ladder needs: where the LiDAR goes, which way it leans, and what to check."""

from __future__ import annotations

import math

import numpy as np

from ..metrics.catalogue import metric_named
from ..metrics.views import PE_VGOP
from ..scenario import pose_at
from ..sensors.pose import Pose
from .circumstances import imperfections_text, scenery_counts, scenery_text
from .objective_text import objective_text
from .site import Site
from .tolerance_text import costliest_text, kept_text, tolerance_text

_UPRIGHT_DEG = 0.05  # a smaller tilt cannot be set on site


def installation_text(site: Site, result: dict) -> str:
    """Instructions for one mounting, as plain text; `result` is the content of result.json."""
    mount = result["deployment"]
    pose = pose_at(mount)
    parts = (
        [f"Installation of one {result['sensor']} LiDAR", ""],
        _placement(site, mount, pose),
        ["", "Check on site"],
        _checks(site, pose),
        ["", *_expected(result), *_circumstances(site)],
        _errors(result),
    )
    return "\n".join(line for part in parts for line in part) + "\n"


def _placement(site, mount, pose):
    return [
        f"Height       {mount['height_m']:.2f} m from the road surface to the optical centre of the sensor",
        f"Position     x {mount['x_m']:.2f} m along the road, y {mount['y_m']:.2f} m across it:",
        f"             {_beside(site, mount['y_m'])}",
        f"Lean         {_lean(pose)}",
        f"             (before yaw: {mount['tilt_x_deg']:.1f} deg across, {mount['tilt_y_deg']:.1f} deg along it)",
        f"Yaw          {mount['yaw_deg']:.1f} deg counter-clockwise seen from above; at 0 the zero azimuth of the",
        "             sensor faces across the road, +y: to the left of the direction of travel",
    ]


def _beside(site, y_m):
    right, left = site.scenario.road.carriageway_y
    if y_m <= right:
        return f"{right - y_m:.2f} m to the right of the carriageway's right edge, seen in the direction of travel"
    return f"{y_m - left:.2f} m to the left of the carriageway's left edge, seen in the direction of travel"


def _lean(pose: Pose):
    """How far and which way the sensor's upright axis leans: beams on that side look down."""
    axis = pose.to_world(np.array([[0.0, 0.0, 1.0]]))[0]
    angle = math.degrees(math.acos(min(axis[2], 1.0)))
    if angle < _UPRIGHT_DEG:
        return "none: the sensor stands upright"
    bearing = math.degrees(math.atan2(axis[1], axis[0]))
    names = {0: "ahead, in the direction of travel", 90: "+y, left of the direction of travel"}
    names |= {180: "back, against the direction of travel", -90: "-y, right of the direction of travel"}
    nearest = min(names, key=lambda name: abs((bearing - name + 180.0) % 360.0 - 180.0))
    off = (bearing - nearest + 180.0) % 360.0 - 180.0
    turned = "" if abs(off) < 0.5 else f", {abs(off):.0f} deg {'counter-' if off > 0 else ''}clockwise of it"
    return f"{angle:.1f} deg forward and down towards {names[nearest]}{turned}"


def _checks(site: Site, pose: Pose):
    dip_zero, dip_quarter = (_dip_deg(pose, axis) for axis in ([0.0, 1.0, 0.0], [1.0, 0.0, 0.0]))
    return [
        f"- Inclinometer on the sensor's base: a fall of {dip_zero:.1f} deg towards zero azimuth and of",
        f"  {dip_quarter:.1f} deg a quarter turn clockwise from it (a negative fall is a rise).",
        f"- {_lowest_beam(site, pose)}",
        f"- Rotation rate {site.observation.lattice.rotation_hz:g} Hz.",
        f"- {_obstacles(site)}",
        "- blind_zones.png shows where vehicles stay below the threshold.",
    ]


def _obstacles(site: Site):
    standing = site.observation.scenery
    if standing is None or not len(standing.scenery):
        return "Poles, signs, trees and barriers between the sensor and the lanes are not in the model: look for them."
    return "Look for poles, signs, trees and barriers between the sensor and the lanes that the scene does not have."


def _dip_deg(pose, sensor_axis):
    """How far an axis of the sensor points below the horizon [deg]."""
    return -math.degrees(math.asin(pose.to_world(np.array([sensor_axis]))[0, 2])) + 0.0


def _lowest_beam(site, pose):
    """Where the lowest ring meets the ground in the direction of zero azimuth."""
    lowest = float(site.model.elevation_rad[0])
    ray = pose.to_world(np.array([[0.0, math.cos(lowest), math.sin(lowest)]]))[0]
    if ray[2] >= 0:
        return "At zero azimuth the lowest ring does not meet the ground."
    reach = -pose.height_m * math.hypot(ray[0], ray[1]) / ray[2]
    return f"At zero azimuth the lowest ring meets the ground {reach:.1f} m from the pole: put a target there."


def _expected(result):
    """What to expect, on the frames that did not choose the mounting where there are any."""
    held_out = result["holdout"] is not None
    found, base, metric = result, result["baseline"], metric_named(result["metric"])
    if held_out:
        found, base = found["holdout"], base["holdout"]
    lines = [
        "Expected, on held-out traffic" if held_out else "Expected, on the traffic that chose the mounting",
        f"- vehicles at or above the threshold: {100 * found['detectable_share']:.1f} % "
        f"(baseline {100 * base['detectable_share']:.1f} %)",
        *([] if metric is PE_VGOP else [f"- the objective is {objective_text(result)}"]),
        f"- objective per vehicle: {metric.amount(found['objective_per_vehicle'])} "
        f"(baseline {metric.number(base['objective_per_vehicle'])})",
    ]
    if held_out and found["interval_90"]:
        low, high = found["interval_90"]
        gain = f"{metric.number(low)} to {metric.amount(high)}"
        lines.append(f"- gain over the baseline: {gain} per vehicle (90 % interval)")
    intervals = (result["map"] or {}).get("optimum_interval_90")
    if intervals:
        height, tilt = intervals["height_m"], intervals["tilt_x_deg"]
        lines += [
            f"- other traffic of this kind would put the best height between {height[0]:.1f} and {height[1]:.1f} m and",
            f"  the best tilt between {tilt[0]:.0f} and {tilt[1]:.0f} deg (90 % of resampled blocks of time)",
        ]
    return lines


def _errors(result):
    """What the installer's errors cost, and which mounting would be best without any."""
    block = result.get("tolerance")
    if block is None:
        return []
    kept, costliest = kept_text(result), costliest_text(result)
    lines = ["", f"If it hangs only nearly so: {tolerance_text(block['settings'])}"]
    lines += [f"- {line}" for line in (kept, costliest) if line]
    if block["sharp"] is not None and block["sharp"]["deployment"] != result["deployment"]:
        mount = block["sharp"]["deployment"]
        angles = f"tilt {mount['tilt_x_deg']:.1f} deg across the road, {mount['tilt_y_deg']:.1f} deg along it"
        lines += [
            f"- without any error the best mounting would be another: height {mount['height_m']:.2f} m,",
            f"  {angles}, yaw {mount['yaw_deg']:.1f} deg; this one forgives more",
        ]
    return lines


def _circumstances(site: Site):
    """What these figures hold under."""
    imperfect = imperfections_text(site.scenario.sensor.imperfections_as_table())
    scenery = scenery_text(scenery_counts(site.observation.scenery))
    return [
        *([f"- as simulated with an imperfect sensor: {imperfect}"] if imperfect else []),
        *([f"- as simulated with scenery: {scenery}"] if scenery else []),
    ]
