"""Our own problem: a scene's objective over its mountings, with two coordinates searched or five."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from ..scenario import load_scenario
from ..study.site import prepare
from .problems import Problem

FRAMES = 2  # an evaluation takes some 2 ms; more frames would smooth the landscape, which is to be rugged
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
def scene_problem(scene: str | Path, case: str) -> Iterator[tuple[Problem, float]]:
    """The problem of one of `CASES`, and the value of the scene's baseline.

    The objective is the sum over the vehicles of `FRAMES` frames, as `optimise` maximises it.
    """
    settings = {("deployment", key): (pair, "search study") for key, pair in CASES[case].items()}
    settings |= {("traffic", "frames"): (FRAMES, "search study"), ("model", "workers"): (1, "search study")}
    site = prepare(load_scenario(scene, settings))
    deployment = site.scenario.deployment
    with site.evaluator(site.search) as evaluator:

        def objective(candidates: np.ndarray) -> np.ndarray:
            return evaluator.totals([deployment.pose(x) for x in candidates]).objective.sum(axis=1)

        baseline = float(evaluator.totals([site.scenario.baseline_pose]).objective.sum())
        yield Problem(case, np.array(deployment.lower), np.array(deployment.upper), objective, None), baseline
