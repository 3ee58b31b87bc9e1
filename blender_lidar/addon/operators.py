"""What the panel's buttons do: load traffic, add a LiDAR, scan and score, set the baseline, export."""

import json
import time
from collections.abc import Callable
from functools import wraps
from pathlib import Path

import bpy
from bpy.props import BoolProperty, EnumProperty, StringProperty
from bpy_extras.io_utils import ExportHelper

from ..casting import resolve
from ..clouds.files import SUSTECHPOINTS_PARTS, write_cloud, write_sustechpoints
from ..clouds.snapshot import MountedSensor, entropy_of_points, entropy_of_vehicles, vertices_of
from ..errors import BlenderLidarError, InputError
from ..files import check_unused, make_folder
from ..names import CLOUD_SUFFIXES
from ..run.folder import RunFolder
from ..run.optimise import evaluate_site
from ..scene.mounting import COORDINATES, leaning, pose_at
from ..scene.scenario import load_scenario, scenario_of
from ..scene.site import check_mount_is_clear, lattice_of, prepare, read_recording, standing_scenery
from ..sensors.pose import Pose
from ..traffic import Recording
from ..traffic.vehicles import Vehicles
from ..world.blender.objects import (
    PART,
    SENSOR,
    SETTINGS,
    build_road,
    collection,
    dress,
    lidars,
    new_lidar,
    remove_orphans,
    role,
)
from ..world.blender.points import colour_cloud, show_cloud
from ..world.blender.site import open_scenery
from ..world.blender.traffic import show_vehicles
from . import properties, session

_LEAST_REACH_M = 120.0  # of the road that is shown


def told(execute: Callable) -> Callable:
    """Let an operator report wrong input in one line and change nothing: the work is checked before it is begun."""

    @wraps(execute)
    def guarded(operator, context):
        try:
            return execute(operator, context)
        except BlenderLidarError as error:
            operator.report({"ERROR"}, " ".join(str(error).split()))
            return {"CANCELLED"}

    return guarded


def has_traffic(context: bpy.types.Context) -> bool:
    """Whether the scene's traffic has been loaded."""
    return context.scene.blender_lidar.loaded


class NeedsTraffic:
    """An operator that is grey until traffic is loaded, and says so."""

    @classmethod
    def poll(cls, context):
        """Whether there is traffic, and a LiDAR."""
        if not has_traffic(context):
            cls.poll_message_set("Load traffic first: the LiDAR tab of the sidebar, Traffic")
            return False
        if session.active_lidar(context.scene) is None:
            cls.poll_message_set("Add a LiDAR first: Add > LiDAR")
            return False
        return True


# --- Traffic ----------------------------------------------------------------------------------------------------------


def show_traffic(scene: bpy.types.Scene, recording: Recording, frame: int) -> None:
    """Show the road and the frame of a recording that is nearest to a number."""
    group = scene.blender_lidar
    scenario = session.scenario_from(scene)
    build_road(scene, scenario.road, max(_LEAST_REACH_M, scenario.sensor.range_gate_m))
    with properties.silently():
        group.loaded, group.frame = True, session.nearest_frame(recording, frame)
    show_frame(scene, recording.vehicles(group.frame))


def show_frame(scene: bpy.types.Scene, vehicles: Vehicles) -> None:
    """Show the vehicles of a frame."""
    show_vehicles(scene, vehicles, scene.blender_lidar.world.detail)
    scene.blender_lidar.at_s = vehicles.time_s


class LIDAR_OT_load(bpy.types.Operator):
    """Read the traffic file, or the scene file, and show its road and vehicles"""

    bl_idname, bl_label, bl_options = "lidar.load", "Load", {"REGISTER", "UNDO"}

    @told
    def execute(self, context):
        """Read it; a scene file fills the panel's fields."""
        scene = context.scene
        path = bpy.path.abspath(scene.blender_lidar.traffic.path)
        if path.lower().endswith(".toml"):
            return _take_over(self, scene, load_scenario(path))
        recording = session.recording_of(scene)
        show_traffic(scene, recording, scene.blender_lidar.frame)
        return _loaded(self, recording)


class LIDAR_OT_load_example(bpy.types.Operator):
    """Load the example: synthetic traffic made to resemble I-80, its road, and a LiDAR beside it"""

    bl_idname, bl_label, bl_options = "lidar.load_example", "Load Example", {"REGISTER", "UNDO"}

    @told
    def execute(self, context):
        """Fill the panel with the shipped scene."""
        return _take_over(self, context.scene, session.example_scenario())


def _take_over(operator, scene, scenario):
    """Fill the panel with a scene file's settings, show its traffic, and let a LiDAR hang there if there is none."""
    session.check_unit(scene)
    recording = read_recording(scenario)
    session.fill_scene(scene, scenario)
    found, tables = session.active_lidar(scene), scenario.as_tables()
    if found is None:  # where what is not searched is as the file says
        found = add_lidar(
            scene, scenario.pose(leaning(scenario.baseline, **scenario.deployment.fixed)), tables["sensor"]
        )
    else:
        properties.fill_sensor(found, tables["sensor"])
        dress(found, lattice_of(scenario.sensor))
    properties.fill_bounds(found, tables["deployment"])
    session.keep(scene, recording)
    ids = scenario.traffic.frame_ids
    show_traffic(scene, recording, ids[0] if ids else int(recording.frames[len(recording.frames) // 2]))
    return _loaded(operator, recording)


def _loaded(operator, recording):
    operator.report({"INFO"}, f"{len(recording.frames)} frames with {len(recording):,} boxes")
    return {"FINISHED"}


class LIDAR_OT_step_frame(NeedsTraffic, bpy.types.Operator):
    """Show the next or the previous frame of the recording"""

    bl_idname, bl_label, bl_options = "lidar.step_frame", "Step", {"REGISTER", "UNDO"}
    back: BoolProperty(default=False, options={"SKIP_SAVE"})

    @told
    def execute(self, context):
        """Go there."""
        scene = context.scene
        frames = session.recording_of(scene).frames
        at = int(frames.searchsorted(scene.blender_lidar.frame)) + (-1 if self.back else 1)
        scene.blender_lidar.frame = int(frames[min(max(at, 0), len(frames) - 1)])
        return {"FINISHED"}


# --- LiDARs -----------------------------------------------------------------------------------------------------------


def add_lidar(scene: bpy.types.Scene, pose: Pose, sensor: dict | None = None) -> bpy.types.Object:
    """A new LiDAR at a mounting, dressed, with [sensor] of a scene or the usual one."""
    lidar = new_lidar(collection(scene, "LiDAR", SENSOR), pose)
    lidar.lidar.schema = properties.SCHEMA
    if sensor is not None:
        properties.fill_sensor(lidar, sensor)
    dress(lidar, lattice_of(session.sensor_of(lidar)))
    scene.blender_lidar.active = lidar.name
    return lidar


class LIDAR_OT_add(bpy.types.Operator):
    """Add a LiDAR on a pole at the 3D cursor, at least as high as the baseline"""

    bl_idname, bl_label, bl_options = "lidar.add", "LiDAR", {"REGISTER", "UNDO"}

    @told
    def execute(self, context):
        """Add it, selected."""
        scene = context.scene
        session.check_unit(scene)
        into = collection(scene, "LiDAR", SENSOR)
        if not _shows(context.view_layer.layer_collection, into):
            raise InputError(f"collection {into.name} is excluded from this view layer; tick it in the Outliner")
        x, y, z = scene.cursor.location
        place = {**dict.fromkeys(COORDINATES, 0.0), "x_m": x, "y_m": y}
        place["height_m"] = max(z, properties.exact(scene.blender_lidar.baseline.height_m))
        lidar = add_lidar(scene, pose_at(place, properties.sloping(scene)))
        for item in context.selected_objects:
            item.select_set(False)
        context.view_layer.objects.active = lidar
        lidar.select_set(True)
        return {"FINISHED"}


def _shows(layer: bpy.types.LayerCollection, of: bpy.types.Collection) -> bool:
    """Whether a view layer holds a collection."""
    return not layer.exclude and (layer.collection == of or any(_shows(child, of) for child in layer.children))


class LIDAR_OT_choose(bpy.types.Operator):
    """Make this LiDAR the active object"""

    bl_idname, bl_label, bl_options = "lidar.choose", "Choose", {"REGISTER", "UNDO"}
    name: StringProperty(options={"SKIP_SAVE"})

    def execute(self, context):
        """Choose it."""
        scene = context.scene
        lidar = scene.objects.get(self.name)
        if lidar is None or lidar.name not in context.view_layer.objects:
            self.report({"ERROR"}, f"no LiDAR {self.name!r} in this view layer")
            return {"CANCELLED"}
        scene.blender_lidar.active = lidar.name
        context.view_layer.objects.active = lidar
        return {"FINISHED"}


def adopt(scene: bpy.types.Scene) -> None:
    """Take over LiDARs that were built without the add-on, and dress those that were duplicated bare."""
    remove_orphans(scene)
    stored = scene.get(SETTINGS)
    if stored and scene.blender_lidar.schema == 0:
        _fill_from(scene, _stored(scene))
    for lidar in lidars(scene):
        if lidar.lidar.schema == 0:
            if SETTINGS in lidar:
                tables = _stored(lidar)
                properties.fill_sensor(lidar, tables["sensor"])
                properties.fill_bounds(lidar, tables["deployment"])
            lidar.lidar.schema = properties.SCHEMA
        if not any(role(child) == PART for child in lidar.children):
            dress(lidar, lattice_of(session.sensor_of(lidar)))


def _stored(block):
    """The settings that `build` wrote with a scene or a LiDAR."""
    try:
        return json.loads(block[SETTINGS])
    except (TypeError, ValueError) as error:
        raise InputError(f"{block.name}: its property {SETTINGS} is damaged: {error}") from error


def _fill_from(scene, tables):
    """Take over what `build` wrote into a scene: its settings and the frame that it shows."""
    group = scene.blender_lidar
    known = {name: table for name, table in tables.items() if name in properties.DECLARED}
    scenario = scenario_of(known, source=f"scene {scene.name}")
    with properties.silently():  # its LiDARs hang beside that road already
        session.fill_scene(scene, scenario)
        properties.hang_as_they_are(scene)
        group.loaded, group.frame = Path(scenario.traffic.path).is_file(), tables["frame"]


# --- Scan and score ---------------------------------------------------------------------------------------------------


class LIDAR_OT_scan(NeedsTraffic, bpy.types.Operator):
    """Cast one revolution from the LiDAR: its cloud, and what the vehicles are worth under it"""

    bl_idname, bl_label, bl_options = "lidar.scan", "Scan", {"REGISTER", "UNDO"}

    @told
    def execute(self, context):
        """Scan exactly, check the place, and show the cloud."""
        scene = context.scene
        lidar = session.needed_lidar(scene)
        place = properties.coordinates_of(lidar)
        scenario, vehicles = session.scenario_from(scene, lidar), session.vehicles_of(scene)
        check_mount_is_clear(scenario, [vehicles], {lidar.name: place})
        ready = session.live_frame(scene, lidar)
        objects = session.exact_objects(scene, context.view_layer, scenario)
        look = ready.look(scenario.pose(place), objects)
        bits = entropy_of_vehicles(look.cloud, vehicles, scenario.objective)
        points = vertices_of(look.cloud, entropy_of_points(look.cloud, vehicles, bits))
        colour_cloud(show_cloud(lidar, points), lidar.lidar.colour_by)
        started, group = time.perf_counter(), lidar.lidar
        session.store(lidar, vehicles, place, look, ready.look(scenario.baseline_pose, objects))
        group.look_s = time.perf_counter() - started
        told_of = "" if look.scored is None else f", objective {group.objective:.2f}"
        self.report({"INFO"}, f"{lidar.name}: {group.points:,} points on frame {vehicles.frame}{told_of}")
        return {"FINISHED"}


class LIDAR_OT_set_baseline(NeedsTraffic, bpy.types.Operator):
    """Make the LiDAR's mounting the baseline that gains are measured against"""

    bl_idname, bl_label, bl_options = "lidar.set_baseline", "Set as Baseline", {"REGISTER", "UNDO"}

    @told
    def execute(self, context):
        """Take the pose over."""
        place = properties.coordinates_of(session.needed_lidar(context.scene))
        properties.fill(context.scene.blender_lidar.baseline, properties.SIX, place)
        return {"FINISHED"}


# --- Export -----------------------------------------------------------------------------------------------------------


def _mounted(scene: bpy.types.Scene) -> tuple[MountedSensor, Vehicles]:
    """The active LiDAR as the command line's `scan` has it, and the frame that is shown."""
    lidar = session.needed_lidar(scene)
    scenario, place = session.scenario_from(scene, lidar), properties.coordinates_of(lidar)
    vehicles = session.vehicles_of(scene)
    check_mount_is_clear(scenario, [vehicles], {lidar.name: place})
    caster = resolve(scenario.model.caster, "caster")
    scenery = standing_scenery(scenario, caster, place, open_scenery(scene, bpy.context.view_layer))
    return MountedSensor(scenario, place, lattice_of(scenario.sensor), caster, scenery), vehicles


class LIDAR_OT_export_cloud(NeedsTraffic, bpy.types.Operator, ExportHelper):
    """Write the cloud of the frame that is shown"""

    bl_idname, bl_label = "lidar.export_cloud", "Export Cloud"
    filename_ext: EnumProperty(name="Format", items=[(name, name[1:].upper(), "") for name in CLOUD_SUFFIXES])

    @told
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


class LIDAR_OT_export_labelled(NeedsTraffic, FolderHelper, bpy.types.Operator):
    """Write the cloud of the frame that is shown, and its boxes as labels, as SUSTechPOINTS has them"""

    bl_idname, bl_label = "lidar.export_labelled", "Export Labelled Set"

    @told
    def execute(self, context):
        """Scan and write; frames of earlier exports stay."""
        sensor, vehicles = _mounted(context.scene)
        cloud = sensor.scan(vehicles)
        make_folder(Path(self.directory), "folder")
        write_sustechpoints(self.directory, cloud, vehicles, sensor.cloud_header(vehicles))
        parts = " and ".join(SUSTECHPOINTS_PARTS)
        self.report({"INFO"}, f"{self.directory}: frame {vehicles.frame} in {parts}")
        return {"FINISHED"}


class LIDAR_OT_export_run(NeedsTraffic, FolderHelper, bpy.types.Operator):
    """Score the mounting on all searched and held-out frames, as the command line's evaluate, into an empty folder"""

    bl_idname, bl_label = "lidar.export_run", "Export Run Folder"

    @told
    def execute(self, context):
        """Evaluate the mounting."""
        scene = context.scene
        lidar = session.needed_lidar(scene)
        place = properties.coordinates_of(lidar)
        check_unused(Path(self.directory), "folder", "run")
        objects = open_scenery(scene, context.view_layer)
        scenario, recordings = session.scenario_from(scene, lidar), [session.recording_of(scene)]
        site = prepare(scenario, place, scenery=objects, recordings=recordings)
        with RunFolder(self.directory).locked() as folder:
            result = evaluate_site(site, folder, place)
        self.report({"INFO"}, f"{self.directory}: objective {result['objective']:.1f} {result['metric_unit']}")
        return {"FINISHED"}


classes = (
    LIDAR_OT_load,
    LIDAR_OT_load_example,
    LIDAR_OT_step_frame,
    LIDAR_OT_add,
    LIDAR_OT_choose,
    LIDAR_OT_scan,
    LIDAR_OT_set_baseline,
    LIDAR_OT_export_cloud,
    LIDAR_OT_export_labelled,
    LIDAR_OT_export_run,
)
