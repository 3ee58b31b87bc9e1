"""KITTI's sweeps: boxes are read as the data set means them, and rings of known beams are found again."""

from __future__ import annotations

import csv
import math
from functools import cache

import numpy as np
import pytest

import tests.research  # noqa: F401
from blender_lidar.errors import InputError
from blender_lidar.metrics.assignment import points_in_boxes
from blender_lidar.sensors.beams import beam_lattice
from blender_lidar.sensors.model import load_model
from kitti_sweeps import kitti_frame, kitti_names, recover_rings
from tests.recorded_samples import CALIBRATION, KITTI, SENSOR, in_kitti_frame, needs_kitti, scanned, street

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
    return kitti_frame(folder, "000007")[0].boxes


def test_a_kitti_label_becomes_a_box_in_the_lidars_frame(kitti):
    assert kitti_names(kitti) == ["000007"]
    frame, cut_off = kitti_frame(kitti, "000007")
    boxes = frame.boxes
    assert (boxes.vehicle_id.tolist(), boxes.label.tolist(), cut_off.tolist()) == ([1], ["Car"], [True])
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


@needs_kitti
def test_the_excerpts_own_boxes_are_found_again_in_the_lidars_frame():
    """`cars.csv` beside the excerpt has every car in the LiDAR's frame, computed elsewhere."""
    with (KITTI / "cars.csv").open(encoding="utf-8", newline="") as stream:
        known = {(row["frame"], int(row["label_line"])): row for row in csv.DictReader(stream)}
    seen = 0
    for frame in kitti_names(KITTI):
        boxes = kitti_frame(KITTI, frame)[0].boxes
        for row in np.flatnonzero(boxes.label == "Car"):
            car = known[frame, int(boxes.vehicle_id[row])]
            centre = [float(car[key]) for key in ("x_m", "y_m", "z_m")]
            np.testing.assert_allclose(boxes.centre_m[row], centre, atol=0.03)
            turn = math.remainder(boxes.heading_rad[row] - float(car["yaw_rad"]), 2 * math.pi)
            assert abs(turn) < math.radians(1.5)
            size = [float(car[key]) for key in ("length_m", "width_m", "height_m")]
            np.testing.assert_allclose(boxes.size_m[row], size, atol=1e-4)
            seen += 1
    assert seen == len(known)


# --- Rings ------------------------------------------------------------------------------------------------------------


@cache
def sweep():
    """A turn over a street: its cloud and its points as KITTI keeps them."""
    cloud = scanned(street())
    return cloud, in_kitti_frame(cloud.xyz)


@pytest.mark.parametrize("top_first", [False, True])
def test_rings_elevations_and_the_azimuth_step_are_those_of_the_sensor(top_first):
    cloud, points = sweep()
    order = np.lexsort((np.arange(len(cloud)), -cloud.ring.astype(int))) if top_first else np.arange(len(cloud))
    rings = recover_rings(points[order])
    ring = cloud.ring[order].astype(int)
    seen = np.unique(ring)  # the top rings look above everything
    np.testing.assert_array_equal(seen[rings.ring], ring)
    model = load_model(SENSOR)
    np.testing.assert_allclose(rings.elevation_rad, model.elevation_rad[seen], atol=1e-6)
    np.testing.assert_allclose(rings.height_m, 0.0, atol=1e-5)
    np.testing.assert_array_equal(rings.lateral_m, 0.0)
    assert rings.step_rad == pytest.approx(beam_lattice(model).step_rad, rel=1e-4)
    assert rings.spread_m < 1e-6


@pytest.mark.parametrize("way", [1.0, -1.0])
@pytest.mark.parametrize("seam", [0.0, math.pi])
def test_a_turn_may_go_either_way_and_start_ahead_or_behind(way, seam):
    cloud, points = sweep()
    azimuth = np.mod(way * (np.arctan2(points[:, 1], points[:, 0]) - seam), 2.0 * math.pi)
    order = np.lexsort((azimuth, cloud.ring))
    rings = recover_rings(points[order])
    np.testing.assert_array_equal(np.unique(cloud.ring)[rings.ring], cloud.ring[order])


def offset_sweep(lateral_m=0.026, height_m=0.2):
    """Rings whose lasers sit above the origin and, in turn, on either side of the axis, and see walls at all ranges."""
    rng = np.random.default_rng(2)
    elevation = np.radians(np.linspace(-12.0, 1.0, 16))
    azimuth = np.radians(np.arange(0.0, 359.9, 0.18))
    parts = []
    for number, tilt in enumerate(elevation):
        rho = np.repeat(rng.uniform(5.0, 50.0, len(azimuth) // 20 + 1), 20)[: len(azimuth)]
        side = lateral_m * (1 if number % 2 else -1)
        cos, sin = np.cos(azimuth), np.sin(azimuth)
        xyz = np.column_stack([rho * cos - side * sin, rho * sin + side * cos, height_m + rho * np.tan(tilt)])
        seen = np.mod(np.arctan2(xyz[:, 1], xyz[:, 0]), 2.0 * math.pi)
        kept = rng.random(len(azimuth)) > 0.1
        parts.append(xyz[kept][np.argsort(seen[kept])])
    return elevation, np.concatenate(parts)


def test_lasers_beside_the_origin_are_found_as_in_the_hdl_64e():
    elevation, points = offset_sweep()
    rings = recover_rings(points)
    np.testing.assert_allclose(rings.elevation_rad, elevation, atol=1e-4)
    np.testing.assert_allclose(rings.height_m, 0.2, atol=1e-3)
    np.testing.assert_allclose(np.abs(rings.lateral_m), 0.026, atol=0.003)
    assert (np.sign(rings.lateral_m) == np.tile([-1, 1], 8)).all()


@pytest.mark.parametrize(
    "change",
    [
        lambda cloud, points: points[np.random.default_rng(1).permutation(len(points))],
        lambda cloud, points: points[np.lexsort((cloud.ring, cloud.azimuth_rad))],  # column by column
        lambda cloud, points: points[:20],
        lambda cloud, points: points[:0],
        lambda cloud, points: points + np.random.default_rng(1).normal(0.0, 0.5, points.shape),
    ],
    ids=["shuffled", "column by column", "twenty points", "no points", "noise"],
)
def test_points_out_of_ring_order_are_refused(change):
    with pytest.raises(InputError, match=r"points are not in ring order"):
        recover_rings(change(*sweep()))
