"""Recorded roadside clouds beside our shapes: how they are read, and the medians by which candidates are judged."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

pytest.importorskip("scipy", reason="SciPy is not installed")

import tests.research  # noqa: F401
from blender_lidar.clouds.rings import table_rings
from blender_lidar.metrics.assignment import NO_BOX, points_in_boxes
from blender_lidar.sensors.beams import beam_lattice
from blender_lidar.sensors.model import load_model
from compare_roadside import CLEARANCE_M, _medians, difference
from draw_roadside import main as draw
from roadside_clouds import roadside_frames

ROADSIDE = Path(__file__).parents[1].parent / "shared" / "data" / "chengdu"
needs_roadside = pytest.mark.skipif(not ROADSIDE.is_dir(), reason=f"no recorded roadside clouds at {ROADSIDE}")


@pytest.fixture(scope="module")
def frames():
    return list(roadside_frames(ROADSIDE))


@needs_roadside
def test_seen_from_the_axis_all_points_lie_on_the_rings_of_the_beam_table(frames):
    lattice = beam_lattice(load_model("RS-Ruby-Lite-V2R"))
    shares = [table_rings(pose.to_sensor(frame.points), lattice)[1] for frame, pose, _ in frames]
    assert min(shares) > 0.97


@needs_roadside
def test_near_roads_are_level_and_fitted_boxes_hold_points(frames):
    for frame, _, sure in frames:
        side = 1.0 if frame.boxes.centre_m[0, 1] > 0.0 else -1.0
        x, y, z = frame.points.T
        road = z[(side * y > 3.0) & (side * y < 15.0) & (x > 10.0) & (x < 40.0) & (np.abs(z) < 0.15)]
        assert abs(np.median(road)) < 0.03
        boxes = frame.boxes
        row = points_in_boxes(frame.points, boxes.centre_m, boxes.size_m, boxes.heading_rad, CLEARANCE_M)
        held = np.bincount(row[row != NO_BOX], minlength=len(boxes))
        assert (held[np.isin(sure, ["A", "B"])] >= 25).all()


@given(seed=st.integers(0, 2**32 - 1))
def test_resampled_medians_are_medians_of_values_written_out(seed):
    rng = np.random.default_rng(seed)
    values, weights = rng.integers(0, 9, 7).astype(float), rng.integers(0, 3, (5, 7)).astype(float)
    for found, row in zip(_medians(values, weights), weights.astype(int), strict=True):
        every = np.repeat(values, row)
        assert found == np.median(every) if len(every) else np.isnan(found)


def test_an_error_less_itself_is_nothing_and_less_a_larger_one_below_nothing():
    rng = np.random.default_rng(1)
    of = {"error": rng.normal(0.0, 0.1, 60), "distance_m": rng.uniform(10.0, 110.0, 60)}
    frame = rng.integers(0, 8, 60)
    assert difference(of, of, frame) == (0.0, 0.0, 0.0)
    gap, low, high = difference(of, {**of, "error": 2.0 * of["error"]}, frame)
    assert low <= gap <= high < 0.0


@needs_roadside
def test_real_clouds_are_drawn_and_asphalt_returns_nearby_and_not_far_off(tmp_path, capsys):
    pytest.importorskip("matplotlib")
    assert draw(["--roadside", str(ROADSIDE), "--draw", str(tmp_path / "drawn")]) == 0
    assert {path.name for path in (tmp_path / "drawn").iterdir()} == {"roadside.png", "points.png"}
    rows = [line.strip("| ").split(" | ") for line in capsys.readouterr().out.splitlines()]
    share = {row[0]: float(row[2]) for row in rows if len(row) == 4 and row[0][0].isdigit()}
    assert share["20-25"] > 99.0 > 75.0 > share["55-60"] > 25.0 > 10.0 > share["70-75"]


def test_a_folder_without_clouds_is_one_line(tmp_path, capsys):
    assert draw(["--roadside", str(tmp_path), "--draw", str(tmp_path / "drawn")]) != 0
    assert "vehicles_fitted.csv: there is no such file" in capsys.readouterr().err
    assert not (tmp_path / "drawn").exists()
