"""Blender in: what is visible in a scene, as triangles with the object that owns each."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import product
from typing import NamedTuple

import bpy
import numpy as np

from ..scenery import Scenery
from ..shapes import STRUCTURE, SURFACES
from .materials import SURFACE_KEY
from .roles import DISPLAY_ONLY, role

Keep = Callable[[np.ndarray], bool]


def visible_triangles(
    scene: bpy.types.Scene, skip: Callable[[bpy.types.Object], bool] | None = None, keep: Keep | None = None
) -> Scenery:
    """Everything that a LiDAR would meet in a scene, with modifiers applied and instances made real.

    Seen is what both the viewport and renders show and has faces once evaluated: meshes, curves, texts, surfaces. What
    renders hide by way of a collection or of what makes the instances is hidden too. Of our own objects, markings,
    point clouds and the LiDAR itself are left out.

    Parameters
    ----------
    scene : Scene
        In its current frame, as its first view layer shows it; its unit scale is applied.
    skip : callable, optional
        Told each object; those for which it is true are left out too.
    keep : callable, optional
        Told the eight corners (8, 3) [m] of each object's and instance's bounding box, in the scene's frame; where it
        is false that one is left out. A forest may have far more triangles than stand within reach.

    Returns
    -------
    Scenery
        In the scene's own frame [m]; owners are the visible objects, and each instance is an owner of its own.
    """
    layer = scene.view_layers[0]
    layer.update()
    rendered = set(_rendered_objects(scene.collection))
    meshes: dict[int, _Solid] = {}
    unit_m = scene.unit_settings.scale_length
    corners, surface, names = [], [], []
    for instance in layer.depsgraph.object_instances:
        item = instance.object
        if item.type != "MESH" or not _is_seen(instance, rendered) or role(item) in DISPLAY_ONLY:
            continue
        if skip is not None and skip(item):
            continue
        mesh = item.data
        if mesh.as_pointer() not in meshes:
            meshes[mesh.as_pointer()] = _solid(mesh)
        solid = meshes[mesh.as_pointer()]
        matrix = np.array(instance.matrix_world, dtype=float)
        turn, move = unit_m * matrix[:3, :3].T, unit_m * matrix[:3, 3]
        if len(solid.faces) == 0 or (keep is not None and not keep(solid.box @ turn + move)):
            continue
        faces = solid.faces if np.linalg.det(turn) > 0.0 else solid.faces[:, ::-1]  # a mirror turns faces inside out
        corners.append((solid.vertices @ turn + move)[faces])
        surface.append(solid.surface)
        names.append(item.name)
    counts = [len(part) for part in corners]
    return Scenery(
        np.concatenate([np.empty((0, 3, 3)), *corners]),
        np.repeat(np.arange(len(counts), dtype=np.int32), counts),
        np.concatenate([np.empty(0, np.uint8), *surface]),
        tuple(names),
    )


def _rendered_objects(collection: bpy.types.Collection) -> Iterator[bpy.types.Object]:
    """The objects in a collection and those below it, but for collections that renders hide."""
    if not collection.hide_render:
        yield from collection.objects
        for child in collection.children:
            yield from _rendered_objects(child)


def _is_seen(instance: bpy.types.DepsgraphObjectInstance, rendered: set[bpy.types.Object]) -> bool:
    """Whether renders show what the viewport shows; `rendered` are the objects in collections that they show."""
    item = instance.object
    if not instance.show_self or item.hide_render:
        return False
    if instance.is_instance:
        return not instance.parent.hide_render and instance.parent.original in rendered
    return item.original in rendered and (not item.is_instancer or item.show_instancer_for_render)


class _Solid(NamedTuple):
    """An evaluated mesh: vertices (n, 3), triangles (m, 3), their surface (m,), corners (8, 3) of the bounding box."""

    vertices: np.ndarray
    faces: np.ndarray
    surface: np.ndarray
    box: np.ndarray


def _solid(mesh: bpy.types.Mesh) -> _Solid:
    mesh.calc_loop_triangles()
    count = len(mesh.loop_triangles)
    vertices, faces = np.empty(3 * len(mesh.vertices), np.float32), np.empty(3 * count, np.int32)
    slot = np.empty(count, np.int32)
    mesh.vertices.foreach_get("co", vertices)
    mesh.loop_triangles.foreach_get("vertices", faces)
    mesh.loop_triangles.foreach_get("material_index", slot)
    known = [_surface_of(material) for material in mesh.materials]
    made_of = np.array(known or [STRUCTURE], dtype=np.uint8)[np.clip(slot, 0, max(0, len(known) - 1))]
    vertices = vertices.reshape(-1, 3).astype(float)
    low, high = vertices.min(axis=0, initial=np.inf), vertices.max(axis=0, initial=-np.inf)
    box = np.array(list(product(*zip(low, high, strict=True))))
    return _Solid(vertices, faces.reshape(-1, 3), made_of, box)


def _surface_of(material: bpy.types.Material | None) -> int:
    """What a material of ours stands for; bare structure for any other."""
    surface = STRUCTURE if material is None else material.get(SURFACE_KEY, STRUCTURE)
    return surface if surface in range(len(SURFACES)) else STRUCTURE
