"""Embree through embreex, in its fast mode: the margins of `TreeCaster` leave no gaps for its robust mode to close."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from .tree import TreeCaster


@contextmanager
def _own_symbols() -> Iterator[None]:
    """Within a Blender binary on Linux, libraries are loaded with RTLD_DEEPBIND: they prefer their own symbols.

    Debian's Blender links Embree 3, and embreex brings Embree 4: without this it would call into the other and crash.
    """
    if sys.platform != "linux" or not Path("/proc/self/exe").resolve().name.startswith("blender"):
        yield
        return
    flags = sys.getdlopenflags()
    sys.setdlopenflags(os.RTLD_NOW | os.RTLD_LOCAL | os.RTLD_DEEPBIND)
    try:
        yield
    finally:
        sys.setdlopenflags(flags)


with _own_symbols():
    from embreex.mesh_construction import TriangleMesh
    from embreex.rtcore_scene import EmbreeScene


class EmbreeCaster(TreeCaster):
    """Casts with Intel's Embree, in float32: the fastest tree."""

    name = "embree"

    def _build(self, corners):
        self._scene = EmbreeScene(robust=False)
        vertices = np.ascontiguousarray(corners.reshape(-1, 3), dtype=np.float32)
        self._mesh = TriangleMesh(self._scene, vertices, np.arange(len(vertices), dtype=np.int32).reshape(-1, 3))

    def _first(self, origins, directions, reach):
        rays = directions
        if directions.dtype != np.float32:
            rays = np.empty(directions.shape, dtype=np.float32)
            rays[:] = directions
        starts = np.broadcast_to(origins.astype(np.float32), rays.shape)
        return self._scene.run(starts, rays, dists=float(reach))
