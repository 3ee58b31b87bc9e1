"""What test files share: stored runs, signals, no deadline of examples, and how many processes `-n auto` starts."""

from __future__ import annotations

import os
import signal
import sys

import pytest
from hypothesis import settings

settings.register_profile("untimed", deadline=None)  # how fast a shared machine is, is no property of the code
settings.load_profile("untimed")

_MOST = 4  # each may hold a Blender, and its tests start processes of their own
# Files that take longest, a quarter of a minute and more; begun first, none of them is at work alone in the end.
_LONGEST = ("blender_addon", "caster_attacks", "cluster", "compiled", "detector_training", "extension", "pairs")

# A signal that is ignored stays ignored in the processes that tests start, and a suite in the background, or under
# nohup, is started so. With a handler that does nothing it goes on ignoring them, and its processes do not.
for _name in ("SIGINT", "SIGTERM", "SIGHUP"):
    if hasattr(signal, _name) and signal.getsignal(getattr(signal, _name)) is signal.SIG_IGN:
        signal.signal(getattr(signal, _name), lambda number, frame: None)


@pytest.hookimpl(optionalhook=True)  # of pytest-xdist
def pytest_xdist_auto_num_workers() -> int:
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return min(cores, _MOST)


def pytest_configure(config: pytest.Config) -> None:
    if hasattr(config.option, "loadscopereorder"):  # of pytest-xdist: the files of the fewest tests would come last
        config.option.loadscopereorder = False


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    items.sort(key=lambda item: item.path.stem.removeprefix("test_") not in _LONGEST)


@pytest.fixture
def quick(monkeypatch, tmp_path):
    """No charts, which take longer than the runs; and the working folder, where runs/ would be made, is the test's."""
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    monkeypatch.chdir(tmp_path)


@pytest.fixture(scope="session")
def stored_runs(tmp_path_factory):
    """Folder of the three runs of `tests.report_samples.make_runs`, made once; a test that changes one copies it."""
    from tests.report_samples import make_runs

    return make_runs(tmp_path_factory.mktemp("runs"))


@pytest.fixture(scope="session")
def site(tmp_path_factory):
    """The small scene whose heights and tilts are searched, made ready."""
    from blender_lidar.scene.scenario import load_scenario
    from blender_lidar.scene.site import prepare
    from tests.small_scene import MAPPED, write_scene

    return prepare(load_scenario(write_scene(tmp_path_factory.mktemp("site"), MAPPED)))


@pytest.fixture
def registered_addon(quick, tmp_path_factory, monkeypatch):
    """The add-on in a new file; the processes that it starts draw no charts."""
    import bpy

    from blender_lidar import addon

    folder = tmp_path_factory.mktemp("no_charts")
    (folder / "matplotlib.py").write_text("raise ImportError('not in this Python')\n")
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(folder), os.environ.get("PYTHONPATH", "")]))
    bpy.ops.wm.read_homefile(use_empty=True)
    addon.register()
    yield
    addon.unregister()
    bpy.ops.wm.read_homefile(use_empty=True)
