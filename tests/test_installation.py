"""The installation sheet says where the sensor really looks."""

from __future__ import annotations

import math
import re

import numpy as np
import pytest

from blender_lidar.document import ANSWER, DOUBT, Document, Quantity, as_json, statement
from blender_lidar.report.installation import installation_text
from blender_lidar.scene.scenario import load_scenario
from blender_lidar.scene.site import prepare
from tests.small_scene import done, mounting, without_charts, write_scene

MOUNT = {"x_m": 0.0, "y_m": 0.0, "height_m": 4.0, "tilt_x_deg": 15.0, "tilt_y_deg": 0.0, "yaw_deg": 0.0}
DOCUMENT = Document(
    "RS-16 at crossing, judged on 40 boxes",
    (
        statement(DOUBT, "Few blocks of time.", first=True),
        statement(
            ANSWER, "{share}", "Detectable", first=True, share=Quantity("detectable", "", 75.0, "%", (60.0, 80.0))
        ),
        statement(ANSWER, "1° off in one tilt 70 % at worst", "How sure", first=True),
        statement(ANSWER, "+25 points", "Gain", first=True),
    ),
)


@pytest.fixture
def sheet(tmp_path):
    def write(changes=None, **mount):
        site = prepare(load_scenario(write_scene(tmp_path, changes)))
        told = {"site": "crossing", "sensor": "RS-16", "deployment": MOUNT | mount, "document": as_json(DOCUMENT)}
        return installation_text(site, told)

    return write


def test_the_columns_that_an_ouster_was_planned_with_are_told(sheet):
    ouster = {"sensor": {"name": "OS1-32", "rotation_hz": None, "columns": 512}}
    assert "- Rotation rate 10 Hz, 512 columns a turn.\n" in sheet(ouster)
    assert "- Rotation rate 20 Hz.\n" in sheet()


def number_in(text, pattern):
    return float(re.search(pattern, text)[1])


def test_height_place_and_scores_are_those_of_the_result(sheet):
    text = sheet(x_m=1.5)
    assert text.startswith("Installation of one RS-16 LiDAR: crossing\n")
    assert "4.00 m from the road surface" in text
    assert "x 1.50 m along the road, y 0.00 m across it" in text
    assert "2.00 m from the edge of the nearest lane, to the right of its traffic" in text
    assert "15.0 deg down towards the road, bearing 0 deg" in text
    assert "x 1.50 m, y 0.00 m in the recording's coordinates (x and y of the table)" in text
    assert "\n- Few blocks of time.\n" in text
    assert text.endswith(
        "Expected: RS-16 at crossing, judged on 40 boxes\n- Detectable: 75 % (60 to 80)\n"
        "- How sure: 1° off in one tilt 70 % at worst\n"
    )
    assert "20 Hz" in text
    assert max(map(len, text.splitlines())) <= 120


@pytest.mark.parametrize(("tilt_x", "tilt_y", "yaw"), [(15.0, 0.0, 0.0), (-5.0, 8.0, 0.0), (12.0, -3.0, 40.0)])
def test_the_inclinometer_readings_are_the_slopes_of_the_sensors_axes(sheet, tilt_x, tilt_y, yaw):
    text = sheet(tilt_x_deg=tilt_x, tilt_y_deg=tilt_y, yaw_deg=yaw)
    pose = mounting(MOUNT, tilt_x_deg=tilt_x, tilt_y_deg=tilt_y, yaw_deg=yaw).pose
    ahead, aside = np.degrees(np.arcsin(-pose.to_world(np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0]]))[:, 2]))
    for fall, where in ((ahead, "towards zero azimuth"), (aside, "a quarter turn clockwise from it, seen from above,")):
        way, number = re.search(rf"{where} it (is level|falls by|rises by)(?: ([\d.]+) deg)?", text).groups()
        assert way == ("is level" if abs(fall) < 0.05 else "falls by" if fall > 0.0 else "rises by")
        assert float(number or 0.0) == pytest.approx(abs(fall), abs=0.051)


def test_beside_a_slope_readings_stay_those_of_a_plumb_mast(sheet):
    level = sheet(yaw_deg=40.0)
    slope = {"grade_percent": 4.0, "cross_fall_percent": 2.0, "crown_percent": 2.5}
    text = sheet({"road": slope}, yaw_deg=40.0)
    kept = [line for line in text.splitlines() if line in level.splitlines()]
    for start in ("Height ", "Position", "Lean", "Yaw", "Cable", "- Inclinometer"):
        assert any(line.startswith(start) for line in kept)
    assert "The road rises 4 % ahead and falls 2 % to the right:" in text
    assert "its middle is 0." in text
    assert "are not in the model: look for them" in text
    # Plumb, z upwards: the ray from the head meets z = 0.04 x + 0.02 y where there is no crown.
    flat = sheet({"road": slope | {"crown_percent": 0.0}}, yaw_deg=40.0)
    pose = mounting(MOUNT, yaw_deg=40.0).pose
    x, y, z = pose.to_world(np.array([[0.0, math.cos(math.radians(15.0)), -math.sin(math.radians(15.0))]]))[0]
    spot = np.array([x, y, z]) * 4.0 / (0.04 * x + 0.02 * y - z) + [0.0, 0.0, 4.0]
    found = number_in(flat, TARGET)
    assert found == pytest.approx(np.linalg.norm(spot), abs=0.051)
    assert found > number_in(level, TARGET) + 0.1  # it looks downhill
    assert number_in(text, TARGET) < found  # a crown stands nearer


TARGET = r"meets the ground ([\d.]+) m from the pole"


def test_the_target_on_a_crown_stands_on_its_surface(sheet):
    """Found by going along the beam in steps of a millimetre; two lanes of 3.5 m begin 2 m away."""
    text = sheet({"road": {"crown_percent": 6.0}}, tilt_x_deg=15.0)
    along = np.arange(0.0, 20.0, 0.001)
    y, z = along * math.cos(math.radians(30.0)), 4.0 - along * math.sin(math.radians(30.0))
    surface = 0.06 * np.clip(3.5 - np.abs(y - 5.5), 0.0, None)
    first = np.flatnonzero(z <= surface)[0]
    assert surface[first] > 0.05
    assert number_in(text, TARGET) == pytest.approx(y[first], abs=0.06)


def test_the_target_stands_where_the_lowest_ring_meets_the_ground(sheet):
    expected = 4.0 / math.tan(math.radians(15.0 + 15.0))
    assert number_in(sheet(), r"meets the ground ([\d.]+) m from the pole") == pytest.approx(expected, abs=0.051)
    assert number_in(
        sheet(tilt_x_deg=-15.0), r"At 180 deg (?:counter-)?clockwise .*\s.* meets the ground ([\d.]+)"
    ) == pytest.approx(expected, abs=0.051)
    assert number_in(sheet(yaw_deg=40.0), r"At zero azimuth, .* meets the ground ([\d.]+)") == pytest.approx(
        expected, abs=0.051
    )


@pytest.mark.parametrize(
    ("tilts", "words"),
    [
        ({"tilt_x_deg": 0.0}, "stands upright"),
        ({"tilt_x_deg": -15.0}, "15.0 deg down away from the road, bearing 180 deg"),
        (
            {"tilt_x_deg": 0.0, "tilt_y_deg": -10.0},
            "10.0 deg down along the nearest lane, with its traffic, bearing 90",
        ),
        ({"yaw_deg": -90.0}, "down along the nearest lane, with its traffic"),
        ({"yaw_deg": 180.0}, "down away from the road"),
        ({"yaw_deg": 30.0}, "down towards the road, bearing 330 deg"),
    ],
)
def test_the_lean_is_told_by_what_it_points_at_whatever_the_yaw(sheet, tilts, words):
    assert words in sheet(**tilts)


def test_a_pole_at_the_left_is_said_to_be_there(sheet):
    assert "3.00 m from the edge of the nearest lane, to the left of its traffic" in sheet(y_m=12.0)


@pytest.mark.parametrize(
    ("yaw", "faces", "behind"),
    [
        (0.0, "+y, left of the direction of travel", "-y, right of the direction of travel"),
        (90.0, "back, against the direction of travel", "ahead, in the direction of travel"),
        (
            30.0,
            "+y, left of the direction of travel, 30 deg counter-clockwise",
            "-y, right of the direction of travel, 30",
        ),
    ],
)
def test_the_sheet_says_where_zero_azimuth_and_the_cable_opposite_it_face(sheet, yaw, faces, behind):
    text = " ".join(sheet(yaw_deg=yaw).split())
    assert f"zero azimuth faces {faces}" in text
    assert f"(see the drawing), faces {behind}" in text
    assert f"bearing {(360.0 - yaw) % 360.0:.0f} deg; a cable outlet" in text


def test_the_sheet_names_the_region_that_the_mounting_was_planned_for(sheet):
    assert "vehicles within 20 m of x 0 m, y 0 m" in sheet()
    assert "within 12 m of x 1 m, y 5 m" in sheet({"region": {"centre_m": [1.0, 5.0], "radius_m": 12.0}})


def test_the_sheet_names_a_chart_only_where_it_was_drawn(tmp_path, monkeypatch, capsys):
    without_charts(monkeypatch)
    done(capsys, "evaluate", write_scene(tmp_path), "--out", tmp_path / "run")
    assert "blind_zones.png" not in (tmp_path / "run" / "installation.txt").read_text(encoding="utf-8")
