"""Attacks on runs: the real command line as a process of its own, hit at any moment, and what must hold afterwards."""

from __future__ import annotations

import csv
import json
import os
import signal
import subprocess
import sys
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

from tests.small_scene import without_times
from tests.waiting import WAIT_S, wait_for

WITHOUT_CHARTS = """
import sys
sys.modules["matplotlib"] = None
if __name__ == "__main__":
    from blender_lidar.cli import main
    sys.exit(main())
"""
TABLES = ("history.csv", "vehicles.csv", "vehicles_baseline.csv", "installation.txt", "score_map.csv")


@dataclass
class Attacked:
    """A command of its own session, with a folder for temporary files of its own.

    Attributes
    ----------
    folder : Path
        Holds stdout, stderr and the temporary files.
    process : Popen
    """

    folder: Path
    words: Sequence[object]
    how: Sequence[object] = ("-c", WITHOUT_CHARTS)  # Python is started
    settings: dict = field(default_factory=dict)  # of Popen
    process: subprocess.Popen = field(init=False)

    def __post_init__(self) -> None:
        self.temporary.mkdir(parents=True, exist_ok=True)
        command = [sys.executable, *map(str, [*self.how, *self.words])]
        environment = {**os.environ, "TMPDIR": str(self.temporary)}
        streams = {name: (self.folder / name).open("wb") for name in ("stdout", "stderr") if name not in self.settings}
        self.process = subprocess.Popen(
            command, stdin=subprocess.DEVNULL, start_new_session=True, env=environment, **streams, **self.settings
        )
        for stream in streams.values():
            stream.close()

    @property
    def temporary(self) -> Path:
        """Where it puts what is only for a moment."""
        return self.folder / "tmp"

    @property
    def stderr(self) -> str:
        """What it has printed there."""
        return (self.folder / "stderr").read_text(errors="replace")

    def send(self, number: int, *, group: bool = False) -> None:
        """Send a signal to it, or to all of its processes."""
        with suppress(ProcessLookupError):
            (os.killpg if group else os.kill)(self.process.pid, number)

    def code(self) -> int:
        """How it has ended."""
        return self.process.wait(WAIT_S)

    def survivors(self) -> list[int]:
        """Those of its processes that are still alive."""
        return [pid for pid, (state, session) in sessions().items() if session == self.process.pid and state != "Z"]

    def end(self) -> None:
        """Leave none of it behind."""
        for pid in self.survivors():
            with suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        self.process.wait(WAIT_S)


def sessions() -> dict[int, tuple[str, int]]:
    """State and session of every process, as /proc tells."""
    table = {}
    for folder in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):  # it has just ended
            state, _, _, session = (folder / "stat").read_text().rpartition(")")[2].split()[:4]
            table[int(folder.name)] = (state, int(session))
    return table


def check_nobody_is_left(attacked: Attacked) -> None:
    """Every process that it started has ended."""
    wait_for(lambda: not attacked.survivors(), f"for {attacked.survivors()} to end")


def check_whole(folder: Path) -> None:
    """Every file that can be seen is complete."""
    for path in filter(Path.is_file, sorted(folder.rglob("[!.]*"))):
        data = path.read_bytes()
        if path.suffix == ".json":
            json.loads(data)
        else:
            assert data.endswith(b"IEND\xaeB`\x82" if path.suffix == ".png" else b"\n"), f"{path} is half written"
        if path.suffix == ".csv":
            assert len({len(row) for row in csv.reader(data.decode().splitlines())}) == 1, f"{path} is half written"


def content(folder: Path) -> dict[str, object]:
    """What a run has left but for what differs between runs that ought to agree: times and the number of workers."""
    found: dict[str, object] = {}
    for path in folder.iterdir():
        found[path.name] = path.read_bytes() if path.name in TABLES else "there"
        if path.name == "result.json":
            found[path.name] = without_times(json.loads(path.read_text()))
        elif path.name == "scene.toml":
            found[path.name] = [line for line in path.read_text().splitlines() if not line.startswith("workers = ")]
    return found


def check_same(folder: Path, undisturbed: Path) -> None:
    """Two folders of runs hold the same."""
    here, there = content(folder), content(undisturbed)
    for name in sorted({*here, *there}):
        assert here.get(name) == there.get(name), f"{folder / name} is not as in the run that nobody disturbed"


def check_stopped(attacked: Attacked) -> None:
    """One line says that it was stopped, and nothing that it needed for a moment is left."""
    lines = [line for line in attacked.stderr.splitlines() if line.startswith("blender-lidar: ")]
    stops = [line for line in lines if line.startswith("blender-lidar: stopped")]
    for sign in ("Traceback", "Exception ignored", "leaked", "Error"):
        assert sign not in attacked.stderr, attacked.stderr[-1500:]
    if attacked.process.returncode < 0 and not attacked.stderr:
        return  # before the command line had begun
    assert (attacked.process.returncode, len(stops)) == (1, 1), attacked.stderr[-1500:]
    assert not list(attacked.temporary.iterdir())
