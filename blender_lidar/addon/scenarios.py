"""Scenarios of Blender's scenes: their LiDARs, a scene file's settings, and the panel's fields as changes to these.

Nothing here keeps a reference to a data-block of Blender's: scenes and LiDARs are known by their `session_uid`, which
undo leaves as it is, or by their names where Blender has none.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

import bpy

from ..errors import InputError
from ..files import read_file
from ..names import METRIC_NAMES
from ..plugins import is_plugin, located, plugin_file
from ..scene.lidars import OF_ANY_MODEL
from ..scene.mounting import ANGLES, LEANS, MOUNTED, PLACE, mounting_from
from ..scene.scenario import Scenario, numbered_tables, scenario_of, shipped_scenes
from ..scene.settings import DATASHEET, GATE, SensorSettings, is_sensor_file
from ..sensors.model import model_names
from ..traffic.vehicles import FLEET_KINDS
from ..world.blender.bodies import kept_body
from ..world.blender.objects import holds, is_lidar
from ..world.blender.road import hidden_ground, road_collection
from . import properties

_SAME_M, _SAME_ROTATION = 2e-4, 1e-5  # nearer, a LiDAR hangs as it was hung
_TRUSTED: set[tuple[Path, bytes]] = set()  # Python files with their content, in this session
_REFUSED: list[Path] = []  # the one that was refused last
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
    whole = layout_scenario(scene, hung, here=here)
    return whole.with_lidars(whole.lidars[hung.index(lidar) if hung else 0])


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
        hangs = {key: value for key, value in tables.get("baseline", {}).items() if key == "installer"}
        tables |= {"baseline": hangs, "sensor": _sensors_of(hung)}
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
        if towards is not None and of.deployment.facing.towards_m != tuple(towards) and not of.deployment.poles:
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
    return scenario_of({"traffic": {"path": "any"}, **tables}, where=properties.where, overrides=changes).lidar.sensor


def check_unit(scene: bpy.types.Scene) -> None:
    """Refuse a scene whose unit is not the metre."""
    if abs(scene.unit_settings.scale_length - 1.0) > 1e-6:
        given = f"scene {scene.name}: unit scale {scene.unit_settings.scale_length:g}"
        raise InputError(f"{given}; allowed: 1, so that a unit is a metre (Scene properties, Units)")


def fill_scene(scene: bpy.types.Scene, tables: Mapping[str, Any], folder: str, scenario: Scenario) -> None:
    """Set the panel's fields to a scene file's settings, and keep its `tables` for all that has no field.

    What such a file leaves open because of its sensor and mounting, region and baseline, is kept as it came out.
    """
    group, found = scene.blender_lidar, numbered_tables(scenario.as_tables())
    found["baseline"] |= scenario.lidars[0].as_table()["baseline"]
    for name, keys in properties.TABLES.items():
        properties.fill(getattr(group, name), keys, found[name])
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
    kept |= {"region": own, "baseline": found["baseline"], "road": found["road"]}
    properties.keep_tables(group, kept, folder, fields_of(scene))
    group.schema = properties.SCHEMA


def without_field(scene: bpy.types.Scene, lidar: bpy.types.Object | None) -> list[str]:
    """What is kept of the scene file and has no field in the panel, a line for each table."""
    tables = {**properties.kept_of(scene.blender_lidar).tables}
    if lidar is not None:
        own = properties.kept_of(lidar.blender_lidar).tables
        tables["sensor"] = own.get("sensor", {})
        tables["deployment"] = {key: one for key, one in own.get("deployment", {}).items() if key == "installer"}
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
    group, of = lidar.blender_lidar, scenario.lidars[number]
    sensor, deployment = asdict(of.sensor), of.deployment.as_table()
    group.in_layout, group.number = scenario.has_names, number
    if sensor["name"] in model_names():
        group.name_ = sensor["name"]
    else:
        group.name_, group.table_path = properties.OWN, str(Path(sensor["name"]).resolve())
    properties.fill(group, properties.SENSOR, sensor)
    group.poles = str(Path(deployment.pop("poles")).resolve()) if of.deployment.poles else ""
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
    facing = of.deployment.places[0].facing
    mast = {"towards": facing.towards_m} if facing.angle_deg is None else {}  # as the road says, not the file
    properties.keep_tables(group, {"sensor": own, "deployment": deployment, "mast": mast}, folder, fields)
    group.baseline = json.dumps(of.baseline.as_table()) if group.in_layout else ""
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
        table["installer"] = False
    elif group.poles:
        table = {key: value for key, value in table.items() if key not in ("x_m", "y_m") or key in bounds}
        table["poles"] = bpy.path.abspath(group.poles)
    return table
