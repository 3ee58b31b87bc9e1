"""What all searches share: ask and tell, the record of candidates and values, checks, and random points in a box."""

from __future__ import annotations

import math
import operator
from abc import ABC, abstractmethod
from collections.abc import Sequence
from itertools import pairwise
from typing import ClassVar

import numpy as np

from ..errors import InputError

# --- Checks of what a search is given: bounds, whole numbers, objective values ----------------------------


def check_bounds(lower: np.ndarray, upper: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The search box as two float arrays, (d,).

    Raises
    ------
    InputError
        If the bounds are not two equally long lists of finite numbers, with every lower one below its upper one.
    """
    lower, upper = _numbers(lower, "lower bounds"), _numbers(upper, "upper bounds")
    if lower.ndim != 1 or lower.shape != upper.shape or lower.size == 0:
        raise InputError(
            f"bounds: shapes {lower.shape} and {upper.shape}; allowed: two lists of equal length, not empty"
        )
    for variable, (low, high) in enumerate(zip(lower.tolist(), upper.tolist(), strict=True)):
        where = f"bounds of variable {variable}: [{low:g}, {high:g}]"
        if not math.isfinite(high - low):
            raise InputError(f"{where}; allowed: finite numbers, a finite distance apart")
        if low > high:
            raise InputError(f"{where} are upside down; allowed: low below high")
        if low == high:
            raise InputError(f"{where} leave nothing to search; fix it with a number instead")
    return lower, upper


def check_whole(value: int, least: int, what: str) -> int:
    """`value` as a plain int of at least `least`, or `InputError` naming `what`."""
    try:
        whole = operator.index(value)
    except TypeError:
        raise InputError(f"{what}: {value!r}; allowed: a whole number, {least} or more") from None
    if whole < least:
        raise InputError(f"{what}: {whole}; allowed: {least} or more")
    return whole


def check_number(value: float, least: float, most: float, what: str) -> float:
    """`value` as a plain finite float from `least` to `most`, or `InputError` naming `what`."""
    try:
        number = math.nan if isinstance(value, str) else float(value)
    except (TypeError, ValueError):
        number = math.nan
    if not (math.isfinite(number) and least <= number <= most):
        raise InputError(f"{what}: {value!r}; allowed: a finite number from {least:g} to {most:g}")
    return number


def check_values(values: np.ndarray, candidates: np.ndarray) -> np.ndarray:
    """The objective's values of `candidates` (s, d) as a float array, (s,).

    Raises
    ------
    InputError
        If there is not one number per candidate, or one is NaN or +inf. ``-inf`` marks a candidate as infeasible.
    """
    values = _numbers(values, "objective values")
    if values.shape != candidates.shape[:1]:
        raise InputError(f"objective values: shape {values.shape}; allowed: {candidates.shape[:1]}, one per candidate")
    unusable = np.isnan(values) | (values == np.inf)
    if unusable.any():
        first = int(np.argmax(unusable))
        raise InputError(
            f"objective: {values[first]} at candidate {candidates[first].tolist()}; allowed: finite or -inf"
        )
    return values


def _numbers(values: np.ndarray, what: str) -> np.ndarray:
    try:
        return np.array(values, dtype=float)
    except (TypeError, ValueError):
        raise InputError(f"{what}: {values!r}; allowed: numbers") from None


# --- Periodic variables: circles, on which neither bound is an end ------------------------------------------


def wrapped(step: np.ndarray, periodic: np.ndarray, period: np.ndarray | float = 1.0) -> np.ndarray:
    """Minimum image: steps (..., d), the short way round where a variable is `periodic` (d,); others as they are."""
    return np.where(periodic, step - period * np.round(step / period), step)


# --- Random points in a box -------------------------------------------------------------------------------


def generator(seed: int) -> np.random.Generator:
    """A random generator whose kind is fixed, also when NumPy changes its default: the same seed, the same draws."""
    return np.random.Generator(np.random.PCG64(check_whole(seed, 0, "seed")))


def latin_hypercube(rng: np.random.Generator, points: int, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
    """Points of which each of `points` equal slices of every variable holds exactly one, (points, d)."""
    slices = rng.permuted(np.tile(np.arange(points), (lower.size, 1)), axis=1).T
    return in_box((slices + rng.random(slices.shape)) / points, lower, upper)


def distinct_donors(i: np.ndarray, j: np.ndarray, k: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Donors j and k of a differential mutation of particles i, all three different.

    They are made of draws out of those that are left: one less, two less.
    """
    j = j + (j >= i)
    k = k + (k >= np.minimum(i, j))
    return j, k + (k >= np.maximum(i, j))


def uniform(rng: np.random.Generator, points: int, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
    """Independent uniform points, (points, d)."""
    return in_box(rng.random((points, lower.size)), lower, upper)


def in_box(unit: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
    """Points of the box from shares of it, 0 to 1 in every variable."""
    # the clip catches a last digit that rounding carries over the upper bound
    return np.clip(lower + unit * (upper - lower), lower, upper)


def joined_history(histories: Sequence[np.ndarray]) -> np.ndarray:
    """Rows of `Search.history` of searches that were carried out one after the other, numbered through."""
    if len(histories) == 1:
        return histories[0]
    rows = [history.copy() for history in histories]
    for before, after in pairwise(rows):
        after[:, :2] += before[-1, :2]
    joined = np.concatenate(rows)
    joined[:, -1] = np.maximum.accumulate(joined[:, -2])
    return joined


# --- Ask and tell -----------------------------------------------------------------------------------------


class Search(ABC):
    """A search for the maximum of a function over a box, by ask and tell: the caller evaluates and owns the loop.

    ::

        while not search.done:
            search.tell(objective(search.ask()))

    A search is deterministic: a new one that is given the same values asks for the same to the last bit. So a record of
    what it asked for and of its values is all that is needed to go on with it, here or in another process. A subclass
    says which candidates are next, and may learn from their values.

    Attributes
    ----------
    name : str
        What users call it.
    lower, upper : ndarray, (d,)
        The box.
    periodic : ndarray of bool, (d,)
        Which variables are circles, their lower bound the same as their upper: a search wraps there. None of them
        unless said.
    budget : int
        Evaluations that the whole search makes.
    """

    name: ClassVar[str]
    label = "search"  # what a run calls it where it has several
    is_final = False  # whether it has the last word in a run: its values are then of another objective than the others
    variables: tuple[str, ...] = ()  # and its variables

    def __init__(
        self,
        lower: np.ndarray,
        upper: np.ndarray,
        *,
        budget: int,
        per_iteration: int = 1,
        periodic: Sequence[bool] | None = None,
    ) -> None:
        self.lower, self.upper = check_bounds(lower, upper)
        self.periodic = np.zeros(self.lower.size, dtype=bool) if periodic is None else np.array(periodic, dtype=bool)
        if self.periodic.shape != self.lower.shape:
            raise InputError(f"periodic: shape {self.periodic.shape}; allowed: {self.lower.shape}, one per variable")
        self.budget = budget
        self._per_iteration = per_iteration  # evaluations, at least; a batch is never divided
        self._x: list[list[float]] = []
        self._values: list[float] = []
        self._iterations: list[int] = []  # evaluations of each
        self._best = -1  # row of the best so far

    @abstractmethod
    def _candidates(self) -> np.ndarray:
        """The candidates to evaluate next, (s, d); fixed between two calls of `tell`."""

    def _learn(self, candidates: np.ndarray, values: np.ndarray) -> None:
        """Take candidates, (s, d), and their values, (s,), that have just been recorded; one may learn nothing."""
        return

    def ask(self) -> np.ndarray:
        """The candidates to evaluate next, (s, d), all within the bounds. Asking again returns the same ones.

        Raises
        ------
        InputError
            If the search is done.
        """
        if self.done:
            raise InputError(f"search {self.name!r}: all {self.budget} evaluations are made; nothing is left to ask")
        return self._candidates().copy()

    def tell(self, values: np.ndarray) -> None:
        """Take the objective's values, (s,), of the candidates last asked for; the higher the better.

        ``-inf`` marks a candidate as infeasible.

        Raises
        ------
        InputError
            If there is not one value per candidate, or one is NaN or +inf: the candidate is named and the search
            stays as it was.
        """
        candidates = self.ask()
        values = check_values(values, candidates)
        for x, value in zip(candidates.tolist(), values.tolist(), strict=True):
            if not self._values or value > self.best_value:
                self._best = len(self._values)
            self._x.append(x)
            self._values.append(value)
        if not self._iterations or self._iterations[-1] >= self._per_iteration:
            self._iterations.append(0)
        self._iterations[-1] += len(values)
        self._learn(candidates, values)

    @property
    def done(self) -> bool:
        """Whether the budget is spent."""
        return self.evaluations >= self.budget

    @property
    def evaluations(self) -> int:
        """Candidates evaluated so far."""
        return len(self._values)

    @property
    def iteration(self) -> int:
        """The iteration that the latest evaluation belongs to, from 1; 0 before the first."""
        return len(self._iterations)

    @property
    def best_x(self) -> np.ndarray:
        """The best candidate so far, (d,); the first of equals.

        Raises
        ------
        InputError
            If nothing has been evaluated yet.
        """
        if not self._values:
            raise InputError(f"search {self.name!r}: nothing has been evaluated yet")
        return np.array(self._x[self._best])

    @property
    def best_value(self) -> float:
        """Its value; ``-inf`` before the first evaluation, and as long as no candidate was feasible."""
        return self._values[self._best] if self._values else -math.inf

    @property
    def history(self) -> np.ndarray:
        """One row per evaluation, (n, d + 5): evaluation, iteration, particle (all from 1), x, value, best so far."""
        x = np.reshape(self._x, (-1, self.lower.size))
        return history_of(x, np.array(self._values), np.array(self._iterations, dtype=int))


def history_of(x: np.ndarray, values: np.ndarray, sizes: np.ndarray) -> np.ndarray:
    """Rows of `Search.history` from candidates (n, d), values (n,) and how many of them each iteration has."""
    evaluation = np.arange(len(x)) + 1
    iteration = np.repeat(np.arange(len(sizes)) + 1, sizes)
    particle = evaluation - np.repeat(np.cumsum(sizes) - sizes, sizes)
    return np.column_stack([evaluation, iteration, particle, x, values, np.maximum.accumulate(values)])
