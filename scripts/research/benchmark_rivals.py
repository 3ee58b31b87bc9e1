"""What others cast rays with: the same beams against the same triangles, and what came of it, to be checked."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from dataclasses import dataclass
from itertools import repeat
from operator import itemgetter

import numpy as np

from benchmark_stages import Entry, FrameCase

RIVALS = "rivals"  # group of entries
RAW, RAW_SURVIVORS = "raw Embree, all beams", "raw Embree, the survivors"
NAIVE, NAIVE_SURVIVORS = "BVHTree.ray_cast, naive loop, all beams", "BVHTree.ray_cast, naive loop, the survivors"
HOISTED = "BVHTree.ray_cast, hoisted loop, all beams"
BARE = "BVHTree.ray_cast, bare calls, returning beams"  # the least that one call for each of these costs


@dataclass(frozen=True, slots=True, eq=False)
class Rival:
    """Another way to cast a frame's beams.

    Attributes
    ----------
    name : str
        What it is.
    cast : callable
        Casts them once.
    distance : callable
        Distance along each of its rays [m], (k,), inf where it met nothing within the gate, from what `cast` returns.
    beams : ndarray, (k,)
        Flat indices of the beams that it casts.
    """

    name: str
    cast: Callable[[], object]
    distance: Callable[[object], np.ndarray]
    beams: np.ndarray

    @property
    def entry(self) -> Entry:
        """To be timed."""
        return Entry(self.name, self.cast, RIVALS)


def rivals_of(case: FrameCase) -> list[Rival]:
    """Every rival whose library is here."""
    return [rival for library, (_, make) in _LIBRARIES.items() if _is_here(library) for rival in make(case)]


def rivals_missing() -> dict[str, str]:
    """Rivals that cannot be timed, and why."""
    return {what: f"{name} is not installed" for name, (what, _) in _LIBRARIES.items() if not _is_here(name)}


def all_beams(case: FrameCase) -> np.ndarray:
    """Flat indices of every beam."""
    return np.arange(len(case.directions))


def _is_here(library: str) -> bool:
    return importlib.util.find_spec(library) is not None


# --- Embree as it comes, robust, with nothing of ours around it -------------------------------------------------------


def _embree(case: FrameCase) -> list[Rival]:
    """All beams, and those alone that can reach a counted vehicle."""
    from embreex.mesh_construction import TriangleMesh
    from embreex.rtcore_scene import EmbreeScene

    scene = EmbreeScene(robust=True)
    vertices = case.triangles.corners.reshape(-1, 3).astype(np.float32)
    mesh = TriangleMesh(scene, vertices, np.arange(len(vertices), dtype=np.int32).reshape(-1, 3))

    def rival(name, beams):
        rays = np.ascontiguousarray(case.directions[beams], dtype=np.float32)
        starts = np.tile(case.pose.position.astype(np.float32), (len(rays), 1))

        def cast():
            return mesh is not None and scene.run(starts, rays, dists=case.gate_m)  # the scene does not keep its mesh

        return Rival(name, cast, lambda found: _along(case, case.directions[beams], np.asarray(found)), beams)

    return [rival(RAW, all_beams(case)), rival(RAW_SURVIVORS, case.survivors)]


def _along(case, directions, triangle):
    """Distance to the plane of the triangle that each ray met, (k,) [m]: Embree tells which, not where."""
    met = np.flatnonzero(triangle >= 0)
    corners = case.triangles.corners[triangle[met]]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    away = np.einsum("ij,ij->i", corners[:, 0] - case.pose.position, normal)
    found = np.full(len(triangle), np.inf)
    found[met] = away / np.einsum("ij,ij->i", directions[met], normal)
    return found


# --- what one does within Blender: loops over rays through one tree ---------------------------------------------------


def _blender(case: FrameCase) -> list[Rival]:
    naive = [_naive(NAIVE, case, all_beams(case)), _naive(NAIVE_SURVIVORS, case, case.survivors)]
    return [*naive, _hoisted(case), _bare(case)]


def _tree(corners):
    import bpy  # noqa: F401  (makes mathutils importable where Blender is a Python module)
    from mathutils.bvhtree import BVHTree

    vertices = corners.reshape(-1, 3)
    faces = np.arange(len(vertices)).reshape(-1, 3)
    return BVHTree.FromPolygons(vertices.tolist(), faces.tolist(), all_triangles=True)


def _naive(name, case, beams):
    """As one writes it first: a Vector for each ray, the method looked up each time, what was met in a list."""
    tree, rays, gate = _tree(case.triangles.corners), case.directions[beams], case.gate_m
    from mathutils import Vector

    origin = Vector(case.pose.position.tolist())

    def cast():
        hits = []
        for ray in rays:
            hits.append(tree.ray_cast(origin, Vector(ray), gate))
        return hits

    return Rival(name, cast, _distances, beams)


def _hoisted(case):
    """As fast as the loop gets: Vectors made before, the bound method at hand, no garbage collector."""
    from mathutils import Vector

    from blender_lidar.casting.bvh import without_collector

    tree, gate = _tree(case.triangles.corners), case.gate_m
    origin, rays = Vector(case.pose.position.tolist()), [Vector(ray) for ray in case.directions.tolist()]

    def cast():
        with without_collector():
            ray_cast = tree.ray_cast
            return [ray_cast(origin, ray, gate) for ray in rays]

    return Rival(HOISTED, cast, _distances, all_beams(case))


def _bare(case):
    """No loop at all, and of the beams those alone that meet something: known before only here."""
    from mathutils import Vector

    from blender_lidar.casting.bvh import without_collector

    tree, gate, origin = _tree(case.triangles.corners), case.gate_m, Vector(case.pose.position.tolist())
    rays = [Vector(ray) for ray in case.directions[case.survivors].tolist()]
    met = np.array([tree.ray_cast(origin, ray, gate)[2] is not None for ray in rays], dtype=bool)
    rays = [ray for ray, returns in zip(rays, met, strict=True) if returns]

    def cast():
        with without_collector():
            return list(map(itemgetter(3), map(tree.ray_cast, repeat(origin), rays, repeat(gate))))

    return Rival(BARE, cast, np.array, case.survivors[met])


def _distances(hits):
    """Of what `BVHTree.ray_cast` returns: (location, normal, index, distance), all None where nothing was met."""
    return np.array([np.inf if hit[3] is None else hit[3] for hit in hits])


# Library -> what its rivals are for who has it not, what makes them.
_LIBRARIES = {
    "embreex": ("raw Embree", _embree),
    "bpy": ("Blender's BVHTree", _blender),
}
