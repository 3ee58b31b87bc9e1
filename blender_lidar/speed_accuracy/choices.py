"""Which mountings a score would choose on other traffic of this kind, and what they lose on held-out frames."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ..study.landscape import Landscape
from ..study.statistics import FEWEST_BLOCKS, block_sums, linear_interval_90, resampled_weights, student_t, student_t_95
from .candidates import BASELINE, FIRST

DRAWS = 300  # resamples of the searched blocks, under each of which a mounting is chosen


class Regret(NamedTuple):
    """What is lost, as a share of the gain, its 90 % interval, None for too few blocks, and how many blocks judge."""

    share: float
    interval_90: tuple[float, float] | None
    blocks: int

    def bound(self, level: float) -> float | None:
        """The loss is no greater with so much confidence; None for too few blocks."""
        if self.interval_90 is None:
            return None
        reach = (self.interval_90[1] - self.share) / student_t_95(self.blocks - 1)
        return self.share + reach * student_t(level, self.blocks - 1)


def searched_weights(block: np.ndarray, seed: int) -> np.ndarray:
    """How often each frame counts under each resample of the searched blocks, (r, f); as they are with too few."""
    labels, row = np.unique(block, return_inverse=True)
    if len(labels) < FEWEST_BLOCKS:
        return np.ones((1, len(block)))
    return resampled_weights(len(labels), np.random.default_rng(seed), DRAWS)[:, row]


def chosen_shares(landscape: Landscape, weights: np.ndarray, frames: np.ndarray | None = None) -> np.ndarray:
    """How often each candidate is the best, (k,), adding up to 1; `frames` are the rows that are looked at, or all.

    Resamples that leave no vehicle on those frames choose nothing and do not count.
    """
    frames = np.arange(len(landscape.vehicles)) if frames is None else frames
    weights = weights[:, frames]
    weights = weights[weights @ landscape.vehicles[frames] > 0.0]
    if not len(weights):
        weights = np.ones((1, len(frames)))
    best = np.argmax(landscape.objective[FIRST:, frames] @ weights.T, axis=0)  # vehicles are the same for all
    return np.bincount(best, minlength=len(landscape.objective) - FIRST) / len(best)


def regret(chosen: np.ndarray, by_reference: np.ndarray, judged: Landscape, block: np.ndarray) -> Regret | None:
    """What choices lose to those of the reference: [F(its) - F(theirs)] / [F(its) - F(baseline)] on frames that judge.

    Parameters
    ----------
    chosen, by_reference : ndarray, (k,)
        From `chosen_shares`; F of them is the mean over what they choose.
    judged : Landscape
        The reference on frames that chose nothing: the baseline and the k candidates.
    block : ndarray of int, (f,)
        Block of each of those frames; intervals are over its blocks.

    Returns
    -------
    Regret or None
        None where the reference's choices gain nothing there.
    """
    objective, vehicles = block_sums(judged.objective, block), block_sums(judged.vehicles, block)
    lost = (by_reference - chosen) @ objective[FIRST:]
    gain = by_reference @ objective[FIRST:] - objective[BASELINE]
    if not gain.sum() > 0.0:
        return None
    share = float(lost.sum() / gain.sum())
    influence = ((lost - share * gain) / gain.sum())[vehicles > 0]
    return Regret(share, linear_interval_90(share, influence), len(influence))


def mean_shares(shares: Sequence[np.ndarray]) -> np.ndarray:
    """Choices of several phases, each as likely as the others."""
    return np.mean(shares, axis=0)
