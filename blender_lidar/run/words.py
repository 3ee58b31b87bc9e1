"""What a run is about, in words: mountings, sensors, regions, scenery, the objective.

`result` is everywhere the content of result.json.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import partial

from ..metrics.catalogue import PE_VGOP, metric_named
from ..metrics.metric import Metric
from ..scene.deployment import Installer, installers_text
from ..scene.mounting import ANGLES
from ..sensors.model import model_names
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
        if pointing is None and (mount["x_m"] or mount["y_m"]):
            parts.append(f"at x {mount['x_m']:.2f} m and y {mount['y_m']:.2f} m")
        return ", ".join(parts)
    facing, square = mount.get("facing_deg", 90.0), {90.0: "", -90.0: "facing -y"}
    facing = square.get(round(math.remainder(facing, 360.0), 6), f"facing {facing:.0f}° from +x")
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
    if pointing is None:  # where it stands and which way the mast faces is told with it
        parts += [facing] if facing else []
        parts += [f"at x {mount['x_m']:.2f} m and y {mount['y_m']:.2f} m"] if mount["x_m"] or mount["y_m"] else []
    return ", ".join(parts)


def boxes_text(scores: Mapping) -> str:
    """How many boxes were judged, and of how many vehicles."""
    return f"{counted(scores['boxes'], 'box')} of {counted(scores['distinct_vehicles'], 'vehicle')}"


def errors_text(result: Mapping) -> str:
    """Within what installation errors figures are expected, in a few words; "" where all hangs already."""
    return installers_text(Installer(**one["installer"]) for one in result["lidars"] if one["installer"])


def frames_word(result: Mapping) -> str:
    """What the frames are called that are not held out."""
    return "searched" if was_searched(result) else "scored"


def warnings_text(result: Mapping) -> list[str]:
    """What cannot be true of the traffic and was accepted, each as a sentence: the first lines of every output."""
    return [f"Warning, accepted ({one['name']}): {one['text']}." for one in result.get("warnings", ())]


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


def is_weighted(result: Mapping) -> bool:
    """Whether vehicles count by weights in the objective."""
    return bool(weights_text(result) or result.get("recordings"))


def definitions(result: Mapping) -> dict[str, str]:
    """What "detectable", the objective and other words of this run mean."""
    metric, identity = metric_named(result["metric"]), result["identity"]
    words = {
        "Detectable": f"occupancy ({identity['[objective] view']} of the three views) of "
        f"{identity['[objective] threshold']:g} or more: a score, no detector.",
        "Objective": f"{objective_text(result)}, summed over the vehicles in the region{metric_unit(metric)}.",
    }
    if classes := identity.get("[objective] classes"):
        words["Objective"] = words["Objective"].replace("the vehicles in the region", f"those of {', '.join(classes)}")
        words["Detectable"] += " Small boxes reach it with few returns: see points in vehicles.csv."
    if result.get("recordings"):
        words["Objective"] += " The frames of a recording together count as its weight."
    if weights := weights_text(result):
        words["Objective"] += f" Each vehicle counts by its weight ({weights}; others 1)."
    if is_weighted(result):
        words["Objective"] += (
            " The objective per vehicle is the weighted mean; the detectable share counts every vehicle once."
        )
    if metric.tells:
        direction = "" if metric.higher_is_better else "; lower is better"
        words["Objective"] += f" The metric, {metric.name}, says of a vehicle {metric.tells}{direction}."
    if errors := errors_text(result):
        words["As hung"] = (
            f"the mean over installation errors of {errors}, each uniform and independent of the others. Nine of ten "
            "installations, in traffic of this kind, reach the share that is given. Tables and charts that do not say "
            "as hung are exactly as planned."
        )
    words["90 % interval"] = (
        f"in brackets; from resampled blocks of {result['block_s']:g} s, because frames close in time show the same "
        "vehicles. Where nearly all blocks have 0 or 100 %, it also holds Clopper and Pearson's exact interval, for "
        "which each different vehicle is one trial."
    )
    if result["holdout"]:
        words["Held-out frames"] = (
            "later frames with other vehicles than the searched ones, which the search did not use."
        )
    words["Box"] = "a vehicle in one frame; a vehicle counts once in every frame that shows it."
    return words


def metric_unit(metric: Metric) -> str:
    """The unit of an objective, behind what it sums."""
    return f", in {metric.unit}" if metric.unit else ""


def sensor_text(result: Mapping) -> str:
    """The sensor's name; that of a user's own beam table in quotes, as it may be any word."""
    return result["sensor"] if result["sensor"] in model_names() else f'LiDAR "{result["sensor"]}"'


def layout_frames(result: Mapping) -> str:
    """What the frames are called that judge what each LiDAR of a layout adds."""
    return "held-out" if result["layout"]["judged_on"] == "holdout" else frames_word(result)
