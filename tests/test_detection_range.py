"""Returns too weak to be told: what the law says, and that scans and scores lose them alike."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from blender_lidar.casting import CASTERS, caster_class, is_available
from blender_lidar.casting.protocol import StandingScenery
from blender_lidar.scene.observation import Observation
from blender_lidar.scoring.frame_scorer import FrameScorer
from blender_lidar.sensors.imperfections import Imperfections, detection_range_m
from blender_lidar.sensors.model import load_model
from blender_lidar.sensors.pose import Pose
from blender_lidar.world.meshes import REFLECTIVITY, ROAD, STRUCTURE, SURFACES
from blender_lidar.world.scenery import structure
from blender_lidar.world.triangles import vehicle_triangles
from tests.lossy_street import LATTICE, POSE, TRAFFIC, beams_of, cloud_of

MOUNTINGS = (POSE, Pose(height_m=4.1))
WEAK = Imperfections(range_at_10_percent_m=9.0)  # paint that faces the sensor to 20 m


def seen(imperfections, detail="body", caster="exact", poses=MOUNTINGS):
    everyone = np.ones(len(TRAFFIC), dtype=bool)
    observation = Observation(LATTICE, 60.0, 0.4, caster, detail, 0.05, imperfections=imperfections)
    return FrameScorer(TRAFFIC, everyone, observation).see(poses)


def surfaces_of(cloud, detail="body"):
    """Index into `SURFACES` of what each point lies on, every beam cast without culling or bound."""
    triangles = vehicle_triangles(TRAFFIC, detail)
    hits = caster_class("exact")(triangles.corners).cast(
        POSE.position, POSE.to_world(LATTICE.directions.reshape(-1, 3))
    )
    on_vehicle = triangles.surface[hits.triangle[beams_of(cloud)]]
    return np.where(cloud.vehicle_id >= 0, on_vehicle, ROAD)


def lost_in(cloud, imperfections, **settings):
    """Whether each point of a perfect cloud is lost."""
    return ~np.isin(beams_of(cloud), beams_of(cloud_of(imperfections, **settings)))


# --- the law ----------------------------------------------------------------------------------------------------------


def test_a_target_of_10_percent_that_faces_the_sensor_is_seen_as_far_as_stated():
    assert detection_range_m(80.0, 0.1, 1.0) == 80.0


@pytest.mark.parametrize(
    ("reflectivity", "incidence_deg", "expected"),
    [(0.2, 0.0, 80.0 * math.sqrt(2.0)), (0.4, 0.0, 160.0), (0.4, 60.0, 80.0 * math.sqrt(2.0)), (0.1, 90.0, 0.0)],
)
def test_the_range_goes_as_the_root_of_what_comes_back(reflectivity, incidence_deg, expected):
    found = detection_range_m(80.0, reflectivity, math.cos(math.radians(incidence_deg)))
    assert found == pytest.approx(expected, abs=1e-5)


def test_makers_figures_for_two_reflectivities_agree():
    """80 m on a 20 % target and its figure for 10 %, as in RS-16's table."""
    at_10_percent = load_model("RS-16").range_at_10_percent_m
    assert detection_range_m(at_10_percent, 0.2, 1.0) == pytest.approx(80.0, abs=0.1)


# --- clouds -----------------------------------------------------------------------------------------------------------


def test_a_board_is_seen_where_its_strength_reaches_that_of_the_stated_target():
    corners = np.array([[[-60, 12, -20], [60, 12, -20], [60, 12, 30]], [[-60, 12, -20], [60, 12, 30], [-60, 12, 30]]])
    board = StandingScenery(structure("board", corners.astype(float)), "exact")
    nobody, level = TRAFFIC.select(np.zeros(len(TRAFFIC), dtype=bool)), Pose(height_m=5.0)
    settings = {"vehicles": nobody, "pose": level, "ground": False, "scenery": board}
    whole = cloud_of(**settings)
    squareness = 12.0 / whole.range_m
    strength = REFLECTIVITY[STRUCTURE] * squareness / whole.range_m**2
    stated = 0.1 / WEAK.range_at_10_percent_m**2
    clear = abs(strength / stated - 1.0) > 1e-9
    lost = lost_in(whole, WEAK, **settings)
    assert 0.2 < lost.mean() < 0.8
    np.testing.assert_array_equal(lost[clear], strength[clear] < stated)


@pytest.mark.parametrize("detail", ["box", "body", "detailed"])
def test_no_return_is_lost_that_is_nearer_and_squarer_than_one_of_its_surface_that_is_kept(detail):
    whole = cloud_of(detail=detail)
    lost, surface = lost_in(whole, WEAK, detail=detail), surfaces_of(whole, detail)
    for number, name in enumerate(SURFACES):
        gone, kept = np.flatnonzero((surface == number) & lost), np.flatnonzero((surface == number) & ~lost)
        if name in ("paint", "road"):
            assert min(len(gone), len(kept)) > 100
        nearer = whole.range_m[gone, None] <= whole.range_m[kept]
        squarer = whole.incidence_rad[gone, None] <= whole.incidence_rad[kept]
        assert not (nearer & squarer).any()


def test_what_is_kept_is_as_it_was():
    whole, part = cloud_of(), cloud_of(WEAK)
    kept = ~lost_in(whole, WEAK)
    for name in type(whole).__slots__:
        np.testing.assert_array_equal(getattr(part, name), getattr(whole, name)[kept])


def test_a_sensor_that_sees_farther_keeps_all_that_the_other_keeps_and_in_the_end_everything():
    whole = cloud_of()
    lost = [lost_in(whole, Imperfections(range_at_10_percent_m=at)) for at in (1e-3, 4.0, 9.0, 20.0, 1e6, 1e300)]
    for near, far in itertools.pairwise(lost):
        assert not (far & ~near).any()
    assert [each.all() for each in lost] == [True] + [False] * 5
    assert [each.any() for each in lost] == [True] * 4 + [False] * 2


def test_a_return_is_judged_by_where_it_comes_from_not_by_the_range_that_noise_makes_of_it():
    noisy, weak = (Imperfections(0.5, range_at_10_percent_m=at, seed=2) for at in (None, 9.0))
    whole, part = (cloud_of(each, max_range_m=200.0, min_range_m=0.0) for each in (noisy, weak))
    far = {"max_range_m": 300.0, "min_range_m": 0.0}  # noise carries returns across the gate
    true = cloud_of(**far)
    too_weak = beams_of(true)[lost_in(true, WEAK, **far)]
    np.testing.assert_array_equal(beams_of(part), np.setdiff1d(beams_of(whole), too_weak))


# --- scores -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("detail", ["box", "body", "detailed"])
@pytest.mark.parametrize(
    "others", [{}, {"range_noise_m": 0.3, "dropout": 0.2, "glass_dropout": 0.5}], ids=["alone", "all"]
)
def test_a_scan_counts_what_the_frame_scorer_counts(detail, others):
    weak = Imperfections(range_at_10_percent_m=9.0, **others)
    cloud = cloud_of(weak, detail)
    row = np.searchsorted(TRAFFIC.vehicle_id, cloud.vehicle_id[cloud.vehicle_id >= 0])
    found = seen(weak, detail).points
    np.testing.assert_array_equal(found[0], np.bincount(row, minlength=len(TRAFFIC)))
    assert 0.2 < found.sum() / seen(Imperfections(**others), detail).points.sum() < 0.95


def test_the_frame_scorer_counts_what_the_law_leaves_of_beams_cast_one_by_one():
    triangles = vehicle_triangles(TRAFFIC, "body")
    rays = POSE.to_world(LATTICE.directions.reshape(-1, 3))
    hits = caster_class("exact")(triangles.corners).cast(POSE.position, rays, 60.0)
    points = np.zeros(len(TRAFFIC), dtype=int)
    for beam in np.flatnonzero(hits.triangle >= 0):
        a, b, c = triangles.corners[hits.triangle[beam]]
        normal = np.cross(b - a, c - a)
        cosine = abs(normal @ rays[beam]) / math.sqrt(normal @ normal)
        reflectivity = {"paint": 0.5, "glass": 0.1}[SURFACES[triangles.surface[hits.triangle[beam]]]]
        strong = reflectivity * cosine / hits.distance[beam] ** 2 >= 0.1 / WEAK.range_at_10_percent_m**2
        points[triangles.owner[hits.triangle[beam]]] += strong
    assert points.sum() > 500
    np.testing.assert_array_equal(seen(WEAK).points[0], points)


def test_mountings_together_and_one_by_one_see_the_same():
    poses = [Pose(0.0, 0.0, height, tilt) for height, tilt in ((2.0, 0.0), (3.0, 0.2), (4.5, 0.4))]
    together, alone = seen(WEAK, poses=poses), [seen(WEAK, poses=[pose]) for pose in poses]
    np.testing.assert_array_equal(together.points, np.concatenate([each.points for each in alone]))
    np.testing.assert_array_equal(together.occupancy, np.concatenate([each.occupancy for each in alone]))


@pytest.mark.parametrize("caster", [name for name in CASTERS if name != "exact"])
@pytest.mark.parametrize("detail", ["body", "detailed"])
def test_every_caster_loses_the_same(caster, detail):
    if not is_available(caster):
        pytest.skip(f"the library of {caster} is not installed")
    fast, exact = (seen(WEAK, detail, caster=each) for each in (caster, "exact"))
    np.testing.assert_array_equal(fast.points, exact.points)
    np.testing.assert_array_equal(fast.occupancy, exact.occupancy)
    np.testing.assert_array_equal(*(beams_of(cloud_of(WEAK, detail, caster=each)) for each in (caster, "exact")))
