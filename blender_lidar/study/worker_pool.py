"""Processes that share the calls of one function; a pool of them starts whole or not at all, and leaves nobody behind.

They are spawned: forking a process that has loaded Blender is unsafe.
"""

from __future__ import annotations

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
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import AbstractContextManager, ExitStack, contextmanager
from multiprocessing import resource_tracker
from pathlib import Path

from ..errors import WorkerError
from ..stop_signals import stops_deferred
from .workers import Workers

_STOP_ON_ITS_WAY_S = 0.5


def within_blender() -> bool:
    """Whether this process is a real Blender: it cannot start Python processes that have bpy too."""
    bpy = sys.modules.get("bpy")
    return bpy is not None and not getattr(bpy.app, "module", False)


if within_blender():
    # A second name for the main module: Blender frees that before it looks through all modules at its end, and crashed.
    sys.modules.pop("__mp_main__", None)


class WorkerPool(Workers):
    """Calls one function in several processes, each of which keeps a copy of it.

    They start in the background; nothing is given to them before all have started.

    Parameters
    ----------
    function : callable
        What to call; it and what belongs to it can be pickled.
    workers : int
        Processes.

    Raises
    ------
    WorkerError
        When a process cannot be started; if one ends while it starts, from the first call that notices.
    """

    def __init__(self, function: Callable, workers: int) -> None:
        with ExitStack() as stack, _failures_as_worker_errors():
            path = stack.enter_context(_stored(function))
            self._starting = _Starting(path, workers)
            super().__init__(self._starting.executor, _call, workers)
            self._stored = stack.pop_all()

    @property
    def ready(self) -> bool:
        """Whether all processes have started; raises `WorkerError` if one has ended meanwhile."""
        if self._starting is not None and self._starting.over:
            self.await_ready()
        return self._starting is None

    def await_ready(self) -> None:
        if self._starting is None:
            return
        with _failures_as_worker_errors():
            try:
                self._starting.wait()
            except BaseException:
                self.close()
                raise
        self._starting = None
        self._stored.close()

    def each(self, *arguments: Iterable) -> Iterator:
        self.await_ready()
        yield from super().each(*arguments)

    def submit(self, *arguments) -> Future:
        """A call under way; only once all processes have started."""
        return self._executor.submit(self._call, *arguments)

    def close(self) -> None:
        with stops_deferred():
            if self._starting is None:
                super().close()
            else:
                self._starting.abandon()
            self._stored.close()

    def _failures_told(self) -> AbstractContextManager:
        return _failures_as_worker_errors()


@contextmanager
def _failures_as_worker_errors() -> Iterator[None]:
    try:
        yield
    except BrokenProcessPool as error:
        time.sleep(_STOP_ON_ITS_WAY_S)  # a SIGTERM to all of us may have reached a worker first; ours ends this here
        raise WorkerError("a worker process ended abruptly, perhaps for want of memory; try --workers 1") from error


# --- in the process that starts the workers ---------------------------------------------------------------------------


@contextmanager
def _stored(function: Callable) -> Iterator[Path]:
    """A file that holds a function: through the pipe to a process that has died, much data would be written for ever.

    Where this process is killed, its workers remove it.
    """
    with ExitStack() as stack:
        try:
            path = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="blender_lidar-"))) / "function.pickle"
            with path.open("wb") as file:
                pickle.dump(function, file, pickle.HIGHEST_PROTOCOL)
        except OSError as error:
            why = error.strerror or error
            raise WorkerError(
                f"the temporary folder {tempfile.tempdir or ''} cannot be written, which worker processes need: {why}; "
                "make room, set TMPDIR to another one, or try --workers 1"
            ) from error
        yield path


class _Starting:
    """A pool from its processes' start until all have read their function."""

    def __init__(self, path: Path, workers: int) -> None:
        others, self.executor = set(multiprocessing.active_children()), None
        try:
            with stops_deferred(), _stops_blocked(), _single_threaded_children(), _no_folders_of_blender():
                context = multiprocessing.get_context("spawn")
                start = (_start_worker, (path, context.Barrier(workers)))
                self.executor = ProcessPoolExecutor(workers, context, *start)
                self._ready = [self.executor.submit(_ready) for _ in range(workers)]  # a process each: none is idle yet
                self._children = set(multiprocessing.active_children()) - others
        except BaseException as error:
            self._children = set(multiprocessing.active_children()) - others
            self.abandon()
            if not isinstance(error, OSError):
                raise
            these = f"{workers} worker processes" if workers > 1 else "a worker process"
            raise WorkerError(f"{these} cannot be started: {error.strerror}; try --workers 1") from error

    @property
    def over(self) -> bool:
        """Whether all have started, or one has ended."""
        return all(one.done() for one in self._ready)

    def wait(self) -> None:
        """Until all have started; raises `BrokenProcessPool` if one has ended."""
        for one in self._ready:
            one.result()

    def abandon(self) -> None:
        """End a pool that may have started in part: its processes wait for those that never came."""
        for child in self._children:
            child.kill()
        if self.executor is not None:
            self.executor.shutdown(wait=True, cancel_futures=True)


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
    before = {name: os.environ.get(name) for name in names}
    os.environ.update(dict.fromkeys(names, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


@contextmanager
def _no_folders_of_blender() -> Iterator[None]:
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


def _start_worker(path: Path, all_started: threading.Barrier) -> None:
    global _function
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the parent's to handle
    threading.Thread(target=_end_with_parent, args=[path.parent], daemon=True).start()
    _function = pickle.loads(path.read_bytes())
    all_started.wait()  # so that no worker takes the first task of another, and the file is no longer needed


def _end_with_parent(folder: Path) -> None:
    """A parent that was killed cannot end its workers, which would wait for ever, nor remove its temporary folder."""
    multiprocessing.parent_process().join()
    shutil.rmtree(folder, ignore_errors=True)
    os._exit(1)


def _ready() -> None:
    """Nothing: its return tells that every process has started."""


def _call(*arguments):
    return _function(*arguments)
