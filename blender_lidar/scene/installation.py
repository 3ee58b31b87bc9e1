"""Installation errors: where LiDARs hang that an installer has hung nearly as planned.

Errors are arrays (..., l, 4): of each LiDAR its height [m], tilt across, tilt along and yaw [rad] more than planned.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from functools import lru_cache

import numpy as np

from ..optimise.search import latin_hypercube
from .deployment import COORDINATE_LIMITS, Installer
from .mounting import ANGLES, Layout, Mounting

ERRORS = ("height_m", *ANGLES)
"""The coordinates that errors are of."""
_TILTS = tuple(map(math.radians, COORDINATE_LIMITS[ANGLES[0]]))
_LIMITS = COORDINATE_LIMITS["height_m"], _TILTS, _TILTS, (-math.inf, math.inf)  # yaw is a circle
_TRIES, _ORDERS = 50, 200  # Latin hypercubes, and orders, of which the one is taken whose coordinates correlate least


def installed(plan: Mounting, error: np.ndarray) -> Mounting:
    """Where a LiDAR planned at `plan` hangs under an error (4,).

    That may be beyond the bounds of a search, as an installer does not know them, but not beyond what a coordinate can
    be at all. Without an error it is the plan, to the last bit.
    """
    if not error.any():
        return plan
    planned = plan.height_m, plan.tilt_x, plan.tilt_y, plan.yaw
    hung = (one + off for one, off in zip(planned, error.tolist(), strict=True))
    return Mounting(plan.mast, *(min(max(one, low), high) for one, (low, high) in zip(hung, _LIMITS, strict=True)))


def installed_layout(plan: Layout, errors: np.ndarray) -> Layout:
    """The same of a layout, whose LiDARs are off each by itself: `errors` (l, 4)."""
    return tuple(None if one is None else installed(one, error) for one, error in zip(plan, errors, strict=True))


def orthogonal_errors(installers: Sequence[Installer], base: int) -> np.ndarray:
    """Errors that stand for all, by an orthogonal array of strength 2, (base^2, l, 4), with equal weights.

    Each coordinate takes base^2 evenly spaced values, once each; each pair of a LiDAR's coordinates falls once into
    each of base x base squares (Owen 1992, Tang 1993). With an error the opposite one is there, so that what falls on
    one side of a plan as it rises on the other cancels, and no two coordinates of a LiDAR correlate. `base` is an odd
    prime. Further LiDARs have the same errors in another order, of some the one that correlates least: at 25 errors no
    two coordinates of two or three LiDARs by more than 0.45.
    """
    return _orthogonal_shares(len(installers), base) * _half_widths(installers)


@lru_cache(maxsize=16)
def _orthogonal_shares(lidars: int, base: int) -> np.ndarray:
    """Shares of the half-widths, -1 to 1, of so many LiDARs, (base^2, l, 4)."""
    half = base // 2
    first, second = (digit.ravel() - half for digit in np.meshgrid(*2 * [np.arange(base)], indexing="ij"))
    coarse = [(digit + half) % base - half for digit in (first, second, first + second, first + 2 * second)]
    fine = [coarse[1], -coarse[0], coarse[3], -coarse[2]]  # the sign is what keeps the pairs from correlating
    shares = np.stack([2.0 * (base * square + place) / base**2 for square, place in zip(coarse, fine, strict=True)], 1)
    found = shares
    for number in range(1, lidars):
        orders = _orders_of_pairs(base**2, np.random.default_rng(number))
        found = min((np.hstack([found, shares[order]]) for order in orders), key=_largest_correlation)
    return found.reshape(base**2, lidars, len(ERRORS))


def _orders_of_pairs(points: int, rng: np.random.Generator) -> Iterator[np.ndarray]:
    """Random orders of an odd number of points in which opposites, first and last, second and last but one, stay so."""
    half = points // 2
    for _ in range(_ORDERS):
        row = rng.permutation(half)
        row = np.where(rng.random(half) < 0.5, row, points - 1 - row)
        yield np.concatenate([row, [half], points - 1 - row[::-1]])


def latin_errors(installers: Sequence[Installer], frames: int, each: int, seed: Sequence[int]) -> np.ndarray:
    """Errors for each of some frames, by a Latin hypercube over all of them, (frames, each, l, 4).

    Every coordinate has one value in each of ``frames * each`` equal slices. Of some hypercubes it is the one with the
    smallest correlation between two coordinates. Which frame has which error is drawn, so that errors do not go with
    blocks of time.
    """
    points, columns = frames * each, len(installers) * len(ERRORS)
    rng, ends = np.random.default_rng(seed), np.ones(columns)
    tried = [latin_hypercube(rng, points, -ends, ends) for _ in range(_TRIES if points > 2 else 1)]
    shares = min(tried, key=_largest_correlation)
    return shares.reshape(frames, each, len(installers), len(ERRORS)) * _half_widths(installers)


def _largest_correlation(points: np.ndarray) -> float:
    if len(points) < 3:
        return 0.0
    return float(np.abs(np.corrcoef(points.T) - np.eye(points.shape[1])).max())


def _half_widths(installers: Sequence[Installer]) -> np.ndarray:
    """Of each LiDAR, (l, 4)."""
    return np.array([one.half_widths for one in installers])


def single_errors(
    installers: Sequence[Installer], degrees: float, height_m: float
) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Errors of one tilt, and errors of the height, of one LiDAR alone, to both sides, (l, 4) each.

    LiDARs that hang already have none.
    """
    sizes = [(1, math.radians(degrees)), (2, math.radians(degrees))], [(0, height_m)]
    free = [lidar for lidar, installer in enumerate(installers) if not installer.is_exact]
    return tuple(
        [
            _alone(len(installers), lidar, coordinate, sign * size)
            for lidar in free
            for coordinate, size in of_kind
            for sign in (-1.0, 1.0)
        ]
        for of_kind in sizes
    )


def limit_errors(installers: Sequence[Installer]) -> list[tuple[int, str, list[np.ndarray]]]:
    """Of each LiDAR and coordinate that has errors, by number and name, minus and plus its half-width alone, (l, 4)."""
    return [
        (lidar, key, [_alone(len(installers), lidar, column, sign * width) for sign in (-1.0, 1.0)])
        for lidar, installer in enumerate(installers)
        for column, (key, width) in enumerate(zip(ERRORS, installer.half_widths, strict=True))
        if width > 0.0
    ]


def _alone(lidars: int, lidar: int, coordinate: int, error: float) -> np.ndarray:
    errors = np.zeros((lidars, len(ERRORS)))
    errors[lidar, coordinate] = error
    return errors
