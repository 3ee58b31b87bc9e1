"""One frame's traffic made lighter or denser, with more lorries or fewer, lane by lane.

A model for asking what would change, not a forecast: vehicles keep their lanes, their order and their sizes, unless
they are turned into others, and queue up anew with the gaps that they are given.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ..traffic import RoadFrame
from ..traffic.vehicles import CLASSES, Vehicles

CAR, VAN, TRUCK, BUS = (CLASSES.index(name) for name in ("car", "van", "truck", "bus"))
TRUCK_SIZE_M = (12.7, 2.59, 3.8)  # I-80's median lorry, and the height that NGSIM's get
CAR_SIZE_M = (4.5, 2.1, 1.5)  # I-80's median car
_ALONG = np.cos(np.radians(30.0))  # of the heading: what drives across the road does not queue

Gaps = Callable[[np.ndarray], np.ndarray]
"""New bumper gaps from old ones [m]; negative where vehicles overlap."""


def thinned(vehicles: Vehicles, kept_ids: np.ndarray) -> Vehicles:
    """Only the vehicles of those ids."""
    return vehicles.select(np.isin(vehicles.vehicle_id, kept_ids))


def as_trucks(vehicles: Vehicles, ids: np.ndarray) -> Vehicles:
    """The vehicles of those ids turned into lorries where they stand; `queued` makes room for them."""
    return _turned_into(vehicles, ids, TRUCK, TRUCK_SIZE_M)


def as_cars(vehicles: Vehicles, ids: np.ndarray) -> Vehicles:
    """The vehicles of those ids turned into cars where they stand."""
    return _turned_into(vehicles, ids, CAR, CAR_SIZE_M)


def _turned_into(vehicles: Vehicles, ids: np.ndarray, class_index: int, size_m: tuple[float, ...]) -> Vehicles:
    chosen = np.isin(vehicles.vehicle_id, ids)
    size, centre = vehicles.size_m.copy(), vehicles.centre_m.copy()
    ground = centre[:, 2] - 0.5 * size[:, 2]
    size[chosen] = size_m
    centre[:, 2] = ground + 0.5 * size[:, 2]
    kind = np.where(chosen, class_index, vehicles.class_index).astype(vehicles.class_index.dtype)
    return replace(vehicles, size_m=size, centre_m=centre, class_index=kind)


def queued(
    vehicles: Vehicles,
    lengths_m: np.ndarray,
    gaps: Gaps,
    *,
    anchor_x_m: float,
    road: RoadFrame,
    filled_to_m: float = 0.0,
    copies_from: int = 0,
) -> Vehicles:
    """Vehicles lined up anew, lane by lane, about the one that is nearest to `anchor_x_m`, which stays.

    Parameters
    ----------
    vehicles : Vehicles
        One frame, with the sizes that they are to have.
    lengths_m : ndarray, (n,)
        The lengths that they had: what their gaps are measured with.
    gaps : callable
        New bumper gaps from old ones.
    anchor_x_m : float
        Where the lanes are looked at [m].
    road : RoadFrame
        Its lanes, and strips as wide as they beside it, say who drives behind whom.
    filled_to_m : float
        How far to both sides of the anchor lanes are to be full [m]. A lane of the road that ends nearer is continued
        with itself, the same vehicles under other numbers, as the recording knows none beyond its ends.
    copies_from : int
        More than any vehicle's number: a copy has its original's and a multiple of this.

    Returns
    -------
    Vehicles
        With copies, if any, at the end. What drives across the road stays where it is.
    """
    along = np.abs(np.cos(vehicles.heading_rad)) >= _ALONG
    lane = np.floor((vehicles.centre_m[:, 1] - road.carriageway_y[0]) / road.lane_width_m).astype(int)
    x = vehicles.centre_m[:, 0].copy()
    copied_rows, copied_x, copied_turn = [], [], []
    for number in np.unique(lane[along]):
        rows = np.flatnonzero(along & (lane == number))
        rows = rows[np.argsort(x[rows], kind="stable")]
        if len(rows) < 2:
            continue
        old, new = lengths_m[rows], vehicles.size_m[rows, 0]
        spread = gaps(np.diff(x[rows]) - 0.5 * (old[1:] + old[:-1]))
        places = np.concatenate([[0.0], np.cumsum(spread + 0.5 * (new[1:] + new[:-1]))])
        middle = np.argmin(np.abs(x[rows] - anchor_x_m))
        places += x[rows[middle]] - places[middle]
        period = places[-1] - places[0] + 0.5 * (new[0] + new[-1]) + float(np.median(spread))
        x[rows] = places
        if not 0 <= number < road.lanes or period < new.sum():  # a ramp ends where it ends; a pile cannot be continued
            continue
        for turn in _turns(places[0] - anchor_x_m, places[-1] - anchor_x_m, period, filled_to_m):
            copied_rows.append(rows)
            copied_x.append(places + turn * period)
            copied_turn.append(np.full(len(rows), turn))
    queue = replace(vehicles, centre_m=np.column_stack([x, vehicles.centre_m[:, 1:]]))
    if not copied_rows:
        return queue
    rows, copied_x, turn = map(np.concatenate, (copied_rows, copied_x, copied_turn))
    together = queue.select(np.concatenate([np.arange(len(queue)), rows]))
    centre, ids = together.centre_m.copy(), together.vehicle_id.copy()
    centre[len(queue) :, 0] = copied_x
    ids[len(queue) :] += copies_from * np.where(turn > 0, 2 * turn - 1, -2 * turn)  # 1, 2, 3 ... for turns 1, -1, 2 ...
    return replace(together, centre_m=centre, vehicle_id=ids)


def _turns(first: float, last: float, period: float, reach: float) -> list[int]:
    """By how many periods the copies of a lane are shifted that fill it from -reach to reach; not 0, itself."""
    before = max(0, int(np.ceil((first + reach) / period)))
    after = max(0, int(np.ceil((reach - last) / period)))
    return [*range(-before, 0), *range(1, after + 1)]
