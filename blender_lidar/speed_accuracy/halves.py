"""Halves of the searched blocks against each other: what other traffic of the same kind would say."""

from __future__ import annotations

import numpy as np

SPLITS = 200
FEWEST_BLOCKS = 4  # two in each half


def halvings(blocks: int, seed: int) -> np.ndarray:
    """Which blocks are in the one half and which in the other, `SPLITS` times at random, (s, 2, blocks) bool."""
    rng = np.random.default_rng(seed)
    halves = np.zeros((SPLITS, 2, blocks), dtype=bool)
    for number in range(SPLITS):
        order = rng.permutation(blocks)
        halves[number, 0, order[: blocks // 2]] = True
        halves[number, 1, order[blocks // 2 :]] = True
    return halves


def chosen_by(halves: np.ndarray, objective: np.ndarray) -> np.ndarray:
    """The candidate that each half holds for the best, (...), from each candidate's block sums (k, blocks).

    `halves` are (..., blocks); vehicles, which are the same for all candidates, make no difference.
    """
    return np.argmax(halves.astype(float) @ objective.T, axis=-1)
