"""What commissioning found, for people: the text, the sheet for the crew at the mast, and a picture."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..statistics import FEWEST_BLOCKS
from ..studies.commission import FEWEST_CLOUDS
from ..studies.road_fit import Z_90
from .figure import INK, sheet
from .text import text_table

if TYPE_CHECKING:
    from ..studies.commission import Commissioned

_COORDINATES = {
    "height_m": ("height above the road", "m", 2),
    "tilt_x_deg": ("tilt: straight ahead looks down", "deg", 2),
    "tilt_y_deg": ("tilt: its right looks up", "deg", 2),
    "yaw_deg": ("yaw against the road", "deg", 1),
}
_WIDTH = 110
_EXACT_DEG = 0.003  # of rings on a road: less is the fit's own
_TOLD = (
    "The leans are against the road: points do not show the plumb line, so that a lean across the road and its "
    "cross-fall, or a lean along it and its grade, are one number.",
    "The height is above the road's surface under the LiDAR, prolonged where that is hidden.",
)


def commission_text(result: Mapping) -> str:
    """The findings for a terminal; `result` as commission.json has it."""
    also, clouds = " or ".join(result["as_possible"]), result["clouds"]
    of = f"the background of {clouds} clouds" if clouds >= FEWEST_CLOUDS else f"the first of {clouds} clouds"
    left_out = f"; {result['left_out']:,} points were no returns" if result["left_out"] else ""
    lines = [
        f"Sensor     {result['sensor']}, {100.0 * result['on_rings']:.0f} % of the points on its rings"
        + (f"; {also} would fit as well" if also else ""),
        f"Cloud      {result['points']:,} points" + (f", {of}" if clouds > 1 else "") + left_out,
        f"Direction  of the road by {result['direction_from'] or 'nothing that is seen: as planned, or the x axis'}",
        "",
        *text_table(_mounting_rows(result)),
        "",
        *text_table(_road_rows(result)),
        "",
        *_wrapped([*_TOLD, *_sensor_notes(result)]),
    ]
    if plan := result.get("plan"):
        lines += ["", *_plan_lines(plan)]
    return "\n".join(lines)


def _wrapped(texts) -> list[str]:
    return [line for text in texts for line in textwrap.wrap(text, _WIDTH)]


def _number(value: float, digits: int) -> str:
    return f"{round(value, digits) + 0.0:.{digits}f}"


def _interval(ends, digits: int) -> str:
    return " to ".join(_number(end, digits) for end in ends)


def _mounting_rows(result):
    several = result["clouds"] > 1
    rows = [("Mounting", "", "90 % interval", "of it systematic", *(["sd of clouds"] * several))]
    for key, one in result["mounting"].items():
        name, unit, digits = _COORDINATES[key]
        spread = one.get("sd_of_clouds")
        rows.append(
            (
                f"  {name} [{unit}]",
                _number(one["value"], digits),
                _interval(one["interval_90"], digits),
                f"+/-{Z_90 * one['systematic']:.{digits}f}",
                *(["-" if spread is None else f"{spread:.{digits + 1}f}"] * several),
            )
        )
    return rows


def _road_rows(result):
    rows = [("Road, from the right", "y [m]", "cross-fall [%]", "height above it at y = 0 [m]")]
    for one in result["carriageways"]:
        fall = one["cross_fall_percent"]
        way = f"{abs(fall):.1f} to the {'right' if fall > 0.0 else 'left'}" if abs(fall) >= 0.05 else "level"
        rows.append(("  smooth strip", _interval(one["y_m"], 1), way, f"{one['above_m']:.2f}"))
    return rows


def _sensor_notes(result) -> list[str]:
    """What else the cloud says of the sensor."""
    notes = []
    if abs(result["lens_m"]) >= 0.01:
        notes.append(
            f"The optical centre lies {1000.0 * result['lens_m']:.0f} mm off the axis, towards where each beam looks."
        )
    low, high = result["range_error_m"]["interval_90"]
    if low > 0.0 or high < 0.0:
        notes.append(
            f"All ranges seem {1000.0 * result['range_error_m']['value']:.0f} mm too long "
            f"({1000.0 * low:.0f} to {1000.0 * high:.0f})."
        )
    for first, last in result["blind_sectors_deg"]:
        notes.append(
            f"Nothing returned from {first:.0f} to {last:.0f} degrees clockwise of straight ahead, where the road is "
            "in reach."
        )
    if result["dead_rings"]:
        notes.append(f"Rings with next to no returns: {', '.join(map(str, result['dead_rings']))} (0 is the lowest).")
    unit = result["unit"]
    before, after, halves = (unit[key] for key in ("off_before_deg", "off_after_deg", "learnt_and_judged_on"))
    if before is None:
        notes.append("Too few rings see both halves of the road for corrections of this unit's beams.")
    elif before < _EXACT_DEG:
        notes.append(f"The rings lie on the road to {before:.3f} degrees: there is nothing to correct.")
    else:
        worth = (
            f"take their error from {before:.3f} to {after:.3f} degrees" if after < before else "make them no better"
        )
        notes.append(
            f"Elevations of {unit['rings']} rings were learnt from the road; on the half of it that did not teach them "
            f"({halves}) the corrections {worth}."
        )
    return notes


def _plan_lines(plan) -> list[str]:
    rows = [("Against the plan", "planned", "measured", "differs by", "90 % interval")]
    for key, off in plan["differences"].items():
        name, unit, digits = _COORDINATES[key]
        sign = f"{off['value']:+.{digits}f}" + ("" if _differs(off) else " (within it)")
        rows.append(
            (
                f"  {name} [{unit}]",
                *(_number(plan[of][key], digits) for of in ("planned", "measured")),
                sign,
                _interval(off["interval_90"], digits),
            )
        )
    return [*text_table(rows), "", *_wrapped([_cost(plan["detectable_share"])]), *_wrapped(_corrections(plan))]


def _differs(off: Mapping) -> bool:
    low, high = off["interval_90"]
    return low > 0.0 or high < 0.0


def _cost(share: Mapping) -> str:
    """What hanging otherwise costs, with its interval."""
    on = "held-out traffic" if share["held_out"] else "the traffic that chose the plan"
    measured, planned = (f"{100.0 * share[key]:.1f} %" for key in ("measured", "planned"))
    text = f"Detectable on {on}: {measured} as it hangs, {planned} as planned"
    if share["interval_90"] is None:
        return f"{text}; fewer than {FEWEST_BLOCKS} blocks of time give no interval."
    low, high = (100.0 * end for end in share["interval_90"])
    verdict = (
        "no difference is shown" if low <= 0.0 <= high else ("it costs vehicles" if high < 0.0 else "it gains vehicles")
    )
    gain = f"{100.0 * share['gain']:+.1f} points (90 % interval over traffic {low:+.1f} to {high:+.1f})"
    return f"{text}: {gain}, {verdict}. This is of the mounting as measured; its own interval is not in it."


_MOST_TURNED_DEG = 45.0  # no crew is so far off, but axes are


def _corrections(plan) -> list[str]:
    """What to do at the mast for what differs beyond its interval."""
    found, off, falls = [], plan["differences"], plan["falls_deg"]
    turn = -off["yaw_deg"]["value"] if "yaw_deg" in off else 0.0
    if abs(turn) > _MOST_TURNED_DEG:
        return [
            f"The yaw is {abs(turn):.0f} degrees off the plan: is --axes right? There is no correction until it is."
        ]
    if _differs(off["height_m"]):
        up = -off["height_m"]["value"]
        found.append(f"{'Raise' if up > 0.0 else 'Lower'} the sensor by {100.0 * abs(up):.0f} cm.")
    sides = ("tilt_x_deg", "of zero azimuth"), ("tilt_y_deg", "a quarter turn clockwise from it")
    for (key, side), planned, measured in zip(sides, falls["planned"], falls["measured"], strict=True):
        if _differs(off[key]):
            down = planned - measured
            found.append(f"{'Lower' if down > 0.0 else 'Raise'} the side {side} by {abs(down):.1f} degrees.")
    if "yaw_deg" in off and _differs(off["yaw_deg"]):
        way = "counter-clockwise" if turn > 0.0 else "clockwise"
        found.append(f"Turn the sensor by {abs(turn):.1f} degrees {way}, seen from above.")
    return found or ["Nothing differs beyond its interval: there is nothing to correct."]


def correction_sheet(result: Mapping) -> str:
    """The sheet for the crew at the mast, as plain text; `result` as commission.json has it, with a plan."""
    plan = result["plan"]
    lines = [f"Correction of the {result['sensor']}", "", *(f"- {one}" for one in _corrections(plan)), "", "Then check"]
    ahead, right = (round(fall, 1) + 0.0 for fall in plan["falls_deg"]["planned"])
    lines += [
        f"- Inclinometer on the sensor's base: a fall of {ahead:.1f} deg towards zero azimuth and of",
        f"  {right:.1f} deg a quarter turn clockwise from it (a negative fall is a rise).",
        f"- {plan['planned']['height_m']:.2f} m from the road surface to the optical centre of the sensor.",
        "- Record a revolution again, and commission it.",
        "",
        *_wrapped([_cost(plan["detectable_share"]), *_TOLD]),
    ]
    return "\n".join(lines) + "\n"


def draw_commission(path: Path, found: Commissioned, result: Mapping) -> None:
    """Draw the road's section under the LiDAR, and the errors of its rings.

    Raises
    ------
    MissingExtraError
        When matplotlib is not installed.
    """
    fit = found.fit
    road = fit.pose.to_world(found.points) + fit.pose.position
    near = (np.hypot(road[:, 0], road[:, 1]) < 45.0) & (road[:, 2] < fit.pose.height_m + 0.5) & (road[:, 2] > -1.5)
    edges = [edge for one in fit.carriageways for edge in one.y_m]
    low, high = min(-2.0, *edges) - 4.0, max(2.0, *edges) + 4.0
    subtitle = f"{result['sensor']}, {fit.pose.height_m:.2f} m above the road"
    with sheet(path, 95.0, "The road as the LiDAR sees it, and its rings", subtitle) as figure:
        section, rings = figure.subplots(1, 2, width_ratios=(3, 2))
        look = {"s": 0.6, "linewidths": 0.0, "rasterized": True}
        for which, colour, label in (
            (near & ~fit.ground, "#b9b9b9", "other points"),
            (near & fit.ground, "#173f70", "road, as fitted"),
        ):
            section.scatter(road[which, 1], road[which, 2], color=colour, label=label, **look)
        for one in fit.carriageways:
            y = np.array(one.y_m)
            section.plot(y, fit.pose.height_m - one.above_m + one.slope * y, color="#cf7f1b", linewidth=1.0)
        section.plot(0.0, fit.pose.height_m, marker="D", color=INK, markersize=5.0, linestyle="none", label="LiDAR")
        section.set(
            xlim=(low, high), ylim=(-1.5, fit.pose.height_m + 0.6), xlabel="Across the road, y [m]", ylabel="Height [m]"
        )
        section.legend(markerscale=4.0)
        known = np.isfinite(fit.ring_sd_rad)
        elevation, error = np.degrees(found.model.elevation_rad[known]), np.degrees(-fit.ring_error_rad[known])
        bars = Z_90 * np.degrees(fit.ring_sd_rad[known])
        rings.errorbar(elevation, error, yerr=bars, fmt="o", color="#173f70", markersize=2.5, linewidth=0.8)
        rings.axhline(0.0, color=INK, linewidth=0.8)
        rings.set(
            xlabel="Elevation by the table [deg]",
            ylabel="Correction [deg], 90 % interval",
            title="Rings that see the road",
        )
        rings.grid(visible=True)
