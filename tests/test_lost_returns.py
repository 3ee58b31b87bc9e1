"""Returns lost to glass and to weakness: which ones, and that scans and scores lose them alike and nothing else."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest

from blender_lidar.casting import CASTERS, caster_class, is_available
from blender_lidar.casting.protocol import StandingScenery
from blender_lidar.scene.observation import Observation
from blender_lidar.scoring.frame_scorer import FrameScorer, singles
from blender_lidar.sensors.beams import beam_lattice
from blender_lidar.sensors.imperfections import PERFECT, Imperfections, detection_range_m
from blender_lidar.sensors.lidar import Lidar
from blender_lidar.sensors.model import load_model
from blender_lidar.sensors.pose import Pose
from blender_lidar.world.meshes import GLASS, REFLECTIVITY, ROAD, STRUCTURE, SURFACES
from blender_lidar.world.scenery import Scenery, structure
from blender_lidar.world.triangles import vehicle_triangles
from tests.sample_traffic import dense_traffic, one_vehicle, scan

pytestmark = pytest.mark.versions

LATTICE = beam_lattice(load_model("RS-LiDAR-32"), stride=4)
TRAFFIC = dense_traffic(vehicles=16, length_m=45.0, frame=7)
POSE = Pose(1.0, -0.5, 3.6, 0.3, 0.07, -0.5)
MOUNTINGS = (POSE, Pose(height_m=4.1))
WINDOWS = ("body", "detailed")
ODDS = {"none": (0.0, 1.0), "half": (0.0, 0.5), "half and drop-out": (0.2, 0.5), "none and drop-out": (0.2, 1.0)}
WEAK = Imperfections(range_at_10_percent_m=9.0)  # paint that faces the sensor to 20 m


def cloud_of(imperfections=PERFECT, detail="body", vehicles=TRAFFIC, pose=POSE, **changes):
    options = {"caster": "exact", "min_range_m": 0.4, "max_range_m": 60.0} | changes
    return scan(vehicles, LATTICE, pose, detail=detail, imperfections=imperfections, **options)


def beams_of(cloud):
    """Flat index of each point's beam by (ring, slot)."""
    ring = cloud.ring.astype(int)
    slot = np.round((cloud.azimuth_rad - LATTICE.slot_azimuth0_rad[ring]) / LATTICE.step_rad).astype(int)
    return ring * LATTICE.columns + slot


def first_hits(detail, vehicles=TRAFFIC, pose=POSE):
    """The vehicles' triangles, and what each beam meets first, cast without culling or bound."""
    triangles = vehicle_triangles(vehicles, detail)
    rays = pose.to_world(LATTICE.directions.reshape(-1, 3))
    return triangles, caster_class("exact")(triangles.corners).cast(pose.position, rays)


def beams_on_glass(detail):
    """Flat indices of the beams that meet glass first."""
    triangles, hits = first_hits(detail)
    return np.flatnonzero((hits.triangle >= 0) & (triangles.surface[hits.triangle] == GLASS))


def surfaces_of(cloud, detail="body"):
    """Index into `SURFACES` of what each point lies on."""
    triangles, hits = first_hits(detail)
    return np.where(cloud.vehicle_id >= 0, triangles.surface[hits.triangle[beams_of(cloud)]], ROAD)


def lost_in(cloud, imperfections, **settings):
    """Whether each point of a perfect cloud is lost."""
    return ~np.isin(beams_of(cloud), beams_of(cloud_of(imperfections, **settings)))


def assert_equal(part, whole, kept):
    for name in type(whole).__slots__:
        np.testing.assert_array_equal(getattr(part, name), getattr(whole, name)[kept])


def seen(imperfections, detail="body", caster="exact", poses=MOUNTINGS):
    everyone = np.ones(len(TRAFFIC), dtype=bool)
    observation = Observation((Lidar(LATTICE, 60.0, 0.4, imperfections),), caster, detail, 0.05)
    return FrameScorer(replace(TRAFFIC, counted=everyone), observation).see(singles(poses))


# --- glass: which returns are lost ------------------------------------------------------------------------------------


@pytest.mark.parametrize("detail", WINDOWS)
def test_windows_that_return_nothing_lose_every_return_from_glass_and_nothing_returns_from_behind_them(detail):
    whole, part = cloud_of(detail=detail), cloud_of(Imperfections(glass_dropout=1.0), detail)
    glass = np.isin(beams_of(whole), beams_on_glass(detail))
    assert 0.05 < glass[whole.vehicle_id >= 0].mean() < 0.5
    assert not glass[whole.vehicle_id < 0].any()
    assert_equal(part, whole, ~glass)


@pytest.mark.parametrize("glass_dropout", [0.5, 1.0])
def test_boxes_have_no_glass_and_lose_nothing(glass_dropout):
    whole, part = cloud_of(detail="box"), cloud_of(Imperfections(glass_dropout=glass_dropout), "box")
    assert_equal(part, whole, slice(None))


def test_windows_that_return_nothing_draw_no_random_numbers_and_are_the_same_for_every_seed():
    models = [Imperfections(glass_dropout=1.0, seed=seed).measurement(LATTICE, 1) for seed in (1, 2)]
    assert [len(each.noise_m) + len(each.chance) for each in models] == [0, 0]
    assert len(Imperfections(glass_dropout=0.9).measurement(LATTICE, 1).chance)


@pytest.mark.parametrize("dropout", [0.0, 0.3])
@pytest.mark.parametrize("glass_dropout", [0.1, 0.5, 0.9])
def test_the_share_that_glass_loses_is_what_either_loss_alone_leaves_nothing_of(dropout, glass_dropout):
    whole, part = cloud_of(), cloud_of(Imperfections(dropout=dropout, glass_dropout=glass_dropout))
    kept = np.isin(beams_of(whole), beams_of(part))
    assert_equal(part, whole, kept)
    glass = np.isin(beams_of(whole), beams_on_glass("body"))
    for of, loss in ((glass, 1.0 - (1.0 - dropout) * (1.0 - glass_dropout)), (~glass, dropout)):
        assert of.sum() > 200
        assert abs(1.0 - kept[of].mean() - loss) <= 4.0 * math.sqrt(loss * (1.0 - loss) / of.sum())


@pytest.mark.parametrize("dropout", [0.0, 0.3])
@pytest.mark.parametrize("detail", WINDOWS)
def test_more_glass_drop_out_never_adds_a_return(detail, dropout):
    beams = [
        set(beams_of(cloud_of(Imperfections(dropout=dropout, glass_dropout=share), detail)))
        for share in (0.0, 0.1, 0.5, 0.8, 1.0)
    ]
    for less, more in itertools.pairwise(beams):
        assert more < less


def test_glass_drop_out_changes_neither_the_noise_nor_what_is_lost_elsewhere():
    without, with_glass = (cloud_of(Imperfections(0.05, 0.3, glass_dropout=share)) for share in (0.0, 0.7))
    kept = np.isin(beams_of(without), beams_of(with_glass))
    assert_equal(with_glass, without, kept)
    assert np.isin(beams_of(without)[~kept], beams_on_glass("body")).all()


@pytest.mark.parametrize("p", [0.1, 0.3, 0.7, 1.0 / 3.0, 0.95])
def test_without_glass_drop_out_nothing_asks_for_glass(p):
    assert not Imperfections(dropout=p).measurement(LATTICE, 1).asks_for_surface
    assert Imperfections(dropout=p, glass_dropout=1.0).measurement(LATTICE, 1).glass_loss == 1.0


def test_a_pane_that_returns_nothing_still_hides_what_is_behind_it():
    car = one_vehicle("car", (0.0, 12.0))
    corners = [[[-5, 6, 0], [5, 6, 0], [5, 6, 5]], [[-5, 6, 0], [5, 6, 5], [-5, 6, 5]]]
    wall = structure("pane", np.array(corners, dtype=float))
    pane = Scenery(wall.corners, wall.owner, np.full(len(wall), GLASS, np.uint8), wall.names)
    pose, lossy = Pose(height_m=3.0, tilt_x=0.3), Imperfections(glass_dropout=1.0)
    scenes = ((None, lossy), (StandingScenery(pane, "exact"), PERFECT), (StandingScenery(pane, "exact"), lossy))
    open_view, returning, lost = (cloud_of(how, vehicles=car, pose=pose, scenery=standing) for standing, how in scenes)
    assert (open_view.vehicle_id >= 0).sum() > 50
    assert (returning.vehicle_id < 0).all()
    on_pane = abs(returning.xyz[:, 1] - 6.0) < 1e-9
    assert on_pane.sum() > 500
    assert_equal(lost, returning, ~on_pane)


# --- weak returns -----------------------------------------------------------------------------------------------------


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
    whole = cloud_of()
    assert_equal(cloud_of(WEAK), whole, ~lost_in(whole, WEAK))


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


@pytest.mark.parametrize(
    ("detail", "name"),
    [("box", "half and drop-out"), ("body", "none and drop-out"), ("detailed", "half"), ("detailed", "none")],
)
def test_a_scan_counts_what_glass_leaves_to_the_frame_scorer(detail, name):
    imperfections = Imperfections(0.02, ODDS[name][0], glass_dropout=ODDS[name][1], seed=3)
    cloud = cloud_of(imperfections, detail)
    row = np.searchsorted(TRAFFIC.vehicle_id, cloud.vehicle_id[cloud.vehicle_id >= 0])
    found = seen(imperfections, detail=detail)
    np.testing.assert_array_equal(found.points[0], np.bincount(row, minlength=len(TRAFFIC)))
    fewer = found.points < seen(Imperfections(0.02, ODDS[name][0], seed=3), detail=detail).points
    assert fewer.any() == (detail != "box")


@pytest.mark.parametrize(
    ("detail", "others"),
    [
        ("box", {}),
        ("body", {"range_noise_m": 0.3, "dropout": 0.2, "glass_dropout": 0.5}),
        ("detailed", {"range_noise_m": 0.3, "dropout": 0.2, "glass_dropout": 0.5}),
    ],
    ids=["box", "body", "detailed"],
)
def test_a_scan_counts_what_weakness_leaves_to_the_frame_scorer(detail, others):
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


# --- a horizontal field of view ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("sector", [(-60.0, 60.0), (10.0, 200.0), (-350.0, -345.0)])
@pytest.mark.parametrize("imperfections", [PERFECT, WEAK, Imperfections(0.02, 0.2, glass_dropout=0.5, seed=3)])
def test_a_sensor_with_a_field_of_view_has_the_returns_of_a_full_turn_within_it(monkeypatch, sector, imperfections):
    whole = cloud_of(imperfections)
    all_points = seen(imperfections).points
    limited = replace(LATTICE, model=replace(LATTICE.model, azimuth_deg=sector))
    monkeypatch.setattr("tests.test_lost_returns.LATTICE", limited)
    low, high = np.radians(sector)
    within = (whole.azimuth_rad - low) % (2.0 * math.pi) <= high - low
    assert 0.0 < within.mean() < 1.0
    assert_equal(cloud_of(imperfections), whole, within)
    row = np.searchsorted(TRAFFIC.vehicle_id, whole.vehicle_id[within & (whole.vehicle_id >= 0)])
    for caster in filter(is_available, CASTERS):
        points = seen(imperfections, caster=caster).points
        np.testing.assert_array_equal(points[0], np.bincount(row, minlength=len(TRAFFIC)))
        assert (points <= all_points).all()
