"""SUMO's floating car data, in whichever file, give the same boxes, and those where SUMO has its vehicles."""

from __future__ import annotations

import cmath
import gzip
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from blender_lidar.errors import InputError
from blender_lidar.traffic import CLASSES, read_traffic
from blender_lidar.traffic.sumo_types import DEFAULT_TYPES, class_in_name, read_config, read_types
from tests import sumo_samples as samples
from tests.traffic_samples import assert_same_boxes

pytestmark = pytest.mark.versions

TYPES = """<routes>
  <vType id="car" length="4.4" width="1.85" height="1.45"/>
  <vType id="lorry" vClass="truck" length="12.5"/>
</routes>
"""


def write(tmp_path, rows, name="run.fcd.xml"):
    path = tmp_path / name
    path.write_text(samples.xml(rows), encoding="utf-8")
    return path


def write_types(tmp_path, text=TYPES):
    path = tmp_path / "types.rou.xml"
    path.write_text(text, encoding="utf-8")
    return path


def typed(tmp_path, definition, name="t"):
    """The one vehicle of a recording whose type a file defines so."""
    path = write(tmp_path, [samples.row(type=name)])
    recording = read_traffic(path, vehicle_types=write_types(tmp_path, f"<additional>{definition}</additional>"))
    return CLASSES[recording.class_index[0]], recording.size_m[0].tolist()


def assert_same(given, expected):
    assert_same_boxes(given, expected)
    assert given.report == expected.report


# --- where the boxes are ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("angle", "heading", "centre"),
    [(0, 90, (50, 0.5)), (90, 0, (47.5, 3)), (180, -90, (50, 5.5)), (270, 180, (52.5, 3)), (45, 45, (48.2322, 1.2322))],
)
def test_a_compass_angle_becomes_a_heading_and_the_box_lies_behind_its_front(tmp_path, angle, heading, centre):
    vehicles = read_traffic(write(tmp_path, [samples.row(angle=angle)])).at(0)
    assert math.remainder(math.degrees(vehicles.heading_rad[0]) - heading, 360) == pytest.approx(0, abs=1e-9)
    np.testing.assert_allclose(vehicles.centre_m, [[*centre, 0.75]], atol=1e-4)


@given(
    centre=st.complex_numbers(max_magnitude=500, allow_nan=False),
    heading=st.floats(-math.pi, math.pi),
    origin=st.complex_numbers(max_magnitude=1e6, allow_nan=False),
    turn=st.floats(-360, 360),
    length=st.floats(1, 25),
)
def test_a_box_comes_back_from_where_sumo_would_record_its_front(
    tmp_path_factory, centre, heading, origin, turn, length
):
    """Independently, with complex numbers: the road's x axis is a unit number, and so is the vehicle's."""
    tmp_path = tmp_path_factory.mktemp("sumo")
    axis = cmath.exp(1j * math.radians(turn))
    front = origin + axis * (centre + cmath.rect(length / 2, heading))
    angle = (90 - math.degrees(cmath.phase(axis * cmath.rect(1, heading)))) % 360
    rows = [samples.row(x=repr(front.real), y=repr(front.imag), angle=repr(angle))]
    types = write_types(tmp_path, f'<routes><vType id="car" length="{length!r}"/></routes>')
    settings = {"origin_m": (origin.real, origin.imag), "heading_deg": turn, "vehicle_types": types}
    recording = read_traffic(write(tmp_path, rows), **settings)
    np.testing.assert_allclose(recording.centre_m[0, :2], [centre.real, centre.imag], atol=1e-8)
    assert math.remainder(recording.heading_rad[0] - heading, 2 * math.pi) == pytest.approx(0, abs=1e-9)


def test_boxes_stand_on_the_flat_road_and_a_note_says_so_where_it_is_not_flat(tmp_path):
    flat = read_traffic(write(tmp_path, [samples.row(z=7.0), samples.row(0.1, z=7.05)]))
    hilly = read_traffic(write(tmp_path, [samples.row(z=7.0), samples.row(0.1, z=9.5)]))
    assert flat.centre_m[:, 2].tolist() == hilly.centre_m[:, 2].tolist() == [0.75, 0.75]
    said = "Ground: z from 7.0 to 9.5 m checks the grade alone; vehicles stand on the plane of [road]"
    assert said in hilly.report.assumed
    assert not any(text.startswith("Ground") for text in flat.report.assumed)


# --- one recording, many files ----------------------------------------------------------------------------------------

CROWD = [
    *samples.driving(frames=5, type="lorry"),
    samples.row(0.4, "person", id="walker", type="DEFAULT_PEDTYPE"),
    samples.row(0.4, "container", id="crate", type="DEFAULT_CONTAINERTYPE"),
    *[samples.row(0.5 + 0.1 * k, x=60.125 + k, y=-3.75, angle=123.45, lane=":junction_1_2") for k in range(5)],
]
SHUFFLED = ("lane", "y", "edge", "angle", "slope", "time", "speed", "x", "id", "type", "pos")
AS_TEXT = {
    "CSV": lambda: samples.csv(CROWD),
    "CSV, columns in another order": lambda: samples.csv(CROWD, columns=SHUFFLED),
    "CSV, commas": lambda: samples.csv(CROWD, separator=","),
    "CSV, tabs": lambda: samples.csv(CROWD, separator="\t"),
    "CSV, CRLF and blank lines": lambda: samples.csv(CROWD).replace("\n", "\r\n\r\n"),
    "CSV, plain column names": lambda: samples.csv(CROWD).replace("vehicle_", "").replace("timestep_", ""),
    "CSV, full column names": lambda: samples.csv(CROWD).replace("vehicle_", "timestep_vehicle_"),
    "CSV that begins with a person": lambda: samples.csv(CROWD).replace("vehicle_", "person_"),
    "CSV by xml2csv.py": lambda: samples.xml2csv(CROWD),
    "XML without indents": lambda: samples.xml(CROWD).replace("  ", ""),
    "XML, empty timesteps between": lambda: samples.xml(CROWD).replace(
        "</timestep>", '</timestep><timestep time="9"/>'
    ),
}


@pytest.fixture
def expected(tmp_path):
    return read_traffic(write(tmp_path, CROWD), vehicle_types=write_types(tmp_path))


@pytest.mark.parametrize("layout", AS_TEXT)
@pytest.mark.parametrize("packed", [False, True])
def test_every_text_layout_gives_the_same_recording(tmp_path, expected, layout, packed):
    path = tmp_path / "run.dat"
    data = AS_TEXT[layout]().encode()
    path.write_bytes(gzip.compress(data) if packed else data)
    found = read_traffic(path, vehicle_types=tmp_path / "types.rou.xml")
    assert_same(found, expected)
    assert (found.report.rows_read, found.report.left_out, len(found)) == (len(CROWD), 1, len(CROWD) - 1)
    (walking,) = np.flatnonzero(found.class_index == CLASSES.index("pedestrian"))
    assert found.vehicle_id[walking] > found.vehicle_id[found.class_index != CLASSES.index("pedestrian")].max()


def test_chunks_do_not_show(tmp_path, expected, monkeypatch):
    from blender_lidar import csv_tables as csv_rows
    from blender_lidar.traffic import sumo_types

    monkeypatch.setattr(csv_rows, "_CHUNK_ROWS", 3)
    monkeypatch.setattr(sumo_types, "_BLOCK_BYTES", 101)
    for name, text in (("run.csv", samples.csv(CROWD)), ("run.xml", samples.xml(CROWD))):
        path = tmp_path / name
        path.write_text(text, encoding="utf-8")
        assert_same(read_traffic(path, vehicle_types=tmp_path / "types.rou.xml"), expected)


def test_columns_that_may_be_missing_are_not_missed(tmp_path):
    path = tmp_path / "few.csv"
    path.write_text(samples.csv(samples.driving(), columns=("time", "id", "x", "y", "angle")), encoding="utf-8")
    recording = read_traffic(path)
    assert set(recording.lane) == {0}
    np.testing.assert_array_equal(recording.centre_m, read_traffic(write(tmp_path, samples.driving())).centre_m)
    assert any("a passenger car's for no type" in text for text in recording.report.assumed)


# --- numbers ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("ids", "numbers"),
    [
        (["7", "0", "12"], [7, 0, 12]),
        (["7", "0", "flow.12"], [0, 1, 2]),
        (["7", "07", "12"], [0, 1, 2]),
        (["7", "-1", "12"], [0, 1, 2]),
        (["7", "9" * 5000, "12"], [0, 1, 2]),
        (["7", "٣", "12"], [0, 1, 2]),
    ],
)
def test_vehicles_keep_whole_numbers_else_are_numbered_as_they_appear(tmp_path, ids, numbers):
    rows = [samples.row(0.1 * at, id=name, x=50 + at) for at, name in enumerate(ids)]
    recording = read_traffic(write(tmp_path, rows))
    assert recording.vehicle_id.tolist() == numbers
    message = [note for note in recording.report.notes if "by first appearance" in note]
    assert bool(message) == (numbers != [7, 0, 12])


@pytest.mark.parametrize(
    ("times", "frames", "step_s"),
    [
        ([0, 0.1, 0.2, 0.4], [0, 1, 2, 4], 0.1),
        ([300, 300.5, 301], [600, 601, 602], 0.5),
        ([0.05, 0.15, 0.25], [0, 1, 2], 0.1),
        ([10, 20, 40], [1, 2, 4], 10),
        ([3], [3], 1),
        ([2.5], [5], 0.5),
        ([0], [0], 1),
    ],
)
def test_frames_count_the_longest_step_of_which_times_lie_multiples_apart(tmp_path, times, frames, step_s):
    recording = read_traffic(write(tmp_path, [samples.row(time, x=50 + 10 * time) for time in times]))
    assert recording.frames.tolist() == frames
    assert recording.time_step_s == pytest.approx(step_s)
    np.testing.assert_allclose(recording.frame_time_s, times)


@pytest.mark.parametrize(("per_second", "digits"), [(3, 2), (3, 3), (7, 2), (30, 2), (30, 3), (60, 3)])
@pytest.mark.parametrize("from_s", [0, 100])
def test_times_that_were_rounded_count_the_steps_that_were_meant(tmp_path, per_second, digits, from_s):
    meant = np.delete(np.arange(from_s * per_second, from_s * per_second + 200), [5, 6, 7, 90])
    rows = [samples.row(x=k) | {"time": f"{number / per_second:.{digits}f}"} for k, number in enumerate(meant)]
    recording = read_traffic(write(tmp_path, rows))
    assert np.diff(recording.frames).tolist() == np.diff(meant).tolist()
    assert recording.frames[0] == pytest.approx(meant[0], rel=1e-3)
    assert recording.time_step_s == pytest.approx(1 / per_second, rel=1e-3)
    rounded = f"times are rounded to {10.0**-digits:g} s: a time step of {1 / per_second:.4f}"
    assert any(note.startswith(rounded[:-2]) for note in recording.report.notes)


def test_times_without_a_rhythm_count_the_step_common_to_all_and_are_told(tmp_path):
    times = [0.0, 0.31, 0.9, 1.02, 1.77, 2.5, 4.0]
    recording = read_traffic(write(tmp_path, [samples.row(time, x=time) for time in times]))
    assert recording.frames.tolist() == [0, 31, 90, 102, 177, 250, 400]
    assert recording.time_step_s == 0.01
    assert "times are 0.12 to 1.5 s apart, 0.66 s in the median: frames count steps of 0.01 s" in recording.report.notes


@pytest.mark.parametrize(
    ("lane", "number"),
    [("road_0", 1), ("a_b_2", 3), (":junction_0_1", 2), ("road", 0), ("road_x", 0), ("", 0), ("r_99999", 0)],
)
def test_lanes_count_from_1_the_rightmost(tmp_path, lane, number):
    assert read_traffic(write(tmp_path, [samples.row(lane=lane)])).lane.tolist() == [number]


# --- classes and sizes ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("attributes", "class_name", "size"),
    [
        ("", "car", [5.0, 1.8, 1.5]),
        ('length="4.9"', "car", [4.9, 1.8, 1.5]),
        ('length="4.91" height="1.9"', "van", [4.91, 1.8, 1.9]),
        ('length="5"', "car", [5.0, 1.8, 1.5]),  # SUMO's default, written out
        ('length="5" width="1.8" height="1.5"', "car", [5.0, 1.8, 1.5]),
        ('height="2.5"', "car", [5.0, 1.8, 2.5]),
        ('length="5.3"', "van", [5.3, 1.8, 1.9]),
        ('length="5.3" height="1.6"', "van", [5.3, 1.8, 1.6]),
        ('length="5.2" guiShape="passenger/sedan"', "car", [5.2, 1.8, 1.5]),
        ('length="4.2" guiShape="passenger/van"', "van", [4.2, 1.8, 1.5]),
        ('length="4.2" guiShape="unknown"', "car", [4.2, 1.8, 1.5]),
        ('guiShape="bus" length="18"', "bus", [18.0, 1.8, 1.5]),
        ('vClass="delivery"', "van", [6.5, 2.16, 2.86]),
        ('vClass="truck" width="2.55"', "truck", [7.1, 2.55, 2.4]),
        ('vClass="trailer"', "truck", [16.5, 2.55, 4.0]),
        ('vClass="coach"', "bus", [14.0, 2.6, 4.0]),
        ('vClass="tram"', "bus", [22.0, 2.4, 3.2]),
        ('vClass="moped"', "motorcycle", [2.1, 0.78, 1.7]),
        ('vClass="bicycle"', "bicycle", [1.6, 0.65, 1.7]),
        ('vClass="scooter"', "motorcycle", [1.2, 0.5, 1.7]),
        ('vClass="wheelchair"', "pedestrian", [1.2, 0.72, 1.2]),
        ('vClass="hov" length="5.5"', "van", [5.5, 1.8, 1.9]),
    ],
)
def test_a_type_has_the_size_given_else_its_class_default(tmp_path, attributes, class_name, size):
    assert typed(tmp_path, f'<vType id="t" {attributes}/>') == (class_name, size)


@pytest.mark.parametrize(
    ("name", "class_name", "length"),
    [
        ("lorry@vehicle 7", "truck", 12.5),
        ("DEFAULT_VEHTYPE", "car", 5.0),
        ("DEFAULT_BIKETYPE", "bicycle", 1.6),
        ("DEFAULT_TAXITYPE@3", "car", 5.0),
    ],
)
def test_sumos_own_types_need_no_definition(tmp_path, name, class_name, length):
    recording = read_traffic(write(tmp_path, [samples.row(type=name)]), vehicle_types=write_types(tmp_path))
    assert CLASSES[recording.class_index[0]] == class_name
    assert recording.size_m[0, 0] == length


def test_without_a_file_of_types_the_class_in_a_name_tells_the_size_and_anything_else_is_a_car(tmp_path):
    names = ("bus", "truck@4", "my_fast_car", "DEFAULT_VEHTYPE", "lorry", "x", "y", "z1", "w")
    rows = [samples.row(id=str(number), x=20.0 * number, type=name) for number, name in enumerate(names)]
    recording = read_traffic(write(tmp_path, rows))
    kinds = ["bus", "truck", "car", "car", "truck", *["car"] * 4]
    assert [CLASSES[index] for index in recording.class_index] == kinds
    assert recording.size_m[:, 0].tolist() == [12.0, 7.1, 5.0, 5.0, 7.1, *[5.0] * 4]
    assert recording.report.assumed == (
        "Sizes: without vehicle_types SUMO's defaults for the vehicle class in the type's name, "
        "a passenger car's for x, y, z1 and 1 more",
    )
    first = "4 vehicles of a type that names no vehicle class taken for cars: give vehicle_types"
    assert first in recording.report.lines(losses=True)


@pytest.mark.parametrize(
    ("name", "found"),
    [
        *(
            (f"{prefix}_{name}", name)
            for prefix in ("veh", "bike", "x")
            for name in sorted(set(DEFAULT_TYPES) - {"custom1", "custom2"})
        ),
        *((name.upper(), name) for name in ("truck", "tram", "trailer")),
        ("Truck-1", "truck"),
        ("hdvTruck", "truck"),
        ("HDVTruck2", "truck"),
        ("cityBus", "bus"),
        ("bus_1_long", "bus"),
        ("moto_7", "motorcycle"),
        ("LKW", "truck"),
        ("type1", None),
        ("intruck", None),
        ("railing", None),
        ("", None),
    ],
)
def test_the_class_in_a_types_name_is_found_between_its_divisions(name, found):
    assert class_in_name(name) == found


def test_types_may_stand_in_several_files_and_a_configuration_names_them(tmp_path):
    for name, vehicle_class in (("a", "bus"), ("b", "truck")):
        text = f'<routes><vType id="{name}" vClass="{vehicle_class}"/><vType id="c"/></routes>'
        (tmp_path / f"{name}.rou.xml").write_text(text)
    (tmp_path / "detectors.add.xml").write_text("<additional/>")
    rows = write(tmp_path, [samples.row(id=name, x=30.0 * place, type=name) for place, name in enumerate("abc")])
    files = [tmp_path / "a.rou.xml", tmp_path / "b.rou.xml"]
    recording = read_traffic(rows, vehicle_types=files)
    assert [CLASSES[index] for index in recording.class_index] == ["bus", "truck", "car"]
    config = tmp_path / "site.sumocfg"
    config.write_text(
        '<configuration><input><route-files value="a.rou.xml, b.rou.xml"/><additional-files v="detectors.add.xml"/>'
        '</input><output><output-prefix value="one_"/><fcd-output value="fcd.xml"/></output></configuration>'
    )
    assert read_config(config) == (None, tmp_path / "one_fcd.xml", files)
    with pytest.raises(InputError, match=r"is SUMO's configuration; give .*--vehicle-types .*a\.rou\.xml --vehicle-t"):
        read_types(config)
    (tmp_path / "b.rou.xml").write_text('<routes><vType id="a" vClass="truck"/></routes>')
    with pytest.raises(InputError, match="vType 'a' is there twice"):
        read_types(*files)


def test_a_mesoscopic_recording_is_told_as_such(tmp_path):
    path = write(tmp_path, [samples.row()])
    path.write_text(path.read_text().replace("<vehicle ", '<vehicle segment="3" '))
    with pytest.raises(InputError, match="is of a mesoscopic run, whose vehicles have no places of their own"):
        read_traffic(path)


def test_what_drives_on_no_road_is_left_out_and_counted(tmp_path):
    rows = [samples.row(time, id=kind, type=kind) for time in (0, 0.1) for kind in ("rail_urban", "bus", "pedestrian")]
    recording = read_traffic(write(tmp_path, rows))
    assert [CLASSES[index] for index in recording.class_index] == ["bus", "pedestrian"] * 2
    assert recording.report.left_out == 2
    assert "rows of vehicles on no road: 2 of rail_urban" in recording.report.notes
    assert "2 rows left out: no vehicle on a road" in recording.report.lines()
    alone = recording.vehicles_alone
    assert [CLASSES[index] for index in alone.class_index] == ["bus", "bus"]
    assert "4 rows left out: no vehicle on a road" in alone.report.lines()
    assert "Pedestrians: 1 left out; [objective] classes that name pedestrian score them" in alone.report.assumed


def test_a_person_is_another_than_the_vehicle_of_the_same_id_and_stands_by_its_own_type(tmp_path):
    rows = [samples.row(0.1 * k, id="1", x=10.0 + k) for k in range(3)]
    rows += [samples.row(0.1 * k, "person", id="1", x=50.0, y=8.0, angle=90, type="walker") for k in range(3)]
    walker = '<vType id="walker" vClass="pedestrian" length="0.4" width="0.5" height="1.6"/>'
    for types in ((), (TYPES.replace("</routes>", walker + "</routes>"),)):
        files = {"vehicle_types": write_types(tmp_path, *types)} if types else {}
        found = read_traffic(write(tmp_path, rows), **files)
        walking = found.class_index == CLASSES.index("pedestrian")
        assert (sorted(set(found.vehicle_id[~walking])), sorted(set(found.vehicle_id[walking]))) == ([1], [2])
        length = 0.4 if types else 0.215
        np.testing.assert_allclose(found.centre_m[walking, 0], 50.0 - 0.5 * length)
        assert set(found.size_m[walking, 0]) == {length}


def test_persons_in_a_vehicle_are_left_out(tmp_path):
    rows = [samples.row(0.1 * k, x=10.0 + k) for k in range(3)]
    rows += [samples.row(0.1 * k, "person", id="rider", x=10.0 + k) for k in range(3)]
    rows += [samples.row(0.2, "person", id="waits", x=15.0)]
    found = read_traffic(write(tmp_path, rows))
    assert (found.report.left_out, (found.class_index == CLASSES.index("pedestrian")).sum()) == (3, 1)


def test_persons_in_another_frame_than_vehicles_are_left_out_and_a_note_says_so(tmp_path):
    rows = [samples.row(0.1 * k, x=460_000.0 + k, y=5_430_000.0) for k in range(3)]
    rows += [samples.row(0.1 * k, "person", id="p", x=k, y=3.0) for k in range(3)]
    found = read_traffic(write(tmp_path, rows))
    assert (len(found), found.report.left_out) == (3, 3)
    assert any("as SUMO writes them with --fcd-output.utm" in note for note in found.report.notes)


# --- defects ----------------------------------------------------------------------------------------------------------


def test_a_vehicle_twice_in_one_timestep_counts_once_and_is_told(tmp_path):
    rows = [samples.row(), samples.row(), samples.row(x=51.0), samples.row(0.1)]
    recording = read_traffic(write(tmp_path, rows))
    assert recording.centre_m[:, 0].tolist() == [47.5, 47.5]
    assert (recording.report.duplicates, recording.report.repeated) == (1, 1)


def test_a_vehicle_that_is_nowhere_is_dropped(tmp_path):
    nowhere = samples.row(0.1, x="-1073741824.00", y="-1073741824.00")
    recording = read_traffic(write(tmp_path, [samples.row(), nowhere, samples.row(0.2), samples.row(0.3)]))
    assert (recording.frames.tolist(), recording.report.off_map) == ([0, 2, 3], 1)


@pytest.mark.parametrize("speed", [None, 0.0])
def test_metres_near_the_origin_are_not_taken_for_degrees(tmp_path, speed):
    rows = [samples.row(0.1 * k, id=str(n), x=4.0 * n, speed=speed) for k in range(3) for n in range(3)]
    assert len(read_traffic(write(tmp_path, rows))) == 9
    rows = [samples.row(0.1 * k, x=0.5 + k, y=0.1) for k in range(3)]
    assert len(read_traffic(write(tmp_path, rows))) == 3
