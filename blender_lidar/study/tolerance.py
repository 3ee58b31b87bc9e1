"""What a mounting is worth when it hangs only nearly as planned: the objective over an installer's errors.

The errors of [objective] tolerance fill a box about the plan. A lattice stands for it, the same for every mounting, so
that a search meets no noise: it has few points, and the verdict many others, none of which the search has seen.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ..scenario import COORDINATE_LIMITS, pose_at
from ..sensors.pose import Pose
from ..settings import COORDINATES, Tolerance
from .evaluation import Evaluator, Totals
from .statistics import block_sums

LOW_SHARE = 0.1  # the share of installations that may fall below what "low" aims at
SEARCHED_POINTS, JUDGED_POINTS = 16, 128
# Korobov generators: of the odd ones, the first with the least P2 (Sloan and Joe 1994) in three dimensions.
GENERATORS = {SEARCHED_POINTS: 3, JUDGED_POINTS: 25}


def lattice(dimensions: int, points: int) -> np.ndarray:
    """A rank-1 lattice in the cube from -1 to 1, (points, dimensions), every point of the same weight.

    It is centred: with a point it holds its mirror image, so that what falls on one side of a plan as it rises on the
    other cancels. In each dimension the points lie as those of the midpoint rule.

    Parameters
    ----------
    dimensions : int
        1 to 4.
    points : int
        `SEARCHED_POINTS` or `JUDGED_POINTS`.
    """
    steps = np.array([pow(GENERATORS[points], power, points) for power in range(dimensions)])
    return 2.0 * ((np.arange(points)[:, None] + 0.5) * steps / points % 1.0) - 1.0


def installation_errors(tolerance: Tolerance, points: int = SEARCHED_POINTS) -> np.ndarray:
    """Errors that stand for all that the tolerance allows, (points, 6) [m, degrees], in the order of `COORDINATES`."""
    widths = tolerance.half_widths
    errors = np.zeros((points, len(COORDINATES)))
    columns = [COORDINATES.index(key) for key in widths]
    errors[:, columns] = lattice(len(widths), points) * list(widths.values())
    return errors


def installed(plan: Mapping[str, float], errors: np.ndarray) -> list[Pose]:
    """Where a LiDAR planned at `plan` [m, degrees] hangs under each of the `errors` (m, 6).

    That may be beyond the bounds of a search, as an installer does not know them, but not beyond what a coordinate can
    be at all.
    """
    low, high = np.array([COORDINATE_LIMITS[key] for key in COORDINATES]).T
    hung = np.clip(np.array([plan[key] for key in COORDINATES]) + errors, low, high)
    return [pose_at(dict(zip(COORDINATES, row, strict=True))) for row in hung.tolist()]


def aimed(values: np.ndarray, aim: str) -> np.ndarray:
    """What is aimed at of values over the errors, (..., m) becoming (...): their mean, or their 10 % quantile."""
    if aim == "mean":
        return values.mean(axis=-1)
    return np.quantile(values, LOW_SHARE, axis=-1, method="hazen")  # each of m points stands for 1 / m of the errors


def objective_over(
    evaluator: Evaluator,
    plans: Sequence[Mapping[str, float]],
    tolerance: Tolerance,
    points: int = SEARCHED_POINTS,
) -> np.ndarray:
    """The objective of each plan over the tolerance, (s,), in the metric's unit: what a robust search maximises.

    Against 512 other points the mean over the 16 here errs by ...
    """
    errors = installation_errors(tolerance, points)
    poses = [pose for plan in plans for pose in installed(plan, errors)]
    objective = evaluator.totals(poses).objective.sum(axis=1)
    return aimed(objective.reshape(len(plans), len(errors)), tolerance.aim)


def best_over_tolerance(
    evaluator: Evaluator, plans: Sequence[Mapping[str, float]], tolerance: Tolerance | None
) -> Mapping[str, float]:
    """The best of a few plans over the tolerance, the first of equals; the first where all hang as planned.

    It is judged under errors that no search has met, so that what a robust search made of its few falls away.
    """
    if tolerance is None:
        return plans[0]
    return plans[int(np.argmax(objective_over(evaluator, plans, tolerance, JUDGED_POINTS)))]


@dataclass(frozen=True, slots=True, eq=False)
class ToleranceLosses:
    """What becomes of a mounting's objective over a tolerance, on the frames of one evaluator.

    Attributes
    ----------
    tolerance : Tolerance
        The errors that are allowed.
    errors : ndarray, (m, 6)
        Those tried, in the order of `COORDINATES` [m, degrees]; each stands for the same share of all.
    planned : Totals
        Of the mounting as planned: one row.
    installed : Totals
        Under each of the errors: m rows.
    at_limits : dict of str to Totals
        For each coordinate that is not exact: where it alone is off, by minus and by plus its half-width; two rows.
    block : ndarray of int, (f,)
        Block of time of each frame.
    """

    tolerance: Tolerance
    errors: np.ndarray
    planned: Totals
    installed: Totals
    at_limits: dict[str, Totals]
    block: np.ndarray

    @property
    def planned_per_vehicle(self) -> float:
        """Objective per vehicle of the mounting as planned, in the metric's unit."""
        return float(self.planned.per_vehicle()[0])

    @property
    def per_vehicle(self) -> np.ndarray:
        """Objective per vehicle under each of the errors, (m,)."""
        return self.installed.per_vehicle()

    @property
    def aimed_per_vehicle(self) -> float:
        """Objective per vehicle over the tolerance: the mean or the low quantile, as it aims."""
        return float(aimed(self.per_vehicle, self.tolerance.aim))

    @property
    def aimed_share(self) -> float:
        """Share of vehicles at or above the threshold over the tolerance: the mean or the low quantile, as it aims."""
        return float(aimed(self.installed.detectable_share(), self.tolerance.aim))

    @property
    def limit_losses(self) -> dict[str, tuple[float, float]]:
        """Objective per vehicle that is lost where one coordinate alone is off, by minus and by plus its half-width."""
        return {
            key: tuple((self.planned_per_vehicle - totals.per_vehicle()).tolist())
            for key, totals in self.at_limits.items()
        }

    @property
    def block_planned(self) -> np.ndarray:
        """Objective of the mounting as planned, summed over each block of time, (b,)."""
        return block_sums(self.planned.objective[0], self.block)

    @property
    def block_objective(self) -> np.ndarray:
        """Objective under each of the errors, summed over each block of time, (m, b)."""
        return block_sums(self.installed.objective, self.block)

    @property
    def block_vehicles(self) -> np.ndarray:
        """Vehicles of each block of time, (b,)."""
        return block_sums(self.planned.vehicles, self.block)

    def aimed_under(self, weights: np.ndarray) -> np.ndarray:
        """`aimed_per_vehicle` with each block of time counted `weights` (r, b) times, (r,)."""
        per_vehicle = weights @ self.block_objective.T / (weights @ self.block_vehicles)[:, None]
        return aimed(per_vehicle, self.tolerance.aim)

    def planned_under(self, weights: np.ndarray) -> np.ndarray:
        """`planned_per_vehicle` with each block of time counted `weights` (r, b) times, (r,)."""
        return weights @ self.block_planned / (weights @ self.block_vehicles)

    def kept(self, baseline_per_vehicle: float) -> float | None:
        """Share of its gain over the baseline that the mounting keeps over the tolerance; None without a gain."""
        gain = self.planned_per_vehicle - baseline_per_vehicle
        return (self.aimed_per_vehicle - baseline_per_vehicle) / gain if gain > 0.0 else None


def losses_over_tolerance(
    evaluator: Evaluator,
    plan: Mapping[str, float],
    tolerance: Tolerance,
    block: Sequence[int],
    points: int = JUDGED_POINTS,
) -> ToleranceLosses:
    """Score a mounting as planned, under errors that fill the tolerance, and at the limits of each coordinate.

    Parameters
    ----------
    evaluator : Evaluator
        What scores, on its frames; all poses in one call.
    plan : mapping of str to float
        The six coordinates of the mounting as planned [m, degrees].
    tolerance : Tolerance
        How far off it may end up.
    block : sequence of int, (f,)
        Block of time of each of the evaluator's frames.
    points : int
        How many errors: `JUDGED_POINTS` or `SEARCHED_POINTS`.
    """
    errors = installation_errors(tolerance, points)
    limits = {
        key: [[sign * width * (other == key) for other in COORDINATES] for sign in (-1.0, 1.0)]
        for key, width in tolerance.half_widths.items()
    }
    tried = np.concatenate([np.zeros((1, len(COORDINATES))), errors, *limits.values()])
    totals = evaluator.totals(installed(plan, tried))
    first = 1 + points

    def rows(start: int, stop: int) -> Totals:
        return Totals(totals.objective[start:stop], totals.detectable[start:stop], totals.vehicles)

    return ToleranceLosses(
        tolerance=tolerance,
        errors=errors,
        planned=rows(0, 1),
        installed=rows(1, first),
        at_limits={key: rows(first + 2 * row, first + 2 * row + 2) for row, key in enumerate(limits)},
        block=np.asarray(block),
    )
