"""A pole stands beside the traffic, never in it, and no LiDAR hangs inside a box or a barrier."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping

import numpy as np

from ..errors import InputError
from ..scenario import Scenario
from ..settings import BarrierSettings, BoxSettings
from ..traffic.overlaps import rectangles_overlap
from ..traffic.vehicles import Vehicles
from ..world.barriers import HALF_WIDTH_M, HEIGHT_M

_PLACE = ("x_m", "y_m", "height_m")
_TOUCHING_M = 1e-6  # a mount that touches a vehicle counts as inside


def check_mount_is_clear(
    scenario: Scenario, frames: Iterable[Vehicles], mounts: Mapping[str, Mapping[str, float]] | None = None
) -> None:
    """Refuse a mount on the carriageway or inside a vehicle, or a LiDAR inside one of [world]'s boxes or barriers.

    Parameters
    ----------
    scenario : Scenario
        The road.
    frames : iterable of Vehicles
        The traffic.
    mounts : mapping of str to coordinates, optional
        Mounts to check, by the option that gave them; the scene's searched places and baseline if left out.

    Raises
    ------
    InputError
        Naming the place, and the lane's edges, the box, or the vehicle and frame.
    """
    if mounts is None:
        places = {
            f"{scenario.source}: [deployment] x_m, y_m": _searched(scenario),
            f"{scenario.source}: [baseline] x_m, y_m": _point(scenario.baseline),
        }
    else:
        places = {option: _point(mount) for option, mount in mounts.items()}
    right, left = scenario.road.carriageway_y
    for where, (low, high) in places.items():
        if low[1] < left and high[1] > right:
            raise InputError(
                f"{where}: the mount at y {_span(low[1], high[1])} m stands on the carriageway; "
                f"allowed: at most {right:g} or at least {left:g} m"
            )
        for box in [*scenario.world.boxes, *map(_box_around, scenario.world.barriers)]:
            if _holds(box, low, high):
                raise InputError(f"{where}: the LiDAR hangs inside {box.name!r} of [world]; move the one or the other")
    for vehicles in frames:
        for where, (low, high) in places.items():
            inside = np.flatnonzero(boxes_meet_rectangle(vehicles, low[:2], high[:2]))
            if len(inside):
                raise InputError(
                    f"{where}: the mount at x {_span(low[0], high[0])} m, y "
                    f"{_span(low[1], high[1])} m stands inside vehicle {vehicles.vehicle_id[inside[0]]} of frame "
                    f"{vehicles.frame}; move it, or leave that frame out with [traffic] frame_ids"
                )


def boxes_meet_rectangle(vehicles: Vehicles, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Which footprints overlap the axis-parallel rectangle from `low` to `high` (2,) [m], (n,) bool."""
    footprints = vehicles.centre_m[:, :2], 0.5 * vehicles.size_m[:, :2], vehicles.heading_rad
    return rectangles_overlap(*footprints, 0.5 * (low + high), 0.5 * (high - low) + _TOUCHING_M, 0.0)


def _box_around(barrier: BarrierSettings) -> BoxSettings:
    (first, last), height = barrier.x_m, HEIGHT_M
    centre = (0.5 * (first + last), barrier.y_m, 0.5 * height)
    return BoxSettings(f"{barrier.kind} at y {barrier.y_m:g} m", centre, (last - first, 2 * HALF_WIDTH_M, height), 0.0)


def _holds(box: BoxSettings, low: np.ndarray, high: np.ndarray) -> bool:
    """Whether a LiDAR mounted anywhere between two corners (3,) may be inside a box."""
    middle, half = np.array(box.centre_m), 0.5 * np.array(box.size_m)
    if high[2] < middle[2] - half[2] or low[2] > middle[2] + half[2]:
        return False
    footprint = middle[None, :2], half[None, :2], np.array([math.radians(box.heading_deg)])
    mounts = 0.5 * (low + high)[:2], 0.5 * (high - low)[:2] + _TOUCHING_M, 0.0
    return bool(rectangles_overlap(*footprint, *mounts).any())


def _searched(scenario):
    """Between which corners, x, y and height, mountings are searched."""
    fixed, bounds = scenario.deployment.fixed, scenario.deployment.bounds
    spans = [(fixed[key], fixed[key]) if key in fixed else bounds[key] for key in _PLACE]
    return tuple(np.array(corner) for corner in zip(*spans, strict=True))


def _point(mount):
    point = np.array([mount[key] for key in _PLACE])
    return point, point


def _span(low, high):
    return f"{low:g}" if low == high else f"{low:g} to {high:g}"
