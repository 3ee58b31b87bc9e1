"""The road's surface under a LiDAR: z = a s + f(t) along (s) and across (t) it, f piecewise linear.

Carriageways, both sides of a crown and the verge have planes of their own. The surface is fitted by iteratively
reweighted least squares, together with errors of the sensor: of all ranges, and of each ring's elevation. Standard
errors are those of the delete-one jackknife over sectors and groups of rings.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ..errors import InputError

FEWEST_POINTS = 500
JACKKNIFE_SECTORS = 12
RING_SD_RAD = math.radians(0.02)
"""Standard deviation of the errors of rings beforehand: what is not smaller afterwards was not learnt."""
_RANGE_SD_M, _BEND_SD = 0.01, 1e-4  # the same of the error of all ranges, and of half the curvature along the road
_INDEPENDENT = 400  # as many points count: an uneven road moves neighbours alike
_MOST_BREAKS, _APART_M, _WORTH = 4, 2.0, 0.03  # of f; how much of the section a break must explain
_BIN_M, _LEVEL_M, _FEWEST_OF_STRIP = 0.5, 0.06, 15  # of the section
_FINE_M, _ROUGH_M = 0.005, 0.03  # of the section about its pieces
_BESIDE_M = 10.0  # what vehicles drive on, as far as the section is looked at
_WITHOUT_TRAFFIC = -20.0, 20.0  # what is looked at where no vehicles are [m]
_STEEPEST_FALL = 0.12  # between two strips of one road: what slopes more is beside it
_UNDER_M = 2.0  # about y = 0, where the height is
_RING_GROUPS = 8
_ROUNDS = 8  # of weighted least squares


class RoadPoints(NamedTuple):
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

    def pick(self, rows: np.ndarray) -> RoadPoints:
        """Some of the points."""
        return RoadPoints(*(column[rows] for column in self))


class RoadFrame(NamedTuple):
    """The level under the LiDAR [m], and the slopes along and across the road."""

    level: float
    along: float
    across: float


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
class SurfaceFit:
    """A fitted road.

    Attributes
    ----------
    strips : list of (float, float)
        Of smooth road that vehicles drive on, y from the right [m].
    frame, errors, doubt : RoadFrame
        Of the road; their standard errors, and what they are in doubt by besides, for what is not seen of the road.
    levels : list of (float, float)
        Of the surface at the ends of each strip [m].
    range_error_m : (float, float)
        By which all ranges seem too long, and its standard error [m].
    ring_error_rad, ring_sd_rad : ndarray, (r,)
        By which each ring's elevation seems too high, and its standard error [rad].
    level_sd_m : float
        Standard error of the level by the fit alone [m].
    ground : ndarray of bool, (n,)
        Which points lie on the surface.
    residual_m : float
        Median distance of these from it.
    ring_check : RingCheck
    """

    strips: list[tuple[float, float]]
    frame: RoadFrame
    errors: RoadFrame | None
    doubt: RoadFrame
    levels: list[tuple[float, float]]
    range_error_m: tuple[float, float]
    ring_error_rad: np.ndarray
    ring_sd_rad: np.ndarray
    level_sd_m: float
    ground: np.ndarray
    residual_m: float
    ring_check: RingCheck | None


def fit_surface(
    ground: RoadPoints, rings: int, driven: tuple[float, float] | None, *, errors: bool = True
) -> SurfaceFit:
    """The road's surface among points near it, of a sensor with so many rings.

    `driven` is from where to where across the road vehicles are seen [m], None without any; `errors` and the check of
    the rings take most of the time.

    The jackknife adds two whole estimates of one variance, which is too much; it holds direction, bends and strips,
    which is too little. The halves of the ring check share the choice of the points.

    Raises
    ------
    InputError
        Where no strip of road is seen.
    """
    known, driven = driven is not None, driven or _WITHOUT_TRAFFIC
    span = math.floor(min(driven[0], 0.0) - _BESIDE_M), math.ceil(max(driven[1], 0.0) + _BESIDE_M)
    profile = _profile(ground, span)
    breaks = _breaks(profile)
    section = _section(*profile, breaks)[1]
    residual = ground.z - _bent(ground.t, breaks) @ section
    strips = _strips(ground, residual, span, driven)
    if not strips:
        raise InputError("no strip of road 3 m wide is seen")
    fall = _slopes(section, breaks, strips)
    widest = fall[int(np.argmax(np.ptp(strips, axis=1)))]
    strips = [one for one, slope in zip(strips, fall, strict=True) if abs(slope - widest) <= _STEEPEST_FALL]
    # What lies beside the road has slopes of its own.
    kept = (np.abs(ground.t) < _UNDER_M) | np.any([(ground.t >= a) & (ground.t <= b) for a, b in strips], axis=0)
    beyond = _slopes(section, breaks, _planes(breaks, _strips(ground, residual, span, span if known else driven)))
    breaks, part = _breaks_within(breaks, strips), ground.pick(kept)
    solved = _surface(part, breaks, rings, residual[kept])
    on = solved.weight > 0.0
    posterior = np.sqrt(np.diag(solved.covariance))
    lies = np.zeros(len(kept), dtype=bool)
    lies[np.flatnonzero(kept)[on]] = True
    return SurfaceFit(
        strips=strips,
        frame=_frame(solved, breaks, strips)[0],
        errors=_jackknife(part, breaks, strips, rings, solved.residual) if errors else None,
        doubt=_doubt(solved, breaks, strips, beyond, known),
        levels=[tuple(_height_across(solved.x, breaks, np.array(strip)).tolist()) for strip in strips],
        range_error_m=(float(solved.x[-1]), float(posterior[-1])),
        ring_error_rad=solved.ring_error,
        ring_sd_rad=solved.ring_sd,
        level_sd_m=float(posterior[0]),
        ground=lies,
        residual_m=float(np.median(np.abs(solved.residual[on]))),
        ring_check=_ring_check(part.pick(on), breaks, strips, rings, solved.residual[on]) if errors else None,
    )


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
    ground: RoadPoints,
    breaks: Sequence[float],
    rings: int,
    residual: np.ndarray,
    ring_sd: float = RING_SD_RAD,
) -> _Solved:
    """Least squares with Tukey's weights: the surface, with normal priors for the sensor's errors.

    It begins with the residuals (n,) of another fit.
    """
    design = np.column_stack([_bent(ground.t, breaks), ground.s, ground.s**2, ground.by_range])
    prior = np.full(design.shape[1], 1e-9)
    prior[-2:] = 1.0 / _BEND_SD**2, 1.0 / _RANGE_SD_M**2
    for turn in range(_ROUNDS):
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


def _profile(ground: RoadPoints, span: tuple[float, float]) -> tuple[np.ndarray, ...]:
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
    ground: RoadPoints,
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
        if min(last, high) - max(first, low) < _NARROWEST_M:
            continue
        if (np.abs(walls - first) <= _AT_BARRIER_M).any():
            low = first
        if (np.abs(walls - last) <= _AT_BARRIER_M).any():
            high = last
        first, last = max(first, low), min(last, high)
        if last - first >= _NARROWEST_M:
            found.append((float(first), float(last)))
    return found


def _slopes(x: np.ndarray, breaks: Sequence[float], planes: Sequence[tuple[float, float]]) -> np.ndarray:
    """Slopes across the road of planes (p,)."""
    low, high = np.array(planes).T
    return (_height_across(x, breaks, high) - _height_across(x, breaks, low)) / (high - low)


def _frame(
    solved: _Solved, breaks: Sequence[float], strips: Sequence[tuple[float, float]]
) -> tuple[RoadFrame, float, float]:
    """The road's frame by a fitted surface, the doubt in its slope across, and how far two levels are apart [m].

    The slope across is the mean of both sides of the crown, the bend at which the surface turns down most, whatever is
    seen of each. It may be no crown: a quarter of what that and the mean over the width differ by is in doubt, and half
    of what planes of one side differ by. Where the LiDAR stands between two carriageways, the level is the mean of both
    prolonged.
    """
    planes = _planes(breaks, strips)
    low, high = np.array(planes).T
    widths, slopes = high - low, _slopes(solved.x, breaks, planes)
    whole = across = float(widths @ slopes / widths.sum())
    uneven = 0.0
    if len(planes) > 1:
        crown = int(np.argmax(slopes[:-1] - slopes[1:])) + 1
        sides = slice(crown), slice(crown, None)
        across = 0.5 * sum(float(widths[of] @ slopes[of] / widths[of].sum()) for of in sides)
        uneven = max(float(np.ptp(slopes[of])) for of in sides)
    level, apart = float(_height_across(solved.x, breaks, 0.0)), 0.0
    right, left = np.flatnonzero(high <= 0.0), np.flatnonzero(low >= 0.0)
    if len(right) and len(left):  # in a median
        edges = (high[right[-1]], slopes[right[-1]]), (low[left[0]], slopes[left[0]])
        one, other = (float(_height_across(solved.x, breaks, at) - slope * at) for at, slope in edges)
        level, apart = 0.5 * (one + other), abs(one - other)
    return RoadFrame(level, float(solved.x[-3]), across), max(0.25 * abs(across - whole), 0.5 * uneven), apart


def _doubt(
    solved: _Solved,
    breaks: Sequence[float],
    strips: Sequence[tuple[float, float]],
    beyond: np.ndarray,
    known: bool,
) -> RoadFrame:
    """What is in doubt of the road's frame: half of what two prolonged levels are apart, and the slope across.

    Where no crown is seen between vehicles, or no vehicles are `known`, it may lie elsewhere: half of the most by which
    another plane of the section slopes otherwise; their slopes are `beyond` (p,).
    """
    frame, across, apart = _frame(solved, breaks, strips)
    if not known or len(_planes(breaks, strips)) == 1:
        across = max(across, 0.5 * float(np.abs(beyond - frame.across).max()))
    return RoadFrame(0.5 * apart, 0.0, across)


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


def _jackknife(ground: RoadPoints, breaks, strips, rings: int, residual: np.ndarray) -> RoadFrame:
    """Standard errors of the road's frame, over sectors and over groups of rings."""
    total = np.zeros(3)
    for group, number in ((ground.sector, JACKKNIFE_SECTORS), (ground.ring % _RING_GROUPS, _RING_GROUPS)):
        parts = [
            _frame(_surface(ground.pick(group != one), breaks, rings, residual[group != one]), breaks, strips)[0]
            for one in range(number)
            if (group == one).any()
        ]
        parts = np.array(parts)
        total += (len(parts) - 1) / len(parts) * ((parts - parts.mean(axis=0)) ** 2).sum(axis=0)
    return RoadFrame(*np.sqrt(total).tolist())


_FEWEST_OF_RING, _FEWEST_RINGS = 20, 8


def _ring_check(
    ground: RoadPoints, breaks: Sequence[float], strips: Sequence[tuple[float, float]], rings: int, residual: np.ndarray
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
