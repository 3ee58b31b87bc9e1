"""The document of a run: what was found, what leaves it in doubt, what to know before acting on it, what was assumed.

The only reader of a run's figures: every if about lean, poles, layouts and what judges stands here once. `result` is
everywhere the content of result.json without its document.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import replace

from ..document import (
    ANSWER,
    ASSUMED,
    CAUTION,
    DOUBT,
    HELD_OUT,
    LEFT_OUT,
    MEANING,
    NOTE,
    SEARCHED,
    Basis,
    Document,
    Quantity,
    Statement,
    as_sentence,
    listed,
    statement,
)
from ..metrics.catalogue import metric_named
from ..names import THE_LIDAR
from ..scene.mounting import COORDINATE_NAMES, LEANS
from ..statistics import FEW_BLOCKS, FEW_VEHICLES
from ..traffic.vehicles import counted
from .quantities import TOLD_BOXES, amount, group_shares, judged, points, quantities, run_tables, share
from .vehicle_table import APPROACH
from .what_if import ON_A_BOUND, OTHER_HEIGHTS
from .words import (
    conditions,
    definitions,
    each_lidar,
    errors_text,
    frames_word,
    is_weighted,
    layout_frames,
    leans,
    of_name,
    place_text,
    region_text,
    sensor_text,
    warnings_text,
    was_searched,
)

# --- The document -----------------------------------------------------------------------------------------------------


def run_document(result: Mapping) -> Document:
    """The document of a run of one LiDAR or of several."""
    statements = (
        *(statement(DOUBT, _safe(as_sentence(text)), first=True) for text in _doubts(result)),
        *_answers(result),
        *_cautions(result),
        *_notes(result),
        *_assumed(result),
        *_meanings(result),
    )
    return Document(_title(result), statements, tuple(run_tables(result)), _settings(result))


def _safe(text: str) -> str:
    """A text in which braces stand for themselves."""
    return text.replace("{", "{{").replace("}", "}}")


def _title(result: Mapping) -> str:
    _, _, basis = judged(result)
    searched = f"{'searched' if was_searched(result) else 'scored'} on {counted(result['frames'], 'frame')}"
    on = f"{counted(basis.boxes, 'box')} of {counted(basis.vehicles, 'vehicle')}"
    blocks = f", {counted(basis.blocks, 'block')} of time" if basis.blocks else ""
    sensor = result["sensor"] if result.get("layout") else sensor_text(result)
    text = f"{sensor} at {result['site']}: {searched}"
    if basis.split == HELD_OUT:
        return f"{text}, judged on {basis.boxes:,} held-out boxes (of {counted(basis.vehicles, 'vehicle')}{blocks})"
    if basis.split == LEFT_OUT:
        return f"{text}, judged on {on}{blocks}, each block left out in turn"
    return f"{text}, {on}"


def _doubts(result: Mapping) -> list[str]:
    """What cannot be true of the traffic and was accepted, and why the advice to hang it there is not carried."""
    return [*warnings_text(result), *filter(None, [doubt(result) if was_searched(result) else ""])]


def doubt(result: Mapping) -> str:
    """Why what was searched or what judges does not carry the advice to hang a LiDAR there; "" where both do."""
    if not better_than_baseline(result):
        what = "mounting" if len(each_lidar(result)) == 1 else "layout"
        return f"No {what} that was tried is better than the baseline"
    told, on = quantities(result), judged(result)[2]
    gain, found = told["objective"], told["points"]
    if on.split == SEARCHED:
        return "Nothing was held out, so this has no independent check"
    traffic = "Traffic left out in turn" if on.split == LEFT_OUT else "Held-out traffic"
    if gain.interval_90 is None:
        return "Too few blocks of time are held out for an interval"
    if gain.interval_90[1] < 0.0 or gain.value < 0.0 or (found.interval_90 and found.interval_90[1] < 0.0):
        return f"{traffic} does not confirm the search: there the mounting does worse than the baseline"
    if gain.interval_90[0] <= 0.0:
        return f"{traffic} does not show that this gains anything: the interval of the gain holds 0"
    if not found.interval_90 or found.interval_90[0] <= 0.0:
        return f"{traffic} shows a gain in the objective, but not that more vehicles become detectable"
    if on.blocks < FEW_BLOCKS:
        return f"{traffic} is only {counted(on.blocks, 'block')} of time, too few to be sure of an interval"
    if result["holdout"] is None:
        return "Nothing was held out, so this mounting itself has no independent check"
    return ""


def better_than_baseline(result: Mapping) -> bool:
    """Whether the mounting beats the baseline as hung, on the frames that were searched."""
    return result["objective_as_hung"] > result["baseline"]["objective_as_hung"]


# --- The answer -------------------------------------------------------------------------------------------------------


def _answers(result: Mapping) -> Iterator[Statement]:
    each, told = each_lidar(result), quantities(result)
    metric, hung = metric_named(result["metric"]), ", as hung" if errors_text(result) else ""
    what = "Mounting" if not was_searched(result) else "Best found" if doubt(result) else "Hang it"
    for name, one in each.items():
        yield statement(ANSWER, _safe(_place(result, one, name)), what if not name else f"{what}, {name}", first=True)
    users = "road users" if "pedestrian" in (result["identity"].get("[objective] classes") or ()) else "vehicles"
    text = f"{{after}} of the {users}{hung}; baseline, {_safe(_baseline(result))}: {{before}}{_no_interval(result)}"
    shares = {key: told[key] for key in ("after", "before")}
    yield statement(ANSWER, text, "Detectable", first=True, **shares)
    gains = {"points": told["points"]}
    if not metric.of_share or is_weighted(result):
        gains["objective"] = told["objective"]
    texts = {"points": "{points}", "objective": f"{told['objective'].label.removeprefix('gain in the ')} {{objective}}"}
    shown = (f"{texts[key]}{_unsure(one)}" for key, one in gains.items())
    yield statement(ANSWER, "; ".join(shown), "Gain", first=True, **gains)
    if hung:
        low = "nine of ten installations reach {low}; " if "low" in told else ""
        text = f"{low}1° off in one tilt {{degree}}, 10 cm off in height {{height}} at worst; "
        text += "exactly as planned {planned}"
        chosen = {key: told[key] for key in ("low", "degree", "height", "planned") if key in told}
        yield statement(ANSWER, text, "How sure", first=True, **chosen)
    yield from _over_single(result)
    for name, one in each.items():
        at = one["pointing"]
        text = f"x {at['x_m']:.2f} m, y {at['y_m']:.2f} m ({at['frame']}); the mast faces bearing "
        text += f"{at['facing_bearing_deg']:.0f}°, clockwise from +y"
        yield statement(ANSWER, _safe(text), of_name(name, "Stands at") if not name else f"Stands, {name}", first=True)
    approaches = tuple(group_shares(result, APPROACH).values())
    if approaches and not judged(result)[2].chosen_here:
        text = ", ".join(f"{one.label} {one}" for one in approaches) + " (exactly as planned)" * bool(hung)
        yield Statement(ANSWER, text, "By approach", approaches)


def _place(result: Mapping, one: Mapping, name: str) -> str:
    """Where a LiDAR hangs, on which pole."""
    place = place_text(one["deployment"], leans=leans(one), pointing=one["pointing"])
    pole = one["pole"] if name else (result.get("poles") or [result.get("pole")])[0]
    sensor, on = (sensor_text(one),) * bool(name), (f"on pole {pole['name']}," if pole else "",)
    return " ".join(filter(None, (*sensor, *on, place)))


def _baseline(result: Mapping) -> str:
    """The baseline in a few words."""
    each = each_lidar(result)
    if len(each) > 1:
        return f"{len(each)} LiDARs"
    mounts = result["baseline"]["deployment"], result["deployment"]
    away_m = math.hypot(*(mounts[0][key] - mounts[1][key] for key in ("x_m", "y_m")))
    place = place_text(mounts[0], leans=leans(result), pointing={"leans": None}).replace(" above the road", "", 1)
    return f"{place}, {away_m:.0f} m away" if away_m >= 0.5 else place


def _no_interval(result: Mapping) -> str:
    """Why the detectable share has no interval; "" where it has one."""
    found, _, basis = judged(result)
    if found["as_hung"]["interval_90"]:
        return ""
    if basis.chosen_here:
        return "; no interval, as the same traffic has chosen the mounting"
    if basis.vehicles < FEW_VEHICLES:
        return f"; no interval, as there are fewer than {FEW_VEHICLES} different vehicles"
    return "; no interval, as there are too few blocks of time"


def _over_single(result: Mapping) -> Iterator[Statement]:
    """What a layout gains over its best single LiDAR, or over what hung already."""
    layout, metric = result.get("layout") or {}, metric_named(result["metric"])
    if not (gain := layout.get("over_single")):
        return
    first = layout["steps"][0]["added"]
    what = "the best single LiDAR of its search" if was_searched(result) else "the best single LiDAR of them"
    if was_searched(result) and all(one["bounds"] is None for one in result["lidars"] if one["name"] in first):
        what = "what hung already"
    told = {"points": points("over_single", f"over {what}", gain["share_gain"], gain["share_gain_interval_90"])}
    text = f"{{points}} detectable{_unsure(told['points'])}"
    if not metric.of_share or is_weighted(result):
        ends = gain["objective_gain"], gain["interval_90"]
        told["objective"] = amount(metric, "objective_over_single", f"over {what}", *ends, signed=True)
        text += f", {{objective}}{metric.per_vehicle}{_unsure(told['objective'])}"
    on = layout_frames(result)
    planned = " exactly as planned," if errors_text(result) else ""
    text += f": over {_safe(what)} ({_safe(listed(first))}),{planned} on {on} frames"
    yield statement(ANSWER, text, "Together", first=True, **told)


# --- What to know before acting on it ---------------------------------------------------------------------------------


def _cautions(result: Mapping) -> Iterator[Statement]:
    each = each_lidar(result).items()
    yield from _sentences(CAUTION, _crossed(result), _undecided_by_threshold(result), first=True)
    if was_searched(result):
        for name, one in each:
            for found in _on_bounds(one):
                yield statement(CAUTION, of_name(_safe(name), found[0]), first=True, **found[1])
            yield from _sentences(CAUTION, *_missed(one), name=name, first=True)
    yield from other_traffic_statements(result)
    if was_searched(result):
        yield from _sentences(CAUTION, poles_text(result), first=True)
        for name, one in each:
            yield from _sentences(NOTE, optimum_text(one), name=name, first=True)
    yield from _worst_groups(result)
    yield from _two_wheelers(result)
    yield from _sentences(NOTE, worst_recording(result), first=True)


def _sentences(kind: str, *texts: str, name: str = "", first: bool = False) -> Iterator[Statement]:
    """Statements without quantities, of the texts that say anything, of the LiDAR of that name."""
    return (Statement(kind, of_name(name, as_sentence(text)), first=first) for text in texts if text)


def _crossed(result: Mapping) -> str:
    """What figures stand for where every block of time has judged."""
    if not result.get("cross_fitted"):
        return ""
    return (
        f"fewer than {FEW_BLOCKS} blocks of time are held out, too few for a check of their own. So each block judged "
        "the best mounting of the other blocks (cross-fitting): the figures are those of choosing this way, not of "
        "this one mounting"
    )


def _undecided_by_threshold(result: Mapping) -> str:
    """Why the detectable share says nothing, where every vehicle is detectable, or none, under both mountings."""
    found, base, _ = judged(result)
    share_after, share_before = (one["as_hung"]["detectable_share"] for one in (found, base))
    if share_after != share_before or 0.0 < share_after < 1.0:
        return ""
    every, change = ("every", "higher") if share_after else ("no", "lower")
    threshold = result["identity"]["[objective] threshold"]
    return (
        f"{every} vehicle is detectable under either mounting, so the detectable share does not tell them apart: "
        f"[objective] threshold is {threshold:g}; try a {change} one"
    )


def _on_bounds(one: Mapping) -> Iterator[tuple[str, dict[str, Quantity]]]:
    """The coordinates of a LiDAR that lie on a bound, and what a metre more of height would change."""
    for key, (name, unit) in COORDINATE_NAMES.items():
        bounds, place = (one.get("bounds") or {}).get(key), one["deployment"].get(key)
        if not isinstance(bounds, list) or place is None:
            continue
        low, high = bounds
        if unit == "deg" and high - low == 360.0:  # a full circle has no bound
            continue
        if key in LEANS[1:]:  # given from -180 to 180 degrees, wherever it was searched
            place = low + (place - low) % 360.0
        slack = ON_A_BOUND * (high - low)
        upright = key == "lean_deg" and low == 0.0 and place < high - slack  # beyond which nothing lies
        if low + slack < place < high - slack or upright:
            continue
        of_pole = key == "height_m" and one.get("pole")
        whose = "its pole" if of_pole else _own_table(one)
        beyond, told = "a value beyond may be better", {}
        if key == "height_m" and place > low + slack and one.get("next_metre"):
            beyond, told = next_metre(one)
        yield f"The {_safe(name)} lies at the bound of {_safe(whose)}: {beyond}.", told


def next_metre(one: Mapping) -> tuple[str, dict[str, Quantity]]:
    """What one metre more than allowed would change, as a text to be filled, and its quantities; none: ""."""
    if not (beyond := one.get("next_metre")):
        return "", {}
    metric, mount = metric_named(one["metric"]), beyond["deployment"]
    angle = f"a lean of {mount['lean_deg']:.1f}°" if leans(one) else f"a tilt of {mount['tilt_x_deg']:.1f}°"
    gain = points("next_metre", "a metre higher", *(beyond[f"detectable_share_gain{end}"] for end in _ENDS))
    told, text = {"more": gain}, f"{mount['height_m']:.2f} m with {angle} would change the detectable share by {{more}}"
    text += _unsure(gain)
    if not metric.of_share or is_weighted(one):
        ends = beyond["gain_over_baseline"], beyond["interval_90"]
        told["objective"] = amount(metric, "next_metre_objective", "a metre higher", *ends, signed=True)
        text += f" and the objective by {{objective}}{metric.per_vehicle}{_unsure(told['objective'])}"
    return text, told


def _unsure(gain: Quantity) -> str:
    """Stands behind a gain whose interval does not show it."""
    return " (no interval)" if gain.interval_90 is None else " (not shown)" if gain.holds_nought else ""


_ENDS = "", "_interval_90"


def _own_table(one: Mapping) -> str:
    """The table of the scene that says where the LiDAR may hang, in a scene's usual form."""
    return "[deployment]" if [row["name"] for row in one["lidars"]] == [THE_LIDAR] else "its [[lidar]]"


_SMALL_SHORTFALL = 0.01  # what a search may miss before more of it is advised


def _missed(one: Mapping) -> Iterator[str]:
    """What the score map says that the search of a LiDAR has missed, or that there is none to say it."""
    if stages := one.get("rungs"):
        screened = sum(stage["candidates"] for stage in stages) - one["evaluations"]
        yield (
            f"{screened:,} mountings were screened on few frames and beams, {one['evaluations']:,} scored on all "
            "(fidelity auto); no grid has checked the search, as with --fidelity full"
        )
    if not (score_map := one["map"]):
        return
    shortfall, best, regret = (score_map.get(key) for key in ("search_shortfall", "best", "holdout_regret"))
    if shortfall is not None and shortfall >= _SMALL_SHORTFALL and not score_map["polished"]:
        tilt = best["lean_deg"] if "lean_deg" in best else best["tilt_x_deg"]
        yield (
            f"The search missed {100 * shortfall:.1f} % of the gain: {_grid(one)} has more at {best['height_m']:.2f} m "
            f"and {tilt:.1f}°; give it more --particles or --iterations"
        )
    if regret is not None and regret > _SMALL_SHORTFALL:
        lacks = f"this mounting lacks {100 * regret:.1f} % of it"
        yield f"On held-out frames the best point of {_grid(one)} gains more: {lacks}"


def _grid(one: Mapping) -> str:
    score_map = one["map"]
    tilts = "leans" if "lean_deg" in score_map["best"] else "tilts"
    through = ", through the coordinates found," if one.get("spread") else ""
    return f"a grid of {score_map['points'][0]} x {score_map['points'][1]} heights and {tilts}{through}"


def other_traffic_statements(result: Mapping) -> Iterator[Statement]:
    """What is detectable under traffic that is not in the recording: lorries first."""
    other = result["other_traffic"]
    yield from _sentences(NOTE, fleet_text(other), first=True)
    if (found := lorries(result)) is not None:
        yield found
    whole, frames = other["recorded"], counted(other["frames"], "frame")
    for mix in other["mixes"]:
        if not mix["boxes"] or mix["lorries"] is not None or whole["detectable_share"] is None:
            continue
        told = {"mix": _mix_share(mix), "recorded": _mix_share(whole)}
        text, kind, first = f"{mix['what']} ({mix['value']}): {{mix}}", NOTE, False
        if mix["what"] == OTHER_HEIGHTS and whole["interval_90"]:
            low, high = whole["interval_90"]
            first = not low <= mix["detectable_share"] <= high
            kind = CAUTION if first else NOTE
        text += f" detectable, instead of {{recorded}} in the same {frames}"
        yield statement(kind, f"{text[0].upper()}{text[1:]}.", first=first, **told)


def _mix_share(mix: Mapping) -> Quantity:
    basis = Basis(HELD_OUT, mix["boxes"], mix["distinct_vehicles"])
    name = mix.get("what", "as recorded")
    return share(
        f"other_traffic {name} {mix.get('value', '')}".rstrip(),
        name,
        mix["detectable_share"],
        mix["interval_90"],
        basis,
    )


_LARGE = ("truck", "bus")


def fleet_text(other: Mapping) -> str:
    """Which vehicles there are and how large where no lorry or bus is among them; "" where some are."""
    fleet = other.get("fleet")
    if fleet is None or any(name in fleet["size_m"] for name in _LARGE):
        return ""
    sizes = (f"{name}s ({' x '.join(f'{side:.1f}' for side in size)} m)" for name, size in fleet["size_m"].items())
    assumed = fleet["assumed"]
    whose = f"{listed(assumed)} assumed, {fleet['by']}" if assumed else "sizes as recorded"
    what = "the recording has" if fleet["recording"] else "these frames have"
    return f"{what} {listed(sizes)} alone, {whose}: no figure here has a lorry or bus"


def lorries(result: Mapping) -> Statement | None:
    """Lorries alone: beside a straight road in the nearest lane, on a map from the approach where they cost most."""
    other = result["other_traffic"]
    whole, alone = other["recorded"], [mix for mix in other["mixes"] if mix["lorries"] == 1.0 and mix["boxes"]]
    approaches = [mix for mix in alone if mix.get("approach")]
    worst = min(approaches, key=lambda mix: mix["detectable_share"]) if approaches else next(iter(alone), None)
    if worst is None or whole["detectable_share"] is None:
        return None
    mix = dict(worst) if len(approaches) < 2 else {**worst, "interval_90": None}  # chosen on what it is told on
    told = {"lorries": _mix_share(mix), "recorded": _mix_share(whole)}
    fewest = f", the fewest of {len(approaches)} approaches" if len(approaches) > 1 else ""
    queued = ", each as long as its gap allows" if other.get("in_place") else ""
    of = f" (from {result['lidars'][0]['name']})" if result.get("layout") and not other.get("in_place") else ""
    text = (
        f"Lorries in place of every car and van of {_safe(worst['lanes'] + of)}{queued}: {{lorries}} of all vehicles "
    )
    text += f"detectable{fewest}, instead of {{recorded}} in the same {counted(other['frames'], 'frame')}."
    return statement(CAUTION, text, first=True, **told)


def _worst_groups(result: Mapping) -> Iterator[Statement]:
    """The band of distance and the lane or approach that are seen worst."""
    by_lane = group_shares(result, APPROACH) or group_shares(result, "lane")
    groups = [one for one in (group_shares(result, "distance"), by_lane) if len(one) > 1]
    worst = (min(one.values(), key=lambda each: each.value) for one in groups)
    worst = [replace(one, interval_90=None) for one in worst]  # chosen on what it is told on
    if worst:
        planned = " (exactly as planned)" if errors_text(result) else ""
        text = f"Seen worst{planned}: {', '.join(f'{one.label} {one}' for one in worst)}."
        yield Statement(NOTE, text, quantities=tuple(worst), first=True)


def _two_wheelers(result: Mapping) -> Iterator[Statement]:
    """What is detectable of motorcycles and bicycles, as hung; of ten boxes or more."""
    found = judged(result)[0]["as_hung"]["two_wheelers"]
    if found is None or found["boxes"] < TOLD_BOXES:
        return
    basis = judged(result)[2]._replace(boxes=found["boxes"], vehicles=found["distinct_vehicles"], blocks=0)
    told = share("two_wheelers", "two-wheelers detectable", found["after"], found["after_interval_90"], basis)
    boxes, hung = counted(basis.boxes, "box"), ", as hung" * bool(errors_text(result))
    yield statement(
        NOTE, f"Of two-wheelers ({boxes}) {{told}} are detectable{hung}{_unsure(told)}.", first=True, told=told
    )


def poles_text(result: Mapping) -> str:
    """Which poles may be as good as the best; empty without candidate poles or held-out frames."""
    poles = result.get("poles") or []
    if len(poles) < 2 or poles[0]["holdout"] is None:
        return ""
    best, alike = poles[0]["name"], [pole["name"] for pole in poles[1:] if pole["holdout"]["differs"] is False]
    if poles[1]["holdout"]["differs"] is None:
        return "too few blocks of time are held out to tell poles apart"
    if not alike:
        return f"pole {best} differs from all others on held-out traffic"
    which = f"{len(alike)} of the {len(poles) - 1} other poles" if len(alike) > _MOST_NAMED else listed(alike)
    return f"pole {best} was best on the searched frames; on held-out traffic {which} may be as good"


_MOST_NAMED = 5


def worst_recording(result: Mapping) -> str:
    """Which of several recordings has the lowest objective; empty where there is one."""
    recordings, held = result.get("recordings") or [], result["holdout"] is not None
    scored = {one["name"]: one["holdout"] if held else one for one in recordings}
    scored = {name: scores for name, scores in scored.items() if scores and scores["objective_per_vehicle"] is not None}
    if len(scored) < 2:
        return ""
    metric, whole = metric_named(result["metric"]), result["holdout"] if held else result
    worst = min(scored, key=lambda name: scored[name]["objective_per_vehicle"])
    values = (metric.amount(scores["objective_per_vehicle"], 1) for scores in (scored[worst], whole))
    on = "held-out" if held else frames_word(result)
    return "of the recordings {} is worst: {} per vehicle, all of them {}, on {} frames".format(worst, *values, on)


_DIGITS = {"m": 2, "deg": 1}


def optimum_text(one: Mapping) -> str:
    """Between what coordinates the optimum lies with other traffic; empty where no interval is known.

    With two coordinates the map tells, with more the mountings that were tried: all coordinates may differ together.
    """
    spread, score_map = one.get("spread"), one["map"] or {}
    intervals = (score_map if spread is None else spread).get("optimum_interval_90")
    if not intervals:
        return ""
    places = []
    for key, (low, high) in intervals.items():
        name, unit = COORDINATE_NAMES[key.rpartition(".")[2]]
        digits = _DIGITS[unit] - (spread is not None or unit == "deg")
        ends = (f"{end:.{digits}f}" for end in (low, high))
        places.append(f"{name} {' to '.join(dict.fromkeys(ends))}{'°' if unit == 'deg' else ' m'}")
    among = f" among the {spread['mountings']:,} mountings tried" if spread is not None else ""
    if spread is None and _off_grid(one):
        among = " on the map's grid, between whose points the mounting above lies, outside that range"
    return (
        f"Other traffic of this kind may choose otherwise: {listed(places)} in 90 % of resamplings{among}; "
        "not every mounting within is as good"
    )


def _off_grid(one: Mapping) -> bool:
    """Whether the mounting lies more than half a step of the map's grid outside the interval of the optimum."""
    found, score_map = one["deployment"], one["map"]
    ends = (one["bounds"][key] for key in score_map["optimum_interval_90"])
    steps = ((high - low) / (points - 1) for points, (low, high) in zip(score_map["points"], ends, strict=True))
    return any(
        not low - 0.5 * step <= found[key] <= high + 0.5 * step
        for step, (key, (low, high)) in zip(steps, score_map["optimum_interval_90"].items(), strict=True)
    )


# --- The rest: notes, what was assumed, what words mean ---------------------------------------------------------------


def _notes(result: Mapping) -> Iterator[Statement]:
    yield from _sentences(NOTE, *conditions(result), first=True)
    yield from _sentences(NOTE, f"vehicles count {region_text(result['region'])}")
    if was_searched(result):
        for name, one in each_lidar(result).items():
            yield from _sentences(NOTE, *_checked(one), name=name)
        yield from _sentences(NOTE, seeds_text(result))
    yield from _sentences(NOTE, *dict.fromkeys((*result["notes"], *result["traffic_report"]["notes"])))


def _checked(one: Mapping) -> Iterator[str]:
    """What checked the search of a LiDAR."""
    if not (score_map := one["map"]):
        return
    shortfall = score_map["search_shortfall"]
    if score_map["polished"]:
        yield f"{_grid(one)} had a better point than the search, so a local search went on from it"
    elif shortfall == 0:
        yield f"No point of {_grid(one)} is better{' as hung' * bool(errors_text(one))} than this mounting"
    elif shortfall is not None and shortfall < _SMALL_SHORTFALL:
        yield f"The search found all but {100 * shortfall:.2f} % of the gain that {_grid(one)} offers"


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


def _assumed(result: Mapping) -> Iterator[Statement]:
    """What was assumed."""
    return (Statement(ASSUMED, as_sentence(text), first=True) for text in result["assumptions"])


def _meanings(result: Mapping) -> Iterator[Statement]:
    """What the words mean."""
    for word, text in definitions(result).items():
        yield Statement(MEANING, text, word, first=word == "Detectable")


def _settings(result: Mapping) -> dict[str, str]:
    """How it was computed, and by what."""
    search = f"{result['search']}, seed {result['seed']}, {result['evaluations']:,} evaluations at full fidelity"
    return {
        "Search": search if was_searched(result) else "none: the mounting was given",
        "Metric": f"{result['metric']}, {result['reading']} reading",
        "Rays": f"cast by {result['caster']}, vehicles in detail {result['detail']}",
        "Traffic": result["identity"]["[traffic] path"],
        **result["versions"],
    }
