"""How something grows: y = factor x^exponent, by least squares of the logarithms."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..errors import InputError


class PowerLaw(NamedTuple):
    """A fitted power law; the standard error of its exponent is None for two points, which any law fits."""

    exponent: float
    standard_error: float | None
    factor: float


def power_law(x: np.ndarray, y: np.ndarray) -> PowerLaw | None:
    """The law of points (n,); None where there is no exponent: fewer than two different x, or a y of 0.

    Raises
    ------
    InputError
        For numbers of points that differ, or an x that is not above 0.
    """
    x, y = np.asarray(x, dtype=float), np.asarray(y, dtype=float)
    if x.shape != y.shape or x.ndim != 1 or not (x > 0.0).all():
        raise InputError(f"power law: x is {x.tolist()} and y {y.tolist()}; allowed: as many of both, x above 0")
    if len(np.unique(x)) < 2 or not ((y > 0.0) & np.isfinite(y)).all():
        return None
    log_x, log_y = np.log(x), np.log(y)
    away = log_x - log_x.mean()
    spread = float(away @ away)
    exponent = float(away @ log_y) / spread
    level = float(log_y.mean() - exponent * log_x.mean())
    left = log_y - level - exponent * log_x
    error = float(np.sqrt(left @ left / (len(x) - 2) / spread)) if len(x) > 2 else None
    return PowerLaw(exponent, error, float(np.exp(level)))
