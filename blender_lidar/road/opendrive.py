"""OpenDRIVE: lanes, junctions and heights of a road map file (.xodr)."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

import numpy as np

from ..errors import InputError, unknown_name
from ..files import number, read_file, reading
from ..names import SIDES
from .mapped_surface import MappedSurface, two_levels
from .opendrive_geometry import ReferenceLine, cubic, cubics, finite, whole
from .road_map import Junction, Lane, RoadMap

_FOR_VEHICLES = (
    *("driving", "entry", "exit", "onRamp", "offRamp", "connectingRamp", "slipLane", "mwyEntry", "mwyExit"),
    *("bidirectional", "bus", "taxi", "HOV", "shared"),
)
_USE = dict.fromkeys(_FOR_VEHICLES, "vehicles") | {"biking": "bicycles"}
_USE |= dict.fromkeys(("sidewalk", "walking"), "pedestrians")
_RULES = ("RHT", "LHT")  # as SIDES[:2]: vehicles drive on the right, or on the left
_CHORD_M = 0.01  # edges lie this near to their curves, in plan and height
_LEAST_STEP_M = 0.25  # a jump of the file is no curve to follow
_JUST_M = 1e-6  # before the end of a lane section its own records still hold
_NOTHING_M = 1e-3  # of a width or a length
_WIDTHS_M = (-0.1, 1000.0)  # below 0 by rounding; of a lane that is a verge
_MEET_M = 0.05
_TILT = 1e-4  # rad or m: what a level cross-section may have by rounding
_TRAFFIC_LIGHT = "1000001"  # the standard's type of a signal

_Key = tuple[str, int, int]  # of a lane in a lane section: road, number of the section, lane


class _Road(NamedTuple):
    """What the file says of a road."""

    element: ElementTree.Element
    where: str
    sections: list[ElementTree.Element]  # by their stations
    links: dict[str, ElementTree.Element]  # of its ends, "start" and "end"
    junction: str  # that it belongs to; nothing where to none

    def key(self, end: str, lane: int) -> _Key:
        """A lane at an end of the road."""
        return self.element.get("id", ""), len(self.sections) - 1 if end == "end" else 0, lane


class _Piece(NamedTuple):
    """A lane in a lane section, in its direction of travel."""

    edges_m: np.ndarray  # (2, k, 3), the one towards the road's middle first
    width_m: np.ndarray  # (k,)
    use: str
    forward: bool  # along the road's stations

    @property
    def centre_m(self) -> np.ndarray:
        """Its centre line, (k, 3) [m]."""
        return self.edges_m.mean(axis=0)

    def leaves_by(self, end: str) -> bool:
        """Whether traffic leaves it at an end of its section, "start" or "end"."""
        return self.forward == (end == "end")

    def place(self, end: str) -> np.ndarray:
        """Where its centre line is at an end of its section, (3,) [m]."""
        return self.centre_m[-1 if self.leaves_by(end) else 0]


def read_opendrive(path: str | Path, origin_m: Sequence[float] = (0.0, 0.0)) -> RoadMap:
    """Road map of an OpenDRIVE file; its axes are the file's, less an origin.

    Lanes for vehicles are those of type driving, entry, exit, ramps, slip lanes, bus, taxi, HOV, shared, and
    bidirectional, which drives as its number says; biking lanes are for bicycles, sidewalks for pedestrians. Others
    (shoulder, border, median, stop, parking, restricted, rails ...) are none. Where a lane has no width it is cut.
    Lanes of a road that are linked one to one and meet are one, from section to section. A lane is named ROAD:LANE, or
    ROAD.SECTION:LANE where the road has several lane sections (from 0; the first in which it lies).

    The surface is the roads' elevation, level across; one that is the same everywhere becomes z = 0. Heights of lanes
    (kerbs) are left out. The area of a junction is what its lanes for vehicles enclose, seen from its middle; its
    `<boundary>` is not read, and direct junctions, which have no lanes of their own, are none.

    Parameters
    ----------
    path : str or Path
        A file of OpenDRIVE 1.x.
    origin_m : (float, float)
        What is subtracted from the file's x and y, its header's offset included, before all else [m].

    Raises
    ------
    MissingFileError, InputError
        If the file cannot be read or is no OpenDRIVE, holds what cannot be a number, a lane or a road, or what one
        level surface cannot show: superelevation, cross-fall, road shapes, bridges, tunnels.
    """
    root = _root(path)
    roads: dict[str, _Road] = {}
    for element in root.iterfind("road"):
        road = _road(element, f"{path}: road {element.get('id', '')}")
        if roads.setdefault(element.get("id", ""), road) is not road:
            raise InputError(f"{road.where} is there twice; allowed: an id of its own for each")
    if not roads:
        raise InputError(f"{path}: has no <road>")
    shift = np.array([*origin_m, 0.0]) - _header_offset(root, path)
    pieces = {key: piece for road in roads.values() for key, piece in _pieces(road, shift)}
    if "vehicles" not in (piece.use for piece in pieces.values()):
        types = sorted({lane.get("type", "") for lane in root.iter("lane")})
        raise InputError(
            f"{path}: has no lane for vehicles that is wider than 0 m; its types are {', '.join(types) or 'none'}; "
            f"allowed: {', '.join(_FOR_VEHICLES)}"
        )
    rules = {_rule(roads[name]) for name, *_ in pieces}
    if len(rules) > 1:
        raise InputError(f"{path}: has roads of rule RHT and of rule LHT; allowed: one for all")

    leads = _leads(root, roads, pieces, path)
    chains = _chains(pieces, leads)
    joined = [_joined([pieces[key] for key in chain]) for chain in chains]
    lanes = _lanes(roads, pieces, chains, leads)
    centres, width_m = [piece.centre_m for piece in joined], np.array([piece.width_m.max() for piece in joined])
    if over := two_levels(centres, width_m, [lane.junction for lane in lanes]):
        one, other, (x, y, _), above = over
        raise InputError(
            f"{path}: lanes {lanes[one].name} and {lanes[other].name} lie {abs(above):.1f} m above each other at x "
            f"{x:.1f}, y {y:.1f} m; allowed: one surface over each place, without bridges"
        )
    zeros, tapering = np.zeros(len(lanes)), any(np.ptp(piece.width_m) > _NOTHING_M for piece in joined)
    return RoadMap(
        points_m=tuple(centre[:, :2] for centre in centres),
        station_m=zeros,
        offset_m=zeros,
        width_m=width_m,
        against=np.zeros(len(lanes), dtype=bool),
        surface=MappedSurface.of_lines(centres),
        widths_m=tuple(piece.width_m for piece in joined) if tapering else (),
        lanes=lanes,
        junctions=tuple(_junctions(root, roads, lanes, joined)),
        drives_on=SIDES[_RULES.index(rules.pop())],
    )


# --- What the file says -----------------------------------------------------------------------------------------------


def _root(path: str | Path) -> ElementTree.Element:
    """The root of an OpenDRIVE file, with names without namespaces."""
    with reading(path, "an OpenDRIVE file (.xodr)"):
        content = read_file(path)
    try:
        root = ElementTree.fromstring(content)
    except (ElementTree.ParseError, LookupError, ValueError) as error:  # the latter two of encodings
        raise InputError(f"{path}: truncated or damaged XML ({error}); an OpenDRIVE file is needed") from error
    for element in root.iter():
        element.tag = element.tag.rpartition("}")[2]
    if root.tag != "OpenDRIVE":
        raise InputError(f"{path}: its root is <{root.tag}>; that of an OpenDRIVE file is <OpenDRIVE>")
    return root


def _header_offset(root: ElementTree.Element, path: str | Path) -> np.ndarray:
    """What a header adds to all coordinates, (3,) [m]."""
    offset = root.find("header/offset")
    if offset is None:
        return np.zeros(3)
    if turn := finite(offset, "hdg", str(path), 0.0):
        raise InputError(f"{path}: its header's <offset> turns the map by hdg {turn:g}; allowed: 0")
    return np.array([finite(offset, key, str(path), 0.0) for key in "xyz"])


def _road(road: ElementTree.Element, where: str) -> _Road:
    """A road, refused where its cross-section is not level, and on a bridge or in a tunnel."""
    length = max(finite(road, "length", where, 0.0), 1.0)
    for element in road.iterfind("lateralProfile//*"):
        if sum(abs(finite(element, key, where, 0.0)) * length**power for power, key in enumerate("abcd")) > _TILT:
            raise InputError(f"{where}: <{element.tag}> tilts or bends its cross-section; allowed: level across")
    for element in road.iterfind("objects/*"):
        for kind in {"bridge", "tunnel"} & {element.tag, element.get("type")}:
            raise InputError(f"{where}: has a {kind} at s {element.get('s')}; allowed: one surface over each place")
    sections = sorted(road.iterfind("lanes/laneSection"), key=lambda element: finite(element, "s", where))
    found = (("start", road.find("link/predecessor")), ("end", road.find("link/successor")))
    junction = road.get("junction", "-1")
    links = {end: link for end, link in found if link is not None}
    return _Road(road, where, sections, links, "" if junction == "-1" else junction)


def _rule(road: _Road) -> str:
    """Right-hand or left-hand traffic, one of `_RULES`."""
    if (rule := road.element.get("rule", _RULES[0])) not in _RULES:
        raise unknown_name(rule, _RULES, "rule", road.where)
    return rule


# --- Lanes, section by section ----------------------------------------------------------------------------------------


def _pieces(road: _Road, shift_m: np.ndarray) -> Iterator[tuple[_Key, _Piece]]:
    """The lanes of a road that have a use and a width."""
    line = ReferenceLine(road.element, road.where, shift_m[:2])
    offset = cubics(road.element.iterfind("lanes/laneOffset"), "s", road.where)
    elevation = cubics(road.element.iterfind("elevationProfile/elevation"), "s", road.where)
    elevation[:, 1] -= shift_m[2]
    left_hand = _rule(road) == "LHT"
    starts = [*(finite(section, "s", road.where) for section in road.sections), line.end_m]
    for row, (element, span_m) in enumerate(zip(road.sections, pairwise(starts), strict=True)):
        section = _Section(line, offset, elevation, _section_lanes(element, road.where), span_m)
        if span_m[1] - span_m[0] < _NOTHING_M or not any(lane.use for lane in section.lanes):
            continue
        if len(offset) and offset[:, 1:].any() and any(lane.by_border for lane in section.lanes):
            raise InputError(f"{road.where}: has a <border> beside a <laneOffset>; allowed: <width> beside it")
        s = _sampled(section)
        edges, across = section.edges(s), section.across(s)
        for lane, edge, (inner, outer) in zip(section.lanes, edges, across, strict=True):
            width = np.sign(lane.number) * (outer - inner)
            if len(wrong := np.flatnonzero((width < _WIDTHS_M[0]) | (width > _WIDTHS_M[1]))):
                text = f"lane {lane.number} is {width[wrong[-1]]:.2f} m wide at s {s[wrong[-1]]:g}"
                raise InputError(f"{road.where}: {text}; allowed: 0 to {_WIDTHS_M[1]:g} m")
            wide = np.flatnonzero(width > _NOTHING_M)
            if lane.use is None or not len(wide):
                continue
            part = np.arange(max(wide[0] - 1, 0), min(wide[-1] + 2, len(s)))
            steps = np.hypot(*np.diff(edge[:, part, :2].mean(axis=0), axis=0).T)
            part = part[np.concatenate([[True], steps > _NOTHING_M])]  # about a curve's centre a lane may stand still
            forward = (lane.number > 0) == (left_hand != lane.reversed)
            part = part if forward else part[::-1]
            if len(part) > 1:
                key = road.element.get("id", ""), row, lane.number
                yield key, _Piece(edge[:, part], width[part].clip(0.0), lane.use, forward)


class _SectionLane(NamedTuple):
    """What a lane section says of a lane."""

    number: int
    use: str | None
    reversed: bool
    by_border: bool
    records: np.ndarray


def _section_lanes(section: ElementTree.Element, where: str) -> list[_SectionLane]:
    """The lanes of a section, from its middle outwards, on the left first."""
    if section.get("singleSide") == "true":
        raise InputError(f"{where}: has a <laneSection> of a single side; allowed: lane sections of both")
    lanes = []
    for element in section.iterfind("*/lane"):
        if lane := whole(element, "id", where):
            by_border = element.find("width") is None and element.find("border") is not None
            records = element.iterfind("border" if by_border else "width")
            turned, use = element.get("direction") == "reversed", _USE.get(element.get("type", ""))
            records = cubics(records, "sOffset", f"{where}, lane {lane}")
            lanes.append(_SectionLane(lane, use, turned, by_border, records))
    return sorted(lanes, key=lambda lane: (lane.number < 0, abs(lane.number)))


@dataclass(frozen=True)
class _Section:
    """A lane section: the edges of all its lanes by station."""

    line: ReferenceLine
    offset: np.ndarray
    elevation: np.ndarray
    lanes: list[_SectionLane]
    span_m: tuple[float, float]

    def across(self, s_m: np.ndarray) -> np.ndarray:
        """Offsets of the inner and outer edge of each lane, (l, 2, n) [m], to the left."""
        s = np.minimum(s_m, self.span_m[1] - _JUST_M)
        edge, found = dict.fromkeys((1.0, -1.0), cubic(self.offset, s)), []
        for lane in self.lanes:
            side, value = np.sign(lane.number), cubic(lane.records, s - self.span_m[0])
            outer = side * np.abs(value) if lane.by_border else edge[side] + side * value
            found.append((edge[side], outer))
            edge[side] = outer
        return np.array(found)

    def edges(self, s_m: np.ndarray) -> np.ndarray:
        """The same as places, (l, 2, n, 3) [m, site frame]."""
        s = np.minimum(s_m, self.span_m[1] - _JUST_M)
        xy, heading = self.line.at(s)
        left = np.stack([-np.sin(heading), np.cos(heading)], axis=1)
        places = xy + self.across(s)[..., None] * left
        z = np.broadcast_to(cubic(self.elevation, s), places.shape[:-1])
        return np.concatenate([places, z[..., None]], axis=-1)


def _sampled(section: _Section) -> np.ndarray:
    """Adaptive sampling: stations (n,) [m] between which chords are near to the edges of the lanes that have a use."""
    (first, last), used = section.span_m, [bool(lane.use) for lane in section.lanes]
    records = [first + lane.records[:, 0] for lane in section.lanes]
    breaks = np.sort(
        np.concatenate([section.line.start_m, section.offset[:, 0], section.elevation[:, 0], *records, [first]])
    )
    breaks = breaks[(breaks >= first) & (breaks < last - _NOTHING_M)]
    s = np.append(breaks[np.diff(breaks, prepend=-np.inf) > _NOTHING_M], last)
    while True:
        step, off = np.diff(s), np.zeros(len(s) - 1)
        places = section.edges(s)[used]
        for part in (0.25, 0.5, 0.75):
            chord = places[..., :-1, :] + part * np.diff(places, axis=-2)
            away = np.linalg.norm(section.edges(s[:-1] + part * step)[used] - chord, axis=-1)
            off = np.maximum(off, away.max(axis=(0, 1)))
        bent = (off > _CHORD_M) & (step > _LEAST_STEP_M)
        if not bent.any():
            return s
        s = np.sort(np.concatenate([s, (s[:-1] + 0.5 * step)[bent]]))


# --- Which lane leads into which --------------------------------------------------------------------------------------


def _leads(
    root: ElementTree.Element, roads: Mapping[str, _Road], pieces: Mapping[_Key, _Piece], path: str | Path
) -> dict[_Key, set[_Key]]:
    """Into which lanes each lane leads."""
    leads: dict[_Key, set[_Key]] = {}
    joints = [joint for name in roads for joint in _joints_of_lanes(roads, name)]
    for one, end, other, other_end in [*joints, *_joints_of_junctions(root, roads, pieces, path)]:
        if one in pieces and other in pieces and pieces[one].leaves_by(end) != pieces[other].leaves_by(other_end):
            before, after = (one, other) if pieces[one].leaves_by(end) else (other, one)
            leads.setdefault(before, set()).add(after)
    return leads


_Joint = tuple[_Key, str, _Key, str]  # two lanes that touch, each with the end of its section at which it does


def _joints_of_lanes(roads: Mapping[str, _Road], name: str) -> Iterator[_Joint]:
    """What the lanes of a road are linked to, in it and in the roads before and after it."""
    road = roads[name]
    for row, section in enumerate(road.sections):
        for lane in section.iterfind("*/lane"):
            for end, tag, step in (("start", "predecessor", -1), ("end", "successor", 1)):
                for link in lane.iterfind(f"link/{tag}"):
                    other, there = whole(link, "id", road.where), "end" if end == "start" else "start"
                    key, onward = (name, row + step, other), road.links.get(end)
                    if not 0 <= row + step < len(road.sections):
                        if (
                            onward is None
                            or onward.get("elementType") != "road"
                            or onward.get("elementId") not in roads
                        ):
                            continue
                        there = onward.get("contactPoint", there)
                        key = roads[onward.get("elementId")].key(there, other)
                    yield (name, row, whole(lane, "id", road.where)), end, key, there


def _joints_of_junctions(
    root: ElementTree.Element, roads: Mapping[str, _Road], pieces: Mapping[_Key, _Piece], path: str | Path
) -> Iterator[_Joint]:
    """What a junction's connections join: a lane that comes in with one of a connecting road or, directly, beyond."""
    for junction in root.iterfind("junction"):
        where = f"{path}: junction {junction.get('id')}"
        for connection in junction.iterfind("connection"):
            road = roads.get(connection.get("incomingRoad", ""))
            onto = roads.get(connection.get("connectingRoad") or connection.get("linkedRoad", ""))
            if road is None or onto is None:
                continue
            there = connection.get("contactPoint", "start")
            ends = [end for end, link in road.links.items() if link.get("elementId") == junction.get("id")]
            for link in connection.iterfind("laneLink"):
                key = onto.key(there, whole(link, "to", where))
                one = {end: road.key(end, whole(link, "from", where)) for end in ends}
                touching = [end for end in ends if one[end] in pieces and key in pieces]
                if touching:  # of a loop both ends are at the junction
                    place = pieces[key].place(there)
                    end = min(touching, key=lambda end: math.dist(pieces[one[end]].place(end), place))
                    yield one[end], end, key, there


def _chains(pieces: Mapping[_Key, _Piece], leads: Mapping[_Key, set[_Key]]) -> list[list[_Key]]:
    """Lanes that go on from section to section of a road, each as its pieces."""
    before, onto = Counter(key for after in leads.values() for key in after), {}
    for key, after in leads.items():
        piece, other = pieces[key], min(after)
        ahead = other[:2] == (key[0], key[1] + (1 if piece.forward else -1)) and pieces[other].use == piece.use
        meet = math.dist(piece.centre_m[-1, :2], pieces[other].centre_m[0, :2]) < _MEET_M
        if len(after) == before[other] == 1 and ahead and meet:
            onto[key] = other
    chains, later = [], set(onto.values())
    for key in pieces:
        if key not in later:
            chain = [key]
            while chain[-1] in onto:
                chain.append(onto[chain[-1]])
            chains.append(chain)
    return chains


def _joined(pieces: Sequence[_Piece]) -> _Piece:
    """Pieces that go on into each other as one."""
    edges = [piece.edges_m[:, row > 0 :] for row, piece in enumerate(pieces)]
    widths = [piece.width_m[row > 0 :] for row, piece in enumerate(pieces)]
    return pieces[0]._replace(edges_m=np.concatenate(edges, axis=1), width_m=np.concatenate(widths))


def _lanes(
    roads: Mapping[str, _Road],
    pieces: Mapping[_Key, _Piece],
    chains: Sequence[Sequence[_Key]],
    leads: Mapping[_Key, set[_Key]],
) -> tuple[Lane, ...]:
    """What the map says of each lane."""
    row, lanes = {key: number for number, chain in enumerate(chains) for key in chain}, []
    for chain in chains:
        name, section, lane = min(chain)  # the first of its sections
        part = f".{section}" if len(roads[name].sections) > 1 else ""
        way = "forward" if pieces[chain[0]].forward else "backward"
        leads_to = tuple(sorted({row[key] for key in leads.get(chain[-1], ())}))
        use = pieces[chain[0]].use
        lanes.append(Lane(f"{name}{part}:{lane}", f"{name} {way}", roads[name].junction, leads_to, use))
    return tuple(lanes)


# --- Junctions --------------------------------------------------------------------------------------------------------


def _junctions(
    root: ElementTree.Element, roads: Mapping[str, _Road], lanes: Sequence[Lane], pieces: Sequence[_Piece]
) -> Iterator[Junction]:
    """The junctions that lanes for vehicles cross."""
    signals = list(root.iter("signal"))
    lights = {signal.get("id") for signal in signals if signal.get("type") == _TRAFFIC_LIGHT}
    for junction in root.iterfind("junction"):
        name = junction.get("id", "")
        edges = [
            piece.edges_m[..., :2]
            for lane, piece in zip(lanes, pieces, strict=True)
            if lane.junction == name and lane.use == "vehicles"
        ]
        if edges:
            controlled = junction.find("controller") is not None
            lit = controlled or any(_has_light(road, name, lights) for road in roads.values())
            yield Junction(name, _star_outline(edges), lit if signals or controlled else None)


def _has_light(road: _Road, junction: str, lights: set[str | None]) -> bool:
    """Whether a traffic light stands on a road of a junction, or on the near half of one that leads there."""
    at = [number(signal.get("s", "")) for signal in road.element.iterfind("signals/*") if signal.get("id") in lights]
    middle = 0.5 * number(road.element.get("length", ""))
    ends = [end for end, link in road.links.items() if link.get("elementId") == junction]
    return any(road.junction == junction or ("end" if s > middle else "start") in ends for s in at)


def _star_outline(edges: Sequence[np.ndarray]) -> np.ndarray:
    """Star-shaped outline of lanes by their edges, (2, k, 2) each: how far they reach each way, (n, 2) [m]."""
    ends = np.concatenate([edge[:, [0, -1]].reshape(-1, 2) for edge in edges])
    middle = ends.mean(axis=0)
    angle = np.concatenate([np.arctan2(*(ends - middle).T[::-1]), np.radians(np.arange(-180.0, 180.0, 2.0))])
    ray = np.stack([np.cos(angle), np.sin(angle)], axis=1)[np.unique(angle, return_index=True)[1], None]
    outlines = [np.concatenate([one, other[::-1]]) for one, other in edges]
    start = np.concatenate(outlines) - middle
    step = np.concatenate([np.roll(outline, -1, axis=0) - outline for outline in outlines])
    with np.errstate(divide="ignore", invalid="ignore"):
        turn = ray[..., 0] * step[:, 1] - ray[..., 1] * step[:, 0]
        part = (ray[..., 1] * start[:, 0] - ray[..., 0] * start[:, 1]) / turn
        reach = (start[:, 0] * step[:, 1] - start[:, 1] * step[:, 0]) / turn
    met = (np.abs(part - 0.5) < 0.5 + 1e-9) & (reach > 0.0)
    return middle + np.where(met, reach, 0.0).max(axis=1, keepdims=True) * ray[:, 0]
