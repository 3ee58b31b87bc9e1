"""Late fusion: boxes of one vehicle from several LiDARs are merged, and nothing else is."""

from __future__ import annotations

import itertools
import json
import math

import numpy as np
import pytest

from blender_lidar.detection.classical import early_fusion
from blender_lidar.detection.judge import clouds_at, detector_at, judge_detectors, range_image
from blender_lidar.detection.scores import MEASURES, recall
from blender_lidar.report.detection import detection_table, detection_text
from blender_lidar.scene.scenario import load_scenario
from blender_lidar.scene.site import prepare
from blender_lidar.traffic.boxes import Boxes, bev_iou, boxes_of_rows, join_boxes, late_fusion, no_boxes
from tests.layout_scene import EAST, WEST, write_layout_scene
from tests.refusals import refused
from tests.small_scene import done, without_charts, write_scene

CAR = (4.5, 1.8, 1.5)


def box(x=0.0, y=0.0, heading=0.0, kind=0, confidence=0.5, size=CAR):
    return (x, y, 0.75, *size, heading, kind, confidence)


def boxes(*rows):
    return boxes_of_rows(rows)


def table_of(found: Boxes) -> np.ndarray:
    """Rows in an order that depends on the boxes alone."""
    columns = [*found.centre_m.T, *found.size_m.T, found.heading_rad, found.kind, found.confidence]
    table = np.column_stack(columns)
    return table[np.lexsort(np.round(table, 9).T)]


def random_boxes(rng, vehicles, *, seen=0.7) -> Boxes:
    """What a LiDAR makes of vehicles: most of them, a little off, some turned about, and a few that are not there."""
    rows = [
        box(x + dx, y + dy, heading + turn, kind if rng.random() < 0.9 else (kind + 1) % 3, rng.random())
        for x, y, heading, kind in vehicles
        if rng.random() < seen
        for dx, dy, turn in [(*rng.normal(0.0, 0.5, 2), rng.choice([0.05, math.pi - 0.05, 0.5 * math.pi]))]
    ]
    return boxes(*rows, *(box(*rng.uniform(-30, 30, 2), confidence=rng.random()) for _ in range(3)))


def random_parts(seed: int, lidars: int = 3) -> list[Boxes]:
    rng = np.random.default_rng(seed)
    vehicles = [(*rng.uniform(-30.0, 30.0, 2), rng.uniform(-math.pi, math.pi), int(rng.integers(3))) for _ in range(15)]
    return [random_boxes(rng, vehicles) for _ in range(lidars)]


def slow_fusion(parts: list[Boxes]) -> np.ndarray:
    """The same by lists, one box at a time: the surest that is left takes the best of each other LiDAR."""
    left = [(lidar, part.select(np.array([row]))) for lidar, part in enumerate(parts) for row in range(len(part))]
    merged = []
    while left:
        of, surest = max(left, key=lambda one: one[1].confidence[0])
        group = [surest]
        for other in set(range(len(parts))) - {of}:
            of_other = [one for lidar, one in left if lidar == other]
            overlap = [one for one in of_other if bev_iou(surest, one)[0, 0] > 0.1]
            near = [one for one in of_other if math.dist(one.centre_m[0, :2], surest.centre_m[0, :2]) <= 2.0]
            if overlap:
                group.append(max(overlap, key=lambda one, surest=surest: bev_iou(surest, one)[0, 0]))
            elif near:
                here = surest.centre_m[0, :2]
                group.append(min(near, key=lambda one, here=here: math.dist(one.centre_m[0, :2], here)))
        left = [(lidar, one) for lidar, one in left if not any(one is other for other in group)]
        axis, total, sums = float(surest.heading_rad[0]), 0.0, np.zeros(7)
        for one in group:
            heading = float(one.heading_rad[0])
            heading += math.pi if math.cos(heading - axis) < 0.0 else 0.0  # turned about
            away = math.remainder(heading - axis, 2.0 * math.pi)
            if one.kind[0] == surest.kind[0] and abs(away) <= math.pi / 4.0:
                sums += one.confidence[0] * np.array([*one.centre_m[0], *one.size_m[0], axis + away])
                total += one.confidence[0]
        merged.append([*sums / total, surest.kind[0], surest.confidence[0]])
    alone = []  # from the surest on
    for row in merged:
        if all(bev_iou(boxes_of_rows([row]), boxes_of_rows([other]))[0, 0] <= 0.1 for other in alone):
            alone.append(row)
    table = np.array(alone)
    return table[np.lexsort(np.round(table, 9).T)]


@pytest.mark.parametrize("seed", range(8))
def test_it_is_what_a_slow_search_box_by_box_finds(seed):
    parts = random_parts(seed)
    found = late_fusion(parts)
    assert len(found) < sum(map(len, parts))
    np.testing.assert_allclose(table_of(found), slow_fusion(parts), atol=1e-9)


@pytest.mark.parametrize("seed", range(3))
def test_the_order_of_the_lidars_does_not_matter(seed):
    parts = random_parts(seed)
    tables = [table_of(late_fusion(list(order))) for order in itertools.permutations(parts)]
    for table in tables[1:]:
        np.testing.assert_allclose(table, tables[0], atol=1e-9)


def test_boxes_that_are_equally_sure_do_not_depend_on_the_order_of_the_lidars_either():
    one, other = boxes(box(0.0), box(20.0)), boxes(box(1.0, 0.2), box(20.0, 0.4))
    np.testing.assert_allclose(table_of(late_fusion([one, other])), table_of(late_fusion([other, one])), atol=1e-12)


@pytest.mark.parametrize("others", [0, 2])
def test_of_one_lidar_it_is_the_identity_however_its_boxes_overlap(others):
    alone = boxes(box(0.0), box(0.3, confidence=0.9), box(9.0, kind=2, confidence=0.0))
    found = late_fusion([alone, *[no_boxes()] * others])
    for name in alone.columns():
        np.testing.assert_array_equal(getattr(found, name), getattr(alone, name))
    assert len(late_fusion([no_boxes()] * (others + 1))) == 0


@pytest.mark.parametrize("seed", range(3))
def test_the_same_boxes_seen_twice_are_the_boxes_seen_once_and_no_surer(seed):
    (part,) = random_parts(seed, 1)
    apart = part.select(np.flatnonzero((bev_iou(part, part) > 0.1).sum(axis=1) == 1))
    np.testing.assert_allclose(table_of(late_fusion([apart, apart])), table_of(apart), atol=1e-9)


def test_the_surer_box_pulls_the_merged_one_towards_itself_and_gives_its_confidence_and_kind():
    found = late_fusion([boxes(box(0.0, confidence=0.6)), boxes(box(1.0, 0.3, confidence=0.2))])
    assert found.centre_m[0, :2] == pytest.approx([0.25, 0.075])
    assert found.confidence.tolist() == [0.6]
    truck = box(1.0, kind=1, confidence=0.9, size=(9.0, 2.5, 3.2))
    found = late_fusion([boxes(box(0.0, confidence=0.6)), boxes(truck)])
    assert (found.kind.tolist(), found.size_m[0].tolist()) == ([1], [9.0, 2.5, 3.2])


@pytest.mark.parametrize("turn", [math.pi, -math.pi, 3.0 * math.pi])
def test_a_box_that_is_turned_about_is_merged_as_the_same_box(turn):
    found = late_fusion([boxes(box(heading=0.2, confidence=0.6)), boxes(box(heading=0.4 + turn, confidence=0.3))])
    assert found.heading_rad[0] == pytest.approx(0.2 + 0.2 / 3.0)


def test_vehicles_abreast_in_neighbouring_lanes_stay_two():
    found = late_fusion([boxes(box(0.0, 0.0)), boxes(box(0.0, 2.5, confidence=0.4))])
    assert len(found) == 2


def test_a_box_between_two_of_another_lidar_takes_one_of_them_alone():
    found = late_fusion([boxes(box(2.5, confidence=0.9)), boxes(box(0.0, confidence=0.8), box(5.2, confidence=0.8))])
    assert table_of(found)[:, 0] == pytest.approx([5.2, 2.5 * 0.9 / 1.7])


@pytest.mark.parametrize(("across", "left"), [(1.9, 1), (2.1, 2)])
def test_boxes_whose_centres_are_near_are_of_one_vehicle_though_they_do_not_overlap(across, left):
    assert bev_iou(boxes(box()), boxes(box(0.0, across))).item() <= 0.1
    assert len(late_fusion([boxes(box()), boxes(box(0.0, across, confidence=0.4))])) == left


@pytest.mark.parametrize("seed", range(3))
def test_no_two_merged_boxes_overlap(seed):
    found = late_fusion(random_parts(seed))
    assert (bev_iou(found, found) > 0.1).sum() == len(found)


def test_of_boxes_that_are_near_a_surer_one_the_one_that_overlaps_most_is_taken():
    found = late_fusion([boxes(box(confidence=0.9)), boxes(box(0.0, 1.85, confidence=0.8), box(2.1, confidence=0.3))])
    assert table_of(found)[:, :2] == pytest.approx(np.array([[0.0, 1.85], [2.1 * 0.25, 0.0]]))


# --- Judged at a layout -----------------------------------------------------------------------------------------------


@pytest.fixture
def _scikit_learn():
    pytest.importorskip("sklearn", reason="scikit-learn, of the extra detect, is not installed")


def judged_at(folder, *lidars):
    site = prepare(load_scenario(write_layout_scene(folder, *lidars)))
    layout = site.scenario.baselines
    detectors = [detector_at(site.with_lidar(k), mount, "classical") for k, mount in enumerate(layout)]
    return judge_detectors(site, layout, detectors)


@pytest.mark.usefixtures("_scikit_learn")
def test_two_lidars_in_one_place_find_what_one_does(tmp_path):
    twins = [{**WEST, "name": name} for name in ("one", "other")]
    judged = judged_at(tmp_path / "twins", *twins)
    shares = {name: [float(recall(of.matches[0], at)[0]) for at in (0.1, 0.3)] for name, of in judged.items()}
    assert 0.0 < shares["one alone"][0] < 1.0
    assert shares["given"] == shares["one alone"] == shares["other alone"]
    assert [len(found) for found in judged["given"].boxes] == [len(found) for found in judged["one alone"].boxes]


@pytest.mark.usefixtures("_scikit_learn")
def test_two_lidars_find_at_least_what_each_finds_and_at_most_what_returns(tmp_path):
    judged = judged_at(tmp_path, WEST, EAST)
    assert list(judged) == ["west alone", "east alone", "early fusion", "given"]
    found = {name: one.matches[0].found > 0.1 for name, one in judged.items()}
    assert (found["given"] >= (found["west alone"] | found["east alone"])).all()
    assert found["given"].mean() > max(found["west alone"].mean(), found["east alone"].mean())
    assert judged["given"].with_return == judged["early fusion"].with_return > judged["west alone"].with_return
    for one in judged.values():  # distances are from the nearest LiDAR, in all
        np.testing.assert_array_equal(one.matches[0].vehicle_distance_m, judged["given"].matches[0].vehicle_distance_m)


@pytest.mark.usefixtures("_scikit_learn")
def test_early_fusion_of_one_lidar_is_the_detector_itself_and_of_two_clusters_all_points(tmp_path):
    site = prepare(load_scenario(write_layout_scene(tmp_path)))
    detectors, clouds = [], []
    for one, mount in zip(map(site.with_lidar, range(2)), site.scenario.baselines, strict=True):
        detector, of = detector_at(one, mount, "classical"), clouds_at(one, mount)
        detector.learn([range_image(detector, of, frame) for frame in site.search])
        detectors.append(detector)
        clouds.append(of(site.holdout[0]))
    parts = [detector.foreground(cloud) for detector, cloud in zip(detectors, clouds, strict=True)]
    (alone, _), both = detectors[0].detect(clouds[0]), early_fusion(detectors, parts)
    np.testing.assert_array_equal(table_of(early_fusion(detectors[:1], parts[:1])), table_of(alone))
    np.testing.assert_allclose(table_of(early_fusion(detectors[::-1], parts[::-1])), table_of(both), atol=1e-9)
    assert len(both) >= len(alone)


@pytest.mark.usefixtures("_scikit_learn")
def test_the_command_tells_each_alone_both_fusions_and_paired_differences(tmp_path, capsys, monkeypatch):
    without_charts(monkeypatch)
    scene, out = write_layout_scene(tmp_path), tmp_path / "found"
    told, _ = done(capsys, "detect", scene, "--lidar", "west,height_m=4", "--detector", "classical", "--out", out)
    result = json.loads((out / "detection.json").read_text())
    assert list(result["mountings"]) == ["baseline", "west alone", "east alone", "early fusion", "given"]
    given = result["mountings"]["given"]
    for other, gain in given["over"].items():
        assert set(gain) == set(MEASURES)
        for key, of in gain.items():
            assert of["difference"] == pytest.approx(given[key] - result["mountings"][other][key])
            assert of["interval_90"][0] <= of["difference"] <= of["interval_90"][1]
    assert [row["name"] for row in result["lidars"]] == ["west", "east"]
    assert result["lidars"][0]["deployment"]["height_m"] == 4.0
    assert given["recall_0.1"] <= result["detectable_share"] <= given["with_return"]
    gain = given["over"]["west alone"]["recall_0.3"]
    below = " ".join(told.partition("Late fusion less west alone")[2].split())
    assert below.startswith(f"recall at 0.3 {100 * gain['difference']:+.1f} ")
    assert "Late fusion less early fusion" in told
    assert {path.name for path in out.iterdir()} >= {
        "detections.csv",
        "detections_west_alone.csv",
        "detections_early_fusion.csv",
        "label_2_east_alone",
    }
    again, _ = done(
        capsys, "detect", scene, "--lidar", "west,height_m=4", "--detector", out / "detections.csv", "--json"
    )
    assert json.loads(again)["mountings"]["given"]["recall_0.3"] == given["recall_0.3"]


@pytest.mark.usefixtures("_scikit_learn")
def test_the_mountings_of_a_run_are_judged_with_it_and_afterwards_alike(tmp_path, capsys, monkeypatch):
    without_charts(monkeypatch)
    scene, run, words = write_layout_scene(tmp_path), tmp_path / "run", ("--detector", "classical", "--out")
    told, _ = done(capsys, "evaluate", scene, "--lidar", "west,height_m=4", *words, run)
    done(capsys, "detect", scene, "--run", run, *words, tmp_path / "found")
    one, other = (json.loads((path / "detection.json").read_text()) for path in (run, tmp_path / "found"))
    assert [row["deployment"]["height_m"] for row in one["lidars"]] == [4.0, 2.0]
    assert one == other
    for text in (told, (run / "report.html").read_text()):
        assert "Late fusion less west alone" in text


@pytest.mark.usefixtures("_scikit_learn")
def test_one_lidar_is_told_as_before(tmp_path, capsys, monkeypatch):
    without_charts(monkeypatch)
    scene = write_scene(tmp_path, {"region": {"centre_m": [0.0, 0.0], "radius_m": 20.0}})
    done(capsys, "detect", scene, "--height", 4, "--detector", "classical", "--out", tmp_path / "found")
    result = json.loads((tmp_path / "found" / "detection.json").read_text())
    assert list(result["mountings"]) == ["baseline", "given"]
    assert {"deployment", "hangs"} <= set(result)
    assert not {"lidars", "detectable_share"} & set(result)
    assert "over" not in result["mountings"]["given"]
    assert "fusion" not in detection_text(result)
    assert detection_table(result).columns[1:3] == ("baseline", "given")


@pytest.mark.usefixtures("_scikit_learn")
@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("--height", 4), "--height: is of one LiDAR, but the scene has west, east"),
        (("--lidar", "north"), "north"),
        (("--lidar", "west,height=4"), "height"),
    ],
)
def test_mountings_that_are_none_of_the_layout_are_refused_in_one_line(words, told, tmp_path, capsys):
    scene = write_layout_scene(tmp_path)
    assert told in refused(
        capsys, tmp_path, "detect", scene, *words, "--detector", "classical", "--out", tmp_path / "no"
    )


def test_joined_boxes_of_no_lidar_are_none():
    assert len(late_fusion([])) == len(join_boxes([])) == 0


@pytest.mark.parametrize(
    ("ends", "told"),
    [
        ([-0.02, 0.12], "+5 points (-2 to +12); not shown, and"),
        ([0.02, 0.08], "+5 points (+2 to +8), and"),
        (None, "+5 points; no interval, and"),
    ],
)
def test_what_a_detector_finds_beside_the_baseline_has_its_interval_and_doubt(ends, told):
    of = {"recall_0.3": 0.8, "precision_0.3": 0.9, "with_return": 1.0, "without_boxes": 0}
    sure = {"interval_90": {"recall_0.3": [0.7, 0.9], "precision_0.3": None}}
    given = {**of, **sure, "over_baseline": {"recall_0.3": {"difference": 0.05, "interval_90": ends}}}
    text = detection_text({"mountings": {"baseline": {"recall_0.3": 0.75, **sure}, "given": given}, "frames": 4})
    assert "finds 80 % (70 to 90) of the vehicles instead of 75 % (70 to 90) under the baseline: " in text
    assert told in text
    assert "90 % of what it finds are vehicles; 100.0 % have a return at all." in text
