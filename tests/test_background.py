"""An optimisation in a process of its own: what it gets, what it says, and when it ends."""

from __future__ import annotations

import json
import pickle
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from blender_lidar.casting import is_available
from blender_lidar.cli import main as command_line
from blender_lidar.commands.background import heard, tell
from blender_lidar.compiled import numba_works
from blender_lidar.scene.scenario import load_scenario
from blender_lidar.world.scenery import box
from tests.small_scene import REGION, without_times, write_scene
from tests.waiting import WAIT_S, wait_for

ROOT = Path(__file__).parents[1]
pytestmark = pytest.mark.skipif(not is_available("embree"), reason="Embree, of the extra fast, is not installed")


@pytest.fixture
def begin(tmp_path):
    """Starts one with changed settings of a small scene, as the window does; its process, run folder and lines."""
    started = []

    def made(scenery=None, **changes):
        scene = write_scene(tmp_path / "scene", REGION | {"model": {"caster": "embree", "workers": 1}} | changes)
        scenario = replace(load_scenario(scene), where=None)
        labels = {("baseline", "x_m, y_m"): "LiDAR panel: Baseline"}
        order, message, run = tmp_path / "order", tmp_path / "message", tmp_path / "run"
        order.write_bytes(pickle.dumps({"scenario": scenario, "labels": labels, "scenery": scenery, "bodies": None}))
        code = "import sys; sys.modules['matplotlib'] = None  # charts take longer than all else\n"
        code += (
            f"from blender_lidar.commands.background import main; raise SystemExit(main({str(order)!r}, {str(run)!r}))"
        )
        with message.open("wb") as stream:
            command = [sys.executable, "-c", code]
            started.append(subprocess.Popen(command, cwd=ROOT, stdin=subprocess.PIPE, stdout=stream, stderr=stream))
        return (
            started[-1],
            run,
            lambda: [values for line in message.read_text().splitlines() if (values := heard(line))],
        )

    yield made
    for process in started:
        process.kill()
        process.communicate()


def test_it_comes_to_what_the_command_line_does_and_tells_how_far_it_is(begin, quick, tmp_path):
    process, run, message = begin()
    assert process.wait(WAIT_S) == 0, message()
    assert command_line(["optimise", str(tmp_path / "scene" / "scene.toml"), "--out", str(tmp_path / "line")]) == 0
    one, other = (json.loads((folder / "result.json").read_text()) for folder in (run, tmp_path / "line"))
    assert without_times(one)["deployment"] == without_times(other)["deployment"]
    assert one["objective"] == other["objective"]
    done = [line["done"] for line in message()]
    assert done == sorted(done)
    assert done[-1] >= one["evaluations"]
    assert message()[-1]["best"] == one["objective"]


def test_a_window_hears_messages_and_nothing_else_that_is_printed(capsys):
    tell("progress", done=3, best=1.5)
    tell("progress", done=3, best=None)
    tell("problem", problem="no")
    messages = [heard(line) for line in capsys.readouterr().out.splitlines()]
    assert messages == [{"done": 3, "best": 1.5}, {"done": 3, "best": None}, {"problem": "no"}]
    lines = (
        "Read blend",
        "{",
        "3",
        "null",
        '["done"]',
        '{"done": 3, "best": 1.0}',
        '{"folder": "/", "_process": null}',
    )
    marked = (
        {"blender_lidar": "progress", "done": 3},
        {"blender_lidar": "progress", "done": "3", "best": 1.0},
        {"blender_lidar": "progress", "done": 3, "best": 1.0, "folder": "/"},
        {"blender_lidar": "result", "result": {}},
        {"blender_lidar": ["progress"]},
    )
    assert not any(map(heard, (*lines, *map(json.dumps, marked))))


def test_what_is_given_besides_hides_vehicles(begin):
    process, run, message = begin(box("wall", (0.0, 1.5, 3.0), (200.0, 0.2, 6.0), 0.0))
    assert process.wait(WAIT_S) == 0, message()
    assert json.loads((run / "result.json").read_text())["detectable_share"] == 0.0


def test_what_is_wrong_is_one_line_in_the_words_of_who_asked(begin):
    process, run, message = begin(baseline={"y_m": 8.0, "height_m": 1.0})
    assert process.wait(WAIT_S) == 1
    (line,) = message()
    assert line["problem"].startswith("LiDAR panel: Baseline: ")
    assert not run.exists()


def test_it_ends_with_the_one_who_started_it(begin):
    process, run, _ = begin(search={"iterations": 100_000})
    wait_for((run / "checkpoint.json").exists)
    assert process.poll() is None
    process.stdin.close()
    assert process.wait(10.0) == 1


@pytest.mark.skipif(not numba_works(), reason="Numba, of the extra fast, is not installed")
def test_what_the_first_scan_needs_is_compiled():
    code = """
from blender_lidar.commands.background import warm_up
warm_up()
from blender_lidar.casting.rasterise import rasterise
from blender_lidar.metrics.compiled_marks import mark_points
assert rasterise.signatures and mark_points.signatures
"""
    subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=True)
