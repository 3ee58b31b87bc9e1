"""The protocol of all casters: triangles in, and for each ray the triangle that it meets first and how far away."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import NamedTuple

import numpy as np

from ..errors import InputError
from ..world.triangles import MOST_M
from .by_coordinate import by_coordinate, cross, length

MISS = -1
_UNIT_TOLERANCE = 1e-6
_LEAST_HEIGHT = 1e-12  # of a triangle, relative to its size and coordinates: what is flatter is rounding, not area
FARTHEST = 1e30  # [m]: finite in float32 too, so that an infinite distance is no hit whatever the range


class Hits(NamedTuple):
    """What rays met first.

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
    """The rays that met something.

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


class Caster(ABC):
    """Casts rays against a fixed set of triangles.

    Parameters
    ----------
    corners : array, (m, 3, 3)
        Corners of each triangle [m], counter-clockwise seen from outside. Triangles without area, as far as float64
        can tell, are never met. Any size and place: the scene is re-centred in float64 before anything becomes float32.
    closed : bool
        Whether the triangles bound solids, so that a ray from outside meets no inside first. It changes no result, but
        for what `tree` says of it: leaks are told by the insides that they lead to. Faster for rays from outside, slow
        for others.

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
        places = by_coordinate(corners)
        coordinate = np.abs(places).reshape(9, -1).max(axis=0, initial=0.0)  # largest of each triangle
        if not (coordinate <= MOST_M).all():  # also catches NaN
            row = int(np.argmin(coordinate <= MOST_M))
            raise InputError(f"triangle {row} {_unusable(corners[row])}")
        # About the middle one of the corners, so that a vehicle at a place that is a mistake moves no other.
        self._origin = np.median(places.transpose(1, 0, 2).reshape(3, -1), axis=1) if len(corners) else np.zeros(3)
        places = places - self._origin[:, None]
        normal = cross(places[1] - places[0], places[2] - places[0])
        area = length(normal)  # twice: base times height
        base = length((places - np.roll(places, 1, axis=0)).transpose(1, 0, 2)).max(axis=0, initial=0.0)
        self._given = len(corners)
        self._solid = np.flatnonzero(area > _LEAST_HEIGHT * base * (base + coordinate))
        self._normal = np.ascontiguousarray((normal[:, self._solid] / area[self._solid]).T)
        self._corners = (corners - self._origin)[self._solid]
        if len(self._solid):
            self._prepare()

    @abstractmethod
    def _prepare(self) -> None:
        """Make ready to cast against `_corners` (m, 3, 3): re-centred, all with area, at least one."""

    @abstractmethod
    def _meet(self, origins: np.ndarray, directions: np.ndarray, max_range: float) -> Returns:
        """As `meet`, with at least one ray, and origins and rows in terms of `_corners`."""

    @property
    def origin(self) -> np.ndarray:
        """What compiled code counts coordinates from, (3,) [m]."""
        return self._origin

    @property
    def rows(self) -> np.ndarray:
        """Row, among the triangles that were given, of each that compiled code knows, (m,): those with area."""
        return self._solid

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
        if len(self._solid) == 0 or len(directions) == 0:
            return Returns(np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int64), np.empty(0))
        max_range = min(max_range, FARTHEST)
        found = self._meet(origins - self._origin, directions, max_range)
        if len(self._solid) == self._given:
            return found
        return found._replace(triangle=self._solid[found.triangle])

    def normals(self, triangle: np.ndarray) -> np.ndarray:
        """Outward unit normals (n, 3) of triangles that were met, by their row in the constructor's `corners`."""
        return self._normal[np.searchsorted(self._solid, triangle)]


def origins_of(origins: np.ndarray, rays: np.ndarray) -> np.ndarray:
    """The origins of some rays; a shared one stays shared."""
    return origins if origins.ndim == 1 else np.take(origins, rays, axis=0)


def _checked(origins, directions, max_range):
    origins, directions = np.asarray(origins, dtype=float), np.asarray(directions, dtype=float)
    if directions.ndim != 2 or directions.shape[1] != 3:
        raise InputError(f"directions have shape {directions.shape}; allowed: (n, 3)")
    if origins.shape not in ((3,), directions.shape):
        raise InputError(f"origins have shape {origins.shape}; allowed: (3,) or {directions.shape}")
    length = np.einsum("ij,ij->i", directions, directions)
    good = np.abs(length - 1.0) <= _UNIT_TOLERANCE
    if not good.all():  # also catches NaN, which casters would miss silently
        row = int(np.argmin(good))
        raise InputError(f"direction {row} is {directions[row].tolist()}; allowed: finite and of unit length")
    good = (np.abs(origins) <= MOST_M).all(axis=-1)
    if not good.all():
        row = int(np.argmin(good))
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
