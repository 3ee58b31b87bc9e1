"""The climbs of one rung, side by side: they share its samples."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..errors import InputError
from .raced_climb import RacedClimb


class RungClimbs:
    """A climb from each of some starts.

    Parameters
    ----------
    starts : ndarray, (k, d)
        Where they begin, in shares of the box, the best first.
    wanted, samples : int
        Samples in all, and to a generation; the best start takes the generation that is odd.
    step, first, block
        As for `RacedClimb`.
    seeds : sequence of int, (k,) or more
        Of each.
    """

    def __init__(
        self,
        starts: np.ndarray,
        wanted: int,
        samples: int,
        step: float,
        first: int,
        block: np.ndarray,
        seeds: range,
    ) -> None:
        self._starts, self._wanted, self._samples, self._step = starts, wanted, samples, step
        self._first, self._block, self._seeds = first, block, seeds
        self._climbs = [self._fresh(number) for number in range(len(starts))]

    @property
    def done(self) -> bool:
        """Whether all have ended."""
        return not self._going_on()

    def ask(self) -> tuple[np.ndarray, slice]:
        """Candidates of all climbs, (s, d) in shares of the box, and which of the frames they are to meet."""
        asked = [climb.ask() for climb in self._going_on()]
        return np.concatenate([candidates for candidates, _ in asked]), asked[0][1]  # they keep step

    def tell(self, objective: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """As `RacedClimb.tell`."""
        climbs = self._going_on()
        ends = np.cumsum([len(climb.ask()[0]) for climb in climbs])
        parts = zip(climbs, np.split(objective, ends[:-1]), strict=True)
        met, whole = zip(*(climb.tell(part) for climb, part in parts), strict=True)
        return np.concatenate(met), np.concatenate(whole)

    def _going_on(self) -> list[RacedClimb]:
        return [climb for climb in self._climbs if not climb.done]

    def _fresh(self, number: int) -> RacedClimb:
        count = len(self._starts)
        generations = max(1, (self._wanted // self._samples + count - 1 - number) // count)
        start, seed = self._starts[number], self._seeds[number]
        return RacedClimb(start, self._step, self._samples, generations, self._first, self._block, seed)

    def state(self) -> dict[str, Any]:
        """How far they have come, for JSON."""
        return {"starts": self._starts.tolist(), "climbs": [climb.state() for climb in self._climbs]}

    def restore(self, state: dict[str, Any]) -> None:
        """Become what `state` described, with the starts that it names; raises `InputError` if it is damaged."""
        if len(state["climbs"]) != len(self._climbs):
            raise InputError(f"climbs: {len(state['climbs'])}; allowed: one for each of {len(self._climbs)} starts")
        for climb, stored in zip(self._climbs, state["climbs"], strict=True):
            climb.restore(stored)
        phases = {climb.ask()[1].start for climb in self._going_on()}
        if len(phases) > 1:
            raise InputError(f"climbs: {len(phases)} phases; allowed: 1, as they keep step")
