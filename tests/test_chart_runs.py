"""The verb chart: the ladder, whole studies on a small scene, stopped ones, and what is refused."""

from __future__ import annotations

import csv
import json
import pickle
from dataclasses import replace

import numpy as np
import pytest

from blender_lidar.casting import is_available
from blender_lidar.commands.chart import parse_share
from blender_lidar.errors import InputError, MissingFileError
from blender_lidar.scoring.fidelity import Fidelity
from blender_lidar.sensors.pose import Pose
from blender_lidar.studies import chart as study
from blender_lidar.studies import ladder
from blender_lidar.studies.ablations import ablations
from blender_lidar.studies.chart import read_paired
from blender_lidar.studies.driver import Job, frame_scorer, landscapes
from blender_lidar.studies.effects import candidates
from blender_lidar.studies.experiments import grounded
from blender_lidar.studies.ladder import ChartEffort, count_hits, time_fidelities
from tests.refusals import refused
from tests.small_scene import CASTER, MAPPED, cli, done, without_charts, write_scene

TINY = ChartEffort(3, 8, 2, 6, 2, 8, phases=2, rounds=2, hit_frames=1, hit_mountings=1, quick=True)
POSES = (Pose(0.0, 0.0, 3.0, 0.25), Pose(0.0, 0.0, 4.4, 0.1))


@pytest.fixture
def tiny(monkeypatch):
    """Whole studies of seconds, without pictures."""
    if CASTER == "exact":
        pytest.skip("no fast caster is installed")
    monkeypatch.setattr("blender_lidar.commands.chart.QUICK_CHART", TINY)
    monkeypatch.setattr(ladder, "CASTERS", (CASTER, "exact"))  # another one takes seconds to load
    monkeypatch.setattr(ladder, "STRIDES", (1, 4))
    kept = ("ground", "body shape", "azimuth offsets", "drop-out", "float32")
    monkeypatch.setattr(study, "ablations", lambda *given: [one for one in ablations(*given) if one.what in kept])
    without_charts(monkeypatch)


# --- the ladder -------------------------------------------------------------------------------------------------------


def test_the_ladder_begins_with_the_reference_and_every_rung_has_a_name_of_its_own(site):
    rungs = ladder.ladder(site)
    assert rungs[0] == ladder.LadderRung(Fidelity("detailed"))
    names = [rung.fidelity.name for rung in rungs]
    assert len(set(names)) == len(names)
    assert len({rung.fidelity.text for rung in rungs}) == len(names)
    plain = [rung.fidelity for rung in rungs if rung.twin is None]
    assert {(one.detail, one.stride, one.frames) for one in plain} == {
        (detail, stride, frames)
        for detail in ("box", "body", "detailed")
        for stride in (1, 2, 4, 8)
        for frames in (None, 3, 2, 1)
    }
    assert pickle.loads(pickle.dumps(rungs)) == rungs


def test_phases_are_spread_over_a_stride():
    assert [one.phase for one in ladder.phased(Fidelity("box", 8), 4)] == [0, 2, 4, 6]
    assert [one.phase for one in ladder.phased(Fidelity("box", 2), 4)] == [0, 1]
    assert ladder.phased(Fidelity("box"), 4) == [Fidelity("box")]


def test_shares_that_leave_as_many_frames_as_another_are_no_rungs():
    assert (ladder.frame_counts(30), ladder.frame_counts(2)) == ([None, 15, 8, 4], [None, 1])
    assert ladder.frame_counts(1) == [None]


@pytest.mark.parametrize("change", [{"culled": False}, {"ground": True}])
def test_neither_culling_nor_the_ground_changes_a_score(site, change):
    fidelities = Fidelity("body", 4), replace(Fidelity("body", 4), **change)
    found = [next(landscapes(site, [Job(ladder.variation(one), POSES)])).objective for one in fidelities]
    np.testing.assert_array_equal(*found)
    assert ladder.variation(fidelities[1]).scorer is (grounded if fidelities[1].ground else frame_scorer)


@pytest.mark.skipif(not (is_available("bvh") and is_available("embree")), reason="needs both trees")
def test_casters_come_to_the_same_scores_and_to_the_hits_of_the_oracle(site):
    fidelities = [Fidelity("detailed", 4, caster=caster) for caster in ("bvh", "embree")]
    found = [next(landscapes(site, [Job(ladder.variation(one), POSES)])).objective for one in fidelities]
    np.testing.assert_array_equal(*found)
    for count in count_hits(site, site.search[:2], POSES, ["bvh", "embree"]):
        assert count["hits"] > 0
        assert (count["hit_or_miss"], count["vehicle"]) == (0, 0)
        assert count["largest_range_m"] < 1e-6


def test_rays_that_differ_from_the_oracles_are_counted():
    oracle = np.array([1.0, 2.0, np.inf, 4.0, 5.0]), np.array([0, 1, -1, 2, 3])
    found = np.array([1.0, np.inf, 3.0, 4.5, 5.25]), np.array([0, -1, 2, 1, 3])
    counts = {"rays": 5, "hits": 4, "hit_or_miss": 2, "vehicle": 1}
    assert ladder.differing_hits(oracle, found) == counts | {"largest_range_m": 0.25}


def test_every_fidelity_is_timed_in_every_round_on_every_frame(site):
    timed = time_fidelities(site, [Fidelity("box"), Fidelity("detailed")], POSES, 3)
    for evaluation_s, build_s in timed.values():
        assert evaluation_s.shape == (3, len(site.search))
        assert (evaluation_s > 0.0).all()
        assert (build_s > 0.0).all()


def test_candidates_lie_between_the_bounds_and_the_seed_moves_them(site):
    first = candidates(site.scenario, 32)
    assert (first.variables, len(first.poses)) == (("height_m", "tilt_x_deg"), 33)
    assert first.poses[0] == site.scenario.baseline_pose
    assert ((first.points >= [2.0, 0.0]) & (first.points <= [4.5, 25.0])).all()
    other = replace(site.scenario, search=replace(site.scenario.search, seed=7))
    assert not np.allclose(candidates(other, 32).points, first.points)


# --- whole studies ----------------------------------------------------------------------------------------------------


def test_a_chart_leaves_tables_a_report_and_a_sentence(tiny, tmp_path, capsys):
    scene = write_scene(tmp_path, MAPPED)
    out, _ = done(capsys, "chart", scene, "--quick", "--other-sensor", "VLP-16", "--out", tmp_path / "run")
    result = json.loads((tmp_path / "run" / "chart.json").read_text())
    tables = {}
    for name in ("chart", "ablation"):
        with (tmp_path / "run" / f"{name}.csv").open(newline="") as stream:
            tables[name] = list(csv.DictReader(stream))
    assert [row["name"] for row in tables["chart"]] == [row["name"] for row in result["rungs"]]
    assert [row["what"] for row in tables["ablation"]] == [row["what"] for row in result["ablations"]]
    report = (tmp_path / "run" / "report.md").read_text()
    assert result["sentence"] in " ".join(out.split())
    assert result["sentence"] in report
    assert all(f"| {row['name']} |" in report for row in result["rungs"])
    reference = result["rungs"][0]
    assert (reference["error"], reference["regret"], reference["within"], reference["speedup"]) == (0.0, 0.0, True, 1.0)
    best = next(row for row in result["rungs"] if row["name"] == result["recommended"])
    assert best["within"]
    for row in result["rungs"]:
        first, middle, third = (row["milliseconds"][key] for key in ("first_quartile", "median", "third_quartile"))
        assert 0.0 < first <= middle <= third
        assert row["same_as_twin"] in (None, True)
    places = [one["where"] for one in result["validated"]]
    assert places[0].startswith("other blocks")
    assert places[1].startswith("VLP-16")
    ground = next(row for row in result["ablations"] if row["what"] == "ground")
    assert (ground["bias"], ground["error"], ground["regret"]) == (0.0, pytest.approx(0.0, abs=1e-12), 0.0)


def test_a_chart_that_was_stopped_goes_on_to_the_same_result(tiny, tmp_path, capsys):
    """But for the times, which are measured once and kept."""
    words = ("chart", write_scene(tmp_path, MAPPED), "--quick", "--other-sensor", "none", "--out", tmp_path / "run")
    assert cli(capsys, *words)[0] == 0
    whole = (tmp_path / "run" / "chart.json").read_bytes()
    for stage in sorted((tmp_path / "run" / "stages").glob("*.json"))[::3]:
        if stage.stem != "times":
            stage.unlink()
    (tmp_path / "run" / "chart.json").unlink()
    assert "holds a study already" in refused(capsys, tmp_path, *words)
    out, _ = done(capsys, *words, "--resume", "--json", "--workers", 2)
    assert (tmp_path / "run" / "chart.json").read_bytes() == whole
    assert json.loads(out) == json.loads(whole)


def test_a_scene_that_holds_nothing_out_and_searches_the_height_alone_is_charted(tiny, tmp_path, capsys):
    scene = write_scene(tmp_path, {"traffic": {"holdout": 0.0}, "objective": {"metric": "log-points"}})
    words = ("--quick", "--other-sensor", "none", "--json", "--out", tmp_path / "run")
    out, _ = done(capsys, "chart", scene, *words)
    result = json.loads(out)
    assert (result["judged_on"], result["validated"]) == ("searched", [])
    assert result["metric"] == "log-points"
    assert all(list(row["shift"]) == ["height_m"] for row in result["ablations"] if row["shift"])


def test_an_imperfect_sensor_is_charted_with_what_it_has_left_out_and_with_all_experiments(tiny, tmp_path, capsys):
    scene = write_scene(tmp_path, {**MAPPED, "sensor": {"dropout": 0.1}})
    words = ("--quick", "--other-sensor", "none", "--json", "--out", tmp_path / "run")
    out, _ = done(capsys, "chart", scene, *words)
    rows = {row["what"]: row for row in json.loads(out)["ablations"]}
    assert abs(rows["float32"]["bias"]) < 1e-3
    assert rows["drop-out"]["value"] == "0.1, as the scene has it"


def test_azimuth_offsets_that_the_scenes_sensor_has_not_are_ablated_on_the_other_one(tiny, tmp_path, capsys):
    scene = write_scene(tmp_path, MAPPED)
    words = ("--quick", "--json", "--out", tmp_path / "run")
    out, _ = done(capsys, "chart", scene, *words, "--other-sensor", "RS-80")
    (row,) = (row for row in json.loads(out)["ablations"] if row["what"] == "azimuth offsets")
    assert row["value"].endswith("deg; RS-80 and its own floor")
    assert abs(row["bias"]) > 0.0


def test_rows_of_random_sensors_say_how_often_they_were_drawn(tiny, tmp_path, capsys):
    words = ("--quick", "--other-sensor", "none", "--out", tmp_path / "run")
    out, _ = done(capsys, "chart", write_scene(tmp_path, MAPPED), *words)
    result = json.loads((tmp_path / "run" / "chart.json").read_text())
    rows = {row["what"]: row["draws"] for row in result["ablations"]}
    assert rows == {"ground": 1, "body shape": 1, "azimuth offsets": 0, "drop-out": 2, "float32": 1}
    assert "5 % of all returns; mean of 2 draws" in out
    assert result["ablation_mountings"] == 6


def test_a_default_other_sensor_that_the_scene_does_not_suit_is_told_of_and_left_out(tiny, tmp_path, capsys):
    """The scene's gate is nearer than the RS-80 sees anything."""
    scene = write_scene(tmp_path, {**MAPPED, "sensor": {"RS-80": {"range_gate_m": 0.1}}})
    out, err = done(capsys, "chart", scene, "--quick", "--json", "--out", tmp_path / "run")
    assert "note: not tried with RS-80: " in err
    assert [one["where"][:12] for one in json.loads(out)["validated"]] == ["other blocks"]


# --- beside real cars, and what is refused ----------------------------------------------------------------------------


def paired_file(path):
    error = {"median": 0.05, "interval_90": [0.04, 0.06]}
    variants = [{"detail": "body", "absolute_error_bits": error, "bias_bits": {"median": 0.0}}]
    path.write_text(json.dumps({"vehicles": 12, "losses": "none", "variants": variants}))
    return path


def test_the_errors_of_a_paired_comparison_stand_beside(tiny, tmp_path, capsys):
    paired_file(tmp_path / "compare.json")
    words = ("--quick", "--other-sensor", "none", "--paired-errors", tmp_path, "--out", tmp_path / "run")
    out, _ = done(capsys, "chart", write_scene(tmp_path, MAPPED), *words)
    assert "Against 12 recorded vehicles (lost: none), median error of each [bits]: body 0.050 (0.040 to 0.060)" in out


def test_what_is_no_paired_comparison_is_refused(tmp_path):
    found = read_paired(paired_file(tmp_path / "compare.json"))
    assert found["variants"] == [{"detail": "body", "error_bits": 0.05, "interval_90": [0.04, 0.06]}]
    for text in ("{}", "[]", "no JSON", '{"variants": [{}]}', '{"variants": 3}'):
        (tmp_path / "compare.json").write_text(text)
        with pytest.raises(InputError, match=r"is no compare.json"):
            read_paired(tmp_path)
    (tmp_path / "compare.json").write_bytes(b"\xa2")
    with pytest.raises(InputError, match=r"--paired-errors: .*is no compare.json"):
        read_paired(tmp_path)
    with pytest.raises(MissingFileError, match="nothing: there is no such file"):
        read_paired(tmp_path / "nothing")


@pytest.mark.parametrize(("text", "share"), [("1%", 0.01), ("0.5 %", 0.005), ("0.02", 0.02), ("100%", 1.0)])
def test_a_tolerance_is_a_share(text, share):
    assert parse_share(text, "--max-regret") == pytest.approx(share)


@pytest.mark.parametrize("text", ["", "0", "0%", "-1%", "101%", "nan", "tilt_deg=1", "inf"])
def test_another_tolerance_is_refused_in_one_line(text, tmp_path, capsys):
    line = refused(capsys, tmp_path, "chart", write_scene(tmp_path, MAPPED), f"--max-regret={text}", "--out", tmp_path)
    assert "--max-regret" in line
    assert "a share above 0 up to 1" in line


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ("--other-sensor RS-1000", "RS-1000"),
        ("--other-sensor RS-16", "--other-sensor: is 'RS-16', the scene's own"),
        ("--other-sensor RS-LiDAR-16", "--other-sensor: is 'RS-LiDAR-16', the scene's own"),
        ("--sensor VLP-16 --other-sensor VLP-16", "--other-sensor: is 'VLP-16', the scene's own"),
    ],
)
def test_another_sensor_is_neither_unknown_nor_the_scenes_own(tmp_path, capsys, words, told):
    scene = write_scene(tmp_path, MAPPED)
    assert told in refused(capsys, tmp_path, "chart", scene, *words.split(), "--out", tmp_path / "run")


def test_a_scene_that_searches_nothing_is_refused(tmp_path, capsys):
    scene = write_scene(tmp_path, {"deployment": {"height_m": 4.0}})
    assert "fixes every coordinate" in refused(capsys, tmp_path, "chart", scene, "--out", tmp_path / "run")


def test_the_other_sensor_is_part_of_what_a_resumed_chart_must_share(site):
    alone, beside = study.chart_identity(site, TINY, None), study.chart_identity(site, TINY, site)
    assert {key for key in alone if alone[key] != beside[key]} == {"chart other"}


@pytest.mark.parametrize(("old", "new"), [("--tolerance", "--max-regret")])
def test_an_option_that_has_another_name_now_is_answered_with_it(capsys, tmp_path, old, new):
    line = refused(capsys, tmp_path, "chart", write_scene(tmp_path, MAPPED), old, "1%", "--out", tmp_path / "run")
    assert old in line
    assert new in line
