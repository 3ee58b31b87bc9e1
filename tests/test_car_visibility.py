"""Expected visibility of single cars: what usually stands in the way counts, what stands there now does not."""

from __future__ import annotations

import numpy as np
import pytest

from blender_lidar.metrics.context import FrameBoxes, Mountings, View
from blender_lidar.metrics.metric import VehicleReturns
from blender_lidar.reality.car_visibility import CarVisibility

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
    return CarVisibility([boxes(one, size) for one in training])(returns)


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
