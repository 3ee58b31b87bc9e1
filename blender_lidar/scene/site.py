"""A scene made ready: sensor, traffic, which frames are searched and which are held out, and which vehicles count."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from ..casting import resolve
from ..casting.protocol import StandingScenery
from ..errors import InputError
from ..scene.observation import CountedFrame, Observation, Scoring, scene_field
from ..sensors.beams import BeamLattice, beam_lattice
from ..sensors.model import LidarModel, load_model, unit_of
from ..traffic import FramePlan, Recording, Vehicles, plan_frames, read_traffic
from ..traffic.vehicles import rectangles_overlap, unknown_frame
from ..world.needs_blender import blender_room
from ..world.scenery import HALF_WIDTH_M, HEIGHT_M, Scenery, barrier, box, boxes_reach, join
from .observation import Region
from .provenance import run_identity, unchanged_inputs
from .scenario import Scenario
from .settings import BarrierSettings, BoxSettings, SensorSettings, WorldSettings

# --- The scenery that a scene's [world] describes: files that Blender reads, boxes and barriers, in the road frame -


def read_scenery(scenario: Scenario, reach_m: float) -> Scenery:
    """What stands still within a horizontal reach of the nominal mount; empty where there is nothing.

    Raises
    ------
    MissingFileError, InputError
        When a file is not there or cannot be used, or nothing of a file lies within reach.
    MissingExtraError
        When it is one that Blender must read, and Blender is not installed.
    """
    world = scenario.world
    centre = scenario.deployment.nominal_xy
    paths = [path for path in (world.blend, world.mesh) if path is not None]
    files = [_near(path, world, centre, reach_m) for path in paths]
    boxes = [box(item.name, item.centre_m, item.size_m, math.radians(item.heading_deg)) for item in world.boxes]
    barriers = [barrier(item.kind, item.y_m, item.x_m) for item in world.barriers]
    return join([*files, *(item.within(centre, reach_m) for item in [*boxes, *barriers])])


def _near(path: str, world: WorldSettings, centre: tuple[float, float], reach_m: float) -> Scenery:
    """What of a file lies within reach; a file of which nothing does is most likely put in the wrong place."""
    read_site = blender_room("site", path).read_site
    placing = _Placing(world.origin_m, math.radians(world.heading_deg))
    near = _placed(read_site(path, lambda box: bool(boxes_reach(placing.to_road(box), centre, reach_m))), placing)
    near = near.within(centre, reach_m)
    if len(near) == 0:
        corners = _placed(read_site(path), placing).corners
        low, high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
        raise InputError(
            f"{path}: nothing of it lies within {reach_m:g} m of the mount at x {centre[0]:g}, y {centre[1]:g} m; "
            f"in the road frame it spans x {low[0]:g} to {high[0]:g}, y {low[1]:g} to {high[1]:g} m: check [world] "
            "origin_m and heading_deg"
        )
    return near


@dataclass(frozen=True, slots=True)
class _Placing:
    """Where the road frame lies in the frame of a file: its origin [m] and the direction of its x axis [rad]."""

    origin_m: tuple[float, float, float]
    heading_rad: float

    def to_road(self, points: np.ndarray) -> np.ndarray:
        """Points (..., 3) of the file in the road frame [m]."""
        cos, sin = math.cos(self.heading_rad), math.sin(self.heading_rad)
        turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])  # for rows
        return (points - np.array(self.origin_m)) @ turn


def _placed(scenery: Scenery, placing: _Placing) -> Scenery:
    return replace(scenery, corners=placing.to_road(scenery.corners))


# --- A pole stands beside the traffic, never in it, and no LiDAR hangs inside a box or a barrier ----------

_PLACE = ("x_m", "y_m", "height_m")
_TOUCHING_M = 1e-6  # a mount that touches a vehicle counts as inside


def check_mount_is_clear(
    scenario: Scenario, frames: Iterable[Vehicles], mounts: Mapping[str, Mapping[str, float]] | None = None
) -> None:
    """Refuse a mount on the carriageway or inside a vehicle, or a LiDAR inside one of [world]'s boxes or barriers.

    Parameters
    ----------
    scenario : Scenario
        The road.
    frames : iterable of Vehicles
        The traffic.
    mounts : mapping of str to coordinates, optional
        Mounts to check, by the option that gave them; the scene's searched places and baseline if left out.

    Raises
    ------
    InputError
        Naming the place, and the lane's edges, the box, or the vehicle and frame.
    """
    if mounts is None:
        places = {
            f"{scenario.source}: [deployment] x_m, y_m": _searched(scenario),
            f"{scenario.source}: [baseline] x_m, y_m": _point(scenario.baseline),
        }
    else:
        places = {option: _point(mount) for option, mount in mounts.items()}
    right, left = scenario.road.carriageway_y
    for where, (low, high) in places.items():
        if low[1] < left and high[1] > right:
            raise InputError(
                f"{where}: the mount at y {_span(low[1], high[1])} m stands on the carriageway; "
                f"allowed: at most {right:g} or at least {left:g} m"
            )
        for solid in [*scenario.world.boxes, *map(_box_around, scenario.world.barriers)]:
            if _holds(solid, low, high):
                raise InputError(
                    f"{where}: the LiDAR hangs inside {solid.name!r} of [world]; move the one or the other"
                )
    for vehicles in frames:
        for where, (low, high) in places.items():
            inside = np.flatnonzero(boxes_meet_rectangle(vehicles, low[:2], high[:2]))
            if len(inside):
                raise InputError(
                    f"{where}: the mount at x {_span(low[0], high[0])} m, y "
                    f"{_span(low[1], high[1])} m stands inside vehicle {vehicles.vehicle_id[inside[0]]} of frame "
                    f"{vehicles.frame}; move it, or leave that frame out with [traffic] frame_ids"
                )


def boxes_meet_rectangle(vehicles: Vehicles, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Which footprints overlap the axis-parallel rectangle from `low` to `high` (2,) [m], (n,) bool."""
    footprints = vehicles.centre_m[:, :2], 0.5 * vehicles.size_m[:, :2], vehicles.heading_rad
    return rectangles_overlap(*footprints, 0.5 * (low + high), 0.5 * (high - low) + _TOUCHING_M, 0.0)


def _box_around(barrier: BarrierSettings) -> BoxSettings:
    (first, last), height = barrier.x_m, HEIGHT_M
    centre = (0.5 * (first + last), barrier.y_m, 0.5 * height)
    size = (last - first, 2 * HALF_WIDTH_M, height)
    return BoxSettings(name=f"{barrier.kind} at y {barrier.y_m:g} m", centre_m=centre, size_m=size)


def _holds(box: BoxSettings, low: np.ndarray, high: np.ndarray) -> bool:
    """Whether a LiDAR mounted anywhere between two corners (3,) may be inside a box."""
    middle, half = np.array(box.centre_m), 0.5 * np.array(box.size_m)
    if high[2] < middle[2] - half[2] or low[2] > middle[2] + half[2]:
        return False
    footprint = middle[None, :2], half[None, :2], np.array([math.radians(box.heading_deg)])
    mounts = 0.5 * (low + high)[:2], 0.5 * (high - low)[:2] + _TOUCHING_M, 0.0
    return bool(rectangles_overlap(*footprint, *mounts).any())


def _searched(scenario):
    """Between which corners, x, y and height, mountings are searched."""
    fixed, bounds = scenario.deployment.fixed, scenario.deployment.bounds
    spans = [(fixed[key], fixed[key]) if key in fixed else bounds[key] for key in _PLACE]
    return tuple(np.array(corner) for corner in zip(*spans, strict=True))


def _point(mount):
    point = np.array([mount[key] for key in _PLACE])
    return point, point


def _span(low, high):
    return f"{low:g}" if low == high else f"{low:g} to {high:g}"


# --- The site ---------------------------------------------------------------------------------------------------------

_VIEW_SLACK_M = 30.0  # vehicles whose centre is this far beyond the range can still reach into it
_FEWEST_ON_ROAD = 0.1  # share; at an intersection, or with both directions in one recording, many drive elsewhere


@dataclass(frozen=True, slots=True, eq=False)
class Site:
    """Everything that a mounting is judged on.

    Attributes
    ----------
    scenario : Scenario
        The settings.
    model : LidarModel
        The sensor, as the unit that hangs there.
    observation : Observation
        Sensor, range, caster and detail.
    scoring : Scoring
        The metric and the settings of Eqs. 10 and 11.
    recording : Recording
        The traffic.
    plan : FramePlan
        Searched and held-out frames.
    search, holdout : tuple of CountedFrame
        The frames of both; a vehicle counted in the search is never counted in the hold-out.
    identity : dict
        What must be the same for two runs on it to have the same result, by the files as they were read.
    """

    scenario: Scenario
    model: LidarModel
    observation: Observation
    scoring: Scoring
    recording: Recording
    plan: FramePlan
    search: tuple[CountedFrame, ...]
    holdout: tuple[CountedFrame, ...]
    identity: dict[str, object]

    @property
    def region(self) -> Region:
        """Where vehicles count."""
        return Region(self.scenario.deployment.nominal_xy, self.scenario.sensor.range_gate_m)

    @property
    def reach_m(self) -> float:
        """How far from the middle of the region vehicles are looked at: farther ones hide none that count [m]."""
        return _reach_m(self.scenario, None)

    def counted(self, vehicles: Vehicles) -> CountedFrame:
        """A frame of other traffic at this site: those within reach, and which of them count."""
        return _counted(vehicles, self.region, self.reach_m)


def prepare(scenario: Scenario, mount: Mapping[str, float] | None = None) -> Site:
    """Read what a scene names and check that mountings can be judged on it.

    Parameters
    ----------
    scenario : Scenario
        The settings.
    mount : mapping of str to float, optional
        A mounting given by hand, in metres and degrees, that will be judged too.

    Raises
    ------
    BlenderLidarError
        When a file cannot be read or changes meanwhile, no vehicle is in the region, or the mount would stand in
        traffic.
    """
    with unchanged_inputs(scenario):
        return _prepared(scenario, mount)


def _prepared(scenario: Scenario, mount: Mapping[str, float] | None) -> Site:
    lattice, caster = lattice_of(scenario.sensor), resolve(scenario.model.caster, "caster")
    model, objective = lattice.model, scenario.objective
    observation = Observation(
        lattice=lattice,
        max_range_m=scenario.sensor.range_gate_m,
        min_range_m=model.range_min_m,
        caster=caster,
        detail=scenario.world.detail,
        cell_m=objective.cell_m,
        reading=objective.reading,
        scenery=standing_scenery(scenario, caster, mount),
        imperfections=scenario.sensor.imperfections,
    )
    recording = read_recording(scenario)
    region = Region(scenario.deployment.nominal_xy, scenario.sensor.range_gate_m)
    settings = scenario.traffic
    plan = plan_frames(
        recording,
        region.holds,
        count=settings.frames,
        ids=settings.frame_ids,
        spacing_s=settings.spacing_s,
        holdout=settings.holdout,
        block_s=settings.block_s,
    )
    frames = [recording.vehicles(frame) for frame in (*plan.search, *plan.holdout)]
    check_mount_is_clear(scenario, frames)
    if mount is not None:
        check_mount_is_clear(scenario, frames, {"--x, --y": mount})
    reach = _reach_m(scenario, mount)
    searched = tuple(_counted(frame, region, reach) for frame in frames[: len(plan.search)])
    held_out = tuple(_counted(frame, region, reach, plan.searched_ids) for frame in frames[len(plan.search) :])
    if not sum(int(frame.counted.sum()) for frame in searched):
        x, y = region.centre_xy
        raise InputError(
            f"{recording.source}: no vehicle within {region.radius_m:g} m of the mount at x {x:g} m, y {y:g} m in the "
            f"{len(plan.search)} searched frames; check [traffic] origin_m, [road] and [deployment]"
        )
    scoring = Scoring(
        threshold=objective.threshold,
        view=objective.view,
        loss=objective.loss,
        reading=objective.reading,
        metric=objective.metric,
        field=scene_field(objective.metric, scenario.road, region.centre_xy, region.radius_m, searched),
    )
    standing = observation.scenery
    identity = run_identity(scenario, caster, standing and standing.scenery.digest)
    return Site(scenario, model, observation, scoring, recording, plan, searched, held_out, identity)


def lattice_of(sensor: SensorSettings) -> BeamLattice:
    """The beams of the unit that a scene names."""
    model = unit_of(load_model(sensor.name), sensor.unit_spread_deg, sensor.unit)
    return beam_lattice(model, sensor.rotation_hz)


def standing_scenery(scenario: Scenario, caster: str, mount: Mapping[str, float] | None) -> StandingScenery | None:
    """What a scene's [world] lets stand still within reach of its mountings and a given `mount`; None without any."""
    if not scenario.world.has_scenery:
        return None
    sensor = scenario.sensor
    reach = sensor.range_gate_m + sensor.imperfections.most_noise_m + _travel(scenario, mount)
    return StandingScenery(read_scenery(scenario, reach), caster)


def read_recording(scenario: Scenario) -> Recording:
    """The traffic that a scene names."""
    settings = scenario.traffic
    recording = read_traffic(
        settings.path,
        format=settings.format,
        time_step_s=settings.time_step_s,
        road=scenario.road,
        period=settings.period,
        location=settings.location,
        height_m=settings.height_m,
        origin_m=settings.origin_m,
        heading_deg=settings.heading_deg,
        vehicle_types=settings.vehicle_types,
    )
    recording = _with_place_told(recording, scenario)
    if settings.lanes is None:
        return recording
    in_lanes = np.isin(recording.lane, settings.lanes)
    if not in_lanes.any():
        present = ", ".join(map(str, np.unique(recording.lane)))
        raise InputError(
            f"{recording.source}: no vehicle in [traffic] lanes {list(settings.lanes)}; its lanes are {present}"
        )
    return recording.where(in_lanes)


def _with_place_told(recording: Recording, scenario: Scenario) -> Recording:
    """The same recording; its report tells if next to no vehicle near the mount is on the carriageway."""
    x, y = scenario.deployment.nominal_xy
    near = np.hypot(recording.centre_m[:, 0] - x, recording.centre_m[:, 1] - y) <= scenario.sensor.range_gate_m
    low, high = scenario.road.carriageway_y
    on_road = (recording.centre_m[near, 1] >= low) & (recording.centre_m[near, 1] <= high)
    if not near.any() or on_road.mean() >= _FEWEST_ON_ROAD:
        return recording
    note = (
        f"{100 * on_road.mean():.0f} % of the boxes near the mount lie on the carriageway of [road], "
        f"y {low:g} to {high:g} m; check [traffic] and [road]"
    )
    return replace(recording, report=replace(recording.report, notes=(*recording.report.notes, note)))


def frame_of(recording: Recording, frame: int, option: str) -> Vehicles:
    """One frame of a recording; an unknown number is refused with the option that gave it."""
    if frame not in recording.frames:
        raise InputError(f"{option}: {unknown_frame(frame, recording)}")
    return recording.vehicles(frame)


def _counted(vehicles, region, reach, not_counted=()) -> CountedFrame:
    near = vehicles.select(region.distance(vehicles) <= reach)
    counted = region.holds(near) & ~np.isin(near.vehicle_id, not_counted)
    return CountedFrame(near, counted)


def _reach_m(scenario: Scenario, mount: Mapping[str, float] | None) -> float:
    """How far from the nominal place vehicles matter to a mounting [m]."""
    return scenario.sensor.range_gate_m + _VIEW_SLACK_M + _travel(scenario, mount)


def _travel(scenario: Scenario, mount: Mapping[str, float] | None) -> float:
    """How far a searched mount, the baseline or a given one may be from the nominal place [m]."""
    far = 0.0
    for key, middle in zip(("x_m", "y_m"), scenario.deployment.nominal_xy, strict=True):
        places = [*scenario.deployment.bounds.get(key, ()), scenario.baseline[key], *([mount[key]] if mount else ())]
        far = max(far, *(abs(place - middle) for place in places))
    return far * np.sqrt(2.0)
