"""An objective that counts: no solver gets a value beyond its budget, and all are recorded alike."""

from __future__ import annotations

import math

import numpy as np

from .problems import Problem


def checkpoints(budget: int) -> list[int]:
    """The numbers of evaluations after which the best so far is kept: ten to a decade, and the budget."""
    grid = np.geomspace(1.0, budget, 1 + math.ceil(20 * math.log10(max(budget, 2))))
    return sorted({round(count) for count in grid.tolist()} | {budget})


class BudgetSpent(Exception):
    """The last evaluation has been made: whatever a solver wanted next is not evaluated."""


class Counted:
    """A problem's objective for one run of one solver.

    Called with candidates (s, d); what exceeds the budget is not evaluated, and `BudgetSpent` ends the run.
    """

    def __init__(self, problem: Problem, budget: int) -> None:
        self.lower, self.upper, self.budget = problem.lower, problem.upper, budget
        self._problem = problem
        self._best: list[float] = []  # so far, after each evaluation
        self._on_bound = 0

    def __call__(self, candidates: np.ndarray) -> np.ndarray:
        candidates = np.atleast_2d(np.asarray(candidates, dtype=float))
        left = self.budget - len(self._best)
        if left > 0:
            made = candidates[:left]
            values = self._problem.objective(made)
            self._on_bound += int(((made <= self.lower) | (made >= self.upper)).any(axis=1).sum())
            reached = self._best[-1] if self._best else -math.inf
            self._best += np.maximum.accumulate(np.concatenate([[reached], values]))[1:].tolist()
        if left < len(candidates):
            raise BudgetSpent
        return values

    @property
    def left(self) -> int:
        """Evaluations that may still be made."""
        return self.budget - len(self._best)

    def record(self) -> dict:
        """What is kept of a run: the best value at the `checkpoints`, and the share of evaluations on a bound."""
        if not self._best:
            raise ValueError("nothing was evaluated")
        rows = [min(count, len(self._best)) - 1 for count in checkpoints(self.budget)]
        return {"best": [self._best[row] for row in rows], "on_bound": self._on_bound / len(self._best)}
