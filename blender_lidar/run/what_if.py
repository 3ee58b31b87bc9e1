"""What if: coverage of a mounting under other traffic than was recorded, with lorries near it above all."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np

from ..casting import BVH, EXACT
from ..scene.deployment import SearchSpace
from ..scene.mounting import Layout, Mounting, changed_mounting
from ..scene.site import Site
from ..scoring.evaluation import Evaluator
from ..scoring.fidelity import evenly_spread
from ..statistics import drawn_share_interval_90
from ..traffic.boxes import WAY_COLUMNS, Boxes
from ..traffic.fleet import (
    BUS,
    CAR,
    TRUCK,
    VAN,
    Gaps,
    heights_are_assumed,
    lorries_in_place,
    queued,
    turned_into,
    with_variety,
)
from ..traffic.vehicles import CLASSES, DIMENSIONS
from .as_hung import as_planned, errors_of_frames, hung_scores, judge_as_hung, searching
from .comparison import Comparison
from .vehicle_table import APPROACH, approaches, lanes, vehicle_tables

# --- Other traffic ----------------------------------------------------------------------------------------------------

JAM_GAPS_M = (1.0, 2.5)


def thinned(site: Site, share: float, seed: int) -> Site:
    """The site with that share of its vehicles."""
    ids = np.unique(site.recording.vehicle_id)
    kept = ids[np.random.default_rng(seed).random(len(ids)) < share]
    return with_traffic(site, lambda vehicles: vehicles.select(np.isin(vehicles.vehicle_id, kept)))


def jammed(site: Site, seed: int = 0) -> Site:
    """The site with queues that close up; nothing is drawn."""
    return with_traffic(site, lambda vehicles: vehicles, lambda gaps: np.clip(gaps, *JAM_GAPS_M), site.reach_m)


def with_traffic(
    site: Site, change: Callable[[Boxes], Boxes], gaps: Gaps | None = None, filled_to_m: float = 0.0
) -> Site:
    """The site with every frame's traffic changed, as the recording has it before anything is cut off.

    What is changed queues up again with other `gaps`, if any; see `queued`. In held-out frames nothing counts that
    counts in a searched frame, as recorded or changed, nor copies of it: a queue that closes up brings vehicles into
    the region that were not there yet.
    """
    step = _copies_from(site)
    road = site.scenario.road_map
    anchor = float(road.locate(np.array([site.scenario.nominal_xy])).s_m[0])
    place = {"anchor_m": anchor, "road": road, "copies_from": step}

    def changed(number: int, frame: Boxes) -> Boxes:
        recorded = site.recording.at(number)
        vehicles = change(recorded)
        if gaps is not None:
            vehicles = queued(vehicles, recorded.size_m[:, 0], gaps, filled_to_m=filled_to_m, **place)
        return _with_ways_of(frame, site.counted(vehicles))

    searched = tuple(map(changed, site.plan.search, site.search))
    held_out = tuple(map(changed, site.plan.holdout, site.holdout))
    chosen = [frame.vehicle_id[frame.counted] % step for frame in searched]
    chosen = np.concatenate([site.plan.searched_ids, *chosen])
    judged = (replace(frame, counted=frame.counted & ~np.isin(frame.vehicle_id % step, chosen)) for frame in held_out)
    return replace(site, search=searched, holdout=tuple(judged))


def _with_ways_of(recorded: Boxes, frame: Boxes) -> Boxes:
    """A frame of changed traffic with the ways that its vehicles have in the recorded one."""
    if recorded.approach is None:
        return frame
    row = recorded.rows_of(frame.vehicle_id)  # -1, the last: nothing
    return replace(frame, **{name: np.append(getattr(recorded, name), "")[row] for name in WAY_COLUMNS})


def _copies_from(site: Site) -> int:
    """More than any vehicle's number: a copy's number modulo this is its original's."""
    return int(site.recording.vehicle_id.max()) + 1


def with_lorries(site: Site, near_to: Sequence[float] | None, near: int | None, share: float, seed: int) -> Site:
    """The site with that share of lorries in the lanes nearest to a place, in all for None; they keep their gaps.

    Which cars and vans turn into lorries is drawn once for each vehicle, so that a greater share has those of a smaller
    one. Lorries and buses that were recorded count among them, motorcycles stay. No vehicle is added.
    """
    road = site.scenario.road_map
    chosen = None if near is None else _by_distance(site, near_to)[:near]

    def here(vehicles: Boxes) -> np.ndarray:
        if chosen is None:
            return np.ones(len(vehicles), dtype=bool)
        return np.isin(road.locate(vehicles.centre_m, vehicles.heading_rad).lane, chosen)

    ids_of = _turning(site, here, share, seed)
    return with_traffic(site, lambda vehicles: turned_into(vehicles, ids_of(vehicles), TRUCK), lambda gaps: gaps)


def with_lorries_in_place(site: Site, approach: str | None, share: float, seed: int) -> Site:
    """The site with that share of lorries among the vehicles from an approach, all for None, where no queue is lined
    up again: a lorry keeps its front bumper and is as long as the gap behind it allows; see `lorries_in_place`.

    Which cars and vans turn into lorries is drawn as for `with_lorries`; they are those within reach.
    """
    surface, frames = site.scenario.road_map.surface, (*site.search, *site.holdout)
    near = [frame.vehicle_id[slice(None) if approach is None else frame.approach == approach] for frame in frames]
    there = np.unique(np.concatenate([np.zeros(0, dtype=np.int64), *near]))
    ids_of = _turning(site, lambda vehicles: np.isin(vehicles.vehicle_id, there), share, seed)

    def turned(vehicles: Boxes) -> Boxes:
        lorries = lorries_in_place(vehicles, ids_of(vehicles))
        risen = surface.height(lorries.centre_m) - surface.height(vehicles.centre_m)
        return replace(lorries, centre_m=lorries.centre_m + np.outer(risen, [0.0, 0.0, 1.0]))

    return with_traffic(site, turned)


def _turning(site: Site, here: Callable[[Boxes], np.ndarray], share: float, seed: int) -> Callable[[Boxes], np.ndarray]:
    """What gives the numbers of a frame's cars and vans that turn into lorries where `here` is true of a vehicle.

    So many that lorries and buses, those that were recorded among them, have that share there in all frames.
    """
    recording = site.recording
    ids = np.unique(recording.vehicle_id)
    drawn = np.random.default_rng(seed).random(len(ids))

    frames = map(recording.at, (*site.plan.search, *site.plan.holdout))
    kinds = np.concatenate([vehicles.class_index[here(vehicles)] for vehicles in frames])
    small, large = (int(np.isin(kinds, classes).sum()) for classes in ((CAR, VAN), (TRUCK, BUS)))
    missing = (share * (small + large) - large) / max(small, 1)

    def turning(vehicles: Boxes) -> np.ndarray:
        turns = (
            np.isin(vehicles.class_index, (CAR, VAN))
            & here(vehicles)
            & (drawn[np.searchsorted(ids, vehicles.vehicle_id)] < missing)
        )
        return vehicles.vehicle_id[turns]

    return turning


def _by_distance(site: Site, xy: Sequence[float]) -> np.ndarray:
    """Rows of the road map's lanes, the nearest to a place first."""
    return np.argsort(np.hypot(*(site.scenario.road_map.nearest(xy) - xy).T), kind="stable")


LORRY_SHARES = (0.1, 0.3, 1.0)
_LIGHT, _RUSH = 0.25, 0.5  # of the vehicles, and of the gaps
_ON_LANES = 0.5  # of the vehicles that count, for the road map's lanes to be theirs


def rush_hour(site: Site, seed: int = 0) -> Site:
    """The site with half the gaps between vehicles, at the same speed; nothing is drawn."""
    return with_traffic(site, lambda vehicles: vehicles, lambda gaps: _RUSH * gaps, site.reach_m)


def with_other_heights(site: Site, seed: int) -> Site:
    """The site with the heights that `[world] variety = 1` draws where all vehicles of a kind have one."""
    near = np.concatenate([frame.vehicle_id for frame in (*site.search, *site.holdout)])
    varied = with_variety(site.recording, 1.0, seed, ids=near)
    return with_traffic(replace(site, recording=varied), lambda vehicles: vehicles)


class Mix(NamedTuple):
    """Other traffic: what it is, and `change(site, seed=)`, which makes it of a site; with or without a draw.

    `lanes` and `lorries` are where lorries drive and their share, None where it is not about them; `approach` is the
    name of the approach that they come from, None where it is about none.
    """

    what: str
    value: str
    change: Callable[..., Site]
    is_drawn: bool
    lanes: str | None = None
    lorries: float | None = None
    approach: str | None = None

    @property
    def told(self) -> dict[str, object]:
        """What it is, as JSON holds it."""
        return {name: getattr(self, name) for name in ("what", "value", "lanes", "lorries", "approach")}


OTHER_HEIGHTS = "other heights"


def mixes(site: Site, near_to: Sequence[float]) -> list[Mix]:
    """Lorries by lane or approach, light traffic, rush hour and a queue, and other heights where these were assumed.

    Beside a straight road lorries drive in the lanes nearest to a place. On a map, where they are lorries in place,
    they come from each approach, there alone, which takes one draw, and shares of them are in all of the site; there is
    no rush hour and no queue, as how queues stand across a map's lanes is not modelled.
    """
    straight, light = site.scenario.road_map.endless, "a quarter of the vehicles"
    found = _lorries_by_lane(site, near_to) if straight else _lorries_by_approach(site)
    found.append(Mix("light traffic", light, partial(thinned, share=_LIGHT), True))
    if straight:
        found.append(Mix("rush hour", "half the gaps", rush_hour, False))
        found.append(Mix("queue", "gaps of {:g} to {:g} m".format(*JAM_GAPS_M), jammed, False))
    if not site.scenario.world.variety and heights_are_assumed(site.recording):
        found.append(Mix(OTHER_HEIGHTS, "as in a real fleet", with_other_heights, True))
    return found


def _lorries(where: str, share: float, change: Callable[..., Site], approach: str | None = None) -> Mix:
    """Lorries somewhere; where every car and van becomes one, nothing is drawn."""
    of = partial(change, share=share)
    return Mix(f"lorries in {where}", f"{100 * share:g} %", of, share < 1.0, where, share, approach)


def _lorries_by_lane(site: Site, near_to: Sequence[float]) -> list[Mix]:
    """Lorries in the lanes nearest to a place, and in all.

    Where most vehicles drive off the lanes of the road map, as at a crossing, they are in every lane alone.
    """
    road, near = site.scenario.road_map, {1: "the nearest lane", 2: "the two nearest lanes"}
    frames = (*site.search, *site.holdout)
    centre, number = (
        np.concatenate([getattr(frame, what)[frame.counted] for frame in frames]) for what in ("centre_m", "lane")
    )
    known = len(centre) and road.on(centre).mean() >= _ON_LANES
    own = number[road.locate(centre).lane == _by_distance(site, near_to)[0]]
    if known and own.any():
        near[1] += f" (lane {np.bincount(np.maximum(own, 0)).argmax()})"
    lanes = [(count, name) for count, name in near.items() if known and count < len(road)]
    return [
        _lorries(name, share, partial(with_lorries, near_to=tuple(near_to), near=count))
        for count, name in (*lanes, (None, "every lane"))
        for share in LORRY_SHARES
    ]


def _lorries_by_approach(site: Site) -> list[Mix]:
    """Lorries alone from each approach that vehicles come from that count, and shares of them in all of the site."""
    frames = [frame for frame in (*site.search, *site.holdout) if frame.approach is not None]
    names = {name for frame in frames for name in frame.approach[frame.counted].tolist() if name}
    found = [
        _lorries(f"approach {name}", 1.0, partial(with_lorries_in_place, approach=name), name) for name in sorted(names)
    ]
    where = "every lane" if site.scenario.road_map.lanes else "the whole area"
    return found + [_lorries(where, share, partial(with_lorries_in_place, approach=None)) for share in LORRY_SHARES]


# --- Coverage under it ------------------------------------------------------------------------------------------------

_FRAMES, _SLOW_FRAMES = 20, 3  # of the judging ones: the share to a few points, in a twentieth of a run's time
_DRAWS = 2  # of what is drawn, so that its interval holds the draw


def other_traffic(site: Site, layout: Layout) -> dict[str, object]:
    """Coverage of a mounting as hung when other traffic drives, as JSON holds it.

    Each frame is seen under installation errors of its own, the same in all traffic.

    Parameters
    ----------
    site : Site
    layout : Layout
        The plan. Lanes are the nearest to its first LiDAR.

    Returns
    -------
    dict
        ``frames`` looked at; ``recorded`` and ``mixes``: ``what`` and its ``value``, ``lanes``, ``lorries`` and
        ``approach``, ``draws``, ``boxes`` of a draw, ``distinct_vehicles``, ``detectable_share``, its ``interval_90``,
        over draws too, and both of the former ``by_lane`` and ``by_approach``; whether lorries stand ``in_place`` and
        no queue is lined up again; ``fleet`` of `_fleet`.
    """
    few, seed = _judging(site), site.scenario.search.seed
    rows, errors = [], errors_of_frames(site.scenario, len(few.holdout))
    for mix in mixes(few, layout[0].xy):
        changed = [mix.change(few, seed=seed + draw) for draw in range(_DRAWS if mix.is_drawn else 1)]
        rows.append(mix.told | _coverage(changed, layout, errors))
    recorded = _coverage([with_traffic(few, lambda vehicles: vehicles)], layout, errors)
    in_place = not site.scenario.road_map.endless
    return {
        "frames": len(few.holdout),
        "recorded": recorded,
        "mixes": rows,
        "in_place": in_place,
        "fleet": _fleet(site),
    }


def _fleet(site: Site) -> dict[str, object]:
    """Which vehicles there are within reach in all frames, so that a figure without lorries is known for one.

    Returns
    -------
    dict
        ``recording``: whether the rest of the recording has no others either; ``size_m`` of each class, medians of
        boxes; ``assumed``, which of their dimensions, and ``by``, whose word that is.
    """
    vehicles, report = (*site.search, *site.holdout), site.recording.report
    kind, size = np.concatenate([one.class_index for one in vehicles]), np.concatenate([one.size_m for one in vehicles])
    present = np.unique(kind).tolist()
    return {
        "recording": set(np.unique(site.recording.class_index).tolist()) == set(present),
        "size_m": {CLASSES[each]: np.median(size[kind == each], axis=0).tolist() for each in present},
        "assumed": [name for name in DIMENSIONS if name in report.assumed_sizes],
        "by": "SUMO's default for the class" if report.format == "sumo" else "the usual of the class",
    }


def _judging(site: Site) -> Site:
    """The site with a few of the frames that judge, held-out or else searched ones, as its only, held-out ones."""
    split = "holdout" if any(frame.counted.any() for frame in site.holdout) else "search"
    frames = getattr(site, split)
    filled = np.flatnonzero([frame.counted.any() for frame in frames])
    most = _SLOW_FRAMES if site.observation.caster in (BVH, EXACT) else _FRAMES
    kept = filled[evenly_spread(len(filled), min(most, len(filled)))]
    parts = {f"holdout{name}": getattr(site.plan, f"{split}{name}")[kept] for name in ("", "_block", "_recording")}
    none = np.zeros(0, dtype=np.int64)
    parts |= dict.fromkeys(("search", "search_block", "search_recording"), none)
    if split == "search":
        parts["searched_ids"] = none
    return replace(site, plan=replace(site.plan, **parts), search=(), holdout=tuple(frames[row] for row in kept))


def _coverage(draws: Sequence[Site], layout: Layout, errors: np.ndarray | None) -> dict[str, object]:
    """What is detectable of traffic, all draws of it together, with its interval, and by lane and approach.

    A box is detectable as often as it is under the installation `errors` of its frame, (f, e, l, 4).
    """
    boxes = [_boxes(site, layout, errors, number) for number, site in enumerate(draws) if _counts(site)]
    if not boxes:
        return {"draws": len(draws), "boxes": 0, "distinct_vehicles": 0, "detectable_share": None} | {
            "interval_90": None,
            "by_lane": {},
            "by_approach": {},
        }
    table = {name: np.concatenate([one[name] for one in boxes]) for name in boxes[0]}
    plan, seed = draws[0].plan, draws[0].scenario.search.seed
    at, vehicle, hits = np.searchsorted(plan.holdout, table["frame"]), table["vehicle_id"], table["detectable"]

    def seen(rows: np.ndarray | slice) -> dict[str, object]:
        distinct = len(np.unique(vehicle[rows]))
        return {"distinct_vehicles": distinct, "detectable_share": float(hits[rows].mean())}

    where = plan.holdout_block[at], table["draw"], seed, plan.holdout_recording[at]
    ends = drawn_share_interval_90(hits, vehicle, *where)
    by_lane = lanes(table) if table["lane"].any() else []
    by_approach = approaches(table) if APPROACH in table else []
    return {
        "draws": len(draws),
        "boxes": round(len(at) / len(draws)),
        **seen(slice(None)),
        "interval_90": ends and list(ends),
        "by_lane": {name: seen(rows) for name, rows in by_lane},
        "by_approach": {name: seen(rows) for name, rows in by_approach},
    }


def _counts(site: Site) -> bool:
    """Whether any vehicle counts."""
    return any(frame.counted.any() for frame in site.holdout)


def _boxes(site: Site, layout: Layout, errors: np.ndarray | None, draw: int) -> dict[str, np.ndarray]:
    """The vehicle table of a site's held-out frames, copies under their originals' numbers, detectable as often as
    under the errors of the frame.
    """
    evaluator = Evaluator(site.holdout, site.observation, site.scoring)
    (table,) = vehicle_tables([layout], holdout=evaluator)
    if errors is not None:
        _, (table["detectable"],) = evaluator.under(errors).by_box([layout])
    return table | {
        "vehicle_id": table["vehicle_id"] % _copies_from(site),
        "draw": np.full(len(table["frame"]), draw),
    }


# --- Beyond the bound -------------------------------------------------------------------------------------------------

ON_A_BOUND = 0.01  # of the width between two bounds: a search that reflects there comes close and never upon it
_BESIDE_DEG = (-4.0, -2.0, 0.0, 2.0, 4.0)


def tilts_beside(
    mounting: Mounting, axis: str, bounds: Mapping[str, Sequence[float]], more_deg: Sequence[float]
) -> list[float]:
    """The tilt or lean of a mounting and what is by so much more, as far as its bounds allow; it alone where fixed."""
    planned = mounting.as_table()[axis]
    if axis not in bounds:
        return [planned]
    return sorted({float(np.clip(planned + more, *bounds[axis])) for more in more_deg})


def next_metre(site: Site, evaluator: Evaluator, space: SearchSpace, layout: Layout) -> dict | None:
    """What a metre more than allowed would gain: None unless the best height lies on its upper bound.

    It is about the one LiDAR of the space that is searched. Of a few tilts about the planned one, the best on the
    searched frames is judged, all as hung.

    Returns
    -------
    dict or None
        ``deployment``, and beside the mounting what `judge_as_hung` says of it, by the names of `as_planned`.
    """
    bounds, axis = space.places[0].bounds, space.axes[1]
    if "height_m" not in bounds:
        return None
    low, high = bounds["height_m"]
    number = space.slots.index(space.places[0])
    mounting = layout[number]
    if mounting.height_m < high - ON_A_BOUND * (high - low):
        return None
    higher = [
        changed_mounting(mounting, site.scenario.road_map, height_m=mounting.height_m + 1.0, **{axis: tilt})
        for tilt in tilts_beside(mounting, axis, bounds, _BESIDE_DEG)
    ]
    raised = [(*layout[:number], one, *layout[number + 1 :]) for one in higher]
    best = int(np.argmax(searching(site, evaluator).totals(raised).objective.sum(axis=1)))
    split, judging = evaluator.judging
    seed = site.scenario.search.seed if split == "holdout" else None
    both = [layout, raised[best]]
    boxes = Comparison.of_split(*vehicle_tables(both, **{split: judging}), split, site, seed)
    _, found = judge_as_hung(boxes, *hung_scores(site.scenario, judging, both))
    return {"deployment": higher[best].as_table(), **as_planned(found)}
