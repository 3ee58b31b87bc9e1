"""Problems that searches are judged on: BBOB, and our own scene.

BBOB are the noiseless functions of Hansen and others (INRIA RR-6829), from the `ioh` package. The scene's objective has
two coordinates searched or five; each instance looks at other frames of a recording, so that a search which draws
nothing has as many chances as the others. They are no independent draws: frames of neighbouring instances are half a
second apart and show the same vehicles in other places. Other recordings have other vehicles.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from blender_lidar.errors import InputError
from blender_lidar.optimise import Objective
from blender_lidar.scene.mounting import COORDINATES
from blender_lidar.scene.scenario import load_scenario
from blender_lidar.scene.site import prepare, read_recording
from blender_lidar.scoring.evaluation import site_evaluator


@dataclass(frozen=True, slots=True, eq=False)
class Problem:
    """An objective (s, d) -> (s,) to maximise over a box, and the best value there is; None where nobody knows."""

    name: str
    lower: np.ndarray
    upper: np.ndarray
    objective: Objective
    best: float | None


# --- BBOB -------------------------------------------------------------------------------------------------------------

BBOB_DIMENSIONS = (2, 3, 5)
BBOB_GROUPS = {
    "separable": range(1, 6),
    "moderate": range(6, 10),
    "ill-conditioned": range(10, 15),
    "multimodal": range(15, 20),
    "weak structure": range(20, 25),
}
BBOB_FUNCTIONS = tuple(function for functions in BBOB_GROUPS.values() for function in functions)


def bbob_problem(function: int, dimension: int, instance: int) -> Problem:
    """An instance of a BBOB function, turned upside down: its best value is ``-f*``."""
    import ioh

    found = ioh.get_problem(function, instance=instance, dimension=dimension, problem_class=ioh.ProblemClass.BBOB)
    bounds, best = found.bounds, -float(found.optimum.y)
    objective = lambda x: -np.asarray(found(x.tolist()), dtype=float)  # noqa: E731
    return Problem(f"f{function}", np.array(bounds.lb), np.array(bounds.ub), objective, best)


# --- our scene --------------------------------------------------------------------------------------------------------

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
    settings: dict[tuple[str, str], object] = {("traffic", "frame_ids"): frames.tolist(), ("traffic", "holdout"): 0.0}
    settings["model", "workers"] = 1
    usual = load_scenario(scene, with_traffic).lidar.deployment
    # As it was judged: in 5-D all three angles, which a scene is refused, and vehicles about the middle of the places.
    bounds = {key: CASES[case][key] for key in COORDINATES if key in CASES[case]}
    place = replace(usual.places[0], fixed={**dict.fromkeys(COORDINATES, 0.0), **usual.places[0].fixed}, bounds=bounds)
    deployment = usual.at(place)
    (space,) = deployment.spaces
    settings["region", "centre_m"] = x_m, y_m = deployment.nominal_xy
    settings |= {("baseline", "x_m"): x_m, ("baseline", "y_m"): y_m}
    given = {key: (value, "search study") for key, value in settings.items()}
    scenario = load_scenario(scene, {**with_traffic, **given})
    site = prepare(scenario.with_lidars(replace(scenario.lidar, deployment=deployment)))
    with site_evaluator(site, site.search) as evaluator:

        def objective(candidates: np.ndarray) -> np.ndarray:
            return evaluator.totals([space.layout(x) for x in candidates]).objective.sum(axis=1)

        baseline = float(evaluator.totals([(site.scenario.lidar.baseline,)]).objective.sum())
        yield Problem(case, np.array(space.lower), np.array(space.upper), objective, None), baseline
