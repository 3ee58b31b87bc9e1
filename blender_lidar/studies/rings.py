"""Rings and rays of a recorded revolution of a LiDAR: ring of each point, elevations, rays without a return.

Where the sensor is known, each point belongs to the nearest ring of its beam table. Else the rings are recovered from
the order of the points, laser offsets included.

Files of rotating LiDARs such as KITTI's keep ring after ring, in each of which the azimuth turns once; a new ring
starts where it wraps. Lasers do not fire from one point: in KITTI's HDL-64E the rays of the upper block cross the axis
0.20 m above the origin of the coordinates, those of the lower one 0.12 m, and where a sweep tells it, in a third of the
rings, they pass it by about 0.02 m to the left or to the right. Seen from the origin a ring's elevation therefore
depends on the range, by a degree between 10 m and far away, which is two to three rings; and azimuths shift by nearly a
step at 10 m. Seen from the laser neither does. So each ring is the cone ``z = height + tan(elevation) * rho``, which
its points miss by 0.3 mm (median over KITTI's sweeps), with the same heights and elevations in all sweeps to 1 mm and
0.001 degrees.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from ..errors import InputError
from ..metrics.vgop import to_vehicle_frame
from ..sensors.beams import BeamLattice
from ..sensors.pose import Pose

FEWEST_RINGS, MOST_RINGS = 4, 256
_FEWEST_RETURNS = 8  # of half of the rings; high ones may see next to nothing
_LEAST_ORDERED = 0.9  # share of neighbouring rings of which the one is above the other as all others are
_NEW_RING_RAD = 0.1  # falls the azimuth so far, a ring begins; edges of near things and jitter take it back by less
_BACKWARDS_RAD, _MOST_BACKWARDS = 1e-4, 0.01  # share of steps between neighbours that may go against the turn
_OFF_CONE_M, _MOST_OFF_CONE = 0.05, 0.1  # a return is off its ring's cone from here on; share of them that may be
_MOST_HEIGHT_M = 0.6  # of a laser; a plane, such as the road through parts of two rings, is a cone of greater height
_FITS = 25
_FINE_M = 5e-4  # distances below do not count as less
_HEIGHT_PRIOR_M = 0.2  # a ring that sees one range alone says nothing of its height: it is near 0
_LATERAL_M = np.linspace(-0.06, 0.06, 61)  # candidates
_LEVEL = 0.002  # [1/m]: neighbours whose inverse ranges differ by less have no parallax
_CLEARLY_BETTER = 0.7  # of the misfit of a laser on the axis
_TURN = 2.0 * math.pi
NO_POINT = -1


@dataclass(frozen=True, slots=True, eq=False)
class Rings:
    """The rings of one revolution; ring 0 is the lowest.

    Attributes
    ----------
    ring : ndarray of int64, (n,)
        Ring of each point.
    elevation_rad : ndarray, (r,)
        Angle of each ring above the horizontal, seen from its own laser [rad]; rising, but for rings of few returns.
    height_m : ndarray, (r,)
        Where the ring's rays cross the sensor's axis, above the origin [m].
    lateral_m : ndarray, (r,)
        How far its rays pass the axis by, to the left of their direction [m].
    step_rad : float
        Mean azimuth from one firing to the next [rad].
    spread_m : float
        Median distance of the points from their rings' cones, upwards [m].
    """

    ring: np.ndarray
    elevation_rad: np.ndarray
    height_m: np.ndarray
    lateral_m: np.ndarray
    step_rad: float
    spread_m: float

    def __len__(self) -> int:
        return len(self.elevation_rad)


def table_rings(points: np.ndarray, lattice: BeamLattice) -> tuple[Rings, float]:
    """The rings of a known sensor, and how well its beam table fits a cloud.

    Parameters
    ----------
    points : ndarray, (n, 3)
        Returns in the sensor's frame, in any order [m].
    lattice : BeamLattice

    Returns
    -------
    rings : Rings
        Every ring of the table; each point belongs to the one with the nearest elevation.
    share : float
        Of the points, how many are within a quarter of the spacing of rings from a ring: about a half where the table
        has nothing to do with the cloud, nearly all where sensor, pose and table are right.
    """
    elevation, rho = lattice.elevation_rad, np.hypot(points[:, 0], points[:, 1])
    seen = np.arctan2(points[:, 2], rho)
    above = np.clip(np.searchsorted(elevation, seen), 1, len(elevation) - 1)
    gap = elevation[above] - elevation[above - 1]
    from_below = (seen - elevation[above - 1]) / gap
    ring = above - (from_below < 0.5)
    share = float((np.abs(seen - elevation[ring]) <= 0.25 * gap).mean()) if len(points) else 0.0
    off = np.abs(points[:, 2] - rho * np.tan(elevation[ring]))
    none = np.zeros(len(elevation))
    spread_m = float(np.median(off)) if len(points) else math.nan
    return Rings(ring, elevation, none, none, lattice.step_rad, spread_m), share


def recover_rings(points: np.ndarray, where: str = "the sweep") -> Rings:
    """The rings of a sweep whose points are in ring order, of a sensor that need not be known.

    Parameters
    ----------
    points : ndarray, (n, 3)
        Returns in the sensor's levelled frame, in the order of the file [m].
    where : str
        What to call the sweep in a message.

    Raises
    ------
    InputError
        Where the points are not ring after ring, each with the azimuth turning once, from one end of the field of view
        to the other: such as PCD files that were filtered, merged or written column by column.
    """
    points = np.asarray(points, dtype=float)
    rho, z = np.hypot(points[:, 0], points[:, 1]), points[:, 2]
    azimuth = np.arctan2(points[:, 1], points[:, 0])
    for starts in _ring_starts(azimuth):
        ends = np.append(starts, len(points))
        ring = np.repeat(np.arange(len(starts)), np.diff(ends))
        cones = np.array([_cone(rho[a:b], z[a:b]) for a, b in pairwise(ends)])
        off = np.abs(z - cones[ring, 0] - cones[ring, 1] * rho)
        rising = np.diff(cones[:, 1])
        ordered = max((rising > 0).mean(), (rising < 0).mean()) >= _LEAST_ORDERED
        if ordered and (off > _OFF_CONE_M).mean() <= _MOST_OFF_CONE and np.abs(cones[:, 0]).max() <= _MOST_HEIGHT_M:
            break
    else:
        raise InputError(
            f"{where}: its {len(points)} points are not in ring order; allowed: ring after ring from the top or from "
            "the bottom, each one turn that starts ahead (+x) or behind (-x), as in KITTI's .bin files; points in "
            "another order need --sensor NAME"
        )
    level = (np.diff(ring) == 0) & (np.abs(np.diff(1.0 / np.maximum(rho, 1e-9))) < _LEVEL)
    steps = np.abs(_wrapped(np.diff(azimuth)))[level]
    usual = np.median(steps)  # encoders round steps, so that the median alone is off
    step = float(steps[(steps > 0.25 * usual) & (steps < 1.25 * usual)].mean())
    lateral = np.array([_lateral(azimuth[a:b], rho[a:b], step) for a, b in pairwise(ends)])
    if (rising < 0).mean() > 0.5:
        ring, cones, lateral = len(cones) - 1 - ring, cones[::-1], lateral[::-1]
    return Rings(ring, np.arctan(cones[:, 1]), cones[:, 0].copy(), lateral.copy(), step, float(np.median(off)))


def _ring_starts(azimuth: np.ndarray) -> Iterator[np.ndarray]:
    """First points of the rings, for every way and place that turns may start from and that fits."""
    for seam in (0.0, math.pi):  # ahead or behind
        for way in (1.0, -1.0):
            step = np.diff(np.mod(way * (azimuth - seam), _TURN))
            wraps = step < -_NEW_RING_RAD
            backwards = (step < -_BACKWARDS_RAD) & ~wraps
            starts = np.concatenate([[0], np.flatnonzero(wraps) + 1])
            usual = np.median(np.diff(np.append(starts, len(azimuth))))
            ordered = usual >= _FEWEST_RETURNS and backwards.mean() <= _MOST_BACKWARDS
            if ordered and FEWEST_RINGS <= len(starts) <= MOST_RINGS:
                yield starts


def _cone(rho: np.ndarray, z: np.ndarray) -> tuple[float, float]:
    """Height and tangent of the elevation of the cone about the vertical axis that most points lie on."""
    design = np.column_stack([np.ones_like(rho), rho])
    height, slope = 0.0, np.median(z / np.maximum(rho, 1e-9))
    for _ in range(_FITS):  # least absolute distances, by weights
        weight = 1.0 / np.maximum(np.abs(z - height - slope * rho), _FINE_M)
        normal = (weight[:, None] * design).T @ design
        normal[0, 0] += 1.0 / _HEIGHT_PRIOR_M
        height, slope = np.linalg.solve(normal, design.T @ (weight * z))
    return float(height), float(slope)


def _lateral(azimuth: np.ndarray, rho: np.ndarray, step: float) -> float:
    """How far a ring's rays pass the axis by [m]: what puts its returns on one grid of azimuths at any range."""
    between, nearer = np.abs(_wrapped(np.diff(azimuth))), np.diff(1.0 / np.maximum(rho, 1.0))
    way = np.sign(np.median(_wrapped(np.diff(azimuth))))
    telling = (np.abs(nearer) > 0.004) & (between < 10.0 * step)
    if telling.sum() < 12:
        return 0.0
    grid = 0.5 * step  # encoders of half a step are common
    phase = (between[telling] - way * _LATERAL_M[:, None] * nearer[telling]) / grid
    weight = np.minimum(np.abs(nearer[telling]), 0.05)
    misfit = np.abs(phase - np.round(phase)) @ weight / weight.sum()
    best = int(np.argmin(misfit))
    return float(_LATERAL_M[best]) if misfit[best] < _CLEARLY_BETTER * misfit[len(_LATERAL_M) // 2] else 0.0


def _wrapped(angle: np.ndarray) -> np.ndarray:
    return np.mod(angle + math.pi, _TURN) - math.pi


# --- Rays -------------------------------------------------------------------------------------------------------------


class Rays(NamedTuple):
    """Rays of one revolution.

    Attributes
    ----------
    origin, direction : ndarray, (k, 3)
        Where each starts [m, frame of the cloud], and its unit vector; through the point where it returned.
    point : ndarray of int64, (k,)
        Row of the cloud's point that it returned as; `NO_POINT` where it did not return.
    range_m : ndarray, (k,)
        How far away that point is along the ray [m]; inf where there is none.
    """

    origin: np.ndarray
    direction: np.ndarray
    point: np.ndarray
    range_m: np.ndarray


class Firings:
    """What a sensor fired during one revolution: what returned, and the firings between that did not.

    Parameters
    ----------
    points : ndarray, (n, 3)
        The returns [m, frame of the cloud].
    rings : Rings
        Their rings, of the points in the sensor's frame, ``pose.to_sensor(points)``.
    pose : Pose
        Of the sensor in the frame of the cloud.
    """

    def __init__(self, points: np.ndarray, rings: Rings, pose: Pose) -> None:
        self._points, self._rings, self._pose = points, rings, pose
        local = pose.to_sensor(points)
        rho = np.hypot(local[:, 0], local[:, 1])
        parallax = np.arcsin(np.clip(rings.lateral_m[rings.ring] / np.maximum(rho, 1e-9), -1.0, 1.0))
        azimuth = np.mod(np.arctan2(local[:, 1], local[:, 0]) - parallax, _TURN)
        order = np.lexsort((azimuth, rings.ring))
        ring, azimuth = rings.ring[order], azimuth[order]
        first = np.searchsorted(ring, ring)  # of its ring
        last = np.append(ring[1:] != ring[:-1], True)
        gap = np.where(last, azimuth[first] + _TURN, np.roll(azimuth, -1)) - azimuth
        # Firings without a return are spread evenly over the gap between two that returned.
        lacking = np.maximum(np.round(gap / rings.step_rad).astype(int) - 1, 0)
        number = np.arange(lacking.sum()) - np.repeat(np.cumsum(lacking) - lacking, lacking) + 1
        between = np.mod(np.repeat(azimuth, lacking) + np.repeat(gap / (lacking + 1), lacking) * number, _TURN)
        dark = np.setdiff1d(np.arange(len(rings)), ring)  # nothing returned on these
        turn = np.arange(0.0, _TURN, rings.step_rad)
        self._azimuth = np.concatenate([azimuth, between, np.tile(turn, len(dark))])
        self._ring = np.concatenate([ring, np.repeat(ring, lacking), np.repeat(dark, len(turn))])
        self._point = np.full(len(self._ring), NO_POINT)
        self._point[: len(order)] = order

    def towards(self, centre: np.ndarray, size: np.ndarray, heading: float) -> tuple[Rays, np.ndarray]:
        """All rays that meet a box, and how far along each it enters the box.

        They go ring by ring, first those that returned, each with the azimuth rising.

        Parameters
        ----------
        centre, size : ndarray, (3,)
            Box centre; length, width and height [m, frame of the cloud].
        heading : float
            Counter-clockwise from +x [rad].
        """
        x, y, _ = self._pose.to_sensor(centre)
        away, reach = math.hypot(x, y), 0.5 * float(np.linalg.norm(size)) + np.abs(self._rings.lateral_m).max()
        bearing, widest = math.atan2(y, x) % _TURN, math.asin(reach / away) if reach < away else math.pi
        aside = _wrapped(self._azimuth - bearing)
        near = np.flatnonzero(np.abs(aside) <= widest)
        near = near[np.lexsort((aside[near], self._point[near] == NO_POINT, self._ring[near]))]
        rays = self._rays(self._azimuth[near], self._point[near], self._ring[near])
        entry, leave = crossing(rays, centre, size, heading)
        meets = (leave >= entry) & (leave > 0.0)
        return Rays(*(values[meets] for values in rays)), entry[meets]

    def _rays(self, azimuth: np.ndarray, point: np.ndarray, ring: np.ndarray) -> Rays:
        """Rays of rings at azimuths counter-clockwise from the sensor's +x, and the points they returned as."""
        lateral, elevation = self._rings.lateral_m[ring], self._rings.elevation_rad[ring]
        cos, sin, level = np.cos(azimuth), np.sin(azimuth), np.cos(elevation)
        start = np.column_stack([-lateral * sin, lateral * cos, self._rings.height_m[ring]])
        origin = self._pose.position + self._pose.to_world(start)
        direction = self._pose.to_world(np.column_stack([cos * level, sin * level, np.sin(elevation)]))
        returned = point != NO_POINT
        way = self._points[point[returned]] - origin[returned]
        distance = np.full(len(point), np.inf)
        distance[returned] = np.linalg.norm(way, axis=1)
        direction[returned] = way / distance[returned, None]
        return Rays(origin, direction, point, distance)


def crossing(rays: Rays, centre: np.ndarray, size: np.ndarray, heading: float) -> tuple[np.ndarray, np.ndarray]:
    """How far along each ray it enters and leaves a box, (k,) each [m]; it meets the box where it leaves it later."""
    start = to_vehicle_frame(rays.origin, centre, heading)
    way = to_vehicle_frame(rays.direction, np.zeros(3), heading)
    with np.errstate(divide="ignore"):
        inverse = 1.0 / np.where(way == 0.0, 1e-300, way)
    near, far = (-0.5 * size - start) * inverse, (0.5 * size - start) * inverse
    return np.minimum(near, far).max(axis=1), np.maximum(near, far).min(axis=1)
