"""Where the mast stands: right, left, in a median, on a gantry, beside roads that drive on either side."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest

from blender_lidar.errors import InputError
from blender_lidar.road.settings import RoadSettings, map_of
from blender_lidar.scene.deployment import SearchSpace
from blender_lidar.scene.mounting import mast_at
from blender_lidar.scene.scenario import load_scenario
from blender_lidar.scene.site import prepare
from blender_lidar.scoring.evaluation import Evaluator
from tests.scene_texts import refusal
from tests.small_scene import HEADER, done, place_of, without_charts, write_scene, write_table

TWO_WAY = {"setback_m": 2.0, "lanes": 2, "lane_width_m": 3.5, "carriageways": 2, "median_m": 5.0}
EDGE = 2.0 + 4 * 3.5 + 5.0  # y of the left edge
WIDTH = EDGE + 2.0  # and of the line beside it
# Places in whole 1/1024 m, so that a turned site has the same coordinates to the last digit.
DRIVING = (
    (-18.5, 3.75, "car"),
    (-6.25, 7.25, "van"),
    (3.5, 3.75, "truck"),
    (12.0, 16.25, "car"),
    (-11.0, 19.75, "van"),
)
SIZES = {"car": (4.5, 1.75, 1.5), "van": (5.25, 2.0, 2.0), "truck": (11.0, 2.5, 3.5)}


def rows(turned=False, step=0.5):
    """Vehicles of both carriageways in 24 frames; all of it turned by 180 degrees about the middle of the road."""
    table = []
    for frame in range(24):
        for number, (x, y, kind) in enumerate(DRIVING, start=1):
            way = 1.0 if y < 0.5 * WIDTH else -1.0
            x_m, heading = x + way * step * frame, 0.0 if way > 0.0 else 180.0
            place = (-x_m, WIDTH - y, (heading + 180.0) % 360.0) if turned else (x_m, y, heading)
            table.append([frame, number, kind, *place[:2], *SIZES[kind], place[2], 0.1 * frame])
    return table


def scene(folder, turned=False, **changes):
    folder.mkdir(parents=True, exist_ok=True)
    write_table(folder / "traffic.csv", rows(turned), HEADER)
    tables = {
        "traffic": {"frames": 6, "holdout": 0.0},
        "road": TWO_WAY,
        "region": {"centre_m": [0.0, 0.5 * WIDTH], "radius_m": 30.0},
        "sensor": {"range_gate_m": 40.0},
    }
    for table, own in changes.items():
        tables[table] = {**tables.get(table, {}), **own}
    return write_scene(folder, tables)


def site(folder, turned=False, **changes):
    return prepare(load_scenario(scene(folder, turned, **changes)))


def points_of(site, mounting):
    scored = Evaluator(site.search, site.observation, site.scoring).by_vehicle([(mounting,)])
    return [one.seen.points[0].tolist() for one in scored]


@pytest.mark.parametrize(
    ("side", "opposite"), [("right", {"side": "left"}), ("median", {"side": "median", "facing_deg": 270.0})]
)
def test_a_site_turned_by_180_degrees_gives_every_vehicle_the_same_points(side, opposite, tmp_path):
    one = site(tmp_path / "one", deployment={"side": side})
    other = site(tmp_path / "other", turned=True, deployment=opposite)
    there = one.scenario.lidar.deployment.spaces[0].layout([4.0])[0]
    turned = other.scenario.lidar.deployment.spaces[0].layout([4.0])[0]
    expected = points_of(one, there)
    assert sum(map(sum, expected)) > 500
    assert points_of(other, turned) == expected


def test_both_carriageways_count_and_drive_opposite_ways():
    for drives_on, against in (("right", [False, False, True, True]), ("left", [True, True, False, False])):
        road = map_of(RoadSettings(drives_on=drives_on, **TWO_WAY))
        np.testing.assert_array_equal(road.against, against)
        found = road.locate(np.array([[0.0, 3.0], [0.0, 9.5], [0.0, 11.0], [0.0, 15.0]]))
        np.testing.assert_array_equal(found.lane >= 0, [True, False, False, True])
        ways = [math.pi if back else 0.0 for back in against]
        np.testing.assert_allclose(np.abs(found.heading_rad[[0, 3]]), [ways[0], ways[3]], atol=1e-12)


@pytest.mark.parametrize(
    ("road", "side", "y_m", "facing_deg"),
    [
        ({}, "right", 0.0, 90.0),
        ({}, None, 0.0, 90.0),
        ({"median_m": 0.0}, "left", 18.0, 270.0),
        ({"drives_on": "left", "setback_m": 0.0, "lanes": 3, "lane_width_m": 3.7, "median_m": 0.0}, None, 22.2, 270.0),
        ({}, "left", WIDTH, 270.0),
        ({}, "median", 11.5, 90.0),
        ({}, "gantry", 5.5, 90.0),
        ({"drives_on": "left"}, None, WIDTH, 270.0),
        ({"drives_on": "left"}, "gantry", 17.5, 90.0),
        ({"drives_on": "left", "carriageways": 1, "median_m": None}, None, 11.0, 270.0),
    ],
)
def test_each_side_has_its_place_and_faces_the_road(road, side, y_m, facing_deg, tmp_path):
    deployment = {} if side is None else {"side": side}
    if side == "gantry":
        deployment["height_m"] = [5.5, 8.0]
    scenario = load_scenario(write_scene(tmp_path, {"road": {**TWO_WAY, **road}, "deployment": deployment}))
    (place,) = scenario.lidar.deployment.places
    mast = place.mounting([6.0]).mast
    assert mast.foot_m[1] == pytest.approx(y_m)
    assert math.degrees(mast.facing_rad) == pytest.approx(facing_deg)
    assert scenario.lidar.baseline.mast == mast
    assert (
        load_scenario(write_scene(tmp_path, scenario.with_whole_paths())).lidar.deployment == scenario.lidar.deployment
    )


@pytest.mark.parametrize(
    ("road", "y_m", "facing_deg"),
    [
        ({"drives_on": "left"}, -1.0, 90.0),
        ({"drives_on": "left"}, WIDTH, 270.0),
        ({}, WIDTH, 270.0),
        ({}, 11.5, 90.0),
        ({"carriageways": 1, "median_m": None}, 40.0, 90.0),  # as scenes of one carriageway always had it
    ],
)
@pytest.mark.parametrize("by", ["y_m", "poles"])
def test_a_mast_whose_place_alone_is_given_faces_the_road(by, road, y_m, facing_deg, tmp_path):
    if by == "poles":
        across = WIDTH - y_m  # on the other side of the road, so that each pole is seen to face by its own place
        (tmp_path / "poles.csv").write_text(f"name,x_m,y_m,facing_deg\nown,0,{across},45\nroad,10,{y_m},\n")
    tables = {"road": {**TWO_WAY, **road}, "region": {"centre_m": [0.0, 0.5 * WIDTH], "radius_m": 30.0}}
    tables["deployment"] = {"poles": "poles.csv"} if by == "poles" else {"y_m": y_m}
    scenario = load_scenario(write_scene(tmp_path, tables))
    masts = [
        place.mounting([low for low, _ in place.bounds.values()]).mast for place in scenario.lidar.deployment.places
    ]
    facing = [math.degrees(mast.facing_rad) for mast in masts]
    np.testing.assert_allclose(facing, [facing_deg] if by == "y_m" else [45.0, facing_deg])
    again = load_scenario(write_scene(tmp_path, scenario.with_whole_paths()))
    assert again.lidar.deployment == scenario.lidar.deployment
    assert again.lidar.baseline == scenario.lidar.baseline
    by_hand = math.degrees(scenario.lidar.mounting({"y_m": y_m}).mast.facing_rad)
    assert by_hand == pytest.approx(facing_deg), "as one that options give"


def test_the_axes_of_a_mast_are_square_and_plumb_on_any_slope():
    for slope in ({}, {"grade_percent": 6.0}, {"grade_percent": -4.0, "cross_fall_percent": 5.0}):
        road = map_of(RoadSettings(**slope))
        for facing in (0.0, 90.0, 225.0):
            axes = mast_at(road, 1.0, -2.0, math.radians(facing)).T_site_mast.rotation
            np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-12)
            assert np.linalg.det(axes) == pytest.approx(1.0)
            np.testing.assert_allclose(axes[2], road.up, atol=1e-12)
            assert math.degrees(math.atan2(*axes[1, 1::-1])) % 360.0 == pytest.approx(facing, abs=0.2)


def test_on_a_gantry_in_a_fall_heights_count_from_the_road(tmp_path):
    stand = {"side": "gantry", "height_m": [6.0, 9.0]}
    gantry = site(tmp_path, road={"crown_percent": 4.0}, deployment=stand)
    (mounting,) = gantry.scenario.lidar.deployment.spaces[0].layout([6.0])
    assert mounting.pose.height_m == pytest.approx(6.0 + 0.04 * 3.5)


def test_a_mast_beside_the_lanes_of_a_gantry_scene_needs_no_clearance(tmp_path):
    gantry = site(tmp_path, deployment={"side": "gantry", "height_m": [5.0, 7.0]})
    beside, over = (gantry.scenario.lidar.mounting({"y_m": y_m, "height_m": 3.0}) for y_m in (0.0, 7.0))
    assert prepare(gantry.scenario, [beside]).scenario is gantry.scenario
    with pytest.raises(InputError, match="hangs 3 m over the lanes"):
        prepare(gantry.scenario, [over])


def test_two_places_may_search_the_same_coordinates():
    one, other = (
        place_of({"y_m": 0.0, "height_m": 2.0}, {"x_m": ends, "yaw_deg": (0.0, 360.0)}) for ends in ((0, 1), (5, 9))
    )
    space = SearchSpace((one, other))
    assert space.variables == ("x_m", "yaw_deg") * 2
    assert space.lower == (0, 0.0, 5, 0.0)
    assert space.upper == (1, 360.0, 9, 360.0)
    assert space.periodic == (False, True, False, True)
    assert [mounting.xy[0] for mounting in space.layout([0.5, 10.0, 6.0, 20.0])] == [0.5, 6.0]


def test_a_vehicle_far_from_the_lower_end_of_a_searched_stretch_is_named(tmp_path):
    path = scene(tmp_path, deployment={"x_m": [-90.0, 30.0], "y_m": 0.5})
    beside = [[*row[:4], 1.0, *row[5:]] if row[1] == 4 else row for row in rows()]
    write_table(tmp_path / "traffic.csv", beside, HEADER)
    scenario = load_scenario(path, {("traffic", "accept"): (["carriageway"], "--accept")})
    with pytest.raises(InputError, match=r"stands inside vehicle .* in front of the mast: move it beside them"):
        prepare(scenario)


def test_a_gantry_keeps_its_clearance_and_any_other_mast_over_a_lane_is_refused(tmp_path):
    gantry = site(tmp_path / "gantry", deployment={"side": "gantry", "height_m": [5.0, 7.0]})
    assert sum(map(sum, points_of(gantry, gantry.scenario.lidar.deployment.spaces[0].layout([6.0])[0]))) > 500
    assert gantry.scenario.lidar.baseline.height_m == 5.0
    with pytest.raises(
        InputError, match=r"hangs 4.5 m over the lanes; allowed: 5 m or more, as \[deployment\] clearance_m says"
    ):
        site(tmp_path / "low", deployment={"side": "gantry", "height_m": [4.5, 7.0]})
    with pytest.raises(InputError, match=r"y 5.5 m stands on the carriageway; allowed: off the lanes, such as x 0"):
        site(tmp_path / "lane", deployment={"y_m": 5.5})
    low = gantry.scenario.lidar.mounting({"height_m": 3.0})
    with pytest.raises(InputError, match="hangs 3 m over the lanes"):
        prepare(gantry.scenario, [low])


@pytest.mark.parametrize(
    ("median_m", "said"), [(5.0, "in the middle of the median, y 11.5 m"), (0.0, "lane line, y 9 m")]
)
def test_a_barrier_is_tried_between_the_carriageways_and_said_to_be_there(median_m, said, tmp_path):
    pytest.importorskip("scipy")
    from blender_lidar.studies.variations import ablations

    two_way = site(tmp_path, road={"median_m": median_m})
    assert ablations(two_way, 1)[0].value.endswith(said)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[road]\nmedian_m = 3.0\n", "median_m: is given for one carriageway"),
        (
            '[deployment]\nside = "median"\n',
            "is a median, but [road] has none; allowed: with [road] carriageways = 2 and median_m above 0",
        ),
        (
            '[deployment]\nside = "left"\ny_m = -3.0\n',
            "lies to the right of the road; allowed: to the left of the road, as side says",
        ),
        ('[deployment]\nside = "kerb"\n', "allowed: right, left, median, gantry"),
    ],
)
def test_sides_that_contradict_the_road_are_refused(text, words, tmp_path):
    assert words in refusal(tmp_path, '[traffic]\npath = "traffic.csv"\n' + text)


@pytest.mark.parametrize(
    ("deployment", "said", "sheet"),
    [
        (
            {"side": "left"},
            "tilted 15.0° down towards the middle of the region Detectable",
            "faces -y, right of the direction of travel on the r",
        ),
        (
            {"side": "median"},
            "tilted 15.0° down to the left of the nearest lane's traffic Detectable",
            "in the median, 2.50 m from the edge of the nearest lane",
        ),
        (
            {"side": "gantry", "height_m": [5.0, 8.0]},
            "tilted 15.0° down towards the middle of the region Detectable",
            "over a lane, 0.00 m from its ",
        ),
        (
            {"facing_deg": 45.0},
            "tilted 15.0° down towards the road Detectable",
            "45 deg counter-clockwise of it",
        ),
    ],
)
def test_words_of_a_mounting_are_true_on_every_side(deployment, said, sheet, tmp_path, capsys, monkeypatch):
    without_charts(monkeypatch)
    path, out = scene(tmp_path, deployment=deployment), tmp_path / "run"
    message, _ = done(capsys, "evaluate", path, "--height", 6, "--tilt-x", 15, "--out", out)
    assert said in " ".join(message.split()), message
    assert sheet in " ".join((out / "installation.txt").read_text(encoding="utf-8").split())
    direct = [word for key, value in deployment.items() if key == "facing_deg" for word in ("--facing", value)]
    plain = scene(tmp_path, deployment={key: value for key, value in deployment.items() if key != "facing_deg"})
    words = ("evaluate", plain, "--height", 6, "--tilt-x", 15, *direct, "--json", "--out", tmp_path / "other")
    result = json.loads(done(capsys, *words)[0])
    assert result["deployment"] == json.loads((out / "result.json").read_text(encoding="utf-8"))["deployment"]


TWO_WAYS = {"carriageways": 2, "median_m": 4.0}


@pytest.mark.parametrize("baseline", [{"y_m": 52.0}, {"facing_deg": 45.0}])
def test_a_mast_at_the_place_that_a_scene_fixes_faces_the_road_wherever_the_baseline_looks(baseline, tmp_path):
    tables = {"road": TWO_WAYS, "deployment": {"y_m": -1.0}, "baseline": baseline}
    lidar = load_scenario(write_scene(tmp_path, tables)).lidar
    mounting = lidar.mounting({"height_m": 3.0})
    assert (mounting.xy[1], mounting.as_table()["facing_deg"]) == (-1.0, 90.0)
    assert lidar.mounting({"y_m": 80.0}).as_table()["facing_deg"] == 270.0


def test_a_mounting_on_the_one_pole_of_a_scene_faces_as_the_pole_does(tmp_path):
    (tmp_path / "poles.csv").write_text("name,x_m,y_m,facing_deg\na,0,-2,30\n", encoding="utf-8")
    circle = {"centre_m": [0.0, 5.0], "radius_m": 20.0}
    tables = {"road": TWO_WAYS, "deployment": {"poles": "poles.csv"}, "region": circle}
    lidar = load_scenario(write_scene(tmp_path, tables)).lidar
    assert lidar.mounting({"height_m": 3.0}).as_table()["facing_deg"] == pytest.approx(30.0)
    assert lidar.mounting({"x_m": 4.0, "y_m": -2.0}).as_table()["facing_deg"] == 90.0
