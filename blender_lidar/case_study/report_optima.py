"""The report's sections on the optima: Table II, their order, mountings as good, and beyond the bounds."""

from __future__ import annotations

from collections.abc import Mapping

from .published import SENSORS
from .verdicts import low_to_high, with_interval


def optima_sections(result: Mapping) -> list[list[str]]:
    """The sections, each as lines of Markdown."""
    return [_table2(result), _order(result), _near_best(result), _wide(result)]


def _table2(result):
    lines = [
        "## Table II",
        "",
        "The best point of the grid is the optimum; the scene's search stands beside it, with its share of the gain on "
        "the searched frames: over 100 % where it finds a better mounting between the grid's points. Bits are per "
        "vehicle.",
        "",
        "| sensor | paper | optimum | 90 % height [m] | 90 % tilt [deg] | DE-PSO | baseline | optimised | gain, "
        f"{result['judged_on']} | detectable | the paper's mounting, gain | vehicles searched, judged |",
        "|---|---|---|---|---|---|---|---|---|---|---|---|",
    ]
    for sensor, of in result["sensors"].items():
        published, search, judged = of["published"], of["de_pso"], of["judged"]
        score = {name: judged[name]["holdout"] or judged[name] for name in judged}
        lines.append(
            f"| {sensor} | {published['height_m']:.1f} m, {published['tilt_deg']:.0f}° "
            f"| {of['height_m']:.1f} m, {of['tilt_deg']:.0f}° "
            f"| {low_to_high(of['height_interval_90'], 1)} | {low_to_high(of['tilt_interval_90'], 0)} "
            f"| {search['height_m']:.2f} m, {search['tilt_x_deg']:.1f}°{_share(of)} "
            f"| {score['baseline']['objective_per_vehicle']:+.3f} | {score['grid']['objective_per_vehicle']:+.3f} "
            f"| {_gain(score, 'grid')} "
            f"| {100 * score['baseline']['detectable_share']:.0f} → {100 * score['grid']['detectable_share']:.0f} % "
            f"| {_gain(score, 'paper')} | {of['vehicles']}, {of['judged_vehicles']} |"
        )
    recalls = ", ".join(
        f"{sensor} {of['published']['recall_01'][0]:.2f} → {of['published']['recall_01'][1]:.2f}"
        for sensor, of in result["sensors"].items()
    )
    return [*lines, "", f"The paper's recall at confidence 0.1 (Table III), another measure: {recalls}."]


def _order(result):
    lines = ["## The order of the optima", ""]
    if result["order"] is None:
        return [*lines, "Too few blocks to resample."]
    for name, text in (("tilt", "tilts falling"), ("height", "heights rising")):
        order = result["order"][name]
        lines.append(
            f"- {text} with the number of beams: strictly in {100 * order['strict']:.1f} % of {order['resamples']} "
            f"resamples, in {100 * order['with_ties']:.1f} % if ties count"
        )
        lines += [
            f"  - {pair['first']} above {pair['second']}: {100 * pair['above']:.1f} %, "
            f"equal {100 * pair['equal']:.1f} %"
            for pair in order["pairs"]
        ]
    return lines


def _near_best(result):
    lines = [
        "## Mountings as good as the best",
        "",
        "| sensor | loses at most | heights [m] | tilts [deg] | points | share of the grid |",
        "|---|---|---|---|---|---|",
    ]
    return lines + [
        f"| {sensor} | {100 * near['of_the_gain']:g} % of the gain | {low_to_high(near['height_m'], 1)} "
        f"| {low_to_high(near['tilt_deg'], 0)} | {near['points']} | {100 * near['share_of_grid']:.1f} % |"
        for sensor, of in result["sensors"].items()
        for near in of["near_best"]
    ]


def _wide(result):
    first = result["sensors"][SENSORS[0]]["wide"]
    low, high = first["bounds"]["height_m"]
    lines = [
        f"## Beyond the bounds: {low:g} to {high:g} m, tilts up to {first['bounds']['tilt_x_deg'][1]:g} degrees",
        "",
        "| sensor | optimum | on the bound | best tilt at each height |",
        "|---|---|---|---|",
    ]
    for sensor, of in result["sensors"].items():
        wide = of["wide"]
        on = [name for name in ("height", "tilt") if wide[f"{name}_on_bound"]]
        each = ", ".join(
            f"{at['height_m']:g} m {at['tilt_deg']:.0f}° {at['per_vehicle']:+.3f}" for at in wide["by_height"]
        )
        lines.append(
            f"| {sensor} | {wide['height_m']:.1f} m, {wide['tilt_deg']:.0f}°, gain {wide['gain']:.3f} bits "
            f"(within the paper's bounds {of['gain']:.3f}) | {' and '.join(on) or 'no'} | {each} |"
        )
    return lines


def _share(of):
    """The search's share of the grid's gain; nothing where the grid gains nothing."""
    if of["gain"] <= 0.0:
        return ""
    return f", {100 * (of['de_pso']['per_vehicle'] - of['baseline_per_vehicle']) / of['gain']:.1f} %"


def _gain(score, name):
    of = score[name]
    if "gain_over_baseline" not in of:
        return f"{of['objective_per_vehicle'] - score['baseline']['objective_per_vehicle']:+.3f} (searched frames)"
    return with_interval({"mean": of["gain_over_baseline"], "interval_90": of["interval_90"]})
