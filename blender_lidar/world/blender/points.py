"""A point cloud as a mesh with named attributes: a vertex for each return, shown as points by geometry nodes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial

import bpy
import numpy as np

from .nodes import light_nothing, math_of, node, output, ramp_of
from .objects import (
    CLOUD,
    SENSOR,
    add_attribute,
    add_object,
    collection,
    made_once,
    matrix_of,
    new_mesh,
    nodes_of,
    only_for_the_eye,
    role,
    scene_of,
)

_NAME, _COLOUR, _MATERIAL = "Point cloud", "colour", "LiDAR points"
# Linear RGB of what is coloured by a number, evenly over its range.
_BY_ENTROPY = ((0.85, 0.05, 0.02), (0.95, 0.55, 0.02), (0.55, 0.95, 0.25))  # of 0, 0.5 and 1 bit of PE-VGOP
_FADING, _FADED_M = ((0.26, 0.34, 0.46), (0.12, 0.17, 0.25)), 100.0  # of points on no vehicle, by their range
# Viridis at 0, 0.25, 0.5, 0.75 and 1, its dark end lifted off asphalt: lighter is more, whoever looks.
_VIRIDIS = ((0.12, 0.02, 0.28), (0.05, 0.14, 0.46), (0.01, 0.33, 0.34), (0.11, 0.62, 0.13), (0.98, 0.8, 0.02))
# Red, yellow, green, cyan, blue, magenta and red again; what is on nothing is grey.
_HUES = tuple(
    np.clip(np.array([(1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 1, 1), (0, 0, 1), (1, 0, 1), (1, 0, 0)]), 0.05, 0.9)
)
_GREY = (0.2, 0.2, 0.2)
_NAMED = ("vehicle", "label")  # what is no quantity but a number of something, -1 of nothing
_GOLDEN, _AFTER = 0.618034, 987  # of a turn from one number to the next, and after how many the hues come again


def _ramp(values: np.ndarray, colours: Sequence[tuple[float, float, float]]) -> np.ndarray:
    """Linear RGB (n, 3) of values (n,) from 0 to 1, between `colours` that are evenly apart."""
    places = np.linspace(0.0, 1.0, len(colours))
    return np.stack([np.interp(values, places, channel) for channel in zip(*colours, strict=True)], axis=1)


def colours_of(entropy_bits: np.ndarray) -> np.ndarray:
    """Linear RGB (n, 3) of PE-VGOP (n,) [bits]."""
    return _ramp(entropy_bits, _BY_ENTROPY)


def colours_by(name: str, points: Mapping[str, np.ndarray]) -> np.ndarray:
    """Linear RGBA (n, 4), float32, of points by one of their attributes, as the node group `LiDAR Points` makes it.

    By `entropy` those on no vehicle are faint, the more the farther away they are; by `vehicle` and `label` each number
    has a hue of its own, whichever others there are; `intensity` is lifted by its square root, as most of it is low.
    """
    values, colours = points[name], np.ones((len(points[name]), 4), np.float32)
    if name == "entropy":
        elsewhere = _ramp(points["range"] / _FADED_M, _FADING)
        colours[:, :3] = np.where(points["vehicle"][:, None] >= 0, colours_of(values), elsewhere)
    elif name in _NAMED:
        turned = np.fmod(numbers_of(values).astype(np.float32), np.float32(_AFTER)) * np.float32(_GOLDEN)
        colours[:, :3] = np.where(values[:, None] >= 0, _ramp(turned - np.floor(turned), _HUES), _GREY)
    elif name == "intensity":
        colours[:, :3] = _ramp(np.sqrt(values), _VIRIDIS)
    else:
        colours[:, :3] = _ramp(values / (float(values.max(initial=0.0)) or 1.0), _VIRIDIS)
    return colours


def show_cloud(
    lidar: bpy.types.Object,
    points: Mapping[str, np.ndarray],
    colour_by: str = "entropy",
    style: str = "Points",
    depsgraph: bpy.types.Depsgraph | None = None,
) -> bpy.types.Object:
    """The cloud of a LiDAR in the road frame, its child; written in place where there is one.

    Parameters
    ----------
    lidar : Object
        What it belongs to and follows.
    points : mapping of str to ndarray
        Places `xyz` (n, 3) [m], and attributes of the vertices, (n,) each, by their names: `vehicle`, the id of the one
        that a point lies on, -1 for none, `entropy`, its PE-VGOP [bits], `range` [m] and others.
    colour_by, style : str
        The attribute that colours a new cloud, see `colours_by`, in one of `STYLES`; an earlier one keeps its look.
    depsgraph : Depsgraph, optional
        What a renderer has evaluated, see `objects.matrix_of`.
    """
    item = cloud_of(lidar)
    if item is None:
        mesh = new_mesh(_NAME, np.empty((0, 3)), np.empty((0, 3), dtype=int), [_material(_MATERIAL)])
        local = lidar.library is None
        into = lidar.users_collection[0] if local else collection(scene_of(lidar), "LiDAR", SENSOR)
        item = add_object(into, _NAME, mesh, CLOUD)
        item.hide_select = True
        only_for_the_eye(item)
        item.modifiers.new("Look", "NODES")
    elif item.data.users > 1:  # of a LiDAR that was duplicated with its cloud linked
        item.data = item.data.copy()
    write_cloud(item.data, points)
    groups = [one.node_group for one in item.modifiers if one.type == "NODES"]
    if any(group is None for group in groups):
        set_style(item, style)
        set_look(item, {"Color By": colour_by})
    if item.parent != lidar:  # written again, Blender would sort all objects anew
        item.parent = lidar
    item.matrix_parent_inverse = matrix_of(lidar, depsgraph).inverted_safe()  # vertices are in the road frame
    return item


def cloud_of(lidar: bpy.types.Object) -> bpy.types.Object | None:
    """The cloud that a LiDAR has measured, None where it has not; that of another file is not ours to write."""
    return next((child for child in lidar.children if role(child) == CLOUD and child.library is None), None)


def write_cloud(mesh: bpy.types.Mesh, points: Mapping[str, np.ndarray]) -> None:
    """Let the mesh of a cloud hold other points, as for `show_cloud`, in place."""
    if len(mesh.vertices) != len(points["xyz"]):
        mesh.clear_geometry()  # materials stay
        mesh.vertices.add(len(points["xyz"]))
    places, stored = np.ascontiguousarray(points["xyz"], dtype=np.float32).ravel(), mesh.attributes.get("position")
    if stored is None:  # before 3.5
        mesh.vertices.foreach_set("co", places)
    else:  # in a hundredth of the time
        stored.data.foreach_set("vector", places)
    for name, values in points.items():
        if name != "xyz":
            add_attribute(mesh, name, numbers_of(values) if name == "vehicle" else values)
    mesh.update()


def numbers_of(vehicle_id: np.ndarray) -> np.ndarray:
    """Vehicle ids, or numbers in their order where one does not fit into an attribute's 32 bits; -1 stays."""
    if len(vehicle_id) == 0 or vehicle_id.max() < 2**31:
        return vehicle_id
    vehicles = np.unique(vehicle_id[vehicle_id >= 0])
    return np.where(vehicle_id >= 0, np.searchsorted(vehicles, vehicle_id), -1)


# --- Looks: node groups that show vertices as points, as assets ------------------------------------------------------

# By their names: the attribute that colours, the radius [m], how strongly points shine, and what is said of them.
STYLES = {
    "Points": ("range", 0.045, 1.0, "Points of a LiDAR in the colors of one of their attributes"),
    "Rings": ("ring", 0.04, 1.0, "Fine points in a color for each ring of the LiDAR"),
    "Intensity on Black": ("intensity", 0.035, 1.5, "Fine bright points by their intensity, for a dark background"),
    "By Vehicle": ("vehicle", 0.06, 1.0, "Large points in a color for each vehicle, gray elsewhere"),
}
_GROUP = "LiDAR Points"


def set_style(cloud: bpy.types.Object, style: str) -> None:
    """Show a cloud in one of `STYLES`; its inputs are then those of the style. All styles become assets of the file."""
    groups = {name: made_once(bpy.data.node_groups, f"style {name}", partial(_styled, name)) for name in STYLES}
    shows = next((one for one in cloud.modifiers if one.type == "NODES"), None) or cloud.modifiers.new("Look", "NODES")
    shows.node_group = groups[style]
    set_look(cloud, {one.name: one.default_value for one in _inputs(groups[style]) if hasattr(one, "default_value")})


def set_look(cloud: bpy.types.Object, inputs: Mapping[str, object]) -> None:
    """Set inputs of the geometry nodes that show a cloud, or traffic, by their names; those not there are left out."""
    for shows in cloud.modifiers:
        for one in _inputs(shows.node_group) if shows.type == "NODES" and shows.node_group else ():
            if one.name not in inputs:
                continue
            if hasattr(shows, "properties"):  # of Blender 5
                getattr(shows.properties.inputs, one.identifier).value = inputs[one.name]
            else:
                shows[one.identifier] = inputs[one.name]
    cloud.update_tag()


def _inputs(group):
    """The inputs of a group: Blender 4.0 moved them."""
    if not hasattr(group, "interface"):
        return list(group.inputs)
    return [one for one in group.interface.items_tree if one.item_type == "SOCKET" and one.in_out == "INPUT"]


def add_socket(group, kind, name, direction="INPUT"):
    """A socket of the group's own."""
    if hasattr(group, "interface"):
        group.interface.new_socket(name=name, in_out=direction, socket_type=f"NodeSocket{kind}")
    else:
        (group.inputs if direction == "INPUT" else group.outputs).new(f"NodeSocket{kind}", name)


def _material(name: str, strength: float = 1.0) -> bpy.types.Material:
    """Points of the attribute `colour`, which shine by themselves, so that it is seen as it is under any light."""

    def make():
        material = bpy.data.materials.new(name)
        material.diffuse_color = (1.0, 0.75, 0.2, 1.0)  # all that solid views show
        tree = nodes_of(material)
        tree.nodes.clear()
        colour = node(tree, "ShaderNodeAttribute", attribute_name=_COLOUR)
        shine = node(tree, "ShaderNodeEmission", {0: colour.outputs["Color"], 1: strength})
        node(tree, "ShaderNodeOutputMaterial", {0: shine.outputs[0]})
        return light_nothing(material)

    return made_once(bpy.data.materials, name, make)


def _styled(style):
    """The node group of a style: that of all, with other values of its inputs."""
    colour_by, radius_m, strength, told = STYLES[style]
    material = _material(_MATERIAL if style == "Points" else style, strength)
    own = {"Material": material, "Color By": colour_by, "Radius": radius_m, "Range To": 1e6}
    group = _points() if style == "Points" else made_once(bpy.data.node_groups, "style Points", _points).copy()
    for one in _inputs(group):
        if one.name in own:
            one.default_value = own[one.name]
    group.name = _GROUP if style == "Points" else style
    group.asset_mark()
    group.asset_data.description = told
    return group


def _chosen(tree, kind, which, no, yes):
    return output(tree, "GeometryNodeSwitch", {"Switch": which, "False": no, "True": yes}, input_type=kind)


def _colours(tree, shown, by):
    """What `colours_by` does, in nodes."""

    def read(name):
        return output(tree, "GeometryNodeInputNamedAttribute", {"Name": name}, data_type="FLOAT")

    def named(name):
        return output(tree, "FunctionNodeCompare", {"A": by, "B": name}, data_type="STRING", operation="EQUAL")

    value, range_m = read(by), read("range")
    statistic = node(tree, "GeometryNodeAttributeStatistic", {"Geometry": shown, "Attribute": value})
    most = next(one for one in statistic.outputs if one.name == "Max" and one.enabled)
    share = math_of(tree, "DIVIDE", value, most)
    share = _chosen(tree, "FLOAT", named("intensity"), share, math_of(tree, "SQRT", value))
    turned = math_of(tree, "FRACT", math_of(tree, "MULTIPLY", math_of(tree, "MODULO", value, float(_AFTER)), _GOLDEN))
    on_something = math_of(tree, "GREATER_THAN", value, -0.5)
    hue = _chosen(tree, "RGBA", on_something, (*_GREY, 1.0), ramp_of(tree, turned, _HUES))
    elsewhere = ramp_of(tree, math_of(tree, "DIVIDE", range_m, _FADED_M), _FADING)
    on_vehicle = math_of(tree, "GREATER_THAN", read("vehicle"), -0.5)
    entropy = _chosen(tree, "RGBA", on_vehicle, elsewhere, ramp_of(tree, value, _BY_ENTROPY))
    colour = _chosen(tree, "RGBA", named("entropy"), ramp_of(tree, share, _VIRIDIS), entropy)
    for name in _NAMED:
        colour = _chosen(tree, "RGBA", named(name), colour, hue)
    return colour


def _points() -> bpy.types.NodeTree:
    """The node group that shows vertices, or points of a point cloud, in the colours of one of their attributes."""
    tree = bpy.data.node_groups.new(_GROUP, "GeometryNodeTree")
    numbers = dict.fromkeys(("Radius", "Range From", "Range To"), "Float")
    for name, kind in {"Geometry": "Geometry", "Material": "Material", "Color By": "String", **numbers}.items():
        add_socket(tree, kind, name)
    add_socket(tree, "Geometry", "Geometry", direction="OUTPUT")
    if hasattr(tree, "is_modifier"):
        tree.is_modifier = True
    given = node(tree, "NodeGroupInput").outputs
    shown, radius = given["Geometry"], given["Radius"]
    colour = _colours(tree, shown, given["Color By"])
    kind = {"data_type": "FLOAT_COLOR", "domain": "POINT"}
    shown = output(tree, "GeometryNodeStoreNamedAttribute", {0: shown, "Name": _COLOUR, "Value": colour}, **kind)
    range_m = output(tree, "GeometryNodeInputNamedAttribute", {"Name": "range"}, data_type="FLOAT")
    near = math_of(tree, "LESS_THAN", range_m, given["Range From"])
    outside = math_of(tree, "MAXIMUM", near, math_of(tree, "GREATER_THAN", range_m, given["Range To"]))
    shown = output(tree, "GeometryNodeDeleteGeometry", {0: shown, 1: outside}, domain="POINT")
    if bpy.app.version < (4, 0):  # whose Eevee shows no attributes of points: real faces, though slow to make
        ball = output(tree, "GeometryNodeMeshIcoSphere", {"Radius": radius, "Subdivisions": 1})
        shown = output(tree, "GeometryNodeInstanceOnPoints", {"Points": shown, "Instance": ball})
        shown = output(tree, "GeometryNodeRealizeInstances", {0: shown})
    else:  # a style that is dragged onto a cloud finds the points of the one before
        points = node(tree, "GeometryNodeSeparateComponents", {0: shown}).outputs["Point Cloud"]
        again = output(tree, "GeometryNodeSetPointRadius", {0: points, "Radius": radius})
        both = node(tree, "GeometryNodeJoinGeometry", {0: again})
        tree.links.new(output(tree, "GeometryNodeMeshToPoints", {0: shown, "Radius": radius}), both.inputs[0])
        shown = both.outputs[0]
    shown = output(tree, "GeometryNodeSetMaterial", {0: shown, "Material": given["Material"]})
    node(tree, "NodeGroupOutput", {0: shown})
    return tree
