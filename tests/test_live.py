"""A frame kept while its LiDAR moves: its clouds are those of `scan`, its scores those of `FrameScorer`, to the bit."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest

import tests.research  # noqa: F401
from blender_lidar.casting import is_available
from blender_lidar.casting.protocol import StandingScenery
from blender_lidar.clouds.live import LiveFrame
from blender_lidar.clouds.scan import scan as scanned
from blender_lidar.clouds.snapshot import entropy_of_vehicles
from blender_lidar.errors import InputError
from blender_lidar.metrics.catalogue import METRICS
from blender_lidar.scene.observation import Observation, Scoring
from blender_lidar.scene.settings import ObjectiveSettings
from blender_lidar.scoring.frame_scorer import FrameScorer, singles
from blender_lidar.scoring.scores import VehicleScores
from blender_lidar.sensors.beams import beam_lattice
from blender_lidar.sensors.imperfections import PERFECT, Imperfections
from blender_lidar.sensors.lidar import Lidar
from blender_lidar.sensors.model import load_model
from blender_lidar.sensors.pose import Pose
from blender_lidar.world.scenery import barrier, box, join
from rival_metrics import OPTIONS
from tests.sample_traffic import dense_traffic, scan

pytestmark = pytest.mark.versions

LATTICE = beam_lattice(load_model("RS-16"), stride=6)
TRAFFIC = dense_traffic(vehicles=40, length_m=100.0)
FRAME = replace(
    TRAFFIC, counted=np.hypot(*TRAFFIC.centre_m[:, :2].T) < 30.0, weight=np.linspace(0.5, 2.0, len(TRAFFIC))
)
STANDING = join([box("sign", (2.0, 3.0, 3.0), (1.5, 0.2, 2.0)), barrier("concrete", 1.5, (-30.0, 30.0))])
ROUGH = Imperfections(0.05, 0.2, glass_dropout=0.4, range_at_10_percent_m=30.0, seed=5)
DRAG = [Pose(0.0, 0.0, 4.1, 0.3), Pose(0.2, 0.1, 4.0, 0.25, 0.05, 0.4), Pose(8.0, -1.0, 5.0, 0.4), Pose(40.0, 0.0, 3.0)]
SCORING = Scoring(0.05, "mean", -1.0, "corrected")


@pytest.fixture(params=["exact", "raster", "embree", "bvh"])
def caster(request):
    if not is_available(request.param):
        pytest.skip(f"{request.param} is not installed")
    return request.param


@pytest.mark.parametrize("since_ms", [0, 80])
def test_what_is_lost_at_a_moment_is_lost_in_cloud_and_score(since_ms):
    moment = replace(TRAFFIC, since_ms=since_ms)
    seen = observation("exact", Imperfections(dropout=0.5))
    clouds = [scanned(one, seen, DRAG[0]) for one in (TRAFFIC, moment)]
    assert np.array_equal(clouds[0].xyz, clouds[1].xyz) == (since_ms == 0)
    found = FrameScorer(moment, seen).see(singles(DRAG[:1]))
    assert found.points.sum() == (clouds[1].vehicle_id >= 0).sum()


def observation(caster, effects=PERFECT, scenery=False):
    standing = StandingScenery(STANDING, caster) if scenery else None
    return Observation((Lidar(LATTICE, 50.0, 0.4, effects),), caster, "body", 0.05, scenery=standing)


def assert_same(found, expected):
    """All arrays of two named tuples or data classes, and of those within, are equal to the last bit."""
    names = getattr(expected, "_fields", None) or [field.name for field in fields(expected)]
    for name in names:
        one, other = getattr(found, name), getattr(expected, name)
        if other is None or isinstance(other, np.ndarray):
            np.testing.assert_array_equal(one, other, err_msg=name)
        elif hasattr(other, "_fields"):
            assert_same(one, other)
        else:
            for row, column in zip(one, other, strict=True):
                np.testing.assert_array_equal(row, column, err_msg=name)


@pytest.mark.parametrize("scenery", [False, True], ids=["open", "hidden"])
@pytest.mark.parametrize("effects", [PERFECT, ROUGH], ids=["perfect", "rough"])
def test_a_look_has_the_cloud_of_a_scan_and_the_scores_of_a_scorer_wherever_it_is_dragged(caster, effects, scenery):
    seen = observation(caster, effects, scenery)
    live = LiveFrame(FRAME, seen, SCORING)
    scorer, scores = FrameScorer(replace(TRAFFIC, counted=FRAME.counted), seen), VehicleScores(SCORING, seen, [FRAME])
    for pose in DRAG:
        look = live.look(pose)
        how = {"scenery": seen.scenery, "imperfections": effects, "caster": caster}
        assert_same(look.cloud, scan(TRAFFIC, LATTICE, pose, min_range_m=0.4, max_range_m=50.0, **how))
        expected = scores.of(FRAME, scorer, singles([pose]))
        assert_same(look.scored, expected)
        assert expected.seen.points.sum() > 50


@pytest.mark.parametrize("metric", [*METRICS, OPTIONS["voxel_entropy_10_cm"], OPTIONS["distance"]])
def test_every_metric_scores_a_look_as_it_scores_a_frame(metric):
    scoring = replace(SCORING, metric=metric)
    seen = observation("exact", ROUGH)
    expected = VehicleScores(scoring, seen, [FRAME]).of(
        FRAME, FrameScorer(replace(TRAFFIC, counted=FRAME.counted), seen), singles(DRAG[:1])
    )
    assert_same(LiveFrame(FRAME, seen, scoring).look(DRAG[0]).scored, expected)


def test_what_stands_beside_the_scenery_returns_and_hides_as_if_it_were_part_of_it():
    seen, pose = observation("exact", ROUGH), DRAG[1]
    sign, wall = box("sign", (2.0, 3.0, 3.0), (1.5, 0.2, 2.0)), barrier("concrete", 1.5, (-30.0, 30.0))
    together = LiveFrame(FRAME, replace(seen, scenery=StandingScenery(join([sign, wall]), "exact")), SCORING)
    apart = LiveFrame(FRAME, replace(seen, scenery=StandingScenery(wall, "exact")), SCORING)
    look = apart.look(pose, [StandingScenery(sign, "exact")])
    assert_same(look.cloud, together.look(pose).cloud)
    assert_same(look.scored, together.look(pose).scored)
    assert look.scored.seen.points.sum() < LiveFrame(FRAME, seen, SCORING).look(pose).scored.seen.points.sum()


def test_without_scoring_there_is_a_cloud_alone_and_without_ground_none_of_it_lies_on_the_road():
    look = LiveFrame(FRAME, observation("exact"), None, ground=False).look(DRAG[0])
    assert look.scored is None
    assert len(look.cloud) == (look.cloud.vehicle_id >= 0).sum() > 50


def test_a_lidar_dragged_below_the_ground_is_refused_and_can_be_dragged_back():
    live = LiveFrame(FRAME, observation("exact"), SCORING)
    with pytest.raises(InputError, match=r"hangs -0\.5 m above the ground; allowed: more than 0 m"):
        live.look(Pose(height_m=-0.5))
    assert len(live.look(DRAG[0]).cloud) > 0


@pytest.mark.parametrize("effects", [PERFECT, ROUGH], ids=["perfect", "rough"])
def test_entropies_of_a_look_are_those_of_its_cloud(effects):
    live, objective = (
        LiveFrame(FRAME, observation("exact", effects, scenery=True), SCORING),
        ObjectiveSettings(class_weights={}),
    )
    for pose in DRAG:
        look = live.look(pose)
        bits = entropy_of_vehicles(look.cloud, TRAFFIC, objective, look)
        np.testing.assert_allclose(bits, entropy_of_vehicles(look.cloud, TRAFFIC, objective), atol=1e-12)
        assert not FRAME.counted.all()
