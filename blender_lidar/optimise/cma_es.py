"""CMA-ES: a Gaussian that climbs, its covariance learnt from the ranks of what it tried (Hansen, arXiv 1604.00772).

With weighted recombination, cumulative step-size adaptation, rank-one and rank-mu updates and negative weights for the
worse half. Positions are shares of the box, 0 to 1 in every variable; only the order of values counts.

Mountings are often best on a bound. A sample beyond one is evaluated on it, and its value counts where it was drawn: as
if the objective went on unchanged outside. The mean may leave the box by two standard deviations of the Gaussian it
moves from, so that where a bound is best nearly all samples come to lie on it, and that variable no longer says
anything about step size and shape; in a corner samples become one point, and the climb ends, as none is better.
Drawn again until they are inside, samples keep off the bounds; if values count where they were evaluated, they have a
climb along a bound end too early.
"""

from __future__ import annotations

import math

import numpy as np

BEYOND = 2.0  # standard deviations by which the mean may leave the box
NARROW = 1e-5  # of the box: a Gaussian no wider than that has arrived
ILL_CONDITIONED = 1e7  # longest over shortest axis
WIDEST = 3.0  # of the box, in standard deviations: it has lost its way
FLAT_GROWTH = 1.3  # of the step size after a generation of equal values
CLIMB_PATIENCE = 10  # generations without a better best, and more for more variables
_LEAST_VARIANCE = 1e-20


class CovarianceAdaptation:
    """One climb from a mean, a step size and a shape.

    Parameters
    ----------
    rng : Generator
        Shared with the caller.
    mean : ndarray, (d,)
        Where it starts.
    step : float
        Standard deviation it starts with, in shares of the box.
    samples : int
        Candidates to a generation, 4 or more.
    covariance : ndarray, (d, d), optional
        The shape it starts with, about 1 in the mean of its diagonal; round when left out.
    periodic : ndarray of bool, (d,), optional
        Which variables are circles: they have no walls.

    Attributes
    ----------
    candidates : ndarray, (samples, d)
        What to evaluate next, in the box.
    samples, generation : int
        Candidates to a generation, and generations that have their values.
    reached : float
        The best value so far; ``-inf`` before the first.
    idle : int
        Generations without a better best.
    """

    def __init__(
        self,
        rng: np.random.Generator,
        mean: np.ndarray,
        step: float,
        samples: int,
        covariance: np.ndarray | None = None,
        periodic: np.ndarray | None = None,
    ) -> None:
        d = mean.size
        self._periodic = np.zeros(d, dtype=bool) if periodic is None else periodic
        self._rng = rng
        self._mean, self._step = mean.copy(), float(step)
        self.samples = samples
        self._rates = _Rates(d, samples)
        self._step_path, self._path = np.zeros(d), np.zeros(d)
        self._covariance = np.eye(d) if covariance is None else covariance
        self._axes, self._lengths = np.eye(d), np.ones(d)
        self._decompose()
        self.generation = 0
        self.reached, self.idle = -math.inf, 0
        self._drawn = np.zeros((samples, d))

    @property
    def candidates(self) -> np.ndarray:
        return self._in_box(self._drawn)

    @property
    def width(self) -> float:
        """Of the candidates, in the variable in which they are widest apart."""
        return float(np.ptp(np.where(self._periodic, self._drawn, self.candidates), axis=0).max())

    @property
    def mean(self) -> np.ndarray:
        """Where it stands, (d,), in the box."""
        return self._in_box(self._mean)

    def _in_box(self, points: np.ndarray) -> np.ndarray:
        return np.where(self._periodic, np.mod(points, 1.0), np.clip(points, 0.0, 1.0))

    @property
    def exhausted(self) -> bool:
        """Whether it has arrived, lost its way, or has long found nothing better."""
        longest, shortest = self._lengths.max(), self._lengths.min()
        return bool(
            self._step * longest < NARROW
            or longest > ILL_CONDITIONED * shortest
            or self._step > WIDEST
            or self.idle > CLIMB_PATIENCE + 30 * self._mean.size // self.samples
        )

    def move(self) -> None:
        """Draw the next `candidates`."""
        normal = self._rng.standard_normal((self.samples, self._mean.size))
        self._drawn = self._mean + self._step * (normal * self._lengths) @ self._axes.T

    def tell(self, values: np.ndarray) -> None:
        """Take the values, (samples,), of `candidates`, and move and shape the Gaussian by their ranks."""
        d, use, weights = self._mean.size, self._rates, self._rates.weights.copy()
        self.generation += 1
        steps = ((self._drawn - self._mean) / self._step)[np.argsort(-values, kind="stable")]
        parents = self.samples // 2
        mean_step = weights[:parents] @ steps[:parents]
        beyond = BEYOND * self._step * np.sqrt(np.square(self._axes * self._lengths).sum(axis=1))
        mean = self._mean + self._step * mean_step
        self._mean = np.where(self._periodic, mean, np.clip(mean, -beyond, 1.0 + beyond))
        whitened = self._axes @ ((mean_step @ self._axes) / self._lengths)
        self._step_path = (1.0 - use.c_step) * self._step_path
        self._step_path += math.sqrt(use.c_step * (2.0 - use.c_step) * use.mass) * whitened
        length = float(np.linalg.norm(self._step_path))
        self._step *= math.exp(min(1.0, use.c_step / use.damping * (length / use.expected - 1.0)))
        settled = math.sqrt(1.0 - (1.0 - use.c_step) ** (2 * self.generation + 2))
        steady = float(length / settled < (1.4 + 2.0 / (d + 1.0)) * use.expected)
        self._path = (1.0 - use.c_path) * self._path
        self._path += steady * math.sqrt(use.c_path * (2.0 - use.c_path) * use.mass) * mean_step
        worse = weights < 0.0
        lengths = np.square((steps[worse] @ self._axes) / self._lengths).sum(axis=1)
        weights[worse] *= d / np.maximum(lengths, 1e-12)  # keeps the covariance positive definite
        stalled = (1.0 - steady) * use.c_one * use.c_path * (2.0 - use.c_path)
        self._covariance = (1.0 - use.c_one - use.c_mu * use.weights.sum() + stalled) * self._covariance
        self._covariance += use.c_one * np.outer(self._path, self._path)
        self._covariance += use.c_mu * (steps.T * weights) @ steps
        self._decompose()
        best = float(values.max())
        if best == values.min():
            self._step *= FLAT_GROWTH  # a plateau: look further
        self.idle = 0 if best > self.reached else self.idle + 1
        self.reached = max(best, self.reached)

    def _decompose(self) -> None:
        self._covariance = (self._covariance + self._covariance.T) / 2.0
        variances, self._axes = np.linalg.eigh(self._covariance)
        self._lengths = np.sqrt(np.maximum(variances, _LEAST_VARIANCE))


class _Rates:
    """Weights from the best of so many samples to the worst, and learning rates for d variables (Hansen, Table 1)."""

    def __init__(self, d: int, samples: int) -> None:
        weights = math.log((samples + 1) / 2) - np.log(np.arange(1, samples + 1))
        positive, negative = weights[: samples // 2], np.minimum(weights[samples // 2 :], 0.0)
        positive, total = positive / positive.sum(), -negative.sum()
        self.mass = mass = float(1.0 / np.square(positive).sum())  # variance-effective selection mass, mu_eff
        self.c_one = 2.0 / ((d + 1.3) ** 2 + mass)
        self.c_mu = min(1.0 - self.c_one - 1e-8, 2.0 * (mass - 2.0 + 1.0 / mass) / ((d + 2.0) ** 2 + mass))
        self.c_step = (mass + 2.0) / (d + mass + 5.0)
        self.damping = 1.0 + 2.0 * max(0.0, math.sqrt((mass - 1.0) / (d + 1.0)) - 1.0) + self.c_step
        self.c_path = (4.0 + mass / d) / (d + 4.0 + 2.0 * mass / d)
        self.expected = math.sqrt(d) * (1.0 - 1.0 / (4.0 * d) + 1.0 / (21.0 * d * d))  # length of a normal vector
        share = min(
            1.0 + self.c_one / self.c_mu,
            1.0 + 2.0 * (total**2 / np.square(negative).sum()) / (mass + 2.0),
            (1.0 - self.c_one - self.c_mu) / (d * self.c_mu),
        )
        self.weights = np.concatenate([positive, negative / total * share])
