"""Roads from maps in scenes: where masts face, who counts, where vehicles come from, and what does not fit."""

from __future__ import annotations

import gzip
import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from blender_lidar.detection.judge import judge_detectors, site_judge, watched
from blender_lidar.detection.pillars import PillarsDetector
from blender_lidar.detection.scores import recall
from blender_lidar.detection.stored import read_dataset
from blender_lidar.errors import InputError
from blender_lidar.report.detection import detection_table
from blender_lidar.report.text import table_text
from blender_lidar.road.driven import driven_area
from blender_lidar.road.road_map import polygon_holds
from blender_lidar.run.quantities import group_shares
from blender_lidar.scene.scenario import scenario_of
from blender_lidar.scene.site import prepare
from blender_lidar.scoring.evaluation import Evaluator
from blender_lidar.toml_table import to_toml
from blender_lidar.traffic.boxes import detected_boxes
from tests.small_scene import done

pytest.importorskip("sumolib", reason="sumolib is not installed")

SCENES = Path(__file__).parents[1] / "scenes"
CROSSING = {
    "traffic": {
        "path": str(SCENES / "crossing_sample.xml.gz"),
        "format": "sumo",
        "vehicle_types": str(SCENES / "crossing_types.xml"),
        "frames": 4,
        "block_s": 90.0,
    },
    "road": {"net": str(SCENES / "crossing.net.xml.gz")},
    "region": {"junction": "middle", "approach_m": 40.0},
    "sensor": {"name": "RS-16", "range_gate_m": 80.0},
    "deployment": {"x_m": 19.0, "y_m": 19.0},
    "model": {"workers": 1},
}


def crossing(**changes):
    """The crossing's settings, some tables changed key by key."""
    return {**CROSSING, **{table: {**CROSSING.get(table, {}), **keys} for table, keys in changes.items()}}


@pytest.fixture(scope="module")
def site():
    return prepare(scenario_of(CROSSING))


def test_a_mast_on_a_map_faces_the_middle_of_the_region_from_where_it_stands(site):
    scenario = site.scenario
    (place,) = scenario.lidar.deployment.places
    assert math.degrees(place.mounting([3.0, 10.0]).mast.facing_rad) == pytest.approx(-135.0)
    assert scenario.lidar.mounting({"x_m": -19.0, "y_m": 19.0}).as_table()["facing_deg"] == pytest.approx(-45.0)


def test_the_region_of_a_junction_is_its_area_and_the_last_metres_of_its_approaches(site):
    outlines = site.region.outlines
    for frame in (*site.search, *site.holdout):
        xy = frame.centre_m[:, :2]
        inside = np.any([polygon_holds(outline, xy) for outline in outlines], axis=0)
        np.testing.assert_array_equal(frame.counted, inside)
    east = [outline for outline in outlines if outline[:, 0].min() > 20.0]
    assert east
    assert max(np.ptp(outline[:, 0]) for outline in east) == pytest.approx(40.0, abs=0.01)


def test_every_vehicle_that_counts_has_its_approach_and_most_their_movement(site):
    approach, turn, x, y = [], [], [], []
    for frame in (*site.search, *site.holdout):
        approach += frame.approach[frame.counted].tolist()
        turn += frame.movement[frame.counted].tolist()
        x += frame.centre_m[frame.counted, 0].tolist()
        y += frame.centre_m[frame.counted, 1].tolist()
    assert set(approach) == {"from_north", "from_east", "from_south", "from_west"}
    assert np.mean(np.array(turn) != "") > 0.95
    assert {"left", "straight", "right"} <= set(turn)
    x, y, approach = np.array(x), np.array(y), np.array(approach)
    assert (approach[x > 30.0] == "from_east").all()
    assert (approach[y < -30.0] == "from_south").all()


def test_a_scene_in_utm_scores_as_the_same_scene_at_the_origin(tmp_path):
    away = np.array([691_000.0, 5_336_000.5])
    table, moved = tmp_path / "origin.csv", tmp_path / "utm.csv"
    rng = np.random.default_rng(7)
    starts = zip(rng.uniform(-30, 30, 6).tolist(), (4.0 * np.arange(6) + 6.0).tolist(), strict=True)
    rows = [
        (frame, number, round(x * 1024) / 1024 + (2.0 * frame), y)
        for number, (x, y) in enumerate(starts)
        for frame in range(12)
    ]
    for path, (dx, dy) in ((table, (0.0, 0.0)), (moved, away.tolist())):
        lines = [f"{frame},{number},car,{x + dx!r},{y + dy!r},4.5,1.8,1.5,0.0" for frame, number, x, y in rows]
        header = "frame,vehicle_id,class,x_m,y_m,length_m,width_m,height_m,heading_deg"
        path.write_text("\n".join([header, *lines]))
    totals = []
    for path, origin in ((table, (0.0, 0.0)), (moved, tuple(away.tolist()))):
        settings = {
            "traffic": {"path": str(path), "format": "table", "frames": 3, "holdout": 0.0, "time_step_s": 0.5},
            "road": {"driven": True, "origin_m": list(origin)},
            "region": {"centre_m": [0.0, 15.0], "radius_m": 40.0},
            "sensor": {"name": "RS-16", "range_gate_m": 60.0},
            "deployment": {"x_m": 0.0, "y_m": 0.0},
            "model": {"workers": 1},
        }
        one = prepare(scenario_of(settings))
        layout = (one.scenario.lidar.mounting({"height_m": 3.0, "tilt_x_deg": 10.0}),)
        totals.append(Evaluator(one.search, one.observation, one.scoring).totals([layout]).objective)
    np.testing.assert_array_equal(*totals)


def test_a_driven_area_holds_each_footprint_and_little_else():
    rng = np.random.default_rng(1)
    centre, heading = rng.uniform(-20.0, 20.0, (9, 2)), rng.uniform(-4.0, 4.0, 9)
    size = np.tile([4.5, 1.8], (9, 1))
    area = driven_area(centre, size, heading)
    axes = np.stack([np.cos(heading), np.sin(heading)], axis=1)
    place = rng.uniform(-25.0, 25.0, (20_000, 2))
    off = place[:, None] - centre
    along = np.abs((off * axes).sum(axis=-1))
    aside = np.abs(off[..., 1] * axes[:, 0] - off[..., 0] * axes[:, 1])
    inside = ((along < 2.25 - 0.36) & (aside < 0.9 - 0.36)).any(axis=1)
    beyond = ~((along < 2.25 + 0.36) & (aside < 0.9 + 0.36)).any(axis=1)
    assert area.on(place[inside]).all()
    assert not area.on(place[beyond]).any()
    covered = np.any([polygon_holds(outline, place) for outline in area.area()], axis=0)
    np.testing.assert_array_equal(covered, area.on(place))


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"region": {"junction": "midle"}}, "did you mean 'middle'"),
        ({"region": {"junction": None, "approaches": ["to_east"]}}, "unknown approach 'to_east'"),
        ({"region": {"stretches": [{"x_m": [0.0, 9.0]}]}}, "allowed: a circle, a polygon"),
        ({"road": {"lanes": 3}}, "allowed: one map, or the keys of a straight road"),
        ({"deployment": {"side": "left"}}, "allowed on a map: gantry"),
        ({"deployment": {"y_m": None}}, "does not say where the mast stands"),
        ({"deployment": {"x_m": 7.0, "y_m": 40.0}}, "stands on the carriageway"),
        ({"world": {"clutter": 1.0}}, "allowed on a map: boxes"),
        ({"traffic": {"origin_m": [4000.0, 100.0]}}, "check [traffic] origin_m"),
    ],
)
def test_what_does_not_fit_a_map_is_refused_in_one_line(changes, told):
    with pytest.raises(InputError) as raised:
        prepare(scenario_of(crossing(**changes)))
    assert told in str(raised.value)
    assert "\n" not in str(raised.value)


def test_the_content_of_the_map_is_part_of_a_runs_identity(tmp_path, site):
    net = tmp_path / "crossing.net.xml"
    net.write_bytes(gzip.decompress((SCENES / "crossing.net.xml.gz").read_bytes()).replace(b"13.90", b"13.80"))
    other = prepare(scenario_of(crossing(road={"net": str(net)})))
    assert other.identity["[road] net"] != site.identity["[road] net"]


def test_a_detector_is_judged_by_approach_and_the_sheet_tells_each_approachs_share(site):
    """One that finds all vehicles from the west and no others."""
    found = []
    for frame in site.holdout:
        vehicles = frame.select(frame.approach == "from_west")
        kinds, sure = vehicles.kind, np.full(len(vehicles), 0.9)
        found.append(detected_boxes(vehicles.centre_m, vehicles.size_m, vehicles.heading_rad, kinds, sure))
    judge = site_judge(site)
    result = judge.result("ours", {"given": judge.judged(found, (19.0, 19.0))}, {})["mountings"]["given"]
    recall = {name: one["recall_0.3"] for name, one in result["by_approach"].items()}
    assert recall == {"from_west": 1.0, "from_east": 0.0, "from_north": 0.0, "from_south": 0.0}
    known = sum(int(frame.counted[frame.approach != ""].sum()) for frame in site.holdout)
    assert sum(one["vehicles"] for one in result["by_approach"].values()) == known
    for one in result["by_approach"].values():
        assert one["recall_0.3_interval_90"] is None or one["recall_0.3_interval_90"][0] <= one["recall_0.3"]
    text = table_text(detection_table({"frames": 3, "mountings": {"mounting": result}}))
    assert "from_west     vehicles" in text
    groups = [
        {"by": "approach", "name": name, "after": share, "after_interval_90": ends, "distinct_vehicles": vehicles}
        | {"boxes": vehicles}
        for name, share, ends, vehicles in (
            ("from_east", 0.56, [0.44, 0.69], 30),
            ("from_west", 0.97, None, 10),
            ("from_north", 0.5, None, 9),  # too few to be told
        )
    ]
    shares = group_shares({"groups": groups, "holdout": {}}, "approach")
    assert {name: str(one) for name, one in shares.items()} == {"from_east": "56 % (44 to 69)", "from_west": "97 %"}


def test_detectors_look_where_vehicles_count_and_find_some(site):
    low, high = watched(site)
    for frame in (*site.search, *site.holdout):
        xy = frame.centre_m[frame.counted, :2]
        assert ((xy >= low) & (xy <= high)).all()
    mounting = site.scenario.lidar.mounting({"height_m": 5.0, "tilt_x_deg": 12.0})
    detector = PillarsDetector("RS-16", mounting.pose, low, high)
    judged = judge_detectors(replace(site, holdout=site.holdout[:2]), (mounting,), [detector])["given"]
    assert sum(map(len, judged.boxes)) >= 10
    assert recall(judged.matches[0], 0.1)[0] > 0.25


def test_a_data_set_of_a_map_judges_a_detector_without_the_map(tmp_path, capsys):
    keep_out = [[[20.0, 0.0], [40.0, 0.0], [40.0, 4.0], [20.0, 4.0]]]
    settings = crossing(region={"keep_out": keep_out}, deployment={"height_m": [4.0, 6.0], "tilt_x_deg": 12.0})
    scene = tmp_path / "scene.toml"
    scene.write_text(to_toml(settings))
    done(capsys, "dataset", scene, "--mountings", 2, "--scans", 8, "--out", tmp_path / "set")
    stored, found = read_dataset(tmp_path / "set"), prepare(scenario_of(settings))
    for frame in (*found.search, *found.holdout):
        np.testing.assert_array_equal(stored.region.holds(frame), found.region.holds(frame))
    for pose, row in zip(stored.poses, range(len(stored.poses)), strict=True):
        table = {key: float(stored.scans[key][row]) for key in ("x_m", "y_m", "height_m", "tilt_x_deg")}
        np.testing.assert_allclose(pose.rotation, found.scenario.lidar.mounting(table).pose.rotation, atol=1e-12)
        np.testing.assert_allclose(pose.position, found.scenario.lidar.mounting(table).pose.position, atol=1e-12)
    out, _ = done(capsys, "detect", tmp_path / "set", "--json")
    (of_all,) = json.loads(out)["mountings"].values()
    assert of_all["recall_0.1"] > 0.2
