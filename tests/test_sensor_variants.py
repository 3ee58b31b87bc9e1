"""One unit of a sensor, whose beams are off by what was asked for."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from blender_lidar.errors import InputError
from blender_lidar.sensors.beams import beam_lattice
from blender_lidar.sensors.model import MOST_SPREAD_DEG, load_model, model_names, unit_of

WIDE = load_model("RS-16")  # rings 2 degrees apart: small errors leave their order
LADDER = load_model("RS-80")  # rings 0.1 degree apart


def errors_deg(model, spread_deg, unit):
    made = unit_of(model, spread_deg, unit)
    pairs = ((made.elevation_rad, model.elevation_rad), (made.azimuth_offset_rad, model.azimuth_offset_rad))
    return np.degrees([mine - nominal for mine, nominal in pairs])


def test_without_a_spread_every_unit_is_the_model():
    assert unit_of(WIDE, 0.0, 7) is WIDE


def test_errors_of_many_units_have_the_spread_that_was_asked_for_and_no_bias():
    errors = np.array([errors_deg(WIDE, 0.03, unit) for unit in range(500)]) / 0.03  # (units, 2, rings)
    count = errors.size
    assert abs(errors.mean()) < 4.0 / math.sqrt(count)
    assert abs(errors.std() - 1.0) < 4.0 / math.sqrt(2.0 * count)
    assert (abs(errors.mean(axis=0)) < 4.5 / math.sqrt(len(errors))).all()
    assert abs(np.corrcoef(errors[:, 0].ravel(), errors[:, 1].ravel())[0, 1]) < 4.0 / math.sqrt(count / 2)
    assert abs(np.corrcoef(errors[:-1].ravel(), errors[1:].ravel())[0, 1]) < 4.0 / math.sqrt(count)


def test_the_same_unit_has_the_same_errors_in_proportion_to_the_spread():
    np.testing.assert_array_equal(errors_deg(WIDE, 0.03, 4), errors_deg(WIDE, 0.03, 4))
    np.testing.assert_allclose(errors_deg(WIDE, 0.06, 4), 2.0 * errors_deg(WIDE, 0.03, 4), atol=1e-12)
    assert (errors_deg(WIDE, 0.03, 4) != errors_deg(WIDE, 0.03, 5)).all()


@pytest.mark.parametrize("name", model_names())
def test_rings_are_numbered_from_this_units_lowest_beam_and_keep_what_is_theirs(name):
    """Beams are known by the azimuth offset and the firing time that they bring along."""
    model, spread = load_model(name), 0.05
    made = unit_of(model, spread, 3)
    assert made.rings == model.rings
    assert (np.diff(made.elevation_rad) >= 0.0).all()
    error = math.radians(spread) * np.random.Generator(np.random.PCG64(3)).standard_normal((2, model.rings))
    beams = np.array([model.elevation_rad + error[0], model.azimuth_offset_rad + error[1], model.fire_time_s]).T
    expected = sorted(map(tuple, beams.tolist()))
    found = zip(made.elevation_rad.tolist(), made.azimuth_offset_rad.tolist(), made.fire_time_s.tolist(), strict=True)
    np.testing.assert_array_equal(list(found), expected)


def test_beams_of_a_fine_ladder_change_places():
    assert (np.diff(LADDER.elevation_rad + np.radians(errors_deg_unsorted(LADDER, 0.1, 1))) < 0.0).any()
    assert (np.diff(unit_of(LADDER, 0.1, 1).elevation_rad) > 0.0).all()


def errors_deg_unsorted(model, spread_deg, unit):
    return spread_deg * np.random.Generator(np.random.PCG64(unit)).standard_normal((2, model.rings))[0]


@settings(max_examples=50)
@given(st.sampled_from(["RS-16", "RS-80", "RS-LiDAR-32"]), st.floats(0.0, MOST_SPREAD_DEG), st.integers(0, 2**53))
def test_a_unit_makes_a_lattice_as_any_sensor_does(name, spread, unit):
    made = unit_of(load_model(name), spread, unit)
    lattice = beam_lattice(made, stride=50)
    assert (np.diff(lattice.elevation_rad) >= 0.0).all()
    assert ((lattice.slot_azimuth0_rad >= 0.0) & (lattice.slot_azimuth0_rad < lattice.step_rad)).all()
    np.testing.assert_allclose(np.linalg.norm(lattice.directions, axis=-1), 1.0, rtol=1e-12)


def test_a_units_arrays_cannot_be_changed():
    made = unit_of(WIDE, 0.03, 1)
    for values in (made.elevation_rad, made.azimuth_offset_rad, made.fire_time_s):
        assert not values.flags.writeable


@pytest.mark.parametrize(
    ("spread", "unit", "named"),
    [
        (-0.1, 1, "spread between units is -0.1 degrees; allowed: 0 to 5"),
        (math.nan, 1, "spread between units is nan"),
        (5.1, 1, "spread between units is 5.1"),
        (0.1, -1, "unit is -1; allowed: a whole number, 0 or more"),
        (0.1, 1.5, "unit is 1.5"),
    ],
)
def test_a_spread_or_unit_that_cannot_be_is_refused(spread, unit, named):
    with pytest.raises(InputError, match=named):
        unit_of(WIDE, spread, unit)


@pytest.mark.parametrize(("unit", "ring"), [(1, 30), (2, 30), (4, 31)])
def test_a_beam_beyond_the_vertical_is_refused_with_the_unit_and_the_ring(unit, ring):
    dome = load_model("RS-BPearl")
    upright = np.degrees(dome.elevation_rad[ring]) + errors_deg_unsorted(dome, 4.0, unit)[ring]
    assert upright > 90.0
    with pytest.raises(InputError, match=f"unit {unit} of RS-BPearl has ring {ring} at {upright:.2f} degrees with a s"):
        unit_of(dome, 4.0, unit)


@pytest.mark.parametrize("unit", [0, 3, 5, 7])
def test_a_unit_whose_beams_all_stay_below_the_vertical_is_taken(unit):
    assert abs(unit_of(load_model("RS-BPearl"), 4.0, unit).elevation_rad).max() <= 0.5 * math.pi
