"""Candidate poles: each is searched, all are judged on the same frames, and intervals hold for all of them together."""

from __future__ import annotations

import csv
import json
import re
from dataclasses import replace
from statistics import NormalDist
from types import SimpleNamespace

import numpy as np
import pytest

from blender_lidar.commands.report import describe_site
from blender_lidar.errors import InputError
from blender_lidar.run.verdict import rank_places
from blender_lidar.scene.deployment import HANGS, Pole, SearchSpace
from blender_lidar.scene.observation import Observation, Scoring
from blender_lidar.scene.poles import read_poles
from blender_lidar.scene.scenario import load_scenario
from blender_lidar.scene.site import prepare
from blender_lidar.scoring.evaluation import Evaluator
from blender_lidar.sensors.beams import beam_lattice
from blender_lidar.sensors.lidar import Lidar
from blender_lidar.sensors.model import load_model
from blender_lidar.statistics import many_to_one_reach_90, resampled_weights, student_t
from blender_lidar.studies.candidates import at_one_place
from blender_lidar.toml_table import read_toml, to_toml
from tests.refusals import refused
from tests.sample_traffic import one_vehicle
from tests.small_scene import REGION, cli, done, mounting, place_of, without_charts, without_times, write_scene

pytestmark = [pytest.mark.usefixtures("quick"), pytest.mark.versions]

HEADER = "name,x_m,y_m,foot_z_m,height_min_m,height_max_m,cost,existing\n"
ROWS = "lamp,0,0,0.5,2,3,,yes\ngantry,-6,-1,,,,1500,no\nfar mast,60,-40,0,2,6,,\n"
CHANGES = {**REGION, "deployment": {"poles": "poles.csv"}, "traffic": {"block_s": 10.0}}
WORDS = ("--workers", 1, "--json")


def scene_with(folder, rows=ROWS, header=HEADER, changes=CHANGES):
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "poles.csv").write_text(header + rows, encoding="utf-8")
    return write_scene(folder, changes)


def test_a_table_of_poles_is_read_with_what_it_leaves_out(tmp_path):
    deployment = load_scenario(scene_with(tmp_path)).lidar.deployment
    assert deployment.poles == (
        Pole("lamp", 0.0, 0.0, 0.5, 2.0, 3.0, None, True),
        Pole("gantry", -6.0, -1.0, 0.0, None, None, 1500.0, False),
        Pole("far mast", 60.0, -40.0, 0.0, 2.0, 6.0),
    )
    on = deployment.places
    assert [one.bounds["height_m"] for one in on] == [
        (2.5, 3.5),
        (2.0, 4.5),
        (2.0, 6.0),
    ]  # above the road, not the foot
    assert [(one.fixed["x_m"], one.fixed["y_m"]) for one in on] == [(0.0, 0.0), (-6.0, -1.0), (60.0, -40.0)]


def test_a_table_as_a_spreadsheet_writes_it_is_the_same(tmp_path):
    plain, sheet = tmp_path / "a.csv", tmp_path / "b.csv"
    plain.write_text(HEADER + ROWS, encoding="utf-8")
    sheet.write_bytes((HEADER + ROWS).replace(",", ";").replace(".", ",").replace("\n", "\r\n").encode("utf-8-sig"))
    assert read_poles(sheet) == read_poles(plain)


@pytest.mark.parametrize(
    ("rows", "fault"),
    [
        ("", "has 0 poles"),
        ("lamp,0,0,,,,,\nlamp,1,0,,,,,\n", "poles.csv:3: name is 'lamp', as in a line before"),
        ("lamp,0,0,,4,3,,\n", "poles.csv:2: height_min_m is 4, height_max_m 3"),
        ("lamp,0,zero,,,,,\n", "poles.csv:2: y_m is 'zero'"),
        (",0,0,,,,,\n", "poles.csv:2: name is nothing"),
        ("lamp,0,0,,,,,maybe\n", "existing is 'maybe'; allowed: yes, no or nothing"),
        ("lamp,0,0,-5,2,4,,\n", "its heights are -3 to -1 m above the road"),
        ("lamp,0,4,,,,,\n", "pole 'lamp': the mount at x 0 m, y 4 m stands on the carriageway"),
    ],
)
def test_a_table_that_cannot_be_used_is_one_line(tmp_path, capsys, rows, fault):
    assert fault in refused(capsys, tmp_path, "optimise", scene_with(tmp_path, rows), "--out", "run")


@pytest.mark.parametrize(
    ("changes", "fault"),
    [
        ({"deployment": {"poles": "poles.csv"}}, "[region] centre_m = [27, -20], radius_m = 20"),
        ({**CHANGES, "deployment": {"poles": "poles.csv", "x_m": 3.0}}, "has poles and x_m"),
        ({**REGION, "deployment": {"x_m": [0.0, 20.0, 40.0]}}, "several places are a table of poles"),
        ({**CHANGES, "deployment": {"poles": "no.csv"}}, "no.csv"),
    ],
)
def test_a_scene_that_cannot_have_poles_is_told_why(tmp_path, capsys, changes, fault):
    scene = scene_with(tmp_path, changes=changes)
    assert fault in refused(capsys, tmp_path, "optimise", scene, "--out", "run")


@pytest.mark.parametrize("verb", ["stability", "chart"])
def test_a_study_is_about_one_place(tmp_path, capsys, verb):
    pytest.importorskip("scipy")
    scene = scene_with(tmp_path, changes={**CHANGES, "deployment": {"poles": "poles.csv", "tilt_x_deg": [0.0, 20.0]}})
    assert "[deployment] poles: are for optimise" in refused(capsys, tmp_path, verb, scene, "--out", "run")
    assert "unknown pole 'lamb'" in refused(capsys, tmp_path, verb, scene, "--pole", "lamb", "--out", "run")
    without = write_scene(tmp_path, REGION)
    assert "has no [deployment] poles" in refused(capsys, tmp_path, verb, without, "--pole", "lamp", "--out", "run")


def test_a_study_on_a_named_pole_searches_what_optimise_searches_there(tmp_path):
    scenario = load_scenario(scene_with(tmp_path))
    for pole, there in zip(scenario.lidar.deployment.poles, scenario.lidar.deployment.spaces, strict=True):
        one = at_one_place(scenario, pole.name).lidar
        (space,) = one.deployment.spaces
        assert (space.variables, space.bounds) == (there.variables, there.bounds)
        middle = [0.5 * sum(ends) for ends in space.bounds]
        assert space.layout(middle) == there.layout(middle)
        assert one.baseline == scenario.lidar.baseline


@pytest.fixture(scope="module")
def ran(tmp_path_factory):
    folder = tmp_path_factory.mktemp("poles")
    with pytest.MonkeyPatch.context() as patched:
        without_charts(patched)
        yield folder, scene_with(folder)


def test_each_pole_is_searched_as_it_would_be_alone_and_judged_on_the_same_frames(ran, capsys):
    folder, scene = ran
    out, _ = done(capsys, "optimise", scene, "--out", folder / "run", *WORDS)
    result = json.loads(out)
    poles = {pole["name"]: pole for pole in result["poles"]}
    assert [pole["rank"] for pole in result["poles"]] == [1, 2, 3]
    assert result["deployment"] == result["poles"][0]["deployment"]
    assert result["objective_per_vehicle"] == result["poles"][0]["objective_per_vehicle"]
    searched = [pole["objective_per_vehicle"] for pole in result["poles"]]
    assert searched == sorted(searched, reverse=True)
    for name, place in {"gantry": {"x_m": -6.0, "y_m": -1.0}, "lamp": {"height_m": [2.5, 3.5]}}.items():
        alone = write_scene(folder / "alone" / name.replace(" ", "_"), {**CHANGES, "deployment": place})
        out, _ = done(capsys, "optimise", alone, "--out", folder / "alone" / f"{name}_run", *WORDS)
        one = json.loads(out)
        assert poles[name]["deployment"] == one["deployment"]
        assert poles[name]["holdout"]["objective_per_vehicle"] == one["holdout"]["objective_per_vehicle"]
        assert one["vehicles"] == result["vehicles"]
    assert poles["lamp"]["height_on_pole_m"] == poles["lamp"]["deployment"]["height_m"] - 0.5
    best = result["poles"][0]["holdout"]
    for pole in result["poles"][1:]:
        held = pole["holdout"]
        assert held["difference_to_best"] == pytest.approx(
            held["objective_per_vehicle"] - best["objective_per_vehicle"]
        )
        low, high = held["interval_90"]
        assert held["differs"] == (low > 0.0 or high < 0.0)
    with (folder / "run" / "ranking.csv").open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert [row["name"] for row in rows] == [pole["name"] for pole in result["poles"]]
    assert load_scenario(folder / "run" / "scene.toml").lidar.deployment == load_scenario(scene).lidar.deployment


def test_the_heights_that_are_said_to_be_searched_are_those_of_the_poles(tmp_path):
    """They were those of [deployment], from which poles of a table with heights of its own differ."""
    rows = "left,0,0,,3,5,,\nright,1,0,,3,8,,\n"
    said = describe_site(prepare(load_scenario(scene_with(tmp_path, rows))))
    assert "2 poles; on each: height 3 to 8 m, as each pole allows" in said


def test_the_answer_names_its_pole_and_those_that_may_be_as_good(tmp_path, capsys):
    rows = "left,0,0,,,,,\nright,0.001,0,,,,,\nfar mast,60,-40,0,2,6,,\n"
    code, out, err = cli(capsys, "optimise", scene_with(tmp_path, rows), "--workers", 1, "--out", tmp_path / "run")
    assert code == 0, err
    text = " ".join(out.split())
    assert re.search("(Hang it|Best found) on pole ", text)
    assert re.search("was best on the searched frames; on held-out traffic (left|right) may be as good", text)
    sheet = (tmp_path / "run" / "installation.txt").read_text()
    assert " m from the foot of pole " in sheet
    assert "Candidate poles, held-out frames" in (tmp_path / "run" / "report.html").read_text()


def test_a_run_over_poles_that_was_stopped_goes_on_to_the_same_ranking(ran, tmp_path, capsys, monkeypatch):
    _, scene = ran
    whole, _ = done(capsys, "optimise", scene, "--out", tmp_path / "whole", *WORDS)
    from blender_lidar.run import replay

    message, tells = replay._tell, []
    monkeypatch.setattr(replay, "_STORE_EVERY_S", 0.0)

    def interrupted(*given):
        tells.append(1)
        if len(tells) == 5:  # on the second pole
            raise KeyboardInterrupt
        message(*given)

    monkeypatch.setattr(replay, "_tell", interrupted)
    assert cli(capsys, "optimise", scene, "--out", tmp_path / "cut", *WORDS)[0] == 1
    monkeypatch.setattr(replay, "_tell", message)
    again, _ = done(capsys, "optimise", scene, "--out", tmp_path / "cut", *WORDS, "--resume")
    assert without_times(json.loads(again)) == without_times(json.loads(whole))


def test_a_mounting_is_put_on_a_pole_by_its_name(ran, tmp_path, capsys):
    _, scene = ran
    out, _ = done(capsys, "evaluate", scene, "--pole", "gantry", "--height", 3, "--out", tmp_path / "run", *WORDS)
    assert [json.loads(out)["deployment"][key] for key in ("x_m", "y_m", "height_m")] == [-6.0, -1.0, 3.0]
    line = refused(capsys, tmp_path, "evaluate", scene, "--pole", "gantri", "--out", "x", begun=True)
    assert "gantry" in line


# --- intervals that hold for all poles together -----------------------------------------------------------------------


def test_simultaneous_intervals_are_those_of_a_loop_over_resamples():
    rng = np.random.default_rng(3)
    objective, weight = rng.normal(2.0, 1.0, (4, 6)) * 5.0, np.array([5.0, 4.0, 0.0, 6.0, 5.0, 7.0])
    objective[:, 2] = 0.0
    filled = weight > 0
    means = objective.sum(axis=1) / weight.sum()
    offs = []
    for counts in resampled_weights(5, np.random.default_rng(8)):
        again = [(counts @ row[filled]) / (counts @ weight[filled]) for row in objective]
        offs.append([(value - again[0]) - (mean - means[0]) for value, mean in zip(again, means, strict=True)])
    errors = np.std(offs, axis=0)
    largest = [max(abs(off[k]) / errors[k] for k in (1, 2, 3)) for off in offs]
    expected = student_t(NormalDist().cdf(np.quantile(largest, 0.9)), 4) * errors
    np.testing.assert_allclose(many_to_one_reach_90(objective, weight, 8), expected, rtol=1e-9, atol=1e-12)
    assert many_to_one_reach_90(objective[:, :2], weight[:2], 8) is None


@pytest.mark.parametrize(("blocks", "mountings"), [(6, 3), (12, 8)])
def test_all_intervals_hold_together_in_nine_cases_of_ten(blocks, mountings):
    rng, held, cases = np.random.default_rng(1), 0, 300
    true = np.linspace(0.0, -0.3, mountings)
    weight = np.full(blocks, 20.0)
    for case in range(cases):
        shared, own = rng.normal(0.0, 0.3, blocks), rng.normal(0.0, 0.1, (mountings, blocks))
        objective = weight * (true[:, None] + shared + own)
        means = objective.sum(axis=1) / weight.sum()
        reach = many_to_one_reach_90(objective, weight, case)
        held += bool((np.abs(means - means[0] - (true - true[0])) <= reach + 1e-12).all())
    assert 0.85 <= held / cases <= 0.99


def ranked(places, x_m, metric="pe-vgop", recording=(0,) * 8):
    """The ranking of poles at some y: 12 frames of a car each, at some x, of which 8 judge, a block each.

    Returns its rows, which pole is best, and the objective of each pole in the held-out frames.
    """
    cars = [replace(one_vehicle("car", (x, 8.0)), frame=number) for number, x in enumerate(x_m)]
    frames = [replace(car, counted=np.ones(1, dtype=bool)) for car in cars]
    seen = Observation((Lidar(beam_lattice(load_model("RS-16"), stride=4), 60.0, 0.4),), "exact", "body", 0.05)
    scoring = Scoring(1e-6, "mean", None, "corrected", metric)
    held = {"holdout": np.arange(4, 12), "holdout_block": np.arange(8), "holdout_recording": np.array(recording)}
    plan = SimpleNamespace(**held)
    scenario = SimpleNamespace(search=SimpleNamespace(seed=1), installers=(HANGS,), aim="mean", is_exact=True)
    site = SimpleNamespace(plan=plan, scoring=scoring, scenario=scenario, search=frames[:4])
    plans = [(mounting({"height_m": 3.0, "tilt_x_deg": 17.0, "y_m": y}),) for y in places]
    spaces = [SearchSpace((place_of({}, {}, pole=Pole(f"{y:g}", 0.0, y)),)) for y in places]
    with Evaluator(frames[:4], seen, scoring, held_out=frames[4:]) as evaluator:
        return *rank_places(site, evaluator, spaces, plans), evaluator.held_out.totals(plans).objective


def test_what_only_breaks_ties_tells_no_poles_apart():
    """Every frame has one car, detectable from both places, and with more bits from the nearer one each time."""
    rows, best, bits = ranked((0.0, -20.0), 0.5 * np.arange(12), "detectable")
    assert (np.diff(bits, axis=0) < 0.0).all()
    held = rows[1]["holdout"]
    assert (best, held["detectable_share"]) == (0, 1.0)
    assert held["detectable_share_interval_90"] is None  # one vehicle in all frames
    assert held["interval_90"][1] < 0.0  # of bits alone
    assert held["differs"] is False


def test_the_intervals_of_poles_do_not_depend_on_the_order_of_their_table():
    found = []
    for places in ((-20.0, 0.0, -8.0), (0.0, -8.0, -20.0)):
        rows, *_ = ranked(places, 3.0 * np.arange(12) - 15.0)
        found.append({row["name"]: (row["rank"], row["holdout"]["interval_90"]) for row in rows})
    one, other = found
    assert [one[name][0] for name in one] == [1, 2, 3]
    for name in one:
        assert one[name][0] == other[name][0]
        if one[name][0] > 1:
            np.testing.assert_allclose(one[name][1], other[name][1], rtol=1e-9)


def test_the_intervals_of_poles_resample_the_blocks_of_each_recording_alone():
    recording = np.repeat((0, 1), 4)
    x_m = np.concatenate([np.arange(4.0), np.arange(4.0), 20.0 + np.arange(4.0)])  # near in the one, far in the other
    rows, _, bits = ranked((0.0, -8.0), x_m, recording=recording)
    low, high = rows[1]["holdout"]["interval_90"]
    reach, as_of_one = (many_to_one_reach_90(bits, np.ones(8), 1, strata)[1] for strata in (recording, None))
    assert 0.5 * (high - low) == pytest.approx(reach)
    assert reach < 0.8 * as_of_one


def test_poles_without_a_name_are_not_asked_for(tmp_path, capsys):
    line = refused(capsys, tmp_path, "evaluate", write_scene(tmp_path), "--pole", "lamp", "--out", "run")
    assert "--pole: is 'lamp', but the scene has no [deployment] poles" in line


def test_a_table_without_its_columns_names_them(tmp_path):
    (tmp_path / "poles.csv").write_text("pole,x,y\nlamp,0,0\n")
    with pytest.raises(InputError, match="no column name"):
        read_poles(tmp_path / "poles.csv")


def test_a_pole_with_one_bracket_fixes_its_height_and_others_are_searched(tmp_path, capsys):
    rows = "bracket,0,0,0.5,4,4,,\nmast,-6,-1,,2,4,,\n"
    changes = {**CHANGES, "deployment": {"poles": "poles.csv", "height_m": 3.0, "tilt_x_deg": [0.0, 20.0]}}
    scene = scene_with(tmp_path, rows, changes=changes)
    bracket, mast = load_scenario(scene).lidar.deployment.places
    assert (bracket.fixed["height_m"], "height_m" in bracket.bounds) == (4.5, False)
    assert mast.bounds["height_m"] == (2.0, 4.0)
    code, out, err = cli(capsys, "optimise", scene, "--out", tmp_path / "run", *WORDS)
    assert code == 0, err
    heights = {pole["name"]: pole["deployment"]["height_m"] for pole in json.loads(out)["poles"]}
    assert heights["bracket"] == 4.5
    fixed = {**CHANGES, "deployment": {"poles": "poles.csv", "height_m": 3.0, "tilt_x_deg": 5.0}}
    line = refused(
        capsys, tmp_path, "optimise", scene_with(tmp_path / "fixed", rows, changes=fixed), "--out", "none", begun=True
    )
    assert "fixes every coordinate" in line
    half = scene_with(tmp_path / "half", "mast,0,0,,,4,,\n", changes=fixed)
    assert "has one end of its heights" in refused(capsys, tmp_path, "optimise", half, "--out", "none", begun=True)


def test_a_mounting_beyond_its_pole_is_refused_and_the_sheet_knows_the_foot(ran, tmp_path, capsys):
    _, scene = ran
    for words, fault in {
        ("lamp", "--height", "9"): "--height: is 9; allowed on pole lamp: 2.5 to 3.5 m",
        ("lamp", "--x", "3"): "--x: is given beside --pole",
    }.items():
        assert fault in refused(capsys, tmp_path, "evaluate", scene, "--pole", *words, "--out", "no", begun=True)
    bracket = scene_with(tmp_path / "bracket", "wall,0,0,1.5,2,,,\nrock,4,0,1.5,,,,\n")
    for pole, fault in {"wall": "3.5 m above the road or more", "rock": "1.5 m above the road or more"}.items():
        line = refused(capsys, tmp_path, "evaluate", bracket, "--pole", pole, "--height", 1, "--out", "no", begun=True)
        assert f"--height: is 1; allowed on pole {pole}: {fault}" in line
    done(capsys, "evaluate", scene, "--pole", "lamp", "--height", 3, "--out", tmp_path / "run", *WORDS)
    assert "2.50 m from the foot of pole lamp" in (tmp_path / "run" / "installation.txt").read_text()


def test_the_baseline_is_the_same_whatever_the_order_of_the_poles(tmp_path):
    one, other = (
        load_scenario(scene_with(tmp_path / name, "".join(rows))).lidar.baseline
        for name, rows in (("a", ROWS.splitlines(keepends=True)), ("b", ROWS.splitlines(keepends=True)[::-1]))
    )
    assert one == other


def test_a_pole_on_the_far_side_that_faces_the_road_is_searched_and_scored_from_there(tmp_path, capsys):
    """Its table says which way it faces, so that one range of tilts looks down at the road from both sides."""
    rows = "near,0,0,90\nfar,0,11,270\n"
    scene = scene_with(tmp_path, rows, "name,x_m,y_m,facing_deg\n", CHANGES)
    out, _ = done(capsys, "optimise", scene, "--out", tmp_path / "run", *WORDS)
    for pole in json.loads(out)["poles"]:
        mount = pole["deployment"]
        words = [word for key in ("height_m", "tilt_x_deg") for word in (f"--{key.split('_')[0]}", repr(mount[key]))]
        words[2] = "--tilt-x"
        out, _ = done(
            capsys, "evaluate", scene, "--pole", pole["name"], *words, "--out", tmp_path / pole["name"], *WORDS
        )
        again = json.loads(out)
        assert again["deployment"]["facing_deg"] == (90.0 if pole["name"] == "near" else 270.0)
        assert again["objective_per_vehicle"] == pytest.approx(pole["objective_per_vehicle"], rel=1e-9)
        assert again["detectable_share"] > 0.5


@pytest.mark.parametrize("form", ["short", "named"])
def test_a_mounting_that_is_not_given_is_as_its_scene_fixes_it(form, tmp_path):
    hung = {"height_m": 4.1, "tilt_x_deg": 19.0, "installer": False}
    path = write_scene(tmp_path, {"deployment": hung})
    if form == "named":
        tables = read_toml(path)
        tables["lidar"] = [{"name": "only", **tables.pop("deployment")}]
        path.write_text(to_toml(tables), encoding="utf-8")
    scenario = load_scenario(path)
    for given in ({}, {"height_m": 3.0}):
        table = scenario.lidar.mounting(given).as_table()
        assert (table["height_m"], table["tilt_x_deg"]) == (given.get("height_m", 4.1), pytest.approx(19.0))
    assert scenario.lidar.mounting({"lean_deg": 5.0}).as_table()["lean_deg"] == pytest.approx(5.0)


def test_on_a_pole_what_the_scene_fixes_holds(tmp_path, capsys):
    (tmp_path / "poles.csv").write_text("name,x_m,y_m\nnorth,-4,-0.5\nsouth,6,-0.5\n")
    fixed = {"poles": "poles.csv", "y_m": None, "height_m": [3.0, 4.0], "tilt_x_deg": 15.0}
    path = write_scene(tmp_path, {**REGION, "deployment": fixed})
    found = [
        json.loads(done(capsys, "evaluate", path, *words, "--json", "--out", tmp_path / name)[0])["deployment"]
        for name, words in (
            ("a", ("--pole", "north", "--height", 3.5)),
            ("b", ("--x", -4, "--y", -0.5, "--height", 3.5)),
        )
    ]
    assert found[0] == found[1]
    assert (found[0]["x_m"], found[0]["height_m"], found[0]["tilt_x_deg"]) == (-4.0, 3.5, pytest.approx(15.0))
