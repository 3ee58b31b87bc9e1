"""The searches that are judged: ours, both forms of DE-PSO, plain ones and other people's.

Of theirs only the population of SciPy's differential evolution is tuned; all else is as it comes.

Each takes a counted objective and a seed. All work in shares of the box or in its units, as they please; what counts is
the objective's own counter.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable

import numpy as np

from ..errors import MissingExtraError
from ..optimise import DePsoSettings, HardenedSettings, make_search
from ..optimise import run as run_search
from ..optimise.hardened import Hardened
from .counted import BudgetSpent, Counted

Solver = Callable[[Counted, int], None]
"""Searches with a counted objective and a seed until the budget is spent."""

OURS = "hardened"
_CONVERGED = 1e-8  # spread of values at which SciPy's population is started anew
_FIRST_STEP = 0.25  # of the scaled box, as CMA-ES' authors advise


def hardened(settings: dict | None = None) -> Solver:
    """Our search with settings in place of its own."""

    def solve(objective: Counted, seed: int) -> None:
        use = HardenedSettings(**{"evaluations": objective.budget, **(settings or {})})
        run_search(Hardened(objective.lower, objective.upper, seed=seed, settings=use), objective)

    return solve


def ours(name: str, reading: str = "corrected") -> Solver:
    """One of the package's searches, at the settings of a scene that says no more than its name."""

    def solve(objective: Counted, seed: int) -> None:
        use = DePsoSettings(reading=reading)
        box = (objective.lower, objective.upper)
        run_search(make_search(name, *box, seed=seed, evaluations=objective.budget, settings=use), objective)

    return solve


def scipy_de(population: int, init: str = "latinhypercube", strategy: str = "best1bin") -> Solver:
    """SciPy's differential evolution, `population` times the number of variables, started anew when converged."""

    def solve(objective: Counted, seed: int) -> None:
        optimize = _scipy_optimize()
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
                atol=_CONVERGED,
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

    _scipy_optimize().direct(
        cost,
        list(zip(objective.lower, objective.upper, strict=True)),
        maxfun=objective.budget,
        maxiter=objective.budget,
        vol_tol=0.0,
        len_tol=0.0,
    )


def cma_es(objective: Counted, seed: int) -> None:
    """CMA-ES of the `cmaes` package, started anew with twice the population when it stops (IPOP)."""
    try:
        import cmaes
    except ImportError as error:
        raise MissingExtraError('CMA-ES needs cmaes: pip install "blender_lidar[study]"') from error
    rng, d = np.random.default_rng(seed), objective.lower.size
    population = 4 + int(3.0 * math.log(d))
    while objective.left:
        climb = cmaes.CMA(
            mean=rng.random(d),
            sigma=_FIRST_STEP,
            bounds=np.tile([0.0, 1.0], (d, 1)),
            population_size=population,
            seed=int(rng.integers(2**31)),
        )
        while not climb.should_stop():
            shares = np.array([climb.ask() for _ in range(population)])
            values = objective(objective.lower + shares * (objective.upper - objective.lower))
            climb.tell([(share, -value) for share, value in zip(shares, values.tolist(), strict=True)])
        population *= 2


SCIPY_DE = {"population": 5}  # docs/search.md tells how it was tuned
SOLVERS: dict[str, Solver] = {
    OURS: hardened(),
    "DE-PSO": ours("de-pso"),
    "DE-PSO as printed": ours("de-pso", "paper"),
    "grid": ours("grid"),
    "random": ours("random"),
    "SciPy DE": scipy_de(**SCIPY_DE),
    "SciPy DIRECT": scipy_direct,
    "CMA-ES": cma_es,
}
DE_PSO_FORMS = ("DE-PSO", "DE-PSO as printed")


def solve(solver: Solver, objective: Counted, seed: int) -> dict:
    """Run a solver to the end of the budget; what is kept of it."""
    with contextlib.suppress(BudgetSpent):
        solver(objective, seed)
    return objective.record()


def _scipy_optimize():
    try:
        from scipy import optimize
    except ImportError as error:
        raise MissingExtraError('the rivals need SciPy: pip install "blender_lidar[study]"') from error
    return optimize
