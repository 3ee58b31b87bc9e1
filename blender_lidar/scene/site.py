"""A scene made ready: sensor, traffic, which frames are searched and which are held out, and which vehicles count."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ..casting import resolve
from ..casting.instances import OwnBodies
from ..casting.protocol import StandingScenery
from ..errors import InputError
from ..rigid import Rigid
from ..road.road_map import RoadMap
from ..sensors.beams import BeamLattice, beam_lattice
from ..sensors.lidar import Lidar
from ..sensors.model import LidarModel, load_model, unit_of, with_columns
from ..traffic import FramePlan, Recording, joined_plans, joined_recordings, plan_frames
from ..traffic.boxes import Boxes
from ..traffic.fleet import with_variety
from ..traffic.frames import few_vehicles
from ..traffic.movements import ways_by_map, ways_by_track, with_ways
from ..traffic.vehicles import CLASSES, unknown_frame
from ..world.clutter import Walkers, clutter
from ..world.meshes import SURFACES
from ..world.needs_blender import blender_room
from ..world.scenery import Scenery, along_road, barrier, box, boxes_reach, join, road_surface
from . import usual
from .mount_checks import check_mount_is_clear, check_places_are_clear, extent, mount_notes
from .mounting import Mounting
from .observation import Observation, Scoring, check_weights, of_scored_class, vehicle_weights
from .place_checks import nobody_there
from .plausibility import checked_recording
from .provenance import run_identity, unchanged_inputs
from .region import Region, region_of
from .roads import read_settings
from .scenario import Scenario
from .settings import ObjectiveSettings, SensorSettings, TrafficSettings

# --- The scenery that a scene's [world] describes: files that Blender reads, boxes and barriers, in the road frame -


def read_scenery(scenario: Scenario, reach_m: float, given: Sequence[Mounting] = ()) -> Scenery:
    """What stands still within a horizontal reach of the nominal mount; empty where there is nothing.

    Raises
    ------
    MissingFileError, InputError
        When a file is not there or cannot be used, or nothing of a file lies within reach.
    MissingExtraError
        When it is one that Blender must read, and Blender is not installed.
    """
    world = scenario.world
    centre = scenario.nominal_xy
    paths = [path for path in (world.blend, world.mesh) if path is not None]
    files = [_near(scenario, path, centre, reach_m) for path in paths]
    boxes = [
        box(item.name, item.centre_m, item.size_m, math.radians(item.heading_deg), SURFACES.index(item.kind))
        for item in world.boxes
    ]
    road = scenario.road_map
    barriers = [along_road(road, barrier(item.kind, item.y_m, road.stations(item.x_m))) for item in world.barriers]
    beside = join([])
    if world.clutter:
        stretch = road.stretch(centre, reach_m)
        beside = clutter(road, world.clutter, world.clutter_seed, stretch, _may_hang(scenario, given))
    if world.ground and not road.surface.is_flat:
        barriers.append(road_surface(road, centre, reach_m))
    return join([*files, *(item.within(centre, reach_m) for item in [*boxes, *barriers, beside])])


def _may_hang(scenario: Scenario, given: Sequence[Mounting]) -> list[tuple[np.ndarray, np.ndarray]]:
    """Where LiDARs may hang, as corners x, y of rectangles [m]: what is searched, the baselines, mountings by hand."""
    places = (place for lidar in scenario.lidars for place in lidar.deployment.places)
    extents = map(extent, (*places, *scenario.baselines, *given))
    return [(low[:2], high[:2]) for low, high in extents]


_UP = {".obj": "y", ".ply": "z", ".stl": "z"}  # as Blender takes files that do not say it
_ON_ROAD_M, _UNDER_ROAD_M = (
    0.5,
    -1.0,
)  # above its plane: where what stands begins at the latest; where little of it lies
_STEPS_A_CELL = 5.0
_MILLIMETRES_FROM_M = 5000.0


def _near(scenario: Scenario, path: str, centre: tuple[float, float], reach_m: float) -> Scenery:
    """What of a file lies within reach; a file of which nothing does is most likely put in the wrong place."""
    world, read_site, usual = scenario.world, blender_room("site", path).read_site, _UP.get(Path(path).suffix.lower())
    T_site_file = Rigid.about_z(math.radians(world.heading_deg), world.origin_m).inverse

    def to_road(points: np.ndarray, *, tipped: bool = False) -> np.ndarray:
        if tipped:  # from y up to z up is a quarter turn about x, and back
            points = points[..., [0, 2, 1]] * ([1.0, 1.0, -1.0] if usual == "y" else [1.0, -1.0, 1.0])
        return T_site_file.points(points)

    if world.up and path == world.mesh and not usual:
        raise InputError(f"[world] up: {path}: says itself which axis is up; allowed for {', '.join(_UP)}")
    whole = read_site(path, None if usual else lambda box: bool(boxes_reach(to_road(box), centre, reach_m)))
    step_m = float(np.spacing(np.abs(whole.corners).max(initial=0.0).astype(np.float32)))
    if step_m > scenario.objective.cell_m / _STEPS_A_CELL:
        raise InputError(
            f"{path}: coordinates as large as {np.abs(whole.corners).max():.0f} m have steps of {step_m:.2g} m in the "
            "32 bits that meshes have; subtract an origin from the file's coordinates and from [world] origin_m"
        )
    one, other = (
        replace(whole, corners=to_road(whole.corners, tipped=tipped)).within(centre, reach_m)
        for tipped in ([False, True] if world.up in (None, usual) else [True, False])
    )
    if usual and not world.up and _stands(other) and not (usual == "z" and _stands(one)):
        raise InputError(
            f'{path}: does not say which axis is up; with [world] up = "{usual}" it has {_heights_text(one)}, with '
            f'"{"z" if usual == "y" else "y"}" {_heights_text(other)}: say which'
        )
    if len(one) == 0:
        corners = to_road((whole if usual else read_site(path)).corners)
        low, high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
        large = "; perhaps in millimetres: metres are needed" if (high - low).max() > _MILLIMETRES_FROM_M else ""
        raise InputError(
            f"{path}: nothing of it lies within {reach_m:g} m of the mount at x {centre[0]:g}, y {centre[1]:g} m; "
            f"in the road frame it spans x {low[0]:g} to {high[0]:g}, y {low[1]:g} to {high[1]:g} m: check [world] "
            f"origin_m and heading_deg{large}"
        )
    if np.median(one.corners[..., 2]) < _UNDER_ROAD_M:
        raise InputError(
            f"{path}: most of it lies under the road, {_heights_text(one)}; check [world] origin_m, and up for "
            f"{', '.join(_UP)}"
        )
    return one


def _stands(found: Scenery) -> bool:
    """Whether scenery stands on the road rather than above or under it."""
    z = found.corners[..., 2]
    return len(found) > 0 and z.min() <= _ON_ROAD_M and np.median(z) >= -_ON_ROAD_M


def _heights_text(found: Scenery) -> str:
    """From where to where scenery is high, in words."""
    z = found.corners[..., 2].round(1) + 0.0
    return f"z {z.min():.1f} to {z.max():.1f} m in the road frame" if len(found) else "nothing within reach"


def read_bodies(scenario: Scenario) -> OwnBodies | None:
    """The meshes of [world.vehicles]; None without any.

    Raises
    ------
    MissingFileError, InputError
        When a file or what it names is not there, or has no faces.
    MissingExtraError
        When Blender is not installed.
    """
    where, found = scenario.where("world", "vehicles"), {}
    for kind, (file, name) in scenario.world.bodies.items():
        found[kind] = blender_room("bodies", f"{where} {kind}").read_body(file, name, f"{where} {kind}")
    return OwnBodies(found) if found else None


# --- The site ---------------------------------------------------------------------------------------------------------

_VIEW_SLACK_M = 30.0  # vehicles whose centre is this far beyond the range can still reach into it


@dataclass(frozen=True, slots=True, eq=False)
class Site:
    """Everything that a mounting is judged on.

    Attributes
    ----------
    scenario : Scenario
        The settings.
    observation : Observation
        Sensor, range, caster and detail.
    scoring : Scoring
        The metric and the settings of Eqs. 10 and 11.
    recording : Recording
        The traffic; several recordings as `traffic.joined_recordings` makes them one.
    plan : FramePlan
        Searched and held-out frames.
    search, holdout : tuple of Boxes
        The frames of both; a vehicle counted in the search is never counted in the hold-out.
    identity : dict
        What must be the same for two runs on it to have the same result, by the files as they were read.
    """

    scenario: Scenario
    observation: Observation
    scoring: Scoring
    recording: Recording
    plan: FramePlan
    search: tuple[Boxes, ...]
    holdout: tuple[Boxes, ...]
    identity: dict[str, object]

    @property
    def model(self) -> LidarModel:
        """The sensor of a layout of one, as the unit that hangs there."""
        return self.observation.lattice.model

    def with_lidar(self, number: int) -> Site:
        """The same site with one of its LiDARs, by its number from 0."""
        scenario = self.scenario.with_lidars(self.scenario.lidars[number])
        observation = replace(self.observation, lidars=self.observation.lidars[number : number + 1])
        return replace(self, scenario=scenario, observation=observation)

    @property
    def models(self) -> tuple[LidarModel, ...]:
        """The sensor of each LiDAR, as the unit that hangs there."""
        return tuple(lidar.lattice.model for lidar in self.observation.lidars)

    @property
    def region(self) -> Region:
        """Where vehicles count."""
        return region_of(self.scenario.region, self.scenario.road_map)

    @property
    def reach_m(self) -> float:
        """How far from the middle of the region vehicles are looked at: farther ones hide none that count [m]."""
        return reach_of(self.scenario)

    def counted(self, vehicles: Boxes) -> Boxes:
        """A frame of other traffic at this site: those within reach, and which of them count."""
        return _counted(vehicles, self.region, self.reach_m, self.scenario.objective)


def prepare(
    scenario: Scenario,
    given: Sequence[Mounting] = (),
    *,
    scenery: Scenery | None = None,
    recordings: Sequence[Recording] | None = None,
    bodies: OwnBodies | None = None,
) -> Site:
    """Read what a scene names and check that mountings can be judged on it.

    Parameters
    ----------
    scenario : Scenario
        The settings.
    given : sequence of Mounting
        Mountings given by hand that will be judged too.
    scenery : Scenery, optional
        What stands still besides what [world] says [m, road frame]; what is out of reach is left out.
    recordings : sequence of Recording, optional
        What `read_recordings` has read of the scenario already; read from its files if left out.
    bodies : OwnBodies, optional
        What `read_bodies` has read likewise.

    Raises
    ------
    BlenderLidarError
        When a file cannot be read or changes meanwhile, no vehicle is in the region, or the mount would stand in
        traffic.
    """
    objective = scenario.objective
    caster = resolve(scenario.model.caster, "caster")
    with unchanged_inputs(scenario):
        lidars, recordings = lidars_of(scenario), recordings or read_recordings(scenario)
        standing = standing_scenery(scenario, caster, given, scenery)
        bodies = bodies or read_bodies(scenario)
        identity = run_identity(scenario, caster, standing and standing.scenery.digest, bodies and bodies.digests)
    region = region_of(scenario.region, scenario.road_map)
    plans = [
        plan_frames(
            recording,
            lambda vehicles: region.holds(vehicles) & of_scored_class(vehicles, objective),
            count=settings.frames,
            ids=settings.frame_ids,
            spacing_s=settings.spacing_s,
            holdout=settings.holdout,
            block_s=settings.block_s,
        )
        for recording, settings in zip(recordings, scenario.recordings, strict=True)
    ]
    names = [one.name or "" for one in scenario.recordings]
    recording, plan = joined_recordings(recordings, names), joined_plans(plans, recordings, names)
    frames = [recording.at(frame) for frame in (*plan.search, *plan.holdout)]
    stands = standing and standing.scenery
    check_places_are_clear(scenario, frames, stands)
    hung = scenario.lidars if len(given) == len(scenario.lidars) else scenario.lidars[:1] * len(given)
    for lidar, mount in zip(hung, given, strict=True):
        check_mount_is_clear(scenario, lidar, frames, {"--x, --y": mount}, stands)
    reach = reach_of(scenario, given)
    searched = tuple(_counted(frame, region, reach, objective) for frame in frames[: len(plan.search)])
    held_out = tuple(
        _counted(frame, region, reach, objective, plan.searched_ids) for frame in frames[len(plan.search) :]
    )
    for number, own in enumerate(recordings):
        of_recording = plan.search_recording == number
        if not any(searched[at].counted.any() for at in np.flatnonzero(of_recording)):
            _check_classes(own, scenario)
            raise nobody_there(own, region, int(of_recording.sum()), scenario)
    judging = len({number for frame in held_out for number in frame.vehicle_id[frame.counted].tolist()})
    notes = [*plan.notes, _out_of_range(scenario, given, searched), *_same_notes(recordings, names)]
    notes += [*mount_notes(scenario, given), few_vehicles(len(plan.searched_ids), judging if held_out else None)]
    plan = replace(plan, notes=tuple(filter(None, notes)))
    both = _with_ways((*searched, *held_out), recording, scenario, region)
    searched, held_out = both[: len(searched)], both[len(searched) :]
    searched = _weighted(searched, plan.search_recording, scenario)
    held_out = _weighted(held_out, plan.holdout_recording, scenario)
    check_weights(objective, searched, held_out, scenario.where("objective", ""))
    observation, scoring = observation_of(scenario, caster, standing, lidars, bodies), scoring_of(scenario)
    return Site(scenario, observation, scoring, recording, plan, searched, held_out, identity)


def _check_classes(recording: Recording, scenario: Scenario) -> None:
    """Refuse classes of which a recording has none."""
    asked = scenario.objective.classes
    there = [CLASSES[index] for index in np.unique(recording.class_index)]
    if asked is not None and not set(asked) & set(there):
        raise InputError(
            f"{scenario.where('objective', 'classes')}: {', '.join(asked)}: {recording.source} has none; its classes "
            f"are {', '.join(there)}"
        )


def _same_notes(recordings: Sequence[Recording], names: Sequence[str]) -> Iterator[str]:
    """Recordings that are one, as where a path was copied."""
    for number, one in enumerate(recordings):
        for before, name in zip(recordings[:number], names, strict=False):
            if np.array_equal(before.frame, one.frame) and np.array_equal(before.centre_m[:, :2], one.centre_m[:, :2]):
                yield (
                    f"recordings {name} and {names[number]} have the same vehicles in the same places: check their "
                    "paths; one that counts twice makes intervals too narrow"
                )


def _out_of_range(scenario: Scenario, given: Sequence[Mounting], searched: Sequence[Boxes]) -> str | None:
    """A note where many that count are beyond the range gate of every mount that is asked about.

    Raises
    ------
    InputError
        Where no mount of a search could see any, or none of one LiDAR's.
    """
    xy = np.concatenate([frame.centre_m[frame.counted, :2] for frame in searched])
    half = 0.5 * np.concatenate([frame.size_m[frame.counted, 0] for frame in searched])
    beyond = np.ones(len(xy), dtype=bool)
    for number, lidar in enumerate(scenario.lidars):
        own = given[number : number + 1] if scenario.is_layout else given
        mounts, gate = own or lidar.deployment.places, lidar.sensor.range_gate_m
        away = [np.maximum(np.maximum(low[:2] - xy, xy - high[:2]), 0.0) for low, high in map(extent, mounts)]
        too_far = np.min([np.hypot(*off.T) for off in away], axis=0) - half > gate
        beyond &= too_far
        if scenario.is_layout and too_far.all():
            place = "x {:.6g}, y {:.6g} m".format(*(own[0].xy if own else lidar.deployment.nominal_xy))
            raise InputError(
                f"{scenario.where(lidar.table, '')}: LiDAR {lidar.name} at {place} has no box that counts in the "
                f"searched frames within its range gate of {gate:g} m, and can never see any; check [region], "
                "range_gate_m and its place"
            )
    share = beyond.mean()
    if share <= usual.SOME:
        return None
    gate = scenario.range_gate_m
    said = f"{100 * share:.0f} % of the boxes that count in the searched frames lie beyond the range gate of {gate:g} m"
    check = "check [region], [sensor] range_gate_m and [deployment] x_m and y_m"
    if share == 1.0 and not given:
        raise InputError(f"{said} from any mount, and can never be seen; {check}")
    return f"{said} from any mount, and count as missed; {check}"


def lidars_of(scenario: Scenario) -> tuple[Lidar, ...]:
    """What hangs in a scene: beams, range gate and imperfections of each LiDAR."""
    lattices = {lidar.sensor: lattice_of(lidar.sensor) for lidar in scenario.lidars}
    return tuple(
        Lidar(
            lattices[one.sensor],
            one.sensor.range_gate_m,
            lattices[one.sensor].model.range_min_m,
            one.sensor.imperfections,
            one.name,
        )
        for one in scenario.lidars
    )


def observation_of(
    scenario: Scenario,
    caster: str,
    scenery: StandingScenery | None,
    lidars: Sequence[Lidar] | None = None,
    bodies: OwnBodies | None = None,
) -> Observation:
    """How a scene's LiDARs see vehicles; `lidars` are those of `lidars_of`, where they are made already.

    `bodies` are meshes of the user's in place of ours.
    """
    return Observation(
        tuple(lidars or lidars_of(scenario)),
        caster=caster,
        detail=scenario.world.detail,
        cell_m=scenario.objective.cell_m,
        reading=scenario.objective.reading,
        scenery=scenery,
        bodies=bodies,
    )


def scoring_of(scenario: Scenario) -> Scoring:
    """What a scene makes of what is seen."""
    asked = scenario.objective
    return Scoring(asked.threshold, asked.view, asked.loss, asked.reading, asked.metric)


def lattice_of(sensor: SensorSettings) -> BeamLattice:
    """The beams of the unit that a scene names."""
    model = unit_of(with_columns(load_model(sensor.name), sensor.columns), sensor.unit_spread_deg, sensor.unit)
    return beam_lattice(model, sensor.rotation_hz)


def standing_scenery(
    scenario: Scenario,
    caster: str,
    given: Sequence[Mounting] = (),
    more: Scenery | None = None,
    *,
    margin_m: float = 0.0,
) -> StandingScenery | None:
    """What stands still within reach of a scene's mountings and of those given by hand, None without any.

    It is what [world] says, and `more` besides; the reach is `margin_m` longer for a LiDAR that is moved.
    """
    flat = scenario.road_map.surface.is_flat or not scenario.world.ground
    if flat and not scenario.world.has_scenery and (more is None or not len(more)):
        return None
    centre = scenario.nominal_xy
    reach = max(lidar.sensor.range_gate_m + lidar.sensor.imperfections.most_noise_m for lidar in scenario.lidars)
    reach += _travel(scenario, given, centre) + margin_m
    scenery = read_scenery(scenario, reach, given)
    world, clear = scenario.world, _may_hang(scenario, given)
    walkers = Walkers(scenario.road_map, world.clutter, world.clutter_seed, clear) if world.clutter else None
    return StandingScenery(scenery if more is None else join([scenery, more.within(centre, reach)]), caster, walkers)


def read_recording(scenario: Scenario) -> Recording:
    """The traffic that a scene names; several recordings as `traffic.joined_recordings` makes them one."""
    return joined_recordings(read_recordings(scenario), [one.name or "" for one in scenario.recordings])


def read_recordings(scenario: Scenario) -> list[Recording]:
    """The recordings that a scene names, each by itself."""
    read = [_read_one(scenario, number) for number in range(len(scenario.recordings))]
    asked = [number for settings in scenario.recordings for number in settings.leave_out or ()]
    unknown = np.setdiff1d(asked, np.concatenate([one.vehicle_id for one in read]))
    if len(unknown):
        sources = ", ".join(one.source for one in read)
        raise InputError(f"{scenario.where('traffic', 'leave_out')}: {sources} has no vehicle {unknown[0]}")
    each = zip(scenario.recordings, read, strict=True)
    return [_finished(scenario, settings, recording) for settings, recording in each]


def _read_one(scenario: Scenario, number: int) -> Recording:
    settings, world = scenario.recordings[number], scenario.world
    recording = read_settings(settings, scenario.road)
    recording = with_variety(recording, world.variety, world.variety_seed, number)
    if not world.pedestrians and "pedestrian" not in scenario.objective.scored_classes:
        recording = recording.vehicles_alone
    if settings.lanes is not None:
        in_lanes = np.isin(recording.lane, settings.lanes)
        if not in_lanes.any():
            present = ", ".join(map(str, np.unique(recording.lane)))
            raise InputError(f"{recording.source}: no vehicle in lanes {list(settings.lanes)}; its lanes are {present}")
        recording = recording.select(in_lanes)
    return recording


def _finished(scenario: Scenario, settings: TrafficSettings, recording: Recording) -> Recording:
    """A recording without the vehicles that are left out, checked, on the road's surface."""
    if settings.leave_out is not None:
        recording = recording.select(~np.isin(recording.vehicle_id, settings.leave_out))
    return _on_surface(checked_recording(recording, replace(scenario, recordings=(settings,))), scenario.road_map)


def _on_surface(recording: Recording, road: RoadMap) -> Recording:
    """The traffic on a crown or on a map's heights: boxes stand upright on the surface under their centres.

    Half a car's width from there the surface lies up to 0.06 m higher or lower, with the steepest crown of 6 %. Boxes
    that do not stand on the plane z = 0, as surveyed ones, stay where they are; a note says so where that is not on the
    surface. A level map has no heights for them.
    """
    if road.surface.is_flat and not road.lanes:
        return recording
    floor, above = recording.centre_m[:, 2] - 0.5 * recording.size_m[:, 2], road.surface.height(recording.centre_m)
    if (abs(floor) > usual.ON_PLANE_M).mean() <= usual.SOME:
        return replace(recording, centre_m=recording.centre_m + np.outer(above, [0.0, 0.0, 1.0]))
    off = np.median(floor - above)
    if (abs(floor - above) <= usual.ON_PLANE_M).mean() >= usual.MOST:
        return recording
    note = (
        f"the boxes' floors are not at z = 0 but at {np.median(floor):.2f} m (median): they are not lifted to the "
        f"surface of [road], and stand {abs(off):.2f} m {'above' if off > 0.0 else 'below'} it (median)"
    )
    return replace(recording, report=replace(recording.report, notes=(*recording.report.notes, note)))


def frame_of(recording: Recording, frame: int, option: str) -> Boxes:
    """One frame of a recording; an unknown number is refused with the option that gave it."""
    if frame not in recording.frames:
        raise InputError(f"{option}: {unknown_frame(frame, recording)}")
    return recording.at(frame)


def _counted(vehicles, region, reach, objective: ObjectiveSettings, not_counted=()) -> Boxes:
    near = vehicles.select(region.distance(vehicles) <= reach)
    counted = region.holds(near) & of_scored_class(near, objective) & ~np.isin(near.vehicle_id, not_counted)
    return replace(near, counted=counted, weight=vehicle_weights(near, objective))


def _with_ways(frames: Sequence[Boxes], recording: Recording, scenario: Scenario, region: Region) -> tuple[Boxes, ...]:
    """The frames with approach, exit and movement of each vehicle, and the map's lane; none beside a straight road."""
    road = scenario.road_map
    if road.endless:
        return tuple(frames)
    junctions = [scenario.region.junction] if scenario.region.junction else _junctions_in(region, road)
    ways = ways_by_map(recording, road, junctions) if road.lanes else ways_by_track(recording, region.centre_xy)
    return tuple(with_ways(frame, ways, road) for frame in frames)


def _junctions_in(region: Region, road: RoadMap) -> list[str]:
    """The junctions whose middle lies in the circle about a region, or of the approaches that count."""
    leads_to = {row for span in region.spans for row in road.lanes[span].leads_to}
    named = {road.lanes[row].junction for row in leads_to} - {""}
    if named:
        return sorted(named)
    middles = {one.name: 0.5 * (one.outline_m.min(axis=0) + one.outline_m.max(axis=0)) for one in road.junctions}
    return [name for name, xy in middles.items() if math.dist(xy, region.centre_xy) <= region.radius_m]


def _weighted(frames: Sequence[Boxes], recording: np.ndarray, scenario: Scenario) -> tuple[Boxes, ...]:
    """Frames of several recordings, all frames of each counting together as its weight says, however many they are."""
    if not len(frames):
        return ()
    numbers, at, counts = np.unique(recording, return_inverse=True, return_counts=True)
    weights = np.array([scenario.recordings[number].weight for number in numbers])
    factor = (weights / weights.sum() * len(frames) / counts)[at.reshape(-1)]
    if (factor == 1.0).all():
        return tuple(frames)
    return tuple(
        replace(frame, weight=own * (np.ones(len(frame.counted)) if frame.weight is None else frame.weight))
        for frame, own in zip(frames, factor.tolist(), strict=True)
    )


def reach_of(scenario: Scenario, given: Sequence[Mounting] = ()) -> float:
    """How far from the middle of the region vehicles count, or matter to a mounting [m]."""
    region = region_of(scenario.region, scenario.road_map)
    seen = scenario.range_gate_m + _VIEW_SLACK_M + _travel(scenario, given, region.centre_xy)
    return max(seen, region.radius_m)


def _travel(scenario: Scenario, given: Sequence[Mounting], centre: tuple[float, float]) -> float:
    """How far a searched mount, the baseline or a given one may be from a place [m]."""
    corners = np.array([corner for extent in _may_hang(scenario, given) for corner in extent])
    return float(np.abs(corners - centre).max()) * np.sqrt(2.0)
