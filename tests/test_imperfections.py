"""Range noise and drop-out: their statistics, that they belong to the beam and the frame alone, and where they end."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from blender_lidar.casting import CASTERS, caster_class, is_available
from blender_lidar.clouds.scan import scan
from blender_lidar.errors import InputError
from blender_lidar.metrics.vgop import entropy, occupancy, to_vehicle_frame
from blender_lidar.scene.observation import CountedFrame, Observation, Scoring
from blender_lidar.scoring.evaluation import Evaluator
from blender_lidar.scoring.frame_scorer import FrameScorer
from blender_lidar.sensors.beams import beam_lattice
from blender_lidar.sensors.imperfections import PERFECT, Imperfections
from blender_lidar.sensors.model import load_model, unit_of
from blender_lidar.sensors.pose import Pose
from blender_lidar.world.shapes import GLASS
from blender_lidar.world.triangles import vehicle_triangles
from tests.sample_traffic import dense_traffic, one_vehicle

FINE = {name: beam_lattice(load_model(name)) for name in ("RS-16", "RS-LiDAR-32")}
COARSE = {
    "RS-16": beam_lattice(load_model("RS-16"), stride=20),
    "RS-LiDAR-32": beam_lattice(load_model("RS-LiDAR-32"), stride=20),  # azimuth offsets: slots are not columns
    "a unit of RS-80": beam_lattice(unit_of(load_model("RS-80"), 0.1, 3), stride=50),
}
TRAFFIC = dense_traffic(vehicles=40, length_m=100.0, frame=7)
MOUNTINGS = [Pose(height_m=4.1, tilt_x=0.33), Pose(1.0, -0.5, 2.6, 0.1, 0.07, -0.5)]
ROUGH = Imperfections(0.05, 0.2, glass_dropout=0.4, seed=5)


def cloud_of(imperfections=PERFECT, lattice=FINE["RS-16"], vehicles=TRAFFIC, pose=MOUNTINGS[0], **changes):
    options = {"caster": "exact", "min_range_m": 0.4, "max_range_m": 60.0} | changes
    return scan(vehicles, lattice, pose, imperfections=imperfections, **options)


def beams_of(cloud, lattice):
    """Flat index of each point's beam by (ring, firing column)."""
    ring = cloud.ring.astype(int)
    slot = np.round((cloud.azimuth_rad - lattice.slot_azimuth0_rad[ring]) / lattice.step_rad).astype(int)
    return ring * lattice.columns + lattice.column(ring, slot)


def by_column(lattice, values):
    """Values by (ring, slot), flat, as an array by (ring, firing column)."""
    found = np.empty((lattice.rings, lattice.columns), values.dtype)
    ring, slot = np.divmod(np.arange(values.size), lattice.columns)
    found[ring, lattice.column(ring, slot)] = values
    return found


# --- statistics -------------------------------------------------------------------------------------------------------


def residuals(imperfections, **settings):
    """Measured less true range of every beam that returns with and without imperfections [m]."""
    true, noisy = (cloud_of(each, **settings) for each in (PERFECT, imperfections))
    _, mine, theirs = np.intersect1d(beams_of(true, FINE["RS-16"]), beams_of(noisy, FINE["RS-16"]), return_indices=True)
    assert len(mine) > 6000
    return noisy.range_m[theirs] - true.range_m[mine]


@pytest.mark.parametrize("sigma", [0.008, 0.02, 0.5])
def test_range_errors_are_normal_with_the_sigma_that_was_asked_for(sigma):
    error = residuals(Imperfections(sigma, seed=2), max_range_m=1000.0, min_range_m=0.0) / sigma
    n = len(error)
    assert abs(error.mean()) < 4.0 / math.sqrt(n)
    assert abs(error.std() - 1.0) < 4.0 / math.sqrt(2.0 * n)
    for deviations in (0.5, 1.0, 2.0, 3.0):
        share = math.erf(deviations / math.sqrt(2.0))
        assert abs((abs(error) < deviations).mean() - share) < 4.0 * math.sqrt(share * (1.0 - share) / n)


@pytest.mark.parametrize("dropout", [0.01, 0.1, 0.9])
def test_the_share_of_lost_returns_is_the_drop_out_and_the_others_are_as_they_were(dropout):
    whole, part = cloud_of(), cloud_of(Imperfections(dropout=dropout))
    n = len(whole)
    assert abs(1.0 - len(part) / n - dropout) < 4.0 * math.sqrt(dropout * (1.0 - dropout) / n)
    kept = np.isin(beams_of(whole, FINE["RS-16"]), beams_of(part, FINE["RS-16"]))
    for name in type(whole).__slots__:
        np.testing.assert_array_equal(getattr(part, name), getattr(whole, name)[kept])


def test_more_drop_out_loses_what_less_has_lost_and_more():
    some, many = (beams_of(cloud_of(Imperfections(dropout=p)), FINE["RS-16"]) for p in (0.1, 0.3))
    assert set(many) < set(some)


def test_draws_are_independent_between_beams_frames_seeds_and_of_each_other():
    lattice = FINE["RS-LiDAR-32"]

    def drawn(frame=0, seed=1):
        draws = Imperfections(1.0, 0.5, seed=seed).measurement(lattice, frame)
        return by_column(lattice, draws.noise_m), by_column(lattice, draws.chance)

    noise, chance = drawn()
    others = [drawn(frame=1), drawn(frame=2**32), drawn(frame=-1), drawn(seed=2), drawn(seed=0)]
    pairs = [(noise, chance)]
    for values, again in zip((noise, chance), zip(*others, strict=True), strict=True):
        pairs += [(values, other) for other in again]
        pairs += [(values[:, :-1], values[:, 1:]), (values[:-1], values[1:]), (values[1:, :-1], values[:-1, 1:])]
    for one, other in pairs:
        assert abs(np.corrcoef(one.ravel(), other.ravel())[0, 1]) < 4.0 / math.sqrt(one.size)


def test_noise_is_cut_off_where_beams_are_no_longer_cast():
    sigma = 2.0
    imperfections = Imperfections(sigma)
    noise = np.concatenate([imperfections.measurement(FINE["RS-16"], frame).noise_m for frame in range(40)])
    assert imperfections.most_noise_m == 6.0 * sigma
    assert 4.2 * sigma < abs(noise).max() <= imperfections.most_noise_m


# --- what draws belong to ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", sorted(COARSE))
def test_draws_are_those_of_numpys_generator_for_the_seed_and_the_frame_by_ring_and_column(name):
    lattice = COARSE[name]
    draws = Imperfections(0.03, 0.5, seed=8).measurement(lattice, 12)
    for values, stream, expected in (
        (draws.noise_m, 0, lambda rng, shape: np.float32(0.03) * rng.standard_normal(shape, np.float32)),
        (draws.chance, 1, lambda rng, shape: rng.random(shape, np.float32)),
    ):
        rng = np.random.Generator(np.random.PCG64(np.random.SeedSequence(8, spawn_key=(12, stream))))
        np.testing.assert_array_equal(by_column(lattice, values), expected(rng, (lattice.rings, lattice.columns)))


def test_a_firing_column_draws_the_same_wherever_it_points():
    model = load_model("RS-LiDAR-32")
    turned = beam_lattice(model, phase_rad=1.0)
    one, other = (ROUGH.measurement(lattice, 3) for lattice in (FINE["RS-LiDAR-32"], turned))
    assert (one.noise_m != other.noise_m).any()
    for name in ("noise_m", "chance"):
        mine, theirs = getattr(one, name), getattr(other, name)
        np.testing.assert_array_equal(by_column(FINE["RS-LiDAR-32"], mine), by_column(turned, theirs))


def test_a_beam_draws_the_same_under_every_mounting():
    lattice = FINE["RS-16"]
    errors = []
    for pose in MOUNTINGS:
        true, noisy = cloud_of(pose=pose, max_range_m=200.0), cloud_of(ROUGH, pose=pose, max_range_m=200.0)
        _, mine, theirs = np.intersect1d(beams_of(true, lattice), beams_of(noisy, lattice), return_indices=True)
        error = np.full(lattice.rings * lattice.columns, np.nan)
        error[beams_of(true, lattice)[mine]] = noisy.range_m[theirs] - true.range_m[mine]
        errors.append(error)
    both = np.isfinite(errors).all(axis=0)
    assert both.sum() > 2000
    np.testing.assert_allclose(errors[0][both], errors[1][both], atol=1e-10)


def test_noise_is_the_same_with_and_without_drop_out_and_grows_with_sigma():
    noisy, both, double = (Imperfections(sigma, p) for sigma, p in ((0.02, 0.0), (0.02, 0.5), (0.04, 0.0)))
    noise = [each.measurement(FINE["RS-16"], 4).noise_m for each in (noisy, both, double)]
    np.testing.assert_array_equal(noise[0], noise[1])
    np.testing.assert_allclose(noise[2], 2.0 * noise[0], rtol=1e-6)


def test_nothing_is_drawn_where_nothing_is_imperfect():
    model = Imperfections(seed=9).measurement(FINE["RS-16"], 1)
    assert len(model.noise_m) == len(model.chance) == 0
    assert PERFECT.most_noise_m == 0.0
    plain, perfect = cloud_of(), cloud_of(Imperfections(0.0, 0.0, seed=9))
    for name in type(plain).__slots__:
        assert getattr(plain, name).tobytes() == getattr(perfect, name).tobytes()


# --- points -----------------------------------------------------------------------------------------------------------


def test_noise_moves_points_along_their_beams_and_changes_nothing_else():
    true, noisy = cloud_of(max_range_m=200.0), cloud_of(Imperfections(0.3), max_range_m=200.0)
    lattice = FINE["RS-16"]
    _, mine, theirs = np.intersect1d(beams_of(true, lattice), beams_of(noisy, lattice), return_indices=True)
    mount = MOUNTINGS[0].position
    beam = (true.xyz[mine] - mount) / true.range_m[mine, None]
    np.testing.assert_allclose(noisy.xyz[theirs], mount + noisy.range_m[theirs, None] * beam, atol=1e-9)
    assert abs(noisy.range_m[theirs] - true.range_m[mine]).max() > 0.9
    for name in ("ring", "azimuth_rad", "time_s", "vehicle_id", "class_index", "incidence_rad", "intensity"):
        np.testing.assert_array_equal(getattr(noisy, name)[theirs], getattr(true, name)[mine])


def test_the_range_gate_judges_the_measured_range_and_noise_crosses_it_both_ways():
    bus, pose, gate = one_vehicle("bus", centre=(0.0, 20.0)), Pose(height_m=2.0), 18.8
    clouds = [
        cloud_of(each, vehicles=bus, pose=pose, min_range_m=6.0, max_range_m=far)
        for each, far in ((PERFECT, 100.0), (Imperfections(0.4), gate))
    ]
    true = dict(zip(beams_of(clouds[0], FINE["RS-16"]).tolist(), clouds[0].range_m, strict=True))
    measured = dict(zip(beams_of(clouds[1], FINE["RS-16"]).tolist(), clouds[1].range_m, strict=True))
    assert max(measured.values()) <= gate
    assert min(measured.values()) >= 6.0
    beyond = [beam for beam in measured if true[beam] > gate]
    lost = [beam for beam, distance in true.items() if 6.5 < distance < gate and beam not in measured]
    assert len(beyond) > 10
    assert len(lost) > 10


def test_no_return_of_great_noise_lies_behind_the_sensor():
    cloud = cloud_of(Imperfections(10.0), min_range_m=0.0)
    assert len(cloud) > 1000
    assert cloud.range_m.min() >= 0.0


# --- scores -----------------------------------------------------------------------------------------------------------


def observation(lattice, imperfections, caster="exact", gate=50.0):
    return Observation(lattice, gate, 0.4, caster, "body", 0.05, imperfections=imperfections)


def everyone(vehicles):
    return np.ones(len(vehicles), dtype=bool)


def slow_pipeline(vehicles, seen, pose):
    """Points and occupancies: every beam cast without bound, its draws and its point looked at by themselves."""
    lattice, triangles = seen.lattice, vehicle_triangles(vehicles, seen.detail)
    rays = pose.to_world(lattice.directions.reshape(-1, 3))
    hits = caster_class("exact")(triangles.corners).cast(pose.position, rays)
    draws = seen.imperfections.measurement(lattice, vehicles.frame)
    points = np.zeros(len(vehicles), dtype=int)
    cells = [(set(), set(), set()) for _ in range(len(vehicles))]
    for beam in np.flatnonzero(hits.triangle >= 0):
        owner = int(triangles.owner[hits.triangle[beam]])
        distance = hits.distance[beam] + (float(draws.noise_m[beam]) if len(draws.noise_m) else 0.0)
        glass = seen.imperfections.glass_dropout if triangles.surface[hits.triangle[beam]] == GLASS else 0.0
        loss = 1.0 - (1.0 - seen.imperfections.dropout) * (1.0 - glass)
        lost = loss == 1.0 or (len(draws.chance) and draws.chance[beam] < np.float32(loss))
        if lost or not seen.min_range_m <= distance <= seen.max_range_m:
            continue
        points[owner] += 1
        away = pose.position + distance * rays[beam] - vehicles.centre_m[owner]
        heading, size = vehicles.heading_rad[owner], vehicles.size_m[owner]
        local = (
            away[0] * math.cos(heading) + away[1] * math.sin(heading),
            away[1] * math.cos(heading) - away[0] * math.sin(heading),
            away[2],
        )
        place = [(along + 0.5 * side) / seen.cell_m for along, side in zip(local, size, strict=True)]
        count = [math.ceil(side / seen.cell_m - 1e-9) for side in size]
        if any(at < -1.0 or at >= number + 1.0 for at, number in zip(place, count, strict=True)):
            continue
        cell = [min(max(math.floor(at), 0), number - 1) for at, number in zip(place, count, strict=True)]
        for view, (a, b) in zip(cells[owner], ((0, 1), (0, 2), (1, 2)), strict=True):
            view.add((cell[a], cell[b]))
    whole = [[math.ceil(side / seen.cell_m - 1e-9) for side in size] for size in vehicles.size_m]
    shares = [
        [len(view) / (n[a] * n[b]) for view, (a, b) in zip(views, ((0, 1), (0, 2), (1, 2)), strict=True)]
        for views, n in zip(cells, whole, strict=True)
    ]
    return points, np.array(shares)


@settings(max_examples=40)
@given(
    seed=st.integers(0, 2**32 - 1),
    sensor=st.sampled_from(sorted(COARSE)),
    height=st.floats(0.5, 6.0),
    angles=st.tuples(st.floats(-0.7, 0.7), st.floats(-0.3, 0.3), st.floats(-3.0, 3.0)),
    sigma=st.sampled_from([0.0, 0.02, 0.3, 3.0]),
    dropout=st.sampled_from([0.0, 0.1, 0.7]),
    glass_dropout=st.sampled_from([0.0, 0.5, 1.0]),
)
def test_points_and_occupancies_equal_those_of_the_slow_pipeline(
    seed, sensor, height, angles, sigma, dropout, glass_dropout
):
    vehicles = dense_traffic(seed=seed, vehicles=8, length_m=30.0, frame=seed % 100)
    seen = observation(COARSE[sensor], Imperfections(sigma, dropout, glass_dropout=glass_dropout, seed=seed), gate=20.0)
    pose = Pose(0.0, 0.0, height, *angles)
    found = FrameScorer(vehicles, everyone(vehicles), seen).see([pose])
    points, shares = slow_pipeline(vehicles, seen, pose)
    np.testing.assert_array_equal(found.points[0], points)
    np.testing.assert_allclose(found.occupancy[0], shares, rtol=1e-12, atol=0.0)


@pytest.mark.parametrize("sigma", [0.02, 0.3])
@pytest.mark.parametrize("pose", MOUNTINGS, ids=["tilted", "turned"])
@pytest.mark.parametrize("sensor", sorted(FINE))
def test_a_scan_and_its_score_equal_what_the_frame_scorer_sees(sensor, pose, sigma):
    imperfections = Imperfections(sigma, 0.1, seed=3)
    cloud = cloud_of(imperfections, FINE[sensor], pose=pose, max_range_m=50.0)
    seen = FrameScorer(TRAFFIC, everyone(TRAFFIC), observation(FINE[sensor], imperfections)).see([pose])
    mine = cloud.vehicle_id >= 0
    row = np.searchsorted(TRAFFIC.vehicle_id, cloud.vehicle_id[mine])
    np.testing.assert_array_equal(seen.points[0], np.bincount(row, minlength=len(TRAFFIC)))
    local = to_vehicle_frame(cloud.xyz[mine], TRAFFIC.centre_m, TRAFFIC.heading_rad, row)
    expected = occupancy(local, row, TRAFFIC.size_m)
    off = (abs(local) > 0.5 * TRAFFIC.size_m[row] + 0.05).any(axis=1)
    assert off.mean() > (0.1 if sigma > 0.1 else 0.0005)  # dropped from the grids
    assert (abs(local) < 0.5 * TRAFFIC.size_m[row] - 0.001).all(axis=1).mean() > 0.1  # inside the vehicle
    np.testing.assert_allclose(seen.occupancy[0], expected, rtol=1e-12)
    np.testing.assert_allclose(entropy(seen.occupancy[0]).sum(), entropy(expected).sum(), rtol=1e-12)


def test_mountings_together_and_one_by_one_and_in_any_order_see_the_same():
    scorer = FrameScorer(TRAFFIC, everyone(TRAFFIC), observation(COARSE["RS-LiDAR-32"], ROUGH))
    rng = np.random.default_rng(3)
    poses = [Pose(0.0, 0.0, rng.uniform(2, 4.5), rng.uniform(0, 0.4)) for _ in range(12)]
    together, backwards = scorer.see(poses), scorer.see(poses[::-1])
    np.testing.assert_array_equal(backwards.occupancy[::-1], together.occupancy)
    for number, pose in enumerate(poses):
        alone = FrameScorer(TRAFFIC, everyone(TRAFFIC), observation(COARSE["RS-LiDAR-32"], ROUGH)).see([pose])
        np.testing.assert_array_equal(together.points[number], alone.points[0])
        np.testing.assert_array_equal(together.occupancy[number], alone.occupancy[0])


def test_what_counts_changes_nothing_for_the_others():
    seen = observation(COARSE["RS-16"], ROUGH)
    counted = np.random.default_rng(1).random(len(TRAFFIC)) < 0.4
    whole = FrameScorer(TRAFFIC, everyone(TRAFFIC), seen).see(MOUNTINGS)
    part = FrameScorer(TRAFFIC, counted, seen).see(MOUNTINGS)
    np.testing.assert_array_equal(part.points, whole.points[:, counted])
    np.testing.assert_array_equal(part.occupancy, whole.occupancy[:, counted])


@pytest.mark.parametrize("caster", [name for name in CASTERS if name != "exact"])
def test_every_caster_finds_the_same(caster):
    if not is_available(caster):
        pytest.skip(f"the library of {caster} is not installed")
    found, expected = (
        FrameScorer(TRAFFIC, everyone(TRAFFIC), observation(FINE["RS-16"], ROUGH, name)).see(MOUNTINGS)
        for name in (caster, "exact")
    )
    np.testing.assert_array_equal(found.points, expected.points)
    np.testing.assert_array_equal(found.occupancy, expected.occupancy)
    fast, exact = cloud_of(ROUGH, caster=caster), cloud_of(ROUGH)
    np.testing.assert_array_equal(fast.ring, exact.ring)
    np.testing.assert_array_equal(fast.vehicle_id, exact.vehicle_id)
    np.testing.assert_allclose(fast.xyz, exact.xyz, atol=1e-9)


def test_one_worker_and_two_give_the_same_bits():
    frames = [
        CountedFrame(vehicles, everyone(vehicles))
        for vehicles in (dense_traffic(seed=n, vehicles=15, length_m=60.0, frame=10 * n) for n in range(4))
    ]
    scoring, seen = Scoring(0.005, "mean", -1.0, "corrected"), observation(COARSE["RS-16"], ROUGH)
    found = []
    for workers in (1, 2):
        with Evaluator(frames, seen, scoring, workers) as evaluator:
            found.append(evaluator.totals(MOUNTINGS).objective)
    assert found[0].tobytes() == found[1].tobytes()
    with Evaluator(frames, replace(seen, imperfections=PERFECT), scoring) as evaluator:
        assert (evaluator.totals(MOUNTINGS).objective != found[0]).any()


# --- settings that cannot be ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("given", "named"),
    [
        ({"range_noise_m": -0.01}, "range_noise_m is -0.01; allowed: 0 to 10"),
        ({"range_noise_m": math.nan}, "range_noise_m is nan"),
        ({"range_noise_m": 11.0}, "range_noise_m is 11"),
        ({"dropout": 1.0}, "dropout is 1.0; allowed: at least 0 and below 1"),
        ({"dropout": -0.1}, "dropout is -0.1"),
        ({"dropout": math.nan}, "dropout is nan"),
        ({"glass_dropout": 1.01}, "glass_dropout is 1.01; allowed: 0 to 1"),
        ({"glass_dropout": -0.1}, "glass_dropout is -0.1"),
        ({"glass_dropout": math.nan}, "glass_dropout is nan"),
        ({"range_at_10_percent_m": 0.0}, "range_at_10_percent_m is 0.0; allowed: more than 0"),
        ({"range_at_10_percent_m": math.inf}, "range_at_10_percent_m is inf"),
        ({"range_at_10_percent_m": math.nan}, "range_at_10_percent_m is nan"),
        ({"seed": -1}, "seed is -1; allowed: a whole number, 0 or more"),
        ({"seed": 0.5}, "seed is 0.5"),
    ],
)
def test_imperfections_that_cannot_be_are_refused(given, named):
    with pytest.raises(InputError, match=named):
        Imperfections(**given)
