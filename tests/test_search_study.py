"""The study of the searches: statistics against others' code, counting, stages, and what the verdict rests on."""

from __future__ import annotations

import math
import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from blender_lidar.errors import InputError, MissingExtraError
from blender_lidar.optimise import maximise
from blender_lidar.plots.search_ecdf import Panel, plot_search_ecdf
from blender_lidar.search_study import bbob, development
from blender_lidar.search_study.counted import BudgetSpent, Counted, checkpoints
from blender_lidar.search_study.judgement import ESTIMATED, MISSED, RIVALS, SHOWN, judgement, parts_of
from blender_lidar.search_study.output import study_identity, write_results
from blender_lidar.search_study.problems import Problem
from blender_lidar.search_study.runs import carry_out, stored
from blender_lidar.search_study.scene_problems import CASES, INSTANCES, scene_problem
from blender_lidar.search_study.solvers import OURS, SOLVERS, scipy_de, solve
from blender_lidar.search_study.statistics import mcnemar, paired_difference, wilcoxon, wilson
from blender_lidar.search_study.tasks import Task, judging
from blender_lidar.study.stages import StudyFolder
from tests.small_scene import traffic_rows, write_scene, write_table

# --- statistics -------------------------------------------------------------------------------------------------------


@settings(deadline=None)
@given(st.integers(1, 500), st.data())
def test_wilson_s_interval_is_scipy_s(runs, data):
    stats = pytest.importorskip("scipy.stats")
    successes = data.draw(st.integers(0, runs))
    theirs = stats.binomtest(successes, runs).proportion_ci(0.95, method="wilson")
    assert wilson(successes, runs) == pytest.approx((successes / runs, theirs.low, theirs.high), abs=1e-12)


@settings(deadline=None)
@given(st.lists(st.tuples(st.booleans(), st.booleans()), min_size=1, max_size=200))
def test_mcnemar_s_test_is_the_binomial_test_of_the_disagreements(pairs):
    stats = pytest.importorskip("scipy.stats")
    first, second = zip(*pairs, strict=True)
    only_first = sum(a and not b for a, b in pairs)
    disagree = sum(a != b for a, b in pairs)
    expected = stats.binomtest(only_first, disagree).pvalue if disagree else 1.0
    assert mcnemar(first, second) == pytest.approx(expected, rel=1e-9)


@given(st.lists(st.tuples(st.booleans(), st.booleans()), min_size=1, max_size=50))
def test_the_paired_difference_turns_its_sign_with_the_order(pairs):
    first, second = zip(*pairs, strict=True)
    here, there = paired_difference(first, second), paired_difference(second, first)
    assert (here.value, here.low, here.high) == pytest.approx((-there.value, -there.high, -there.low))
    assert here.low <= here.high


@pytest.mark.parametrize("shares", [(0.9, 0.05, 0.02), (0.5, 0.2, 0.1), (0.96, 0.01, 0.01)])
def test_the_interval_of_the_paired_difference_covers_the_truth_as_often_as_it_says(shares):
    agree, only_first, only_second = shares
    rng, covered = np.random.default_rng(0), 0
    for _ in range(2000):
        kind = rng.choice(4, size=100, p=[agree, only_first, only_second, 1.0 - sum(shares)])
        found = paired_difference(np.isin(kind, [0, 1]), np.isin(kind, [0, 2]))
        covered += found.low <= only_first - only_second <= found.high
    assert covered / 2000 >= 0.94


def test_wilcoxon_s_test_tells_a_shift_from_none():
    pytest.importorskip("scipy")
    rng = np.random.default_rng(1)
    first = rng.normal(size=200)
    assert wilcoxon(first, first + rng.normal(0.3, 1.0, 200)) < 0.01
    assert math.isnan(wilcoxon(first, first))


# --- counting ---------------------------------------------------------------------------------------------------------


def problem_of(objective, d=2):
    return Problem("made up", np.zeros(d), np.ones(d), objective, None)


@given(st.lists(st.integers(1, 9), min_size=1, max_size=20), st.integers(1, 60))
def test_nothing_beyond_the_budget_is_evaluated_or_told(batches, budget):
    seen, told = [], []
    rng = np.random.default_rng(len(batches))

    def objective(x):
        seen.extend(x[:, 0].tolist())
        return x[:, 0]

    counted = Counted(problem_of(objective), budget)
    asked = [rng.random((size, 2)) for size in batches]
    asked[0][0, 1] = 1.0  # on a bound
    try:
        for candidates in asked:
            told.extend(counted(candidates).tolist())
    except BudgetSpent:
        assert sum(batches) > budget
    everything = np.concatenate(asked)[:budget, 0]
    assert seen == everything.tolist()
    assert told == everything[: len(told)].tolist()
    record = counted.record()
    best = np.maximum.accumulate(everything)
    assert record["best"] == [best[min(count, len(best)) - 1] for count in checkpoints(budget)]
    assert record["on_bound"] == pytest.approx(1 / len(everything))


@pytest.mark.parametrize("budget", [1, 2, 37, 2000])
def test_the_best_is_kept_from_the_first_evaluation_to_the_last(budget):
    kept = checkpoints(budget)
    assert (kept[0], kept[-1]) == (1, budget)
    assert kept == sorted(set(kept))


@pytest.mark.parametrize("name", SOLVERS)
def test_every_solver_spends_its_budget_and_no_more_and_its_seed_tells(name):
    pytest.importorskip("scipy")
    pytest.importorskip("cmaes")
    problem = development.development_problem("sphere", 2, 3)
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


def test_scipy_s_converged_population_is_started_anew():
    pytest.importorskip("scipy")
    seen = []

    def objective(x):
        seen.append(x.copy())
        return -np.square(x - 0.3).sum(axis=1)

    solve(scipy_de(5), Counted(problem_of(objective), 2000), 1)
    late = np.concatenate(seen)[-1000:]
    assert sum(map(len, seen)) == 2000
    assert np.ptp(late, axis=0).min() > 0.5


# --- problems ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", development.NAMES)
@pytest.mark.parametrize("dimension", development.DIMENSIONS)
def test_a_development_problem_hides_its_optimum_and_is_zero_there(name, dimension):
    problems = [development.development_problem(name, dimension, instance) for instance in range(4)]
    for problem in problems:
        assert (problem.lower > 0.0).all()  # the origin is outside
        points = problem.lower + 10.0 * np.random.default_rng(0).random((500, dimension))
        assert (problem.objective(points) <= 0.0).all()
    middle = [float(p.objective((p.lower + p.upper)[None] / 2.0)[0]) for p in problems]
    assert max(middle) < -0.02  # and the centre is not it
    assert len({round(value, 9) for value in middle}) >= 3
    again = development.development_problem(name, dimension, 2)
    assert np.array_equal(again.lower, problems[2].lower)


@pytest.mark.parametrize("name", [name for name in development.NAMES if name != "Rastrigin"])
def test_the_optimum_of_a_development_problem_can_be_found(name):
    problem = development.development_problem(name, 2, 0)
    assert maximise(problem.objective, problem.lower, problem.upper, seed=0).value > -1e-2


@pytest.mark.parametrize("function", [1, 8, 24])
def test_a_bbob_problem_reaches_its_best_at_its_optimum_and_nowhere_else(function):
    ioh = pytest.importorskip("ioh")
    problem = bbob.bbob_problem(function, 3, 77)
    found = ioh.get_problem(function, instance=77, dimension=3, problem_class=ioh.ProblemClass.BBOB)
    assert problem.objective(np.array([found.optimum.x]))[0] == pytest.approx(problem.best)
    points = np.random.default_rng(0).uniform(-5.0, 5.0, (50, 3))
    assert (problem.objective(points) < problem.best).all()
    assert problem.objective(points).tolist() == [-found(x.tolist()) for x in points]


def test_every_bbob_function_has_one_group():
    assert sorted(f for functions in bbob.GROUPS.values() for f in functions) == list(bbob.FUNCTIONS)


@pytest.mark.parametrize("case", CASES)
def test_the_scene_s_objective_at_the_baseline_is_the_baseline_s(tmp_path, case):
    with scene_problem(write_scene(tmp_path), case, 3) as (problem, baseline):
        at = dict.fromkeys(CASES[case], 0.0) | {"height_m": 2.0}
        if "y_m" in at:
            at["y_m"] = sum(CASES[case]["y_m"]) / 2.0  # the baseline stands at the nominal place
        assert problem.objective(np.array([list(at.values())]))[0] == pytest.approx(baseline)
        assert len(problem.lower) == len(CASES[case])


def test_each_instance_of_the_scene_has_frames_of_its_own(tmp_path):
    scene, at = write_scene(tmp_path), np.array([[3.0, 10.0], [4.0, 15.0]])
    found = []
    for instance in (0, 1, INSTANCES, 30):
        with scene_problem(scene, "scene 2-D", instance) as (problem, _):
            found.append(problem.objective(at).tolist())
    assert found[0] == found[2]
    assert len({tuple(values) for values in found}) == 3


def test_a_scene_with_too_few_frames_for_the_study_is_refused(tmp_path):
    write_table(tmp_path / "traffic.csv", traffic_rows(frames=12))
    with (
        pytest.raises(InputError, match="12 frames; the study needs 31 or more"),
        scene_problem(write_scene(tmp_path), "scene 2-D", 0),
    ):
        pass


# --- stages and judgement ---------------------------------------------------------------------------------------------


def small_tasks():
    return [Task(f"tuning_{k}", "tuning", "hardened, as frozen", k + 1, 12, "") for k in range(3)]


@pytest.mark.parametrize("workers", [1, 2])
def test_a_stopped_study_goes_on_and_comes_to_the_same(tmp_path, workers):
    whole, stopped = StudyFolder(tmp_path / "whole", {}), StudyFolder(tmp_path / "stopped", {})
    with whole.locked():
        carry_out(whole, small_tasks(), 1, lambda steps: None)

    def interrupted(steps):
        raise KeyboardInterrupt

    with stopped.locked(), pytest.raises(KeyboardInterrupt):
        carry_out(stopped, small_tasks(), workers, interrupted)
    assert sum(stopped.holds(task.name) for task in small_tasks()) == 1
    told = []
    with stopped.locked(resume=True):
        carry_out(stopped, small_tasks(), workers, told.append)
    assert sum(told) == 3
    assert stored(stopped, small_tasks()) == stored(whole, small_tasks())


def test_more_seeds_than_the_scene_has_instances_are_refused():
    assert len(judging(["bbob"], INSTANCES + 1, 50, "scene.toml")) == 3 * (INSTANCES + 1)
    with pytest.raises(InputError, match="32 seeds; a recording has 31 instances"):
        judging(["bbob", "scene 2-D"], INSTANCES + 1, 50, "scene.toml")


def test_recordings_have_instances_seeds_and_names_of_their_own():
    tasks = judging(["bbob", "scene 2-D"], 2, 50, "scene.toml", ["there/a.csv.gz", "b.csv"])
    scene = [task for task in tasks if task.part == "scene 2-D"]
    assert [task.recording for task in scene] == ["shipped", "a.csv.gz", "b.csv"] * 2
    assert [task.traffic for task in scene] == [None, "there/a.csv.gz", "b.csv"] * 2
    assert len({task.instance for task in scene}) == len({task.name for task in scene}) == 6
    assert len([task for task in tasks if task.part == "bbob"]) == 6
    assert scene[0].instance % INSTANCES == scene[1].instance % INSTANCES  # the same places in each
    with pytest.raises(InputError, match=r"recordings a\.csv, a\.csv; allowed: each name once"):
        judging(["scene 2-D"], 2, 50, "scene.toml", ["a.csv", "there/a.csv"])


def test_a_further_recording_takes_the_place_of_the_scene_s(tmp_path):
    scene, at = write_scene(tmp_path), np.array([[3.0, 10.0], [4.0, 15.0]])
    rows = traffic_rows()
    write_table(tmp_path / "same.csv", rows)
    write_table(tmp_path / "fewer.csv", [row for row in rows if row[1] % 3])
    found = {}
    for name in (None, "same.csv", "fewer.csv"):
        traffic = None if name is None else str(tmp_path / name)
        with scene_problem(scene, "scene 2-D", 0, traffic) as (problem, baseline):
            found[name] = [*problem.objective(at).tolist(), baseline]
    assert found[None] == found["same.csv"]
    assert found[None] != found["fewer.csv"]


def test_the_tuning_is_on_seeds_that_nothing_is_judged_on():
    assert max(task.instance for task in judging(["bbob", *CASES], 31, 2000, "scene.toml")) < 1000


def made_up(ours, others):
    """Stored BBOB runs in 2-D whose final regrets are (instances, functions) for us, and for every rival."""
    found = []
    for instance, row in enumerate(ours):
        runs = []
        for place, function in enumerate(bbob.FUNCTIONS):
            for name in SOLVERS:
                regret = row[place] if name == OURS else others[instance][place]
                best = [-regret - 1.0] * (len(checkpoints(50)) - 1) + [-regret]
                runs.append({"solver": name, "problem": f"f{function}", "optimum": 0.0, "best": best, "on_bound": 0.25})
        found.append((Task(f"bbob_2d_{instance}", "bbob", "2", instance, 50, ""), runs))
    return found


def test_the_verdict_follows_from_the_runs():
    pytest.importorskip("scipy")
    rng = np.random.default_rng(0)
    good, bad = 10.0 ** rng.uniform(-6.0, -1.5, (8, 24)), 10.0 ** rng.uniform(-3.0, 1.0, (8, 24))
    (ahead,) = judgement(parts_of(made_up(good, bad)))["verdict"]
    assert set(ahead["de_pso"].values()) == {"better"}
    assert ahead["within_margin"] == SHOWN
    assert ahead["worse_groups"] == []
    (behind,) = judgement(parts_of(made_up(bad, good)))["verdict"]
    assert set(behind["de_pso"].values()) == {"worse"}
    assert behind["within_margin"] == MISSED
    assert len(behind["worse_groups"]) == 5 * len(RIVALS)
    (even,) = judgement(parts_of(made_up(good, good)))["verdict"]
    assert set(even["de_pso"].values()) == {"no different"}
    assert even["ahead"][0] == 0.0


@pytest.mark.parametrize(("instances", "within"), [(1, ESTIMATED), (8, SHOWN)])
def test_a_tie_is_shown_to_be_one_only_by_many_runs(instances, within):
    pytest.importorskip("scipy")
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
        tasks.append((Task(f"scene_2-D_{instance}", "scene 2-D", "", instance, 50, ""), runs))
    (part,) = parts_of(tasks)
    assert part.regret[OURS][:, -1] == pytest.approx([0.5, 0.005])
    assert part.solved(OURS).tolist() == [False, True]
    assert part.regret["random"][:, -1].tolist() == [0.0, 0.0]
    assert part.regret["grid"].min() == 1.0
    for run in tasks[1][1]:
        run["baseline"] = 100.0
    with pytest.raises(InputError, match="scene_2-D_1: no solver found better than the scene's baseline"):
        parts_of(tasks)


def test_what_is_reported_is_what_the_runs_hold():
    pytest.importorskip("scipy")
    ours = np.full((2, 24), 1e-3)
    ours[0, :12] = 1.0
    (part,) = parts_of(made_up(ours, np.full((2, 24), 5e-2)))
    (row,) = judgement([part])["parts"]
    assert row["runs"] == 48
    assert row["solvers"][OURS]["success"][0] == 36 / 48
    assert row["solvers"]["random"]["success"][0] == 0.0
    assert row["solvers"]["random"]["also"] == {"0.1": 1.0, "0.0001": 0.0}
    assert row["solvers"][OURS]["regret"] == pytest.approx([1e-3, 1.0])
    assert row["solvers"][OURS]["on_bound"] == 0.25
    assert row["by_group"]["weak structure"][OURS] == 1.0
    assert row["by_group"]["separable"][OURS] == 0.5
    share = np.mean([(ours <= target).mean() for target in part.targets])
    assert part.reached(OURS)[-1] == pytest.approx(share)


def test_the_results_are_written_from_what_is_stored(tmp_path):
    pytest.importorskip("scipy")
    tasks = [*small_tasks()[:1], *(task for task, _ in made_up(np.ones((2, 24)), np.ones((2, 24))))]
    folder = StudyFolder(tmp_path / "study", {})
    with folder.locked():
        for task, runs in made_up(np.full((2, 24), 1e-3), np.ones((2, 24))):
            folder.stage(task.name, lambda runs=runs: runs)
        carry_out(folder, tasks, 1, lambda steps: None)
        written = write_results(folder, tasks)
    page = folder.file("search.md").read_text(encoding="utf-8")
    assert "| **hardened** | 100.0 (92.6 to 100.0) |" in page
    assert "| hardened, as frozen |" in page
    assert written[:2] == ["search.md", "search.json"]
    assert {*written} == {path.name for path in folder.path.iterdir() if path.name.startswith("search")}


def test_a_study_with_another_search_cannot_be_resumed(tmp_path):
    scene = write_scene(tmp_path)
    identity = study_identity(scene, 2, 200)
    assert "optimise/hardened.py" in identity
    with StudyFolder(tmp_path / "study", identity).locked():
        pass
    other = StudyFolder(tmp_path / "study", {**identity, "optimise/hardened.py": "other"})
    with pytest.raises(InputError, match=r"optimise/hardened\.py"):
        other.check(resume=True)


@pytest.mark.parametrize(
    ("library", "use"),
    [
        ("ioh", lambda: bbob.bbob_problem(1, 2, 1)),
        ("cmaes", lambda: SOLVERS["CMA-ES"](Counted(problem_of(lambda x: x[:, 0]), 9), 1)),
        ("scipy", lambda: SOLVERS["SciPy DE"](Counted(problem_of(lambda x: x[:, 0]), 9), 1)),
        ("scipy", lambda: wilcoxon([1.0], [2.0])),
    ],
)
def test_a_missing_library_is_named_with_the_extra_that_brings_it(monkeypatch, library, use):
    monkeypatch.setitem(sys.modules, library, None)
    with pytest.raises(MissingExtraError, match=r"pip install .blender_lidar\[study\]") as caught:
        use()
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("panels", [0, 2])
def test_panels_with_other_searches_are_refused(tmp_path, panels):
    found = [Panel("a", np.arange(1, 9), {f"search {k}": np.linspace(0, 1, 8)}) for k in range(panels)]
    with pytest.raises(InputError, match="ECDF chart"):
        plot_search_ecdf(tmp_path / "x.png", found, "share")
    assert not (tmp_path / "x.png").exists()
