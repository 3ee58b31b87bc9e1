"""One frame of traffic, made ready once, seen from any number of layouts of LiDARs."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import cached_property
from itertools import repeat
from typing import NamedTuple

import numpy as np

from ..casting import EXACT, caster_class
from ..casting.culling import Pieces, cut_vehicles, revolutions
from ..casting.instances import InstancedTree, OwnBodies
from ..casting.protocol import Revolution, dot, take
from ..compiled import numba_works
from ..metrics.vgop import to_vehicle_frame
from ..metrics.view_grids import ViewGrids
from ..scene.observation import Observation
from ..sensors.pose import Pose
from ..signals import stops_recognised
from ..traffic.boxes import Boxes
from ..world.meshes import GLASS, REFLECTIVITY
from ..world.triangles import vehicle_triangles

# --- The vehicles of a frame as shapes, ready to be cast against: made once for any sensor and mounting ---


class FrameShapes:
    """Triangles of a frame's vehicles at one level of detail, in the tree of one caster.

    Parameters
    ----------
    frame : Boxes
        All vehicles; each can hide another, and those with `counted` are scored.
    detail : str
        Level of detail, of `world.shapes.DETAILS`.
    caster : str
        A name of `casting.CASTERS`.
    bodies : OwnBodies, optional
        Meshes of the user's, which some of the vehicles have.

    Attributes
    ----------
    counted : Boxes
        The vehicles that are scored.
    own : ndarray of bool, (n,), or None
        Vehicles that have a mesh of the user's; None where none has.
    tree : Caster or InstancedTree
        Of all triangles.
    owner : ndarray of int32, (m,)
        Row of each triangle's vehicle in the frame; for a triangle that was met it is ``owner[tree.solid(triangle)]``.
    counted_row : ndarray of int64, (m,)
        Row of each triangle's vehicle among the counted, -1 where it does not count; by `tree.solid` likewise.
    surface : ndarray of uint8, (m,)
        What each triangle is made of, an index into `world.meshes.SURFACES`: ``surface[tree.face(triangle)]``.
    """

    def __init__(self, frame: Boxes, detail: str, caster: str, bodies: OwnBodies | None = None) -> None:
        self.frame, self.detail, self.caster = frame.frame, detail, caster
        counted = frame.counts
        self.counted = frame.select(counted)
        own = None if bodies is None else bodies.rows(frame) >= 0
        self.own = own if own is not None and own.any() else None
        triangles = vehicle_triangles(frame, detail, self.own)
        self.owner, self.surface = triangles.owner, triangles.surface
        self.tree = caster_class(caster)(triangles.corners, closed=True)
        if self.own is not None:
            self.tree = InstancedTree(self.tree, len(triangles), frame.select(own), bodies)
            self.owner = np.append(self.owner, np.flatnonzero(own).astype(np.int32))
            self.surface = np.concatenate([self.surface, *(one.surface for one in bodies.shapes.values())])
        rows = np.append(np.where(counted, np.cumsum(counted) - 1, -1), -1)  # the last is that of `STATIC`
        self.counted_row = rows[self.owner].astype(np.int64)
        self._counted = counted

    @cached_property
    def pieces(self) -> Pieces:
        """The counted vehicles cut for culling: beams that can reach only others hide nothing from them."""
        return cut_vehicles(self.counted, self.detail, None if self.own is None else self.own[self._counted])


# --- The frame scorer -------------------------------------------------------------------------------------------------


class Seen(NamedTuple):
    """What layouts saw of the counted vehicles of one frame, all their LiDARs together.

    Attributes
    ----------
    by_lidar : ndarray of int64, (s, l, n)
        Returns of each LiDAR from each vehicle, for each layout; none of one that is left out.
    occupancy : ndarray, (s, n, 3)
        P of the top, side and front view; a cell that several LiDARs see is occupied once.
    returns : (ndarray, ndarray) or None
        If they were asked for: the returns of all layouts, each in its vehicle's frame, (k, 3) [m], and the row that
        each belongs to, (k,): vehicles are counted on from layout to layout, 0 to s n - 1.
    """

    by_lidar: np.ndarray
    occupancy: np.ndarray
    returns: tuple[np.ndarray, np.ndarray] | None = None

    @property
    def points(self) -> np.ndarray:
        """Returns from each vehicle, for each layout, (s, n) int64."""
        return self.by_lidar.sum(axis=1)


def singles(poses: Iterable[Pose]) -> list[tuple[Pose]]:
    """Layouts of one LiDAR each."""
    return [(pose,) for pose in poses]


class FrameScorer:
    """Frame scorer: casts the beams that can reach a vehicle of one frame and counts what they occupy.

    Compiled code (`compiled_frames`) does so where Numba is installed; NumPy's way is the one to read beside the paper,
    and decides where compiled code leaves something to rounding. Both find the same to the last digit.

    Parameters
    ----------
    frame : Boxes
        All vehicles; each can hide another, and those with `counted` are scored.
    observation : Observation
        The LiDARs of a layout, caster and detail. What their imperfections draw is kept: up to 8 bytes for each beam.
    shapes : FrameShapes, optional
        Of the same frame at the same detail behind the same caster, where they are made already.

    Attributes
    ----------
    vehicles : Boxes
        The counted vehicles.
    shapes : FrameShapes
    grids : ViewGrids
        Of the counted vehicles.
    compiled : CompiledScorer or None
        Who does the same where Numba is installed, for a frame in which something counts.
    """

    def __init__(self, frame: Boxes, observation: Observation, shapes: FrameShapes | None = None) -> None:
        self._observation = seen = observation.at(frame.time_s)
        self.shapes = shapes or FrameShapes(frame, seen.detail, seen.caster, seen.bodies)
        self.vehicles = self.shapes.counted
        self._measurements = [lidar.measurement(frame.draw) for lidar in seen.lidars]
        self.grids = ViewGrids(self.vehicles.size_m, seen.cell_m, seen.reading)
        self.cell_growth = seen.cell_growth
        self.compiled = None
        ours = self.shapes.own is None  # and no instances
        if numba_works() and seen.caster != EXACT and len(self) and ours and len(self.shapes.tree.rows):
            from .compiled_frames import CompiledScorer

            self.compiled = CompiledScorer(self.shapes, self.grids, seen, self._measurements)

    def __len__(self) -> int:
        return len(self.vehicles)

    @stops_recognised()
    def see(self, layouts: Sequence[Sequence[Pose | None]], *, keep_returns: bool = False) -> Seen:
        """What each of s layouts sees of the n counted vehicles; the returns themselves only where they are kept.

        A layout is a pose for each LiDAR, in their order; None where one is left out. LiDARs that keep their pose from
        layout to layout are cast once, so that moving one costs one cast.
        """
        if self.compiled is None or keep_returns:
            return self.seen_of(layouts, self._revolutions(layouts), keep_returns=keep_returns)
        by_lidar, cells, undecided = self.compiled.see(layouts)
        shares = self.grids.shares(cells)
        for row in undecided.tolist():
            one = layouts[row : row + 1]
            seen = self.seen_of(one, self._revolutions(one))
            by_lidar[row], shares[row] = seen.by_lidar[0], seen.occupancy[0]
        return Seen(by_lidar, shares)

    def vehicle_points(self, *layout: Pose) -> tuple[np.ndarray, np.ndarray]:
        """Returns from counted vehicles: points (k, 3), each in its vehicle's frame [m], and vehicle rows (k,)."""
        (found,) = self._revolutions([layout])
        parts = [returns for returns in self._returns(layout, found) if returns is not None]
        return tuple(map(np.concatenate, zip(*parts, strict=True)))

    def _returns(self, layout, turn):
        """The same of each LiDAR, given what its beams met; None of one that is left out."""
        return [
            None if pose is None else self.returns_of(pose, hits, lidar)
            for lidar, (pose, hits) in enumerate(zip(layout, turn, strict=True))
        ]

    def returns_of(self, pose: Pose, hits: Revolution, lidar: int = 0) -> tuple[np.ndarray, np.ndarray]:
        """Returns of one LiDAR from counted vehicles, as `vehicle_points`, given what its beams met."""
        scenery, measurement = self._observation.scenery, self._measurements[lidar]
        row = take(self.shapes.counted_row, self.shapes.tree.solid(hits.triangle))
        surface = self._surface(hits) if measurement.asks_for_surface else ()
        distance = measurement.measured(hits.beam, hits.distance, *surface)
        wanted = np.flatnonzero((row >= 0) & (distance < np.inf))
        directions = take(hits.directions, wanted, axis=1)
        if scenery is not None:
            shown = ~scenery.hides(pose.position, directions.T, take(hits.distance, wanted))
            wanted, directions = wanted[shown], directions[:, shown]
        distance, row = take(distance, wanted), take(row, wanted)
        points = pose.position + (distance * directions).T  # Eqs. 2 and 3, the range scaling the direction alone
        return to_vehicle_frame(points, self.vehicles.centre_m, self.vehicles.heading_rad, row), row  # Eqs. 4 and 5

    def _revolutions(self, layouts):
        """What the beams of each LiDAR of each layout meet, layout after layout; None of one that is left out."""
        turns = [self._turns(lidar, poses) for lidar, poses in enumerate(zip(*layouts, strict=True))]
        return zip(*turns, strict=True) if layouts else iter(())

    def _turns(self, number, poses):
        """What the beams of one LiDAR meet from each pose; one that it keeps from layout to layout is cast once."""
        tree, pieces = self.shapes.tree, self.shapes.pieces if self._observation.culled else None
        lidar, first = self._observation.lidars[number], poses[0]
        if len(poses) > 1 and all(pose == first for pose in poses):
            (found,) = self._turns(number, poses[:1])
            return repeat(found, len(poses))
        turns = iter(revolutions(tree, lidar.lattice, [one for one in poses if one is not None], lidar.reach_m, pieces))
        return (None if pose is None else next(turns) for pose in poses)

    def _surface(self, hits):
        """Whether hits are on glass, their reflectivity and the cosine of their incidence."""
        surface = take(self.shapes.surface, self.shapes.tree.face(hits.triangle))
        cosine = np.abs(dot(self.shapes.tree.normals(hits.triangle).T, hits.directions))
        return surface == GLASS, REFLECTIVITY[surface], cosine

    def seen_of(
        self, layouts: Sequence[Sequence[Pose]], turns: Iterable[Sequence[Revolution]], *, keep_returns: bool = False
    ) -> Seen:
        """As `see`, given what the beams of each LiDAR of each layout met, in turn."""
        by_lidar = np.zeros((len(layouts), len(self._measurements), len(self)), dtype=np.int64)
        shares = np.zeros((len(layouts), len(self), 3))
        kept = [(np.empty((0, 3)), np.empty(0, dtype=np.int64))]
        for number, (layout, turn) in enumerate(zip(layouts, turns, strict=True)):
            parts = [(np.empty((0, 3)), np.empty(0, dtype=np.int64))]
            for lidar, returns in enumerate(self._returns(layout, turn)):
                if returns is not None:
                    by_lidar[number, lidar] = np.bincount(returns[1], minlength=len(self))
                    parts.append(returns)
            local, row = parts[1] if len(parts) == 2 else map(np.concatenate, zip(*parts, strict=True))
            shares[number] = self.grids.occupancy(local, row)  # Eqs. 6 to 8
            if keep_returns:
                kept.append((local, number * len(self) + row))
        return Seen(by_lidar, shares, tuple(map(np.concatenate, zip(*kept, strict=True))) if keep_returns else None)
