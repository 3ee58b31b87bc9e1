"""Windows that return some of the light or none: which returns they lose, and that they change nothing else."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from blender_lidar.casting import CASTERS, caster_class, is_available
from blender_lidar.casting.protocol import StandingScenery
from blender_lidar.scene.observation import Observation
from blender_lidar.scoring.frame_scorer import FrameScorer
from blender_lidar.sensors.imperfections import PERFECT, Imperfections
from blender_lidar.sensors.pose import Pose
from blender_lidar.world.scenery import Scenery, structure
from blender_lidar.world.shapes import GLASS
from blender_lidar.world.triangles import vehicle_triangles
from tests.lossy_street import LATTICE, POSE, TRAFFIC, beams_of, cloud_of
from tests.sample_traffic import one_vehicle

WINDOWS = ("body", "detailed")
ODDS = {"none": (0.0, 1.0), "half": (0.0, 0.5), "half and drop-out": (0.2, 0.5), "none and drop-out": (0.2, 1.0)}


def beams_on_glass(detail, vehicles=TRAFFIC, pose=POSE):
    """Flat indices of the beams that meet glass first, each cast without culling or bound."""
    triangles = vehicle_triangles(vehicles, detail)
    hits = caster_class("exact")(triangles.corners).cast(
        pose.position, pose.to_world(LATTICE.directions.reshape(-1, 3))
    )
    return np.flatnonzero((hits.triangle >= 0) & (triangles.surface[hits.triangle] == GLASS))


def assert_equal(part, whole, kept):
    for name in type(whole).__slots__:
        np.testing.assert_array_equal(getattr(part, name), getattr(whole, name)[kept])


def observation(imperfections, detail="body", caster="exact"):
    return Observation(LATTICE, 60.0, 0.4, caster, detail, 0.05, imperfections=imperfections)


def seen(imperfections, **settings):
    everyone = np.ones(len(TRAFFIC), dtype=bool)
    return FrameScorer(TRAFFIC, everyone, observation(imperfections, **settings)).see([POSE, Pose(height_m=4.1)])


# --- which returns are lost -------------------------------------------------------------------------------------------


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


# --- scores -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ODDS)
@pytest.mark.parametrize("detail", ["box", *WINDOWS])
def test_a_scan_counts_what_the_frame_scorer_counts(detail, name):
    imperfections = Imperfections(0.02, ODDS[name][0], glass_dropout=ODDS[name][1], seed=3)
    cloud = cloud_of(imperfections, detail)
    row = np.searchsorted(TRAFFIC.vehicle_id, cloud.vehicle_id[cloud.vehicle_id >= 0])
    found = seen(imperfections, detail=detail)
    np.testing.assert_array_equal(found.points[0], np.bincount(row, minlength=len(TRAFFIC)))
    fewer = found.points < seen(Imperfections(0.02, ODDS[name][0], seed=3), detail=detail).points
    assert fewer.any() == (detail != "box")


@pytest.mark.parametrize("caster", [name for name in CASTERS if name != "exact"])
@pytest.mark.parametrize("detail", WINDOWS)
@pytest.mark.parametrize("name", ODDS)
def test_every_caster_loses_the_same(caster, detail, name):
    if not is_available(caster):
        pytest.skip(f"the library of {caster} is not installed")
    imperfections = Imperfections(dropout=ODDS[name][0], glass_dropout=ODDS[name][1])
    fast, exact = (seen(imperfections, detail=detail, caster=each) for each in (caster, "exact"))
    np.testing.assert_array_equal(fast.points, exact.points)
    np.testing.assert_array_equal(fast.occupancy, exact.occupancy)
    clouds = [cloud_of(imperfections, detail, caster=each) for each in (caster, "exact")]
    np.testing.assert_array_equal(*map(beams_of, clouds))
