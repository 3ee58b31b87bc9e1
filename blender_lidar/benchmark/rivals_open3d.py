"""Open3D's RaycastingScene, which stands on Embree too; on one core, as all here."""

from __future__ import annotations

import numpy as np
import open3d

from .case import FrameCase
from .rival import Rival, all_beams

OPEN3D = "Open3D RaycastingScene, all beams"


def open3d_rivals(case: FrameCase) -> list[Rival]:
    """All beams."""
    tensor, dtype = open3d.core.Tensor, open3d.core.Dtype
    vertices = case.triangles.corners.reshape(-1, 3).astype(np.float32)
    faces = np.arange(len(vertices), dtype=np.uint32).reshape(-1, 3)
    scene = open3d.t.geometry.RaycastingScene(nthreads=1)
    scene.add_triangles(tensor(vertices, dtype=dtype.Float32), tensor(faces, dtype=dtype.UInt32))
    origins = np.broadcast_to(case.pose.position, case.directions.shape)
    rays = tensor(np.concatenate([origins, case.directions], axis=1).astype(np.float32), dtype=dtype.Float32)

    def cast():
        return scene.cast_rays(rays, nthreads=1)

    def distance(answer):
        found = answer["t_hit"].numpy().astype(float)
        return np.where(found <= case.gate_m, found, np.inf)  # it knows no range

    return [Rival(OPEN3D, cast, distance, all_beams(case))]
