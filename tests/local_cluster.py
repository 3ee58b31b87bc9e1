"""A real cluster of this machine: a dask scheduler and workers, each a process of its own, and none left behind."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

from tests.waiting import WAIT_S, wait_for

ROOT = Path(__file__).parents[1]


class LocalCluster:
    """Started in a folder, where logs and temporary files go; use it as a context manager.

    Parameters
    ----------
    folder : path
        Where there is no blender_lidar, so that the scheduler does without one unless it is installed.
    workers : int
        Worker processes of one thread each.
    """

    def __init__(self, folder: Path, workers: int = 2) -> None:
        self._folder, self._first = folder, workers
        self._started: list[subprocess.Popen] = []

    def __enter__(self) -> LocalCluster:
        message = self._folder / "scheduler.json"
        try:
            self.scheduler = self._start(
                "dask_scheduler", "--port", 0, "--scheduler-file", message, "--idle-timeout", "20 minutes"
            )
            wait_for(lambda: message.exists() and message.read_text().endswith("}"))
            self.address = json.loads(message.read_text())["address"]
            self.workers = [self.start_worker() for _ in range(self._first)]
            return self
        except BaseException:
            self.__exit__()
            raise

    def __exit__(self, *exception) -> None:
        for process in self._started[::-1]:  # a worker whose scheduler has gone waits for it
            process.terminate()
            try:
                process.wait(5.0)
            except subprocess.TimeoutExpired:
                with suppress(ProcessLookupError):
                    os.killpg(process.pid, signal.SIGKILL)
                process.wait(WAIT_S)

    def start_worker(self, *words: object, package: Path = ROOT, nanny: bool = False) -> subprocess.Popen:
        """A worker that has registered, and imports blender_lidar from the folder `package`."""
        place = self._folder / f"worker_{len(self._started)}"
        words = (*words, *(() if words else ("--nthreads", 1)), *(() if nanny else ("--no-nanny",)))
        process = self._start(
            "dask_worker", self.address, "--local-directory", place, *words, environment={"PYTHONPATH": str(package)}
        )
        log = self._log(process)
        wait_for(lambda: "Registered to:" in log.read_text(errors="replace"))
        return process

    def _start(self, module: str, *words: object, environment: dict[str, str] | None = None) -> subprocess.Popen:
        command = [sys.executable, "-m", f"distributed.cli.{module}", "--host", "127.0.0.1", "--no-dashboard", *words]
        path = self._folder / f"{len(self._started)}.log"
        plain = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
        with path.open("w") as log:
            process = subprocess.Popen(
                [str(word) for word in command],
                cwd=self._folder,
                env=plain | (environment or {}),
                stdout=log,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )
        self._started.append(process)
        return process

    def _log(self, process: subprocess.Popen) -> Path:
        return self._folder / f"{self._started.index(process)}.log"
