"""The scenery that a scene's [world] describes: files that Blender reads, boxes and barriers, in the road frame."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from ..errors import InputError
from ..scenario import Scenario
from ..settings import WorldSettings
from ..world.barriers import barrier
from ..world.needs_blender import blender_room
from ..world.scenery import Scenery, box, boxes_reach, join


def read_scenery(scenario: Scenario, reach_m: float) -> Scenery:
    """What stands still within a horizontal reach of the nominal mount; empty where there is nothing.

    Raises
    ------
    MissingFileError, InputError
        When a file is not there or cannot be used, or nothing of a file lies within reach.
    MissingExtraError
        When it is one that Blender must read, and Blender is not installed.
    """
    world = scenario.world
    centre = scenario.deployment.nominal_xy
    paths = [path for path in (world.blend, world.mesh) if path is not None]
    files = [_near(path, world, centre, reach_m) for path in paths]
    boxes = [box(item.name, item.centre_m, item.size_m, math.radians(item.heading_deg)) for item in world.boxes]
    barriers = [barrier(item.kind, item.y_m, item.x_m) for item in world.barriers]
    return join([*files, *(item.within(centre, reach_m) for item in [*boxes, *barriers])])


def _near(path: str, world: WorldSettings, centre: tuple[float, float], reach_m: float) -> Scenery:
    """What of a file lies within reach; a file of which nothing does is most likely put in the wrong place."""
    read_site = blender_room("site", path).read_site
    placing = _Placing(world.origin_m, math.radians(world.heading_deg))
    near = _placed(read_site(path, lambda box: bool(boxes_reach(placing.to_road(box), centre, reach_m))), placing)
    near = near.within(centre, reach_m)
    if len(near) == 0:
        corners = _placed(read_site(path), placing).corners
        low, high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
        raise InputError(
            f"{path}: nothing of it lies within {reach_m:g} m of the mount at x {centre[0]:g}, y {centre[1]:g} m; "
            f"in the road frame it spans x {low[0]:g} to {high[0]:g}, y {low[1]:g} to {high[1]:g} m: check [world] "
            "origin_m and heading_deg"
        )
    return near


@dataclass(frozen=True, slots=True)
class _Placing:
    """Where the road frame lies in the frame of a file: its origin [m] and the direction of its x axis [rad]."""

    origin_m: tuple[float, float, float]
    heading_rad: float

    def to_road(self, points: np.ndarray) -> np.ndarray:
        """Points (..., 3) of the file in the road frame [m]."""
        cos, sin = math.cos(self.heading_rad), math.sin(self.heading_rad)
        turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])  # for rows
        return (points - np.array(self.origin_m)) @ turn


def _placed(scenery: Scenery, placing: _Placing) -> Scenery:
    return replace(scenery, corners=placing.to_road(scenery.corners))
