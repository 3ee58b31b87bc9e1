"""Vehicles as instances of shared meshes, and frames of a recording as an animation."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import bpy
import numpy as np
from mathutils import Matrix

from ...traffic.vehicles import Vehicles
from ..shapes import GLASS, shape
from ..triangles import shape_names
from .objects import KEY, SHAPE, VEHICLE, VEHICLE_ID, add_object, collection, glass, new_mesh, of_ours, paint_of


def show_vehicles(scene: bpy.types.Scene, vehicles: Vehicles, detail: str = "body") -> list[bpy.types.Object]:
    """Let the scene's vehicles be those of a frame.

    A vehicle that is there already, in the same shape, is moved; others are made, and those that have left are removed.

    Returns
    -------
    list of Object
        One for each vehicle, in the frame's order.
    """
    into = collection(scene, "Vehicles", VEHICLE)
    present = {(item[VEHICLE_ID], item[SHAPE]): item for item in into.objects if VEHICLE_ID in item}
    shown = []
    for vehicle_id, name, matrix in zip(
        vehicles.vehicle_id.tolist(), shape_names(vehicles).tolist(), box_matrices(vehicles), strict=True
    ):
        key = (str(vehicle_id), f"{name} {detail}")
        item = present.pop(key, None) or _new_vehicle(into, key, name, detail)
        item.animation_data_clear()
        item.hide_render = item.hide_viewport = False
        item.matrix_world = matrix
        shown.append(item)
    bpy.data.batch_remove(present.values())
    return shown


def box_matrices(vehicles: Vehicles) -> list[Matrix]:
    """What takes the unit box to each vehicle's box in the road frame: scaled by its size, turned, moved."""
    matrices = np.zeros((len(vehicles), 4, 4))
    cos, sin = np.cos(vehicles.heading_rad), np.sin(vehicles.heading_rad)
    length, width, height = vehicles.size_m.T
    matrices[:, 0, 0], matrices[:, 0, 1] = cos * length, -sin * width
    matrices[:, 1, 0], matrices[:, 1, 1] = sin * length, cos * width
    matrices[:, 2, 2] = height
    matrices[:, :3, 3] = vehicles.centre_m
    matrices[:, 3, 3] = 1.0
    return [Matrix(matrix) for matrix in matrices.tolist()]


def animate(
    scene: bpy.types.Scene, frames: Sequence[Vehicles], detail: str = "body", *, time_step_s: float, fps: int = 24
) -> None:
    """Let the scene's vehicles drive through several frames of a recording, played at true speed.

    Vehicles are shown from the first to the last of the frames that they are in, and move evenly in between.

    Parameters
    ----------
    frames : sequence of Vehicles
        In the order of time.
    time_step_s : float
        Time between consecutive frame numbers [s].
    fps : int
        Pictures per second of the animation.
    """
    show_vehicles(scene, frames[0].select(np.zeros(len(frames[0]), dtype=bool)), detail)
    into = collection(scene, "Vehicles", VEHICLE)
    moving: dict[str, bpy.types.Object] = {}
    last_seen: dict[str, float] = {}
    start = frames[0].frame
    scene.render.fps, scene.frame_start = fps, 1
    for vehicles in frames:
        at = 1.0 + (vehicles.frame - start) * time_step_s * fps
        for vehicle_id, name, matrix, heading in _rows(vehicles):
            item = moving.get(vehicle_id)
            if item is None:
                moving[vehicle_id] = item = _new_vehicle(into, (vehicle_id, f"{name} {detail}"), name, detail)
                item.matrix_world = matrix
                _key_visibility(item, shown=False, at=at - 1.0)
                _key_visibility(item, shown=True, at=at)
            item.location = matrix.translation
            item.rotation_euler.z = heading + _whole_turns(item.rotation_euler.z - heading)
            item.keyframe_insert("location", frame=at)
            item.keyframe_insert("rotation_euler", frame=at)
            last_seen[vehicle_id] = at
    end = max(last_seen.values(), default=1.0)
    for vehicle_id, at in last_seen.items():
        if at < end:
            _key_visibility(moving[vehicle_id], shown=False, at=at + 1.0)
    for item in moving.values():
        _join_keys_by_straight_lines(item)
    scene.frame_end = max(1, round(end))
    scene.frame_set(1)


def _rows(vehicles: Vehicles) -> Iterable[tuple[str, str, Matrix, float]]:
    ids, names = map(str, vehicles.vehicle_id.tolist()), shape_names(vehicles).tolist()
    return zip(ids, names, box_matrices(vehicles), vehicles.heading_rad.tolist(), strict=True)


def _whole_turns(angle: float) -> float:
    """The multiple of a full turn nearest to an angle [rad]: headings must not spin from +180 to -180 degrees."""
    turn = 2.0 * np.pi
    return turn * round(angle / turn)


def _key_visibility(item, *, shown, at):
    item.hide_render = item.hide_viewport = not shown
    item.keyframe_insert("hide_render", frame=at)
    item.keyframe_insert("hide_viewport", frame=at)


def _join_keys_by_straight_lines(item: bpy.types.Object) -> None:
    """Let an object move evenly from key to key; Blender's own choice starts and stops at each."""
    action = item.animation_data.action
    if hasattr(action, "fcurves"):
        curves = list(action.fcurves)
    else:  # from Blender 5 on
        bags = (bag for layer in action.layers for strip in layer.strips for bag in strip.channelbags)
        curves = [curve for bag in bags for curve in bag.fcurves]
    for curve in curves:
        for key in curve.keyframe_points:
            key.interpolation = "LINEAR"
        curve.update()


def _new_vehicle(into, key, name, detail):
    item = add_object(into, f"{name} {key[0]}", _mesh(name, detail))
    item[VEHICLE_ID], item[SHAPE] = key  # as texts: numbers would have to fit into 32 bits
    return item


def _mesh(name, detail):
    """The mesh that all vehicles of a shape share."""
    title = f"{name} {detail}"
    mesh = of_ours(bpy.data.meshes, title)
    if mesh is not None:
        return mesh
    unit = shape(name, detail)
    paints = [paint_of("truck" if name == "long_truck" else name), glass()]
    mesh = new_mesh(title, unit.vertices, unit.faces, paints, unit.surface == GLASS)
    mesh[KEY] = title
    return mesh
