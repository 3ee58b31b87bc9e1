"""The panel's properties, made from the one declaration of each setting: unit, range, default and tooltip.

`Scene.blender_lidar` holds what a scene has once, `Object.blender_lidar` what each LiDAR has. Blender keeps numbers in
single precision and angles in radians: `values_of` gives them back as they were typed.
"""

# Not from __future__ import annotations: Blender reads properties from annotations as they are.
import json
import math
import zlib
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import lru_cache, wraps
from typing import NamedTuple, get_args, get_origin

import bpy
from bpy.props import (
    BoolProperty,
    CollectionProperty,
    EnumProperty,
    FloatProperty,
    FloatVectorProperty,
    IntProperty,
    PointerProperty,
    StringProperty,
)

from ..errors import InputError, one_line
from ..names import METRIC_NAMES
from ..road.road_map import RoadMap
from ..road.settings import RoadSettings, map_of
from ..scene.deployment import MOUNTING_OR_LEAN, SEARCHED, Facing
from ..scene.mounting import COORDINATES, LEANS, Mounting, changed_mounting, hung_at, mounting_from
from ..scene.settings import DECLARED, GATE
from ..toml_table import Setting
from ..traffic.vehicles import FLEET_KINDS
from ..world.blender import objects
from ..world.blender.objects import hang, lidars, pose_of
from ..world.blender.points import STYLES
from ..world.blender.site import LABELS_BY
from . import words

CONTEXT = "blender_lidar"  # of translation: Blender's dictionary has none of it, so that what we draw stays whole
SCHEMA = 1  # of what is saved in a .blend file
_DIGITS = 6  # that single precision keeps of a number
_POSE_DIGITS = 4  # of metres and degrees: it keeps these within a kilometre
_UNITS = {"m": ("LENGTH", "NONE"), "deg": ("ROTATION", "ANGLE"), "s": ("TIME", "NONE")}  # unit and subtype by suffix
OWN = "own"  # in place of a name: what a file of the user's says
_PATH = {"subtype": "FILE_PATH"}
if bpy.app.version >= (4, 5, 0):  # before, every path could be relative to the .blend file
    _PATH["options"] = {"PATH_SUPPORTS_BLEND_RELATIVE"}
ON_CHANGE: list[Callable[[bpy.types.ID, str], None]] = []
"""Called with the scene or the LiDAR whose property has changed, and the table that it is of."""


_silent = False


def _changed(table: str) -> Callable:
    def update(group, context):
        for call in () if _silent else ON_CHANGE:
            call(group.id_data, table)

    return update


@contextmanager
def silently() -> Iterator[None]:
    """While it lasts changed properties call no update."""
    global _silent
    before, _silent = _silent, True
    try:
        yield
    finally:
        _silent = before


# --- A property from a declaration ------------------------------------------------------------------------------------


def label_of(key: str) -> str:
    """What the panel calls a setting: ``range_gate_m`` is "Range Gate"; of several, ``x_m, y_m``, "X, Y"."""
    if ", " in key:
        return ", ".join(map(label_of, key.split(", ")))
    if key in words.CALLED:
        return words.CALLED[key]
    name, _, unit = key.rpartition("_")
    parts = (name if unit in (*_UNITS, "hz") and name else key).split("_")
    return " ".join(part if part[:1].isupper() else part.capitalize() for part in parts)


def where(table: str, key: str) -> str:
    """What an error calls the panel's field of a setting."""
    panel = "Noise" if key in IMPERFECTIONS else words.PANELS.get(table, label_of(table))
    return f"LiDAR panel: {panel}{f', {label_of(key)}' if key else ''}"


def made_from(key: str, declared: Setting, table: str, **more: object):
    """The Blender property of a setting; `more` replaces what is made of its declaration."""
    kind, unit = declared.kind, key.rpartition("_")[2]
    text = words.TOOLTIPS.get(key, f"{declared.help[:1].upper()}{declared.help[1:]}")
    settings: dict[str, object] = {"name": label_of(key), "description": text, "update": _changed(table)}
    default = declared.default if declared.default not in (None, ...) else None
    if kind is bool:
        return BoolProperty(**settings | {"default": bool(default)} | more)
    if kind is str and declared.allowed:
        items = [(name, name.capitalize(), words.CHOICES.get(name, "")) for name in declared.allowed]
        return EnumProperty(**settings | {"items": items, "default": default} | more)
    if kind is str:
        subtype = _PATH if declared.is_path else {}
        return StringProperty(**settings | subtype | {"default": default or ""} | more)
    low, high = max(declared.low, declared.above), min(declared.high, declared.below)
    if kind is int:
        bounds = {"min": int(max(low, -(2**31))), "max": int(min(high, 2**31 - 1))}
        return IntProperty(**settings | bounds | {"default": int(default or 0)} | more)
    scale = math.radians(1.0) if unit == "deg" else 1.0
    bounds = {"min": scale * low if math.isfinite(low) else -1e9, "max": scale * high if math.isfinite(high) else 1e9}
    look = {"precision": 3}
    if unit in _UNITS:
        look |= dict(zip(("unit", "subtype"), _UNITS[unit], strict=True))
    if kind is float:
        return FloatProperty(**settings | bounds | look | {"default": scale * float(default or 0.0)} | more)
    return StringProperty(**settings | more)  # numbers; of map coordinates single precision would keep metres


def exact(value: float, key: str = "") -> float:
    """A number as it was typed, from single precision; degrees for a key of them."""
    return float(f"{math.degrees(value) if key.endswith('_deg') else value:.{_DIGITS}g}")


def values_of(group: bpy.types.PropertyGroup, keys: Mapping[str, Setting]) -> dict[str, object]:
    """Settings by key as a scene file has them; what is left open, 0 or empty where no default is declared, is not."""
    found: dict[str, object] = {}
    for key, declared in keys.items():
        value = getattr(group, key)
        if isinstance(value, float):
            value = exact(value, key)
        if declared.default in (None, ...) and value in ("", 0):
            continue
        if get_origin(declared.kind) is tuple:
            with suppress(ValueError):  # what is no pair of numbers is refused as it is
                value = [get_args(declared.kind)[0](part) for part in value.split(",")]
        found[key] = value
    return found


def fill(group: bpy.types.PropertyGroup, keys: Mapping[str, Setting], values: Mapping[str, object]) -> None:
    """Set the properties of settings to values as a scene file has them; what is None is left open."""
    for key in keys:
        value = values.get(key)
        if value is None:
            group.property_unset(key)
        elif isinstance(value, list | tuple):
            setattr(group, key, ", ".join(f"{part:.15g}" for part in value))
        else:
            setattr(group, key, math.radians(value) if key.endswith("_deg") else value)


def _chosen(table: str, *keys: str) -> dict[str, Setting]:
    return {key: DECLARED[table][key] for key in keys}


_TRAFFIC = _chosen("traffic", "path", "format", "period", "origin_m", "heading_deg", "time_step_s")
_TRAFFIC |= _chosen("traffic", "frames", "holdout", "block_s", "leave_out")
_ROAD = _chosen("road", "station_m", "right_edge_m", "setback_m", "lanes", "lane_width_m")
_ROAD |= _chosen("road", "grade_percent", "cross_fall_percent", "crown_percent")
_WORLD = _chosen("world", "detail", "ground", "variety", "variety_seed")
_OBJECTIVE = _chosen("objective", "threshold", "cell_m")
_SEARCH = _chosen("search", "particles", "iterations", "seed")
_MODEL = _chosen("model", "caster")
SENSOR = _chosen("sensor", "rotation_hz", "range_gate_m", "dropout", "glass_dropout", "unit_spread_deg", "unit")
SENSOR |= _chosen("sensor", "noise_seed", "range_noise_m", "range_at_10_percent_m")
IMPERFECTIONS = tuple(key for key in SENSOR if key not in ("rotation_hz", "range_gate_m"))
SIX = {key: MOUNTING_OR_LEAN[key] for key in COORDINATES}
SEARCHABLE = SIX | {key: MOUNTING_OR_LEAN[key] for key in LEANS}
"""The coordinates of which a LiDAR has a field and a row of bounds each."""
TABLES = {
    "traffic": _TRAFFIC,
    "road": _ROAD,
    "world": _WORLD,
    "objective": _OBJECTIVE,
    "search": _SEARCH,
    "model": _MODEL,
    "baseline": SIX,
}
"""The settings that a scene has once, by table of the scene file."""
_USUAL = {"x_m": (-10.0, 10.0), "y_m": (-5.0, 0.0), **SEARCHED}  # bounds of a row that is switched on


def _annotations(table: str, keys: Mapping[str, Setting]) -> dict[str, object]:
    return {key: made_from(key, declared, "world" if key == "leave_out" else table) for key, declared in keys.items()}


# Groups with one property for each key, as registered classes read them from their annotations.
GROUPS = {
    table: type(f"BLENDER_LIDAR_PG_{table}", (bpy.types.PropertyGroup,), {"__annotations__": _annotations(table, keys)})
    for table, keys in TABLES.items()
}
_OWN_BODIES = {
    kind: PointerProperty(
        name=label_of(kind),
        type=bpy.types.Collection,
        update=_changed("world"),
        description="Collection that is shown and scanned in place of the body of each such vehicle, fitted to its box",
    )
    for kind in FLEET_KINDS
}
GROUPS["vehicles"] = type("BLENDER_LIDAR_PG_vehicles", (bpy.types.PropertyGroup,), {"__annotations__": _OWN_BODIES})


# --- What a scene file says, kept beside the fields that it has filled: only those changed since replace it -----------


class Kept(NamedTuple):
    """What a scene or a LiDAR was filled with.

    Attributes
    ----------
    tables : dict
        The scene file's own tables; none where nothing was loaded.
    folder : str
        Where relative paths among them start from.
    fields : dict
        What the panel's fields said when they had been filled, by table and key.
    """

    tables: dict[str, dict]
    folder: str
    fields: dict[str, dict]


def kept_of(group: bpy.types.PropertyGroup) -> Kept:
    """What a scene's or a LiDAR's group was filled with."""
    return _kept_in(group.kept) if group.kept else Kept({}, "", {})


@lru_cache(maxsize=64)
def _kept_in(text):
    return Kept(**json.loads(text))


def keep_tables(group: bpy.types.PropertyGroup, tables: dict, folder: str, fields: dict) -> None:
    """Keep with a scene or a LiDAR what it has just been filled with."""
    group.kept = json.dumps(Kept(tables, folder, fields)._asdict())


def changed(before: Kept, fields: dict[str, dict]) -> dict[tuple[str, str], tuple[object, str]]:
    """The fields that are not as they were filled, as `scenario_of` takes what replaces a file's settings."""
    found = {}
    for table, now in fields.items():
        then = before.fields.get(table, {})
        keys = [key for key in {**then, **now} if now.get(key) != then.get(key)]
        found |= {(table, key): (now.get(key), where(table, key)) for key in keys}
    return found


# --- The region, and what a scene has besides -------------------------------------------------------------------------


class BLENDER_LIDAR_PG_region(bpy.types.PropertyGroup):
    """Where vehicles count: a circle."""

    centre_m: FloatVectorProperty(
        name="Center",
        size=2,
        unit="LENGTH",
        description="Center of the circle in which vehicles count, x and y",
        update=_changed("region"),
    )
    with_gate: BoolProperty(
        name="Up to Range Gate",
        default=True,
        update=_changed("region"),
        description="Use the sensor's range gate as the radius of the circle",
    )
    radius_m: FloatProperty(
        name="Radius",
        default=50.0,
        min=0.1,
        max=1e6,
        unit="LENGTH",
        update=_changed("region"),
        description="Radius of the circle in which vehicles count",
    )

    def table(self) -> dict[str, object]:
        """As a scene file has it."""
        return {
            "centre_m": [exact(value) for value in self.centre_m],
            "radius_m": GATE if self.with_gate else exact(self.radius_m),
        }


def _session():
    from . import session  # which imports this module

    return session


def _scenarios():
    from . import scenarios  # likewise

    return scenarios


class BLENDER_LIDAR_PG_pointer(bpy.types.PropertyGroup):
    """One of a scene's LiDARs, kept so that no other objects need to be looked at: see `scenarios.lidars_of`."""

    lidar: PointerProperty(type=bpy.types.Object)


def _chosen_row(group):
    active = _scenarios().active_lidar(group.id_data)
    return next((number for number, row in enumerate(group.lidars) if row.lidar == active), -1)


def _choose_row(group, index):
    group.active = group.lidars[index].lidar
    _scenarios().select(bpy.context, group.active)


class BLENDER_LIDAR_PG_scene(bpy.types.PropertyGroup):
    """What the sidebar's tab shows of a scene."""

    schema: IntProperty(default=0, options={"HIDDEN"})
    loaded: BoolProperty(default=False, options={"HIDDEN"})
    source: StringProperty(default="", options={"HIDDEN"}, description="Scene file that the settings came from")
    problem: StringProperty(default="", options={"HIDDEN"}, description="What is wrong with a field")
    kept: StringProperty(default="", options={"HIDDEN"}, description="The scene file's own tables, as JSON")
    metric: EnumProperty(
        name="Objective",
        items=[
            *words.METRIC_ITEMS,
            (OWN, "The Scene File's Own", "A metric from a Python file that the scene file names"),
        ],
        default=METRIC_NAMES[0],
        update=_changed("objective"),
        description="What Score shows and Optimize raises, summed over the vehicles",
    )
    frame: IntProperty(
        name="Instant",
        get=lambda group: _session().shown_frame(group.id_data),
        set=lambda group, value: _session().show_frame(group.id_data, value),
        description="Number of the recorded instant that is nearest to the timeline; another one moves the timeline",
    )
    label_by: EnumProperty(
        name="Label By",
        items=[(key, key.replace("_", " ").title(), f"Its {key.replace('_', ' ')}") for key in LABELS_BY],
        update=_changed("labels"),
        description="What of your own objects labels the points on them",
    )
    covered: StringProperty(options={"HIDDEN"}, description="Which share of chosen objects LiDARs saw, as JSON")
    clip: BoolProperty(options={"HIDDEN"}, description="Whether the timeline plays the 20 s of the example")
    known_frame: IntProperty(options={"HIDDEN"}, description="Number of the last known instant")
    starts_s: FloatProperty(
        name="Starts At",
        unit="TIME",
        subtype="TIME_ABSOLUTE",
        update=_changed("clock"),
        description="Second of the timeline at which the recording begins",
    )
    active: PointerProperty(
        name="LiDAR", type=bpy.types.Object, description="The LiDAR that is scanned, scored and optimized"
    )
    lidars: CollectionProperty(type=BLENDER_LIDAR_PG_pointer, options={"HIDDEN"})
    row: IntProperty(get=_chosen_row, set=_choose_row, options={"HIDDEN"}, description="The active one among them")
    fused: StringProperty(options={"HIDDEN"}, description="What the layout is worth on the frame scanned last, as JSON")
    bake_format: EnumProperty(
        name="Format", items=[(".ply", "PLY", ""), (".pcd", "PCD", "")], description="Of its files"
    )
    hung_on: StringProperty(
        default="{}", options={"HIDDEN"}, description="The road beside which the LiDARs hang, as JSON"
    )


for _table in GROUPS:
    BLENDER_LIDAR_PG_scene.__annotations__[_table] = PointerProperty(type=GROUPS[_table])
BLENDER_LIDAR_PG_scene.__annotations__["region"] = PointerProperty(type=BLENDER_LIDAR_PG_region)


# --- A LiDAR ------------------------------------------------------------------------------------------------------


def _pose_getter(key):
    def get(group):
        try:
            value = mounting_of(group.id_data).as_table()[key] or 0.0  # what does not lean has no direction
        except InputError:  # mirrored or sheared, which the panel says in place of a pose
            return math.nan
        return math.radians(value) if key.endswith("_deg") else value

    return get


def _pose_setter(key):
    def put(group, value):
        lidar = group.id_data
        given = {key: exact(value, key)}
        try:
            hang(lidar, changed_mounting(mounting_of(lidar), road_of(scene_of(lidar)), **given).pose)
        except InputError as error:
            tell(scene_of(lidar), str(error))

    return put


def scene_of(block: bpy.types.Scene | bpy.types.Object) -> bpy.types.Scene | None:
    """A scene itself, or the first one that a LiDAR is in."""
    return block if isinstance(block, bpy.types.Scene) else objects.scene_of(block)


def tell(scene: bpy.types.Scene | None, problem: str) -> None:
    """Say at the top of the tab what is wrong; only what differs is written, as each writing is an update."""
    if scene is not None and scene.blender_lidar.problem != problem:
        scene.blender_lidar.problem = problem


def guarded(call: Callable) -> Callable:
    """Let a handler or a timer say at the top of the tab what is wrong, whatever it is, and print nothing."""

    @wraps(call)
    def safe(*given):
        try:
            return call(*given)
        except Exception as error:
            scene = given[0] if given and isinstance(given[0], bpy.types.Scene) else bpy.context.scene
            tell(scene, one_line(str(error)))

    return safe


def mounting_of(lidar: bpy.types.Object, road: RoadMap | None = None, depsgraph=None) -> Mounting:
    """How a LiDAR hangs beside a `road`, its scene's unless said; its coordinates are rounded to what Blender holds.

    With a `depsgraph` it hangs as that has evaluated it.

    Raises
    ------
    InputError
        For a LiDAR that is mirrored or sheared, or a road frame that is tilted or scaled.
    """
    road = road_of(scene_of(lidar)) if road is None else road
    tables, pose = kept_of(lidar.blender_lidar).tables, pose_of(lidar, depsgraph)
    filed, mast = tables.get("deployment", {}), tables.get("mast", {})
    facing = Facing(filed.get("facing_deg", None if mast else 90.0), mast.get("towards"))
    hung = hung_at(pose, road, math.radians(facing.at((pose.x_m, pose.y_m), road)))
    table = hung.as_table()
    found = {key: round(table[key], _POSE_DIGITS) + 0.0 for key in COORDINATES}
    found["yaw_deg"] = math.fmod(found["yaw_deg"], 360.0)  # a full circle less than a digit is none
    return mounting_from(found, road, hung)


def road_table(scene: bpy.types.Scene | None) -> dict[str, object]:
    """[road] of a scene: as its file has it, changed as the panel's fields say."""
    if scene is None:
        return {}
    kept, fields = kept_of(scene.blender_lidar), values_of(scene.blender_lidar.road, _ROAD)
    changes = changed(kept, {"road": fields})
    return kept.tables.get("road", {}) | {key: value for (_, key), (value, _) in changes.items()}


def road_of(scene: bpy.types.Scene | None) -> RoadMap:
    """The road of a scene, as a map."""
    return _map_of(road_table(scene))


def _map_of(table: dict[str, object]) -> RoadMap:
    maps = {key: tuple(value) if isinstance(value, list) else value for key, value in table.items()}
    if maps.get("driven"):
        raise InputError(
            "[road] driven: a driven area is made from the traffic; allowed in the panel: net or opendrive"
        )
    return map_of(RoadSettings(**(maps if {"net", "opendrive"} & maps.keys() else table)))


def hang_as_they_are(scene: bpy.types.Scene) -> None:
    """Take a scene's LiDARs for hung beside its road as it is now."""
    scene.blender_lidar.hung_on = json.dumps(road_table(scene))


def hang_again(scene: bpy.types.Scene) -> None:
    """Hang a scene's LiDARs by their coordinates beside its road as it is now; mirrored ones have none."""
    before, now = _map_of(json.loads(scene.blender_lidar.hung_on)), road_of(scene)
    hang_as_they_are(scene)
    for lidar in lidars(scene):
        if scene_of(lidar) == scene:
            with suppress(InputError):
                mounting = mounting_of(lidar, before)
                there = mounting_from({}, now, mounting)
                if there != mounting:
                    hang(lidar, there.pose)


# Numbers are saved, so that they hang on the names: another model does not shift them.
MODELS = [*words.SENSORS, (OWN, "Beam Table of Your Own", "A TOML or CSV file")]
MODELS = [(name, *shown, zlib.crc32(name.encode()) & 0x7FFFFFFF) for name, *shown in MODELS]


class BLENDER_LIDAR_PG_lidar(bpy.types.PropertyGroup):
    """What belongs to one LiDAR; its transform is its pose."""

    schema: IntProperty(default=0, options={"HIDDEN"})
    kept: StringProperty(default="", options={"HIDDEN"}, description="[sensor] and [deployment] of the file, as JSON")
    name_: EnumProperty(
        name="Model",
        items=MODELS,
        default="RS-16",
        update=_changed("sensor"),
        description="Which LiDAR it is: each has the beams of its data sheet or of a calibrated unit",
    )
    table_path: StringProperty(
        name="Beam Table", update=_changed("sensor"), description="Beam table of your own", **_PATH
    )
    datasheet: BoolProperty(
        name="As the Data Sheet Says",
        update=_changed("sensor"),
        description="Take the range noise and the range of a 10 % target from the model's data sheet",
    )
    live: BoolProperty(
        name="Live", update=_changed("live"), description="Scan and score again whenever the LiDAR is moved"
    )
    in_layout: BoolProperty(
        name="In Layout",
        update=_changed("layout"),
        description="Score and optimize this LiDAR together with the others that are in the layout",
    )
    number: IntProperty(default=99, options={"HIDDEN"}, description="Its place in the scene file's list of LiDARs")
    baseline: StringProperty(options={"HIDDEN"}, update=_changed("baseline"), description="Its own in a layout: JSON")
    colour_by: EnumProperty(
        name="Color by",
        update=_changed("look"),
        default="range",
        items=[(key, key.capitalize(), "") for key in ("range", "ring", "vehicle", "intensity", "entropy", "label")],
        description="Quantity that colors the points",
    )
    style: EnumProperty(
        name="Style",
        update=_changed("style"),
        items=[(name, name, told) for name, (*_, told) in STYLES.items()],
        description="Look of the scanned points, a node group",
    )
    poles: StringProperty(
        name="Poles", description="CSV of candidate places that are searched, in place of X and Y", **_PATH
    )
    scanned_frame: IntProperty(default=-1, options={"HIDDEN"})
    scanned_s: FloatProperty(options={"HIDDEN"}, description="Time since the recording's beginning that was scanned")
    scanned_at: FloatVectorProperty(size=6, options={"HIDDEN"})
    scanned_with: StringProperty(options={"HIDDEN"}, description="Digest of the settings that were scanned with")
    points: IntProperty(options={"HIDDEN"})
    vehicles: IntProperty(options={"HIDDEN"})
    objective: FloatProperty(options={"HIDDEN"})
    detectable_share: FloatProperty(options={"HIDDEN"})
    baseline_objective: FloatProperty(options={"HIDDEN"})
    baseline_share: FloatProperty(options={"HIDDEN"})
    found: StringProperty(options={"HIDDEN"}, description="What an optimization has found, as JSON")


BLENDER_LIDAR_PG_lidar.__annotations__ |= _annotations("sensor", SENSOR)
for _key, _declared in SEARCHABLE.items():
    BLENDER_LIDAR_PG_lidar.__annotations__[_key] = made_from(
        _key, _declared, "deployment", get=_pose_getter(_key), set=_pose_setter(_key), update=None
    )
    _low, _high = _USUAL.get(_key, (_declared.low, _declared.high))
    _scale = math.radians(1.0) if _key.endswith("_deg") else 1.0
    BLENDER_LIDAR_PG_lidar.__annotations__ |= {
        f"{_key}_on": BoolProperty(
            name=label_of(_key), default=_key in SEARCHED, description=f"Search this coordinate: {_declared.help}"
        ),
        f"{_key}_low": made_from(_key, _declared, "deployment", name="Low", default=_scale * _low, update=None),
        f"{_key}_high": made_from(_key, _declared, "deployment", name="High", default=_scale * _high, update=None),
    }


classes = (
    *GROUPS.values(),
    BLENDER_LIDAR_PG_region,
    BLENDER_LIDAR_PG_pointer,
    BLENDER_LIDAR_PG_scene,
    BLENDER_LIDAR_PG_lidar,
)


def register() -> None:
    """Let every scene and object have its group."""
    bpy.types.Scene.blender_lidar = PointerProperty(type=BLENDER_LIDAR_PG_scene)
    bpy.types.Object.blender_lidar = PointerProperty(type=BLENDER_LIDAR_PG_lidar)


def unregister() -> None:
    """Take the groups away; what is saved in files stays there."""
    del bpy.types.Scene.blender_lidar, bpy.types.Object.blender_lidar
