"""What a change does to score, ranking and choice of mountings: the statistics of all studies.

Share of the gain that is lost, ranking (weighted Kendall's tau), cross-fitted calibration, regret of choices on
resampled blocks of traffic, and the noise ceiling of halved blocks.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from ..statistics import FEWEST_BLOCKS, interval_90, linear_interval_90, resampled_weights, student_t
from ..world.shapes import DETAILS
from .candidates import BASELINE, FIRST
from .driver import Landscape

# --- one score beside another: ranking, calibration, Pareto front -----------------------------------------------------


def weighted_tau(values: np.ndarray, reference: np.ndarray) -> float:
    """Kendall's tau-b of two scores (k,), each pair weighted by the reference's ranks (Vigna 2015).

    The weight of a pair is ``1 / (1 + r) + 1 / (1 + s)`` with the ranks r and s, 0 for the best: additive and
    hyperbolic. Of mountings that the reference holds for equal, those that `values` holds for better rank first.

    Returns
    -------
    float
        From -1 to 1; NaN where one of the two prefers no mounting to another.
    """
    from scipy.stats import weightedtau

    rank = np.empty(len(reference), dtype=int)
    rank[np.lexsort((values, reference))[::-1]] = np.arange(len(reference))
    return float(weightedtau(values, reference, rank=rank).statistic)


def calibrated_residuals(values: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """Residuals of a cross-fitted linear regression: reference less ``a + b values``, (k,).

    For each half of the mountings a and b are fitted by least squares on the other half; where `values` prefers no
    mounting to another, b is 0.
    """
    half = len(values) // 2
    first, second = slice(0, half), slice(half, None)
    residuals = np.empty(len(values))
    for judged, fitted in ((first, second), (second, first)):
        middle, away = values[fitted].mean(), values[fitted] - values[fitted].mean()
        slope = away @ reference[fitted] / max(away @ away, np.finfo(float).tiny)
        residuals[judged] = reference[judged] - reference[fitted].mean() - slope * (values[judged] - middle)
    return residuals


def agreement(values: np.ndarray, reference: np.ndarray) -> tuple[float, float, float]:
    """Mean bias of `values` (k,), root mean square error after calibration, and weighted Kendall's tau."""
    error = np.sqrt(np.mean(np.square(calibrated_residuals(values, reference))))
    return float(np.mean(values - reference)), float(error), weighted_tau(values, reference)


def pareto_front(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Rows that no other row is as good as in both costs and better than in one, (f,), by rising first cost.

    Equal rows are all kept.
    """
    no_worse = (first[:, None] <= first) & (second[:, None] <= second)
    better = (first[:, None] < first) | (second[:, None] < second)
    order = np.lexsort((second, first))
    return order[~(no_worse & better).any(axis=0)[order]]


# --- what choices lose, as a share of the gain ------------------------------------------------------------------------


SURE = 0.95  # of all tests together: see `chart.mark_within`
BOUND_LEVEL = 1.0 - (1.0 - SURE) / len(DETAILS)  # of each test's bound, one-sided
DRAWS = 300  # resamples of the searched blocks, under each of which a mounting is chosen


class Lost(NamedTuple):
    """What is lost, as a share of the gain, its 90 % interval, None for too few blocks, and how many blocks judge."""

    share: float
    interval_90: tuple[float, float] | None
    blocks: int

    def bound(self, level: float) -> float | None:
        """The loss is no greater with so much confidence; None for too few blocks."""
        if self.interval_90 is None:
            return None
        reach = (self.interval_90[1] - self.share) / student_t(0.95, self.blocks - 1)
        return self.share + reach * student_t(level, self.blocks - 1)


def share_lost(lost: np.ndarray, gain: np.ndarray, filled: np.ndarray) -> Lost | None:
    """Sum of what is lost over the sum of the gain that there was to have, each given block by block, (d, b).

    A mean over d random draws, whose blocks are the same. `filled` (b,) are the blocks with vehicles. None where a draw
    gains nothing.
    """
    lost, gain = np.atleast_2d(lost, gain)
    whole = gain.sum(axis=1, keepdims=True)
    if not (whole > 0.0).all():
        return None
    shares = lost.sum(axis=1, keepdims=True) / whole
    influence = ((lost - shares * gain) / whole).mean(axis=0)[filled]  # how far each block moves the share
    share = float(shares.mean())
    return Lost(share, linear_interval_90(share, influence), len(influence))


def searched_weights(block: np.ndarray, seed: int) -> np.ndarray:
    """How often each frame counts under each resample of the searched blocks, (r, f); as they are with too few."""
    labels, row = np.unique(block, return_inverse=True)
    if len(labels) < FEWEST_BLOCKS:
        return np.ones((1, len(block)))
    return resampled_weights(len(labels), np.random.default_rng(seed), DRAWS)[:, row]


def chosen_shares(landscape: Landscape, weights: np.ndarray, frames: np.ndarray | slice = slice(None)) -> np.ndarray:
    """How often each candidate is the best, (k,), adding up to 1; `frames` are the rows that are looked at, or all.

    Resamples that leave no vehicle on those frames choose nothing and do not count.
    """
    weights = weights[:, frames]
    weights = weights[weights @ landscape.weight[frames] > 0.0]
    if not len(weights):
        weights = np.ones((1, weights.shape[1]))
    best = np.argmax(landscape.objective[FIRST:, frames] @ weights.T, axis=0)  # vehicles are the same for all
    return np.bincount(best, minlength=len(landscape.objective) - FIRST) / len(best)


def regret(
    chosen: Sequence[np.ndarray], by_reference: Sequence[np.ndarray], judged: Sequence[Landscape], block: np.ndarray
) -> Lost | None:
    """What choices lose to those of the reference: [F(its) - F(theirs)] / [F(its) - F(baseline)] on frames that judge.

    Parameters
    ----------
    chosen, by_reference : sequence of ndarray, (k,)
        From `chosen_shares`, one for each random draw; F of them is the mean over what they choose.
    judged : sequence of Landscape
        The reference on frames that chose nothing, under each draw: the baseline and the k candidates.
    block : ndarray of int, (f,)
        Block of each of those frames; intervals are over its blocks.

    Returns
    -------
    Lost or None
        None where the reference's choices gain nothing there.
    """
    objective, vehicles = zip(*(one.blocks(block) for one in judged), strict=True)
    draws = list(zip(chosen, by_reference, objective, strict=True))
    lost = np.array([(its - theirs) @ worth[FIRST:] for theirs, its, worth in draws])
    gain = np.array([its @ worth[FIRST:] - worth[BASELINE] for _, its, worth in draws])
    return share_lost(lost, gain, sum(vehicles) > 0)


# --- the reference, and its noise ceiling -----------------------------------------------------------------------------


SPLITS = 200
FEWEST_HALVED = 4  # blocks: two in each half
_ROUNDING = 1e-12  # of the largest score: an error that is no greater is none


def halvings(blocks: int, seed: int) -> np.ndarray:
    """Which blocks are in the one half and which in the other, `SPLITS` times at random, (s, 2, blocks) bool."""
    rng = np.random.default_rng(seed)
    place = np.argsort([rng.permutation(blocks) for _ in range(SPLITS)], axis=1)
    return np.stack([place < blocks // 2, place >= blocks // 2], axis=1)


def chosen_by(halves: np.ndarray, objective: np.ndarray) -> np.ndarray:
    """The candidate that each half holds for the best, (...), from each candidate's block sums (k, blocks).

    `halves` are (..., blocks); vehicles, which are the same for all candidates, make no difference.
    """
    return np.argmax(halves.astype(float) @ objective.T, axis=-1)


@dataclass(frozen=True, eq=False)
class Reference:
    """What fidelities are compared with.

    Attributes
    ----------
    searched : Landscape
        Of the baseline and the candidates, on the frames that choose.
    searched_block : ndarray of int, (f,)
        Their blocks.
    judged, judged_block
        The same on the frames that judge.
    seed : int
        Of resamples and halvings.
    """

    searched: Landscape
    searched_block: np.ndarray
    judged: Landscape
    judged_block: np.ndarray
    seed: int

    @cached_property
    def weights(self) -> np.ndarray:
        """`searched_weights`, (r, f)."""
        return searched_weights(self.searched_block, self.seed)

    @cached_property
    def noise(self) -> Noise | None:
        """The noise ceiling; None for fewer than four blocks with vehicles."""
        return noise_ceiling(self)

    def select(self, numbers: Sequence[int]) -> Reference:
        """Of some of the candidates."""
        rows = [BASELINE, *(FIRST + number for number in numbers)]
        searched, judged = self.searched.select(rows), self.judged.select(rows)
        return Reference(searched, self.searched_block, judged, self.judged_block, self.seed)

    def best(self, count: int) -> list[int]:
        """So many of the best candidates, in the order in which they come."""
        return sorted(np.argsort(-self.searched.per_vehicle()[FIRST:], kind="stable")[:count].tolist())

    @property
    def gain(self) -> float:
        """What the best candidate gains over the baseline on the frames that choose, per vehicle."""
        values = self.searched.per_vehicle()
        return float(values[FIRST:].max() - values[BASELINE])


@dataclass(frozen=True, slots=True)
class Noise:
    """One half of the searched blocks against the other, over many random halvings.

    A difference of halves has twice the standard error of the whole: about what a 95 % interval of the reference
    reaches to either side.

    Attributes
    ----------
    bias, error, tau : float
        As of a fidelity, the one half in its place and the other in the reference's: medians, of the bias without sign.
    error_90 : (float, float)
        Where 90 % of the errors lie.
    apart : float or None
        Mean difference, without sign, between what the choices of both halves come to on the frames that judge, as a
        share of what a half's choice gains there; None where that is nothing.
    """

    bias: float
    error: float
    error_90: tuple[float, float]
    tau: float
    apart: float | None


def noise_ceiling(reference: Reference) -> Noise | None:
    """One half of the reference's blocks against the other; None for fewer than four blocks with vehicles."""
    objective, vehicles = reference.searched.blocks(reference.searched_block)
    objective, vehicles = objective[FIRST:, vehicles > 0], vehicles[vehicles > 0]
    if len(vehicles) < FEWEST_HALVED:
        return None
    halves = halvings(len(vehicles), reference.seed)
    scored = [[objective[:, half].sum(axis=1) / vehicles[half].sum() for half in pair] for pair in halves]
    bias, error, tau = np.array([agreement(*both) for both in scored]).T
    tau = np.nan_to_num(tau)  # where a half prefers no mounting, nothing is ranked alike
    worth = reference.judged.objective.sum(axis=1)
    chosen = worth[FIRST + chosen_by(halves, objective)]
    gain = chosen.mean() - worth[BASELINE]
    apart = float(np.abs(chosen[:, 0] - chosen[:, 1]).mean() / gain) if gain > 0.0 else None
    bias, middle, tau = (float(np.median(column)) for column in (np.abs(bias), error, tau))
    return Noise(bias, middle, interval_90(error), tau, apart)


# --- another model of the same mountings: how far it is off, and what its choices lose --------------------------------


def compared(
    draws: Sequence[tuple[Landscape, Landscape, Landscape]],
    reference: Reference,
    frames: np.ndarray | slice = slice(None),
) -> dict[str, object]:
    """Scores, ranking and choices of another model beside one, means over random draws or phases of the beams.

    Parameters
    ----------
    draws : sequence of (Landscape, Landscape, Landscape)
        The baseline and the candidates by the other model and by the one that it is compared with on the frames that
        choose, and by the latter on those that judge.
    reference : Reference
        Whose blocks these are.
    frames : ndarray or slice
        Rows of the frames that the other model looks at.

    Returns
    -------
    dict
        ``bias``: what the other model scores more, in the metric's unit per vehicle, mean over the candidates.
        ``error``: root mean square of what is left after calibration, in the same unit. ``tau``: `weighted_tau`.
        ``lost``: `regret` of its choices, None where nothing is gained. ``chosen``: shares (2, k) of the candidates
        that are chosen by it and by the one. A tau that cannot be known is None.
    """
    pairs = [(one.per_vehicle(frames)[FIRST:], other.per_vehicle()[FIRST:]) for one, other, _ in draws]
    bias, errors, tau = np.array([agreement(*pair) for pair in pairs]).T
    error = float(np.sqrt(np.mean(errors**2)))
    weights = reference.weights
    chosen = np.array([[chosen_shares(one, weights, frames), chosen_shares(other, weights)] for one, other, _ in draws])
    return {
        "bias": float(bias.mean()),
        "error": 0.0 if error <= _ROUNDING * np.abs(pairs[0][1]).max() else error,
        "tau": None if np.isnan(tau).any() else float(tau.mean()),
        "lost": regret(*chosen.transpose(1, 0, 2), [judged for *_, judged in draws], reference.judged_block),
        "chosen": chosen.mean(axis=0),
    }


NEEDED, NOT_NEEDED, UNDECIDED = "needed", "not needed", "undecided"


def verdict(interval_90: tuple[float, float] | None, tolerance: float) -> str:
    """Whether a thing must be modelled: what is lost without it is surely more than the tolerance, or surely not."""
    if interval_90 is None or interval_90[0] <= tolerance < interval_90[1]:
        return UNDECIDED
    return NEEDED if interval_90[0] > tolerance else NOT_NEEDED
