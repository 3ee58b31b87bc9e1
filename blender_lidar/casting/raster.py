"""Our own caster, compiled by Numba: whole revolutions are rasterised, other rays go through a tree (`RayTree`).

Both work in float64 with the planes that all casters measure with, and leave what rounding decides to `ExactSearch`:
so they find the same hits and ranges as the other casters do.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import NamedTuple

import numpy as np

from ..compiled import compiled
from ..sensors.beams import BeamLattice
from ..sensors.pose import Pose
from .protocol import FARTHEST, Caster, Revolution
from .rasterise import RUN, DepthBuffer, Table, depth_buffer, lattice_table, rasterise, take_returns

_spare: dict[int, DepthBuffer] = {}  # by number of beams


class RasterCaster(Caster):
    """Rasterises revolutions; in float64, and the fastest by far."""

    name = "raster"

    def _prepare(self):
        self._mesh = mesh_of(self._corners)

    def _meet(self, origins, directions, max_range):
        return self.ray_tree.meet(origins, directions, max_range)

    def revolution(self, lattice: BeamLattice, pose: Pose, max_range: float) -> Revolution:
        """What the beams of one revolution meet first, no farther than `max_range` [m]."""
        if len(self._solid) == 0:
            return Revolution(np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int64), np.empty(0), np.empty((3, 0)))
        max_range = min(max_range, FARTHEST)
        origin, rotation, components = pose.position - self.origin, pose.rotation, lattice.components.reshape(3, -1)
        with self.rasterising(lattice) as (mesh, planes, closed, table, buffer, number):
            near_surface = rasterise(
                mesh, planes, table, components, origin, rotation, max_range, closed, number, buffer
            )
            *found, undecided = take_returns(buffer, planes, components, origin, rotation, max_range)
        if near_surface:  # nothing is certain
            found, undecided = [column[..., :0] for column in found], np.arange(components.shape[1])
        if len(undecided):
            directions = pose.to_world(components[:, undecided].T).T
            met = self._exact.meet(origin, directions.T, max_range)
            more = undecided[met.ray], met.triangle, met.distance, directions[:, met.ray]
            order = np.argsort(np.concatenate([found[0], more[0]]))
            found = [np.concatenate(both, axis=-1)[..., order] for both in zip(found, more, strict=True)]
        beam, triangle, distance, directions = found
        return Revolution(beam, self._solid[triangle], distance, directions)

    @contextmanager
    def rasterising(
        self, lattice: BeamLattice, revolutions: int = 1
    ) -> Iterator[tuple[Mesh, np.ndarray, bool, Table, DepthBuffer, int]]:
        """What compiled code needs to rasterise so many revolutions of a lattice.

        Mesh, planes, whether backs may be passed over, lattice, depth buffer, and the number of the first of these
        revolutions. The buffer is one for all casters; whoever uses it has it alone, and who is interrupted leaves it
        behind.
        """
        beams, vertices = lattice.rings * lattice.columns, len(self._mesh.vertices)
        buffer = _spare.pop(beams, None)
        if buffer is None or len(buffer.projected_in) < vertices:
            buffer = depth_buffer(beams, vertices)
        first = int(buffer.number[2])
        buffer.number[2] += revolutions
        whole = len(self._solid) == self._given  # else solids may lack a side
        yield self._mesh, self.planes, self._closed and whole, lattice_table(lattice), buffer, first
        _spare[beams] = buffer


# --- Triangles as indices into vertices that they share, in runs of neighbours, each with a sphere about it -----------

_MIXERS = tuple(  # odd, else arbitrary
    map(np.uint64, (0x9E3779B97F4A7C15, 0xC2B2AE3D27D4EB4F, 0x165667B19E3779F9, 0xD6E8FEB86659FD93))
)
_RADIUS_ROUNDING = 1e-12  # relative: what rounding may take off a radius


class Mesh(NamedTuple):
    """Mesh of shared vertices, ready to be rasterised.

    Attributes
    ----------
    vertices : ndarray, (v, 3)
        Each place once [m].
    faces : ndarray of int32, (m, 3)
        Rows of the corners of each triangle.
    middle, radius : ndarray, (r, 3) and (r,)
        Sphere about each run of `RUN` triangles [m].
    low, high : ndarray, (s, 3)
        Boxes about what hangs together by its vertices [m]: a solid lies within one of them.
    """

    vertices: np.ndarray
    faces: np.ndarray
    middle: np.ndarray
    radius: np.ndarray
    low: np.ndarray
    high: np.ndarray


def mesh_of(corners: np.ndarray) -> Mesh:
    """Triangles `corners` (m, 3, 3) [m], at least one, with the vertices that they share."""
    flat = np.ascontiguousarray(corners.reshape(-1, 3)) + 0.0  # -0 becomes 0: they are the same place
    row, first = _same_places(flat.view(np.uint64), _table_size(len(flat)))
    vertices, faces = flat[first], row.reshape(-1, 3)
    middle, radius = _spheres(corners)
    return Mesh(vertices, faces, middle, radius + _RADIUS_ROUNDING * np.abs(vertices).max(), *_solids(vertices, faces))


def _table_size(places: int) -> int:
    return 1 << int(2 * places - 1).bit_length()


@compiled
def _same_places(bits, size):
    """Row of the first equal place for each of (n, 3), numbered as they come, and which places came first."""
    table = np.full(size, -1, dtype=np.int32)
    row, first, found = np.empty(len(bits), dtype=np.int32), np.empty(len(bits), dtype=np.int32), 0
    for i in range(len(bits)):
        x, y, z = bits[i, 0], bits[i, 1], bits[i, 2]
        mixed = (x * _MIXERS[0]) ^ (y * _MIXERS[1]) ^ (z * _MIXERS[2])
        mixed = (mixed ^ (mixed >> np.uint64(32))) * _MIXERS[3]  # round numbers have few bits, all of them high ones
        slot = np.int64((mixed ^ (mixed >> np.uint64(32))) & np.uint64(size - 1))
        while True:
            there = table[slot]
            if there < 0:
                table[slot], first[found], row[i] = found, i, found
                found += 1
                break
            at = first[there]
            if bits[at, 0] == x and bits[at, 1] == y and bits[at, 2] == z:
                row[i] = there
                break
            slot = (slot + 1) & (size - 1)
    return row, first[:found].copy()


def _spheres(corners):
    """Spheres about runs of triangles: middle (r, 3) of their boxes, and radius (r,)."""
    starts = np.arange(0, len(corners), RUN)
    low, high = np.minimum.reduceat(corners.min(axis=1), starts), np.maximum.reduceat(corners.max(axis=1), starts)
    middle = 0.5 * (low + high)
    away = corners - np.repeat(middle, np.diff(starts, append=len(corners)), axis=0)[:, None]
    return middle, np.sqrt(np.maximum.reduceat(np.square(away).sum(axis=2).max(axis=1), starts))


@compiled
def _solids(vertices, faces):
    """Boxes about what hangs together: low (s, 3) and high (s, 3)."""
    parent = np.arange(len(vertices))
    for t in range(len(faces)):
        a = _root(parent, faces[t, 0])
        for k in range(1, 3):
            b = _root(parent, faces[t, k])
            parent[b] = a
    number, found = np.full(len(vertices), -1), 0
    low, high = np.empty_like(vertices), np.empty_like(vertices)
    for v in range(len(vertices)):
        top = _root(parent, v)
        if number[top] < 0:
            number[top], low[found], high[found] = found, vertices[v], vertices[v]
            found += 1
        box = number[top]
        for axis in range(3):
            low[box, axis], high[box, axis] = (
                min(low[box, axis], vertices[v, axis]),
                max(high[box, axis], vertices[v, axis]),
            )
    return low[:found].copy(), high[:found].copy()


@compiled
def _root(parent, v):
    while parent[v] != v:
        parent[v] = parent[parent[v]]
        v = parent[v]
    return v
