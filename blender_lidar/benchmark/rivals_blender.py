"""What one does within Blender: loops over rays through one tree, a tree for each object, or the scene."""

from __future__ import annotations

from itertools import repeat
from operator import itemgetter

import bpy
import numpy as np
from mathutils import Vector
from mathutils.bvhtree import BVHTree

from ..casting.bvh import without_collector
from ..world.blender.traffic import show_vehicles
from .case import FrameCase
from .rival import NAIVE, NAIVE_SURVIVORS, Rival, all_beams, some_beams

HOISTED = "BVHTree.ray_cast, hoisted loop, all beams"
BARE = "BVHTree.ray_cast, bare calls, returning beams"  # the least that one call for each of these costs
PER_OBJECT = "a BVHTree for each object, all beams"
SCENE = "Scene.ray_cast, all beams"


def blender_rivals(case: FrameCase) -> list[Rival]:
    """All of them; the two slow ones cast a part of the beams."""
    tree = _tree(case.triangles.corners)
    return [
        _naive(NAIVE, case, tree, all_beams(case)),
        _naive(NAIVE_SURVIVORS, case, tree, case.survivors),
        _hoisted(case, tree),
        _bare(case, tree),
        _per_object(case),
        _scene(case),
    ]


def naive_loop(case: FrameCase) -> Rival:
    """The plain loop over all beams through one tree."""
    return _naive(NAIVE, case, _tree(case.triangles.corners), all_beams(case))


def _tree(corners):
    vertices = corners.reshape(-1, 3)
    faces = np.arange(len(vertices)).reshape(-1, 3)
    return BVHTree.FromPolygons(vertices.tolist(), faces.tolist(), all_triangles=True)


def _naive(name, case, tree, beams):
    """As one writes it first: a Vector for each ray, the method looked up each time, what was met in a list."""
    rays, gate = case.directions[beams], case.gate_m
    origin = Vector(case.pose.position.tolist())

    def cast():
        hits = []
        for ray in rays:
            hits.append(tree.ray_cast(origin, Vector(ray), gate))
        return hits

    return Rival(name, cast, _distances, beams)


def _hoisted(case, tree):
    """As fast as the loop gets: Vectors made before, the bound method at hand, no garbage collector."""
    rays, gate = [Vector(ray) for ray in case.directions.tolist()], case.gate_m
    origin = Vector(case.pose.position.tolist())

    def cast():
        with without_collector():
            ray_cast = tree.ray_cast
            return [ray_cast(origin, ray, gate) for ray in rays]

    return Rival(HOISTED, cast, _distances, all_beams(case))


def _bare(case, tree):
    """No loop at all, and of the beams those alone that meet something: known before only here."""
    gate, origin = case.gate_m, Vector(case.pose.position.tolist())
    rays = [Vector(ray) for ray in case.directions[case.survivors].tolist()]
    met = np.array([tree.ray_cast(origin, ray, gate)[2] is not None for ray in rays], dtype=bool)
    rays = [ray for ray, returns in zip(rays, met, strict=True) if returns]

    def cast():
        with without_collector():
            return list(map(itemgetter(3), map(tree.ray_cast, repeat(origin), rays, repeat(gate))))

    return Rival(BARE, cast, np.array, case.survivors[met])


def _per_object(case):
    """A tree for each vehicle; every ray tries them all and keeps the nearest hit."""
    triangles = case.triangles
    trees = [_tree(triangles.corners[triangles.owner == row]) for row in range(len(case.vehicles))]
    beams, scale = some_beams(case)
    rays, gate = case.directions[beams], case.gate_m
    origin = Vector(case.pose.position.tolist())

    def cast():
        hits = []
        for ray in rays:
            direction, nearest = Vector(ray), (None, None, None, None)
            for tree in trees:
                hit = tree.ray_cast(origin, direction, gate)
                if hit[0] is not None and (nearest[0] is None or hit[3] < nearest[3]):
                    nearest = hit
            hits.append(nearest)
        return hits

    return Rival(PER_OBJECT, cast, _distances, beams, scale)


def _scene(case):
    """Rays through a Blender scene that holds the vehicles as objects."""
    scene = bpy.data.scenes.new("benchmark")
    show_vehicles(scene, case.vehicles, case.detail)
    layer = scene.view_layers[0]
    layer.update()
    beams, scale = some_beams(case)
    rays, gate = case.directions[beams], case.gate_m
    origin = Vector(case.pose.position.tolist())

    def cast():
        hits, seen = [], layer.depsgraph
        for ray in rays:
            hits.append(scene.ray_cast(seen, origin, Vector(ray), distance=gate))
        return hits

    def distance(hits):
        return np.array([(location - origin).length if met else np.inf for met, location, *_ in hits])

    return Rival(SCENE, cast, distance, beams, scale)


def _distances(hits):
    """Of what `BVHTree.ray_cast` returns: (location, normal, index, distance), all None where nothing was met."""
    return np.array([np.inf if hit[3] is None else hit[3] for hit in hits])
