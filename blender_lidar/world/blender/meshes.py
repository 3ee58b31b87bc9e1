"""Mesh data-blocks from arrays, in a few calls whatever their size."""

from __future__ import annotations

from collections.abc import Sequence

import bpy
import numpy as np


def new_mesh(
    name: str,
    vertices: np.ndarray,
    faces: np.ndarray,
    materials: Sequence[bpy.types.Material] = (),
    material_index: np.ndarray | None = None,
) -> bpy.types.Mesh:
    """A mesh of polygons that all have the same number of corners.

    Parameters
    ----------
    name : str
    vertices : ndarray, (n, 3)
        Positions [m, object frame]; stored as float32.
    faces : ndarray of int, (m, corners)
        Vertices of each polygon, counter-clockwise seen from outside; (0, 3) for a cloud of points.
    materials : sequence of Material
        Its material slots.
    material_index : ndarray of int, (m,), optional
        Slot of each polygon; the first for all if left out.
    """
    mesh = bpy.data.meshes.new(name)
    mesh.vertices.add(len(vertices))
    mesh.vertices.foreach_set("co", np.ascontiguousarray(vertices, dtype=np.float32).ravel())
    if len(faces):
        corners = faces.shape[1]
        mesh.loops.add(faces.size)
        mesh.loops.foreach_set("vertex_index", np.ascontiguousarray(faces, dtype=np.int32).ravel())
        mesh.polygons.add(len(faces))
        mesh.polygons.foreach_set("loop_start", np.arange(0, faces.size, corners, dtype=np.int32))
        mesh.polygons.foreach_set("loop_total", np.full(len(faces), corners, dtype=np.int32))
        mesh.polygons.foreach_set("use_smooth", np.zeros(len(faces), dtype=bool))  # Blender 4.1 on shades smoothly
    for material in materials:
        mesh.materials.append(material)
    if material_index is not None:
        mesh.polygons.foreach_set("material_index", np.ascontiguousarray(material_index, dtype=np.int32))
    mesh.update(calc_edges=True)
    return mesh


def add_attribute(mesh: bpy.types.Mesh, name: str, values: np.ndarray) -> None:
    """Give every vertex a number, (n,): whole ones become INT, others FLOAT."""
    whole = values.dtype.kind in "iu"
    attribute = mesh.attributes.new(name, "INT" if whole else "FLOAT", "POINT")
    attribute.data.foreach_set("value", np.ascontiguousarray(values, dtype=np.int32 if whole else np.float32))
