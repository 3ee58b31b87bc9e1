"""Variety of vehicles: a height and a body for each, drawn by its number, where traffic knows a height a class alone.

And other vehicles in their places: lorries for cars, queues with other gaps.

Shares and heights are round numbers of ours for the fleets of Europe and North America, not a survey: heights are
uniform between the 5 and 95 % points of what is sold under the name of a body. To compare: the mean boxes of nuScenes
by which detectors are set up (the anchors of OpenPCDet and mmdetection3d) are 1.72 m high for cars, with SUVs and
pick-ups among them, 2.73 for trucks, 3.82 for trailers, 3.47 for buses, 1.44 for motorcycles with riders; the EU allows
4.0 m (directive 96/53/EC), most of the USA 13 ft 6 in, 4.11 m.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ..road.road_map import RoadMap
from .boxes import Boxes
from .tracks import medians_of
from .vehicles import (
    CLASSES,
    FLEET_KINDS,
    HEIGHTS_M,
    PEDESTRIAN,
    Recording,
    fleet_kind,
    rectangles_overlap,
)

# --- Heights and bodies -----------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Body:
    """One of the bodies of a kind of vehicle.

    Attributes
    ----------
    name : str
        Of its shape, of `world.shapes`.
    share : float
        How many have it, among those whose length allows it.
    height_m : (float, float)
        The 5 and 95 % points of their heights, between which these are drawn uniform except for what goes with length.
    length_m : (float, float)
        How long they are [m].
    with_length : float
        How much of the height goes with the length, 0 to 1; below 0 the longer ones are the lower ones.
    """

    name: str
    share: float
    height_m: tuple[float, float]
    length_m: tuple[float, float] = (0.0, np.inf)
    with_length: float = 0.0


FLEET = {
    "car": (
        Body("car", 0.45, (1.40, 1.50), (3.8, np.inf), 0.3),
        Body("hatchback", 0.25, (1.43, 1.56), (0.0, 4.5), -0.5),
        Body("suv", 0.30, (1.53, 1.75), (3.9, np.inf), 0.5),
    ),
    "van": (
        Body("van", 0.25, (1.72, 1.98)),
        Body("large_suv", 0.30, (1.70, 1.95)),
        Body("pickup", 0.25, (1.75, 1.98)),
        Body("panel_van", 0.10, (1.97, 2.65), (4.9, np.inf), 0.4),
        Body("large_saloon", 0.10, (1.43, 1.52), (4.9, 5.5)),
    ),
    "truck": (
        Body("truck", 0.5, (2.8, 3.7)),
        Body("flatbed", 0.3, (2.2, 2.9)),
        Body("tank_truck", 0.2, (2.6, 3.3)),
    ),
    "long_truck": (
        Body("long_truck", 0.65, (3.6, 4.15)),
        Body("flatbed_trailer", 0.2, (3.0, 3.9)),
        Body("tanker_trailer", 0.15, (3.3, 3.8)),
    ),
    "bus": (Body("bus", 0.6, (2.9, 3.3)), Body("coach", 0.4, (3.4, 3.8))),
    "motorcycle": (Body("motorcycle", 1.0, (1.25, 1.6)),),
    "bicycle": (Body("bicycle", 1.0, (1.55, 1.9)),),
    "pedestrian": (Body("pedestrian", 1.0, (1.5, 1.9)),),
}
"""The bodies of each kind of vehicle, as `HEIGHTS_M` names the kinds, the usual one first."""
KIND_OF_BODY = {body.name: kind for kind, bodies in FLEET.items() for body in bodies}
BODIES = tuple(KIND_OF_BODY)
"""All of them by name; `Boxes.body` counts into them from 1 on."""
_LENGTHS_M = (3.5, 5.5)  # between which heights go with lengths


def with_variety(
    recording: Recording, variety: float, seed: int, number: int = 0, ids: np.ndarray | None = None
) -> Recording:
    """The same traffic with a height and a body for each vehicle, which stay its own in all frames.

    Heights are drawn where all vehicles of a kind have the same one, as in recordings without heights and in SUMO's
    with one type a class; who has a height of its own keeps it, and has a body that may be as high. Kinds are of
    vehicles, by their most frequent class and their median length, not by what was measured in a frame. Boxes stay
    where they stand: their floor is kept.

    Parameters
    ----------
    recording : Recording
    variety : float
        From 0, all are alike, to 1: so large a share of the vehicles has a body drawn from `FLEET`, others the usual
        one, and so far do heights move from the one to the drawn. A class's height that is not that of `HEIGHTS_M` is
        the middle of its heights in its place: all are scaled.
    seed : int
    number : int
        Of the recording among several, whose vehicles have the same numbers.
    ids : ndarray, optional
        The vehicles that are to differ; all if left out.
    """
    if not variety:
        return recording
    vehicle, of = np.unique(recording.vehicle_id, return_inverse=True)
    kind, length = _kinds(recording, of)
    own = _own_heights(recording, kind, of)
    height = medians_of(recording.size_m[:, 2], of)
    body, factor = np.zeros(len(vehicle), np.int8), np.ones(len(vehicle))
    for at in np.flatnonzero(np.ones(len(vehicle), bool) if ids is None else np.isin(vehicle, ids)).tolist():
        identity = int(vehicle[at])
        rng = np.random.default_rng([seed, number, identity % 2**64])
        name, drawn = _drawn(FLEET_KINDS[kind[at]], length[at], height[at] if own[at] else None, variety, rng)
        body[at], factor[at] = 1 + BODIES.index(name), 1.0 if own[at] else drawn
    size, centre = recording.size_m.copy(), recording.centre_m.copy()
    size[:, 2] *= factor[of]
    centre[:, 2] += 0.5 * (size[:, 2] - recording.size_m[:, 2])
    return replace(recording, size_m=size, centre_m=centre, body=body[of])


def heights_are_assumed(recording: Recording) -> bool:
    """Whether some vehicles have the one height of their kind, so that `with_variety` gives them others."""
    of = np.unique(recording.vehicle_id, return_inverse=True)[1]
    return not _own_heights(recording, _kinds(recording, of)[0], of).all()


def _own_heights(recording: Recording, kind: np.ndarray, of: np.ndarray) -> np.ndarray:
    """Which vehicles have a height of their own, by their kinds, (k,) bool: not where all of a kind have the same."""
    rows, own = kind[of], np.zeros(len(kind), dtype=bool)
    for each in np.unique(kind):
        given = recording.size_m[rows == each, 2]
        several = (kind == each).sum() > 1
        own[kind == each] = (given != given[0]).any() or not (several or given[0] == HEIGHTS_M[FLEET_KINDS[each]])
    return own


def _kinds(recording: Recording, of: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Of each vehicle its kind, a row of `FLEET_KINDS`, by its most frequent class and median length, and that [m]."""
    counts = np.bincount(of * len(CLASSES) + recording.class_index, minlength=(of.max(initial=-1) + 1) * len(CLASSES))
    length = medians_of(recording.size_m[:, 0], of)
    return fleet_kind(counts.reshape(-1, len(CLASSES)).argmax(axis=1), length), length


def _drawn(
    kind: str, length_m: float, own_height_m: float | None, variety: float, rng: np.random.Generator
) -> tuple[str, float]:
    """The name of a body of a kind, and by how much its height is more than the usual one.

    Where a vehicle has a height of its own, it is within those of the body, or this is the usual one.
    """
    bodies = FLEET[kind]
    fits = [one.length_m[0] <= length_m <= one.length_m[1] for one in bodies]
    if own_height_m is not None:
        holds = [one.height_m[0] <= own_height_m <= one.height_m[1] for one in bodies]
        fits = np.logical_and(fits, holds)
    share = np.array([one.share for one in bodies]) * fits
    other, choice, height = rng.random(3)
    row = 0
    if other < variety and share.any():
        row = int(np.searchsorted(np.cumsum(share), choice * share.sum(), side="right"))
    body = bodies[row]
    (shortest, longest), with_length = np.clip(body.length_m, *_LENGTHS_M), body.with_length
    along = np.clip((length_m - shortest) / (longest - shortest), 0.0, 1.0)
    rank = (1.0 - abs(with_length)) * height + abs(with_length) * (along if with_length > 0.0 else 1.0 - along)
    drawn = body.height_m[0] + rank * (body.height_m[1] - body.height_m[0])
    return body.name, 1.0 + variety * (drawn / HEIGHTS_M[kind] - 1.0)


# --- Vehicles turned into others, and queues --------------------------------------------------------------------------

CAR, VAN, TRUCK, BUS = (CLASSES.index(name) for name in ("car", "van", "truck", "bus"))
SIZE_M = {TRUCK: (12.7, 2.59, 3.8), CAR: (4.5, 2.1, 1.5)}  # I-80's median lorry, as high as NGSIM's get, and car
_BETWEEN = -(10**9)  # number of the strip next to the left carriageway, between both
_ALONG = np.cos(np.radians(30.0))  # of the heading off the lane's: what drives across the road does not queue

_KEPT_FREE_M = 1.0  # behind a lorry that has grown in its place

Gaps = Callable[[np.ndarray], np.ndarray]
"""New bumper gaps from old ones [m]; negative where vehicles overlap."""


def turned_into(vehicles: Boxes, ids: np.ndarray, kind: int) -> Boxes:
    """The vehicles of those ids turned into lorries or cars where they stand; `queued` makes room for them."""
    chosen = np.isin(vehicles.vehicle_id, ids)
    size, centre = vehicles.size_m.copy(), vehicles.centre_m.copy()
    ground = centre[:, 2] - 0.5 * size[:, 2]
    size[chosen] = SIZE_M[kind]
    centre[:, 2] = ground + 0.5 * size[:, 2]
    classes = np.where(chosen, kind, vehicles.class_index).astype(vehicles.class_index.dtype)
    body = None if vehicles.body is None else np.where(chosen, 0, vehicles.body)
    return replace(vehicles, size_m=size, centre_m=centre, class_index=classes, body=body)


def lorries_in_place(vehicles: Boxes, ids: np.ndarray) -> Boxes:
    """The vehicles of those ids turned into lorries that keep their front bumpers, as long as the room behind allows.

    Behind each 1 m stays free to the next box in its path: one whose extent across the lorry's heading overlaps the
    lorry's. None becomes shorter or narrower than it was. One that a lorry's width would push into another keeps its
    own. So no two boxes overlap that did not before. Nobody else moves.

    Parameters
    ----------
    vehicles : Boxes
        One frame.
    ids : ndarray
        Numbers of the vehicles that become lorries.
    """
    lorries = turned_into(vehicles, ids, TRUCK)
    centre, size = lorries.centre_m.copy(), lorries.size_m.copy()
    centre[:, :2], size[:, :2] = vehicles.centre_m[:, :2], vehicles.size_m[:, :2]
    heading = vehicles.heading_rad
    forward = np.stack([np.cos(heading), np.sin(heading)], axis=1)
    for row in np.flatnonzero(np.isin(vehicles.vehicle_id, ids)).tolist():
        own, left = size[row, :2].copy(), np.array([-forward[row, 1], forward[row, 0]])
        front = centre[row, :2] + 0.5 * own[0] * forward[row]
        extents = _extents(centre[:, :2] - front, size, forward, np.stack([forward[row], left]))
        extents = np.delete(extents, row, axis=0)
        for width in (max(own[1], SIZE_M[TRUCK][1]), own[1]):
            length = _length_of_lorry(own[0], width, extents)
            place, half = front - 0.5 * length * forward[row], 0.5 * np.array([length, width])
            met = rectangles_overlap(centre[:, :2], 0.5 * size[:, :2], heading, place, half, heading[row])
            if met.sum() == met[row]:  # itself at most
                break
        centre[row, :2], size[row, :2] = place, (length, width)
    return replace(lorries, centre_m=centre, size_m=size)


def _extents(offset: np.ndarray, size: np.ndarray, forward: np.ndarray, axes: np.ndarray) -> np.ndarray:
    """From where to where boxes reach along two axes (2, 2), (n, 2 axes, 2 ends) [m]; their centres are at `offset`."""
    left = np.stack([-forward[:, 1], forward[:, 0]], axis=1)
    half = 0.5 * (size[:, :1] * np.abs(forward @ axes.T) + size[:, 1:2] * np.abs(left @ axes.T))
    return np.stack([offset @ axes.T - half, offset @ axes.T + half], axis=-1)


def _length_of_lorry(own_m: float, width_m: float, extents: np.ndarray) -> float:
    """How long a lorry is that has room up to others, given by their extents ahead of its front and to its left."""
    (ahead_low, ahead_high), (left_low, left_high) = extents.transpose(1, 2, 0)
    in_path = (left_low < 0.5 * width_m) & (left_high > -0.5 * width_m) & (ahead_low < 0.0)
    room_m = -ahead_high[in_path].max(initial=-np.inf) - _KEPT_FREE_M
    return max(own_m, min(SIZE_M[TRUCK][0], room_m))


def queued(
    vehicles: Boxes,
    lengths_m: np.ndarray,
    gaps: Gaps,
    *,
    anchor_m: float,
    road: RoadMap,
    filled_to_m: float = 0.0,
    copies_from: int = 0,
) -> Boxes:
    """Vehicles lined up again, lane by lane, about the one that is nearest to station `anchor_m`, which stays.

    Parameters
    ----------
    vehicles : Boxes
        One frame, with the sizes that they are to have.
    lengths_m : ndarray, (n,)
        The lengths that they had: what their gaps are measured with.
    gaps : callable
        New bumper gaps from old ones.
    anchor_m : float
        Station at which the lanes are looked at [m].
    road : RoadMap
        Its lanes, and strips as wide as the usual one beside them, say who drives behind whom.
    filled_to_m : float
        How far to both sides of the anchor lanes are to be full [m]; at 0 no vehicle is added. A lane of the road that
        ends nearer is continued with itself, the same vehicles under other numbers, as the recording knows none beyond
        its ends.
    copies_from : int
        More than any vehicle's number: a copy has its original's and a multiple of this.

    Returns
    -------
    Boxes
        With copies, if any, at the end. What drives across the road stays where it is.
    """
    at, (right, left), width = road.locate(vehicles.centre_m), road.edges_t, float(np.median(road.width_m))
    along = np.abs(np.cos(vehicles.heading_rad - at.heading_rad)) >= _ALONG
    along &= vehicles.class_index != PEDESTRIAN
    aside = np.floor((at.t_m - np.where(at.t_m < right, right, left)) / width).astype(int)
    beside = np.select([at.t_m < right, at.t_m >= left], [aside, len(road) + aside], _BETWEEN + aside)
    lane = np.where(at.lane >= 0, at.lane, beside)
    x = at.s_m.copy()
    copies = []  # of each: rows, their places, and by how many periods they are shifted
    for number in np.unique(lane[along]):
        rows = np.flatnonzero(along & (lane == number))
        rows = rows[np.argsort(x[rows], kind="stable")]
        if len(rows) < 2:
            continue
        old, new = lengths_m[rows], vehicles.size_m[rows, 0]
        spread = gaps(np.diff(x[rows]) - 0.5 * (old[1:] + old[:-1]))
        places = np.concatenate([[0.0], np.cumsum(spread + 0.5 * (new[1:] + new[:-1]))])
        middle = np.argmin(np.abs(x[rows] - anchor_m))
        places += x[rows[middle]] - places[middle]
        x[rows] = places
        on_road = 0 <= number < len(road)  # a ramp ends where it ends; a pile cannot be continued
        if not filled_to_m or not on_road:
            continue
        period = places[-1] - places[0] + 0.5 * (new[0] + new[-1]) + float(np.median(spread))
        if period < new.sum():
            continue
        before = max(0, math.ceil((places[0] - anchor_m + filled_to_m) / period))
        after = max(0, math.ceil((filled_to_m - places[-1] + anchor_m) / period))
        copies += [(rows, places + turn * period, turn) for turn in range(-before, after + 1) if turn]
    queue = replace(vehicles, centre_m=np.column_stack([road.at(x, at.t_m), vehicles.centre_m[:, 2]]))
    if not copies:
        return queue
    rows, copied_x = (np.concatenate(parts) for parts in list(zip(*copies, strict=True))[:2])
    turn = np.repeat([turn for *_, turn in copies], [len(rows) for rows, *_ in copies])
    together = queue.select(np.concatenate([np.arange(len(queue)), rows]))
    centre, ids = together.centre_m.copy(), together.vehicle_id.copy()
    centre[len(queue) :, :2] = road.at(copied_x, at.t_m[rows])
    ids[len(queue) :] += copies_from * np.where(turn > 0, 2 * turn - 1, -2 * turn)  # 1, 2, 3 ... for turns 1, -1, 2 ...
    return replace(together, centre_m=centre, vehicle_id=ids)
