"""What a run found, as sentences: for the command line, the page and the installation sheet.

`result` is everywhere the content of result.json.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from ..metrics.catalogue import PE_VGOP, metric_named
from ..metrics.metric import Metric
from ..run.tolerance import tolerance_text
from ..sensors.model import model_names

COORDINATE_NAMES = {
    "height_m": ("height", "m"),
    "tilt_x_deg": ("tilt across the road", "deg"),
    "tilt_y_deg": ("tilt along the road", "deg"),
    "yaw_deg": ("yaw", "deg"),
    "lean_deg": ("lean", "deg"),
    "lean_direction_deg": ("direction of the lean", "deg"),
    "spin_deg": ("spin", "deg"),
    "x_m": ("x along the road", "m"),
    "y_m": ("y across the road", "m"),
}
_MOST_NAMED = 5
_LEVEL_DEG = 0.05  # a smaller angle cannot be set on site
TILTS, LEAN = ("tilt_x_deg", "tilt_y_deg", "yaw_deg"), ("lean_deg", "lean_direction_deg", "spin_deg")

# --- What a run is about: its mountings, what judges them, and what the scores hold under -----------------------------


def was_searched(result: Mapping) -> bool:
    """Whether a search chose the mounting; otherwise it was given."""
    return result["search"] is not None


def sharp_of(result: Mapping) -> Mapping | None:
    """The best mounting that hangs as planned and its scores, where a search over a tolerance found the run's."""
    return (result.get("tolerance") or {}).get("sharp")


def mounting_name(result: Mapping) -> str:
    """What the run's mounting is called beside the baseline, and beside the sharp one where it had a tolerance."""
    if not was_searched(result):
        return "given"
    return "optimised" if sharp_of(result) is None else "robust"


def sides(result: Mapping) -> list[tuple[str, Mapping[str, float]]]:
    """The mountings that pictures show side by side, the baseline first: what each is called, and where it hangs."""
    return [("Baseline", result["baseline"]["deployment"]), (mounting_name(result).capitalize(), result["deployment"])]


def leans(result: Mapping) -> bool:
    """Whether a run speaks of a lean and its direction, as its scene does, and not of tilts and yaw."""
    return result.get("identity", {}).get("[deployment] lean_deg") is not None


def mounting_text(mount: Mapping[str, float], *, leans: bool = False) -> str:
    """A mounting in a few words; `leans` as for `place_text`."""
    if leans:
        way = "" if mount["lean_direction_deg"] is None else f" towards {mount['lean_direction_deg']:.0f}°"
        return f"height {mount['height_m']:.2f} m, lean {mount['lean_deg']:.1f}°{way}"
    parts = [f"height {mount['height_m']:.2f} m", f"tilt {mount['tilt_x_deg']:.1f}°"]
    more = {"along the road": mount["tilt_y_deg"], "yaw": mount["yaw_deg"]}
    return ", ".join([*parts, *(f"{name} {angle:.1f}°" for name, angle in more.items() if angle)])


def direction_text(mount: Mapping[str, float]) -> str:
    """Which way a sensor leans: the nearest axis of the road frame, and how far it points off that axis."""
    ways = {0.0: "forward along the road, {}+x", 90.0: "to the left across the road, {}+y"}
    ways |= {180.0: "back along the road, {}-x", -90.0: "to the right across the road, {}-y"}
    bearing = mount["lean_direction_deg"] + mount.get("facing_deg", 90.0)
    nearest = min(ways, key=lambda way: abs(math.remainder(bearing - way, 360.0)))
    off = math.remainder(bearing - nearest, 360.0)
    turned = "" if abs(off) < 0.5 else f"{abs(off):.0f}° {'counter-' if off > 0 else ''}clockwise of "
    return ways[nearest].format(turned)


def place_text(mount: Mapping[str, float], *, leans: bool = False) -> str:
    """A mounting in words that a sentence can hold, without the coordinates that are nought.

    `leans` says whether its orientation is given as a lean, which a mounting of result.json has besides its tilts.
    """
    if leans:
        parts = [f"{mount['height_m']:.2f} m above the road", "level"]
        if mount["lean_deg"] >= _LEVEL_DEG:
            parts[1] = f"leaning {mount['lean_deg']:.1f}° {direction_text(mount)}"
        if abs(mount["spin_deg"]) >= _LEVEL_DEG:
            parts.append(f"turned {mount['spin_deg']:.1f}° about its axis")
        if mount["x_m"] or mount["y_m"]:
            parts.append(f"at x {mount['x_m']:.2f} m and y {mount['y_m']:.2f} m")
        return ", ".join(parts)
    facing, square = mount.get("facing_deg", 90.0), {90.0: "", -90.0: "facing -y"}
    facing = square.get(round(math.remainder(facing, 360.0), 6), f"facing {facing:g}° from +x")
    across = "across it", "along it"
    if facing not in square.values():
        across = "towards where the mast faces", "sideways"
    tilts = dict(zip(TILTS, across, strict=False))
    leaning = [f"{mount[key]:.1f}° {way}" for key, way in tilts.items() if abs(mount[key]) >= _LEVEL_DEG]
    parts = [f"{mount['height_m']:.2f} m above the road", f"tilted {' and '.join(leaning)}" if leaning else "level"]
    if abs(mount["yaw_deg"]) >= _LEVEL_DEG:
        parts.append(f"turned {mount['yaw_deg']:.1f}°")
    parts += [facing] if facing else []
    if mount["x_m"] or mount["y_m"]:
        parts.append(f"at x {mount['x_m']:.2f} m and y {mount['y_m']:.2f} m")
    return ", ".join(parts)


def judged(result: Mapping) -> tuple[Mapping, Mapping, str]:
    """Scores of the mounting and of the baseline where they are judged, and what traffic that is."""
    if result["holdout"] is not None:
        return result["holdout"], result["baseline"]["holdout"], "held-out traffic"
    on = "the traffic that was used to choose the mounting" if was_searched(result) else "the scored traffic"
    return result, result["baseline"], on


def frames_word(result: Mapping) -> str:
    """What the frames are called that are not held out."""
    return "searched" if was_searched(result) else "scored"


def warnings_text(result: Mapping) -> list[str]:
    """What cannot be true of the traffic and was accepted, each as a sentence: the first lines of every output."""
    return [f"Warning, accepted ({one['name']}): {one['text']}." for one in result.get("warnings", ())]


def conditions(result: Mapping) -> list[str]:
    """What the scores hold under besides the mounting: an imperfect sensor, scenery."""
    imperfect = imperfections_text(result["imperfections"])
    values = {
        "simulated with an imperfect sensor": imperfect,
        "simulated with scenery": scenery_text(result["scenery"]),
    }
    return [f"{what}: {text}" for what, text in values.items() if text]


def region_text(region: Mapping) -> str:
    """Where vehicles count, in a few words; `region` is what result.json has of `RegionSettings`."""
    if region["polygon_m"]:
        text = f"in a polygon of {len(region['polygon_m'])} corners"
    elif region["stretches"]:
        spans = (" to ".join(f"{x:g}" for x in one["x_m"]) for one in region["stretches"])
        text = f"on the road from x {' and '.join(spans)} m"
        if any(one["lanes"] for one in region["stretches"]):
            text = text.replace("the road", "chosen lanes")
    else:
        x, y = region["centre_m"]
        text = f"within {region['radius_m']:g} m of x {x:g} m, y {y:g} m"
    return text + (f", less {len(region['keep_out'])} that are kept out" if region["keep_out"] else "")


def imperfections_text(imperfections: Mapping[str, float | None]) -> str:
    """What is imperfect about a sensor, in a few words; empty where nothing is.

    `imperfections` is what `SensorSettings.imperfections_as_table` gives and result.json keeps.
    """
    noise, dropout = imperfections["range_noise_m"], imperfections["dropout"]
    glass = imperfections["glass_dropout"]
    values = {
        "range noise {range_noise_m:g} m": noise,
        f"drop-out {100 * dropout:g} %": dropout,
        f"drop-out on glass {100 * glass:g} %": glass,
        "noise seed {noise_seed}": noise or dropout or 0.0 < glass < 1.0,
        "a 10 % target seen to {range_at_10_percent_m:g} m": imperfections["range_at_10_percent_m"] is not None,
        "unit {unit} of units that differ by {unit_spread_deg:g} deg": imperfections["unit_spread_deg"],
    }
    return ", ".join(text.format(**imperfections) for text, there in values.items() if there)


def scenery_text(counts: Mapping[str, int] | None) -> str:
    """How much scenery stood there, in a few words; empty where the scene has none."""
    if counts is None:
        return ""
    return f"{', '.join(counted(counts[what + 's'], what) for what in ('object', 'triangle'))} within reach"


def objective_text(result: Mapping) -> str:
    """What the objective of a run adds up."""
    metric, loss = metric_named(result["metric"]), result["identity"]["[objective] loss"]
    merit = f"{'' if metric.higher_is_better else 'minus '}the {metric.label}"
    merit_of = "1 for" if metric.of_share else f"{merit} of"
    if loss is not None and result["reading"] != "corrected":
        instead = "" if metric is PE_VGOP else f", with {merit} in place of the entropy"
        return f"Eq. 10 of the paper as printed{instead}"
    if loss is None and metric.of_share:
        return f"{merit_of} every detectable vehicle, 0 for every other vehicle"
    if loss is None:
        return f"{merit_of} every vehicle, detectable or not"
    unit = metric.unit.removesuffix("s") if abs(loss) == 1 else metric.unit
    return f"{merit_of} every detectable vehicle, minus {f'{abs(loss):g} {unit}'.rstrip()} for every other vehicle"


def weights_text(result: Mapping) -> str:
    """How much vehicles count in the objective, in a few words; empty where all count the same."""
    identity = result["identity"]
    classes = identity.get("[objective] class_weights") or {}
    zones = identity.get("[objective] zones") or []
    lines = [f"{name} {weight:g}" for name, weight in classes.items()]
    lines += [f"in {zone['name']} x {zone['weight']:g}" for zone in zones]
    return ", ".join(lines)


def definitions(result: Mapping) -> dict[str, str]:
    """What the objective, and with it its unit, and "detectable" mean in this run, a sentence or two each."""
    metric, identity = metric_named(result["metric"]), result["identity"]
    words = {
        "objective": f"{objective_text(result)}, summed over the vehicles in view, which are the same for every "
        "mounting.",
        "detectable": f"occupancy ({identity['[objective] view']} of the three views) of at least "
        f"{identity['[objective] threshold']:g}: a threshold on the metric, not a detector.",
    }
    if weights := weights_text(result):
        words["objective"] += (
            f" Each counts by its weight ({weights}; others 1): the objective per vehicle is the weighted mean. The "
            "detectable share counts every vehicle once."
        )
    if metric.tells:
        direction = "" if metric.higher_is_better else "; lower is better"
        words["objective"] += f" For each vehicle the metric, {metric.name}, tells {metric.tells}{direction}."
    return words


# --- How a number, a gain, an interval are written -------------------------------------------------------------


def counted(number: int, what: str) -> str:
    """A number of things: ``"1 frame"``, ``"2,000 frames"``, ``"2 boxes"``."""
    return f"{number:,} {what}{('es' if what.endswith('x') else 's') * (number != 1)}"


def minus(text: str) -> str:
    """A number's text with a minus that is as wide as a plus."""
    return text.replace("-", "\N{MINUS SIGN}")


def as_sentence(text: str) -> str:
    """A text that begins with a capital letter and ends with a full stop, if with no question mark."""
    return f"{text[0].upper()}{text[1:]}{'' if text.endswith('?') else '.'}"


def span(metric: Metric, ends: Sequence[float], more: int = 0, sign: str = "-") -> str:
    """The two ends of an interval; `more` and `sign` as for `Metric.number`."""
    return " to ".join(metric.number(end, more, sign) for end in ends)


def percent(scores: Mapping) -> str:
    """The detectable share in per cent."""
    return f"{100 * scores['detectable_share']:.1f} %"


def _gain(found, base):
    """Objective per vehicle over that of the baseline, in the metric's unit."""
    return found["objective_per_vehicle"] - base["objective_per_vehicle"]


# --- What a run comes to, in one sentence and in key figures ----------------------------------------------------------


def answer(result: Mapping) -> str:
    """The mounting and what it is worth against the baseline, with the interval where there is one."""
    kept = kept_text(result)
    *_, on = judged(result)
    return f"{_what_to_do(result)}: on {on} {worth(result)}." + (f" {as_sentence(kept)}" if kept else "")


def key_figures(result: Mapping) -> list[tuple[str, str]]:
    """The few figures that matter, each with what it is."""
    mount, (found, base, on), metric = result["deployment"], judged(result), metric_named(result["metric"])
    gain = f"gain{metric.per_vehicle}"
    if found.get("interval_90"):
        gain += f" (90 %: {minus(span(metric, found['interval_90']))})"
    figures = {
        "height above the road": f"{mount['height_m']:.2f} m",
        **_orientation(result),
        f"detectable on {on}": f"{100 * base['detectable_share']:.1f} \N{RIGHTWARDS ARROW} {percent(found)}",
        gain: minus(metric.difference(_gain(found, base), sign="+")),
    }
    return list(figures.items())


def _orientation(result):
    """The angle that a run is about, and what it is."""
    mount = result["deployment"]
    if not leans(result):
        return {"tilt across the road": minus(f"{mount['tilt_x_deg']:.1f}°")}
    way = "" if mount["lean_direction_deg"] is None else f" {direction_text(mount)}"
    return {f"lean{way}": f"{mount['lean_deg']:.1f}°"}


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


def sensor_text(result: Mapping) -> str:
    """The sensor's name; that of a user's own beam table in quotes, as it may be any word."""
    return result["sensor"] if result["sensor"] in model_names() else f'LiDAR "{result["sensor"]}"'


def _what_to_do(result):
    """The sentence's beginning: hang it there, or that nothing tried is better than the baseline."""
    sensor, place = sensor_text(result), place_text(result["deployment"], leans=leans(result))
    if not was_searched(result):
        return f"The {sensor} {place}"
    if not better_than_baseline(result):
        return f"No mounting that was tried is better than the baseline; the best of them has the {sensor} {place}"
    if _gain(*judged(result)[:2]) < 0.0:
        return f"Held-out traffic does not confirm the search, whose best mounting has the {sensor} {place}"
    if result.get("poles"):
        return f"Hang the {sensor} on pole {result['poles'][0]['name']}, {place}"
    return f"Hang the {sensor} {place}"


def worth(result: Mapping) -> str:
    """What the mounting is worth against the baseline where both are judged, on held-out frames if there are any."""
    found, base, _ = judged(result)
    gain, metric = _gain(found, base), metric_named(result["metric"])
    amount = f"{'gains' if gain >= 0.0 else 'loses'} {metric.difference(abs(gain))}"
    # A vehicle that gains metres or nats would sound like the reverse of what is meant where lower is better.
    gained = f"a vehicle {amount}" if metric.higher_is_better else f"the objective {amount} per vehicle"
    if metric.of_share:
        weighted = "by their weights " if weights_text(result) else ""
        gained = f"{weighted}that is {metric.number(abs(gain))} {'more' if gain >= 0.0 else 'fewer'} of 100 vehicles"
    return (
        f"{percent(found)} of the vehicles are detectable instead of {percent(base)} under the baseline, and "
        f"{gained}{_interval(result, metric, gain)}"
    )


def _interval(result, metric, gain):
    """The 90 % interval of the gain and what doubt it leaves, or why there is none."""
    if result["holdout"] is None:
        return "; nothing was held out, so there is no independent check and no interval"
    if result["holdout"]["interval_90"] is None:
        return "; there are too few blocks of time for an interval"
    low, high = result["holdout"]["interval_90"]
    doubt = "" if low > 0.0 or high < 0.0 else f", so that there may be no {'gain' if gain >= 0.0 else 'loss'} at all"
    return f" (90 % interval of the gain {span(metric, (low, high))}{doubt})"


# --- How far to trust the answer --------------------------------------------------------------------------------------

_SMALL_SHORTFALL = 0.01  # what a search may miss before more of it is advised
_ON_A_BOUND = 0.01  # of the width between two bounds: a search that reflects there comes close and never upon it
_WIDTHS = {"height_m": "height_m", "tilt_x_deg": "tilt_deg", "tilt_y_deg": "tilt_deg", "yaw_deg": "yaw_deg"}


def cautions(result: Mapping) -> list[str]:
    """What tolerance, search and map say about how far to trust the optimum, as sentences."""
    notes = (kept_text(result), costliest_text(result), _against_sharp(result), worst_text(result))
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
        if key in LEAN[1:]:  # given from -180 to 180 degrees, wherever it was searched
            place = low + (place - low) % 360.0
        slack = _ON_A_BOUND * (high - low)
        upright = key == "lean_deg" and low == 0.0 and place < high - slack  # beyond which nothing lies
        if not low + slack < place < high - slack and not upright:
            whose = "its pole" if key == "height_m" and result.get("pole") else "[deployment]"
            found.append(f"The best {name} lies on a bound of {whose}; a value beyond it may be better.")
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


def seeds_text(result: Mapping) -> str:
    """How far apart the searches with several seeds ended; empty where there was one."""
    spread = result.get("spread")
    if spread is None or len(spread["seeds"]) < 2:
        return ""
    places = []
    for key in spread["searched"]:
        name, unit = COORDINATE_NAMES[key]
        found = [one["deployment"][key] for one in spread["seeds"] if one["deployment"][key] is not None]
        if found and key in LEAN[1:]:  # on the circle, near the first
            found = [found[0] + math.remainder(angle - found[0], 360.0) for angle in found]
        if len(found) == len(spread["seeds"]):  # without a lean there is no direction
            places.append(f"{name} {min(found):.{_DIGITS[unit]}f} to {max(found):.{_DIGITS[unit]}f} {unit}")
    values = [one["objective_per_vehicle"] for one in spread["seeds"]]
    base, best = result["baseline"]["objective_per_vehicle"], max(values)
    lacks = f", the worst of them with {100 * (best - min(values)) / (best - base):.1f} % less gain than the best"
    return f"{len(values)} searches with other seeds ended at {', '.join(places)}{lacks if best > base else ''}"


def better_than_baseline(result: Mapping) -> bool:
    """Whether the mounting beats the baseline on the frames that were searched."""
    return result["objective"] > result["baseline"]["objective"]


def aim_text(settings: Mapping) -> str:
    """What counts of the objective over the errors of a tolerance."""
    return "mean" if settings["aim"] == "mean" else "what nine of ten installations reach"


def kept_text(result: Mapping) -> str:
    """How much of its gain the mounting keeps within the run's tolerance; empty without a tolerance or a gain."""
    scores, where = _judged_over_tolerance(result)
    if scores is None or scores["gain_kept"] is None:
        return ""
    settings = result["tolerance"]["settings"]
    return (
        f"within {tolerance_text(settings)} the mounting keeps {100 * scores['gain_kept']:.0f} % of its gain "
        f"({aim_text(settings)}, {where})"
    )


def costliest_text(result: Mapping) -> str:
    """Which single error at its limit costs most; empty without a tolerance, or where none costs anything."""
    scores, where = _judged_over_tolerance(result)
    limits = {} if scores is None else scores["loss_at_limits"]
    ends = ((loss, key, sign) for key in limits for loss, sign in zip(limits[key], "-+", strict=True))
    loss, key, sign = max(ends, default=(0.0, "", ""))
    if loss <= 0.0:
        return ""
    (name, unit), width = COORDINATE_NAMES[key], result["tolerance"]["settings"][_WIDTHS[key]]
    if key in TILTS[:2] and abs(math.remainder(result["deployment"]["yaw_deg"], 360.0)) >= _LEVEL_DEG:
        name = f"tilt about the sensor's own {'x' if key == 'tilt_x_deg' else 'y'} axis"
    metric = metric_named(result["metric"])
    lost = f"{metric.difference(loss)}{metric.per_vehicle}"
    return f"of single installation errors, {name} {sign}{width:g} {unit} costs most: {lost} ({where})"


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


def _judged_over_tolerance(result):
    """Scores of the mounting over the tolerance where it is judged, None without one, and which frames that is."""
    if result.get("tolerance") is None:
        return None, ""
    scores = result["tolerance"]["robust"]["optimised"]
    if scores["holdout"] is not None:
        return scores["holdout"], "held-out frames"
    return scores, f"{frames_word(result)} frames"


_DIGITS = {"m": 2, "deg": 1}


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
