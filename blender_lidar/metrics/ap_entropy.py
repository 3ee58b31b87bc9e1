"""Perception entropy by Ma, Liu and Li: how uncertain a detector fed with so many returns leaves a position."""

from __future__ import annotations

import math

import numpy as np

from ..errors import InputError
from .metric import Metric, VehicleReturns

SLOPE, INTERCEPT, MARGIN = 0.152, 0.659, 1e-3
"""a, b and epsilon of `expected_precision` for a LiDAR, as go4robo has them."""


def expected_precision(
    count: np.ndarray, slope: float = SLOPE, intercept: float = INTERCEPT, margin: float = MARGIN
) -> np.ndarray:
    """Average precision that a detector is expected to have with m returns, clip(a ln m + b, eps, 1 - eps), (n,).

    Parameters
    ----------
    count : ndarray, (n,)
        Returns m; without any the precision is `margin`.
    slope, intercept : float
        a, above 0, and b: to be fitted to a detector.
    margin : float
        eps, above 0 and at most 0.5.

    Raises
    ------
    InputError
        When a setting is out of its bounds or a count is negative.
    """
    count = np.asarray(count)
    if not (count >= 0).all():
        raise InputError("count holds a negative number of returns; allowed: 0 or more")
    if not (0.0 < slope < math.inf and abs(intercept) < math.inf and 0.0 < margin <= 0.5):
        raise InputError(
            f"slope {slope}, intercept {intercept}, margin {margin}; allowed: a slope above 0, a finite intercept, "
            "a margin above 0 and at most 0.5"
        )
    fitted = slope * np.log(np.maximum(count, 1)) + intercept
    return np.where(count > 0, np.clip(fitted, margin, 1.0 - margin), margin)


def ap_entropy(
    returns: VehicleReturns, slope: float = SLOPE, intercept: float = INTERCEPT, margin: float = MARGIN
) -> np.ndarray:
    """Entropy of a vehicle's position, 2 ln sigma + 1 + ln 2 pi with sigma = 1 / AP - 1 [nats], (n,); lower is better.

    The differential entropy of a position in the plane with a normal error of spread sigma in both directions, where AP
    is the `expected_precision` with the vehicle's returns. Ma, Liu and Li, arXiv:2104.06615; constants as in go4robo's
    `bot_3d_rep.py`, which gives the same formulas. Parameters as in `expected_precision`.

    With these constants AP reaches its upper bound at 10 returns and the metric is blind above, so that it does little
    more than count the vehicles with so many: refit a and b to the detector meant. H has no bounds but those that eps
    sets: 16.7 nats for a vehicle without returns, -11.0 for one that is seen well.
    """
    precision = expected_precision(returns.count, slope, intercept, margin)
    return 2.0 * np.log(1.0 / precision - 1.0) + 1.0 + math.log(2.0 * math.pi)


AP_ENTROPY = Metric(
    "ap-entropy",
    "entropy of the position",
    "nats",
    higher_is_better=False,
    score=ap_entropy,
    tells="how uncertain a detector is expected to leave its position",
)
