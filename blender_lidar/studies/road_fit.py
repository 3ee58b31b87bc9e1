"""Extrinsic calibration against the road: height, leans and yaw of a LiDAR from its own cloud of a straight road.

The road's surface is z = a s + f(t) along (s) and across (t) it, f piecewise linear, so that carriageways, crown and
verge have planes of their own. It is fitted by iteratively reweighted least squares, together with errors of the
sensor: of all ranges, and of each ring's elevation. Intervals are of the delete-one jackknife over sectors and groups
of rings, and a stated systematic part.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ..errors import InputError
from ..sensors.pose import Pose, tilts_of

FEWEST_POINTS = 500
_REACH_M, _NEAREST_M = 45.0, 1.0  # of ground that is fitted
_STEEPEST = math.cos(math.radians(50.0))  # between the sensor's upright axis and the road's
_HEIGHTS_M = (0.5, 40.0)
_TRIALS, _TRIED = 400, 6000  # of the plane's random samples, and points
# Standard deviations beforehand: of the error of all ranges, of a ring's elevation, of the curvature along the road.
_RANGE_SD_M, _RING_SD_RAD, _BEND_SD = 0.01, math.radians(0.02), 1e-4
_INDEPENDENT = 400  # as many points count: an uneven road moves neighbours alike
_NOISE_M, _NOISE_BY_RANGE = 0.012, 0.0008  # of the ground about its surface
_MOST_BREAKS, _APART_M, _WORTH = 4, 2.0, 0.03  # of f; how much of the section a break must explain
_BIN_M, _LEVEL_M, _FEWEST_OF_STRIP = 0.5, 0.06, 15  # of the section
_FINE_M, _ROUGH_M = 0.005, 0.03  # of the section about its pieces
_BESIDE_M = 10.0  # what vehicles drive on, as far as the section is looked at
_UNDER_M = 2.0  # about y = 0, where the height is
_SECTORS, _RING_GROUPS = 12, 8
_SYSTEMATIC_M, _SYSTEMATIC_RAD = 0.012, math.radians(0.05)  # what an uneven road adds, standard deviations
_Z_90 = 1.645


class Estimate(NamedTuple):
    """A value with its standard error and the systematic part of that, all in one unit."""

    value: float
    error: float
    systematic: float

    @property
    def interval_90(self) -> tuple[float, float]:
        """Ends of the 90 % interval, systematic part included."""
        half = _Z_90 * math.hypot(self.error, self.systematic)
        return self.value - half, self.value + half


class Carriageway(NamedTuple):
    """A strip of smooth road: its edges as far as they are seen, y [m, road frame], and its cross-fall.

    `slope` is its rise along +y by metre, `above_m` the height of the LiDAR above it, prolonged to y = 0.
    """

    y_m: tuple[float, float]
    slope: float
    above_m: float


class RingCheck(NamedTuple):
    """Errors of rings, learnt from one half of the road and judged on the other.

    Attributes
    ----------
    halves : str
        What the halves are.
    before_rad, after_rad : float or None
        Root mean square of the rings' mean elevations off the road, without and with what the other half taught [rad];
        None where fewer than eight rings see both.
    """

    halves: str
    before_rad: float | None
    after_rad: float | None


@dataclass(frozen=True, slots=True, eq=False)
class RoadFit:
    """Where a LiDAR hangs above a road, by its cloud.

    The road frame has its origin under the LiDAR on the road's surface, prolonged where that is hidden, x along the
    road, z square to the mean slope of its carriageways.

    Attributes
    ----------
    pose : Pose
        The sensor's, with x_m = y_m = 0.
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
        By which the table's elevation of each ring seems too high [rad]; 0 where the ring saw no road.
    ring_sd_rad : ndarray, (r,)
        Standard error of these; inf where the ring saw no road.
    ground : ndarray of bool, (n,)
        Which points lie on the road's surface.
    residual_m : float
        Median distance of these from it.
    ring_check : RingCheck
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
    ring_check: RingCheck


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


_CELL_M, _STANDS_M, _FEWEST_OF_ONE = 0.35, (0.35, 2.5), 25
_LENGTHS_M, _RAIL_M = (2.5, 20.0), 25.0
_MEDIAN_M = 12.0  # between vehicles: what stands farther aside is none


def _standing(level: np.ndarray) -> _Seen:
    """Vehicles and rails among levelled points (n, 3), as clusters of cells with L-shapes fitted to them.

    The closeness criterion of Zhang et al. (IV 2017).
    """
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
        found = [_l_shape(some[rows, :2]) for rows in np.split(order, ends) if len(rows) >= _FEWEST_OF_ONE]
    rows = np.array([one for one in found if one[1] >= _LENGTHS_M[0]]).reshape(-1, 6)
    return _Seen(rows[:, 0], rows[:, 1], rows[:, 2:6], rows[:, 1] >= _RAIL_M)


def _l_shape(xy: np.ndarray) -> tuple[float, ...]:
    """Heading of the longer side [rad], its length [m], and the least and greatest x and y of a cluster (n, 2)."""
    some = xy[:: len(xy) // 300 + 1]
    turns = np.arange(0.0, 90.0, 1.0)
    for finer in (1.0, 0.1):
        turn = np.radians(turns)[:, None]
        along, across = (np.cos(turn + by) * some[:, 0] + np.sin(turn + by) * some[:, 1] for by in (0.0, 0.5 * math.pi))
        edges = [
            np.minimum(one - one.min(1, keepdims=True), one.max(1, keepdims=True) - one) for one in (along, across)
        ]
        best = int((1.0 / np.maximum(np.minimum(*edges), 0.05)).sum(axis=1).argmax())
        turns = turns[best] + np.arange(-1.0, 1.05, 0.1) if finer == 1.0 else turns
    lengths = np.ptp(along[best]), np.ptp(across[best])
    heading = float(turn[best, 0]) + (0.5 * math.pi if lengths[1] > lengths[0] else 0.0)
    return heading % math.pi, float(max(lengths)), *xy.min(axis=0), *xy.max(axis=0)


def _direction(seen: _Seen) -> tuple[Estimate | None, str]:
    """The road's direction mod 180 degrees [rad], by rails if there are two, else by what stands on it."""
    rails = seen.rail.sum() >= 2
    heading, weight = (
        (seen.heading[seen.rail], seen.length[seen.rail]) if rails else (seen.heading, seen.length.clip(0.0, 8.0))
    )
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
    error = 1.25 * spread / math.sqrt(alike.sum())
    return Estimate(float(middle), error, math.radians(0.15 if rails else 0.3)), "rails" if rails else "vehicles"


def _weighted_median(values: np.ndarray, weight: np.ndarray) -> float:
    order = np.argsort(values)
    reached = np.cumsum(weight[order])
    return float(values[order][np.searchsorted(reached, 0.5 * reached[-1])])


# --- The surface ------------------------------------------------------------------------------------------------------


class _Ground(NamedTuple):
    """Points near the road, (n,) each: along, across and above the first plane [m], ring, sector, levers and noise [m].

    `by_ring` is how far a point rises by a radian of its ring's elevation, `by_range` by a metre of range.
    """

    s: np.ndarray
    t: np.ndarray
    z: np.ndarray
    ring: np.ndarray
    sector: np.ndarray
    by_ring: np.ndarray
    by_range: np.ndarray
    noise: np.ndarray

    def pick(self, rows: np.ndarray) -> _Ground:
        """Some of the points."""
        return _Ground(*(column[rows] for column in self))


class _Solved(NamedTuple):
    """A fitted surface.

    `x` has the level, the slope across and its changes at the breaks, then slope and half the curvature along, and the
    error of ranges; `ring_error` is by ring, `residual` and `weight` by point.
    """

    x: np.ndarray
    covariance: np.ndarray
    ring_error: np.ndarray
    ring_sd: np.ndarray
    residual: np.ndarray
    weight: np.ndarray


def _surface(
    ground: _Ground,
    breaks: Sequence[float],
    rings: int,
    residual: np.ndarray,
    rounds: int = 8,
    ring_sd: float = _RING_SD_RAD,
) -> _Solved:
    """Least squares with Tukey's weights: the surface, with normal priors for the sensor's errors.

    It begins with the residuals (n,) of another fit.
    """
    design = np.column_stack([_bent(ground.t, breaks), ground.s, ground.s**2, ground.by_range])
    prior = np.full(design.shape[1], 1e-9)
    prior[-2:] = 1.0 / _BEND_SD**2, 1.0 / _RANGE_SD_M**2
    for turn in range(rounds):
        window = ground.noise * max(6.0 - turn, 3.0)
        weight = (1.0 - (residual / window) ** 2).clip(0.0) ** 2
        weight *= min(1.0, _INDEPENDENT / max(weight.sum(), 1.0)) / ground.noise**2
        lever = weight * ground.by_ring
        of_rings = np.bincount(ground.ring, lever * ground.by_ring, rings) + 1.0 / ring_sd**2
        cross = np.stack([np.bincount(ground.ring, lever * column, rings) for column in design.T])
        pull = np.bincount(ground.ring, lever * ground.z, rings)
        normal = (design * weight[:, None]).T @ design - (cross / of_rings) @ cross.T + np.diag(prior)
        x = np.linalg.solve(normal, design.T @ (weight * ground.z) - (cross / of_rings) @ pull)
        ring_error = (pull - cross.T @ x) / of_rings
        residual = ground.z - design @ x - ground.by_ring * ring_error[ground.ring]
    return _Solved(x, np.linalg.inv(normal), ring_error, 1.0 / np.sqrt(of_rings), residual, weight)


def _profile(ground: _Ground, span: tuple[float, float]) -> tuple[np.ndarray, ...]:
    """The road's section: of strips across the road y [m], level [m] and weight, (k,) each.

    The level is where most points lie within a few centimetres, the weight the square of their share: it is small where
    hedges, rails or vehicles stand.
    """
    strip = np.floor((ground.t - span[0]) / _BIN_M).astype(int)
    found = []
    for one in range(math.ceil((span[1] - span[0]) / _BIN_M)):
        z = np.sort(ground.z[strip == one])
        if len(z) >= _FEWEST_OF_STRIP:
            held = np.searchsorted(z, z + _LEVEL_M, "right") - np.arange(len(z))
            at, most = int(held.argmax()), int(held.max())
            found.append((span[0] + (one + 0.5) * _BIN_M, float(z[at : at + most].mean()), (most / len(z)) ** 2))
    return tuple(np.array(found).reshape(-1, 3).T)


def _bent(t: np.ndarray, breaks: Sequence[float]) -> np.ndarray:
    """Columns of a piecewise linear function of t (n,): 1, t, and what each break adds, (n, 2 + breaks)."""
    return np.column_stack([np.ones_like(t), t, *(np.maximum(t - one, 0.0) for one in breaks)])


def _section(t: np.ndarray, z: np.ndarray, weight: np.ndarray, breaks: Sequence[float]) -> tuple[float, np.ndarray]:
    """Piecewise linear fit of the road's section, by least absolute deviations.

    Returns the misfit, in which far strips count the same, and the coefficients.
    """
    design, off = _bent(t, breaks), np.ones_like(t)
    for _ in range(20):
        root = np.sqrt(weight / np.maximum(np.abs(off), _FINE_M))
        x = np.linalg.lstsq(design * root[:, None], z * root, rcond=None)[0]
        off = z - design @ x
    return float(weight @ np.minimum(np.abs(off) / _ROUGH_M, 10.0)), x


def _breaks(profile: tuple[np.ndarray, ...]) -> list[float]:
    """Where the surface bends across the road, y [m]: one break after the other, while each explains much."""
    t, _, weight = profile
    found, least = [], _section(*profile, ())[0]
    while len(found) < _MOST_BREAKS:
        places = [one for one in t[2:-2] if all(abs(one - other) >= _APART_M for other in found)]
        tried = [(_section(*profile, sorted([*found, one]))[0], float(one)) for one in places]
        if not tried or least - min(tried)[0] < max(_WORTH * weight.sum(), 0.1 * least):
            break
        least, one = min(tried)
        found = sorted([*found, one])
    for step in (0.25, 0.1):  # each to where it explains most
        for at in range(len(found)):
            moved = [[*found[:at], found[at] + by, *found[at + 1 :]] for by in (-step, step)]
            best, places = min((_section(*profile, one)[0], one) for one in moved)
            if best < least:
                least, found = best, places
    return found


def _height_across(x: np.ndarray, breaks: Sequence[float], t: np.ndarray | float) -> np.ndarray | float:
    """f(t): the surface across the road at s = 0 [m]."""
    return x[0] + x[1] * t + sum(x[2 + at] * np.maximum(t - one, 0.0) for at, one in enumerate(breaks))


_LEAST_SHARE, _GAP_M, _NARROWEST_M = 0.6, 4.0, 3.0
_AT_BARRIER_M = 1.5
_RAISED_M, _CELL_ALONG_M, _BARRIER_CELLS = 0.2, 2.0, 12  # of a barrier: what stands 24 m along the road or more


def _strips(
    ground: _Ground,
    residual: np.ndarray,
    span: tuple[float, float],
    driven: tuple[float, float],
) -> list[tuple[float, float]]:
    """Strips of smooth road that vehicles drive on, y from the right [m]: between barriers where there are."""
    edges = np.arange(span[0], span[1] + 0.5 * _BIN_M, _BIN_M)
    low, smooth = (
        np.histogram(ground.t[which], edges)[0] for which in (ground.z < 1.0, np.abs(residual) < 6.0 * ground.noise)
    )
    raised = residual > _RAISED_M
    cells = np.stack([np.digitize(ground.t, edges), np.floor(ground.s / _CELL_ALONG_M)], axis=1)[raised]
    barrier = np.bincount(np.unique(cells, axis=0)[:, 0].astype(int), minlength=len(edges) + 1)[1:-1] >= _BARRIER_CELLS
    is_road = (smooth >= 8) & (smooth >= _LEAST_SHARE * low)
    runs: list[list[float]] = []
    for at in np.flatnonzero(is_road).tolist():
        last = round((runs[-1][1] - edges[0]) / _BIN_M) if runs else at
        if runs and edges[at] - runs[-1][1] <= _GAP_M and not barrier[last:at].any():
            runs[-1][1] = float(edges[at + 1])
        else:
            runs.append([float(edges[at]), float(edges[at + 1])])
    walls = edges[:-1][barrier] + 0.5 * _BIN_M
    found = []
    for first, last in runs:  # beyond what vehicles drive on as far as a barrier, if one is near
        low, high = driven
        if (np.abs(walls - first) <= _AT_BARRIER_M).any():
            low = first
        if (np.abs(walls - last) <= _AT_BARRIER_M).any():
            high = last
        first, last = max(first, low), min(last, high)
        if last - first >= _NARROWEST_M:
            found.append((float(first), float(last)))
    return found


class _Reading(NamedTuple):
    """Level under the LiDAR [m], slopes of the road along and across, and the doubt in the first and the last."""

    level: float
    along: float
    across: float
    level_doubt: float
    across_doubt: float


def _read(solved: _Solved, breaks: Sequence[float], strips: Sequence[tuple[float, float]]) -> _Reading:
    """What a fitted surface says of the road's frame.

    The slope across is the mean of both sides of the crown, the break at which the surface turns down most, whatever is
    seen of each. Where there is none, or it is no crown, the mean over the width is as good: a quarter of what these
    differ by is in doubt. Where the LiDAR stands between two carriageways, the level is the mean of both prolonged.
    """
    planes = _planes(breaks, strips)
    low, high = np.array(planes).T
    levels = np.array([_height_across(solved.x, breaks, ends) for ends in (low, high)])
    widths, slopes = high - low, (levels[1] - levels[0]) / (high - low)
    whole = across = float(widths @ slopes / widths.sum())
    if len(planes) > 1:
        crown = int(np.argmax(slopes[:-1] - slopes[1:])) + 1
        sides = slice(crown), slice(crown, None)
        across = 0.5 * sum(float(widths[of] @ slopes[of] / widths[of].sum()) for of in sides)
    level, doubt = float(_height_across(solved.x, breaks, 0.0)), 0.0
    right, left = np.flatnonzero(high <= 0.0), np.flatnonzero(low >= 0.0)
    if len(right) and len(left):  # in a median
        ends = (
            levels[1, right[-1]] - slopes[right[-1]] * high[right[-1]],
            levels[0, left[0]] - slopes[left[0]] * low[left[0]],
        )
        level, doubt = float(0.5 * (ends[0] + ends[1])), float(0.5 * abs(ends[0] - ends[1]))
    return _Reading(level, float(solved.x[-3]), across, doubt, 0.25 * abs(across - whole))


def _breaks_within(breaks: Sequence[float], strips: Sequence[tuple[float, float]]) -> list[float]:
    """The breaks within strips, and the edges of the gaps between them: levels of two carriageways are their own."""
    inner = [one for one in breaks if any(low < one < high for low, high in strips)]
    edges = [
        one for (_, end), (start, _) in itertools.pairwise(strips) if start - end >= _APART_M for one in (end, start)
    ]
    return sorted([one for one in inner if all(abs(one - other) >= 0.5 * _APART_M for other in edges)] + edges)


def _planes(breaks: Sequence[float], strips: Sequence[tuple[float, float]]) -> list[tuple[float, float]]:
    """The strips, cut where the surface bends, y from the right [m]; what is narrow only where all are."""
    cut = []
    for low, high in strips:
        ends = [low, *(one for one in breaks if low < one < high), high]
        cut += list(itertools.pairwise(ends))
    return [one for one in cut if one[1] - one[0] >= _NARROWEST_M] or cut


def fit_road(
    points: np.ndarray,
    ring: np.ndarray,
    rings: int,
    facing: float | None = None,
    traffic: Sequence[np.ndarray] = (),
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
    direction, direction_from = _direction(seen)
    turn = 0.0 if direction is None else direction.value
    turn = _along(turn, flat, seen, level, facing)
    ground, rows = _near_ground(points, ring, flat, normal, height, turn)
    driven = _driven(seen, turn) or (-20.0, 20.0)
    span = math.floor(min(driven[0], 0.0) - _BESIDE_M), math.ceil(max(driven[1], 0.0) + _BESIDE_M)
    profile = _profile(ground, span)
    breaks = _breaks(profile)
    residual = ground.z - _bent(ground.t, breaks) @ _section(*profile, breaks)[1]
    strips = _strips(ground, residual, span, driven)
    if not strips:
        raise InputError("no strip of road 3 m wide is seen")
    # What lies beside the road has slopes of its own.
    kept = (np.abs(ground.t) < _UNDER_M) | np.any([(ground.t >= a) & (ground.t <= b) for a, b in strips], axis=0)
    ground, rows, residual = ground.pick(kept), rows[kept], residual[kept]
    breaks = _breaks_within(breaks, strips)
    solved = _surface(ground, breaks, rings, residual)
    on = solved.weight > 0.0
    first, spread = _read(solved, breaks, strips), _jackknife(ground, breaks, strips, rings, solved.residual)
    cos, sin = math.cos(turn), math.sin(turn)
    road = level @ np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    up = np.array([-first.along, -first.across, 1.0])
    up /= np.linalg.norm(up)
    x = np.array([1.0, 0.0, 0.0]) - up[0] * up
    x /= np.linalg.norm(x)
    rotation = road @ np.stack([x, np.cross(up, x), up], axis=1)
    tilt_x, tilt_y, yaw = tilts_of(rotation)
    above = (height - first.level) * float(up[2])
    pose = Pose(0.0, 0.0, above, tilt_x, tilt_y, yaw)
    # Slopes along and across turn the sensor about the road's axes; the tilts are about its own.
    about = abs(math.cos(yaw)), abs(math.sin(yaw))
    posterior = np.sqrt(np.diag(solved.covariance))
    return RoadFit(
        pose=pose,
        height_m=Estimate(above, max(spread.level, float(posterior[0])), math.hypot(_SYSTEMATIC_M, first.level_doubt)),
        tilt_x=_about(about, spread, first.across_doubt, tilt_x),
        tilt_y=_about(about[::-1], spread, first.across_doubt, tilt_y),
        yaw=None if direction is None else direction._replace(value=yaw),
        direction_from=direction_from,
        carriageways=tuple(_carriageway(one, solved, breaks, first, height) for one in strips),
        range_error_m=Estimate(float(solved.x[-1]), float(posterior[-1]), 0.0),
        ring_error_rad=solved.ring_error,
        ring_sd_rad=np.where(solved.ring_sd < 0.99 * _RING_SD_RAD, solved.ring_sd, np.inf),
        ground=_mask(len(points), rows[on]),
        residual_m=float(np.median(np.abs(solved.residual[on]))),
        ring_check=_ring_check(ground.pick(on), breaks, strips, rings, solved.residual[on]),
    )


def _about(share: tuple[float, float], spread: _Reading, doubt: float, tilt: float) -> Estimate:
    """A tilt with its errors, of which the slopes across and along the road have shares."""
    across, along = share
    return Estimate(
        tilt, math.hypot(across * spread.across, along * spread.along), math.hypot(_SYSTEMATIC_RAD, across * doubt)
    )


def _mask(count: int, rows: np.ndarray) -> np.ndarray:
    which = np.zeros(count, dtype=bool)
    which[rows] = True
    return which


def _carriageway(strip, solved: _Solved, breaks: Sequence[float], road: _Reading, height: float) -> Carriageway:
    a, b = strip
    low, high = (float(_height_across(solved.x, breaks, one)) for one in strip)
    slope = (high - low) / (b - a)
    return Carriageway(strip, slope - road.across, height - (low - slope * a))


def _along(turn: float, flat: np.ndarray, seen: _Seen, level: np.ndarray, facing: float | None) -> float:
    """Of the two ways along the road the one that is x, from the levelled sensor's x axis [rad]."""
    if facing is not None:
        # the yaw of the sensor is that of its x axis against the road's
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


def _near_ground(points, ring, flat, normal, height, turn) -> tuple[_Ground, np.ndarray]:
    """The points that may be ground, and their rows."""
    reach = np.hypot(flat[:, 0], flat[:, 1])
    rows = np.flatnonzero((reach < _REACH_M) & (np.abs(flat[:, 2]) < 1.0))
    p, q, rho = points[rows], flat[rows], reach[rows]
    away = np.linalg.norm(p, axis=1)
    level = np.maximum(np.hypot(p[:, 0], p[:, 1]), 1e-9)
    rise = np.column_stack([-p[:, 0] * p[:, 2] / level, -p[:, 1] * p[:, 2] / level, level])  # times the range
    cos, sin = math.cos(turn), math.sin(turn)
    ground = _Ground(
        s=cos * q[:, 0] + sin * q[:, 1],
        t=cos * q[:, 1] - sin * q[:, 0],
        z=q[:, 2],
        ring=ring[rows],
        sector=((np.arctan2(q[:, 1], q[:, 0]) + math.pi) / (2.0 * math.pi) * _SECTORS).astype(int) % _SECTORS,
        by_ring=rise @ normal,
        by_range=p @ normal / away,
        noise=np.hypot(_NOISE_M, _NOISE_BY_RANGE * rho),
    )
    return ground, rows


def _jackknife(ground: _Ground, breaks, strips, rings: int, residual: np.ndarray) -> _Reading:
    """Standard errors of what the surface says, over sectors and over groups of rings."""
    total = np.zeros(5)
    for group, number in ((ground.sector, _SECTORS), (ground.ring % _RING_GROUPS, _RING_GROUPS)):
        parts = [
            _read(_surface(ground.pick(group != one), breaks, rings, residual[group != one]), breaks, strips)
            for one in range(number)
            if (group == one).any()
        ]
        parts = np.array(parts)
        total += (len(parts) - 1) / len(parts) * ((parts - parts.mean(axis=0)) ** 2).sum(axis=0)
    return _Reading(*np.sqrt(total).tolist())


_FEWEST_OF_RING, _FEWEST_RINGS = 20, 8


def _ring_check(
    ground: _Ground, breaks: Sequence[float], strips: Sequence[tuple[float, float]], rings: int, residual: np.ndarray
) -> RingCheck:
    """Errors of rings from one half of the road, judged on the other: carriageways, or what is ahead and behind."""
    on_both_sides = strips[0][1] <= 0.0 <= strips[-1][0]
    halves = "carriageways" if on_both_sides else "ahead and behind"
    first = (ground.t if on_both_sides else ground.s) > 0.0
    taught, off, enough = [], [], np.ones(rings, dtype=bool)
    for half in (first, ~first):
        part, start = ground.pick(half), residual[half]
        if len(start) < FEWEST_POINTS:
            return RingCheck(halves, None, None)
        taught.append(_surface(part, breaks, rings, start).ring_error)
        as_it_is = _surface(part, breaks, rings, start, ring_sd=1e-9)
        lever = as_it_is.weight * part.by_ring
        share = np.bincount(part.ring, lever * part.by_ring, rings)
        off.append(np.bincount(part.ring, lever * as_it_is.residual, rings) / np.maximum(share, 1e-12))
        enough &= np.bincount(part.ring, minlength=rings) >= _FEWEST_OF_RING
    if enough.sum() < _FEWEST_RINGS:
        return RingCheck(halves, None, None)
    before = np.concatenate([one[enough] for one in off])
    after = np.concatenate([(one - other)[enough] for one, other in zip(off, taught[::-1], strict=True)])
    return RingCheck(halves, *(float(np.sqrt(np.mean(one**2))) for one in (before, after)))
