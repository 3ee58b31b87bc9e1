"""Several LiDARs: studies, the Python interface, and what is refused of scenes and options."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import blender_lidar as bl
from blender_lidar.errors import InputError
from blender_lidar.report.chart import CHART_REPORT
from blender_lidar.report.stability import STABILITY_REPORT
from blender_lidar.scene.scenario import load_scenario
from blender_lidar.scene.site import prepare
from blender_lidar.scoring.evaluation import Evaluator
from blender_lidar.studies import stability as study
from blender_lidar.studies.candidates import FIRST, at_one_place, grid_candidates, joint_space, sobol_candidates
from blender_lidar.studies.chart import ChartEffort, chart_identity, chart_study
from blender_lidar.studies.driver import Job, StudyFolder, landscapes
from blender_lidar.studies.findings import VERDICTS
from blender_lidar.studies.stability import StabilityEffort, study_identity, study_stability
from blender_lidar.studies.variations import sensor_variations, with_only
from blender_lidar.toml_table import to_toml
from tests.refusals import refused
from tests.small_scene import CASTER, REGION, SETTINGS, done, traffic_rows, without_charts, write_table

TINY = StabilityEffort(2, 2, heights=2, tilts=3, fine_tilts=3, seeds=2, budget=0.3, draws=1, quick=True)
SEARCHED = {"height_m": [2.0, 4.5], "tilt_x_deg": [0.0, 25.0]}
TWO = (
    {"name": "left", "x_m": -6.0, **SEARCHED},
    {"name": "right", "x_m": 6.0, "sensor": "RS-32", "height_m": [3.0, 4.5], "tilt_x_deg": 15.0},
)
POLES = "name,x_m,y_m\nA,-8,0\nB,8,0\n"
ON_POLES = tuple({"name": name, "poles": "poles.csv", **SEARCHED} for name in ("left", "right"))


def write_layout(folder, lidars=TWO, changes=None):
    """A scene of several LiDARs, and its traffic."""
    tables = {name: dict(table) for name, table in {**SETTINGS, **REGION}.items() if name != "deployment"}
    tables["search"] |= {"particles": 20, "iterations": 5}
    for name, table in (changes or {}).items():
        tables.setdefault(name, {}).update(table)
    write_table(folder / "traffic.csv", traffic_rows())
    (folder / "poles.csv").write_text(POLES)
    path = folder / "scene.toml"
    path.write_text(to_toml({**tables, "lidar": [dict(one) for one in lidars]}), encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    return prepare(load_scenario(write_layout(tmp_path_factory.mktemp("layout"))))


class Quiet:
    """A counter that shows nothing."""

    def __init__(self, total, what):
        self.done = 0

    def advance(self, steps):
        self.done += steps

    def close(self):
        pass


# --- candidates and changes -------------------------------------------------------------------------------------------


def test_candidates_move_one_lidar_on_its_grid_while_the_others_keep_their_mounting_and_then_all_together(site):
    layout = site.scenario.baselines
    found = grid_candidates(site.scenario, layout, 3, 4)
    assert found.variables == ("left.height_m", "left.tilt_x_deg", "right.height_m", "right.tilt_x_deg")
    assert found.names == ("left", "right")
    left, right, joint = np.split(np.arange(1, len(found.points)), [12, 15])  # the right one's tilt is fixed
    assert all(found.layouts[FIRST + row][1] is layout[1] for row in left)
    assert all(found.layouts[FIRST + row][0] is layout[0] for row in right)
    assert len(joint) == 12
    assert all(found.layouts[FIRST + row][number] != layout[number] for row in joint for number in (0, 1))
    for point, hung in zip(found.points, found.layouts[FIRST:], strict=True):
        tables = [mounting.as_table() for mounting in hung]
        told = [table[key] for table in tables for key in ("height_m", "tilt_x_deg")]
        assert told == pytest.approx(point.tolist())
        assert [table["x_m"] for table in tables] == [-6.0, 6.0]


def test_sobol_points_span_the_coordinates_of_all_lidars_each_between_its_own_bounds(site):
    found = sobol_candidates(site.scenario, 16)
    assert found.variables == ("left.height_m", "left.tilt_x_deg", "right.height_m")
    low, high = found.points.min(axis=0), found.points.max(axis=0)
    assert (low >= [2.0, 0.0, 3.0]).all()
    assert (high <= [4.5, 25.0, 4.5]).all()
    assert (high - low > 0.8 * np.subtract(joint_space(site.scenario).upper, joint_space(site.scenario).lower)).all()


def test_a_lidar_out_of_order_leaves_what_a_layout_without_it_sees(site):
    layouts = sobol_candidates(site.scenario, 4).layouts
    out = [one for one in sensor_variations(site, 1) if one.what == "LiDAR out of order"]
    assert [one.value for one in out] == ["left", "right"]
    found = landscapes(site, [Job(one, layouts) for one in out])
    with Evaluator(site.search, site.observation, site.scoring) as evaluator:
        for number, scored in enumerate(found):
            without = [tuple(None if k == number else one for k, one in enumerate(each)) for each in layouts]
            np.testing.assert_array_equal(scored.objective, evaluator.totals(without).objective)


def test_a_change_of_the_sensor_reaches_every_lidar_and_keeps_their_names_and_gates(site):
    for variation in sensor_variations(site, 1):
        lidars = variation.changed(site).observation.lidars
        assert [one.name for one in lidars] == ["left", "right"]
        if variation.what != "LiDAR out of order":
            pairs = list(zip(lidars, site.observation.lidars, strict=True))
            assert all(one.max_range_m == own.max_range_m for one, own in pairs)
            assert all((one.lattice, one.imperfections) != (own.lattice, own.imperfections) for one, own in pairs)


# --- whole studies ----------------------------------------------------------------------------------------------------


def quick_study(site, folder, monkeypatch, layout=None):
    for name in ("metric_variations", "traffic_variations"):
        every = getattr(study, name)
        monkeypatch.setattr(study, name, lambda *given, every=every: every(*given)[:1])
    sensors = study.sensor_variations
    monkeypatch.setattr(study, "sensor_variations", lambda *given: sensors(*given)[-2:])
    work = StudyFolder(folder, study_identity(site, TINY, layout), Quiet)
    with work.locked():
        result = study_stability(site, TINY, work, layout)
        STABILITY_REPORT.write(work, result)
    return result


def test_a_study_of_a_layout_judges_each_lidar_and_what_is_left_without_it(site, tmp_path, monkeypatch):
    if CASTER == "exact":
        pytest.skip("no fast caster is installed")
    without_charts(monkeypatch)
    result = quick_study(site, tmp_path / "found", monkeypatch)
    named = {(one["what"], one["value"]): one for one in result["findings"]}
    assert {one["verdict"] for one in result["findings"]} <= {*VERDICTS, None}
    assert set(result["mounting"]) == set(result["baseline"]) == {"left", "right"}
    for name in ("left", "right"):
        assert (f"{name} height", "0.05 m less") in named
        assert ("LiDAR out of order", name) in named
    report = (tmp_path / "found" / "report.md").read_text()
    assert "left: " in report
    assert "while the others are held" in report


def test_a_layout_of_ones_own_is_the_one_that_is_judged(site, tmp_path, monkeypatch):
    if CASTER == "exact":
        pytest.skip("no fast caster is installed")
    without_charts(monkeypatch)
    layout = grid_candidates(site.scenario, site.scenario.baselines, 2, 2).layouts[-1]
    result = quick_study(site, tmp_path / "given", monkeypatch, layout)
    assert result["mounting_given"]
    told = {name: table["height_m"] for name, table in result["mounting"].items()}
    assert told == pytest.approx({"left": layout[0].height_m, "right": layout[1].height_m})
    with Evaluator(site.search, site.observation, site.scoring) as evaluator:
        assert result["objective_per_vehicle"] == pytest.approx(evaluator.totals([layout]).per_vehicle()[0])


def test_a_chart_of_a_layout_has_the_row_of_fusing_whose_other_side_is_the_mean_of_each_alone(site, tmp_path):
    if CASTER == "exact":
        pytest.skip("no fast caster is installed")
    effort = ChartEffort(2, 8, 8, draws=1, phases=1, rounds=1, quick=True)
    work = StudyFolder(tmp_path / "chart", chart_identity(site, effort), Quiet)
    with work.locked():
        result = chart_study(site, effort, 0.01, work)
    assert CHART_REPORT.text(result)
    fusion = next(row for row in result["ablations"] if row["what"] == "fusion")
    assert set(fusion["shift"]) == {"left.height_m", "left.tilt_x_deg", "right.height_m"}
    every, few = sobol_candidates(site.scenario, 8).layouts, replace(site, search=site.search[::5])
    scored = [landscape_of(few, every)] + [landscape_of(with_only(few, [name]), every) for name in ("left", "right")]
    fused, *alone = (one[FIRST:].mean() for one in scored)
    assert fused > np.mean(alone)
    assert fusion["bias"] > 0.0


def landscape_of(site, layouts):
    with Evaluator(site.search, site.observation, site.scoring) as evaluator:
        return evaluator.totals(layouts).per_vehicle()


def test_a_study_has_each_lidar_on_the_pole_on_which_its_layout_hangs(tmp_path):
    scenario = load_scenario(write_layout(tmp_path, ON_POLES))
    layout = tuple(
        one.deployment.on_pole(name).mounting([3.0, 10.0]) for one, name in zip(scenario.lidars, "BA", strict=True)
    )
    placed = at_one_place(scenario, layout=layout)
    assert [one.deployment.nominal_xy for one in placed.lidars] == [(8.0, 0.0), (-8.0, 0.0)]
    with pytest.raises(
        InputError, match=r"\[\[lidar\]\] 1 poles: are for optimise; a study is about one place of each"
    ):
        at_one_place(scenario)


# --- Python -----------------------------------------------------------------------------------------------------------


def test_a_layout_is_scored_fused_and_each_alone_and_is_never_worse_than_its_parts(site):
    found = bl.score_layout(site, left={"height_m": 4.0, "tilt_x_deg": 10.0}, right={"height_m": 3.5})
    assert (found.mounting["left"]["height_m"], found.mounting["right"]["height_m"]) == (4.0, 3.5)
    assert found.mounting["right"]["tilt_x_deg"] == pytest.approx(15.0)  # as its table fixes it
    assert list(found.alone) == ["left", "right"]
    points = [np.asarray(one.vehicles["points"]) for one in (*found.alone.values(), found)]
    np.testing.assert_array_equal(points[0] + points[1], points[2])
    assert all(one.detectable_share <= found.detectable_share for one in found.alone.values())
    for name, number in (("left", 0), ("right", 1)):
        one = site.with_lidar(number)
        told = found.mounting[name]
        alone = bl.score_mounting(one, **{key: told[key] for key in ("x_m", "height_m", "tilt_x_deg")})
        assert alone.objective == pytest.approx(found.alone[name].objective)
    held_out = bl.score_layout(site, held_out=True)
    assert held_out.mounting["left"]["tilt_x_deg"] == 0.0  # of its baseline, as its table searches it


def test_a_layout_is_judged_as_evaluate_does(site):
    run = bl.judge_layout(site, left={"height_m": 4.0}, right={"height_m": 3.5})
    assert [row["deployment"]["height_m"] for row in run.result["lidars"]] == [4.0, 3.5]
    assert [part["name"] for part in run.result["layout"]["parts"]] == ["left", "right"]


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (
            lambda site: bl.score_mounting(site, height_m=4.0),
            "mounting: is of one LiDAR, but the scene has left, right",
        ),
        (lambda site: bl.judge_mounting(site), "allowed: score_layout, judge_layout"),
        (lambda site: bl.score_mountings(site, [{}]), "score_mountings: row 1: is of one LiDAR"),
        (lambda site: bl.score_layout(site, lefft={}), "score_layout: unknown LiDAR 'lefft'; did you mean 'left'"),
        (lambda site: bl.score_layout(site, left=4.0), "score_layout: left: is 4.0; allowed: a mapping such as"),
        (
            lambda site: bl.score_layout(site, left={"heigth_m": 4.0}),
            "score_layout left: unknown coordinate",
        ),
        (lambda site: bl.judge_layout(site, left={"height_m": -1.0}), "judge_layout left: height_m: is -1.0; allowed:"),
        (lambda site: bl.score_layout(site, left={"pole": "A"}), "the scene has no [deployment] poles"),
        (
            lambda site: bl.score_layout(site, left={"y_m": 4.0}),
            "mounting of left: the mount at x -6 m, y 4 m",
        ),
    ],
)
def test_python_refuses_in_one_line_what_is_no_layout_of_the_scene(site, call, said):
    with pytest.raises(InputError) as caught:
        call(site)
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)


# --- what is refused of scenes and options: one line, and nothing is written ------------------------------------------


def with_lidars(*changes):
    return [{**one, **change} for one, change in zip(TWO, changes, strict=True)]


@pytest.mark.parametrize(
    ("lidars", "changes", "said"),
    [
        (with_lidars({}, {"name": "left"}), {}, "[[lidar]] 2 name: is 'left', as of another LiDAR"),
        (with_lidars({}, {"x_m": 300.0}), {}, "[[lidar]] 2: LiDAR right at x 300, y 0 m has no box that counts"),
        (
            TWO,
            {"sensor": {"RS-32": {"range_gate_m": 0.6}}},
            "right at x 6, y 0 m has no box that counts",
        ),
        (TWO, {"search": {"particles": 4}}, "particles: 4 x 5 iterations are too few evaluations for each LiDAR of 2"),
        ([{**one, "pole": "A"} for one in ON_POLES], {}, "[[lidar]] 2 pole: is 'A', as of"),
        ([{**ON_POLES[0], "pole": "A"}, {**TWO[1], "x_m": -8.0}], {}, "[[lidar]] 2 x_m, y_m: is [-8.0, 0.0], as of"),
        ([{**TWO[1], "x_m": -8.0}, {**ON_POLES[0], "pole": "A"}], {}, "[[lidar]] 2 pole: is 'A', as of"),
        (
            [*ON_POLES, {**TWO[1], "x_m": -8.0, "name": "third"}],
            {},
            "2 LiDARs cannot each have a pole of their own among",
        ),
        (TWO, {"deployment": {"height_m": 3.0}}, "[deployment]: is given beside [[lidar]]"),
        (TWO, {"region": {"radius_m": None}}, "[region] radius_m: must be given with several LiDARs"),
    ],
)
def test_a_scene_of_lidars_that_cannot_hang_so_is_refused(capsys, tmp_path, lidars, changes, said):
    path = write_layout(tmp_path, lidars, changes)
    assert said in refused(capsys, tmp_path, "optimise", path, "--out", tmp_path / "run")


def test_a_list_without_a_lidar_is_refused(capsys, tmp_path):
    path = write_layout(tmp_path)
    path.write_text("lidar = []\n" + path.read_text().partition("[[lidar]]")[0])
    assert "[lidar]: is a list without one" in refused(capsys, tmp_path, "optimise", path, "--out", tmp_path / "run")


@pytest.mark.parametrize(
    ("lidars", "options", "said"),
    [
        (TWO, ["--lidar", "lefft,height_m=3"], "--lidar: unknown LiDAR 'lefft'; did you mean 'left'?"),
        (TWO, ["--lidar", ""], "--lidar: is ''; allowed: a text"),
        (TWO, ["--lidar", "left,heigt_m=3"], "--lidar left: unknown coordinate 'heigt_m'; did you mean 'height_m'?"),
        (TWO, ["--lidar", "left,height_m=3", "--lidar", "left,height_m=4"], "--lidar: left is given twice"),
        (TWO, ["--lidar", "left,height_m=3,height_m=4"], "'height_m=4' is there twice"),
        (TWO, ["--height", "3"], "--height: is of one LiDAR, but the scene has left, right"),
        (TWO, ["--lidar", "left,height_m=3", "--run", "run"], "--run: is given beside --lidar"),
        (ON_POLES, ["--lidar", "left,pole=A", "--lidar", "right,pole=A"], "right: hangs on pole A, as left does"),
        (ON_POLES, ["--lidar", "left,pole=A,x_m=3"], "--lidar left: x_m: is given beside pole; allowed: one of both"),
        (ON_POLES, ["--lidar", "left,pole=C"], "--lidar left: pole: unknown pole 'C'"),
    ],
)
@pytest.mark.parametrize("verb", ["evaluate", "stability"])
def test_mountings_that_are_none_of_the_scenes_lidars_are_refused(capsys, tmp_path, verb, lidars, options, said):
    path = write_layout(tmp_path, lidars)
    assert said in refused(capsys, tmp_path, verb, path, *options, "--out", tmp_path / "run")


@pytest.mark.parametrize(
    ("lidars", "words", "said"),
    [
        (TWO, ["table", "--setback", "3", "--height", "4"], "[[lidar]]: are 2; a table is of one: [deployment]"),
        (ON_POLES, ["stability"], "[[lidar]] 1 poles: are for optimise; a study is about one place of each LiDAR"),
        (ON_POLES, ["chart"], "[[lidar]] 1 poles: are for optimise; a study is about one place of each LiDAR"),
        (ON_POLES, ["chart", "--pole", "A"], "--pole: is of one LiDAR, but the scene has 2; allowed: --run DIR"),
        (ON_POLES, ["chart", "--run", "nowhere"], "nowhere: is not the folder of a run"),
    ],
)
def test_studies_that_need_one_lidar_or_one_place_of_each_say_so(capsys, tmp_path, lidars, words, said):
    path = write_layout(tmp_path, lidars)
    assert said in refused(capsys, tmp_path, words[0], path, *words[1:], "--out", tmp_path / "run")


@pytest.mark.parametrize("verb", ["optimise", "stability", "chart"])
def test_where_no_lidar_searches_anything_that_is_said(capsys, tmp_path, verb):
    lidars = with_lidars({"height_m": 3.0, "tilt_x_deg": 10.0}, {"height_m": 3.0})
    said = refused(capsys, tmp_path, verb, write_layout(tmp_path, lidars), "--out", tmp_path / "run")
    assert "every [[lidar]] fixes" in said


def test_a_scene_that_init_proposes_takes_lidars_in_place_of_its_deployment(tmp_path, capsys, monkeypatch):
    without_charts(monkeypatch)
    scenes = Path(__file__).parents[1] / "scenes"
    traffic, net = scenes / "crossing_sample.xml.gz", scenes / "crossing.net.xml.gz"
    done(capsys, "init", tmp_path / "init", "--from", "sumo", traffic, "--net", net)
    path = tmp_path / "init" / "scene.toml"
    before, table, rest = path.read_text().partition("[deployment]\n")
    own, _, after = rest.partition("\n# What gains")
    lidars = "".join(f'[[lidar]]\nname = "{name}"\n{own}\n' for name in ("one", "two"))
    path.write_text(f"{before}{lidars}\n# What gains{after}")
    site = bl.load_scene(path, frames=1, detail="box", traffic={"holdout": 0.0})
    assert table
    assert [len(one.deployment.places) for one in site.scenario.lidars] == [8, 8]
    assert len({mounting.xy for mounting in site.scenario.baselines}) == 2
    found = bl.score_layout(site, one={"pole": "corner_south_west"}, two={"pole": "corner_north_east"})
    assert found.detectable_share >= max(one.detectable_share for one in found.alone.values())
    with pytest.raises(InputError, match="two: hangs on pole median_south, as one does; allowed: a pole each"):
        bl.score_layout(site, one={"pole": "median_south"}, two={"pole": "median_south"})
