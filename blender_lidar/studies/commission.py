"""Commissioning: what recorded clouds of a LiDAR that hangs at a road say of its sensor, its mounting and its unit.

From one revolution, or from several of one mounting: then what each beam usually meets, the background, is taken, and
the spread of the single revolutions is told.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from ..errors import InputError
from ..run.comparison import Comparison
from ..run.vehicle_table import vehicle_tables
from ..scene.mounting import Layout, Mounting, hung_at
from ..scene.site import Site
from ..scoring.evaluation import site_evaluator
from ..sensors.beams import beam_directions
from ..sensors.identify import (
    Identified,
    Match,
    elevations,
    identify_sensor,
    lens_offset,
    nearest_ring,
    offsets_misfit,
)
from ..sensors.model import LidarModel, load_model, model_names
from .road_fit import Estimate, RoadFit, fit_road
from .road_surface import FEWEST_POINTS

_NO_METRES_M = 1500.0  # median range of a cloud that is not in metres
_HEIGHTS_M, _FAR_M = np.arange(0.5, 25.0, 0.1), 15.0  # of a sensor in a cloud that is in the road's frame
_NEAREST_M = 0.3  # of a return
_MOST_APART_M, _MOST_APART_DEG = 0.15, 0.7  # of clouds of one mounting
_OFF_TURN_RAD = math.radians(1.0)  # azimuths of columns so far from a table's are not of it
FEWEST_CLOUDS = 3  # of which a background is taken
_STILL_M, _STILL_BY_RANGE = 0.15, 0.005  # how far the ranges of a beam may differ if what it meets stands still
_HIGH_M, _FEWEST_HIGH, _MOVES = 4.5, 100, 0.25  # points above vehicles; least share of them that must stand still
_FLOOR_M, _MOST_ON_FLOOR = 0.1, 0.25  # of z; only one ring of a sensor is level
_BLIND_DEG, _GROUND_M = 4, 30.0
_STRAYS, _MISSING = 0.02, 40  # share of the usual returns that a blind sector may have; what must lack in it
_DEAD = 0.05  # of the returns of the rings beside it


@dataclass(frozen=True, slots=True, eq=False)
class Commissioned:
    """What clouds say.

    Attributes
    ----------
    match : Match
        The sensor, named by the cloud or given, and how well it explains the first cloud.
    as_possible : tuple of str
        Other models that would explain it as well.
    lens_m : float
        How far the optical centre lies off the axis, towards where the beams look [m].
    points : ndarray, (n, 3)
        The background, or the first cloud, in the sensor's frame [m].
    ring : ndarray of int, (n,)
    fit : RoadFit
        Of these points.
    each : tuple of RoadFit
        Of single clouds, where there are several.
    blind_deg : tuple of (float, float)
        Sectors of azimuth, clockwise from the sensor's +y, in which nothing returned though the road lies there.
    dead_rings : tuple of int
        Rings that return next to nothing though those beside them do.
    left_out : int
        Points of all clouds that were not finite, or nearer than any return.
    """

    match: Match
    as_possible: tuple[str, ...]
    lens_m: float
    points: np.ndarray
    ring: np.ndarray
    fit: RoadFit
    each: tuple[RoadFit, ...]
    blind_deg: tuple[tuple[float, float], ...]
    dead_rings: tuple[int, ...]
    left_out: int

    @property
    def model(self) -> LidarModel:
        """The sensor's model."""
        return self.match.model

    @property
    def unit_rad(self) -> np.ndarray:
        """Elevations of this unit's rings (r,) [rad]: as the cloud has them, corrected where they saw enough road.

        Drivers write points by the table of their unit, or by the model's; a ring without points has the model's.
        """
        found, seen = self.model.elevation_rad.copy(), elevations(self.points, self.lens_m)
        for ring in np.unique(self.ring):
            found[ring] = np.median(seen[self.ring == ring])
        return found - np.where(np.isfinite(self.fit.ring_sd_rad), self.fit.ring_error_rad, 0.0)


def commission(
    clouds: Sequence[np.ndarray],
    names: Sequence[str],
    given: LidarModel | None = None,
    grid: np.ndarray | None = None,
    facing: float | None = None,
    report: Callable[[], None] = lambda: None,
) -> Commissioned:
    """Sensor, mounting and unit of a LiDAR by its clouds.

    Parameters
    ----------
    clouds : sequence of ndarray, (n, 3)
        Of one mounting, in the sensor's frame: x right, y ahead, z up its axis [m].
    names : sequence of str
        Of the clouds, for messages.
    given : LidarModel, optional
        The sensor, where it is known.
    grid : ndarray, (columns, channels, 3), optional
        The first cloud, where it is organised; NaN where nothing returned.
    facing : float, optional
        The planned yaw [rad].
    report : callable
        Called after each cloud.

    Raises
    ------
    InputError
        Naming the cloud and what is wrong with it: too few points, other units, another frame, a mirrored axis, points
        of several sensors or mountings, or of one that moves, no road.
    """
    every, clouds = sum(map(len, clouds)), [_returns(points) for points in clouds]
    for name, points in zip(names, clouds, strict=True):
        _check_metres(name, points)
    match, as_possible = _sensor(names[0], clouds[0], given, grid)
    model = match.model
    lens_m = lens_offset(clouds[0], model)
    rings = [nearest_ring(elevations(points, lens_m), model.elevation_rad) for points in clouds]
    pooled, each = len(clouds) >= FEWEST_CLOUDS, []
    for name, points, ring in zip(names, clouds, rings, strict=True):
        if not identify_sensor(elevations(points), [model]).matches:
            raise InputError(f"{name}: its points are not on the rings of {model.name}, as those of {names[0]} are")
        single = partial(fit_road, errors=not (pooled or each))
        each.append(_named(name, single, points, ring, model.rings, facing))
        report()
    _check_alike(names, each)
    points, ring, fit = clouds[0], rings[0], each[0]
    if pooled:
        points, ring = _background(clouds, rings, model, each, names)
        fit = _named("the background", fit_road, points, ring, model.rings, facing, clouds)
    return Commissioned(
        match=match,
        as_possible=as_possible,
        lens_m=lens_m,
        points=points,
        ring=ring,
        fit=fit,
        each=tuple(each) if len(each) > 1 else (),
        blind_deg=_blind_sectors(np.concatenate(clouds), model, fit),
        dead_rings=_dead_rings(np.concatenate(rings), model.rings),
        left_out=every - sum(map(len, clouds)),
    )


def _returns(points: np.ndarray) -> np.ndarray:
    """The points that are returns: some drivers write the origin where nothing returned."""
    with np.errstate(invalid="ignore"):
        return points[np.linalg.norm(points, axis=1) > _NEAREST_M]


def _check_alike(names: Sequence[str], each: Sequence[RoadFit]) -> None:
    """Refuse clouds of several mountings."""
    heights, leans = [fit.height_m.value for fit in each], np.array([fit.pose.rotation[:, 2] for fit in each])
    apart = math.degrees(math.acos(min(1.0, float((leans @ leans.T).min()))))
    if np.ptp(heights) > _MOST_APART_M or apart > _MOST_APART_DEG:
        raise InputError(
            f"{names[0]} to {names[-1]}: hang {min(heights):.2f} to {max(heights):.2f} m above the road, and lean "
            f"{apart:.1f} degrees apart; allowed: clouds of one LiDAR that does not move"
        )


def _named(name: str, what: Callable, *given: object):
    """What a function gives; its errors name the cloud."""
    try:
        return what(*given)
    except InputError as error:
        raise InputError(f"{name}: {error}") from None


# --- The sensor -------------------------------------------------------------------------------------------------------


def _check_metres(name: str, points: np.ndarray) -> None:
    if len(points) < FEWEST_POINTS:
        raise InputError(f"{name}: {len(points)} points; allowed: {FEWEST_POINTS} or more")
    usual = float(np.median(np.linalg.norm(points, axis=1)))
    if usual > _NO_METRES_M:
        raise InputError(
            f"{name}: half of its points are farther than {usual:,.0f}; allowed: metres (are these millimetres?)"
        )
    if usual < 0.5:
        raise InputError(f"{name}: half of its points are nearer than {usual:.3g}; allowed: metres")


def _sensor(
    name: str, points: np.ndarray, given: LidarModel | None, grid: np.ndarray | None
) -> tuple[Match, tuple[str, ...]]:
    """The sensor of a cloud, and which others it may be as well."""
    if given is not None and given.rings < 2:
        raise InputError(f"--sensor: {given.name} has one ring; allowed: two or more")
    on_floor = float((np.abs(points[:, 2]) < _FLOOR_M).mean())
    if on_floor > _MOST_ON_FLOOR:
        raise InputError(
            f"{name}: is in the road's frame: {100.0 * on_floor:.0f} % of its points lie at z = 0; allowed: the "
            f"sensor's own frame{_hung_at(points)}"
        )
    models = [load_model(one) for one in model_names()]
    identified = identify_sensor(elevations(points), models + [given] * (given not in (None, *models)))
    matches = identified.matches
    if not matches:
        raise InputError(f"{name}: {_why_none(points, identified)}")
    if given is not None:
        matches = tuple(one for one in matches if one.model.name == given.name)
        if not matches:
            raise InputError(
                f"{name}: its points are on the rings of {identified.matches[0].model.name}, not on those of "
                f"{given.name}; allowed: a cloud of that sensor in its own frame"
            )
    if grid is not None:
        matches = _by_columns(name, matches, grid)
    others = (one.model.name for one in identified.matches if given is not None or one in matches)
    return matches[0], tuple(one for one in others if one != matches[0].model.name)


def _by_columns(name: str, matches: Sequence, grid: np.ndarray) -> tuple:
    """The matches whose number of rings and azimuth offsets fit an organised cloud, the best first."""
    channels = grid.shape[1]
    counted = [one for one in matches if one.model.rings == channels] or list(matches)
    apart = [offsets_misfit(grid, one.model) for one in counted]
    other = [offsets_misfit(grid, one.model, mirrored=True) for one in counted]
    if min(other) < min(0.5 * min(apart), _OFF_TURN_RAD) and min(apart) > _OFF_TURN_RAD:
        raise InputError(
            f"{name}: its columns turn against the azimuth offsets of {counted[int(np.argmin(other))].model.name}; "
            "allowed: a right-handed frame (is x or y mirrored?)"
        )
    fitting = [one for one, off in zip(counted, apart, strict=True) if off <= _OFF_TURN_RAD]
    return tuple(fitting or counted)


def _why_none(points: np.ndarray, identified: Identified) -> str:
    """Why no table explains a cloud, as far as it shows."""
    nearest = identified.nearest
    if turned := identify_sensor(-elevations(points)).matches:
        name = turned[0].model.name
        return f"is upside down: with z turned its points are on the rings of {name}; allowed: z up the sensor's axis"
    if at := _hung_at(points):
        return f"is in the road's frame; allowed: the sensor's own frame{at}"
    if nearest.on_rings > 0.4:
        return (
            f"{100.0 * nearest.on_rings:.0f} % of its points are on the rings of the nearest table, "
            f"{nearest.model.name}, and the rest on none (points of a second sensor, or of one that moves?); allowed: "
            "one revolution in its sensor's own frame"
        )
    return (
        "its elevations are on no rings; allowed: one revolution in its sensor's own frame, of a sensor that the verb "
        "sensors lists or --sensor FILE (is it in the road's frame, filtered by voxels, or of a moving sensor?)"
    )


def _hung_at(points: np.ndarray) -> str:
    """The height about which points of the road's frame are on the rings of a sensor that hangs level, in words."""
    far = points[np.hypot(points[:, 0], points[:, 1]) > _FAR_M]  # where a few centimetres of height turn nothing
    some = far[np.random.default_rng(0).permutation(len(far))[:800]]
    if len(some) < FEWEST_POINTS:
        return ""
    found = [
        (one.likelihood, one.model.name, up)
        for up in _HEIGHTS_M
        for one in identify_sensor(elevations(some - [0.0, 0.0, up]), units=False).matches[:1]
    ]
    if not found:
        return ""
    _, name, up = max(found)
    return f", or its place: seen from {up:.1f} m up its points are on the rings of {name} (--origin 0 0 {up:.1f})"


# --- The background ---------------------------------------------------------------------------------------------------


def _background(
    clouds: Sequence[np.ndarray],
    rings: Sequence[np.ndarray],
    model: LidarModel,
    each: Sequence[RoadFit],
    names: Sequence[str],
) -> tuple[np.ndarray, np.ndarray]:
    """What stands still, (n, 3) and rings (n,): by beam the point of the median range, where most agree."""
    columns, every = model.columns(), np.concatenate(clouds)
    index = np.full((len(clouds), model.rings * columns), -1)
    start = np.cumsum([0, *map(len, clouds)])
    for row, (points, ring) in enumerate(zip(clouds, rings, strict=True)):
        column = np.floor(np.arctan2(points[:, 0], points[:, 1]) / (2.0 * math.pi) * columns).astype(int) % columns
        index[row, ring * columns + column] = np.arange(start[row], start[row + 1])
    often = np.flatnonzero((index >= 0).sum(axis=0) > 0.5 * len(clouds))
    index = index[:, often]
    ranges = np.where(index >= 0, np.linalg.norm(every, axis=1)[index], np.nan)
    middle = np.nanmedian(ranges, axis=0)
    off = np.abs(ranges - middle)
    still = (off < _STILL_M + _STILL_BY_RANGE * middle).sum(axis=0) > 0.5 * len(clouds)
    points = every[index[np.nanargmin(off, axis=0), np.arange(len(often))]]
    high = each[0].pose.to_world(points)[:, 2] + each[0].pose.height_m > _HIGH_M
    share = float(still[high].mean()) if high.sum() >= _FEWEST_HIGH else 1.0
    if share < _MOVES:
        raise InputError(
            f"{names[0]} to {names[-1]}: {100.0 * share:.0f} % of what lies more than {_HIGH_M:g} m above the road "
            "stands still from cloud to cloud; allowed: clouds of a LiDAR that does not move"
        )
    return points[still], often[still] // columns


# --- What the sensor does not see -------------------------------------------------------------------------------------


def _blind_sectors(points: np.ndarray, model: LidarModel, fit: RoadFit) -> tuple[tuple[float, float], ...]:
    """Sectors without a return, though beams there would meet the road nearby [degrees clockwise from +y]."""
    way = beam_directions(np.radians(np.arange(360) + 0.5), model.elevation_rad[:, None])
    down = -(way @ fit.pose.rotation)[..., 2]
    meets = ((down > 0.0) & (fit.pose.height_m < _GROUND_M * down)).sum(axis=0) >= 2
    bearing = np.degrees(np.arctan2(points[:, 0], points[:, 1])) % 360.0
    count = np.bincount(bearing.astype(int) % 360, minlength=360)
    usual = float(np.median(count[meets])) if meets.any() else 0.0
    empty = (count < _STRAYS * usual) & meets
    if empty.all() or not empty.any() or _BLIND_DEG * usual < _MISSING:
        return ()
    first = int(np.flatnonzero(~empty)[0])
    edges = np.flatnonzero(np.diff(np.append(np.roll(empty, -first), False).astype(int)))
    sectors = [(int(a) + 1 + first, int(b) + 1 + first) for a, b in zip(edges[::2], edges[1::2], strict=True)]
    return tuple((float(a % 360), float((b - 1) % 360 + 1)) for a, b in sectors if b - a >= _BLIND_DEG)


def _dead_rings(ring: np.ndarray, rings: int) -> tuple[int, ...]:
    """Rings with next to no returns between two that have many, to which they did not go: beams of units may cross.

    Not the three lowest and highest, nor two that are neighbours.
    """
    count = np.bincount(ring, minlength=rings).astype(float)
    found = []
    for one in range(3, rings - 3):
        around = np.median(count[one + np.array([-3, -2, 2, 3])])
        beside = count[[one - 1, one + 1]]
        if count[one] < _DEAD * beside.min() and beside.min() >= 100 and beside.sum() < 2.3 * around:
            found.append(one)
    return tuple(found)


# --- Against the plan -------------------------------------------------------------------------------------------------


def hung_mounting(site: Site, planned: Mounting, fit: RoadFit) -> Mounting:
    """The mounting that a fit says, at the place of the planned one; with the planned yaw where none was seen."""
    plan, road = planned.pose, site.scenario.road_map
    level = float(road.surface.height(np.array([plan.x_m, plan.y_m])))
    yaw = plan.yaw if fit.yaw is None else fit.yaw.value
    pose = replace(fit.pose, x_m=plan.x_m, y_m=plan.y_m, height_m=level + fit.pose.height_m, yaw=yaw)
    return hung_at(pose, road, planned.mast.facing_rad)


def against_plan(site: Site, layout: Layout, number: int, fit: RoadFit, *, searched: bool = False) -> dict:
    """How a LiDAR hangs beside its plan, and what that costs.

    Parameters
    ----------
    site : Site
    layout : Layout
        The planned mountings.
    number : int
        Of the LiDAR among them.
    fit : RoadFit
        With the planned yaw as its `facing`.
    searched : bool
        Whether a search chose the plan on the searched frames, which then say no interval.

    Returns
    -------
    dict
        ``planned`` and ``measured`` mountings as tables; ``differences`` of the coordinates that were measured, each
        with ``value`` and ``interval_90`` [m, degrees]; the ``falls`` of the sensor's base towards zero azimuth and a
        quarter turn clockwise from it, planned and measured [degrees]; ``detectable_share`` of both, on held-out
        traffic where there is any, with ``gain`` and ``interval_90`` of the measured over the planned.
    """
    planned = layout[number]
    hangs = hung_mounting(site, planned, fit)
    tables, measured = [one.as_table() for one in (planned, hangs)], _measured(fit)
    differences = {}
    for key, (one, unit) in measured.items():
        off = math.remainder(tables[1][key] - tables[0][key], 360.0) if unit != 1.0 else tables[1][key] - tables[0][key]
        half = 0.5 * unit * (one.interval_90[1] - one.interval_90[0])
        differences[key] = {"value": off, "interval_90": [off - half, off + half]}
    up = np.array(planned.mast.up)
    falls = [
        [-math.degrees(math.asin(axis @ up)) for axis in one.pose.to_world(np.eye(3))[[1, 0]]]
        for one in (planned, hangs)
    ]
    others = [*layout]
    others[number] = hangs
    with site_evaluator(site, site.search, site.holdout) as evaluator:
        split, judging = evaluator.judging
        tables_of = vehicle_tables([layout, tuple(others)], **{split: judging})
    seed = site.scenario.search.seed if split == "holdout" or not searched else None
    boxes = Comparison.of_split(*tables_of, split, site, seed)
    shares = boxes.shares()
    return {
        "planned": tables[0],
        "measured": tables[1],
        "differences": differences,
        "falls_deg": {"planned": falls[0], "measured": falls[1]},
        "detectable_share": {
            "planned": shares["before"],
            "measured": shares["after"],
            "gain": shares["gain"],
            "interval_90": shares["gain_interval_90"],
            "held_out": split == "holdout",
            "blocks": boxes.blocks,
        },
    }


def _measured(fit: RoadFit) -> dict[str, tuple[Estimate, float]]:
    """What a fit measures, by the coordinates of a mounting, and the factor of each to their units."""
    degrees = math.degrees(1.0)
    found = {"height_m": (fit.height_m, 1.0), "tilt_x_deg": (fit.tilt_x, degrees), "tilt_y_deg": (fit.tilt_y, degrees)}
    return found if fit.yaw is None else {**found, "yaw_deg": (fit.yaw, degrees)}


def result_of(found: Commissioned, axes: str, origin_m: Sequence[float], plan: Mapping | None) -> dict:
    """What clouds said, for a result file; lengths in metres and angles in degrees, as the keys say."""
    fit = found.fit
    mounting = {}
    for key, (one, unit) in _measured(fit).items():
        ends = [unit * end for end in one.interval_90]
        mounting[key] = {"value": unit * one.value, "interval_90": ends, "systematic": unit * one.systematic}
        if found.each:
            every = [unit * _measured(other)[key][0].value for other in found.each if key in _measured(other)]
            mounting[key]["sd_of_clouds"] = float(np.std(every, ddof=1)) if len(every) > 1 else None
    check, bias = fit.ring_check, fit.range_error_m
    return {
        "sensor": found.model.name,
        "as_possible": list(found.as_possible),
        "on_rings": found.match.on_rings,
        "left_out": found.left_out,
        "axes": axes,
        "origin_m": list(origin_m),
        "pose": fit.pose.as_table(),
        "mounting": mounting,
        "direction_from": fit.direction_from,
        "carriageways": [
            {"y_m": list(one.y_m), "cross_fall_percent": 100.0 * one.slope, "above_m": one.above_m}
            for one in fit.carriageways
        ],
        "road_residual_m": fit.residual_m,
        "range_error_m": {"value": bias.value, "interval_90": list(bias.interval_90)},
        "lens_m": found.lens_m,
        "blind_sectors_deg": [list(one) for one in found.blind_deg],
        "dead_rings": list(found.dead_rings),
        "unit": {
            "rings": int(np.isfinite(fit.ring_sd_rad).sum()),
            "learnt_and_judged_on": check.halves,
            "off_before_deg": check.before_rad and math.degrees(check.before_rad),
            "off_after_deg": check.after_rad and math.degrees(check.after_rad),
        },
        "points": len(found.points),
        **({"plan": plan} if plan else {}),
    }
