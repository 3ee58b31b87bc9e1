"""How far two scores rank mountings alike, the best ones counting most."""

from __future__ import annotations

import numpy as np


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
