"""More than two coordinates: several seeds, the spread of their answers, intervals of each, a polished grid point."""

from __future__ import annotations

import json

import numpy as np
import pytest

from blender_lidar.run.answer import seeds_text
from blender_lidar.scene.scenario import load_scenario
from blender_lidar.statistics import best_intervals_90, interval_90, resampled_weights
from tests.refusals import refused
from tests.small_scene import MAPPED, REGION, cli, done, without_times, write_scene

pytestmark = pytest.mark.usefixtures("quick")

THREE = {**REGION, "deployment": {"tilt_x_deg": [0.0, 25.0], "x_m": [-4.0, 4.0]}}
BUDGET = {"search": {"particles": 5, "iterations": 8}}
WORDS = ("--workers", 1, "--json")


def optimised(capsys, folder, changes, *words):
    scene = write_scene(folder, changes)
    out, _ = done(capsys, "optimise", scene, "--out", folder / "run", *WORDS, *words)
    return json.loads(out)


def test_several_seeds_are_searched_where_more_than_two_coordinates_are(tmp_path, capsys):
    assert load_scenario(write_scene(tmp_path, MAPPED)).search.seeds == 1
    assert load_scenario(write_scene(tmp_path, THREE)).search.seeds == 3
    assert load_scenario(write_scene(tmp_path, {**THREE, "search": {"fidelity": "auto"}})).search.seeds == 1
    result = optimised(capsys, tmp_path / "three", {**THREE, **BUDGET})
    spread = result["spread"]
    assert [one["seed"] for one in spread["seeds"]] == [1, 2, 3]
    assert spread["searched"] == ["x_m", "height_m", "tilt_x_deg"]
    best = max(one["objective_per_vehicle"] for one in spread["seeds"])
    assert result["objective_per_vehicle"] >= best - 1e-12
    rows = (tmp_path / "three" / "run" / "history.csv").read_text().splitlines()[1:]
    assert len(rows) == result["evaluations"] == spread["mountings"]
    assert 120 <= len(rows) <= 160


def test_each_seed_is_the_search_that_it_would_be_alone(tmp_path, capsys):
    changes = {**THREE, "search": {**BUDGET["search"], "method": "random"}}  # which no grid point is polished for
    spread = optimised(capsys, tmp_path / "all", changes)["spread"]
    alone = [optimised(capsys, tmp_path / str(seed), changes, "--seeds", 1, "--seed", seed) for seed in (1, 3)]
    assert [one["deployment"] for one in spread["seeds"][::2]] == [one["deployment"] for one in alone]


@pytest.mark.parametrize("words", [("--fidelity", "auto"), ("--search", "grid")], ids=lambda words: words[0])
def test_several_seeds_are_refused_where_there_is_one_search_of_its_own_kind(tmp_path, capsys, words):
    scene = write_scene(tmp_path, THREE)
    line = refused(capsys, tmp_path, "optimise", scene, "--seeds", 2, *words, "--out", "run")
    assert "--seeds: is 2; allowed: 1 with fidelity" in line


def test_every_sentence_of_an_optimum_in_more_than_two_coordinates_names_them_all(tmp_path, capsys):
    scene = write_scene(tmp_path, {**THREE, **BUDGET, "traffic": {"block_s": 10.0}})
    code, out, err = cli(capsys, "optimise", scene, "--workers", 1, "--out", tmp_path / "run")
    assert code == 0, err
    text = " ".join(out.split())
    message = text[text.index("Other traffic of this kind may choose otherwise: x along the road ") :].partition(";")[0]
    assert all(f"{name} " in message for name in ("height", "tilt across the road"))
    text = " ".join(done(capsys, "report", tmp_path / "run", "--all")[0].split())
    assert "3 searches with other seeds ended at x along the road" in text
    if "heights and tilts" in text:
        assert "heights and tilts, through the coordinates found," in text


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ((1.5, 1.4), "20.0 % less gain than the best"),
        ((1.1, 0.2), "the worst of them no better than the baseline"),
        ((0.9, 0.2), None),
    ],
)
def test_the_worst_of_several_searches_has_less_gain_or_none(values, said):
    seeds = [{"deployment": {"height_m": 3.0}, "objective_per_vehicle": value} for value in values]
    result = {
        "spread": {"searched": ["height_m"], "seeds": seeds},
        "baseline": {"objective_per_vehicle_as_searched": 1.0},
    }
    text = seeds_text(result)
    assert text.endswith("height 3.00 to 3.00 m" if said is None else said)


def test_a_run_that_was_stopped_and_goes_on_comes_to_the_same_spread(tmp_path, capsys, monkeypatch):
    whole = optimised(capsys, tmp_path / "whole", {**THREE, **BUDGET, "traffic": {"block_s": 10.0}})
    scene, tells = write_scene(tmp_path / "cut", {**THREE, **BUDGET, "traffic": {"block_s": 10.0}}), []
    from blender_lidar.run import replay

    message = replay._tell
    monkeypatch.setattr(replay, "_STORE_EVERY_S", 0.0)

    def interrupted(*given):
        tells.append(1)
        if len(tells) == 12:  # in the second search
            raise KeyboardInterrupt
        message(*given)

    monkeypatch.setattr(replay, "_tell", interrupted)
    folder = tmp_path / "cut" / "run"
    assert cli(capsys, "optimise", scene, "--out", folder, *WORDS)[0] == 1
    monkeypatch.setattr(replay, "_tell", message)
    out, _ = done(capsys, "optimise", scene, "--out", folder, *WORDS, "--resume")
    again = json.loads(out)
    assert again["spread"] == whole["spread"]
    assert again["spread"]["optimum_interval_90"] is not None
    assert without_times(again)["deployment"] == without_times(whole)["deployment"]


def test_intervals_of_the_best_mounting_are_those_of_a_loop_over_resamples():
    rng = np.random.default_rng(5)
    x, objective, weight = rng.random((40, 3)), rng.random((40, 6)), np.array([3.0, 0.0, 2.0, 5.0, 4.0, 6.0])
    objective[:, 1] = 0.0
    x[:, 2] = (x[:, 2] * 360.0 - 180.0).round(6)
    filled = weight > 0
    places = []
    for row in resampled_weights(5, np.random.default_rng(9)):
        values = [
            sum(w * o for w, o in zip(row, one[filled], strict=True)) / (row @ weight[filled]) for one in objective
        ]
        places.append(x[int(np.argmax(values))])
    answer = np.array([0.5, 0.5, 170.0])
    found = best_intervals_90(x, objective, weight, answer, (False, False, True), 9)
    places = np.array(places)
    assert found[:2] == [interval_90(places[:, 0]), interval_90(places[:, 1])]
    around = np.where(places[:, 2] < -10.0, places[:, 2] + 360.0, places[:, 2])
    assert found[2] == pytest.approx(interval_90(around))
    assert best_intervals_90(x, objective[:, :2], weight[:2], answer, (False, False, True), 9) is None


def test_a_grid_point_that_beats_the_hardened_search_is_polished_and_is_the_answer(tmp_path, capsys):
    changes = {**MAPPED, "search": {"particles": 4, "iterations": 1}}
    result = optimised(capsys, tmp_path / "hardened", changes)
    assert result["map"]["polished"] is True
    assert result["objective_per_vehicle"] >= result["map"]["best"]["objective_per_vehicle"]
    assert result["map"]["search_shortfall"] == 0.0
    random = optimised(capsys, tmp_path / "random", {**MAPPED, "search": {**changes["search"], "method": "random"}})
    assert random["map"]["polished"] is False
    assert random["map"]["search_shortfall"] > 0.0
