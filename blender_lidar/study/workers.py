"""Workers: whoever calls one function that they hold, through an executor; here those that need no other process.

Behind one door, all come to the same results: this process (`Alone`), processes of our own (`worker_pool.WorkerPool`),
this one with such processes (`shared_work.SharedWork`) and those of a cluster (`cluster_workers.ClusterWorkers`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Executor, Future
from contextlib import AbstractContextManager, nullcontext

from ..stop_signals import stops_deferred

_TASKS_PER_WORKER = 8  # few enough to amortise a task, enough to even out uneven ones


class Workers:
    """Calls one function through an executor.

    Parameters
    ----------
    executor : Executor
        What carries the calls out.
    call : callable
        What is submitted to it: the function, or what finds it where it is held.
    count : int
        How many calls are carried out at a time.
    """

    def __init__(self, executor: Executor, call: Callable, count: int) -> None:
        self._executor, self._call = executor, call
        self.count = count

    def sizes(self, items: int, work: int) -> list[int]:
        """How many of so many items every task is to take, in their order; each is `work` casts of a frame."""
        return even_sizes(items, self.count * _TASKS_PER_WORKER)

    def map(self, *arguments: Iterable) -> list:
        """What the function returns for each set of arguments, in their order.

        Raises
        ------
        WorkerError
            When workers are lost that nobody can replace.
        """
        return list(self.each(*arguments))

    def each(self, *arguments: Iterable) -> Iterator:
        """As `map`, one after another as soon as it is known; where others work, all calls are under way at once."""
        with self._failures_told():
            yield from self._executor.map(self._call, *arguments)

    def await_ready(self) -> None:
        """Until all that are still starting are at work; raises `WorkerError` if they never will be."""

    def close(self) -> None:
        """End what belongs to us, after the calls that it is busy with; until then a stop waits.

        Python takes a thread whose `join` Ctrl-C has cut short for ended, leaves, and waits for the processes for ever.
        """
        with stops_deferred():
            self._executor.shutdown(wait=True, cancel_futures=True)

    def _failures_told(self) -> AbstractContextManager:
        """Make one line of what can go wrong with such workers."""
        return nullcontext()


def even_sizes(items: int, tasks: int) -> list[int]:
    """Sizes of `tasks` tasks that differ by one at most; of fewer where there are not as many items."""
    tasks = min(items, tasks)
    return [(number + 1) * items // tasks - number * items // tasks for number in range(tasks)]


class Alone(Workers):
    """This process calls the function, when its result is wanted."""

    def __init__(self, function: Callable) -> None:
        super().__init__(InProcessExecutor(), function, 1)

    def sizes(self, items: int, work: int) -> list[int]:
        return [items]


class InProcessExecutor(Executor):
    """Carries out each call in this process, before `submit` returns."""

    def submit(self, function: Callable, /, *arguments, **keywords) -> Future:
        future: Future = Future()
        try:
            future.set_result(function(*arguments, **keywords))
        except Exception as error:  # a stop is no result
            future.set_exception(error)
        return future

    def map(self, function: Callable, *iterables: Iterable, timeout: float | None = None, chunksize: int = 1):
        """As the built-in: what nobody asks for is not computed, and progress can be told in between."""
        return map(function, *iterables)
