"""An optimisation in a process of its own, for a window that goes on meanwhile: the command line's, with its progress.

Its order is a pickle: the `scenario`, the `labels` by which errors call its settings, and what stands there besides, as
`scenery`. It prints messages as lines of JSON, `tell`, which the window finds, `heard`, among all that is printed.
"""

from __future__ import annotations

import json
import os
import pickle
import sys
import threading
from dataclasses import replace
from pathlib import Path

from ..clouds.live import LiveFrame
from ..errors import BlenderLidarError, one_line
from ..run.folder import RunFolder
from ..run.optimise import optimise_site
from ..scene.scenario import load_scenario, shipped_scenes
from ..scene.site import prepare
from ..scoring.evaluation import Evaluator
from .optimise import write_pages

_MARK = "blender_lidar"  # of our messages: their kind
_NUMBER = (int, float, type(None))
_MESSAGES = {"progress": {"done": int, "best": _NUMBER}, "problem": {"problem": str}}


class _Listener:
    """A listener that prints how far it is."""

    def __init__(self) -> None:
        self._counted: dict[int, int] = {}
        self._best: float | None = None

    def searching(self, search) -> None:
        self._counted[id(search)] = len(search.history)
        self._best = float(search.best_value) if len(search.history) else self._best
        self._tell()

    def mapping(self, points: int) -> None:
        self._counted[0] = self._counted.get(0, 0) + points
        self._tell()

    def _tell(self) -> None:
        tell("progress", done=sum(self._counted.values()), best=self._best)


def tell(kind: str, **values: object) -> None:
    """Print a message: ``progress`` with `done` and `best`, or a ``problem``."""
    print(json.dumps({_MARK: kind, **values}), flush=True)


def heard(line: str) -> dict[str, object]:
    """The values of a message of `tell`; none of any other line, which Blender or a library may print."""
    try:
        values = json.loads(line)
    except ValueError:
        return {}
    known = _MESSAGES.get(str(values.pop(_MARK, None)), {}) if isinstance(values, dict) else {}
    right = known.keys() == values.keys() if known else False
    return values if right and all(isinstance(values[key], kind) for key, kind in known.items()) else {}


def main(order: str, folder: str) -> int:
    """Optimise what the file `order` says into `folder`; returns the exit code. It ends with the one who started it."""
    threading.Thread(target=_end_with_parent, daemon=True).start()
    try:
        given = pickle.loads(Path(order).read_bytes())
        labels = given["labels"]
        scenario = replace(given["scenario"], where=lambda table, key: labels.get((table, key), f"[{table}] {key}"))
        site = prepare(scenario, scenery=given["scenery"], bodies=given["bodies"])
        with RunFolder(folder).locked() as run:
            optimise_site(site, run, _Listener())
            write_pages(site, run, lambda note: None)
    except BlenderLidarError as error:
        tell("problem", problem=one_line(str(error)))
        return 1
    return 0


def _end_with_parent() -> None:
    """Wait until standard input is closed, which whoever started this holds open."""
    os.read(sys.stdin.fileno(), 1)
    os._exit(1)


def warm_up() -> None:
    """Have everything compiled that the shipped scene needs, and kept on disk for the next process."""
    if hasattr(os, "nice"):
        os.nice(10)  # nobody waits for it
    site = prepare(load_scenario(shipped_scenes()["i80"], {("traffic", "frames"): (1, "warm_up")}))
    LiveFrame(site.search[0], site.observation, site.scoring).look(site.scenario.baselines[0].pose)
    with Evaluator(site.search, site.observation, site.scoring) as evaluator:
        evaluator.totals([site.scenario.baselines])
