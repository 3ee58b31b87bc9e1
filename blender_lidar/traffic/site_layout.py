"""Proposing a site on a map, or on the driven area: the busiest junction, or the stretch about a place."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..errors import InputError
from ..road.approaches import approaches_to, check_driven, junction_named
from ..road.driven import DrivenArea, driven_area
from ..road.pole_places import PolePlace, propose_poles
from ..road.road_map import Junction, RoadMap, polygon_holds
from ..road.settings import RoadSettings, map_of
from .motion import Samples, thinning
from .movements import ways_by_map, ways_by_track
from .vehicles import Recording, counted

APPROACH_M = 40.0
RADIUS_M = 40.0  # of the region where no junction is known
_ARMS_M = 30.0  # from the middle of a junction, where its arms are told apart
_MIDDLE_M = 12.0  # from it, within which no arm can be told
_ARM_RAD = math.radians(45.0)  # between two arms at least
_FEWEST_ON_AN_ARM, _LEAST_SHARE = 5, 0.04  # vehicles
_LEAST_SPREAD = 0.1  # circular dispersion where ways meet; below 0.01 on a motorway
_CELL_M = 10.0
_NEAR_M = 50.0  # from --at to a junction that is meant by it
_TOLD = 4  # other junctions


@dataclass(frozen=True, slots=True, eq=False)
class SiteLayout:
    """A site on a map as a scene has it.

    Attributes
    ----------
    settings : RoadSettings
        [road]; its origin is the middle of the site, in whole metres of the map's frame.
    road : RoadMap
        In the site frame.
    recording : Recording
        In the site frame.
    junction : Junction or None
        Where vehicles count; None where the map has none there.
    middle_xy : (float, float)
        The middle of the region [m, site frame].
    radius_m : float
        Of the region about it [m].
    poles : list of PolePlace
        The nearest to the middle first.
    vehicles : int
        Different ones that cross the junction, or come within the radius.
    approaches : tuple of str
        Roads that lead to the junction; none without a junction of a map.
    movement : ndarray of str, (n,)
        That of the vehicle of each box, "" for none.
    notes : tuple of str
        What else there is, and what to check, as sentences.
    """

    settings: RoadSettings
    road: RoadMap
    recording: Recording
    junction: Junction | None
    middle_xy: tuple[float, float]
    radius_m: float
    poles: list[PolePlace]
    vehicles: int
    approaches: tuple[str, ...]
    movement: np.ndarray
    notes: tuple[str, ...]


def propose_site(
    recording: Recording,
    settings: RoadSettings,
    junction: str | None = None,
    at: tuple[float, float] | None = None,
) -> SiteLayout:
    """The busiest junction of a map, or of the traffic alone, with its approaches and places for poles.

    Parameters
    ----------
    recording : Recording
        In the map's frame [m].
    settings : RoadSettings
        Which map, with its origin at 0.
    junction : str, optional
        The junction to take, by the map's name.
    at : (float, float), optional
        The place to take, in the map's frame [m]: the junction about it, or the stretch where there is none.

    Raises
    ------
    BlenderLidarError
        When the map cannot be read, when traffic and map lie apart, when nobody drives there, or when there is no room
        for a pole.
    """
    whole = None if settings.driven else map_of(settings)
    if whole is not None:
        _check_together(recording, whole, settings)
    found, notes = _found(recording, whole, junction, at)
    middle = np.asarray(at, dtype=float) if found is None and at is not None else _middle(recording, whole, found)
    origin = np.round(middle)
    settings = replace(settings, origin_m=tuple(origin.tolist()))
    recording = _moved(recording, origin)
    middle_xy = tuple(np.round(middle - origin, 1).tolist())
    away = np.hypot(*(recording.centre_m[:, :2] - middle_xy).T)
    if whole is None:
        road = _driven_near(recording, away)
        notes.append("without a map, ground that nobody drove on may be road: check each pole")
        moved = None
    else:
        road = map_of(settings)
        moved = None if found is None else junction_named(road, found.name, "--junction")
    radius = RADIUS_M
    if moved is not None:
        radius = APPROACH_M + float(np.hypot(*(moved.outline_m - middle_xy).T).max())
        inside = polygon_holds(moved.outline_m, recording.centre_m[:, :2])
        ways = ways_by_map(recording, road, [moved.name])
    else:
        inside, ways = away <= radius, ways_by_track(recording, middle_xy)
    crosses = moved is not None or whole is None
    poles = propose_poles(road, middle_xy, radius, "corner" if crosses else "roadside")
    if not poles:
        raise InputError(
            f"{recording.source}: no room for a pole off the lanes within {radius:.0f} m of the site's middle"
        )
    return SiteLayout(
        settings=settings,
        road=road,
        recording=recording,
        junction=moved,
        middle_xy=middle_xy,
        radius_m=radius,
        poles=poles,
        vehicles=len(np.unique(recording.vehicle_id[inside])),
        approaches=tuple(approaches_to(road, [moved.name])) if moved is not None else (),
        movement=np.array([ways.get(number, ("", "", ""))[2] for number in recording.vehicle_id.tolist()]),
        notes=tuple(notes),
    )


def is_crossing(recording: Recording) -> bool:
    """Whether the traffic alone shows a junction: three arms or more about the place where most ways meet."""
    place = _meeting_place(recording)
    return place is not None and _arms(recording, place) >= 3


def _moved(recording: Recording, origin: np.ndarray) -> Recording:
    """The same with its frame's origin elsewhere [m]."""
    off, report = np.array([*origin, 0.0]), recording.report
    report = replace(report, ground=report.ground - off)
    return replace(recording, centre_m=recording.centre_m - off, report=report)


def _thinned(recording: Recording) -> Recording:
    return recording.select(thinning(len(recording)))


def _check_together(recording: Recording, road: RoadMap, settings: RoadSettings) -> None:
    """Refuse traffic that lies beside the map: in another projection, or without its offset."""
    xy = _thinned(recording).centre_m[:, :2]
    if road.on(xy[:: max(1, len(xy) // 2000)]).mean() >= 0.5:
        return
    corners = np.concatenate([*road.points_m])
    apart = np.median(xy, axis=0) - 0.5 * (corners.min(axis=0) + corners.max(axis=0))
    hint = ""
    if settings.net:
        from ..road.sumo_net import net_location

        offset = net_location(settings.net)[0]
        hint = f"; the net's netOffset is {offset[0]:.2f},{offset[1]:.2f}, which traffic in its projection lacks"
    raise InputError(
        f"{recording.source}: less than half of the boxes lie on the roads of {settings.path}: the middles of both are "
        f"x {apart[0]:.0f}, y {apart[1]:.0f} m apart{hint}; allowed: traffic in the map's own metres"
    )


def _found(
    recording: Recording, road: RoadMap | None, name: str | None, at: tuple[float, float] | None
) -> tuple[Junction | None, list[str]]:
    """The junction that is asked for, or the busiest, and what to say of the others."""
    if road is None:
        if name is not None:
            raise InputError(
                f"--junction: is {name!r}, but there is no map; allowed: with --net or --road, or --at X,Y"
            )
        return None, []
    xy = recording.centre_m[:, :2]
    if name is not None:
        found = junction_named(road, name, "--junction")
        check_driven(road, found, xy, "--junction")
        return found, []
    if at is not None:
        gaps = [(float(np.hypot(*(_middle_of(one) - at))), one) for one in road.junctions]
        away, found = min(gaps, key=lambda one: one[0], default=(math.inf, None))
        if found is not None and (away <= _NEAR_M or polygon_holds(found.outline_m, np.array([at]))[0]):
            check_driven(road, found, xy, "--at")
            return found, []
        _check_near(xy, at)
        return None, [f"no junction of the map lies within {_NEAR_M:g} m of {at[0]:g},{at[1]:g}: the stretch is taken"]
    part = _thinned(recording)
    counts = {one.name: _crossing(part, one) for one in road.junctions}
    ranked = sorted(road.junctions, key=lambda one: (-(len(approaches_to(road, [one.name])) > 1), -counts[one.name]))
    ranked = [one for one in ranked if counts[one.name]]
    if not ranked:
        return None, ["no vehicle crosses a junction of the map: the busiest stretch is taken"]
    others = [f"{one.name} ({counted(counts[one.name], 'vehicle')})" for one in ranked[1 : 1 + _TOLD]]
    told = f"other junctions, for --junction: {', '.join(others)}"
    return ranked[0], [told] if others else []


def _crossing(recording: Recording, junction: Junction) -> int:
    """How many different vehicles have a box centre in a junction."""
    xy, (low, high) = recording.centre_m[:, :2], (junction.outline_m.min(axis=0), junction.outline_m.max(axis=0))
    near = np.flatnonzero(((xy >= low) & (xy <= high)).all(axis=1))
    return len(np.unique(recording.vehicle_id[near[polygon_holds(junction.outline_m, xy[near])]]))


def _check_near(xy: np.ndarray, at: Sequence[float]) -> None:
    away = float(np.hypot(*(xy - at).T).min())
    if away > RADIUS_M:
        raise InputError(
            f"--at: is {at[0]:g},{at[1]:g}; the nearest vehicle is {away:.0f} m away; allowed: where they drive"
        )


def _middle_of(junction: Junction) -> np.ndarray:
    return 0.5 * (junction.outline_m.min(axis=0) + junction.outline_m.max(axis=0))


def _middle(recording: Recording, road: RoadMap | None, junction: Junction | None) -> np.ndarray:
    """The middle of a junction, else of where ways meet, else of where most is driven, (2,) [m]."""
    if junction is not None:
        return _middle_of(junction)
    place = _meeting_place(recording) if road is None else None
    if place is not None:
        return place
    xy = _thinned(recording).centre_m[:, :2]
    return _busiest_cell(xy)


def _driven_near(recording: Recording, away: np.ndarray) -> DrivenArea:
    road = driven_area(recording.centre_m, recording.size_m, recording.heading_rad)
    if road is None:
        raise InputError(
            f"{recording.source}: vehicles drive kilometres apart; allowed: recordings of one site, or a map"
        )
    if away.min() > RADIUS_M:
        raise InputError(f"--at: the nearest vehicle is {away.min():.0f} m away; allowed: a place where they drive")
    return road


# --- Junctions that no map shows --------------------------------------------------------------------------------------


def _meeting_place(recording: Recording) -> np.ndarray | None:
    """Where ways of different directions meet most, (2,) [m]: the circular dispersion of doubled headings, times flow.

    None where nothing moves, or all along one road.
    """
    try:
        samples = Samples.of(recording)
    except InputError:
        return None
    samples = samples.select(samples.speed > 0.0).thinned()
    double = np.exp(2j * samples.heading_rad)
    cells, row = np.unique(np.floor(samples.xy / _CELL_M).astype(int), axis=0, return_inverse=True)
    row = row.reshape(-1)
    weight = np.bincount(row, samples.speed)
    turn = np.bincount(row, samples.speed * double.real) + 1j * np.bincount(row, samples.speed * double.imag)
    index = {tuple(cell): at for at, cell in enumerate(cells.tolist())}
    around = [(right, up) for right in (-1, 0, 1) for up in (-1, 0, 1)]
    best, found = 0.0, None
    for x, y in index:
        rows = [index[x + right, y + up] for right, up in around if (x + right, y + up) in index]
        flow = float(weight[rows].sum())
        spread = flow - float(abs(turn[rows].sum()))
        if spread > max(best, _LEAST_SPREAD * flow):
            best, found = spread, np.array([x + 0.5, y + 0.5]) * _CELL_M
    return found


def _arms(recording: Recording, place: np.ndarray) -> int:
    """On how many arms vehicles come to a place or leave it: peaks of a circular histogram of where they are seen first
    and last about it.
    """
    from scipy import ndimage, signal

    order = np.lexsort((recording.frame, recording.vehicle_id))
    xy, vehicle = recording.centre_m[order, :2] - place, recording.vehicle_id[order]
    away = np.hypot(*xy.T)
    near = away <= _ARMS_M
    xy, vehicle, away = xy[near], vehicle[near], away[near]
    changes = np.diff(vehicle) != 0
    first, last = np.concatenate([[True], changes]), np.concatenate([changes, [True]])
    ends = xy[(first | last) & (away >= _MIDDLE_M)]
    if not len(ends):
        return 0
    turn = np.degrees(np.arctan2(ends[:, 1], ends[:, 0])) % 360.0
    counts = np.histogram(turn, 72, (0.0, 360.0))[0]
    around = np.tile(ndimage.convolve1d(counts, np.ones(5, int), mode="wrap"), 3)
    least = max(_FEWEST_ON_AN_ARM, _LEAST_SHARE * len(ends))
    peaks = signal.find_peaks(around, height=least, distance=round(math.degrees(_ARM_RAD) / 5.0))[0]
    return int(((peaks >= 72) & (peaks < 144)).sum())


def _busiest_cell(xy: np.ndarray) -> np.ndarray:
    """The middle of the cell of 10 m in which most lie, (2,) [m]."""
    cells, row = np.unique(np.floor(xy / _CELL_M).astype(int), axis=0, return_inverse=True)
    return (cells[np.bincount(row.reshape(-1)).argmax()] + 0.5) * _CELL_M
