"""Whether Numba is installed and works: what it compiles has a twin in NumPy, or is one caster of several."""

from __future__ import annotations

from functools import cache


@cache
def numba_works() -> bool:
    """Whether it can be imported: it refuses where NumPy is newer than it knows, and libraries may be missing."""
    try:
        import numba  # noqa: F401
    except Exception:  # whatever a broken library raises
        return False
    return True
