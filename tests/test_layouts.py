"""Layouts of several LiDARs: their search, what each adds, their installation errors, and what one of them costs."""

from __future__ import annotations

import itertools
import json
import tomllib
from dataclasses import replace

import numpy as np
import pytest

from blender_lidar.run.as_hung import HungObjective
from blender_lidar.run.folder import RunFolder
from blender_lidar.run.layout_search import LayoutObjective, coordinates_of
from blender_lidar.run.layouts import judge_layout, price_of
from blender_lidar.run.optimise import evaluate_site, optimise_site
from blender_lidar.run.replay import Replay
from blender_lidar.run.searches import layout_search
from blender_lidar.scene.scenario import scenario_of
from blender_lidar.scene.site import prepare
from blender_lidar.scoring.evaluation import Evaluator, site_evaluator
from blender_lidar.sensors.model import DATA_FOLDER
from blender_lidar.toml_table import to_toml
from tests.small_scene import REGION, SETTINGS, traffic_rows, without_times, write_table

POLES = "name,x_m,y_m,cost\nleft,-12,0,100\nmiddle,0,0,\nright,12,0,300\n"
FREE = {"height_m": [2.0, 4.5], "tilt_x_deg": [0.0, 25.0], "installer": False}  # as quick, and as planned


class Nobody:
    """A listener that tells nobody, and may stop the run after some batches."""

    def __init__(self, stop_after: int | None = None) -> None:
        self.left, self.labels = stop_after, []

    def searching(self, search) -> None:
        if search.done:
            self.labels.append(search.label)
        if self.left is not None:
            self.left -= 1
            if self.left < 0:
                raise KeyboardInterrupt

    def mapping(self, points: int) -> None:
        """Nobody is told."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    made = tmp_path_factory.mktemp("layouts")
    write_table(made / "traffic.csv", traffic_rows())
    (made / "poles.csv").write_text(POLES, encoding="utf-8")
    return made


def site_of(folder, *lidars, **changes):
    """The small scene with these LiDARs; `changes` are of its tables."""
    tables = {name: dict(table) for name, table in {**SETTINGS, **REGION}.items() if name != "deployment"}
    tables["search"] = {"particles": 6, "iterations": 10, "seed": 1}
    for name, table in changes.items():
        tables[name] = {**tables.get(name, {}), **table}
    names = ("north", "south", "east")
    tables["lidar"] = [{"name": name, **own} for name, own in zip(names, lidars, strict=False)]
    return prepare(scenario_of(tables, folder=folder))


def on_poles(**more):
    return {"poles": "poles.csv", **FREE, **more}


@pytest.fixture(scope="module")
def finished(folder, tmp_path_factory):
    """The site, folder and result of a run of two LiDARs on three poles, and the labels of its searches."""
    site, run, listener = site_of(folder, on_poles(), on_poles()), tmp_path_factory.mktemp("run") / "run", Nobody()
    run = RunFolder(run)
    with run.begun():
        optimise_site(site, run, listener)
    return site, run, run.result, listener.labels


def test_a_scene_of_several_lidars_is_read_again_as_it_was_written(folder):
    site = site_of(folder, on_poles(), {"x_m": 5.0, "y_m": 0.0, "sensor": "RS-32", **FREE}, sensor={"price": 2.0})
    tables = site.scenario.with_whole_paths()
    again = scenario_of(tomllib.loads(to_toml(tables)))
    assert again.as_tables() == scenario_of(tables).as_tables()
    assert again.lidars == site.scenario.lidars


def test_no_lidar_changes_where_vehicles_count(folder):
    one = site_of(folder, on_poles())
    two = site_of(folder, on_poles(), on_poles(sensor="RS-80"))
    for a, b in zip(one.search, two.search, strict=True):
        np.testing.assert_array_equal(a.vehicle_id[a.counted], b.vehicle_id[b.counted])


def test_the_layout_found_beats_all_pairs_of_a_coarse_grid_but_for_one_percent(finished):
    site, _, result, _ = finished
    grid = list(itertools.product(np.linspace(2.0, 4.5, 4), np.linspace(0.0, 25.0, 6)))
    places = site.scenario.lidars[0].deployment.places
    singles = [(place.pole.name, place.mounting(x)) for place in places for x in grid]
    with site_evaluator(site, site.search) as evaluator:
        base = evaluator.totals([site.scenario.baselines]).objective.sum()
        best = max(
            evaluator.totals([(one, other) for name, other in singles if name > pole]).objective.sum(axis=1).max()
            for pole, one in singles
            if pole != "right"
        )
    assert result["objective"] >= best - 0.01 * (best - base)
    assert len({row["pole"]["name"] for row in result["lidars"]}) == 2


def test_the_steps_of_a_search_add_one_lidar_each_and_never_lose_on_the_searched_frames(finished):
    _site, _, result, labels = finished
    steps = result["layout"]["steps"]
    assert [row["lidars"] for row in steps] == [1, 2]
    assert sorted(name for row in steps for name in row["added"]) == ["north", "south"]
    assert steps[0]["gain"] is None
    assert steps[1]["objective_per_vehicle"] == pytest.approx(result["holdout"]["objective_per_vehicle"])
    assert labels[0].startswith("north, pole")
    assert "all together" in labels


def test_what_each_lidar_adds_is_what_scoring_without_it_says(finished):
    site, _run, result, _ = finished
    layout = tuple(site.scenario.lidars[k].mounting(row["deployment"]) for k, row in enumerate(result["lidars"]))
    judging = Evaluator(site.holdout, site.observation, site.scoring)
    whole, north, south = judging.totals([layout, (layout[0], None), (None, layout[1])]).per_vehicle()
    parts = {row["name"]: row for row in result["layout"]["parts"]}
    assert parts["north"]["alone"]["objective_per_vehicle"] == pytest.approx(north)
    assert parts["north"]["without"]["objective_per_vehicle"] == pytest.approx(south)
    assert parts["south"]["without"]["objective_gain"] == pytest.approx(whole - north)
    covered = [row["share"] for row in result["layout"]["covered_by"]]
    assert covered == sorted(covered, reverse=True)
    alone = [judging.by_vehicle([one]) for one in ((layout[0], None), (None, layout[1]))]
    times = [a.detectable[0].astype(int) + b.detectable[0] for a, b in zip(*alone, strict=True)]
    assert covered[1] == pytest.approx((np.concatenate(times) == 2).mean())
    assert covered[0] <= result["holdout"]["detectable_share"] + 1e-12  # fused shares hold at least what one sees


def test_vehicle_tables_tell_the_points_of_each_lidar(finished):
    _, run, _, _ = finished
    read = RunFolder(run.path).optimised
    np.testing.assert_array_equal(read["points"], read["points_north"] + read["points_south"])
    assert read["points_north"].dtype == np.int64
    assert read["points_north"].any()
    assert read["points_south"].any()


def test_the_history_tells_where_each_lidar_hung(finished):
    _, run, result, _ = finished
    with run.file("history.csv").open(encoding="utf-8") as stream:
        header, *rows = (line.rstrip("\n").split(",") for line in stream)
    wanted = [f"{name}.{key}" for name in ("north", "south") for key in ("x_m", "y_m", "height_m", "tilt_x_deg")]
    assert header == ["evaluation", "iteration", "particle", *wanted, "objective", "best"]
    assert [int(row[0]) for row in rows] == list(range(1, len(rows) + 1))
    assert float(rows[-1][-1]) == pytest.approx(result["objective"])
    assert len(rows) <= result["evaluations"]


def test_each_lidar_has_a_score_map_through_the_layout(finished):
    site, run, result, _ = finished
    for number, row in enumerate(result["lidars"]):
        score_map = run.read_score_map(row["name"])
        assert row["map"]["search_shortfall"] is not None
        assert row["map"]["search_shortfall"] <= 0.01
        height, tilt, value = score_map.best
        layout = [site.scenario.lidars[k].mounting(one["deployment"]) for k, one in enumerate(result["lidars"])]
        place = next(p for p in site.scenario.lidars[0].deployment.places if p.pole.name == row["pole"]["name"])
        layout[number] = place.mounting([height, tilt])
        with site_evaluator(site, site.search) as evaluator:
            assert value == pytest.approx(float(evaluator.totals([tuple(layout)]).per_vehicle()[0]), abs=0.02)


def test_a_run_that_was_stopped_ends_as_one_that_was_not(finished, folder, tmp_path):
    site, _, whole, _ = finished
    run = RunFolder(tmp_path / "run")
    for stop_after in (3, 40, None):
        with run.begun(resume=stop_after != 3):
            try:
                optimise_site(site, run, Nobody(stop_after), resume=stop_after != 3)
            except KeyboardInterrupt:
                continue
    assert without_times(run.result) == without_times(whole)


def test_a_lidar_that_hangs_already_stays_and_is_where_the_steps_begin(folder, tmp_path):
    held = {"x_m": -12.0, "y_m": 0.0, "height_m": 3.0, "tilt_x_deg": 10.0}
    site, run = site_of(folder, held, on_poles()), RunFolder(tmp_path / "run")
    with run.begun():
        result = optimise_site(site, run, Nobody())
    assert result["lidars"][0]["deployment"]["height_m"] == 3.0
    assert result["lidars"][0]["bounds"] is None
    assert result["lidars"][1]["pole"]["name"] != "left"  # where the other hangs
    assert [row["added"] for row in result["layout"]["steps"]] == [["north"], ["south"]]
    assert result["layout"]["over_single"]["lidars"] == 1


def test_a_given_layout_is_judged_beside_the_best_of_its_lidars_alone(folder, tmp_path):
    site, run = site_of(folder, on_poles(), on_poles(), on_poles()), RunFolder(tmp_path / "run")
    layout = tuple(
        replace(place.mounting([3.0, 12.0]), height_m=height)
        for place, height in zip(site.scenario.lidars[0].deployment.places, (2.5, 3.0, 3.5), strict=True)
    )
    with run.begun():
        result = evaluate_site(site, run, layout)
    alone = [row["alone"]["objective_per_vehicle"] for row in result["layout"]["parts"]]
    assert result["layout"]["steps"][0]["objective_per_vehicle"] == pytest.approx(max(alone))
    assert result["search"] is None
    assert [row["lidars"] for row in result["layout"]["steps"]] == [1, 3]
    json.dumps(result)


def test_prices_add_sensors_and_poles_and_are_none_where_one_is_not_known(folder):
    site = site_of(folder, on_poles(pole="right"), on_poles(sensor="RS-32"), sensor={"price": 1000.0})
    layout = site.scenario.baselines
    assert price_of(site, layout) == 1000.0 + 300.0 + 1000.0  # the other is on the middle pole, which has no cost
    assert price_of(site, (layout[0], None)) == 1300.0
    own = {"price": None, "RS-16": {"price": 5.0}}
    assert price_of(site_of(folder, on_poles(), on_poles(sensor="RS-32"), sensor=own), layout) is None


def test_the_errors_of_each_lidar_are_drawn_by_itself_and_their_mean_is_that_of_all_errors(folder):
    shaken = {"y_m": 0.0, **FREE, "installer": {"tilt_deg": 3.0, "height_m": 0.1, "yaw_deg": 0.0}}
    site = site_of(folder, {"x_m": -9.0, **shaken}, {"x_m": 9.0, **shaken})
    layout = tuple(replace(one, tilt_x=0.2, height_m=3.0) for one in site.scenario.baselines)
    evaluator = Evaluator(site.search, site.observation, site.scoring)
    mean = HungObjective(site, evaluator)([layout])[0]
    rng = np.random.default_rng(1)
    off = [
        tuple(
            replace(
                one,
                height_m=one.height_m + rng.uniform(-0.1, 0.1),
                tilt_x=one.tilt_x + np.radians(rng.uniform(-3.0, 3.0)),
                tilt_y=one.tilt_y + np.radians(rng.uniform(-3.0, 3.0)),
            )
            for one in layout
        )
        for _ in range(600)
    ]
    values = evaluator.totals(off).objective.sum(axis=1)
    assert mean == pytest.approx(values.mean(), abs=4.0 * values.std() / np.sqrt(8 * len(site.search)))


def test_errors_are_searched_over_all_lidars_together(folder, tmp_path):
    free = {"y_m": 0.0, "height_m": [2.0, 4.5], "tilt_x_deg": 15.0, "installer": {"tilt_deg": 2.0}}
    few = {"search": {"particles": 5, "iterations": 6}, "traffic": {"frames": 3}}
    site = site_of(folder, {"x_m": -9.0, **free}, {"x_m": 9.0, **free}, **few)
    run, listener = RunFolder(tmp_path / "run"), Nobody()
    with run.begun():
        result = optimise_site(site, run, listener)
    assert listener.labels[-1] == "under more installation errors"
    columns = run.read_columns()
    assert len(columns) == 3 + 2 + 2
    assert columns["best"][-1] == pytest.approx(result["objective_as_hung"])
    assert run.file("history_candidates.csv").exists()


def test_lidars_alike_are_searched_once_and_coordinates_are_read_back(folder, tmp_path):
    site, listener = site_of(folder, on_poles(), on_poles(), on_poles()), Nobody()
    with site_evaluator(site, site.search) as evaluator:
        search = layout_search(
            site, LayoutObjective(site, evaluator), Replay(RunFolder(tmp_path), {}, resume=False), listener
        )
        search.run()
    assert sum(label.startswith("north, pole") for label in listener.labels[:3]) == 3  # not of south and east too
    assert len(search.steps) == 3
    assert None not in search.steps[-1]
    assert len({one.xy for one in search.layout}) == 3
    space = search.space(0, 1, 2)
    (x,) = coordinates_of(space, [tuple(search.layout)])
    again = space.layout(x)
    for one, other in zip(again, search.layout, strict=True):
        assert one.height_m == pytest.approx(other.height_m)
        assert one.tilt_x == pytest.approx(other.tilt_x)
    np.testing.assert_allclose(x, search.point(0, 1, 2))


def test_two_lidars_judged_are_worth_at_least_each_of_them_in_detectable_vehicles(folder):
    site = site_of(folder, on_poles(), on_poles())
    layout = tuple(place.mounting([3.5, 15.0]) for place in site.scenario.lidars[0].deployment.places[:2])
    with site_evaluator(site, site.search, site.holdout) as evaluator:
        found = judge_layout(site, evaluator, layout, [], searched=False)
    for row in found["parts"]:
        assert row["alone"]["share_gain"] >= 0.0  # a union of cells holds each
    assert found["over_single"]["share_gain"] == min(row["alone"]["share_gain"] for row in found["parts"])


# --- Poles, baselines and tables that LiDARs share ------------------------------------------------------------------


def test_a_lidar_with_few_poles_to_choose_from_keeps_one_of_them(folder, tmp_path):
    """Greedy choice alone would put the first on a pole that the others need."""
    (folder / "two.csv").write_text(POLES.replace("right,12,0,300\n", ""), encoding="utf-8")
    two, few = on_poles(poles="two.csv", tilt_x_deg=15.0), {"particles": 5, "iterations": 6}
    site, run = site_of(folder, on_poles(tilt_x_deg=15.0), two, two, search=few), RunFolder(tmp_path)
    with run.begun():
        result = optimise_site(site, run, Nobody())
    assert next(row["pole"]["name"] for row in result["lidars"]) == "right"
    assert len({one.xy for one in site.scenario.baselines}) == 3


def test_a_search_of_poles_alone_tells_of_each_that_was_tried(folder, tmp_path):
    fixed = {"poles": "poles.csv", "height_m": 3.5, "tilt_x_deg": 15.0, "installer": False}
    site, run = site_of(folder, fixed, fixed), RunFolder(tmp_path / "run")
    with run.begun():
        result = optimise_site(site, run, Nobody())
    layouts = [
        (one.mounting([]), other.mounting([]))
        for one, other in itertools.permutations(site.scenario.lidars[0].deployment.places, 2)
    ]
    with site_evaluator(site, site.search) as evaluator:
        best = evaluator.totals(layouts).objective.sum(axis=1).max()
    assert result["objective"] == pytest.approx(best)
    assert result["evaluations"] == len(RunFolder(run.path).read_columns()["best"]) >= 5


def test_a_lidar_that_hangs_already_is_in_the_baseline_as_it_hangs(folder):
    held = {"x_m": -12.0, "y_m": 0.0, "height_m": 3.0, "tilt_x_deg": 10.0}
    one, other = site_of(folder, held, on_poles()).scenario.baselines
    assert (one.height_m, other.height_m) == (3.0, 2.0)
    assert site_of(folder, {**held, "baseline": {"height_m": 2.5}}, on_poles()).scenario.baselines[0].height_m == 2.5
    assert site_of(folder, held, {**held, "x_m": 12.0}).scenario.baselines[0].height_m == 2.0  # nothing is searched


def test_a_baseline_of_its_own_turns_as_it_says_and_not_as_that_of_all(folder):
    lean = {"baseline": {"lean_deg": 12.0}}
    one, other = site_of(folder, on_poles(**lean), on_poles(), baseline={"tilt_x_deg": 5.0}).scenario.baselines
    assert one.as_table()["lean_deg"] == pytest.approx(12.0)
    assert other.as_table()["tilt_x_deg"] == pytest.approx(5.0)


def test_a_model_and_a_file_of_its_name_keep_their_own_settings(folder):
    (folder / "mine.toml").write_text((DATA_FOLDER / "rs_16.toml").read_text(encoding="utf-8"), encoding="utf-8")
    own = {"RS-16": {"range_gate_m": 15.0}, "mine.toml": {"range_gate_m": 18.0}}
    site = site_of(folder, on_poles(), on_poles(sensor="mine.toml"), sensor=own)
    assert [lidar.sensor.range_gate_m for lidar in site.scenario.lidars] == [15.0, 18.0]
    again = scenario_of(tomllib.loads(to_toml(site.scenario.with_whole_paths())))
    assert next(lidar.sensor for lidar in again.lidars) == site.scenario.lidars[0].sensor
    assert again.lidars[1].sensor.range_gate_m == 18.0
