"""Moments of a scene: one frame of its traffic under a mounting, with what the LiDAR saw, for Blender to show."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np

from ..casting import resolve
from ..casting.instances import OwnBodies
from ..casting.protocol import StandingScenery
from ..metrics.vgop import entropy, pe_vgop, to_vehicle_frame
from ..scene.lidars import LidarSpec
from ..scene.mounting import Layout, Mounting
from ..scene.provenance import versions
from ..scene.scenario import Scenario
from ..scene.settings import ObjectiveSettings
from ..scene.site import lattice_of, observation_of, read_bodies, standing_scenery
from ..sensors.beams import BeamLattice
from ..traffic.boxes import Boxes
from ..world.needs_blender import blender_room
from ..world.scenery import Scenery
from .files import LABELS, LIDARS
from .scan import PointCloud, joined_clouds, scan

if TYPE_CHECKING:
    from ..world.blender.scene import Moment
    from .live import Look


@dataclass(frozen=True, slots=True, eq=False)
class MountedSensor:
    """A scene's sensor at one mounting.

    Attributes
    ----------
    scenario : Scenario
        The scene with this LiDAR alone.
    mounting : Mounting
    lattice : BeamLattice
        The sensor's beams.
    caster : str
        A name of `casting.CASTERS`.
    scenery : StandingScenery or None
        What stands still.
    bodies : OwnBodies or None
        Meshes of the user's in place of our vehicles'.
    """

    scenario: Scenario
    mounting: Mounting
    lattice: BeamLattice
    caster: str
    scenery: StandingScenery | None
    bodies: OwnBodies | None = None

    @property
    def spec(self) -> LidarSpec:
        """The scene's LiDAR that it is."""
        return self.scenario.lidar

    @property
    def stands(self) -> Scenery | None:
        """What stands there at all times, None where nothing does."""
        return None if self.scenery is None else self.scenery.scenery

    def scan(self, vehicles: Boxes) -> PointCloud:
        """One revolution over a frame, ground included."""
        observation = observation_of(self.scenario, self.caster, self.scenery, bodies=self.bodies)
        return scan(vehicles, observation, self.mounting.pose, ground=self.scenario.plane_returns)

    def cloud_header(self, vehicles: Boxes) -> dict[str, object]:
        """What made the cloud of a frame, for the file that holds it."""
        lattice, sensor, slopes = self.lattice, self.spec.sensor, self.scenario.road.slopes
        return {
            "sensor": lattice.model.name,
            "pose": self.mounting.pose.as_table(),
            "frame": vehicles.frame,
            "caster": self.caster,
            "detail": self.scenario.world.detail,
            "ring_elevation_deg": np.degrees(lattice.elevation_rad).round(6).tolist(),
            "azimuth_step_deg": float(np.degrees(lattice.step_rad)),
            "rotation_hz": lattice.rotation_hz,
            "range_m": [lattice.model.range_min_m, sensor.range_gate_m],
            "imperfections": sensor.imperfections_as_table(),
            "versions": versions(self.caster),
            "mounting": self.mounting.as_table(),
            **({"road": slopes} if slopes else {}),
            **({LABELS: labels} if (labels := self.stands and self.stands.labels) else {}),
        }

    def moment(self, vehicles: Boxes, detections: Mapping[int, Boxes], points: Mapping | None) -> Moment:
        """A frame, the `points` that the sensor sees of it and what a detector found, for `world.blender.scene`."""
        return blender_room("scene", "a scene to be shown").Moment(
            road=self.scenario.road_map,
            vehicles=vehicles,
            detail=self.scenario.world.detail,
            lattice=self.lattice,
            pose=self.mounting.pose,
            range_gate_m=self.spec.sensor.range_gate_m,
            points=points,
            scenery=None if self.scenery is None else self.scenery.at(vehicles.time_s).with_walkers,
            settings=self.scenario.with_whole_paths(),
            name=self.spec.name,
            detections=detections,
            bodies=self.scenario.world.bodies,
        )


def mounted_sensors(
    scenario: Scenario, layout: Layout, more: Scenery | None = None, bodies: OwnBodies | None = None
) -> tuple[MountedSensor, ...]:
    """Each of the scene's sensors at its mounting: all see the same scenery, and `bodies`, read unless given."""
    caster = resolve(scenario.model.caster, "caster")
    scenery, bodies = standing_scenery(scenario, caster, layout, more), bodies or read_bodies(scenario)
    each, stands = zip(scenario.lidars, layout, strict=True), (caster, scenery, bodies)
    return tuple(
        MountedSensor(scenario.with_lidars(lidar), mounting, lattice_of(lidar.sensor), *stands)
        for lidar, mounting in each
    )


def fused_moment(
    scenario: Scenario,
    sensors: Sequence[MountedSensor],
    vehicles: Boxes,
    *,
    with_cloud: bool = True,
    detections: Mapping[int, Boxes] = MappingProxyType({}),
) -> Moment:
    """A frame under all LiDARs of a scene, each with its own cloud; PE-VGOP in them is that of all points together."""
    points: list[Mapping | None] = [None] * len(sensors)
    if with_cloud:
        clouds = [one.scan(vehicles) for one in sensors]
        bits = entropy_of_vehicles(joined_clouds(clouds), vehicles, scenario.objective)
        points = [vertices_of(cloud, vehicles, bits, number) for number, cloud in enumerate(clouds)]
    first, *further = (one.moment(vehicles, detections, of) for one, of in zip(sensors, points, strict=True))
    return replace(first, settings=scenario.with_whole_paths(), further=tuple(further))


def fused_header(sensors: Sequence[MountedSensor], vehicles: Boxes) -> dict[str, object]:
    """What made the joined cloud of a frame: the header of each LiDAR's, by its name; that of a single one as it is.

    `pose` is the first LiDAR's, in whose levelled frame formats of a sensor's frame have all points.
    """
    rows = [{"name": one.spec.name, **one.cloud_header(vehicles)} for one in sensors]
    if len(rows) == 1:
        return sensors[0].cloud_header(vehicles)
    shared = ("frame", "caster", "detail", "versions", "pose", LABELS)
    return {key: rows[0][key] for key in shared if key in rows[0]} | {LIDARS: rows}


def vertices_of(cloud: PointCloud, vehicles: Boxes, entropy_bits: np.ndarray, lidar: int = 0) -> dict:
    """A cloud, and PE-VGOP (v,) of the frame's vehicles, as `world.blender.points.show_cloud` takes them.

    Points that lie on no vehicle have 0 bits; `lidar` is the number of the LiDAR that has measured them.
    """
    bits = np.zeros(len(cloud))
    mine, row = _on_vehicles(cloud, vehicles)
    bits[mine] = entropy_bits[row]
    return {
        "xyz": cloud.xyz,
        "range": cloud.range_m,
        "ring": cloud.ring,
        "intensity": cloud.intensity,
        "vehicle": cloud.vehicle_id,
        "entropy": bits,
        "time": cloud.time_s,
        "lidar": np.full(len(cloud), lidar),
        "label": cloud.label,
    }


def entropy_of_vehicles(
    cloud: PointCloud, vehicles: Boxes, objective: ObjectiveSettings, look: Look | None = None
) -> np.ndarray:
    """PE-VGOP (Eq. 9) of every vehicle of a frame in a cloud of it, (v,) [bits].

    Occupancies of vehicles that a live `look` has scored are taken from there.
    """
    mine, row = _on_vehicles(cloud, vehicles)
    scored = None if look is None else look.scored
    if scored is not None:
        left = ~look.counted[row]
        mine, row = mine[left], row[left]
    points = to_vehicle_frame(cloud.xyz[mine], vehicles.centre_m, vehicles.heading_rad, row)
    bits = pe_vgop(points, row, vehicles.size_m, objective.cell_m, reading=objective.reading)
    if scored is not None:
        bits[look.counted] = entropy(scored.seen.occupancy[0]).sum(axis=1)
    return bits


def _on_vehicles(cloud, vehicles):
    """The points that lie on vehicles, and the rows of these."""
    mine = np.flatnonzero(cloud.vehicle_id >= 0)
    return mine, vehicles.rows_of(cloud.vehicle_id[mine])
