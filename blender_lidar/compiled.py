"""Numba: whether it works here, within Blender too, and functions compiled by it that are kept on disk."""

from __future__ import annotations

import hashlib
import multiprocessing  # here first of all: Numba, too, imports it
import sys
import warnings
from collections.abc import Callable
from contextlib import suppress
from functools import cache, partial
from pathlib import Path

_SETTINGS = {"nogil": True, "error_model": "numpy"}  # a division by zero gives inf, as in NumPy


def within_blender() -> bool:
    """Whether this process is a real Blender: it cannot start Python processes that have bpy too."""
    bpy = sys.modules.get("bpy")
    return bpy is not None and not getattr(bpy.app, "module", not bpy.app.binary_path)  # 4.2 does not say


if within_blender():
    # A second name for the main module: Blender frees that before it looks through all modules at its end, and crashed.
    sys.modules.pop("__mp_main__", None)


@cache
def numba_works() -> bool:
    """Whether Numba can be imported: it refuses where NumPy is newer than it knows, and libraries may be missing."""
    try:
        import numba  # noqa: F401
    except Exception:  # a broken library may raise anything
        return False
    return True


def compiled(function: Callable, **settings: bool) -> Callable:
    """The function, compiled when it is first called, and kept on disk until any source file of the package changes.

    Numba itself looks at a function's own file alone, and not at what it calls nor at the types of its arguments.
    """
    from numba import njit

    from .files import source_digest  # not where metrics are imported without Numba

    try:
        made = njit(cache=True, **_SETTINGS, **settings)(function)
        kept = made._cache._cache_file
        kept._source_stamp = source_digest()
        kept.save = partial(_save, kept)
        _drop_unreadable(kept)
    except (AttributeError, OSError, RuntimeError):  # no place, or Numba keeps it in another way
        _warn_once()
        return njit(**_SETTINGS, **settings)(function)
    return made


def inlined(function: Callable) -> Callable:
    """The same, put in place of every call from compiled code.

    Of numbers alone wherever calls are many: each array that is handed on has its references counted.
    """
    return compiled(function, forceinline=True)


@cache
def _warn_once() -> None:
    """Warn that nothing can be kept, and not again in the processes that this one starts."""
    if multiprocessing.parent_process() is None:
        text = (
            f"compiled code cannot be kept in {Path(__file__).parent} nor in the user's folder for caches, and is "
            "compiled again at every start, for half a minute; set NUMBA_CACHE_DIR to another folder"
        )
        warnings.warn(text, stacklevel=2)


def _save(kept, key, data) -> None:
    """Keep what was compiled for the types `key` in a file that is named by them.

    Numba itself numbers the files: of two processes that compile at the same time both take the same number, and later
    ones get the code of one type for another, and wrong results. On a full disk nothing is kept.
    """
    base = kept._index_name.removesuffix(".nbi")
    name = f"{base}-{hashlib.sha256(repr((kept._source_stamp, key)).encode()).hexdigest()[:16]}.nbc"
    with suppress(OSError):
        found = kept._load_index()
        if not found:
            for old in Path(kept._cache_path).glob(f"{base}[-.]*.nbc"):  # of other sources
                old.unlink(missing_ok=True)
        kept._save_data(name, data)
        kept._save_index(found | {key: name})


def _drop_unreadable(kept) -> None:
    """Remove a stored index that names what has moved to another module: Numba would fail when it reads it."""
    try:
        kept._load_index()
    except Exception:  # unpickling may raise anything
        Path(kept._index_path).unlink(missing_ok=True)
