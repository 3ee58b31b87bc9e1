"""What a run found, as sentences: for the command line, the page and the installation sheet.

`result` is everywhere the content of result.json.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import partial

import numpy as np

from ..metrics.catalogue import DETECTABLE, PE_VGOP, metric_named
from ..metrics.metric import Metric
from ..run.as_hung import as_planned
from ..run.vehicle_table import APPROACH
from ..scene.deployment import Installer, installers_text
from ..scene.mounting import ANGLES
from ..sensors.model import model_names
from ..statistics import FEW_BLOCKS, FEW_VEHICLES
from ..traffic.vehicles import counted

_TOLD_BELOW = 0.005
LEVEL_DEG = 0.05  # a smaller angle cannot be set on site

# --- What a run is about: its mountings, what judges them, and what the scores hold under -----------------------------


def each_lidar(result: Mapping) -> dict[str, Mapping]:
    """By the name of each LiDAR of a layout the result as of that one: where it hangs stands as of a single LiDAR.

    Scores stay those of the whole layout. A single LiDAR's is the result itself, under "".
    """
    rows, found = result.get("lidars") or (), {}
    if len(rows) < 2:
        return {"": result}
    spread = result["spread"] or {}
    for row in rows:
        name, own = row["name"], {"baseline": {**result["baseline"], "deployment": row["baseline"]}}
        if intervals := spread.get("optimum_interval_90"):  # names stand there where several are searched
            of = {key.rpartition(".")[::2]: ends for key, ends in intervals.items()}
            of = {key: ends for (lidar, key), ends in of.items() if lidar == name or (not lidar and row["bounds"])}
            own["spread"] = {**spread, "optimum_interval_90": of}
        found[name] = {**result, **row, **own}
    return found


def of_name(name: str, text: str) -> str:
    """A text behind the name of the LiDAR that it is about; that of a single one has none."""
    return f"{name}: {text}" if name else text


def was_searched(result: Mapping) -> bool:
    """Whether a search chose the mounting; otherwise it was given."""
    return result["search"] is not None


def mounting_name(result: Mapping) -> str:
    """What the run's mounting is called beside the baseline."""
    return "optimised" if was_searched(result) else "given"


def sides(result: Mapping) -> list[tuple[str, str, dict[str, Mapping[str, float]]]]:
    """What pictures show side by side, the baseline first: what each is called, its text, where each LiDAR hangs."""
    each = each_lidar(result)
    found = {"Baseline": {name: one["baseline"]["deployment"] for name, one in each.items()}}
    found[mounting_name(result).capitalize()] = {name: one["deployment"] for name, one in each.items()}
    text = partial(mounting_text, leans=leans(result))
    several = counted(len(each), "LiDAR") if len(each) > 1 else ""
    return [(name, several or text(mounts[""]), mounts) for name, mounts in found.items()]


def gate_text(result: Mapping) -> str:
    """The range gate, of several LiDARs each different one."""
    gates = {one["range_gate_m"]: None for one in each_lidar(result).values()}
    return f"range gate {' and '.join(f'{gate:g}' for gate in gates)} m"


def run_text(result: Mapping, *, held_out: bool = False) -> str:
    """The line below a chart's title: sensor, range gate, vehicles, and the metric where it is not the default.

    The vehicles are those of the searched frames, or of those `held_out` where there are any.
    """
    of, kind = (result["holdout"], "held-out frame") if held_out and result["holdout"] else (result, "frame")
    if held_out and result.get("cross_fitted"):  # every block of time judges
        parts = result, result["holdout"] or {"vehicles": 0, "frames": 0}
        of, kind = {key: sum(part[key] for part in parts) for key in ("vehicles", "frames")}, "frame"
    metric = "" if result["metric"] == PE_VGOP.name else f", metric {metric_named(result['metric']).name}"
    return (
        f"{result['sensor']}, {gate_text(result)}, "
        f"{counted(of['vehicles'], 'vehicle box')} in {counted(of['frames'], kind)}{metric}"
    )


def leans(result: Mapping) -> bool:
    """Whether a run speaks of a lean and its direction, as its scene does, and not of tilts and yaw."""
    rows = result.get("lidars") or [{}]
    return result.get("leans", rows[0].get("leans", False))


def mounting_text(mount: Mapping[str, float], *, leans: bool = False) -> str:
    """A mounting in a few words; `leans` as for `place_text`."""
    if leans:
        way = "" if mount["lean_direction_deg"] is None else f" towards {mount['lean_direction_deg']:.0f}°"
        return f"height {mount['height_m']:.2f} m, lean {mount['lean_deg']:.1f}°{way}"
    parts = [f"height {mount['height_m']:.2f} m", f"tilt {mount['tilt_x_deg']:.1f}°"]
    more = {"along the road": mount["tilt_y_deg"], "yaw": mount["yaw_deg"]}
    return ", ".join([*parts, *(f"{name} {angle:.1f}°" for name, angle in more.items() if angle)])


def direction_text(mount: Mapping[str, float], pointing: Mapping | None = None) -> str:
    """Which way a sensor leans: what lies there and its bearing, where `scene.directions.pointing` has told.

    Otherwise the nearest axis of the site frame, and how far off that axis.
    """
    if pointing:
        return f"{pointing['leans']}, bearing {pointing['lean_bearing_deg']:.0f}°"
    ways = {0.0: "along the road, {}+x", 90.0: "across the road, {}+y"}
    ways |= {180.0: "along the road, {}-x", -90.0: "across the road, {}-y"}
    bearing = mount["lean_direction_deg"] + mount.get("facing_deg", 90.0)
    nearest = min(ways, key=lambda way: abs(math.remainder(bearing - way, 360.0)))
    off = math.remainder(bearing - nearest, 360.0)
    turned = "" if abs(off) < 0.5 else f"{abs(off):.0f}° {'counter-' if off > 0 else ''}clockwise of "
    return ways[nearest].format(turned)


def place_text(mount: Mapping[str, float], *, leans: bool = False, pointing: Mapping | None = None) -> str:
    """A mounting in words that a sentence can hold, without the coordinates that are 0.

    `leans` says whether its orientation is given as a lean, which a mounting of result.json has besides its tilts;
    `pointing` is what result.json has of where it points.
    """
    aims = pointing if pointing and pointing["leans"] else None
    if leans:
        parts = [f"{mount['height_m']:.2f} m above the road", "level"]
        if mount["lean_deg"] >= LEVEL_DEG:
            parts[1] = f"leaning {mount['lean_deg']:.1f}° {direction_text(mount, aims)}"
        if abs(mount["spin_deg"]) >= LEVEL_DEG:
            parts.append(f"turned {mount['spin_deg']:.1f}° about its axis")
        if mount["x_m"] or mount["y_m"]:
            parts.append(f"at x {mount['x_m']:.2f} m and y {mount['y_m']:.2f} m")
        return ", ".join(parts)
    facing, square = mount.get("facing_deg", 90.0), {90.0: "", -90.0: "facing -y"}
    facing = square.get(round(math.remainder(facing, 360.0), 6), f"facing {facing:g}° from +x")
    across = "across it", "along it"
    if facing not in square.values():
        across = "towards where the mast faces", "sideways"
    tilts = dict(zip(ANGLES, across, strict=False))
    leaning = [f"{mount[key]:.1f}° {way}" for key, way in tilts.items() if abs(mount[key]) >= LEVEL_DEG]
    tilted = f"tilted {' and '.join(leaning)}" if leaning else "level"
    if aims and len(leaning) == 1:
        tilted = f"tilted {aims['lean_deg']:.1f}° down {aims['leans']}"
    parts = [f"{mount['height_m']:.2f} m above the road", tilted]
    if abs(mount["yaw_deg"]) >= LEVEL_DEG:
        parts.append(f"turned {mount['yaw_deg']:.1f}°")
    parts += [facing] if facing else []
    if mount["x_m"] or mount["y_m"]:
        parts.append(f"at x {mount['x_m']:.2f} m and y {mount['y_m']:.2f} m")
    return ", ".join(parts)


def judged(result: Mapping) -> tuple[Mapping, Mapping, str]:
    """Scores of the mounting and of the baseline where they are judged, and what traffic that is."""
    if (crossed := result.get("cross_fitted")) is not None:
        return crossed["optimised"], crossed["baseline"], "traffic left out in turn"
    if result["holdout"] is not None:
        return result["holdout"], result["baseline"]["holdout"], "held-out traffic"
    on = "the traffic that was used to choose the mounting" if was_searched(result) else "the scored traffic"
    return result, result["baseline"], on


def judged_hung(result: Mapping) -> tuple[Mapping, Mapping, str]:
    """The same as hung, by the same names: expected over installation errors, none of what hangs already."""
    found, base, on = judged(result)
    return {**found, **as_planned(found["as_hung"])}, {**base, **as_planned(base["as_hung"])}, on


def errors_text(result: Mapping) -> str:
    """Within what installation errors figures are expected, in a few words; "" where all hangs already."""
    return installers_text(Installer(**one["installer"]) for one in result["lidars"] if one["installer"])


def as_hung_word(result: Mapping) -> str:
    """Stands before a share that is one as hung; "" where that is the one as planned."""
    return "as hung " if errors_text(result) else ""


def frames_word(result: Mapping) -> str:
    """What the frames are called that are not held out."""
    return "searched" if was_searched(result) else "scored"


def warnings_text(result: Mapping) -> list[str]:
    """What cannot be true of the traffic and was accepted, each as a sentence: the first lines of every output."""
    return [f"Warning, accepted ({one['name']}): {one['text']}." for one in result.get("warnings", ())]


def where_text(result: Mapping) -> str:
    """Where the mast stands and which way it faces in the recording's own coordinates."""
    places = []
    for name, one in each_lidar(result).items():
        at, mast = one["pointing"], f"mast of {name}" if name else "mast"
        place = f"the {mast} stands at x {at['x_m']:.2f} m, y {at['y_m']:.2f} m"
        places.append(f"{place} and faces {at['facing_bearing_deg']:.0f}°")
    place = "; ".join(places)
    return f"In the recording's own coordinates ({at['frame']}) {place}; bearings are clockwise from their +y."


def assumed_texts(result: Mapping) -> list[str]:
    """What was assumed, a sentence each."""
    return [as_sentence(text) for text in result["assumptions"]]


def conditions(result: Mapping) -> list[str]:
    """What the scores hold under besides the mounting: an imperfect sensor, scenery."""
    each = {name: imperfections_text(one["imperfections"]) for name, one in each_lidar(result).items()}
    imperfect = next(iter(each.values()))
    if len(set(each.values())) > 1:
        imperfect = "; ".join(f"{name} {text or 'exact'}" for name, text in each.items())
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
    elif region["junction"] or region["approaches"] or region["lanes"]:
        parts = [f"at junction {region['junction']}"] if region["junction"] else []
        if region["approach_m"]:
            named = ", ".join(region["approaches"] or ()) or ("all its approaches" if region["junction"] else "")
            parts += [f"on the last {region['approach_m']:g} m of {named}"] if named else []
        parts += [f"on lanes {', '.join(region['lanes'])}"] if region["lanes"] else []
        text = " and ".join(parts)
    else:
        x, y = region["centre_m"]
        text = f"within {region['radius_m']:g} m of x {x:g} m, y {y:g} m"
    keep_out = region["keep_out"]
    return text + (f", without {counted(len(keep_out), 'keep-out polygon')}" if keep_out else "")


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


def scenery_text(counts: Mapping | None) -> str:
    """How much scenery stood there, in a few words; empty where the scene has none."""
    if counts is None:
        return ""
    text = f"{', '.join(counted(counts[what + 's'], what) for what in ('object', 'triangle'))} within reach"
    if counts.get("z_m"):
        text += ", z {:.1f} to {:.1f} m".format(*(round(end, 1) + 0.0 for end in counts["z_m"]))
        text += f", {100 * counts['below_road']:.0f} % below the road" if counts["below_road"] >= _TOLD_BELOW else ""
    return text


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


def _is_weighted(result):
    return bool(weights_text(result) or result.get("recordings"))


def definitions(result: Mapping) -> dict[str, str]:
    """What the objective, and with it its unit, and "detectable" mean in this run, a sentence or two each."""
    metric, identity = metric_named(result["metric"]), result["identity"]
    words = {
        "objective": f"{objective_text(result)}, summed over the vehicles in view, which are the same for every "
        "mounting.",
        "detectable": f"occupancy ({identity['[objective] view']} of the three views) of at least "
        f"{identity['[objective] threshold']:g}: a threshold on the metric, not a detector.",
    }
    if classes := identity.get("[objective] classes"):
        words["objective"] = words["objective"].replace("the vehicles in view", f"those in view ({', '.join(classes)})")
        words["detectable"] += " Small boxes reach it with few returns: see points in vehicles.csv."
    if result.get("recordings"):
        words["objective"] += " The frames of a recording together count as its weight."
    if weights := weights_text(result):
        words["objective"] += f" Each vehicle counts by its weight ({weights}; others 1)."
    if _is_weighted(result):
        words["objective"] += (
            " The objective per vehicle is the weighted mean; the detectable share counts every vehicle once."
        )
    if metric.tells:
        direction = "" if metric.higher_is_better else "; lower is better"
        words["objective"] += f" For each vehicle the metric, {metric.name}, tells {metric.tells}{direction}."
    return words


# --- How a number, a gain, an interval are written -------------------------------------------------------------


def minus(text: str) -> str:
    """A number's text with a minus that is as wide as a plus."""
    return text.replace("-", "\N{MINUS SIGN}")


def as_sentence(text: str) -> str:
    """A text that begins with a capital letter and ends with a full stop, if with no question mark."""
    return f"{text[0].upper()}{text[1:]}{'' if text.endswith('?') else '.'}"


def span(metric: Metric, ends: Sequence[float], more: int = 0, sign: str = "-") -> str:
    """The two ends of an interval; `more` and `sign` as for `Metric.number`."""
    return " to ".join(metric.number(end, more, sign) for end in ends)


def decimals_of(ends: Sequence[float], most: int) -> int:
    """Decimals that a 90 % interval allows a number: down to the first digit of its half-width, or to the second of 1x.

    `most` is the number of decimals that an interval of no width leaves.
    """
    step = (ends[1] - ends[0]) / 4.0
    return min(max(math.ceil(-math.log10(step)), 0), most) if step > 0.0 else most


def measured(metric: Metric, value: float, ends: Sequence[float] | None, sign: str = "-") -> tuple[str, str]:
    """A number and its 90 % interval as texts, with the digits that the interval allows; "" where there is none.

    Without an interval a share has whole per cent, and any other value one digit less than a vehicle's.
    """
    if not ends:
        return metric.number(value, -1, sign), ""
    more = decimals_of(metric.shown(np.asarray(ends)), metric.decimals) - metric.decimals
    return metric.number(value, more, sign), span(metric, ends, more, sign)


def change_text(metric: Metric, value: float, ends: Sequence[float] | None, unit: str) -> str:
    """A difference with its interval; one that holds 0 shows none, and without an interval nothing is shown."""
    number, within = measured(metric, value, ends, "+")
    unsure = ", which holds 0: not shown" if ends and ends[0] <= 0.0 <= ends[1] else ""
    return f"{minus(number)} {unit}{in_brackets(within + unsure) or ' (no interval)'}"


def approaches_text(result: Mapping) -> str:
    """The detectable share of each approach under the mounting, in per cent with 90 % intervals; "" without any."""
    found = []
    for group in result.get("groups", ()):
        if group["by"] == APPROACH:
            share, ends = measured(DETECTABLE, group["after"], group["after_interval_90"])
            found.append(f"{group['name']} {share} %{f' ({ends})' if ends else ''}")
    return f"detectable by approach: {', '.join(found)}" if found else ""


def share_texts(scores: Mapping) -> tuple[str, str]:
    """`measured` of the detectable share of scores in result.json, in per cent."""
    return measured(DETECTABLE, scores["detectable_share"], scores.get("detectable_share_interval_90"))


def percent(scores: Mapping) -> str:
    """The detectable share in per cent, with its 90 % interval where it has one."""
    share, ends = share_texts(scores)
    return f"{share} % ({ends})" if ends else f"{share} %"


def boxes_text(scores: Mapping) -> str:
    """How many boxes were judged, and of how many vehicles: each counts once in every frame that shows it."""
    return f"{counted(scores['boxes'], 'box')} of {counted(scores['distinct_vehicles'], 'vehicle')}"


def _gain(found, base):
    """Objective per vehicle over that of the baseline, in the metric's unit."""
    return found["objective_per_vehicle"] - base["objective_per_vehicle"]


def _unsigned(metric, value, ends):
    """A difference without its sign, and its interval turned with it, as `measured`."""
    if value < 0.0:
        value, ends = -value, ends and [-end for end in reversed(ends)]
    number, within = measured(metric, value, ends)
    return number, f" ({minus(within)})" if within else ""


# --- What a run comes to, in one sentence and in key figures ----------------------------------------------------------


def answer(result: Mapping) -> str:
    """The mounting and what it is worth against the baseline, with the interval where there is one."""
    (found, _, on), hung = judged(result), as_hung_word(result)
    text = f"{_what_to_do(result)}: {hung}on {on} ({boxes_text(found)}) {worth(result)}."
    return " ".join([text, *map(as_sentence, filter(None, (planned_text(result), over_single_text(result))))])


def planned_text(result: Mapping) -> str:
    """What nine of ten installations reach, and what is seen exactly as planned and a little off; "" without errors."""
    if not errors_text(result):
        return ""
    found, _, _ = judged(result)
    hung, (planned, within) = found["as_hung"], share_texts(found)
    worst = {"one degree off in one tilt": hung["worst_degree"], "10 cm off in height": hung["worst_10_cm"]}
    off = " and ".join(f"{what} at worst {_share(share)} %" for what, share in worst.items())
    low = (
        ""
        if hung["nine_of_ten"] is None
        else f"nine of ten installations, in traffic of this kind, reach {_share(hung['nine_of_ten'])} %; "
    )
    return f"{low}exactly as planned it would be {planned} %{in_brackets(within)}, {off}"


def short_planned_text(result: Mapping) -> str:
    """The same in a short line, for a panel."""
    hung = judged(result)[0]["as_hung"]
    return f"1° off {_share(hung['worst_degree'])} %, 10 cm off {_share(hung['worst_10_cm'])} % at worst"


def _share(share):
    return DETECTABLE.number(share, -1)


def over_single_text(result: Mapping) -> str:
    """What a layout gains over its best single LiDAR, or over what hung already; "" of a single one."""
    layout, metric = result.get("layout") or {}, metric_named(result["metric"])
    if not (gain := layout.get("over_single")):
        return ""
    first = layout["steps"][0]["added"]
    what = f"the best single LiDAR {'that was found' if was_searched(result) else 'of them'}"
    if was_searched(result) and all(one["bounds"] is None for one in result["lidars"] if one["name"] in first):
        what = "what hung already"
    measures = [("the detectable share", DETECTABLE, "share_gain", "share_gain_interval_90", "percentage points")]
    if not metric.of_share:
        unit = f"{metric.unit} per vehicle".lstrip()
        measures.append(("the objective", metric, "objective_gain", "interval_90", unit))
    texts = []
    for of, measure, key, interval, unit in measures:
        texts.append(f"{of} changes by {change_text(measure, gain[key], gain[interval], unit)}")
    planned, on = "exactly as planned and " if errors_text(result) else "", layout_frames(result)
    return f"{planned}compared with {what} ({' and '.join(first)}), {' and '.join(texts)}, on {on} frames"


def layout_frames(result: Mapping) -> str:
    """What the frames are called that judge what each LiDAR of a layout adds."""
    return "held-out" if result["layout"]["judged_on"] == "holdout" else frames_word(result)


def key_figures(result: Mapping) -> list[tuple[str, str]]:
    """The few figures that matter, each with what it is."""
    each, (found, base, on), metric = each_lidar(result), judged_hung(result), metric_named(result["metric"])
    (after, within), (before, _) = share_texts(found), share_texts(base)
    if len(each) > 1:
        figures = [
            (f"{name}, {one['sensor']}", mounting_text(one["deployment"], leans=leans(one)))
            for name, one in each.items()
        ]
    else:
        height = f"{result['deployment']['height_m']:.2f} m"
        figures = [("height above the road", height), *_orientation(result).items()]
    hung = as_hung_word(result)
    figures.append((f"detectable {hung}on {on}{in_brackets(within)}", f"{before} \N{RIGHTWARDS ARROW} {after} %"))
    if hung and found["nine_of_ten"] is not None:
        figures.append(("what nine of ten installations reach", f"{_share(found['nine_of_ten'])} %"))
    gains = {("detectable vehicles", "percentage points"): (DETECTABLE, "detectable_share_gain")}
    if not metric.of_share or _is_weighted(result):
        of = "objective, weighted" if metric.of_share else f"objective{metric.per_vehicle}"
        gains[of, "percentage points" if metric.of_share else metric.unit] = metric, None
    for (what, unit), (of, key) in gains.items():
        value, ends = (
            (found[key], found[f"{key}_interval_90"]) if key else (_gain(found, base), found.get("interval_90"))
        )
        number, within = measured(of, value, ends, "+")
        figures.append((f"gain in {what}{in_brackets(within)}", minus(f"{number} {unit}".rstrip())))
    return figures


def in_brackets(within: str) -> str:
    """An interval behind what it belongs to; nothing for none."""
    return f" (90 %: {minus(within)})" if within else ""


def _orientation(result):
    """The angle that a run is about, and what it is."""
    mount = result["deployment"]
    if not leans(result):
        return {"tilt across the road": minus(f"{mount['tilt_x_deg']:.1f}°")}
    way = "" if mount["lean_direction_deg"] is None else f" {direction_text(mount, result['pointing'])}"
    return {f"lean{way}": f"{mount['lean_deg']:.1f}°"}


def sensor_text(result: Mapping) -> str:
    """The sensor's name; that of a user's own beam table in quotes, as it may be any word."""
    return result["sensor"] if result["sensor"] in model_names() else f'LiDAR "{result["sensor"]}"'


def _what_to_do(result):
    """The sentence's beginning: hang it there, or what leaves that in doubt."""
    places = []
    for name, one in each_lidar(result).items():
        place = place_text(one["deployment"], leans=leans(one), pointing=one["pointing"])
        pole = one["pole"] if name else (result.get("poles") or [None])[0]
        pole = f" on pole {pole['name']}," if pole and (name or better_than_baseline(result)) else ""
        places.append(f"{sensor_text(one)}{f' {name}' * bool(name)}{pole} {place}")
    hung = "; the ".join(places)
    if not was_searched(result):
        return f"The {hung}"
    what = "mounting" if len(places) == 1 else "layout"
    if why := doubt(result):
        return f"{why}; the best {what} found has the {hung}"
    return f"Hang the {hung}"


def doubt(result: Mapping) -> str:
    """Why what was searched or what judges does not carry the advice to hang a LiDAR there; "" where both do."""
    if not better_than_baseline(result):
        what = "mounting" if len(each_lidar(result)) == 1 else "layout"
        return f"No {what} that was tried is better than the baseline"
    found, base, on = judged_hung(result)
    ends, shares, on = found.get("interval_90"), found["detectable_share_gain_interval_90"], f"{on[0].upper()}{on[1:]}"
    if judged(result)[0] is result:
        return "Nothing was held out, so this has no independent check"
    if ends is None:
        return "Too few blocks of time are held out for an interval"
    if ends[1] < 0.0 or _gain(found, base) < 0.0 or (shares and shares[1] < 0.0):
        return f"{on} does not confirm the search: there the mounting does worse than the baseline"
    if ends[0] <= 0.0:
        return f"{on} does not show that this gains anything (the interval of the gain holds 0)"
    if not shares or shares[0] <= 0.0:
        return f"{on} shows a gain in the objective, but not that more vehicles become detectable"
    if found["blocks"] < FEW_BLOCKS:
        return f"{on} is only {counted(found['blocks'], 'block')} of time, too few to be sure of an interval"
    if result["holdout"] is None:
        return "Nothing was held out, so this mounting itself has no independent check"
    return ""


def worth(result: Mapping) -> str:
    """What the mounting is worth against the baseline where both are judged, on held-out frames if there are any.

    The detectable share comes first, then the objective; all with 90 % intervals, or why there are none.
    """
    found, base, _ = judged_hung(result)
    (after, within), (before, base_within) = share_texts(found), share_texts(base)
    metric, share = metric_named(result["metric"]), found["detectable_share_gain"]
    within = f" (90 % interval {within})" if within else ""
    base_within = f" ({base_within})" if base_within else ""
    number, around = _unsigned(DETECTABLE, share, found["detectable_share_gain_interval_90"])
    points = f"{number} percentage points {'more' if share > 0.0 else 'fewer'}{around}"
    points = points if share else f"no difference{around}"
    walking = "pedestrian" in (result.get("identity", {}).get("[objective] classes") or ())
    text = f"{after} % of the {'road users' if walking else 'vehicles'} are detectable{within} "
    text += f"instead of {before} %{base_within} under the baseline, {points}"
    if not metric.of_share or _is_weighted(result):
        gain = _gain(found, base)
        number, around = _unsigned(metric, gain, found.get("interval_90"))
        of = "weighted share" if metric.of_share else "objective"
        unit = "percentage points" if metric.of_share else f"{metric.unit} per vehicle".lstrip()
        text += f", and the {of} {'gains' if gain >= 0.0 else 'loses'} {number} {unit}{around}"
    return text + _no_interval(result, found)


def _no_interval(result, found):
    """Why the detectable share has no interval; "" where it has one."""
    if found["detectable_share_interval_90"]:
        return ""
    if judged(result)[0] is result and was_searched(result):
        return "; there is no interval, as the same traffic has chosen the mounting"
    if found["distinct_vehicles"] < FEW_VEHICLES:
        return f"; shares have no interval, as there are fewer than {FEW_VEHICLES} different vehicles"
    return "; there are too few blocks of time for intervals"


def better_than_baseline(result: Mapping) -> bool:
    """Whether the mounting beats the baseline as hung, on the frames that were searched."""
    return result["objective_as_hung"] > result["baseline"]["objective_as_hung"]
