"""Vehicles as instances of shared meshes, and frames of a recording as an animation."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import bpy
import numpy as np

from ...traffic.fleet import KIND_OF_BODY
from ...traffic.vehicles import Vehicles
from ..meshes import GLASS
from ..shapes import shape
from ..triangles import shape_names
from .objects import (
    SHAPE,
    VEHICLE,
    VEHICLE_ID,
    add_object,
    collection,
    frame_of,
    glass,
    made_once,
    new_mesh,
    paint_of,
    wear_own_paint,
)
from .points import colours_of

_FPS = 24  # pictures per second of an animation


def show_vehicles(scene: bpy.types.Scene, vehicles: Vehicles, detail: str = "body") -> list[bpy.types.Object]:
    """Let the scene's vehicles be those of a frame.

    A vehicle that is there already, in the same shape, is moved; others are made, and those that have left are removed.

    Returns
    -------
    list of Object
        One for each vehicle, in the frame's order.
    """
    into, frame = collection(scene, "Vehicles", VEHICLE), frame_of(scene)
    present = {(item[VEHICLE_ID], item[SHAPE]): item for item in into.objects if VEHICLE_ID in item}
    shown = []
    for (vehicle_id, name), centre, size, heading in _rows(vehicles):
        item = present.pop((vehicle_id, f"{name} {detail}"), None)
        item = item or _new_vehicle(into, frame, vehicle_id, name, detail)
        item.animation_data_clear()
        item.hide_render = item.hide_viewport = False
        item.location, item.scale, item.rotation_euler = centre, size, (0.0, 0.0, heading)
        shown.append(item)
    bpy.data.batch_remove(present.values())
    return shown


def colour_vehicles(items: Iterable[bpy.types.Object], entropy_bits: np.ndarray | None) -> None:
    """Colour vehicles by their PE-VGOP (n,) [bits], as points on them are coloured; None gives them their paint again.

    In solid view the viewport has to show the colours of objects; in Eevee and Cycles their paint does.
    """
    if entropy_bits is None:
        for item in items:
            wear_own_paint(item)
        return
    for item, colour in zip(items, colours_of(entropy_bits).tolist(), strict=True):
        item.color = (*colour, 1.0)


def animate(scene: bpy.types.Scene, frames: Sequence[Vehicles], detail: str = "body", *, time_step_s: float) -> None:
    """Let the scene's vehicles drive through several frames of a recording, played at true speed.

    Vehicles are shown from the first to the last of the frames that they are in, and move evenly in between.

    Parameters
    ----------
    frames : sequence of Vehicles
        In the order of time.
    time_step_s : float
        Time between consecutive frame numbers [s].
    """
    show_vehicles(scene, frames[0].select(np.zeros(len(frames[0]), dtype=bool)), detail)
    into, frame = collection(scene, "Vehicles", VEHICLE), frame_of(scene)
    moving: dict[str, bpy.types.Object] = {}
    last_seen: dict[str, float] = {}
    start = frames[0].frame
    scene.render.fps, scene.frame_start = _FPS, 1
    for vehicles in frames:
        at = shown_at(vehicles.frame, start, time_step_s, _FPS)
        for (vehicle_id, name), centre, size, heading in _rows(vehicles):
            item = moving.get(vehicle_id)
            if item is None:
                moving[vehicle_id] = item = _new_vehicle(into, frame, vehicle_id, name, detail)
                item.scale, item.rotation_euler.z = size, heading
                key_visibility(item, shown=False, at=at - 1.0)
                key_visibility(item, shown=True, at=at)
            item.location = centre
            item.rotation_euler.z = heading + _whole_turns(item.rotation_euler.z - heading)
            item.keyframe_insert("location", frame=at)
            item.keyframe_insert("rotation_euler", frame=at)
            last_seen[vehicle_id] = at
    end = max(last_seen.values(), default=1.0)
    for vehicle_id, at in last_seen.items():
        if at < end:
            key_visibility(moving[vehicle_id], shown=False, at=at + 1.0)
    for item in moving.values():
        _join_keys_by_straight_lines(item)
    scene.frame_end = max(1, round(end))
    scene.frame_set(1)


def shown_at(number: int, first: int, time_step_s: float, fps: float) -> float:
    """When a frame of a recording is shown: in frames of the animation that begins with the recording's `first`."""
    return 1.0 + (number - first) * time_step_s * fps


def _rows(vehicles):
    """Of each vehicle its id and shape, and its box: what takes the unit box there."""
    names = zip(map(str, vehicles.vehicle_id.tolist()), shape_names(vehicles).tolist(), strict=True)
    box = vehicles.centre_m.tolist(), vehicles.size_m.tolist(), vehicles.heading_rad.tolist()
    return zip(names, *box, strict=True)


def _whole_turns(angle: float) -> float:
    """The multiple of a full turn nearest to an angle [rad]: headings must not spin from +180 to -180 degrees."""
    turn = 2.0 * np.pi
    return turn * round(angle / turn)


def key_visibility(item: bpy.types.Object, *, shown: bool, at: float) -> None:
    """From a frame of the animation on let an object be shown, or not."""
    item.hide_render = item.hide_viewport = not shown
    item.keyframe_insert("hide_render", frame=at)
    item.keyframe_insert("hide_viewport", frame=at)


def _join_keys_by_straight_lines(item: bpy.types.Object) -> None:
    """Let an object move evenly from key to key; Blender's own choice starts and stops at each."""
    action = item.animation_data.action
    holders = [action]
    if not hasattr(action, "fcurves"):  # from Blender 5 on
        holders = [bag for layer in action.layers for strip in layer.strips for bag in strip.channelbags]
    curves = [curve for holder in holders for curve in holder.fcurves]
    for curve in curves:
        for key in curve.keyframe_points:
            key.interpolation = "LINEAR"
        curve.update()


def _new_vehicle(into, frame, vehicle_id, name, detail):
    """A new object; all vehicles of a shape share a mesh."""
    title = f"{name} {detail}"

    def make():
        unit = shape(name, detail)
        kind = KIND_OF_BODY[name]
        paints = [paint_of("truck" if kind == "long_truck" else kind), glass()]
        return new_mesh(title, unit.vertices, unit.faces, paints, unit.surface == GLASS)

    item = add_object(into, f"{name} {vehicle_id}", made_once(bpy.data.meshes, title, make), parent=frame)
    item[VEHICLE_ID], item[SHAPE] = vehicle_id, title  # as texts: numbers would have to fit into 32 bits
    wear_own_paint(item)
    return item
