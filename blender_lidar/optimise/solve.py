"""Searches in one call: an objective in, its best point out."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..errors import InputError, unknown_name
from ..names import ITERATIONS, PARTICLES, SEARCHES
from ..plugins import IN_A_FILE, call_plugin, faults_in_one_line, is_plugin, load_plugin
from .baselines import GridSearch, RandomSearch, grid_points
from .de_pso import DePso, DePsoSettings
from .hardened import Hardened
from .search import Search, check_bounds, check_whole

Objective = Callable[[np.ndarray], np.ndarray]
"""Takes candidates, (s, d), and returns their values, (s,): the higher the better, ``-inf`` for an infeasible one."""


@dataclass(frozen=True, slots=True, eq=False)
class SearchResult:
    """What a search found.

    Parameters
    ----------
    x : ndarray, (d,)
        The best point; the first of equals.
    value : float
        Its value; ``-inf`` if no candidate was feasible.
    evaluations : int
        Candidates evaluated.
    history : ndarray, (evaluations, d + 5)
        Per evaluation: evaluation, iteration, particle (all from 1), x, value, best so far.
    """

    x: np.ndarray
    value: float
    evaluations: int
    history: np.ndarray


def run(search: Search, objective: Objective, callback: Callable[[Search], None] | None = None) -> SearchResult:
    """Run `search` from where it is to its end.

    Parameters
    ----------
    search : Search
        Fresh, or on its way.
    objective : callable
        See `Objective`.
    callback : callable, optional
        Called with the search after every batch of values: to show progress.

    Returns
    -------
    SearchResult

    Raises
    ------
    InputError
        If the objective returns anything but one finite number or ``-inf`` per candidate.
    """
    while not search.done:
        search.tell(objective(search.ask()))
        if callback is not None:
            callback(search)
    return SearchResult(search.best_x, search.best_value, search.evaluations, search.history)


class OwnSearch(Search):
    """A search of one's own, an object with `ask` and `tell`, held to the rules of a `Search`.

    ``--search own.py:Climb`` searches with it. `Climb` is a class, or a function that makes the object, called as
    ``Climb(lower, upper, seed=seed, budget=budget)`` with bounds (d,). Then by turns ``ask()`` gives the candidates to
    evaluate next, (s, d) within the bounds, and ``tell(values)`` takes their values, (s,): the higher the better,
    ``-inf`` for an infeasible one. The last batch is cut to what the budget leaves. A new one that is given
    the same values has to ask for the same, so that a run can go on.

    Raises
    ------
    InputError
        When its code fails, or asks for something else, in one line.
    """

    def __init__(
        self, name: str, make: Callable, lower: np.ndarray, upper: np.ndarray, *, seed: int, budget: int
    ) -> None:
        super().__init__(lower, upper, budget=check_whole(budget, 1, "evaluations"))
        self.name, self._what, self._asked = name, f"search {name!r}", None
        self._own = call_plugin(self._what, make, self.lower.copy(), self.upper.copy(), seed=seed, budget=self.budget)
        for method in ("ask", "tell"):
            if not callable(getattr(self._own, method, None)):
                raise InputError(f"{self._what}: has no {method}(); allowed: an object with ask() and tell(values)")

    def _candidates(self) -> np.ndarray:
        if self._asked is None:
            asked = call_plugin(self._what, self._own.ask)
            with faults_in_one_line(f"{self._what}: ask()"):
                asked = np.array(asked)
            form = f"(s, {self.lower.size}), s at least 1, finite numbers"
            if asked.ndim != 2 or asked.shape[1] != self.lower.size or not len(asked) or asked.dtype.kind not in "fiu":
                raise InputError(f"{self._what}: ask() gave {asked.dtype} {asked.shape}; allowed: {form}")
            outside = ~((asked >= self.lower) & (asked <= self.upper)).all(axis=1)  # as is what is NaN
            if outside.any():
                first, box = asked[outside][0].tolist(), f"{self.lower.tolist()} to {self.upper.tolist()}"
                raise InputError(f"{self._what}: ask() gave {first}; allowed: {box}")
            self._asked = asked[: self.budget - self.evaluations].astype(float)
        return self._asked

    def _learn(self, candidates: np.ndarray, values: np.ndarray) -> None:
        self._asked = None
        call_plugin(self._what, self._own.tell, values.copy())


def search_named(name: str, where: str = "") -> Callable:
    """What makes the search of one's own in a file, ``FILE.py:NAME``.

    Raises
    ------
    MissingFileError, InputError
        When there is none, with the nearest name, or it cannot be loaded; `where` says where the name came from.
    """
    if not is_plugin(name):
        raise unknown_name(name, (*SEARCHES, IN_A_FILE), "search", where)
    found = load_plugin(name, where)
    if not callable(found):
        prefix = f"{where}: " if where else ""
        raise InputError(f"{prefix}{name}: is a {type(found).__name__}; allowed: a class, or a function that makes one")
    return found


def make_search(
    name: str,
    lower: np.ndarray,
    upper: np.ndarray,
    *,
    seed: int,
    evaluations: int = 2000,
    periodic: Sequence[bool] | None = None,
    **settings: object,
) -> Search:
    """A search by its name, before its first evaluation.

    Parameters
    ----------
    name : str
        One of `SEARCHES`, or a plug-in: see `OwnSearch`.
    lower, upper : array_like, (d,)
        Bounds of each variable.
    seed : int
        Same seed, same candidates; a grid has no use for it.
    evaluations : int
        The budget, never exceeded: DE-PSO makes as many whole iterations as fit, a grid is as fine as fits.
    periodic : sequence of bool, (d,), optional
        Which variables are circles, their bounds one and the same place. A plug-in does not know: to it they are ends.
    **settings
        The method's own: `particles` of the hardened search, fields of `DePsoSettings` except for the budget.

    Raises
    ------
    InputError
        If the name is unknown or an argument cannot be used.
    """
    lower, upper = check_bounds(lower, upper)
    if name not in SEARCHES:
        return OwnSearch(name, search_named(name), lower, upper, seed=seed, budget=evaluations)
    if name == GridSearch.name:
        return GridSearch(lower, upper, points=grid_points(evaluations, lower.size), periodic=periodic, **settings)
    if name == RandomSearch.name:
        return RandomSearch(lower, upper, seed=seed, evaluations=evaluations, **settings)
    if name == Hardened.name:
        return Hardened(lower, upper, seed=seed, evaluations=evaluations, periodic=periodic, **settings)
    use = DePsoSettings(**settings)
    evaluations = check_whole(evaluations, use.particles, f"evaluations with {use.particles} particles")
    use = replace(use, iterations=evaluations // use.particles)
    return DePso(lower, upper, seed=seed, settings=use, periodic=periodic)


def de_pso(
    objective: Objective,
    lower: np.ndarray,
    upper: np.ndarray,
    *,
    seed: int,
    particles: int = PARTICLES,
    iterations: int = ITERATIONS,
    inertia: float = 0.7,
    differential_weight: float = 0.5,
    cognitive: float = 0.3,
    social: float = 0.2,
    differential_threshold: float = 0.1,
    reading: str = "corrected",
    callback: Callable[[Search], None] | None = None,
) -> SearchResult:
    """Maximise `objective` with DE-PSO, the paper's Algorithm 1; see `DePsoSettings` for the settings.

    Parameters
    ----------
    objective : callable
        See `Objective`. It gets the whole swarm at once, (particles, d); with ``reading="paper"`` one candidate at a
        time, (1, d), as Algorithm 1 updates its best inside the loop.
    lower, upper : array_like, (d,)
        Bounds of each variable, in any unit.
    seed : int
        Same seed, same answer.
    callback : callable, optional
        Called with the `Search` after every batch of values.

    Returns
    -------
    SearchResult
        After ``particles * iterations`` evaluations.

    Raises
    ------
    InputError
        If the bounds, a setting or a value of the objective cannot be used.
    """
    weights = inertia, differential_weight, cognitive, social
    settings = DePsoSettings(particles, iterations, *weights, differential_threshold, reading)
    return run(DePso(lower, upper, seed=seed, settings=settings), objective, callback)


def maximise(
    objective: Objective,
    lower: np.ndarray,
    upper: np.ndarray,
    *,
    seed: int,
    evaluations: int = 2000,
    search: str = "hardened",
) -> SearchResult:
    """Maximise `objective` over a box with the search of that name.

    Parameters
    ----------
    objective : callable
        See `Objective`.
    lower, upper : array_like, (d,)
        Bounds of each variable.
    seed : int
        Same seed, same answer.
    evaluations : int
        The budget, never exceeded; a grid, or a swarm in whole iterations, may use less.
    search : {"hardened", "de-pso", "grid", "random"} or str
        Or a plug-in's name: see `OwnSearch`.

    Returns
    -------
    SearchResult

    Raises
    ------
    InputError
        If the bounds, the budget, the name or a value of the objective cannot be used.
    """
    return run(make_search(search, lower, upper, seed=seed, evaluations=evaluations), objective)
