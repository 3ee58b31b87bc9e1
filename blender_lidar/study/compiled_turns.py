"""Turns drawn, measured and marked in one go, compiled: a whole swarm of mountings against one frame in the cache.

The arithmetic is that of `TrianglePlanes`, `Pose.to_world` and `PlacedGrids`, operation by operation.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..casting.compiled_rays import measured, to_world
from ..casting.raster import RasterCaster
from ..casting.sweep import draw
from ..compiled import compiled
from ..metrics.compiled_marks import mark_places
from ..metrics.view_grids import PlacedGrids
from ..sensors.beams import BeamLattice
from ..sensors.pose import Pose

_AT_A_TIME = 64  # mountings; their marks have to differ


class CompiledTurns:
    """Counts what mountings see of the counted vehicles of a frame, where nothing stands in between or is lost.

    Parameters
    ----------
    caster : RasterCaster
        Of the frame's triangles.
    counted_row : ndarray of int64, (m,)
        Row of the vehicle of each triangle among those that count; -1 where it does not.
    grids : PlacedGrids
        Of the vehicles that count.
    lattice : BeamLattice
        The sensor's beams.
    near, far : float
        The range gate [m].
    """

    def __init__(
        self,
        caster: RasterCaster,
        counted_row: np.ndarray,
        grids: PlacedGrids,
        lattice: BeamLattice,
        near: float,
        far: float,
    ) -> None:
        self._caster, self._grids, self._lattice, self._gate = caster, grids, lattice, (near, far)
        self._row = np.ascontiguousarray(counted_row[caster.rows], dtype=np.int64)
        self._components = lattice.components.reshape(3, -1)

    def see(self, poses: Sequence[Pose]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Points (s, n) and marked cells (s, n, 3) of s mountings, and those of them at which rounding decides.

        Of the latter, rows of `poses`, nothing is counted.
        """
        points = np.zeros((len(poses), len(self._grids)), dtype=np.int64)
        cells = np.zeros((len(poses), len(self._grids), 3), dtype=np.int64)
        undecided = np.zeros(len(poses), dtype=bool)
        for first in range(0, len(poses), _AT_A_TIME):
            some = slice(first, first + _AT_A_TIME)
            self._see(poses[some], points[some], cells[some], undecided[some])
        return points, cells, np.flatnonzero(undecided)

    def _see(self, poses, points, cells, undecided):
        """Add what some mountings see to their rows."""
        grids, origins = self._grids, np.array([pose.position for pose in poses])
        with self._caster.drawing(self._lattice, len(poses)) as drawing:
            _see_turns(
                *drawing,
                origins - self._caster.origin,
                np.array([pose.rotation for pose in poses]),
                self._components,
                self._row,
                *self._gate,
                np.ascontiguousarray(grids.starts(origins).reshape(3, len(poses), -1).transpose(1, 0, 2)),
                *grids.turning,
                grids.marks.cells,
                grids.marks.start,
                *grids.marks.take_marks(len(poses)),
                points,
                cells,
                undecided,
            )
        grids.marks.release()


@compiled
def _see_turns(
    mesh, planes, closed, table, paper, first_turn, origins, rotations, components, rows, near, far,
    starts, cosine, sine, cell_m, cells, first_cell, marks, first_mark, points, hit, undecided,
):  # fmt: skip
    """Add up `points` and `hit`, mounting by mounting."""
    beams = len(paper.nearest)
    place, vehicle = np.empty((3, beams)), np.empty(beams, dtype=np.int64)
    nearest, triangle, touched = paper.nearest, paper.triangle, paper.touched
    for s in range(len(origins)):
        origin, rotation, start = origins[s], rotations[s], starts[s]
        touching = draw(mesh, planes, table, components, origin, rotation, far, closed, first_turn + s, paper)
        undecided[s], found = _rounding_decides(paper, far) or touching, 0
        for k in range(paper.number[0]):
            beam = touched[k]
            t, nearest[beam] = triangle[beam], np.inf
            row = rows[t]
            if row < 0 or undecided[s]:
                continue
            x, y, z = to_world(components[0, beam], components[1, beam], components[2, beam], rotation)
            distance = measured(planes, t, origin, x, y, z)
            if not near <= distance <= far:
                continue
            points[s, row] += 1
            away = distance / cell_m
            place[0, found] = (cosine[row] * x + sine[row] * y) * away + start[0, row]
            place[1, found] = (cosine[row] * y - sine[row] * x) * away + start[1, row]
            place[2, found] = z * away + start[2, row]
            vehicle[found] = row
            found += 1
        mark_places(place, vehicle[:found], cells, first_cell, marks, first_mark + s, hit[s])


@compiled
def _rounding_decides(paper, reach):
    """Whether rounding decides of any beam; forgets it then."""
    found = False
    for k in range(paper.number[1]):
        beam = paper.doubtful[k]
        found |= paper.doubted[beam] <= min(paper.nearest[beam], reach)
        paper.doubted[beam] = np.inf
    return found
