"""Shares with their intervals, and comparisons of pairs: what a judgement of searches rests on."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ..errors import MissingExtraError

Z_95 = 1.959963984540054  # standard normal, two-sided 95 %


class Share(NamedTuple):
    """A share and its 95 % interval."""

    value: float
    low: float
    high: float


def wilson(successes: int, runs: int) -> Share:
    """Share of successes with Wilson's 95 % interval (1927); `runs` is 1 or more."""
    share, z2 = successes / runs, Z_95**2
    middle = (share + z2 / (2 * runs)) / (1 + z2 / runs)
    reach = Z_95 * math.sqrt(share * (1 - share) / runs + z2 / (4 * runs**2)) / (1 + z2 / runs)
    return Share(share, max(0.0, middle - reach), min(1.0, middle + reach))


def paired_difference(first: Sequence[bool], second: Sequence[bool]) -> Share:
    """Share of successes of the first less that of the second on the same problems, with a 95 % interval.

    Bonett and Price's (2012): Wald's with one added to either kind of disagreement, and two to the runs.
    """
    first, second = np.asarray(first, dtype=bool), np.asarray(second, dtype=bool)
    only_first, only_second, runs = int((first & ~second).sum()), int((~first & second).sum()), first.size
    p, q = (only_first + 1) / (runs + 2), (only_second + 1) / (runs + 2)
    reach = Z_95 * math.sqrt((p + q - (p - q) ** 2) / (runs + 2))
    return Share((only_first - only_second) / runs, max(-1.0, p - q - reach), min(1.0, p - q + reach))


def mcnemar(first: Sequence[bool], second: Sequence[bool]) -> float:
    """Exact two-sided p-value of McNemar's test: of the disagreements, as many favour the first as the second."""
    first, second = np.asarray(first, dtype=bool), np.asarray(second, dtype=bool)
    only_first, only_second = int((first & ~second).sum()), int((~first & second).sum())
    disagree = only_first + only_second
    fewer = min(only_first, only_second)
    tail = sum(math.comb(disagree, k) for k in range(fewer + 1)) * 2
    return min(1.0, tail / 2**disagree)


def wilcoxon(first: Sequence[float], second: Sequence[float]) -> float:
    """Two-sided p-value of Wilcoxon's signed-rank test; NaN where all pairs are equal.

    Raises
    ------
    MissingExtraError
        If SciPy is not installed.
    """
    try:
        from scipy import stats
    except ImportError as error:
        raise MissingExtraError('the tests need SciPy: pip install "blender_lidar[study]"') from error
    difference = np.asarray(first, dtype=float) - np.asarray(second, dtype=float)
    difference = difference[difference != 0.0]
    return float(stats.wilcoxon(difference).pvalue) if difference.size else math.nan
