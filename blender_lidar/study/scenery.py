"""The scenery that a scene's [world] describes: files that Blender reads, boxes and barriers, in the road frame."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from ..errors import InputError, MissingExtraError
from ..scenario import Scenario
from ..world.barriers import barrier
from ..world.scenery import Scenery, box, join


def read_scenery(scenario: Scenario, reach_m: float) -> Scenery:
    """What stands still within a horizontal reach of the nominal mount; empty where there is nothing.

    Raises
    ------
    MissingFileError, InputError
        When a file is not there or cannot be used, or nothing of it lies within reach.
    MissingExtraError
        When it is one that Blender must read, and Blender is not installed.
    """
    world = scenario.world
    centre = scenario.deployment.nominal_xy
    paths = [path for path in (world.blend, world.mesh) if path is not None]
    files = [_near(_placed(_read_file(path), world), centre, reach_m, path) for path in paths]
    boxes = [box(item.name, item.centre_m, item.size_m, math.radians(item.heading_deg)) for item in world.boxes]
    barriers = [barrier(item.kind, item.y_m, item.x_m) for item in world.barriers]
    return join([*files, *(item.within(centre, reach_m) for item in [*boxes, *barriers])])


def _read_file(path: str) -> Scenery:
    try:
        from ..world.blender.site import read_site
    except ImportError as error:
        if error.name != "bpy":
            raise
        raise MissingExtraError(f'{path}: Blender reads it: pip install "blender_lidar[blender]"') from error
    return read_site(path)


def _near(scenery: Scenery, centre: tuple[float, float], reach_m: float, path: str) -> Scenery:
    """What of a file lies within reach; a file of which nothing does is most likely put in the wrong place."""
    near = scenery.within(centre, reach_m)
    if len(near) == 0:
        low, high = scenery.corners.min(axis=(0, 1)), scenery.corners.max(axis=(0, 1))
        raise InputError(
            f"{path}: nothing of it lies within {reach_m:g} m of the mount at x {centre[0]:g}, y {centre[1]:g} m; "
            f"in the road frame it spans x {low[0]:g} to {high[0]:g}, y {low[1]:g} to {high[1]:g} m: check [world] "
            "origin_m and heading_deg"
        )
    return near


def _placed(scenery: Scenery, world) -> Scenery:
    """Scenery from the frame of its file in the road frame."""
    turn = math.radians(world.heading_deg)
    cos, sin = math.cos(turn), math.sin(turn)
    to_road = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])  # for rows
    return replace(scenery, corners=(scenery.corners - np.array(world.origin_m)) @ to_road)
