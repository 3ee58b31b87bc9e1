"""SUMO nets (.net.xml, plain or gzip): their lanes and junctions as a road map."""

from __future__ import annotations

import gzip
import io
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING
from xml import sax
from xml.etree import ElementTree

import numpy as np

from ..errors import InputError, MissingExtraError, shown
from ..files import read_file, reading
from ..names import SIDES
from .road_map import Flat, Junction, Lane, RoadMap

if TYPE_CHECKING:
    from sumolib.net import Net
    from sumolib.net.lane import Lane as NetLane
    from sumolib.net.node import Node

# SUMO's classes, former ones included. All others are vehicles, trams among them, as they are in recordings.
_SLOW = {"bicycles": {"bicycle", "scooter"}, "pedestrians": {"pedestrian", "wheelchair"}}
_ON_NO_ROAD = {"rail_urban", "rail", "rail_electric", "rail_fast", "rail_slow", "lightrail", "cityrail", "subway"}
_ON_NO_ROAD |= {"cable_car", "ship", "container", "aircraft", "drone"}
_SHORTEST_M = 1.0
_FLAT_M = 0.5
_SAME_M = 1e-6  # netconvert writes places to the centimetre, short lanes from one to the same one


def read_net(path: str | Path, origin_m: Sequence[float] = (0.0, 0.0)) -> RoadMap:
    """Road map of a SUMO net, by sumolib; its axes are the net's, less an origin.

    A lane has the name of SUMO's and that of its edge as its road. Those that cross a junction are between the others,
    unless the net was made without them. What allows bicycles, or pedestrians, and nothing faster is theirs; rails and
    what allows nobody are left out, and so are walking areas and lanes without length: what leads to one of them leads
    to what it leads to. Junctions are those where roads of vehicles from three or more others meet, or divide.

    Parameters
    ----------
    path : str or Path
        As netconvert or netedit writes it.
    origin_m : (float, float)
        What is subtracted from the net's x and y before all else [m].

    Raises
    ------
    MissingFileError, InputError
        If the file cannot be read or is no SUMO net, is in degrees, has heights, or no lane for vehicles.
    MissingExtraError
        Without sumolib.
    """
    data = _content(path)
    root, _ = _head(data, path)
    net = _net(data, path)
    lanes = {
        lane.getID(): lane
        for edge in net.getEdges()
        for lane in edge.getLanes()
        if _use(lane) and edge.getFunction() != "walkingarea"
    }
    if "vehicles" not in map(_use, lanes.values()):
        raise InputError(f"{path}: has no lane for vehicles; at least one is needed")
    shapes = {name: _shape(lane, f"{path}: lane {name}") for name, lane in lanes.items()}
    _check_degrees([shape for name, shape in shapes.items() if not lanes[name].getEdge().isSpecial()], path)
    _check_flat(np.concatenate([shape[:, 2] for shape in shapes.values()]), path)
    shapes = {name: shape - np.array([*origin_m, 0.0]) for name, shape in shapes.items() if len(shape) > 1}

    junctions = {node.getID(): _junction(node, origin_m) for node in net.getNodes() if _roads_meet(node)}
    row = {name: number for number, name in enumerate(shapes)}
    leads = {lane.getID(): _next(lane, net) for edge in net.getEdges() for lane in edge.getLanes()}
    zeros = np.zeros(len(shapes))
    return RoadMap(
        points_m=tuple(shape[:, :2] for shape in shapes.values()),
        station_m=zeros,
        offset_m=zeros,
        width_m=np.array([lanes[name].getWidth() for name in shapes]),
        against=np.zeros(len(shapes), dtype=bool),
        surface=Flat(),
        lanes=tuple(
            Lane(
                name=name,
                road=lanes[name].getEdge().getID(),
                junction=_crossed(lanes[name], junctions),
                leads_to=tuple(sorted(_reached(name, leads, row))),
                use=_use(lanes[name]),
            )
            for name in shapes
        ),
        junctions=tuple(junctions.values()),
        drives_on=SIDES[root.get("lefthand") in ("true", "1")],
    )


def net_location(path: str | Path) -> tuple[np.ndarray, str]:
    """Where a SUMO net lies on Earth, by its <location>: the net's offset and its projection.

    Parameters
    ----------
    path : str or Path

    Returns
    -------
    net_offset_m : ndarray, (2,)
        What was added to projected coordinates, UTM's for instance, to make the net's [m].
    projection : str
        As PROJ calls it; ``"!"`` where there is none.

    Raises
    ------
    MissingFileError, InputError
        If the file cannot be read or is no SUMO net.
    """
    _, location = _head(_content(path), path)
    text = location.get("netOffset", "0,0")
    try:
        offset = np.array([float(part) for part in text.split(",")])
    except ValueError:
        offset = np.full(2, np.nan)
    if offset.shape != (2,) or not np.isfinite(offset).all():
        raise InputError(f"{path}: location: netOffset {shown(text)}; allowed: two numbers of metres")
    return offset, location.get("projParameter", "!")


# --- The file ---------------------------------------------------------------------------------------------


def _content(path: str | Path) -> bytes:
    """The file, unpacked if its content (not its name) is gzip."""
    with reading(path, "a SUMO net"):
        data = read_file(path)
        try:
            return gzip.decompress(data) if data.startswith(b"\x1f\x8b") else data
        except (EOFError, zlib.error, gzip.BadGzipFile) as error:
            raise InputError(f"{path}: truncated or damaged gzip file ({error})") from error


def _head(data: bytes, path: str | Path) -> tuple[dict[str, str], dict[str, str]]:
    """Attributes of <net> and of <location>, which stands before all edges."""
    root = None
    try:
        for _, element in ElementTree.iterparse(io.BytesIO(data), events=("start",)):
            if root is None and element.tag != "net":
                raise InputError(
                    f"{path}: the root element is <{element.tag}>; a SUMO net has <net>, as netconvert writes it"
                )
            root = element if root is None else root
            if element.tag in ("location", "edge"):
                return root.attrib, element.attrib if element.tag == "location" else {}
    except (ElementTree.ParseError, ValueError, LookupError) as error:  # the latter two of encodings
        if isinstance(error, InputError):
            raise
        raise InputError(f"{path}: truncated or damaged XML ({error}); a SUMO net is needed") from error
    return root.attrib, {}


def _net(data: bytes, path: str | Path) -> Net:
    """The net with the lanes inside its junctions."""
    try:
        from sumolib.net import NetReader
    except ImportError as error:
        raise MissingExtraError(f'{path}: SUMO nets need sumolib: pip install "blender_lidar[maps]"') from error
    reader = NetReader(withInternal=True, withFoes=False)
    parser = sax.make_parser()
    parser.setContentHandler(reader)
    try:
        parser.parse(io.BytesIO(data))
    except sax.SAXParseException as error:
        line, why = error.getLineNumber(), error.getMessage()
        raise InputError(f"{path}:{line}: truncated or damaged XML ({why}); a SUMO net is needed") from error
    except (LookupError, ValueError, AttributeError, TypeError) as error:  # what sumolib stumbles over
        why = f"{type(error).__name__}: {error}"
        raise InputError(f"{path}:{parser.getLineNumber()}: is not as netconvert writes it ({why})") from error
    return reader.getNet()


# --- Lanes and junctions ----------------------------------------------------------------------------------


def _use(lane: NetLane) -> str | None:
    """Who travels on a lane; None for what is no road."""
    allowed = set(lane.getPermissions()) - _ON_NO_ROAD
    slow = [use for use, classes in _SLOW.items() if allowed & classes]
    return "vehicles" if allowed.difference(*_SLOW.values()) else slow[0] if slow else None


def _shape(lane: NetLane, where: str) -> np.ndarray:
    """The different points of a lane's centre line, (k, 3) [m]."""
    if not 0.0 < lane.getWidth() < np.inf:
        raise InputError(f"{where}: width {lane.getWidth():g} m; allowed: more than 0")
    shape = _different(lane.getShape3D())
    if not np.isfinite(shape).all():
        raise InputError(f"{where}: its shape holds what is no number; allowed: metres")
    return shape


def _different(shape: Sequence[Sequence[float]]) -> np.ndarray:
    """Points (k, 3) without those that lie on the one before."""
    points = np.array(shape, dtype=float).reshape(-1, 3)
    step = np.hypot(*np.diff(points[:, :2], axis=0, prepend=np.inf).T)
    return points[~(step <= _SAME_M)]


def _check_degrees(shapes: Sequence[np.ndarray], path: str | Path) -> None:
    """Refuse lanes between junctions of which none has any length: in degrees netconvert's junctions swallow them."""
    longest = max((np.hypot(*np.diff(shape[:, :2], axis=0).T).sum() for shape in shapes), default=0.0)
    if longest < _SHORTEST_M:
        raise InputError(
            f"{path}: no lane between junctions is longer than {longest:.1g} m, as where coordinates are longitude and "
            "latitude; allowed: metres, as netconvert --proj.utm makes them"
        )


def _check_flat(z_m: np.ndarray, path: str | Path) -> None:
    if np.ptp(z_m) > _FLAT_M:
        raise InputError(
            f"{path}: has heights from {z_m.min():.1f} to {z_m.max():.1f} m; only OpenDRIVE's are used; allowed: flat "
            "nets, as netconvert --flatten makes them"
        )


def _next(lane: NetLane, net: Net) -> list[str]:
    """The lanes that follow a lane, the first of those inside the junction where there are any."""
    outgoing = ((link.getViaLaneID(), link.getToLane().getID()) for link in lane.getOutgoing())
    return [via if via and net.hasEdge(via.rpartition("_")[0]) else to for via, to in outgoing]


def _reached(name: str, leads: dict[str, list[str]], row: dict[str, int]) -> set[int]:
    """Rows of the lanes into which one leads, through those that have no row."""
    found, seen, ahead = set(), set(), list(leads[name])
    while ahead:
        one = ahead.pop()
        if one in row:
            found.add(row[one])
        elif one not in seen:
            seen.add(one)
            ahead += leads[one]
    return found


def _crossed(lane: NetLane, junctions: dict[str, Junction]) -> str:
    """The junction that a lane crosses; nothing where roads do not meet there."""
    edge = lane.getEdge()
    name = edge.getFromNode().getID() if edge.isSpecial() else ""
    return name if name in junctions else ""


def _roads_meet(node: Node) -> bool:
    """Whether a node has an area, and vehicles drive there from or to more than two others, or divide."""
    incoming, outgoing = (
        [edge for edge in edges if not edge.isSpecial() and "vehicles" in map(_use, edge.getLanes())]
        for edges in (node.getIncoming(), node.getOutgoing())
    )
    others = {edge.getFromNode() for edge in incoming} | {edge.getToNode() for edge in outgoing}
    onward = [
        {to for to, links in edge.getOutgoing().items() if to in outgoing and links[0].getDirection() != "t"}
        for edge in incoming
    ]
    return len(node.getShape() or ()) > 2 and (len(others) > 2 or max(map(len, onward), default=0) > 1)


def _junction(node: Node, origin_m: Sequence[float]) -> Junction:
    outline = _different(node.getShape3D())[:, :2] - np.asarray(origin_m, dtype=float)
    return Junction(node.getID(), outline, node.getType().startswith("traffic_light"))
