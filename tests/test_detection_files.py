"""Detections as files: what is written is read again; what is wrong is refused in one line."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from blender_lidar.clouds.files import levelled
from blender_lidar.detection.files import kitti_camera, read_detected, write_detected, write_kitti_labels
from blender_lidar.errors import InputError, MissingFileError
from blender_lidar.sensors.pose import Pose
from blender_lidar.traffic.boxes import KINDS, corners_of, detected_boxes

POSE = Pose(3.0, -2.0, 4.5, math.radians(20.0), 0.0, math.radians(35.0))


def random_boxes(count, seed):
    rng = np.random.default_rng(seed)
    return detected_boxes(
        rng.uniform(-50, 50, (count, 3)),
        rng.uniform(0.5, 12, (count, 3)),
        rng.uniform(-math.pi, math.pi, count),
        rng.integers(len(KINDS), size=count).astype(np.int8),
        rng.random(count),
    )


def assert_alike(boxes, others, digits):
    for name in ("centre_m", "size_m", "kind", "confidence"):
        np.testing.assert_allclose(getattr(boxes, name), getattr(others, name), atol=10.0**-digits)
    np.testing.assert_allclose(corners_of(boxes), corners_of(others), atol=10 * 10.0**-digits)


@pytest.mark.parametrize("written", ["csv", "kitti"])
def test_what_is_written_is_read_again(written, tmp_path):
    found = {100: random_boxes(20, 1), 7: random_boxes(3, 2), 8: random_boxes(0, 3)}
    if written == "csv":
        write_detected(tmp_path / "boxes.csv", found)
        read = read_detected(tmp_path / "boxes.csv", POSE)
        assert set(read) == {7, 100}
    else:
        write_kitti_labels(tmp_path / "label_2", found, POSE)
        read = read_detected(tmp_path / "label_2", POSE)
        assert set(read) == {7, 8, 100}
    for number in (100, 7):
        assert_alike(read[number], found[number], 2)


def test_each_number_may_have_a_mounting_of_its_own(tmp_path):
    poses = [replace(POSE, x_m=10.0 * number, yaw=math.radians(50.0 * number)) for number in range(3)]
    found = {number: random_boxes(5, number) for number in (0, 2)}
    write_kitti_labels(tmp_path / "label_2", found, poses)
    read = read_detected(tmp_path / "label_2", poses)
    for number in (0, 2):
        assert_alike(read[number], found[number], 2)
    for name, write in (("boxes.csv", write_detected), ("label_2", write_kitti_labels)):
        write(tmp_path / name, {3: found[2]}, *([POSE] if name == "label_2" else []))
        with pytest.raises(InputError, match=f"{name}: has detections of number 3; allowed: scans 0 to 2"):
            read_detected(tmp_path / name, poses)


def test_the_camera_of_kitti_looks_along_the_x_axis_of_the_levelled_cloud():
    """As KITTI's calibration says of a camera in the LiDAR: x_cam = -y, y_cam = -z, z_cam = x."""
    boxes = random_boxes(10, 4)
    bottom, rotation_y = kitti_camera(boxes, POSE)
    floor = boxes.centre_m - np.array([0.0, 0.0, 0.5]) * boxes.size_m
    x, y, z = levelled(floor, POSE).T
    np.testing.assert_allclose(bottom, np.column_stack([-y, -z, x]), atol=1e-12)
    ahead = boxes.centre_m + np.column_stack([np.cos(boxes.heading_rad), np.sin(boxes.heading_rad), np.zeros(10)])
    forward = levelled(ahead, POSE) - levelled(boxes.centre_m, POSE)
    np.testing.assert_allclose(np.cos(rotation_y), -forward[:, 1], atol=1e-12)  # KITTI: (cos, 0, -sin) in the camera
    np.testing.assert_allclose(-np.sin(rotation_y), forward[:, 0], atol=1e-12)


HEADER = "frame,class,x_m,y_m,z_m,length_m,width_m,height_m,heading_deg,confidence\n"
KITTI = "Car -1 -1 -10 -1 -1 -1 -1 1.5 1.8 4.5 1 2 20 0.1 0.9\n"
BAD = {
    "a.csv": [
        (HEADER, "has no detection of a vehicle"),
        (HEADER.replace(",confidence", ""), "no column confidence"),
        (HEADER + "1,car,0,0,0,4,2,1,0,1.5\n", "a.csv:2: confidence is 1.5; allowed: 0 to 1"),
        (HEADER + "1,car,0,0,0,0,2,1,0,0.5\n", "a.csv:2: length_m is 0; allowed: more than 0"),
        (HEADER + "1,lorry,0,0,0,4,2,1,0,0.5\n", "a.csv:2: unknown class 'lorry'"),
        (HEADER + "1,car,nan,0,0,4,2,1,0,0.5\n", "a.csv:2: x_m is 'nan'"),
    ],
    "000100.txt": [
        (KITTI.rpartition(" ")[0], "000100.txt:1: 15 fields; allowed: 16, the last is the score"),
        (KITTI.replace("20", "twenty"), "000100.txt:1: 'twenty' is no number"),
        (KITTI.replace("4.5", "-4.5"), "000100.txt:1: length is -4.5; allowed: more than 0"),
        (KITTI.replace("0.9", "2"), "000100.txt:1: confidence is 2; allowed: 0 to 1"),
        (KITTI.replace("Car", "Lorry"), "000100.txt:1: unknown class 'lorry'"),
    ],
}


def test_what_is_no_vehicle_is_left_out(tmp_path):
    (tmp_path / "000100.txt").write_text(KITTI.replace("Car", "Pedestrian"))
    assert len(read_detected(tmp_path, POSE)[100]) == 0


@pytest.mark.parametrize(("name", "content", "message"), [(name, *one) for name, some in BAD.items() for one in some])
def test_what_is_wrong_is_refused_in_a_line(name, content, message, tmp_path):
    (tmp_path / name).write_text(content)
    with pytest.raises(InputError) as caught:
        read_detected(tmp_path if name.endswith(".txt") else tmp_path / name, POSE)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_file_that_is_not_there_and_an_empty_folder_are_told(tmp_path):
    for path in (tmp_path, tmp_path / "a.csv"):
        with pytest.raises(MissingFileError):
            read_detected(path, POSE)
