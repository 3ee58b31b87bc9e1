"""A sensor's beams spread evenly: what changes and what stays."""

from __future__ import annotations

import numpy as np
import pytest

from blender_lidar.sensors.beams import beam_lattice
from blender_lidar.sensors.model import load_model, model_names
from blender_lidar.sensors.spacing import evenly_spaced


@pytest.mark.parametrize("name", model_names())
def test_even_beams_have_the_same_number_and_the_same_ends_and_one_step(name):
    model, even = load_model(name), evenly_spaced(load_model(name))
    assert even.rings == model.rings
    assert even.elevation_rad[[0, -1]].tolist() == model.elevation_rad[[0, -1]].tolist()
    steps = np.diff(even.elevation_rad)
    np.testing.assert_allclose(steps, np.ptp(model.elevation_rad) / (model.rings - 1), rtol=1e-9)
    assert not even.elevation_rad.flags.writeable


def test_nothing_but_the_elevations_changes():
    model, even = load_model("RS-80"), evenly_spaced(load_model("RS-80"))
    assert even.azimuth_offset_rad is model.azimuth_offset_rad
    for key in ("rotation_hz", "block_time_s", "range_min_m", "range_max_m"):
        assert getattr(even, key) == getattr(model, key)
    old, new = beam_lattice(model), beam_lattice(even)
    assert new.columns == old.columns
    np.testing.assert_array_equal(new.slot_azimuth0_rad, old.slot_azimuth0_rad)
    assert np.ptp(np.diff(model.elevation_rad)) > 0.01  # the real one is uneven


def test_an_even_sensor_stays_as_it_is():
    model = load_model("RS-32")
    np.testing.assert_allclose(evenly_spaced(model).elevation_rad, model.elevation_rad, atol=1e-12)


def test_its_name_says_that_nobody_builds_it():
    even = evenly_spaced(load_model("RS-80"))
    assert even.name == "RS-80 evenly spaced"
    assert "no such sensor" in even.confidence
    assert even.aliases == ()
