"""A recording of SUMO's that cannot be used ends in one line that names the file, and the line where there is one."""

from __future__ import annotations

import gzip
import sys

import pytest

from blender_lidar.errors import BlenderLidarError, MissingExtraError, MissingFileError
from blender_lidar.traffic import read_traffic, source
from tests import sumo_samples as samples
from tests.traffic_samples import refused

ROWS = samples.driving(3, 8)
HEADER_LINES = 5  # of `samples.xml`, before the first timestep


def write(tmp_path, content, name="run.fcd.xml"):
    path = tmp_path / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


def of_rows(tmp_path, *rows):
    return write(tmp_path, samples.xml(rows))


# --- XML --------------------------------------------------------------------------------------------------------------


def test_truncated_xml(tmp_path):
    text = samples.xml(ROWS)
    for length in (len(text) // 2, len(text) - 3, text.index("<timestep") + 4):
        assert "truncated or damaged XML (" in refused(write(tmp_path, text[:length]))


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        (
            "<fcd-export>\n<timestep time=0/>\n</fcd-export>",
            "FILE:2: truncated or damaged XML (not well-formed",
        ),
        ("<fcd-export>\n</fcd>", "FILE:2: truncated or damaged XML (mismatched tag"),
        ("<routes></routes>", "FILE:1: the root element is <routes>; a recording of SUMO's has <fcd-export>"),
        ("<fcd-export/>", "FILE: no vehicle in 0 rows; at least one is needed"),
        ("<fcd-export>\n<vehicle/></fcd-export>", "FILE:2: <vehicle> outside a <timestep>"),
    ],
)
def test_xml_of_something_else(tmp_path, text, reason):
    assert refused(write(tmp_path, text)).startswith(reason)


# --- values -----------------------------------------------------------------------------------------------------------

PLACE = "a finite number (SUMO leaves it out if --fcd-output.attributes does)"
BAD_VALUES = [
    ("id", None, "id is missing"),
    ("x", "abc", f"x is 'abc'; allowed: {PLACE}"),
    ("x", "nan", f"x is 'nan'; allowed: {PLACE}"),
    ("y", "inf", f"y is 'inf'; allowed: {PLACE}"),
    ("angle", "1,5", f"angle is '1,5'; allowed: {PLACE}"),
    ("z", "-inf", "z is '-inf'; allowed: a finite number"),
]


@pytest.mark.parametrize(("name", "value", "reason"), BAD_VALUES)
def test_a_bad_value_in_xml(tmp_path, name, value, reason):
    rows = [*ROWS[:4], samples.row(0.1, **{name: value}), *ROWS[6:]]
    assert refused(of_rows(tmp_path, *rows)) == f"FILE:{HEADER_LINES + 1 + 3 + 2 + 2}: {reason}"


@pytest.mark.parametrize(("name", "value", "reason"), [case for case in BAD_VALUES if case[1]])
def test_a_bad_value_in_csv(tmp_path, monkeypatch, name, value, reason):
    monkeypatch.setattr(source, "_CHUNK_ROWS", 2)
    rows = [*ROWS[:4], samples.row(0.1, **{name: value}), *ROWS[6:]]
    text = samples.csv(rows, columns=("time", "z", *samples.ATTRIBUTES))
    assert refused(write(tmp_path, text, "run.csv")) == f"FILE:6: {reason}"


@pytest.mark.parametrize("layout", ["xml", "csv"])
def test_times_that_go_back(tmp_path, layout):
    rows = [samples.row(0.5), samples.row(0.6), samples.row(0.2)]
    text = samples.xml(rows) if layout == "xml" else samples.csv(rows)
    line = HEADER_LINES + 8 if layout == "xml" else 4
    assert refused(write(tmp_path, text)) == f"FILE:{line}: time 0.2 s comes after a later one"


def test_times_for_people_to_read(tmp_path):
    text = samples.xml(ROWS).replace('time="0.00"', 'time="00:00:00.00"')
    allowed = "a finite number of seconds (leave out SUMO's --human-readable-time)"
    assert refused(write(tmp_path, text)) == f"FILE:7: time is '00:00:00.00'; allowed: {allowed}"


def test_a_recording_without_vehicles(tmp_path):
    persons = [samples.row(0.1 * k, "person", id="p") for k in range(3)]
    assert refused(of_rows(tmp_path, *persons)) == "FILE: no vehicle in 3 rows; at least one is needed"
    assert (
        refused(write(tmp_path, samples.csv(persons), "p.csv")) == "FILE: no vehicle in 3 rows; at least one is needed"
    )
    trains = [samples.row(0.1 * k, type="subway", x=50.0 + k) for k in range(3)]
    assert refused(of_rows(tmp_path, *trains)) == "FILE: no vehicle on a road; all are subway"
    header = samples.csv(ROWS).split("\n", 1)[0]
    assert refused(write(tmp_path, header + "\n", "header.csv")) == "FILE: no vehicle in 0 rows; at least one is needed"


@pytest.mark.parametrize("speed", [13.0, 0.0, None])
def test_longitude_and_latitude(tmp_path, speed):
    rows = [
        samples.row(0.1 * k, id=str(n), x=8.5 + 1e-5 * (k * (speed or 0) / 7.3 + 10 * n), y=49.0, speed=speed)
        for k in range(10)
        for n in range(3)
    ]
    assert refused(of_rows(tmp_path, *rows)) == (
        "FILE: x and y are longitude and latitude; metres are needed: run SUMO without --fcd-output.geo, "
        "or with --fcd-output.utm"
    )


# --- CSV --------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["x", "angle", "time"])
def test_a_missing_column(tmp_path, name):
    columns = [column for column in ("time", *samples.ATTRIBUTES) if column != name]
    text = refused(write(tmp_path, samples.csv(ROWS, columns=columns)), format="sumo")
    assert text.startswith(f"FILE:1: no column {name}; needed: time, id, x, y, angle")


# --- Parquet ----------------------------------------------------------------------------------------------------------


def test_a_damaged_parquet_file(tmp_path):
    samples.need_pyarrow()
    whole = samples.write_parquet(tmp_path / "whole.parquet", ROWS).read_bytes()
    for damaged in (whole[: len(whole) // 2], b"PAR1", b"PAR1" + bytes(200), whole[:40] + b"\xff" * 80 + whole[120:]):
        assert refused(write(tmp_path, damaged)).startswith("FILE: truncated or damaged Parquet file (")
    assert refused(write(tmp_path, gzip.compress(whole))) == "FILE: not a text file (UTF-8, UTF-16 or Windows-1252)"


def test_a_bad_value_in_parquet(tmp_path):
    samples.need_pyarrow()
    path = tmp_path / "run.parquet"
    samples.write_parquet(path, [*ROWS, samples.row(0.8, x="nan")])
    assert refused(path) == f"FILE: row {len(ROWS) + 1}: x is 'nan'; allowed: {PLACE}"
    samples.write_parquet(path, [*ROWS, samples.row(0.8, y=None)])
    assert f"FILE: row {len(ROWS) + 1}: y is" in refused(path)
    samples.write_parquet(path, ROWS, columns=("time", "id", "x", "y"))
    assert refused(path).startswith("FILE: no column angle; needed: time")


def test_parquet_without_pyarrow_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    path = write(tmp_path, b"PAR1 and more")
    with pytest.raises(MissingExtraError) as caught:
        read_traffic(path)
    assert str(caught.value) == f'{path}: Parquet files need pyarrow: pip install "blender_lidar[parquet]"'


# --- types ------------------------------------------------------------------------------------------------------------


def write_types(tmp_path):
    return write(tmp_path, "<routes><vType id='car'/></routes>", "types.xml")


def types_refused(tmp_path, text):
    path = write(tmp_path, text, "types.xml")
    with pytest.raises(BlenderLidarError) as caught:
        read_traffic(of_rows(tmp_path, *ROWS), vehicle_types=path)
    assert "\n" not in str(caught.value)
    return str(caught.value).replace(str(path), "TYPES").replace(str(tmp_path / "run.fcd.xml"), "FILE")


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("", "TYPES:1: truncated or damaged XML (no element found"),
        ("<routes/>", "TYPES: no <vType>; a route or additional file that defines the vehicles is needed"),
        ("<routes>\n<vType/></routes>", "TYPES:2: vType without an id"),
        ("<routes><vType id='car'/>\n<vType id='car'/></routes>", "TYPES:2: vType 'car' is there twice"),
        ("<routes><vType id='car' length='long'/></routes>", "TYPES:1: length is 'long'; allowed: more"),
        (
            "<routes><vType id='car' height='-1'/></routes>",
            "TYPES:1: height is -1; allowed: more than",
        ),
        (
            "<routes><vType id='car' length='0'/></routes>",
            "TYPES:1: length is 0; allowed: more than 0",
        ),
        (
            "<routes><vType id='car' vClass='lory'/></routes>",
            "TYPES:1: unknown vClass 'lory'; did you mean",
        ),
        (
            "<routes><vType id='cart'/></routes>",
            "FILE: vehicle_types TYPES: unknown type 'car'; did you mean 'cart'?",
        ),
    ],
)
def test_a_file_of_types_that_cannot_be_used(tmp_path, text, reason):
    assert types_refused(tmp_path, text).startswith(reason)


@pytest.mark.parametrize(
    "rows", [[samples.row(type=None)], [samples.row(), samples.row(id="b", x=9.0, type=None)]], ids=["none", "one"]
)
def test_a_file_of_types_for_a_recording_without_types(tmp_path, rows):
    path = write_types(tmp_path)
    assert refused(of_rows(tmp_path, *rows), vehicle_types=path).replace(str(path), "TYPES") == (
        "FILE: vehicle_types TYPES: vehicles have no type, by which it could say the size; SUMO writes types unless "
        "--fcd-output.attributes leaves them out: name type there, or do without vehicle_types"
    )


def test_a_missing_file_of_types(tmp_path):
    with pytest.raises(MissingFileError, match=r"nowhere\.rou\.xml: there is no such file"):
        read_traffic(of_rows(tmp_path, *ROWS), vehicle_types=tmp_path / "nowhere.rou.xml")
