"""The verb chart: the ladder, whole studies on a small scene, stopped ones, and what is refused."""

from __future__ import annotations

import csv
import json
import pickle
from dataclasses import replace

import numpy as np
import pytest

from blender_lidar.commands.parsers import parse_share
from blender_lidar.scene.mounting import Mounting
from blender_lidar.scoring.fidelity import Fidelity
from blender_lidar.studies import chart as study
from blender_lidar.studies.candidates import sobol_candidates
from blender_lidar.studies.chart import ChartEffort, time_fidelities
from tests.refusals import refused
from tests.small_scene import CASTER, MAPPED, REGION, done, without_charts, write_scene

TINY = ChartEffort(3, 8, 6, 2, phases=2, rounds=2, quick=True)
LAYOUTS = ((Mounting(height_m=3.0, tilt_x=0.25),), (Mounting(height_m=4.4, tilt_x=0.1),))


@pytest.fixture
def tiny(monkeypatch):
    """Whole studies of seconds, without pictures."""
    if CASTER == "exact":
        pytest.skip("no fast caster is installed")
    monkeypatch.setattr("blender_lidar.commands.studies.QUICK_CHART", TINY)
    monkeypatch.setattr(study, "STRIDES", (1, 4))
    kept = ("body shape", "azimuth offsets", "drop-out")
    ablations = study.ablations
    monkeypatch.setattr(study, "ablations", lambda *given: [one for one in ablations(*given) if one.what in kept])
    without_charts(monkeypatch)


# --- the ladder -------------------------------------------------------------------------------------------------------


def test_the_ladder_begins_with_the_reference_and_every_rung_has_a_name_of_its_own(site):
    rungs = study.ladder(site)
    assert rungs[0] == Fidelity("detailed")
    assert len({rung.name for rung in rungs}) == len({rung.text for rung in rungs}) == len(rungs)
    assert {(one.detail, one.stride, one.frames) for one in rungs} == {
        (detail, stride, frames)
        for detail in ("box", "body", "detailed")
        for stride in (1, 2, 4, 8)
        for frames in (None, 3, 2, 1)
    }
    assert pickle.loads(pickle.dumps(rungs)) == rungs


def test_phases_are_spread_over_a_stride_and_shares_of_frames_are_counted_once():
    assert [one.phase for one in study.phased(Fidelity("box", 8), 4)] == [0, 2, 4, 6]
    assert [one.phase for one in study.phased(Fidelity("box", 2), 4)] == [0, 1]
    assert study.phased(Fidelity("box"), 4) == [Fidelity("box")]
    assert (study.frame_counts(30), study.frame_counts(2)) == ([None, 15, 8, 4], [None, 1])
    assert study.frame_counts(1) == [None]


def test_every_fidelity_is_timed_in_every_round_on_every_frame(site):
    timed = time_fidelities(site, [Fidelity("box"), Fidelity("detailed")], LAYOUTS, 3)
    for evaluation_s, build_s in timed.values():
        assert evaluation_s.shape == (3, len(site.search))
        assert (evaluation_s > 0.0).all()
        assert (build_s > 0.0).all()


def test_candidates_lie_between_the_bounds_and_the_seed_moves_them(site):
    first = sobol_candidates(site.scenario, 32)
    assert (first.variables, len(first.layouts)) == (("height_m", "tilt_x_deg"), 33)
    assert first.layouts[0] == (site.scenario.lidar.baseline,)
    assert ((first.points >= [2.0, 0.0]) & (first.points <= [4.5, 25.0])).all()
    other = replace(site.scenario, search=replace(site.scenario.search, seed=7))
    assert not np.allclose(sobol_candidates(other, 32).points, first.points)


# --- whole studies ----------------------------------------------------------------------------------------------------


def test_a_chart_leaves_tables_a_report_and_a_sentence_and_one_that_was_stopped_comes_to_the_same(
    tiny, tmp_path, capsys
):
    """But for the times, which are measured once and kept."""
    words = ("chart", write_scene(tmp_path, MAPPED), "--quick", "--out", tmp_path / "run")
    out, _ = done(capsys, *words)
    whole, tables = (tmp_path / "run" / "chart.json").read_bytes(), {}
    result = json.loads(whole)
    for name in ("chart", "ablation"):
        with (tmp_path / "run" / f"{name}.csv").open(newline="") as stream:
            tables[name] = list(csv.DictReader(stream))
    assert [row["name"] for row in tables["chart"]] == [row["name"] for row in result["rungs"]]
    assert [row["what"] for row in tables["ablation"]] == [row["what"] for row in result["ablations"]]
    assert {"regret_interval_90_low", "milliseconds_median"} <= set(tables["chart"][0])
    report = (tmp_path / "run" / "report.md").read_text()
    assert result["sentence"] in " ".join(out.split())
    assert result["sentence"] in report
    assert all(f"| {row['name']} |" in report for row in result["rungs"])
    reference = result["rungs"][0]
    assert (reference["error"], reference["regret"], reference["within"], reference["speedup"]) == (0.0, 0.0, True, 1.0)
    assert next(row for row in result["rungs"] if row["name"] == result["recommended"])["within"]
    for row in result["rungs"]:
        first, middle, third = (row["milliseconds"][key] for key in ("first_quartile", "median", "third_quartile"))
        assert 0.0 < first <= middle <= third
    assert {row["what"]: row["draws"] for row in result["ablations"]} == {
        **{"body shape": 1, "azimuth offsets": 0, "drop-out": 2}
    }
    assert "5 % of all returns; mean of 2 draws" in out
    for stage in sorted((tmp_path / "run" / "stages").glob("*.json"))[::3]:
        if stage.stem != "times":
            stage.unlink()
    (tmp_path / "run" / "chart.json").unlink()
    assert "holds a study already" in refused(capsys, tmp_path, *words)
    out, _ = done(capsys, *words, "--resume", "--json", "--workers", 2)
    assert (tmp_path / "run" / "chart.json").read_bytes() == whole
    assert json.loads(out) == result


def test_a_scene_that_holds_nothing_out_and_searches_the_height_alone_is_charted(tiny, tmp_path, capsys):
    scene = write_scene(tmp_path, {"traffic": {"holdout": 0.0}, "objective": {"metric": "view-coverage"}})
    out, _ = done(capsys, "chart", scene, "--quick", "--json", "--out", tmp_path / "run")
    result = json.loads(out)
    assert result["judged_on"] == "searched"
    assert result["metric"] == "view-coverage"
    assert all(list(row["shift"]) == ["height_m"] for row in result["ablations"] if row["shift"])


# --- what is refused --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("text", "share"), [("1%", 0.01), ("0.5 %", 0.005), ("0.02", 0.02), ("100%", 1.0)])
def test_a_tolerance_is_a_share(text, share):
    assert parse_share(text, "--max-regret") == pytest.approx(share)


@pytest.mark.parametrize("text", ["0", "101%", "nan", "tilt_deg=1"])
def test_another_tolerance_is_refused_in_one_line(text, tmp_path, capsys):
    line = refused(capsys, tmp_path, "chart", write_scene(tmp_path, MAPPED), f"--max-regret={text}", "--out", tmp_path)
    assert "--max-regret" in line
    assert "a share above 0 up to 1" in line


@pytest.mark.parametrize(
    ("verb", "fixed", "said"),
    [
        ("chart", {"height_m": 4.0}, "fixes every coordinate"),
        ("stability", {"height_m": 4.0, "y_m": [-1.0, 0.0]}, "fixes height_m and tilt_x_deg"),
    ],
)
def test_a_scene_that_searches_nothing_is_refused(tmp_path, capsys, verb, fixed, said):
    scene = write_scene(tmp_path, {"deployment": fixed, **REGION})
    assert said in refused(capsys, tmp_path, verb, scene, "--out", tmp_path / "run")
