"""`blender-lidar init`: the proposed road is the one that was driven on, and the scene that is written runs at once."""

from __future__ import annotations

import csv
import gzip
import json
import math
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest

from blender_lidar.cli import main
from blender_lidar.commands.init_scene import filled, path_value, straight_scene, text_value
from blender_lidar.errors import InputError
from blender_lidar.road import RoadSettings
from blender_lidar.scene.provenance import run_identity
from blender_lidar.scene.scenario import load_scenario, shipped_scenes
from blender_lidar.scene.site import prepare, read_recording
from blender_lidar.toml_table import to_toml
from blender_lidar.traffic import read_traffic
from blender_lidar.traffic.layout import propose_layout
from tests import sumo_samples
from tests.small_scene import CASTER, HEADER, traffic_rows, without_charts, write_table

FOOT_M = 0.3048
NGSIM = Path(__file__).parents[2] / "shared" / "data" / "ngsim"
UNPLACED = RoadSettings(station_m=0.0, right_edge_m=0.0, setback_m=0.0)


def proposed(path, **settings):
    recording = read_traffic(path, road=UNPLACED)
    return propose_layout(recording, **settings)


def run(*words) -> int:
    return main([str(word) for word in words])


# --- Roads whose lanes are known --------------------------------------------------------------------------------------


def rows_on(heading_deg: float, across_m, *, every_s=6.0, until_s=60.0, at=(500.0, -200.0), seed=1, wanders=True):
    """Cars at 12 m/s on lanes a given way to the left of a line through `at`, wandering, one now and then changing."""
    ends_m = -150.0, 150.0
    rng = np.random.default_rng(seed)
    turn = math.radians(heading_deg)
    forward, left = np.array([math.cos(turn), math.sin(turn)]), np.array([-math.sin(turn), math.cos(turn)])
    rows = []
    for lane, across in enumerate(across_m):
        for number, start_s in enumerate(np.arange(-20.0, until_s, every_s)):
            off, changes = rng.normal(0.0, 0.25) * wanders, number % 7 == 0 and wanders
            for time in np.arange(0.0, until_s, 0.5):
                x = ends_m[0] + 12.0 * (time - start_s - 0.7 * lane)
                if ends_m[0] <= x <= ends_m[1]:
                    y = across + off + 0.15 * wanders * math.sin(x / 20.0)
                    if changes and len(across_m) > 1:
                        y += (across_m[lane - 1] - across) / (1.0 + math.exp(-x / 10.0))
                    place = np.array(at) + x * forward + y * left
                    given = {"id": f"{heading_deg:g}.{lane}.{number}", "angle": (90.0 - heading_deg) % 360.0}
                    given |= {"x": round(place[0], 2), "y": round(place[1], 2), "lane": f"road_{lane}"}
                    rows.append(sumo_samples.row(time, **given))
    return rows


def write_rows(path: Path, rows) -> Path:
    path.write_text(sumo_samples.xml(sorted(rows, key=lambda row: float(row["time"]))))
    return path


def across_of(layout, heading_deg, at=(500.0, -200.0)):
    """The right edge and the lane centres that a layout says, measured to the left of a line through `at`."""
    turn = math.radians(heading_deg)
    left = np.array([-math.sin(turn), math.cos(turn)])
    line = float((np.array(layout.origin_m) - at) @ left)
    road = layout.road
    edge = line + road.setback_m
    return edge, edge + road.lane_width_m * (np.arange(road.lanes) + 0.5)


@pytest.mark.parametrize("heading", [0.0, 33.0, 118.0, -160.0])
def test_lanes_and_edge_of_a_straight_road_are_found_whatever_its_heading(tmp_path, heading):
    lanes = [3.5 * (number + 0.5) for number in range(3)]
    layout = proposed(write_rows(tmp_path / "run.fcd.xml", rows_on(heading, lanes)))
    assert layout.heading_deg == pytest.approx(heading, abs=0.5)
    edge, centres = across_of(layout, heading)
    assert edge == pytest.approx(0.0, abs=1.0)
    assert centres == pytest.approx(lanes, abs=0.5)
    assert layout.lane_numbers == (1, 2, 3)
    assert abs(layout.origin_m[0] - 500.0) < 100.0


def test_lanes_are_found_without_lane_numbers_and_one_that_nobody_uses_counts(tmp_path):
    lanes = [1.6, 4.8, 11.2]
    rows = [{**row, "lane": ""} for row in rows_on(20.0, lanes)]
    layout = proposed(write_rows(tmp_path / "run.fcd.xml", rows))
    edge, centres = across_of(layout, 20.0)
    assert layout.lane_numbers == ()
    assert edge == pytest.approx(0.0, abs=1.0)
    assert centres == pytest.approx([1.6, 4.8, 8.0, 11.2], abs=0.5)


def test_a_vehicle_far_astray_does_not_hide_the_road(tmp_path):
    rows = rows_on(33.0, [1.75, 5.25])
    rows += [sumo_samples.row(time, id="astray", x=4e8 + 5.0 * time, y=-9e7 + 3.25 * time) for time in range(60)]
    edge, centres = across_of(proposed(write_rows(tmp_path / "run.fcd.xml", rows)), 33.0)
    assert edge == pytest.approx(0.0, abs=1.0)
    assert centres == pytest.approx([1.75, 5.25], abs=0.5)


def test_at_an_intersection_the_busiest_approach_is_proposed_and_the_others_are_told(tmp_path):
    rows = []
    for heading, every_s in ((10.0, 2.0), (190.0, 8.0), (100.0, 5.0), (280.0, 9.0)):
        rows += rows_on(heading, (-5.25, -1.75), every_s=every_s, seed=int(heading))
    layout = proposed(write_rows(tmp_path / "run.fcd.xml", rows))
    assert layout.heading_deg == pytest.approx(10.0, abs=0.5)
    edge, centres = across_of(layout, 10.0)
    assert edge == pytest.approx(-7.0, abs=1.0)
    assert centres == pytest.approx([-5.25, -1.75], abs=0.5)
    along = (np.array(layout.origin_m) - (500.0, -200.0)) @ (math.cos(0.1745), math.sin(0.1745))
    assert -60.0 < along < -7.0  # before the crossing, and not on it
    message = " ".join(layout.notes)
    assert "an intersection?" in message
    lines = (note.partition(":\n")[2] for note in layout.notes if "another carriageway" in note)
    others = sorted(tomllib.loads(scene)["traffic"]["heading_deg"] for scene in lines)
    assert others == pytest.approx([100.0], abs=0.5)  # and -80 is its own other carriageway, as -170 is that of 10
    assert (layout.road.carriageways, layout.road.median_m) == (2, pytest.approx(0.0, abs=0.5))


@pytest.mark.parametrize("radius_m", [60.0, 120.0, -150.0])
def test_a_bend_is_measured_however_sharp_it_is_and_is_one_carriageway(tmp_path, radius_m):
    """A loop has a tangent in every direction, and one carriageway."""
    rows = []
    for number in range(40):
        for time in np.arange(0.0, 60.0, 0.5):
            along = 10.0 * time - 12.0 * number
            if 0.0 <= along <= 4.5 * abs(radius_m):
                turn = along / radius_m
                x, y = radius_m * math.sin(turn), radius_m * (1.0 - math.cos(turn))
                rows.append(
                    sumo_samples.row(time, id=str(number), x=x, y=y, angle=90.0 - math.degrees(turn), lane="a_0")
                )
    layout = proposed(write_rows(tmp_path / "run.fcd.xml", rows))
    message = next(note for note in layout.notes if "bends" in note)
    assert float(message.split()[4]) == pytest.approx(math.degrees(50.0 / abs(radius_m)), abs=2.0)
    sagitta = max(abs(end) for end in layout.stretch_m) ** 2 / (2.0 * abs(radius_m))
    assert sagitta <= 1.1
    assert not any("another carriageway" in note for note in layout.notes)


def test_the_shipped_samples_lanes_and_edge_are_found():
    layout = proposed(shipped_scenes()["i80"].with_name("i80_sample.csv.gz"), follows_x=True)
    road = layout.ngsim_road()
    assert road.lanes == 6
    assert road.right_edge_m == pytest.approx(72 * FOOT_M, abs=1.0)
    centres = road.right_edge_m - road.lane_width_m * (np.arange(6) + 0.5)  # Local_X, lane 6 first
    assert centres == pytest.approx(12 * FOOT_M * np.array([5.5, 4.5, 3.5, 2.5, 1.5, 0.5]), abs=0.5)
    assert layout.lane_numbers == (6, 5, 4, 3, 2, 1)
    assert 202.3 < road.station_m < 450.0  # past the on-ramp


@pytest.mark.parametrize(
    ("name", "lanes"),
    [
        ("SYNTHETIC_sumo_i80_60s_ngsim18.txt.gz", 6),
        ("i80_0400-0415_lanes1-3_partial_18col.csv.gz", 3),
        ("i80_0400-0415_lanes1-3_partial_120s.csv", 3),
    ],
)
def test_lanes_and_edge_of_i80_are_found(name, lanes):
    if not (NGSIM / name).exists():
        pytest.skip("needs the shared recordings")
    layout = proposed(NGSIM / name, follows_x=True)
    road = layout.ngsim_road()
    assert road.lanes == lanes
    assert road.right_edge_m == pytest.approx(12 * FOOT_M * lanes, abs=1.0)
    centres = road.right_edge_m - road.lane_width_m * (np.arange(lanes) + 0.5)
    assert centres == pytest.approx(12 * FOOT_M * (lanes - np.arange(lanes) - 0.5), abs=0.5)


# --- Both ways, on either side of the road ----------------------------------------------------------------------------

KERB_M, MEDIAN_M, WIDE_M = (9.0, 5.5), 7.5, 3.5  # lane centres from the middle of the road, lane 0 first


def both_ways(side="right", heading=0.0, there=KERB_M, back=KERB_M, **how):
    """Traffic of both carriageways about a line, there and back; left-hand traffic is that of the right mirrored."""
    rows = rows_on(heading, [-y for y in there], **how)
    rows += rows_on(heading + 180.0, [-y for y in back], every_s=7.0, seed=2, **how)
    return rows if side == "right" else [mirrored(row) for row in rows]


def mirrored(row):
    turned = {"y": f"{-float(row['y']):.2f}", "angle": str((180.0 - float(row["angle"])) % 360.0)}
    return {**row, **turned, "lane": row["lane"]}


def table_of(path: Path, rows) -> Path:
    """The same as a table of boxes, 4.5 m long, without lanes."""
    numbers = {name: number for number, name in enumerate(dict.fromkeys(row["id"] for row in rows), start=1)}
    table = []
    for row in rows:
        time, turn = float(row["time"]), math.radians(90.0 - float(row["angle"]))
        place = float(row["x"]) - 2.5 * math.cos(turn), float(row["y"]) - 2.5 * math.sin(turn)
        table.append([round(2.0 * time), numbers[row["id"]], "car", *place, 4.5, 1.8, 1.5, math.degrees(turn), time])
    write_table(path, sorted(table))
    return path


def asked(path, **settings):
    return proposed(path, kerb_lane=path.suffix == ".xml", **settings)


@pytest.mark.parametrize("form", ["sumo", "table"])
@pytest.mark.parametrize("heading", [0.0, 118.0])
@pytest.mark.parametrize("side", ["right", "left"])
def test_both_carriageways_and_the_side_that_is_driven_on_are_found(form, heading, side, tmp_path):
    rows = both_ways(side, heading)
    path = write_rows(tmp_path / "run.fcd.xml", rows) if form == "sumo" else table_of(tmp_path / "t.csv", rows)
    layout = asked(path)
    road = layout.road
    assert (road.drives_on, road.carriageways, road.lanes) == (side, 2, 2)
    assert road.lane_width_m == pytest.approx(WIDE_M, abs=0.2)
    assert road.median_m == pytest.approx(MEDIAN_M, abs=0.5)
    assert layout.heading_deg == pytest.approx(heading if side == "right" else -heading, abs=0.5)
    turn, middle = math.radians(layout.heading_deg), (500.0, -200.0 if side == "right" else 200.0)
    off = (np.array(layout.pole_m) - middle) @ (-math.sin(turn), math.cos(turn))
    kerb = KERB_M[0] + 0.5 * WIDE_M + road.setback_m
    assert off == pytest.approx(-kerb if side == "right" else kerb, abs=0.3)
    assert layout.lane_y == pytest.approx(road.setback_m + 1.75 + np.array([0.0, 3.5, 14.5, 18.0]), abs=0.3)
    assert not any("another carriageway" in note for note in layout.notes)
    if form == "sumo":
        text = filled(straight_scene(read_traffic(path, road=UNPLACED), layout, form).fields)
        (lanes,) = (line for line in text.splitlines() if line.startswith("lanes"))
        assert f"the file's lanes {'1, 2' if side == 'right' else '2, 1'} along x;" in lanes


def test_carriageways_that_differ_are_one_and_another(tmp_path):
    """Three lanes beside two: the scene has the busier way, whose pole stands at its own kerb, and names the other."""
    for side in ("right", "left"):
        path = write_rows(tmp_path / f"{side}.fcd.xml", both_ways(side, there=(12.5, *KERB_M)))
        layout = asked(path)
        assert (layout.road.drives_on, layout.road.carriageways, layout.road.lanes) == (side, 1, 3)
        assert layout.pole_m[1] == pytest.approx((-216.25 if side == "right" else 216.25), abs=0.5)
        (other,) = (note.partition(":\n")[2] for note in layout.notes if "another carriageway" in note)
        assert tomllib.loads(other)["road"]["lanes"] == 2


def test_one_way_traffic_is_told_by_lane_numbers_from_the_kerb_alone(tmp_path):
    for side, layouts in (("right", rows_on(0.0, (1.75, 5.25))), ("left", rows_on(0.0, (5.25, 1.75)))):
        path = write_rows(tmp_path / f"{side}.fcd.xml", layouts)
        assert asked(path).road.drives_on == side
        assert not any("assumed" in note for note in asked(path).notes)
        unknown = proposed(table_of(tmp_path / f"{side}.csv", layouts))
        assert unknown.road.drives_on == "right"
        assert any("right-hand traffic is assumed" in note for note in unknown.notes)


@pytest.mark.parametrize("back", [KERB_M, ()])
def test_mirrored_traffic_gives_a_mirrored_scene_and_the_same_result(back, tmp_path, monkeypatch, capsys):
    """With two carriageways every vehicle of both counts."""
    without_charts(monkeypatch)
    results, how = [], ("--frames", 4, "--caster", CASTER, "--detail", "box", "--installer", "false", "--workers", 1)
    how += ("--json",)
    for side in ("right", "left"):
        folder = tmp_path / side
        path = write_rows(tmp_path / f"{side}.fcd.xml", both_ways(side, back=back, until_s=40.0, wanders=False))
        assert run("init", folder, "--from", "sumo", path) == 0
        capsys.readouterr()
        assert run("evaluate", folder / "scene.toml", "--height", 4, "--tilt-x", 12, *how, "--out", folder / "r") == 0
        results.append(json.loads(capsys.readouterr().out))
        rows = list(csv.DictReader((folder / "r" / "vehicles.csv").open()))
        scenario = load_scenario(folder / "scene.toml", {("model", "caster"): ("exact", "here")})
        assert scenario.road.carriageways == (2 if back else 1)
        site = prepare(scenario)
        low, high = scenario.region.stretches[0].x_m
        for frame in (*site.search, *site.holdout):
            inside = (frame.centre_m[:, 0] >= low) & (frame.centre_m[:, 0] <= high)
            assert frame.counted.sum() == inside.sum() > 0
        ways = {round(math.cos(math.radians(float(row["heading_deg"])))) for row in rows}
        assert ways == ({1, -1} if back else {1})
    one, other = results
    assert one["vehicles"] == other["vehicles"] > 10
    for key in ("objective", "objective_per_vehicle", "detectable_share"):
        assert one[key] == pytest.approx(other[key], abs=1e-9)


# --- Where the pole stands --------------------------------------------------------------------------------------------


def test_a_pole_never_stands_where_a_vehicle_is(tmp_path):
    """Parked cars along the right edge of all but 20 m move the pole there, or away from the road."""
    rows = rows_on(0.0, (1.75, 5.25))
    for number, x in enumerate([*range(350, 500, 6), *range(520, 650, 6)]):
        for time in np.arange(0.0, 60.0, 0.5):
            rows.append(sumo_samples.row(time, id=f"parked.{number}", x=x, y=-202.0, lane="road_9"))
    layout = proposed(write_rows(tmp_path / "run.fcd.xml", rows))
    x, y = layout.origin_m
    assert 497.0 < x < 516.0 or y < -204.5
    assert across_of(layout, 0.0)[0] == pytest.approx(0.0, abs=1.0)


# --- What cannot be proposed ------------------------------------------------------------------------------------------


def refused(path):
    with pytest.raises(InputError) as caught:
        proposed(path)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_what_cannot_be_proposed_is_said_in_one_line(tmp_path):
    path = tmp_path / "run.fcd.xml"
    one = [sumo_samples.row(t, x=10.0 * t) for t in range(20)]
    assert "fewer than 3 vehicles" in refused(write_rows(path, one))
    standing = [sumo_samples.row(t, id=f"v{n}", x=8.0 * n) for t in range(9) for n in range(9)]
    assert "every vehicle stands" in refused(write_rows(path, standing))
    assert "more than one frame" in refused(write_rows(path, standing[:9]))
    rng = np.random.default_rng(1)
    anywhere = [
        sumo_samples.row(t, id=f"v{n}", x=50 * x + 9 * t * math.cos(turn), y=50 * y + 9 * t * math.sin(turn))
        for n, (x, y, turn) in enumerate(rng.uniform(0, 2 * math.pi, (60, 3)))
        for t in range(9)
    ]
    assert "no road can be proposed" in refused(write_rows(path, anywhere))


# --- The verb ---------------------------------------------------------------------------------------------------------


def test_a_scene_from_a_table_loads_and_runs_at_once(tmp_path, monkeypatch, capsys):
    without_charts(monkeypatch)
    folder = tmp_path / "my site"
    folder.mkdir()
    write_table(folder / "traffic.csv", traffic_rows())
    assert run("init", folder, folder / "traffic.csv") == 0
    message = capsys.readouterr()
    assert "blender-lidar optimise " in message.out
    assert "no picture" in message.err
    scenario = load_scenario(folder / "scene.toml")
    assert 'path = "traffic.csv"' in (folder / "scene.toml").read_text()
    assert scenario.road.lanes == 2
    assert scenario.road.lane_width_m == pytest.approx(3.5, abs=0.1)
    assert scenario.recordings[0].origin_m[1] == pytest.approx(0.0, abs=1.0)
    how = ("--frames", 3, "--caster", CASTER, "--detail", "box", "--workers", 1)
    assert run("evaluate", folder / "scene.toml", "--height", 4, *how, "--out", tmp_path / "given") == 0
    if CASTER != "exact":  # which takes long
        quick = (*how, "--particles", 3, "--iterations", 2)
        assert run("optimise", folder / "scene.toml", *quick, "--out", tmp_path / "run") == 0
        assert (tmp_path / "run" / "report.html").exists()
    assert run("init", folder, folder / "traffic.csv") == 2
    assert "nothing is overwritten" in capsys.readouterr().err


def test_what_would_stop_a_run_is_told_at_once(tmp_path, monkeypatch, capsys):
    without_charts(monkeypatch)
    at = HEADER.index("length_m")
    in_feet = [[*row[:at], *(value / FOOT_M for value in row[at : at + 3]), *row[at + 3 :]] for row in traffic_rows()]
    write_table(tmp_path / "traffic.csv", in_feet)
    assert run("init", tmp_path / "site", tmp_path / "traffic.csv") == 0
    assert "a run will stop: " in (message := capsys.readouterr().err)
    assert "--accept sizes" in message


@pytest.mark.parametrize("heading_deg", [0.0, 33.0, 121.0])
def test_init_says_that_a_run_will_stop_where_one_does_and_nowhere_else(heading_deg, tmp_path, monkeypatch, capsys):
    """Tractors and trailers whose boxes touch: which ones overlap by a rounding depends on the frame of reference."""
    without_charts(monkeypatch)
    cos, sin = math.cos(math.radians(heading_deg)), math.sin(math.radians(heading_deg))
    rows = []
    for row in traffic_rows():
        for part, length, ahead in ((0, 6.0, 5.0), (1, 10.0, -3.0)):
            x, y = row[3] + ahead, row[4]
            place = [round(x * cos - y * sin, 2), round(x * sin + y * cos, 2)]
            rows.append([row[0], 2 * row[1] + part, "truck", *place, length, 2.5, 3.6, heading_deg, row[9]])
    write_table(tmp_path / "traffic.csv", rows)
    assert run("init", tmp_path / "site", tmp_path / "traffic.csv") == 0
    message = capsys.readouterr().err
    how = ("--height", 4, "--frames", 3, "--caster", CASTER, "--detail", "box", "--workers", 1)
    assert run("evaluate", tmp_path / "site" / "scene.toml", *how, "--out", tmp_path / "run") == 0
    assert "a run will stop" not in message


def test_the_example_runs_and_the_pictures_are_drawn(tmp_path):
    pytest.importorskip("matplotlib")
    assert run("init", tmp_path / "ex", "--from", "example") == 0
    assert (tmp_path / "ex" / "scene.png").stat().st_size > 20_000
    assert load_scenario(tmp_path / "ex" / "scene.toml").road.lanes == 6


def test_a_sumo_scene_holds_the_files_that_were_given(tmp_path, monkeypatch):
    without_charts(monkeypatch)
    run_xml = write_rows(tmp_path / "run.fcd.xml", rows_on(33.0, [1.75, 5.25]))
    types = tmp_path / "cars.rou.xml"
    types.write_text('<routes><vType id="car" vClass="passenger"/></routes>')
    assert run("init", tmp_path / "site", "--from", "sumo", run_xml, "--vehicle-types", types) == 0
    scenario = load_scenario(tmp_path / "site" / "scene.toml")
    assert Path(scenario.recordings[0].path) == run_xml
    assert scenario.recordings[0].vehicle_types == (str(types),)
    assert scenario.region.stretches[0].x_m == (-50.0, 50.0)


def test_a_sumo_configuration_gives_recording_and_types_or_says_how_to_write_them(tmp_path, monkeypatch, capsys):
    without_charts(monkeypatch)
    run_xml = write_rows(tmp_path / "run.fcd.xml", rows_on(33.0, [1.75, 5.25]))
    for name in ("cars", "lorries"):
        (tmp_path / f"{name}.rou.xml").write_text(f'<routes><vType id="{name}" vClass="passenger"/></routes>')
    (tmp_path / "cars.rou.xml").write_text('<routes><vType id="car" vClass="passenger"/></routes>')
    config, named = tmp_path / "site.sumocfg", '<fcd-output value="run.fcd.xml"/>'
    config.write_text(f'<configuration><route-files value="cars.rou.xml,lorries.rou.xml"/>{named}</configuration>')
    assert run("init", tmp_path / "site", config) == 0
    scenario = load_scenario(tmp_path / "site" / "scene.toml")
    assert Path(scenario.recordings[0].path) == run_xml
    types = tuple(str(tmp_path / f"{name}.rou.xml") for name in ("cars", "lorries"))
    assert scenario.recordings[0].vehicle_types == types
    again = tmp_path / "again.toml"
    again.write_text(to_toml(scenario.with_whole_paths()))
    assert load_scenario(again).recordings[0] == scenario.recordings[0]
    digests = run_identity(scenario, "exact")
    (tmp_path / "lorries.rou.xml").write_text('<routes><vType id="lorries" vClass="truck"/></routes>')
    changed = run_identity(scenario, "exact")
    assert [key for key in digests if digests[key] != changed[key]] == ["[traffic] vehicle_types 2"]
    config.write_text(config.read_text().replace("run.fcd", "not_there.fcd"))
    monkeypatch.setattr("blender_lidar.commands.init._sumo", lambda: None)
    assert run("init", tmp_path / "other", config) == 2
    assert "not_there.fcd.xml, which is not there; write it with SUMO: sumo -c " in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ((), "0 files given"),
        (("--from", "ngsim"), "0 files given"),
        (("--from", "example", "run.csv"), "allowed: no FILE"),
        (("--from", "ngsmi", "run.csv"), "did you mean 'ngsim'"),
        (("run.csv",), "there is no such file"),
        (("--from", "sumo", "run.csv", "--period", "1"), "does not apply"),
    ],
)
def test_wrong_words_are_told_and_leave_nothing(tmp_path, capsys, words, message):
    assert run("init", tmp_path / "site", *words) == 2
    assert message in capsys.readouterr().err
    assert not (tmp_path / "site").exists()


def test_a_folder_with_foreign_files_is_refused(tmp_path, capsys):
    (tmp_path / "notes.txt").write_text("mine")
    write_table(tmp_path / "traffic.csv", traffic_rows())
    assert run("init", tmp_path, tmp_path / "traffic.csv") == 2
    assert "notes.txt" in capsys.readouterr().err
    assert sorted(path.name for path in tmp_path.iterdir()) == ["notes.txt", "traffic.csv"]


def test_a_line_of_the_template_needs_its_fields_and_is_there_for_each_entry_of_a_list():
    assert set(tomllib.loads(filled({}))) == {"traffic", "road", "region", "sensor", "deployment", "baseline", "search"}
    lines = filled({"note": ["one", "two"], "road": "", "net": '"a.net.xml"', "lanes": 3}).splitlines()
    assert [line for line in lines if line.startswith("# Note")] == ["# Note: one", "# Note: two"]
    assert {'net = "a.net.xml"', "x_m = 0.0  # along the road"} <= set(lines)
    assert not any("$" in line or line.startswith(("lanes", "height_m = [2.0, 6.0]")) for line in lines)


@pytest.mark.parametrize("text", [r"C:\traffic\new\run.csv", "it's \\ odd", 'a "quoted" name', "tab\there", "café.csv"])
def test_a_path_is_valid_toml_whatever_it_holds(text):
    assert tomllib.loads(f"path = {text_value(text)}")["path"] == text
    assert ("'" in text_value(text)) or "\\" not in text or text.startswith("it's") or "\t" in text


def test_a_path_below_the_folder_is_relative_to_it(tmp_path):
    assert path_value(tmp_path / "site" / "data" / "run.csv", tmp_path / "site") == '"data/run.csv"'
    assert tomllib.loads(f"p = {path_value(tmp_path / 'run.csv', tmp_path / 'site')}")["p"] == str(tmp_path / "run.csv")


def test_parquet_which_blender_cannot_read_is_written_as_a_table_that_it_can(tmp_path, monkeypatch):
    pytest.importorskip("pyarrow")
    from pyarrow import csv as tables
    from pyarrow import parquet

    without_charts(monkeypatch)
    path = table_of(tmp_path / "t.csv", both_ways("right", 30.0))
    foreign, taken = tmp_path / "t.parquet", tmp_path / "taken"
    parquet.write_table(tables.read_csv(path), foreign)
    assert run("init", tmp_path / "plain", path) == run("init", tmp_path / "site", foreign) == 0
    plain, made = (load_scenario(tmp_path / name / "scene.toml") for name in ("plain", "site"))
    assert (Path(made.recordings[0].path).name, made.recordings[0].format) == ("traffic.csv", "table")
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    np.testing.assert_array_equal(read_recording(made).centre_m, read_recording(plain).centre_m)
    assert read_recording(made).report == read_recording(plain).report
    taken.mkdir()
    (taken / "traffic.csv").write_bytes(foreign.read_bytes())
    assert run("init", taken, taken / "traffic.csv") == 2
    assert (taken / "traffic.csv").read_bytes() == foreign.read_bytes()


def test_ngsims_road_is_the_same_whatever_the_encoding_of_the_file(tmp_path, monkeypatch):
    without_charts(monkeypatch)
    whole = gzip.decompress((shipped_scenes()["i80"].parent / "i80_sample.csv.gz").read_bytes())
    found = []
    for encoding in ("utf-8", "utf-16"):
        path = tmp_path / f"{encoding}.csv"
        path.write_bytes(whole.decode().encode(encoding))
        assert run("init", tmp_path / f"site {encoding}", path) == 0
        found.append(load_scenario(tmp_path / f"site {encoding}" / "scene.toml").road)
    assert found[0] == found[1]
