"""Casters of rays: one protocol, triangles in, and for each ray the triangle that it meets first and how far away."""

from __future__ import annotations

from abc import ABC, abstractmethod
from functools import cached_property, partial
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ..compiled import numba_works
from ..errors import InputError
from ..world.clutter import Walkers
from ..world.scenery import Scenery, join
from ..world.triangles import MOST_M

if TYPE_CHECKING:
    from .exact import ExactSearch
    from .kernels import BoxTree, RayTree

MISS = -1
_UNIT_TOLERANCE = 1e-6
_LEAST_HEIGHT = 1e-12  # of a triangle, relative to its size and coordinates: what is flatter is rounding, not area
FARTHEST = 1e30  # [m]: finite in float32 too, so that an infinite distance is no hit at any range

take = partial(np.take, mode="clip")  # rows are in range: without that check twice as fast in NumPy 2

_ROUNDING = 16.0 * float(np.finfo(float).eps)

# --- Vectors as structures of arrays, coordinate after coordinate in memory: NumPy is slow over axes of three ---------


def structure_of_arrays(corners: np.ndarray) -> np.ndarray:
    """Corners (m, 3, 3) as (corner, axis, triangle)."""
    return np.ascontiguousarray(corners.reshape(-1, 9).T).reshape(3, 3, -1)


def cross(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Cross products of vectors (3, m)."""
    x, y, z = first
    u, v, w = second
    return np.stack([y * w - z * v, z * u - x * w, x * v - y * u])


def dot(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Sums of three products along the first axis, always added up in the same order."""
    return first[0] * second[0] + first[1] * second[1] + first[2] * second[2]


def length(vectors: np.ndarray) -> np.ndarray:
    """Lengths of vectors (3, ...)."""
    return np.sqrt(dot(vectors, vectors))


# --- Where rays meet the planes of triangles that another has picked, in float64 --------------------------------------


class PlaneHits(NamedTuple):
    """Where rays meet the planes of triangles.

    Attributes
    ----------
    distance : ndarray, (k,)
        Along each ray [m]; below 0 where the plane lies behind, not finite for a ray along the plane.
    facing : ndarray, (k,)
        Cosine between ray and normal: below 0 where the ray comes from outside.
    inside : ndarray of bool, (k,)
        Whether the ray meets the triangle itself; False also where the distance is below 0 or not finite.
    """

    distance: np.ndarray
    facing: np.ndarray
    inside: np.ndarray


class TrianglePlanes:
    """The planes of triangles, and the place within each triangle where a ray meets its plane.

    A point p lies at ``normal . p - offset`` from the plane, and the weights of the triangle's second and third corner
    are affine in p likewise: three affine functions, whose coefficients are kept.

    Parameters
    ----------
    corners : ndarray, (m, 3, 3)
        Corners of each triangle [m]; all have area.
    normal : ndarray, (m, 3)
        Unit normals.
    """

    def __init__(self, corners: np.ndarray, normal: np.ndarray) -> None:
        places, normal = structure_of_arrays(corners), np.ascontiguousarray(normal.T)
        first, second = places[1] - places[0], places[2] - places[0]
        double_area = dot(cross(first, second), normal)
        self._functions = np.empty((13, len(corners)))  # so that what is gathered for many rays lies side by side
        slopes = normal, cross(second, normal) / double_area, cross(normal, first) / double_area
        for function, slope in enumerate(slopes):
            self._functions[4 * function : 4 * function + 3] = slope
            self._functions[4 * function + 3] = dot(slope, places[0])
        coordinate = np.abs(places).reshape(9, -1).max(axis=0)
        side = np.abs(np.concatenate([first, second])).max(axis=0)
        # Slopes are one over the triangle's heights, of which rounding takes that of the coordinates.
        steepest = np.maximum(*(dot(slope, slope) for slope in slopes[1:]))
        self._functions[12] = _ROUNDING * coordinate * side * steepest

    @cached_property
    def rows(self) -> np.ndarray:
        """Slope and offset of each triangle's three functions and the rounding of its weights, (m, 13).

        The last one is what rounding of the corners and of the slopes may add to a weight at the triangle.
        """
        return np.ascontiguousarray(self._functions.T)

    def meet(self, origins: np.ndarray, directions: np.ndarray, triangle: np.ndarray) -> PlaneHits:
        """Where k rays meet the planes of k triangles.

        Parameters
        ----------
        origins : ndarray, (3,) or (3, k)
            Start of all rays, or of each, coordinate by coordinate [m].
        directions : ndarray, (3, k)
            Unit directions, coordinate by coordinate.
        triangle : ndarray of int, (k,)
            Row of the triangle that each ray is asked about.
        """
        if numba_works():
            from .kernels import meet_planes

            shared = origins.ndim == 1
            return PlaneHits(*meet_planes(self.rows, origins.reshape(3, -1), shared, directions, triangle))
        with np.errstate(divide="ignore", invalid="ignore"):
            missing, facing = self._along(0, origins, directions, triangle)
            distance = missing / facing
            weights = []
            for corner in (1, 2):
                missing, gain = self._along(corner, origins, directions, triangle)
                weights.append(gain * distance - missing)
            second, third = weights
            inside = (distance >= 0.0) & (np.minimum(second, third) >= 0.0) & (second + third <= 1.0)
        return PlaneHits(distance, facing, inside)

    def _along(self, function, origins, directions, triangle):
        """An affine function of each triangle: from the origin to its 0, and its growth along the ray."""
        *slopes, offset = self._functions[4 * function : 4 * function + 4]
        shared = origins.ndim == 1
        missing = take(offset - dot(slopes, origins) if shared else offset, triangle)
        slopes = [take(slope, triangle) for slope in slopes]
        return missing if shared else missing - dot(slopes, origins), dot(slopes, directions)


# --- Casters ----------------------------------------------------------------------------------------------------------


class Hits(NamedTuple):
    """First hits of rays.

    Attributes
    ----------
    distance : ndarray, (n,)
        Distance along each ray [m]; inf where it met nothing.
    triangle : ndarray of int64, (n,)
        Row of the triangle that was met; `MISS` (-1) where there is none.
    """

    distance: np.ndarray
    triangle: np.ndarray


class Returns(NamedTuple):
    """First hits, of those rays alone that met something.

    Attributes
    ----------
    ray : ndarray of int64, (k,)
        Their rows, ascending.
    triangle : ndarray of int64, (k,)
        Row of the triangle that each met first.
    distance : ndarray, (k,)
        Distance along each [m].
    """

    ray: np.ndarray
    triangle: np.ndarray
    distance: np.ndarray


class Revolution(NamedTuple):
    """First hits of the beams of one revolution.

    Attributes
    ----------
    beam : ndarray of int64, (k,)
        Those that met something, flat indices into the lattice, ``ring * columns + slot``, rising.
    triangle : ndarray of int64, (k,)
        Row of the triangle that each met first.
    distance : ndarray, (k,)
        Distance along each [m].
    directions : ndarray, (3, k)
        Unit vectors in the road frame.
    """

    beam: np.ndarray
    triangle: np.ndarray
    distance: np.ndarray
    directions: np.ndarray


class Caster(ABC):
    """Casts rays against a fixed set of triangles.

    Parameters
    ----------
    corners : array, (m, 3, 3)
        Corners of each triangle [m], counter-clockwise seen from outside. Triangles without area, as far as float64
        can tell, are never met. Any size and place: the scene is re-centred in float64 before anything becomes float32.
    closed : bool
        Whether the triangles bound solids, so that a ray from outside meets no inside first. It changes no hit, but
        `tree` uses it to find leaks: a ray that meets an inside first has come through one. Faster for rays from
        outside, slow for others.

    Attributes
    ----------
    origin : ndarray, (3,)
        What coordinates are counted from within [m].
    rows : ndarray of int, (m,)
        Row, among the triangles that were given, of each that has area; the others are left out.

    Raises
    ------
    InputError
        For a wrong shape, or a triangle that is not finite or farther away than `MOST_M`, by its row from 0.
    """

    name: str

    def __init__(self, corners: np.ndarray, closed: bool = False) -> None:
        self._closed = closed
        corners = np.asarray(corners, dtype=float)
        if corners.ndim != 3 or corners.shape[1:] != (3, 3):
            raise InputError(f"triangles have shape {corners.shape}; allowed: (m, 3, 3)")
        places = structure_of_arrays(corners)
        coordinate = np.abs(places).reshape(9, -1).max(axis=0, initial=0.0)  # largest of each triangle
        if not (coordinate <= MOST_M).all():  # also catches NaN
            row = int(np.argmin(coordinate <= MOST_M))
            raise InputError(f"triangle {row} {_unusable(corners[row])}")
        # About the middle one of the corners, so that a vehicle at a place that is a mistake moves no other.
        self.origin = np.median(places.transpose(1, 0, 2).reshape(3, -1), axis=1) if len(corners) else np.zeros(3)
        places = places - self.origin[:, None]
        normal = cross(places[1] - places[0], places[2] - places[0])
        area = length(normal)  # twice: base times height
        base = length((places - np.roll(places, 1, axis=0)).transpose(1, 0, 2)).max(axis=0, initial=0.0)
        self._given = len(corners)
        self.rows = np.flatnonzero(area > _LEAST_HEIGHT * base * (base + coordinate))
        self._normal = np.ascontiguousarray((normal[:, self.rows] / area[self.rows]).T)
        self._corners = (corners - self.origin)[self.rows]
        self._planes = TrianglePlanes(self._corners, self._normal)
        if len(self.rows):
            self._prepare()

    def _prepare(self) -> None:  # noqa: B027 (not all have anything to do)
        """Make ready to cast against `_corners` (m, 3, 3): re-centred, all with area, at least one."""

    def make_ready(self, low: np.ndarray, high: np.ndarray) -> None:  # noqa: B027 (not all have anything to do)
        """Make ready for rays that start between two corners, (3,) [m]: while they do, nothing is made again."""

    def solid(self, triangle: np.ndarray) -> np.ndarray:
        """Row of each triangle that was met where an `InstancedTree` has fewer: here its own."""
        return triangle

    face = solid

    @abstractmethod
    def _meet(self, origins: np.ndarray, directions: np.ndarray, max_range: float) -> Returns:
        """As `meet`, with at least one ray, and origins and rows in terms of `_corners`."""

    @cached_property
    def _exact(self) -> ExactSearch:
        """Who decides in float64 what rounding would, every ray against every triangle."""
        from .exact import ExactSearch

        return ExactSearch(self._corners, self._planes)

    @cached_property
    def ray_tree(self) -> RayTree:
        """Compiled bounding volume hierarchy in float64 of the triangles with area, at least one."""
        from .kernels import RayTree

        return RayTree(self._corners, self._planes.rows, self._exact)

    @property
    def _sure(self):
        """What meets rays in float64: the compiled tree, or without Numba the search."""
        return self.ray_tree if numba_works() else self._exact

    @property
    def planes(self) -> np.ndarray:
        """`TrianglePlanes.rows`, (m, 13): counted from `origin`, in the order of `rows`."""
        return self._planes.rows

    def cast(self, origins: np.ndarray, directions: np.ndarray, max_range: float = np.inf) -> Hits:
        """What each ray meets first, no farther than `max_range`.

        Parameters
        ----------
        origins : ndarray, (3,) or (n, 3)
            Start of all rays, or of each [m].
        directions : ndarray, (n, 3)
            Unit directions, to one in a million.
        max_range : float
            Farthest distance that counts [m], itself included.

        Raises
        ------
        InputError
            For wrong shapes, a direction that is not finite and of unit length, or an origin that is not finite, by the
            number of its row from 0.
        """
        origins, directions = _checked(origins, directions, max_range)
        found = self.meet(origins, directions, max_range)
        distance, triangle = np.full(len(directions), np.inf), np.full(len(directions), MISS, dtype=np.int64)
        distance[found.ray], triangle[found.ray] = found.distance, found.triangle
        return Hits(distance, triangle)

    def meet(self, origins: np.ndarray, directions: np.ndarray, max_range: float = np.inf) -> Returns:
        """As `cast`, but only the rays that meet something, and unchecked: for rays that are known to be good.

        Fastest for arrays that hold coordinate after coordinate in memory, as `Pose.to_world` returns them.
        """
        if len(self.rows) == 0 or len(directions) == 0:
            return Returns(np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int64), np.empty(0))
        max_range = min(max_range, FARTHEST)
        found = self._meet(origins - self.origin, directions, max_range)
        if len(self.rows) == self._given:
            return found
        return found._replace(triangle=self.rows[found.triangle])

    def normals(self, triangle: np.ndarray) -> np.ndarray:
        """Outward unit normals (n, 3) of triangles that were met, by their row in the constructor's `corners`."""
        return self._normal[np.searchsorted(self.rows, triangle)]


def origins_of(origins: np.ndarray, rays: np.ndarray) -> np.ndarray:
    """The origins of some rays; a shared one stays shared."""
    return origins if origins.ndim == 1 else np.take(origins, rays, axis=0)


def decide_doubtful(search, origins, directions, max_range, doubtful, triangle, distance) -> None:
    """Let a search in float64 say, in place, what the doubtful of some rays meet; inf where nothing."""
    if len(doubtful):
        found = search.meet(origins_of(origins, doubtful), directions[doubtful], max_range)
        distance[doubtful] = np.inf
        distance[doubtful[found.ray]], triangle[doubtful[found.ray]] = found.distance, found.triangle


def _checked(origins, directions, max_range):
    origins, directions = np.asarray(origins, dtype=float), np.asarray(directions, dtype=float)
    if directions.ndim != 2 or directions.shape[1] != 3:
        raise InputError(f"directions have shape {directions.shape}; allowed: (n, 3)")
    if origins.shape not in ((3,), directions.shape):
        raise InputError(f"origins have shape {origins.shape}; allowed: (3,) or {directions.shape}")
    length = np.einsum("ij,ij->i", directions, directions)
    for row in np.flatnonzero(~(np.abs(length - 1.0) <= _UNIT_TOLERANCE))[:1]:  # NaN too, which casters would miss
        raise InputError(f"direction {row} is {directions[row].tolist()}; allowed: finite and of unit length")
    for row in np.flatnonzero(~(np.abs(np.atleast_2d(origins)) <= MOST_M).all(axis=1))[:1]:
        which = "the origin" if origins.ndim == 1 else f"origin {row}"
        raise InputError(f"{which} {_unusable(np.atleast_2d(origins)[row])}")
    if not max_range >= 0.0:
        raise InputError(f"max_range is {max_range}; allowed: a distance of 0 m or more")
    return origins, directions / np.sqrt(length)[:, None]  # as float32 rounded them, say


def _unusable(numbers):
    """What is wrong with coordinates that are not all finite and near enough, in words."""
    farthest = np.abs(numbers).max()
    if not np.isfinite(farthest):
        return "is not finite"
    return f"lies {farthest:g} m from the origin of coordinates; allowed: up to {MOST_M:g} m"


# --- Scenery that hides vehicles --------------------------------------------------------------------------------------


class StandingScenery:
    """Occluders that stand still, ready to be cast against; their tree is made at the first cast and not pickled.

    Parameters
    ----------
    scenery : Scenery
        Its triangles.
    caster : str
        A name of `casting.CASTERS`.
    walkers : Walkers, optional
        Who moves along the roadsides: `at` says where they are.
    still : StandingScenery, optional
        What stands there at all times, whose tree all moments share.
    """

    def __init__(
        self, scenery: Scenery, caster: str, walkers: Walkers | None = None, still: StandingScenery | None = None
    ) -> None:
        self._own, self._caster, self._walkers, self._still = scenery, caster, walkers, still

    def __getstate__(self) -> dict:
        return {"_own": self._own, "_caster": self._caster, "_walkers": self._walkers, "_still": self._still}

    @property
    def scenery(self) -> Scenery:
        """The triangles of what stands at all times, which all moments share."""
        return self._own if self._still is None else self._still.scenery

    @property
    def with_walkers(self) -> Scenery:
        """All triangles of the moment."""
        return self._own if self._still is None else join([self._still.scenery, self._own])

    def at(self, time_s: float) -> StandingScenery:
        """The scenery of a moment [s]: with those who walk, where they are then."""
        if self._walkers is None:
            return self
        return StandingScenery(self._walkers.at(time_s), self._caster, still=self)

    def beside(self, more: Scenery) -> StandingScenery:
        """The same with something else that stands there."""
        return StandingScenery(join([self._own, more]), self._caster, self._walkers, self._still)

    @property
    def parts(self) -> tuple[StandingScenery, ...]:
        """What has a tree of its own: those who walk, and what stands at all times."""
        return (self,) if self._still is None else (*self._still.parts, self)

    @cached_property
    def tree(self) -> Caster:
        """A caster of its own triangles; meshes of others may be open."""
        from . import caster_class

        return caster_class(self._caster)(self._own.corners, closed=False)

    @property
    def occluders(self) -> list[tuple[np.ndarray, BoxTree]]:
        """What compiled code needs to test for occlusion: of each tree the origin of coordinates (3,) [m], and it."""
        return [(part.tree.origin, part.tree.ray_tree.boxes) for part in self.parts if len(part.tree.rows)]

    def met(self, origin: np.ndarray, directions: np.ndarray, reach_m: float) -> tuple[np.ndarray, ...]:
        """First hits of rays from an `origin` (3,) [m] along unit `directions` (n, 3) within `reach_m` [m].

        Returns
        -------
        ray : ndarray of int64, (k,)
            Rows of those that met something, rising.
        distance : ndarray, (k,)
            How far along each [m].
        surface : ndarray of uint16, (k,)
            What it is made of, an index into `world.meshes.REFLECTIVITY`.
        cosine : ndarray, (k,)
            Of the incidence on it.
        label : ndarray of int32, (k,)
            Number of its label, -1 where it has none.
        """
        parts = [part._met(origin, directions, reach_m) for part in self.parts]
        if len(parts) == 1:
            return parts[0]
        ray, distance, *rest = map(np.concatenate, zip(*parts, strict=True))
        order = np.lexsort((distance, ray))
        first = order[np.diff(ray[order], prepend=-1) > 0]
        return tuple(column[first] for column in (ray, distance, *rest))

    def _met(self, origin: np.ndarray, directions: np.ndarray, reach_m: float) -> tuple[np.ndarray, ...]:
        """`met` of its own triangles alone."""
        found = self.tree.meet(origin, directions, reach_m)
        cosine = np.abs(dot(self.tree.normals(found.triangle).T, directions[found.ray].T))
        surface, label = (of[found.triangle] for of in (self._own.surface, self._own.label))
        return found.ray, found.distance, surface, cosine, label

    def hides(self, origins: np.ndarray, directions: np.ndarray, distance: np.ndarray) -> np.ndarray:
        """Occlusion test: whether something stands nearer than a distance along rays, (n,) bool.

        Parameters
        ----------
        origins : ndarray, (3,) or (n, 3)
            Start of all rays, or of each [m].
        directions : ndarray, (n, 3)
            Unit directions.
        distance : ndarray, (n,)
            How far along each [m].
        """
        hidden = np.zeros(len(distance), dtype=bool)
        for part in self.parts if len(distance) else ():
            found = part.tree.meet(origins, directions, float(distance.max()))
            hidden[found.ray] |= found.distance < distance[found.ray]
        return hidden
