"""Labelled cars get the points of their boxes and the scores that an independent, slow reading of the paper gives."""

from __future__ import annotations

import csv
import math
from pathlib import Path

import numpy as np
import pytest

from blender_lidar.errors import InputError
from blender_lidar.metrics.assignment import SLACK_M
from blender_lidar.reality.cars import bearing_deg, score_cars
from blender_lidar.reality.chosen_metrics import chosen_metrics, comparable
from blender_lidar.reality.labelled import LabelledBoxes
from blender_lidar.reality.layouts import open_labelled
from blender_lidar.reality.learned_metrics import LEARNED
from tests.labelled_samples import sample_cars, write_kitti, write_sustech

KITTI = Path(__file__).parents[1].parent / "shared" / "data" / "kitti"
needs_kitti = pytest.mark.skipif(not KITTI.is_dir(), reason=f"no KITTI excerpt at {KITTI}")
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
    for frame in dict.fromkeys(cars.frame.tolist()):
        sweep = clouds.read(frame)
        for box in np.flatnonzero(np.char.lower(sweep.boxes.label) == "car"):
            boxes = sweep.boxes
            inside, shares = slow_views(sweep.points, boxes.centre_m[box], boxes.size_m[box], boxes.heading_rad[box])
            gap = np.linalg.norm(boxes.centre_m - boxes.centre_m[box], axis=1)
            reach = 0.5 * np.linalg.norm(boxes.size_m, axis=1)
            alone = np.count_nonzero(gap < reach + reach[box]) == 1
            assert cars.boxes.label_line[row] == boxes.label_line[box]
            if alone:
                assert cars.count[row] == inside
                np.testing.assert_allclose(cars.occupancy[row], shares, atol=1e-6)
                assert cars.scores["pe-vgop"][row] == pytest.approx(slow_entropy(shares), abs=1e-6)
            row += 1
    assert row == len(cars)


@pytest.mark.parametrize("write", [write_kitti, write_sustech])
def test_views_equal_sets_of_cells_in_both_layouts(tmp_path, write):
    clouds = open_labelled(write(tmp_path / "data", sample_cars(3)))
    cars = score_cars(clouds, clouds.frames, ["Car"], KNOWING)
    assert len(cars) == 12
    assert cars.count.min() > 0
    assert_as_slowly(clouds, cars)


@needs_kitti
def test_views_of_real_cars_equal_sets_of_cells():
    clouds = open_labelled(KITTI)
    cars = score_cars(clouds, clouds.frames, ["Car"], chosen_metrics("pe-vgop"))
    assert len(cars) == 212
    assert_as_slowly(clouds, cars)


@needs_kitti
def test_points_in_real_boxes_are_those_that_the_excerpt_counts():
    """It counted on full sweeps with boxes as they came; two boxes overlap, and faces are rounded elsewhere."""
    clouds = open_labelled(KITTI)
    cars = score_cars(clouds, clouds.frames, ["Car"], chosen_metrics("pe-vgop"))
    with (KITTI / "cars.csv").open(encoding="utf-8", newline="") as stream:
        known = {(row["frame"], int(row["label_line"])): int(row["points"]) for row in csv.DictReader(stream)}
    counted = np.array([known[key] for key in zip(cars.frame, cars.boxes.label_line.tolist(), strict=True)])
    np.testing.assert_allclose(cars.count, counted, rtol=0.06, atol=3)
    assert np.corrcoef(cars.count, counted)[0, 1] > 0.9999


def test_the_layouts_agree_on_the_same_cars(tmp_path):
    found = sample_cars(2)
    folders = write_kitti(tmp_path / "kitti", found), write_sustech(tmp_path / "sustech", found, "CAR")
    kitti, sustech = (score_cars(clouds, clouds.frames, ["car"], KNOWING) for clouds in map(open_labelled, folders))
    np.testing.assert_array_equal(kitti.count, sustech.count)
    for name, values in kitti.scores.items():
        np.testing.assert_allclose(values, sustech.scores[name], rtol=1e-5, err_msg=name)


def test_a_ground_clearance_takes_only_the_lowest_points(tmp_path):
    clouds = open_labelled(write_kitti(tmp_path / "data", sample_cars(2)))
    kept, stripped = (score_cars(clouds, clouds.frames, ["Car"], KNOWING, m) for m in (0.0, 0.3))
    assert (stripped.count < kept.count).any()
    assert (stripped.occupancy <= kept.occupancy + 1e-12).all()
    np.testing.assert_array_equal(stripped.boxes.centre_m, kept.boxes.centre_m)


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
    np.testing.assert_allclose(bearing_deg(boxes), [0, 0, 90, 90, 45, 45], atol=1e-5)


def test_metrics_are_chosen_by_name():
    assert [one.name for one in chosen_metrics("points, pe-vgop")] == ["points", "pe-vgop"]
    assert [one.name for one in chosen_metrics(None)][:2] == ["view-coverage", "pe-vgop"]
    with pytest.raises(InputError, match=r"--metrics: unknown metric 'pe-vgo'; did you mean 'pe-vgop'\?"):
        chosen_metrics("pe-vgo")
    with pytest.raises(InputError, match="--metrics: names points twice"):
        chosen_metrics("points,points")
    assert all(one.learn is None for one in comparable().values())  # none needs a scene's traffic
