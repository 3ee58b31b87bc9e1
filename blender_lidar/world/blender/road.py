"""The road in Blender: asphalt, areas of junctions, markings and the verge beside it, as a few flat meshes."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace

import bpy
import numpy as np

from ...road.road_map import Lane, RoadMap
from ..meshes import ROAD
from .nodes import light_nothing, math_of, node, output, ramp_of
from .objects import MARKING, ROAD_ROLE, add_object, clear, collection, is_shown, new_mesh, plain, road_frame, role

_SHOULDER_M = 2.0
_VERGE_M = 60.0  # beyond the shoulders
_LINE_WIDTH_M, _DASH_M, _DASH_EVERY_M = 0.12, 3.0, 12.0  # MUTCD: 10 ft lines and 30 ft gaps
_STOP_LINE_M = 0.4
# What lies over what, high enough not to flicker, seen from afar.
_VERGE_ABOVE_M, _JUNCTION_ABOVE_M, _PATH_ABOVE_M, _LINE_ABOVE_M = -0.02, 0.005, 0.01, 0.02
_CROSSING_ABOVE_M = 2e-4  # one lane of a junction over the other
_BESIDE_M = 0.15  # beyond the edge of a lane, to see what lies there
VERGE, LINE = (0.15, 0.20, 0.06), (0.75, 0.75, 0.72)  # linear RGB
HAZE, _HAZE_FROM_M = (0.60, 0.72, 0.86), 400.0  # what far ground fades into, and where most of it has
# By who travels there.
ASPHALTS = {
    "vehicles": ("Asphalt", (0.045, 0.047, 0.05)),
    "bicycles": ("Cycle track", (0.13, 0.07, 0.055)),
    "pedestrians": ("Footway", (0.17, 0.165, 0.155)),
}
_NO_LANE = Lane("", "")
_PART = "blender_lidar_part"  # custom property: what of the road an object is; of the collection, what its ground has

Polygons = list[tuple[np.ndarray, float | np.ndarray, str]]
"""Outlines (k, 2) [m], counter-clockwise, with how high they lie above the road's surface [m] and of what material."""


def build_road(
    scene: bpy.types.Scene, road: RoadMap, xy: Sequence[float], reach_m: float, verge_m: float = _VERGE_M
) -> None:
    """The road within reach of a place [m, site frame], with its markings, and the verge beside it, so wide.

    They are children of the road frame, and take the place of an earlier road.
    """
    into, frame = collection(scene, "Road", ROAD_ROLE), road_frame(scene)
    clear(into)
    made = {name: _mottled(plain(name, colour, ROAD, 0.85), 0.25) for name, colour in ASPHALTS.values()}
    made |= {"Verge": _mottled(plain("Verge", VERGE, ROAD, 1.0), 0.35), "Lane line": plain("Lane line", LINE)}
    if road.endless:
        parts = _straight(road, road.stretch(xy, reach_m), verge_m)
    else:
        parts = _mapped(road, np.asarray(xy), reach_m, verge_m)
    parts = {name: polygons for name, polygons in parts.items() if polygons}
    for name, polygons in parts.items():
        of = MARKING if name == "Lane lines" else ROAD_ROLE
        add_object(into, name, _flat_mesh(name, road, polygons, made), of, frame)[_PART] = name
    into[_PART] = ", ".join(name for name in parts if name != "Lane lines")


def road_collection(scene: bpy.types.Scene) -> bpy.types.Collection | None:
    """The collection of a scene's road where one has been built."""
    found = (one for one in scene.collection.children_recursive if role(one) == ROAD_ROLE and one.get(_PART))
    return next(found, None)


def hidden_ground(scene: bpy.types.Scene, layer: bpy.types.ViewLayer) -> list[str]:
    """The parts of a scene's ground, such as Surface and Verge, that a view layer or renders hide, or that are gone."""
    into = road_collection(scene)
    shown = {item.get(_PART) for item in into.objects if is_shown(scene, layer, item)} if into else set()
    return [name for name in into[_PART].split(", ") if name not in shown] if into else []


def show_ground(scene: bpy.types.Scene, layer: bpy.types.ViewLayer, *, shown: bool) -> None:
    """Hide a scene's ground with its markings in view and renders, or show it where all of it is hidden."""
    into = road_collection(scene)
    if into and not (shown and len(hidden_ground(scene, layer)) < len(into[_PART].split(", "))):
        for item in (one for one in into.objects if _PART in one):
            item.hide_viewport = item.hide_render = not shown
            if shown and item.name in layer.objects:
                item.hide_set(False, view_layer=layer)


def middle_of(road: RoadMap, xy: Sequence[float], reach_m: float) -> np.ndarray:
    """What a camera at a place looks at, (2,) [m]: the middle of a road without ends, the nearest junction or lane."""
    if road.endless:
        return road.at(road.locate(np.array([xy])).s_m[0], np.mean(road.edges_t))
    middles = np.array([junction.outline_m.mean(axis=0) for junction in road.junctions]).reshape(-1, 2)
    near = middles[np.hypot(*(middles - xy).T) <= reach_m]
    places = near if len(near) else road.nearest(xy)
    return places[np.hypot(*(places - xy).T).argmin()]


def _flat_mesh(name, road, polygons: Polygons, materials):
    """Polygons as one mesh."""
    parts = [np.column_stack([line, road.surface.height(line) + above]) for line, above, _ in polygons]
    vertices = np.concatenate(parts)
    faces = np.split(np.arange(len(vertices)), np.cumsum([len(part) for part in parts])[:-1])
    names, slots = np.unique([material for *_, material in polygons], return_inverse=True)
    return new_mesh(name, vertices, faces, [materials[one] for one in names], slots)


def _mottled(material, by):
    """Let a material be lighter and darker from place to place by a share, and fade into the haze far away."""
    tree = material.node_tree
    shader = next(one for one in tree.nodes if one.type == "BSDF_PRINCIPLED")
    colour = shader.inputs["Base Color"]
    if colour.is_linked:
        return material
    place = node(tree, "ShaderNodeTexCoord").outputs["Object"]
    patches = output(tree, "ShaderNodeTexNoise", {"Vector": place, "Scale": 0.15, "Detail": 3.0})
    share = math_of(tree, "MULTIPLY_ADD", patches, 3.0, -1.0)  # noise keeps to its middle
    ends = [[channel * (1.0 + sign * by) for channel in colour.default_value[:3]] for sign in (-1, 1)]
    tree.links.new(ramp_of(tree, share, ends), colour)
    far = math_of(tree, "DIVIDE", node(tree, "ShaderNodeCameraData").outputs["View Distance"], _HAZE_FROM_M)
    clear_air = math_of(tree, "POWER", 0.4, math_of(tree, "MULTIPLY", far, far))
    haze = output(tree, "ShaderNodeEmission", {"Color": (*HAZE, 1.0)})
    both = output(tree, "ShaderNodeMixShader", {0: clear_air, 1: haze, 2: shader.outputs[0]})
    tree.links.new(both, next(one for one in tree.nodes if one.type == "OUTPUT_MATERIAL").inputs["Surface"])
    return light_nothing(material)


# --- A straight road: carriageways with shoulders between two stations -----------------------------------------------


def _straight(road: RoadMap, s_m: tuple[float, float], verge_m: float) -> dict[str, Polygons]:
    """Carriageways with their crowns and shoulders, verges, and lines from station to station."""
    edges, between = (np.array([road.locate(line[:1]).t_m[0] for line in lines]) for lines in road.lines(s_m))
    carriageways = np.sort(edges).reshape(-1, 2)
    asphalt, verges, free = [], [], carriageways[0, 0] - verge_m
    half_medians = 0.5 * (carriageways[1:, 0] - carriageways[:-1, 1])
    shoulders = np.minimum(_SHOULDER_M, [_SHOULDER_M, *half_medians, _SHOULDER_M])
    for (low, high), right, left in zip(carriageways, shoulders[:-1], shoulders[1:], strict=True):
        verges.append((free, low - right))
        crown = [] if road.surface.is_flat else [low, 0.5 * (low + high), high]
        asphalt += itertools.pairwise([low - right, *crown, high + left])
        free = high + left
    verges.append((free, carriageways[-1, 1] + verge_m))
    half = 0.5 * _LINE_WIDTH_M
    painted = [(*s_m, t - half, t + half) for t in edges]
    for s in np.arange(s_m[0], s_m[1] - _DASH_M, _DASH_EVERY_M).tolist():
        painted += [(s, s + _DASH_M, t - half, t + half) for t in between]
    return {
        "Verge": _strips(road, [(*s_m, *ends) for ends in verges if ends[1] - ends[0] > _LINE_WIDTH_M], 0.0, "Verge"),
        "Surface": _strips(road, [(*s_m, *ends) for ends in asphalt], 0.0, "Asphalt"),
        "Lane lines": _strips(road, painted, _LINE_ABOVE_M, "Lane line"),
    }


def _strips(road, strips, above_m, material) -> Polygons:
    """Quads from station to station and from offset to offset [m], (first, last, right, left) each."""
    first, last, right, left = np.array(strips, dtype=float).T
    corners = np.stack([road.at(s, t) for s, t in ((first, right), (last, right), (last, left), (first, left))], axis=1)
    return [(quad, above_m, material) for quad in corners]


# --- A mapped road: lanes with ends, and the areas of junctions ------------------------------------------------------


def _mapped(road: RoadMap, xy: np.ndarray, reach_m: float, verge_m: float) -> dict[str, Polygons]:
    """Lanes within reach of a place, junctions and markings; of a driven area, which has no lanes, its outlines."""
    ends = _within_reach(road, xy, reach_m)
    sides = {row: np.array_split(road.area([row], ends[row])[0], 2) for row in ends}
    sides = {row: (right, left[::-1]) for row, (right, left) in sides.items()}
    areas = [one.outline_m for one in road.junctions if len(one.outline_m) > 2 and _reaches(one.outline_m, xy, reach_m)]
    covered = {junction.name for junction in road.junctions if len(junction.outline_m) > 2}
    surface = [(one, 0.0, "Asphalt") for one in ([] if len(road) else road.area()) if _reaches(one, xy, reach_m)]
    for number, (row, (right, left)) in enumerate(sides.items()):
        lane, above = _lane(road, row), 0.0
        if lane.junction:
            if lane.use == "vehicles" and lane.junction in covered:
                continue
            above = (_PATH_ABOVE_M if lane.junction in covered else 0.0) + _CROSSING_ABOVE_M * (1 + number % 40)
        quads = np.stack([right[:-1], right[1:], left[1:], left[:-1]], axis=1)
        surface += [(quad, above, ASPHALTS[lane.use][0]) for quad in quads]
    outer = reach_m + verge_m
    lowest = min([road.surface.height(outline).min() for outline, *_ in surface], default=0.0)
    verge = xy + outer * np.array([(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)])
    return {
        "Verge": [(verge, min(lowest, 0.0) + _VERGE_ABOVE_M - road.surface.height(verge), "Verge")],
        "Surface": surface,
        "Junctions": [(_counter_clockwise(area), _JUNCTION_ABOVE_M, "Asphalt") for area in areas],
        "Lane lines": [(bar, _LINE_ABOVE_M, "Lane line") for bar in _painted(road, ends, sides)],
    }


def _lane(road: RoadMap, row: int) -> Lane:
    return road.lanes[row] if road.lanes else _NO_LANE


def _within_reach(road: RoadMap, xy: np.ndarray, reach_m: float) -> dict[int, tuple[float, float]]:
    """Of each lane that comes within reach of a place, from which station to which [m]."""
    found = {}
    for row, line in enumerate(road.points_m):
        step, off = np.diff(line, axis=0), xy - line[:-1]
        length = np.hypot(*step.T)
        along = (off * step).sum(axis=1) / length
        half = np.sqrt((reach_m**2 - np.square(off).sum(axis=1) + along**2).clip(0.0))
        low, high = (end.clip(0.0, length) for end in (along - half, along + half))
        part = np.flatnonzero(high > low)
        if len(part):
            station = road.stations(lane=row)
            found[row] = float(station[part[0]] + low[part[0]]), float(station[part[-1]] + high[part[-1]])
    return found


def _reaches(outline: np.ndarray, xy: np.ndarray, reach_m: float) -> bool:
    """Whether the box about an outline comes within reach of a place."""
    return bool(np.hypot(*(xy - xy.clip(outline.min(axis=0), outline.max(axis=0)))) <= reach_m)


def _counter_clockwise(outline: np.ndarray) -> np.ndarray:
    x, y = (outline - outline[0]).T  # the shoelace formula
    return outline if (x * np.roll(y, -1) - y * np.roll(x, -1)).sum() > 0.0 else outline[::-1]


def _painted(road: RoadMap, ends: dict, sides: dict) -> list[np.ndarray]:
    """Markings of the lanes between junctions, as quads: solid edges, dashes between lanes, and stop lines."""
    rows = [row for row in sides if not _lane(road, row).junction and _lane(road, row).use != "pedestrians"]
    bars, between, crossings = [], _part(road, rows), _crossings(road)
    for row, (right, left) in ((row, sides[row]) for row in rows):
        found, same_way = _beside(between, right, left, against=road.against[row])
        for side, there, same in zip((right, left), found, same_way, strict=True):
            other = rows[there] if there >= 0 else row
            if other < row:  # which draws it
                continue
            if other > row and same and _lane(road, row).use == _lane(road, other).use:
                bars += _dashes(side)
            else:
                bars += _bars(side[:-1], side[1:], _LINE_WIDTH_M)
        end = 0 if road.against[row] else -1
        whole = abs(ends[row][end] - road.stations(lane=row)[end]) < _LINE_WIDTH_M
        enters = any(_lane(road, other).junction in crossings for other in _lane(road, row).leads_to)
        if whole and enters and _lane(road, row).use == "vehicles":
            middle = right + left
            behind = 0.5 * _STOP_LINE_M * _unit(middle[end] - middle[1 if end == 0 else -2])
            bars += _bars((right[end] - behind)[None], (left[end] - behind)[None], _STOP_LINE_M)
    return bars


def _crossings(road: RoadMap) -> set[str]:
    """Junctions that have stop lines: those with signals, or into which three roads lead or more."""
    led = {}
    for lane in road.lanes:
        for junction in {road.lanes[row].junction for row in lane.leads_to} - {"", lane.junction}:
            led.setdefault(junction, set()).add(lane.road)
    signalised = {junction.name for junction in road.junctions if junction.signalised}
    return signalised | {junction for junction, roads in led.items() if len(roads) > 2}


def _beside(lanes: RoadMap, right: np.ndarray, left: np.ndarray, *, against: bool) -> tuple[np.ndarray, np.ndarray]:
    """The lanes beyond the middles of a lane's sides, -1 for none, and which of them go its way, (2,) each."""
    at = (len(right) - 1) // 2
    along = _unit((right + left)[at + 1] - (right + left)[at])
    out = _BESIDE_M * np.array([along[1], -along[0]])
    middles = [0.5 * (side[at] + side[at + 1]) for side in (right, left)]
    found = lanes.locate(np.array([middles[0] + out, middles[1] - out]))
    turn = found.heading_rad - np.arctan2(along[1], along[0]) - np.pi * against
    return found.lane, np.cos(turn) > 0.0


def _unit(vector: np.ndarray) -> np.ndarray:
    return vector / np.hypot(*vector)


def _part(road: RoadMap, rows: list[int]) -> RoadMap:
    """Some lanes of a road alone, to look for places on them."""
    own = {key: getattr(road, key)[rows] for key in ("station_m", "offset_m", "width_m", "against")}
    lines, widths = (tuple(of[row] for row in rows if of) for of in (road.points_m, road.widths_m))
    return replace(road, points_m=lines, widths_m=widths, lanes=(), junctions=(), **own)


def _dashes(line: np.ndarray) -> list[np.ndarray]:
    """A broken line along a line (k, 2), as quads."""
    station = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(line, axis=0).T))])
    first = np.arange(0.0, station[-1] - _DASH_M, _DASH_EVERY_M)
    start, end = (np.stack([np.interp(s, station, axis) for axis in line.T], axis=1) for s in (first, first + _DASH_M))
    return _bars(start, end, _LINE_WIDTH_M)


def _bars(start: np.ndarray, end: np.ndarray, width_m: float) -> list[np.ndarray]:
    """Quads of a width about segments, from (m, 2) to (m, 2) [m]."""
    step = end - start
    length = np.hypot(*step.T).clip(1e-9)  # of none the quad has no area
    left = np.stack([-step[:, 1], step[:, 0]], axis=1) * (0.5 * width_m / length)[:, None]
    return list(np.stack([start - left, end - left, end + left, start + left], axis=1))
