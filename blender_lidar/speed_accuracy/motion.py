"""An experiment: a turn takes its time, and vehicles move while it lasts."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np

from ..casting.culling import cut_vehicles, reachable_beams
from ..casting.protocol import Caster
from ..sensors.beams import BeamLattice
from ..sensors.pose import Pose
from ..study.frame_scorer import Observation
from ..study.scoring import CountedFrame
from ..traffic.vehicles import Recording, Vehicles
from ..world.triangles import vehicle_triangles
from .plain_scorer import PlainScorer, Shots

SECTORS = 16  # that a turn is cut into; each sees vehicles where they are at its middle
_FARTHEST_FRAME_S = 1.0  # from which a velocity is still taken


class MovingScorer(PlainScorer):
    """Casts each sector of a turn against vehicles where they are at its time.

    A frame's boxes are where vehicles are in the middle of the turn.

    Parameters
    ----------
    frame : CountedFrame
    observation : Observation
    velocity_m_s : ndarray, (n, 2)
        Of each vehicle of the frame, counted or not.
    boxes_move : bool
        Whether a return is scored in its vehicle's box as it is at that time; else in the box of the middle of the
        turn, as where nobody accounts for motion.
    """

    def __init__(
        self, frame: CountedFrame, observation: Observation, velocity_m_s: np.ndarray, *, boxes_move: bool = True
    ) -> None:
        super().__init__(frame, observation)
        self._sector = sectors(observation.lattice)
        self._boxes_move = boxes_move
        swept = _swept(self.vehicles, velocity_m_s[frame.counted], observation)
        self._pieces = cut_vehicles(swept, "box")  # which holds every shape, wherever it is on its way
        self._turned: list[tuple[Caster, np.ndarray, np.ndarray]] = []
        for late_s in sector_times(observation.lattice):
            there = moved(frame.vehicles, velocity_m_s, late_s)
            tree, owner = self._against(vehicle_triangles(there, observation.detail))
            self._turned.append((tree, owner, there.select(frame.counted).centre_m))

    def _shots(self, pose: Pose) -> Shots:
        lattice = self._observation.lattice
        (beams,) = reachable_beams(lattice, self._pieces, [pose], self._observation.max_range_m)
        beams = beams[np.argsort(self._sector[beams], kind="stable")]
        directions = pose.to_world(lattice.directions.reshape(-1, 3)[beams])
        ends = np.searchsorted(self._sector[beams], np.arange(SECTORS + 1))
        parts = []
        for (first, last), (tree, owner, centre_m) in zip(pairwise(ends.tolist()), self._turned, strict=True):
            box_m = centre_m if self._boxes_move else self.vehicles.centre_m
            parts.append(self._met(pose, directions[first:last], tree, owner, box_m))
        return Shots(
            *(
                np.concatenate([getattr(part, name) for part in parts])
                for name in ("direction", "distance", "row", "centre_m")
            )
        )


def _swept(vehicles: Vehicles, velocity_m_s: np.ndarray, observation: Observation) -> Vehicles:
    """Boxes about all places where vehicles are during a turn, whichever way they go."""
    way_m = np.hypot(*velocity_m_s.T) / observation.lattice.rotation_hz
    return replace(vehicles, size_m=vehicles.size_m + np.stack([way_m, way_m, np.zeros(len(way_m))], axis=1))


def sectors(lattice: BeamLattice) -> np.ndarray:
    """Which sector of the turn each beam belongs to, by its column's time, (rings * columns,) int."""
    ring = np.arange(lattice.rings)[:, None]
    return (lattice.column(ring, np.arange(lattice.columns)) * SECTORS // lattice.columns).ravel()


def sector_times(lattice: BeamLattice) -> np.ndarray:
    """The middle of each sector, (SECTORS,) [s] from the middle of the turn."""
    return ((np.arange(SECTORS) + 0.5) / SECTORS - 0.5) / lattice.rotation_hz


def moved(vehicles: Vehicles, velocity_m_s: np.ndarray, time_s: float) -> Vehicles:
    """The vehicles so much later."""
    centre = vehicles.centre_m.copy()
    centre[:, :2] += velocity_m_s * time_s
    return replace(vehicles, centre_m=centre)


def recorded_velocity(recording: Recording, vehicles: Vehicles) -> np.ndarray:
    """Velocity of each vehicle of a frame, (n, 2) [m/s], from where it is in the frames before and after.

    From one of them where it is in no other; 0 where it is in neither, or both are more than a second away.
    """
    at = int(np.searchsorted(recording.frames, vehicles.frame))
    places, times = [vehicles.centre_m[:, :2]] * 2, [np.full(len(vehicles), vehicles.time_s) for _ in range(2)]
    for side, neighbour in enumerate((at - 1, at + 1)):
        if not 0 <= neighbour < len(recording.frames):
            continue
        other = recording.vehicles(int(recording.frames[neighbour]))
        if abs(other.time_s - vehicles.time_s) > _FARTHEST_FRAME_S:
            continue
        _, here, there = np.intersect1d(vehicles.vehicle_id, other.vehicle_id, return_indices=True)
        places[side] = places[side].copy()
        places[side][here], times[side][here] = other.centre_m[there, :2], other.time_s
    lasted = (times[1] - times[0])[:, None]
    return np.divide(places[1] - places[0], lasted, out=np.zeros((len(vehicles), 2)), where=lasted > 0.0)


def velocity_at(vehicles: Vehicles, speed_m_s: float) -> np.ndarray:
    """Velocity (n, 2) of vehicles that all drive ahead at one speed [m/s]."""
    return speed_m_s * np.stack([np.cos(vehicles.heading_rad), np.sin(vehicles.heading_rad)], axis=1)
