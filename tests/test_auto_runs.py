"""Runs with --fidelity auto: what is reported is scored on everything, and only time depends on how it was run."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest

from blender_lidar.cli import main
from blender_lidar.run import replay
from blender_lidar.run.folder import RunFolder
from blender_lidar.run.optimise import optimise_site
from blender_lidar.scene.scenario import load_scenario
from blender_lidar.scene.site import prepare
from tests.small_scene import MAPPED, cli, done, without_charts, write_scene

pytestmark = pytest.mark.usefixtures("quick")

BUDGET = {"particles": 4, "iterations": 10, "seed": 1}
AUTO = {**MAPPED, "search": {**BUDGET, "fidelity": "auto"}}


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """The scene, and the folder of a run that was never stopped."""
    folder = tmp_path_factory.mktemp("auto")
    scene = write_scene(folder, AUTO)
    with pytest.MonkeyPatch.context() as patch:
        without_charts(patch)
        assert main(["optimise", str(scene), "--out", str(folder / "run")]) == 0
    return scene, folder / "run"


def result_of(folder: Path) -> dict:
    """What may not depend on how a run was made."""
    result = json.loads((folder / "result.json").read_text())
    for rung in result["rungs"] or ():
        del rung["seconds"]
    return {key: value for key, value in result.items() if key not in ("seconds", "versions", "identity")}


def history_of(folder: Path) -> list[dict[str, str]]:
    with (folder / "history.csv").open() as stream:
        return list(csv.DictReader(stream))


def optimised(capsys, scene, out, *words) -> dict:
    done(capsys, "optimise", scene, "--out", out, *words)
    return result_of(out)


def test_the_result_is_what_evaluate_makes_of_the_mounting_to_the_last_digit(tmp_path, finished, capsys):
    scene, folder = finished
    found = result_of(folder)
    mount = found["deployment"]
    words = ("--height", repr(mount["height_m"]), "--tilt-x", repr(mount["tilt_x_deg"]))
    done(capsys, "evaluate", scene, *words, "--out", tmp_path / "evaluated")
    evaluated = result_of(tmp_path / "evaluated")
    for key in ("objective", "objective_per_vehicle", "detectable_share", "holdout", "baseline", "frames", "vehicles"):
        assert found[key] == evaluated[key]


def test_the_history_is_of_what_was_scored_on_everything(finished):
    result, rows = result_of(finished[1]), history_of(finished[1])
    assert len(rows) == result["evaluations"]
    assert float(rows[-1]["best"]) == result["objective"] == max(float(row["objective"]) for row in rows)
    best = next(row for row in rows if float(row["objective"]) == result["objective"])
    assert float(best["height_m"]) == result["deployment"]["height_m"]


def test_the_stages_go_from_cheap_to_everything(finished):
    result = result_of(finished[1])
    rungs = result["rungs"]
    assert result["fidelity"] == "auto"
    assert rungs[0]["candidates"] >= 40
    assert (rungs[-1]["stride"], rungs[-1]["detail"], rungs[-1]["frames"]) == (1, result["detail"], result["frames"])
    assert rungs[-1]["candidates"] == result["evaluations"]
    assert [rung["frames"] for rung in rungs] == sorted(rung["frames"] for rung in rungs)


def test_no_map_is_drawn_and_nothing_is_said_of_one(finished, capsys):
    scene, folder = finished
    out, _ = done(capsys, "optimise", scene, "--out", folder, "--resume")
    assert result_of(folder)["map"] is None
    assert not (folder / "score_map.csv").exists()
    assert "No point of" not in out
    assert "no grid has checked the search" in " ".join(out.split())


def test_two_workers_come_to_the_same_as_one(tmp_path, finished, capsys):
    scene, folder = finished
    assert optimised(capsys, scene, tmp_path / "two", "--workers", 2) == result_of(folder)
    assert history_of(tmp_path / "two") == history_of(folder)


class Stop(Exception):
    """Ends a run after so many batches."""


class Stopping:
    def __init__(self, after: int) -> None:
        self._left = after

    def searching(self, search) -> None:
        self._left -= 1
        if self._left < 0:
            raise Stop

    def mapping(self, points) -> None:
        raise AssertionError("there is no map")


def test_a_run_that_is_stopped_after_any_batch_goes_on_to_the_same(tmp_path, finished, monkeypatch):
    monkeypatch.setattr(replay, "_STORE_EVERY_S", 0.0)
    site = prepare(load_scenario(finished[0]))
    folder, stops = RunFolder(tmp_path / "run"), 0
    with folder.locked():
        while True:
            try:
                result = optimise_site(site, folder, Stopping(after=2), resume=bool(stops))
                break
            except Stop:
                stops += 1
    assert stops >= 6  # in the screening, and in the climb
    assert result_of(folder.path) == result_of(finished[1])
    assert history_of(folder.path) == history_of(finished[1])
    assert len(folder.read_columns()["best"]) == result["evaluations"]


def test_another_fidelity_is_another_run(finished, capsys):
    scene, folder = finished
    code, _, err = cli(capsys, "optimise", scene, "--fidelity", "full", "--out", folder, "--resume")
    assert code == 2
    assert "[search] fidelity = 'auto', not 'full'" in err


@pytest.mark.parametrize(
    "changes",
    [
        {"traffic": {"frames": 1}},
        {"deployment": {"tilt_x_deg": 15.0}},
        {
            "deployment": {
                "tilt_x_deg": None,
                "lean_deg": [0.0, 25.0],
                "lean_direction_deg": [0.0, 360.0],
                "spin_deg": [0.0, 30.0],
            }
        },
        {"search": {"method": "de-pso"}},
    ],
    ids=lambda changes: str(next(iter(changes.items()))),
)
def test_it_serves_any_scene(tmp_path, changes, capsys):
    tables = {name: dict(table) for name, table in AUTO.items()}
    for name, table in changes.items():
        tables.setdefault(name, {}).update(table)
    found = optimised(capsys, write_scene(tmp_path, tables), tmp_path / "run")
    assert found["objective"] == max(float(row["objective"]) for row in history_of(tmp_path / "run"))
    assert np.isfinite(found["objective"])


def test_another_word_is_refused_by_the_option_and_by_the_scene(tmp_path, capsys):
    code, _, err = cli(capsys, "optimise", write_scene(tmp_path, {"search": {"fidelity": "ful"}}))
    assert (code, err.count("\n")) == (2, 1)
    assert "[search] fidelity" in err
    code, _, err = cli(capsys, "optimise", write_scene(tmp_path), "--fidelity", "half")
    assert (code, err.count("\n")) == (2, 1)
    assert "'full', 'auto'" in err
