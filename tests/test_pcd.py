"""PCD files, against a reader made from the specification alone, as others write them, and damaged."""

from __future__ import annotations

import json
import struct
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from blender_lidar.clouds.files import read_points, write_cloud
from blender_lidar.errors import OutputError
from tests.test_clouds import CLOUD, HEADER, SUFFIXES, files, refusal


def read_pcd_by_the_book(path):
    """Header and columns of a binary PCD 0.7 file: https://pointclouds.org/documentation/tutorials/pcd_file_format."""
    content = Path(path).read_bytes()
    header, order = {}, []
    while "DATA" not in header:
        line, content = content.split(b"\n", 1)
        if not line.startswith(b"#"):
            key, _, value = line.decode("ascii").partition(" ")
            header[key] = value.split()
            order.append(key)
    assert order == ["VERSION", "FIELDS", "SIZE", "TYPE", "COUNT", "WIDTH", "HEIGHT", "VIEWPOINT", "POINTS", "DATA"]
    assert header["DATA"] == ["binary"]
    codes = {"F4": "f", "F8": "d", "U1": "B", "U2": "H", "U4": "I", "I1": "b", "I2": "h", "I4": "i"}
    layout = "<" + "".join(codes[kind + size] for kind, size in zip(header["TYPE"], header["SIZE"], strict=True))
    assert set(header["COUNT"]) == {"1"}
    assert len(content) == struct.calcsize(layout) * int(header["POINTS"][0])
    rows = list(struct.iter_unpack(layout, content))
    columns = {name: [row[number] for row in rows] for number, name in enumerate(header["FIELDS"])}
    return header, columns


def pcd(body=b"", **changes):
    """A PCD file of two points x, y, z, in ascii unless changed; a change to None leaves a line out."""
    lines = {
        "VERSION": "0.7",
        "FIELDS": "x y z",
        "SIZE": "4 4 4",
        "TYPE": "F F F",
        "COUNT": "1 1 1",
        "WIDTH": "2",
        "HEIGHT": "1",
        "VIEWPOINT": "0 0 0 1 0 0 0",
        "POINTS": "2",
        "DATA": "ascii",
    } | changes
    return "".join(f"{key} {value}\n" for key, value in lines.items() if value is not None).encode() + body


ROWS = b"1 2 3\n4 5 6\n"
LABELLED = {"FIELDS": "x y z vehicle_id", "SIZE": "4 4 4 4", "TYPE": "F F F F", "COUNT": "1 1 1 1"}


def test_pcd_is_read_by_a_reader_made_from_the_specification(tmp_path):
    write_cloud(tmp_path / "cloud.pcd", CLOUD, HEADER)
    header, columns = read_pcd_by_the_book(tmp_path / "cloud.pcd")
    assert (header["WIDTH"], header["HEIGHT"], header["POINTS"]) == ([str(len(CLOUD))], ["1"], [str(len(CLOUD))])
    assert header["VIEWPOINT"] == ["0", "0", "0", "1", "0", "0", "0"]
    np.testing.assert_array_equal(np.column_stack([columns[axis] for axis in "xyz"]), CLOUD.xyz.astype(np.float32))
    np.testing.assert_allclose(columns["intensity"], CLOUD.intensity, rtol=1e-6)
    assert columns["ring"] == CLOUD.ring.tolist()
    assert columns["timestamp"] == CLOUD.time_s.tolist()
    assert columns["vehicle_id"] == CLOUD.vehicle_id.tolist()
    assert columns["class"] == CLOUD.class_index.tolist()
    comment = (tmp_path / "cloud.pcd").read_bytes().split(b"\n")[1]
    assert json.loads(comment.removeprefix(b"# ")) == HEADER


def test_a_vehicle_id_that_a_pcd_file_cannot_hold_is_not_changed_silently(tmp_path):
    large = replace(CLOUD, vehicle_id=np.where(CLOUD.vehicle_id >= 0, CLOUD.vehicle_id + 2**32, -1))
    first = large.vehicle_id[large.vehicle_id >= 0][0]
    with pytest.raises(OutputError, match=rf"cloud\.pcd: vehicle_id {first} does not fit .*; \.npz keeps it$"):
        write_cloud(tmp_path / "cloud.pcd", large, HEADER)
    assert files(tmp_path) == []
    write_cloud(tmp_path / "cloud.npz", large, HEADER)
    np.testing.assert_array_equal(read_points(tmp_path / "cloud.npz")[1], large.vehicle_id)


@pytest.mark.parametrize("number", [2**31 - 1, -(2**31)])
def test_the_largest_ids_of_32_bits_are_kept_by_a_pcd_file(tmp_path, number):
    write_cloud(tmp_path / "cloud.pcd", replace(CLOUD, vehicle_id=np.full(len(CLOUD), number)), HEADER)
    assert (read_points(tmp_path / "cloud.pcd")[1] == number).all()


@pytest.mark.parametrize("line_end", ["\n", "\r\n"])
@pytest.mark.parametrize("count", ["1 1 1", None])
def test_an_ascii_pcd_file_is_read(tmp_path, line_end, count):
    path = tmp_path / "cloud.pcd"
    path.write_bytes((b"# a comment\n" + pcd(ROWS, COUNT=count)).replace(b"\n", line_end.encode()))
    points, vehicle = read_points(path)
    assert points.tolist() == [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]
    assert vehicle is None


def test_fields_in_another_order_and_of_other_kinds_are_read(tmp_path):
    path = tmp_path / "cloud.pcd"
    layout = [("vehicle_id", "<u2"), ("normal", "<f4", 3), ("z", "<f8"), ("y", "<i2"), ("x", "<f4")]
    record = np.array([(5, (9, 9, 9), 3.5, 2, 1.25), (6, (9, 9, 9), -3.5, -2, -1.25)], dtype=layout)
    fields = {"FIELDS": "vehicle_id normal z y x", "SIZE": "2 4 8 2 4", "TYPE": "U F F I F", "COUNT": "1 3 1 1 1"}
    path.write_bytes(pcd(record.tobytes(), DATA="binary", **fields))
    points, vehicle = read_points(path)
    assert points.tolist() == [[1.25, 2.0, 3.5], [-1.25, -2.0, -3.5]]
    assert vehicle.tolist() == [5, 6]


def test_an_ascii_field_of_several_numbers_does_not_shift_the_others(tmp_path):
    path = tmp_path / "cloud.pcd"
    fields = {"FIELDS": "normal x y z vehicle_id", "SIZE": "4 4 4 4 4", "TYPE": "F F F F I", "COUNT": "3 1 1 1 1"}
    path.write_bytes(pcd(b"9 9 9 1 2 3 7\n9 9 9 4 5 6 8\n", **fields))
    points, vehicle = read_points(path)
    assert points.tolist() == [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]
    assert vehicle.tolist() == [7, 8]


def test_the_padding_that_pcl_writes_is_passed_over(tmp_path):
    path = tmp_path / "cloud.pcd"
    record = np.array([(1, 2, 3, b"", 4, b"")], dtype="<f4,<f4,<f4,V4,<f4,V12")
    fields = {"FIELDS": "x y z _ rgb _", "SIZE": "4 4 4 1 4 1", "TYPE": "F F F U F U", "COUNT": "1 1 1 4 1 12"}
    path.write_bytes(pcd(record.tobytes(), DATA="binary", POINTS="1", WIDTH="1", **fields))
    assert read_points(path)[0].tolist() == [[1.0, 2.0, 3.0]]


@pytest.mark.filterwarnings("error")
def test_an_ascii_file_without_points_is_an_empty_cloud(tmp_path):
    path = tmp_path / "cloud.pcd"
    path.write_bytes(pcd(b"\n", POINTS="0", WIDTH="0"))
    assert read_points(path)[0].shape == (0, 3)


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_points_that_are_not_finite_are_left_out_with_their_ids_and_counted(tmp_path, suffix):
    path = tmp_path / f"cloud{suffix}"
    rows = np.array([[1, 2, 3, 7], [np.nan, np.nan, np.nan, np.nan], [4, 5, 6, 8], [0, -np.inf, 0, 9]])
    if suffix == ".npz":
        np.savez(path, xyz=rows[:, :3], vehicle_id=rows[:, 3])
    else:
        path.write_bytes(
            pcd(rows.astype("<f4").tobytes(), DATA="binary", WIDTH="2", HEIGHT="2", POINTS="4", **LABELLED)
        )
    with pytest.warns(UserWarning, match="left out") as caught:
        points, vehicle = read_points(path)
    assert [str(warning.message) for warning in caught] == [f"{path}: 2 of 4 points left out: not finite"]
    assert points.tolist() == [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]
    assert vehicle.tolist() == [7, 8]


DAMAGED_PCD = {
    "empty": b"",
    "garbage": bytes(range(256)) * 8,
    "comments only": b"# nothing\n" * 50,
    "no DATA": b"VERSION 0.7\nFIELDS x y z\n",
    "no kind of DATA": pcd(ROWS, DATA=""),
    "compressed": pcd(ROWS, DATA="binary_compressed"),
    "no POINTS": pcd(ROWS, POINTS=None),
    "POINTS not a number": pcd(ROWS, POINTS="two"),
    "no z": pcd(b"1 2\n3 4\n", FIELDS="x y", SIZE="4 4", TYPE="F F", COUNT="1 1"),
    "x twice": pcd(ROWS, FIELDS="x x z"),
    "a SIZE too few": pcd(ROWS, SIZE="4 4"),
    "a SIZE that is none": pcd(bytes(24), DATA="binary", SIZE="4 4 3"),
    "a TYPE that is none": pcd(bytes(24), DATA="binary", TYPE="F F Q"),
    "z twice over": pcd(bytes(32), DATA="binary", COUNT="1 1 2"),
    "truncated": pcd(bytes(23), DATA="binary"),
    "far more POINTS than bytes": pcd(bytes(24), DATA="binary", POINTS="9000000000000"),
    "text in a number": pcd(b"1 2 3\n4 five 6\n"),
    "ragged rows": pcd(b"1 2 3\n4 5\n"),
    "no rows": pcd(b""),
    "a COUNT of none": pcd(ROWS, COUNT="1 0 1"),
    "a COUNT beyond all memory": pcd(bytes(24), DATA="binary", COUNT=f"1 1 {10**30}"),
    "POINTS that overflow": pcd(bytes(24), DATA="binary", POINTS=str(2**62)),
    "columns that no field names": pcd(b"1 2 3 4\n5 6 7 8\n"),
    "a comment among the rows": pcd(b"1 2 3\n# 4 5 6\n4 5 6\n"),
    "not ascii": pcd("1 2 ³\n4 5 6\n".encode()),
}


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("name", DAMAGED_PCD)
def test_a_damaged_pcd_file_is_refused_in_one_line(tmp_path, name):
    path = tmp_path / "cloud.pcd"
    path.write_bytes(DAMAGED_PCD[name])
    assert refusal(path)


@pytest.mark.parametrize(
    "content",
    [
        pcd(b"1 2 3\n"),
        pcd(ROWS + b"7 8 9\n"),
        pcd(bytes(24), DATA="binary", POINTS="-1"),
        pcd(ROWS, POINTS="0"),
        pcd(b"1 2 3 nan\n4 5 6 1\n", **LABELLED),
        pcd(b"1 2 3 0.5\n4 5 6 1\n", **LABELLED),
    ],
    ids=["ascii truncated", "ascii too long", "negative POINTS", "no POINTS but rows", "id is NaN", "id is a fraction"],
)
@pytest.mark.filterwarnings("error")
def test_a_pcd_file_that_contradicts_itself_is_refused(tmp_path, content):
    path = tmp_path / "cloud.pcd"
    path.write_bytes(content)
    assert refusal(path)
