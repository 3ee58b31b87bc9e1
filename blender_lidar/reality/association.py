"""How far two quantities go together, in many resamples at once.

A resample is a row of weights: how often each of n observations is drawn in it, 0 or more. What is computed under such
weights equals what would be computed of the observations written out as often as drawn, ranks included.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

_ROUNDING = 1e-12  # a variance so far below the mean square is none


def pearson(x: np.ndarray, y: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Pearson's r of x and y, (n,) each, in each resample, (r,); NaN where one of them is constant."""
    x, y = x - x.mean(), y - y.mean()
    total = weights.sum(axis=1)
    sx, sy, sxx, syy, sxy = (weights @ column / total for column in (x, y, x * x, y * y, x * y))
    return _ratio(sxy - sx * sy, _positive(sxx - sx * sx, sxx) * _positive(syy - sy * sy, syy))


def centred_ranks(values: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Ranks of the observations that each resample draws, less their mean, (r, n).

    Ties, and copies of one observation, share their mean rank. An observation that is not drawn gets the rank between
    its neighbours, which counts nowhere.

    Parameters
    ----------
    values : ndarray, (n,)
    weights : ndarray, (r, n)
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
    """What least squares on the controls and a constant leave of `x` in each resample, (r, n).

    Parameters
    ----------
    x : ndarray, (r, n)
        Of mean 0 in each resample, as `centred_ranks` makes it.
    controls : sequence of ndarray, (r, n)
        Orthogonal to each other, as `orthogonal` makes them; one that is 0 throughout a resample explains nothing.
    weights : ndarray, (r, n)
    """
    left = x
    for control in controls:
        weighted = weights * control
        slope = _over(_dot(weighted, left), _dot(weighted, control))
        left = left - slope[:, None] * control
    kept = _positive(_dot(weights * left, left), _dot(weights * x, x))
    return left * (kept > 0.0)[:, None]


def orthogonal(controls: Sequence[np.ndarray], weights: np.ndarray) -> list[np.ndarray]:
    """Controls, (r, n) each and of mean 0, made orthogonal to those before them in each resample."""
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
    x, y = (_off_mean(np.where(there, values, 0.0), there, number) for values in (x, y))
    r = _ratio(_dot(x, y), _dot(x, x) * _dot(y, y))
    return np.where(number[:, 0] >= 3, r, np.nan)


def _off_mean(values: np.ndarray, there: np.ndarray, number: np.ndarray) -> np.ndarray:
    off = np.where(there, values - values.sum(axis=1, keepdims=True) / np.maximum(number, 1), 0.0)
    spread = _positive(_dot(off, off), _dot(values, values))
    return off * (spread > 0.0)[:, None]


def _positive(variance: np.ndarray, scale: np.ndarray) -> np.ndarray:
    """A variance, or 0 where it is no more than rounding of numbers of that mean square."""
    return np.where(variance > _ROUNDING * scale, variance, 0.0)


def _dot(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return np.einsum("rn,rn->r", x, y)


def _over(part: np.ndarray, whole: np.ndarray, empty: float = 0.0) -> np.ndarray:
    return np.divide(part, whole, out=np.full(np.shape(whole), empty), where=whole > 0.0)


def _ratio(product: np.ndarray, squares: np.ndarray) -> np.ndarray:
    return np.clip(_over(product, np.sqrt(squares), empty=np.nan), -1.0, 1.0)
