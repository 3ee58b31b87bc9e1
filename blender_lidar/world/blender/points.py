"""A point cloud as a mesh with named attributes: a vertex for each return, shown as points by geometry nodes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import bpy
import numpy as np

from .objects import (
    CLOUD,
    add_attribute,
    add_object,
    made_once,
    matrix_of,
    new_mesh,
    nodes_of,
    only_for_the_eye,
    role,
)

_NAME, _LOOK, _COLOUR = "Point cloud", "LiDAR points", "colour"
_RADIUS_M = 0.045
# Linear RGB of what is coloured by a number, evenly over its range.
_BY_ENTROPY = ((0.85, 0.05, 0.02), (0.95, 0.55, 0.02), (0.55, 0.95, 0.25))  # of 0, 0.5 and 1 bit of PE-VGOP
_FADING, _FADED_M = ((0.16, 0.20, 0.26), (0.08, 0.10, 0.14)), 100.0  # of points on no vehicle, by their range
# Viridis at 0, 0.25, 0.5, 0.75 and 1, linear: lighter is more, for those too who see no colours.
_VIRIDIS = ((0.06, 0.0, 0.09), (0.04, 0.08, 0.26), (0.01, 0.28, 0.26), (0.11, 0.58, 0.12), (0.98, 0.8, 0.02))
_GOLDEN = 0.618034  # of a turn from hue to hue: neighbours in the list differ much


def _ramp(values: np.ndarray, colours: Sequence[tuple[float, float, float]]) -> np.ndarray:
    """Linear RGB (n, 3) of values (n,) from 0 to 1, between `colours` that are evenly apart."""
    places = np.linspace(0.0, 1.0, len(colours))
    return np.stack([np.interp(values, places, channel) for channel in zip(*colours, strict=True)], axis=1)


def colours_of(entropy_bits: np.ndarray) -> np.ndarray:
    """Linear RGB (n, 3) of PE-VGOP (n,) [bits]."""
    return _ramp(entropy_bits, _BY_ENTROPY)


def colours_by(name: str, points: Mapping[str, np.ndarray]) -> np.ndarray:
    """Linear RGBA (n, 4), float32, of points by one of their attributes: `entropy`, `vehicle`, `range` and the like.

    By `entropy` those on no vehicle are faint, the more the farther away they are.
    """
    values, colours = points[name], np.ones((len(points[name]), 4), np.float32)
    if name == "entropy":
        elsewhere = _ramp(points["range"] / _FADED_M, _FADING)
        colours[:, :3] = np.where(points["vehicle"][:, None] >= 0, colours_of(values), elsewhere)
    elif name == "vehicle":
        hue = (_GOLDEN * np.unique(values, return_inverse=True)[1].reshape(-1, 1) + np.array([0.0, 1 / 3, 2 / 3])) % 1.0
        colours[:, :3] = np.where(values[:, None] >= 0, np.clip(np.abs(6.0 * hue - 3.0) - 1.0, 0.05, 0.9), 0.2)
    else:
        most = 1.0 if name == "intensity" else float(values.max(initial=0.0)) or 1.0
        colours[:, :3] = _ramp(values / most, _VIRIDIS)
    return colours


def show_cloud(
    lidar: bpy.types.Object, points: Mapping[str, np.ndarray], colour_by: str = "entropy"
) -> bpy.types.Object:
    """The cloud of a LiDAR in the road frame, its child; written in place where there is one.

    Parameters
    ----------
    lidar : Object
        What it belongs to and follows.
    points : mapping of str to ndarray
        Places `xyz` (n, 3) [m], and attributes of the vertices, (n,) each, by their names: `vehicle`, the id of the one
        that a point lies on, -1 for none, `entropy`, its PE-VGOP [bits], `range` [m] and others.
    colour_by : str
        The attribute that colours them, see `colours_by`.
    """
    item = cloud_of(lidar)
    if item is None:
        mesh = new_mesh(_NAME, np.empty((0, 3)), np.empty((0, 3), dtype=int), [_material()])
        item = add_object(lidar.users_collection[0], _NAME, mesh, CLOUD)
        item.hide_select = True
        only_for_the_eye(item)
        item.modifiers.new(_LOOK, "NODES").node_group = made_once(bpy.data.node_groups, _LOOK, _points)
    elif item.data.users > 1:  # of a LiDAR that was duplicated with its cloud linked
        item.data = item.data.copy()
    write_cloud(item.data, points, colour_by)
    item.parent = lidar  # whose frame is another than that of the vertices
    item.matrix_parent_inverse = matrix_of(lidar).inverted_safe()
    return item


def colour_cloud(cloud: bpy.types.Object, name: str) -> None:
    """Colour a cloud by another one of its attributes, as `colours_by` does."""
    mesh, points = cloud.data, {}
    for key in {name, "vehicle", "range"}:
        points[key] = np.empty(len(mesh.vertices))
        mesh.attributes[key].data.foreach_get("value", points[key])
    _colour(mesh, points, name)
    mesh.update()


def _colour(mesh, points, name):
    attribute = mesh.attributes.get(_COLOUR) or mesh.attributes.new(_COLOUR, "FLOAT_COLOR", "POINT")
    attribute.data.foreach_set("color", colours_by(name, points).ravel())


def cloud_of(lidar: bpy.types.Object) -> bpy.types.Object | None:
    """The cloud that a LiDAR has measured, None where it has not."""
    return next((child for child in lidar.children if role(child) == CLOUD), None)


def write_cloud(mesh: bpy.types.Mesh, points: Mapping[str, np.ndarray], colour_by: str = "entropy") -> None:
    """Let the mesh of a cloud hold other points, as for `show_cloud`, in place, coloured as `colours_by` does."""
    if len(mesh.vertices) != len(points["xyz"]):
        mesh.clear_geometry()  # materials stay
        mesh.vertices.add(len(points["xyz"]))
    mesh.vertices.foreach_set("co", np.ascontiguousarray(points["xyz"], dtype=np.float32).ravel())
    for name, values in points.items():
        if name != "xyz":
            add_attribute(mesh, name, _numbers(values) if name == "vehicle" else values)
    _colour(mesh, points, colour_by)
    mesh.update()


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
    """Points of the attribute `colour`, which shine by themselves, so that it is seen as it is under any light."""

    def make():
        material = bpy.data.materials.new(_LOOK)
        material.diffuse_color = (0.9, 0.6, 0.1, 1.0)
        tree = nodes_of(material)
        tree.nodes.clear()
        kinds = ("ShaderNodeAttribute", "ShaderNodeEmission", "ShaderNodeOutputMaterial")
        colour, shine, output = _add_nodes(tree, 0, *kinds)
        colour.attribute_name = _COLOUR
        _link(tree, (colour.outputs["Color"], shine.inputs["Color"]), (shine.outputs[0], output.inputs["Surface"]))
        return material

    return made_once(bpy.data.materials, _LOOK, make)


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
