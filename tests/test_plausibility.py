"""What cannot be true of traffic stops a run, by name; what is real or generated does not; accepted is reported."""

from __future__ import annotations

import json
import math
import os
import subprocess
from pathlib import Path

import numpy as np
import pytest

import blender_lidar as bl
from blender_lidar.errors import InputError
from blender_lidar.names import WARNINGS
from blender_lidar.scene.plausibility import CHECKS, checked_recording
from blender_lidar.scene.scenario import load_scenario, shipped_scenes
from blender_lidar.scene.site import prepare, read_recording
from blender_lidar.traffic import read_traffic
from tests import traffic_samples as ngsim
from tests.refusals import refused
from tests.small_scene import HEADER, cli, done, traffic_rows, without_charts, write_scene, write_table
from tests.waiting import WAIT_S

NGSIM = Path(__file__).parents[2] / "shared" / "data" / "ngsim"
COLUMN = {name: place for place, name in enumerate(HEADER)}


def table(**changes):
    """The usual rows with columns changed: each by a function of the row as a mapping."""
    rows = traffic_rows()
    for row in rows:
        given = dict(zip(HEADER, row, strict=True))
        for name, change in changes.items():
            row[COLUMN[name]] = change(given)
    return rows


def times(factor, *names):
    return {name: lambda row, name=name: row[name] * factor for name in names}


def turned(row, by_deg):
    """A place turned about the road's middle at 5.5 m."""
    angle = math.radians(by_deg)
    x, y = row["x_m"], row["y_m"] - 5.5
    return x * math.cos(angle) - y * math.sin(angle), 5.5 + x * math.sin(angle) + y * math.cos(angle)


def scene_of(folder, rows, changes=None):
    folder.mkdir(parents=True, exist_ok=True)
    write_table(folder / "traffic.csv", rows)
    return write_scene(folder, changes)


def road_at(degrees, heading_deg=None, swapped=False):
    """The usual rows on a road in this direction, counter-clockwise from +x; headings along it unless given."""
    names = ("y_m", "x_m") if swapped else ("x_m", "y_m")
    changes = {name: lambda row, axis=axis: turned(row, degrees)[axis] for axis, name in enumerate(names)}
    return table(heading_deg=lambda row: degrees if heading_deg is None else heading_deg, **changes)


def both_ways(rows, degrees):
    """The same with every other vehicle on its way back, on the road's other side."""
    for row in rows:
        if row[COLUMN["vehicle_id"]] % 2:
            back = turned({"x_m": -row[COLUMN["x_m"]], "y_m": 11.0 - row[COLUMN["y_m"]]}, degrees)
            row[COLUMN["x_m"]], row[COLUMN["y_m"]] = back
            row[COLUMN["heading_deg"]] = degrees - 180.0
        else:
            given = dict(zip(HEADER, row, strict=True))
            row[COLUMN["x_m"]], row[COLUMN["y_m"]] = turned(given, degrees)
            row[COLUMN["heading_deg"]] = degrees
    return rows


SIZES = ("length_m", "width_m", "height_m")
ACROSS = {"x_m": lambda row: turned(row, 50)[0], "y_m": lambda row: turned(row, 50)[1]}
TABLES = {  # by name: the rows, what warns and what it takes them for
    "sizes in feet": (table(**times(3.28084, *SIZES)), "sizes", "probably feet for metres"),
    "lengths and widths in feet": (table(**times(3.28084, *SIZES[:2])), "sizes", "probably another unit"),
    "sizes in centimetres": (table(**times(100.0, *SIZES[1:])), "sizes", "impossible sizes"),
    "half sizes": (table(**times(0.5, *SIZES)), "sizes", "probably another unit"),
    "heights of nothing": (table(height_m=lambda row: 0.01), "sizes", "impossible sizes"),
    "length and width swapped": (
        table(length_m=lambda row: row["width_m"], width_m=lambda row: row["length_m"]),
        "sizes",
        "a median car is 1.8 by 4.4 by 1.5 m (usual: 2.6 to 8 by 1.1 to 2.8 by 0.9 to 2.8 m)",
    ),
    "half a turn": (table(heading_deg=lambda row: 180.0), "headings", "probably reversed, by half a turn"),
    "a compass": (table(heading_deg=lambda row: 90.0), "headings", "probably clockwise from north"),
    "radians": (table(heading_deg=lambda row: math.radians(50), **ACROSS), "headings", "probably radians for degrees"),
    "radians on both carriageways": (
        table(
            x_m=lambda row: row["x_m"] * (-1) ** row["vehicle_id"],
            heading_deg=lambda row: math.pi * (row["vehicle_id"] % 2),
        ),
        "headings",
        "probably radians for degrees",
    ),
    "clockwise": (table(heading_deg=lambda row: -50.0, **ACROSS), "headings", "probably clockwise, or y mirrored"),
    "milliseconds": (table(**times(1000.0, "time_s")), "time-step", "or a jam crawls"),
    "frame numbers for seconds": (table(**times(25.0, "time_s")), "time-step", "or a jam crawls"),
    "a tenth of the time": (table(**times(0.1, "time_s")), "time-step", "with frames 0.2 s apart"),
    "places in feet of traffic at 15 m/s": (
        table(x_m=lambda row: 3.28 * 1.5 * row["x_m"], y_m=lambda row: 3.28 * row["y_m"]),
        "time-step",
        "places are not in metres",
    ),
    "the other side": (table(y_m=lambda row: -row["y_m"]), "carriageway", "the side (y mirrored, or half a turn)"),
    "a road that lies across the file's axes": (
        table(heading_deg=lambda row: 50.0, **ACROSS),
        "carriageway",
        "probably [traffic] heading_deg = 50",
    ),
    **{
        f"a road at {degrees} degrees": (
            road_at(degrees),
            "carriageway",
            f"probably [traffic] heading_deg = {degrees}, the direction of travel in the file",
        )
        for degrees in (8, -57, 146)
    },
    "a road at 20 degrees that is driven both ways": (
        both_ways(table(), 20.0),
        "carriageway",
        "drive at 20 degrees to the road's x axis",
    ),
    "a compass on a road at 33 degrees": (road_at(33, heading_deg=57), "headings", "probably clockwise from north"),
    "x and y swapped on a road at 33 degrees": (road_at(33, swapped=True), "headings", "or x and y are swapped"),
    "headings of another axis": (road_at(0, heading_deg=12), "headings", "measured from another axis than x_m"),
    "vehicles there twice": (
        [
            [*row[:1], row[1] + 100 * again, *row[2:3], row[3] + 0.3 * again, *row[4:]]
            for row in table()
            for again in (0, 1)
        ],
        "overlaps",
        "vehicles are listed twice under different ids",
    ),
}


@pytest.mark.parametrize("case", TABLES)
def test_what_cannot_be_true_of_a_table_stops_with_its_name_and_what_is_probably_meant(case, tmp_path, capsys):
    rows, name, meant = TABLES[case]
    scene = scene_of(tmp_path, rows)
    line = refused(capsys, tmp_path, "optimise", scene, "--out", tmp_path / "run")
    assert meant in line
    assert line.endswith(f"if traffic and scene are right as they are, go on with --accept {name}")
    accepted = list(dict.fromkeys([name, "carriageway"]))  # what was turned for a case lies across the road too
    warnings = read_recording(load_scenario(write_scene(tmp_path, {"traffic": {"accept": accepted}}))).report.warnings
    assert warnings[0][0] == name
    assert len(warnings) == 1


@pytest.mark.parametrize(
    ("metres", "message"),
    [
        ((), None),
        (("Local_X", "Local_Y", "v_Length", "v_Width"), r"v_Length and v_Width in metres, where NGSIM.*--accept sizes"),
        (("v_Length", "v_Width"), r"v_Length and v_Width in metres, where NGSIM's columns.*--accept sizes"),
    ],
)
def test_ngsim_with_metres_where_it_has_feet_stops(metres, message, tmp_path):
    given = ngsim.columns(vehicles=40, frames=60)
    ngsim.write(tmp_path, ngsim.native(given | {name: (given[name] * 0.3048).round(3) for name in metres}))
    scene = load_scenario(write_scene(tmp_path, {"traffic": {"path": "recording.txt"}, "road": {"lanes": 6}}))
    if message is None:
        assert read_recording(scene).report.warnings == ()
    else:
        with pytest.raises(InputError, match=message):
            read_recording(scene)


EXACT = {("model", "caster"): ("exact", "x")}  # which is there without any extra


STRETCH = {("region", "stretches"): ([{"x_m": [-40.0, 40.0]}], "x"), ("region", "centre_m"): (None, "x")}
STRETCH |= {("region", "radius_m"): (None, "x")}


RS_80 = {("sensor", "name"): ("RS-80", "x")}


@pytest.mark.parametrize(("changes", "edge_m"), [({}, 36.0), (STRETCH, 36.0), (RS_80, 72.0)])
def test_a_carriageway_that_lies_beside_its_vehicles_stops(changes, edge_m):
    message = r"check \[road\] right_edge_m, in metres .*: vehicles drive at Local_X.*--accept carriageway"
    with pytest.raises(InputError, match=message):
        prepare(load_scenario("i80", {**EXACT, **changes, ("road", "right_edge_m"): (edge_m, "x")}))


def test_a_region_where_nobody_drives_says_where_vehicles_are(tmp_path):
    with pytest.raises(InputError) as caught:
        prepare(load_scenario("i80", {**EXACT, ("road", "station_m"): (1650.0, "x")}))
    text = str(caught.value)
    assert "in the road frame vehicles drive at x -1630 to -1174 m, y 3 to 22 m" in text
    assert "check [road] station_m (such as 226)" in text
    assert "--accept" not in text  # there is nothing to judge


def test_vehicles_against_the_travel_on_the_carriageway_are_told(tmp_path):
    rows = traffic_rows()
    notes = read_recording(load_scenario(scene_of(tmp_path / "one way", rows))).report.notes
    assert not any("against the direction of their lane" in note for note in notes)
    notes = read_recording(load_scenario(scene_of(tmp_path / "two ways", both_ways(table(), 0.0)))).report.notes
    message = [note for note in notes if "drive against the direction of their lane, and they count" in note]
    assert len(message) == 1
    assert 40 <= int(message[0].split()[0]) <= 60


HEIGHTS = {  # of z_m, by the row, and whether they are refused
    "floors": (lambda row: 0.0, True),
    "tops": (lambda row: row[7], True),
    "above sea": (lambda row: 212.0, True),
    "middles": (lambda row: 0.5 * row[7], False),
}


@pytest.mark.parametrize("case", HEIGHTS)
def test_heights_that_are_not_of_the_middles_stop(case, tmp_path):
    height, refused = HEIGHTS[case]
    write_table(tmp_path / "traffic.csv", [[*row, height(row)] for row in traffic_rows()], (*HEADER, "z_m"))
    scene = load_scenario(write_scene(tmp_path))
    if not refused:
        assert read_recording(scene).report.warnings == ()
    else:
        with pytest.raises(
            InputError, match=r"probably z_m is the height of floors or tops, or above sea level.*--accept sizes"
        ):
            read_recording(scene)


@pytest.mark.parametrize(("shift_m", "message"), [(0.0, False), (4.0, True)])
def test_vehicles_beside_a_stretch_of_the_carriageway_are_told(shift_m, message, tmp_path):
    write_table(tmp_path / "traffic.csv", table(y_m=lambda row: row["y_m"] + shift_m))
    region = {"region": {"stretches": [{"x_m": [-40.0, 40.0]}]}}
    accepted = {"traffic": {"accept": ["carriageway"]}}
    notes = read_recording(load_scenario(write_scene(tmp_path, {**region, **accepted}))).report.notes
    assert any("and do not count" in note for note in notes) is message


def stream(number, heading_deg, y_m, every_s, speed_m_s=10.0, x_m=0.0):
    """Rows of vehicles that drive through (x_m, y_m), one after another."""
    cos, sin = math.cos(math.radians(heading_deg)), math.sin(math.radians(heading_deg))
    rows = []
    for frame in range(300):
        for place in range(int(300 / every_s)):
            along = speed_m_s * (frame - place * every_s) * 1.0
            if abs(along) < 60.0:
                x, y = x_m + along * cos, y_m + along * sin
                ident = 1000 * number + place
                rows.append([frame, ident, "car", round(x, 3), round(y, 3), 4.4, 1.8, 1.5, heading_deg, 1.0 * frame])
    return rows


STRETCHES = {"region": {"stretches": [{"x_m": [-50.0, 50.0]}], "centre_m": None, "radius_m": None}}
SIDE_TRAFFIC = {  # what is busier than the road that is asked about
    "a minor approach that an arterial crosses": stream(1, 0, 5.5, 15.0)
    + stream(2, 90, 0.0, 1.5, x_m=35.0)
    + stream(3, -90, 0.0, 1.5, x_m=39.0),
    "a ramp beside a motorway": stream(1, 0, 5.5, 12.0)
    + stream(2, -12, 40.0, 1.5, speed_m_s=30.0)
    + stream(3, -12, 44.0, 1.5, speed_m_s=30.0),
    "a ramp beside a jam": stream(1, 0, 5.5, 12.0) + stream(2, 0, 22.0, 1.5, speed_m_s=3.0),
    "tidal traffic": stream(1, 0, 5.5, 15.0) + stream(2, 180, 16.5, 1.2),
}


@pytest.mark.parametrize("region", [REGION_50 := {"region": {"centre_m": [0.0, 0.0], "radius_m": 50.0}}, STRETCHES])
@pytest.mark.parametrize("case", SIDE_TRAFFIC)
def test_busier_traffic_beside_the_road_stops_nothing(case, region, tmp_path):
    write_table(tmp_path / "traffic.csv", SIDE_TRAFFIC[case])
    region = {"region": {key: value for key, value in region["region"].items() if value is not None}}
    assert read_recording(load_scenario(write_scene(tmp_path, region))).report.warnings == ()


@pytest.mark.parametrize("sigma_m", [0.2, 0.5])
def test_positions_of_a_tracker_with_noise_stop_nothing(sigma_m, tmp_path):
    rng = np.random.default_rng(6)
    rows = [
        [frame, number, "car", 20.0 * number - 160.0 + frame + x, 5.5 + y, 4.4, 1.8, 1.5, 0.0, 0.1 * frame]
        for number in range(10)
        for frame, (x, y) in enumerate(rng.normal(0.0, sigma_m, (60, 2)))
    ]
    assert "headings" not in [name for name, _ in _warned(tmp_path, rows)]


def _warned(folder, rows):
    write_table(folder / "traffic.csv", rows)
    return read_recording(load_scenario(write_scene(folder, {"traffic": {"accept": list(WARNINGS)}}))).report.warnings


def test_what_is_kept_out_is_not_told_to_count(tmp_path):
    oncoming = [[-100.0, 2.0], [100.0, 2.0], [100.0, 5.0], [-100.0, 5.0]]
    region = {"region": {"stretches": [{"x_m": [-40.0, 40.0]}], "keep_out": [oncoming]}}
    write_table(tmp_path / "traffic.csv", stream(1, 0, 7.0, 5.0) + stream(2, 180, 3.5, 5.0))
    for kept_out in (True, False):
        if not kept_out:
            del region["region"]["keep_out"]
        notes = read_recording(load_scenario(write_scene(tmp_path, region))).report.notes
        assert any("against the direction of their lane" in note for note in notes) is not kept_out


# --- No stop without a cause ----------------------------------------------------------------------------------------


def all_checks(path, changes=None, folder=None, **settings):
    """The names of what all checks find in a file, under the default [road] unless said."""
    scene = folder / "scene.toml"
    given = write_scene(folder, {"traffic": {"path": str(path), **settings}, **(changes or {})})
    assert given == scene
    return [name for name, _ in checked_recording(*_read(scene)).report.warnings]


def _read(scene):
    scenario = load_scenario(scene, {("traffic", "accept"): (list(WARNINGS), "x")})
    given = {"origin_m": scenario.recordings[0].origin_m, "heading_deg": scenario.recordings[0].heading_deg}
    given["vehicle_types"] = scenario.recordings[0].vehicle_types
    recording = read_traffic(scenario.recordings[0].path, road=scenario.road, **{k: v for k, v in given.items() if v})
    return recording, scenario


def test_real_and_shipped_recordings_are_believed(tmp_path):
    paths = sorted(path for path in NGSIM.glob("*.*") if path.is_file())
    if not paths:
        pytest.skip("the NGSIM excerpts of ../shared/data are not here")
    for path in paths:
        changes = {"road": {"lanes": 6}, "sensor": {"range_gate_m": 100.0}}
        assert all_checks(path, changes, tmp_path) == [], path
        recording, scenario = _read(tmp_path / "scene.toml")
        assert checked_recording(recording, scenario).report.notes == recording.report.notes, path


@pytest.mark.parametrize("name", shipped_scenes())
def test_shipped_scenes_are_believed(name):
    if name.startswith("crossing"):
        pytest.importorskip("sumolib", reason="sumolib is not installed")
    report = read_recording(load_scenario(name)).report
    assert report.warnings == ()
    assert report.notes == ()


@pytest.mark.parametrize("kinds", [("passenger", "bus", "truck"), ("motorcycle", "bicycle")])
def test_what_sumo_writes_of_a_town_is_believed(kinds, tmp_path):
    """Crossings with traffic lights and turning vehicles, a second from frame to frame."""
    home = Path(pytest.importorskip("sumo", reason="SUMO is not installed").SUMO_HOME)
    environment = os.environ | {"SUMO_HOME": str(home)}

    def run(program, *options):
        command = [str(home / "bin" / program), *options, "--xml-validation", "never"]
        subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, timeout=WAIT_S, check=True)

    net = "--grid --grid.number 3 --grid.length 120 --default.lanenumber 2 --tls.guess --output-file net.xml"
    run("netgenerate", *net.split())
    ends = ("A0A1", "A1B1", "B2C2", "C1B1", "C2C1", "B1B0", "A2B2", "C0B0")
    trips = (
        f'<trip id="{number}" type="{kinds[number % len(kinds)]}" depart="{number}" from="{ends[number % 8]}" '
        f'to="{ends[(3 * number + 1 + number // 8) % 8]}"/>'
        for number in range(120)
    )
    types = "".join(f'<vType id="{kind}" vClass="{kind}"/>' for kind in kinds)
    (tmp_path / "r.xml").write_text(f"<routes>{types}{''.join(trips)}</routes>", encoding="utf-8")
    run(
        "sumo",
        *[
            "--net-file",
            "net.xml",
            "--route-files",
            "r.xml",
            "--fcd-output",
            "run.xml",
            "--end",
            "180",
            "--no-step-log",
        ],
    )
    road = {"road": {"lanes": 2}, "sensor": {"range_gate_m": 80.0}}
    assert all_checks("run.xml", road, tmp_path, origin_m=[60.0, 110.0], vehicle_types="r.xml") == []


def test_a_jam_that_stands_and_a_single_frame_are_believed(tmp_path):
    standing = table(x_m=lambda row: 15.0 * row["vehicle_id"] - 300.0)
    for rows in (standing, [row for row in traffic_rows() if row[0] == 30]):
        found = read_recording(load_scenario(scene_of(tmp_path, rows))).report.warnings
        assert found == ()


def test_labelled_sweeps_whose_frames_are_unrelated_are_believed(tmp_path):
    """As of KITTI: other vehicles in each frame, that point anywhere, under ids of their own."""
    rng = np.random.default_rng(5)
    rows = [
        [frame, 50 * frame + number, "car", x, y, 3.9, 1.6, 1.5, rng.uniform(-180, 180), 0.1 * frame]
        for frame in range(30)
        for number, (x, y) in enumerate(rng.uniform([-40, 2], [40, 40], (12, 2)).tolist())
    ]
    assert read_recording(load_scenario(scene_of(tmp_path, rows))).report.warnings == ()


# --- Accepting -------------------------------------------------------------------------------------------------------


def test_every_name_is_a_check_and_an_unknown_one_is_refused(tmp_path, capsys):
    assert tuple(dict.fromkeys(check.name for check in CHECKS if check.name)) == WARNINGS
    scene = scene_of(tmp_path, traffic_rows())
    line = refused(capsys, tmp_path, "optimise", scene, "--accept", "heading", "--out", tmp_path / "run")
    assert "--accept" in line
    assert "headings" in line


@pytest.mark.parametrize("how", ["option", "scene key"])
def test_what_is_accepted_stands_first_in_all_that_a_run_leaves(how, tmp_path, capsys, monkeypatch):
    without_charts(monkeypatch)
    accepted = {"traffic": {"accept": ["carriageway", "sizes"]}} if how == "scene key" else {}
    rows = table(y_m=lambda row: -row["y_m"] - 9.0, **times(3.28084, *SIZES))
    scene = scene_of(tmp_path, rows, accepted)
    words = ("--accept", "carriageway", "--accept", "sizes") if how == "option" else ()
    out, _ = done(capsys, "evaluate", scene, "--height", 4, *words, "--out", tmp_path / "run")
    text = " ".join(out.split())
    first = [f"Warning, accepted ({name}): " for name in ("sizes", "carriageway")]
    message = text[text.index(first[0]) :]
    assert message.index(first[1]) < message.index("4.00 m above the road")
    result = json.loads((tmp_path / "run" / "result.json").read_text(encoding="utf-8"))
    assert [one["name"] for one in result["warnings"]] == ["sizes", "carriageway"]
    sheet = (tmp_path / "run" / "installation.txt").read_text(encoding="utf-8")
    page = (tmp_path / "run" / "report.html").read_text(encoding="utf-8")
    for start in first:
        assert sheet.index(start) < sheet.index("Height")
        assert page.index(start) < page.index("4.00 m above the road")
    again, _ = done(capsys, "evaluate", tmp_path / "run" / "scene.toml", "--height", 4, "--json")
    assert json.loads(again)["warnings"] == result["warnings"]


def test_python_accepts_and_tells_too(tmp_path):
    scene = scene_of(tmp_path, TABLES["half a turn"][0])
    with pytest.raises(InputError, match="--accept headings"):
        bl.load_scene(scene)
    run = bl.judge_mounting(bl.load_scene(scene, accept=["headings"]), height_m=4.0)
    assert str(run).startswith("Warning, accepted (headings): ")
    assert run.report().split("\n\n")[1].startswith("  ! Warning, accepted (headings): ")


def test_scans_stop_too_and_tell_what_is_accepted(tmp_path, capsys):
    scene = scene_of(tmp_path, TABLES["half a turn"][0])
    words = "scan", scene, "--frame", 3, "--out", tmp_path / "cloud.npz"
    assert cli(capsys, *words)[0] == 2
    assert done(capsys, *words, "--accept", "headings")[0].startswith("Warning, accepted (headings): ")


def test_a_queue_on_a_street_oblique_to_a_maps_x_is_no_camera_that_drifts(tmp_path):
    angle, rows = math.radians(10.0), []
    for number in range(8):  # that crawls at 1 m/s
        for frame in range(0, 900, 2):
            s = -15.0 + 0.1 * frame - 7.5 * number
            place = s * math.cos(angle), s * math.sin(angle)
            rows.append([frame, number + 1, "car", *place, 4.5, 1.8, 1.5, 10.0, 0.1 * frame])
    for number in range(30):
        for frame in range(0, 100, 2):
            if (later := frame + 30 * number) < 900:
                rows.append([later, 100 + number, "car", 10.0, -50.0 + frame, 4.5, 1.8, 1.5, 90.0, 0.1 * later])
    write_table(tmp_path / "p.csv", rows)
    settings = {
        "traffic": {"path": str(tmp_path / "p.csv"), "frames": 4, "holdout": 0.0, "accept": ["overlaps", "time-step"]},
        "road": {"driven": True},
        "region": {"centre_m": [0.0, 0.0], "radius_m": 40.0},
        "deployment": {"x_m": -10.0, "y_m": 20.0},
        "model": {"workers": 1},
    }
    assert "drift" not in dict(bl.load_scene(settings).recording.report.warnings)


def test_where_nobody_drives_a_map_is_not_told_of_a_straight_roads_keys(tmp_path):
    write_table(tmp_path / "p.csv", traffic_rows())
    settings = {
        "traffic": {"path": str(tmp_path / "p.csv"), "frames": 4, "holdout": 0.0},
        "road": {"driven": True},
        "region": {"centre_m": [0.0, 60.0], "radius_m": 20.0},
        "deployment": {"x_m": 0.0, "y_m": -3.0},
        "model": {"workers": 1},
    }
    with pytest.raises(InputError, match=r"check \[traffic\] origin_m and heading_deg, and \[region\]") as caught:
        bl.load_scene(settings)
    assert "setback_m" not in str(caught.value)
