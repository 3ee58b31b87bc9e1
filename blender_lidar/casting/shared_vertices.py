"""Triangles as indices into vertices that they share, in runs of neighbours, each with a sphere about it."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ..compiled import compiled

RUN = 16  # triangles: neighbours in the list tend to be neighbours in space
_MIXERS = tuple(  # odd, else arbitrary
    map(np.uint64, (0x9E3779B97F4A7C15, 0xC2B2AE3D27D4EB4F, 0x165667B19E3779F9, 0xD6E8FEB86659FD93))
)
_ROUNDING = 1e-12  # relative: what rounding may take off a radius


class Mesh(NamedTuple):
    """Triangles made ready for `sweep`.

    Attributes
    ----------
    vertices : ndarray, (v, 3)
        Each place once [m].
    faces : ndarray of int32, (m, 3)
        Rows of the corners of each triangle.
    middle, radius : ndarray, (r, 3) and (r,)
        Sphere about each run of `RUN` triangles [m].
    low, high : ndarray, (s, 3)
        Boxes about what hangs together by its vertices [m]: a solid lies within one of them.
    """

    vertices: np.ndarray
    faces: np.ndarray
    middle: np.ndarray
    radius: np.ndarray
    low: np.ndarray
    high: np.ndarray


def mesh_of(corners: np.ndarray) -> Mesh:
    """Triangles `corners` (m, 3, 3) [m], at least one, with the vertices that they share."""
    flat = np.ascontiguousarray(corners.reshape(-1, 3)) + 0.0  # -0 becomes 0: they are the same place
    row, first = _same_places(flat.view(np.uint64), _table_size(len(flat)))
    vertices, faces = flat[first], row.reshape(-1, 3)
    middle, radius = _spheres(vertices, faces)
    return Mesh(vertices, faces, middle, radius + _ROUNDING * np.abs(vertices).max(), *_solids(vertices, faces))


def _table_size(places: int) -> int:
    return 1 << int(2 * places - 1).bit_length()


@compiled
def _same_places(bits, size):
    """Row of the first equal place for each of (n, 3), numbered as they come, and which places came first."""
    table = np.full(size, -1, dtype=np.int32)
    row, first, found = np.empty(len(bits), dtype=np.int32), np.empty(len(bits), dtype=np.int32), 0
    for i in range(len(bits)):
        x, y, z = bits[i, 0], bits[i, 1], bits[i, 2]
        mixed = (x * _MIXERS[0]) ^ (y * _MIXERS[1]) ^ (z * _MIXERS[2])
        mixed = (mixed ^ (mixed >> np.uint64(32))) * _MIXERS[3]  # round numbers have few bits, all of them high ones
        slot = np.int64((mixed ^ (mixed >> np.uint64(32))) & np.uint64(size - 1))
        while True:
            there = table[slot]
            if there < 0:
                table[slot], first[found], row[i] = found, i, found
                found += 1
                break
            at = first[there]
            if bits[at, 0] == x and bits[at, 1] == y and bits[at, 2] == z:
                row[i] = there
                break
            slot = (slot + 1) & (size - 1)
    return row, first[:found].copy()


@compiled
def _spheres(vertices, faces):
    """Spheres about runs of triangles: middle (r, 3) of their boxes, and radius (r,)."""
    runs = (len(faces) + RUN - 1) // RUN
    middle, radius = np.empty((runs, 3)), np.empty(runs)
    for run in range(runs):
        corners = faces[run * RUN : (run + 1) * RUN].reshape(-1)
        low, high = vertices[corners[0]].copy(), vertices[corners[0]].copy()
        for v in corners:
            for axis in range(3):
                low[axis], high[axis] = min(low[axis], vertices[v, axis]), max(high[axis], vertices[v, axis])
        farthest = 0.0
        for axis in range(3):
            middle[run, axis] = 0.5 * (low[axis] + high[axis])
        for v in corners:
            x, y, z = vertices[v, 0] - middle[run, 0], vertices[v, 1] - middle[run, 1], vertices[v, 2] - middle[run, 2]
            farthest = max(farthest, x * x + y * y + z * z)
        radius[run] = math.sqrt(farthest)
    return middle, radius


@compiled
def _solids(vertices, faces):
    """Boxes about what hangs together: low (s, 3) and high (s, 3)."""
    parent = np.arange(len(vertices))
    for t in range(len(faces)):
        a = _root(parent, faces[t, 0])
        for k in range(1, 3):
            b = _root(parent, faces[t, k])
            parent[b] = a
    number, found = np.full(len(vertices), -1), 0
    low, high = np.empty_like(vertices), np.empty_like(vertices)
    for v in range(len(vertices)):
        top = _root(parent, v)
        if number[top] < 0:
            number[top], low[found], high[found] = found, vertices[v], vertices[v]
            found += 1
        box = number[top]
        for axis in range(3):
            low[box, axis], high[box, axis] = (
                min(low[box, axis], vertices[v, axis]),
                max(high[box, axis], vertices[v, axis]),
            )
    return low[:found].copy(), high[:found].copy()


@compiled
def _root(parent, v):
    while parent[v] != v:
        parent[v] = parent[parent[v]]
        v = parent[v]
    return v
