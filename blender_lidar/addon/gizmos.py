"""Gizmos of the active LiDAR: arrows for its height and range gate, a dial for its tilt across the road."""

from __future__ import annotations

import math
import time

import bpy
from mathutils import Matrix, Vector

from ..errors import BlenderLidarError
from ..world.blender.objects import frame_of
from . import properties, scenarios

_COLOURS = {"height_m": (0.3, 0.6, 1.0), "tilt_x_deg": (1.0, 0.3, 0.3), "range_gate_m": (1.0, 0.8, 0.2)}
_LEAST = {"height_m": 0.0, "range_gate_m": 0.1}  # a range gate of 0 is the model's own range
_STILL_S = 0.4  # after the last change a drag is taken for ended, so that it is one step of undo
_changed_at = 0.0


def _value(key):
    lidar = scenarios.active_lidar(bpy.context.scene)
    if lidar is None:  # deleted in a drag
        return 0.0
    value = getattr(lidar.blender_lidar, key)
    return value or scenarios.sensor_of(lidar).range_gate_m if key == "range_gate_m" else value


def _set(key, value):
    global _changed_at
    lidar = scenarios.active_lidar(bpy.context.scene)
    if lidar is not None:
        setattr(lidar.blender_lidar, key, max(value, _LEAST.get(key, value)))
    _changed_at = time.monotonic()
    if not bpy.app.background and not bpy.app.timers.is_registered(_push):
        bpy.app.timers.register(_push, first_interval=_STILL_S)


def _push():
    """One step of undo for a drag, as handlers of gizmos make none."""
    if time.monotonic() - _changed_at < _STILL_S:
        return _STILL_S
    with bpy.context.temp_override(window=bpy.context.window_manager.windows[0]):
        bpy.ops.ed.undo_push(message="LiDAR Gizmo")
    return None


class BLENDER_LIDAR_GGT_lidar(bpy.types.GizmoGroup):
    """Height, tilt and range gate of the active LiDAR."""

    bl_label, bl_options = "LiDAR", {"3D", "PERSISTENT", "SHOW_MODAL_ALL"}
    bl_space_type, bl_region_type = "VIEW_3D", "WINDOW"

    @classmethod
    def poll(cls, context):
        """Whether a LiDAR of this file is selected and can be changed."""
        lidar = scenarios.active_lidar(context.scene)
        if lidar is None or lidar.library is not None or not lidar.select_get():
            return False
        try:
            properties.mounting_of(lidar), scenarios.sensor_of(lidar)
        except BlenderLidarError:
            return False
        return True

    def setup(self, context):
        """An arrow for each length and a dial for the angle."""
        self.of = {}
        for key, colour in _COLOURS.items():
            gizmo = self.gizmos.new("GIZMO_GT_dial_3d" if key == "tilt_x_deg" else "GIZMO_GT_arrow_3d")
            gizmo.target_set_handler("offset", get=lambda key=key: _value(key), set=lambda to, key=key: _set(key, to))
            gizmo.color, gizmo.alpha, gizmo.color_highlight, gizmo.alpha_highlight = colour, 0.7, (1.0, 1.0, 1.0), 1.0
            gizmo.use_draw_modal, gizmo.scale_basis = True, 0.6 if key == "tilt_x_deg" else 1.0
            self.of[key] = gizmo

    def draw_prepare(self, context):
        """Place them: in the mast's frame x is to the right of y, where the mast faces, and z is plumb."""
        lidar = scenarios.active_lidar(context.scene)
        frame, mounting = frame_of(context.scene), properties.mounting_of(lidar)
        turn = Matrix.Rotation(mounting.mast.facing_rad - math.pi / 2, 4, "Z")
        turn = (frame.matrix_world.to_3x3().normalized().to_4x4() if frame else Matrix()) @ turn
        head = Matrix.Translation(lidar.matrix_world.translation)
        foot = Matrix.Translation(head.translation - turn @ Vector((0.0, 0.0, mounting.height_m)))
        self.of["height_m"].matrix_basis = foot @ turn
        self.of["tilt_x_deg"].matrix_basis = head @ turn @ Matrix.Rotation(-math.pi / 2, 4, "Y")  # about -x
        self.of["range_gate_m"].matrix_basis = head @ turn @ Matrix.Rotation(-math.pi / 2, 4, "X")  # along y


classes = (BLENDER_LIDAR_GGT_lidar,)


def unregister() -> None:
    """Push nothing more."""
    if bpy.app.timers.is_registered(_push):
        bpy.app.timers.unregister(_push)
