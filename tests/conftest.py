"""How many processes share the tests, where pytest-xdist is asked for as many as are good: `-n auto`."""

from __future__ import annotations

import os

import pytest

_MOST = 4  # each may hold a Blender, and its tests start processes of their own


@pytest.hookimpl(optionalhook=True)  # of pytest-xdist
def pytest_xdist_auto_num_workers() -> int:
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return min(cores, _MOST)
