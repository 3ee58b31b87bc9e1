"""Closed triangle meshes by lofting: rings of points joined one to the next and closed by a cap at either end.

Every part of a vehicle is such a tube, a wheel as well as a body, and a shape is any number of them; where they overlap
a ray from outside meets the outermost first. So shapes are closed and their faces point outwards by construction.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

# What a triangle is made of; its index is stored per triangle.
SURFACES = ("paint", "glass", "road", "structure", "building", "vegetation", "person", "cyclist")
PAINT, GLASS, ROAD, STRUCTURE, BUILDING, VEGETATION, PERSON, CYCLIST = range(8)
_STEPS = 200  # of a reflectivity from 0 to 1: a surface for each, of materials of the user's own
OWN_SURFACE = len(SURFACES)
"""The class of what is made of a material of the user's own and of no kind that is said."""
_KINDS = (STRUCTURE, BUILDING, VEGETATION)  # of things of the user's own, in the order of their surfaces; `BOX_KINDS`
# Diffuse, at 905 nm, of `SURFACES`: round numbers, not measurements; and of the surfaces by `surface_of`, of each kind.
REFLECTIVITY = np.concatenate(
    [[0.5, 0.1, 0.2, 0.3, 0.3, 0.3, 0.3, 0.3], np.tile(np.arange(_STEPS + 1) / _STEPS, len(_KINDS))]
)
SURFACE_CLASS = np.concatenate(
    [np.arange(OWN_SURFACE), np.repeat([OWN_SURFACE, BUILDING, VEGETATION], _STEPS + 1)]
).astype(np.uint8)
"""Surface class of each surface, an index into `REFLECTIVITY`: an index into `SURFACES`, or `OWN_SURFACE`."""

_EQUAL = 1e-9  # relative: lengths that differ by less are equal


def surface_of(reflectivity: float) -> int:
    """The surface of a diffuse reflectivity, 0 to 1, to half a percent: an index into `REFLECTIVITY`."""
    return OWN_SURFACE + round(_STEPS * min(max(float(reflectivity), 0.0), 1.0))


def of_kind(surface: np.ndarray, kind: int | np.ndarray) -> np.ndarray:
    """Surfaces (m,) of things of a kind, `STRUCTURE`, `BUILDING` or `VEGETATION`: they reflect as before, panes too."""
    first = (_STEPS + 1) * np.searchsorted(_KINDS, kind)
    bare = np.where(surface == STRUCTURE, kind, surface)
    return np.where(surface >= OWN_SURFACE, OWN_SURFACE + first + (surface - OWN_SURFACE) % (_STEPS + 1), bare).astype(
        np.uint16
    )


@dataclass(frozen=True, slots=True)
class Shape:
    """A closed triangle mesh.

    Attributes
    ----------
    vertices : ndarray, (n, 3)
        Corners: of a vehicle's shape each coordinate in [-0.5, 0.5], of a part of it [m].
    faces : ndarray of int, (m, 3)
        Corners of each triangle, counter-clockwise seen from outside.
    surface : ndarray of uint8, (m,)
        Index into `SURFACES`.
    """

    vertices: np.ndarray
    faces: np.ndarray
    surface: np.ndarray


def tube(rings, glass=None, *, shorter: bool = True) -> Shape:
    """Join rings of points and close both ends.

    Parameters
    ----------
    rings : array, (s, n, 3)
        Points of each ring [m], all rings in the same sense, none of them crossing itself.
    glass : array of bool, (s - 1, n), optional
        Which of the quads between two rings, from each point to the next, are glass.
    shorter : bool
        Whether each quad is cut along its shorter diagonal, or else all from the first point to the next ring's second.

    Returns
    -------
    Shape
        2 n (s - 1) triangles along the tube, and n - 2 in each cap.
    """
    rings = np.asarray(rings, dtype=float)
    stations, around = rings.shape[:2]
    vertices = rings.reshape(-1, 3)
    a = np.add.outer(around * np.arange(stations - 1), np.arange(around)).ravel()
    b = np.add.outer(around * np.arange(stations - 1), np.roll(np.arange(around), -1)).ravel()
    c, d = b + around, a + around
    first, second = (np.linalg.norm(vertices[p] - vertices[q], axis=1) for p, q in ((a, c), (b, d)))
    # Of equal ones the second half of a ring takes the other, so that what is the same on both sides stays so.
    slack = np.tile(np.where(2 * np.arange(around) < around - 1, _EQUAL, -_EQUAL), stations - 1)
    along_first = np.logical_or(not shorter, first <= second * (1.0 + slack))[:, None]
    sides = np.where(along_first, np.stack([a, b, c, a, c, d], axis=1), np.stack([b, c, d, b, d, a], axis=1))
    cap = _zigzag(around)
    faces = np.concatenate([sides.reshape(-1, 3), cap[:, ::-1], cap + around * (stations - 1)])
    surface = np.full(len(faces), PAINT, dtype=np.uint8)
    if glass is not None:
        surface[: 2 * len(a)][np.repeat(np.ravel(glass), 2)] = GLASS
    inside_out = volume(vertices[faces]) < 0.0
    return Shape(vertices, faces[:, ::-1] if inside_out else faces, surface)


def _zigzag(around: int) -> np.ndarray:
    """Triangles (n - 2, 3) between both sides of a ring that closes on itself: the first point faces the last."""
    triangles, left, right = [], 0, around - 1
    while right - left >= 2:
        triangles.append((left, left + 1, right))
        if right - left >= 3:
            triangles.append((left + 1, right - 1, right))
        left, right = left + 1, right - 1
    return np.array(triangles)


def volume(corners: np.ndarray) -> float:
    """What closed triangles (m, 3, 3) enclose; below 0 if they are inside out."""
    return float(np.einsum("ti,ti->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6.0)


def block(low, high) -> Shape:
    """The box between two corners: twelve triangles."""
    (x0, y0, z0), (x1, y1, z1) = low, high
    return tube([[(x, y0, z0), (x, y1, z0), (x, y1, z1), (x, y0, z1)] for x in (x0, x1)])


def drum(middle, radius: float, width: float, sides: int) -> Shape:
    """A wheel: a prism about an axis along y, which stands on one of its flat sides at the height ``z - radius``."""
    x, y, z = middle
    turn = 2.0 * np.pi * (np.arange(sides) - 0.25 * sides + 0.5) / sides
    rim = radius / np.cos(np.pi / sides)  # where sides meet
    across, up = x + rim * np.cos(turn), z + rim * np.sin(turn)
    return tube([np.stack([across, np.full(sides, side), up], axis=1) for side in (y - width / 2, y + width / 2)])


def limb(spine, sides: int = 6) -> Shape:
    """A tube along a spine, of elliptical rings square to the way from its first to its last point.

    Parameters
    ----------
    spine : sequence of (x, y, z, half_width, half_depth)
        Middle of each ring and its half-axes [m], the first of them across the vehicle; the way must not lead along y.
    sides : int
        Points of each ring; even, so that a limb with y = 0 is the same on both sides.
    """
    spine = np.asarray(spine, dtype=float)
    along = spine[-1, :3] - spine[0, :3]
    along /= np.linalg.norm(along)
    across = np.array([0.0, 1.0, 0.0]) - along[1] * along
    across /= np.linalg.norm(across)
    turn = 2.0 * np.pi * (np.arange(sides) + 0.5) / sides
    offset = spine[:, 3, None, None] * np.outer(np.cos(turn), across)
    return tube(spine[:, None, :3] + offset + spine[:, 4, None, None] * np.outer(np.sin(turn), np.cross(along, across)))


def loft(halves, glass=None) -> Shape:
    """Join cross-sections that are the same on both sides.

    Parameters
    ----------
    halves : array, (s, p, 3)
        Left half of each cross-section [m], from its lower end up to the ridge at y = 0.
    glass : array of bool, (s - 1, p - 1), optional
        Which of the bands from each point to the next are glass, on both sides.
    """
    halves = np.asarray(halves, dtype=float)
    right = halves[:, -2::-1] * [1.0, -1.0, 1.0]
    if glass is not None:
        glass = np.asarray(glass, dtype=bool)
        floor = np.zeros((len(glass), 1), dtype=bool)
        glass = np.concatenate([glass, glass[:, ::-1], floor], axis=1)
    return tube(np.concatenate([halves, right], axis=1), glass)


def both_sides(*parts: Shape) -> tuple[Shape, ...]:
    """Parts of the left side, and the same on the right."""
    return (*parts, *(Shape(part.vertices * [1.0, -1.0, 1.0], part.faces[:, ::-1], part.surface) for part in parts))


def joined(parts) -> Shape:
    """Several meshes as one."""
    before = np.cumsum([0, *(len(part.vertices) for part in parts)])
    return Shape(
        np.concatenate([part.vertices for part in parts]),
        np.concatenate([part.faces + first for part, first in zip(parts, before, strict=False)]),
        np.concatenate([part.surface for part in parts]),
    )


def fitted(mesh: Shape) -> Shape:
    """The mesh scaled into the unit box about the origin, which it fills exactly."""
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    return Shape((mesh.vertices - low) / (high - low) - 0.5, mesh.faces, mesh.surface)
