"""The scene that ``blender-lidar init`` proposes: its template, and what fills it for a straight road and for a map."""

from __future__ import annotations

import csv
import io
import math
import os
import re
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from string import Template
from typing import NamedTuple

import numpy as np

from ..names import SIDES
from ..report.plan import Stand
from ..report.site_plan import plot_mapped_plan, plot_site_plan, road_text
from ..road.settings import map_of
from ..scene.deployment import Facing
from ..scene.place_checks import grades_percent
from ..scene.region import region_of
from ..scene.scenario import load_scenario
from ..scene.settings import RegionSettings
from ..toml_table import to_toml
from ..traffic import Recording
from ..traffic.lanes import LANE_WIDTHS_M
from ..traffic.layout import SETBACK_M, RoadLayout
from ..traffic.site_layout import APPROACH_M, SiteLayout
from ..traffic.vehicles import counted

SCENE, PICTURE, POLES = "scene.toml", "scene.png", "poles.csv"

# A line is left out where a field of it has no value, and is there once for each entry of a list. ${road}, ${map} and
# the like at the start of a line are conditions: empty, or without a value.
TEMPLATE = """\
# Where should a LiDAR hang $place? Proposed from $vehicles.
# Check it by eye: $picture shows it. Any number may be changed; docs/reference/scene_file.md explains all.
# Note: $note
# Road frame: x in the direction of travel at the pole, y to the left, metres; the pole stands at x = 0, y = $pole_y.
${map}# Site frame: the axes of the map, metres; its origin is the middle of the site.

[traffic]
period = $period
location = $location
path = $path
vehicle_types = $vehicle_types
format = "$format"
${kerb}# The pole's foot, in the file's own metres: $side of the densest stretch, no end or crossing near it.
# Across the road from the pole's foot, which is at $foot in the file's own metres: $side of the
${across}# densest stretch, no end or crossing near it.
${placed}# The file follows this carriageway $extent.
origin_m = $file_origin_m
${placed}# Direction of travel in the file, counter-clockwise from its x axis: the one in which lanes are sharpest.
heading_deg = $heading_deg
# frames = 30    # searched, spread over the first part of the recording
# holdout = 0.4  # share of the recording, at its end, that is held out as a check

[road]
net = $net
opendrive = $opendrive
driven = $driven  # no map: the road is where the recorded vehicles drive
origin_m = $origin_m  # of the site frame, in the $frame's own metres
${ngsim}# Local_Y of the pole, in metres: the densest stretch, away from its ends.
${ngsim}# The file follows this carriageway $extent.
station_m = $station_m
right_edge_m = $right_edge_m  # Local_X, in metres: half a lane beyond the rightmost lane's centre
drives_on = "$side"  # $shown_by
carriageways = $carriageways  # the other one drives against x
median_m = $median_m  # between the edges of both; their lanes are alike
setback_m = $setback_m  # from the pole to the edge of the road: $setback_reason
lanes = $lanes  # centres measured at y $centres m$lane_numbers; add those that nobody used
lane_width_m = $lane_width_m  # $lane_width_reason
grade_percent = $grade_percent  # how the file's heights rise along x about the region

${road}# Where vehicles count, the same for every mounting: all lanes from one x to another. Or a circle,
${road}# centre_m = [0.0, 0.0] with radius_m = 50.0, or an outline, polygon_m = [[x, y], [x, y], [x, y]].
${crossing}# Where vehicles count: in the junction, and on the last metres of the approaches to it. These are
#   $approach
${crossing}# approaches = ["...", "..."] takes some of them; polygon_m or centre_m with radius_m any other area.
${circle}# Where vehicles count: in a circle. Or in an outline, polygon_m = [[x, y], [x, y], [x, y]].
[region]
stretches = [{ x_m = [$from_m.0, $to_m.0] }]
junction = $junction
approach_m = $approach_m
centre_m = $centre_m
radius_m = $radius_m

[sensor]
name = "RS-16"  # `blender-lidar sensors` lists the others
range_gate_m = $gate_m  # so far it should see vehicles; the $farthest

${map}# Corners, islands and medians off the lanes; each mast faces the middle of the region. Strike out those
${map}# that cannot be. A number fixes a coordinate, a pair [low, high] has it searched.
${road}# A number fixes a coordinate, a pair [low, high] has it searched.
[deployment]
${road}x_m = 0.0  # along the road
${road}side = "$side"  # the kerb, setback_m beside the road
# y_m = $beside_m  # a place of your own on that side: a metre farther from the road
${divided}# side = "median"  # the middle between both carriageways
${road}# side = "gantry"  # over the lanes: height_m, and that of [baseline], from clearance_m = 5.0 on
poles = $poles
${road}height_m = [2.0, 4.5]  # what your pole allows
${map}height_m = [2.0, 6.0]  # what your poles allow
${road}tilt_x_deg = [0.0, 25.0]  # down to where the mast faces, the road
${map}tilt_x_deg = [0.0, 25.0]  # down to where the mast faces
# installer = { tilt_deg = 0.5, height_m = 0.05, yaw_deg = 2.0 }  # how nearly as planned it will hang

${road}# What gains are measured against.
${map}# What gains are measured against: the pole nearest to the middle.
[baseline]
height_m = 2.0

[search]
seed = 1
"""
_GATE_STEP_M = 5.0
_AXES = {"ngsim": ("Local_Y", "-Local_X"), "sumo": ("x of the net", "y of the net"), "table": ("x_m", "y_m")}


class Proposal(NamedTuple):
    """A proposed scene.

    Attributes
    ----------
    fields : mapping
        What the template is filled with.
    draw : callable
        Draws the picture into a folder that has the scene.
    rows : list of (str, str)
        What is said of it.
    placed : Recording
        Its traffic, in the frame of the scene.
    poles : str
        Their table, of a scene on a map.
    """

    fields: Mapping[str, object]
    draw: Callable[[Path], object]
    rows: list[tuple[str, str]]
    placed: Recording
    poles: str = ""


def filled(fields: Mapping[str, object]) -> str:
    """The scene: the template with fields."""
    lines = []
    for line in TEMPLATE.splitlines():
        names = [name[0] or name[1] for name in re.findall(r"\$(?:(\w+)|{(\w+)})", line)]
        values = {name: fields.get(name) for name in names}
        if None not in values.values():
            several = next((name for name in names if isinstance(values[name], list | tuple)), None)
            each = values[several] if several else [None]
            lines += [Template(line).substitute(values | {several or "": one}) for one in each]
    return "\n".join([*lines, ""])


def text_value(text: str) -> str:
    """A text in TOML; backslashes, of Windows, in literal quotes, where they mean themselves."""
    if "\\" in text and "'" not in text and text.isprintable():
        return f"'{text}'"
    return to_toml({"t": {"t": text}}).partition(" = ")[2].rstrip("\n")


def path_value(path: object, folder: Path) -> str:
    """A path as the scene has it: from its folder where it lies below, else absolute."""
    path, folder = Path(os.path.abspath(path)), Path(os.path.abspath(folder))  # noqa: PTH100 - links stay links
    below = path.is_relative_to(folder)
    return text_value(path.relative_to(folder).as_posix() if below else str(path))


def traffic_fields(given: Mapping[str, object], kind: str, folder: Path) -> dict[str, object]:
    """[traffic]: the recording and how it is read."""
    said = {key: text_value(value) for key, value in given.items() if key not in ("path", "vehicle_types")}
    files = [path_value(file, folder) for file in given.get("vehicle_types", ())]
    types = (files[0] if len(files) == 1 else f"[{', '.join(files)}]") if files else None
    return {**said, "path": path_value(given["path"], folder), "vehicle_types": types, "format": kind}


def _if(condition: object) -> str | None:
    return "" if condition else None


def _gate_m(farthest_m: float) -> float:
    return _GATE_STEP_M * math.ceil((farthest_m + 1.0) / _GATE_STEP_M)


def _traffic_rows(recording: Recording, kind: str) -> list[tuple[str, str]]:
    seconds = float(np.ptp(recording.frame_time_s))
    return [
        ("Traffic", f"{recording.source}: {kind}, {counted(len(recording.frames), 'frame')} in {seconds:.0f} s"),
        *(("", line) for line in recording.report.lines(losses=True)),
        *(("Assumed", text) for text in recording.report.assumed),
    ]


# --- A straight road --------------------------------------------------------------------------------------


def straight_scene(recording: Recording, layout: RoadLayout, kind: str) -> Proposal:
    """The scene of a pole beside a straight road, where a recording follows it."""
    road, is_ngsim, both_ways = layout.road, kind == "ngsim", layout.road.carriageways == 2
    low, high = math.floor(layout.stretch_m[0]), math.ceil(layout.stretch_m[1])
    ground = recording.report.ground
    ground = np.column_stack([layout.T_file_site.inverse.points(ground[:, :2]), ground[:, 2]])
    grades = grades_percent(ground, 0.5 * (low + high))
    grade = 0.0 if grades is None else round(0.5 * sum(grades), 1) + 0.0
    across = np.abs(np.subtract(map_of(road).edges_t, layout.pole_y)).max()
    corner = max(math.hypot(along, across) for along in (low, high))
    passing = f"{layout.vehicles + layout.oncoming:,} vehicles that pass the pole"
    passing += f", {layout.oncoming:,} of them the other way" if layout.oncoming else ""
    beside = road.place(road.drives_on)[0] + (1.0 if road.drives_on == SIDES[1] else -1.0)
    fields = {
        "road": "",
        "place": "beside this road",
        "vehicles": passing,
        "picture": PICTURE,
        "note": [note.replace("\n", "\n#   ") for note in layout.notes],
        "pole_y": f"{layout.pole_y:g}",
        "side": road.drives_on,
        "shown_by": layout.shown_by,
        "extent": "from x {:.0f} to {:.0f} m".format(*layout.extent_m),
        "carriageways": 2 if both_ways else None,
        "median_m": road.median_m if both_ways else None,
        "divided": _if(both_ways),
        "setback_m": road.setback_m,
        "setback_reason": "usual"
        if road.setback_m == SETBACK_M
        else f"at {SETBACK_M:g} m the pole would stand in traffic",
        "lanes": road.lanes,
        "lane_width_m": road.lane_width_m,
        **_lane_reasons(layout),
        "grade_percent": grade or None,
        "from_m": low,
        "to_m": high,
        "gate_m": _gate_m(corner),
        "farthest": f"region's farthest corner is {corner:.0f} m away",
        "beside_m": f"{beside:g}",
    }
    if is_ngsim:
        placed = layout.ngsim_road()
        fields |= {"ngsim": "", "station_m": placed.station_m, "right_edge_m": placed.right_edge_m}
    else:
        fields |= {"placed": "", "kerb": _if(not layout.pole_y), "across": _if(layout.pole_y)}
        fields |= {"foot": "[{:.2f}, {:.2f}]".format(*layout.pole_m) if layout.pole_y else None}
        fields |= {"file_origin_m": _list_value(layout.origin_m), "heading_deg": layout.heading_deg}
    (x, y), heading = layout.pole_m, "" if is_ngsim else f", heading {layout.heading_deg + 0.0:g} deg"
    of_file = {"ngsim": f"Local_Y {x:.0f} m", "sumo": f"x {x:.1f}, y {y:.1f} m of the net"}
    place = of_file.get(kind, f"x {x:.1f}, y {y:.1f} m of the table")
    rows = [
        *_traffic_rows(recording, kind),
        ("Road", f"{road_text(road)}{heading}, from {passing}"),
        *([("Slope", f"{grade:+.1f} % along x, as the file's heights rise: grade_percent")] if grade else []),
        ("Pole", f"at {place}, {road.setback_m:g} m to the {road.drives_on} of the road"),
        ("Region", f"x {low} to {high} m of all lanes"),
        *(("Note", note.replace("\n", "\n" + 11 * " ")) for note in layout.notes),
    ]
    centre, turn = recording.centre_m.copy(), layout.T_file_site.inverse
    centre[:, :2] = turn.points(centre[:, :2])
    placed = replace(recording, centre_m=centre, heading_rad=turn.headings(recording.heading_rad))
    placed = replace(placed, report=replace(recording.report, ground=ground))
    axes = _AXES.get(kind, ("x", "y"))
    return Proposal(fields, lambda folder: plot_site_plan(recording, layout, folder / PICTURE, axes), rows, placed)


def _lane_reasons(layout: RoadLayout) -> dict[str, str]:
    """Where lanes were measured, and what their width comes from."""
    numbers, widths = "", np.diff(layout.lane_y)
    if layout.lane_numbers:  # those of another carriageway are not known
        numbers = f", the file's lanes {', '.join(map(str, layout.lane_numbers))}"
        numbers += " along x" if layout.road.carriageways == 2 else ""
    widths = widths[widths <= LANE_WIDTHS_M[1]]  # without the median
    reason = "usual; it cannot be measured from one lane"
    if len(widths):
        reason = f"from lane centres {widths.min():.2f} to {widths.max():.2f} m apart"
    centres = ", ".join(f"{one:.1f}" for one in layout.lane_y)
    return {"centres": centres, "lane_numbers": numbers, "lane_width_reason": reason}


def _list_value(numbers) -> str:
    """Numbers as a list in TOML."""
    return f"[{', '.join(map(str, numbers))}]"


# --- A site on a map --------------------------------------------------------------------------------------


def site_scene(site: SiteLayout, kind: str, folder: Path) -> Proposal:
    """The scene of a junction or a stretch of a map, or of where vehicles drove, with candidate poles."""
    settings, junction, driven = site.settings, site.junction, site.settings.driven
    key = next(key for key in ("net", "opendrive", "driven") if getattr(settings, key))
    turn = np.linspace(0.0, math.tau, 64)
    corners = np.array(site.middle_xy) + site.radius_m * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    if junction is not None:
        region = region_of(RegionSettings(junction=junction.name, approach_m=APPROACH_M), site.road)
        corners = np.concatenate(region.outlines)
    farthest = max(float(np.hypot(*(corners - (pole.x_m, pole.y_m)).T).max()) for pole in site.poles)
    frame = "recording" if driven else "map"
    fields = {
        "map": "",
        "place": "at this stretch" if junction is None and not driven else "at this intersection",
        "vehicles": f"{counted(site.vehicles, 'vehicle')} that drive there",
        "picture": PICTURE,
        "note": site.notes,
        key: "true" if driven else path_value(settings.path, folder),
        "origin_m": _list_value(settings.origin_m),
        "frame": frame,
        "crossing": _if(junction is not None),
        "approach": site.approaches,
        "circle": _if(junction is None),
        "junction": None if junction is None else text_value(junction.name),
        "approach_m": None if junction is None else APPROACH_M,
        "centre_m": _list_value(site.middle_xy) if junction is None else None,
        "radius_m": site.radius_m if junction is None else None,
        "gate_m": _gate_m(farthest),
        "farthest": f"farthest is {farthest:.0f} m from a pole",
        "poles": text_value(POLES),
    }
    x, y = np.add(settings.origin_m, site.middle_xy)
    place = f"{site.radius_m:g} m about x {x:.1f}, y {y:.1f} m of the {frame}"
    if junction is not None:
        approaches = "1 approach" if len(site.approaches) == 1 else f"{len(site.approaches)} approaches"
        place = f"junction {junction.name}, and the last {APPROACH_M:g} m of {approaches}"
    rows = [
        *_traffic_rows(site.recording, kind),
        ("Road", "where the recorded vehicles drive; no map" if driven else settings.path),
        ("Region", f"{place}; {counted(site.vehicles, 'vehicle')}"),
        ("Middle", f"x {x:.1f}, y {y:.1f} m of the {frame}"),
        ("Poles", f"{len(site.poles)}, off the lanes, facing the middle: {', '.join(one.name for one in site.poles)}"),
        *(("Note", note) for note in site.notes),
    ]
    table = io.StringIO()
    csv.writer(table, lineterminator="\n").writerows([("name", "x_m", "y_m"), *site.poles])
    return Proposal(fields, lambda folder: _draw_site(site, folder), rows, site.recording, table.getvalue())


def _draw_site(site: SiteLayout, folder: Path) -> None:
    """Draw the site's plan, with the region that its scene has."""
    region = region_of(load_scenario(folder / SCENE).region, site.road)
    facing = Facing(towards_m=region.centre_xy)
    stands = [Stand(name, (x, y), math.radians(facing.at((x, y), site.road))) for name, x, y in site.poles]
    ways = site.movement if (site.movement != "").any() else None
    plot_mapped_plan(folder / PICTURE, site.road, region.outlines, stands, site.recording, ways=ways)
