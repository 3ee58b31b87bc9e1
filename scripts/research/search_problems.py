"""Problems that searches are judged on (BBOB and our own scene) or tuned on (development problems, and nothing else).

BBOB are the noiseless functions of Hansen and others (INRIA RR-6829), from the `ioh` package. The scene's objective has
two coordinates searched or five; each instance looks at other frames of a recording, so that a search which draws
nothing has as many chances as the others. They are no independent draws: frames of neighbouring instances are half a
second apart and show the same vehicles in other places. Other recordings have other vehicles.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from blender_lidar.errors import InputError
from blender_lidar.optimise import Objective
from blender_lidar.scene.mounting import COORDINATES, Deployment
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
    usual = load_scenario(scene, with_traffic).deployment
    # As it was judged: in 5-D all three angles, which a scene is refused, and vehicles about the middle of the places.
    bounds = {key: CASES[case][key] for key in COORDINATES if key in CASES[case]}
    deployment = Deployment({**dict.fromkeys(COORDINATES, 0.0), **usual.fixed}, bounds)
    settings["region", "centre_m"] = x_m, y_m = deployment.nominal_xy
    settings |= {("baseline", "x_m"): x_m, ("baseline", "y_m"): y_m}
    given = {key: (value, "search study") for key, value in settings.items()}
    site = prepare(replace(load_scenario(scene, {**with_traffic, **given}), deployment=deployment))
    with site_evaluator(site, site.search) as evaluator:

        def objective(candidates: np.ndarray) -> np.ndarray:
            return evaluator.totals([deployment.pose(x) for x in candidates]).objective.sum(axis=1)

        baseline = float(evaluator.totals([site.scenario.baseline_pose]).objective.sum())
        yield Problem(case, np.array(deployment.lower), np.array(deployment.upper), objective, None), baseline


# --- development problems ---------------------------------------------------------------------------------------------
# Shifted, most turned, in boxes beside their optima: every box is 10 wide, lies wholly beyond the origin and is centred
# on nothing. The value at the optimum is 0; values are negative elsewhere, so that success is -value <= target. Costs
# are of offsets z (s, d) from the optimum.

DIMENSIONS = (2, 4, 6)
TARGET = 1e-2
WIDTH = 10.0


def _ellipsoid(z: np.ndarray, decades: float = 4.0) -> np.ndarray:
    """A sphere with axes from 1 to 10^(decades / 2): condition number 10^decades."""
    return (10.0 ** (decades * np.linspace(0.0, 1.0, z.shape[1])) * np.square(z)).sum(axis=1)


def _rosenbrock(z: np.ndarray) -> np.ndarray:
    z = z + 1.0
    return (100.0 * np.square(z[:, 1:] - np.square(z[:, :-1])) + np.square(z[:, :-1] - 1.0)).sum(axis=1)


def _rastrigin(z: np.ndarray) -> np.ndarray:
    return (np.square(z) - 10.0 * np.cos(2.0 * np.pi * z) + 10.0).sum(axis=1)


def _ackley(z: np.ndarray) -> np.ndarray:
    funnel = -20.0 * np.exp(-0.2 * np.sqrt(np.square(z).mean(axis=1)))
    return funnel - np.exp(np.cos(2.0 * np.pi * z).mean(axis=1)) + 20.0 + np.e


_TURNED: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "sphere": lambda z: np.square(z).sum(axis=1),
    "ellipsoid": _ellipsoid,
    "thin ellipsoid": lambda z: _ellipsoid(z, 6.0),
    "Rosenbrock": _rosenbrock,
    "Rastrigin": _rastrigin,
    "Ackley": _ackley,
    "stepped Ackley": lambda z: np.floor(_ackley(z) / 0.05) * 0.05,  # as a threshold makes the real objective
    "ridge": lambda z: np.abs(z[:, 0]) + 30.0 * np.sqrt(np.square(z[:, 1:]).sum(axis=1)),
}
_ALONG_THE_AXES: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "Rastrigin along the axes": _rastrigin,
    "rippled ellipsoid along the axes": lambda z: _ellipsoid(z) + 5.0 * (1.0 - np.cos(np.pi * z)).sum(axis=1),
}
_PEAKS = {
    "peaks": {"count": 12, "least": 0.5, "width": 1.3},
    "many peaks": {"count": 60, "least": 0.3, "width": 0.55},
}
NAMES = (*_TURNED, "wall", *_PEAKS, *_ALONG_THE_AXES)


def development_problem(name: str, dimension: int, instance: int) -> Problem:
    """The instance of one of `NAMES`: optimum, box and rotation drawn anew."""
    rng = np.random.default_rng([instance, dimension, NAMES.index(name)])
    lower = 10.0 + 90.0 * rng.random(dimension)
    optimum = lower + WIDTH * (0.15 + 0.7 * rng.random(dimension))
    axes, _ = np.linalg.qr(rng.standard_normal((dimension, dimension)))
    if name == "wall":
        objective = _wall(rng, lower, optimum, axes)
    elif name in _PEAKS:
        objective = _peaks(rng, lower, optimum, axes, **_PEAKS[name])
    elif name in _ALONG_THE_AXES:
        objective = lambda x: -_ALONG_THE_AXES[name](x - optimum)  # noqa: E731
    else:
        objective = lambda x: -_TURNED[name]((x - optimum) @ axes)  # noqa: E731
    return Problem(name, lower, lower + WIDTH, objective, 0.0)


def _wall(rng, lower, optimum, axes):
    """An ellipsoid whose optimum lies on a bound of half of the variables, which it presses against."""
    pressed = np.arange(lower.size) < (lower.size + 1) // 2
    side = np.where(rng.random(lower.size) < 0.5, lower + WIDTH, lower)
    optimum = np.where(pressed, side, optimum)

    def objective(x: np.ndarray) -> np.ndarray:
        offset = x - optimum
        return -(2.0 * np.abs(offset[:, pressed]).sum(axis=1) + _ellipsoid(offset @ axes) / 100.0)

    return objective


def _peaks(rng, lower, optimum, axes, *, count, least, width):
    """Gaussian peaks of all widths, anywhere; the highest is 1, the others from `least` to 0.9."""
    d = lower.size
    centres = lower + WIDTH * (0.05 + 0.9 * rng.random((count, d)))
    centres[0] = optimum
    heights = np.concatenate([[1.0], least + (0.9 - least) * rng.random(count - 1)])
    widths = width * d**0.5 * np.exp(rng.normal(0.0, 0.3, (count, d)))

    def objective(x: np.ndarray) -> np.ndarray:
        offset = ((x[:, None, :] - centres) @ axes) / widths
        return -(1.0 - (heights * np.exp(-0.5 * np.square(offset).sum(axis=2))).max(axis=1))

    return objective
