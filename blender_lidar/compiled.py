"""Functions compiled by Numba, kept on disk from one process to the next where there is a place for that."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from functools import cache
from pathlib import Path

from numba import njit

_SETTINGS = {"nogil": True, "error_model": "numpy"}  # a division by zero gives inf, as in NumPy


def compiled(function: Callable, **settings: bool) -> Callable:
    """The function, compiled when it is first called."""
    try:
        made = njit(cache=True, **_SETTINGS, **settings)(function)
        kept = made._cache._cache_file
        kept._source_stamp = _stamp()
        _drop_unreadable(kept)
    except (AttributeError, OSError, RuntimeError):  # nowhere to keep it, or Numba keeps it in another way
        return njit(**_SETTINGS, **settings)(function)
    return made


def inlined(function: Callable) -> Callable:
    """The same, put in place of every call from compiled code.

    Of numbers alone wherever calls are many: each array that is handed on has its references counted.
    """
    return compiled(function, forceinline=True)


@cache
def _stamp() -> str:
    """Tells whether compiled code of any module has changed: Numba itself looks at a function's own file alone."""
    digest = hashlib.sha256()
    for path in sorted(Path(__file__).parent.rglob("*.py")):
        content = path.read_bytes()
        if b"compiled import" in content or path == Path(__file__):
            digest.update(content)
    return digest.hexdigest()


def _drop_unreadable(kept) -> None:
    """Remove a stored index that names what has moved to another module: Numba would fail when it reads it."""
    try:
        kept._load_index()
    except Exception:  # whatever unpickling raises
        Path(kept._index_path).unlink(missing_ok=True)
