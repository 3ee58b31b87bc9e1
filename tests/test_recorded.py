"""Recorded clouds and their labelled boxes are read as their data sets mean them; bad input ends in one line."""

from __future__ import annotations

import csv
import math
import re

import numpy as np
import pytest

from blender_lidar.errors import InputError, MissingFileError
from blender_lidar.metrics.assignment import points_in_boxes
from blender_lidar.studies.recorded import kitti_frame, kitti_names, tabled_frames
from tests.recorded_samples import CALIBRATION, KITTI, needs_kitti

AXES = "0 -1 0 0 0 0 -1 0 1 0 0 0"  # the LiDAR's x, y, z become the camera's z, -x, -y
CAR = "Car 0.25 1 -1.5 0 0 10 10 1.5 1.8 4.4 -2.0 1.7 12.0 -1.5707963267948966"
DONT_CARE = "DontCare -1 -1 -10 0 0 10 10 -1 -1 -1 -1000 -1000 -1000 -10"


@pytest.fixture
def kitti(tmp_path):
    """One frame of three points, one of them in the only car, beside one without a cloud."""
    for part in ("velodyne", "label_2", "calib"):
        (tmp_path / part).mkdir()
    points = np.array([[12, 2, -1, 0.5], [30, 0, 0, 0.1], [np.nan, 0, 0, 0]], dtype="<f4")
    (tmp_path / "velodyne" / "000007.bin").write_bytes(points.tobytes())
    (tmp_path / "label_2" / "000007.txt").write_text(f"{DONT_CARE}\n{CAR}\n", encoding="utf-8")
    (tmp_path / "label_2" / "000008.txt").write_text(f"{CAR}\n", encoding="utf-8")
    (tmp_path / "calib" / "000007.txt").write_text(CALIBRATION, encoding="utf-8")
    return tmp_path


def relabelled(folder, *lines):
    (folder / "label_2" / "000007.txt").write_text("\n".join(lines), encoding="utf-8")
    return kitti_frame(folder, "000007").boxes


def test_a_kitti_label_becomes_a_box_in_the_lidars_frame(kitti):
    assert kitti_names(kitti) == ["000007"]
    frame = kitti_frame(kitti, "000007")
    boxes = frame.boxes
    assert (boxes.number.tolist(), boxes.label.tolist(), boxes.cut_off.tolist()) == ([1], ["Car"], [True])
    np.testing.assert_allclose(boxes.size_m, [[4.4, 1.8, 1.5]])
    np.testing.assert_allclose(boxes.centre_m, [[12.0, 2.0, -1.7 + 0.75]])
    np.testing.assert_allclose(boxes.heading_rad, [0.0], atol=1e-12)  # along the LiDAR's x
    assert len(frame.points) == 2  # what is not finite is no point
    assert points_in_boxes(frame.points, boxes.centre_m, boxes.size_m, boxes.heading_rad).tolist() == [0, -1]


def test_a_turn_to_the_right_in_the_picture_is_clockwise_from_above(kitti):
    turned = CAR.rsplit(" ", 1)[0] + " 0.0"  # along the camera's x, to its right
    np.testing.assert_allclose(relabelled(kitti, turned).heading_rad, [-0.5 * math.pi])


def test_a_label_file_without_boxes_gives_none(kitti):
    boxes = relabelled(kitti, DONT_CARE)
    assert (len(boxes), boxes.centre_m.shape) == (0, (0, 3))


def test_labels_become_the_shapes_that_traffic_has_and_people_are_narrower_than_their_boxes(kitti):
    labels = {"Car": (4.4, "car"), "Pedestrian": (1.0, ""), "Van": (5.0, "van"), "Truck": (8.0, "truck")}
    labels |= {"Tram": (12.0, "bus"), "Cyclist": (1.8, "motorcycle"), "Misc": (3.0, "")}
    lines = [CAR.replace("Car", name).replace("4.4", str(length)) for name, (length, _) in labels.items()]
    boxes = relabelled(kitti, *lines, CAR.replace("4.4", "5.1"), CAR.replace("Car", "Truck").replace("4.4", "12.0"))
    assert boxes.shape.tolist() == [*(shape for _, shape in labels.values()), "van", "long_truck"]
    assert boxes.size_m[1].tolist() == pytest.approx([0.6, 1.08, 1.5])
    assert boxes.of_class(None).tolist() == [True, False, True, True, True, True, False, True, True]
    assert boxes.of_class(["car", "VAN"]).tolist() == [True, False, True, False, False, False, False, True, False]


@pytest.mark.parametrize(
    ("part", "content", "told"),
    [
        ("label_2/000007.txt", "Car 1 2 3", "000007.txt:1: 4 fields; allowed: 15"),
        ("label_2/000007.txt", CAR.replace("12.0", "far"), "000007.txt:1: could not convert"),
        ("label_2/000007.txt", CAR.replace("12.0", "nan"), "000007.txt:1: a number is not finite"),
        ("label_2/000007.txt", CAR.replace("4.4", "0"), "a side of the box is 0 m"),
        ("calib/000007.txt", "R0_rect: 1 2\n", "R0_rect has 2 numbers; allowed: 9"),
        ("calib/000007.txt", CALIBRATION.replace(AXES, "2" + AXES[1:]), "is no rotation"),
        ("velodyne/000007.bin", "seventeen bytes..", "17 bytes; allowed: 16 for each point"),
    ],
)
def test_a_damaged_file_is_named_in_one_line(kitti, part, content, told):
    (kitti / part).write_text(content, encoding="utf-8")
    with pytest.raises(InputError) as caught:
        kitti_frame(kitti, "000007")
    line = str(caught.value)
    assert (told in line, str(kitti) in line, line.count("\n")) == (True, True, 0)


def test_a_folder_without_whole_frames_is_refused(kitti, tmp_path_factory):
    with pytest.raises(MissingFileError, match=r"--kitti: .*nowhere: there is no such folder"):
        kitti_names(kitti / "nowhere")
    (kitti / "calib" / "000007.txt").unlink()
    for folder in (kitti, tmp_path_factory.mktemp("other")):
        with pytest.raises(InputError, match=r"no frame with all its files; allowed: velodyne/NAME.bin and label_2/"):
            kitti_names(folder)


@needs_kitti
def test_the_excerpts_own_boxes_are_found_again_in_the_lidars_frame():
    """`cars.csv` beside the excerpt has every car in the LiDAR's frame, computed elsewhere."""
    with (KITTI / "cars.csv").open(encoding="utf-8", newline="") as stream:
        known = {(row["frame"], int(row["label_line"])): row for row in csv.DictReader(stream)}
    seen = 0
    for frame in kitti_names(KITTI):
        boxes = kitti_frame(KITTI, frame).boxes
        for row in np.flatnonzero(boxes.label == "Car"):
            car = known[frame, int(boxes.number[row])]
            centre = [float(car[key]) for key in ("x_m", "y_m", "z_m")]
            np.testing.assert_allclose(boxes.centre_m[row], centre, atol=0.03)
            turn = math.remainder(boxes.heading_rad[row] - float(car["yaw_rad"]), 2 * math.pi)
            assert abs(turn) < math.radians(1.5)
            size = [float(car[key]) for key in ("length_m", "width_m", "height_m")]
            np.testing.assert_allclose(boxes.size_m[row], size, atol=1e-4)
            seen += 1
    assert seen == len(known)


# --- Clouds beside a table --------------------------------------------------------------------------------------------


@pytest.fixture
def table(tmp_path):
    """Two frames of one vehicle each, and clouds of one point for both."""
    for name in "ab":
        np.savez(tmp_path / f"{name}.npz", xyz=np.array([[10.0, 2.0, 1.0]]))
    path = tmp_path / "boxes.csv"
    header = "frame,vehicle_id,class,x_m,y_m,length_m,width_m,height_m,heading_deg"
    path.write_text(f"{header}\n1,7,car,10,2,4,2,1.5,90\n2,7,truck,11,2,10,2.5,4,90\n", encoding="utf-8")
    return path


def test_each_cloud_has_the_boxes_of_its_frame(table):
    clouds = [str(table.with_name(f"{name}.npz")) for name in "ab"]
    first, second = tabled_frames(clouds, str(table), (2, 1))
    assert (first.name, first.boxes.shape.tolist(), second.boxes.shape.tolist()) == ("2", ["long_truck"], ["car"])
    assert second.boxes.centre_m.tolist() == [[10.0, 2.0, 0.75]]
    assert second.points.tolist() == [[10.0, 2.0, 1.0]]
    np.testing.assert_allclose(second.boxes.heading_rad, [0.5 * math.pi])


@pytest.mark.parametrize(
    ("clouds", "frames", "told"),
    [
        ("a", None, "holds 2 frames, 1 to 2, for 1 clouds; give --frame with a number for each cloud"),
        ("ab", (1,), "--frame: 1 numbers; allowed: one for each of the 2 clouds"),
        ("a", (3,), "no frame 3; the recording has 2 frames from 1 to 2"),
    ],
)
def test_clouds_that_have_no_frame_are_refused(table, clouds, frames, told):
    paths = [str(table.with_name(f"{name}.npz")) for name in clouds]
    with pytest.raises(InputError, match=re.escape(told)):
        list(tabled_frames(paths, str(table), frames))
