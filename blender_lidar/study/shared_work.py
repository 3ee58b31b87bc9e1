"""This process and others, which share the calls of one function.

Where all results are wanted together, the others take calls from the front and this one takes them from the back, until
they meet: nobody waits while another is at work, and in like batches each meets the same items, so that what is kept
for an item is made in one process. Calls are large at both ends and small where they meet: to hand one over costs as
much as a few casts of a frame, and the last one is what others wait for. Where results are wanted one after another,
all take the next, so that what is done can be stored at once. While the others start, this one is at work already; a
run that is over by then has never waited for them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, wait
from typing import Any

from .worker_pool import WorkerPool
from .workers import Workers

_AT_HAND = 2  # calls that each of the others is given at a time: what it makes, and the next
_FEWEST_CALLS = 4  # for each process: one that starts late, or is slower, finds or leaves enough for the others
_LEAST_WORK = 64  # casts of a frame: less is not divided, whatever _FEWEST_CALLS, but for a small call behind it


class SharedWork(Workers):
    """Calls one function in this process and in others, each of which keeps a copy of it.

    Parameters
    ----------
    function : callable
        What to call; it and what belongs to it can be pickled.
    processes : int
        How many, this one among them; two or more.

    Raises
    ------
    WorkerError
        When a process cannot be started.
    """

    def __init__(self, function: Callable, processes: int) -> None:
        self._function, self._pool, self.count = function, WorkerPool(function, processes - 1), processes

    def sizes(self, items: int, work: int) -> list[int]:
        others, least = self.count - 1, math.ceil(_LEAST_WORK / max(work, 1))
        most = max(least, math.ceil(items / (_FEWEST_CALLS * self.count)))
        front = _tapered(items * others // self.count, others, least, most)
        return front + _tapered(items - sum(front), 1, 1, most)[::-1]

    def map(self, *arguments: Iterable) -> list:
        return list(self._results(arguments, from_back=True))

    def each(self, *arguments: Iterable) -> Iterator:
        return self._results(arguments, from_back=False)

    def _results(self, arguments: tuple[Iterable, ...], *, from_back: bool) -> Iterator:
        with self._failures_told():
            yield from _Batch(self._function, list(zip(*arguments, strict=True)), self._pool, from_back).results()

    def await_ready(self) -> None:
        self._pool.await_ready()

    def close(self) -> None:
        self._pool.close()

    def _failures_told(self):
        return self._pool._failures_told()


def _tapered(items: int, processes: int, least: int, most: int) -> list[int]:
    """Sizes of calls for so many processes, that each take half of what is left to them, within `least` and `most`.

    One item of each is left to the end, whatever `least` says: the last call is the small one.
    """
    sizes: list[int] = []
    while items:
        left, calls = math.ceil(items / processes), min(processes, items)
        size = min(max(least, math.ceil(left / 2)), most, max(1, left - 1))
        sizes += [size] * calls
        items -= size * calls
    return sizes


class _Batch:
    """Calls that are asked for together.

    Others are given no more than keeps them busy, and nothing is taken back from them: Python 3.11 waits for ever for
    processes of which one has died if a call was cancelled.
    """

    def __init__(self, function: Callable, calls: list[tuple], pool: WorkerPool, from_back: bool) -> None:
        self._function, self._calls, self._pool, self._from_back = function, calls, pool, from_back
        self._first, self._end = 0, len(calls)  # of those that nobody has taken
        self._done: dict[int, Any] = {}  # by this process
        self._given: dict[int, Future] = {}

    def results(self) -> Iterator:
        """What the calls return, in their order."""
        for number in range(len(self._calls)):
            while not (number in self._done or (number in self._given and self._given[number].done())):
                self._give_first()
                if self._first < self._end:
                    self._take_one()
                else:
                    wait([self._given[number]])
            yield self._done.pop(number) if number in self._done else self._given.pop(number).result()

    def _give_first(self) -> None:
        """Let the others have enough to do, once they have started."""
        if self._first == self._end or not self._pool.ready:
            return
        busy = sum(not call.done() for call in self._given.values())
        end = min(self._end, self._first + max(0, self._pool.count * _AT_HAND - busy))
        for number in range(self._first, end):
            self._given[number] = self._pool.submit(*self._calls[number])
        self._first = end

    def _take_one(self) -> None:
        if self._from_back:
            self._end -= 1
            number = self._end
        else:
            number = self._first
            self._first += 1
        self._done[number] = self._function(*self._calls[number])
