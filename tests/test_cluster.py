"""Evaluations on a cluster: a real dask scheduler with workers in processes of their own, and what may befall them."""

from __future__ import annotations

import json
import os
import shutil
import signal
import socket
import subprocess
import sys
import textwrap
import threading
import warnings
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from blender_lidar.errors import InputError, WorkerError
from blender_lidar.scenario import load_scenario
from blender_lidar.stability.metric_variations import metric_variations
from blender_lidar.study import cluster as cluster_module
from blender_lidar.study.cluster import ClusterExecutor
from blender_lidar.study.cluster_workers import ClusterWorkers, _held
from blender_lidar.study.evaluation import Evaluator
from blender_lidar.study.landscapes import HELD_OUT, Job, landscapes
from blender_lidar.study.site import prepare
from tests.local_cluster import ROOT, LocalCluster
from tests.small_scene import CASTER, MAPPED, cli, without_charts, without_times, write_scene
from tests.test_evaluation import POSES, SCORING, SEEN, frames_of
from tests.waiting import WAIT_S, wait_for

pytest.importorskip("distributed", reason="dask.distributed, of the extra cluster, is not installed")

FRAMES = frames_of(40)
SEEN_HERE = replace(SEEN, caster=CASTER)
PATIENCE_S = 60.0  # with a scheduler on a machine that is busy with other tests
FILES = ("history.csv", "vehicles.csv", "vehicles_baseline.csv", "score_map.csv", "installation.txt")


@pytest.fixture(autouse=True)
def _patience(monkeypatch):
    monkeypatch.setattr(cluster_module, "_ANSWER_S", PATIENCE_S)


@pytest.fixture(scope="module")
def cluster(tmp_path_factory):
    with LocalCluster(tmp_path_factory.mktemp("cluster")) as started:
        yield started


@pytest.fixture
def own_cluster(tmp_path):
    """Of one worker, for tests that do it harm."""
    with LocalCluster(tmp_path, workers=1) as started:
        yield started


@pytest.fixture(scope="module")
def alone():
    with Evaluator(FRAMES, SEEN_HERE, SCORING) as evaluator:
        return evaluator.totals(POSES)


def check_same(found, expected):
    for mine, theirs in zip(found, expected, strict=True):
        assert mine.dtype == theirs.dtype
        assert mine.tobytes() == theirs.tobytes()


def until_refused(evaluator):
    """That somebody is gone is noticed a moment later."""
    for _ in range(1000):
        evaluator.totals(POSES[:1])


def held_by_workers():
    """How many functions a worker keeps."""
    return len(_held)


def drop_all():
    _held.clear()


def in_all(address):
    """How many functions the workers of a cluster keep together."""
    executor = ClusterExecutor(address)
    try:
        return sum(executor.run(held_by_workers).values())
    finally:
        executor.shutdown()


# --- the same answer --------------------------------------------------------------------------------------------------


def test_a_run_comes_to_the_same_to_the_last_digit_here_with_two_processes_and_on_a_cluster(
    cluster, tmp_path, capsys, monkeypatch
):
    without_charts(monkeypatch)
    scene = write_scene(tmp_path, MAPPED)
    places = {"alone": ("--workers", 1), "pair": ("--workers", 2), "cluster": ("--cluster", cluster.address)}
    results = {}
    for name, words in places.items():
        code, out, err = cli(capsys, "optimise", scene, "--out", tmp_path / name, *words)
        assert code == 0, err
        results[name] = without_times(json.loads((tmp_path / name / "result.json").read_text()))
        assert ("worker" in out) == (name != "cluster")
        for file in FILES:
            assert (tmp_path / name / file).read_bytes() == (tmp_path / "alone" / file).read_bytes()
    assert f"cluster {cluster.address}" in out
    assert results["alone"] == results["pair"] == results["cluster"]


def test_scores_are_the_same_bits_with_trees_new_and_kept(cluster, alone):
    with Evaluator(FRAMES, SEEN_HERE, SCORING, cluster=cluster.address) as evaluator:
        for _ in range(3):
            check_same(evaluator.totals(POSES), alone)
        check_same(evaluator.totals(POSES[:1]), (alone.objective[:1], alone.detectable[:1], alone.vehicles))
    with Evaluator(FRAMES[:1], SEEN_HERE, SCORING, cluster=cluster.address) as evaluator:
        np.testing.assert_array_equal(evaluator.totals(POSES).objective, alone.objective[:, :1])
    with Evaluator([], SEEN_HERE, SCORING, cluster=cluster.address) as evaluator:
        assert evaluator.totals(POSES).objective.shape == (3, 0)


def test_a_study_of_stability_goes_through_the_same_door(cluster, tmp_path):
    site = prepare(load_scenario(write_scene(tmp_path)))
    jobs = [Job(one, tuple(POSES), split) for one in metric_variations(site)[:2] for split in ("searched", HELD_OUT)]
    there = replace(site, scenario=replace(site.scenario, model=replace(site.scenario.model, cluster=cluster.address)))
    counted = []
    for mine, theirs in zip(landscapes(site, jobs), landscapes(there, jobs, counted.append), strict=True):
        assert mine.as_dict() == theirs.as_dict()
    assert sum(counted) == 2 * (len(site.search) + len(site.holdout))


def test_a_run_killed_on_a_cluster_goes_on_here_to_the_same_result_and_leaves_nothing_there(
    cluster, tmp_path, capsys, monkeypatch
):
    without_charts(monkeypatch)
    scene = write_scene(tmp_path)
    assert cli(capsys, "optimise", scene, "--out", tmp_path / "whole")[0] == 0
    program = """
        import os, signal, sys
        from blender_lidar import run
        from blender_lidar.results import RunFolder
        store = RunFolder.write_checkpoint
        def store_and_die(*given):
            store(*given)
            os.kill(os.getpid(), signal.SIGKILL)
        RunFolder.write_checkpoint = store_and_die
        from blender_lidar.cli import main
        main(sys.argv[1:])
        """
    killed = blender_lidar("optimise", scene, "--out", tmp_path / "run", "--cluster", cluster.address, program=program)
    assert killed.wait(WAIT_S) == -signal.SIGKILL
    assert (tmp_path / "run" / "checkpoint.json").exists()
    code, _, err = cli(capsys, "optimise", scene, "--out", tmp_path / "run", "--resume")
    assert code == 0, err
    ours, whole = (json.loads((tmp_path / name / "result.json").read_text()) for name in ("run", "whole"))
    assert without_times(ours) == without_times(whole)
    assert (tmp_path / "run" / "history.csv").read_bytes() == (tmp_path / "whole" / "history.csv").read_bytes()
    wait_for(lambda: in_all(cluster.address) == 0)


# --- who does what ----------------------------------------------------------------------------------------------------


def own_process(_number):
    return os.getpid()


def test_a_frame_goes_to_the_worker_that_has_its_tree(cluster):
    executor = ClusterExecutor(cluster.address)
    try:
        assert list(executor.map(abs, [-3])) == [3]
        first, second = (list(executor.map(own_process, range(2))) for _ in range(2))
    finally:
        executor.shutdown()
    assert first == second
    assert len(set(first)) == 2


class Pickled:
    """Counts how often it is read anew."""

    read = 0

    def __reduce__(self):
        return _read_anew, ()

    def times(self, _task):
        return os.getpid(), Pickled.read


def _read_anew():
    Pickled.read += 1
    return Pickled()


def test_each_worker_is_handed_the_function_once_whatever_the_number_of_tasks(cluster):
    before = ClusterExecutor(cluster.address)
    known = set(before.run(os.getpid).values())
    before.shutdown()
    workers = ClusterWorkers(Pickled().times, cluster.address)
    try:
        told = [answer for _ in range(3) for answer in workers.map(range(20))]
    finally:
        workers.close()
    assert {pid for pid, _ in told} == known
    assert {read for _, read in told} == {1}


def test_nothing_is_kept_on_the_cluster_once_it_is_left(cluster):
    with Evaluator(FRAMES, SEEN_HERE, SCORING, cluster=cluster.address) as evaluator:
        evaluator.totals(POSES[:1])
        assert in_all(cluster.address) == 2
    wait_for(lambda: in_all(cluster.address) == 0)


def test_tasks_are_few_where_there_is_little_to_do_and_enough_to_even_out_much(cluster):
    workers = ClusterWorkers(abs, cluster.address)
    try:
        assert [len(workers.sizes(items, 1)) for items in (0, 1, 2, 30, 64, 10_000)] == [0, 1, 2, 2, 4, 8]
        assert workers.map([-1, 2, -3]) == [1, 2, 3]
        assert workers.map([]) == []
    finally:
        workers.close()


# --- workers that come and go -----------------------------------------------------------------------------------------


def test_a_worker_killed_midway_changes_nothing(own_cluster, alone):
    second = own_cluster.start_worker()
    with Evaluator(FRAMES, SEEN_HERE, SCORING, cluster=own_cluster.address) as evaluator:
        killer = threading.Timer(0.2, second.kill)
        killer.start()
        while killer.is_alive() or second.poll() is None:
            check_same(evaluator.totals(POSES), alone)
        check_same(evaluator.totals(POSES), alone)


def test_a_worker_that_comes_later_is_used(own_cluster, alone):
    with Evaluator(FRAMES, SEEN_HERE, SCORING, cluster=own_cluster.address) as evaluator:
        check_same(evaluator.totals(POSES), alone)
        own_cluster.start_worker()
        check_same(evaluator.totals(POSES), alone)
        assert in_all(own_cluster.address) == 2


def set_status(name):
    """Pause this worker as dask does, or let it go on."""
    from distributed import Worker
    from distributed.core import Status

    (here,) = Worker._instances
    here.status = Status[name]
    return here.address


def test_a_paused_worker_held_up_every_batch_and_is_passed_over_until_it_goes_on(tmp_path, alone):
    free = ("--memory-limit", 0)  # nobody else lets them go on
    with LocalCluster(tmp_path, workers=0) as started:
        started.start_worker("--nthreads", 1, *free)
        with Evaluator(FRAMES, SEEN_HERE, SCORING, cluster=started.address) as evaluator:
            started.start_worker("--nthreads", 1, *free)
            other = ClusterExecutor(started.address)
            paused = other.workers[1]
            other.run(partial(set_status, "paused"), [paused])
            wait_for(lambda: paused not in other.workers)
            check_same(evaluator.totals(POSES), alone)
            assert sum(other.run(held_by_workers).values()) == 1
            other.run(partial(set_status, "running"), [paused])
            wait_for(lambda: paused in other.workers)
            check_same(evaluator.totals(POSES), alone)
            assert sum(other.run(held_by_workers).values()) == 2
        other.shutdown()


def test_when_all_workers_are_paused_that_is_told_and_waited_for(tmp_path, monkeypatch):
    monkeypatch.setattr(cluster_module, "_NOBODY_S", 0.0)
    with LocalCluster(tmp_path, workers=0) as started:
        started.start_worker("--nthreads", 1, "--memory-limit", 0)
        workers, other = ClusterWorkers(abs, started.address), ClusterExecutor(started.address)
        other.run(partial(set_status, "paused"))
        wait_for(lambda: not other.workers)
        later = threading.Timer(0.5, other.run, [partial(set_status, "running")])
        later.start()
        with pytest.warns(UserWarning, match="all workers there are paused, perhaps for want of memory; waiting"):
            assert workers.map([-1, -2]) == [1, 2]
        later.join()
        workers.close()
        other.shutdown()


def test_when_the_only_worker_is_killed_another_one_takes_over(own_cluster, alone):
    with Evaluator(FRAMES, SEEN_HERE, SCORING, cluster=own_cluster.address) as evaluator:
        check_same(evaluator.totals(POSES), alone)
        own_cluster.workers[0].kill()
        later = threading.Timer(1.0, own_cluster.start_worker)
        later.start()
        check_same(evaluator.totals(POSES), alone)
        later.join()


def test_when_all_workers_are_gone_for_good_that_is_one_line(own_cluster, alone, monkeypatch):
    monkeypatch.setattr(cluster_module, "_LOOK_ROUND_S", 0.2)
    monkeypatch.setattr(cluster_module, "_NOBODY_S", 1.0)
    with Evaluator(FRAMES, SEEN_HERE, SCORING, cluster=own_cluster.address) as evaluator:
        check_same(evaluator.totals(POSES), alone)
        own_cluster.workers[0].kill()
        with pytest.raises(WorkerError, match="the dask scheduler there has no workers") as failure:
            until_refused(evaluator)
    assert "\n" not in str(failure.value)


def test_a_worker_that_drops_what_it_holds_is_handed_it_again(own_cluster, alone):
    """As where dask moves it to disk, short of memory."""
    other = ClusterExecutor(own_cluster.address)
    with Evaluator(FRAMES, SEEN_HERE, SCORING, cluster=own_cluster.address) as evaluator:
        check_same(evaluator.totals(POSES), alone)
        other.run(drop_all)
        check_same(evaluator.totals(POSES), alone)
    other.shutdown()


def test_when_the_scheduler_ends_that_is_one_line_at_once(own_cluster, alone):
    with Evaluator(FRAMES, SEEN_HERE, SCORING, cluster=own_cluster.address) as evaluator:
        check_same(evaluator.totals(POSES), alone)
        own_cluster.scheduler.kill()
        with pytest.raises(WorkerError, match="the dask scheduler there has gone") as failure:
            until_refused(evaluator)
    assert "\n" not in str(failure.value)


def blender_lidar(*words, program="from blender_lidar.cli import main\nimport sys\nsys.exit(main())"):
    """The command line as a process of its own, without charts."""
    head = "import sys\nsys.modules['matplotlib'] = None\n"
    head += f"from blender_lidar.study import cluster\ncluster._ANSWER_S = {PATIENCE_S}\n"
    command = [sys.executable, "-c", head + textwrap.dedent(program), *map(str, words)]
    return subprocess.Popen(
        command, cwd=ROOT, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, start_new_session=True
    )


def test_ctrl_c_ends_the_run_and_leaves_the_cluster_alive(cluster, tmp_path, alone):
    out = tmp_path / "run"
    words = ("--out", out, "--cluster", cluster.address, "--iterations", 100_000)
    with blender_lidar("optimise", write_scene(tmp_path), *words) as run:
        try:
            wait_for((out / "checkpoint.json").exists)
            run.send_signal(signal.SIGINT)
            _, err = run.communicate(timeout=WAIT_S)
        finally:
            run.kill()
    assert run.returncode == 1
    assert err.splitlines()[-1] == f"blender-lidar: stopped; go on with: --out {out} --resume"
    assert "Traceback" not in err
    wait_for(lambda: in_all(cluster.address) == 0)
    with Evaluator(FRAMES, SEEN_HERE, SCORING, cluster=cluster.address) as evaluator:
        check_same(evaluator.totals(POSES), alone)


# --- what is refused --------------------------------------------------------------------------------------------------


def refused(capsys, tmp_path, *words):
    out = tmp_path / f"run_{len(list(tmp_path.iterdir()))}"
    code, _, err = cli(capsys, "optimise", write_scene(tmp_path), "--out", out, *words)
    lines = err.splitlines()
    assert "Traceback" not in err
    return code, lines[-1]


def test_an_address_without_a_scheduler_is_one_line(capsys, tmp_path, monkeypatch):
    monkeypatch.setattr(cluster_module, "_ANSWER_S", 1.0)
    before = set(threading.enumerate())
    with socket.create_server(("127.0.0.1", 0)) as silent:  # takes calls, and says nothing
        for port in (1, silent.getsockname()[1]):
            code, line = refused(capsys, tmp_path, "--cluster", f"tcp://127.0.0.1:{port}")
            assert code == 1
            assert line.startswith(f"blender-lidar: tcp://127.0.0.1:{port}: no dask scheduler answers there within 1 s")
            assert set(threading.enumerate()) == before  # nobody goes on trying


def test_the_address_of_a_worker_is_one_line(capsys, tmp_path, cluster):
    executor = ClusterExecutor(cluster.address)
    worker = executor.workers[0]
    executor.shutdown()
    code, line = refused(capsys, tmp_path, "--cluster", worker)
    assert code == 1
    assert line.startswith(f"blender-lidar: {worker}: no dask scheduler answers there")


def test_a_scheduler_without_workers_is_one_line(capsys, tmp_path, monkeypatch):
    monkeypatch.setattr(cluster_module, "_FIRST_WORKER_S", 1.0)
    with LocalCluster(tmp_path, workers=0) as empty:
        code, line = refused(capsys, tmp_path, "--cluster", empty.address)
    assert code == 1
    assert line == (
        f"blender-lidar: {empty.address}: the dask scheduler there has no workers; start some with `dask worker "
        f"{empty.address} --nthreads 1`"
    )


def test_workers_with_another_blender_lidar_or_none_are_refused(tmp_path):
    other, broken = tmp_path / "other", tmp_path / "broken"
    shutil.copytree(ROOT / "blender_lidar", other / "blender_lidar", ignore=shutil.ignore_patterns("__pycache__"))
    with (other / "blender_lidar" / "__init__.py").open("a") as file:
        file.write("# an hour older\n")
    (broken / "blender_lidar").mkdir(parents=True)
    (broken / "blender_lidar" / "__init__.py").write_text("raise ImportError('no such thing here')\n")
    for package, said in (
        (other, "has another blender_lidar, 0.1.0 "),
        (broken, "cannot import blender_lidar: no such"),
    ):
        folder = tmp_path / f"cluster of {package.name}"
        folder.mkdir()
        with LocalCluster(folder, workers=0) as wrong:
            wrong.start_worker(package=package)
            with pytest.raises(WorkerError, match=said) as failure:
                ClusterWorkers(abs, wrong.address)
        assert "\n" not in str(failure.value)


def test_threads_that_would_be_idle_are_told_and_get_in_nobodys_way(tmp_path, alone):
    with LocalCluster(tmp_path, workers=0) as threaded:
        threaded.start_worker("--nthreads", 3)
        with pytest.warns(UserWarning, match="a worker process does one task at a time"):
            evaluator = Evaluator(FRAMES, SEEN_HERE, SCORING, cluster=threaded.address).__enter__()
        with evaluator:
            check_same(evaluator.totals(POSES), alone)


def test_workers_that_are_alike_are_no_reason_for_a_note(cluster):
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        ClusterWorkers(abs, cluster.address).close()
    assert [note.message for note in told if issubclass(note.category, UserWarning)] == []


def fails(how):
    if how == "import":
        import a_library_that_nobody_has  # noqa: F401
    raise InputError("this cannot be")


def test_what_a_task_raises_is_raised_here(cluster):
    workers = ClusterWorkers(fails, cluster.address)
    try:
        with pytest.raises(InputError, match=r"^this cannot be$"):
            workers.map(["input"])
        with pytest.raises(WorkerError, match="a worker cannot do its task: No module named 'a_library_that_nobody"):
            workers.map(["import"])
    finally:
        workers.close()


def test_without_dask_the_extra_is_named(capsys, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    code, line = refused(capsys, tmp_path, "--cluster", "tcp://127.0.0.1:8786")
    assert code == 2
    assert line == 'blender-lidar: --cluster needs dask.distributed: pip install "blender_lidar[cluster]"'
