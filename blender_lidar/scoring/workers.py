"""Worker processes: this process and others call one function, which each of them holds (`concurrent.futures`).

The others are spawned, as to fork a process that has loaded Blender is unsafe, and start in the background while this
one is at work already; a run that is over by then has never waited for them.

Where all results are wanted together, the others take calls from the front and this one takes them from the back,
until they meet: nobody waits while another is at work, and in like batches each meets the same items, so that what
is kept for an item is made in one process. Calls are large at both ends and small where they meet: to hand one over
costs as much as a few casts of a frame, and the last one is what others wait for. Where results are wanted one
after another, all take the next, so that what is done can be stored at once.
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
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing import resource_tracker
from pathlib import Path
from typing import Any

from ..errors import WorkerError
from ..signals import stops_deferred

_AT_HAND = 2  # calls that each of the others is given at a time: what it makes, and the next
_FEWEST_CALLS = 4  # for each process: one that starts late, or is slower, finds or leaves enough for the others
_LEAST_WORK = 64  # casts of a frame: less is not divided, whatever _FEWEST_CALLS, but for a small call behind it
_STOP_ON_ITS_WAY_S = 0.5
_FUNCTION = "function.pickle"  # a file of the folder that the others read when they start


class Workers:
    """Calls one function in this process and in others, each of which keeps a copy of it.

    Parameters
    ----------
    function : callable
        What to call; for others, it and what belongs to it can be pickled.
    processes : int
        How many, this one among them.

    Raises
    ------
    WorkerError
        When a process cannot be started; if one ends while it starts, or later, from the first call that notices.
    """

    def __init__(self, function: Callable, processes: int = 1) -> None:
        self._function, self.count = function, processes
        self._others = ProcessPool(function, processes - 1) if processes > 1 else None

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
        return list(self._results(arguments, from_back=self._others is not None))

    def each(self, *arguments: Iterable) -> Iterator:
        """As `map`, one after another as soon as it is known."""
        return self._results(arguments, from_back=False)

    def await_ready(self) -> None:
        """Until all others have started; raises `WorkerError` if one never will."""
        if self._others is not None:
            self._others.await_ready()

    def close(self) -> None:
        """End the others, after the calls that they are busy with."""
        if self._others is not None:
            self._others.close()

    def _results(self, arguments: tuple[Iterable, ...], *, from_back: bool) -> Iterator:
        """What the calls return, in their order.

        Others are given no more than keeps them busy, and nothing is taken back from them: Python 3.11 waits for ever
        for processes of which one has died if a call was cancelled.
        """
        calls = list(zip(*arguments, strict=True))
        first, end = 0, len(calls)  # of those that nobody has taken
        done: dict[int, Any] = {}  # by this process
        given: dict[int, Future] = {}
        with _failures_told():
            for number in range(len(calls)):
                while not (number in done or (number in given and given[number].done())):
                    if first < end and self._others is not None and self._others.ready:
                        busy = sum(not call.done() for call in given.values())
                        start, first = first, min(end, first + max(0, self._others.count * _AT_HAND - busy))
                        given |= {place: self._others.submit(*calls[place]) for place in range(start, first)}
                    if first == end:
                        wait([given[number]])
                    elif from_back:
                        end -= 1
                        done[end] = self._function(*calls[end])
                    else:
                        first += 1
                        done[first - 1] = self._function(*calls[first - 1])
                yield done.pop(number) if number in done else given.pop(number).result()


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


class ProcessPool:
    """Spawned processes that call one function, each of which keeps a copy of it; all of them start, or none.

    Parameters
    ----------
    function : callable
        What to call; it and what belongs to it can be pickled.
    count : int
        Processes.

    Raises
    ------
    WorkerError
        When a process cannot be started; if one ends while it starts, from `ready` or `await_ready`.
    """

    def __init__(self, function: Callable, count: int) -> None:
        self.count, self._starting = count, []
        self._folder, self._executor, self._children = None, None, set()
        try:
            self._store(function)
            self._start()
        except BaseException:
            self.close()
            raise

    @property
    def ready(self) -> bool:
        """Whether all processes have started; nothing is given to them before."""
        if all(one.done() for one in self._starting):
            self.await_ready()
        return not self._starting

    def await_ready(self) -> None:
        """Until all processes have started."""
        with _failures_told():
            try:
                for one in self._starting:
                    one.result()
            except BaseException:
                self.close()
                raise
        self._starting = []
        self._folder.cleanup()

    def submit(self, *arguments) -> Future:
        """A call under way, once all processes have started."""
        return self._executor.submit(_call, *arguments)

    def close(self) -> None:
        """End the processes, after the calls that they are busy with; until then a stop waits.

        Python takes a thread whose `join` Ctrl-C has cut short for ended, leaves, and waits for the processes for ever.
        """
        with stops_deferred():
            if self._starting or self._executor is None:  # they wait for those that never came
                for child in self._children:
                    child.kill()
            if self._executor is not None:
                self._executor.shutdown(wait=True, cancel_futures=True)
            if self._folder is not None:
                self._folder.cleanup()

    def _store(self, function: Callable) -> None:
        """Write the function to a file: through the pipe to a process that has died, much data is written for ever.

        Where this process is killed, the others remove it.
        """
        try:
            self._folder = tempfile.TemporaryDirectory(prefix="blender_lidar-")
            with (Path(self._folder.name) / _FUNCTION).open("wb") as file:
                pickle.dump(function, file, pickle.HIGHEST_PROTOCOL)
        except OSError as error:
            raise WorkerError(
                f"the temporary folder {tempfile.tempdir or ''} cannot be written, which worker processes need: "
                f"{error.strerror or error}; make room, set TMPDIR to another one, or try --workers 1"
            ) from error

    def _start(self) -> None:
        before = set(multiprocessing.active_children())
        try:
            with _failures_told(), stops_deferred(), _stops_blocked(), _single_threaded_children(), _own_bpy():
                context = multiprocessing.get_context("spawn")
                start = (_start_worker, (Path(self._folder.name), context.Barrier(self.count)))
                self._executor = ProcessPoolExecutor(self.count, context, *start)
                for _ in range(self.count):  # a process each: none is idle yet
                    self._starting.append(self._executor.submit(os.getpid))
        except OSError as error:
            these = f"{self.count} worker processes" if self.count > 1 else "a worker process"
            raise WorkerError(f"{these} cannot be started: {error.strerror}; try --workers 1") from error
        finally:
            self._children = set(multiprocessing.active_children()) - before


@contextmanager
def _failures_told() -> Iterator[None]:
    try:
        yield
    except BrokenProcessPool as error:
        time.sleep(_STOP_ON_ITS_WAY_S)  # a SIGTERM to all of us may have reached a worker first; ours ends this here
        raise WorkerError("a worker process ended abruptly, perhaps for want of memory; try --workers 1") from error


# --- what processes that are started here take over --------------------------------------------------------


@contextmanager
def _stops_blocked() -> Iterator[None]:
    """Keep Ctrl-C and the closing of the terminal from processes started here, from their first moment on.

    In this one they are no more than kept from this thread: another one may take them. SIGTERM passes: it is how a pool
    ends the processes that are left when one has died.
    """
    if not hasattr(signal, "pthread_sigmask"):  # Windows
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGHUP})
    try:
        resource_tracker.ensure_running()  # later its start would let SIGINT through again
        signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def _single_threaded_children() -> Iterator[None]:
    """Let processes started here multiply their small matrices with one thread each."""
    names = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
    before = {name: os.environ[name] for name in names if name in os.environ}
    os.environ.update(dict.fromkeys(names, "1"))
    try:
        yield
    finally:
        for name in names:
            del os.environ[name]
        os.environ.update(before)


@contextmanager
def _own_bpy() -> Iterator[None]:
    """Let processes started here, which take over `sys.path`, find the bpy that was installed.

    Once imported, bpy puts folders of its own first, where there is another bpy that works inside Blender alone.
    """
    before, blender = sys.path, sys.modules.get("bpy")
    if blender is not None:
        own = blender.utils.resource_path("LOCAL")
        sys.path = [folder for folder in before if not Path(folder).is_relative_to(own)]
    try:
        yield
    finally:
        sys.path = before


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
