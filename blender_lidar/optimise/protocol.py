"""The ask/tell protocol that every search follows: the caller owns the loop, the evaluation and the storage."""

from __future__ import annotations

from typing import Any, ClassVar, Protocol

import numpy as np


class Search(Protocol):
    """A search for the maximum of a function over a box.

    ::

        while not search.done:
            search.tell(objective(search.ask()))

    A search never calls the objective. Between any two calls it can be stored with `state` and rebuilt with
    `from_state`, here or in another process: what follows is the same to the last bit.
    """

    name: ClassVar[str]

    def ask(self) -> np.ndarray:
        """The candidates to evaluate next, (s, d), all within the bounds. Asking again returns the same ones.

        Raises
        ------
        InputError
            If the search is done.
        """

    def tell(self, values: np.ndarray) -> None:
        """Take the objective's values, (s,), of the candidates last asked for; the higher the better.

        ``-inf`` marks a candidate as infeasible.

        Raises
        ------
        InputError
            If there is not one value per candidate, or one is NaN or +inf: the candidate is named and the search
            stays as it was.
        """

    @property
    def done(self) -> bool:
        """Whether the budget is spent."""

    @property
    def budget(self) -> int:
        """Evaluations that the whole search makes."""

    @property
    def evaluations(self) -> int:
        """Candidates evaluated so far."""

    @property
    def iteration(self) -> int:
        """The iteration that the latest evaluation belongs to, from 1; 0 before the first."""

    @property
    def best_x(self) -> np.ndarray:
        """The best candidate so far, (d,); the first of equals.

        Raises
        ------
        InputError
            If nothing has been evaluated yet.
        """

    @property
    def best_value(self) -> float:
        """Its value; ``-inf`` before the first evaluation, and as long as no candidate was feasible."""

    @property
    def history(self) -> np.ndarray:
        """One row per evaluation, (evaluations, d + 5): evaluation, iteration, particle (all from 1), x, value, best so
        far."""

    def state(self) -> dict[str, Any]:
        """Everything that the search is, as plain lists, numbers and strings for JSON (``-inf`` as None)."""

    @classmethod
    def from_state(cls, state: dict[str, Any]) -> Search:
        """The search that `state` described.

        Raises
        ------
        InputError
            If the state is incomplete or contradicts itself.
        """
