"""What SUMO itself writes, in each of its formats, is read as what SUMO itself simulated."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from blender_lidar.errors import InputError
from blender_lidar.traffic import CLASSES, overlapping_pairs, read_traffic
from blender_lidar.traffic.sumo_types import DEFAULT_TYPES
from tests import sumo_samples as samples
from tests.waiting import WAIT_S

sumo = pytest.importorskip("sumo", reason="SUMO is not installed")
HOME = Path(sumo.SUMO_HOME)
ROUNDING_M = 0.0051  # XML and CSV have two decimals, Parquet has them all
ROUNDING_DEG = 0.0051

NODES = '<node id="a" x="0" y="0"/><node id="b" x="200" y="0"/><node id="c" x="400" y="150"/>'
EDGES = """<edge id="ab" from="a" to="b" numLanes="3" speed="20" sidewalkWidth="2"/>
           <edge id="bc" from="b" to="c" numLanes="3" speed="20" sidewalkWidth="2"/>"""
# Vehicle 0 enters with its rear at the edge's beginning, and then waits there.
ROUTES = """
  <vType id="sedan" length="4.4" width="1.85" height="1.45" guiShape="passenger/sedan"/>
  <vTypeDistribution id="mix">
    <vType id="lorry" vClass="truck" length="11.5" probability="0.3"/>
    <vType id="parcels" vClass="delivery" probability="0.7"/>
  </vTypeDistribution>
  <vType id="bike" vClass="bicycle"/>
  <route id="r" edges="ab bc"/>
  {first}
  <vehicle id="long" type="lorry" route="r" depart="0" departLane="3" departPos="base" departSpeed="0">
    <stop lane="ab_3" startPos="11" endPos="12" duration="3"/>
  </vehicle>
  <person id="p" depart="0"><walk edges="ab bc"/></person>
  <container id="c" depart="0"><tranship from="ab" to="bc" speed="2"/></container>
  <flow id="f" type="sedan" route="r" begin="0.5" end="20" period="2" departLane="1"/>
  <flow id="g" type="mix" route="r" begin="1" end="20" period="3" departLane="2"/>
  <vehicle id="untyped" route="r" depart="3" departLane="1"/>
  <vehicle id="b" type="bike" route="r" depart="5" departLane="1"/>"""


def run(program, folder, *options):
    command = [str(HOME / "bin" / program), *options, "--xml-validation", "never"]
    environment = os.environ | {"SUMO_HOME": str(HOME)}
    done = subprocess.run(
        command, cwd=folder, env=environment, capture_output=True, text=True, timeout=WAIT_S, check=False
    )
    assert done.returncode == 0, done.stderr


def write_xml(path, root, content):
    path.write_text(f"<{root}>{content}</{root}>", encoding="utf-8")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("net")
    write_xml(folder / "nodes.xml", "nodes", NODES)
    write_xml(folder / "edges.xml", "edges", EDGES)
    write_xml(folder / "routes.rou.xml", "routes", ROUTES.format(first=""))
    files = ("--node-files", "nodes.xml", "--edge-files", "edges.xml")
    run("netconvert", folder, *files, "--output-file", "net.xml", "--offset.disable-normalization")
    return folder


@pytest.fixture(scope="module")
def simulate(folder):
    """Write a recording, once, and give its path."""

    def simulate(name, *options, net="net.xml", routes="routes.rou.xml"):
        path = folder / name
        if not path.exists():
            files = ("--net-file", net, "--route-files", routes, "--fcd-output", name)
            run("sumo", folder, *files, "--step-length", "0.1", "--end", "15", "--no-step-log", *options)
        return path

    return simulate


@pytest.fixture(scope="module")
def recording(folder, simulate):
    return read_traffic(simulate("run.fcd.xml"), vehicle_types=folder / "routes.rou.xml")


def assert_same(given, expected, within_m, within_deg):
    for name in ("frame", "vehicle_id", "class_index", "size_m", "lane", "frame_time_s"):
        np.testing.assert_array_equal(getattr(given, name), getattr(expected, name), err_msg=name)
    # A box lies half a length behind its front, where a rounded heading is felt too.
    np.testing.assert_allclose(given.centre_m, expected.centre_m, atol=within_m + 6 * np.radians(within_deg), rtol=0)
    np.testing.assert_allclose(given.heading_rad, expected.heading_rad, atol=np.radians(within_deg), rtol=0)
    assert given.report == expected.report


def test_every_kind_of_vehicle_is_there_with_its_size(recording):
    found = {(CLASSES[index], *size) for index, size in zip(recording.class_index, recording.size_m, strict=True)}
    sedan, untyped, bike = ("car", 4.4, 1.85, 1.45), ("car", 5.0, 1.8, 1.5), ("bicycle", 1.6, 0.65, 1.7)
    walker = "pedestrian", 0.215, 0.478, 1.719
    assert found == {sedan, untyped, bike, ("truck", 11.5, 2.4, 2.4), ("van", 6.5, 2.16, 2.86), walker}
    assert recording.report.left_out == len(recording.frames)  # the container
    assert recording.time_step_s == pytest.approx(0.1)


def test_a_vehicle_whose_rear_enters_at_the_edges_beginning_has_its_box_there(recording):
    """SUMO's departPos "base" puts the rear 0.1 m behind the beginning of the edge, which lies at x = 0."""
    first = recording.at(0)
    long = first.size_m[:, 0] == 11.5
    rear = first.centre_m[long, 0] - 11.5 / 2
    np.testing.assert_allclose(rear, 0.1, atol=0.02)


def test_boxes_follow_each_other_without_overlap_and_point_where_they_drive(recording):
    assert not any(len(overlapping_pairs(recording.at(frame))) for frame in recording.frames)
    order = np.lexsort((recording.frame, recording.vehicle_id))
    centre, lane, heading = recording.centre_m[order, :2], recording.lane[order], recording.heading_rad[order]
    moved = np.diff(centre, axis=0)
    follows = (np.diff(recording.vehicle_id[order]) == 0) & (np.diff(lane) == 0)  # SUMO changes lanes in a single step
    follows &= (np.hypot(*moved.T) > 1.0) & (centre[1:, 0] < 180)  # before the bend
    off = np.arctan2(moved[:, 1], moved[:, 0]) - heading[1:]
    assert follows.sum() > 400
    assert np.degrees(np.abs(off[follows])).max() < 0.5


def test_csv_is_the_same_to_the_last_digit(folder, simulate, recording):
    for name, options in {
        "run.fcd.csv": (),
        "run.fcd.csv.gz": (),
        "plain.csv": ("--output.column-header", "plain"),
        "full.csv": ("--output.column-header", "full"),
        "commas.csv": ("--output.column-separator", ","),
    }.items():
        found = read_traffic(simulate(name, *options), vehicle_types=folder / "routes.rou.xml")
        assert_same(found, recording, 0.0, 0.0)


def test_sumos_own_conversion_to_csv_is_the_same_to_the_last_digit(folder, simulate, recording):
    simulate("run.fcd.xml")
    tool = HOME / "tools" / "xml" / "xml2csv.py"
    if not tool.exists():
        pytest.skip("SUMO's tools are not installed")
    command = [sys.executable, str(tool), "run.fcd.xml", "-o", "converted.csv"]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=WAIT_S, check=False)
    assert done.returncode == 0, done.stderr
    found = read_traffic(folder / "converted.csv", vehicle_types=folder / "routes.rou.xml")
    assert_same(found, recording, 0.0, 0.0)


def test_parquet_is_the_same_within_the_rounding_of_the_others(folder, simulate, recording):
    samples.need_pyarrow()
    found = read_traffic(simulate("run.fcd.parquet"), vehicle_types=folder / "routes.rou.xml")
    assert_same(found, recording, ROUNDING_M, ROUNDING_DEG)


def test_a_recording_that_begins_with_a_person_is_the_same_in_each_format(folder, simulate):
    first = '<person id="early" depart="0"><walk edges="ab bc"/></person>'
    later = ROUTES.replace('depart="0"', 'depart="1"').replace('begin="0.5"', 'begin="1"')
    write_xml(folder / "person.rou.xml", "routes", later.format(first=first))
    read = {
        name: read_traffic(simulate(name, routes="person.rou.xml"), vehicle_types=folder / "person.rou.xml")
        for name in ("person.xml", "person.csv")
    }
    assert (folder / "person.csv").read_text(encoding="utf-8").startswith("timestep_time;person_id;")
    assert_same(read["person.csv"], read["person.xml"], 0.0, 0.0)
    assert len(read["person.xml"]) > 100


@pytest.mark.parametrize("name", ["geo.xml", "geo.csv", "geo.parquet"])
def test_geographic_output_is_refused_in_each_format(folder, simulate, name):
    if name.endswith("parquet"):
        samples.need_pyarrow()
    lonlat = '<node id="a" x="8.5" y="49"/><node id="b" x="8.503" y="49"/><node id="c" x="8.506" y="49.001"/>'
    write_xml(folder / "lonlat.xml", "nodes", lonlat)
    files = ("--node-files", "lonlat.xml", "--edge-files", "edges.xml")
    run("netconvert", folder, *files, "--output-file", "geo_net.xml", "--proj.utm")
    path = simulate(name, "--fcd-output.geo", net="geo_net.xml")
    with pytest.raises(InputError, match=r"longitude and latitude; metres are needed: run SUMO without"):
        read_traffic(path)
    utm = simulate(f"utm_{name}", "--fcd-output.utm", net="geo_net.xml")
    assert read_traffic(utm).centre_m[:, 0].min() > 400_000


def test_the_default_sizes_are_those_that_sumo_tells(folder):
    tools = HOME / "tools"
    if not (tools / "traci").is_dir():
        pytest.skip("SUMO's tools are not installed")
    sizes = {name: known.size_m for name, known in DEFAULT_TYPES.items() if known.class_name is not None}
    names = list(sizes)
    write_xml(folder / "classes.rou.xml", "routes", "".join(f'<vType id="t_{n}" vClass="{n}"/>' for n in names))
    program = f"""
import sys
sys.path.insert(0, {str(tools)!r})
import traci
traci.start([{str(HOME / "bin" / "sumo")!r}, "-n", "net.xml", "-r", "classes.rou.xml", "--no-step-log",
             "--xml-validation", "never"], stdout=open("traci.log", "w"))
for name in {names!r}:
    get = traci.vehicletype
    print(name, get.getLength("t_" + name), get.getWidth("t_" + name), get.getHeight("t_" + name))
traci.close()
"""
    command = [sys.executable, "-c", program]
    environment = os.environ | {"SUMO_HOME": str(HOME)}
    done = subprocess.run(
        command, cwd=folder, env=environment, capture_output=True, text=True, timeout=WAIT_S, check=False
    )
    assert done.returncode == 0, done.stderr
    message = {
        name: tuple(map(float, size)) for name, *size in map(str.split, done.stdout.splitlines()) if name in names
    }
    assert message == sizes
