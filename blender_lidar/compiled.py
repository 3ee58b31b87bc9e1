"""Functions compiled by Numba, kept on disk from one process to the next where there is a place for that."""

from __future__ import annotations

from collections.abc import Callable

from numba import njit

_SETTINGS = {"nogil": True, "error_model": "numpy"}  # a division by zero gives inf, as in NumPy


def compiled(function: Callable, **settings: bool) -> Callable:
    """The function, compiled when it is first called."""
    try:
        return njit(cache=True, **_SETTINGS, **settings)(function)
    except RuntimeError:  # neither the package's folder nor the user's can be written
        return njit(**_SETTINGS, **settings)(function)


def inlined(function: Callable) -> Callable:
    """The same, put in place of every call from compiled code.

    Of numbers alone wherever calls are many: each array that is handed on has its references counted.
    """
    return compiled(function, forceinline=True)
