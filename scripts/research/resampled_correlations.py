"""Correlations and regressions of resampled observations: Spearman, Pearson, partial, of means; their intervals.

A resample is a row of weights: how often each observation is drawn in it. What is computed under such weights equals
what would be computed of the observations written out as often as drawn, ranks included. The first row of weights is
the observations themselves, each once. Whole clusters are drawn.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.special import stdtr

from blender_lidar.statistics import RESAMPLES, resampled_weights, student_t_95

SEED, FOLDS = 1, 10
_ROUNDING = 1e-12  # a variance so far below the mean square is none
_NEARLY_ONE = 1.0 - 1e-12


class Clusters(NamedTuple):
    """What is resampled as one: its name, and the cluster of each car (n,), numbered from 0 without gaps."""

    unit: str
    of_car: np.ndarray

    @property
    def number(self) -> int:
        return int(self.of_car.max()) + 1


def cluster_bootstrap(drawn: Clusters) -> tuple[Clusters, np.ndarray, np.ndarray]:
    """Draw whole clusters with replacement, (1 + r, n) weights, and deal them out to folds, (n,)."""
    rng = np.random.default_rng(SEED)
    weights = resampled_weights(drawn.number, rng, RESAMPLES)[:, drawn.of_car]
    dealt = np.argsort(rng.permutation(drawn.number)) % FOLDS
    return drawn, np.vstack([np.ones((1, weights.shape[1])), weights]), dealt[drawn.of_car]


def pearson(x: np.ndarray, y: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Pearson's r of x and y, (n,) each, in each resample, (r,); NaN where one of them is constant."""
    x, y = x - x.mean(), y - y.mean()
    total = weights.sum(axis=1)
    sx, sy, sxx, syy, sxy = (weights @ column / total for column in (x, y, x * x, y * y, x * y))
    return _ratio(sxy - sx * sy, _positive(sxx - sx * sx, sxx) * _positive(syy - sy * sy, syy))


def centred_ranks(values: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Ranks of the observations (n,) in each resample, less their mean, (r, n).

    Ties, and copies of one observation, share their mean rank. An observation that is not drawn gets the rank between
    its neighbours, which counts nowhere.
    """
    order = np.argsort(values, kind="stable")
    first = np.concatenate([[True], np.diff(values[order]) > 0])  # of its ties
    tied = np.add.reduceat(np.take(weights, order, axis=1), np.flatnonzero(first), axis=1)
    up_to = np.cumsum(tied, axis=1)
    rank = up_to - 0.5 * (tied + up_to[:, -1:])
    place = np.empty(len(values), dtype=np.int64)
    place[order] = np.cumsum(first) - 1
    return np.take(rank, place, axis=1)


def residual(x: np.ndarray, controls: Sequence[np.ndarray], weights: np.ndarray) -> np.ndarray:
    """Residuals of weighted least squares of `x` on the controls and a constant in each resample, (r, n).

    `x` and the controls are (r, n), of mean 0 in each resample, the controls as `orthogonal` makes them; one that is 0
    throughout a resample explains nothing.
    """
    left = x
    for control in controls:
        weighted = weights * control
        slope = _over(_dot(weighted, left), _dot(weighted, control))
        left = left - slope[:, None] * control
    kept = _positive(_dot(weights * left, left), _dot(weights * x, x))
    return left * (kept > 0.0)[:, None]


def orthogonal(controls: Sequence[np.ndarray], weights: np.ndarray) -> list[np.ndarray]:
    """Gram-Schmidt: controls, (r, n) each and of mean 0, made orthogonal to those before them in each resample."""
    made: list[np.ndarray] = []
    for control in controls:
        made.append(residual(control, made, weights))
    return made


def correlation(x: np.ndarray, y: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Pearson's r in each resample, (r,), of values of mean 0 there, (r, n) each; NaN where one of them is constant."""
    weighted = weights * x
    return _ratio(_dot(weighted, y), _dot(weighted, x) * _dot(weights * y, y))


def group_means(values: np.ndarray, group: np.ndarray, groups: int, weights: np.ndarray) -> np.ndarray:
    """Mean of the values, (n,), in each of the groups that `group` (n,) numbers, (r, groups); NaN in an empty one."""
    member = np.equal.outer(group, np.arange(groups)).astype(float)
    return _over(weights @ (member * values[:, None]), weights @ member, empty=np.nan)


def correlation_of_means(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Pearson's r over the groups of each resample, (r,), of two means, (r, g) each; groups with a NaN are left out.

    NaN with fewer than three groups or without spread.
    """
    there = np.isfinite(x) & np.isfinite(y)
    number = there.sum(axis=1, keepdims=True)
    off = []
    for values in (np.where(there, x, 0.0), np.where(there, y, 0.0)):
        apart = np.where(there, values - values.sum(axis=1, keepdims=True) / np.maximum(number, 1), 0.0)
        off.append(apart * (_positive(_dot(apart, apart), _dot(values, values)) > 0.0)[:, None])
    return np.where(number[:, 0] >= 3, correlation(*off, there.astype(float)), np.nan)


def cross_validated_r2(x: np.ndarray, y: np.ndarray, fold: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Out-of-fold coefficient of determination of a linear regression of y on x, (n,) each, in each resample, (r,).

    1 less the squared errors over those of the other folds' mean. Lines are fitted once, to the observations
    themselves: resamples draw from their errors.
    """
    error, of_mean = np.zeros((2, len(y)))
    for number in range(int(fold.max()) + 1):
        out = fold == number
        off = x[~out] - x[~out].mean()
        slope = float(off @ y[~out]) / float(off @ off)
        error[out] = y[out] - (y[~out].mean() + slope * (x[out] - x[~out].mean()))
        of_mean[out] = y[out] - y[~out].mean()
    return 1.0 - _over(weights @ error**2, weights @ of_mean**2, empty=np.nan)


def _positive(variance, scale):
    """A variance, or 0 where it is no more than rounding of numbers of that mean square."""
    return np.where(variance > _ROUNDING * scale, variance, 0.0)


def _dot(x, y):
    return np.einsum("rn,rn->r", x, y)


def _over(part, whole, empty=0.0):
    return np.divide(part, whole, out=np.full(np.shape(whole), empty), where=whole > 0.0)


def _ratio(product_, squares):
    return np.clip(_over(product_, np.sqrt(squares), empty=np.nan), -1.0, 1.0)


class Estimate(NamedTuple):
    """A value and its 90 % interval; of a difference also how probable one as large would be were there none."""

    value: float
    low: float = math.nan
    high: float = math.nan
    p_above: float = math.nan

    def text(self, digits: int = 2, sign: str = "") -> str:
        """For people: ``0.81 (0.74 to 0.87)``; with `sign` ``"+"`` all three bear one."""
        value, low, high = (f"{number:{sign}.{digits}f}" for number in self[:3])
        if not math.isfinite(self.low):
            return value if math.isfinite(self.value) else "-"
        return f"{value} ({low} to {high})"


def of_correlation(values: np.ndarray, number: int) -> Estimate:
    """Of a correlation: first its value, then those of the resamples of so many clusters, (1 + r,).

    Student's t with number - 1 degrees of freedom times the resampled standard deviation of Fisher's z, turned back.
    """
    value, resampled = float(values[0]), values[1:][np.isfinite(values[1:])]
    if not math.isfinite(value) or len(resampled) < 2:
        return Estimate(value)
    z, middle = (np.arctanh(np.clip(r, -_NEARLY_ONE, _NEARLY_ONE)) for r in (resampled, value))
    reach = student_t_95(number - 1) * np.std(z)
    return Estimate(value, math.tanh(middle - reach), math.tanh(middle + reach))


def of_difference(first: np.ndarray, second: np.ndarray, number: int) -> Estimate:
    """Of the first less the second, both (1 + r,) in the same resamples: Student's t times the resampled deviation."""
    apart = first - second
    value, resampled = float(apart[0]), apart[1:][np.isfinite(apart[1:])]
    spread = float(np.std(resampled)) if len(resampled) else 0.0
    if spread == 0.0:  # the same in every resample
        return Estimate(value, value, value)
    reach = student_t_95(number - 1) * spread
    return Estimate(value, value - reach, value + reach, float(stdtr(number - 1, -value / spread)))
