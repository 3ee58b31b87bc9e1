"""Multi-fidelity search: screening on the cheapest rung, successive halving from rung to rung, and CMA-ES climbs.

A rung is a fidelity, cheap or dear, and some of the frames; the last one, the reference, is what counts. Only the best
candidates of a rung go on to the next (successive halving: Jamieson and Talwalkar, AISTATS 2016), unless blocks of time
leave no doubt that they are worse. Climbs race their samples over the frames. The caller is asked for candidates on a
fidelity and frames, and tells the objective on each frame; what a fidelity is, it alone knows.
"""

from __future__ import annotations

import math
from collections.abc import Hashable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ..errors import InputError
from ..statistics import FEWEST_BLOCKS, block_sums, student_t
from .cma_es import CovarianceAdaptation
from .search import Search, check_values, generator, history_of, in_box, wrapped

_STEPS = 0.1, 0.05, 0.012  # of the box, with which climbs start: on the first rung, later ones, and at the reference
_SAMPLES = 6, 7  # to a generation, and more for more variables; at the reference, where each is a round of large calls
_FIRST_SHARE = 0.33  # of the frames that all samples of a later climb meet; on the first rung they are few
_APART, _BARELY_APART = 0.04, 0.006  # of the box: what is nearer counts as the same mounting


@dataclass(frozen=True, slots=True)
class Rung:
    """What candidates are scored with on one rung.

    Attributes
    ----------
    fidelity : hashable
        What else than frames makes it cheap or dear; it has a `name`.
    frames : tuple of int
        Places among all frames, in the order in which rungs take them: a rung has all frames of the one below.
    candidates : int
        How many come here from the rung below, at most; the first rung has a search in their place.
    climb : int
        Samples of the climbs from the best of them in all; at the reference, of each.
    """

    fidelity: Hashable
    frames: tuple[int, ...]
    candidates: int = 0
    climb: int = 0


class Asked(NamedTuple):
    """What is to be scored next: candidates `x` (s, d), seen through a `fidelity` on some of the `frames`."""

    fidelity: Hashable
    frames: tuple[int, ...]
    x: np.ndarray


class MultiFidelitySearch:
    """Screening, successive halving and climbs, by ask and tell; as deterministic as a `Search`.

    Parameters
    ----------
    screen : Search
        Searches the box on the first rung.
    rungs : sequence of Rung
        From the cheapest to the reference, two or more.
    block : sequence of int, (f,)
        Block of time of each frame.
    seed : int
        Of the climbs.

    Attributes
    ----------
    done : bool
        Whether the climb at the reference has ended.
    evaluations : int
        Candidates scored so far, on any rung.
    """

    def __init__(self, screen: Search, rungs: Sequence[Rung], block: Sequence[int], *, seed: int) -> None:
        self._screen, self.rungs, self._block = screen, tuple(rungs), np.asarray(block)
        self.label, self.variables, self.is_final = screen.label, screen.variables, screen.is_final
        self._lower, self._upper, self._periodic = screen.lower, screen.upper, screen.periodic
        self._seed = seed
        self._level, self._work = 0, "screen"  # the rung that is at work, and at what
        self._records = [RungRecord(self._lower.size, rung.frames) for rung in self.rungs]
        self.done, self.evaluations = False, 0
        self._spent = [{"candidates": 0, "frame_casts": 0, "seconds": 0.0} for _ in self.rungs]
        self._batches = self._searched()
        self._asked = next(self._batches)

    @property
    def stage(self) -> str:
        """What is at work, in words."""
        rung = self.rungs[self._level]
        return f"{self._work}: {rung.fidelity.name}, {len(rung.frames)} frames"

    @property
    def budget(self) -> int:
        """Candidates that the whole search scores at most, on any rung."""
        return self._screen.budget + sum(rung.candidates + rung.climb for rung in self.rungs) + self.rungs[-1].climb

    @property
    def best_x(self) -> np.ndarray:
        """The best candidate at the reference, (d,), once there is one; the first of equals."""
        return self._records[-1].x[np.argmax(self._records[-1].totals)].copy()

    @property
    def best_value(self) -> float:
        """Its value; ``-inf`` before there is one."""
        return float(self._records[-1].totals.max(initial=-math.inf))

    @property
    def best_screened_x(self) -> np.ndarray:
        """The best candidate of the screening so far, (d,), which the first batch makes known."""
        return self._screen.best_x

    @property
    def history(self) -> np.ndarray:
        """One row for each candidate scored at the reference, as `Search.history`; a batch is an iteration."""
        confirmed = self._records[-1]
        return history_of(confirmed.x, confirmed.totals, np.array(confirmed.batches, dtype=int))

    @property
    def spent(self) -> list[dict[str, float]]:
        """What each rung has taken: frames, candidates, casts of a frame, seconds."""
        return [
            {"frames": len(rung.frames), **spent, "seconds": round(spent["seconds"], 3)}
            for rung, spent in zip(self.rungs, self._spent, strict=True)
        ]

    def ask(self) -> Asked:
        """What to score next; asking again returns the same."""
        return self._asked

    def tell(self, objective: np.ndarray, seconds: float = 0.0) -> None:
        """Take the objective of what was asked for, (s, frames asked for), and how long it took to score.

        Raises
        ------
        InputError
            If there is not one usable number for each candidate and frame; the search stays as it was.
        """
        asked, spent = self._asked, self._spent[self._level]
        objective = np.asarray(objective, dtype=float)
        if objective.shape != (len(asked.x), len(asked.frames)):
            allowed = len(asked.x), len(asked.frames)
            raise InputError(f"objective values: shape {objective.shape}; allowed: {allowed}, one per frame")
        check_values(objective.sum(axis=1), asked.x)
        if self._work != "climb" or asked.frames[0] == self.rungs[self._level].frames[0]:  # else counted when it began
            self.evaluations += len(asked.x)
            spent["candidates"] += len(asked.x)
        spent["frame_casts"] += objective.size
        spent["seconds"] += seconds
        try:
            self._asked = self._batches.send(objective)
        except StopIteration:
            self.done = True

    # What follows are generators of `Asked`, which are sent the objective of each, (s, frames asked for).

    def _searched(self) -> Iterator[Asked]:
        """The whole search, from the screen on the first rung to the climbs at the reference."""
        first = self.rungs[0]
        while not self._screen.done:
            x = self._screen.ask()
            objective = yield Asked(first.fidelity, first.frames, x)
            self._screen.tell(objective.sum(axis=1))
            self._records[0].add(x, objective)
        yield from self._climbed()
        while self._level < len(self.rungs) - 1:
            self._level += 1
            yield from self._halved()
            yield from self._climbed()

    def _halved(self) -> Iterator[Asked]:
        """Score the best of the rung below on those frames of this rung that they have not met."""
        self._work = "halving"
        below, rung, reference = self.rungs[self._level - 1], self.rungs[self._level], self.rungs[-1]
        record, alike = self._records[self._level - 1], below.fidelity == rung.fidelity
        unit, block = self._unit(record.x), self._block[list(below.frames)]
        distance = _APART if self._level == 1 else _BARELY_APART
        drops = NONE if not alike else ALL if below.fidelity == reference.fidelity else BUT_PEAKS
        kept = going_on(
            unit, record.objective, block, rung.candidates, distance=distance, drops=drops, periodic=self._periodic
        )
        x, known = record.x[kept], record.objective[kept, : len(below.frames) * alike]
        if known.shape[1] < len(rung.frames):  # with few frames rungs are alike
            new = yield Asked(rung.fidelity, rung.frames[known.shape[1] :], x.copy())
            known = np.concatenate([known, new], axis=1)
        self._records[self._level].add(x, known)

    def _climbed(self) -> Iterator[Asked]:
        """Climb from the best of a rung, and race the samples over its frames: see `_ranks`.

        CMA-ES needs no more than the ranks of its samples. Each generation is scored on the first frames of the rungs'
        order; its best third goes on to the others. All climbs of a rung keep step.
        """
        rung, record, block = self.rungs[self._level], self._records[self._level], self._block
        if not rung.climb:
            return
        self._work, unit, block = "climb", self._unit(record.x), block[list(rung.frames)]
        likely = self._level > 0
        starts = unit[climb_starts(unit, record.objective, block, likely=likely, periodic=self._periodic)]
        first = math.ceil((_FIRST_SHARE if self._level else 1.0) * len(rung.frames))
        at_reference = self._level == len(self.rungs) - 1
        step = _STEPS[2 if at_reference else min(self._level, 1)]
        samples = _SAMPLES[at_reference] + int(3.0 * math.log(self._lower.size))
        wanted = rung.climb * (len(starts) if at_reference else 1)  # too short to be shared by two
        climbs = []
        for number, start in enumerate(starts):
            generations = max(1, (wanted // samples + len(starts) - 1 - number) // len(starts))
            rng = generator(self._seed + self._level + number * len(self.rungs))
            climbs.append((CovarianceAdaptation(rng, start, step, samples, None, self._periodic), generations))
        while going := [climb for climb, last in climbs if climb.generation < last and not climb.exhausted]:
            for climb in going:
                climb.move()
            tried = [climb.candidates for climb in going]
            begun = whole = yield from self._asked_of(tried, rung, slice(0, first))
            rows = [np.arange(samples) for _ in going]
            if first < len(block):
                rows = [survivors(part, block[:first], math.ceil(samples / 3)) for part in begun]
                tried = [candidates[better] for candidates, better in zip(tried, rows, strict=True)]
                ends = yield from self._asked_of(tried, rung, slice(first, len(block)))
                parts = zip(begun, rows, ends, strict=True)
                whole = [np.concatenate([part[better], end], axis=1) for part, better, end in parts]
            record.add(self._in_box(np.concatenate(tried)), np.concatenate(whole))
            for climb, *scores in zip(going, begun, rows, whole, strict=True):
                climb.tell(_ranks(*scores))

    def _asked_of(self, tried: list[np.ndarray], rung: Rung, frames: slice) -> Iterator[Asked]:
        """Ask for the candidates of several climbs at once; returns the objective of each climb's, (s, frames)."""
        objective = yield Asked(rung.fidelity, rung.frames[frames], self._in_box(np.concatenate(tried)))
        return np.split(objective, np.cumsum([len(candidates) for candidates in tried])[:-1])

    def _unit(self, x: np.ndarray) -> np.ndarray:
        return (x - self._lower) / (self._upper - self._lower)

    def _in_box(self, unit: np.ndarray) -> np.ndarray:
        return in_box(unit, self._lower, self._upper)


def _ranks(begun: np.ndarray, rows: np.ndarray, whole: np.ndarray) -> np.ndarray:
    """What orders a generation, (samples,): `rows`, which met all frames, by these, above the others by the first.

    So the last of a generation's parents may be chosen by the first frames alone.
    """
    values = -np.argsort(np.argsort(-begun.sum(axis=1), kind="stable"), kind="stable").astype(float)
    totals = whole.sum(axis=1)
    values[rows] = 1.0 + np.searchsorted(np.sort(totals), totals)  # equals stay equal
    return values


class RungRecord:
    """Candidates that were scored on all frames of a rung, batch by batch.

    Parameters
    ----------
    variables : int
        Searched coordinates.
    frames : sequence of int, (f,)
        Places of the rung's frames among all, in the order of the rungs.

    Attributes
    ----------
    x, objective : ndarray, (s, variables) and (s, f)
        Candidates, and what they have on each frame.
    batches : list of int
        How many came together.
    """

    def __init__(self, variables: int, frames: Sequence[int]) -> None:
        self._in_time = np.argsort(frames)
        self.x = np.empty((0, variables))
        self.objective = np.empty((0, len(frames)))
        self.batches: list[int] = []

    def add(self, x: np.ndarray, objective: np.ndarray) -> None:
        """Record a batch of candidates (s, d) and their objective (s, f)."""
        self.x, self.objective = np.concatenate([self.x, x]), np.concatenate([self.objective, objective])
        self.batches.append(len(x))

    @property
    def totals(self) -> np.ndarray:
        """Objective of each candidate, (s,): summed over the frames in time, as an evaluation of it is."""
        return np.ascontiguousarray(self.objective[:, self._in_time]).sum(axis=1)


# --- Which mountings go on to a dearer rung, and from which of them to climb: the best, and those far from any better -

ALL, BUT_PEAKS, NONE = "all", "but peaks", "none"
_SAME = 1e-9  # of the box
_BASIN = 0.15  # of the box: a candidate that is the best so far about it stands for a basin of its own
_DOUBT = 0.05  # of all that are equal to the best, how often any is called clearly behind


def going_on(
    x: np.ndarray,
    objective: np.ndarray,
    block: np.ndarray,
    most: int,
    *,
    distance: float,
    drops: str,
    periodic: np.ndarray | bool = False,
) -> np.ndarray:
    """Rows of the candidates that go on to the next rung, the best first.

    Up to a quarter of the places, two at least, are for peaks, each the best within 0.15 of the box about it, so that
    what a dear rung ranks higher outlives cheap ones wherever it lies. The others are for the best that do not crowd
    each other.

    Parameters
    ----------
    x : ndarray, (s, d)
        Candidates, in shares of the box.
    objective : ndarray, (s, f)
        Of each candidate on each frame.
    block : ndarray of int, (f,)
        Block of time of each frame.
    most : int
        How many may go on.
    distance : float
        Within which candidates crowd each other; see `diverse`.
    drops : str
        `ALL` that are clearly behind the best; those `BUT_PEAKS` on a rung that the next one outdoes by more frames
        alone, while the reference may rank far places otherwise; `NONE` where the next one ranks otherwise itself: its
        error is not that of a sample of blocks.
    periodic : ndarray of bool, (d,), or bool
        Which variables are circles.

    Returns
    -------
    ndarray of int, (k,)
    """
    totals = objective.sum(axis=1)
    rows = np.argsort(-totals, kind="stable")
    behind = clearly_behind(objective[rows], block, most - 1) & (drops != NONE)
    high = np.isin(rows, peaks(x, totals, periodic))
    rows = rows[~behind | (high & (drops == BUT_PEAKS))]
    x, totals = x[rows], totals[rows]
    taken = peaks(x, totals, periodic)[: min(most, max(2, most // 4))].tolist()
    return rows[sorted(diverse(x, totals, most, distance, taken, periodic))]


def climb_starts(
    x: np.ndarray, objective: np.ndarray, block: np.ndarray, *, likely: bool, periodic: np.ndarray | bool = False
) -> np.ndarray:
    """Rows to climb from: the best, and the best peak far from it; a `likely` one alone is not clearly behind."""
    rows = peaks(x, objective.sum(axis=1), periodic)[:2]
    return rows[~clearly_behind(objective[rows], block, 1)] if likely else rows


def peaks(x: np.ndarray, values: np.ndarray, periodic: np.ndarray | bool = False) -> np.ndarray:
    """Local maxima: rows of the candidates (s, d), in shares of the box, that are the best within 0.15, best first."""
    order = np.argsort(-values, kind="stable")
    better = (_away(x[order[:place]], x[row], periodic) for place, row in enumerate(order))
    return np.array([row for row, away in zip(order, better, strict=True) if not (away <= _BASIN).any()], dtype=int)


def diverse(
    x: np.ndarray,
    values: np.ndarray,
    count: int,
    distance: float,
    taken: Sequence[int] = (),
    periodic: np.ndarray | bool = False,
) -> list[int]:
    """Rows of the best candidates that do not crowd each other, beginning with the best.

    From the best on, a candidate is taken unless one that is taken lies within the distance of it, which shrinks by
    halves until there are `count`, or no further ones.

    Parameters
    ----------
    x : ndarray, (s, d)
        Candidates, in shares of the box.
    values : ndarray, (s,)
        The higher the better.
    count : int
        How many are wanted.
    distance : float
        In the variable in which two candidates are farthest apart, as a share of the box.
    taken : sequence of int
        Rows that are taken already.
    periodic : ndarray of bool, (d,), or bool
        Which variables are circles.
    """
    order = np.argsort(-values, kind="stable")
    taken = list(taken)
    while len(taken) < count and distance > _SAME:
        for row in order:
            if len(taken) == count:
                break
            if not (_away(x[taken], x[row], periodic) <= distance).any():
                taken.append(int(row))
        distance /= 2.0
    return taken


def survivors(objective: np.ndarray, block: np.ndarray, most: int) -> np.ndarray:
    """Race: rows of at most so many candidates (s, f), the best first, none of which is clearly behind the best."""
    order = np.argsort(-objective.sum(axis=1), kind="stable")[:most]
    return order[~clearly_behind(objective[order], block, most - 1)]


def clearly_behind(objective: np.ndarray, block: np.ndarray, compared: int) -> np.ndarray:
    """One-sided t-test: which candidates (s, f) are clearly behind the first, the best; none with too few blocks.

    Clearly is by more than the one-sided bound of the difference, whose standard error is that of its sums over blocks:
    all candidates have met the same vehicles, so what they share falls away. With so many compared, the bound is such
    that any that equals one fixed first candidate is dropped in 5 % of cases (Bonferroni). The first is not fixed but
    the best, and so is lucky: of candidates that are all equal some are dropped in 9 % of cases (of two) to 27 % (of
    16), by simulation with 8 blocks.
    """
    blocks = len(np.unique(block))
    if blocks < FEWEST_BLOCKS:
        return np.zeros(len(objective), dtype=bool)
    behind = block_sums(objective[0] - objective, block)
    error = np.sqrt(blocks) * behind.std(axis=1, ddof=1)  # of the sum over the blocks
    return behind.sum(axis=1) > student_t(1.0 - _DOUBT / max(1, compared), blocks - 1) * error


def _away(some: np.ndarray, one: np.ndarray, periodic: np.ndarray | bool) -> np.ndarray:
    """How far candidates (k, d) are from one (d,), in the variable in which that is farthest."""
    return np.abs(wrapped(some - one, periodic)).max(axis=1)
