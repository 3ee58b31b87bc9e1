"""``blender-lidar init``: a scene for a recording of one's own, proposed from where its vehicles drive."""

from __future__ import annotations

import argparse
import importlib.util
import math
import os
import shlex
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ..csv_header import is_parquet
from ..errors import InputError, MissingExtraError, MissingFileError, one_line, unknown_name
from ..files import check_folder, check_unused, make_folder, whole_file, write_text
from ..names import SIDES, TRAFFIC_FORMATS
from ..report.site_plan import plot_site_plan, road_text
from ..road.settings import RoadSettings, map_of
from ..scene.place_checks import grades_percent
from ..scene.plausibility import checked_recording
from ..scene.scenario import load_scenario, shipped_scenes
from ..scene.settings import TrafficSettings
from ..toml_table import settings_of, to_toml
from ..traffic import Recording, format_of, read_traffic, write_table
from ..traffic.lanes import LANE_WIDTHS_M
from ..traffic.layout import SETBACK_M, RoadLayout, propose_layout
from ..traffic.site_layout import SiteLayout, is_crossing, propose_site
from ..traffic.sumo_types import SumoConfig, is_config, read_config
from ..traffic.vehicles import counted
from .init_site import POLES, draw_site, site_summary, write_site
from .options import check_scipy, given_options

SCENE, PICTURE, RECORDING, TABLE = "scene.toml", "scene.png", "run.fcd.xml.gz", "traffic.csv"
EXAMPLE = "example"
OPTIONS = ("period", "location", "vehicle_types")
_SAMPLE = "i80_sample.csv.gz"
_AXES = {
    "ngsim": ("Local_Y", "-Local_X"),
    "sumo": ("x of the net", "y of the net"),
    "table": ("x_m", "y_m"),
}
_GATE_STEP_M = 5.0
_FCD_PERIOD_S = 0.5


def run(args: argparse.Namespace) -> int:
    """Read the traffic, propose a road, write the scene and its picture; returns the exit code."""
    check_scipy("init")
    folder = Path(args.folder)
    kind, path = _source(args)
    settings = settings_of(TrafficSettings)
    given = given_options(args, {key: settings[key] for key in OPTIONS})
    asked = _asked(args)
    types = ()
    if is_config(path):
        config = read_config(path)
        _check(folder, [path, *config.types])
        net = config.net if asked.settings.driven else None  # a map that is given counts before
        asked = asked if net is None else asked._replace(settings=RoadSettings(net=str(net)))
        path, types = _recorded(path, config, folder), config.types
    if types and "vehicle_types" not in given:
        given["vehicle_types"] = types
    for file in [one for one in given.get("vehicle_types", ()) if is_config(one)]:
        given["vehicle_types"] = [*read_config(file).types, *(one for one in given["vehicle_types"] if one != file)]
    maps = [Path(asked.settings.path)] if asked.settings.path else []
    _check(folder, [path, *map(Path, given.get("vehicle_types", ())), *maps])
    kind = format_of(path) if kind == TRAFFIC_FORMATS[0] else kind
    unplaced = RoadSettings(station_m=0.0, right_edge_m=0.0, setback_m=0.0)
    recording = read_traffic(path, format=kind, road=unplaced, **given)
    follows_x, kerb_lane = kind == "ngsim", kind == "sumo"
    if is_parquet(path):  # which Blender does not read
        if (folder / TABLE).exists():
            raise InputError(f"FOLDER: {folder}: holds a {TABLE} already, and nothing is overwritten; give another one")
        make_folder(folder, "FOLDER")
        path, kind, given = folder / TABLE, "table", {}
        write_table(path, recording)
        print(f"blender-lidar: note: {path} holds the recording as Blender reads it too", file=sys.stderr)
    recording = recording.vehicles_alone
    if not asked.settings.driven or asked.at or asked.junction or (not follows_x and is_crossing(recording)):
        if follows_x:
            raise InputError("--net, --road, --at and --junction: do not apply to NGSIM, whose roads are straight")
        return _run_site(propose_site(recording, *asked), kind, {"path": path, **given}, folder)
    layout = propose_layout(recording, follows_x=follows_x, kerb_lane=kerb_lane)
    make_folder(folder, "FOLDER")
    text = scene_text(recording, layout, kind, {"path": path, **given}, folder)
    write_text(folder / SCENE, text)
    written = [str(folder / SCENE)]
    try:
        plot_site_plan(recording, layout, folder / PICTURE, _AXES.get(kind, ("x", "y")))
        written.append(str(folder / PICTURE))
    except MissingExtraError as error:
        print(f"blender-lidar: note: no picture: {error}", file=sys.stderr)
    print(_summary(recording, layout, kind, written))
    _check_plausible(recording, layout, folder / SCENE)
    return 0


def _check_plausible(recording: Recording, layout: RoadLayout, scene: Path) -> None:
    """Say, while it is the file's turn to be put right, what would stop a run of the scene, and what is suspicious."""
    centre = recording.centre_m.copy()
    centre[:, :2] = layout.T_file_site.inverse.points(centre[:, :2])
    placed = replace(recording, centre_m=centre, heading_rad=layout.T_file_site.inverse.headings(recording.heading_rad))
    placed = replace(placed, report=replace(recording.report, ground=_ground(recording, layout)))
    _tell_suspicious(placed, scene)


def _tell_suspicious(placed: Recording, scene: Path) -> None:
    """The same of a recording in the frame of its scene."""
    try:
        checked = checked_recording(placed, load_scenario(scene))
    except InputError as error:
        print(f"blender-lidar: note: a run will stop: {one_line(str(error))}", file=sys.stderr)
        return
    for note in checked.report.notes[len(placed.report.notes) :]:
        print(f"blender-lidar: note: {note}", file=sys.stderr)


def _ground(recording: Recording, layout: RoadLayout) -> np.ndarray:
    """The ground under the vehicles in the road frame, (n, 3) [m]."""
    ground = recording.report.ground
    return np.column_stack([layout.T_file_site.inverse.points(ground[:, :2]), ground[:, 2]])


def _source(args: argparse.Namespace) -> tuple[str, Path]:
    """The format, perhaps ``"auto"``, and the file."""
    words = [*(args.source or ()), *([args.file] if args.file is not None else ())]
    kinds = (*TRAFFIC_FORMATS, EXAMPLE)
    kind = words.pop(0) if words and args.source and words[0] in kinds else TRAFFIC_FORMATS[0]
    if kind == EXAMPLE and not words:
        return "ngsim", shipped_scenes()["i80"].with_name(_SAMPLE)
    if len(words) == 1 and kind != EXAMPLE:
        return kind, Path(words[0])
    if len(words) > 1 and args.source and kind == TRAFFIC_FORMATS[0]:
        raise unknown_name(words[0], kinds, "format", "--from")
    wanted = "no FILE" if kind == EXAMPLE else "one FILE of trajectories, or --from example"
    raise InputError(f"init: {len(words)} files given; allowed: {wanted}")


def _recorded(config: Path, named: SumoConfig, folder: Path) -> Path:
    """The recording that SUMO's configuration has written; where there is none yet, SUMO is run."""
    if named.data is not None and named.data.exists():
        return named.data
    program = _sumo()
    if program is None:
        missing = "names no fcd-output" if named.data is None else f"names {named.data}, which is not there"
        raise InputError(
            f"{config}: {missing}; write it with SUMO: sumo -c {shlex.quote(str(config))} --fcd-output run.fcd.xml; "
            f"then: blender-lidar init FOLDER --from sumo run.fcd.xml --vehicle-types {shlex.quote(str(config))}"
        )
    make_folder(folder, "FOLDER")
    path = folder / RECORDING
    print(f"blender-lidar: note: SUMO writes {path}", file=sys.stderr)
    with whole_file(path) as temporary:
        written = temporary.with_name(f"{temporary.name}.xml.gz")  # SUMO packs what ends so
        options = ["--fcd-output", written, "--device.fcd.period", _FCD_PERIOD_S, "--xml-validation", "never"]
        words = [str(program), "-c", str(config), *map(str, options), "--no-step-log", "--no-warnings"]
        try:
            done = subprocess.run(words, capture_output=True, text=True, check=False)
            if done.returncode:
                told = [line for line in done.stderr.splitlines() if line.startswith("Error")] or ["no reason given"]
                raise InputError(f"{config}: SUMO stopped: {one_line(told[0])}")
            written.replace(temporary)
        finally:
            written.unlink(missing_ok=True)
    return path


def _sumo() -> Path | None:
    """The program of SUMO: of the package eclipse-sumo, else of ``SUMO_HOME``, else on the path."""
    homes = [os.environ.get("SUMO_HOME", "")]
    if importlib.util.find_spec("sumo") is not None:
        homes.insert(0, getattr(importlib.import_module("sumo"), "SUMO_HOME", ""))
    folders = [str(Path(home, "bin")) for home in homes if home]
    found = shutil.which("sumo", path=os.pathsep.join([*folders, os.environ.get("PATH", "")]))
    return Path(found) if found else None


class SiteOptions(NamedTuple):
    """What the options ask for: a map, a junction by name, a place x, y [m]."""

    settings: RoadSettings
    junction: str | None
    at: tuple[float, float] | None


def _asked(args: argparse.Namespace) -> SiteOptions:
    if args.net and args.road:
        raise InputError(f"--net {args.net} and --road {args.road}: two maps; allowed: one")
    for path in filter(None, (args.net, args.road)):
        if not Path(path).exists():
            raise MissingFileError(f"{path}: there is no such file")
    at = None
    if args.at is not None:
        try:
            at = tuple(float(part) for part in args.at.split(","))
        except ValueError:
            at = ()
        if len(at) != 2 or not all(map(math.isfinite, at)):
            raise InputError(f"--at: is {args.at!r}; allowed: X,Y in the map's metres")
    maps = {key: str(path) for key, path in (("net", args.net), ("opendrive", args.road)) if path}
    return SiteOptions(RoadSettings(**(maps or {"driven": True})), args.junction, at)


def _run_site(site: SiteLayout, kind: str, given: dict[str, object], folder: Path) -> int:
    """Write the scene, poles and picture of a site on a map; returns the exit code."""
    make_folder(folder, "FOLDER")
    traffic = [*_traffic_lines(given, kind, folder)]
    write_site(site, folder, SCENE, PICTURE, traffic, lambda path: _path(path, folder))
    written = [str(folder / SCENE), str(folder / POLES)]
    try:
        draw_site(site, folder / SCENE, folder / PICTURE)
        written.append(str(folder / PICTURE))
    except MissingExtraError as error:
        print(f"blender-lidar: note: no picture: {error}", file=sys.stderr)
    print(site_summary(site, kind, written))
    _tell_suspicious(site.recording, folder / SCENE)
    return 0


def _check(folder: Path, inputs: list[Path]) -> None:
    """Refuse a folder with a scene, or with anything but the files that the scene will name."""
    check_folder(folder, "FOLDER")
    if (folder / SCENE).exists():
        raise InputError(f"FOLDER: {folder}: holds a {SCENE} already, and nothing is overwritten; give another folder")
    parts = [Path(os.path.relpath(path.absolute(), folder.absolute())).parts[0] for path in inputs]
    check_unused(folder, "FOLDER", "init", lambda path: path.name in parts)


# --- The scene as text ------------------------------------------------------------------------------------------------


def scene_text(recording: Recording, layout: RoadLayout, kind: str, given: dict[str, object], folder: Path) -> str:
    """A scene file with a comment for each proposed number: what it came from, and how to change it."""
    low, high = _region_m(layout)
    if kind == "ngsim":
        for key, known in (("period", recording.report.periods), ("location", recording.report.locations)):
            if len(known) > 1:
                given.setdefault(key, getattr(recording.report, key))
    grade = _grade_percent(recording, layout)
    across = np.abs(np.subtract(map_of(layout.road).edges_t, layout.pole_y)).max()
    corner = max(math.hypot(along, across) for along in (low, high))
    gate = _GATE_STEP_M * math.ceil((corner + 1.0) / _GATE_STEP_M)
    lines = [
        f"# Where should a LiDAR hang beside this road? Proposed from {_passing(layout)}.",
        f"# Check it by eye: {PICTURE} shows it. Any number may be changed; docs/reference/scene_file.md explains all.",
        *("# Note: " + note.replace("\n", "\n#   ") for note in layout.notes),
        "# Road frame: x in the direction of travel at the pole, y to the left, metres; the pole stands at x = 0, "
        f"y = {layout.pole_y:g}.",
        "",
        "[traffic]",
        *_traffic_lines(given, kind, folder),
        *([] if kind == "ngsim" else _placing_lines(layout)),
        "# frames = 30    # searched, spread over the first part of the recording",
        "# holdout = 0.4  # share of the recording, at its end, that is held out as a check",
        "",
        *_road_lines(layout, kind),
        *([f"grade_percent = {grade}  # how the file's heights rise along x about the region"] if grade else []),
        "",
        "# Where vehicles count, the same for every mounting: all lanes from one x to another. Or a circle,",
        "# centre_m = [0.0, 0.0] with radius_m = 50.0, or an outline, polygon_m = [[x, y], [x, y], [x, y]].",
        "[region]",
        f"stretches = [{{ x_m = [{low}.0, {high}.0] }}]",
        "",
        "[sensor]",
        'name = "RS-16"  # `blender-lidar sensors` lists the others',
        f"range_gate_m = {gate}  # so far it should see vehicles; the region's farthest corner is {corner:.0f} m away",
        "",
        "# A number fixes a coordinate, a pair [low, high] has it searched.",
        "[deployment]",
        "x_m = 0.0  # along the road",
        *_side_lines(layout.road),
        "height_m = [2.0, 4.5]  # what your pole allows",
        "tilt_x_deg = [0.0, 25.0]  # down to where the mast faces, the road",
        "# installer = { tilt_deg = 0.5, height_m = 0.05, yaw_deg = 2.0 }  # how nearly as planned it will hang",
        "",
        "# What gains are measured against.",
        "[baseline]",
        "height_m = 2.0",
        "",
        "[search]",
        "seed = 1",
        "",
    ]
    return "\n".join(lines)


def _traffic_lines(given: dict[str, object], kind: str, folder: Path) -> list[str]:
    """[traffic]: the recording and how it is read."""
    said = {key: _text(value) for key, value in given.items() if key not in ("path", "vehicle_types")}
    said["path"] = _path(given["path"], folder)
    if files := [_path(file, folder) for file in given.get("vehicle_types", ())]:
        said["vehicle_types"] = files[0] if len(files) == 1 else f"[{', '.join(files)}]"
    return [*(f"{key} = {value}" for key, value in said.items()), f'format = "{kind}"']


def _passing(layout: RoadLayout) -> str:
    both = f", {layout.oncoming:,} of them the other way" if layout.oncoming else ""
    return f"{layout.vehicles + layout.oncoming:,} vehicles that pass the pole{both}"


def _placing_lines(layout: RoadLayout) -> list[str]:
    side = layout.road.drives_on
    lines = [f"# The pole's foot, in the file's own metres: {side} of the densest stretch, no end or crossing near it."]
    if layout.pole_y:
        foot = "[{:.2f}, {:.2f}]".format(*layout.pole_m)
        lines = [
            f"# Across the road from the pole's foot, which is at {foot} in the file's own metres: {side} of the",
            "# densest stretch, no end or crossing near it.",
        ]
    return [
        *lines,
        f"# The file follows this carriageway {_extent(layout)}.",
        f"origin_m = [{', '.join(map(str, layout.origin_m))}]",
        "# Direction of travel in the file, counter-clockwise from its x axis: the one in which lanes are sharpest.",
        f"heading_deg = {layout.heading_deg}",
    ]


def _road_lines(layout: RoadLayout, kind: str) -> list[str]:
    road, widths = layout.road, np.diff(layout.lane_y)
    centres = ", ".join(f"{one:.1f}" for one in layout.lane_y)
    along = " along x" if road.carriageways == 2 else ""  # those of the other one are not known
    numbers = f", the file's lanes {', '.join(map(str, layout.lane_numbers))}{along}" if layout.lane_numbers else ""
    widths = widths[widths <= LANE_WIDTHS_M[1]]  # without the median
    apart = f"from lane centres {widths.min():.2f} to {widths.max():.2f} m apart" if len(widths) else ""
    why = "usual" if road.setback_m == SETBACK_M else f"at {SETBACK_M:g} m the pole would stand in traffic"
    lines = ["[road]", *(_station_lines(layout) if kind == "ngsim" else [])]
    lines.append(f'drives_on = "{road.drives_on}"  # {layout.shown_by}')
    if road.carriageways == 2:
        lines += [
            "carriageways = 2  # the other one drives against x",
            f"median_m = {road.median_m}  # between the edges of both; their lanes are alike",
        ]
    return [
        *lines,
        f"setback_m = {road.setback_m}  # from the pole to the edge of the road: {why}",
        f"lanes = {road.lanes}  # centres measured at y {centres} m{numbers}; add those that nobody used",
        f"lane_width_m = {road.lane_width_m}  # {apart or 'usual; it cannot be measured from one lane'}",
    ]


def _grade_percent(recording: Recording, layout: RoadLayout) -> float:
    """How the file's heights rise along x about the region [%]; 0 where they are not known."""
    grades = grades_percent(_ground(recording, layout), 0.5 * sum(_region_m(layout)))
    return 0.0 if grades is None else round(0.5 * sum(grades), 1) + 0.0


def _side_lines(road: RoadSettings) -> list[str]:
    y_m = road.place(road.drives_on)[0] + (1.0 if road.drives_on == SIDES[1] else -1.0)
    return [
        f'side = "{road.drives_on}"  # the kerb, setback_m beside the road',
        f"# y_m = {y_m:g}  # a place of your own on that side: a metre farther from the road",
        *(['# side = "median"  # the middle between both carriageways'] if road.carriageways == 2 else []),
        '# side = "gantry"  # over the lanes: height_m, and that of [baseline], from clearance_m = 5.0 on',
    ]


def _station_lines(layout: RoadLayout) -> list[str]:
    road = layout.ngsim_road()
    return [
        "# Local_Y of the pole, in metres: the densest stretch, away from its ends.",
        f"# The file follows this carriageway {_extent(layout)}.",
        f"station_m = {road.station_m}",
        f"right_edge_m = {road.right_edge_m}  # Local_X, in metres: half a lane beyond the rightmost lane's centre",
    ]


def _region_m(layout: RoadLayout) -> tuple[int, int]:
    return math.floor(layout.stretch_m[0]), math.ceil(layout.stretch_m[1])


def _extent(layout: RoadLayout) -> str:
    return "from x {:.0f} to {:.0f} m".format(*layout.extent_m)


def _path(path: object, folder: Path) -> str:
    """A path as the scene has it: from its folder where it lies below, else absolute."""
    path, folder = Path(os.path.abspath(path)), Path(os.path.abspath(folder))  # noqa: PTH100 - links stay links
    below = path.is_relative_to(folder)
    return _text(path.relative_to(folder).as_posix() if below else str(path))


def _text(text: str) -> str:
    """A text in TOML; backslashes, of Windows, in literal quotes, where they mean themselves."""
    if "\\" in text and "'" not in text and text.isprintable():
        return f"'{text}'"
    return to_toml({"t": {"t": text}}).partition(" = ")[2].rstrip("\n")


# --- What is said -----------------------------------------------------------------------------------------------------


def _summary(recording: Recording, layout: RoadLayout, kind: str, written: list[str]) -> str:
    (x, y), road = layout.pole_m, layout.road
    seconds = float(np.ptp(recording.frame_time_s))
    of_file = {"ngsim": f"Local_Y {x:.0f} m", "sumo": f"x {x:.1f}, y {y:.1f} m of the net"}
    heading = "" if kind == "ngsim" else f", heading {layout.heading_deg + 0.0:g} deg"
    low, high = _region_m(layout)
    grade = _grade_percent(recording, layout)
    place = of_file.get(kind, f"x {x:.1f}, y {y:.1f} m of the table")
    lines = [
        ("Traffic", f"{recording.source}: {kind}, {counted(len(recording.frames), 'frame')} in {seconds:.0f} s"),
        *(("", line) for line in recording.report.lines(losses=True)),
        *(("Assumed", text) for text in recording.report.assumed),
        ("Road", f"{road_text(road)}{heading}, from {_passing(layout)}"),
        *([("Slope", f"{grade:+.1f} % along x, as the file's heights rise: grade_percent")] if grade else []),
        ("Pole", f"at {place}, {road.setback_m:g} m to the {road.drives_on} of the road"),
        ("Region", f"x {low} to {high} m of all lanes"),
        *(("Note", note.replace("\n", "\n" + 11 * " ")) for note in layout.notes),
        ("Written", ", ".join(written)),
    ]
    scene = shlex.quote(written[0])
    rows = [f"{name:<10} {text}" for name, text in lines]
    check = f"Look at {written[1]}, then:" if len(written) > 1 else "Next:"
    commands = [f"  blender-lidar evaluate {scene} --height 4 --tilt-x 15", f"  blender-lidar optimise {scene}"]
    return "\n".join([*rows, "", check, *commands])
