"""Instanced casting, a hierarchy of two levels: one tree for each mesh, whatever the number of its instances.

A mesh may have 100,000 triangles, and a frame 150 vehicles that have it, or a file a forest of trees: too many to be
merged. Rays are taken to a mesh's own space instead, once they enter the box about an instance of it.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping
from functools import cached_property
from itertools import pairwise

import numpy as np

from ..traffic.boxes import Boxes
from ..traffic.vehicles import FLEET_KINDS, fleet_kind
from ..world.meshes import Shape
from .protocol import FARTHEST, MISS, Caster, Returns

_TURN = 2.0 * np.pi
_CHUNK, _PAIRS = 512, 0.5  # most instances looked at in one go, and most pairs of one and a ray by the number of rays
_BANDS = 32  # of elevation, with as many rays each
_HALF = 0.5 + 1e-9  # of the unit box, and what rounding may take off it
_READY = np.full(3, _HALF + 2.0)  # where rays may start

Cast = Callable[[int, np.ndarray, np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray, np.ndarray]]
"""Casts in a mesh's space: its row, starts and directions (3, k), reaches (k,); rows that hit, their faces, how far."""


class Instances:
    """Instances of meshes, each under an affine map.

    Parameters
    ----------
    mesh : ndarray of int, (k,)
        Which mesh each is of.
    turn, move : ndarray, (k, 3, 3) and (k, 3)
        A point p of the mesh lies at ``p @ turn + move``.
    box : ndarray, (m, 2, 3)
        Lowest and highest corner of each mesh, wider than it by what rounding takes off.
    """

    def __init__(self, mesh: np.ndarray, turn: np.ndarray, move: np.ndarray, box: np.ndarray) -> None:
        self.mesh, self._move, self._box = mesh, move, box
        cofactor = np.cross(turn[:, (1, 2, 0)], turn[:, (2, 0, 1)]).swapaxes(1, 2)
        self._back = cofactor / np.einsum("ni,ni->n", turn[:, 0], cofactor[:, :, 0])[:, None, None]  # the inverse
        half = 0.5 * (box[:, 1] - box[:, 0])[:, None] * ((1, 1, 1), (1, 1, -1), (1, -1, 1), (-1, 1, 1))
        self._ahead = 2.0 * half[:, 0].max(axis=1, initial=0.0)  # rays start so far before a box, at no surface in it
        self._across = half[mesh] @ turn  # from the centre to corners, no two of them opposite
        self._centre = np.einsum("ni,nij->nj", box.mean(axis=1)[mesh], turn) + move
        self._radius = np.sqrt(np.square(self._across).sum(axis=2).max(axis=1, initial=0.0))

    def normals(self, instance: np.ndarray, normal: np.ndarray) -> np.ndarray:
        """Unit normals (n, 3) of faces of instances, from those in the space of the mesh, of any length."""
        square = np.einsum("nj,nij->ni", normal, self._back[instance])
        return square / np.sqrt(np.square(square).sum(axis=1))[:, None]

    def meet(
        self, origin: np.ndarray, directions: np.ndarray, nearest: np.ndarray, cast: Cast
    ) -> tuple[np.ndarray, np.ndarray]:
        """What rays from an `origin` (3,) along unit `directions` (n, 3) meet nearer than `nearest` (n,) [m].

        Instances are met in chunks from near to far, without rays that have met something.

        Returns
        -------
        face, instance : ndarray of int64, (n,)
            `MISS` where there is none; elsewhere `nearest` has become how far off it is.
        """
        face, instance = np.full(len(directions), MISS), np.zeros(len(directions), np.int64)
        middle = self._centre - origin
        gap = np.sqrt(np.square(middle).sum(axis=1)) - self._radius
        near = np.flatnonzero(gap <= nearest.max(initial=0.0))
        near = near[np.argsort(gap[near])]
        rays, first = _ByDirection(directions) if len(near) else None, 0
        while first < len(near) and rays.keep(nearest > gap[near[first]]):
            some = near[first : first + _CHUNK]
            which, ray, done = rays.towards(middle[some], self._across[some])
            self._cast(origin, directions, some, which, ray, (nearest, face, instance), cast)
            first += done
        return face, instance

    def _cast(self, origin, directions, some, which, ray, found, cast) -> None:
        """Cast pairs of `some[which]` and `ray`, where the ray enters the box before what it has met, and keep it."""
        nearest, face, instance = found
        back = np.ascontiguousarray(self._back[some].transpose(1, 2, 0))
        box = self._box[self.mesh[some]].transpose(1, 2, 0)
        starts = np.einsum("in,ijn->jn", (origin - self._move[some]).T, back)
        along = sum(directions.T[axis, ray] * np.take(back[axis], which, axis=1) for axis in range(3))
        with np.errstate(divide="ignore", invalid="ignore"):
            low, high = (np.take(wall - starts, which, axis=1) / along for wall in box)
        enter, leave = np.fmin(low, high).max(axis=0), np.fmax(low, high).min(axis=0)
        left = np.flatnonzero((leave >= np.maximum(enter, 0.0)) & (enter < nearest[ray]))
        far = np.maximum(enter[left], 0.0)
        left = left[np.argsort(ray[left] + far / (1.0 + far))]  # by ray, from near to far
        later = np.diff(ray[left], prepend=-1) == 0  # most rays that meet anything meet the first that they enter
        of = self.mesh[some[which[left]]] + len(self._box) * later
        for group in np.unique(of).tolist():
            one, mesh = left[of == group], group % len(self._box)
            one = one[enter[one] < nearest[ray[one]]]
            stretch = np.sqrt(np.square(along[:, one]).sum(axis=0))  # lengths there over lengths in the scene
            before = np.maximum(enter[one] - self._ahead[mesh] / stretch, 0.0)
            start = starts[:, which[one]] + before * along[:, one]
            hit, number, distance = cast(mesh, start, along[:, one] / stretch, (nearest[ray[one]] - before) * stretch)
            distance = before[hit] + distance / stretch[hit]
            order = np.argsort(-distance)  # the nearest of a ray is written last
            order = order[distance[order] < nearest[ray[one[hit[order]]]]]
            at = one[hit[order]]
            nearest[ray[at]], face[ray[at]], instance[ray[at]] = distance[order], number[order], some[which[at]]


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
        self._base, self._count = base, count
        self._trees = [bodies.tree(kind, base.name) for kind in bodies.shapes]
        sizes = np.array([len(shape.faces) for shape in bodies.shapes.values()])
        self._faces_before = np.cumsum(sizes) - sizes  # of each mesh
        mesh = bodies.rows(vehicles)
        self._first = count + np.cumsum(sizes[mesh]) - sizes[mesh]  # triangle of each vehicle
        cos, sin, zero = np.cos(vehicles.heading_rad), np.sin(vehicles.heading_rad), np.zeros(len(mesh))
        turn = np.array([[cos, sin, zero], [-sin, cos, zero], [zero, zero, zero + 1.0]]).transpose(2, 0, 1)
        box = np.tile([[[-_HALF] * 3, [_HALF] * 3]], (len(sizes), 1, 1))
        self._instances = Instances(mesh, vehicles.size_m[:, :, None] * turn, vehicles.centre_m, box)

    def solid(self, triangle: np.ndarray) -> np.ndarray:
        """For each triangle its row in the base, or beyond them that of its vehicle: the k are counted on."""
        return np.where(triangle < self._count, triangle, self._count + self._item(triangle))

    def face(self, triangle: np.ndarray) -> np.ndarray:
        """For each triangle its row in the base, or beyond them that in the meshes, each of which is there once."""
        item = self._item(triangle)
        in_meshes = self._count + self._faces_before[self._instances.mesh[item]] + triangle - self._first[item]
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
            own = np.flatnonzero(~ours & (self._instances.mesh[item] == mesh))
            normal[own] = self._instances.normals(item[own], tree.normals(triangle[own] - self._first[item[own]]))
        return normal

    def meet(self, origins: np.ndarray, directions: np.ndarray, max_range: float = np.inf) -> Returns:
        """As `Caster.meet`."""
        found = self._base.meet(origins, directions, max_range)
        farthest = np.nextafter(min(max_range, FARTHEST), np.inf)  # itself included
        nearest, triangle = np.full(len(directions), farthest), np.full(len(directions), MISS)
        nearest[found.ray], triangle[found.ray] = found.distance, found.triangle
        shared = origins.ndim == 1
        ends = [] if shared else (np.flatnonzero((origins[1:] != origins[:-1]).any(axis=1)) + 1).tolist()
        for first, last in pairwise([0, *ends, len(directions)]):  # rays that start together
            origin, some = origins if shared else origins[first], slice(first, last)
            face, vehicle = self._instances.meet(origin, directions[some], nearest[some], self._cast)
            triangle[some] = np.where(face == MISS, triangle[some], self._first[vehicle] + face)
        ray = np.flatnonzero(triangle != MISS)
        return Returns(ray, triangle[ray], nearest[ray])

    def _cast(self, mesh, starts, directions, reach):
        """As `Cast`."""
        found = self._trees[mesh].meet(starts.T, directions.T, reach.max(initial=0.0))
        return found.ray, found.triangle, found.distance
