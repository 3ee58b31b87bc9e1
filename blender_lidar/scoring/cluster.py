"""Workers of a cluster (`dask.distributed`): reached by the address of their scheduler, and never ended.

Each worker keeps the function as the result of a task, on which the calls depend: so dask makes it again where it is
lost, and drops it when the process that asked for it ends. Calls name the worker that has the trees of their frames;
another one takes them where it is busy or gone. The scheduler needs nothing but dask, as it sees bytes alone. Nobody
else imports that library, which the extra `cluster` brings.
"""

from __future__ import annotations

import asyncio
import logging
import operator
import pickle
import threading
import warnings
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import CancelledError, ThreadPoolExecutor
from contextlib import suppress
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from platform import python_version
from typing import NamedTuple

from .. import __version__
from ..errors import MissingExtraError, WorkerError
from ..files import source_digest
from ..signals import stops_deferred
from .workers import even_sizes

_ANSWER_S = 10.0  # a scheduler that is there answers in milliseconds, unless it is very busy
_NOBODY_S = 30.0  # what it may take to start a worker again that died
_LOOK_ROUND_S = 2.0
_LEAST_ITEMS = 16  # of a task, which costs some milliseconds
_TASKS_PER_WORKER = 4  # few enough to amortise a task, enough to even out uneven ones
_TRIES = 5
_LOST = ("cancelled", "lost")
_LIBRARIES = ("numpy", "embreex", "numba", "bpy", "distributed")  # which may alter digits, or how we talk
_LOGGERS = ("distributed", "distributed.client", "distributed.worker", "tornado.application")


class ClusterWorkers:
    """Calls one function on the workers of an existing cluster, which lives on.

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
        try:
            with stops_deferred():  # an import that is interrupted may fail in any way
                import distributed
        except ImportError as error:
            raise MissingExtraError('--cluster needs dask.distributed: pip install "blender_lidar[cluster]"') from error
        self._distributed, self.address, self._client = distributed, address, None
        self._content = pickle.dumps(_Held(pickle.dumps(function, pickle.HIGHEST_PROTOCOL)))
        self._kept: dict[str, object] = {}  # by worker, the future that is the function there
        self._levels = {name: logging.getLogger(name).level for name in _LOGGERS}
        for name in _LOGGERS:  # its failures are ours to report, in one line
            logging.getLogger(name).setLevel(logging.CRITICAL + 1)
        try:
            self._client = self._connected()
            self._hand_out()
            if max(self._client.nthreads().values(), default=1) > 1:
                warnings.warn(
                    f"{address}: a worker process does one task at a time, however many threads it has; start them "
                    "with --nthreads 1, one for each core",
                    stacklevel=2,
                )
        except BaseException:
            self.close()
            raise

    def sizes(self, items: int, work: int) -> list[int]:
        """How many of so many items each call is to take, in their order; they differ by one at most."""
        workers = len(self._kept)
        return even_sizes(items, min(workers * _TASKS_PER_WORKER, max(workers, items // _LEAST_ITEMS)))

    def map(self, *arguments: Iterable) -> list:
        """What the function returns for each set of arguments, in their order.

        Raises
        ------
        WorkerError
            When the scheduler has gone, or workers that nobody replaces.
        """
        return list(self.each(*arguments))

    def each(self, *arguments: Iterable) -> Iterator:
        """As `map`, one after another as soon as it is known; all calls are under way at once."""
        tasks = [pickle.dumps(given) for given in zip(*arguments, strict=True)]
        calls = dict.fromkeys(range(len(tasks)))
        try:
            for number in range(len(tasks)):
                while not (found := self._found(calls[number])):
                    self._begin(tasks, calls)
                del calls[number]
                yield found[0]
        finally:
            with suppress(Exception):
                self._client.cancel([call.future for call in calls.values()])

    def close(self) -> None:
        """Leave the cluster, which drops what is ours there."""
        if self._client is not None:
            with suppress(Exception):  # it has gone before us
                self._client.close(timeout=_ANSWER_S)
        for name, level in self._levels.items():
            logging.getLogger(name).setLevel(level)

    def _connected(self):
        """A client; asked for its name first, as a client waits for ever for what takes calls and says nothing."""
        how = {"timeout": _ANSWER_S, "set_as_default": False, "name": "blender_lidar"}
        try:
            with ThreadPoolExecutor(1) as thread, warnings.catch_warnings():  # some callers run an event loop here
                if (kind := thread.submit(asyncio.run, self._kind()).result()) != "Scheduler":
                    raise ValueError(f"there is a {kind}")
                warnings.simplefilter("ignore")  # `_check_alike` says which versions differ
                for _ in range(_TRIES - 1):
                    with suppress(AssertionError):  # dask's greeting may come together with news of a worker
                        return self._distributed.Client(self.address, **how)
                return self._distributed.Client(self.address, **how)
        except Exception as error:  # something else may listen there
            raise WorkerError(
                f"{self.address}: no dask scheduler answers there within {_ANSWER_S:g} s; start one with "
                "`dask scheduler`, or leave --cluster out"
            ) from error

    async def _kind(self) -> str:
        how = self._distributed.Security().get_connection_args("client")
        async with asyncio.timeout(_ANSWER_S), self._distributed.rpc(self.address, connection_args=how) as there:
            return (await there.identity())["type"]

    def _hand_out(self) -> list[str]:
        """Addresses of the workers, of which the new ones are checked and given the function; waits a while for one."""
        try:
            if self._client.status != "running":  # it would go on trying
                raise ConnectionError(self._client.status)
            with suppress(TimeoutError):
                self._client.wait_for_workers(1, timeout=_NOBODY_S)
            present = list(self._client.nthreads())
            kept = {worker: one for worker, one in self._kept.items() if one.status not in _LOST}
            new = [worker for worker in present if worker not in kept]
            asked = pickle.loads, pickle.dumps(_Described())  # so that one without our library can say so
            there = self._client.run(*asked, workers=new, on_error="return") if new else {}
        except Exception as error:
            raise WorkerError(f"{self.address}: the dask scheduler there has gone, or no longer answers") from error
        if not present:
            raise WorkerError(
                f"{self.address}: the dask scheduler there has no workers; start some with `dask worker "
                f"{self.address} --nthreads 1`"
            )
        _check_alike(there, self.address)
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", "Sending large graph")
            kept |= {worker: self._submit(pickle.loads, worker, self._content) for worker in new}
        self._kept = {worker: kept[worker] for worker in present}
        return present

    def _begin(self, tasks: list[bytes], calls: dict[int, _Call | None]) -> None:
        """Begin those calls that have not begun or are lost: dask waits for ever for a worker that was the last one."""
        workers = self._hand_out()
        for number, call in calls.items():
            if call is None or call.future.status in _LOST or call.worker not in workers:
                worker = workers[number % len(workers)]
                future = self._submit(operator.call, worker, self._kept[worker], tasks[number])
                calls[number] = _Call(worker, future)

    def _submit(self, function: Callable, worker: str, *given: object):
        """Begin a task that is done at a worker, if there is time for it there."""
        return self._client.submit(function, *given, workers=[worker], allow_other_workers=True, pure=False)

    def _found(self, call: _Call | None) -> tuple:
        """What a call has returned, alone in a tuple; () where it is not there in time or was cancelled meanwhile."""
        if call is None:
            return ()
        with suppress(TimeoutError, CancelledError):
            call.future.exception(timeout=_LOOK_ROUND_S)
        if call.future.status == "error":
            self._fail(call.future.exception())
        with suppress(CancelledError):
            if call.future.status == "finished":
                return (call.future.result(),)
        return ()

    def _fail(self, error: BaseException) -> None:
        """Raise what a call has raised, in one line where the worker is to blame."""
        if isinstance(error, ImportError):
            raise WorkerError(f"{self.address}: a worker cannot do its task: {error}") from error
        if isinstance(error, self._distributed.KilledWorker):
            text = "workers died one after another over the same mountings, perhaps because memory ran out"
            raise WorkerError(f"{self.address}: {text}") from error
        raise error


class _Call(NamedTuple):
    """A call that has begun: the worker that it was given to, and dask's future."""

    worker: str
    future: object


def _check_alike(descriptions: dict[str, object], address: str) -> None:
    """Refuse workers with another blender_lidar, whose answers may differ; name other libraries that do."""
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
        unlike |= theirs.items() - ours.items()
    if unlike:
        which = ", ".join(f"{name} {there} there, {ours[name]} here" for name, there in sorted(unlike))
        warnings.warn(f"{address}: versions differ, and so may the last digits: {which}", stacklevel=4)


# --- in a worker ------------------------------------------------------------------------------------------------------

_one_at_a_time = threading.Lock()


@cache
def _description() -> dict[str, str]:
    """Versions of what runs here; that of blender_lidar is followed by a digest of its source."""
    found = {"blender_lidar": f"{__version__} ({source_digest()})", "python": python_version()}
    for library in _LIBRARIES:
        try:
            found[library] = version(library)
        except PackageNotFoundError:
            found[library] = "none"
    return found


class _Described:
    """What becomes, where it is unpickled, the description of that process."""

    def __reduce__(self):
        return _description, ()


class _Held:
    """A function that a worker keeps, with the bytes that it came as, by which dask may move it to another one."""

    def __init__(self, content: bytes) -> None:
        self._content, self._function = content, pickle.loads(content)

    def __call__(self, task: bytes) -> object:
        with _one_at_a_time:
            return self._function(*pickle.loads(task))

    def __reduce__(self):
        return _Held, (self._content,)

    def __sizeof__(self) -> int:
        """What dask takes it to cost to move it."""
        return len(self._content)
