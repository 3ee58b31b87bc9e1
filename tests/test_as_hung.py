"""Runs with installation errors: what they answer, what their figures are, how these are told, and what is refused."""

from __future__ import annotations

import copy
import csv
import json
from pathlib import Path

import numpy as np
import pytest

from blender_lidar.cli import main
from blender_lidar.errors import InputError
from blender_lidar.report.text import short_lines
from blender_lidar.run.answer import doubt
from blender_lidar.run.as_hung import JUDGED_BASE, HungScores, two_wheelers_as_hung
from blender_lidar.run.comparison import Comparison
from blender_lidar.run.folder import RunFolder
from blender_lidar.run.optimise import evaluate_site, optimise_site
from blender_lidar.run.quantities import quantities
from blender_lidar.run.words import errors_text
from blender_lidar.scene.deployment import HANGS, Installer
from blender_lidar.scene.installation import installed_layout, orthogonal_errors, single_errors
from blender_lidar.scene.scenario import load_scenario, scenario_of
from blender_lidar.scene.site import prepare
from blender_lidar.scoring.evaluation import site_evaluator
from blender_lidar.statistics import share_gain_interval_90, share_interval_90
from tests.refusals import refused
from tests.small_scene import (
    CASTER,
    MAPPED,
    REGION,
    SETTINGS,
    done,
    traffic_rows,
    without_charts,
    write_scene,
    write_table,
)
from tests.test_layouts import POLES, Nobody

pytestmark = [
    pytest.mark.usefixtures("quick"),
    pytest.mark.skipif(CASTER == "exact", reason="no fast caster is installed: these runs would take ten minutes"),
]

FREE = {"height_m": [2.0, 4.5], "tilt_x_deg": [0.0, 25.0]}
WIDE = {"tilt_deg": 4.0, "height_m": 0.3, "yaw_deg": 6.0}
SHAKEN = {
    "traffic": {"frames": 12, "holdout": 0.5, "block_s": 6.0},
    "search": {"particles": 4, "iterations": 5},
    "objective": {"threshold": 0.03},  # which not all reach
    "deployment": {**MAPPED["deployment"], "installer": WIDE},
}


def stored(folder: Path) -> dict:
    return json.loads((folder / "result.json").read_text())


def history(path: Path) -> list[dict[str, float]]:
    with path.open(newline="") as stream:
        return [{key: float(value) for key, value in row.items()} for row in csv.DictReader(stream)]


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """The same scene searched with installation errors and without."""
    folder = tmp_path_factory.mktemp("runs")
    scene = str(write_scene(folder, SHAKEN))
    with pytest.MonkeyPatch.context() as patch:
        without_charts(patch)
        assert main(["optimise", scene, "--out", str(folder / "shaken")]) == 0
        assert main(["optimise", scene, "--installer", "false", "--out", str(folder / "exact")]) == 0
    return folder


def judged(result: dict) -> dict:
    return result["holdout"] or result


# --- What a run leaves ------------------------------------------------------------------------------------------------


def test_without_errors_all_figures_agree_with_those_as_planned(runs):
    result = stored(runs / "exact")
    for scores in (result, result["baseline"]):
        assert scores["objective_as_hung"] == pytest.approx(scores["objective"], abs=1e-9)
        held, hung = scores["holdout"], scores["holdout"]["as_hung"]
        assert hung["detectable_share"] == held["detectable_share"]
        assert hung["interval_90"] == held["detectable_share_interval_90"]
        assert hung["objective_per_vehicle"] == pytest.approx(held["objective_per_vehicle"])
    held, hung = result["holdout"], result["holdout"]["as_hung"]
    assert hung["gain"] == held["detectable_share_gain"]
    assert hung["gain_interval_90"] == held["detectable_share_gain_interval_90"]
    assert hung["objective_gain"] == pytest.approx(held["gain_over_baseline"])
    assert hung["objective_gain_interval_90"] == pytest.approx(held["interval_90"])
    assert hung["worst_degree"] == hung["worst_10_cm"] == held["detectable_share"]
    assert history(runs / "exact" / "history.csv")[-1]["best"] == result["objective"]
    assert not (runs / "exact" / "history_candidates.csv").exists()
    assert result["installer"] is False
    assert errors_text(result) == ""
    assert not {"low", "degree", "height", "planned"} & set(quantities(result))


def test_the_history_ends_with_the_objective_as_hung_of_the_answer(runs):
    result, rows = stored(runs / "shaken"), history(runs / "shaken" / "history.csv")
    assert rows[-1]["best"] == result["objective_as_hung"]
    best = max(rows, key=lambda row: row["objective"])
    assert {key: best[key] for key in ("height_m", "tilt_x_deg")} == pytest.approx(
        {key: result["deployment"][key] for key in ("height_m", "tilt_x_deg")}
    )
    candidates = history(runs / "shaken" / "history_candidates.csv")
    assert result["evaluations"] == len(rows) + len(candidates)
    assert result["installer"] == {**WIDE, "aim": "mean"}


def test_evaluate_of_the_answer_prints_its_numbers(runs, tmp_path, capsys):
    result = stored(runs / "shaken")
    mount = result["deployment"]
    words = ["--height", repr(mount["height_m"]), "--tilt-x", repr(mount["tilt_x_deg"]), "--out", tmp_path / "given"]
    found = json.loads(done(capsys, "evaluate", runs / "scene.toml", *words, "--json")[0])
    for key in ("objective", "objective_as_hung", "objective_per_vehicle", "detectable_share", "holdout"):
        assert found[key] == result[key], key
    assert found["baseline"]["holdout"] == result["baseline"]["holdout"]
    for name in ("vehicles.csv", "vehicles_baseline.csv"):
        assert (tmp_path / "given" / name).read_bytes() == (runs / "shaken" / name).read_bytes()


def test_figures_are_those_of_each_installation_alone(runs):
    result, site = stored(runs / "shaken"), prepare(load_scenario(runs / "scene.toml"))
    layout = (site.scenario.lidar.mounting(result["deployment"]),)
    evaluator, installers = site_evaluator(site, site.holdout), site.scenario.installers

    def shares(plan, errors):
        return evaluator.totals([installed_layout(plan, error) for error in errors]).detectable_share()

    errors, hung = orthogonal_errors(installers, JUDGED_BASE), result["holdout"]["as_hung"]
    after, before = shares(layout, errors), shares(site.scenario.baselines, errors)
    assert hung["detectable_share"] == pytest.approx(after.mean())
    assert hung["gain"] == pytest.approx(after.mean() - before.mean())
    assert result["baseline"]["holdout"]["as_hung"]["detectable_share"] == pytest.approx(before.mean())
    planned, (degrees, heights) = result["holdout"]["detectable_share"], single_errors(installers, 1.0, 0.1)
    assert hung["worst_degree"] == pytest.approx(min(planned, *shares(layout, degrees)))
    assert hung["worst_10_cm"] == pytest.approx(min(planned, *shares(layout, heights)))
    low, high = hung["interval_90"]
    assert low <= hung["detectable_share"] <= high
    assert hung["nine_of_ten"] < hung["detectable_share"]


def test_a_baseline_that_hangs_already_is_not_shaken(runs, tmp_path, capsys):
    scene = write_scene(tmp_path, {**SHAKEN, "baseline": {"installer": False}})
    out, _ = done(capsys, "evaluate", scene, "--height", 4, "--tilt-x", 15, "--out", tmp_path / "run", "--json")
    result = json.loads(out)
    held = result["baseline"]["holdout"]
    assert held["as_hung"]["detectable_share"] == held["detectable_share"]
    assert result["baseline"]["objective_as_hung"] == result["baseline"]["objective"]
    assert result["holdout"]["as_hung"]["detectable_share"] != result["holdout"]["detectable_share"]
    assert result["identity"]["[baseline] installer"] is False
    again = load_scenario(tmp_path / "run" / "scene.toml")
    assert again.baseline_hangs


def test_the_answer_is_no_worse_as_hung_than_the_one_that_was_searched_as_planned(runs):
    shaken, exact, site = stored(runs / "shaken"), stored(runs / "exact"), prepare(load_scenario(runs / "scene.toml"))
    layouts = [(site.scenario.lidar.mounting(one["deployment"]),) for one in (shaken, exact)]
    many = np.random.default_rng(0).uniform(-1.0, 1.0, (200, 1, 4)) * np.array(site.scenario.installers[0].half_widths)
    evaluator = site_evaluator(site, site.search)
    hung = [evaluator.totals([installed_layout(one, error) for error in many]).objective.sum(axis=1) for one in layouts]
    difference = hung[0] - hung[1]
    assert difference.mean() >= -2.0 * difference.std() / np.sqrt(len(many))


# --- What is said -----------------------------------------------------------------------------------------------------


def test_hang_is_carried_by_the_gain_as_hung(runs):
    result = copy.deepcopy(stored(runs / "shaken"))
    hung = result["holdout"]["as_hung"]
    result["holdout"]["blocks"], hung["objective_gain_interval_90"], hung["gain_interval_90"] = (
        9,
        [0.1, 0.3],
        [0.1, 0.3],
    )
    assert doubt(result) == ""
    result["holdout"]["as_hung"]["gain_interval_90"] = [-0.1, 0.3]
    assert doubt(result)
    told = quantities(result)
    assert told["after"].value == 100.0 * hung["detectable_share"]
    assert told["before"].value == 100.0 * result["baseline"]["holdout"]["as_hung"]["detectable_share"]


def test_terminal_page_sheet_and_panel_tell_the_same_share_as_hung(runs, tmp_path, capsys):
    result, run = stored(runs / "shaken"), runs / "shaken"
    told = quantities(result)
    out, _ = done(capsys, "evaluate", runs / "scene.toml", "--run", run, "--out", tmp_path / "again")
    texts = {
        "terminal": out,
        "page": (run / "report.html").read_text(),
        "sheet": (run / "installation.txt").read_text(),
    }
    for name, text in texts.items():
        flat = " ".join(text.split())
        assert f"{told['after']} of the vehicles, as hung" in flat, name
        assert f"exactly as planned {told['planned']}" in flat, name
    assert "Assumed: The LiDAR hangs within ±4° of either tilt, ±0.3 m of height, ±6° of yaw" in " ".join(out.split())
    assert any(line.startswith(f"Detectable: {told['after']} ") for line in short_lines(RunFolder(run).document))


@pytest.mark.parametrize("missed", [0, 6])
def test_a_share_near_a_hundred_percent_has_as_wide_an_interval_with_a_few_installations_that_miss(missed):
    vehicle, hits = np.arange(340), np.ones(340)
    hits[:missed] = 24.0 / 25.0  # by one installation of 25
    low, high = share_interval_90(hits, vehicle, vehicle // 20, 1)
    assert 0.985 < low < 0.992
    assert high == 1.0
    low, high = share_gain_interval_90(np.ones(340), hits, vehicle, vehicle // 20, 1)
    assert -0.015 < low < -0.008
    assert 0.008 < high < 0.015


def test_two_wheelers_are_told_alone_where_there_are_any():
    kinds = np.array(["car", "motorcycle", "bicycle", "car"] * 5)
    table = {"frame": np.zeros(20), "vehicle_id": np.arange(20), "objective": np.zeros(20), "class": kinds}
    table["detectable"] = np.ones(20, dtype=bool)
    boxes = Comparison(table, table, np.arange(20) % 5, np.zeros(20, dtype=int), None, 1)
    seen = np.stack([kinds != "bicycle", kinds == "car"]).astype(float)  # under two errors
    scores = HungScores(0.0 * seen, seen, seen, seen)
    found = two_wheelers_as_hung(boxes, scores, scores)
    assert (found["after"], found["boxes"]) == (0.25, 10)
    table["class"] = np.full(20, "car")
    none = Comparison(table, table, boxes.block, boxes.recording, None, 1)
    assert two_wheelers_as_hung(none, scores, scores) is None


def test_what_nine_of_ten_reach_needs_as_many_vehicles_as_an_interval():
    for vehicles, is_known in ((6, False), (12, True)):
        table = {"frame": np.zeros(vehicles), "vehicle_id": np.arange(vehicles), "objective": np.zeros(vehicles)}
        table["detectable"] = np.arange(vehicles) % 2 == 0
        boxes = Comparison(table, table, np.arange(vehicles) % 6, np.zeros(vehicles, dtype=int), None, 1)
        assert (boxes.low_share(np.stack([table["detectable"]] * 3), 0.1) is not None) == is_known
        assert (boxes.shares()["after_interval_90"] is not None) == is_known


# --- Forms in pairs: poles, several LiDARs, several fidelities, few blocks, more coordinates --------------------------


def site_with(folder: Path, lidars=(), **changes):
    write_table(folder / "traffic.csv", traffic_rows())
    (folder / "poles.csv").write_text(POLES, encoding="utf-8")
    tables = {name: dict(table) for name, table in {**SETTINGS, **REGION}.items() if name != "deployment" or not lidars}
    tables["traffic"] |= {"frames": 3}
    tables["search"] = {"particles": 6, "iterations": 10, "seed": 1}
    for name, table in changes.items():
        tables[name] = {**tables.get(name, {}), **table}
    if lidars:
        tables["lidar"] = [{"name": f"lidar_{number}", **one} for number, one in enumerate(lidars)]
    return prepare(scenario_of(tables, folder=folder))


def optimised(site, folder: Path, **how):
    run = RunFolder(folder)
    with run.begun(**how):
        return optimise_site(site, run, Nobody(), **how)


def given(site, result, folder: Path):
    """The result of the same mountings, evaluated."""
    run = RunFolder(folder)
    rows = zip(site.scenario.lidars, result["lidars"], strict=True)
    layout = tuple(one.mounting(row["deployment"]) for one, row in rows)
    with run.begun():
        return evaluate_site(site, run, layout)


def test_candidate_poles_are_ranked_as_hung(tmp_path):
    stand = {"poles": "poles.csv", "installer": WIDE, "height_m": [2.0, 4.5], "tilt_x_deg": 15.0}
    site = site_with(tmp_path, deployment=stand)
    result = optimised(site, tmp_path / "run")
    hung = [pole["objective_per_vehicle_as_hung"] for pole in result["poles"]]
    assert hung == sorted(hung, reverse=True)
    assert result["poles"][0]["deployment"] == result["deployment"]
    assert hung[0] == pytest.approx(result["objective_as_hung"] / result["vehicles"])
    assert history(tmp_path / "run" / "history.csv")[-1]["best"] == pytest.approx(result["objective_as_hung"])
    best = result["poles"][0]["holdout"]
    assert best["as_hung"]["detectable_share"] == pytest.approx(result["holdout"]["as_hung"]["detectable_share"])
    assert best["difference_to_best"] == 0.0


def test_of_several_lidars_the_one_that_hangs_already_is_not_shaken(tmp_path):
    held = {"x_m": -8.0, "height_m": 4.0, "tilt_x_deg": 15.0}
    site = site_with(tmp_path, [held, {"x_m": 8.0, **FREE, "installer": WIDE}])
    assert site.scenario.installers == (HANGS, Installer(**WIDE))
    result = optimised(site, tmp_path / "run")
    assert [one["installer"] for one in result["lidars"]] == [False, {**WIDE, "aim": "mean"}]
    assert history(tmp_path / "run" / "history.csv")[-1]["best"] == pytest.approx(result["objective_as_hung"])
    same = given(site, result, tmp_path / "given")
    for key in ("objective_as_hung", "objective", "holdout"):
        assert same[key] == pytest.approx(result[key]) if key != "holdout" else same[key] == result[key]


def test_a_search_over_several_fidelities_is_judged_as_hung(tmp_path):
    stand = {"installer": WIDE, "height_m": [2.0, 4.5], "tilt_x_deg": [0.0, 25.0]}
    site = site_with(tmp_path, deployment=stand, search={"fidelity": "auto", "particles": 5, "iterations": 4})
    result = optimised(site, tmp_path / "run")
    rows = history(tmp_path / "run" / "history.csv")
    assert rows[-1]["best"] == result["objective_as_hung"]
    assert 1 <= len(rows) <= 4
    assert result["rungs"]


def test_with_few_blocks_each_judges_as_hung_what_was_chosen_without_it(tmp_path):
    site = site_with(tmp_path, deployment={"installer": WIDE}, traffic={"frames": 8, "holdout": 0.0, "block_s": 15.0})
    result = optimised(site, tmp_path / "run")
    hung = result["cross_fitted"]["optimised"]["as_hung"]
    low, high = hung["interval_90"]
    assert low <= hung["detectable_share"] <= high
    assert result["cross_fitted"]["baseline"]["as_hung"]["detectable_share"] == pytest.approx(
        hung["detectable_share"] - hung["gain"]
    )


def test_a_run_that_was_stopped_goes_on_to_the_same_answer(tmp_path):
    site = site_with(tmp_path, deployment={"installer": WIDE}, search={"particles": 4, "iterations": 6})
    whole = optimised(site, tmp_path / "whole")
    for stop in (3, 9):  # in the search, and in the last stage
        folder = tmp_path / f"stopped_{stop}"
        with pytest.raises(KeyboardInterrupt), RunFolder(folder).begun() as run:
            optimise_site(site, run, Nobody(stop))
        resumed = optimised(site, folder, resume=True)
        for key in ("deployment", "objective_as_hung", "holdout", "evaluations"):
            assert resumed[key] == whole[key]


# --- What is read and refused -----------------------------------------------------------------------------------------


def installers_of(folder: Path, **changes):
    return load_scenario(write_scene(folder, changes)).installers


def test_errors_are_there_unless_the_scene_says_that_the_lidar_hangs(tmp_path):
    assert installers_of(tmp_path, deployment={"installer": None}) == (Installer(),)
    assert Installer().half_widths == pytest.approx((0.05, np.radians(0.5), np.radians(0.5), np.radians(2.0)))
    assert installers_of(tmp_path) == (HANGS,)
    assert installers_of(tmp_path, deployment={"installer": {"tilt_deg": 1.0}}) == (Installer(tilt_deg=1.0),)


@pytest.mark.parametrize("installer", [False, {"tilt_deg": 1.0}, {"yaw_deg": 2.5, "aim": "low"}])
def test_the_scene_as_used_has_the_same_installer(tmp_path, installer):
    scenario = load_scenario(write_scene(tmp_path, {"deployment": {"installer": installer}}))
    again = scenario_of(scenario.with_whole_paths())
    assert again.installers == scenario.installers


def test_an_option_replaces_the_installer_of_every_lidar_but_those_that_hang(tmp_path):
    lidars = [{"x_m": -8.0, "height_m": 4.0, "tilt_x_deg": 15.0}, {"x_m": 8.0, **FREE}]
    tables = {name: dict(table) for name, table in {**SETTINGS, **REGION}.items() if name != "deployment"}
    tables["lidar"] = [{"name": f"lidar_{number}", **one} for number, one in enumerate(lidars)]
    tables["search"] = {"particles": 6, "iterations": 10}
    write_table(tmp_path / "traffic.csv", traffic_rows())
    option = {("deployment", "installer"): ({"tilt_deg": 2.0}, "--installer")}
    assert scenario_of(tables, folder=tmp_path, overrides=option).installers == (HANGS, Installer(tilt_deg=2.0))
    assert scenario_of(tables, folder=tmp_path).installers == (HANGS, Installer())
    tables["lidar"][0]["installer"] = {"tilt_deg": 1.0}
    assert scenario_of(tables, folder=tmp_path).installers == (Installer(tilt_deg=1.0), Installer())
    both = scenario_of(tables, folder=tmp_path, overrides=option).installers
    assert both == (Installer(tilt_deg=1.0), Installer(tilt_deg=2.0))


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        (
            {"objective": {"tolerance": {"tilt_deg": 1.0}}},
            "[objective] tolerance: is called installer now; allowed: in [deployment] or a [[lidar]]",
        ),
        ({"deployment": {"installer": True}}, "[deployment] installer: is True; allowed: a table, or false"),
        ({"deployment": {"installer": 1}}, "[deployment] installer: is 1; allowed: a table, or false"),
        ({"deployment": {"installer": {"tilt_deg": 11}}}, "[deployment.installer] tilt_deg: is 11; allowed: 0 to 10"),
        ({"deployment": {"installer": {"tilt": 1}}}, "unknown key 'tilt'"),
        ({"deployment": {"installer": {"aim": "worst"}}}, "aim: unknown"),
        (
            {"baseline": {"installer": {"tilt_deg": 1}}},
            "[baseline] installer: is {'tilt_deg': 1}; allowed: true or false",
        ),
    ],
)
def test_what_is_no_installer_is_refused_in_one_line(tmp_path, changes, text):
    with pytest.raises(InputError) as error:
        load_scenario(write_scene(tmp_path, changes))
    assert text in str(error.value)
    assert "\n" not in str(error.value)


def test_lidars_of_one_layout_aim_at_one_thing(tmp_path):
    lidars = [{"x_m": x, **FREE, "installer": {"aim": aim}} for x, aim in ((-8.0, "mean"), (8.0, "low"))]
    with pytest.raises(InputError, match="aims are low and mean; allowed: one"):
        site_with(tmp_path, lidars)


def test_the_old_option_is_refused(tmp_path, capsys):
    assert "--tolerance" in refused(capsys, tmp_path, "optimise", "i80", "--tolerance", "tilt_deg=1")
