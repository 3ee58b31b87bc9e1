"""A scene made ready: sensor, traffic, which frames are searched and which are held out, and which vehicles count."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from ..casting import resolve
from ..casting.standing import StandingScenery
from ..errors import InputError
from ..provenance import run_identity, unchanged_inputs
from ..scenario import Scenario
from ..sensors.beams import BeamLattice, beam_lattice
from ..sensors.model import LidarModel, load_model
from ..sensors.unit import unit_of
from ..settings import SensorSettings
from ..traffic import FramePlan, Recording, Vehicles, plan_frames, read_traffic
from ..traffic.vehicles import unknown_frame
from .evaluation import Evaluator
from .frame_scorer import Observation
from .keep_clear import check_mount_is_clear
from .scenery import read_scenery
from .scoring import CountedFrame, Scoring, scene_field
from .worker_pool import within_blender
from .workplace import Workplace

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
    def workers(self) -> int:
        """Processes to use: as set, or one for each processor that this process may use; one within a real Blender."""
        if within_blender():
            return 1
        if self.scenario.model.workers:
            return self.scenario.model.workers
        return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1

    @property
    def workplace(self) -> Workplace:
        """Where evaluations are carried out."""
        return Workplace(self.workers, self.scenario.model.cluster)

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

    def evaluator(self, frames: tuple[CountedFrame, ...]) -> Evaluator:
        """Something that scores mountings on `frames`."""
        return Evaluator(frames, self.observation, self.scoring, self.workers, self.scenario.model.cluster)


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
        detail=scenario.model.detail,
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


@dataclass(frozen=True, slots=True)
class Region:
    """The region of interest: a disc about the nominal mount, the same for every mounting that is tried."""

    centre_xy: tuple[float, float]
    radius_m: float

    def distance(self, vehicles: Vehicles) -> np.ndarray:
        """Horizontal distance of each box centre from the middle, (n,) [m]."""
        return np.hypot(*(vehicles.centre_m[:, :2] - self.centre_xy).T)

    def holds(self, vehicles: Vehicles) -> np.ndarray:
        """Which box centres lie inside, (n,) bool."""
        return self.distance(vehicles) <= self.radius_m


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
