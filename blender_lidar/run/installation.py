"""What the person on the ladder needs: where the LiDAR goes, which way it leans, and what to check."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from ..casting.protocol import StandingScenery
from ..metrics.catalogue import PE_VGOP, metric_named
from ..scene.scenario import pose_at
from ..scene.site import Site
from ..sensors.pose import Pose

COORDINATE_NAMES = {
    "height_m": ("height", "m"),
    "tilt_x_deg": ("tilt across the road", "deg"),
    "tilt_y_deg": ("tilt along the road", "deg"),
    "yaw_deg": ("yaw", "deg"),
    "x_m": ("x along the road", "m"),
    "y_m": ("y across the road", "m"),
}

# --- What a score holds under besides the mounting: how imperfect the sensor was, and what stood in its way -


def imperfections_text(imperfections: Mapping[str, float | None]) -> str:
    """What is imperfect about a sensor, in a few words; empty where nothing is.

    `imperfections` is what `SensorSettings.imperfections_as_table` gives and result.json keeps.
    """
    texts = []
    if imperfections["range_noise_m"]:
        texts.append(f"range noise {imperfections['range_noise_m']:g} m")
    if imperfections["dropout"]:
        texts.append(f"drop-out {100 * imperfections['dropout']:g} %")
    glass = imperfections.get("glass_dropout", 0.0)  # results of earlier versions do not say
    if glass:
        texts.append(f"drop-out on glass {100 * glass:g} %")
    if imperfections["range_noise_m"] or imperfections["dropout"] or 0.0 < glass < 1.0:
        texts.append(f"noise seed {imperfections['noise_seed']}")
    if imperfections.get("range_at_10_percent_m") is not None:
        texts.append(f"a 10 % target seen to {imperfections['range_at_10_percent_m']:g} m")
    if imperfections["unit_spread_deg"]:
        spread = imperfections["unit_spread_deg"]
        texts.append(f"unit {imperfections['unit']} of units that differ by {spread:g} deg")
    return ", ".join(texts)


def scenery_counts(standing: StandingScenery | None) -> dict[str, int] | None:
    """Objects and triangles of the scenery within reach, for result.json; None where the scene has none."""
    if standing is None:
        return None
    return {"objects": len(np.unique(standing.scenery.owner)), "triangles": len(standing.scenery)}


def scenery_text(counts: Mapping[str, int] | None) -> str:
    """How much scenery stood there, in a few words; empty where the scene has none."""
    if counts is None:
        return ""
    objects, triangles = counts["objects"], counts["triangles"]
    plural = ("s" * (objects != 1), "s" * (triangles != 1))
    return f"{objects:,} object{plural[0]}, {triangles:,} triangle{plural[1]} within reach"


# --- What an objective adds up, in words ------------------------------------------------------------------


def objective_text(result: Mapping) -> str:
    """What the objective of a run adds up; `result` is the content of result.json."""
    metric, loss = metric_named(result["metric"]), result["identity"]["[objective] loss"]
    if loss is not None and result["reading"] != "corrected":
        instead = "" if metric is PE_VGOP else f", with {_merit(metric)} in place of the entropy"
        return f"Eq. 10 of the paper as printed{instead}"
    if loss is None:
        if metric.of_scene:
            return f"{_merit(metric)}, of the scene of each frame, once for every vehicle in it"
        return f"{_merit(metric)} of every vehicle, detectable or not"
    unit = metric.unit.removesuffix("s") if abs(loss) == 1 else metric.unit
    return f"{_merit(metric)} of every detectable vehicle, less {f'{abs(loss):g} {unit}'.rstrip()} for every other one"


def _merit(metric):
    """The metric, with its sign turned where lower is better."""
    return f"{'' if metric.higher_is_better else 'minus '}the {metric.label}"


# --- What an installer's errors do to a mounting, as sentences --------------------------------------------

_WIDTHS = {"height_m": "height_m", "tilt_x_deg": "tilt_deg", "tilt_y_deg": "tilt_deg", "yaw_deg": "yaw_deg"}


def tolerance_text(settings: Mapping) -> str:
    """How far off its plan a mounting may end up; `settings` is what result.json has of a `Tolerance`."""
    widths = (("height_m", "m of height"), ("tilt_deg", "deg of either tilt"), ("yaw_deg", "deg of yaw"))
    return ", ".join(f"+/-{settings[key]:g} {what}" for key, what in widths if settings[key])


def aim_text(settings: Mapping) -> str:
    """What of the objective over these errors counts."""
    return "mean" if settings["aim"] == "mean" else "what nine of ten installations reach"


def tolerance_notes(result: Mapping) -> list[str]:
    """What robustness costs and gains, what is kept, and which error matters most; none where there was no tolerance.

    `result` is the content of result.json.
    """
    if result.get("tolerance") is None:
        return []
    notes = [kept_text(result), costliest_text(result)]
    if result["tolerance"]["sharp"] is not None:
        notes.append(_against_sharp(result))
    return [f"{note[0].upper()}{note[1:]}." for note in notes if note]


def kept_text(result: Mapping) -> str:
    """How much of its gain the mounting keeps; empty where it has none."""
    scores, where = _judged(result)
    if scores["gain_kept"] is None:
        return ""
    settings = result["tolerance"]["settings"]
    return (
        f"within {tolerance_text(settings)} the mounting keeps {100 * scores['gain_kept']:.0f} % of its gain "
        f"({aim_text(settings)}, {where})"
    )


def costliest_text(result: Mapping) -> str:
    """Which single error at its limit costs most; empty where none costs anything."""
    settings, (scores, where) = result["tolerance"]["settings"], _judged(result)
    ends = [
        (loss, key, sign)
        for key, losses in scores["loss_at_limits"].items()
        if key in _WIDTHS
        for loss, sign in zip(losses, "-+", strict=True)
    ]
    loss, key, sign = max(ends, default=(0.0, "", ""))
    if loss <= 0.0:
        return ""
    (name, unit), width = COORDINATE_NAMES[key], settings[_WIDTHS[key]]
    lost = metric_named(result["metric"]).amount(loss)
    return f"of the single errors {name} {sign}{width:g} {unit} costs most: {lost} per vehicle ({where})"


def _against_sharp(result: Mapping) -> str:
    """What robustness costs where all hangs as planned, and what it gains where it does not."""
    block, metric = result["tolerance"], metric_named(result["metric"])
    if block["sharp"]["deployment"] == result["deployment"]:
        return "the search over the tolerance found no better mounting than the sharp one"
    held = block["robust"]["optimised"]["holdout"]
    if held is None or "over_sharp" not in held:
        return ""
    parts = []
    for name, where in (("as_planned", "as planned"), ("over_tolerance", "over the tolerance")):
        difference = held["over_sharp"][name]
        told = metric.amount(difference["objective_per_vehicle"], sign="+")
        if difference["interval_90"]:
            low, high = (metric.number(end, 0, "+") for end in difference["interval_90"])
            told += f" (90 %: {low} to {high})"
        parts.append(f"{where} {told}")
    return f"beside the sharp mounting the robust one has, per vehicle on held-out frames, {' and '.join(parts)}"


def _judged(result: Mapping) -> tuple[Mapping, str]:
    """Scores of the mounting over the tolerance where it is judged, and which frames that is."""
    scores = result["tolerance"]["robust"]["optimised"]
    if scores["holdout"] is not None:
        return scores["holdout"], "held-out frames"
    return scores, "scored frames" if result["search"] is None else "searched frames"


# --- The installation sheet -------------------------------------------------------------------------------------------

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
    """Height, position, lean and yaw: one mounting as it is measured on site."""
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
    """How far beside the carriageway the pole stands, and on which side."""
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
    """What an installer can measure: falls of the base, where the lowest ring lands, rate of rotation, obstacles."""
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
    """What to look for between sensor and lanes: what the model does not have."""
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
    if sentence := optimum_text(result["map"] or {}):
        lines.append("- " + sentence.replace(" and the best", " and\n  the best"))
    return lines


def optimum_text(score_map: Mapping) -> str:
    """Between what heights and tilts the optimum lies with other traffic; empty where no interval is known."""
    intervals = score_map.get("optimum_interval_90")
    if not intervals:
        return ""
    height, tilt = intervals["height_m"], intervals["tilt_x_deg"]
    return (
        f"other traffic of this kind would put the best height between {height[0]:.1f} and {height[1]:.1f} m and "
        f"the best tilt between {tilt[0]:.0f} and {tilt[1]:.0f} deg (90 % of resampled blocks of time)"
    )


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
