"""What is left of the difference between two scores when the one may be stretched and shifted to meet the other."""

from __future__ import annotations

import numpy as np


def calibrated_residuals(values: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """Reference less ``a + b values``, (k,): for each half of the mountings fitted by least squares on the other half.

    Where `values` prefers no mounting to another, b is 0.
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
