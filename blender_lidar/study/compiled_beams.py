"""Beams culled, cast through a tree, measured and marked in a few passes, compiled.

The tree says in float32 which triangle each beam meets first; all the rest is done here, beam by beam. The arithmetic
is that of `TreeCaster`, `Pose.to_world` and `PlacedGrids`, operation by operation.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..casting.compiled_culling import single_directions_of
from ..casting.compiled_rays import to_world
from ..casting.culling import Pieces, ray_directions, reachable_beams
from ..casting.protocol import MISS
from ..casting.tree import EDGE_ON, TreeCaster
from ..compiled import compiled
from ..metrics.compiled_marks import mark_places
from ..metrics.view_grids import PlacedGrids
from ..sensors.beams import BeamLattice
from ..sensors.pose import Pose

_NONE = np.empty(0)


class CompiledBeams:
    """Counts what mountings see of the counted vehicles of a frame, where nothing stands in between or is lost.

    Parameters
    ----------
    caster : TreeCaster
        Of the frame's triangles, which bound solids.
    counted_row : ndarray of int64, (m,)
        Row of the vehicle of each triangle among those that count; -1 where it does not.
    grids : PlacedGrids
        Of the vehicles that count.
    lattice : BeamLattice
        The sensor's beams.
    pieces : Pieces or None
        Beams that can reach none of these are not cast; None where all are.
    near, far : float
        The range gate [m].
    """

    def __init__(
        self,
        caster: TreeCaster,
        counted_row: np.ndarray,
        grids: PlacedGrids,
        lattice: BeamLattice,
        pieces: Pieces | None,
        near: float,
        far: float,
    ) -> None:
        self._caster, self._grids, self._lattice, self._pieces = caster, grids, lattice, pieces
        self._near, self._far = near, far
        self._row = np.ascontiguousarray(counted_row[caster.rows], dtype=np.int64)
        self._components = lattice.components.reshape(3, -1)

    def see(self, poses: Sequence[Pose]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Points (s, n) and marked cells (s, n, 3) of s mountings, and those of them that touch a vehicle.

        Of the latter, rows of `poses`, nothing is counted.
        """
        points = np.zeros((len(poses), len(self._grids)), dtype=np.int64)
        cells = np.zeros((len(poses), len(self._grids), 3), dtype=np.int64)
        touching = [row for row, pose in enumerate(poses) if not self._saw(pose, points[row], cells[row])]
        return points, cells, np.array(touching, dtype=np.int64)

    def _saw(self, pose, points, cells):
        """Add what a mounting sees to its rows; whether that is certain."""
        beams = self._beams(pose)
        if not len(beams):
            return True
        position, rotation = pose.position, pose.rotation
        origin = position - self._caster.origin
        rays = single_directions_of(self._components, beams, rotation)
        triangle = self._caster.first(origin, rays, self._far)
        if triangle is None:
            return False
        grids = self._grids
        turned, gate = (self._components, rotation), (self._near, self._far)
        of_triangles = self._caster.planes, origin, self._row
        where = grids.marks.cells, grids.marks.start, *grids.marks.take_marks(1)
        marked = position, *grids.placing, *grids.turning, *where, points, cells
        doubtful = _see_beams(triangle, _NONE, beams, *turned, *of_triangles, *gate, *marked)
        if len(doubtful):
            found = self._caster.decide(origin, ray_directions(self._lattice, doubtful, pose).T, self._far)
            _see_beams(found.triangle, found.distance, doubtful[found.ray], *turned, *of_triangles, *gate, *marked)
        grids.marks.release()
        return True

    def _beams(self, pose):
        if self._pieces is None:
            return np.arange(self._components.shape[1])
        return next(reachable_beams(self._lattice, self._pieces, [pose], self._far))


@compiled
def _see_beams(
    triangle, decided, beams, components, rotation, planes, origin, rows, near, far,
    position, centre, half, cosine, sine, cell_m, cells, first_cell, marks, mark, points, hit,
):  # fmt: skip
    """Add up `points` and `hit` of one mounting from what its beams met first, and return the beams that are doubtful.

    Where distances are `decided` none is; else they are measured.
    """
    start, place = _starts(position, centre, half, cosine, sine, cell_m), np.empty((3, len(beams)))
    vehicle, found = np.empty_like(beams), 0
    doubtful, left = np.empty_like(beams), 0
    ox, oy, oz = origin[0], origin[1], origin[2]
    for k in range(len(beams)):
        t, beam = triangle[k], beams[k]
        if t == MISS:
            continue
        x, y, z = to_world(components[0, beam], components[1, beam], components[2, beam], rotation)
        if len(decided):
            distance = decided[k]
        else:
            facing = planes[t, 0] * x + planes[t, 1] * y + planes[t, 2] * z
            distance = (planes[t, 3] - (planes[t, 0] * ox + planes[t, 1] * oy + planes[t, 2] * oz)) / facing
            lacking = planes[t, 7] - (planes[t, 4] * ox + planes[t, 5] * oy + planes[t, 6] * oz)
            second = (planes[t, 4] * x + planes[t, 5] * y + planes[t, 6] * z) * distance - lacking
            lacking = planes[t, 11] - (planes[t, 8] * ox + planes[t, 9] * oy + planes[t, 10] * oz)
            third = (planes[t, 8] * x + planes[t, 9] * y + planes[t, 10] * z) * distance - lacking
            inside = distance >= 0.0 and second >= 0.0 and third >= 0.0 and second + third <= 1.0
            if not inside or facing > -EDGE_ON:
                doubtful[left] = beam
                left += 1
                continue
        row = rows[t]
        if row < 0 or not near <= distance <= far:
            continue
        points[row] += 1
        away = distance / cell_m
        place[0, found] = (cosine[row] * x + sine[row] * y) * away + start[0, row]
        place[1, found] = (cosine[row] * y - sine[row] * x) * away + start[1, row]
        place[2, found] = z * away + start[2, row]
        vehicle[found] = row
        found += 1
    mark_places(place, vehicle[:found], cells, first_cell, marks, mark, hit)
    return doubtful[:left]


@compiled
def _starts(position, centre, half, cosine, sine, cell_m):
    """As `PlacedGrids.starts`, of one origin."""
    start = np.empty((3, len(cosine)))
    for v in range(len(cosine)):
        x, y, z = position[0] - centre[v, 0], position[1] - centre[v, 1], position[2] - centre[v, 2]
        start[0, v] = (cosine[v] * x + sine[v] * y + half[0, v]) / cell_m
        start[1, v] = (cosine[v] * y - sine[v] * x + half[1, v]) / cell_m
        start[2, v] = (z + half[2, v]) / cell_m
    return start
