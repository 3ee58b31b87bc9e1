"""Block bootstrap: intervals that resample blocks of time, as frames close in time show the same vehicles."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import lru_cache

import numpy as np

RESAMPLES = 2000
FEWEST_BLOCKS = 3  # with fewer no interval is given
FEW_BLOCKS = 6  # with fewer an interval is no ground to hang a LiDAR on
FEW_VEHICLES = 10  # different ones; with fewer a share has no interval
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(64)
_LARGEST_PROBABILITY = 1.0 - 1e-9
_RESAMPLES_AT_ONCE = 100  # of many mountings: all at once may fill the memory
_HALF_A_BOX = 0.5  # less off 0 or 100 % of a block tells as little as nothing off
_HALVINGS = 60  # of the angle: as near as floats come


def block_sums(values: np.ndarray, block: np.ndarray) -> np.ndarray:
    """Sums of per-frame values (..., f) over the frames of each block, (..., b); `block` (f,) labels the frames."""
    labels, row = np.unique(block, return_inverse=True)
    sums = np.zeros((*values.shape[:-1], len(labels)))
    np.add.at(np.moveaxis(sums, -1, 0), row, np.moveaxis(np.asarray(values, dtype=float), -1, 0))
    return sums


def of_blocks(values: np.ndarray, block: np.ndarray) -> np.ndarray:
    """What all frames of a block share, such as their recording, from values of each frame: (f,) becoming (b,)."""
    return values[np.unique(block, return_index=True)[1]]


def resampled_weights(
    blocks: int, rng: np.random.Generator, resamples: int = RESAMPLES, stratum: np.ndarray | None = None
) -> np.ndarray:
    """Weights of the block bootstrap: how often each block is drawn in each resample, (resamples, blocks).

    One block fewer is drawn than there are: with few blocks the plain bootstrap is too narrow by the factor sqrt((b -
    1) / b), and this rescaling (Rao and Wu 1988) mends it. With several strata, `stratum` (blocks,), blocks are drawn
    within each, and then count for as many as the stratum has.
    """
    if stratum is not None and (stratum != stratum[0]).any():
        weights = np.zeros((resamples, blocks))
        for own in (stratum == label for label in np.unique(stratum)):
            count = int(own.sum())
            weights[:, own] = resampled_weights(count, rng, resamples) * (count / (count - 1))
        return weights
    drawn = rng.integers(blocks, size=(resamples, blocks - 1))
    weights = np.zeros((resamples, blocks))
    np.add.at(weights, (np.arange(resamples)[:, None], drawn), 1.0)
    return weights


def degrees_of_freedom(stratum: np.ndarray) -> int:
    """Degrees of freedom of a mean over blocks, one lost for each stratum; `stratum` (b,) is that of each block.

    0 where no interval is to be had: with fewer than `FEWEST_BLOCKS` blocks, or a stratum that has one alone.
    """
    counts = np.unique(stratum, return_counts=True)[1]
    return 0 if len(stratum) < FEWEST_BLOCKS or counts.min() < 2 else int((counts - 1).sum())


def drawn_blocks(
    vehicles: np.ndarray, seed: int, stratum: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray, int] | None:
    """Block bootstrap of the blocks that have vehicles: which these are, their weights, and the degrees of freedom.

    Parameters
    ----------
    vehicles : ndarray, (b,)
        Of each block, or the sum of their weights.
    seed : int
        For the resampling.
    stratum : ndarray, (b,), optional
        Recording of each block, where there are several.

    Returns
    -------
    filled : ndarray of bool, (b,)
    weights : ndarray, (resamples, filled blocks)
        As of `resampled_weights`.
    degrees : int
        Of `degrees_of_freedom`; None in place of all three where there are too few blocks.
    """
    filled = vehicles > 0
    strata = np.zeros(int(filled.sum())) if stratum is None else stratum[filled]
    degrees = degrees_of_freedom(strata)
    if not degrees:
        return None
    return filled, resampled_weights(len(strata), np.random.default_rng(seed), stratum=strata), degrees


def interval_90(values: np.ndarray) -> tuple[float, float]:
    """Percentile interval: the middle 90 % of resampled values."""
    low, high = np.quantile(values, [0.05, 0.95])
    return float(low), float(high)


def ratio_interval_90(numerator: np.ndarray, denominator: np.ndarray, seed: int) -> tuple[float, float] | None:
    """90 % bootstrap interval of a ratio, sum(numerator) / sum(denominator), from the sums of each block (b,).

    Blocks whose denominator is 0 say nothing and are left out; None for fewer than `FEWEST_BLOCKS`.
    """
    filled = denominator > 0
    numerator, denominator = numerator[filled], denominator[filled]
    return statistic_interval_90(lambda counts: counts @ numerator / (counts @ denominator), denominator, seed)


def statistic_interval_90(
    statistic: Callable[[np.ndarray], np.ndarray],
    vehicles: np.ndarray,
    seed: int,
    stratum: np.ndarray | None = None,
) -> tuple[float, float] | None:
    """90 % bootstrap interval of a statistic of blocks, of which each has so many vehicles, (b,).

    Student's t times the resampled standard deviation: with few blocks, percentiles of resamples cover too little (80 %
    instead of 90 % with five). `statistic` takes how often each block counts, (r, b), and gives its value for each of
    the r. `stratum` (b,) is the recording of each block, where there are several. None for too few blocks.
    """
    if (drawn := drawn_blocks(vehicles, seed, stratum)) is None:
        return None
    filled, of_filled, degrees = drawn
    weights = np.zeros((RESAMPLES, len(filled)))
    weights[:, filled] = of_filled
    reach = student_t_95(degrees) * float(np.std(statistic(weights)))
    middle = float(statistic(np.ones((1, len(filled))))[0])
    return middle - reach, middle + reach


def many_to_one_reach_90(
    objective: np.ndarray, weight: np.ndarray, seed: int, stratum: np.ndarray | None = None
) -> np.ndarray | None:
    """Simultaneous 90 % intervals of differences to the first of several means, by the bootstrap of the largest t.

    Half their widths: with 90 % probability all hold together (many-to-one comparisons as Dunnett's, with the
    studentised maximum resampled: Romano and Wolf 2005, Econometrica 73). The resampled maximum is carried from the
    normal distribution over to Student's t at the same probability, as with few blocks resamples vary too little.

    Parameters
    ----------
    objective : ndarray, (k, b)
        Of each of k mountings in each block; the first is the one that the others are compared with.
    weight : ndarray, (b,)
        Vehicles of each block, or the sum of their weights.
    seed : int
        For the resampling of blocks, which is the same for all.
    stratum : ndarray, (b,), optional
        Recording of each block, where there are several.

    Returns
    -------
    ndarray, (k,)
        The first is 0; None for too few blocks with vehicles.
    """
    if (drawn := drawn_blocks(weight, seed, stratum)) is None:
        return None
    filled, counts, degrees = drawn
    objective, weight = objective[:, filled], weight[filled]
    resampled = counts @ objective.T / (counts @ weight)[:, None]
    off = resampled - resampled[:, :1] - (objective - objective[0]).sum(axis=1) / weight.sum()
    error = off.std(axis=0)
    largest = (np.abs(off) / np.where(error > 0.0, error, np.inf)).max(axis=1)
    probability = 0.5 * (1.0 + math.erf(float(np.quantile(largest, 0.9)) / math.sqrt(2.0)))
    return student_t(min(probability, _LARGEST_PROBABILITY), degrees) * error


def best_intervals_90(
    x: np.ndarray,
    block_objective: np.ndarray,
    block_weight: np.ndarray,
    answer: np.ndarray,
    periodic: Sequence[bool],
    seed: int,
    stratum: np.ndarray | None = None,
) -> list[tuple[float, float]] | None:
    """90 % interval of each coordinate of the best mounting of those that were tried, under block resampling.

    Parameters
    ----------
    x : ndarray, (n, d)
        What was tried.
    block_objective : ndarray, (n, b)
        Objective of each in each block of time.
    block_weight : ndarray, (b,)
        Vehicles of each block, or the sum of their weights.
    answer : ndarray, (d,)
        About which a coordinate that is a full circle is given, `periodic` (d,).
    seed : int
        For the resampling of blocks.
    stratum : ndarray, (b,), optional
        Recording of each block, where there are several.

    Returns
    -------
    list of (float, float), d
        None for too few blocks that have vehicles.
    """
    if (drawn := drawn_blocks(block_weight, seed, stratum)) is None:
        return None
    filled, weights, _ = drawn
    per_block, best = block_objective[:, filled].T, np.empty(len(weights), dtype=int)
    for start in range(0, len(weights), _RESAMPLES_AT_ONCE):  # each divides all by the same vehicles
        part = slice(start, start + _RESAMPLES_AT_ONCE)
        best[part] = np.argmax(weights[part] @ per_block, axis=1)
    found = x[best]
    turned = answer + np.mod(found - answer + 180.0, 360.0) - 180.0
    return [interval_90(values) for values in np.where(periodic, turned, found).T]


def best_without_block(sums: np.ndarray) -> np.ndarray:
    """Cross-fitting: for each block the row that is best on the others, (b,), from sums of k rows over blocks (k, b).

    With `FEW_BLOCKS` or more a block's neighbours do not choose for it either, as some of its vehicles are in them
    (h-block cross-validation: Burman, Chow and Nolan 1994).
    """
    number = np.arange(sums.shape[1])
    aside = 1 if len(number) >= FEW_BLOCKS else 0
    return np.argmax(sums @ (np.abs(number[:, None] - number) > aside), axis=0)


def linear_interval_90(middle: float, influence: np.ndarray) -> tuple[float, float] | None:
    """90 % interval of a ratio of sums by linearisation, from how far each block moves it, (b,); None for too few.

    The ratio is taken as linear in the blocks (Cochran 1977, section 6.4): where there is little to divide by it is
    nothing at all in some resamples.
    """
    blocks = len(influence)
    if blocks < FEWEST_BLOCKS:
        return None
    reach = student_t_95(blocks - 1) * float(np.sqrt(blocks / (blocks - 1) * (influence**2).sum()))
    return middle - reach, middle + reach


def clopper_pearson_90(hits: float, trials: int) -> tuple[float, float]:
    """90 % interval of a share by Clopper and Pearson (1934, Biometrika 26): `hits` of independent `trials`.

    Where the hits are not whole they are rounded away from the middle of the interval, which makes it wider.
    """

    def at_least(fewest: int, share: float) -> float:
        number = np.arange(fewest, trials + 1)
        return float(np.exp(choices[number] + number * math.log(share) + (trials - number) * math.log1p(-share)).sum())

    def where(fewest: int, probability: float) -> float:
        low, high = 0.0, 1.0
        for _ in range(_HALVINGS):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if at_least(fewest, middle) < probability else (low, middle)
        return low

    factorial = np.concatenate([[0.0], np.cumsum(np.log(np.arange(1.0, trials + 1.0)))])
    choices = factorial[-1] - factorial - factorial[::-1]
    fewest, most = math.floor(hits + 1e-9), math.ceil(hits - 1e-9)
    return where(fewest, 0.05) if fewest else 0.0, where(most + 1, 0.95) if most < trials else 1.0


def share_interval_90(
    hits: np.ndarray, vehicle: np.ndarray, block: np.ndarray, seed: int, stratum: np.ndarray | None = None
) -> tuple[float, float] | None:
    """90 % interval of the share of boxes of which something is true, over blocks of time.

    What is true of a box may be a share itself, as of installations, from 0 to 1.

    Where all but two blocks at most have 0 or 100 %, resampling them tells next to nothing: the interval then also
    holds that of Clopper and Pearson, for which each different vehicle is one trial, hit in the share of its boxes.

    Parameters
    ----------
    hits : ndarray, (n,)
        One for each box, a vehicle in one frame: whether it is true of it, or with which probability.
    vehicle : ndarray, (n,)
        The vehicle of each box.
    block : ndarray of int, (n,)
        Its block of time.
    seed : int
        For the resampling of blocks.
    stratum : ndarray, (n,), optional
        Its recording, where there are several.

    Returns
    -------
    (float, float) or None
        Within 0 to 1; None for fewer than `FEW_VEHICLES` different vehicles, or too few blocks.
    """
    ends, is_extreme = _mean_over_blocks(hits.astype(float), block, seed, stratum)
    if ends is None or len(np.unique(vehicle)) < FEW_VEHICLES:
        return None
    if is_extreme:
        exact = _share_of_vehicles(hits, vehicle)
        ends = min(ends[0], exact[0]), max(ends[1], exact[1])
    return max(ends[0], 0.0), min(ends[1], 1.0)


def drawn_share_interval_90(
    hits: np.ndarray,
    vehicle: np.ndarray,
    block: np.ndarray,
    draw: np.ndarray,
    seed: int,
    stratum: np.ndarray | None = None,
) -> tuple[float, float] | None:
    """90 % interval of the share of boxes of which something is true in traffic that was drawn several times.

    Blocks of time and draws are crossed: ``V = V_blocks + V_draws`` with ``V_blocks`` the variance of the share of all
    draws together when blocks are resampled, and ``V_draws = s^2 / D`` of the shares of the D draws, as for crossed
    random effects (Owen 2007, The pigeonhole bootstrap, Annals of Applied Statistics 1), without the term that both
    count: the interval is rather too wide than too narrow. Half its width is Student's t times sqrt(V), with the
    degrees of freedom of Welch and Satterthwaite (1946, Biometrics Bulletin 2), ``V^2 / (V_blocks^2 / (B - 1) +
    V_draws^2 / (D - 1))``.

    Parameters
    ----------
    hits : ndarray, (n,)
        0 to 1, one for each box of each draw.
    vehicle, block, stratum, seed
        As `share_interval_90`, whose interval it is for one draw, and which it always holds.
    draw : ndarray of int, (n,)
        The draw of each box.

    Returns
    -------
    (float, float) or None
        Within 0 to 1; None where `share_interval_90` is.
    """
    ends = share_interval_90(hits, vehicle, block, seed, stratum)
    shares = block_sums(hits, draw) / block_sums(np.ones(len(draw)), draw)
    if ends is None or len(shares) < 2:
        return ends
    boxes, strata = block_sums(np.ones(len(block)), block), None if stratum is None else of_blocks(stratum, block)
    blocks = degrees_of_freedom(np.zeros(len(boxes)) if strata is None else strata)
    middle, of_blocks_alone = float(np.mean(hits)), _mean_over_blocks(hits, block, seed, stratum)[0]
    by_blocks = ((of_blocks_alone[1] - middle) / student_t_95(blocks)) ** 2
    by_draws = float(np.var(shares, ddof=1)) / len(shares)
    if not by_draws:
        return ends
    whole = by_blocks + by_draws
    degrees = whole**2 / (by_blocks**2 / blocks + by_draws**2 / (len(shares) - 1))
    reach = student_t_95(degrees) * math.sqrt(whole)
    return max(min(ends[0], middle - reach), 0.0), min(max(ends[1], middle + reach), 1.0)


def share_gain_interval_90(
    before: np.ndarray,
    after: np.ndarray,
    vehicle: np.ndarray,
    block: np.ndarray,
    seed: int,
    stratum: np.ndarray | None = None,
) -> tuple[float, float] | None:
    """90 % interval of the difference of two shares of the same boxes, paired over blocks of time.

    Where all but two blocks at most have a difference of -1, 0 or 1, the interval also holds what Clopper and Pearson
    allow of boxes that were won, and of boxes that were lost. Otherwise as `share_interval_90`.
    """
    ends, is_extreme = _mean_over_blocks(after.astype(float) - before, block, seed, stratum)
    if ends is None or len(np.unique(vehicle)) < FEW_VEHICLES:
        return None
    if is_extreme:
        change = after.astype(float) - before
        won, lost = (_share_of_vehicles(np.maximum(boxes, 0.0), vehicle) for boxes in (change, -change))
        ends = min(ends[0], won[0] - lost[1]), max(ends[1], won[1] - lost[0])
    return max(ends[0], -1.0), min(ends[1], 1.0)


def _mean_over_blocks(
    values: np.ndarray, block: np.ndarray, seed: int, stratum: np.ndarray | None
) -> tuple[tuple[float, float] | None, bool]:
    """Interval of the mean of values (n,) over blocks, and whether all but two blocks at most have whole means.

    A mean counts as whole within half a box: what is true of a box may be a share, as of installations.
    """
    boxes, strata = block_sums(np.ones(len(block)), block), None if stratum is None else of_blocks(stratum, block)
    sums = block_sums(values, block)
    ends = statistic_interval_90(lambda weights: weights @ sums / (weights @ boxes), boxes, seed, strata)
    off = np.abs(sums - boxes * (sums / boxes).round())
    return ends, (off > _HALF_A_BOX).sum() < FEWEST_BLOCKS


def _share_of_vehicles(hits: np.ndarray, vehicle: np.ndarray) -> tuple[float, float]:
    """Clopper and Pearson's interval, for which each different vehicle is one trial."""
    row = np.unique(vehicle, return_inverse=True)[1].reshape(-1)
    boxes = np.bincount(row)
    return clopper_pearson_90(float((block_sums(hits, row) / boxes).sum()), len(boxes))


def student_t_95(degrees: float) -> float:
    """95 % point of Student's t: half the width of a 90 % interval, in standard errors; see `student_t`."""
    return student_t(0.95, degrees)


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
