"""The plain rivals that a search has to beat: an exhaustive grid and uniform random points."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import ClassVar

import numpy as np

from ..errors import InputError
from .search import Search, check_whole, generator, uniform

_BATCH = 20  # candidates to an ask


class _ListSearch(Search):
    """A fixed list of candidates (budget, d), asked for in batches; a batch is an "iteration" of the history."""

    _list: np.ndarray

    def _candidates(self) -> np.ndarray:
        return self._list[self.evaluations : self.evaluations + _BATCH]


class GridSearch(_ListSearch):
    """Exhaustive search of a full factorial grid that includes both bounds; the last variable changes fastest.

    Parameters
    ----------
    lower, upper : array_like, (d,)
        Bounds of each variable.
    points : sequence of int, (d,)
        Nodes along each variable, 2 or more: ``(26, 26)`` is 0.1 m by 1 degree on the paper's bounds. See
        `grid_points` for the finest grid within a budget.
    periodic : sequence of bool, (d,), optional
        Which variables are circles.

    Raises
    ------
    InputError
        If the bounds cannot be used, or there is not one whole number of at least 2 points per variable.
    """

    name: ClassVar[str] = "grid"

    def __init__(
        self, lower: np.ndarray, upper: np.ndarray, *, points: Sequence[int], periodic: Sequence[bool] | None = None
    ) -> None:
        if np.shape(points) != (np.size(lower),):
            allowed = f"one whole number for each of the {np.size(lower)} variables"
            raise InputError(f"grid points: {points!r}; allowed: {allowed}")
        points = [check_whole(count, 2, "grid points") for count in points]
        super().__init__(lower, upper, budget=math.prod(points), periodic=periodic)
        ends = ~self.periodic  # a circle's upper bound is its lower one
        sides = zip(self.lower, self.upper, points, ends, strict=True)
        axes = [np.linspace(low, high, count, endpoint=end) for low, high, count, end in sides]
        self._list = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, self.lower.size)


class RandomSearch(_ListSearch):
    """Random search: independent uniform candidates.

    Parameters
    ----------
    lower, upper : array_like, (d,)
        Bounds of each variable.
    seed : int
        Same seed, same candidates.
    evaluations : int
        Their number, 1 or more.

    Raises
    ------
    InputError
        If the bounds, the seed or a number cannot be used.
    """

    name: ClassVar[str] = "random"

    def __init__(self, lower: np.ndarray, upper: np.ndarray, *, seed: int, evaluations: int) -> None:
        super().__init__(lower, upper, budget=check_whole(evaluations, 1, "evaluations"))
        self._list = uniform(generator(seed), self.budget, self.lower, self.upper)


def grid_points(evaluations: int, variables: int) -> tuple[int, ...]:
    """The finest near-cubic grid of at most `evaluations` nodes: points along each of `variables` variables.

    Raises
    ------
    InputError
        If the budget does not reach for both bounds of every variable, ``2 ** variables``.
    """
    evaluations = check_whole(evaluations, 2**variables, f"evaluations of a grid over {variables} variables")
    even = max(2, int(evaluations ** (1 / variables)) - 1)  # below the root, however that is rounded
    while (even + 1) ** variables <= evaluations:
        even += 1
    finer = 0  # variables with a point more
    while (even + 1) ** (finer + 1) * even ** (variables - finer - 1) <= evaluations:
        finer += 1
    return (even + 1,) * finer + (even,) * (variables - finer)
