"""The mountings that a study of stability compares: the one in question, the baseline, and a grid of others."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ..errors import InputError
from ..scenario import Scenario, pose_at
from ..sensors.pose import Pose
from ..study.score_map import AXES

REFERENCE, BASELINE, CANDIDATES = 0, 1, 2  # rows: the first two, and where the grid begins


@dataclass(frozen=True, slots=True, eq=False)
class Mountings:
    """A reference, the baseline, and candidates on a grid of heights and tilts through the reference.

    Attributes
    ----------
    reference : dict of str to float
        The six coordinates in question, metres and degrees.
    baseline : Pose
    height_m, tilt_deg : ndarray, (k,)
        Of each candidate.
    """

    reference: dict[str, float]
    baseline: Pose
    height_m: np.ndarray
    tilt_deg: np.ndarray

    @property
    def grid(self) -> list[dict[str, float]]:
        """The six coordinates of each candidate, (k)."""
        return [
            {**self.reference, AXES[0]: height, AXES[1]: tilt}
            for height, tilt in zip(self.height_m.tolist(), self.tilt_deg.tolist(), strict=True)
        ]

    @property
    def steps(self) -> tuple[float, float]:
        """From one height of the grid to the next [m], and from one tilt to the next [deg]; 0 where there is one."""
        height, tilt = (float(np.diff(np.unique(axis)).max(initial=0.0)) for axis in (self.height_m, self.tilt_deg))
        return height, tilt

    @property
    def poses(self) -> tuple[Pose, ...]:
        """All of them, (2 + k)."""
        return pose_at(self.reference), self.baseline, *map(pose_at, self.grid)


def check_searched(scenario: Scenario) -> None:
    """Refuse a scene that fixes both height and tilt: there is no optimum whose place could be uncertain."""
    if not any(axis in scenario.deployment.bounds for axis in AXES):
        raise InputError(
            f"{scenario.source}: [deployment] fixes height_m and tilt_x_deg; allowed: at least one a pair [low, high]"
        )


def mountings_about(scenario: Scenario, reference: Mapping[str, float], heights: int, tilts: int) -> Mountings:
    """Candidates over the searched ones of height and tilt, the other coordinates as in `reference`."""
    counts = dict(zip(AXES, (heights, tilts), strict=True))
    axes: list[Sequence[float]] = [
        np.linspace(*scenario.deployment.bounds[axis], counts[axis]).round(9)  # 4.3, not 4.30...01
        if axis in scenario.deployment.bounds
        else np.array([reference[axis]])
        for axis in AXES
    ]
    height, tilt = (grid.ravel() for grid in np.meshgrid(*axes, indexing="ij"))
    return Mountings(dict(reference), scenario.baseline_pose, height, tilt)
