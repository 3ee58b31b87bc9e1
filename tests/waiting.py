"""Waiting for another process, however busy the machine is: for what it does, never for a time."""

from __future__ import annotations

import time
from collections.abc import Callable

WAIT_S = 300.0  # for what takes seconds on an idle machine; ends only what hangs


def wait_for(condition: Callable[[], object], what: str = "") -> None:
    """Until a condition holds."""
    end = time.monotonic() + WAIT_S
    while not condition():
        assert time.monotonic() < end, f"waited in vain {what}"
        time.sleep(0.01)
