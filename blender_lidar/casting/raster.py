"""Our own caster, compiled by Numba: whole revolutions are rasterised, other rays go through a tree (`RayTree`).

Both work in float64 with the planes that all casters measure with, and leave what rounding decides to `ExactSearch`:
so they find the same hits and ranges as the other casters do.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from ..compiled import compiled
from ..sensors.beams import BeamLattice
from ..sensors.pose import Pose
from .culling import ray_directions
from .protocol import FARTHEST, Caster, Revolution, decide_doubtful
from .rasterise import RUN, DepthBuffer, LatticeTable, Mesh, depth_buffer, lattice_table, rasterise, undecided_beams

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
        if len(self.rows) == 0:
            return Revolution(np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int64), np.empty(0), np.empty((3, 0)))
        max_range = min(max_range, FARTHEST)
        origin, components = pose.position - self.origin, lattice.components.reshape(3, -1)
        with self.rasterising(lattice) as (mesh, planes, closed, table, buffer, number):
            near_surface = rasterise(
                mesh, planes, table, components, origin, pose.rotation, max_range, closed, number, buffer
            )
            undecided = undecided_beams(buffer, max_range)
            touched = buffer.touched[: buffer.number[0]]
            buffer.nearest[touched] = np.inf
            if near_surface:  # nothing is certain
                undecided = np.arange(components.shape[1])
            beams = np.zeros(components.shape[1], dtype=bool)
            beams[touched] = beams[undecided] = True
            beam = np.flatnonzero(beams)
            triangle = np.minimum(buffer.triangle[beam], len(planes) - 1)  # of the undecided it is anything
        directions = ray_directions(lattice, beam, pose)
        distance = self._planes.meet(origin, directions, triangle).distance
        doubtful = np.searchsorted(beam, undecided)
        decide_doubtful(self._exact, origin, directions.T, max_range, doubtful, triangle, distance)
        met = distance <= max_range
        return Revolution(beam[met], self.rows[triangle[met]], distance[met], directions[:, met])

    @contextmanager
    def rasterising(
        self, lattice: BeamLattice, revolutions: int = 1
    ) -> Iterator[tuple[Mesh, np.ndarray, bool, LatticeTable, DepthBuffer, int]]:
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
        whole = len(self.rows) == self._given  # else solids may lack a side
        yield self._mesh, self.planes, self._closed and whole, lattice_table(lattice), buffer, first
        _spare[beams] = buffer


# --- Triangles as indices into vertices that they share, in runs of neighbours, each with a sphere about it -----------

_MIXERS = tuple(  # odd, else arbitrary
    map(np.uint64, (0x9E3779B97F4A7C15, 0xC2B2AE3D27D4EB4F, 0x165667B19E3779F9, 0xD6E8FEB86659FD93))
)
_RADIUS_ROUNDING = 1e-12  # relative: what rounding may take off a radius


def mesh_of(corners: np.ndarray) -> Mesh:
    """Indexed mesh of triangles `corners` (m, 3, 3) [m], at least one, with the vertices that they share."""
    flat = np.ascontiguousarray(corners.reshape(-1, 3)) + 0.0  # -0 becomes 0: they are the same place
    row, first = _same_places(flat.view(np.uint64), 1 << int(2 * len(flat) - 1).bit_length())
    vertices, faces = flat[first], row.reshape(-1, 3)
    least, most = corners.min(axis=1), corners.max(axis=1)
    runs = np.arange(0, len(faces), RUN)
    middle = 0.5 * (np.minimum.reduceat(least, runs) + np.maximum.reduceat(most, runs))
    away = np.square(corners - np.repeat(middle, RUN, axis=0)[: len(faces), None]).sum(axis=2).max(axis=1)
    radius = np.sqrt(np.maximum.reduceat(away, runs)) + _RADIUS_ROUNDING * np.abs(vertices).max()
    # Neighbours in the list hang together as long as a later one has a vertex of an earlier one.
    oldest = first[faces].min(axis=1) // 3
    starts = np.flatnonzero(np.minimum.accumulate(oldest[::-1])[::-1] == np.arange(len(faces)))
    low, high = np.minimum.reduceat(least, starts), np.maximum.reduceat(most, starts)
    return Mesh(vertices, faces, middle, radius, low, high)


@compiled
def _same_places(bits, size):
    """By a hash table: row of the first equal place for each of (n, 3), numbered as they come, and which came first."""
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
