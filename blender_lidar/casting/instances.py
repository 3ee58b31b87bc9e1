"""Instanced casting, a hierarchy of two levels: one tree for each mesh of the user's, whatever the number of vehicles.

Such a mesh may have 100,000 triangles and a frame 150 vehicles, too many to be merged. Rays are taken into a vehicle's
unit box instead, where its mesh lies as it was fitted, and what they meet there is taken back.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from functools import cached_property
from itertools import pairwise

import numpy as np

from ..traffic.boxes import Boxes
from ..traffic.vehicles import FLEET_KINDS, fleet_kind
from ..world.meshes import Shape
from .protocol import FARTHEST, MISS, Caster, Returns, origins_of

_HALF = 0.5 + 1e-9  # of the unit box, and what rounding may take off it
_AHEAD = 1.0  # rays start so far before the box, in its units: near enough for float32, and at none of its surfaces
_READY = np.full(3, _HALF + _AHEAD)
_AT_A_TIME = 1 << 20  # pairs of a ray and a box


class OwnBodies:
    """Meshes of the user's in place of our vehicles' bodies; their trees are made at the first cast and not pickled.

    Parameters
    ----------
    shapes : mapping of str to Shape
        By the kinds of `FLEET_KINDS`, each filling the unit box; that of trucks is one of long ones too where these
        have none.
    """

    def __init__(self, shapes: Mapping[str, Shape]) -> None:
        self.shapes = dict(shapes)
        self._trees: dict[tuple[str, str], Caster] = {}

    def __getstate__(self) -> dict:
        return {"shapes": self.shapes, "_trees": {}}

    @cached_property
    def digests(self) -> dict[str, str]:
        """SHA-256 of each mesh, by its kind."""
        contents = {kind: (one.vertices[one.faces].tobytes(), one.surface) for kind, one in self.shapes.items()}
        return {kind: hashlib.sha256(b"".join(parts)).hexdigest() for kind, parts in contents.items()}

    def rows(self, vehicles: Boxes) -> np.ndarray:
        """Which of the meshes each vehicle has, counted from 0 in their order, (n,) int; -1 for a body of ours."""
        kinds = list(self.shapes)
        own = {kind: kinds.index(kind) for kind in kinds}
        own.setdefault("long_truck", own.get("truck", -1))
        of_kind = np.array([own.get(kind, -1) for kind in FLEET_KINDS])
        return of_kind[fleet_kind(vehicles.class_index, vehicles.size_m[:, 0])]

    def tree(self, kind: str, caster: str) -> Caster:
        """A caster, of the name `caster`, of the mesh of a kind, in the unit box; it may be open."""
        if (kind, caster) not in self._trees:
            from . import caster_class

            shape = self.shapes[kind]
            self._trees[kind, caster] = tree = caster_class(caster)(shape.vertices[shape.faces], closed=False)
            tree.make_ready(-_READY, _READY)
        return self._trees[kind, caster]


class InstancedTree:
    """Caster of a frame some of whose vehicles have meshes of the user's: `meet` and `normals` as of `Caster`.

    Triangles are numbered on: first those of `base`, then those of each of these vehicles.

    Parameters
    ----------
    base : Caster
        Of the triangles of all other vehicles.
    count : int
        How many these are.
    vehicles : Boxes, of k
        Those that have a mesh of the user's.
    bodies : OwnBodies
        The meshes.
    """

    def __init__(self, base: Caster, count: int, vehicles: Boxes, bodies: OwnBodies) -> None:
        self._base, self._count, self._mesh = base, count, bodies.rows(vehicles)
        self._trees = [bodies.tree(kind, base.name) for kind in bodies.shapes]
        sizes = np.array([len(shape.faces) for shape in bodies.shapes.values()])
        self._faces_before = np.cumsum(sizes) - sizes  # of each mesh
        mine = sizes[self._mesh]
        self._first = count + np.cumsum(mine) - mine  # triangle of each vehicle
        self._centre, self._size = vehicles.centre_m, vehicles.size_m
        self._turn = np.cos(vehicles.heading_rad), np.sin(vehicles.heading_rad)
        self._radius = _HALF * np.linalg.norm(vehicles.size_m, axis=1)

    def solid(self, triangle: np.ndarray) -> np.ndarray:
        """For each triangle its row in the base, or beyond them that of its vehicle: the k are counted on."""
        return np.where(triangle < self._count, triangle, self._count + self._item(triangle))

    def face(self, triangle: np.ndarray) -> np.ndarray:
        """For each triangle its row in the base, or beyond them that in the meshes, each of which is there once."""
        item = self._item(triangle)
        in_meshes = self._count + self._faces_before[self._mesh[item]] + triangle - self._first[item]
        return np.where(triangle < self._count, triangle, in_meshes)

    def _item(self, triangle):
        """The vehicle that a triangle belongs to; any for one of the base."""
        return np.maximum(np.searchsorted(self._first, triangle, side="right") - 1, 0)

    def normals(self, triangle: np.ndarray) -> np.ndarray:
        """As `Caster.normals`."""
        normal, item = np.empty((len(triangle), 3)), self._item(triangle)
        ours = triangle < self._count
        normal[ours] = self._base.normals(triangle[ours])
        for mesh, tree in enumerate(self._trees):
            own = np.flatnonzero(~ours & (self._mesh[item] == mesh))
            of = item[own]
            square = tree.normals(triangle[own] - self._first[of]) / self._size[of]
            cos, sin = (part[of] for part in self._turn)
            x, y, z = (square / np.linalg.norm(square, axis=1, keepdims=True)).T
            normal[own] = np.stack([cos * x - sin * y, sin * x + cos * y, z], axis=1)
        return normal

    def meet(self, origins: np.ndarray, directions: np.ndarray, max_range: float = np.inf) -> Returns:
        """As `Caster.meet`: each ray looks into the boxes that it enters, the nearest first, until one is farther."""
        found = self._base.meet(origins, directions, max_range)
        nearest, triangle = np.full(len(directions), min(max_range, FARTHEST)), np.full(len(directions), MISS)
        nearest[found.ray], triangle[found.ray] = found.distance, found.triangle
        ray, item, enters, local = self._entered(origins, directions, nearest)
        order = np.lexsort((enters, ray))
        rank = np.arange(len(order)) - np.searchsorted(ray[order], ray[order])  # of each box among those of its ray
        for turn in range(rank.max(initial=-1) + 1):
            now = order[rank == turn]
            now = now[enters[now] <= nearest[ray[now]]]
            for mesh in np.unique(self._mesh[item[now]]).tolist():
                some = now[self._mesh[item[now]] == mesh]
                start, along = (part[some] for part in local)
                speed = np.linalg.norm(along, axis=1)  # box's units per metre
                from_m = np.maximum(enters[some] - _AHEAD / speed, 0.0)
                met = self._trees[mesh].meet(start + from_m[:, None] * along, along / speed[:, None])
                some, distance = some[met.ray], from_m[met.ray] + met.distance / speed[met.ray]
                of = ray[some]
                first = (distance < nearest[of]) | ((triangle[of] == MISS) & (distance == nearest[of]))
                nearest[of[first]] = distance[first]
                triangle[of[first]] = self._first[item[some[first]]] + met.triangle[first]
        ray = np.flatnonzero(triangle != MISS)
        return Returns(ray, triangle[ray], nearest[ray])

    def _entered(self, origins, directions, nearest):
        """Pairs of a ray and a box that it enters before `nearest`: both, how far off [m], start and way in its units.

        The way is not of unit length: along it distances stay metres.
        """
        ray, item = self._near_pairs(origins, directions, nearest)
        cos, sin = (part[item] for part in self._turn)
        local = []
        for x, y, z in ((origins_of(origins, ray) - self._centre[item]).T, directions[ray].T):
            local.append(np.stack([cos * x + sin * y, cos * y - sin * x, z], axis=1) / self._size[item])
        with np.errstate(divide="ignore", invalid="ignore"):
            one, other = (-_HALF - local[0]) / local[1], (_HALF - local[0]) / local[1]
        enters = np.fmin(one, other).max(axis=1)
        into = (np.fmax(one, other).min(axis=1) >= np.maximum(enters, 0.0)) & (enters <= nearest[ray])
        return ray[into], item[into], enters[into], [part[into] for part in local]

    def _near_pairs(self, origins, directions, nearest):
        """Pairs of a ray and a vehicle whose bounding sphere it pierces."""
        rays, items = [np.empty(0, np.int64)], [np.empty(0, np.int64)]
        shared = origins.ndim == 1
        ends = [] if shared else (np.flatnonzero((origins[1:] != origins[:-1]).any(axis=1)) + 1).tolist()
        for first, last in pairwise([0, *ends, len(directions)]):  # rays that start together
            towards = self._centre - (origins if shared else origins[first])
            least = np.square(towards).sum(axis=1) - self._radius**2  # of the square of what lies along the ray
            farthest = nearest[first:last].max(initial=0.0) + self._radius
            near = np.flatnonzero(least <= farthest**2 - self._radius**2)
            along_least = np.where(least > 0.0, np.sqrt(np.maximum(least, 0.0)), -np.inf)[near] * (1.0 - 1e-9)
            step = max(_AT_A_TIME // max(len(near), 1), 1)
            for start in range(first, last, step):
                there = directions[start : min(start + step, last)] @ towards[near].T >= along_least
                ray, item = np.nonzero(there)
                rays.append(ray + start)
                items.append(near[item])
        return np.concatenate(rays), np.concatenate(items)
