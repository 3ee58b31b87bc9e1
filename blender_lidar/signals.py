"""How a process is told to stop: Ctrl-C, SIGTERM of a batch system, SIGHUP of a terminal that closes.

Each becomes a KeyboardInterrupt, so that what is at work tidies up on its way out, and does so undisturbed.
"""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

STOPS = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))
_TIDYING_S = 2.0


@contextmanager
def stops_watched() -> Iterator[None]:
    """While it lasts, let every signal that means stop, unless it is ignored as under nohup, raise KeyboardInterrupt.

    It does so once. Another one within two seconds changes nothing: schedulers send several, and impatience is no
    reason to leave things lying about. A later one ends the process at once, as if it were killed. For a whole process:
    what comes after it, while Python ends, changes nothing.
    """
    stopped_at: list[float] = []

    def stop(number, frame):
        if not stopped_at:
            stopped_at.append(time.monotonic())
            raise KeyboardInterrupt
        if time.monotonic() - stopped_at[0] > _TIDYING_S:
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


@contextmanager
def stops_deferred() -> Iterator[None]:
    """Let a stop wait until the block ends, lest it leaves something half done."""
    handlers, held = {number: signal.getsignal(number) for number in STOPS}, []
    ours = {number: handler for number, handler in handlers.items() if callable(handler)}
    if threading.current_thread() is not threading.main_thread():
        yield  # signals do not interrupt us
        return
    for number in ours:
        signal.signal(number, lambda number, frame: held.append(number))
    try:
        yield
    finally:
        for number, handler in ours.items():
            signal.signal(number, handler)
        if held:
            signal.raise_signal(held[0])


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


@contextmanager
def stops_end_at_once() -> Iterator[None]:
    """While it lasts, a stop ends the process at once: for code that would swallow it, or be deaf to it, and go on."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {number: signal.getsignal(number) for number in STOPS}
    for number, handler in before.items():
        if callable(handler):
            signal.signal(number, signal.SIG_DFL)
    try:
        yield
    finally:
        for number, handler in before.items():
            if callable(handler):
                signal.signal(number, handler)
