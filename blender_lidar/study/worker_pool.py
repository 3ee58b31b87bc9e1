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
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
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

    Parameters
    ----------
    function : callable
        What to call; it and what belongs to it can be pickled.
    workers : int
        Processes.

    Raises
    ------
    WorkerError
        When a process cannot be started or ends while it starts.
    """

    def __init__(self, function: Callable, workers: int) -> None:
        with _stored(function) as path, _failures_as_worker_errors():
            super().__init__(_started(path, workers), _call, workers)

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


def _started(path: Path, workers: int) -> ProcessPoolExecutor:
    """A pool whose processes have all read their function."""
    others, executor = set(multiprocessing.active_children()), None
    try:
        with stops_deferred(), _stops_blocked(), _single_threaded_children(), _no_folders_of_blender():
            context = multiprocessing.get_context("spawn")
            start = (_start_worker, (path, context.Barrier(workers)))
            executor = ProcessPoolExecutor(workers, context, *start)
            ready = executor.map(_ready, range(workers))  # starts them all, as none is idle before the last
        list(ready)
    except OSError as error:
        _abandon(executor, others)
        raise WorkerError(f"{workers} worker processes cannot be started: {error.strerror}; try --workers 1") from error
    except BaseException:
        _abandon(executor, others)
        raise
    return executor


def _abandon(executor: ProcessPoolExecutor | None, others: set) -> None:
    """End a pool that may have started in part: its processes wait for those that never came."""
    for child in set(multiprocessing.active_children()) - others:
        child.kill()
    if executor is not None:
        executor.shutdown(wait=True, cancel_futures=True)


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


def _ready(_: int) -> None:
    """Nothing: its return tells that every process has started."""


def _call(*arguments):
    return _function(*arguments)
