"""What if: other traffic than was recorded at a site, thinned, in queues, or of other vehicles."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ..scene.observation import CountedFrame
from ..scene.site import Site
from ..traffic.fleet import Gaps, queued
from ..traffic.vehicles import Vehicles

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
    step = int(site.recording.vehicle_id.max()) + 1
    road = site.scenario.road_map
    anchor = float(road.locate(np.array([site.scenario.deployment.nominal_xy])).s_m[0])
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
