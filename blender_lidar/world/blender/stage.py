"""Cameras, light and viewports: a scene that looks right without touching a setting."""

from __future__ import annotations

import math

import bpy
from mathutils import Vector

from ...sensors.pose import Pose
from ...traffic.road import RoadFrame
from .roles import KEY, STAGE, add_object, clear, collection, of_ours

ABOVE, FROM_POLE = "From above", "From the pole"
_CLIP_END_M = 2000.0
_CAMERA_ZOOM = 15.0  # the camera's picture fills the viewport
_ABOVE = (-0.38, -0.62, 0.5)  # from the middle of the road to the camera, in depths: from before the pole
_OVER_HEAD_M, _LOOKS_DOWN_RAD = 0.3, math.radians(15.0)  # the same for every tilt, so that pictures can be compared
_SUN_DIRECTION = (0.35, 0.45, -0.8)
_SUN_STRENGTH, _SKY, _SKY_STRENGTH = 3.2, (0.55, 0.65, 0.8), 0.55


def build_stage(scene: bpy.types.Scene, road: RoadFrame, pose: Pose, depth_m: float) -> None:
    """Two cameras and a sun, in place of earlier ones, and a sky where the scene has no world.

    Parameters
    ----------
    pose : Pose
        The mounting: one camera sees it from above, obliquely, the other looks across the road from just over it.
    depth_m : float
        How much of the road the camera above takes in, along x, at the far edge of the carriageway [m].
    """
    into = collection(scene, "Cameras and light", STAGE)
    clear(into)
    right, left = road.carriageway_y
    middle = Vector((pose.x_m, 0.5 * (right + left), 0.0))
    above = middle + depth_m * Vector(_ABOVE)
    camera = _camera(into, ABOVE, above, middle, 50.0)
    mount = Vector(pose.position.tolist()) + Vector((0.0, 0.0, _OVER_HEAD_M))
    ahead = Vector((0.0, math.cos(_LOOKS_DOWN_RAD), -math.sin(_LOOKS_DOWN_RAD)))
    _camera(into, FROM_POLE, mount, mount + ahead, 100.0)
    sun = add_object(into, "Sun", bpy.data.lights.new("Sun", "SUN"))
    sun.data.energy, sun.data.angle = _SUN_STRENGTH, math.radians(1.5)
    sun.rotation_euler = Vector(_SUN_DIRECTION).to_track_quat("-Z", "Y").to_euler()
    scene.camera = camera
    if scene.world is None:
        scene.world = _sky()


def show_in_viewports(scene: bpy.types.Scene) -> None:
    """Let every 3D viewport of the file look through the scene's camera and show materials."""
    for screen in bpy.data.screens:
        for area in screen.areas:
            for space in area.spaces:
                if space.type == "VIEW_3D":
                    space.shading.type = "MATERIAL"
                    space.clip_end = _CLIP_END_M
                    space.overlay.show_relationship_lines = False
                    space.region_3d.view_perspective = "CAMERA"
                    space.region_3d.view_camera_zoom = _CAMERA_ZOOM


def _camera(into, name, place, target, angle_deg):
    camera = add_object(into, name, bpy.data.cameras.new(name))
    camera.location = place
    camera.rotation_euler = (target - place).to_track_quat("-Z", "Y").to_euler()
    camera.data.angle, camera.data.clip_end = math.radians(angle_deg), _CLIP_END_M
    return camera


def _sky():
    world = of_ours(bpy.data.worlds, STAGE)
    if world is not None:
        return world
    world = bpy.data.worlds.new("Sky")
    world[KEY] = STAGE
    world.color = _SKY
    if bpy.app.version < (5, 0):
        world.use_nodes = True
    background = next(node for node in world.node_tree.nodes if node.type == "BACKGROUND")
    background.inputs["Color"].default_value = (*_SKY, 1.0)
    background.inputs["Strength"].default_value = _SKY_STRENGTH
    return world
