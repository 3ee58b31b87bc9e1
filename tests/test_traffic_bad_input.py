"""A file that cannot be used ends in one line that names the file, and the line and column where there is one."""

from __future__ import annotations

import gzip

import numpy as np
import pytest

from blender_lidar.errors import InputError, MissingFileError
from blender_lidar.traffic import read_traffic, source
from tests import traffic_samples as samples
from tests.traffic_samples import refused


@pytest.fixture
def columns():
    return samples.columns(vehicles=3, frames=20)


def with_field(text, line, field, value, separator=None):
    """The same text with one field, both counted from 1, replaced."""
    lines = text.splitlines()
    fields = lines[line - 1].split(separator)
    fields[field - 1] = value
    lines[line - 1] = (separator or " ").join(fields)
    return "\n".join(lines) + "\n"


def test_no_such_file(tmp_path):
    with pytest.raises(MissingFileError, match=r"nowhere\.txt: there is no such file"):
        read_traffic(tmp_path / "nowhere.txt")


def test_a_folder(tmp_path):
    assert refused(tmp_path) == "FILE: is a folder; allowed: a file of vehicles"


@pytest.mark.parametrize("content", [b"", b"\n \n", gzip.compress(b"", mtime=0)])
def test_an_empty_file(tmp_path, content):
    path = tmp_path / "empty.txt"
    path.write_bytes(content)
    assert refused(path) == "FILE: no rows; a file of vehicles is needed"


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
    whole = gzip.compress(samples.native(columns | noise).encode())
    for length in (len(whole) // 2, len(whole) - 4, 12):
        path.write_bytes(whole[:length])
        assert "truncated or damaged gzip" in refused(path)
    path.write_bytes(whole[:60] + b"\xff\xfe" * 20 + whole[100:])
    assert "truncated or damaged gzip" in refused(path)


@pytest.mark.parametrize("column", ["Vehicle_ID", "Local_X", "v_Class", "Lane_ID", "Global_Time"])
def test_a_missing_column(tmp_path, columns, column):
    path = samples.write(tmp_path, samples.api(columns).replace(column.lower(), "other", 1))
    assert f"FILE:1: no column {column}; needed: Vehicle_ID, Frame_ID" in refused(path)


def test_a_header_alone(tmp_path, columns):
    path = samples.write(tmp_path, samples.api(columns).splitlines()[0] + "\n")
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
    path = samples.write(tmp_path, "# made up\n\n" + with_field(samples.native(columns), 31, field, value))
    assert refused(path) == f"FILE:33: {text}"


@pytest.mark.parametrize(("line", "chunk"), [(2, 400_000), (30, 7), (60, 7)])
@pytest.mark.parametrize(("fields", "kept"), [(17, slice(17)), (19, slice(None))])
def test_a_wrong_number_of_fields(tmp_path, columns, monkeypatch, line, chunk, fields, kept):
    monkeypatch.setattr(source, "_CHUNK_ROWS", chunk)
    path = tmp_path / "recording.txt"
    lines = samples.native(columns).splitlines()
    lines[line - 1] = " ".join([*lines[line - 1].split(), "7"][kept])
    path.write_text("\n".join(lines) + "\n")
    assert refused(path) == f"FILE:{line}: {fields} fields; the first line has 18"


@pytest.mark.parametrize("line", [2, 30, 61])
def test_a_wrong_number_of_fields_in_csv(tmp_path, columns, line):
    path = tmp_path / "api.csv"
    lines = samples.api(columns).splitlines()
    whole = lines[line - 1]
    lines[line - 1] = whole.rsplit(",", 1)[0]
    path.write_text("\n".join(lines) + "\n")
    assert refused(path) == f"FILE:{line}: 24 fields; the first line has 25"
    lines[line - 1] = whole.replace(",", ",1,", 1)  # an unquoted thousands separator
    path.write_text("\n".join(lines) + "\n")
    assert refused(path) == f"FILE:{line}: 26 fields; the first line has 25"


def test_settings_that_do_not_fit_the_format(tmp_path, columns):
    path = samples.write(tmp_path, samples.native(columns))
    assert "heading_deg = 3.0 does not apply to traffic of format 'ngsim'" in refused(path, heading_deg=3.0)
    with pytest.raises(InputError, match=r"unknown traffic format 'ngsm'; did you mean 'ngsim'\?"):
        read_traffic(path, format="ngsm")
