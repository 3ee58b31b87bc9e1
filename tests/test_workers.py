"""Calls shared by this process and others: all are made, once, in whichever process, and returned in their order."""

from __future__ import annotations

import multiprocessing
import os
import subprocess
import sys
import textwrap
import time
from functools import partial
from pathlib import Path

import pytest

from blender_lidar.errors import WorkerError
from blender_lidar.scoring.workers import MappedWorkers, Workers
from tests.small_scene import write_scene
from tests.waiting import WAIT_S

pytestmark = pytest.mark.versions

ROOT = Path(__file__).parents[1]


def slowly(number: int, seconds: float = 0.0) -> tuple[int, int]:
    time.sleep(seconds)
    if number < 0:
        raise ValueError(f"{number} is negative")
    return number, os.getpid()


@pytest.fixture(params=[2, 3])
def shared(request):
    work = Workers(slowly, request.param)
    yield work
    work.close()


def test_results_come_in_the_order_of_the_calls_before_and_after_the_others_have_started(shared):
    for _ in range(2):
        assert [number for number, _ in shared.map(range(50))] == list(range(50))
        shared.await_ready()
    assert shared.map([]) == []


def test_all_processes_take_part_and_this_one_takes_the_last(shared):
    shared.await_ready()
    made = shared.map(range(24), [0.02] * 24)
    assert len({process for _, process in made}) == shared.count
    assert made[-1][1] == os.getpid()
    assert made[0][1] != os.getpid()


def test_in_like_batches_two_processes_meet_the_same_items():
    """What is kept for an item is then made by one of them."""
    work = Workers(slowly, 2)
    try:
        work.await_ready()
        batches = [[process for _, process in work.map(range(16), [0.05] * 16)] for _ in range(3)]
    finally:
        work.close()
    assert sum(len(set(process)) > 1 for process in zip(*batches, strict=True)) <= 6
    assert batches[0] == sorted(batches[0], key=lambda process: process == os.getpid())


@pytest.mark.parametrize("place", [0, 12, 23])
def test_an_error_in_any_call_is_raised_and_the_next_batch_is_none_the_worse(shared, place):
    shared.await_ready()
    numbers = [-1 if number == place else number for number in range(24)]
    with pytest.raises(ValueError, match="-1 is negative"):
        shared.map(numbers, [0.005] * 24)
    assert [number for number, _ in shared.map(range(8))] == list(range(8))


def noted(folder: Path, number: int) -> int:
    (folder / str(number)).touch()
    time.sleep(0.02)
    return number


@pytest.fixture
def noting():
    work = Workers(noted, 2)
    work.await_ready()
    yield work
    work.close()


def test_what_nobody_asks_for_any_more_is_not_begun(noting, tmp_path):
    results = noting.each([tmp_path] * 40, range(40))
    next(results)
    results.close()
    noting.map([tmp_path] * 2, (40, 41))
    assert len(list(tmp_path.iterdir())) < 12


@pytest.mark.parametrize("work", [1, 6, 700])
@pytest.mark.parametrize("items", [0, 1, 2, 7, 54, 1000])
def test_calls_hold_all_items_are_large_at_both_ends_and_small_where_they_meet(shared, items, work):
    sizes = shared.sizes(items, work)
    assert sum(sizes) == items
    assert all(size > 0 for size in sizes)
    turn = sizes.index(min(sizes)) if sizes else 0
    assert sizes[:turn] == sorted(sizes[:turn], reverse=True)
    assert sizes[turn:] == sorted(sizes[turn:])
    if items >= 54:
        assert sizes[turn] == 1
        assert max(sizes) <= items / 2


def test_little_work_is_one_large_call_to_each_of_the_others_and_a_small_one(shared):
    """Handing a call over takes as long as some casts: batches of a climb lost a fifth to it."""
    others, items = shared.count - 1, 12 * shared.count
    sizes = shared.sizes(items, 4)
    assert sizes[: 2 * others] == [11] * others + [1] * others
    assert max(shared.sizes(items, 700)) <= items / (4 * shared.count)


class ReadOnce:
    """Counts how often a process has read it."""

    read = 0

    def __reduce__(self):
        return _read_once, ()

    def __call__(self, number: int) -> tuple[int, int, int]:
        return 10 * number, os.getpid(), ReadOnce.read


def _read_once():
    ReadOnce.read += 1
    return ReadOnce()


def test_any_map_makes_the_calls_and_each_of_its_processes_reads_the_function_once():
    with multiprocessing.get_context("spawn").Pool(2) as pool:
        work = MappedWorkers(ReadOnce(), pool.map)
        found = [one for _ in range(3) for one in work.map(range(20))]
        assert [number for number, *_ in found] == [10 * number for number in range(20)] * 3
        assert {read for *_, read in found} == {1}
        assert os.getpid() not in {process for _, process, _ in found}
        assert list(work.each([])) == []
        work.close()
        assert pool.map(abs, [-1]) == [1]
    assert sum(work.sizes(1000, 1)) == 1000
    assert work.sizes(2, 1) == [1, 1]


def test_closing_ends_the_others():
    before = set(multiprocessing.active_children())
    work = Workers(slowly, 3)
    work.await_ready()
    children = set(multiprocessing.active_children()) - before
    work.close()
    assert len(children) == 2
    assert not any(child.is_alive() for child in children)


class Dying:
    """Ends the process that it is unpickled in; it is larger than a pipe holds."""

    def __reduce__(self):
        return os._exit, (1,), b"0" * 1_000_000


def test_a_worker_that_dies_while_it_starts_is_an_error_and_no_hang():
    work = Workers(partial(len, Dying()), 2)
    try:
        with pytest.raises(WorkerError, match="a worker process ended abruptly, perhaps because memory ran out"):
            work.await_ready()
    finally:
        work.close()


def python(*words, **how):
    """Another Python in the working folder of the tests; it must end well."""
    done = subprocess.run(
        [sys.executable, *map(str, words)], cwd=ROOT, capture_output=True, text=True, timeout=WAIT_S, **how
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()


@pytest.mark.parametrize("piped", [True, False], ids=["from a pipe", "a file"])
def test_a_script_that_starts_workers_needs_no_guard(tmp_path, piped):
    """What is started must not run the script again, and finds no file of one that came through a pipe."""
    script = textwrap.dedent(
        f"""
        import blender_lidar as bl

        print("once")
        site = bl.load_scene({str(write_scene(tmp_path))!r}, workers=2)
        with bl.api.site_evaluator(site, site.search) as evaluator:
            evaluator.workers.await_ready()
            layout = (site.scenario.lidar.baseline,)
            print(evaluator.workers.count, len(evaluator.totals([layout]).objective))
        """
    )
    (tmp_path / "script.py").write_text(script)
    said = (
        python("-", input=script)
        if piped
        else python(tmp_path / "script.py", env={**os.environ, "PYTHONPATH": str(ROOT)})
    )
    assert said == ["once", "2 1"]


def test_what_a_script_defines_is_found_by_its_workers_below_its_guard(tmp_path):
    script = """
        from blender_lidar.scoring.workers import Workers

        def doubled(number):
            return 2 * number

        if __name__ == "__main__":
            work = Workers(doubled, 2)
            work.await_ready()
            print(work.map(range(4)))
            work.close()
        """
    (tmp_path / "script.py").write_text(textwrap.dedent(script))
    assert python(tmp_path / "script.py", env={**os.environ, "PYTHONPATH": str(ROOT)}) == ["[0, 2, 4, 6]"]
