"""Runs that are stopped, starved of space or robbed of their files end in one line and lose nothing.

Runs that are killed are in `tests.test_resume`.
"""

from __future__ import annotations

import errno
import os
import signal
import subprocess
import sys
import tempfile
from contextlib import contextmanager
from pathlib import Path

import pytest

from blender_lidar.cli import main
from blender_lidar.errors import OutputError, WorkerError, WriteError, output_error
from blender_lidar.files import folder_lock, whole_file
from blender_lidar.run.folder import RunFolder
from blender_lidar.run.optimise import evaluate_site
from blender_lidar.scene.scenario import load_scenario
from blender_lidar.scene.site import prepare
from blender_lidar.scoring.workers import Workers
from tests.refusals import refused
from tests.run_attacks import (
    Attacked,
    check_nobody_is_left,
    check_same,
    check_stopped,
    check_whole,
)
from tests.small_scene import cli, done, without_charts, write_scene
from tests.waiting import wait_for

pytestmark = pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="this system has no /proc")

ENDLESS = ("--iterations", 100_000)  # a search that does not end before it is stopped


@pytest.fixture
def scene(tmp_path):
    return write_scene(tmp_path, {"traffic": {"frames": 4}})


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """A scene, and the folder of a run of it that nobody disturbed."""
    folder = tmp_path_factory.mktemp("undisturbed")
    scene = write_scene(folder, {"traffic": {"frames": 4}})
    with pytest.MonkeyPatch.context() as monkeypatch:
        without_charts(monkeypatch)
        assert main(["optimise", str(scene), "--out", str(folder / "run")]) == 0
    return scene, folder / "run"


@pytest.fixture
def attack(tmp_path):
    """Starts the command line as a process of its own, and leaves nothing of it behind."""
    started = []

    def begin(*words: object, **how) -> Attacked:
        started.append(Attacked(tmp_path / f"process_{len(started)}", words, **how))
        return started[-1]

    yield begin
    for attacked in started:
        attacked.end()


@contextmanager
def small_disk(folder: Path, kilobytes: int):
    """A disk of that size; root alone can have one."""
    folder.mkdir()
    command = ["mount", "-t", "tmpfs", "-o", f"size={kilobytes}k", "small_disk", folder]
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=False)
    except FileNotFoundError:
        pytest.skip("there is no mount")
    if done.returncode != 0:
        pytest.skip(f"no small disk can be mounted: {done.stderr.strip()}")
    try:
        yield folder
    finally:
        subprocess.run(["umount", folder], check=True)


# --- stopped ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("numbers", "workers"),
    [((signal.SIGINT,), 2), ((signal.SIGTERM, signal.SIGTERM), 2), ((signal.SIGHUP,), 1)],
    ids=["Ctrl-C", "SIGTERM", "closed terminal"],
)
def test_what_stops_a_run_leaves_a_word_how_to_go_on_and_no_process_or_semaphore(
    attack, tmp_path, scene, numbers, workers
):
    out = tmp_path / "run"
    run = attack("optimise", scene, "--out", out, "--workers", workers, *ENDLESS)
    wait_for((out / "checkpoint.json").exists)
    assert (len(run.survivors()) > 1) == (workers > 1)
    for number in numbers:
        run.send(number, group=True)
    assert run.code() == 1
    check_nobody_is_left(run)
    check_stopped(run)
    assert run.stderr.splitlines()[-1] == f"blender-lidar: stopped; go on with: --out {out} --resume"
    check_whole(out)


def python(program: str) -> subprocess.CompletedProcess:
    program = "import signal, time\nfrom blender_lidar import signals as stop_signals\n" + program
    return subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)


@pytest.mark.parametrize(("tidying_s", "code", "printed"), [(60.0, 0, "tidied\n"), (0.0, -signal.SIGTERM, "")])
def test_a_second_stop_cut_tidying_up_short_and_only_a_late_one_does(tidying_s, code, printed):
    done = python(
        f"stop_signals._TIDYING_S = {tidying_s}\n"
        "with stop_signals.stops_watched():\n"
        "    try: signal.raise_signal(signal.SIGINT)\n"
        "    except KeyboardInterrupt:\n"
        "        time.sleep(0.01); signal.raise_signal(signal.SIGTERM); print('tidied')\n"
        "signal.raise_signal(signal.SIGINT)  # while Python ends"
    )
    assert (done.returncode, done.stdout, done.stderr) == (code, printed, "")


def test_a_stop_within_compiled_code_is_told_as_a_stop():
    """As Python makes it of a call that returns a result while a KeyboardInterrupt is under way."""
    done = python(
        "def compiled(cause):\n"
        "    for _ in range(2):\n"
        "        try: raise SystemError('returned a result with an exception set') from cause\n"
        "        except SystemError as error: cause = error\n"
        "    raise cause\n"
        "for cause in (KeyboardInterrupt(), ValueError()):\n"
        "    try:\n"
        "        with stop_signals.stops_recognised(): compiled(cause)\n"
        "    except BaseException as error: print(type(error).__name__)"
    )
    assert (done.returncode, done.stdout) == (0, "KeyboardInterrupt\nSystemError\n")


def test_a_stop_while_the_compiler_calls_python_back_comes_later_and_is_not_lost():
    """As its cache of compiled code does: ctypes prints what a callback raises, and goes on."""
    done = python(
        "import ctypes\n"
        "callback = 'def notify(): signal.raise_signal(signal.SIGTERM); time.sleep(0.05); return 1'\n"
        "of_llvm = {**globals(), '__name__': 'llvmlite.binding.executionengine'}\n"
        "exec(callback, of_llvm)\n"
        "with stop_signals.stops_watched():\n"
        "    try:\n"
        "        print(ctypes.CFUNCTYPE(ctypes.c_int)(of_llvm['notify'])())\n"
        "        time.sleep(60)\n"
        "    except KeyboardInterrupt: print('stopped')"
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, "1\nstopped\n", "")


def test_a_stop_while_blender_starts_stops_the_run():
    pytest.importorskip("bpy")
    done = python(
        "import os, sys, threading\n"
        "from blender_lidar.world.needs_blender import blender_room\n"
        "with stop_signals.stops_watched():\n"
        "    try:\n"
        "        threading.Timer(0.3, os.kill, (os.getpid(), signal.SIGTERM)).start()\n"
        "        blender_room('scene', 'a test')\n"
        "        time.sleep(60)\n"
        "    except KeyboardInterrupt: print('stopped')"
    )
    assert (done.returncode, done.stdout.splitlines()[-1], done.stderr) == (0, "stopped", "")


def test_a_stop_while_charts_are_drawn_says_how_to_go_on(attack, tmp_path, scene):
    pytest.importorskip("matplotlib")
    for number in range(20):
        out = tmp_path / f"run_{number}"
        run = attack("optimise", scene, "--out", out, how=("-m", "blender_lidar"))
        wait_for((out / "result.json").exists)
        run.send(signal.SIGINT)
        if run.code() not in (0, -signal.SIGINT):
            break  # else it had drawn them all when it was stopped, or was a process that ends
    assert run.code() == 1
    check_stopped(run)
    assert run.stderr.splitlines()[-1] == f"blender-lidar: stopped; go on with: --out {out} --resume"
    check_whole(out)


# --- killed -----------------------------------------------------------------------------------------------------------


def test_what_a_killed_writer_leaves_is_what_is_swept_away(tmp_path):
    """Its name is recognised whatever the file is: a chart, a cloud, a render."""
    for name in ("chart.png", "cloud.pcd", "none"):
        with whole_file(tmp_path / name) as temporary:
            os.link(temporary, tmp_path / "kept")
            left = temporary
        (tmp_path / "kept").rename(left)
        (tmp_path / name).unlink()
    assert len(list(tmp_path.iterdir())) == 3
    with RunFolder(tmp_path).locked():
        pass
    assert not list(tmp_path.iterdir())


# --- no space ---------------------------------------------------------------------------------------------------------


def test_a_run_whose_disk_is_full_fails_naming_the_file_and_goes_on_when_there_is_space(
    tmp_path, finished, capsys, monkeypatch
):
    without_charts(monkeypatch)
    scene, undisturbed = finished
    with small_disk(tmp_path / "disk", 24) as disk:
        out = disk / "run"
        code, _, err = cli(capsys, "optimise", scene, "--out", out)
        assert code == 1
        assert err.splitlines()[-1].startswith(f"blender-lidar: {out}")
        assert err.splitlines()[-1].endswith(": cannot be written: No space left on device")
        assert not list(out.glob(".*"))
        check_whole(out)
        subprocess.run(["mount", "-o", "remount,size=1m", disk], check=True)
        done(capsys, "optimise", scene, "--out", out, "--resume")
        check_same(out, undisturbed)


@pytest.mark.parametrize(
    ("number", "kind", "code"), [("ENOSPC", WriteError, 1), ("EIO", WriteError, 1), ("EROFS", OutputError, 2)]
)
def test_a_good_place_on_a_full_disk_is_no_wrong_input(number, kind, code):
    message = output_error("a.csv: cannot be written", OSError(getattr(errno, number), "why"))
    assert (type(message), message.exit_code, str(message)) == (kind, code, "a.csv: cannot be written: why")


def test_a_temporary_folder_that_cannot_be_written_is_not_called_the_output(tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "missing"))
    with pytest.raises(WorkerError, match=r"the temporary folder .*missing cannot be written.*; make room, set TMPDIR"):
        Workers(abs, 3)


# --- streams ----------------------------------------------------------------------------------------------------------


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no /dev/full")
def test_a_run_whose_messages_cannot_be_written_is_not_lost(attack, tmp_path, finished):
    scene, undisturbed = finished
    with Path("/dev/full").open("w") as full:
        run = attack("optimise", scene, "--out", tmp_path / "run", settings={"stderr": full})
    assert run.code() == 0
    check_same(tmp_path / "run", undisturbed)


# --- files that vanish or change --------------------------------------------------------------------------------------


def test_an_evaluation_is_kept_when_its_traffic_vanishes_meanwhile(tmp_path, scene):
    site = prepare(load_scenario(scene))
    (tmp_path / "traffic.csv").unlink()
    result = evaluate_site(site, RunFolder(tmp_path), site.scenario.baselines)
    assert result["identity"]["[traffic] path"].startswith("file with SHA-256 ")


def test_render_refuses_other_traffic_than_the_runs(tmp_path, scene, capsys, monkeypatch):
    pytest.importorskip("bpy")
    without_charts(monkeypatch)
    done(capsys, "evaluate", scene, "--out", tmp_path / "run")
    table = tmp_path / "traffic.csv"
    table.write_text(table.read_text().replace("1.5", "1.6"))
    line = refused(capsys, tmp_path, "render", tmp_path / "run")
    assert line == f"blender-lidar: {table}: is not as it was when the run read it"


# --- the folder -------------------------------------------------------------------------------------------------------


def test_of_many_runs_at_once_in_one_folder_one_is_carried_out(attack, tmp_path, finished):
    scene, undisturbed = finished
    runs = [attack("optimise", scene, "--out", tmp_path / "run") for _ in range(3)]
    codes = [run.code() for run in runs]
    assert codes.count(0) == 1
    for run, code in zip(runs, codes, strict=True):
        message = run.stderr.splitlines()
        assert code == 0 or (code == 2 and len(message) == 1)
    check_same(tmp_path / "run", undisturbed)


def test_a_folder_that_a_failed_run_removed_before_it_was_locked_is_made_again(tmp_path):
    with folder_lock(tmp_path / "deep" / "run"):
        assert (tmp_path / "deep" / "run").is_dir()


def test_a_file_system_without_locks_is_mentioned(tmp_path, monkeypatch):
    fcntl = pytest.importorskip("fcntl")

    def refuse(*_):
        raise OSError(errno.ENOTSUP, "Operation not supported")

    monkeypatch.setattr(fcntl, "flock", refuse)
    text = "another run there would not be noticed, as it cannot be locked: Operation not supported"
    with pytest.warns(UserWarning, match=text), folder_lock(tmp_path):
        pass
