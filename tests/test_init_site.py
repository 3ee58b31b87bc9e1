"""`blender-lidar init` at intersections: the busiest junction, poles off the lanes, and a scene that runs as it is."""

from __future__ import annotations

import csv
import gzip
import json
import math
import re
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from blender_lidar.cli import main
from blender_lidar.commands import init
from blender_lidar.road.pole_places import propose_poles
from blender_lidar.road.settings import RoadSettings, map_of
from blender_lidar.scene.scenario import load_scenario
from blender_lidar.scene.site import prepare
from tests import sumo_samples
from tests.small_scene import without_charts

SCENES = Path(__file__).parents[1] / "scenes"
NET, TYPES = SCENES / "crossing.net.xml.gz", SCENES / "crossing_types.xml"
SITES = Path(__file__).parents[2] / "shared" / "data" / "sites"
needs_maps = pytest.mark.skipif(find_spec("sumolib") is None, reason="sumolib, of the extra maps, is missing")


def run(*words) -> int:
    return main([str(word) for word in words])


@pytest.fixture(scope="module")
def sample(tmp_path_factory):
    """The first two minutes of the shipped intersection's traffic."""
    text = gzip.decompress((SCENES / "crossing_sample.xml.gz").read_bytes()).decode()
    first = re.search(r'<timestep time="([^"]+)"', text)
    late = next(one for one in re.finditer(r'<timestep time="([^"]+)"', text) if float(one[1]) > float(first[1]) + 120)
    path = tmp_path_factory.mktemp("sample") / "run.fcd.xml"
    path.write_text(text[: late.start()] + "</fcd-export>")
    return path


def poles_of(folder):
    with (folder / "poles.csv").open() as stream:
        return {row["name"]: (float(row["x_m"]), float(row["y_m"])) for row in csv.DictReader(stream)}


# --- Poles ------------------------------------------------------------------------------------------------------------


def test_poles_beside_a_road_with_a_median_stand_on_both_sides_and_on_the_median():
    road = map_of(RoadSettings(lanes=2, lane_width_m=3.5, carriageways=2, median_m=6.0, setback_m=2.0))
    right, left = road.edges_t
    poles = propose_poles(road, (0.0, 0.5 * (right + left)), 20.0)
    sides = {round(y, 1) for _, x, y in poles}
    assert len(poles) == 3
    assert min(sides) == pytest.approx(right - 3.0, abs=0.6)
    assert max(sides) == pytest.approx(left + 3.0, abs=0.6)
    assert all(abs(x) <= 0.5 for _, x, y in poles)
    for _, x, y in poles:
        assert road.clearance((x, y))[0] >= 1.0


# --- Scenes -----------------------------------------------------------------------------------------------------------


@needs_maps
def test_a_net_gives_its_junction_four_corners_and_a_scene_that_runs(tmp_path, sample, monkeypatch, capsys):
    without_charts(monkeypatch)
    folder = tmp_path / "site"
    assert run("init", folder, "--from", "sumo", sample, "--net", NET, "--vehicle-types", TYPES) == 0
    printed = capsys.readouterr().out
    assert "junction middle, and the last 40 m of 4 approaches" in printed
    assert "from_north" in (folder / "scene.toml").read_text()
    poles = poles_of(folder)
    corners = {name for name in poles if name.startswith("corner")}
    assert corners == {f"corner_{one}" for one in ("north_east", "north_west", "south_east", "south_west")}
    scenario = load_scenario(folder / "scene.toml")
    for name, place in poles.items():
        gap, _ = scenario.road_map.clearance(place)
        assert gap >= 1.0, name
    site = prepare(
        load_scenario(
            folder / "scene.toml", {("traffic", "frames"): (3, "here"), ("model", "caster"): ("exact", "here")}
        )
    )
    assert any(frame.counted.any() for frame in site.search)
    how = ("--frames", 3, "--particles", 6, "--iterations", 2, "--installer", "false", "--workers", 1)
    how += ("--out", tmp_path / "run")
    assert run("optimise", folder / "scene.toml", *how) == 0
    capsys.readouterr()
    assert run("report", tmp_path / "run", "--all") == 0
    told = capsys.readouterr().out
    assert "from_north" in told
    assert "straight" in told


@needs_maps
def test_a_site_is_the_same_wherever_the_net_lies(tmp_path, sample, monkeypatch):
    """Net and traffic moved by whole metres: the scene, its origin moved, has the same poles."""
    without_charts(monkeypatch)
    net = gzip.decompress(NET.read_bytes()).decode()
    off = np.array([691_000.0, 5_336_000.0])
    texts = {"shape": 2, "customShape": 2}
    for key in texts:
        net = re.sub(
            rf' {key}="([^"]*)"',
            lambda found, key=key: (
                f' {key}="'
                + " ".join(
                    ",".join(
                        f"{float(one) + (off[at] if at < 2 else 0.0):.2f}" for at, one in enumerate(place.split(","))
                    )
                    for place in found[1].split()
                )
                + '"'
            ),
            net,
        )
    net = re.sub(
        r'(<junction [^>]*?) x="([^"]*)" y="([^"]*)"',
        lambda found: f'{found[1]} x="{float(found[2]) + off[0]:.2f}" y="{float(found[3]) + off[1]:.2f}"',
        net,
    )
    moved_net, moved = tmp_path / "utm.net.xml", tmp_path / "utm.fcd.xml"
    moved_net.write_text(net)
    moved.write_text(
        re.sub(
            r' x="([^"]*)" y="([^"]*)"',
            lambda found: f' x="{float(found[1]) + off[0]:.2f}" y="{float(found[2]) + off[1]:.2f}"',
            sample.read_text(),
        )
    )
    for name, traffic, map_file in (("here", sample, NET), ("there", moved, moved_net)):
        words = ("--from", "sumo", traffic, "--net", map_file, "--vehicle-types", TYPES)
        assert run("init", tmp_path / name, *words) == 0
    assert poles_of(tmp_path / "here") == poles_of(tmp_path / "there")
    assert load_scenario(tmp_path / "there" / "scene.toml").road.origin_m == tuple(off)


def test_traffic_alone_at_a_crossing_gives_a_driven_area_and_poles_off_the_tracks(
    tmp_path, sample, monkeypatch, capsys
):
    without_charts(monkeypatch)
    folder = tmp_path / "site"
    assert run("init", folder, "--from", "sumo", sample, "--vehicle-types", TYPES) == 0
    assert "ground that nobody drove on may be road" in capsys.readouterr().out
    scenario = load_scenario(folder / "scene.toml")
    assert scenario.road.driven
    assert math.hypot(*scenario.road.origin_m) < 20.0
    poles = poles_of(folder)
    assert len(poles) >= 4
    assert all(scenario.road_map.clearance(place)[0] >= 2.5 for place in poles.values())
    site = prepare(
        load_scenario(
            folder / "scene.toml", {("traffic", "frames"): (3, "here"), ("model", "caster"): ("exact", "here")}
        )
    )
    assert any(frame.counted.any() for frame in site.search)


@needs_maps
def test_the_junction_or_the_place_that_is_asked_for_is_taken(tmp_path, sample, monkeypatch, capsys):
    without_charts(monkeypatch)
    words = ("--from", "sumo", sample, "--net", NET, "--vehicle-types", TYPES)
    assert run("init", tmp_path / "one", *words, "--junction", "middle") == 0
    assert run("init", tmp_path / "two", *words, "--at", "10,10") == 0
    assert load_scenario(tmp_path / "two" / "scene.toml").region.junction == "middle"
    assert run("init", tmp_path / "three", *words, "--at", "-110,0") == 0
    assert "no junction of the map lies within 50 m" in capsys.readouterr().out
    region = load_scenario(tmp_path / "three" / "scene.toml").region
    assert (region.junction, region.radius_m) == (None, 40.0)


@needs_maps
@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--net", NET, "--junction", "midle"), "unknown junction 'midle'; did you mean 'middle'"),
        (("--net", NET, "--at", "7"), "--at: is '7'; allowed: X,Y"),
        (("--net", NET, "--at", "0,inf"), "allowed: X,Y"),
        (("--net", NET, "--at", "9000,0"), "the nearest vehicle is"),
        (("--net", NET, "--road", NET), "two maps; allowed: one"),
        (("--net", "not_there.net.xml"), "there is no such file"),
        (("--junction", "middle"), "there is no map"),
    ],
)
def test_wrong_words_are_one_line_and_leave_nothing(tmp_path, sample, capsys, words, message):
    assert run("init", tmp_path / "site", "--from", "sumo", sample, *words) == 2
    told = capsys.readouterr().err
    assert message in told
    assert told.count("\n") == 1
    assert not (tmp_path / "site").exists()


@needs_maps
def test_traffic_beside_the_map_is_refused_with_how_far_apart_both_are(tmp_path, sample, capsys):
    far = tmp_path / "far.fcd.xml"
    far.write_text(re.sub(r' x="([^"]*)"', lambda one: f' x="{float(one[1]) + 5000.0:.2f}"', sample.read_text()))
    assert run("init", tmp_path / "site", "--from", "sumo", far, "--net", NET, "--vehicle-types", TYPES) == 2
    told = capsys.readouterr().err
    assert re.search(r"middles of both are x (49|50)\d\d, y -?\d+ m apart", told)
    assert "netOffset" in told


@needs_maps
def test_a_sumo_configuration_alone_is_run_where_sumo_is_installed(tmp_path, monkeypatch, capsys):
    if init._sumo() is None:
        pytest.skip("SUMO is not installed")
    without_charts(monkeypatch)
    (tmp_path / "net.net.xml").write_bytes(gzip.decompress(NET.read_bytes()))
    trips = "".join(
        f'<trip id="{number}" type="car" depart="{number}" from="from_{a}" to="to_{b}" departLane="best"/>'
        for number, (a, b) in enumerate(
            [("west", "east"), ("south", "north"), ("north", "west"), ("east", "south")] * 12
        )
    )
    (tmp_path / "cars.rou.xml").write_text(f'<routes><vType id="car" vClass="passenger"/>{trips}</routes>')
    config = tmp_path / "site.sumocfg"
    config.write_text(
        '<configuration><net-file value="net.net.xml"/><route-files value="cars.rou.xml"/><end value="90"/>'
        "</configuration>"
    )
    folder = tmp_path / "site"
    assert run("init", folder, config) == 0
    assert "SUMO writes" in capsys.readouterr().err
    scenario = load_scenario(folder / "scene.toml")
    assert scenario.region.junction == "middle"
    assert sorted(one.name for one in folder.iterdir()) == ["poles.csv", "run.fcd.xml.gz", "scene.toml"]
    config.write_text(config.read_text().replace("net.net.xml", "not_there.net.xml"))
    assert run("init", tmp_path / "other", config) == 2
    assert "SUMO stopped" in capsys.readouterr().err


@needs_maps
def test_a_real_signalised_intersection_is_proposed_with_islands(tmp_path, monkeypatch, capsys):
    folder = SITES / "ingolstadt1"
    if not folder.exists():
        pytest.skip("the real intersection is not here")
    without_charts(monkeypatch)
    traffic, net = folder / "ingolstadt1.fcd.xml.gz", folder / "ingolstadt1.net.xml"
    words = ("--from", "sumo", traffic, "--net", net, "--vehicle-types", folder / "ingolstadt1.rou.xml")
    assert run("init", tmp_path / "site", *words) == 0
    scenario = load_scenario(tmp_path / "site" / "scene.toml")
    (junction,) = (one for one in scenario.road_map.junctions if one.name == scenario.region.junction)
    assert junction.signalised
    poles = poles_of(tmp_path / "site")
    assert any(name.startswith("median") for name in poles)
    assert len(poles) >= 5
    assert all(scenario.road_map.clearance(place)[0] >= 1.0 for place in poles.values())


def test_straight_roads_are_no_crossings(tmp_path):
    from blender_lidar.traffic import read_traffic
    from blender_lidar.traffic.site_layout import is_crossing

    unplaced = RoadSettings(station_m=0.0, right_edge_m=0.0, setback_m=0.0)
    rows = []
    for number in range(30):
        way = 1.0 if number % 2 else -1.0
        for time in np.arange(0.0, 40.0, 0.5):
            x = way * (12.0 * (time - number) + 0.0)
            if abs(x) < 150.0:
                given = {"x": x, "y": -3.0 * way, "angle": 90.0 * way % 360.0, "lane": "a_0"}
                rows.append(sumo_samples.row(time, id=str(number), **given))
    path = tmp_path / "road.fcd.xml"
    path.write_text(sumo_samples.xml(sorted(rows, key=lambda row: float(row["time"]))))
    assert not is_crossing(read_traffic(path, road=unplaced))


@needs_maps
def test_the_shares_of_approaches_leave_as_csv_and_as_geojson_in_the_nets_projection(tmp_path, sample, monkeypatch):
    without_charts(monkeypatch)
    net = gzip.decompress(NET.read_bytes()).decode()
    location = '<location netOffset="-690000.00,-5335000.00" convBoundary="0,0,1,1" origBoundary="0,0,1,1" '
    location += 'projParameter="+proj=utm +zone=32 +ellps=WGS84 +datum=WGS84 +units=m +no_defs"/>'
    path = tmp_path / "site.net.xml"
    path.write_text(re.sub(r"<location [^>]*/>", location, net))
    folder = tmp_path / "site"
    assert run("init", folder, "--from", "sumo", sample, "--net", path, "--vehicle-types", TYPES) == 0
    how = ("--height", 4, "--tilt-x", 15, "--pole", "corner_north_east", "--frames", 4, "--workers", 1)
    assert run("evaluate", folder / "scene.toml", *how, "--out", tmp_path / "run") == 0
    result = json.loads((tmp_path / "run" / "result.json").read_text())
    with (tmp_path / "run" / "approaches.csv").open() as stream:
        rows = {row["name"]: row for row in csv.DictReader(stream) if row["by"] == "approach"}
    shares = {one["name"]: one["after"] for one in result["groups"] if one["by"] == "approach"}
    assert {name: float(row["after"]) for name, row in rows.items()} == pytest.approx(shares)
    outlines = json.loads((tmp_path / "run" / "approaches.geojson").read_text())
    assert outlines["crs"]["properties"]["name"].endswith("::32632")
    *areas, mast = outlines["features"]
    assert {one["properties"]["name"] for one in areas} == set(rows)
    east = next(one for one in areas if one["properties"]["name"] == "from_east")
    corners = np.concatenate([np.array(ring) for polygon in east["geometry"]["coordinates"] for ring in polygon])
    np.testing.assert_array_equal(east["geometry"]["coordinates"][0][0][0], east["geometry"]["coordinates"][0][0][-1])
    assert 690_010.0 < corners[:, 0].min() < corners[:, 0].max() < 690_080.0
    place = result["deployment"]
    assert mast["geometry"]["coordinates"] == pytest.approx([690_000 + place["x_m"], 5_335_000 + place["y_m"]])
    at = result["pointing"]
    assert (at["frame"], at["x_m"], at["y_m"]) == ("x and y of the net", place["x_m"], place["y_m"])


def test_a_picture_of_the_site_lies_under_the_blind_zones(tmp_path, sample, monkeypatch, capsys):
    image = pytest.importorskip("matplotlib.image", reason="matplotlib is not installed")
    pixels = np.zeros((400, 400, 3))
    pixels[:, :, 0] = 1.0  # red, half a metre each
    image.imsave(tmp_path / "air.png", pixels)
    folder = tmp_path / "site"
    with monkeypatch.context() as patched:
        without_charts(patched)
        assert run("init", folder, "--from", "sumo", sample, "--vehicle-types", TYPES) == 0
    scene = folder / "scene.toml"
    scene.write_text(
        scene.read_text() + f'\n[drawing]\nimage = "{tmp_path / "air.png"}"\nimage_points = '
        "[[0, 400, -100.0, -100.0], [400, 400, 100.0, -100.0]]\n"
    )
    poles = poles_of(folder)
    how = (
        "--height",
        4,
        "--tilt-x",
        15,
        "--pole",
        next(iter(poles)),
        "--frames",
        3,
        "--installer",
        "false",
        "--workers",
        1,
    )
    for name, words in (("with", ()), ("without", None)):
        if words is None:
            scene.write_text(scene.read_text().partition("\n[drawing]")[0])
        assert run("evaluate", scene, *how, "--out", tmp_path / name) == 0
    red = []
    for name in ("with", "without"):
        found = image.imread(tmp_path / name / "blind_zones.png")[..., :3]
        red.append(((found[..., 0] > 0.95) & (found[..., 1] < 0.7) & (found[..., 1] > 0.3)).mean())
    assert red[0] > red[1] + 0.1
