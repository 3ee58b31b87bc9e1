"""Live preview: while a LiDAR is moved its cloud, its score and the vehicles' colours follow, drawn by the GPU.

What changes is marked by handlers and looked at by a timer, in one go for all events between two redraws. The user's
own objects occlude at preview quality here; Scan, Score and Optimise cast against their exact triangles. The cloud in
Blender's data is hidden meanwhile; before a save or a render, and at the end, what was seen last is written into it.
"""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import dataclass, field

import bpy
import numpy as np
from bpy.app.handlers import persistent
from mathutils import Euler

from ..clouds.live import LiveFrame, Look
from ..clouds.scan import joined_clouds
from ..clouds.snapshot import entropy_of_vehicles, vertices_of
from ..errors import BlenderLidarError, one_line
from ..scene.mount_checks import check_mount_is_clear
from ..scene.scenario import Scenario
from ..traffic.boxes import Boxes
from ..world.blender.objects import check_local, frame_of
from ..world.blender.points import STYLES, cloud_of, colours_by, colours_of, set_look, set_style, show_cloud
from . import properties, scenarios, session
from .preferences import preference
from .preview import VisibleObjects

classes = ()
_OWN_POINTS = (4, 5)  # from there on a shader for points, as not every GPU interface knows their size otherwise
_PAUSE_S = 0.005  # Blender handles the next events and redraws in between
_BOX_ALPHA, _BOX_GAP_M = 0.25, 0.05  # of the faces of vehicles' boxes; how far they stand off
_VIEW_TILT, _VIEW_TURN, _VIEW_MOST_M = 1.0, -0.35, 60.0  # how a site is looked at: from behind the LiDAR, obliquely


@dataclass(eq=False)
class _Shown:
    """What is kept of a LiDAR that is live."""

    seen: object = None  # place, time and objects that it was looked at with
    since_s: float = 0.0
    frame: LiveFrame | None = None
    scenario: Scenario | None = None
    baseline: Look | None = None
    look: Look | None = None
    problem: str = ""
    bits: np.ndarray | None = None  # of every vehicle
    colours: np.ndarray | None = None
    batch: object = None
    cloud: str = ""  # name of the object that is hidden meanwhile


@dataclass(eq=False)
class _Boxes:
    """The vehicles of a scene, to be drawn in the colours of their entropy."""

    vehicles: Boxes
    bits: np.ndarray
    batches: tuple | None = None


@dataclass(eq=False)
class _State:
    """What is kept beside Blender's data, by the `session_uid` of LiDARs and scenes."""

    shown: dict[str, _Shown] = field(default_factory=dict)
    boxes: dict[str, _Boxes] = field(default_factory=dict)
    objects: dict[str, VisibleObjects] = field(default_factory=dict)
    reshaped: set[str] = field(default_factory=set)  # scenes with vehicles' own bodies that were edited
    drawing: object = None
    rendering: bool = False


_state = _State()


# --- What is live, and what each update does --------------------------------------------------------------------------


@properties.guarded
def update(graph: bpy.types.Depsgraph | None = None) -> None:
    """Look again from every live LiDAR of the scenes that are open in windows, where anything has changed.

    `graph` is what a renderer has evaluated; without it nothing is looked at while it renders.
    """
    if _state.rendering and graph is None:
        return
    live = {}
    for scene, layer in _open_scenes():
        mine = _live_in(scene)
        live |= {scenarios.uid_of(lidar): lidar for lidar in mine}
        if not mine:
            _state.boxes.pop(scenarios.uid_of(scene), None)
            continue
        objects = _state.objects.get(scenarios.uid_of(scene))
        if objects is None:
            objects = _state.objects[scenarios.uid_of(scene)] = VisibleObjects()
        try:
            if graph is None:
                _read_bodies(scene)
                layer.update()  # instances of objects that have gone since would crash Blender
            objects.refresh(scene, graph or layer.depsgraph)
        except BlenderLidarError as error:
            objects.forget()  # so that all is looked at again
            properties.tell(scene, str(error))
            continue
        problems, moved = [], False
        for lidar in mine:
            shown = _state.shown.setdefault(scenarios.uid_of(lidar), _Shown())
            try:
                if _update_one(scene, lidar, shown, objects, graph):
                    shown.problem, moved = "", True
            except BlenderLidarError as error:
                shown.problem, moved = one_line(str(error)), True
            problems += [shown.problem] if shown.problem else []
        if moved:
            redraw()
            try:
                _update_layout(
                    scene, next((scenarios.layout_of(scene, one) for one in mine if one.blender_lidar.in_layout), [])
                )
            except BlenderLidarError as error:
                problems.append(one_line(str(error)))
            properties.tell(scene, problems[0] if problems else "")
    for key in set(_state.shown) - live.keys():
        _end(key)
    if graph is None:
        hide_clouds()
    _draw_if(bool(_state.shown))


def _read_bodies(scene):
    """Read vehicles' own bodies again, where one was edited."""
    if scenarios.uid_of(scene) in _state.reshaped:
        _state.reshaped.discard(scenarios.uid_of(scene))
        session.bodies_shown(scene, again=True)
        for shown in _state.shown.values():
            shown.seen = shown.frame = None


def _live_in(scene):
    """The LiDARs of a scene that are looked at: those that are live, and all of a layout of which one is."""
    found = scenarios.lidars_of(scene)
    together = any(lidar.blender_lidar.live and lidar.blender_lidar.in_layout for lidar in found)
    return [one for one in found if one.blender_lidar.live or (together and one.blender_lidar.in_layout)]


def _open_scenes() -> list[tuple[bpy.types.Scene, bpy.types.ViewLayer]]:
    """Scenes in windows with what each window shows of them; without windows the scene in use."""
    manager = bpy.context.window_manager
    windows = [] if bpy.app.background or manager is None else manager.windows
    found = {window.scene.name_full: (window.scene, window.view_layer) for window in windows}
    return list(found.values()) or [(bpy.context.scene, bpy.context.view_layer)]


def _update_one(scene, lidar, shown, objects, graph) -> bool:
    """Look from a LiDAR unless it was looked at as it is now; whether that was done."""
    check_local(lidar)
    group, mounting = lidar.blender_lidar, properties.mounting_of(lidar, depsgraph=graph)
    since_s = session.since_of(scene)
    now = mounting, since_s, session.is_traffic_shown(scene), objects.state, group.colour_by
    if now == shown.seen:
        return False
    shown.seen = now
    if shown.frame is None or shown.since_s != since_s or session.dragged_off(lidar, mounting):
        shown.frame, shown.since_s = session.live_frame(scene, lidar, depsgraph=graph), since_s
        shown.scenario, shown.baseline = scenarios.scenario_from(scene, lidar), None
    frame, vehicles = shown.frame, shown.frame.frame
    if scenarios.has_road(scene):
        check_mount_is_clear(shown.scenario, shown.scenario.lidar, [vehicles], {lidar.name: mounting})
    if shown.baseline is None:
        shown.baseline = frame.look(shown.scenario.lidar.baseline.pose, [objects]) if frame.scoring else None
    shown.look = look = frame.look(mounting.pose, [objects])
    shown.bits = entropy_of_vehicles(look.cloud, vehicles, shown.scenario.objective, look)
    shown.colours = colours_by(group.colour_by, vertices_of(look.cloud, vehicles, shown.bits))
    shown.batch = None
    session.store(lidar, vehicles, look, shown.baseline or look)
    if lidar == scenarios.active_lidar(scene):
        _state.boxes[scenarios.uid_of(scene)] = _Boxes(vehicles, shown.bits)
    return True


def _update_layout(scene, hung) -> None:
    """Fuse what the LiDARs of a layout have looked at last; nothing is said of it while one of them cannot look."""
    shown = [_state.shown[scenarios.uid_of(one)] for one in hung]
    if scene.blender_lidar.fused:
        scene.blender_lidar.fused = ""
    if len(shown) < 2 or any(one.problem for one in shown):
        return
    looks = [(one.look, one.baseline or one.look) for one in shown]
    cloud = joined_clouds([one.look.cloud for one in shown])
    session.store_layout(scene, hung, [one.frame for one in shown], looks)
    if scenarios.active_lidar(scene) in hung:
        vehicles = shown[0].frame.frame
        bits = entropy_of_vehicles(cloud, vehicles, shown[0].scenario.objective)
        _state.boxes[scenarios.uid_of(scene)] = _Boxes(vehicles, bits)


# --- Blender's own points: hidden while live, and current whenever they are shown -------------------------------------


def hide_clouds(*_) -> None:
    """Hide the clouds of live LiDARs, which the GPU draws; one is made where there is none yet."""
    for lidar, layer, shown in _looked_at():
        if (cloud := _cloud(lidar, shown)) is None and shown.look is not None:
            cloud = _write(lidar, shown)
        _hide(cloud, layer, hidden=True)


def _hide(cloud, layer, *, hidden):
    if cloud is not None and cloud.hide_get(view_layer=layer) != hidden:
        with suppress(RuntimeError):  # it is in no collection of this view layer
            cloud.hide_set(hidden, view_layer=layer)


def write_clouds(graph: bpy.types.Depsgraph | None = None) -> None:
    """Let the clouds of live LiDARs be what was seen last, where a renderer has evaluated `graph`."""
    for lidar, _layer, shown in _looked_at():
        _write(lidar, shown, graph)


def _looked_at():
    """LiDARs that are live, with a view layer that shows them and what is kept of each."""
    for scene, layer in _open_scenes():
        for lidar in scenarios.lidars_of(scene):
            if lidar.library is None and scenarios.uid_of(lidar) in _state.shown:
                yield lidar, layer, _state.shown[scenarios.uid_of(lidar)]


def _cloud(lidar, shown):
    """The cloud of a LiDAR, without a look at all objects where it is known."""
    cloud = bpy.data.objects.get(shown.cloud)
    if cloud is None or cloud.parent != lidar:
        cloud = cloud_of(lidar)
        shown.cloud = "" if cloud is None else cloud.name
    return cloud


def _write(lidar, shown, graph=None):
    """Let a cloud be what was seen last, but where undo has ended it, or the LiDAR cannot look."""
    if shown.look is not None and shown.frame is not None and not shown.problem:
        points = vertices_of(shown.look.cloud, shown.frame.frame, shown.bits)
        return show_cloud(lidar, points, lidar.blender_lidar.colour_by, lidar.blender_lidar.style, graph)
    return _cloud(lidar, shown)


def _end(key: str) -> None:
    """Let Blender's own points stand for what was drawn last."""
    for lidar, layer, shown in _looked_at():
        if scenarios.uid_of(lidar) == key:
            _hide(_write(lidar, shown), layer, hidden=False)
    del _state.shown[key]
    redraw()


# --- Views, and drawing -----------------------------------------------------------------------------------------------


def _views():
    manager = bpy.context.window_manager
    for window in [] if bpy.app.background or manager is None else manager.windows:
        yield from (area for area in window.screen.areas if area.type == "VIEW_3D")


def redraw() -> None:
    """Draw all 3D views again."""
    for area in _views():
        area.tag_redraw()


def frame_site(lidar: bpy.types.Object, reach_m: float) -> None:
    """Let 3D views that do not look through a camera show a LiDAR and the traffic within its reach [m]."""
    _, y, _ = lidar.matrix_world.to_3x3().col
    reach_m = min(reach_m, _VIEW_MOST_M)
    for area in _views():
        view = area.spaces.active.region_3d
        if view.view_perspective != "CAMERA":
            x, y_, z = lidar.matrix_world.translation
            ahead = math.atan2(y.y, y.x)
            view.view_location = x + 0.2 * reach_m * math.cos(ahead), y_ + 0.2 * reach_m * math.sin(ahead), 0.5 * z
            view.view_distance = 1.2 * reach_m
            view.view_rotation = Euler((_VIEW_TILT, 0.0, ahead - 0.5 * math.pi + _VIEW_TURN)).to_quaternion()


def _draw_if(wanted: bool) -> None:
    """Have the views draw, or no more."""
    if wanted and _state.drawing is None and not bpy.app.background:
        calls = {"POST_VIEW": _draw, "POST_PIXEL": _draw_score}
        _state.drawing = [bpy.types.SpaceView3D.draw_handler_add(call, (), "WINDOW", at) for at, call in calls.items()]
    elif not wanted and _state.drawing is not None:
        for handle in _state.drawing:
            bpy.types.SpaceView3D.draw_handler_remove(handle, "WINDOW")
        _state.drawing = None


def _shader_name():
    """What draws points of a colour each: Blender 4.0 and 4.5 gave it other names."""
    if bpy.app.version < (4, 0):
        return "3D_FLAT_COLOR"
    return "POINT_FLAT_COLOR" if bpy.app.version >= _OWN_POINTS else "FLAT_COLOR"


def _draw() -> None:
    """Draw the points of all live LiDARs of the scene that the view shows, and its vehicles."""
    import gpu  # of no use without a window
    from gpu_extras.batch import batch_for_shader

    scene, size = bpy.context.scene, float(preference("point_size"))
    if not bpy.context.space_data.overlay.show_overlays:
        return
    scale, frame = scene.unit_settings.scale_length, frame_of(scene)
    shader = gpu.shader.from_builtin(_shader_name())
    gpu.state.depth_test_set("LESS_EQUAL")
    gpu.state.point_size_set(size)
    gpu.matrix.push()
    if frame is not None:
        gpu.matrix.multiply_matrix(frame.matrix_world)
    for lidar in scenarios.lidars_of(scene):
        shown = _state.shown.get(scenarios.uid_of(lidar))
        if shown is None or shown.look is None or shown.problem or not lidar.visible_get():
            continue
        if shown.batch is None:
            places = np.ascontiguousarray(shown.look.cloud.xyz / scale, dtype=np.float32)
            shown.batch = batch_for_shader(shader, "POINTS", {"pos": places, "color": shown.colours})
        shader.bind()
        if bpy.app.version >= _OWN_POINTS:
            shader.uniform_float("size", size)
        shown.batch.draw(shader)
    _draw_boxes(_state.boxes.get(scenarios.uid_of(scene)), scale)
    gpu.matrix.pop()
    gpu.state.point_size_set(1.0)
    gpu.state.depth_test_set("NONE")


def _draw_score() -> None:
    """Write the score of the active LiDAR, where it is live, into the view."""
    import blf

    lidar = scenarios.active_lidar(bpy.context.scene)
    shown = None if lidar is None else _state.shown.get(scenarios.uid_of(lidar))
    if shown is None or shown.look is None or not bpy.context.space_data.overlay.show_overlays:
        return
    group, text = lidar.blender_lidar, shown.problem
    if not text and group.vehicles:
        gain = 100 * (group.detectable_share - group.baseline_share)
        text = f"Detectable {100 * group.detectable_share:.0f} % ({gain:+.0f} pp) of {group.vehicles}"
    scale = bpy.context.preferences.system.ui_scale
    blf.size(0, (14 if shown.problem else 22) * scale, *([72] if bpy.app.version < (4, 0) else []))
    blf.enable(0, blf.SHADOW)
    blf.shadow(0, 5, 0.0, 0.0, 0.0, 1.0)
    blf.color(0, 1.0, 1.0, 1.0, 1.0)
    blf.position(0, max((bpy.context.region.width - blf.dimensions(0, text)[0]) / 2, 0), 28 * scale, 0)
    blf.draw(0, text)
    blf.disable(0, blf.SHADOW)


def _draw_boxes(boxes, scale):
    """Draw the boxes of vehicles in the colours of their entropy, whatever a view's shading."""
    import gpu
    from gpu_extras.batch import batch_for_shader

    if boxes is None or not len(boxes.bits):
        return
    shader = gpu.shader.from_builtin("3D_FLAT_COLOR" if bpy.app.version < (4, 0) else "FLAT_COLOR")
    if boxes.batches is None:
        corners = (box_corners(boxes.vehicles) / scale).reshape(-1, 3).astype(np.float32)
        colours = np.ones((len(boxes.bits), 8, 4), np.float32)
        colours[..., :3] = colours_of(boxes.bits)[:, None]
        first = 8 * np.arange(len(boxes.bits), dtype=np.int32)[:, None, None]
        made = []
        for kind, alpha, of in (("LINES", 1.0, _EDGES), ("TRIS", _BOX_ALPHA, _FACES)):
            colours[..., 3] = alpha
            rows = (first + of).reshape(-1, of.shape[1])
            given = {"pos": corners, "color": colours.reshape(-1, 4).copy()}
            made.append(batch_for_shader(shader, kind, given, indices=rows))
        boxes.batches = tuple(made)
    gpu.state.blend_set("ALPHA")
    gpu.state.depth_mask_set(False)
    for batch in boxes.batches:
        batch.draw(shader)
    gpu.state.blend_set("NONE")


_SIGNS = np.array([(x, y, z) for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
_EDGES = np.array([(a, a + step) for step in (1, 2, 4) for a in range(8) if not a & step], np.int32)
_FACES = np.array(
    [
        face
        for step, (u, v) in ((1, (2, 4)), (2, (1, 4)), (4, (1, 2)))
        for a in (0, step)
        for face in ((a, a + u, a + v), (a + u, a + u + v, a + v))
    ],
    np.int32,
)


def box_corners(vehicles: Boxes) -> np.ndarray:
    """Corners of vehicles' boxes as they are drawn, a little larger than the vehicles, (n, 8, 3) [m]."""
    local = _SIGNS * (vehicles.size_m + 2.0 * _BOX_GAP_M)[:, None]
    cos, sin = np.cos(vehicles.heading_rad)[:, None], np.sin(vehicles.heading_rad)[:, None]
    x, y, z = np.moveaxis(local, -1, 0)
    return np.stack([cos * x - sin * y, sin * x + cos * y, z], axis=-1) + vehicles.centre_m[:, None]


# --- Events that mark a change ----------------------------------------------------------------------------------------


@persistent
@properties.guarded
def on_update(scene, depsgraph=None, *_) -> None:
    """Mark what Blender has evaluated again."""
    _note_updates(depsgraph)
    _soon()


def _note_updates(depsgraph):
    if depsgraph is None:
        return
    for objects in _state.objects.values():
        objects.note_updates(depsgraph.updates)
    scene = depsgraph.scene.original
    if scenarios.uid_of(scene) in _state.objects:  # not that in which bodies are read
        changed = {one.id.original for one in depsgraph.updates if one.is_updated_geometry}
        if any(changed & set(of.all_objects) for of in session.chosen_bodies(scene).values()):
            _state.reshaped.add(scenarios.uid_of(scene))


@persistent
@properties.guarded
def on_frame(scene, depsgraph=None, *_) -> None:
    """Mark another time; while a renderer asks for it, look at once and write what is seen into the cloud."""
    _note_updates(depsgraph)
    if _state.rendering and depsgraph is not None:
        update(depsgraph)
        write_clouds(depsgraph)
    _soon()


@persistent
@properties.guarded
def on_history(*_) -> None:
    """Mark all: other settings, or another state from the history of undo."""
    for shown in _state.shown.values():
        shown.seen = shown.frame = None
    for objects in _state.objects.values():
        objects.forget()
    _soon()


@persistent
@properties.guarded
def on_load(*_) -> None:
    """Let go of what was drawn of the file before."""
    for kept in (_state.shown, _state.boxes, _state.objects, _state.reshaped):
        kept.clear()
    _state.rendering = False
    _draw_if(False)
    _soon()


@persistent
@properties.guarded
def on_save(*_) -> None:
    """Save the clouds of live LiDARs as they are, and visible."""
    update()
    for lidar, layer, shown in _looked_at():
        _hide(_write(lidar, shown), layer, hidden=False)


@persistent
@properties.guarded
def on_render(*_) -> None:
    """Render the clouds of live LiDARs as they are: hidden in views, they are not in pictures."""
    write_clouds()
    _state.rendering = True


@persistent
@properties.guarded
def on_rendered(*_) -> None:
    """Go on."""
    _state.rendering = False
    _soon()


def on_change(block: bpy.types.ID, table: str) -> None:
    """A property of the panel has changed."""
    if table not in ("live", "look", "style"):
        on_history()
    elif table == "live" or bpy.app.background:
        update()  # at once, so that the step of undo has the cloud as it is to be
    group, cloud = block.blender_lidar, cloud_of(block) if table in ("look", "style") else None
    if cloud is not None and table == "style":
        set_style(cloud, group.style)
    elif cloud is not None:
        set_look(cloud, {"Color By": group.colour_by})
    if table == "style":
        group.colour_by = STYLES[group.style][0]
    _soon()


def _soon() -> None:
    """Update once Blender has handled what it is at."""
    if bpy.app.background or bpy.app.timers.is_registered(update):
        return
    if _state.shown or any(_live_in(scene) for scene, _ in _open_scenes()):
        bpy.app.timers.register(update, first_interval=_PAUSE_S)


app_handlers = {
    "depsgraph_update_post": on_update,
    "frame_change_post": on_frame,
    "undo_post": on_history,
    "redo_post": on_history,
    "load_post": on_load,
    "save_pre": on_save,
    "save_post": persistent(hide_clouds),
    "render_init": on_render,
    "render_complete": on_rendered,
    "render_cancel": on_rendered,
}


def register() -> None:
    """Listen."""
    properties.ON_CHANGE.append(on_change)


def unregister() -> None:
    """Listen and draw no more; the clouds are shown as they were seen last."""
    properties.ON_CHANGE.remove(on_change)
    for key in list(_state.shown):
        properties.guarded(_end)(key)
    on_load()
    if bpy.app.timers.is_registered(update):
        bpy.app.timers.unregister(update)
