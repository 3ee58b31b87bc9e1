"""How densely and how evenly beams sample the empty road: the two surrogate metrics of Cai and others."""

from __future__ import annotations

import math

import numpy as np

from ..errors import InputError

DISC_RADIUS_M, DISCS, SEED = 0.7, 6000, 1
"""r and D of `nuc` as in the authors' code; theirs has no fixed seed, and draws no return twice."""
_PAIRS_AT_A_TIME = 1 << 16  # whose temporaries stay in cache


def ground_density(points_m: np.ndarray, area_m2: float) -> float:
    """Returns from the ground per area of the field, N / A [points/m²]; higher is better.

    Cai et al., ICRA 2023, arXiv:2211.15975 (PCSim, `ComputeDNUC.py`). It falls with the square of distance, so that the
    metres next to the pole decide it. It knows no vehicles: neither where they drive nor what they hide.

    Parameters
    ----------
    points_m : ndarray, (n, 2)
        Returns in the field [m].
    area_m2 : float
        Its area A [m²].

    Raises
    ------
    InputError
        When the shape is another, a point is not finite or the area is not positive.
    """
    return len(_checked(points_m, area_m2)) / area_m2


def nuc(
    points_m: np.ndarray, area_m2: float, radius_m: float = DISC_RADIUS_M, discs: int = DISCS, seed: int = SEED
) -> float:
    """Non-uniformity of ground returns, the standard deviation of x_i = n_i / (N p) over discs; lower is better.

    n_i of all N returns lie in the i-th of D discs of radius r about returns drawn at random, with replacement; p = pi
    r^2 / A is a disc's share of the field, so that x is about 1 for returns spread evenly. Cai et al., ICRA 2023,
    arXiv:2211.15975 (PCSim, `ComputeDNUC.py`), after PU-Net's normalised uniformity coefficient.

    As published, discs reach over the field's edge, and are drawn where returns are dense, so that sparse zones hardly
    count. A few returns close together, or a single one, make it 0, which no road can better: read it beside
    `ground_density`. Without any return it is taken for its upper bound 1 / (2 p).

    Parameters
    ----------
    points_m : ndarray, (n, 2)
        Returns in the field [m].
    area_m2 : float
        Its area A [m²].
    radius_m : float
        r [m].
    discs : int
        D.
    seed : int
        Of the draws. The same numbers in [0, 1) pick the discs of every cloud.

    Raises
    ------
    InputError
        When the shape is another, a point is not finite or a number is not positive.
    """
    points = _checked(points_m, area_m2)
    if not 0.0 < radius_m < math.inf or discs < 1:
        raise InputError(f"{discs} discs of radius {radius_m} m; allowed: 1 or more, a positive radius")
    share = math.pi * radius_m**2 / area_m2
    if not len(points):
        return 0.5 / share  # x lies between 0 and 1 / p
    drawn = (np.random.default_rng(seed).random(discs) * len(points)).astype(np.int64)
    within = _neighbours(points, points[drawn], radius_m)
    return float(np.std(within)) / (len(points) * share)


def field_area(radius_m: float, y_m: tuple[float, float]) -> float:
    """Area of the part of a strip between two y that lies in a disc about the origin [m²].

    Parameters
    ----------
    radius_m : float
        The disc's radius R [m].
    y_m : tuple of float
        From y to y [m].
    """
    low, high = np.clip(y_m, -radius_m, radius_m)
    # The integral of 2 sqrt(R^2 - y^2).
    below = [y * math.sqrt(radius_m**2 - y**2) + radius_m**2 * math.asin(y / radius_m) for y in (low, high)]
    return max(below[1] - below[0], 0.0)


def _neighbours(points, centres, radius):
    """How many points lie within `radius` of each centre, rim included, (c,).

    Points are sorted into columns as wide as `radius`, and by y within each: a disc's neighbours then lie in one run of
    each of three columns.
    """
    low, reach = points.min(axis=0), radius * (1.0 + 1e-9)  # more than enough for rounding; the distance decides
    x, y = (points - low).T
    height = y.max() + 3.0 * reach  # of a column, so that no run leaves its own
    place = np.floor(x / reach) * height + y
    order = np.argsort(place, kind="stable")
    x, y, place = x[order], y[order], place[order]
    middle_x, middle_y = (centres - low).T
    middle = (np.floor(middle_x / reach)[:, None] + np.array([-1.0, 0.0, 1.0])) * height + middle_y[:, None]
    first = np.searchsorted(place, middle - reach, side="left")
    length = np.searchsorted(place, middle + reach, side="right") - first
    ends = np.cumsum(length.sum(axis=1))
    within = np.zeros(len(centres), dtype=np.int64)
    start = 0
    while start < len(centres):
        before = ends[start - 1] if start else 0
        stop = max(int(np.searchsorted(ends, before + _PAIRS_AT_A_TIME, side="right")), start + 1)
        many = length[start:stop].ravel()
        candidate = np.arange(many.sum()) + np.repeat(first[start:stop].ravel() - (np.cumsum(many) - many), many)
        pairs = length[start:stop].sum(axis=1)
        across = x[candidate] - np.repeat(middle_x[start:stop], pairs)
        along = y[candidate] - np.repeat(middle_y[start:stop], pairs)
        near = np.append(0, np.cumsum(across * across + along * along <= radius * radius))
        last = np.cumsum(pairs)
        within[start:stop] = near[last] - near[last - pairs]
        start = stop
    return within


def _checked(points, area):
    points = np.asarray(points, dtype=float)
    if points.ndim != 2 or points.shape[1] != 2 or not np.isfinite(points).all():
        raise InputError(f"points: shape {points.shape}; allowed: (n, 2), finite")
    if not 0.0 < area < math.inf:
        raise InputError(f"area_m2 is {area}; allowed: a positive number of square metres")
    return points
