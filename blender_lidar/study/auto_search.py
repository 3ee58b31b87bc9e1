"""A search that spends little: it screens on the cheapest rung, halves from rung to rung and climbs where it is told.

It is told the objective of each candidate on each frame of what it asks for. As a `Search`, it neither scores nor
stores by itself: between any two calls it can be stored with `state` and goes on as if never stopped.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from ..errors import InputError
from ..optimise import Search, search_from_state
from ..optimise.checks import check_values
from ..optimise.stored import read_array, read_count
from .fidelity import Fidelity
from .halving import ALL, BUT_PEAKS, NONE, climb_starts, going_on
from .rung_climbs import RungClimbs
from .rung_record import RungRecord
from .rungs import Rung
from .spending import Spending

NAME = "auto"
_STEPS = 0.1, 0.05, 0.012  # of the box, with which climbs start: on the first rung, later ones, and at the reference
_SAMPLES = 6, 7  # to a generation, and more for more variables; at the reference, where each is a round of large calls
_FIRST_SHARE = 0.33  # of the frames that all samples of a later climb meet; on the first rung they are few
_APART, _BARELY_APART = 0.04, 0.006  # of the box: what is nearer counts as the same mounting


class Asked(NamedTuple):
    """What is to be scored next.

    Attributes
    ----------
    fidelity : Fidelity
        With which shapes and beams.
    frames : tuple of int
        On which of the searched frames.
    x : ndarray, (s, d)
        The candidates.
    """

    fidelity: Fidelity
    frames: tuple[int, ...]
    x: np.ndarray


class AutoSearch:
    """Screening, successive halving and climbs.

    Parameters
    ----------
    screen : Search
        Searches on the first rung; fresh, or restored.
    rungs : sequence of Rung
        From the cheapest to the reference, two or more.
    block : sequence of int, (f,)
        Block of time of each searched frame.
    lower, upper : sequence of float, (d,)
        The box.
    seed : int
        Of the climbs.
    """

    def __init__(
        self,
        screen: Search,
        rungs: Sequence[Rung],
        block: Sequence[int],
        lower: Sequence[float],
        upper: Sequence[float],
        *,
        seed: int,
    ) -> None:
        self._screen, self._rungs, self._block = screen, tuple(rungs), np.asarray(block)
        self._lower, self._upper = np.array(lower, dtype=float), np.array(upper, dtype=float)
        self._seed = seed
        self._level = 0  # of the rung that is at work
        self._x = np.empty((0, self._lower.size))  # candidates that came to this rung
        self._known = np.empty((0, 0))  # what they have on its frames from the rung below
        self._record = self._fresh_record()
        self._climb: RungClimbs | None = None
        self._done = False
        self._spending = Spending(rungs)

    @property
    def done(self) -> bool:
        """Whether the climb at the reference has ended."""
        return self._done

    @property
    def stage(self) -> str:
        """What is at work, in words."""
        what = "climb" if self._climb is not None else "halving" if self._level else "screen"
        return f"{what}: {self._rung.fidelity.name}, {len(self._rung.frames)} frames"

    @property
    def budget(self) -> int:
        """Candidates that the whole search scores at most, on any rung."""
        return self._screen.budget + sum(rung.candidates + rung.climb for rung in self._rungs) + self._rungs[-1].climb

    @property
    def evaluations(self) -> int:
        """Candidates scored so far, on any rung."""
        return self._spending.candidates

    @property
    def confirmed(self) -> RungRecord:
        """Candidates scored at the reference."""
        return self._record if self._at_reference else RungRecord(self._lower.size, self._rungs[-1].frames)

    @property
    def best_x(self) -> np.ndarray:
        """The best candidate at the reference, (d,); raises `InputError` before there is one."""
        return self.confirmed.x[self.confirmed.best].copy()

    @property
    def best_value(self) -> float:
        """Its value; ``-inf`` before there is one."""
        return self.confirmed.best_value

    @property
    def history(self) -> np.ndarray:
        """One row for each candidate scored at the reference, as `Search.history`."""
        return self.confirmed.history

    @property
    def spent(self) -> list[dict[str, Any]]:
        """What each rung has taken: fidelity, frames, candidates, casts of a frame, seconds."""
        return self._spending.rows()

    @property
    def _rung(self) -> Rung:
        return self._rungs[self._level]

    @property
    def _at_reference(self) -> bool:
        return self._level == len(self._rungs) - 1

    def ask(self) -> Asked:
        """What to score next; asking again returns the same."""
        rung = self._rung
        if self._climb is None and self._level == 0:
            return Asked(rung.fidelity, rung.frames, self._screen.ask())
        if self._climb is None:
            return Asked(rung.fidelity, rung.frames[self._known.shape[1] :], self._x.copy())
        unit, frames = self._climb.ask()
        return Asked(rung.fidelity, rung.frames[frames], self._in_box(unit))

    def tell(self, objective: np.ndarray, seconds: float = 0.0) -> None:
        """Take the objective of what was asked for, (s, frames asked for), and what it took to score."""
        asked, level = self.ask(), self._level
        totals = check_values(objective.sum(axis=1), asked.x)
        begun = self._climb is not None and asked.frames[0] != self._rung.frames[0]  # counted when it began
        self._spending.add(level, candidates=0 if begun else len(totals), casts=objective.size, seconds=seconds)
        if self._climb is not None:
            met, whole = self._climb.tell(objective)
            self._record.add(self._in_box(met), whole)
            if self._climb.done:
                self._go_on()
        elif level == 0:
            self._screen.tell(totals)
            self._record.add(asked.x, objective)
            if self._screen.done:
                self._climb_or_go_on()
        else:
            self._arrive(np.concatenate([self._known, objective], axis=1))

    def _arrive(self, objective: np.ndarray) -> None:
        """Record what came to this rung, now that it has met all of its frames."""
        self._record.add(self._x, objective)
        self._climb_or_go_on()

    def _climb_or_go_on(self) -> None:
        rung = self._rung
        if not rung.climb:
            self._go_on()
            return
        unit, likely = self._unit(self._record.x), self._level > 0
        starts = climb_starts(unit, self._record.objective, self._block_of(rung), likely=likely)
        self._climb = self._fresh_climbs(unit[starts])

    def _go_on(self) -> None:
        """Send the best to the next rung; from the last one there is none."""
        if self._at_reference:
            self._done = True
            return
        below, record = self._rung, self._record
        self._level += 1
        kept = going_on(
            self._unit(record.x),
            record.objective,
            self._block_of(below),
            self._rung.candidates,
            distance=_APART if self._level == 1 else _BARELY_APART,
            drops=self._drops(below),
        )
        self._climb, self._record = None, self._fresh_record()
        self._x, self._known = record.x[kept], record.objective[kept, : self._met_below(self._level)]
        if self._known.shape[1] == len(self._rung.frames):  # with few frames rungs are alike
            self._arrive(self._known)

    def _met_below(self, level: int) -> int:
        """On how many of a rung's frames its candidates were scored on the rung below."""
        below, rung = self._rungs[level - 1 : level + 1]
        return len(below.frames) if below.fidelity == rung.fidelity else 0

    def _drops(self, below: Rung) -> str:
        """Which of those that are clearly behind on a rung stay there."""
        if below.fidelity != self._rung.fidelity:
            return NONE
        return ALL if below.fidelity == self._rungs[-1].fidelity else BUT_PEAKS

    def _fresh_record(self) -> RungRecord:
        return RungRecord(self._lower.size, self._rung.frames)

    def _fresh_climbs(self, starts: np.ndarray) -> RungClimbs:
        rung = self._rung
        first = math.ceil((_FIRST_SHARE if self._level else 1.0) * len(rung.frames))
        step = _STEPS[2 if self._at_reference else min(self._level, 1)]
        seed, apart = self._seed + self._level, len(self._rungs)
        seeds = range(seed, seed + apart * len(starts), apart)
        samples = _SAMPLES[self._at_reference] + int(3.0 * math.log(self._lower.size))
        wanted = rung.climb * (len(starts) if self._at_reference else 1)  # too short to be shared by two
        return RungClimbs(starts, wanted, samples, step, first, self._block_of(rung), seeds)

    def _block_of(self, rung: Rung) -> np.ndarray:
        """Block of time of each of a rung's frames."""
        return self._block[list(rung.frames)]

    def _unit(self, x: np.ndarray) -> np.ndarray:
        return (x - self._lower) / (self._upper - self._lower)

    def _in_box(self, unit: np.ndarray) -> np.ndarray:
        return np.clip(self._lower + unit * (self._upper - self._lower), self._lower, self._upper)

    def state(self) -> dict[str, Any]:
        """Everything that it is but for its arguments, for JSON."""
        return {
            "search": NAME,
            "screen": self._screen.state(),
            "level": self._level,
            "x": self._x.tolist(),
            "known": self._known.tolist(),
            "record": self._record.state(),
            "climb": None if self._climb is None else self._climb.state(),
            "done": self._done,
            "spent": self._spending.state(),
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Become what `state` described.

        Raises
        ------
        InputError
            If the state is incomplete or contradicts itself.
        """
        try:
            self._restore(state)
        except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as error:
            raise InputError(f"stored {NAME!r} search cannot be used: {type(error).__name__}: {error}") from None

    def _restore(self, state: dict[str, Any]) -> None:
        if state["search"] != NAME:
            raise InputError(f"search: {state['search']!r}; allowed: {NAME!r}")
        self._screen = search_from_state(state["screen"])
        self._level = read_count(state, "level", len(self._rungs) - 1)
        self._x = read_array(state, "x", (len(state["x"]), self._lower.size))
        met = self._met_below(self._level) if self._level else 0
        self._known = read_array(state, "known", (len(self._x), met))
        self._record = self._fresh_record()
        self._record.restore(state["record"])
        self._done = bool(state["done"])
        self._spending.restore(state["spent"])
        climb = state["climb"]
        if climb is not None:
            self._climb = self._fresh_climbs(read_array(climb, "starts", (len(climb["starts"]), self._lower.size)))
            self._climb.restore(climb)
            if self._climb.done and not self._done:
                raise InputError("climb: all have ended, the search has not")
