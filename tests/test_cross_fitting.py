"""Cross-fitting where too little is held out: every block of time judges a mounting that was chosen without it."""

from __future__ import annotations

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from blender_lidar.optimise import vehicle_score
from blender_lidar.run.folder import RunFolder
from blender_lidar.scene.scenario import load_scenario
from blender_lidar.scene.site import prepare
from blender_lidar.scoring.evaluation import site_evaluator
from blender_lidar.statistics import FEW_BLOCKS, best_without_block, statistic_interval_90
from tests.small_scene import done, traffic_rows, without_charts, write_scene, write_table


@settings(max_examples=30)
@given(st.integers(0, 2**32), st.integers(2, 9))
def test_what_is_best_without_a_block_is_found_by_plain_loops(seed, blocks):
    sums = np.random.default_rng(seed).normal(size=(7, blocks))
    aside = 1 if blocks >= FEW_BLOCKS else 0
    for block, row in enumerate(best_without_block(sums).tolist()):
        others = [sum(values[b] for b in range(blocks) if abs(b - block) > aside) for values in sums]
        assert row == int(np.argmax(others))


def run_of(folder, capsys, **traffic):
    """A search whose blocks are 10 s, so that few are held out."""
    write_table(folder / "traffic.csv", traffic_rows(vehicles=60))
    changes = {"traffic": {"frames": 16, "holdout": 0.3, "block_s": 12.0, **traffic}, "sensor": {"range_gate_m": 30.0}}
    scene = write_scene(folder, changes)
    out, _ = done(
        capsys, "optimise", scene, "--search", "grid", "--particles", 9, "--iterations", 1, "--out", folder / "r"
    )
    return out, json.loads((folder / "r" / "result.json").read_text(encoding="utf-8")), scene


def test_every_block_judges_what_was_chosen_without_it(tmp_path, capsys, monkeypatch):
    """An oracle in plain loops from single scorings of every mounting that was tried."""
    without_charts(monkeypatch)
    out, result, scene = run_of(tmp_path, capsys)
    assert result["holdout"]["blocks"] < FEW_BLOCKS
    crossed, base = result["cross_fitted"]["optimised"], result["cross_fitted"]["baseline"]
    site = prepare(load_scenario(scene))
    heights = np.unique(RunFolder(tmp_path / "r").read_columns()["height_m"])
    plan, labels = site.plan, np.unique(site.plan.search_block)
    with site_evaluator(site, site.search, site.holdout) as evaluator:
        layouts = [(site.scenario.lidar.mounting({"height_m": height, "tilt_x_deg": 15.0}),) for height in heights]
        layouts = [*layouts, (site.scenario.lidar.baseline,)]
        searched, held = evaluator.totals(layouts), evaluator.held_out.totals(layouts)
    aside = 1 if len(labels) >= FEW_BLOCKS else 0
    gained, vehicles, seen = [], [], 0
    for place, label in enumerate(labels):
        others = [frame for frame, one in enumerate(plan.search_block) if abs(list(labels).index(one) - place) > aside]
        best = int(np.argmax([searched.objective[row, others].sum() for row in range(len(heights))]))
        own = plan.search_block == label
        gained.append(searched.objective[best, own].sum() - searched.objective[-1, own].sum())
        vehicles.append(searched.vehicles[own].sum())
        seen += searched.detectable[best, own].sum()
    answer = int(np.argmin(np.abs(heights - result["deployment"]["height_m"])))
    for label in np.unique(plan.holdout_block):
        own = plan.holdout_block == label
        gained.append(held.objective[answer, own].sum() - held.objective[-1, own].sum())
        vehicles.append(held.vehicles[own].sum())
        seen += held.detectable[answer, own].sum()
    gained, vehicles = np.array(gained), np.array(vehicles)
    assert crossed["gain_over_baseline"] == pytest.approx(gained.sum() / vehicles.sum(), abs=1e-9)
    assert crossed["detectable_share"] == pytest.approx(seen / vehicles.sum(), abs=1e-12)
    assert (crossed["boxes"], crossed["blocks"]) == (vehicles.sum(), (vehicles > 0).sum())
    interval = statistic_interval_90(lambda w: w @ gained / (w @ vehicles), vehicles, result["seed"])
    assert crossed["interval_90"] == pytest.approx(interval, abs=1e-9)
    assert base["gain_over_baseline"] == 0.0
    assert sum(one["boxes"] for one in result["groups"] if one["by"] == "class") == crossed["boxes"]
    said = " ".join(out.split())
    assert f", {crossed['blocks']} blocks of time, each block left out in turn" in said
    assert "each block judged the best mounting of the other blocks (cross-fitting)" in said
    table = next(one for one in result["document"]["tables"] if one["key"] == "mountings")
    assert any(row[0].startswith(f"Each block left out in turn, {crossed['blocks']} blocks") for row in table["rows"])


def test_where_enough_is_held_out_that_judges_alone(tmp_path, capsys, monkeypatch):
    without_charts(monkeypatch)
    _, result, _ = run_of(tmp_path, capsys, block_s=2.0, holdout=0.5)
    assert result["holdout"]["blocks"] >= FEW_BLOCKS
    assert result["cross_fitted"] is None


def test_vehicle_scores_of_boxes_add_up_to_the_objective(tmp_path, capsys, monkeypatch):
    """What judges is the same boxes as `groups` has, with the scene's own score of each."""
    without_charts(monkeypatch)
    _, result, _ = run_of(tmp_path, capsys)
    rows = [one for one in result["groups"] if one["by"] == "class"]
    boxes = np.array([one["boxes"] for one in rows])
    means = np.array([one["objective_after"] for one in rows])
    assert vehicle_score(np.zeros(1), np.zeros(1, dtype=bool), -1.0, "corrected")[0] == -1.0
    whole = boxes @ means / boxes.sum()
    assert whole == pytest.approx(result["cross_fitted"]["optimised"]["objective_per_vehicle"], abs=1e-9)
