"""Where vehicles are on the road: what `plausibility.CHECKS` asks of places, directions, lanes, overlaps and grades."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ..errors import InputError
from ..names import SIDES
from ..road.road_map import wrap_angle
from ..traffic.lanes import FEWEST_ON_A_ROAD, USUAL_LANE_M, density_peaks
from ..traffic.vehicles import Recording, frames_looked_at, overlapping_pairs
from . import usual
from .region import Region, region_of
from .scenario import Scenario

if TYPE_CHECKING:
    from .plausibility import Found, LookedAt

OVERLAPPING = 0.12  # pairs a box; why there, stands in the list
GRADE_PERCENT = 1.0  # which moves a beam's end by a car's height at 150 m
DRIFT_RAD = (math.radians(1.5), math.radians(15.0))  # that crosses half a lane in 60 m; lane changes are beyond
_SAME_PLACE_M = 0.5  # between the middles of two boxes: no two vehicles are so near
WIDER = 0.08  # of a lane's width; why there, stands in the list
_ABOUT_LANE_M = 0.7  # from a lane's middle: nearly all drive so
_GROUND_M, _BESIDE_M = 100.0, 40.0  # along the road and across it: how far the ground is looked at for a grade


@dataclass(frozen=True, slots=True, eq=False)
class Placed:
    """Boxes about the region, a sample, as they lie on the road; the one place that knows how a road lies.

    Attributes
    ----------
    t : ndarray, (n,)
        Across the road, to the left [m].
    heading_rad : ndarray, (n,)
        From the direction in which their lane drives [rad].
    vehicle : ndarray, (n,) int
    inside, on_road : ndarray, (n,) bool
        Whether they lie in the region, and on a lane.
    edges : (float, float)
        The t of the road's outermost edges [m].
    region : Region
    """

    t: np.ndarray
    heading_rad: np.ndarray
    vehicle: np.ndarray
    inside: np.ndarray
    on_road: np.ndarray
    edges: tuple[float, float]
    region: Region

    @classmethod
    def of(cls, recording: Recording, scenario: Scenario) -> Placed:
        """Those of a recording in the circle about a scene's region."""
        road = scenario.road_map
        region = region_of(scenario.region, road)
        near = np.flatnonzero(region.distance(recording) <= region.radius_m)
        near = near[np.unique(np.linspace(0, len(near) - 1, min(len(near), usual.SAMPLE)).astype(int))]
        part = recording.select(np.bincount(near, minlength=len(recording)) > 0)
        at = road.locate(part.centre_m, part.heading_rad)
        heading = part.heading_rad - at.heading_rad
        edges = road.edges_t if road.endless else (0.0, 0.0)
        return cls(at.t_m, heading, part.vehicle_id, region.holds(part), at.lane >= 0, edges, region)

    @property
    def name(self) -> str:
        return "the carriageway of [road], y {:g} to {:g} m".format(*self.edges)

    def beside(self, which: np.ndarray, least: float) -> bool:
        """Whether less than a share of some lie on the carriageway, and nearly all on one as wide that overlaps it."""
        low, high = self.edges
        t = np.sort(self.t[which])
        held = np.searchsorted(t, t + (high - low), side="right") - np.arange(len(t))
        best = held.argmax()
        few = self.on_road[which].mean() < least
        return bool(few and held[best] > usual.ALL * len(t) and abs(t[best] - low) < high - low)


# --- What each check measures; None where all may be true: stops --------------------------------------------------


def oblique(seen: LookedAt, few: float) -> Found:
    """Vehicles that drive obliquely to a straight road."""
    heading = seen.placed.heading_rad[seen.placed.inside]
    straight = seen.scenario.road_map.endless and not seen.report.periods
    if not straight or len(heading) < usual.FEWEST or not seen.heading_known:
        return None
    axis = 0.5 * float(np.angle(np.exp(2j * heading).mean()))  # of both ways along it
    axis += math.pi if np.cos(heading - axis).sum() < 0.0 else 0.0
    if _share_along(heading) >= few or _share_along(heading - axis) < usual.MINORITY:
        return None
    return _turn_meant(axis, seen.scenario)


def _share_along(heading: np.ndarray) -> float:
    return float((np.abs(np.sin(heading)) <= math.sin(_ALONG_RAD)).mean())


_ALONG_RAD = math.radians(5.0)  # who drives along a road, for the direction of the road


def beside(seen: LookedAt, limit: tuple[float, float]) -> Found:
    """Almost none of the region's vehicles on the carriageway of a straight road, or most on one beside it."""
    placed, stretches = seen.placed, seen.scenario.region.stretches
    looked_at = placed.inside | bool(stretches)  # beside a stretch too
    if not seen.scenario.road_map.endless or looked_at.sum() < usual.FEWEST:
        return None
    share = placed.on_road[looked_at].mean()
    nobody = share < limit[0] and not (placed.inside.sum() >= usual.FEWEST if stretches else _keep_to_it(placed))
    if not nobody and not placed.beside(looked_at, limit[1]):
        return None
    t, where = placed.t[looked_at], "about" if stretches else "in"
    meant = _place_meant(t, seen.recording, seen.scenario)
    return {"share": 100 * share, "where": where, "road": placed.name, "span": _span("y", t), "meant": meant}


def off_map(seen: LookedAt, half: float) -> Found:
    """Most vehicles beside the roads of the map: how far apart both are."""
    if seen.scenario.road_map.endless:
        return None
    recording, region = seen.recording, seen.placed.region
    part = recording.select(np.arange(len(recording)) % max(1, len(recording) // usual.SAMPLE) == 0)
    near = region.distance(part) <= region.radius_m
    looked_at = part.select(near) if near.sum() >= usual.FEWEST else part
    share = seen.scenario.road_map.on(looked_at.centre_m).mean()
    if len(looked_at) < usual.FEWEST or share >= half:
        return None
    x, y = np.median(part.centre_m[:, :2], axis=0) - region.centre_xy
    return {"share": 100 * share, "away": float(np.hypot(x, y)), "x": x, "y": y}


def _keep_to_it(placed: Placed) -> bool:
    """Whether three vehicles keep to the carriageway in the region: then others may be many beside it."""
    along = placed.on_road & (np.cos(placed.heading_rad) > math.cos(_ALONG_RAD))
    of_row = np.unique(placed.vehicle[placed.inside], return_inverse=True)[1].reshape(-1)
    keeping = np.bincount(of_row, along[placed.inside]) > usual.MOST * np.bincount(of_row)
    return bool(keeping.sum() >= FEWEST_ON_A_ROAD and along[placed.inside].sum() >= usual.FEWEST)


def _place_meant(t: np.ndarray, recording: Recording, scenario: Scenario) -> str:
    """What would put vehicles at `t` onto the carriageway, in words."""
    if recording.report.periods:
        at = _span("Local_X", scenario.road.T_site_ngsim.inverse.points(np.stack([0.0 * t, t], axis=1))[:, 0])
        return f"check [road] right_edge_m, in metres where NGSIM has feet: vehicles drive at {at}"
    return (
        "check [traffic] origin_m and heading_deg, the unit and the side (y mirrored, or half a turn), and [road] "
        "setback_m, lanes and lane_width_m"
    )


def _turn_meant(axis: float, scenario: Scenario) -> dict[str, float]:
    """A direction in the road frame [rad] in degrees, and as what `heading_deg` would make it the road's."""
    turns = axis, axis + math.radians(scenario.recordings[0].heading_deg or 0.0)
    at, meant = (round(math.degrees(wrap_angle(angle)), 1) + 0.0 for angle in turns)
    return {"at": at, "meant": meant}


# --- Notes on a straight road -------------------------------------------------------------------------------------


def few_on_it(seen: LookedAt, minority: float) -> Found:
    """Few vehicles of the region on the carriageway."""
    placed, inside = seen.placed, seen.placed.inside
    ahead = inside & (np.cos(placed.heading_rad) > math.cos(usual.ASTRAY_RAD))
    off = ahead.sum() >= usual.FEWEST and placed.beside(ahead, usual.MOST)
    off |= inside.any() and placed.on_road[inside].mean() < minority
    if not off or "carriageway" in seen.warnings or seen.scenario.region.stretches:
        return None
    share, span = 100 * placed.on_road[inside].mean(), _span("y", placed.t[inside])
    return {"share": share, "road": placed.name, "span": span}


def lane_width(seen: LookedAt, limit: tuple[float, float]) -> Found:
    """Lanes that nobody builds."""
    width = _lane_width(seen)
    return None if limit[0] <= width <= limit[1] else {"width": width, "low": limit[0], "high": limit[1]}


def _lane_width(seen: LookedAt) -> float:
    return float(np.median(seen.scenario.road_map.width_m))


def _along(seen: LookedAt) -> np.ndarray:
    """Which boxes drive along the road on the carriageway or within a lane beside it, (n,) bool."""
    placed, lane = seen.placed, max(_lane_width(seen), USUAL_LANE_M)
    (low, high), t = placed.edges, placed.t
    return (t > low - lane) & (t < high + lane) & (np.abs(np.sin(placed.heading_rad)) < math.sin(usual.ASTRAY_RAD))


def next_to_it(seen: LookedAt, some: float) -> Found:
    """Vehicles that drive beside stretches of the carriageway."""
    placed = seen.placed
    next_to, inside = (_along(seen) & ~placed.inside & ~placed.on_road).sum(), placed.inside.sum()
    if not seen.scenario.region.stretches or not inside or next_to <= some * (inside + next_to):
        return None
    return {"share": 100 * next_to / (inside + next_to), "road": placed.name}


def _against(seen: LookedAt) -> tuple[np.ndarray, np.ndarray, float]:
    """Which boxes drive against their lane, which count on the carriageway, (n,) bool, and what share of these."""
    against = np.cos(seen.placed.heading_rad) < -math.cos(usual.ASTRAY_RAD)
    there = seen.placed.inside & seen.placed.on_road
    return against, there, against[there].mean() if there.sum() >= usual.FEWEST else 0.0


def against(seen: LookedAt, some: float) -> Found:
    """Vehicles that drive against the direction of their lane."""
    share = _against(seen)[2]
    return {"share": 100 * share, "road": seen.placed.name} if share > some else None


def slightly_oblique(seen: LookedAt, limit_rad: float) -> Found:
    """Vehicles on the carriageway that all drive off its direction by a little."""
    heading, length = seen.placed.heading_rad[_against(seen)[1]], 2.0 * seen.placed.region.radius_m
    nearly = np.arctan(np.tan(heading[np.abs(np.sin(heading)) < math.sin(DRIFT_RAD[1])]))  # both ways
    off = float(np.median(nearly)) if len(nearly) >= usual.FEWEST else 0.0
    if abs(off) < limit_rad:
        return None
    return {**_turn_meant(off, seen.scenario), "across": length * abs(math.tan(off)), "length": length}


def _lanes_driven(seen: LookedAt) -> tuple[np.ndarray, float] | None:
    """Two lanes and more, by where boxes lie across the road [m], and how far apart they are; None for none."""
    t = seen.placed.t[seen.placed.inside & _along(seen)]
    if len(t) < 5 * usual.FEWEST:
        return None
    lanes = np.sort(density_peaks(t, np.ones(len(t))))
    in_lanes, spacing = (np.abs(t[:, None] - lanes) <= _ABOUT_LANE_M).any(axis=1).mean(), np.diff(lanes)
    if len(lanes) < 2 or in_lanes <= usual.MOST or spacing.max() > (1.0 + usual.MANY) * spacing.min():
        return None
    return lanes, float(spacing.mean())


def lane_spacing(seen: LookedAt, wider: float) -> Found:
    """Lanes that lie farther apart than those of [road], or nearer."""
    lanes, apart = _lanes_driven(seen) or ((), 0.0)
    width = _lane_width(seen)
    off = len(lanes) and abs(apart / width - 1.0) > wider
    return {"lanes": len(lanes), "apart": apart, "width": width} if off else None


def off_lanes(seen: LookedAt, limit_m: float) -> Found:
    """Lanes as far apart as those of [road], beside them."""
    lanes, apart = _lanes_driven(seen) or ((), 0.0)
    width = _lane_width(seen)
    if not len(lanes) or abs(apart / width - 1.0) > WIDER:
        return None
    off = np.abs(lanes[:, None] - seen.scenario.road_map.offset_m).min(axis=1) / width
    off = width * np.abs(off - np.rint(off))
    return {"off": off.mean(), "at": ", ".join(f"{one:.1f}" for one in lanes)} if off.min() > limit_m else None


def mirrored(seen: LookedAt, most: float) -> Found:
    """Oncoming vehicles on the side on which nobody should come."""
    placed, (low, high), (oncoming, there, share) = seen.placed, seen.placed.edges, _against(seen)
    drives_on, beside = seen.scenario.road.drives_on, oncoming & ((placed.t < low) | (placed.t > high))
    wrong = beside & (placed.t < low if drives_on == SIDES[0] else placed.t > high)
    travels = there.sum() >= usual.FEWEST and share < usual.HALF
    if not travels or wrong.sum() < usual.FEWEST or wrong.sum() <= most * beside.sum():
        return None
    other = SIDES[1] if drives_on == SIDES[0] else SIDES[0]
    return {"drives_on": drives_on, "other": other, "road": placed.name, "span": _span("y", placed.t[wrong])}


# --- Boxes in one another -----------------------------------------------------------------------------------------


def _overlapping(recording: Recording) -> tuple[int, float]:
    """Pairs of boxes that overlap, and among how many boxes they were looked for."""
    report = recording.report
    return report.overlaps, report.overlap_frames * len(recording) / len(recording.frames)


def twice(seen: LookedAt, few: float) -> Found:
    """Boxes that stand where another one stands."""
    (pairs, boxes), most = _overlapping(seen.recording), _most(seen, (usual.SOME, OVERLAPPING))
    if boxes < usual.FEWEST or not pairs:
        return None
    found = _in_one_place(seen.recording)
    return {"twice": found, "boxes": boxes} if few * boxes < found <= most * boxes else None


def overlaps(seen: LookedAt, limit: tuple[float, float]) -> Found:
    """Boxes that stand in one another."""
    pairs, boxes = _overlapping(seen.recording)
    return {"pairs": pairs, "boxes": boxes} if boxes >= usual.FEWEST and pairs > _most(seen, limit) * boxes else None


def some_overlap(seen: LookedAt, limit: tuple[float, float]) -> Found:
    """Some boxes that stand in one another."""
    pairs, boxes = _overlapping(seen.recording)
    return {"pairs": 100 * pairs / boxes} if limit[0] * boxes < pairs <= limit[1] * boxes else None


def _most(seen: LookedAt, limit: tuple[float, float]) -> float:
    return limit[0] if seen.report.periods else limit[1]


def _in_one_place(recording: Recording) -> int:
    """Pairs of boxes that overlap about one middle, in the frames in which overlaps were looked for."""
    found = 0
    for frame in frames_looked_at(recording):
        vehicles = recording.at(frame)
        one, other = overlapping_pairs(vehicles).T
        apart = vehicles.centre_m[one, :2] - vehicles.centre_m[other, :2]
        found += int((np.hypot(*apart.T) < _SAME_PLACE_M).sum())
    return found


# --- Where vehicles are --------------------------------------------------------------------------------------------


def nobody_there(recording: Recording, region: Region, frames: int, scenario: Scenario) -> InputError:
    """The error for a region where nobody drives: where vehicles are, and the keys that move one to the other."""
    road, (x, y) = scenario.road_map, recording.centre_m[:, :2].T
    at, (first, last) = road.locate(recording.centre_m), road.stretch(region.centre_xy, region.radius_m)
    beside = (at.s_m >= first) & (at.s_m <= last)
    if road.endless and beside.any() and (at.lane[beside] >= 0).mean() < usual.FEW:
        meant = _place_meant(at.t_m[beside], recording, scenario)
    elif asked := {lane for one in scenario.region.stretches or () for lane in one.lanes or ()}:
        there = ", ".join(map(str, np.unique(recording.lane[recording.lane != 0]).tolist()))
        meant = f"its lanes are {there}" if there else "it names no lanes"
        meant = f"check [region] stretches: of lanes {', '.join(map(str, sorted(asked)))}, {meant}"
    elif recording.report.periods:
        _, local_y = scenario.road.T_site_ngsim.inverse.points((np.median(x), 0.0))
        meant = f"check [road] station_m (such as {local_y:.0f}) and [region]"
    else:
        meant = "check [traffic] origin_m and heading_deg, and [region]"
    return InputError(
        f"{recording.source}: no vehicle in the region, within {region.radius_m:g} m of x {region.centre_xy[0]:g} m, y "
        f"{region.centre_xy[1]:g} m, in the {frames} searched frames; in the road frame vehicles drive at "
        f"{_span('x', x)}, {_span('y', y)}; {meant}"
    )


def _span(name: str, values: np.ndarray) -> str:
    low, high = np.quantile(values, [0.05, 0.95]) + 0.0
    return f"{name} {low:.0f} to {high:.0f} m"


# --- How the ground rises, where the recording says so ----------------------------------------------------------------


def known_grades(recording: Recording, scenario: Scenario) -> tuple[float, float] | None:
    """`grades_percent` of a recording about the region's middle; None on a map, whose heights are its own."""
    if not scenario.road_map.endless:
        return None
    return grades_percent(recording.report.ground, region_of(scenario.region, scenario.road_map).centre_xy[0])


def grades_percent(ground: np.ndarray, middle_m: float) -> tuple[float, float] | None:
    """How the ground (n, 3) rises along x before a place and beyond it [%], by least squares.

    From what lies within `_GROUND_M` along the road and `_BESIDE_M` beside it; None where that is too little.
    """
    found = []
    for side in (-1.0, 1.0):
        along = side * (ground[:, 0] - middle_m)
        near = ground[(along >= 0.0) & (along <= _GROUND_M) & (np.abs(ground[:, 1]) <= _BESIDE_M)]
        if len(near) < usual.FEWEST or np.ptp(near[:, 0]) < 0.3 * _GROUND_M:
            return None
        found.append(100.0 * float(np.polyfit(near[:, 0], near[:, 2], 1)[0]))
    return found[0], found[1]


Grades = tuple[float, float] | None
"""How the ground rises before a place and beyond it [%], as `known_grades` finds it."""


def crest(known: Grades, limit: float = 2.0 * GRADE_PERCENT) -> Found:
    """A crest or a dip."""
    if known is None or abs(known[1] - known[0]) <= limit:
        return None
    return {"what": "crest" if known[1] < known[0] else "dip", "before": known[0], "beyond": known[1]}


def rise(known: Grades, said: float, limit: float = GRADE_PERCENT) -> Found:
    """A ground that rises otherwise than [road] grade_percent says."""
    measured = said if known is None else 0.5 * (known[0] + known[1])
    return {"measured": measured, "said": said} if abs(measured - said) > limit else None
