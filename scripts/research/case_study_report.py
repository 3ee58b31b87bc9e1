"""The case study's results for a person to read: a page of Markdown, and tables as CSV."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

from blender_lidar.files import to_csv
from case_study import EVEN, SENSORS
from case_study_claims import claims, with_interval


def report_text(result: Mapping) -> str:
    """The whole page."""
    judged = f"{result['judged_frames']} held-out frames in {result['judged_blocks']} blocks of time"
    fall = sum(order["tilts_fall"] for order in result["sensitivity_orders"])
    sections = (
        _head(result, judged),
        _section("What reproduces", "", ("the paper", "here", "verdict"), _claims(result)),
        _section(*_table2(result)),
        _section("The order of the optima", *_order(result)),
        _section(*_wide(result)),
        _section(
            "More",
            "`near_best.csv`: mountings that lose 1 and 5 % of the gain at most. `fig9.csv`: what is seen by distance; "
            f"{EVEN} is judged at RS-80's optimum, not at one of its own. `spacing.csv`: the change from RS-80's "
            "baseline to its optimum as what height and tilt do with even beams and what the uneven beams add; their "
            "lead is what they see more than even ones under the same mounting. `sensitivity.csv`: the optimum with "
            "one setting changed at a time; tilts fall strictly with the number of beams under "
            f"{fall} of the {len(result['sensitivity_orders'])} settings common to all three sensors.",
        ),
    )
    return "\n".join(sections)


def tables(result: Mapping) -> dict[str, str]:
    """The CSV files by name: the rows of the result, what is nested in them spread over columns."""
    optima = [
        {"sensor": sensor, **{key: value for key, value in of.items() if key not in ("map", "near_best")}}
        for sensor, of in result["sensors"].items()
    ]
    near_best = [{"sensor": sensor, **near} for sensor, of in result["sensors"].items() for near in of["near_best"]]
    return {
        "table2.csv": _csv(optima),
        "near_best.csv": _csv(near_best),
        "fig9.csv": _csv(result["fig9"]),
        "spacing.csv": _csv(result["spacing"]),
        "sensitivity.csv": _csv(result["sensitivity"]),
    }


def _csv(rows: Sequence[Mapping]) -> str:
    spread = [_spread(row) for row in rows]
    names = list(dict.fromkeys(name for row in spread for name in row))
    cells = [["" if (value := row.get(name)) is None else value for name in names] for row in spread]
    return to_csv(names, [[repr(value) if isinstance(value, float) else value for value in row] for row in cells])


def _spread(row: Mapping, before: str = "") -> dict:
    """Nested keys joined by underscores; of a pair the ends, low and high; longer lists are left out."""
    found = {}
    for key, value in row.items():
        if isinstance(value, Mapping):
            found |= _spread(value, f"{before}{key}_")
        elif isinstance(value, (list, tuple)):
            if len(value) == 2 and not isinstance(value[0], Mapping):
                found |= {f"{before}{key}_low": value[0], f"{before}{key}_high": value[1]}
        else:
            found[f"{before}{key}"] = value
    return found


def _section(title: str, text: str, head: Sequence[str] = (), rows: Iterable[Sequence[object]] = ()) -> str:
    lines = [f"## {title}", ""]
    if text:
        lines += [text, ""]
    if head:
        lines += [_line(head), "|---" * len(head) + "|", *map(_line, rows), ""]
    return "\n".join(lines)


def _line(cells: Sequence[object]) -> str:
    return f"| {' | '.join(map(str, cells))} |"


def low_to_high(pair: Sequence[float] | None, digits: int) -> str:
    """A range as text; one number where both ends look the same."""
    if pair is None:
        return "too few blocks"
    low, high = (f"{end:.{digits}f}" for end in pair)
    return low if low == high else f"{low} to {high}"


def _head(result, judged):
    effort = {name: " x ".join(map(str, of)) for name, of in result["effort"].items() if name.endswith("grid")}
    lines = [
        "# The paper's case study, made again",
        "",
        f"He, Cao, Su and Liu, arXiv 2407.17942, section V, with blender_lidar {result['versions']['blender_lidar']}.",
        "",
        f"- Scene `{result['scene']}`, traffic `{result['traffic']}`, {result['reading']} reading, "
        f"{result['caster']}, seed {result['seed']}.",
        f"- {result['frames']} searched frames in {result['blocks']} blocks of {result['block_s']:g} s, the same for "
        f"all sensors; {judged} judge.",
        "- Intervals are 90 %. Those of the optima hold the middle 90 % of the optima of resampled searched blocks, "
        "the same resamples for all sensors; probabilities of an order are shares of these. Those of gains, by "
        "distance and of the spacing are by Student's t over the held-out blocks. Each varied setting has resamples "
        "of its own.",
        f"- Grids: {effort['grid']} heights and tilts for Table II, {effort['wide_grid']} beyond its bounds, "
        f"{effort['sensitivity_grid']} over {result['effort']['sensitivity_frames']} frames for what is varied.",
        "- *Detectable* is a threshold on the metric (mean occupancy 0.005), not a detector's recall.",
        *(f"- Note: {note}." for note in result["notes"]),
        "",
    ]
    return "\n".join(lines)


def _claims(result):
    return [(claim.text, claim.ours, f"**{claim.verdict}**") for claim in claims(result)]


def _table2(result):
    head = ("sensor", "paper", "optimum", "90 % height [m]", "90 % tilt [deg]", "DE-PSO", "baseline", "optimised")
    head += ("gain", "detectable", "recall, Table III", "gain of the paper's mounting", "vehicles searched, judged")
    text = (
        "The best point of the grid is the optimum; DE-PSO stands beside it, with its share of the grid's gain on the "
    )
    text += "searched frames. Bits are per vehicle, on held-out frames."
    rows = []
    for sensor, of in result["sensors"].items():
        published, search = of["published"], of["de_pso"]
        score = {name: found["holdout"] for name, found in of["judged"].items()}
        gain = {
            name: with_interval({"mean": score[name]["gain_over_baseline"], **score[name]})
            for name in ("grid", "paper")
        }
        share = (search["per_vehicle"] - of["baseline_per_vehicle"]) / of["gain"] if of["gain"] > 0.0 else float("nan")
        rows.append(
            (
                sensor,
                f"{published['height_m']:.1f} m, {published['tilt_deg']:.0f}°",
                f"{of['height_m']:.1f} m, {of['tilt_deg']:.0f}°",
                low_to_high(of["height_interval_90"], 1),
                low_to_high(of["tilt_interval_90"], 0),
                f"{search['height_m']:.2f} m, {search['tilt_x_deg']:.1f}°, {100 * share:.1f} %",
                f"{score['baseline']['objective_per_vehicle']:+.3f}",
                f"{score['grid']['objective_per_vehicle']:+.3f}",
                gain["grid"],
                _percents(score["baseline"]["detectable_share"], score["grid"]["detectable_share"]),
                _percents(*published["recall_01"]),
                gain["paper"],
                f"{of['vehicles']}, {of['judged_vehicles']}",
            )
        )
    return "Table II", text, head, rows


def _percents(before, after):
    return f"{100 * before:.0f} → {100 * after:.0f} %"


def _order(result):
    if result["order"] is None:
        return "Too few blocks to resample.", (), ()
    rows = []
    for name, text in (("tilt", "tilts fall with the number of beams"), ("height", "heights rise")):
        order = result["order"][name]
        rows.append((text, f"{100 * order['strict']:.1f} %", f"{100 * (order['with_ties'] - order['strict']):.1f} %"))
        for pair in order["pairs"]:
            which = f"{name} of {pair['first']} above that of {pair['second']}"
            rows.append((which, f"{100 * pair['above']:.1f} %", f"{100 * pair['equal']:.1f} %"))
    return "Shares of the resamples.", ("order", "strictly", "with ties alone"), rows


def _wide(result):
    bounds = result["sensors"][SENSORS[0]]["wide"]["bounds"]
    title = f"Beyond the bounds: {low_to_high(bounds['height_m'], 0)} m, tilts to {bounds['tilt_x_deg'][1]:g} degrees"
    rows = []
    for sensor, of in result["sensors"].items():
        wide = of["wide"]
        on = [name for name in ("height", "tilt") if wide[f"{name}_on_bound"]]
        each = (f"{at['height_m']:g} m {at['tilt_deg']:.0f}° {at['per_vehicle']:+.3f}" for at in wide["by_height"])
        optimum = f"{wide['height_m']:.1f} m, {wide['tilt_deg']:.0f}°"
        rows.append(
            (sensor, optimum, f"{wide['gain']:.3f}", f"{of['gain']:.3f}", ", ".join(on) or "no", ", ".join(each))
        )
    return title, "", ("sensor", "optimum", "gain", "within the bounds", "on the bound", "best tilt by height"), rows
