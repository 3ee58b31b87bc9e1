"""The road: carriageway, shoulders and verge as one plane, lane lines on it, and what stands beside it."""

from __future__ import annotations

import bpy
import numpy as np

from ...traffic.road import RoadFrame
from ..scenery import Scenery
from ..shapes import GLASS
from .materials import CONCRETE, LINE, VERGE, asphalt, glass, plain
from .meshes import new_mesh
from .roles import MARKING, ROAD, STANDING, add_object, clear, collection

_SHOULDER_M = 2.0
_VERGE_M = 60.0  # beyond the shoulders
_LINE_WIDTH_M, _DASH_M, _DASH_EVERY_M = 0.12, 3.0, 12.0  # MUTCD: 10 ft lines and 30 ft gaps
_LINE_ABOVE_M = 0.01  # high enough not to flicker, seen from afar


def build_road(scene: bpy.types.Scene, road: RoadFrame, reach_m: float) -> None:
    """The plane z = 0 from x = -`reach_m` to `reach_m`, with lane lines; it takes the place of an earlier one."""
    into = collection(scene, "Road", ROAD)
    clear(into)
    right, left = road.carriageway_y
    edges = np.array([right - _VERGE_M, right - _SHOULDER_M, left + _SHOULDER_M, left + _VERGE_M])
    ground = np.array([(x, y, 0.0) for y in edges for x in (-reach_m, reach_m)])
    faces = np.array([(2 * row, 2 * row + 1, 2 * row + 3, 2 * row + 2) for row in range(3)])
    materials = [plain("Verge", VERGE, roughness=1.0), asphalt()]
    add_object(into, "Surface", new_mesh("Surface", ground, faces, materials, np.array([0, 1, 0])))

    solid = [((right, left)[side], -reach_m, reach_m) for side in (0, 1)]
    starts = np.arange(-reach_m, reach_m - _DASH_M, _DASH_EVERY_M)
    dashed = [
        (right + lane * road.lane_width_m, start, start + _DASH_M) for lane in range(1, road.lanes) for start in starts
    ]
    half, z = 0.5 * _LINE_WIDTH_M, _LINE_ABOVE_M
    vertices = np.array(
        [
            corner
            for y, first, last in solid + dashed
            for corner in ((first, y - half, z), (last, y - half, z), (last, y + half, z), (first, y + half, z))
        ]
    )
    lines = new_mesh("Lane lines", vertices, np.arange(len(vertices)).reshape(-1, 4), [plain("Lane line", LINE)])
    add_object(into, "Lane lines", lines, MARKING)


def build_scenery(scene: bpy.types.Scene, scenery: Scenery | None) -> None:
    """Barriers, buildings and whatever else stands still, an object each; they take the place of earlier ones."""
    into = collection(scene, "Scenery", STANDING)
    clear(into)
    if scenery is None:
        return
    materials = [plain("Structure", CONCRETE), glass()]
    order = np.argsort(scenery.owner, kind="stable")
    owners, starts = np.unique(scenery.owner[order], return_index=True)
    for row, own in zip(owners.tolist(), np.split(order, starts[1:]), strict=True):
        name = scenery.names[row]
        corners = scenery.corners[own]
        middle = 0.5 * (corners.min(axis=(0, 1)) + corners.max(axis=(0, 1)))  # float32 is finest about an object
        vertices, faces = _welded(corners - middle)
        item = add_object(into, name, new_mesh(name, vertices, faces, materials, scenery.surface[own] == GLASS))
        item.location = middle


def _welded(corners):
    """Vertices and faces of triangles (m, 3, 3) whose equal corners are shared."""
    vertices, faces = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)
    return vertices, faces.reshape(-1, 3)
