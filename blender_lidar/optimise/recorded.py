"""What all searches share: the record of candidates and values, the best so far, and storing both."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from typing import Any, ClassVar, Self

import numpy as np

from ..errors import InputError
from .checks import check_bounds, check_values


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
        row = np.arange(self.evaluations)
        values = np.array(self._values)
        return np.column_stack(
            [
                row + 1,
                row // self._per_iteration + 1,
                row % self._per_iteration + 1,
                np.reshape(self._x, (-1, self._lower.size)),
                values,
                np.maximum.accumulate(values),
            ]
        )

    def state(self) -> dict[str, Any]:
        return {
            "search": self.name,
            "arguments": {"lower": self._lower.tolist(), "upper": self._upper.tolist(), **self._arguments()},
            "x": [list(x) for x in self._x],
            "values": [None if value == -math.inf else value for value in self._values],
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
        values = np.array([-math.inf if value is None else value for value in state["values"]], dtype=float)
        candidates = stored_array(state, "x", (len(values), self._lower.size))
        if len(values) > self._budget:
            raise InputError(f"values: {len(values)} of {self._budget}")
        self._record(candidates.tolist(), check_values(values, candidates).tolist())


def stored_array(state: dict[str, Any], key: str, shape: tuple[int, ...]) -> np.ndarray:
    """``state[key]`` as a finite float array of `shape`, or `InputError` naming the key."""
    array = np.array(state[key], dtype=float)
    if array.size == 0 and 0 in shape:
        return np.empty(shape)
    if array.shape != shape or not np.isfinite(array).all():
        raise InputError(f"{key}: shape {array.shape}; allowed: finite numbers, {shape}")
    return array
