"""A run that was killed or stopped at any moment goes on to the same result as one that was not."""

from __future__ import annotations

import json
import os
import shutil
import signal
import time
from pathlib import Path

import numpy as np
import pytest

from blender_lidar import __version__
from blender_lidar.cli import main
from tests.refusals import refused
from tests.run_attacks import Attacked, check_nobody_is_left, check_same, check_stopped, check_whole
from tests.small_scene import MAPPED, done, without_charts, without_times, write_scene
from tests.waiting import wait_for

pytestmark = [
    pytest.mark.usefixtures("quick"),
    pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="this system has no SIGKILL"),
]

# One file is written, whole, for each of: the scene, the checkpoint after each of 3 iterations, history, two vehicle
# tables, the installation sheet, the result, the page.
WRITES = 10
ENDLESS = ("--iterations", 100_000)  # a search that does not end before it is stopped

# Runs the command line without charts and stores a checkpoint after every batch. Before that file takes its place whose
# number is argument 1 (0: none), the process sends itself the signal that argument 2 names.
PROGRAM = """
import os, signal, sys
from pathlib import Path

signal.signal(signal.SIGINT, signal.default_int_handler)  # whatever this process was started with
sys.modules["matplotlib"] = None
from blender_lidar.run import replay
replay._STORE_EVERY_S = 0.0
replace, left = Path.replace, int(sys.argv[1])

def replace_or_die(self, target):
    global left
    left -= 1
    if left == 0:
        os.kill(os.getpid(), getattr(signal, sys.argv[2]))
    return replace(self, target)

Path.replace = replace_or_die
if __name__ == "__main__":
    from blender_lidar.cli import main
    sys.exit(main(sys.argv[3:]))
"""


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """A scene, and the folder of a run of it that nobody disturbed."""
    folder = tmp_path_factory.mktemp("undisturbed")
    with pytest.MonkeyPatch.context() as monkeypatch:
        without_charts(monkeypatch)
        assert main(["optimise", str(write_scene(folder)), "--out", str(folder / "run")]) == 0
    return folder / "scene.toml", folder / "run"


@pytest.fixture
def start(tmp_path):
    """Starts runs as processes of their own, and leaves none of them, nor of their workers, behind."""
    started = []

    def begin(scene: Path, out: Path, *words: object, dies_at: int = 0, by: str = "SIGKILL") -> Attacked:
        how = ("-c", PROGRAM, dies_at, by)
        folder = tmp_path / f"process_{len(started)}"
        started.append(Attacked(folder, ["optimise", scene, "--out", out, *words], how))
        return started[-1]

    yield begin
    for run in started:
        run.end()


needs_proc = pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="this system has no /proc")


def check_goes_on_to_the_same(scene: Path, out: Path, undisturbed: Path, *words: object) -> None:
    assert main(["optimise", str(scene), "--out", str(out), "--resume", *map(str, words)]) == 0
    check_same(out, undisturbed)


def stored_evaluations(folder: Path) -> int:
    return sum(len(batch["values"]) for batch in json.loads((folder / "checkpoint.json").read_text())["batches"])


# --- killed -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("write", [1, 4, WRITES])
def test_a_run_killed_at_any_write_goes_on_to_the_same_result(start, tmp_path, finished, write):
    scene, undisturbed = finished
    assert start(scene, tmp_path / "run", dies_at=write).code() == -signal.SIGKILL
    check_whole(tmp_path / "run")
    check_goes_on_to_the_same(scene, tmp_path / "run", undisturbed)


def test_a_run_makes_no_more_writes_than_were_tested(start, tmp_path, finished):
    run = start(finished[0], tmp_path / "run", dies_at=WRITES + 1)
    assert run.code() == 0, run.stderr


def test_a_run_killed_before_it_wrote_anything_starts_from_its_beginning_and_says_so(tmp_path, finished, capsys):
    scene, undisturbed = finished
    out, _ = done(capsys, "optimise", scene, "--out", tmp_path / "run", "--resume")
    assert "nothing is stored there to go on with; the search starts from its beginning." in out
    check_goes_on_to_the_same(scene, tmp_path / "run", undisturbed)


@pytest.mark.parametrize(
    ("words", "write", "stored"),
    [
        ("--search grid --particles 10 --iterations 6", 4, 40),  # three batches of 20
        ("--search de-pso --reading paper", 8, 6),  # asks for one candidate at a time: in the middle of an iteration
    ],
)
def test_the_rivals_go_on_as_well(start, tmp_path, words, write, stored):
    words, scene = words.split(), write_scene(tmp_path)
    assert main(["optimise", str(scene), "--out", str(tmp_path / "whole"), *words]) == 0
    start(scene, tmp_path / "run", *words, dies_at=write).code()
    assert stored_evaluations(tmp_path / "run") == stored
    check_goes_on_to_the_same(scene, tmp_path / "run", tmp_path / "whole", *words)


def test_a_run_killed_while_it_maps_goes_on_to_the_same_map(start, tmp_path):
    scene = write_scene(tmp_path, {**MAPPED, "traffic": {"frames": 2}})
    assert main(["optimise", str(scene), "--out", str(tmp_path / "whole")]) == 0
    start(scene, tmp_path / "run", dies_at=6).code()  # the map comes after the history
    assert not (tmp_path / "run" / "score_map.csv").exists()
    check_goes_on_to_the_same(scene, tmp_path / "run", tmp_path / "whole")
    assert (tmp_path / "run" / "score_map.csv").read_bytes() == (tmp_path / "whole" / "score_map.csv").read_bytes()


@needs_proc
def test_a_run_whose_worker_is_killed_has_failed_by_no_fault_of_its_input(start, tmp_path, finished):
    run = start(finished[0], tmp_path / "run", "--workers", 3, *ENDLESS)
    wait_for((tmp_path / "run" / "checkpoint.json").exists)
    workers = [pid for pid in run.survivors() if b"spawn_main" in Path(f"/proc/{pid}/cmdline").read_bytes()]
    assert len(workers) == 2  # and the run's own process
    os.kill(workers[0], signal.SIGKILL)
    assert run.code() == 1
    assert run.stderr.splitlines()[-1].startswith("blender-lidar: a worker process ended abruptly")
    assert "Traceback" not in run.stderr


# --- stopped ----------------------------------------------------------------------------------------------------------


def test_a_stopped_run_goes_on_to_the_same_result(start, tmp_path, finished):
    scene, undisturbed = finished
    run = start(scene, tmp_path / "run", dies_at=4, by="SIGINT")
    run.code()
    check_stopped(run)
    assert not list((tmp_path / "run").glob(".*"))  # unlike a killed one it tidies up
    check_goes_on_to_the_same(scene, tmp_path / "run", undisturbed)


@needs_proc
def test_ctrl_c_while_the_workers_start_is_quiet(start, tmp_path, finished):
    run = start(finished[0], tmp_path / "run", "--workers", 2, *ENDLESS)
    wait_for(lambda: len(run.survivors()) > 2)
    time.sleep(0.2)  # they import what they need
    run.send(signal.SIGINT, group=True)
    run.code()
    check_nobody_is_left(run)
    check_stopped(run)
    assert len(run.stderr.splitlines()) == 1, run.stderr


# --- resume -----------------------------------------------------------------------------------------------------------


CHANGES = [
    (["--seed", 2], "[search] seed = 1, not 2"),
    (["--frames", 5], "[traffic] frames = 6, not 5"),
    (["--range-noise", "datasheet"], "[sensor] range_noise_m = 0.0, not 0.02"),
    (["--search", "random"], "[search] method = 'hardened', not 'random'"),
]


@pytest.fixture(scope="module")
def killed(finished, tmp_path_factory):
    """The folder of a run that was killed while it searched."""
    folder = tmp_path_factory.mktemp("killed")
    command = ["optimise", finished[0], "--out", folder / "run"]
    Attacked(folder, command, ("-c", PROGRAM, 4, "SIGKILL")).code()
    return folder / "run"


@pytest.fixture
def stopped(killed, tmp_path):
    """A copy of it, but for what it had not finished writing, to be changed."""
    return shutil.copytree(killed, tmp_path / "stopped", ignore=shutil.ignore_patterns(".*"))


@pytest.mark.parametrize("which", ["stopped", "finished"])
@pytest.mark.parametrize(("words", "named"), CHANGES, ids=lambda value: str(value[0]))
def test_resume_with_other_settings_is_refused_naming_what_differs(request, finished, which, words, named, capsys):
    scene = finished[0]
    folder = request.getfixturevalue("stopped") if which == "stopped" else finished[1]
    before = {path.name: path.read_bytes() for path in folder.glob("[!.]*")}
    line = refused(capsys, folder, "optimise", scene, "--out", folder, "--resume", *words, begun=True)
    assert line.startswith(f"blender-lidar: --resume: {folder}: the run there had {named}; give it the same settings")
    assert {path.name: path.read_bytes() for path in folder.glob("[!.]*")} == before


def test_resume_with_other_traffic_of_the_same_name_is_refused(tmp_path, capsys):
    scene = write_scene(tmp_path)
    assert main(["optimise", str(scene), "--out", str(tmp_path / "run")]) == 0
    table = tmp_path / "traffic.csv"
    table.write_text(table.read_text().replace("1.5", "1.6"))
    line = refused(capsys, tmp_path, "optimise", scene, "--out", tmp_path / "run", "--resume", begun=True)
    assert "the run there had [traffic] path = 'file with SHA-256 " in line


def test_the_same_traffic_elsewhere_is_the_same_run(start, tmp_path, finished):
    scene, undisturbed = finished
    start(scene, tmp_path / "run", dies_at=4).code()
    shutil.copy(scene.parent / "traffic.csv", tmp_path / "copy.csv")
    words = ["--traffic", str(tmp_path / "copy.csv")]
    assert main(["optimise", str(scene), "--out", str(tmp_path / "run"), "--resume", *words]) == 0
    results = (json.loads((folder / "result.json").read_text()) for folder in (tmp_path / "run", undisturbed))
    resumed, expected = map(without_times, results)
    assert resumed == expected


def test_resume_needs_to_know_where(finished, tmp_path, capsys):
    line = refused(capsys, tmp_path, "optimise", finished[0], "--resume", begun=True)
    assert line == "blender-lidar: --resume: needs --out DIR, the folder of the run that was stopped"


@pytest.mark.parametrize("content", [b"", b"{", b"{}", b"\xff"])
@pytest.mark.parametrize("name", ["checkpoint.json", "result.json"])
def test_a_damaged_file_is_refused_by_name(tmp_path, stopped, finished, capsys, name, content):
    shutil.copytree(stopped, tmp_path / "run")
    (tmp_path / "run" / name).write_bytes(content)
    line = refused(capsys, tmp_path, "optimise", finished[0], "--out", tmp_path / "run", "--resume", begun=True)
    assert str(tmp_path / "run") in line


def change_checkpoint(folder: Path, change) -> None:
    content = json.loads((folder / "checkpoint.json").read_text())
    change(content["batches"])
    (folder / "checkpoint.json").write_text(json.dumps(content))


@pytest.mark.parametrize("place", ["x", "values"])
def test_a_search_that_asks_for_anything_else_by_one_bit_is_not_gone_on_with(stopped, finished, capsys, place):
    """As it may with another processor's linear algebra: the last bit of a mounting, or another objective."""

    def change(batches):
        if place == "x":
            batches[1]["x"][2][0] = float(np.nextafter(batches[1]["x"][2][0], 9.0))
        else:
            batches[0]["values"] = batches[0]["values"][::-1]

    change_checkpoint(stopped, change)
    line = refused(capsys, stopped, "optimise", finished[0], "--out", stopped, "--resume", begun=True)
    assert "asks for other mountings in batch 2 than the run there did" in line


@pytest.mark.parametrize("which", ["stopped", "finished"])
def test_a_run_made_by_other_code_is_not_gone_on_with(request, finished, capsys, monkeypatch, which):
    """It was noticed by the version alone, which does not change from one commit to the next."""
    folder = request.getfixturevalue("stopped") if which == "stopped" else finished[1]
    monkeypatch.setattr("blender_lidar.scene.provenance.source_digest", lambda: "0123456789ab")
    line = refused(capsys, folder, "optimise", finished[0], "--out", folder, "--resume", begun=True)
    assert f"{folder}: the run there was made by other code, blender_lidar '{__version__} (" in line
    assert f"not '{__version__} (0123456789ab)'" in line
