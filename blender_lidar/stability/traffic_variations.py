"""Lighter and denser traffic than the recording's, and other shares of lorries."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from ..study.scoring import CountedFrame
from ..study.site import Site
from ..study.variation import Variation
from ..traffic.vehicles import Vehicles
from .traffic_mix import BUS, CAR, TRUCK, VAN, as_cars, as_trucks, queued, thinned
from .variations import TRAFFIC

SHARES_KEPT = {"light: a quarter of it": 0.25, "medium: half of it": 0.5}
JAM_GAPS_M = (1.0, 2.5)
TRUCK_SHARES = (0.0, 0.1, 0.3)


def traffic_variations(site: Site, draws: int) -> list[Variation]:
    """The recording's traffic thinned, jammed, and with other shares of lorries; what is drawn `draws` times over."""
    numbers = range(1, draws + 1)
    found = [
        Variation(TRAFFIC, "density", text, partial(_light, share=share, seed=number), number)
        for text, share in SHARES_KEPT.items()
        for number in numbers
    ]
    found.append(Variation(TRAFFIC, "density", f"jammed: gaps of {JAM_GAPS_M[1]:g} m at most", _jammed))
    for share in TRUCK_SHARES:
        drawn = numbers if share else (0,)  # no lorries at all is no draw
        found += [
            Variation(TRAFFIC, "lorries", f"{100 * share:g} %", partial(_with_trucks, share=share, seed=number), number)
            for number in drawn
        ]
    return found


def _light(site: Site, share: float, seed: int) -> Site:
    ids = np.unique(site.recording.vehicle_id)
    kept = ids[np.random.default_rng(seed).random(len(ids)) < share]
    return _with_traffic(site, partial(thinned, kept_ids=kept))


def _jammed(site: Site) -> Site:
    def jam(vehicles):
        return _queued(site, vehicles, vehicles.size_m[:, 0], lambda gaps: np.clip(gaps, *JAM_GAPS_M), site.reach_m)

    return _with_traffic(site, jam)


def _with_trucks(site: Site, share: float, seed: int) -> Site:
    """The site with that share of lorries and buses among its vehicles: others turn into them, or they into cars."""
    ids, first = np.unique(site.recording.vehicle_id, return_index=True)
    kind = site.recording.class_index[first]
    large = np.isin(kind, (TRUCK, BUS))
    wanted = round(share * len(ids))
    rng = np.random.default_rng(seed)
    if wanted < large.sum():
        changed = rng.choice(ids[large], int(large.sum()) - wanted, replace=False)
        turned_into = as_cars
    else:
        small = ids[np.isin(kind, (CAR, VAN))]
        changed = rng.choice(small, min(wanted - int(large.sum()), len(small)), replace=False)
        turned_into = as_trucks

    def remix(vehicles):
        return _queued(site, turned_into(vehicles, changed), vehicles.size_m[:, 0], lambda gaps: gaps)

    return _with_traffic(site, remix)


def _queued(site, vehicles, lengths_m, gaps, filled_to_m=0.0):
    x_m, _ = site.scenario.deployment.nominal_xy
    return queued(
        vehicles,
        lengths_m,
        gaps,
        anchor_x_m=x_m,
        road=site.scenario.road,
        filled_to_m=filled_to_m,
        copies_from=_copies_from(site),
    )


def _copies_from(site: Site) -> int:
    return int(site.recording.vehicle_id.max()) + 1


def _with_traffic(site: Site, change: Callable[[Vehicles], Vehicles]) -> Site:
    """The site with every frame's traffic changed, as the recording has it before anything is cut off."""
    searched, held_out = (
        [site.counted(change(site.recording.vehicles(frame))) for frame in frames]
        for frames in (site.plan.search, site.plan.holdout)
    )
    step = _copies_from(site)
    chose = [site.plan.searched_ids, *(frame.vehicles.vehicle_id[frame.counted] % step for frame in searched)]
    judged = (_not_counting(frame, np.concatenate(chose), step) for frame in held_out)
    return replace(site, search=tuple(searched), holdout=tuple(judged))


def _not_counting(frame: CountedFrame, ids: np.ndarray, copies_from: int) -> CountedFrame:
    """A frame without some vehicles, nor copies of them, among those that count.

    In held-out frames these are what counts in any searched frame, as recorded or changed: a queue that closes up
    brings vehicles into the region that were not there yet.
    """
    return replace(frame, counted=frame.counted & ~np.isin(frame.vehicles.vehicle_id % copies_from, ids))
