"""The mountings that fidelities are compared on: the baseline, and points spread evenly over what is searched."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..errors import InputError
from ..optimise.sampling import generator, sobol
from ..scenario import Scenario
from ..sensors.pose import Pose

BASELINE, FIRST = 0, 1  # rows of a landscape: the baseline, and where the candidates begin


@dataclass(frozen=True, slots=True, eq=False)
class Candidates:
    """Mountings to compare.

    Attributes
    ----------
    variables : tuple of str
        Names of the searched coordinates.
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


def candidates(scenario: Scenario, count: int) -> Candidates:
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
    points = sobol(generator(scenario.search.seed), count, lower, upper)
    poses = (scenario.baseline_pose, *(deployment.pose(point) for point in points))
    return Candidates(deployment.variables, points, poses)
