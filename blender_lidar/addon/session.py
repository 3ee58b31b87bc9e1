"""What the panel works on: the settings of a scene and a LiDAR, its traffic, and frames kept ready, in memory.

Nothing here keeps a reference to a data-block of Blender's: scenes and LiDARs are known by their `session_uid`, which
undo leaves as it is, or by their names where Blender has none.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import bpy

from ..casting import resolve
from ..casting.protocol import StandingScenery
from ..clouds.live import LiveFrame, Look
from ..errors import InputError
from ..scene.observation import CountedFrame, vehicle_weights
from ..scene.region import region_of
from ..scene.scenario import Scenario, load_scenario, scenario_of, shipped_scenes
from ..scene.settings import SensorSettings
from ..scene.site import lattice_of, observation_of, read_recording, scoring_of, standing_scenery
from ..traffic import Recording, Vehicles, instants
from ..traffic.vehicles import unknown_frame
from ..world.blender.objects import is_lidar, lidars
from ..world.blender.site import open_scenery
from . import properties

_EXAMPLE = "i80"
_RECORDINGS: dict[str, tuple[str, Recording]] = {}  # by scene: what it was read with, and the traffic
_OBJECTS: dict[str, tuple[tuple[str, str], StandingScenery]] = {}  # by scene: the user's own
_FRAMES: dict[str, tuple[str, LiveFrame]] = {}  # by LiDAR


def uid_of(block: bpy.types.ID) -> str:
    """What a data-block is known by until the file is closed."""
    return str(getattr(block, "session_uid", 0) or block.name_full)


def active_lidar(scene: bpy.types.Scene) -> bpy.types.Object | None:
    """The LiDAR that the panel speaks of: the active object if it is one, else the one chosen in the list."""
    layer = bpy.context.view_layer if bpy.context.scene == scene else None
    chosen = layer.objects.active if layer is not None else None
    while chosen is not None and not is_lidar(chosen):  # a child of it, such as its cloud
        chosen = chosen.parent
    if chosen is not None and chosen.name in scene.objects:
        return chosen
    named = scene.objects.get(scene.blender_lidar.active)
    return named if is_lidar(named) else next(iter(lidars(scene)), None)


def needed_lidar(scene: bpy.types.Scene) -> bpy.types.Object:
    """The active LiDAR.

    Raises
    ------
    InputError
        Where the scene has none.
    """
    lidar = active_lidar(scene)
    if lidar is None:
        raise InputError("the scene has no LiDAR; add one: Add > LiDAR")
    return lidar


# --- Settings: the panel's fields as a scene -----------------------------------------------------------------------


def tables_of(
    scene: bpy.types.Scene, lidar: bpy.types.Object | None = None, *, searched: bool = False
) -> dict[str, dict[str, object]]:
    """The panel's fields as the tables of a scene file; of a LiDAR its pose is fixed unless it is to be `searched`."""
    group = scene.blender_lidar
    tables = {name: properties.values_of(getattr(group, name), keys) for name, keys in properties.TABLES.items()}
    traffic = tables["traffic"]
    traffic["path"] = bpy.path.abspath(str(traffic.get("path", "")))
    tables["objective"]["metric"] = group.metric
    tables["region"] = group.region.table()
    tables["baseline"] = properties.values_of(group.baseline, properties.SIX)
    if lidar is not None:
        tables["sensor"] = properties.sensor_table(lidar)
        tables["model"]["workers"] = 1  # processes would need a Python of their own with bpy
        tables["deployment"] = properties.deployment_table(lidar, searched=searched)
    return tables


def scenario_from(scene: bpy.types.Scene, lidar: bpy.types.Object | None = None, *, searched: bool = False) -> Scenario:
    """The panel's settings, checked as a scene file's are.

    Raises
    ------
    InputError
        Naming the panel's field; for a scene whose unit is not the metre.
    """
    check_unit(scene)
    return scenario_of(tables_of(scene, lidar, searched=searched), where=properties.where, source=f"scene {scene.name}")


def sensor_of(lidar: bpy.types.Object) -> SensorSettings:
    """The sensor of a LiDAR, whatever else the panel says.

    Raises
    ------
    InputError
        Naming the panel's field.
    """
    tables = {"traffic": {"path": "any"}, "sensor": properties.sensor_table(lidar)}
    return scenario_of(tables, where=properties.where).sensor


def check_unit(scene: bpy.types.Scene) -> None:
    """Refuse a scene whose unit is not the metre."""
    if abs(scene.unit_settings.scale_length - 1.0) > 1e-6:
        given = f"scene {scene.name}: unit scale {scene.unit_settings.scale_length:g}"
        raise InputError(f"{given}; allowed: 1, so that a unit is a metre (Scene properties, Units)")


def fill_scene(scene: bpy.types.Scene, scenario: Scenario) -> None:
    """Set the panel's fields to those of a scene file."""
    group, tables = scene.blender_lidar, scenario.as_tables()
    for name, keys in properties.TABLES.items():
        properties.fill(getattr(group, name), keys, tables[name])
    group.metric, group.source = scenario.objective.metric, scenario.source
    properties.fill(group.baseline, properties.SIX, scenario.baseline)
    region = scenario.region
    if region.centre_m is not None:
        group.region.centre_m = region.centre_m
        group.region.with_gate = region.radius_m == scenario.sensor.range_gate_m
        group.region.radius_m = region.radius_m
    group.schema = properties.SCHEMA


# --- Traffic ----------------------------------------------------------------------------------------------------------


def example_scenario() -> Scenario:
    """The scene that ships with the package."""
    return load_scenario(shipped_scenes()[_EXAMPLE])


def recording_of(scene: bpy.types.Scene) -> Recording:
    """The traffic of a scene, read again where its settings have changed or the file was opened anew.

    Raises
    ------
    BlenderLidarError
        Where none is chosen, or it cannot be read.
    """
    scenario = scenario_from(scene)
    of, key = _read_with(scenario), uid_of(scene)
    if key not in _RECORDINGS or _RECORDINGS[key][0] != of:
        _RECORDINGS[key] = of, read_recording(scenario)
    return _RECORDINGS[key][1]


def keep(scene: bpy.types.Scene, recording: Recording) -> None:
    """Keep traffic that has just been read with the scene's settings."""
    scenario = scenario_from(scene)
    _RECORDINGS[uid_of(scene)] = _read_with(scenario), recording


def _read_with(scenario: Scenario) -> str:
    return repr((scenario.traffic, scenario.road, scenario.region, scenario.world, _stamp(scenario.traffic.path)))


def _stamp(path: str) -> tuple[int, int] | None:
    try:
        status = Path(path).stat()
    except OSError:
        return None
    return status.st_size, status.st_mtime_ns


def vehicles_of(scene: bpy.types.Scene) -> Vehicles:
    """The vehicles of the frame that a scene shows.

    Raises
    ------
    InputError
        For a frame that the recording does not have.
    """
    recording, frame = recording_of(scene), scene.blender_lidar.frame
    if frame not in recording.frames:
        raise unknown_frame(frame, recording)
    return recording.vehicles(frame)


def nearest_frame(recording: Recording, frame: int) -> int:
    """The frame of a recording that is nearest to a number."""
    whole = instants(recording)
    return int(whole[abs(whole - frame).argmin()])


# --- Frames kept ready ------------------------------------------------------------------------------------------------


def live_frame(scene: bpy.types.Scene, lidar: bpy.types.Object) -> LiveFrame:
    """The frame that a scene shows, ready to be seen by one of its LiDARs from anywhere; kept until something changes.

    Raises
    ------
    BlenderLidarError
        For settings, traffic or a frame that cannot be used.
    """
    scenario, vehicles = scenario_from(scene, lidar), vehicles_of(scene)
    unlike = {"deployment", "baseline", "search"}
    tables = {name: table for name, table in scenario.as_tables().items() if name not in unlike}
    of, key = repr((tables, vehicles.frame, _stamp(scenario.traffic.path))), uid_of(lidar)
    if key not in _FRAMES or _FRAMES[key][0] != of:
        _FRAMES[key] = of, _made_ready(scenario, vehicles)
    return _FRAMES[key][1]


def _made_ready(scenario: Scenario, vehicles: Vehicles) -> LiveFrame:
    caster, region = resolve(scenario.model.caster, "caster"), region_of(scenario.region, scenario.road.carriageway_y)
    frame = CountedFrame(vehicles, region.holds(vehicles), vehicle_weights(vehicles, scenario.objective))
    scenery = standing_scenery(scenario, caster, None)
    observation = observation_of(scenario, lattice_of(scenario.sensor), caster, scenery)
    scoring = scoring_of(scenario) if frame.counted.any() else None
    return LiveFrame(frame, observation, scoring, ground=scenario.world.ground)


def exact_objects(scene: bpy.types.Scene, layer: bpy.types.ViewLayer, scenario: Scenario) -> list[StandingScenery]:
    """The visible objects of the user's as exact triangles, for `LiveFrame.look`; made ready once while they stay.

    Raises
    ------
    InputError
        For a vertex that is not finite.
    """
    scenery, caster, key = open_scenery(scene, layer), resolve(scenario.model.caster, "caster"), uid_of(scene)
    of = caster, scenery.digest
    if key not in _OBJECTS or _OBJECTS[key][0] != of:
        _OBJECTS[key] = of, StandingScenery(scenery, caster)
    return [_OBJECTS[key][1]] if len(scenery) else []


def store(lidar: bpy.types.Object, vehicles: Vehicles, place: Mapping[str, float], look: Look, baseline: Look) -> None:
    """Keep with a LiDAR what the panel says of a scan: its size and score, and the baseline's."""
    group = lidar.lidar
    group.points, group.scanned_frame, group.scanned_at = len(look.cloud), vehicles.frame, list(place.values())
    group.vehicles = 0 if look.scored is None else look.scored.values.shape[1]
    for scored, objective, share in (
        (look.scored, "objective", "detectable_share"),
        (baseline.scored, "baseline_objective", "baseline_share"),
    ):
        setattr(group, objective, 0.0 if scored is None else float(scored.objective.sum()))
        setattr(group, share, 0.0 if scored is None else float(scored.detectable.mean()))


def forget(scene: bpy.types.Scene | None = None) -> None:
    """Let go of what is kept, of one scene or of all."""
    if scene is None:
        _RECORDINGS.clear()
        _FRAMES.clear()
        _OBJECTS.clear()
    else:
        _RECORDINGS.pop(uid_of(scene), None)
