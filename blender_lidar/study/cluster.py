"""A cluster of dask.distributed: reached by the address of its scheduler, used through an executor, never ended.

Nobody else imports that library, which the extra `cluster` brings; here it is imported when it is needed.
"""

from __future__ import annotations

import asyncio
import logging
import pickle
import threading
import time
import warnings
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import CancelledError, Executor
from contextlib import contextmanager, suppress
from itertools import takewhile
from typing import NamedTuple

from ..errors import MissingExtraError, WorkerError
from ..stop_signals import stops_deferred

_ANSWER_S = 10.0  # a scheduler that is there answers in milliseconds, unless it is very busy
_FIRST_WORKER_S = 10.0
_LOOK_ROUND_S = 2.0
_LOOK_AGAIN_S = 0.1
_HAND_OUT_S = 30.0  # after which workers that hold the function begin without the others
_MOST_CANCELLED = 20  # calls that are begun anew in one batch
_GRACE_S = 5.0  # beyond that, before a question that has no end is given up
_NOBODY_S = 30.0  # what a worker that died may take to be started anew
_LOGGERS = ("distributed", "distributed.client", "distributed.worker", "tornado.application")


class ClusterExecutor(Executor):
    """Carries out calls on the workers of a cluster, by `map` alone.

    Parameters
    ----------
    address : str
        The scheduler's: ``tcp://host:8786``.

    Raises
    ------
    MissingExtraError
        Without dask.distributed.
    WorkerError
        When no scheduler answers there, or it has no workers.
    """

    def __init__(self, address: str) -> None:
        self.address = address
        self._distributed = _library()
        self._levels = {name: logging.getLogger(name).level for name in _LOGGERS}
        for name in _LOGGERS:  # its failures are ours to tell, in one line
            logging.getLogger(name).setLevel(logging.CRITICAL + 1)
        self._client, self._pause_told = None, False
        try:
            self._client = self._connected()
            self._workers: list[str] = []
            self.await_workers(_FIRST_WORKER_S)
        except BaseException:
            self.shutdown()
            raise

    def _connected(self):
        """Asked for its name first, as a client waits for ever for what takes calls and says nothing."""
        found: list = []
        thread = threading.Thread(target=self._ask, args=[found], daemon=True)  # some callers run an event loop here
        thread.start()
        thread.join(_ANSWER_S + _GRACE_S)
        found = found or [TimeoutError("no answer")]  # a name that nobody resolves has no end of its own
        if not isinstance(found[0], Exception):
            how = {"timeout": _ANSWER_S, "set_as_default": False, "name": "blender_lidar"}
            try:
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore")  # versions that differ are told by who knows which of them matter
                    return self._distributed.Client(self.address, **how)
            except Exception as error:  # it has gone meanwhile
                found = [error]
        raise WorkerError(
            f"{self.address}: no dask scheduler answers there within {_ANSWER_S:g} s; start one with `dask scheduler`, "
            "or leave --cluster out"
        ) from found[0]

    def _ask(self, found: list) -> None:
        try:
            told = asyncio.run(self._told())
            found.append(told if told["type"] == "Scheduler" else ValueError(f"there is a {told['type']}"))
        except Exception as error:  # whatever else may listen there
            found.append(error)

    async def _told(self) -> dict[str, object]:
        how = self._distributed.Security().get_connection_args("client")
        async with asyncio.timeout(_ANSWER_S), self._distributed.rpc(self.address, connection_args=how) as there:
            return await there.identity()

    def await_workers(self, at_most_s: float | None = None) -> list[str]:
        """`workers`, of which there is at least one; waits for that, as one that died may be started anew.

        For those that are paused, all of them, it waits as long as that takes.
        """
        end = time.monotonic() + (_NOBODY_S if at_most_s is None else at_most_s)
        while not (present := self.workers):
            if self._threads():
                self._tell_of_pause()
                end = max(end, time.monotonic() + _NOBODY_S)  # one that dies of it may be started anew
            elif time.monotonic() >= end:
                raise self._no_workers()
            time.sleep(_LOOK_AGAIN_S)
        return present

    @property
    def workers(self) -> list[str]:
        """Addresses of the worker processes, of which a call goes to each in turn: the known ones first, as before.

        Those that are paused, as dask does for want of memory, take no call and are left out meanwhile.
        """
        with self._scheduler_needed():
            present = self._client.sync(self._client.scheduler.ncores_running, workers=None)
        known = [worker for worker in self._workers if worker in present]
        self._workers = known + [worker for worker in present if worker not in known]
        return self._workers

    @property
    def most_threads(self) -> int:
        """Threads of the worker process that has most."""
        return max(self._threads().values(), default=1)

    def map(self, function: Callable, *iterables: Iterable, timeout: float | None = None, chunksize: int = 1):
        """Results in order; the n-th call goes to the same worker each time, while it is there and has time for it."""
        tasks = [_packed(function, given) for given in zip(*iterables, strict=False)]
        workers = self.await_workers()
        calls: list[_Placed] = [None] * len(tasks)
        for number, worker in enumerate(workers[: len(tasks)]):
            mine = slice(number, None, len(workers))
            calls[mine] = self._placed(tasks[mine], worker)
        return self._results(calls)

    def run(self, function: Callable, workers: list[str] | None = None) -> dict[str, object]:
        """What a function returns on these workers, or all, or the error that it raises; they may be busy meanwhile."""
        with self._scheduler_needed():
            return self._client.run(pickle.loads, _packed(function, ()), workers=workers, on_error="return")

    def keep(self, function: Callable, argument: object, workers: Iterable[str]) -> dict[str, object]:
        """Call a function on each of these workers, which keep what it returns; by worker.

        They do so until what is returned here is dropped, or this process ends. The argument goes to one of them, and
        from there to the others. Workers that are lost meanwhile are left out, and those that others have to wait for.
        """
        with self._scheduler_needed():
            sent = self._client.scatter(_packed(function, (argument,)), hash=False, timeout=_NOBODY_S)
        kept = {one: self._client.submit(pickle.loads, sent, workers=[one], pure=False) for one in workers}
        patience = time.monotonic() + _HAND_OUT_S  # with workers that are paused or busy with something else
        for worker, call in kept.items():
            while not self._has_ended(call) and worker in self.workers:
                if time.monotonic() > patience and any(one.status == "finished" for one in kept.values()):
                    break
            if call.status == "error":
                self._check(call)
        return {worker: call for worker, call in kept.items() if call.status == "finished"}

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Leave the cluster, which drops what is ours there and lives on."""
        client, self._client = self._client, None
        if client is not None:
            with suppress(Exception):  # it has gone before us
                client.close(timeout=_ANSWER_S)
        for name, level in self._levels.items():
            logging.getLogger(name).setLevel(level)

    def _placed(self, tasks: list[bytes], worker: str) -> list[_Placed]:
        """Begin calls, on a certain worker if it has time for them."""
        where = {"workers": [worker], "allow_other_workers": True, "pure": False}
        calls = self._client.map(pickle.loads, tasks, **where)
        return [_Placed(task, worker, call) for task, call in zip(tasks, calls, strict=True)]

    def _results(self, placed: list[_Placed]) -> Iterator:
        begun_anew = 0
        try:
            while placed:
                while not self._has_ended(placed[0].call):
                    self._see_to(placed)
                if placed[0].call.status in ("cancelled", "lost"):  # the cluster was restarted
                    begun_anew += 1
                    if begun_anew > _MOST_CANCELLED:
                        raise WorkerError(f"{self.address}: calls are cancelled there again and again")
                    placed[:1] = self._placed([placed[0].task], self.await_workers()[0])
                    continue
                self._check(placed[0].call)
                done = [one.call for one in takewhile(lambda one: one.call.status == "finished", placed)]
                with self._scheduler_needed():
                    found = self._client.gather(done)
                del placed[: len(done)]
                yield from found
        finally:
            with suppress(Exception):
                self._client.cancel([one.call for one in placed])

    def _see_to(self, placed: list[_Placed]) -> None:
        """Begin anew what was begun on workers that are lost: dask forgets it if they were the last ones."""
        present = self.await_workers()
        for number, one in enumerate(placed):
            if one.worker not in present and one.call.status != "finished":
                placed[number : number + 1] = self._placed([one.task], present[number % len(present)])

    def _has_ended(self, call) -> bool:
        """Whether a call has ended, well or not; waits a moment for that."""
        try:
            call.exception(timeout=_LOOK_ROUND_S)
            return True
        except TimeoutError:
            return False

    def _check(self, call) -> None:
        """Raise what a call raised that has ended."""
        error = call.exception()
        if error is not None:
            with self._failures_told():
                raise error

    @contextmanager
    def _failures_told(self) -> Iterator[None]:
        try:
            yield
        except self._distributed.KilledWorker as error:
            raise WorkerError(
                f"{self.address}: workers died one after another over the same mountings, perhaps for want of memory"
            ) from error
        except CancelledError as error:
            raise self._no_scheduler() from error

    @contextmanager
    def _scheduler_needed(self) -> Iterator[None]:
        try:
            yield
        except Exception as error:
            raise self._no_scheduler() from error

    def _threads(self) -> dict[str, int]:
        """Of each worker process, paused or not."""
        with self._scheduler_needed():
            return self._client.nthreads()

    def _tell_of_pause(self) -> None:
        if not self._pause_told:
            self._pause_told = True
            warnings.warn(
                f"{self.address}: all workers there are paused, perhaps for want of memory; waiting for one",
                stacklevel=2,
            )

    def _no_workers(self) -> WorkerError:
        return WorkerError(
            f"{self.address}: the dask scheduler there has no workers; start some with `dask worker {self.address} "
            "--nthreads 1`"
        )

    def _no_scheduler(self) -> WorkerError:
        return WorkerError(f"{self.address}: the dask scheduler there has gone, or no longer answers")


class _Placed(NamedTuple):
    """A call that has begun: what was packed, the worker whom it was given to, and dask's future."""

    task: bytes
    worker: str
    call: object


class _Call:
    """What becomes, where it is unpickled, the result of a call."""

    def __init__(self, function: Callable, arguments: tuple) -> None:
        self._parts = function, arguments

    def __reduce__(self):
        return self._parts


def _packed(function: Callable, arguments: tuple) -> bytes:
    """A call for `pickle.loads` to carry out: so the scheduler, which looks at tasks, needs nothing but dask."""
    return pickle.dumps(_Call(function, arguments), pickle.HIGHEST_PROTOCOL)


def worker_address() -> str:
    """Of the worker that calls this."""
    return _library().get_worker().address


def _library():
    try:
        with stops_deferred():  # an import that is interrupted may fail in any way
            import distributed
    except ImportError as error:
        raise MissingExtraError('--cluster needs dask.distributed: pip install "blender_lidar[cluster]"') from error
    return distributed
