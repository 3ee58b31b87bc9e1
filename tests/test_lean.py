"""A lean, its direction and the spin: the same orientations as tilts and yaw, each said once."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

import blender_lidar as bl
from blender_lidar.errors import InputError
from blender_lidar.road.settings import RoadSettings, map_of
from blender_lidar.scene.mounting import mounting_from
from blender_lidar.scene.scenario import load_scenario
from blender_lidar.scene.site import prepare
from blender_lidar.scoring.evaluation import Evaluator
from blender_lidar.sensors.pose import lean_matrix, lean_of, rotation_matrix, tilts_of
from tests.refusals import refused
from tests.small_scene import cli, mounting, write_scene

pytestmark = [pytest.mark.usefixtures("quick"), pytest.mark.versions]

PLACE = {"x_m": 0.0, "y_m": 0.0, "height_m": 4.0}
half, whole = (st.floats(-limit, limit) for limit in (math.pi / 2, 2.0 * math.pi))


def about_z(angle):
    return rotation_matrix(0.0, 0.0, angle)


@given(half, half, whole)
@example(0.0, 0.0, 1.0)
@example(0.3, math.pi / 2, 0.7)
@example(1e-9, -1e-9, 2.0)
@example(math.pi / 2, math.pi / 2, 0.2)
def test_tilts_and_yaw_are_a_lean_with_the_same_matrix(tilt_x, tilt_y, yaw):
    rotation = rotation_matrix(tilt_x, tilt_y, yaw)
    lean, direction, spin = lean_of(rotation)
    np.testing.assert_allclose(lean_matrix(lean, direction, spin), rotation, rtol=0.0, atol=1e-12)
    assert math.cos(lean) == pytest.approx(math.cos(tilt_x) * math.cos(tilt_y), abs=1e-12)
    if math.sin(lean) > 1e-6:
        expected = math.atan2(math.cos(tilt_x) * math.sin(tilt_y), math.sin(tilt_x)) + yaw
        assert math.remainder(direction - expected, 2.0 * math.pi) == pytest.approx(0.0, abs=1e-9)


@given(st.floats(0.0, math.pi / 2), whole, whole)
@example(math.pi / 2, math.pi / 2, 0.0)
@example(math.pi / 2, 0.0, 1.0)
@example(0.0, 1.0, 2.0)
def test_a_lean_is_tilts_and_yaw_with_the_same_matrix(lean, direction, spin):
    rotation = lean_matrix(lean, direction, spin)
    parts = about_z(spin) @ about_z(-direction) @ rotation_matrix(lean, 0.0, 0.0) @ about_z(direction)
    np.testing.assert_allclose(rotation, parts, rtol=0.0, atol=1e-12)
    tilt_x, tilt_y, yaw = tilts_of(rotation)
    assert abs(tilt_x) <= math.pi / 2 + 1e-12
    np.testing.assert_allclose(rotation_matrix(tilt_x, tilt_y, yaw), rotation, rtol=0.0, atol=1e-12)
    sin, cos = math.sin(lean), math.cos(lean)
    axis = [-sin * math.sin(direction), sin * math.cos(direction), cos]
    np.testing.assert_allclose(rotation[2], axis, rtol=0.0, atol=1e-12)


@pytest.mark.parametrize(
    ("tilts", "direction"),
    [((20.0, 0.0, 0.0), 0.0), ((0.0, 20.0, 0.0), 90.0), ((-20.0, 0.0, 0.0), 180.0), ((20.0, 0.0, 35.0), 35.0)],
)
def test_a_tilt_across_leans_towards_the_road_and_one_along_against_the_traffic(tilts, direction):
    found = mounting(PLACE, **dict(zip(("tilt_x_deg", "tilt_y_deg", "yaw_deg"), tilts, strict=True))).as_table()
    assert found["lean_deg"] == pytest.approx(20.0)
    assert abs(found["lean_direction_deg"]) == pytest.approx(abs(direction))


def test_without_a_lean_there_is_no_direction_and_all_turns_are_spin():
    found = mounting(PLACE, yaw_deg=40.0).as_table()
    assert (found["lean_deg"], found["lean_direction_deg"], found["spin_deg"]) == (0.0, None, 40.0)
    near, upright = (mounting(PLACE, lean_deg=lean, lean_direction_deg=70.0).pose for lean in (1e-9, 0.0))
    np.testing.assert_allclose(near.rotation, upright.rotation, atol=1e-10)


@pytest.mark.parametrize(
    ("deployment", "fault"),
    [
        ({"lean_deg": 20.0, "yaw_deg": 3.0}, "has lean_deg and yaw_deg; allowed: a lean, or tilts and yaw"),
        ({"lean_direction_deg": [0.0, 90.0]}, "has lean_direction_deg without lean_deg"),
        ({"lean_deg": 10.0, "lean_direction_deg": [-200.0, 200.0]}, "is 400 degrees wide; allowed: at most 360"),
        (
            {"tilt_x_deg": [0.0, 25.0], "tilt_y_deg": [-5.0, 5.0], "yaw_deg": [-10.0, 10.0]},
            "[deployment]: tilt_x_deg, tilt_y_deg, yaw_deg: are searched together",
        ),
        (
            {"tilt_x_deg": [-25.0, 25.0], "yaw_deg": [-100.0, 100.0]},
            "[deployment] tilt_x_deg: is searched on both sides of 0 with more than 180 degrees of yaw_deg",
        ),
    ],
)
def test_angles_that_say_a_lean_in_more_than_one_way_are_refused(tmp_path, capsys, deployment, fault):
    text = write_scene(tmp_path, {"deployment": {"tilt_x_deg": None, **deployment}})
    assert fault in refused(capsys, tmp_path, "optimise", text, "--out", "run")


@pytest.mark.parametrize(
    "deployment",
    [
        {"tilt_x_deg": [0.0, 25.0], "yaw_deg": [-180.0, 180.0]},
        {"tilt_x_deg": [-25.0, 25.0], "yaw_deg": [-90.0, 90.0]},
        {"tilt_x_deg": [0.0, 25.0], "tilt_y_deg": [-5.0, 5.0]},
    ],
)
def test_angles_that_say_each_lean_once_are_searched(tmp_path, deployment):
    assert load_scenario(write_scene(tmp_path, {"deployment": deployment})).lidar.deployment.spaces[0].variables


def test_a_lean_in_an_option_takes_the_place_of_tilts_in_the_scene(tmp_path, capsys):
    scene = write_scene(tmp_path, {"baseline": {"tilt_x_deg": 3.0}})
    words = ("--height", 4, "--lean", 20, "--lean-direction", 30, "--json")
    code, out, err = cli(capsys, "evaluate", scene, *words, "--out", tmp_path / "run")
    assert code == 0, err
    mount = json.loads(out)["deployment"]
    assert (mount["lean_deg"], mount["lean_direction_deg"]) == pytest.approx((20.0, 30.0))
    assert mounting(mount).pose.rotation == pytest.approx(lean_matrix(math.radians(20.0), math.radians(30.0), 0.0))
    line = refused(capsys, tmp_path, "evaluate", scene, "--lean", 3, "--yaw", 3, "--out", tmp_path / "both", begun=True)
    assert "has lean_deg and yaw_deg" in line


def test_a_scene_of_leans_is_written_searched_and_told_as_such(tmp_path, capsys):
    lean = {"lean_deg": [0.0, 25.0], "lean_direction_deg": [-180.0, 180.0], "tilt_x_deg": None}
    changes = {"deployment": lean, "baseline": {"lean_deg": 2.0}, "search": {"particles": 6, "iterations": 10}}
    scene = write_scene(tmp_path, changes)
    scenario = load_scenario(scene)
    (space,) = scenario.lidar.deployment.spaces
    assert space.periodic == (False, False, True)
    assert space.axes == ("height_m", "lean_deg")
    code, out, err = cli(capsys, "optimise", scene, "--out", tmp_path / "run")
    assert code == 0, err
    result = json.loads((tmp_path / "run" / "result.json").read_text())
    mount = result["deployment"]
    assert "leaning" in out or "level" in out
    assert "tilt across the road" not in out
    assert mounting(mount).pose.rotation == pytest.approx(
        lean_matrix(*(math.radians(mount[key] or 0.0) for key in ("lean_deg", "lean_direction_deg", "spin_deg")))
    )
    assert set(result["map"]["best"]) == {"height_m", "lean_deg", "objective_per_vehicle"}
    assert load_scenario(tmp_path / "run" / "scene.toml").lidar.deployment == scenario.lidar.deployment
    header = (tmp_path / "run" / "history.csv").read_text().splitlines()[0]
    assert "lean_deg,lean_direction_deg" in header


def test_spin_moves_scores_by_no_more_than_the_phase_of_the_columns_does(tmp_path):
    """Of a sensor with even columns: turned by whole steps nothing changes, by parts of one only what samples."""
    site = prepare(load_scenario(write_scene(tmp_path)))
    step = math.degrees(site.observation.lattice.step_rad)
    leans = {**PLACE, "lean_deg": 15.0, "lean_direction_deg": 10.0}

    def scores(spins):
        layouts = [(mounting(leans, spin_deg=spin),) for spin in spins]
        return Evaluator(site.search, site.observation, site.scoring).totals(layouts).per_vehicle()

    phases = scores(step * np.arange(8) / 8.0)
    whole_steps = scores(step * np.array([1.0, 10.0, 100.0]))
    far = scores([33.3, 91.7, 180.1, -120.6])
    np.testing.assert_allclose(whole_steps, phases[0], rtol=1e-6)
    assert np.ptp(phases) > 0.0
    assert abs(far - phases.mean()).max() <= 2.0 * np.ptp(phases)


def test_what_was_given_is_named_where_it_cannot_be():
    with pytest.raises(InputError, match="row 3: has spin_deg and tilt_y_deg"):
        mounting_from({"spin_deg": 1.0, "tilt_y_deg": 2.0}, map_of(RoadSettings()), where="row 3")


def test_a_lean_of_nought_keeps_the_direction_that_it_was_given(tmp_path, capsys):
    """The map is drawn the scene's way, away from the road, and the answer is the best of all that was tried."""
    lean = {"lean_deg": [0.0, 30.0], "lean_direction_deg": 180.0, "tilt_x_deg": None}
    scene = write_scene(tmp_path, {"deployment": lean, "search": {"particles": 6, "iterations": 8}})
    code, out, err = cli(capsys, "optimise", scene, "--out", tmp_path / "run", "--json")
    assert code == 0, err
    result = json.loads(out)
    rows = (tmp_path / "run" / "history.csv").read_text().splitlines()
    objective = [float(row.split(",")[-2]) for row in rows[1:]]
    assert result["objective"] == pytest.approx(max(objective))
    if result["deployment"]["lean_deg"] > 1e-6:
        assert abs(result["deployment"]["lean_direction_deg"]) == pytest.approx(180.0)
    best = result["map"]["best"]
    words = ("--height", best["height_m"], "--lean", best["lean_deg"], "--lean-direction", 180, "--json")
    _, out, _ = cli(capsys, "evaluate", scene, *words, "--out", tmp_path / "one")
    assert json.loads(out)["objective_per_vehicle"] == pytest.approx(best["objective_per_vehicle"])


def test_a_spin_within_its_bounds_is_on_none_of_them(tmp_path, capsys):
    spin = {"lean_deg": 10.0, "spin_deg": [190.0, 350.0], "tilt_x_deg": None, "height_m": 3.0}
    scene = write_scene(tmp_path, {"deployment": spin, "search": {"particles": 4, "iterations": 3}})
    code, out, err = cli(capsys, "optimise", scene, "--out", tmp_path / "run")
    assert code == 0, err
    found = json.loads((tmp_path / "run" / "result.json").read_text())["deployment"]["spin_deg"]
    assert 192.0 < found % 360.0 < 348.0
    assert "lies on a bound" not in out


@pytest.mark.parametrize("tilts", [(0.0, 0.0, 0.0), (20.0, -4.0, 30.0)])
def test_both_forms_of_one_orientation_as_a_result_has_them_are_one(tmp_path, tilts):
    site = bl.load_scene(write_scene(tmp_path), workers=1)
    mount = {**PLACE, **dict(zip(("tilt_x_deg", "tilt_y_deg", "yaw_deg"), tilts, strict=True))}
    message = mounting(mount).as_table()
    assert bl.score_mounting(site, **message).mounting == message
    with pytest.raises(InputError, match="its lean is not that of its tilts and yaw"):
        bl.score_mounting(site, **{**message, "lean_deg": 7.0})
