"""The region of interest: which vehicles count, and that no pose, pole, seed or caster moves it."""

from __future__ import annotations

import json

import numpy as np
import pytest

from blender_lidar.detection.judge import region_of_alarms
from blender_lidar.errors import InputError
from blender_lidar.road.road_map import polygon_holds
from blender_lidar.road.settings import RoadSettings, map_of
from blender_lidar.scene.region import Region, check_polygon
from blender_lidar.scene.scenario import load_scenario
from blender_lidar.scene.site import prepare
from tests.refusals import refused
from tests.sample_traffic import one_vehicle
from tests.small_scene import GATE_M, REGION, cli, write_scene, write_table

pytestmark = [pytest.mark.usefixtures("quick"), pytest.mark.versions]

L_SHAPE = [(0.0, 0.0), (4.0, 0.0), (4.0, 1.0), (1.0, 1.0), (1.0, 4.0), (0.0, 4.0)]
U_SHAPE = [(0.0, 0.0), (6.0, 0.0), (6.0, 4.0), (4.0, 4.0), (4.0, 2.0), (2.0, 2.0), (2.0, 4.0), (0.0, 4.0)]
FIXED = {"height_m": 3.0, "tilt_x_deg": 15.0}


def winding_number(polygon, x, y):
    """How often the outline goes around a point: the slow way, by the angles under which its sides are seen."""
    corners = [complex(*corner) - complex(x, y) for corner in polygon]
    turned = (np.angle(after / before) for before, after in zip(corners, corners[1:] + corners[:1], strict=True))
    return round(sum(turned) / (2.0 * np.pi))


@pytest.mark.parametrize("polygon", [L_SHAPE, U_SHAPE, U_SHAPE[::-1], [(0.0, 0.0), (5.0, 1.0), (-1.0, 6.0)]])
def test_a_polygon_holds_the_points_that_its_outline_goes_around(polygon):
    points = np.random.default_rng(1).uniform(-2.0, 7.0, (500, 2))
    expected = [winding_number(polygon, *point) != 0 for point in points.tolist()]
    assert polygon_holds(polygon, points).tolist() == expected


@pytest.mark.parametrize("polygon", [L_SHAPE, U_SHAPE])
def test_corners_and_edges_belong_to_a_polygon(polygon):
    corners = np.array(polygon)
    middles = 0.5 * (corners + np.roll(corners, -1, axis=0))
    assert polygon_holds(polygon, np.concatenate([corners, middles])).all()
    assert not polygon_holds(polygon, np.array([[-1e-6, 2.0], [3.0, 4.0 + 1e-6]])).any()


@pytest.mark.parametrize(
    ("polygon", "fault"),
    [
        ([(0, 0), (1, 0)], "has 2 different corners of 2"),
        ([(0, 0), (1, 0), (0, 0), (0, 1)], "has 3 different corners of 4"),
        ([(0, 0), (2, 2), (2, 0), (0, 2)], "sides 1 and 3 cross"),
        ([(0, 0), (1, 1), (2, 2)], "lie on one line"),
    ],
)
def test_corners_that_are_no_polygon_are_refused(polygon, fault):
    with pytest.raises(InputError, match=fault):
        check_polygon(polygon, "here")


def test_sides_that_lie_on_one_line_without_touching_are_no_fault():
    check_polygon(U_SHAPE, "here")


def test_what_is_kept_out_does_not_count():
    region = Region((0.0, 0.0), 10.0, keep_out=[L_SHAPE])
    places = [(0.5, 0.5), (4.0, 0.5), (3.0, 3.0), (-1.0, 0.0)]
    assert [region.holds(one_vehicle("car", centre=place)).item() for place in places] == [False, False, True, True]


def write_lanes(folder):
    """Two lanes that swap sides half way: y alone does not say which one a vehicle is in."""
    header = ("frame", "vehicle_id", "class", "x_m", "y_m", "length_m", "width_m", "height_m", "heading_deg", "lane")
    rows = [
        [frame, lane, "car", 2.0 * frame - 40.0, 3.75 if (lane == 1) == (frame < 20) else 7.25, 4.4, 1.8, 1.5, 0, lane]
        for frame in range(40)
        for lane in (1, 2)
    ]
    return write_table(folder / "traffic.csv", rows, header)


def counted_in(folder, region):
    """Lane and x of each vehicle that counts in a scene with that [region]."""
    traffic = {"frames": None, "frame_ids": list(range(40)), "holdout": 0.0}
    site = prepare(load_scenario(write_scene(folder, {"deployment": FIXED, "traffic": traffic, "region": region})))
    chosen = [frame.select(frame.counted) for frame in site.search]
    return {(int(lane), float(x)) for each in chosen for lane, x in zip(each.lane, each.centre_m[:, 0], strict=True)}


def test_a_stretch_counts_the_carriageway_or_the_recordings_lanes(tmp_path):
    write_lanes(tmp_path)
    xs = [float(x) for x in range(-10, 7, 2)]  # both ends are in
    assert counted_in(tmp_path, {"stretches": [{"x_m": [-10.0, 6.0]}]}) == {(lane, x) for lane in (1, 2) for x in xs}
    assert counted_in(tmp_path, {"stretches": [{"x_m": [-10.0, 6.0], "lanes": [2]}]}) == {(2, x) for x in xs}
    both = [{"x_m": [-10.0, -4.0], "lanes": [1]}, {"x_m": [-2.0, 6.0], "lanes": [2]}]
    assert counted_in(tmp_path, {"stretches": both}) == {(1 if x <= -4.0 else 2, x) for x in xs}


def test_vehicles_beyond_the_gate_count_as_missed(tmp_path):
    near, far = (
        prepare(load_scenario(write_scene(tmp_path / name, {"region": {"radius_m": radius}})))
        for name, radius in (("near", GATE_M), ("far", 35.0))
    )
    seen = far.search
    assert all((frame.counted == (far.region.distance(frame) <= 35.0)).all() for frame in far.search)
    assert any((far.region.distance(vehicles) > GATE_M).any() for vehicles in seen)
    assert sum(frame.counted.sum() for frame in far.search) > sum(frame.counted.sum() for frame in near.search)


def counted(site):
    return [frame.vehicle_id[frame.counted].tolist() for frame in (*site.search, *site.holdout)]


@pytest.mark.parametrize(
    "changes",
    [
        {"deployment": {"x_m": [-15.0, 5.0], "y_m": [-1.0, 0.0]}},
        {"deployment": {"x_m": 12.0, "y_m": -3.0}},
        {"deployment": {"height_m": 9.0, "yaw_deg": 30.0}, "baseline": {"x_m": 7.0}},
        {"search": {"seed": 5}, "model": {"caster": "exact"}},
        {"sensor": {"name": "RS-80", "range_gate_m": 90.0}},
    ],
    ids=lambda changes: next(iter(changes)),
)
def test_the_same_vehicles_count_whatever_is_searched_or_hangs_there(tmp_path, changes):
    site = prepare(load_scenario(write_scene(tmp_path, REGION)))
    overrides = {(name, key): (value, "--it") for name, table in changes.items() for key, value in table.items()}
    other = prepare(load_scenario(write_scene(tmp_path, REGION), overrides))
    assert counted(other) == counted(site)
    assert other.plan.block_s == site.plan.block_s


def test_another_sensor_keeps_the_region_unless_it_is_to_follow_the_gate(tmp_path):
    gates = {"sensor": {"RS-16": {"range_gate_m": 20.0}, "RS-80": {"range_gate_m": 60.0}, "range_gate_m": None}}
    chosen = {("sensor", "name"): ("RS-80", "--sensor")}
    assert load_scenario(write_scene(tmp_path, gates), chosen).region.radius_m == 20.0
    scene = write_scene(tmp_path, {**gates, "region": {"radius_m": "gate"}})
    assert [load_scenario(scene, options).region.radius_m for options in ({}, chosen)] == [20.0, 60.0]


@pytest.mark.parametrize("key", ["x_m", "y_m"])
def test_a_searched_place_needs_a_region_and_one_is_proposed(tmp_path, capsys, key):
    scene = write_scene(tmp_path, {"deployment": {key: [-4.0, -2.0]}})
    line = refused(capsys, tmp_path, "optimise", scene, "--out", "run")
    middle = "[-3, 0]" if key == "x_m" else "[0, -3]"
    assert f"[deployment] {key}: is searched" in line
    assert f"[region] centre_m = {middle}, radius_m = 20" in line


@pytest.mark.parametrize(
    ("region", "fault"),
    [
        ({"polygon_m": L_SHAPE, "radius_m": 5.0}, "has polygon_m and radius_m"),
        ({"polygon_m": L_SHAPE[:2]}, "polygon_m: has 2 different corners"),
        ({"polygon_m": [1.0, 2.0, 3.0]}, "polygon_m: is 1.0; allowed: a list of 2 numbers"),
        ({"radius_m": "sensor"}, "radius_m: is 'sensor'; allowed: a number, or \"gate\""),
        ({"radius_m": 0.0}, "radius_m: is 0.0; allowed: more than 0"),
        ({"stretches": [{"x_m": [3.0, 1.0]}]}, "x_m: is [3.0, 1.0]; allowed: a pair [from, to]"),
        ({"keep_out": [[[0.0, 0.0], [2.0, 2.0], [2.0, 0.0], [0.0, 2.0]]]}, "keep_out: sides 1 and 3 cross"),
    ],
)
def test_a_region_that_cannot_be_used_is_one_line(tmp_path, capsys, region, fault):
    scene = write_scene(tmp_path, {"region": region})
    assert fault in refused(capsys, tmp_path, "optimise", scene, "--out", "run")


def test_searching_x_in_any_interval_that_holds_the_optimum_finds_the_same_place(tmp_path, capsys):
    """One car stands behind two others, which hide it from most places."""
    rows = [
        [frame, number, "car", x, y, 4.4, 1.8, 1.5, 0.0, 2.0 * frame]
        for frame in range(3)
        for number, (x, y) in enumerate([(0.5, 7.0), (-5.0, 4.0), (6.0, 4.0)])
    ]
    write_table(tmp_path / "traffic.csv", rows)
    changes = {"traffic": {"frames": 1, "holdout": 0.0}, "search": {"particles": 10, "iterations": 20}}
    found = []
    for number, interval in enumerate([[-12.0, 4.0], [-4.0, 14.0], [-2.0, 2.0]]):
        scene = write_scene(tmp_path, {**REGION, **changes, "deployment": {"height_m": 3.0, "x_m": interval}})
        code, out, err = cli(capsys, "optimise", scene, "--out", tmp_path / f"run{number}", "--json")
        assert code == 0, err
        found.append(json.loads(out))
        assert found[-1]["region"].items() >= {**REGION["region"], "polygon_m": None, "stretches": []}.items()
        assert found[-1]["baseline"] == found[0]["baseline"]
    places = [result["deployment"]["x_m"] for result in found]
    assert max(places) - min(places) < 0.5  # the top is ragged
    assert -1.5 < places[0] < 1.5


def test_a_detection_where_nothing_counts_is_no_false_alarm():
    road = map_of(RoadSettings(setback_m=-2.0, lanes=2, lane_width_m=4.0))
    square = [(-1.0, 0.0), (1.0, 0.0), (1.0, 2.0), (-1.0, 2.0)]
    region = Region((0.0, 0.0), 20.0, stretches=[((-20.0, 20.0), [7])], keep_out=[square], road=road)
    places = [one_vehicle("car", (0.0, 1.0)), one_vehicle("car", (5.0, 1.0))]
    assert [bool(region_of_alarms(region).holds(one)[0]) for one in places] == [False, True]
