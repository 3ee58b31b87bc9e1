"""What a thing that is modelled changes: score, ranking and choice without it and with it, each with its interval.

Intervals leave out one block of traffic after another (the jackknife), of those that choose and of those that judge,
and have the spread between random draws in them: units of a sensor, or what its returns' noise draws.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ..study.statistics import FEWEST_BLOCKS, student_t
from .calibration import calibrated_residuals, root_mean_square
from .candidates import BASELINE, FIRST
from .halves import chosen_by
from .ranking import weighted_tau

SCORE, ERROR, RANKING, OPTIMUM, BIAS, COST = "score", "error", "ranking", "optimum", "bias", "cost"
EFFECTS = (SCORE, ERROR, RANKING, OPTIMUM, BIAS, COST)
_OF_JUDGES = (OPTIMUM, COST)
_UNSIGNED = (SCORE, ERROR, OPTIMUM)


class Effect(NamedTuple):
    """A number, and its 90 % interval; None for too few blocks."""

    value: float
    interval_90: tuple[float, float] | None


@dataclass(frozen=True, slots=True, eq=False)
class Draw:
    """One random draw of a thing, or the thing itself where nothing is drawn; k candidates.

    Attributes
    ----------
    without, having : ndarray, (k, b)
        Objective of each candidate in each block that chooses.
    vehicles : ndarray, (b,)
        In those blocks; none is empty.
    judged : ndarray, (1 + k, j), or None
        Objective with the thing of the baseline and the candidates in each block that judges; candidates that neither
        side chooses may be NaN.
    """

    without: np.ndarray
    having: np.ndarray
    vehicles: np.ndarray
    judged: np.ndarray | None


def choices(draw: Draw, halves: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """What each half would choose without the thing and with it, (1 + b, s, 2) each: first of all blocks, then with one
    block left out after another."""
    blocks = halves.shape[-1]
    kept = np.concatenate([np.ones((1, blocks), dtype=bool), ~np.eye(blocks, dtype=bool)])
    there = halves[None] & kept[:, None, None, :]
    return chosen_by(there, draw.without), chosen_by(there, draw.having)


def effects(draws: Sequence[Draw], halves: np.ndarray) -> dict[str, Effect | None]:
    """All effects of a thing, means over its draws; None for those that cannot be known.

    Returns
    -------
    dict
        ``score``: mean difference over the candidates, per vehicle, without sign, and ``bias`` with it, positive where
        the thing scores more. ``error``: what calibration leaves of it. ``ranking``: `ranking.weighted_tau` of both.
        ``optimum``: mean difference, without sign, between what both choose from the same half of the blocks, on the
        blocks that judge, as a share of the gain there; ``cost`` with its sign: positive is lost without the thing.
    """
    searched = np.array([_left_out_of_searched(draw) for draw in draws])  # (d, 1 + b, 4)
    found = {name: _effect(name, searched[:, :, column]) for column, name in enumerate((SCORE, ERROR, RANKING, BIAS))}
    judged = [_judged(draw, halves) for draw in draws]
    for column, name in enumerate(_OF_JUDGES):
        known = all(one is not None for one in judged)
        found[name] = None
        if known:
            found[name] = _effect(name, *(np.array(part)[:, :, column] for part in zip(*judged, strict=True)))
    return found


def _left_out_of_searched(draw: Draw) -> np.ndarray:
    """Score, error, ranking and bias, of all blocks and without each of them, (1 + b, 4)."""
    blocks = len(draw.vehicles)
    kept = np.concatenate([np.ones((1, blocks)), 1.0 - np.eye(blocks)])
    vehicles = np.maximum(kept @ draw.vehicles, 1.0)  # none is left where the only block is left out
    rows = []
    for without, having in zip(*((kept @ of.T) / vehicles[:, None] for of in (draw.without, draw.having)), strict=True):
        bias = float(np.mean(having - without))
        error = root_mean_square(calibrated_residuals(without, having))
        rows.append((abs(bias), error, weighted_tau(without, having), bias))
    return np.array(rows)


def _judged(draw: Draw, halves: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """Optimum and cost: without each block that chooses, (1 + b, 2), and without each that judges, (1 + j, 2)."""
    if draw.judged is None:
        return None
    without, having = choices(draw, halves)
    whole = draw.judged.sum(axis=1)
    rows = [_apart(*both, whole) for both in zip(without, having, strict=True)]
    others = [_apart(without[0], having[0], whole - one) for one in draw.judged.T]
    if any(row is None for row in (*rows, *others)):
        return None
    return np.array(rows), np.array([rows[0], *others])


def _apart(without: np.ndarray, having: np.ndarray, worth: np.ndarray) -> tuple[float, float] | None:
    """How far choices are apart and what is lost, as shares of the gain; None where nothing is gained."""
    lost = worth[FIRST + having] - worth[FIRST + without]
    gain = float(worth[FIRST + having].mean() - worth[BASELINE])
    return (float(np.abs(lost).mean() / gain), float(lost.mean() / gain)) if gain > 0.0 else None


def _effect(name: str, *left_out: np.ndarray) -> Effect | None:
    """From the values of each draw on everything and without each block, (d, 1 + b), for each sort of blocks."""
    least, most = (0.0 if name in _UNSIGNED else -np.inf), (1.0 if name == RANKING else np.inf)
    of_draws = left_out[0][:, 0]
    value, parts = float(of_draws.mean()), []
    if not np.isfinite(value):
        return None
    for values in left_out:
        means = values[:, 1:].mean(axis=0)
        if len(means) < FEWEST_BLOCKS or not np.isfinite(means).all():
            return Effect(value, None)
        parts.append(((len(means) - 1) * float(np.var(means)), len(means) - 1))
    if len(of_draws) > 1:
        parts.append((float(np.var(of_draws, ddof=1)) / len(of_draws), len(of_draws) - 1))
    variance = sum(part for part, _ in parts)
    if variance <= 0.0:
        return Effect(value, (value, value))
    degrees = variance**2 / sum(part**2 / free for part, free in parts)  # Welch and Satterthwaite
    reach = student_t(0.95, degrees) * float(np.sqrt(variance))
    return Effect(value, (max(value - reach, least), min(value + reach, most)))
