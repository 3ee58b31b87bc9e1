"""Intervals and p-values from resampled clusters, and what many comparisons do to them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ..study.statistics import FEWEST_BLOCKS, interval_90, student_t_95

_NEARLY_ONE = 1.0 - 1e-12


class Estimate(NamedTuple):
    """A value and its 90 % interval; NaN where there is none."""

    value: float
    low: float = math.nan
    high: float = math.nan

    def text(self, digits: int = 2) -> str:
        """For people: ``0.81 (0.74 to 0.87)``."""
        if not math.isfinite(self.value):
            return "-"
        if not math.isfinite(self.low):
            return f"{self.value:.{digits}f}"
        return f"{self.value:.{digits}f} ({self.low:.{digits}f} to {self.high:.{digits}f})"


class Difference(NamedTuple):
    """A difference with its 90 % interval, and how probable one as large or larger would be were it none.

    The probability is NaN where nothing can be told, or the two are the same in every resample.
    """

    value: float
    low: float
    high: float
    p_above: float


def of_correlation(values: np.ndarray, clusters: int) -> Estimate:
    """Of a correlation: first its value, then those of the resamples, (1 + r,).

    Student's t with clusters - 1 degrees of freedom times the resampled standard deviation of Fisher's z, turned back.
    """
    value, resampled = float(values[0]), values[1:][np.isfinite(values[1:])]
    if not math.isfinite(value) or clusters < FEWEST_BLOCKS or len(resampled) < 2:
        return Estimate(value)
    z = np.arctanh(np.clip(resampled, -_NEARLY_ONE, _NEARLY_ONE))
    middle = math.atanh(min(max(value, -_NEARLY_ONE), _NEARLY_ONE))
    reach = student_t_95(clusters - 1) * float(np.std(z))
    return Estimate(value, math.tanh(middle - reach), math.tanh(middle + reach))


def of_resamples(values: np.ndarray, clusters: int) -> Estimate:
    """Of anything else: its value and the middle 90 % of those of the resamples, (1 + r,)."""
    value, resampled = float(values[0]), values[1:][np.isfinite(values[1:])]
    if not math.isfinite(value) or clusters < FEWEST_BLOCKS or len(resampled) < 2:
        return Estimate(value)
    return Estimate(value, *interval_90(resampled))


def of_difference(first: np.ndarray, second: np.ndarray, clusters: int) -> Difference:
    """Of the first less the second, both (1 + r,) in the same resamples: Student's t times the resampled deviation."""
    apart = first - second
    value, resampled = float(apart[0]), apart[1:][np.isfinite(apart[1:])]
    if not math.isfinite(value) or clusters < FEWEST_BLOCKS or len(resampled) < 2:
        return Difference(value, math.nan, math.nan, math.nan)
    spread = float(np.std(resampled))
    if spread == 0.0:  # the same in every resample
        return Difference(value, value, value, math.nan if value == 0.0 else float(value < 0.0))
    reach = student_t_95(clusters - 1) * spread
    return Difference(value, value - reach, value + reach, student_t_above(value / spread, clusters - 1))


def student_t_above(t: float, degrees: int) -> float:
    """Probability that Student's t with a whole number of degrees of freedom exceeds `t`.

    Abramowitz and Stegun, 26.7.3 and 26.7.4.
    """
    angle = math.atan(t / math.sqrt(degrees))
    sin, cos = math.sin(angle), math.cos(angle)
    odd = degrees % 2
    term = cos if odd else 1.0
    total = 0.0 if degrees == 1 else term
    for number in range(2 + odd, degrees - 1, 2):
        term *= cos * cos * (number - 1) / number
        total += term
    within = 2.0 / math.pi * (angle + sin * total) if odd else sin * total
    return min(max(0.5 * (1.0 - within), 0.0), 1.0)


def holm(p_values: Sequence[float]) -> list[float]:
    """P-values adjusted for their number (Holm 1979), in the order given; NaN stays and does not count."""
    adjusted = [math.nan] * len(p_values)
    order = sorted((p, place) for place, p in enumerate(p_values) if not math.isnan(p))
    largest = 0.0
    for rank, (p, place) in enumerate(order):
        largest = max(largest, min(1.0, (len(order) - rank) * p))
        adjusted[place] = largest
    return adjusted
