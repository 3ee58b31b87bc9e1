"""Ray casting against the visible objects of the open scene at preview quality: Blender's own trees, one for each mesh.

Exact is what `site.open_scenery` gives; here a ray now and then slips between two faces, as `BVHTree.ray_cast` lets it.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import bpy
import numpy as np
from mathutils.bvhtree import BVHTree

from ..casting.instances import Instances
from ..casting.protocol import MISS
from ..world.blender.objects import role, to_road
from ..world.blender.site import Kinds, Labels, arrays_of, scanned, visible_instances
from ..world.meshes import of_kind
from ..world.scenery import NO_LABEL

_PLACING = bpy.types.Object, bpy.types.Collection, bpy.types.Scene
_WITHOUT_SHAPE = "EMPTY", "CAMERA", "LIGHT", "LIGHT_PROBE", "SPEAKER", "ARMATURE", "LATTICE"
_PAD = 1e-4  # of a mesh's size, by which boxes and spheres are wider: rounding takes none of their rays


class _Mesh(NamedTuple):
    """A mesh: Blender's tree, its faces' surface (m,) and normal (m, 3), its box (2, 3), and what it comes of."""

    tree: BVHTree
    surface: np.ndarray
    normal: np.ndarray
    box: np.ndarray
    polygons: bool  # its faces are, else triangles
    blocks: frozenset[tuple]


class VisibleObjects:
    """Visible objects of the user's, as a live preview meets them: rays are taken to each mesh's space.

    It stands in for `casting.protocol.StandingScenery` where clouds are looked at live (`clouds.live`). What was seen
    is kept until it is told of a change: handlers of `depsgraph_update_post` and `frame_change_post` give
    `note_updates` their `depsgraph.updates`, and those of undo, other files and other labels call `forget`.
    """

    def __init__(self) -> None:
        self._meshes: dict[tuple, _Mesh] = {}
        self._seen: object = None  # road frame and view layer of the last walk; None when there must be another
        self.state = 0  # rises whenever other meshes stand there, or elsewhere, than were seen before
        self._place([], np.empty((0, 3, 3)), np.empty((0, 3)), {})

    def note_updates(self, updates: Iterable[bpy.types.DepsgraphUpdate]) -> None:
        """Take note of what Blender has evaluated again: the scene, where anything was hidden, added or removed."""
        changed = []
        for update in updates:
            block = update.id
            if update.is_updated_geometry or isinstance(block, bpy.types.Material):
                changed.append(block.original)
            shapeless = getattr(block, "type", "") in _WITHOUT_SHAPE and not block.is_instancer
            if isinstance(block, _PLACING) and role(block) is None and not shapeless:
                self._seen = None
        self.forget(changed)

    def forget(self, blocks: Iterable[bpy.types.ID] | None = None) -> None:
        """Drop the trees of original objects, meshes and materials with another shape or surface; all when None."""
        changed = set(map(_uid, blocks or ()))
        kept = {key: of for key, of in self._meshes.items() if blocks is not None and not of.blocks & changed}
        if blocks is None or len(kept) < len(self._meshes):
            self._meshes, self.state, self._seen = kept, self.state + 1, None

    def refresh(self, scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph) -> None:
        """Look where the visible objects of a scene are now, evaluated just before, if anything has changed."""
        seen = to_road(scene, depsgraph).tolist(), scene.unit_settings.scale_length, depsgraph.mode
        if self._seen != (*seen, depsgraph.view_layer.name):
            self._walk(scene, depsgraph)
            self._seen = *seen, depsgraph.view_layer.name

    def _walk(self, scene, depsgraph) -> None:
        """Look at every instance."""
        meshes, by_face, labels, kinds = {}, {}, Labels(scene), Kinds()

        def take(item):
            key = _uid(_owner(item, depsgraph)), item.data.as_pointer()  # which others take again, but not its owner
            if key not in meshes:
                mesh = meshes[key] = self._meshes.get(key) or _mesh_of(item, depsgraph)
                if not mesh.polygons:
                    item.data.calc_loop_triangles()
                of = labels.of_faces(item.data, item.data.polygons if mesh.polygons else item.data.loop_triangles)
                by_face[id(mesh)] = np.full(len(mesh.surface), NO_LABEL, np.int32) if of is None else of
            return meshes[key], labels.of(item), kinds.of(item)

        before = self._table
        taken, turn, move = visible_instances(scene, depsgraph, scanned(scene, depsgraph.view_layer), take)
        self._meshes = meshes
        solid = np.abs(np.linalg.det(turn)) > 0.0
        rows = [row for row, (mesh, *_) in enumerate(taken) if solid[row] and len(mesh.surface)]
        self._place([taken[row] for row in rows], turn[rows], move[rows], by_face)
        self.state += not all(map(np.array_equal, before, self._table))

    def _place(self, taken, turn, move, by_face) -> None:
        """Keep a table of instances: the mesh, label, kind and place of each."""
        used = {id(mesh): mesh for mesh, *_ in taken}
        self._used, row = list(used.values()), {key: row for row, key in enumerate(used)}
        mesh = np.array([row[id(mesh)] for mesh, *_ in taken], dtype=np.int64)
        self._label, self._kind = np.array([of for _, *of in taken], dtype=np.int32).reshape(-1, 2).T
        self._instances = Instances(mesh, turn, move, np.array([mesh.box for mesh in self._used]).reshape(-1, 2, 3))
        self._first = np.cumsum([0, *(len(mesh.surface) for mesh in self._used)])  # of each mesh's faces
        self._surface = np.concatenate([np.empty(0, np.uint16), *(mesh.surface for mesh in self._used)])
        self._normal = np.concatenate([np.empty((0, 3)), *(mesh.normal for mesh in self._used)])
        self._of_face = np.concatenate([np.empty(0, np.int32), *(by_face[key] for key in used)])
        self._table = list(used), mesh, turn, move, self._label, self._kind, self._of_face  # as others see it

    def met(self, origin: np.ndarray, directions: np.ndarray, reach_m: float) -> tuple[np.ndarray, ...]:
        """As `StandingScenery.met`."""
        nearest = np.full(len(directions), reach_m)
        face, instance = self._instances.meet(origin, directions, nearest, self._cast)
        ray = np.flatnonzero(face != MISS)
        at = instance[ray]
        row = face[ray] + self._first[self._instances.mesh[at]]
        cosine = np.abs(np.einsum("ij,ij->i", self._instances.normals(at, self._normal[row]), directions[ray]))
        surface, label = of_kind(self._surface[row], self._kind[at]), np.maximum(self._label[at], self._of_face[row])
        return ray, nearest[ray], surface, cosine, label

    def _cast(self, mesh, starts, directions, reach):
        """As `casting.instances.Cast`."""
        origins, rays = (zip(*map(memoryview, np.ascontiguousarray(of)), strict=True) for of in (starts, directions))
        hits = enumerate(map(self._used[mesh].tree.ray_cast, origins, rays, reach.tolist()))
        found = [(row, face, distance) for row, (_, _, face, distance) in hits if face is not None]
        row, face, distance = np.array(found, dtype=float).reshape(-1, 3).T
        return row.astype(np.int64), face.astype(np.int64), distance


def _uid(block: bpy.types.ID) -> tuple:
    """What an original data-block is known by."""
    return type(block).__name__, getattr(block, "session_uid", 0) or block.name_full


def _owner(item, depsgraph) -> bpy.types.ID:
    """Whose the mesh of an evaluated object is: a mesh of the file's as it is there, or an object that has made it."""
    original = item.original
    plain = original.type == "MESH" and original.data.evaluated_get(depsgraph) == item.data
    return original.data if plain else original


def _mesh_of(item, depsgraph) -> _Mesh:
    """The mesh of an evaluated object."""
    mesh, original = item.data, item.original
    worn = [material.original for material in mesh.materials if material is not None]
    blocks = frozenset(map(_uid, [_owner(item, depsgraph), *worn]))
    polygons = original.type == "MESH" and original.evaluated_get(depsgraph).data == mesh
    vertices, faces, surface, box = arrays_of(mesh, triangles=not polygons)
    if polygons:
        normal = np.empty(3 * len(mesh.polygons), np.float32)
        mesh.polygons.foreach_get("normal", normal)
        tree, normal = BVHTree.FromObject(original, depsgraph), normal.reshape(-1, 3).astype(float)
    else:  # of curves, texts, and what geometry nodes have made
        tree = BVHTree.FromPolygons(vertices.tolist(), faces.tolist(), all_triangles=True)
        a, b, c = (vertices[faces[:, corner]] for corner in range(3))
        normal = np.cross(b - a, c - a)
    pad = _PAD * (box[-1] - box[0]).max()
    return _Mesh(tree, surface, normal, np.array([box[0] - pad, box[-1] + pad]), polygons, blocks)
