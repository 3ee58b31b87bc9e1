"""Variety of vehicles by the fleet, and traffic made lighter, denser and heavier."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from blender_lidar.detection.judge import sensor_at
from blender_lidar.road import RoadSettings
from blender_lidar.road.settings import map_of
from blender_lidar.scene.scenario import load_scenario
from blender_lidar.scene.settings import TrafficSettings
from blender_lidar.scene.site import prepare, read_recording, read_recordings
from blender_lidar.scoring import frame_scorer
from blender_lidar.traffic import overlapping_pairs
from blender_lidar.traffic.fleet import (
    BODIES,
    CAR,
    FLEET,
    KIND_OF_BODY,
    SIZE_M,
    TRUCK,
    queued,
    turned_into,
    with_variety,
)
from blender_lidar.traffic.vehicles import CLASSES, FLEET_KINDS, HEIGHTS_M, Recording, RepairReport, fleet_kind
from blender_lidar.world.triangles import shape_names
from tests.sample_traffic import dense_traffic
from tests.small_scene import CASTER

pytestmark = pytest.mark.versions


def scenario(variety, **more):
    scene = {("world", "variety"): variety, ("model", "caster"): CASTER, ("traffic", "frames"): 6}
    scene |= {tuple(key.split("__")): value for key, value in more.items()}
    return load_scenario("i80", {key: (value, "x") for key, value in scene.items()})


@pytest.fixture(scope="module")
def recordings():
    return {variety: read_recording(scenario(variety)) for variety in (0.0, 0.5, 1.0)}


@pytest.fixture(scope="module")
def sites():
    return prepare(scenario(0.0)), prepare(scenario(1.0))


def of_vehicles(recording):
    """One row of each vehicle: kinds, lengths, heights and bodies, as rows of `FLEET`."""
    _, first = np.unique(recording.vehicle_id, return_index=True)
    length, classes = recording.size_m[first, 0], recording.class_index[first]
    kinds = np.array(FLEET_KINDS)[fleet_kind(classes, length)]
    names = [[body.name for body in FLEET[kind]] for kind in kinds]
    drawn = [
        of_kind[0] if body == 0 else BODIES[body - 1]
        for of_kind, body in zip(names, recording.body[first], strict=True)
    ]
    rows = np.array([of_kind.index(name) for of_kind, name in zip(names, drawn, strict=True)])
    return kinds, length, recording.size_m[first, 2], rows


def table(heights, ids=None, kind="car"):
    """A recording of vehicles in two frames, 4.4 m long."""
    n = len(heights)
    ids = np.arange(n) if ids is None else ids
    size = np.column_stack([np.full(n, 4.4), np.full(n, 1.8), heights])
    return Recording.from_rows(
        frame=np.repeat([0, 1], n),
        time_s=np.repeat([0.0, 0.1], n),
        vehicle_id=np.tile(ids, 2),
        class_index=np.full(2 * n, CLASSES.index(kind)),
        centre_m=np.tile(np.column_stack([10.0 * np.arange(n), np.full(n, 9.0), 0.5 * np.asarray(heights)]), (2, 1)),
        size_m=np.tile(size, (2, 1)),
        heading_rad=np.zeros(2 * n),
        lane=np.zeros(2 * n),
        time_step_s=0.1,
        source="table",
        report=RepairReport(),
    )


def test_heights_differ_by_vehicle_within_those_of_their_body(recordings):
    kinds, length, height, body = of_vehicles(recordings[1.0])
    assert set(kinds) == {"car", "van", "truck", "long_truck", "motorcycle"}
    for kind in set(kinds):
        mine = kinds == kind
        assert len(np.unique(height[mine])) == mine.sum() > 10
        assert np.std(height[mine]) > 0.05
        for row, one in enumerate(FLEET[kind]):
            of_body = mine & (body == row)
            assert of_body.any()
            low, high = one.height_m
            assert (height[of_body] >= low - 1e-9).all()
            assert (height[of_body] <= high + 1e-9).all()
            if row > 0:
                assert (length[of_body] >= one.length_m[0]).all()
                assert (length[of_body] <= one.length_m[1]).all()
    suv = (kinds == "car") & (body == 2)
    assert np.corrcoef(length[suv], height[suv])[0, 1] > 0.4
    assert height[kinds == "car"].mean() == pytest.approx(1.5, abs=0.05)


def test_strength_scales_the_spread_and_without_it_nothing_changes(recordings):
    spread = {}
    for variety, recording in recordings.items():
        kinds, _, height, body = of_vehicles(recording)
        car = kinds == "car"
        spread[variety] = np.std(height[car]), (body[car] > 0).mean()
        floor = recording.centre_m[:, 2] - 0.5 * recording.size_m[:, 2]
        np.testing.assert_allclose(floor, 0.0, atol=1e-12)
    assert spread[0.0] == (0.0, 0.0)
    assert 0.02 < spread[0.5][0] < 0.6 * spread[1.0][0]
    assert spread[0.5][1] == pytest.approx(0.5 * spread[1.0][1], abs=0.04)
    assert with_variety(recordings[0.0], 0.0, 1) is recordings[0.0]


def test_a_vehicle_stays_itself_whatever_else_there_is(recordings):
    whole = recordings[1.0]
    some = read_recording(scenario(1.0, traffic__lanes=(2, 3)))
    rows = np.isin(whole.lane, (2, 3))
    for column in ("size_m", "centre_m", "body"):
        np.testing.assert_array_equal(getattr(some, column), getattr(whole, column)[rows])
    for number in whole.vehicle_id[:40]:
        mine = whole.vehicle_id == number
        assert len(np.unique(whole.size_m[mine, 2])) == len(np.unique(whole.body[mine])) == 1


def test_the_seed_and_the_recording_count():
    base = scenario(1.0)
    twice = replace(base, recordings=(*base.recordings, replace(base.recordings[0], name="again")))
    assert isinstance(twice.recordings[1], TrafficSettings)
    first, second = read_recordings(twice)
    assert (first.size_m[:, 2] != second.size_m[:, 2]).mean() > 0.9
    np.testing.assert_array_equal(first.size_m, read_recording(base).size_m)
    joined = read_recording(twice)
    _, first_rows = np.unique(joined.vehicle_id, return_index=True)
    assert len(np.unique(joined.size_m[first_rows, 2])) > 0.99 * len(first_rows)
    assert len(np.unique(joined.body)) > 5
    other = read_recording(scenario(1.0, world__variety_seed=2))
    assert (other.size_m[:, 2] != first.size_m[:, 2]).mean() > 0.9


def test_heights_of_their_own_stay_and_those_of_a_class_are_scaled():
    own = table([1.4, 1.5, 1.62])
    varied = with_variety(own, 1.0, 1)
    np.testing.assert_array_equal(varied.size_m, own.size_m)
    np.testing.assert_array_equal(with_variety(table([1.62]), 1.0, 1).size_m, table([1.62]).size_m)
    assert with_variety(table([1.5]), 1.0, 1).size_m[0, 2] != 1.5
    usual, higher = (with_variety(table([height] * 3), 1.0, 1).size_m[:, 2] for height in (HEIGHTS_M["car"], 1.8))
    np.testing.assert_allclose(higher, usual * 1.8 / 1.5, rtol=1e-12)
    raised = table([1.5] * 3)
    raised = replace(raised, centre_m=raised.centre_m + np.array([0.0, 0.0, 0.2]))
    varied = with_variety(raised, 1.0, 1)
    np.testing.assert_allclose(varied.centre_m[:, 2] - 0.5 * varied.size_m[:, 2], 0.2, atol=1e-12)
    negative = with_variety(table([1.5] * 2, np.array([-3, 7])), 1.0, 1)
    assert len(np.unique(negative.size_m[:, 2])) == 2


def test_a_body_is_of_the_vehicle_however_it_is_measured_in_a_frame():
    once = table([3.0] * 40, kind="truck")
    length = np.where(np.arange(len(once)) < 40, 8.95, 9.05)  # of all trucks in the first frame, and in the second
    once = replace(once, size_m=np.column_stack([length, once.size_m[:, 1:]]))
    varied = with_variety(once, 1.0, 1)
    first, second = (shape_names(varied.at(frame)) for frame in (0, 1))
    np.testing.assert_array_equal(first, second)
    assert {KIND_OF_BODY[name] for name in first} == {"truck"}
    np.testing.assert_array_equal(varied.size_m[:40, 2], varied.size_m[40:, 2])
    assert len(np.unique(varied.size_m[:, 2])) == 40
    classes = np.where(np.arange(len(once)) < 40, CLASSES.index("van"), once.class_index).astype(np.int8)
    sometimes = with_variety(replace(once, class_index=classes), 1.0, 1)
    np.testing.assert_array_equal(*(shape_names(sometimes.at(frame)) for frame in (0, 1)))


def test_who_has_a_height_of_its_own_has_a_body_as_high():
    height = np.repeat([1.45, 1.54, 1.62, 2.5], 100)
    names = shape_names(with_variety(table(height), 1.0, 1).at(0)).reshape(4, 100)
    assert [set(one) for one in names] == [{"car", "hatchback"}, {"hatchback", "suv"}, {"suv"}, {"car"}]


@pytest.mark.parametrize("compiled", [True, False])
def test_scores_see_the_same_bodies_as_clouds(compiled, sites, monkeypatch):
    if not compiled:
        monkeypatch.setattr(frame_scorer, "numba_works", lambda: False)
    site = sites[1]
    mounting = site.scenario.lidar.mounting({"height_m": 4.0, "tilt_x_deg": 15.0})
    shown = set()
    for frame in site.search[:3]:
        shown |= set(shape_names(frame).tolist())
        cloud = sensor_at(site, mounting).scan(frame)
        expected = [(cloud.vehicle_id == number).sum() for number in frame.vehicle_id[frame.counted]]
        seen = frame_scorer.FrameScorer(frame, site.observation).see([(mounting.pose,)])
        np.testing.assert_array_equal(seen.points[0], expected)
    assert {"car", "hatchback", "suv"} < shown


# --- traffic made lighter, denser and heavier -------------------------------------------------------------------------


ROAD = RoadSettings()
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
        road=map_of(ROAD),
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
