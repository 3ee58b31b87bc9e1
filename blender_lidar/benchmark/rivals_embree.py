"""Embree as it comes: embreex alone, robust, with nothing of ours around it."""

from __future__ import annotations

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene

from .case import FrameCase
from .rival import RAW, RAW_SURVIVORS, Rival, all_beams


def embree_rivals(case: FrameCase) -> list[Rival]:
    """All beams, and those alone that can reach a counted vehicle."""
    scene = EmbreeScene(robust=True)
    vertices = case.triangles.corners.reshape(-1, 3).astype(np.float32)
    mesh = TriangleMesh(scene, vertices, np.arange(len(vertices), dtype=np.int32).reshape(-1, 3))
    return [
        _rival(RAW, case, scene, mesh, all_beams(case)),
        _rival(RAW_SURVIVORS, case, scene, mesh, case.survivors),
    ]


def _rival(name, case, scene, mesh, beams):
    rays = np.ascontiguousarray(case.directions[beams], dtype=np.float32)
    starts = np.tile(case.pose.position.astype(np.float32), (len(rays), 1))

    def cast():
        return mesh is not None and scene.run(starts, rays, dists=case.gate_m)  # the scene does not keep its mesh

    def distance(triangle):
        return _along(case, case.directions[beams], np.asarray(triangle))

    return Rival(name, cast, distance, beams)


def _along(case, directions, triangle):
    """Distance to the plane of the triangle that each ray met, (k,) [m]: it tells which, not where."""
    met = np.flatnonzero(triangle >= 0)
    corners = case.triangles.corners[triangle[met]]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lacking = np.einsum("ij,ij->i", corners[:, 0] - case.pose.position, normal)
    found = np.full(len(triangle), np.inf)
    found[met] = lacking / np.einsum("ij,ij->i", directions[met], normal)
    return found
