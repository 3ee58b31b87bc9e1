"""SUMO's nets are read as SUMO itself drives on them; other files are refused by name."""

from __future__ import annotations

import gzip
import os
import re
import subprocess
import sys
from collections import Counter
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from blender_lidar.errors import InputError, MissingExtraError, MissingFileError
from blender_lidar.road.approaches import approaches_to
from blender_lidar.road.sumo_net import net_location, read_net
from blender_lidar.traffic import read_traffic
from tests.waiting import WAIT_S

shapely = pytest.importorskip("shapely", reason="shapely, of the extra test, is not installed")
pytest.importorskip("sumolib", reason="sumolib, of the extra maps, is not installed")

pytestmark = pytest.mark.versions

INGOLSTADT = Path(__file__).parents[1].parent / "shared" / "data" / "sites" / "ingolstadt1"
needs_ingolstadt = pytest.mark.skipif(not INGOLSTADT.is_dir(), reason=f"no net of a site at {INGOLSTADT}")
ORIGIN_M = (212990.0, 451459.0)

NODES = '<node id="{}" x="{}" y="{}" type="{}"/>'
EDGE = '<edge id="{0}{1}" from="{0}" to="{1}" numLanes="{2}" {3}/>'
STAR = {
    "c": (0, 0, "traffic_light"),
    "e": (100, 0, "priority"),
    "f": (180, 30, "priority"),
    "n": (0, 90, "priority"),
    "w": (-90, 0, "priority"),
}


@pytest.fixture(scope="session")
def program():
    """Run one of SUMO's programs in a folder."""
    sumo = pytest.importorskip("sumo", reason="SUMO is not installed")

    def program(name, folder, *options):
        command = [str(Path(sumo.SUMO_HOME) / "bin" / name), *map(str, options), "--xml-validation", "never"]
        environment = os.environ | {"SUMO_HOME": str(sumo.SUMO_HOME)}
        done = subprocess.run(
            command, cwd=folder, env=environment, capture_output=True, text=True, timeout=WAIT_S, check=False
        )
        assert done.returncode == 0, done.stderr

    return program


@pytest.fixture(scope="session")
def made(tmp_path_factory, program):
    """The net of a crossing of three arms by netconvert; a node on the eastern arm is none."""
    folder = tmp_path_factory.mktemp("nets")

    def made(name, *options, nodes=STAR, lanes=2, of_edges="", extra=""):
        path = folder / f"{name}.net.xml"
        if not path.exists():
            rows = [NODES.format(key, *values) for key, values in nodes.items()]
            (folder / "nodes.xml").write_text(f"<nodes>{''.join(rows)}</nodes>")
            pairs = [("c", "e"), ("e", "f"), ("c", "n"), ("c", "w")] if "w" in nodes else [("c", "e"), ("e", "f")]
            rows = [EDGE.format(*ends, lanes, of_edges) for pair in pairs for ends in (pair, pair[::-1])]
            (folder / "edges.xml").write_text(f"<edges>{''.join(rows)}{extra}</edges>")
            files = ("--node-files", "nodes.xml", "--edge-files", "edges.xml", "--output-file", path.name)
            program("netconvert", folder, *files, *options)
        return path

    return made


def rows_of(road):
    return {lane.name: row for row, lane in enumerate(road.lanes)}


def changed(path, old, new, name="changed.net.xml"):
    text = path.read_text()
    assert old in text
    out = path.with_name(name)
    out.write_text(text.replace(old, new))
    return out


# --- What SUMO drives on it -------------------------------------------------------------------------------


def recorded(path, origin_m):
    """Of an FCD file's vehicles the fronts (n, 2), headings (n,), lanes and ids, row by row."""
    with gzip.open(path) if path.suffix == ".gz" else path.open("rb") as stream:
        rows = [element.attrib for element in ElementTree.parse(stream).iter("vehicle")]
    xy = np.array([[float(row["x"]), float(row["y"])] for row in rows]) - origin_m
    heading = np.radians(90.0 - np.array([float(row["angle"]) for row in rows]))
    return xy, heading, [row["lane"] for row in rows], [row["id"] for row in rows]


def corners_of(recording):
    """The corners of all footprints, (n, 4, 2) [m]."""
    forward = np.stack([np.cos(recording.heading_rad), np.sin(recording.heading_rad)], axis=1)[:, None]
    left = forward[..., ::-1] * [-1.0, 1.0]
    half = 0.5 * recording.size_m
    signs = np.array([(1, 1), (1, -1), (-1, -1), (-1, 1)])[..., None]
    ahead, aside = half[:, None, :1] * signs[:, 0] * forward, half[:, None, 1:2] * signs[:, 1] * left
    return recording.centre_m[:, None, :2] + ahead + aside


def share_on_road(road, corners):
    """Share of the footprints (n, 4, 2) that lie whole on lanes and junctions, by shapely."""
    lines = zip(road.points_m, road.width_m, strict=True)
    lanes = [
        shapely.LineString(line).buffer(0.5 * width, cap_style="flat", join_style="mitre") for line, width in lines
    ]
    area = shapely.union_all([*lanes, *(shapely.Polygon(one.outline_m).buffer(0.0) for one in road.junctions)])
    inside = shapely.contains_xy(area, *corners.reshape(-1, 2).T)
    return inside.reshape(-1, 4).all(axis=1).mean()


def assert_follows(road, lanes, ids):
    """Each vehicle stays on its road, or goes on where its lane, or one beside it, leads within three lanes."""
    row = rows_of(road)
    beside = {}
    for number in row.values():
        beside.setdefault(road.lanes[number].road, set()).add(number)
    last = {}
    for lane, one in zip(lanes, ids, strict=True):
        before, last[one] = last.get(one, row[lane]), row[lane]
        reached = {before}
        for _ in range(4):
            reached = set().union(*(beside[road.lanes[number].road] for number in reached))
            if row[lane] in reached:
                break
            reached |= {to for number in reached for to in road.lanes[number].leads_to}
        assert row[lane] in reached, f"{one}: {road.lanes[before].name} to {lane}"


@needs_ingolstadt
def test_the_recorded_vehicles_of_a_real_intersection_are_on_its_lanes():
    road = read_net(INGOLSTADT / "ingolstadt1.net.xml", ORIGIN_M)
    fcd = INGOLSTADT / "ingolstadt1.fcd.xml.gz"
    recording = read_traffic(str(fcd), format="sumo", origin_m=ORIGIN_M)
    assert share_on_road(road, corners_of(recording)) > 0.99
    xy, heading, lanes, ids = recorded(fcd, ORIGIN_M)
    found = road.locate(xy, heading)
    same = np.array([road.lanes[row].name for row in found.lane]) == lanes
    crossing = np.char.startswith(lanes, ":")
    assert same[~crossing].mean() > 0.999
    assert same[crossing].mean() > 0.95
    assert found.lane.min() >= 0
    assert_follows(road, lanes, ids)


@needs_ingolstadt
def test_the_junctions_of_a_real_net_are_where_roads_meet():
    road = read_net(INGOLSTADT / "ingolstadt1.net.xml", ORIGIN_M)
    assert [junction.signalised for junction in road.junctions] == [False, True]
    assert {lane.junction for lane in road.lanes} == {"", *(junction.name for junction in road.junctions)}
    assert Counter(lane.use for lane in road.lanes) == {"vehicles": 41, "pedestrians": 11}
    assert np.abs(road.junctions[1].outline_m.mean(axis=0)).max() < 5.0


@pytest.mark.parametrize("options", [(), ("--lefthand",)], ids=["right", "left"])
def test_what_sumo_simulates_follows_the_lanes(tmp_path, made, program, options):
    net = made("walked" + "".join(options), *options, "--sidewalks.guess", "--crossings.guess")
    road = read_net(net)
    assert road.drives_on == ("left" if options else "right")
    ends = [("w", "f"), ("f", "n"), ("n", "w"), ("w", "n"), ("f", "w")]
    between = {"w": "wc", "f": "fe ec", "n": "nc"}, {"w": "cw", "f": "ce ef", "n": "cn"}
    flow = '<flow id="{}{}" begin="0" end="60" period="4" type="car"><route edges="{} {}"/></flow>'
    flows = [flow.format(a, b, between[0][a], between[1][b]) for a, b in ends]
    (tmp_path / "routes.xml").write_text(f'<routes><vType id="car" length="4.5" width="1.8"/>{"".join(flows)}</routes>')
    files = ("--net-file", net, "--route-files", "routes.xml", "--fcd-output", "fcd.xml")
    program("sumo", tmp_path, *files, "--end", "90", "--no-step-log", "--step-length", "0.5")
    xy, heading, lanes, ids = recorded(tmp_path / "fcd.xml", (0.0, 0.0))
    found = road.locate(xy, heading)
    outside = ~np.char.startswith(lanes, ":")
    assert (np.array([road.lanes[row].name for row in found.lane]) == lanes)[outside].mean() > 0.99
    assert_follows(road, lanes, ids)
    types = {"vehicle_types": str(tmp_path / "routes.xml"), "origin_m": (0.0, 0.0)}
    recording = read_traffic(str(tmp_path / "fcd.xml"), format="sumo", **types)
    within = np.hypot(*(recording.centre_m[:, :2] - [90.0, 0.0]).T) < 80.0  # at the map's edge rears hang over
    assert share_on_road(road, corners_of(recording)[within]) > 0.99


# --- Lanes and junctions ----------------------------------------------------------------------------------


def test_lanes_lead_through_a_junction_and_meet_end_to_end(made):
    road = read_net(made("plain"))
    row, ends = rows_of(road), set()
    assert {road.lanes[to].junction for to in road.lanes[row["wc_0"]].leads_to} == {"c"}
    for lane, line in zip(road.lanes, road.points_m, strict=True):
        for to in lane.leads_to:
            np.testing.assert_allclose(line[-1], road.points_m[to][0], atol=0.02)
        ends |= set() if lane.leads_to else {lane.name}
        assert lane.road == lane.name.rpartition("_")[0]
        assert lane.use == "vehicles"
    assert ends == {"cw_0", "cn_0", "ef_0"}  # where the map ends vehicles turn from the lanes beside these
    assert not road.against.any()
    np.testing.assert_array_equal(road.width_m, 3.2)


def test_a_junction_is_where_roads_meet(made):
    road = read_net(made("plain"))
    (junction,) = road.junctions
    assert (junction.name, junction.signalised) == ("c", True)
    assert shapely.Polygon(junction.outline_m).contains(shapely.Point(90.0, 0.0))
    assert {lane.junction for lane in road.lanes} == {"c", ""}
    assert read_net(made("bend", nodes={key: STAR[key] for key in "cef"})).junctions == ()


def test_an_origin_shifts_all_and_nothing_else(made):
    path, origin = made("plain"), np.array([12.5, -7.0])
    here, there = read_net(path), read_net(path, tuple(origin))
    for one, other in zip(here.points_m, there.points_m, strict=True):
        np.testing.assert_array_equal(one - origin, other)
    np.testing.assert_array_equal(here.junctions[0].outline_m - origin, there.junctions[0].outline_m)
    assert here.lanes == there.lanes


def test_a_net_without_lanes_in_its_junctions_leads_straight_on(made):
    road, direct = read_net(made("plain")), read_net(made("direct", "--no-internal-links"))
    assert not any(lane.junction for lane in direct.lanes)

    def leads(road):
        """Names of the lanes outside junctions, and of those that they lead to."""
        found = {}
        for lane in road.lanes:
            if not lane.name.startswith(":"):
                ahead = set(lane.leads_to)
                while inside := {to for to in ahead if road.lanes[to].name.startswith(":")}:
                    ahead = (ahead - inside).union(*(road.lanes[to].leads_to for to in inside))
                found[lane.name] = {road.lanes[to].name for to in ahead}
        return found

    assert leads(direct) == leads(road)
    assert leads(direct)["wc_0"] == {"ce_0"}
    assert sorted(approaches_to(direct, ["c"])) == sorted(approaches_to(road, ["c"])) == ["ec", "nc", "wc"]


def test_lanes_have_the_use_that_their_permissions_give_them(made):
    extra = """<edge id="rails" from="w" to="e" allow="rail"/><edge id="closed" from="n" to="e" disallow="all"/>
        <edge id="tramway" from="e" to="w" allow="tram"/><edge id="path" from="w" to="n" allow="pedestrian bicycle"/>"""
    path = made("uses", "--crossings.guess", of_edges='sidewalkWidth="2" bikeLaneWidth="1"', extra=extra)
    road = read_net(path)
    uses = {lane.name: lane.use for lane in road.lanes}
    assert [uses[f"wc_{number}"] for number in range(4)] == ["pedestrians", "bicycles", "vehicles", "vehicles"]
    assert (uses["tramway_0"], uses["path_0"]) == ("vehicles", "bicycles")
    assert not {"rails_0", "closed_0"} & set(uses)
    assert all(uses[name] == "pedestrians" for name in uses if re.match(":c_c", name))
    width_m = dict(zip(uses, road.width_m, strict=True))
    assert (width_m["wc_0"], width_m["wc_1"], width_m[":c_c0_0"]) == (2.0, 1.0, 4.0)
    assert not any(re.match(":._w", name) for name in uses)  # walking areas are outlines
    walks_to = {road.lanes[to].use for to in road.lanes[rows_of(road)["wc_0"]].leads_to}
    assert walks_to == {"pedestrians"}  # through them


def test_lanes_without_length_are_passed_through(made):
    path = made("plain")
    line = next(line for line in path.read_text().splitlines() if 'id=":e_0_0"' in line)
    point = re.search(r'shape="(\S+) ', line)[1]
    whole = read_net(path)
    short = read_net(changed(path, line, re.sub(r'shape="[^"]*"', f'shape="{point} {point}"', line)))

    def leads(road):
        return {lane.name: {road.lanes[to].name for to in lane.leads_to} for lane in road.lanes}

    before, after = leads(whole), leads(short)
    through = before.pop(":e_0_0")
    assert after == {
        name: ahead - {":e_0_0"} | (through if ":e_0_0" in ahead else set()) for name, ahead in before.items()
    }


def test_a_packed_net_is_the_same_whatever_its_name(made, tmp_path):
    path = made("plain")
    for name in ("net.xml.gz", "net.xml"):
        (tmp_path / name).write_bytes(gzip.compress(path.read_bytes()))
        road = read_net(tmp_path / name)
        assert road.lanes == read_net(path).lanes


def test_the_place_of_a_net_on_earth(made):
    nodes = {"c": (8.52, 48.76, "priority"), "e": (8.523, 48.76, "priority"), "f": (8.525, 48.762, "priority")}
    offset, projection = net_location(made("earth", "--proj.utm", nodes=nodes))
    assert projection.startswith("+proj=utm +zone=32")
    assert -offset[0] == pytest.approx(464_700, abs=500)
    assert -offset[1] == pytest.approx(5_400_800, abs=500)
    offset, projection = net_location(made("plain"))
    assert projection == "!"
    np.testing.assert_allclose(offset, (90.0, 0.0))


# --- Refusals ---------------------------------------------------------------------------------------------


def refused(path, error=InputError):
    """The one line with which a net is refused."""
    with pytest.raises(error) as raised:
        read_net(path)
    line = str(raised.value)
    assert "\n" not in line
    assert line.startswith(str(path))
    return line[len(str(path)) :]


@pytest.mark.parametrize(
    ("content", "told"),
    [
        (b"<routes><vType/></routes>", ": the root element is <routes>; a SUMO net has <net>"),
        (b"x,y\n1,2\n", "XML"),
        (b"", "XML"),
        (b"<net version='1.9'><edge id='a'>", ":1: truncated or damaged XML"),
        (b"<net version='1.9'></net>", ": has no lane for vehicles"),
        (
            b"<net version='1.9'><edge id='a'><lane id='a_0'/></edge></net>",
            ":1: is not as netconvert writes it (KeyError",
        ),
        (b"\x1f\x8b\x08\x00\x00", "gzip"),
    ],
)
def test_what_is_no_net_is_refused(tmp_path, content, told):
    path = tmp_path / "file.net.xml"
    path.write_bytes(content)
    assert told in refused(path)


def test_a_net_that_is_not_there_is_missed(tmp_path):
    assert "there is no such file" in refused(tmp_path / "no.net.xml", MissingFileError)
    assert "is a folder; allowed: a SUMO net" in refused(tmp_path)


def test_a_net_for_others_than_vehicles_is_refused(made):
    assert "no lane for vehicles" in refused(made("paths", of_edges='allow="pedestrian"'))


def test_a_lane_without_width_or_place_is_named(made):
    path = made("plain")
    assert "lane wc_0: width 0 m" in refused(changed(path, '<lane id="wc_0" ', '<lane id="wc_0" width="0.0" '))
    line = next(line for line in path.read_text().splitlines() if 'id="wc_0"' in line)
    assert "lane wc_0: its shape" in refused(changed(path, line, re.sub('shape="[^,]*', 'shape="nan', line)))


def test_heights_are_refused_and_a_common_one_is_not(made):
    nodes = {key: (x, y, f'priority" z="{x / 20}') for key, (x, y, _) in STAR.items()}
    assert ": has heights from -4.5 to 9.0 m; only OpenDRIVE's are used" in refused(made("high", nodes=nodes))
    nodes = {key: (x, y, f'{kind}" z="374.2') for key, (x, y, kind) in STAR.items()}
    assert len(read_net(made("level", nodes=nodes))) == len(read_net(made("plain")))


@pytest.mark.parametrize("options", [(), ("--precision", "6", "--offset.disable-normalization")])
def test_degrees_are_refused(made, options):
    nodes = {"c": (8.52, 48.76, "priority"), "e": (8.523, 48.76, "priority"), "f": (8.525, 48.762, "priority")}
    assert "longitude and latitude" in refused(made(f"degrees{len(options)}", *options, nodes=nodes))


def test_without_sumolib_the_extra_is_named(tmp_path, monkeypatch):
    path = tmp_path / "a.net.xml"
    path.write_text("<net/>")
    monkeypatch.setitem(sys.modules, "sumolib.net", None)
    assert 'pip install "blender_lidar[maps]"' in refused(path, MissingExtraError)
