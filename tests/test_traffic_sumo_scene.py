"""A scene whose traffic is SUMO's, from the command line on."""

from __future__ import annotations

import json
import shutil

import pytest

from blender_lidar.scene.scenario import load_scenario
from tests import sumo_samples as samples
from tests.refusals import refused
from tests.small_scene import cli, done, without_charts, write_scene

LANES = {"road_0": -3.75, "road_1": -7.25}  # y of the lanes of a road along the net's -x, from the right
TYPES = '<routes><vType id="car" length="4.4" height="1.5"/><vType id="lorry" vClass="truck" length="11"/></routes>'


@pytest.fixture
def scene(tmp_path, monkeypatch):
    """SUMO's road runs the other way, its vehicles at x = 1000 when they pass the mount."""
    without_charts(monkeypatch)
    rows = []
    for frame in range(0, 120, 2):
        for number in range(40):
            lane = f"road_{number % 2}"
            x = 1000.0 - (10.0 * frame + (-1200 + 31 * number))
            kind = "lorry" if number % 5 == 0 else "car"
            if abs(x - 1000) < 45:
                place = {"x": round(x, 2), "y": LANES[lane], "lane": lane}
                rows.append(samples.row(frame, id=f"v.{number}", angle=270.0, type=kind, **place))
    (tmp_path / "types.rou.xml").write_text(TYPES, encoding="utf-8")
    (tmp_path / "run.fcd.xml").write_text(samples.xml(rows), encoding="utf-8")
    traffic = {"path": "run.fcd.xml", "vehicle_types": "types.rou.xml", "origin_m": [1000.0, 0.0], "heading_deg": 180.0}
    return write_scene(tmp_path, {"traffic": traffic})


def test_optimise_and_evaluate_take_sumos_traffic(scene, tmp_path, capsys):
    out, _ = done(capsys, "optimise", scene, "--verbose", "--out", tmp_path / "run")
    assert "run.fcd.xml: 60 frames" in out
    assert "vehicles are numbered from 0 by first appearance: v." in out
    table = (tmp_path / "run" / "vehicles.csv").read_text(encoding="utf-8").splitlines()
    header = table[0].split(",")
    boxes = [dict(zip(header, line.split(","), strict=True)) for line in table[1:]]
    assert {(box["class"], float(box["length_m"])) for box in boxes} == {("car", 4.4), ("truck", 11.0)}
    assert {round(float(box["y_m"]), 2) for box in boxes} == {3.75, 7.25}
    assert {abs(float(box["heading_deg"])) for box in boxes} == {0.0}
    out, _ = done(capsys, "evaluate", scene, "--height", 4, "--tilt-x", 15, "--json")
    assert json.loads(out)["vehicles"] == json.loads((tmp_path / "run" / "result.json").read_text())["vehicles"]


def test_the_scene_as_used_finds_its_files_again(scene, tmp_path, capsys):
    assert cli(capsys, "optimise", scene, "--out", tmp_path / "run")[0] == 0
    again = load_scenario(tmp_path / "run" / "scene.toml").traffic
    assert again.vehicle_types == str((tmp_path / "types.rou.xml").resolve())
    shutil.copytree(tmp_path / "run", tmp_path / "copy")
    assert cli(capsys, "optimise", scene, "--out", tmp_path / "copy", "--resume")[0] == 0
    (tmp_path / "types.rou.xml").write_text(TYPES.replace("4.4", "4.5"), encoding="utf-8")
    line = refused(capsys, tmp_path, "optimise", scene, "--out", tmp_path / "copy", "--resume", begun=True)
    assert "[traffic] vehicle_types" in line


def test_traffic_far_from_the_mount_is_refused_with_the_keys_to_look_at(scene, tmp_path, capsys):
    far = write_scene(tmp_path, {"traffic": {"path": "run.fcd.xml", "origin_m": [5000.0, 0.0]}})
    line = refused(capsys, tmp_path, "optimise", far, "--out", tmp_path / "far")
    assert "vehicles drive at x -4037 to -3958 m, y -7 to -4 m; check [traffic] origin_m and heading_deg" in line
