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
from functools import cached_property
from typing import NamedTuple

import numpy as np

from ..errors import InputError
from ..optimise.search import generator
from ..scene.scenario import Scenario
from ..sensors.pose import Pose
from ..statistics import FEWEST_BLOCKS, interval_90, linear_interval_90, resampled_weights, student_t
from ..world.shapes import DETAILS
from .driver import Landscape

SOBOL_BITS = 30
BASELINE_ROW, FIRST = 0, 1  # rows of a landscape: the baseline, and where the candidates begin


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
        poses = (self.poses[BASELINE_ROW], *(self.poses[FIRST + number] for number in numbers))
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


# --- one score beside another: ranking, calibration, Pareto front -----------------------------------------------------


def weighted_tau(values: np.ndarray, reference: np.ndarray) -> float:
    """Kendall's tau-b of two scores (k,), each pair weighted by the reference's ranks (Vigna 2015).

    The weight of a pair is ``1 / (1 + r) + 1 / (1 + s)`` with the ranks r and s, 0 for the best: additive and
    hyperbolic. Of mountings that the reference holds for equal, those that `values` holds for better rank first.

    Returns
    -------
    float
        From -1 to 1; NaN where one of the two prefers no mounting to another.
    """
    from scipy.stats import weightedtau

    rank = np.empty(len(reference), dtype=int)
    rank[np.lexsort((values, reference))[::-1]] = np.arange(len(reference))
    return float(weightedtau(values, reference, rank=rank).statistic)


def calibrated_residuals(values: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """Residuals of a cross-fitted linear regression: reference less ``a + b values``, (k,).

    For each half of the mountings a and b are fitted by least squares on the other half; where `values` prefers no
    mounting to another, b is 0.
    """
    half = len(values) // 2
    first, second = slice(0, half), slice(half, None)
    residuals = np.empty(len(values))
    for judged, fitted in ((first, second), (second, first)):
        middle, away = values[fitted].mean(), values[fitted] - values[fitted].mean()
        slope = away @ reference[fitted] / max(away @ away, np.finfo(float).tiny)
        residuals[judged] = reference[judged] - reference[fitted].mean() - slope * (values[judged] - middle)
    return residuals


def agreement(values: np.ndarray, reference: np.ndarray) -> tuple[float, float, float]:
    """Mean bias of `values` (k,), root mean square error after calibration, and weighted Kendall's tau."""
    error = np.sqrt(np.mean(np.square(calibrated_residuals(values, reference))))
    return float(np.mean(values - reference)), float(error), weighted_tau(values, reference)


def pareto_front(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Rows that no other row is as good as in both costs and better than in one, (f,), by rising first cost.

    Equal rows are all kept.
    """
    no_worse = (first[:, None] <= first) & (second[:, None] <= second)
    better = (first[:, None] < first) | (second[:, None] < second)
    order = np.lexsort((second, first))
    return order[~(no_worse & better).any(axis=0)[order]]


# --- what is chosen on other traffic of this kind, and what it loses on held-out frames -------------------------------


SURE = 0.95  # of all tests together: see `ladder.mark_within`
BOUND_LEVEL = 1.0 - (1.0 - SURE) / len(DETAILS)  # of each test's bound, one-sided
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


def chosen_shares(landscape: Landscape, weights: np.ndarray, frames: np.ndarray | slice = slice(None)) -> np.ndarray:
    """How often each candidate is the best, (k,), adding up to 1; `frames` are the rows that are looked at, or all.

    Resamples that leave no vehicle on those frames choose nothing and do not count.
    """
    weights = weights[:, frames]
    weights = weights[weights @ landscape.weight[frames] > 0.0]
    if not len(weights):
        weights = np.ones((1, weights.shape[1]))
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
    gain = by_reference @ objective[FIRST:] - objective[BASELINE_ROW]
    if not gain.sum() > 0.0:
        return None
    share = float(lost.sum() / gain.sum())
    influence = ((lost - share * gain) / gain.sum())[vehicles > 0]
    return Regret(share, linear_interval_90(share, influence), len(influence))


# --- the reference, the noise ceiling, and how near a fidelity comes to the reference ---------------------------------


SPLITS = 200
FEWEST_HALVED = 4  # blocks: two in each half
_ROUNDING = 1e-12  # of the largest score: an error that is no greater is none


def halvings(blocks: int, seed: int) -> np.ndarray:
    """Which blocks are in the one half and which in the other, `SPLITS` times at random, (s, 2, blocks) bool."""
    rng = np.random.default_rng(seed)
    place = np.argsort([rng.permutation(blocks) for _ in range(SPLITS)], axis=1)
    return np.stack([place < blocks // 2, place >= blocks // 2], axis=1)


def chosen_by(halves: np.ndarray, objective: np.ndarray) -> np.ndarray:
    """The candidate that each half holds for the best, (...), from each candidate's block sums (k, blocks).

    `halves` are (..., blocks); vehicles, which are the same for all candidates, make no difference.
    """
    return np.argmax(halves.astype(float) @ objective.T, axis=-1)


@dataclass(frozen=True, eq=False)
class Reference:
    """What fidelities are compared with.

    Attributes
    ----------
    searched : Landscape
        Of the baseline and the candidates, on the frames that choose.
    searched_block : ndarray of int, (f,)
        Their blocks.
    judged, judged_block
        The same on the frames that judge.
    seed : int
        Of resamples and halves.
    """

    searched: Landscape
    searched_block: np.ndarray
    judged: Landscape
    judged_block: np.ndarray
    seed: int

    @cached_property
    def weights(self) -> np.ndarray:
        """`searched_weights`, (r, f)."""
        return searched_weights(self.searched_block, self.seed)

    @cached_property
    def chosen(self) -> np.ndarray:
        """How often each candidate is chosen, (k,)."""
        return chosen_shares(self.searched, self.weights)

    @cached_property
    def halves(self) -> np.ndarray:
        """Halves of the filled blocks that choose, (s, 2, b) bool; with too few blocks all of them choose."""
        blocks = int((self.searched.blocks(self.searched_block)[1] > 0).sum())
        return halvings(blocks, self.seed) if blocks >= FEWEST_HALVED else np.ones((1, 2, blocks), dtype=bool)

    @cached_property
    def noise(self) -> Noise | None:
        """The noise ceiling; None for fewer than four blocks with vehicles."""
        return noise_ceiling(self)

    def select(self, numbers: Sequence[int]) -> Reference:
        """Of some of the candidates."""
        rows = [BASELINE_ROW, *(FIRST + number for number in numbers)]
        searched, judged = self.searched.select(rows), self.judged.select(rows)
        return Reference(searched, self.searched_block, judged, self.judged_block, self.seed)

    def best(self, count: int) -> list[int]:
        """So many of the best candidates, in the order in which they come."""
        return sorted(np.argsort(-self.searched.per_vehicle()[FIRST:], kind="stable")[:count].tolist())

    @property
    def gain(self) -> float:
        """What the best candidate gains over the baseline on the frames that choose, per vehicle."""
        values = self.searched.per_vehicle()
        return float(values[FIRST:].max() - values[BASELINE_ROW])


def accuracy(
    reference: Reference, phases: Sequence[Landscape], frames: np.ndarray | slice = slice(None)
) -> dict[str, object]:
    """How near a fidelity comes whose phases score `phases` on all frames, and which looks at the rows `frames`.

    Returns
    -------
    dict
        As JSON holds it. ``bias``: what it scores more, in the metric's unit per vehicle, mean over the candidates and
        phases. ``error``: root mean square of what is left after calibration, in the same unit, and ``error_share`` of
        the gain. ``tau``: `weighted_tau`. ``regret`` with ``regret_interval_90`` and the upper ``regret_bound`` at
        `BOUND_LEVEL`. None for what cannot be known.
    """
    truth, gain = reference.searched.per_vehicle()[FIRST:], reference.gain
    values = [phase.objective[FIRST:, frames].sum(axis=1) / (phase.weight[frames].sum() or 1) for phase in phases]
    bias, errors, tau = np.array([agreement(each, truth) for each in values]).T
    error = float(np.sqrt(np.mean(errors**2)))
    error = 0.0 if error <= _ROUNDING * float(np.abs(truth).max()) else error
    chosen = np.mean([chosen_shares(phase, reference.weights, frames) for phase in phases], axis=0)
    lost = regret(chosen, reference.chosen, reference.judged, reference.judged_block)
    return {
        "bias": float(bias.mean()),
        "error": error,
        "error_share": error / gain if gain > 0.0 else None,
        "tau": None if np.isnan(tau).any() else float(tau.mean()),
        "regret": lost and lost.share,
        "regret_interval_90": lost and lost.interval_90,
        "regret_bound": lost and lost.bound(BOUND_LEVEL),
    }


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
    halves = reference.halves
    scored = [[objective[:, half].sum(axis=1) / vehicles[half].sum() for half in pair] for pair in halves]
    bias, error, tau = np.array([agreement(*both) for both in scored]).T
    tau = np.nan_to_num(tau)  # where a half prefers no mounting, nothing is ranked alike
    worth = reference.judged.objective.sum(axis=1)
    chosen = worth[FIRST + chosen_by(halves, objective)]
    gain = chosen.mean() - worth[BASELINE_ROW]
    apart = float(np.abs(chosen[:, 0] - chosen[:, 1]).mean() / gain) if gain > 0.0 else None
    bias, middle, tau = (float(np.median(column)) for column in (np.abs(bias), error, tau))
    return Noise(bias, middle, interval_90(error), tau, apart)


# --- effects of a thing that is modelled: score, ranking and choice without it and with it ----------------------------

_UNSIGNED = ("score", "error", "apart")


class Effect(NamedTuple):
    """A number, and its 90 % interval; None for too few blocks."""

    value: float
    interval_90: tuple[float, float] | None


@dataclass(frozen=True, slots=True, eq=False)
class AblationDraw:
    """One random draw of a thing, or the thing itself where nothing is drawn; k candidates.

    Attributes
    ----------
    without, having : ndarray, (k, b)
        Objective of each candidate in each block that chooses.
    vehicles : ndarray, (b,)
        In those blocks, or the sum of their weights; none is empty.
    judged : ndarray, (1 + k, j)
        Objective with the thing of the baseline and the candidates in each block that judges; candidates that neither
        side chooses may be NaN.
    """

    without: np.ndarray
    having: np.ndarray
    vehicles: np.ndarray
    judged: np.ndarray


def choices(draw: AblationDraw, halves: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """What each half would choose without the thing and with it, (1 + b, s, 2) each: first of all blocks, then with one
    block left out after another."""
    blocks = halves.shape[-1]
    kept = np.concatenate([np.ones((1, blocks), dtype=bool), ~np.eye(blocks, dtype=bool)])
    there = halves[None] & kept[:, None, None, :]
    return chosen_by(there, draw.without), chosen_by(there, draw.having)


def effects(draws: Sequence[AblationDraw], halves: np.ndarray) -> dict[str, Effect | None]:
    """All effects of a thing, means over its draws, with jackknife intervals; None for those that cannot be known.

    Returns
    -------
    dict
        ``bias``: mean difference over the candidates, per vehicle, positive where the thing scores more, and ``score``
        without its sign. ``error``: what calibration leaves of it. ``tau``: `weighted_tau` of both. ``regret``: mean
        difference between what both choose from the same half of the blocks, on the blocks that judge, as a share of
        the gain there, positive where something is lost without the thing, and ``apart`` without its sign.
    """
    searched = np.array([_left_out_of_searched(draw) for draw in draws])  # (d, 1 + b, 4)
    judged = [np.array(part) for part in zip(*(_left_out_of_judged(draw, halves) for draw in draws), strict=True)]
    gained = all(np.isfinite(part).all() for part in judged)
    found = {
        name: _effect(name, searched[..., column]) for column, name in enumerate(("bias", "score", "error", "tau"))
    }
    for column, name in enumerate(("apart", "regret")):
        found[name] = _effect(name, *(part[..., column] for part in judged)) if gained else None
    return found


def _left_out_of_searched(draw: AblationDraw) -> np.ndarray:
    """Bias, score, error and tau, of all blocks and without each of them, (1 + b, 4)."""
    blocks = len(draw.vehicles)
    kept = np.concatenate([np.ones((1, blocks)), 1.0 - np.eye(blocks)])
    vehicles = kept @ draw.vehicles
    vehicles[vehicles == 0.0] = 1.0  # none is left where the only block is left out
    rows = []
    for without, having in zip(*((kept @ of.T) / vehicles[:, None] for of in (draw.without, draw.having)), strict=True):
        bias, error, tau = agreement(without, having)
        rows.append((-bias, abs(bias), error, tau))
    return np.array(rows)


def _left_out_of_judged(draw: AblationDraw, halves: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Apart and regret: without each block that chooses, (1 + b, 2), and without each that judges, (1 + j, 2)."""
    without, having = choices(draw, halves)
    whole = draw.judged.sum(axis=1)
    of_choosing = np.array([_apart(*both, whole) for both in zip(without, having, strict=True)])
    left_out = [whole, *(whole - one for one in draw.judged.T)]
    return of_choosing, np.array([_apart(without[0], having[0], worth) for worth in left_out])


def _apart(without: np.ndarray, having: np.ndarray, worth: np.ndarray) -> tuple[float, float]:
    """How far choices are apart and what is lost, as shares of the gain; NaN where nothing is gained."""
    lost = worth[FIRST + having] - worth[FIRST + without]
    gain = worth[FIRST + having].mean() - worth[BASELINE_ROW]
    return (np.abs(lost).mean() / gain, lost.mean() / gain) if gain > 0.0 else (np.nan, np.nan)


def _effect(name: str, *left_out: np.ndarray) -> Effect | None:
    """The mean over draws of what everything gives, from values (d, 1 + b) of everything and without each block.

    There is an array for each sort of blocks, and the interval has their jackknife variances and the draws' in it.
    """
    least, most = (0.0 if name in _UNSIGNED else -np.inf), (1.0 if name == "tau" else np.inf)
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
