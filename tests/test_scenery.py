"""What stands still: its meshes, how it hides vehicles in scans and scores, and how a scene file describes it."""

from __future__ import annotations

import json
import math
import pickle
import re
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from blender_lidar.casting import CASTERS, caster_class, is_available
from blender_lidar.casting.protocol import StandingScenery
from blender_lidar.errors import InputError
from blender_lidar.scene.observation import Observation
from blender_lidar.scene.scenario import load_scenario
from blender_lidar.scene.site import read_scenery
from blender_lidar.scoring.frame_scorer import FrameScorer, singles
from blender_lidar.sensors.beams import beam_lattice
from blender_lidar.sensors.lidar import Lidar
from blender_lidar.sensors.model import load_model
from blender_lidar.sensors.pose import Pose
from blender_lidar.toml_table import read_toml, to_toml
from blender_lidar.world.meshes import STRUCTURE, VEGETATION
from blender_lidar.world.scenery import BARRIERS, barrier, barrier_extent, box, join
from blender_lidar.world.triangles import vehicle_triangles
from tests.refusals import refused
from tests.report_samples import Page
from tests.sample_traffic import dense_traffic, scan
from tests.small_scene import cli, done, without_charts, without_times, write_scene

pytestmark = pytest.mark.versions

LATTICE = beam_lattice(load_model("RS-16"), stride=6)
TRAFFIC = dense_traffic(vehicles=30, length_m=80.0)
POSE = Pose(1.0, -0.5, 4.1, math.radians(15.0), math.radians(2.0), math.radians(-20.0))
REACH_M = 50.0
SCENERY = join(
    [
        barrier("concrete", 5.6, (-30.0, 30.0)),
        barrier("guard_rail", 1.0, (-25.0, 25.0)),
        box("cabinet", (6.0, 1.2, 1.0), (1.5, 0.8, 2.0), 0.4),
        box("gantry", (-12.0, 8.0, 4.0), (0.5, 16.0, 0.6)),
    ]
)
HERE = [name for name in CASTERS if is_available(name)]
WALL = {"centre_m": [0.0, 1.0, 2.5], "size_m": [60.0, 0.2, 5.0], "name": "wall"}

RAIL = {"kind": "guard_rail", "y_m": 1}
HEDGE = {"centre_m": [0.0, 1.0, 1.0], "size_m": [60.0, 0.2, 2.0]}
FAR = {"centre_m": [500.0, 1.0, 1.0], "size_m": [1.0, 1.0, 1.0]}


def edges(corners):
    rounded = [[tuple(corner) for corner in triangle] for triangle in corners.round(9).tolist()]
    return Counter((triangle[i], triangle[(i + 1) % 3]) for triangle in rounded for i in range(3))


def first_hits(lattice=LATTICE, pose=POSE):
    """Everything merged and cast in float64, the ground as two large triangles: distance and owner of every beam."""
    vehicles = vehicle_triangles(TRAFFIC)
    far = 500.0
    square = np.array([(-far, -far, 0.0), (far, -far, 0.0), (far, far, 0.0), (-far, far, 0.0)])
    corners = np.concatenate([vehicles.corners, SCENERY.corners, square[[(0, 1, 2), (0, 2, 3)]]])
    owner = np.concatenate([vehicles.owner, np.full(len(SCENERY) + 2, -1)])
    directions = pose.to_world(lattice.directions.reshape(-1, 3))
    hits = caster_class("exact")(corners).cast(pose.position, directions, REACH_M)
    met = hits.triangle >= 0
    return hits.distance[met], np.where(owner[hits.triangle[met]] >= 0, owner[hits.triangle[met]], -1)


@pytest.mark.parametrize("kind", BARRIERS)
def test_a_barrier_is_closed_faces_outwards_and_stands_where_it_is_put(kind):
    made = barrier(kind, 24.0, (-10.0, 15.0))
    corners = made.corners - made.corners.mean(axis=(0, 1))
    there = edges(made.corners)
    assert all(there[b, a] == count for (a, b), count in there.items())
    assert np.einsum("ij,ij->i", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])).sum() > 0.0
    low, high = made.corners.min(axis=(0, 1)), made.corners.max(axis=(0, 1))
    assert low[0] == -10.0
    assert high[0] == pytest.approx(15.0, abs=0.1)
    assert low[2] == 0.0
    assert high[2] == barrier_extent(kind)[1]
    assert high[1] - 24.0 == pytest.approx(barrier_extent(kind)[0])
    assert low[1] + high[1] == pytest.approx(48.0)
    assert (made.surface == (VEGETATION if kind == "hedge" else STRUCTURE)).all()


def test_a_box_has_the_volume_and_the_place_that_are_asked_for():
    made = box("b", (1.0, 2.0, 3.0), (4.0, 2.0, 1.0), 0.7)
    corners = made.corners
    volume = np.einsum("ij,ij->i", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])).sum() / 6.0
    assert volume == pytest.approx(8.0)
    middle = 0.5 * (corners.min(axis=(0, 1)) + corners.max(axis=(0, 1)))
    np.testing.assert_allclose(middle, (1.0, 2.0, 3.0), atol=1e-12)
    reach = np.linalg.norm(corners - (1.0, 2.0, 3.0), axis=2)
    np.testing.assert_allclose(reach, 0.5 * math.sqrt(16 + 4 + 1))


def test_joined_scenery_keeps_every_owner():
    assert SCENERY.names[2:] == ("cabinet", "gantry")
    assert [int((SCENERY.owner == row).sum()) for row in (2, 3)] == [12, 12]
    assert len(join([])) == 0


@pytest.mark.parametrize("caster", HERE)
def test_a_scan_meets_what_everything_merged_and_cast_in_float64_meets(caster):
    cloud = scan(TRAFFIC, LATTICE, POSE, caster=caster, max_range_m=REACH_M, scenery=StandingScenery(SCENERY, caster))
    distance, owner = first_hits()
    assert len(cloud) == len(distance)
    np.testing.assert_allclose(cloud.range_m, distance, atol=1e-9)
    ids = np.where(owner >= 0, TRAFFIC.vehicle_id[owner], -1)
    np.testing.assert_array_equal(cloud.vehicle_id, ids)


@pytest.mark.parametrize("caster", HERE)
def test_the_score_counts_what_a_scan_counts_behind_scenery(caster):
    scenery = StandingScenery(SCENERY, caster)
    seen = Observation((Lidar(LATTICE, REACH_M),), caster, "body", 0.05, scenery=scenery)
    poses = [POSE, Pose(0.0, 0.0, 3.0)]
    scored = FrameScorer(TRAFFIC, seen).see(singles(poses))
    for row, pose in enumerate(poses):
        cloud = scan(TRAFFIC, LATTICE, pose, caster=caster, max_range_m=REACH_M, scenery=scenery)
        counts = [(cloud.vehicle_id == vehicle).sum() for vehicle in TRAFFIC.vehicle_id]
        np.testing.assert_array_equal(scored.points[row], counts)
    free = FrameScorer(TRAFFIC, replace(seen, scenery=None)).see(singles(poses)).points
    assert (scored.points <= free).all()
    assert scored.points.sum() < free.sum()


@settings(max_examples=25)
@given(st.floats(-40.0, 40.0), st.floats(-3.0, 30.0), st.floats(2.0, 60.0))
def test_what_lies_within_reach_is_met_whether_or_not_the_rest_is_left_out(x, y, reach):
    near = SCENERY.within((x, y), reach)
    origin = np.array([x, y, 2.5])
    rng = np.random.default_rng(1)
    rays = rng.normal(size=(60, 3))
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    whole = caster_class("exact")(SCENERY.corners).cast(origin, rays, reach)
    part = caster_class("exact")(near.corners).cast(origin, rays, reach)
    np.testing.assert_allclose(whole.distance, part.distance, rtol=1e-12)
    assert near.names == SCENERY.names


def test_scenery_that_went_to_another_process_hides_the_same():
    ready = StandingScenery(SCENERY, HERE[-1])
    rays = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    distance = np.array([30.0, 30.0])
    before = ready.hides(np.array([0.0, 0.0, 0.5]), rays, distance)
    again = pickle.loads(pickle.dumps(ready)).hides(np.array([0.0, 0.0, 0.5]), rays, distance)
    assert before.tolist() == again.tolist() == [True, False]


def test_a_scene_file_says_what_stands_there_and_is_written_as_it_was_read(tmp_path):
    text = {"world": {"boxes": [WALL], "barriers": [{"kind": "concrete", "y_m": 10.0, "x_m": [-20.0, 20.0]}]}}
    path = write_scene(tmp_path, text)
    scenario = load_scenario(path)
    again = tmp_path / "again.toml"
    again.write_text(to_toml(scenario.as_tables()), encoding="utf-8")
    assert load_scenario(again).world == scenario.world
    assert read_toml(again)["world"]["boxes"][0]["name"] == "wall"
    found = read_scenery(scenario, 50.0)
    assert found.names == ("wall", "concrete at y 10 m")
    np.testing.assert_allclose(found.corners[found.owner == 0].min(axis=(0, 1)), (-30.0, 0.9, 0.0), atol=1e-12)


@pytest.mark.parametrize(
    ("world", "problem"),
    [
        ({"boxes": [{"centre_m": [0, 0, 0]}]}, "[world] boxes 1 size_m: is missing"),
        ({"boxes": [WALL, {**WALL, "size_m": [1, 0, 1]}]}, "[world] boxes 2 size_m: is 0; allowed: more than 0"),
        ({"boxes": [{**WALL, "colour": "red"}]}, "[world] boxes 1: unknown key 'colour'"),
        ({"boxes": [3]}, "[world] boxes 1: is 3; allowed: a table"),
        ({"barriers": [{"kind": "fence", "y_m": 1}]}, "[world] barriers 1 kind: unknown kind 'fence'"),
        ({"barriers": [{"kind": "concrete"}]}, "[world] barriers 1 y_m: is missing"),
        ({"barriers": [{**RAIL, "x_m": 3}]}, "[world] barriers 1 x_m: is 3; allowed: a list"),
        ({"barriers": [{**RAIL, "x_m": [0, 1e5]}]}, "allowed: a pair [from, to], to after from"),
    ],
)
def test_scenery_that_cannot_be_meant_is_refused_with_its_number(tmp_path, world, problem):
    with pytest.raises(InputError) as error:
        load_scenario(write_scene(tmp_path, {"world": world}))
    assert problem in str(error.value)


@pytest.mark.parametrize(
    ("world", "name", "within", "above"),
    [
        ({"boxes": [{**WALL, "centre_m": [0.0, 0.0, 2.5]}]}, "wall", 2, 9),
        ({"barriers": [{"kind": "concrete", "y_m": 0.0}]}, "concrete at y 0 m", 0.5, 2),
        ({"barriers": [{"kind": "hedge", "y_m": 0.4}]}, "hedge at y 0.4 m", 1, 2),
    ],
)
def test_a_lidar_inside_what_stands_there_is_refused_and_one_above_it_is_not(
    tmp_path, capsys, world, name, within, above
):
    scene, out = write_scene(tmp_path, {"world": world}), ("--out", tmp_path / "c.npz")
    scanned = ("scan", scene, "--frame", 1, *out)
    for words in (scanned, ("evaluate", scene, *out)):
        line = refused(capsys, tmp_path, *words, "--height", within)
        assert f"the LiDAR hangs inside '{name}' of [world]" in line
    done(capsys, *scanned, "--height", above)


def test_a_run_with_other_scenery_is_not_resumed(tmp_path, capsys, monkeypatch):
    without_charts(monkeypatch)
    run = tmp_path / "run"
    scene = write_scene(tmp_path, {"world": {"boxes": [HEDGE]}})
    assert cli(capsys, "optimise", scene, "--out", run)[0] == 0
    write_scene(tmp_path, {"world": {"boxes": [{**HEDGE, "size_m": [60.0, 0.2, 2.1]}]}})
    assert "[world]" in refused(capsys, tmp_path, "optimise", scene, "--out", run, "--resume", begun=True)


def test_behind_a_wall_nothing_is_detectable_and_two_workers_agree_with_one(tmp_path, capsys, monkeypatch):
    without_charts(monkeypatch)
    results = []
    for name, changes in (
        ("free", {}),
        ("walled", {"world": {"boxes": [WALL]}}),
        ("hedged", {"world": {"boxes": [HEDGE]}}),
        ("hedged by two", {"world": {"boxes": [HEDGE]}, "model": {"workers": 2}}),
    ):
        scene = write_scene(tmp_path / name, changes)
        assert cli(capsys, "evaluate", scene, "--height", 3, "--out", tmp_path / name / "run")[0] == 0
        results.append(json.loads((tmp_path / name / "run" / "result.json").read_text()))
    for result in results:
        del result["site"]  # the folder's name
    free, walled, hedged, by_two = results
    assert free["detectable_share"] > 0.5
    assert walled["detectable_share"] == 0.0
    assert walled["objective_per_vehicle"] < hedged["objective_per_vehicle"] < free["objective_per_vehicle"]
    drop = {"identity"}
    same = [{k: v for k, v in without_times(r).items() if k not in drop} for r in (hedged, by_two)]
    assert same[0] == same[1]


@pytest.mark.parametrize(
    ("boxes", "counts", "words"),
    [
        ([], None, ""),
        # the ends of both are too far away
        ([WALL], {"objects": 1, "triangles": 8}, "1 object, 8 triangles within reach, z 0.0 to 5.0 m"),
        ([WALL, HEDGE, FAR], {"objects": 2, "triangles": 16}, "2 objects, 16 triangles within reach, z 0.0 to 5.0 m"),
        ([FAR], {"objects": 0, "triangles": 0}, "0 objects, 0 triangles within reach"),
    ],
)
def test_a_run_tells_how_much_stands_within_its_reach(tmp_path, capsys, monkeypatch, boxes, counts, words):
    without_charts(monkeypatch)
    scene = write_scene(tmp_path, {"world": {"boxes": boxes}} if boxes else None)
    out, _ = done(capsys, "evaluate", scene, "--height", 3, "--out", tmp_path / "run")
    result = json.loads((tmp_path / "run" / "result.json").read_text())
    page = Page((tmp_path / "run" / "report.html").read_text(encoding="utf-8"))
    sheet = (tmp_path / "run" / "installation.txt").read_text(encoding="utf-8")
    if (counts or {}).get("objects"):
        counts = counts | {"z_m": pytest.approx([0.0, 5.0]), "below_road": 0.0}
    assert result["scenery"] == counts
    assert re.findall("^Scenery .*", out, re.MULTILINE) == ([f"Scenery    {words}"] if words else [])
    assert (f"Simulated with scenery: {words}" in page.text(page.find("ul")[0])) == bool(words)
    nothing = not (counts or {}).get("objects")
    assert ("barriers between the sensor and the lanes are not in the model" in sheet) == nothing


def test_without_ground_a_scan_keeps_vehicles_and_scenery_alone(tmp_path, capsys):
    scene = write_scene(tmp_path, {"world": {"ground": False, "boxes": [WALL]}})
    assert cli(capsys, "scan", scene, "--frame", 20, "--height", 3, "--out", tmp_path / "c.npz")[0] == 0
    with np.load(tmp_path / "c.npz") as cloud:
        of_nothing = cloud["vehicle_id"] < 0
        assert of_nothing.any()
        np.testing.assert_allclose(cloud["xyz"][of_nothing, 1], 0.9, atol=1e-9)  # the wall's near face
