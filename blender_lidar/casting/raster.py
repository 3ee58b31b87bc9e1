"""Our own caster, compiled by Numba: whole turns are drawn (`sweep`), other rays go through a tree (`ray_tree`).

Both work in float64 with the planes that all casters measure with, and leave what rounding decides to `ExactSearch`:
so they find the same hits and ranges as the other casters do.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import cached_property
from typing import NamedTuple

import numpy as np

from ..sensors.beams import BeamLattice
from ..sensors.pose import Pose
from .canvas import Canvas, Table, canvas, table_of
from .exact import ExactSearch
from .planes import fastest_planes
from .protocol import FARTHEST, Caster
from .ray_tree import RayTree
from .shared_vertices import Mesh, mesh_of
from .sweep import draw, take_returns

_spare: dict[int, Canvas] = {}  # by number of beams


class Turn(NamedTuple):
    """What the beams of one turn met.

    Attributes
    ----------
    beam : ndarray of int64, (k,)
        Those that met something, flat indices into the lattice, rising.
    triangle : ndarray of int64, (k,)
        Row of the triangle that each met first.
    distance : ndarray, (k,)
        Distance along each [m].
    directions : ndarray, (3, k)
        Unit vectors in the road frame.
    """

    beam: np.ndarray
    triangle: np.ndarray
    distance: np.ndarray
    directions: np.ndarray


class RasterCaster(Caster):
    """Draws a turn's beams triangle by triangle; in float64, and the fastest by far."""

    name = "raster"

    def _prepare(self):
        planes = fastest_planes()(self._corners, self._normal)
        self._measured, self._planes, self._mesh = planes, planes.as_rows(), mesh_of(self._corners)

    @cached_property
    def _exact(self) -> ExactSearch:
        return ExactSearch(self._corners, self._measured)

    @cached_property
    def _tree(self) -> RayTree:
        return RayTree(self._corners, self._planes, self._exact)

    def _meet(self, origins, directions, max_range):
        return self._tree.meet(origins, directions, max_range)

    def turn(self, lattice: BeamLattice, pose: Pose, max_range: float) -> Turn:
        """What the beams of one turn meet first, no farther than `max_range` [m]."""
        if len(self._solid) == 0:
            return Turn(np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int64), np.empty(0), np.empty((3, 0)))
        max_range = min(max_range, FARTHEST)
        origin, rotation, components = pose.position - self.origin, pose.rotation, lattice.components.reshape(3, -1)
        with self.drawing(lattice) as (mesh, planes, closed, table, paper, turn):
            touching = draw(mesh, planes, table, components, origin, rotation, max_range, closed, turn, paper)
            *found, undecided = take_returns(paper, planes, components, origin, rotation, max_range)
        found = Turn(*found)
        if touching:
            everything = pose.to_world(components.T)
            met = self._exact.meet(origin, everything, max_range)
            found = Turn(met.ray, met.triangle, met.distance, np.ascontiguousarray(everything[met.ray].T))
            undecided = undecided[:0]
        if len(undecided):
            directions = pose.to_world(components[:, undecided].T)
            decided = self._exact.meet(origin, directions, max_range)
            beam = np.concatenate([found.beam, undecided[decided.ray]])
            order = np.argsort(beam)
            found = Turn(
                beam[order],
                np.concatenate([found.triangle, decided.triangle])[order],
                np.concatenate([found.distance, decided.distance])[order],
                np.concatenate([found.directions, directions[decided.ray].T], axis=1)[:, order],
            )
        return found._replace(triangle=self._solid[found.triangle])

    @contextmanager
    def drawing(
        self, lattice: BeamLattice, turns: int = 1
    ) -> Iterator[tuple[Mesh, np.ndarray, bool, Table, Canvas, int]]:
        """What compiled code needs to draw so many turns of a lattice.

        Mesh, planes, whether backs may be passed over, lattice, canvas, and the number of the first of these turns. The
        canvas is one for all casters; whoever draws has it alone, and who is interrupted leaves it behind.
        """
        beams, vertices = lattice.rings * lattice.columns, len(self._mesh.vertices)
        paper = _spare.pop(beams, None)
        if paper is None or len(paper.made) < vertices:
            paper = canvas(beams, vertices)
        first = int(paper.number[2])
        paper.number[2] += turns
        whole = len(self._solid) == self._given  # else solids may lack a side
        yield self._mesh, self._planes, self._closed and whole, table_of(lattice), paper, first
        _spare[beams] = paper
