"""Cluster bootstrap of labelled cars: correlations, isotonic regression, cross-validation, intervals and p-values.

A resample is a row of weights: how often each of n cars is drawn in it, 0 or more. What is computed under such weights
equals what would be computed of the cars written out as often as drawn, ranks included. The cars of one frame share
light, weather and road, and those of a drive are partly the same, so whole drives are drawn where they are told, else
frames. The first row of weights is the cars themselves, each once.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from ...statistics import FEWEST_BLOCKS, RESAMPLES, interval_90, resampled_weights, student_t_95

FOLDS = 10
BAND_WIDTHS_M = {"bins_5m": 5.0, "bins_10m": 10.0}
FEWEST_IN_BAND = 5  # cars: fewer make no mean
_CELLS = 1 << 18  # of resamples by cars that are worked on at a time: their tables stay in the processor's cache
_ROUNDING = 1e-12  # a variance so far below the mean square is none
_NEARLY_ONE = 1.0 - 1e-12

# --- What is drawn ----------------------------------------------------------------------------------------------------


class Clusters(NamedTuple):
    """What is resampled as one.

    Attributes
    ----------
    unit : str
        For people: ``"drive"``, ``"frame"``, ``"5 frames"``.
    of_car : ndarray of int64, (n,)
        Cluster of each car, numbered from 0 without gaps.
    too_narrow : bool
        Whether clusters are known, or must be feared, to depend on each other, so that intervals come out too narrow.
    """

    unit: str
    of_car: np.ndarray
    too_narrow: bool

    @property
    def number(self) -> int:
        return int(self.of_car.max()) + 1


def clusters(cars: Mapping[str, np.ndarray], block_frames: int = 1) -> Clusters:
    """What is resampled as one in a set of cars: a drive where it is told and there are enough, else a frame.

    Parameters
    ----------
    cars : mapping of str to ndarray of str, (n,)
        Their ``frame``, and perhaps ``drive`` and ``label_kind``.
    block_frames : int
        So many frames of one drive, or of one kind of labels, in the order of their names, count as one where drives
        are not resampled.
    """
    if "drive" in cars and len(np.unique(cars["drive"])) >= FEWEST_BLOCKS:
        return Clusters("drive", _numbered(cars["drive"]), False)
    # Frames of one drive, or of sequences, show the same cars again.
    within, dependent = np.full(len(cars["frame"]), ""), "drive" in cars
    if "drive" in cars:
        within = cars["drive"]
    elif "label_kind" in cars:
        within = kinds(cars["label_kind"])
        dependent = "tracking" in within
    block = np.empty(len(within), dtype=np.int64)
    for name in np.unique(within):
        mine = within == name
        block[mine] = _numbered(cars["frame"][mine]) // block_frames
    label = np.char.add(np.char.add(within, " "), block.astype(str))
    return Clusters("frame" if block_frames == 1 else f"{block_frames} frames", _numbered(label), dependent)


def kinds(label_kind: np.ndarray) -> np.ndarray:
    """The word that tells kinds of labels apart, the first but KITTI: ``object label_2 (...)`` is ``object``."""
    words = [text.split() for text in label_kind.tolist()]
    return np.array([next((word for word in line if word != "KITTI"), "") for line in words], dtype=str)


def _numbered(labels: np.ndarray) -> np.ndarray:
    return np.unique(labels, return_inverse=True)[1].reshape(-1).astype(np.int64)


class Resampling(NamedTuple):
    """Draws of clusters, the same for whatever is asked.

    Attributes
    ----------
    clusters : Clusters
    weights : ndarray, (1 + r, n)
        How often each car is drawn; in the first row each once.
    fold : ndarray of int64, (n,)
        Fold of each car in a cross-validation, from 0 on: whole clusters, dealt out at random in even numbers. There
        are as many folds as clusters where these are fewer than `FOLDS`.
    """

    clusters: Clusters
    weights: np.ndarray
    fold: np.ndarray


def cluster_bootstrap(drawn: Clusters, seed: int, resamples: int = RESAMPLES) -> Resampling:
    """Draw whole clusters with replacement, and deal them out to folds."""
    rng = np.random.default_rng(seed)
    weights = resampled_weights(drawn.number, rng, resamples)[:, drawn.of_car]
    dealt = np.argsort(rng.permutation(drawn.number)) % FOLDS
    return Resampling(drawn, np.vstack([np.ones((1, weights.shape[1])), weights]), dealt[drawn.of_car])


# --- Bootstrap correlations -------------------------------------------------------------------------------------------


def bootstrap_correlations(
    merits: Mapping[str, np.ndarray],
    performance: np.ndarray,
    held_fixed: Sequence[np.ndarray],
    distance_m: np.ndarray,
    weights: np.ndarray,
) -> dict[str, dict[str, np.ndarray]]:
    """Correlations of metrics with a detector's performance in every resample.

    Parameters
    ----------
    merits : mapping of str to ndarray, (n,)
        By the metric's name, high where it is good.
    performance : ndarray, (n,)
        0 where the car was missed.
    held_fixed : sequence of ndarray, (n,)
        What partial correlations hold fixed; one without spread holds nothing fixed.
    distance_m : ndarray, (n,)
        Makes the bands.
    weights : ndarray, (r, n)

    Returns
    -------
    dict of str to dict of str to ndarray
        By metric: ``spearman``, ``pearson`` and ``partial_spearman``, (r,), ranks made anew in each resample, the last
        being Pearson's r of the residuals of least squares of the ranks on those held fixed (NaN without residuals);
        and ``bins_5m``, ``bins_10m`` (bands of distance with enough cars) and ``deciles`` (tenths of the cars, from the
        lowest metric to the highest): means of metric and performance, (r, 2, g).
    """
    bands = {name: np.floor(distance_m / width).astype(np.int64) for name, width in BAND_WIDTHS_M.items()}
    used = {name: np.flatnonzero(np.bincount(band) >= FEWEST_IN_BAND) for name, band in bands.items()}
    found: dict[str, dict[str, list]] = {name: {} for name in merits}
    rows = max(_CELLS // weights.shape[1], 1)
    for part in (weights[first : first + rows] for first in range(0, len(weights), rows)):
        target = centred_ranks(performance, part)
        controls = orthogonal([centred_ranks(values, part) for values in held_fixed], part)
        left = residual(target, controls, part)
        total = part.sum(axis=1, keepdims=True)
        for name, merit in merits.items():
            ranks = centred_ranks(merit, part)
            decile = np.clip((10 * (ranks / total + 0.5)).astype(np.int64), 0, 9)
            both = (merit, performance)
            values = {
                "spearman": correlation(ranks, target, part),
                "partial_spearman": correlation(residual(ranks, controls, part), left, part),
                "pearson": pearson(merit, performance, part),
                **{
                    by: np.stack([group_means(of, band, band.max() + 1, part)[:, used[by]] for of in both], axis=1)
                    for by, band in bands.items()
                },
                "deciles": np.stack([group_means(of, decile, 10, part) for of in both], axis=1),
            }
            for key, value in values.items():
                found[name].setdefault(key, []).append(value)
    return {name: {key: np.concatenate(parts) for key, parts in of.items()} for name, of in found.items()}


def pearson(x: np.ndarray, y: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Pearson's r of x and y, (n,) each, in each resample, (r,); NaN where one of them is constant."""
    x, y = x - x.mean(), y - y.mean()
    total = weights.sum(axis=1)
    sx, sy, sxx, syy, sxy = (weights @ column / total for column in (x, y, x * x, y * y, x * y))
    return _ratio(sxy - sx * sy, _positive(sxx - sx * sx, sxx) * _positive(syy - sy * sy, syy))


def centred_ranks(values: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Ranks of the observations (n,) in each resample, less their mean, (r, n).

    Ties, and copies of one observation, share their mean rank. An observation that is not drawn gets the rank between
    its neighbours, which counts nowhere.
    """
    order = np.argsort(values, kind="stable")
    first = np.concatenate([[True], np.diff(values[order]) > 0])  # of its ties
    tied = np.add.reduceat(np.take(weights, order, axis=1), np.flatnonzero(first), axis=1)
    up_to = np.cumsum(tied, axis=1)
    rank = up_to - 0.5 * (tied + up_to[:, -1:])
    place = np.empty(len(values), dtype=np.int64)
    place[order] = np.cumsum(first) - 1
    return np.take(rank, place, axis=1)


def residual(x: np.ndarray, controls: Sequence[np.ndarray], weights: np.ndarray) -> np.ndarray:
    """Residuals of weighted least squares of `x` on the controls and a constant in each resample, (r, n).

    `x` and the controls are (r, n), of mean 0 in each resample, the controls as `orthogonal` makes them; one that is 0
    throughout a resample explains nothing.
    """
    left = x
    for control in controls:
        weighted = weights * control
        slope = _over(_dot(weighted, left), _dot(weighted, control))
        left = left - slope[:, None] * control
    kept = _positive(_dot(weights * left, left), _dot(weights * x, x))
    return left * (kept > 0.0)[:, None]


def orthogonal(controls: Sequence[np.ndarray], weights: np.ndarray) -> list[np.ndarray]:
    """Gram-Schmidt: controls, (r, n) each and of mean 0, made orthogonal to those before them in each resample."""
    made: list[np.ndarray] = []
    for control in controls:
        made.append(residual(control, made, weights))
    return made


def correlation(x: np.ndarray, y: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Pearson's r in each resample, (r,), of values of mean 0 there, (r, n) each; NaN where one of them is constant."""
    weighted = weights * x
    return _ratio(_dot(weighted, y), _dot(weighted, x) * _dot(weights * y, y))


def group_means(values: np.ndarray, group: np.ndarray, groups: int, weights: np.ndarray) -> np.ndarray:
    """Mean of the values, (n,), in each of the groups that `group` numbers from 0, (r, groups); NaN in an empty one.

    `group` is (n,), the same in every resample, or (r, n).
    """
    if group.ndim == 1:
        member = np.equal.outer(group, np.arange(groups)).astype(float)
        return _over(weights @ (member * values[:, None]), weights @ member, empty=np.nan)
    rows = len(weights)
    cell = (group + groups * np.arange(rows)[:, None]).ravel()
    sums, counts = (
        np.bincount(cell, weights=of.ravel(), minlength=groups * rows).reshape(rows, groups)
        for of in (weights * values, weights)
    )
    return _over(sums, counts, empty=np.nan)


def correlation_of_means(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Pearson's r over the groups of each resample, (r,), of two means, (r, g) each; groups with a NaN are left out.

    NaN with fewer than three groups or without spread.
    """
    there = np.isfinite(x) & np.isfinite(y)
    number = there.sum(axis=1, keepdims=True)
    off = []
    for values in (np.where(there, x, 0.0), np.where(there, y, 0.0)):
        apart = np.where(there, values - values.sum(axis=1, keepdims=True) / np.maximum(number, 1), 0.0)
        off.append(apart * (_positive(_dot(apart, apart), _dot(values, values)) > 0.0)[:, None])
    return np.where(number[:, 0] >= 3, correlation(*off, there.astype(float)), np.nan)


def _positive(variance: np.ndarray, scale: np.ndarray) -> np.ndarray:
    """A variance, or 0 where it is no more than rounding of numbers of that mean square."""
    return np.where(variance > _ROUNDING * scale, variance, 0.0)


def _dot(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return np.einsum("rn,rn->r", x, y)


def _over(part: np.ndarray, whole: np.ndarray, empty: float = 0.0) -> np.ndarray:
    return np.divide(part, whole, out=np.full(np.shape(whole), empty), where=whole > 0.0)


def _ratio(product: np.ndarray, squares: np.ndarray) -> np.ndarray:
    return np.clip(_over(product, np.sqrt(squares), empty=np.nan), -1.0, 1.0)


# --- Cross-validated regressions --------------------------------------------------------------------------------------


def isotonic_fit(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Isotonic regression of y on x, (n,) each: rising knots of x and the values there, (k,) each.

    Observations of one x are averaged first; between knots the curve is straight, beyond them level.
    """
    from scipy.optimize import isotonic_regression

    knots, row = np.unique(x, return_inverse=True)
    weight = np.bincount(row).astype(float)
    return knots, isotonic_regression(np.bincount(row, weights=y) / weight, weights=weight).x


def isotonic(x: np.ndarray, y: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Isotonic regression of y on x, evaluated at other x."""
    return np.interp(at, *isotonic_fit(x, y))


def linear(x: np.ndarray, y: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Linear regression of y on x, evaluated at other x; level where x has no spread."""
    off = x - x.mean()
    spread = float(off @ off)
    slope = float(off @ y) / spread if spread > 0.0 else 0.0
    return y.mean() + slope * (at - x.mean())


def cross_validated_r2(
    x: np.ndarray, y: np.ndarray, regression: Callable[..., np.ndarray], fold: np.ndarray, weights: np.ndarray
) -> np.ndarray:
    """Out-of-fold coefficient of determination of a regression of y on x, (n,) each, in each resample, (r,).

    1 less the squared errors over those of the other folds' mean; below 0 where that mean predicts better. Curves are
    fitted once, to the observations themselves: resamples, `weights` (r, n), draw from their errors.

    Parameters
    ----------
    regression : callable
        `isotonic` or `linear`: takes x and y to fit to, and where to evaluate.
    fold : ndarray of int64, (n,)
    """
    error, of_mean = np.zeros((2, len(y)))
    for number in range(int(fold.max()) + 1):
        out = fold == number
        error[out] = y[out] - regression(x[~out], y[~out], x[out])
        of_mean[out] = y[out] - y[~out].mean()
    worst = weights @ of_mean**2
    return 1.0 - _over(weights @ error**2, worst, empty=np.nan)


# --- Intervals and p-values -------------------------------------------------------------------------------------------


class Estimate(NamedTuple):
    """A value and its 90 % interval; NaN where there is none.

    Attributes
    ----------
    value, low, high : float
    p_above : float or None
        Of a difference: how probable one as large or larger would be were there none; NaN where nothing can be told, or
        the two are the same in every resample.
    p_holm : float or None
        The same adjusted for the number of metrics that are held against one of them.
    """

    value: float
    low: float = math.nan
    high: float = math.nan
    p_above: float | None = None
    p_holm: float | None = None

    def text(self, digits: int = 2, sign: str = "") -> str:
        """For people: ``0.81 (0.74 to 0.87)``; with `sign` ``"+"`` all three bear one."""
        value, low, high = (f"{number:{sign}.{digits}f}" for number in self[:3])
        if not math.isfinite(self.low):
            return value if math.isfinite(self.value) else "-"
        return f"{value} ({low} to {high})"


def _resamples(values: np.ndarray, number: int) -> tuple[float, np.ndarray | None]:
    """Split (1 + r,) into the value and the finite ones of the resamples; None for too few of them or of clusters."""
    value, resampled = float(values[0]), values[1:][np.isfinite(values[1:])]
    enough = math.isfinite(value) and number >= FEWEST_BLOCKS and len(resampled) >= 2
    return value, resampled if enough else None


def of_correlation(values: np.ndarray, number: int) -> Estimate:
    """Of a correlation: first its value, then those of the resamples of so many clusters, (1 + r,).

    Student's t with number - 1 degrees of freedom times the resampled standard deviation of Fisher's z, turned back.
    """
    value, resampled = _resamples(values, number)
    if resampled is None:
        return Estimate(value)
    z, middle = (np.arctanh(np.clip(r, -_NEARLY_ONE, _NEARLY_ONE)) for r in (resampled, value))
    reach = student_t_95(number - 1) * np.std(z)
    return Estimate(value, math.tanh(middle - reach), math.tanh(middle + reach))


def of_resamples(values: np.ndarray, number: int) -> Estimate:
    """Percentile bootstrap: the value and the middle 90 % of those of the resamples of so many clusters, (1 + r,)."""
    value, resampled = _resamples(values, number)
    return Estimate(value) if resampled is None else Estimate(value, *interval_90(resampled))


def of_difference(first: np.ndarray, second: np.ndarray, number: int) -> Estimate:
    """Of the first less the second, both (1 + r,) in the same resamples: Student's t times the resampled deviation."""
    from scipy.special import stdtr

    value, resampled = _resamples(first - second, number)
    if resampled is None:
        return Estimate(value, p_above=math.nan)
    spread = float(np.std(resampled))
    if spread == 0.0:  # the same in every resample
        return Estimate(value, value, value, math.nan if value == 0.0 else float(value < 0.0))
    reach = student_t_95(number - 1) * spread
    return Estimate(value, value - reach, value + reach, float(stdtr(number - 1, -value / spread)))


def holm(p_values: Sequence[float]) -> list[float]:
    """Holm-Bonferroni: p-values adjusted for their number (Holm 1979), in the order given; NaN does not count."""
    p = np.asarray(p_values, dtype=float)
    order = np.argsort(p, kind="stable")[: int(np.isfinite(p).sum())]  # NaN comes last
    adjusted = np.full(len(p), np.nan)
    adjusted[order] = np.minimum(np.maximum.accumulate(p[order] * np.arange(len(order), 0, -1)), 1.0)
    return adjusted.tolist()
