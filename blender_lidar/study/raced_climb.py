"""A climb that spends all frames on the best third of every generation only.

CMA-ES (`optimise.covariance_adaptation`) needs no more than the ranks of its samples. Each generation is scored on the
first frames of the rungs' order; its best third goes on to the others, and the rest rank below by what they have;
so the last of its parents may be chosen by the first frames alone.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ..errors import InputError
from ..optimise.covariance_adaptation import CovarianceAdaptation
from ..optimise.sampling import generator
from ..optimise.stored import read_array, read_count
from .halving import survivors


class RacedClimb:
    """Generations of samples about a mean, each raced over the frames.

    Parameters
    ----------
    mean : ndarray, (d,)
        Where it starts, in shares of the box.
    step : float
        Standard deviation it starts with, in shares of the box.
    samples, generations : int
        Samples to a generation, and generations in all.
    first : int
        How many frames all samples meet; the others are for the best third.
    block : ndarray of int, (f,)
        Block of time of each frame, in the order of the rungs.
    seed : int
        Same seed, same samples.
    """

    def __init__(
        self, mean: np.ndarray, step: float, samples: int, generations: int, first: int, block: np.ndarray, seed: int
    ) -> None:
        self._rng = generator(seed)
        self._climb = CovarianceAdaptation(self._rng, mean, step, samples)
        self._climb.move()
        self._left, self._first, self._block = generations, first, np.asarray(block)
        self._begun: np.ndarray | None = None  # what a generation has on the first frames

    @property
    def done(self) -> bool:
        """Whether all generations are made, or it has arrived or is stuck."""
        return self._left == 0 or self._climb.exhausted

    def ask(self) -> tuple[np.ndarray, slice]:
        """Candidates, (s, d) in shares of the box, and which of the frames they are to meet."""
        if self._begun is None:
            return self._climb.candidates, slice(0, self._first)
        return self._climb.candidates[self._better()], slice(self._first, len(self._block))

    def tell(self, objective: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Take the objective of what was asked for, (s, frames asked for).

        Returns
        -------
        ndarray, (k, d), and ndarray, (k, f)
            The candidates that have met all frames by now, and their objective on each; none in mid-generation.
        """
        if self._begun is None and self._first < len(self._block):
            self._begun = objective
            return self._climb.candidates[:0], np.empty((0, len(self._block)))
        if self._begun is None:
            rows, whole = np.arange(len(objective)), objective
        else:
            rows = self._better()
            whole = np.concatenate([self._begun[rows], objective], axis=1)
        met = self._climb.candidates[rows]
        self._climb.tell(self._ranks(rows, whole))
        self._left, self._begun = self._left - 1, None
        self._climb.move()
        return met, whole

    def _better(self) -> np.ndarray:
        """Rows of the samples that go on to all frames."""
        return survivors(self._begun, self._block[: self._first], math.ceil(len(self._begun) / 3))

    def _ranks(self, rows: np.ndarray, whole: np.ndarray) -> np.ndarray:
        """What orders a generation, (samples,): those that met all frames by these, above the others by theirs."""
        begun = whole if self._begun is None else self._begun
        values = -np.argsort(np.argsort(-begun.sum(axis=1), kind="stable"), kind="stable").astype(float)
        totals = whole.sum(axis=1)
        values[rows] = 1.0 + np.searchsorted(np.sort(totals), totals)  # equals stay equal
        return values

    def state(self) -> dict[str, Any]:
        """How far it has come, for JSON."""
        return {
            "climb": self._climb.state(),
            "left": self._left,
            "begun": None if self._begun is None else self._begun.tolist(),
            "random": self._rng.bit_generator.state,
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Become what `state` described; raises `InputError` naming what is damaged."""
        variables = self._climb.candidates.shape[1]
        samples = self._climb.samples
        self._climb = CovarianceAdaptation.restored(self._rng, variables, state["climb"])
        if self._climb.samples != samples:
            raise InputError(f"samples: {self._climb.samples}; allowed: {samples}")
        self._left = read_count(state, "left", self._left)
        begun = state["begun"]
        self._begun = None if begun is None else read_array(state, "begun", (samples, self._first))
        self._rng.bit_generator.state = state["random"]
