"""One revolution of a LiDAR over one frame of traffic: the point cloud."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import lru_cache
from typing import NamedTuple, Protocol

import numpy as np

from ..casting.culling import cut_vehicles, revolutions
from ..casting.protocol import Revolution, dot, take
from ..errors import InputError
from ..scene.observation import Observation
from ..scoring.frame_scorer import FrameShapes
from ..sensors.beams import BeamLattice
from ..sensors.pose import Pose
from ..traffic.boxes import Boxes
from ..traffic.vehicles import CLASSES
from ..world.meshes import GLASS, REFLECTIVITY, ROAD
from ..world.scenery import NO_LABEL
from ..world.triangles import STATIC

NO_CLASS = -1
FULL_INTENSITY_M = 10.0  # up to here a surface that faces the sensor returns its full reflectivity


@dataclass(frozen=True, slots=True)
class PointCloud:
    """The returns of one revolution, one row each; only beams that met something within range.

    Attributes
    ----------
    xyz : ndarray, (n, 3)
        Points [m, road frame].
    range_m : ndarray, (n,)
        Distance from the optical centre, as measured [m].
    ring : ndarray of uint16, (n,)
        Ring, 0 the lowest.
    azimuth_rad : ndarray, (n,)
        Azimuth in the sensor frame, clockwise from +y [rad].
    time_s : ndarray, (n,)
        Time since the start of the revolution [s].
    vehicle_id : ndarray of int64, (n,)
        Vehicle that was met, -1 for anything else.
    class_index : ndarray of int8, (n,)
        Index into `traffic.vehicles.CLASSES`, -1 for anything else.
    incidence_rad : ndarray, (n,)
        Angle between beam and surface normal [rad]; 0 is head-on.
    intensity : ndarray, (n,)
        Lambert's law by surface class, falling with the square of the range, 0 to 1.
    lidar : ndarray of uint8, (n,)
        Number of the LiDAR in the order of its layout; 0 where there is one.
    label : ndarray of int32, (n,)
        Number of the label of the user's own object that was met, -1 for anything else, as all have where left out.
    surface : ndarray of uint16, (n,)
        What was met, an index into `world.meshes.SURFACES` or, beyond these, a material of the user's own; road where
        left out.
    """

    xyz: np.ndarray
    range_m: np.ndarray
    ring: np.ndarray
    azimuth_rad: np.ndarray
    time_s: np.ndarray
    vehicle_id: np.ndarray
    class_index: np.ndarray
    incidence_rad: np.ndarray
    intensity: np.ndarray
    lidar: np.ndarray
    label: np.ndarray | None = None
    surface: np.ndarray | None = None

    def __post_init__(self) -> None:
        for name, value, kind in (("label", NO_LABEL, np.int32), ("surface", ROAD, np.uint16)):
            if getattr(self, name) is None:
                object.__setattr__(self, name, np.full(len(self.xyz), value, kind))

    def __len__(self) -> int:
        return len(self.xyz)

    def select(self, which: np.ndarray) -> PointCloud:
        """Some of the returns, by a mask or by rows."""
        return PointCloud(*(getattr(self, one.name)[which] for one in fields(self)))


class Stands(Protocol):
    """What stands still and returns: `StandingScenery`, or Blender's own trees of the user's objects."""

    def met(self, origin: np.ndarray, directions: np.ndarray, reach_m: float) -> tuple[np.ndarray, ...]:
        """As `StandingScenery.met`."""


class Turn(NamedTuple):
    """What the beams of one revolution met, before anything of it is measured.

    Attributes
    ----------
    vehicles : Revolution
        What they would meet of the vehicles, were there nothing else.
    directions : ndarray, (b, 3)
        Unit vectors of all beams [road frame].
    standing : tuple of tuples of ndarray
        What they would meet of each that stands still: as from `StandingScenery.met`.
    """

    vehicles: Revolution
    directions: np.ndarray
    standing: tuple[tuple[np.ndarray, ...], ...]


class FrameScan:
    """One frame of traffic, made ready once, whose point cloud is taken from any number of mountings.

    Parameters
    ----------
    shapes : FrameShapes
        The frame's vehicles as triangles behind a caster.
    vehicles : Boxes
        The frame.
    observation : Observation
        Sensor, range gate, scenery and imperfections: hits become returns by the same `MeasurementModel` as in
        `scoring.frame_scorer`. Scenery returns, and hides what is behind it.
    ground : bool
        Whether the road, the plane z = 0, returns.
    """

    def __init__(self, shapes: FrameShapes, vehicles: Boxes, observation: Observation, *, ground: bool = True) -> None:
        seen = observation.at(vehicles.time_s)
        self._shapes, self._vehicles, self._seen, self._ground = shapes, vehicles, seen, ground
        self._pieces = cut_vehicles(vehicles, seen.detail, shapes.own) if seen.culled else None
        self._reach_m = seen.lidar.reach_m
        self._model = seen.lidar.measurement(vehicles.draw)

    def turn(self, pose: Pose, also: Sequence[Stands] = ()) -> Turn:
        """Cast one revolution; `also` stands still beside the observation's scenery.

        Raises
        ------
        InputError
            When the sensor is not above the ground.
        """
        if self._ground and not pose.height_m > 0.0:
            raise InputError(f"the LiDAR hangs {pose.height_m} m above the ground; allowed: more than 0 m")
        lattice = self._seen.lattice
        (hits,) = revolutions(self._shapes.tree, lattice, [pose], self._reach_m, self._pieces)
        directions = pose.to_world(lattice.components.reshape(3, -1).T)
        standing = [*also] if self._seen.scenery is None else [self._seen.scenery, *also]
        found = (each.met(pose.position, directions, self._reach_m) for each in standing)
        return Turn(hits, directions, tuple(found))

    def cloud(self, pose: Pose, turn: Turn) -> PointCloud:
        """What a mounting measures of what its beams met."""
        seen, shapes, vehicles, directions = self._seen, self._shapes, self._vehicles, turn.directions
        kinds = (np.inf, float), (STATIC, np.int32), (ROAD, np.uint16), (1.0, float), (NO_LABEL, np.int32)
        met = [np.full(len(directions), value, kind) for value, kind in kinds]  # by beam, so far
        distance, owner, surface, cosine, label = met

        def meet(beam, *found):
            for column, values in zip(met, found, strict=True):
                column[beam] = values

        hits = turn.vehicles
        facing = np.abs(dot(shapes.tree.normals(hits.triangle).T, hits.directions))
        solid, face = shapes.tree.solid(hits.triangle), shapes.tree.face(hits.triangle)
        meet(hits.beam, hits.distance, shapes.owner[solid], shapes.surface[face], facing, NO_LABEL)
        for beam, away, made_of, facing, labelled in turn.standing:
            first = away < distance[beam]
            meet(beam[first], away[first], STATIC, made_of[first], facing[first], labelled[first])
        if self._ground:  # the plane z = 0: exact, where a mesh would leak
            down = -directions[:, 2]
            with np.errstate(divide="ignore", over="ignore"):
                to_ground = np.where(down > 0.0, pose.height_m / down, np.inf)
            first = np.flatnonzero((to_ground < distance) & (to_ground <= self._reach_m))
            meet(first, to_ground[first], STATIC, ROAD, down[first], NO_LABEL)

        every = np.arange(len(distance))
        made_of = (surface == GLASS, REFLECTIVITY[surface], cosine) if self._model.asks_for_surface else ()
        measured = self._model.measured(every, distance, *made_of)
        kept = np.flatnonzero(measured < np.inf)
        distance, owner, surface, cosine, label = (take(column, kept) for column in met)
        range_m, (ring, azimuth_rad, time_s) = take(measured, kept), _beams_of(seen.lattice)
        return PointCloud(
            xyz=pose.position + (range_m * take(directions.T, kept, axis=1)).T,  # Eqs. 2 and 3
            range_m=range_m,
            ring=take(ring, kept),
            azimuth_rad=take(azimuth_rad, kept),
            time_s=take(time_s, kept),
            vehicle_id=np.append(vehicles.vehicle_id, STATIC)[owner],  # the last, where it is no vehicle
            class_index=np.append(vehicles.class_index, np.int8(NO_CLASS))[owner],
            incidence_rad=np.arccos(np.clip(cosine, 0.0, 1.0)),
            intensity=REFLECTIVITY[surface] * cosine * _fall(distance),
            lidar=np.zeros(len(kept), dtype=np.uint8),
            label=label,
            surface=surface,
        )


@lru_cache(maxsize=8)
def _beams_of(lattice: BeamLattice) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Ring, azimuth [rad] and time [s] of all beams of a lattice, by their flat index."""
    ring, slot = np.divmod(np.arange(lattice.rings * lattice.columns), lattice.columns)
    return ring.astype(np.uint16), lattice.azimuth_rad(ring, slot), lattice.time_s(ring, slot)


def scan(vehicles: Boxes, observation: Observation, pose: Pose, *, ground: bool = True) -> PointCloud:
    """Cast one revolution over one frame: `FrameScan` for one mounting alone.

    Raises
    ------
    InputError
        When the sensor is not above the ground.
    """
    shapes = FrameShapes(vehicles, observation.detail, observation.caster, observation.bodies)
    frame = FrameScan(shapes, vehicles, observation, ground=ground)
    return frame.cloud(pose, frame.turn(pose))


def joined_clouds(clouds: Sequence[PointCloud]) -> PointCloud:
    """The clouds of a layout's LiDARs as one, LiDAR after LiDAR; a single one as it is."""
    columns = {one.name: np.concatenate([getattr(cloud, one.name) for cloud in clouds]) for one in fields(PointCloud)}
    columns["lidar"] = np.repeat(np.arange(len(clouds), dtype=np.uint8), list(map(len, clouds)))
    return PointCloud(**columns)


def class_names(class_index: np.ndarray) -> np.ndarray:
    """Class of each point as text: a name of `CLASSES`, or "" for what is no vehicle."""
    return np.array([*CLASSES, ""])[class_index]


def _fall(distance):
    return np.minimum(1.0, FULL_INTENSITY_M / np.maximum(distance, 1e-9)) ** 2
