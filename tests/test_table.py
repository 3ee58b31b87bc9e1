"""The table of best tilt and detectable share by setback and height."""

from __future__ import annotations

import csv
import json

import numpy as np
import pytest

from blender_lidar.commands.parsers import parse_range
from blender_lidar.commands.table import mounting_at
from blender_lidar.errors import InputError
from blender_lidar.run.comparison import Comparison
from blender_lidar.run.vehicle_table import vehicle_table
from blender_lidar.scene.mounting import changed_mounting
from blender_lidar.scene.scenario import load_scenario
from blender_lidar.scene.site import prepare
from blender_lidar.scoring.evaluation import site_evaluator
from tests.report_samples import Page
from tests.small_scene import MAPPED, cli, done, traffic_rows, write_scene, write_table


@pytest.mark.parametrize(
    ("text", "numbers"),
    [
        ("2:10:2", [2, 4, 6, 8, 10]),
        ("3,4.5,6,8", [3, 4.5, 6, 8]),
        ("6,2:3:0.5", [2, 2.5, 3, 6]),
        ("4", [4]),
        ("2:5:2", [2, 4]),
    ],
)
def test_ranges_and_lists_are_read(text, numbers):
    assert parse_range(text, "--setback", 60.0) == numbers


@pytest.mark.parametrize(
    "text", ["", "x", "2:10", "10:2:2", "2:10:0", "0", "-1", "61", "1:60:0.1", "nan", "2:inf:1", "1:2:3:4"]
)
def test_a_range_that_is_none_is_refused_in_one_line(text):
    with pytest.raises(InputError, match=r"--setback: .*; allowed: metres above 0 up to 60"):
        parse_range(text, "--setback", 60.0)


def scene_of(folder, **changes):
    write_table(folder / "traffic.csv", traffic_rows(vehicles=120))
    return write_scene(folder, {**MAPPED, "sensor": {"range_gate_m": 35.0}, **changes})


def test_each_cell_is_what_evaluate_and_plain_loops_find(tmp_path, capsys):
    scene = scene_of(tmp_path)
    out, _ = done(capsys, "table", scene, "--setback", "2,6", "--height", "3,4.5", "--out", tmp_path / "t")
    with (tmp_path / "t" / "table.csv").open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert [(float(row["setback_m"]), float(row["height_m"])) for row in rows] == [(2, 3), (2, 4.5), (6, 3), (6, 4.5)]
    site = prepare(load_scenario(scene))
    with site_evaluator(site, site.search, site.holdout) as evaluator:
        for row in rows:
            mounting = mounting_at(site.scenario, float(row["setback_m"]), float(row["height_m"]))
            assert site.scenario.road_map.clearance(mounting.xy)[0] == pytest.approx(float(row["setback_m"]))
            tilts = np.linspace(0.0, 25.0, 26)
            tried = [(changed_mounting(mounting, site.scenario.road_map, tilt_x_deg=tilt),) for tilt in tilts]
            best = int(np.argmax(evaluator.totals(tried).objective.sum(axis=1)))
            assert float(row["tilt_x_deg"]) == pytest.approx(tilts[best])
            table = vehicle_table(tried[best], holdout=evaluator.held_out)
            assert float(row["detectable_share"]) == pytest.approx(table["detectable"].mean(), abs=1e-6)
            assert int(row["boxes"]) == len(table["frame"])
    page = Page((tmp_path / "t" / "table.html").read_text(encoding="utf-8"))
    assert page.text(page.find("h1")[0]).endswith(": detectable vehicles by setback and height")
    assert "hung at 4.5 m" in out
    assert max(map(len, out.replace(str(tmp_path), "").splitlines())) <= 120


def test_the_best_cell_is_as_good_as_itself_and_a_worse_one_is_not_marked(tmp_path, capsys):
    words = ("table", scene_of(tmp_path), "--setback", "2", "--height", "0.6,4.5", "--json", "--out", tmp_path / "t")
    cells = json.loads(done(capsys, *words)[0])["cells"]
    low, high = sorted(cells, key=lambda cell: cell["detectable_share"])
    assert high["as_good"]
    assert high["difference_to_best"] == 0.0
    assert low["as_good"] == (low["difference_interval_90"][1] >= 0.0)


@pytest.mark.parametrize(
    "fixed",
    [
        {"tilt_x_deg": 19.0},
        {"tilt_y_deg": 8.0, "yaw_deg": 15.0},
        {"lean_deg": [0.0, 25.0], "lean_direction_deg": 40.0, "tilt_x_deg": None},
    ],
)
def test_angles_that_the_scene_fixes_are_kept(tmp_path, capsys, fixed):
    scene = scene_of(tmp_path, deployment={"height_m": [2.0, 4.5], **fixed})
    words = ("table", scene, "--setback", "2", "--height", "4.5", "--json", "--out", tmp_path / "t")
    cell = json.loads(done(capsys, *words)[0])["cells"][0]
    scenario = load_scenario(scene)
    axis = scenario.lidar.deployment.spaces[0].axes[1]
    given = {key: value for key, value in fixed.items() if isinstance(value, float)} | {axis: cell[axis]}
    site = prepare(scenario)
    with site_evaluator(site, site.search, site.holdout) as evaluator:
        plan = (changed_mounting(mounting_at(scenario, 2.0, 4.5), scenario.road_map, **given),)
        share = evaluator.held_out.totals([plan]).detectable_share()[0]
    assert cell["detectable_share"] == pytest.approx(share, abs=1e-9)
    if fixed.get("tilt_x_deg"):
        assert cell["tilt_x_deg"] == 19.0


def test_on_the_left_a_mast_moves_to_the_left_and_in_a_median_it_is_refused(tmp_path, capsys):
    left = load_scenario(scene_of(tmp_path, deployment={"side": "left", "height_m": [2.0, 4.5]}))
    near, far = (mounting_at(left, setback, 4.0).xy[1] for setback in (2.0, 6.0))
    assert far == pytest.approx(near + 4.0)
    two_way = {"road": {"lanes": 1, "carriageways": 2, "median_m": 4.0}}
    scene = write_scene(tmp_path, {**two_way, "deployment": {"side": "median", "height_m": [2.0, 4.5]}})
    code, _, err = cli(capsys, "table", scene, "--setback", "2", "--height", "4", "--out", tmp_path / "t")
    assert code == 2
    assert "stands over or between lanes (median); allowed: beside the road" in err
    assert not (tmp_path / "t").exists()


def test_several_sensors_have_a_table_each_and_a_folder_in_use_is_refused(tmp_path, capsys):
    scene = scene_of(tmp_path)
    words = ("table", scene, "--setback", "2", "--height", "4", "--sensor", "RS-16,RS-32", "--out", tmp_path / "t")
    out, _ = done(capsys, *words)
    assert "RS-16, setback" in out
    assert "RS-32, setback" in out
    code, _, err = cli(capsys, *words)
    assert (code, "is not empty" in err) == (2, True)


def test_differences_of_many_cells_hold_together():
    """Of many cells that are alike, each block's noise its own, hardly any is called worse: the intervals are joint."""
    rng, worse = np.random.default_rng(1), []
    block = np.repeat(np.arange(12), 20)
    for _ in range(40):
        cells = (rng.random((60, 240)) < 0.7).astype(float)
        before = {"frame": np.zeros(240), "vehicle_id": np.arange(240), "objective": np.zeros(240)}
        before["detectable"] = cells[0]
        boxes = Comparison(before, before, block, np.zeros(240, dtype=int), None, 1)
        reach = boxes.reach_90("detectable", [{"detectable": cell} for cell in cells])
        gain = (cells - cells[0]).mean(axis=1)
        worse.append((gain + reach < 0.0).any())
        assert reach[0] == 0.0
    assert np.mean(worse) < 0.25
