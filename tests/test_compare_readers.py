"""Labelled sweeps and tables of detections are read as their data sets mean them; what is wrong is told in one line."""

from __future__ import annotations

import csv
import json
import math
import re

import numpy as np
import pytest

from blender_lidar.errors import BlenderLidarError, InputError, MissingFileError
from blender_lidar.metrics.assignment import points_in_boxes
from blender_lidar.studies.compare.detections import read_detections, read_frames, tuned_frames
from blender_lidar.studies.compare.labelled import open_labelled
from tests.labelled_samples import KITTI, needs_kitti

# The LiDAR's x, y, z become the camera's z, -x, -y.
AXES = "0 -1 0 0 0 0 -1 0 1 0 0 0"
CALIBRATION = f"P2: 1 2 3\nR0_rect: 1 0 0 0 1 0 0 0 1\nTr_velo_to_cam: {AXES}\n"
CAR = "Car 0.25 1 -1.5 0 0 10 10 1.5 1.8 4.4 -2.0 1.7 12.0 -1.5707963267948966"
DONT_CARE = "DontCare -1 -1 -10 0 0 10 10 -1 -1 -1 -1000 -1000 -1000 -10"


@pytest.fixture
def kitti(tmp_path):
    """One sweep of three points, one of them in the only car, beside one without a cloud."""
    for part in ("velodyne", "label_2", "calib"):
        (tmp_path / part).mkdir()
    points = np.array([[12, 2, -1, 0.5], [30, 0, 0, 0.1], [np.nan, 0, 0, 0]], dtype="<f4")
    (tmp_path / "velodyne" / "000007.bin").write_bytes(points.tobytes())
    (tmp_path / "label_2" / "000007.txt").write_text(f"{DONT_CARE}\n{CAR}\n", encoding="utf-8")
    (tmp_path / "label_2" / "000008.txt").write_text(f"{CAR}\n", encoding="utf-8")
    (tmp_path / "calib" / "000007.txt").write_text(CALIBRATION, encoding="utf-8")
    return tmp_path


def test_a_kitti_label_becomes_a_box_in_the_lidars_frame(kitti):
    clouds = open_labelled(kitti)
    assert (clouds.layout, clouds.frames, clouds.unpaired) == ("KITTI", ("000007",), 1)
    sweep = clouds.read("000007")
    boxes = sweep.boxes
    assert (boxes.label_line.tolist(), boxes.label.tolist()) == ([1], ["Car"])
    np.testing.assert_allclose(boxes.size_m, [[4.4, 1.8, 1.5]])
    np.testing.assert_allclose(boxes.centre_m, [[12.0, 2.0, -1.7 + 0.75]])
    np.testing.assert_allclose(boxes.heading_rad, [0.0], atol=1e-12)  # along the LiDAR's x
    assert (boxes.occlusion[0], boxes.truncation[0]) == (1, 0.25)
    np.testing.assert_allclose(boxes.distance_m, [math.hypot(12, 2)])
    assert len(sweep.points) == 2  # what is not finite is no point
    assert points_in_boxes(sweep.points, boxes.centre_m, boxes.size_m, boxes.heading_rad).tolist() == [0, -1]


def test_a_turn_to_the_right_in_the_picture_is_clockwise_from_above(kitti):
    turned = CAR.rsplit(" ", 1)[0] + " 0.0"  # along the camera's x, to its right
    (kitti / "label_2" / "000007.txt").write_text(turned, encoding="utf-8")
    np.testing.assert_allclose(open_labelled(kitti).read("000007").boxes.heading_rad, [-0.5 * math.pi])


def test_a_label_file_without_boxes_gives_none(kitti):
    (kitti / "label_2" / "000007.txt").write_text(DONT_CARE, encoding="utf-8")
    boxes = open_labelled(kitti).read("000007").boxes
    assert (len(boxes), boxes.centre_m.shape) == (0, (0, 3))


@pytest.mark.parametrize(
    ("part", "content", "told"),
    [
        ("label_2/000007.txt", "Car 1 2 3", "000007.txt:1: 4 fields; allowed: 15"),
        ("label_2/000007.txt", CAR.replace("12.0", "far"), "000007.txt:1: could not convert"),
        ("label_2/000007.txt", CAR.replace("12.0", "nan"), "000007.txt:1: a number is not finite"),
        ("label_2/000007.txt", CAR.replace("4.4", "0"), "a side of the box is 0 m"),
        ("label_2/000007.txt", CAR.replace("0.25 1 ", "0.25 9 "), "occlusion is 9"),
        ("calib/000007.txt", "R0_rect: 1 2\n", "R0_rect has 2 numbers; allowed: 9"),
        ("calib/000007.txt", CALIBRATION.replace(AXES, "2" + AXES[1:]), "is no rotation"),
        ("calib/000007.txt", CALIBRATION.replace(AXES, "x" + AXES[1:]), "Tr_velo_to_cam: could not convert"),
        ("velodyne/000007.bin", "seventeen bytes..", "17 bytes; allowed: 16 for each point"),
    ],
)
def test_a_damaged_file_is_named_in_one_line(kitti, part, content, told):
    (kitti / part).write_text(content, encoding="utf-8")
    with pytest.raises(InputError) as caught:
        open_labelled(kitti).read("000007")
    line = str(caught.value)
    assert (told in line, str(kitti) in line, line.count("\n")) == (True, True, 0)


def test_a_folder_of_another_layout_or_without_sweeps_is_refused(kitti, tmp_path_factory):
    other = tmp_path_factory.mktemp("other")
    with pytest.raises(InputError, match="layout of no known data set; allowed: KITTI: velodyne/"):
        open_labelled(other)
    with pytest.raises(MissingFileError, match=r"--kitti: .*nowhere: there is no such folder"):
        open_labelled(other / "nowhere")
    (kitti / "calib" / "000007.txt").unlink()
    with pytest.raises(InputError, match="no sweep with all its files"):
        open_labelled(kitti)


def scene_of_sustechpoints(folder, objects):
    for part in ("lidar", "label"):
        (folder / part).mkdir()
    (folder / "label" / "1.json").write_text(json.dumps(objects), encoding="utf-8")
    header = "VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 1\nHEIGHT 1\nPOINTS 1\nDATA ascii\n"
    (folder / "lidar" / "1.pcd").write_text(header + "1 2 3\n", encoding="utf-8")
    return open_labelled(folder)


PSR = {
    "position": {"x": 1, "y": 2, "z": 3},
    "scale": {"x": 4, "y": 2, "z": 1.5},
    "rotation": {"x": 0, "y": 0, "z": 0.5},
}


@pytest.mark.parametrize("wrapped", [False, True])
def test_sustechpoints_labels_are_read(tmp_path, wrapped):
    objects = [{"obj_id": "1", "obj_type": "Car", "psr": PSR}]
    clouds = scene_of_sustechpoints(tmp_path, {"objs": objects} if wrapped else objects)
    sweep = clouds.read("1")
    assert (clouds.layout, sweep.boxes.label.tolist()) == ("SUSTechPOINTS", ["Car"])
    assert sweep.boxes.centre_m.tolist() == [[1, 2, 3]]
    assert (sweep.boxes.size_m.tolist(), sweep.boxes.heading_rad.tolist()) == ([[4, 2, 1.5]], [0.5])
    assert (sweep.points.tolist(), sweep.boxes.occlusion.tolist()) == ([[1, 2, 3]], [-1])


@pytest.mark.parametrize(
    "objects",
    ["text", [1], [{"obj_type": "Car"}], [{"obj_type": "Car", "psr": PSR | {"scale": {"x": 1, "y": 0, "z": 1}}}]],
)
def test_what_is_no_list_of_boxes_is_refused_in_one_line(tmp_path, objects):
    with pytest.raises(BlenderLidarError) as caught:
        scene_of_sustechpoints(tmp_path, objects).read("1")
    assert "1.json" in str(caught.value)


def test_what_scan_writes_for_sustechpoints_reads_back_as_the_same_boxes(tmp_path):
    from blender_lidar.cli import main
    from tests.small_scene import write_scene

    scene = write_scene(tmp_path, {"model": {"caster": "exact"}})
    out = tmp_path / "annotated"
    words = ["scan", scene, "--frame-ids", "20,40", "--format", "sustechpoints", "--out", out, "--yaw", 30]
    assert main([str(word) for word in words]) == 0
    clouds = open_labelled(out)
    sweep = clouds.read(clouds.frames[0])
    boxes = sweep.boxes
    assert len(boxes) > 0
    inside = points_in_boxes(sweep.points, boxes.centre_m, boxes.size_m, boxes.heading_rad)
    assert set(range(len(boxes))) <= set(inside.tolist())  # every labelled vehicle returned a point


@needs_kitti
def test_the_excerpts_own_boxes_are_found_again_in_the_lidars_frame():
    """`cars.csv` beside the excerpt has every car in the LiDAR's frame, computed elsewhere."""
    with (KITTI / "cars.csv").open(encoding="utf-8", newline="") as stream:
        known = {(row["frame"], int(row["label_line"])): row for row in csv.DictReader(stream)}
    clouds, seen = open_labelled(KITTI), 0
    for frame in clouds.frames:
        boxes = clouds.read(frame).boxes
        for row in np.flatnonzero(boxes.label == "Car"):
            car = known[frame, int(boxes.label_line[row])]
            centre = [float(car[key]) for key in ("x_m", "y_m", "z_m")]
            np.testing.assert_allclose(boxes.centre_m[row], centre, atol=0.03)
            turn = math.remainder(boxes.heading_rad[row] - float(car["yaw_rad"]), 2 * math.pi)
            assert abs(turn) < math.radians(1.5)
            size = [float(car[key]) for key in ("length_m", "width_m", "height_m")]
            np.testing.assert_allclose(boxes.size_m[row], size, atol=1e-4)
            assert boxes.occlusion[row] == int(car["occlusion"])
            seen += 1
    assert seen == len(known)


# --- Tables beside the sweeps -----------------------------------------------------------------------------------------

HEADER = "frame,label_line,a_confidence,a_iou3d,b_confidence,b_iou3d,b_iou_bev,b_in_range,size_m"
ROWS = ["1,0,0.5,0.8,0.9,0.7,0.75,1,4.2", "1,2,0,0,0,0,0,0,4.2", "2,0,1,1,0.3,0.2,0.3,1,4.2"]


def written(folder, *lines, name="cars.csv"):
    path = folder / name
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def test_every_detector_that_has_a_confidence_is_read(tmp_path):
    found = read_detections(written(tmp_path, HEADER, *ROWS))
    assert found.detectors == ("a", "b")
    own = {f"{of}_{what}" for of in "ab" for what in ("in_range", "performance")}
    assert set(found.table) == {"line", "frame", "label_line"} | own
    told = {name: column.tolist() for name, column in found.table.items()}
    assert (told["line"], told["frame"], told["label_line"]) == ([2, 3, 4], ["1", "1", "2"], [0, 2, 0])
    assert told["a_performance"] == pytest.approx([0.4, 0.0, 1.0])
    assert told["a_in_range"] == [True, True, True]  # not told: all are
    assert told["b_in_range"] == [True, False, True]


def test_what_is_told_of_frames_comes_from_beside_or_from_where_it_is_named(tmp_path):
    cars = written(tmp_path, "frame,label_line,split,a_confidence,a_iou3d", "1,0,val,1,1", "2,0,val,1,1")
    assert read_detections(cars).table["split"].tolist() == ["val", "val"]
    written(tmp_path, "frame,split,drive", "2,train,x", "1,val,y", "3,val,y", name="frames.csv")
    about = read_detections(cars).table
    assert (about["split"].tolist(), about["drive"].tolist()) == (["val", "train"], ["y", "x"])
    other = written(tmp_path, "frame,label_kind", "1,object", "2,tracking", name="other.csv")
    about = read_detections(cars, other).table
    assert about["label_kind"].tolist() == ["object", "tracking"]
    assert "drive" not in about


@pytest.mark.parametrize(
    ("lines", "told"),
    [
        ([HEADER, *ROWS, ROWS[1]], "cars.csv:5: frame 1, label_line 2 is in line 3 already"),
        (
            [HEADER.replace("label_line", "label_lin"), *ROWS],
            "no column label_line; needed: frame, label_line, a_confidence",
        ),
        (
            [HEADER.replace("a_iou3d", "a_iou_3d"), *ROWS],
            "no column a_iou3d; needed: frame, label_line, a_confidence, a_iou3d",
        ),
        (
            [HEADER.replace("_confidence", "_score"), *ROWS],
            "needed: frame, label_line, NAME_confidence, NAME_iou3d; it has frame, ",
        ),
        ([HEADER.replace("size_m", "a_iou3d"), *ROWS], "cars.csv: column a_iou3d is there twice"),
        ([HEADER, ROWS[0].replace("0.5", "1.5")], "cars.csv:2: a_confidence is 1.5; allowed: 0 to 1"),
        ([HEADER, ROWS[0].replace("0.8", "nan")], "cars.csv:2: a_iou3d is 'nan'; allowed: 0 to 1"),
        ([HEADER, ROWS[0].replace(",1,4.2", ",0.5,4.2")], "cars.csv:2: b_in_range is 0.5; allowed: 0 or 1"),
        ([HEADER, ROWS[0].replace("1,0,", "1,0.5,", 1)], "cars.csv:2: label_line is 0.5; allowed: a whole number"),
        ([HEADER, ROWS[0].replace("1,0,", "1,-1,", 1)], "cars.csv:2: label_line is -1; allowed: a whole number"),
        ([HEADER, ROWS[0].replace("1,0,", " ,0,", 1)], "cars.csv:2: frame is empty"),
        ([HEADER, "", ROWS[0] + ",7"], "cars.csv:3: 10 fields; the first line has 9"),
        ([HEADER], "has no row below its header"),
        ([""], "cars.csv: no rows; "),
    ],
)
def test_a_row_or_column_that_cannot_be_used_is_named_in_one_line(tmp_path, lines, told):
    with pytest.raises(InputError, match=re.escape(told)) as caught:
        read_detections(written(tmp_path, *lines))
    assert "\n" not in str(caught.value)
    assert "cars.csv" in str(caught.value)


@pytest.mark.parametrize(
    ("lines", "told"),
    [
        (["frame,split", "1,val", "1,val"], "frames.csv:3: frame 1 is in line 2 already"),
        (["frame,split", "1,val"], "cars.csv:4: frame 2 has no row in"),
        (["split", "val"], "frames.csv: no column frame; needed: frame; it has split"),
        (["frame,split", "1,", "2,val"], "frames.csv:2: split is empty"),
    ],
)
def test_a_table_of_frames_that_cannot_be_used_is_named_too(tmp_path, lines, told):
    written(tmp_path, *lines, name="frames.csv")
    with pytest.raises(InputError, match=re.escape(told)):
        read_detections(written(tmp_path, HEADER, *ROWS))


def test_files_that_are_not_there_or_no_tables_are_refused(tmp_path):
    with pytest.raises(MissingFileError, match="no such file"):
        read_detections(tmp_path / "none.csv")
    with pytest.raises(InputError, match="is a folder; allowed: a file"):
        read_detections(tmp_path)
    binary = tmp_path / "binary.csv"
    binary.write_bytes(bytes(range(256)) * 4)
    with pytest.raises(BlenderLidarError) as caught:
        read_detections(binary)
    assert "\n" not in str(caught.value)
    cars = written(tmp_path, HEADER, *ROWS)
    with pytest.raises(MissingFileError, match=r"nowhere.csv: there is no such file"):
        read_detections(cars, tmp_path / "nowhere.csv")


def test_long_names_of_frames_and_detectors_stay_whole(tmp_path):
    frame, detector = "sweep_" * 12, "a_detector_of_three_ensembles_and_more"
    cars = written(tmp_path, f"frame,label_line,{detector}_confidence,{detector}_iou3d", f"{frame},0,1,1")
    found = read_detections(cars)
    assert found.table["frame"].tolist() == [frame]
    assert found.detectors == (detector,)


def test_which_frames_were_fitted_to_is_read_from_the_list_whatever_others_are_there(tmp_path):
    assert tuned_frames({}) is None
    rows = [("1", "train", "object"), ("2", "val", "object"), ("3", "val", "tracking"), ("000006", "val", "object")]
    text = "frame,split,label_kind\n" + "\n".join(map(",".join, rows)) + "\n"
    for written in (text, "\ufeff" + text, text + "4,val,object\n"):
        (tmp_path / "frames.csv").write_text(written, encoding="utf-8")
        assert tuned_frames(read_frames(tmp_path / "frames.csv")) == ["1", "000006"]
    (tmp_path / "frames.csv").write_text(text.replace("split", "part"), encoding="utf-8")
    assert tuned_frames(read_frames(tmp_path / "frames.csv")) is None


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("frame,split,label_kind\n1,val,object\n2,val\n", "frames.csv:3: 2 fields; the first line has 3"),
        ("frame,split,label_kind\n1,,object\n", "frames.csv:2: split is empty"),
        ("name,split,label_kind\n1,val,object\n", "frames.csv: no column frame; needed: frame; it has name"),
        ("frame,split\n", "frames.csv: has no row below its header"),
    ],
)
def test_a_list_of_frames_that_cannot_be_used_is_named(tmp_path, text, told):
    (tmp_path / "frames.csv").write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=re.escape(told)):
        read_frames(tmp_path / "frames.csv")
