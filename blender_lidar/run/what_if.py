"""What if: coverage of a mounting under other traffic than was recorded, with lorries in the near lanes above all."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np

from ..casting import BVH, EXACT
from ..scene.deployment import SearchSpace
from ..scene.mounting import Layout, Mounting, changed_mounting, mast_at
from ..scene.observation import CountedFrame
from ..scene.site import Site
from ..scoring.evaluation import Evaluator
from ..scoring.fidelity import evenly_spread
from ..statistics import share_interval_90
from ..traffic.fleet import BUS, CAR, TRUCK, VAN, Gaps, queued, turned_into
from ..traffic.vehicles import Vehicles
from .vehicle_table import BoxShares, lanes, vehicle_table, vehicle_tables
from .verdict import BASELINE_NAME, judge

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
    site: Site, change: Callable[[Vehicles], Vehicles], gaps: Gaps | None = None, filled_to_m: float = 0.0
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

    def changed(number: int) -> CountedFrame:
        recorded = site.recording.vehicles(number)
        vehicles = change(recorded)
        if gaps is not None:
            vehicles = queued(vehicles, recorded.size_m[:, 0], gaps, filled_to_m=filled_to_m, **place)
        return site.counted(vehicles)

    searched, held_out = (tuple(map(changed, frames)) for frames in (site.plan.search, site.plan.holdout))
    chosen = [frame.vehicles.vehicle_id[frame.counted] % step for frame in searched]
    chosen = np.concatenate([site.plan.searched_ids, *chosen])
    judged = (
        replace(frame, counted=frame.counted & ~np.isin(frame.vehicles.vehicle_id % step, chosen)) for frame in held_out
    )
    return replace(site, search=searched, holdout=tuple(judged))


def _copies_from(site: Site) -> int:
    """More than any vehicle's number: a copy's number modulo this is its original's."""
    return int(site.recording.vehicle_id.max()) + 1


def with_lorries(site: Site, near_to: Sequence[float] | None, near: int | None, share: float, seed: int) -> Site:
    """The site with that share of lorries in the lanes nearest to a place, in all for None; they keep their gaps.

    Which cars and vans turn into lorries is drawn once for each vehicle, so that a greater share has those of a smaller
    one. Lorries and buses that were recorded count among them, motorcycles stay. No vehicle is added.
    """
    road, recording = site.scenario.road_map, site.recording
    ids = np.unique(recording.vehicle_id)
    drawn = np.random.default_rng(seed).random(len(ids))
    chosen = None if near is None else _by_distance(site, near_to)[:near]

    def here(vehicles: Vehicles, *classes: int) -> np.ndarray:
        found = np.isin(vehicles.class_index, classes)
        if chosen is None:
            return found
        return found & np.isin(road.locate(vehicles.centre_m, vehicles.heading_rad).lane, chosen)

    frames = [recording.vehicles(number) for number in (*site.plan.search, *site.plan.holdout)]
    small = sum(int(here(vehicles, CAR, VAN).sum()) for vehicles in frames)
    large = sum(int(here(vehicles, TRUCK, BUS).sum()) for vehicles in frames)
    missing = (share * (small + large) - large) / max(small, 1)

    def turned(vehicles: Vehicles) -> Vehicles:
        turns = here(vehicles, CAR, VAN) & (drawn[np.searchsorted(ids, vehicles.vehicle_id)] < missing)
        return turned_into(vehicles, vehicles.vehicle_id[turns], TRUCK)

    return with_traffic(site, turned, lambda gaps: gaps)


def _by_distance(site: Site, xy: Sequence[float]) -> np.ndarray:
    """Rows of the road map's lanes, the nearest to a place first."""
    return np.argsort(np.hypot(*(site.scenario.road_map.nearest(xy) - xy).T), kind="stable")


LORRY_SHARES = (0.1, 0.3, 1.0)
_LIGHT, _RUSH = 0.25, 0.5  # of the vehicles, and of the gaps
_ON_LANES = 0.5  # of the vehicles that count, for the road map's lanes to be theirs


def rush_hour(site: Site, seed: int = 0) -> Site:
    """The site with half the gaps between vehicles, at the same speed; nothing is drawn."""
    return with_traffic(site, lambda vehicles: vehicles, lambda gaps: _RUSH * gaps, site.reach_m)


class Mix(NamedTuple):
    """Other traffic: what it is, and `change(site, seed=)`, which makes it of a site; with or without a draw.

    `lanes` and `lorries` are where lorries drive and their share; None where it is not about them.
    """

    what: str
    value: str
    change: Callable[..., Site]
    is_drawn: bool
    lanes: str | None = None
    lorries: float | None = None


def mixes(site: Site, near_to: Sequence[float]) -> list[Mix]:
    """Lorries in the lanes nearest to a place, light traffic, rush hour and a queue.

    Where most vehicles drive off the lanes of the road map, as at a crossing, lorries are in every lane alone. On a map
    it is light traffic alone: how queues stand across its lanes is not modelled.
    """
    light = Mix("light traffic", "a quarter of the vehicles", partial(thinned, share=_LIGHT), True)
    if site.scenario.straight is None:
        return [light]
    road, near = site.scenario.road_map, {1: "the nearest lane", 2: "the two nearest lanes"}
    frames = (*site.search, *site.holdout)
    centre, number = (
        np.concatenate([getattr(frame.vehicles, what)[frame.counted] for frame in frames])
        for what in ("centre_m", "lane")
    )
    known = len(centre) and road.on(centre).mean() >= _ON_LANES
    own = number[road.locate(centre).lane == _by_distance(site, near_to)[0]]
    if known and own.any():
        near[1] += f" (lane {np.bincount(np.maximum(own, 0)).argmax()})"
    lanes = [(count, name) for count, name in near.items() if known and count < len(road)]
    found = [
        Mix(
            f"lorries in {name}",
            f"{100 * share:g} %",
            partial(with_lorries, near_to=tuple(near_to), near=count, share=share),
            True,
            name,
            share,
        )
        for count, name in (*lanes, (None, "every lane"))
        for share in LORRY_SHARES
    ]
    rush, queue = Mix("rush hour", "half the gaps", rush_hour, False), "gaps of {:g} to {:g} m".format(*JAM_GAPS_M)
    return [*found, light, rush, Mix("queue", queue, jammed, False)]


# --- Coverage under it ------------------------------------------------------------------------------------------------

_FRAMES, _SLOW_FRAMES = 20, 3  # of the judging ones: the share to a few points, in a twentieth of a run's time
REPAIRED = 0.02  # of the recorded share is all that may be missing
_HIGHEST_M, _STEP_M = 12.0, 0.5
_MORE_DEG = (0.0, 5.0, 10.0)  # than planned, as a higher LiDAR needs


def other_traffic(site: Site, layout: Layout) -> dict[str, object]:
    """Coverage of a layout when other traffic drives, and what would repair it, as JSON holds it.

    Returns
    -------
    dict
        ``frames`` looked at; ``recorded`` and ``mixes``: ``what`` and its ``value``, ``lanes`` and ``lorries``,
        ``boxes``, ``distinct_vehicles``, ``detectable_share``, its ``interval_90``, and both of the latter ``by_lane``;
        and ``repair`` of lorries alone in the nearest lane where these, of ten vehicles or more, hide more than 2
        points from a single LiDAR: see `_repair`. Lanes are the nearest to the first LiDAR.
    """
    few, seed = _judging(site), site.scenario.search.seed
    whole = _coverage(with_traffic(few, lambda vehicles: vehicles), layout)
    rows, near = [], None
    for mix in mixes(few, layout[0].xy):
        changed = mix.change(few, seed=seed)
        told = {"what": mix.what, "value": mix.value, "lanes": mix.lanes, "lorries": mix.lorries}
        rows.append(told | _coverage(changed, layout))
        if near is None and mix.lorries == LORRY_SHARES[-1]:
            near = changed, rows[-1]
    (lorries, seen), enough, repair = near or (None, {}), (whole["detectable_share"] or 0.0) - REPAIRED, None
    if seen.get("interval_90") and seen["detectable_share"] < enough and len(layout) == 1:
        repair = _repair(lorries, layout[0], enough)
    return {"frames": len(few.holdout), "recorded": whole, "mixes": rows, "repair": repair}


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


def _coverage(site: Site, layout: Layout) -> dict[str, object]:
    """What is detectable of the traffic of a site, with its interval, and by lane where lanes are known."""
    plan, seed = site.plan, site.scenario.search.seed
    if not any(frame.counted.any() for frame in site.holdout):
        return dict.fromkeys(("boxes", "distinct_vehicles"), 0) | {
            "detectable_share": None,
            "interval_90": None,
            "by_lane": {},
        }
    table = vehicle_table(layout, holdout=Evaluator(site.holdout, site.observation, site.scoring))
    at, vehicle = np.searchsorted(plan.holdout, table["frame"]), table["vehicle_id"] % _copies_from(site)

    def seen(rows: np.ndarray | slice) -> dict[str, object]:
        distinct = len(np.unique(vehicle[rows]))
        return {"distinct_vehicles": distinct, "detectable_share": float(table["detectable"][rows].mean())}

    ends = share_interval_90(table["detectable"], vehicle, plan.holdout_block[at], seed, plan.holdout_recording[at])
    by_lane = lanes(table) if table["lane"].any() else []
    return {
        "boxes": len(at),
        **seen(slice(None)),
        "interval_90": ends and list(ends),
        "by_lane": {name: seen(rows) for name, rows in by_lane},
    }


def _repair(site: Site, mounting: Mounting, enough: float) -> dict[str, object]:
    """The least height that sees enough of a site's traffic, or the best, and what a pole on the other side sees.

    Returns
    -------
    dict
        ``height_m`` and ``tilt_deg`` (tilt across the road, or lean), ``detectable_share`` there, whether it
        ``repairs``, ``up_to_m`` what height was looked for and whether it is ``within_bounds``; ``other_side``, the
        share from a mirrored mounting across the road, None where no mast can stand there.
    """
    deployment, road = site.scenario.deployment, site.scenario.road_map
    places, axis = deployment.places, deployment.spaces[0].axes[1]
    place = min(places, key=lambda one: math.dist([np.mean(one.span(key)) for key in ("x_m", "y_m")], mounting.xy))
    _, high = place.bounds.get("height_m", (mounting.height_m,) * 2)
    up_to_m = max(_HIGHEST_M, high, mounting.height_m + _STEP_M)
    heights = np.arange(mounting.height_m + _STEP_M, up_to_m + 1e-9, _STEP_M)
    tilts = _tilts_beside(mounting, axis, place.bounds, _MORE_DEG)
    higher = [(height, tilt) for height in heights.tolist() for tilt in tilts]
    layouts = [(changed_mounting(mounting, road, height_m=height, **{axis: tilt}),) for height, tilt in higher]
    if (other := _on_other_side(site, mounting)) is not None:
        layouts.append((other,))
    shares = Evaluator(site.holdout, site.observation, site.scoring).totals(layouts).detectable_share()
    seen = shares[: len(higher)]
    sufficient = np.flatnonzero(seen >= enough)
    best = int(sufficient[0] if len(sufficient) else np.argmax(seen))
    height, tilt = higher[best]
    return {
        "height_m": height,
        "tilt_deg": tilt,
        "within_bounds": bool(height <= high),
        "repairs": bool(len(sufficient)),
        "up_to_m": float(up_to_m),
        "detectable_share": float(seen[best]),
        "other_side": None if other is None else float(shares[-1]),
    }


def _tilts_beside(
    mounting: Mounting, axis: str, bounds: Mapping[str, Sequence[float]], more_deg: Sequence[float]
) -> list[float]:
    """The tilt or lean of a mounting and what is by so much more, as far as its bounds allow; it alone where fixed."""
    planned = mounting.as_table()[axis]
    if axis not in bounds:
        return [planned]
    return sorted({float(np.clip(planned + more, *bounds[axis])) for more in more_deg})


def _on_other_side(site: Site, mounting: Mounting) -> Mounting | None:
    """The mirror image of a mounting across the road, as far from it; None where the mast stands over or between lanes.

    The rotor turns the same way in both: only the order in time of its returns is another.
    """
    road, side = site.scenario.road_map, site.scenario.road.side_of(mounting.xy)
    if side not in ("left", "right"):
        return None
    place = road.locate(np.array([mounting.xy]))
    x, y = road.at(place.s_m[0], sum(road.edges_t) - place.t_m[0])
    if road.clearance((x, y))[0] <= 0.0:
        return None
    facing = math.remainder(2.0 * place.heading_rad[0] - mounting.mast.facing_rad, 2.0 * math.pi)
    mast = mast_at(road, float(x), float(y), facing)
    return replace(mounting, mast=mast, tilt_y=-mounting.tilt_y, yaw=-mounting.yaw)


# --- Beyond the bound -------------------------------------------------------------------------------------------------

ON_A_BOUND = 0.01  # of the width between two bounds: a search that reflects there comes close and never upon it
_BESIDE_DEG = (-4.0, -2.0, 0.0, 2.0, 4.0)


def next_metre(site: Site, evaluator: Evaluator, space: SearchSpace, layout: Layout) -> dict | None:
    """What a metre more than allowed would gain: None unless the best height lies on its upper bound.

    It is about the one LiDAR of the space that is searched.

    Of a few tilts about the planned one, the best on the searched frames is judged as a run's own mounting is.

    Returns
    -------
    dict or None
        ``deployment``, and beside the mounting what `run.verdict.judge` and `BoxShares.share_scores` say of it on the
        frames that judge.
    """
    bounds, axis, split = space.places[0].bounds, space.axes[1], "holdout"
    if "height_m" not in bounds:
        return None
    low, high = bounds["height_m"]
    number = space.slots.index(space.places[0])
    mounting = layout[number]
    if mounting.height_m < high - ON_A_BOUND * (high - low):
        return None
    higher = [
        changed_mounting(mounting, site.scenario.road_map, height_m=mounting.height_m + 1.0, **{axis: tilt})
        for tilt in _tilts_beside(mounting, axis, bounds, _BESIDE_DEG)
    ]
    raised = [(*layout[:number], one, *layout[number + 1 :]) for one in higher]
    best = int(np.argmax(evaluator.totals(raised).objective.sum(axis=1)))
    layouts, seed = {"optimised": raised[best], BASELINE_NAME: layout}, site.scenario.search.seed
    verdict, judging = judge(site, layouts, evaluator, seed)["optimised"], evaluator.held_out
    if verdict["holdout"] is None:
        split, seed, judging = "search", None, evaluator
    after, before = vehicle_tables(list(layouts.values()), **{split: judging})
    shares = BoxShares.of_split(before, after, split, site.plan, seed).share_scores()
    return {"deployment": higher[best].as_table(), **(verdict["holdout"] or verdict), **shares}
