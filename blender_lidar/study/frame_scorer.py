"""One frame of traffic, made ready once, seen from any number of mountings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np

from ..casting import EXACT, RASTER
from ..casting.culling import ray_directions, reachable_beams
from ..casting.protocol import Returns, origins_of
from ..casting.standing import StandingScenery
from ..metrics.vgop import to_vehicle_frame
from ..metrics.view_grids import PlacedGrids
from ..numba_here import numba_works
from ..sensors.beams import BeamLattice
from ..sensors.detection_range import detection_range_m
from ..sensors.imperfections import PERFECT, Imperfections
from ..sensors.pose import Pose
from ..stop_signals import stops_recognised
from ..traffic.vehicles import Vehicles
from ..world.meshes import GLASS, REFLECTIVITY
from .frame_shapes import FrameShapes

_take = partial(np.take, mode="clip")  # rows are in range: without that check twice as fast in NumPy 2

_TURNS_AT_A_TIME = 16  # of several mountings: the rays that they keep fit into the cache
_RAYS_AT_A_TIME = 1 << 14  # of several mountings: enough to amortise NumPy's calls, few enough for the cache


@dataclass(frozen=True, slots=True)
class Observation:
    """How a mounting's beams see vehicles, before any score is made of it.

    Attributes
    ----------
    lattice : BeamLattice
        The sensor's beams.
    max_range_m : float
        Returns from farther away are lost [m].
    min_range_m : float
        Returns from nearer are lost [m].
    caster : str
        A name of `casting.CASTERS`.
    detail : str
        Level of detail of the vehicles' shapes.
    cell_m : float
        Side of an occupancy cell [m].
    reading : str
        How Eq. 8 is read: see `metrics.vgop.occupancy`.
    scenery : StandingScenery or None
        What stands still and hides vehicles.
    imperfections : Imperfections
        Range noise and lost returns; none unless said.
    culled : bool
        Whether beams that can reach no vehicle are left out; it changes no result. `raster` always does without them.
    """

    lattice: BeamLattice
    max_range_m: float
    min_range_m: float
    caster: str
    detail: str
    cell_m: float
    reading: str = "corrected"
    scenery: StandingScenery | None = None
    imperfections: Imperfections = PERFECT
    culled: bool = True


class Seen(NamedTuple):
    """What mountings saw of the counted vehicles of one frame.

    Attributes
    ----------
    points : ndarray of int64, (s, n)
        Returns from each vehicle, for each mounting.
    occupancy : ndarray, (s, n, 3)
        P of the top, side and front view.
    returns : (ndarray, ndarray) or None
        If they were asked for: the returns of all mountings, each in its vehicle's frame, (k, 3) [m], and the row that
        each belongs to, (k,): vehicles are counted on from mounting to mounting, 0 to s n - 1.
    """

    points: np.ndarray
    occupancy: np.ndarray
    returns: tuple[np.ndarray, np.ndarray] | None = None


class FrameScorer:
    """Casts the beams that can reach a vehicle and counts what they occupy.

    Parameters
    ----------
    vehicles : Vehicles
        All vehicles of the frame; each can hide another.
    counted : ndarray of bool, (n,)
        Those whose occupancy is wanted.
    observation : Observation
        Sensor, range, caster and detail. What its imperfections draw is kept: up to 8 bytes for each beam.
    shapes : FrameShapes, optional
        Of the same frame at the same detail behind the same caster, where they are made already.

    Attributes
    ----------
    vehicles : Vehicles
        The counted vehicles.
    shapes : FrameShapes
    """

    def __init__(
        self, vehicles: Vehicles, counted: np.ndarray, observation: Observation, shapes: FrameShapes | None = None
    ) -> None:
        self._observation = observation
        if shapes is None:
            shapes = FrameShapes(vehicles, counted, observation.detail, observation.caster)
        self.shapes, self.vehicles = shapes, shapes.counted
        self._tree, self._counted_row = shapes.tree, shapes.counted_row
        self._draws = observation.imperfections.draws(observation.lattice, vehicles.frame)
        self._reach_m = observation.max_range_m + observation.imperfections.most_noise_m
        asks_for_glass = self._draws is not None and self._draws.asks_for_glass
        self._of_glass = shapes.surface == GLASS if asks_for_glass else None  # each triangle
        self._seen_to_10_percent_m = observation.imperfections.range_at_10_percent_m
        self._reflectivity = None if self._seen_to_10_percent_m is None else REFLECTIVITY[shapes.surface]
        self._noisy = observation.imperfections.most_noise_m > 0.0
        self._grids = PlacedGrids(
            self.vehicles.centre_m,
            self.vehicles.size_m,
            self.vehicles.heading_rad,
            observation.cell_m,
            observation.reading,
        )
        self._draws_turns = observation.caster == RASTER
        self._compiled = self._compiled_passes()

    def __len__(self) -> int:
        return len(self.vehicles)

    @stops_recognised()
    def see(self, poses: Sequence[Pose], *, keep_returns: bool = False) -> Seen:
        """What each of s mountings sees of the n counted vehicles; the returns themselves only where they are kept."""
        if self._compiled is not None and not keep_returns:
            return self._see_compiled(poses)
        return self._see(poses, keep_returns)

    def _see(self, poses, keep_returns=False) -> Seen:
        points = np.zeros((len(poses), len(self)), dtype=np.int64)
        shares = np.zeros((len(poses), len(self), 3))
        kept = []
        for group, beams in self._groups(poses):
            members = poses[group]
            mount, directions, distance, row = self._returns(members, beams)
            counts = np.bincount(row if mount is None else mount * len(self) + row, minlength=points[group].size)
            points[group] = counts.reshape(len(members), len(self))
            origins = np.array([pose.position for pose in members])
            shares[group] = self._grids.returns_occupancy(origins, mount, directions, distance, row, self._noisy)
            if keep_returns:
                origin = origins[0] if mount is None else _take(origins, mount, axis=0)
                first = len(self) * (group.start + (0 if mount is None else mount))
                kept.append((self._in_vehicle_frames(origin, directions, distance, row), first + row))
        return Seen(points, shares, _joined(kept) if keep_returns else None)

    def _compiled_passes(self):
        """What does the same in one go where all returns count as they are; None where something is lost or hidden."""
        seen = self._observation
        if seen.caster == EXACT or not numba_works():
            return None
        if self._draws is not None or self._reflectivity is not None or seen.scenery is not None:
            return None
        if not len(self) or not len(self._tree.rows):  # nothing counts, or nothing has area
            return None
        what, gate = (self._tree, self._counted_row, self._grids, seen.lattice), (seen.min_range_m, seen.max_range_m)
        if self._draws_turns:
            from .compiled_turns import CompiledTurns

            return CompiledTurns(*what, *gate)
        from .compiled_beams import CompiledBeams

        return CompiledBeams(*what, self.shapes.pieces if seen.culled else None, *gate)

    def _see_compiled(self, poses) -> Seen:
        """What mountings see; those at which nothing is certain go the slow way."""
        points, cells, undecided = self._compiled.see(poses)
        shares = self._grids.shares(cells)
        for row in undecided.tolist():
            seen = self._see(poses[row : row + 1])
            points[row], shares[row] = seen.points[0], seen.occupancy[0]
        return Seen(points, shares)

    def vehicle_points(self, pose: Pose) -> tuple[np.ndarray, np.ndarray]:
        """Returns from counted vehicles: points (k, 3), each in its vehicle's frame [m], and vehicle rows (k,)."""
        ((_, beams),) = self._groups([pose])
        _, directions, distance, row = self._returns([pose], beams)
        return self._in_vehicle_frames(pose.position, directions, distance, row), row

    def _in_vehicle_frames(self, origin, directions, distance, row):
        """Returns in the frames of their vehicles, (k, 3)."""
        points = origin + (directions * distance).T  # Eqs. 2 and 3, the range scaling the direction alone
        return to_vehicle_frame(points, self.vehicles.centre_m, self.vehicles.heading_rad, row)

    def _groups(self, poses):
        """Mountings that are cast together, as a slice, with the beams of each that are cast; None where all are."""
        if self._draws_turns:
            step = min(self._grids.marks.clouds_at_a_time, _TURNS_AT_A_TIME)
            yield from ((slice(first, min(first + step, len(poses))), None) for first in range(0, len(poses), step))
            return
        first, group, rays = 0, [], 0
        for beams in self._beams(poses):
            if group and (rays + len(beams) > _RAYS_AT_A_TIME or len(group) == self._grids.marks.clouds_at_a_time):
                yield slice(first, first + len(group)), group
                first, group, rays = first + len(group), [], 0
            group.append(beams)
            rays += len(beams)
        if group:
            yield slice(first, first + len(group)), group

    def _beams(self, poses):
        """Beams of each mounting that are cast."""
        lattice = self._observation.lattice
        if self._observation.culled:
            return reachable_beams(lattice, self.shapes.pieces, poses, self._reach_m)
        return (np.arange(lattice.rings * lattice.columns) for _ in poses)

    def _returns(self, poses, beams):
        """Returns from counted vehicles: row of the mounting, direction (3, k), distance and row of the vehicle.

        The row of the mounting is None where there is one.
        """
        seen = self._observation
        mount, beam, origins, directions, found = self._drawn(poses) if beams is None else self._cast(poses, beams)
        row, distance = _take(self._counted_row, found.triangle), found.distance
        if self._draws is not None:
            of_glass = None if self._of_glass is None else _take(self._of_glass, found.triangle)
            distance = self._draws.measured(_take(beam, found.ray), distance, of_glass)
        wanted = np.flatnonzero((row >= 0) & (distance >= seen.min_range_m) & (distance <= seen.max_range_m))
        if self._reflectivity is not None:
            wanted = wanted[self._strong_enough(found, wanted, directions)]
        ray = _take(found.ray, wanted)
        if seen.scenery is not None:
            hidden = seen.scenery.hides(origins_of(origins, ray), directions.T[ray], _take(found.distance, wanted))
            wanted, ray = wanted[~hidden], ray[~hidden]
        return (
            None if mount is None else _take(mount, ray),
            _take(directions, ray, axis=1),
            _take(distance, wanted),
            _take(row, wanted),
        )

    def _cast(self, poses, beams):
        """Rays of given beams: rows of their mountings, beams, origins, directions (3, r), and what they meet."""
        lattice = self._observation.lattice
        directions = [ray_directions(lattice, some, pose) for pose, some in zip(poses, beams, strict=True)]
        mount, origins = _mounted(poses, [len(some) for some in beams])
        directions, beam = _end_to_end(directions, axis=1), _end_to_end(beams)
        return mount, beam, origins, directions, self._tree.meet(origins, directions.T, self._reach_m)

    def _drawn(self, poses):
        """The same for all beams that meet something."""
        turns = [self._tree.turn(self._observation.lattice, pose, self._reach_m) for pose in poses]
        mount, origins = _mounted(poses, [len(turn.beam) for turn in turns])
        beam, triangle, distance = (
            _end_to_end([getattr(turn, name) for turn in turns]) for name in ("beam", "triangle", "distance")
        )
        directions = _end_to_end([turn.directions for turn in turns], axis=1)
        return mount, beam, origins, directions, Returns(np.arange(len(beam)), triangle, distance)

    def _strong_enough(self, found, wanted, directions):
        """Which of some returns, by their rows in `found`, come from no farther than their surface is seen."""
        triangle, along = _take(found.triangle, wanted), _take(directions, _take(found.ray, wanted), axis=1)
        cosine = np.abs(np.einsum("ij,ji->i", self._tree.normals(triangle), along))
        seen_to_m = detection_range_m(self._seen_to_10_percent_m, _take(self._reflectivity, triangle), cosine)
        return _take(found.distance, wanted) <= seen_to_m


def _mounted(poses, rays):
    """Row of the mounting of each ray and its origin, for mountings with so many `rays`; None and (3,) for one."""
    if len(poses) == 1:
        return None, poses[0].position
    mount = np.repeat(np.arange(len(poses)), rays)
    return mount, _take(np.array([pose.position for pose in poses]).T, mount, axis=1).T


def _end_to_end(parts, axis=0):
    return parts[0] if len(parts) == 1 else np.concatenate(parts, axis=axis)


def _joined(parts):
    """Points (k, 3) and rows (k,) of all groups of mountings."""
    if not parts:
        return np.empty((0, 3)), np.empty(0, dtype=np.int64)
    return tuple(np.concatenate(columns) for columns in zip(*parts, strict=True))
