"""A point cloud as a mesh with named attributes: a vertex for each return, shown as points by geometry nodes."""

from __future__ import annotations

from collections.abc import Mapping

import bpy
import numpy as np

from .objects import (
    CLOUD,
    COLOURED,
    add_attribute,
    add_object,
    clear,
    collection,
    made_once,
    matrix_of,
    new_mesh,
    nodes_of,
    only_for_the_eye,
    role,
)

_NAME, _LOOK = "Point cloud", "LiDAR points"
_RADIUS_M = 0.045
# Linear RGB by value, for what is coloured by a number: of nothing seen, of half and of a whole bit of PE-VGOP.
_BITS, _BY_ENTROPY = (0.0, 1.0), ((0.85, 0.05, 0.02), (0.95, 0.55, 0.02), (0.55, 0.95, 0.25))


def colours_of(entropy_bits: np.ndarray) -> np.ndarray:
    """Linear RGB (n, 3) of PE-VGOP (n,) [bits]."""
    places = np.linspace(*_BITS, len(_BY_ENTROPY))
    return np.stack([np.interp(entropy_bits, places, channel) for channel in zip(*_BY_ENTROPY, strict=True)], axis=1)


# Viridis at 0, 0.25, 0.5, 0.75 and 1, linear: lighter is more, for those too who see no colours.
_VIRIDIS = ((0.06, 0.0, 0.09), (0.04, 0.08, 0.26), (0.01, 0.28, 0.26), (0.11, 0.58, 0.12), (0.98, 0.8, 0.02))
_GOLDEN = 0.618034  # of a turn from hue to hue: neighbours in the list differ much


def colours_by(name: str, points: Mapping[str, np.ndarray]) -> np.ndarray:
    """Linear RGBA (n, 4), float32, of points by one of their attributes: `entropy`, `vehicle`, `range` and the like."""
    values, colours = points[name], np.ones((len(points[name]), 4), np.float32)
    if name == "entropy":
        colours[:, :3] = np.where(points["vehicle"][:, None] >= 0, colours_of(values), (0.16, 0.2, 0.26))
    elif name == "vehicle":
        hue = (_GOLDEN * np.unique(values, return_inverse=True)[1].reshape(-1, 1) + np.array([0.0, 1 / 3, 2 / 3])) % 1.0
        colours[:, :3] = np.where(values[:, None] >= 0, np.clip(np.abs(6.0 * hue - 3.0) - 1.0, 0.05, 0.9), 0.2)
    else:
        most = 1.0 if name == "intensity" else float(values.max(initial=0.0)) or 1.0
        places = np.linspace(0.0, 1.0, len(_VIRIDIS))
        for channel, of in enumerate(zip(*_VIRIDIS, strict=True)):
            colours[:, channel] = np.interp(values / most, places, of)
    return colours


def build_cloud(
    scene: bpy.types.Scene, points: Mapping[str, np.ndarray] | None, lidar: bpy.types.Object | None = None
) -> bpy.types.Object | None:
    """A cloud in the road frame, in place of an earlier one; None only takes that away.

    Parameters
    ----------
    points : mapping of str to ndarray, or None
        Places `xyz` (n, 3) [m], and attributes of the vertices, (n,) each, by their names. Two colour them: `vehicle`,
        the id of the one that a point lies on, -1 for none, and `entropy`, its PE-VGOP [bits]; all others `range` [m].
    lidar : Object, optional
        What it belongs to and follows.
    """
    into = collection(scene, _NAME, CLOUD)
    clear(into)
    return None if points is None else _new_cloud(into, points, lidar)


def show_cloud(lidar: bpy.types.Object, points: Mapping[str, np.ndarray]) -> bpy.types.Object:
    """The cloud of a LiDAR, its child: as `build_cloud`, written in place where there is one."""
    item = cloud_of(lidar)
    if item is None:
        return _new_cloud(lidar.users_collection[0], points, lidar)
    if item.data.users > 1:  # of a LiDAR that was duplicated with its cloud linked
        item.data = item.data.copy()
    write_cloud(item.data, points)
    _fasten(item, lidar)
    return item


def colour_cloud(cloud: bpy.types.Object, name: str) -> None:
    """Colour a cloud by one of its attributes, as `colours_by` does, no more as `build_cloud` does."""
    mesh, points = cloud.data, {}
    for key in {name, "vehicle"}:
        points[key] = np.empty(len(mesh.vertices))
        mesh.attributes[key].data.foreach_get("value", points[key])
    colour = mesh.attributes.get("colour") or mesh.attributes.new("colour", "FLOAT_COLOR", "POINT")
    colour.data.foreach_set("color", colours_by(name, points).ravel())
    mesh.update()
    cloud[COLOURED] = 1.0


def cloud_of(lidar: bpy.types.Object) -> bpy.types.Object | None:
    """The cloud that a LiDAR has measured, None where it has not."""
    return next((child for child in lidar.children if role(child) == CLOUD), None)


def _new_cloud(into, points, lidar):
    mesh = new_mesh(_NAME, np.empty((0, 3)), np.empty((0, 3), dtype=int), [_material()])
    write_cloud(mesh, points)
    item = add_object(into, _NAME, mesh, CLOUD)
    only_for_the_eye(item)
    item.modifiers.new(_LOOK, "NODES").node_group = made_once(bpy.data.node_groups, _LOOK, _points)
    if lidar is not None:
        item.hide_select = True
        _fasten(item, lidar)
    return item


def write_cloud(mesh: bpy.types.Mesh, points: Mapping[str, np.ndarray]) -> None:
    """Let the mesh of a cloud hold other points, as for `build_cloud`, in place."""
    if len(mesh.vertices) != len(points["xyz"]):
        mesh.clear_geometry()  # materials stay
        mesh.vertices.add(len(points["xyz"]))
    mesh.vertices.foreach_set("co", np.ascontiguousarray(points["xyz"], dtype=np.float32).ravel())
    for name, values in points.items():
        if name != "xyz":
            add_attribute(mesh, name, _numbers(values) if name == "vehicle" else values)
    mesh.update()


def _fasten(item, lidar):
    """Let a cloud, whose vertices are in the road frame, follow its LiDAR from where that hangs now."""
    item.parent = lidar
    item.matrix_parent_inverse = matrix_of(lidar).inverted_safe()


def _numbers(vehicle_id: np.ndarray) -> np.ndarray:
    """Vehicle ids, or numbers in their order where one does not fit into an attribute's 32 bits; -1 stays."""
    if len(vehicle_id) == 0 or vehicle_id.max() < 2**31:
        return vehicle_id
    vehicles = np.unique(vehicle_id[vehicle_id >= 0])
    return np.where(vehicle_id >= 0, np.searchsorted(vehicles, vehicle_id), -1)


# --- Nodes: the look of the points ------------------------------------------------------------------------------------


def _add_nodes(tree, row, *kinds):
    """New nodes of some kinds, side by side in a row."""
    nodes = [tree.nodes.new(kind) for kind in kinds]
    for column, node in enumerate(nodes):
        node.location = (220.0 * column, -260.0 * row)
    return nodes


def _link(tree, *links):
    """Join outputs to inputs."""
    for output, into in links:
        tree.links.new(output, into)


def _material() -> bpy.types.Material:
    """Colours points on vehicles by their vehicle's `entropy`, and all others faintly by `range`, or all as chosen.

    The points shine by themselves, so that their colours are those of the ramps under any light.
    """
    return made_once(bpy.data.materials, _LOOK, _shining)


def _shining():
    material = bpy.data.materials.new(_LOOK)
    material.diffuse_color = (0.9, 0.6, 0.1, 1.0)
    tree = nodes_of(material)
    tree.nodes.clear()
    elsewhere = _ramp(tree, 1, "range", (0.0, 100.0), ((0.16, 0.20, 0.26), (0.08, 0.10, 0.14)))
    on_vehicle = _ramp(tree, 2, "entropy", _BITS, _BY_ENTROPY)
    vehicle, is_vehicle, mix, chosen, output = _add_nodes(
        tree,
        0,
        "ShaderNodeAttribute",
        "ShaderNodeMath",
        "ShaderNodeMixShader",
        "ShaderNodeMixShader",
        "ShaderNodeOutputMaterial",
    )
    coloured, colour, shine = _add_nodes(tree, 3, "ShaderNodeAttribute", "ShaderNodeAttribute", "ShaderNodeEmission")
    coloured.attribute_type, coloured.attribute_name, colour.attribute_name = "OBJECT", COLOURED, "colour"
    vehicle.attribute_name = "vehicle"
    is_vehicle.operation, is_vehicle.inputs[1].default_value = "GREATER_THAN", -0.5
    _link(
        tree,
        (vehicle.outputs["Fac"], is_vehicle.inputs[0]),
        (is_vehicle.outputs[0], mix.inputs[0]),
        (elsewhere, mix.inputs[1]),
        (on_vehicle, mix.inputs[2]),
        (colour.outputs["Color"], shine.inputs["Color"]),
        (coloured.outputs["Fac"], chosen.inputs[0]),
        (mix.outputs[0], chosen.inputs[1]),
        (shine.outputs[0], chosen.inputs[2]),
        (chosen.outputs[0], output.inputs["Surface"]),
    )
    return material


def _ramp(tree, row, attribute, bounds, colours):
    """A shining colour that runs through `colours` as an attribute goes from one bound to the other."""
    value, scaled, ramp, shine = _add_nodes(
        tree, row, "ShaderNodeAttribute", "ShaderNodeMapRange", "ShaderNodeValToRGB", "ShaderNodeEmission"
    )
    value.attribute_name = attribute
    scaled.inputs["From Min"].default_value, scaled.inputs["From Max"].default_value = bounds
    elements = ramp.color_ramp.elements
    elements[0].color, elements[-1].color = (*colours[0], 1.0), (*colours[-1], 1.0)
    for place, colour in enumerate(colours[1:-1], start=1):
        elements.new(place / (len(colours) - 1)).color = (*colour, 1.0)
    _link(
        tree,
        (value.outputs["Fac"], scaled.inputs["Value"]),
        (scaled.outputs[0], ramp.inputs["Fac"]),
        (ramp.outputs["Color"], shine.inputs["Color"]),
    )
    return shine.outputs[0]


def _points() -> bpy.types.NodeTree:
    """The node group that shows vertices as points; their radius is an input of the modifier."""
    group = bpy.data.node_groups.new(_LOOK, "GeometryNodeTree")
    _socket(group, "Geometry", "INPUT", "NodeSocketGeometry")
    _socket(group, "Radius", "INPUT", "NodeSocketFloat").default_value = _RADIUS_M
    _socket(group, "Geometry", "OUTPUT", "NodeSocketGeometry")
    given, made, coloured, result = _add_nodes(
        group, 0, "NodeGroupInput", "GeometryNodeMeshToPoints", "GeometryNodeSetMaterial", "NodeGroupOutput"
    )
    coloured.inputs["Material"].default_value = _material()
    vertices, radius = given.outputs["Geometry"], given.outputs["Radius"]
    _link(
        group,
        (vertices, made.inputs["Mesh"]),
        (radius, made.inputs["Radius"]),
        (coloured.outputs["Geometry"], result.inputs["Geometry"]),
    )
    shown = made.outputs[0]
    if bpy.app.version < (4, 0):  # whose Eevee shows no attributes of points: real faces, though slow to make
        ball, placed, real = _add_nodes(
            group, 1, "GeometryNodeMeshIcoSphere", "GeometryNodeInstanceOnPoints", "GeometryNodeRealizeInstances"
        )
        ball.inputs["Subdivisions"].default_value = 1
        _link(
            group,
            (radius, ball.inputs["Radius"]),
            (vertices, placed.inputs["Points"]),
            (ball.outputs["Mesh"], placed.inputs["Instance"]),
            (placed.outputs["Instances"], real.inputs["Geometry"]),
        )
        group.nodes.remove(made)
        shown = real.outputs["Geometry"]
    _link(group, (shown, coloured.inputs["Geometry"]))
    return group


def _socket(group, name, direction, kind):
    """A socket of the group's own: Blender 4.0 moved them."""
    if hasattr(group, "interface"):
        return group.interface.new_socket(name=name, in_out=direction, socket_type=kind)
    return (group.inputs if direction == "INPUT" else group.outputs).new(kind, name)
