"""A frame as it is seen while vehicles move during a revolution: `FrameScorer`, sector by sector."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from ..casting import CASTERS, RASTER, is_available
from ..casting.culling import cut_vehicles, ray_directions, reachable_beams
from ..casting.protocol import Revolution
from ..scene.observation import CountedFrame, Observation
from ..scene.site import Site
from ..scoring.frame_scorer import FrameScorer
from ..sensors.beams import BeamLattice
from ..sensors.pose import Pose
from ..traffic.vehicles import Recording, Vehicles

FREE_FLOW_M_S = 30.0

SECTORS = 16  # that a revolution is cut into; each sees vehicles where they are at its middle
_FARTHEST_FRAME_S = 1.0  # from which a velocity is still taken


class MovingScorer(FrameScorer):
    """Casts each sector of a revolution against vehicles where they are at its time.

    A frame's boxes are where vehicles are in the middle of the revolution.

    Parameters
    ----------
    frame : CountedFrame
    observation : Observation
    velocity_m_s : ndarray, (n, 2)
        Of each vehicle of the frame, counted or not.
    boxes_move : bool
        Whether a return is scored in its vehicle's box as it is at that time; else in the box of the middle of the
        revolution, as where nobody accounts for motion.
    """

    def __init__(
        self, frame: CountedFrame, observation: Observation, velocity_m_s: np.ndarray, *, boxes_move: bool = True
    ) -> None:
        observation = replace(observation, caster=_caster_of_rays(observation.caster))
        super().__init__(frame.vehicles, frame.counted, observation)
        self.compiled, self._sector = None, sectors(observation.lattice)
        swept = _swept(self.vehicles, velocity_m_s[frame.counted], observation)
        self._pieces = cut_vehicles(swept, "box")  # which holds every shape, wherever it is on its way
        self._turned = [
            FrameScorer(moved(frame.vehicles, velocity_m_s, late_s), frame.counted, observation)
            for late_s in sector_times(observation.lattice)
        ]
        if not boxes_move:
            for scorer in self._turned:
                scorer.vehicles = self.vehicles

    def _revolutions(self, layouts: Sequence[Sequence[Pose]]) -> Iterator[tuple[list[Revolution]]]:
        """What the beams of each mounting meet, sector by sector."""
        lattice, reach = self._observation.lattice, self._observation.lidar.reach_m
        for (pose,) in layouts:
            reachable, found = reachable_beams(lattice, self._pieces, pose, reach), []
            for number, scorer in enumerate(self._turned):
                beams = reachable[self._sector[reachable] == number]
                directions = ray_directions(lattice, beams, pose)
                met = scorer.shapes.tree.meet(pose.position, directions.T, reach)
                found.append(Revolution(beams[met.ray], met.triangle, met.distance, directions[:, met.ray]))
            yield (found,)

    def returns_of(self, pose: Pose, hits: list[Revolution], lidar: int = 0) -> tuple[np.ndarray, np.ndarray]:
        """As `FrameScorer.returns_of`, given what the beams of each sector met."""
        parts = [scorer.returns_of(pose, met, lidar) for scorer, met in zip(self._turned, hits, strict=True)]
        points, rows = map(np.concatenate, zip(*parts, strict=True))
        return points, rows


def moving(site: Site, frame: CountedFrame, *, fast: bool = False, boxes_move: bool = True) -> FrameScorer:
    """Vehicles that move during a revolution as they were recorded, or all at one speed; see `MovingScorer`."""
    vehicles = frame.vehicles
    velocity = velocity_at(vehicles, FREE_FLOW_M_S) if fast else recorded_velocity(site.recording, vehicles)
    return MovingScorer(frame, site.observation, velocity, boxes_move=boxes_move)


def _caster_of_rays(caster: str) -> str:
    """The scene's caster; for the one that is best at whole revolutions another fast one, where one is installed."""
    others = [name for name in CASTERS[:-1] if name != RASTER and is_available(name)]
    return others[0] if caster == RASTER and others else caster


def _swept(vehicles: Vehicles, velocity_m_s: np.ndarray, observation: Observation) -> Vehicles:
    """Boxes about all places where vehicles are during a revolution, whichever way they go."""
    way_m = np.hypot(*velocity_m_s.T) / observation.lattice.rotation_hz
    return replace(vehicles, size_m=vehicles.size_m + np.stack([way_m, way_m, np.zeros(len(way_m))], axis=1))


def sectors(lattice: BeamLattice) -> np.ndarray:
    """Which sector of the revolution each beam belongs to, by its column's time, (rings * columns,) int."""
    ring = np.arange(lattice.rings)[:, None]
    return (lattice.column(ring, np.arange(lattice.columns)) * SECTORS // lattice.columns).ravel()


def sector_times(lattice: BeamLattice) -> np.ndarray:
    """The middle of each sector, (SECTORS,) [s] from the middle of the revolution."""
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
    moved_m, lasted_s = np.zeros((len(vehicles), 2)), np.zeros((len(vehicles), 1))
    for place, sign in ((at - 1, -1.0), (at + 1, 1.0)):
        if 0 <= place < len(recording.frames):
            other = recording.vehicles(int(recording.frames[place]))
            if abs(other.time_s - vehicles.time_s) <= _FARTHEST_FRAME_S:
                _, here, there = np.intersect1d(vehicles.vehicle_id, other.vehicle_id, return_indices=True)
                moved_m[here] += sign * (other.centre_m[there, :2] - vehicles.centre_m[here, :2])
                lasted_s[here] += sign * (other.time_s - vehicles.time_s)
    return np.divide(moved_m, lasted_s, out=np.zeros_like(moved_m), where=lasted_s > 0.0)


def velocity_at(vehicles: Vehicles, speed_m_s: float) -> np.ndarray:
    """Velocity (n, 2) of vehicles that all drive ahead at one speed [m/s]."""
    return speed_m_s * np.stack([np.cos(vehicles.heading_rad), np.sin(vehicles.heading_rad)], axis=1)
