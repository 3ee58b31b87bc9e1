"""Intervals that resample blocks of time: frames close in time show the same vehicles, and are no new evidence."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import lru_cache

import numpy as np

RESAMPLES = 2000
FEWEST_BLOCKS = 3  # with fewer no interval is given
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(64)
_HALVINGS = 60  # of the angle: as near as floats come
# Student's t, 95 % point, for 1 to 30 degrees of freedom (any statistics table).
_STUDENT_T_95 = (
    *(6.314, 2.920, 2.353, 2.132, 2.015, 1.943, 1.895, 1.860, 1.833, 1.812),
    *(1.796, 1.782, 1.771, 1.761, 1.753, 1.746, 1.740, 1.734, 1.729, 1.725),
    *(1.721, 1.717, 1.714, 1.711, 1.708, 1.706, 1.703, 1.701, 1.699, 1.697),
)


def block_sums(values: np.ndarray, block: np.ndarray) -> np.ndarray:
    """Sums of per-frame values (..., f) over the frames of each block, (..., b); `block` (f,) labels the frames."""
    labels, row = np.unique(block, return_inverse=True)
    sums = np.zeros((*values.shape[:-1], len(labels)))
    np.add.at(np.moveaxis(sums, -1, 0), row, np.moveaxis(np.asarray(values, dtype=float), -1, 0))
    return sums


def resampled_weights(blocks: int, rng: np.random.Generator, resamples: int = RESAMPLES) -> np.ndarray:
    """How often each block is drawn in each resample, (resamples, blocks).

    One block fewer is drawn than there are: with few blocks the plain bootstrap is too narrow by the factor sqrt((b -
    1) / b), and this rescaling (Rao and Wu 1988) mends it.
    """
    drawn = rng.integers(blocks, size=(resamples, blocks - 1))
    weights = np.zeros((resamples, blocks))
    np.add.at(weights, (np.arange(resamples)[:, None], drawn), 1.0)
    return weights


def interval_90(values: np.ndarray) -> tuple[float, float]:
    """The middle 90 % of resampled values."""
    low, high = np.quantile(values, [0.05, 0.95])
    return float(low), float(high)


def ratio_interval_90(numerator: np.ndarray, denominator: np.ndarray, seed: int) -> tuple[float, float] | None:
    """90 % interval of sum(numerator) / sum(denominator), from the sums of each block (b,).

    Student's t with b - 1 degrees of freedom times the resampled standard deviation: with few blocks, percentiles of
    resamples cover too little (80 % instead of 90 % with five). Blocks whose denominator is 0 say nothing and are left
    out; None for fewer than `FEWEST_BLOCKS`.
    """
    filled = denominator > 0
    numerator, denominator = numerator[filled], denominator[filled]
    if len(numerator) < FEWEST_BLOCKS:
        return None
    weights = resampled_weights(len(numerator), np.random.default_rng(seed))
    spread = float(np.std((weights @ numerator) / (weights @ denominator)))
    middle = float(numerator.sum() / denominator.sum())
    reach = student_t_95(len(numerator) - 1) * spread
    return middle - reach, middle + reach


def difference_interval_90(
    first: tuple[np.ndarray, np.ndarray], second: tuple[np.ndarray, np.ndarray], seed: int
) -> tuple[float, float] | None:
    """90 % interval of one ratio less another, each of block sums (numerator, denominator), (b,), of the same blocks.

    As `ratio_interval_90`, both ratios under the same resamples; those in which one of them has no vehicle are left
    out. None where one of the two has fewer than `FEWEST_BLOCKS` blocks with vehicles.
    """
    if min(int((denominator > 0).sum()) for _, denominator in (first, second)) < FEWEST_BLOCKS:
        return None
    filled = (first[1] > 0) | (second[1] > 0)
    weights = resampled_weights(int(filled.sum()), np.random.default_rng(seed))
    drawn = [(weights @ numerator[filled], weights @ denominator[filled]) for numerator, denominator in (first, second)]
    kept = (drawn[0][1] > 0) & (drawn[1][1] > 0)
    ratios = [numerator[kept] / denominator[kept] for numerator, denominator in drawn]
    spread = float(np.std(ratios[0] - ratios[1]))
    middle = float(first[0].sum() / first[1].sum() - second[0].sum() / second[1].sum())
    reach = student_t_95(int(filled.sum()) - 1) * spread
    return middle - reach, middle + reach


def statistic_interval_90(
    statistic: Callable[[np.ndarray], np.ndarray], vehicles: np.ndarray, seed: int
) -> tuple[float, float] | None:
    """90 % interval of a statistic of blocks, of which each has so many vehicles, (b,).

    As `ratio_interval_90`, which it equals for a ratio; `statistic` takes how often each block counts, (r, b), and
    gives its value for each of the r.
    """
    filled = vehicles > 0
    blocks = int(filled.sum())
    if blocks < FEWEST_BLOCKS:
        return None
    weights = np.zeros((RESAMPLES, len(filled)))
    weights[:, filled] = resampled_weights(blocks, np.random.default_rng(seed))
    reach = student_t_95(blocks - 1) * float(np.std(statistic(weights)))
    middle = float(statistic(np.ones((1, len(filled))))[0])
    return middle - reach, middle + reach


def linear_interval_90(middle: float, influence: np.ndarray) -> tuple[float, float] | None:
    """90 % interval of a ratio of sums over blocks, by how far each block moves it, (b,); None for too few blocks.

    The ratio is taken as linear in the blocks (Cochran 1977, section 6.4): where there is little to divide by it is
    nothing at all in some resamples.
    """
    blocks = len(influence)
    if blocks < FEWEST_BLOCKS:
        return None
    reach = student_t_95(blocks - 1) * float(np.sqrt(blocks / (blocks - 1) * (influence**2).sum()))
    return middle - reach, middle + reach


def student_t_95(degrees: int) -> float:
    """The 95 % point of Student's t; beyond the table by the first term of its Cornish-Fisher expansion."""
    if degrees <= len(_STUDENT_T_95):
        return _STUDENT_T_95[degrees - 1]
    return 1.645 + 1.524 / degrees


@lru_cache(maxsize=256)
def student_t(probability: float, degrees: float) -> float:
    """The point that Student's t is below with a probability between 0.5 and 1, to nine digits.

    With t = sqrt(v) tan(a) the distribution of v degrees of freedom is the integral of cos(a) ** (v - 1), which is
    smooth: solved for a by bisection.

    Raises
    ------
    ValueError
        For another probability, or less than one degree of freedom.
    """
    if not (0.5 <= probability < 1.0 and degrees >= 1):
        raise ValueError(f"probability {probability:g}, degrees {degrees}; allowed: 0.5 up to 1, and 1 or more")
    whole = math.sqrt(math.pi) * math.exp(math.lgamma(degrees / 2.0) - math.lgamma((degrees + 1.0) / 2.0))
    low, high = 0.0, 0.5 * math.pi
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        angles = 0.5 * middle * (1.0 + _NODES)
        below = 0.5 + 0.5 * middle * float(_WEIGHTS @ np.cos(angles) ** (degrees - 1.0)) / whole
        low, high = (middle, high) if below < probability else (low, middle)
    return math.sqrt(degrees) * math.tan(low)
