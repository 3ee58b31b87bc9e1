"""The add-on in the Blenders that are here: the checks of `addon_checks_*.py`, each in every one of them."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from functools import lru_cache
from pathlib import Path

import pytest

from blender_lidar.casting import is_available
from tests.waiting import WAIT_S

pytestmark = [pytest.mark.session, pytest.mark.versions]

SESSION = Path(__file__).with_name("addon_session.py")
CHECKS = [
    name
    for path in sorted(SESSION.parent.glob("addon_checks_*.py"))
    for name in re.findall(r"^def check_(\w+)", path.read_text(encoding="utf-8"), re.MULTILINE)
]
BLENDER = shutil.which("blender")
PROGRAMS = {
    "Blender": [BLENDER, "--background", "--factory-startup", "--python-exit-code", "1", "--python", SESSION, "--"],
    "bpy": [sys.executable, SESSION],
}


@pytest.fixture(scope="module")
def session(tmp_path_factory):
    """All checks in one process of a Blender, which must end by itself: what is wrong, by check."""

    @lru_cache
    def run(program):
        if BLENDER is None if program == "Blender" else not is_available("bvh"):
            pytest.skip(f"{program} is not installed")
        folder = tmp_path_factory.mktemp(program)
        environment = os.environ | {"BLENDER_USER_RESOURCES": str(folder / "blender"), "PYTHONDONTWRITEBYTECODE": "1"}
        if program == "Blender":  # it has a Python of its own
            environment = {key: value for key, value in environment.items() if key not in ("PYTHONPATH", "VIRTUAL_ENV")}
            environment["PATH"] = "/usr/bin:/bin"
        command = [*PROGRAMS[program], folder / "work"]
        done = subprocess.run(
            command, capture_output=True, text=True, timeout=WAIT_S, check=False, env=environment, cwd=folder
        )
        printed = done.stdout + done.stderr
        assert done.returncode == 0, printed
        assert "Traceback" not in "".join(line for line in printed.splitlines() if not line.startswith('{"checks"'))
        return next(json.loads(line)["checks"] for line in done.stdout.splitlines() if line.startswith('{"checks"'))

    return run


@pytest.mark.skipif(BLENDER is None, reason="no Blender on this machine")
def test_a_blender_with_the_addon_ends_without_a_word_of_it():
    code = (
        f"import sys; sys.path.insert(0, {str(SESSION.parents[1])!r}); import blender_lidar; blender_lidar.register()"
    )
    command = [BLENDER, "--background", "--factory-startup", "--python-exit-code", "1", "--python-expr", code]
    environment = {key: value for key, value in os.environ.items() if key not in ("PYTHONPATH", "VIRTUAL_ENV")}
    environment |= {"PATH": "/usr/bin:/bin", "PYTHONDONTWRITEBYTECODE": "1"}
    done = subprocess.run(command, capture_output=True, text=True, timeout=WAIT_S, check=False, env=environment)
    assert (done.returncode, "Traceback" in done.stdout + done.stderr) == (0, False), done.stdout + done.stderr


@pytest.mark.parametrize("program", PROGRAMS)
@pytest.mark.parametrize("check", CHECKS)
def test_in_a_blender(session, program, check):
    problem = session(program)[check]
    assert not problem, problem
