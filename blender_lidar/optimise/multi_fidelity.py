"""Multi-fidelity search in two stages: screening at a coarse fidelity, then a climb at the full one from the best few.

The screening searches the box, and climbs once more from the best point of another hill, as the full fidelity may
rank hills otherwise. The best few mountings that lie apart are scored on everything, and CMA-ES climbs from the best of
these. What a fidelity is, the caller alone knows.
"""

from __future__ import annotations

import math
from collections.abc import Hashable
from typing import NamedTuple

import numpy as np

from .hardened import Polish
from .search import Search, wrapped

_STARTS = 8  # mountings that go on from the screening
_TOPS = 3  # of them, that are tops of hills, where there are so many
_APART, _HILL = 0.04, 0.15  # of the box, in one variable at least
_CLIMB = 20  # evaluations of a climb for each variable, of two at least: with one too it takes some generations
_STEPS = 0.1, 0.03  # of the box, with which climbs start: in the screening, at the full fidelity


class Asked(NamedTuple):
    """What is to be scored next: candidates `x` (s, d), seen through a `fidelity` on some of the `frames`."""

    fidelity: Hashable
    frames: tuple[int, ...]
    x: np.ndarray


class MultiFidelitySearch:
    """Screening and climb, by ask and tell; as deterministic as a `Search`.

    Parameters
    ----------
    screen : Search
        Searches the box at the coarse fidelity.
    fidelity : hashable
        The coarse one; it has a `name`.
    frames : tuple of int
        Places of the frames that it looks at.
    seed : int
        Of the climbs.

    Attributes
    ----------
    spent : list of dict
        What both stages have taken: candidates, seconds.
    """

    def __init__(self, screen: Search, fidelity: Hashable, frames: tuple[int, ...], *, seed: int) -> None:
        self.fidelity, self.frames, self._seed = fidelity, frames, seed
        self.label, self.variables, self.is_final = screen.label, screen.variables, screen.is_final
        self._screens: list[Search] = [screen]
        self._climb: Polish | None = None  # once the screening is done
        self.spent = [{"candidates": 0, "seconds": 0.0} for _ in range(2)]

    @property
    def stage(self) -> str:
        """What is at work, in words."""
        return f"screening: {self.fidelity.name}, {len(self.frames)} frames" if self._climb is None else "climb"

    @property
    def done(self) -> bool:
        """Whether the climb has ended."""
        return self._climb is not None and self._climb.done

    @property
    def evaluations(self) -> int:
        """Candidates scored so far, in either stage."""
        return sum(row["candidates"] for row in self.spent)

    @property
    def budget(self) -> int:
        """Candidates that both stages score at most."""
        return self._screens[0].budget + _STARTS + 2 * self._climb_budget

    @property
    def best_x(self) -> np.ndarray:
        """The best candidate, (d,), of the climb, or of the screening before it has one; the first of equals."""
        if self._climb is not None and self._climb.evaluations:
            return self._climb.best_x
        return max(self._screens, key=lambda search: search.best_value).best_x

    @property
    def best_value(self) -> float:
        """The best value of the climb, at the full fidelity; ``-inf`` before there is one."""
        return -math.inf if self._climb is None else self._climb.best_value

    @property
    def history(self) -> np.ndarray:
        """Of the climb, as `Search.history`."""
        return self._screens[0].history[:0] if self._climb is None else self._climb.history

    def ask(self) -> Asked | np.ndarray:
        """What to score next: candidates at the coarse fidelity, or at the full one (s, d); the same if asked again."""
        if self._climb is None:
            return Asked(self.fidelity, self.frames, self._screens[-1].ask())
        return self._climb.ask()

    def tell(self, values: np.ndarray, seconds: float = 0.0) -> None:
        """Take the objective of what was asked for, (s,), and how long it took to score; as `Search.tell`."""
        search, spent = (self._screens[-1], self.spent[0]) if self._climb is None else (self._climb, self.spent[1])
        before = search.evaluations
        search.tell(values)
        spent["candidates"] += search.evaluations - before
        spent["seconds"] += seconds
        if self._climb is None and search.done:
            self._go_on()

    def _go_on(self) -> None:
        """After a search at the coarse fidelity: climb another hill there, or at the full one from the best few."""
        first = self._screens[0]
        history = np.concatenate([search.history for search in self._screens])
        x, values = history[:, 3:-2], history[:, -2]
        shares = (x - first.lower) / (first.upper - first.lower)
        tops = peaks(shares, values, first.periodic)[:_TOPS]
        if len(self._screens) == 1 and len(tops) > 1:
            self._screens.append(self._polish(x[tops[1]], self._climb_budget, _STEPS[0]))
            return
        others = far_apart_best(shares, values, _APART, _STARTS, first.periodic)
        starts = x[list(dict.fromkeys([*tops, *others]))[:_STARTS]]
        self._climb = self._polish(starts, len(starts) + self._climb_budget, _STEPS[1])

    def _polish(self, start: np.ndarray, evaluations: int, step: float) -> Polish:
        first, seed = self._screens[0], self._seed
        about = {"start": start, "seed": seed, "evaluations": evaluations, "step": step, "periodic": first.periodic}
        return Polish(first.lower, first.upper, **about)

    @property
    def _climb_budget(self) -> int:
        return _CLIMB * max(2, self._screens[0].lower.size)


def peaks(shares: np.ndarray, values: np.ndarray, periodic: np.ndarray | bool = False) -> list[int]:
    """Local maxima: rows of the points (n, d), in shares of the box, that are the best within 0.15, the best first."""
    order = np.argsort(-values, kind="stable").tolist()
    nearest = (_away(shares[order[:place]], shares[row], periodic) for place, row in enumerate(order))
    return [row for row, near in zip(order, nearest, strict=True) if near > _HILL]


def far_apart_best(
    shares: np.ndarray, values: np.ndarray, distance: float, most: int, periodic: np.ndarray | bool = False
) -> list[int]:
    """Rows of the best points (n, d), in shares of the box, that lie at least so far from one another; the best first.

    Distance is in the variable in which two are farthest apart, the short way round where that is `periodic`.
    """
    chosen: list[int] = []
    for row in np.argsort(-values, kind="stable").tolist():
        if len(chosen) < most and _away(shares[chosen], shares[row], periodic) >= distance:
            chosen.append(row)
    return chosen


def _away(some: np.ndarray, one: np.ndarray, periodic: np.ndarray | bool) -> float:
    """How far the nearest of some points (k, d) is from one (d,), in the variable in which that is farthest."""
    return float(np.abs(wrapped(some - one, periodic)).max(axis=1).min(initial=np.inf))
