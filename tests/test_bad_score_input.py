"""Bad input of `score`: one line on stderr that names the place, exit code 2, and nothing left behind."""

from __future__ import annotations

import numpy as np
import pytest

from tests.refusals import BAD_CELLS, changed, refused
from tests.small_scene import cli, traffic_rows, write_table

pytestmark = pytest.mark.usefixtures("quick")


@pytest.fixture
def boxes(tmp_path):
    rows = [[0, 7, "car", 0.0, 5.0, 4.0, 2.0, 1.5, 0.0, 0.0], [0, 8, "car", 9.0, 5.0, 4.0, 2.0, 1.5, 0.0, 0.0]]
    return write_table(tmp_path / "boxes.csv", rows)


@pytest.fixture
def points(tmp_path):
    path = tmp_path / "points.npz"
    np.savez(path, xyz=np.array([[0.0, 4.0, 0.7], [9.0, 4.0, 0.7]]), vehicle_id=np.array([7, 8]))
    return path


def pcd(fields: str, sizes: str, types: str, count: int, body: bytes) -> bytes:
    lines = ["VERSION 0.7", f"FIELDS {fields}", f"SIZE {sizes}", f"TYPE {types}", f"POINTS {count}", "DATA binary", ""]
    return "\n".join(lines).encode() + body


BAD_CLOUDS = {
    "empty.npz": b"",
    "binary.npz": bytes(range(256)),
    "text.pcd": b"x y z\n1 2 3\n",
    "empty.pcd": b"",
    "short.pcd": pcd("x y z", "4 4 4", "F F F", 9, bytes(24)),
    "two.pcd": pcd("x y", "4 4", "F F", 1, bytes(8)),
    "huge.pcd": pcd("x y z", "4 4 4", "F F F", 10**15, bytes(24)),
    "cloud.las": b"LASF",
}


@pytest.mark.parametrize("name", BAD_CLOUDS)
def test_a_cloud_that_cannot_be_scored(tmp_path, capsys, boxes, name):
    (tmp_path / name).write_bytes(BAD_CLOUDS[name])
    line = refused(capsys, tmp_path, "score", "--points", tmp_path / name, "--boxes", boxes, "--assign", "box")
    assert name in line


BAD_ARRAYS = {
    "no xyz": {"points": np.zeros((2, 3))},
    "flat": {"xyz": np.zeros(6)},
    "two columns": {"xyz": np.zeros((3, 2))},
    "text": {"xyz": np.array([["a", "b", "c"]])},
    "ids too short": {"xyz": np.zeros((2, 3)), "vehicle_id": np.array([1])},
    "pickled": {"xyz": np.array([[None, None, None]], dtype=object)},
}


@pytest.mark.parametrize("case", BAD_ARRAYS)
def test_an_npz_that_cannot_be_scored(tmp_path, capsys, boxes, case):
    np.savez(tmp_path / "cloud.npz", **BAD_ARRAYS[case])
    assert "cloud.npz" in refused(capsys, tmp_path, "score", "--points", tmp_path / "cloud.npz", "--boxes", boxes)


def test_clouds_and_boxes_that_are_not_there_or_are_folders(tmp_path, capsys, boxes, points):
    def line(cloud, table):
        return refused(capsys, tmp_path, "score", "--points", cloud, "--boxes", table)

    assert "none.npz" in line("none.npz", boxes)
    assert f"{tmp_path}: is a folder" in line(tmp_path, boxes)
    assert "none.csv: there is no such file" in line(points, "none.csv")
    assert f"{tmp_path}: is a folder" in line(points, tmp_path)


@pytest.mark.parametrize("case", BAD_CELLS)
def test_boxes_that_cannot_be_used(tmp_path, capsys, points, case):
    column, value = BAD_CELLS[case]
    table = write_table(tmp_path / "boxes.csv", changed(column, value))
    assert "boxes.csv:5: " in refused(capsys, tmp_path, "score", "--points", points, "--boxes", table)


def test_a_cloud_without_vehicle_ids_asks_for_assignment_by_box(tmp_path, capsys, boxes):
    np.savez(tmp_path / "bare.npz", xyz=np.zeros((2, 3)))
    line = refused(capsys, tmp_path, "score", "--points", tmp_path / "bare.npz", "--boxes", boxes)
    assert "does not say which vehicle a point belongs to; use --assign box" in line


def test_boxes_with_texts_for_ids_ask_for_assignment_by_box(tmp_path, capsys, points):
    rows = [[0, "veh_7", "car", 0.0, 5.0, 4.0, 2.0, 1.5, 0.0, 0.0]]
    words = ["score", "--points", points, "--boxes", write_table(tmp_path / "boxes.csv", rows)]
    assert "boxes.csv: vehicle_id are texts, and a cloud's are numbers" in refused(capsys, tmp_path, *words)
    assert cli(capsys, *words, "--assign", "box")[0] == 0


def test_boxes_of_several_frames_need_a_frame(tmp_path, capsys, points):
    table = write_table(tmp_path / "boxes.csv", traffic_rows())
    assert "name one with --frame" in refused(capsys, tmp_path, "score", "--points", points, "--boxes", table)
    line = refused(capsys, tmp_path, "score", "--points", points, "--boxes", table, "--frame", 99)
    assert "no frame 99" in line


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["--cell", "0"], "--cell: is 0.0; allowed: at least 0.001"),
        (["--cell", "nan"], "--cell: is nan; allowed: a number"),
        (["--threshold", "-1"], "--threshold: is -1.0; allowed: at least 0"),
        (["--ground-clearance", "-0.1"], "--ground-clearance: is -0.1; allowed: at least 0"),
        (["--ground-clearance", "low"], "--ground-clearance: is 'low'; allowed: a number"),
        (["--assign", "near"], "argument --assign: invalid choice: 'near'"),
        (["--view", "back"], "argument --view: invalid choice: 'back'"),
    ],
    ids=lambda value: " ".join(value)[:24],
)
def test_options_of_score_that_cannot_be_used(tmp_path, capsys, boxes, points, words, expected):
    assert expected in refused(capsys, tmp_path, "score", "--points", points, "--boxes", boxes, *words)


@pytest.mark.parametrize("out", ["file/scores.csv", "none/scores.csv", "folder", "/proc/none.csv"])
def test_scores_that_cannot_be_written(tmp_path, capsys, boxes, points, out):
    (tmp_path / "file").write_text("here")
    (tmp_path / "folder").mkdir()
    line = refused(capsys, tmp_path, "score", "--points", points, "--boxes", boxes, "--out", out)
    assert f"{out}: cannot be written: " in line
