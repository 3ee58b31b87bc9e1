"""What the panel's buttons do: load traffic, add a LiDAR, scan and score, set the baseline, export."""

import json
from collections.abc import Callable
from functools import wraps
from importlib.util import find_spec
from pathlib import Path

import bpy
import numpy as np
from bpy.props import BoolProperty, EnumProperty, FloatProperty, StringProperty
from bpy_extras.io_utils import ExportHelper
from mathutils import Vector

from ..casting import resolve
from ..clouds.files import SUSTECHPOINTS_PARTS, write_cloud, write_sustechpoints
from ..clouds.snapshot import MountedSensor, entropy_of_vehicles, mounted_sensors, vertices_of
from ..commands.optimise import write_pages
from ..errors import BlenderLidarError, InputError, one_line
from ..files import check_unused, make_folder
from ..names import CLOUD_SUFFIXES
from ..run.folder import RunFolder
from ..run.optimise import evaluate_site
from ..scene.mount_checks import check_mount_is_clear
from ..scene.mounting import Mounting, changed_mounting, mounting_from
from ..scene.scenario import Scenario, load_scenario, scenario_of, shipped_scenes
from ..scene.site import lattice_of, prepare, read_recordings, standing_scenery
from ..sensors.pose import Pose
from ..toml_table import read_toml
from ..traffic import Recording
from ..traffic.boxes import Boxes
from ..traffic.vehicles import SAME_S
from ..world.blender.objects import (
    FAN,
    PART,
    SENSOR,
    SETTINGS,
    STANDING,
    build_scenery,
    collection,
    dress,
    frame_of,
    is_lidar,
    lidars,
    new_lidar,
    remove_orphans,
    road_frame,
    role,
    to_road,
)
from ..world.blender.points import show_cloud
from ..world.blender.road import build_road, show_ground
from ..world.blender.site import is_own, open_scenery
from ..world.blender.traffic import show_recording
from ..world.scenery import Scenery
from . import live, properties, scenarios, session
from .preferences import preference

_CLOUDS = [name for name in CLOUD_SUFFIXES if name not in (".las", ".laz") or find_spec("laspy")]
_LEAST_REACH_M = 120.0  # of the road that is shown
_WITH_FACES = ("MESH", "CURVE", "SURFACE", "META", "FONT")
_STAND_OFF_M = 30.0  # so large may be what a new LiDAR stands off from


def one_line_errors(execute: Callable) -> Callable:
    """Let an operator report wrong input in one line and change nothing: the work is checked before it is begun."""

    @wraps(execute)
    def guarded(operator, context):
        try:
            return execute(operator, context)
        except BlenderLidarError as error:
            operator.report({"ERROR"}, one_line(str(error)))
            return {"CANCELLED"}

    return guarded


class NeedsLidar:
    """A panel or an operator, which says why, that is not there until a LiDAR is and, with `of_traffic`, traffic."""

    of_traffic = False

    @classmethod
    def poll(cls, context):
        """Whether there are."""
        missing = "Add a LiDAR first: Add > LiDAR" if scenarios.active_lidar(context.scene) is None else ""
        if cls.of_traffic and not context.scene.blender_lidar.loaded:
            missing = "Load traffic first: the LiDAR tab of the sidebar, Traffic"
        if missing and issubclass(cls, bpy.types.Operator):
            cls.poll_message_set(missing)
        return not missing


# --- Traffic ----------------------------------------------------------------------------------------------------------


def show_site(scene: bpy.types.Scene, recording: Recording, frame: int, scenery: Scenery | None) -> None:
    """Show the road, what a scene file has standing there, and the frame of a recording nearest to a number."""
    group = scene.blender_lidar
    scenario = scenarios.scenario_from(scene)
    reach = max(_LEAST_REACH_M, scenario.range_gate_m)
    bare = frame_of(scene) is None
    build_road(scene, scenario.road_map, scenario.nominal_xy, reach)
    for lidar in [one for one in lidars(scene) if bare and one.library is None]:  # which has no pole yet
        dress(lidar, lattice_of(scenarios.sensor_of(lidar)))
    show_ground(scene, scenarios.view_layer_of(scene), shown=scene.blender_lidar.world.ground)
    build_scenery(scene, scenery)
    for item in collection(scene, "Scenery", STANDING).objects:
        item.hide_select = True  # it shows what the file says; moving it would move nothing that is scanned
    group.loaded = True
    session.start_clock(scene, recording, frame)
    place = group.world.detail, session.since_of(scene), group.starts_s
    show_recording(scene, recording, *place, session.bodies_shown(scene))


class BLENDER_LIDAR_OT_load(bpy.types.Operator):
    """Read the traffic file, or the scene file, and show its road and vehicles"""

    bl_idname, bl_label, bl_options = "blender_lidar.load", "Load Traffic", {"REGISTER", "UNDO"}

    @one_line_errors
    def execute(self, context):
        """Read it; a scene file fills the panel's fields."""
        scene = context.scene
        path = Path(bpy.path.abspath(scene.blender_lidar.traffic.path))
        if path.suffix.lower() == ".toml":
            return _fill_from_file(self, context, path)
        scene.blender_lidar.clip &= path.name == session.CLIP[0]
        scenery = _standing(scenarios.scenario_from(scene, scenarios.active_lidar(scene)))
        recording = session.recording_of(scene)
        show_site(scene, recording, scene.blender_lidar.known_frame, scenery)
        if (lidar := scenarios.active_lidar(scene)) is not None:
            scenarios.select(context, lidar)
            live.frame_site(lidar, lidar.blender_lidar.range_gate_m)
        return _loaded(self, recording)


class BLENDER_LIDAR_OT_run_file(bpy.types.Operator):
    """Let the scene run a Python file, a metric or a search, as it is now and until Blender ends"""

    bl_idname, bl_label = "blender_lidar.run_file", "Run Python File"
    filepath: StringProperty(subtype="FILE_PATH", options={"SKIP_SAVE"})

    def invoke(self, context, event):
        """Ask first."""
        return context.window_manager.invoke_props_dialog(self, width=500)

    def draw(self, context):
        """Say what is asked."""
        self.layout.label(text=self.filepath, icon="FILE_SCRIPT", translate=False)
        text = "It can do on this computer whatever you can. Run it only if you trust who wrote it."
        self.layout.label(text=text, icon="ERROR", translate=False)

    @one_line_errors
    def execute(self, context):
        """Take it as allowed, and take over what waited for it."""
        scenarios.trust(Path(self.filepath))
        for scene in bpy.data.scenes:
            scene.blender_lidar.problem = ""
            adopt(scene)
        return {"FINISHED"}


class BLENDER_LIDAR_OT_load_example(bpy.types.Operator):
    """Load the example: synthetic traffic made to resemble I-80, its road, and a LiDAR beside it"""

    bl_idname, bl_label, bl_options = "blender_lidar.load_example", "Load Example", {"REGISTER", "UNDO"}

    @one_line_errors
    def execute(self, context):
        """Fill the panel with the shipped scene."""
        scene = context.scene
        as_made = (scene.frame_start, scene.frame_end) == (1, 250) and not bpy.data.actions
        answer = _fill_from_file(self, context, shipped_scenes()["i80"], clip=True)
        if as_made:
            length_s = session.recording_of(scene).since_s[-1]
            scene.frame_end = scene.frame_current + round(length_s * scene.render.fps / scene.render.fps_base)
        return answer


def _fill_from_file(operator, context, path, *, clip=False):
    """Fill the panel with a scene file's settings, show its traffic, and let LiDARs hang there that are not there."""
    scene = context.scene
    scenarios.check_unit(scene)
    tables, folder = read_toml(path), str(path.resolve().parent)
    scenarios.check_trusted(tables, folder)
    scenario = load_scenario(path)
    recordings, scenery = read_recordings(session.with_clip(scenario, clip)), _standing(scenario)
    scene.blender_lidar.clip = clip
    scenarios.fill_scene(scene, tables, folder, scenario)
    properties.hang_again(scene)
    there, taken = {one.name: one for one in lidars(scene) if one.library is None}, set()
    for one in there.values() if scenario.has_names else ():
        one.blender_lidar.in_layout = False
    for number, one in enumerate(scenario.lidars):
        found = there.get(one.name) if scenario.has_names else scenarios.active_lidar(scene)
        if found is None or found.library is not None:  # a new one as the file says, each on a pole of its own
            places = one.deployment.places
            place = next((of for of in places if of.xy not in taken), places[0])
            taken.add(place.xy)
            stands = {key: place.fixed[key] for key in ("x_m", "y_m") if key in place.fixed}
            if place.xy is not None:
                stands["facing_deg"] = place.facing.at(place.xy, place.road)
            pose = changed_mounting(one.mounting(stands), place.road, **place.fixed).pose
            found = add_lidar(scene, pose, one.name)
        scenarios.fill_lidar(found, tables, folder, scenario, number)
        dress(found, lattice_of(one.sensor))
    scenarios.select(context, scenarios.layout_of(scene, found)[0])
    live.frame_site(context.view_layer.objects.active, scenario.range_gate_m)
    recording = session.keep(scene, recordings)
    ids, frames = scenario.recordings[0].frame_ids, recording.frames
    show_site(scene, recording, ids[0] if ids and not clip else int(frames[0 if clip else len(frames) // 2]), scenery)
    return _loaded(operator, recording)


def _standing(scenario):
    """What a scene's [world] has standing there at the start of its traffic."""
    if not scenario.world.has_scenery:
        return None
    return standing_scenery(scenario, resolve(scenario.model.caster, "caster")).at(0.0).with_walkers


def _loaded(operator, recording):
    operator.report({"INFO"}, f"{len(recording.frames)} frames with {len(recording):,} boxes")
    return {"FINISHED"}


class BLENDER_LIDAR_OT_step_frame(NeedsLidar, bpy.types.Operator):
    """Move the timeline to the next or the previous instant of the recording"""

    bl_idname, bl_label, bl_options = "blender_lidar.step_frame", "Step Traffic", {"REGISTER", "UNDO"}
    of_traffic = True
    back: BoolProperty(default=False, options={"SKIP_SAVE"})

    @one_line_errors
    def execute(self, context):
        """Go there."""
        scene = context.scene
        recording, now_s = session.recording_of(scene), session.since_of(scene)
        if self.back:
            at = recording.since_s.searchsorted(now_s - SAME_S) - 1
        else:
            at = recording.since_s.searchsorted(now_s + SAME_S, side="right")
        session.show_frame(scene, int(recording.frames[min(max(at, 0), len(recording.frames) - 1)]))
        return {"FINISHED"}


# --- LiDARs -----------------------------------------------------------------------------------------------------------


def add_lidar(scene: bpy.types.Scene, pose: Pose, name: str = "LiDAR") -> bpy.types.Object:
    """A new LiDAR at a mounting, dressed, with the usual sensor."""
    lidar = new_lidar(scene, pose, name)
    lidar.blender_lidar.schema = properties.SCHEMA
    dress(lidar, lattice_of(scenarios.sensor_of(lidar)))
    scene.blender_lidar.lidars.add().lidar = scene.blender_lidar.active = lidar
    return lidar


def select_wearer(layer: bpy.types.ViewLayer) -> None:
    """Select a LiDAR in place of its head, pole or fan where that is the active object: who clicks on it means it."""
    if is_clicked(layer.objects.active):
        part, lidar = layer.objects.active, layer.objects.active.parent
        part.select_set(False, view_layer=layer)
        lidar.select_set(True, view_layer=layer)
        layer.objects.active = lidar


def is_clicked(item: bpy.types.Object | None) -> bool:
    """Whether an active object is a head, pole or fan that stands for its LiDAR."""
    return item is not None and role(item) in (PART, FAN) and is_lidar(item.parent)


class BLENDER_LIDAR_OT_add(bpy.types.Operator):
    """Add a LiDAR at the 3D cursor: beside what stands there or, on a road, on a pole as high as the baseline"""

    bl_idname, bl_label, bl_options = "blender_lidar.add", "LiDAR", {"REGISTER", "UNDO"}
    model: EnumProperty(name="Model", items=properties.MODELS, default="RS-16", options={"SKIP_SAVE"})
    height_m: FloatProperty(name="Height", unit="LENGTH", description="Height of the sensor", options={"SKIP_SAVE"})
    live: BoolProperty(name="Live", description="Scan again whenever anything is moved", options={"SKIP_SAVE"})

    @one_line_errors
    def execute(self, context):
        """Add it, selected."""
        scene = context.scene
        scenarios.check_unit(scene)
        into = collection(scene, "LiDAR", SENSOR)
        if not _shows(context.view_layer.layer_collection, into):
            raise InputError(f"collection {into.name} is excluded from this view layer; tick it in the Outliner")
        x, y, z = scene.cursor.location
        if scenarios.has_road(scene):
            x, y, z, _ = to_road(scene) @ [x, y, z, 1.0]
            z = max(z, properties.exact(scene.blender_lidar.baseline.height_m))
        else:
            x, y, z = _beside_what_is_there(context, np.array([x, y, z]))
        if not self.properties.is_property_set("height_m"):
            self.height_m = z
        place = {"x_m": x, "y_m": y, "height_m": properties.exact(self.height_m)}
        lidar = add_lidar(scene, mounting_from(place, properties.road_of(scene)).pose)
        if not self.properties.is_property_set("model"):
            self.model = preference("sensor")
        if scene.blender_lidar.schema == 0 and not scene.blender_lidar.model.is_property_set("caster"):
            scene.blender_lidar.model.caster = preference("caster")
        lidar.blender_lidar.name_ = self.model
        scenarios.select(context, lidar)
        lidar.blender_lidar.live = self.live
        return {"FINISHED"}


def _beside_what_is_there(context, place: np.ndarray) -> np.ndarray:
    """A place (3,), or where from a LiDAR that faces +y sees the smallest visible object in whose box it lies.

    That is as far off as the object is large; where it is too large to be seen from there the place stays.
    """
    best, size = place, _STAND_OFF_M
    for item in context.view_layer.objects:
        if item.type in _WITH_FACES and is_own(item) and item.visible_get(view_layer=context.view_layer):
            box = np.array([item.matrix_world @ Vector(corner) for corner in item.bound_box])
            low, high = box.min(axis=0), box.max(axis=0)
            if (low < place).all() and (place < high).all() and (high - low).max() < size:
                size, middle = (high - low).max(), 0.5 * (low + high)
                best = np.array([middle[0], low[1] - size, middle[2]])
    return best


def _shows(layer: bpy.types.LayerCollection, of: bpy.types.Collection) -> bool:
    """Whether a view layer holds a collection."""
    return not layer.exclude and (layer.collection == of or any(_shows(child, of) for child in layer.children))


def adopt(scene: bpy.types.Scene) -> None:
    """Take over LiDARs that were built without the add-on, and complete those that were duplicated alone."""
    if scene.library is not None:
        return
    remove_orphans(scene)
    scenarios.keep_lidars(scene, lidars(scene))
    stored = scene.get(SETTINGS)
    if stored and scene.blender_lidar.schema == 0:
        _fill_from(scene)
    here = [one for one in lidars(scene) if one.library is None]
    found, carried = here, frame_of(scene) is not None or not scenarios.has_road(scene)
    if found and not carried:
        road_frame(scene)
    for lidar in found:
        if lidar.blender_lidar.schema == 0:
            if SETTINGS in lidar:
                scenarios.fill_lidar(lidar, *_stored(lidar), json.loads(lidar[SETTINGS]).get("number", 0))
            lidar.blender_lidar.schema = properties.SCHEMA
        parts = [child for child in lidar.children if role(child) == PART]
        if not carried or not parts:
            dress(lidar, lattice_of(scenarios.sensor_of(lidar)))


def _stored(block):
    """What `build` wrote with a scene or a LiDAR: tables with whole paths, so no folder, and the same as a scenario."""
    try:
        tables = json.loads(block[SETTINGS])
    except (TypeError, ValueError) as error:
        raise InputError(f"{block.name}: its property {SETTINGS} is damaged: {error}") from error
    tables = {name: table for name, table in tables.items() if name in properties.DECLARED}
    scenarios.check_trusted(tables, "")
    return tables, "", scenario_of(tables, source=f"scene {block.name}")


def _fill_from(scene):
    """Take over what `build` wrote into a scene: its settings and the frame that it shows."""
    group, stored = scene.blender_lidar, _stored(scene)
    with properties.silently():  # its LiDARs hang beside that road already
        scenarios.fill_scene(scene, *stored)
        properties.hang_as_they_are(scene)
        traffic = stored[-1].recordings[0]
        told = json.loads(scene[SETTINGS])
        group.known_frame, group.starts_s = told["frame"], told["starts_s"]
        group.loaded = Path(traffic.path).is_file()


# --- Scan and score ---------------------------------------------------------------------------------------------------


def checked_mount(scene: bpy.types.Scene, lidar: bpy.types.Object) -> tuple[Scenario, Mounting, Boxes]:
    """The settings of a LiDAR, how it hangs, and the frame that is shown, in which it hangs clear."""
    scenario, mounting = scenarios.scenario_from(scene, lidar), properties.mounting_of(lidar)
    vehicles = session.vehicles_of(scene)
    if scenarios.has_road(scene):
        check_mount_is_clear(scenario, scenario.lidar, [vehicles], {lidar.name: mounting})
    return scenario, mounting, vehicles


class BLENDER_LIDAR_OT_scan(NeedsLidar, bpy.types.Operator):
    """Cast one revolution from the LiDAR, show its cloud, and score the vehicles"""

    bl_idname, bl_label, bl_options = "blender_lidar.scan", "Scan", {"REGISTER", "UNDO"}

    @one_line_errors
    def execute(self, context):
        """Scan exactly, check the place, and show the cloud."""
        scene = context.scene
        hung, frames, looks, told = scenarios.layout_of(scene, scenarios.active_lidar(scene)), [], [], []
        checked = [checked_mount(scene, one) for one in hung]
        for lidar, (scenario, mounting, _) in zip(hung, checked, strict=True):
            frames.append(session.live_frame(scene, lidar, exact=True))
            objects = session.exact_objects(scene, context.view_layer, scenario)
            look = frames[-1].look(mounting.pose, objects)
            looks.append((look, frames[-1].look(scenario.lidar.baseline.pose, objects) if frames[-1].scoring else look))
        if len(hung) > 1:
            session.store_layout(scene, hung, frames, looks)
        for lidar, (look, base), (scenario, _, vehicles) in zip(hung, looks, checked, strict=True):
            bits = entropy_of_vehicles(look.cloud, vehicles, scenario.objective)
            group = lidar.blender_lidar
            show_cloud(lidar, vertices_of(look.cloud, vehicles, bits), group.colour_by, group.style)
            session.store(lidar, vehicles, look, base)
            scored = "" if look.scored is None else f", objective {float(look.scored.objective.sum()):.2f}"
            told.append(f"{lidar.name}: {len(look.cloud):,} points at {session.since_of(scene):.2f} s{scored}")
        live.hide_clouds()
        self.report({"INFO"}, "; ".join(told))
        return {"FINISHED"}


class BLENDER_LIDAR_OT_set_baseline(NeedsLidar, bpy.types.Operator):
    """Make the LiDAR's mounting the baseline that gains are measured against"""

    bl_idname, bl_label, bl_options = "blender_lidar.set_baseline", "Set as Baseline", {"REGISTER", "UNDO"}
    of_traffic = True

    @one_line_errors
    def execute(self, context):
        """Take the pose over."""
        lidar = scenarios.active_lidar(context.scene)
        mounting = properties.mounting_of(lidar)
        if lidar.blender_lidar.in_layout or lidar.blender_lidar.baseline:
            lidar.blender_lidar.baseline = json.dumps(mounting.as_table())
        else:
            properties.fill(context.scene.blender_lidar.baseline, properties.SIX, mounting.as_table())
        return {"FINISHED"}


# --- Export -----------------------------------------------------------------------------------------------------------


def _mounted(scene: bpy.types.Scene) -> tuple[MountedSensor, Boxes]:
    """The active LiDAR as the command line's `scan` has it, and the frame that is shown."""
    lidar = scenarios.active_lidar(scene)
    vehicles, hung = checked_mount(scene, lidar)[-1], scenarios.layout_of(scene, lidar)
    whole, layout = scenarios.layout_scenario(scene, hung), tuple(map(properties.mounting_of, hung))
    sensors = mounted_sensors(
        whole, layout, open_scenery(scene, bpy.context.view_layer), session.own_bodies(scene, again=True)
    )
    return sensors[hung.index(lidar)], vehicles


class BLENDER_LIDAR_OT_export_cloud(NeedsLidar, bpy.types.Operator, ExportHelper):
    """Write the cloud of the frame that is shown"""

    bl_idname, bl_label = "blender_lidar.export_cloud", "Export Cloud"
    filename_ext: EnumProperty(
        name="Format",
        items=[(name, name[1:].upper(), "") for name in _CLOUDS],
        default=".ply",
        description="Of the file",
    )
    filter_glob: StringProperty(default=";".join(f"*{name}" for name in _CLOUDS), options={"HIDDEN"})

    @one_line_errors
    def execute(self, context):
        """Scan and write."""
        sensor, vehicles = _mounted(context.scene)
        cloud = sensor.scan(vehicles)
        write_cloud(self.filepath, cloud, sensor.cloud_header(vehicles))
        self.report({"INFO"}, f"{self.filepath}: {len(cloud):,} points")
        return {"FINISHED"}


class FolderHelper:
    """An operator that asks for a folder."""

    directory: StringProperty(subtype="DIR_PATH", options={"SKIP_SAVE"})
    filter_folder: BoolProperty(default=True, options={"HIDDEN", "SKIP_SAVE"})

    def invoke(self, context, event):
        """Ask for it."""
        context.window_manager.fileselect_add(self)
        return {"RUNNING_MODAL"}


class BLENDER_LIDAR_OT_export_labelled(NeedsLidar, FolderHelper, bpy.types.Operator):
    """Write the cloud of the frame that is shown, and its boxes as labels of SUSTechPOINTS"""

    bl_idname, bl_label = "blender_lidar.export_labelled", "Export Labeled Set"

    @one_line_errors
    def execute(self, context):
        """Scan and write; frames of earlier exports stay."""
        sensor, vehicles = _mounted(context.scene)
        cloud = sensor.scan(vehicles)
        make_folder(Path(self.directory), "folder")
        write_sustechpoints(self.directory, cloud, vehicles, sensor.cloud_header(vehicles))
        parts = " and ".join(SUSTECHPOINTS_PARTS)
        self.report({"INFO"}, f"{self.directory}: frame {vehicles.frame} in {parts}")
        return {"FINISHED"}


class BLENDER_LIDAR_OT_export_run(NeedsLidar, FolderHelper, bpy.types.Operator):
    """Score the mounting on all searched and held-out frames, as evaluate does, into an empty folder"""

    bl_idname, bl_label = "blender_lidar.export_run", "Export Run Folder"
    of_traffic = True

    @one_line_errors
    def execute(self, context):
        """Evaluate the mounting."""
        scene = context.scene
        hung = scenarios.layout_of(scene, scenarios.active_lidar(scene))
        layout = tuple(map(properties.mounting_of, hung))
        session.check_traffic_is_shown(scene)
        check_unused(Path(self.directory), "folder", "run")
        objects = open_scenery(scene, context.view_layer)
        scenario, recordings = scenarios.layout_scenario(scene, hung), session.recordings_of(scene)
        bodies = session.own_bodies(scene, again=True)
        site = prepare(scenario, layout, scenery=objects, recordings=recordings, bodies=bodies)
        with RunFolder(self.directory).locked() as folder:
            result = evaluate_site(site, folder, layout)
            write_pages(site, folder, lambda note: self.report({"WARNING"}, note))
        self.report({"INFO"}, f"{self.directory}: objective {result['objective']:.1f} {result['metric_unit']}")
        return {"FINISHED"}


classes = (
    BLENDER_LIDAR_OT_load,
    BLENDER_LIDAR_OT_run_file,
    BLENDER_LIDAR_OT_load_example,
    BLENDER_LIDAR_OT_step_frame,
    BLENDER_LIDAR_OT_add,
    BLENDER_LIDAR_OT_scan,
    BLENDER_LIDAR_OT_set_baseline,
    BLENDER_LIDAR_OT_export_cloud,
    BLENDER_LIDAR_OT_export_labelled,
    BLENDER_LIDAR_OT_export_run,
)
