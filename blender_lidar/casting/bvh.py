"""Blender's BVHTree: the reference caster."""

from __future__ import annotations

import gc
from contextlib import contextmanager
from itertools import chain, repeat
from operator import itemgetter

import bpy  # noqa: F401  (makes mathutils importable where Blender is a Python module)
import numpy as np
from mathutils import Vector
from mathutils.bvhtree import BVHTree

from .protocol import MISS
from .tree import TreeCaster

_triangle_of = itemgetter(2)  # ray_cast returns (location, normal, index, distance)


class BvhCaster(TreeCaster):
    """Casts with `mathutils.bvhtree.BVHTree`, one merged tree for the whole frame."""

    name = "bvh"

    def _build(self, corners):
        vertices = corners.reshape(-1, 3)
        faces = np.arange(len(vertices)).reshape(-1, 3)
        self._tree = BVHTree.FromPolygons(vertices.tolist(), faces.tolist(), all_triangles=True)

    def _first(self, origins, directions, reach):
        with without_collector():
            starts = repeat(Vector(origins.tolist())) if origins.ndim == 1 else _shared_vectors(origins)
            # Tuples are parsed faster than Vectors are made, and made fastest of buffers.
            rays = zip(*map(memoryview, np.ascontiguousarray(directions.T)), strict=True)
            met = list(map(_triangle_of, map(self._tree.ray_cast, starts, rays, repeat(float(reach)))))
        return np.array([MISS if index is None else index for index in met], dtype=np.int64)


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
