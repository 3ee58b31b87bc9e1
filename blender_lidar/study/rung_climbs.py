"""The climbs of one rung, one after another: they share its samples."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ..optimise.stored import read_count
from .raced_climb import RacedClimb

_SAMPLES = 4  # to a generation, and more for more variables


class RungClimbs:
    """A climb from each of some starts.

    Parameters
    ----------
    starts : ndarray, (k, d)
        Where they begin, in shares of the box, the best first.
    wanted : int
        Samples in all; the best start takes the generation that is odd.
    step, first, block
        As for `RacedClimb`.
    seeds : sequence of int, (k,) or more
        Of each.
    """

    def __init__(
        self, starts: np.ndarray, wanted: int, step: float, first: int, block: np.ndarray, seeds: range
    ) -> None:
        self._starts, self._wanted, self._step, self._first = starts, wanted, step, first
        self._block, self._seeds = block, seeds
        self._number = 0  # of the one that is at work
        self._climb = self._fresh()

    @property
    def done(self) -> bool:
        """Whether all have ended."""
        return self._climb.done and self._number == len(self._starts) - 1

    def ask(self) -> tuple[np.ndarray, slice]:
        """As `RacedClimb.ask`."""
        return self._climb.ask()

    def tell(self, objective: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """As `RacedClimb.tell`."""
        told = self._climb.tell(objective)
        if self._climb.done and not self.done:
            self._number += 1
            self._climb = self._fresh()
        return told

    def _fresh(self) -> RacedClimb:
        count, d = self._starts.shape
        samples = _SAMPLES + int(3.0 * math.log(d))
        generations = max(1, (self._wanted // samples + count - 1 - self._number) // count)
        start, seed = self._starts[self._number], self._seeds[self._number]
        return RacedClimb(start, self._step, samples, generations, self._first, self._block, seed)

    def state(self) -> dict[str, Any]:
        """How far they have come, for JSON."""
        return {"starts": self._starts.tolist(), "number": self._number, "climb": self._climb.state()}

    def restore(self, state: dict[str, Any]) -> None:
        """Become what `state` described, with the starts that it names; raises `InputError` if it is damaged."""
        self._number = read_count(state, "number", len(self._starts) - 1)
        self._climb = self._fresh()
        self._climb.restore(state["climb"])
