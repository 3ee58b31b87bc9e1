"""One frame of traffic, made ready once, seen from any number of mountings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ..casting import caster_class
from ..casting.culling import box_pieces, reachable_beams
from ..metrics.vgop import occupancy, to_vehicle_frame
from ..sensors.beams import BeamLattice
from ..sensors.pose import Pose
from ..traffic.vehicles import Vehicles
from ..world.triangles import vehicle_triangles

_RAYS_AT_A_TIME = 1 << 16  # rays of several mountings are cast together, as many as stay in cache


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
    """

    lattice: BeamLattice
    max_range_m: float
    min_range_m: float
    caster: str
    detail: str
    cell_m: float


class Seen(NamedTuple):
    """What mountings saw of the counted vehicles of one frame.

    Attributes
    ----------
    points : ndarray of int64, (s, n)
        Returns from each vehicle, for each mounting.
    occupancy : ndarray, (s, n, 3)
        P of the top, side and front view.
    """

    points: np.ndarray
    occupancy: np.ndarray


class FrameScorer:
    """Casts the beams that can reach a vehicle and counts what they occupy.

    Parameters
    ----------
    vehicles : Vehicles
        All vehicles of the frame; each can hide another.
    counted : ndarray of bool, (n,)
        Those whose occupancy is wanted.
    observation : Observation
        Sensor, range, caster and detail.
    """

    def __init__(self, vehicles: Vehicles, counted: np.ndarray, observation: Observation) -> None:
        self._observation = observation
        self._vehicles = vehicles.select(counted)
        triangles = vehicle_triangles(vehicles, observation.detail)
        self._tree = caster_class(observation.caster)(triangles.corners)
        row = np.where(counted, np.cumsum(counted) - 1, -1)
        self._counted_row = row[triangles.owner]  # of each triangle; -1 where it does not count
        # Beams that can reach only vehicles that do not count need not be cast: they hide nothing from other beams.
        self._pieces = box_pieces(self._vehicles.centre_m, self._vehicles.size_m, self._vehicles.heading_rad)

    def __len__(self) -> int:
        return len(self._vehicles)

    def see(self, poses: Sequence[Pose]) -> Seen:
        """What each of s mountings sees of the n counted vehicles."""
        found: list[Seen] = []
        waiting: list[tuple[Pose, np.ndarray]] = []
        rays = 0
        for pose in poses:
            beams = reachable_beams(self._observation.lattice, self._pieces, pose, self._observation.max_range_m)
            if waiting and rays + len(beams) > _RAYS_AT_A_TIME:
                found.append(self._cast(waiting))
                waiting, rays = [], 0
            waiting.append((pose, beams))
            rays += len(beams)
        if waiting:
            found.append(self._cast(waiting))
        if not found:
            return Seen(np.empty((0, len(self)), dtype=np.int64), np.empty((0, len(self), 3)))
        return Seen(np.concatenate([f.points for f in found]), np.concatenate([f.occupancy for f in found]))

    def vehicle_points(self, pose: Pose) -> tuple[np.ndarray, np.ndarray]:
        """Returns from counted vehicles: points (k, 3), each in its vehicle's frame [m], and vehicle rows (k,)."""
        beams = reachable_beams(self._observation.lattice, self._pieces, pose, self._observation.max_range_m)
        local, row = self._points([(pose, beams)])
        return local, row

    def _cast(self, batch) -> Seen:
        """Cast the beams of several mountings together; vehicle i of mounting j is row ``j * n + i``."""
        local, row = self._points(batch)
        mountings, vehicles = len(batch), len(self)
        size = np.tile(self._vehicles.size_m, (mountings, 1))
        shares = occupancy(local, row, size, self._observation.cell_m)
        points = np.bincount(row, minlength=mountings * vehicles)
        return Seen(points.reshape(mountings, vehicles), shares.reshape(mountings, vehicles, 3))

    def _points(self, batch):
        flat = self._observation.lattice.directions.reshape(-1, 3)
        directions = np.concatenate([pose.to_world(np.take(flat, beams, axis=0)) for pose, beams in batch])
        rays = [len(beams) for _, beams in batch]
        origins = np.repeat([pose.position for pose, _ in batch], rays, axis=0) if len(batch) > 1 else batch[0][0].position
        hits = self._tree.cast(origins, directions, self._observation.max_range_m)
        met = np.flatnonzero(hits.distance < np.inf)
        row = np.take(self._counted_row, hits.triangle[met])
        wanted = (row >= 0) & (hits.distance[met] >= self._observation.min_range_m)
        met, row = met[wanted], row[wanted]
        points = hits.distance[met, None] * directions[met]
        points += origins if origins.ndim == 1 else origins[met]
        local = to_vehicle_frame(points, self._vehicles.centre_m, self._vehicles.heading_rad, row)
        mounting = np.repeat(np.arange(len(batch)), rays)[met]
        return local, row + mounting * len(self)
