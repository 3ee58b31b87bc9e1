"""Experiments on how a frame is seen: scorers that stand in the product's place, each with one step changed.

`PlainScorer` casts every beam against every triangle, one mounting after another; what `FrameScorer` does faster it
comes to as well, and so judges it. Others calculate in float32, leave out wheels and mirrors, or let vehicles move
while a turn lasts. `grounded` has the product's own scorer cast against the road too.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from ..casting import CASTERS, RASTER, caster_class, is_available
from ..casting.culling import cut_vehicles, reachable_beams
from ..casting.protocol import Caster, origins_of
from ..errors import InputError
from ..metrics.vgop import occupancy, to_vehicle_frame
from ..scene.observation import CountedFrame, Observation
from ..scene.site import Site
from ..scoring.frame_scorer import FrameScorer, FrameShapes, Seen
from ..sensors.beams import BeamLattice
from ..sensors.imperfections import PERFECT
from ..sensors.pose import Pose
from ..traffic.vehicles import Recording, Vehicles
from ..world.detailed_shapes import detailed_parts
from ..world.meshes import Shape, joined
from ..world.scenery import ground_plane
from ..world.shapes import DETAILS
from ..world.triangles import Triangles, vehicle_triangles

FREE_FLOW_M_S = 30.0

# --- the plain scorer -------------------------------------------------------------------------------------------------


class Shots(NamedTuple):
    """Returns from counted vehicles of one mounting.

    Attributes
    ----------
    direction : ndarray, (k, 3)
        Of each beam.
    distance : ndarray, (k,)
        Along it [m].
    row : ndarray of int, (k,)
        Of the counted vehicle that was met.
    centre_m : ndarray, (k, 3)
        Where that vehicle's box is taken to be [m, road frame].
    """

    direction: np.ndarray
    distance: np.ndarray
    row: np.ndarray
    centre_m: np.ndarray


class PlainScorer:
    """As `FrameScorer`, of a perfect sensor.

    Parameters
    ----------
    frame : CountedFrame
    observation : Observation
    triangles : Triangles, optional
        What stands for the frame's vehicles; those of the observation's detail if left out.

    Raises
    ------
    InputError
        For an imperfect sensor: what is drawn belongs to the product's own scorer.
    """

    def __init__(self, frame: CountedFrame, observation: Observation, triangles: Triangles | None = None) -> None:
        check_perfect(observation)
        self._observation = observation
        self.vehicles: Vehicles = frame.vehicles.select(frame.counted)
        self._counted_row = np.where(frame.counted, np.cumsum(frame.counted) - 1, -1)
        self._tree, self._owner = self._against(triangles or vehicle_triangles(frame.vehicles, observation.detail))

    def __len__(self) -> int:
        return len(self.vehicles)

    def see(self, poses: Sequence[Pose], *, keep_returns: bool = False) -> Seen:
        """What each of s mountings sees of the n counted vehicles."""
        points, shares, kept = [], [], []
        for number, pose in enumerate(poses):
            shots = self._shots(pose)
            local = self._local(pose.position, shots)
            points.append(np.bincount(shots.row, minlength=len(self)))
            shares.append(
                occupancy(local, shots.row, self.vehicles.size_m, self._observation.cell_m, self._observation.reading)
            )
            kept.append((local, number * len(self) + shots.row))
        returns = tuple(map(np.concatenate, zip(*kept, strict=True))) if keep_returns and kept else None
        return Seen(np.array(points).reshape(-1, len(self)), np.array(shares).reshape(-1, len(self), 3), returns)

    def _against(self, triangles: Triangles) -> tuple[Caster, np.ndarray]:
        tree = caster_class(_caster_of_rays(self._observation.caster))(triangles.corners, closed=True)
        return tree, self._counted_row[triangles.owner]

    def _shots(self, pose: Pose) -> Shots:
        directions = pose.to_world(self._observation.lattice.directions.reshape(-1, 3))
        return self._met(pose, directions, self._tree, self._owner, self.vehicles.centre_m)

    def _met(self, pose, directions, tree, owner, centre_m) -> Shots:
        """The returns of some beams against a tree whose triangles belong to counted rows, or to -1."""
        seen = self._observation
        found = tree.meet(pose.position, directions, seen.max_range_m)
        row = owner[found.triangle]
        wanted = np.flatnonzero((row >= 0) & (found.distance >= seen.min_range_m))
        ray, distance, row = found.ray[wanted], found.distance[wanted], row[wanted]
        if seen.scenery is not None:
            shown = ~seen.scenery.hides(origins_of(pose.position, ray), directions[ray], distance)
            ray, distance, row = ray[shown], distance[shown], row[shown]
        return Shots(directions[ray], distance, row, centre_m[row])

    def _local(self, origin: np.ndarray, shots: Shots) -> np.ndarray:
        """Returns in the frames of their vehicles, (k, 3) [m]."""
        points = origin + shots.direction * shots.distance[:, None]
        return to_vehicle_frame(points, shots.centre_m, self.vehicles.heading_rad[shots.row])


def check_perfect(observation: Observation) -> None:
    """Refuse an imperfect sensor."""
    if replace(observation.imperfections, seed=PERFECT.seed) != PERFECT:
        raise InputError("the scene's sensor is imperfect, and this experiment is made with a perfect one")


class SinglePrecisionScorer(PlainScorer):
    """What is cast becomes float32, and so does all that is made of it up to the place in the vehicle."""

    def _local(self, origin, shots):
        narrow = np.float32
        points = origin.astype(narrow) + shots.direction.astype(narrow) * shots.distance.astype(narrow)[:, None]
        away = points - shots.centre_m.astype(narrow)
        heading = self.vehicles.heading_rad.astype(narrow)[shots.row]
        cos, sin = np.cos(heading), np.sin(heading)
        ahead, left = cos * away[:, 0] + sin * away[:, 1], cos * away[:, 1] - sin * away[:, 0]
        return np.stack([ahead, left, away[:, 2]], axis=1).astype(float)


def _caster_of_rays(caster: str) -> str:
    """The scene's caster; for the one that is best at whole turns another that is fast, where one is installed."""
    others = [name for name in CASTERS[:-1] if name != RASTER and is_available(name)]
    return others[0] if caster == RASTER and others else caster


# --- a turn takes its time, and vehicles move while it lasts ----------------------------------------------------------

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
        return Shots(*map(np.concatenate, zip(*parts, strict=True)))


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


# --- vehicles without wheels and mirrors ------------------------------------------------------------------------------


@cache
def bare_shape(name: str, detail: str) -> Shape:
    """`shapes.shape` at the level `detailed` without the parts that stand on the ground, and without mirrors.

    What is left stays where it was: it no longer fills its box to the ground. `detail` is not looked at.
    """
    parts = detailed_parts(name)
    vertices = np.concatenate([part.vertices for part in parts])
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    kept = parts if name == "motorcycle" else parts[:-2]  # the last two are mirrors; a motorcycle keeps its own
    bare = joined([part for part in kept if part.vertices[:, 2].min() > low[2] + 1e-6])
    made = Shape((bare.vertices - low) / (high - low) - 0.5, bare.faces, bare.surface)
    for array in (made.vertices, made.faces, made.surface):
        array.setflags(write=False)
    return made


# --- ways to see a frame of a site, as variations name them -----------------------------------------------------------


def bare(site: Site, frame: CountedFrame) -> PlainScorer:
    """Vehicles at the best level of detail, without wheels and mirrors."""
    return PlainScorer(frame, site.observation, vehicle_triangles(frame.vehicles, DETAILS[-1], bare_shape))


def single(site: Site, frame: CountedFrame) -> PlainScorer:
    """Ranges and points in float32."""
    return SinglePrecisionScorer(frame, site.observation)


def moving(site: Site, frame: CountedFrame, *, fast: bool = False, boxes_move: bool = True) -> PlainScorer:
    """Vehicles that move during a turn as they were recorded, or all at one speed; see `MovingScorer`."""
    vehicles = frame.vehicles
    velocity = velocity_at(vehicles, FREE_FLOW_M_S) if fast else recorded_velocity(site.recording, vehicles)
    return MovingScorer(frame, site.observation, velocity, boxes_move=boxes_move)


def grounded(site: Site, frame: CountedFrame) -> FrameScorer:
    """The product's own scorer with the road among what is cast against, as two large triangles."""
    reach_m = site.reach_m + site.scenario.sensor.imperfections.most_noise_m
    ground = ground_plane(site.region.centre_xy, reach_m).corners
    seen = site.observation
    shapes = FrameShapes(frame.vehicles, frame.counted, seen.detail, seen.caster, ground)
    return FrameScorer(frame.vehicles, frame.counted, seen, shapes)
