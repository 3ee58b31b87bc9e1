"""Our own problem: a scene's objective over its mountings, with two coordinates searched or five.

Each instance looks at other frames of a recording, so that a search which draws nothing has as many chances as the
others, and none wins by the luck of one landscape. They are no independent draws: frames of neighbouring instances are
half a second apart and show the same vehicles in other places. Other recordings have other vehicles.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from ..errors import InputError
from ..scenario import load_scenario
from ..study.site import prepare, read_recording
from .problems import Problem

FRAMES = 8  # of an instance; with two, chance makes a needle of the optimum
INSTANCES = 31  # of a recording, that share no frame: 248 of 270
CASES: dict[str, dict[str, list[float]]] = {
    "scene 2-D": {"height_m": [2.0, 4.5], "tilt_x_deg": [0.0, 25.0]},
    "scene 5-D": {
        "y_m": [-4.0, 1.0],
        "height_m": [2.0, 4.5],
        "tilt_x_deg": [0.0, 25.0],
        "tilt_y_deg": [-15.0, 15.0],
        "yaw_deg": [-30.0, 30.0],
    },
}


@contextmanager
def scene_problem(
    scene: str | Path, case: str, instance: int, traffic: str | None = None
) -> Iterator[tuple[Problem, float]]:
    """The problem of one of `CASES`, and the value of the scene's baseline.

    The objective is the sum over the vehicles of `FRAMES` frames at most, as `optimise` maximises it: of every 31st
    frame of the recording, the scene's or that of the file `traffic`, beginning with the `instance`-th.
    """
    with_traffic = {} if traffic is None else {("traffic", "path"): (traffic, "--traffic")}
    recording = read_recording(load_scenario(scene, with_traffic))
    if len(recording.frames) < INSTANCES:
        raise InputError(f"{recording.source}: {len(recording.frames)} frames; the study needs {INSTANCES} or more")
    frames = recording.frames[instance % INSTANCES :: INSTANCES][:FRAMES]
    settings: dict[tuple[str, str], tuple[object, str]] = dict(with_traffic)
    settings |= {("deployment", key): (pair, "search study") for key, pair in CASES[case].items()}
    settings["traffic", "frame_ids"] = frames.tolist(), "search study"
    settings["traffic", "holdout"] = 0.0, "search study"
    settings["model", "workers"] = 1, "search study"
    site = prepare(load_scenario(scene, settings))
    deployment = site.scenario.deployment
    with site.evaluator(site.search) as evaluator:

        def objective(candidates: np.ndarray) -> np.ndarray:
            return evaluator.totals([deployment.pose(x) for x in candidates]).objective.sum(axis=1)

        baseline = float(evaluator.totals([site.scenario.baseline_pose]).objective.sum())
        yield Problem(case, np.array(deployment.lower), np.array(deployment.upper), objective, None), baseline
