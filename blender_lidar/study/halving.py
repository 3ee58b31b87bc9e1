"""Which mountings go on to a dearer rung: diverse ones from a search, then those that others do not clearly beat."""

from __future__ import annotations

import numpy as np

from .statistics import FEWEST_BLOCKS, block_sums, student_t_95

_SAME = 1e-9  # of the box


def diverse(
    x: np.ndarray, values: np.ndarray, count: int, distance: float, lower: np.ndarray, upper: np.ndarray
) -> np.ndarray:
    """Rows of the best candidates that do not crowd each other, beginning with the best.

    From the best on, a candidate is taken unless one that is taken lies within the distance of it, which shrinks by
    halves until there are `count`, or no further ones.

    Parameters
    ----------
    x : ndarray, (s, d)
        Candidates.
    values : ndarray, (s,)
        The higher the better.
    count : int
        How many are wanted.
    distance : float
        In the variable in which two candidates are farthest apart, as a share of the box.
    lower, upper : ndarray, (d,)
        The box.
    """
    unit = (x - lower) / (upper - lower)
    order = np.argsort(-values, kind="stable")
    taken: list[int] = []
    while len(taken) < count and distance > _SAME:
        for row in order:
            if len(taken) == count:
                break
            if not taken or np.abs(unit[taken] - unit[row]).max(axis=1).min() > distance:
                taken.append(int(row))
        distance /= 2.0
    return np.array(taken)


def survivors(objective: np.ndarray, block: np.ndarray, most: int, *, tell_apart: bool) -> np.ndarray:
    """Rows of the candidates that go on, the best first: at most `most`, none that is clearly behind the best.

    Clearly is by more than the one-sided 95 % bound of the difference, whose standard error is that of its sums over
    blocks of time: all candidates have met the same vehicles, so what they share falls away.

    Parameters
    ----------
    objective : ndarray, (s, f)
        Of each candidate on each frame.
    block : ndarray of int, (f,)
        Block of time of each frame.
    most : int
        How many may go on.
    tell_apart : bool
        Whether candidates are dropped for being clearly behind. Not on a rung that ranks otherwise than the reference:
        its error is not that of a sample of blocks.
    """
    totals = objective.sum(axis=1)
    order = np.argsort(-totals, kind="stable")[:most]
    blocks = len(np.unique(block))
    if not tell_apart or blocks < FEWEST_BLOCKS:
        return order
    behind = block_sums(objective[order[0]] - objective[order], block)
    error = np.sqrt(blocks) * behind.std(axis=1, ddof=1)  # of the sum over the blocks
    return order[behind.sum(axis=1) <= student_t_95(blocks - 1) * error]
