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
import time
from contextlib import closing, suppress
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from blender_lidar.errors import InputError, WorkerError
from blender_lidar.scene.scenario import load_scenario
from blender_lidar.scene.site import prepare
from blender_lidar.scoring import cluster as cluster_module
from blender_lidar.scoring.cluster import ClusterWorkers
from blender_lidar.scoring.evaluation import Evaluator, Workplace
from blender_lidar.studies.driver import HELD_OUT, Job, landscapes
from blender_lidar.studies.variations import metric_variations
from tests.local_cluster import ROOT, LocalCluster
from tests.sample_traffic import counted_frames
from tests.small_scene import CASTER, MAPPED, cli, done, without_charts, without_times, write_scene
from tests.test_evaluation import LAYOUTS, SCORING, SEEN
from tests.waiting import WAIT_S, wait_for

distributed = pytest.importorskip("distributed", reason="dask.distributed, of the extra cluster, is not installed")

FRAMES = counted_frames(40)
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
    """Of one worker that nobody pauses but the test, for tests that do it harm."""
    with LocalCluster(tmp_path, workers=0) as started:
        started.workers = [started.start_worker("--nthreads", 1, "--memory-limit", 0)]
        yield started


def on_each_worker(started, function, workers=None):
    with connected(started.address) as client:
        return client.run(function, workers=workers)


def connected(address):
    """A client; dask refuses a greeting that comes together with news of a worker."""
    for _ in range(5):
        with suppress(AssertionError):
            return distributed.Client(address, set_as_default=False)
    return pytest.fail("no client can be made")


def test_a_greeting_that_dask_refuses_is_asked_for_again(cluster, monkeypatch):
    client, refused = distributed.Client, [AssertionError(), AssertionError()]

    def sometimes(*given, **named):
        if refused:
            raise refused.pop()
        return client(*given, **named)

    monkeypatch.setattr(distributed, "Client", sometimes)
    with closing(ClusterWorkers(square, cluster.address)) as workers:
        assert squares(workers) == SQUARES
    assert not refused


def kept(started):
    """The kinds of what workers keep, by dask's names."""
    keys = on_each_worker(started, lambda dask_worker: list(dask_worker.data)).values()
    return sorted(key.split("-")[0] for worker in keys for key in worker)


def blender_lidar(*words, program=""):
    """The command line as a process of its own, without charts, after a program."""
    head = "import sys\nsys.modules['matplotlib'] = None\n"
    tail = "\nfrom blender_lidar.cli import main\nsys.exit(main())"
    command = [sys.executable, "-c", head + textwrap.dedent(program) + tail, *map(str, words)]
    return subprocess.Popen(
        command, cwd=ROOT, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, start_new_session=True
    )


# --- the same answer --------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A scene, and the folder of a run of it in one process."""
    folder = tmp_path_factory.mktemp("whole")
    scene = write_scene(folder, MAPPED)
    run = blender_lidar("optimise", scene, "--out", folder / "run", "--workers", 1)
    assert run.wait(WAIT_S) == 0
    return scene, folder / "run"


def check_same_run(mine, whole):
    results = [json.loads((folder / "result.json").read_text()) for folder in (mine, whole)]
    assert without_times(results[0]) == without_times(results[1])
    for file in FILES:
        assert (mine / file).read_bytes() == (whole / file).read_bytes()


def test_a_run_comes_to_the_same_to_the_last_digit_here_and_on_a_cluster(cluster, whole, tmp_path, capsys, monkeypatch):
    without_charts(monkeypatch)
    out, _ = done(capsys, "optimise", whole[0], "--out", tmp_path / "run", "--cluster", cluster.address)
    assert f"cluster {cluster.address}" in out
    check_same_run(tmp_path / "run", whole[1])


def test_scores_are_the_same_bits_with_trees_new_and_kept_and_nothing_is_left_behind(cluster):
    with Evaluator(FRAMES, SEEN_HERE, SCORING) as here:
        alone = here.totals(LAYOUTS)
    with Evaluator(FRAMES, SEEN_HERE, SCORING, Workplace(cluster=cluster.address)) as evaluator:
        for _ in range(3):
            for mine, theirs in zip(evaluator.totals(LAYOUTS), alone, strict=True):
                assert mine.dtype == theirs.dtype
                assert mine.tobytes() == theirs.tobytes()
        np.testing.assert_array_equal(evaluator.totals(LAYOUTS[:1]).objective, alone.objective[:1])
        wait_for(lambda: kept(cluster).count("loads") == 2)
    wait_for(lambda: not kept(cluster))
    with Evaluator([], SEEN_HERE, SCORING, Workplace(cluster=cluster.address)) as evaluator:
        assert evaluator.totals(LAYOUTS).objective.shape == (3, 0)


def test_a_study_of_stability_goes_through_the_same_door(cluster, tmp_path):
    site = prepare(load_scenario(write_scene(tmp_path)))
    jobs = [Job(one, tuple(LAYOUTS), split) for one in metric_variations(site)[:2] for split in ("searched", HELD_OUT)]
    there = replace(site, scenario=replace(site.scenario, model=replace(site.scenario.model, cluster=cluster.address)))
    counted = []
    for mine, theirs in zip(landscapes(site, jobs), landscapes(there, jobs, counted.append), strict=True):
        np.testing.assert_array_equal(mine.objective, theirs.objective)
        np.testing.assert_array_equal(mine.vehicles, theirs.vehicles)
    assert sum(counted) == 2 * (len(site.search) + len(site.holdout))


@pytest.mark.parametrize("stop", ["SIGKILL", "SIGINT"])
def test_a_run_stopped_on_a_cluster_leaves_nothing_there_and_goes_on_here_to_the_same(
    cluster, whole, tmp_path, capsys, monkeypatch, stop
):
    without_charts(monkeypatch)
    out = tmp_path / "run"
    program = f"""
        import os, signal
        from blender_lidar.run.folder import RunFolder
        store = RunFolder.write_checkpoint
        def store_and_stop(*given):
            store(*given)
            os.kill(os.getpid(), signal.{stop})
        RunFolder.write_checkpoint = store_and_stop
        """
    with blender_lidar("optimise", whole[0], "--out", out, "--cluster", cluster.address, program=program) as run:
        _, err = run.communicate(timeout=WAIT_S)
    assert run.returncode == (1 if stop == "SIGINT" else -signal.SIGKILL)
    if stop == "SIGINT":
        assert err.splitlines()[-1] == f"blender-lidar: stopped; go on with: --out {out} --resume"
        assert "Traceback" not in err
    wait_for(lambda: not kept(cluster))
    done(capsys, "optimise", whole[0], "--out", out, "--resume", "--workers", 1)
    check_same_run(out, whole[1])


# --- who does what ----------------------------------------------------------------------------------------------------


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


def test_each_worker_is_handed_the_function_once_and_a_frame_goes_to_the_one_that_has_its_tree(cluster):
    with closing(ClusterWorkers(Pickled().times, cluster.address)) as workers:
        batches = [workers.map(range(8)) for _ in range(3)]
        assert workers.map([]) == []
        assert [len(workers.sizes(items, 1)) for items in (0, 1, 2, 30, 64, 10_000)] == [0, 1, 2, 2, 4, 8]
        assert sum(workers.sizes(1001, 1)) == 1001
    assert batches[0] == batches[1] == batches[2]
    assert {pid for pid, _ in batches[0]} == set(on_each_worker(cluster, os.getpid).values())
    assert {read for _, read in batches[0]} == {1}


# --- workers that come and go -----------------------------------------------------------------------------------------


def set_status(name, dask_worker):
    """Pause a worker as dask does, or let it go on."""
    dask_worker.status = distributed.core.Status[name]


def square(number):
    """One call at a time in each process."""
    assert not _busy
    _busy.append(number)
    time.sleep(0.01)
    _busy.remove(number)
    return number**2


_busy = []
SQUARES = [number**2 for number in range(24)]


def squares(workers):
    return workers.map(range(24))


def test_workers_that_come_later_are_used_and_one_killed_midway_or_the_only_one_changes_nothing(own_cluster):
    with closing(ClusterWorkers(square, own_cluster.address)) as workers:
        assert squares(workers) == SQUARES
        second = own_cluster.start_worker()
        assert squares(workers) == SQUARES
        wait_for(lambda: kept(own_cluster).count("loads") == 2)
        killer = threading.Timer(0.2, second.kill)
        killer.start()
        while killer.is_alive() or second.poll() is None:
            assert squares(workers) == SQUARES
        assert squares(workers) == SQUARES
        own_cluster.workers[0].kill()
        later = threading.Timer(0.3, own_cluster.start_worker)
        later.start()
        assert squares(workers) == SQUARES
        later.join()


def test_a_paused_worker_is_passed_over_and_what_is_cancelled_is_begun_anew(own_cluster):
    own_cluster.start_worker("--nthreads", 1, "--memory-limit", 0)
    with closing(ClusterWorkers(square, own_cluster.address)) as workers:
        assert squares(workers) == SQUARES
        paused = next(iter(on_each_worker(own_cluster, os.getpid)))
        for status in ("paused", "running"):
            on_each_worker(own_cluster, partial(set_status, status), [paused])
            assert squares(workers) == SQUARES
        for _ in range(2):  # as where somebody restarts the cluster, between batches and during one
            workers._client.cancel([*workers._kept.values()], force=True)
            results = workers.each(range(24))
            found = [next(results)]
            workers._client.cancel([*workers._kept.values()], force=True)
            assert [*found, *results] == SQUARES


def test_when_all_workers_or_the_scheduler_are_gone_for_good_that_is_one_line(own_cluster, monkeypatch):
    monkeypatch.setattr(cluster_module, "_LOOK_ROUND_S", 0.2)
    monkeypatch.setattr(cluster_module, "_NOBODY_S", 0.3)

    def message(gone):
        with closing(ClusterWorkers(square, own_cluster.address)) as workers:
            assert squares(workers) == SQUARES
            gone.kill()
            began = time.monotonic()
            with pytest.raises(WorkerError) as failure:
                until_refused(workers)
        assert time.monotonic() - began < WAIT_S
        assert "\n" not in str(failure.value)
        return str(failure.value)

    assert "the dask scheduler there has no workers; start some" in message(own_cluster.workers[0])
    own_cluster.start_worker("--nthreads", 1, "--memory-limit", 0)
    assert "the dask scheduler there has gone, or no longer" in message(own_cluster.scheduler)


def until_refused(workers):
    """That somebody is gone is noticed a moment later."""
    for _ in range(1000):
        squares(workers)


# --- what is refused --------------------------------------------------------------------------------------------------


def check_refused(address, said):
    with pytest.raises(WorkerError, match=said) as failure:
        ClusterWorkers(abs, address)
    assert str(failure.value).startswith(f"{address}: ")
    assert "\n" not in str(failure.value)


def test_an_address_without_a_scheduler_is_one_line(monkeypatch, cluster):
    check_refused(next(iter(on_each_worker(cluster, os.getpid))), "no dask scheduler answers there")
    monkeypatch.setattr(cluster_module, "_ANSWER_S", 1.0)
    before = set(threading.enumerate())
    with socket.create_server(("127.0.0.1", 0)) as silent:  # takes calls, and says nothing
        for port in (1, silent.getsockname()[1]):
            check_refused(f"tcp://127.0.0.1:{port}", "no dask scheduler answers there within 1 s; start one with")
    assert set(threading.enumerate()) == before  # nobody goes on trying


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ("# an hour older", "has another blender_lidar, 0.1.0 "),
        ("raise ImportError('no such thing here')", "cannot import blender_lidar: no such"),
    ],
)
def test_workers_with_another_blender_lidar_or_none_are_refused(tmp_path, changed, said):
    package = tmp_path / "other" / "blender_lidar"
    shutil.copytree(ROOT / "blender_lidar", package, ignore=shutil.ignore_patterns("__pycache__"))
    with (package / "__init__.py").open("a") as file:
        file.write(f"{changed}\n")
    with LocalCluster(tmp_path, workers=0) as wrong:
        wrong.start_worker(package=package.parent)
        check_refused(wrong.address, said)


def test_a_scheduler_without_workers_is_one_line_and_threads_that_would_be_idle_are_told(tmp_path, monkeypatch):
    monkeypatch.setattr(cluster_module, "_NOBODY_S", 0.3)
    with LocalCluster(tmp_path, workers=0) as started:
        check_refused(started.address, f"has no workers; start some with `dask worker {started.address} --nthreads 1`$")
        started.start_worker("--nthreads", 3)
        with pytest.warns(UserWarning, match="a worker process does one task at a time"):
            workers = ClusterWorkers(square, started.address)
        with closing(workers):
            assert squares(workers) == SQUARES


def fails(how):
    if how == "import":
        import a_library_that_nobody_has  # noqa: F401
    raise TimeoutError("too late") if how == "time" else InputError("this cannot be")


def test_what_a_task_raises_is_raised_here(cluster):
    with closing(ClusterWorkers(fails, cluster.address)) as workers:
        with pytest.raises(InputError, match=r"^this cannot be$"):
            workers.map(["input"])
        with pytest.raises(TimeoutError, match=r"^too late$"):
            workers.map(["time"])
        with pytest.raises(WorkerError, match="a worker cannot do its task: No module named 'a_library_that_nobody"):
            workers.map(["import"])


def test_without_dask_the_extra_is_named(capsys, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    words = ("--out", tmp_path / "run", "--cluster", "tcp://127.0.0.1:8786")
    code, _, err = cli(capsys, "optimise", write_scene(tmp_path), *words)
    assert code == 2
    assert err.splitlines()[-1] == (
        'blender-lidar: --cluster needs dask.distributed: pip install "blender_lidar[cluster]"'
    )
