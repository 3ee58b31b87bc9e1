"""Range noise and drop-out: their statistics, that they belong to the beam and the frame alone, and where they end."""

from __future__ import annotations

import math

import numpy as np
import pytest

from blender_lidar.errors import InputError
from blender_lidar.scene.mounting import Mast, Mounting
from blender_lidar.sensors.beams import beam_lattice
from blender_lidar.sensors.imperfections import PERFECT, Imperfections
from blender_lidar.sensors.model import load_model, unit_of
from blender_lidar.sensors.pose import Pose
from tests.sample_traffic import dense_traffic, one_vehicle, scan

pytestmark = pytest.mark.versions

FINE = {name: beam_lattice(load_model(name)) for name in ("RS-16", "RS-LiDAR-32")}
COARSE = {
    "RS-16": beam_lattice(load_model("RS-16"), stride=20),
    "RS-LiDAR-32": beam_lattice(load_model("RS-LiDAR-32"), stride=20),  # azimuth offsets: slots are not columns
    "a unit of RS-80": beam_lattice(unit_of(load_model("RS-80"), 0.1, 3), stride=50),
}
TRAFFIC = dense_traffic(vehicles=40, length_m=100.0, frame=7)
MOUNTINGS = [Mounting(height_m=4.1, tilt_x=0.33), Mounting(Mast((1.0, -0.5, 0.0)), 2.6, 0.1, 0.07, -0.5)]
LAYOUTS, POSES = [(one,) for one in MOUNTINGS], [one.pose for one in MOUNTINGS]
ROUGH = Imperfections(0.05, 0.2, glass_dropout=0.4, seed=5)


def cloud_of(imperfections=PERFECT, lattice=FINE["RS-16"], vehicles=TRAFFIC, pose=POSES[0], **changes):
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
    for pose in POSES:
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
    mount = POSES[0].position
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
    ],
)
def test_imperfections_that_cannot_be_are_refused(given, named):
    with pytest.raises(InputError, match=named):
        Imperfections(**given)
