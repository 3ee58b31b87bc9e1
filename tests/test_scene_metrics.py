"""Metrics of a whole scene in a run: their identities, their worst habits, and that each of them drives a search."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import numpy as np
import pytest

from blender_lidar.clouds.scan import scan
from blender_lidar.errors import InputError
from blender_lidar.metrics import scene_metrics
from blender_lidar.metrics.catalogue import METRICS, metric_named
from blender_lidar.metrics.metric import Field, SceneContext, VehicleReturns, View
from blender_lidar.metrics.scene_metrics import ROAD_VOXEL_M, Road, field_area, ground_points, nuc
from blender_lidar.metrics.voxel_grid import covered_voxels
from blender_lidar.scene.observation import CountedFrame, Observation, Scoring
from blender_lidar.scene.scenario import load_scenario
from blender_lidar.scene.site import prepare
from blender_lidar.scoring.evaluation import Evaluator, site_evaluator
from blender_lidar.scoring.frame_scorer import FrameScorer
from blender_lidar.scoring.scores import VehicleScores, mountings_of
from blender_lidar.sensors.beams import beam_lattice
from blender_lidar.sensors.model import load_model
from blender_lidar.sensors.pose import Pose
from tests.refusals import refused
from tests.sample_traffic import dense_traffic, joined
from tests.small_scene import done, without_charts, write_scene
from tests.test_occupancy_priors import covered_entropy, expected_visibility, m_sog, s_mig

NAMES = [name for name, metric in METRICS.items() if metric.learn is not None]
WITH_PRIOR = ("s-mig", "covered-entropy", "m-sog", "expected-visibility")
LATTICE = beam_lattice(load_model("RS-16"), stride=4)
SEEN = Observation(LATTICE, 30.0, 0.4, "exact", "box", 0.05)
FIELD = Field((0.0, 0.0), 30.0, (2.0, 23.96))
POSES = [Pose(height_m=2.0), Pose(height_m=4.1, tilt_x=0.33), Pose(1.0, -1.0, 3.0, 0.1, 0.1, 0.4)]
OUT_OF_REACH = Pose(height_m=40.0)


def frames_of(number, seed=0, length_m=70.0):
    made = []
    for frame in range(number):
        vehicles = dense_traffic(seed=seed + frame, vehicles=16 + frame, length_m=length_m, frame=10 * frame)
        made.append(CountedFrame(vehicles, np.hypot(*vehicles.centre_m[:, :2].T) < 30.0))
    return made


FRAMES = frames_of(6)


def scoring(name, field=FIELD):
    return Scoring(0.005, "mean", None, "corrected", name, field)


def context(frames=FRAMES, lattice=LATTICE):
    return SceneContext(tuple(frame.boxes for frame in frames), lattice.directions, 0.4, 30.0, FIELD)


def per_vehicle(name, poses=POSES, frames=FRAMES):
    with Evaluator(frames, SEEN, scoring(name)) as evaluator:
        return evaluator.totals(poses).per_vehicle()


def published(name, pose, road):
    """The value as its formula has it, from the prior and the voxels alone."""
    covered = covered_voxels(road.grid, pose.position, road.beams @ pose.rotation, 30.0, 0.4)
    if name == "expected-visibility":
        return expected_visibility(road.frames.prior, road.reached(pose.position, pose.rotation))
    return {"s-mig": s_mig, "covered-entropy": covered_entropy, "m-sog": m_sog}[name](road.frames, covered)


@pytest.mark.parametrize("name", WITH_PRIOR)
def test_the_objective_per_vehicle_is_the_published_value_under_the_frames_own_prior(name):
    road = Road(context())
    expected = [published(name, pose, road) for pose in POSES]
    np.testing.assert_allclose(per_vehicle(name), expected, rtol=1e-9)
    assert np.ptp(expected) > 1e-3


def test_the_prior_is_the_share_of_frames_weighted_by_their_counted_vehicles():
    road = Road(context())
    counted = [int(frame.counted.sum()) for frame in FRAMES]
    assert len(set(counted)) > 2
    voxel = int(np.argmax(road.frames.prior))
    x, y, z = road.grid.centres(np.array([voxel]))[0]
    inside = 0
    for frame, weight in zip(FRAMES, counted, strict=True):
        vehicles = frame.vehicles
        dx, dy = x - vehicles.centre_m[:, 0], y - vehicles.centre_m[:, 1]
        cos, sin = np.cos(vehicles.heading_rad), np.sin(vehicles.heading_rad)
        length, width, height = 0.5 * vehicles.size_m.T
        holds = (abs(cos * dx + sin * dy) <= length) & (abs(cos * dy - sin * dx) <= width)
        inside += weight * bool((holds & (abs(z - vehicles.centre_m[:, 2]) <= height)).any())
    assert road.frames.prior[voxel] == pytest.approx(inside / sum(counted))


def test_frames_have_their_own_shares_of_a_value_so_that_blocks_of_time_differ():
    for name in NAMES:
        with Evaluator(FRAMES, SEEN, scoring(name)) as evaluator:
            totals = evaluator.totals(POSES[:1])
        of_frames = totals.objective[0] / totals.vehicles
        assert (np.ptp(of_frames) > 1e-6) == (name in WITH_PRIOR), name


@pytest.mark.parametrize("name", NAMES)
def test_a_value_does_not_depend_on_where_the_frames_origin_is(name):
    """A field about another place than x = y = 0, as a scene with [deployment] x_m and y_m has it."""
    by = np.array([40.0, -12.0, 0.0])  # of whole voxels, so that the same centres lie in the same boxes
    moved = [
        replace(frame, vehicles=replace(frame.vehicles, centre_m=frame.vehicles.centre_m + by)) for frame in FRAMES
    ]
    poses = [replace(pose, x_m=pose.x_m + by[0], y_m=pose.y_m + by[1]) for pose in POSES]
    field = Field((40.0, -12.0), 30.0, (-10.0, 11.96))
    with Evaluator(moved, SEEN, scoring(name, field)) as evaluator:
        found = evaluator.totals(poses).per_vehicle()
    np.testing.assert_allclose(found, per_vehicle(name), rtol=1e-3)


def test_all_vehicles_of_a_frame_have_its_value():
    for name in NAMES:
        scores = VehicleScores(scoring(name), SEEN, FRAMES)
        scorer = FrameScorer(FRAMES[2].vehicles, FRAMES[2].counted, SEEN)
        values = scores.of(FRAMES[2], scorer, POSES, mountings_of(POSES)).values
        assert values.shape == (3, FRAMES[2].counted.sum())
        assert (np.ptp(values, axis=1) == 0.0).all()
        assert np.ptp(values[:, 0]) > 0.0


def test_the_frame_and_the_company_in_which_mountings_are_scored_do_not_matter():
    """What is kept from one call to the next belongs to the mounting."""
    for name in ("m-sog", "expected-visibility", "ground-nuc"):
        together = VehicleScores(scoring(name), SEEN, FRAMES)
        for frame in (FRAMES[3], FRAMES[0]):
            scorer = FrameScorer(frame.vehicles, frame.counted, SEEN)
            all_three = together.of(frame, scorer, POSES, mountings_of(POSES)).values
            for pose, values in zip(POSES[::-1], all_three[::-1], strict=True):
                alone = (
                    VehicleScores(scoring(name), SEEN, FRAMES).of(frame, scorer, [pose], mountings_of([pose])).values
                )
                np.testing.assert_array_equal(alone[0], values)


def test_each_mounting_is_valued_once_for_all_frames_however_many_are_scored_together(monkeypatch):
    """A swarm may be larger than what is kept from one to the next."""
    monkeypatch.setattr(scene_metrics, "_MOUNTINGS_KEPT", 2)
    asked = []

    def value(_, origin, rotation):
        asked.append(origin[2])
        return origin[2]

    score = scene_metrics.SceneScore(context(), lambda known: known, value)
    mountings = mountings_of([Pose(height_m=height) for height in (2.0, 3.0, 4.0, 5.0)])
    for frame in (*FRAMES, *FRAMES):
        n = 4 * frame.counted.sum()
        view = View(mountings, frame.boxes)
        returns = VehicleReturns(np.ones((n, 3)), np.zeros(n, dtype=np.int64), np.zeros((n, 3)), view=view)
        assert score(returns).reshape(4, -1)[:, 0].tolist() == [2.0, 3.0, 4.0, 5.0]
    assert asked == [2.0, 3.0, 4.0, 5.0]


def test_two_workers_give_the_same_bits_as_one():
    made = scoring("expected-visibility")
    with Evaluator(FRAMES, SEEN, made) as alone, Evaluator(FRAMES, SEEN, made, workers=2) as pair:
        assert alone.totals(POSES).objective.tobytes() == pair.totals(POSES).objective.tobytes()


# --- what the metrics reward ------------------------------------------------------------------------------------------


def test_a_lidar_that_reaches_nothing_has_the_best_s_mig_and_m_sog_and_the_worst_of_all_others():
    for name in NAMES:
        road, nothing = per_vehicle(name, [POSES[1], OUT_OF_REACH])
        if name in ("s-mig", "m-sog"):
            assert nothing == 0.0 > road, name
        else:
            assert nothing < road, name


def lorries(number, y):
    """A wall of lorries along a lane, as a frame's vehicles."""
    one = dense_traffic(seed=3, vehicles=1, frame=number)
    x = np.arange(-24.0, 25.0, 12.0)
    return replace(
        one.select(np.zeros(len(x), dtype=int)),
        vehicle_id=np.arange(len(x)) + 900,
        centre_m=np.column_stack([x, np.full(len(x), y), np.full(len(x), 1.9)]),
        size_m=np.full((len(x), 3), [11.8, 2.4, 3.8]),
        heading_rad=np.zeros(len(x)),
    )


def test_no_vehicle_stops_a_beam_of_s_mig_but_traffic_dims_expected_visibility():
    """Lorries in every second frame between the LiDAR and the lanes behind."""
    plain, walled, pose = [], [], Pose(height_m=2.0)
    for number, frame in enumerate(frames_of(6, seed=50)):
        far = frame.vehicles.select(frame.vehicles.centre_m[:, 1] > 6.0)
        far = joined(far, lorries(number, 18.2))  # so that the regions are as high
        plain.append(CountedFrame(far, np.ones(len(far), dtype=bool)))
        with_wall = joined(far, lorries(number, 3.2)) if number % 2 else far
        walled.append(CountedFrame(with_wall, np.arange(len(with_wall)) < len(far)))
    roads = [Road(context(frames)) for frames in (plain, walled)]
    assert roads[0].grid == roads[1].grid
    behind = roads[0].grid.centres(np.arange(len(roads[0].grid)))[:, 1] > 6.0
    covered = [road.covered(pose.position, pose.rotation) & behind for road in roads]
    np.testing.assert_array_equal(*covered)
    assert covered[0].sum() > 1000
    before, after = (road.reached(pose.position, pose.rotation)[covered[0]].mean() for road in roads)
    assert after < 0.8 * before


def test_thinned_beams_are_beams_less_than_a_voxel_apart_and_cover_nearly_all():
    dense = beam_lattice(load_model("RS-16"))
    road, every = Road(context(lattice=dense)), dense.directions.reshape(-1, 3)
    per_ring = len(road.beams) // dense.rings
    assert per_ring < 0.4 * dense.columns
    rings = road.beams.reshape(dense.rings, per_ring, 3)
    apart = 30.0 * np.linalg.norm(np.diff(rings, axis=1), axis=2)
    assert apart.max() < ROAD_VOXEL_M
    for pose in POSES:
        thinned = road.covered(pose.position, pose.rotation)
        whole = covered_voxels(road.grid, pose.position, every @ pose.rotation, 30.0, 0.4)
        assert not (thinned & ~whole).any()
        assert thinned.sum() > 0.93 * whole.sum()


def test_voxels_nearer_than_the_sensor_reports_are_neither_covered_nor_reached():
    every, kept = Road(context()), Road(replace(context(), min_range_m=12.0))
    away = np.linalg.norm(every.grid.centres(np.arange(len(every.grid))) - POSES[1].position, axis=1)
    far = away >= 12.0 - 0.5 * math.sqrt(3.0) * ROAD_VOXEL_M
    covered, reached = (look(POSES[1].position, POSES[1].rotation) for look in (kept.covered, kept.reached))
    assert every.covered(POSES[1].position, POSES[1].rotation)[~far].any()
    for found in (covered, reached):
        assert found[far].any()
        assert not found[~far].any()


# --- ground returns ---------------------------------------------------------------------------------------------------


def test_the_ground_nearer_than_the_sensor_reports_does_not_return():
    pose, far = POSES[1], replace(context(), min_range_m=12.0)
    every, kept = (ground_points(known, pose.position, pose.rotation) for known in (context(), far))
    away = np.sqrt(np.square(every - pose.position[:2]).sum(axis=1) + pose.height_m**2)
    np.testing.assert_array_equal(kept, every[away >= 12.0])
    assert 0 < len(kept) < len(every)


@pytest.mark.parametrize("pose", [*POSES, OUT_OF_REACH])
def test_ground_returns_are_those_of_a_scan_of_the_empty_road(pose):
    empty = dense_traffic(vehicles=0)
    cloud = scan(empty, LATTICE, pose, caster="exact", min_range_m=0.4, max_range_m=30.0).xyz
    inside = (cloud[:, 1] >= 2.0) & (cloud[:, 1] <= 23.96) & (np.hypot(cloud[:, 0], cloud[:, 1]) <= 30.0)
    points = ground_points(context(), pose.position, pose.rotation)
    np.testing.assert_allclose(points, cloud[inside, :2], atol=1e-9)
    area = field_area(30.0, (2.0, 23.96))
    found = [per_vehicle(name, [pose])[0] for name in ("ground-density", "ground-nuc")]
    np.testing.assert_allclose(found, [len(points) / area, -nuc(points, area)], rtol=1e-12)
    assert (len(points) > 0) == (pose is not OUT_OF_REACH)


# --- what is refused --------------------------------------------------------------------------------------------------


def test_without_a_scene_there_is_nothing_to_learn_from():
    nothing = VehicleReturns(np.ones((1, 3)), np.zeros(1, dtype=np.int64), np.zeros((1, 3)))
    for name in NAMES:
        with pytest.raises(InputError, match="learns from a scene's traffic"):
            metric_named(name).values(nothing)
        with pytest.raises(InputError, match="learns from a scene's traffic"):
            VehicleScores(scoring(name, None), SEEN, FRAMES)


def test_frames_in_which_nothing_counts_have_no_values():
    nobody = [CountedFrame(frame.vehicles, np.zeros_like(frame.counted)) for frame in FRAMES]
    for name in NAMES:
        with Evaluator(nobody, SEEN, scoring(name)) as evaluator:
            assert evaluator.totals(POSES).objective.tolist() == [[0.0] * 6] * 3


def test_traffic_beside_the_carriageway_is_refused_in_one_line(tmp_path, capsys):
    traffic = {"frames": 3, "accept": ["carriageway"]}
    scene = write_scene(tmp_path, {"road": {"setback_m": 12.0}, "deployment": {"y_m": 10.5}, "traffic": traffic})
    line = refused(capsys, tmp_path, "optimise", scene, "--metric", "s-mig", "--out", tmp_path / "run")
    assert "metric 's-mig' looks at the carriageway of [road], y 12 to 19 m" in line
    assert not (tmp_path / "run" / "result.json").exists()


# --- runs -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", NAMES)
def test_each_metric_drives_a_search_and_is_judged_on_a_prior_of_the_held_out_frames(
    name, tmp_path, capsys, monkeypatch
):
    without_charts(monkeypatch)
    scene = write_scene(tmp_path)
    out, _ = done(capsys, "optimise", scene, "--metric", name, "--out", tmp_path / "run", "--json")
    result = json.loads(out)
    assert result["metric"] == name
    scenario = load_scenario(scene, {("objective", "metric"): (name, "--metric")})
    site = prepare(scenario)
    best = scenario.deployment.pose([result["deployment"]["height_m"]])
    for frames, stored in ((site.search, result), (site.holdout, result["holdout"])):
        with Evaluator(frames, site.observation, site.scoring) as evaluator:
            found, base = evaluator.totals([best, scenario.baseline_pose]).per_vehicle()
        assert stored["objective_per_vehicle"] == pytest.approx(found, rel=1e-9)
        assert found != base
    assert result["holdout"]["interval_90"] is not None
    assert (tmp_path / "run" / "vehicles.csv").exists()


def test_searching_for_s_mig_hides_the_road_that_its_positive_form_uncovers(tmp_path):
    """The degenerate sign, in a search that may tilt the LiDAR away."""
    bounds = {
        "deployment": {"height_m": 4.0, "tilt_x_deg": [-40.0, 25.0]},
        "search": {"method": "grid", "particles": 9},
    }
    scene = write_scene(tmp_path, bounds)
    share, tilt = {}, {}
    for name in ("s-mig", "covered-entropy"):
        site = prepare(load_scenario(scene, {("objective", "metric"): (name, "--metric")}))
        tilts = np.linspace(-40.0, 25.0, 14)
        with site_evaluator(site, site.search) as evaluator:
            totals = evaluator.totals([Pose(height_m=4.0, tilt_x=math.radians(angle)) for angle in tilts])
        best = int(np.argmax(totals.per_vehicle()))
        share[name], tilt[name] = totals.detectable_share()[best], tilts[best]
    assert tilt["s-mig"] < 0.0 < tilt["covered-entropy"]
    assert share["s-mig"] < 0.5 * share["covered-entropy"]
