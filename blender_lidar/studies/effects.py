"""Statistics of the chart: how near one score of mountings comes to another, and what a change of the model does.

Ranking (weighted Kendall's tau), cross-fitted calibration, regret of choices on resampled blocks of traffic, the noise
ceiling of halved blocks, and jackknife intervals. Jackknife intervals leave out one block of traffic after another, of
those that choose and of those that judge, and have the spread between random draws in them: units of a sensor, or what
its returns' noise draws.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ..errors import InputError
from ..optimise.search import generator
from ..scene.scenario import Scenario
from ..sensors.pose import Pose
from ..statistics import FEWEST_BLOCKS, linear_interval_90, resampled_weights, student_t
from .driver import Landscape

SOBOL_BITS = 30
BASELINE, FIRST = 0, 1  # rows of a landscape: the baseline, and where the candidates begin


@dataclass(frozen=True, slots=True, eq=False)
class Candidates:
    """Mountings to compare.

    Attributes
    ----------
    variables : tuple of str
        Names of the searched coordinates.
    points : ndarray, (k, d)
        The candidates [m, degrees].
    poses : tuple of Pose, (1 + k)
        The baseline and the candidates.
    """

    variables: tuple[str, ...]
    points: np.ndarray
    poses: tuple[Pose, ...]

    def select(self, numbers: Sequence[int]) -> Candidates:
        """The baseline and some of the candidates, by their rows in `points`."""
        poses = (self.poses[BASELINE], *(self.poses[FIRST + number] for number in numbers))
        return Candidates(self.variables, self.points[list(numbers)], poses)


def candidates(scenario: Scenario, count: int) -> Candidates:
    """So many points of Sobol's sequence over [deployment], shifted at random by the scene's seed.

    Raises
    ------
    InputError
        When nothing is searched.
    """
    deployment = scenario.deployment
    if not deployment.bounds:
        raise InputError(
            f"{scenario.source}: [deployment] fixes every coordinate; allowed: at least one a pair [low, high]"
        )
    lower, upper = np.array(deployment.lower, dtype=float), np.array(deployment.upper, dtype=float)
    points = sobol(scenario.search.seed, count, lower, upper)
    poses = (scenario.baseline_pose, *(deployment.pose(point) for point in points))
    return Candidates(deployment.variables, points, poses)


def sobol(seed: int, count: int, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
    """The first points of Sobol's sequence in a box, all shifted alike (digit by digit) by a random amount, (count, d).

    Any 2^m of them that follow a multiple of 2^m fill the box evenly.
    """
    from scipy.stats import qmc

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # that any other count than a power of 2 is less even
        points = qmc.Sobol(lower.size, scramble=False, bits=SOBOL_BITS).random(count)
    shift = generator(seed).integers(1 << SOBOL_BITS, size=lower.size)
    digits = (points * (1 << SOBOL_BITS)).astype(np.int64) ^ shift
    return np.clip(lower + (digits + 0.5) / (1 << SOBOL_BITS) * (upper - lower), lower, upper)


# --- ranking, calibration, Pareto front -------------------------------------------------------------------------------


def weighted_tau(values: np.ndarray, reference: np.ndarray) -> float:
    """Kendall's tau-b of two scores (k,), each pair weighted by the reference's ranks (Vigna 2015).

    The weight of a pair is ``1 / (1 + r) + 1 / (1 + s)`` with the ranks r and s, 0 for the best: additive and
    hyperbolic. Of mountings that the reference holds for equal, those that `values` holds for better rank first.

    Returns
    -------
    float
        From -1 to 1; NaN where one of the two prefers no mounting to another.
    """
    rank = np.empty(len(reference), dtype=int)
    rank[np.lexsort((values, reference))[::-1]] = np.arange(len(reference))
    hyperbolic = 1.0 / (1.0 + rank)
    weight = np.add.outer(hyperbolic, hyperbolic)
    np.fill_diagonal(weight, 0.0)
    first, second = (np.sign(np.subtract.outer(scores, scores)) for scores in (values, reference))
    scale = np.sqrt((weight * first**2).sum() * (weight * second**2).sum())
    return float((weight * first * second).sum() / scale) if scale > 0.0 else float("nan")


def calibrated_residuals(values: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """Residuals of a cross-fitted linear regression: reference less ``a + b values``, (k,).

    For each half of the mountings a and b are fitted by least squares on the other half; where `values` prefers no
    mounting to another, b is 0.
    """
    half = len(values) // 2
    first, second = slice(0, half), slice(half, None)
    residuals = np.empty(len(values))
    for judged, fitted in ((first, second), (second, first)):
        intercept, slope = _line(values[fitted], reference[fitted])
        residuals[judged] = reference[judged] - (intercept + slope * values[judged])
    return residuals


def _line(x: np.ndarray, y: np.ndarray) -> tuple[float, float]:
    away = x - x.mean()
    spread = float(away @ away)
    slope = float(away @ y) / spread if spread > 0.0 else 0.0
    return float(y.mean() - slope * x.mean()), slope


def root_mean_square(residuals: np.ndarray) -> float:
    """Of residuals."""
    return float(np.sqrt(np.mean(np.square(residuals))))


def pareto_front(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Rows that no other row is as good as in both costs and better than in one, (f,), by rising first cost.

    Equal rows are all kept.
    """
    order = np.lexsort((second, first))
    kept, least, last = [], np.inf, None
    for row in order.tolist():
        both = (first[row], second[row])
        if second[row] < least or both == last:
            kept.append(row)
            least, last = second[row], both
    return np.array(kept, dtype=int)


# --- halves of the blocks against each other: what other traffic of this kind would say -------------------------------


SPLITS = 200
FEWEST_HALVED = 4  # blocks: two in each half


def halvings(blocks: int, seed: int) -> np.ndarray:
    """Which blocks are in the one half and which in the other, `SPLITS` times at random, (s, 2, blocks) bool."""
    rng = np.random.default_rng(seed)
    halves = np.zeros((SPLITS, 2, blocks), dtype=bool)
    for number in range(SPLITS):
        order = rng.permutation(blocks)
        halves[number, 0, order[: blocks // 2]] = True
        halves[number, 1, order[blocks // 2 :]] = True
    return halves


def chosen_by(halves: np.ndarray, objective: np.ndarray) -> np.ndarray:
    """The candidate that each half holds for the best, (...), from each candidate's block sums (k, blocks).

    `halves` are (..., blocks); vehicles, which are the same for all candidates, make no difference.
    """
    return np.argmax(halves.astype(float) @ objective.T, axis=-1)


# --- what is chosen on other traffic of this kind, and what it loses on held-out frames -------------------------------


DRAWS = 300  # resamples of the searched blocks, under each of which a mounting is chosen


class Regret(NamedTuple):
    """What is lost, as a share of the gain, its 90 % interval, None for too few blocks, and how many blocks judge."""

    share: float
    interval_90: tuple[float, float] | None
    blocks: int

    def bound(self, level: float) -> float | None:
        """The loss is no greater with so much confidence; None for too few blocks."""
        if self.interval_90 is None:
            return None
        reach = (self.interval_90[1] - self.share) / student_t(0.95, self.blocks - 1)
        return self.share + reach * student_t(level, self.blocks - 1)


def searched_weights(block: np.ndarray, seed: int) -> np.ndarray:
    """How often each frame counts under each resample of the searched blocks, (r, f); as they are with too few."""
    labels, row = np.unique(block, return_inverse=True)
    if len(labels) < FEWEST_BLOCKS:
        return np.ones((1, len(block)))
    return resampled_weights(len(labels), np.random.default_rng(seed), DRAWS)[:, row]


def chosen_shares(landscape: Landscape, weights: np.ndarray, frames: np.ndarray | None = None) -> np.ndarray:
    """How often each candidate is the best, (k,), adding up to 1; `frames` are the rows that are looked at, or all.

    Resamples that leave no vehicle on those frames choose nothing and do not count.
    """
    frames = np.arange(len(landscape.vehicles)) if frames is None else frames
    weights = weights[:, frames]
    weights = weights[weights @ landscape.vehicles[frames] > 0.0]
    if not len(weights):
        weights = np.ones((1, len(frames)))
    best = np.argmax(landscape.objective[FIRST:, frames] @ weights.T, axis=0)  # vehicles are the same for all
    return np.bincount(best, minlength=len(landscape.objective) - FIRST) / len(best)


def regret(chosen: np.ndarray, by_reference: np.ndarray, judged: Landscape, block: np.ndarray) -> Regret | None:
    """What choices lose to those of the reference: [F(its) - F(theirs)] / [F(its) - F(baseline)] on frames that judge.

    Parameters
    ----------
    chosen, by_reference : ndarray, (k,)
        From `chosen_shares`; F of them is the mean over what they choose.
    judged : Landscape
        The reference on frames that chose nothing: the baseline and the k candidates.
    block : ndarray of int, (f,)
        Block of each of those frames; intervals are over its blocks.

    Returns
    -------
    Regret or None
        None where the reference's choices gain nothing there.
    """
    objective, vehicles = judged.blocks(block)
    lost = (by_reference - chosen) @ objective[FIRST:]
    gain = by_reference @ objective[FIRST:] - objective[BASELINE]
    if not gain.sum() > 0.0:
        return None
    share = float(lost.sum() / gain.sum())
    influence = ((lost - share * gain) / gain.sum())[vehicles > 0]
    return Regret(share, linear_interval_90(share, influence), len(influence))


# --- the reference, and how near a fidelity comes to it ---------------------------------------------------------------


_ROUNDING = 1e-12  # of the largest score: an error that is no greater is none


@dataclass(frozen=True, slots=True, eq=False)
class Reference:
    """What fidelities are compared with.

    Attributes
    ----------
    searched : Landscape
        Of the baseline and the candidates, on the frames that choose.
    judged : Landscape
        The same on those that judge.
    searched_block, judged_block : ndarray of int, (f,)
        Blocks of both.
    weights : ndarray, (r, f)
        From `searched_weights`.
    chosen : ndarray, (k,)
        How often each candidate is chosen.
    seed : int
    """

    searched: Landscape
    judged: Landscape
    searched_block: np.ndarray
    judged_block: np.ndarray
    weights: np.ndarray
    chosen: np.ndarray
    seed: int

    @classmethod
    def of(
        cls, searched: Landscape, searched_block: np.ndarray, judged: Landscape, judged_block: np.ndarray, seed: int
    ) -> Reference:
        """With its own choices."""
        weights = searched_weights(searched_block, seed)
        return cls(searched, judged, searched_block, judged_block, weights, chosen_shares(searched, weights), seed)

    def select(self, numbers: Sequence[int]) -> Reference:
        """Of some of the candidates."""
        rows = [BASELINE, *(FIRST + number for number in numbers)]
        searched, judged = self.searched.select(rows), self.judged.select(rows)
        return Reference.of(searched, self.searched_block, judged, self.judged_block, self.seed)

    def best(self, count: int) -> list[int]:
        """So many of the best candidates, in the order in which they come."""
        return sorted(np.argsort(-self.searched.per_vehicle()[FIRST:], kind="stable")[:count].tolist())

    @property
    def gain(self) -> float:
        """What the best candidate gains over the baseline on the frames that choose, per vehicle."""
        values = self.searched.per_vehicle()
        return float(values[FIRST:].max() - values[BASELINE])


class Accuracy(NamedTuple):
    """How near a fidelity comes to the reference, its phases averaged.

    Attributes
    ----------
    bias : float
        What it scores more, in the metric's unit per vehicle; mean over the candidates.
    error : float
        Root mean square of what is left after calibration, in the metric's unit per vehicle.
    tau : float
        `weighted_tau`.
    regret : Regret or None
    """

    bias: float
    error: float
    tau: float
    regret: Regret | None


def accuracy(reference: Reference, phases: Sequence[Landscape], frames: np.ndarray | None = None) -> Accuracy:
    """Of a fidelity whose phases come to `phases` on all frames and which looks at the rows `frames` of them."""
    frames = np.arange(len(reference.searched.vehicles)) if frames is None else frames
    truth = reference.searched.per_vehicle()[FIRST:]
    values = [
        phase.objective[FIRST:, frames].sum(axis=1) / max(int(phase.vehicles[frames].sum()), 1) for phase in phases
    ]
    chosen = np.mean([chosen_shares(phase, reference.weights, frames) for phase in phases], axis=0)
    error = root_mean_square(np.array([calibrated_residuals(each, truth) for each in values]))
    return Accuracy(
        bias=float(np.mean([each - truth for each in values])),
        error=0.0 if error <= _ROUNDING * float(np.abs(truth).max()) else error,
        tau=float(np.mean([weighted_tau(each, truth) for each in values])),
        regret=regret(chosen, reference.chosen, reference.judged, reference.judged_block),
    )


@dataclass(frozen=True, slots=True)
class Noise:
    """One half of the searched blocks against the other, over many random halvings.

    A difference of halves has twice the standard error of the whole: about what a 95 % interval of the reference
    reaches to either side.

    Attributes
    ----------
    bias, error, tau : float
        As of a fidelity, the one half in its place and the other in the reference's: medians, of the bias without sign.
    error_90 : (float, float)
        Where 90 % of the errors lie.
    apart : float or None
        Mean difference, without sign, between what the choices of both halves come to on the frames that judge, as a
        share of what a half's choice gains there; None where that is nothing.
    """

    bias: float
    error: float
    error_90: tuple[float, float]
    tau: float
    apart: float | None


def noise_ceiling(reference: Reference) -> Noise | None:
    """One half of the reference's blocks against the other; None for fewer than four blocks with vehicles."""
    objective, vehicles = reference.searched.blocks(reference.searched_block)
    objective, vehicles = objective[FIRST:, vehicles > 0], vehicles[vehicles > 0]
    if len(vehicles) < FEWEST_HALVED:
        return None
    halves = halvings(len(vehicles), reference.seed)
    rows = []
    for pair in halves:
        one, other = (objective[:, half].sum(axis=1) / vehicles[half].sum() for half in pair)
        error = root_mean_square(calibrated_residuals(one, other))
        rows.append((abs(float(np.mean(one - other))), error, weighted_tau(one, other)))
    bias, error, tau = np.array(rows).T
    tau = np.nan_to_num(tau)  # where a half prefers no mounting, nothing is ranked alike
    low, high = np.quantile(error, [0.05, 0.95]).tolist()
    middle = [float(np.median(column)) for column in (bias, error, tau)]
    worth = reference.judged.objective.sum(axis=1)
    of_chosen = worth[FIRST + chosen_by(halves, objective)]
    gain = float(of_chosen.mean() - worth[BASELINE])
    apart = float(np.abs(of_chosen[:, 0] - of_chosen[:, 1]).mean() / gain) if gain > 0.0 else None
    return Noise(middle[0], middle[1], (low, high), middle[2], apart)


# --- effects of a thing that is modelled: score, ranking and choice without it and with it ----------------------------


SCORE, ERROR, RANKING, OPTIMUM, BIAS, COST = "score", "error", "ranking", "optimum", "bias", "cost"
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
