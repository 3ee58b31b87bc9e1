"""Labelled sweeps are read as their data sets mean them, in either layout."""

from __future__ import annotations

import csv
import json
import math
from pathlib import Path

import numpy as np
import pytest

from blender_lidar.errors import BlenderLidarError, InputError, MissingFileError
from blender_lidar.metrics.assignment import points_in_boxes
from blender_lidar.reality.kitti_layout import read_calibration, read_labels
from blender_lidar.reality.layouts import open_labelled

KITTI = Path(__file__).parents[1].parent / "shared" / "data" / "kitti"
needs_kitti = pytest.mark.skipif(not KITTI.is_dir(), reason=f"no KITTI excerpt at {KITTI}")

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
    assert boxes.label_line.tolist() == [1]
    assert boxes.label.tolist() == ["Car"]
    np.testing.assert_allclose(boxes.size_m, [[4.4, 1.8, 1.5]])
    np.testing.assert_allclose(boxes.centre_m, [[12.0, 2.0, -1.7 + 0.75]])
    np.testing.assert_allclose(boxes.heading_rad, [0.0], atol=1e-12)  # along the LiDAR's x
    assert (boxes.occlusion[0], boxes.truncation[0]) == (1, 0.25)
    np.testing.assert_allclose(boxes.distance_m, [math.hypot(12, 2)])
    assert len(sweep.points) == 2  # what is not finite is no point
    assert points_in_boxes(sweep.points, boxes.centre_m, boxes.size_m, boxes.heading_rad).tolist() == [0, -1]


def test_a_turn_to_the_right_in_the_picture_is_clockwise_from_above(kitti):
    turned = CAR.rsplit(" ", 1)[0] + " 0.0"  # along the camera's x, to its right
    path = kitti / "label_2" / "000007.txt"
    path.write_text(turned, encoding="utf-8")
    heading = read_labels(path, read_calibration(kitti / "calib" / "000007.txt")).heading_rad
    np.testing.assert_allclose(heading, [-0.5 * math.pi])


def test_a_label_file_without_boxes_gives_none(kitti):
    (kitti / "label_2" / "000007.txt").write_text(DONT_CARE, encoding="utf-8")
    boxes = open_labelled(kitti).read("000007").boxes
    assert len(boxes) == 0
    assert boxes.centre_m.shape == (0, 3)


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
    assert told in str(caught.value)
    assert str(kitti) in str(caught.value)
    assert "\n" not in str(caught.value)


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
    assert sweep.boxes.size_m.tolist() == [[4, 2, 1.5]]
    assert sweep.boxes.heading_rad.tolist() == [0.5]
    assert sweep.points.tolist() == [[1, 2, 3]]
    assert sweep.boxes.occlusion.tolist() == [-1]


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
