"""Times of things done side by side: in rounds, so that a busy moment of the machine falls on all of them."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ..errors import InputError


class Entry(NamedTuple):
    """Something to time.

    Attributes
    ----------
    name : str
        What it is; the same in every column.
    act : callable
        Does it once.
    group : str
        Where it stands in a table.
    scale : float
        What a measured time is multiplied by: beams that it stands for over beams that it casts, say.
    note : str
        What one has to know beside the number.
    """

    name: str
    act: Callable[[], object]
    group: str
    scale: float = 1.0
    note: str = ""


class Quartiles(NamedTuple):
    """Median and quartiles over rounds."""

    low: float
    median: float
    high: float


@dataclass(frozen=True, slots=True, eq=False)
class Timing:
    """What came of an entry: seconds (rounds, columns), scaled."""

    name: str
    group: str
    note: str
    seconds: np.ndarray

    @property
    def quartiles(self) -> Quartiles:
        """Over the rounds, of the median column of each [s]."""
        return quartiles(np.median(self.seconds, axis=1))

    def ratio(self, rival: Timing) -> Quartiles:
        """Over the rounds, of the median of the ratios of pairs measured within the same round in the same column."""
        if self.seconds.shape != rival.seconds.shape:
            raise InputError(
                f"{self.name} was timed {self.seconds.shape} times and {rival.name} {rival.seconds.shape}; "
                "allowed: as many rounds and columns"
            )
        return quartiles(np.median(self.seconds / rival.seconds, axis=1))


def quartiles(values: np.ndarray) -> Quartiles:
    """Median and quartiles of (n,) values, straight lines between neighbours."""
    return Quartiles(*(float(value) for value in np.quantile(values, (0.25, 0.5, 0.75))))


def in_rounds(
    columns: Sequence[Sequence[Entry]],
    rounds: int,
    *,
    warm: bool = True,
    told: Callable[[], None] = lambda: None,
    clock: Callable[[], float] = time.perf_counter,
    into: dict[str, Timing] | None = None,
) -> dict[str, Timing]:
    """Time every entry of every column once in each round, one entry after another.

    Parameters
    ----------
    columns : sequence of sequence of Entry
        The same entries for each of several frames, say.
    rounds : int
        How often.
    warm : bool
        Whether each is done once just before it is timed: a search scores one frame for a whole swarm in a row, so that
        caches are warm.
    told : callable
        Called after each round.
    clock : callable
        Seconds from any zero.
    into : dict, optional
        What is returned is added to it round by round, so that whoever is interrupted keeps the rounds before.

    Returns
    -------
    dict of str to Timing
        By name.
    """
    names = [entry.name for entry in columns[0]] if columns else []
    if len(set(names)) < len(names) or any([entry.name for entry in column] != names for column in columns):
        raise InputError(f"timed side by side: {names}; allowed: different names, the same ones in each column")
    into = {} if into is None else into
    first = columns[0] if columns else ()
    seconds = np.empty((len(names), rounds, len(columns)))
    for turn in range(rounds):
        for at, column in enumerate(columns):
            for row, entry in enumerate(column):
                if warm:
                    entry.act()
                start = clock()
                entry.act()
                seconds[row, turn, at] = (clock() - start) * entry.scale
        for entry, times in zip(first, seconds, strict=True):
            into[entry.name] = Timing(entry.name, entry.group, entry.note, times[: turn + 1])
        told()
    return {name: into[name] for name in names}
