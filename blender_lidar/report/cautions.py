"""How far to trust what a run found, as sentences: what its search, its score map and its tolerance say.

`result` is everywhere the content of result.json.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from ..metrics.catalogue import DETECTABLE, metric_named
from ..run.what_if import ON_A_BOUND, REPAIRED
from ..scene.mounting import ANGLES, COORDINATE_NAMES, LEANS
from .summary import (
    LEVEL_DEG,
    as_sentence,
    better_than_baseline,
    judged,
    judged_over_tolerance,
    measured,
    sharp_of,
    span,
    was_searched,
)

_MOST_NAMED = 5
_SMALL_SHORTFALL = 0.01  # what a search may miss before more of it is advised
_WIDTHS = {"height_m": "height_m", "tilt_x_deg": "tilt_deg", "tilt_y_deg": "tilt_deg", "yaw_deg": "yaw_deg"}
_DIGITS = {"m": 2, "deg": 1}


def cautions(result: Mapping) -> list[str]:
    """What tolerance, search and map say about how far to trust the optimum, as sentences."""
    notes = (_crossed_text(result), costliest_text(result), _against_sharp(result), worst_text(result))
    found = [as_sentence(note) for note in (*notes, _undecided_by_threshold(result)) if note]
    if not was_searched(result):
        return found
    if not better_than_baseline(result):
        found.append("No mounting that was tried is better than the baseline.")
    for key, (name, unit) in COORDINATE_NAMES.items():
        bounds, place = _bounds(result, key), result["deployment"].get(key)
        if not isinstance(bounds, list) or place is None:
            continue
        low, high = bounds
        if unit == "deg" and high - low == 360.0:  # a full circle has no bound
            continue
        if key in LEANS[1:]:  # given from -180 to 180 degrees, wherever it was searched
            place = low + (place - low) % 360.0
        slack = ON_A_BOUND * (high - low)
        upright = key == "lean_deg" and low == 0.0 and place < high - slack  # beyond which nothing lies
        if not low + slack < place < high - slack and not upright:
            whose = "its pole" if key == "height_m" and result.get("pole") else "[deployment]"
            beyond = next_metre_text(result) if key == "height_m" and place > low + slack else ""
            found.append(f"The best {name} lies on a bound of {whose}; {beyond or 'a value beyond it may be better'}.")
    if result.get("rungs"):
        tried = sum(rung["candidates"] for rung in result["rungs"])
        found.append(
            f"Of {tried:,} mountings {result['evaluations']:,} were scored with all frames and beams, the others with "
            "fewer (fidelity auto). No grid was scored to check the search; --fidelity full scores one."
        )
    if result["map"]:
        found += _map_notes(result, "mounting found" if sharp_of(result) is None else "sharp mounting")
    return [
        *found,
        *(as_sentence(text) for text in (poles_text(result), seeds_text(result), optimum_text(result)) if text),
    ]


def next_metre_text(result: Mapping) -> str:
    """What one metre more than allowed would gain; empty where the height is not on its bound."""
    if (beyond := result.get("next_metre")) is None:
        return ""
    scores, metric = beyond["holdout"] or beyond, metric_named(result["metric"])
    points, around = measured(
        DETECTABLE, *(scores[f"detectable_share_gain{end}"] for end in ("", "_interval_90")), sign="+"
    )
    text = f"at {beyond['deployment']['height_m']:.2f} m the detectable share would change by {points} points"
    text += f" ({around})" if around else ""
    if "gain_over_baseline" in scores:
        gain, around = measured(metric, scores["gain_over_baseline"], scores["interval_90"], "+")
        text += f" and the objective by {gain} {metric.shown_unit}{metric.per_vehicle}"
        text += f" ({around})" if around else ""
    return text


def lorries_text(result: Mapping) -> str:
    """Coverage with lorries alone in the nearest lane, the lane that loses most, and what would repair it."""
    other = result["other_traffic"]
    whole, repair = other["recorded"], other["repair"]
    worst = next(mix for mix in other["mixes"] if mix["lorries"] == 1.0)
    if whole["detectable_share"] is None or worst["detectable_share"] is None or repair is None:
        return ""
    after, before = map(_share_with_interval, (worst, whole))
    text = f"If all vehicles of {worst['lanes']} were lorries, {after} would be detectable instead of {before}"
    lost = {
        name: share - worst["by_lane"][name] for name, share in whole["by_lane"].items() if name in worst["by_lane"]
    }
    if lost and max(lost.values()) > 0.0:
        lane = max(lost, key=lost.get)
        text += f"; in {lane}, {100 * worst['by_lane'][lane]:.0f} instead of {100 * whole['by_lane'][lane]:.0f} %"
    if whole["detectable_share"] - worst["detectable_share"] <= REPAIRED:
        return text
    share, height = f"about {100 * repair['detectable_share']:.0f} %", f"{repair['height_m']:.1f} m"
    beyond = "" if repair["within_bounds"] else ", above the allowed heights,"
    if repair["repairs"]:
        text += f". A height of {height}{beyond} would bring it back ({share})"
    else:
        text += f". No height up to {repair['up_to_m']:g} m brings it back (at best {share}, at {height})"
    if repair["other_side"] is not None:
        text += f"; a pole on the other side of the road would see about {100 * repair['other_side']:.0f} %"
    return text


def other_traffic_text(result: Mapping) -> str:
    """Coverage by night, in the rush hour and in a queue."""
    rows = [mix for mix in result["other_traffic"]["mixes"] if mix["lanes"] is None]
    shares = [f"{mix['what']} ({mix['value']}) {_share_with_interval(mix)}" for mix in rows if mix["boxes"]]
    return f"Detectable under other traffic: {', '.join(shares)}" if shares else ""


def _share_with_interval(mix):
    share, around = measured(DETECTABLE, mix["detectable_share"], mix["interval_90"])
    return f"{share} %" + (f" ({around})" if around else "")


def _crossed_text(result):
    """What figures stand for where every block of time has judged."""
    if not result.get("cross_fitted"):
        return ""
    return (
        "fewer than six blocks of time are held out, so every block judged the best of the mountings tried without it "
        "(cross-fitting): the figures are those of this way of choosing, and the mounting is that of the whole search"
    )


def _undecided_by_threshold(result):
    """Why the detectable share says nothing, where every vehicle is detectable, or none, under both mountings."""
    found, base, on = judged(result)
    if found["detectable_share"] != base["detectable_share"] or 0.0 < found["detectable_share"] < 1.0:
        return ""
    every, change = ("every", "higher") if found["detectable_share"] else ("no", "lower")
    threshold = result["identity"]["[objective] threshold"]
    return (
        f"{every} vehicle is detectable under either mounting on {on}, so the detectable share does not "
        f"distinguish them: [objective] threshold is {threshold:g}; try a {change} one"
    )


def _bounds(result, key):
    """Between what a coordinate was searched, or the number that fixed it; on a pole with heights of its own these."""
    searched = result.get("bounds") or {}
    return searched.get(key, result["identity"].get(f"[deployment] {key}"))


def _against_sharp(result):
    """What robustness costs where all hangs as planned, and what it gains where it does not; "" without both."""
    metric, sharp = metric_named(result["metric"]), sharp_of(result)
    if sharp is None:
        return ""
    if sharp["deployment"] == result["deployment"]:
        return "the search over the tolerance found no mounting better than the sharp one"
    beside = (result["tolerance"]["robust"]["optimised"]["holdout"] or {}).get("over_sharp", {})
    parts = []
    for name, difference in beside.items():
        text = metric.difference(difference["objective_per_vehicle"], sign="+")
        if difference["interval_90"]:
            text += f" (90 %: {span(metric, difference['interval_90'], 0, '+')})"
        parts.append(f"{text} {'as planned' if name == 'as_planned' else 'over the tolerance'}")
    start = "on held-out frames the robust mounting has, compared with the sharp one and per vehicle, "
    return start + " and ".join(parts) if parts else ""


def _map_notes(result, mounting):
    """What the score map says of the search and the optimum: what was missed, how flat and how certain the top is."""
    score_map = result["map"]
    tilts = "leans" if "lean_deg" in score_map["best"] else "tilts"
    grid = f"a grid of {score_map['points'][0]} x {score_map['points'][1]} heights and {tilts}"
    if result.get("spread"):
        grid += ", the other coordinates as the search had found them,"
    shortfall, best = score_map["search_shortfall"], score_map["best"]
    tilt = best["lean_deg"] if "lean_deg" in best else best["tilt_x_deg"]
    found = []
    if score_map.get("polished"):
        found.append(
            f"A point of {grid} was better than the mounting of the search, so a local search went on from there."
        )
    elif shortfall == 0:
        found.append(f"No point of {grid} is better than the {mounting}.")
    elif shortfall is not None and shortfall < _SMALL_SHORTFALL:
        found.append(f"The search found all but {100 * shortfall:.2f} % of the gain that {grid} offers.")
    elif shortfall is not None:
        where = f"{best['height_m']:.2f} m and {tilt:.1f} deg"
        found.append(
            f"The search missed {100 * shortfall:.1f} % of the gain that {grid} offers, at {where}: "
            "give it more --particles or --iterations."
        )
    regret = score_map.get("holdout_regret")
    if regret is not None and regret > _SMALL_SHORTFALL:
        lacks = f"lacks {100 * regret:.1f} % of the gain that the best point of that grid has there"
        found.append(f"On the held-out frames the {mounting} {lacks}.")
    return found


def seeds_text(result: Mapping) -> str:
    """How far apart the searches with several seeds ended; empty where there was one."""
    spread = result.get("spread")
    if spread is None or len(spread["seeds"]) < 2:
        return ""
    places = []
    for key in spread["searched"]:
        name, unit = COORDINATE_NAMES[key]
        found = [one["deployment"][key] for one in spread["seeds"] if one["deployment"][key] is not None]
        if found and key in LEANS[1:]:  # on the circle, near the first
            found = [found[0] + math.remainder(angle - found[0], 360.0) for angle in found]
        if len(found) == len(spread["seeds"]):  # without a lean there is no direction
            places.append(f"{name} {min(found):.{_DIGITS[unit]}f} to {max(found):.{_DIGITS[unit]}f} {unit}")
    values = [one["objective_per_vehicle"] for one in spread["seeds"]]
    base, best = result["baseline"]["objective_per_vehicle"], max(values)
    lacks = "" if best <= base else ", the worst of them no better than the baseline"
    if min(values) > base:
        lacks = f", the worst of them with {100 * (best - min(values)) / (best - base):.1f} % less gain than the best"
    return f"{len(values)} searches with other seeds ended at {', '.join(places)}{lacks}"


def poles_text(result: Mapping) -> str:
    """Which poles may be as good as the best; empty without candidate poles or held-out frames."""
    poles = result.get("poles") or []
    if len(poles) < 2 or poles[0]["holdout"] is None:
        return ""
    best, alike = poles[0]["name"], [pole["name"] for pole in poles[1:] if pole["holdout"]["differs"] is False]
    if poles[1]["holdout"]["differs"] is None:
        return "there are too few blocks of held-out time to distinguish poles"
    if not alike:
        return f"pole {best} differs from all others on held-out traffic"
    which = f"{len(alike)} of the {len(poles) - 1} others" if len(alike) > _MOST_NAMED else " and ".join(alike)
    return f"held-out traffic does not distinguish {which} from pole {best}, the best on the searched frames"


def worst_text(result: Mapping) -> str:
    """Which of several recordings a mounting sees worst; empty where there is one."""
    recordings = result.get("recordings") or []
    held = result["holdout"] is not None
    scored = {one["name"]: one["holdout"] if held else one for one in recordings}
    scored = {name: scores for name, scores in scored.items() if scores is not None}
    if len(scored) < 2:
        return ""
    metric, whole = metric_named(result["metric"]), result["holdout"] if held else result
    worst = (min if metric.higher_is_better else max)(scored, key=lambda name: scored[name]["objective_per_vehicle"])
    values = (metric.amount(scores["objective_per_vehicle"], 1) for scores in (scored[worst], whole))
    return "recording {} is seen worst: {} per vehicle, and {} in the weighted mean of all".format(worst, *values)


def costliest_text(result: Mapping) -> str:
    """Which single error at its limit costs most; empty without a tolerance, or where none costs anything."""
    scores, where = judged_over_tolerance(result)
    limits = {} if scores is None else scores["loss_at_limits"]
    ends = ((loss, key, sign) for key in limits for loss, sign in zip(limits[key], "-+", strict=True))
    loss, key, sign = max(ends, default=(0.0, "", ""))
    if loss <= 0.0:
        return ""
    (name, unit), width = COORDINATE_NAMES[key], result["tolerance"]["settings"][_WIDTHS[key]]
    if key in ANGLES[:2] and abs(math.remainder(result["deployment"]["yaw_deg"], 360.0)) >= LEVEL_DEG:
        name = f"tilt about the sensor's own {'x' if key == 'tilt_x_deg' else 'y'} axis"
    metric = metric_named(result["metric"])
    lost = f"{metric.difference(loss)}{metric.per_vehicle}"
    return f"of single installation errors, {name} {sign}{width:g} {unit} costs most: {lost} ({where})"


def optimum_text(result: Mapping) -> str:
    """Between what coordinates the optimum lies with other traffic; empty where no interval is known.

    With two coordinates the map tells, with more the mountings that were tried: all coordinates may differ together.
    """
    spread, score_map = result.get("spread"), result["map"] or {}
    intervals = (score_map if spread is None else spread).get("optimum_interval_90")
    if not intervals:
        return ""
    if spread is None:
        (height, tilt), what = intervals.values(), "lean" if "lean_deg" in intervals else "tilt"
        places = [f"height {_between(*height, 1)} m", f"the best {what} {_between(*tilt, 0)} deg"]
        among = (
            ", on the grid; the mounting found lies between its points, outside that range" if _off_grid(result) else ""
        )
    else:
        named = ((*COORDINATE_NAMES[key], *ends) for key, ends in intervals.items())
        places = [f"{name} {_between(low, high, _DIGITS[unit] - 1)} {unit}" for name, unit, low, high in named]
        among = f", among the {spread['mountings']:,} mountings that were tried: wider where these lie far apart"
    *others, last = places
    listed = f"{', '.join(others)} and {last}" if others else last
    return f"other traffic of this kind would put the best {listed} (90 % of resampled blocks of time{among})"


def _between(low, high, digits):
    ends = [f"{end:.{digits}f}" for end in (low, high)]
    return f"at {ends[0]}" if ends[0] == ends[1] else f"between {ends[0]} and {ends[1]}"


def _off_grid(result):
    """Whether the mounting found lies more than half a step of the map's grid outside the interval of the optimum."""
    found, bounds = (sharp_of(result) or result)["deployment"], result.get("bounds") or {}
    intervals = result["map"]["optimum_interval_90"]
    points = result["map"].get("points", ())
    for number, (key, (low, high)) in zip(points, intervals.items(), strict=False):
        half_step = 0.5 * (bounds[key][1] - bounds[key][0]) / (number - 1) if key in bounds else 0.0
        if not low - half_step <= found[key] <= high + half_step:
            return True
    return False
