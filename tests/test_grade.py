"""A recording's own heights beside [road] grade_percent: alike, of the wrong sign, or with a crest."""

from __future__ import annotations

import csv

import numpy as np
import pytest

from blender_lidar.cli import main
from blender_lidar.errors import InputError
from blender_lidar.scene.place_checks import grades_percent
from blender_lidar.scene.scenario import load_scenario
from blender_lidar.scene.site import read_recording
from tests.small_scene import HEADER, traffic_rows, write_scene, write_table


def recording_of(folder, grade, rises, reach_m=140.0, **road):
    """A table whose z_m rises along x, of a scene with such a grade."""
    rows = []
    for row in traffic_rows(vehicles=80):
        row[3] = row[3] * reach_m / 40.0
        rows.append([*row, row[7] / 2 + rises(row[3])])
    write_table(folder / "traffic.csv", rows, (*HEADER, "z_m"))
    changes = {"road": {"grade_percent": grade, **road}, "traffic": {"accept": ["time-step", "tracks"]}}
    return read_recording(load_scenario(write_scene(folder, changes)))


def test_the_slope_is_found_on_either_side():
    x = np.linspace(-120.0, 120.0, 800)
    ground = np.column_stack([x, np.zeros(800), np.where(x < 0.0, 0.03 * x, -0.05 * x) + 412.0])
    assert grades_percent(ground, 0.0) == pytest.approx((3.0, -5.0), abs=1e-9)
    assert grades_percent(ground[:20], 0.0) is None
    assert grades_percent(ground + np.array([0.0, 90.0, 0.0]), 0.0) is None


@pytest.mark.parametrize("grade", [5.0, -3.0])
def test_heights_of_the_roads_own_grade_put_the_boxes_on_its_plane(tmp_path, grade):
    recording = recording_of(tmp_path, grade, lambda x: 0.01 * grade * x)
    np.testing.assert_allclose(recording.centre_m[:, 2], recording.size_m[:, 2] / 2)


def test_on_a_level_road_a_slope_that_its_grade_allows_puts_the_boxes_on_it_too(tmp_path):
    recording = recording_of(tmp_path, 0.0, lambda x: 412.0 + 0.008 * x)
    np.testing.assert_allclose(recording.centre_m[:, 2], recording.size_m[:, 2] / 2)


@pytest.mark.parametrize("said", [0.0, -5.0])
def test_a_grade_of_the_wrong_sign_or_left_out_stops(tmp_path, said):
    expected = rf"rise by \+5\.0 % along x, and \[road\] grade_percent says {said:g}; probably it should be 5\.0"
    with pytest.raises(InputError, match=expected) as caught:
        recording_of(tmp_path, said, lambda x: 0.05 * x)
    assert "--accept grade" in str(caught.value)


def test_a_crest_stops(tmp_path):
    with pytest.raises(InputError, match=r"make a crest at the region, from \+5\.0 to -5\.0 % along x"):
        recording_of(tmp_path, 0.0, lambda x: -0.05 * abs(x))


def test_init_proposes_the_grade_of_the_file_and_its_scene_is_read(tmp_path):
    rows = []
    for step in range(60):
        for number in range(20):
            x = -300.0 + 30.0 * number + 10.0 * step
            rows.append(
                [step, number, "car", x, 2.0 + 3.5 * (number % 2), 4.5, 1.8, 1.5, 0.0, float(step), 0.75 + 0.04 * x]
            )
    write_table(tmp_path / "cars.csv", rows, (*HEADER, "z_m"))
    assert main(["init", str(tmp_path / "site"), str(tmp_path / "cars.csv")]) == 0
    text = (tmp_path / "site" / "scene.toml").read_text(encoding="utf-8")
    assert "grade_percent = 4.0  # how the file's heights rise" in text
    recording = read_recording(load_scenario(tmp_path / "site" / "scene.toml"))
    assert np.ptp(recording.centre_m[:, 2]) < 1e-9
    with (tmp_path / "cars.csv").open(newline="") as stream:
        assert len(list(csv.reader(stream))) == len(rows) + 1
