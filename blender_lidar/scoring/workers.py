"""Worker processes: this process and others, spawned, call one function (`concurrent.futures`).

To fork a process that has loaded Blender is unsafe, and a spawned one takes a second to start: meanwhile this one is at
work already, and a run that is over by then has never waited. Where all results are wanted together, the others take
calls from the front and this one takes them from the back, until they meet: nobody waits while another is at work, and
in like batches each meets the same items, so that what is kept for an item is made in one process. Calls are large at
both ends and small where they meet: to hand one over costs as much as a few casts of a frame, and the last one is what
others wait for. Where results are wanted one after another, all take the next, so that what is done can be stored at
once.
"""

from __future__ import annotations

import math
import multiprocessing
import os
import pickle
import shutil
import signal
import sys
import tempfile
import threading
import time
import uuid
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from functools import partial
from multiprocessing import resource_tracker
from pathlib import Path
from types import ModuleType
from typing import Any

from ..errors import WorkerError
from ..signals import stops_deferred

_AT_HAND = 2  # calls that each of the others is given at a time: what it makes, and the next
_FEWEST_CALLS = 4  # for each process: one that starts late, or is slower, finds or leaves enough for the others
_LEAST_WORK = 64  # casts of a frame: less is not divided, also in favour of _FEWEST_CALLS, except for a small last call
_STOP_ON_ITS_WAY_S = 0.5
_CALLS_OF_MAP = 16
_FUNCTION = "function.pickle"  # a file of the folder that the others read when they start
_ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


class Workers:
    """Calls one function in this process and in others, each of which keeps a copy of it; use `close` at the end.

    Parameters
    ----------
    function : callable
        What to call; for others, it and what belongs to it can be pickled.
    processes : int
        How many, this one among them; all of them start, or none.

    Raises
    ------
    WorkerError
        When a process cannot be started; if one ends while it starts, or later, from the first call that notices.
    """

    def __init__(self, function: Callable, processes: int = 1) -> None:
        self._function, self.count = function, processes
        self._folder, self._executor, self._children = None, None, set()
        self._starting: Future | None = None  # done when all others have started
        if processes > 1:
            try:
                self._store()
                self._start()
            except BaseException:
                self.close()
                raise

    def sizes(self, items: int, work: int) -> list[int]:
        """How many of so many items each call is to take, in their order; each item is `work` casts of a frame."""
        others, least = self.count - 1, math.ceil(_LEAST_WORK / max(work, 1))
        if not others:
            return [items]
        most = max(least, math.ceil(items / (_FEWEST_CALLS * self.count)))
        front = _tapered(items * others // self.count, others, least, most)
        return front + _tapered(items - sum(front), 1, 1, most)[::-1]

    def map(self, *arguments: Iterable) -> list:
        """What the function returns for each set of arguments, in their order."""
        return list(self.each(*arguments, from_back=self.count > 1))

    def submit(self, *arguments) -> Future:
        """A call of one of the others."""
        return self._executor.submit(_call, *arguments)

    def await_ready(self) -> None:
        """Until all others have started, which they do in the background; raises `WorkerError` if one never will."""
        if self._starting is not None:
            with _failures_in_one_line():
                self._starting.result()
            self._starting = None
            self._folder.cleanup()

    def close(self) -> None:
        """End the others, after the calls that they are busy with; until then a stop waits.

        Python takes a thread whose `join` Ctrl-C has cut short for ended, leaves, and waits for the processes for ever.
        """
        with stops_deferred():
            if self._starting is not None or self._executor is None:  # they wait for those that never came
                for child in self._children:
                    child.kill()
            if self._executor is not None:
                self._executor.shutdown(wait=True, cancel_futures=True)
            if self._folder is not None:
                self._folder.cleanup()

    def each(self, *arguments: Iterable, from_back: bool = False) -> Iterator:
        """As `map`, one after another as soon as it is known; this process takes the next calls, or the last.

        Others are given no more than keeps them busy, and nothing is taken back from them: Python 3.11 waits for ever
        for processes of which one has died if a call was cancelled.
        """
        calls = list(zip(*arguments, strict=True))
        first, end = 0, len(calls)  # of those that nobody has taken
        done: dict[int, Any] = {}  # by this process
        given: dict[int, Future] = {}
        with _failures_in_one_line():
            for number in range(len(calls)):
                while not (number in done or (number in given and given[number].done())):
                    if first < end and self._others_are_ready():
                        busy = sum(not call.done() for call in given.values())
                        start, first = first, min(end, first + max(0, (self.count - 1) * _AT_HAND - busy))
                        given |= {place: self.submit(*calls[place]) for place in range(start, first)}
                    if first == end:
                        wait([given[number]])
                    elif from_back:
                        end -= 1
                        done[end] = self._function(*calls[end])
                    else:
                        first += 1
                        done[first - 1] = self._function(*calls[first - 1])
                yield done.pop(number) if number in done else given.pop(number).result()

    def _others_are_ready(self) -> bool:
        """Whether there are others and all have started; nothing is given to them before."""
        if self._starting is not None and self._starting.done():
            self.await_ready()
        return self._executor is not None and self._starting is None

    def _store(self) -> None:
        """Write the function to a file: through the pipe to a process that has died, much data is written for ever.

        Where this process is killed, the others remove it.
        """
        try:
            self._folder = tempfile.TemporaryDirectory(prefix="blender_lidar-")
            content = pickle.dumps(self._function, pickle.HIGHEST_PROTOCOL)
            self._needs_main = b"__main__" in content
            (Path(self._folder.name) / _FUNCTION).write_bytes(content)
        except OSError as error:
            raise WorkerError(
                f"the temporary folder {tempfile.tempdir or ''} cannot be written, which worker processes need: "
                f"{error.strerror or error}; make room, set TMPDIR to another one, or try --workers 1"
            ) from error

    def _start(self) -> None:
        others, before = self.count - 1, set(multiprocessing.active_children())
        try:
            with _failures_in_one_line(), stops_deferred(), _as_children_take_it_over(self._needs_main):
                context = multiprocessing.get_context("spawn")
                start = (_start_worker, (Path(self._folder.name), context.Barrier(others)))
                self._executor = ProcessPoolExecutor(others, context, *start)
                for _ in range(others):  # a process each: none is idle yet
                    self._starting = self._executor.submit(os.getpid)
        except OSError as error:
            these = f"{others} worker processes" if others > 1 else "a worker process"
            raise WorkerError(f"{these} cannot be started: {error.strerror}; try --workers 1") from error
        finally:
            self._children = set(multiprocessing.active_children()) - before


def _tapered(items: int, processes: int, least: int, most: int) -> list[int]:
    """Loop scheduling by factoring: sizes of calls of which each process takes half of what is left to it.

    They stay within `least` and `most`. One item of each is left to the end, even if `least` is more: the last call is
    the small one.
    """
    sizes: list[int] = []
    while items:
        left, calls = math.ceil(items / processes), min(processes, items)
        size = min(max(least, math.ceil(left / 2)), most, max(1, left - 1))
        sizes += [size] * calls
        items -= size * calls
    return sizes


def even_sizes(items: int, calls: int) -> list[int]:
    """How many of so many items each of so many calls takes, one at least; they differ by one at most."""
    calls = min(items, calls)
    return [(number + 1) * items // calls - number * items // calls for number in range(calls)]


class MappedWorkers:
    """Calls one function through any `map`, as SciPy's `workers` does: of a pool, of an executor or of a cluster.

    Parameters
    ----------
    function : callable
        What to call; it and what belongs to it can be pickled. A process reads it once.
    mapping : callable
        Called with a function and a list of what to call it with; gives what it returns, in that order.
    """

    def __init__(self, function: Callable, mapping: Callable[[Callable, list], Iterable]) -> None:
        content = pickle.dumps(function, pickle.HIGHEST_PROTOCOL)
        self._mapping, self._call = mapping, partial(_call_read, uuid.uuid4().hex, content)

    def sizes(self, items: int, work: int) -> list[int]:
        """As of `Workers`; few calls, as the function goes with each, and nobody knows how many processes there are."""
        return even_sizes(items, _CALLS_OF_MAP)

    def map(self, *arguments: Iterable) -> list:
        """As of `Workers`."""
        return list(self.each(*arguments))

    def each(self, *arguments: Iterable) -> Iterator:
        """As of `Workers`, as early as the `map` gives one."""
        return iter(self._mapping(self._call, list(zip(*arguments, strict=True))))

    def close(self) -> None:
        """Nothing: whose `map` it is ends it."""


@contextmanager
def _failures_in_one_line() -> Iterator[None]:
    try:
        yield
    except BrokenProcessPool as error:
        time.sleep(_STOP_ON_ITS_WAY_S)  # a SIGTERM to all of us may have reached a worker first; ours ends this here
        raise WorkerError("a worker process ended abruptly, perhaps because memory ran out; try --workers 1") from error


@contextmanager
def _as_children_take_it_over(needs_main: bool) -> Iterator[None]:
    """Environment, `sys.path` and blocked signals as processes that are started here are to take them over.

    A spawned process would run the main script first, under another name, so that a script without
    ``if __name__ == "__main__":`` would start everything again, and one read from a pipe has no file to run. Unless it
    `needs_main`, because the function that it calls is defined there, it is given an empty main module.

    One thread each multiplies their small matrices. They find the bpy that was installed: once imported, it puts
    folders of its own first, where there is another one that works inside Blender alone. Ctrl-C and the closing of the
    terminal are kept from them from their first moment on, and here from this thread: another one may take them.
    SIGTERM passes: it is how a pool ends the processes that are left when one has died.
    """
    threads, path, blender = {name: os.environ.get(name) for name in _ONE_THREAD}, sys.path, sys.modules.get("bpy")
    posix = hasattr(signal, "pthread_sigmask")
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGHUP}) if posix else None
    os.environ.update(dict.fromkeys(_ONE_THREAD, "1"))
    main = sys.modules["__main__"]
    if not needs_main:
        sys.modules["__main__"] = ModuleType("__main__")
    try:
        if posix:
            resource_tracker.ensure_running()  # later its start would let SIGINT through again
            signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        if blender is not None:
            own = blender.utils.resource_path("LOCAL")
            sys.path = [folder for folder in path if not Path(folder).is_relative_to(own)]
        yield
    finally:
        sys.modules["__main__"] = main
        for name in _ONE_THREAD:
            del os.environ[name]
        os.environ.update({name: value for name, value in threads.items() if value is not None})
        sys.path = path
        if posix:
            signal.pthread_sigmask(signal.SIG_SETMASK, mask)


# --- in a worker ------------------------------------------------------------------------------------------------------

_function: Callable | None = None


def _start_worker(folder: Path, all_started: threading.Barrier) -> None:
    global _function
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the parent's to handle
    threading.Thread(target=_end_with_parent, args=[folder], daemon=True).start()
    _function = pickle.loads((folder / _FUNCTION).read_bytes())
    all_started.wait()  # so that no worker takes the first task of another, and the file is no longer needed


def _end_with_parent(folder: Path) -> None:
    """A parent that was killed cannot end its workers, which would wait for ever, nor remove its temporary folder."""
    multiprocessing.parent_process().join()
    shutil.rmtree(folder, ignore_errors=True)
    os._exit(1)


def _call(*arguments):
    return _function(*arguments)


_read: dict[str, Callable] = {}  # the function of the last token
_one_at_a_time = threading.Lock()


def _call_read(token: str, content: bytes, arguments: tuple):
    with _one_at_a_time:  # its caches are not for threads
        if token not in _read:
            _read.clear()
            _read[token] = pickle.loads(content)
        return _read[token](*arguments)
