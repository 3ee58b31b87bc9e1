"""Quantities of a run, and its tables: mountings side by side, groups of boxes, candidate poles, what LiDARs add.

`result` is everywhere the content of result.json without its document.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from ..document import HELD_OUT, LEFT_OUT, SCORED, SEARCHED, Basis, Quantity, Table, adding_up
from ..metrics.catalogue import metric_named
from ..metrics.metric import Metric
from ..scene.mounting import ANGLES, COORDINATE_NAMES, LEANS
from ..statistics import FEW_VEHICLES
from ..traffic.vehicles import counted
from .words import each_lidar, errors_text, frames_word, layout_frames, leans, mounting_name, was_searched

# --- Quantities of a run ----------------------------------------------------------------------------------------------


def share(key: str, label: str, value: float, ends: Sequence[float] | None = None, basis: Basis | None = None):
    """A share of boxes as a quantity in per cent, from values of 0 to 1."""
    return Quantity(key, label, 100.0 * value, "%", _percent(ends), basis)


def points(key: str, label: str, value: float, ends: Sequence[float] | None = None, basis: Basis | None = None):
    """A difference of shares as a quantity in percentage points."""
    return Quantity(key, label, 100.0 * value, "points", _percent(ends), basis, signed=True)


def amount(metric: Metric, key: str, label: str, value: float, ends=None, basis=None, *, signed: bool = False):
    """A mean of a metric, or a `signed` difference of two, as a quantity."""
    if metric.of_share:
        return (points if signed else share)(key, label, value, ends, basis)
    ends = ends and tuple(ends)
    return Quantity(key, label, value, metric.unit, ends, basis, metric.decimals - 1, signed)


def _percent(ends):
    return ends and tuple(100.0 * end for end in ends)


def judged_on(result: Mapping) -> str:
    """The split of frames on which the mounting is judged."""
    if result.get("cross_fitted") is not None:
        return LEFT_OUT
    if result["holdout"] is not None:
        return HELD_OUT
    return SEARCHED if was_searched(result) else SCORED


def judged(result: Mapping) -> tuple[Mapping, Mapping, Basis]:
    """Scores of the mounting and of the baseline as planned where they are judged, and what they stand on."""
    found, base, split = result, result["baseline"], judged_on(result)
    if split == LEFT_OUT:
        found, base = (result["cross_fitted"][name] for name in ("optimised", "baseline"))
    elif split == HELD_OUT:
        found, base = found["holdout"], base["holdout"]
    sizes = found["boxes"], found["distinct_vehicles"], found.get("blocks", 0)
    return found, base, Basis(split, *sizes, hung=False, chosen_here=split == SEARCHED)


def quantities(result: Mapping) -> dict[str, Quantity]:
    """What a mounting is worth beside the baseline where both are judged, as hung where installation errors shake it.

    ``before``, ``after`` and ``points`` of the detectable share, which add up as they are written, ``objective``, what
    it gains; ``low``, ``degree``, ``height`` and ``planned`` with installation errors.
    """
    (found, base, basis), metric = judged(result), metric_named(result["metric"])
    hung, before = found["as_hung"], base["as_hung"]
    on = basis._replace(hung=bool(errors_text(result)))
    shares = adding_up(
        share("baseline", "detectable, baseline", before["detectable_share"], before["interval_90"], on),
        share("detectable", "detectable", hung["detectable_share"], hung["interval_90"], on),
        points("gain", "gain in detectable vehicles", hung["gain"], hung["gain_interval_90"], on),
    )
    gain = hung["objective_gain"], hung["objective_gain_interval_90"]
    objective = f"gain in the {'weighted share' if metric.of_share else f'objective{metric.per_vehicle}'}"
    told = dict(zip(("before", "after", "points"), shares, strict=True))
    told["objective"] = amount(metric, "objective_gain", objective, *gain, on, signed=True)
    if on.hung:
        told["degree"] = share("worst_degree", "one degree off in one tilt, at worst", hung["worst_degree"], None, on)
        told["height"] = share("worst_10_cm", "10 cm off in height, at worst", hung["worst_10_cm"], None, on)
        ends = found["detectable_share_interval_90"]
        told["planned"] = share("planned", "exactly as planned", found["detectable_share"], ends, basis)
        if hung["nine_of_ten"] is not None:
            told["low"] = share("nine_of_ten", "nine of ten installations reach", hung["nine_of_ten"], None, on)
    return told


def group_shares(result: Mapping, by: str) -> dict[str, Quantity]:
    """The detectable share of each group under the mounting, exactly as planned; of ten different vehicles or more."""
    return {
        one["name"]: share(
            f"{by} {one['name']}",
            one["by"].replace("distance", one["name"]) if by == "distance" else one["name"],
            one["after"],
            one["after_interval_90"],
            Basis(judged_on(result), one["boxes"], one["distinct_vehicles"]),
        )
        for one in result["groups"]
        if one["by"].split()[0] == by and one["distinct_vehicles"] >= FEW_VEHICLES
    }


# --- Tables -----------------------------------------------------------------------------------------------------------


def run_tables(result: Mapping) -> Iterator[Table]:
    """All tables of a run, the mountings side by side first."""
    yield _sides(result)
    yield from _groups(result)
    if result.get("poles"):
        yield _poles(result)
    if result.get("layout"):
        yield from _layout(result)
    if result.get("recordings"):
        yield _recordings(result)


def _sides(result: Mapping) -> Table:
    """Baseline and mounting: where they hang, and scores on each split of frames, as planned and as hung."""
    rows: list[tuple] = []
    for name, one in each_lidar(result).items():
        rows += [(name,)] * bool(name) + _coordinates(one)
    parts = [(f"{'Searched' if was_searched(result) else 'Scored'} frames", result["baseline"], result)]
    if result["holdout"]:
        parts.append(("Held-out frames", result["baseline"]["holdout"], result["holdout"]))
    if crossed := result.get("cross_fitted"):
        parts.append(("Each block left out in turn", crossed["baseline"], crossed["optimised"]))
    for split, before, after in parts:
        blocks = f", {counted(after['blocks'], 'block')} of time" if "blocks" in after else ""
        planned = ", exactly as planned" if errors_text(result) else ""
        rows += [(f"{split}{blocks}{planned}",), *_scores(result, before, after)]
    if errors_text(result):
        found, base, basis = judged(result)
        rows += [(f"As hung, {basis.split} frames",), *_hung_scores(result, base["as_hung"], found["as_hung"])]
    title = f"Baseline and {mounting_name(result)} mounting"
    return Table("mountings", title, ("", "baseline", mounting_name(result), "gain"), tuple(rows))


def _coordinates(one: Mapping) -> list[tuple]:
    """Where a LiDAR hangs in both mountings."""
    mounts = [side["deployment"] for side in (one["baseline"], one)]
    shown = COORDINATE_NAMES.keys() - (ANGLES if leans(one) else LEANS)
    always = ("height_m", "lean_deg" if leans(one) else "tilt_x_deg")
    return [
        (name, *(None if mount[key] is None else _length(key, name, mount[key], unit) for mount in mounts), None)
        for key, (name, unit) in COORDINATE_NAMES.items()
        if key in shown and (key in always or any(mount[key] for mount in mounts))
    ]


def _length(key: str, name: str, value: float, unit: str) -> Quantity:
    return Quantity(key, name, value, "°" if unit == "deg" else unit, decimals=2)


def _shares(before: Mapping, after: Mapping, gain: float, ends: Sequence[float] | None) -> tuple[Quantity, ...]:
    """Detectable shares of two scores and their difference, which add up as they are written."""
    first, last = (
        share("detectable_share", "detectable", one["detectable_share"], one["ends"]) for one in (before, after)
    )
    return adding_up(first, last, points("detectable_share_gain", "gain", gain, ends))


def _with_ends(scores: Mapping, key: str = "detectable_share_interval_90") -> dict:
    return {"detectable_share": scores["detectable_share"], "ends": scores.get(key)}


def _scores(result: Mapping, before: Mapping, after: Mapping) -> list[tuple]:
    """Scores of both mountings on the same frames, as planned."""
    metric = metric_named(result["metric"])
    gain = after["detectable_share_gain"], after["detectable_share_gain_interval_90"]
    rows = [
        ("boxes", *(f"{one['boxes']:,}" for one in (before, after)), None),
        ("different vehicles", *(f"{one['distinct_vehicles']:,}" for one in (before, after)), None),
        ("detectable share", *_shares(_with_ends(before), _with_ends(after), *gain)),
    ]
    if "objective" in after and not metric.of_share:
        unit = {"unit": metric.unit, "decimals": max(metric.decimals - 2, 0)}
        rows.append(
            (
                "objective",
                *(Quantity("objective", "objective", one["objective"], **unit) for one in (before, after)),
                None,
            )
        )
    values = [amount(metric, "objective_per_vehicle", "", one["objective_per_vehicle"]) for one in (before, after)]
    gained = None
    if "gain_over_baseline" in after:
        gained = amount(
            metric, "gain_over_baseline", "", after["gain_over_baseline"], after["interval_90"], signed=True
        )
    return [*rows, (f"objective{metric.per_vehicle or ', mean'}", *values, gained)]


def _hung_scores(result: Mapping, before: Mapping, after: Mapping) -> list[tuple]:
    """Scores of both mountings as hung, under the same errors."""
    metric = metric_named(result["metric"])
    rows = [
        (
            "detectable share",
            *_shares(
                *(_with_ends(one, "interval_90") for one in (before, after)), after["gain"], after["gain_interval_90"]
            ),
        )
    ]
    if after["nine_of_ten"] is not None:
        rows.append(
            (
                "nine of ten installations reach",
                *(share("nine_of_ten", "", one["nine_of_ten"]) for one in (before, after)),
                None,
            )
        )
    rows.append(("1° off in one tilt, at worst", None, share("worst_degree", "", after["worst_degree"]), None))
    rows.append(("10 cm off in height, at worst", None, share("worst_10_cm", "", after["worst_10_cm"]), None))
    values = [amount(metric, "objective_per_vehicle", "", one["objective_per_vehicle"]) for one in (before, after)]
    gain = amount(metric, "gain", "", after["objective_gain"], after["objective_gain_interval_90"], signed=True)
    return [*rows, (f"objective{metric.per_vehicle or ', mean'}", *values, gain)]


TOLD_BOXES = 10  # fewer are counts, and in one row together


def _groups(result: Mapping) -> Iterator[Table]:
    """Detectable share and objective per vehicle of groups of boxes, before and after, a table for each kind of group.

    Groups of fewer than ten boxes are counts, several beside larger ones in one row, "others".
    """
    metric, basis = metric_named(result["metric"]), judged(result)[2]
    columns = ("boxes", "vehicles", "detectable: before", "detectable: after", "detectable: gain")
    columns += ("objective: before", "objective: after")
    for by in dict.fromkeys(group["by"] for group in result["groups"]):
        groups = [group for group in result["groups"] if group["by"] == by]
        few = [group for group in groups if group["boxes"] < TOLD_BOXES]
        joined = few if 1 < len(few) < len(groups) else []
        rows = [
            _counted_row(group["name"], [group]) if group in few else _group_row(group, metric)
            for group in groups
            if group not in joined
        ]
        rows += [_counted_row("others", joined)] if joined else []
        title = f"By {by}, {basis.split} frames{', exactly as planned' * bool(errors_text(result))}"
        yield Table(f"by {by}", title, (by, *columns), tuple(rows), basis)


_WHEN = "before", "after"


def _group_row(group: Mapping, metric: Metric) -> tuple:
    """Numbers of boxes and vehicles of a group, shares and objective before and after."""
    ends = ({"detectable_share": group[when], "ends": group[f"{when}_interval_90"]} for when in _WHEN)
    means = (group[f"objective_{when}"] for when in _WHEN)
    objective = (None if mean is None else amount(metric, "objective", "", mean) for mean in means)
    shares = _shares(*ends, group["gain"], group["gain_interval_90"])
    return (group["name"], f"{group['boxes']:,}", f"{group['distinct_vehicles']:,}", *shares, *objective)


def _counted_row(name: str, groups: Sequence[Mapping]) -> tuple:
    """How many boxes of small groups are detectable before and after."""
    boxes = sum(group["boxes"] for group in groups)
    seen = (f"{round(sum(group[when] * group['boxes'] for group in groups))} of {boxes}" for when in _WHEN)
    vehicles = f"{groups[0]['distinct_vehicles']}" if len(groups) == 1 else None
    return (name, f"{boxes}", vehicles, *seen, None, None, None)


def _poles(result: Mapping) -> Table:
    """Candidate poles side by side, the best on the searched frames first."""
    metric, poles = metric_named(result["metric"]), result["poles"]
    held, hung = poles[0]["holdout"] is not None, "as hung" if errors_text(result) else "as planned"
    columns = ("pole", "height on it", f"objective {hung}, searched", f"detectable {hung if held else 'as planned'}")
    columns += ("difference, all together", "differs") * held + ("cost", "existing")
    rows = []
    for pole in poles:
        scores = pole["holdout"] or pole
        seen = (
            share("detectable_share", "", *(scores["as_hung"][k] for k in ("detectable_share", "interval_90")))
            if held
            else share("detectable_share", "", pole["detectable_share"])
        )
        cells = [
            Quantity("height_on_pole_m", "", pole["height_on_pole_m"], "m", decimals=2),
            amount(metric, "objective_per_vehicle_as_hung", "", pole["objective_per_vehicle_as_hung"]),
            seen,
        ]
        if held:
            off = scores["difference_to_best"], scores["interval_90"]
            cells.append(amount(metric, "difference_to_best", "", *off, signed=True) if pole["rank"] > 1 else None)
            cells.append(_YES[scores["differs"]])
        cells += [None if pole["cost"] is None else f"{pole['cost']:g}", _YES[pole["existing"]]]
        rows.append((pole["name"], *cells))
    judging = "held-out" if held else "searched" if was_searched(result) else "scored"
    return Table("poles", f"Candidate poles, {judging} frames, in the order of the searched ones", columns, tuple(rows))


_YES = {None: None, True: "yes", False: "no"}


def _layout(result: Mapping) -> Iterator[Table]:
    """What each of several LiDARs adds, and what each number of them comes to."""
    layout, metric = result["layout"], metric_named(result["metric"])
    on = layout_frames(result)

    def row(name: str, price: float | None, scores: Mapping, gain: Mapping | None) -> tuple:
        ends = scores["detectable_share_interval_90"]
        cells = [
            None if price is None else f"{price:g}",
            share("detectable_share", "", scores["detectable_share"], ends),
        ]
        if gain is None:
            return (name, *cells, None, None, None)
        objective = amount(metric, "objective_gain", "", gain["objective_gain"], gain["interval_90"], signed=True)
        gained = points("share_gain", "", gain["share_gain"], gain["share_gain_interval_90"])
        shown = None if gain["interval_90"] is None else _YES[gain["interval_90"][0] > 0.0]
        return (name, *cells, gained, objective, shown)

    head = ("price", "alone", "adds: detectable", "adds: objective", "adds: shown")
    parts = [
        row(f"{lidar['name']}, {lidar['sensor']}", lidar["price"], part["alone"], part["without"])
        for lidar, part in zip(result["lidars"], layout["parts"], strict=True)
        if part["alone"] is not None
    ]
    yield Table("parts", f"What each LiDAR adds, {on} frames", ("LiDAR", *head), tuple(parts))
    steps = [
        row(f"{one['lidars']}: {'+ ' * bool(one['gain'])}{', '.join(one['added'])}", one["price"], one, one["gain"])
        for one in layout["steps"]
    ]
    covered = [
        (f"{one['lidars']} or more", None, share("covered_by", "", one["share"], one["interval_90"]), None, None, None)
        for one in layout["covered_by"]
    ]
    rows = (*steps, ("By so many LiDARs themselves",), *covered)
    head = ("price", "detectable", "step: detectable", "step: objective", "step: shown")
    yield Table("steps", f"From one LiDAR to all, {on} frames", ("LiDARs", *head), rows)


def _recordings(result: Mapping) -> Table:
    """What a mounting is worth on each of several recordings."""
    metric, held = metric_named(result["metric"]), result["holdout"] is not None
    columns = ("recording", "weight", "detectable: before", "detectable: after", "detectable: gain")
    columns += ("objective: before", "objective: after", "objective: gain")
    rows = []
    for one, base in zip(result["recordings"], result["baseline"]["recordings"], strict=True):
        after, before = (one["holdout"], base["holdout"]) if held else (one, base)
        if after is None:
            rows.append((one["name"], f"{one['weight']:g}", "nothing held out", *[None] * 5))
            continue
        gain = after["detectable_share_gain"], after["detectable_share_gain_interval_90"]
        shares = _shares(_with_ends(before), _with_ends(after), *gain)
        means = (side["objective_per_vehicle"] for side in (before, after))
        values = (None if mean is None else amount(metric, "objective", "", mean) for mean in means)
        ends = after.get("gain_over_baseline"), after.get("interval_90")
        gained = None if ends[0] is None else amount(metric, "gain", "", *ends, signed=True)
        rows.append((one["name"], f"{one['weight']:g}", *shares, *values, gained))
    return Table(
        "recordings",
        f"Each recording alone, {'held-out' if held else frames_word(result)} frames",
        columns,
        tuple(rows),
    )
