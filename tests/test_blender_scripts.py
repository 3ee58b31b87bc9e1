"""The scripts for `blender --background`, in a real Blender where there is one, and in the bpy module."""

from __future__ import annotations

import importlib.util
import json
import os
import shutil
import subprocess
import sys
import venv
from pathlib import Path

import numpy as np
import pytest

from blender_lidar.casting import is_available
from tests.small_scene import without_times, write_scene
from tests.waiting import WAIT_S

pytestmark = [pytest.mark.session, pytest.mark.versions]

SCRIPTS = Path(__file__).parents[1] / "scripts"
BLENDER = shutil.which("blender")
PROGRAMS = [
    pytest.param(
        [BLENDER, "--background", "--factory-startup", "--python-exit-code", "1", "--python", "SCRIPT", "--"],
        id="Blender",
        marks=pytest.mark.skipif(BLENDER is None, reason="no Blender on this machine"),
    ),
    pytest.param(
        [sys.executable, "SCRIPT"],
        id="bpy",
        marks=pytest.mark.skipif(not is_available("bvh"), reason="the module bpy is not installed"),
    ),
]
BVH = {"model": {"caster": "bvh"}}


def run(program, script, *words, folder):
    """Run a script with arguments: exit code, standard output, standard error."""
    start = [str(SCRIPTS / script) if word == "SCRIPT" else word for word in program]
    # As users run them: into a pipe, what is printed waits for the end, and a crash there loses it.
    settings = {name: value for name, value in os.environ.items() if name != "PYTHONUNBUFFERED"}
    settings |= {"BLENDER_USER_RESOURCES": str(folder), "PYTHONDONTWRITEBYTECODE": "1"}
    done = subprocess.run(
        [*start, *map(str, words)],
        capture_output=True,
        text=True,
        timeout=WAIT_S,
        check=False,
        env=settings,
        cwd=folder,
    )
    return done.returncode, done.stdout, done.stderr


def test_there_is_something_to_run_them_with():
    if BLENDER is None and not is_available("bvh"):
        pytest.skip("neither a Blender nor bpy is installed")
    verbs = [path.name for path in SCRIPTS.glob("*.py") if "from blender_lidar.cli import main" in path.read_text()]
    assert sorted(verbs) == ["build_scene.py", "optimise.py", "scan.py"]


@pytest.mark.parametrize("program", PROGRAMS)
def test_a_scan_is_written_and_a_missing_scene_is_one_line(program, tmp_path):
    scene, out = write_scene(tmp_path, BVH), tmp_path / "cloud.npz"
    code, said, err = run(
        program, "scan.py", scene, "--frame", 20, "--height", 4, "--tilt-x", 15, "--out", out, folder=tmp_path
    )
    assert code == 0, err
    assert "(RS-16, bvh)" in said
    with np.load(out) as cloud:
        assert (cloud["vehicle_id"] >= 0).sum() > 50
        header = json.loads(str(cloud["header"]))
        assert header["pose"]["tilt_x_deg"] == 15.0
        assert header["versions"]["bpy"]
    code, said, err = run(program, "scan.py", "none.toml", "--frame", 1, "--out", out, folder=tmp_path)
    assert code == 2
    assert "blender-lidar: none.toml: there is no such file" in err
    assert "Traceback" not in said + err


@pytest.mark.skipif(BLENDER is None, reason="no Blender on this machine")
def test_a_blender_that_takes_an_environment_without_numpy_says_what_to_do(tmp_path, monkeypatch):
    """Debian's Blender looks for packages where the first Python of PATH does."""
    environment = tmp_path / "venv"
    venv.create(environment, with_pip=False)
    monkeypatch.setenv("PATH", f"{environment / 'bin'}{os.pathsep}{os.environ['PATH']}")
    monkeypatch.setenv("VIRTUAL_ENV", str(environment))
    monkeypatch.delenv("PYTHONPATH", raising=False)
    code, said, err = run(
        PROGRAMS[0].values[0], "scan.py", "scene.toml", "--frame", 1, "--out", "a.npz", folder=tmp_path
    )
    if "there is no such file" in err:
        pytest.skip("this Blender brings a Python of its own")
    assert code == 2
    message = [line for line in err.splitlines() if line.startswith("blender-lidar: ")]
    assert len(message) == 1
    assert f"no NumPy that works in {environment}" in message[0]
    assert "run deactivate before Blender" in message[0]
    assert "Traceback" not in said + err


@pytest.mark.parametrize("program", PROGRAMS)
def test_a_scene_is_built(program, tmp_path):
    scene, out = write_scene(tmp_path, BVH), tmp_path / "scene.blend"
    code, said, err = run(program, "build_scene.py", scene, "--frame", 20, "--out", out, folder=tmp_path)
    assert code == 0, err
    assert "points" in said
    assert out.stat().st_size > 20_000
    assert "Traceback" not in said + err


@pytest.mark.skipif(BLENDER is None or not is_available("bvh"), reason="needs a Blender and the module bpy")
def test_both_come_to_the_same_mounting(tmp_path):
    results = []
    for number, parameter in enumerate(PROGRAMS):
        (program,) = parameter.values
        folder = tmp_path / str(number)
        scene = write_scene(folder, BVH)
        code, _, err = run(program, "optimise.py", scene, "--out", folder / "run", folder=folder)
        assert code == 0, err
        result = without_times(json.loads((folder / "run" / "result.json").read_text()))
        results.append(result)
    for key in ("objective_per_vehicle", "detectable_share", "evaluations"):
        assert results[0][key] == pytest.approx(results[1][key], rel=2e-3), key  # NumPy 1.24 rounds otherwise
    assert results[0]["frame_ids"] == results[1]["frame_ids"]


EMBREE = """
import importlib.util, sys
if sys.version_info[:2] != {version}:
    print("skipped: embreex is installed for another Python than Blender's")
elif importlib.util.find_spec("numpy") is None:
    print("skipped: Blender's Python has no NumPy")
else:
    sys.path[:0] = {paths}
    flags = sys.getdlopenflags()
    import numpy as np
    from blender_lidar.casting import caster_class
    floor = np.array([[[-9, -9, 0], [9, -9, 0], [9, 9, 0]], [[-9, -9, 0], [9, 9, 0], [-9, 9, 0]]], dtype=float)
    hits = caster_class("embree")(floor).cast(np.array([1.0, 2.0, 3.0]), np.array([[0.0, 0.0, -1.0]]))
    print("distance", hits.distance[0], sys.getdlopenflags() == flags)
"""


@pytest.mark.skipif(BLENDER is None or not is_available("embree"), reason="needs a Blender and embreex")
def test_embree_casts_within_a_blender_that_links_an_embree_of_its_own(tmp_path):
    """Debian's Blender 3.4.1 crashed: embreex called into its Embree 3; and at its end, for `__mp_main__`."""
    place = Path(importlib.util.find_spec("embreex").origin).parents[1]
    for path in place.glob("embreex*"):
        (tmp_path / path.name).symlink_to(path)
    script = tmp_path / "embree.py"
    paths = [str(tmp_path), str(SCRIPTS.parent)]
    script.write_text(EMBREE.format(version=sys.version_info[:2], paths=paths), encoding="utf-8")
    program = [BLENDER, "--background", "--factory-startup", "--python-exit-code", "1", "--python", "SCRIPT"]
    code, printed, errors = run(program, script, folder=tmp_path)
    if "skipped: " in printed:
        pytest.skip(printed.split("skipped: ")[1].splitlines()[0])
    assert code == 0, printed + errors
    assert "distance 3.0 True" in printed, printed + errors
