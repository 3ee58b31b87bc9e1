"""The case study's results for a person to read."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from .claims import claims, with_interval
from .published import SENSORS
from .sensitivity import setting_of

_SOURCE = "He, Cao, Su and Liu, arXiv 2407.17942, section V"


def report_text(result: Mapping, pictures: Sequence[str] = ()) -> str:
    """The whole report, in Markdown."""
    parts = (
        _head(result),
        _claims(result),
        _table2(result),
        _order(result),
        _near_best(result),
        _wide(result),
        _fig9(result),
        _spacing(result),
        _sensitivity(result),
        _pictures(pictures),
    )
    return "\n".join(line for part in parts for line in (*part, "")).rstrip() + "\n"


def _head(result):
    effort = result["effort"]
    lines = [
        "# The paper's case study, made again",
        "",
        f"{_SOURCE}, against blender_lidar {result['versions']['blender_lidar']}.",
        "",
        f"- Scene `{result['scene']}`, traffic `{result['traffic']}`, {result['reading']} reading, "
        f"{result['caster']}, seed {result['seed']}.",
        f"- {result['frames']} searched frames in {result['blocks']} blocks of {result['block_s']:g} s, the same for "
        f"all sensors; {result['judged_frames']} {result['judged_on']} frames judge.",
        "- Intervals are 90 %, from resampled blocks of time; probabilities are shares of the same resamples.",
        f"- Grids: {_by(effort['grid'])} heights and tilts for Table II, {_by(effort['wide_grid'])} beyond its bounds, "
        f"{_by(effort['sensitivity_grid'])} over {effort['sensitivity_frames']} frames for what is varied.",
        "- *Detectable* is a threshold on the metric (mean occupancy 0.005), not a detector's recall.",
    ]
    return lines + [f"- Note: {note}." for note in result["notes"]]


def _claims(result):
    return [
        "## What reproduces",
        "",
        "| the paper | here | verdict |",
        "|---|---|---|",
        *(f"| {claim.text} | {claim.ours} | **{claim.verdict}** |" for claim in claims(result)),
    ]


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
            f"| {_range(of['height_interval_90'], 1)} | {_range(of['tilt_interval_90'], 0)} "
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
        f"| {sensor} | {100 * near['of_the_gain']:g} % of the gain | {_range(near['height_m'], 1)} "
        f"| {_range(near['tilt_deg'], 0)} | {near['points']} | {100 * near['share_of_grid']:.1f} % |"
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


def _fig9(result):
    lines = [
        "## By distance (Fig. 9)",
        "",
        f"On the {result['judged_on']} frames; change of the detectable share in points and of the entropy in bits.",
        "",
        "| sensor | distance | vehicles | detectable | change | entropy | change |",
        "|---|---|---|---|---|---|---|",
    ]
    rows = {(row["sensor"], row["band"], row["measure"]): row for row in result["fig9"]}
    for (sensor, band, measure), share in rows.items():
        if measure == "detectable":
            bits = rows[sensor, band, "entropy_bits"]
            lines.append(
                f"| {sensor} | {band} | {share['vehicles']} "
                f"| {100 * share['baseline']:.0f} → {100 * share['optimised']:.0f} % "
                f"| {with_interval(share['change'], 0, 100.0)} "
                f"| {bits['baseline']:.3f} → {bits['optimised']:.3f} | {with_interval(bits['change'])} |"
            )
    return lines


def _spacing(result):
    lines = [
        "## RS-80: height, tilt or spacing?",
        "",
        "The change from baseline to optimum, in bits of entropy per vehicle, against a table of the same number of "
        "rings and field of view with even steps. Change = height + tilt (with even beams) + spacing.",
        "",
        "| distance | change | height | tilt | spacing | uneven less even at the baseline |",
        "|---|---|---|---|---|---|",
    ]
    effects = ("change", "height_evenly_spaced", "tilt_evenly_spaced", "spacing", "spacing_at_baseline")
    return lines + [
        f"| {row['band']} | " + " | ".join(with_interval(row[effect]) for effect in effects) + " |"
        for row in result["spacing"]
        if row["measure"] == "entropy_bits"
    ]


def _sensitivity(result):
    lines = [
        "## What the paper leaves unstated",
        "",
        "Optimum and gain over the baseline under the same setting, one setting changed at a time.",
        "",
        "| setting | changed to | " + " | ".join(SENSORS) + " |",
        "|---|---|" + "---|" * len(SENSORS),
    ]
    cells: dict[tuple[str, str], dict[str, str]] = {}
    notes = []
    for row in result["sensitivity"]:
        cells.setdefault(setting_of(row), {})[row["sensor"]] = _optimum_cell(row)
        if row["note"]:
            notes.append(f"- {row['what']} {row['value']}, {row['sensor']}: not possible here: {row['note']}")
    lines += [
        f"| {what} | {value} | " + " | ".join(of.get(sensor, "") for sensor in SENSORS) + " |"
        for (what, value), of in cells.items()
    ]
    kept = [order for order in result["sensitivity_orders"] if order["tilts_fall"]]
    of_all = len(result["sensitivity_orders"])
    said = (
        f"Tilts fall strictly with the number of beams under {len(kept)} of the {of_all} settings common to all three."
    )
    return [*lines, "", said, *_holding(result), *([""] if notes else []), *notes]


def _holding(result):
    """Under which settings the interval of a sensor's tilt holds the paper's value."""
    lines = ["", "The paper's tilt lies within the 90 % interval of ours:", ""]
    for sensor, of in result["sensors"].items():
        rows = [row for row in result["sensitivity"] if row["sensor"] == sensor and row["tilt_low_deg"] is not None]
        tilt = of["published"]["tilt_deg"]
        held = [row for row in rows if row["tilt_low_deg"] <= tilt <= row["tilt_high_deg"]]
        named = "; ".join(
            f"{' '.join(setting_of(row)).strip()} ({_range((row['tilt_low_deg'], row['tilt_high_deg']), 0)})"
            for row in held
        )
        lines.append(f"- {sensor}, {tilt:.0f} degrees: {named or 'under none of them'}")
    return lines


def _optimum_cell(row):
    if row["note"]:
        return "—"
    return f"{row['height_m']:.1f} m, {row['tilt_deg']:.0f}°, {row['gain_bits']:+.3f}"


def _pictures(pictures):
    return [] if not pictures else ["## Pictures", "", *(f"![{name}]({name})" for name in pictures)]


def _share(of):
    """The search's share of the grid's gain; nothing where the grid gains nothing."""
    if of["gain"] <= 0.0:
        return ""
    return f", {100 * (of['de_pso']['per_vehicle'] - of['baseline_per_vehicle']) / of['gain']:.1f} %"


def _by(grid):
    return " x ".join(map(str, grid))


def _range(pair, digits):
    if pair is None:
        return "too few blocks"
    low, high = (f"{end:.{digits}f}" for end in pair)
    return low if low == high else f"{low} to {high}"


def _gain(score, name):
    of = score[name]
    if "gain_over_baseline" not in of:
        return f"{of['objective_per_vehicle'] - score['baseline']['objective_per_vehicle']:+.3f} (searched frames)"
    return with_interval({"mean": of["gain_over_baseline"], "interval_90": of["interval_90"]})
