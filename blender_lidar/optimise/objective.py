"""The objective's arithmetic: which vehicles count as detectable (Eq. 11) and what each adds to the sum (Eq. 10)."""

from __future__ import annotations

import math

import numpy as np

from ..errors import InputError, unknown_name
from ..metrics.view_grids import check_reading
from ..names import VIEWS
from .search import check_number


def detectable(occupancy: np.ndarray, threshold: float = 0.005, view: str = "mean") -> np.ndarray:
    """Whether enough of a vehicle is seen: ``1(P >= delta)``, Eq. 11.

    The paper does not say which of the three views P is. For a car at 0.005, ``"max"`` asks for about 6 points,
    ``"mean"`` for about 9 and ``"min"`` for about 17.

    Parameters
    ----------
    occupancy : array_like, (..., 3)
        Shares of occupied cells in the top, side and front view (Eq. 8), zero or more.
    threshold : float
        delta, zero or more.
    view : {"mean", "max", "min"}
        How the three views become one P.

    Returns
    -------
    ndarray of bool, (...)

    Raises
    ------
    InputError
        If the threshold, the view or the occupancy is not one of the above.
    """
    if view not in VIEWS:
        raise unknown_name(view, VIEWS, "view")
    threshold = check_number(threshold, 0.0, math.inf, "threshold")
    occupancy = np.asarray(occupancy, dtype=float)
    if occupancy.shape[-1:] != (3,) or not (occupancy >= 0.0).all():  # NaN fails too
        raise InputError(f"occupancy: shape {occupancy.shape}; allowed: (..., 3), shares of 0 or more")
    share = getattr(occupancy, view)(axis=-1)  # views are named as NumPy's means and extremes
    return share >= threshold  # Eq. 11


def vehicle_score(
    merit: np.ndarray, detectable: np.ndarray, loss: float | None = -1.0, reading: str = "corrected"
) -> np.ndarray:
    """What each vehicle adds to the objective: one summand of Eq. 10.

    Parameters
    ----------
    merit : array_like, (...)
        A vehicle's value by the chosen metric, more being better: E, its PE-VGOP [bit] (Eq. 9), in the paper.
    detectable : array_like of bool, (...)
        Eq. 11.
    loss : float or None
        The constant C, in the metric's unit; the paper takes -1 bit. None: a vehicle adds its merit, detectable or not.
    reading : {"corrected", "paper"}
        ``"corrected"``: a missed vehicle costs ``abs(C)``, whichever sign C is given. ``"paper"``: ``-C`` as printed,
        so that with the paper's C = -1 a missed vehicle *earns* 1 bit, more than most detectable ones.

    Returns
    -------
    ndarray, (...)
        In the metric's unit; the objective is its sum over a fixed list of vehicles.

    Raises
    ------
    InputError
        If a merit or the loss is not finite, or the reading is unknown.
    """
    check_reading(reading)
    merit, detectable = np.asarray(merit, dtype=float), np.asarray(detectable, dtype=bool)
    if not np.isfinite(merit).all():
        raise InputError("merit: infinite or NaN; allowed: finite numbers")
    if loss is None:
        return merit
    loss = check_number(loss, -math.inf, math.inf, "loss")
    missed = -abs(loss) if reading == "corrected" else -loss
    return np.where(detectable, merit, missed)  # Eq. 10
