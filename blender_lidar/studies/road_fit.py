"""Extrinsic calibration against the road: height, leans and yaw of a LiDAR from its own cloud of a straight road.

A first plane levels the cloud, what stands on the road shows its direction, and a surface is fitted to it
(`road_surface`). Intervals are of the jackknife of that, and a stated systematic part.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ..detection.l_shape import LShape, l_shape_heading
from ..errors import InputError
from ..sensors.pose import Pose, tilts_of
from .road_surface import (
    FEWEST_POINTS,
    JACKKNIFE_SECTORS,
    RING_SD_RAD,
    RingCheck,
    RoadFrame,
    RoadPoints,
    SurfaceFit,
    fit_surface,
)

_REACH_M, _NEAREST_M = 45.0, 1.0  # of ground that is fitted
_STEEPEST = math.cos(math.radians(50.0))  # between the sensor's upright axis and the road's
_HEIGHTS_M = (0.5, 40.0)
_TRIALS, _TRIED = 400, 6000  # of the plane's random samples, and points
_NOISE_M, _NOISE_BY_RANGE = 0.012, 0.0008  # of the ground about its surface
_SYSTEMATIC_M, _SYSTEMATIC_RAD = 0.012, math.radians(0.05)  # what an uneven road adds, standard deviations
_RANGE_M = 0.015  # the same of the error of ranges, which bends of the road are taken for
_RAILS_RAD, _VEHICLES_RAD = math.radians(0.15), math.radians(0.4)  # of directions: rails bend, bodies taper
Z_90 = 1.645


class Estimate(NamedTuple):
    """A value with its standard error and the systematic part of that, all in one unit."""

    value: float
    error: float
    systematic: float

    @property
    def interval_90(self) -> tuple[float, float]:
        """Ends of the 90 % interval, systematic part included."""
        half = Z_90 * math.hypot(self.error, self.systematic)
        return self.value - half, self.value + half


class Carriageway(NamedTuple):
    """A strip of smooth road: its edges as far as they are seen, y [m, road frame], and its cross-fall.

    `slope` is its rise along +y by metre, `above_m` the height of the LiDAR above it, prolonged to y = 0.
    """

    y_m: tuple[float, float]
    slope: float
    above_m: float


@dataclass(frozen=True, slots=True, eq=False)
class RoadFit:
    """Where a LiDAR hangs above a road, by its cloud.

    The road frame has its origin under the LiDAR on the road's surface, prolonged where that is hidden, x along the
    road, z square to the mean slope of its carriageways.

    Attributes
    ----------
    pose : Pose
        The sensor's, with x_m = y_m = 0; its yaw is the planned one, or 0, where none was measured.
    height_m, tilt_x, tilt_y : Estimate
        [m, rad]; the tilts do not depend on the yaw.
    yaw : Estimate or None
        [rad]; None where nothing showed the direction of the road, which is then the sensor's x axis.
    direction_from : str
        What showed it: ``rails``, ``vehicles`` or nothing.
    carriageways : tuple of Carriageway
        From the right.
    range_error_m : Estimate
        By which all ranges seem too long [m].
    ring_error_rad : ndarray, (r,)
        By which the cloud's elevation of each ring seems too high [rad]; 0 where the ring saw no road.
    ring_sd_rad : ndarray, (r,)
        Standard error of these; inf where the ring saw no road.
    ground : ndarray of bool, (n,)
        Which points lie on the road's surface.
    residual_m : float
        Median distance of these from it.
    ring_check : RingCheck or None
        None where the errors were not asked for.
    """

    pose: Pose
    height_m: Estimate
    tilt_x: Estimate
    tilt_y: Estimate
    yaw: Estimate | None
    direction_from: str
    carriageways: tuple[Carriageway, ...]
    range_error_m: Estimate
    ring_error_rad: np.ndarray
    ring_sd_rad: np.ndarray
    ground: np.ndarray
    residual_m: float
    ring_check: RingCheck | None


# --- The plane, and the direction of the road -------------------------------------------------------------------------


def ground_plane(points: np.ndarray) -> tuple[np.ndarray, float]:
    """The road's plane by RANSAC: its upward normal (3,), and the height of the sensor above it [m].

    `points` are (n, 3) of the sensor's frame [m]; far ones count for the ground between them and their neighbours.

    Raises
    ------
    InputError
        Where there is no plane below the sensor.
    """
    rng = np.random.default_rng(0)
    reach = np.linalg.norm(points, axis=1)
    some = points[(reach > _NEAREST_M) & (reach < 60.0)]
    some = some[rng.permutation(len(some))[:_TRIED]]
    if len(some) < FEWEST_POINTS:
        raise InputError(f"{len(some)} points within 60 m; allowed: {FEWEST_POINTS} or more")
    slack = 0.05 + 0.004 * np.linalg.norm(some, axis=1)
    weight = np.minimum(np.hypot(some[:, 0], some[:, 1]), 25.0)
    best, normal, height = 0.0, np.array([0.0, 0.0, 1.0]), math.nan
    for _ in range(_TRIALS):
        a, b, c = some[rng.integers(len(some), size=3)]
        trial = np.cross(b - a, c - a)
        length = float(np.linalg.norm(trial))
        if length < 1e-6:
            continue
        trial = trial / math.copysign(length, trial[2])
        above = float(-trial @ a)
        if trial[2] >= _STEEPEST and _HEIGHTS_M[0] <= above <= _HEIGHTS_M[1]:
            held = float((weight * (1.0 - ((some @ trial + above) / slack) ** 2).clip(0.0)).sum())
            if held > best:
                best, normal, height = held, trial, above
    if not best:
        raise InputError("no plane lies below the sensor")
    for narrowing in (3.0, 2.5, 2.0, 1.5, 1.5):
        off = (some @ normal + height) / (narrowing * slack)
        kept = weight / slack**2 * (1.0 - off**2).clip(0.0) ** 2
        design = np.column_stack([some[:, :2], np.ones(len(some))]) * np.sqrt(kept)[:, None]
        x, y, level = np.linalg.lstsq(design, some[:, 2] * np.sqrt(kept), rcond=None)[0].tolist()
        length = math.hypot(x, y, 1.0)
        normal, height = np.array([-x, -y, 1.0]) / length, -level / length
    on = some[np.abs(some @ normal + height) < slack]
    if len(on) < 0.1 * len(some) or len(on) < 100 or np.ptp(on[:, :2], axis=0).min() < 8.0:
        raise InputError(f"{len(on)} of {len(some)} points lie on a plane below the sensor, which is no road")
    return normal, height


def levelling(normal: np.ndarray) -> np.ndarray:
    """The rotation (3, 3) for rows that turns a normal upright and leaves the sensor's x axis above itself."""
    x = np.array([1.0, 0.0, 0.0]) - normal[0] * normal
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(normal, x), normal], axis=1)


class _Seen(NamedTuple):
    """What stands on the road: headings mod 180 degrees (k,) [rad], lengths (k,) [m], x and y (k, 2), rails or not."""

    heading: np.ndarray
    length: np.ndarray
    corner: np.ndarray
    rail: np.ndarray

    def pick(self, rows: np.ndarray) -> _Seen:
        """Some of it."""
        return _Seen(*(column[rows] for column in self))


_CELL_M, _STANDS_M, _FEWEST_OF_ONE = 0.35, (0.35, 2.5), 25
_LENGTHS_M, _RAIL_M = (2.5, 20.0), 25.0
_MEDIAN_M = 12.0  # between vehicles: what stands farther aside is none


def _standing(level: np.ndarray) -> _Seen:
    """Vehicles and rails among levelled points (n, 3), as clusters of cells with L-shapes fitted to them."""
    from scipy import ndimage

    reach = np.hypot(level[:, 0], level[:, 1])
    some = level[(reach < 50.0) & (level[:, 2] > _STANDS_M[0]) & (level[:, 2] < _STANDS_M[1])]
    found = []
    if len(some):
        cell = np.floor(some[:, :2] / _CELL_M).astype(int)
        cell -= cell.min(axis=0)
        filled = np.zeros(cell.max(axis=0) + 1, dtype=bool)
        filled[tuple(cell.T)] = True
        owner = ndimage.label(filled, np.ones((3, 3)))[0][tuple(cell.T)]
        order = np.argsort(owner, kind="stable")
        ends = np.flatnonzero(np.diff(owner[order])) + 1
        found = [_standing_one(some[rows, :2]) for rows in np.split(order, ends) if len(rows) >= _FEWEST_OF_ONE]
    rows = np.array([one for one in found if one[1] >= _LENGTHS_M[0]]).reshape(-1, 6)
    return _Seen(rows[:, 0], rows[:, 1], rows[:, 2:6], rows[:, 1] >= _RAIL_M)


def _standing_one(xy: np.ndarray) -> tuple[float, ...]:
    """Heading of the longer side [rad], its length [m], and the least and greatest x and y of a cluster (n, 2)."""
    shape = LShape.about(xy, l_shape_heading(xy))
    along, across = shape.seen.tolist()
    turned = shape.heading + (0.5 * math.pi if across > along else 0.0)
    return turned % math.pi, max(along, across), *xy.min(axis=0), *xy.max(axis=0)


def _direction(still: _Seen, each: Sequence[_Seen]) -> tuple[Estimate | None, str]:
    """The road's direction mod 180 degrees [rad]: by rails of what stands still, else by the vehicles of each cloud."""
    rails = still.rail.sum() >= 2
    found = [still.pick(still.rail)] if rails else [one.pick(~one.rail) for one in each]
    heading, length = (np.concatenate([getattr(one, key) for one in found]) for key in ("heading", "length"))
    weight = length if rails else length.clip(0.0, 8.0)
    if len(heading) < (2 if rails else 3):
        return None, ""
    middle = 0.5 * np.angle((weight * np.exp(2j * heading)).sum())
    for _ in range(2):  # the median about the mean of double angles
        off = np.mod(heading - middle + 0.5 * math.pi, math.pi) - 0.5 * math.pi
        alike = np.abs(off) < math.radians(15.0)
        if not alike.any():
            return None, ""
        middle += _weighted_median(off[alike], weight[alike])
    spread = 1.4826 * float(np.median(np.abs(off[alike] - np.median(off[alike]))))
    error = 1.25 * spread / math.sqrt(alike.sum() / len(found))  # one cloud may show what another does
    return Estimate(float(middle), error, _RAILS_RAD if rails else _VEHICLES_RAD), "rails" if rails else "vehicles"


def _weighted_median(values: np.ndarray, weight: np.ndarray) -> float:
    order = np.argsort(values)
    reached = np.cumsum(weight[order])
    return float(values[order][np.searchsorted(reached, 0.5 * reached[-1])])


def fit_road(
    points: np.ndarray,
    ring: np.ndarray,
    rings: int,
    facing: float | None = None,
    traffic: Sequence[np.ndarray] = (),
    *,
    errors: bool = True,
) -> RoadFit:
    """Where the LiDAR of a cloud hangs above a straight road.

    Parameters
    ----------
    points : ndarray, (n, 3)
        In the sensor's frame [m]: x to the right of y, z up its axis.
    ring : ndarray of int, (n,)
        Ring of each point.
    rings : int
        How many there are.
    facing : float, optional
        Yaw that is planned [rad]: of the two ways along the road the one nearer to it is x. Without it, x is such that
        the road lies towards +y, or the way nearer to the sensor's x or y axis where it lies to both sides.
    traffic : sequence of ndarray, (k, 3)
        Single clouds of the same mounting, where `points` are a background without vehicles: these show the direction
        of the road, and where it is driven on.
    errors : bool
        Whether standard errors are found; else they are 0.

    Raises
    ------
    InputError
        Where no road is seen.
    """
    normal, height = ground_plane(points)
    level = levelling(normal)
    flat = points @ level + [0.0, 0.0, height]
    each = [_standing(one @ level + [0.0, 0.0, height]) for one in traffic or [points]]
    seen = _Seen(*(np.concatenate(columns) for columns in zip(*each, strict=True)))
    direction, direction_from = _direction(_standing(flat) if traffic else seen, each)
    turn = _along(direction.value, seen, facing) if direction else -(facing or 0.0)
    ground, rows = _near_ground(points, ring, flat, normal, height, turn)
    road = fit_surface(ground, rings, _driven(seen, turn), errors=errors)
    cos, sin = math.cos(turn), math.sin(turn)
    up = np.array([-road.frame.along, -road.frame.across, 1.0])
    up /= np.linalg.norm(up)
    x = np.array([1.0, 0.0, 0.0]) - up[0] * up
    x /= np.linalg.norm(x)
    along = level @ np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    tilt_x, tilt_y, yaw = tilts_of(along @ np.stack([x, np.cross(up, x), up], axis=1))
    above = (height - road.frame.level) * float(up[2])
    # Slopes along and across turn the sensor about the road's axes; the tilts are about its own.
    about = abs(math.cos(yaw)), abs(math.sin(yaw))
    spread = road.errors or RoadFrame(0.0, 0.0, 0.0)
    return RoadFit(
        pose=Pose(0.0, 0.0, above, tilt_x, tilt_y, yaw),
        height_m=Estimate(above, max(spread.level, road.level_sd_m), math.hypot(_SYSTEMATIC_M, road.doubt.level)),
        tilt_x=_about(about, spread, road.doubt, tilt_x),
        tilt_y=_about(about[::-1], spread, road.doubt, tilt_y),
        yaw=None if direction is None else direction._replace(value=yaw),
        direction_from=direction_from,
        carriageways=tuple(_carriageway(*one, road, height) for one in zip(road.strips, road.levels, strict=True)),
        range_error_m=Estimate(*road.range_error_m, _RANGE_M),
        ring_error_rad=road.ring_error_rad,
        ring_sd_rad=np.where(road.ring_sd_rad < 0.99 * RING_SD_RAD, road.ring_sd_rad, np.inf),
        ground=np.isin(np.arange(len(points)), rows[road.ground]),
        residual_m=road.residual_m,
        ring_check=road.ring_check,
    )


def _about(share: tuple[float, float], spread: RoadFrame, doubt: RoadFrame, tilt: float) -> Estimate:
    """A tilt with its errors, of which the slopes across and along the road have shares."""
    across, along = share
    error = math.hypot(across * spread.across, along * spread.along)
    return Estimate(tilt, error, math.hypot(_SYSTEMATIC_RAD, across * doubt.across))


def _carriageway(
    strip: tuple[float, float], levels: tuple[float, float], road: SurfaceFit, height: float
) -> Carriageway:
    slope = (levels[1] - levels[0]) / (strip[1] - strip[0])
    return Carriageway(strip, slope - road.frame.across, height - (levels[0] - slope * strip[0]))


def _along(turn: float, seen: _Seen, facing: float | None) -> float:
    """Of the two ways along the road the one that is x, from the levelled sensor's x axis [rad]."""
    if facing is not None:  # the yaw of the sensor is less the turn of the road in its frame
        return turn if math.cos(turn + facing) >= 0.0 else turn + math.pi
    middle = seen.corner.reshape(-1, 2, 2).mean(axis=1)[~seen.rail]
    left = middle @ [-math.sin(turn), math.cos(turn)]
    if len(left) >= 3 and abs(np.sign(left).sum()) >= 0.8 * len(left):
        return turn if np.sign(left).sum() > 0.0 else turn + math.pi
    ways = [turn, turn + math.pi]
    return max(ways, key=lambda one: max(math.cos(one), math.sin(one)))


def _driven(seen: _Seen, turn: float) -> tuple[float, float] | None:
    """From where to where across the road vehicles are seen, with a metre beside them [m]; None without any."""
    vehicles = seen.corner[~seen.rail & (seen.length < _LENGTHS_M[1])]
    if len(vehicles) < 3:
        return None
    x, y = vehicles[:, [0, 2]], vehicles[:, [1, 3]]
    across = np.sort(-math.sin(turn) * x.mean(axis=1) + math.cos(turn) * y.mean(axis=1))
    groups = np.split(across, np.flatnonzero(np.diff(across) > _MEDIAN_M) + 1)
    near = min((one for one in groups if len(one) >= 3), key=lambda one: np.abs(one).min(), default=across)
    return float(near[0] - 2.0), float(near[-1] + 2.0)


def _near_ground(points, ring, flat, normal, height, turn) -> tuple[RoadPoints, np.ndarray]:
    """The points that may be ground, and their rows."""
    reach = np.hypot(flat[:, 0], flat[:, 1])
    rows = np.flatnonzero((reach < _REACH_M) & (np.abs(flat[:, 2]) < 1.0))
    p, q, rho = points[rows], flat[rows], reach[rows]
    away = np.linalg.norm(p, axis=1)
    level = np.maximum(np.hypot(p[:, 0], p[:, 1]), 1e-9)
    rise = np.column_stack([-p[:, 0] * p[:, 2] / level, -p[:, 1] * p[:, 2] / level, level])  # times the range
    cos, sin = math.cos(turn), math.sin(turn)
    ground = RoadPoints(
        s=cos * q[:, 0] + sin * q[:, 1],
        t=cos * q[:, 1] - sin * q[:, 0],
        z=q[:, 2],
        ring=ring[rows],
        sector=((np.arctan2(q[:, 1], q[:, 0]) + math.pi) / (2.0 * math.pi) * JACKKNIFE_SECTORS).astype(int)
        % JACKKNIFE_SECTORS,
        by_ring=rise @ normal,
        by_range=p @ normal / away,
        noise=np.hypot(_NOISE_M, _NOISE_BY_RANGE * rho),
    )
    return ground, rows
