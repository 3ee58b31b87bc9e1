"""Workers of a cluster: each process there is handed the function once, and keeps it until we leave.

What a worker keeps is the result of a task that names that worker: dask neither copies nor drops it, and lets go of it
when the process that asked for it ends, however it ends. Calls name the function by a token, so that any worker may
carry one out, and those of a worker that is lost are carried out by others.
"""

from __future__ import annotations

import hashlib
import pickle
import threading
import uuid
import warnings
import weakref
from collections.abc import Callable, Iterable, Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from functools import cache, partial
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from platform import python_version

from .. import __version__
from ..errors import BlenderLidarError, WorkerError
from .cluster import ClusterExecutor, worker_address
from .workers import Workers, even_sizes

_LIBRARIES = ("numpy", "embreex", "numba", "bpy", "distributed")  # which may alter digits, or how we talk
_LEAST_ITEMS = 16  # of a task, which costs some milliseconds
_TASKS_PER_WORKER = 4  # half of what a process of our own gets, as dask evens out what is uneven
_MOST_MISSES = 20


class ClusterWorkers(Workers):
    """Calls one function on the workers of an existing cluster, each of which keeps a copy of it.

    Parameters
    ----------
    function : callable
        What to call; it and what belongs to it can be pickled.
    address : str
        The scheduler's: ``tcp://host:8786``.

    Raises
    ------
    MissingExtraError
        Without dask.distributed.
    WorkerError
        When no scheduler answers there, it has no workers, or they run another blender_lidar.
    """

    def __init__(self, function: Callable, address: str) -> None:
        executor = ClusterExecutor(address)
        try:
            if executor.most_threads > 1:
                warnings.warn(
                    f"{address}: a worker process does one task at a time, however many threads it has; start them "
                    "with --nthreads 1, one for each core",
                    stacklevel=2,
                )
            token, content = uuid.uuid4().hex, pickle.dumps(function, pickle.HIGHEST_PROTOCOL)
            self._parcel, self._kept = _Parcel(token, content), {}
            super().__init__(executor, partial(_call, token), len(executor.workers))
            self._hand_out()
        except BaseException:
            executor.shutdown()
            raise

    def sizes(self, items: int, work: int) -> list[int]:
        return even_sizes(items, min(self.count * _TASKS_PER_WORKER, max(self.count, items // _LEAST_ITEMS)))

    def each(self, *arguments: Iterable) -> Iterator:
        self._hand_out()
        tasks = list(zip(*arguments, strict=True))
        with self._failures_told(), closing(self._executor.map(self._call, *arguments)) as results:
            for task, found in zip(tasks, results, strict=True):
                yield self._asked_again(task, found)

    def _asked_again(self, task: tuple, found: object) -> object:
        """What a task comes to that went to a worker that does not hold the function, as one that has just come."""
        for _ in range(_MOST_MISSES):
            if not isinstance(found, _NotHeld):
                return found
            self._hand_out(found.worker)
            (found,) = self._executor.map(self._call, *([one] for one in task))
        raise WorkerError(f"{self._executor.address}: the workers drop what they are handed, for want of memory")

    def _hand_out(self, *again: str) -> None:
        """Give the function to workers that have none, and anew to some."""
        present = self._executor.await_workers()
        self._kept = {worker: kept for worker, kept in self._kept.items() if worker in present and worker not in again}
        missing = [worker for worker in present if worker not in self._kept]
        if missing:
            _check_alike(self._executor.run(_description, missing), self._executor.address)
            with self._failures_told():
                self._kept |= self._executor.keep(_hold, self._parcel, missing)

    @contextmanager
    def _failures_told(self) -> Iterator[None]:
        try:
            yield
        except BlenderLidarError:
            raise
        except ImportError as error:
            raise WorkerError(f"{self._executor.address}: a worker cannot do its task: {error}") from error


def _check_alike(descriptions: dict[str, object], address: str) -> None:
    """Refuse workers with another blender_lidar, whose answers may differ; tell of other libraries that do."""
    ours, unlike = _description(), set()
    for worker, theirs in descriptions.items():
        if isinstance(theirs, OSError):  # it has just been lost
            continue
        if isinstance(theirs, Exception):
            raise WorkerError(
                f"{address}: its worker {worker} cannot import blender_lidar: {theirs}; install it where that runs"
            ) from theirs
        if theirs["blender_lidar"] != ours["blender_lidar"]:
            raise WorkerError(
                f"{address}: its worker {worker} has another blender_lidar, {theirs['blender_lidar']}, than here, "
                f"{ours['blender_lidar']}; install the same there and start the worker again"
            )
        unlike |= {(name, theirs[name]) for name in ours if theirs[name] != ours[name]}
    if unlike:
        told = ", ".join(
            f"{name} {theirs or 'none'} there, {ours[name] or 'none'} here" for name, theirs in sorted(unlike)
        )
        warnings.warn(f"{address}: versions differ, and so may the last digits: {told}", stacklevel=3)


# --- in a worker of the cluster ---------------------------------------------------------------------------------------


@cache
def _description() -> dict[str, str]:
    """Versions of what runs here; that of blender_lidar is followed by a digest of its source."""
    digest = hashlib.sha256()
    for path in sorted(Path(__file__).parents[1].rglob("*.py")):
        digest.update(path.read_bytes().replace(b"\r\n", b"\n") + b"\0")
    found = {"blender_lidar": f"{__version__} ({digest.hexdigest()[:12]})", "python": python_version()}
    for library in _LIBRARIES:
        try:
            found[library] = version(library)
        except PackageNotFoundError:
            found[library] = ""
    return found


@dataclass(frozen=True, slots=True)
class _Parcel:
    """A function on its way: its token, and what `pickle` makes of it."""

    token: str
    content: bytes


@dataclass(frozen=True, slots=True)
class _NotHeld:
    """What a worker answers that has no such function."""

    worker: str


class _Held:
    """A function that this process keeps; one thread at a time calls it."""

    def __init__(self, parcel: _Parcel) -> None:
        self._token, self._function, self._lock = parcel.token, pickle.loads(parcel.content), threading.Lock()

    def __call__(self, *arguments) -> object:
        with self._lock:
            return self._function(*arguments)

    def __reduce__(self):
        """Dask may move what a worker keeps, to disk or to another one."""
        return _hold, (_Parcel(self._token, pickle.dumps(self._function, pickle.HIGHEST_PROTOCOL)),)


_held: weakref.WeakValueDictionary[str, _Held] = weakref.WeakValueDictionary()  # dask has the reference that counts


def _hold(parcel: _Parcel) -> _Held:
    return _held.setdefault(parcel.token, _held.get(parcel.token) or _Held(parcel))


def _call(token: str, *arguments) -> object:
    held = _held.get(token)
    return _NotHeld(worker_address()) if held is None else held(*arguments)
