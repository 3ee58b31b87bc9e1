"""A recording that cannot be used ends in one line that names the file, and the line and column where there is one."""

from __future__ import annotations

import gzip
import sys

import numpy as np
import pytest

from blender_lidar import csv_tables as source
from blender_lidar.errors import BlenderLidarError, InputError, MissingExtraError, MissingFileError
from blender_lidar.traffic import read_traffic
from tests import sumo_samples as sumo
from tests import traffic_samples as ngsim
from tests.traffic_samples import refused

# --- NGSIM, and files of something else -------------------------------------------------------------------------------


@pytest.fixture
def columns():
    return ngsim.columns(vehicles=3, frames=20)


def with_field(text, line, field, value, separator=None):
    """The same text with one field, both counted from 1, replaced."""
    lines = text.splitlines()
    fields = lines[line - 1].split(separator)
    fields[field - 1] = value
    lines[line - 1] = (separator or " ").join(fields)
    return "\n".join(lines) + "\n"


@pytest.mark.parametrize("content", [b"", b"\n \n", gzip.compress(b"", mtime=0)])
def test_an_empty_file(tmp_path, content):
    path = tmp_path / "empty.txt"
    path.write_bytes(content)
    assert refused(path) == "FILE: no rows; a table is needed"


@pytest.mark.parametrize(
    ("content", "text"),
    [
        (bytes(range(256)) * 40, "not a text file"),
        ("1 2 3\n".encode("utf-16"), "FILE:1: 3 fields; NGSIM rows have 18 or 24"),
        (b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1" + bytes(100), "FILE: a workbook of a spreadsheet"),
        (b"PK\x03\x04\x14\0\x06\0[Content_Types].xml", "FILE: a workbook of a spreadsheet; save the sheet as CSV"),
        (b"PK\x03\x04" + bytes(100), "zip archive"),
        (b"# nothing else\n", "no rows"),
        (
            b"hello world\n",
            "FILE:1: no traffic that is known: it begins with 'hello world'; allowed: NGSIM's text or CSV (Vehicle_ID, "
            "Frame_ID, Global_Time, Local_X, Local_Y, v_Length, v_Width, v_Class, Lane_ID), SUMO's floating car data "
            "(time, id, x, y, angle), or a table of boxes (frame, vehicle_id, class, x_m, y_m, length_m, width_m, "
            "height_m, heading_deg)",
        ),
        (b"1 2 3\n", "FILE:1: 3 fields; NGSIM rows have 18 or 24"),
    ],
)
def test_a_file_of_something_else(tmp_path, content, text):
    path = tmp_path / "other.txt"
    path.write_bytes(content)
    assert text in refused(path)


def test_a_truncated_gzip_file(tmp_path, columns):
    path = tmp_path / "cut.txt.gz"
    noise = {"Local_X": np.random.default_rng(0).random(60)}
    whole = gzip.compress(ngsim.native(columns | noise).encode())
    for length in (len(whole) // 2, len(whole) - 4, 12):
        path.write_bytes(whole[:length])
        assert "truncated or damaged gzip" in refused(path)
    path.write_bytes(whole[:60] + b"\xff\xfe" * 20 + whole[100:])
    assert "truncated or damaged gzip" in refused(path)


@pytest.mark.parametrize("column", ["Vehicle_ID", "Local_X", "v_Class", "Lane_ID", "Global_Time"])
def test_a_missing_column(tmp_path, columns, column):
    path = ngsim.write(tmp_path, ngsim.api(columns).replace(column.lower(), "other", 1))
    assert f"FILE:1: no column {column}; needed: Vehicle_ID, Frame_ID" in refused(path)


def test_a_header_alone(tmp_path, columns):
    path = ngsim.write(tmp_path, ngsim.api(columns).splitlines()[0] + "\n")
    assert refused(path) == "FILE: no rows below the header in line 1"


BAD_VALUES = [
    (5, "abc", "Local_X is 'abc'; allowed: feet"),
    (6, "NaN", "Local_Y is 'NaN'; allowed: feet"),
    (1, "1.5", "Vehicle_ID is 1.5; allowed: a whole number of at least 0"),
    (1, "-1", "Vehicle_ID is -1; allowed: a whole number of at least 0"),
    (2, "x", "Frame_ID is 'x'; allowed: a whole number"),
    (4, "-inf", "Global_Time is '-inf'; allowed: milliseconds"),
    (9, "-14.5", "v_Length is -14.5; allowed: feet, at least 0"),
    (11, "4", "v_Class is 4; allowed: 1 (motorcycle), 2 (auto) or 3 (truck)"),
]


@pytest.mark.parametrize(("field", "value", "text"), BAD_VALUES)
def test_a_bad_value_in_native_text(tmp_path, columns, field, value, text):
    path = ngsim.write(tmp_path, "# made up\n\n" + with_field(ngsim.native(columns), 31, field, value))
    assert refused(path) == f"FILE:33: {text}"


@pytest.mark.parametrize(("line", "chunk"), [(2, 400_000), (30, 7), (60, 7)])
@pytest.mark.parametrize(("fields", "kept"), [(17, slice(17)), (19, slice(None))])
def test_a_wrong_number_of_fields(tmp_path, columns, monkeypatch, line, chunk, fields, kept):
    monkeypatch.setattr(source, "_CHUNK_ROWS", chunk)
    path = tmp_path / "recording.txt"
    lines = ngsim.native(columns).splitlines()
    lines[line - 1] = " ".join([*lines[line - 1].split(), "7"][kept])
    path.write_text("\n".join(lines) + "\n")
    assert refused(path) == f"FILE:{line}: {fields} fields; the first line has 18"


@pytest.mark.parametrize("line", [2, 30, 61])
def test_a_wrong_number_of_fields_in_csv(tmp_path, columns, line):
    path = tmp_path / "api.csv"
    lines = ngsim.api(columns).splitlines()
    whole = lines[line - 1]
    lines[line - 1] = whole.rsplit(",", 1)[0]
    path.write_text("\n".join(lines) + "\n")
    assert refused(path) == f"FILE:{line}: 24 fields; the first line has 25"
    lines[line - 1] = whole.replace(",", ",1,", 1)  # an unquoted thousands separator
    path.write_text("\n".join(lines) + "\n")
    assert refused(path) == f"FILE:{line}: 26 fields; the first line has 25"


def test_settings_that_do_not_fit_the_format(tmp_path, columns):
    path = ngsim.write(tmp_path, ngsim.native(columns))
    assert "heading_deg = 3.0 does not apply to traffic of format 'ngsim'" in refused(path, heading_deg=3.0)
    with pytest.raises(InputError, match=r"unknown traffic format 'ngsm'; did you mean 'ngsim'\?"):
        read_traffic(path, format="ngsm")


# --- SUMO -------------------------------------------------------------------------------------------------------------

ROWS = sumo.driving(3, 8)
HEADER_LINES = 5  # of `sumo.xml`, before the first timestep


def write(tmp_path, content, name="run.fcd.xml"):
    path = tmp_path / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


def of_rows(tmp_path, *rows):
    return write(tmp_path, sumo.xml(rows))


# --- SUMO: XML --------------------------------------------------------------------------------------------------------


def test_truncated_xml(tmp_path):
    text = sumo.xml(ROWS)
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


# --- SUMO: values -----------------------------------------------------------------------------------------------------

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
    rows = [*ROWS[:4], sumo.row(0.1, **{name: value}), *ROWS[6:]]
    assert refused(of_rows(tmp_path, *rows)) == f"FILE:{HEADER_LINES + 1 + 3 + 2 + 2}: {reason}"


@pytest.mark.parametrize(("name", "value", "reason"), [case for case in BAD_VALUES if case[1]])
def test_a_bad_value_in_csv(tmp_path, monkeypatch, name, value, reason):
    monkeypatch.setattr(source, "_CHUNK_ROWS", 2)
    rows = [*ROWS[:4], sumo.row(0.1, **{name: value}), *ROWS[6:]]
    text = sumo.csv(rows, columns=("time", "z", *sumo.ATTRIBUTES))
    assert refused(write(tmp_path, text, "run.csv")) == f"FILE:6: {reason}"


@pytest.mark.parametrize("layout", ["xml", "csv"])
def test_times_that_go_back(tmp_path, layout):
    rows = [sumo.row(0.5), sumo.row(0.6), sumo.row(0.2)]
    text = sumo.xml(rows) if layout == "xml" else sumo.csv(rows)
    line = HEADER_LINES + 8 if layout == "xml" else 4
    assert refused(write(tmp_path, text)) == f"FILE:{line}: time 0.2 s comes after a later one"


def test_times_for_people_to_read(tmp_path):
    text = sumo.xml(ROWS).replace('time="0.00"', 'time="00:00:00.00"')
    allowed = "a finite number of seconds (leave out SUMO's --human-readable-time)"
    assert refused(write(tmp_path, text)) == f"FILE:7: time is '00:00:00.00'; allowed: {allowed}"


def test_a_recording_without_vehicles(tmp_path):
    persons = [sumo.row(0.1 * k, "person", id="p") for k in range(3)]
    assert refused(of_rows(tmp_path, *persons)) == "FILE: no vehicle in 3 rows; at least one is needed"
    assert refused(write(tmp_path, sumo.csv(persons), "p.csv")) == "FILE: no vehicle in 3 rows; at least one is needed"
    trains = [sumo.row(0.1 * k, type="subway", x=50.0 + k) for k in range(3)]
    assert refused(of_rows(tmp_path, *trains)) == "FILE: no vehicle on a road; all are subway"
    header = sumo.csv(ROWS).split("\n", 1)[0]
    assert refused(write(tmp_path, header + "\n", "header.csv")) == "FILE: no vehicle in 0 rows; at least one is needed"


@pytest.mark.parametrize("speed", [13.0, 0.0, None])
def test_longitude_and_latitude(tmp_path, speed):
    rows = [
        sumo.row(0.1 * k, id=str(n), x=8.5 + 1e-5 * (k * (speed or 0) / 7.3 + 10 * n), y=49.0, speed=speed)
        for k in range(10)
        for n in range(3)
    ]
    assert refused(of_rows(tmp_path, *rows)) == (
        "FILE: x and y are longitude and latitude; metres are needed: run SUMO without --fcd-output.geo, "
        "or with --fcd-output.utm"
    )


# --- SUMO: CSV --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["x", "angle", "time"])
def test_a_missing_column_of_sumo(tmp_path, name):
    columns = [column for column in ("time", *sumo.ATTRIBUTES) if column != name]
    text = refused(write(tmp_path, sumo.csv(ROWS, columns=columns)), format="sumo")
    assert text.startswith(f"FILE:1: no column {name}; needed: time, id, x, y, angle")


# --- SUMO: Parquet ----------------------------------------------------------------------------------------------------


def test_a_damaged_parquet_file(tmp_path):
    sumo.need_pyarrow()
    whole = sumo.write_parquet(tmp_path / "whole.parquet", ROWS).read_bytes()
    for damaged in (whole[: len(whole) // 2], b"PAR1", b"PAR1" + bytes(200), whole[:40] + b"\xff" * 80 + whole[120:]):
        assert refused(write(tmp_path, damaged)).startswith("FILE: truncated or damaged Parquet file (")
    assert refused(write(tmp_path, gzip.compress(whole))) == "FILE: not a text file (UTF-8, UTF-16 or Windows-1252)"


def test_a_bad_value_in_parquet(tmp_path):
    sumo.need_pyarrow()
    path = tmp_path / "run.parquet"
    sumo.write_parquet(path, [*ROWS, sumo.row(0.8, x="nan")])
    assert refused(path) == f"FILE: row {len(ROWS) + 1}: x is 'nan'; allowed: {PLACE}"
    sumo.write_parquet(path, [*ROWS, sumo.row(0.8, y=None)])
    assert f"FILE: row {len(ROWS) + 1}: y is" in refused(path)
    sumo.write_parquet(path, ROWS, columns=("time", "id", "x", "y"))
    assert refused(path).startswith("FILE: no column angle; needed: time")


def test_parquet_without_pyarrow_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    path = write(tmp_path, b"PAR1 and more")
    with pytest.raises(MissingExtraError) as caught:
        read_traffic(path)
    assert str(caught.value) == f'{path}: Parquet files need pyarrow: pip install "blender_lidar[parquet]"'


# --- SUMO: vehicle types ----------------------------------------------------------------------------------------------


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
    "rows", [[sumo.row(type=None)], [sumo.row(), sumo.row(id="b", x=9.0, type=None)]], ids=["none", "one"]
)
def test_a_file_of_types_for_a_recording_without_types(tmp_path, rows):
    path = write_types(tmp_path)
    assert refused(of_rows(tmp_path, *rows), vehicle_types=path).replace(str(path), "TYPES") == (
        "FILE: vehicle_types TYPES: vehicles have no type, so it cannot give their sizes; SUMO writes types unless "
        "--fcd-output.attributes leaves them out: name type there, or do without vehicle_types"
    )


def test_a_missing_file_of_types(tmp_path):
    with pytest.raises(MissingFileError, match=r"nowhere\.rou\.xml: there is no such file"):
        read_traffic(of_rows(tmp_path, *ROWS), vehicle_types=tmp_path / "nowhere.rou.xml")
