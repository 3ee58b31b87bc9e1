"""CSV tables: every value comes back, and a run's vehicles are boxes that we and `score` can read."""

from __future__ import annotations

import csv
from dataclasses import replace

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from blender_lidar.files import to_csv, write_columns
from blender_lidar.run.vehicle_table import VEHICLE_COLUMNS, vehicle_table
from blender_lidar.scene.mounting import Mounting
from blender_lidar.scene.observation import Observation, Scoring
from blender_lidar.scoring.evaluation import Evaluator
from blender_lidar.sensors.beams import beam_lattice
from blender_lidar.sensors.lidar import Lidar
from blender_lidar.sensors.model import load_model
from blender_lidar.traffic import read_table
from tests.sample_traffic import dense_traffic


def read(path):
    """Columns of a CSV file as text."""
    with path.open(newline="", encoding="utf-8") as stream:
        header, *rows = csv.reader(stream)
    return {name: [row[number] for row in rows] for number, name in enumerate(header)}


@given(st.lists(st.floats(allow_nan=False), max_size=20))
def test_floats_come_back_bit_for_bit(values):
    text = to_csv(["value"], [[repr(value)] for value in values])
    assert [float(line) for line in text.splitlines()[1:]] == values


def test_columns_of_every_kind_come_back(tmp_path):
    columns = {
        "number": np.array([0.1, -1e-300, 1e300, np.pi]),
        "whole": np.array([1, -2, 2**53, 0], dtype=np.int64),
        "small": np.array([0.1, 0.2, 0.3, 0.4], dtype=np.float32),
        "flag": np.array([True, False, True, False]),
        "name": np.array(["car", 'a "b", c', "two\nlines", "größer"]),
    }
    write_columns(tmp_path / "table.csv", columns)
    content = read(tmp_path / "table.csv")
    assert list(content) == list(columns)
    assert [float(text) for text in content["number"]] == columns["number"].tolist()
    assert [int(text) for text in content["whole"]] == columns["whole"].tolist()
    np.testing.assert_array_equal(np.array(content["small"], dtype=np.float32), columns["small"])
    assert content["flag"] == ["1", "0", "1", "0"]
    assert content["name"] == columns["name"].tolist()


def test_the_vehicles_of_a_run_are_a_table_of_boxes(tmp_path):
    lattice = beam_lattice(load_model("RS-16"), stride=20)
    seen = Observation((Lidar(lattice, 40.0, 0.4),), "exact", "box", 0.05)
    vehicles = dense_traffic(vehicles=15, length_m=60.0, frame=30)
    frame = replace(vehicles, counted=np.arange(15) % 3 > 0)
    evaluator = Evaluator([frame], seen, Scoring(0.005, "mean", -1.0, "corrected"))
    table = vehicle_table((Mounting(height_m=4.0),), search=evaluator)
    write_columns(tmp_path / "vehicles.csv", {name: table[name] for name in VEHICLE_COLUMNS})
    boxes = read_table(tmp_path / "vehicles.csv").at(30)
    counted = vehicles.select(frame.counted)
    np.testing.assert_array_equal(boxes.vehicle_id, counted.vehicle_id)
    np.testing.assert_array_equal(boxes.class_index, counted.class_index)
    np.testing.assert_array_equal(boxes.centre_m, counted.centre_m)
    np.testing.assert_array_equal(boxes.size_m, counted.size_m)
    np.testing.assert_array_equal(boxes.lane, counted.lane)
    np.testing.assert_allclose(boxes.heading_rad, counted.heading_rad, atol=1e-12)
