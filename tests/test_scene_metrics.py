"""Metrics of a whole scene, a plug-in that learns: identities, bad habits, and that they drive a search."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import numpy as np
import pytest

import tests.research  # noqa: F401
from blender_lidar.metrics.metric import VehicleReturns
from blender_lidar.run.verdict import map_scores
from blender_lidar.scene.mounting import Mast, Mounting
from blender_lidar.scene.observation import Observation, Scoring
from blender_lidar.scene.scenario import load_scenario
from blender_lidar.scene.site import prepare
from blender_lidar.scoring.evaluation import Evaluator, site_evaluator
from blender_lidar.scoring.frame_scorer import FrameScorer, singles
from blender_lidar.scoring.scores import VehicleScores
from blender_lidar.sensors.beams import beam_lattice
from blender_lidar.sensors.lidar import Lidar
from blender_lidar.sensors.model import load_model
from rival_metrics import OPTIONS as RIVALS
from scene_metrics import (
    DISC_RADIUS_M,
    NAMES,
    OPTIONS,
    ROAD_VOXEL_M,
    Road,
    SceneScore,
    _neighbours,
    nuc,
    thinned,
)
from tests.sample_traffic import dense_traffic, scan
from tests.small_scene import MAPPED, done, without_charts, write_scene
from tests.test_occupancy_priors import covered_entropy, expected_visibility, m_sog, s_mig
from voxel_grid import covered_voxels

pytestmark = pytest.mark.versions

WITH_PRIOR = NAMES[:4]
LATTICE = beam_lattice(load_model("RS-16"), stride=4)
SEEN = Observation((Lidar(LATTICE, 30.0, 0.4),), "exact", "box", 0.05)


MOUNTINGS = [
    Mounting(height_m=2.0),
    Mounting(height_m=4.1, tilt_x=0.33),
    Mounting(Mast((1.0, -1.0, 0.0)), 3.0, 0.1, 0.1, 0.4),
]
LAYOUTS, POSES = [(one,) for one in MOUNTINGS], [one.pose for one in MOUNTINGS]
OUT_OF_REACH = Mounting(height_m=40.0)


def frames_of(number, seed=0, length_m=70.0):
    made = []
    for frame in range(number):
        vehicles = dense_traffic(seed=seed + frame, vehicles=16 + frame, length_m=length_m, frame=10 * frame)
        made.append(replace(vehicles, counted=np.hypot(*vehicles.centre_m[:, :2].T) < 30.0))
    return made


FRAMES = frames_of(6)


def scoring(name):
    return Scoring(0.005, "mean", None, "corrected", OPTIONS[name])


def seen_by(*lidars):
    return replace(SEEN, lidars=lidars)


def per_vehicle(name, layouts=LAYOUTS, frames=FRAMES, seen=SEEN):
    with Evaluator(frames, seen, scoring(name)) as evaluator:
        return evaluator.totals(layouts).per_vehicle()


def published(name, pose, road):
    """The value as its formula has it, from the prior and the voxels alone."""
    covered = covered_voxels(road.grid, pose.position, thinned(SEEN.lidar) @ pose.rotation, 30.0, 0.4)
    if name == "expected_visibility":
        return expected_visibility(road.frames.prior, road.reached([pose]))
    return {"s_mig": s_mig, "covered_entropy": covered_entropy, "m_sog": m_sog}[name](road.frames, covered)


@pytest.mark.parametrize("name", WITH_PRIOR)
def test_the_objective_per_vehicle_is_the_published_value_under_the_frames_own_prior(name):
    road = Road(FRAMES, SEEN)
    expected = [published(name, pose, road) for pose in POSES]
    np.testing.assert_allclose(per_vehicle(name), expected, rtol=1e-9)
    assert np.ptp(expected) > 1e-3


@pytest.mark.parametrize("name", NAMES)
def test_a_value_does_not_depend_on_where_the_frames_origin_is(name):
    by = np.array([40.0, -12.0, 0.0])  # of whole voxels, so that the same centres lie in the same boxes
    moved = [replace(frame, centre_m=frame.centre_m + by) for frame in FRAMES]
    layouts = [(replace(one, mast=Mast((one.xy[0] + by[0], one.xy[1] + by[1], 0.0))),) for one in MOUNTINGS]
    np.testing.assert_allclose(per_vehicle(name, layouts, moved), per_vehicle(name), rtol=1e-3)


@pytest.mark.parametrize("name", NAMES)
def test_two_lidars_in_one_place_are_worth_one_and_one_that_is_left_out_nothing(name):
    """Ground returns alone are twice as dense."""
    twice, times = seen_by(SEEN.lidar, SEEN.lidar), 2.0 if name == "ground_density" else 1.0
    pairs = [(one, one) for one in MOUNTINGS]
    alone = per_vehicle(name)
    np.testing.assert_allclose(per_vehicle(name, pairs, seen=twice), times * alone, rtol=0.02 * (name == "ground_nuc"))
    left_out = [(None, one) for one in MOUNTINGS]
    np.testing.assert_array_equal(per_vehicle(name, left_out, seen=twice), alone)


def test_the_frame_and_the_company_in_which_mountings_are_scored_do_not_matter():
    """What is kept from one call to the next belongs to the mounting."""
    for name in ("m_sog", "expected_visibility", "ground_nuc"):
        together = VehicleScores(scoring(name), SEEN, FRAMES)
        for frame in (FRAMES[3], FRAMES[0]):
            scorer = FrameScorer(frame, SEEN)
            all_three = together.of(frame, scorer, singles(POSES)).values
            for pose, values in zip(POSES[::-1], all_three[::-1], strict=True):
                alone = VehicleScores(scoring(name), SEEN, FRAMES).of(frame, scorer, singles([pose])).values
                np.testing.assert_array_equal(alone[0], values)


def test_each_mounting_is_valued_once_for_all_frames_however_many_are_scored_together(monkeypatch):
    """A swarm may be larger than what is kept from one to the next."""
    monkeypatch.setattr("scene_metrics._LAYOUTS_KEPT", 2)
    asked = []

    def value(_, layout):
        asked.append(layout[0].height_m)
        return asked[-1]

    score = SceneScore(FRAMES, SEEN, value)
    layouts = [(Mounting(height_m=height).pose,) for height in (2.0, 3.0, 4.0, 5.0)]
    for frame in (*FRAMES, *FRAMES):
        n = 4 * frame.counted.sum()
        nothing = np.ones((n, 3)), np.zeros(n, dtype=np.int64), np.zeros((n, 3))
        returns = VehicleReturns(*nothing, frame=frame, layouts=layouts)
        assert score(returns).reshape(4, -1)[:, 0].tolist() == [2.0, 3.0, 4.0, 5.0]
    assert asked == [2.0, 3.0, 4.0, 5.0]


# --- what the metrics reward ------------------------------------------------------------------------------------------


def test_a_lidar_that_reaches_nothing_has_the_best_s_mig_and_m_sog_and_the_worst_of_all_others():
    for name in NAMES:
        road, nothing = per_vehicle(name, [LAYOUTS[1], (OUT_OF_REACH,)])
        if name in ("s_mig", "m_sog"):
            assert nothing == 0.0 > road, name
        else:
            assert nothing < road, name


def test_thinned_beams_are_beams_less_than_a_voxel_apart_and_cover_nearly_all():
    dense = beam_lattice(load_model("RS-16"))
    seen, every = seen_by(replace(SEEN.lidar, lattice=dense)), dense.directions.reshape(-1, 3)
    road, beams = Road(FRAMES, seen), thinned(seen.lidar)
    per_ring = len(beams) // dense.rings
    assert per_ring < 0.4 * dense.columns
    rings = beams.reshape(dense.rings, per_ring, 3)
    apart = 30.0 * np.linalg.norm(np.diff(rings, axis=1), axis=2)
    assert apart.max() < ROAD_VOXEL_M
    for pose in POSES:
        found = road.covered([pose])
        whole = covered_voxels(road.grid, pose.position, every @ pose.rotation, 30.0, 0.4)
        assert not (found & ~whole).any()
        assert found.sum() > 0.93 * whole.sum()


# --- ground returns ---------------------------------------------------------------------------------------------------


def test_the_ground_nearer_than_the_sensor_reports_does_not_return():
    pose, far = POSES[1], seen_by(replace(SEEN.lidar, min_range_m=12.0))
    every, kept = (Road(FRAMES, seen).ground_points([pose]) for seen in (SEEN, far))
    away = np.sqrt(np.square(every - pose.position[:2]).sum(axis=1) + pose.height_m**2)
    np.testing.assert_array_equal(kept, every[away >= 12.0])
    assert 0 < len(kept) < len(every)


@pytest.mark.parametrize("mounting", [*MOUNTINGS, OUT_OF_REACH])
def test_ground_returns_are_those_of_a_scan_of_the_empty_road(mounting):
    pose = mounting.pose
    empty = dense_traffic(vehicles=0)
    cloud = scan(empty, LATTICE, pose, caster="exact", min_range_m=0.4, max_range_m=30.0).xyz
    road = Road(FRAMES, SEEN)
    points, area = road.ground_points([pose]), road.area_m2
    inside = ((cloud[:, :2] >= road.low) & (cloud[:, :2] <= road.high)).all(axis=1)
    np.testing.assert_allclose(points, cloud[inside, :2], atol=1e-9)
    found = [per_vehicle(name, [(mounting,)])[0] for name in ("ground_density", "ground_nuc")]
    np.testing.assert_allclose(found, [len(points) / area, -nuc(points, area)], rtol=1e-12)
    assert (len(points) > 0) == (mounting is not OUT_OF_REACH)


AREA_M2 = 20.0 * 30.0


def slow_nuc(points, area, radius, discs, seed):
    """Every disc against every point."""
    share = math.pi * radius**2 / area
    picked = [points[int(u * len(points))] for u in np.random.default_rng(seed).random(discs)]
    ratio = [sum(math.dist(point, centre) <= radius for point in points) / (len(points) * share) for centre in picked]
    mean = sum(ratio) / discs
    return math.sqrt(sum((x - mean) ** 2 for x in ratio) / discs)


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("pairs", [1, 40, 1 << 20])
def test_non_uniformity_equals_the_slow_loop_however_many_pairs_are_looked_at_together(seed, pairs, monkeypatch):
    monkeypatch.setattr("scene_metrics._PAIRS_AT_A_TIME", pairs)
    rng = np.random.default_rng(seed)
    radius = float(rng.uniform(0.3, 6.0))
    points = np.concatenate([rng.uniform([-10, 2], [10, 32], (200, 2)), rng.normal([3.0, 8.0], 0.4, (100, 2))])
    expected = slow_nuc(points, AREA_M2, radius, 80, seed)
    assert nuc(points, AREA_M2, radius, 80, seed) == pytest.approx(expected, rel=1e-12)
    assert expected > 0.1


def test_points_on_the_rim_of_a_disc_count_and_whole_radii_apart_are_found():
    """Points on a lattice of the radius: each has itself and, but for the border, four neighbours on the rim."""
    step = np.arange(7) * 0.5
    points = np.stack(np.meshgrid(step, step), axis=-1).reshape(-1, 2)
    found = _neighbours(points, points, 0.5)
    border = np.isin(points, (0.0, 3.0)).sum(axis=1)
    np.testing.assert_array_equal(found, 5 - border)


def test_a_single_return_is_perfectly_uniform_and_none_is_worst():
    """Why NUC alone places no sensor."""
    assert nuc(np.array([[1.0, 2.0]]), AREA_M2) == 0.0
    assert nuc(np.full((500, 2), 3.0), AREA_M2) == 0.0
    worst = nuc(np.zeros((0, 2)), AREA_M2)
    assert worst == pytest.approx(0.5 * AREA_M2 / (math.pi * DISC_RADIUS_M**2))
    two = np.concatenate([np.zeros((50, 2)), np.array([[10.0, 10.0]] * 50), np.array([[20.0, 0.0]])])
    assert 0.0 < nuc(two, AREA_M2) < worst


def test_the_road_is_the_least_rectangle_about_all_boxes_that_count():
    road, ends = Road(FRAMES, SEEN), []
    for frame in FRAMES:
        for (x, y, _), (length, width, _), turn in zip(
            frame.centre_m[frame.counted],
            frame.size_m[frame.counted],
            frame.heading_rad[frame.counted],
            strict=True,
        ):
            ahead, left = (np.array([math.cos(turn), math.sin(turn)]), np.array([-math.sin(turn), math.cos(turn)]))
            ends += [(x, y) + i * length * ahead + j * width * left for i in (-0.5, 0.5) for j in (-0.5, 0.5)]
    np.testing.assert_allclose((road.low, road.high), (np.min(ends, axis=0), np.max(ends, axis=0)))
    assert road.area_m2 == pytest.approx(np.prod(np.ptp(ends, axis=0)))


# --- what is refused --------------------------------------------------------------------------------------------------


def test_frames_in_which_nothing_counts_have_no_values():
    nobody = [replace(frame, counted=np.zeros_like(frame.counted)) for frame in FRAMES]
    for name in NAMES:
        with Evaluator(nobody, SEEN, scoring(name)) as evaluator:
            assert evaluator.totals(LAYOUTS).objective.tolist() == [[0.0] * 6] * 3


# --- runs -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["expected_visibility", "ground_nuc"])
def test_a_metric_drives_a_search_and_is_judged_on_a_prior_of_the_held_out_frames(name, tmp_path, capsys, monkeypatch):
    without_charts(monkeypatch)
    scene = write_scene(tmp_path)
    out, _ = done(capsys, "optimise", scene, "--metric", OPTIONS[name], "--out", tmp_path / "run", "--json")
    result = json.loads(out)
    scenario = load_scenario(scene, {("objective", "metric"): (OPTIONS[name], "--metric")})
    site = prepare(scenario)
    layouts = [(scenario.lidar.mounting(result["deployment"]),), (scenario.lidar.baseline,)]
    for frames, stored in ((site.search, result), (site.holdout, result["holdout"])):
        with Evaluator(frames, site.observation, site.scoring) as evaluator:
            found, base = evaluator.totals(layouts).per_vehicle()
        assert stored["objective_per_vehicle"] == pytest.approx(found, rel=1e-9)
        assert found != base


def test_searching_for_s_mig_hides_the_road_that_its_positive_form_uncovers():
    """The degenerate sign, in a search that may tilt the LiDAR away."""
    tilts = np.linspace(-0.7, 0.45, 14)
    layouts = [(Mounting(height_m=4.0, tilt_x=tilt),) for tilt in tilts]
    turned_away, uncovered = (tilts[np.argmax(per_vehicle(name, layouts))] for name in ("s_mig", "covered_entropy"))
    assert turned_away < 0.0 < uncovered


def test_metric_choices_names_the_best_point_of_each_metrics_own_map(tmp_path, capsys):
    pytest.importorskip("scipy")
    import metric_choices

    scene, names = write_scene(tmp_path, MAPPED), ("pe-vgop", RIVALS["distance"], OPTIONS["ground_density"])
    assert metric_choices.main([str(scene), "--metrics", ",".join(names)]) == 0
    rows = {line.split()[0]: line.split()[1:] for line in capsys.readouterr().out.splitlines()[1:]}
    scenario = load_scenario(scene, {("objective", "metric"): (names[-1], "--metric")})
    site = prepare(scenario)
    (space,) = scenario.lidar.deployment.spaces
    with site_evaluator(site, site.search) as evaluator:
        found = map_scores(evaluator, space, space.lower, site.plan.search_block)
    height, tilt = np.unravel_index(np.argmax(found.per_vehicle), found.per_vehicle.shape)
    expected = [f"{found.height_m[height]:.2f}", f"{found.tilt_deg[tilt]:.1f}"]
    assert rows["scene_metrics.py:ground_density"][:2] == expected
    assert rows["rival_metrics.py:distance"] == ["-", "-", "-", "nan"]  # the same wherever it hangs
    assert rows["pe-vgop"][3] == "1.00"
    assert metric_choices.main([str(scene), "--metrics", "pe-vgob"]) == 2
    assert "did you mean 'pe-vgop'" in capsys.readouterr().err
