"""The extension's zip: what is in it, and all its buttons in the Blenders that are here."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
import tomllib
import zipfile
from importlib.util import find_spec
from pathlib import Path

import pytest

import blender_lidar

pytestmark = pytest.mark.session

ROOT = Path(__file__).resolve().parents[1]
SESSION = ROOT / "tests" / "extension_session.py"
BLENDER = shutil.which("blender")
RUN_FILES = {"result.json", "scene.toml", "vehicles.csv"}


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    out = tmp_path_factory.mktemp("dist")
    command = [sys.executable, ROOT / "scripts" / "build_extension.py", "--out", out]
    message = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    (path,) = out.iterdir()
    assert message.startswith(f"{path}: ")
    assert find_spec("bpy") is None or "Success parsing TOML" in message
    return path


def test_the_zip_is_small_and_has_one_folder_with_all_of_the_package(made):
    assert made.stat().st_size < 5e6
    with zipfile.ZipFile(made) as packed:
        names = packed.namelist()
        manifest = tomllib.loads(packed.read("blender_lidar/blender_manifest.toml").decode())
    assert {name.split("/")[0] for name in names} == {"blender_lidar"}
    package = {path.relative_to(ROOT).as_posix() for path in (ROOT / "blender_lidar").rglob("*.py")}
    assert package <= set(names)
    assert {"blender_lidar/LICENSE", "blender_lidar/scenes/i80.toml", "blender_lidar/report/report.css"} <= set(names)
    assert "blender_lidar/detection/data/pillars.npz" in names
    assert manifest["version"] == blender_lidar.__version__
    assert ".".join(map(str, blender_lidar.bl_info["version"])) == blender_lidar.__version__


def test_a_blender_with_an_older_python_is_told_so_in_one_line(monkeypatch):
    monkeypatch.setattr(sys, "version_info", (3, 10, 13))
    with pytest.raises(RuntimeError, match=r"^LiDAR: needs Blender 4\.2 or later; this one has Python [^\n]*$"):
        blender_lidar.register()


def session(command, made, tmp_path, **variables):
    """What a session says; it must end by itself, without a word of an error."""
    environment = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
    environment |= {"BLENDER_USER_RESOURCES": str(tmp_path / "blender"), **variables}
    run = subprocess.run(
        [*command, made], capture_output=True, text=True, env=environment, cwd=tmp_path, timeout=300, check=False
    )
    assert run.returncode == 0, run.stdout + run.stderr
    assert not re.search(r"Error|Traceback", run.stdout + run.stderr), run.stdout + run.stderr
    return next(json.loads(line) for line in run.stdout.splitlines() if line.startswith('{"version"'))


def test_it_is_installed_used_and_removed_twice_in_the_bpy_module(made, tmp_path):
    pytest.importorskip("bpy")
    # As in a Blender, whose Python has neither: Numba would compile all that a removal has just deleted.
    for name in ("numba", "matplotlib"):
        (tmp_path / f"{name}.py").write_text("raise ImportError('not in this Python')\n")
    message = session([sys.executable, SESSION], made, tmp_path, PYTHONPATH=str(tmp_path))
    assert message["scanned"][0] == message["scanned"][1]
    assert message["scanned"][0]["points"] > 1000
    assert set(message["used"]["run"]) >= RUN_FILES


@pytest.mark.skipif(BLENDER is None, reason="no Blender is installed")
def test_it_is_installed_used_and_removed_twice_in_a_real_blender(made, tmp_path):
    command = [BLENDER, "--background", "--factory-startup", "--python-exit-code", "1", "--python", SESSION, "--"]
    message = session(command, made, tmp_path, PATH="/usr/bin:/bin")
    assert message["scanned"][0] == message["scanned"][1]
    assert set(message["used"]["run"]) >= RUN_FILES
