"""scripts/research/make_crossing.py: fresh traffic at a signal, the same for the same seed, and its cycle is found; and
the intersection that it ships, scenes/crossing*.
"""

from __future__ import annotations

import csv
import gzip
from collections import Counter
from importlib.metadata import packages_distributions, version
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

pytest.importorskip("pandas")

import tests.research  # noqa: F401
import make_crossing as script
from blender_lidar.road.settings import RoadSettings
from blender_lidar.road.sumo_net import read_net
from blender_lidar.traffic import CLASSES, overlapping_pairs, plan_frames, read_traffic
from tests.test_make_traffic import needs_sumo


def rows_of(path):
    """The file but for its head, which has the time of day."""
    return gzip.decompress(path.read_bytes()).partition(b"<fcd-export")[2]


def text_of(path):
    """What the file says: Python versions write other gzip headers."""
    content = path.read_bytes()
    return gzip.decompress(content) if path.suffix == ".gz" else content


@needs_sumo
def test_a_generated_crossing_shows_the_cycle_of_its_signal(tmp_path):
    first, second = script.cached_recordings(tmp_path, 2, 60, minutes=5.0)
    assert first.read_bytes() != second.read_bytes()
    west = {"origin_m": (-20.0, -9.0), "heading_deg": 0.0, "vehicle_types": str(tmp_path / script.VEHICLE_TYPES)}
    road = RoadSettings(lanes=script.LANES, lane_width_m=script.LANE_M)
    recording = read_traffic(str(first), format="sumo", road=road, **west)
    plan = plan_frames(recording, lambda vehicles: abs(vehicles.centre_m[:, 0]) < 50.0)
    assert any("a signal's cycle (60 s" in note for note in plan.notes)
    (again,) = script.cached_recordings(tmp_path / "again", 1, 60, minutes=5.0)
    assert rows_of(again) == rows_of(first)


# --- The shipped intersection -----------------------------------------------------------------------------

SCENES = Path(__file__).parents[1] / "scenes"
NET, SAMPLE, TYPES, POLES = (SCENES / name for name in script.SAMPLE_FILES)
STEP_S = 0.5


@pytest.fixture(scope="module")
def road():
    pytest.importorskip("sumolib", reason="sumolib, of the extra maps, is not installed")
    return read_net(NET)


@pytest.fixture(scope="module")
def whole_recording():
    return read_traffic(str(SAMPLE), format="sumo", vehicle_types=str(TYPES), origin_m=(0.0, 0.0))


@pytest.fixture(scope="module")
def recording(whole_recording):
    return whole_recording.vehicles_alone


@pytest.fixture(scope="module")
def steps():
    with gzip.open(SAMPLE) as stream:
        return list(ElementTree.parse(stream).iter("timestep"))


@pytest.fixture(scope="module")
def tracks(steps):
    """Of each vehicle its type, its lanes, and its places (n, 3): time, x, y."""
    rows = {}
    for step in steps:
        for one in step.iter("vehicle"):
            _, lanes, places = rows.setdefault(one.get("id"), (one.get("type"), [], []))
            lanes.append(one.get("lane"))
            places.append((float(step.get("time")), float(one.get("x")), float(one.get("y"))))
    return {name: (kind, lanes, np.array(places)) for name, (kind, lanes, places) in rows.items()}


def test_the_shipped_files_are_small_and_say_that_they_are_synthetic():
    assert sum(path.stat().st_size for path in (NET, SAMPLE, TYPES, POLES)) < 1e6
    for path in (NET, SAMPLE, TYPES):
        text = path.read_bytes()
        assert b"synthetic" in (gzip.decompress(text) if path.suffix == ".gz" else text)[:200]


def test_it_holds_half_an_hour_each_half_second_within_120_m(steps, tracks):
    np.testing.assert_allclose([float(step.get("time")) for step in steps], STEP_S * np.arange(3600))
    assert max(np.hypot(*places[:, 1:].T).max() for _, _, places in tracks.values()) <= 120.0


def test_its_net_is_one_signalised_junction_of_four_arms(road):
    (junction,) = road.junctions
    assert (junction.name, junction.signalised, road.drives_on) == ("middle", True, "right")
    np.testing.assert_allclose(junction.outline_m.mean(axis=0), 0.0, atol=2.0)
    approaches = Counter((lane.road, lane.use) for lane in road.lanes if lane.road.startswith("from_"))
    assert approaches == {
        (f"from_{arm}", use): lanes
        for arm in script.DIRECTIONS
        for use, lanes in (("vehicles", 3), ("bicycles", 1), ("pedestrians", 1))
    }


def test_its_vehicles_are_on_its_lanes_and_not_in_one_another(road, recording):
    found = road.locate(recording.centre_m[::7], recording.heading_rad[::7])
    assert (found.lane >= 0).mean() > 0.999
    use = np.array([road.lanes[lane].use for lane in found.lane])
    cycling = recording.class_index[::7] == CLASSES.index("bicycle")
    assert (use[~cycling] == "vehicles").mean() > 0.999
    some = [recording.at(frame) for frame in recording.frames[::5]]
    assert sum(len(overlapping_pairs(vehicles)) for vehicles in some) < 0.001 * sum(map(len, some))


def test_its_flows_and_turns_are_those_of_a_busy_junction(tracks):
    motor = [row for row in tracks.values() if row[0] != "bicycle"]
    kinds = Counter(kind for kind, _, _ in motor)
    assert 0.05 < (kinds["lorry"] + kinds["semitrailer"]) / len(motor) < 0.12
    assert kinds["bus"] > 5
    ways = [([lane[5:-2] for lane in lanes if lane.startswith("from_")], lanes[-1]) for _, lanes, _ in motor]
    through = [(start[0], last[3:-2]) for start, last in ways if start and last.startswith("to_")]
    assert 1600 < 2 * len(through) < 2000
    turns = Counter(
        next(turn for turn, exit_to in script.exits(start).items() if exit_to == end) for start, end in through
    )
    share = {turn: count / len(through) for turn, count in turns.items()}
    assert share == {turn: pytest.approx(wanted, abs=0.03) for turn, wanted in script.TURNS.items()}


def test_queues_grow_in_red_and_leave_in_green(tracks):
    leaving = [
        (places[row + 1, 0], lanes[row])
        for kind, lanes, places in tracks.values()
        for row in range(len(lanes) - 1)
        if lanes[row].startswith("from_") and lanes[row + 1].startswith(":middle") and kind != "bicycle"
    ]
    for lane in ("from_east_2", "from_east_3", "from_north_3", "from_west_4"):
        phase = np.array([time % script.SAMPLE_CYCLE_S for time, of in leaving if of == lane])
        turn = np.exp(2j * np.pi * phase / script.SAMPLE_CYCLE_S)
        assert abs(turn.mean()) > 0.7  # all within a part of the cycle
    waits = [STEP_S * (np.hypot(*np.diff(places[:, 1:], axis=0).T) < 0.1).sum() for _, _, places in tracks.values()]
    assert 10.0 < np.mean(waits) < 40.0
    assert max(waits) < 1.2 * script.SAMPLE_CYCLE_S


def test_it_holds_blocks_enough_to_judge_by(recording):
    plan = plan_frames(recording, lambda vehicles: np.hypot(*vehicles.centre_m[:, :2].T) < 84.0)
    assert len(np.unique(plan.holdout_block)) >= 6


def test_persons_and_bicycles_are_there(steps, whole_recording):
    persons = sum(len(list(step.iter("person"))) for step in steps)
    assert whole_recording.report.left_out == 0
    assert (whole_recording.class_index == CLASSES.index("pedestrian")).sum() == persons > 15_000
    assert len({one.get("id") for step in steps for one in step.iter("vehicle") if one.get("type") == "bicycle"}) > 40


def test_poles_stand_off_the_lanes(road):
    shapely = pytest.importorskip("shapely", reason="shapely, of the extra test, is not installed")
    with POLES.open(encoding="utf-8", newline="") as stream:
        poles = {row["name"]: (float(row["x_m"]), float(row["y_m"])) for row in csv.DictReader(stream)}
    lines = zip(road.points_m, road.width_m, strict=True)
    lanes = shapely.union_all(
        [shapely.LineString(line).buffer(0.5 * width, cap_style="flat", join_style="mitre") for line, width in lines]
        + [shapely.Polygon(road.junctions[0].outline_m)]
    )
    assert len(poles) == 8
    for name, (x, y) in poles.items():
        assert lanes.distance(shapely.Point(x, y)) >= 1.5, name
        north, east = (np.sign(round(at / 10)) for at in (y, x))
        of_name = sum(np.array(script.DIRECTIONS[word]) for word in name.split("_") if word in script.DIRECTIONS)
        np.testing.assert_array_equal(of_name, (east, north))


@needs_sumo
def test_the_same_version_of_sumo_makes_the_same_files(tmp_path):
    if "eclipse-sumo" not in packages_distributions().get("sumo", ()) or version("eclipse-sumo") != "1.28.0":
        pytest.skip("the shipped files are by SUMO 1.28.0")
    script.make_sample(tmp_path)
    for path in (NET, SAMPLE, TYPES, POLES):
        assert text_of(tmp_path / path.name) == text_of(path), path.name
