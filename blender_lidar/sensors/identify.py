"""Sensor identification: which beam table a recorded cloud comes from, by the likelihood of its elevations.

A rotating LiDAR's points lie on cones, one for each ring. A table explains a cloud where the points lie nearer to its
rings than chance puts them into the spaces between: the gain of that likelihood over chance decides, and tables that
explain it nearly as well are told too.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from .model import LidarModel, load_model, model_names

_SPREADS_RAD = np.radians([0.003, 0.006, 0.012, 0.025])  # of points about their rings, of which the likeliest is taken
_STRAY, _EXPECTATIONS = 0.05, 12  # share of the points that lie anywhere, to begin with; rounds to find it
_FARTHEST_RAD = math.radians(0.8)  # from its ring: what lies farther is none of its points
_LEAST_GAIN, _LEAST_ON_RINGS, _LEAST_SEEN = 0.3, 0.92, 0.8  # of a table that explains a cloud
_ALIKE_GAIN = 0.15  # less than the best table's: as possible
_MOST_POINTS = 20_000
_ENOUGH = 30  # points of a ring, beside which a ring without any cannot lie
_BESIDE_RAD = math.radians(0.35)
# Where the table itself does not fit: standard deviation of a unit's elevations, and how far a ring may be off, also as
# a share of the way to the next. Makers' calibrations of units differ from their tables by up to 0.45 degrees.
_LEAST_SEEN_OF_UNIT = 0.88
_UNIT_RAD, _SHIFT_RAD, _SHIFT = math.radians(0.05), math.radians(0.12), 0.35
_LENSES_M, _LENS_SHOWS = np.arange(-0.02, 0.0621, 0.002), 0.5  # the misfit falls to half: else units' rings may err


class Match(NamedTuple):
    """How well one beam table explains a cloud.

    Attributes
    ----------
    model : LidarModel
    gain : float
        Mean log-likelihood of a point over chance within the spaces between rings [nats].
    likelihood : float
        Mean log-likelihood of a point [nats], less the cost of the table's rings (Schwarz's BIC).
    on_rings : float
        Share of the points that are on rings, within the widest spread, and not anywhere, by expectation maximisation.
    seen : float
        Share of the rings between the lowest and the highest point that have points.
    """

    model: LidarModel
    gain: float
    likelihood: float
    on_rings: float
    seen: float

    @property
    def explains(self) -> bool:
        """Whether the cloud can be of this table."""
        return self.gain >= _LEAST_GAIN and self.on_rings >= _LEAST_ON_RINGS and self.seen >= _LEAST_SEEN


class Identified(NamedTuple):
    """What a cloud says of its sensor.

    Attributes
    ----------
    matches : tuple of Match
        The tables that explain it, the best first, and after it those as possible; empty where none does.
    nearest : Match
        The likeliest table, whether or not it explains the cloud.
    """

    matches: tuple[Match, ...]
    nearest: Match


def elevations(points: np.ndarray, lens_m: float = 0.0) -> np.ndarray:
    """Elevation of points (n, 3) of a sensor's frame [m], (n,) [rad].

    `lens_m` is how far the optical centre lies off the axis, towards where each beam looks.
    """
    return np.arctan2(points[:, 2], np.hypot(points[:, 0], points[:, 1]) - lens_m)


def nearest_ring(elevation: np.ndarray, ladder: np.ndarray) -> np.ndarray:
    """Index of the ring of a rising `ladder` (r,) that is nearest to each elevation (n,) [rad]."""
    above = np.clip(np.searchsorted(ladder, elevation), 1, len(ladder) - 1)
    return above - (elevation - ladder[above - 1] < ladder[above] - elevation)


def identify_sensor(
    elevation: np.ndarray, models: Sequence[LidarModel] | None = None, *, units: bool = True
) -> Identified:
    """The beam tables that explain the elevations (n,) [rad] of a cloud in its sensor's frame.

    Where no table fits as it is, `units` whose rings are off it are tried.

    Parameters
    ----------
    elevation : ndarray, (n,)
    models : sequence of LidarModel, optional
        The tables; by default all that ship.
    """
    models = [load_model(name) for name in model_names()] if models is None else models
    models = [model for model in models if model.rings > 1]
    some = np.sort(elevation[np.random.default_rng(0).permutation(len(elevation))[:_MOST_POINTS]])
    for of_unit in (False, True) if units else (False,):
        found = [_match(some, model, of_unit) for model in models]
        found.sort(key=lambda one: -one.likelihood)
        explaining = [one for one in found if one.explains]
        if explaining:
            best = explaining[0]
            alike = [one for one in explaining if one.likelihood >= best.likelihood - _ALIKE_GAIN]
            return Identified(tuple(alike), found[0])
    return Identified((), found[0])


def _match(elevation: np.ndarray, model: LidarModel, of_unit: bool) -> Match:
    """How well a table explains elevations (n,), or a unit of it whose rings lie where most of their points do."""
    ladder, count = model.elevation_rad, len(elevation)
    middle = 0.5 * (ladder[1:] + ladder[:-1])
    low, high = (
        np.concatenate(ends)
        for ends in ((2.0 * ladder[:1] - middle[:1], middle), (middle, 2.0 * ladder[-1:] - middle[-1:]))
    )
    ring = nearest_ring(elevation, ladder)
    off = elevation - ladder[ring]
    reach = np.minimum(np.minimum(ladder - low, high - ladder), _FARTHEST_RAD)
    inside = (elevation >= np.maximum(low[ring], ladder[ring] - _FARTHEST_RAD)) & (
        elevation <= np.minimum(high[ring], ladder[ring] + _FARTHEST_RAD)
    )
    points = np.bincount(ring[inside], minlength=len(ladder))
    shift = _ring_shifts(off, ring, inside, reach) if of_unit else np.zeros(len(ladder))
    off = off - shift[ring]
    gap, weight = (high - low)[ring], np.maximum(points[ring], 0.5) / count
    best = (-math.inf, 0.0)
    for spread in _SPREADS_RAD:
        density = np.where(inside, np.exp(-0.5 * (off / spread) ** 2) / (spread * math.sqrt(2.0 * math.pi)), 0.0)
        on_rings = 1.0 - _STRAY
        for _ in range(_EXPECTATIONS):
            on_rings = float((on_rings * density / (on_rings * density + (1.0 - on_rings) / gap)).mean())
            on_rings = min(on_rings, 1.0 - 0.1 * _STRAY)
        over_chance = np.log(on_rings * density * gap + 1.0 - on_rings)
        of_points = np.where(inside, over_chance + np.log(weight / gap), math.log(0.1 * _STRAY / math.pi))
        best = max(best, (float(of_points.mean()), float(over_chance.mean())))
    likelihood, gain = best
    spanned = (ladder >= elevation[0] - _UNIT_RAD) & (ladder <= elevation[-1] + _UNIT_RAD)
    seen = float((points[spanned] > 0).mean()) if spanned.any() else 0.0
    likelihood -= 0.5 * model.rings * math.log(count) / count
    likelihood -= 0.5 * float(np.mean((shift[ring] / _UNIT_RAD) ** 2))  # of two tables the one that fits with less
    if (of_unit and seen < _LEAST_SEEN_OF_UNIT) or (not of_unit and _has_hole(points, ladder)):
        gain = seen = 0.0
    return Match(model, gain, likelihood, on_rings, seen)


def _ring_shifts(off: np.ndarray, ring: np.ndarray, inside: np.ndarray, reach: np.ndarray) -> np.ndarray:
    """How far each ring of a unit lies from its table, (r,) [rad]: the median of its points, drawn towards 0."""
    shift = np.zeros(len(reach))
    for one in np.unique(ring[inside]):
        mine = off[inside & (ring == one)]
        median = float(np.median(mine))
        error = 1.5 * float(np.median(np.abs(mine - median))) / math.sqrt(len(mine))
        shift[one] = median * _UNIT_RAD**2 / (_UNIT_RAD**2 + error**2)
    most = np.maximum(np.minimum(reach, _SHIFT_RAD), 2.0 * _SHIFT * reach)
    return np.where(np.abs(shift) <= most, shift, 0.0)


def _has_hole(points: np.ndarray, ladder: np.ndarray) -> bool:
    """Whether the ring above the highest or below the lowest that returned lies close by and yet is empty.

    Its neighbour has `_ENOUGH` points, and what is so near sees nearly the same.
    """
    full = np.flatnonzero(points >= _ENOUGH)
    if not len(full):
        return False
    beyond = [(full[-1], full[-1] + 1), (full[0], full[0] - 1)]
    return any(
        0 <= other < len(ladder) and points[other] == 0 and abs(ladder[other] - ladder[one]) <= _BESIDE_RAD
        for one, other in beyond
    )


# --- The optical centre, and the columns of organised clouds ----------------------------------------------------------


def lens_offset(points: np.ndarray, model: LidarModel) -> float:
    """How far the optical centre lies off the axis, towards where the beams look [m]: what puts most points on rings.

    From points (n, 3) of the sensor's frame [m] and its table. Near points tell: at 10 m 3 cm turn a ring by up to 0.1
    degree.
    """
    some = points[np.random.default_rng(0).permutation(len(points))[:_MOST_POINTS]]
    spread = float(_SPREADS_RAD[1])

    def misfit(lens_m):
        elevation = elevations(some, lens_m)
        off = elevation - model.elevation_rad[nearest_ring(elevation, model.elevation_rad)]
        return float(np.minimum((off / spread) ** 2, 9.0).mean())

    found = [misfit(lens_m) for lens_m in _LENSES_M]
    at = int(np.argmin(found))
    return float(_LENSES_M[at]) if found[at] < _LENS_SHOWS * found[int(np.argmin(np.abs(_LENSES_M)))] else 0.0


def offsets_misfit(grid: np.ndarray, model: LidarModel, *, mirrored: bool = False) -> float:
    """How far the columns of an organised cloud are from a table's azimuth offsets, root mean square [rad].

    Parameters
    ----------
    grid : ndarray, (columns, channels, 3)
        In the sensor's frame [m], in which +y is azimuth 0, clockwise; NaN where nothing returned.
    mirrored : bool
        Whether to take the offsets the other way round, as of a cloud with a mirrored axis.

    Returns
    -------
    float
        inf where too few channels returned.
    """
    azimuth = np.arctan2(grid[..., 0], grid[..., 1])
    with np.errstate(invalid="ignore"):
        elevation = np.arctan2(grid[..., 2], np.hypot(grid[..., 0], grid[..., 1]))
    known = np.isfinite(azimuth)
    full = known.sum(axis=0) >= _ENOUGH
    if full.sum() < 4:
        return math.inf
    azimuth, known = azimuth[:, full], known[:, full]
    of_channel = np.array([np.median(one[~np.isnan(one)]) for one in elevation[:, full].T])
    offset = model.azimuth_offset_rad[nearest_ring(of_channel, model.elevation_rad)] * (-1.0 if mirrored else 1.0)
    turned = np.where(known, np.exp(1j * (azimuth - offset)), 0.0)
    column = turned.sum(axis=1, keepdims=True)
    apart = np.angle((turned * np.conj(column)).sum(axis=0))
    return float(np.sqrt(np.mean((apart - np.median(apart)) ** 2)))
