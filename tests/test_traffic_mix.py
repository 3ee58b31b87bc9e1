"""Traffic made lighter, denser and heavier: what stays, what moves, and that nothing drives through another."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from blender_lidar.road import StraightRoad
from blender_lidar.road.straight import road_map
from blender_lidar.studies.variations import CAR, SIZE_M, TRUCK, queued, turned_into
from blender_lidar.traffic import overlapping_pairs
from tests.sample_traffic import dense_traffic

ROAD = StraightRoad()
COPIES_FROM = 10_000


def straight(vehicles):
    """The same with boxes along the road, so that gaps are what they seem."""
    return replace(vehicles, heading_rad=np.zeros(len(vehicles)))


def lanes(vehicles):
    return np.floor((vehicles.centre_m[:, 1] - ROAD.carriageways_y[0][0]) / ROAD.lane_width_m).astype(int)


def gaps(vehicles):
    """Bumper gaps of every lane, front to back."""
    found = []
    for lane in np.unique(lanes(vehicles)):
        rows = np.flatnonzero(lanes(vehicles) == lane)
        rows = rows[np.argsort(vehicles.centre_m[rows, 0])]
        x, length = vehicles.centre_m[rows, 0], vehicles.size_m[rows, 0]
        found.append(np.diff(x) - 0.5 * (length[1:] + length[:-1]))
    return np.concatenate(found)


def queue(vehicles, change=lambda gaps: gaps, **settings):
    return queued(
        vehicles,
        settings.pop("lengths_m", vehicles.size_m[:, 0]),
        change,
        anchor_m=settings.pop("anchor_m", 0.0),
        road=road_map(ROAD),
        copies_from=COPIES_FROM,
        **settings,
    )


def test_with_the_gaps_and_lengths_that_they_had_vehicles_stay_where_they_are():
    traffic = dense_traffic()
    np.testing.assert_allclose(queue(traffic).centre_m, traffic.centre_m, atol=1e-9)


def test_a_jam_has_the_gaps_that_were_asked_for_in_the_same_order_about_the_anchor():
    traffic = straight(dense_traffic())
    jam = queue(traffic, lambda gaps: np.clip(gaps, 1.0, 2.5), anchor_m=30.0)
    assert gaps(jam).min() >= 1.0 - 1e-9
    assert gaps(jam).max() <= 2.5 + 1e-9
    for lane in np.unique(lanes(traffic)):
        rows = np.flatnonzero(lanes(traffic) == lane)
        np.testing.assert_array_equal(np.argsort(traffic.centre_m[rows, 0]), np.argsort(jam.centre_m[rows, 0]))
        nearest = rows[np.argmin(np.abs(traffic.centre_m[rows, 0] - 30.0))]
        assert jam.centre_m[nearest, 0] == traffic.centre_m[nearest, 0]
    assert len(overlapping_pairs(jam)) == 0


@pytest.mark.parametrize("reach", [60.0, 180.0, 700.0])
def test_a_jam_is_continued_as_far_as_it_is_looked_at_with_copies_that_have_their_own_numbers(reach):
    traffic = straight(dense_traffic())
    jam = queue(traffic, lambda gaps: np.clip(gaps, 1.0, 2.5), filled_to_m=reach)
    for lane in range(ROAD.lanes):
        x = np.sort(jam.centre_m[lanes(jam) == lane, 0])
        assert x[0] <= -reach
        assert x[-1] >= reach
    assert len(np.unique(jam.vehicle_id)) == len(jam)
    assert set(jam.vehicle_id % COPIES_FROM) <= set(traffic.vehicle_id)
    assert gaps(jam).max() <= 2.5 + 1e-9
    assert len(overlapping_pairs(jam)) == 0


def test_a_ramp_beside_the_road_is_not_continued():
    traffic = straight(dense_traffic())
    centre = traffic.centre_m.copy()
    centre[:5, 1] = ROAD.carriageways_y[0][0] - 2.0
    centre[:5, 0] = np.arange(5) * 20.0
    jam = queue(replace(traffic, centre_m=centre), lambda gaps: np.clip(gaps, 1.0, 2.5), filled_to_m=300.0)
    assert (lanes(jam) < 0).sum() == 5


def test_vehicles_in_one_another_do_not_make_endless_copies():
    traffic = straight(dense_traffic(vehicles=12))
    centre = traffic.centre_m.copy()
    centre[:, 0], centre[:, 1] = np.linspace(0.0, 0.5, 12), ROAD.carriageways_y[0][0] + 1.0
    piled = replace(traffic, centre_m=centre)
    assert len(queue(piled, lambda gaps: np.clip(gaps, 1.0, 2.5), filled_to_m=500.0)) < 500
    assert len(queue(piled, filled_to_m=500.0)) == 12  # with negative gaps there is no length to continue by


def test_what_drives_across_the_road_stays_where_it_is():
    traffic = dense_traffic()
    heading = traffic.heading_rad.copy()
    heading[::3] = np.pi / 2
    mixed = replace(traffic, heading_rad=heading)
    jam = queue(mixed, lambda gaps: np.clip(gaps, 1.0, 2.5))
    np.testing.assert_array_equal(jam.centre_m[::3], traffic.centre_m[::3])
    assert (np.abs(jam.centre_m[:, 0] - traffic.centre_m[:, 0]) > 1.0).any()


def test_cars_that_become_lorries_stand_on_the_road_and_push_the_others_away():
    traffic = straight(dense_traffic())
    ids = traffic.vehicle_id[traffic.class_index == CAR][::4]
    heavier = turned_into(traffic, ids, TRUCK)
    turned = np.isin(heavier.vehicle_id, ids)
    assert (heavier.class_index[turned] == TRUCK).all()
    np.testing.assert_allclose(heavier.size_m[turned], np.tile(SIZE_M[TRUCK], (turned.sum(), 1)))
    np.testing.assert_allclose(heavier.centre_m[:, 2], 0.5 * heavier.size_m[:, 2])
    np.testing.assert_array_equal(heavier.size_m[~turned], traffic.size_m[~turned])
    apart = queue(heavier, lengths_m=traffic.size_m[:, 0])
    np.testing.assert_allclose(gaps(apart), gaps(traffic), atol=1e-9)
    assert len(overlapping_pairs(apart)) <= len(overlapping_pairs(traffic))


def test_lorries_that_become_cars_are_cars():
    traffic = dense_traffic()
    ids = traffic.vehicle_id[traffic.class_index == TRUCK]
    assert len(ids)
    lighter = turned_into(traffic, ids, CAR)
    turned = np.isin(lighter.vehicle_id, ids)
    assert (lighter.class_index[turned] == CAR).all()
    np.testing.assert_allclose(lighter.size_m[turned], np.tile(SIZE_M[CAR], (len(ids), 1)))
