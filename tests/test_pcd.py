"""PCD files as others write them, and damaged; test_cloud_formats has ours, read by another reader."""

from __future__ import annotations

import numpy as np
import pytest

from blender_lidar.clouds.files import read_points
from tests.test_clouds import SUFFIXES, refusal


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
    "compressed": pcd(ROWS, DATA="binary_compressed"),
    "no POINTS": pcd(ROWS, POINTS=None),
    "no z": pcd(b"1 2\n3 4\n", FIELDS="x y", SIZE="4 4", TYPE="F F", COUNT="1 1"),
    "z twice over": pcd(bytes(32), DATA="binary", COUNT="1 1 2"),
    "truncated": pcd(bytes(23), DATA="binary"),
    "text in a number": pcd(b"1 2 3\n4 five 6\n"),
    "ragged rows": pcd(b"1 2 3\n4 5\n"),
    "columns that no field names": pcd(b"1 2 3 4\n5 6 7 8\n"),
    "not ascii": pcd("1 2 ³\n4 5 6\n".encode()),
    "too few rows": pcd(b"1 2 3\n"),
    "too many rows": pcd(ROWS + b"7 8 9\n"),
    "an id that is a fraction": pcd(b"1 2 3 0.5\n4 5 6 1\n", **LABELLED),
}


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("name", DAMAGED_PCD)
def test_a_damaged_pcd_file_is_refused_in_one_line(tmp_path, name):
    path = tmp_path / "cloud.pcd"
    path.write_bytes(DAMAGED_PCD[name])
    assert refusal(path)
