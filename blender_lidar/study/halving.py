"""Which mountings go on to a dearer rung, and from which of them to climb: the best, and those far from any better."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .statistics import FEWEST_BLOCKS, block_sums, student_t

ALL, BUT_PEAKS, NONE = "all", "but peaks", "none"
_SAME = 1e-9  # of the box
_BASIN = 0.15  # of the box: a candidate that is the best so far about it stands for a basin of its own
_DOUBT = 0.05  # of all that are equal to the best, how often any is called clearly behind


def going_on(
    x: np.ndarray, objective: np.ndarray, block: np.ndarray, most: int, *, distance: float, drops: str
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

    Returns
    -------
    ndarray of int, (k,)
    """
    totals = objective.sum(axis=1)
    rows = np.argsort(-totals, kind="stable")
    behind = clearly_behind(objective[rows], block, most - 1) & (drops != NONE)
    high = np.isin(rows, peaks(x, totals))
    rows = rows[~behind | (high & (drops == BUT_PEAKS))]
    x, totals = x[rows], totals[rows]
    taken = peaks(x, totals)[: min(most, max(2, most // 4))].tolist()
    return rows[sorted(diverse(x, totals, most, distance, taken))]


def climb_starts(x: np.ndarray, objective: np.ndarray, block: np.ndarray, *, likely: bool) -> np.ndarray:
    """Rows to climb from: the best, and the best peak far from it; a `likely` one alone is not clearly behind."""
    rows = peaks(x, objective.sum(axis=1))[:2]
    return rows[~clearly_behind(objective[rows], block, 1)] if likely else rows


def peaks(x: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Rows of the candidates (s, d), in shares of the box, that are the best within 0.15 about them, the best first."""
    order = np.argsort(-values, kind="stable")
    return np.array(
        [row for place, row in enumerate(order) if not (_away(x[order[:place]], x[row]) <= _BASIN).any()], dtype=int
    )


def diverse(x: np.ndarray, values: np.ndarray, count: int, distance: float, taken: Sequence[int] = ()) -> list[int]:
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
    """
    order = np.argsort(-values, kind="stable")
    taken = list(taken)
    while len(taken) < count and distance > _SAME:
        for row in order:
            if len(taken) == count:
                break
            if not (_away(x[taken], x[row]) <= distance).any():
                taken.append(int(row))
        distance /= 2.0
    return taken


def survivors(objective: np.ndarray, block: np.ndarray, most: int) -> np.ndarray:
    """Rows of at most so many candidates (s, f), the best first, none of which is clearly behind the best."""
    order = np.argsort(-objective.sum(axis=1), kind="stable")[:most]
    return order[~clearly_behind(objective[order], block, most - 1)]


def clearly_behind(objective: np.ndarray, block: np.ndarray, compared: int) -> np.ndarray:
    """Which candidates (s, f) are clearly behind the first, the best; none of them with too few blocks of time.

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


def _away(some: np.ndarray, one: np.ndarray) -> np.ndarray:
    """How far candidates (k, d) are from one (d,), in the variable in which that is farthest."""
    return np.abs(some - one).max(axis=1)
