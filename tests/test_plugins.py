"""Metrics and searches of one's own: by name everywhere, with the digits of ours, one line where broken."""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import blender_lidar as bl
import tests.research  # noqa: F401
from blender_lidar.errors import BlenderLidarError, InputError
from blender_lidar.metrics.catalogue import METRICS
from blender_lidar.optimise import make_search, run
from blender_lidar.optimise.solve import OwnSearch
from blender_lidar.run.folder import RunFolder
from blender_lidar.run.vehicle_table import METRIC_VALUE
from blender_lidar.studies.variations import metric_variations
from rival_metrics import OPTIONS
from tests.small_scene import cli, done, write_scene
from tests.waiting import WAIT_S

pytestmark = [pytest.mark.usefixtures("quick"), pytest.mark.versions]

ROOT = Path(__file__).parents[1]
EXAMPLES = ROOT / "docs" / "examples"
MAPPED = {"deployment": {"height_m": [2.0, 4.5], "tilt_x_deg": [0.0, 25.0]}}
BUDGET = ("--particles", 4, "--iterations", 3)

VIEWS = """
import blender_lidar

@blender_lidar.metric(label="sum", tells="what shares of it the beams hit")
def views(returns):
    return returns.occupancy.sum(axis=1)
"""
DRAWN = """
from numpy.random import PCG64, Generator

class Drawn:
    def __init__(self, lower, upper, *, seed, budget):
        self.rng, self.lower, self.upper = Generator(PCG64(seed)), lower, upper

    def ask(self):
        return self.lower + self.rng.random((5, self.lower.size)) * (self.upper - self.lower)

    def tell(self, values):
        pass
"""


CROWDED = """
import numpy as np
import blender_lidar

@blender_lidar.metric(learns=True, needs=["layouts"], unit="boxes", decimals=1, tells="how many boxes were nearer")
def crowded(frames, observation):
    places = np.concatenate([frame.centre_m[frame.counted, :2] for frame in frames])

    def score(returns):
        origin = np.array([pose.position[:2] for (pose,) in returns.layouts])[:, None]
        here = returns.frame.centre_m[returns.frame.counted, :2]
        own, others = (np.linalg.norm(xy - origin, axis=2) for xy in (here, places))
        return (others[:, None] < own[..., None]).sum(axis=2).ravel()

    return score
"""


@pytest.fixture
def own(tmp_path):
    """Writes a file of one's own; its path."""

    def written(text, name="own.py"):
        path = tmp_path / name
        path.write_text(text)
        return path

    return written


@pytest.mark.parametrize("script", sorted(EXAMPLES.glob("*.py")), ids=lambda path: path.stem)
def test_the_examples_run(script, tmp_path):
    pytest.importorskip("embreex")
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    run = subprocess.run(
        [sys.executable, str(script)],
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        text=True,
        timeout=WAIT_S,
        check=False,
    )
    assert run.returncode == 0, run.stderr
    assert ("Hang it" in run.stdout) == (script.stem == "own_metric")
    assert ("own_search.py:Evolution: " in run.stdout) == (script.stem == "own_search")


def test_a_metric_in_a_file_has_the_digits_of_ours_in_workers_too(tmp_path, own, capsys, monkeypatch):
    scene = write_scene(tmp_path, MAPPED)
    own(VIEWS)
    monkeypatch.chdir(tmp_path)
    words = (*BUDGET, "--frames", 3)
    for name, metric, workers in (
        ("ours", OPTIONS["sum_of_views"], 1),
        ("one", "own.py:views", 1),
        ("two", "own.py:views", 2),
    ):
        done(capsys, "optimise", scene, *words, "--metric", metric, "--workers", workers, "--out", tmp_path / name)
    ours, one, two = (RunFolder(tmp_path / name) for name in ("ours", "one", "two"))
    for other in (one, two):
        assert other.result["deployment"] == ours.result["deployment"]
        assert other.result["objective"] == ours.result["objective"]
        np.testing.assert_array_equal(other.optimised[METRIC_VALUE], ours.optimised[METRIC_VALUE])
    assert one.result["metric"] == f"{(tmp_path / 'own.py').resolve()}:views"
    assert one.result["identity"] == two.result["identity"]
    assert "own.py:views, file with SHA-256" in one.result["identity"]["[objective] metric"]


def test_a_metric_that_learns_does_so_from_the_frames_that_it_scores_searched_or_held_out(tmp_path, own, capsys):
    name = f"{own(CROWDED)}:crowded"
    scene = write_scene(tmp_path, MAPPED)
    words = ("--metric", name, "--frames", 3, "--workers", 1, "--out", tmp_path / "run")
    done(capsys, "optimise", scene, *BUDGET, *words)
    run, site = RunFolder(tmp_path / "run"), bl.load_scene(scene, metric=name, frames=3)
    mount = np.array([site.scenario.lidar.deployment.spaces[0].layout([4.0, 0.0])[0].xy])
    for split, frames in (("search", site.search), ("holdout", site.holdout)):
        places = np.concatenate([frame.centre_m[frame.counted, :2] for frame in frames])
        away = np.linalg.norm(places - mount, axis=1)
        expected = [sum(other < mine for other in away.tolist()) for mine in away.tolist()]
        chosen = run.optimised["split"] == split
        np.testing.assert_array_equal(run.optimised[METRIC_VALUE][chosen], expected)
    assert "boxes" in (tmp_path / "run" / "report.html").read_text(encoding="utf-8")


def test_a_metric_learns_from_the_frames_that_it_scores_and_how_they_are_seen(tmp_path, own):
    saved = "    import pickle\n    pickle.dump((frames, observation), open(__file__ + '.seen', 'wb'))\n"
    saved += "    return lambda returns: None"
    path = own(CROWDED[: CROWDED.index("    places")] + saved)
    site = bl.load_scene(write_scene(tmp_path, MAPPED), metric=f"{path}:crowded", workers=1)
    with pytest.raises(InputError, match="gave object values; allowed: numbers"):
        bl.score_mounting(site, height_m=4.0)
    frames, observation = pickle.loads(Path(f"{path}.seen").read_bytes())
    assert [frame.frame for frame in frames] == [frame.frame for frame in site.search]
    np.testing.assert_array_equal(observation.lattice.directions, site.observation.lattice.directions)
    assert (observation.lidar.min_range_m, observation.lidar.max_range_m) == (0.4, 20.0)


def test_a_cloud_has_no_scene_to_learn_from(tmp_path, own):
    path = own(CROWDED)
    site = bl.load_scene(write_scene(tmp_path), workers=1)
    with pytest.raises(InputError, match=r"learns from a scene's traffic; allowed: in a run of a scene"):
        bl.score_cloud(bl.scan_frame(site, site.search[0].frame), metrics=[f"{path}:crowded"])


def test_a_chart_of_a_metric_that_learns_compares_it_with_those_of_the_catalogue(tmp_path, own):
    pytest.importorskip("scipy")
    path = own(CROWDED)
    site = bl.load_scene(write_scene(tmp_path, MAPPED), metric=f"{path}:crowded", workers=1)
    changed = [one.changed(site) for one in metric_variations(site) if one.what == "other metric"]
    assert [one.scoring.metric for one in changed] == list(METRICS)


def test_a_scene_file_finds_its_plugins_from_its_own_folder_and_so_does_the_scene_of_a_run(tmp_path, own, capsys):
    own(VIEWS)
    own(DRAWN, "drawn.py")
    tables = {"objective": {"metric": "own.py:views"}, "search": {"method": "drawn.py:Drawn"}}
    scene = write_scene(tmp_path, {**MAPPED, **tables})
    done(capsys, "optimise", scene, *BUDGET, "--workers", 1, "--out", tmp_path / "run")
    again = bl.load_scene(tmp_path / "run" / "scene.toml", workers=1)
    assert bl.best_mounting(again).result["objective"] == RunFolder(tmp_path / "run").result["objective"]


def test_metrics_and_searches_are_given_to_python_themselves(tmp_path, own, monkeypatch):
    path = own(VIEWS + DRAWN)
    monkeypatch.syspath_prepend(tmp_path)
    import own as module

    site = bl.load_scene(write_scene(tmp_path, MAPPED), metric=module.views, search=module.Drawn, workers=1)
    assert site.scenario.objective.metric == f"{path.resolve()}:views"
    assert site.scenario.search.method == f"{path.resolve()}:Drawn"
    monkeypatch.delitem(sys.modules, "own")
    scan = bl.scan_frame(site, site.search[0].frame, height_m=4.0)
    table = bl.score_cloud(scan, metrics=[module.views])
    np.testing.assert_allclose(table["views"], table["p_top"] + table["p_side"] + table["p_front"])


def test_what_no_file_defines_is_refused_as_workers_could_not_load_it():
    cell: dict = {}
    exec("def seen(returns):\n    return returns.count\nclass Own: pass", cell)
    for code in (bl.metric(cell["seen"]), cell["Own"], lambda lower, upper, *, seed, budget: None):
        with pytest.raises(InputError, match=r"is defined in no file.*in a notebook: %%writefile own.py"):
            bl.load_scene("i80", search=code)


def test_a_search_of_ones_own_is_asked_and_told_as_ours_are():
    lower, upper = np.array([0.0, -1.0]), np.array([2.0, 1.0])

    class Copy:
        def __init__(self, lower, upper, *, seed, budget):
            self.search = make_search("de-pso", lower, upper, seed=seed, evaluations=budget, particles=5)
            self.ask, self.tell = self.search.ask, self.search.tell

    def objective(x):
        return -((x - 0.3) ** 2).sum(axis=1)

    ours = run(make_search("de-pso", lower, upper, seed=4, evaluations=40, particles=5), objective)
    own = run(OwnSearch("copy", Copy, lower, upper, seed=4, budget=40), objective)
    np.testing.assert_array_equal(own.history, ours.history)


def test_the_last_batch_is_cut_to_the_budget_and_a_run_that_was_stopped_goes_on(tmp_path, own, monkeypatch):
    own(DRAWN)
    monkeypatch.chdir(tmp_path)
    site = bl.load_scene(write_scene(tmp_path, MAPPED), search="own.py:Drawn", particles=4, iterations=3, workers=1)

    def stop(done, total, best):
        if done >= 5:
            raise KeyboardInterrupt

    stopped = bl.best_mounting(site, tmp_path / "run", progress=stop)
    assert not stopped.complete
    again = bl.best_mounting(site, tmp_path / "run", resume=True)
    whole = bl.best_mounting(site)
    assert again.result["evaluations"] == 12
    np.testing.assert_array_equal(again.history["objective"], whole.history["objective"])


def test_a_run_whose_plugin_has_changed_is_not_gone_on_with(tmp_path, own, capsys):
    path = own(DRAWN)
    scene = write_scene(tmp_path, MAPPED)
    words = ("optimise", scene, *BUDGET, "--search", f"{path}:Drawn", "--workers", 1, "--out", tmp_path / "run")
    done(capsys, *words)
    path.write_text(DRAWN.replace("(5,", "(4,"))
    code, _, message = cli(capsys, *words, "--resume")
    assert code == 2
    assert "had [search] method = 'own.py:Drawn, file with SHA-256" in message


METRIC_FAULTS = {
    "import nothing_of_that_name": "line 1: ModuleNotFoundError: No module named 'nothing_of_that_name'",
    "def f(:\n": "own.py, line 1: SyntaxError: invalid syntax",
    "g = 1": "defines no 'f'",
    "def f(returns):\n    return returns.count": "is a function; allowed: a function with @blender_lidar.metric",
    "import blender_lidar as bl\n@bl.metric\ndef f(returns):\n    return 1 / 0": "line 4: ZeroDivisionError",
    "import blender_lidar as bl\n@bl.metric\ndef f(returns):\n    return returns.count[1:]": r"gave shape \(\d+,\)",
    "import blender_lidar as bl\n@bl.metric\ndef f(returns):\n    return returns.count * float('nan')": "is not finite",
}


@pytest.mark.parametrize("text", METRIC_FAULTS)
@pytest.mark.filterwarnings("ignore:invalid value")
def test_a_broken_metric_is_told_in_one_line(tmp_path, own, text):
    path = own(text)
    with pytest.raises(InputError, match=METRIC_FAULTS[text]) as caught:
        bl.score_mounting(bl.load_scene(write_scene(tmp_path), metric=f"{path}:f", workers=1))
    assert "\n" not in str(caught.value)


def test_a_metric_that_breaks_in_a_worker_is_told_in_one_line(tmp_path, own, capsys):
    path = own("import os, blender_lidar as bl\nME = os.getpid()\n@bl.metric\ndef f(returns):\n    return 1 / 0\n")
    words = ("--metric", f"{path}:f", "--workers", 2, "--out", tmp_path / "run")
    code, _, message = cli(capsys, "optimise", write_scene(tmp_path, MAPPED), *BUDGET, *words)
    assert code == 2
    assert message.splitlines()[-1].endswith(f"{path}:f', line 5: ZeroDivisionError: division by zero")
    assert "Traceback" not in message


SEARCH = "class S:\n    def __init__(self, lower, upper, *, seed, budget): self.x = [lower]\n"
SEARCH_FAULTS = {
    "S = 1": "is a int; allowed: a class, or a function that makes one",
    "class S:\n    pass": "own.py:S': TypeError: S() takes no arguments",
    SEARCH: "has no ask(); allowed: an object with ask() and tell(values)",
    SEARCH + "    def ask(self): return self.x": "has no tell()",
    SEARCH
    + "    def ask(self): return self.x[0]\n    def tell(self, v): pass": "ask() gave float64 (2,); allowed: (s, 2)",
    SEARCH
    + "    def ask(self): return [self.x[0] - 1]\n    def tell(self, v): pass": "ask() gave [1.0, -1.0]; allowed",
    SEARCH + "    def ask(self): return self.x\n    def tell(self, v): 1 / 0": "own.py:S', line 4: ZeroDivisionError",
}


@pytest.mark.parametrize("text", SEARCH_FAULTS)
def test_a_broken_search_is_told_in_one_line(tmp_path, own, text):
    path, scene = own(text), write_scene(tmp_path, MAPPED)
    with pytest.raises(InputError) as caught:
        bl.best_mounting(bl.load_scene(scene, search=f"{path}:S", workers=1))
    assert SEARCH_FAULTS[text] in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_plugin_that_is_not_there_is_told_with_what_is(tmp_path, capsys):
    scene = write_scene(tmp_path, MAPPED)
    with pytest.raises(BlenderLidarError, match=r"nowhere.py: there is no such file"):
        bl.load_scene(scene, metric="nowhere.py:f")
    code, _, message = cli(capsys, "optimise", scene, "--search", "hardend")
    assert code == 2
    assert "--search: unknown search 'hardend'; did you mean 'hardened'?" in message
    assert "FILE.py:NAME" in message
    code, _, message = cli(capsys, "optimise", scene, "--reading", "own.py:f")
    assert code == 2
    assert "invalid choice" in message


def test_a_metric_called_as_another_column_is_refused(tmp_path, own):
    path = own("import blender_lidar as bl\n@bl.metric\ndef detectable(returns):\n    return returns.count\n")
    site = bl.load_scene(write_scene(tmp_path), workers=1)
    scan = bl.scan_frame(site, site.search[0].frame)
    with pytest.raises(InputError, match="'detectable' is the name of another column"):
        bl.score_cloud(scan, metrics=[f"{path}:detectable"])
