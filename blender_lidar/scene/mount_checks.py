"""Checks of mountings and sensor: what stands or hangs in the way, angles in radians, unusual heights and noise.

A mast stands beside the traffic, never in it, and no LiDAR hangs inside a box or a barrier: that stops a run, as does a
searched angle that can hardly be degrees. The rest are notes.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from ..errors import InputError
from ..road.road_map import RoadMap
from ..traffic.boxes import Boxes
from ..traffic.vehicles import PEDESTRIAN, rectangles_overlap
from ..world.scenery import Scenery, barrier_extent
from . import usual
from .angles import in_radians
from .deployment import Deployment, Place
from .lidars import LidarSpec
from .mounting import ANGLES, LEANS, PLACE, Mounting
from .region import region_of
from .scenario import Scenario
from .settings import BarrierSettings, BoxSettings

# --- Where masts stand and LiDARs hang, beside the lanes, the traffic and what stands still ---------------------------

_TOUCHING_M = 1e-6  # a mount that touches a vehicle counts as inside
_MOST_STEPS = 400  # along each side of a searched rectangle: half a lane apart, where it is no larger


def extent(mount: Place | Mounting) -> tuple[np.ndarray, np.ndarray]:
    """From where to where a LiDAR may hang: x and y of its mast's foot and its height, (3,) each [m]."""
    if isinstance(mount, Mounting):
        return np.array([*mount.xy, mount.height_m]), np.array([*mount.xy, mount.height_m])
    return tuple(np.transpose([mount.span(key) for key in PLACE]))


class _Reach(NamedTuple):
    """Where a mount that is asked about may be."""

    said: str  # what errors call it
    facing_rad: float
    feet: tuple[np.ndarray, np.ndarray]  # corners of the rectangle where its mast stands, (2,) each [m]
    head_low: np.ndarray  # of the box in which the LiDAR hangs, (3,) [m]
    head_high: np.ndarray
    over_lanes: bool


def check_places_are_clear(scenario: Scenario, frames: Sequence[Boxes], scenery: Scenery | None = None) -> None:
    """`check_mount_is_clear` of every place that a scene searches, and of its baselines."""
    for lidar in scenario.lidars:
        poles_file, where = lidar.deployment.poles_file, scenario.where(lidar.table, "x_m, y_m")
        asked = {
            f"{poles_file}: pole {place.pole.name!r}" if place.pole else where: place
            for place in lidar.deployment.places
        }
        asked[scenario.where("baseline", "x_m, y_m")] = lidar.baseline
        check_mount_is_clear(scenario, lidar, frames, asked, scenery)


def check_mount_is_clear(
    scenario: Scenario,
    lidar: LidarSpec,
    frames: Iterable[Boxes],
    mounts: Mapping[str, Place | Mounting],
    scenery: Scenery | None = None,
) -> None:
    """Refuse a mount on the carriageway or inside a vehicle, or a LiDAR inside a box, a barrier or a closed mesh.

    Parameters
    ----------
    scenario : Scenario
        The road.
    lidar : LidarSpec
        Which of its LiDARs hangs there.
    frames : iterable of Boxes
        The traffic.
    mounts : mapping of str to Place or Mounting
        Mounts to check, by what gave them.
    scenery : Scenery, optional
        What stands there, of which no closed mesh may hold a LiDAR: of a searched place its corners and its middle.

    Raises
    ------
    InputError
        Naming the place, and the lane's edges, the box, or the vehicle and frame.
    """
    barriers = (boxes_around(barrier, scenario.road_map) for barrier in scenario.world.barriers)
    solids = [*scenario.world.boxes, *itertools.chain.from_iterable(barriers)]
    frames = [frame.select(frame.class_index != PEDESTRIAN) for frame in frames]  # who walk give way to masts
    for where, mount in mounts.items():
        reach = _reach(scenario.road_map, lidar.deployment, where, mount)
        _check_solids(reach, where, solids)
        _check_meshes(reach, where, scenery, region_of(scenario.region, scenario.road_map).centre_xy)
        _check_vehicles(reach, frames)


def _reach(road: RoadMap, deployment: Deployment, where: str, mount: Place | Mounting) -> _Reach:
    """What a mount may reach; over a lane it must be a gantry's, above its clearance."""
    low, high = extent(mount)
    x, y = (f"{a:g}" if a == b else f"{a:g} to {b:g}" for a, b in zip(low[:2], high[:2], strict=True))
    said, clearance_m = f"{where}: the mount at x {x} m, y {y} m", deployment.clearance_m
    places = _places(road, low[:2], high[:2])
    over = places[road.within(places)]
    if len(over) and not deployment.is_gantry:
        right, left = (np.round(edge, 3) + 0.0 for edge in road.edges_across(over[0]))
        raise InputError(
            f"{said} stands on the carriageway; allowed: off the lanes, such as x {right[0]:g}, y {right[1]:g} m or x "
            f'{left[0]:g}, y {left[1]:g} m, or [deployment] side = "gantry"'
        )
    if len(over) and low[2] < clearance_m:
        raise InputError(
            f"{where}: the LiDAR hangs {low[2]:g} m over the lanes; allowed: {clearance_m:g} m or more, as "
            "[deployment] clearance_m says"
        )
    ground = road.surface.height(places)
    lowest, highest = np.sort(np.outer((low[2], high[2]), road.up), axis=0)  # off the feet
    head_low = np.array([*low[:2], ground.min()]) + lowest
    head_high = np.array([*high[:2], ground.max()]) + highest
    one = mount if isinstance(mount, Mounting) else mount.mounting([end for end, _ in mount.bounds.values()])
    return _Reach(said, one.mast.facing_rad, (low[:2], high[:2]), head_low, head_high, len(over) > 0)


def _check_solids(reach: _Reach, where: str, solids: Iterable[BoxSettings]) -> None:
    """Refuse a LiDAR that may hang inside a box."""
    for solid in solids:
        middle, half = solid.centre_m[2], 0.5 * solid.size_m[2]
        box = np.array([solid.centre_m]), np.array([solid.size_m]), np.radians([solid.heading_deg])
        beside = reach.head_low[2] > middle + half or reach.head_high[2] < middle - half
        if not beside and footprints_meet(*box, reach.head_low, reach.head_high).any():
            raise InputError(f"{where}: the LiDAR hangs inside {solid.name!r} of [world]; move one of them")


def _check_vehicles(reach: _Reach, frames: Sequence[Boxes]) -> None:
    """Refuse a mast that may stand in a vehicle, and over the lanes a LiDAR that one reaches up to."""
    (low, high), head_low, head_high = reach.feet, reach.head_low[:2], reach.head_high[:2]
    for vehicles in frames:
        boxes = vehicles.centre_m, vehicles.size_m, vehicles.heading_rad
        meets = footprints_meet(*boxes, np.minimum(low, head_low), np.maximum(high, head_high))
        top = vehicles.centre_m[:, 2] + 0.5 * vehicles.size_m[:, 2]
        if reach.over_lanes:
            meets &= top >= reach.head_low[2]
        if meets.any():
            advice = f"hang it above {top[meets].max():.2f} m" if reach.over_lanes else _driven_over(frames, reach)
            first = vehicles.vehicle_id[meets][0]
            raise InputError(f"{reach.said} stands inside vehicle {first} of frame {vehicles.frame}; {advice}")


_LEVEL = (0.81, 0.59, 0.001), (-0.97, 0.23, 0.001), (0.13, -0.99, 0.001)
_RAYS = np.array([*_LEVEL, (0.27, 0.48, 0.83), (0.52, 0.44, -0.73)])  # along no axis, as walls stand along these
_WELDED_M = 1e-4


def _check_meshes(reach: _Reach, where: str, scenery: Scenery | None, driven_xy: tuple[float, float]) -> None:
    """Refuse a LiDAR that may hang inside a closed mesh, unless that is about where vehicles drive as well."""
    if scenery is None or not len(scenery):
        return
    low, high = (np.full((len(scenery.names), 3), end) for end in (np.inf, -np.inf))
    np.minimum.at(low, scenery.owner, scenery.corners.min(axis=1))
    np.maximum.at(high, scenery.owner, scenery.corners.max(axis=1))
    places = np.unique(np.array(list(itertools.product(*zip(reach.head_low, reach.head_high, strict=True)))), axis=0)
    about = ((low < reach.head_high) & (reach.head_low < high)).all(axis=1)
    for row in np.flatnonzero(about).tolist():
        corners = scenery.corners[scenery.owner == row]
        if not _is_closed(corners) or _holds(corners, np.array([*driven_xy, 1.0])):
            continue
        if any(_holds(corners, place) for place in (*places, places.mean(axis=0))):
            raise InputError(f"{where}: the LiDAR hangs inside {scenery.names[row]!r} of [world]; move one of them")


def _is_closed(corners: np.ndarray) -> bool:
    """Watertight mesh: whether every edge of triangles (m, 3, 3), once corners are welded, belongs to two of them."""
    _, vertex = np.unique(np.rint(corners.reshape(-1, 3) / _WELDED_M), axis=0, return_inverse=True)
    faces = vertex.reshape(-1, 3)
    edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    _, count = np.unique(edges[edges[:, 0] != edges[:, 1]], axis=0, return_counts=True)
    return bool(len(count)) and bool((count % 2 == 0).all())


def _holds(corners: np.ndarray, place: np.ndarray) -> bool:
    """Point in polyhedron by ray parity: whether rays from a place (3,) all cross triangles (m, 3, 3) an odd number of
    times (crossings as of Moller and Trumbore 1997).
    """
    edge_1, edge_2, offset = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0], place - corners[:, 0]
    cross_1 = np.cross(offset, edge_1)
    for ray in _RAYS:
        cross_2 = np.cross(ray, edge_2)
        with np.errstate(divide="ignore", invalid="ignore"):
            reciprocal = 1.0 / (edge_1 * cross_2).sum(axis=1)
            u, v = (offset * cross_2).sum(axis=1) * reciprocal, cross_1 @ ray * reciprocal
            ahead = (edge_2 * cross_1).sum(axis=1) * reciprocal > 0.0
            crossed = (u >= 0.0) & (v >= 0.0) & (u + v <= 1.0) & ahead
        if crossed.sum() % 2 == 0:
            return False
    return True


def _driven_over(frames: Sequence[Boxes], reach: _Reach) -> str:
    """Where vehicles pass where a mast may stand, as advice."""
    (low, high), facing = reach.feet, reach.facing_rad
    xy, size, heading = (
        np.concatenate([getattr(vehicles, key) for vehicles in frames]) for key in ("centre_m", "size_m", "heading_rad")
    )
    off = np.hypot(*(xy[:, :2] - np.clip(xy[:, :2], low, high)).T)
    near, turn = off <= usual.ABREAST_M + 0.5 * size[:, 0], heading - facing
    ahead = (xy[:, :2] - 0.5 * (low + high)) @ (math.cos(facing), math.sin(facing))
    half = 0.5 * (size[:, 0] * np.abs(np.cos(turn)) + size[:, 1] * np.abs(np.sin(turn)))
    first, last = (ahead - half)[near].min(), (ahead + half)[near].max()
    return f"vehicles drive there from {first:.1f} to {last:.1f} m in front of the mast: move it beside them"


def _places(road: RoadMap, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Places all over the rectangle from `low` to `high`, (2,) each, not farther apart than half a lane, (n, 2) [m]."""
    lane_m = road.width_m.min() if len(road) else 1.0
    steps = np.ceil((high - low) / (0.5 * lane_m)).clip(0, _MOST_STEPS).astype(int) + 1
    x, y = (np.linspace(a, b, n) for a, b, n in zip(low, high, steps, strict=True))
    return np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)


def footprints_meet(
    centre: np.ndarray, size: np.ndarray, heading: np.ndarray, low: np.ndarray, high: np.ndarray
) -> np.ndarray:
    """Which boxes' footprints overlap the axis-parallel rectangle from `low` to `high`, (n,) bool.

    `centre` and `size` are (n, 2) or more [m], `heading` is (n,) [rad]; of `low` and `high` x and y count.
    """
    low, high = low[:2], high[:2]
    rectangle = 0.5 * (low + high), 0.5 * (high - low) + _TOUCHING_M, 0.0
    return rectangles_overlap(centre[:, :2], 0.5 * size[:, :2], heading, *rectangle)


def boxes_around(barrier: BarrierSettings, road: RoadMap) -> Iterator[BoxSettings]:
    """A box about each straight piece of a barrier."""
    name, (half_width_m, height_m) = f"{barrier.kind} at y {barrier.y_m:g} m", barrier_extent(barrier.kind)
    for ends in itertools.pairwise(road.at(road.stations(barrier.x_m), barrier.y_m)):
        (x, y), (ahead, aside) = np.mean(ends, axis=0), np.diff(ends, axis=0)[0]
        size = (math.hypot(ahead, aside), 2 * half_width_m, height_m)
        heading = math.degrees(math.atan2(aside, ahead))
        yield BoxSettings(name=name, centre_m=(x, y, 0.5 * height_m), size_m=size, heading_deg=heading)


# --- Angles in radians, tilts away from the road, unusual heights and noise -------------------------------------------

_LEVEL = 1e-6  # sine of a lean
_USUAL_HEIGHTS = "(usual: 2 to 12, a gantry or a lamp): metres above the road?"


def mount_notes(scenario: Scenario, given: Sequence[Mounting] = ()) -> Iterator[str]:
    """What is suspicious of mountings and sensor and may be right, as sentences; `given` are those given by hand."""
    for number, lidar in enumerate(scenario.lidars):
        own = given[number : number + 1] if scenario.is_layout else given
        called = f"{lidar.name}: " if scenario.is_layout else ""
        yield from (called + note for note in _notes_on(lidar, own))


def _notes_on(lidar: LidarSpec, given: Sequence[Mounting]) -> Iterator[str]:
    """What is suspicious of one LiDAR."""
    deployment = lidar.deployment
    asked = [("the mounting", one.as_table()) for one in given] or [("[deployment]", deployment.places[0].fixed)]
    for name, table in (*asked, ("[baseline]", lidar.baseline.as_table())):
        for key in ANGLES if ANGLES[0] in table else LEANS:
            meant = in_radians(key, (table.get(key) or 0.0,))
            if meant:
                yield f"{key} of {name} is {table[key]:g} degrees; is that {meant[0]:g} degrees in radians?"
        if table.get("height_m", 0.0) > usual.HIGHEST_M:
            yield f"height_m of {name} is {table['height_m']:g} m {_USUAL_HEIGHTS}"
    places = () if given else deployment.places
    highest = max([place.span("height_m")[1] for place in places if "height_m" in place.bounds], default=0.0)
    if highest > usual.HIGHEST_M:
        yield f"heights up to {highest:g} m are searched {_USUAL_HEIGHTS}"
    noise = lidar.sensor.range_noise_m or 0.0
    if noise > usual.NOISE_M:
        yield f"[sensor] range_noise_m is {noise:g} m (data sheets: 0.01 to 0.05 m): centimetres?"
    away = [place for place in places if _looks_away(place)]
    if away:
        some = f"on {len(away)} of {len(places)} poles every" if deployment.poles else "every"
        x_m, y_m = away[0].mounting([low for low, _ in away[0].bounds.values()]).xy
        yield (
            f"{some} mounting that is searched looks down away from the road, as at x {x_m:g}, y {y_m:g} m: a "
            "positive tilt_x_deg looks down to where the mast faces, a negative one behind it"
        )


def _looks_away(place: Place) -> bool:
    """Whether all that is searched looks down on the side of the mast on which there is no lane."""
    road, leans = place.road, []
    for mounting in map(place.mounting, itertools.product(*place.bounds.values())):
        down = mounting.pose.rotation[2, :2]  # the sensor looks down to where its upright axis leans
        towards = road.nearest(mounting.xy) - mounting.xy
        length = np.hypot(*down) * np.hypot(*towards.T)
        if np.hypot(*down) > _LEVEL and length.all():
            leans.append((towards @ down / length).max())
    return bool(leans) and max(leans) < -usual.AWAY
