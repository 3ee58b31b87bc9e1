"""How far to trust what a run found, as sentences: what its search and its score map say.

`result` is everywhere the content of result.json.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from ..metrics.catalogue import DETECTABLE, metric_named
from ..names import THE_LIDAR
from ..run.what_if import ON_A_BOUND, OTHER_HEIGHTS
from ..scene.mounting import COORDINATE_NAMES, LEANS
from ..statistics import FEW_VEHICLES
from ..traffic.vehicles import counted
from .summary import (
    as_sentence,
    better_than_baseline,
    each_lidar,
    errors_text,
    in_brackets,
    judged_hung,
    leans,
    measured,
    minus,
    of_name,
    was_searched,
)

_MOST_NAMED = 5
_LARGE = ("truck", "bus")
_SMALL_SHORTFALL = 0.01  # what a search may miss before more of it is advised
_DIGITS = {"m": 2, "deg": 1}


def cautions(result: Mapping) -> list[str]:
    """What search and map say about how far to trust the optimum, as sentences."""
    notes = (crossed_text(result), worst_text(result))
    found = [as_sentence(note) for note in (*notes, _undecided_by_threshold(result)) if note]
    if not was_searched(result):
        return found
    if not better_than_baseline(result):
        found.append("No mounting that was tried is better than the baseline.")
    each = each_lidar(result).items()
    found += [of_name(name, text) for name, one in each for text in _search_notes(one)]
    found += [as_sentence(text) for text in (poles_text(result), seeds_text(result)) if text]
    return found + [of_name(name, as_sentence(text)) for name, one in each if (text := optimum_text(one))]


def _search_notes(result):
    """What bounds, fidelity and map say of where the search of a LiDAR has ended."""
    found = []
    for key, (name, unit) in COORDINATE_NAMES.items():
        bounds, place = (result.get("bounds") or {}).get(key), result["deployment"].get(key)
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
            of_pole = key == "height_m" and result.get("pole")
            whose = "its pole" if of_pole else _own_table(result)
            beyond = next_metre_text(result) if key == "height_m" and place > low + slack else ""
            where = "on" if place in bounds else f"within {slack:.2g} {unit} of"
            beyond = beyond or "a value beyond it may be better"
            found.append(f"The best {name} lies {where} a bound of {whose}; {beyond}.")
    if result.get("rungs"):
        tried = sum(rung["candidates"] for rung in result["rungs"])
        found.append(
            f"Of {tried:,} mountings {result['evaluations']:,} were scored with all frames and beams, the others with "
            "fewer (fidelity auto). No grid was scored to check the search; --fidelity full scores one."
        )
    if result["map"]:
        found += _map_notes(result)
    return found


def next_metre_text(result: Mapping) -> str:
    """What one metre more than allowed would gain; empty where the height is not on its bound."""
    if (beyond := result.get("next_metre")) is None:
        return ""
    metric, mount = metric_named(result["metric"]), beyond["deployment"]
    ends = (beyond[f"detectable_share_gain{end}"] for end in ("", "_interval_90"))
    points, around = measured(DETECTABLE, *ends, sign="+")
    text = f"at {mount['height_m']:.2f} m and {_tilt_text(result, mount)} the detectable share would change by "
    text += minus(f"{points} percentage points") + in_brackets(around)
    gain, around = measured(metric, beyond["gain_over_baseline"], beyond["interval_90"], "+")
    return (
        f"{text} and the objective by {minus(f'{gain} {metric.shown_unit}')}{metric.per_vehicle}{in_brackets(around)}"
    )


def other_traffic_texts(result: Mapping) -> list[str]:
    """What the first lines say of who is not in the recording, as sentences."""
    texts = (fleet_text(result), lorries_text(result), heights_text(result), other_traffic_text(result))
    return [f"{text}." for text in texts if text]


def fleet_text(result: Mapping) -> str:
    """Which vehicles there are and how large where no lorry or bus is among them; "" where some are."""
    fleet = result["other_traffic"].get("fleet")
    if fleet is None or any(name in fleet["size_m"] for name in _LARGE):
        return ""
    *others, last = (
        f"{name}s ({' x '.join(f'{side:.1f}' for side in size)} m)" for name, size in fleet["size_m"].items()
    )
    classes, assumed = f"{', '.join(others)} and {last}" if others else last, fleet["assumed"]
    whose = f"{' and '.join(assumed)} assumed, {fleet['by']}" if assumed else "sizes as recorded"
    what = "The recording has" if fleet["recording"] else "These frames have"
    return f"{what} {classes} alone, {whose}; no lorry or bus is in the figures"


def lorries_text(result: Mapping) -> str:
    """Coverage with lorries alone: beside a straight road in the nearest lane, and which lane loses most; at an
    intersection from the approach from which they cost most.
    """
    other = result["other_traffic"]
    whole, alone = other["recorded"], [mix for mix in other["mixes"] if mix["lorries"] == 1.0]
    approaches = [mix for mix in alone if mix.get("approach") and mix["boxes"]]
    worst = min(approaches, key=lambda mix: mix["detectable_share"]) if approaches else next(iter(alone), None)
    if worst is None or whole["detectable_share"] is None or worst["detectable_share"] is None:
        return ""
    after, before = map(_share_with_count, (worst, whole))
    if len(approaches) > 1:  # chosen on the frames that it is told on, and so without an interval
        share = DETECTABLE.number(worst["detectable_share"], -1)
        after = f"{share} %, the fewest of {len(approaches)} approaches,"
    instead = "as recorded" if after == before else f"instead of {before}"
    in_place = other.get("in_place")
    of = f" (from {result['lidars'][0]['name']})" if result.get("layout") and not in_place else ""
    queues = ", in a queue as long as its gap allows" if in_place else ""
    text = f"If every car and van of {worst['lanes']}{of} were a lorry{queues}, of all vehicles {after} would be "
    text += (
        f"detectable {instead}, in {counted(other['frames'], 'held-out frame' if result.get('holdout') else 'frame')}"
    )
    told = known_groups(whole).keys() & known_groups(worst).keys()
    fell = [name for name in sorted(told) if known_groups(worst)[name] < known_groups(whole)[name]]
    if not in_place and fell:
        lane = min(fell, key=known_groups(worst).get)
        shares = (f"{100 * known_groups(row)[lane]:.0f}" for row in (worst, whole))
        text += "; of the vehicles in {} then {} % instead of {} %".format(lane, *shares)
    return text


def heights_text(result: Mapping) -> str:
    """What other heights change where a class has one, if that lies outside the interval as recorded."""
    other = result["other_traffic"]
    whole, mix = other["recorded"], next((mix for mix in other["mixes"] if mix["what"] == OTHER_HEIGHTS), None)
    if mix is None or not mix["boxes"] or not whole["interval_90"]:
        return ""
    low, high = whole["interval_90"]
    if low <= mix["detectable_share"] <= high:
        return ""
    after, before = map(_share_with_count, (mix, whole))
    text = "Some classes have one height each in the recording, and that matters"
    return f"{text}: with those of a real fleet {after} would be detectable instead of {before}"


def other_traffic_text(result: Mapping) -> str:
    """Coverage in light traffic, in the rush hour, in a queue and with other heights."""
    rows = [mix for mix in result["other_traffic"]["mixes"] if mix["lorries"] is None]
    shares = [f"{mix['what']} ({mix['value']}) {_share_with_count(mix)}" for mix in rows if mix["boxes"]]
    return f"Detectable in these frames under other traffic: {', '.join(shares)}" if shares else ""


def known_groups(mix: Mapping) -> dict[str, float]:
    """The detectable share of each approach, or else lane, of other traffic that has vehicles enough for one."""
    groups = (mix.get("by_approach") or mix["by_lane"]).items()
    return {name: one["detectable_share"] for name, one in groups if one["distinct_vehicles"] >= FEW_VEHICLES}


def _share_with_count(mix):
    """A share with its interval; without one, as with few vehicles, how many boxes of how many."""
    share, around = measured(DETECTABLE, mix["detectable_share"], mix["interval_90"])
    boxes = f"{round(mix['detectable_share'] * mix['boxes']):,} of {counted(mix['boxes'], 'box')}"
    return f"{share} % ({around})" if around else boxes


def _tilt_text(result, mount):
    """The angle that a scene searches beside the height."""
    return f"a lean of {mount['lean_deg']:.1f}°" if leans(result) else f"a tilt of {mount['tilt_x_deg']:.1f}°"


def crossed_text(result: Mapping) -> str:
    """What figures stand for where every block of time has judged."""
    if not result.get("cross_fitted"):
        return ""
    return (
        "too few blocks of time (under six) are held out for a check of their own, so each block has judged the "
        "mounting that is best on the other blocks (cross-fitting): the figures are those of this procedure, and the "
        "mounting above, the best on all searched blocks, was not checked itself"
        + (", nor that the best few were judged again under more installation errors" if errors_text(result) else "")
    )


def _undecided_by_threshold(result):
    """Why the detectable share says nothing, where every vehicle is detectable, or none, under both mountings."""
    found, base, on = judged_hung(result)
    if found["detectable_share"] != base["detectable_share"] or 0.0 < found["detectable_share"] < 1.0:
        return ""
    every, change = ("every", "higher") if found["detectable_share"] else ("no", "lower")
    threshold = result["identity"]["[objective] threshold"]
    return (
        f"{every} vehicle is detectable under either mounting on {on}, so the detectable share does not "
        f"distinguish them: [objective] threshold is {threshold:g}; try a {change} one"
    )


def _own_table(result):
    """The table of the scene that says where the LiDAR may hang, in a scene's usual form."""
    return "[deployment]" if [row["name"] for row in result["lidars"]] == [THE_LIDAR] else "its [[lidar]]"


def _map_notes(result):
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
    elif shortfall == 0 and errors_text(result):
        found.append(f"The best point of {grid} is no better as hung than the mounting found.")
    elif shortfall == 0:
        found.append(f"No point of {grid} is better than the mounting found.")
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
        found.append(f"On the held-out frames the mounting found {lacks}.")
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
    base, best = result["baseline"]["objective_per_vehicle_as_searched"], max(values)
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
        places = [f"height {_between(*height, 2)} m", f"the best {what} {_between(*tilt, 0)} deg"]
        among = ", on a grid of {:.2g} m by {:.2g} deg".format(*_grid_steps(result))
        if _off_grid(result):
            among += "; the mounting found lies between its points, outside that range"
    else:
        named = ((*COORDINATE_NAMES[key], *ends) for key, ends in intervals.items())
        places = [f"{name} {_between(low, high, _DIGITS[unit] - 1)} {unit}" for name, unit, low, high in named]
        among = f", among the {spread['mountings']:,} mountings that were tried: wider where these lie far apart"
    *others, last = places
    listed = f"{', '.join(others)} and {last}" if others else last
    sure = "90 % of resamplings of its blocks of time"
    return (
        f"other traffic of this kind would put the best {listed} ({sure}{among}; this is no leave to hang it elsewhere)"
    )


def _between(low, high, digits):
    ends = [f"{end:.{digits}f}" for end in (low, high)]
    return f"at {ends[0]}" if ends[0] == ends[1] else f"between {ends[0]} and {ends[1]}"


def _off_grid(result):
    """Whether the mounting found lies more than half a step of the map's grid outside the interval of the optimum."""
    found, intervals = result["deployment"], result["map"]["optimum_interval_90"]
    return any(
        not low - 0.5 * step <= found[key] <= high + 0.5 * step
        for step, (key, (low, high)) in zip(_grid_steps(result), intervals.items(), strict=True)
    )


def _grid_steps(result):
    """Steps of the score map's grid along its two coordinates."""
    ends = (result["bounds"][key] for key in result["map"]["optimum_interval_90"])
    return [(high - low) / (points - 1) for points, (low, high) in zip(result["map"]["points"], ends, strict=True)]
