"""The one-off scripts of scripts/research: their tables say what the package says, and bad input ends in a line."""

from __future__ import annotations

import csv
import importlib
import json
import re
from pathlib import Path

import numpy as np
import pytest

import tests.research  # noqa: F401
from blender_lidar.metrics.vehicle_metrics import CELL_M, HALF_SHARE
from blender_lidar.run.verdict import map_scores
from blender_lidar.scene.scenario import load_scenario
from blender_lidar.scene.site import prepare
from blender_lidar.scoring.evaluation import site_evaluator
from blender_lidar.scoring.fidelity import Fidelity
from blender_lidar.studies.driver import Job, landscapes
from blender_lidar.studies.effects import FIRST, candidates, weighted_tau
from blender_lidar.studies.ladder import variation
from tests.small_scene import MAPPED, cli, without_charts, write_scene

KITTI = Path(__file__).parents[2] / "shared" / "data" / "kitti"
needs_kitti = pytest.mark.skipif(not KITTI.is_dir(), reason=f"no KITTI excerpt at {KITTI}")


def run(name, *words):
    """The exit code of a script."""
    return importlib.import_module(name).main([str(word) for word in words])


@pytest.mark.parametrize(
    ("name", "words", "told"),
    [
        ("imperfection_effects", ["--height", "nan"], "--height: is nan; allowed: "),
        ("imperfection_effects", ["--sensor", "RS-17"], "--sensor: unknown sensor 'RS-17'"),
        ("metric_choices", ["--metrics", "pe-vgob"], "did you mean 'pe-vgop'"),
        ("coarse_beams", ["--sensor", "RS-17"], "--sensor: unknown sensor 'RS-17'"),
        ("fidelity_regret", ["--seeds", "1"], "height_m and tilt_x_deg, and they alone, must be pairs"),
        ("search_regret", ["--seeds", "1"], "height_m and tilt_x_deg must both be pairs"),
    ],
)
def test_what_cannot_be_is_refused_in_one_line(name, words, told, tmp_path, capsys):
    pytest.importorskip("scipy")
    assert run(name, write_scene(tmp_path), *words) == 2
    out, err = capsys.readouterr()
    assert (out, err.count("\n")) == ("", 1)
    assert err.startswith(f"{name}: ")
    assert told in err


def test_fidelity_auto_is_told_by_speed_and_regret_and_goes_on_from_what_is_stored(tmp_path, capsys):
    words = [write_scene(tmp_path, MAPPED), "--sensors", "RS-16", "--frames", 3, "--seeds", 2, "--evaluations", 40]
    words += ["--workers", 1, "--grid-runs", 2, "--searches", "de-pso", "--out", tmp_path / "out"]
    assert run("fidelity_regret", *words) == 0
    told = capsys.readouterr().out
    assert told == (tmp_path / "out" / "fidelity_regret.txt").read_text()
    for rival in ("grid", "de-pso"):
        assert f"  {rival}: alone median" in told
        assert f"searched: regret to {rival}: mean" in told
    worst = [float(line.split("worst ")[1].split(" %")[0]) for line in told.splitlines() if "to best known" in line]
    assert worst[0] >= 0.0  # nothing is better than the best known on the frames that were searched
    assert run("fidelity_regret", *words) == 2
    assert "--resume" in capsys.readouterr().err
    assert run("fidelity_regret", *words, "--resume") == 0
    assert capsys.readouterr().out == told


def test_regret_of_a_search_is_its_share_of_the_grid_s_gain(tmp_path, capsys):
    scene = write_scene(tmp_path, MAPPED)
    assert run("search_regret", scene, "--seeds", 1, "--search", "grid", "--frames", 3) == 0
    told = capsys.readouterr().out
    best, base = re.search(r"grid: ([-+.\d]+) .* baseline ([-+.\d]+)", told).groups()
    value, regret = re.search(r"seed 1: ([-+.\d]+) at .*; regret ([-.\d]+) %", told).groups()
    expected = 100.0 * (float(best) - float(value)) / (float(best) - float(base))
    assert float(regret) == pytest.approx(expected, abs=20.0 / (float(best) - float(base)))  # one digit is told
    assert "regret on searched frames, 1 seeds: median" in told


def test_every_imperfection_adds_what_runs_with_those_settings_differ_by(tmp_path, capsys, monkeypatch):
    without_charts(monkeypatch)
    effects = importlib.import_module("imperfection_effects").EFFECTS

    def table(changes):
        """Numbers of each row by its name."""
        scene = write_scene(tmp_path, changes)
        assert run("imperfection_effects", scene, "--draws", 2, "--height", 3, "--tilt-x", 10) == 0
        lines = capsys.readouterr().out.splitlines()[2:]
        rows = [re.match(r"(\S+(?: \S+)*) {2,}(.*)", line) for line in lines]
        return {row[1]: [float(number) for number in re.findall(r"[+-]?\d+\.\d+", row[2])] for row in rows}

    def evaluated(**sensor):
        out = tmp_path / ("-".join(f"{key}{value}" for key, value in sensor.items()) or "perfect")
        changed = write_scene(tmp_path, {"sensor": sensor})
        assert cli(capsys, "evaluate", changed, "--height", 3, "--tilt-x", 10, "--out", out)[0] == 0
        result = json.loads((out / "result.json").read_text())
        return np.array([result["objective_per_vehicle"], 100 * result["detectable_share"]])

    found, perfect = table({}), evaluated()
    assert [*found] == ["perfect", *(name for name, _, _ in effects)]
    assert found["perfect"][:2] == pytest.approx(perfect, abs=6e-5)
    for name, on, drawn in effects:
        draws = [{drawn: draw} if drawn else {"noise_seed": draw} for draw in (1, 2)]
        added = [evaluated(**on, **draw) - perfect for draw in draws]
        expected = np.column_stack([np.mean(added, axis=0), np.std(added, axis=0, ddof=1)]).ravel()
        assert found[name][:4] == pytest.approx(expected, abs=6e-5), name
    assert found["drop-out 0.1"][6] == pytest.approx(-0.1 * found["perfect"][3], rel=0.2)
    spoilt = {"dropout": 0.5, "glass_dropout": 1.0, "range_at_10_percent_m": 9.0, "unit_spread_deg": 0.1}
    assert table({"sensor": spoilt})["perfect"] == found["perfect"]  # the first row is a perfect sensor's


def test_metric_choices_names_the_best_point_of_each_metrics_own_map(tmp_path, capsys):
    pytest.importorskip("scipy")
    scene = write_scene(tmp_path, MAPPED)
    assert run("metric_choices", scene, "--metrics", "pe-vgop,points,distance") == 0
    rows = {line.split()[0]: line.split()[1:] for line in capsys.readouterr().out.splitlines()[1:]}
    scenario = load_scenario(scene, {("objective", "metric"): ("points", "--metric")})
    site = prepare(scenario)
    with site_evaluator(site, site.search) as evaluator:
        found = map_scores(evaluator, scenario.deployment, dict(scenario.baseline), site.plan.search_block)
    height, tilt = np.unravel_index(np.argmax(found.per_vehicle), found.per_vehicle.shape)
    assert rows["points"][:2] == [f"{found.height_m[height]:.2f}", f"{found.tilt_deg[tilt]:.1f}"]
    assert rows["distance"] == ["-", "-", "-", "nan"]  # the same wherever it hangs
    assert rows["pe-vgop"][3] == "1.00"


def test_coarse_beams_tells_rank_correlations_of_mountings_scored_anew(tmp_path, capsys):
    scene = write_scene(tmp_path, MAPPED)
    assert run("coarse_beams", scene, "--frames", 6, "--mountings", 12) == 0
    told = capsys.readouterr().out
    site = prepare(load_scenario(scene))
    poses = candidates(site.scenario, 12).poses
    values = [
        next(landscapes(site, [Job(variation(Fidelity("body", stride)), poses)])).objective[FIRST:].sum(axis=1)
        for stride in (1, 4)
    ]
    row = re.search(rf"body, every 4th column, {len(site.search)} frames +(\S+) +(\S+)", told)
    assert float(row[2]) == pytest.approx(weighted_tau(values[1], values[0]), abs=0.0051)
    assert row[1] != row[2]
    assert len(re.findall(r"^b\S+, .*-?\d\.\d\d$", told, re.MULTILINE)) == 4 + 3 + 4


@needs_kitti
def test_view_coverage_s_constants_are_the_best_of_their_form_and_no_car_of_the_other_split_has_a_say(tmp_path, capsys):
    assert run("choose_view_coverage", "--kitti", KITTI, "--detections", KITTI / "cars.csv") == 0
    told = capsys.readouterr().out
    assert f"root of squares  cell {CELL_M:g} m, h {HALF_SHARE:g}: +0.0000" in told
    with (KITTI / "cars.csv").open(encoding="utf-8", newline="") as stream:
        rows = list(csv.DictReader(stream))
    for row in rows:
        if row["split"] != "train":
            row["second_confidence"] = row["pointpillars_iou3d"] = "0.5"
    with (tmp_path / "cars.csv").open("w", encoding="utf-8", newline="") as stream:
        writer = csv.DictWriter(stream, rows[0])
        writer.writeheader()
        writer.writerows(rows)
    assert run("choose_view_coverage", "--kitti", KITTI, "--detections", tmp_path / "cars.csv") == 0
    assert capsys.readouterr().out == told
    (tmp_path / "cars.csv").write_text("frame,label_line,a_confidence,a_iou3d\n000001,0,0.5,0.5\n", encoding="utf-8")
    assert run("choose_view_coverage", "--kitti", KITTI, "--detections", tmp_path / "cars.csv") == 2
    err = capsys.readouterr().err
    assert err.count("\n") == 1
    assert "no frame of split 'train'" in err
