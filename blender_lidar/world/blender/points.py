"""A point cloud as a mesh with named attributes: a vertex for each return, shown as spheres by geometry nodes."""

from __future__ import annotations

import bpy
import numpy as np

from ...clouds.scan import PointCloud
from .objects import (
    CLOUD,
    KEY,
    add_attribute,
    add_object,
    clear,
    collection,
    new_mesh,
    of_ours,
    only_for_the_eye,
    point_material,
)

_NAME = "Point cloud"
_GROUP, _MATERIAL = "LiDAR points", "LiDAR points"
_RADIUS_M = 0.045
_BITS = (0.0, 1.0)  # of a vehicle's PE-VGOP: the colours' range


def build_cloud(
    scene: bpy.types.Scene,
    cloud: PointCloud | None,
    entropy_bits: np.ndarray | None = None,
) -> bpy.types.Object | None:
    """A cloud in the road frame, in place of an earlier one; None only takes that away.

    Its vertices carry `range` [m], `ring`, `intensity`, `vehicle` (-1 for anything else), `time` [s] and `entropy`.

    Parameters
    ----------
    entropy_bits : ndarray, (n,), optional
        PE-VGOP of the vehicle that each point lies on [bits]; 0 if left out.
    """
    into = collection(scene, _NAME, CLOUD)
    clear(into)
    if cloud is None:
        return None
    mesh = new_mesh(_NAME, cloud.xyz, np.empty((0, 3), dtype=int), [_material()])
    columns = {
        "range": cloud.range_m,
        "ring": cloud.ring,
        "intensity": cloud.intensity,
        "vehicle": _numbers(cloud.vehicle_id),
        "entropy": np.zeros(len(cloud)) if entropy_bits is None else entropy_bits,
        "time": cloud.time_s,
    }
    for column, values in columns.items():
        add_attribute(mesh, column, values)
    item = add_object(into, _NAME, mesh)
    only_for_the_eye(item)
    shown = item.modifiers.new(_GROUP, "NODES")
    shown.node_group = _group()
    return item


def _numbers(vehicle_id: np.ndarray) -> np.ndarray:
    """Vehicle ids, or numbers in their order where one does not fit into an attribute's 32 bits; -1 stays."""
    if len(vehicle_id) == 0 or vehicle_id.max() < 2**31:
        return vehicle_id
    vehicles = np.unique(vehicle_id[vehicle_id >= 0])
    return np.where(vehicle_id >= 0, np.searchsorted(vehicles, vehicle_id), -1)


def _material() -> bpy.types.Material:
    material = of_ours(bpy.data.materials, _MATERIAL)
    return point_material(_MATERIAL, _BITS) if material is None else material


def _group() -> bpy.types.NodeTree:
    """The node group that shows vertices as spheres; its radius is an input of the modifier."""
    group = of_ours(bpy.data.node_groups, _GROUP)
    if group is not None:
        return group
    group = bpy.data.node_groups.new(_GROUP, "GeometryNodeTree")
    group[KEY] = _GROUP
    _socket(group, "Geometry", "INPUT", "NodeSocketGeometry")
    _socket(group, "Radius", "INPUT", "NodeSocketFloat").default_value = _RADIUS_M
    _socket(group, "Geometry", "OUTPUT", "NodeSocketGeometry")
    kinds = (
        "NodeGroupInput",
        "GeometryNodeMeshIcoSphere",
        "GeometryNodeInstanceOnPoints",
        "GeometryNodeRealizeInstances",  # real faces: Eevee shows no attributes of a cloud of points
        "GeometryNodeSetMaterial",
        "NodeGroupOutput",
    )
    given, ball, placed, real, coloured, result = nodes = [group.nodes.new(kind) for kind in kinds]
    ball.inputs["Subdivisions"].default_value = 1
    coloured.inputs["Material"].default_value = _material()
    for start, end in (
        (given.outputs["Radius"], ball.inputs["Radius"]),
        (given.outputs["Geometry"], placed.inputs["Points"]),
        (ball.outputs["Mesh"], placed.inputs["Instance"]),
        (placed.outputs["Instances"], real.inputs["Geometry"]),
        (real.outputs["Geometry"], coloured.inputs["Geometry"]),
        (coloured.outputs["Geometry"], result.inputs["Geometry"]),
    ):
        group.links.new(start, end)
    for column, node in enumerate(nodes):
        node.location = (200.0 * column, 0.0)
    return group


def _socket(group, name, direction, kind):
    """A socket of the group's own: Blender 4.0 moved them."""
    if hasattr(group, "interface"):
        return group.interface.new_socket(name=name, in_out=direction, socket_type=kind)
    return (group.inputs if direction == "INPUT" else group.outputs).new(kind, name)
