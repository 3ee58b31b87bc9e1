"""Live preview: while a LiDAR is moved its cloud, its score and the vehicles' colours follow, drawn by the GPU.

What changes is marked by handlers and looked at by a timer, in one go for all events between two redraws. The user's
own objects occlude at preview quality here; Scan, Score and Optimise cast against their exact triangles.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import bpy
import numpy as np
from bpy.app.handlers import persistent

from ..clouds.live import LiveFrame, Look
from ..clouds.scan import joined_clouds
from ..clouds.snapshot import entropy_of_vehicles, vertices_of
from ..errors import BlenderLidarError
from ..scene.scenario import Scenario
from ..traffic.vehicles import Vehicles
from ..world.blender.objects import SHAPE, VEHICLE, VEHICLE_ID, frame_of, lidars, role, wear_own_paint
from ..world.blender.points import STYLES, cloud_of, colour_cloud, colours_by, set_style, show_cloud
from ..world.blender.preview import VisibleObjects
from ..world.blender.traffic import colour_vehicles
from . import properties, session

classes = ()
_POINT_SIZE = 3.0  # [pixels]
_OWN_POINTS = (4, 5)  # from there on a shader for points, as not every GPU interface knows their size otherwise
_PAUSE_S = 0.005  # Blender handles the next events and redraws in between


@dataclass(eq=False)
class _Shown:
    """What is kept of a LiDAR that is live."""

    scene: str
    seen: object = None  # place, frame and objects that it was looked at with
    frame: LiveFrame | None = None
    scenario: Scenario | None = None
    baseline: Look | None = None
    look: Look | None = None
    problem: str = ""
    bits: np.ndarray | None = None  # of every vehicle
    colours: np.ndarray | None = None
    batch: object = None


@dataclass(eq=False)
class _State:
    """What is kept beside Blender's data, by the `session_uid` of LiDARs and scenes."""

    shown: dict[str, _Shown] = field(default_factory=dict)
    objects: dict[str, VisibleObjects] = field(default_factory=dict)
    drawing: object = None


_state = _State()


# --- What is live, and what each update does --------------------------------------------------------------------------


def update() -> None:
    """Look again from every live LiDAR of the scenes that are open in windows, where anything has changed."""
    live = set()
    for scene, layer in _open_scenes():
        found = lidars(scene)
        together = any(lidar.blender_lidar.live and lidar.blender_lidar.in_layout for lidar in found)
        mine = [one for one in found if one.blender_lidar.live or (together and one.blender_lidar.in_layout)]
        live |= {session.uid_of(lidar) for lidar in mine}
        if not mine:
            continue
        key = session.uid_of(scene)
        objects = _state.objects.setdefault(key, VisibleObjects())
        layer.update()  # instances of objects that have gone since would crash Blender
        try:
            objects.refresh(scene, layer.depsgraph)
        except BlenderLidarError as error:
            objects.forget()  # so that all is looked at again
            _tell(scene, str(error))
            continue
        problems, moved = [], False
        for lidar in mine:
            shown = _state.shown.get(session.uid_of(lidar))
            if shown is None:
                shown = _state.shown[session.uid_of(lidar)] = _begin(scene, layer, lidar)
            try:
                if _update_one(scene, lidar, shown, objects):
                    shown.problem, moved = "", True
            except BlenderLidarError as error:
                shown.problem, moved = " ".join(str(error).split()), True
            problems += [shown.problem] if shown.problem else []
        if moved:
            try:
                _update_layout(
                    scene, next((session.layout_of(scene, one) for one in mine if one.blender_lidar.in_layout), [])
                )
            except BlenderLidarError as error:
                problems.append(" ".join(str(error).split()))
            _tell(scene, problems[0] if problems else "")
    for key in set(_state.shown) - live:
        _end(key, _state.shown.pop(key))
    _draw_if(bool(_state.shown))


def _tell(scene, problem) -> None:
    """Say at the top of the tab what is wrong; what is set is drawn again."""
    if scene.blender_lidar.problem != problem:
        scene.blender_lidar.problem = problem


def _open_scenes() -> list[tuple[bpy.types.Scene, bpy.types.ViewLayer]]:
    """Scenes in windows with what each window shows of them; without windows the scene in use."""
    manager = bpy.context.window_manager
    windows = [] if bpy.app.background or manager is None else manager.windows
    found = {window.scene.name_full: (window.scene, window.view_layer) for window in windows}
    return list(found.values()) or [(bpy.context.scene, bpy.context.view_layer)]


def _update_one(scene, lidar, shown, objects) -> bool:
    """Look from a LiDAR unless it was looked at as it is now; whether that was done."""
    group, mounting = lidar.blender_lidar, properties.mounting_of(lidar)
    now = mounting, session.since_of(scene), objects.state, group.colour_by
    if now == shown.seen:
        return False
    shown.seen = now
    vehicles = session.vehicles_of(scene)
    frame = shown.frame
    same = frame is not None and session.moment_key(frame.frame.vehicles) == session.moment_key(vehicles)
    if not same or session.dragged_off(lidar, mounting):
        shown.scenario, shown.baseline = session.scenario_from(scene, lidar), None
        frame = shown.frame = session.live_frame(scene, lidar)
    if shown.baseline is None:
        shown.baseline = frame.look(shown.scenario.baseline.pose, [objects]) if frame.scoring else None
    shown.look = look = frame.look(mounting.pose, [objects])
    shown.bits = entropy_of_vehicles(look.cloud, vehicles, shown.scenario.objective)
    shown.colours = colours_by(group.colour_by, vertices_of(look.cloud, vehicles, shown.bits))
    shown.batch = None
    session.store(lidar, vehicles, look, shown.baseline or look)
    if lidar == session.active_lidar(scene):
        colour_vehicles(*_coloured(scene, vehicles, shown.bits))
    redraw()
    return True


def _update_layout(scene, hung) -> None:
    """Fuse what the LiDARs of a layout have looked at last; nothing is said of it while one of them cannot look."""
    shown = [_state.shown[session.uid_of(one)] for one in hung]
    scene.blender_lidar.fused = ""
    if len(shown) < 2 or any(one.problem for one in shown):
        return
    looks = [(one.look, one.baseline or one.look) for one in shown]
    cloud = joined_clouds([one.look.cloud for one in shown])
    session.store_layout(scene, hung, [one.frame for one in shown], looks)
    if session.active_lidar(scene) in hung:
        vehicles = shown[0].frame.frame.vehicles
        bits = entropy_of_vehicles(cloud, vehicles, shown[0].scenario.objective)
        colour_vehicles(*_coloured(scene, vehicles, bits))


def _coloured(scene: bpy.types.Scene, vehicles: Vehicles, bits: np.ndarray):
    """The objects of a frame's vehicles, and the entropy of each."""
    row = {str(number): at for at, number in enumerate(vehicles.vehicle_id.tolist())}
    items = [item for item in scene.objects if role(item) == VEHICLE and item.get(VEHICLE_ID) in row]
    return items, bits[[row[item[VEHICLE_ID]] for item in items]]


def _begin(scene, layer, lidar) -> _Shown:
    """What was measured before is not shown while a LiDAR is live, and solid views show the colours of objects."""
    cloud = cloud_of(lidar)
    if cloud is not None and cloud.name in layer.objects:
        cloud.hide_set(True, view_layer=layer)
    for item in scene.objects:  # what else is ours keeps its look
        if role(item) not in (None, VEHICLE):
            wear_own_paint(item)
    _colour_solid("MATERIAL", "OBJECT")
    return _Shown(session.uid_of(scene))


def _end(key: str, shown: _Shown) -> None:
    """Let Blender's own points stand for what was drawn last, and vehicles have their paint again."""
    for scene, layer in _open_scenes():
        for lidar in lidars(scene):
            if session.uid_of(lidar) != key:
                continue
            if shown.look is not None and shown.frame is not None:  # not where undo has ended it
                vehicles = shown.frame.frame.vehicles
                points = vertices_of(shown.look.cloud, vehicles, shown.bits)
                show_cloud(lidar, points, lidar.blender_lidar.colour_by, lidar.blender_lidar.style)
            cloud = cloud_of(lidar)
            if cloud is not None and cloud.name in layer.objects:
                cloud.hide_set(False, view_layer=layer)
        if not any(one.scene == session.uid_of(scene) for one in _state.shown.values()):
            colour_vehicles([item for item in scene.objects if role(item) == VEHICLE and SHAPE in item], None)
    if not _state.shown:
        _colour_solid("OBJECT", "MATERIAL")
    redraw()


# --- Drawing ----------------------------------------------------------------------------------------------------------


def _views():
    manager = bpy.context.window_manager
    for window in [] if bpy.app.background or manager is None else manager.windows:
        yield from (area for area in window.screen.areas if area.type == "VIEW_3D")


def redraw() -> None:
    """Draw all 3D views again."""
    for area in _views():
        area.tag_redraw()


def _colour_solid(of: str, to: str) -> None:
    """Let views that show the colours `of` materials or objects in solid mode show the others."""
    for area in _views():
        for space in area.spaces:
            if space.type == "VIEW_3D" and space.shading.color_type == of:
                space.shading.color_type = to


def _draw_if(wanted: bool) -> None:
    """Have the views draw, or no more."""
    if wanted and _state.drawing is None and not bpy.app.background:
        _state.drawing = bpy.types.SpaceView3D.draw_handler_add(_draw, (), "WINDOW", "POST_VIEW")
    elif not wanted and _state.drawing is not None:
        bpy.types.SpaceView3D.draw_handler_remove(_state.drawing, "WINDOW")
        _state.drawing = None


def _shader_name():
    """What draws points of a colour each: Blender 4.0 and 4.5 gave it other names."""
    if bpy.app.version < (4, 0):
        return "3D_FLAT_COLOR"
    return "POINT_FLAT_COLOR" if bpy.app.version >= _OWN_POINTS else "FLAT_COLOR"


def _draw() -> None:
    """Draw the points of all live LiDARs of the scene that the view shows."""
    import gpu  # of no use without a window
    from gpu_extras.batch import batch_for_shader

    scene, scale = session.uid_of(bpy.context.scene), bpy.context.scene.unit_settings.scale_length
    frame = frame_of(bpy.context.scene)
    shader = gpu.shader.from_builtin(_shader_name())
    if bpy.app.version >= _OWN_POINTS:
        shader.uniform_float("size", _POINT_SIZE)
    gpu.state.depth_test_set("LESS_EQUAL")
    gpu.state.point_size_set(_POINT_SIZE)
    gpu.matrix.push()
    if frame is not None:
        gpu.matrix.multiply_matrix(frame.matrix_world)
    for shown in _state.shown.values():
        if shown.scene != scene or shown.look is None:
            continue
        if shown.batch is None:
            places = np.ascontiguousarray(shown.look.cloud.xyz / scale, dtype=np.float32)
            shown.batch = batch_for_shader(shader, "POINTS", {"pos": places, "color": shown.colours})
        shown.batch.draw(shader)
    gpu.matrix.pop()
    gpu.state.point_size_set(1.0)
    gpu.state.depth_test_set("NONE")


# --- Events that mark a change ----------------------------------------------------------------------------------------


@persistent
def on_update(scene, depsgraph=None, *_) -> None:
    """Mark what Blender has evaluated again."""
    for objects in () if depsgraph is None else _state.objects.values():
        objects.heed(depsgraph.updates)
    _soon()


@persistent
def on_other_time(*_) -> None:
    """Mark all: another file, another moment, or another state from the history of undo."""
    for shown in _state.shown.values():
        shown.seen = shown.frame = None
    for objects in _state.objects.values():
        objects.forget()
    _soon()


@persistent
def on_load(*_) -> None:
    """Let go of what was drawn of the file before."""
    _state.shown.clear()
    _state.objects.clear()
    _draw_if(False)
    _soon()


def on_change(block: bpy.types.ID, table: str) -> None:
    """A property of the panel has changed."""
    if table not in ("live", "look", "style"):
        on_other_time()
    elif bpy.app.background:
        update()
    cloud = cloud_of(block) if table in ("look", "style") else None
    if table == "style":
        if cloud is not None:
            set_style(cloud, block.blender_lidar.style)
        block.blender_lidar.colour_by = STYLES[block.blender_lidar.style][0]
    elif cloud is not None:
        colour_cloud(cloud, block.blender_lidar.colour_by)
    _soon()


def _soon() -> None:
    """Update once Blender has handled what it is at."""
    if bpy.app.background or bpy.app.timers.is_registered(update):
        return
    if _state.shown or any(lidar.blender_lidar.live for scene, _ in _open_scenes() for lidar in lidars(scene)):
        bpy.app.timers.register(update, first_interval=_PAUSE_S)


app_handlers = {
    "depsgraph_update_post": on_update,
    "frame_change_post": on_other_time,
    "undo_post": on_other_time,
    "redo_post": on_other_time,
    "load_post": on_load,
}


def register() -> None:
    """Listen."""
    properties.ON_CHANGE.append(on_change)


def unregister() -> None:
    """Listen and draw no more."""
    properties.ON_CHANGE.remove(on_change)
    on_load()
    if bpy.app.timers.is_registered(update):
        bpy.app.timers.unregister(update)
