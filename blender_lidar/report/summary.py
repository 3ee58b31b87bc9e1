"""What a run found, as rows and sentences: the command line prints them, the page sets them."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ..metrics.catalogue import METRICS, metric_named
from ..metrics.metric import Metric
from ..optimise import vehicle_score
from ..run.installation import COORDINATE_NAMES, aim_text, kept_text, optimum_text, tolerance_notes, tolerance_text
from ..run.verdict import metric_values

# --- What a run comes to, in one sentence -----------------------------------------------------------------

_LEVEL_DEG = 0.05  # a smaller angle cannot be set on site
_NO_BREAK = "\N{NO-BREAK SPACE}"
_UNITS = "|".join(sorted({re.escape(metric.unit) for metric in METRICS.values() if metric.unit}, reverse=True))
_SPACE_BEFORE_UNIT = re.compile(rf"(?<=\d) (?=%|(?:m|{_UNITS})(?!\w))")


def answer(result: Mapping) -> str:
    """The mounting and what it is worth against the baseline, with the interval where there is one."""
    forgives = "" if result.get("tolerance") is None else kept_text(result)
    told = f"{_what_to_do(result)}: {_worth(result)}." + (f" {forgives[0].upper()}{forgives[1:]}." if forgives else "")
    return _SPACE_BEFORE_UNIT.sub(_NO_BREAK, told)


def key_figures(result: Mapping) -> list[tuple[str, str]]:
    """The few figures that matter, each with what it is."""
    mount, (found, base, on), metric = result["deployment"], _judges(result), metric_named(result["metric"])
    figures = [
        ("height above the road", f"{mount['height_m']:.2f} m"),
        ("tilt across the road", minus(f"{mount['tilt_x_deg']:.1f}°")),
        (f"detectable on {on}", f"{100 * base['detectable_share']:.1f} \N{RIGHTWARDS ARROW} {_percent(found)}"),
    ]
    gain = "gain per vehicle"
    if found.get("interval_90"):
        low, high = found["interval_90"]
        gain += f" (90 %: {minus(f'{metric.number(low)} to {metric.number(high)}')})"
    figures.append((gain, minus(metric.amount(_gain(found, base), sign="+"))))
    return [(_SPACE_BEFORE_UNIT.sub(_NO_BREAK, what), figure) for what, figure in figures]


def minus(text: str) -> str:
    """A number's text with a minus that is as wide as a plus."""
    return text.replace("-", "\N{MINUS SIGN}")


def _what_to_do(result):
    """The sentence's beginning: hang it there, or that nothing tried is better than the baseline."""
    sensor, place = result["sensor"], _place(result["deployment"])
    if not was_searched(result):
        return f"The {sensor} {place}"
    if not better_than_baseline(result):
        return f"No mounting that was tried is better than the baseline; the best of them has the {sensor} {place}"
    return f"Hang the {sensor} {place}"


def _place(mount):
    """Where a mounting hangs and how it leans, in words; coordinates that are nought are left out."""
    tilts = {"tilt_x_deg": "across it", "tilt_y_deg": "along it"}
    leaning = [f"{mount[key]:.1f}° {way}" for key, way in tilts.items() if abs(mount[key]) >= _LEVEL_DEG]
    parts = [f"{mount['height_m']:.2f} m above the road", f"tilted {' and '.join(leaning)}" if leaning else "level"]
    if abs(mount["yaw_deg"]) >= _LEVEL_DEG:
        parts.append(f"turned {mount['yaw_deg']:.1f}°")
    if mount["x_m"] or mount["y_m"]:
        parts.append(f"at x {mount['x_m']:.2f} m and y {mount['y_m']:.2f} m")
    return minus(", ".join(parts))


def _worth(result):
    """What the mounting is worth against the baseline where both are judged, on held-out frames if there are any."""
    found, base, on = _judges(result)
    gain, metric = _gain(found, base), metric_named(result["metric"])
    return (
        f"on {on} {_percent(found)} of the vehicles are detectable instead of {_percent(base)} under the baseline, and "
        f"{_gained(metric, gain)}{_interval(result, metric, gain)}"
    )


def _gained(metric, gain):
    """What the mounting is worth to a vehicle."""
    amount = f"{'gains' if gain >= 0.0 else 'loses'} {metric.amount(abs(gain))}"
    # A vehicle that gains metres or nats would sound like the reverse of what is meant where lower is better, and what
    # a scene gains is not a vehicle's.
    of_vehicles = metric.higher_is_better and not metric.of_scene
    return f"a vehicle {amount}" if of_vehicles else f"the objective {amount} per vehicle"


def _interval(result, metric, gain):
    """The 90 % interval of the gain and what doubt it leaves, or why there is none."""
    if result["holdout"] is None:
        return "; nothing was held out, so that there is no interval"
    if result["holdout"]["interval_90"] is None:
        return "; there are too few blocks of time for an interval"
    low, high = result["holdout"]["interval_90"]
    doubt = "" if low > 0.0 or high < 0.0 else f", so that there may be no {'gain' if gain >= 0.0 else 'loss'} at all"
    return f" (90 % interval of the gain {minus(f'{metric.number(low)} to {metric.number(high)}')}{doubt})"


def _judges(result):
    """Scores of the mounting and of the baseline where they are judged, and what traffic that is."""
    if result["holdout"] is not None:
        return result["holdout"], result["baseline"]["holdout"], "held-out traffic"
    return result, result["baseline"], "the traffic that chose it" if was_searched(result) else "the scored traffic"


def _gain(found, base):
    """Objective per vehicle over that of the baseline, in the metric's unit."""
    return found["objective_per_vehicle"] - base["objective_per_vehicle"]


def _percent(scores):
    """The detectable share in per cent."""
    return f"{100 * scores['detectable_share']:.1f} %"


# --- The mountings of a run side by side, as rows: the command line prints them, the page sets them -------

_ALWAYS_SHOWN = ("height_m", "tilt_x_deg")


Section = tuple[str, list[tuple[str, ...]]]
"""A heading, and rows: what, then a text for each of `compared_names`, "" where it has none."""


def compared_names(result: Mapping) -> tuple[str, ...]:
    """What the mountings of a run are called: the baseline, the sharp one where there is one, the run's own."""
    return ("baseline", *(("sharp",) if sharp_of(result) else ()), mounting_name(result))


def comparison_sections(result: Mapping) -> list[Section]:
    """The mountings of a run side by side; `result` is the content of result.json."""
    sharp, block = sharp_of(result), result.get("tolerance")
    compared = [result["baseline"], *([sharp] if sharp else []), result]
    mounts = [scores["deployment"] for scores in compared]
    mounting = [
        (f"{name} [{unit}]", *(f"{mount[key]:.2f}" for mount in mounts))
        for key, (name, unit) in COORDINATE_NAMES.items()
        if key in _ALWAYS_SHOWN or any(mount[key] for mount in mounts)
    ]
    sections = [("Mounting", mounting), *_score_sections(result, compared)]
    if block is not None:
        compared = [block["robust"][name] for name in ("baseline", "sharp", "optimised") if name in block["robust"]]
        over = f", {tolerance_text(block['settings'])}: {aim_text(block['settings'])}"
        sections += _score_sections(result, compared, over, "gain over the baseline as planned")
    return sections


def _score_sections(
    result: Mapping, compared: Sequence[Mapping], over: str = "", gain: str = "gain per vehicle"
) -> list[Section]:
    """Scores on the searched frames and on the held-out ones; `over` names a tolerance that they are over."""
    metric = metric_named(result["metric"])
    kept = [_kept_row(compared)] if over else []
    total = (
        [] if over else [(metric.in_unit("objective"), *(metric.number(each["objective"], -2) for each in compared))]
    )
    chosen_on = "Searched" if was_searched(result) else "Scored"
    sections = [(f"{chosen_on} frames{over}", [*total, *_score_rows(metric, compared), *kept])]
    if result["holdout"]:
        held = [scores["holdout"] for scores in compared]
        gains = (metric.number(scores["gain_over_baseline"], 1, "+") for scores in held[1:])
        rows = [*_score_rows(metric, held), (metric.in_unit(gain), "", *gains)]
        if held[-1]["interval_90"]:
            spans = (_span(metric, scores["interval_90"]) for scores in held[1:])
            rows.append((f"90 % interval, {result['holdout']['blocks']} blocks", "", *spans))
        sections.append((f"Held-out frames{over}", [*rows, *([_kept_row(held)] if over else [])]))
    return sections


def _kept_row(compared: Sequence[Mapping]) -> tuple[str, ...]:
    """What an error of installation leaves of each gain over the baseline, which has none itself."""
    shares = (scores["gain_kept"] for scores in compared[1:])
    return ("gain kept [%]", "", *("-" if share is None else f"{100 * share:.1f}" for share in shares))


def _score_rows(metric: Metric, compared: Sequence[Mapping]) -> list[tuple[str, ...]]:
    """Objective per vehicle and detectable share of each mounting."""
    values = (metric.number(scores["objective_per_vehicle"], 1) for scores in compared)
    shares = (f"{100 * scores['detectable_share']:.1f}" for scores in compared)
    return [(metric.in_unit("objective per vehicle"), *values), ("detectable share [%]", *shares)]


def _span(metric: Metric, pair) -> str:
    """The two ends of an interval, with their signs."""
    return " to ".join(metric.number(end, 1, "+") for end in pair)


# --- Key figures, scores of groups and cautions -----------------------------------------------------------------------

_SMALL_SHORTFALL = 0.01  # what a search may miss before more of it is advised
_ON_A_BOUND = 0.01  # of the width between two bounds: a search that reflects there comes close and never upon it
_SPLITS = ("search", "holdout")

Table = Mapping[str, np.ndarray]


@dataclass(frozen=True, slots=True)
class GroupScores:
    """Scores of groups of vehicles, before and after.

    Attributes
    ----------
    measure : str
        What the objective is told in: the metric's unit, or that it is the objective where that has none.
    splits : list of str
        ``"searched"`` or ``"scored"``, and ``"held out"`` where anything was.
    rows : list of (str, list of str, int)
        A group's name; for each split the objective per vehicle before and after, then detectable per cent before and
        after, ``"-"`` where it has no vehicle or the objective is the whole scene's; how many vehicles it has in all
        splits.
    """

    measure: str
    splits: list[str]
    rows: list[tuple[str, list[str], int]]


def was_searched(result: Mapping) -> bool:
    """Whether a search chose the mounting; otherwise it was given."""
    return result["search"] is not None


def mounting_name(result: Mapping) -> str:
    """What the run's mounting is called beside the baseline, and beside the sharp one where it had a tolerance."""
    if not was_searched(result):
        return "given"
    return "optimised" if sharp_of(result) is None else "robust"


def sharp_of(result: Mapping) -> Mapping | None:
    """The best mounting that hangs as planned and its scores, where a search over a tolerance found the run's."""
    return (result.get("tolerance") or {}).get("sharp")  # results of earlier versions have no such block


def sides(result: Mapping) -> list[tuple[str, Mapping[str, float]]]:
    """The mountings that pictures show side by side, the baseline first: what each is called, and where it hangs."""
    return [("Baseline", result["baseline"]["deployment"]), (mounting_name(result).capitalize(), result["deployment"])]


def mounting_text(mount: Mapping[str, float]) -> str:
    """A mounting in a few words."""
    parts = [f"height {mount['height_m']:.2f} m", f"tilt {mount['tilt_x_deg']:.1f}°"]
    if mount["tilt_y_deg"]:
        parts.append(f"along the road {mount['tilt_y_deg']:.1f}°")
    if mount["yaw_deg"]:
        parts.append(f"yaw {mount['yaw_deg']:.1f}°")
    return ", ".join(parts)


def group_scores(
    groups: Callable[[Table], list[tuple[str, np.ndarray]]], result: Mapping, baseline: Table, found: Table
) -> GroupScores:
    """Objective per vehicle and detectable share of each group, searched and held out, before and after.

    Parameters
    ----------
    groups : function
        Names groups of the rows of a vehicle table: `run.verdict.distance_bands` or `lanes`.
    baseline, found : vehicle tables
        The same vehicles in the same order, under the baseline and under the run's mounting.
    """
    tables = (baseline, found)
    metric, loss = metric_named(result["metric"]), result["identity"]["[objective] loss"]
    scores = [
        vehicle_score(metric.merit(metric_values(table)), table["detectable"], loss, result["reading"])
        for table in tables
    ]
    splits = [split for split in _SPLITS if (found["split"] == split).any()]
    rows = []
    for name, chosen in groups(baseline):
        cells = []
        for split in splits:
            mine = [chosen & (table["split"] == split) for table in tables]
            cells += [
                metric.number(score[rows_of].mean()) if rows_of.any() and not metric.of_scene else "-"
                for score, rows_of in zip(scores, mine, strict=True)
            ]
            cells += [
                f"{100 * table['detectable'][rows_of].mean():.1f}" if rows_of.any() else "-"
                for table, rows_of in zip(tables, mine, strict=True)
            ]
        rows.append((name, cells, int(chosen.sum())))
    names = {"search": "searched" if was_searched(result) else "scored", "holdout": "held out"}
    return GroupScores(metric.unit or "objective", [names[split] for split in splits], rows)


def cautions(result: Mapping) -> list[str]:
    """What the search and the map say about how far to trust the optimum, as sentences."""
    found = []
    if result.get("tolerance") is not None:
        found += tolerance_notes(result)
    if not was_searched(result):
        return found
    if not better_than_baseline(result):
        found.append("No mounting that was tried is better than the baseline.")
    for key, (name, _) in COORDINATE_NAMES.items():
        bounds = result["identity"][f"[deployment] {key}"]
        if isinstance(bounds, list) and not _well_within(result["deployment"][key], *bounds):
            found.append(f"The best {name} lies on a bound of [deployment]; beyond may be better.")
    if result.get("rungs"):
        found.append(_rungs_note(result))
    if result["map"]:
        found += _map_notes(result["map"], "mounting found" if sharp_of(result) is None else "sharp mounting")
    return found


def better_than_baseline(result: Mapping) -> bool:
    """Whether the mounting beats the baseline on the frames that were searched."""
    return result["objective"] > result["baseline"]["objective"]


def _well_within(value: float, low: float, high: float) -> bool:
    """Whether a coordinate is farther from both bounds than a search that reflects there would come."""
    slack = _ON_A_BOUND * (high - low)
    return low + slack < value < high - slack


def _rungs_note(result):
    """What a search from cheap to dear has scored, and what it therefore cannot tell."""
    tried = sum(rung["candidates"] for rung in result["rungs"])
    return (
        f"Of {tried:,} mountings {result['evaluations']:,} were scored with all frames and beams, the others with "
        "fewer (fidelity auto); no grid was, so that what the search has missed is not known: --fidelity full draws it."
    )


def _map_notes(score_map, mounting):
    """What the score map says of the search and the optimum: what was missed, how flat and how certain the top is."""
    grid = f"a grid of {score_map['points'][0]} x {score_map['points'][1]} heights and tilts"
    shortfall, best = score_map["search_shortfall"], score_map["best"]
    found = []
    if shortfall == 0:
        found.append(f"No point of {grid} is better than the {mounting}.")
    elif shortfall is not None and shortfall < _SMALL_SHORTFALL:
        found.append(f"The search found all but {100 * shortfall:.2f} % of the gain that {grid} offers.")
    elif shortfall is not None:
        where = f"{best['height_m']:.2f} m and {best['tilt_x_deg']:.1f} deg"
        found.append(
            f"The search missed {100 * shortfall:.1f} % of the gain that {grid} offers, at {where}: "
            "give it more --particles or --iterations."
        )
    regret = score_map.get("holdout_regret")  # not in the results of earlier versions
    if regret is not None and regret > _SMALL_SHORTFALL:
        lacks = f"lacks {100 * regret:.1f} % of the gain that the best point of that grid has there"
        found.append(f"On the held-out frames the {mounting} {lacks}.")
    if score_map["share_within_1_percent"] is not None:
        share = 100 * score_map["share_within_1_percent"]
        how_many = (
            f"{share:.1f} % of those heights and tilts come" if share else "None of those heights and tilts comes"
        )
        found.append(f"{how_many} within 1 % of the gain of the best one.")
    if sentence := optimum_text(score_map):
        found.append(f"{sentence[0].upper()}{sentence[1:]}.")
    return found
