"""What the panel works on: the settings of a scene and a LiDAR, its traffic, and frames kept ready, in memory.

Nothing here keeps a reference to a data-block of Blender's: scenes and LiDARs are known by their `session_uid`, which
undo leaves as it is, or by their names where Blender has none.
"""

from __future__ import annotations

import hashlib
import json
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import Any

import bpy

from ..casting import resolve
from ..casting.instances import OwnBodies
from ..casting.protocol import StandingScenery
from ..clouds.live import DRAG_M, FusedScores, LiveFrame, Look
from ..errors import InputError
from ..files import read_file
from ..names import METRIC_NAMES
from ..plugins import is_plugin, located, plugin_file
from ..scene.lidars import OF_ANY_MODEL
from ..scene.mounting import ANGLES, LEANS, MOUNTED, PLACE, Mounting, mounting_from
from ..scene.observation import CountedFrame, of_scored_class, vehicle_weights
from ..scene.region import region_of
from ..scene.scenario import Scenario, scenario_of, shipped_scenes
from ..scene.settings import DATASHEET, GATE, SensorSettings, is_sensor_file
from ..scene.site import observation_of, read_recordings, scoring_of, standing_scenery
from ..sensors.model import model_names
from ..traffic import Recording, Vehicles, joined_recordings
from ..traffic.vehicles import FLEET_KINDS, SAME_S, no_vehicles
from ..world.blender.bodies import OwnBody, body_of, kept_body
from ..world.blender.objects import holds, is_lidar, is_shown
from ..world.blender.road import hidden_ground, road_collection
from ..world.blender.site import open_scenery
from ..world.blender.traffic import show_recording, starts_at, traffic_object
from . import properties

CLIP = "i80_sample.csv.gz", "i80_drive.csv.gz"  # what is searched, and 20 s of the same that are played
_SAME_FRAME = 1e-3  # of the timeline
_DIGITS_S = 6
_OF_SEARCH = ("frames", "holdout", "block_s")  # fields of [traffic] that one scan does not depend on
_SAME_M, _SAME_ROTATION = 2e-4, 1e-5  # nearer, a LiDAR hangs as it was hung
_RECORDINGS: dict[str, tuple[str, list[Recording], Recording]] = {}  # by scene: what they were read with, and as one
_OBJECTS: dict[str, tuple[tuple[str, str], StandingScenery]] = {}  # by scene: the user's own
_BODIES: dict[str, tuple[object, dict[str, OwnBody], OwnBodies | None]] = {}  # by scene: vehicles' bodies of their own
_FRAMES: dict[str, tuple[str, str, Mounting, LiveFrame]] = {}  # by LiDAR: what and where it was made for
_TRUSTED: set[tuple[Path, bytes]] = set()  # Python files with their content, in this session
_REFUSED: list[Path] = []  # the one that was refused last
_FUSED: dict[str, tuple[list[LiveFrame], FusedScores | None]] = {}  # by scene: of the LiDARs that hang together


NO_TRAFFIC = "no traffic"  # in place of its path, where a scene has none


def uid_of(block: bpy.types.ID) -> str:
    """What a data-block is known by until the file is closed."""
    return str(getattr(block, "session_uid", 0) or block.name_full)


def view_layer_of(scene: bpy.types.Scene) -> bpy.types.ViewLayer:
    """The view layer in use, or a scene's first where another scene is."""
    return bpy.context.view_layer if bpy.context.scene == scene else scene.view_layers[0]


def has_road(scene: bpy.types.Scene) -> bool:
    """Whether LiDARs hang beside a road: traffic is loaded, or a road stands there as in a file of `build`."""
    return scene.blender_lidar.loaded or road_collection(scene) is not None


def active_lidar(scene: bpy.types.Scene) -> bpy.types.Object | None:
    """The LiDAR that the panel speaks of: the active object if it is one, else the one chosen in the list."""
    layer = bpy.context.view_layer if bpy.context.scene == scene else None
    chosen = layer.objects.active if layer is not None else None
    while chosen is not None and not is_lidar(chosen):  # a child of it, such as its cloud
        chosen = chosen.parent
    if chosen is not None and holds(scene, chosen):
        return chosen
    kept = scene.blender_lidar.active
    return kept if is_lidar(kept) and holds(scene, kept) else next(iter(lidars_of(scene)), None)


def lidars_of(scene: bpy.types.Scene) -> list[bpy.types.Object]:
    """The LiDARs of a scene, by name, as handlers keep them: those that have left it since are passed over."""
    kept = {row.lidar for row in scene.blender_lidar.lidars} - {None}
    return sorted((one for one in kept if is_lidar(one) and holds(scene, one)), key=lambda one: one.name_full)


def keep_lidars(scene: bpy.types.Scene, found: Iterable[bpy.types.Object]) -> None:
    """Keep which LiDARs a scene has, and let go of deleted ones; nothing is written where they are known."""
    group, found = scene.blender_lidar, set(found)
    before = {row.lidar for row in group.lidars}
    if before != found or len(group.lidars) != len(found):
        group.lidars.clear()
        for one in found:
            group.lidars.add().lidar = one
        group.active = group.active if group.active in found else None
        bpy.data.batch_remove([one for one in before - found if one is not None and one.users == 0])


def select(context: bpy.types.Context, lidar: bpy.types.Object) -> None:
    """Select a LiDAR alone and make it active, so that G moves it."""
    context.view_layer.update()  # which may not know a new one yet
    try:
        lidar.hide_set(False)
    except RuntimeError:  # it is in no collection of this view layer
        return properties.tell(context.scene, f"LiDAR {lidar.name}: is in no collection of this view layer")
    for item in context.selected_objects:
        item.select_set(False)
    context.view_layer.objects.active = lidar
    lidar.select_set(True)


# --- Settings: a scene file, and the panel's fields as changes to it --------------------------------------------------


def fields_of(scene: bpy.types.Scene) -> dict[str, dict[str, object]]:
    """What the panel's fields say of a scene, as the tables of a scene file."""
    group = scene.blender_lidar
    tables = {name: properties.values_of(getattr(group, name), keys) for name, keys in properties.TABLES.items()}
    path = str(tables["traffic"].get("path", "")) or ("" if group.loaded else NO_TRAFFIC)
    tables["traffic"]["path"] = _shipped(bpy.path.abspath(path))
    if group.metric in METRIC_NAMES:
        tables["objective"]["metric"] = group.metric
    tables["region"] = group.region.table()
    return tables


def _shipped(path: str) -> str:
    """A path, in the scenes of this add-on where it was one in an older add-on's that is gone."""
    there, here = Path(path), shipped_scenes()["i80"].parent
    gone = path and not there.exists()
    if gone and there.name == here.name:
        return str(here)
    if gone and there.parent.name == here.name and (here / there.name).exists():
        return str(here / there.name)
    return path


def python_files(tables: object, folder: str) -> list[Path]:
    """The Python files that a scene's tables name as metric or search, FILE.py:NAME."""
    if is_plugin(tables):
        return [plugin_file(located(str(tables), Path(folder)))]
    parts = tables.values() if isinstance(tables, Mapping) else tables if isinstance(tables, list | tuple) else ()
    return [path for part in parts for path in python_files(part, folder)]


def trust(path: Path) -> None:
    """Let a Python file run, as it is now, until Blender ends."""
    _TRUSTED.add((path, read_file(path)))


def untrusted(scene: bpy.types.Scene) -> list[Path]:
    """The Python files that a scene, or the scene file that was refused last, would run and that nobody has allowed."""
    kept = properties.kept_of(scene.blender_lidar)
    files = dict.fromkeys([*python_files(kept.tables, kept.folder), *_REFUSED])
    return [path for path in files if path.is_file() and (path, path.read_bytes()) not in _TRUSTED]


def check_trusted(tables: Mapping[str, Any], folder: str) -> None:
    """Refuse tables that name a Python file that nobody has allowed to run."""
    for path in python_files(tables, folder):
        if path.is_file() and (path, path.read_bytes()) not in _TRUSTED:
            _REFUSED[:] = [path]
            raise InputError(
                f"{path}: is Python code that the scene runs; allowed after Run {path.name} in the LiDAR tab"
            )


def scenario_from(scene: bpy.types.Scene, lidar: bpy.types.Object | None = None, *, here: bool = True) -> Scenario:
    """The scene of one LiDAR alone, which keeps the name that it has in its layout; as `layout_scenario`."""
    hung = [] if lidar is None else layout_of(scene, lidar)
    return layout_scenario(scene, hung, here=here).alone(hung.index(lidar) if hung else 0)


def layout_of(scene: bpy.types.Scene, lidar: bpy.types.Object) -> list[bpy.types.Object]:
    """The LiDARs of the layout that a LiDAR is in, in the order of their file; itself where it is in none."""
    together = (
        [one for one in lidars_of(scene) if one.blender_lidar.in_layout] if lidar.blender_lidar.in_layout else [lidar]
    )
    return sorted(together, key=lambda one: one.blender_lidar.number)


def layout_scenario(
    scene: bpy.types.Scene, hung: list[bpy.types.Object], *, here: bool = True, held: Sequence[bpy.types.Object] = ()
) -> Scenario:
    """The scene that is scanned, scored, exported and optimised: the scene file's settings, changed as the panel says.

    Parameters
    ----------
    scene : Scene
    hung : sequence of Object
        Whose sensors, mountings and bounds are the scene's: none, a LiDAR, or those of a layout, as [[lidar]].
    here : bool
        Whether this process casts: others would need a Python of their own with bpy.
    held : sequence of Object
        Those of them that are not searched but stay as they hang.

    Raises
    ------
    InputError
        Naming the panel's field, or the place in the scene file; for a scene whose unit is not the metre.
    """
    check_unit(scene)
    kept = properties.kept_of(scene.blender_lidar)
    tables, changes = dict(kept.tables), properties.changed(kept, fields_of(scene))
    free = {"x_m": 0.0, "y_m": 0.0}  # without a road nothing is asked of where they hang
    entries = [deployment_table(one, held=one in held) if has_road(scene) else dict(free) for one in hung]
    named = any(one.blender_lidar.in_layout for one in hung)
    if road_collection(scene) is None or hidden_ground(scene, view_layer_of(scene)):
        changes["world", "ground"] = False, "what the scene shows"
    baselines = [json.loads(one.blender_lidar.baseline or "{}") for one in hung]
    baselines = [{key: table[key] for key in MOUNTED if key in table} for table in baselines]
    if named:
        shared = {key: value for key, value in fields_of(scene)["baseline"].items() if key not in ("x_m", "y_m")}
        tables |= {"baseline": {}, "sensor": _sensors_of(hung)}
        for one, entry, own in zip(hung, entries, baselines, strict=True):
            entry["name"] = re.sub(r"[^\w-]", "_", one.name_full)  # less what no name in a scene file has
            entry |= {"sensor": sensor_of(one).name, "baseline": own or shared}
    elif hung:
        own, changes_of_sensor = _sensor_of(hung[0])
        tables |= {**own, "baseline": baselines[0] or tables.get("baseline", {})}
        changes |= changes_of_sensor
    elif any(tables.get("road", {}).get(key) for key in ("net", "opendrive")):
        tables["deployment"] = {"x_m": 0.0, "y_m": 0.0}  # a map has no place of its own for a mast that is not there
    if named or any(baselines):  # its own is in force
        changes = {place: change for place, change in changes.items() if place[0] != "baseline"}
    own_metric = {} if ("objective", "metric") in changes else tables.get("objective", {})
    check_trusted({**tables, "objective": own_metric}, kept.folder)
    if here:
        changes["model", "workers"] = 1, "the add-on"
    where = partial(_where, scene.blender_lidar.source if kept.tables else "", [one.name for one in hung])
    made = partial(
        scenario_of, where=where, source=f"scene {scene.name}", folder=Path(_shipped(kept.folder)), overrides=changes
    )
    tables |= {"lidar": entries} if named else {"deployment": entries[0]} if hung else {}
    scenario, moved = made(tables), False
    for one, entry, of in zip(hung, entries, scenario.lidars, strict=False):
        towards = properties.kept_of(one.blender_lidar).tables.get("mast", {}).get("towards")
        if towards is not None and of.deployment.middle_xy != tuple(towards) and not of.deployment.poles:
            entry["facing_deg"] = properties.mounting_of(one).as_table()["facing_deg"]
            moved = True  # the region was, since the LiDAR was loaded; its mast was not turned
    return made(tables) if moved else scenario


def _sensors_of(hung):
    """[sensor] of a layout: what all share, and a table for each model; a layout has one value of each setting."""
    shared, models = {}, {}
    for one in hung:
        sensor = asdict(sensor_of(one))
        model = sensor.pop("name")
        for key, value in sensor.items():
            of = shared if key in OF_ANY_MODEL else models.setdefault(model, {})
            if of.setdefault(key, value) != value:
                said = f"LiDAR {one.name}, {properties.label_of(key)}: is {value}, but {of[key]} of another"
                allowed = "the same for all" if of is shared else f"the same for all {model}"
                raise InputError(f"{said} in the layout; allowed: {allowed}")
    return {"name": next(iter(models)), **shared, **models}


def _sensor_of(lidar):
    """[sensor] of a LiDAR as its file has it, and what its fields change of that."""
    kept = properties.kept_of(lidar.blender_lidar)
    changes = properties.changed(kept, {"sensor": sensor_table(lidar)})
    return {"sensor": kept.tables.get("sensor", {})}, changes


def _where(source: str, names: Sequence[str], table: str, key: str) -> str:
    """What an error calls a setting: the panel's field, or the place in the scene file where the panel has none."""
    if table.startswith("lidar "):
        of = f"LiDAR {names[int(table.split()[1]) - 1]}"
        return f"LiDAR panel: {of}{f', {properties.label_of(key)}' if key else ''}"
    has_field = table in ("sensor", "deployment", "baseline") or key in properties.TABLES.get(table, ())
    return properties.where(table, key) if has_field or not source else f"{source}: [{table}] {key}".rstrip()


def sensor_of(lidar: bpy.types.Object) -> SensorSettings:
    """The sensor of a LiDAR alone, without the rest of the panel.

    Raises
    ------
    InputError
        Naming the panel's field.
    """
    tables, changes = _sensor_of(lidar)
    return scenario_of({"traffic": {"path": "any"}, **tables}, where=properties.where, overrides=changes).sensor


def check_unit(scene: bpy.types.Scene) -> None:
    """Refuse a scene whose unit is not the metre."""
    if abs(scene.unit_settings.scale_length - 1.0) > 1e-6:
        given = f"scene {scene.name}: unit scale {scene.unit_settings.scale_length:g}"
        raise InputError(f"{given}; allowed: 1, so that a unit is a metre (Scene properties, Units)")


def fill_scene(scene: bpy.types.Scene, tables: Mapping[str, Any], folder: str, scenario: Scenario) -> None:
    """Set the panel's fields to a scene file's settings, and keep its `tables` for all that has no field.

    What such a file leaves open because of its sensor and mounting, region and baseline, is kept as it came out.
    """
    group, found = scene.blender_lidar, scenario.as_tables()
    for name, keys in properties.TABLES.items():
        properties.fill(getattr(group, name), keys, found.get(name) or scenario.baseline.as_table())
    group.source, metric = scenario.source, scenario.objective.metric
    group.metric = metric if metric in METRIC_NAMES else properties.OWN
    region, own = scenario.region, dict(tables.get("region", {}))
    if region.centre_m is not None:
        group.region.with_gate = own.get("radius_m") == GATE
        group.region.centre_m, group.region.radius_m = region.centre_m, region.radius_m
        own |= {"centre_m": region.centre_m, "radius_m": GATE if group.region.with_gate else region.radius_m}
    kept = {name: table for name, table in tables.items() if name not in ("sensor", "deployment", "lidar")}
    kept["world"] = {key: value for key, value in kept.get("world", {}).items() if key != "vehicles"}  # which are here:
    for kind in FLEET_KINDS:
        if of := scenario.world.bodies.get(kind):  # where it names none those of the window stay
            setattr(group.vehicles, kind, kept_body(*of, f"{scenario.where('world', 'vehicles')} {kind}"))
    kept |= {"region": own, "baseline": found.get("baseline", {}), "road": found["road"]}
    properties.keep_tables(group, kept, folder, fields_of(scene))
    group.schema = properties.SCHEMA


def without_field(scene: bpy.types.Scene, lidar: bpy.types.Object | None) -> list[str]:
    """What is kept of the scene file and has no field in the panel, a line for each table."""
    tables = {**properties.kept_of(scene.blender_lidar).tables}
    if lidar is not None:
        tables["sensor"] = properties.kept_of(lidar.blender_lidar).tables.get("sensor", {})
    shown = {**properties.TABLES, "sensor": ("name", *properties.SENSOR), "region": ("centre_m", "radius_m")}
    lines = []
    for name, table in tables.items():
        if isinstance(table, list):
            lines.append(f"[{name}] {len(table)} recordings")
            table = {key: value for one in table for key, value in one.items()}
        fields = (*shown.get(name, ()), *(("metric",) if name == "objective" else ()))
        keys = [key for key, value in table.items() if key not in fields and value not in (None, [], {})]
        if keys:
            lines.append(f"[{name}] {', '.join(keys)}")
    return lines


def sensor_table(lidar: bpy.types.Object) -> dict[str, object]:
    """What a LiDAR's fields say of [sensor]."""
    group = lidar.blender_lidar
    name = bpy.path.abspath(group.table_path) if group.name_ == properties.OWN else group.name_
    table = {"name": name, **properties.values_of(group, properties.SENSOR)}
    if group.datasheet:
        table |= {"range_noise_m": DATASHEET, "range_at_10_percent_m": DATASHEET}
    return table


def show_model(lidar: bpy.types.Object) -> None:
    """Let the fields of [sensor] that were not changed be those of the LiDAR's model, as its scene file has them."""
    group, kept = lidar.blender_lidar, properties.kept_of(lidar.blender_lidar)
    then, now = kept.fields.get("sensor", {}), sensor_table(lidar)
    same = {key: of for key, of in properties.SENSOR.items() if key in then and now.get(key) == then[key]}
    with properties.silently():
        properties.fill(group, same, asdict(sensor_of(lidar)))
    shown = {key: value for key, value in sensor_table(lidar).items() if key in same}
    properties.keep_tables(group, kept.tables, kept.folder, {**kept.fields, "sensor": then | shown})


def fill_lidar(lidar, tables: Mapping[str, Mapping], folder: str, scenario: Scenario, number: int = 0) -> None:
    """Set a LiDAR's fields to what one of a scene has and searches, and keep [sensor] as the `tables` of it say."""
    group, scenario = lidar.blender_lidar, scenario.alone(number)
    sensor, deployment = asdict(scenario.sensor), scenario.deployment.as_table()
    group.in_layout, group.number = bool(scenario.lidar_name), number
    if sensor["name"] in model_names():
        group.name_ = sensor["name"]
    else:
        group.name_, group.table_path = properties.OWN, str(Path(sensor["name"]).resolve())
    properties.fill(group, properties.SENSOR, sensor)
    group.poles = str(Path(deployment.pop("poles")).resolve()) if scenario.deployment.poles else ""
    for key in properties.SEARCHABLE:
        bounds, scale = deployment.get(key), math.radians(1.0) if key.endswith("_deg") else 1.0
        searched = isinstance(bounds, list | tuple)
        setattr(group, f"{key}_on", searched)
        for end, value in zip(("low", "high"), bounds if searched else (), strict=False):
            setattr(group, f"{key}_{end}", scale * value)
    own = tables.get("sensor", {})
    own = {str(Path(folder, key).resolve()) if is_sensor_file(key) else key: value for key, value in own.items()}
    fields = {"sensor": sensor_table(lidar), "deployment": _bounds_of(group)}
    own["name"] = fields["sensor"]["name"]  # with its whole path
    towards = scenario.deployment.places[0].towards  # where masts on a map face unless the file says it
    mast = {} if towards is None else {"towards": list(towards)}
    properties.keep_tables(group, {"sensor": own, "deployment": deployment, "mast": mast}, folder, fields)
    group.baseline = json.dumps(scenario.baseline.as_table()) if group.in_layout else ""
    group.schema = properties.SCHEMA


def _bounds_of(group: bpy.types.PropertyGroup) -> dict[str, list[float]]:
    """Between what bounds a LiDAR's rows that are on have it searched [m, degrees]."""
    on = [key for key in properties.SEARCHABLE if getattr(group, f"{key}_on")]
    return {key: [properties.exact(getattr(group, f"{key}_{end}"), key) for end in ("low", "high")] for key in on}


def deployment_table(lidar: bpy.types.Object, *, held: bool = False) -> dict[str, object]:
    """[deployment] of a LiDAR: where it hangs, and the bounds of the rows that are on, none where it is held there.

    A coordinate that is as the scene file had it keeps the file's number, which has more digits than Blender holds.
    """
    group, mounting, kept = lidar.blender_lidar, properties.mounting_of(lidar), properties.kept_of(lidar.blender_lidar)
    place, road = mounting.as_table(), properties.road_of(properties.scene_of(lidar))
    filed, filled = (of.get("deployment", {}) for of in (kept.tables, kept.fields))
    bounds = {} if held else _bounds_of(group)
    fixed = {key: value for key, value in filed.items() if isinstance(value, float) and key not in bounds}
    leans = bounds.keys() & set(LEANS) or ("lean_deg" in filed and not bounds.keys() & set(ANGLES))
    turn = {key: place[key] or 0.0 for key in (LEANS if leans else ANGLES)}
    as_filed = {key: fixed.get(key, value) for key, value in turn.items()}
    table = {key: value for key, value in filed.items() if key not in properties.SEARCHABLE}
    table |= {key: place[key] for key in PLACE}
    table |= {key: fixed[key] for key in table if key in fixed and abs(fixed[key] - table[key]) < _SAME_M}
    now, then = (mounting_from(angles, road, mounting).pose.rotation for angles in (turn, as_filed))
    table |= as_filed if abs(now - then).max() < _SAME_ROTATION else turn
    table |= {key: filed[key] if pair == filled.get(key) else pair for key, pair in bounds.items()}
    if held:
        table["facing_deg"] = place["facing_deg"]  # also of a mast that faces as its pole or the road says
    elif group.poles:
        table = {key: value for key, value in table.items() if key not in ("x_m", "y_m") or key in bounds}
        table["poles"] = bpy.path.abspath(group.poles)
    return table


# --- Traffic ----------------------------------------------------------------------------------------------------------


def recordings_of(scene: bpy.types.Scene) -> list[Recording]:
    """The recordings that are searched, read again where settings have changed or the file was opened again.

    Raises
    ------
    BlenderLidarError
        Where none is chosen, or one cannot be read.
    """
    scenario = scenario_from(scene)
    return _read(scene, scenario, searched=with_clip(scenario, scene.blender_lidar.clip) is not scenario)[0]


def recording_of(scene: bpy.types.Scene) -> Recording:
    """The traffic that the timeline plays, as one recording; read again like `recordings_of`."""
    return _read(scene, with_clip(scenario_from(scene), scene.blender_lidar.clip))[1]


def with_clip(scenario: Scenario, clip: bool) -> Scenario:
    """Settings with the traffic that the timeline plays, in the example, with `clip`, the 20 s beside its own."""
    path = Path(scenario.traffic.path)
    if not clip or path.name != CLIP[0]:
        return scenario
    return replace(scenario, traffic=replace(scenario.traffic, path=str(path.with_name(CLIP[1]))))


def _read(scene, scenario, *, searched=False):
    key, of = f"{uid_of(scene)}{' searched' if searched else ''}", _read_with(scenario)
    if key not in _RECORDINGS or _RECORDINGS[key][0] != of:
        _keep(key, scenario, read_recordings(scenario))
        if not searched:
            show_traffic(scene, again=True)
    return _RECORDINGS[key][1:]


def keep(scene: bpy.types.Scene, recordings: list[Recording]) -> Recording:
    """Keep the traffic that the timeline plays, which has just been read; returns it as one recording."""
    return _keep(uid_of(scene), with_clip(scenario_from(scene), scene.blender_lidar.clip), recordings)


def _keep(key, scenario, recordings):
    joined = joined_recordings(recordings, [one.name or "" for one in scenario.recordings])
    _RECORDINGS[key] = _read_with(scenario), recordings, joined
    return joined


def _read_with(scenario: Scenario) -> str:
    stamps, world = [stamp(one.path) for one in scenario.recordings], replace(scenario.world, ground=True)
    return repr((scenario.recordings, scenario.road, scenario.region, world, stamps))


def stamp(path: str) -> tuple[int, int] | None:
    try:
        status = Path(path).stat()
    except OSError:
        return None
    return status.st_size, status.st_mtime_ns


# --- The clock: the timeline ------------------------------------------------------------------------------------------


def seconds_of(scene: bpy.types.Scene) -> float:
    """The time that a scene's timeline shows [s], as the node *Scene Time* has it."""
    return scene.frame_current_final * scene.render.fps_base / scene.render.fps


def since_of(scene: bpy.types.Scene) -> float:
    """The time since the recording's first instant that the timeline shows [s]."""
    return round(seconds_of(scene) - scene.blender_lidar.starts_s, _DIGITS_S) + 0.0


def vehicles_of(scene: bpy.types.Scene) -> Vehicles:
    """The vehicles at the timeline's time: a recorded instant's, or between two; none in a gap, or without traffic.

    There are none either where the object that shows them was hidden or deleted.

    Raises
    ------
    BlenderLidarError
        Where the traffic cannot be read.
    """
    if not scene.blender_lidar.loaded:
        return no_vehicles(shown_frame(scene), seconds_of(scene))
    found = recording_of(scene).moment(since_of(scene))
    return found if is_traffic_shown(scene) else found.select([])


def is_traffic_shown(scene: bpy.types.Scene) -> bool:
    """Whether a scene shows its vehicles, in views and in renders."""
    item = traffic_object(scene)
    return item is not None and is_shown(scene, view_layer_of(scene), item)


def check_traffic_is_shown(scene: bpy.types.Scene) -> None:
    """Refuse to search or judge traffic that is not shown."""
    if not is_traffic_shown(scene):
        what = "deleted; Load brings it back" if traffic_object(scene) is None else "hidden; show it"
        raise InputError(f"Vehicles: the traffic was {what}: what is not shown is not scanned")


def show_traffic(scene: bpy.types.Scene, *, again: bool = False) -> None:
    """Let what shows the traffic have that of the timeline's time; `again` where anything but the time has changed.

    Raises
    ------
    BlenderLidarError
        Where the traffic cannot be read.
    """
    group, item = scene.blender_lidar, traffic_object(scene)
    if item is not None and (again or not starts_at(item, since_of(scene), group.starts_s)):
        place = group.world.detail, since_of(scene), group.starts_s
        show_recording(scene, recording_of(scene), *place, bodies_shown(scene))


def shown_frame(scene: bpy.types.Scene) -> int:
    """Number of the instant nearest to the timeline; of traffic that has not been read yet the last one known.

    Without traffic that of the timeline's frame.
    """
    group = scene.blender_lidar
    if not group.loaded:
        return max(scene.frame_current, 0)
    if uid_of(scene) in _RECORDINGS:
        return _RECORDINGS[uid_of(scene)][-1].moment(since_of(scene)).frame
    return group.known_frame


def show_frame(scene: bpy.types.Scene, frame: int) -> None:
    """Move the timeline to the recorded instant whose number is nearest.

    Raises
    ------
    BlenderLidarError
        Where the traffic cannot be read.
    """
    group = scene.blender_lidar
    if group.loaded:
        recording = recording_of(scene)
        at = abs(recording.frames - frame).argmin()
        number = (group.starts_s + recording.since_s[at]) * scene.render.fps / scene.render.fps_base
        whole = math.floor(number + _SAME_FRAME)
        scene.frame_set(whole, subframe=max(number - whole, 0.0))
        frame = int(recording.frames[at])
    group.known_frame = frame


def start_clock(scene: bpy.types.Scene, recording: Recording, frame: int) -> None:
    """Let the timeline's present time be that of the instant of a recording whose number is nearest."""
    at = abs(recording.frames - frame).argmin()
    with properties.silently():
        scene.blender_lidar.starts_s = seconds_of(scene) - recording.since_s[at]
    scene.blender_lidar.known_frame = int(recording.frames[at])


def time_text(scene: bpy.types.Scene) -> str:
    """What the panel says of the timeline's time: whether an instant is there, or any traffic."""
    since_s = since_of(scene)
    text = f"At {since_s:.2f} s"
    if uid_of(scene) not in _RECORDINGS:
        return text
    recording = _RECORDINGS[uid_of(scene)][-1]
    if abs(recording.since_s - since_s).min() <= SAME_S:
        return text
    return f"{text}, {'between instants' if len(recording.moment(since_s)) else 'no traffic at this time'}"


# --- Frames kept ready ------------------------------------------------------------------------------------------------


def live_frame(
    scene: bpy.types.Scene,
    lidar: bpy.types.Object,
    *,
    exact: bool = False,
    bodies: OwnBodies | None = None,
    depsgraph: bpy.types.Depsgraph | None = None,
) -> LiveFrame:
    """The frame that a scene shows, ready to be seen by one of its LiDARs; kept until something changes.

    It is ready for wherever the LiDAR is dragged within 60 m; `exact` has clutter kept clear of where it hangs now,
    and own bodies read again unless they are given. With a `depsgraph` LiDARs hang as that has evaluated them.

    Raises
    ------
    BlenderLidarError
        For settings, traffic or a frame that cannot be used.
    """
    hung, vehicles, key = layout_of(scene, lidar), vehicles_of(scene), uid_of(lidar)
    bodies = bodies or own_bodies(scene, again=exact)
    whole, layout = layout_scenario(scene, hung), [properties.mounting_of(one, depsgraph=depsgraph) for one in hung]
    scenario, mounting = whole.alone(hung.index(lidar)), layout[hung.index(lidar)]
    tables, stamps = scenario.as_tables(), [stamp(path) for path in scenario.files.values()]
    tables = {name: tables[name] for name in tables if name not in ("deployment", "search", "lidar")}
    of = repr((tables, scenario.lidar_name, bodies and bodies.digests, moment_key(vehicles), stamps))
    about = repr((layout, [one.deployment for one in whole.lidars])) if exact and scenario.world.clutter else ""
    before = _FRAMES.get(key)
    if before is None or before[0] != of or (about and before[1] != about) or dragged_off(lidar, mounting):
        _FRAMES[key] = of, about, mounting, _made_ready(scenario, vehicles, whole, layout, bodies)
    return _FRAMES[key][-1]


def moment_key(vehicles: Vehicles) -> tuple[int, float, int]:
    """What tells moments of a recording apart."""
    return vehicles.frame, vehicles.time_s, len(vehicles)


def dragged_off(lidar: bpy.types.Object, mounting: Mounting) -> bool:
    """Whether a LiDAR is so far from where its frame was made ready that scenery and crown may end too soon."""
    before = _FRAMES.get(uid_of(lidar))
    return before is not None and any(
        abs(now - then) > DRAG_M for now, then in zip(mounting.xy, before[2].xy, strict=True)
    )


def _made_ready(scenario: Scenario, vehicles: Vehicles, whole: Scenario, layout: list[Mounting], bodies) -> LiveFrame:
    caster, region = resolve(scenario.model.caster, "caster"), region_of(scenario.region, scenario.road_map)
    counted = region.holds(vehicles) & of_scored_class(vehicles, scenario.objective)
    frame = CountedFrame(vehicles, counted, vehicle_weights(vehicles, scenario.objective))
    scenery = standing_scenery(whole, caster, layout, margin_m=2.0 * DRAG_M)
    observation = observation_of(scenario, caster, scenery, bodies=bodies)
    scoring = scoring_of(scenario) if frame.counted.any() else None
    return LiveFrame(frame, observation, scoring, ground=scenario.plane_returns)


def bodies_shown(scene: bpy.types.Scene, *, again: bool = False) -> dict[str, OwnBody]:
    """Vehicles' bodies of the user's own by kind, as their collections were last; as they are now if read `again`.

    Raises
    ------
    InputError
        For a collection that is no body.
    """
    chosen, key = chosen_bodies(scene), uid_of(scene)
    uids, before = {kind: uid_of(of) for kind, of in chosen.items()}, _BODIES.get(key)
    if before is None or again or before[0] != uids:
        found = {kind: body_of(of, properties.where("vehicles", kind)) for kind, of in chosen.items()}
        own = OwnBodies({kind: body.shape for kind, body in found.items()}) if found else None
        if before and before[2] and own and before[2].digests == own.digests:
            own = before[2]  # with its trees
        _BODIES[key] = uids, found, own
        if before and before[2] is not own:
            show_traffic(scene, again=True)
    return _BODIES[key][1]


def chosen_bodies(scene: bpy.types.Scene) -> dict[str, bpy.types.Collection]:
    """The collections that stand for vehicles, by kind."""
    group = scene.blender_lidar.vehicles
    return {kind: of for kind in FLEET_KINDS if (of := getattr(group, kind)) is not None}


def own_bodies(scene: bpy.types.Scene, *, again: bool = False) -> OwnBodies | None:
    """The meshes of `bodies_shown`, None without any, ready to be cast against."""
    bodies_shown(scene, again=again)
    return _BODIES[uid_of(scene)][2]


def exact_objects(scene: bpy.types.Scene, layer: bpy.types.ViewLayer, scenario: Scenario) -> list[StandingScenery]:
    """The visible objects of the user's as exact triangles, for `LiveFrame.look`; made ready once while they stay.

    Raises
    ------
    InputError
        For a vertex that is not finite.
    """
    scenery, caster, key = open_scenery(scene, layer), resolve(scenario.model.caster, "caster"), uid_of(scene)
    of = caster, scenery.digest, scenery.label.tobytes(), scenery.labels
    if key not in _OBJECTS or _OBJECTS[key][0] != of:
        _OBJECTS[key] = of, StandingScenery(scenery, caster)
    return [_OBJECTS[key][1]] if len(scenery) else []


def settings_digest(lidar: bpy.types.Object) -> str:
    """A digest of what a LiDAR's cloud and score are made with, but for its pose, the time and the user's own objects.

    That is its sensor, its baseline and the scene's settings, and whether traffic and ground are shown.
    """
    scene = properties.scene_of(lidar)
    group, fields = scene.blender_lidar, {name: of for name, of in fields_of(scene).items() if name != "search"}
    fields["traffic"] = {key: value for key, value in fields["traffic"].items() if key not in _OF_SEARCH}
    fields["traffic"]["path"] = group.traffic.path  # stays what it is where the file is moved with its traffic
    own = group.kept, [getattr(group.vehicles, kind) for kind in FLEET_KINDS]
    shown = is_traffic_shown(scene), hidden_ground(scene, view_layer_of(scene))
    made_with = sensor_table(lidar), lidar.blender_lidar.baseline, fields, own, shown
    return hashlib.sha256(repr(made_with).encode()).hexdigest()


def store(lidar: bpy.types.Object, vehicles: Vehicles, look: Look, baseline: Look) -> None:
    """Keep with a LiDAR, unless it is linked, what the panel says of a scan: its size and score, and the baseline's."""
    group = lidar.blender_lidar
    if lidar.library is not None:
        return
    group.points, group.scanned_frame = len(look.cloud), vehicles.frame
    group.scanned_s = since_of(properties.scene_of(lidar))
    group.scanned_at, group.scanned_with = list(look.pose.as_table().values()), settings_digest(lidar)
    group.vehicles = 0 if look.scored is None else look.scored.values.shape[1]
    for scored, objective, share in (
        (look.scored, "objective", "detectable_share"),
        (baseline.scored, "baseline_objective", "baseline_share"),
    ):
        setattr(group, objective, 0.0 if scored is None else float(scored.objective.sum()))
        setattr(group, share, 0.0 if scored is None else float(scored.detectable.mean()))


def store_layout(scene, hung: list[bpy.types.Object], frames: list[LiveFrame], looks: list[tuple[Look, Look]]) -> None:
    """Keep with a scene what its layout is worth, fused of what each LiDAR sees now and as its baseline."""
    told, key = (
        {"lidars": [one.name_full for one in hung], "vehicles": int(frames[0].frame.counted.sum())},
        uid_of(scene),
    )
    if key not in _FUSED or _FUSED[key][0] != frames:
        _FUSED[key] = frames, FusedScores(frames) if frames[0].scoring else None
    for name, of in zip(("now", "baseline"), zip(*looks, strict=True), strict=True) if _FUSED[key][1] else ():
        scored = _FUSED[key][1].of(of)
        told[name] = {"objective": float(scored.objective.sum()), "share": float(scored.detectable.mean())}
    scene.blender_lidar.fused = json.dumps(told) if "now" in told else ""


def forget() -> None:
    """Let go of all that is kept."""
    for kept in (_RECORDINGS, _FRAMES, _OBJECTS, _BODIES, _FUSED):
        kept.clear()
