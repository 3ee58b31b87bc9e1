"""The judgement of the searches: its statistics, counting, problems, stages, and what the verdict rests on."""

from __future__ import annotations

import importlib.util

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

pytest.importorskip("scipy", reason="the judgement needs SciPy, of the extra study")

import tests.research  # noqa: F401
from blender_lidar.errors import InputError
from blender_lidar.studies.driver import StudyFolder
from search_judgement import ESTIMATED, MISSED, RIVALS, SHOWN, judgement, mcnemar, paired_difference, parts_of, wilson
from search_problems import (
    BBOB_FUNCTIONS,
    CASES,
    INSTANCES,
    Problem,
    bbob_problem,
    scene_problem,
)
from search_solvers import OURS, SOLVERS, BudgetSpent, Counted, checkpoints, solve
from search_study import Task, carry_out, judging, main, study_identity, write_results
from tests.small_scene import traffic_rows, write_scene, write_table

# --- statistics -------------------------------------------------------------------------------------------------------


def test_wilson_s_interval_and_mcnemar_s_test_are_those_of_the_books():
    assert wilson(8, 10) == pytest.approx([0.8, 0.4901625, 0.9433178], abs=1e-6)  # (p + z2/2n -+ z s) / (1 + z2/n)
    first, second = np.array([True] * 9 + [False] * 2 + [True] * 5), np.array([False] * 9 + [True] * 2 + [True] * 5)
    assert mcnemar(first, second) == pytest.approx(2 * (1 + 11 + 55) / 2**11)  # 9 and 2 of 11 disagreements
    assert mcnemar(first, first) == 1.0


@pytest.mark.parametrize("shares", [(0.9, 0.05, 0.02), (0.5, 0.2, 0.1), (0.96, 0.01, 0.01)])
def test_the_interval_of_the_paired_difference_covers_the_truth_as_often_as_it_says(shares):
    agree, only_first, only_second = shares
    rng, covered = np.random.default_rng(0), 0
    for _ in range(2000):
        kind = rng.choice(4, size=100, p=[agree, only_first, only_second, 1.0 - sum(shares)])
        first, second = np.isin(kind, [0, 1]), np.isin(kind, [0, 2])
        value, low, high = paired_difference(first, second)
        assert paired_difference(second, first) == pytest.approx([-value, -high, -low])
        covered += low <= only_first - only_second <= high
    assert covered / 2000 >= 0.94


# --- counting ---------------------------------------------------------------------------------------------------------


def problem_of(objective, d=2):
    return Problem("made up", np.zeros(d), np.ones(d), objective, None)


@given(st.lists(st.integers(1, 9), min_size=1, max_size=20), st.integers(1, 60))
def test_nothing_beyond_the_budget_is_evaluated_or_told(batches, budget):
    seen, message = [], []
    rng = np.random.default_rng(len(batches))

    def objective(x):
        seen.extend(x[:, 0].tolist())
        return x[:, 0]

    counted = Counted(problem_of(objective), budget)
    asked = [rng.random((size, 2)) for size in batches]
    asked[0][0, 1] = 1.0  # on a bound
    try:
        for candidates in asked:
            message.extend(counted(candidates).tolist())
    except BudgetSpent:
        assert sum(batches) > budget
    everything = np.concatenate(asked)[:budget, 0]
    assert seen == everything.tolist()
    assert message == everything[: len(message)].tolist()
    record, best, kept = counted.record(), np.maximum.accumulate(everything), checkpoints(budget)
    assert (kept[0], kept[-1]) == (1, budget)
    assert record["best"] == [best[min(count, len(best)) - 1] for count in kept]
    assert record["on_bound"] == pytest.approx(1 / len(everything))


@pytest.mark.parametrize("name", SOLVERS)
def test_every_solver_spends_its_budget_and_no_more_and_its_seed_tells(name):
    pytest.importorskip("cmaes")
    problem = problem_of(lambda x: -100.0 * np.square(x - 0.3).sum(axis=1))
    counts = []

    def run(seed):
        counted = Counted(problem, 300)
        found = solve(SOLVERS[name], counted, seed)
        counts.append(300 - counted.left)
        return found

    first, again, other = run(1), run(1), run(2)
    assert first == again
    assert (first == other) == (name in ("grid", "SciPy DIRECT"))  # they draw nothing
    assert 280 <= min(counts) <= max(counts) <= 300
    assert first["best"][-1] > -(20.0 if name in ("grid", "random") else 1.0)


# --- problems ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("function", [1, 8, 24])
def test_a_bbob_problem_reaches_its_best_at_its_optimum_and_nowhere_else(function):
    ioh = pytest.importorskip("ioh")
    problem = bbob_problem(function, 3, 77)
    found = ioh.get_problem(function, instance=77, dimension=3, problem_class=ioh.ProblemClass.BBOB)
    assert problem.objective(np.array([found.optimum.x]))[0] == pytest.approx(problem.best)
    points = np.random.default_rng(0).uniform(-5.0, 5.0, (50, 3))
    assert (problem.objective(points) < problem.best).all()
    assert problem.objective(points).tolist() == [-found(x.tolist()) for x in points]
    assert sorted(BBOB_FUNCTIONS) == list(range(1, 25))


@pytest.mark.parametrize("case", CASES)
def test_the_scene_s_objective_at_the_baseline_is_the_baseline_s(tmp_path, case):
    with scene_problem(write_scene(tmp_path), case, 3) as (problem, baseline):
        at = dict.fromkeys(CASES[case], 0.0) | {"height_m": 2.0}
        if "y_m" in at:
            at["y_m"] = sum(CASES[case]["y_m"]) / 2.0  # the baseline stands at the nominal place
        assert problem.objective(np.array([list(at.values())]))[0] == pytest.approx(baseline)


def test_each_instance_of_the_scene_has_frames_and_each_recording_vehicles_of_its_own(tmp_path):
    scene, at, rows = write_scene(tmp_path), np.array([[3.0, 10.0], [4.0, 15.0]]), traffic_rows()
    same = write_table(tmp_path / "same.csv", rows)
    fewer = write_table(tmp_path / "fewer.csv", [row for row in rows if row[1] % 3])
    found = []
    for instance, traffic in ((0, None), (INSTANCES, None), (0, same), (1, None), (30, None), (0, fewer)):
        with scene_problem(scene, "scene 2-D", instance, traffic and str(traffic)) as (problem, _):
            found.append(tuple(problem.objective(at).tolist()))
    assert found[0] == found[1] == found[2]
    assert len(set(found)) == 4
    write_table(tmp_path / "short.csv", traffic_rows(frames=12))
    short = scene_problem(scene, "scene 2-D", 0, str(tmp_path / "short.csv"))
    with pytest.raises(InputError, match="12 frames; the study needs 31 or more"), short:
        pass


# --- stages and judgement ---------------------------------------------------------------------------------------------


def small_tasks():
    return [Task(f"bbob_2d_{k}", "bbob", "2", k, 20) for k in range(3)]


def test_a_study_of_two_processes_that_is_stopped_goes_on_in_one_and_comes_to_the_same(tmp_path):
    for library in ("ioh", "cmaes"):
        pytest.importorskip(library)
    whole, stopped = StudyFolder(tmp_path / "whole", {}), StudyFolder(tmp_path / "stopped", {})
    with whole.locked():
        carry_out(whole, small_tasks(), 1, lambda steps: None)

    def interrupted(steps):
        raise KeyboardInterrupt

    with stopped.locked(), pytest.raises(KeyboardInterrupt):
        carry_out(stopped, small_tasks(), 2, interrupted)
    assert sum(stopped.holds(task.name) for task in small_tasks()) == 1
    message = []
    with stopped.locked(resume=True):
        carry_out(stopped, small_tasks(), 1, message.append)
    assert sum(message) == 3
    found = [[folder.stage(task.name, task.run) for task in small_tasks()] for folder in (whole, stopped)]
    assert found[0] == found[1]


def test_recordings_have_instances_seeds_and_names_of_their_own():
    tasks = judging(["bbob", "scene 2-D"], 2, 50, "scene.toml", ["there/a.csv.gz", "b.csv"])
    scene = [task for task in tasks if task.part == "scene 2-D"]
    assert [task.recording for task in scene] == ["shipped", "a.csv.gz", "b.csv"] * 2
    assert [task.traffic for task in scene] == ["", "there/a.csv.gz", "b.csv"] * 2
    assert len({task.instance for task in scene}) == len({task.name for task in scene}) == 6
    assert len([task for task in tasks if task.part == "bbob"]) == 6
    assert scene[0].instance % INSTANCES == scene[1].instance % INSTANCES  # the same places in each
    with pytest.raises(InputError, match=r"recordings a\.csv, a\.csv; allowed: each name once"):
        judging(["scene 2-D"], 2, 50, "scene.toml", ["a.csv", "there/a.csv"])
    every = judging(["bbob", *CASES], 40, 2000, "scene.toml")
    assert [sum(task.part == part for task in every) for part in ("bbob", *CASES)] == [120, INSTANCES, INSTANCES]


def made_up(ours, others):
    """Stored BBOB runs in 2-D whose final regrets are (instances, functions) for us, and for every rival."""
    found = []
    for instance, row in enumerate(ours):
        runs = []
        for place in range(24):
            for name in SOLVERS:
                regret = row[place] if name == OURS else others[instance][place]
                best = [-regret - 1.0] * (len(checkpoints(50)) - 1) + [-regret]
                of = {"solver": name, "problem": f"f{place + 1}", "optimum": 0.0, "best": best, "on_bound": 0.25}
                runs.append(of)
        found.append((Task(f"bbob_2d_{instance}", "bbob", "2", instance, 50), runs))
    return found


def test_the_verdict_follows_from_the_runs():
    rng = np.random.default_rng(0)
    good, bad = 10.0 ** rng.uniform(-6.0, -1.5, (8, 24)), 10.0 ** rng.uniform(-3.0, 1.0, (8, 24))
    (ahead,) = judgement(parts_of(made_up(good, bad)))["verdict"]
    assert (set(ahead["de_pso"].values()), ahead["within_margin"], ahead["worse_groups"]) == ({"better"}, SHOWN, [])
    (behind,) = judgement(parts_of(made_up(bad, good)))["verdict"]
    assert (set(behind["de_pso"].values()), behind["within_margin"]) == ({"worse"}, MISSED)
    assert len(behind["worse_groups"]) == 5 * len(RIVALS)
    (even,) = judgement(parts_of(made_up(good, good)))["verdict"]
    assert (set(even["de_pso"].values()), even["ahead"][0]) == ({"no different"}, 0.0)


@pytest.mark.parametrize(("instances", "within"), [(1, ESTIMATED), (8, SHOWN)])
def test_a_tie_is_shown_to_be_one_only_by_many_runs(instances, within):
    good = np.full((instances, 24), 1e-3)
    (even,) = judgement(parts_of(made_up(good, good)))["verdict"]
    assert even["within_margin"] == within


def test_regret_on_the_scene_is_a_share_of_what_the_best_found_on_the_same_frames():
    tasks = []
    for instance, (baseline, ours, best) in enumerate([(10.0, 20.0, 30.0), (0.0, 99.5, 100.0)]):
        runs = []
        for name in SOLVERS:
            final = {OURS: ours, "random": best}.get(name, baseline)
            found = [baseline] * (len(checkpoints(50)) - 1) + [final]
            runs.append({"solver": name, "best": found, "baseline": baseline, "on_bound": 0.0})
        tasks.append((Task(f"scene_2-D_{instance}", "scene 2-D", "", instance, 50), runs))
    (part,) = parts_of(tasks)
    assert part.regret[OURS][:, -1] == pytest.approx([0.5, 0.005])
    assert part.solved(OURS).tolist() == [False, True]
    assert (part.regret["random"][:, -1].tolist(), part.regret["grid"].min()) == ([0.0, 0.0], 1.0)
    for run in tasks[1][1]:
        run["baseline"] = 100.0
    with pytest.raises(InputError, match="scene_2-D_1: no solver found better than the scene's baseline"):
        parts_of(tasks)


def test_what_is_reported_is_what_the_runs_hold(tmp_path):
    ours = np.full((4, 24), 1e-3)
    ours[:2, :12] = 1.0
    stored = made_up(ours, np.full((4, 24), 5e-2))
    (part,) = parts_of(stored)
    (row,) = judgement([part])["parts"]
    assert row["runs"] == 96
    assert row["solvers"][OURS]["success"][0] == 72 / 96
    assert row["solvers"]["random"]["success"][0] == 0.0
    assert row["solvers"]["random"]["also"] == {"0.1": 1.0, "0.0001": 0.0}
    assert row["solvers"][OURS]["regret"] == pytest.approx([1e-3, 1.0])
    assert row["solvers"][OURS]["on_bound"] == 0.25
    assert (row["by_group"]["weak structure"][OURS], row["by_group"]["separable"][OURS]) == (1.0, 0.5)
    share = np.mean([(ours <= target).mean() for target in part.targets])
    assert part.reached(OURS)[-1] == pytest.approx(share)
    tasks, folder = [task for task, _ in stored], StudyFolder(tmp_path / "study", {})
    with folder.locked():
        for task, runs in stored:
            folder.stage(task.name, lambda runs=runs: runs)
        written = write_results(folder, tasks)
    page = folder.file("search.md").read_text(encoding="utf-8")
    assert "| **hardened** | 75.0 (65.5 to 82.6) |" in page
    drawn = ["search_ecdf_bbob.png"] if importlib.util.find_spec("matplotlib") else []
    assert written == ["search.md", "search.json", *drawn]
    assert {*written} == {path.name for path in folder.path.iterdir() if path.name.startswith("search")}


def test_a_study_with_another_search_cannot_be_resumed_and_a_wrong_recording_is_refused(tmp_path, capsys):
    for library in ("ioh", "cmaes"):
        pytest.importorskip(library)
    identity = study_identity(write_scene(tmp_path), 2, 200)
    assert "optimise/hardened.py" in identity
    with StudyFolder(tmp_path / "study", identity).locked():
        pass
    other = StudyFolder(tmp_path / "study", {**identity, "optimise/hardened.py": "other"})
    with pytest.raises(InputError, match=r"optimise/hardened\.py"):
        other.check(resume=True)
    assert main(["--traffic", "a.csv", "--traffic", "a.csv"]) == 2
    assert capsys.readouterr().err == "search_study: --traffic: recordings a.csv, a.csv; allowed: each name once\n"
