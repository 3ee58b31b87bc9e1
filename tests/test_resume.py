"""A run that was killed or stopped at any moment goes on to the same result as one that was not."""

from __future__ import annotations

import csv
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import pytest

from blender_lidar.cli import main
from tests.small_scene import MAPPED, cli, without_charts, without_times, write_scene
from tests.waiting import WAIT_S, wait_for

pytestmark = pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="this system has no SIGKILL")

# One file is written, whole, for each of: the scene, the checkpoint after each of 3 iterations, history, two vehicle
# tables, the installation sheet, the result, the page.
WRITES = 10
TABLES = ("history.csv", "vehicles.csv", "vehicles_baseline.csv", "installation.txt")
ENDLESS = ("--iterations", 100_000)  # a search that does not end before it is stopped

# Runs the command line without charts and stores a checkpoint after every batch. Before that file takes its place whose
# number is argument 1 (0: none), the process sends itself the signal that argument 2 names.
PROGRAM = """
import os, signal, sys
from pathlib import Path

signal.signal(signal.SIGINT, signal.default_int_handler)  # whatever this process was started with
sys.modules["matplotlib"] = None
from blender_lidar import run
run._CHECKPOINT_EVERY_S = 0.0
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


@pytest.fixture(autouse=True)
def _quick(monkeypatch):
    without_charts(monkeypatch)


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

    def begin(scene: Path, out: Path, *words: object, dies_at: int = 0, by: str = "SIGKILL") -> subprocess.Popen:
        command = [sys.executable, "-c", PROGRAM, dies_at, by, "optimise", scene, "--out", out, *words]
        with (out.parent / "stderr.txt").open("w") as stderr:
            process = subprocess.Popen(
                [str(word) for word in command], stdout=subprocess.DEVNULL, stderr=stderr, start_new_session=True
            )
        started.append(process)
        return process

    yield begin
    for process in started:
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait(WAIT_S)


def children(pid: int) -> list[int]:
    """Processes started by another, as /proc tells."""
    return [child for child, (_, parent) in processes().items() if parent == pid]


def alive(pids: list[int]) -> list[int]:
    table = processes()
    return [pid for pid in pids if pid in table and table[pid][0] != "Z"]


def processes() -> dict[int, tuple[str, int]]:
    """State and parent of every process."""
    table = {}
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            state, parent = (folder / "stat").read_text().rpartition(")")[2].split()[:2]
        except OSError:  # it has just ended
            continue
        table[int(folder.name)] = (state, int(parent))
    return table


needs_proc = pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="this system has no /proc")


def check_nothing_is_half_written(folder: Path) -> None:
    """Every file that can be seen is complete."""
    for path in folder.glob("[!.]*"):
        text = path.read_text()
        if path.suffix == ".json":
            json.loads(text)
        elif path.suffix == ".csv":
            assert text.endswith("\n")
            assert len({len(row) for row in csv.reader(text.splitlines())}) == 1
        else:
            assert text.endswith("\n")


def without_workers(folder: Path) -> list[str]:
    """The scene as used but for the number of workers, which changes nothing."""
    return [line for line in (folder / "scene.toml").read_text().splitlines() if not line.startswith("workers = ")]


def check_goes_on_to_the_same(scene: Path, out: Path, undisturbed: Path, *words: object) -> None:
    assert main(["optimise", str(scene), "--out", str(out), "--resume", *map(str, words)]) == 0
    results = (json.loads((folder / "result.json").read_text()) for folder in (out, undisturbed))
    resumed, expected = map(without_times, results)
    assert resumed == expected
    for name in TABLES:
        assert (out / name).read_bytes() == (undisturbed / name).read_bytes()
    assert without_workers(out) == without_workers(undisturbed)
    assert {path.name for path in out.iterdir()} == {path.name for path in undisturbed.iterdir()}


# --- killed -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("write", range(1, WRITES + 1))
def test_a_run_killed_at_any_write_goes_on_to_the_same_result(start, tmp_path, finished, write):
    scene, undisturbed = finished
    process = start(scene, tmp_path / "run", dies_at=write)
    process.wait(WAIT_S)
    assert process.returncode == -signal.SIGKILL
    check_nothing_is_half_written(tmp_path / "run")
    check_goes_on_to_the_same(scene, tmp_path / "run", undisturbed)


def test_a_run_makes_no_more_writes_than_were_tested(start, tmp_path, finished):
    process = start(finished[0], tmp_path / "run", dies_at=WRITES + 1)
    process.wait(WAIT_S)
    err = (tmp_path / "stderr.txt").read_text()
    assert process.returncode == 0, err


def test_a_run_killed_twice_goes_on_to_the_same_result(start, tmp_path, finished):
    scene, undisturbed = finished
    start(scene, tmp_path / "run", dies_at=3).wait(WAIT_S)
    start(scene, tmp_path / "run", "--resume", dies_at=3).wait(WAIT_S)
    assert (tmp_path / "run" / "checkpoint.json").exists()
    check_goes_on_to_the_same(scene, tmp_path / "run", undisturbed)


def test_a_run_killed_before_it_wrote_anything_starts_from_its_beginning_and_says_so(tmp_path, finished, capsys):
    scene, undisturbed = finished
    code, out, _ = cli(capsys, "optimise", scene, "--out", tmp_path / "run", "--resume")
    assert code == 0
    assert "nothing is stored there to go on with; the search starts from its beginning." in out
    check_goes_on_to_the_same(scene, tmp_path / "run", undisturbed)


@pytest.mark.parametrize("method", ["grid", "random"])
def test_the_rivals_go_on_as_well(start, tmp_path, method):
    words = ["--search", method, "--particles", "10", "--iterations", "6"]  # three batches of 20
    scene = write_scene(tmp_path)
    assert main(["optimise", str(scene), "--out", str(tmp_path / "whole"), *words]) == 0
    start(scene, tmp_path / "run", *words, dies_at=4).wait(WAIT_S)
    state = json.loads((tmp_path / "run" / "checkpoint.json").read_text())["search"]
    assert len(state["values"]) == 40
    check_goes_on_to_the_same(scene, tmp_path / "run", tmp_path / "whole", *words)


def test_the_literal_reading_goes_on_in_the_middle_of_an_iteration(start, tmp_path):
    words = ["--search", "de-pso", "--reading", "paper"]  # asks for one candidate at a time
    scene = write_scene(tmp_path)
    assert main(["optimise", str(scene), "--out", str(tmp_path / "whole"), *words]) == 0
    start(scene, tmp_path / "run", *words, dies_at=8).wait(WAIT_S)
    state = json.loads((tmp_path / "run" / "checkpoint.json").read_text())["search"]
    assert len(state["values"]) == 6
    check_goes_on_to_the_same(scene, tmp_path / "run", tmp_path / "whole", *words)


def test_a_run_killed_while_it_maps_goes_on_to_the_same_map(start, tmp_path):
    scene = write_scene(tmp_path, {**MAPPED, "traffic": {"frames": 2}})
    assert main(["optimise", str(scene), "--out", str(tmp_path / "whole")]) == 0
    start(scene, tmp_path / "run", dies_at=6).wait(WAIT_S)  # the map comes after the history
    assert not (tmp_path / "run" / "score_map.csv").exists()
    check_goes_on_to_the_same(scene, tmp_path / "run", tmp_path / "whole")
    assert (tmp_path / "run" / "score_map.csv").read_bytes() == (tmp_path / "whole" / "score_map.csv").read_bytes()


def test_a_run_with_two_workers_killed_while_it_searches_goes_on_with_one(start, tmp_path, finished):
    scene, undisturbed = finished
    process = start(scene, tmp_path / "run", "--workers", 2, dies_at=3)
    process.wait(WAIT_S)
    assert process.returncode == -signal.SIGKILL
    assert (tmp_path / "run" / "checkpoint.json").exists()
    check_goes_on_to_the_same(scene, tmp_path / "run", undisturbed)


def test_a_run_killed_while_its_workers_start_goes_on_to_the_same_result(start, tmp_path, finished):
    scene, undisturbed = finished
    process = start(scene, tmp_path / "run", "--workers", 2)
    wait_for((tmp_path / "run" / "scene.toml").exists)
    process.kill()
    process.wait(WAIT_S)
    check_nothing_is_half_written(tmp_path / "run")
    check_goes_on_to_the_same(scene, tmp_path / "run", undisturbed, "--workers", 2)


@needs_proc
def test_the_workers_of_a_killed_run_end_with_it(start, tmp_path, finished):
    process = start(finished[0], tmp_path / "run", "--workers", 2, *ENDLESS)
    wait_for((tmp_path / "run" / "checkpoint.json").exists)
    workers = children(process.pid)
    process.kill()
    process.wait(WAIT_S)
    wait_for(lambda: not alive(workers), 10.0)


@needs_proc
def test_a_run_whose_worker_is_killed_has_failed_by_no_fault_of_its_input(start, tmp_path, finished):
    process = start(finished[0], tmp_path / "run", "--workers", 3, *ENDLESS)
    wait_for((tmp_path / "run" / "checkpoint.json").exists)
    workers = [pid for pid in children(process.pid) if b"spawn_main" in Path(f"/proc/{pid}/cmdline").read_bytes()]
    assert len(workers) == 2  # and the run's own process
    os.kill(workers[0], signal.SIGKILL)
    process.wait(WAIT_S)
    err = (tmp_path / "stderr.txt").read_text()
    assert process.returncode == 1
    assert err.splitlines()[-1].startswith("blender-lidar: a worker process ended abruptly")
    assert "Traceback" not in err


# --- stopped ----------------------------------------------------------------------------------------------------------


@needs_proc
@pytest.mark.parametrize("workers", [1, 2])
@pytest.mark.parametrize("to", ["process", "group"])
def test_ctrl_c_says_how_to_go_on_and_leaves_no_process_behind(start, tmp_path, finished, workers, to):
    out = tmp_path / "run"
    process = start(finished[0], out, "--workers", workers, *ENDLESS)
    wait_for((out / "checkpoint.json").exists)
    helpers = children(process.pid)
    assert bool(helpers) == (workers > 1)
    os.kill(process.pid if to == "process" else -process.pid, signal.SIGINT)
    process.wait(WAIT_S)
    err = (tmp_path / "stderr.txt").read_text()
    assert process.returncode == 1
    assert "Traceback" not in err
    assert err.splitlines()[-1] == f"blender-lidar: stopped; go on with: --out {out} --resume"
    wait_for(lambda: not alive(helpers))
    check_nothing_is_half_written(out)


@pytest.mark.parametrize("write", [2, 4, 6])
def test_a_stopped_run_goes_on_to_the_same_result(start, tmp_path, finished, write):
    scene, undisturbed = finished
    process = start(scene, tmp_path / "run", dies_at=write, by="SIGINT")
    process.wait(WAIT_S)
    err = (tmp_path / "stderr.txt").read_text()
    assert process.returncode == 1
    assert "stopped; go on with: " in err
    assert not list((tmp_path / "run").glob(".*"))  # unlike a killed one it tidies up
    check_goes_on_to_the_same(scene, tmp_path / "run", undisturbed)


@needs_proc
def test_ctrl_c_while_the_workers_start_is_quiet(start, tmp_path, finished):
    process = start(finished[0], tmp_path / "run", "--workers", 2, *ENDLESS)
    wait_for(lambda: len(children(process.pid)) > 1)
    helpers = children(process.pid)
    time.sleep(0.2)  # they import what they need
    os.killpg(process.pid, signal.SIGINT)
    process.wait(WAIT_S)
    err = (tmp_path / "stderr.txt").read_text()
    wait_for(lambda: not alive(helpers))
    assert process.returncode == 1
    assert len(err.splitlines()) == 1, err


# --- resume -----------------------------------------------------------------------------------------------------------


def test_a_finished_run_is_shown_again_and_nothing_of_it_changes(tmp_path, finished, capsys):
    scene, undisturbed = finished
    shutil.copytree(undisturbed, tmp_path / "run")
    before = {path.name: path.read_bytes() for path in (tmp_path / "run").iterdir()}
    code, out, err = cli(capsys, "optimise", scene, "--out", tmp_path / "run", "--resume", "--json")
    assert code == 0
    assert out.encode() == before["result.json"]
    assert "Mounting" in err
    assert {path.name: path.read_bytes() for path in (tmp_path / "run").iterdir()} == before


CHANGES = [
    (["--seed", 2], "[search] seed = 1, not 2"),
    (["--iterations", 4], "[search] iterations = 3, not 4"),
    (["--sensor", "RS-32"], "[sensor] name = 'RS-16', not 'RS-32'"),
    (["--reading", "paper"], "[objective] reading = 'corrected', not 'paper'"),
    (["--detail", "box"], "[world] detail = 'body', not 'box'"),
    (["--frames", 5], "[traffic] frames = 6, not 5"),
    (["--range-noise", "datasheet"], "[sensor] range_noise_m = 0.0, not 0.02"),
    (["--dropout", "0.1"], "[sensor] dropout = 0.0, not 0.1"),
    (["--glass-dropout", "1"], "[sensor] glass_dropout = 0.0, not 1.0"),
    (["--range-at-10-percent", "datasheet"], "[sensor] range_at_10_percent_m = None, not 56.6"),
    (["--unit-spread", "0.1"], "[sensor] unit_spread_deg = 0.0, not 0.1"),
    (["--search", "random"], "[search] method = 'hardened', not 'random'"),
]


@pytest.fixture
def stopped(start, finished, tmp_path):
    """The folder of a run that was killed while it searched."""
    start(finished[0], tmp_path / "stopped", dies_at=4).wait(WAIT_S)
    return tmp_path / "stopped"


@pytest.mark.parametrize("which", ["stopped", "finished"])
@pytest.mark.parametrize(("words", "named"), CHANGES, ids=lambda value: str(value[0]))
def test_resume_with_other_settings_is_refused_naming_what_differs(request, finished, which, words, named, capsys):
    scene = finished[0]
    folder = request.getfixturevalue("stopped") if which == "stopped" else finished[1]
    before = {path.name: path.read_bytes() for path in folder.glob("[!.]*")}
    code, _, err = cli(capsys, "optimise", scene, "--out", folder, "--resume", *words)
    assert code == 2
    assert err.startswith(f"blender-lidar: --resume: {folder}: the run there had {named}; give it the same settings")
    assert len(err.splitlines()) == 1
    assert {path.name: path.read_bytes() for path in folder.glob("[!.]*")} == before


@pytest.mark.parametrize("key", ["unit", "noise_seed"])
def test_resume_with_another_unit_or_noise_seed_is_refused(tmp_path, finished, capsys, key):
    shutil.copytree(finished[0].parent, tmp_path / "other", ignore=shutil.ignore_patterns("run"))
    scene = write_scene(tmp_path / "other", {"sensor": {key: 2}})
    code, _, err = cli(capsys, "optimise", scene, "--out", finished[1], "--resume")
    assert code == 2
    assert f"the run there had [sensor] {key} = 1, not 2; give it the same settings" in err


def test_resume_with_other_traffic_of_the_same_name_is_refused(tmp_path, capsys):
    scene = write_scene(tmp_path)
    assert main(["optimise", str(scene), "--out", str(tmp_path / "run")]) == 0
    table = tmp_path / "traffic.csv"
    table.write_text(table.read_text().replace("1.5", "1.6"))
    code, _, err = cli(capsys, "optimise", scene, "--out", tmp_path / "run", "--resume")
    assert code == 2
    assert "the run there had [traffic] path = 'file with SHA-256 " in err


def test_the_same_traffic_elsewhere_is_the_same_run(start, tmp_path, finished):
    scene, undisturbed = finished
    start(scene, tmp_path / "run", dies_at=4).wait(WAIT_S)
    shutil.copy(scene.parent / "traffic.csv", tmp_path / "copy.csv")
    words = ["--traffic", str(tmp_path / "copy.csv")]
    assert main(["optimise", str(scene), "--out", str(tmp_path / "run"), "--resume", *words]) == 0
    results = (json.loads((folder / "result.json").read_text()) for folder in (tmp_path / "run", undisturbed))
    resumed, expected = map(without_times, results)
    assert resumed == expected


def test_resume_needs_to_know_where(finished, capsys):
    code, _, err = cli(capsys, "optimise", finished[0], "--resume")
    assert code == 2
    assert err == "blender-lidar: --resume: needs --out DIR, the folder of the run that was stopped\n"


def test_an_evaluation_is_no_search_to_go_on_with(tmp_path, finished, capsys):
    scene, _ = finished
    assert main(["evaluate", str(scene), "--height", "3", "--out", str(tmp_path / "one")]) == 0
    code, _, err = cli(capsys, "optimise", scene, "--out", tmp_path / "one", "--resume")
    assert code == 2
    assert "holds one mounting's evaluation, not a search" in err


@pytest.mark.parametrize("content", [b"", b"{", b"[]", b"{}", b'{"identity": {}}', b"\xff", b'{"search": {}}'])
@pytest.mark.parametrize("name", ["checkpoint.json", "result.json"])
def test_a_damaged_file_is_refused_by_name(tmp_path, stopped, finished, capsys, name, content):
    shutil.copytree(stopped, tmp_path / "run")
    (tmp_path / "run" / name).write_bytes(content)
    code, _, err = cli(capsys, "optimise", finished[0], "--out", tmp_path / "run", "--resume")
    assert code == 2
    assert str(tmp_path / "run") in err
    assert len(err.splitlines()) == 1
    assert "Traceback" not in err
