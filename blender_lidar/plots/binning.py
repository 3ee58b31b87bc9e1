"""What the charts count: vehicles by distance band and by cell of the road, and the region of near-best mountings."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ..errors import InputError


@dataclass(frozen=True, slots=True)
class Bands:
    """Vehicles by distance band; band b holds the distances in ``[b, b + 1) * band_m``.

    Attributes
    ----------
    centre_m : ndarray, (b,)
        Middle of each band [m].
    count : ndarray, (b,) int
        Vehicles in it.
    detectable_share : ndarray, (b,)
        Share of them that are detectable, 0 to 1; NaN in an empty band.
    score : ndarray, (b,)
        Mean of their scores; vehicles without a finite one are left out, NaN if none has one.
    """

    centre_m: np.ndarray
    count: np.ndarray
    detectable_share: np.ndarray
    score: np.ndarray


def columns(
    table: Mapping[str, ArrayLike], names: tuple[str, ...], what: str, may_be_nan: tuple[str, ...] = ()
) -> dict[str, np.ndarray]:
    """The named columns of a table as float arrays of one length, (n,).

    Raises
    ------
    InputError
        If a column is missing, is not a row of numbers, differs in length from the first, or holds a value that is
        not finite without being named in `may_be_nan`.
    """
    missing = [name for name in names if name not in table]
    if missing:
        raise InputError(f"{what}: no column {missing[0]!r}; needed: {', '.join(names)}")
    try:
        arrays = {name: np.asarray(table[name], dtype=float) for name in names}
    except (TypeError, ValueError) as error:
        raise InputError(f"{what}: a column is not numeric: {error}") from error
    length = arrays[names[0]].shape
    for name, array in arrays.items():
        if array.ndim != 1 or array.shape != length:
            raise InputError(f"{what}: column {name!r} has shape {array.shape}, {names[0]!r} has {length}")
        if name not in may_be_nan and not np.isfinite(array).all():
            raise InputError(f"{what}: column {name!r} holds a value that is not a finite number")
    return arrays


def band_count(distances_m: np.ndarray, band_m: float) -> int:
    """Bands needed to hold every distance, at least one."""
    return 1 + int(np.max(np.floor(distances_m / band_m), initial=0.0))


def distance_bands(
    distance_m: np.ndarray, detectable: np.ndarray, score: np.ndarray, band_m: float, bands: int
) -> Bands:
    """Count and average vehicles by distance.

    Parameters
    ----------
    distance_m : ndarray, (n,)
        Horizontal distance from the mount [m], below ``bands * band_m``.
    detectable : ndarray, (n,)
        1 or True where the vehicle reaches the threshold.
    score : ndarray, (n,)
        A metric, such as the perception entropy; NaN is allowed.
    band_m : float
        Width of a band [m].
    bands : int
        How many bands, from distance 0 on.
    """
    band = np.floor(distance_m / band_m).astype(int)
    count = np.bincount(band, minlength=bands)
    known = np.isfinite(score)
    return Bands(
        centre_m=(np.arange(bands) + 0.5) * band_m,
        count=count,
        detectable_share=_ratio(np.bincount(band, weights=detectable, minlength=bands), count),
        score=_ratio(
            np.bincount(band[known], weights=score[known], minlength=bands),
            np.bincount(band[known], minlength=bands),
        ),
    )


def covering_edges(low: float, high: float, step: float, anchor: float = 0.0) -> np.ndarray:
    """Edges at ``anchor + k * step`` for whole k, (e,), the shortest run with every value in ``[low, high]`` inside."""
    first = math.floor((low - anchor) / step)
    last = math.floor((high - anchor) / step) + 1
    # The quotient is rounded: an edge may have come out one step on the wrong side of its value.
    first -= anchor + first * step > low
    last += anchor + last * step < high
    return anchor + step * np.arange(first, last + 1)


def cell_shares(
    x_m: np.ndarray, y_m: np.ndarray, counted: np.ndarray, x_edges_m: np.ndarray, y_edges_m: np.ndarray
) -> np.ndarray:
    """Share of the vehicles in each cell of the road for which `counted` is true.

    Parameters
    ----------
    x_m, y_m : ndarray, (n,)
        Box centres [m, road frame]; those beyond the edges count nowhere.
    counted : ndarray, (n,) bool
        Which vehicles make up the share.
    x_edges_m, y_edges_m : ndarray, (c + 1,) and (r + 1,)
        Rising cell edges [m]; a cell holds its lower edge, the last one its upper edge too.

    Returns
    -------
    ndarray, (r, c)
        0 to 1, rows along y; NaN in a cell without vehicles.
    """
    edges = (y_edges_m, x_edges_m)
    total, *_ = np.histogram2d(y_m, x_m, bins=edges)
    part, *_ = np.histogram2d(y_m[counted], x_m[counted], bins=edges)
    return _ratio(part, total)


def near_best_threshold(best: float, baseline: float, share: float) -> float:
    """The least value within `share` of the gain ``best - baseline`` below the best; the best itself without a gain."""
    return best - share * max(best - baseline, 0.0)


def footprints(
    x_m: np.ndarray, y_m: np.ndarray, length_m: np.ndarray, width_m: np.ndarray, heading_deg: np.ndarray
) -> np.ndarray:
    """Corners of vehicle boxes seen from above, (n, 4, 2) [m, road frame], counter-clockwise from the front left.

    All arguments are (n,): box centres and sizes [m], headings [deg] counter-clockwise from +x.
    """
    corner = np.array([[0.5, 0.5], [-0.5, 0.5], [-0.5, -0.5], [0.5, -0.5]])
    along = length_m[:, None] * corner[:, 0]
    left = width_m[:, None] * corner[:, 1]
    heading = np.radians(heading_deg)[:, None]
    x = x_m[:, None] + along * np.cos(heading) - left * np.sin(heading)
    y = y_m[:, None] + along * np.sin(heading) + left * np.cos(heading)
    return np.stack([x, y], axis=-1)


def _ratio(part: np.ndarray, whole: np.ndarray) -> np.ndarray:
    """part / whole, NaN where the whole is zero."""
    return np.divide(part, whole, out=np.full(np.shape(whole), np.nan), where=whole > 0)
