"""The verb stability: every change on a small scene, whole studies, stopped ones, and what is refused."""

from __future__ import annotations

import csv
import json
import pickle
from dataclasses import replace

import numpy as np
import pytest

import tests.research  # noqa: F401
from blender_lidar.errors import InputError
from blender_lidar.plugins import short_name
from blender_lidar.report.stability import HEADINGS, STABILITY_REPORT
from blender_lidar.scene.scenario import load_scenario
from blender_lidar.scene.site import prepare
from blender_lidar.scoring.evaluation import site_evaluator
from blender_lidar.scoring.frame_scorer import FrameScorer
from blender_lidar.studies import stability as study
from blender_lidar.studies.candidates import grid_candidates
from blender_lidar.studies.driver import AS_IT_IS, HELD_OUT, Job, Variation, landscapes
from blender_lidar.studies.findings import VERDICTS
from blender_lidar.studies.stability import StabilityEffort
from blender_lidar.studies.variations import TRAFFIC, metric_variations, sensor_variations, traffic_variations
from rival_metrics import OPTIONS
from tests.refusals import refused
from tests.small_scene import CASTER, MAPPED, done, mounting, traffic_rows, without_charts, write_scene, write_table

RIVALS = (OPTIONS["log_returns"], OPTIONS["voxel_occupancy"])
TINY = StabilityEffort(3, 2, heights=2, tilts=3, fine_tilts=5, seeds=2, budget=1.0, draws=1, quick=True)


@pytest.fixture
def one_study(monkeypatch):
    """Whole studies of seconds: fewer changes of each kind, all of them real."""
    for name in ("metric_variations", "sensor_variations", "traffic_variations"):
        every = getattr(study, name)
        monkeypatch.setattr(study, name, lambda *given, every=every: every(*given)[:3])
    monkeypatch.setattr("blender_lidar.commands.studies.QUICK_STABILITY", TINY)
    without_charts(monkeypatch)


@pytest.fixture
def tiny(one_study):
    """The same, where a study does not take a minute."""
    if CASTER == "exact":
        pytest.skip("no fast caster is installed, and one whole study by the float64 one is enough")


def mountings(site):
    return grid_candidates(site.scenario, (mounting({"height_m": 4.0, "tilt_x_deg": 12.0}),), 2, 3)


def every_variation(site):
    return [*traffic_variations(site, 2), *metric_variations(site, RIVALS), *sensor_variations(site, 2)]


# --- changes ----------------------------------------------------------------------------------------------------------


def test_every_change_has_a_name_of_its_own_and_can_be_sent_to_a_worker(site):
    variations = every_variation(site)
    assert len({variation.stage for variation in variations}) == len(variations)
    again = pickle.loads(pickle.dumps(variations))
    assert [variation.stage for variation in again] == [variation.stage for variation in variations]


def test_no_change_is_what_the_scene_has_already(site):
    for variation in every_variation(site):
        changed = variation.changed(site)
        assert len(changed.search) == len(site.search)
        pairs = zip(changed.search, site.search, strict=True)
        as_before = (changed.observation, changed.scoring) == (site.observation, site.scoring)
        assert not (as_before and all(one.vehicle_id is other.vehicle_id for one, other in pairs)), variation


def test_without_a_loss_there_is_neither_c_nor_view_nor_delta_to_vary_as_the_objective_asks_for_none(site):
    without = replace(site, scoring=replace(site.scoring, loss=None))
    assert {variation.what for variation in metric_variations(without)} == {"cell size", "other metric"}
    layouts = mountings(site).layouts
    for change in ({"view": "min"}, {"threshold": 0.05}):
        other = replace(without, scoring=replace(without.scoring, **change))
        scored = [next(landscapes(one, [Job(AS_IT_IS, layouts)])).objective for one in (without, other)]
        np.testing.assert_array_equal(*scored)


def test_changes_of_the_sensor_leave_traffic_and_score_alone_and_the_others_leave_the_sensor(site):
    for variation in sensor_variations(site, 1):
        changed = variation.changed(site)
        assert changed.scoring == site.scoring
        assert changed.search is site.search
    for variation in (*metric_variations(site), *traffic_variations(site, 1)):
        assert variation.changed(site).observation.lattice is site.observation.lattice


def test_changed_traffic_never_counts_a_searched_vehicle_or_its_copy_among_the_held_out(tmp_path):
    """Searched up to a block before what is held out: a jam pulls in vehicles that as recorded only that shows."""
    settings = {"frames": None, "frame_ids": [18, 20, 22], "block_s": 1.0}
    write_table(tmp_path / "traffic.csv", traffic_rows(vehicles=120))
    site = prepare(load_scenario(write_scene(tmp_path, {**MAPPED, "traffic": settings})))
    step = int(site.recording.vehicle_id.max()) + 1
    for variation in traffic_variations(site, 2):
        changed = variation.changed(site)
        searched, judged = (
            np.concatenate([frame.vehicle_id[frame.counted] % step for frame in frames])
            for frames in (changed.search, changed.holdout)
        )
        assert not np.isin(judged, [*site.plan.searched_ids, *searched]).any(), variation


@pytest.mark.parametrize("workers", [1, 2])
def test_landscapes_equal_what_the_evaluator_says_whatever_the_number_of_workers(site, workers):
    site = replace(site, scenario=replace(site.scenario, model=replace(site.scenario.model, workers=workers)))
    layouts = mountings(site).layouts
    refused = Variation(TRAFFIC, "what cannot be", "", _refuse)
    jobs = [Job(AS_IT_IS, layouts), Job(refused, layouts), Job(AS_IT_IS, layouts[:2], HELD_OUT)]
    counted = []
    searched, text, held_out = landscapes(site, jobs, counted.append)
    for scored, frames in ((searched, site.search), (held_out, site.holdout)):
        with site_evaluator(site, frames) as evaluator:
            totals = evaluator.totals(layouts[: len(scored.objective)])
        np.testing.assert_array_equal(scored.objective, totals.objective)
        np.testing.assert_array_equal(scored.vehicles, totals.vehicles)
    assert text == "it cannot be"
    assert sum(counted) == 2 * len(site.search) + len(site.holdout)


def test_what_changes_the_score_alone_is_cast_once_and_comes_to_what_it_comes_to_alone(site, monkeypatch):
    layouts = mountings(site).layouts
    jobs = [Job(one, layouts) for one in (AS_IT_IS, *metric_variations(site, RIVALS))]
    jobs.insert(3, Job(Variation(TRAFFIC, "what cannot be", "", _refuse, recast=False), layouts))
    jobs[7:] = [replace(job, layouts=layouts[4:1:-1]) for job in jobs[7:]]
    counted, casts, see = [], [], FrameScorer.see
    monkeypatch.setattr(FrameScorer, "see", lambda *given, **kept: casts.append(len(given[1])) or see(*given, **kept))
    together = list(landscapes(site, jobs, counted.append))
    assert sum(casts) == len(site.search) * (len(layouts) + 3)  # jobs of the same mountings cast these once a frame
    assert sum(counted) == len(jobs) * len(site.search)
    for job, scored in zip(jobs, together, strict=True):
        (alone,) = landscapes(site, [job])
        if isinstance(alone, str):
            assert scored == alone == "it cannot be"
        else:
            np.testing.assert_allclose(scored.objective, alone.objective, rtol=1e-12, atol=1e-12)
            np.testing.assert_array_equal(scored.vehicles, alone.vehicles)


def _refuse(site):
    raise InputError("it cannot be")


def test_a_changed_site_is_scored_as_a_scene_that_says_so(site, tmp_path):
    """Independent of the study: the scene file itself asks for the change."""
    for variation, table, key, value in (
        (("metric", "cell size", "10 cm"), "objective", "cell_m", 0.1),
        (("metric", "view of Eq. 11", "min"), "objective", "view", "min"),
        (("metric", "other metric", "view-coverage"), "objective", "metric", "view-coverage"),
        (("metric", "other metric", short_name(RIVALS[0])), "objective", "metric", RIVALS[0]),
        (("sensor", "glass drop-out", "1"), "sensor", "glass_dropout", 1.0),
        (("sensor", "rotation rate", "10 Hz"), "sensor", "rotation_hz", 10.0),
    ):
        chosen = next(one for one in every_variation(site) if (one.section, one.what, one.value) == variation)
        asked = prepare(load_scenario(write_scene(tmp_path, {**MAPPED, table: {key: value}})))
        layouts = [(site.scenario.lidar.mounting({"height_m": 4.0}),), (site.scenario.lidar.baseline,)]
        with site_evaluator(asked, asked.search) as evaluator:
            expected = evaluator.totals(layouts).objective
        (found,) = landscapes(site, [Job(chosen, tuple(layouts))])
        np.testing.assert_allclose(found.objective, expected, rtol=1e-12)


# --- whole studies ----------------------------------------------------------------------------------------------------


def test_a_study_leaves_a_verdict_on_every_line_and_one_that_was_stopped_comes_to_the_same(one_study, tmp_path, capsys):
    run, words = tmp_path / "run", ("stability", write_scene(tmp_path, MAPPED), "--quick", "--out", tmp_path / "run")
    out, _ = done(capsys, *words)
    whole = (run / "stability.json").read_bytes()
    result = json.loads(whole)
    with (run / "stability.csv").open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert len(rows) == len(result["findings"])
    assert {row["verdict"] for row in rows} <= {*VERDICTS, ""}
    without = [row["what"] for row in rows if not row["verdict"]]
    assert without == ["optimum on other traffic of this kind", *(what for what in without if "higher for" in what)]
    told = [row for row in rows if row["verdict"] not in ("undecided", "") and row["what"] != "gain over the baseline"]
    assert all(row["detectable_share_lost_interval_90_low"] for row in told)
    assert {row["section"] for row in rows} == {"traffic", "mounting", "metric", "sensor", "search"}
    assert {"loss", "objective_lost_interval_90_low", "detectable_share_mounting"} <= set(rows[0])
    report = (run / "report.md").read_text()
    assert all(row["text"] in report for row in rows)
    for heading in HEADINGS.values():
        assert f"\n{heading}\n" in out
        assert f"\n{heading}: " in out
    assert "as optimise answers, seed 1" in " ".join(out.split())
    for stage in sorted((run / "stages").glob("*.json"))[1::3]:
        stage.unlink()
    (run / "stability.json").unlink()
    assert "holds a study already" in refused(capsys, tmp_path, *words)
    out, _ = done(capsys, *words, "--resume", "--workers", 2, "--json")
    assert (run / "stability.json").read_bytes() == whole
    assert json.loads(out) == result


def test_a_mounting_of_ones_own_that_sees_nothing_is_judged_by_cross_fitting_where_nothing_is_held_out(
    tiny, tmp_path, capsys
):
    scene = write_scene(tmp_path, {**MAPPED, "traffic": {"holdout": 0.0, "frames": None}})
    words = ("--quick", "--frame-ids", "0:20:4", "--height", 30, "--tilt-x", 7, "--yaw", 30)  # beyond the range gate
    out, _ = done(capsys, "stability", scene, *words, "--out", tmp_path / "run", "--json")
    result = json.loads(out)
    assert (result["mounting_given"], result["answered_frames"]) == (True, 6)
    text = STABILITY_REPORT.text(result)
    assert "as given: 30.00 m above the road, tilted 7.0° across it, turned 30.0°; " in text
    assert "(cross-fitting, as too little is held out)" in " ".join(text.split())
    of = {finding["what"]: finding for finding in result["findings"]}
    assert of["as the scene has it"]["numbers"]["detectable_share"]["mounting"] == 0.0
    gained = of["gain over the baseline"]["numbers"]
    assert gained["gain_over_baseline"] == pytest.approx(
        result["objective_per_vehicle"] - result["baseline_per_vehicle"]
    )


def test_where_only_the_height_is_searched_candidates_differ_by_height_alone(site):
    scenario = load_scenario(site.scenario.source)
    lidar, (place,) = scenario.lidar, scenario.lidar.deployment.places
    place = replace(place, fixed={**place.fixed, "tilt_x_deg": 12.0}, bounds={"height_m": (2.0, 4.5)})
    scenario = scenario.with_lidars(replace(lidar, deployment=replace(lidar.deployment, places=(place,))))
    found = grid_candidates(scenario, (mounting({"tilt_x_deg": 12.0}),), 6, 26)
    assert found.points[1:].tolist() == [[height, 12.0] for height in (2.0, 2.5, 3.0, 3.5, 4.0, 4.5)]


def test_fewer_frames_are_not_so_few_that_they_are_empty(site):
    empty = [replace(frame, counted=np.zeros_like(frame.counted)) for frame in site.search[1:]]
    sparse = replace(site, search=(site.search[0], *empty))
    assert study.with_fewer_frames(sparse, 2) is sparse
    assert len(study.with_fewer_frames(site, 2).search) == 2


def test_a_study_judges_what_optimise_answers(tmp_path, capsys, monkeypatch):
    without_charts(monkeypatch)
    scene = write_scene(tmp_path, {**MAPPED, "search": {"particles": 6, "iterations": 4}})
    done(capsys, "optimise", scene, "--out", tmp_path / "run")
    answer = json.loads((tmp_path / "run" / "result.json").read_text())["deployment"]
    done(capsys, "stability", scene, "--quick", "--out", tmp_path / "study")
    found = json.loads((tmp_path / "study" / "stability.json").read_text())["mounting"]
    assert {key: found[key] for key in ("height_m", "tilt_x_deg")} == {
        key: pytest.approx(answer[key]) for key in ("height_m", "tilt_x_deg")
    }
