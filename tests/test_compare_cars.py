"""Labelled cars get the points of their boxes and the scores that an independent, slow reading of the paper gives.

Expected visibility: what usually stands in the way of a car counts, what stands there now does not.
"""

from __future__ import annotations

import csv
import math

import numpy as np
import pytest

from blender_lidar.errors import InputError
from blender_lidar.metrics.assignment import SLACK_M
from blender_lidar.metrics.metric import FrameBoxes, Mountings, VehicleReturns, View
from blender_lidar.studies.compare.cars import (
    LEARNED,
    SHARES,
    chosen_metrics,
    comparable,
    expected_visibility,
    of_bearing,
    score_cars,
)
from blender_lidar.studies.compare.labelled import LabelledBoxes, open_labelled
from tests.labelled_samples import KITTI, needs_kitti, sample_cars, write_kitti, write_sustech

CELL_M = 0.05
KNOWING = [one for one in chosen_metrics(None) if one.name not in LEARNED]  # without being taught


def slow_views(points, centre, size, heading):
    """Points in a box one by one, and for each view the set of cells that they lie in over all cells there are."""
    number = [math.ceil(side / CELL_M - 1e-9) for side in size]
    cells = {"top": set(), "side": set(), "front": set()}
    inside = 0
    near = np.linalg.norm(points[:, :2] - centre[:2], axis=1) < 1.0 + math.hypot(*size[:2])
    for x, y, z in points[near] - centre:
        along = math.cos(heading) * x + math.sin(heading) * y
        left = math.cos(heading) * y - math.sin(heading) * x
        place = (along, left, z)
        if any(abs(at) > 0.5 * side + SLACK_M for at, side in zip(place, size, strict=True)):
            continue
        inside += 1
        where = [
            min(max(math.floor((at + 0.5 * side) / CELL_M), 0), most - 1)
            for at, side, most in zip(place, size, number, strict=True)
        ]
        cells["top"].add((where[0], where[1]))
        cells["side"].add((where[0], where[2]))
        cells["front"].add((where[1], where[2]))
    length, width, height = number
    return inside, (
        len(cells["top"]) / (length * width),
        len(cells["side"]) / (length * height),
        len(cells["front"]) / (width * height),
    )


def slow_entropy(shares):
    return -sum(share * math.log2(share) for share in shares if share > 0.0)


def assert_as_slowly(clouds, cars):
    """Every car that no other box overlaps."""
    row = 0
    for frame in dict.fromkeys(cars["frame"].tolist()):
        sweep = clouds.read(frame)
        for box in np.flatnonzero(np.char.lower(sweep.boxes.label) == "car"):
            boxes = sweep.boxes
            inside, shares = slow_views(sweep.points, boxes.centre_m[box], boxes.size_m[box], boxes.heading_rad[box])
            gap = np.linalg.norm(boxes.centre_m - boxes.centre_m[box], axis=1)
            reach = 0.5 * np.linalg.norm(boxes.size_m, axis=1)
            alone = np.count_nonzero(gap < reach + reach[box]) == 1
            assert cars["label_line"][row] == boxes.label_line[box]
            if alone:
                assert cars["points_in_box"][row] == inside
                np.testing.assert_allclose([cars[name][row] for name in SHARES], shares, atol=1e-6)
                assert cars["pe-vgop"][row] == pytest.approx(slow_entropy(shares), abs=1e-6)
            row += 1
    assert row == len(cars["frame"])


@pytest.mark.parametrize("write", [write_kitti, write_sustech])
def test_views_equal_sets_of_cells_in_both_layouts(tmp_path, write):
    clouds = open_labelled(write(tmp_path / "data", sample_cars(3)))
    cars, _ = score_cars(clouds, clouds.frames, ["Car"], KNOWING)
    assert len(cars["frame"]) == 12
    assert cars["points_in_box"].min() > 0
    assert_as_slowly(clouds, cars)


@needs_kitti
def test_views_of_real_cars_equal_sets_of_cells():
    clouds = open_labelled(KITTI)
    cars, _ = score_cars(clouds, clouds.frames, ["Car"], chosen_metrics("pe-vgop"))
    assert len(cars["frame"]) == 212
    assert_as_slowly(clouds, cars)


@needs_kitti
def test_points_in_real_boxes_are_those_that_the_excerpt_counts():
    """It counted on full sweeps with boxes as they came; two boxes overlap, and faces are rounded elsewhere."""
    clouds = open_labelled(KITTI)
    cars, _ = score_cars(clouds, clouds.frames, ["Car"], chosen_metrics("pe-vgop"))
    with (KITTI / "cars.csv").open(encoding="utf-8", newline="") as stream:
        known = {(row["frame"], int(row["label_line"])): int(row["points"]) for row in csv.DictReader(stream)}
    counted = [known[key] for key in zip(cars["frame"].tolist(), cars["label_line"].tolist(), strict=True)]
    np.testing.assert_allclose(cars["points_in_box"], counted, rtol=0.06, atol=3)
    assert np.corrcoef(cars["points_in_box"], counted)[0, 1] > 0.9999


def test_the_layouts_agree_on_the_same_cars(tmp_path):
    found = sample_cars(2)
    folders = write_kitti(tmp_path / "kitti", found), write_sustech(tmp_path / "sustech", found, "CAR")
    kitti, sustech = (score_cars(clouds, clouds.frames, ["car"], KNOWING)[0] for clouds in map(open_labelled, folders))
    np.testing.assert_array_equal(kitti["points_in_box"], sustech["points_in_box"])
    for metric in KNOWING:
        np.testing.assert_allclose(kitti[metric.name], sustech[metric.name], rtol=1e-5, err_msg=metric.name)


def test_a_ground_clearance_takes_only_the_lowest_points(tmp_path):
    clouds = open_labelled(write_kitti(tmp_path / "data", sample_cars(2)))
    kept, stripped = (score_cars(clouds, clouds.frames, ["Car"], KNOWING, m)[0] for m in (0.0, 0.3))
    assert (stripped["points_in_box"] < kept["points_in_box"]).any()
    assert all((stripped[name] <= kept[name] + 1e-12).all() for name in SHARES)
    np.testing.assert_array_equal(stripped["distance_m"], kept["distance_m"])


def test_labels_that_none_of_the_sweeps_has_are_refused_with_those_there_are(tmp_path):
    clouds = open_labelled(write_kitti(tmp_path / "data", sample_cars(1)))
    with pytest.raises(InputError, match=r"--class: Lorry: .* labels none in 1 sweeps; it labels Car"):
        score_cars(clouds, clouds.frames, ["Lorry"], KNOWING)


def test_a_car_straight_ahead_is_end_on_and_one_across_is_side_on():
    heading = np.radians([0.0, 180.0, 90.0, -90.0, 45.0, 225.0])
    boxes = LabelledBoxes(
        label_line=np.arange(6),
        label=np.full(6, "Car"),
        centre_m=np.tile([20.0, 0.0, -1.0], (6, 1)),
        size_m=np.ones((6, 3)),
        heading_rad=heading,
        occlusion=np.zeros(6, dtype=np.int8),
        truncation=np.zeros(6),
    )
    np.testing.assert_allclose(boxes.bearing_deg, [0, 0, 90, 90, 45, 45], atol=1e-5)


def test_every_car_has_one_bearing():
    classes = of_bearing(np.array([0.0, 19.9, 20.0, 69.9, 70.0, 90.0]))
    assert {name: mine.tolist() for name, mine in classes.items()} == {
        "end-on": [True, True, False, False, False, False],
        "oblique": [False, False, True, True, False, False],
        "side-on": [False, False, False, False, True, True],
    }


def test_metrics_are_chosen_by_name():
    assert [one.name for one in chosen_metrics("points, pe-vgop,points")] == ["points", "pe-vgop"]
    assert [one.name for one in chosen_metrics(None)][:2] == ["view-coverage", "pe-vgop"]
    with pytest.raises(InputError, match=r"--metrics: unknown metric 'pe-vgo'; did you mean 'pe-vgop'\?"):
        chosen_metrics("pe-vgo")
    assert all(one.learn is None for one in comparable().values())  # none needs a scene's traffic


# --- Expected visibility ----------------------------------------------------------------------------------------------

CAR = (4.4, 2.0, 1.6)


def boxes(places, size):
    """Vehicles that look along x."""
    n = len(places)
    centre = np.array(places, dtype=float).reshape(n, 3)
    return FrameBoxes(0, centre, np.tile(size, (n, 1)), np.zeros(n), np.ones(n, dtype=bool))


def visibility(training, *places, size=CAR):
    frame = boxes(places, size)
    n = len(places)
    view = View(Mountings(np.zeros((1, 3)), np.eye(3)[None]), frame)
    returns = VehicleReturns(frame.size_m, np.zeros(n, dtype=np.int64), np.zeros((n, 3)), view=view)
    return expected_visibility([boxes(one, size) for one in training])(returns)


NEAR, FAR, ASIDE = (10.0, 0.2, -0.6), (30.0, 0.2, -0.6), (0.2, 20.0, -0.6)


def test_a_car_where_none_was_before_is_wholly_visible():
    assert visibility([[ASIDE]], NEAR, FAR).tolist() == [1.0, 1.0]


def test_a_car_behind_where_cars_usually_stand_is_less_visible_the_more_often_they_do():
    rarely, often, ever = (visibility([[NEAR]] * with_car + [[]] * (4 - with_car), FAR)[0] for with_car in (1, 3, 4))
    assert 1.0 > rarely > often > ever
    assert ever == 0.0  # no beam gets through what is always there


def test_what_stands_in_the_way_now_changes_nothing():
    alone = visibility([[NEAR], [ASIDE]], FAR)
    assert visibility([[NEAR], [ASIDE]], FAR, NEAR)[0] == alone[0]


def test_it_is_the_mean_over_its_voxels_of_the_product_along_the_beam():
    """Of a bar of ten voxels straight ahead that one frame in four holds: each beam meets them one after the other."""
    bar = np.array([4.2, 0.3, 0.3])
    seen = visibility([[(10.0, 0.2, 0.2)], [], [], []], (10.0, 0.2, 0.2), size=bar)[0]
    assert seen == pytest.approx(np.mean([0.75**k for k in range(10)]))


def test_a_car_beyond_the_region_is_not_looked_for():
    assert visibility([[NEAR]], (200.0, 0.0, -0.6)).tolist() == [0.0]
