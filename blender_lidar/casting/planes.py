"""Where rays meet triangles that another has picked, in float64."""

from __future__ import annotations

from functools import cache, partial
from typing import NamedTuple

import numpy as np

from ..numba_here import numba_works
from .by_coordinate import by_coordinate, cross, dot

_take = partial(np.take, mode="clip")  # rows are in range: without that check twice as fast in NumPy 2

_ROUNDING = 16.0 * float(np.finfo(float).eps)


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
        places, normal = by_coordinate(corners), np.ascontiguousarray(normal.T)
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

    def as_rows(self) -> np.ndarray:
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
        distance, facing = self._along(0, origins, directions, triangle)
        with np.errstate(divide="ignore", invalid="ignore"):
            distance /= facing
            inside = distance >= 0.0
            second, gain = self._along(1, origins, directions, triangle)
            gain *= distance
            np.subtract(gain, second, out=second)
            third, gain = self._along(2, origins, directions, triangle)
            gain *= distance
            np.subtract(gain, third, out=third)
            inside &= np.minimum(second, third) >= 0.0
            second += third
            inside &= second <= 1.0
        return PlaneHits(distance, facing, inside)

    def _along(self, function, origins, directions, triangle):
        """An affine function of each triangle: what the origin lacks to its 0, and its growth along the ray."""
        *slopes, offset = self._functions[4 * function : 4 * function + 4]
        shared = origins.ndim == 1
        missing = _take(offset - dot(slopes, origins) if shared else offset, triangle)
        slopes = [_take(slope, triangle) for slope in slopes]
        if not shared:
            missing -= dot(slopes, origins)
        growth = dot(slopes, directions)
        return missing, growth


@cache
def fastest_planes() -> type[TrianglePlanes]:
    """The compiled twin where Numba is installed."""
    if not numba_works():
        return TrianglePlanes
    from .compiled_planes import CompiledPlanes

    return CompiledPlanes
