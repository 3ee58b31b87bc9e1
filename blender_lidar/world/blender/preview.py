"""Ray casting against the visible objects of the open scene at preview quality: Blender's own trees, one for each mesh.

Exact is what `site.open_scenery` gives; here a ray now and then slips between two faces, as `BVHTree.ray_cast` lets it.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import bpy
import numpy as np
from mathutils.bvhtree import BVHTree

from ..meshes import of_kind
from ..scenery import NO_LABEL
from .objects import role, to_road
from .site import Kinds, Labels, arrays_of, scanned, visible_instances

_PLACING = bpy.types.Object, bpy.types.Collection, bpy.types.Scene
_WITHOUT_SHAPE = "EMPTY", "CAMERA", "LIGHT", "LIGHT_PROBE", "SPEAKER", "ARMATURE", "LATTICE"
_TURN = 2.0 * np.pi
_CHUNK, _PAIRS = 512, 0.5  # most instances looked at in one go, and most pairs of one and a ray by the number of rays
_BANDS = 32  # of elevation, with as many rays each
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
        """Keep a table of instances: mesh, label and kind of each, what takes points to it and back, its sphere."""
        used = {id(mesh): mesh for mesh, *_ in taken}
        self._used, row = list(used.values()), {key: row for row, key in enumerate(used)}
        self._mesh = np.array([row[id(mesh)] for mesh, *_ in taken], dtype=np.int64)
        self._label, self._kind = np.array([of for _, *of in taken], dtype=np.int32).reshape(-1, 2).T
        self._turn, self._move = turn, move
        self._box = np.array([mesh.box for mesh in self._used]).reshape(-1, 2, 3)
        self._first = np.cumsum([0, *(len(mesh.surface) for mesh in self._used)])  # of each mesh's faces
        self._surface = np.concatenate([np.empty(0, np.uint16), *(mesh.surface for mesh in self._used)])
        self._normal = np.concatenate([np.empty((0, 3)), *(mesh.normal for mesh in self._used)])
        self._of_face = np.concatenate([np.empty(0, np.int32), *(by_face[key] for key in used)])
        cofactor = np.cross(turn[:, (1, 2, 0)], turn[:, (2, 0, 1)]).swapaxes(1, 2)
        self._back = cofactor / np.einsum("ni,ni->n", turn[:, 0], cofactor[:, :, 0])[:, None, None]  # the inverse
        half = 0.5 * (self._box[:, 1] - self._box[:, 0])[:, None] * ((1, 1, 1), (1, 1, -1), (1, -1, 1), (-1, 1, 1))
        self._across = half[self._mesh] @ turn  # from the centre to corners, no two of them opposite
        self._centre = np.einsum("ni,nij->nj", self._box.mean(axis=1)[self._mesh], turn) + move
        self._radius = np.sqrt(np.square(self._across).sum(axis=2).max(axis=1, initial=0.0))
        self._table = list(used), self._mesh, turn, move, self._label, self._kind, self._of_face  # as others see it

    def met(self, origin: np.ndarray, directions: np.ndarray, reach_m: float) -> tuple[np.ndarray, ...]:
        """As `StandingScenery.met`, in chunks of instances from near to far, without rays that have met something."""
        nearest = np.full(len(directions), reach_m)
        face, instance = np.full(len(directions), -1), np.zeros(len(directions), np.int64)
        middle = self._centre - origin
        gap = np.sqrt(np.square(middle).sum(axis=1)) - self._radius
        near = np.flatnonzero(gap <= reach_m)
        near = near[np.argsort(gap[near])]
        rays, first = _ByDirection(directions) if len(near) else None, 0
        while first < len(near) and rays.keep(nearest > gap[near[first]]):
            some = near[first : first + _CHUNK]
            which, ray, done = rays.towards(middle[some], self._across[some])
            self._cast(origin, directions, some, which, ray, (nearest, face, instance))
            first += done
        ray = np.flatnonzero(face >= 0)
        at = instance[ray]
        row = face[ray] + self._first[self._mesh[at]]
        normal = np.einsum("nj,nij->ni", self._normal[row], self._back[at])
        normal /= np.sqrt(np.square(normal).sum(axis=1))[:, None]
        cosine = np.abs(np.einsum("ij,ij->i", normal, directions[ray]))
        surface, label = of_kind(self._surface[row], self._kind[at]), np.maximum(self._label[at], self._of_face[row])
        return ray, nearest[ray], surface, cosine, label

    def _cast(self, origin, directions, some, which, ray, found) -> None:
        """Cast pairs of `some[which]` and `ray`, where the ray enters the box before what it has met, and keep it."""
        nearest, face, instance = found
        back = np.ascontiguousarray(self._back[some].transpose(1, 2, 0))
        box = self._box[self._mesh[some]].transpose(1, 2, 0)
        starts = np.einsum("in,ijn->jn", (origin - self._move[some]).T, back)
        along = sum(directions.T[axis, ray] * np.take(back[axis], which, axis=1) for axis in range(3))
        with np.errstate(divide="ignore", invalid="ignore"):
            low, high = (np.take(wall - starts, which, axis=1) / along for wall in box)
        enter, leave = np.fmin(low, high).max(axis=0), np.fmax(low, high).min(axis=0)
        left = np.flatnonzero((leave >= np.maximum(enter, 0.0)) & (enter < nearest[ray]))
        far = np.maximum(enter[left], 0.0)
        left = left[np.argsort(ray[left] + far / (1.0 + far))]  # by ray, from near to far
        later = np.diff(ray[left], prepend=-1) == 0  # most rays that meet anything meet the first that they enter
        of = self._mesh[some[which[left]]] + len(self._used) * later
        for mesh in np.unique(of):
            one = left[of == mesh]
            one = one[enter[one] < nearest[ray[one]]]
            stretch = np.sqrt(np.square(along[:, one]).sum(axis=0))  # lengths there over lengths in the scene
            reach = nearest[ray[one]] * stretch
            hit, number, distance = _cast(
                self._used[mesh % len(self._used)].tree, starts[:, which[one]], along[:, one], reach
            )
            order = np.argsort(-distance / stretch[hit])  # the nearest of a ray is written last
            hit, at = hit[order], one[hit[order]]
            nearest[ray[at]], face[ray[at]] = distance[order] / stretch[hit], number[order]
            instance[ray[at]] = some[which[at]]


class _ByDirection:
    """Rays from an origin, sorted by elevation and azimuth: those towards a box are found without looking at all."""

    def __init__(self, directions):
        self._all = len(directions)
        self._edges = np.quantile(directions[::8, 2], np.linspace(0.0, 1.0, _BANDS + 1)[1:-1])
        band = np.searchsorted(self._edges, directions[:, 2], side="right")
        key = band * (2.0 * _TURN) + np.arctan2(directions[:, 1], directions[:, 0])
        self._ray = np.argsort(key)
        self._key = key[self._ray]

    def keep(self, wanted):
        """Go on with those for which `wanted`, (n,) by ray, is true; whether there are any."""
        kept = wanted[self._ray]
        self._ray, self._key = self._ray[kept], self._key[kept]
        return len(self._ray) > 0

    def towards(self, middle, across):
        """Pairs (box, ray) of boxes with rays that may pierce them, and of how many boxes, as pairs may be too many.

        Each has its `middle` (k, 3) from the origin, and `across` (k, 4, 3) from there to corners, no two opposite.
        """
        x, y, z = (middle[:, None] + np.concatenate([across, -across], axis=1)).transpose(2, 0, 1)
        around, level = np.arctan2(middle[:, 1], middle[:, 0]), np.hypot(middle[:, 0], middle[:, 1])
        aside = (np.arctan2(y, x) - around[:, None] + np.pi) % _TURN - np.pi
        first, last = aside.min(axis=1), aside.max(axis=1)
        about = last - first > np.pi  # the origin is within, seen from above
        first, last = np.where(about, -np.pi, first), np.where(about, np.pi, last)
        nearest = np.maximum(level - np.hypot(across[..., 0], across[..., 1]).max(axis=1), 0.0)
        ends, farthest = np.stack([z.min(axis=1), z.max(axis=1)]), np.hypot(x, y).max(axis=1)
        beside = np.where((ends < 0.0) == [[True], [False]], nearest, farthest)  # where they are lowest and highest
        low, high = np.searchsorted(self._edges, ends / np.maximum(np.hypot(ends, beside), 1e-9), side="right")
        bands, start = high - low + 1, (around + first + np.pi) % _TURN - np.pi
        box = np.repeat(np.arange(len(middle)), bands)
        whole = _ranges(low, bands) * (2.0 * _TURN)  # where each band begins
        start, end = whole + start[box], whole + (start + last - first)[box]
        over = np.flatnonzero(end > whole + np.pi)  # reach beyond azimuth pi
        start = np.searchsorted(self._key, np.concatenate([start, whole[over] - np.pi]))
        end = np.searchsorted(self._key, np.concatenate([end, end[over] - _TURN]))
        box, count = np.concatenate([box, box[over]]), end - start
        most = np.cumsum(np.bincount(box, count, len(middle)))
        done = max(1, int(np.searchsorted(most, _PAIRS * self._all, side="right")))
        count[box >= done] = 0
        return np.repeat(box, count), self._ray[_ranges(start, count)], done


def _ranges(start, count):
    """Whole numbers from each start on, as many as its count says, one after the other."""
    return np.arange(count.sum()) + np.repeat(start - np.cumsum(count) + count, count)


def _cast(tree, origins, directions, reach):
    """Rows of rays that meet a face, its number, and how far along [local units]; (3, n) each, of any length."""
    starts, rays = (zip(*map(memoryview, np.ascontiguousarray(of)), strict=True) for of in (origins, directions))
    hits = enumerate(map(tree.ray_cast, starts, rays, reach.tolist()))
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
