"""What each metric would choose: the script's table is the best of the same grid, metric by metric."""

from __future__ import annotations

import runpy
from pathlib import Path

import numpy as np

from blender_lidar.scenario import load_scenario
from blender_lidar.study.score_map import map_scores
from blender_lidar.study.site import prepare
from tests.small_scene import MAPPED, write_scene

SCRIPT = Path(__file__).parents[1] / "scripts" / "metric_choices.py"
main = runpy.run_path(str(SCRIPT))["main"]


def test_the_table_names_the_best_point_of_each_metrics_own_map(tmp_path, capsys):
    scene = write_scene(tmp_path, MAPPED)
    assert main([str(scene), "--metrics", "points,distance"]) == 0
    rows = {line.split()[0]: line.split()[1:] for line in capsys.readouterr().out.splitlines()[1:]}
    scenario = load_scenario(scene, {("objective", "metric"): ("points", "--metric")})
    site = prepare(scenario)
    with site.evaluator(site.search) as evaluator:
        found = map_scores(evaluator, scenario.deployment, dict(scenario.baseline), site.plan.search_block)
    height, tilt = np.unravel_index(np.argmax(found.per_vehicle), found.per_vehicle.shape)
    assert rows["points"][:2] == [f"{found.height_m[height]:.2f}", f"{found.tilt_deg[tilt]:.1f}"]
    assert rows["distance"][:3] == ["-", "-", "-"]  # the same wherever it hangs


def test_an_unknown_metric_ends_in_one_line(tmp_path, capsys):
    scene = write_scene(tmp_path, {"model": {"caster": "exact"}})
    assert main([str(scene), "--metrics", "pe-vgob"]) == 2
    told = capsys.readouterr().err
    assert told.count("\n") == 1
    assert "did you mean 'pe-vgop'" in told
