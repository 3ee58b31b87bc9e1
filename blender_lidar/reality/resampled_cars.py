"""The cars of one set and one detector under many resamples, and what is asked of each metric in turn."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from ..study.statistics import RESAMPLES, resampled_weights
from .association import centred_ranks, correlation, correlation_of_means, group_means, orthogonal, pearson, residual
from .car_sets import Clusters
from .cross_validation import folds_of, share_foretold
from .isotonic import isotonic_fit, predict

BANDS_M = (5.0, 10.0)
DECILES = 10
_CELLS = 1 << 18  # of resamples by cars that are worked on at a time: their tables stay in the processor's cache
FEWEST_IN_BAND = 5  # cars: fewer make no mean


class Draws(NamedTuple):
    """How cars are resampled.

    Attributes
    ----------
    block_frames : int
        So many frames are drawn as one, where whole drives are not.
    seed : int
        Of the draws and the folds.
    resamples : int
    """

    block_frames: int = 1
    seed: int = 1
    resamples: int = RESAMPLES


class Resampling:
    """Draws of clusters, the same for whatever is asked: the first row is the cars themselves.

    Parameters
    ----------
    clusters : Clusters
        What is drawn as one, and never divided between the folds of a cross-validation.
    seed : int
    resamples : int
    """

    def __init__(self, clusters: Clusters, seed: int, resamples: int = RESAMPLES) -> None:
        rng = np.random.default_rng(seed)
        drawn = resampled_weights(clusters.number, rng, resamples)[:, clusters.of_car]
        self.weights = np.vstack([np.ones((1, drawn.shape[1])), drawn])
        self.fold = folds_of(clusters.of_car, rng)
        self.clusters = clusters

    def in_parts(self) -> Iterator[np.ndarray]:
        """The weights, some resamples at a time."""
        rows = max(_CELLS // self.weights.shape[1], 1)
        for first in range(0, len(self.weights), rows):
            yield self.weights[first : first + rows]


class Grouped(NamedTuple):
    """Correlation over groups of cars of mean metric and mean performance: Pearson's, (r,), Spearman's of the first."""

    groups: int
    pearson: np.ndarray
    spearman: float


class Followed(NamedTuple):
    """How a metric goes with the performance; arrays are (r,), one for each resample.

    Attributes
    ----------
    spearman, pearson : ndarray
        Over cars; ranks are made anew in each resample.
    partial_spearman : ndarray
        The rank correlation with distance and occlusion held fixed: Pearson's r of what is left of both when least
        squares on the ranks of distance, the ranks of occlusion and a constant are taken from their ranks. NaN where
        nothing is left. Occlusion without spread holds nothing fixed.
    groups : dict of str to Grouped
        Over bands of distance with enough cars, ``bins_5m`` and ``bins_10m``, and over tenths of the cars from those
        with the lowest metric to those with the highest, ``deciles``.
    """

    spearman: np.ndarray
    partial_spearman: np.ndarray
    pearson: np.ndarray
    groups: dict[str, Grouped]

    @classmethod
    def joined(cls, parts: Sequence[Followed]) -> Followed:
        """Of resamples that were worked on in parts, the first of which begins with the cars themselves."""
        first = parts[0]
        groups = {
            name: grouped._replace(pearson=np.concatenate([part.groups[name].pearson for part in parts]))
            for name, grouped in first.groups.items()
        }
        arrays = (np.concatenate([part[number] for part in parts]) for number in range(3))
        return cls(*arrays, groups)


class ResampledCars:
    """n cars with what a detector made of them, under some resamples.

    Parameters
    ----------
    performance : ndarray, (n,)
        0 where the car was missed.
    distance_m, occlusion : ndarray, (n,)
        What partial correlations hold fixed.
    weights : ndarray, (r, n)
        How often each resample draws each car.
    """

    def __init__(
        self, performance: np.ndarray, distance_m: np.ndarray, occlusion: np.ndarray, weights: np.ndarray
    ) -> None:
        self._weights, self._performance = weights, performance
        self._ranks = centred_ranks(performance, self._weights)
        held = [centred_ranks(values, self._weights) for values in (distance_m, occlusion)]
        self._controls = orthogonal(held, self._weights)
        self._left = residual(self._ranks, self._controls, self._weights)
        self._bands = {f"bins_{width:.0f}m": np.floor(distance_m / width).astype(np.int64) for width in BANDS_M}

    def followed_by(self, merit: np.ndarray) -> Followed:
        """How a metric, (n,), high where it is good, goes with the performance."""
        ranks = centred_ranks(merit, self._weights)
        return Followed(
            spearman=correlation(ranks, self._ranks, self._weights),
            partial_spearman=correlation(residual(ranks, self._controls, self._weights), self._left, self._weights),
            pearson=pearson(merit, self._performance, self._weights),
            groups={
                **{name: self._by_band(merit, band) for name, band in self._bands.items()},
                "deciles": self._by_decile(merit, ranks),
            },
        )

    def _by_band(self, merit: np.ndarray, band: np.ndarray) -> Grouped:
        count = np.bincount(band)
        used = count >= FEWEST_IN_BAND
        return _grouped(
            *(group_means(values, band, len(count), self._weights)[:, used] for values in (merit, self._performance))
        )

    def _by_decile(self, merit: np.ndarray, ranks: np.ndarray) -> Grouped:
        share = ranks / self._weights.sum(axis=1, keepdims=True) + 0.5  # of the cars below each
        decile = np.clip((DECILES * share).astype(np.int64), 0, DECILES - 1)
        return _grouped(*(group_means(values, decile, DECILES, self._weights) for values in (merit, self._performance)))


def _grouped(metric: np.ndarray, performance: np.ndarray) -> Grouped:
    there = np.isfinite(metric[0])
    one = np.ones((1, int(there.sum())))
    ranks = [centred_ranks(values[0, there], one) if one.size else one for values in (metric, performance)]
    spearman = float(correlation(*ranks, one)[0]) if one.size >= 3 else np.nan
    return Grouped(one.size, correlation_of_means(metric, performance), spearman)


def isotonic_r2(merit: np.ndarray, performance: np.ndarray, resampling: Resampling) -> np.ndarray:
    """Share of the performance's variance that a rising curve of a metric foretells in frames not fitted to, (1 + r,).

    `merit` and `performance` are (n,).
    """

    def foretell(fitted: np.ndarray, told: np.ndarray) -> np.ndarray:
        return predict(isotonic_fit(merit[fitted], performance[fitted]), merit[told])

    return share_foretold(performance, resampling.fold, foretell, resampling.weights)
