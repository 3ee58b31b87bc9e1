"""Intervals that resample blocks of time: frames close in time show the same vehicles, and are no new evidence."""

from __future__ import annotations

import numpy as np

RESAMPLES = 2000
FEWEST_BLOCKS = 3  # with fewer no interval is given


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
    """90 % interval of sum(numerator) / sum(denominator), from the sums of each block (b,); None for too few blocks."""
    if len(numerator) < FEWEST_BLOCKS:
        return None
    weights = resampled_weights(len(numerator), np.random.default_rng(seed))
    return interval_90((weights @ numerator) / (weights @ denominator))
