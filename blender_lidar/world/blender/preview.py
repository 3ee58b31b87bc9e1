"""Ray casting against the visible objects of the open scene at preview quality: Blender's own trees, one for each mesh.

Exact is what `site.open_scenery` gives; here a ray now and then slips between two faces, as `BVHTree.ray_cast` lets it.
"""

from __future__ import annotations

import gc
from itertools import repeat
from operator import itemgetter
from typing import NamedTuple

import bpy
import numpy as np
from mathutils import Vector
from mathutils.bvhtree import BVHTree

from ..scenery import NO_LABEL
from .site import Labels, arrays_of, scanned, visible_instances

_TURN = 2.0 * np.pi
_NOTHING = (-1.0, 0.0)
_face_and_distance = itemgetter(2, 3)  # ray_cast returns (location, normal, index, distance)


class _Mesh(NamedTuple):
    """A mesh data-block: Blender's tree; surface (m,) and unit normal (m, 3) of its faces, its box (8, 3), and labels
    (m,) where its materials say them.
    """

    tree: BVHTree
    surface: np.ndarray
    normal: np.ndarray
    box: np.ndarray
    label: np.ndarray | None = None


class VisibleObjects:
    """Visible objects of the user's, as a live preview meets them: rays are taken to the space of each mesh.

    It stands in for `casting.protocol.StandingScenery` where clouds are looked at live (`clouds.live`).
    """

    def __init__(self) -> None:
        self._meshes: dict[int, _Mesh] = {}
        self._placed: list[tuple[_Mesh, np.ndarray, np.ndarray, int]] = []
        self._forgotten = 0

    @property
    def state(self) -> tuple:
        """Which meshes stood where when last looked at: equal while nothing has changed."""
        placed = [(id(mesh), turn.tobytes(), move.tobytes()) for mesh, turn, move, _ in self._placed]
        return self._forgotten, *placed

    def forget(self) -> None:
        """Drop what is kept of meshes: call it when the geometry of any object of the user's has changed."""
        self._meshes.clear()
        self._forgotten += 1

    def refresh(self, scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph) -> int:
        """Look where the visible objects of a scene are now, evaluated just before; the number of their faces."""
        meshes, labels, self._placed = {}, Labels(scene), []
        for item, turn, move in visible_instances(scene, depsgraph, scanned(scene, depsgraph.view_layer)):
            key = item.data.as_pointer()
            if key not in meshes:
                meshes[key] = self._meshes.get(key) or _mesh_of(item, depsgraph, labels)
            if len(meshes[key].surface) and abs(np.linalg.det(turn)) > 0.0:
                self._placed.append((meshes[key], turn, move, labels.of(item)))
        self._meshes = meshes
        return sum(len(mesh.surface) for mesh, *_ in self._placed)

    def met(self, origin: np.ndarray, directions: np.ndarray, reach_m: float) -> tuple[np.ndarray, ...]:
        """As `StandingScenery.met`."""
        rays = _ByAzimuth(origin, directions) if self._placed else None
        nearest = np.full(len(directions), reach_m)
        met = np.zeros(len(directions), dtype=bool)
        surface, cosine = np.zeros(len(directions), np.uint8), np.zeros(len(directions))
        label = np.full(len(directions), NO_LABEL, np.int32)
        for mesh, turn, move, number in self._placed:
            some = rays.towards(mesh.box @ turn + move, reach_m)
            if len(some) == 0:
                continue
            back = np.linalg.inv(turn)
            local = directions[some] @ back
            stretch = np.sqrt(np.einsum("ij,ij->i", local, local))  # lengths there over lengths in the scene
            face, distance = _cast(mesh.tree, (origin - move) @ back, local, nearest[some] * stretch)
            found = np.flatnonzero(face >= 0)
            some, face, distance = some[found], face[found], distance[found] / stretch[found]
            normal = mesh.normal[face] @ back.T
            normal /= np.sqrt(np.einsum("ij,ij->i", normal, normal))[:, None]
            nearest[some], met[some], surface[some] = distance, True, mesh.surface[face]
            label[some] = number if mesh.label is None else mesh.label[face]
            cosine[some] = np.abs(np.einsum("ij,ij->i", normal, directions[some]))
        ray = np.flatnonzero(met)
        return ray, nearest[ray], surface[ray], cosine[ray], label[ray]


class _ByAzimuth:
    """Rays from an origin, sorted by azimuth, so that those towards a box are found without looking at all."""

    def __init__(self, origin, directions):
        self._origin, self._directions = origin, directions
        azimuth = np.arctan2(directions[:, 1], directions[:, 0])
        self._order = np.argsort(azimuth)
        self._azimuth = azimuth[self._order]

    def towards(self, box, reach_m):
        """Those that pierce the sphere about a box (8, 3)."""
        away = box - self._origin
        middle = away.mean(axis=0)
        radius = np.sqrt(np.square(away - middle).sum(axis=1).max())
        distance, level = np.sqrt(middle @ middle), np.hypot(*middle[:2])
        if distance - radius > reach_m:
            return np.empty(0, dtype=np.int64)
        some = self._order
        if level > radius:
            half = np.arcsin(radius / level)
            first = (np.arctan2(middle[1], middle[0]) - half + np.pi) % _TURN - np.pi
            low, high = np.searchsorted(self._azimuth, [first, first + 2.0 * half])
            over = np.searchsorted(self._azimuth, first + 2.0 * half - _TURN)  # beyond azimuth pi
            some = np.concatenate([some[low:high], some[:over]])
        if distance > radius:
            some = some[self._directions[some] @ middle >= np.sqrt(distance**2 - radius**2)]
        return some


def _cast(tree, origin, directions, reach):
    """Face that each ray meets, -1 for none, and how far along [local units]; `directions` of any length."""
    rays = zip(*map(memoryview, np.ascontiguousarray(directions.T)), strict=True)
    hits = map(tree.ray_cast, repeat(Vector(origin.tolist())), rays, reach.tolist())
    collecting = gc.isenabled()
    gc.disable()  # its sweeps would come often, for so many small objects
    try:
        found = [
            number for hit in map(_face_and_distance, hits) for number in (hit if hit[0] is not None else _NOTHING)
        ]
    finally:
        if collecting:
            gc.enable()
    face, distance = np.array(found).reshape(-1, 2).T
    return face.astype(np.int64), distance


def _mesh_of(item, depsgraph, labels) -> _Mesh:
    """The mesh of an evaluated object."""
    mesh, original = item.data, item.original
    if original.type == "MESH" and original.evaluated_get(depsgraph).data == mesh:
        vertices, _, surface, box = arrays_of(mesh, triangles=False)
        normal = np.empty(3 * len(mesh.polygons), np.float32)
        mesh.polygons.foreach_get("normal", normal)
        label = labels.of_faces(mesh, mesh.polygons)
        tree = BVHTree.FromObject(original, depsgraph)
        return _Mesh(tree, surface, normal.reshape(-1, 3).astype(float), box, label)
    vertices, faces, surface, box = arrays_of(mesh)  # of curves, texts, and what geometry nodes have made
    tree = BVHTree.FromPolygons(vertices.tolist(), faces.tolist(), all_triangles=True)
    a, b, c = (vertices[faces[:, corner]] for corner in range(3))
    return _Mesh(tree, surface, np.cross(b - a, c - a), box, labels.of_faces(mesh, mesh.loop_triangles))
