"""Coverage under other traffic: lorries by lane, and what a run says of them."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from blender_lidar.casting import is_available
from blender_lidar.run.answer import fleet_text, lorries, next_metre, other_traffic_statements
from blender_lidar.run.as_hung import FEW_ERRORS, errors_of_frames
from blender_lidar.run.what_if import (
    LORRY_SHARES,
    OTHER_HEIGHTS,
    mixes,
    other_traffic,
    with_lorries,
    with_lorries_in_place,
    with_other_heights,
)
from blender_lidar.scene.deployment import Installer
from blender_lidar.scene.installation import installed_layout
from blender_lidar.scene.scenario import load_scenario
from blender_lidar.scene.site import prepare
from blender_lidar.scoring.evaluation import Evaluator
from blender_lidar.statistics import drawn_share_interval_90, share_interval_90
from blender_lidar.studies.candidates import on_other_side
from blender_lidar.traffic.boxes import Boxes
from blender_lidar.traffic.fleet import BUS, CAR, SIZE_M, TRUCK, VAN, lorries_in_place, with_variety
from blender_lidar.traffic.vehicles import overlapping_pairs
from tests.small_scene import CASTER, HEADER, MAPPED, done, traffic_rows, without_charts, write_scene, write_table
from tests.test_heights import SLOPE
from tests.test_heights import scene as sloping_scene

FAST = "raster" if is_available("raster") else CASTER


@pytest.fixture(scope="module")
def site():
    """The shipped road of six lanes."""
    changes = {("model", "caster"): FAST, ("traffic", "frames"): 4, ("model", "workers"): 1}
    changes["deployment", "installer"] = False
    return prepare(load_scenario("i80", {key: (value, "x") for key, value in changes.items()}))


@pytest.fixture(scope="module")
def planned(site):
    """A mounting there."""
    return (site.scenario.lidar.mounting({"height_m": 4.5, "tilt_x_deg": 23.0}),)


@pytest.fixture(scope="module")
def seen(site, planned):
    """What it sees of other traffic."""
    return other_traffic(site, planned)


def kinds_by_lane(site):
    """Number of vehicles and of lorries in each lane of the road map, (lanes, 2), over the searched frames."""
    road, counts = site.scenario.road_map, np.zeros((len(site.scenario.road_map), 2))
    for frame in site.search:
        lane = road.locate(frame.centre_m).lane
        large = np.isin(frame.class_index, (TRUCK, BUS))
        for number in range(len(road)):
            counts[number] += [(lane == number).sum(), (large & (lane == number)).sum()]
    return counts


@pytest.mark.parametrize("xy", [(0.0, 0.0), (0.0, 26.0)])
@pytest.mark.parametrize("near", [1, 2, None])
def test_lorries_drive_in_the_lanes_nearest_to_the_mast_alone(site, xy, near):
    before, after = kinds_by_lane(site), kinds_by_lane(with_lorries(site, xy, near, 1.0, 1))
    lanes = np.argsort(np.abs(site.scenario.road_map.offset_m - xy[1]))
    chosen = lanes[:near]
    assert after[chosen, 1].sum() >= 0.97 * after[chosen, 0].sum()  # but for motorcycles
    others = np.setdiff1d(lanes, chosen)
    np.testing.assert_array_equal(after[others], before[others])


def test_a_share_of_lorries_is_that_share_of_the_lane_and_has_those_of_a_smaller_one(site):
    found = {}
    for share in (0.0, 0.3, 0.6):
        changed = with_lorries(site, (0.0, 0.0), None, share, 3)
        vehicles, large = kinds_by_lane(changed).sum(axis=0)
        found[share] = {
            (frame.frame, int(one)) for frame in changed.search for one in frame.vehicle_id[frame.class_index == TRUCK]
        }
        if share:
            assert large / vehicles == pytest.approx(share, abs=0.08)
    assert len(found[0.3] & found[0.6]) >= 0.8 * len(found[0.3])  # the rest were pushed out of reach


def test_lorries_add_no_vehicle_where_a_lane_is_empty_on_one_side_of_the_mast(tmp_path):
    write_table(tmp_path / "traffic.csv", traffic_rows(vehicles=6))
    site = prepare(load_scenario(write_scene(tmp_path)))
    for near in (1, None):
        for frame in with_lorries(site, (0.0, 0.0), near, 1.0, 1).search:
            recorded = site.recording.at(frame.frame)
            assert set(frame.vehicle_id) <= set(recorded.vehicle_id)


def test_a_queue_is_counted_by_the_vehicles_that_it_was_made_of(site, seen):
    queue = next(mix for mix in seen["mixes"] if mix["what"] == "queue")
    assert queue["distinct_vehicles"] <= len(np.unique(site.recording.vehicle_id))


@pytest.mark.parametrize("changes", [{}, {"tilt_y_deg": 10.0, "yaw_deg": 20.0}])
def test_the_other_side_has_the_mirror_image_of_a_mounting(site, changes):
    mounting = site.scenario.lidar.mounting({"height_m": 4.5, "tilt_x_deg": 23.0, **changes})
    mounting = replace(mounting, mast=replace(mounting.mast, facing_rad=1.0))
    other = on_other_side(site.scenario, mounting)
    here, there = (one.pose.to_world(np.eye(3)[1:])[:, :2] for one in (mounting, other))
    np.testing.assert_allclose(there, here * [1.0, -1.0], atol=1e-12)  # the road goes along x
    again = on_other_side(site.scenario, other)
    assert again.xy == pytest.approx(mounting.xy)
    assert again.mast.facing_rad == pytest.approx(1.0)


def test_coverage_of_recorded_traffic_is_that_of_the_frames_and_the_same_again(site, planned, seen):
    found = other_traffic(site, planned)
    assert found == seen
    with Evaluator(site.holdout, site.observation, site.scoring) as evaluator:
        share = evaluator.totals([planned]).detectable_share()[0]
    assert found["frames"] == (3 if FAST == "exact" else len(site.holdout))
    if FAST != "exact":
        assert found["recorded"]["detectable_share"] == pytest.approx(share, abs=1e-9)
    assert [mix["lorries"] for mix in found["mixes"][:9]] == 3 * list(LORRY_SHARES)
    shares = {(mix["lanes"], mix["lorries"]): mix["detectable_share"] for mix in found["mixes"]}
    assert (
        shares[next(mix["lanes"] for mix in found["mixes"] if mix["lanes"]), 1.0]
        < found["recorded"]["detectable_share"] - 0.1
    )
    assert shares["every lane", 1.0] < shares["every lane", 0.1]
    json.dumps(found)


def test_a_road_of_two_lanes_has_its_near_lane_and_both(tmp_path):
    site = prepare(load_scenario(write_scene(tmp_path)))
    assert [mix.lanes for mix in mixes(site, (0.0, 0.0))] == [
        *["the nearest lane"] * 3,
        *["every lane"] * 3,
        *[None] * 4,
    ]


def test_off_the_lanes_of_the_road_map_lorries_are_in_every_lane_alone(tmp_path):
    write_table(tmp_path / "traffic.csv", [[*row[:4], row[4] + 30.0, *row[5:]] for row in traffic_rows()])
    polygon = {"region": {"polygon_m": [[-20.0, 20.0], [20.0, 20.0], [20.0, 60.0], [-20.0, 60.0]]}}
    changes = {"traffic": {"accept": ["carriageway"]}, "sensor": {"range_gate_m": 70.0}}
    scene = write_scene(tmp_path, {**polygon, **changes})
    site = prepare(load_scenario(scene))
    assert {mix.lanes for mix in mixes(site, (0.0, 0.0))} == {"every lane", None}


# --- On a map: lorries where cars stand -------------------------------------------------------------------------------


def cars(*places, length=4.5, width=1.8):
    """One frame of cars at (x, y, heading in degrees)."""
    x, y, heading = np.array(places, dtype=float).T
    count = len(places)
    size = np.tile([length, width, 1.5], (count, 1))
    centre = np.column_stack([x, y, np.full(count, 0.75)])
    kind = np.full(count, CAR, dtype=np.int8)
    return Boxes(0, 0.0, np.arange(count), kind, centre, size, np.radians(heading), np.zeros(count, np.int16))


def fronts(vehicles):
    """Where front bumpers are, (n, 2)."""
    forward = np.stack([np.cos(vehicles.heading_rad), np.sin(vehicles.heading_rad)], axis=1)
    return vehicles.centre_m[:, :2] + 0.5 * vehicles.size_m[:, :1] * forward


def test_a_lorry_in_a_queue_is_as_long_as_its_gap_allows_and_alone_as_long_as_lorries_are():
    queue = cars((0.0, 0.0, 0.0), (-6.5, 0.0, 0.0), (-16.0, 0.0, 0.0))  # gaps of 2 and 5 m
    found = lorries_in_place(queue, queue.vehicle_id)
    np.testing.assert_allclose(found.size_m[:, 0], [5.5, 8.5, SIZE_M[TRUCK][0]])
    np.testing.assert_allclose(found.size_m[:, 1:], [SIZE_M[TRUCK][1:]] * 3)
    np.testing.assert_allclose(found.centre_m[:, 2], 0.5 * SIZE_M[TRUCK][2])
    assert (found.class_index == TRUCK).all()


def test_cars_side_by_side_keep_the_width_that_they_have_no_room_beyond():
    pair = cars((0.0, 0.0, 90.0), (2.0, 0.0, 90.0))
    found = lorries_in_place(pair, pair.vehicle_id)
    assert found.size_m[:, 1].tolist() == [1.8, 1.8]
    assert found.size_m[:, 0].tolist() == [SIZE_M[TRUCK][0]] * 2


@pytest.mark.parametrize("seed", range(5))
def test_lorries_in_place_keep_their_front_bumpers_never_shrink_and_overlap_nobody_whom_they_did_not(seed):
    rng = np.random.default_rng(seed)
    lots = cars(*zip(*rng.uniform(-40.0, 40.0, (2, 80)), rng.uniform(-180.0, 180.0, 80), strict=True))
    chosen = lots.vehicle_id[rng.random(80) < 0.7]
    found = lorries_in_place(lots, chosen)
    np.testing.assert_allclose(fronts(found), fronts(lots), atol=1e-9)
    assert (found.size_m >= lots.size_m - 1e-12).all()
    before, after = (set(map(tuple, overlapping_pairs(one).tolist())) for one in (lots, found))
    assert after <= before
    stays = ~np.isin(lots.vehicle_id, chosen)
    np.testing.assert_array_equal(found.size_m[stays], lots.size_m[stays])
    assert (found.size_m[~stays, 0] > lots.size_m[~stays, 0]).any()


def with_settings(scene, **changes):
    settings = {("model", "caster"): FAST, ("traffic", "frames"): 4, ("model", "workers"): 1}
    settings |= {tuple(key.split("__")): value for key, value in changes.items()}
    return prepare(load_scenario(scene, {key: (value, "x") for key, value in settings.items()}))


@pytest.fixture(scope="module")
def crossing():
    """The shipped intersection."""
    pytest.importorskip("sumolib", reason="sumolib is not installed")
    return with_settings("crossing")


@pytest.fixture(scope="module")
def seen_at_crossing(crossing):
    return other_traffic(crossing, crossing.scenario.baselines)


def driven_scene(folder):
    """Two lanes of vehicles as traffic alone, with no road but where they drove."""
    road = {"road": {"driven": True, **dict.fromkeys(("setback_m", "lanes", "lane_width_m"))}}
    region = {"region": {"centre_m": [0.0, 5.0], "radius_m": 20.0}}
    return write_scene(folder, {**road, **region, "deployment": {"x_m": 0.0, "y_m": -2.0}, "model": {"caster": FAST}})


def test_at_an_intersection_lorries_come_from_each_approach_that_results_are_told_by(crossing, seen_at_crossing):
    approaches = {name for frame in crossing.holdout for name in frame.approach[frame.counted] if name}
    rows = [mix for mix in seen_at_crossing["mixes"] if mix["lorries"] is not None]
    assert {mix["approach"] for mix in rows} == {None, *approaches}
    assert [mix["lorries"] for mix in rows if mix["approach"] is None] == list(LORRY_SHARES)
    assert set(seen_at_crossing["recorded"]["by_approach"]) <= approaches
    json.dumps(seen_at_crossing)


def test_lorries_of_an_approach_are_those_that_come_from_it(crossing):
    name = "from_east"
    changed = with_lorries_in_place(crossing, name, 1.0, 1)
    for before, after in zip(crossing.search, changed.search, strict=True):
        kind = dict(zip(before.vehicle_id.tolist(), before.class_index.tolist(), strict=True))
        became = [
            number
            for number, now in zip(after.vehicle_id.tolist(), after.class_index, strict=True)
            if now != kind.get(number, now)
        ]
        small = np.isin(before.class_index, (CAR, VAN)) & (before.approach == name)
        assert set(became) == set(before.vehicle_id[small].tolist())
        there = np.isin(after.vehicle_id, became)
        assert (after.approach[there] == name).all()


def test_no_box_of_an_intersection_overlaps_another_that_it_did_not_before(crossing):
    changed = with_lorries_in_place(crossing, None, 1.0, 1)
    for before, after in zip(crossing.search, changed.search, strict=True):
        (vehicles, lorries), pairs = (before, after), []
        for one in (vehicles, lorries):
            pairs.append({frozenset(one.vehicle_id[list(pair)].tolist()) for pair in overlapping_pairs(one)})
        assert pairs[1] <= pairs[0]


def test_at_an_intersection_the_approach_whose_lorries_cost_most_is_named(seen_at_crossing):
    rows = {mix["approach"]: mix["detectable_share"] for mix in seen_at_crossing["mixes"] if mix["approach"]}
    told = lorries({"other_traffic": seen_at_crossing})
    start = (
        f"Lorries in place of every car and van of approach {min(rows, key=rows.get)}, each as long as its gap allows: "
    )
    assert told.text.startswith(start)
    assert told.quantities[0].interval_90 is None  # it was chosen on what it is told on


def test_a_driven_area_has_lorries_too(tmp_path):
    site = prepare(load_scenario(driven_scene(tmp_path)))
    found = other_traffic(site, site.scenario.baselines)
    alone = {mix["lanes"]: mix for mix in found["mixes"] if mix["lorries"] == 1.0}
    assert set(alone) == {"approach west", "the whole area"}
    assert alone["the whole area"]["boxes"] > 0
    assert "of approach west, each as long as its gap allows" in lorries({"other_traffic": found}).text
    large = [with_lorries_in_place(site, None, share, 1) for share in (0.3, 0.6)]
    ids = [
        {int(number) for frame in one.search for number in frame.vehicle_id[frame.class_index == TRUCK]}
        for one in large
    ]
    assert ids[0] < ids[1]


def test_lorries_of_a_map_with_heights_stand_on_its_road(tmp_path):
    site = prepare(sloping_scene(tmp_path, SLOPE))
    assert "every lane" in {mix.lanes for mix in mixes(site, (0.0, 0.0))}
    for frame in with_lorries_in_place(site, None, 1.0, 1).search:
        centre, size = frame.centre_m, frame.size_m
        assert (frame.class_index == TRUCK).all()
        assert (size[:, 0] > 4.5).any()
        floor = centre[:, 2] - 0.5 * size[:, 2]
        np.testing.assert_allclose(floor, site.scenario.road_map.surface.height(centre), atol=1e-9)


# --- Draws, installations and heights ---------------------------------------------------------------------------------


@pytest.mark.parametrize(("of_draws", "of_both"), [(0.05, 0.05), (0.0, 0.1)])
def test_the_interval_of_traffic_that_is_drawn_holds_the_truth_in_nine_of_ten_repetitions(of_draws, of_both):
    rng, blocks, draws, boxes, repeats, truth = np.random.default_rng(1), 12, 3, 30, 300, 0.6
    block, draw, _ = np.indices((blocks, draws, boxes)).reshape(3, -1)
    held = []
    for _ in range(repeats):
        parts = rng.normal(0.0, 0.1, (blocks, 1)), rng.normal(0.0, of_draws, (1, draws))
        share = truth + sum(parts) + rng.normal(0.0, of_both, (blocks, draws))
        hits = (rng.random((blocks, draws, boxes)) < share[..., None]).reshape(-1).astype(float)
        low, high = drawn_share_interval_90(hits, np.arange(len(hits)), block, draw, 1)
        held.append(low <= truth <= high)
    assert 0.86 <= np.mean(held) <= 0.97


def test_the_interval_of_one_draw_is_that_of_the_boxes_and_several_draws_make_it_no_narrower():
    rng = np.random.default_rng(2)
    block, vehicle = np.repeat(np.arange(8), 20), np.arange(160)
    hits = (rng.random(160) < 0.5).astype(float)
    plain = share_interval_90(hits, vehicle, block, 1)
    assert drawn_share_interval_90(hits, vehicle, block, np.zeros(160, int), 1) == plain
    low, high = drawn_share_interval_90(hits, vehicle, block, vehicle % 4, 1)
    assert low <= plain[0] < plain[1] <= high


def test_what_is_drawn_is_drawn_several_times_and_what_is_not_once(seen):
    draws = {(mix["what"], mix["lorries"]): mix["draws"] for mix in seen["mixes"]}
    once = {mix for mix, count in draws.items() if count == 1}
    assert {what for what, _ in once} >= {"rush hour", "queue"}
    assert {lorries for _, lorries in once} == {None, 1.0}
    assert set(draws.values()) == {1, 2}


def test_each_frame_is_seen_under_installation_errors_of_its_own(site, planned):
    lidar = site.scenario.lidar
    shaken = replace(lidar.deployment, installer=Installer(tilt_deg=4.0))
    scenario = site.scenario.with_lidars(replace(lidar, deployment=shaken))
    frames = [frame for frame in site.holdout if frame.counted.any()]
    errors, seen = errors_of_frames(scenario, len(frames)), []
    for frame, of_frame in zip(frames, errors, strict=True):
        evaluator = Evaluator([frame], site.observation, site.scoring)
        hits = [evaluator.by_box([installed_layout(planned, error)])[1][0] for error in of_frame]
        seen.append(np.mean(hits, axis=0))
    found = other_traffic(replace(site, scenario=scenario), planned)
    assert len(frames) == found["frames"]
    assert len(errors) * errors.shape[1] >= FEW_ERRORS
    assert found["recorded"]["detectable_share"] == pytest.approx(np.concatenate(seen).mean())
    assert found["recorded"]["interval_90"] is not None


def test_other_heights_are_those_of_variety_where_a_class_has_one_height(site):
    whole = with_variety(site.recording, 1.0, 3)
    for frame in with_other_heights(site, 3).search:
        expected = whole.at(frame.frame)
        rows = np.searchsorted(expected.vehicle_id, frame.vehicle_id)
        np.testing.assert_array_equal(frame.size_m, expected.size_m[rows])
    assert OTHER_HEIGHTS in [mix.what for mix in mixes(site, (0.0, 0.0))]


def test_heights_that_are_each_vehicles_own_or_vary_already_are_not_drawn_again(tmp_path):
    rows = [[*row[:7], row[7] + 0.001 * row[1], *row[8:]] for row in traffic_rows()]
    (tmp_path / "own").mkdir()
    write_table(tmp_path / "own" / "traffic.csv", rows)
    for folder, changes in (("own", {}), ("varied", {"world": {"variety": 0.5}})):
        site = prepare(load_scenario(write_scene(tmp_path / folder, changes)))
        assert OTHER_HEIGHTS not in [mix.what for mix in mixes(site, (0.0, 0.0))]


# --- What the first lines say -----------------------------------------------------------------------------------------


def cars_alone(folder, columns=HEADER):
    """A table without lorries, and some of its columns."""
    rows = [[*row[:2], "car", *row[3:5], 4.3, 1.8, 1.5, *row[8:]] for row in traffic_rows()]
    kept = [HEADER.index(name) for name in columns]
    folder.mkdir(exist_ok=True)
    write_table(folder / "traffic.csv", [[row[at] for at in kept] for row in rows], columns)
    return prepare(load_scenario(write_scene(folder, {"model": {"caster": FAST}})))


def test_cars_alone_are_told_with_their_sizes_and_whose_these_are(tmp_path):
    end = "no figure here has a lorry or bus"
    site = cars_alone(tmp_path)
    recorded = other_traffic(site, site.scenario.baselines)
    assert fleet_text(recorded) == f"the recording has cars (4.3 x 1.8 x 1.5 m) alone, sizes as recorded: {end}"
    without = cars_alone(tmp_path / "flat", [name for name in HEADER if name != "height_m"])
    told = other_traffic(without, without.scenario.baselines)
    assert ", height assumed, the usual of the class: " in fleet_text(told)
    (first, *_) = other_traffic_statements({"other_traffic": told})
    assert first.text.startswith("The recording has cars (4.3 x 1.8 x 1.5 m)")


def test_a_recording_with_lorries_says_nothing_of_its_fleet(seen, seen_at_crossing):
    assert fleet_text(seen) == fleet_text(seen_at_crossing) == ""


def test_sizes_that_a_sumo_type_leaves_to_defaults_are_told_as_assumed(tmp_path):
    pytest.importorskip("sumolib", reason="sumolib is not installed")
    source = load_scenario("crossing").source.replace("crossing.toml", "crossing_types.xml")
    types = Path(source).read_text(encoding="utf-8")
    types = types.replace('vClass="passenger" length="3.9" width="1.7" height="1.5"', 'length="3.9"')
    (tmp_path / "types.xml").write_text(types, encoding="utf-8")
    site = with_settings("crossing", traffic__vehicle_types=str(tmp_path / "types.xml"))
    assert site.recording.report.assumed_sizes == ("width", "height")
    assert any("width and height by SUMO's default" in text for text in site.recording.report.assumed)


def row_of(share, *lanes, vehicles=20, **more):
    by_lane = {f"lane {number + 1}": {"detectable_share": one, "distinct_vehicles": vehicles} for number, one in lanes}
    row = {
        "interval_90": None,
        "boxes": 100,
        "distinct_vehicles": vehicles,
        "detectable_share": share,
        "by_lane": by_lane,
        "by_approach": {},
    }
    return {**row, "what": "", "value": "", "lanes": None, "lorries": None, "approach": None, **more}


def test_lorries_in_the_nearest_lane_are_told_beside_what_was_recorded():
    worst = row_of(0.67, (0, 0.95), (1, 0.52), lanes="the nearest lane (lane 1)", lorries=1.0)
    whole = row_of(0.99, (0, 1.0), (1, 0.98)) | {"interval_90": [0.97, 1.0]}
    told = lorries({"other_traffic": {"frames": 20, "recorded": whole, "mixes": [worst]}})
    assert told.text == (
        "Lorries in place of every car and van of the nearest lane (lane 1): 67 % of all vehicles detectable, "
        "instead of 99.0 % (97.0 to 100.0) in the same 20 frames."
    )


def test_other_heights_are_a_line_of_their_own_where_they_change_more_than_the_interval_holds():
    whole = row_of(0.87) | {"interval_90": [0.82, 0.92]}
    for share, first in ((0.84, False), (0.79, True)):
        mix = row_of(share, what=OTHER_HEIGHTS, value="as in a real fleet")
        result = {"other_traffic": {"frames": 20, "recorded": whole, "mixes": [mix]}}
        (told,) = other_traffic_statements(result)
        assert told.first == first
        assert told.text.startswith("Other heights (as in a real fleet): ")
        assert told.text.endswith("instead of 87 % (82 to 92) in the same 20 frames.")


def test_where_the_height_lies_on_its_bound_the_next_metre_is_told(tmp_path, capsys, monkeypatch):
    without_charts(monkeypatch)
    write_table(tmp_path / "traffic.csv", traffic_rows(vehicles=120))
    low = {"deployment": {"height_m": [2.0, 2.6], "tilt_x_deg": [0.0, 25.0]}, "sensor": {"range_gate_m": 35.0}}
    scene = write_scene(tmp_path, {**MAPPED, **low})
    out, _ = done(capsys, "optimise", scene, "--out", tmp_path / "run")
    result = json.loads((tmp_path / "run" / "result.json").read_text(encoding="utf-8"))
    height, beyond = result["deployment"]["height_m"], result["next_metre"]
    assert (beyond is not None) == (height >= 2.594)
    if beyond is not None:
        assert beyond["deployment"]["height_m"] == pytest.approx(height + 1.0)
        text, told = next_metre(result)
        assert text.format(**told) in " ".join(out.split())
    assert lorries(result).text in " ".join(out.split())
