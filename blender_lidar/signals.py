"""How a process is asked to stop: Ctrl-C, SIGTERM of a batch system, SIGHUP of a terminal that closes.

Each becomes a KeyboardInterrupt, so that what is at work tidies up on its way out, and does so undisturbed.
"""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from types import FrameType

STOPS = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))
_TIDYING_S = 2.0
_POSTPONED_S = 0.01


@contextmanager
def stops_watched() -> Iterator[None]:
    """While it lasts, let every signal that means stop, unless it is ignored as under nohup, raise KeyboardInterrupt.

    It does so once. Another one within two seconds changes nothing: schedulers send several, and impatience is no
    reason to leave things lying about. A later one ends the process at once, as if it were killed. For a whole process:
    what comes after it, while Python ends, changes nothing.
    """
    stopped_at: list[float] = []

    def stop(number, frame):
        if _is_called_by_llvm(frame):
            # to the process: a signal of another thread alone does not wake this one where it waits
            wake = (os.kill, (os.getpid(), number)) if os.name == "posix" else (signal.raise_signal, (number,))
            again = threading.Timer(_POSTPONED_S, *wake)
            again.daemon = True
            again.start()
        elif not stopped_at:
            stopped_at.append(time.monotonic())
            raise KeyboardInterrupt
        elif time.monotonic() - stopped_at[0] > _TIDYING_S:
            signal.signal(number, signal.SIG_DFL)
            os.kill(os.getpid(), number)

    watched = [n for n in STOPS if signal.getsignal(n) in (signal.SIG_DFL, signal.default_int_handler)]
    for number in watched:
        signal.signal(number, stop)
    try:
        yield
    finally:
        for number in watched:
            signal.signal(number, signal.SIG_IGN)


def _is_called_by_llvm(frame: FrameType | None) -> bool:
    """Whether Python code is at work that Numba's compiler calls back: what that raises is printed and lost."""
    while frame is not None and not frame.f_globals.get("__name__", "").startswith("llvmlite."):
        frame = frame.f_back
    return frame is not None


@contextmanager
def _stops_handled(handler) -> Iterator[None]:
    """Let `handler` have the stops that some function has now; in the main thread, as they interrupt no other."""
    main = threading.current_thread() is threading.main_thread()
    ours = {number: function for number in STOPS if main and callable(function := signal.getsignal(number))}
    for number in ours:
        signal.signal(number, handler)
    try:
        yield
    finally:
        for number, function in ours.items():
            signal.signal(number, function)


@contextmanager
def stops_deferred() -> Iterator[None]:
    """Let a stop wait until the block ends, so that nothing is left half done."""
    held = []
    try:
        with _stops_handled(lambda number, frame: held.append(number)):
            yield
    finally:
        if held:
            signal.raise_signal(held[0])


def stops_end_at_once() -> AbstractContextManager[None]:
    """While it lasts, a stop ends the process at once: for code that would swallow it, or be deaf to it, and go on."""
    return _stops_handled(signal.SIG_DFL)


@contextmanager
def stops_recognised() -> Iterator[None]:
    """Let a stop that met compiled code be one again: Numba goes on, and Python makes a SystemError of both."""
    try:
        yield
    except SystemError as error:
        cause = error.__cause__
        while isinstance(cause, SystemError):
            cause = cause.__cause__
        if isinstance(cause, KeyboardInterrupt):
            raise cause from None
        raise
