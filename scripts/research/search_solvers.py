"""The searches that are judged: ours, both forms of DE-PSO, plain ones and other people's; all counted alike.

Of theirs only the population of SciPy's differential evolution is tuned; all else is as it comes. Each takes a counted
objective and a seed. All work in shares of the box or in its units, as they please; what counts is the objective's own
counter.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable

import numpy as np
from scipy import optimize

from blender_lidar.optimise import make_search
from blender_lidar.optimise import run as run_search
from search_problems import Problem


class BudgetSpent(Exception):
    """The last evaluation has been made: what a solver asks for next is not evaluated."""


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
        left = self.left
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
        rows = [min(count, len(self._best)) - 1 for count in checkpoints(self.budget)]
        return {"best": [self._best[row] for row in rows], "on_bound": self._on_bound / len(self._best)}


def checkpoints(budget: int) -> list[int]:
    """The numbers of evaluations after which the best so far is kept: ten to a decade, and the budget."""
    grid = np.geomspace(1.0, budget, 1 + math.ceil(20 * math.log10(max(budget, 2))))
    return sorted({round(count) for count in grid.tolist()} | {budget})


Solver = Callable[[Counted, int], None]
"""Searches with a counted objective and a seed until the budget is spent."""


def solve(solver: Solver, objective: Counted, seed: int) -> dict:
    """Run a solver to the end of the budget; what is kept of it."""
    with contextlib.suppress(BudgetSpent):
        solver(objective, seed)
    return objective.record()


def ours(name: str, reading: str = "corrected") -> Solver:
    """One of the package's searches, at the settings of a scene that says no more than its name."""

    def solve(objective: Counted, seed: int) -> None:
        box, own = (objective.lower, objective.upper), {"reading": reading} if name == "de-pso" else {}
        run_search(make_search(name, *box, seed=seed, evaluations=objective.budget, **own), objective)

    return solve


def scipy_de(population: int, init: str = "latinhypercube", strategy: str = "best1bin") -> Solver:
    """SciPy's differential evolution, `population` times the number of variables, restarted when converged."""

    def solve(objective: Counted, seed: int) -> None:
        rng = np.random.default_rng(seed)
        while objective.left:
            optimize.differential_evolution(
                lambda x: -objective(x.T),
                list(zip(objective.lower, objective.upper, strict=True)),
                popsize=population,
                init=init,
                strategy=strategy,
                maxiter=objective.budget,
                polish=False,
                tol=0.0,
                atol=1e-8,  # spread of values at which it has converged
                vectorized=True,
                updating="deferred",
                seed=int(rng.integers(2**31)),
            )

    return solve


def scipy_direct(objective: Counted, seed: int) -> None:
    """SciPy's DIRECT; deterministic, so that the seed plays no part."""

    def cost(x: np.ndarray) -> float:
        # older versions cannot be left by an exception
        return -float(objective(x)[0]) if objective.left else math.inf

    box = list(zip(objective.lower, objective.upper, strict=True))
    most = {"maxfun": objective.budget, "maxiter": objective.budget}
    optimize.direct(cost, box, **most, vol_tol=0.0, len_tol=0.0)


def cma_es(objective: Counted, seed: int) -> None:
    """CMA-ES of the `cmaes` package, restarted with twice the population when it stops (IPOP)."""
    import cmaes

    rng, d = np.random.default_rng(seed), objective.lower.size
    population = 4 + int(3.0 * math.log(d))
    while objective.left:
        climb = cmaes.CMA(
            mean=rng.random(d),
            sigma=0.25,  # of the scaled box, as its authors advise
            bounds=np.tile([0.0, 1.0], (d, 1)),
            population_size=population,
            seed=int(rng.integers(2**31)),
        )
        while not climb.should_stop():
            shares = np.array([climb.ask() for _ in range(population)])
            values = objective(objective.lower + shares * (objective.upper - objective.lower))
            climb.tell([(share, -value) for share, value in zip(shares, values.tolist(), strict=True)])
        population *= 2


OURS = "hardened"
SCIPY_POPULATION = 5  # docs/evidence/search.md tells how it was tuned
SOLVERS: dict[str, Solver] = {
    OURS: ours("hardened"),
    "DE-PSO": ours("de-pso"),
    "DE-PSO as printed": ours("de-pso", "paper"),
    "grid": ours("grid"),
    "random": ours("random"),
    "SciPy DE": scipy_de(SCIPY_POPULATION),
    "SciPy DIRECT": scipy_direct,
    "CMA-ES": cma_es,
}
DE_PSO_FORMS = ("DE-PSO", "DE-PSO as printed")
RIVALS = tuple(name for name in SOLVERS if name != OURS)
