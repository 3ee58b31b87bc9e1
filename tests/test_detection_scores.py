"""Matching of detections with vehicles, recall, precision, AP, paired intervals and overlap, beside slow oracles."""

from __future__ import annotations

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest

from blender_lidar.detection.scores import (
    CRITERIA,
    MEASURES,
    MISSED,
    Matches,
    average_precision,
    by_distance,
    intervals,
    match,
    measured,
    paired_intervals,
    precision,
    recall,
)
from blender_lidar.scene.region import Region
from blender_lidar.traffic.boxes import (
    KINDS,
    Boxes,
    bev_iou,
    corners_of,
    detected_boxes,
    join_boxes,
    no_boxes,
    suppressed,
)
from blender_lidar.traffic.vehicles import CLASSES

REGION = Region((0.0, 0.0), 50.0)
CENTRE, HALF, MOST = CRITERIA


def frame_of(places, counted=None, classes=None):
    count = len(places)
    vehicles = Boxes(
        frame=0,
        time_s=0.0,
        vehicle_id=np.arange(count),
        class_index=np.zeros(count, np.int8) if classes is None else np.array([CLASSES.index(c) for c in classes]),
        centre_m=np.column_stack([np.array(places, dtype=float).reshape(-1, 2), np.full(count, 0.75)]),
        size_m=np.tile([4.5, 1.8, 1.5], (count, 1)),
        heading_rad=np.zeros(count),
        lane=np.zeros(count, int),
    )
    return replace(vehicles, counted=np.ones(count, dtype=bool) if counted is None else np.array(counted))


def boxes_at(places, confidence, kind=None):
    count = len(places)
    return detected_boxes(
        np.column_stack([np.array(places, dtype=float).reshape(-1, 2), np.full(count, 0.75)]),
        np.tile([4.5, 1.8, 1.5], (count, 1)),
        np.zeros(count),
        np.zeros(count, np.int8) if kind is None else np.array(kind, np.int8),
        np.array(confidence, dtype=float),
    )


def matched(boxes, frame, criterion=CENTRE, kind=None):
    return match([boxes], [frame], REGION, (0.0, 0.0), criterion, kind)


def test_the_surest_takes_the_nearest_vehicle_and_the_next_one_is_a_false_alarm():
    found = matched(boxes_at([(0.5, 0), (1.5, 0), (20, 0)], [0.5, 0.9, 0.3]), frame_of([(0, 0), (-30, 0)]))
    assert found.confidence.tolist() == [0.5, 0.9, 0.3]
    assert found.hit.tolist() == [False, True, False]
    assert found.found.tolist() == [0.9, MISSED]


def test_a_frame_that_does_not_say_which_vehicles_count_counts_all():
    boxes, frame = boxes_at([(0.5, 0), (20, 0)], [0.5, 0.9]), frame_of([(0, 0), (-30, 0)])
    for kind in (None, 0, 1):
        said, not_said = (matched(boxes, one, kind=kind) for one in (frame, replace(frame, counted=None)))
        np.testing.assert_array_equal(said.found, not_said.found)
        np.testing.assert_array_equal(said.hit, not_said.hit)


def test_a_detection_goes_to_the_nearest_vehicle_that_no_surer_one_has():
    found = matched(boxes_at([(0.2, 0), (0.4, 0)], [0.9, 0.8]), frame_of([(0, 0), (1.8, 0)]))
    assert found.hit.all()
    assert found.found.tolist() == [0.9, 0.8]


def test_what_does_not_count_is_neither_hit_nor_false_alarm():
    """A vehicle that does not count, and a place outside the region."""
    frame = frame_of([(0, 0), (10, 0), (60, 0)], counted=[True, False, False])
    found = matched(boxes_at([(10, 0), (60, 0), (70, 0), (0, 0), (30, 0)], [0.9, 0.8, 0.7, 0.6, 0.5]), frame)
    assert found.confidence.tolist() == [0.6, 0.5]
    assert found.hit.tolist() == [True, False]
    assert len(found.found) == 1


def test_overlap_counts_from_its_threshold_on():
    frame = frame_of([(0, 0)])
    for shift, iou in ((1.4, (4.5 - 1.4) / (4.5 + 1.4)), (1.6, (4.5 - 1.6) / (4.5 + 1.6)), (0.7, 3.8 / 5.2)):
        boxes = boxes_at([(shift, 0)], [0.5])
        assert matched(boxes, frame, HALF).hit.tolist() == [iou >= 0.5]
        assert matched(boxes, frame, MOST).hit.tolist() == [iou >= 0.7]


def test_distances_of_hits_are_their_vehicles():
    """Else a vehicle at 9.9 m that is found at 10.1 m is missed in one band and found too often in the next."""
    found = matched(boxes_at([(10.1, 0)], [0.5]), frame_of([(9.9, 0)]))
    assert recall(found.near(0, 10), 0.1)[0] == average_precision(found.near(0, 10))[0] == 1.0
    assert len(found.near(10, 20).confidence) == 0


def test_of_a_kind_others_are_not_there_and_a_box_on_one_is_a_false_alarm():
    frame = frame_of([(0, 0), (20, 0), (40, 0)], classes=["van", "bus", "truck"])
    boxes = boxes_at([(0, 0), (20, 0), (40, 0)], [0.9, 0.8, 0.7], kind=[0, 0, 1])
    assert recall(matched(boxes, frame), 0.1)[0] == 1.0
    cars, large = matched(boxes, frame, kind=0), matched(boxes, frame, kind=1)
    assert (recall(cars, 0.1)[0], precision(cars, 0.1)[0]) == (1.0, 0.5)
    assert (recall(large, 0.1)[0], precision(large, 0.1)[0]) == (0.5, 1.0)


def test_of_a_kind_a_surer_box_of_another_kind_takes_no_vehicle():
    """As detectors give them that suppress overlaps within each kind alone."""
    boxes = boxes_at([(0, 0), (0.1, 0)], [0.9, 0.8], kind=[2, 0])
    assert average_precision(matched(boxes, frame_of([(0, 0)]), kind=0))[0] == 1.0


def test_bands_hold_every_vehicle_and_every_false_alarm():
    found = [matched(boxes_at([(49, 0)], [0.5]), frame_of([(10, 0), (20, 0)]), each) for each in CRITERIA]
    bands = by_distance(found, 49.0)
    assert list(bands) == ["0-10 m", "10-20 m", "20-30 m", "30-40 m", "40-50 m"]
    assert sum(band["vehicles"] for band in bands.values()) == 2
    assert [band["false_alarms_0.3"] for band in bands.values()] == [0, 0, 0, 0, 1]


# --- Average precision ------------------------------------------------------------------------------------------------


def slow_ap(confidence, hit, vehicles):
    """Area below the best precision at no less recall, threshold after threshold."""
    points = [(0.0, 0.0)]
    for threshold in sorted(set(confidence), reverse=True):
        sure = confidence >= threshold
        points.append((hit[sure].sum() / vehicles, hit[sure].mean()))
    area, before = 0.0, 0.0
    for reached, _ in points:
        area += (reached - before) * max(p for r, p in points if r >= reached)
        before = reached
    return area


def random_matches(seed, frames=12, decimals=1, detections=60, vehicles=50):
    rng = np.random.default_rng(seed)
    hit = rng.random(detections) < 0.6
    found = np.full(vehicles, MISSED)
    confidence = rng.random(detections).round(decimals)
    found[: hit.sum()] = confidence[hit]
    vehicle_frame = rng.integers(frames, size=vehicles)
    frame = rng.integers(frames, size=detections)
    frame[hit] = vehicle_frame[: hit.sum()]
    return Matches(
        frames=frames,
        confidence=confidence,
        hit=hit,
        frame=frame,
        distance_m=rng.uniform(0, 50, detections),
        found=found,
        vehicle_frame=vehicle_frame,
        vehicle_distance_m=rng.uniform(0, 50, vehicles),
    )


@pytest.mark.parametrize("seed", range(8))
def test_average_precision_is_the_area_that_a_slow_oracle_finds(seed):
    matches = random_matches(seed)
    expected = slow_ap(matches.confidence, matches.hit, len(matches.found))
    assert average_precision(matches)[0] == pytest.approx(expected, abs=1e-12)


def test_frames_that_count_twice_are_frames_that_are_there_twice():
    matches = random_matches(3)
    weight = np.zeros((2, matches.frames))
    weight[0, :6], weight[1] = 2.0, np.arange(matches.frames)
    for measure in MEASURES.values():
        whole = measure([matches] * 3, weight)
        for row, value in zip(weight, whole, strict=True):
            again = np.repeat(np.arange(len(matches.frame)), row[matches.frame].astype(int))
            vehicles = np.repeat(np.arange(len(matches.vehicle_frame)), row[matches.vehicle_frame].astype(int))
            assert measure([matches.select(again, vehicles)] * 3, None)[0] == pytest.approx(value, abs=1e-12)


def test_perfect_detections_score_one_and_nothing_scores_nothing():
    frame = frame_of([(0, 0), (20, 5)])
    perfect = [match([boxes_at([(0, 0), (20, 5)], [1, 1])], [frame], REGION, (0, 0), each) for each in CRITERIA]
    scores = measured(perfect)
    assert all(scores[name] == 1.0 for name in MEASURES)
    nothing = [match([join_boxes([])], [frame], REGION, (0, 0), each) for each in CRITERIA]
    scores = measured(nothing)
    assert scores["recall_0.1"] == scores["ap_iou_0.5"] == 0.0
    assert scores["precision_0.1"] is None
    empty = [match([join_boxes([])], [frame_of([])], REGION, (0, 0), each) for each in CRITERIA]
    assert measured(empty)["recall_0.1"] is None


# --- Intervals --------------------------------------------------------------------------------------------------------


def test_a_detector_beside_itself_differs_by_nothing_and_one_that_misses_some_loses():
    matches = random_matches(5)
    block = np.arange(matches.frames)
    for message in paired_intervals([matches] * 3, [matches] * 3, block, 1).values():
        assert message == {"difference": 0.0, "interval_90": [0.0, 0.0]}
    kept = matches.select(np.arange(len(matches.confidence)) % 2 == 0, np.ones(len(matches.found), bool))
    fewer = paired_intervals([kept] * 3, [matches] * 3, block, 1)["ap_centre_2m"]
    assert fewer["difference"] < 0.0
    assert fewer["interval_90"][0] < fewer["difference"] < fewer["interval_90"][1] < 0.0


def test_the_interval_of_one_detector_is_about_its_value_and_within_0_and_1():
    matches = [random_matches(5)] * 3
    block = np.arange(matches[0].frames)
    ends = intervals(matches, block, 1)
    for name, measure in MEASURES.items():
        low, high = ends[name]
        assert 0.0 <= low < float(measure(matches, None)[0]) < high <= 1.0
    assert set(intervals(matches, block // len(block), 1).values()) == {None}  # a single block


def test_distances_may_be_from_another_lidar_in_each_frame():
    boxes, frame = boxes_at([(0, 0)], [0.9]), frame_of([(0, 0)])
    found = match([boxes] * 2, [frame] * 2, REGION, np.array([(3.0, 4.0), (0.0, 2.0)]), CENTRE)
    assert found.distance_m.tolist() == found.vehicle_distance_m.tolist() == [5.0, 2.0]


def test_paired_intervals_hold_the_truth_as_often_as_they_say(monkeypatch):
    """Of 300 draws from frames that are all alike: 90 % within about two standard errors of that count."""
    monkeypatch.setattr("blender_lidar.detection.scores.MEASURES", {"recall_0.3": MEASURES["recall_0.3"]})
    rng, inside, draws = np.random.default_rng(8), 0, 300
    for _ in range(draws):
        shared = rng.random((16, 8)) < 0.5  # vehicles that both find, or neither
        parts = []
        for share in (0.7, 0.6):
            found = np.where(shared | (rng.random((16, 8)) < 2 * share - 1), 0.5, MISSED).ravel()
            vehicle_frame = np.repeat(np.arange(16), 8)
            nothing = match([join_boxes([])] * 16, [frame_of([])] * 16, REGION, (0.0, 0.0), CENTRE)
            seen = {"found": found, "vehicle_frame": vehicle_frame, "vehicle_distance_m": np.zeros(128)}
            parts.append([replace(nothing, **seen)] * 3)
        low, high = paired_intervals(*parts, np.arange(16), 1)["recall_0.3"]["interval_90"]
        inside += low <= 0.5 * (0.4 - 0.2) <= high
    assert 0.85 <= inside / draws <= 0.95


def test_false_alarms_of_blocks_without_vehicles_widen_the_interval():
    rng = np.random.default_rng(9)
    frames = [frame_of([(0, 0)]) if number % 2 else frame_of([]) for number in range(12)]
    perfect = [boxes_at([(0, 0)], [0.9]) if number % 2 else join_boxes([]) for number in range(12)]
    alarms = [boxes_at(rng.uniform(10, 30, (count, 2)), np.full(count, 0.5)) for count in (0, 1, 5, 0, 9, 2)]
    noisy = [alarms[number // 2] if number % 2 == 0 else perfect[number] for number in range(12)]
    one, other = ([match(boxes, frames, REGION, (0, 0), each) for each in CRITERIA] for boxes in (noisy, perfect))
    message = paired_intervals(one, other, np.arange(12), 1)["precision_0.3"]
    low, high = message["interval_90"]
    assert low < message["difference"] - 0.05
    assert high > message["difference"] + 0.05


def test_what_is_undefined_has_no_difference():
    frame = frame_of([(0, 0)])
    nothing, found = (
        [match([boxes] * 4, [frame] * 4, REGION, (0, 0), each) for each in CRITERIA]
        for boxes in (join_boxes([]), boxes_at([(0, 0)], [0.9]))
    )
    message = paired_intervals(nothing, found, np.arange(4), 1)
    assert message["precision_0.3"] == {"difference": None, "interval_90": None}
    assert message["recall_0.3"]["difference"] == -1.0


def test_memory_grows_with_the_detections_and_not_with_the_frames_besides():
    """It was frames times confidences, 6 GB for 3,000 scans."""
    many = random_matches(10, frames=3000, decimals=9, detections=20_000, vehicles=18_000)
    weight = np.random.default_rng(1).integers(3, size=(300, 3000)).astype(float)
    tracemalloc.start()
    assert 0.0 < measured([many] * 3)["ap_centre_2m"] < 1.0
    most_of_one = tracemalloc.get_traced_memory()[1]
    assert np.isfinite(average_precision(many, weight)).all()
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert most_of_one < 20e6
    assert most < 200e6


# --- overlap of oriented boxes from above, beside shapely; non-maximum suppression ------------------------------------


OCTAGON = 4 - 2 * (2**0.5 - 1) ** 2  # a square on its corner less the two that stick out


def boxes_of(rows, confidence=None):
    """Boxes from rows of x, y, length, width, heading [degrees]."""
    x, y, length, width, heading = np.array(rows, dtype=float).reshape(-1, 5).T
    return detected_boxes(
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
    each = replace(no_boxes(), class_index=np.arange(len(CLASSES)))
    kinds = [KINDS[kind] if kind >= 0 else None for kind in each.kind]
    assert dict(zip(CLASSES, kinds, strict=True)) == {
        "car": "car",
        "van": "car",
        "truck": "truck or bus",
        "bus": "truck or bus",
        "motorcycle": "motorcycle",
        "bicycle": "motorcycle",
        "pedestrian": None,
    }
