"""Mountings that a study compares: Sobol's sequence over what is searched, or a grid through the mounting in question.

All that studies know of coordinates stands here.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ..errors import InputError
from ..optimise.search import generator
from ..run.tolerance import installed
from ..scene.mounting import COORDINATES, leaning, pose_at, with_lean
from ..scene.scenario import Scenario
from ..sensors.pose import Pose

SOBOL_BITS = 30
BASELINE, FIRST = 0, 1  # rows of a landscape: the baseline, and where the candidates begin
PROFILES = {"height_m": 0.5, "tilt_x_deg": 5.0, "tilt_y_deg": 5.0, "yaw_deg": 10.0}  # how far off each is drawn
_STEPS = 10  # of a profile, to each side


@dataclass(frozen=True, slots=True, eq=False)
class Candidates:
    """Mountings to compare.

    Attributes
    ----------
    variables : tuple of str
        Names of the coordinates in which they differ.
    points : ndarray, (k, d)
        The candidates [m, degrees].
    poses : tuple of Pose, (1 + k)
        The baseline and the candidates.
    """

    variables: tuple[str, ...]
    points: np.ndarray
    poses: tuple[Pose, ...]

    def select(self, numbers: Sequence[int]) -> Candidates:
        """The baseline and some of the candidates, by their rows in `points`."""
        poses = (self.poses[BASELINE], *(self.poses[FIRST + number] for number in numbers))
        return Candidates(self.variables, self.points[list(numbers)], poses)


def sobol_candidates(scenario: Scenario, count: int) -> Candidates:
    """So many points of Sobol's sequence over [deployment], shifted at random by the scene's seed.

    Raises
    ------
    InputError
        When nothing is searched.
    """
    deployment = scenario.deployment
    if not deployment.bounds:
        raise InputError(
            f"{scenario.source}: [deployment] fixes every coordinate; allowed: at least one a pair [low, high]"
        )
    lower, upper = np.array(deployment.lower, dtype=float), np.array(deployment.upper, dtype=float)
    points = sobol(scenario.search.seed, count, lower, upper)
    poses = (scenario.baseline_pose, *(deployment.pose(point) for point in points))
    return Candidates(deployment.variables, points, poses)


def sobol(seed: int, count: int, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
    """The first points of Sobol's sequence in a box, all shifted alike (digit by digit) by a random amount, (count, d).

    Any 2^m of them that follow a multiple of 2^m fill the box evenly.
    """
    from scipy.stats import qmc

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # that any other count than a power of 2 is less even
        points = qmc.Sobol(lower.size, scramble=False, bits=SOBOL_BITS).random(count)
    shift = generator(seed).integers(1 << SOBOL_BITS, size=lower.size)
    digits = (points * (1 << SOBOL_BITS)).astype(np.int64) ^ shift
    return np.clip(lower + (digits + 0.5) / (1 << SOBOL_BITS) * (upper - lower), lower, upper)


def grid_candidates(
    scenario: Scenario, mounting: Mapping[str, float], heights: int, tilts: int, *, widest_deg: float = math.inf
) -> Candidates:
    """The mounting in question, and a grid over the searched ones of height and tilt through it.

    The tilt is the lean where the scene is given by it; the other coordinates stay as they are in `mounting`. There are
    so many heights and tilts, or more tilts where their steps would be wider than `widest_deg`.
    """
    names, bounds, place = scenario.deployment.axes, scenario.deployment.bounds, with_lean(mounting)
    lowest, highest = bounds.get(names[1], (0.0, 0.0))
    counts = {names[0]: heights, names[1]: max(tilts, math.ceil((highest - lowest) / widest_deg) + 1)}
    axes = [
        np.linspace(*bounds[name], counts[name]).round(9) if name in bounds else [place[name]]  # 4.3, not 4.30...01
        for name in names
    ]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
    points = np.concatenate([[[place[name] for name in names]], grid])
    placed = (leaning(mounting, **dict(zip(names, point, strict=True))) for point in grid.tolist())
    poses = [pose_at(one, scenario.road) for one in (dict(mounting), *placed)]
    return Candidates(names, points, (scenario.baseline_pose, *poses))


def off_plan(scenario: Scenario, mounting: Mapping[str, float]) -> dict[str, tuple[np.ndarray, list[Pose]]]:
    """The mounting with one coordinate off at a time: offsets [m or degrees] and poses, by the coordinate's name."""
    found = {}
    for key, reach in PROFILES.items():
        offsets = np.linspace(-reach, reach, 2 * _STEPS + 1)
        found[key] = offsets, installed(mounting, np.outer(offsets, np.array(COORDINATES) == key), scenario.road)
    return found


def check_searched(scenario: Scenario) -> None:
    """Refuse a scene that fixes both height and tilt: there is no optimum whose place could be uncertain."""
    axes = scenario.deployment.axes
    if not any(axis in scenario.deployment.bounds for axis in axes):
        raise InputError(
            f"{scenario.source}: [deployment] fixes {' and '.join(axes)}; allowed: at least one a pair [low, high]"
        )


def check_one_place(scenario: Scenario) -> None:
    """Refuse candidate poles and several recordings: a study is about one place and one recording."""
    if scenario.further_traffic:
        raise InputError(
            f"{scenario.source}: [[traffic]]: {len(scenario.recordings)} recordings are for optimise and evaluate; a "
            "study is about one: [traffic]"
        )
    if scenario.deployment.poles:
        raise InputError(
            f"{scenario.source}: [deployment] poles: are for optimise; a study is about one place: x_m and y_m"
        )
