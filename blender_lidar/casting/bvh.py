"""Blender's BVHTree: the reference caster."""

from __future__ import annotations

import gc
import threading
from contextlib import contextmanager
from itertools import chain, repeat
from operator import itemgetter

import bpy  # first: it makes mathutils importable where Blender is a Python module
import numpy as np
from mathutils import Vector
from mathutils.bvhtree import BVHTree

from .protocol import MISS
from .tree import TreeCaster

_MANY = 20_000  # triangles: a mesh of fewer takes as long as lists do, and lists leave Blender's data alone
_triangle_of = itemgetter(2)  # ray_cast returns (location, normal, index, distance)


class BvhCaster(TreeCaster):
    """Casts with `mathutils.bvhtree.BVHTree`, one merged tree for the whole frame."""

    name = "bvh"

    def _build(self, corners):
        if len(corners) > _MANY and threading.current_thread() is threading.main_thread():  # others may touch no data
            self._tree = _tree_of_mesh(corners)
            return
        vertices = corners.reshape(-1, 3)
        faces = np.arange(len(vertices)).reshape(-1, 3)
        with without_collector():
            self._tree = BVHTree.FromPolygons(vertices.tolist(), faces.tolist(), all_triangles=True)

    def _first(self, origins, directions, reach):
        with without_collector():
            starts = repeat(Vector(origins.tolist())) if origins.ndim == 1 else _shared_vectors(origins)
            # Tuples are parsed faster than Vectors are made, and made fastest of buffers.
            rays = zip(*map(memoryview, np.ascontiguousarray(directions.T)), strict=True)
            met = list(map(_triangle_of, map(self._tree.ray_cast, starts, rays, repeat(float(reach)))))
        return np.nan_to_num(np.array(met, dtype=float), nan=MISS).astype(np.int64)  # None becomes NaN


def _tree_of_mesh(corners):
    """The tree of triangles by way of a mesh, which takes arrays: an object for a while, in no scene."""
    count = len(corners)
    mesh = bpy.data.meshes.new("Triangles")
    try:
        mesh.vertices.add(3 * count)
        mesh.vertices.foreach_set("co", np.ascontiguousarray(corners, dtype=np.float32).ravel())
        mesh.loops.add(3 * count)
        mesh.loops.foreach_set("vertex_index", np.arange(3 * count, dtype=np.int32))
        mesh.polygons.add(count)
        mesh.polygons.foreach_set("loop_start", np.arange(0, 3 * count, 3, dtype=np.int32))
        mesh.polygons.foreach_set("loop_total", np.full(count, 3, dtype=np.int32))
        item, layer = bpy.data.objects.new("Triangles", mesh), bpy.context.view_layer
        return BVHTree.FromObject(item, layer.depsgraph or bpy.context.evaluated_depsgraph_get(), deform=False)
    finally:
        bpy.data.meshes.remove(mesh)  # with its object


def _shared_vectors(origins):
    """A Vector for each ray; one for each run of rays that share their origin."""
    ends = np.flatnonzero((origins[1:] != origins[:-1]).any(axis=1)) + 1
    bounds = np.concatenate([[0], ends, [len(origins)]])
    starts = map(Vector, origins[bounds[:-1]].tolist())
    return chain.from_iterable(map(repeat, starts, np.diff(bounds).tolist()))


@contextmanager
def without_collector():
    """Without Python's cyclic garbage collector: each of many small objects would bring its next sweep nearer."""
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()
