"""What all searches share: the record of candidates and values, the best so far, and storing both."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from typing import Any, ClassVar, Self

import numpy as np

from ..errors import InputError
from .checks import check_bounds, check_values
from .stored import read_array, read_values, write_values


class RecordedSearch(ABC):
    """Base of the searches; see `Search` for the public methods.

    A subclass says which candidates are next, and may learn from `tell`. Between two calls those candidates are
    already fixed, so `ask` changes nothing and a stored search never loses a random draw.
    """

    name: ClassVar[str]

    def __init__(self, lower: np.ndarray, upper: np.ndarray, *, budget: int, per_iteration: int) -> None:
        self._lower, self._upper = check_bounds(lower, upper)
        self._budget = budget
        self._per_iteration = per_iteration
        self._x: list[list[float]] = []
        self._values: list[float] = []
        self._best = -1  # row of the best so far

    @abstractmethod
    def _candidates(self) -> np.ndarray:
        """The candidates to evaluate next, (s, d)."""

    @abstractmethod
    def _arguments(self) -> dict[str, Any]:
        """The constructor's arguments, for JSON."""

    def ask(self) -> np.ndarray:
        if self.done:
            raise InputError(f"search {self.name!r}: all {self._budget} evaluations are made; nothing is left to ask")
        return self._candidates().copy()

    def tell(self, values: np.ndarray) -> None:
        candidates = self.ask()
        values = check_values(values, candidates)
        self._record(candidates.tolist(), values.tolist())

    def _record(self, candidates: list[list[float]], values: list[float]) -> None:
        for x, value in zip(candidates, values, strict=True):
            if not self._values or value > self.best_value:
                self._best = len(self._values)
            self._x.append(x)
            self._values.append(value)

    @property
    def done(self) -> bool:
        return self.evaluations >= self._budget

    @property
    def budget(self) -> int:
        return self._budget

    @property
    def evaluations(self) -> int:
        return len(self._values)

    @property
    def iteration(self) -> int:
        return math.ceil(self.evaluations / self._per_iteration)

    @property
    def best_x(self) -> np.ndarray:
        if not self._values:
            raise InputError(f"search {self.name!r}: nothing has been evaluated yet")
        return np.array(self._x[self._best])

    @property
    def best_value(self) -> float:
        return self._values[self._best] if self._values else -math.inf

    @property
    def history(self) -> np.ndarray:
        values = np.array(self._values)
        iteration, particle = self._numbering()
        return np.column_stack(
            [
                np.arange(self.evaluations) + 1,
                iteration + 1,
                particle + 1,
                np.reshape(self._x, (-1, self._lower.size)),
                values,
                np.maximum.accumulate(values),
            ]
        )

    def _numbering(self) -> tuple[np.ndarray, np.ndarray]:
        """Iteration of every evaluation and its place there, both from 0."""
        return np.divmod(np.arange(self.evaluations), self._per_iteration)

    def state(self) -> dict[str, Any]:
        return {
            "search": self.name,
            "arguments": {"lower": self._lower.tolist(), "upper": self._upper.tolist(), **self._arguments()},
            "x": [list(x) for x in self._x],
            "values": write_values(self._values),
        }

    @classmethod
    def from_state(cls, state: dict[str, Any]) -> Self:
        try:
            search = cls._from_arguments(dict(state["arguments"]))
            search._restore(state)
        except (ArithmeticError, AttributeError, KeyError, TypeError, ValueError) as error:
            raise InputError(f"stored {cls.name!r} search cannot be used: {type(error).__name__}: {error}") from None
        return search

    @classmethod
    def _from_arguments(cls, arguments: dict[str, Any]) -> Self:
        return cls(**arguments)

    def _restore(self, state: dict[str, Any]) -> None:
        """Take over the record from `state`; a subclass adds what else it remembers."""
        values = read_values(state, "values", len(state["values"]))
        candidates = read_array(state, "x", (len(values), self._lower.size))
        if len(values) > self._budget:
            raise InputError(f"values: {len(values)} of {self._budget}")
        self._record(candidates.tolist(), check_values(values, candidates).tolist())
