"""Road maps, straight and bent, give lane, station and offset of a place, and outlines that agree with them."""

from __future__ import annotations

import math
import pickle

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from blender_lidar.road.approaches import approaches_to
from blender_lidar.road.driven import driven_area
from blender_lidar.road.road_map import Flat, RoadMap, polygon_holds
from blender_lidar.road.settings import RoadSettings, map_of
from blender_lidar.scene.mount_checks import boxes_around, footprints_meet
from blender_lidar.scene.settings import BarrierSettings
from blender_lidar.world.scenery import along_road, barrier

pytestmark = pytest.mark.versions

STRAIGHT = RoadSettings(setback_m=2.0, lanes=3, lane_width_m=3.5)
FLAT = map_of(STRAIGHT).surface


def arc(radius=60.0, turn_rad=1.2, lanes=2, width=3.5, step_m=0.5):
    """Lanes about a circle's middle at (0, radius), the right one first, driven counter-clockwise from (0, 0)."""
    lines = []
    for lane in range(lanes):
        own = radius - lane * width
        angle = np.linspace(0.0, turn_rad, math.ceil(radius * turn_rad / step_m))
        lines.append(np.stack([own * np.sin(angle), radius - own * np.cos(angle)], axis=1))
    offset = width * np.arange(lanes)
    return RoadMap(tuple(lines), np.zeros(lanes), offset, np.full(lanes, width), np.zeros(lanes, dtype=bool), FLAT)


def test_a_straight_road_locates_places_by_its_lanes():
    road = map_of(STRAIGHT)
    xy = np.array([[7.0, 2.0], [-300.0, 5.4], [0.25, 5.6], [4e4, 12.5], [1.0, 1.99], [1.0, 12.51]])
    found = road.locate(xy)
    np.testing.assert_array_equal(found.lane, [0, 0, 1, 2, -1, -1])
    np.testing.assert_array_equal(found.s_m, xy[:, 0])
    np.testing.assert_allclose(found.t_m, xy[:, 1], atol=1e-12)
    assert road.edges_t == (2.0, 12.5)
    np.testing.assert_array_equal(found.heading_rad, 0.0)


@settings(max_examples=60, deadline=None)
@given(st.floats(0.02, 1.18), st.floats(-6.0, 2.5))
def test_on_a_bend_station_offset_and_heading_are_those_of_the_circle(angle, outwards):
    radius, road = 60.0, arc()
    away = radius + outwards
    place = np.array([[away * math.sin(angle), radius - away * math.cos(angle)]])
    found = road.locate(place)
    lane = 0 if -1.75 < outwards < 1.75 else 1 if -5.25 < outwards < -1.75 else -1
    if min(abs(outwards - edge) for edge in (-5.25, -1.75, 1.75)) < 0.01:
        return  # chords are inside their arcs
    assert found.lane[0] == lane
    if lane >= 0:
        own = radius - 3.5 * lane
        assert found.s_m[0] == pytest.approx(own * angle, abs=0.02)
        assert found.t_m[0] == pytest.approx(radius - away, abs=0.01)
        assert found.heading_rad[0] == pytest.approx(angle, abs=0.01)


def test_outlines_hold_the_places_that_are_on_their_lane():
    rng = np.random.default_rng(3)
    for road, s in ((arc(), (5.0, 50.0)), (map_of(STRAIGHT), (-20.0, 30.0))):
        xy = rng.uniform((-25.0, -10.0), (60.0, 60.0), (4000, 2))
        found = road.locate(xy)
        for lane, outline in enumerate(road.area(s_m=s)):
            along = (found.s_m >= s[0]) & (found.s_m <= s[1])
            near_edge = np.abs(np.abs(found.t_m - road.offset_m[lane]) - 0.5 * road.width_m[lane]) < 0.02
            near_end = np.abs(found.s_m - np.array([s[0], s[1]])[:, None]).min(axis=0) < 0.2
            clear = ~near_edge & ~near_end
            np.testing.assert_array_equal(polygon_holds(outline, xy)[clear], ((found.lane == lane) & along)[clear])


@pytest.mark.parametrize("road", [map_of(STRAIGHT), arc(lanes=3)], ids=["straight", "bend"])
def test_a_carriageway_has_two_edges_and_lines_between_its_lanes(road):
    edges, between = road.lines((1.0, 40.0))
    assert (len(edges), len(between)) == (2, 2)
    for line in between:
        assert road.within(line[1:-1]).all()
    for line in edges:
        np.testing.assert_allclose(np.abs(road.locate(line[1:-1]).t_m - np.mean(road.edges_t)), 5.25, atol=1e-3)
        assert not road.within(line).any()


def test_the_edges_beside_a_place_lie_across_all_lanes():
    right, left = map_of(STRAIGHT).edges_across((4.0, 7.0))
    np.testing.assert_allclose([right, left], [[4.0, 2.0], [4.0, 12.5]], atol=1e-5)
    right, left = arc().edges_across((60.0 * math.sin(0.5), 60.0 - 60.0 * math.cos(0.5)))
    for place, radius in ((right, 61.75), (left, 54.75)):
        assert np.hypot(place[0], place[1] - 60.0) == pytest.approx(radius, abs=0.01)


def test_where_lanes_cross_the_heading_decides():
    crossing = RoadMap(
        (np.array([[-20.0, 0.0], [20.0, 0.0]]), np.array([[0.0, -20.0], [0.0, 20.0]])),
        np.array([100.0, 200.0]),
        np.zeros(2),
        np.array([3.0, 3.0]),
        np.array([False, True]),
        FLAT,
    )
    found = crossing.locate(np.zeros((3, 2)), np.array([0.1, -1.5, 1.4]))
    np.testing.assert_array_equal(found.lane[:2], [0, 1])
    np.testing.assert_allclose(found.s_m[:2], [120.0, 220.0])
    assert found.heading_rad[1] == pytest.approx(-0.5 * math.pi)
    assert crossing.locate(np.array([[20.001, 0.0]])).lane[0] == -1, "a lane with ends has ends"


def test_a_crown_rises_to_the_middle_and_its_triangles_lie_on_it():
    road = map_of(RoadSettings(setback_m=2.0, lanes=4, lane_width_m=3.0, crown_percent=2.5))
    height = road.surface.height(np.array([[0.0, 0.0], [0.0, 2.0], [9.0, 8.0], [0.0, 11.0], [0.0, 14.0], [0.0, 99.0]]))
    np.testing.assert_allclose(height, [0.0, 0.0, 0.15, 0.075, 0.0, 0.0], atol=1e-15)
    corners = road.surface.triangles((0.0, 0.0), 5.0)
    np.testing.assert_allclose(corners[..., 2], road.surface.height(corners.reshape(-1, 3)).reshape(4, 3), atol=1e-15)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert (normal[:, 2] > 0.0).all()
    assert len(FLAT.triangles((0.0, 0.0), 5.0)) == 0


def test_only_a_straight_road_without_ends_has_an_axis():
    np.testing.assert_array_equal(map_of(STRAIGHT).axis, [1.0, 0.0])
    assert arc().axis is None


def test_stations_of_a_stretch_are_its_ends_and_the_corners_between():
    assert map_of(STRAIGHT).stations((-20.0, 30.0)).tolist() == [-20.0, 30.0]
    assert map_of(STRAIGHT).stretch((7.0, 5.0), 10.0) == (-3.0, 17.0)
    corners = np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 20.0]])
    bend = RoadMap((corners,), np.array([5.0]), np.zeros(1), np.full(1, 3.5), np.array([False]), FLAT)
    assert bend.stations().tolist() == [5.0, 15.0, 35.0]
    assert bend.stations((0.0, 20.0)).tolist() == [5.0, 15.0, 20.0]
    assert bend.stations((40.0, 50.0)).tolist() == []


def test_a_barrier_on_a_bend_follows_it_and_a_lidar_in_it_is_refused():
    road = arc()
    made = along_road(road, barrier("concrete", 5.4, road.stations((5.0, 50.0))))
    away = np.hypot(made.corners[..., 0], made.corners[..., 1] - 60.0)
    assert np.abs(away - (60.0 - 5.4)).max() < 0.32
    boxes = list(boxes_around(BarrierSettings(kind="concrete", y_m=5.4, x_m=(5.0, 50.0)), road))
    keys = ("centre_m", "size_m", "heading_deg")
    centre, size, heading = (np.array([getattr(box, key) for box in boxes]) for key in keys)
    for radius, refused in ((54.6, True), (53.0, False)):
        place = np.array([radius * math.sin(0.4), 60.0 - radius * math.cos(0.4)])
        assert footprints_meet(centre, size, np.radians(heading), place, place).any() == refused


def test_a_map_survives_pickling():
    road = pickle.loads(pickle.dumps(arc()))
    xy = np.array([[3.0, 0.1], [30.0, 9.0]])
    np.testing.assert_array_equal(road.locate(xy).s_m, arc().locate(xy).s_m)


@pytest.mark.parametrize("road", [map_of(STRAIGHT), arc()], ids=["straight", "bend"])
def test_a_place_lies_where_its_station_and_offset_say(road):
    s, t = np.meshgrid(np.linspace(3.0, 40.0, 23), np.linspace(*road.edges_t, 9)[1:-1])
    found = road.locate(road.at(s, t).reshape(-1, 2))
    mine = found.lane == 0
    assert mine.sum() > 20
    np.testing.assert_allclose(found.s_m[mine], s.ravel()[mine], atol=0.05)
    np.testing.assert_allclose(found.t_m, t.ravel(), atol=0.01)


def test_on_a_bend_a_slanted_heading_changes_nothing_within_one_lane():
    road, angle = arc(), np.linspace(0.1, 1.1, 40)
    place = np.stack([60.5 * np.sin(angle), 60.0 - 60.5 * np.cos(angle)], axis=1)
    alone = road.locate(place)
    for turn in (-0.6, 0.3, 2.5):
        for found, expected in zip(road.locate(place, angle + turn), alone, strict=True):
            np.testing.assert_array_equal(found, expected)


def test_across_a_loop_that_comes_back_the_edges_beside_a_place_are_found():
    ring = arc(radius=10.0, turn_rad=2.0 * math.pi - 0.01, lanes=1, width=9.0)
    right, left = ring.edges_across((10.0, 10.0))
    assert np.hypot(*(right - (0.0, 10.0))) == pytest.approx(14.5, abs=0.02)
    assert np.hypot(*(left - (0.0, 10.0))) == pytest.approx(5.5, abs=0.02)


def nowhere() -> RoadMap:
    """A road without lanes."""
    none = np.zeros(0)
    return RoadMap((), none, none, none, none.astype(bool), Flat())


def driven() -> RoadMap:
    """A road without lanes, where one car has driven."""
    return driven_area(np.array([[3.0, 4.0]]), np.array([[4.5, 1.8]]), np.array([0.3]))


@pytest.mark.parametrize("made", [nowhere, driven])
def test_a_road_without_lanes_answers_whatever_one_with_lanes_answers(made):
    road, xy = made(), np.array([[3.0, 4.0], [90.0, -7.0]])
    located = road.locate(xy, np.zeros(2))
    assert located.lane.tolist() == [-1, -1]
    np.testing.assert_array_equal(road.at(located.s_m, located.t_m), xy)
    assert (len(road), road.edges_t, road.axis, road.lines((0.0, 9.0))) == (0, (0.0, 0.0), None, ([], []))
    assert road.stations((2.0, 5.0)).tolist() == [2.0, 5.0]
    assert len(road.stations()) == len(road.stations((5.0, 5.0))) == 0
    assert road.stretch((3.0, 4.0), 10.0) == (-7.0, 13.0)
    assert (road.side_of((3.0, 4.0)), road.direction((3.0, 4.0)), road.driven) == ("", 0.0, road)
    assert road.nearest((9.0, 9.0)).shape[1] == 2
    assert all(edge.shape == (2,) for edge in road.edges_across((3.0, 4.0)))
    is_driven = made is driven
    assert road.on(xy).tolist() == road.within(xy).tolist() == [is_driven, False]
    assert bool(road.area()) == is_driven
    assert (road.clearance((90.0, -7.0))[0] < math.inf) == is_driven
    assert approaches_to(road, ["any"]) == []


@pytest.mark.parametrize("carriageways", [1, 2])
def test_the_side_of_a_road_is_that_of_its_edges_and_a_map_has_none(carriageways):
    settings = RoadSettings(carriageways=carriageways, median_m=6.0 if carriageways == 2 else None, lanes=2)
    road, edges = map_of(settings), settings.carriageways_y
    middle = 0.5 * (edges[0][1] + edges[-1][0])
    found = [road.side_of((5.0, y)) for y in (edges[0][0], sum(edges[0]) / 2, middle, edges[-1][1])]
    assert found == ["right", "gantry", "median" if carriageways == 2 else "gantry", "left"]
    assert [math.degrees(road.facing_of[side]) for side in ("right", "left", "median", "gantry")] == [90, 270, 90, 90]
    assert arc().side_of((5.0, 0.0)) == ""
