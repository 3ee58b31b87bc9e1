"""The scenery that a scene's [world] describes: files that Blender reads, boxes and barriers, in the road frame."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from ..errors import MissingExtraError
from ..scenario import Scenario
from ..world.barriers import barrier
from ..world.scenery import Scenery, box, join


def read_scenery(scenario: Scenario) -> Scenery:
    """Everything that stands still; empty where there is nothing.

    Raises
    ------
    MissingFileError, InputError
        When a file is not there or cannot be used.
    MissingExtraError
        When it is one that Blender must read, and Blender is not installed.
    """
    world = scenario.world
    files = [_placed(_read_file(path), world) for path in (world.blend, world.mesh) if path is not None]
    boxes = [box(item.name, item.centre_m, item.size_m, math.radians(item.heading_deg)) for item in world.boxes]
    barriers = [barrier(item.kind, item.y_m, item.x_m) for item in world.barriers]
    return join([*files, *boxes, *barriers])


def _read_file(path: str) -> Scenery:
    try:
        from ..world.blender.site import read_site
    except ImportError as error:
        if error.name != "bpy":
            raise
        raise MissingExtraError(f'{path}: Blender reads it: pip install "blender_lidar[blender]"') from error
    return read_site(path)


def _placed(scenery: Scenery, world) -> Scenery:
    """Scenery from the frame of its file in the road frame."""
    turn = math.radians(world.heading_deg)
    cos, sin = math.cos(turn), math.sin(turn)
    to_road = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])  # for rows
    return replace(scenery, corners=(scenery.corners - np.array(world.origin_m)) @ to_road)
