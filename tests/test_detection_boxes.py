"""Overlap of oriented boxes from above, beside shapely; non-maximum suppression."""

from __future__ import annotations

import numpy as np
import pytest

from blender_lidar.traffic.boxes import (
    KINDS,
    DetectedBoxes,
    bev_iou,
    corners_of,
    join_boxes,
    kind_of,
    no_boxes,
    suppressed,
)
from blender_lidar.traffic.vehicles import CLASSES

OCTAGON = 4 - 2 * (2**0.5 - 1) ** 2  # a square on its corner less the two that stick out


def boxes_of(rows, confidence=None):
    """DetectedBoxes from rows of x, y, length, width, heading [degrees]."""
    x, y, length, width, heading = np.array(rows, dtype=float).reshape(-1, 5).T
    return DetectedBoxes(
        np.column_stack([x, y, np.full_like(x, 0.75)]),
        np.column_stack([length, width, np.full_like(x, 1.5)]),
        np.radians(heading),
        np.zeros(len(x), np.int8),
        np.ones(len(x)) if confidence is None else np.array(confidence, dtype=float),
    )


def random_boxes(rng, count, spread_m):
    return boxes_of(
        np.column_stack(
            [
                *rng.uniform(-spread_m, spread_m, (2, count)),
                *rng.uniform(0.5, 12.0, (2, count)),
                rng.uniform(-400, 400, count),
            ]
        )
    )


@pytest.mark.parametrize("offset_m", [0.0, 5e5])
def test_overlap_is_that_of_shapely(offset_m):
    shapely = pytest.importorskip("shapely", reason="shapely, of the extra test, is not installed")
    rng = np.random.default_rng(4)
    one, other = random_boxes(rng, 60, 12.0), random_boxes(rng, 70, 12.0)
    for boxes in (one, other):
        boxes.centre_m[:, :2] += offset_m
    polygons, others = (shapely.polygons(corners_of(boxes) - offset_m) for boxes in (one, other))
    shared = shapely.area(shapely.intersection(polygons[:, None], others[None]))
    expected = shared / (shapely.area(polygons)[:, None] + shapely.area(others) - shared)
    assert (expected > 0.0).sum() > 1000
    np.testing.assert_allclose(bev_iou(one, other), expected, atol=1e-9 if offset_m == 0.0 else 1e-7)


@pytest.mark.parametrize(
    ("other", "iou"),
    [
        ((0, 0, 4, 2, 0), 1.0),
        ((0, 0, 4, 2, 180), 1.0),
        ((0, 0, 2, 4, 90), 1.0),
        ((2, 0, 4, 2, 0), 1 / 3),
        ((4, 0, 4, 2, 0), 0.0),  # they touch
        ((0, 0, 1, 1, 0), 1 / 8),  # within
        ((0, 0, 2, 2, 45), OCTAGON / (8 + 4 - OCTAGON)),
        ((1, 0.5, 2, 1, 0), 2 / 8),  # with sides on those of the other
    ],
)
def test_overlaps_that_are_known(other, iou):
    one, other = boxes_of([(0, 0, 4, 2, 0)]), boxes_of([other])
    assert bev_iou(one, other)[0, 0] == pytest.approx(iou, abs=1e-12)
    assert bev_iou(other, one)[0, 0] == pytest.approx(iou, abs=1e-12)


def test_overlap_of_nothing_is_empty():
    assert bev_iou(no_boxes(), boxes_of([(0, 0, 4, 2, 0)])).shape == (0, 1)
    assert len(suppressed(no_boxes(), 0.1)) == 0
    assert len(join_boxes([])) == 0


def test_the_surest_of_those_that_overlap_stays():
    rows = [(0, 0, 4, 2, 0), (0.5, 0, 4, 2, 5), (10, 0, 4, 2, 0), (1.0, 0, 4, 2, 0)]
    kept = suppressed(boxes_of(rows, [0.5, 0.9, 0.2, 0.4]), 0.1)
    assert kept.confidence.tolist() == [0.9, 0.2]
    kept = suppressed(boxes_of(rows, [0.5, 0.9, 0.2, 0.4]), 0.99)
    assert kept.confidence.tolist() == [0.9, 0.5, 0.4, 0.2]


def test_every_class_has_a_kind():
    kinds = [KINDS[kind] for kind in kind_of(np.arange(len(CLASSES)))]
    assert dict(zip(CLASSES, kinds, strict=True)) == {
        "car": "car",
        "van": "car",
        "truck": "truck or bus",
        "bus": "truck or bus",
        "motorcycle": "motorcycle",
    }
