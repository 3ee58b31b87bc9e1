"""The traffic of a recording on Blender's timeline: instances on one mesh of points, which move without any Python."""

from __future__ import annotations

from collections.abc import Mapping

import bpy
import numpy as np
from mathutils import Matrix

from ...road.road_map import wrap_angle
from ...traffic.boxes import Boxes
from ...traffic.fleet import KIND_OF_BODY
from ...traffic.vehicles import SAME_S, Recording
from ..meshes import GLASS, joined
from ..shapes import shape, wheels
from ..triangles import shape_names
from .bodies import OwnBody
from .nodes import math_of, node, output
from .objects import (
    HEAD,
    METAL,
    VEHICLE,
    add_attribute,
    add_object,
    clear,
    collection,
    frame_of,
    glass,
    made_once,
    new_mesh,
    paint_of,
    plain,
    wear_own_paint,
)
from .points import add_socket, numbers_of, set_look

_NAME = "Vehicles"
_WINDOW = "blender_lidar_window"  # custom property: between which times of the recording the mesh has its traffic [s]
_BODIES = "blender_lidar_bodies"  # and the collection of what stands for vehicles
_MADE_OF = "blender_lidar_made_of"  # and of that what its bodies are
MOST_SEGMENTS = 300_000  # in a mesh at once: more would make .blend files and undo slow
_BEHIND = 0.25  # share of them from before the moment shown
_EVER_S = 1e9


def traffic_object(scene: bpy.types.Scene) -> bpy.types.Object | None:
    """The object that shows a scene's traffic; None where nothing is loaded, or it was deleted."""
    return next((item for item in scene.objects if item.get(_WINDOW) is not None), None)


def starts_at(item: bpy.types.Object, since_s: float, starts_s: float) -> bool:
    """Let a recording's traffic begin at a second of the timeline; False where its object does not have a moment."""
    low, high, origin_s = item[_WINDOW]
    set_look(item, {"Start": starts_s + origin_s})
    return low <= since_s < high


def show_recording(
    scene: bpy.types.Scene,
    recording: Recording,
    detail: str,
    since_s: float,
    starts_s: float,
    own: Mapping[str, OwnBody] | None = None,
    *,
    alone: bool = False,
) -> None:
    """Let the timeline move a recording's vehicles: at every time those of `Recording.moment`.

    They are instances on a mesh that has a vertex for each box: its vehicle from that instant to the next, `begin` to
    `end` [s], how far it gets, `move` [m], `heading` and `turn` [rad], `size` [m], `body`, a place in the collection of
    bodies, and `vehicle`. Of more than `MOST_SEGMENTS` it holds those about a moment.

    Parameters
    ----------
    scene : Scene
    recording : Recording
    detail : str
        Level of detail of the vehicles' shapes.
    since_s : float
        The moment, on the recording's clock [s].
    starts_s : float
        Second of the timeline at which the recording begins.
    own : mapping of str to OwnBody, optional
        Bodies of the user's in place of ours, by the kinds of vehicles that have them.
    alone : bool
        Whether there is no recording to go on with: `starts_at` is False then.
    """
    clock, rows = recording.since_s, np.append(0, np.cumsum(recording.counts))
    at = max(int(np.searchsorted(clock, since_s, side="right")) - 1, 0)
    first = int(np.searchsorted(rows, rows[at] - _BEHIND * MOST_SEGMENTS))
    last = int(np.searchsorted(rows, rows[first] + MOST_SEGMENTS, side="right")) - 1
    last = max(last, at + 1)  # even of an instant with more than that
    part = slice(rows[first], rows[last])
    after = recording.next_row[part]
    begin, origin_s = np.repeat(clock[first:last], recording.counts[first:last]), float(clock[first])
    goes_on = after >= 0
    end = np.where(goes_on, clock[np.searchsorted(recording.frames, recording.frame[after])], begin + 2.0 * SAME_S)
    there = np.where(goes_on, after, np.arange(rows[first], rows[last]))
    there = {name: getattr(recording, name)[there] for name in ("centre_m", "heading_rad")}
    boxes = recording.select(part)
    low, high = -_EVER_S if first == 0 else clock[first], _EVER_S if last == len(clock) else clock[last] - SAME_S
    window = [0.0, 0.0, origin_s] if alone else [low, high, origin_s]
    item = _write(scene, boxes, there, begin - origin_s, end - origin_s, detail, own, window)
    starts_at(item, since_s, starts_s)


def show_still(scene: bpy.types.Scene, vehicles: Boxes, detail: str = "body", own=None) -> None:
    """Let a scene show the vehicles of one moment at all times, as `show_recording` does."""
    there = {"centre_m": vehicles.centre_m, "heading_rad": vehicles.heading_rad}
    ever = np.full(len(vehicles), _EVER_S)
    _write(scene, vehicles, there, -ever, ever, detail, own, [0.0, 0.0, 0.0])


def _write(scene, boxes, there, begin, end, detail, own, window):
    """Let the mesh of a scene's vehicles hold boxes, and places and headings at their end; returns its object."""
    item = traffic_object(scene) or _new_object(scene)
    item[_WINDOW], mesh = window, item.data
    mesh.clear_geometry()
    mesh.vertices.add(len(boxes))
    mesh.vertices.foreach_set("co", np.ascontiguousarray(boxes.centre_m, dtype=np.float32).ravel())
    names, body = np.unique(shape_names(boxes), return_inverse=True)
    values = {"begin": begin, "end": end, "heading": boxes.heading_rad, "size": boxes.size_m, "body": body}
    values |= {"move": there["centre_m"] - boxes.centre_m, "vehicle": numbers_of(boxes.vehicle_id)}
    values["turn"] = wrap_angle(there["heading_rad"] - boxes.heading_rad)
    for name, value in values.items():
        add_attribute(mesh, name, value)
    mesh.update()
    _fill_bodies(item[_BODIES], names.tolist(), detail, own)
    item.update_tag()
    return item


def _new_object(scene):
    into = collection(scene, _NAME, VEHICLE)
    clear(into)
    item = add_object(into, _NAME, new_mesh(_NAME, np.empty((0, 3)), np.empty((0, 3), dtype=int)))
    item.parent = frame_of(scene)
    item.hide_select = True
    item.lock_location = item.lock_rotation = item.lock_scale = (True, True, True)
    item.modifiers.new("Traffic", "NODES").node_group = made_once(bpy.data.node_groups, "traffic", _nodes)
    item[_BODIES], item[_WINDOW] = bpy.data.collections.new("Vehicle bodies"), [0.0, 0.0, 0.0]
    set_look(item, {"Bodies": item[_BODIES]})
    return item


# --- What stands for vehicles: an object for each shape, in a collection that is in no scene --------------------------


def _fill_bodies(into, names, detail, own):
    """Let a collection of bodies have one for each of some shapes, named so that Blender too has them in that order."""
    own = own or {}
    bodies = [own.get(kind) or own.get(kind.removeprefix("long_")) for kind in map(KIND_OF_BODY.get, names)]
    titles = [f"{number:02d} {name} {detail}" for number, name in enumerate(names)]
    made_of = repr([titles, [of and (of.collection.name_full, of.fit.tolist()) for of in bodies]])
    if into.get(_MADE_OF) != made_of:
        bpy.data.batch_remove(list(into.objects))
        for title, name, of in zip(titles, names, bodies, strict=True):
            own_object(into, of, title) if of else body_object(into, name, detail, title)
        into[_MADE_OF] = made_of


def own_object(into: bpy.types.Collection, body: OwnBody, title: str) -> bpy.types.Object:
    """The object in a collection of bodies that stands for vehicles with a body of the user's: it instances that."""
    item = add_object(into, title, None, VEHICLE)
    item.instance_type, item.instance_collection = "COLLECTION", body.collection
    item.matrix_basis = Matrix(body.fit) @ Matrix.Translation(body.collection.instance_offset)
    return item


def body_object(into: bpy.types.Collection, name: str, detail: str, title: str) -> bpy.types.Object:
    """The object in a collection of bodies that stands for the vehicles of a shape: it fills the unit box."""
    kind = KIND_OF_BODY[name]

    def make():
        unit = shape(name, detail)
        parts = [unit, *(wheels(name) if detail == "body" else ())]  # with which it is shown, but not scanned
        slots = np.repeat(np.arange(len(parts)) + 1, [len(part.faces) for part in parts])
        slots[: len(unit.faces)] = unit.surface == GLASS
        paints = [paint_of("truck" if kind == "long_truck" else kind), glass()]
        paints += [plain("Tire", HEAD), plain("Hub", METAL, roughness=0.4)][: len(parts) - 1]
        made = joined(parts)
        return new_mesh(f"{name} {detail}", made.vertices, made.faces, paints, slots)

    item = add_object(into, title, made_once(bpy.data.meshes, f"{name} {detail}", make), VEHICLE)
    wear_own_paint(item)
    return item


# --- Nodes ------------------------------------------------------------------------------------------------------------


def _nodes() -> bpy.types.NodeTree:
    """The node group that keeps the points of the time shown, and places a body on each."""
    tree = bpy.data.node_groups.new("Traffic", "GeometryNodeTree")
    add_socket(tree, "Geometry", "Geometry")
    add_socket(tree, "Float", "Start")
    add_socket(tree, "Collection", "Bodies")
    add_socket(tree, "Geometry", "Geometry", direction="OUTPUT")

    def read(name, kind="FLOAT"):
        return output(tree, "GeometryNodeInputNamedAttribute", {"Name": name}, data_type=kind)

    given = node(tree, "NodeGroupInput").outputs
    now = math_of(tree, "SUBTRACT", output(tree, "GeometryNodeInputSceneTime"), given["Start"])
    begin, end = read("begin"), read("end")
    soon = math_of(tree, "ADD", now, SAME_S)  # as `Recording.moment`, which takes what is this near for an instant
    begun, over = math_of(tree, "LESS_THAN", soon, begin), math_of(tree, "LESS_THAN", soon, end)
    kept = {0: given["Geometry"], 1: math_of(tree, "SUBTRACT", over, begun)}
    points = output(tree, "GeometryNodeSeparateGeometry", kept, domain="POINT")
    passed = output(tree, "ShaderNodeMapRange", {0: now, 1: begin, 2: end, 3: 0.0, 4: 1.0}, clamp=True)
    move = {0: read("move", "FLOAT_VECTOR"), "Scale": passed}
    move = output(tree, "ShaderNodeVectorMath", move, operation="SCALE")
    points = output(tree, "GeometryNodeSetPosition", {"Geometry": points, "Offset": move})
    heading = math_of(tree, "MULTIPLY_ADD", read("turn"), passed, read("heading"))
    bodies = {"Collection": given["Bodies"], "Separate Children": True}
    placed = {
        "Points": points,
        "Instance": output(tree, "GeometryNodeCollectionInfo", bodies),
        "Pick Instance": True,
        "Instance Index": read("body", "INT"),
        "Rotation": output(tree, "ShaderNodeCombineXYZ", {"Z": heading}),
        "Scale": read("size", "FLOAT_VECTOR"),
    }
    node(tree, "NodeGroupOutput", {0: output(tree, "GeometryNodeInstanceOnPoints", placed)})
    return tree
