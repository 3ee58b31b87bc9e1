"""Handlers of events: files that are opened, the timeline, LiDARs that are duplicated."""

import bpy
from bpy.app.handlers import persistent

from ..errors import BlenderLidarError
from ..world.blender.objects import PART, frame_of, lidars, orphans, role
from ..world.blender.road import show_ground
from . import operators, properties, session

classes = ()


@persistent
def on_load(*_) -> None:
    """Let go of what the file before had, and take over what this one was built with."""
    session.forget()
    adopt_all()


@persistent
def on_update(scene, *_) -> None:
    """Complete bare LiDARs and roads without their frame, and remove parts of deleted LiDARs, at the next moment."""
    found = lidars(scene)
    bare = any(not any(role(child) == PART for child in lidar.children) for lidar in found)
    if not bare and not (found and session.has_road(scene) and frame_of(scene) is None) and not orphans(scene):
        return
    if not bpy.app.background and not bpy.app.timers.is_registered(adopt_all):
        bpy.app.timers.register(adopt_all, first_interval=0.0)


def adopt_all() -> None:
    """Take over every scene of the file."""
    for scene in bpy.data.scenes:
        try:
            operators.adopt(scene)
        except BlenderLidarError as error:  # no operator is there to report it
            scene.blender_lidar.problem = str(error)


def on_change(block: bpy.types.ID, table: str) -> None:
    """Show another moment, hang LiDARs beside another road, hide the ground, or dress a LiDAR as its new model.

    What is wrong stands at the top of the tab.
    """
    scene = properties.scene_of(block)
    if scene is None:
        return
    group = scene.blender_lidar
    group.problem = ""
    try:
        if table == "clock" and group.loaded:
            operators.show_moment(scene)
        elif table == "road":
            properties.hang_again(scene)
        elif table == "world":
            show_ground(scene, session.view_layer_of(scene), shown=group.world.ground)
        elif table == "sensor" and block != scene:
            operators.dress(block, operators.lattice_of(session.sensor_of(block)))
    except BlenderLidarError as error:
        group.problem = str(error)


@persistent
def on_time(scene, *_) -> None:
    """Show the vehicles of another time, before Blender evaluates it."""
    if scene.blender_lidar.loaded:
        try:
            operators.show_moment(scene)
        except BlenderLidarError as error:
            scene.blender_lidar.problem = str(error)


app_handlers = {"load_post": on_load, "depsgraph_update_post": on_update, "frame_change_pre": on_time}


def register() -> None:
    """Listen."""
    properties.ON_CHANGE.append(on_change)
    if not bpy.app.background:  # data cannot be read while add-ons are enabled at the start
        bpy.app.timers.register(adopt_all, first_interval=0.1)


def unregister() -> None:
    """Listen no more."""
    properties.ON_CHANGE.remove(on_change)
    if bpy.app.timers.is_registered(adopt_all):
        bpy.app.timers.unregister(adopt_all)
    session.forget()
