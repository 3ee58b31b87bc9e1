"""What candidates have on one rung: where they lie, and their objective on each of its frames."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from ..errors import InputError
from ..optimise.stored import read_array, read_count


class RungRecord:
    """Candidates that were scored on all frames of a rung, batch by batch.

    Parameters
    ----------
    variables : int
        Searched coordinates.
    frames : sequence of int, (f,)
        Places of the rung's frames among the searched ones, in the order of the rungs.
    """

    def __init__(self, variables: int, frames: Sequence[int]) -> None:
        self._in_time = np.argsort(frames)
        self.x = np.empty((0, variables))
        self.objective = np.empty((0, len(frames)))
        self._batches: list[int] = []

    def __len__(self) -> int:
        return len(self.x)

    def add(self, x: np.ndarray, objective: np.ndarray) -> None:
        """Record a batch of candidates (s, d) and their objective (s, f); an empty one is none."""
        if len(x):
            self.x, self.objective = np.concatenate([self.x, x]), np.concatenate([self.objective, objective])
            self._batches.append(len(x))

    @property
    def totals(self) -> np.ndarray:
        """Objective of each candidate, (s,): summed over the frames in time, as an evaluation of it is."""
        return np.ascontiguousarray(self.objective[:, self._in_time]).sum(axis=1)

    @property
    def best(self) -> int:
        """Row of the best candidate; the first of equals.

        Raises
        ------
        InputError
            If there is none.
        """
        if not len(self):
            raise InputError("auto search: no mounting has come to this rung yet")
        return int(np.argmax(self.totals))

    @property
    def best_value(self) -> float:
        """Objective of the best candidate; ``-inf`` without one."""
        return float(self.totals.max(initial=-math.inf))

    @property
    def history(self) -> np.ndarray:
        """One row per candidate, as `Search.history`; a batch is an iteration."""
        batches, totals = np.array(self._batches, dtype=int), self.totals
        number = np.arange(len(self))
        return np.column_stack(
            [
                number + 1,
                np.repeat(np.arange(len(batches)), batches) + 1,
                number - np.repeat(np.cumsum(batches) - batches, batches) + 1,
                self.x,
                totals,
                np.maximum.accumulate(totals),
            ]
        )

    def state(self) -> dict[str, Any]:
        """All of it, for JSON."""
        return {"x": self.x.tolist(), "objective": self.objective.tolist(), "batches": self._batches}

    def restore(self, state: dict[str, Any]) -> None:
        """Become what `state` described; raises `InputError` naming what is damaged."""
        count = len(state["x"])
        self.x = read_array(state, "x", (count, self.x.shape[1]))
        self.objective = read_array(state, "objective", (count, self.objective.shape[1]))
        self._batches = [read_count({"batches": size}, "batches") for size in state["batches"]]
        if sum(self._batches) != count:
            raise InputError(f"batches: {sum(self._batches)} candidates in all, not {count}")
