"""Blender's BVHTree: the reference caster."""

from __future__ import annotations

import gc
from contextlib import contextmanager
from itertools import repeat
from operator import itemgetter

import bpy  # noqa: F401  (makes mathutils importable where Blender is a Python module)
import numpy as np
from mathutils import Vector
from mathutils.bvhtree import BVHTree

from .protocol import MISS, Caster

_triangle_of = itemgetter(2)  # ray_cast returns (location, normal, index, distance)


class BvhCaster(Caster):
    """Casts with `mathutils.bvhtree.BVHTree`, one merged tree for the whole frame."""

    name = "bvh"

    def _build(self, corners):
        vertices = corners.reshape(-1, 3)
        faces = np.arange(len(vertices)).reshape(-1, 3)
        self._tree = BVHTree.FromPolygons(vertices.tolist(), faces.tolist(), all_triangles=True)

    def _first(self, origins, directions, reach):
        ray_cast = self._tree.ray_cast
        rays = list(map(Vector, directions.tolist()))
        if origins.ndim == 1:
            starts = repeat(Vector(origins.tolist()))
        else:  # one Vector for each run of rays that share their origin
            ends = np.flatnonzero((origins[1:] != origins[:-1]).any(axis=1)) + 1
            bounds = np.concatenate([[0], ends, [len(origins)]])
            shared = [Vector(origin) for origin in origins[bounds[:-1]].tolist()]
            starts = [
                start for start, n in zip(shared, np.diff(bounds).tolist(), strict=True) for start in repeat(start, n)
            ]
        with _collector_paused():
            met = list(map(_triangle_of, map(ray_cast, starts, rays, repeat(float(reach)))))
        return np.array([MISS if index is None else index for index in met], dtype=np.int64)


@contextmanager
def _collector_paused():
    """Without Python's cyclic garbage collector: each result tuple would bring its next sweep nearer."""
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()
