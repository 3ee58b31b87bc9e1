"""The objective over height and tilt: a picture of the whole landscape, and how certain its top is."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..scenario import Deployment, pose_at
from .evaluation import Evaluator, Totals
from .statistics import FEWEST_BLOCKS, block_sums, interval_90, resampled_weights

AXES = ("height_m", "tilt_x_deg")
POINTS = (11, 26)  # a quarter metre by 1 degree over the paper's ranges: enough to see the landscape
FINE_POINTS = (26, 26)  # 0.1 m by 1 degree: the resolution in which the paper reports
_CHUNK = 26


@dataclass(frozen=True, slots=True, eq=False)
class ScoreMap:
    """The objective on a grid of heights and tilts, the other coordinates fixed.

    Attributes
    ----------
    height_m : ndarray, (h,)
    tilt_deg : ndarray, (t,)
    per_vehicle : ndarray, (h, t)
        Objective per vehicle, in the metric's unit.
    detectable_share : ndarray, (h, t)
    block_objective : ndarray, (h, t, b)
        Objective summed over each block of time that has vehicles.
    block_vehicles : ndarray, (b,)
        Vehicles of each block.
    """

    height_m: np.ndarray
    tilt_deg: np.ndarray
    per_vehicle: np.ndarray
    detectable_share: np.ndarray
    block_objective: np.ndarray
    block_vehicles: np.ndarray

    @property
    def best(self) -> tuple[float, float, float]:
        """Height [m], tilt [deg] and objective per vehicle of the best grid point."""
        row, column = np.unravel_index(np.argmax(self.per_vehicle), self.per_vehicle.shape)
        return float(self.height_m[row]), float(self.tilt_deg[column]), float(self.per_vehicle[row, column])

    def best_coordinates(self, others: dict[str, float]) -> dict[str, float]:
        """The six coordinates of the best grid point; `others` fixes those that the grid does not span."""
        return {**others, **dict(zip(AXES, self.best, strict=False))}

    def resampled_best(self, seed: int) -> tuple[np.ndarray, np.ndarray] | None:
        """Height [m] and tilt [deg] of the best grid point in each block resample; None for too few blocks."""
        blocks = len(self.block_vehicles)
        if blocks < FEWEST_BLOCKS:
            return None
        return self.best_under(resampled_weights(blocks, np.random.default_rng(seed)))

    def best_under(self, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Height [m] and tilt [deg] of the best grid point, (r,) each, with each block counted `weights` (r, b) times.

        Every row of the weights must leave some vehicles.
        """
        objective = self.block_objective.reshape(-1, len(self.block_vehicles))
        values = weights @ objective.T / (weights @ self.block_vehicles)[:, None]
        row, column = np.unravel_index(np.argmax(values, axis=1), self.per_vehicle.shape)
        return self.height_m[row], self.tilt_deg[column]

    def optimum_intervals_90(self, seed: int) -> dict[str, tuple[float, float]] | None:
        """90 % intervals of the best height and tilt under block resampling; None for too few blocks."""
        resampled = self.resampled_best(seed)
        return (
            None
            if resampled is None
            else {axis: interval_90(values) for axis, values in zip(AXES, resampled, strict=True)}
        )


def map_scores(
    evaluator: Evaluator,
    deployment: Deployment,
    optimum: dict[str, float],
    block: np.ndarray,
    progress: Callable[[int], None] = lambda points: None,
    grid: tuple[int, int] = POINTS,
) -> ScoreMap | None:
    """Score a grid over the searched heights and tilts through the `optimum`; None unless both are searched.

    Parameters
    ----------
    evaluator : Evaluator
        What scores.
    deployment : Deployment
        Bounds of both axes.
    optimum : dict of str to float
        The six coordinates found, which fix the other four.
    block : ndarray of int, (f,)
        Block of time of each of the evaluator's frames.
    progress : callable
        Told how many grid points have been scored since it was last called.
    grid : (int, int)
        Number of heights and of tilts.
    """
    if not all(axis in deployment.bounds for axis in AXES):
        return None
    height, tilt = (np.linspace(*deployment.bounds[axis], points) for axis, points in zip(AXES, grid, strict=True))
    poses = [pose_at({**optimum, AXES[0]: float(h), AXES[1]: float(t)}) for h in height for t in tilt]
    parts = []
    for start in range(0, len(poses), _CHUNK):
        chunk = poses[start : start + _CHUNK]
        parts.append(evaluator.totals(chunk))
        progress(len(chunk))
    totals = Totals(
        np.concatenate([part.objective for part in parts]),
        np.concatenate([part.detectable for part in parts]),
        evaluator.vehicles,
    )
    block_vehicles = block_sums(evaluator.vehicles, block)
    filled = block_vehicles > 0  # an empty block prefers no mounting
    return ScoreMap(
        height_m=height,
        tilt_deg=tilt,
        per_vehicle=totals.per_vehicle().reshape(grid),
        detectable_share=totals.detectable_share().reshape(grid),
        block_objective=block_sums(totals.objective, block)[:, filled].reshape(*grid, -1),
        block_vehicles=block_vehicles[filled],
    )
