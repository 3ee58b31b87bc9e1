"""Eq. 1 and the lattice of one turn, against a slow loop over (ring, firing column); and one unit of a sensor."""

from __future__ import annotations

import math
import pickle

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from blender_lidar.errors import InputError
from blender_lidar.names import MOST_SPREAD_DEG
from blender_lidar.sensors.beams import BeamLattice, beam_directions, beam_lattice
from blender_lidar.sensors.model import LidarModel, load_model, model_names, unit_of

pytestmark = pytest.mark.versions

TURN = 2.0 * math.pi


def small_model(offsets_rad: list[float], columns: int, fire_s: list[float] | None = None) -> LidarModel:
    rings = len(offsets_rad)
    return LidarModel(
        name="small",
        elevation_rad=np.linspace(-0.4, 0.2, rings),
        azimuth_offset_rad=np.array(offsets_rad),
        fire_time_s=np.full(rings, np.nan) if fire_s is None else np.array(fire_s),
        default_rotation_hz=10.0,
        block_time_us=1e5 / columns,
    )


def assert_equals_slow_loop(lattice: BeamLattice, phase_rad: float = 0.0) -> None:
    """Every (ring, firing column) must stand in the lattice once, with its direction, azimuth and time."""
    model, columns = lattice.model, lattice.columns
    slot_of = np.full((lattice.rings, columns), -1)
    for ring in range(lattice.rings):
        column = lattice.column(ring, np.arange(columns))
        slot_of[ring, column] = np.arange(columns)
    assert np.all(slot_of >= 0)
    ring_index = np.arange(lattice.rings)[:, None]
    directions = lattice.directions[ring_index, slot_of]
    azimuths = lattice.azimuth_rad(ring_index, slot_of)
    times = lattice.time_s(ring_index, slot_of)
    for ring in range(lattice.rings):
        elevation = float(model.elevation_rad[ring])
        offset = float(model.azimuth_offset_rad[ring])
        fire = float(model.fire_time_s[ring])
        for column in range(columns):
            azimuth = phase_rad + column * TURN / columns + offset
            x = math.sin(azimuth) * math.cos(elevation)
            y = math.cos(azimuth) * math.cos(elevation)
            z = math.sin(elevation)
            found = directions[ring, column]
            assert abs(found[0] - x) + abs(found[1] - y) + abs(found[2] - z) < 1e-12
            turns = (azimuths[ring, column] - azimuth) / TURN
            assert abs(turns - round(turns)) < 1e-12
            time = column / (lattice.rotation_hz * columns) + (0.0 if math.isnan(fire) else fire)
            assert abs(times[ring, column] - time) < 1e-12


def assert_sorted_by_azimuth(lattice: BeamLattice) -> None:
    assert np.all(lattice.slot_azimuth0_rad >= 0.0)
    assert np.all(lattice.slot_azimuth0_rad < lattice.step_rad)
    azimuth = lattice.azimuth_rad(np.arange(lattice.rings)[:, None], np.arange(lattice.columns))
    assert np.all(azimuth >= 0.0)
    assert np.all(azimuth < TURN)
    assert np.all(np.diff(azimuth, axis=1) > 0.0)


@pytest.mark.parametrize(
    ("azimuth_deg", "elevation_deg", "direction"),
    [(0, 0, (0, 1, 0)), (90, 0, (1, 0, 0)), (180, 0, (0, -1, 0)), (270, 0, (-1, 0, 0)), (0, 90, (0, 0, 1))],
)
def test_azimuth_runs_from_plus_y_clockwise_towards_plus_x(azimuth_deg, elevation_deg, direction):
    found = beam_directions(math.radians(azimuth_deg), math.radians(elevation_deg))
    np.testing.assert_allclose(found, direction, atol=1e-15)


def test_directions_broadcast_and_have_unit_length():
    directions = beam_directions(np.linspace(0.0, 7.0, 5), np.linspace(-1.5, 1.5, 3)[:, None])
    assert directions.shape == (3, 5, 3)
    assert directions.flags.c_contiguous
    np.testing.assert_allclose(np.linalg.norm(directions, axis=-1), 1.0)
    np.testing.assert_allclose(
        np.arctan2(directions[..., 2], np.hypot(directions[..., 0], directions[..., 1]))[:, 0],
        np.linspace(-1.5, 1.5, 3),
    )


@pytest.mark.parametrize("name", model_names())
def test_the_lattice_of_every_model_equals_a_slow_loop(name):
    model = load_model(name)
    lattice = beam_lattice(model)
    assert lattice.columns == model.columns()
    assert lattice.step_rad == TURN / lattice.columns
    assert lattice.directions.shape == (model.rings, lattice.columns, 3)
    assert lattice.directions.dtype == np.float64
    assert lattice.components.flags.c_contiguous
    assert_sorted_by_azimuth(lattice)
    assert_equals_slow_loop(lattice)


@given(
    offsets=st.lists(st.floats(-math.pi, math.pi), min_size=1, max_size=5),
    columns=st.integers(1, 40),
    phase=st.floats(-100.0, 100.0),
)
def test_any_lattice_equals_a_slow_loop(offsets, columns, phase):
    lattice = beam_lattice(small_model(offsets, columns), phase_rad=phase)
    assert lattice.columns == columns
    assert_sorted_by_azimuth(lattice)
    assert_equals_slow_loop(lattice, phase)


@given(offset=st.sampled_from([-1e-300, -1e-17, -1e-16, 0.0, 1e-16, math.pi, -math.pi]), columns=st.integers(1, 4000))
def test_offsets_on_the_edge_of_a_slot_or_of_the_turn_stay_in_range(offset, columns):
    lattice = beam_lattice(small_model([offset], columns))
    assert_sorted_by_azimuth(lattice)
    assert 0 <= lattice.shift[0] < columns


@pytest.mark.parametrize("name", ["RS-80", "RS-LiDAR-32", "HDL-64E-S2"])
def test_an_interval_of_azimuths_is_a_contiguous_range_of_slots_in_every_ring(name):
    lattice = beam_lattice(load_model(name))
    azimuth = np.arctan2(lattice.directions[..., 0], lattice.directions[..., 1]) % TURN
    inside = (azimuth > 1.0) & (azimuth < 1.5)
    assert np.all(np.abs(np.diff(inside.astype(int), axis=1)).sum(axis=1) == 2)


def test_the_beams_of_one_firing_column_look_where_their_offsets_say():
    model = load_model("RS-80")
    lattice = beam_lattice(model)
    ring = np.arange(model.rings)
    slot = (300 + lattice.shift) % lattice.columns
    np.testing.assert_array_equal(lattice.column(ring, slot), 300)
    expected = 300 * lattice.step_rad + model.azimuth_offset_rad
    np.testing.assert_allclose(lattice.azimuth_rad(ring, slot), expected, atol=1e-12)


def test_time_is_the_columns_plus_the_rings_own():
    lattice = beam_lattice(small_model([0.0, 0.0], 100, fire_s=[2e-6, math.nan]))
    np.testing.assert_allclose(lattice.time_s(np.array([0, 1]), np.array([50, 50])), [0.05 + 2e-6, 0.05])


def test_times_of_a_turn_fill_the_turn():
    lattice = beam_lattice(load_model("RS-16"), 20.0)
    times = lattice.time_s(np.arange(16)[:, None], np.arange(lattice.columns))
    assert times.min() == 0.0
    assert 1 / 20 - 55.5e-6 < times.max() < 1 / 20


@pytest.mark.parametrize("name", ["RS-80", "RS-LiDAR-32"])
def test_a_phase_turns_every_beam_clockwise(name):
    model = load_model(name)
    plain, turned = beam_lattice(model), beam_lattice(model, phase_rad=0.3)
    ring = np.arange(model.rings)[:, None]
    column = np.arange(plain.columns)
    before = plain.azimuth_rad(ring, (column + plain.shift[:, None]) % plain.columns)
    after = turned.azimuth_rad(ring, (column + turned.shift[:, None]) % turned.columns)
    np.testing.assert_allclose((after - before) % TURN, 0.3, atol=1e-12)


def test_a_stride_keeps_every_kth_firing_column():
    model = load_model("RS-80")
    whole, coarse = beam_lattice(model), beam_lattice(model, stride=4)
    assert coarse.columns * 4 == whole.columns
    ring, column = np.arange(model.rings)[:, None], np.arange(coarse.columns)
    kept = whole.directions[ring, (4 * column + whole.shift[:, None]) % whole.columns]
    found = coarse.directions[ring, (column + coarse.shift[:, None]) % coarse.columns]
    np.testing.assert_allclose(found, kept, atol=1e-12)
    same_time = whole.time_s(ring, (4 * column + whole.shift[:, None]) % whole.columns)
    np.testing.assert_allclose(coarse.time_s(ring, (column + coarse.shift[:, None]) % coarse.columns), same_time)


def test_a_stride_that_does_not_divide_the_turn_still_covers_it_evenly():
    lattice = beam_lattice(load_model("RS-16"), stride=4)  # 1802 columns
    assert lattice.columns == 450
    assert_sorted_by_azimuth(lattice)
    assert_equals_slow_loop(lattice)


@pytest.mark.parametrize("stride", [0, -1, 1803, 1.5, math.nan])
def test_a_stride_out_of_range_is_refused(stride):
    with pytest.raises(InputError, match=r"stride is .*; allowed: whole numbers from 1 to the 1802 columns"):
        beam_lattice(load_model("RS-16"), stride=stride)


def test_a_lattice_cannot_be_changed_and_survives_pickling():
    lattice = beam_lattice(load_model("RS-16"))
    with pytest.raises(ValueError, match="read-only"):
        lattice.directions[0, 0, 0] = 1.0
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(lattice)).directions, lattice.directions)


# --- one unit of a sensor, whose beams are off by what was asked for --------------------------------------------------


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
