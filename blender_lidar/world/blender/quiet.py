"""Blender's chatter kept off standard output, where results are printed, and its errors in one line."""

from __future__ import annotations

import ctypes
import io
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout, suppress


@contextmanager
def quiet() -> Iterator[None]:
    """While it lasts, what is written to standard output, even by C code, goes nowhere."""
    if sys.stdout is not None:
        sys.stdout.flush()
    try:
        kept = os.dup(1)
    except OSError:  # there is none: it was closed before the program began
        yield
        return
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    try:
        with redirect_stdout(io.StringIO()):
            yield
    finally:
        with suppress(OSError, TypeError, AttributeError):  # Windows has no library of that kind
            ctypes.CDLL(None).fflush(None)  # C's own buffers, which Blender prints into
        os.dup2(kept, 1)
        os.close(kept)
        os.close(nowhere)


def first_error(error: RuntimeError) -> str:
    """What an operator of Blender reports, in one line: the first that names an error."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip()] or [type(error).__name__]
    text = next((line for line in lines if "Error" in line), lines[0])
    return text.removeprefix("Error: ").rstrip(":")
