"""Handlers of events: files that are opened, the timeline, LiDARs that are added, duplicated, deleted or clicked."""

import bpy
from bpy.app.handlers import persistent

from ..errors import BlenderLidarError, one_line
from ..world.blender.objects import frame_of, holds, is_lidar, lidars
from ..world.blender.road import show_ground
from . import operators, properties, scenarios, session

classes = ()
_failed: set[str] = set()  # scenes that could not be taken over, which is not tried again at every update


@persistent
@properties.guarded
def on_load(*_) -> None:
    """Let go of what the file before had, and take over what this one was built with."""
    session.forget()
    _failed.clear()
    adopt_all()
    for scene in bpy.data.scenes:  # a render may need them, in which none can be read
        properties.guarded(session.bodies_shown)(scene)


@persistent
@properties.guarded
def on_history(*_) -> None:
    """Look for all LiDARs again after undo and redo, and complete them at the next moment."""
    _failed.clear()
    for scene in bpy.data.scenes:
        if scene.library is None:
            scenarios.keep_lidars(scene, lidars(scene))
    _at_next(adopt_all)


@persistent
@properties.guarded
def on_update(scene, depsgraph=None, *_) -> None:
    """Keep the LiDARs among what Blender has evaluated again; complete and select them at the next moment."""
    if scene.library is not None:
        return
    known = {row.lidar for row in scene.blender_lidar.lidars}
    told = depsgraph is not None and depsgraph.id_type_updated("SCENE")  # also of what is new; others are many
    ids = [change.id for change in depsgraph.updates] if told else []
    new = {item.original for item in ids if isinstance(item, bpy.types.Object) and is_lidar(item)} - known
    new = {one for one in new if holds(scene, one)}
    if new:
        scenarios.keep_lidars(scene, known - {None} | new)
    own = any(one is not None and one.library is None for one in known | new) and scenarios.has_road(scene)
    gone = any(one is None or not holds(scene, one) for one in known)
    if (new or gone or (own and frame_of(scene) is None)) and scenarios.uid_of(scene) not in _failed:
        _at_next(adopt_all)
    if depsgraph is not None and operators.is_clicked(depsgraph.view_layer.objects.active):
        _at_next(_select_wearers)


def _at_next(call) -> None:
    """Have something done once Blender has handled what it is at; in the background who calls scripts does so."""
    if not bpy.app.background and not bpy.app.timers.is_registered(call):
        bpy.app.timers.register(call, first_interval=0.0)


@properties.guarded
def _select_wearers() -> None:
    for window in bpy.context.window_manager.windows:
        operators.select_wearer(window.view_layer)


@properties.guarded
def adopt_all() -> None:
    """Take over every scene of the file."""
    for scene in bpy.data.scenes:
        try:
            operators.adopt(scene)
        except Exception as error:  # no operator is there to report it
            _failed.add(scenarios.uid_of(scene))
            properties.tell(scene, one_line(str(error)))


@properties.guarded
def on_change(block: bpy.types.ID, table: str) -> None:
    """Show another moment, hang LiDARs beside another road, hide the ground, or dress a LiDAR as its new model.

    What is wrong stands at the top of the tab.
    """
    scene = properties.scene_of(block)
    if scene is None:
        return
    problem = ""
    try:
        if table == "world":
            show_ground(scene, scenarios.view_layer_of(scene), shown=scene.blender_lidar.world.ground)
        if table in ("clock", "world") and scene.blender_lidar.loaded:
            session.show_traffic(scene, again=table == "world")
        elif table == "road":
            properties.hang_again(scene)
        elif table == "sensor" and block != scene:
            scenarios.show_model(block)
            operators.dress(block, operators.lattice_of(scenarios.sensor_of(block)))
    except BlenderLidarError as error:
        problem = str(error)
    properties.tell(scene, problem)


@persistent
@properties.guarded
def on_time(scene, *_) -> None:
    """Show the vehicles of another time, before Blender evaluates it."""
    if scene.blender_lidar.loaded:
        session.show_traffic(scene)


app_handlers = {
    "load_post": on_load,
    "undo_post": on_history,
    "redo_post": on_history,
    "depsgraph_update_post": on_update,
    "frame_change_pre": on_time,
}


def register() -> None:
    """Listen."""
    properties.ON_CHANGE.append(on_change)
    if not bpy.app.background:  # data cannot be read while add-ons are enabled at the start
        bpy.app.timers.register(on_load, first_interval=0.1)


def unregister() -> None:
    """Listen no more."""
    properties.ON_CHANGE.remove(on_change)
    for call in (adopt_all, on_load, _select_wearers):
        if bpy.app.timers.is_registered(call):
            bpy.app.timers.unregister(call)
    session.forget()
