"""Scenes in Blender: cameras and light, rendered pictures, a whole frame built, and saved as a .blend file."""

from __future__ import annotations

import json
import math
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import bpy
import numpy as np
from mathutils import Matrix, Vector

from ...errors import InputError, OutputError
from ...files import whole_file, write_bytes
from ...road.road_map import RoadMap
from ...sensors.beams import BeamLattice
from ...sensors.pose import Pose
from ...signals import stops_end_at_once
from ...traffic.boxes import Boxes
from ...traffic.vehicles import Recording
from ..scenery import Scenery
from .bodies import body_of, kept_body
from .detections import animate_detections, show_detections
from .nodes import math_of, node, output, ramp_of
from .objects import (
    FAN,
    ROAD_ROLE,
    SENSOR,
    SETTINGS,
    STAGE,
    add_object,
    build_lidar,
    build_scenery,
    clear,
    collection,
    frame_of,
    made_once,
    nodes_of,
    role,
    set_inputs,
)
from .points import show_cloud
from .quiet import first_error, quiet
from .road import HAZE, build_road, middle_of
from .traffic import show_recording, show_still

# --- Cameras, light and viewports: a scene that looks right without touching a setting --------------------

ABOVE, FROM_POLE = "From above", "From the pole"
_CLIP_END_M = 4000.0
_CAMERA_ZOOM = 15.0  # the camera's picture fills the viewport
# From the middle of the road to the camera and to what it looks at, in depths: from before the pole up to the horizon.
_ABOVE, _BEYOND, _ABOVE_DEG = (-0.55, -0.42, 0.23), (0.4, 0.1, 0.0), 52.0
_OVER_HEAD_M, _LOOKS_DOWN_RAD = 0.3, math.radians(15.0)  # the same for every tilt, so that pictures can be compared
_SUN_DIRECTION, _SUN_COLOUR, _SUN_STRENGTH = (0.6, -0.3, -0.65), (1.0, 0.9, 0.76), 5.0
_SKY = (HAZE, (0.42, 0.60, 0.86), (0.24, 0.44, 0.78), (0.14, 0.32, 0.68))  # from horizon to zenith


def build_stage(scene: bpy.types.Scene, road: RoadMap, pose: Pose, depth_m: float) -> None:
    """Two cameras and a sun, in place of earlier ones, and a sky where the scene has no world.

    Parameters
    ----------
    road : RoadMap
    pose : Pose
        The mounting: one camera sees it from above, obliquely, the other looks across the road from just over it.
    depth_m : float
        How much of the road the camera above takes in, along it, at the far edge of the carriageway [m].
    """
    into, frame = collection(scene, "Cameras and light", STAGE), frame_of(scene)
    clear(into)
    middle = Vector((*middle_of(road, pose.position[:2], depth_m).tolist(), 0.0))
    x, y, _ = middle - Vector((pose.x_m, pose.y_m, 0.0))
    facing = math.atan2(y, x) if x or y else 0.5 * math.pi  # one over the middle of the road looks to its left
    turn = Matrix.Rotation(facing - 0.5 * math.pi, 3, "Z")
    above, beyond = (middle + depth_m * (turn @ Vector(off)) for off in (_ABOVE, _BEYOND))
    camera = _camera(into, frame, ABOVE, above, beyond, _ABOVE_DEG)
    mount = Vector(pose.position.tolist()) + Vector((0.0, 0.0, _OVER_HEAD_M))
    looks = turn @ Vector((0.0, math.cos(_LOOKS_DOWN_RAD), -math.sin(_LOOKS_DOWN_RAD)))
    _camera(into, frame, FROM_POLE, mount, mount + looks, 100.0)
    sun = add_object(into, "Sun", bpy.data.lights.new("Sun", "SUN"), parent=frame)
    sun.data.energy, sun.data.angle, sun.data.color = _SUN_STRENGTH, math.radians(2.0), _SUN_COLOUR
    sun.rotation_euler = Vector(_SUN_DIRECTION).to_track_quat("-Z", "Y").to_euler()
    if scene.camera is None:  # one of the user's own stays
        scene.camera = camera
    if scene.world is None:
        scene.world = made_once(bpy.data.worlds, STAGE, _sky)


def show_in_viewports(scene: bpy.types.Scene) -> None:
    """Let every 3D viewport of the file look through the scene's camera and show materials."""
    spaces = (space for screen in bpy.data.screens for area in screen.areas for space in area.spaces)
    for space in spaces:
        if space.type == "VIEW_3D":
            space.shading.type, space.clip_end = "MATERIAL", _CLIP_END_M
            space.overlay.show_relationship_lines = False
            space.region_3d.view_perspective, space.region_3d.view_camera_zoom = "CAMERA", _CAMERA_ZOOM


def _camera(into, frame, name, place, target, angle_deg):
    camera = add_object(into, name, bpy.data.cameras.new(name), parent=frame)
    camera.location = place
    camera.rotation_euler = (target - place).to_track_quat("-Z", "Y").to_euler()
    camera.data.angle, camera.data.clip_end = math.radians(angle_deg), _CLIP_END_M
    return camera


def _sky():
    """A sky that is hazy at the horizon: no sky model is the same in all Blenders."""
    world = bpy.data.worlds.new("Sky")
    world.color = HAZE
    tree = nodes_of(world)
    tree.nodes.clear()
    up = node(tree, "ShaderNodeSeparateXYZ", {0: node(tree, "ShaderNodeTexCoord").outputs["Generated"]}).outputs["Z"]
    colour = ramp_of(tree, math_of(tree, "POWER", math_of(tree, "MAXIMUM", up, 0.0), 0.5), _SKY)
    node(tree, "ShaderNodeOutputWorld", {0: output(tree, "ShaderNodeBackground", {0: colour})})
    return world


# --- Pictures of a scene, by Cycles on the processor: the same picture from the same scene, on any machine -

CAMERAS = {"above": ABOVE, "pole": FROM_POLE, "points": ABOVE}  # by the names of the pictures' files
SIZE = (1280, 720)
SAMPLES = 12
_SEED = 1
_CAPTION_PIXELS, _DIM = 24, 0.08
_BOUNCES = 3  # light that has been reflected more often shows in no picture of a road


def render_picture(
    path: str | Path, scene: bpy.types.Scene, camera: str, *, size: tuple[int, int] = SIZE, samples: int = SAMPLES
) -> None:
    """Render a scene through one of its cameras to a PNG file.

    Parameters
    ----------
    path : path
    scene : Scene
    camera : str
        Name of the camera.
    size : (int, int)
        Width and height [pixels].
    samples : int
        Light paths per pixel.

    Raises
    ------
    InputError
        For a camera that the scene does not have, or a Blender without Cycles.
    OutputError
        When the file cannot be written.
    """
    cameras = {item.name: item for item in scene.objects if item.type == "CAMERA"}
    if camera not in cameras:
        raise InputError(f"unknown camera {camera!r}; allowed: {', '.join(cameras) or 'none, the scene has no camera'}")
    scene.camera = cameras[camera]
    for item in scene.objects:
        if role(item) == FAN:  # seen from its own apex it would hide the road
            item.hide_render = camera == FROM_POLE
    _settings(scene, size, samples)
    with tempfile.TemporaryDirectory(prefix="blender_lidar-") as folder:  # in a path of ours nothing is a template
        picture = Path(folder) / "picture.png"
        scene.render.filepath = str(picture)
        try:
            with quiet(), stops_end_at_once():  # Cycles would swallow them and go on
                bpy.ops.render.render(write_still=True, scene=scene.name)
        except RuntimeError as error:
            raise OutputError(f"{path}: cannot be rendered: {first_error(error)}") from error
        write_bytes(path, picture.read_bytes())


def show_points_alone(scene: bpy.types.Scene, caption: str) -> None:
    """Let pictures of a scene show its clouds on black, the rest dim, without ground and fans, and a caption."""
    for item in scene.objects:
        item.visible_camera = role(item) not in (ROAD_ROLE, FAN)
        if item.type == "LIGHT":
            item.data.energy = _DIM
    scene.world = bpy.data.worlds.new("Black")
    set_inputs(scene.world, "BACKGROUND", {"Color": (0.0, 0.0, 0.0, 1.0)})
    render = scene.render
    for name in render.bl_rna.properties.keys():  # noqa: SIM118
        if name.startswith("use_stamp"):
            setattr(render, name, name in ("use_stamp", "use_stamp_note"))
    render.stamp_note_text, render.stamp_font_size = caption, _CAPTION_PIXELS
    render.stamp_background = (0.0, 0.0, 0.0, 1.0)


def join_pictures(path: str | Path, rows: Sequence[Sequence[Path]]) -> None:
    """One PNG file of several pictures of a size, in rows."""

    def pixels(picture):
        image = bpy.data.images.load(str(picture))
        found = np.empty((image.size[1], image.size[0], 4), np.float32)
        image.pixels.foreach_get(found.ravel())
        return found

    joined = np.concatenate([np.concatenate(list(map(pixels, row)), axis=1) for row in rows[::-1]])  # from the bottom
    image = bpy.data.images.new("Joined", joined.shape[1], joined.shape[0])
    image.pixels.foreach_set(joined.ravel())
    with whole_file(path) as temporary:
        image.filepath_raw, image.file_format = str(temporary.resolve()), "PNG"
        image.save()


def _settings(scene, size, samples):
    render = scene.render
    try:
        render.engine = "CYCLES"
    except TypeError as error:
        raise InputError(f"this Blender, {bpy.app.version_string}, has no Cycles to render with") from error
    scene.cycles.device, scene.cycles.samples, scene.cycles.seed = "CPU", samples, _SEED
    scene.cycles.use_adaptive_sampling, scene.cycles.adaptive_threshold = True, 0.03
    denoisers = scene.cycles.bl_rna.properties["denoiser"].enum_items  # those that this Blender was built with
    scene.cycles.use_denoising = "OPENIMAGEDENOISE" in denoisers
    scene.cycles.max_bounces = _BOUNCES
    render.resolution_x, render.resolution_y = size
    render.resolution_percentage = 100
    render.image_settings.file_format, render.image_settings.color_mode = "PNG", "RGB"
    render.image_settings.compression = 90  # pictures are mailed within report.html
    render.use_file_extension = True


# --- A whole scene: road, vehicles, LiDAR and what it saw, in Blender, and as a .blend file ---------------

_LEAST_REACH_M, _HORIZON_M = 120.0, 1500.0  # of the road, and of the ground that hides its end in haze
_SEEN_SHARE, _SEEN_AT_MOST_M = 1.4, 120.0  # of the range gate: how much road the camera above takes in


@dataclass(frozen=True, slots=True, eq=False)
class Moment:
    """What is built: one frame of traffic under one mounting.

    Attributes
    ----------
    road : RoadMap
    vehicles : Boxes
        The frame.
    detail : str
        Level of detail of the vehicles' shapes.
    lattice : BeamLattice
        The sensor's beams.
    pose : Pose
        The mounting.
    range_gate_m : float
        How far the sensor is asked to see [m].
    points : mapping of str to ndarray, or None
        What it saw, as `points.show_cloud` takes it.
    scenery : Scenery or None
        What stands still.
    settings : mapping or None
        The scene file's tables, for the add-on to go on with.
    detections : mapping of int to Boxes
        What a detector found, by the numbers of frames.
    name : str
        What the LiDAR is called.
    further : tuple of Moment
        The same of the other LiDARs of a layout, of which sensor, mounting, points and name count.
    since_s : float
        When the frame is, on the clock of its recording [s].
    bodies : mapping of str to (str, str)
        Bodies of the user's by kind of vehicle: a .blend file and the name of an object or a collection in it.
    """

    road: RoadMap
    vehicles: Boxes
    detail: str
    lattice: BeamLattice
    pose: Pose
    range_gate_m: float
    points: Mapping[str, np.ndarray] | None = None
    scenery: Scenery | None = None
    settings: Mapping[str, object] | None = None
    detections: Mapping[int, Boxes] = field(default_factory=dict)
    name: str = "LiDAR"
    further: tuple[Moment, ...] = ()
    since_s: float = 0.0
    bodies: Mapping[str, tuple[str, str]] = field(default_factory=dict)


def empty_scene() -> bpy.types.Scene:
    """The one scene of a new file, with nothing in it; what Blender held before is gone."""
    with quiet():
        bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    scene = bpy.context.scene
    scene.name = "Road"
    scene.world = None
    scene.unit_settings.system = "METRIC"
    scene.view_settings.view_transform = "Standard"  # the points' colours as their ramps say
    scene.render.resolution_x, scene.render.resolution_y = SIZE
    return scene


def build_scene(scene: bpy.types.Scene, moment: Moment, played: Recording | None = None) -> None:
    """Build a moment in a scene, in place of one that was built there earlier; objects of others stay.

    Its vehicles stand unless they drive through what is `played`, from the first frame of the animation on.
    """
    each = moment, *moment.further
    middle, gate_m = np.mean([one.pose.position for one in each], axis=0), max(one.range_gate_m for one in each)
    away_m = float(max(np.abs(one.pose.position - middle).max() for one in each))
    reach_m = max(_LEAST_REACH_M, gate_m) + away_m
    build_road(scene, moment.road, middle[:2], _HORIZON_M if moment.road.endless else reach_m, _HORIZON_M)
    build_scenery(scene, moment.scenery)
    bodies = {kind: body_of(kept_body(*place, place[0]), place[0]) for kind, place in moment.bodies.items()}
    if played is None:
        show_still(scene, moment.vehicles, moment.detail, bodies)
    else:
        show_recording(scene, played, moment.detail, 0.0, 1.0 / scene.render.fps, bodies, alone=True)
    clear(collection(scene, "LiDAR", SENSOR))
    for number, one in enumerate(each):
        lidar = build_lidar(scene, one.lattice, one.pose, one.name)
        if one.points is not None:
            show_cloud(lidar, one.points)
        if moment.settings is not None:
            starts_s = scene.frame_current_final * scene.render.fps_base / scene.render.fps - moment.since_s
            told = moment.settings | {"frame": moment.vehicles.frame, "number": number, "starts_s": starts_s}
            lidar[SETTINGS] = scene[SETTINGS] = json.dumps(told)
    show_detections(scene, moment.detections.get(moment.vehicles.frame))
    build_stage(scene, moment.road, moment.pose, min(_SEEN_AT_MOST_M, _SEEN_SHARE * gate_m + away_m))
    for layer in scene.view_layers:
        layer.update()


_WHOLE_FRAMES_S = 1e-4
_FPS = (24, 25, 30, 50, 60)  # pictures per second that an animation may have, the first where no other suits


def save_blend(path: str | Path, moment: Moment, played: Recording | None = None) -> None:
    """Write a moment as a .blend file that shows at once what is in it; what Blender held before is gone.

    Parameters
    ----------
    played : Recording, optional
        What the vehicles drive through, at true speed from the first frame of the animation on, and that detections are
        shown of; without it they stand. All its instants lie on whole frames where a usual frame rate allows it.

    Raises
    ------
    OutputError
        When the file cannot be written.
    """
    scene = empty_scene()
    since_s = np.zeros(1) if played is None else played.since_s
    off = {fps: np.abs(since_s * fps - np.round(since_s * fps)).max() for fps in _FPS}
    scene.render.fps = next((fps for fps in _FPS if off[fps] < _WHOLE_FRAMES_S * fps), _FPS[0])
    scene.frame_set(1)
    build_scene(scene, moment, played)
    if played is not None:
        scene.frame_start, scene.frame_end = 1, max(1, 1 + round(since_s[-1] * scene.render.fps))
        animate_detections(scene, moment.detections, played.frames.tolist(), since_s.tolist())
    show_in_viewports(scene)
    files = bpy.context.preferences.filepaths
    backups, files.save_version = files.save_version, 0  # no copy, under another name, of what was in the file's place
    try:  # not packed: an older Blender must be able to tell that the file is too new for it
        with whole_file(path) as temporary, quiet():
            bpy.ops.wm.save_as_mainfile(filepath=str(temporary.resolve()), copy=True, compress=False)
    except RuntimeError as error:
        raise OutputError(f"{path}: cannot be written: {first_error(error)}") from error
    finally:
        files.save_version = backups
